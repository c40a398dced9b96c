"""Sample holder: brightness of the sample, the etalon or the angular target in every direction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import xarray as xr
from scipy.special import ndtr

from brdfpipe import specular_directions
from brdfpipe.geometry import Array, unit_vector
from brdfpipe.rig.description import Rig, Target
from brdfpipe.rig.emulator import mirror
from brdfpipe.rig.emulator.camera_view import in_entrance_hole
from brdfpipe.rig.emulator.effects import Effects, EmulationError, random_stream
from brdfpipe.rig.emulator.illumination import Illumination
from brdfpipe.rig.turned_mirror import Aim

LOADS = ("sample", "etalon", "target", "mirror", "dark-trap", "line-lamp")
SIDES = ("reflection", "transmission")

_CHUNK = 20_000
"""Directions per evaluation, to limit memory."""


@dataclass(frozen=True)
class Etalon:
    """Reflectance standard as certified: BRDF ρ/π (1 − b (ϑ/60°)²) at normal incidence and all wavelengths."""

    reflectance: float = 0.9
    falloff: float = 0.05

    def brdf(self, theta: Array) -> Array:
        """BRDF [1/sr] at angles from the normal [degree]."""
        return np.asarray(self.reflectance / np.pi * (1 - self.falloff * (theta / 60) ** 2))


TARGET_EDGE = 0.06
"""Standard deviation of the blurred edge of a spot of the angular target [degree]."""


@dataclass(frozen=True)
class Setup:
    """Manual arrangement: entrance [degree], object in the holder, and side on which the hemisphere is."""

    entrance: float
    load: str = "sample"
    side: str = "reflection"
    aim: Aim | None = None


class Truth(Protocol):
    """The BSDF of a sample, ready for evaluation, as :func:`brdfpipe.bsdf.registry.representation` makes it of a dataset.

    The rig cannot import this function, because it is below the BSDF.
    """

    dataset: xr.Dataset
    """Kind ``bsdf``."""

    def evaluate(self, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array, wavelength: Array | None) -> Array:
        """BRDF or BTDF [1/sr], (directions, wavelengths or 1)."""

    def specular(self, theta_i: Array, phi_i: Array, wavelength: Array | None) -> tuple[Array, Array]:
        """Mirror reflectance and regular transmittance [1], (incidences, wavelengths or 1) each."""


class SampleHolder:
    """The sample holder of a rig.

    All light of an entrance falls onto the object in the holder, from one direction. Lamp, splitter and truth are integrated over the band with
    the three nodes of the illumination. Outside its wavelengths the truth is extrapolated as constant.

    Parameters
    ----------
    rig : the description
    truth : the sample; its azimuth 0 points to the entrance. None: a sample that reflects nothing
    illumination : of the sample
    effects, seed, session : see :mod:`brdfpipe.rig.emulator.effects`
    etalon : as certified
    """

    def __init__(
        self,
        rig: Rig,
        truth: Truth | None,
        illumination: Illumination,
        effects: Effects,
        *,
        seed: int,
        session: int,
        etalon: Etalon,
    ) -> None:
        self._rig, self._truth, self._illumination = rig, truth, illumination
        self._effects, self._etalon, self._seed, self._session = effects, etalon, seed, session
        deviate = float(random_stream(seed, "certificate", session).standard_normal())
        self._etalon_factor = 1 + effects.certificate * deviate

    def brightness(self, setup: Setup, theta_s: Array, phi_s: Array, wavelengths: Array) -> Array:
        """BRDF × cosine of view [1/sr] times the light behind the splitter, (directions, wavelengths).

        Raises EmulationError for an impossible arrangement, or a truth with a smooth, specular surface.

        Parameters
        ----------
        theta_s, phi_s : (directions,), about the mirror direction, or about the straight transmission [degree]
        wavelengths : of the monochromator [nm]
        """
        transmission = check_setup(setup, self._rig).side == "transmission"
        nodes, light = self._illumination.band(wavelengths)
        light = light * (1 - self._illumination.split_ratio(nodes))
        total = light.sum(axis=-1)
        brightness = np.full((theta_s.size, wavelengths.size), self._effects.stray) * total
        if setup.load == "etalon":
            brightness += self._etalon_brightness(setup.entrance, theta_s, phi_s)[:, None] * total
        elif setup.load == "target":
            assert self._rig.target is not None
            brightness += target_brightness(self._rig.target, theta_s, phi_s)[:, None] * total
        elif setup.load == "mirror" and setup.aim is not None:
            normal = mirror.true_normal(setup.entrance, setup.aim, self._effects, self._seed, self._session)
            brightness += mirror.brightness(setup.entrance, normal, theta_s, phi_s)[:, None] * total
        elif setup.load == "sample" and self._truth is not None:
            _refuse_specular(self._truth, setup)
            cosine = specular_directions.cos_view(setup.entrance, theta_s, phi_s)
            for chunk in np.array_split(np.flatnonzero(cosine > 0), 1 + theta_s.size // _CHUNK):
                brdf = _brdf(self._truth, setup, theta_s[chunk], phi_s[chunk], nodes)
                brightness[chunk] += cosine[chunk, None] * np.einsum("dwn,wn->dw", brdf, light)
        hole = in_entrance_hole(self._rig, self._effects, setup.entrance, theta_s, phi_s, transmission=transmission)
        brightness[hole] = 0.0
        return brightness

    def _etalon_brightness(self, entrance: float, theta_s: Array, phi_s: Array) -> Array:
        cosine = np.maximum(specular_directions.cos_view_etalon(entrance, theta_s, phi_s), 0.0)
        theta = np.degrees(np.arccos(np.minimum(cosine, 1.0)))
        return self._etalon_factor * cosine * self._etalon.brdf(theta)


def _brdf(truth: Truth, setup: Setup, theta_s: Array, phi_s: Array, nodes: Array) -> Array:
    """BRDF or BTDF of the truth [1/sr], (directions, wavelengths, nodes of the band) or broadcastable; negative values of fits become 0."""
    theta_o, phi_o = specular_directions.outgoing(setup.entrance, theta_s, phi_s, side=setup.side)
    directions = np.full_like(theta_o, setup.entrance), np.zeros_like(theta_o), theta_o, phi_o
    if "wavelength" not in truth.dataset.coords:
        return np.maximum(truth.evaluate(*directions, None), 0.0)[:, :1, None]
    available = truth.dataset["wavelength"].values
    distinct, inverse = np.unique(np.clip(nodes, available[0], available[-1]), return_inverse=True)
    brdf = np.maximum(truth.evaluate(*directions, distinct), 0.0)
    brdf = np.broadcast_to(brdf, (theta_o.size, distinct.size))
    return np.asarray(brdf[:, inverse.reshape(nodes.shape)])


def _refuse_specular(truth: Truth, setup: Setup) -> None:
    reflected, transmitted = truth.specular(np.array([setup.entrance]), np.zeros(1), None)
    if float((transmitted if setup.side == "transmission" else reflected).max()) > 0:
        raise EmulationError(
            "the truth has a perfectly smooth surface, which the emulator does not support: the brightness of its mirror "
            "image depends on the size of the source; use a rough surface"
        )


def target_brightness(target: Target, theta_s: Array, phi_s: Array) -> Array:
    """BRDF × cosine of view [1/sr] of an angular target in directions [degree]: 1 in the middle of a spot."""
    cosine = unit_vector(theta_s, phi_s) @ unit_vector(target.theta_s, target.phi_s).T
    depth = target.radius - np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return np.asarray(ndtr(depth / TARGET_EDGE).sum(axis=1))


def check_setup(setup: Setup, rig: Rig) -> Setup:
    """The setup, if it is possible with a rig; else raises EmulationError with the accepted values."""
    if setup.load not in LOADS:
        raise EmulationError(f"unknown object {setup.load!r} in the holder; accepted: {', '.join(LOADS)}")
    if setup.load == "target" and rig.target is None:
        raise EmulationError("the rig has no angular target; describe it under `target` in rig.yaml")
    if setup.load == "mirror" and setup.aim is None:
        raise EmulationError(
            "the direction to which the mirror sends the light is missing; accepted: theta_s and phi_s"
        )
    if setup.side not in SIDES:
        raise EmulationError(f"unknown side {setup.side!r}; accepted: {', '.join(SIDES)}")
    if setup.side == "transmission":
        if setup.load in ("etalon", "target", "mirror"):
            raise EmulationError(f"the {setup.load} transmits no light; accepted: reflection")
        if not 0 <= setup.entrance < 90:
            problem = f"no transmission at an incidence of {setup.entrance:g} degree"
            raise EmulationError(f"{problem}; accepted: 0 to below 90")
    elif setup.entrance not in rig.entrances:
        entrances = ", ".join(f"{entrance:g}" for entrance in rig.entrances)
        raise EmulationError(f"the rig has no entrance at {setup.entrance:g} degree; accepted: {entrances}")
    return setup
