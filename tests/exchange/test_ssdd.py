"""Files of surface scattering distribution data: read back by this package, and value by value by rules of the format alone."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import samples
from damaged_files import check_garbled_files

from brdfpipe import facets, optics
from brdfpipe.bsdf import microfacet, slab
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import error_of, fresh_pairs
from brdfpipe.errors import InputError
from brdfpipe.exchange import ssdd_blocks
from brdfpipe.exchange.reading import format_of, read
from brdfpipe.exchange.registry import ExchangeError, write

COARSE = {"tolerance": 0.1, "albedo_tolerance": 0.02, "largest": 60_000}


@pytest.fixture(scope="module")
def grey():
    return samples.beckmann_bsdf(0.2).assign_attrs(material="grey", digest="abc")


@pytest.fixture(scope="module")
def file(grey, tmp_path_factory):
    path = tmp_path_factory.mktemp("ssdd") / "grey.ssdd"
    write(grey, path, **COARSE)
    return path


def blocks_of(path: Path) -> dict[str, tuple[dict[str, list[str]], np.ndarray]]:
    """Entries and values (parameter 3, 2, 1, 0, channels) of each block of a text file, read by the rules of the format."""
    found, entries, numbers = {}, {}, []

    def finish():
        if "DATA_TYPE" in entries:
            sizes = [len(entries.get(f"PARAM{number}_LIST", [0])) for number in (3, 2, 1, 0)]
            found[entries["DATA_TYPE"][0]] = entries, np.array(numbers, dtype=float).reshape(*sizes, -1)

    for line in path.read_text().splitlines():
        if not line or line.startswith("# "):
            continue
        word, *rest = line.split()
        if word == "DATA_TYPE":
            finish()
            entries, numbers = {}, []
        if word[0].isdigit():
            numbers.append(line.split())
        else:
            entries[word] = rest
    finish()
    return found


@pytest.mark.parametrize("binary", [False, True])
def test_the_file_read_back_errs_by_what_its_record_says(grey, tmp_path, binary):
    path = tmp_path / "grey.ssdd"
    write(grey, path, binary=binary, **COARSE)
    assert format_of(path).name == "ssdd"
    record, model = json.loads(Path(f"{path}.json").read_text()), grey.bsdf.nonspectral()
    found = error_of(model, representation(read(path)).evaluate, fresh_pairs(model, 11, incidences=24))
    assert found.percentile_95 <= 1.4 * record["error"]["percentile_95"] + 1e-4
    assert found.albedo <= record["error"]["albedo"] + 5e-4
    assert record["error"]["within_tolerance"]


def test_text_and_numbers_hold_the_same(grey, file, tmp_path):
    write(grey, tmp_path / "b.ssdd", binary=True, **COARSE)
    assert read(tmp_path / "b.ssdd")["brdf"].values == pytest.approx(read(file)["brdf"].values, rel=5.1e-5)
    assert (tmp_path / "b.ssdd").stat().st_size < 0.5 * file.stat().st_size


def test_entries_are_in_the_order_of_the_format_and_the_incidence_is_fastest(grey, file):
    assert file.read_text().startswith("VERSION 0.3\n")
    entries, values = blocks_of(file)["brdf"]
    order = ["DATA_TYPE", "COLOR_MODEL", "PARAM_TYPE", "REDUCTION_TYPE", "PARAM0_LIST", "PARAM2_LIST", "PARAM3_LIST"]
    assert list(entries)[: len(order)] == order
    assert list(entries)[-1] == "DATA"
    theta_i, theta_s, phi_s = (np.array(entries[f"PARAM{number}_LIST"], dtype=float) for number in (0, 2, 3))
    row, column = int(np.abs(theta_i - 50).argmin()), int(np.abs(theta_s - 20).argmin())
    model = grey.bsdf.nonspectral()
    for turn, sign in ((0, -1), (-1, 1)):
        # Azimuth 0 lies from the mirror direction towards the normal, 180 away from it.
        expected = float(model.bsdf.evaluate(theta_i[row], 0, theta_i[row] + sign * theta_s[column], 180))
        assert values[turn, column, 0, row, 0] == pytest.approx(expected, rel=0.1001)
    assert (phi_s[0], phi_s[-1]) == (0, 180)


def test_mirrored_light_has_a_block_of_its_own(tmp_path):
    polished = microfacet.build(facets.flat(), index=1.5)
    write(polished, tmp_path / "p.ssdd", **COARSE)
    entries, share = blocks_of(tmp_path / "p.ssdd")["specular_reflectance"]
    theta_i = np.array(entries["PARAM0_LIST"], dtype=float)
    assert share[0, 0, 0, 0, 0] == pytest.approx(0.04)
    row = int(np.abs(theta_i - 60).argmin())
    assert share[0, 0, 0, row, 0] == pytest.approx(optics.fresnel(np.cos(np.radians(theta_i[row])), 1.5).mean, rel=1e-4)
    assert "specular" not in json.loads((tmp_path / "p.ssdd.json").read_text())["left_out"]
    warnings = str(read(tmp_path / "p.ssdd").attrs["warnings"])
    assert "mirrored into a single direction" in warnings
    assert "0:0.0400" in warnings


def test_mirrored_colours_have_the_scale_of_a_share(tmp_path):
    polished = microfacet.build(facets.flat(), index=1.5, spectrum=samples.spectrum(0.3))
    write(polished, tmp_path / "p.ssdd", colour="xyz", **COARSE)
    blocks = blocks_of(tmp_path / "p.ssdd")
    # Y is the share; white light stays white, of which D65 has X 0.9505 and Z 1.089.
    assert blocks["specular_reflectance"][1][0, 0, 0, 0] == pytest.approx([0.04 * 0.9505, 0.04, 0.04 * 1.089], rel=2e-3)
    assert blocks["brdf"][0]["COLOR_MODEL"] == ["xyz"]


@pytest.mark.parametrize("binary", [False, True])
def test_a_sheet_has_blocks_of_both_sides(tmp_path, binary):
    sheet = slab.build(samples.beckmann(0.4), facets.flat(), index=1.5)
    write(sheet, tmp_path / "s.ssdd", binary=binary, **COARSE)
    back = read(tmp_path / "s.ssdd")
    assert "transmitted light was not read" in back.attrs["history"]
    at = 30.0, 0.0, 10.0, 150.0
    assert float(back.bsdf.evaluate(*at)) == pytest.approx(float(sheet.bsdf.nonspectral().bsdf.evaluate(*at)), rel=0.12)
    if not binary:
        text = (tmp_path / "s.ssdd").read_text()
        (tmp_path / "t.ssdd").write_text("VERSION 0.3\n" + text[text.index("DATA_TYPE btdf") :])
        passed = read(tmp_path / "t.ssdd")
        assert passed.attrs["side"] == "transmission"
        at = 30.0, 0.0, 150.0, 170.0
        expected = float(sheet.bsdf.nonspectral().bsdf.evaluate(*at))
        assert float(passed.bsdf.evaluate(*at)) == pytest.approx(expected, rel=0.12)


def test_spectra_have_their_wavelengths(tmp_path):
    red = samples.beckmann_bsdf(0.3, reflectance=np.linspace(0.05, 0.6, samples.WAVELENGTH.size))
    write(red, tmp_path / "red.ssdd", colour="spectral", **COARSE)
    back = read(tmp_path / "red.ssdd")
    assert back["wavelength"].values == pytest.approx(samples.WAVELENGTH)
    at = 30.0, 0.0, 10.0, 90.0
    assert back.bsdf.evaluate(*at).values == pytest.approx(red.bsdf.evaluate(*at).values, rel=0.1)


def test_a_lay_becomes_azimuths_of_incidence(tmp_path):
    brushed = samples.brushed_bsdf(0.3, 0.15, 25.0)
    write(brushed, tmp_path / "b.ssdd", tolerance=0.3, albedo_tolerance=0.2, largest=100_000)
    model, back = brushed.bsdf.nonspectral(), read(tmp_path / "b.ssdd")
    at = [(40, phi, 25, phi + 150) for phi in (25.0, 70.0, 115.0, 160.0)]
    found, wanted = ([float(bsdf.bsdf.evaluate(*angles)) for angles in at] for bsdf in (back, model))
    assert found == pytest.approx(wanted, rel=0.3)
    assert max(wanted) > 2 * min(wanted)


def by_hand(tmp_path: Path, entries: str, values: str, model: str = "monochrome") -> Path:
    text = (
        f"VERSION 0.2\n\n# by hand\nDATA_TYPE brdf\nCOLOR_MODEL {model}\n{entries}\nDATA ascii\n# PARAM3: 0\n{values}\n"
    )
    (tmp_path / "hand.ssdd").write_text(text)
    return tmp_path / "hand.ssdd"


LISTS = "PARAM0_LIST 0 60\nPARAM2_LIST 0 90\nPARAM3_LIST {around}"


def test_the_example_of_the_format_is_lambertian(tmp_path):
    entries = "PARAM_TYPE half_difference_coordinate_system\nREDUCTION_TYPE bilateral_symmetry reciprocity\n"
    lists = "PARAM0_LIST 0 90\nPARAM2_LIST 0 90\nPARAM3_LIST 0 90"
    back = read(by_hand(tmp_path, entries + lists, "0.2 0.3 0.4\n" * 8, "xyz"))
    found = representation(back).tristimulus(*(np.array([angle]) for angle in (30.0, 0.0, 50.0, 77.0)), "D65", 2)
    assert found[0] / (100 * np.pi) == pytest.approx([0.2, 0.3, 0.4])


def test_reciprocity_alone_repeats_the_difference_azimuths(tmp_path):
    entries = "PARAM_TYPE half_difference_coordinate_system\nREDUCTION_TYPE reciprocity\n" + LISTS
    back = read(by_hand(tmp_path, entries.format(around="0 90 180"), "1\n1\n1\n1\n2\n2\n2\n2\n1\n1\n1\n1"))
    assert back["phi_d"].values.tolist() == [0, 90, 180, 270, 360]
    assert back["brdf"].values[0, 0].tolist() == [1, 2, 1, 2, 1]


def test_azimuths_about_the_normal_count_from_a_fixed_direction(tmp_path):
    entries = "PARAM_TYPE spherical_coordinate_system\nPARAM0_LIST 10 60\nPARAM1_LIST 0 120 240\nPARAM2_LIST 10 80\nPARAM3_LIST 0 120 240"
    # The value is that of the azimuth of scatter, whatever the incidence.
    values = "\n".join(f"{around}" for around in (1, 2, 3) for _ in range(12))
    back = read(by_hand(tmp_path, entries, values))
    found = [float(back.bsdf.evaluate(30, phi_i, 40, phi_o)) for phi_i, phi_o in ((0, 120), (120, 120), (240, 0))]
    assert found == pytest.approx([2, 2, 1])


@pytest.mark.parametrize("lists", ["0 90 180 270", "0 90 180 270 360"])
def test_azimuths_about_the_normal_count_from_the_direction_of_the_one_incidence_too(tmp_path, lists):
    entries = (
        "PARAM_TYPE spherical_coordinate_system\nPARAM0_LIST 10 60\nPARAM1_LIST 90\nPARAM2_LIST 10 80\nPARAM3_LIST "
    )
    # The value is the azimuth of scatter; the mirror direction of an incidence at 90 is at 270.
    values = "\n".join(f"{float(around) % 360:g}" for around in lists.split() for _ in range(4))
    back = read(by_hand(tmp_path, entries + lists, values))
    assert [float(back.bsdf.evaluate(30, 0, 40, phi_o)) for phi_o in (180, 90, 0)] == pytest.approx([270, 180, 90])


def test_a_long_table_of_text_is_read_in_batches(tmp_path, monkeypatch):
    entries = "PARAM_TYPE specular_coordinate_system\n" + LISTS.format(around="0 180")
    whole = read(by_hand(tmp_path, entries, "\n".join("12345678")))
    monkeypatch.setattr(ssdd_blocks, "_BATCH", 3)
    assert read(by_hand(tmp_path, entries, "\n".join("12345678")))["brdf"].equals(whole["brdf"])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("VERSION 0.2", "VERSION 7", "line 1.*no SSDD file"),
        ("DATA_TYPE brdf", "DATA_TYPE rain", "line 4.*DATA_TYPE"),
        ("DATA_TYPE brdf", "DATA_TYPE specular_reflectance", "line 14.*before DATA_TYPE"),
        ("monochrome", "spectrum", "line .*WAVELENGTH_LIST"),
        ("monochrome", "grey", "line .*COLOR_MODEL"),
        ("monochrome", "xyz", "line .*number of channels"),
        ("specular_coordinate_system", "distorted_spherical_coordinate_system", "PARAM_TYPE"),
        ("PARAM3_LIST 0 180", "", "line .*no PARAM3_LIST"),
        ("PARAM3_LIST 0 180", "PARAM4_LIST 0 5\nPARAM3_LIST 0 180", "offsets"),
        ("PARAM3_LIST 0 180", "PARAM3_LIST 0 x", "line .*not a number"),
        ("PARAM3_LIST 0 180", "PARAM3_LIST 0 90 180", "line .*ends early"),
        ("DATA ascii", "DATA hex", "line .*unknown DATA"),
        ("DATA ascii", "DATA binary", "line .*ends early.*bytes"),
        ("DATA ascii\n# PARAM3: 0\n1\n2\n3\n4\n5\n6\n7\n8\n", "", "ends early.*no DATA"),
        ("DATA ascii", "DETA ascii", "line .*unknown entry"),
        ("\n3\n", "\nnan\n", "line .*not finite"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused_with_its_line(tmp_path, old, new, message):
    entries = "PARAM_TYPE specular_coordinate_system\n" + LISTS.format(around="0 180")
    path = by_hand(tmp_path, entries, "1\n2\n3\n4\n5\n6\n7\n8")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read(path)


def test_a_file_of_mirrored_light_alone_has_no_table(tmp_path):
    (tmp_path / "m.ssdd").write_text(
        "VERSION 0.3\nDATA_TYPE specular_reflectance\nCOLOR_MODEL monochrome\nPARAM0_LIST 0\nDATA ascii\n0.04\n"
    )
    with pytest.raises(InputError, match="no table"):
        read(tmp_path / "m.ssdd")


def test_lists_of_too_many_angles_are_refused_before_a_table_is_made(tmp_path):
    many = " ".join(map(str, range(30_000)))
    entries = f"PARAM_TYPE specular_coordinate_system\nPARAM0_LIST {many}\nPARAM2_LIST {many}\nPARAM3_LIST 0 180"
    with pytest.raises(InputError, match="too large"):
        read(by_hand(tmp_path, entries, "1"))


@pytest.mark.parametrize(("option", "value"), [("tolerance", 0.0), ("largest", 5), ("colour", "red")])
def test_options_out_of_range_are_refused(grey, tmp_path, option, value):
    with pytest.raises(ExchangeError, match=option):
        write(grey, tmp_path / "grey.ssdd", **{option: value})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("count", [30, pytest.param(300, marks=pytest.mark.slow)])
def test_garbled_files_are_read_or_refused_and_never_crash(grey, tmp_path, count, binary):
    write(grey, tmp_path / "grey.ssdd", tolerance=0.5, albedo_tolerance=0.5, largest=2000, binary=binary)
    check_garbled_files((tmp_path / "grey.ssdd").read_bytes(), tmp_path / "x.ssdd", "ssdd", count)
