"""The scattering indicatrix: light of one incidence as a body whose radius in each direction is the logarithm of the BRDF."""

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

_ALONG, _AROUND = 13, 22
"""Meshes from the mirror direction to the horizon, and around it."""
_KNEE = 3.0
"""Angle from the mirror direction [degree] beyond which meshes grow."""
_MOST_DECADES = 5
_DARK = 0.6
"""What is left of the colour of a mesh that turns away from the lamp that shades the body."""
_LAMP = np.array([-0.36, -0.48, 0.8])
_SIZE = 230.0
"""Of the largest radius [figure unit]."""
_MIDDLE, _HEIGHT = (WIDTH / 2, _SIZE + 10), _SIZE + 160
"""Where the middle of the sample stands, and how high the figure is [figure unit]."""
_NORMAL = 0.95
"""Length of the normal, of the largest radius."""

_RIGHT = np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0])
_UP = np.array([-np.sqrt(1 / 6), np.sqrt(1 / 6), np.sqrt(2 / 3)])
_EYE = np.array([np.sqrt(1 / 3), -np.sqrt(1 / 3), np.sqrt(1 / 3)])
"""An isometric view of x away from the source, y across, z along the normal; the eye is on the side the light goes to."""


def indicatrix(bsdf: xr.Dataset, incidence: float) -> Figure | None:
    """The BRDF of an incidence over all directions as a body, in an isometric view; None where there is no light.

    Parameters
    ----------
    bsdf : of a BSDF with a lay, the plane of incidence is along it
    incidence : degree, below 90
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
    title = f"3-D lobe at {incidence:g}° incidence" + (f" {plane.words}" if plane.words else "")
    parts = [*_ground([r for r, _ in rings]), *_rays(incidence, float(radius[0, 0])), _meshes(body, radius)]
    clear = [ring for ring in rings if ring[0] > 1.1 * _SIZE * float(radius[-1].max())]
    parts += [text(4, 15, "radius: BRDF, sr⁻¹ (log)", "start", "t"), *_labels(clear, incidence)]
    svg = frame(f"{title}: BRDF over all directions as a body, radius logarithmic", _HEIGHT, parts)
    note = (
        f"{bsdf_sections.wavelength_words(bsdf).capitalize()}. The radius in a direction is the logarithm of the BRDF there, from "
        f"{power_of_ten(int(low))} sr⁻¹ at the centre to {number(float(positive.max()))} sr⁻¹; rings on the sample mark decades. "
        "Meshes are drawn about the mirror direction, finer near it."
    )
    return Figure(title, svg, note=note)


def _directions(incidence: float) -> tuple[Array, Array]:
    """Polar angle, and azimuth from the one away from the source, (along, around): from the mirror direction to the horizon."""
    phi = np.linspace(-180.0, 180.0, _AROUND + 1)
    horizon = 90 + np.degrees(np.arctan(np.cos(np.radians(phi)) * np.tan(np.radians(incidence)))) - 0.2
    part = np.linspace(0.0, 1.0, _ALONG + 1)[:, None]
    theta_o, azimuth = outgoing(incidence, _KNEE * np.sinh(part * np.arcsinh(horizon / _KNEE)), phi)
    return np.minimum(theta_o, 89.9), azimuth - 180


def _range(positive: Array) -> tuple[float, float]:
    """Exponents of ten at the centre and at the largest radius."""
    high = float(np.log10(positive.max()))
    low = float(np.floor(np.log10(np.percentile(positive, 2)) - 0.5))
    return max(low, float(np.ceil(high)) - _MOST_DECADES), high


def _seen(points: Array) -> tuple[Array, Array]:
    """Figure units of points."""
    return _MIDDLE[0] + points @ _RIGHT, _MIDDLE[1] - points @ _UP


def _meshes(body: Array, radius: Array) -> str:
    """The meshes that face the eye, the farthest first, in half units of the figure."""
    corners = _corners(body)
    middle = corners.mean(axis=1)
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    # Seen from the centre, the outside of every mesh is the far one.
    normal *= np.sign((normal * middle).sum(axis=1, keepdims=True))
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    level = viridis(_corners(radius[..., None]).mean(axis=(1, 2)))
    shade = _DARK + (1 - _DARK) * np.maximum(normal @ _LAMP, 0).round(1)
    colours = (level * shade[:, None]).round().astype(np.uint8)
    x, y = ((2 * axis).round().astype(int) for axis in _seen(corners))
    # Ties in depth, left and right of the plane of incidence, must not fall by rounding.
    order = np.argsort((middle @ _EYE).round(3), kind="stable")
    parts = [_mesh(x[k], y[k], colours[k]) for k in order[(normal @ _EYE > 1e-6)[order]]]
    box = f'viewBox="0 0 {2 * WIDTH} {2 * _HEIGHT:g}" width="{WIDTH}" height="{_HEIGHT:g}"'
    return f'<svg class="mesh" {box}>{"".join(parts)}</svg>'


def _corners(grid: Array) -> Array:
    """What stands at the corners of each mesh, in turn, (mesh, 4, …)."""
    turns = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=2)
    return np.asarray(turns.reshape(-1, 4, grid.shape[-1]))


def _mesh(x: NDArray[np.int64], y: NDArray[np.int64], colour: NDArray[np.uint8]) -> str:
    red, green, blue = colour.tolist()
    steps = " ".join(f"{a}{b:+d}" for a, b in zip(np.diff(x).tolist(), np.diff(y).tolist(), strict=True))
    return f'<path fill="#{red:02x}{green:02x}{blue:02x}" d="M{x[0]} {y[0]}l{steps}z"/>'


def _ground(radii: list[float]) -> list[str]:
    """The sample's plane: rings of decades and one about all, and the plane of incidence and the one across it."""
    circle = f'<ellipse class="g" cx="{_MIDDLE[0]:g}" cy="{_MIDDLE[1]:g}"'
    parts = [f'{circle} rx="{r:.1f}" ry="{r * _EYE[2]:.1f}"/>' for r in [*radii, _SIZE]]
    ends = _seen(_SIZE * np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 1.0, 0.0]]))
    return [*parts, _lines(*ends, [(0, 1), (2, 3)], "g")]


