"""Facets of a surface with a lay, and azimuths that resolve it."""

from __future__ import annotations

import numpy as np
import pytest

from brdfpipe import facets
from brdfpipe.bsdf.microfacet import anisotropic_quadrature as quadrature
from brdfpipe.facets.planar_density import Ellipse, PlanarDensity


@pytest.mark.parametrize("ratio", [1.0, 0.3, 3.0, 50.0])
@pytest.mark.parametrize("step", [11.25, 3.75, 7.0])
def test_arcs_and_azimuths_are_each_others_inverse(ratio, step):
    ellipse = Ellipse(0.1, 0.1 * ratio, 33.0)
    arcs = np.arange(0.0, 360.0, step)
    back = quadrature.azimuth_to_arc(ellipse, quadrature.arc_to_azimuth(ellipse, arcs))
    assert (back - arcs + 180) % 360 == pytest.approx(180.0, abs=1e-8)


def test_arcs_of_a_round_ellipse_are_azimuths():
    assert quadrature.azimuth_to_arc(Ellipse(0.2, 0.2, 30.0), np.array([30.0, 75.0, 29.0])) == pytest.approx(
        [0.0, 45.0, 359.0]
    )


def test_light_along_the_normal_meets_every_facet_once():
    density = PlanarDensity.of(facets.analytic("beckmann", a_x=0.01, a_y=0.1, azimuth=20.0))
    p, q, share = quadrature.facet_rule(density, np.zeros(1), np.zeros(1), mirroring=False)
    assert share.sum() == pytest.approx(1.0, abs=1e-6)
    covariance = np.array([[(share * a * b).sum() for a in (p, q)] for b in (p, q)])
    assert covariance == pytest.approx(density.moments[2], abs=1e-8)


def test_half_of_the_facets_face_light_near_grazing():
    density = PlanarDensity.of(facets.analytic("ggx", a_x=0.1, a_y=0.3))
    _, _, share = quadrature.facet_rule(density, np.array([89.999]), np.array([40.0]), mirroring=False)
    assert share.sum() == pytest.approx(0.5, abs=1e-3)
