"""From emulated frames to the light of each cell, against what the emulator was told; and what must be refused or named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import rig_accuracy as accuracy
import rig_emulated
import xarray as xr

from brdfpipe import specular_directions, vocabulary
from brdfpipe.errors import BrdfpipeError
from brdfpipe.rig import frames as files
from brdfpipe.rig import reduce, screen
from brdfpipe.rig.acquisition.devices.camera import Picture
from brdfpipe.rig.emulator.effects import Effects
from brdfpipe.rig.emulator.measurement import black
from brdfpipe.rig.emulator.source import Source
from brdfpipe.rig.emulator.view import true_screen
from brdfpipe.rig.plan import Plan
from brdfpipe.rig.reduction.relative_light import COMPONENTS, REPEAT_U, ReductionError
from brdfpipe.rig.templates import start

PLASTIC = "plastic, 10 sr⁻¹, 3°"
WIDE = "milk glass"


def reduced(frames: xr.Dataset, **told: object) -> xr.Dataset:
    return reduce(frames, rig_emulated.plan().rig, **{"incidence": 30.0, **told})


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


def test_the_picture_and_the_disc_are_found_where_they_are(sample):
    rig = rig_emulated.plan().rig
    true = true_screen(rig, Effects(), 1, 0)
    shift = np.subtract(true.centre, rig.screen.centre)
    assert sample.attrs["registration_shift"] == pytest.approx(shift, abs=4.5 * sample.attrs["registration_u"])
    millimetres = np.radians(sample.attrs["disc_centre_u"]) * true.focal_length
    assert sample.attrs["disc_centre"] == pytest.approx(true.disc, abs=4.5 * millimetres)
    assert sample.attrs["disc_centre_u"] < 0.01


def test_an_ideal_rig_gives_the_brightness_of_each_direction():
    """Nothing but geometry: the disc is as bright as f cos γ, the fibres too, to the rounding of counts."""
    frames = rig_emulated.frames(WIDE, effects=Effects.none())
    found = reduced(frames)
    cosine = specular_directions.cos_view(30.0, found["theta_s"].values, found["phi_s"].values)
    theta_o, phi_o = specular_directions.outgoing(30.0, found["theta_s"].values, found["phi_s"].values)
    above = cosine > 0.05
    brdf = accuracy.TRUTHS[WIDE]().bsdf.evaluate(30.0, 0.0, theta_o[above], phi_o[above]).values
    seen = brdf * cosine[above]
    signal = found["signal"].values[0, :, above].T
    # The disc's pixels follow the lens: f² times their solid angle.
    of_disc = found["kind"].values[above] == "disc"
    lens = np.where(of_disc, np.cos(np.radians(found["theta_s"].values[above])) ** 3, 1.0)
    ratio = signal / (seen * lens)
    disc = ratio[:, of_disc]
    assert disc / np.median(disc) == pytest.approx(1, abs=2e-3)
    # A fibre's end has less light than its aperture, which counts for all alike.
    fibres = ratio[:, ~of_disc]
    assert fibres / np.median(fibres) == pytest.approx(1, abs=4e-3)
    assert np.median(disc[0]) == pytest.approx(np.median(disc[1]), rel=1e-3)


def test_cells_below_the_horizon_hold_nothing(sample):
    cosine = specular_directions.cos_view(30.0, sample["theta_s"].values, sample["phi_s"].values)
    dark = sample["signal"].values[0][:, cosine < -0.05]
    noise = sample["signal_u_noise"].values[0][:, cosine < -0.05]
    # Stray light of 2e-5 sr⁻¹ is less than that.
    assert np.sqrt(np.mean((dark / noise) ** 2)) < 1.5
    assert (np.abs(dark) < 1e-3 * np.nanmedian(sample["signal"].values)).all()


def test_the_share_of_light_in_the_halo_is_told(sample):
    # Of 0.5 % a third falls beyond the picture's half width, or passes for even light.
    assert 0.002 < sample.attrs["glare_share"] < 0.006


def test_a_picture_without_room_between_the_cells_says_that_its_glare_is_not_removed():
    plan = accuracy.plan_of((550.0,), (30.0,), fibres=40)
    screen_ = replace(plan.rig.screen, disc_radius=62.0, reference=(52.0, 38.0))
    rig = replace(plan.rig, screen=screen_, fibres=plan.rig.fibres[:1])
    plan = replace(plan, rig=rig, etalon_entrances=(10.0,), runs=("sample",))
    found = reduce(accuracy.frames_of(plan, accuracy.TRUTHS[WIDE](), seed=1), rig, incidence=30.0, override=True)
    assert np.isnan(found.attrs["glare_share"])
    assert any("glare was not removed" in warning for warning in vocabulary.warnings(found))


def test_filters_in_both_beams_change_nothing_that_matters():
    """What the description says of the filters' place is believed, and divides out either way."""
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
    ("told", "words"),
    [
        ({"incidence": 45.0}, "no frame of the sample in reflection at 45 degree"),
        ({"side": "transmission"}, "no frame of the sample in transmission"),
        ({"incidence": None}, "several incidences"),
        ({"load": "mirror"}, "no frame of the mirror"),
    ],
)
def test_an_arrangement_that_was_not_measured_is_refused(told, words):
    with pytest.raises(ReductionError, match=words):
        reduced(rig_emulated.frames(), **told)


