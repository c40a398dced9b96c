"""The BSDF of what the pixels of a scan's texture do not resolve, and how far the map with it is from the BRDF without a map."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.microfacet.builder import build
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.geometry import Array, angles_of
from brdfpipe.texture.scan_texture import facets_of, map_slopes
from brdfpipe.texture.seen_from_afar import seen_from_afar

NOTABLE_DIFFERENCE = 0.1
"""From which on a warning says that the map with the rest is not the BRDF."""

NOTABLE_LAY = 0.02
"""From which on a warning says that the map has a lay that the BRDF has not; a map whose lay the BRDF has is within 2 % of it."""

_LIGHT = np.array([(0.0, 0.0), *((radius, turn) for radius in (2.0, 4.0) for turn in range(0, 360, 60))])
"""Directions of a round light about its middle: radius and turn [degree]."""
_INCIDENCES, _BESIDE = (0.0, 25.0, 45.0), (-1.5, -0.7, 0.0, 0.7, 1.5)
"""Incidences [degree], and distances of lights from the mirror direction in slope rms."""
_AZIMUTHS = (20.0, 80.0, 140.0)
"""Of the light on a surface without a lay [degree]: in their mean the lay of a map does not show."""
_BINS_PER_WIDTH, _MOST_BINS = 3.0, 6000


class Differences(NamedTuple):
    """Rms relative differences between the mean over a map and the BRDF without it."""

    mean: float
    """Of a BRDF without a lay in the mean over azimuths of the light, else along and across the lay."""
    lay: float
    """Of single azimuths from that mean; 0 where the BRDF has a lay."""


def unresolved_bsdf(
    texture: xr.Dataset, index: xr.Dataset, bsdf: xr.Dataset, spectrum: xr.Dataset | None = None
) -> xr.Dataset:
    """The BSDF that goes with the map of a scan.

    Parameters
    ----------
    texture : kind ``texture``, of a scan
    index, spectrum : of the material, as :func:`brdfpipe.bsdf.microfacet.builder.build` takes them
    bsdf : kind ``bsdf``, of the material without a map

    Returns
    -------
    Dataset of kind ``bsdf``, representation ``microfacet``; the attributes ``mean_difference`` and ``lay_difference`` are the rms relative :class:`Differences` between the mean over
    the map and ``bsdf``, over lights of 5 degree from the mirror direction to 1.5 rms slopes beside it, at incidences of 0, 25 and 45 degree
    """
    vocabulary.validate(texture, "texture")
    rest = build(facets_of(texture), index=index, spectrum=spectrum)
    found = differences(texture, rest, bsdf)
    rest = rest.assign_attrs(mean_difference=found.mean, lay_difference=found.lay, route="predicted")
    warnings = []
    if found.mean > NOTABLE_DIFFERENCE:
        warnings.append(
            f"the map with this BSDF differs from the BRDF of the material by {found.mean:.0%}, seen from afar: by waves or light reflected more than once, which the split of the "
            "facets does not have, or by fine roughness that depends on the place"
        )
    if found.lay > NOTABLE_LAY:
        warnings.append(
            f"in light from single azimuths the map with this BSDF is {found.lay:.1%} brighter or darker than the BRDF of the material: the coarse structure of the scan has a "
            "lay that the BRDF has not; scan a larger part, or set `surface.isotropic: false`, so that both have it"
        )
    return vocabulary.add_warning(rest, *warnings)


def differences(texture: xr.Dataset, rest: xr.Dataset, bsdf: xr.Dataset) -> Differences:
    """The differences of :func:`unresolved_bsdf`; the rest and the BRDF in their mean over wavelengths, V(λ)·D65."""
    lay = representation(bsdf).lay
    slopes = map_slopes(texture, _BINS_PER_WIDTH, _MOST_BINS)
    slope_rms = float(np.sqrt(texture["slope_rms"] ** 2 + np.trace(slopes.covariance)))
    of_rest, whole = nonspectral(rest), nonspectral(bsdf)
    found = []
    for azimuth in _AZIMUTHS if lay is None else (lay, lay + 90.0):
        pairs = _lights(slope_rms, azimuth)
        both = seen_from_afar(of_rest, slopes, *pairs), representation(whole).evaluate(*pairs, None)
        means = [one.mean(axis=-1).reshape(-1, len(_LIGHT)).mean(axis=1) for one in both]
        found.append(means[0] / means[1] - 1)
    each = np.array(found)
    middle = each.mean(axis=0) if lay is None else each
    return Differences(*(float(np.sqrt(np.mean(one**2))) for one in (middle, each - middle)))


def _lights(slope_rms: float, azimuth: float) -> tuple[Array, Array, Array, Array]:
    """Incidences, and directions of the lights."""
    tilt = np.degrees(np.arctan(slope_rms))
    middles = np.array([(theta, theta + step * tilt) for theta in _INCIDENCES for step in _BESIDE])
    theta_i, middle = np.repeat(middles, len(_LIGHT), axis=0).T
    radius, turn = np.radians(np.tile(_LIGHT, (len(middles), 1)).T)
    # About the middle, which lies opposite to the incidence: one tangent in the plane of incidence, the other across it.
    at, zero = np.radians(middle), np.zeros_like(middle)
    towards = np.stack([-np.sin(at), zero, np.cos(at)], axis=-1)
    along, across = np.stack([-np.cos(at), zero, -np.sin(at)], axis=-1), np.array([0.0, 1.0, 0.0])
    outgoing = (
        np.cos(radius)[:, None] * towards
        + (np.sin(radius) * np.cos(turn))[:, None] * along
        + (np.sin(radius) * np.sin(turn))[:, None] * across
    )
    theta_o, phi_o = angles_of(outgoing)
    return theta_i, np.full_like(theta_i, azimuth), np.minimum(theta_o, 85.0), phi_o + azimuth
