"""The ASTM file, read back the way BSDF viewers read it, and by this package."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import samples
from damaged_files import check_garbled_files

from brdfpipe import exchange, facets, optics
from brdfpipe.bsdf import microfacet, slab
from brdfpipe.bsdf.input_uncertainty import uncertainty
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import error_of, fresh_pairs
from brdfpipe.errors import InputError
from brdfpipe.exchange import fixed_azimuths
from brdfpipe.exchange.reading import format_of, read

COARSE = {"tolerance": 0.1, "albedo_tolerance": 0.02, "largest": 60_000}


@pytest.fixture(scope="module")
def grey():
    return samples.beckmann_bsdf(0.25).assign_attrs(material="grey", digest="abc123")


@pytest.fixture(scope="module")
def file(grey, tmp_path_factory):
    path = tmp_path_factory.mktemp("astm") / "grey.astm"
    exchange.write(grey, path, **COARSE)
    return path


@pytest.fixture(scope="module")
def brushed():
    return samples.brushed_bsdf(0.2, 0.4, -30.0)


def read_as_viewers_do(path):
    """Words of the header one by one until VARS, then comma-separated rows: the reading rules of libbsdf's reader."""
    lines = path.read_text().split("\n")
    words, row = [], 0
    while "VARS" not in lines[row].split():
        words += lines[row].split()
        row += 1
    points = int(words[words.index("NUM_POINTS") + 1])
    names = lines[row].split(" ", 1)[1].split(",")
    rows = np.array([[float(value) for value in line.split(",")] for line in lines[row + 1 :] if line])
    return points, names, rows


def check_rows(model, rows, limit, turn=lambda theta: theta):
    """Values are those of the model, scaled by at most the tolerance and rounded."""
    chosen = rows[np.random.default_rng(3).integers(len(rows), size=400)]
    theta_i, phi_i, theta_s, phi_s = np.degrees(chosen[:, :4]).T
    expected = model.bsdf.evaluate(theta_i, phi_i, turn(theta_s), np.minimum(phi_s, 360)).values.ravel()
    assert chosen[:, 4] == pytest.approx(expected, rel=limit, abs=1e-6)


def test_a_viewer_reads_a_full_grid_of_the_values_of_the_model(grey, file):
    points, names, rows = read_as_viewers_do(file)
    assert names == ["theta_i", "phi_i", "theta_s", "phi_s", "Integrated"]
    assert points == len(rows) == np.prod([np.unique(column).size for column in rows[:, :4].T])
    assert len(np.unique(rows[:, :4], axis=0)) == len(rows)
    assert (rows[:, 3].min(), np.degrees(rows[:, 3].max())) == pytest.approx((0, 360), abs=1e-3)
    check_rows(grey.bsdf.nonspectral(), rows, 0.1002)


def test_the_file_read_back_errs_by_what_its_record_says(grey, file):
    record = json.loads(Path(f"{file}.json").read_text())
    model = grey.bsdf.nonspectral()
    found = error_of(model, representation(read(file)).evaluate, fresh_pairs(model, 11, incidences=24))
    assert found.percentile_95 <= 1.4 * record["error"]["percentile_95"] + 1e-4
    assert found.albedo <= record["error"]["albedo"] + 5e-4
    assert record["error"]["within_tolerance"]
    assert record["values"] == read_as_viewers_do(file)[0]
    assert "warnings" not in read(file).attrs


def test_a_glossy_surface_takes_less_than_10_megabytes_at_one_percent(tmp_path):
    glossy = samples.beckmann_bsdf(0.08)
    exchange.write(glossy, tmp_path / "glossy.astm")
    error = json.loads((tmp_path / "glossy.astm.json").read_text())["error"]
    assert error["percentile_95"] <= 0.01
    assert (tmp_path / "glossy.astm").stat().st_size < 10e6


def test_the_file_has_no_blank_lines_or_trailing_commas(file):
    lines = file.read_text().split("\n")
    assert lines[-1] == ""
    assert all(line.strip() and not line.endswith(",") for line in lines[:-1])


def test_the_header_states_material_convention_and_source(file):
    header = file.read_text().split("VARS")[0]
    assert "SAMPLE_NAME grey" in header
    assert "not multiplied by cos" in header
    assert "abc123" in header


