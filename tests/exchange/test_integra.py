"""Integra's files: read back by this package, and cell by cell by rules of the format alone."""

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
from brdfpipe.exchange.reading import read
from brdfpipe.exchange.registry import ExchangeError, write
from brdfpipe.geometry import angles_of

COARSE = {"tolerance": 0.1, "albedo_tolerance": 0.02, "largest": 60_000}

HAND = """\
;; by hand
Source Measured
TypeSym {symmetry}
TypeColorModel {model}
TypeData {data}
sigma 2
 0 60
phi {phi}
theta 3
 0 90 180
"""


@pytest.fixture(scope="module")
def grey():
    return samples.beckmann_bsdf(0.2).assign_attrs(material="grey", digest="abc")


@pytest.fixture(scope="module")
def file(grey, tmp_path_factory):
    path = tmp_path_factory.mktemp("integra") / "grey.ddr"
    write(grey, path, **COARSE)
    return path


def channels(path: Path) -> tuple[dict[str, np.ndarray], dict[str, tuple[np.ndarray, np.ndarray]]]:
    """Lists of the header; and kbdf (psi, sigma) and values (psi, sigma, phi, theta) of each channel, read by the rules of the format."""
    words = " ".join(line for line in path.read_text().splitlines() if not line.startswith(";;")).split()
    lists, found = {"psi": np.zeros(1)}, {}
    for name in ("psi", "sigma", "phi", "theta"):
        if name in words:
            at, count = words.index(name) + 2, int(words[words.index(name) + 1])
            lists[name] = np.array(words[at : at + count], dtype=float)
    shape = tuple(lists[name].size for name in ("psi", "sigma", "phi", "theta"))
    for start in (number for number, word in enumerate(words) if word == "kbdf"):
        kbdf = np.array(words[start + 1 : start + 1 + shape[0] * shape[1]], dtype=float).reshape(shape[:2])
        begin = words.index("def", start) + 1
        values = np.array(words[begin : words.index("enddef", begin)], dtype=float).reshape(shape)
        name = words[start - 1] if words[start - 2] != "wl" else f"wl {words[start - 1]}"
        found[name] = kbdf, values
    return lists, found


def direction(sigma: float, psi: float, phi: float, theta: float) -> tuple[float, float]:
    """θ_o and φ_o [degree] of a cell: polar coordinates about the specular ray, azimuth 0 towards the normal, counter-clockwise."""
    s, p, t, a = np.radians([sigma, phi, theta, psi])
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    specular, upwards = np.array([-np.sin(s), 0, np.cos(s)]), np.array([np.cos(s), 0, np.sin(s)])
    around = np.cos(p) * upwards + np.sin(p) * np.cross(specular, upwards)
    theta_o, phi_o = angles_of(turn @ (np.cos(t) * specular + np.sin(t) * around))
    return float(theta_o), float(phi_o)


def check_cells(model, path: Path, name: str, limit: float) -> int:
    """BRDF = value·kbdf/π at some cells above the horizon; how many were compared."""
    lists, found = channels(path)
    kbdf, values = found[name]
    compared, generator = 0, np.random.default_rng(3)
    for _ in range(400):
        index = tuple(generator.integers(0, size) for size in values.shape)
        psi, sigma, phi, theta = (axis[place] for axis, place in zip(lists.values(), index, strict=True))
        theta_o, phi_o = direction(sigma, psi, phi, theta)
        if theta_o > 85:
            continue
        expected = model.bsdf.evaluate(sigma, psi, theta_o, phi_o).item()
        assert values[index] * kbdf[index[:2]] / np.pi == pytest.approx(expected, rel=limit), (sigma, psi, phi, theta)
        compared += 1
    return compared


def test_the_file_read_back_errs_by_what_its_record_says(grey, file):
    record = json.loads(Path(f"{file}.json").read_text())
    model = grey.bsdf.nonspectral()
    found = error_of(model, representation(read(file)).evaluate, fresh_pairs(model, 11, incidences=24))
    assert found.percentile_95 <= 1.4 * record["error"]["percentile_95"] + 1e-4
    assert found.albedo <= record["error"]["albedo"] + 5e-4
    assert record["error"]["within_tolerance"]


