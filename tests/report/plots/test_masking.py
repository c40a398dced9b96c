from __future__ import annotations

import re

import numpy as np
import pytest
import samples
import xarray as xr

from brdfpipe.facets import analytic
from brdfpipe.masking.analytic_smith import beckmann_lambda
from brdfpipe.report.plots import masking
from brdfpipe.report.plots.svg import Figure, Line


def _labels(figure: Figure) -> list[str]:
    return [label for *_, label in figure.legend]


def test_masking_along_the_lay_is_that_of_the_narrow_width(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Line] = []
    monkeypatch.setattr(masking, "_figure", lambda title, name, marks, note: drawn.extend(marks))
    masking.smith_masking_with_lay(analytic("beckmann", a_x=0.2, a_y=0.5, azimuth=30.0), 30.0)
    theta = np.array([70.0, 85.0])
    for line, width in zip(drawn, (0.2, 0.5), strict=True):
        np.testing.assert_allclose(np.interp(theta, line.x, line.y), 1 / (1 + beckmann_lambda(theta, width)), atol=5e-3)


def test_the_visibility_of_the_heights_is_drawn_beside_smiths() -> None:
    choice = samples.masking_choice()
    figure = masking.visibility_figure(choice)
    assert figure is not None
    assert [label.split(",")[0] for label in _labels(figure)] == ["Smith", "traced on the map"] * 2
    assert "Smith's masking would give −30%" in figure.note.replace("-", "−")
    assert figure.note.endswith("masking measured.")
    assert masking.visibility_figure(choice[[]]) is None


def test_g2_is_drawn_where_it_was_cast_with_error_bars_where_they_are_known() -> None:
    cast = {
        "g2_raycast": [1.0, 0.9, 0.5, np.nan],
        "g2_raycast_u": [0.0, 0.01, np.nan, np.nan],
        "g2_height_correlated": [1.0, 0.9, 0.6, 0.2],
    }
    comparison = xr.Dataset(
        {name: ("theta_i", values) for name, values in cast.items()}, {"theta_i": [0.0, 30, 60, 80]}
    )
    figure = masking.bistatic_figure(comparison)
    assert figure is not None
    assert _labels(figure)[0] == "Smith, height-correlated"
    points, bars = (
        re.search(r'class="p c2" d="([^"]*)"', figure.svg),
        re.search(r'class="e c2" d="([^"]*)"', figure.svg),
    )
    assert points is not None
    assert bars is not None
    assert points[1].count("h0") == 3  # no facet faces both directions at the fourth
    assert bars[1].count("V") == 2
    assert "nan" not in figure.svg
    assert masking.bistatic_figure(comparison.assign(g2_raycast=np.nan * comparison["g2_raycast"])) is None