@pytest.mark.parametrize("name", ["VARS", "my NUM_POINTS", "two\nlines VARS x"])
def test_a_material_named_like_a_keyword_does_not_derail_the_reader(grey, file, tmp_path, name):
    exchange.write(grey.assign_attrs(material=name), tmp_path / "vars.astm", **COARSE)
    assert read_as_viewers_do(tmp_path / "vars.astm")[0] == read_as_viewers_do(file)[0]


def test_the_format_is_that_of_the_extension_unless_named(grey, tmp_path):
    exchange.write(grey, tmp_path / "a.txt", format="astm", **COARSE)
    assert format_of(tmp_path / "a.txt", "astm").name == "astm"
    assert read_as_viewers_do(tmp_path / "a.txt")[0] > 0
    with pytest.raises(exchange.ExchangeError, match=r"a\.txt: no format has files that end with '\.txt'"):
        exchange.write(grey, tmp_path / "a.txt")


def test_tables_beside_the_file_have_no_record(grey, tmp_path):
    exchange.write(grey, tmp_path / "grey.total_reflectance.csv")
    assert [path.name for path in tmp_path.iterdir()] == ["grey.total_reflectance.csv"]


@pytest.mark.parametrize(("colour", "names"), [("xyz", ["X", "Y", "Z"]), ("spectral", None)])
def test_colours_and_spectra_have_columns(tmp_path, colour, names):
    red = samples.beckmann_bsdf(0.3, reflectance=np.linspace(0.05, 0.6, samples.WAVELENGTH.size))
    exchange.write(red, tmp_path / "red.astm", colour=colour, **COARSE)
    found = read_as_viewers_do(tmp_path / "red.astm")[1][4:]
    assert found == (names or [f"{one:g}nm" for one in samples.WAVELENGTH])
    back = read(tmp_path / "red.astm")
    at = 30.0, 0.0, 10.0, 90.0
    if colour == "spectral":
        assert back.bsdf.evaluate(*at).values == pytest.approx(red.bsdf.evaluate(*at).values, rel=0.1)
    else:
        assert float(back.bsdf.nonspectral().bsdf.evaluate(*at)) == pytest.approx(
            float(red.bsdf.nonspectral().bsdf.evaluate(*at)), rel=0.1
        )
        red_green = representation(back).tristimulus(*(np.array([angle]) for angle in at), "D65", 2)
        assert red_green[0, 0] > red_green[0, 2]


@pytest.fixture(scope="module")
def brushed_file(brushed, tmp_path_factory):
    path = tmp_path_factory.mktemp("astm") / "brushed.astm"
    exchange.write(brushed, path, tolerance=0.3, albedo_tolerance=0.2, largest=100_000)
    return path


def test_rows_of_a_surface_with_a_lay_are_a_full_grid_of_its_values(brushed, brushed_file):
    points, _, rows = read_as_viewers_do(brushed_file)
    sizes = [np.unique(column).size for column in rows[:, :4].T]
    assert points == len(rows) == np.prod(sizes) <= 100_000
    check_rows(brushed.bsdf.nonspectral(), rows, 0.3002)
    assert "NOT isotropic" in brushed_file.read_text()


def test_a_surface_with_a_lay_is_read_at_relative_azimuths_with_the_error_of_the_record(brushed, brushed_file):
    error = json.loads(Path(f"{brushed_file}.json").read_text())["error"]
    model, back = brushed.bsdf.nonspectral(), read(brushed_file)
    assert back["brdf"].dims[0] == "phi_i"
    found = error_of(model, representation(back).evaluate, fresh_pairs(model, 11, incidences=24))
    # Both are percentiles over 12 and 24 planes of incidence of a coarse table.
    assert found.percentile_95 <= 1.5 * error["relative_azimuths"]["percentile_95"]
    assert not error["within_tolerance"]
    assert "MORE than the tolerance" in brushed_file.read_text()[:3000]


