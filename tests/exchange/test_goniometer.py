"""Tables of a goniometer in the plane of incidence: the values of the file, what was assumed beside them, and files that are refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
import samples
import xarray as xr
from damaged_files import check_garbled_files

from brdfpipe.errors import InputError
from brdfpipe.exchange.reading import read
from brdfpipe.exchange.registry import WRITTEN, ExchangeError, write

INCIDENCES = (10.0, 30.0, 50.0)
WAVELENGTHS = (450.0, 550.0, 650.0)


def views(theta_i: float) -> np.ndarray:
    """From -78 to 78 degree, in steps of 1 near the mirror direction and of 3 elsewhere."""
    return np.union1d(np.arange(-78.0, 79.0, 3.0), theta_i + np.arange(-12.0, 13.0))


def content(bsdf: xr.Dataset) -> str:
    """The file of a BSDF, whose detector hides views within 7.6 degree of the source."""
    lines = [" Incident_angle,Measure_angle," + ",".join(f" {one:g}nm " for one in WAVELENGTHS)]
    for theta_i in INCIDENCES:
        view = views(theta_i)
        factors = (
            np.pi * bsdf.bsdf.evaluate(theta_i, 0.0, np.abs(view), np.where(view > 0, 180.0, 0.0), WAVELENGTHS).values
        )
        factors = np.where(np.abs(view + theta_i)[:, None] < 7.6, 0.0, factors)
        lines += [
            f"{theta_i:g},{at:g}," + ",".join(f"{one:.5g}" for one in row)
            for at, row in zip(view, factors, strict=True)
        ]
    return "\n".join(lines) + "\n"


@pytest.fixture(scope="module")
def satin():
    return samples.beckmann_bsdf(0.15, reflectance=np.linspace(0.2, 0.5, samples.WAVELENGTH.size))


@pytest.fixture(scope="module")
def file(satin, tmp_path_factory):
    path = tmp_path_factory.mktemp("goniometer") / "satin.csv"
    path.write_text(content(satin))
    return path


def number(values: xr.DataArray) -> float:
    return float(values.item())


def warnings_of(table: xr.Dataset) -> str:
    return " | ".join(json.loads(table.attrs["warnings"]))


def test_in_the_plane_the_table_has_the_values_of_the_file(satin, file):
    table = read(file)
    for theta_i in INCIDENCES:
        view = views(theta_i)
        view = view[(np.abs(view + theta_i) >= 7.6) & (view != 0)]
        at = theta_i, 0.0, np.abs(view), np.where(view > 0, 180.0, 0.0), WAVELENGTHS
        # Five digits in the file: half of the last one is up to 5e-5.
        assert table.bsdf.evaluate(*at).values == pytest.approx(satin.bsdf.evaluate(*at).values, rel=5e-5)


def test_positive_views_are_on_the_side_of_the_mirror_direction(file):
    table = read(file)
    assert number(table.bsdf.evaluate(30, 0, 30, 180, 550)) > 2 * number(table.bsdf.evaluate(30, 0, 21, 0, 550))
    # A surface without a lay: the plane may be turned.
    assert number(table.bsdf.evaluate(30, 70, 33, 250, 550)) == pytest.approx(
        number(table.bsdf.evaluate(30, 0, 33, 180, 550))
    )


def test_an_isotropic_lobe_keeps_its_light_outside_the_plane(satin, file):
    table = read(file)
    # The values of facets depend on the half vector, but also on the cosines of both directions: 5 % for a lobe of 17 degree.
    for theta_i in INCIDENCES:
        assert number(table.bsdf.albedo(theta_i, wavelength=550)) == pytest.approx(
            number(satin.bsdf.albedo(theta_i, wavelength=550)), rel=0.05
        )


def test_what_is_assumed_outside_the_plane_is_a_warning_and_flagged(file):
    table = read(file)
    assert "the plane of incidence alone" in warnings_of(table)
    flags = table["brdf_quality"].attrs["flag_meanings"].split()
    beside = table["brdf_quality"].sel(phi_s=90.0)
    assert {flags[one] for one in np.unique(beside[:, 1:])} == {"extrapolated"}
    assert (beside[:, 0] == 0).all()


def test_shadowed_rows_are_interpolated_flagged_and_counted(satin, file):
    table = read(file)
    hidden = sum(int((np.abs(views(theta_i) + theta_i) < 7.6).sum()) for theta_i in INCIDENCES)
    total = sum(views(theta_i).size for theta_i in INCIDENCES)
    assert f"{hidden} of {total} rows are all 0" in warnings_of(table)
    assert "30°: -36 to -24" in warnings_of(table)
    flags = table["brdf_quality"].attrs["flag_meanings"].split()
    quality = table["brdf_quality"].sel(theta_i=30.0, phi_s=0.0)
    assert flags[int(quality.sel(theta_s=60.0))] == "interpolated"
    assert flags[int(quality.sel(theta_s=51.0))] == "measured"
    # Far from the lobe the values are even: the gap of 15 degree is crossed within 3 %.
    at = 30.0, 0.0, 30.0, 0.0, 550.0
    assert number(table.bsdf.evaluate(*at)) == pytest.approx(number(satin.bsdf.evaluate(*at)), rel=0.03)


def test_the_format_is_read_and_not_written(satin, tmp_path):
    assert "goniometer" not in WRITTEN
    with pytest.raises(ExchangeError, match="unknown format"):
        write(satin, tmp_path / "x.csv", "goniometer")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("Measure_angle", "View_angle", "unknown columns"),
        (" 450nm ", " blue ", "not increasing wavelengths"),
        (" 450nm ", " 950nm ", "not increasing wavelengths"),
        ("\n10,-78,", "\n10,-78,1,", "wrong number of columns"),
        ("\n10,-78,", "\n10,-98,", "out of range"),
        ("\n10,-78,", "\n95,-78,", "out of range"),
        ("\n10,-78,", "\n11,-78,", "fewer than two values"),
        ("\n10,-75,", "\n10,-78,", "occurs twice"),
        ("\n10,-78,", "\n10,-78,x", "not a number"),
        ("\n10,-78,", "\n10,-78,nan", "n"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused_with_what_was_found(file, tmp_path, old, new, message):
    text = file.read_text()
    assert old in text
    (tmp_path / "bad.csv").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read(tmp_path / "bad.csv", "goniometer")


def test_a_file_whose_views_have_the_other_sign_is_refused(file, tmp_path):
    head, *rows = file.read_text().splitlines()
    turned = [",".join([cells[0], str(-float(cells[1])), *cells[2:]]) for cells in (row.split(",") for row in rows)]
    (tmp_path / "turned.csv").write_text("\n".join([head, *turned]))
    with pytest.raises(InputError, match="shadow of the detector"):
        read(tmp_path / "turned.csv")


def test_a_table_of_many_angles_is_refused_before_it_is_made(tmp_path):
    rows = "\n".join(f"{0.01 * k:g},{0.007 * j:g},1" for k in range(40) for j in range(40))
    (tmp_path / "many.csv").write_text("Incident_angle,Measure_angle,550nm\n" + rows)
    # 40 incidences with 40 views each have few angles from the mirror direction in common.
    table = read(tmp_path / "many.csv")
    assert table["theta_s"].size < 1600
    spread = "\n".join(f"{0.01 * k:g},{np.sqrt(2) * j + np.pi * k / 1e3:.9g},1" for k in range(800) for j in range(50))
    (tmp_path / "spread.csv").write_text("Incident_angle,Measure_angle,550nm\n" + spread)
    with pytest.raises(InputError, match="too large"):
        read(tmp_path / "spread.csv")


@pytest.mark.parametrize("count", [30, pytest.param(300, marks=pytest.mark.slow)])
def test_damaged_files_are_read_or_refused_and_never_crash(file, tmp_path, count):
    check_garbled_files(file.read_bytes(), tmp_path / "x.csv", "goniometer", count)


def test_a_real_table_has_its_values_and_its_shadows(shared_data):
    table = read(shared_data / "bsdf" / "inplane_gonio_35nm.csv")
    assert number(np.pi * table.bsdf.evaluate(10, 0, 78, 0, 390)) == pytest.approx(0.7165)
    assert number(np.pi * table.bsdf.evaluate(60, 0, 59, 180, 550)) == pytest.approx(123.6701)
    assert "26 of 329 rows are all 0" in warnings_of(table)
    assert table["wavelength"].values[[0, -1]].tolist() == [390.0, 730.0]
    # A white sample: its albedo at 25 degree is that of the plane, 0.94 to 0.97, and the lobe's.
    assert 0.93 < number(table.bsdf.albedo(25.0, wavelength=550)) < 1.0
