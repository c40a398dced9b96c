"""The geometry of veiling glare as keys."""

from __future__ import annotations

import pytest

from brdfpipe.appearance.cabin import Cabin, cabin_of
from brdfpipe.descriptions import reading
from brdfpipe.errors import InputError
from brdfpipe.scenes.glare_keys import GlareKeys


def read(tmp_path, text: str):
    path = tmp_path / "glare.yaml"
    path.write_text(text, encoding="utf-8")
    return reading.read(path, GlareKeys)


def test_the_defaults_are_those_of_the_computation(tmp_path):
    assert cabin_of(read(tmp_path, "distance: 0.4")) == Cabin()
    content = read(tmp_path, "windscreen: {rake: 35}\nsky: {kind: Overcast, illuminance: 8000}")
    cabin = cabin_of(content)
    assert (cabin.windscreen.rake, cabin.windscreen.length, cabin.sky.kind) == (35, 0.9, "overcast")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("windscreen: {rake: 95}", "windscreen.rake: not an accepted value; found 95"),
        ("sky: {kind: cloudy}", "sky.kind: not an accepted value; found 'cloudy'; accepted: uniform, clear, overcast"),
        ("windscreen: {transmittance: 0.95}", "glass of index 1.52 cannot transmit 0.95"),
        ("distance: 2", "the place on the glass is above its top"),
        ("line_of_sight: 40", "along a windscreen of rake 30; accepted: a line of sight below the rake"),
    ],
)
def test_a_geometry_that_cannot_be_is_refused(tmp_path, text, message):
    with pytest.raises(InputError) as refusal:
        read(tmp_path, text)
    assert message in str(refusal.value)
