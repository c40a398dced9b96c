"""The representations ``microfacet`` and ``smooth``: an interface over a diffuse base, or over a transparent body."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from functools import cache
from typing import Self

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.base import UNRESOLVED_SLOPE, Representation
from brdfpipe.bsdf.microfacet.microsurface import NOT_PHYSICAL, Microsurface
from brdfpipe.bsdf.microfacet.model import Model, mean_index, with_mean_index
from brdfpipe.bsdf.spectral import OnlyOnce, each_time, per_wavelength
from brdfpipe.geometry import Array, HalfVector

_SEVERAL = ("furnace_albedo", "second_reflection")
"""Variables of light that is reflected more than once."""

OF_FACETS = frozenset({"slope_density", "lambda_smith"})
"""Variables of the facets' density and masking alone."""

_LAY_ALBEDO_ACCURACY = 2e-4
"""Tables of the albedo over two angles agree with the integral to about 1e-4."""


class Interface(Representation):
    """Base class of rough and of perfectly smooth interfaces."""

    uses_index = True
    transmittance_needs_quadrature = False

    def __init__(self, dataset: xr.Dataset) -> None:
        super().__init__(dataset)
        # Functions of the dataset, not of this object, which would keep itself alive.
        surface = cache(lambda: Microsurface.of(dataset) if "slope_density" in dataset else None)
        self._surface = surface
        self._model = per_wavelength(lambda wavelength: Model.of(dataset, wavelength, surface()))

    def with_changed(self, dataset: xr.Dataset, names: Collection[str]) -> Self:
        """See the base class; tables of albedos and of further reflections do not follow from the facets' density and masking."""
        made = type(self)(dataset)
        if not (set(names) <= OF_FACETS and self.isotropic):
            return made
        given_surface, given_model = self._surface, self._model

        def changed_surface() -> Microsurface | None:
            given = given_surface()
            return None if given is None else given.with_density(dataset)

        surface = cache(changed_surface)
        made._surface = surface
        made._model = per_wavelength(lambda wavelength: replace(given_model(wavelength), surface=surface()))
        return made

    @property
    def surface(self) -> Microsurface | None:
        """The facets; None of a perfectly smooth interface."""
        return self._surface()

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        return self._model(wavelength).evaluate(theta_i, phi_i, theta_o, phi_o)

    def reflected_by(
        self,
        pair: HalfVector,
        visible: Array,
        theta_i: Array,
        phi_i: Array,
        theta_o: Array,
        phi_o: Array,
        wavelength: Array | None,
        once: OnlyOnce = each_time,
    ) -> Array:
        """As :meth:`evaluate`, above the surface, of known half vectors and visibilities of facets."""
        return self._model(wavelength).reflected_by(pair, visible, theta_i, phi_i, theta_o, phi_o, once)

    def further_light(
        self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None
    ) -> Array | None:
        """What of :meth:`evaluate`, above the surface, facets do not reflect once, (directions…, wavelength or 1); None if that is all."""
        return self._model(wavelength).further_light(theta_i, phi_i, theta_o, phi_o)

    def mueller(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        """Frames as in :mod:`brdfpipe.bsdf.microfacet.polarised`; NaN for light through the interface or from within it."""
        return self._model(wavelength).mueller(theta_i, phi_i, theta_o, phi_o)

    def albedo(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        return self._model(wavelength).directional_albedo(theta_i, phi_i)

    def transmittance(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
        return self._model(wavelength).transmittance(theta_i, phi_i)

    @property
    def albedo_needs_quadrature(self) -> bool:
        return False

    @property
    def albedo_accuracy(self) -> float:
        return super().albedo_accuracy if self.isotropic else _LAY_ALBEDO_ACCURACY

    @property
    def isotropic(self) -> bool:
        return "phi_i" not in self.dataset["directional_albedo"].dims

    @property
    def mirror_symmetric(self) -> bool:
        return self.isotropic

    @property
    def lobe_slope(self) -> float:
        """Median slope of the facets."""
        return UNRESOLVED_SLOPE if self.surface is None else self.surface.typical_slope

    def nonspectral(self, weight: Array) -> xr.Dataset:
        """The surface with the weighted mean of the reflectance, and one index.

        The index gives the mean reflectance at normal incidence (of a metal, it is the mean of n and of k). At other angles the error
        is of second order in the spread of n: 1e-5 of the specular part for a polymer over the visible.
        """
        bsdf = self.dataset
        total = weight @ bsdf["total_reflectance"].values if "total_reflectance" in bsdf else None
        if bsdf["n"].ndim == 0:
            diffuse = bsdf["diffuse"].values
            reduced = bsdf.drop_dims("wavelength").assign(diffuse=weight @ diffuse if diffuse.ndim else diffuse)
        else:
            reduced = with_mean_index(bsdf, weight)
        return vocabulary.label(reduced if total is None else reduced.assign(total_reflectance=total), "bsdf")

    def mean_index(self, weight: Array) -> tuple[float, float] | None:
        return mean_index(self.dataset, weight) if self.dataset["n"].ndim else None

    def without_diffuse(self) -> xr.Dataset:
        return self.dataset.assign(diffuse=xr.zeros_like(self.dataset["diffuse"]))

    def single_reflection(self) -> xr.Dataset | None:
        facets = self.without_diffuse()
        if not any(name in facets for name in _SEVERAL):
            return None
        return facets.drop_vars([*_SEVERAL, "second_slope", "second_weight"], errors="ignore")

    @property
    def unphysical_choice(self) -> str:
        if "recipe" in self.dataset.attrs:
            return f"recipe {self.dataset.attrs['recipe']}"
        masking = self.dataset.attrs["masking"]
        return f"masking {masking}" if masking in NOT_PHYSICAL else ""


_INCIDENCE_DIMS = [("theta_i",), ("theta_i", "phi_i")]

_INTERFACE_KIND = vocabulary.Kind(
    required={
        **dict.fromkeys(("n", "k", "mean_albedo", "diffuse"), vocabulary.SPECTRAL),
        "directional_albedo": [(*dims, *spectral) for dims in _INCIDENCE_DIMS for spectral in (("wavelength",), ())],
        "mean_furnace_albedo": vocabulary.SCALAR,
    },
    optional={
        **dict.fromkeys(("lay", "theta_m"), vocabulary.SCALAR),
        **vocabulary.SECOND_REFLECTION,
        **dict.fromkeys(("compensation", "total_reflectance"), vocabulary.SPECTRAL),
        "furnace_albedo": _INCIDENCE_DIMS,
        "visibility_ratio": vocabulary.VISIBILITY_COORDINATES,
        "single_ratio": vocabulary.SINGLE_VISIBILITY_COORDINATES,
        "visibility_limit": [("limit_theta",)],
    },
    attributes=("masking", "diffuse_mode", "multiple_scattering", "transmission"),
)


class Microfacet(Interface):
    """A rough interface, given by the slope density of its facets."""

    name = "microfacet"
    kind = replace(
        _INTERFACE_KIND,
        required={
            "slope_density": vocabulary.SLOPES,
            "lambda_smith": [("theta",), ("theta", "phi")],
            **_INTERFACE_KIND.required,
        },
    )


class Smooth(Interface):
    """A perfectly smooth interface: its mirror reflection is not part of the BSDF, but of :meth:`specular`."""

    name = "smooth"
    kind = _INTERFACE_KIND

    def specular(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> tuple[Array, Array]:
        model = self._model(wavelength)
        bare = replace(model, diffuse=np.zeros(1))
        return bare.directional_albedo(theta_i, phi_i), model.transmittance(theta_i, phi_i)
