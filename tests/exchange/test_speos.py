"""Speos' anisotropic BSDF files: read back by this package, and cell by cell by rules of the format alone."""

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
from brdfpipe.exchange import speos
from brdfpipe.exchange.reading import format_of, read
from brdfpipe.exchange.registry import ExchangeError, write

COARSE = {"tolerance": 0.1, "albedo_tolerance": 0.02, "largest": 60_000}

BY_HAND = """\
OPTIS - Anisotropic BSDF surface file v8.0
0
by hand
11
description
0 1 0
1 0
{kind}
1
0
2
0 60
0 0

2
400 20
700 {red}
"""
BLOCK = "2 5\n\t0 90 180 270 360\n0 1 1 1 1 1\n90 1 1 1 1 1\n"


@pytest.fixture(scope="module")
def grey():
    return samples.beckmann_bsdf(0.2).assign_attrs(material="grey", digest="abc")


@pytest.fixture(scope="module")
def file(grey, tmp_path_factory):
    path = tmp_path_factory.mktemp("speos") / "grey.anisotropicbsdf"
    write(grey, path, **COARSE)
    return path


def blocks_of(path: Path) -> dict[tuple[float, float], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """θ, φ and values (θ, φ) by rotation and incidence, read by the rules of the format."""
    lines = [line.split() for line in path.read_text().splitlines()][5:]
    assert lines[1] == ["1", "0"]
    assert lines[2] == ["1"]
    rotations = [float(word) for word in lines[4]]
    incidences = [float(word) for word in lines[6]]
    start = 5 + 2 * len(rotations) + 2
    start += 1 + int(lines[start][0])
    found = {}
    for rotation in rotations:
        for incidence in incidences:
            polar, around = map(int, lines[start])
            azimuth = np.array(lines[start + 1], dtype=float)
            rows = np.array(lines[start + 2 : start + 2 + polar], dtype=float)
            assert azimuth.size == around
            found[rotation, incidence] = rows[:, 0], azimuth, rows[:, 1:]
            start += 2 + polar
    assert lines[start] == ["End", "of", "file"]
    return found


def check_cells(model, path: Path, limit: float) -> int:
    """The mirror direction is at azimuth 0, counter-clockwise seen from above; how many cells were compared."""
    blocks = list(blocks_of(path).items())
    generator, compared = np.random.default_rng(3), 0
    for _ in range(200):
        (rotation, incidence), (polar, azimuth, values) = blocks[generator.integers(len(blocks))]
        row, column = generator.integers(polar.size), generator.integers(azimuth.size)
        if polar[row] > 85:
            continue
        expected = model.bsdf.evaluate(incidence, rotation, polar[row], (rotation + 180 + azimuth[column]) % 360).item()
        assert values[row, column] == pytest.approx(expected, rel=limit), (rotation, incidence, polar[row])
        compared += 1
    return compared


def test_the_file_read_back_errs_by_what_its_record_says(grey, file):
    record = json.loads(Path(f"{file}.json").read_text())
    model = grey.bsdf.nonspectral()
    back = read(file).bsdf.nonspectral()
    found = error_of(model, representation(back).evaluate, fresh_pairs(model, 11, incidences=24))
    assert found.percentile_95 <= 1.4 * record["error"]["percentile_95"] + 1e-3
    # The scale of all values comes from one percentage, which another quadrature finds again within 0.1 %.
    assert found.albedo <= record["error"]["albedo"] + 1.5e-3
    assert record["error"]["within_tolerance"]


def test_cells_are_the_directions_about_the_normal_with_the_mirror_direction_at_0(grey, file):
    # Values are scaled by at most the tolerance, and rounded.
    assert check_cells(grey.bsdf.nonspectral(), file, 0.1001) > 100
    for polar, azimuth, values in blocks_of(file).values():
        assert (polar[0], polar[-1], azimuth[0], azimuth[-1]) == (0, 90, 0, 360)
        assert values[:, 0] == pytest.approx(values[:, -1])


def test_the_spectrum_is_that_of_the_first_incidence(tmp_path):
    red = samples.beckmann_bsdf(0.3, reflectance=np.linspace(0.05, 0.6, samples.WAVELENGTH.size))
    write(red, tmp_path / "red.anisotropicbsdf", **COARSE)
    lines = (tmp_path / "red.anisotropicbsdf").read_text().splitlines()
    start = lines.index("reflectance of this incidence") + 2
    rows = np.array([line.split() for line in lines[start : start + int(lines[start - 1])]], dtype=float)
    assert rows[:, 0] == pytest.approx(samples.WAVELENGTH)
    # The table's reflectance may differ from the model's by the tolerance.
    assert rows[:, 1] / 100 == pytest.approx(red.bsdf.albedo([0.0]).values.ravel(), rel=0.02)
    record = json.loads((tmp_path / "red.anisotropicbsdf.json").read_text())
    assert "first incidence" in record["left_out"]["spectrum"]
    back = read(tmp_path / "red.anisotropicbsdf")
    assert back.bsdf.albedo([0.0]).values.ravel() == pytest.approx(rows[:, 1] / 100, rel=0.01)


def test_a_lay_becomes_anisotropy_angles(tmp_path):
    brushed = samples.brushed_bsdf(0.3, 0.15, 25.0)
    path = tmp_path / "brushed.anisotropicbsdf"
    write(brushed, path, tolerance=0.3, albedo_tolerance=0.2, largest=100_000)
    model = brushed.bsdf.nonspectral()
    assert check_cells(model, path, 0.3001) > 100
    back = read(path).bsdf.nonspectral()
    at = [(40, phi, 25, phi + 150) for phi in (25.0, 70.0, 115.0, 160.0)]
    found, wanted = ([float(bsdf.bsdf.evaluate(*angles)) for angles in at] for bsdf in (back, model))
    assert found == pytest.approx(wanted, rel=0.3)
    assert max(wanted) > 2 * min(wanted)


def test_intensity_values_lose_their_cosine(tmp_path):
    path = tmp_path / "hand.anisotropicbsdf"
    text = BY_HAND.format(kind=0, red=20) + (BLOCK * 2).replace("90 1 1 1 1 1", "60 .5 .5 .5 .5 .5") + "End of file\n"
    path.write_text(text)
    table = speos.read(path)
    assert (table.quantity, table.relative, table.channels) == ("brdf_cos", True, "photopic")
    back = read(path)
    found = [float(back.bsdf.evaluate(0, 0, theta, 77)) for theta in (0, 60)]
    assert found[1] == pytest.approx(found[0])


@pytest.mark.parametrize(("end", "length"), [("\n", 15), ("\r\n", 16)])
def test_a_description_may_have_several_lines_with_ends_of_either_kind(tmp_path, end, length):
    path = tmp_path / "hand.anisotropicbsdf"
    text = BY_HAND.format(kind=1, red=40).replace("11\ndescription\n", f"{length}\nfirst\nsecond li\n")
    path.write_bytes((text + BLOCK * 2 + "End of file\n").replace("\n", end).encode())
    assert read(path)["theta_i"].values.tolist() == [0, 60]


def test_percentages_scale_values_by_wavelength(tmp_path):
    path = tmp_path / "hand.anisotropicbsdf"
    path.write_text(BY_HAND.format(kind=1, red=40) + BLOCK * 2 + "End of file\n")
    back = read(path)
    assert format_of(path).name == "speos"
    # A constant reflects what the file says at every incidence.
    expected = np.array([0.2, 0.4]) / np.pi
    assert back.bsdf.evaluate(30, 0, 30, 10).values.ravel() == pytest.approx(expected, rel=1e-3)


def test_real_vinyl_has_the_cells_that_the_converter_of_ansys_writes_from_the_same_measurement(shared_data):
    """Interpolated from the Zemax file as here, then times π and a factor for each incidence that brings it to its reflectance."""
    measured = read(shared_data / "bsdf" / "brown_vinyl_zemax.bsdf")
    found = speos.read(shared_data / "bsdf" / "brown_vinyl_speos.anisotropicbsdf")
    theta_i, theta_o, phi_o = np.meshgrid(*found.axes.values(), indexing="ij")
    expected = np.pi * measured.bsdf.evaluate(theta_i, 0 * theta_i, theta_o, phi_o).values.reshape(theta_i.shape)
    lit = (found.values[..., 0] > 0) & (theta_o <= 70)
    ratio = np.where(lit, found.values[..., 0] / np.where(lit, expected, 1.0), np.nan)
    factor = np.nanmedian(ratio, axis=(1, 2))
    spread = np.nanmax(np.abs(ratio / factor[:, None, None] - 1))
    assert spread < 1e-3
    assert lit.mean() > 0.5
    # The integral of the measurement itself misses its declared reflectance by a similar share.
    assert ((factor > 1) & (factor < 1.25)).all()


def test_real_vinyl_is_written_as_the_converter_of_ansys_writes_it(shared_data, tmp_path):
    """The same measurement from a Zemax file, at the angles of the other file: one factor for each incidence, π times what brings it to its reflectance."""
    path = tmp_path / "vinyl.anisotropicbsdf"
    write(read(shared_data / "bsdf" / "brown_vinyl_zemax.bsdf"), path, tolerance=0.05, albedo_tolerance=0.02)
    stated = json.loads(Path(f"{path}.json").read_text())["error"]["percentile_95"]
    ours, theirs = read(path), speos.read(shared_data / "bsdf" / "brown_vinyl_speos.anisotropicbsdf")
    theta_i, theta_o, phi_o = np.meshgrid(*theirs.axes.values(), indexing="ij")
    values = ours.bsdf.evaluate(theta_i, 0 * theta_i, theta_o, phi_o).values.reshape(theta_i.shape)
    lit = (theirs.values[..., 0] > 0) & (theta_o <= 70)
    ratio = np.where(lit, theirs.values[..., 0] / np.where(lit, np.pi * values, 1.0), np.nan)
    factor = np.nanmedian(ratio, axis=(1, 2))
    # Our file is off by what its record says, at directions between its nodes.
    assert np.nanquantile(np.abs(ratio / factor[:, None, None] - 1), 0.95) < 1.2 * stated
    assert ((factor > 1) & (factor < 1.25)).all()


@pytest.mark.parametrize(("option", "value"), [("tolerance", 0.0), ("albedo_tolerance", 2.0), ("largest", 5)])
def test_options_out_of_range_are_refused(grey, tmp_path, option, value):
    with pytest.raises(ExchangeError, match=option):
        write(grey, tmp_path / "grey.anisotropicbsdf", **{option: value})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("v8.0", "v7.1", "line 1.*too old"),
        ("OPTIS", "OPTICS", "line 1.*not such a file"),
        ("\n0\n", "\n1\n", "line 2.*not text"),
        ("\n1\t0\n", "\n0\t1\n", "line .*transmitted light alone"),
        ("\n1\t0\n1\n", "\n1\t0\n7\n", "line .*type of values"),
        ("\n1\t0\n1\n1\n", "\n1\t0\n1\n1000000000\n", "line .*count out of range"),
        ("850\t", "150\t", "line .*wavelengths do not increase"),
        ("850\t", "850\t-", "line .*(negative|not increase)"),
        ("e-0", "e-x", "line .*not a number"),
        ("End of file", "", "ends early"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused_with_its_line(tmp_path, old, new, message):
    blocks = BLOCK.replace(" ", "\t").replace("\t1", "\t1e-03", 1)
    text = BY_HAND.replace("1 0\n", "1\t0\n").replace("400 ", "350\t").replace("700 ", "850\t")
    text = text.format(kind=1, red=30) + blocks * 2 + "End of file\n"
    assert old in text
    (tmp_path / "bad.anisotropicbsdf").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read(tmp_path / "bad.anisotropicbsdf", "speos")


def test_other_angles_in_a_later_block_are_refused(tmp_path):
    text = BY_HAND.format(kind=1, red=30) + BLOCK + BLOCK.replace("90 180", "91 180") + "End of file\n"
    (tmp_path / "bad.anisotropicbsdf").write_text(text)
    with pytest.raises(InputError, match=r"line .*other angles phi"):
        read(tmp_path / "bad.anisotropicbsdf")


@pytest.mark.parametrize("count", [40, pytest.param(300, marks=pytest.mark.slow)])
def test_garbled_files_are_read_or_refused_and_never_crash(file, tmp_path, count):
    check_garbled_files(file.read_bytes(), tmp_path / "x.anisotropicbsdf", "speos", count)
