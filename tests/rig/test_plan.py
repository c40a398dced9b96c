"""plan.yaml: values, refusals, and the order of exposures."""

from __future__ import annotations

from itertools import groupby, pairwise

import pytest
import small_rig

from brdfpipe.errors import InputError
from brdfpipe.rig import plan as plans
from brdfpipe.rig.plan import Drift, Plan, Step, sources


def plan(folder, text=small_rig.PLAN, **changes):
    for key, value in changes.items():
        lines = [line for line in text.splitlines() if not line.startswith(f"{key}:")]
        text = "\n".join([*lines, *([f"{key}: {value}"] if value is not None else [])]) + "\n"
    return Plan.load(small_rig.write(folder, text))


def test_a_plan_is_read_with_its_defaults(tmp_path):
    loaded = plan(tmp_path)
    assert loaded.sample == "tile"
    assert loaded.wavelengths == (500, 550)
    assert loaded.bracket == (Step(1, 2), Step(1, 1))
    assert (loaded.darks, loaded.runs, loaded.side) == (5, ("etalon", "sample"), ("reflection",))
    assert loaded.drift == Drift(every=4, wavelength=550, step=1, tolerance=0.03)
    assert loaded.etalon_entrances == (10,)
    assert loaded.rig.name == "small"


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        ("{from: 390, to: 730, step: 10}", [390 + 10 * k for k in range(35)]),
        ("{from: 400, to: 401, step: 0.1}", [400 + k / 10 for k in range(11)]),
        ("{from: 500, to: 500, step: 1}", [500]),
        ("[500.5]", [500.5]),
    ],
)
def test_wavelengths_are_a_list_or_steps_that_reach_both_ends(tmp_path, written, expected):
    assert plan(tmp_path, wavelengths=written).wavelengths == tuple(expected)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"incidences": "[20, 30]"}, ["incidences", "no such entrance", "found 30", "0, 10, 20, 45"]),
        ({"incidences": "[20, 20]"}, ["incidences"]),
        ({"incidences": None}, ["incidences", "missing"]),
        ({"wavelengths": "[550, 500]"}, ["wavelengths", "do not increase"]),
        ({"wavelengths": "[550, 550]"}, ["wavelengths", "do not increase"]),
        ({"wavelengths": "[]"}, ["wavelengths"]),
        ({"wavelengths": "[300]"}, ["wavelengths", "does not reach", "300 nm", "380 to 780 nm"]),
        ({"wavelengths": "{from: 390, to: 395, step: 2}"}, ["wavelengths", "whole number of steps"]),
        ({"wavelengths": "{from: 500, to: 400, step: 10}"}, ["wavelengths", "whole number of steps"]),
        ({"wavelengths": "{from: 390, to: 730}"}, ["step", "missing"]),
        ({"wavelengths": "{from: 390, to: 730, step: 0}"}, ["step"]),
        ({"bracket": "[{exposure: 1, position: 3}]"}, ["bracket.0.position", "no filter", "found 3", "1, 2, 4"]),
        ({"bracket": "[{exposure: 0, position: 1}]"}, ["bracket.0.exposure", "above 0"]),
        ({"bracket": "[{exposure: 1, position: 1}, {exposure: 1.0, position: 1}]"}, ["bracket.1", "duplicate frame"]),
        ({"bracket": "[]"}, ["bracket"]),
        ({"darks": "4"}, ["darks", "from 5 to 1000"]),
        ({"drift": "{every: 0}"}, ["drift.every"]),
        ({"drift": "{step: 3}"}, ["drift.step", "no such frame", "1 to 2"]),
        ({"drift": "{wavelength: 900}"}, ["drift.wavelength", "does not reach"]),
        ({"runs": "[sample, sampel]"}, ["'sampel'", "etalon"]),
        ({"runs": "[target]"}, ["runs", "no angular target"]),
        ({"side": "[transmission, reflection, both]"}, ["side"]),
        ({"etalon_entrances": "[20]"}, ["etalon_entrances", "missing", "10"]),
        ({"etalon_entrances": "[10, 30]"}, ["etalon_entrances", "no such entrance", "30"]),
        ({"sample": "../tile"}, ["sample", "letters, digits"]),
        ({"sample": "etalon"}, ["sample", "not etalon"]),
        ({"rig": "../rig.yaml"}, ["rig", "outside the plan's folder"]),
        ({"rig": "rgi.yaml"}, ["no such file", "did you mean 'rig.yaml'"]),
        ({"wavelength": "[500]"}, ["unknown key 'wavelength'", "wavelengths"]),
        ({"wavelengths": "{from: 380, to: 780, step: 0.1}", "incidences": "[0, 10, 20, 45]", "etalon_entrances": "[0, 10, 20, 45]",
          "side": "[reflection, transmission]", "drift": "{every: 1}"}, ["too many frames", "99999"]),
    ],
)  # fmt: skip
def test_an_invalid_value_is_refused_with_its_key_and_what_is_accepted(tmp_path, changes, words):
    with pytest.raises(InputError) as refusal:
        plan(tmp_path, **changes)
    for word in ["plan.yaml", *words]:
        assert word in str(refusal.value)