def test_cells_are_the_directions_at_their_angles_from_the_specular_ray(grey, file):
    # The scale of an incidence differs from 1 by at most the tolerance; here by far less.
    assert check_cells(grey.bsdf.nonspectral(), file, "bw", 0.03) > 100


def test_kbdf_is_the_reflectance_and_undeclared_differences_are_absent(grey, file):
    lists, found = channels(file)
    lower = lists["sigma"] < 80
    albedo = grey.bsdf.nonspectral().bsdf.albedo(lists["sigma"][lower]).values
    assert found["bw"][0][0, lower] == pytest.approx(albedo, rel=0.02)
    assert "declare" not in read(file).attrs.get("warnings", "")


def test_comments_and_record_say_what_the_file_leaves_out(file):
    assert set(json.loads(Path(f"{file}.json").read_text())["left_out"]) == {"spectrum", "polarisation"}
    comments = [line for line in file.read_text().splitlines() if line.startswith(";;")]
    assert any("polarisation" in line for line in comments)
    assert any("value kbdf / pi" in line for line in comments)


def test_a_spectral_file_has_a_channel_for_each_wavelength(tmp_path):
    red = samples.beckmann_bsdf(0.3, reflectance=np.linspace(0.05, 0.6, samples.WAVELENGTH.size))
    red = red.sel(wavelength=slice(400, 700, 10))
    write(red, tmp_path / "red.ddr", colour="spectral", **COARSE)
    assert "spectrum" not in json.loads((tmp_path / "red.ddr.json").read_text())["left_out"]
    blue, amber = (red.sel(wavelength=[nm]) for nm in (450.0, 600.0))
    assert check_cells(blue, tmp_path / "red.ddr", "wl 450", 0.04) > 100
    assert check_cells(amber, tmp_path / "red.ddr", "wl 600", 0.04) > 100
    back = read(tmp_path / "red.ddr")
    assert back["wavelength"].values == pytest.approx(red["wavelength"].values)
    at = 40.0, 0.0, 10.0, 90.0
    wanted = red.bsdf.evaluate(*at).values
    assert back.bsdf.evaluate(*at).values == pytest.approx(wanted, rel=0.1)
    assert wanted[-1] > 3 * wanted[0]


def test_colours_are_linear_rgb(tmp_path):
    red = samples.beckmann_bsdf(0.3, reflectance=np.linspace(0.2, 0.6, samples.WAVELENGTH.size))
    write(red, tmp_path / "red.ddr", colour="rgb", **COARSE)
    found = channels(tmp_path / "red.ddr")[1]
    assert list(found) == ["red", "gre", "blu"]
    assert (found["red"][0] > found["gre"][0]).all()
    assert (found["gre"][0] > found["blu"][0]).all()
    at = 30.0, 0.0, 10.0, 90.0
    back = read(tmp_path / "red.ddr")
    # Y of the colours is the BRDF weighted with V(λ) and D65.
    assert float(back.bsdf.nonspectral().bsdf.evaluate(*at)) == pytest.approx(
        float(red.bsdf.nonspectral().bsdf.evaluate(*at)), rel=0.1
    )


def test_a_lay_becomes_azimuths_of_incidence(tmp_path):
    brushed = samples.brushed_bsdf(0.3, 0.15, 25.0)
    write(brushed, tmp_path / "brushed.ddr", tolerance=0.3, albedo_tolerance=0.2, largest=100_000)
    assert "TypeSym ASymmetrical 4D" in (tmp_path / "brushed.ddr").read_text()
    model = brushed.bsdf.nonspectral()
    # Values are scaled by at most the tolerance, and rounded; azimuths of incidence differ by far more.
    assert check_cells(model, tmp_path / "brushed.ddr", "bw", 0.3001) > 100
    back = read(tmp_path / "brushed.ddr")
    at = [(40, phi, 25, phi + 150) for phi in (25.0, 70.0, 115.0, 160.0)]
    found, wanted = ([float(bsdf.bsdf.evaluate(*angles)) for angles in at] for bsdf in (back, model))
    assert found == pytest.approx(wanted, rel=0.3)
    assert max(wanted) > 2 * min(wanted)


