"""Small datasets that many tests start from; nothing here is measured."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache, partial

import numpy as np
import pytest
import xarray as xr

from brdfpipe import facets, optics, vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.microfacet import energy
from brdfpipe.bsdf.microfacet.second_reflection import SecondReflection
from brdfpipe.facets.slope_histogram import Histogram, histogram
from brdfpipe.facets.slopes import FINE_BINS

WAVELENGTH = np.arange(360.0, 781.0, 5.0)


def spectrum(reflectance=0.3, *, geometry: str = "sci", theta: float = 8.0) -> xr.Dataset:
    """A total reflectance on the 5-nm grid: a number, or values on it."""
    values = np.broadcast_to(np.asarray(reflectance, dtype=float), WAVELENGTH.shape).copy()
    return vocabulary.label(
        xr.Dataset(
            {"total_reflectance": ("wavelength", values)},
            coords={"wavelength": WAVELENGTH},
            attrs={"geometry": geometry, "theta_i": theta, "method": "synthetic", "residual_delta_e": 0.0},
        ),
        "spectrum",
    )


beckmann = cache(partial(facets.analytic, "beckmann"))
"""Gaussian facets of a width a, built once: tests do not change them."""


def beckmann_bsdf(sigma: float = 0.1, *, n: float = 1.55, reflectance=0.3, **options) -> xr.Dataset:
    """The microfacet BSDF of a Gaussian surface of slope rms ``sigma`` per axis; ``reflectance=None`` for its gloss alone.

    Light that facets reflect more than once is lost unless ``multiple_scattering`` says otherwise: single reflection has closed forms.
    """
    options = {"multiple_scattering": "none"} | options
    values = None if reflectance is None else tuple(np.atleast_1d(reflectance).astype(float).tolist())
    return _beckmann_bsdf(sigma, n, values, tuple(sorted(options.items()))).copy(deep=True)


@cache
def _beckmann_bsdf(sigma: float, n: float, reflectance: tuple[float, ...] | None, options: tuple) -> xr.Dataset:
    return microfacet.build(
        beckmann(sigma * np.sqrt(2)),
        index=optics.refractive_index(n),
        spectrum=None if reflectance is None else spectrum(reflectance),
        **dict(options),
    )


def glossy_bsdf(a: float, n: float) -> xr.Dataset:
    """Beckmann facets without diffuse light; the table of the albedo is coarse, for what depends on the lobe alone."""
    return _glossy_bsdf(a, n).copy(deep=True)


@cache
def _glossy_bsdf(a: float, n: float) -> xr.Dataset:
    with coarse_albedo_tables():
        return microfacet.build(facets.analytic("beckmann", a), index=n, multiple_scattering="none")


def visibility_table(ratio) -> xr.Dataset:
    """A ``visibility`` dataset of a ratio to Smith's over (grazing, steepness, asymmetry); a number is the same everywhere."""
    ratio = np.broadcast_to(ratio, (5, 6, 4)) if np.ndim(ratio) == 0 else np.asarray(ratio)
    dims = ("grazing", "steepness", "asymmetry")
    axes = (np.linspace(0, last, size) for last, size in zip((0.96, 2.5, 1.0), ratio.shape, strict=True))
    dataset = xr.Dataset({"visibility_ratio": (dims, ratio)}, coords=dict(zip(dims, axes, strict=True)))
    return vocabulary.label(dataset, "visibility")


def random_second_reflection(planes: int = 1, turns: int = 0, wavelengths: int = 1) -> SecondReflection:
    """Light reflected more than once whose table varies at random, with planes or factors at azimuths of a surface with a lay."""
    random = np.random.default_rng(6)
    log_factor = random.normal(size=(8, 8, 5, planes * wavelengths)) - 2
    weight = np.exp(0.3 * random.normal(size=(8, turns)))
    return SecondReflection(0.3, (log_factor + log_factor.swapaxes(0, 1)) / 2, weight, planes)


def masking_choice(masking: str = "measured", error: float = -0.3) -> xr.Dataset:
    """A ``visibility`` dataset of what the heights of a surface say about Smith's masking, without the table."""
    theta, shape = np.array([30.0, 60.0, 75.0]), ("theta_i", "region")
    smith = np.stack([np.array([1.0, 0.9, 0.6])] * 2, axis=1)
    fields = {"visible_share": smith / (1 + error), "smith_visible_share": smith, "smith_error": np.full((3, 2), error)}
    fields |= {f"{name}_u": np.full((3, 2), 0.01) for name in ("visible_share", "smith_error")}
    dataset = xr.Dataset(
        {name: (shape, np.minimum(values, 1.0)) for name, values in fields.items()},
        {"theta_i": theta, "region": ["peak", "all"]},
        {"masking": masking, "reason": f"Smith's masking would give {error:+.0%}", "method": "traced on the map"},
    )
    return vocabulary.label(dataset, "visibility")


def brushed_bsdf(a_x: float, a_y: float, azimuth: float = 0.0) -> xr.Dataset:
    """The microfacet BSDF of a Gaussian surface of index 1.5 with a lay: widths along and across it, its azimuth; its albedo is coarse.

    Its facets reflect once alone.
    """
    return _brushed_bsdf(a_x, a_y, azimuth).copy(deep=True)


@cache
def _brushed_bsdf(a_x: float, a_y: float, azimuth: float) -> xr.Dataset:
    with coarse_albedo_tables():
        surface = facets.analytic("beckmann", a_x=a_x, a_y=a_y, azimuth=azimuth)
        return microfacet.build(surface, index=1.5, multiple_scattering="none")


@contextmanager
def coarse_albedo_tables() -> Iterator[None]:
    """Makes ``microfacet.build`` cheap, for properties that do not depend on the accuracy of the table of the albedo."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(energy, "_INTERPOLATION_ERROR", 1e-4)
        patch.setattr(energy, "_LAY_STEP", 0.8)
        yield


def histogram_of_slopes(blocks: Iterable[np.ndarray], scale: float) -> Histogram:
    """Histogram of slopes that are given block by block, as those of a map are counted."""
    uppers = ((slopes.astype(np.float32) ** 2).view(np.uint32) >> 16 for slopes in blocks)
    return histogram(np.stack([np.bincount(upper, minlength=FINE_BINS) for upper in uppers]), scale)


def gaussian_surface(size: int = 512, *, sigma: float = 0.15, correlation: float = 8.0, seed: int = 1) -> xr.Dataset:
    """A periodic Gaussian height map of slope rms ``sigma`` per axis and Gaussian correlation (pixels), 1 µm pitch."""
    rng = np.random.default_rng(seed)
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size)))
    shape = np.exp(-((np.pi * frequency * correlation) ** 2) / 2)
    height = np.fft.ifft2(np.fft.fft2(rng.normal(size=(size, size))) * shape).real
    slopes = np.diff(height, axis=1)
    return surface(height * sigma / slopes.std())


def surface(height, pitch: tuple[float, float] = (1.0, 1.0)) -> xr.Dataset:
    """A surface dataset of a map (y, x) or a line (x) in µm."""
    height = np.asarray(height, dtype=float)
    dims = ("y", "x")[2 - height.ndim :]
    coords = {dim: np.arange(n) * step for dim, n, step in zip(dims[::-1], height.shape[::-1], pitch, strict=False)}
    attrs = {"pitch_x": pitch[0], "levelling": "none", "band": "synthetic"}
    if height.ndim == 2:
        attrs["pitch_y"] = pitch[1]
    return vocabulary.label(xr.Dataset({"height": (dims, height)}, coords=coords, attrs=attrs), "surface")
