"""The representation ``wave``: coherent mirror reflection, wave-optical halo, and a diffuse base."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from functools import cached_property, partial
from typing import NamedTuple, Self

import numpy as np
import xarray as xr

from brdfpipe import hemisphere, vocabulary
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.coupled_base import CoupledBase, ellipse_of
from brdfpipe.bsdf.microfacet.albedo_table import AlbedoTable
from brdfpipe.bsdf.microfacet.microsurface import NOT_PHYSICAL, Microsurface
from brdfpipe.bsdf.representations.microfacet import Microfacet
from brdfpipe.bsdf.spectral import at_wavelengths, only_once, per_wavelength, spectral_values
from brdfpipe.bsdf.wave.two_scale import Angles, RoughSurface
from brdfpipe.facets.planar_density import Ellipse
from brdfpipe.geometry import Array, as_numbers
from brdfpipe.optics.fresnel_equations import fresnel, reflectance_of

_MIXTURE_NODES = 8
"""Wavelengths that stand for a spectral mean: exact for a polynomial of degree 15 in the wavelength."""


_VALUES_TOGETHER = 2**21
"""Values of several BSDFs that are computed together."""

_MIXED_OR_NOT = (("wavelength",), ("mixed",))
_BY_INCIDENCE = (("theta_i", "wavelength"), ("theta_i",))
_BY_DIRECTION = (*_BY_INCIDENCE, ("theta_i", "phi_i", "wavelength"), ("theta_i", "phi_i"))

_CLOSURE = [("closure_incidence", "closure_wavelength"), ("closure_incidence", "closure_arc", "closure_wavelength")]

_FACETS = {**Microfacet.kind.required, **Microfacet.kind.optional}
"""Variables of the facets' BSDF."""


class _Spectral(NamedTuple):
    """Fields at a set of wavelengths, or of a mixture of wavelengths."""

    wavelength: Array
    n: Array
    k: Array
    base: CoupledBase
    excess: AlbedoTable
    mixture: Array | None
    """(wavelength,) weights of sum 1 of coherent part and halo; None without a mixture"""

    def mixed(self, values: Array) -> Array:
        """Values (…, wavelength); averaged to (…, 1) for a mixture."""
        return values if self.mixture is None else np.asarray(values @ self.mixture[:, None])


CHANGES_OF_SURFACE = frozenset({"slope_density", "lambda_smith", "sigma", "log_halo", "halo_closure", "coherent_loss"})
"""Variables of the light that the surface scatters, which do not enter the base and the balance of energy."""


def _split(angles: Angles, parts: int) -> Iterator[Angles]:
    """Directions in parts of equal size."""
    one, two, three, four = (np.array_split(angle, parts) for angle in angles)
    return zip(one, two, three, four, strict=True)


def _same(one: xr.Variable, other: xr.Variable) -> bool:
    return one.data is other.data or bool(np.array_equal(one.values, other.values))


def _mixed(dims: tuple[str, ...]) -> tuple[str, ...]:
    """Dimensions of a mean over wavelengths, of which a few stand for all."""
    return tuple("mixed" if dim == "wavelength" else dim for dim in dims)


def _spectral_at(bsdf: xr.Dataset, wavelength: Array | None) -> _Spectral:
    """Fields of a ``bsdf`` dataset at wavelengths [nm], None for its own."""
    excess = spectral_values(bsdf, "coherent_excess", wavelength)
    lay = "phi_i" in bsdf.variables["coherent_excess"].dims
    around = (bsdf.variables["phi_i"].values, ellipse_of(bsdf)) if lay else (None, None)
    fields = CoupledBase.of(bsdf, wavelength), AlbedoTable(bsdf.variables["theta_i"].values, excess, *around)
    if "mixture" in bsdf:
        wavelength, n, k, mixture = (bsdf.variables[name].values for name in ("mixed_wavelength", "n", "k", "mixture"))
        return _Spectral(wavelength, n, k, *fields, mixture)
    used = bsdf["wavelength"].values if wavelength is None else np.asarray(wavelength, dtype=float)
    n, k = (spectral_values(bsdf, name, wavelength) for name in ("n", "k"))
    return _Spectral(used, n, k, *fields, None)


