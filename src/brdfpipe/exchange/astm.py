"""ASTM E1392, the comma-separated dialect that BSDF viewers read (``.astm``).

Header lines ``KEY value``, then ``VARS`` with the column names, then one row a pair of directions: angles in radian, BRDF in
sr⁻¹. Readers do not mirror a half circle, so the table must cover φ from 0 to 360° inclusive; they look for the words
``NUM_POINTS`` and ``VARS`` anywhere in the header, so no value may be one of them.
"""

from __future__ import annotations

import io
import os
from pathlib import Path

import numpy as np
import xarray as xr

from brdfpipe import store, vocabulary
from brdfpipe.bsdf.tabulation import relative_loss
from brdfpipe.errors import BrdfpipeError

_KEYWORDS = ("NUM_POINTS", "VARS")


class ExchangeError(BrdfpipeError):
    """A BSDF cannot be written in this format."""


def write(table: xr.Dataset, path: str | os.PathLike[str]) -> None:
    """Write a table of an isotropic, non-spectral BRDF.

    Parameters
    ----------
    table : kind ``bsdf``, representation ``table``, without wavelength; phi_o from 0 to 360
    path : the file; it appears whole or not at all

    Raises
    ------
    ExchangeError : the table is spectral, or does not cover the full circle.
    """
    vocabulary.validate(table, "bsdf")
    if table.attrs["representation"] != "table" or "wavelength" in table["brdf"].dims:
        raise ExchangeError("the ASTM file takes a non-spectral table; tabulate `bsdf.nonspectral()` first")
    phi = table["phi_o"].values
    if phi[0] != 0 or phi[-1] != 360:
        raise ExchangeError(f"the ASTM file needs phi_o from 0 to 360; the table covers {phi[0]:g} to {phi[-1]:g}")
    axes = [np.radians(table[name].values) for name in ("theta_i", "theta_o", "phi_o")]
    theta_i, theta_s, phi_s = (grid.ravel() for grid in np.meshgrid(*axes, indexing="ij"))
    brdf = table["brdf"].transpose("theta_i", "theta_o", "phi_o").values.ravel()
    rows = np.column_stack([theta_i, np.zeros_like(theta_i), theta_s, phi_s, brdf])
    body = io.StringIO()
    np.savetxt(body, rows, fmt="%.9g", delimiter=",")
    store.write_text(path, _header(table, Path(path).name, brdf.size) + body.getvalue())


def _header(table: xr.Dataset, file: str, points: int) -> str:
    material = str(table.attrs.get("material", "unnamed"))
    lost = float(relative_loss(table).max())
    convention = (
        "BRDF in sr-1 (not multiplied by cos theta_s), weighted with V(lambda) and D65; angles in radian from the normal; "
        f"mirror direction at phi_s = phi_i + pi; isotropic; digest of the model {table.attrs.get('digest', 'unknown')}; "
        f"the reflectance of this grid differs from the model's by up to {lost:.2%}"
    )
    lines = {
        "LAB_NAME": "brdfpipe",
        "SYSTEM_NAME": f"computed from {table.attrs.get('source_representation', 'a table')}",
        "APERTURE": "0",
        "SAMPLE_NAME": f"{material}_" if material in _KEYWORDS else material,
        "MEAS_NAME": convention,
        "FILE_NAME": file,
        "MEAS_DATE": "unknown",
        "MEAS_TIME": "unknown",
        "NUM_POINTS": str(points),
        "VARS": "theta_i,phi_i,theta_s,phi_s,Integrated",
    }
    return "".join(f"{key} {value}\n" for key, value in lines.items())
