"""Parameters of a closed form that were read from a file, evaluated on a table of half-angle coordinates."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from brdfpipe.bsdf.grids import GRIDS
from brdfpipe.bsdf.tabulation import values_on_nodes
from brdfpipe.errors import InputError
from brdfpipe.exchange.fits.fitting import WIDTHS
from brdfpipe.exchange.fits.forms import Lobe, Material, by_albedo, dielectric, nothing, schlick
from brdfpipe.exchange.read_table import Channels, ReadTable
from brdfpipe.geometry import Array

Evaluate = Callable[[Array, Array, Array, Array], Array]
"""(theta_i, phi_i, theta_o, phi_o) [degree] → BRDF (directions, channels) [sr-1]"""

LARGEST_INDEX = 10.0
_WIDEST_ANGLE = 89.5
_STEPS_OF_LOBE, _STEPS_OF_BODY = 180, 45
"""Nodes of the half vector: by the width of the lobe, and even. A bare lobe of GGX of width 0.06 then errs by 2.0 % at the 95th percentile, of 0.3 by 1.2 %."""
_THETA_D = _WIDEST_ANGLE * np.sin(np.pi / 2 * np.linspace(0, 1, 45))
"""Dense towards grazing incidence [degree]."""
_PHI_D = np.linspace(0.0, 180.0, 25)


def table(
    evaluate: Evaluate, width: float, channels: Channels, words: str, warnings: tuple[str, ...] = ()
) -> ReadTable:
    """A table of a BRDF that is the same on both sides of the plane of incidence and without a lay.

    Parameters
    ----------
    evaluate : the BRDF of directions above the surface
    width : of its lobe, as a slope of the half vector [1]; it decides the nodes
    channels : ``photopic``, or ``rgb`` for linear sRGB
    words : what was evaluated
    """
    log = np.arcsinh(np.tan(np.radians(_WIDEST_ANGLE)) / width)
    lobe = np.degrees(np.arctan(width * np.sinh(np.linspace(0, log, _STEPS_OF_LOBE))))
    even = np.linspace(0, _WIDEST_ANGLE, _STEPS_OF_BODY)
    axes = {"theta_h": np.unique(np.round([*lobe, *even], 4)), "theta_d": _THETA_D, "phi_d": _PHI_D}

    def above(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, _: None) -> Array:
        # Nodes below the horizon continue the values at it, because cells there reach above it.
        at = np.minimum(theta_i, _WIDEST_ANGLE), phi_i, np.minimum(theta_o, _WIDEST_ANGLE), phi_o
        shape = np.broadcast_shapes(*(angle.shape for angle in at))
        found = evaluate(*(np.broadcast_to(angle, shape).ravel() for angle in at))
        return found.reshape(*shape, -1)

    values = values_on_nodes(above, GRIDS["half"], axes, False, True)
    return ReadTable(
        "half", axes, values, channels=channels, notes=(f"parameters, not a table: {words}",), warnings=warnings
    )


def shading_model(
    path: Path,
    *,
    colour: Array,
    metalness: float,
    roughness: float,
    index: float,
    form: str,
    warnings: tuple[str, ...] = (),
) -> ReadTable:
    """The table of GGX facets over a Lambertian base, as OpenPBR or glTF mean it.

    Parameters
    ----------
    path : of the file, for messages
    colour : (3,) of the base, or the reflectance of a metal at normal incidence, linear sRGB
    metalness : share of the metal in a mixture of both
    roughness : its square is the width of the lobe
    index : of the dielectric
    form : ``OpenPBR``, Fresnel's equations and light that facets reflect more than once, or ``glTF 2.0``, Schlick's curve

    Raises
    ------
    InputError : a parameter is out of range.
    """
    from brdfpipe.exchange.fits.forms import by_fresnel
    from brdfpipe.optics.fresnel_equations import fresnel

    for name, value, low, high in (
        *((f"colour {part}", value, 0.0, 1.0) for part, value in zip("RGB", colour, strict=True)),
        ("metalness", metalness, 0.0, 1.0),
        ("roughness", roughness, 0.0, 1.0),
        ("index of refraction", index, 1.0, LARGEST_INDEX),
    ):
        if not low <= value <= high:
            raise InputError(path, f"the {name} is out of range", found=f"{value:g}", accepted=f"{low:g} to {high:g}")
    exact = form == "OpenPBR"
    width = max(roughness**2, WIDTHS[0])
    normal = np.full(3, float(fresnel(1.0, index).mean))
    glossy = Lobe("ggx", width, dielectric(index) if exact else schlick(normal), exact)
    body = Material(glossy, colour, by_albedo if exact else by_fresnel)
    metal = Material(Lobe("ggx", width, schlick(colour), exact), np.zeros(3), nothing)
    parts = [(share, part) for share, part in ((1 - metalness, body), (metalness, metal)) if share > 0]
    if roughness**2 < WIDTHS[0]:
        warnings += (
            f"the roughness {roughness:g} mirrors light into a single direction, which no table holds: it was evaluated at "
            f"{np.sqrt(WIDTHS[0]):.3g}; of a smooth face use `surface: {{distribution: flat}}` and the index",
        )
    words = (
        f"the microfacet model of {form}: GGX of width {width:.4g} over a Lambertian base of linear sRGB "
        f"{', '.join(f'{value:.4g}' for value in colour)}, metalness {metalness:g}, index {index:g}"
    )

    def evaluate(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        at = theta_i, phi_i, theta_o, phi_o
        return np.sum([share * part.evaluate(*at) for share, part in parts], axis=0)

    return table(evaluate, width, "rgb", words, warnings)


def number(path: Path, value: object, name: str) -> float:
    """A finite number. Raises InputError: it is something else."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(path, f"{name} is not a number", found=repr(value)[:40], accepted="a finite number")
    return float(value)


def part(path: Path, values: Mapping[str, Any], name: str) -> dict[str, Any]:
    """An object within an object, empty where there is none. Raises InputError: it is something else."""
    found = values.get(name, {})
    if not isinstance(found, dict):
        raise InputError(path, f"{name} is not an object", found=type(found).__name__, accepted="{…}")
    return found
