"""Whether a surface is rough enough for facets: the variance of the phase that its heights give to reflected light."""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe import vocabulary

LIMITS = 0.01, 20.0
"""Phase variances between which facets give wrong values: below, the surface is a mirror; above, geometrical optics holds to a few percent."""

_INCIDENCES = (20, 60, 85)
_WAVELENGTH = 0.55


def phase_variances(sigma: float) -> dict[int, float]:
    """g at 550 nm by incidence of gloss meters [degree], of an rms height [um]."""
    return {angle: (4 * np.pi * sigma * np.cos(np.radians(angle)) / _WAVELENGTH) ** 2 for angle in _INCIDENCES}


def known_rms_height(psd: xr.Dataset) -> float:
    """Rms height [um] of a roughness spectrum in its band, and of longer waves."""
    return float(np.hypot(float(psd["sigma"]), float(psd.get("long_sigma", 0.0))))


def unresolved_rms_height(psd: xr.Dataset | None) -> float:
    """Rms height [um] of a plateau of a roughness spectrum that is noise or roughness finer than the pitch; 0 without a spectrum."""
    return 0.0 if psd is None else float(psd.get("unresolved_sigma", 0.0))


def with_warning(bsdf: xr.Dataset, psd: xr.Dataset) -> xr.Dataset:
    """Add a warning where a surface is too smooth for its facets.

    Parameters
    ----------
    bsdf : kind ``bsdf``, of facets
    psd : kind ``psd``, of the same surface

    Notes
    -----
    g = (4πσ cos θ_i/λ)² at 550 nm and the incidences of gloss meters; e^(−g) of the mirror reflection is coherent (Davies 1954, Proc. IEE
    101 part IV, 209), which facets cannot show.
    """
    sigma = known_rms_height(psd)
    phase = phase_variances(sigma)
    between = [f"{g:.2g} at {angle}°" for angle, g in phase.items() if LIMITS[0] < g < LIMITS[1]]
    if not between:
        return bsdf
    text = (
        f"the surface is too smooth for facets: with its rms height of {1e3 * sigma:.3g} nm the phase variance g is {', '.join(between)} "
        f"incidence (550 nm); below {LIMITS[1]:g} facets give wrong light near the mirror direction. Set `model.optics: auto`"
    )
    return vocabulary.add_warning(bsdf, text)
