"""Veiling glare of a dashboard: the luminance that its image in the windscreen adds to what the driver sees.

The axes are those of :mod:`brdfpipe.appearance.cabin`. A point of the dashboard behind the foot sees the sky through the rectangle of the
windscreen. What it reflects towards the windscreen's inner face is reflected there to the driver, who looks ahead and slightly down.
docs/veiling-glare.md states what is not modelled.

The sky is integrated over the rectangle, not over the hemisphere: its edges are those of the integral, and the integrand is smooth but
for the lobe of the dashboard, about whose mirror direction the cells are graded.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.appearance.cabin import Cabin
from brdfpipe.appearance.skies import sky_luminance
from brdfpipe.bsdf import sphere_cubature
from brdfpipe.bsdf.base import Representation
from brdfpipe.bsdf.microfacet.polarised import facet_mueller
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.geometry import Array, angles_of, unit_vector

SUN_RADIUS = 0.2666
"""Angular radius of the sun, mean over the year [degree]."""

ACCURACY = 1e-4
"""Relative error of the integrals."""

_UP = np.array([0.0, 0.0, 1.0])


def veiling_luminance(bsdf: xr.Dataset, cabin: Cabin | None = None) -> xr.Dataset:
    """The luminance that the mirror image of a dashboard in the windscreen adds to the driver's view.

    Parameters
    ----------
    bsdf : kind ``bsdf``, of the dashboard; averaged with V(λ)·D65 where it depends on wavelength
    cabin : the geometry and the light

    Returns
    -------
    Dataset with ``veiling_luminance_sun``, ``veiling_luminance_sky`` and their sum ``veiling_luminance`` [cd/m²]

    Raises
    ------
    BrdfpipeError : a geometry in which the driver does not see the dashboard mirrored, or impossible glass.

    Notes
    -----
    Light is polarised by the glass that it enters through, by the dashboard as far as its BRDF has a Mueller matrix, and analysed by
    the glass that mirrors it: on black dashboards this raises the luminance by 40 to 60 %. Both faces of the glass mirror.
    """
    cabin = Cabin() if cabin is None else cabin
    vocabulary.validate(bsdf, "bsdf")
    dashboard = representation(nonspectral(bsdf))
    sun, sky = _of_the_sun(dashboard, cabin), _of_the_sky(dashboard, cabin)
    words = "luminance of the dashboard's image in the windscreen"
    values = {
        "veiling_luminance_sun": (sun, f"{words}, of the sun"),
        "veiling_luminance_sky": (sky, f"{words}, of the sky"),
    }
    values["veiling_luminance"] = sun + sky, f"{words}, of sun and sky"
    return xr.Dataset(
        {name: ((), value, {"units": "cd m-2", "long_name": text}) for name, (value, text) in values.items()}
    )


def _of_the_sun(dashboard: Representation, cabin: Cabin) -> float:
    sun = cabin.sun
    towards = unit_vector(90 - sun.elevation, sun.azimuth)
    if towards[2] <= 0 or not cabin.through_the_windscreen(towards):
        return 0.0
    radius = np.radians(SUN_RADIUS)
    luminance = sun.illuminance / (np.pi * np.sin(radius) ** 2)
    right = np.cross(towards, _UP) if towards[2] < 1 - 1e-12 else np.array([1.0, 0.0, 0.0])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, towards)])

    def light(owner: sphere_cubature.Indices, r: Array, turn: Array) -> Array:
        offset = np.sin(r)[:, None] * (np.cos(turn)[:, None] * axes[0] + np.sin(turn)[:, None] * axes[1])
        return _mirrored(dashboard, cabin, np.cos(r)[:, None] * towards + offset) * np.sin(r)

    mirror = cabin.view * [-1, -1, 1]
    across = axes @ mirror
    near, turn = np.arctan2(np.hypot(*across), mirror @ towards), np.arctan2(across[1], across[0])
    edges = sphere_cubature.graded(np.array([near]), 0.0, radius, radius / 3), _turns(turn)
    scattered = luminance * _integral(light, *edges)
    inside = near < radius
    return scattered + (luminance * _regular(dashboard, cabin) if inside else 0.0)


def _of_the_sky(dashboard: Representation, cabin: Cabin) -> float:
    sky, sun, glass = cabin.sky, (cabin.sun.elevation, cabin.sun.azimuth), cabin.windscreen

    def light(owner: sphere_cubature.Indices, slant: Array, across: Array) -> Array:
        to_glass = cabin.directions_to(slant, across)
        distance = np.linalg.norm(to_glass, axis=-1)
        directions = to_glass / distance[:, None]
        luminance = sky_luminance(sky.kind, sky.illuminance, sun, directions)
        return _mirrored(dashboard, cabin, directions) * luminance * cabin.height / distance**3

    mirror = cabin.view * [-1, -1, 1]
    half = glass.width / 2
    peaks = [at for direction in (mirror, unit_vector(90 - sun[0], sun[1])) if (at := cabin.point_on_glass(direction))]
    along, across = (np.array([at[k] for at in peaks]) for k in (0, 1))
    edges = (
        sphere_cubature.graded(along, 0.0, glass.length, glass.length / 6),
        sphere_cubature.graded(across, -half, half, half / 3),
    )
    value = _integral(light, *edges)
    if cabin.through_the_windscreen(mirror):
        value += float(sky_luminance(sky.kind, sky.illuminance, sun, mirror)) * _regular(dashboard, cabin)
    return value


def _turns(centre: float) -> Array:
    """Azimuths of a full turn [radian], graded towards one."""
    return np.radians(sphere_cubature.phi_edges(float(np.degrees(centre))))


def _integral(light: sphere_cubature.Integrand, first: Array, second: Array) -> float:
    low, high = sphere_cubature.rectangles(first, second)
    start = np.zeros(len(low), dtype=np.intp), low, high
    mesh = sphere_cubature.refine(start, sphere_cubature.plane_integral(light), ACCURACY)
    return float(mesh.totals(mesh.value, 1)[0, 0])


def _mirrored(dashboard: Representation, cabin: Cabin, directions: Array) -> Array:
    """What reaches the driver of light from directions (n, 3), as a share of its radiance: per solid angle of the source [sr-1]."""
    theta_i, phi_i = angles_of(directions)
    theta_o, phi_o = (np.full(len(directions), angle) for angle in angles_of(cabin.view))
    turn = cabin.material_azimuth
    below = theta_i >= 90
    matrix = dashboard.mueller(np.where(below, 0.0, theta_i), phi_i + turn, theta_o, phi_o + turn, None)[:, 0]
    entered = _entered(cabin, directions)
    reflected = np.einsum("nij,nj->ni", matrix[:, :2, :3], entered)
    return np.where(below, 0.0, np.cos(np.radians(theta_i)) * (reflected @ _analysed(cabin)))


def _entered(cabin: Cabin, directions: Array) -> Array:
    """I, Q and U in the dashboard's s–p frame of unit unpolarised light that the glass let in from directions (n, 3).

    Frames as in :mod:`brdfpipe.bsdf.microfacet.polarised`: s = k × n / |k × n| with the normal n of the dashboard or of the glass, and
    p = k × s. Where a plane of incidence is not defined, its s–p frame does not matter.
    """
    travel = -directions
    glass = cabin.windscreen.plate(np.abs(directions @ cabin.glass_normal))
    mean, half = (
        (glass.transmittance_s + glass.transmittance_p) / 2,
        (glass.transmittance_s - glass.transmittance_p) / 2,
    )
    s = np.cross(travel, _UP)
    # At the zenith the s–p frame follows the azimuth, which is 0 there.
    s = np.where(np.linalg.norm(s, axis=1, keepdims=True) > 1e-12, s, [0.0, 1.0, 0.0])
    s /= np.linalg.norm(s, axis=1, keepdims=True)
    p = np.cross(travel, s)
    of_glass = np.cross(travel, cabin.glass_normal)
    along_s, along_p = (of_glass * s).sum(axis=1), (of_glass * p).sum(axis=1)
    square = np.maximum(along_s**2 + along_p**2, 1e-30)
    return np.stack([mean, half * (along_s**2 - along_p**2) / square, half * 2 * along_s * along_p / square], axis=-1)


def _analysed(cabin: Cabin) -> Array:
    """Weights of I and Q of the dashboard's light in what the glass mirrors: both have the plane y = 0 as their plane of incidence."""
    glass = cabin.windscreen.plate(np.abs(cabin.view @ cabin.glass_normal))
    return np.array([glass.reflectance_s + glass.reflectance_p, glass.reflectance_s - glass.reflectance_p]).ravel() / 2


def _regular(dashboard: Representation, cabin: Cabin) -> float:
    """Share of the radiance from the mirror direction that a polished dashboard mirrors, and then the glass."""
    mirror = cabin.view * [-1, -1, 1]
    theta, phi = (np.atleast_1d(angle) for angle in angles_of(mirror))
    share = float(dashboard.specular(theta, phi + cabin.material_azimuth, None)[0][0, 0])
    if share == 0:
        return 0.0
    matrix = np.eye(2)
    if dashboard.uses_index and "n" in dashboard.dataset:
        # Means over wavelength, where the dataset keeps several: only the ratio of s and p depends on them.
        n, k = (float(dashboard.dataset[name].mean()) if name in dashboard.dataset else 0.0 for name in ("n", "k"))
        fresnel = facet_mueller(np.cos(np.radians(theta[0])), n, k)[:2, :2]
        matrix = fresnel / fresnel[0, 0]
    else:
        matrix[1] = 0.0  # not known: unpolarised
    return float(share * (_analysed(cabin) @ matrix @ _entered(cabin, mirror[None])[0, :2]))
