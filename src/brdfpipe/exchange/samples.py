"""Samples of a BSDF as comma-separated values (``.samples.csv``), a row for each pair of directions, and wavelength.

The first line names the columns and their units. Directions of scatter need no grid: half of those that are written lie where the light goes. In reading, samples on a grid about the normal become
that grid; others are interpolated within their incidence, by triangles about the mirror direction, onto a grid there.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import store, vocabulary
from brdfpipe.bsdf.grids import specular_angles
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.sampling import Distribution
from brdfpipe.bsdf.source_changes import SourceChanges, uncertain
from brdfpipe.bsdf.table_error import error_of, fresh_pairs
from brdfpipe.errors import InputError
from brdfpipe.exchange import cell_means, gridded, records
from brdfpipe.exchange.direction_rows import Rows, gridded_rows
from brdfpipe.exchange.read_table import ReadTable, as_bsdf
from brdfpipe.exchange.registry import ExchangeError, Format
from brdfpipe.exchange.text_lines import LARGEST_FILE
from brdfpipe.geometry import Array

FORMAT = Format(
    description="samples in any directions as comma-separated values, with their uncertainty",
    files={"reflection": {"write": (".samples.csv",)}},
    takes="cells",
    carries=("lay", "spectrum", "uncertainty"),
    options={"spectral": False, "incidences": 18, "views": 600},
    spectral={"spectral": True},
    read="read",
    begins=("\ntheta_i_deg",),
)

_ANGLES = ["theta_i_deg", "phi_i_deg", "theta_o_deg", "phi_o_deg"]
_WAVELENGTH, _VALUE, _U = "wavelength_nm", "bsdf_per_sr", "bsdf_u_per_sr"
_AZIMUTHS_WITH_LAY, _HORIZON, _AROUND = 24, 89.5, 36
_SHARED_TURN = 30.0
"""Azimuths of incidence within which the distribution of the first one, turned with it, places the samples [degree]: a distribution takes longer than all else."""
_FEWEST_VIEWS, _MOST_INCIDENCES, _MOST_ROWS = 8, 4000, 20_000_000
_GRID_SHARE = 0.5
"""Of a grid that has samples; with fewer they are scattered."""
_POLAR_NODES, _STEP = 48, 10.0
_FLAT = 1e-3
"""Share of its length that the samples of an incidence are wide, below which they have no triangles."""


def write(
    bsdf: xr.Dataset, path: Path, *, spectral: bool = False, incidences: int = 18, views: int = 600
) -> records.Record:
    """Write the reflecting side.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    path : the file; it appears whole or not at all
    spectral : a row for each wavelength of the BSDF instead of one weighted with V(λ) and D65
    incidences : angles of incidence, 3 to 90; with a lay at 24 azimuths each
    views : directions of scatter of each incidence, 50 to 20 000

    Raises
    ------
    ExchangeError : an option is out of range.
    """
    for name, given, low, high in (("incidences", incidences, 3, 90), ("views", views, 50, 20_000)):
        if not low <= given <= high:
            raise ExchangeError(f"{name} is {given!r}; accepted: {low} to {high}")
    seen = gridded.side_of(bsdf, "reflection", path)
    reduced = nonspectral(seen)
    at = _directions(reduced, incidences, views)
    values = np.maximum(representation(reduced).evaluate(*at, None), 0.0)
    table = as_bsdf(_scattered(Rows(*at, values), None, path), path)
    error = error_of(reduced, representation(table).evaluate, fresh_pairs(reduced, 2))
    source = reduced
    if spectral and "wavelength" in seen.coords:
        source, values = seen, np.maximum(representation(seen).evaluate(*at, None), 0.0)
    u = _uncertainty(source, at)
    reading = "interpolated by triangles between the samples of an incidence"
    record = records.record(
        cell_means.CellTable(bsdf, values, error, reading, "luminous" if source is reduced else "spectrum"),
        FORMAT,
        bsdf,
    )
    if u is None and uncertain(bsdf):
        record["left_out"]["uncertainty"] = "standard uncertainties"
    columns: dict[str, Array] = {
        name: np.repeat(angle, values.shape[1]) for name, angle in zip(_ANGLES, at, strict=True)
    }
    if source is not reduced:
        columns[_WAVELENGTH] = np.tile(seen["wavelength"].values, values.shape[0])
    columns[_VALUE] = values.ravel()
    if u is not None:
        columns[_U] = np.broadcast_to(u, values.shape).ravel()
    with store.atomic_path(path) as temporary:
        pd.DataFrame(columns).to_csv(temporary, index=False, float_format="%.6g", lineterminator="\n")
    return record


def _directions(bsdf: xr.Dataset, incidences: int, views: int) -> tuple[Array, Array, Array, Array]:
    """θ_i, φ_i, θ_o and φ_o of the samples: of each incidence half drawn where the light goes, half even, the mirror direction, and the horizon."""
    model, generator = representation(bsdf), np.random.default_rng(7)
    azimuths = np.zeros(1) if model.isotropic else np.arange(0.0, 360.0, 360 / _AZIMUTHS_WITH_LAY)
    ring = np.arange(0.0, 360.0, 360 / _AROUND)
    found: list[NDArray[np.float64]] = []
    distributions: dict[int, Distribution] = {}
    for phi_i in azimuths:
        for number, theta_i in enumerate(np.linspace(0.0, 85.0, incidences)):
            turn = phi_i - phi_i // _SHARED_TURN * _SHARED_TURN
            if turn == 0:
                distributions[number] = model.distribution(float(theta_i), float(phi_i), None)
            drawn = distributions[number].draw(views // 2, generator)
            kept = ~drawn.is_specular & (drawn.theta < _HORIZON)
            polar, around = generator.random((2, views - views // 2))
            theta_o = np.concatenate(
                [drawn.theta[kept], np.degrees(np.arcsin(np.sqrt(polar))), [theta_i], np.full(ring.size, _HORIZON)]
            )
            phi_o = np.concatenate([drawn.phi[kept] + turn, 360 * around, [phi_i + 180], ring]) % 360
            theta_o = np.minimum(theta_o, _HORIZON)
            found.append(np.stack([np.full_like(theta_o, theta_i), np.full_like(theta_o, phi_i), theta_o, phi_o]))
    theta_i, phi_i, theta_o, phi_o = np.round(np.concatenate(found, axis=1), 3)
    return theta_i, phi_i, theta_o, phi_o


def _uncertainty(bsdf: xr.Dataset, at: tuple[Array, Array, Array, Array]) -> Array | None:
    """Standard uncertainty of each sample (n, wavelength) [sr-1]; None where it is not known."""
    if uncertain(bsdf):
        return np.sqrt(SourceChanges.of(bsdf).variance(*at, None))
    model = representation(bsdf)
    return np.asarray(model.uncertainty(*at, None)) if model.states_uncertainty else None


def read(path: Path) -> ReadTable:
    """Read samples of reflected light, with their uncertainties where the file has them.

    Raises InputError: a column is missing or unknown, a row is wrong, or an incidence has too few samples.
    """
    frame = _frame(path)
    wavelength = np.unique(frame[_WAVELENGTH]) if _WAVELENGTH in frame else np.zeros(1)
    if not (wavelength >= 0).all() or (wavelength.size > 1 and wavelength[0] <= 0):
        raise InputError(path, "a wavelength is out of range", found=f"{wavelength[0]:g}", accepted="above 0 nm")
    if wavelength.size > 4000:
        raise InputError(path, "too many wavelengths", found=wavelength.size, accepted="at most 4000")
    # A row for each direction, a column for each wavelength.
    angles, row = np.unique(frame[_ANGLES].to_numpy(), axis=0, return_inverse=True)
    columns = (
        np.searchsorted(wavelength, frame[_WAVELENGTH]) if _WAVELENGTH in frame else np.zeros(len(frame), dtype=int)
    )
    fields = [name for name in (_VALUE, _U) if name in frame]
    values = np.full((angles.shape[0], len(fields) * wavelength.size), np.nan)
    for number, name in enumerate(fields):
        values[row.ravel(), number * wavelength.size + columns] = frame[name]
    if np.isnan(values).any():
        at = " ".join(f"{angle:g}" for angle in angles[np.isnan(values).any(axis=1)][0])
        raise InputError(path, "a direction lacks some of the wavelengths", found=at, accepted="all of them")
    theta_i, phi_i, theta_o, phi_o = angles.T
    return _scattered(
        Rows(theta_i, phi_i, theta_o, phi_o, values), wavelength if wavelength.size > 1 else None, path, _U in frame
    )


def _frame(path: Path) -> pd.DataFrame:
    if path.stat().st_size > LARGEST_FILE:
        raise InputError(path, "the file is too large", accepted=f"at most {LARGEST_FILE >> 20} MiB")
    try:
        text = path.read_text(encoding="utf-8-sig")
        frame = pd.read_csv(path, nrows=_MOST_ROWS, encoding="utf-8-sig")
    except (ValueError, OverflowError) as error:
        raise InputError(path, "no comma-separated values", found=str(error)[-80:]) from error
    frame.columns = [str(name).strip() for name in frame.columns]
    known = [*_ANGLES, _WAVELENGTH, _VALUE, _U]
    if missing := [name for name in (*_ANGLES, _VALUE) if name not in frame]:
        raise InputError(
            path, "a column is missing", where="line 1", found=f"no {missing[0]}", accepted=", ".join(known)
        )
    if other := [name for name in frame if name not in known]:
        raise InputError(path, "unknown column", where="line 1", found=repr(other[0])[:40], accepted=", ".join(known))
    if len(frame) == 0:
        raise InputError(path, "no rows", found="the line of names alone", accepted="a row for each sample")
    numbers = frame.apply(pd.to_numeric, errors="coerce").to_numpy(dtype=float)
    limits = {"theta_i_deg": (0, 90), "theta_o_deg": (0, 90), "phi_i_deg": (-720, 720), "phi_o_deg": (-720, 720)}
    good = np.isfinite(numbers)
    for number, name in enumerate(frame):
        low, high = limits.get(str(name), (-np.inf if name == _VALUE else 0, np.inf))
        good[:, number] &= (numbers[:, number] >= low) & (numbers[:, number] <= high)
    if not good.all():
        row, column = (int(index) for index in np.argwhere(~good)[0])
        line = [number for number, one in enumerate(text.splitlines(), start=1) if one.strip()][row + 1]
        name, found = str(frame.columns[column]), str(frame.iat[row, column])[:40]
        low, high = limits.get(name, (0, np.inf))
        accepted = f"{low} to {high}" if name in limits else "a number" if name == _VALUE else "a number, 0 or more"
        raise InputError(path, f"{name} is out of range", where=f"line {line}", found=found, accepted=accepted)
    return pd.DataFrame(numbers, columns=frame.columns)


def _scattered(rows: Rows, wavelength: Array | None, path: Path, has_u: bool = False) -> ReadTable:
    """Samples as a grid: their own about the normal, or one about the mirror direction onto which they are interpolated."""
    single = tuple(np.round(angles, 3) for angles in (rows.theta_i, rows.phi_i, rows.theta_o, rows.phi_o))
    cells = float(np.prod([float(np.unique(angles).size) for angles in single]))
    if rows.theta_i.size >= _GRID_SHARE * cells:
        grid = gridded_rows(rows, path)
        return _read_table("uniform", grid.axes, grid.values, None, wavelength, has_u, grid.notes)
    incidences, member = np.unique(np.stack([single[1] % 360, single[0]]), axis=1, return_inverse=True)
    member = member.ravel()
    phi_i, theta_i = (np.unique(angles) for angles in incidences)
    if phi_i.size * theta_i.size != incidences.shape[1] or incidences.shape[1] > _MOST_INCIDENCES:
        raise InputError(
            path,
            "the incidences are no grid",
            found=f"{incidences.shape[1]} of {theta_i.size} polar angles and {phi_i.size} azimuths",
            accepted="each polar angle at each azimuth",
        )
    fewest = int(np.bincount(member).min())
    if fewest < _FEWEST_VIEWS:
        raise InputError(path, "an incidence has too few samples", found=fewest, accepted=f"{_FEWEST_VIEWS} or more")
    theta_s, phi_s = specular_angles(rows.theta_i, rows.phi_i, rows.theta_o, rows.phi_o)
    with_lay = phi_i.size > 1
    polar = np.quantile(theta_s, np.linspace(0, 1, _POLAR_NODES))
    polar = np.unique(np.round(np.concatenate([[0.0], polar, [180.0]]), 2))
    around = np.arange(0.0, 361.0 if with_lay else 181.0, _STEP)
    shape = (phi_i.size, theta_i.size, polar.size, around.size)
    values, quality = np.empty((*shape, rows.values.shape[1])), np.empty(shape, dtype=np.int8)
    for number in range(incidences.shape[1]):
        chosen = member == number
        at = int(np.searchsorted(phi_i, incidences[0, number])), int(np.searchsorted(theta_i, incidences[1, number]))
        values[at], quality[at] = _interpolated(
            theta_s[chosen], phi_s[chosen], rows.values[chosen], polar, around, not with_lay, path
        )
    axes = {"theta_i": theta_i, "theta_s": polar, "phi_s": around}
    if with_lay:
        axes = {"phi_i": np.append(phi_i, phi_i[0] + 360), **axes}
        values, quality = (np.concatenate([one, one[:1]]) for one in (values, quality))
    else:
        values, quality = values[0], quality[0]
    note = "the samples were interpolated onto a grid about the mirror direction"
    return _read_table("specular", axes, values, quality, wavelength, has_u, (note,))


def _interpolated(
    theta_s: Array, phi_s: Array, values: Array, polar: Array, around: Array, mirrored: bool, path: Path
) -> tuple[Array, NDArray[np.int8]]:
    """Values (θ_s, φ_s, channels) on a grid, and their quality; beyond the samples the nearest one."""
    from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

    if mirrored:
        theta_s, phi_s, values = np.tile(theta_s, 2), np.append(phi_s, -phi_s), np.tile(values, (2, 1))
    points = np.stack([theta_s * np.cos(np.radians(phi_s)), theta_s * np.sin(np.radians(phi_s))], axis=-1)
    _, single = np.unique(np.round(points, 6), axis=0, return_index=True)
    points, values = points[single], values[single]
    grid = np.meshgrid(polar, np.radians(around), indexing="ij")
    wanted = np.stack([grid[0] * np.cos(grid[1]), grid[0] * np.sin(grid[1])], axis=-1)
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] < _FLAT * spread[0]:
        raise InputError(
            path, "the samples of an incidence lie on one line", accepted="directions around the mirror direction"
        )
    between = LinearNDInterpolator(points, values)(wanted)
    beyond = np.asarray(np.isnan(between).any(axis=-1))
    found = np.where(beyond[..., None], NearestNDInterpolator(points, values)(wanted), between)
    return found, np.where(beyond, vocabulary.quality("extrapolated"), vocabulary.quality("interpolated")).astype(
        np.int8
    )


def _read_table(
    layout: str,
    axes: Mapping[str, Array],
    values: Array,
    quality: NDArray[np.int8] | None,
    wavelength: Array | None,
    has_u: bool,
    notes: tuple[str, ...],
) -> ReadTable:
    count = values.shape[-1] // 2 if has_u else values.shape[-1]
    return ReadTable(
        layout,
        axes,
        values[..., :count],
        channels="photopic" if wavelength is None else "spectral",
        wavelength=wavelength,
        uncertainty=values[..., count:] if has_u else None,
        quality=quality,
        notes=notes,
    )
