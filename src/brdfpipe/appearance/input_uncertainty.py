"""Uncertainty of gloss, haze and colours from the inputs of a prediction, by source.

Each independent change of an input by one standard uncertainty changes the whole BSDF (:mod:`brdfpipe.bsdf.source_changes`). Every
quantity is computed of every changed BSDF, so that correlations are kept: between the directions in a receptor, between the receptors of a haze,
and between wavelengths.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance import apertures
from brdfpipe.appearance.apertures import Rule
from brdfpipe.appearance.colours import FLOP_GEOMETRIES, TOTAL, colours_after_changes, flop_index, total_reflectance
from brdfpipe.appearance.gloss_meter import beam_of, gloss_of_each
from brdfpipe.appearance.haze import HazeWindow, beams_of, haze_of
from brdfpipe.appearance.transmission import luminous_transmittance, transmission_haze
from brdfpipe.bsdf.change_variables import MODEL, NOT_STATED, OF_MAP
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.source_changes import Reflector, SourceChanges, uncertain, without_changes
from brdfpipe.geometry import Array
from brdfpipe.spectra import colorimetry

INSTRUMENT = "instrument"
"""Source of the tolerances of instruments."""

_RULE = Rule((2, 3), 3)
"""Accurate to 1 % of a change."""
_TURNS = np.arange(8) * 22.5
"""Azimuths from the lay over which a change of gloss is averaged: a half turn, because changes of a density are symmetric [degree]."""


def with_input_uncertainty(
    appearance: xr.Dataset,
    bsdf: xr.Dataset,
    *,
    geometries: Sequence[str],
    windows: Sequence[HazeWindow],
) -> xr.Dataset:
    """Appearance with the uncertainty of the inputs of its BSDF; unchanged where none is known.

    Parameters
    ----------
    appearance : any of ``gloss``, ``haze``, ``reflectance_haze``, ``lab`` and ``flop_index``, with ``<name>_u`` from the tolerances of
        instruments; attributes ``illuminant`` and ``observer`` with ``lab``
    bsdf : the BSDF that it was computed from
    geometries : names of the geometries of ``lab``, without that of the total reflectance
    windows : of ``reflectance_haze``

    Returns
    -------
    The same with ``<name>_u`` of all sources together, and ``<name>_u_source(source, …)``: the inputs, and ``instrument``
    """
    if not uncertain(bsdf):
        return appearance
    parts: dict[str, Mapping[str, Array]] = {}
    if "gloss" in appearance or windows:
        parts |= _meter_parts(appearance, bsdf, windows)
    if "lab" in appearance:
        parts |= _colour_parts(appearance, bsdf, geometries)
    sources = [*dict.fromkeys(SourceChanges.of(bsdf).sources), INSTRUMENT]
    fields: dict[str, tuple[Any, ...]] = {}
    # A total reflectance is as uncertain as its spectrum.
    total_known = "spectrum" not in str(bsdf.attrs.get(NOT_STATED, "")).split(", ")
    for name, by_source in parts.items():
        given = appearance[name]
        tolerance = appearance.get(f"{name}_u", xr.zeros_like(given))
        rows = np.stack([np.broadcast_to(by_source.get(source, 0.0), given.shape) for source in sources[:-1]])
        rows = np.concatenate([rows, tolerance.values[None]])
        # No tolerance is known of the instrument that measures a total reflectance.
        total = np.sqrt(np.square(np.nan_to_num(rows)).sum(axis=0))
        known = np.isfinite(given.values)
        if not total_known and name in ("lab", "luminous_reflectance"):
            known = known & (given["geometry"].values != TOTAL)[:, None] if name == "lab" else np.zeros_like(known)
        total, rows = np.where(known, total, np.nan), np.where(known, rows, np.nan)
        attrs = {"units": "1", "long_name": f"standard uncertainty of {given.attrs.get('long_name', name)}"}
        fields[f"{name}_u"] = (
            given.dims,
            total,
            attrs | {"long_name": f"{attrs['long_name']}, from tolerances and the BSDF"},
        )
        fields[f"{name}_u_source"] = (
            ("source", *given.dims),
            rows,
            attrs | {"long_name": f"{attrs['long_name']}, by source"},
        )
    return appearance.assign(fields).assign_coords(source=sources)


def with_transmission_uncertainty(appearance: xr.Dataset, bsdf: xr.Dataset) -> xr.Dataset:
    """Appearance with the uncertainty of ``luminous_transmittance`` and ``transmission_haze`` from the inputs of the BSDF.

    No tolerance of instruments is known. Unchanged where the BSDF does not transmit or its inputs are not uncertain.
    """
    names = [name for name in ("luminous_transmittance", "transmission_haze") if name in appearance]
    if not names or not uncertain(bsdf):
        return appearance
    changes, reduced = SourceChanges.of(bsdf), SourceChanges.of(nonspectral(bsdf))
    found = {
        "luminous_transmittance": [luminous_transmittance(bsdf, one) for one in (changes.given, *changes.changed)],
        "transmission_haze": [transmission_haze(bsdf, one) for one in (reduced.given, *reduced.changed)],
    }
    sources = [*dict.fromkeys(changes.sources), INSTRUMENT]
    appearance = appearance.assign_coords(source=sources)
    for name in names:
        values = np.array(found[name])
        by_source = changes.by_source(values[1:] - values[0])
        rows = np.array([float(by_source.get(source, 0.0)) for source in sources])
        title = f"standard uncertainty of {vocabulary.QUANTITIES[name].long_name}"
        attrs = {"units": "1", "long_name": f"{title}, from the BSDF"}
        appearance[f"{name}_u"] = ((), float(np.sqrt(np.square(rows).sum())), attrs)
        appearance[f"{name}_u_source"] = ("source", rows, attrs | {"long_name": f"{title}, by source"})
    return appearance


def _meter_parts(
    appearance: xr.Dataset, bsdf: xr.Dataset, windows: Sequence[HazeWindow]
) -> dict[str, Mapping[str, Array]]:
    """Standard uncertainty of gloss, haze and reflectance haze from each source."""
    sample = apertures.sample_of(bsdf, None)
    changes = SourceChanges.of(sample.bsdf)
    isotropic = representation(sample.bsdf).isotropic
    azimuths = np.asarray(np.zeros(1) if isotropic else (representation(sample.bsdf).lay or 0.0) + _TURNS, dtype=float)
    angles = appearance["gloss_angle"].values.tolist() if "gloss" in appearance else []

    of_gloss, of_windows = [beam_of(angle, _RULE) for angle in angles], [beams_of(window, _RULE) for window in windows]
    receptors = apertures.Receptors.of(sample, [*of_gloss, *chain.from_iterable(of_windows)])

    def measured(reflector: Reflector, received: Sequence[Array]) -> Array:
        light = iter(received)
        received_here = [next(light) for _ in of_gloss]
        each = gloss_of_each(sample, of_gloss, received_here, azimuths, reflector) if of_gloss else []
        gloss = [one.mean() for one in each]
        beside = [haze_of(beams, [next(light) for _ in beams]).mean() for beams in of_windows]
        return np.array([*gloss, *beside])

    reflectors = changes.given, *changes.changed
    given, *changed = map(measured, reflectors, receptors.received_each(azimuths, changes))
    all_changes = np.array(changed) - given
    parts = {"gloss": changes.by_source(all_changes[:, : len(angles)])} if angles else {}
    if windows:
        parts["reflectance_haze"] = changes.by_source(all_changes[:, len(angles) :])
    if {20.0, 60.0} <= set(angles):
        parts["haze"] = changes.by_source(all_changes[:, angles.index(60.0)] - all_changes[:, angles.index(20.0)])
    if MODEL in parts.get("gloss", {}) and "model_gloss_error" in bsdf:
        finer = _finer_roughness(sample.bsdf)
        of_finer = np.zeros(given.size)
        if finer is not None:
            of_finer = measured(finer, receptors.received(azimuths, finer)) - given
        of_finer = of_finer[: len(angles)]
        parts |= _known_errors(parts, bsdf, angles, of_finer)
    return dict(parts)


def _known_errors(
    parts: Mapping[str, dict[str, Array]], bsdf: xr.Dataset, angles: list[float], of_finer: Array
) -> dict[str, dict[str, Array]]:
    """Gloss and haze with the error of gloss that a reference states instead of that of the light by region: light that a region reflects too much
    may still enter the receptor.

    The reference is of the map that was counted. That it is finite counts once: as that of facets and spectrum, and here by what it makes of the
    reference beyond that. ``of_finer`` is the change of gloss by finer roughness, of which neither knows.
    """
    error, of_map = (
        bsdf[name].reindex(error_gloss_angle=angles).values for name in ("model_gloss_error", "reference_gloss_u")
    )
    counted = sum((np.square(parts["gloss"].get(name, np.zeros_like(error))) for name in OF_MAP), np.zeros_like(error))
    not_counted = np.sqrt(np.maximum(np.square(of_map) - counted, 0.0))

    def known(own: Array, others: Array, of_light: Array) -> Array:
        return np.where(np.isfinite(own), np.sqrt(own**2 + others), of_light)

    others = not_counted**2 + of_finer**2
    result = {"gloss": parts["gloss"] | {MODEL: known(error, others, parts["gloss"][MODEL])}}
    if "haze" in parts:
        low, high = angles.index(20.0), angles.index(60.0)
        others_of_haze = not_counted[low] ** 2 + not_counted[high] ** 2 + (of_finer[high] - of_finer[low]) ** 2
        own = error[high] - error[low]
        result["haze"] = parts["haze"] | {MODEL: known(own, others_of_haze, parts["haze"][MODEL])}
    return result


def _finer_roughness(bsdf: xr.Dataset) -> Reflector | None:
    """The BSDF less the light that roughness finer than the scan may scatter, which reference solutions on that scan do not know either."""
    if "finer_roughness_loss" not in bsdf:
        return None
    return SourceChanges(without_changes(bsdf).assign(relative_error=bsdf["finer_roughness_loss"])).changed[0]


def _colour_parts(
    appearance: xr.Dataset, bsdf: xr.Dataset, geometries: Sequence[str]
) -> dict[str, Mapping[str, Array]]:
    """Standard uncertainty of colours, flop index and luminous reflectance from each source."""
    changes = SourceChanges.of(bsdf)
    seen_under = str(appearance.attrs["illuminant"]), int(appearance.attrs["observer"])
    names = [str(name) for name in appearance["geometry"].values]
    three = [names.index(name) for name in FLOP_GEOMETRIES if name in names]
    spectra = [total_reflectance(bsdf, reflector) for reflector in (changes.given, *changes.changed)]
    labs = colours_after_changes(bsdf, geometries, *seen_under, changes, [total for _, total in spectra])
    flops = [flop_index(*lab[three, 0]) for lab in labs] if "flop_index" in appearance else []
    weight = colorimetry.luminous_weight(spectra[0][0])
    luminous = [float(weight @ total / weight.sum()) for _, total in spectra]
    return {
        name: changes.by_source(np.asarray(values[1:]) - np.asarray(values[0]))
        for name, values in (("lab", labs), ("flop_index", flops), ("luminous_reflectance", luminous))
        if len(values)
    }
