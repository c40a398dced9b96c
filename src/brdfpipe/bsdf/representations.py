"""What each representation of a BSDF can do, by name, and what all of them can do through ``evaluate`` alone."""

from __future__ import annotations

from types import ModuleType
from typing import Any, NamedTuple, Protocol, cast

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe import hemisphere
from brdfpipe.bsdf import cells, flake, lambert_gauss, table
from brdfpipe.bsdf.measured import evaluation as measured
from brdfpipe.bsdf.microfacet import builder as microfacet
from brdfpipe.bsdf.slab import builder as slab
from brdfpipe.errors import VocabularyError
from brdfpipe.geometry import Array


class Representation(Protocol):
    """The functions a representation's module offers, on plain arrays in degree and nm.

    Two are required. A module may offer more, by these names, where it knows better than the functions of this module:

    - ``albedo(bsdf, theta_i, phi_i, wavelength)``: reflectance to the side the light comes from, mirror reflection included;
      None for a dataset of which it is not known better
    - ``transmittance(bsdf, theta_i, phi_i, wavelength)``: share that leaves on the other side, straight transmission included
    - ``specular(bsdf, theta_i, phi_i, wavelength)``: reflectance and transmittance of perfectly smooth surfaces, which
      ``evaluate`` cannot show
    - ``isotropic(bsdf)``: whether only the difference of the azimuths counts
    - ``lobe_slope(bsdf)``: a typical slope of the facets behind the lobe
    - ``kinks(bsdf)``: polar angles, and azimuths from that of incidence, at which the BSDF bends [degree]
    - ``uncertainty(bsdf, theta_i, phi_i, theta_o, phi_o, wavelength)``: standard uncertainty of ``evaluate`` in sr⁻¹
    """

    def evaluate(
        self, bsdf: xr.Dataset, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None
    ) -> Array:
        """BRDF or BTDF in sr⁻¹, (directions…, wavelength or 1)."""

    def nonspectral(self, bsdf: xr.Dataset, weight: Array) -> xr.Dataset:
        """The dataset averaged over wavelength with normalised weights."""


class Integrated(NamedTuple):
    """What leaves on one side, by quadrature."""

    value: Array
    """(incidences…, wavelength or 1)"""
    error: Array
    """Estimate of the quadrature's error, of the same shape; it holds for lobes that :func:`integrated` can find"""


_MODULES: dict[str, ModuleType] = {
    "microfacet": microfacet,
    "smooth": microfacet,
    "lambert_gauss": lambert_gauss,
    "table": table,
    "slab": slab,
    "flake": flake,
    "rig": measured,
}


def representation(bsdf: xr.Dataset) -> Representation:
    """The module that evaluates a dataset.

    Raises
    ------
    VocabularyError : it is no ``bsdf``, or of an unknown representation.
    """
    name = bsdf.attrs.get("representation")
    if name not in _MODULES:
        raise VocabularyError(f"not an evaluable bsdf: representation {name!r}; known: {', '.join(_MODULES)}")
    return cast(Representation, _MODULES[name])


