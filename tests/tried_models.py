"""Errors of two candidates on materials that differ by their slopes alone."""

from brdfpipe.scenes.experience import Experience, Known, Trial
from brdfpipe.scenes.features import FEATURES
from brdfpipe.scenes.ladders import FULLEST, Candidate

FACETS = Candidate(optics="facets")
ORIGIN = dict.fromkeys(FEATURES, 0.0)
SLOPES = tuple(k / 4 for k in range(-6, 7))
"""Slopes of the materials, in units of their spread."""


def at(slope: float) -> dict[str, float]:
    """Features of a material of a slope, in units of its spread."""
    return ORIGIN | {"log_slope": slope * FEATURES["log_slope"]}


def error(slope: float) -> float:
    """Error of facets, which grows tenfold with each unit of the slope; 0.3 at 0."""
    return 0.3 * 10**slope


def known(*slopes: float) -> Experience:
    materials = tuple(
        Known(f"m {k}", at(slope), {FACETS: Trial(error(slope), 0.5), FULLEST: Trial(0.0, 3.0)})
        for k, slope in enumerate(slopes)
    )
    return Experience("gloss", "digest", materials).fitted()
