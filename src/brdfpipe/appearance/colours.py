"""Colours of a material under a light: the total reflectance, and single geometries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.registry import representation
from brdfpipe.flakes.geometries import SETS, Directions, named_directions, refuse_mixed_signs
from brdfpipe.geometry import Array, angles_of
from brdfpipe.spectra import colorimetry

TOTAL = "8:total"
"""Name of the sphere geometry: 8° incidence, all reflected light, specular included."""

GEOMETRIES = ("45:0", *SETS["E2194"])
"""Single geometries that always computed: 45:0, and the three of ASTM E2194."""

ANGLE_TOLERANCE = 0.5
"""± of the directions of light and of view of a multi-angle instrument, in the plane of incidence and across it [degree].

Assumed: no public source states what ASTM E2194, E2539 or DIN 6175-2 allow. Apertures are not averaged over."""

_STEPS = ((-ANGLE_TOLERANCE, 0.0), (ANGLE_TOLERANCE, 0.0), (0.0, -ANGLE_TOLERANCE), (0.0, ANGLE_TOLERANCE))
"""Along θ, then across it [degree]."""
_ALL_ROUND = np.arange(0.0, 360.0, 1.0)

_GRAZING = 89.999
BLACK = 0.1
"""Lightness below which a colour is taken for black: ten times the spread of good instruments on a black tile."""

_ROUNDING = 1e-9
"""Differences of lightness that a perfect diffuser shows by rounding."""


def colour(
    bsdf: xr.Dataset,
    geometries: Sequence[str] | Mapping[str, tuple[float, float, float]] = GEOMETRIES,
    illuminant: str = "D65",
    observer: int = 10,
    *,
    azimuth: float | None = None,
) -> xr.DataArray:
    """CIE L*a*b* of the total reflectance at 8° and of single geometries.

    A single geometry away from the mirror direction does not see what a polished surface mirrors; the total reflectance does.

    Parameters
    ----------
    bsdf : kind ``bsdf``; one that does not depend on wavelength is neutral
    geometries : names of geometries (``45as15``), of standards and of instruments (:data:`brdfpipe.flakes.SETS`), each geometry
        once; or name → (theta_i, theta_o, phi_o) [degree]. The reflectance factor is π·BRDF
    illuminant, observer : CIE illuminant name; 2 or 10 [degree]
    azimuth : of the plane of incidence of the single geometries [degree]; by default the colour of the mean over all azimuths,
        which matters to a surface with a lay. The total reflectance is always such a mean

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
    vocabulary.validate(bsdf, "bsdf")
    wavelength, total = representation(bsdf).total_reflectance()
    places = _places(geometries)
    white = colorimetry.weights(illuminant, observer).white
    sphere = colorimetry.reflectance_to_xyz(wavelength, total, illuminant, observer)
    single = _lab(bsdf, _angles(places), illuminant, observer, azimuth)
    return _named(np.concatenate([colorimetry.xyz_to_lab(sphere, white)[None], single]), [TOTAL, *places], "lab")


def colour_uncertainty(
    bsdf: xr.Dataset,
    geometries: Sequence[str] | Mapping[str, tuple[float, float, float]] = GEOMETRIES,
    illuminant: str = "D65",
    observer: int = 10,
) -> xr.Dataset:
    """Standard uncertainties that :data:`ANGLE_TOLERANCE` of an instrument leaves of its colours and of the flop index.

    The directions of light and of view are each off in the plane of incidence and across it, four independent rectangular
    distributions of their half range over √3. One light serves all geometries of a flop index; each has a view of its own. That
    the BSDF itself is uncertain is not part of it.

    Parameters
    ----------
    bsdf, geometries, illuminant, observer : as of :func:`colour`

    Returns
    -------
    ``lab_u(geometry, component)`` [1], NaN of the total reflectance, which is no single geometry; and ``flop_index_u`` [1], NaN where
        the three geometries of E2194 are not among them or there is no index
    """
    places = _places(geometries)
    theta_i, phi_i, theta_o, phi_o = _angles(places)
    moved = [
        *((*_turned(theta_i, phi_i, *step), theta_o, phi_o) for step in _STEPS),
        *((theta_i, phi_i, *_turned(theta_o, phi_o, *step)) for step in _STEPS),
    ]
    at = [np.concatenate(angles) for angles in zip(*moved, strict=True)]
    labs = _lab(bsdf, at, illuminant, observer, None).reshape(4, 2, len(places), 3)
    ranges = (labs[:, 1] - labs[:, 0]) / 2
    u = np.concatenate([np.full((1, 3), np.nan), np.sqrt(np.sum(ranges**2, axis=0) / 3)])
    uncertainty = xr.Dataset({"lab_u": _named(u, [TOTAL, *places], "lab_u")})
    flop = _flop_uncertainty(bsdf, places, ranges[..., 0], illuminant, observer)
    attrs = {"units": "1", "long_name": "standard uncertainty of the flop index, from tolerances"}
    return uncertainty.assign(flop_index_u=((), flop, attrs))


def _flop_uncertainty(
    bsdf: xr.Dataset, places: Mapping[str, Directions], ranges: Array, illuminant: str, observer: int
) -> float:
    """Of half the ranges of L*, (tolerances, geometries)."""
    names = list(places)
    if not set(SETS["E2194"]) <= set(names):
        return float("nan")
    chosen = [names.index(name) for name in SETS["E2194"]]
    three = [axis[chosen] for axis in _angles(places)]
    lightness = _lab(bsdf, three, illuminant, observer, None)[:, 0]
    half = ranges[:, chosen]
    views = [half[k] * one for k in (2, 3) for one in np.eye(3)]
    ends = [[flop_index(*(lightness + sign * change)) for sign in (-1, 1)] for change in (*half[:2], *views)]
    known = np.array(ends)
    # Where a perfect diffuser's fall is 0 and turns negative by a hair, the index ends.
    return float(np.sqrt(np.sum((np.diff(known, axis=1) / 2) ** 2) / 3)) if np.isfinite(known).all() else float("nan")