def _lines(x: Array, y: Array, pairs: list[tuple[int, int]], style: str) -> str:
    """Straight lines from point to point."""
    data = "".join(f"M{x[a]:.1f} {y[a]:.1f}L{x[b]:.1f} {y[b]:.1f}" for a, b in pairs)
    return f'<path class="{style}" d="{data}"/>'


def _rays(incidence: float, tip: float) -> list[str]:
    """The light that comes, the mirror direction beyond the lobe, and the normal."""
    source, mirror, normal = (
        _SIZE * unit_vector(theta, azimuth) for theta, azimuth in ((incidence, 180.0), (incidence, 0.0), (0.0, 0.0))
    )
    x, y = _seen(np.stack([source, mirror * tip, mirror * 1.12, normal * _NORMAL, 0 * normal]))
    return [_lines(x, y, [pair], style) for style, pair in (("l c3", (0, 4)), ("l ref d", (1, 2)), ("l ref", (3, 4)))]


def _labels(rings: list[tuple[float, str]], incidence: float) -> list[str]:
    ends = (1.03, incidence, 180.0, "light", "end"), (1.16, incidence, 0.0, "mirror", "start")
    parts = []
    for reach, theta, azimuth, name, anchor in (*ends, (_NORMAL + 0.03, 0.0, 0.0, "normal", "start")):
        x, y = _seen(reach * _SIZE * unit_vector(theta, azimuth))
        parts.append(text(float(x), float(y), name, anchor))
    for radius, name in rings[:: -max(1, round(len(rings) / 4))]:
        x, y = _seen(np.array([0.0, -radius, 0.0]))
        parts.append(text(float(x), float(y) + 4, name, "middle", "h"))
    return parts
