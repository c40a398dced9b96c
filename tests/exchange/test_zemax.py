"""Zemax files: read back by this package, and cell by cell by rules of the format alone."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
import samples
import xarray as xr
from damaged_files import check_garbled_files

from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import error_of, fresh_pairs
from brdfpipe.errors import InputError
from brdfpipe.exchange.reading import read
from brdfpipe.exchange.registry import ExchangeError, write

COARSE = {"tolerance": 0.1, "albedo_tolerance": 0.02, "largest": 60_000}


@pytest.fixture(scope="module")
def grey():
    return samples.beckmann_bsdf(0.2).assign_attrs(material="grey", digest="abc")


@pytest.fixture(scope="module")
def file(grey, tmp_path_factory):
    path = tmp_path_factory.mktemp("zemax") / "grey.zemax.bsdf"
    write(grey, path, **COARSE)
    return path


def test_the_file_read_back_errs_by_what_its_record_says(grey, file):
    record = json.loads(Path(f"{file}.json").read_text())
    model = grey.bsdf.nonspectral()
    found = error_of(model, representation(read(file)).evaluate, fresh_pairs(model, 11, incidences=24))
    assert found.percentile_95 <= 1.4 * record["error"]["percentile_95"] + 1e-4
    assert found.albedo <= record["error"]["albedo"] + 5e-4
    assert record["error"]["within_tolerance"]


def test_a_cell_is_the_direction_at_its_angles_from_the_specular_ray(grey, file):
    words = [line.split() for line in file.read_text().splitlines() if line and not line.startswith("#")]
    heads = {line[0]: number for number, line in enumerate(words) if line[0][0].isalpha()}
    lists = {
        name: np.array(words[heads[name] + 1], dtype=float)
        for name in ("AngleOfIncidence", "ScatterAzimuth", "ScatterRadial")
    }
    aoi, azimuth, radial = lists.values()
    row, column = int(np.abs(aoi - 50).argmin()), int(np.abs(radial - 20).argmin())
    block = heads["DataBegin"] + 1 + row * (azimuth.size + 1) + 1
    model = grey.bsdf.nonspectral()
    for turn, sign in ((0, -1), (azimuth.size - 1, 1)):
        # Azimuth 0 lies from the specular ray towards the normal, 180 away from it.
        expected = float(model.bsdf.evaluate(aoi[row], 0, aoi[row] + sign * radial[column], 180))
        assert float(words[block + turn][column]) == pytest.approx(expected, rel=0.021)


def test_tis_is_the_reflectance_of_the_model(grey, file):
    tis = [float(line.split()[1]) for line in file.read_text().splitlines() if line.startswith("TIS")]
    aoi = next(
        np.array(after.split(), dtype=float)
        for before, after in zip(file.read_text().splitlines(), file.read_text().splitlines()[1:], strict=False)
        if before.startswith("AngleOfIncidence")
    )
    lower = aoi < 80
    albedo = grey.bsdf.nonspectral().bsdf.albedo(aoi[lower]).values
    assert np.array(tis)[lower] == pytest.approx(albedo, rel=0.02)


def test_comments_and_record_say_what_the_file_leaves_out(file):
    record = json.loads(Path(f"{file}.json").read_text())
    assert set(record["left_out"]) == {"spectrum", "polarisation"}
    comments = [line for line in file.read_text().splitlines() if line.startswith("#")]
    assert any("polarisation" in line for line in comments)
    assert any("95th percentile" in line for line in comments)


def test_colours_are_three_blocks_of_tristimulus_values(tmp_path):
    red = samples.beckmann_bsdf(0.3, reflectance=np.linspace(0.05, 0.6, samples.WAVELENGTH.size))
    write(red, tmp_path / "red.zemax.bsdf", colour=True, **COARSE)
    back = read(tmp_path / "red.zemax.bsdf")
    at = 30.0, 0.0, 10.0, 90.0
    xyz = back["brdf_xyz"].interp(theta_i=30.0)
    assert list(xyz["component"].values) == ["X", "Y", "Z"]
    expected = red.bsdf.nonspectral().bsdf.evaluate(*at)
    assert float(back.bsdf.nonspectral().bsdf.evaluate(*at)) == pytest.approx(float(expected), rel=0.1)
    found = representation(back).tristimulus(*(np.array([angle]) for angle in at), "D65", 2)
    assert found[0, 0] > found[0, 2]


def test_a_lay_becomes_sample_rotations(tmp_path):
    brushed = samples.brushed_bsdf(0.3, 0.15)
    write(brushed, tmp_path / "brushed.zemax.bsdf", tolerance=0.3, albedo_tolerance=0.2, largest=100_000)
    back = read(tmp_path / "brushed.zemax.bsdf")
    assert "phi_i" in back.dims
    across, along = (float(back.bsdf.evaluate(40, phi, 25, phi + 180)) for phi in (90.0, 0.0))
    wanted = [float(brushed.bsdf.nonspectral().bsdf.evaluate(40, phi, 25, phi + 180)) for phi in (90.0, 0.0)]
    assert [across, along] == pytest.approx(wanted, rel=0.3)


def test_tis_of_every_rotation_is_the_reflectance_along_its_azimuth(tmp_path):
    brushed = samples.brushed_bsdf(0.5, 0.15)
    write(brushed, tmp_path / "brushed.zemax.bsdf", tolerance=0.3, albedo_tolerance=0.2, largest=30_000)
    lines = (tmp_path / "brushed.zemax.bsdf").read_text().splitlines()
    rotation, aoi = (
        np.array(after.split(), dtype=float)
        for before, after in itertools.pairwise(lines)
        if before.startswith(("SampleRotation", "AngleOfIncidence"))
    )
    tis = np.array([float(line.split()[1]) for line in lines if line.startswith("TIS")])
    row = int(np.abs(aoi - 65).argmin())
    albedo = brushed.bsdf.nonspectral().bsdf.albedo(aoi[row], rotation).values
    # Along the lay and across it the reflectances differ by far more than a coarse table errs.
    assert np.ptp(albedo) > 0.2 * albedo.mean()
    assert tis.reshape(rotation.size, aoi.size)[:, row] == pytest.approx(albedo, rel=0.05)


def test_fewer_values_than_a_lay_needs_are_refused(tmp_path):
    with pytest.raises(ExchangeError, match="largest is 80; accepted: at least 81"):
        write(samples.brushed_bsdf(0.3, 0.15), tmp_path / "brushed.zemax.bsdf", largest=80)


def test_a_long_name_is_refused(grey, tmp_path):
    with pytest.raises(ExchangeError, match="at most 60 characters"):
        write(grey, tmp_path / f"{'a' * 60}.zemax.bsdf")


@pytest.mark.parametrize(("name", "value"), [("tolerance", 0.0), ("albedo_tolerance", 2.0), ("largest", 5)])
def test_options_out_of_range_are_refused(grey, tmp_path, name, value):
    with pytest.raises(ExchangeError, match=name):
        write(grey, tmp_path / "grey.zemax.bsdf", **{name: value})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("SpectralContent  Monochrome", "SpectralContent  Infrared", "SpectralContent"),
        ("ScatterType  BRDF", "ScatterType  BXDF", "unknown ScatterType"),
        ("DataBegin", "DataBgin", "DataBegin"),
        ("TIS", "SIT", "begins with TIS"),
        ("ScatterRadial  ", "ScatterRadial  9", "numbers|out of range"),
        ("e-0", "e-x", "not a number"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused_with_its_line(file, tmp_path, old, new, message):
    text = file.read_text()
    assert old in text
    (tmp_path / "bad.bsdf").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read(tmp_path / "bad.bsdf", "zemax")


def test_tabs_separate_words_as_blanks_do(file, tmp_path):
    lines = file.read_text().replace("  ", "\t").replace("TIS ", "TIS\t")
    (tmp_path / "tabs.bsdf").write_text(lines)
    xr.testing.assert_equal(read(tmp_path / "tabs.bsdf", "zemax"), read(file))


@pytest.mark.parametrize("count", [40, pytest.param(300, marks=pytest.mark.slow)])
def test_garbled_files_are_read_or_refused_and_never_crash(file, tmp_path, count):
    check_garbled_files(file.read_bytes(), tmp_path / "x.bsdf", "zemax", count)


def test_real_vinyl_names_its_dropouts_and_its_declared_integral(shared_data):
    back = read(shared_data / "bsdf" / "brown_vinyl_zemax.bsdf")
    warnings = json.loads(back.attrs["warnings"])
    assert any("95 of 2372 cells above the horizon" in text for text in warnings)
    (integrals,) = (text for text in warnings if "declared" in text and "not rescaled" in text)
    # Two of the 13 incidences, with what their lines TIS say.
    assert "25°: 0.141 (0.137 declared)" in integrals
    assert "75°: 0.282 (0.257 declared)" in integrals
    # A cell of the file: AOI 15°, azimuth 0, radial 30: 4.618E-02, 15° on the side of incidence.
    assert float(back.bsdf.evaluate(15, 0, 15, 0)) == pytest.approx(4.618e-2, rel=1e-6)
    assert float(back.bsdf.evaluate(15, 0, 15, 180)) == pytest.approx(6.375e-2, rel=1e-6)
