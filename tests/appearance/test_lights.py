"""The lights of a preview, and their tables."""

from __future__ import annotations

import numpy as np
import pytest

from brdfpipe.appearance.lights import LIGHTS, WHITE_LEVEL, LightError, Lights, SoftBox, lights, sphere_rule


def test_an_unknown_light_is_refused_with_those_known():
    with pytest.raises(
        LightError, match=r"unknown light 'candle'; accepted: studio, sun, overcast, spot, tubes; set `preview_light`"
    ):
        lights("candle")


@pytest.mark.parametrize("blur", [0.03, 0.1])
def test_a_blur_keeps_the_light_of_a_box(blur):
    # The tangent plane is flat and the sphere is not: exact for a small box on its axis up to the fourth power of the blur.
    box = SoftBox((-0.5, -0.6, 0.6), 0.1, 0.2, 3.0)
    directions, share = sphere_rule(400_000)
    sharp, soft = (box.light_from(directions, width).sum() * share for width in (0.0, blur))
    assert soft == pytest.approx(sharp, rel=0.002 + 20 * blur**4 + 0.5 * blur * 0.1)


def test_a_box_is_visible_only_from_its_side():
    box = SoftBox((0.0, -1.0, 0.0), 0.2, 0.2, 2.0)
    seen = box.light_from(np.array([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]))
    assert seen == pytest.approx([2.0, 0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("name", LIGHTS)
@pytest.mark.parametrize("blur", [0.0, 0.02, 0.0566])
def test_the_lookup_table_agrees_with_the_lights(name, blur):
    environment = lights(name)
    directions, _ = sphere_rule(50_000)
    x, y, z = (directions[:, k, None].astype(np.float32) for k in range(3))
    filtered = environment.filtered(x, y, z, np.array([blur]))[0, :, 0]
    expected = environment.radiance(directions, blur)
    # The nearest texel errs at the edges of boxes, to either side; few of the directions meet the sun's.
    assert filtered.mean() == pytest.approx(expected.mean(), rel=4e-3)
    assert np.sqrt(np.mean((filtered - expected) ** 2)) < 0.02 * expected.max()


def test_nadir_and_zenith_are_in_the_lookup_table():
    filtered = Lights((), zenith=2.0, ground=0.5).filtered
    z = np.array([[1.0], [-1.0]], dtype=np.float32)
    zero = np.zeros((2, 1), dtype=np.float32)
    assert filtered(zero, zero, z, np.zeros(1))[0, :, 0] == pytest.approx([2.0, 0.5], rel=1e-3)


def test_an_even_sky_is_exposed_to_the_white_level():
    assert Lights((), 0.3, 0.3).exposure == pytest.approx(WHITE_LEVEL / 0.3, rel=1e-3)
