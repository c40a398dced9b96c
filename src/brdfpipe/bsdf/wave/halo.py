"""Light that a surface with low slopes scatters beside the mirror direction, by first-order wave optics.

Of an incidence (θ_i, φ_i) and γ = cos θ the Bragg frequency is f = |sin θ_o e_o + sin θ_i e_i|/λ, e the unit vectors of the azimuths, and
the phase variance is g = [2πσ(γ_i + γ_o)/λ]². With the transform K(g, f) of :mod:`brdfpipe.bsdf.wave.height_transform` and the
polarisation factor Q, the halo is one of

``ssa1``             f_r = Q (K/λ²) 4γ_i γ_o/(γ_i + γ_o)²   first-order small-slope approximation
``ghs``              f_r = Q K/λ²                          generalised Harvey-Shack theory
``rayleigh-rice``    f_r = (16π²/λ⁴) γ_i γ_o Q S(f)        limit of ``ssa1`` as g → 0

In the mirror direction Q is Fresnel's reflectance. All three are reciprocal.

References
----------
Rice 1951, Commun. Pure Appl. Math. 4, 351; Church, Jenkinson & Zavada 1977, Opt. Eng. 16, 360; Stover, Optical Scattering, 3rd ed.,
ch. 4 (Rayleigh-Rice, and Q after Barrick); Krywonos, Harvey & Choi 2011, J. Opt. Soc. Am. A 28, 1121; Voronovich 1994, Wave
Scattering from Rough Surfaces, ch. 5.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter, spline_filter1d

from brdfpipe.bsdf.spectral import OnlyOnce, each_time
from brdfpipe.content_cache import cached_by_content
from brdfpipe.geometry import Array, HalfVector, slope_towards

if TYPE_CHECKING:
    from brdfpipe.bsdf.wave.halo_kernel import HaloTable, OrderTable

_TINY = 1e-300

_PAULI = np.array([[[1, 0], [0, 1]], [[1, 0], [0, -1]], [[0, 1], [1, 0]], [[0, -1j], [1j, 0]]])
"""Matrices σ with Stokes components S = ½ Tr(σ E E†) of the field E = (E_s, E_p), in the frames of :mod:`brdfpipe.bsdf.microfacet.polarised`."""

_LEAST_FIRST_ORDER = 1e-9

_WRAPPED = 3
"""Nodes of azimuth that are repeated at either end."""

Azimuths = tuple[Array, Array]
"""φ_i and φ_o [degree], (directions,) each"""
Field = NDArray[np.float64] | NDArray[np.complex128]


class Amplitudes(NamedTuple):
    """Polarisation factors of first-order scattering, incident polarisation first, (directions…, wavelength)."""

    ss: Field
    sp: Field
    ps: Field
    pp: Field

    @property
    def s(self) -> Array:
        """Q of light incident polarised s, all exits."""
        return np.asarray(np.abs(self.ss) ** 2 + np.abs(self.sp) ** 2)

    @property
    def p(self) -> Array:
        """Q of light incident polarised p, all exits."""
        return np.asarray(np.abs(self.ps) ** 2 + np.abs(self.pp) ** 2)

    @property
    def mean(self) -> Array:
        """Q of unpolarised light."""
        return (self.s + self.p) / 2

    def mueller(self) -> Array:
        """Mueller matrices (…, 4, 4) [1]; [0, 0] is :attr:`mean`."""
        jones = np.stack([np.stack([-self.ss, self.ps], axis=-1), np.stack([self.sp, self.pp], axis=-1)], axis=-2)
        return np.asarray(np.einsum("aij,...jk,bkl,...il->...ab", _PAULI, jones, _PAULI, jones.conj()).real / 2)


def amplitudes(pair: HalfVector, azimuth: Array, n: Array, k: Array) -> Amplitudes:
    """Polarisation factors of Rayleigh-Rice theory for a body of index n + ik.

    Parameters
    ----------
    pair : of the directions, (directions,)
    azimuth : φ_o − φ_i [degree], (directions,); 180 is the plane of incidence beyond the normal
    n, k : (wavelength,)

    References
    ----------
    Stover, Optical Scattering, 3rd ed., eq. 4.2 to 4.5 (Barrick 1970).
    """
    absorbing = bool(np.any(k))
    index = n + 1j * k if absorbing else n
    contrast, epsilon = (index - 1) * (index + 1), index * index
    cos_i, cos_o, sin_i, sin_o = (part[..., None] for part in (pair.cos_i, pair.cos_o, pair.sin_i, pair.sin_o))
    turned = np.radians(180 - azimuth)[..., None]
    cos, sin = np.cos(turned), np.sin(turned)
    root_i, root_o = _root(contrast, cos_i, absorbing), _root(contrast, cos_o, absorbing)
    s_i, s_o = 1 / (cos_i + root_i + _TINY), 1 / (cos_o + root_o + _TINY)
    p_i, p_o = 1 / (epsilon * cos_i + root_i + _TINY), 1 / (epsilon * cos_o + root_o + _TINY)
    return Amplitudes(
        contrast * cos * s_i * s_o,
        -contrast * sin * root_o * s_i * p_o,
        -contrast * sin * root_i * p_i * s_o,
        contrast * (root_i * root_o * cos - epsilon * sin_i * sin_o) * p_i * p_o,
    )


def polarisation_factor(pair: HalfVector, azimuth: Array, n: Array, k: Array, compiled: bool) -> Array:
    """Q of unpolarised light, (directions, wavelength), with the parameters of :func:`amplitudes`; by compiled code if that is loaded."""
    if not compiled:
        return amplitudes(pair, azimuth, n, k).mean
    from brdfpipe.bsdf.wave import halo_kernel

    return halo_kernel.polarisation_factor(pair, azimuth, n, k)


def _root(contrast: Field, cosine: Array, absorbing: bool) -> Field:
    """√(ε − sin²θ)."""
    square = contrast + cosine * cosine
    if not absorbing:
        return np.asarray(np.sqrt(np.maximum(square, 0.0)))
    root = np.sqrt(square)
    return np.asarray(root.real + 1j * np.abs(root.imag))


class Stretch(NamedTuple):
    """A stretch of the plane by which the roughness of a surface with a lay becomes nearly the same in all directions."""

    lay: float
    """Azimuth along the lay [degree]"""
    ratio: float
    """√ of the width of the spectrum across the lay over that along it; it keeps areas"""

    def __call__(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Length, and azimuth from the lay [degree] in [0, 180), of stretched slopes or frequencies along x and y."""
        turn = np.radians(self.lay)
        along = (x * np.cos(turn) + y * np.sin(turn)) * self.ratio
        across = (y * np.cos(turn) - x * np.sin(turn)) / self.ratio
        return np.hypot(along, across), np.degrees(np.arctan2(across, along)) % 180


