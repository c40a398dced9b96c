"""LightTools files: read back by this package, and cell by cell by rules of the format alone."""

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

HEADER = """\
# by hand
Symmetry Asymmetric
SpectralContent {content}
ScatterAzimuth {azimuth}
ScatterRadial 3
0 45 90
DataBegin
"""
BLOCK = "AOI {aoi}\nPOI {poi}\nSide {side}\nWavelength {nm}\nScatterType {type}\nTIS 0.3\n{rows}"


@pytest.fixture(scope="module")
def grey():
    return samples.beckmann_bsdf(0.2).assign_attrs(material="grey", digest="abc")


@pytest.fixture(scope="module")
def file(grey, tmp_path_factory):
    path = tmp_path_factory.mktemp("lighttools") / "grey.lighttools.bsdf"
    write(grey, path, **COARSE)
    return path


def blocks_of(path: Path) -> tuple[np.ndarray, np.ndarray, list[tuple[dict[str, str], np.ndarray]]]:
    """Azimuths, radial angles, and the words and values (azimuth, radial) of each block, read by the rules of the format."""
    lines = [line.split() for line in path.read_text().splitlines() if not line.startswith("#")]
    heads = {line[0]: number for number, line in enumerate(lines)}
    azimuth, radial = (np.array(lines[heads[name] + 1], dtype=float) for name in ("ScatterAzimuth", "ScatterRadial"))
    blocks, words = [], {}
    number = heads["DataBegin"] + 1
    while lines[number] != ["DataEnd"]:
        words[lines[number][0]] = lines[number][1]
        number += 1
        if "TIS" in words:
            blocks.append((words, np.array(lines[number : number + azimuth.size], dtype=float)))
            words, number = {}, number + azimuth.size
    return azimuth, radial, blocks


def check_cells(model, path: Path, limit: float) -> int:
    """The source is at azimuth 90 and the mirror direction at 270, seen from above counter-clockwise; how many cells were compared."""
    azimuth, radial, blocks = blocks_of(path)
    generator, compared = np.random.default_rng(3), 0
    for _ in range(200):
        words, values = blocks[generator.integers(len(blocks))]
        row, column = generator.integers(azimuth.size), generator.integers(radial.size)
        if radial[column] > 85 or azimuth[row] in (0.0, 360.0):
            continue
        aoi, poi = float(words["AOI"]), float(words["POI"])
        expected = model.bsdf.evaluate(aoi, poi, radial[column], poi + azimuth[row] - 90).item()
        assert values[row, column] == pytest.approx(expected, rel=limit), (words, azimuth[row], radial[column])
        compared += 1
    return compared


def test_the_file_read_back_errs_by_what_its_record_says(grey, file):
    record = json.loads(Path(f"{file}.json").read_text())
    model = grey.bsdf.nonspectral()
    found = error_of(model, representation(read(file)).evaluate, fresh_pairs(model, 11, incidences=24))
    assert found.percentile_95 <= 1.4 * record["error"]["percentile_95"] + 1e-4
    assert found.albedo <= record["error"]["albedo"] + 5e-4
    assert record["error"]["within_tolerance"]


def test_cells_are_the_directions_about_the_normal_with_the_source_at_90(grey, file):
    # Values are scaled by at most the tolerance, at grazing incidence by all of it, and rounded.
    assert check_cells(grey.bsdf.nonspectral(), file, 0.1001) > 100
    azimuth, _, blocks = blocks_of(file)
    assert (azimuth[0], azimuth[-1]) == (0.0, 360.0)
    steep = next(values for words, values in blocks if float(words["AOI"]) > 60)
    assert azimuth[steep.max(axis=1).argmax()] == 270


def test_azimuths_0_and_360_are_one_direction_between_their_neighbours(file):
    azimuth, _, blocks = blocks_of(file)
    for _, values in blocks:
        assert values[0] == pytest.approx(values[-1], rel=1e-4)
        share = (360 - azimuth[-2]) / (360 - azimuth[-2] + azimuth[1])
        assert values[0] == pytest.approx((1 - share) * values[-2] + share * values[1], rel=3e-4)


def test_tis_is_the_reflectance_of_the_model(grey, file):
    words = [words for words, _ in blocks_of(file)[2] if float(words["AOI"]) < 80]
    albedo = grey.bsdf.nonspectral().bsdf.albedo([float(block["AOI"]) for block in words]).values
    assert [float(block["TIS"]) for block in words] == pytest.approx(albedo.tolist(), rel=0.02)
    assert "declare" not in read(file).attrs.get("warnings", "")


def test_comments_and_record_say_what_the_file_leaves_out(file):
    assert set(json.loads(Path(f"{file}.json").read_text())["left_out"]) == {"spectrum", "polarisation"}
    comments = [line for line in file.read_text().splitlines() if line.startswith("#")]
    assert any("polarisation" in line for line in comments)
    assert any("the source is at 90" in line for line in comments)


def test_the_format_is_told_from_that_of_zemax(grey, file, tmp_path):
    write(grey, tmp_path / "grey.zemax.bsdf", **COARSE)
    (tmp_path / "renamed.bsdf").write_bytes(file.read_bytes())
    assert format_of(tmp_path / "renamed.bsdf").name == "lighttools"
    assert format_of(tmp_path / "grey.zemax.bsdf").name == "zemax"


