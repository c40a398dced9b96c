"""Imperfections of a real rig; each is a number, and 0 switches it off.

Each effect has its own random numbers, so that switching one off changes no other. Properties of the rig (fibres, sensor) depend on the seed
alone. Properties of a session (position of the camera, drift of the lamp) also depend on the session, the noise of a frame also on the frame.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from brdfpipe.errors import BrdfpipeError


class EmulationError(BrdfpipeError):
    """An effect, fault, arrangement or sample that the emulated rig does not support."""


@dataclass(frozen=True)
class Effects:
    """Size of each effect; ``Effects()`` is a realistic rig, :meth:`none` an ideal one.

    Raises EmulationError: a number is negative or not finite, or a share exceeds 1. The design of the rig is that of Voloboy et al., Keldysh
    Institute preprint (2005). Sizes it does not state are typical of a good laboratory.
    """

    xenon: bool = True
    """Spectrum of a xenon arc instead of a flat one."""
    slit: bool = True
    """Triangular band whose full width at half maximum is the ``slit`` of the description, instead of a single wavelength."""
    warm_up: float = 0.05
    """Share of the light that is missing when the lamp is switched on."""
    drift: float = 0.01
    """Drift of the lamp: relative standard deviation over hours."""
    wavelength_offset: float = 0.0
    """Wavelength of the band less that which the monochromator reports [nm], of either sign."""
    splitter_slope: float = 0.02
    """Relative change of the splitter's share for the reference, per 100 nm."""
    paths: float = 0.05
    """Relative standard deviation, between entrances, of the light that reaches the sample."""
    path_slope: float = 0.01
    """Standard deviation, between entrances, of the relative change of that light per 100 nm."""
    filters: float = 1.0
    """Largest error of a filter's transmittance over the wavelengths, in stated standard uncertainties."""

    fibres: float = 0.15
    """Largest relative deviation of a fibre's efficiency from the mean."""
    dead_fibres: float = 0.02
    """Share of fibres that transmit nothing."""
    fibre_field: float = 0.3
    """Half angle of the field of view of a fibre [degree]: an end of 1 mm radius at 200 mm."""
    fibre_directions: float = 0.0
    """Distance of the direction of each fibre from the description, in a random azimuth [degree]."""
    mirror_angles: float = 0.02
    """Root mean square angle between the normal of a mirror and that to which it was turned [degree]."""
    holes: float = 3.0
    """Angular radius of the entrances, as seen from the sample, which return no light [degree]."""
    stray: float = 2e-5
    """Stray light of walls and mirrors in every direction, as an equivalent BRDF × cosine [1/sr]."""

    vignetting: float = 0.3
    """Share of light lost in the corners of the image, and again at the edge of the disc; it grows with the square of the distance."""
    disc_offset: float = 0.1
    """Distance of the disc's centre from the description [degree]."""
    radial_error: float = 5e-7
    """Magnitude of the difference of the radial distortion from the description [1/mm²]."""
    registration: float = 0.3
    """Standard deviation, between sessions, of the shift of the image on the sensor, along rows and columns [pixel]."""
    core: float = 0.7
    """Standard deviation of the core of the point spread function [pixel]."""
    halo: float = 0.005
    """Share of the light in the halo of the point spread function: veiling glare."""
    halo_radius: float = 40.0
    """Scale R of the halo, (1 + r²/R²)^(−3/2) [pixel]; 30 % of its light is within R."""

    photon_noise: bool = True
    """Poisson statistics of the electrons."""
    read_noise: float = 20.0
    """Standard deviation [e⁻]."""
    dark: float = 2.0
    """Dark current at 20 °C [e⁻/s]; it doubles every 7 °C."""
    warming: float = 2.0
    """Rise of the sensor's temperature above 20 °C within hours [°C]."""
    hot_pixels: float = 0.003
    """Share of pixels with a hundred times the dark current or more."""
    response: float = 0.01
    """Relative standard deviation of the pixels' response to light."""
    bias: float = 100.0
    """Counts without electrons."""
    cosmic: float = 0.0
    """Mean number of cosmic hits in a frame; each leaves some thousand electrons in up to three pixels."""
    compression: float = 75e3
    """Scale c [e⁻] of the compression e' = l + c ln(1 + (e − l)/c) beyond the linear range l; 0 is linear throughout."""

    certificate: float = 0.005
    """Relative standard deviation, between sessions, of the etalon's BRDF from the certificate."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value, largest = getattr(self, field.name), 1.0 if field.name in _SHARES else np.inf
            if not (field.name in _SIGNED or value >= 0) or not value <= largest or not np.isfinite(value):
                accepted = "0 to 1" if field.name in _SHARES else "0 or more"
                raise EmulationError(f"effect `{field.name}` out of range: {value}; accepted: {accepted}")
        if self.halo and not self.halo_radius:
            raise EmulationError("effect `halo_radius` out of range: 0; accepted: above 0 if `halo` is above 0")

    @classmethod
    def none(cls) -> Effects:
        """The ideal rig: only the geometry, the splitter's 8 %, and the rounding and range of counts remain."""
        zeros: dict[str, Any] = {field.name: False if field.default is True else 0.0 for field in fields(cls)}
        return cls(**zeros)


_SIGNED = ("wavelength_offset",)

_SHARES = ("warm_up", "fibres", "dead_fibres", "vignetting", "halo", "hot_pixels")


def random_stream(seed: int, purpose: str, *key: int) -> np.random.Generator:
    """Random numbers that depend only on the seed, their purpose, and a key such as session and frame."""
    return np.random.default_rng([seed, int.from_bytes(purpose.encode(), "big"), *key])
