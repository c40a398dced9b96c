"""Ladders of the model: for each choice its rungs from the cheapest to the fullest, with what each leaves out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import NamedTuple


class Rung(NamedTuple):
    """One way to treat a part of the model."""

    name: str
    leaves_out: str
    """What the rung leaves out; empty for the fullest one."""


LADDERS: Mapping[str, tuple[Rung, ...]] = {
    "distribution": (
        Rung("lambert", "all gloss: the total reflectance is diffuse"),
        Rung("lambert-gauss", "the shape of the lobe and its growth between the fitted incidences"),
        Rung("beckmann", "the measured shape of the slope density, its tail above all, and a lay"),
        Rung("ggx", "the measured shape of the slope density, and a lay"),
        Rung("isotropic", "a lay"),
        Rung("counted", ""),
    ),
    "optics": (
        Rung("facets", "diffraction, and the coherent light of smooth surfaces"),
        Rung("wave", "masking, steep slopes, and slopes that are not normally distributed"),
        Rung("auto", ""),
    ),
    "masking": (
        Rung("height-correlated", "valleys and ridges that the slopes do not show"),
        Rung("auto", ""),
    ),
    "multiple_scattering": (
        Rung("none", "light that facets reflect more than once"),
        Rung("directional", "what the heights say of that light: it is computed after Smith"),
        Rung("auto", ""),
    ),
    "diffuse": (
        Rung("none", "the light from below the surface"),
        Rung("coupled", ""),
    ),
    "index": (
        Rung("constant", "dispersion"),
        Rung("dispersive", ""),
    ),
    "bands": (
        Rung("one", "colour: one wavelength, 555 nm, with the luminous reflectance"),
        Rung("three", "spectral features between 450, 550 and 650 nm"),
        Rung("every 40 nm", "spectral features narrower than 40 nm"),
        Rung("all", ""),
    ),
}
"""Rungs by ladder, the cheapest first; the last one leaves nothing out."""


@dataclass(frozen=True)
class Candidate:
    """One rung of every ladder: a way to build a BSDF."""

    distribution: str = "counted"
    optics: str = "auto"
    masking: str = "auto"
    multiple_scattering: str = "auto"
    diffuse: str = "coupled"
    index: str = "dispersive"
    bands: str = "all"

    @property
    def structure(self) -> Candidate:
        """The same with the fullest rungs of base, index and bands: what of it depends on the surface alone."""
        return replace(self, **{name: getattr(FULLEST, name) for name in SPECTRAL_LADDERS})

    @property
    def leaves_out(self) -> tuple[str, ...]:
        """What its rungs leave out; of a surface without gloss, that alone."""
        if self.distribution == "lambert":
            return (LADDERS["distribution"][0].leaves_out,)
        chosen = (next(rung for rung in LADDERS[name] if rung.name == value) for name, value in self.rungs.items())
        return tuple(rung.leaves_out for rung in chosen if rung.leaves_out)

    @property
    def rungs(self) -> dict[str, str]:
        """Rung by ladder."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def key(self) -> str:
        """Its rungs in the order of the ladders, for files."""
        return "/".join(self.rungs.values())

    def __str__(self) -> str:
        below = {name: value for name, value in self.rungs.items() if value != LADDERS[name][-1].name}
        return ", ".join(f"{name} {value}".replace("_", " ") for name, value in below.items()) or "fullest"


FULLEST = Candidate()
"""Nothing left out."""

SPECTRAL_LADDERS = ("diffuse", "index", "bands")
"""Ladders of what lies below the surface and of wavelengths; the others are of the surface."""


def structures(*, surface: bool, heights: bool, spectrum_known: bool, lay: bool, waves: bool) -> tuple[Candidate, ...]:
    """The distinct treatments of a surface, with the fullest base, index and bands.

    Parameters
    ----------
    surface : whether slopes are known
    heights : whether these come from a scan, on which light can be traced
    spectrum_known : whether there is a total reflectance, without which there is no diffuse light
    lay : whether the slopes have a lay
    waves : whether a roughness spectrum is known

    Returns
    -------
    The fullest candidate among them. A ladder that makes no difference has its fullest rung
    """
    candidates = [Candidate("lambert", "facets", "height-correlated", "none")] if spectrum_known else []
    if not surface:
        return (*candidates, FULLEST)
    simple = {"optics": "facets", "masking": "height-correlated", "multiple_scattering": "none"}
    candidates += [Candidate(name, **simple) for name in ("lambert-gauss", "beckmann", "ggx")]
    if waves:
        candidates.append(Candidate("counted", "wave", "height-correlated", "none"))
    optics = ("facets", "auto") if waves else ("auto",)
    if lay:
        candidates += [Candidate("isotropic", one, "height-correlated", "none") for one in optics]
    reflections = ("none", "directional", "auto") if heights and not lay else ("none", "auto")
    candidates += [
        Candidate("counted", one, masking, several)
        for one, masking, several in product(
            optics, ("height-correlated", "auto") if heights else ("auto",), reflections
        )
        if (masking, several) != ("auto", "directional")
    ]
    return tuple(candidates)
