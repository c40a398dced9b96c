from __future__ import annotations

import numpy as np
import pytest
import samples

from brdfpipe import psd
from brdfpipe.bsdf import microfacet, slab, wave
from brdfpipe.bsdf.light_shares import ReflectanceParts, light_sum, reflectance_parts, scattered_rms_height
from brdfpipe.facets import flat


def _parts(bsdf, theta) -> ReflectanceParts:
    theta_i = np.array(theta)
    return reflectance_parts(bsdf, theta_i, np.full_like(theta_i, 180.0), np.array([550.0]))


def test_the_parts_of_the_reflectance_add_up_to_the_total() -> None:
    grazing = np.r_[np.linspace(0, 80, 33), 90 - np.geomspace(10, 0.1, 24)]
    parts = _parts(samples.beckmann_bsdf(0.2), grazing)
    assert parts.facets is not None
    assert parts.below is not None
    assert (parts.facets <= parts.total).all()
    np.testing.assert_allclose(parts.mirrored + parts.facets + parts.below, parts.total, rtol=1e-12)
    assert not parts.mirrored.any()


def test_of_a_smooth_surface_the_mirrored_part_is_that_of_fresnel() -> None:
    parts = _parts(microfacet.build(flat(), index=1.5, spectrum=samples.spectrum(0.3)), [0.0, 8.0])
    assert parts.facets is not None
    assert parts.mirrored[0] == pytest.approx(0.04, rel=1e-12)
    assert np.abs(parts.facets).max() < 1e-15
    assert parts.total[1] == pytest.approx(0.3, abs=1e-9)


def test_the_directional_reflectance_is_that_of_the_bsdf() -> None:
    # The BSDF closes on the spectrum at 8 degree, to the accuracy of the tabulated albedo.
    total = _parts(samples.beckmann_bsdf(0.2), [8.0]).total[0]
    assert total == pytest.approx(0.3, abs=1e-6)


def test_reflected_transmitted_and_absorbed_light_of_a_slab_add_up_to_all() -> None:
    sheet = slab.build(flat(), flat(), index=1.5, internal_transmittance=0.8)
    assert light_sum(sheet, 180.0, None) == pytest.approx(1.0, abs=1e-5)
    assert light_sum(sheet.assign(absorptance=sheet["absorptance"] + 0.1), 180.0, None) == pytest.approx(1.1, abs=1e-5)
    assert light_sum(sheet.drop_vars("absorptance"), 180.0, None) is None


@pytest.mark.parametrize(("sigma", "recovered"), [(0.005, True), (0.05, True), (0.2, False)])
def test_the_scattered_light_tells_the_rms_height_while_something_is_mirrored(sigma: float, recovered: bool) -> None:
    bsdf = wave.build(psd.analytic("gaussian", sigma=sigma, length=5.0), index=1.5, wavelength=[550.0, 650.0])
    heights = [scattered_rms_height(bsdf, theta_i) for theta_i in (5.0, 45.0)]
    # TIS is exact for a mirror; the reflectance of a dielectric varies over the halo.
    assert heights == (
        pytest.approx([sigma, sigma], rel=2e-3) if recovered else pytest.approx([np.nan] * 2, nan_ok=True)
    )


def test_no_rms_height_is_claimed_of_facets() -> None:
    assert np.isnan(scattered_rms_height(samples.beckmann_bsdf(0.1)))
