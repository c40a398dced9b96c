"""Uncertainty of the gloss of the light that a height map diffracts, because the map is finite.

A map of an area A diffracts light in modes of 1/A in frequency, whose powers scatter as those of random fields: by all of their mean, and f and −f
together, because heights are real; where the phase varies much they are independent, and u is up to √2 too large. Light that one mode has too much,
the others and the coherent light lack. So
var G = 2/A ∬ (100 w − G)² U² d²f, w the share of the light at f that enters the receptor: of even light within it, that of (∬ U)²/∬ U² · A/2
independent speckles.

References
----------
Goodman, Speckle Phenomena in Optics, 2007, ch. 4 (integrated speckle).
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from brdfpipe.appearance.apertures import REFERENCE_INDEX, SOURCE, Rule, half_width, sample_of
from brdfpipe.appearance.gloss_meter import RECEPTOR, gloss_at
from brdfpipe.bsdf.representations.kirchhoff import Diffraction, Kirchhoff
from brdfpipe.geometry import Array
from brdfpipe.optics.fresnel_equations import fresnel

RING_ERROR = 0.004
"""Relative error of light that is not coherent, by the rings of its spectrum."""

_APERTURES = Rule((2, 3), 4)  # of changes of gloss
_TURNS = (np.arange(32) + 0.5) * np.pi / 64
"""Azimuths of a quarter turn, whose mean is that of all."""


def diffracted_gloss_u(reference: xr.Dataset, angle: float, value: float) -> float:
    """Standard uncertainty of the gloss of diffraction on a map, as the gloss of the surface [gloss units].

    Parameters
    ----------
    reference : kind ``bsdf``, representation ``kirchhoff``, a mean over wavelength
    angle : of a gloss meter [degree]
    value : gloss of the reference there

    Notes
    -----
    The uncertainty is the larger of the scatter by speckle and of that between blocks of the map. Blocks of few waves agree by chance; sparse scratches
    scatter more than random heights do.
    """
    one = Kirchhoff(reference)
    sample = sample_of(reference, None)
    units = [gloss_at(sample, angle, np.zeros(1), _APERTURES, reflector)[0] for reflector in (one, *one.changed)]
    between_blocks = np.sqrt(np.square(np.array(units[1:]) - units[0]).sum())
    coherent = float(one.specular(np.array([angle]), np.zeros(1), None)[0].mean())
    glass = float(fresnel(np.cos(np.radians(angle)), REFERENCE_INDEX).mean)
    scatter = max(gloss_scatter(reference, angle), between_blocks)
    return float(np.hypot(scatter, RING_ERROR * (value - 100 * coherent / glass)))


def gloss_scatter(reference: xr.Dataset, angle: float) -> float:
    """Standard deviation of gloss [gloss units] between maps of one surface of random heights, by speckle.

    Parameters
    ----------
    reference, angle : as for :func:`diffracted_gloss_u`

    Notes
    -----
    Heights without a lay: with one, the light is in fewer modes, and scatters more. Over visible light the modes of a receptor are nearly the
    same ones, so that a mean over wavelength scatters as its mean wavelength does.
    """
    wavelength, n, k = (
        float(reference[name].values @ reference["mixture"].values) for name in ("mixed_wavelength", "n", "k")
    )
    diffraction, cosine = Diffraction.of(reference), float(np.cos(np.radians(angle)))
    frequency, spectrum = diffraction.at_phase(4e3 * np.pi * cosine / wavelength)
    light = spectrum * 2 * np.pi * frequency * np.gradient(frequency)
    coherent = float(diffraction.coherent_share(np.array([[cosine]]), np.array([wavelength]))[0, 0])
    received = _received(frequency * wavelength * 1e-3, angle)
    share = (coherent + light @ received.mean(axis=1)) / (coherent + light.sum())
    variance = 2 / float(reference["measured_area"]) * (light * spectrum) @ np.square(received - share).mean(axis=1)
    mirror = fresnel(cosine, n, k).mean / fresnel(cosine, REFERENCE_INDEX).mean
    return 100 * float(mirror * np.sqrt(variance))


def _received(offset: Array, angle: float) -> Array:
    """Share of the source image that is seen within the receptor, of light offset from the mirror direction by direction cosines, (offset, azimuth)."""
    along, across = offset[:, None] * np.cos(_TURNS) / np.cos(np.radians(angle)), offset[:, None] * np.sin(_TURNS)
    share = np.ones(along.shape)
    for place, receptor, source in zip((along, across), RECEPTOR[angle], SOURCE, strict=True):
        window, image = half_width(receptor), half_width(source)
        share *= np.clip(np.minimum(place + image, window) - np.maximum(place - image, -window), 0, None) / (2 * image)
    return share
