"""Standard uncertainties of readings of instruments where a material does not state them.

Makers of hand-held gloss meters state that two of their instruments agree within 0.5 gloss units, or 0.5 % above 100; twice that leaves room for the
sample, which nobody reads twice at the same place. Colours: makers state that two instruments agree within 0.2 to 0.3 of ΔE*ab on tiles; textured samples
are read worse.
"""

from __future__ import annotations

GLOSS_U, GLOSS_RELATIVE_U = 1.0, 0.01
"""Of a gloss reading: gloss units, or a share of the reading where that is more."""

REFLECTANCE_HAZE_U = 1.0
"""Gloss units."""

LAB_U = 0.5
"""Of each of L*, a* and b*."""

TRANSMITTANCE_U = 0.005


def gloss_u(value: float, stated: float | None = None) -> float:
    """Standard uncertainty of a gloss reading [gloss units], as ``stated`` or by default."""
    return stated if stated is not None else max(GLOSS_U, GLOSS_RELATIVE_U * value)
