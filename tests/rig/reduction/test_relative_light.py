"""From emulated frames to the light of each cell, compared with the emulator's truth; refusals and warnings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import rig_accuracy as accuracy
import rig_emulated
import xarray as xr

from brdfpipe import specular_directions, vocabulary
from brdfpipe.errors import BrdfpipeError
from brdfpipe.rig import frame_file, reduce, screen
from brdfpipe.rig import frames as files
from brdfpipe.rig.emulator.camera_view import true_screen
from brdfpipe.rig.emulator.effects import Effects
from brdfpipe.rig.emulator.illumination import Illumination
from brdfpipe.rig.plan import Plan
from brdfpipe.rig.raw_frame import RawFrame
from brdfpipe.rig.reduction.lamp_monitor import REPEAT_U
from brdfpipe.rig.reduction.relative_light import COMPONENTS, ReductionError
from brdfpipe.rig.templates import start

PLASTIC = "plastic, 10 sr⁻¹, 3°"
WIDE = "milk glass"


def reduced(frames: xr.Dataset, **options: object) -> xr.Dataset:
    return reduce(frames, rig_emulated.plan().rig, **{"incidence": 30.0, **options})


@pytest.fixture(scope="module")
def sample() -> xr.Dataset:
    return reduced(rig_emulated.frames())


# --- what comes out


def test_an_arrangement_is_reduced_to_a_value_and_its_components_in_every_cell(sample):
    vocabulary.validate(sample, "reduced")
    plan = rig_emulated.plan()
    assert dict(sample["signal"].sizes) == {"incidence": 1, "wavelength": 2, "cell": sample.sizes["cell"]}
    assert sample["cell"].values[: len(plan.rig.fibres)].tolist() == [fibre.name for fibre in plan.rig.fibres]
    for name, correlation in COMPONENTS.items():
        assert sample[f"signal_u_{name}"].attrs["correlation"] == correlation
        assert (sample[f"signal_u_{name}"].values[np.isfinite(sample["signal"].values)] >= 0).all()
    assert sample.attrs["load"] == "sample"
    assert sample.attrs["side"] == "reflection"
    assert sample.attrs["day"] == "1970-01-01"
    assert sample.attrs["filter"] == 1
    assert vocabulary.warnings(sample) == vocabulary.warnings(rig_emulated.frames())


def test_the_position_of_picture_and_disc_is_recovered(sample):
    rig = rig_emulated.plan().rig
    true = true_screen(rig, Effects(), 1, 0)
    shift = np.subtract(true.centre, rig.screen.centre)
    assert sample.attrs["registration_shift"] == pytest.approx(shift, abs=4.5 * sample.attrs["registration_u"])
    millimetres = np.radians(sample.attrs["disc_centre_u"]) * true.focal_length
    assert sample.attrs["disc_centre"] == pytest.approx(true.disc_centre, abs=4.5 * millimetres)
    assert sample.attrs["disc_centre_u"] < 0.01


def test_an_ideal_rig_gives_the_brightness_of_each_direction():
    """Without other effects the disc and the fibres are as bright as f cos γ, within the rounding of counts."""
    frames, rig = rig_emulated.frames(WIDE, effects=Effects.none()), rig_emulated.plan().rig
    measured = reduce(frames, replace(rig, camera=replace(rig.camera, read_noise=0.0)), incidence=30.0)
    cosine = specular_directions.cos_view(30.0, measured["theta_s"].values, measured["phi_s"].values)
    theta_o, phi_o = specular_directions.outgoing(30.0, measured["theta_s"].values, measured["phi_s"].values)
    above = cosine > 0.05
    brdf = accuracy.TRUTHS[WIDE]().bsdf.evaluate(30.0, 0.0, theta_o[above], phi_o[above]).values
    seen = brdf * cosine[above]
    signal = measured["signal"].values[0, :, above].T
    # The disc's pixels follow the lens: f² times their solid angle.
    of_disc = measured["kind"].values[above] == "disc"
    lens = np.where(of_disc, np.cos(np.radians(measured["theta_s"].values[above])) ** 3, 1.0)
    ratio = signal / (seen * lens)
    disc = ratio[:, of_disc]
    assert disc / np.median(disc) == pytest.approx(1, abs=2e-3)
    # A fibre's end has less light than its aperture, which counts for all alike.
    fibres = ratio[:, ~of_disc]
    assert fibres / np.median(fibres) == pytest.approx(1, abs=4e-3)
    assert np.median(disc[0]) == pytest.approx(np.median(disc[1]), rel=1e-3)


def test_cells_below_the_horizon_have_no_light(sample):
    cosine = specular_directions.cos_view(30.0, sample["theta_s"].values, sample["phi_s"].values)
    dark = sample["signal"].values[0][:, cosine < -0.05]
    noise = sample["signal_u_noise"].values[0][:, cosine < -0.05]
    # Stray light of 2e-5 sr⁻¹ is less than that.
    assert np.sqrt(np.mean((dark / noise) ** 2)) < 1.5
    assert (np.abs(dark) < 1e-3 * np.nanmedian(sample["signal"].values)).all()


def test_the_share_of_light_in_the_halo_is_estimated(sample):
    # Of 0.5 % a third falls beyond the picture's half width, or passes for even light.
    assert 0.002 < sample.attrs["glare_share"] < 0.006


def test_glare_that_too_few_pixels_show_is_not_subtracted_and_a_warning_says_so():
    plan = accuracy.plan_of((550.0,), (30.0,), fibres=40)
    screen_ = replace(plan.rig.screen, disc_radius=62.0, reference_centre=(52.0, 38.0))
    rig = replace(plan.rig, screen=screen_, fibres=plan.rig.fibres[:1])
    plan = replace(plan, rig=rig, etalon_entrances=(10.0,), runs=("sample",))
    measured = reduce(accuracy.frames_of(plan, accuracy.TRUTHS[WIDE](), seed=1), rig, incidence=30.0, override=True)
    assert np.isnan(measured.attrs["glare_share"])
    assert any("glare was not subtracted" in warning for warning in vocabulary.warnings(measured))


def test_filters_in_both_beams_divide_out():
    """The position of the filters is taken from the description, and divides out either way."""
    frames = rig_emulated.frames(of="reference")
    rig = replace(rig_emulated.plan().rig, nd_location="reference")
    both = reduce(frames, rig, incidence=30.0)
    alone = reduced(rig_emulated.frames())
    bright = np.nan_to_num(alone["signal"].values) > 1e-3 * float(np.nanmax(alone["signal"].values))
    u = np.hypot(both["signal_u_noise"].values, alone["signal_u_noise"].values)[bright]
    signal = both["signal"].values[bright], alone["signal"].values[bright]
    assert np.abs(signal[0] / signal[1] - 1).max() < 0.03
    assert np.median(np.abs(signal[0] - signal[1]) / np.hypot(u, 3e-3 * signal[1])) < 1.5
    assert both["signal_u_nd"].values[np.isfinite(both["signal"].values)].max() == 0


# --- what is missing or wrong


def test_frames_of_another_rig_are_refused():
    other = replace(rig_emulated.plan().rig, digest="another")
    with pytest.raises(ReductionError, match="another rig"):
        reduce(rig_emulated.frames(), other, incidence=30.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"incidence": 45.0}, "no frame of the sample in reflection at 45 degree"),
        ({"side": "transmission"}, "no frame of the sample in transmission"),
        ({"incidence": None}, "several incidences"),
        ({"load": "mirror"}, "no frame of the mirror"),
    ],
)
def test_an_arrangement_that_was_not_measured_is_refused(options, words):
    with pytest.raises(ReductionError, match=words):
        reduced(rig_emulated.frames(), **options)


def test_a_wrong_nd_location_is_refused_unless_overridden():
    wrong = replace(rig_emulated.plan().rig, nd_location="reference")
    with pytest.raises(ReductionError, match=r"nd_location: sample"):
        reduce(rig_emulated.frames(), wrong, incidence=30.0)
    warnings = vocabulary.warnings(reduce(rig_emulated.frames(), wrong, incidence=30.0, override=True))
    assert any("wrong `nd_location: " in warning for warning in warnings)


def test_a_missing_dark_frame_is_refused():
    with pytest.raises(BrdfpipeError, match="no dark frame of 10 s"):
        reduced(rig_emulated.without(rig_emulated.frames(), purpose="dark", exposure=10.0))


def test_too_few_dark_frames_give_a_warning_and_their_noise_counts():
    frames = rig_emulated.frames()
    dark = np.flatnonzero((frames["purpose"].values == "dark") & (frames["exposure"].values == 10.0))
    few = reduced(frames.isel(frame=np.setdiff1d(np.arange(frames.sizes["frame"]), dark[1:])))
    assert any("dark frames of 10 s: only 1" in warning for warning in vocabulary.warnings(few))
    # One dark frame is as noisy as that of the light; of ten a tenth is left. The light has other frames besides.
    faint = specular_directions.cos_view(30.0, few["theta_s"].values, few["phi_s"].values) < -0.05
    noise = few["signal_u_noise"].values[0][:, faint] / reduced(frames)["signal_u_noise"].values[0][:, faint]
    assert 1.2 < np.median(noise) < np.sqrt(2 / 1.1)


def test_a_frame_out_of_the_linear_range_is_named_and_not_used(sample):
    frames = rig_emulated.frames().copy(deep=True)
    own = (
        (frames["purpose"].values == "sample") & (frames["incidence"].values == 30) & (frames["exposure"].values == 10)
    )
    place = int(np.flatnonzero(own)[0])
    frames["counts"][place] = 65535
    measured = reduced(frames)
    shot = int(frames["shot"].values[place])
    assert any(
        f"Frame {shot} (470 nm) exceeds the camera's linear range everywhere" in warning
        for warning in vocabulary.warnings(measured)
    )
    both = np.isfinite(measured["signal"].values) & np.isfinite(sample["signal"].values)
    u = np.sqrt(sum(measured[f"signal_u_{name}"].values ** 2 for name in COMPONENTS))
    assert np.median(np.abs(measured["signal"].values - sample["signal"].values)[both] / u[both]) < 1
    # Less light, more noise, at that wavelength alone; the disc is bright enough for shorter exposures.
    ratio = (measured["signal_u_noise"] / sample["signal_u_noise"]).values[0]
    faint = measured["kind"].values == "fibre"
    assert np.nanmedian(ratio[0, faint]) > 1.5
    assert np.nanmedian(ratio[1, faint]) == pytest.approx(1, abs=0.01)


def darken(frames: xr.Dataset, own: np.ndarray) -> None:
    """Make frames dark ones, each with a noise of its own."""
    dark = frames["counts"].values[frames["purpose"].values == "dark"][-1]
    noise = np.random.default_rng(1).integers(0, 4, (np.count_nonzero(own), *dark.shape), dtype=np.uint16)
    frames["counts"].values[own] = dark + noise


def test_a_wavelength_without_light_is_named_and_left_missing():
    frames = rig_emulated.frames().copy(deep=True)
    own = (frames["purpose"].values == "sample") & (frames["wavelength"].values == 470)
    darken(frames, own)
    measured = reduced(frames)
    assert np.isnan(measured["signal"].values[0, 0]).all()
    assert np.isnan(measured["reference"].values[0, 0])
    assert np.isfinite(measured["signal"].values[0, 1]).sum() > 300
    assert any(
        "1 of 2 wavelengths have no values" in warning and "470 nm" in warning
        for warning in vocabulary.warnings(measured)
    )


def test_no_light_at_all_is_refused():
    frames = rig_emulated.frames().copy(deep=True)
    darken(frames, frames["purpose"].values == "sample")
    with pytest.raises(ReductionError, match="in every frame"):
        reduced(frames)


def test_a_bracket_with_a_missing_frame_is_reduced_from_the_others(sample):
    frames = rig_emulated.without(rig_emulated.frames(), purpose="sample", wavelength=550.0, exposure=10.0)
    measured = reduced(frames)
    u = np.sqrt(sum(measured[f"signal_u_{name}"].values ** 2 for name in COMPONENTS))
    both = np.isfinite(measured["signal"].values) & np.isfinite(sample["signal"].values)
    assert np.abs((measured["signal"].values - sample["signal"].values)[both] / u[both]).max() < 6


def test_cells_saturated_in_every_frame_are_missing_and_flagged():
    frames = rig_emulated.frames()
    long = frames.isel(frame=~((frames["purpose"].values == "sample") & (frames["nd_position"].values != 1)))
    measured = reduced(long)
    quality = measured["signal_quality"].values[0]
    saturated = quality == vocabulary.quality("saturated")
    middle = measured["theta_s"].values < 3
    assert saturated[:, middle & (measured["kind"].values == "disc")].all()
    assert np.isnan(measured["signal"].values[0][saturated]).all()
    assert any(f"Up to {saturated.sum(axis=1).max()} cells" in warning for warning in vocabulary.warnings(measured))
    assert np.isfinite(measured["signal"].values[0][:, measured["theta_s"].values > 30]).mean() > 0.9


def test_without_a_target_the_mirror_direction_is_as_uncertain_as_described(sample):
    measured = reduced(rig_emulated.without(rig_emulated.frames(), purpose="target"))
    assert measured.attrs["disc_centre"] == list(rig_emulated.plan().rig.screen.disc_centre)
    assert measured.attrs["disc_centre_u"] == 0.1
    flank = (measured["theta_s"].values > 3) & (measured["theta_s"].values < 6) & (measured["kind"].values == "disc")
    share = (measured["signal_u_geometry"] / measured["signal"]).values[0][:, flank]
    # A Gaussian of 3 degree falls by θ/σ² of itself a degree: 0.1 degree are 5 %.
    assert np.median(share) == pytest.approx(0.1 * 4.5 / 9, rel=0.3)


def test_the_target_may_be_of_another_run(sample):
    own = rig_emulated.frames()
    target = own.isel(frame=np.isin(own["purpose"].values, ("target", "dark")))
    measured = reduced(rig_emulated.without(own, purpose="target"), target=target)
    assert measured.attrs["disc_centre"] == pytest.approx(sample.attrs["disc_centre"], abs=1e-6)


def test_a_sample_too_dark_to_register_is_registered_by_the_etalon_of_its_session():
    frames = rig_emulated.frames().copy(deep=True)
    own = np.flatnonzero(frames["purpose"].values == "sample")
    rows, columns = np.mgrid[:240, :320]
    centre = screen.to_pixel(rig_emulated.plan().rig.screen, *rig_emulated.plan().rig.screen.reference_centre)
    away = np.hypot(columns - centre[0], rows - centre[1]) > 15
    dark = frames["counts"].values[frames["purpose"].values == "dark"]
    random = np.random.default_rng(0)
    for place in own:
        frames["counts"][place] = np.where(away, dark[random.integers(len(dark))], frames["counts"].values[place])
    measured = reduced(frames)
    true = true_screen(rig_emulated.plan().rig, Effects(), 1, 0)
    assert measured.attrs["registration_spots"] < 12
    shift = np.subtract(true.centre, rig_emulated.plan().rig.screen.centre)
    assert measured.attrs["registration_shift"] == pytest.approx(shift, abs=0.1)


def test_a_black_sample_is_black_to_within_its_noise():
    plan = accuracy.plan_of((550.0,), (30.0,), fibres=40)
    plan = replace(plan, etalon_entrances=(10.0,), runs=("target", "sample"))
    measured = reduce(accuracy.frames_of(plan, None, seed=1), plan.rig, incidence=30.0)
    u = np.hypot(measured["signal_u_noise"].values, measured["signal_u_glare"].values)
    assert np.sqrt(np.nanmean((measured["signal"].values / u) ** 2)) < 1.5
    quality = measured["signal_quality"].values
    assert (quality == vocabulary.quality("below_noise")).mean() > 0.8
    assert measured.attrs["disc_centre_u"] < 0.02


def test_repeatability_is_the_scatter_of_the_monitor_readings():
    """One frame repeated several times, its light over the reference changing by 2 %."""
    frames = rig_emulated.frames().copy(deep=True)
    own = np.flatnonzero((frames["purpose"].values == "sample") & (frames["incidence"].values == 30.0))
    base = own[2]
    rows, columns = np.mgrid[:240, :320]
    centre = screen.to_pixel(rig_emulated.plan().rig.screen, *rig_emulated.plan().rig.screen.reference_centre)
    away = np.hypot(columns - centre[0], rows - centre[1]) > 15
    readings = []
    for number, factor in enumerate((1.001, 1.02, 0.98, 1.03, 0.97)):  # an identical frame is left out
        reading = frames.isel(frame=[base]).copy(deep=True)
        light = reading["counts"].values[0].astype(float) - 100
        reading["counts"][0] = np.rint(np.where(away, factor * light, light) + 100).astype(np.uint16)
        readings.append(
            reading.assign_coords(
                purpose=("frame", ["drift"]), shot=("frame", [frames["shot"].values[own[0]] + number])
            )
        )
    measured = reduced(xr.concat([rig_emulated.without(frames, purpose="drift"), *readings], "frame"))
    repeat = (measured["signal_u_repeat"] / np.abs(measured["signal"])).values
    assert np.nanmax(repeat) == pytest.approx(np.nanmin(repeat))
    # The frame of the bracket that the readings repeat is one of them.
    seen = np.std([1.0, 1.001, 1.02, 0.98, 1.03, 0.97], ddof=1)
    assert np.nanmax(repeat) == pytest.approx(np.sqrt((5 * seen**2 + REPEAT_U**2) / 6), rel=0.05)


def _repeat_of(frames: xr.Dataset, **options: object) -> tuple[float, list[str]]:
    measured = reduced(frames, **options)
    relative = (measured["signal_u_repeat"] / np.abs(measured["signal"])).values
    warnings = [text for text in vocabulary.warnings(measured) if "Lamp repeatability is uncertain" in text]
    return float(np.nanmax(relative)), warnings


def test_monitor_readings_of_all_arrangements_count_for_the_repeatability():
    """The sample's last reading, through the other entrance, is 5 % brighter than the frames it repeats; the assumption counts once."""
    frames = rig_emulated.frames()
    readings = np.flatnonzero(frames["purpose"].values == "drift")
    arrangements = list(zip(frames["load"].values[readings], frames["incidence"].values[readings], strict=True))
    # Each group of readings repeats a frame of its bracket.
    count = arrangements.count(arrangements[-1]) + 1
    # The spots of the target are too dim to count.
    freedom = len([load for load, _ in arrangements if load != "target"])
    assert len(set(arrangements)) > 2
    steady, warnings = _repeat_of(frames, incidence=10.0)
    assert not warnings
    assert steady < 1.5 * REPEAT_U / np.sqrt(freedom + 1)
    centre = screen.to_pixel(rig_emulated.plan().rig.screen, *rig_emulated.plan().rig.screen.reference_centre)
    rows, columns = np.mgrid[:240, :320]
    away = np.hypot(columns - centre[0], rows - centre[1]) > 15
    bright = frames.copy(deep=True)
    counts = bright["counts"].values[readings[-1]].astype(float)
    bright["counts"][readings[-1]] = np.rint(np.where(away, 100 + 1.05 * (counts - 100), counts)).astype(np.uint16)
    wobble, warnings = _repeat_of(bright, incidence=10.0)
    assert not warnings
    scatter = 0.05**2 * (count - 1) / count
    assert wobble == pytest.approx(np.sqrt((scatter + REPEAT_U**2) / (freedom + 1)), rel=0.1)


