"""The ASTM file, read back the way BSDF viewers read it."""

from __future__ import annotations

import numpy as np
import pytest
import samples

from brdfpipe import exchange
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


def test_every_pair_of_directions_stands_once(table, tmp_path):
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
