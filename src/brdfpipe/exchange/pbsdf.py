"""Polarised BRDFs of KAIST's database, which Mitsuba's plugin ``measured_polarized`` renders (tensor file, ``.pbsdf``).

Mueller matrices of the BRDF [sr-1] on nodes of the half-angle coordinates φ_d, θ_d and θ_h, at five wavelengths. The Stokes parameters of both directions are those of the frame whose first axis is
across the plane of both directions, and whose third is the direction of travel.

References
----------
Baek et al. 2020 (ACM Trans. Graph. 39, 139); Mitsuba 3, plugin ``measured_polarized``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from brdfpipe.bsdf import table_nodes
from brdfpipe.bsdf.grids import GRIDS
from brdfpipe.bsdf.registry import representation
from brdfpipe.errors import InputError
from brdfpipe.exchange import cell_means, gridded, records, tensor_file
from brdfpipe.exchange.read_table import ReadTable
from brdfpipe.exchange.registry import ExchangeError, Format
from brdfpipe.geometry import Array, unit_vector

FORMAT = Format(
    description="Mueller matrices at five wavelengths, for Mitsuba's plugin `measured_polarized`; not for surfaces with a lay",
    files={"reflection": {"write": (".pbsdf",)}},
    refuses=("lay",),
    takes="cells",
    carries=("spectrum", "polarisation"),
    read="read",
)

WAVELENGTHS = np.array([450.0, 500.0, 550.0, 600.0, 650.0])
"""The plugin reads five [nm]."""
AXES = {
    "theta_h": np.arange(64.0) ** 2 * 89.0 / 63.0**2,
    "theta_d": np.linspace(0.0, 89.0, 31),
    "phi_d": np.linspace(-180.0, 180.0, 37),
}
"""Nodes [degree]; those of the half vector are dense at the normal, where lobes are."""
_HORIZON = 89.9
_ROUNDING = 1e-3
"""Angles of single precision in radian are rounded by less [degree]."""


def write(bsdf: xr.Dataset, path: Path) -> records.Record:
    """Write the reflecting side. The stated error is that of the intensity of unpolarised light, interpolated linearly as the plugin does it.

    Nodes of which a direction is below the horizon hold the matrix at the horizon.

    Raises ExchangeError: the surface has a lay, or the BSDF has no Mueller matrices of all directions.
    """
    model = representation(bsdf)
    if not model.isotropic:
        raise ExchangeError(
            f"{path.name}: the surface has a lay, and the azimuths of a .pbsdf file are relative to each other"
        )
    values = _matrices(bsdf)
    if not np.isfinite(values).all():
        raise ExchangeError(f"{path.name}: the BSDF has no Mueller matrices in some directions")
    intensity = cell_means.node_values(gridded.photopic(bsdf), "half", AXES)
    around = {**AXES, "phi_d": AXES["phi_d"] + 180}
    # A table turns from 0; the first node of the file is half a turn before.
    turned = np.concatenate([intensity[:, :, 18:], intensity[:, :, 1:19]], axis=2)
    error = cell_means.table_error(bsdf, table_nodes.interpolation(around, turned))
    table = cell_means.CellTable(bsdf, values.reshape(-1, WAVELENGTHS.size, 16)[..., 0], error, "interpolated linearly")
    record = records.record(table, FORMAT)
    if "wavelength" in bsdf.coords:
        record["left_out"]["spectrum"] = "the spectrum beyond 450 to 650 nm, and between five wavelengths 50 nm apart"
    fields = {name: np.radians(AXES[name])[None].astype(np.float32) for name in AXES}
    fields |= {"wvls": WAVELENGTHS.astype(np.uint16), "M": values.astype(np.float32)}
    description = records.comment(bsdf).encode("ascii", "replace")
    tensor_file.write(path, {"description": np.frombuffer(description, dtype=np.uint8), **fields})
    return record


def _matrices(bsdf: xr.Dataset) -> Array:
    """Mueller matrices in the frames of the file, (φ_d, θ_d, θ_h, wavelength, 4, 4) [sr-1]."""
    model, names = representation(bsdf), ("phi_d", "theta_d", "theta_h")
    wavelength = WAVELENGTHS if "wavelength" in bsdf.coords else None
    values = np.empty((*(AXES[name].size for name in names), WAVELENGTHS.size, 4, 4))
    for row in range(values.shape[0]):
        axes = {**AXES, "phi_d": AXES["phi_d"][[row]]}
        nodes = dict(
            zip(
                names,
                (grid.ravel() for grid in np.meshgrid(*(axes[name] for name in names), indexing="ij")),
                strict=True,
            )
        )
        theta_i, phi_i, theta_o, phi_o = GRIDS["half"].directions(nodes)
        theta_i, theta_o = np.minimum(theta_i, _HORIZON), np.minimum(theta_o, _HORIZON)
        own = model.mueller(theta_i, phi_i, theta_o, phi_o, wavelength)
        incident, outgoing = _across_turns(nodes, theta_i, phi_i, theta_o, phi_o)
        turned = rotator(outgoing)[:, None] @ own @ rotator(-incident)[:, None]
        values[row] = turned.reshape(*values.shape[1:3], -1, 4, 4)
    return values


def _across_turns(
    nodes: dict[str, Array], theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array
) -> tuple[Array, Array]:
    """Angles from the s direction of each ray to the normal of the plane of both, about the direction of travel [radian]."""
    theta_h, phi_d = nodes["theta_h"], np.radians(nodes["phi_d"])[:, None]
    half = unit_vector(theta_h, np.zeros_like(theta_h))
    away = unit_vector(theta_h + 90, np.zeros_like(theta_h))
    across = np.cross(half, np.cos(phi_d) * away + np.sin(phi_d) * np.array([0.0, 1.0, 0.0]))
    return turn_of(across, -unit_vector(theta_i, phi_i), phi_i + 180), turn_of(
        across, unit_vector(theta_o, phi_o), phi_o
    )


def turn_of(axis: Array, travel: Array, azimuth: Array) -> Array:
    """Angle about the direction of travel (n, 3) from s = k × z, of the azimuth [degree] of travel, to an axis (n, 3) [radian]."""
    phi = np.radians(azimuth)
    s = np.stack([np.sin(phi), -np.cos(phi), np.zeros_like(phi)], axis=-1)
    p = np.cross(travel, s)
    return np.asarray(np.arctan2((axis * p).sum(axis=-1), (axis * s).sum(axis=-1)))


def rotator(angle: Array) -> Array:
    """Matrices that give Stokes parameters in a frame turned by the angle [radian] about the direction of travel, (…, 4, 4)."""
    cosine, sine = np.cos(2 * angle), np.sin(2 * angle)
    matrix = np.zeros((*np.shape(angle), 4, 4))
    matrix[..., 0, 0] = matrix[..., 3, 3] = 1.0
    matrix[..., 1, 1] = matrix[..., 2, 2] = cosine
    matrix[..., 1, 2], matrix[..., 2, 1] = sine, -sine
    return matrix


def read(path: Path) -> ReadTable:
    """Read the BRDF of unpolarised light, the first element of each Mueller matrix, by wavelength.

    Raises InputError: the file is not of this kind, or its fields contradict each other.
    """
    fields = tensor_file.read(path)
    names = ("phi_d", "theta_d", "theta_h")
    if missing := [name for name in (*names, "wvls", "M") if name not in fields]:
        found = ", ".join(sorted(fields))[:80]
        raise InputError(path, "the file lacks fields", found=found, accepted=", ".join(missing))
    axes = {name: np.round(np.degrees(fields[name].ravel().astype(float)), 4) for name in names}
    wavelength = fields["wvls"].ravel().astype(float)
    shape = (*(axes[name].size for name in names), wavelength.size, 4, 4)
    if fields["M"].shape != shape:
        raise InputError(
            path,
            "the matrices M do not fit the angles and wavelengths",
            found=f"shape {fields['M'].shape}",
            accepted=f"{shape}",
        )
    if not ((np.diff(wavelength) > 0).all() and wavelength.size and np.isfinite(wavelength).all()):
        raise InputError(path, "the wavelengths do not increase", found=str(wavelength)[:60])
    around = axes["phi_d"]
    if around.size < 3 or not (np.diff(around) > 0).all() or abs(around[-1] - around[0] - 360) > _ROUNDING:
        raise InputError(path, "the azimuths phi_d are not a circle", found=f"{around[:1]} to {around[-1:]}")
    first = int(np.argmin(np.abs(around)))
    if abs(around[first]) > _ROUNDING:
        raise InputError(path, "no azimuth phi_d is 0", found=f"{around[first]:g} degree as the nearest")
    intensity = np.moveaxis(fields["M"][..., 0, 0], (0, 1, 2), (2, 1, 0)).astype(float)
    turned = np.concatenate([intensity[:, :, first:], intensity[:, :, 1 : first + 1]], axis=2)
    circle = np.concatenate([around[first:], around[1 : first + 1] + 360])
    circle[0], circle[-1] = 0.0, 360.0
    read_axes = {"theta_h": axes["theta_h"], "theta_d": axes["theta_d"], "phi_d": circle}
    note = "the BRDF of unpolarised light alone was read; the other elements of the Mueller matrices were not"
    return ReadTable("half", read_axes, turned, "spectral", wavelength, notes=(note,))
