"""Total transmittance of a material, and its haze: the scattered share of the transmitted light.

References
----------
ASTM D1003 (haze: the share of the transmitted light that deviates from the incident beam by more than 2.5°). Conformance is not
claimed: light of one direction instead of an instrument's beam, weighted with V(λ)·D65; results are "D1003-style".
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.source_changes import Reflector
from brdfpipe.geometry import Array
from brdfpipe.hemisphere import panel_rule

HAZE_CONE = 2.5
"""Half angle of the cone of light that counts as not scattered [degree]."""

_UNKNOWN_SLOPE = 5e-3
_ORDER = 8
_AZIMUTHS = np.arange(0.0, 360.0, 5.0)


def luminous_transmittance(bsdf: xr.Dataset, reflector: Reflector | None = None) -> float:
    """Total transmittance at normal incidence, weighted with V(λ)·D65 [1].

    Parameters
    ----------
    bsdf : kind ``bsdf``; 0 where it does not transmit
    reflector : what transmits in place of the BSDF, at its wavelengths
    """
    from brdfpipe.spectra import colorimetry

    wavelength, total = representation(bsdf).total_transmittance()
    if reflector is not None:
        normal = np.zeros(1)
        total = np.broadcast_to(reflector.transmittance(normal, normal, None)[0], total.shape)
    weight = colorimetry.luminous_weight(wavelength)
    return float(weight @ total / weight.sum())


def transmission_haze(bsdf: xr.Dataset, reflector: Reflector | None = None) -> float:
    """Share of the transmitted light that is scattered by more than 2.5°, at normal incidence, D1003-style [1].

    Parameters
    ----------
    bsdf : kind ``bsdf``; averaged with V(λ)·D65 where it depends on wavelength
    reflector : what transmits in place of the averaged BSDF

    Returns
    -------
    float : 0 for a clear plate, 0.998 for a perfect diffuser; NaN where nothing is transmitted
    """
    vocabulary.validate(bsdf, "bsdf")
    measured = representation(nonspectral(bsdf)) if reflector is None else reflector
    normal = np.zeros(1)
    total = float(measured.transmittance(normal, normal, None)[0, 0])
    if not total > 0:
        return float("nan")
    straight = float(measured.specular(normal, normal, None)[1][0, 0])
    theta, phi, weight = _cone(representation(bsdf).lobe_slope or _UNKNOWN_SLOPE)
    incidence = np.zeros_like(theta)
    btdf = measured.evaluate(incidence, incidence, 180 - theta, phi, None)
    within_cone = straight + float(weight @ btdf[:, 0])
    return float(np.clip(1 - within_cone / total, 0.0, 1.0))


def _cone(slope: float) -> tuple[Array, Array, Array]:
    """Directions within the cone and their projected solid angles, graded towards the axis on the scale of the slope."""
    doublings = int(np.clip(np.ceil(np.log2(8 * np.radians(HAZE_CONE) / slope)), 2, 40))
    edges = np.concatenate([[0.0], HAZE_CONE * 2.0 ** np.arange(-doublings, 1)])
    theta, width = panel_rule(edges, _ORDER)
    share = np.radians(width) * np.sin(np.radians(theta)) * np.cos(np.radians(theta))
    theta, phi = (grid.ravel() for grid in np.meshgrid(theta, _AZIMUTHS, indexing="ij"))
    return theta, phi, np.repeat(share, _AZIMUTHS.size) * 2 * np.pi / _AZIMUTHS.size