def test_the_limit_of_frames_includes_dark_frames_and_lamp_readings(tmp_path, monkeypatch):
    changes = {"bracket": "[{exposure: 1, position: 1}]", "drift": "{every: 3}", "darks": "7"}
    count = len(plan(tmp_path, **changes).shots)
    monkeypatch.setattr(plans, "MAX_SHOTS", count)
    plan(tmp_path, **changes)
    monkeypatch.setattr(plans, "MAX_SHOTS", count - 1)
    with pytest.raises(InputError, match=f"too many frames; found {count}; accepted: at most {count - 1}"):
        plan(tmp_path, **changes)


def test_no_light_is_measured_through_a_sample_at_75_degree(tmp_path):
    path = small_rig.write(tmp_path, small_rig.PLAN.replace("[20]", "[80]") + "side: [reflection, transmission]\n")
    rig = tmp_path / "rig.yaml"
    rig.write_text(rig.read_text().replace("[0, 10, 20, 45]", "[0, 10, 20, 80]"))
    with pytest.raises(InputError, match="side: transmission cannot be measured at this incidence; found 80 degree"):
        Plan.load(path)
    path.write_text(path.read_text().replace("side: [reflection, transmission]", ""))
    assert Plan.load(path).incidences == (80,)


def test_every_light_frame_of_the_plan_is_taken_once(tmp_path):
    loaded = plan(tmp_path, incidences="[20, 45]", side="[reflection, transmission]", runs="[sample, etalon]")
    lights = [shot for shot in loaded.shots if shot.step]
    wanted = {
        (load, side, sigma, wavelength, step)
        for load, side, sigma in [("etalon", "reflection", 10)]
        + [("sample", side, sigma) for side in ("reflection", "transmission") for sigma in (20, 45)]
        for wavelength in (500, 550)
        for step in (1, 2)
    }
    keys = [
        (shot.arrangement.load, shot.arrangement.side, shot.arrangement.incidence, shot.wavelength, shot.step)
        for shot in lights
    ]
    assert set(keys) == wanted
    assert len(keys) == len(wanted)
    assert [shot.ordinal for shot in loaded.shots] == list(range(1, len(loaded.shots) + 1))
    for shot in lights:
        assert (shot.exposure, shot.position) == (1, loaded.bracket[shot.step - 1].position)


def test_no_arrangement_is_made_twice(tmp_path):
    loaded = plan(tmp_path, incidences="[45, 20]", side="[reflection, transmission]")
    arranged = [arrangement for arrangement, _ in groupby(shot.arrangement for shot in loaded.shots)]
    assert arranged == list(loaded.arrangements)
    assert [(arrangement.load, arrangement.side, arrangement.incidence) for arrangement in arranged] == [
        ("etalon", "reflection", 10),
        ("sample", "reflection", 45),
        ("sample", "reflection", 20),
        ("sample", "transmission", 45),
        ("sample", "transmission", 20),
    ]


def test_wavelengths_rise_once_in_each_arrangement(tmp_path):
    loaded = plan(tmp_path, wavelengths="{from: 500, to: 600, step: 10}", drift="{every: 1000}")
    for _, shots in groupby((shot for shot in loaded.shots if shot.step), lambda shot: shot.arrangement):
        assert all(before.wavelength <= after.wavelength for before, after in pairwise(shots))


def test_the_lamp_is_read_at_both_ends_and_after_every_given_number_of_frames(tmp_path):
    loaded = plan(tmp_path, wavelengths="{from: 500, to: 600, step: 10}", drift="{every: 5, wavelength: 530, step: 2}")
    light = [shot for shot in loaded.shots if not shot.dark]
    assert light[0].purpose == light[-1].purpose == "drift"
    runs = [
        len(list(group)) for is_reading, group in groupby(light, lambda shot: shot.purpose == "drift") if not is_reading
    ]
    assert set(runs[:-1]) == {5}
    assert sum(runs) == 2 * 11 * 2
    for reading in (shot for shot in light if shot.purpose == "drift"):
        assert (reading.wavelength, reading.position, reading.exposure, reading.step) == (530, 1, 1, 0)


def test_dark_frames_of_every_exposure_open_and_close_the_run(tmp_path):
    loaded = plan(
        tmp_path, bracket="[{exposure: 1, position: 2}, {exposure: 0.2, position: 2}, {exposure: 1, position: 1}]"
    )
    for ends in (loaded.shots[:10], loaded.shots[-10:]):
        assert [shot.exposure for shot in ends] == [0.2] * 5 + [1] * 5
        assert all(shot.dark for shot in ends)
    assert not any(shot.dark for shot in loaded.shots[10:-10])


def test_dark_frames_need_no_move_of_mirrors_or_devices(tmp_path):
    loaded = plan(tmp_path, darks="6")
    opening, closing = loaded.shots[:7], loaded.shots[-7:]
    for group in (opening, closing):
        assert len({(shot.arrangement, shot.wavelength, shot.position) for shot in group}) == 1


