"""Degree of polarisation of the reflected light, over all directions."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe.bsdf.registry import representation
from brdfpipe.geometry import half_vector
from brdfpipe.report.plots import bsdf_sections
from brdfpipe.report.plots.directional_maps import (
    DECADES_SHOWN,
    HemispherePixels,
    direction_marks,
    hemisphere_figure,
    lay_turn,
    map_percent,
)
from brdfpipe.report.plots.svg import Array, Figure, sentence

POLARISED_INCIDENCE = 60.0
"""Angle of incidence of the map of polarisation, degree: that of the common gloss geometry, near Brewster's of most plastics."""


def polarisation(bsdf: xr.Dataset) -> Figure | None:
    """Degree of polarisation of the light reflected from unpolarised light; None where a BSDF cannot tell."""
    plane = bsdf_sections.planes(bsdf)[0]
    if not {"n", "k"} <= set(bsdf) or representation(bsdf).is_slab or (facets := _single_reflection(bsdf)) is None:
        return None
    title = f"Degree of polarisation, {POLARISED_INCIDENCE:g}° incidence" + (f" {plane.words}" if plane.words else "")
    if bsdf_sections.specular(bsdf, np.array([POLARISED_INCIDENCE]))[0].any():
        mirror = float(_facet_polarisation(bsdf, np.array([POLARISED_INCIDENCE]), np.zeros(1))[0])
        words = "Light from the base below is not." if _has_base(bsdf) else ""
        return sentence(
            title, f"Of unpolarised light, {map_percent(mirror)} of the mirrored ray is polarised. {words}".strip()
        )
    pixels = HemispherePixels(POLARISED_INCIDENCE)
    total = bsdf_sections.value(bsdf, plane, POLARISED_INCIDENCE, pixels.theta, pixels.turn)
    alone = bsdf_sections.value(facets, plane, POLARISED_INCIDENCE, pixels.theta, pixels.turn)
    if not total.max() > 0 or not alone.max() > 0:
        return None
    lit = total > total.max() * 10.0**-DECADES_SHOWN
    share = np.divide(alone, total, out=np.zeros_like(alone), where=lit)
    degree = np.where(lit, share * _facet_polarisation(bsdf, pixels.theta, pixels.turn), np.nan)
    at_mirror = float(degree[np.argmin((pixels.theta - POLARISED_INCIDENCE) ** 2 + pixels.turn**2)])
    most = int(np.nanargmax(degree))
    top = next(limit for limit in (0.1, 0.2, 0.5, 1.0) if degree[most] <= limit * (1 + 1e-9))
    svg = hemisphere_figure(
        f"Degree of polarisation of light reflected from unpolarised light at {POLARISED_INCIDENCE:g} degrees {plane.words}",
        pixels,
        (degree, 0.0, top, 20),
        "polarised share",
        [(fifths / 5, f"{20 * fifths * top:g}\u202f%") for fifths in range(6)],
        direction_marks(POLARISED_INCIDENCE, POLARISED_INCIDENCE, lay_turn(bsdf, plane)),
    )
    blank = "" if lit.all() else " Blank: less than a millionth of the peak."
    note = (
        f"Of unpolarised light, {map_percent(at_mirror)} of the light in the mirror direction (ring) is polarised. The largest degree is "
        f"{map_percent(float(degree[most]))}, at {pixels.theta[most]:.0f}°, {bsdf_sections.wavelength_words(bsdf)}. Light from the base "
        f"and light reflected more than once counts as unpolarised.{blank}"
    )
    return Figure(title, svg, note=note)


def _single_reflection(bsdf: xr.Dataset) -> xr.Dataset | None:
    """The part of a BSDF that keeps the polarisation a facet gives."""
    once = representation(bsdf).single_reflection()
    return once if once is not None else representation(bsdf).without_diffuse()


def _has_base(bsdf: xr.Dataset) -> bool:
    return bool(np.any(bsdf["diffuse"].values > 0)) if "diffuse" in bsdf else False


def _facet_polarisation(bsdf: xr.Dataset, theta_o: Array, turn: Array) -> Array:
    """Degree of polarisation of unpolarised light after the one facet that mirrors it towards a direction."""
    from brdfpipe.bsdf.microfacet.polarised import degree_of_polarisation, facet_mueller

    n, k = (float(bsdf_sections.at_reference(bsdf[name])) for name in ("n", "k"))
    # The frame in which the light is described turns with the direction; how much of it is polarised does not.
    cos_zeta = half_vector(POLARISED_INCIDENCE, 180.0, theta_o, turn).cos_zeta
    return degree_of_polarisation(facet_mueller(cos_zeta, n, k)[..., 0])
