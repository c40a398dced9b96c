"""The interface of a representation of a BSDF; every quantity but ``evaluate`` has a default that is derived from it."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from typing import ClassVar, NamedTuple, Self

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import hemisphere, vocabulary
from brdfpipe.bsdf import sampling, sphere_cubature
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array

QUADRATURE_ACCURACY = 1e-6
"""Relative error of integrals by adaptive cubature, unless a representation sets its own."""

_ALBEDO_ACCURACY = 1e-8
"""Error of an albedo interpolated from a table [1]: reflectance and transmittance are interpolated to 2e-9 each."""

UNRESOLVED_SLOPE = 1e-6
"""Lobe slope of a perfectly smooth surface: no instrument resolves it."""


class Integral(NamedTuple):
    """∫ f |cos θ_o| dω_o over one side of the surface, by quadrature."""

    value: Array
    """(incidences…, wavelength or 1)"""
    error: Array
    """Estimated error of the quadrature, same shape; valid for lobes that :meth:`Representation.integrate` resolves"""


class Representation(ABC):
    """A ``bsdf`` dataset of one representation, prepared for evaluation on plain arrays.

    Angles are in degree and wavelengths in nm; ``wavelength=None`` means those of the dataset. All directions have the same shape.
    Results have the wavelength as an additional last dimension, (directions…, wavelength), of length 1 if they do not depend on it.
    :func:`brdfpipe.bsdf.registry.representation` returns the instance of a dataset.

    Subclasses set ``name`` and ``kind`` and define ``evaluate`` and ``nonspectral``. They override a default that they can improve.
    """

    name: ClassVar[str]
    """Value of the dataset's attribute ``representation``."""
    kind: ClassVar[vocabulary.Kind]
    """Variables and attributes that the representation needs."""
    accuracy: ClassVar[float] = QUADRATURE_ACCURACY
    """Relative error to which integrals are computed."""
    states_uncertainty: ClassVar[bool] = False
    """Whether :meth:`uncertainty` and :meth:`albedo_uncertainty` are defined."""
    states_quality: ClassVar[bool] = False
    """Whether :meth:`quality` is defined, because the representation holds measured directions."""
    uses_index: ClassVar[bool] = False
    """Whether the reflection is computed from the refractive index ``n`` (and ``k``) of the dataset."""
    transmittance_needs_quadrature: ClassVar[bool] = True

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "name" in cls.__dict__:
            vocabulary.REPRESENTATIONS[cls.name] = cls.kind

    def __init__(self, dataset: xr.Dataset) -> None:
        self.dataset = dataset
        self.derived: dict[str, object] = {}
        """What other modules have prepared from it, by their names"""

    # --- values

    def with_changed(self, dataset: xr.Dataset, names: Collection[str]) -> Self:
        """The representation of the same dataset with other values of some variables; what does not follow from these may be shared."""
        return type(self)(dataset)

    def evaluate_each(
        self,
        others: Sequence[Representation],
        theta_i: Array,
        phi_i: Array,
        theta_o: Array,
        phi_o: Array,
        wavelength: Array | None,
    ) -> list[Array]:
        """:meth:`evaluate` of this BSDF and of others, which are made by :meth:`with_changed`."""
        return [one.evaluate(theta_i, phi_i, theta_o, phi_o, wavelength) for one in (self, *others)]

    @abstractmethod
    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        """BRDF or BTDF [sr-1], without perfectly specular parts."""

    @abstractmethod
    def nonspectral(self, weight: Array) -> xr.Dataset:
        """The dataset averaged over its wavelengths with weights of sum 1; see :func:`brdfpipe.bsdf.nonspectral.nonspectral`."""

    def averaged_change(self, name: str, change: Array, weight: Array) -> xr.Variable | None:
        """Change of a variable of :meth:`nonspectral` from that (changes, …) of the spectral one; None for the mean over wavelength."""
        return None

    def mean_index(self, weight: Array) -> tuple[float, float] | None:
        """n and k of :meth:`nonspectral`; None if the reflection is not computed from an index over wavelength."""
        return None

    def mueller(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        """Mueller matrix of the BRDF [sr-1], (directions…, wavelength, 4, 4); by default a perfect depolariser."""
        brdf = self.evaluate(theta_i, phi_i, theta_o, phi_o, wavelength)
        matrix = np.zeros((*brdf.shape, 4, 4))
        matrix[..., 0, 0] = brdf
        return matrix

    def uncertainty(
        self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None
    ) -> Array:
        """Standard uncertainty (k = 1) of :meth:`evaluate` [sr-1]; :class:`VocabularyError` unless ``states_uncertainty``."""
        raise self._undefined("uncertainty")

    def quality(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> NDArray[np.int8]:
        """Indices into ``vocabulary.QUALITY_FLAGS``, (directions…); :class:`VocabularyError` unless ``states_quality``."""
        raise self._undefined("quality")

    def tristimulus(
        self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, illuminant: str, observer: int
    ) -> Array | None:
        """X, Y and Z, (directions…, 3), of a BSDF that was fitted to colours under this illuminant and observer; otherwise None."""
        return None

    def stored_values(self) -> Array:
        """Values at the nodes of a linear interpolation, (nodes, wavelength or 1) [sr-1]; none by default."""
        return np.empty((0, 1))

    # --- shares of the light

    def albedo(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        """Directional reflectance [1], (incidences…, wavelength), mirror reflection included."""
        return self.integrate(theta_i, phi_i, wavelength).value + self.specular(theta_i, phi_i, wavelength)[0]

    def albedo_uncertainty(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        """Standard uncertainty (k = 1) of :meth:`albedo` [1]; :class:`VocabularyError` unless ``states_uncertainty``."""
        raise self._undefined("uncertainty")

    def transmittance(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        """Directional transmittance [1], (incidences…, wavelength), regular transmission included."""
        if not self.transmits:
            return np.zeros((*np.shape(theta_i), 1))
        scattered = self.integrate(theta_i, phi_i, wavelength, transmitted_side=True).value
        return scattered + self.specular(theta_i, phi_i, wavelength)[1]

    def specular(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> tuple[Array, Array]:
        """Mirror reflectance and regular transmittance [1], (incidences…, wavelength) each; not part of :meth:`evaluate`."""
        zero = np.zeros((*np.shape(theta_i), 1))
        return zero, zero

    @property
    def albedo_needs_quadrature(self) -> bool:
        return True

    @property
    def albedo_accuracy(self) -> float:
        """Error of :meth:`albedo` [1], by which it may exceed 1 although the BSDF conserves energy."""
        return self.accuracy if self.albedo_needs_quadrature else _ALBEDO_ACCURACY

    def total_reflectance(self) -> tuple[Array, Array]:
        """Wavelengths (360 and 780 nm if the BSDF does not depend on it), and the reflectance at 8 degree, mean over azimuth."""
        azimuths = hemisphere.azimuths(self.isotropic)
        return self._spectrum(self.albedo(np.full(azimuths.size, 8.0), azimuths, None).mean(axis=0))

    def total_transmittance(self) -> tuple[Array, Array]:
        """Wavelengths, and the total transmittance at normal incidence; otherwise as :meth:`total_reflectance`."""
        return self._spectrum(self.transmittance(np.zeros(1), np.zeros(1), None)[0])

    # --- symmetry, lobe, transmission

    @property
    def isotropic(self) -> bool:
        """Whether the BSDF depends on the azimuths only through their difference."""
        return True

    @property
    def mirror_symmetric(self) -> bool:
        """Whether values at φ_i + Δφ and φ_i − Δφ are equal, by the model's form, so that half of the azimuths have half of the light."""
        return False

    @property
    def lay(self) -> float | None:
        """Azimuth along the lay of the surface [degree], of an axis: from 0 to below 180; None if the surface is isotropic or the lay is unknown."""
        lay = math.nan if self.isotropic else float(self.dataset.get("lay", math.nan))
        return lay % 180 if math.isfinite(lay) else None

    @property
    def lobe_slope(self) -> float | None:
        """Typical slope of the facets that form the specular lobe [1]; None if it is unknown."""
        return None

    def lobe_slope_at(self, theta_i: float) -> float | None:
        """Slope over which the narrowest part of the lobe varies at an incidence [degree]; :attr:`lobe_slope` if that is the same at all."""
        return self.lobe_slope

    @property
    def halvings(self) -> int:
        """How often the cells of a quadrature halve towards the mirror direction, so that the narrowest lobe is not missed."""
        return sphere_cubature.HALVINGS

    @property
    def non_smooth_angles(self) -> tuple[Array, Array]:
        """θ_o, and φ_o − φ_i, at which the slope of the BSDF jumps [degree]; none by default."""
        return np.empty(0), np.empty(0)

    def stored_incidences(self) -> tuple[Array, Array]:
        """θ_i and φ_i of the nodes of a linear interpolation [degree]; none by default."""
        return np.empty(0), np.empty(0)

    @property
    def transmits(self) -> bool:
        """Whether light passes to the other side of the surface."""
        return bool(self.dataset.attrs.get("transmission", "none") != "none")

    @property
    def transmits_into_body(self) -> bool:
        """Whether transmitted light ends in the body below the surface."""
        return bool(self.dataset.attrs.get("transmission") == "interface")

    @property
    def is_slab(self) -> bool:
        """Whether transmitted light passes a body and ends in air."""
        return bool(self.dataset.attrs.get("transmission") == "slab")

    def index_below(self, wavelength: Array | None = None) -> float:
        """Refractive index of the medium behind the surface, mean over wavelength; 1 behind a slab, or if it is unknown."""
        if "n" not in self.dataset or self.is_slab:
            return 1.0
        n = self.dataset["n"]
        if wavelength is not None and "wavelength" in n.dims:
            return float(np.interp(wavelength, self.dataset["wavelength"].values, n.values).mean())
        return float(n.mean())

    def refracted(self, theta_i: Array, wavelength: Array | None = None) -> Array:
        """Polar angle of the refracted ray [degree], above 90 for light from above; NaN for total reflection."""
        theta_i = np.asarray(theta_i, dtype=float)
        index = self.index_below(wavelength)
        sine = np.sin(np.radians(theta_i)) * np.where(theta_i <= 90, 1 / index, index)
        inner = np.degrees(np.arcsin(np.where(sine <= 1, sine, np.nan)))
        return np.where(theta_i <= 90, 180 - inner, inner)

    # --- parts and limits of the model

    def without_diffuse(self) -> xr.Dataset | None:
        """The dataset without the light scattered below the surface; None if that is not a separate part."""
        return None

    def single_reflection(self) -> xr.Dataset | None:
        """The dataset of the light reflected once, as :meth:`without_diffuse`; None if that is not a separate part."""
        return None

    @property
    def unphysical_choice(self) -> str:
        """Option of the model that is known to violate energy conservation or reciprocity; empty if there is none."""
        return ""

    @property
    def gloss_caveat(self) -> str:
        """Why gloss computed from this BSDF is not that of the material; empty if it is."""
        return ""

    # --- integration and sampling

    def integrate(
        self,
        theta_i: Array,
        phi_i: Array,
        wavelength: Array | None,
        *,
        transmitted_side: bool = False,
        relative: float | None = None,
    ) -> Integral:
        """∫ f |cos θ_o| dω_o over the side of incidence, or the other side, without perfectly specular parts.

        Parameters
        ----------
        theta_i, phi_i : degree, of the same shape
        transmitted_side : integrate over the other side
        relative : relative error; by default ``accuracy``

        Notes
        -----
        Adaptive Genz–Malik cubature over :meth:`evaluate`. Cells are graded down to 0.001 degree towards the mirror direction, or the
        refracted and the straight direction, or to :attr:`halvings`: lobes about these are resolved at any width. Other lobes are resolved if they are wider
        than about 2 degree, or if :attr:`non_smooth_angles` gives their position.
        """
        incidences = np.atleast_1d(theta_i).ravel().astype(float), np.atleast_1d(phi_i).ravel().astype(float)
        if incidences[0].size == 0:
            empty = np.zeros((*np.shape(theta_i), 1))
            return Integral(empty, empty)
        edges = [self.quadrature_edges(*at, transmitted_side) for at in zip(*incidences, strict=True)]
        sides = 2 if self.mirror_symmetric else 1
        if sides == 2:
            edges = [(theta, phi[phi >= phi_i + 180]) for (theta, phi), phi_i in zip(edges, incidences[1], strict=True)]
        cells = [sphere_cubature.rectangles(theta, phi) for theta, phi in edges]
        owner = np.repeat(np.arange(len(cells)), [low.shape[0] for low, _ in cells])
        low, high = (np.concatenate(corners) for corners in zip(*cells, strict=True))
        rule = sphere_cubature.integral(self._integrand(*incidences, wavelength), self._wavelength_count(wavelength))
        mesh = sphere_cubature.refine((owner, low, high), rule, self.accuracy if relative is None else relative)
        shape = (*np.shape(theta_i), -1)
        value, error = (sides * mesh.totals(field, len(cells)).reshape(shape) for field in (mesh.value, mesh.error))
        return Integral(value, error)

    def distribution(self, theta_i: float, phi_i: float, wavelength: Array | None) -> sampling.Distribution:
        """Density from which outgoing directions are drawn, close to the mean over wavelength of f |cos θ_o|."""
        incidence = np.array([theta_i]), np.array([phi_i])
        theta, phi = self.quadrature_edges(theta_i, phi_i, transmitted_side=False)
        if self.transmits:
            theta = np.union1d(theta, self.quadrature_edges(theta_i, phi_i, transmitted_side=True)[0])
        shares = np.stack([share[0] for share in self.specular(*incidence, wavelength)])
        refracted = float(self.refracted(np.array(theta_i), wavelength)) if shares[1].mean() > 0 else 180 - theta_i
        rule = sphere_cubature.constant(self._integrand(*incidence, wavelength), self._wavelength_count(wavelength))
        rays = np.array([[theta_i, (phi_i + 180) % 360], [refracted, (phi_i + 180) % 360]])
        return sampling.Distribution.of((theta, phi), rule, shares, rays)

    def sample(self, n: int, seed: int, theta_i: float, phi_i: float, wavelength: Array | None) -> xr.Dataset:
        """Outgoing directions of one incidence, kind ``samples``; see :meth:`brdfpipe.bsdf.accessor.BSDFAccessor.sample`."""
        if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
            raise VocabularyError(f"number of samples is {n!r}; accepted: an integer >= 1")
        distribution = self.distribution(theta_i, phi_i, wavelength)
        samples = distribution.draw(int(n), np.random.default_rng(seed))
        scattered = ~samples.is_specular
        theta_o, phi_o = samples.theta[scattered], samples.phi[scattered]
        incidence = np.full_like(theta_o, theta_i), np.full_like(theta_o, phi_i)
        brdf = self.evaluate(*incidence, theta_o, phi_o, wavelength)
        weight = np.empty((samples.theta.size, self._wavelength_count(wavelength)))
        weight[scattered] = brdf * (np.abs(np.cos(np.radians(theta_o))) / samples.pdf[scattered])[:, None]
        for ray, probability in enumerate(distribution.specular_probability):
            if probability > 0:
                weight[samples.ray == ray] = distribution.specular_share[ray] / probability
        if wavelength is None and "wavelength" in self.dataset.coords:
            wavelength = self.dataset["wavelength"].values
        return sampling.as_dataset(samples, weight, (theta_i, phi_i), wavelength)

    def pdf(self, theta_i: float, phi_i: float, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        """Density with which :meth:`sample` draws outgoing directions [sr-1], without specular rays; of the directions' shape."""
        return self.distribution(theta_i, phi_i, wavelength).pdf(theta_o, phi_o)

    def _wavelength_count(self, wavelength: Array | None) -> int:
        return int(self.dataset.sizes.get("wavelength", 1)) if wavelength is None else max(1, wavelength.size)

    def quadrature_edges(self, theta_i: float, phi_i: float, transmitted_side: bool) -> tuple[Array, Array]:
        """Polar and azimuthal edges [degree] of cells that cover one side, graded towards possible lobes."""
        peaks = np.array([theta_i])
        if transmitted_side:
            peaks = np.array([180 - theta_i, float(self.refracted(np.array(theta_i)))])
        below = (theta_i > 90) != transmitted_side
        theta = sphere_cubature.theta_edges(peaks[np.isfinite(peaks)], below, self.halvings)
        phi = sphere_cubature.phi_edges(phi_i + 180, self.halvings)
        polar, azimuths = self.non_smooth_angles
        if polar.size or azimuths.size:
            azimuths = (azimuths + phi_i - phi[0]) % 360 + phi[0]
            theta = np.union1d(theta, polar[(polar > theta[0]) & (polar < theta[-1])])
            phi = np.union1d(phi, azimuths[(azimuths > phi[0]) & (azimuths < phi[-1])])
        return theta, phi

    def _integrand(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> sphere_cubature.Integrand:
        return lambda owner, theta_o, phi_o: self.evaluate(theta_i[owner], phi_i[owner], theta_o, phi_o, wavelength)

    def _spectrum(self, values: Array) -> tuple[Array, Array]:
        if "wavelength" not in self.dataset.coords:
            return np.array([360.0, 780.0]), np.repeat(values, 2)
        wavelength = self.dataset["wavelength"].values
        return wavelength, np.broadcast_to(values, wavelength.shape)

    def _undefined(self, quantity: str) -> VocabularyError:
        return VocabularyError(f"the representation {self.name!r} states no {quantity}")
