"""The ASTM file, read back the way BSDF viewers read it."""

from __future__ import annotations

import numpy as np
import pytest
import samples

from brdfpipe import exchange, facets, optics
from brdfpipe.bsdf import microfacet, slab
from brdfpipe.bsdf.input_uncertainty import uncertainty
from brdfpipe.exchange import astm

GRID = {"theta_i": [0.0, 30.0, 60.0], "theta_o": np.arange(0, 86, 5.0), "phi_o": np.arange(0, 361, 10.0)}


@pytest.fixture(scope="module")
def table():
    return samples.beckmann_bsdf(0.25).bsdf.nonspectral().bsdf.tabulate(GRID).assign_attrs(material="grey")


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


def test_a_viewer_reads_back_every_value(table, tmp_path):
    astm.write(table, tmp_path / "grey.astm")
    points, names, rows = read_as_viewers_do(tmp_path / "grey.astm")
    assert names == ["theta_i", "phi_i", "theta_s", "phi_s", "Integrated"]
    assert points == len(rows) == table["brdf"].size
    theta_i, phi_i, theta_s, phi_s = np.degrees(rows[:, :4]).T
    assert rows[:, 4] == pytest.approx(table.bsdf.evaluate(theta_i, phi_i, theta_s, phi_s).values, rel=1e-7)
    assert phi_s.min() == 0
    assert phi_s.max() == pytest.approx(360)


def test_every_pair_of_directions_is_in_one_row(table, tmp_path):
    astm.write(table, tmp_path / "grey.astm")
    rows = read_as_viewers_do(tmp_path / "grey.astm")[2]
    assert len(np.unique(rows[:, :4], axis=0)) == len(rows)


def test_the_file_has_no_blank_lines_or_trailing_commas(table, tmp_path):
    astm.write(table, tmp_path / "grey.astm")
    lines = (tmp_path / "grey.astm").read_text().split("\n")
    assert lines[-1] == ""
    assert all(line.strip() and not line.endswith(",") for line in lines[:-1])


def test_the_header_states_material_convention_and_source(table, tmp_path):
    astm.write(table.assign_attrs(digest="abc123"), tmp_path / "grey.astm")
    header = (tmp_path / "grey.astm").read_text().split("VARS")[0]
    assert "SAMPLE_NAME grey" in header
    assert "not multiplied by cos" in header
    assert "abc123" in header


def test_a_material_named_like_a_keyword_does_not_derail_the_reader(table, tmp_path):
    astm.write(table.assign_attrs(material="VARS"), tmp_path / "vars.astm")
    assert len(read_as_viewers_do(tmp_path / "vars.astm")[2]) == table["brdf"].size


def test_the_format_is_that_of_the_extension_unless_named(table, tmp_path):
    exchange.write(table, tmp_path / "a.astm")
    exchange.write(table, tmp_path / "a.txt", format="astm")
    assert read_as_viewers_do(tmp_path / "a.txt")[0] == read_as_viewers_do(tmp_path / "a.astm")[0]
    with pytest.raises(exchange.ExchangeError, match=r"a\.txt: unknown format 'txt'; accepted: astm"):
        exchange.write(table, tmp_path / "a.txt")


def test_a_spectral_or_half_table_is_refused(tmp_path):
    bsdf = samples.beckmann_bsdf(0.25)
    with pytest.raises(astm.ExchangeError, match="non-spectral"):
        astm.write(bsdf.bsdf.tabulate(GRID), tmp_path / "a.astm")
    half = bsdf.bsdf.nonspectral().bsdf.tabulate({**GRID, "phi_o": np.arange(0, 181, 10.0)})
    with pytest.raises(astm.ExchangeError, match="from 0 to 360"):
        astm.write(half, tmp_path / "a.astm")
    assert not (tmp_path / "a.astm").exists()


@pytest.fixture(scope="module")
def brushed():
    return samples.brushed_bsdf(0.2, 0.4, -30.0)