def test_interpolation_from_the_nodes_around_is_that_of_a_table_at_fixed_azimuths(brushed):
    model = brushed.bsdf.nonspectral()
    axes = {
        "phi_i": np.linspace(0, 360, 9),
        "theta_i": np.array([0.0, 40, 80]),
        "theta_o": np.array([0.0, 45, 85]),
        "phi_o": np.linspace(0, 360, 17),
    }
    read_between = fixed_azimuths.between_nodes(model, axes)
    # Halfway between two planes of incidence, at one azimuth of scatter: the mean of both.
    theta, phi = np.array([40.0]), np.array([90.0])
    ends = [float(model.bsdf.evaluate(40, at, 45, 90)) for at in (45, 90)]
    assert read_between(theta, np.array([67.5]), theta + 5, phi, None)[0, 0] == pytest.approx(np.mean(ends))
    values = np.arange(16.0)[None, None, :, None]
    closed = np.concatenate([values, values[:, :, :1]], axis=2)
    # Light from 90 degree that leaves towards 90 degree leaves at 0 relative to it.
    assert fixed_azimuths.from_fixed(closed, 2, axes)[0, 0, 4, 0] == 0


def test_the_header_states_the_specular_share(tmp_path):
    polished = microfacet.build(facets.flat(), index=1.5)
    exchange.write(polished, tmp_path / "p.astm", **COARSE)
    header, rows = (tmp_path / "p.astm").read_text().split("VARS")[0], read_as_viewers_do(tmp_path / "p.astm")[2]
    assert "NOT in this file: the share mirrored into a single direction" in header
    assert "0:0.040000" in header
    assert (rows[:, 4] == 0).all()


def test_each_side_of_a_sheet_is_a_file_of_its_own(tmp_path):
    sheet = slab.build(facets.analytic("beckmann", 0.3), facets.analytic("beckmann", 0.2), index=1.5)
    exchange.write(sheet, tmp_path / "s.astm", **COARSE)
    exchange.write(sheet, tmp_path / "s.transmission.astm", **COARSE)
    for name, turn in (("s.astm", lambda theta: theta), ("s.transmission.astm", lambda theta: 180 - theta)):
        points, _, rows = read_as_viewers_do(tmp_path / name)
        assert points == len(rows)
        assert (np.diff(rows[:, 0]) >= 0).all()
        assert rows[:, 2].max() < np.pi / 2
        check_rows(sheet.bsdf.nonspectral(), rows, 0.1002, turn)
    assert "BTDF in sr-1" in (tmp_path / "s.transmission.astm").read_text()
    assert read(tmp_path / "s.astm")["theta_o"].max() < 90
    passed = read(tmp_path / "s.transmission.astm")
    assert passed.attrs["side"] == "transmission"
    expected = float(sheet.bsdf.nonspectral().bsdf.evaluate(30, 0, 140, 150))
    assert float(passed.bsdf.evaluate(30, 0, 140, 150)) == pytest.approx(expected, rel=0.1)


def test_a_reflecting_material_has_no_transmission_to_write(grey, tmp_path):
    with pytest.raises(exchange.ExchangeError, match="no light passes"):
        exchange.write(grey, tmp_path / "t.transmission.astm", **COARSE)


def test_the_header_states_the_uncertainty_where_it_is_known(tmp_path):
    bsdf = samples.beckmann_bsdf(0.25, n=1.5)
    changes = uncertainty(bsdf, index=optics.refractive_index(1.5, uncertainty=0.05))
    for model, stated in ((bsdf, False), (bsdf.merge(changes, combine_attrs="override"), True)):
        reduced = model.bsdf.nonspectral()
        exchange.write(reduced, tmp_path / "a.astm", **COARSE)
        header = (tmp_path / "a.astm").read_text().split("VARS")[0]
        relative = reduced.bsdf.uncertainty(45, 0, 45, 180) / reduced.bsdf.evaluate(45, 0, 45, 180) if stated else 0
        note = f" 45:{float(relative):.4f} "
        assert ("relative standard uncertainty in the mirror direction" in header and note in header) == stated
        assert ("directions, half of them where the light goes: median 0." in header) == stated
        record = json.loads((tmp_path / "a.astm.json").read_text())
        assert ("uncertainty" in record["left_out"]) == stated


@pytest.mark.parametrize(
    ("option", "value"), [("tolerance", 0.0), ("albedo_tolerance", 2.0), ("largest", 5), ("colour", "red")]
)
def test_options_out_of_range_are_refused(grey, brushed, tmp_path, option, value):
    for bsdf in (grey, brushed):
        with pytest.raises(exchange.ExchangeError, match=option):
            exchange.write(bsdf, tmp_path / "a.astm", **{option: value})
    assert not list(tmp_path.iterdir())