@dataclass(frozen=True)
class Halo:
    """The halo of one surface, prepared for evaluation."""

    sigma: float
    """Rms height [um]"""
    form: str
    """One of :data:`brdfpipe.masking.modes.HALOS`"""
    spline: Array
    """Coefficients of a cubic spline through ln(K/g), (phase variance, frequency), or (phase variance, frequency, azimuth) with a lay"""
    first_phase: float
    """ln g of the first node"""
    phase_step: float
    """Step of ln g"""
    scale: float
    """f0 [um-1]: nodes are evenly spaced in asinh(f/f0)"""
    frequency_step: float
    """Step of asinh(f/f0)"""
    spectrum: Callable[[Array], Array] | None
    """S/σ² [um2] where it is known in closed form"""
    stretch: Stretch | None = None
    """Of the frequencies of a surface with a lay, before the table is read"""
    compiled: bool = False
    """Whether the table is read by compiled code, which takes a while to load"""
    first_order: Array | None = None
    """Coefficients of a spline through the logarithm of the share of the amplitude that is of first order, over the nodes of ``spline``; None: all"""

    @classmethod
    def of(cls, bsdf: xr.Dataset, *, by_order: bool = False) -> Halo:
        """The halo of a ``bsdf`` dataset, representation ``wave``; ``by_order``: higher orders reflect as tilted facets."""
        names = ("log_halo", "phase_variance", "halo_frequency", "frequency_scale", "sigma")
        values, phase, frequency, scale, sigma = (bsdf.variables[name].values for name in names)
        halo = cls.of_table(values, phase, frequency, scale, sigma, form=str(bsdf.attrs["form"]), by_order=by_order)
        lay = "halo_azimuth" in bsdf.dims
        stretch = Stretch(float(bsdf["halo_lay"]), float(bsdf["halo_stretch"])) if lay else None
        return replace(halo, spectrum=_closed_form(bsdf), stretch=stretch)

    @classmethod
    def of_table(
        cls,
        values: Array,
        phase: Array,
        frequency: Array,
        scale: Array,
        sigma: Array,
        form: str,
        by_order: bool = False,
    ) -> Halo:
        """From ``log_halo`` over ``phase_variance`` and ``halo_frequency``, with ``frequency_scale`` and the rms height [um]."""
        if by_order:
            spline, first_order = _splines_by_order(values, phase, frequency)
        else:
            spline, first_order = _spline(values), None
        return cls(
            float(sigma),
            form,
            spline,
            float(np.log(phase[0])),
            float(np.log(phase[-1] / phase[0])) / (phase.size - 1),
            float(scale),
            float(np.arcsinh(frequency[-1] / scale)) / (frequency.size - 1),
            None,
            first_order=first_order,
        )

    def phase_variance(self, cosines: Array, wavelength: Array) -> Array:
        """g [1], (…, wavelength), of cos θ_i + cos θ_o (…) at wavelengths [nm]."""
        return np.asarray((2e3 * np.pi * self.sigma * cosines[..., None] / wavelength) ** 2)

    def coherent_share(self, theta_i: Array, wavelength: Array) -> Array:
        """e^(−g) in the mirror direction, (incidences…, wavelength); 1 − g, at least 0, of ``rayleigh-rice``."""
        g = self.phase_variance(2 * np.cos(np.radians(theta_i)), wavelength)
        return np.maximum(1 - g, 0.0) if self.form == "rayleigh-rice" else np.exp(-g)

    def strength_and_transform(self, pair: HalfVector, azimuths: Azimuths, wavelength: Array) -> tuple[Array, Array]:
        """BRDF over the polarisation factor [sr-1], and K/λ² [1], (directions, wavelength) each."""
        nm, cosines = wavelength * 1e-3, pair.cos_i + pair.cos_o
        ratio = self._looked_up(("transform",), pair, azimuths, wavelength)[0] / nm**2
        geometry = (4 * np.pi * self.sigma / nm) ** 2 * (pair.cos_i * pair.cos_o)[..., None]
        return geometry * ratio, self.phase_variance(cosines, wavelength) * ratio

    def by_order(
        self, pair: HalfVector, azimuths: Azimuths, wavelength: Array, tilted: Array, once: OnlyOnce = each_time
    ) -> tuple[Array, Array]:
        """BRDF over the polarisation factor of waves, and over Fresnel's reflectance of the tilted facet [sr-1], (directions, wavelength) each.

        Both ways to reflect add as amplitudes do.
        ``tilted`` is what reflects as tilted facets over what ``ghs`` gives, (directions,).
        """
        if self.first_order is None:
            (ratio,) = once(("halo", id(self)), lambda: self._looked_up(("transform",), pair, azimuths, wavelength))
            return self._strength(ratio, pair, wavelength), np.zeros_like(ratio)
        tables = ("transform", "first order")
        ratio, first = once(("halo", id(self)), lambda: self._looked_up(tables, pair, azimuths, wavelength))
        first = np.minimum(first, 1.0)
        cosines = pair.cos_i + pair.cos_o
        # Amplitudes, over that of `ghs`, of both ways to reflect.
        low = first if self.form == "ghs" else first * (2 * np.sqrt(pair.cos_i * pair.cos_o) / cosines)[..., None]
        high = (1 - first) * np.sqrt(tilted)[..., None]
        scale = (low + high) * ratio * self.phase_variance(cosines, wavelength) / (wavelength * 1e-3) ** 2
        return low * scale, high * scale

    def strength(self, pair: HalfVector, azimuths: Azimuths, wavelength: Array) -> Array:
        """BRDF over the polarisation factor [sr-1], (directions, wavelength).

        ``azimuths`` are φ_i and φ_o [degree], (directions,) each; they matter for a surface with a lay.
        """
        return self._strength(self._looked_up(("transform",), pair, azimuths, wavelength)[0], pair, wavelength)

    def first_strength(self, pair: HalfVector, azimuths: Azimuths, wavelength: Array) -> Array:
        """The same as the phase variance tends to 0, without its loss to higher orders."""
        return self._strength(self._looked_up(("spectrum",), pair, azimuths, wavelength)[0], pair, wavelength)

    def _strength(self, ratio: Array, pair: HalfVector, wavelength: Array) -> Array:
        # 16π²σ²γ_iγ_o/λ⁴ · K/g, which has no quotient of small cosines.
        geometry = (pair.cos_i + pair.cos_o) ** 2 / 4 if self.form == "ghs" else pair.cos_i * pair.cos_o
        scale = (4 * np.pi * self.sigma) ** 2 * geometry[..., None] / (wavelength * 1e-3) ** 4
        return np.asarray(scale * ratio)

    def slope_and_azimuth(self, pair: HalfVector, azimuths: Azimuths) -> tuple[Array, Array]:
        """Slope of the facets of pairs, stretched, and the place of its azimuth in the table, (directions,) each; the latter is empty without a lay."""
        if self.stretch is None:
            return np.sqrt(pair.slope_squared), np.empty(0)
        slope, around = self.stretch(*slope_towards(pair, *azimuths))
        return slope, np.asarray(around * (self.spline.shape[2] - 2 * _WRAPPED) / 180 + _WRAPPED)

    def _looked_up(self, tables: Sequence[str], pair: HalfVector, azimuths: Azimuths, wavelength: Array) -> list[Array]:
        """K/g [um2] (``transform``), its limit as g tends to 0 (``spectrum``), or the share of ``first order`` [1], (directions…, wavelength) each."""
        cosines, place = pair.cos_i + pair.cos_o, []
        slope, column = self.slope_and_azimuth(pair, azimuths)
        if self.stretch is not None:
            place = [np.repeat(column[..., None], wavelength.size, axis=-1)]
        frequency = (slope * cosines)[..., None] / (wavelength * 1e-3)
        limit = self.form == "rayleigh-rice" or tables == ("spectrum",)
        if self.form == "rayleigh-rice" and self.spectrum is not None:
            return [self.spectrum(frequency)]
        row, along = np.zeros_like(frequency), np.arcsinh(frequency / self.scale) / self.frequency_step
        if not limit:
            with np.errstate(divide="ignore"):
                log_phase = 2 * np.log(2e3 * np.pi * self.sigma * cosines)
            row = np.maximum((log_phase[..., None] - 2 * np.log(wavelength) - self.first_phase) / self.phase_step, 0.0)
        if self.compiled:
            from brdfpipe.bsdf.wave import halo_kernel

            found = halo_kernel.Place(row, along, np.ascontiguousarray(column, dtype=float))
            named = ("spectrum" if limit else table for table in tables)
            return [halo_kernel.transform_ratio(self._compiled_tables[name], found) for name in named]
        at = np.array([row, along, *place])
        return [
            np.exp(map_coordinates(values, at, order=3, mode="mirror", prefilter=False))
            for values in (self._first_order if table == "first order" else self.spline for table in tables)
        ]

    @cached_property
    def by_compiled_code(self) -> Halo:
        """The same halo, whose table is read by compiled code."""
        return self if self.compiled else replace(self, compiled=True)

    @cached_property
    def by_order_table(self) -> OrderTable:
        """The tables side by side, as compiled code sums light of all orders."""
        from brdfpipe.bsdf.wave.halo_kernel import OrderTable

        splines = [self.spline] if self.first_order is None else [self.spline, self.first_order]
        phase, frequency = (self.first_phase, self.phase_step), (self.scale, self.frequency_step)
        return OrderTable.of(splines, self.sigma, phase, frequency)

    @property
    def _first_order(self) -> Array:
        assert self.first_order is not None
        return self.first_order

    @cached_property
    def _compiled_tables(self) -> dict[str, HaloTable]:
        """The tables as compiled code reads them."""
        from brdfpipe.bsdf.wave.halo_kernel import HaloTable

        tables = {"transform": HaloTable.of(self.spline, True), "spectrum": HaloTable.of(self.spline, False)}
        if self.first_order is not None:
            tables["first order"] = HaloTable.of(self.first_order, True)
        return tables


