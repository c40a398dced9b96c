"""Colours of a material under a light: the total reflectance, and single geometries."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import hemisphere, vocabulary
from brdfpipe.appearance.tolerances import labelled, standard_uncertainty
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.microfacet.gloss_trap import SPECULAR_TRAP
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.source_changes import Reflector, SourceChanges
from brdfpipe.flakes.geometries import SETS, Directions, named_directions, refuse_mixed_signs
from brdfpipe.geometry import Array, angles_of, unit_vector
from brdfpipe.spectra import colorimetry

TOTAL = "8:total"
"""Name of the sphere geometry: 8° incidence, all reflected light, specular included."""

WITHOUT_SPECULAR = "8:sce"
"""Name of the sphere geometry with a gloss trap: 8° incidence, specular excluded."""

FLOP_GEOMETRIES = SETS["E2194"]
"""Geometries of the flop index: 15, 45 and 110° from the mirror direction."""

GEOMETRIES = ("45:0", *FLOP_GEOMETRIES)
"""The standard single geometries: 45:0, and the three of ASTM E2194."""

Geometries = Sequence[str] | Mapping[str, tuple[float, float, float]]
"""Names of geometries, or name → θ_i, θ_o, φ_o [degree]."""

ANGLE_TOLERANCE = 0.5
"""± of the directions of light and of view of a multi-angle instrument, in the plane of incidence and across it [degree].