def _turned(theta: Array, phi: Array, along: float, across: float) -> tuple[Array, Array]:
    """Directions turned along their meridian or across it; never below the surface."""
    polar, azimuth = np.radians(theta), np.radians(phi)
    sin, cos = np.sin(polar), np.cos(polar)
    up = np.stack([sin * np.cos(azimuth), sin * np.sin(azimuth), cos], axis=-1)
    down = np.stack([cos * np.cos(azimuth), cos * np.sin(azimuth), -sin], axis=-1)
    beside = np.stack([-np.sin(azimuth), np.cos(azimuth), np.zeros_like(azimuth)], axis=-1)
    a, b = np.radians(along), np.radians(across)
    turned = angles_of(up * np.cos(a) * np.cos(b) + down * np.sin(a) + beside * np.sin(b))
    return np.minimum(turned[0], _GRAZING), np.asarray(turned[1])


def quality(bsdf: xr.Dataset, geometries: Mapping[str, Directions]) -> NDArray[np.int8] | None:
    """Whether geometries lie among what was measured, a value of ``QUALITY_FLAGS`` each; None of a BSDF that rests on a model.

    Of a surface with a lay, the worst of all azimuths.
    """
    evaluator = representation(bsdf)
    if not evaluator.states_quality:
        return None
    turns = np.array([0.0]) if evaluator.isotropic else _ALL_ROUND
    return np.asarray(evaluator.quality(*_around(_angles(geometries), turns)).max(axis=1), dtype=np.int8)


def colour_quality(
    bsdf: xr.Dataset, geometries: Sequence[str] | Mapping[str, tuple[float, float, float]] = GEOMETRIES
) -> xr.DataArray | None:
    """``lab_quality(geometry)`` of the colours of :func:`colour`; None of a BSDF that rests on a model.

    The total reflectance takes in directions that were not measured: it is completed.
    """
    places = _places(geometries)
    flags = quality(bsdf, places)
    if flags is None:
        return None
    total = np.concatenate([[vocabulary.quality("completed")], flags]).astype(np.int8)
    return xr.DataArray(total, {"geometry": [TOTAL, *places]}, ("geometry",), "lab_quality")


def _lab(bsdf: xr.Dataset, at: Sequence[Array], illuminant: str, observer: int, azimuth: float | None) -> Array:
    """L*a*b* of directions θ_i, φ_i, θ_o and φ_o, (directions, 3)."""
    turns = _ALL_ROUND if azimuth is None and not representation(bsdf).isotropic else np.array([azimuth or 0.0])
    brdf = representation(bsdf).evaluate(*_around(at, turns), None).mean(axis=1)
    wavelength = bsdf["wavelength"].values if "wavelength" in bsdf.coords else np.array([360.0, 780.0])
    factors = np.broadcast_to(np.pi * brdf, (brdf.shape[0], wavelength.size))
    xyz = colorimetry.reflectance_to_xyz(wavelength, factors, illuminant, observer)
    return np.asarray(colorimetry.xyz_to_lab(xyz, colorimetry.weights(illuminant, observer).white))


def _around(at: Sequence[Array], turns: Array) -> tuple[Array, Array, Array, Array]:
    """Directions turned about the normal, (directions, turns)."""
    theta_i, phi_i, theta_o, phi_o = (axis[:, None] for axis in at)
    around = np.broadcast_arrays(theta_i, phi_i + turns, theta_o, phi_o + turns)
    return around[0], around[1], around[2], around[3]


def _angles(places: Mapping[str, Directions]) -> tuple[Array, Array, Array, Array]:
    theta_i, phi_i, theta_o, phi_o = np.array([list(place) for place in places.values()], dtype=float).reshape(-1, 4).T
    return theta_i, phi_i, theta_o, phi_o


def _named(values: Array, names: Sequence[str], name: str) -> xr.DataArray:
    quantity = vocabulary.QUANTITIES["lab"]
    title = quantity.long_name if name == "lab" else f"standard uncertainty of {quantity.long_name}, from tolerances"
    return xr.DataArray(
        values,
        dims=("geometry", "component"),
        coords={"geometry": list(names), "component": ["L*", "a*", "b*"]},
        name=name,
        attrs={"units": quantity.units, "long_name": title},
    )


def _places(geometries: Sequence[str] | Mapping[str, tuple[float, float, float]]) -> dict[str, Directions]:
    if isinstance(geometries, Mapping):
        return {name: Directions(theta_i, 0.0, theta_o, phi) for name, (theta_i, theta_o, phi) in geometries.items()}
    refuse_mixed_signs(geometries)
    return {name: place for group in geometries for name, place in named_directions(group).items()}


def flop_index(lab15: float, lab45: float, lab110: float) -> float:
    """Flop index 2.69 (L15 − L110)^1.11 / L45^0.86 of the lightness at 15, 45 and 110° aspecular; NaN where it is not defined.

    It is not where the paint brightens towards 110°, nor where it is black at 45°, with a lightness below :data:`BLACK`: a ratio to
    what no instrument tells from nought.

    References
    ----------
    Alman 1987 (DuPont); ASTM E2194 geometries. Public sources confirm the scale, 0 of a solid colour and 15 to 17 of the strongest
    metallic, but not the constants.
    """
    fall = lab15 - lab110
    if not fall >= -_ROUNDING or not lab45 >= BLACK:
        return float("nan")
    return float(2.69 * max(fall, 0.0) ** 1.11 / lab45**0.86)