def test_without_usable_monitor_readings_the_assumed_repeatability_is_stated():
    frames = rig_emulated.frames()
    without = rig_emulated.without(frames, purpose="drift")
    dim = frames.copy(deep=True)
    dark = frames["counts"].values[(frames["purpose"].values == "dark") & (frames["exposure"].values == 2.0)][0]
    for place in np.flatnonzero(frames["purpose"].values == "drift"):
        dim["counts"][place] = dark
    for some in (without, dim):
        repeat, warnings = _repeat_of(some)
        assert repeat == pytest.approx(REPEAT_U)
        assert len(warnings) == 1
        assert "`drift.every`" in warnings[0]


# --- the lamp


def test_monitor_readings_and_brackets_follow_the_lamp():
    """The drift of the emulated lamp is known: reference light over it is constant within noise."""
    effects = Effects(warm_up=0.5)
    frames, plan = rig_emulated.frames(effects=effects), rig_emulated.plan()
    lamp = Illumination(plan.rig, effects, 1, 0).lamp
    z = {wavelength: [] for wavelength in rig_emulated.WAVELENGTHS}
    for incidence in rig_emulated.INCIDENCES:
        measured = reduced(frames, incidence=incidence)
        readings = frames.isel(frame=(frames["purpose"].values == "drift") & (frames["incidence"].values == incidence))
        assert measured["drift_elapsed"].values.tolist() == readings["elapsed"].values.tolist() != []
        assert (measured["drift_wavelength"].values == plan.drift.wavelength).all()
        for place, wavelength in enumerate(rig_emulated.WAVELENGTHS):
            z[wavelength] += [[measured[name].values[0, place] for name in ("elapsed", "reference", "reference_u")]]
        z[plan.drift.wavelength] += np.transpose(
            [measured[f"drift_{name}"].values for name in ("elapsed", "reference", "reference_u")]
        ).tolist()
    for readings in z.values():
        time, light, u = np.array(readings).T
        assert np.ptp(lamp(time)) > 4 * np.median(u / light)
        level = light / lamp(time)
        mean = np.average(level, weights=(light / u) ** 2)
        assert np.abs((level / mean - 1) / (u / light)).max() < 4


