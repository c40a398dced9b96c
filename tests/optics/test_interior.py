"""Internal transmittance of a clear body."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from brdfpipe import vocabulary
from brdfpipe.errors import InputError
from brdfpipe.optics import interior


def table(folder: Path, header: str, values: object) -> Path:
    wavelength = np.arange(380.0, 741.0, 20.0)
    path = folder / "t.txt"
    columns = np.column_stack([wavelength, np.broadcast_to(np.asarray(values, dtype=float), wavelength.shape)])
    np.savetxt(path, columns, header=header, comments="")
    return path


def test_a_body_without_a_stated_absorption_absorbs_nothing() -> None:
    clear = vocabulary.validate(interior.ingest({"thickness": 3}), "interior")
    assert interior.spectral(clear) == 1.0
    assert float(clear["thickness"]) == 3


@pytest.mark.parametrize(("unit", "per_mm"), [("1/mm", 0.25), ("1/cm", 0.025), ("1/m", 0.00025)])
def test_an_absorption_coefficient_follows_lamberts_law(tmp_path: Path, unit: str, per_mm: float) -> None:
    spec = {"thickness": 2.0, "absorption": {"file": "t.txt", "unit": unit}}
    interior_dataset = interior.ingest(spec, table(tmp_path, "wavelength_nm absorption", 0.25))
    assert interior_dataset["internal_transmittance"].values == pytest.approx(np.exp(-2 * per_mm), rel=1e-12)
    assert interior.spectral(interior.ingest({"thickness": 2.0, "absorption": per_mm})) == pytest.approx(
        np.exp(-2 * per_mm), rel=1e-12
    )


def test_a_table_in_percent_is_the_table_in_fractions(tmp_path: Path) -> None:
    given = {"file": "t.txt", "scale": "percent"}
    interior_dataset = interior.ingest(
        {"thickness": 1, "internal_transmittance": given}, table(tmp_path, "nm T%", 85.0)
    )
    assert interior.spectral(interior_dataset).values == pytest.approx(0.85)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("header", "values", "options", "pattern"),
    [
        (
            "nm T",
            85.0,
            {},
            r"ambiguous scale: fraction or percent; found values up to 85; accepted: fraction .* or percent",
        ),
        (
            "nm T[%]",
            0.8,
            {},
            "ambiguous scale: fraction or percent; found values up to 0.8 and a header that says percent",
        ),
        ("nm T", 1.2, {"scale": "fraction"}, "internal transmittance above 1; found 1.2"),
        ("nm T", -0.1, {}, "negative transmittance or absorption"),
    ],
)
def test_impossible_or_ambiguous_values_are_refused(
    tmp_path: Path, header: str, values: float, options: dict[str, str], pattern: str
) -> None:
    spec = {"thickness": 1, "internal_transmittance": {"file": "t.txt", **options}}
    with pytest.raises(InputError, match=pattern):
        interior.ingest(spec, table(tmp_path, header, values))


@pytest.mark.parametrize("text", ["500 0.9\n600 0.9\n", "400 0.9 0.8\n700 0.9 0.8\n"])
def test_a_table_that_is_too_short_or_too_wide_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "t.txt").write_text("wavelength_nm T\n" + text)
    with pytest.raises(InputError, match=r"must cover 400–700 nm|too many columns"):
        interior.ingest({"thickness": 1, "internal_transmittance": {"file": "t.txt"}}, tmp_path / "t.txt")


@pytest.mark.parametrize(
    ("spec", "key"),
    [
        ({}, "slab.thickness"),
        ({"thickness": 0}, "slab.thickness"),
        ({"thickness": True}, "slab.thickness"),
        ({"thickness": 1, "internal_transmittance": 1.01}, "slab.internal_transmittance"),
        ({"thickness": 1, "absorption": -1}, "slab.absorption"),
    ],
)
def test_a_number_out_of_range_names_its_key(spec: dict[str, float], key: str) -> None:
    with pytest.raises(InputError, match=f"set `{key}`"):
        interior.ingest(spec)
