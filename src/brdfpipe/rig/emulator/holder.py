"""What lies in the holder, and how bright it is in every direction: the sample, the etalon, the angular target, or nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy.special import ndtr

from brdfpipe import specular_directions, vocabulary
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array, unit_vector
from brdfpipe.rig.description import Rig, Target
from brdfpipe.rig.emulator.effects import Effects, stream
from brdfpipe.rig.emulator.source import Source
from brdfpipe.rig.emulator.view import hidden

LOADS = ("sample", "etalon", "target", "dark-trap")
SIDES = ("reflection", "transmission")

_AT_ONCE = 20_000
"""Directions of one evaluation: what bounds the memory."""


class EmulationError(BrdfpipeError):
    """Something that the emulated rig cannot show."""


@dataclass(frozen=True)
class Etalon:
    """The reflectance standard as its certificate has it: BRDF ρ/π (1 − b (ϑ/60°)²), at normal incidence, at all wavelengths."""

    reflectance: float = 0.9
    falloff: float = 0.05

    def brdf(self, theta: Array) -> Array:
        """BRDF [1/sr] at angles from its normal [degree]."""
        return np.asarray(self.reflectance / np.pi * (1 - self.falloff * (theta / 60) ** 2))


TARGET_EDGE = 0.06
"""Standard deviation over which the edge of a spot of the angular target fades [degree]."""


@dataclass(frozen=True)
class Setup:
    """What an operator has arranged: entrance [degree], what lies in the holder, and on which side of it the hemisphere stands."""

    entrance: float
    load: str = "sample"
    side: str = "reflection"


class Holder:
    """The holder of a rig.

    Parameters
    ----------
    rig : description
    truth : kind ``bsdf``, the sample; it lies with its azimuth 0 towards the entrance
    source : the light that comes
    effects, seed, session : see :mod:`brdfpipe.rig.emulator.effects`
    etalon : as certified

    Raises
    ------
    VocabularyError : the truth is no bsdf.

    Notes
    -----
    All light of an entrance falls on what lies in the holder, and from one direction. A band of wavelengths is summed over lamp, splitter
    and truth by the source's three points. Beyond its own wavelengths the truth goes on as it is at the last of them.
    """

    def __init__(
        self, rig: Rig, truth: xr.Dataset, source: Source, effects: Effects, *, seed: int, session: int, etalon: Etalon
    ) -> None:
        self._rig, self._truth, self._source = rig, vocabulary.validate(truth, "bsdf"), source
        self._bsdf = truth.bsdf
        self._effects, self._etalon = effects, etalon
        self._certified = 1 + effects.certificate * float(stream(seed, "certificate", session).standard_normal())

    def brightness(self, setup: Setup, theta_s: Array, phi_s: Array, wavelengths: Array) -> Array:
        """BRDF × cosine of view [1/sr] times the lamp's light behind the splitter, (directions, wavelengths).

        Parameters
        ----------
        setup : what is arranged
        theta_s, phi_s : (directions,), about the mirror direction, or about the light that passes straight [degree]
        wavelengths : of the monochromator [nm]

        Raises
        ------
        EmulationError : the rig cannot be arranged so, or the truth mirrors light as no rough surface does.
        """
        through = check(setup, self._rig).side == "transmission"
        nodes, light = self._source.band(wavelengths)
        light = light * (1 - self._source.split(nodes))
        total = light.sum(axis=-1)
        bright = np.full((theta_s.size, wavelengths.size), self._effects.stray) * total
        if setup.load == "etalon":
            bright += self._etalon_seen(setup.entrance, theta_s, phi_s)[:, None] * total
        elif setup.load == "target":
            assert self._rig.target is not None
            bright += target_seen(self._rig.target, theta_s, phi_s)[:, None] * total
        elif setup.load == "sample":
            self._refuse_mirrors(setup)
            cosine = specular_directions.cos_view(setup.entrance, theta_s, phi_s)
            for part in np.array_split(np.flatnonzero(cosine > 0), 1 + theta_s.size // _AT_ONCE):
                brdf = self._brdf(setup, theta_s[part], phi_s[part], nodes)
                bright[part] += cosine[part, None] * np.einsum("dwn,wn->dw", brdf, light)
        bright[hidden(self._rig, self._effects, setup.entrance, theta_s, phi_s, through=through)] = 0.0
        return bright

    def _etalon_seen(self, entrance: float, theta_s: Array, phi_s: Array) -> Array:
        cosine = np.maximum(specular_directions.cos_view_etalon(entrance, theta_s, phi_s), 0.0)
        theta = np.degrees(np.arccos(np.minimum(cosine, 1.0)))
        return self._certified * cosine * self._etalon.brdf(theta)

    def _brdf(self, setup: Setup, theta_s: Array, phi_s: Array, nodes: Array) -> Array:
        """BRDF or BTDF of the truth [1/sr]: (directions, wavelengths, nodes of the band), or broadcastable; 0 where a fit is below."""
        theta_o, phi_o = specular_directions.outgoing(setup.entrance, theta_s, phi_s, side=setup.side)
        evaluate = self._bsdf.evaluate
        if "wavelength" not in self._truth.coords:
            return np.maximum(evaluate(setup.entrance, 0.0, theta_o, phi_o).values, 0.0)[:, None, None]
        own = self._truth["wavelength"].values
        asked, where = np.unique(np.clip(nodes, own[0], own[-1]), return_inverse=True)
        found = np.maximum(evaluate(setup.entrance, 0.0, theta_o, phi_o, asked).values, 0.0)
        return np.asarray(found[:, where.reshape(nodes.shape)])

    def _refuse_mirrors(self, setup: Setup) -> None:
        reflected, passed = self._bsdf.specular(setup.entrance)
        if float((passed if setup.side == "transmission" else reflected).max()) > 0:
            raise EmulationError(
                "the truth has a perfectly smooth surface, whose mirror image is as bright as the source is small; "
                "give the surface a roughness"
            )


def target_seen(target: Target, theta_s: Array, phi_s: Array) -> Array:
    """How bright an angular target is in directions [degree], as BRDF × cosine of view [1/sr]: 1 in the middle of a spot."""
    cosine = unit_vector(theta_s, phi_s) @ unit_vector(target.theta_s, target.phi_s).T
    inwards = target.radius - np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return np.asarray(ndtr(inwards / TARGET_EDGE).sum(axis=1))


def check(setup: Setup, rig: Rig) -> Setup:
    """A setup, if a rig can be arranged so.

    Raises
    ------
    EmulationError : naming what cannot be, and what could.
    """
    entrances = ", ".join(f"{each:g}" for each in rig.entrances)
    if setup.load not in LOADS:
        raise EmulationError(f"nothing is called {setup.load!r} in the holder; accepted: {', '.join(LOADS)}")
    if setup.load == "target" and rig.target is None:
        raise EmulationError("the rig has no angular target; describe one under `target` in rig.yaml")
    if setup.side not in SIDES:
        raise EmulationError(f"the sample has no side {setup.side!r}; accepted: {', '.join(SIDES)}")
    if setup.side == "transmission":
        if setup.load in ("etalon", "target"):
            raise EmulationError(f"the {setup.load} lets no light pass; look at it in reflection")
        if not 0 <= setup.entrance < 90:
            raise EmulationError(
                f"no light passes at an incidence of {setup.entrance:g}; accepted: 0 to below 90 degree"
            )
    elif setup.entrance not in rig.entrances:
        raise EmulationError(f"the rig has no entrance at {setup.entrance:g} degree; accepted: {entrances}")
    return setup
