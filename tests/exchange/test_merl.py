"""MERL tables: read back by this package, and by the lookup of the database's own reader."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import samples

from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import error_of, fresh_pairs
from brdfpipe.errors import InputError
from brdfpipe.exchange.reading import read
from brdfpipe.exchange.registry import write
from brdfpipe.geometry import unit_vector

SIZE = 12 + 8 * 3 * 90 * 90 * 180


@pytest.fixture(scope="module")
def grey():
    return samples.beckmann_bsdf(0.2).assign_attrs(material="grey", digest="abc")


@pytest.fixture(scope="module")
def file(grey, tmp_path_factory):
    path = tmp_path_factory.mktemp("merl") / "grey.binary"
    write(grey, path)
    return path


def at_node(content: bytes, i: int, j: int, k: int) -> np.ndarray:
    """Red, green and blue of a node, as BRDFRead.cpp finds them."""
    index = k + 180 * (j + 90 * i)
    stored = [struct.unpack_from("<d", content, 12 + 8 * (index + plane * 90 * 90 * 180))[0] for plane in range(3)]
    return np.array(stored) * [1 / 1500, 1.15 / 1500, 1.66 / 1500]


def directions(theta_h: float, theta_d: float, phi_d: float) -> tuple[float, float, float, float]:
    """θ_i, φ_i, θ_o and φ_o of half-angle coordinates, by turning the half vector back as the paper does."""
    difference = unit_vector(theta_d, phi_d)
    cosine, sine = np.cos(np.radians(theta_h)), np.sin(np.radians(theta_h))
    turn = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
    w_i, half = turn @ difference, turn @ [0.0, 0.0, 1.0]
    w_o = 2 * (w_i @ half) * half - w_i
    angles = [(np.degrees(np.arccos(w[2])), np.degrees(np.arctan2(w[1], w[0]))) for w in (w_i, w_o)]
    return *angles[0], *angles[1]


def test_a_program_that_interpolates_errs_by_what_the_record_says(grey, file):
    error = json.loads(Path(f"{file}.json").read_text())["error"]
    model = grey.bsdf.nonspectral()
    found = error_of(model, representation(nonspectral(read(file))).evaluate, fresh_pairs(model, 11, incidences=24))
    assert found.percentile_95 <= 1.4 * error["interpolated"]["percentile_95"] + 1e-4
    assert found.albedo <= error["interpolated"]["albedo"] + 5e-4
    # Cells of one degree in a lobe of slope 0.2: the curvature within half a cell.
    assert error["interpolated"]["percentile_95"] < 0.005


def test_the_lookup_of_the_database_errs_by_what_the_record_says(grey, file):
    record, content = json.loads(Path(f"{file}.json").read_text()), file.read_bytes()
    model = grey.bsdf.nonspectral()
    pairs = fresh_pairs(model, 12)
    chosen = np.random.default_rng(3).choice(pairs.theta_o.size, 400, replace=False)
    errors = []
    for at in zip(*(angles[chosen] for angles in pairs), strict=True):
        w_i, w_o = unit_vector(at[0], at[1]), unit_vector(at[2], at[3])
        half = (w_i + w_o) / np.linalg.norm(w_i + w_o)
        theta_h, theta_d = np.degrees(np.arccos(half[2])), np.degrees(np.arccos(min(w_i @ half, 1.0)))
        x_axis = unit_vector(theta_h + 90, np.degrees(np.arctan2(half[1], half[0])))
        phi_d = np.degrees(np.arctan2(w_i @ np.cross(half, x_axis), w_i @ x_axis)) % 180
        found = at_node(content, int(np.sqrt(theta_h / 90) * 90), int(theta_d), int(phi_d) % 180)[1]
        given, cosine = float(model.bsdf.evaluate(*at)), np.cos(np.radians(at[2]))
        errors.append(abs(found - given) * cosine / max(given * cosine, 1e-3))
    assert np.quantile(errors, 0.95) == pytest.approx(record["error"]["percentile_95"], rel=0.35)


@pytest.mark.parametrize("node", [(0, 30, 0), (20, 30, 0), (20, 30, 90), (40, 10, 45), (60, 20, 135)])
def test_a_node_is_the_brdf_at_its_half_angles(grey, file, node):
    i, j, k = node
    expected = float(grey.bsdf.nonspectral().bsdf.evaluate(*directions(i * i / 90, j, k)))
    assert at_node(file.read_bytes(), *node) == pytest.approx(expected, rel=1e-3)


def test_the_header_and_the_length_are_those_of_the_database(file):
    assert struct.unpack("<3i", file.read_bytes()[:12]) == (90, 90, 180)
    assert file.stat().st_size == SIZE


def test_the_record_says_what_the_file_leaves_out(file):
    record = json.loads(Path(f"{file}.json").read_text())
    assert set(record["left_out"]) == {"spectrum", "polarisation"}
    assert "within_tolerance" not in record["error"]


def test_colours_are_red_green_and_blue(tmp_path):
    red = samples.beckmann_bsdf(0.3, reflectance=np.linspace(0.05, 0.6, samples.WAVELENGTH.size))
    write(red, tmp_path / "red.binary")
    value = at_node((tmp_path / "red.binary").read_bytes(), 50, 20, 60)
    assert value[0] > value[1] > value[2] > 0


def test_negative_values_are_invalid_and_filled_from_their_neighbours(file, tmp_path):
    content = bytearray(file.read_bytes())
    struct.pack_into("<d", content, 12 + 8 * (45 + 180 * (20 + 90 * 30)), -1.0)
    (tmp_path / "x.binary").write_bytes(content)
    back, whole = read(tmp_path / "x.binary"), read(file)
    assert any("1 of" in text and "no value" in text for text in json.loads(back.attrs["warnings"]))
    assert float(back["brdf"][30, 20, 45]) == pytest.approx(float(whole["brdf"][30, 20, 45]), rel=0.01)
    assert int(back["brdf_quality"][30, 20, 45]) != 0


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda content: content[:-1], "wrong length"),
        (lambda content: content + b"\0", "wrong length"),
        (lambda content: content[:5], "not a MERL table"),
        (lambda content: struct.pack("<3i", 1000, 1000, 1000) + content[12:], "not a MERL table"),
        (lambda content: struct.pack("<3i", 90, 90, -180) + content[12:], "not a MERL table"),
        (lambda content: content[:-8] + struct.pack("<d", np.inf), "not finite"),
        (lambda content: content[:12] + struct.pack("<d", 1e300) + content[20:], "not finite"),
        (lambda content: content[:12] + b"\xff" * (SIZE - 12), "no cell has a value"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused_with_what_was_found(file, tmp_path, damage, message):
    (tmp_path / "bad.binary").write_bytes(damage(file.read_bytes()))
    with pytest.raises(InputError, match=message):
        read(tmp_path / "bad.binary")


@pytest.mark.parametrize("count", [8, pytest.param(300, marks=pytest.mark.slow)])
def test_mutated_files_are_read_or_refused_and_never_crash(file, tmp_path, count):
    generator, path = np.random.default_rng(2), tmp_path / "x.binary"
    path.write_bytes(file.read_bytes())
    for number in range(count):
        # Every other damage is in the header or changes the length; it is repaired in place.
        place = int(generator.integers(0, 12) if number % 4 == 1 else generator.integers(12, SIZE - 8))
        with path.open("r+b") as opened:
            opened.seek(place)
            before = opened.read(8)
            opened.seek(place)
            opened.write(generator.integers(0, 256, 8).astype(np.uint8).tobytes())
            if number % 4 == 3:
                opened.truncate(int(generator.integers(0, SIZE)))
        try:
            found = read(path)
        except InputError:
            pass
        else:
            assert np.isfinite(found["brdf"].values).all()
        if number % 4 == 3:
            path.write_bytes(file.read_bytes())
        else:
            with path.open("r+b") as opened:
                opened.seek(place)
                opened.write(before)
