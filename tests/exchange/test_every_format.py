"""What every format has to do, whatever it holds: keep the stated error in a round trip, and name what it loses of every kind of material."""

from __future__ import annotations

import json
import re
import tracemalloc
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import rig_primary
import samples
import xarray as xr

from brdfpipe import facets, flakes, optics, psd
from brdfpipe.bsdf import flake, microfacet, slab, wave
from brdfpipe.bsdf.lambert_gauss import lambertian
from brdfpipe.bsdf.measured.completion import complete
from brdfpipe.bsdf.measured.smoothing import smooth
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import error_of, fresh_pairs
from brdfpipe.errors import InputError
from brdfpipe.exchange import records
from brdfpipe.exchange.read_table import ReadTable, as_bsdf
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
    "measured": lambda: complete(
        smooth(rig_primary.measured(rig_primary.lobe("metallic, lobe of 14 degree"), (0.0, 30.0, 60.0), (500.0, 600.0)))
    ),
    "imported": lambda: as_bsdf(
        ReadTable(
            "uniform",
            {"theta_i": np.array([0.0, 80.0]), "theta_o": np.array([0.0, 45.0, 90.0]), "phi_o": np.array([0.0, 180.0])},
            np.full((2, 3, 2, 1), 0.1) * [[[[1.0]], [[0.8]], [[0.5]]]],
            channels="photopic",
        ),
        Path("grey.csv"),
    ),
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
        mirrors = max(float(part.max()) for part in model.specular(normal, normal, None)) > records.NEGLIGIBLE_SHARE
        assert mirrors or "specular" not in lost
        assert not mirrors or "specular" in lost or "specular" in declared.carries


def _list(count: int, last: float) -> str:
    return " ".join(f"{angle:.4f}" for angle in np.linspace(0.0, last, count))


_MANY = 1000
_GRIDS = {
    "zemax": (
        {r"(AngleOfIncidence).*\n.*": 85.0, r"(ScatterAzimuth).*\n.*": 180.0, r"(ScatterRadial).*\n.*": 180.0},
        "{key}  {count}\n{angles}",
    ),
    "integra": ({r"(sigma).*\n.*": 85.0, r"(phi).*\n.*": 180.0, r"(theta) .*\n.*": 180.0}, "{key} {count}\n{angles}"),
    "lighttools": ({r"(ScatterAzimuth).*\n.*": 360.0, r"(ScatterRadial).*\n.*": 89.5}, "{key} 1000000000\n{angles}"),
    "ssdd": (
        {r"(PARAM0_LIST).*": 85.0, r"(PARAM2_LIST).*": 180.0, r"(PARAM3_LIST).*": 180.0},
        "{key} {angles}",
    ),
}
"""Lists of angles of a header, their last angle, and how each is written."""


@pytest.mark.parametrize("name", _GRIDS)
def test_a_header_that_claims_a_milliard_cells_is_refused_before_memory_is_taken(name: str, tmp_path: Path) -> None:
    coarse = {"tolerance": 0.9, "albedo_tolerance": 0.9, "largest": 2000}
    FORMATS[name].write(material("grey"), tmp_path / "x", **coarse)
    file = tmp_path / f"x{FORMATS[name].suffixes('reflection')[0]}"
    text, (lists, written) = file.read_text(), _GRIDS[name]
    for pattern, last in lists.items():

        def claimed(found: re.Match[str], last: float = last) -> str:
            return written.format(key=found[1], count=_MANY, angles=_list(_MANY, last))

        text, count = re.subn(rf"(?m)^{pattern}$", claimed, text, count=1)
        assert count == 1
    file.write_text(text)
    tracemalloc.start()
    try:
        with pytest.raises(InputError):
            read(file, name)
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()


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