@cached_by_content(8)
def _splines_by_order(log_transform: Array, phase: Array, frequency: Array) -> tuple[Array, Array]:
    """Coefficients of splines through a table, and through the logarithm of :func:`_first_order_share`."""
    return _spline(log_transform), _spline(np.log(_first_order_share(log_transform, phase, frequency)))


def _first_order_share(log_transform: Array, phase: Array, frequency: Array) -> Array:
    """Share of the amplitude [1] that reflects as waves of first order do, at the nodes of a table.

    Light of order n is scattered n times, and turns into that of tilted facets as 1 − 1/n. The mean of 1/n over the orders of the transform
    K is e^(−g) ∫ e^g K/g dg / K. Orders of roughness coarser than half the frequency do not count: what is scattered once by finer
    roughness, g S/σ² dimmed by that roughness, remains of first order.
    """
    step = np.diff(phase).reshape(-1, *(1,) * (log_transform.ndim - 1))
    # Between two nodes e^g K/g grows exponentially.
    growth = np.maximum(np.diff(log_transform, axis=0) + step, 1e-12)
    decay, here = np.exp(-growth), step * -np.expm1(-growth) / growth
    of_order = np.ones_like(log_transform)
    for row in range(1, phase.size):
        of_order[row] = (of_order[row - 1] * phase[row - 1] * decay[row - 1] + here[row - 1]) / phase[row]
    spectrum = np.exp(log_transform[0])
    level = spectrum if spectrum.ndim == 1 else spectrum.mean(axis=1)
    cumulative = np.append(0.0, np.cumsum(np.pi * np.diff(frequency**2) * (level[1:] + level[:-1]) / 2))
    finer = np.clip(1 - np.interp(frequency / 2, frequency, cumulative), 0.0, 1.0)
    dimmed = -phase[:, None] * finer
    once = np.exp(
        np.minimum(log_transform[0] + (dimmed if level is spectrum else dimmed[..., None]) - log_transform, 0.0)
    )
    return np.clip(np.maximum(of_order, once), _LEAST_FIRST_ORDER, 1.0)


