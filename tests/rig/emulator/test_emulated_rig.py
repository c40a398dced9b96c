"""The emulated rig: the camera sees the state of the devices, and the same run gives the same bytes."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from rig_truths import WAVELENGTHS, lobe, with_fibres

from brdfpipe.bsdf.registry import representation
from brdfpipe.rig import screen
from brdfpipe.rig.acquisition.devices.connection import connect
from brdfpipe.rig.acquisition.devices.errors import DeviceError
from brdfpipe.rig.emulator.effects import Effects, EmulationError
from brdfpipe.rig.emulator.emulated_rig import READOUT, EmulatedRig
from brdfpipe.rig.emulator.illumination import SPLIT
from brdfpipe.rig.emulator.optics import REFERENCE_RATE, SAMPLE_RATE

IDEAL = Effects.none()
MIDDLE_WAVELENGTH = (119, 159)


def emulated(rig, effects=IDEAL, truth=None, **options):
    return EmulatedRig(rig, representation(lobe(0.6) if truth is None else truth), effects=effects, **options)


def arranged(rig, effects=IDEAL, *, wavelength=550.0, position=1, sigma=20.0, truth=None, **options):
    """A rig without serial lines, with its devices at their positions."""
    stand = emulated(rig, effects, truth, **options)
    stand.monochromator.restore(wavelength)
    stand.wheel.restore(position)
    stand.set_entrance(sigma)
    return stand


def reference(rig, counts):
    column, row = (int(np.rint(coordinate)) for coordinate in screen.to_pixel(rig.screen, *rig.screen.reference_centre))
    return int(counts[row, column])


# --- what the camera sees


def test_a_picture_has_the_counts_of_the_closed_form(rig):
    counts = arranged(rig).camera.expose(2.0).counts
    # Pixel (119, 159) lies half a pixel, 0.06 degree, from the middle of the disc: the cosine of view is within 4e-4 of cos 20° there.
    expected = 2 * SAMPLE_RATE * (1 - SPLIT) * 0.6 / np.pi * np.cos(np.radians(20)) / 3
    assert int(counts[MIDDLE_WAVELENGTH]) == pytest.approx(expected, abs=0.5 + 4e-4 * expected)
    assert reference(rig, counts) == round(2 * REFERENCE_RATE * SPLIT / 3)


def test_the_range_of_the_rig_fits_five_frames(rig):
    # 0.01 to 2500 sr⁻¹: each end where nine pixels reach a ratio of 50, or the linear range ends.
    bright = arranged(rig, truth=lobe(0.0, 2500.0 / np.cos(np.radians(20)), 3.0), position=3).camera.expose(0.2)
    dark = arranged(rig, truth=lobe(0.01 * np.pi / np.cos(np.radians(20)))).camera.expose(10.0)
    assert 3 * int(bright.counts[MIDDLE_WAVELENGTH]) == pytest.approx(25_000 * (1 - SPLIT), rel=0.01)
    assert 3 * int(dark.counts[MIDDLE_WAVELENGTH]) == pytest.approx(500 * (1 - SPLIT), rel=0.01)


def test_the_camera_sees_the_wavelength_and_the_filter_that_the_lines_have_set(rig):
    truth = lobe(0.2 + 0.001 * (WAVELENGTHS - 380))
    with emulated(rig, truth=truth) as stand:
        stand.set_entrance(20)
        with connect(stand.rig, camera=stand.camera) as bench:
            bench.monochromator.goto(450)
            bench.wheel.goto(1)
            first = bench.camera.expose(4.0).counts
            bench.monochromator.goto(650)
            second = bench.camera.expose(4.0).counts
            bench.wheel.goto(2)
            third = bench.camera.expose(40.0).counts
    assert int(second[MIDDLE_WAVELENGTH]) / int(first[MIDDLE_WAVELENGTH]) == pytest.approx(0.47 / 0.27, rel=1e-3)
    assert int(third[MIDDLE_WAVELENGTH]) == pytest.approx(int(second[MIDDLE_WAVELENGTH]), abs=1)
    assert not Path(stand.rig.monochromator.port).exists()


@pytest.mark.parametrize("move", ["wavelength", "filter"])
def test_an_exposure_before_its_move_shows_in_the_pixels(rig, move):
    truth = lobe(0.2 + 0.001 * (WAVELENGTHS - 380))

    def counts(late):
        with emulated(rig, truth=truth) as stand, connect(stand.rig, camera=stand.camera) as bench:
            moves = [lambda: bench.monochromator.goto(650.0), lambda: bench.wheel.goto(2)]
            postponed = moves.pop(("wavelength", "filter").index(move))
            moves[0]()
            if not late:
                postponed()
            return bench.camera.expose(4.0).counts.astype(float)

    wrong, right = counts(late=True), counts(late=False)
    assert not np.allclose(wrong[MIDDLE_WAVELENGTH], right[MIDDLE_WAVELENGTH], rtol=0.1)


def test_a_move_during_the_exposure_blurs_the_frame(rig):
    truth = lobe(0.2 + 0.001 * (WAVELENGTHS - 380))
    stand = arranged(rig, wavelength=450.0, truth=truth)
    still = float(stand.camera.expose(30.0).counts[MIDDLE_WAVELENGTH])
    stand.monochromator.feed(b"400 NM/MIN\r")
    stand.monochromator.feed(b"650 >NM\r")
    moving = float(stand.camera.expose(30.0).counts[MIDDLE_WAVELENGTH])
    # 200 nm in 30 s: the mean over the exposure is that of 550 nm.
    assert moving / still == pytest.approx(0.37 / 0.27, rel=2e-3)
    assert stand.monochromator.wavelength == 650


def test_the_mean_of_the_lamp_over_the_exposure_counts_in_sample_and_reference_alike(rig):
    stand = arranged(rig, dataclasses.replace(IDEAL, warm_up=0.05, drift=0.01), seed=3)
    signals = []
    for wait in (0, 100, 400, 2000, 5000):
        stand.clock.advance_to(stand.clock.now() + wait)
        counts = stand.camera.expose(10.0).counts
        signals.append((float(counts[MIDDLE_WAVELENGTH]), float(reference(rig, counts))))
    sample, lamp = np.array(signals).T
    assert np.ptp(lamp) > 0.03 * lamp.mean()
    # Rounding to whole counts, of 4300 and more.
    assert sample / lamp == pytest.approx(np.full(5, sample[0] / lamp[0]), rel=3e-4)


def test_a_dark_frame_sees_no_light_but_hot_pixels(rig):
    stand = arranged(rig, dataclasses.replace(IDEAL, dark=2.0, hot_pixels=0.003))
    dark = stand.camera.expose(10.0, shutter=False).counts
    assert (dark > 100).sum() == round(0.003 * dark.size)
    assert np.median(dark) == 7  # 20 electrons


def test_the_load_of_the_holder_is_measured(rig):
    stand = arranged(rig)
    sample = stand.camera.expose(4.0).counts
    stand.set_entrance(10, load="etalon")
    etalon = stand.camera.expose(4.0).counts
    stand.set_entrance(20, load="dark-trap")
    trap = stand.camera.expose(4.0).counts
    etalon_brdf = 0.9 / np.pi * (1 - 0.05 * (20 / 60) ** 2)
    expected = 0.6 / np.pi / etalon_brdf  # both cosines are that of 20 degree
    assert int(sample[MIDDLE_WAVELENGTH]) / int(etalon[MIDDLE_WAVELENGTH]) == pytest.approx(expected, rel=1e-3)
    assert trap[MIDDLE_WAVELENGTH] == 0
    assert reference(rig, sample) == reference(rig, etalon) == reference(rig, trap)


# --- time and bytes


def test_exposures_and_readouts_take_virtual_time(rig):
    stand = arranged(rig)
    first = stand.camera.expose(2.5)
    second = stand.camera.expose(0.0)
    assert (first.started, first.seconds, second.started) == (0.0, 2.5, 2.5 + READOUT)
    assert stand.clock.now() == 2.5 + 2 * READOUT
    assert stand.camera.frames == 2


def steps(stand, count=6):
    pictures = []
    for number in range(count):
        stand.clock.advance_to(stand.clock.now() + 1.7)
        stand.monochromator.restore(430.0 + 20 * number)
        pictures.append(stand.camera.expose(0.7 + 0.1 * number))
    return pictures


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(rig):
    first, same, other = (steps(arranged(rig, Effects(), seed=seed)) for seed in (5, 5, 6))
    for one, two, three in zip(first, same, other, strict=True):
        assert one.counts.tobytes() == two.counts.tobytes() != three.counts.tobytes()
        assert (one.started, one.temperature) == (two.started, two.temperature)


def test_a_restored_rig_continues_with_the_same_bytes(rig):
    whole = steps(arranged(rig, Effects(), seed=5))
    stand = arranged(rig, Effects(), seed=5)
    last = whole[2]
    stand.restore(last.started + last.seconds + READOUT, 470.0, 1, 3)
    for number in (3, 4, 5):
        stand.clock.advance_to(stand.clock.now() + 1.7)
        stand.monochromator.restore(430.0 + 20 * number)
        assert stand.camera.expose(0.7 + 0.1 * number).counts.tobytes() == whole[number].counts.tobytes()


def test_another_session_is_the_same_rig_on_another_day(rig):
    dark = [arranged(rig, Effects(), session=session).camera.expose(30.0, shutter=False).counts for session in (0, 1)]
    assert dark[0].tobytes() != dark[1].tobytes()
    hot = [frame > np.median(frame) + 500 for frame in dark]
    assert np.array_equal(*hot)


@pytest.mark.parametrize("effect", sorted(field.name for field in dataclasses.fields(Effects)))
def test_every_effect_shows(rig, effect):
    # Together with effects that others need: a dark current, a halo, and a warm sensor.
    base = dataclasses.replace(IDEAL, dark=5.0, halo=0.01, halo_radius=20.0)
    stage = with_fibres(rig)
    in_a_hole = dataclasses.replace(stage.fibres[0], theta_s=20.0, phi_s=0.0)
    stage = dataclasses.replace(stage, fibres=(in_a_hole, *stage.fibres[1:]))
    truth = lobe(np.where(WAVELENGTHS < 535, 0.2, 0.5), 20.0, 6.0)

    def picture(effects):
        stand = EmulatedRig(stage, representation(truth), effects=effects, seed=1)
        stand.restore(50.0 if effect == "warm_up" else 5000.0, 530.0, 2, 0)
        load = {"certificate": "etalon", "mirror_angles": "mirror"}.get(effect, "sample")
        stand.set_entrance(10, load=load, aim=(5.0, 0.0) if load == "mirror" else None)
        return stand.camera.expose(30.0).counts

    off_by_default = {"cosmic": 50.0, "fibre_directions": 0.5, "wavelength_offset": 8.0}
    changed = dataclasses.replace(base, **{effect: off_by_default.get(effect, getattr(Effects(), effect))})
    assert not np.array_equal(picture(changed), picture(base))


# --- refusals


def test_time_does_not_run_backwards(rig):
    stand = arranged(rig)
    stand.camera.expose(5.0)
    with pytest.raises(EmulationError, match="cannot return to"):
        stand.restore(3.0, 500.0, 1, 0)


@pytest.mark.parametrize("wrong", [{"seed": -1}, {"session": -1}])
def test_numbers_below_nought_are_refused(rig, wrong):
    with pytest.raises(EmulationError, match="accepted: 0 or more"):
        emulated(rig, **wrong)


@pytest.mark.parametrize("seconds", [-1.0, float("nan"), 1e6])
def test_an_invalid_exposure_time_is_refused(rig, seconds):
    with pytest.raises(DeviceError, match=r"exposure time .* out of range"):
        arranged(rig).camera.expose(seconds)


def test_an_impossible_arrangement_leaves_the_previous_one(rig):
    stand = arranged(rig)
    with pytest.raises(EmulationError, match="no entrance at 30"):
        stand.set_entrance(30)
    assert stand.setup.entrance == 20


def test_the_devices_are_those_of_the_description(rig):
    described = dataclasses.replace(
        rig,
        monochromator=dataclasses.replace(rig.monochromator, serial_number="77", grating=3),
        wheel=dataclasses.replace(rig.wheel, dialect="acton-wheel", baud=9600, positions=8),
    )
    with emulated(described) as stand, connect(stand.rig, camera=stand.camera) as bench:
        assert "77" in bench.monochromator.identify()
        assert stand.monochromator.grating == 3
        assert bench.wheel.goto(8) == 8
    assert stand.rig.camera.kind == "emulated"
    assert stand.rig.digest == rig.digest