def test_filters_that_stand_elsewhere_than_described_are_named_and_refused_unless_overridden():
    wrong = replace(rig_emulated.plan().rig, nd_location="reference")
    with pytest.raises(ReductionError, match=r"nd_location: sample"):
        reduce(rig_emulated.frames(), wrong, incidence=30.0)
    told = vocabulary.warnings(reduce(rig_emulated.frames(), wrong, incidence=30.0, override=True))
    assert any("neutral filters are not where the description says" in warning for warning in told)


def test_without_dark_frames_of_an_exposure_nothing_is_reduced():
    with pytest.raises(BrdfpipeError, match="no dark frame of 10 s"):
        reduced(rig_emulated.without(rig_emulated.frames(), purpose="dark", exposure=10.0))


def test_few_dark_frames_are_named_and_their_noise_is_counted():
    frames = rig_emulated.frames()
    dark = np.flatnonzero((frames["purpose"].values == "dark") & (frames["exposure"].values == 10.0))
    few = reduced(frames.isel(frame=np.setdiff1d(np.arange(frames.sizes["frame"]), dark[1:])))
    assert any("dark frames of 10 s: only 1" in warning for warning in vocabulary.warnings(few))
    # One dark frame is as noisy as that of the light; of ten a tenth is left. The light has other frames besides.
    faint = specular_directions.cos_view(30.0, few["theta_s"].values, few["phi_s"].values) < -0.05
    noise = few["signal_u_noise"].values[0][:, faint] / reduced(frames)["signal_u_noise"].values[0][:, faint]
    assert 1.2 < np.median(noise) < np.sqrt(2 / 1.1)


def test_a_frame_beyond_the_range_everywhere_is_named_and_counts_for_nothing(sample):
    frames = rig_emulated.frames().copy(deep=True)
    own = (
        (frames["purpose"].values == "sample") & (frames["incidence"].values == 30) & (frames["exposure"].values == 10)
    )
    place = int(np.flatnonzero(own)[0])
    frames["counts"][place] = 65535
    found = reduced(frames)
    shot = int(frames["shot"].values[place])
    assert any(
        f"frame {shot} (470 nm) is beyond the linear range everywhere" in each for each in vocabulary.warnings(found)
    )
    both = np.isfinite(found["signal"].values) & np.isfinite(sample["signal"].values)
    u = np.sqrt(sum(found[f"signal_u_{name}"].values ** 2 for name in COMPONENTS))
    assert np.median(np.abs(found["signal"].values - sample["signal"].values)[both] / u[both]) < 1
    # Less light, more noise, at that wavelength alone; the disc is bright enough for shorter exposures.
    ratio = (found["signal_u_noise"] / sample["signal_u_noise"]).values[0]
    faint = found["kind"].values == "fibre"
    assert np.nanmedian(ratio[0, faint]) > 1.5
    assert np.nanmedian(ratio[1, faint]) == pytest.approx(1, abs=0.01)


def test_a_wavelength_without_light_is_named_and_left_missing():
    frames = rig_emulated.frames().copy(deep=True)
    dark = frames["counts"].values[frames["purpose"].values == "dark"][-1]
    own = (frames["purpose"].values == "sample") & (frames["wavelength"].values == 470)
    frames["counts"][np.flatnonzero(own)] = dark
    found = reduced(frames)
    assert np.isnan(found["signal"].values[0, 0]).all()
    assert np.isnan(found["reference"].values[0, 0])
    assert np.isfinite(found["signal"].values[0, 1]).sum() > 300
    assert any("1 of 2 wavelengths have no values" in each and "470 nm" in each for each in vocabulary.warnings(found))