def albedo(bsdf: xr.Dataset, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
    """Directional reflectance [1], (incidences…, wavelength or 1): the representation's own, else by quadrature."""
    module = representation(bsdf)
    own = module.albedo(bsdf, theta_i, phi_i, wavelength) if hasattr(module, "albedo") else None
    if own is not None:
        return np.asarray(own)
    rough = integrated(bsdf, theta_i, phi_i, wavelength).value
    return rough + specular(bsdf, theta_i, phi_i, wavelength)[0]


def transmittance(bsdf: xr.Dataset, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
    """Share of the light that leaves on the other side [1], (incidences…, wavelength or 1)."""
    module = representation(bsdf)
    if hasattr(module, "transmittance"):
        return np.asarray(module.transmittance(bsdf, theta_i, phi_i, wavelength))
    if not transmits(bsdf):
        return np.zeros((*np.shape(theta_i), 1))
    rough = integrated(bsdf, theta_i, phi_i, wavelength, through=True).value
    return rough + specular(bsdf, theta_i, phi_i, wavelength)[1]


def specular(bsdf: xr.Dataset, theta_i: Array, phi_i: Array, wavelength: Array | None) -> tuple[Array, Array]:
    """Reflectance and transmittance of perfectly smooth surfaces [1], (incidences…, wavelength or 1) each."""
    module = representation(bsdf)
    if hasattr(module, "specular"):
        reflected, passed = module.specular(bsdf, theta_i, phi_i, wavelength)
        return np.asarray(reflected), np.asarray(passed)
    nothing = np.zeros((*np.shape(theta_i), 1))
    return nothing, nothing


def mueller(
    bsdf: xr.Dataset, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None
) -> Array:
    """Mueller matrix of the BRDF [sr-1], (directions…, wavelength or 1, 4, 4); a depolariser where the representation has none."""
    module = representation(bsdf)
    if hasattr(module, "mueller"):
        return np.asarray(module.mueller(bsdf, theta_i, phi_i, theta_o, phi_o, wavelength))
    brdf = module.evaluate(bsdf, theta_i, phi_i, theta_o, phi_o, wavelength)
    matrix = np.zeros((*brdf.shape, 4, 4))
    matrix[..., 0, 0] = brdf
    return matrix


def has_uncertainty(bsdf: xr.Dataset) -> bool:
    """Whether the representation states how uncertain its values are."""
    return hasattr(representation(bsdf), "uncertainty")


def uncertainty(
    bsdf: xr.Dataset, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None
) -> Array:
    """Standard uncertainty of the BSDF in sr⁻¹, (directions…, wavelength or 1).

    Raises
    ------
    VocabularyError : the representation states none.
    """
    module: Any = representation(bsdf)
    if not has_uncertainty(bsdf):
        told = ", ".join(name for name, each in _MODULES.items() if hasattr(each, "uncertainty"))
        raise VocabularyError(
            f"the representation {bsdf.attrs['representation']!r} states no uncertainty; those that do: {told}"
        )
    return np.asarray(module.uncertainty(bsdf, theta_i, phi_i, theta_o, phi_o, wavelength))


def isotropic(bsdf: xr.Dataset) -> bool:
    """Whether the BSDF depends on the azimuths by their difference alone."""
    module = representation(bsdf)
    return bool(module.isotropic(bsdf)) if hasattr(module, "isotropic") else True


def transmits(bsdf: xr.Dataset) -> bool:
    """Whether light passes to the other side, by the attribute ``transmission``."""
    return bool(bsdf.attrs.get("transmission", "none") != "none")


def index_below(bsdf: xr.Dataset, wavelength: Array | None = None) -> float:
    """Refractive index of what the transmitted light ends in: the body, or air again behind a slab; mean over wavelength."""
    if "n" not in bsdf or bsdf.attrs.get("transmission") == "slab":
        return 1.0
    n = bsdf["n"]
    if wavelength is not None and "wavelength" in n.dims:
        return float(np.interp(wavelength, bsdf["wavelength"].values, n.values).mean())
    return float(n.mean())


def refracted(bsdf: xr.Dataset, theta_i: Array, wavelength: Array | None = None) -> Array:
    """Polar angle of the ray that a smooth surface transmits, from 90 to 180 for light from above; NaN where it is totally reflected."""
    theta_i = np.asarray(theta_i, dtype=float)
    index = index_below(bsdf, wavelength)
    sine = np.sin(np.radians(theta_i)) * np.where(theta_i <= 90, 1 / index, index)
    inner = np.degrees(np.arcsin(np.where(sine <= 1, sine, np.nan)))
    return np.where(theta_i <= 90, 180 - inner, inner)


def integrated(
    bsdf: xr.Dataset,
    theta_i: Array,
    phi_i: Array,
    wavelength: Array | None,
    *,
    through: bool = False,
    relative: float | None = None,
) -> Integrated:
    """∫ f |cos θ_o| dω_o over the side the light comes from, or the other one, through ``evaluate`` alone.

    Parameters
    ----------
    theta_i, phi_i : degree, of any one shape
    through : integrate over the side the light does not come from
    relative : the error wanted, as a share of the value; by default 1e-6, or the ``ACCURACY`` that the representation is worth

    Notes
    -----
    Adaptive cells, graded towards the mirror direction (or the refracted and the straight one) down to 0.001°, so that lobes
    about it are resolved whatever their width; lobes elsewhere are found where they are wider than some 2°, or where the
    representation tells its kinks. Genz–Malik cubature. Perfectly specular terms are not part of it.
    """
    angles = np.atleast_1d(theta_i).ravel().astype(float), np.atleast_1d(phi_i).ravel().astype(float)
    if angles[0].size == 0:
        empty = np.zeros((*np.shape(theta_i), 1))
        return Integrated(empty, empty)
    start = [first_cells(bsdf, *at, through) for at in zip(*angles, strict=True)]
    owner = np.repeat(np.arange(len(start)), [low.shape[0] for low, _ in start])
    low, high = (np.concatenate(corners) for corners in zip(*start, strict=True))
    integrand = integrand_of(bsdf, *angles, wavelength)
    rule = cells.integral(integrand, wavelengths_of(bsdf, wavelength))
    if relative is None:
        relative = float(getattr(representation(bsdf), "ACCURACY", 1e-6))
    mesh = cells.refine((owner, low, high), rule, relative)
    shape = (*np.shape(theta_i), -1)
    totals = (mesh.totals(field, len(start)).reshape(shape) for field in (mesh.value, mesh.error))
    return Integrated(*totals)


def integrand_of(bsdf: xr.Dataset, theta_i: Array, phi_i: Array, wavelength: Array | None) -> cells.Integrand:
    """The BSDF as a function of which incidence, θ_o and φ_o."""
    module = representation(bsdf)
    return lambda owner, theta_o, phi_o: module.evaluate(bsdf, theta_i[owner], phi_i[owner], theta_o, phi_o, wavelength)


def wavelengths_of(bsdf: xr.Dataset, wavelength: Array | None) -> int:
    """How many wavelengths an evaluation gives."""
    if wavelength is not None:
        return max(1, wavelength.size)
    return bsdf.sizes.get("wavelength", 1)


def first_cells(bsdf: xr.Dataset, theta_i: float, phi_i: float, through: bool) -> tuple[Array, Array]:
    """Low and high corners of the cells that cover one side, graded towards where a lobe may be."""
    theta, phi = cell_edges(bsdf, theta_i, phi_i, through)
    return cells.rectangles(theta, phi)


def cell_edges(bsdf: xr.Dataset, theta_i: float, phi_i: float, through: bool) -> tuple[Array, Array]:
    """Polar and azimuthal edges of the first cells of one side."""
    peaks = np.array([180 - theta_i, float(refracted(bsdf, np.array(theta_i)))]) if through else np.array([theta_i])
    below = (theta_i > 90) != through
    theta, phi = cells.theta_edges(peaks[np.isfinite(peaks)], below), cells.phi_edges(phi_i + 180)
    module = representation(bsdf)
    if hasattr(module, "kinks"):
        polar, azimuths = module.kinks(bsdf)
        turned = (azimuths + phi_i - phi[0]) % 360 + phi[0]
        theta = np.union1d(theta, polar[(polar > theta[0]) & (polar < theta[-1])])
        phi = np.union1d(phi, turned[(turned > phi[0]) & (turned < phi[-1])])
    return theta, phi


def lobe_slope(bsdf: xr.Dataset) -> float | None:
    """A typical slope of the facets behind the specular lobe [1]; None where the representation does not know it."""
    module = representation(bsdf)
    return float(module.lobe_slope(bsdf)) if hasattr(module, "lobe_slope") else None


def nonspectral(bsdf: xr.Dataset, weight: ArrayLike | None = None) -> xr.Dataset:
    """The BSDF seen by a detector of spectral response ``weight``; see :meth:`brdfpipe.bsdf.accessor.BSDFAccessor.nonspectral`."""
    response = normalised(bsdf, weight)
    return bsdf if response is None else representation(bsdf).nonspectral(bsdf, response)


def normalised(bsdf: xr.Dataset, weight: ArrayLike | None = None) -> Array | None:
    """The spectral response on the wavelengths of a BSDF, of sum 1; None where it does not depend on wavelength.

    Raises
    ------
    VocabularyError : the weight is not one finite number >= 0 a wavelength, or all 0.
    """
    if "wavelength" not in bsdf.coords:
        return None
    wavelength = bsdf["wavelength"].values
    if weight is None:
        from brdfpipe.spectra import colorimetry

        weight = colorimetry.luminous_weight(wavelength)
    response = np.asarray(weight, dtype=float)
    if (
        response.shape != wavelength.shape
        or not np.isfinite(response).all()
        or response.min() < 0
        or not response.any()
    ):
        raise VocabularyError(
            f"the weight needs {wavelength.size} finite values >= 0, not all 0; found shape {response.shape}"
        )
    return np.asarray(response / response.sum())


def lay(bsdf: xr.Dataset) -> float | None:
    """Azimuth along the lay of the surface [degree]; None where it has none, or none is known."""
    return None if isotropic(bsdf) or "lay" not in bsdf else float(bsdf["lay"])


def total_reflectance(bsdf: xr.Dataset) -> tuple[Array, Array]:
    """Wavelengths and the total reflectance at 8°, integrated from the BSDF; a neutral one on two wavelengths.

    Of a surface with a lay, the mean over eight azimuths.
    """
    return _spectrum(bsdf, albedo(bsdf, *_all_round(bsdf, 8.0), None).mean(axis=0))


def total_transmittance(bsdf: xr.Dataset) -> tuple[Array, Array]:
    """Wavelengths and the total transmittance at normal incidence; a neutral one on two wavelengths."""
    return _spectrum(bsdf, transmittance(bsdf, np.zeros(1), np.zeros(1), None)[0])


def _all_round(bsdf: xr.Dataset, theta: float) -> tuple[Array, Array]:
    azimuths = hemisphere.azimuths(isotropic(bsdf))
    return np.full(azimuths.size, theta), azimuths


def _spectrum(bsdf: xr.Dataset, values: Array) -> tuple[Array, Array]:
    if "wavelength" in bsdf.coords:
        return bsdf["wavelength"].values, np.broadcast_to(values, bsdf["wavelength"].shape)
    return np.array([360.0, 780.0]), np.repeat(values, 2)
