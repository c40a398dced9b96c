"""ASTM E1392, the comma-separated dialect that BSDF viewers read (``.astm``).

The file has header lines ``KEY value``, a line ``VARS`` with the column names, and one row for each pair of directions: angles in
radian, BRDF in sr⁻¹. Readers do not mirror a half circle: the table must cover φ from 0 to 360° inclusive. They expect a full
grid: every azimuth of incidence needs the same azimuths φ_s. They search the whole header for ``NUM_POINTS`` and ``VARS``: no value
may be one of these words. Viewers ask the user whether a file is a BRDF or a BTDF, and count θ_s from the normal of the side where
the light leaves: the two sides are two files.
"""

from __future__ import annotations

import io
import os
from pathlib import Path

import numpy as np
import xarray as xr

from brdfpipe import store, vocabulary
from brdfpipe.bsdf.change_variables import NOT_STATED
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.representations.table import Table
from brdfpipe.bsdf.source_changes import SourceChanges, in_quadrature, uncertain
from brdfpipe.bsdf.tabulation import relative_loss
from brdfpipe.exchange import sidecar_tables
from brdfpipe.exchange.registry import ExchangeError, Format
from brdfpipe.geometry import Array

FORMAT = Format(
    description="the BSDF table as ASTM E1392, and the total reflectance or transmittance beside it",
    files={
        "reflection": {"write": (".astm",), "write_total_reflectance": (".total_reflectance.csv",)},
        "transmission": {
            "write_transmission": (".transmission.astm",),
            "write_total_transmittance": (".total_transmittance.csv",),
        },
    },
    takes="table",
    carries=("transmission", "lay"),
)

_KEYWORDS = ("NUM_POINTS", "VARS")
_STATED_AT = np.array([20.0, 45.0, 60.0])
"""Incidences at which the header states the uncertainty [degree]."""


def write(bsdf: xr.Dataset, path: str | os.PathLike[str], *, table: xr.Dataset | None = None) -> None:
    """Write the reflecting side of a non-spectral table.

    Parameters
    ----------
    bsdf : kind ``bsdf``: the model that the table was made from, or the table itself
    path : the file; it appears whole or not at all
    table : kind ``bsdf``, representation ``table`` on a uniform grid, without wavelength; phi_o from 0 to 360. A table with
        ``phi_i`` needs the model: light from each azimuth is evaluated at the φ_s of all azimuths. With a model the header states
        the perfectly specular share, which no row can hold

    Raises
    ------
    ExchangeError : the table is spectral, does not cover the full circle, or has ``phi_i`` and there is no model.
    """
    table, model = (bsdf, None) if table is None else (table, bsdf)
    reduced = _checked(table, model)
    rows = _rows(table, reduced, through=False)
    lost = float(relative_loss(table).max())
    notes = [
        "BRDF in sr-1 (not multiplied by cos theta_s), weighted with V(lambda) and D65",
        "angles in radian from the normal; mirror direction at phi_s = phi_i + pi",
        f"the reflectance of this grid differs from the model's by up to {lost:.2%}",
        *_specular_note(table, reduced, through=False),
        *_uncertainty_note(reduced),
        *_uncertainty_of_rows(table, through=False),
    ]
    store.write_text(path, _file(table, Path(path).name, notes, rows))


def write_transmission(bsdf: xr.Dataset, path: str | os.PathLike[str], *, table: xr.Dataset | None = None) -> None:
    """Write the transmitting side of a non-spectral table; as :func:`write`.

    Raises ExchangeError: as :func:`write`, and where the table has no polar angles beyond 90 degree.
    """
    table, model = (bsdf, None) if table is None else (table, bsdf)
    reduced = _checked(table, model)
    if not (table["theta_o"].values > 90).any():
        raise ExchangeError("the table holds reflection alone; tabulate with `theta_o` beyond 90 degree")
    rows = _rows(table, reduced, through=True)
    notes = [
        "BTDF in sr-1 (not multiplied by cos theta_s), weighted with V(lambda) and D65",
        "angles in radian: theta_i from the normal of the front, theta_s from the normal of the other side, where the light leaves; "
        "undeviated light at theta_s = theta_i and phi_s = phi_i + pi",
        *_specular_note(table, reduced, through=True),
        *_uncertainty_of_rows(table, through=True),
    ]
    store.write_text(path, _file(table, Path(path).name, notes, rows))


