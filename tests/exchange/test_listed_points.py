"""Points of a JSON file on a grid, and files that are refused before they fill the memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from brdfpipe.errors import InputError
from brdfpipe.exchange import listed_points

NAMES = ("phi_i", "theta_i", "theta_o", "phi_o", "channel")


def points(*axes) -> dict[str, np.ndarray]:
    return dict(zip(NAMES, (grid.ravel() for grid in np.meshgrid(*axes, indexing="ij")), strict=True))


def test_points_in_any_order_are_put_on_their_grid():
    columns = points([0.0], [10.0, 50.0], [0.0, 30.0, 60.0], [0.0, 90.0, 180.0], [450.0, 650.0])
    values = np.arange(36.0)[:, None]
    order = np.random.default_rng(1).permutation(36)
    axes, found = listed_points.on_grid(
        Path("x"), {name: column[order] for name, column in columns.items()}, values[order]
    )
    assert list(axes) == ["theta_i", "theta_o", "phi_o"]
    assert found[..., 0].ravel().tolist() == values.ravel().tolist()


def test_points_that_are_absent_have_no_value():
    columns = points([0.0], [10.0, 50.0], [0.0, 30.0], [0.0, 180.0], [0.0])
    _, found = listed_points.on_grid(Path("x"), {name: column[1:] for name, column in columns.items()}, np.ones((7, 1)))
    assert np.isnan(found).sum() == 1


def test_azimuths_of_incidence_are_closed_to_a_turn():
    columns = points([0.0, 90.0, 180.0, 270.0], [10.0, 50.0], [0.0, 30.0], [0.0, 120.0, 240.0], [0.0])
    axes, found = listed_points.on_grid(Path("x"), columns, columns["phi_i"][:, None])
    assert axes["phi_i"].tolist() == [0.0, 90.0, 180.0, 270.0, 360.0]
    assert axes["phi_o"].tolist() == [0.0, 120.0, 240.0, 360.0]
    assert found[:, 0, 0, 0, 0, 0].tolist() == [0.0, 90.0, 180.0, 270.0, 0.0]


def test_points_at_random_would_fill_a_huge_grid_and_are_refused():
    scattered = np.random.default_rng(0).uniform(0, 80, (2000, 5))
    with pytest.raises(InputError, match="no grid"):
        listed_points.on_grid(Path("x"), dict(zip(NAMES, scattered.T, strict=True)), np.ones((2000, 1)))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[1, 2]", "not a JSON object"),
        ('{"a": NaN}', "not finite"),
        ('{"a": ', "damaged JSON"),
        ("[" * 100_000, "damaged JSON"),
        ("", "damaged JSON"),
    ],
)
def test_other_json_is_refused(tmp_path, content, message):
    (tmp_path / "x.json").write_text(content)
    with pytest.raises(InputError, match=message):
        listed_points.read_object(tmp_path / "x.json")


def test_a_file_of_many_gigabytes_is_refused_before_it_is_read(tmp_path):
    with (tmp_path / "huge.json").open("wb") as opened:
        opened.truncate(1 << 34)
    with pytest.raises(InputError, match="too large"):
        listed_points.read_object(tmp_path / "huge.json")
