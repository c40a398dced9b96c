"""The representation ``kirchhoff``: light diffracted by a measured height map, after Kirchhoff's approximation, over a diffuse base."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import map_coordinates

from brdfpipe import vocabulary
from brdfpipe.bsdf.coupled_base import above_surface
from brdfpipe.bsdf.representations.coupled_surface import COUPLED_SURFACE, CoupledSurface
from brdfpipe.bsdf.spectral import at_wavelengths, per_wavelength
from brdfpipe.geometry import Array, HalfVector, half_vector
from brdfpipe.optics.fresnel_equations import fresnel

_NODES = ("phase_per_height", "spatial_frequency")
_MIXED = [("mixed",)]
_SPECTRAL = [("wavelength",), *_MIXED]
_CLOSER, _CLOSER_RINGS = 8, 6  # times as close are the nodes of q, and the rings of f, in evaluation
_WING = 0.02  # share of the diffracted light in the wing of a lobe
_LEAST_SHARE = 1e-3  # of a wavelength in a mean, over that of the heaviest


def _light_at(bsdf: xr.Dataset, wavelength: Array | None) -> _Light:
    """Light of a ``bsdf`` dataset at wavelengths [nm], None for its own."""
    if "mixture" in bsdf:
        return _Light(*(bsdf[name].values for name in ("mixed_wavelength", "n", "k", "mixture")))
    used = bsdf["wavelength"].values if wavelength is None else np.asarray(wavelength, dtype=float)
    return _Light(used, at_wavelengths(bsdf["n"], wavelength), at_wavelengths(bsdf["k"], wavelength), None)


class Kirchhoff(CoupledSurface):
    """Coherent mirror reflection and diffracted light f = F(ζ) U(q, f)/λ² of one map; F is Fresnel's reflectance of the half vector."""

    name = "kirchhoff"
    kind = vocabulary.Kind(
        required={
            "log_phase_spectrum": [_NODES],
            "log_phase_spectrum_change": [("block", *_NODES)],
            "coherent_share": [_NODES[:1]],
            "coherent_share_change": [("block", _NODES[0])],
            "frequency_scale": vocabulary.SCALAR,
            "measured_area": vocabulary.SCALAR,
            "n": _SPECTRAL,
            "k": _SPECTRAL,
            **COUPLED_SURFACE,
        },
        optional={
            "total_reflectance": vocabulary.SPECTRAL,
            "mixture": _MIXED,
            "mixed_wavelength": _MIXED,
        },
        attributes=("band",),
    )
    accuracy = 1e-4

    def __init__(self, dataset: xr.Dataset) -> None:
        super().__init__(dataset)
        self._diffraction = Diffraction.of(dataset)
        # A function of the dataset, not of this object, which would keep itself alive.
        self._light = per_wavelength(lambda wavelength: _light_at(dataset, wavelength))

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        light, base = self._light(wavelength), self._base(wavelength)

        def values(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
            diffracted = self._diffraction.brdf(theta_i, phi_i, theta_o, phi_o, light.wavelength, light.n, light.k)
            return light.mixed(diffracted) + base.brdf(theta_i, theta_o)

        return above_surface(values, theta_i, phi_i, theta_o, phi_o, light.width)

    def uncertainty(
        self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None
    ) -> Array:
        """Of the finite map, from the scatter between its blocks, and by speckle; that of the coherent part is not included."""
        light = self._light(wavelength)

        def values(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
            return light.mixed(
                self._diffraction.brdf_u(theta_i, phi_i, theta_o, phi_o, light.wavelength, light.n, light.k)
            )

        return above_surface(values, theta_i, phi_i, theta_o, phi_o, light.width)

    @cached_property
    def changed(self) -> tuple[Kirchhoff, ...]:
        """The BSDF after each independent change of the light by one standard uncertainty of the finite map.

        The variance of anything that is computed from it is the sum of the squares of what the changes make of it.
        """
        plain, names = self.dataset.drop_dims("block"), ("log_phase_spectrum", "coherent_share")
        datasets = []
        for row in range(self.dataset.sizes["block"]):
            after = {name: self.dataset[name] + self.dataset[f"{name}_change"][row] for name in names}
            datasets.append(plain.assign(after | {"coherent_share": after["coherent_share"].clip(0, 1)}))
        return tuple(Kirchhoff(dataset) for dataset in datasets)

    def specular(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> tuple[Array, Array]:
        light, theta = self._light(wavelength), np.asarray(theta_i, dtype=float)
        cosine = np.where(theta < 90, np.cos(np.radians(theta)), 0.0)[..., None]
        coherent = fresnel(cosine, light.n, light.k).mean * self._diffraction.coherent_share(cosine, light.wavelength)
        reflected = np.where((theta < 90)[..., None], light.mixed(coherent), 0.0)
        return reflected, np.zeros_like(reflected)

    def albedo_uncertainty(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        """0: coherent and diffracted light together are what the map returns, whatever its heights."""
        return np.zeros_like(self.albedo(theta_i, phi_i, wavelength))

    @property
    def lobe_slope(self) -> float:
        """Slope of the half vector at which the diffracted light has half its peak, at normal incidence and the middle wavelength."""
        wavelength = self._light(None).wavelength
        return self._diffraction.lobe_slope(float(wavelength[wavelength.size // 2]))

    def nonspectral(self, weight: Array) -> xr.Dataset:
        """The mean over wavelength: every wavelength of weight is evaluated before averaging."""
        bsdf = self.dataset
        heavy = np.abs(weight) >= _LEAST_SHARE * np.abs(weight).max()
        mixed = {"mixture": weight[heavy] / weight[heavy].sum(), "mixed_wavelength": bsdf["wavelength"].values[heavy]}
        mixed |= {name: bsdf[name].values[heavy] for name in ("n", "k")}
        reduced = self._without_wavelength(weight)
        return vocabulary.label(reduced.assign({name: ("mixed", values) for name, values in mixed.items()}), "bsdf")

    def mean_index(self, weight: Array) -> tuple[float, float] | None:
        n, k = self.dataset["n"].values, self.dataset["k"].values
        return (float(weight @ n), float(weight @ k)) if np.ptp(n) or np.ptp(k) else None


class _Light(NamedTuple):
    """Wavelengths [nm] and indices, and the weights of their mean (None: no mean)."""

    wavelength: Array
    n: Array
    k: Array
    mixture: Array | None

    @property
    def width(self) -> int:
        return 1 if self.mixture is not None else self.wavelength.size

    def mixed(self, values: Array) -> Array:
        return values if self.mixture is None else np.asarray(values @ self.mixture[:, None])


class Diffraction(NamedTuple):
    """The spectrum of the phase of one map, prepared for evaluation."""

    spectrum: Array
    """U/q² [um2 per (rad/um)²], (q, f), with nodes of q so close that both axes are linear between them"""
    relative_u: Array
    coherent: Array
    """Share of the mirror reflection, with the close nodes of q"""
    phase: Array
    frequency: Array
    scale: float
    """Nodes are evenly spaced in ln q, and in asinh(f/scale)"""

    @classmethod
    def of(cls, bsdf: xr.Dataset) -> Diffraction:
        values = bsdf["log_phase_spectrum"].values
        node = np.arange(values.shape[0])
        close = np.linspace(0, node[-1], _CLOSER * node[-1] + 1)
        return cls(
            _between_rings(np.exp(PchipInterpolator(node, values)(close)), bsdf[_NODES[1]].values),
            _relative_u(bsdf),
            PchipInterpolator(node, bsdf["coherent_share"].values)(close),
            bsdf[_NODES[0]].values,
            bsdf[_NODES[1]].values,
            float(bsdf["frequency_scale"]),
        )

    def brdf(
        self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array, n: Array, k: Array
    ) -> Array:
        """Of the diffracted light [sr-1], (directions…, wavelength); both directions above the surface."""
        pair = half_vector(theta_i, phi_i, theta_o, phi_o)
        phase, row, column, sampled = self._position(pair, wavelength)
        at = _CLOSER * row, _CLOSER_RINGS * column
        spectrum = map_coordinates(self.spectrum, at, order=1, mode="nearest") * phase**2
        return np.where(
            sampled, fresnel(pair.cos_zeta[..., None], n, k).mean * spectrum / (wavelength * 1e-3) ** 2, 0.0
        )

    def brdf_u(
        self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array, n: Array, k: Array
    ) -> Array:
        """Standard uncertainty of :meth:`brdf`."""
        _, row, column, _ = self._position(half_vector(theta_i, phi_i, theta_o, phi_o), wavelength)
        relative = map_coordinates(self.relative_u, [row, column], order=1, mode="nearest")
        return relative * self.brdf(theta_i, phi_i, theta_o, phi_o, wavelength, n, k)

    def _position(self, pair: HalfVector, wavelength: Array) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
        """q, its row and the column of f in the table, and whether the pitch of the map samples f, (directions…, wavelength) each."""
        um, cosines = wavelength * 1e-3, (pair.cos_i + pair.cos_o)[..., None]
        phase, frequency = 2 * np.pi * cosines / um, np.sqrt(pair.slope_squared)[..., None] * cosines / um
        with np.errstate(divide="ignore"):
            row = np.log(phase / self.phase[0]) / np.log(self.phase[1] / self.phase[0])
        column = np.arcsinh(frequency / self.scale) / np.arcsinh(self.frequency[1] / self.scale)
        # Below the first node U grows as q².
        return (
            phase,
            np.maximum(row, 0.0),
            np.minimum(column, self.frequency.size - 1.0),
            frequency <= self.frequency[-1],
        )

    def coherent_share(self, cosine: Array, wavelength: Array) -> Array:
        """Share of the mirror reflection that is coherent, of cos θ_i (…, 1) at wavelengths [nm]."""
        phase = 4e3 * np.pi * cosine / wavelength
        share = np.interp(phase, np.geomspace(self.phase[0], self.phase[-1], self.coherent.size), self.coherent)
        below = np.minimum(phase / self.phase[0], 1.0) ** 2
        return np.where(phase < self.phase[0], 1 - below * (1 - self.coherent[0]), share)

    def at_phase(self, phase: float) -> tuple[Array, Array]:
        """Frequencies [um-1], six to a ring, and the spectrum U [um2] there at one q [rad/um]."""
        number = np.arange(self.spectrum.shape[1]) / _CLOSER_RINGS
        ring = np.arcsinh(self.frequency[1] / self.scale)
        row = max(np.log(phase / self.phase[0]) / np.log(self.phase[1] / self.phase[0]), 0.0)
        at = np.full(number.size, _CLOSER * row), np.arange(number.size)
        values = map_coordinates(self.spectrum, at, order=1, mode="nearest") * phase**2
        return self.scale * np.sinh(ring * number), values

    def lobe_slope(self, wavelength: float) -> float:
        """Slope at which the light has half its peak, at normal incidence and a wavelength [nm]."""
        row = int(np.argmin(np.abs(self.phase - 4e3 * np.pi / wavelength)))
        values = self.spectrum[_CLOSER * row, ::_CLOSER_RINGS]
        # By chance the peak of a map may be low; a Gaussian lobe has a quarter of its light within 0.644 of that slope.
        light = cumulative_trapezoid(values * self.frequency, self.frequency, initial=0)
        quarter = float(np.interp(light[-1] / 4, light, self.frequency)) / 0.644
        below = values < values[0] / 2
        half = float(self.frequency[below.argmax()]) if below.any() else float(self.frequency[-1])
        return min(half, quarter) * wavelength * 1e-3 / 2


def _between_rings(spectrum: Array, frequency: Array) -> Array:
    """Spectrum (q, rings) at closer frequencies: linear, but exponential beyond nearly all light, where it falls steadily.

    A ring has the mean of a triangle that reaches its neighbours, 2(cosh b − 1)/b² of the value in its middle where the spectrum falls by b from
    ring to ring.
    """
    light = cumulative_trapezoid(spectrum * frequency, frequency, axis=1, initial=0)
    wing = light > (1 - _WING) * light[:, -1:]
    fall = -np.diff(np.log(spectrum), axis=1, prepend=np.log(spectrum[:, :1]), append=np.log(spectrum[:, -1:]))
    steady = np.maximum(wing * np.abs(_steady(fall[:, :-1], fall[:, 1:])), 1e-3)
    middle = spectrum * steady**2 / (2 * (np.cosh(steady) - 1))
    fall = np.diff(-np.log(middle), axis=1)
    before, after = fall[:, np.maximum(np.arange(fall.shape[1]) - 1, 0)], np.append(fall[:, 1:], fall[:, -1:], axis=1)
    exponent = (wing[:, :-1] * _steady(_steady(before, fall), after))[..., None]
    part = np.arange(_CLOSER_RINGS) / _CLOSER_RINGS
    straight = (1 - part) * middle[:, :-1, None] + part * middle[:, 1:, None] * np.exp(exponent)
    closer = (straight * np.exp(-exponent * part)).reshape(len(spectrum), -1)
    return np.append(closer, middle[:, -1:], axis=1)


def _steady(one: Array, other: Array) -> Array:
    """The smaller of two falls, 0 where one rises and the other falls."""
    return np.where(one * other > 0, np.copysign(np.minimum(np.abs(one), np.abs(other)), one), 0.0)


def _relative_u(bsdf: xr.Dataset) -> Array:
    """Relative standard uncertainty of the spectrum (q, f): the scatter between blocks of the map; 0 without changes.

    Next to the mirror direction a block has no mode that is as slow, and blocks agree by chance: there it is at least that by speckle.
    """
    if "log_phase_spectrum_change" not in bsdf:
        return np.zeros(bsdf["log_phase_spectrum"].shape)
    changes = bsdf["log_phase_spectrum_change"].values
    between_blocks, modes = np.sqrt(np.square(np.expm1(changes)).sum(axis=0)), _modes(bsdf)
    # The powers of modes scatter by all of their mean, f and −f together. A ring is the mean of a triangle of them that reaches its neighbours:
    # ∫w²/(∫w)² is two thirds of one over its area.
    by_speckle = np.sqrt(2 * 2 / 3 / modes)
    return np.where(modes < len(changes), np.maximum(between_blocks, by_speckle), between_blocks)


def _modes(bsdf: xr.Dataset) -> Array:
    """Number of modes of the map in every ring (q, f), one for an area of 1/A in frequency; at least one."""
    frequency, spectrum = bsdf[_NODES[1]].values, bsdf["log_phase_spectrum"].values
    area = 2 * np.pi * frequency * np.gradient(frequency)
    area[0] = np.pi * frequency[1] ** 2 / 3
    # The innermost rings that have one value are one.
    one = np.cumprod(spectrum == spectrum[:, :1], axis=1)
    rings = np.where(one, (one * area).sum(axis=1, keepdims=True), area)
    return np.maximum(float(bsdf["measured_area"]) * rings, 1.0)
