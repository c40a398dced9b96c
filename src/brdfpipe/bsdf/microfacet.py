"""The microfacet BRDF of a rough dielectric over a diffuse base.

Specular part: SC = D F G / (4 cos θ_i cos θ_o), D from the measured slope density, Smith masking from the same density, so
that energy and reciprocity hold by construction. Diffuse part: coupled to what the facets let through (Kelemen &
Szirmay-Kalos), so that the total reflectance at the measuring geometry is the measured one, exactly.

References
----------
Patent US 9,395,299 (CRF), steps c to h; Heitz 2014 (JCGT 3(2)); Kelemen & Szirmay-Kalos 2001 (Eurographics short papers).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from brdfpipe import hemisphere, optics, vocabulary
from brdfpipe.density import RadialDensity
from brdfpipe.errors import BrdfpipeError
from brdfpipe.facets import azimuthal_average
from brdfpipe.geometry import Array, half_vector
from brdfpipe.hemisphere import panel_rule
from brdfpipe.masking import VISIBILITY, Smith

DIFFUSE_MODES = ("coupled", "none")

Reflectance = Callable[[Array, ArrayLike, ArrayLike], Array]
"""Reflectance of a facet from (cos ζ, n, k)."""

_AZIMUTHS = 12
_ALBEDO_NODES = 96

SPECULAR_TRAP = 5.0
"""Half angle of the gloss trap of a sphere instrument, unless the spectrum says otherwise [degree]."""
_INDEX_NODES = 5


class ModelError(BrdfpipeError):
    """A BSDF cannot be built from what was given."""


def build(
    facets: xr.Dataset,
    *,
    index: xr.Dataset | float | str,
    spectrum: xr.Dataset | None = None,
    masking: str = "height-correlated",
    diffuse: str = "coupled",
) -> xr.Dataset:
    """Microfacet BRDF of a surface.

    Parameters
    ----------
    facets : kind ``facets``; one with a lay is averaged over azimuth, with a warning
    index : kind ``index``, a number or a plastic's name; the refractive index of the body, against air
    spectrum : kind ``spectrum``; the total reflectance at incidence ``theta_i``, specular included (``sci``), or excluded
        (``sce``): then what the facets mirror into the instrument's gloss trap, a cone of half angle ``specular_trap``
        (attribute, 5 degree by default) about the mirror direction, is added. Without it the specular part stands alone
    masking : ``height-correlated`` or ``separable``
    diffuse : ``coupled`` or ``none``

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``microfacet``

    Raises
    ------
    ModelError : an unknown mode.
    VocabularyError : a dataset of the wrong kind.

    Notes
    -----
    f = SC + d′ (1 − E(θ_i)) (1 − E(θ_o)) / [π (1 − Ē)] with E the directional albedo of SC, Ē = 2 ∫ E μ dμ and
    d′ = (R − E(θ_m)) / (1 − E(θ_m)). Where R < E(θ_m), d′ is clamped at 0, flagged, and a warning names the wavelengths.
    """
    vocabulary.validate(facets, "facets")
    index = vocabulary.validate(index, "index") if isinstance(index, xr.Dataset) else optics.refractive_index(index)
    if masking not in VISIBILITY:
        raise ModelError(f"unknown masking {masking!r}; accepted: {', '.join(VISIBILITY)}; set `model.masking`")
    if diffuse not in DIFFUSE_MODES:
        raise ModelError(f"unknown diffuse mode {diffuse!r}; accepted: {', '.join(DIFFUSE_MODES)}; set `model.diffuse`")
    if spectrum is not None:
        vocabulary.validate(spectrum, "spectrum")
    wavelength = None if spectrum is None else spectrum["wavelength"].values
    n, k, wavelength, held = _index_on(index, wavelength)
    isotropic = azimuthal_average(facets)
    bsdf = isotropic[["slope_density", "lambda_smith"]].drop_attrs()
    bsdf = bsdf.drop_vars([name for name in bsdf.coords if name not in ("slope", "theta")])
    bsdf.attrs = {
        "representation": "microfacet",
        "masking": masking,
        "diffuse_mode": diffuse,
        "band": facets.attrs["band"],
    }
    if wavelength is not None:
        bsdf = bsdf.assign_coords(wavelength=wavelength)
    spectral = () if n.ndim == 0 else ("wavelength",)
    bsdf = vocabulary.add_warning(bsdf.assign(n=(spectral, n), k=(spectral, k)), *held)
    theta_m = 8.0 if spectrum is None else float(spectrum.attrs["theta_i"])
    bsdf = _with_albedo(bsdf, theta_m)
    bsdf = _with_diffuse(bsdf, spectrum, theta_m)
    if isotropic is not facets:
        bsdf = vocabulary.add_warning(bsdf, *vocabulary.warnings(isotropic))
    return vocabulary.label(bsdf, "bsdf")


def evaluate(
    bsdf: xr.Dataset, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None
) -> Array:
    """BRDF in sr⁻¹, (directions…, wavelength); see :meth:`brdfpipe.bsdf.accessor.BSDFAccessor.evaluate`."""
    model = _Model.of(bsdf, wavelength)
    above = (theta_i < 90) & (theta_o < 90)
    theta_i, phi_i, theta_o, phi_o = (np.where(above, angle, 0.0) for angle in (theta_i, phi_i, theta_o, phi_o))
    half = half_vector(theta_i, phi_i, theta_o, phi_o)
    shape_factor = model.density(half.slope_squared) * (1 + half.slope_squared) ** 2 / 4
    shape_factor = shape_factor * model.visibility(np.radians(theta_i), np.radians(theta_o))
    fresnel = optics.fresnel(half.cos_zeta[..., None], model.n, model.k)[2]
    brdf = shape_factor[..., None] * fresnel
    if model.diffuse.any():
        let_in, let_out = 1 - model.albedo(theta_i), 1 - model.albedo(theta_o)
        brdf = brdf + model.diffuse * let_in * let_out / (np.pi * (1 - model.mean_albedo))
    return np.where(above[..., None], brdf, 0.0)


def albedo(bsdf: xr.Dataset, theta_i: Array, phi_i: Array, wavelength: Array | None) -> Array:
    """Directional reflectance [1], (incidences…, wavelength): that of the facets, integrated anew, plus the diffuse part."""
    model = _Model.of(bsdf, wavelength)
    flat = np.minimum(theta_i, 90.0).ravel()
    specular = directional_albedo(model, np.radians(flat)).reshape(*theta_i.shape, -1)
    # ∫ (1 − E(θ_o)) cos θ_o dω_o = π (1 − Ē): the diffuse lobe keeps its share exactly.
    total = specular + model.diffuse * (1 - model.albedo(np.minimum(theta_i, 90.0)))
    return np.where((theta_i < 90)[..., None], total, 0.0)


def lobe_slope(bsdf: xr.Dataset) -> float:
    """The slope that half of the facets exceed [1]."""
    return RadialDensity.of(bsdf).median_slope


def nonspectral(bsdf: xr.Dataset, weight: Array) -> xr.Dataset:
    """The same surface seen by a detector of spectral response ``weight`` (normalised, on the dataset's wavelengths).

    The reflectance is averaged with the weight and the index replaced by its average; the error is of second order in
    the spread of n (1e-5 of the specular part for a polymer over the visible).
    """
    if "wavelength" not in bsdf.coords:
        return bsdf
    total = weight @ bsdf["total_reflectance"].values if "total_reflectance" in bsdf else None
    if bsdf["n"].ndim == 0:
        diffuse = bsdf["diffuse"].values
        reduced = bsdf.drop_dims("wavelength").assign(diffuse=weight @ diffuse if diffuse.ndim else diffuse)
    else:
        reduced = _with_mean_index(bsdf, weight)
    return vocabulary.label(reduced if total is None else reduced.assign(total_reflectance=total), "bsdf")


def _with_mean_index(bsdf: xr.Dataset, weight: Array) -> xr.Dataset:
    reduced = bsdf.drop_dims("wavelength").assign(
        {name: weight @ bsdf[name].values if bsdf[name].ndim else bsdf[name].values for name in ("n", "k")}
    )
    reduced = _with_albedo(reduced, float(bsdf["theta_m"])).assign(diffuse=0.0)
    specular = float(_Model.of(reduced, None).albedo(bsdf["theta_m"].values)[..., 0])
    at_measurement = _Model.of(bsdf, None).albedo(bsdf["theta_m"].values)
    diffuse = np.broadcast_to(bsdf["diffuse"].values, weight.shape)
    total = float(weight @ np.broadcast_to(at_measurement + diffuse * (1 - at_measurement), weight.shape))
    return reduced.assign(diffuse=max(total - specular, 0.0) / (1 - specular))


class _Model(NamedTuple):
    """A microfacet dataset, ready to evaluate; spectral fields are (wavelength,) or of length 1."""

    density: RadialDensity
    smith: Smith
    masking: str
    n: Array
    k: Array
    theta_nodes: Array
    albedo_nodes: Array
    """(theta, wavelength)"""
    mean_albedo: Array
    diffuse: Array

    @classmethod
    def of(cls, bsdf: xr.Dataset, wavelength: Array | None) -> _Model:
        on = _Wavelengths(bsdf, wavelength)
        nodes = bsdf["directional_albedo"].transpose("theta_i", ...)
        return cls(
            RadialDensity.of(bsdf),
            Smith.of(bsdf),
            str(bsdf.attrs["masking"]),
            on(bsdf["n"]),
            on(bsdf["k"]),
            bsdf["theta_i"].values,
            on(nodes),
            on(bsdf["mean_albedo"]),
            on(bsdf["diffuse"]),
        )

    def visibility(self, theta_i: Array, theta_o: Array) -> Array:
        cos_i, sin_i, cos_o, sin_o = np.cos(theta_i), np.sin(theta_i), np.cos(theta_o), np.sin(theta_o)
        excess_i, excess_o = self.smith.excess_towards(cos_i, sin_i), self.smith.excess_towards(cos_o, sin_o)
        return VISIBILITY[self.masking](cos_i, sin_i, excess_i, cos_o, sin_o, excess_o)

    def albedo(self, theta: Array) -> Array:
        """E(θ), (…, wavelength), interpolated."""
        return _interpolate_albedo(self.theta_nodes, self.albedo_nodes, theta)


class _Wavelengths:
    """Bring fields to the wavelengths asked for; refuse to extrapolate."""

    def __init__(self, bsdf: xr.Dataset, wavelength: Array | None) -> None:
        self.own = bsdf["wavelength"].values if "wavelength" in bsdf.coords else None
        self.asked = wavelength

    def __call__(self, field: xr.DataArray) -> Array:
        values = np.asarray(field.values, dtype=float)
        if "wavelength" not in field.dims:
            return values[..., None]
        if self.asked is None or self.own is None:
            return values
        from scipy.interpolate import make_interp_spline

        return np.asarray(make_interp_spline(self.own, values, k=1, axis=-1)(self.asked))


def directional_albedo(model: _Model, theta_i: Array, fresnel: Reflectance | None = None) -> Array:
    """Directional albedo E(θ_i) of the specular part, (incidences, wavelength).

    Parameters
    ----------
    model : the evaluable model
    theta_i : (incidences,) in radian, 0 to π/2
    fresnel : reflectance against (cos ζ, n, k), the dielectric's by default; a test of energy passes 1

    Notes
    -----
    Integrated over the facets instead of the outgoing directions,
    E = ∫∫ P22 F G2 (cos θ_i − p sin θ_i) / cos θ_i dp dq over facets that mirror upwards, so that a narrow lobe costs no more
    than a wide one. In polar slope coordinates the horizon is p = s cos β < (1 − s²) cot θ_i / 2: β is integrated from there,
    and s in panels split at tan(45° − θ_i/2) and its inverse, where that limit enters and leaves.
    """
    reflectance = fresnel or (lambda cos_zeta, n, k: optics.fresnel(cos_zeta, n, k)[2])
    cos_i, sin_i = np.cos(theta_i)[:, None, None], np.sin(theta_i)[:, None, None]
    s, s_weight, beta, beta_weight = _slope_rule(model.density, theta_i)
    u, p = s[..., None] ** 2, s[..., None] * np.cos(beta)
    towards = np.maximum(cos_i - p * sin_i, 0.0)
    cos_zeta = towards / np.sqrt(1 + u)
    cos_o = np.clip(2 * towards / (1 + u) - cos_i, 1e-300, 1.0)
    sin_o = np.sqrt((1 - cos_o) * (1 + cos_o))
    excess_i = model.smith.excess_towards(cos_i, sin_i)
    excess_o = model.smith.excess_towards(cos_o, sin_o)
    visible = VISIBILITY[model.masking](np.maximum(cos_i, 1e-300), sin_i, excess_i, cos_o, sin_o, excess_o)
    weight = (model.density(s**2) * s * s_weight)[..., None] * beta_weight * visible * cos_o * towards
    return _spectral_mean(weight.reshape(theta_i.size, -1), cos_zeta.reshape(theta_i.size, -1), model, reflectance)


def _slope_rule(density: RadialDensity, theta_i: Array) -> tuple[Array, Array, Array, Array]:
    """Quadrature over the facets that mirror (θ_i, 0) above the horizon: s and its weight (θ, S), β and its weight (θ, S, B)."""
    enters = np.tan(np.pi / 4 - theta_i / 2)
    reach = density.slope[-1]
    with np.errstate(divide="ignore"):
        splits = np.minimum(np.stack([enters, 1 / enters], axis=1), reach)
    panels = np.broadcast_to(density.panels(), (theta_i.size, density.panels().size))
    s, s_weight = panel_rule(np.sort(np.concatenate([panels, splits], axis=1), axis=1), 4)
    with np.errstate(divide="ignore", invalid="ignore"):
        limit = (1 - s**2) / (2 * s * np.tan(theta_i)[:, None])
    start = np.arccos(np.clip(np.nan_to_num(limit, nan=1.0, posinf=1.0, neginf=-1.0), -1.0, 1.0))
    beta, beta_weight = panel_rule(np.stack([start, np.full_like(start, np.pi)], axis=-1), _AZIMUTHS)
    return s, s_weight, beta, 2 * beta_weight


def _spectral_mean(weight: Array, cos_zeta: Array, model: _Model, reflectance: Reflectance) -> Array:
    """Σ weight · F(cos ζ; λ), (incidences, wavelength).

    F is smooth in n: where only n disperses, it is evaluated at a few Chebyshev nodes of n and interpolated, which is exact to
    1e-9 over the spread of a transparent body and costs the same for any number of wavelengths.
    """
    pairs, where = np.unique(np.stack(np.broadcast_arrays(model.n, model.k)), axis=1, return_inverse=True)
    if pairs.shape[1] > _INDEX_NODES and not pairs[1].any():
        low, high = pairs[0, 0], pairs[0, -1]
        unit = np.cos(np.pi * (np.arange(_INDEX_NODES) + 0.5) / _INDEX_NODES)
        nodes = low + (high - low) * (unit + 1) / 2
        at_nodes = np.stack([(weight * reflectance(cos_zeta, n, 0.0)).sum(axis=-1) for n in nodes], axis=-1)
        chebyshev = np.polynomial.chebyshev
        coefficients = np.linalg.solve(chebyshev.chebvander(unit, _INDEX_NODES - 1), at_nodes.T)
        return np.asarray(chebyshev.chebval(2 * (model.n - low) / (high - low) - 1, coefficients))
    values = [(weight * reflectance(cos_zeta, n, k)).sum(axis=-1) for n, k in pairs.T]
    return np.stack(values, axis=-1)[:, where.ravel()]


def _with_albedo(bsdf: xr.Dataset, theta_m: float) -> xr.Dataset:
    """Add the directional albedo on nodes that crowd towards grazing, where it bends, and its mean."""
    theta = np.degrees(np.arccos(np.cos(np.linspace(0, np.pi / 2, _ALBEDO_NODES)) ** 2))
    # Within a few slopes of grazing the masking decides: E turns there on the scale of the roughness.
    grazing = 90 - np.degrees(RadialDensity.of(bsdf).median_slope) * 2.0 ** np.arange(-5, 7, 0.2)
    theta = np.unique(np.round(np.concatenate([theta, grazing[(grazing > 45) & (grazing < 90)], [theta_m]]), 9))
    spectral = bsdf["n"].dims
    model = _Model(
        RadialDensity.of(bsdf),
        Smith.of(bsdf),
        str(bsdf.attrs["masking"]),
        np.atleast_1d(bsdf["n"].values),
        np.atleast_1d(bsdf["k"].values),
        *(np.empty(0),) * 4,
    )
    nodes = np.clip(directional_albedo(model, np.radians(theta)), 0.0, 1.0)
    theta_rule, weight = panel_rule(np.linspace(0, np.pi / 2, 17), 8)
    weight = weight * 2 * np.sin(theta_rule) * np.cos(theta_rule)
    mean = weight @ _interpolate_albedo(theta, nodes, np.degrees(theta_rule))
    if not spectral:
        nodes, mean = nodes[:, 0], mean[0]
    return bsdf.assign_coords(theta_i=theta).assign(
        directional_albedo=(("theta_i", *spectral), nodes), mean_albedo=(spectral, mean)
    )


def _interpolate_albedo(theta_nodes: Array, albedo_nodes: Array, theta: Array) -> Array:
    from scipy.interpolate import CubicSpline

    # E is even in θ: its derivative vanishes at the normal.
    spline = CubicSpline(
        theta_nodes, albedo_nodes, axis=0, bc_type=((1, np.zeros(albedo_nodes.shape[1])), "not-a-knot")
    )
    return np.clip(np.asarray(spline(theta)), 0.0, 1.0)


def _with_diffuse(bsdf: xr.Dataset, spectrum: xr.Dataset | None, theta_m: float) -> xr.Dataset:
    specular = _Model.of(bsdf.assign(diffuse=0.0), None).albedo(np.asarray(theta_m))
    if spectrum is None or bsdf.attrs["diffuse_mode"] == "none":
        return bsdf.assign(diffuse=0.0, theta_m=theta_m)
    measured = spectrum["total_reflectance"].values.astype(float)
    trapped = _trapped(bsdf, spectrum, theta_m)
    total = measured + trapped
    wanted = (total - specular) / (1 - specular)
    clamped = wanted < 0
    quality = np.where(clamped, vocabulary.quality("clamped"), vocabulary.quality("measured")).astype(np.int8)
    bsdf = bsdf.assign(
        diffuse=("wavelength", np.maximum(wanted, 0.0)),
        diffuse_quality=("wavelength", quality),
        total_reflectance=("wavelength", total),
        theta_m=theta_m,
    )
    if spectrum.attrs["geometry"] == "sce":
        bsdf = vocabulary.add_history(
            bsdf,
            f"the specular was excluded: what the facets mirror into a gloss trap of half angle {trap_of(spectrum):g}°, "
            f"{float(np.mean(trapped)):.4f} of the light, was added to the measured reflectance",
        )
    if clamped.any():
        where = spectrum["wavelength"].values[clamped]
        deficit = float((specular - total)[clamped].max())
        bsdf = vocabulary.add_warning(
            bsdf,
            f"the total reflectance lies up to {deficit:.4f} below the specular albedo of the facets at {where.size} wavelengths "
            f"({where.min():g} to {where.max():g} nm); the diffuse part was set to 0 there. Was the specular excluded "
            "(`spectrum.geometry: sce`), or is the refractive index or the surface another one?",
        )
    return bsdf


def trap_of(spectrum: xr.Dataset) -> float:
    """Half angle of the gloss trap that excluded the specular [degree]."""
    return float(spectrum.attrs.get("specular_trap", SPECULAR_TRAP))


def _trapped(bsdf: xr.Dataset, spectrum: xr.Dataset, theta_m: float) -> Array:
    """What the facets mirror into the gloss trap, (wavelength or 1,); nothing where the specular was included.

    A trap takes the light within a few degrees of the mirror direction; a rough surface mirrors most of it elsewhere, where
    the instrument collects it as if it were diffuse.
    """
    if spectrum.attrs["geometry"] != "sce":
        return np.zeros(1)
    theta, phi, weight = hemisphere.around_mirror(theta_m, lobe_slope(bsdf), trap_of(spectrum))
    brdf = evaluate(bsdf.assign(diffuse=0.0), np.full_like(theta, theta_m), np.zeros_like(phi), theta, phi, None)
    return np.asarray(weight @ brdf)


def _index_on(index: xr.Dataset, wavelength: Array | None) -> tuple[Array, Array, Array | None, list[str]]:
    """n and k on the wavelengths of the model, scalars where they do not depend on wavelength, and what to warn about."""
    n, k = index["n"].values.astype(float), index["k"].values.astype(float)
    if np.ptp(n) == 0 and np.ptp(k) == 0:
        return n[0], k[0], wavelength, []
    known = index["wavelength"].values
    if wavelength is None:
        return n, k, known, []
    n, k = optics.interpolate_index(index, np.clip(wavelength, known[0], known[-1]))
    if known[0] <= wavelength[0] and wavelength[-1] <= known[-1]:
        return n, k, wavelength, []
    held = (
        f"the refractive index is known from {known[0]:g} to {known[-1]:g} nm and was held constant beyond, out to "
        f"{wavelength[0]:g} and {wavelength[-1]:g} nm; give a table that covers the spectrum"
    )
    return n, k, wavelength, [held]
