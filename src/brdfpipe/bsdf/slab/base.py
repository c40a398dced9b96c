"""What lies below a clear coat: an opaque body with a face of its own, as an operator on the light inside the coat.

The face reflects by its facets, or as a mirror. Facets lose light to one another; it comes back diffusely, less what each further
reflection passes on. Light that the face lets through enters the body, which returns it diffusely: below the face by Lambert's law, and
out of it, by reciprocity, in proportion to the same transmittance. That part is an operator of rank one, so that the reflectance of the
body, and with it the colour, follows from a total reflectance without further operators.

References
----------
Kulla & Conty 2017 (SIGGRAPH course) for the light that facets lose; Sherman & Morrison 1950 (Ann. Math. Stat. 21, 124) for the
rank-one part; conventions as in :mod:`brdfpipe.bsdf.slab.face`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from brdfpipe.bsdf.microfacet import energy
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.slab.adding_doubling import Sheet, solved
from brdfpipe.bsdf.slab.face import (
    LEAST_LOSS,
    Azimuths,
    Face,
    Nodes,
    balance,
    mirror_elements,
    mirrored_by_facets,
)
from brdfpipe.geometry import Array
from brdfpipe.optics.fresnel_equations import mean_fresnel

_TINY = 1e-300


def of_base(
    surface: Microsurface | None,
    masking: str,
    coat_index: float,
    relative: tuple[float, float],
    nodes: Nodes,
    azimuths: Azimuths,
    sharp: bool,
) -> Face:
    """The face of an opaque body below a coat, at one wavelength, as the back of a sheet through which nothing passes.

    Parameters
    ----------
    surface : facets of the base; None for a smooth one
    coat_index : refractive index of the coat, relative to air
    relative : n and k of the base, relative to the coat
    sharp : take the lobe that the facets reflect as a single direction, because the nodes do not resolve it
    """
    n, k = relative
    root, none = np.sqrt(nodes.weight), np.zeros(nodes.outside.size)
    mirrored, within, lost, correction = mirror_elements(np.cos(np.radians(nodes.inside)), n, k), None, 0.0 * root, 0.0
    if surface is not None:
        given = surface, masking, np.array([n]), np.array([k]), nodes.inside
        albedo, of_mirrors = energy.directional_albedo(*given, mirrors=True).T
        albedo, lost = np.clip(albedo, 0.0, 1 - LEAST_LOSS), np.clip(1 - of_mirrors, 0.0, 1.0)
        lost *= _returned_share(mean_fresnel(np.array([n]), np.array([k]))[0], root, lost)
        if sharp:
            mirrored *= albedo / np.maximum(mirrored[0], _TINY)
        else:
            mirrored = np.zeros_like(mirrored)
            within = mirrored_by_facets(surface, masking, coat_index, nodes, azimuths, relative)
            scale, correction = balance(within[0], azimuths, root, root, albedo, albedo)
            within *= scale[..., None]
    return Face(
        reflected=none,
        straight=np.zeros((2, none.size)),
        mirrored=mirrored,
        through=None,
        within=within,
        lost_outside=none,
        lost_inside=np.stack([lost, np.zeros_like(lost)]),
        root=root,
        correction=correction,
        mirrored_outside=none,
    )


def _returned_share(reflectance: float, root: Array, lost: Array) -> float:
    """Share of the light lost by facets that they reflect in the end, F² Ē / (1 − F (1 − Ē)) with F the mean reflectance."""
    kept = 1 - float(root**2 @ lost) / float(root**2 @ np.ones_like(root))
    return reflectance**2 * kept / (1 - reflectance * (1 - kept))


class BodyLight(NamedTuple):
    """How the body shows through the coat: f = A(θ_i) A(θ_o) G / 2π, with G = g / (1 − g κ) and g the strength of the body."""

    entering: Array
    """(N,) A: light from outside that enters the body before it has been there, over the root of its étendue"""
    returned: float
    """κ: light of the body of unit strength that enters it again"""
    strongest: float
    """g of a body that absorbs nothing"""

    def weight(self, strength: Array) -> Array:
        """G of a body of a strength g."""
        return np.asarray(strength / (1 - strength * self.returned))


def body_light(sheet: Sheet, transmittance: float) -> BodyLight:
    """The light of a body below the back of a sheet, for an internal transmittance of the coat at normal incidence."""
    components, inside = 2, sheet.nodes.inside.size
    (t_front,), (r_front,) = sheet.front.operators(sheet.azimuths, np.zeros(1), components)
    _, (r_back,) = sheet.back.operators(sheet.azimuths, np.zeros(1), components)
    root = sheet.back.root
    leaving = np.einsum("o,oaj->aj", root, r_back[0]) / root
    # What the face does not reflect enters: 1 − I from I, and − I from Q.
    entering = np.array([1.0, 0.0])[:, None] - leaving
    entering[0] = np.maximum(entering[0], 0.0)
    face = (root * entering).ravel()
    passage = np.tile(sheet.passage(transmittance), components)
    size = components * inside
    above, below = (operator.reshape(size, size) * passage for operator in (r_front, r_back))
    sources = np.column_stack([t_front.reshape(size, -1), above @ face])
    down = solved(above @ below, sources)
    reached = (face * passage) @ down
    total = float(root**2 @ entering[0])
    return BodyLight(reached[:-1] / sheet.front.outer_root, float(reached[-1]), 1 / max(total, _TINY))
