"""A BSDF as a material of Mitsuba 3: the files of its plugin ``measured``, and the dictionary that loads them.

Light that is mirrored into a single direction is added as a conductor of the same Fresnel reflectance, in a blend of half and half: the values
of the file and the reflectance of the conductor are then twice those of the BSDF. The conductor in the blend has facets of slope 0.0035 (reflected rays spread by 0.4 degree), because
``blendbsdf`` of Mitsuba 3.8 weights a perfect mirror wrongly: it adds the probability of its direction to the density of the other material.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.one_side import one_side
from brdfpipe.bsdf.registry import representation
from brdfpipe.exchange import records, rgl
from brdfpipe.exchange.registry import FORMATS, GRID_OPTIONS
from brdfpipe.optics.fresnel_equations import fresnel

_ANGLES = np.array([0.0, 15.0, 30.0, 45.0, 60.0, 70.0, 80.0])
"""Incidences at which a mirror reflectance is compared with Fresnel's [degree]."""
_ALIKE = 0.01
"""Largest relative difference from Fresnel's reflectance, times a constant, of a mirror part that is written."""
_DARK = 1e-6
"""Reflectance below which a part of the light is left out."""
_HALF = 2.0
"""What both halves of a blend are multiplied by."""
_SMOOTH = 0.005
"""Roughness of a mirror within a blend: the least that single precision resolves to 1 %."""


def material(
    bsdf: xr.Dataset,
    folder: str | os.PathLike[str],
    name: str | None = None,
    *,
    spectral: bool = False,
    two_sided: bool = True,
    **grid: Any,
) -> dict[str, Any]:
    """Write the files of a BSDF for Mitsuba, and return what ``mitsuba.load_dict`` takes.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    folder : where the file is written, with a record of its error and of what it leaves out
    name : of the file, by default that of the material
    spectral : for the variants that render by wavelength, instead of those in colours
    two_sided : the material on both sides of a surface; otherwise the side that the normal points away from is black
    grid : options of the format ``rgl``: ``tolerance``, ``albedo_tolerance`` and ``largest``

    Returns
    -------
    The dictionary of a BSDF. Azimuth 0 is the direction of the first texture coordinate. The record ``<file>.json`` says what the file leaves out: light that passes, polarisation, and a mirror part that is not as
    Fresnel's reflectance times a constant to 1 %, which ``left_out["specular"]`` then states

    Raises
    ------
    ExchangeError : an option is unknown or out of range.
    """
    name = name or str(bsdf.attrs.get("material", "material"))
    mirror, seen = _mirror(bsdf), one_side(bsdf, "reflection")
    if mirror is not None and not _scatters(seen):
        return _sided(mirror, two_sided)
    suffix = f"{'.with_mirror' if mirror else ''}.{'spectral' if spectral else 'rgb'}.bsdf"
    path, scale = Path(folder) / f"{name}{suffix}", _HALF if mirror else 1.0
    format = FORMATS["rgl"]
    options = {**GRID_OPTIONS, **format.keywords(grid)}
    write = rgl.write_spectral if spectral else rgl.write
    record = write(seen, path, scale=scale, **options)
    # Of the whole BSDF, which may let light pass.
    record["left_out"] = records.left_out(bsdf, format, "spectrum" if spectral else "rgb")
    if mirror:
        record["left_out"].pop("specular", None)
        record["values_are"] = "twice the BRDF, for a blend of half of it and half of a mirror"
    format.write_record(path, record)
    scattering = {"type": "measured", "filename": str(path)}
    if mirror is None:
        return _sided(scattering, two_sided)
    doubled = {
        **mirror,
        "type": "roughconductor",
        "alpha": _SMOOTH,
        "distribution": "beckmann",
        "specular_reflectance": _uniform(_HALF * mirror["specular_reflectance"]["value"]),
    }
    return _sided({"type": "blendbsdf", "weight": 0.5, "scattering": scattering, "mirror": doubled}, two_sided)


def _sided(bsdf: dict[str, Any], two_sided: bool) -> dict[str, Any]:
    return {"type": "twosided", "bsdf": bsdf} if two_sided else bsdf


def _uniform(value: float) -> dict[str, Any]:
    """A number for all wavelengths; of a colour it may exceed 1."""
    return {"type": "uniform", "value": float(value)}


def _scatters(bsdf: xr.Dataset) -> bool:
    model = representation(nonspectral(bsdf))
    angles = np.array([0.0, 45.0]), np.zeros(2)
    return bool((model.albedo(*angles, None) - model.specular(*angles, None)[0]).max() > _DARK)


def _mirror(bsdf: xr.Dataset) -> dict[str, Any] | None:
    """A smooth conductor with the mirror reflectance of the BSDF; None if there is none, or none of this form."""
    plain = nonspectral(bsdf)
    share = representation(plain).specular(_ANGLES, np.zeros_like(_ANGLES), None)[0].mean(axis=-1)
    if share.max() <= _DARK or "n" not in plain:
        return None
    n, k = float(plain["n"].mean()), float(plain["k"].mean()) if "k" in plain else 0.0
    ratio = share / fresnel(np.cos(np.radians(_ANGLES)), n, k).mean
    if np.abs(ratio / ratio.mean() - 1).max() > _ALIKE:
        return None
    # Without absorption the equations of a conductor are those of a dielectric, and nothing passes: both sides may have it.
    return {
        "type": "conductor",
        "eta": _uniform(n),
        "k": _uniform(k),
        "specular_reflectance": _uniform(float(ratio.mean())),
    }