def test_no_light_at_all_is_refused():
    frames = rig_emulated.frames().copy(deep=True)
    dark = frames["counts"].values[frames["purpose"].values == "dark"][-1]
    frames["counts"][np.flatnonzero(frames["purpose"].values == "sample")] = dark
    with pytest.raises(ReductionError, match="in every frame"):
        reduced(frames)


def test_a_bracket_with_a_missing_frame_is_reduced_from_the_others(sample):
    frames = rig_emulated.without(rig_emulated.frames(), purpose="sample", wavelength=550.0, exposure=10.0)
    found = reduced(frames)
    u = np.sqrt(sum(found[f"signal_u_{name}"].values ** 2 for name in COMPONENTS))
    both = np.isfinite(found["signal"].values) & np.isfinite(sample["signal"].values)
    assert np.abs((found["signal"].values - sample["signal"].values)[both] / u[both]).max() < 6


def test_what_is_too_bright_for_every_frame_is_missing_and_says_why():
    frames = rig_emulated.frames()
    long = frames.isel(frame=~((frames["purpose"].values == "sample") & (frames["nd_position"].values != 1)))
    found = reduced(long)
    quality = found["signal_quality"].values[0]
    saturated = quality == vocabulary.quality("saturated")
    middle = found["theta_s"].values < 3
    assert saturated[:, middle & (found["kind"].values == "disc")].all()
    assert np.isnan(found["signal"].values[0][saturated]).all()
    assert any(f"up to {saturated.sum(axis=1).max()} cells" in warning for warning in vocabulary.warnings(found))
    assert np.isfinite(found["signal"].values[0][:, found["theta_s"].values > 30]).mean() > 0.9


def test_without_a_target_the_mirror_direction_is_as_uncertain_as_described(sample):
    found = reduced(rig_emulated.without(rig_emulated.frames(), purpose="target"))
    assert found.attrs["disc_centre"] == list(rig_emulated.plan().rig.screen.disc)
    assert found.attrs["disc_centre_u"] == 0.1
    flank = (found["theta_s"].values > 3) & (found["theta_s"].values < 6) & (found["kind"].values == "disc")
    share = (found["signal_u_geometry"] / found["signal"]).values[0][:, flank]
    # A Gaussian of 3 degree falls by θ/σ² of itself a degree: 0.1 degree are 5 %.
    assert np.median(share) == pytest.approx(0.1 * 4.5 / 9, rel=0.3)


def test_a_target_of_another_run_serves_as_well(sample):
    own = rig_emulated.frames()
    target = own.isel(frame=np.isin(own["purpose"].values, ("target", "dark")))
    found = reduced(rig_emulated.without(own, purpose="target"), target=target)
    assert found.attrs["disc_centre"] == pytest.approx(sample.attrs["disc_centre"], abs=1e-6)


def test_a_sample_too_dark_to_register_goes_by_the_etalon_of_its_session():
    frames = rig_emulated.frames().copy(deep=True)
    own = np.flatnonzero(frames["purpose"].values == "sample")
    rows, columns = np.mgrid[:240, :320]
    centre = screen.to_pixel(rig_emulated.plan().rig.screen, *rig_emulated.plan().rig.screen.reference)
    away = np.hypot(columns - centre[0], rows - centre[1]) > 15
    dark = frames["counts"].values[frames["purpose"].values == "dark"]
    random = np.random.default_rng(0)
    for place in own:
        frames["counts"][place] = np.where(away, dark[random.integers(len(dark))], frames["counts"].values[place])
    found = reduced(frames)
    true = true_screen(rig_emulated.plan().rig, Effects(), 1, 0)
    assert found.attrs["registration_spots"] < 12
    shift = np.subtract(true.centre, rig_emulated.plan().rig.screen.centre)
    assert found.attrs["registration_shift"] == pytest.approx(shift, abs=0.1)


def test_a_black_sample_is_black_to_within_its_noise():
    plan = accuracy.plan_of((550.0,), (30.0,), fibres=40)
    plan = replace(plan, etalon_entrances=(10.0,), runs=("target", "sample"))
    found = reduce(accuracy.frames_of(plan, black(), seed=1), plan.rig, incidence=30.0)
    u = np.hypot(found["signal_u_noise"].values, found["signal_u_glare"].values)
    assert np.sqrt(np.nanmean((found["signal"].values / u) ** 2)) < 1.5
    quality = found["signal_quality"].values
    assert (quality == vocabulary.quality("below_noise")).mean() > 0.8
    assert found.attrs["disc_centre_u"] < 0.02