def by_hand(tmp_path: Path, data: str, rows: str, *, symmetry="AxiSymmetrical", model="bw", phi="1\n0") -> Path:
    header = HAND.format(symmetry=symmetry, model=model, data=data, phi=phi)
    (tmp_path / "hand.ddr").write_text(header + rows)
    return tmp_path / "hand.ddr"


FLAT = "bw\n kbdf 0.5 0.25\n def\n" + "1 1 1\n" * 2 + "enddef\n"


def test_luminance_values_are_pi_brdf_over_kbdf(tmp_path):
    back = read(by_hand(tmp_path, "Luminance Absolute", FLAT))
    assert float(back.bsdf.evaluate(0, 0, 30, 50)) == pytest.approx(0.5 / np.pi)
    assert float(back.bsdf.evaluate(60, 0, 30, 50)) == pytest.approx(0.25 / np.pi)
    assert "declare" not in back.attrs.get("warnings", "")


def test_intensity_values_hold_the_cosine(tmp_path):
    back = read(by_hand(tmp_path, "Intensity Absolute", FLAT))
    # Value·kbdf = BRDF·cos θ_o; at incidence 0 the nodes are at θ_o 0 and beyond.
    assert float(back.bsdf.evaluate(0, 0, 0, 0)) == pytest.approx(0.5)
    assert float(back.bsdf.evaluate(60, 0, 60, 180)) == pytest.approx(0.25 / np.cos(np.radians(60)))


def test_relative_values_are_scaled_to_kbdf(tmp_path):
    back = read(by_hand(tmp_path, "Luminance Relative", FLAT.replace("1 1 1", "700 700 700")))
    # The reflectance of a constant BRDF is π times it.
    assert float(back.bsdf.evaluate(0, 0, 30, 50)) == pytest.approx(0.5 / np.pi, rel=2e-3)
    assert float(back.bsdf.evaluate(60, 0, 30, 50)) == pytest.approx(0.25 / np.pi, rel=2e-3)
    assert "relative" in back.attrs["history"]


def test_open_circles_and_other_spellings_are_read(tmp_path):
    rows = "".join(f"{name}\nKBDF 1 1\nDEF\n" + "1 1\n1\n" * 8 + "enddef\n" for name in ("red", "green", "blue"))
    back = read(
        by_hand(tmp_path, "luminance absolute", rows, symmetry="asymmetrical", model="rgb", phi="4 0 90 180 270")
    )
    assert back["phi_s"].values[-1] == 360
    assert float(back.bsdf.nonspectral().bsdf.evaluate(0, 0, 30, 300)) == pytest.approx(1 / np.pi)


@pytest.mark.parametrize(("option", "value"), [("colour", "xyz"), ("tolerance", 0.0), ("largest", 5)])
def test_options_out_of_range_are_refused(grey, tmp_path, option, value):
    with pytest.raises(ExchangeError, match=option):
        write(grey, tmp_path / "grey.ddr", **{option: value})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("TypeColorModel BW", "TypeColorModel grey", "line .*TypeColorModel"),
        ("PlaneSymmetrical", "Symmetrical", "line .*TypeSym"),
        ("Luminance Absolute", "Radiance Absolute", "TypeData"),
        ("bw\nkbdf", "red\nkbdf", "line .*bw"),
        ("\ndef\n", "\ndfe\n", "line .*def"),
        ("theta ", "theta 9", "line .*(numbers|out of range)"),
        ("e-0", "e-x", "line .*not a number"),
        ("enddef", "", "enddef"),
        ("sigma", "sigmaT", "line .*transmitted"),
        ("\nphi ", "\nphj ", "line .*unknown word"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused_with_its_line(file, tmp_path, old, new, message):
    text = file.read_text()
    assert old in text
    (tmp_path / "bad.ddr").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read(tmp_path / "bad.ddr")


@pytest.mark.parametrize("count", [40, pytest.param(300, marks=pytest.mark.slow)])
def test_garbled_files_are_read_or_refused_and_never_crash(file, tmp_path, count):
    check_garbled_files(file.read_bytes(), tmp_path / "x.ddr", "integra", count)