def write_total_reflectance(bsdf: xr.Dataset, path: str | os.PathLike[str], *, table: xr.Dataset | None = None) -> None:
    """Write the spectrum that completes the non-spectral table to the "ASTM form" of the patent US 9,395,299."""
    sidecar_tables.write_total_reflectance(bsdf, path)


def write_total_transmittance(
    bsdf: xr.Dataset, path: str | os.PathLike[str], *, table: xr.Dataset | None = None
) -> None:
    """Write the spectrum that completes the table of the transmitting side."""
    sidecar_tables.write_total_transmittance(bsdf, path)


def _checked(table: xr.Dataset, model: xr.Dataset | None) -> xr.Dataset | None:
    """Refuse a table that the format cannot hold; return the model without wavelengths, weighted like the table."""
    vocabulary.validate(table, "bsdf")
    if not isinstance(representation(table), Table) or "wavelength" in table["brdf"].dims:
        raise ExchangeError("the ASTM file takes a non-spectral table; tabulate `bsdf.nonspectral()` first")
    if not {"theta_i", "theta_o", "phi_o"} <= set(table["brdf"].dims):
        raise ExchangeError("the ASTM file takes a table on a uniform grid: theta_i, theta_o, phi_o")
    phi = table["phi_o"].values
    if phi[-1] - phi[0] != 360 or phi[0] != 0:
        raise ExchangeError(f"the ASTM file needs phi_o from 0 to 360; the table covers {phi[0]:g} to {phi[-1]:g}")
    if "phi_i" in table["brdf"].dims and model is None:
        raise ExchangeError(
            "the table has azimuths of incidence; give the BSDF it was made from, and the table as `table`"
        )
    return None if model is None else nonspectral(model)


def _rows(table: xr.Dataset, model: xr.Dataset | None, through: bool) -> Array:
    """θ_i, φ_i, θ_s, φ_s [radian] and BSDF of one side, a row each; θ_s from the normal of that side."""
    theta_i = table["theta_i"].values[table["theta_i"].values < 90]
    polar = table["theta_o"].values
    polar = polar[polar > 90] if through else polar[polar <= 90]
    if "phi_i" not in table["brdf"].dims:
        phi_i, phi_s = np.zeros(1), table["phi_o"].values
        brdf = table["brdf"].transpose("theta_i", "theta_o", "phi_o").sel(theta_i=theta_i, theta_o=polar).values
    else:
        assert model is not None
        phi_i, phi_s = _azimuths(table)
    nodes = np.meshgrid(theta_i, phi_i, polar, phi_s, indexing="ij")
    incidence, azimuth, outgoing, around = (angles.ravel() for angles in nodes)
    if "phi_i" in table["brdf"].dims and model is not None:
        evaluate = representation(model).evaluate
        brdf = evaluate(incidence, azimuth, outgoing, around, None)[..., 0]
    outgoing = 180 - outgoing if through else outgoing
    rows = np.column_stack([*map(np.radians, (incidence, azimuth, outgoing, around)), brdf.ravel()])
    # Readers expect rising angles.
    return rows[np.lexsort(rows[:, 3::-1].T)] if through else rows


def _azimuths(table: xr.Dataset) -> tuple[Array, Array]:
    """Azimuths of incidence within one turn, and the azimuths φ_s that the table has about any of them."""
    phi_i = np.unique(np.round(table["phi_i"].values % 360, 6))
    around = np.unique(np.round((phi_i[:, None] + table["phi_o"].values) % 360, 6))
    return phi_i, np.union1d(around, [0.0, 360.0])


