"""A table that was read from a file, as a BSDF: missing cells, negative values, the declared integral and reciprocity are named."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf import approximation_error
from brdfpipe.bsdf.grids import GRIDS, Angles
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.representations.table import Table
from brdfpipe.errors import InputError
from brdfpipe.geometry import Array
from brdfpipe.spectra import colorimetry
from brdfpipe.spectra.linear_recovery import spectra_of_primaries

Channels = Literal["photopic", "xyz", "rgb", "spectral"]

INTEGRAL_LIMIT = 0.02
"""Relative difference between the declared integral of a table and its own above which it is warned of."""
RECIPROCITY_LIMIT = 0.1
"""Median relative difference of exchanged directions above which it is warned of."""

LARGEST_VALUE = 1e12
"""BRDF above which a value is refused [sr-1]: all light within a millionth of a radian."""

_NEAR_NORMAL, _NEAR_GRAZING = 10.0, 75.0
"""Incidences that a table has to reach to serve for all directions without a warning [degree]."""
_INCIDENCES_OF_HALF_ANGLES = np.array([10.0, 45.0, 75.0])
_MOST_INTEGRATED = 5
_MOST_LISTED = 13
"""Incidences of which a warning lists both reflectances."""
_HORIZON = 89.9
_MOST_COMPARED = 4000


@dataclass(frozen=True)
class ReadTable:
    """Content of a file."""

    layout: str
    """Key of :data:`brdfpipe.bsdf.grids.GRIDS`"""
    axes: Mapping[str, Array]
    """Increasing angles [degree], in the order of the layout"""
    values: Array
    """(axes…, channels), NaN where the file has no value"""
    channels: Channels = "photopic"
    """``xyz``: X, Y and Z, Y the BSDF weighted with V(λ); ``rgb``: linear sRGB; each under D65"""
    wavelength: Array | None = None
    """(channels,) nm, of spectral values"""
    declared_integral: Array | None = None
    """([phi_i,] theta_i, channels) reflectance that the file declares; NaN where it declares none"""
    zero_is_missing: bool = False
    """Whether 0 marks cells without a measurement"""
    quantity: str = "brdf"
    """Of :data:`brdfpipe.exchange.registry.QUANTITIES`"""
    relative: bool = False
    """Whether the values are proportional to the BRDF, on the scale of the declared integral; the scale of the first incidence that declares one holds
    for those that declare none"""
    quality: NDArray[np.int8] | None = None
    """(axes…) :func:`brdfpipe.vocabulary.quality` of values that the reader itself derived from others; by default all are of the file"""
    uncertainty: Array | None = None
    """(axes…, channels) standard uncertainties of the values, of the same quantity; NaN where the file has none"""
    side: str = "reflection"
    """``transmission``: the light that passes, its polar angles counted from the normal of the other side"""
    notes: tuple[str, ...] = ()
    """What the reader changed or assumed"""
    warnings: tuple[str, ...] = ()
    """What it assumed that decides results"""


def as_bsdf(read: ReadTable, path: Path) -> xr.Dataset:
    """The BSDF of a table.

    Parameters
    ----------
    read : the content of the file
    path : of the file, for messages

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``table``: ``brdf`` and its ``brdf_quality``, and ``brdf_xyz`` of a table with colours. Cells without a value
    are interpolated within their incidence, between cells about the same distance from the lobe. Values are never rescaled, unless they are relative: a declared integral that differs is a warning

    Raises
    ------
    InputError : no cell has a value, a value is infinite or above :data:`LARGEST_VALUE`, or an axis does not increase.
    """
    if (infinite := np.isinf(read.values)).any():
        raise InputError(
            path, "a value is infinite", found=f"{infinite.sum()} of {read.values.size}", accepted="numbers below 1e300"
        )
    for name, axis in read.axes.items():
        if not np.isfinite(axis).all():
            raise InputError(path, f"an angle {name} is not finite", found=f"{axis[~np.isfinite(axis)][0]:g}")
        if axis.size > 1 and not (np.diff(axis) > 0).all():
            at = int(np.flatnonzero(np.diff(axis) <= 0)[0])
            raise InputError(path, f"the angles {name} do not increase", found=f"{axis[at + 1]:g} after {axis[at]:g}")
        low, high = (0, 180) if name.startswith("theta") else (-360, 720)
        if axis[0] < low or axis[-1] > high:
            found, accepted = f"{axis[0]:g} to {axis[-1]:g}", f"{low} to {high} degree"
            raise InputError(path, f"the angles {name} are out of range", found=found, accepted=accepted)
    if read.channels == "rgb":
        # Colours outside those of a screen have negative channels, not negative X, Y or Z.
        read = _with_tristimulus(read)
    values, quality, warnings = _completed(_as_brdf(read.values, read), read, path)
    read, values, quality = _with_two_nodes(read, values, quality)
    if read.relative:
        read, values, scaled = _on_declared_scale(read, values, path)
        warnings += scaled
    if (largest := float(values.max())) > LARGEST_VALUE:
        raise InputError(
            path,
            "a value is too large for a BRDF; if it marks a missing value, leave its cell empty",
            found=f"{largest:g} sr-1",
            accepted=f"up to {LARGEST_VALUE:g} sr-1",
        )
    names = tuple(read.axes)
    table = xr.Dataset(coords=dict(read.axes), attrs={"representation": Table.name, "source_representation": "file"})
    if read.channels == "spectral":
        table = table.assign_coords(wavelength=read.wavelength)
        table["brdf"] = (*names, "wavelength"), values
    else:
        has_colours = read.channels == "xyz"
        table["brdf"] = names, values[..., 1 if has_colours else 0]
        if has_colours:
            table = table.assign_coords(wavelength=colorimetry.GRID, component=["X", "Y", "Z"], channel=["R", "G", "B"])
            table["brdf_xyz"] = (*names, "component"), values
            table["spectrum_of_rgb"] = ("wavelength", "channel"), spectra_of_primaries()
            table = table.assign_attrs(illuminant="D65", observer=2)
    table["brdf_quality"] = names, quality
    if read.uncertainty is not None:
        u = _as_brdf(read.uncertainty, read)
        for number, name in enumerate(names):
            u = np.repeat(u, read.axes[name].size // u.shape[number], axis=number)
        table["brdf_u"] = (table["brdf"].dims, u if read.channels == "spectral" else u[..., 0])
    if "theta_o" in read.axes and read.axes["theta_o"][-1] > 90:
        table.attrs["transmission"] = "slab"
    table = vocabulary.label(table, "bsdf")
    luminous = table.drop_dims(["wavelength", "component", "channel"]) if "brdf_xyz" in table else table
    warnings += (
        _excess(read, luminous)
        + _declared(read, luminous)
        + _reciprocity(luminous)
        + _incidences(read)
        + _azimuths(read)
    )
    if read.side == "transmission":
        table = table.assign_attrs(side="transmission", transmission="slab")
    return vocabulary.add_warning(vocabulary.add_history(table, *read.notes), *read.warnings, *warnings)


def _directions(read: ReadTable) -> Angles:
    grid = GRIDS[read.layout]
    return grid.directions(dict(zip(read.axes, np.meshgrid(*read.axes.values(), indexing="ij"), strict=True)))


def _as_brdf(values: Array, read: ReadTable) -> Array:
    if read.quantity == "pi_brdf":
        return np.asarray(values / np.pi)
    if read.quantity == "brdf_cos":
        # On both sides of the surface.
        cosine = np.maximum(np.abs(np.cos(np.radians(_directions(read)[2]))), np.cos(np.radians(_HORIZON)))
        return np.asarray(values / cosine[..., None])
    return values


def _completed(values: Array, read: ReadTable, path: Path) -> tuple[Array, NDArray[np.int8], list[str]]:
    """Values at all cells, their quality (axes…), and warnings."""
    quality = np.zeros(values.shape[:-1], dtype=np.int8) if read.quality is None else read.quality.copy()
    theta_i, _, theta_o, _ = _directions(read)
    above = np.broadcast_to((read.layout == "uniform") | (theta_i <= 90) & (theta_o <= 90), quality.shape)
    missing = np.asarray(np.isnan(values).any(axis=-1))
    if read.zero_is_missing:
        missing |= (values == 0).all(axis=-1)
    warnings = []
    if (negative := ~missing & (values < 0).any(axis=-1)).any():
        least = float(np.nanmin(values))
        warnings.append(
            f"{negative.sum()} of {above.sum()} cells are negative (down to {least:.3g} sr-1); they became 0"
        )
        quality[negative] = vocabulary.quality("clamped")
        values = np.maximum(values, 0.0)
    if (lost := missing & above).any():
        share = lost.sum() / above.sum()
        warnings.append(
            f"{lost.sum()} of {above.sum()} cells above the horizon ({share:.1%}) have no value; they were interpolated from their neighbours"
        )
    if not missing.any():
        return values, quality, warnings
    if missing.all():
        raise InputError(path, "no cell has a value", found="0 or nothing in all of them")
    filled = values.copy()
    slices = [name not in ("theta_i", "phi_i", "theta_h", "phi_h") for name in read.axes]
    outer = values.shape[: slices.index(True)]
    inner = [axis for axis, within in zip(read.axes.values(), slices, strict=True) if within]
    for index in np.ndindex(outer):
        if missing[index].all():
            raise InputError(path, "an incidence has no value at all", found=f"number {index[-1] + 1}")
        if missing[index].any():
            filled[index], guessed = _filled(values[index], missing[index], inner)
            quality[index][missing[index]] = np.where(
                guessed, vocabulary.quality("extrapolated"), vocabulary.quality("interpolated")
            )
    return filled, quality, warnings


def _filled(values: Array, missing: NDArray[np.bool_], axes: list[Array]) -> tuple[Array, NDArray[np.bool_]]:
    """Values with those that are missing interpolated in the plane of polar angle and azimuth; where none is around, the nearest one."""
    from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

    polar, azimuth = np.meshgrid(*axes, indexing="ij")
    points = np.stack([polar * np.cos(np.radians(azimuth)), polar * np.sin(np.radians(azimuth))], axis=-1)
    known, wanted = points[~missing], points[missing]
    found = NearestNDInterpolator(known, values[~missing])(wanted)
    guessed = np.ones(len(wanted), dtype=bool)
    if len(known) > 3 and np.linalg.matrix_rank(known - known.mean(axis=0)) == 2:
        between = LinearNDInterpolator(known, values[~missing])(wanted)
        guessed = np.asarray(np.isnan(between).any(axis=-1))
        found = np.where(guessed[:, None], found, between)
    result = values.copy()
    result[missing] = found
    return result, guessed


def _with_two_nodes(
    read: ReadTable, values: Array, quality: NDArray[np.int8]
) -> tuple[ReadTable, Array, NDArray[np.int8]]:
    """An axis of one angle gets a second one with the same values, because a table is interpolated."""
    axes = dict(read.axes)
    for number, (name, axis) in enumerate(read.axes.items()):
        if axis.size == 1:
            axes[name] = np.array([axis[0], axis[0] + 1.0 if axis[0] < 89 else axis[0] + 0.5])
            values, quality = np.repeat(values, 2, axis=number), np.repeat(quality, 2, axis=number)
            note = f"the file has one angle {name}, {axis[0]:g} degree; other angles have its values"
            read = replace(read, notes=(*read.notes, note))
    return replace(read, axes=axes), values, quality


def _on_declared_scale(read: ReadTable, values: Array, path: Path) -> tuple[ReadTable, Array, list[str]]:
    """Relative values, and their uncertainties, on the scale at which each channel of an incidence reflects what the file declares; and warnings."""
    declared = np.full((1, 1, 1), np.nan) if read.declared_integral is None else read.declared_integral
    declared = declared.reshape(-1, *declared.shape[-2:])
    known = np.isfinite(declared).all(axis=-1)
    if not known.any():
        raise InputError(
            path, "relative values have no scale", found="no reflectance", accepted="a reflectance of each channel"
        )
    # Wavelengths stand for the channels, so that colours are not converted.
    stand_in = xr.Dataset(
        {"brdf": ((*read.axes, "wavelength"), values)},
        {**read.axes, "wavelength": np.arange(400.0, 400 + values.shape[-1])},
        {"representation": Table.name},
    )
    azimuths = read.axes.get("phi_i", np.zeros(1))
    factor = np.full(declared.shape, np.nan)
    for azimuth, row in np.argwhere(known):
        theta_i, phi_i = float(read.axes["theta_i"][row]), float(azimuths[azimuth])
        rule = approximation_error.directions(stand_in, min(theta_i, 89.5), phi_i)
        integral = rule.weight @ approximation_error.brdf_at(stand_in, theta_i, phi_i, rule)
        factor[azimuth, row] = np.divide(
            declared[azimuth, row], integral, out=np.ones_like(integral), where=integral > 0
        )
    factor[~known] = factor[known][0]
    shape = declared.shape if "phi_i" in read.axes else declared.shape[1:]
    factors = factor.reshape(*shape[:-1], 1, 1, shape[-1])
    scaled = values * factors
    if read.uncertainty is not None:
        read = replace(read, uncertainty=read.uncertainty * factors)
    if not np.isfinite(scaled).all():
        raise InputError(path, "a value on the declared scale is not finite", accepted="numbers below 1e300")
    positive = factor[known][factor[known] > 0]
    if positive.size == 0 or positive.max() / positive.min() - 1 <= INTEGRAL_LIMIT:
        return read, scaled, []
    text = f"the values are proportional to the BRDF; those of each incidence were scaled to the declared reflectance, by {positive.min():.4g} to {positive.max():.4g}"
    return read, scaled, [f"{text}: as these differ, the table may be too coarse for its lobe"]


def _with_tristimulus(read: ReadTable) -> ReadTable:
    """X, Y and Z, in place of linear sRGB under D65; Y of a perfect white diffuser is 1/π."""
    to_xyz = np.linalg.inv(colorimetry.srgb_from_xyz(colorimetry.weights("D65", 2).white) * 100).T
    declared = None if read.declared_integral is None else read.declared_integral @ to_xyz
    return replace(read, values=read.values @ to_xyz, declared_integral=declared, channels="xyz")


def _excess(read: ReadTable, table: xr.Dataset) -> list[str]:
    """More light than arrives, and what the values may be instead."""
    angles = read.axes.get("theta_i", _INCIDENCES_OF_HALF_ANGLES)
    chosen = np.unique(angles[np.linspace(0, angles.size - 1, _MOST_INTEGRATED).astype(int)])
    chosen = chosen[chosen < _HORIZON]
    shares = np.array([_integrals(table, float(angle)).max() for angle in chosen])
    if shares.size == 0 or shares.max() <= 1 + INTEGRAL_LIMIT:
        return []
    worst = int(np.argmax(shares))
    text = f"the values send out {shares[worst]:.3g} times the light that arrives (at {chosen[worst]:g} degree of incidence)"
    remedy = "check their unit and scale"
    if shares[worst] <= np.pi * (1 + INTEGRAL_LIMIT) and read.quantity == "brdf":
        remedy = "if they are reflectance factors, π times the BRDF, read them as the quantity `pi_brdf`"
    elif shares[worst] <= 100 * (1 + INTEGRAL_LIMIT):
        remedy = "if they are percentages, divide them by 100 in the file"
    return [f"{text}; {remedy}"]


def _declared(read: ReadTable, table: xr.Dataset) -> list[str]:
    """The declared integral beside that of the table."""
    if read.declared_integral is None or "theta_i" not in read.axes:
        return []
    declared = read.declared_integral.reshape(-1, *read.declared_integral.shape[-2:])[0]
    channel = 1 if read.channels == "xyz" else declared.shape[-1] // 2
    angles = read.axes["theta_i"][: declared.shape[0]]
    own = np.array([_integrals(table, float(angle))[channel if read.channels == "spectral" else 0] for angle in angles])
    stated = declared[:, channel]
    known = np.isfinite(stated) & (stated > 0)
    if not known.any():
        return []
    ratio = own[known] / stated[known]
    worst = int(np.argmax(np.abs(np.log(np.maximum(ratio, 1e-12)))))
    if abs(ratio[worst] - 1) <= INTEGRAL_LIMIT:
        return []
    chosen = np.unique([*np.linspace(0, ratio.size - 1, min(ratio.size, _MOST_LISTED)).astype(int), worst])
    listed = ", ".join(
        f"{angle:g}°: {of_values:.3f} ({of_file:.3f} declared)"
        for angle, of_values, of_file in zip(
            angles[known][chosen], own[known][chosen], stated[known][chosen], strict=True
        )
    )
    return [
        f"the integral of the values differs from the reflectance that the file declares by up to {abs(ratio[worst] - 1):.0%}: {listed}; "
        "the values were not rescaled"
    ]


def _incidences(read: ReadTable) -> list[str]:
    """What holds beyond the incidences of the file."""
    if read.layout == "half":
        return []
    low, high = float(read.axes["theta_i"][0]), float(read.axes["theta_i"][-1])
    if low <= _NEAR_NORMAL and high >= _NEAR_GRAZING:
        return []
    text = f"the file has incidences from {low:g} to {high:g} degree; beyond them the values of the nearest hold"
    return [text if read.layout == "uniform" else f"{text}, about the mirror direction"]


def _azimuths(read: ReadTable) -> list[str]:
    """What holds beyond the azimuths of incidence of a file with a lay, unless they are a circle or, of a surface that half a turn does not change, half of it."""
    axis = next((read.axes[name] for name in ("phi_i", "phi_h") if name in read.axes), None)
    if axis is None or axis[-1] - axis[0] in (180, 360):
        return []
    return [
        f"the file has azimuths of incidence from {axis[0]:g} to {axis[-1]:g} degree, neither a circle nor half of it; beyond them the values of the nearest hold"
    ]


def _integrals(table: xr.Dataset, theta_i: float) -> Array:
    """Reflectance (channels,) of one incidence."""
    rule = approximation_error.directions(table, theta_i)
    return np.asarray(rule.weight @ approximation_error.brdf_at(table, theta_i, 0.0, rule))


def _reciprocity(table: xr.Dataset) -> list[str]:
    """How far exchanged directions differ, within the incidences of the table."""
    if "theta_i" not in table.coords:
        return []
    low, high = float(table["theta_i"][0]), min(float(table["theta_i"][-1]), 85.0)
    if high - low < 10:
        return []
    generator = np.random.default_rng(0)
    theta_i, theta_o = generator.uniform(low, high, (2, _MOST_COMPARED))
    phi_i, phi_o = generator.uniform(0.0, 360.0, (2, _MOST_COMPARED))
    evaluate = representation(table).evaluate
    one, other = evaluate(theta_i, phi_i, theta_o, phi_o, None), evaluate(theta_o, phi_o, theta_i, phi_i, None)
    mean = (one + other).mean(axis=-1) / 2
    lit = mean > 0
    if not lit.any():
        return []
    median = float(np.median(np.abs(one - other).mean(axis=-1)[lit] / mean[lit]))
    if median <= RECIPROCITY_LIMIT:
        return []
    return [
        f"exchanged directions differ by {median:.1%} (median), so the table is not reciprocal; check that it is BRDF, not BRDF times a cosine"
    ]
