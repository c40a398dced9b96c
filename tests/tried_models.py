"""Errors of two candidates on materials that differ by their slopes alone."""

from brdfpipe.scenes.experience import Experience, Known, Trial
from brdfpipe.scenes.features import FEATURES
from brdfpipe.scenes.ladders import FULLEST, Candidate

FACETS = Candidate(optics="facets")
ORIGIN = dict.fromkeys(FEATURES, 0.0)


def known(*slopes: float) -> Experience:
    unit = FEATURES["log_slope"]
    return Experience(
        "gloss",
        "digest",
        tuple(
            Known(f"m{k}", ORIGIN | {"log_slope": slope * unit}, {FACETS: Trial(slope, 0.5), FULLEST: Trial(0.0, 3.0)})
            for k, slope in enumerate(slopes)
        ),
    )
