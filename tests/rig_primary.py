"""Synthetic primary data of a rig: cells, known lobes, and noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.specular_directions import cos_view, outgoing

Truth = Callable[[float, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""BSDF (wavelength, direction) of incidence, theta_s, phi_s and wavelength."""


def cells(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Directions of a rig's cells: rings of the disc to 10° with about square cells, and fibres beyond."""
    random = np.random.default_rng(seed)
    theta, phi = [np.zeros(1)], [np.zeros(1)]
    ring = 0.6
    while ring < 10:
        wide = 0.5 + 0.07 * ring
        count = round(2 * np.pi * ring / wide)
        theta.append(np.full(count, ring))
        phi.append((np.arange(count) + 0.5) * 360 / count)
        ring += wide
    ring = 11.5
    while ring < 140:
        wide = min(3 + 0.12 * (ring - 10), 8)
        count = max(round(np.pi * np.degrees(np.sin(np.radians(ring))) / wide), 6)
        theta.append(ring + wide * random.uniform(-0.2, 0.2, count))
        phi.append((np.arange(count) + random.random()) * 360 / count + wide * random.uniform(-0.2, 0.2, count))
        ring += wide
    return np.concatenate(theta), np.concatenate(phi)


def measured(
    truth: Truth,
    incidences: Sequence[float] = (45.0,),
    wavelengths: Sequence[float] = (550.0,),
    *,
    noise: float = 0.02,
    dark: float = 0.0,
    seed: int = 0,
    side: str = "reflection",
) -> xr.Dataset:
    """Kind ``primary``: the truth at the cells above cos γ = 0.07, with relative Gaussian noise and constant noise.

    Parameters
    ----------
    noise : relative standard deviation; 0 for values without noise, whose uncertainty is then stated as 0.1 %
    dark : standard deviation of the constant noise [sr-1]
    """
    theta, phi = cells()
    wavelength = np.asarray(wavelengths, dtype=float)
    random = np.random.default_rng(seed)
    brdf = np.stack([truth(incidence, theta, phi, wavelength) for incidence in incidences])
    u = np.hypot(noise * brdf, dark) if noise or dark else 1e-3 * brdf
    if noise or dark:
        brdf = brdf + u * random.standard_normal(brdf.shape)
    above = cos_view(np.asarray(incidences)[:, None], theta, phi) > 0.07
    quality = np.where(above, vocabulary.quality("measured"), vocabulary.quality("shadowed")).astype(np.int8)
    primary = xr.Dataset(
        {
            "brdf": (("incidence", "wavelength", "cell"), np.where(above[:, None], brdf, np.nan)),
            "brdf_u": (("incidence", "wavelength", "cell"), u),
            "brdf_quality": (("incidence", "wavelength", "cell"), np.repeat(quality[:, None], wavelength.size, axis=1)),
        },
        coords={
            "incidence": np.asarray(incidences, dtype=float),
            "wavelength": wavelength,
            "theta_s": ("cell", theta),
            "phi_s": ("cell", phi),
        },
        attrs={"side": side},
    )
    return vocabulary.label(primary, "primary")


def gaussian(theta: np.ndarray, width: float) -> np.ndarray:
    return np.exp(-(theta**2) / (2 * width**2))


def base(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """A base that varies by 30 % along the plane of incidence."""
    return 1 + 0.3 * np.sin(np.radians(theta)) * np.cos(np.radians(phi))


LOBES = {
    "peak 10 sr-1, 3 degree": lambda t, p: 0.1 * base(t, p) + 10 * gaussian(t, 3),
    "peak 300 sr-1, 1.5 degree": lambda t, p: 0.1 * base(t, p) + 300 * gaussian(t, 1.5),
    "metallic, lobe of 14 degree": lambda t, p: (0.05 + 3 * gaussian(t, 14)) * base(t, p) + 10 * gaussian(t, 3),
}
"""BSDF [sr-1] about the mirror direction, of ϑ and φ [degree]."""


def lobe(name: str) -> Truth:
    return lambda _, theta, phi, wavelength: np.broadcast_to(LOBES[name](theta, phi), (wavelength.size, theta.size))


def dense(incidence: float, lowest: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """A grid of ϑ and φ where cos γ is above ``lowest``, finer in the lobe."""
    theta = np.concatenate([np.arange(0, 12, 0.25), np.arange(12, 130, 1.0)])
    theta, phi = (angle.ravel() for angle in np.meshgrid(theta, np.arange(0, 360, 5.0), indexing="ij"))
    above = cos_view(incidence, theta, phi) > lowest
    return theta[above], phi[above]


def rms(value: np.ndarray, truth: np.ndarray) -> float:
    """Root mean square relative error."""
    return float(np.sqrt(np.mean((value / truth - 1) ** 2)))


def of_model(bsdf: xr.Dataset) -> Truth:
    """The truth of a BSDF that does not depend on wavelength."""

    def truth(incidence: float, theta: np.ndarray, phi: np.ndarray, wavelength: np.ndarray) -> np.ndarray:
        theta_o, phi_o = outgoing(incidence, theta, phi)
        brdf = bsdf.bsdf.evaluate(incidence, 0.0, np.minimum(theta_o, 89.99), phi_o).values
        return np.broadcast_to(brdf, (wavelength.size, theta.size))

    return truth
