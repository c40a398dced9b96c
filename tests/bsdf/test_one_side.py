"""One side of a sheet, as a BSDF that reflects."""

from __future__ import annotations

import numpy as np
import pytest
import samples

from brdfpipe import facets
from brdfpipe.bsdf import slab
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.one_side import one_side
from brdfpipe.bsdf.registry import representation

THETA_O, PHI_O = np.array([5.0, 40.0, 70.0]), np.array([180.0, 200.0, 30.0])


@pytest.fixture(scope="module")
def sheet():
    rough = facets.analytic("beckmann", 0.3)
    return slab.build(rough, rough, index=1.5, internal_transmittance=0.9)


def values(bsdf, theta_o):
    at = np.full(3, 30.0), np.zeros(3), np.asarray(theta_o), PHI_O
    return representation(bsdf).evaluate(*at, None)


def test_transmitted_light_is_folded_over_the_surface(sheet):
    assert values(one_side(sheet, "transmission"), THETA_O) == pytest.approx(values(sheet, 180 - THETA_O))
    assert (values(one_side(sheet, "transmission"), 180 - THETA_O) == 0).all()


def test_reflected_light_stays_and_the_other_side_is_dark(sheet):
    assert values(one_side(sheet, "reflection"), THETA_O) == pytest.approx(values(sheet, THETA_O))
    assert (values(one_side(sheet, "reflection"), 180 - THETA_O) == 0).all()
    assert not representation(one_side(sheet, "reflection")).transmits


def test_the_share_of_a_side_is_its_albedo(sheet):
    theta, phi = np.array([0.0, 50.0]), np.zeros(2)
    whole = representation(sheet)
    for side, share in (("reflection", whole.albedo), ("transmission", whole.transmittance)):
        seen = representation(one_side(sheet, side))
        assert seen.albedo(theta, phi, None) == pytest.approx(share(theta, phi, None))
        # What is scattered into all directions is the rest: the quadrature resolves the folded lobe.
        assert seen.integrate(theta, phi, None).value + seen.specular(theta, phi, None)[0] == pytest.approx(
            share(theta, phi, None), rel=1e-3
        )


def test_the_mean_over_wavelength_is_of_that_side(sheet):
    seen = nonspectral(one_side(sheet, "transmission"))
    assert "wavelength" not in seen.coords
    assert values(seen, THETA_O)[:, 0] == pytest.approx(values(nonspectral(sheet), 180 - THETA_O)[:, 0])


def test_a_surface_that_reflects_alone_is_itself():
    grey = samples.beckmann_bsdf(0.2)
    assert one_side(grey, "reflection") is grey