def test_a_rig_that_wobbles_between_looks_at_the_lamp_says_so():
    """The same state looked at again and again, its light over the reference changing by 2 %."""
    frames = rig_emulated.frames().copy(deep=True)
    own = np.flatnonzero((frames["purpose"].values == "sample") & (frames["incidence"].values == 30.0))
    base = own[2]
    rows, columns = np.mgrid[:240, :320]
    centre = screen.to_pixel(rig_emulated.plan().rig.screen, *rig_emulated.plan().rig.screen.reference)
    away = np.hypot(columns - centre[0], rows - centre[1]) > 15
    looks = []
    for number, factor in enumerate((1.0, 1.02, 0.98, 1.03, 0.97)):
        look = frames.isel(frame=[base]).copy(deep=True)
        light = look["counts"].values[0].astype(float) - 100
        look["counts"][0] = np.rint(np.where(away, factor * light, light) + 100).astype(np.uint16)
        looks.append(
            look.assign_coords(purpose=("frame", ["drift"]), shot=("frame", [frames["shot"].values[own[0]] + number]))
        )
    found = reduced(xr.concat([rig_emulated.without(frames, purpose="drift"), *looks], "frame"))
    repeat = (found["signal_u_repeat"] / np.abs(found["signal"])).values
    assert np.nanmax(repeat) == pytest.approx(np.nanmin(repeat))
    # The frame of the bracket that the looks repeat is one of them.
    seen = np.std([1.0, 1.0, 1.02, 0.98, 1.03, 0.97], ddof=1)
    assert np.nanmax(repeat) == pytest.approx(np.sqrt((5 * seen**2 + REPEAT_U**2) / 6), rel=0.05)


def _repeat_of(frames: xr.Dataset, **told: object) -> tuple[float, list[str]]:
    found = reduced(frames, **told)
    relative = (found["signal_u_repeat"] / np.abs(found["signal"])).values
    told = [text for text in vocabulary.warnings(found) if "how well the light repeats over its reference" in text]
    return float(np.nanmax(relative)), told


def test_looks_of_all_arrangements_tell_how_well_the_rig_repeats_itself():
    """Light of the sample's last look, through the other entrance, 5 % brighter than the frames it repeats; what is expected counts once."""
    frames = rig_emulated.frames()
    looks = np.flatnonzero(frames["purpose"].values == "drift")
    arrangements = list(zip(frames["load"].values[looks], frames["incidence"].values[looks], strict=True))
    # Each group of looks has the frame of its bracket beside.
    count = arrangements.count(arrangements[-1]) + 1
    # The spots of the target are too dim to tell.
    freedom = len([load for load, _ in arrangements if load != "target"])
    assert len(set(arrangements)) > 2
    steady, told = _repeat_of(frames, incidence=10.0)
    assert not told
    assert steady < 1.5 * REPEAT_U / np.sqrt(freedom + 1)
    centre = screen.to_pixel(rig_emulated.plan().rig.screen, *rig_emulated.plan().rig.screen.reference)
    rows, columns = np.mgrid[:240, :320]
    away = np.hypot(columns - centre[0], rows - centre[1]) > 15
    bright = frames.copy(deep=True)
    counts = bright["counts"].values[looks[-1]].astype(float)
    bright["counts"][looks[-1]] = np.rint(np.where(away, 100 + 1.05 * (counts - 100), counts)).astype(np.uint16)
    wobble, told = _repeat_of(bright, incidence=10.0)
    assert not told
    scatter = 0.05**2 * (count - 1) / count
    assert wobble == pytest.approx(np.sqrt((scatter + REPEAT_U**2) / (freedom + 1)), rel=0.1)


def test_a_rig_that_cannot_tell_how_well_it_repeats_itself_states_what_is_assumed():
    frames = rig_emulated.frames()
    without = rig_emulated.without(frames, purpose="drift")
    dim = frames.copy(deep=True)
    dark = frames["counts"].values[(frames["purpose"].values == "dark") & (frames["exposure"].values == 2.0)][0]
    for place in np.flatnonzero(frames["purpose"].values == "drift"):
        dim["counts"][place] = dark
    for each in (without, dim):
        repeat, told = _repeat_of(each)
        assert repeat == pytest.approx(REPEAT_U)
        assert len(told) == 1
        assert "`drift.every`" in told[0]


# --- the lamp


