from __future__ import annotations

import numpy as np
import pytest

from brdfpipe.facets import analytic
from brdfpipe.facets.analytic_distributions import DISTRIBUTIONS, equivalent_densities
from brdfpipe.facets.planar_density import PlanarDensity


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_the_equivalent_of_a_named_density_is_that_density(name: str) -> None:
    facets, slope = analytic(name, 0.1), np.linspace(0, 0.4, 50)
    own = np.interp(slope, facets["slope"].values, facets["slope_density"].values)
    # Linear interpolation between 512 nodes, and of the median slope between quadrature nodes: 1 % at the peak.
    section = equivalent_densities(facets)[DISTRIBUTIONS.index(name)].section(slope)
    np.testing.assert_allclose(section, own, rtol=0.02, atol=0.01 * own.max())


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_the_equivalent_of_a_named_density_with_a_lay_has_its_sections(name: str) -> None:
    facets, slope = analytic(name, a_x=0.1, a_y=0.2), np.linspace(0, 0.3, 20)
    density, equivalent = PlanarDensity.of(facets), equivalent_densities(facets)[DISTRIBUTIONS.index(name)]
    # Its widths come from moments or medians of the tabulated density.
    np.testing.assert_allclose(equivalent.section(slope), density(slope, 0 * slope), rtol=0.05, atol=1e-3)
    np.testing.assert_allclose(equivalent.section(slope, 1), density(0 * slope, slope), rtol=0.05, atol=1e-3)


def test_a_beckmann_without_rms_slope_has_the_median_slope_of_the_facets() -> None:
    facets = analytic("beckmann", 0.1)
    (rms, _), (median, _) = equivalent_densities(facets), equivalent_densities(facets.drop_vars("slope_rms"))
    assert (rms.matched, median.matched) == ("rms", "median")
    # The median is interpolated between the nodes of a quadrature.
    np.testing.assert_allclose(median.widths, rms.widths, rtol=5e-3)
