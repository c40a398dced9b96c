"""Tables read from files, as BSDFs: missing cells, negative values, declared integrals and reciprocity are named."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import samples

from brdfpipe import facets
from brdfpipe.appearance import colours
from brdfpipe.bsdf import slab
from brdfpipe.bsdf.checks import check
from brdfpipe.errors import InputError
from brdfpipe.exchange import reading
from brdfpipe.exchange.read_table import ReadTable, as_bsdf
from brdfpipe.exchange.registry import ExchangeError, write
from brdfpipe.exchange.text_lines import Lines
from brdfpipe.spectra.colorimetry import delta_e_00, reflectance_to_xyz

THETA_I, THETA_S, PHI_S = np.array([0.0, 30.0, 80.0]), np.linspace(0, 150, 31), np.linspace(0, 180, 19)


TRANSMITTING = (
    ".transmission.zemax.bsdf",
    ".ddt",
    ".transmission.lighttools.bsdf",
    ".mbsdf",
)


def table(values=0.1, **options) -> ReadTable:
    shape = THETA_I.size, THETA_S.size, PHI_S.size, 1
    axes = {"theta_i": THETA_I, "theta_s": THETA_S, "phi_s": PHI_S}
    return ReadTable("specular", axes, np.broadcast_to(values, shape).astype(float).copy(), **options)


def warnings_of(read: ReadTable) -> str:
    return " | ".join(json.loads(as_bsdf(read, Path("x.bsdf")).attrs.get("warnings", "[]")))


def test_a_constant_table_is_a_perfect_diffuser():
    found = as_bsdf(table(0.3 / np.pi), Path("x.bsdf"))
    assert found.bsdf.albedo([10, 40]).values == pytest.approx([0.3, 0.3], rel=2e-3)
    assert "warnings" not in found.attrs
    assert (found["brdf_quality"] == 0).all()


def test_missing_cells_are_interpolated_and_flagged():
    read = table(THETA_S[None, :, None, None] + 1.0)
    read.values[1, 4, 7] = np.nan
    found = as_bsdf(read, Path("x.bsdf"))
    # Between cells at the same radius, linear on the chords of their triangles.
    assert float(found["brdf"][1, 4, 7]) == pytest.approx(21.0, rel=0.02)
    assert "interpolated" in found["brdf_quality"].attrs["flag_meanings"].split()[int(found["brdf_quality"][1, 4, 7])]
    assert "1 of" in warnings_of(read)


def test_zero_is_missing_only_where_the_format_says_so():
    read = table()
    read.values[2, 0, :] = 0.0
    assert float(as_bsdf(read, Path("x"))["brdf"][2, 0, 0]) == 0.0
    filled = as_bsdf(table(read.values, zero_is_missing=True), Path("x"))
    assert float(filled["brdf"][2, 0, 0]) == pytest.approx(0.1)


def test_negative_values_are_counted_and_become_zero():
    read = table()
    read.values[0, 3, 2] = -0.02
    assert "1 of" in warnings_of(read)
    assert "-0.02" in warnings_of(read)
    assert float(as_bsdf(read, Path("x"))["brdf"].min()) == 0.0


def test_another_declared_integral_is_named_and_nothing_is_rescaled():
    declared = np.full((THETA_I.size, 1), 0.2)
    assert warnings_of(table(0.2 / np.pi, declared_integral=declared)) == ""
    assert "not rescaled" in warnings_of(table(0.3 / np.pi, declared_integral=declared))
    found = as_bsdf(table(0.3 / np.pi, declared_integral=declared), Path("x"))
    assert float(found["brdf"].max()) == pytest.approx(0.3 / np.pi)


def test_a_table_times_the_cosine_is_not_reciprocal_and_is_converted_on_request():
    axes = {"theta_i": np.linspace(0, 85, 18), "theta_o": np.linspace(0, 85, 18), "phi_o": np.linspace(0, 180, 7)}
    cosine = np.broadcast_to(np.cos(np.radians(axes["theta_o"]))[None, :, None, None] / np.pi, (18, 18, 7, 1))
    read = ReadTable("uniform", axes, cosine.copy())
    assert "not reciprocal" in warnings_of(read)
    converted = ReadTable("uniform", axes, cosine.copy(), quantity="brdf_cos")
    assert warnings_of(converted) == ""
    assert as_bsdf(converted, Path("x"))["brdf"].values == pytest.approx(1 / np.pi)


def test_reflectance_factors_become_brdf():
    assert as_bsdf(table(np.pi, quantity="pi_brdf"), Path("x"))["brdf"].values == pytest.approx(1.0)


@pytest.mark.parametrize(("quantity", "scale"), [("brdf", 1.0), ("pi_brdf", 1 / np.pi)])
def test_uncertainties_are_on_the_scale_of_the_values(quantity, scale):
    read = table(0.2, quantity=quantity)
    found = as_bsdf(replace(read, uncertainty=read.values / 10), Path("x"))
    assert found["brdf_u"].values == pytest.approx(0.02 * scale)


def test_light_on_both_sides_times_the_cosine_is_converted_on_both():
    axes = {"theta_i": np.linspace(0, 80, 5), "theta_o": np.linspace(0, 180, 19), "phi_o": np.linspace(0, 180, 7)}
    cosine = np.broadcast_to(np.abs(np.cos(np.radians(axes["theta_o"])))[None, :, None, None] / 10, (5, 19, 7, 1))
    read = ReadTable("uniform", axes, cosine.copy(), quantity="brdf_cos", uncertainty=cosine / 10)
    found = as_bsdf(read, Path("x")).sel(theta_o=[30.0, 80.0, 100.0, 150.0])
    assert found["brdf"].values == pytest.approx(0.1)
    assert found["brdf_u"].values == pytest.approx(0.01)


def test_a_value_that_no_brdf_has_is_refused_also_after_conversion():
    read = table()
    read.values[1, 2, 3] = 1e30
    with pytest.raises(InputError, match=r"too large for a BRDF; if it marks a missing value.*found 1e\+30 sr-1"):
        as_bsdf(read, Path("x"))
    read.values[1, 2, 3] = 2e12
    with pytest.raises(InputError, match="too large for a BRDF"):
        as_bsdf(read, Path("x"))
    as_bsdf(replace(read, quantity="pi_brdf"), Path("x"))


@pytest.mark.parametrize(
    ("reflectance", "quantity", "words"),
    [
        (0.99, "brdf", ""),
        (3.0, "brdf", "send out 3 times the light that arrives.*read them as the quantity `pi_brdf`"),
        (3.0, "pi_brdf", ""),
        (60.0, "brdf", "send out 60 times.*if they are percentages, divide them by 100"),
        (1000.0, "brdf", "send out 1e\\+03 times.*check their unit and scale"),
    ],
)
def test_more_light_than_arrives_is_named_with_what_to_do(reflectance, quantity, words):
    found = warnings_of(table(reflectance / np.pi, quantity=quantity))
    assert re.search(words, found) if words else "light that arrives" not in found


def test_a_table_that_reflects_more_than_it_receives_fails():
    read = ReadTable("specular", table().axes, table(3.0 / np.pi).values)
    assert json.loads(check(as_bsdf(read, Path("x"))).attrs["verdicts"])["energy"]["verdict"] == "fail"


def test_the_uncertainty_of_relative_values_is_scaled_with_them():
    read = table(2.0, relative=True, declared_integral=np.full((THETA_I.size, 1), 0.5))
    found = as_bsdf(replace(read, uncertainty=read.values / 10), Path("x"))
    assert found["brdf_u"].values == pytest.approx(found["brdf"].values / 10)
    assert float(found.bsdf.albedo(20.0)) == pytest.approx(0.5, rel=1e-3)


def test_numbers_that_are_not_finite_are_refused():
    read = table()
    for angles, found in ((np.array([0.0, np.nan, 60.0]), "nan"), (np.array([0.0, 30.0, np.inf]), "inf")):
        with pytest.raises(InputError, match=f"theta_i is not finite; found {found}"):
            as_bsdf(replace(read, axes={**read.axes, "theta_i": angles}), Path("x"))
    read.values[0, 0, 0] = np.inf
    with pytest.raises(InputError, match="a value is infinite; found 1 of"):
        as_bsdf(read, Path("x"))


def test_a_number_of_a_line_is_finite(tmp_path):
    (tmp_path / "x").write_text("reflectance nan\n")
    lines = Lines(tmp_path / "x")
    lines.next("a reflectance")
    assert lines.number("0.5") == 0.5
    with pytest.raises(InputError, match=r"line 1.*not finite"):
        lines.number("nan")


def test_white_in_rgb_is_the_white_of_the_light():
    read = table()
    white = ReadTable(read.layout, read.axes, np.full((*read.values.shape[:-1], 3), 1 / np.pi), channels="rgb")
    found = as_bsdf(white, Path("x"))
    assert found["brdf"].values == pytest.approx(1 / np.pi)
    x, y, z = found["brdf_xyz"].values[0, 0, 0]
    # D65, 2 degree: X = 0.9505, Z = 1.0888 of Y = 1 (IEC 61966-2-1).
    assert (x / y, z / y) == pytest.approx((0.9505, 1.0888), abs=5e-4)


def test_the_colour_of_a_file_is_that_of_its_source_for_the_other_observer_too(tmp_path):
    red = samples.beckmann_bsdf(0.3, reflectance=0.05 + 0.6 / (1 + np.exp(-(samples.WAVELENGTH - 590) / 25)))
    write(red, tmp_path / "red.zemax.bsdf", colour=True, tolerance=0.05)
    back = reading.read(tmp_path / "red.zemax.bsdf")
    for observer in (2, 10):
        wanted, found = (colours.colour(one, ["45:0"], "D65", observer).values for one in (red, back))
        assert delta_e_00(wanted, found).max() < 1.5


def test_colours_outside_srgb_keep_their_luminance_at_every_direction_and_in_the_reflectance():
    """A deep red has a negative green value. Its spectra are cut off at 0 in no direction, so that the reflectance is their integral."""
    axes = {"theta_i": np.linspace(0, 80, 5), "theta_o": np.linspace(0, 85, 18), "phi_o": np.linspace(0, 180, 19)}
    lobe = np.exp(-np.square(axes["theta_o"] / 30))[None, :, None, None] * np.ones((5, 1, 19, 1))
    rgb = lobe * [0.25, -0.01, 0.05] + (1 - lobe) * [0.05, 0.02, 0.02]
    found = as_bsdf(ReadTable("uniform", axes, rgb, channels="rgb"), Path("x"))
    verdicts = json.loads(check(found).attrs["verdicts"])
    assert {name: verdicts[name]["verdict"] for name in ("energy", "positivity", "integral")} == dict.fromkeys(
        ("energy", "positivity", "integral"), "pass"
    )
    spectral, luminous = found.bsdf.albedo([10.0, 45.0]), found.bsdf.nonspectral().bsdf.albedo([10.0, 45.0])
    y = reflectance_to_xyz(found["wavelength"].values, spectral.values, "D65", 2)[:, 1] / 100
    assert y == pytest.approx(luminous.values, rel=1e-6)


def test_a_grey_file_is_grey():
    found = as_bsdf(table(0.1), Path("x.bsdf"))
    assert colours.colour(found, ["45:0"]).values[:, 1:] == pytest.approx(0, abs=1e-9)


def test_incidences_that_the_file_does_not_have_are_named():
    read = table()
    few = ReadTable(read.layout, {**read.axes, "theta_i": np.array([15.0, 30.0, 60.0])}, read.values)
    assert "from 15 to 60 degree" in warnings_of(few)
    many = ReadTable(read.layout, {**read.axes, "theta_i": np.array([0.0, 45.0, 80.0])}, read.values)
    assert warnings_of(many) == ""


@pytest.mark.parametrize(("last", "named"), [(90, True), (180, False), (360, False)])
def test_azimuths_of_incidence_that_are_neither_a_circle_nor_half_of_it_are_named(last, named):
    read = table()
    lay = np.linspace(0, last, 4)
    values = np.repeat(read.values[None], lay.size, axis=0)
    found = warnings_of(ReadTable("specular", {"phi_i": lay, **read.axes}, values))
    assert ("from 0 to 90 degree, neither a circle nor half of it" in found) == named


def test_one_incidence_serves_for_all_and_says_so():
    read = table()
    one = ReadTable(read.layout, {**read.axes, "theta_i": np.array([30.0])}, read.values[:1])
    found = as_bsdf(one, Path("x"))
    assert "one angle theta_i" in found.attrs["history"]
    assert float(found.bsdf.evaluate(60, 0, 10, 0)) == pytest.approx(0.1)


def test_a_table_without_values_or_with_unsorted_angles_is_refused():
    with pytest.raises(InputError, match="no cell has a value"):
        as_bsdf(table(np.nan), Path("x"))
    read = table()
    with pytest.raises(InputError, match="do not increase"):
        as_bsdf(ReadTable(read.layout, {**read.axes, "theta_i": THETA_I[::-1]}, read.values), Path("x"))


@pytest.mark.parametrize(
    ("name", "format", "quantity", "message"),
    [
        ("x.bsdf", "unheard", None, "unknown format"),
        ("x.unknown", None, None, "no format has such files"),
        ("x.bsdf", None, "radiance", "unknown quantity"),
        ("missing.bsdf", None, None, "no such file"),
        ("empty.bsdf", None, None, "the file is empty"),
    ],
)
def test_what_cannot_be_read_is_refused_with_the_key_to_set(tmp_path, name, format, quantity, message):
    if name != "missing.bsdf":
        (tmp_path / name).write_text("" if name == "empty.bsdf" else "Source Measured\n")
    with pytest.raises(InputError, match=message) as refusal:
        reading.read(tmp_path / name, format, quantity=quantity)
    assert "`table." in str(refusal.value)


@pytest.fixture(scope="module")
def sheet():
    rough = facets.analytic("beckmann", 0.3)
    return slab.build(rough, rough, index=1.5, internal_transmittance=0.9)


@pytest.mark.parametrize("suffix", TRANSMITTING)
def test_light_that_passes_a_sheet_is_written_and_read(sheet, tmp_path, suffix):
    path = tmp_path / f"sheet{suffix}"
    write(sheet, path, tolerance=0.05, albedo_tolerance=0.01)
    record = json.loads(Path(f"{path}.json").read_text())
    assert record["error"]["within_tolerance"]
    assert "transmission" not in record["left_out"]
    back, plain = reading.read(path).bsdf.nonspectral(), sheet.bsdf.nonspectral()
    for theta_i in (10.0, 45.0):
        assert float(back.bsdf.transmittance(theta_i)) == pytest.approx(
            float(plain.bsdf.transmittance(theta_i)), rel=0.01
        )
    if suffix != ".mbsdf":
        assert float(back.bsdf.albedo(45.0)) == 0.0
    # Beside the ray that goes straight on, on both sides of the plane of incidence and off it.
    for theta_o, phi_o in ((150.0, 220.0), (140.0, 220.0), (165.0, 200.0)):
        expected = float(plain.bsdf.evaluate(30, 40, theta_o, phi_o))
        assert float(back.bsdf.evaluate(30, 40, theta_o, phi_o)) == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("suffix", [".zemax.bsdf", ".ddr", ".lighttools.bsdf"])
def test_a_file_of_reflected_light_errs_by_its_own_side_alone(sheet, tmp_path, suffix):
    path = tmp_path / f"sheet{suffix}"
    write(sheet, path, tolerance=0.05, albedo_tolerance=0.01)
    assert json.loads(Path(f"{path}.json").read_text())["error"]["within_tolerance"]
    plain = sheet.bsdf.nonspectral()
    assert float(reading.read(path).bsdf.albedo(30.0)) == pytest.approx(float(plain.bsdf.albedo(30.0)), rel=0.02)


@pytest.mark.parametrize("suffix", TRANSMITTING[:3])
def test_a_material_that_no_light_passes_has_no_file_of_transmitted_light(tmp_path, suffix):
    with pytest.raises(ExchangeError, match="no sheet"):
        write(samples.beckmann_bsdf(0.3), tmp_path / f"grey{suffix}")