class Wave(Representation):
    """A surface that reflects coherently, scatters as waves do and mirrors by facets, over a diffuse base.

    Its dataset holds the facets' BSDF too, with its own names, unless the surface has none.
    """

    name = "wave"
    kind = vocabulary.Kind(
        required={
            "sigma": vocabulary.SCALAR,
            **dict.fromkeys(("n", "k"), _MIXED_OR_NOT),
            **dict.fromkeys(("diffuse", "mean_albedo"), vocabulary.SPECTRAL),
            "directional_albedo": _BY_DIRECTION,
            "coherent_excess": _BY_DIRECTION,
            "energy_residual": vocabulary.SCALAR,
        },
        optional={
            **{name: [*dims, *map(_mixed, dims)] for name, dims in _FACETS.items()},
            "log_halo": [("phase_variance", "halo_frequency"), ("phase_variance", "halo_frequency", "halo_azimuth")],
            **dict.fromkeys(("halo_lay", "halo_stretch"), vocabulary.SCALAR),
            **dict.fromkeys(("frequency_scale", "fit_length", "fit_slope", "theta_m"), vocabulary.SCALAR),
            "total_reflectance": vocabulary.SPECTRAL,
            **dict.fromkeys(("mixture", "mixed_wavelength"), _MIXED_OR_NOT[1:]),
            "log_fine_halo": [("fine_phase_variance", "fine_frequency")],
            **dict.fromkeys(
                ("fine_scale", "fine_sigma", "facet_sigma", "resolved_slope", "passage_phase", "cut_error"),
                vocabulary.SCALAR,
            ),
            "facet_share": _BY_INCIDENCE,
            "halo_closure": _CLOSURE,
            "coherent_loss": _CLOSURE,
        },
        attributes=("optics", "form", "spectrum", "diffuse_mode", "transmission"),
        missing=("fit_slope",),
    )
    uses_index = True
    transmittance_needs_quadrature = False

    def __init__(self, dataset: xr.Dataset) -> None:
        super().__init__(dataset)
        # Functions of the dataset, not of this object, which would keep itself alive.
        spectral = per_wavelength(lambda wavelength: _spectral_at(dataset, wavelength))
        self._spectral = spectral
        self._reflectance = per_wavelength(lambda wavelength: reflectance_of(*spectral(wavelength)[1:3]))

    @cached_property
    def _surface(self) -> RoughSurface:
        return RoughSurface.of(self.dataset)

    def with_changed(self, dataset: xr.Dataset, names: Collection[str]) -> Self:
        """See the base class."""
        made = type(self)(dataset)
        if set(names) <= CHANGES_OF_SURFACE:
            made._spectral, made._reflectance = self._spectral, self._reflectance
            made.__dict__["_surface"] = self._surface.with_changed(dataset, names)
        elif set(names) <= {"diffuse"}:
            made.__dict__["_surface"] = self._surface
        return made

    def evaluate_each(
        self,
        others: Sequence[Representation],
        theta_i: Array,
        phi_i: Array,
        theta_o: Array,
        phi_o: Array,
        wavelength: Array | None,
    ) -> list[Array]:
        """See the base class; surfaces of one body and bases of one surface share what is the same."""
        at, shape, angles = self._prepared(theta_i, phi_i, theta_o, phi_o, wavelength)
        family = [self, *(one for one in others if isinstance(one, Wave) and self._has_body_of(one))]
        # All values of all BSDFs may not fit into the memory; equal parts are computed in the same way.
        parts = -(-angles[0].size * at.wavelength.size * len(family) // _VALUES_TOGETHER)
        blocks = [self._of_family(family, at, block, wavelength) for block in _split(angles, max(parts, 1))]
        found = {
            id(one): brdf for one, brdf in zip(family, map(np.concatenate, zip(*blocks, strict=True)), strict=True)
        }
        return [
            found[id(one)].reshape(*shape, found[id(one)].shape[-1])
            if id(one) in found
            else one.evaluate(theta_i, phi_i, theta_o, phi_o, wavelength)
            for one in (self, *others)
        ]

    @staticmethod
    def _of_family(family: Sequence[Wave], at: _Spectral, angles: Angles, wavelength: Array | None) -> list[Array]:
        """Values of BSDFs of one body, (directions, wavelength) each."""
        surfaces = list({id(one._surface): one._surface for one in family}.values())
        each = RoughSurface.evaluate_each(surfaces, angles, at.wavelength, at.n, at.k)
        of_surfaces = {id(surface): at.mixed(brdf) for surface, brdf in zip(surfaces, each, strict=True)}
        once = only_once()
        values = []
        for one in family:
            fields = one._spectral(wavelength)
            base = once((id(fields),), partial(one._base, fields, angles))
            values.append(of_surfaces[id(one._surface)] + base)
        return values

    def _has_body_of(self, other: Wave) -> bool:
        """Whether another BSDF, made by :meth:`with_changed`, has the same index and mixture of wavelengths."""
        names = ("n", "k", "mixture", "mixed_wavelength")
        own, others = self.dataset.variables, other.dataset.variables
        return all(
            (name in own) == (name in others) and (name not in own or _same(own[name], others[name])) for name in names
        )

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        one = as_numbers(theta_i, phi_i, theta_o, phi_o)
        if one is not None:
            at = self._spectral(wavelength)
            if not (one[0] < 90 and one[2] < 90):
                return np.zeros(1 if at.mixture is not None else at.wavelength.size)
            surface = at.mixed(
                self._surface.of_pairs(one, at.wavelength, at.n, at.k, reflectance=self._reflectance(wavelength))
            )
            return surface + at.base.brdf(one[0], one[2], one[1], one[3])
        at, shape, angles = self._prepared(theta_i, phi_i, theta_o, phi_o, wavelength)
        brdf = at.mixed(self._surface.evaluate(angles, at.wavelength, at.n, at.k)) + self._base(at, angles)
        return brdf.reshape(*shape, brdf.shape[-1])

    def mueller(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        """Frames as in :mod:`brdfpipe.bsdf.microfacet.polarised`; the coherent part is not included."""
        at, shape, angles = self._prepared(theta_i, phi_i, theta_o, phi_o, wavelength)
        matrix = self._surface.mueller(angles, at.wavelength, at.n, at.k)
        matrix = np.moveaxis(at.mixed(np.moveaxis(matrix, 1, -1)), -1, 1)
        matrix[..., 0, 0] += self._base(at, angles)
        return matrix.reshape(*shape, *matrix.shape[1:])

    def _prepared(
        self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None
    ) -> tuple[_Spectral, tuple[int, ...], Angles]:
        angles = np.broadcast_arrays(theta_i, phi_i, theta_o, phi_o)
        one, two, three, four = (np.asarray(angle, dtype=float).reshape(-1) for angle in angles)
        return self._spectral(wavelength), angles[0].shape, (one, two, three, four)

    def _base(self, at: _Spectral, angles: Angles) -> Array:
        """BRDF of the diffuse base [sr-1], (directions, wavelength)."""
        theta_i, phi_i, theta_o, phi_o = angles
        above = ((theta_i < 90) & (theta_o < 90))[:, None]
        brdf = at.base.brdf(np.minimum(theta_i, 90.0), np.minimum(theta_o, 90.0), phi_i, phi_o)
        return np.where(above, brdf, 0.0)

    def albedo(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        return self._spectral(wavelength).base.total_albedo(np.asarray(theta_i, dtype=float), phi_i)

    def specular(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> tuple[Array, Array]:
        at, (theta, phi) = (
            self._spectral(wavelength),
            np.broadcast_arrays(np.asarray(theta_i, float), np.asarray(phi_i, float)),
        )
        cosine = np.where(theta >= 90, 0.0, np.cos(np.radians(theta)))
        share = self._surface.coherent_share(theta, phi, at.wavelength)
        coherent = fresnel(cosine[..., None], at.n, at.k).mean * share
        reflected = np.maximum(at.mixed(coherent) - at.excess(np.minimum(theta, 90.0), phi), 0.0)
        return np.where((theta >= 90)[..., None], 0.0, reflected), np.zeros_like(reflected)

    def regime(self, theta_i: Array, wavelength: Array) -> tuple[Array, Array]:
        """Shares of the reflection towards the mirror direction that are coherent, and as of facets [1], (incidences, wavelength) each.

        With a lay the mean over azimuth.
        """
        share = self._surface.facet_share(2 * np.cos(np.radians(theta_i)), wavelength)
        azimuths = hemisphere.azimuths(self.isotropic)
        return self._surface.coherent_share(theta_i[:, None], azimuths, wavelength).mean(axis=1), share

    @property
    def albedo_needs_quadrature(self) -> bool:
        return False

    @property
    def isotropic(self) -> bool:
        return (
            "phi_i" not in self.dataset.variables["directional_albedo"].dims and "halo_azimuth" not in self.dataset.dims
        )

    @property
    def mirror_symmetric(self) -> bool:
        return self.isotropic

    @property
    def lay(self) -> float | None:
        # Of the facets where there are some: theirs is the one that the page names.
        if "lay" in self.dataset or "halo_lay" not in self.dataset:
            return super().lay
        return float(self.dataset["halo_lay"]) % 180

    @cached_property
    def lobe_slope(self) -> float:
        """Facet slope at which the halo has half its peak, at normal incidence and the middle wavelength, or of the facets if smaller."""
        return self._lobe_slopes(0.0)

    def lobe_slope_at(self, theta_i: float) -> float:
        """See the base class. Towards grazing incidence the phase variance falls, and light of first order by long waves is the narrowest part."""
        return min(self.lobe_slope, self._lobe_slopes(theta_i))

    @cached_property
    def _lobe_slopes(self) -> Callable[[float], float]:
        return self.lobe_slopes_of(self.dataset)

    @staticmethod
    def lobe_slopes_of(bsdf: xr.Dataset) -> Callable[[float], float]:
        """That of a ``bsdf`` dataset, as a function of the incidence [degree]; the dataset is read once."""
        of_facets = Microsurface.of(bsdf).typical_slope if "slope_density" in bsdf else 1.0
        of_halo = Wave._halo_slopes(bsdf)
        return lambda theta_i: min(of_halo(theta_i), of_facets)

    @staticmethod
    def widths_of(bsdf: xr.Dataset) -> tuple[float, float]:
        """Slopes along the lay and across it over which the halo or the facets of a ``bsdf`` dataset vary, whichever is narrower."""
        of_halo = Wave._halo_slopes(bsdf)(0.0)
        squared = float(bsdf["halo_stretch"]) ** 2 if "halo_stretch" in bsdf else 1.0
        widths = of_halo, of_halo * squared
        if "slope_along" not in bsdf.coords:
            return widths
        ellipse = Ellipse.of(bsdf)
        return min(widths[0], ellipse.along), min(widths[1], ellipse.across)

    @staticmethod
    def _halo_slopes(bsdf: xr.Dataset) -> Callable[[float], float]:
        """Slope at which the halo has half its peak, as a function of the incidence [degree], with a lay along it; 1 without a halo."""
        if "log_halo" not in bsdf:
            return lambda theta_i: 1.0
        wavelength = bsdf["mixed_wavelength" if "mixture" in bsdf else "wavelength"].values
        middle, sigma = float(wavelength[wavelength.size // 2]) * 1e-3, float(bsdf["sigma"])
        phase, frequency, log_halo = (bsdf[name].values for name in ("phase_variance", "halo_frequency", "log_halo"))
        if log_halo.ndim == 3:
            log_halo, frequency = log_halo.max(axis=2), frequency / float(bsdf["halo_stretch"])

        def at_incidence(theta_i: float) -> float:
            both = 2 * max(np.cos(np.radians(theta_i)), 1e-3)
            values = log_halo[np.argmin(np.abs(phase - (2 * np.pi * both * sigma / middle) ** 2))]
            # A measured spectrum has no heights longer than the scan, and its halo a dip in the middle.
            below = (values < values.max() - np.log(2)) & (np.arange(values.size) > values.argmax())
            half = frequency[below.argmax()] if below.any() else frequency[-1]
            return float(np.clip(half * middle / both, 1e-9, 1.0))

        return at_incidence

    def nonspectral(self, weight: Array) -> xr.Dataset:
        """The mean over wavelength. Coherent part and halo are evaluated at a few wavelengths that stand for all of them."""
        bsdf = self.dataset
        wavelength, mixture = _gauss_nodes(bsdf["wavelength"].values, weight)
        kept = bsdf.drop_dims("wavelength").drop_vars("facet_share", errors="ignore")
        means = {
            name: (bsdf[name].dims[:-1], bsdf[name].values @ weight)
            for name in ("directional_albedo", "coherent_excess", "mean_albedo", "total_reflectance")
            if name in bsdf
        }
        at_nodes = {
            name: (_mixed(tuple(map(str, bsdf[name].dims))), at_wavelengths(bsdf[name], wavelength))
            for name in ("n", "k", *_FACETS)
            if name in bsdf and "wavelength" in bsdf[name].dims and name not in (*means, "diffuse", "diffuse_quality")
        }
        at_measured = bsdf["directional_albedo"].sel(theta_i=float(bsdf["theta_m"]))
        entering = 1 - (at_measured.mean("phi_i") if "phi_i" in at_measured.dims else at_measured).values
        base = float(weight @ (bsdf["diffuse"].values * entering)) / max(float(weight @ entering), 1e-12)
        reduced = kept.assign(means | at_nodes).assign(
            mixture=("mixed", mixture),
            mixed_wavelength=("mixed", wavelength),
            diffuse=base,
        )
        return vocabulary.label(reduced, "bsdf")

    def mean_index(self, weight: Array) -> tuple[float, float] | None:
        n, k = self.dataset["n"].values, self.dataset["k"].values
        return (float(weight @ n), float(weight @ k)) if np.ptp(n) or np.ptp(k) else None

    def without_diffuse(self) -> xr.Dataset:
        return self._without_diffuse

    @cached_property
    def _without_diffuse(self) -> xr.Dataset:
        """One dataset for all who ask, so that its representation is prepared once."""
        bsdf = self.dataset
        nothing = {"diffuse": np.zeros_like(bsdf.variables["diffuse"].values)}
        return bsdf.copy(data={name: nothing.get(str(name), bsdf.variables[name].data) for name in bsdf.data_vars})

    @property
    def unphysical_choice(self) -> str:
        if self.dataset.attrs["form"] == "rayleigh-rice" and "log_halo" in self.dataset:
            return "form rayleigh-rice"
        masking = self.dataset.attrs.get("masking")
        return f"masking {masking}" if masking in NOT_PHYSICAL else ""


def _gauss_nodes(wavelength: Array, weight: Array) -> tuple[Array, Array]:
    """Wavelengths and weights of a Gauss quadrature of the discrete weights (Golub & Welsch 1969, by Lanczos' recurrence)."""
    used = weight > 0
    x, w = wavelength[used], weight[used]
    if x.size <= _MIXTURE_NODES:
        return x, w
    centre, half = (x[0] + x[-1]) / 2, (x[-1] - x[0]) / 2
    vectors = [np.sqrt(w / w.sum())]
    diagonal, beside = [], []
    for _ in range(_MIXTURE_NODES):
        product = (x - centre) / half * vectors[-1]
        diagonal.append(float(vectors[-1] @ product))
        for vector in vectors:
            product = product - (vector @ product) * vector
        beside.append(float(np.linalg.norm(product)))
        vectors.append(product / beside[-1])
    values, basis = np.linalg.eigh(np.diag(diagonal) + np.diag(beside[:-1], 1) + np.diag(beside[:-1], -1))
    return np.asarray(centre + half * values), np.asarray(w.sum() * basis[0] ** 2)
