"""rig.yaml: values, digest and refusals."""

from __future__ import annotations

import pytest

from brdfpipe.errors import InputError
from brdfpipe.rig.description import Rig, read_fibres

CAMERA = (
    "camera: {kind: alpaca, address: 'bench:11111', width: 640.0, height: 480, gain: 2, bits: 12, linear_to: 2.0e4}"
)

EVERY_OTHER_KEY = """\
etalon_entrance: 20
target: {spots: [[0, 0], [4, 0], [4, 90.5]]}
slit: 5.0
wavelengths: {low: 400}
"""


def rewritten(rig_file, old, new):
    text = rig_file.read_text()
    assert old in text
    rig_file.write_text(text.replace(old, new))
    return rig_file


def test_a_description_is_read_with_its_defaults(rig):
    assert (rig.monochromator.baud, rig.wheel.baud) == (9600, 115200)
    assert rig.screen.focal_length == 150
    assert rig.wavelengths == (380, 780)
    assert rig.etalon_entrance == 10
    assert rig.filter_at(2).transmittance == 0.1
    assert rig.filter_at(2).u == 0.02
    assert [fibre.name for fibre in rig.fibres] == ["A1", "A2", "A3", "A4"]
    assert rig.fibres[1].phi_s == 90
    assert rig.camera.full == 65535


def test_the_digest_is_of_the_instrument_not_of_its_ports(rig_file, rig):
    assert Rig.load(rewritten(rig_file, "/dev/ttyUSB0", "COM3")).digest == rig.digest
    assert Rig.load(rewritten(rig_file, "transmittance: 0.1}", "transmittance: 0.11}")).digest != rig.digest


def test_the_digest_of_a_description_never_changes_because_the_frames_of_earlier_runs_carry_it(rig_file, rig):
    assert rig.digest == "9c4b76c987f555ef5a18e4479195afd988b5340f86b48cd1c3062bc2538eb88c"
    explicit = rewritten(rig_file, "transmittance: 0.1}", "transmittance: 0.1, u: 0.02}")
    assert Rig.load(explicit).digest == "3c5721d81f0a3e7901d55af1799ff79c71db55cb3dabbb109f1ee07aa05400ad"
    every_key = rig_file.read_text() + EVERY_OTHER_KEY
    rig_file.write_text(every_key.replace("camera: {kind: drop-folder, folder: camera}", CAMERA))
    assert Rig.load(rig_file).digest == "3f4dbdfea20760bb48affd05190f7dfcc03264309fee8533118c0d812084528a"


def test_a_moved_fibre_is_another_instrument(rig_file, rig):
    fibres = rig_file.with_name("fibres.csv")
    fibres.write_text(fibres.read_text().replace("A2,30", "A2,31"))
    assert Rig.load(rig_file).digest != rig.digest


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("position: 2", "position: 1", ["two filters at one position of the wheel", "filters"]),
        ("position: 3", "position: 9", ["position that the wheel does not have", "9", "1 to 6"]),
        ("entrances: [0, 10, 20, 45]", "entrances: [0, 20]", ["etalon_entrance", "no such entrance", "0, 20"]),
        ("/dev/ttyUSB1", "/dev/ttyUSB0", ["two devices on one port"]),
        ("nd_location: sample", "nd_location: lamp", ["nd_location", "'lamp'", "sample, reference"]),
        ("dialect: acton,", "dialect: actno,", ["'actno'", "acton"]),
        ("transmittance: 0.1}", "transmittance: 0}", ["filters.1.transmittance"]),
        ("file: fibres.csv", "file: ../fibres.csv", ["outside the rig's folder", "fibres.file"]),
        ("file: fibres.csv", "file: fibre.csv", ["no such file", "fibres.csv"]),
        ("kind: drop-folder, folder: camera", "kind: drop-folder", ["folder"]),
        ("scale: 3,", "", ["scale"]),
        ("name: bench-1", "name: ../x", ["name"]),
    ],
)
def test_an_invalid_value_is_refused_with_its_key_and_what_is_accepted(rig_file, old, new, words):
    with pytest.raises(InputError) as refusal:
        Rig.load(rewritten(rig_file, old, new))
    for word in ["rig.yaml", *words]:
        assert word in str(refusal.value)


def test_a_wheel_may_be_on_the_monochromators_controller(rig_file):
    rewritten(rig_file, "{dialect: thorlabs, port: /dev/ttyUSB1", "{dialect: acton-wheel, port: /dev/ttyUSB0")
    assert Rig.load(rig_file).shared_port
    rewritten(rig_file, "acton-wheel,", "acton-wheel, baud: 19200,")
    with pytest.raises(InputError, match=r"two baud rates of one port.*19200.*9600"):
        Rig.load(rig_file)


def test_an_absent_filter_is_refused(rig):
    with pytest.raises(InputError, match="found 5; accepted: 1, 2, 3"):
        rig.filter_at(5)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["empty"]),
        ("# nothing\n", ["empty"]),
        ("name,theta,phi_s,x,y\nA,1,2,3,4\n", ["line 1", "titles", "theta_s"]),
        ("name,theta_s,phi_s,x,y\n", ["number of fibres", "0"]),
        ("name,theta_s,phi_s,x,y\nA,1,2,3\n", ["line 2", "cells", "4", "5"]),
        ("name,theta_s,phi_s,x,y\n\nA,1,2,3,4\nB,1,two,3,4\n", ["line 4", "phi_s", "'two'"]),
        ("name,theta_s,phi_s,x,y\nA,nan,2,3,4\n", ["line 2", "theta_s", "nan"]),
        ("name,theta_s,phi_s,x,y\nA,181,2,3,4\n", ["line 2", "0 to 180"]),
        ("name,theta_s,phi_s,x,y\nA,1,2,3,4\nA,2,2,3,4\n", ["duplicate fibre name", "A"]),
    ],
)
def test_a_wrong_table_of_fibres_is_refused_by_line(tmp_path, text, words):
    path = tmp_path / "fibres.csv"
    path.write_text(text)
    with pytest.raises(InputError) as refusal:
        read_fibres(path)
    for word in ["fibres.csv", *words]:
        assert word in str(refusal.value)


def test_the_folder_of_the_camera_is_beside_the_description(rig_file, rig):
    assert rig.camera.folder == str(rig_file.resolve().parent / "camera")
