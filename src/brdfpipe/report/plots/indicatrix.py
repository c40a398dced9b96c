"""The scattering indicatrix: BRDF of one incidence as a body whose radius in each direction is the logarithm of the BRDF."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe.geometry import unit_vector
from brdfpipe.report.formatting import number
from brdfpipe.report.plots import bsdf_sections
from brdfpipe.report.plots.raster import viridis
from brdfpipe.report.plots.svg import WIDTH, Array, Figure, frame, power_of_ten, text
from brdfpipe.specular_directions import outgoing

_RADIAL_MESHES, _AZIMUTHAL_MESHES = 13, 22
"""From the mirror direction to the horizon, and around the mirror direction."""
_FINE_ANGLE = 3.0
"""Angle from the mirror direction beyond which meshes become larger [degree]."""
_MOST_DECADES = 5
_AMBIENT = 0.6
"""Brightness of a mesh that faces away from the lamp."""
_LAMP = np.array([-0.36, -0.48, 0.8])
_SIZE = 230.0
"""Largest radius [figure units]."""
_CENTRE_X, _CENTRE_Y, _HEIGHT = WIDTH / 2, _SIZE + 10, _SIZE + 160
_NORMAL_LENGTH = 0.95
"""Share of the largest radius."""

_RIGHT = np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0])
_UP = np.array([-np.sqrt(1 / 6), np.sqrt(1 / 6), np.sqrt(2 / 3)])
_EYE = np.array([np.sqrt(1 / 3), -np.sqrt(1 / 3), np.sqrt(1 / 3)])
"""Isometric view: x away from the source, y across, z along the normal; the eye is on the side to which the light is reflected."""


def indicatrix(bsdf: xr.Dataset, incidence: float) -> Figure | None:
    """The BRDF of an incidence [degree] over all directions as a body, in isometric view; None without light.

    With a lay, the plane of incidence is along it.
    """
    plane = bsdf_sections.planes(bsdf)[0]
    theta_o, turn = _directions(incidence)
    value = bsdf_sections.value(bsdf, plane, incidence, theta_o, turn)
    positive = value[np.isfinite(value) & (value > 0)]
    if not positive.size:
        return None
    low, high = _range(positive)
    radius = np.clip((np.log10(np.maximum(np.nan_to_num(value), 10.0 ** (low - 1))) - low) / (high - low), 0, 1)
    decades = range(int(low) + 1, int(np.floor(high)) + 1)
    rings = [(_SIZE * (exponent - low) / (high - low), power_of_ten(exponent)) for exponent in decades]
    body = _SIZE * radius[..., None] * unit_vector(theta_o, turn)
    title = plane.title(f"3-D lobe at {incidence:g}° incidence")
    parts = [*_ground([r for r, _ in rings]), *_rays(incidence, float(radius[0, 0])), _meshes(body, radius)]
    outside = [ring for ring in rings if ring[0] > 1.1 * _SIZE * float(radius[-1].max())]
    parts += [text(4, 15, "radius: BRDF, sr⁻¹ (log)", "start", "t"), *_labels(outside, incidence)]
    svg = frame(f"{title}: BRDF over all directions as a body, radius logarithmic", _HEIGHT, parts)
    note = (
        f"{bsdf_sections.wavelength_words(bsdf).capitalize()}. The radius in a direction is the logarithm of the BRDF there, from "
        f"{power_of_ten(int(low))} sr⁻¹ at the centre to {number(float(positive.max()))} sr⁻¹; rings on the sample mark decades. "
        "Meshes are drawn about the mirror direction, finer near it."
    )
    return Figure(title, svg, note=note)


def _directions(incidence: float) -> tuple[Array, Array]:
    """Polar angle, and azimuth from the one away from the source: rings from the mirror direction to the horizon."""
    phi = np.linspace(-180.0, 180.0, _AZIMUTHAL_MESHES + 1)
    horizon = 90 + np.degrees(np.arctan(np.cos(np.radians(phi)) * np.tan(np.radians(incidence)))) - 0.2
    part = np.linspace(0.0, 1.0, _RADIAL_MESHES + 1)[:, None]
    theta_o, azimuth = outgoing(incidence, _FINE_ANGLE * np.sinh(part * np.arcsinh(horizon / _FINE_ANGLE)), phi)
    return np.minimum(theta_o, 89.9), azimuth - 180


def _range(positive: Array) -> tuple[float, float]:
    """Exponents of ten at the centre and at the largest radius."""
    high = float(np.log10(positive.max()))
    low = float(np.floor(np.log10(np.percentile(positive, 2)) - 0.5))
    return max(low, float(np.ceil(high)) - _MOST_DECADES), high


def _projected(points: Array) -> tuple[Array, Array]:
    """Positions of points in the figure."""
    return _CENTRE_X + points @ _RIGHT, _CENTRE_Y - points @ _UP


def _meshes(body: Array, radius: Array) -> str:
    """The meshes that face the eye, the farthest first, in half figure units."""
    corners = _corners(body)
    middle = corners.mean(axis=1)
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    # The outside of every mesh faces away from the centre.
    normal *= np.sign((normal * middle).sum(axis=1, keepdims=True))
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    level = viridis(_corners(radius[..., None]).mean(axis=(1, 2)))
    shade = _AMBIENT + (1 - _AMBIENT) * np.maximum(normal @ _LAMP, 0).round(1)
    colours = (level * shade[:, None]).round().astype(np.uint8)
    x, y = ((2 * axis).round().astype(int) for axis in _projected(corners))
    # Rounding must not decide between equal depths, left and right of the plane of incidence.
    order = np.argsort((middle @ _EYE).round(3), kind="stable")
    parts = [_mesh(x[k], y[k], colours[k]) for k in order[(normal @ _EYE > 1e-6)[order]]]
    box = f'viewBox="0 0 {2 * WIDTH} {2 * _HEIGHT:g}" width="{WIDTH}" height="{_HEIGHT:g}"'
    return f'<svg class="mesh" {box}>{"".join(parts)}</svg>'


def _corners(grid: Array) -> Array:
    """Values at the four corners of each mesh, (mesh, 4, …)."""
    turns = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=2)
    return np.asarray(turns.reshape(-1, 4, grid.shape[-1]))


def _mesh(x: NDArray[np.int64], y: NDArray[np.int64], colour: NDArray[np.uint8]) -> str:
    red, green, blue = colour.tolist()
    steps = " ".join(f"{a}{b:+d}" for a, b in zip(np.diff(x).tolist(), np.diff(y).tolist(), strict=True))
    return f'<path fill="#{red:02x}{green:02x}{blue:02x}" d="M{x[0]} {y[0]}l{steps}z"/>'


def _ground(radii: list[float]) -> list[str]:
    """The plane of the sample: rings of decades and the outermost one, and the lines along and across the plane of incidence."""
    circle = f'<ellipse class="g" cx="{_CENTRE_X:g}" cy="{_CENTRE_Y:g}"'
    parts = [f'{circle} rx="{r:.1f}" ry="{r * _EYE[2]:.1f}"/>' for r in [*radii, _SIZE]]
    ends = _projected(_SIZE * np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 1.0, 0.0]]))
    return [*parts, _lines(*ends, [(0, 1), (2, 3)], "g")]


def _lines(x: Array, y: Array, pairs: list[tuple[int, int]], style: str) -> str:
    """Straight lines between pairs of points."""
    data = "".join(f"M{x[a]:.1f} {y[a]:.1f}L{x[b]:.1f} {y[b]:.1f}" for a, b in pairs)
    return f'<path class="{style}" d="{data}"/>'


def _rays(incidence: float, tip: float) -> list[str]:
    """Incident light, the mirror direction beyond the lobe, and the normal."""
    directions = (incidence, 180.0), (incidence, 0.0), (0.0, 0.0)
    source, mirror, normal = (_SIZE * unit_vector(*direction) for direction in directions)
    x, y = _projected(np.stack([source, mirror * tip, mirror * 1.12, normal * _NORMAL_LENGTH, 0 * normal]))
    return [_lines(x, y, [pair], style) for style, pair in (("l c3", (0, 4)), ("l ref d", (1, 2)), ("l ref", (3, 4)))]


def _labels(rings: list[tuple[float, str]], incidence: float) -> list[str]:
    ends = (1.03, incidence, 180.0, "light", "end"), (1.16, incidence, 0.0, "mirror", "start")
    parts = []
    for reach, theta, azimuth, name, anchor in (*ends, (_NORMAL_LENGTH + 0.03, 0.0, 0.0, "normal", "start")):
        x, y = _projected(reach * _SIZE * unit_vector(theta, azimuth))
        parts.append(text(float(x), float(y), name, anchor))
    for radius, name in rings[:: -max(1, round(len(rings) / 4))]:
        x, y = _projected(np.array([0.0, -radius, 0.0]))
        parts.append(text(float(x), float(y) + 4, name, "middle", "h"))
    return parts