def test_looks_and_brackets_tell_of_the_lamp_as_it_was():
    """The emulated lamp is known, its warming up and its wandering: light over it is the same at all times, but for noise."""
    effects = Effects(warm_up=0.5)
    frames, plan = rig_emulated.frames(effects=effects), rig_emulated.plan()
    lamp = Source(plan.rig, effects, 1, 0).lamp
    z = {wavelength: [] for wavelength in rig_emulated.WAVELENGTHS}
    for incidence in rig_emulated.INCIDENCES:
        found = reduced(frames, incidence=incidence)
        looks = frames.isel(frame=(frames["purpose"].values == "drift") & (frames["incidence"].values == incidence))
        assert found["drift_elapsed"].values.tolist() == looks["elapsed"].values.tolist() != []
        assert (found["drift_wavelength"].values == plan.drift.wavelength).all()
        for place, wavelength in enumerate(rig_emulated.WAVELENGTHS):
            z[wavelength] += [[found[name].values[0, place] for name in ("elapsed", "reference", "reference_u")]]
        z[plan.drift.wavelength] += np.transpose(
            [found[f"drift_{name}"].values for name in ("elapsed", "reference", "reference_u")]
        ).tolist()
    for told in z.values():
        time, light, u = np.array(told).T
        assert np.ptp(lamp(time)) > 4 * np.median(u / light)
        level = light / lamp(time)
        mean = np.average(level, weights=(light / u) ** 2)
        assert np.abs((level / mean - 1) / (u / light)).max() < 4


def test_filters_before_the_reference_make_the_lamp_as_uncertain_as_they_are():
    rig = replace(rig_emulated.plan().rig, nd_location="reference")
    both = reduce(rig_emulated.frames(of="reference"), rig, incidence=30.0)
    relative = (both["reference_u"] / both["reference"]).values
    # Of the four frames two are behind filters known to 2 %.
    assert relative.max() < 0.02
    assert relative.min() > 0.02 * np.sqrt(2) / 4 * 0.95


def test_an_entrance_without_a_look_tells_of_none(sample):
    found = reduced(rig_emulated.without(rig_emulated.frames(), purpose="drift").assign_attrs(drift_tolerance=0.05))
    assert found.attrs["drift_tolerance"] == 0.05
    assert not [name for name in found.variables if str(name).startswith("drift_")]
    assert found["reference"].values == pytest.approx(sample["reference"].values)
    assert found["elapsed"].values == pytest.approx(sample["elapsed"].values)


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
        picture = Picture(taken["counts"].values[place], float(taken["elapsed"].values[place]), shot.exposure, 20.0)
        state = files.State(shot.wavelength, shot.position)
        told = {"state": state, "origin": 0.0, "camera": "emulated camera"}
        files.write_frame(tmp_path / "frames" / shot.name, picture, shot, plan, **told)
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


@pytest.mark.parametrize("how", ["cut off", "a bit turned", "of another wavelength", "gone"])
def test_a_spoiled_file_is_named_with_what_it_leaves_uncovered_and_the_others_are_used(run, how):
    folder, plan = run
    whole = reduce(files.read_run(folder), plan.rig)
    name = frame_of(plan, 470.0, 10.0, 1)
    spoil(folder / "frames" / name, how, folder / "frames" / frame_of(plan, 550.0, 10.0, 1))
    found = reduce(files.read_run(folder), plan.rig)
    told = " ".join(vocabulary.warnings(found))
    assert name in told or how == "gone"
    assert "no bracket step 4 (sample: 470 nm)" in told
    u = np.sqrt(sum(found[f"signal_u_{each}"].values ** 2 for each in COMPONENTS))
    error = np.abs(found["signal"].values - whole["signal"].values) / u
    assert np.nanmax(error) < 6
    assert np.isfinite(found["signal"].values).sum() == np.isfinite(whole["signal"].values).sum()


def test_a_run_without_its_dark_frames_is_refused(run):
    folder, plan = run
    for path in (folder / "frames").glob("*-dark-*"):
        spoil(path, "cut off")
    with pytest.raises(BrdfpipeError, match="no dark frame of"):
        reduce(files.read_run(folder), plan.rig)


def test_an_arrangement_without_a_frame_is_refused_with_the_files_that_were_lost_and_what_to_do(run):
    folder, plan = run
    for path in (folder / "frames").glob("*-sample-*"):
        spoil(path, "cut off")
    with pytest.raises(ReductionError, match="no frame of the sample in reflection at 10 degree") as refusal:
        reduce(files.read_run(folder, 10.0), plan.rig, incidence=10.0)
    assert "2 of 2 wavelengths at 10 degree have no bracket step 1" in str(refusal.value)
    assert "`brdfpipe rig scan … --resume` takes them again" in str(refusal.value)
    assert frame_of(plan, 550.0, 10.0, 1) in str(refusal.value)
    assert "made by the emulator" not in str(refusal.value)