def test_filters_before_the_reference_add_their_uncertainty_to_the_lamp():
    rig = replace(rig_emulated.plan().rig, nd_location="reference")
    both = reduce(rig_emulated.frames(of="reference"), rig, incidence=30.0)
    relative = (both["reference_u"] / both["reference"]).values
    # Of the four frames two are behind filters known to 2 %.
    assert relative.max() < 0.02
    assert relative.min() > 0.02 * np.sqrt(2) / 4 * 0.95


def test_an_entrance_without_monitor_readings_has_no_drift_variables(sample):
    measured = reduced(rig_emulated.without(rig_emulated.frames(), purpose="drift").assign_attrs(drift_tolerance=0.05))
    assert measured.attrs["drift_tolerance"] == 0.05
    assert not [name for name in measured.variables if str(name).startswith("drift_")]
    assert measured["reference"].values == pytest.approx(sample["reference"].values)
    assert measured["elapsed"].values == pytest.approx(sample["elapsed"].values)


# --- from files

PLAN = """\
rig: rig.yaml
sample: tile
incidences: [10]
wavelengths: [470, 550]
bracket:
  - {exposure: 2, position: 3}
  - {exposure: 2, position: 2}
  - {exposure: 2, position: 1}
  - {exposure: 10, position: 1}
runs: [sample]
"""


