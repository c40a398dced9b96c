"""SCI and SCE of one sample beside the light that its BSDF mirrors: the right surface passes, a wrong one fails."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import samples
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf import checks
from brdfpipe.bsdf.microfacet.builder import build
from brdfpipe.bsdf.specular_difference import compare
from brdfpipe.errors import InputError
from brdfpipe.facets.analytic_distributions import analytic, flat
from brdfpipe.optics.index import refractive_index
from brdfpipe.spectra.ingestion import ingest

NM = np.arange(400.0, 701, 10)


def pair(included: float, excluded: float, **attrs: Any) -> xr.Dataset:
    values = {"total_reflectance": included, "specular_excluded_reflectance": excluded}
    variables = {name: ("wavelength", np.full(NM.size, value)) for name, value in values.items()}
    attributes = {"geometry": "sci", "theta_i": 8.0, "method": "measured", **attrs}
    return vocabulary.label(xr.Dataset(variables, {"wavelength": NM}, attributes), "spectrum")


def bsdf(slope: float | None, spectrum: xr.Dataset) -> xr.Dataset:
    facets = flat() if slope is None else analytic("beckmann", a=slope)
    return build(facets=facets, index=refractive_index(1.5), spectrum=spectrum)


def verdict(slope: float | None, spectrum: xr.Dataset) -> str:
    result = checks.check(bsdf(slope, spectrum), spectrum)
    return str(json.loads(result.attrs["verdicts"])["specular_difference"]["verdict"])


def test_a_polished_plastic_mirrors_four_percent_into_the_trap() -> None:
    spectrum = pair(0.24, 0.20)
    found = compare(bsdf(None, spectrum), spectrum)
    assert found is not None
    # Fresnel at 8°, ((1.5 − 1) / (1.5 + 1))² = 4 % within 1e-4, and sin² 5° of the diffuse 0.2.
    assert found.predicted == pytest.approx(0.04 + 0.2 * np.sin(np.radians(5)) ** 2, abs=3e-4)
    assert found.measured == pytest.approx(0.04)


@pytest.mark.parametrize(
    ("slope", "difference", "expected"),
    [
        (None, 0.0415, "pass"),
        (None, 0.005, "fail"),  # the sample is rough, the description says polished
        (0.3, 0.0025, "pass"),
        (0.3, 0.041, "fail"),  # the sample is polished, the scan is rough
        (0.3, 0.0118, "warn"),
    ],
)
def test_the_verdict_tells_a_surface_from_one_of_other_roughness(
    slope: float | None, difference: float, expected: str
) -> None:
    assert verdict(slope, pair(0.25, 0.25 - difference)) == expected


def test_between_polished_and_rough_the_trap_takes_what_facets_mirror_into_it() -> None:
    slope, spectrum = 0.05, pair(0.25, 0.22)
    found = compare(bsdf(slope, spectrum), spectrum)
    assert found is not None
    # Facets up to half of 5° from the normal mirror into the trap: 1 − exp(−tan²(2.5°) / a²) of a Beckmann density, times Fresnel's 4 %;
    # the cone is 2 % narrower in slope in the plane of incidence. And the diffuse 0.2 in the cone.
    expected = 0.04 * (1 - np.exp(-((np.tan(np.radians(2.5)) / slope) ** 2))) + 0.21 * np.sin(np.radians(5)) ** 2
    assert found.predicted == pytest.approx(expected, rel=0.03)
    # A trap of 1° more or less takes another share, which the uncertainty holds.
    assert found.u > 0.0043


def test_a_spectrum_alone_is_not_compared() -> None:
    spectrum = pair(0.24, 0.20).drop_vars("specular_excluded_reflectance")
    assert compare(bsdf(None, spectrum), spectrum) is None
    assert "specular_difference" not in json.loads(checks.check(bsdf(None, spectrum), spectrum).attrs["verdicts"])


def write(folder: Path, name: str, value: float) -> Path:
    path = folder / name
    path.write_text("nm;R [%]\n" + "".join(f"{nm:g};{100 * value + nm / 1000:.2f}\n" for nm in NM))
    return path


def test_two_files_are_read_as_one_spectrum(tmp_path: Path) -> None:
    spec = {"sci": {"file": "i.csv"}, "sce": {"file": "e.csv"}, "specular_trap": 4.0, "reflectance_uncertainty": 0.002}
    included, excluded = write(tmp_path, "i.csv", 0.24), write(tmp_path, "e.csv", 0.2)
    both = ingest(spec, included, excluded=excluded)
    assert (both.attrs["geometry"], both.attrs["specular_trap"]) == ("sci", 4.0)
    difference = both["total_reflectance"] - both["specular_excluded_reflectance"]
    np.testing.assert_allclose(difference, 0.04, atol=1e-12)
    np.testing.assert_allclose(both["specular_excluded_reflectance_u"], 0.002)
    with pytest.raises(InputError, match="more light with the specular component excluded than with it included"):
        ingest(spec, excluded, excluded=included)
    with pytest.raises(InputError, match=r"`spectrum\.sce\.column`"):
        ingest({**spec, "sce": {"file": "e.csv", "column": 5}}, included, excluded=excluded)


def test_one_file_may_hold_both_in_labelled_rows(tmp_path: Path) -> None:
    rows = [
        ",".join([name, mode, *(f"{value:.3f}" for _ in NM)])
        for name, mode, value in (("red", "SCI", 0.24), ("red", "SCE", 0.2))
    ]
    path = tmp_path / "both.csv"
    path.write_text("\n".join([",".join(["name", "Mode", *(f"{nm:g}" for nm in NM)]), *rows]) + "\n")
    part = {"file": "both.csv", "sample": "red", "scale": "fraction"}
    both = ingest({"sci": part, "sce": part}, path, excluded=path)
    assert float(both["total_reflectance"][0] - both["specular_excluded_reflectance"][0]) == pytest.approx(0.04)


def test_any_bsdf_is_compared() -> None:
    # A rough surface mirrors nearly nothing into the trap.
    found = compare(samples.beckmann_bsdf(0.3), pair(0.25, 0.247))
    assert found is not None
    assert 0 < found.predicted < 0.01
