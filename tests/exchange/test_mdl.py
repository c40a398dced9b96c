"""MBSDF files of MDL: read back by this package, and cell by cell by rules of the format alone."""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path

import numpy as np
import pytest
import samples

from brdfpipe import vocabulary
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import error_of, fresh_pairs
from brdfpipe.errors import InputError
from brdfpipe.exchange.read_table import ReadTable, as_bsdf
from brdfpipe.exchange.reading import read
from brdfpipe.exchange.registry import ExchangeError, write

MARK = b"MBSDF_DATA_REFLECTION=\n"
COARSE = {"tolerance": 0.02, "albedo_tolerance": 0.005, "largest": 60_000}


@pytest.fixture(scope="module")
def grey():
    return samples.beckmann_bsdf(0.2).assign_attrs(material="grey", digest="abc")


@pytest.fixture(scope="module")
def file(grey, tmp_path_factory):
    path = tmp_path_factory.mktemp("mdl") / "grey.mbsdf"
    write(grey, path, colour=False, **COARSE)
    return path


def cells(path: Path) -> np.ndarray:
    """Values by θ_i, θ_o and φ, read by the rules of the specification."""
    head, _, block = path.read_bytes().partition(MARK)
    assert head.startswith(b"NVIDIA ARC MBSDF V1\n")
    kind, polar, around = struct.unpack("<3I", block[:12])
    return np.frombuffer(block[12:], "<f4").reshape(polar, polar, around, 3 if kind else 1)


def test_the_file_read_back_errs_by_what_its_record_says(grey, file):
    record = json.loads(Path(f"{file}.json").read_text())
    model = grey.bsdf.nonspectral()
    found = error_of(model, representation(read(file)).evaluate, fresh_pairs(model, 11, incidences=24))
    assert found.percentile_95 <= 1.4 * record["error"]["percentile_95"] + 1e-4
    assert found.albedo <= record["error"]["albedo"] + 5e-4
    assert record["error"]["within_tolerance"]


