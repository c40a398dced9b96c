"""Reflectance haze, against closed forms and gloss."""

from __future__ import annotations

import numpy as np
import pytest
import samples

from brdfpipe import facets, optics
from brdfpipe.appearance import apertures, gloss
from brdfpipe.appearance.gloss_meter import RECEPTOR
from brdfpipe.appearance.haze import (
    WINDOWS,
    HazeError,
    HazeWindow,
    reflectance_haze,
    reflectance_haze_with_uncertainty,
)
from brdfpipe.bsdf import lambert_gauss, microfacet


def rough(a, n=1.5):
    return samples.glossy_bsdf(a, n)


def test_a_polished_surface_has_no_haze():
    assert reflectance_haze(microfacet.build(facets.flat(), index=1.5)).values == pytest.approx(0, abs=1e-12)


def test_haze_of_a_white_lambertian_is_the_solid_angle_of_its_windows():
    haze = reflectance_haze(lambert_gauss.lambertian(samples.spectrum(1.0)))
    solid = 2 * np.radians(1.8) * np.radians(3.6) * np.cos(np.radians(20))
    # Small windows: solid angles to 1e-3, and black glass on the axis to 1e-4.
    expected = 100 * solid / np.pi / float(optics.fresnel(np.cos(np.radians(20)), 1.567)[2])
    assert float(haze[0]) == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("a", [0.01, 0.05, 0.3])
def test_the_windows_and_the_receptor_between_them_make_one_wide_receptor(a):
    windows = [HazeWindow(20.0, 1.4, (1.0, 3.6))]
    beside, centre = float(reflectance_haze(rough(a), windows)[0]), float(gloss(rough(a), [20.0])[0])
    light = apertures.source(20.0, apertures.FINE)
    beam = apertures.Beam(20.0, light, apertures.centred(3.8, 3.6), 6)
    (whole,) = apertures.received(apertures.sample_of(rough(a), None), [beam], np.zeros(1))
    # 20° gloss ends 0.9° off the axis, where the windows start; they are wider across by 1/cos 1.4° = 1.0003.
    assert beside + centre == pytest.approx(100 * (light.weight @ whole[0]) / (light.weight @ light.glass), rel=4e-4)


def test_haze_has_a_maximum_between_polished_and_matt():
    hazes = [float(reflectance_haze(rough(a))[0]) for a in (0.001, 0.005, 0.015, 0.1, 0.4)]
    assert np.argmax(hazes) in (1, 2)
    assert hazes[0] < 0.1 < hazes[-1] < max(hazes)


def test_windows_further_off_see_less_and_are_named():
    asked = [{"angle": 30, "offset": offset, "aperture": [0.5, 3]} for offset in (2, 5, 15)]
    hazes = reflectance_haze(rough(0.05), asked)
    assert (np.diff(hazes.values) < 0).all()
    assert hazes["haze_window"].values.tolist()[0] == "30° ± 2°, 0.5° × 3°"


def test_haze_of_a_surface_with_a_lay_is_between_those_of_its_planes():
    brushed = samples.brushed_bsdf(0.01, 0.1, 20)
    mean = float(reflectance_haze(brushed)[0])
    planes = [float(reflectance_haze(brushed, azimuth=azimuth)[0]) for azimuth in (20, 110)]
    assert min(planes) < mean < max(planes)


def test_haze_of_a_surface_with_a_lay_is_the_mean_of_many_azimuths():
    brushed = samples.brushed_bsdf(0.01, 0.1, 20)
    around = [float(reflectance_haze(brushed, azimuth=azimuth)[0]) for azimuth in np.arange(23.75, 110.0, 7.5)]
    # The lay and what lies across it are axes of symmetry: these are half steps off both.
    assert float(reflectance_haze(brushed)[0]) == pytest.approx(np.mean(around), rel=1e-4)


def test_the_windows_of_the_standard_do_not_overlap_the_receptor_of_gloss():
    (window,) = WINDOWS
    assert (window.angle - window.offset, window.angle + window.offset) == (18.1, 21.9)
    assert RECEPTOR[window.angle][0] / 2 <= window.offset - window.aperture[0] / 2


@pytest.mark.parametrize(
    ("window", "said"),
    [
        (HazeWindow(20.0, 1.0, (1.8, 3.6)), "covers part of the source's image"),
        (HazeWindow(85.0, 4.5, (2.0, 3.6)), "extends below the surface"),
    ],
)
def test_a_window_that_cannot_be_is_refused(window, said):
    with pytest.raises(HazeError, match=said):
        reflectance_haze(rough(0.1), [window])


def test_the_uncertainty_of_a_matt_surface_is_that_of_solid_angles_and_cosines():
    value, spread = reflectance_haze_with_uncertainty(lambert_gauss.lambertian(samples.spectrum(1.0)))
    axes = np.radians([18.1, 21.9])
    by_window = float(value[0]) * np.cos(axes) / np.cos(axes).sum()
    own = [by_window * 0.05 / 1.8, by_window * 0.1 / 3.6, by_window * np.radians(0.1) * np.tan(axes)]
    glass = [float(optics.fresnel(np.cos(np.radians(angle)), 1.567)[2]) for angle in (19.9, 20.1)]
    # The window's axes move with the mirror direction.
    cosines = [np.cos(np.radians([18.1, 21.9]) + np.radians(off)).sum() for off in (-0.1, 0.1)]
    by_angle = float(value[0]) * (np.diff(np.log(cosines)) - np.diff(np.log(glass)))[0] / 2
    expected = np.sqrt((np.sum(np.square(own)) + by_angle**2) / 3)
    assert float(spread[0]) == pytest.approx(expected, rel=0.01)
    assert spread.name == "reflectance_haze_u"


@pytest.mark.parametrize("a", [0.01, 0.1])
def test_the_uncertainty_follows_instruments_whose_windows_are_off(a):
    # A steep lobe: where the windows stand counts most, and the two are independent.
    def of(window):
        return float(reflectance_haze(rough(a), [window])[0])

    (nominal,) = WINDOWS
    both = [of(nominal._replace(offset=nominal.offset + off)) for off in (-0.1, 0.1)]
    # Both windows moved outwards together add linearly what counts as independent, nearly alike on either side.
    by_axes = abs(np.diff(both)[0]) / 2 / np.sqrt(2) / np.sqrt(3)
    total_u = float(reflectance_haze_with_uncertainty(rough(a))[1][0])
    assert by_axes < total_u < 2 * by_axes + 0.03 * of(nominal)


def test_a_polished_surface_has_no_uncertainty_of_haze():
    polished = microfacet.build(facets.flat(), index=1.5)
    assert reflectance_haze_with_uncertainty(polished)[1].values == pytest.approx(0, abs=1e-12)


def test_the_uncertainty_leaves_the_haze_as_it_is():
    value, spread = reflectance_haze_with_uncertainty(rough(0.05))
    assert value.identical(reflectance_haze(rough(0.05)))
    assert float(spread[0]) > 0
