"""The stage ``spectrum``: total reflectance from a file or from a colour."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.errors import InputError, naming_key
from brdfpipe.spectra.readers import SCALE_DOUBT, check_geometry, check_incidence, read_spectrum
from brdfpipe.spectra.recovery import check_recoverable, index_words, recover, specular_reflectance

_MOST_EXCESS = 0.005
"""Share of the light that SCE may exceed SCI by: the repeatability of two measurements of a matt sample."""
_LOWEST_INDEX = 1.45
"""Below the index of every named plastic: a smooth surface that reflects less was measured with the specular excluded."""


def ingest(
    spec: Mapping[str, Any],
    path: str | PathLike[str] | None = None,
    index: float | xr.Dataset | None = None,
    checkpoint: Path | None = None,
    excluded: str | PathLike[str] | None = None,
) -> xr.Dataset:
    """Total reflectance of a material from the ``spectrum`` section of its material.yaml.

    Parameters
    ----------
    spec : ``file`` and the keywords of :func:`read_spectrum`; or ``lab``, ``geometry``, ``incidence`` and the keywords ``illuminant``,
        ``observer``, ``method``, ``threshold``, ``seed`` of :func:`recover`. With the specular excluded, ``specular_trap`` is the half
        angle of the instrument's gloss trap [degree]; ``reflectance_uncertainty`` is a standard uncertainty common to all wavelengths [1];
        ``fallbacks`` are the keys of a file, with ``specular_trap`` and ``reflectance_uncertainty``, that count only where the file does
        not state them.
        Or ``sci`` and ``sce``, each with ``file`` and keywords: the sample with the specular component included and excluded
    path : path of the file, if it differs from the name in ``spec``
    index : refractive index, if known: a number or a dataset of kind ``index``. A colour with the specular included then gives a
        spectrum that contains its Fresnel reflectance; a file with less than it is warned about
    checkpoint : file with the state of a random search, to resume from
    excluded : path of the file of ``sce``, as ``path`` is that of ``sci``

    Returns
    -------
    Dataset of kind ``spectrum``; of two files that of ``sci``, with ``specular_excluded_reflectance`` at its wavelengths beside it

    Raises
    ------
    InputError : both or neither of ``file`` and ``lab``; as :func:`read_spectrum` and :func:`recover`.
    TypeError : an unknown or missing keyword.
    """
    if "sci" in spec:
        return _pair(spec, path, excluded, index)
    if ("file" in spec) == ("lab" in spec):
        raise _refusal("either `file` or `lab` is required", None, "file: … or lab: [L*, a*, b*]", "spectrum")
    options = dict(spec)
    u = options.pop("reflectance_uncertainty", None)
    dataset = _ingested(options, path, index, checkpoint)
    if u is None:
        return dataset
    if "total_reflectance_u" in dataset:
        if "reflectance_uncertainty" in options.get("fallbacks", ()):
            note = f"the file states uncertainties: `reflectance_uncertainty` {u:g} of the catalogue was left out"
            return vocabulary.add_history(dataset, note)
        problem, accepted = (
            "the file states an uncertainty",
            "no `reflectance_uncertainty` with a column of uncertainties",
        )
        raise _refusal(problem, f"{u:g}", accepted, "spectrum.reflectance_uncertainty")
    return vocabulary.label(
        dataset.assign(total_reflectance_u=xr.full_like(dataset["total_reflectance"], u).drop_attrs()), "spectrum"
    )


def _pair(
    spec: Mapping[str, Any],
    path: str | PathLike[str] | None,
    excluded: str | PathLike[str] | None,
    index: float | xr.Dataset | None,
) -> xr.Dataset:
    """The spectrum with the specular component included, and beside it the one with it excluded."""
    common = {key: spec[key] for key in ("reflectance_uncertainty",) if key in spec}
    parts = {}
    for geometry, file in (("sci", path), ("sce", excluded)):
        with naming_key(f"spectrum.{geometry}", "spectrum"):
            half = {**spec[geometry], **common, "geometry": geometry}
            if fallbacks := {*spec.get("fallbacks", ()), *half.get("fallbacks", ())} - {"geometry", "specular_trap"}:
                half["fallbacks"] = sorted(fallbacks)
            parts[geometry] = ingest(half, file, index)
    included, without = parts["sci"], parts["sce"]
    nm = included["wavelength"].values
    ends = {"left": np.nan, "right": np.nan}
    values = {
        name.replace("total", "specular_excluded"): (
            "wavelength",
            np.interp(nm, without["wavelength"], without[name], **ends),
        )
        for name in ("total_reflectance", "total_reflectance_u")
        if name in without
    }
    both = included.assign(values)
    excess = float((both["specular_excluded_reflectance"] - both["total_reflectance"]).mean())
    if excess > _MOST_EXCESS:
        raise _refusal(
            "more light with the specular component excluded than with it included",
            f"{excess:.3g} of the light more",
            "sci and sce of one sample, not interchanged",
            "spectrum",
        )
    both = both.assign_attrs(_trap_attribute(spec.get("specular_trap"), "sce"))
    history = [f"SCE: {line}" for line in without.attrs.get("history", "").splitlines() if line]
    both = vocabulary.add_history(vocabulary.label(both, "spectrum"), *history)
    both.attrs.pop("warnings", None)
    of_each = (f"{kind.upper()}: {one}" for kind, part in parts.items() for one in vocabulary.warnings(part))
    return vocabulary.add_warning(both, *of_each)


def _ingested(
    options: dict[str, Any],
    path: str | PathLike[str] | None,
    index: float | xr.Dataset | None,
    checkpoint: Path | None,
) -> xr.Dataset:
    trap, geometry = options.pop("specular_trap", None), options.get("geometry")
    if "file" in options:
        file = options.pop("file")
        source = Path(file if path is None else path)
        dataset = read_spectrum(source, **options)
        if "specular_trap" in options.get("fallbacks", ()) and dataset.attrs["geometry"] != "sce":
            trap = None
        trap_attribute = _trap_attribute(trap, dataset.attrs["geometry"])
        return _warn_if_excluded(dataset, source.name, index).assign_attrs(trap_attribute)
    options, trap_attribute = _of_colour(options, trap)
    specular_index = index if geometry == "sci" else None
    recovered = recover(specular_index=specular_index, checkpoint=checkpoint, progress=True, **options)
    return recovered.assign_attrs(trap_attribute)


def check_colour(spec: Mapping[str, Any], index: float | xr.Dataset | None = None) -> None:
    """Refuse a ``spectrum`` section with ``lab`` that :func:`ingest` will refuse; nothing is searched for.

    Parameters
    ----------
    spec, index : as for :func:`ingest`

    Raises
    ------
    InputError : naming the key of material.yaml.
    """
    options = dict(spec)
    with naming_key("spectrum.lab", "lab"):
        options, _ = _of_colour(options, options.pop("specular_trap", None))
        for name in ("seed", "reflectance_uncertainty"):
            options.pop(name, None)
        specular_index = index if options.pop("geometry") == "sci" else None
        check_recoverable(specular_index=specular_index, **options)


def _of_colour(options: dict[str, Any], trap: float | None) -> tuple[dict[str, Any], dict[str, float]]:
    """Keywords of the recovery of a colour, and the attribute of the gloss trap; a wrong geometry, incidence or trap is refused."""
    check_geometry("material.yaml", options.get("geometry"))
    check_incidence("material.yaml", options.get("incidence"))
    trap_attribute = _trap_attribute(trap, str(options.get("geometry")))
    theta = {"theta": options["incidence"]} if "incidence" in options else {}
    return {key: value for key, value in options.items() if key != "incidence"} | theta, trap_attribute


def _trap_attribute(trap: float | None, geometry: str) -> dict[str, float]:
    """Half angle of the gloss trap [degree], as an attribute; empty if none is given."""
    if trap is None:
        return {}
    if geometry != "sce":
        problem = "a gloss trap needs a reflectance with the specular excluded"
        raise _refusal(problem, f"geometry {geometry}", "geometry sce", "spectrum.specular_trap")
    return {"specular_trap": float(trap)}


def _warn_if_excluded(dataset: xr.Dataset, file: str, index: float | xr.Dataset | None) -> xr.Dataset:
    """Warn if a reflectance with the specular included is below the specular reflectance alone."""
    n = _LOWEST_INDEX if index is None else index
    wavelength = dataset["wavelength"].values
    specular = specular_reflectance(n, dataset.attrs["theta_i"], wavelength)
    is_below = dataset["total_reflectance"].values < specular
    below = wavelength[is_below]
    scale_is_doubtful = any(SCALE_DOUBT in warning for warning in vocabulary.warnings(dataset))
    if dataset.attrs["geometry"] != "sci" or below.size == 0 or scale_is_doubtful:
        return dataset
    surface = f"a smooth surface of index {index_words(n)}"
    if index is None:
        surface += ", lower than any named plastic"
    return vocabulary.add_warning(
        dataset,
        f"{file}: the reflectance is below {specular[is_below].max():.4f}, the specular reflectance of {surface}, at {below.size} wavelengths "
        f"from {below[0]:g} to {below[-1]:g} nm. If the specular was excluded, set `spectrum.geometry: sce`; otherwise correct the index.",
    )


def _refusal(problem: str, found: str | None, accepted: str, key: str) -> InputError:
    return InputError("material.yaml", problem, where="spectrum", found=found, accepted=accepted, key=key)