@cached_by_content(8)
def _spline(values: Array) -> Array:
    """Coefficients of a cubic spline over phase variance and frequency, and around half a turn of azimuth if there is one."""
    return _periodic_spline(values) if values.ndim == 3 else np.asarray(spline_filter(values, order=3, mode="mirror"))


def _periodic_spline(values: Array) -> Array:
    """Coefficients of a cubic spline over phase variance and frequency, and around half a turn of azimuth, whose ends are wrapped."""
    for axis in (0, 1):
        values = np.asarray(spline_filter1d(values, order=3, axis=axis, mode="mirror"))
    values = np.asarray(spline_filter1d(values, order=3, axis=2, mode="grid-wrap"))
    return np.concatenate([values[..., -_WRAPPED:], values, values[..., :_WRAPPED]], axis=2)


def _closed_form(bsdf: xr.Dataset) -> Callable[[Array], Array] | None:
    spectrum = bsdf.attrs["spectrum"]
    if spectrum == "measured":
        return None
    length = float(bsdf["fit_length"])
    if spectrum == "gaussian":
        return lambda f: np.pi * length**2 * np.exp(-((np.pi * length * f) ** 2))
    slope = float(bsdf["fit_slope"])
    return lambda f: 2 * np.pi * length**2 * (slope - 2) * (1 + (2 * np.pi * length * f) ** 2) ** (-slope / 2)
