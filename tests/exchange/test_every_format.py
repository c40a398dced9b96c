"""What every format has to do, whatever it holds: keep the stated error in a round trip, and name what it loses of every kind of material."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import samples
import xarray as xr

from brdfpipe import facets, flakes, optics, psd
from brdfpipe.bsdf import flake, microfacet, slab, wave
from brdfpipe.bsdf.lambert_gauss import lambertian
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import error_of, fresh_pairs
from brdfpipe.exchange.reading import read
from brdfpipe.exchange.registry import FORMATS, LOSSES, WRITTEN, ExchangeError

ROUND_TRIPS = [name for name in WRITTEN if FORMATS[name].read]
GRID = {"tolerance": 0.1, "albedo_tolerance": 0.05, "largest": 30_000}

_COLOURS = [
    {"geometry": name, "lab": [lightness, 5, -20]}
    for name, lightness in (("45as15", 60), ("45as45", 30), ("45as110", 15))
]

KINDS: dict[str, Callable[[], xr.Dataset]] = {
    "facets": lambda: samples.beckmann_bsdf(0.3),
    "grey": lambda: samples.beckmann_bsdf(0.3).bsdf.nonspectral(),
    "lay": lambda: samples.brushed_bsdf(0.4, 0.25),
    "smooth": lambda: microfacet.build(facets.flat(), index=1.5, spectrum=samples.spectrum(0.3)),
    "coherent": lambda: wave.build(
        psd.analytic("gaussian", sigma=0.05, length=2.0), index=1.5, wavelength=[500.0, 600.0]
    ),
    "sheet": lambda: slab.build(samples.beckmann(0.4), facets.flat(), index=1.5, internal_transmittance=0.9),
    "clear sheet": lambda: slab.build(facets.flat(), facets.flat(), index=1.5),
    "flakes": lambda: flake.build(flakes.ingest({"colours": _COLOURS, "illuminant": "D65", "observer": 10})),
    "diffuser": lambda: lambertian(samples.spectrum(0.5)),
    "black": lambda: lambertian(samples.spectrum(0.0)),
    "gloss alone": lambda: samples.beckmann_bsdf(0.3, n=1.5, reflectance=None),
    "metal": lambda: microfacet.build(facets.analytic("ggx", 0.4), index=optics.refractive_index({"n": 0.4, "k": 2.8})),
}


@cache
def material(kind: str) -> xr.Dataset:
    return KINDS[kind]().assign_attrs(material=kind)


def options(name: str) -> dict[str, object]:
    return dict(GRID) if FORMATS[name].takes == "grid" else {}


def _stated(name: str, file: Path) -> dict[str, float]:
    """The error that is stated beside a file, or in it for the formula that is read."""
    if FORMATS[name].has_record:
        return json.loads(Path(f"{file}.json").read_text())["error"]
    fits = json.loads(file.read_text())["fits"]
    found = [
        one for fit in fits for one in (fit, fit.get("by_incidence", {})) if {"parameters", "incidences"} & set(one)
    ]
    return min((one["error"] for one in found), key=lambda error: error["percentile_95"])


@pytest.mark.parametrize("name", ROUND_TRIPS)
def test_a_round_trip_keeps_the_stated_error(name: str, tmp_path: Path) -> None:
    bsdf = material("grey")
    declared = FORMATS[name]
    declared.write(bsdf, tmp_path / "x", **options(name))
    file = tmp_path / f"x{declared.suffixes('reflection')[0]}"
    found = read(file, name).bsdf.nonspectral() if "wavelength" in read(file, name).coords else read(file, name)
    stated = _stated(name, file)
    again = error_of(bsdf, representation(found).evaluate, fresh_pairs(bsdf, 31))
    # Other directions than those of the statement, of 12 incidences each.
    assert again.percentile_95 <= 1.6 * stated["percentile_95"] + 2e-3
    assert again.albedo <= 1.6 * stated["albedo"] + 2e-3


def _refusal(write: Callable[[], None]) -> str:
    """The words with which a material is refused; empty if it is written."""
    try:
        write()
    except ExchangeError as error:
        return str(error)
    return ""


def _exports(name: str, kind: str, folder: Path) -> None:
    """Write a material: the files, or a refusal in words."""
    bsdf, declared = material(kind), FORMATS[name]
    transmits = representation(bsdf).transmits
    for side in declared.files:
        if side == "transmission" and not transmits:
            continue
        if refusal := _refusal(lambda side=side: declared.write(bsdf, folder / "x", side, **options(name))):
            assert len(refusal) > 20
            continue
        for suffix in declared.suffixes(side):
            assert (folder / f"x{suffix}").stat().st_size > 0
        if not declared.has_record:
            continue
        record = json.loads((folder / f"x{declared.suffixes(side)[0]}.json").read_text())
        lost = set(record["left_out"])
        assert lost <= set(LOSSES)
        assert np.isfinite([value for value in record["error"].values() if isinstance(value, float)]).all()
        assert ("lay" in lost) == (not representation(bsdf).isotropic and "lay" not in declared.carries)
        assert ("transmission" in lost) == (transmits and "transmission" not in declared.carries)
        model, normal = representation(bsdf), np.zeros(1)
        mirrors = max(float(part.max()) for part in model.specular(normal, normal, None)) > 1e-6
        assert mirrors or "specular" not in lost
        assert not mirrors or "specular" in lost or "specular" in declared.carries


@pytest.mark.parametrize("name", WRITTEN)
def test_a_sheet_is_written_or_refused_and_its_losses_are_named(name: str, tmp_path: Path) -> None:
    _exports(name, "sheet", tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", WRITTEN)
def test_every_kind_of_material_is_written_or_refused_and_its_losses_are_named(
    name: str, kind: str, tmp_path: Path
) -> None:
    _exports(name, kind, tmp_path)