ROWS = "".join(
    f"{theta_i},0,{theta_s},{phi},{1 + theta_s}\n"
    for theta_i in (0, 0.5, 1)
    for theta_s in (0, 0.7, 1.4)
    for phi in (0, 1.570796, 3.141593)
)


def by_hand(
    tmp_path: Path, rows: str = ROWS, names: str = "Integrated", count: int | None = None, head: str = ""
) -> Path:
    count = len(rows.splitlines()) if count is None else count
    text = f"LAB_NAME x\n{head}NUM_POINTS {count}\nVARS theta_i,phi_i,theta_s,phi_s,{names}\n{rows}"
    (tmp_path / "hand.astm").write_text(text)
    return tmp_path / "hand.astm"


def test_rows_in_any_order_with_other_line_ends_are_a_grid(tmp_path):
    shuffled = np.random.default_rng(1).permutation(ROWS.splitlines())
    back = read(by_hand(tmp_path, "\r\n\r\n".join(shuffled) + "\r\n", count=27))
    assert float(back.bsdf.evaluate(20, 0, np.degrees(0.7), 120)) == pytest.approx(1.7)
    assert "taken as BRDF" in back.attrs["history"]


def test_a_header_that_says_so_has_brdf_times_cosine(tmp_path):
    back = read(by_hand(tmp_path, head="MEAS_NAME CCBRDF of a plate\n"))
    assert float(back.bsdf.evaluate(20, 0, np.degrees(0.7), 120)) == pytest.approx(1.7 / np.cos(0.7))


@pytest.mark.parametrize(
    ("names", "channels"), [("450nm,550nm,650nm", "wavelength"), ("R,G,B", None), ("a,b,c", None), ("X,Y,Z", None)]
)
def test_channels_are_told_by_their_names(tmp_path, names, channels):
    rows = "".join(f"{row},2,3\n" for row in ROWS.splitlines())
    back = read(by_hand(tmp_path, rows, names))
    assert ("brdf_xyz" in back) == (channels is None)


def test_wavelengths_are_sorted(tmp_path):
    rows = "".join(f"{row},2,3\n" for row in ROWS.splitlines())
    back = read(by_hand(tmp_path, rows, "650nm,450nm,550nm"))
    assert back.bsdf.evaluate(0, 0, 0, 0).values.ravel() == pytest.approx([2, 3, 1])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("VARS", "VAR"), "no line VARS"),
        (("NUM_POINTS 27", "NUM_POINTS 1000000000"), "ends early.*27 rows"),
        (("NUM_POINTS 27", "NUM_POINTS many"), "not a count"),
        (("Integrated", "a,b"), "unknown columns of values"),
        (("Integrated", "450nm,450nm,450nm"), "wavelengths are not different"),
        ((",phi_s,Integrated", ",phi_s"), "no columns of values"),
        (("\n0.5,0,0,0,1", "\n0.5,0,0,0,x"), "line 13.*not a number"),
        (("\n0.5,0,0,0,1", "\n0.5,0,0,0,nan"), "line 13.*not a number"),
        (("\n0.5,0,0,0,1", "\n0.5,0,0,0"), "line 13.*wrong number of columns"),
        (("\n0.5,0,0,0,1", "\n0.5,0,0,0,1,1"), "line 13.*wrong number of columns"),
        (("\n0.5,0,0,0,1", "\n45,0,0,0,1"), "angles are out of range"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused_with_its_line(tmp_path, change, message):
    path = by_hand(tmp_path)
    text = path.read_text()
    assert change[0] in text
    path.write_text(text.replace(*change, 1))
    with pytest.raises(InputError, match=message):
        read(path)


@pytest.mark.parametrize("count", [40, pytest.param(300, marks=pytest.mark.slow)])
def test_garbled_files_are_read_or_refused_and_never_crash(grey, tmp_path, count):
    exchange.write(grey, tmp_path / "grey.astm", tolerance=0.5, albedo_tolerance=0.5, largest=2000)
    check_garbled_files((tmp_path / "grey.astm").read_bytes(), tmp_path / "x.astm", "astm", count)
