"""Klems matrices: read back by this package, and patch by patch by rules of the format alone."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
import samples
import xarray as xr
from loaded_by_radiance import load

from brdfpipe import facets, vocabulary
from brdfpipe.bsdf import microfacet, slab
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import error_of, fresh_pairs
from brdfpipe.errors import InputError
from brdfpipe.exchange.reading import read
from brdfpipe.exchange.registry import write

RINGS = [(0, 5, 1), (5, 15, 8), (15, 25, 16), (25, 35, 20), (35, 45, 24), (45, 55, 24), (55, 65, 24), (65, 75, 16)]
RINGS += [(75, 90, 12)]
SOLID_ANGLE = np.concatenate(
    [[np.pi * (np.sin(np.radians(b)) ** 2 - np.sin(np.radians(a)) ** 2) / n] * n for a, b, n in RINGS]
)
"""Projected solid angles of the 145 patches [sr]"""


@pytest.fixture(scope="module")
def grey():
    return samples.beckmann_bsdf(0.2).assign_attrs(material="<grey>", digest="abc")


@pytest.fixture(scope="module")
def file(grey, tmp_path_factory):
    path = tmp_path_factory.mktemp("klems") / "grey.klems.xml"
    write(grey, path)
    return path


@pytest.fixture(scope="module")
def sheet_file(tmp_path_factory):
    rough = facets.analytic("beckmann", 0.3)
    path = tmp_path_factory.mktemp("klems") / "sheet.klems.xml"
    sheet = slab.build(rough, rough, index=1.5, internal_transmittance=0.9)
    write(sheet, path)
    return sheet, path


def matrices(path: Path) -> dict[str, np.ndarray]:
    """Matrices (outgoing, incident) by the name of their direction."""
    root = ElementTree.parse(path).getroot()
    assert root.findtext(".//{*}IncidentDataStructure") == "Columns"
    return {
        block.findtext("{*}WavelengthDataDirection"): np.array(
            block.findtext("{*}ScatteringData").split(), dtype=float
        ).reshape(145, 145)
        for block in root.iter("{http://windows.lbl.gov}WavelengthDataBlock")
    }


def drawn(number: int, generator: np.random.Generator, count: int = 20_000) -> tuple[np.ndarray, np.ndarray]:
    """Outgoing directions of a patch, evenly in projected solid angle."""
    for low, high, parts in RINGS:
        if number < parts:
            squared = generator.uniform(np.sin(np.radians(low)) ** 2, np.sin(np.radians(high)) ** 2, count)
            phi = 360 * (number + generator.uniform(-0.5, 0.5, count)) / parts
            return np.degrees(np.arcsin(np.sqrt(squared))), phi
        number -= parts
    raise AssertionError(number)


def patch_mean(bsdf, row: int, column: int, passes: bool = False) -> float:
    generator = np.random.default_rng(row * 145 + column)
    # The vector of incidence is (-x, -y, z) of the outgoing patch of the same number.
    (theta_i, phi_i), (theta_o, phi_o) = drawn(column, generator), drawn(row, generator)
    at = theta_i, phi_i + 180, 180 - theta_o if passes else theta_o, phi_o
    return float(representation(bsdf).evaluate(*at, None).mean())


def test_the_file_read_back_errs_by_what_its_record_says(grey, file):
    record = json.loads(Path(f"{file}.json").read_text())
    model = grey.bsdf.nonspectral()
    found = error_of(model, representation(read(file)).evaluate, fresh_pairs(model, 11, incidences=24))
    assert found.percentile_95 <= 1.4 * record["error"]["percentile_95"]
    assert found.albedo <= record["error"]["albedo"] + 5e-4
    assert "within_tolerance" not in record["error"]
    assert "145 patches" in record["left_out"]["resolution"]
    assert "NOT in this file: detail within the 145 patches" in file.read_text()


def test_a_matt_body_loses_nothing_within_the_patches(tmp_path):
    even = xr.Dataset(
        {
            "lambert": ("theta_i", [0.2, 0.2]),
            "gauss_peak": ("theta_i", [0.0, 0.0]),
            "gauss_fwhm_parallel": ("theta_i", [10.0, 10.0]),
            "gauss_fwhm_perpendicular": ("theta_i", [10.0, 10.0]),
        },
        coords={"theta_i": [0.0, 60.0]},
        attrs={"representation": "lambert_gauss"},
    )
    write(vocabulary.label(even, "bsdf"), tmp_path / "x.klems.xml")
    assert "resolution" not in json.loads((tmp_path / "x.klems.xml.json").read_text())["left_out"]


@pytest.mark.parametrize(("row", "column"), [(0, 0), (60, 60), (60, 40), (3, 120), (129, 141), (100, 20)])
def test_a_value_is_the_mean_over_its_two_patches(grey, file, row, column):
    # 20 000 directions: 1 % of a value that varies by its own size, three times.
    expected = patch_mean(grey.bsdf.nonspectral(), row, column)
    assert matrices(file)["Reflection Back"][row, column] == pytest.approx(expected, rel=0.03)


def test_the_mirror_direction_of_a_patch_has_its_number(file):
    values = matrices(file)["Reflection Back"]
    first = np.cumsum([0] + [parts for *_, parts in RINGS])
    for column in range(25, 133):
        number = int(np.searchsorted(first, column, side="right")) - 1
        ring = np.arange(first[number], first[number + 1])
        assert ring[values[ring, column].argmax()] == column


def test_sums_over_the_outgoing_patches_are_the_reflectance(grey, file):
    sums = SOLID_ANGLE @ matrices(file)["Reflection Back"]
    # Ring of 35 to 45 degree, over which the reflectance of this surface varies by 0.3 %.
    assert sums[50] == pytest.approx(float(grey.bsdf.nonspectral().bsdf.albedo(40.0)), rel=5e-3)
    assert sums[0] == pytest.approx(float(grey.bsdf.nonspectral().bsdf.albedo(2.5)), rel=5e-3)


def test_a_sheet_has_light_that_passes_and_keeps_it(sheet_file):
    sheet, path = sheet_file
    found, plain = matrices(path), sheet.bsdf.nonspectral()
    assert set(found) == {"Reflection Back", "Transmission Back"}
    for row, column in ((50, 50), (50, 40), (10, 100)):
        expected = patch_mean(plain, row, column, passes=True)
        assert found["Transmission Back"][row, column] == pytest.approx(expected, rel=0.05)
    assert "transmission" not in json.loads(Path(f"{path}.json").read_text())["left_out"]
    back = read(path)
    assert float(back.bsdf.transmittance(40.0)) == pytest.approx(float(plain.bsdf.transmittance(40.0)), rel=0.05)


def test_light_into_a_body_is_said_to_be_left_out(tmp_path):
    write(microfacet.build(facets.analytic("beckmann", 0.3), index=1.5, transparent=True), tmp_path / "x.klems.xml")
    record = json.loads((tmp_path / "x.klems.xml.json").read_text())
    assert "into the body" in record["left_out"]["transmission"]
    assert set(matrices(tmp_path / "x.klems.xml")) == {"Reflection Back"}
    assert record["error"]["percentile_95"] < 1


@pytest.mark.slow
def test_a_lay_is_kept(tmp_path):
    brushed = samples.brushed_bsdf(0.4, 0.15)
    write(brushed, tmp_path / "brushed.klems.xml")
    values, plain = matrices(tmp_path / "brushed.klems.xml")["Reflection Back"], brushed.bsdf.nonspectral()
    # Ring of 35 to 45 degree: patches at 0 and 90 degree.
    along, across = 45, 51
    assert values[0, along] != pytest.approx(values[0, across], rel=0.2)
    for column in (along, across):
        assert values[0, column] == pytest.approx(patch_mean(plain, 0, column), rel=0.04)
    back = read(tmp_path / "brushed.klems.xml")
    assert float(back.bsdf.evaluate(40, 180, 0, 0)) == pytest.approx(values[0, along], rel=1e-4)
    assert float(back.bsdf.evaluate(40, 270, 0, 0)) == pytest.approx(values[0, across], rel=1e-4)


def test_both_ways_to_the_means_agree(grey):
    from brdfpipe.exchange import klems

    model = representation(grey.bsdf.nonspectral())

    def brdf(*at):
        return model.evaluate(*at, None)[..., 0]

    ratio = klems._means(brdf, False, True) / klems._means_with_lay(brdf, False)
    # Below 75 degree; the last ring is steep, and the rule for surfaces with a lay coarse.
    assert ratio[:133, :133] == pytest.approx(1.0, rel=0.03)
    assert np.median(np.abs(ratio - 1)) < 1e-3


def test_comments_and_name_are_valid_xml(file):
    text = file.read_text()
    assert "NOT in this file: polarisation" in text
    assert ElementTree.fromstring(text).findtext(".//{*}Name") == "<grey>"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<Name>", "<Nam>", "damaged XML"),
        ("WindowElement", "DoorElement", "not a BSDF of one layer"),
        ("<IncidentDataStructure>Columns", "<IncidentDataStructure>TensorTree4", "not Klems matrices"),
        ("<ColumnAngleBasis>LBNL/Klems Full", "<ColumnAngleBasis>LBNL/Klems Half", "unknown angle basis"),
        ("Reflection Back", "Reflection Front", "no reflection of light from"),
        ('"Integral">Visible', '"Integral">NIR', "no visible data"),
        ("<ScatteringData>\n", "<ScatteringData>\n0.1 ", "wrong number of values"),
        ("<ScatteringData>\n1", "<ScatteringData>\nx", "not a number"),
        ("<ScatteringData>\n1", "<ScatteringData>\nnan 1", "wrong number"),
        ("e-01 ", "e+99 ", "not finite"),
        ("<WindowElement ", '<!DOCTYPE x [<!ENTITY a "b">]><WindowElement ', "document type"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused_with_what_was_found(file, tmp_path, old, new, message):
    text = file.read_text()
    assert old in text
    (tmp_path / "bad.xml").write_text(text.replace(old, new) if old == "WindowElement" else text.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read(tmp_path / "bad.xml", "klems")


def test_a_file_of_many_gigabytes_is_refused_before_it_is_read(tmp_path):
    with (tmp_path / "huge.xml").open("wb") as opened:
        opened.truncate(1 << 34)
    with pytest.raises(InputError, match="too large"):
        read(tmp_path / "huge.xml", "klems")


def test_rows_are_the_transpose_of_columns(file, tmp_path):
    text = file.read_text()
    (tmp_path / "rows.xml").write_text(text.replace(">Columns<", ">Rows<"))
    first, other = read(file), read(tmp_path / "rows.xml")
    at = (40.0, 0.0, 10.0, 45.0), (10.0, 45.0, 40.0, 0.0)
    assert float(other.bsdf.evaluate(*at[0])) == pytest.approx(float(first.bsdf.evaluate(*at[1])), rel=0.02)


@pytest.mark.parametrize("count", [40, pytest.param(300, marks=pytest.mark.slow)])
def test_mutated_files_are_read_or_refused_and_never_crash(file, tmp_path, count):
    generator, content = np.random.default_rng(2), file.read_bytes()
    for number in range(count):
        damaged = bytearray(content)
        match number % 4:
            case 0:
                damaged = damaged[: generator.integers(1, len(damaged))]
            case 1:
                damaged[generator.integers(0, 4000)] = generator.integers(0, 256)
            case 2:
                start = generator.integers(0, len(damaged) - 300)
                del damaged[start : start + generator.integers(1, 300)]
            case _:
                start = generator.integers(4000, len(damaged) - 8)
                damaged[start : start + 8] = generator.integers(32, 127, 8).astype(np.uint8).tobytes()
        (tmp_path / "x.xml").write_bytes(damaged)
        try:
            found = read(tmp_path / "x.xml", "klems")
        except InputError:
            continue
        assert np.isfinite(found["brdf"].values).all()


def test_real_blinds_have_the_values_and_the_light_that_radiance_reads(shared_data):
    back = read(shared_data / "bsdf" / "test_blinds_kf.xml")
    # Radiance 6, bsdf.query at centres of patches with 24 parts, or of the same azimuths.
    assert float(back.bsdf.evaluate(30, 0, 150, 180)) == pytest.approx(34.5395, rel=1e-3)
    assert float(back.bsdf.evaluate(50, 60, 140, 75)) == pytest.approx(0.108122, rel=1e-3)
    assert float(back.bsdf.evaluate(50, 60, 40, 75)) == pytest.approx(0.058732, rel=1e-3)
    # direct_hemi at centres of patches, reflected and passed: the table keeps the light of each ring to 0.5 %.
    for theta, phi, reflected, passed in (
        (0.0, 0.0, 0.02673, 0.86138),
        (20.0, 90.0, 0.04125, 0.64337),
        (40.0, 270.0, 0.05958, 0.33494),
        (70.0, 0.0, 0.03614, 0.72613),
    ):
        assert float(back.bsdf.albedo(theta, phi)) == pytest.approx(reflected, rel=0.006)
        assert float(back.bsdf.transmittance(theta, phi)) == pytest.approx(passed, rel=0.006)


def test_radiance_and_the_table_agree_on_the_light_of_real_blinds(shared_data):
    radiance = pytest.importorskip("pyradiance.bsdf", reason="pyradiance is not there")
    path = shared_data / "bsdf" / "test_blinds_kf.xml"
    loaded, back = load(radiance, path), read(path)
    for theta in (0.0, 10.0, 20.0, 40.0, 60.0, 70.0):
        for phi in (0.0, 90.0, 270.0):
            total = radiance.direct_hemi(loaded, theta, phi, radiance.SAMPLE_ALL)
            reflected = radiance.direct_hemi(loaded, theta, phi, radiance.SAMPLE_ALL & ~radiance.SAMPLE_T)
            assert float(back.bsdf.albedo(theta, phi)) == pytest.approx(reflected, rel=0.01)
            assert float(back.bsdf.transmittance(theta, phi)) == pytest.approx(total - reflected, rel=0.01)


def test_radiance_reads_the_light_that_the_model_reflects_and_passes(grey, file, sheet_file):
    radiance = pytest.importorskip("pyradiance.bsdf", reason="pyradiance is not there")
    loaded, plain = load(radiance, file), grey.bsdf.nonspectral()
    for theta in (0.0, 30.0, 60.0):
        low, high, _ = next(ring for ring in RINGS if ring[0] <= theta < ring[1])
        angles = np.degrees(np.arcsin(np.sqrt(np.linspace(*np.sin(np.radians([low, high])) ** 2, 101))))
        mean = float(plain.bsdf.albedo(angles).mean())
        assert radiance.direct_hemi(loaded, theta, 0.0, radiance.SAMPLE_ALL) == pytest.approx(mean, rel=0.01)
    assert radiance.direct_hemi(loaded, 150.0, 0.0, radiance.SAMPLE_ALL) == 0
    # Turned by 50 degree, so that a mirrored azimuth shows.
    values = matrices(file)["Reflection Back"]
    assert radiance.query(loaded, 40.0, 60.0, 40.0, 225.0)[1] == pytest.approx(values[45 + 15, 45 + 16], rel=0.01)
    sheet, path = sheet_file
    both = load(radiance, path)
    plain = sheet.bsdf.nonspectral()
    total = float(plain.bsdf.albedo(40.0) + plain.bsdf.transmittance(40.0))
    assert radiance.direct_hemi(both, 40.0, 0.0, radiance.SAMPLE_ALL) == pytest.approx(total, rel=0.01)
