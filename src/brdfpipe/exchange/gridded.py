"""A BSDF on the grid of a format: nodes by the error of the program that reads it, and the values of its channels in blocks.

Every table states three things in and beside its file: the error of the table, its own integral, and what the format leaves out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import xarray as xr

from brdfpipe.appearance.colours import xyz_of
from brdfpipe.bsdf import table_nodes
from brdfpipe.bsdf.grids import GRIDS
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.one_side import Side, one_side
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import Limits, TableError, rules
from brdfpipe.bsdf.tabulation import full_circle, values_on_nodes
from brdfpipe.exchange.records import Content
from brdfpipe.exchange.registry import ExchangeError
from brdfpipe.geometry import Array
from brdfpipe.spectra import colorimetry


@dataclass(frozen=True)
class Channels:
    """What a table holds at each pair of directions: one number, three of a colour, or one for each wavelength."""

    names: tuple[str, ...]
    source: xr.Dataset
    """The BSDF that is evaluated"""
    convert: Callable[[Array], Array] = np.asarray
    """From its values (…, wavelength) to (…, channels)"""
    wavelength: Array | None = None
    """(channels,) nm, of a spectral table"""


def side_of(bsdf: xr.Dataset, side: Side, path: Path) -> xr.Dataset:
    """One side of a BSDF as a BSDF that reflects alone, see :mod:`brdfpipe.bsdf.one_side`.

    Raises ExchangeError: no light passes to the other side, into air.
    """
    if side == "transmission" and not representation(bsdf).is_slab:
        raise ExchangeError(f"{path.name}: the material is no sheet, so no light passes to the air behind it")
    return one_side(bsdf, side)


def photopic(bsdf: xr.Dataset) -> Channels:
    """One number: the BSDF weighted with V(λ) and D65."""
    return Channels(("photopic",), nonspectral(bsdf))


def tristimulus(bsdf: xr.Dataset) -> Channels:
    """X, Y and Z under D65 for the 2 degree observer; Y of a perfect white diffuser is 1/π."""
    return Channels(("X", "Y", "Z"), bsdf, lambda values: xyz_of(bsdf, values, "D65", 2) / (100 * np.pi))


def linear_rgb(bsdf: xr.Dataset) -> Channels:
    """Linear sRGB under D65; a perfect white diffuser has 1/π in each."""
    to_rgb = colorimetry.srgb_from_xyz(colorimetry.weights("D65", 2).white)
    return Channels(("R", "G", "B"), bsdf, lambda values: xyz_of(bsdf, values, "D65", 2) @ to_rgb.T / np.pi)


def spectral(bsdf: xr.Dataset, wavelength: Array) -> Channels:
    """One number for each wavelength [nm]."""
    return Channels(tuple(f"{one:g}nm" for one in wavelength), bsdf, np.asarray, np.asarray(wavelength, dtype=float))


def photopic_or_spectral(bsdf: xr.Dataset, by_wavelength: bool) -> Channels:
    """One number for each wavelength of the BSDF; one weighted with V(λ) and D65 unless ``by_wavelength``, or where it has no wavelengths."""
    if by_wavelength and "wavelength" in bsdf.coords:
        return spectral(bsdf, bsdf["wavelength"].values)
    return photopic(bsdf)


@dataclass(frozen=True)
class Gridded:
    """A BSDF on a grid."""

    bsdf: xr.Dataset
    layout: str
    axes: Mapping[str, Array]
    channels: Channels
    factor: Array
    error: TableError
    limits: Limits

    reading = "interpolated linearly"

    @property
    def content(self) -> Content:
        if self.channels.wavelength is not None:
            return "spectrum"
        return {"X": "xyz", "R": "rgb"}.get(self.channels.names[0], "luminous")  # type: ignore[return-value]

    @property
    def channel_count(self) -> int:
        return len(self.channels.names)

    @property
    def size(self) -> int:
        """Number of values of all channels."""
        return int(np.prod([axis.size for axis in self.axes.values()])) * self.channel_count

    @cached_property
    def _axis(self) -> int:
        return list(self.axes).index("theta_i")

    def block(self, row: int) -> Array:
        """Values of one incidence θ_i, (other axes…, channels) [sr-1]."""
        model, channels = representation(self.channels.source), self.channels
        axes = {**self.axes, "theta_i": self.axes["theta_i"][[row]]}

        def evaluate(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, _: None) -> Array:
            return channels.convert(model.evaluate(theta_i, phi_i, theta_o, phi_o, channels.wavelength))

        values = values_on_nodes(evaluate, GRIDS[self.layout], axes, False, model.mirror_symmetric)
        factor = np.take(self.factor, [row], axis=self._axis) if self.factor.shape[self._axis] > 1 else self.factor
        return np.asarray((values * factor).take(0, axis=self._axis))

    def full_circle(self) -> Gridded:
        """A uniform table whose azimuths cover a turn, for programs that do not mirror a half circle."""
        around = self.axes["phi_o"]
        return self if around[-1] > 180 else replace(self, axes={**self.axes, "phi_o": full_circle(around)})

    def blocks(self) -> Iterator[tuple[float, Array, Array]]:
        """θ_i [degree], values (other axes…, channels) [sr-1], and the reflectance ([phi_i,] channels) of the table's own interpolation, by incidence."""
        for row, theta_i in enumerate(self.axes["theta_i"]):
            values = self.block(row)
            yield float(theta_i), values, self.integral(float(theta_i), values)

    def integral(self, theta_i: float, values: Array) -> Array:
        """Reflectance ([phi_i,] channels) of the values of one incidence θ_i [degree], by the table's own interpolation."""
        if "phi_i" not in self.axes:
            return self._integral_at(theta_i, 0.0, values)
        azimuths = zip(self.axes["phi_i"], values, strict=True)
        return np.stack([self._integral_at(theta_i, float(phi_i), outgoing) for phi_i, outgoing in azimuths])

    def _integral_at(self, theta_i: float, phi_i: float, outgoing: Array) -> Array:
        rule = rules(self.bsdf, min(theta_i, 89.5), phi_i)[0]
        around = {name: axis for name, axis in self.axes.items() if name not in ("theta_i", "phi_i")}
        # Two incidences, because a table of one cannot be interpolated.
        axes = {"theta_i": np.array([theta_i, theta_i + 1e-6]), **around}
        read = table_nodes.interpolation(axes, np.stack([outgoing, outgoing]))
        at = np.full_like(rule.theta, theta_i), np.full_like(rule.theta, phi_i), rule.theta, rule.phi
        return np.asarray(rule.weight @ read(*at, None))


