"""Shares of light that is mirrored, or passes, into a single direction, as text of Integra's Lumicept and Inspirer (``.sdr``, ``.sdt``).

Such light has no density, so the tables of scattered light do not hold it.

References
----------
libbsdf (2026), ``SdrReader`` and ``SdrWriter``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from brdfpipe import store
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.one_side import Side
from brdfpipe.bsdf.registry import representation
from brdfpipe.exchange import records
from brdfpipe.geometry import Array

INCIDENCES = np.append(np.arange(0.0, 89.5), 89.9)
"""Angles of incidence at which shares are given [degree]; between 89.9 and 90 they change by what rounding would."""

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