def test_the_target_is_measured_at_one_wavelength(tmp_path):
    path = small_rig.write(tmp_path, small_rig.PLAN + "runs: [target, etalon, sample]\n")
    with (tmp_path / "rig.yaml").open("a") as rig:
        rig.write("target: {spots: [[0, 0], [4, 0], [4, 90]]}\n")
    loaded = Plan.load(path)
    shots = [shot for shot in loaded.shots if shot.purpose == "target"]
    assert [(shot.wavelength, shot.step) for shot in shots] == [(550, 1), (550, 2)]
    assert loaded.sample_id(shots[0].arrangement) == "target"


LINE_LAMP = {"runs": "[line-lamp, etalon]", "line_lamp": "{lines: [435.833, 546.074], step: 2}"}


def test_lines_are_read_about_their_wavelengths_without_lamp_readings(tmp_path):
    loaded = plan(tmp_path, **LINE_LAMP)
    light = [shot for shot in loaded.shots if not shot.dark]
    lines = [shot for shot in light if shot.purpose == "line-lamp"]
    assert light[: len(lines)] == lines
    assert [shot.wavelength for shot in lines[:9]] == [round(435.833 + 2.25 * place, 3) for place in range(-4, 5)]
    assert {(shot.exposure, shot.position, shot.arrangement.load) for shot in lines} == {(1, 1, "line-lamp")}
    assert light[len(lines)].purpose == "drift"
    alone = plan(tmp_path, runs="[line-lamp]", line_lamp="{lines: [546.074]}")
    assert [shot.purpose for shot in alone.shots if not shot.dark] == ["line-lamp"] * 9


def test_the_mirror_is_turned_to_each_direction_at_one_wavelength(tmp_path):
    loaded = plan(tmp_path, runs="[mirror]", mirror="{step: 30, to: 60}")
    aims = [arrangement.aim for arrangement in loaded.arrangements]
    assert aims[0] == (0.0, 0.0)
    assert {theta for theta, _ in aims} == {0.0, 30.0, 60.0}
    assert len(set(aims)) == len(aims) == 1 + 6 + 10
    taken = [shot for shot in loaded.shots if shot.purpose == "mirror"]
    assert {shot.wavelength for shot in taken} == {loaded.drift.wavelength}
    assert len(taken) == len(aims) * len(loaded.bracket)
    assert plan(tmp_path).aims == ()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"runs": "[line-lamp, etalon]"}, ["no lines of the lamp", "line_lamp: {lines:"]),
        (LINE_LAMP | {"line_lamp": "{lines: [385]}"}, ["line_lamp.lines", "does not reach", "376 nm"]),
        (LINE_LAMP | {"line_lamp": "{lines: [500], step: 3}"}, ["line_lamp.step", "no such frame", "1 to 2"]),
        ({"sample": "mirror"}, ["reserved name", "line-lamp"]),
        ({"mirror": "{step: 1}"}, ["mirror.step"]),
    ],
)
def test_an_invalid_calibration_is_refused(tmp_path, changes, words):
    with pytest.raises(InputError) as refusal:
        plan(tmp_path, **changes)
    assert all(word in str(refusal.value) for word in words), str(refusal.value)


def test_plans_differ_by_their_values_and_not_by_their_ports(tmp_path):
    one = plan(tmp_path / "one")
    other = plan(tmp_path / "other", wavelengths="[500, 560]", darks="7")
    assert one.differences(plan(tmp_path / "same")) == []
    assert one.differences(other) == [
        "wavelengths: 500.0, 550.0 and 500.0, 560.0",
        "darks: 5 and 7",
        *(difference for difference in one.differences(other) if difference.startswith("drift")),
    ]
    rig = tmp_path / "same" / "rig.yaml"
    rig.write_text(rig.read_text().replace("/dev/ttyUSB1", "COM3"))
    assert one.differences(Plan.load(tmp_path / "same" / "plan.yaml")) == []
    rig.write_text(
        rig.read_text().replace("nd_location: sample", "nd_location: reference").replace("width: 96", "width: 97")
    )
    assert one.differences(Plan.load(tmp_path / "same" / "plan.yaml")) == [
        "rig nd_location: sample and reference",
        "rig width: 96 and 97",
    ]


def test_the_sources_of_a_plan_are_its_files(tmp_path):
    path = small_rig.write(tmp_path)
    assert sources(path) == {name: tmp_path / name for name in ("plan.yaml", "rig.yaml", "fibres.csv")}
    renamed = path.rename(tmp_path / "monday.yaml")
    assert sources(renamed)["plan.yaml"] == renamed


def test_a_rig_with_a_reserved_file_name_is_refused(tmp_path):
    path = small_rig.write(tmp_path).rename(tmp_path / "monday.yaml")
    (tmp_path / "rig.yaml").rename(tmp_path / "plan.yaml")
    path.write_text(path.read_text().replace("rig: rig.yaml", "rig: plan.yaml"))
    with pytest.raises(InputError, match="a file name that the folder of a run needs itself; found plan"):
        sources(path)
