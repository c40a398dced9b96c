"""What a real rig does to its light, effect by effect: each a number that switches it off at 0.

What is random is drawn from streams of their own, so that switching one effect off changes no other. Three things decide a stream:
what is peculiar to a rig (its fibres, its sensor) stays for all that is measured with it, what to a session (how the camera sits that
day, how the lamp wanders) for the session, and the noise of a frame for that frame alone.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from brdfpipe.errors import BrdfpipeError


class EffectError(BrdfpipeError):
    """An effect that cannot be."""


@dataclass(frozen=True)
class Effects:
    """How far a rig is from an ideal one; ``Effects()`` is a rig as they are, :meth:`none` the ideal one.

    Raises
    ------
    EffectError : a number is negative or undefined, or a share above 1.

    References
    ----------
    RIG, emulator: fibre efficiencies, core and halo of the point spread, read noise, hot pixels, photo response. What it does not put
    into figures is chosen here as what a good laboratory would meet.
    """

    xenon: bool = True
    """The lamp has the spectrum of a xenon arc, and not a flat one."""
    slit: bool = True
    """A band of wavelengths passes, triangular, its full width at half maximum the ``slit`` of the description."""
    warm_up: float = 0.05
    """Light missing when the lamp is lit, as a share of what comes later."""
    drift: float = 0.01
    """Wandering of the lamp: relative standard deviation over hours."""
    splitter_slope: float = 0.02
    """Relative change of what the splitter sends to the reference, per 100 nm."""
    paths: float = 0.05
    """Relative standard deviation, between entrances, of the light that reaches the holder."""
    path_slope: float = 0.01
    """Standard deviation, between entrances, of the relative change of that light per 100 nm."""
    filters: float = 1.0
    """Largest error of a filter's transmittance over the wavelengths, in the standard uncertainties its description states."""

    fibres: float = 0.15
    """Largest relative deviation of a fibre's efficiency from the mean."""
    dead_fibres: float = 0.02
    """Share of fibres that let nothing pass."""
    fibre_field: float = 0.3
    """Half angle of what a fibre sees [degree]: an end of 1 mm radius at 200 mm."""
    holes: float = 3.0
    """Radius, as seen from the sample, of the entrances, out of which no light comes back [degree]."""
    stray: float = 2e-5
    """What walls and mirrors send everywhere, beside what lies in the holder: BRDF × cosine that would be as bright [1/sr]."""

    vignetting: float = 0.3
    """Light lost in the corners of the picture, and again at the rim of the disc; it grows as the square of the distance."""
    disc_offset: float = 0.1
    """The disc's centre is so far from where the description has it [degree]."""
    radial_error: float = 5e-7
    """The radial distortion differs from the description's by so much, to either side [1/mm²]."""
    registration: float = 0.3
    """Standard deviation, between sessions, of where the picture lies on the sensor, along rows and along columns [pixel]."""
    core: float = 0.7
    """Standard deviation of the core of the point spread [pixel]."""
    halo: float = 0.005
    """Share of the light that goes into the halo: veiling glare."""
    halo_radius: float = 40.0
    """Scale R of the halo, (1 + r²/R²)^(−3/2) [pixel]; 30 % of its light falls within R."""

    photon_noise: bool = True
    """Electrons come by chance (Poisson)."""
    read_noise: float = 20.0
    """Standard deviation [e⁻]."""
    dark: float = 2.0
    """Dark current at 20 °C [e⁻/s]; it doubles every 7 °C."""
    warming: float = 2.0
    """Rise of the sensor's temperature above 20 °C within hours [°C]."""
    hot_pixels: float = 0.003
    """Share of pixels of a hundred and more times the dark current."""
    response: float = 0.01
    """Relative standard deviation of the pixels' response to light."""
    bias: float = 100.0
    """Counts of a frame without any electron."""
    compression: float = 75e3
    """Electrons c of e' = l + c ln(1 + (e − l)/c), the charge read of e beyond the linear range l; 0 is linear throughout."""

    certificate: float = 0.005
    """Relative standard deviation, between sessions, of the etalon's BRDF from its certificate."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value, most = getattr(self, field.name), 1.0 if field.name in _SHARES else np.inf
            if not 0 <= value <= most or not np.isfinite(value):
                accepted = "0 to 1" if field.name in _SHARES else "a number from 0 up"
                raise EffectError(f"the effect `{field.name}` is {value}; accepted: {accepted}")
        if self.halo and not self.halo_radius:
            raise EffectError("the effect `halo_radius` is 0; accepted: a number above 0 where there is a halo")

    @classmethod
    def none(cls) -> Effects:
        """The ideal rig: what remains is geometry, the splitter's 8 %, and counts being whole numbers that end somewhere."""
        nothing: dict[str, Any] = {field.name: False if field.default is True else 0.0 for field in fields(cls)}
        return cls(**nothing)


_SHARES = ("warm_up", "fibres", "dead_fibres", "vignetting", "halo", "hot_pixels")


def stream(seed: int, what: str, *which: int) -> np.random.Generator:
    """Random numbers that depend on the seed, on what they are for, and on which session or frame, and on nothing else."""
    return np.random.default_rng([seed, int.from_bytes(what.encode(), "big"), *which])
