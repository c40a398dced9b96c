from __future__ import annotations

import numpy as np
import pytest

from brdfpipe.facets import analytic
from brdfpipe.facets.planar_density import PlanarDensity
from brdfpipe.report.plots import masking, slope_density
from brdfpipe.report.plots.svg import Figure


def _labels(figure: Figure) -> list[str]:
    return [label for *_, label in figure.legend]


def test_the_overlays_of_a_named_density_are_that_density() -> None:
    slope = np.linspace(0, 0.4, 50)
    for name, which in (("beckmann", 0), ("ggx", 1)):
        facets = analytic(name, 0.1)
        model = slope_density.radial_equivalents(facets)[which][0]
        own = np.interp(slope, facets["slope"].values, facets["slope_density"].values)
        # Linear interpolation between 512 nodes, and of the median slope between quadrature nodes: 1 % at the peak.
        np.testing.assert_allclose(model(slope), own, rtol=0.02, atol=0.01 * own.max())


def test_beckmann_has_the_rms_slope_where_it_is_finite_and_else_the_median() -> None:
    assert "Beckmann of the same rms slope, 0.1" in _labels(slope_density.slope_density(analytic("beckmann", 0.1)))
    assert any(
        "Beckmann of the same median slope" in label for label in _labels(masking.smith_masking(analytic("ggx", 0.1)))
    )


@pytest.mark.parametrize("name", ["beckmann", "ggx"])
def test_the_overlays_of_a_named_finish_with_a_lay_are_its_sections(name: str) -> None:
    facets = analytic(name, a_x=0.1, a_y=0.2)
    density = PlanarDensity.of(facets)
    sections = slope_density.planar_equivalents(facets, density)[("beckmann", "ggx").index(name)][0]
    slope = np.linspace(0, 0.3, 20)
    # The widths of the overlay come from moments or medians of the tabulated density.
    np.testing.assert_allclose(sections[0](slope), density(slope, 0 * slope), rtol=0.05, atol=1e-3)
    np.testing.assert_allclose(sections[1](slope), density(0 * slope, slope), rtol=0.05, atol=1e-3)
