"""Shares of light that is mirrored, or passes, into a single direction, as text of Integra's Lumicept and Inspirer (``.sdr``, ``.sdt``).

Such light has no density, so the tables of scattered light do not hold it.

References
----------
libbsdf (2026), ``SdrReader`` and ``SdrWriter``.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import store
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.one_side import Side
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import InputError
from brdfpipe.exchange import records
from brdfpipe.exchange.text_lines import Lines
from brdfpipe.geometry import Array

INCIDENCES = np.append(np.arange(0.0, 89.5), 89.9)
"""Angles of incidence at which shares are given [degree]; between 89.9 and 90 they change by what rounding would."""

SUFFIXES = {".ddr": ".sdr", ".ddt": ".sdt"}
"""Of a table of scattered light → of the shares beside it."""

_STATED_AT = (0.0, 45.0, 75.0)
_MOST_ANGLES, _MOST_CHANNELS = 4000, 2000
_RGB = ("red", "gre", "blu")
_AZIMUTHS = np.arange(0.0, 360.0, 15.0)


def shares(bsdf: xr.Dataset, side: Side) -> Array:
    """Share of the light of each of :data:`INCIDENCES` in a single direction, weighted with V(λ) and D65 [1]; the mean over azimuth."""
    model = representation(nonspectral(bsdf))
    turns = np.zeros(1) if model.isotropic else _AZIMUTHS
    theta_i, phi_i = np.meshgrid(INCIDENCES, turns, indexing="ij")
    return np.asarray(model.specular(theta_i, phi_i, None)[side == "transmission"][..., 0].mean(axis=1))


def write(bsdf: xr.Dataset, path: Path, side: Side) -> None:
    """Write the shares of one side; 0 where no light has a single direction."""
    what = "mirrored" if side == "reflection" else "that passes a sheet undeviated"
    angles = " ".join(f"{angle:g}" for angle in INCIDENCES)
    values = " ".join(f"{share:.6g}" for share in shares(bsdf, side))
    text = (
        f";; {records.comment(bsdf)}\n;; share of the light {what}, weighted with V(lambda) and D65; scattered light is in the file beside\n"
        f"Source Generated\nTypeColorModel BW\nsigma {INCIDENCES.size}\n{angles}\nbw\ndef\n{values}\nenddef\n"
    )
    store.write_text(path, text.encode("ascii", "replace").decode())


class Shares(NamedTuple):
    """Shares of light in single directions that were read."""

    theta_i: Array
    """Increasing angles of incidence [degree]"""
    values: Array
    """(theta_i, channels) [1]"""
    wavelength: Array | None
    """(channels,) nm, of spectral shares"""


def read(path: Path) -> Shares:
    """Read the shares of one side.

    Raises InputError: the file contradicts itself, is not of this format, or a share is below 0 or above 1.
    """
    lines = Lines(path, ";")
    model, theta_i, line = "bw", np.zeros(0), ""
    while True:
        line = lines.next("a line of the header or of a channel")
        key, _, rest = " ".join(line.lower().split()).partition(" ")
        if key == "typecolormodel":
            model = rest
        elif key == "sigma":
            count, _, begun = rest.partition(" ")
            theta_i = lines.gathered(lines.count(count, _MOST_ANGLES), "sigma", begun)
        elif key != "source":
            break
    if not theta_i.size:
        raise lines.error("the header has no sigma", found=repr(line)[:40], accepted="sigma and its angles")
    if not ((np.diff(theta_i) > 0).all() and theta_i[0] >= 0 and theta_i[-1] <= 90):
        found = f"{theta_i[0]:g} to {theta_i[-1]:g}"
        raise InputError(path, "the angles sigma do not increase from 0 to 90", found=found, accepted="degree")
    content, _, number = model.partition(" ")
    if content not in ("bw", "rgb", "spectral"):
        raise InputError(path, "unknown TypeColorModel", found=repr(model)[:40], accepted="BW, RGB, spectral")
    channels = lines.count(number, _MOST_CHANNELS) if content == "spectral" else {"bw": 1, "rgb": 3}[content]
    values, wavelength = np.empty((theta_i.size, channels)), np.full(channels, np.nan)
    for channel in range(channels):
        name, _, rest = (line if channel == 0 else lines.next("the next channel")).lower().partition(" ")
        wanted = {"bw": "bw", "rgb": _RGB[channel % 3], "spectral": "wl"}[content]
        if name[:3] != wanted:
            raise lines.error("unexpected channel", found=repr(name)[:40], accepted=wanted)
        wavelength[channel] = lines.number(rest) if content == "spectral" else np.nan
        lines.expect("def")
        values[:, channel] = lines.gathered(theta_i.size, "shares")
        lines.expect("enddef")
    if content == "spectral" and not (wavelength[0] > 0 and (np.diff(wavelength) > 0).all()):
        raise InputError(path, "the wavelengths do not increase", found=f"{wavelength[0]:g} nm first", accepted="nm")
    if not ((values >= 0) & (values <= 1)).all():
        found = f"{values.min():g} to {values.max():g}"
        raise InputError(path, "a share of light is out of range", found=found, accepted="0 to 1")
    return Shares(theta_i, values, wavelength if content == "spectral" else None)


def stated_beside(table: Path) -> tuple[str, ...]:
    """A warning with the shares of the file beside a table of scattered light; none where there is no file, or where no light has a single direction.

    Raises InputError: that file cannot be read.
    """
    path = table.with_suffix(SUFFIXES.get(table.suffix.lower(), ""))
    if path == table or not path.is_file():
        return ()
    found = read(path)
    mean = found.values.mean(axis=1)
    if mean.max() <= records.NEGLIGIBLE_SHARE:
        return ()
    listed = ", ".join(f"{np.interp(angle, found.theta_i, mean):.4f} at {angle:g}°" for angle in _STATED_AT)
    return (
        f"{path.name} beside the table sends light into a single direction, a share of {listed}: no table holds it, so gloss and the "
        "total reflectance lack it; of a smooth face use `surface: {distribution: flat}` and the index",
    )