def test_a_cell_is_the_mean_about_its_centre_and_the_mirror_is_in_the_last_one(grey, file):
    values = cells(file)
    polar, _, around, _ = values.shape
    assert around == 2 * polar
    theta, phi = (np.arange(polar) + 0.5) * 90 / polar, (np.arange(around) + 0.5) * 180 / around
    model = grey.bsdf.nonspectral()
    for row, column, turn in ((polar // 2, polar // 4, around - 1), (polar // 3, polar // 2, around // 3), (2, 1, 0)):
        expected = float(model.bsdf.evaluate(theta[row], 0, theta[column], phi[turn]))
        # The mean differs from the centre by h²/24 of each second derivative: cells of 3 degree in a lobe of 22 degree.
        assert float(values[row, column, turn, 0]) == pytest.approx(expected, rel=0.02)
    assert int(values[polar // 2, polar // 2, :, 0].argmax()) == around - 1


def test_a_cell_holds_the_mean_of_the_lobe_that_it_contains():
    from brdfpipe.exchange.cell_means import cell_means
    from brdfpipe.exchange.gridded import photopic

    sharp = samples.beckmann_bsdf(0.1).bsdf.nonspectral()
    edges = {"theta_i": np.array([30.0, 34.0]), "theta_o": np.array([28.0, 36.0]), "phi_o": np.array([170.0, 180.0])}
    fine = [np.linspace(a, b, 41)[:-1] + (b - a) / 80 for a, b in edges.values()]
    mean = float(np.mean(representation(sharp).evaluate(*_at(*np.meshgrid(*fine, indexing="ij")), None)))
    assert float(cell_means(photopic(sharp), edges)[0, 0, 0, 0]) == pytest.approx(mean, rel=0.01)


def _at(theta_i, theta_o, phi_o):
    return theta_i, np.zeros_like(theta_i), theta_o, phi_o


def test_lines_of_the_header_say_what_the_file_leaves_out(file):
    head = file.read_bytes().partition(MARK)[0].decode().splitlines()
    assert all("=" in line and line.endswith('"') for line in head[1:])
    assert any("polarisation" in line for line in head)
    assert any("95th percentile" in line for line in head)
    assert set(json.loads(Path(f"{file}.json").read_text())["left_out"]) == {"spectrum", "polarisation"}


def test_colours_are_linear_srgb(tmp_path):
    red = samples.beckmann_bsdf(0.3, reflectance=np.linspace(0.05, 0.6, samples.WAVELENGTH.size))
    write(red, tmp_path / "red.mbsdf", **COARSE)
    values = cells(tmp_path / "red.mbsdf")
    assert values.shape[-1] == 3
    assert values[5, 3, 4, 0] > values[5, 3, 4, 2]
    back = read(tmp_path / "red.mbsdf")
    expected = float(red.bsdf.nonspectral().bsdf.evaluate(30.0, 0.0, 10.0, 90.0))
    assert float(back.bsdf.nonspectral().bsdf.evaluate(30.0, 0.0, 10.0, 90.0)) == pytest.approx(expected, rel=0.03)


def test_a_colour_outside_srgb_is_said_and_no_value_is_negative(tmp_path):
    wavelength = samples.WAVELENGTH
    laser = 0.6 * np.exp(-(((wavelength - 515) / 10) ** 2)) + 0.001
    write(samples.beckmann_bsdf(0.3, reflectance=laser), tmp_path / "green.mbsdf", **COARSE)
    record = json.loads((tmp_path / "green.mbsdf.json").read_text())
    assert "outside sRGB" in record["left_out"]["gamut"]
    assert cells(tmp_path / "green.mbsdf").min() >= 0


@pytest.mark.parametrize("suffix", [".mbsdf", ".binary"])
def test_what_an_exchange_of_the_directions_changes_is_averaged_and_said(tmp_path, suffix):
    axes = {"theta_i": np.linspace(0, 88, 23), "theta_o": np.linspace(0, 90, 19), "phi_o": np.linspace(0, 180, 7)}
    values = np.broadcast_to(0.1 + 0.05 * np.sin(np.radians(axes["theta_i"]))[:, None, None, None], (23, 19, 7, 1))
    bsdf = as_bsdf(ReadTable("uniform", axes, values), Path("x"))
    write(bsdf, tmp_path / f"x{suffix}", **(COARSE if suffix == ".mbsdf" else {}))
    record = json.loads((tmp_path / f"x{suffix}.json").read_text())
    sentence = record["left_out"]["reciprocity"]
    off = float(re.search(r"off by ([0-9.]+)%", sentence)[1]) / 100
    assert 0.05 < off < 0.25
    # What remains of the error where cells are fine enough.
    stated = record["error"] if suffix == ".mbsdf" else record["error"]["interpolated"]
    assert stated["percentile_95"] == pytest.approx(off, rel=0.05)


def test_a_lay_is_averaged_and_said_to_be_lost(tmp_path):
    brushed = samples.brushed_bsdf(0.3, 0.15)
    write(brushed, tmp_path / "brushed.mbsdf", colour=False, tolerance=0.5, albedo_tolerance=0.5, largest=8000)
    record = json.loads((tmp_path / "brushed.mbsdf.json").read_text())
    assert "mean over it" in record["left_out"]["lay"]
    # Compared with the surface that has the lay.
    assert record["error"]["percentile_95"] > 0.1


@pytest.mark.parametrize(("name", "value"), [("tolerance", 0.0), ("albedo_tolerance", 2.0), ("largest", 1000)])
def test_options_out_of_range_are_refused(grey, tmp_path, name, value):
    with pytest.raises(ExchangeError, match=name):
        write(grey, tmp_path / "grey.mbsdf", **{name: value})
    assert not list(tmp_path.iterdir())


def test_a_file_too_small_for_its_tolerance_says_so(grey, tmp_path):
    write(grey, tmp_path / "x.mbsdf", colour=False, tolerance=1e-4, largest=2000)
    error = json.loads((tmp_path / "x.mbsdf.json").read_text())["error"]
    assert not error["within_tolerance"]
    assert "tolerance" in error["exceeded"]
    assert b"MORE than the tolerance of 0.0001" in (tmp_path / "x.mbsdf").read_bytes()


def changed_head(content: bytes, *head: int) -> bytes:
    at = content.index(MARK) + len(MARK)
    return content[:at] + struct.pack("<3I", *head) + content[at + 12 :]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (
            lambda content: content[1:],
            "not an MBSDF file; found 'VIDIA ARC MBSDF V1.*; accepted: a first line 'NVIDIA ARC MBSDF V1'",
        ),
        (lambda content: content.replace(b"REFLECTION=", b"REFLECTIVE="), "no block of reflected light"),
        (lambda content: content.replace(b"DATA_REFLECTION=", b"DATA_TRANSMISSION="), "transmitted light alone"),
        (lambda content: changed_head(content, 7, 4, 4), "unknown type"),
        (lambda content: changed_head(content, 0, 1000, 1000), "out of range"),
        (lambda content: changed_head(content, 1, 2**32 - 1, 2**32 - 1), "out of range"),
        (lambda content: changed_head(content, 0, 0, 90), "out of range"),
        (lambda content: changed_head(content, 0, 300, 300), "ends early"),
        (lambda content: content[:-1], "ends early"),
        (lambda content: content + b"MBSDF_DATA", "unexpected content"),
        (lambda content: content[:-4] + struct.pack("<f", np.inf), "not finite"),
        (lambda content: content[: content.index(MARK) + len(MARK) + 5], "ends early"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused_with_what_was_found(file, tmp_path, damage, message):
    (tmp_path / "bad.mbsdf").write_bytes(damage(file.read_bytes()))
    with pytest.raises(InputError, match=message):
        read(tmp_path / "bad.mbsdf")


def test_a_block_of_transmitted_light_is_named(file, tmp_path):
    block = b"MBSDF_DATA_TRANSMISSION=\n" + struct.pack("<3I8f", 0, 2, 2, *[0.1] * 8)
    (tmp_path / "both.mbsdf").write_bytes(file.read_bytes() + block)
    assert "transmitted light of the file was not read" in read(tmp_path / "both.mbsdf").attrs["history"]


@pytest.mark.parametrize("count", [40, pytest.param(300, marks=pytest.mark.slow)])
def test_mutated_files_are_read_or_refused_and_never_crash(tmp_path, grey, count):
    write(grey, tmp_path / "small.mbsdf", colour=True, tolerance=1.0, albedo_tolerance=1.0, largest=1024)
    generator, content = np.random.default_rng(2), (tmp_path / "small.mbsdf").read_bytes()
    head = content.index(MARK) + len(MARK) + 12
    for number in range(count):
        damaged = bytearray(content)
        match number % 4:
            case 0:
                damaged = damaged[: generator.integers(1, len(damaged))]
            case 1:
                damaged[generator.integers(0, head)] = generator.integers(0, 256)
            case 2:
                start = generator.integers(0, len(damaged) - 300)
                del damaged[start : start + generator.integers(1, 300)]
            case _:
                start = generator.integers(head - 30, len(damaged) - 8)
                damaged[start : start + 8] = generator.integers(0, 256, 8).astype(np.uint8).tobytes()
        (tmp_path / "x.mbsdf").write_bytes(damaged)
        try:
            found = read(tmp_path / "x.mbsdf")
        except InputError:
            continue
        assert np.isfinite(found["brdf"].values).all()


def test_a_real_car_paint_has_negative_values_and_is_not_reciprocal(shared_data):
    back = read(shared_data / "bsdf" / "carpaint_red.mbsdf")
    warnings = json.loads(back.attrs["warnings"])
    # A third of the cells are redder than a screen can be. Only where Y or Z is negative is no colour.
    assert any("of 182250 cells are negative" in text for text in warnings)
    content = (shared_data / "bsdf" / "carpaint_red.mbsdf").read_bytes()
    values = np.frombuffer(content, "<f4", offset=55).reshape(-1, 3)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])  # IEC 61966-2-1
    expected = (values @ to_xyz.T < 0).any(axis=-1).mean()
    assert float((back["brdf_quality"] == vocabulary.quality("clamped")).mean()) == pytest.approx(expected, abs=1e-4)
    assert [back.sizes[name] for name in ("theta_i", "theta_o", "phi_o", "component")] == [45, 45, 90, 3]
    # The first cell is 0.1158447, -0.0018298, 0.0390520.
    red, green, blue = struct.unpack("<3f", content[55:67])
    assert float(back["brdf"][0, 0, 0]) == pytest.approx(0.2126 * red + 0.7152 * green + 0.0722 * blue, rel=1e-3)
    assert back["brdf_xyz"].values[0, 0, 0, 0] > back["brdf_xyz"].values[0, 0, 0, 2]
