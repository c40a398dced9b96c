"""Reflectance spectra: read from files, recovered from colours, and their colorimetry."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.errors import InputError
from brdfpipe.spectra.readers import GEOMETRIES, read_spectrum
from brdfpipe.spectra.recovery import index_words, metamerism, recover, specular_reflectance

__all__ = ["ingest", "metamerism", "read_spectrum", "recover"]

_FILE_KEYS = ("format", "scale", "sample", "column", "uncertainty", "allow_fluorescent")
_LAB_KEYS = ("illuminant", "observer", "method", "threshold", "seed")
_COMMON_KEYS = ("geometry", "incidence", "specular_trap")
_INCIDENCE = 8.0
_LOWEST_INDEX = 1.45
"""Below the index of every named plastic: a smooth surface that reflects less was measured with the specular excluded."""


def ingest(
    spec: Mapping[str, Any],
    path: str | PathLike[str] | None = None,
    index: float | xr.Dataset | None = None,
    checkpoint: Path | None = None,
) -> xr.Dataset:
    """Total reflectance of a material from the ``spectrum`` section of its material.yaml.

    Parameters
    ----------
    spec : ``{file, format, geometry, incidence, scale, sample, column, uncertainty, allow_fluorescent}`` or
        ``{lab, illuminant, observer, method, threshold, seed, geometry, incidence}``. ``geometry`` may be absent if the file states
        it; ``incidence`` is 8 degree by default. With the specular excluded, ``specular_trap`` is the half angle of the
        instrument's gloss trap
    path : path of the file, if it differs from the name in ``spec``
    index : refractive index, if known: a number or a dataset of kind ``index``. A colour with the specular included then gives a spectrum that contains its Fresnel
        reflectance; a file with less than it is warned about
    checkpoint : file with the state of a random search, to resume from

    Returns
    -------
    Dataset of kind ``spectrum``

    Raises
    ------
    InputError : unknown or missing keys; as :func:`read_spectrum` and :func:`recover`.
    """
    is_file = _check_keys(spec)
    incidence = _incidence(spec)
    if is_file:
        options = {key: spec[key] for key in _FILE_KEYS if key in spec}
        source = path if path is not None else str(spec["file"])
        stated = _geometry(spec) if "geometry" in spec else None
        dataset = read_spectrum(source, geometry=stated, incidence=incidence, **options)
        trap = _specular_trap(spec, dataset.attrs["geometry"])
        return _warn_if_excluded(dataset, Path(source).name, index).assign_attrs(trap)
    geometry = _geometry(spec)
    trap = _specular_trap(spec, geometry)
    recovered = recover(
        spec["lab"],
        illuminant=spec["illuminant"],
        observer=spec["observer"],
        **{key: spec[key] for key in ("method", "threshold", "seed") if key in spec},
        specular_index=index if geometry == "sci" else None,
        theta=_INCIDENCE if incidence is None else incidence,
        geometry=geometry,
        checkpoint=checkpoint,
        progress=True,
    )
    return recovered.assign_attrs(trap)


def _specular_trap(spec: Mapping[str, Any], geometry: str) -> dict[str, float]:
    """Half angle of the gloss trap [degree], as an attribute; empty without the key."""
    if "specular_trap" not in spec:
        return {}
    trap = spec["specular_trap"]
    if isinstance(trap, bool) or not isinstance(trap, int | float) or not 0 < trap <= 90 or geometry != "sce":
        found = repr(trap)[:40] if geometry == "sce" else f"{trap!r} with geometry {geometry}"[:60]
        raise _refusal(
            "invalid half angle of the gloss trap",
            found,
            "0 < degree <= 90, with geometry sce",
            "spectrum.specular_trap",
        )
    return {"specular_trap": float(trap)}


def _check_keys(spec: Mapping[str, Any]) -> bool:
    """Check the keys of a spectrum; return whether it is a file."""
    given = set(spec) if isinstance(spec, Mapping) else set()
    if ("file" in given) == ("lab" in given):
        raise _refusal("either `file` or `lab` is required", None, "file: … or lab: [L*, a*, b*]", "spectrum")
    known = ("file", *_FILE_KEYS, *_COMMON_KEYS) if "file" in given else ("lab", *_LAB_KEYS, *_COMMON_KEYS)
    for key in map(str, spec):
        if key not in known:
            nearest = difflib.get_close_matches(key, known, n=1)
            hint = f" (nearest is {nearest[0]})" if nearest else ""
            raise _refusal(f"unknown key{hint}", repr(key[:40]), ", ".join(known), "spectrum")
    for key, accepted in (("illuminant", "D65, A, …"), ("observer", "2 or 10")):
        if "lab" in given and key not in given:
            raise _refusal(f"the {key} of the colour is missing", None, accepted, f"spectrum.{key}")
    return "file" in given


def _geometry(spec: Mapping[str, Any]) -> str:
    geometry = spec.get("geometry")
    if geometry not in GEOMETRIES:
        raise _refusal(
            "specular reflection included or excluded: not stated",
            None if geometry is None else repr(geometry)[:40],
            "sci (included) or sce (excluded)",
            "spectrum.geometry",
        )
    return str(geometry)


def _incidence(spec: Mapping[str, Any]) -> float | None:
    if "incidence" not in spec:
        return None
    incidence = spec["incidence"]
    if isinstance(incidence, bool) or not isinstance(incidence, int | float) or not 0 <= incidence < 90:
        raise _refusal("invalid incidence angle", repr(incidence)[:40], "0 <= degree < 90", "spectrum.incidence")
    return float(incidence)


def _warn_if_excluded(dataset: xr.Dataset, file: str, index: float | xr.Dataset | None) -> xr.Dataset:
    """Warn if a reflectance with the specular included is below the specular reflectance alone."""
    n = _LOWEST_INDEX if index is None else index
    wavelength = dataset["wavelength"].values
    specular = specular_reflectance(n, dataset.attrs["theta_i"], wavelength)
    is_below = dataset["total_reflectance"].values < specular
    below = wavelength[is_below]
    if dataset.attrs["geometry"] != "sci" or below.size == 0:
        return dataset
    whose = f"a smooth surface of index {index_words(n)}" + (
        "" if index is not None else ", lower than any named plastic"
    )
    return vocabulary.add_warning(
        dataset,
        f"{file}: the reflectance is below {specular[is_below].max():.4f}, the specular reflectance of {whose}, at {below.size} wavelengths "
        f"from {below[0]:g} to {below[-1]:g} nm. If the specular was excluded, set `spectrum.geometry: sce`; otherwise correct the index.",
    )


def _refusal(problem: str, found: str | None, accepted: str, key: str) -> InputError:
    return InputError("material.yaml", problem, where="spectrum", found=found, accepted=accepted, key=key)
