"""Haze of transmitted light, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import samples
import xarray as xr
from scipy.optimize import brentq

from brdfpipe import appearance, facets, vocabulary
from brdfpipe.appearance.transmission import luminous_transmittance, transmission_haze
from brdfpipe.bsdf import microfacet, slab


def diffuser(share: float) -> xr.Dataset:
    """A sheet that spreads a share of the light evenly on the other side."""
    theta_o = np.array([0.0, 45.0, 90.0, 91.0, 135.0, 180.0])
    brdf = np.zeros((2, theta_o.size, 2))
    brdf[:, theta_o >= 90] = share / np.pi
    table = xr.Dataset(
        {"brdf": (("theta_i", "theta_o", "phi_o"), brdf)},
        coords={"theta_i": [0.0, 80.0], "theta_o": theta_o, "phi_o": [0.0, 360.0]},
        attrs={"representation": "table", "transmission": "slab"},
    )
    return vocabulary.label(table, "bsdf")


def test_a_perfect_diffuser_sends_all_but_the_cone_elsewhere():
    # ∫ cos θ dω / π over a cone of 2.5° is sin² 2.5°.
    assert transmission_haze(diffuser(0.5)) == pytest.approx(1 - np.sin(np.radians(2.5)) ** 2, abs=1e-5)
    assert luminous_transmittance(diffuser(0.5)) == pytest.approx(0.5, rel=1e-4)


def test_a_clear_plate_has_no_haze_and_stokes_transmittance():
    plate = slab.build(facets.flat(), facets.flat(), index=1.5, internal_transmittance=0.9)
    r, tau = 0.04, 0.9
    assert transmission_haze(plate) == pytest.approx(0, abs=1e-12)
    assert luminous_transmittance(plate) == pytest.approx((1 - r) ** 2 * tau / (1 - (r * tau) ** 2), rel=1e-5)


def test_haze_of_one_rough_face_is_the_share_of_facets_that_deflect_more_than_the_cone():
    a, n = 0.12, 1.5
    through = microfacet.build(facets.analytic("beckmann", a), index=n, transparent=True)
    tilt = brentq(lambda t: t - np.arcsin(np.sin(t) / n) - np.radians(2.5), 0, 1)
    # (1 − F) and masking of facets as gentle as these change the shares by parts in a thousand.
    assert transmission_haze(through) == pytest.approx(np.exp(-((np.tan(tilt) / a) ** 2)), abs=3e-3)


def test_an_opaque_material_has_no_haze_of_transmission():
    opaque = samples.beckmann_bsdf(0.1)
    assert np.isnan(transmission_haze(opaque))
    assert luminous_transmittance(opaque) == 0
    assert "transmission_haze" not in appearance.compute_appearance(opaque)


def test_the_appearance_of_a_sheet_contains_its_transmittance():
    frosted = slab.build(facets.flat(), facets.analytic("beckmann", 0.2), index=1.5)
    computed = vocabulary.validate(appearance.compute_appearance(frosted), "appearance")
    assert 0.5 < float(computed["transmission_haze"]) < 1
    # A sheet that absorbs nothing passes what it does not reflect; 8° of incidence against 0° differ by a thousandth.
    assert float(computed["luminous_transmittance"] + computed["luminous_reflectance"]) == pytest.approx(1, abs=1e-3)
