"""Tensor trees: read back by this package, cell by cell by rules of the format alone, and by Radiance."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
import samples
from loaded_by_radiance import load

from brdfpipe import facets
from brdfpipe.bsdf import slab
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import error_of, fresh_pairs
from brdfpipe.errors import InputError
from brdfpipe.exchange import tensor_tree
from brdfpipe.exchange.reading import read
from brdfpipe.exchange.registry import write

SMALL = {"largest": 20_000}


@pytest.fixture(scope="module")
def grey():
    return samples.beckmann_bsdf(0.25).assign_attrs(material="grey", digest="abc")


@pytest.fixture(scope="module")
def file(grey, tmp_path_factory):
    path = tmp_path_factory.mktemp("tree") / "grey.tree.xml"
    write(grey, path, **SMALL)
    return path


def parsed(text: str):
    """Nested lists of the braces of a tree; a leaf is a list of numbers."""
    return json.loads(re.sub(r"(?<=[\]\d])\s+(?=[\[\d])", ",", text.strip().replace("{", "[").replace("}", "]")))


def at(tree, place):
    """Value of a place in the unit cube, by the rule of Radiance's lookup."""
    place = list(place)
    while isinstance(tree[0], list):
        number = 0
        for axis in range(len(place)):
            place[axis] *= 2
            if place[axis] >= 1:
                number |= 1 << axis
                place[axis] -= 1
        tree = tree[number]
    assert len(tree) == 1
    return tree[0]


def data_of(path: Path) -> dict[str, list]:
    root = ElementTree.parse(path).getroot()
    blocks = root.iter("{http://windows.lbl.gov}WavelengthDataBlock")
    return {
        block.findtext("{*}WavelengthDataDirection"): parsed(block.findtext("{*}ScatteringData")) for block in blocks
    }


def test_the_square_is_that_of_shirley_and_chiu():
    # Corners of the square are azimuths of 45 degree on the horizon; rings are square.
    theta, phi = tensor_tree.directions_of(np.array([1.0, 1.0, 0.5, 0.0]), np.array([0.5, 1.0, 0.75, 0.5]))
    assert theta == pytest.approx([90, 90, 30, 90])
    assert phi == pytest.approx([0, 45, 90, 180])
    generator = np.random.default_rng(0)
    x, y = generator.random((2, 500))
    back = tensor_tree.square_of(*tensor_tree.directions_of(x, y))
    assert np.abs(np.stack(back) - [x, y]).max() < 1e-12
    # Equal areas are equal projected solid angles.
    inside = tensor_tree.directions_of(*generator.random((2, 100_000)))[0] < 30
    assert inside.mean() == pytest.approx(0.25, abs=0.006)


def test_the_file_read_back_errs_by_what_its_record_says(grey, file):
    record = json.loads(Path(f"{file}.json").read_text())
    model = grey.bsdf.nonspectral()
    found = error_of(model, representation(read(file)).evaluate, fresh_pairs(model, 11, incidences=24))
    assert found.percentile_95 <= 1.4 * record["error"]["percentile_95"]
    assert found.albedo <= record["error"]["albedo"] + 5e-3


def test_a_cell_holds_the_mean_of_its_directions(grey, file):
    tree, plain = data_of(file)["Reflection Back"], grey.bsdf.nonspectral()
    depth = 5
    assert tree[1] == tree[3] == [0]
    generator = np.random.default_rng(4)
    for place in ((0.2, 0.9, 0.5), (0.1, 0.8, 0.55), (0.4, 0.3, 0.7)):
        low = np.floor(np.array(place) * 2**depth) / 2**depth
        drawn = low[:, None] + generator.random((3, 4000)) / 2**depth
        theta_o, phi_o = tensor_tree.directions_of(drawn[1], drawn[2])
        theta_i = np.degrees(np.arcsin(1 - 2 * drawn[0]))
        # The mirror direction has the azimuth 0 on the outgoing square.
        values = plain.bsdf.evaluate(theta_i, 180.0, theta_o, phi_o).values
        assert at(tree, place) == pytest.approx(values.mean(), rel=0.03)