def test_rows_of_a_surface_with_a_lay_are_a_full_grid_of_true_values(brushed, tmp_path):
    table = brushed.bsdf.tabulate({**GRID, "phi_i": [-30.0, 15.0, 60.0]})
    astm.write(brushed, tmp_path / "b.astm", table=table)
    points, _, rows = read_as_viewers_do(tmp_path / "b.astm")
    angles = np.degrees(rows[:, :4])
    sizes = [np.unique(np.round(column, 5)).size for column in angles.T]
    assert points == len(rows) == np.prod(sizes)
    assert np.unique(np.round(angles[:, 1], 5)).tolist() == [15, 60, 330]
    assert rows[:, 4] == pytest.approx(brushed.bsdf.evaluate(*angles.T).values, rel=1e-6)
    assert "NOT isotropic" in (tmp_path / "b.astm").read_text()


def test_rows_of_a_surface_with_a_lay_need_its_model(brushed, tmp_path):
    table = brushed.bsdf.tabulate({**GRID, "phi_i": [0.0, 90.0]})
    with pytest.raises(astm.ExchangeError, match="give the BSDF it was made from"):
        astm.write(table, tmp_path / "b.astm")


def test_the_header_states_the_specular_share(tmp_path):
    polished = microfacet.build(facets.flat(), index=1.5)
    astm.write(polished, tmp_path / "p.astm", table=polished.bsdf.tabulate(GRID))
    header, rows = (tmp_path / "p.astm").read_text().split("VARS")[0], read_as_viewers_do(tmp_path / "p.astm")[2]
    assert "NOT in these rows, because light in a single direction has no density: the share mirrored" in header
    assert "0:0.040000" in header
    assert (rows[:, 4] == 0).all()


def test_each_side_of_a_sheet_is_a_file_of_its_own(tmp_path):
    sheet = slab.build(facets.analytic("beckmann", 0.3), facets.analytic("beckmann", 0.2), index=1.5)
    both = {**GRID, "theta_o": [*GRID["theta_o"], *(180 - GRID["theta_o"][::-1])]}
    table = sheet.bsdf.tabulate(both)
    astm.write(sheet, tmp_path / "s.astm", table=table)
    astm.write_transmission(sheet, tmp_path / "s.transmission.astm", table=table)
    for file, turn in (("s.astm", lambda theta: theta), ("s.transmission.astm", lambda theta: 180 - theta)):
        points, _, rows = read_as_viewers_do(tmp_path / file)
        theta_i, phi_i, theta_s, phi_s = np.degrees(rows[:, :4]).T
        assert points == len(rows)
        assert theta_s.max() < 90
        assert rows[:, 4] == pytest.approx(sheet.bsdf.evaluate(theta_i, phi_i, turn(theta_s), phi_s).values, rel=1e-5)
    assert "BTDF in sr-1" in (tmp_path / "s.transmission.astm").read_text()


def test_a_table_of_reflection_alone_has_no_transmission_to_write(table, tmp_path):
    with pytest.raises(astm.ExchangeError, match="beyond 90 degree"):
        astm.write_transmission(table, tmp_path / "t.astm")


def test_the_header_states_the_uncertainty_where_it_is_known(tmp_path):
    bsdf = samples.beckmann_bsdf(0.25, n=1.5)
    changes = uncertainty(bsdf, index=optics.refractive_index(1.5, uncertainty=0.05))
    for model, stated in ((bsdf, False), (bsdf.merge(changes, combine_attrs="override"), True)):
        reduced = model.bsdf.nonspectral()
        astm.write(reduced, tmp_path / "a.astm", table=reduced.bsdf.tabulate(GRID))
        header = (tmp_path / "a.astm").read_text()
        relative = reduced.bsdf.uncertainty(45, 0, 45, 180) / reduced.bsdf.evaluate(45, 0, 45, 180) if stated else 0
        note = f" 45:{float(relative):.4f} "
        assert ("relative standard uncertainty in the mirror direction" in header and note in header) == stated
        assert ("relative standard uncertainty of the rows: median 0." in header) == stated