def test_colours_are_blocks_of_tristimulus_values(tmp_path):
    red = samples.beckmann_bsdf(0.3, reflectance=np.linspace(0.05, 0.6, samples.WAVELENGTH.size))
    write(red, tmp_path / "red.lighttools.bsdf", colour=True, **COARSE)
    words = [words["TristimulusValue"] for words, _ in blocks_of(tmp_path / "red.lighttools.bsdf")[2]]
    assert words[:4] == ["TrisX", "TrisY", "TrisZ", "TrisX"]
    back = read(tmp_path / "red.lighttools.bsdf")
    at = 30.0, 0.0, 10.0, 90.0
    assert float(back.bsdf.nonspectral().bsdf.evaluate(*at)) == pytest.approx(
        float(red.bsdf.nonspectral().bsdf.evaluate(*at)), rel=0.1
    )
    found = representation(back).tristimulus(*(np.array([angle]) for angle in at), "D65", 2)
    assert found[0, 0] > found[0, 2]


def test_a_lay_becomes_planes_of_incidence(tmp_path):
    brushed = samples.brushed_bsdf(0.3, 0.15, 25.0)
    path = tmp_path / "brushed.lighttools.bsdf"
    write(brushed, path, tolerance=0.3, albedo_tolerance=0.2, largest=100_000)
    model = brushed.bsdf.nonspectral()
    # Values are scaled by at most the tolerance, and rounded; azimuths differ by far more.
    assert check_cells(model, path, 0.3001) > 100
    back = read(path)
    at = [(40, phi, 25, phi + 150) for phi in (25.0, 70.0, 115.0, 160.0)]
    found, wanted = ([float(bsdf.bsdf.evaluate(*angles)) for angles in at] for bsdf in (back, model))
    assert found == pytest.approx(wanted, rel=0.3)
    assert max(wanted) > 2 * min(wanted)


def by_hand(tmp_path: Path, *blocks: str, content="Monochrome", azimuth="4\n0 90 180 270") -> Path:
    text = HEADER.format(content=content, azimuth=azimuth) + "".join(blocks) + "DataEnd\n"
    (tmp_path / "hand.bsdf").write_text(text)
    return tmp_path / "hand.bsdf"


def block(aoi=0, poi=0, side="Front", nm=555, type="BRDF", rows="1 1 1\n2 2 2\n3 3 3\n4 4 4\n") -> str:
    return BLOCK.format(aoi=aoi, poi=poi, side=side, nm=nm, type=type, rows=rows)


def test_azimuths_of_other_files_are_turned(tmp_path):
    back = read(by_hand(tmp_path, block(0), block(60)))
    # Rows at 0, 90, 180, 270: beside, towards the source, on the other side, the mirror direction.
    found = [float(back.bsdf.evaluate(30, 20, 30, 20 + phi)) for phi in (270, 0, 90, 180)]
    assert found == pytest.approx([1, 2, 3, 4])


def test_half_circles_are_mirrored_about_the_plane_of_incidence(tmp_path):
    rows = "1 1 1\n2 2 2\n4 4 4\n"
    for azimuth, towards_source in (("3\n90 180 270", 1), ("3 -90 0 90", 4)):
        back = read(by_hand(tmp_path, block(0, rows=rows), block(60, rows=rows), azimuth=azimuth))
        found = [float(back.bsdf.evaluate(30, 0, 30, phi)) for phi in (0, 90, 180, 270)]
        assert found == pytest.approx([towards_source, 2, 5 - towards_source, 2])


def test_wavelengths_become_a_spectrum_and_other_sides_are_passed_over(tmp_path):
    other = block(0, side="Back"), block(0, type="BTDF")
    lit = [block(aoi, nm=nm, rows=f"{nm} {nm} {nm}\n" * 4) for aoi in (0, 60) for nm in (650, 450)]
    back = read(by_hand(tmp_path, *lit, *other))
    assert back["wavelength"].values.tolist() == [450, 650]
    assert back.bsdf.evaluate(30, 0, 30, 10).values == pytest.approx([450, 650])
    assert "2 blocks" in back.attrs["history"]


@pytest.mark.parametrize(
    ("blocks", "message"),
    [
        ([block(0), block(0)], "line .*appears twice"),
        ([block(0), block(60), block(0, poi=90)], "no grid"),
        ([block(0), block(120)], "no grid"),
        ([block(0, side="Back")], "no block"),
        ([block(0).replace("AOI 0\n", "")], "line .*no AOI"),
    ],
)
def test_blocks_that_are_no_grid_are_refused(tmp_path, blocks, message):
    with pytest.raises(InputError, match=message):
        read(by_hand(tmp_path, *blocks), "lighttools")


@pytest.mark.parametrize(("option", "value"), [("tolerance", 0.0), ("albedo_tolerance", 2.0), ("largest", 5)])
def test_options_out_of_range_are_refused(grey, tmp_path, option, value):
    with pytest.raises(ExchangeError, match=option):
        write(grey, tmp_path / "grey.lighttools.bsdf", **{option: value})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("SpectralContent Monochrome", "SpectralContent Infrared", "line .*SpectralContent"),
        ("SpectralContent Monochrome", "SpectralContent XYZ", "line .*TristimulusValue"),
        ("DataBegin", "DataBgin", "line .*unknown word"),
        ("TIS", "SIT", "line .*unknown word"),
        ("AOI 0", "AOI x", "line .*not a number"),
        ("ScatterRadial ", "ScatterRadial 9", "line .*(numbers|out of range)"),
        ("e-0", "e-x", "line .*not a number"),
        ("DataEnd", "", "ends early"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused_with_its_line(file, tmp_path, old, new, message):
    text = file.read_text()
    assert old in text
    (tmp_path / "bad.bsdf").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read(tmp_path / "bad.bsdf", "lighttools")


@pytest.mark.parametrize("count", [40, pytest.param(300, marks=pytest.mark.slow)])
def test_garbled_files_are_read_or_refused_and_never_crash(file, tmp_path, count):
    check_garbled_files(file.read_bytes(), tmp_path / "x.bsdf", "lighttools", count)