def test_a_tree_keeps_to_its_size_and_is_finer_at_the_lobe(file):
    text = file.read_text()
    assert text.count("{") < 1.2 * 20_000
    record = json.loads(Path(f"{file}.json").read_text())
    assert record["values"] <= 20_000


def test_even_light_is_one_leaf(tmp_path):
    even = samples.beckmann_bsdf(0.3, n=1.0001, reflectance=0.5)
    write(even, tmp_path / "even.tree.xml")
    assert json.loads((tmp_path / "even.tree.xml.json").read_text())["values"] < 500


def test_a_sheet_has_light_that_passes_and_keeps_it(tmp_path):
    rough = facets.analytic("beckmann", 0.3)
    sheet = slab.build(rough, rough, index=1.5, internal_transmittance=0.9)
    write(sheet, tmp_path / "sheet.tree.xml", largest=40_000)
    assert set(data_of(tmp_path / "sheet.tree.xml")) == {"Reflection Back", "Transmission Back"}
    back, plain = read(tmp_path / "sheet.tree.xml"), sheet.bsdf.nonspectral()
    assert float(back.bsdf.transmittance(30.0)) == pytest.approx(float(plain.bsdf.transmittance(30.0)), rel=0.03)
    assert float(back.bsdf.evaluate(30, 40, 150, 220)) == pytest.approx(
        float(plain.bsdf.evaluate(30, 40, 150, 220)), rel=0.2
    )


