"""Numbers of rays, facets and nodes with which a model is computed: fine, or quick where a scene accepts the error of that."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from brdfpipe.bsdf.microfacet import second_reflection, traced_reflections
from brdfpipe.bsdf.wave import builder as wave
from brdfpipe.bsdf.wave import height_transform

QUICK, FINE = "quick", "fine"
"""Names of :data:`NUMERICS`."""

NUMERICAL_ERROR: Mapping[str, float] = {"gloss": 0.15}
"""Error of quick numerics by metric, in its unit: above that of all random materials that were tried (``benchmarks/quick_numerics.py``). Metrics
without one have fine numerics."""

MOST_OF_TOLERANCE = 0.15
"""Share of the tolerance that the error of quick numerics may be."""


@dataclass(frozen=True)
class Numerics:
    """Numbers of rays, facets and nodes."""

    compares_all: bool
    """Whether all facets are compared to choose the masking, and not only as many as make the choice clear"""
    rays: int
    """Of each incidence, for light that is reflected more than once"""
    reflection_nodes: tuple[int, int]
    """Angles and azimuths of the table of that light"""
    phase_step: float
    """Of the logarithm of the phase variance in tables of the halo [1]"""
    lay_energy_nodes: wave.EnergyNodes
    """Of the integrals that close the energy of waves, of a surface with a lay"""


NUMERICS = {
    QUICK: Numerics(
        compares_all=False,
        rays=2**13,
        reflection_nodes=(12, 9),
        phase_step=0.12,
        lay_energy_nodes=wave.EnergyNodes(17, 4, 3, closure_arcs=8, arcs_a_half=7, arcs_a_turn=15),
    ),
    FINE: Numerics(
        compares_all=True,
        rays=traced_reflections.RAYS,
        reflection_nodes=second_reflection.NODES,
        phase_step=height_transform.PHASE_STEP,
        lay_energy_nodes=wave.LAY_ENERGY_NODES,
    ),
}


def numerics_for(metric: str, tolerance: float, lay: bool) -> tuple[str, float]:
    """Name of the numerics of a material, and their error in the unit of the metric; fine with a lay, whose rays are shared by many planes."""
    error = NUMERICAL_ERROR.get(metric)
    if lay or error is None or error > MOST_OF_TOLERANCE * tolerance:
        return FINE, 0.0
    return QUICK, error
