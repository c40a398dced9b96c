"""Speos' BRDF files: read back by this package, and block by block by rules of the format alone."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import samples
from damaged_files import check_garbled_files

from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import error_of, fresh_pairs
from brdfpipe.errors import InputError
from brdfpipe.exchange.reading import format_of, read
from brdfpipe.exchange.registry import ExchangeError, write

COARSE = {"tolerance": 0.1, "albedo_tolerance": 0.02, "largest": 60_000}

BY_HAND = """\
OPTIS - brdf surface file v8.0
0
by hand
11
description
1 0
1
2 2
0 60
450 650
"""
BLOCK = "{percent}\n2 3\n\t0 180 360\n0 1 1 1\n90 1 1 1\n"


@pytest.fixture(scope="module")
def grey():
    return samples.beckmann_bsdf(0.2).assign_attrs(material="grey", digest="abc")


@pytest.fixture(scope="module")
def file(grey, tmp_path_factory):
    path = tmp_path_factory.mktemp("speos") / "grey.brdf"
    write(grey, path, **COARSE)
    return path


def by_hand(path: Path, old: str = "", new: str = "") -> Path:
    text = BY_HAND + "".join(BLOCK.format(percent=share) for share in (20, 40, 30, 60)) + "End of file\n"
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return path


def test_the_file_read_back_errs_by_what_its_record_says(grey, file):
    assert format_of(file).name == "speos-brdf"
    record = json.loads(Path(f"{file}.json").read_text())
    model = grey.bsdf.nonspectral()
    found = error_of(model, representation(read(file)).evaluate, fresh_pairs(model, 11, incidences=24))
    assert found.percentile_95 <= 1.4 * record["error"]["percentile_95"] + 1e-3
    # The scale of each incidence comes from its percentage, which another quadrature finds again within 0.1 %.
    assert found.albedo <= record["error"]["albedo"] + 1.5e-3
    assert record["error"]["within_tolerance"]


def test_a_block_has_its_reflectance_then_angles_then_values(grey, file):
    lines = [line.split() for line in file.read_text().splitlines()][5:]
    assert lines[:2] == [["1", "0"], ["1"]]
    incidences, wavelengths = map(int, lines[2])
    assert (len(lines[3]), lines[4], wavelengths) == (incidences, ["555"], 1)
    model = grey.bsdf.nonspectral()
    number, start = incidences // 2, 5
    for _ in range(number):
        start += 3 + int(lines[start + 1][0])
    theta_i = float(lines[3][number])
    assert float(lines[start][0]) / 100 == pytest.approx(model.bsdf.albedo([theta_i]).item(), rel=0.02)
    polar, around = map(int, lines[start + 1])
    phi, rows = np.array(lines[start + 2], float), np.array(lines[start + 3 : start + 3 + polar], float)
    assert (phi.size, phi[0], phi[-1], rows[-1, 0]) == (around, 0, 360, 90)
    row = int(np.abs(rows[:, 0] - theta_i).argmin())
    expected = model.bsdf.evaluate(theta_i, 0, rows[row, 0], 180 + phi).values
    # Values are scaled by at most the tolerance, and rounded.
    assert rows[row, 1:] == pytest.approx(expected, rel=0.1001)
    assert lines[-1] == ["End", "of", "file"]


def test_spectral_files_have_a_block_for_each_wavelength(tmp_path):
    red = samples.beckmann_bsdf(0.3, reflectance=np.linspace(0.05, 0.6, samples.WAVELENGTH.size))
    write(red, tmp_path / "red.brdf", spectral=True, **COARSE)
    back = read(tmp_path / "red.brdf")
    assert back["wavelength"].values == pytest.approx(samples.WAVELENGTH)
    at = 30.0, 0.0, 10.0, 90.0
    assert back.bsdf.evaluate(*at).values == pytest.approx(red.bsdf.evaluate(*at).values, rel=0.1)
    assert "spectrum" not in json.loads((tmp_path / "red.brdf.json").read_text())["left_out"]


def test_values_are_on_the_scale_of_the_percentages(tmp_path):
    back = read(by_hand(tmp_path / "hand.brdf"))
    for theta_i, shares in ((0, (0.2, 0.4)), (60, (0.3, 0.6))):
        found = back.bsdf.evaluate(theta_i, 0, 30, 40).values.ravel()
        assert found == pytest.approx(np.array(shares) / np.pi, rel=1e-3)


def test_a_declared_reflectance_that_the_values_do_not_have_is_named(tmp_path):
    assert "differ" in str(read(by_hand(tmp_path / "hand.brdf")).attrs["warnings"])


def test_a_lay_is_refused(tmp_path):
    with pytest.raises(ExchangeError, match="anisotropicbsdf"):
        write(samples.brushed_bsdf(0.3, 0.15, 25.0), tmp_path / "brushed.brdf", **COARSE)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("v8.0", "v7.1", "line 1.*too old"),
        ("brdf surface", "Anisotropic BSDF surface", "line 1.*not such a file"),
        ("\n1 0\n", "\n0 1\n", "line .*transmitted light alone"),
        ("\n2 2\n", "\n2\n", "line .*numbers of incidences"),
        ("\n2 2\n", "\n2 1000000000\n", "line .*count out of range"),
        ("0 60", "0 99", "line .*out of range"),
        ("450 650", "650 450", "line .*wavelengths do not increase"),
        ("\n20\n", "\n-20\n", "line .*out of range"),
        ("2 3", "3 3", "line .*(wrong number|not a)"),
        ("End of file", "", "ends early"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused_with_its_line(tmp_path, old, new, message):
    with pytest.raises(InputError, match=message):
        read(by_hand(tmp_path / "bad.brdf", old, new), "speos-brdf")


@pytest.mark.parametrize("count", [40, pytest.param(300, marks=pytest.mark.slow)])
def test_garbled_files_are_read_or_refused_and_never_crash(file, tmp_path, count):
    check_garbled_files(file.read_bytes(), tmp_path / "x.brdf", "speos-brdf", count)