Assumed: no public source states what ASTM E2194, E2539 or DIN 6175-2 allow. Apertures are not averaged over."""

_STEPS = ((-ANGLE_TOLERANCE, 0.0), (ANGLE_TOLERANCE, 0.0), (0.0, -ANGLE_TOLERANCE), (0.0, ANGLE_TOLERANCE))
"""Along θ, then across it [degree]."""
_ALL_AZIMUTHS, _SOME_AZIMUTHS = np.arange(0.0, 360.0, 1.0), np.arange(0.0, 360.0, 5.0)
_GRAZING = 89.999
_CHANGE_ACCURACY = 1e-4
"""Relative error of an integral of which only the change by an uncertain input matters."""

BLACK = 0.1
"""Lightness below which a colour counts as black: ten times the spread of good instruments on a black tile."""

_TRAP_SLOPE = 0.1
"""Slope for which the light in a gloss trap is integrated, where the BSDF has no lobe."""

_ROUNDING = 1e-9
"""Differences of lightness of a perfect diffuser, from rounding."""


def colour(
    bsdf: xr.Dataset,
    geometries: Geometries = GEOMETRIES,
    illuminant: str = "D65",
    observer: int = 10,
    *,
    azimuth: float | None = None,
    reflector: Reflector | None = None,
    total: Array | None = None,
) -> xr.DataArray:
    """CIE L*a*b* of the total reflectance at 8° and of single geometries.

    The light that a polished surface mirrors is part of the total reflectance, but of no single geometry off the mirror direction.

    Parameters
    ----------
    bsdf : kind ``bsdf``; one that does not depend on wavelength is neutral
    geometries : names of geometries (``45as15``), of standards and of instruments (:data:`brdfpipe.flakes.SETS`), each geometry
        once; or name → (theta_i, theta_o, phi_o) [degree]. The reflectance factor is π·BRDF
    illuminant, observer : CIE illuminant name; 2 or 10 [degree]
    azimuth : of the plane of incidence of the single geometries [degree]; by default the colour of the mean over all azimuths, for
        surfaces with a lay. The total reflectance is always such a mean
    reflector : evaluated instead of the BSDF
    total : total reflectance of the reflector, if known (:func:`total_reflectance`)

    Returns
    -------
    DataArray ``lab(geometry, component)`` [1]; L* exceeds 100 where a geometry sees a highlight

    Raises
    ------
    BrdfpipeError : an unknown name.

    References
    ----------
    CIE 015; ASTM E308, E2194, E2539; DIN 6175-2:2001 (since 2019 part of DIN 6175). Public sources confirm three angles for E2194,
    several angles of illumination and of view for E2539, and the sign of the aspecular angle, positive towards the normal; that
    the three are 15, 45 and 110° is the trade's use.
    """
    if reflector is None:
        vocabulary.validate(bsdf, "bsdf")
    if total is None:
        total = total_reflectance(bsdf, reflector)[1]
    wavelength, directions = _wavelengths(bsdf), _directions(geometries)
    white = colorimetry.weights(illuminant, observer).white
    sphere = colorimetry.reflectance_to_xyz(wavelength, total, illuminant, observer)
    single = _lab(bsdf, angles(directions), illuminant, observer, azimuth, reflector)
    return _labelled("lab", np.concatenate([colorimetry.xyz_to_lab(sphere, white)[None], single]), directions)


def colour_without_specular(
    bsdf: xr.Dataset, illuminant: str = "D65", observer: int = 10, *, reflector: Reflector | None = None
) -> xr.DataArray:
    """CIE L*a*b* of the reflectance at 8° with the specular component excluded, as a sphere instrument with a gloss trap reads it.

    The trap takes the light within :data:`.SPECULAR_TRAP` of the mirror direction, and what is mirrored into that direction alone.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    illuminant, observer : CIE illuminant name; 2 or 10 [degree]
    reflector : evaluated instead of the BSDF

    Returns
    -------
    DataArray ``lab_sce(component)`` [1]; the mean over all azimuths, of a surface with a lay
    """
    evaluator = representation(bsdf)
    rule = hemisphere.around_mirror(8.0, evaluator.lobe_slope or _TRAP_SLOPE, SPECULAR_TRAP)
    turns = hemisphere.azimuths(evaluator.isotropic)[:, None]
    at = np.broadcast_arrays(8.0, turns, rule.theta, rule.phi + turns)
    seen = evaluator if reflector is None else reflector
    trapped = (rule.weight[:, None] * seen.evaluate(at[0], at[1], at[2], at[3], None)).sum(axis=1).mean(axis=0)
    trapped = trapped + seen.specular(np.full(turns.size, 8.0), turns[:, 0], None)[0].mean(axis=0)
    wavelength, total = total_reflectance(bsdf, reflector)
    left = np.maximum(total - trapped, 0.0)
    xyz = colorimetry.reflectance_to_xyz(wavelength, left, illuminant, observer)
    lab = colorimetry.xyz_to_lab(xyz, colorimetry.weights(illuminant, observer).white)
    return labelled("lab_sce", lab, component=["L*", "a*", "b*"])


def colours_after_changes(
    bsdf: xr.Dataset,
    geometries: Geometries,
    illuminant: str,
    observer: int,
    changes: SourceChanges,
    totals: Sequence[Array],
) -> Array:
    """L*a*b* as :func:`colour` of a BSDF and of the same after each change of its inputs, (1 + changes, geometries, components).

    Parameters
    ----------
    bsdf, geometries, illuminant, observer : as for :func:`colour`
    changes : of the BSDF
    totals : total reflectance of each (:func:`total_reflectance`)
    """
    wavelength, white = _wavelengths(bsdf), colorimetry.weights(illuminant, observer).white
    # A change of a colour is smoother over the azimuth than a colour.
    turns = np.zeros(1) if representation(bsdf).isotropic else _SOME_AZIMUTHS
    each = changes.evaluate_each(*_turned_about_normal(angles(_directions(geometries)), turns), None)
    spheres = colorimetry.reflectance_to_xyz(wavelength, np.stack(totals), illuminant, observer)
    means = [brdf.mean(axis=1) for brdf in each]
    together = np.stack([np.broadcast_to(mean, (*mean.shape[:-1], wavelength.size)) for mean in means])
    single = _lab_of(bsdf, together, illuminant, observer, changed=True)
    return np.concatenate([colorimetry.xyz_to_lab(spheres, white)[:, None], single], axis=1)


def colour_uncertainty(
    bsdf: xr.Dataset,
    geometries: Geometries = GEOMETRIES,
    illuminant: str = "D65",
    observer: int = 10,
) -> xr.Dataset:
    """Standard uncertainties of the colours and of the flop index from :data:`ANGLE_TOLERANCE` of an instrument.

    The directions of light and of view are each off in the plane of incidence and across it: four independent rectangular
    distributions. One light serves all geometries of a flop index; each has a view of its own. The uncertainty of the BSDF is not
    included.

    Parameters
    ----------
    bsdf, geometries, illuminant, observer : as for :func:`colour`

    Returns
    -------
    ``lab_u(geometry, component)`` [1], NaN for the total reflectance, because it is not one geometry; and ``flop_index_u`` [1], NaN
        without the three geometries of E2194 or where there is no index
    """
    directions = _directions(geometries)
    theta_i, phi_i, theta_o, phi_o = angles(directions)
    moved = [
        *((*_turned(theta_i, phi_i, *step), theta_o, phi_o) for step in _STEPS),
        *((theta_i, phi_i, *_turned(theta_o, phi_o, *step)) for step in _STEPS),
    ]
    at = [np.concatenate(angle) for angle in zip(*moved, strict=True)]
    labs = _lab(bsdf, at, illuminant, observer, None).reshape(4, 2, len(directions), 3)
    half_ranges = (labs[:, 1] - labs[:, 0]) / 2
    lab_u = np.concatenate([np.full((1, 3), np.nan), standard_uncertainty(half_ranges, axis=0)])
    flop_u = math.nan
    if set(FLOP_GEOMETRIES) <= set(directions):
        three = {name: directions[name] for name in FLOP_GEOMETRIES}
        lightness = _lab(bsdf, angles(three), illuminant, observer, None)[:, 0]
        flop_u = _flop_uncertainty(lightness, half_ranges[:, [list(directions).index(name) for name in three], 0])
    attrs = {"units": "1", "long_name": "standard uncertainty of the flop index, from tolerances"}
    return xr.Dataset({"lab_u": _labelled("lab_u", lab_u, directions), "flop_index_u": ((), flop_u, attrs)})


def _flop_uncertainty(lightness: Array, half_ranges: Array) -> float:
    """Uncertainty of the flop index from the half ranges of L* at its geometries, (tolerances, geometries)."""
    views = [half_ranges[k] * one for k in (2, 3) for one in np.eye(3)]
    ends = np.array(
        [[flop_index(*(lightness + sign * change)) for sign in (-1, 1)] for change in (*half_ranges[:2], *views)]
    )
    # A perfect diffuser darkens by 0 towards 110°: one end of its range may have no index.
    return float(standard_uncertainty(np.diff(ends, axis=1) / 2, axis=None)) if np.isfinite(ends).all() else math.nan


def _turned(theta: Array, phi: Array, along: float, across: float) -> tuple[Array, Array]:
    """Directions turned along their meridian and across it [degree]; never below the surface."""
    polar, azimuth = np.radians(theta), np.radians(phi)
    sin, cos = np.sin(polar), np.cos(polar)
    down = np.stack([cos * np.cos(azimuth), cos * np.sin(azimuth), -sin], axis=-1)
    beside = np.stack([-np.sin(azimuth), np.cos(azimuth), np.zeros_like(azimuth)], axis=-1)
    a, b = np.radians(along), np.radians(across)
    turned = angles_of(unit_vector(theta, phi) * np.cos(a) * np.cos(b) + down * np.sin(a) + beside * np.sin(b))
    return np.minimum(turned[0], _GRAZING), turned[1]


def quality(bsdf: xr.Dataset, directions: Mapping[str, Directions]) -> NDArray[np.int8] | None:
    """Quality flag (:data:`brdfpipe.vocabulary.QUALITY_FLAGS`) of each geometry; None for a BSDF from a model.

    For a surface with a lay, the worst flag of all azimuths.
    """
    evaluator = representation(bsdf)
    if not evaluator.states_quality:
        return None
    turns = np.array([0.0]) if evaluator.isotropic else _ALL_AZIMUTHS
    return np.asarray(evaluator.quality(*_turned_about_normal(angles(directions), turns)).max(axis=1), dtype=np.int8)


def colour_quality(bsdf: xr.Dataset, geometries: Geometries = GEOMETRIES) -> xr.DataArray | None:
    """``lab_quality(geometry)`` of the colours of :func:`colour`; None for a BSDF from a model.

    The total reflectance includes directions that were not measured: it is completed.
    """
    directions = _directions(geometries)
    flags = quality(bsdf, directions)
    if flags is None:
        return None
    total = np.concatenate([[vocabulary.quality("completed")], flags]).astype(np.int8)
    return xr.DataArray(total, {"geometry": [TOTAL, *directions]}, ("geometry",), "lab_quality")


def total_reflectance(bsdf: xr.Dataset, reflector: Reflector | None = None) -> tuple[Array, Array]:
    """Wavelengths [nm] and total reflectance of a BSDF, as :meth:`.Representation.total_reflectance`, or of what is evaluated instead."""
    if reflector is None:
        return representation(bsdf).total_reflectance()
    azimuths = hemisphere.azimuths(representation(bsdf).isotropic)
    incidence = np.full(azimuths.size, 8.0), azimuths, None
    if isinstance(reflector, Representation) and reflector.albedo_needs_quadrature:
        albedo = reflector.integrate(*incidence, relative=_CHANGE_ACCURACY).value + reflector.specular(*incidence)[0]
    else:
        albedo = reflector.albedo(*incidence)
    wavelength = _wavelengths(bsdf)
    return wavelength, np.broadcast_to(albedo.mean(axis=0), wavelength.shape)


def _wavelengths(bsdf: xr.Dataset) -> Array:
    """nm; both ends of the visible spectrum if the BSDF does not depend on wavelength."""
    return np.asarray(bsdf["wavelength"].values) if "wavelength" in bsdf.coords else np.array([360.0, 780.0])


def _lab(
    bsdf: xr.Dataset,
    at: Array | Sequence[Array],
    illuminant: str,
    observer: int,
    azimuth: float | None,
    reflector: Reflector | None = None,
) -> Array:
    """L*a*b* of directions θ_i, φ_i, θ_o and φ_o, (directions, 3); NaN where a changed BSDF is not known."""
    averaged = azimuth is None and not representation(bsdf).isotropic
    # A change of a colour is smoother over the azimuth than a colour.
    turns = (_ALL_AZIMUTHS if reflector is None else _SOME_AZIMUTHS) if averaged else np.array([azimuth or 0.0])
    evaluate = (representation(bsdf) if reflector is None else reflector).evaluate
    brdf = evaluate(*_turned_about_normal(at, turns), None).mean(axis=1)
    return _lab_of(bsdf, brdf, illuminant, observer, changed=reflector is not None)


def _lab_of(bsdf: xr.Dataset, brdf: Array, illuminant: str, observer: int, changed: bool) -> Array:
    """L*a*b* (…, 3) of BRDFs (…, wavelength or 1); NaN where a changed BSDF is not known."""
    unknown = np.asarray(~np.isfinite(brdf).all(axis=-1)) if changed else np.zeros(brdf.shape[:-1], dtype=bool)
    xyz = xyz_of(bsdf, np.where(unknown[..., None], 0.0, brdf), illuminant, observer)
    lab = colorimetry.xyz_to_lab(xyz, colorimetry.weights(illuminant, observer).white)
    return np.where(unknown[..., None], np.nan, lab)


def xyz_of(bsdf: xr.Dataset, brdf: Array, illuminant: str, observer: int) -> Array:
    """X, Y and Z of the reflectance factors π·BRDF, (…, 3); ``brdf`` (…, wavelength or 1) [sr-1]."""
    wavelength = _wavelengths(bsdf)
    factors = np.broadcast_to(np.pi * brdf, (*brdf.shape[:-1], wavelength.size))
    return colorimetry.reflectance_to_xyz(wavelength, factors, illuminant, observer)


def _turned_about_normal(at: Array | Sequence[Array], turns: Array) -> tuple[Array, Array, Array, Array]:
    """Directions turned about the normal, each (directions, turns)."""
    theta_i, phi_i, theta_o, phi_o = (angle[:, None] for angle in at)
    theta_i, phi_i, theta_o, phi_o = np.broadcast_arrays(theta_i, phi_i + turns, theta_o, phi_o + turns)
    return theta_i, phi_i, theta_o, phi_o


def angles(directions: Mapping[str, Directions]) -> Array:
    """θ_i, φ_i, θ_o and φ_o [degree], (4, directions)."""
    return np.array([list(pair) for pair in directions.values()], dtype=float).reshape(-1, 4).T


def _labelled(name: str, values: Array, directions: Mapping[str, Directions]) -> xr.DataArray:
    """Colours of the total reflectance and of single geometries."""
    return labelled(name, values, geometry=[TOTAL, *directions], component=["L*", "a*", "b*"])


def _directions(geometries: Geometries) -> dict[str, Directions]:
    if isinstance(geometries, Mapping):
        return {name: Directions(theta_i, 0.0, theta_o, phi) for name, (theta_i, theta_o, phi) in geometries.items()}
    refuse_mixed_signs(geometries)
    return {name: pair for group in geometries for name, pair in named_directions(group).items()}


def flop_index(lab15: float, lab45: float, lab110: float) -> float:
    """Flop index 2.69 (L15 − L110)^1.11 / L45^0.86 of the lightness at 15, 45 and 110° aspecular; NaN where it is not defined.

    It is not defined where the paint brightens towards 110°, or where it is black at 45° (a lightness below :data:`BLACK`, which no
    instrument distinguishes from 0).

    References
    ----------
    Alman 1987 (DuPont); ASTM E2194 geometries. Public sources confirm the scale, 0 of a solid colour and 15 to 17 of the strongest
    metallic, but not the constants.
    """
    fall = lab15 - lab110
    if not fall >= -_ROUNDING or not lab45 >= BLACK:
        return math.nan
    return float(2.69 * max(fall, 0.0) ** 1.11 / lab45**0.86)
