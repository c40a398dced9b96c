"""The ``spectrum`` of a material file: which keys, which defaults, and where the refractive index counts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from brdfpipe.catalogue.material_keys import Colour, MeasuredSpectrum
from brdfpipe.errors import InputError
from brdfpipe.optics import fresnel, interpolate_index, refractive_index
from brdfpipe.spectra import ingest
from brdfpipe.vocabulary import warnings

LAB = {"lab": [30.0, 5.0, 2.0], "illuminant": "D65", "observer": 10, "geometry": "sci"}


def test_a_colour_with_the_specular_included_contains_the_fresnel_reflectance() -> None:
    spectrum = ingest({**LAB, "incidence": 10}, None, 1.59)
    assert spectrum["total_reflectance"].min() > fresnel(np.cos(np.radians(10)), 1.59).mean
    assert spectrum.attrs["theta_i"] == 10


def test_the_index_does_not_count_where_the_specular_was_excluded() -> None:
    excluded = ingest({**LAB, "geometry": "sce"}, None, 1.59)
    without = ingest(LAB)
    np.testing.assert_array_equal(excluded["total_reflectance"], without["total_reflectance"])
    assert (excluded.attrs["geometry"], without.attrs["geometry"]) == ("sce", "sci")


def test_a_measured_black_is_judged_by_the_index_of_each_wavelength(tmp_path: Path) -> None:
    index = refractive_index("PC")
    wavelength = np.arange(400, 701, 10)
    specular = fresnel(np.cos(np.radians(8)), interpolate_index(index, wavelength)[0]).mean
    path = tmp_path / "r.txt"
    spec = {"file": "r.txt", "geometry": "sci", "scale": "fraction"}
    for above, expected in ((1e-4, False), (-1e-4, True)):
        rows = zip(wavelength, specular + above, strict=True)
        path.write_text("".join(f"{nm} {r:.8f}\n" for nm, r in rows), encoding="ascii")
        assert (
            any("If the specular was excluded" in warning for warning in warnings(ingest(spec, path, index)))
            == expected
        )


def test_the_incidence_is_8_degree_by_default() -> None:
    assert ingest(LAB).attrs["theta_i"] == 8


def test_a_file_is_read_from_its_path_with_its_options(tmp_path: Path) -> None:
    path = tmp_path / "r.txt"
    path.write_text("".join(f"{nm} 0.5 0.6\n" for nm in range(400, 701, 10)), encoding="ascii")
    spectrum = ingest({"file": "r.txt", "geometry": "sci", "scale": "fraction", "column": 3}, path)
    assert (spectrum["total_reflectance"] == 0.6).all()


def test_the_geometry_of_the_file_is_used_if_the_description_has_none(tmp_path: Path) -> None:
    rows = "".join(f"{nm} 0.5\n" for nm in range(400, 701, 10))
    path = tmp_path / "r.txt"
    path.write_text("# specular included\n" + rows, encoding="ascii")
    spectrum = ingest({"file": "r.txt", "scale": "fraction"}, path)
    assert (spectrum.attrs["geometry"], spectrum.attrs["theta_i"]) == ("sci", 8)
    path.write_text(rows, encoding="ascii")
    with pytest.raises(InputError, match="specular reflection included or excluded: not stated") as refusal:
        ingest({"file": "r.txt", "scale": "fraction"}, path)
    assert refusal.value.key == "spectrum.geometry"


@pytest.mark.parametrize(
    ("spec", "key", "message"),
    [
        ({}, "spectrum", "either `file` or `lab` is required"),
        ({"file": "r.txt", **LAB}, "spectrum", "either `file` or `lab` is required"),
        (
            {k: v for k, v in LAB.items() if k != "geometry"},
            "spectrum.geometry",
            "specular reflection included or excluded",
        ),
        ({**LAB, "incidence": "8"}, "spectrum.incidence", "invalid incidence angle"),
        ({**LAB, "incidence": 95}, "spectrum.incidence", "invalid incidence angle"),
        ({**LAB, "geometry": "both"}, "spectrum.geometry", "found 'both'"),
    ],
)
def test_a_wrong_or_missing_key_is_refused_by_name(spec: Any, key: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as refusal:
        ingest(spec)
    assert refusal.value.key == key


@pytest.mark.parametrize(
    ("spec", "name"),
    [
        ({**LAB, "observr": 2}, "observr"),
        ({**LAB, "scale": "percent"}, "scale"),
        ({"file": "r.txt", "geometry": "sci", "illuminant": "D65"}, "illuminant"),
        ({k: v for k, v in LAB.items() if k != "illuminant"}, "illuminant"),
        ({k: v for k, v in LAB.items() if k != "observer"}, "observer"),
    ],
)
def test_a_keyword_that_does_not_apply_or_is_missing_is_refused_by_the_signature(spec: Any, name: str) -> None:
    with pytest.raises(TypeError, match=rf"\b{name}\b"):
        ingest(spec)


def test_the_method_its_threshold_and_seed_reach_the_search(tmp_path: Path) -> None:
    spec = {**LAB, "lab": [50.0, 10.0, 5.0], "method": "adaptive4", "threshold": 0.01, "seed": 3}
    spectrum = ingest(spec, checkpoint=tmp_path / "search.json")
    assert (spectrum.attrs["method"], spectrum.attrs["seed"], spectrum.attrs["threshold"]) == ("adaptive4", 3, 0.01)
    assert spectrum.attrs["residual_delta_e"] < 0.01
    assert list(tmp_path.iterdir()) == []


def test_a_gloss_trap_needs_a_reflectance_with_the_specular_excluded() -> None:
    spec = {"lab": [50, 0, 0], "illuminant": "D65", "observer": 10, "geometry": "sce", "specular_trap": 3}
    assert ingest(spec).attrs["specular_trap"] == 3.0
    with pytest.raises(InputError, match=r"needs a reflectance with the specular excluded.*spectrum\.specular_trap"):
        ingest({**spec, "geometry": "sci"})


@pytest.mark.parametrize("angle", [0, True, 90.1, -1])
@pytest.mark.parametrize(("keys", "source"), [(MeasuredSpectrum, {"file": "r.txt"}), (Colour, LAB)])
def test_the_half_angle_of_a_gloss_trap_is_checked_with_the_keys(keys: Any, source: Any, angle: Any) -> None:
    with pytest.raises(ValidationError, match="specular_trap"):
        keys.model_validate({**source, "geometry": "sce", "specular_trap": angle})


def test_warnings_of_both_reflectances_say_of_which_they_are(tmp_path: Path) -> None:
    path = tmp_path / "both.csv"
    rows = "".join(f"{nm};30;25\n" for nm in range(400, 701, 10) if nm != 550)
    path.write_text(f"nm;R SCI %;R SCE %\n{rows}", encoding="utf-8")
    half = {"file": path.name}
    words = (
        "both.csv: the step from 540 to 560 nm differs from the others. Look for a lost row or a mistyped wavelength."
    )
    spectrum = ingest({"sci": half, "sce": half}, path, excluded=path)
    assert warnings(spectrum) == [f"SCI: {words}", f"SCE: {words}"]
