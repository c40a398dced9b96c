"""Frames on disk: complete or absent, labelled with the state read back, and verified when they are read."""

from __future__ import annotations

import gzip
import math
import shutil
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
import small_rig
from astropy.io import fits
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from brdfpipe import vocabulary
from brdfpipe.errors import InputError
from brdfpipe.rig.frame_file import DeviceState, FrameError, frame_size, read_frame, write_frame
from brdfpipe.rig.frames import read_run
from brdfpipe.rig.plan import Plan
from brdfpipe.rig.raw_frame import RawFrame
from brdfpipe.store import StoreError

STARTED = 1_763_761_234.567891


@pytest.fixture
def plan(tmp_path):
    return Plan.load(small_rig.write(tmp_path / "bench"))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A finished run of fake devices; tests change a copy."""
    folder = tmp_path_factory.mktemp("run")
    plan = Plan.load(small_rig.write(folder / "bench"))
    small_rig.take(plan, small_rig.fake_bench(), folder / "run")
    return folder / "run"


@pytest.fixture
def copy(run, tmp_path):
    shutil.copytree(run, tmp_path / "run")
    return tmp_path / "run"


def light(plan, number=0):
    return [shot for shot in plan.shots if shot.purpose == "sample"][number]


def picture(shot, seed=0, **changes):
    counts = np.random.default_rng(seed).integers(0, 65536, (72, 96)).astype(np.uint16)
    return replace(RawFrame(counts, STARTED, shot.exposure, -3.25), **changes)


def written(plan, folder, shot=None, taken=None, **changes):
    shot = shot or light(plan)
    options = {
        "state": DeviceState(shot.wavelength + 0.02, shot.position),
        "run_start": STARTED - 60,
        "camera": "CCD",
        **changes,
    }
    path = folder / shot.name
    return path, shot, write_frame(path, taken or picture(shot), shot, plan, **options)


def relabelled(path, **labels):
    """A frame with another label and valid checksums."""
    content = fits.getdata(path), fits.getheader(path)
    image = fits.PrimaryHDU(content[0], content[1])
    for keyword, value in labels.items():
        if value is None:
            del image.header[keyword.replace("_", "-")]
        else:
            image.header[keyword.replace("_", "-")] = value
    image.add_checksum()
    path.unlink()
    image.writeto(path)


def frame_of(plan, folder, number):
    return folder / "frames" / plan.shots[number - 1].name


# --- one frame


def test_what_is_written_is_read_back(plan, tmp_path):
    path, shot, frame = written(plan, tmp_path)
    read_back = read_frame(path, shot, plan)
    assert np.array_equal(read_back.counts, picture(shot).counts)
    assert read_back.counts.dtype == np.uint16
    assert replace(read_back, counts=None) == replace(frame, counts=None)
    assert (read_back.state, read_back.started, read_back.elapsed) == (DeviceState(500.02, 2), STARTED, 60)
    assert (read_back.temperature, read_back.camera, read_back.run_start) == (-3.25, "CCD", STARTED - 60)


@given(st.integers(0, 2**16 - 1), st.floats(0, 9.9e9), st.floats(-273, 100))
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_count_and_any_time_come_back(plan, tmp_path, count, started, temperature):
    counts = np.full((72, 96), count, dtype=np.uint16)
    shot = light(plan)
    taken = picture(shot, counts=counts, started=started, temperature=temperature)
    path, _, frame = written(plan, tmp_path, shot, taken, run_start=None)
    read_back = read_frame(path, shot, plan)
    assert (read_back.counts == count).all()
    assert read_back.started == frame.started == pytest.approx(started, abs=1e-6)
    assert (read_back.elapsed, read_back.run_start) == (0, frame.started)
    assert read_back.temperature == pytest.approx(temperature, abs=5e-4)


def test_other_programs_read_the_same_from_it(plan, tmp_path):
    path, shot, _ = written(plan, tmp_path)
    with fits.open(path, checksum=True) as images:
        images.verify("exception")
        header, counts = images[0].header, images[0].data
    assert counts.dtype == np.uint16
    assert np.array_equal(counts, picture(shot).counts)
    for keyword, value in {
        "EXPTIME": 1.0,
        "IMAGETYP": "Light Frame",
        "GAIN": 3,
        "CCD-TEMP": -3.25,
        "WAVELEN": 500.02,
        "WLBAND": 10,
        "INCANG": 20,
        "NDPOS": 2,
        "NDTRANS": 0.1,
        "SAMPLEID": "tile",
        "SHOT": shot.ordinal,
        "PURPOSE": "sample",
        "SIDE": "reflection",
        "RIGNAME": "small",
        "RIGHASH": plan.rig.digest,
        "ELAPSED": 60,
        "INSTRUME": "CCD",
    }.items():
        assert header[keyword] == value
    assert datetime.fromisoformat(header["DATE-OBS"]).replace(tzinfo=UTC).timestamp() == pytest.approx(
        STARTED, abs=1e-5
    )


def test_a_dark_frame_is_labelled_dark(plan, tmp_path):
    path, _, _ = written(plan, tmp_path, plan.shots[0])
    assert fits.getheader(path)["IMAGETYP"] == "Dark Frame"


def test_an_unknown_temperature_stays_unknown(plan, tmp_path):
    shot = light(plan)
    path, _, _ = written(plan, tmp_path, shot, picture(shot, temperature=math.nan))
    assert math.isnan(read_frame(path, shot, plan).temperature)


def test_the_bytes_depend_on_the_exposure_alone(plan, tmp_path):
    first, shot, one = written(plan, tmp_path / "a")
    second, _, other = written(plan, tmp_path / "b")
    assert first.read_bytes() == second.read_bytes()
    assert one.digest == other.digest
    assert first.stat().st_size == frame_size(plan)
    third, _, _ = written(plan, tmp_path / "c", shot, picture(shot, seed=1))
    assert third.read_bytes() != first.read_bytes()


def test_a_name_of_a_camera_that_fits_cannot_hold_is_made_to_fit(plan, tmp_path):
    path, shot, _ = written(plan, tmp_path, camera="Kamera 320 × 240, größer'\n" + 100 * "x")
    assert read_frame(path, shot, plan).camera.startswith("Kamera 320 x 240, gr??er ?xxx")


def test_no_temporary_file_stays(plan, tmp_path):
    path, _, _ = written(plan, tmp_path / "a")
    assert [item.name for item in path.parent.iterdir()] == [path.name]


def test_a_failed_write_leaves_no_file(plan, tmp_path, monkeypatch):
    monkeypatch.setattr("pathlib.Path.write_bytes", lambda self, content: self.touch() or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        written(plan, tmp_path / "a")
    assert list((tmp_path / "a").iterdir()) == []


def test_a_full_disk_is_reported(plan, tmp_path, monkeypatch):
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr("shutil.disk_usage", lambda path: usage._replace(free=1000))
    with pytest.raises(StoreError, match="not enough disk space to write it"):
        written(plan, tmp_path)


# --- damaged and wrong files


def test_any_damaged_byte_is_detected(plan, tmp_path):
    path, shot, _ = written(plan, tmp_path)
    content = path.read_bytes()
    generator = np.random.default_rng(3)
    for place in [0, 79, 80, 2879, 2880, len(content) - 1, *generator.integers(0, len(content), 150)]:
        damaged = bytearray(content)
        damaged[place] ^= int(generator.integers(1, 256))
        path.write_bytes(damaged)
        with pytest.raises(FrameError, match=shot.name):
            read_frame(path, shot, plan)


@pytest.mark.parametrize("length", [0, 1, 79, 2879, 2880, 5760, 10_000, -1, -2880])
def test_a_truncated_frame_is_detected(plan, tmp_path, length):
    path, shot, _ = written(plan, tmp_path)
    path.write_bytes(path.read_bytes()[:length])
    with pytest.raises(FrameError, match=shot.name):
        read_frame(path, shot, plan)


def test_a_frame_with_zeros_at_its_end_is_detected(plan, tmp_path):
    """A file system may have written the size of a file before its content."""
    path, shot, _ = written(plan, tmp_path)
    content = path.read_bytes()
    path.write_bytes(content[:12_000] + bytes(len(content) - 12_000))
    with pytest.raises(FrameError, match="damaged"):
        read_frame(path, shot, plan)


def test_a_missing_frame_is_reported(plan, tmp_path):
    with pytest.raises(FrameError, match="missing"):
        read_frame(tmp_path / "frames" / light(plan).name, light(plan), plan)


@pytest.mark.parametrize(
    ("labels", "words"),
    [
        ({"SHOT": 3}, ["SHOT", "found 3"]),
        ({"WAVELEN": 510.0}, ["WAVELEN", "found 510", "500"]),
        ({"WAVELEN": 499.4}, ["WAVELEN"]),
        ({"WAVELEN": "five hundred"}, ["WAVELEN", "five hundred"]),
        ({"WAVELEN": True}, ["WAVELEN"]),
        ({"INCANG": 45.0}, ["INCANG", "found 45"]),
        ({"NDPOS": 1}, ["NDPOS", "found 1"]),
        ({"NDTRANS": 0.11}, ["NDTRANS", "0.11"]),
        ({"EXPTIME": 2.0}, ["EXPTIME", "2.0"]),
        ({"IMAGETYP": "Dark Frame"}, ["IMAGETYP", "Dark Frame"]),
        ({"PURPOSE": "etalon"}, ["PURPOSE", "etalon"]),
        ({"SIDE": "transmission"}, ["SIDE"]),
        ({"STEP": 2}, ["STEP"]),
        ({"SAMPLEID": "another"}, ["SAMPLEID", "another", "tile"]),
        ({"RIGHASH": 64 * "0"}, ["RIGHASH"]),
        ({"RIGNAME": "other"}, ["RIGNAME"]),
        ({"GAIN": 2.0}, ["GAIN"]),
        ({"WLBAND": 15.0}, ["WLBAND"]),
        *(({keyword: None}, [keyword.replace("_", "-"), "missing"]) for keyword in ("SHOT", "WAVELEN", "NDPOS", "INCANG")),
        *(({keyword: None}, [keyword.replace("_", "-"), "missing"]) for keyword in ("STARTED", "ELAPSED", "CCD_TEMP")),
        ({"STARTED": "now"}, ["STARTED", "not a number"]),
    ],
)  # fmt: skip
def test_a_frame_labelled_as_another_is_refused(plan, tmp_path, labels, words):
    path, shot, _ = written(plan, tmp_path)
    relabelled(path, **labels)
    with pytest.raises(FrameError) as refusal:
        read_frame(path, shot, plan)
    for word in [shot.name, *words]:
        assert word in str(refusal.value)


def test_a_frame_without_sums_is_not_believed(plan, tmp_path):
    path, shot, _ = written(plan, tmp_path)
    with fits.open(path) as images:
        del images[0].header["CHECKSUM"]
        images[0].writeto(tmp_path / "other.fits")
    (tmp_path / "other.fits").replace(path)
    with pytest.raises(FrameError, match="invalid checksum"):
        read_frame(path, shot, plan)


def compressed(path):
    path.write_bytes(gzip.compress(path.read_bytes()))


def of_another_size(path):
    image = fits.PrimaryHDU(np.zeros((72, 95), dtype=np.uint16), fits.getheader(path))
    image.add_checksum()
    image.writeto(path, overwrite=True)


def of_fractions(path):
    image = fits.PrimaryHDU(np.zeros((72, 96), dtype=np.float32), fits.getheader(path))
    image.header.remove("BZERO", ignore_missing=True)
    image.add_checksum()
    image.writeto(path, overwrite=True)


def with_a_second_picture(path):
    fits.append(path, np.zeros((2, 2), dtype=np.uint8))


def enormous(path):
    path.write_bytes(path.read_bytes() + bytes(100_000))


def that_promises_much(path):
    header = b"".join(
        card.ljust(80).encode()
        for card in ["SIMPLE  =                    T", "BITPIX  =                   16", "NAXIS   =                    2",
                     "NAXIS1  =           2000000000", "NAXIS2  =           2000000000", "END"]
    )  # fmt: skip
    path.write_bytes(header.ljust(2880))


def elsewhere(path):
    path.rename(path.with_name("elsewhere"))
    path.symlink_to(path.with_name("elsewhere"))


@pytest.mark.parametrize(
    "spoil",
    [compressed, of_another_size, of_fractions, with_a_second_picture, enormous, that_promises_much, elsewhere],
)
def test_a_file_that_is_not_a_frame_is_refused(plan, tmp_path, spoil):
    path, shot, _ = written(plan, tmp_path)
    spoil(path)
    with pytest.raises(FrameError, match=shot.name):
        read_frame(path, shot, plan)


def test_counts_beyond_the_bits_of_the_camera_are_refused(plan, tmp_path):
    path, shot, _ = written(plan, tmp_path)
    rig = replace(plan.rig, camera=replace(plan.rig.camera, bits=12))
    with pytest.raises(FrameError, match="counts exceed the camera's range"):
        read_frame(path, shot, replace(plan, rig=rig))


def test_refusals_cross_process_borders(plan, tmp_path):
    import pickle

    with pytest.raises(FrameError) as refusal:
        read_frame(tmp_path / "x.fits", light(plan), plan)
    assert str(pickle.loads(pickle.dumps(refusal.value))) == str(refusal.value)


# --- a run


def test_a_whole_run_is_a_dataset_without_warnings(run):
    frames = read_run(run)
    plan = Plan.load(run / "plan.yaml")
    assert frames.attrs["kind"] == "frames"
    assert vocabulary.warnings(frames) == []
    assert frames["counts"].shape == (len(plan.shots), 72, 96)
    assert frames["counts"].dtype == np.uint16
    # Every pixel of the fake camera holds the number of the exposure.
    assert (frames["counts"].values == frames["shot"].values[:, None, None]).all()
    for place, shot in enumerate(plan.shots):
        one = frames.isel(frame=place)
        assert one["purpose"] == shot.purpose
        assert one["side"] == shot.arrangement.side
        assert one["incidence"] == shot.arrangement.incidence
        assert one["wavelength"] == one["wavelength_read"] == shot.wavelength
        assert (one["exposure"], one["nd_position"]) == (shot.exposure, shot.position)
        assert one["nd_transmittance"] == {1: 1, 2: 0.1}[shot.position]
        assert one["elapsed"] == 10 * place
    assert frames.attrs["rig_digest"] == plan.rig.digest
    assert (frames.attrs["sample"], frames.attrs["rig"], frames.attrs["camera"]) == ("tile", "small", "fake camera")


def test_one_incidence_comes_with_all_dark_frames_and_lamp_readings(run):
    frames = read_run(run, 20)
    assert set(frames["purpose"].values) == {"sample", "dark", "drift"}
    assert set(frames["incidence"].values[frames["purpose"].values == "sample"]) == {20}
    # Lamp readings of the other entrance, and the bracket frames that they repeat, give the repeatability of the rig.
    there = frames.isel(frame=(frames["purpose"].values == "drift") & (frames["incidence"].values == 10))
    states = zip(there["load"].values, there["wavelength"].values, there["exposure"].values, strict=True)
    drift = Plan.load(run / "plan.yaml").drift
    assert len(set(states)) == 1
    assert (there["wavelength"].values == drift.wavelength).all()
    assert there.sizes["frame"] == 1 + sum(
        shot.purpose == "drift" and shot.arrangement.incidence == 10 for shot in Plan.load(run / "plan.yaml").shots
    )
    assert (frames["purpose"].values == "dark").sum() == 10
    assert set(read_run(run, 10)["purpose"].values) == {"etalon", "dark", "drift"}


def test_an_incidence_that_was_not_planned_is_refused(run):
    with pytest.raises(InputError, match="incidence not in the plan; found 30; accepted: 10, 20"):
        read_run(run, 30)


def test_a_folder_without_a_run_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"plan\.yaml: no such file"):
        read_run(tmp_path)


def test_a_run_without_a_usable_frame_is_refused(copy):
    shutil.rmtree(copy / "frames")
    with pytest.raises(InputError, match="no usable frame"):
        read_run(copy)


def warnings_after(copy, incidence=None):
    frames = read_run(copy, incidence)
    return frames, vocabulary.warnings(frames)


def test_a_warning_names_a_damaged_frame_and_what_is_missing(copy):
    plan = Plan.load(copy / "plan.yaml")
    shot = light(plan, 3)
    path = copy / "frames" / shot.name
    path.write_bytes(path.read_bytes()[:-100])
    frames, messages = warnings_after(copy)
    assert shot.ordinal not in frames["shot"].values
    assert frames.sizes["frame"] == len(plan.shots) - 1
    named, gap = messages
    assert shot.name in named
    assert "not used" in named
    assert gap.startswith("bracket step 2 is missing at 1 of 2 wavelengths at 20 degree (sample: 550 nm)")
    assert "--resume" in gap


def test_missing_frames_are_summarised_by_purpose(copy):
    plan = Plan.load(copy / "plan.yaml")
    for shot in plan.shots:
        if (shot.purpose == "etalon" and shot.step == 1) or shot.ordinal in (1, 2, 3) or shot.purpose == "drift":
            (copy / "frames" / shot.name).unlink()
    _, messages = warnings_after(copy)
    assert [line.split(";")[0] for line in messages] == [
        "3 of 10 dark frames of 1 s are missing",
        "1 of 1 lamp monitor readings at 10 degree are missing",
        "bracket step 1 is missing at 2 of 2 wavelengths at 10 degree (etalon: 500, 550 nm)",
        "2 of 2 lamp monitor readings at 20 degree are missing",
    ]


def test_missing_frames_of_other_incidences_give_no_warning(copy):
    plan = Plan.load(copy / "plan.yaml")
    for shot in plan.shots:
        if shot.purpose == "etalon":
            (copy / "frames" / shot.name).unlink()
    assert warnings_after(copy, incidence=20)[1] == []


def test_a_second_frame_of_a_shot_is_named_and_not_used(copy):
    plan = Plan.load(copy / "plan.yaml")
    shot = light(plan)
    other = copy / "frames" / f"{shot.ordinal:05d}-sample-20deg-510nm.fits"
    shutil.copy(copy / "frames" / shot.name, other)
    frames, messages = warnings_after(copy)
    assert frames.sizes["frame"] == len(plan.shots)
    assert len(messages) == 1
    assert other.name in messages[0]
    assert f"second file of frame {shot.ordinal}, whose file is {shot.name}" in messages[0]


def test_a_other_device_among_the_frames_is_named(copy):
    (copy / "frames" / "holiday.fits").write_bytes(b"sun")
    (copy / "frames" / "99999-sample.fits").write_bytes(b"sun")
    (copy / "frames" / "notes.txt").write_text("no frame")
    _, messages = warnings_after(copy)
    assert [line.split(":")[0] for line in messages] == ["99999-sample.fits", "holiday.fits"]
    assert all("not a frame of the plan" in line for line in messages)


def test_exchanged_frames_are_both_named(copy):
    plan = Plan.load(copy / "plan.yaml")
    one, other = (copy / "frames" / light(plan, number).name for number in (0, 3))
    content = one.read_bytes()
    one.write_bytes(other.read_bytes())
    other.write_bytes(content)
    frames, messages = warnings_after(copy)
    assert frames.sizes["frame"] == len(plan.shots) - 2
    assert one.name in messages[0]
    assert other.name in messages[1]
    assert len(messages) == 4


def test_frames_of_another_rig_are_not_used(copy):
    """The description in the folder of the run was edited after the scan: every frame belongs to another rig."""
    rig = copy / "rig.yaml"
    rig.write_text(rig.read_text().replace("transmittance: 0.1}", "transmittance: 0.12}"))
    with pytest.raises(
        InputError, match="the description of the rig was changed after the frames of this run were taken"
    ):
        read_run(copy)


def test_a_wavelength_axis_that_was_shifted_in_the_plan_is_noticed(copy):
    plan = copy / "plan.yaml"
    plan.write_text(plan.read_text().replace("[500, 550]", "[510, 550]"))
    _, messages = warnings_after(copy)
    assert any(
        "bracket step 1 is missing at 1 of 2 wavelengths at 20 degree (sample: 510 nm)" in line for line in messages
    )
    assert sum("whose file is 0" in line for line in messages) == 4


def test_file_names_that_cannot_be_printed_do_not_stop_the_reading(copy):
    try:
        (copy / "frames" / "\udcff.fits").write_bytes(b"x")
    except (ValueError, OSError):
        pytest.skip("this system has no such names")
    (messages,) = warnings_after(copy)[1]
    assert messages.startswith("\\xff.fits")