def gridded(
    bsdf: xr.Dataset, layout: str, channels: Channels, *, tolerance: float, albedo_tolerance: float, largest: int
) -> Gridded:
    """A BSDF on the smallest grid of a layout that a program which interpolates linearly reads within a tolerance.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    layout : ``uniform``, ``specular`` or ``half``, see :mod:`brdfpipe.bsdf.grids`
    channels : what each node holds
    tolerance : limit of the error at the 95th percentile of directions, relative to BRDF·cos θ_o [1]
    albedo_tolerance : limit of the relative error of the directional reflectance [1]
    largest : number of nodes; if they are not enough for the tolerance, the error is larger and stated

    Raises
    ------
    ExchangeError : a tolerance or the number of nodes is out of range.
    """
    check_limits(tolerance, albedo_tolerance, largest, least=table_nodes.smallest_table(bsdf, layout))
    choice = table_nodes.choose_nodes(
        nonspectral(bsdf), layout, tolerance=tolerance, albedo_tolerance=albedo_tolerance, largest=largest
    )
    limits = Limits(tolerance, albedo_tolerance)
    return Gridded(bsdf, layout, choice.axes, channels, choice.factor, choice.error, limits)


def check_limits(tolerance: float, albedo_tolerance: float, largest: int, *, least: int) -> None:
    """Raise an ExchangeError if a limit of the error, or of the number of values, is out of range."""
    for name, value in (("tolerance", tolerance), ("albedo_tolerance", albedo_tolerance)):
        if not 0 < value <= 1:
            raise ExchangeError(f"{name} is {value!r}; accepted: above 0, at most 1")
    if largest < least:
        raise ExchangeError(f"largest is {largest!r}; accepted: at least {least} values")