@pytest.fixture
def run(tmp_path):
    """The folder of a finished run, and its plan."""
    (start(tmp_path, fibres=40)).write_text(PLAN)
    plan = Plan.load(tmp_path / "plan.yaml")
    taken = accuracy.frames_of(plan, accuracy.TRUTHS[PLASTIC](), seed=2)
    (tmp_path / "frames").mkdir()
    for place, shot in enumerate(plan.shots):
        picture = RawFrame(taken["counts"].values[place], float(taken["elapsed"].values[place]), shot.exposure, 20.0)
        state = frame_file.DeviceState(shot.wavelength, shot.position)
        options = {"state": state, "run_start": 0.0, "camera": "emulated camera"}
        frame_file.write_frame(tmp_path / "frames" / shot.name, picture, shot, plan, **options)
    return tmp_path, plan


def frame_of(plan: Plan, wavelength: float, exposure: float, position: int) -> str:
    wanted = ("sample", wavelength, exposure, position)
    return next(
        shot.name for shot in plan.shots if (shot.purpose, shot.wavelength, shot.exposure, shot.position) == wanted
    )


def spoil(path, how: str, other=None) -> None:
    content = bytearray(path.read_bytes())
    if how == "cut off":
        content = content[: len(content) // 2]
    elif how == "a bit turned":
        content[-40_000] ^= 8
    elif how == "of another wavelength":
        content = bytearray(other.read_bytes())
    elif how == "gone":
        return path.unlink()
    path.write_bytes(bytes(content))


@pytest.mark.cases(2)
@pytest.mark.parametrize("how", ["cut off", "a bit turned", "of another wavelength", "gone"])
def test_a_corrupt_file_is_named_and_the_other_frames_are_used(run, how):
    folder, plan = run
    whole = reduce(files.read_run(folder), plan.rig)
    name = frame_of(plan, 470.0, 10.0, 1)
    spoil(folder / "frames" / name, how, folder / "frames" / frame_of(plan, 550.0, 10.0, 1))
    measured = reduce(files.read_run(folder), plan.rig)
    warnings = " ".join(vocabulary.warnings(measured))
    assert name in warnings or how == "gone"
    assert "bracket step 4 is missing at 1 of" in warnings
    assert "(sample: 470 nm)" in warnings
    u = np.sqrt(sum(measured[f"signal_u_{component}"].values ** 2 for component in COMPONENTS))
    error = np.abs(measured["signal"].values - whole["signal"].values) / u
    assert np.nanmax(error) < 6
    assert np.isfinite(measured["signal"].values).sum() == np.isfinite(whole["signal"].values).sum()


def test_a_run_without_its_dark_frames_is_refused(run):
    folder, plan = run
    for path in (folder / "frames").glob("*-dark-*"):
        spoil(path, "cut off")
    with pytest.raises(BrdfpipeError, match="no dark frame of"):
        reduce(files.read_run(folder), plan.rig)


def test_an_arrangement_without_a_frame_is_refused_with_the_lost_files_and_the_remedy(run):
    folder, plan = run
    for path in (folder / "frames").glob("*-sample-*"):
        spoil(path, "cut off")
    with pytest.raises(ReductionError, match="no frame of the sample in reflection at 10 degree") as refusal:
        reduce(files.read_run(folder, 10.0), plan.rig, incidence=10.0)
    assert "bracket step 1 is missing at 2 of 2 wavelengths at 10 degree" in str(refusal.value)
    assert "take them again with `brdfpipe rig scan … --resume`" in str(refusal.value)
    assert frame_of(plan, 550.0, 10.0, 1) in str(refusal.value)
    assert "come from the rig emulator" not in str(refusal.value)