def test_a_lay_is_kept(tmp_path):
    brushed = samples.brushed_bsdf(0.5, 0.3)
    write(brushed, tmp_path / "brushed.tree.xml", largest=8_192, tolerance=0.2)
    tree, plain = data_of(tmp_path / "brushed.tree.xml")["Reflection Back"], brushed.bsdf.nonspectral()
    assert len(tree) == 16
    back = read(tmp_path / "brushed.tree.xml")
    for phi in (0.0, 90.0):
        # Light from azimuth phi has its reversed vector on the first square.
        incident = [float(one[0]) for one in tensor_tree.square_of(np.array([25.0]), np.array([phi + 180.0]))]
        outgoing = [float(one[0]) for one in tensor_tree.square_of(np.array([10.0]), np.array([phi + 30.0]))]
        value = at(tree, incident + outgoing)
        assert value == pytest.approx(float(plain.bsdf.evaluate(25, phi, 10, phi + 30)), rel=0.35)
        assert float(back.bsdf.evaluate(25, phi, 10, phi + 30)) == pytest.approx(value, rel=0.35)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (">TensorTree3<", ">TensorTree5<", "not a tensor tree"),
        ("LBNL/Shirley-Chiu", "LBNL/Klems Full", "unknown angle basis"),
        ("<ScatteringData>\n{", "<ScatteringData>\n", "outside|too many|closes no|goes on|ends early"),
        ("<ScatteringData>\n{", "<ScatteringData>\n{{", "too many|closes no|ends early"),
        ("}\n</ScatteringData>", "</ScatteringData>", "ends early"),
        ("}\n</ScatteringData>", "}{1}\n</ScatteringData>", "goes on"),
        ("{0}", "{0 1}", "finite values"),
        ("{0}", "{x}", "not a number"),
        ("{0}", "{1e40}", "finite values"),
        ("{0}", "{" * 40 + "0" + "}" * 40, "too deep.*at most 7"),
        ("Reflection Back", "Reflection Front", "no reflection"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused_with_what_was_found(file, tmp_path, old, new, message):
    text = file.read_text()
    assert old in text
    (tmp_path / "bad.xml").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read(tmp_path / "bad.xml", "tensor-tree")


def test_a_leaf_may_be_a_grid(file, tmp_path):
    grid = " ".join(str(0.1 * (1 + number)) for number in range(8))
    text = re.sub(
        r"(?s)<ScatteringData>.*</ScatteringData>", f"<ScatteringData>{{{grid}}}</ScatteringData>", file.read_text()
    )
    (tmp_path / "grid.xml").write_text(text)
    # A grid counts its last axis fastest: outgoing place (0.75, 0.25) is number 2 of the lower half.
    back = read(tmp_path / "grid.xml")
    assert float(back.bsdf.evaluate(10, 0, 30, 180 - 45)) == pytest.approx(0.3, rel=0.5)
    assert float(back["brdf"].max()) <= 0.4001


@pytest.mark.parametrize("count", [30, pytest.param(300, marks=pytest.mark.slow)])
def test_mutated_files_are_read_or_refused_and_never_crash(tmp_path, count):
    generator = np.random.default_rng(2)
    write(samples.beckmann_bsdf(0.5), tmp_path / "x.tree.xml", largest=5_000, tolerance=0.3)
    content = (tmp_path / "x.tree.xml").read_bytes()
    begin = content.index(b"<ScatteringData>")
    refused = 0
    for number in range(count):
        damaged = bytearray(content)
        match number % 4:
            case 0:
                damaged = damaged[: generator.integers(1, len(damaged))]
            case 1:
                damaged[generator.integers(0, begin)] = generator.integers(0, 256)
            case 2:
                start = generator.integers(0, len(damaged) - 300)
                del damaged[start : start + generator.integers(1, 300)]
            case _:
                start = generator.integers(begin, len(damaged) - 8)
                damaged[start : start + 8] = generator.choice(np.frombuffer(b"{}0123456789.e ", np.uint8), 8).tobytes()
        (tmp_path / "bad.xml").write_bytes(damaged)
        try:
            found = read(tmp_path / "bad.xml", "tensor-tree")
        except InputError:
            refused += 1
            continue
        assert np.isfinite(found["brdf"].values).all()
    assert refused >= count / 4


def test_radiance_reads_the_light_that_the_model_reflects(grey, tmp_path):
    radiance = pytest.importorskip("pyradiance.bsdf", reason="pyradiance is not there")
    write(grey, tmp_path / "grey.tree.xml")
    loaded, plain = load(radiance, tmp_path / "grey.tree.xml"), grey.bsdf.nonspectral()
    for theta in (0.0, 30.0, 60.0):
        total = radiance.direct_hemi(loaded, theta, 20.0, radiance.SAMPLE_ALL)
        assert total == pytest.approx(float(plain.bsdf.albedo(theta)), rel=0.01)
    # Off the plane of incidence, where a wrong azimuth would show.
    expected = float(plain.bsdf.evaluate(40, 70, 50, 190))
    assert radiance.query(loaded, 40.0, 70.0, 50.0, 190.0)[1] == pytest.approx(expected, rel=0.1)


@pytest.mark.slow
def test_radiance_reads_a_lay_and_light_that_passes(tmp_path):
    radiance = pytest.importorskip("pyradiance.bsdf", reason="pyradiance is not there")
    rough = facets.analytic("beckmann", 0.3)
    sheet = slab.build(rough, rough, index=1.5, internal_transmittance=0.9)
    write(sheet, tmp_path / "sheet.tree.xml")
    both, plain = load(radiance, tmp_path / "sheet.tree.xml"), sheet.bsdf.nonspectral()
    total = float(plain.bsdf.albedo(30.0) + plain.bsdf.transmittance(30.0))
    assert radiance.direct_hemi(both, 30.0, 0.0, radiance.SAMPLE_ALL) == pytest.approx(total, rel=0.01)
    brushed = samples.brushed_bsdf(0.5, 0.3)
    write(brushed, tmp_path / "brushed.tree.xml", tolerance=0.1)
    loaded, plain = load(radiance, tmp_path / "brushed.tree.xml"), brushed.bsdf.nonspectral()
    for phi in (0.0, 90.0):
        expected = float(plain.bsdf.evaluate(25, phi, 10, phi + 30))
        assert radiance.query(loaded, 25.0, phi, 10.0, phi + 30)[1] == pytest.approx(expected, rel=0.25)
        assert radiance.direct_hemi(loaded, 25.0, phi, radiance.SAMPLE_ALL) == pytest.approx(
            float(plain.bsdf.albedo(25.0, phi)), rel=0.05
        )
