"""Effect pigments: colours at several geometries, the flakes that mirror them below a clear coat, and fits along the flake angle."""

from __future__ import annotations

from brdfpipe.flakes.forms import FORMS, Fit, fit, leave_one_out
from brdfpipe.flakes.geometries import SETS, directions
from brdfpipe.flakes.reading import ingest
from brdfpipe.flakes.refraction import flake_angle, flake_normal, refract

__all__ = [
    "FORMS",
    "SETS",
    "Fit",
    "directions",
    "fit",
    "flake_angle",
    "flake_normal",
    "ingest",
    "leave_one_out",
    "refract",
]