def _specular_note(table: xr.Dataset, model: xr.Dataset | None, through: bool) -> list[str]:
    """The share of light in a single direction; it has no density, so no row can hold it."""
    if model is None:
        return []
    theta_i = table["theta_i"].values[table["theta_i"].values < 90]
    share = representation(model).specular(theta_i, np.zeros_like(theta_i), None)[int(through)][:, 0]
    if not share.any():
        return []
    listed = " ".join(f"{angle:g}:{value:.6f}" for angle, value in zip(theta_i, share, strict=True))
    path = "transmitted undeviated" if through else "mirrored"
    return [
        f"NOT in these rows, because light in a single direction has no density: the share {path}, by theta_i in degree: {listed}"
    ]


def _uncertainty_note(model: xr.Dataset | None) -> list[str]:
    """Relative standard uncertainty of the BRDF in the mirror direction; none where no input has a known one."""
    if model is None or not uncertain(model):
        return []
    changes, theta = SourceChanges.of(model), _STATED_AT
    mirror = theta, np.zeros_like(theta), theta, np.full_like(theta, 180.0), None
    brdf = changes.given.evaluate(*mirror)[:, 0]
    u = in_quadrature(changes.by_source(changes.of_brdf(*mirror)[..., 0]))
    relative = np.divide(u, brdf, out=np.zeros_like(u), where=brdf > 0)
    listed = " ".join(f"{angle:g}:{value:.4f}" for angle, value in zip(theta, relative, strict=True))
    sources = " and ".join(dict.fromkeys(changes.sources))
    missing = str(model.attrs.get(NOT_STATED, ""))
    unknown = f"; not known, and none assumed: {missing}" if missing else ""
    return [
        f"relative standard uncertainty in the mirror direction, by theta_i in degree: {listed} (from {sources}{unknown})"
    ]


def _uncertainty_of_rows(table: xr.Dataset, through: bool) -> list[str]:
    """Relative standard uncertainty of the values of the table; a further column would be read as another BSDF."""
    if "brdf_u" not in table:
        return []
    side = table.sel(theta_o=table["theta_o"].values[(table["theta_o"].values > 90) == through])
    brdf, u = side["brdf"].values, side["brdf_u"].values
    known = (brdf > 0) & np.isfinite(u)
    if not known.any():
        return []
    low, middle, high = np.quantile(u[known] / brdf[known], [0.05, 0.5, 0.95])
    return [
        f"relative standard uncertainty of the rows: median {middle:.4f}, nine tenths of them {low:.4f} to {high:.4f}; row by row in `brdf_u` "
        "of the table's dataset"
    ]


def _file(table: xr.Dataset, file: str, notes: list[str], rows: Array) -> str:
    material = str(table.attrs.get("material", "unnamed"))
    phi_i = np.degrees(np.unique(rows[:, 1]))
    lay = (
        "isotropic"
        if "phi_i" not in table["brdf"].dims
        else f"NOT isotropic: the surface has a lay; phi_i of {', '.join(f'{angle:g}' for angle in phi_i)} degree"
    )
    lines = {
        "LAB_NAME": "brdfpipe",
        "SYSTEM_NAME": f"computed from {table.attrs.get('source_representation', 'a table')}",
        "APERTURE": "0",
        "SAMPLE_NAME": f"{material}_" if material in _KEYWORDS else material,
        "MEAS_NAME": "; ".join([*notes, lay, f"digest of the table {table.attrs.get('digest', 'unknown')}"]),
        "FILE_NAME": file,
        "MEAS_DATE": "unknown",
        "MEAS_TIME": "unknown",
        "NUM_POINTS": str(len(rows)),
        "VARS": "theta_i,phi_i,theta_s,phi_s,Integrated",
    }
    body = io.StringIO()
    np.savetxt(body, rows, fmt="%.9g", delimiter=",")
    return "".join(f"{key} {value}\n" for key, value in lines.items()) + body.getvalue()
