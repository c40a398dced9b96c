"""Reading colours at several geometries."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from brdfpipe import flakes, vocabulary
from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.spectra import colorimetry

LAB = {"45:-30": (33.90, -7.58, -36.61), "45:0": (12.29, 1.19, -25.77), "45:65": (3.07, 2.09, -13.24)}
VIEWING = {"illuminant": "D65", "observer": 10}


def inline(**changes):
    colours = [{"geometry": name, "lab": list(lab)} for name, lab in LAB.items()]
    return {"colours": colours, **VIEWING, **changes}


def written(folder: Path, text: str, encoding: str = "utf-8") -> Path:
    path = folder / "colours.csv"
    path.write_bytes(text.encode(encoding))
    return path


def test_the_patents_colours_have_its_luminances():
    multiangle = flakes.ingest(inline())
    vocabulary.validate(multiangle, "multiangle")
    # The third is printed for the constant 903.3 of L*; the exact 24389/27 gives 4e-6 less.
    assert multiangle["tristimulus"].sel(channel="Y").values == pytest.approx(
        [7.96026763, 1.45052385, 0.33986494], rel=5e-6
    )
    assert multiangle["tristimulus"].sel(channel="Y").values[:2] == pytest.approx([7.96026763, 1.45052385], abs=5e-9)
    assert multiangle["theta_o"].values.tolist() == [30.0, 0.0, 65.0]
    assert multiangle["phi_o"].values.tolist() == [180.0, 0.0, 0.0]


def test_a_file_and_the_same_colours_in_yaml_give_the_same_dataset(tmp_path):
    rows = "\n".join(f"{name},{lab[0]},{lab[1]},{lab[2]}" for name, lab in LAB.items())
    path = written(tmp_path, f"# measured\ngeometry,L*,a*,b*\n{rows}\n")
    assert flakes.ingest({"file": path.name, **VIEWING}, path).identical(flakes.ingest(inline()))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_semicolons_decimal_commas_and_encodings_are_read(tmp_path, encoding):
    rows = "\r\n".join(f"{name};" + ";".join(str(v).replace(".", ",") for v in lab) for name, lab in LAB.items())
    path = written(tmp_path, f"# für Lack\r\nGeometry;L;a;b\r\n{rows}\r\n", encoding)
    assert flakes.ingest({"file": "x", **VIEWING}, path)["tristimulus"].identical(
        flakes.ingest(inline())["tristimulus"]
    )


def test_explicit_angles_and_xyz_are_read(tmp_path):
    path = written(
        tmp_path, "theta_i\ttheta_o\tphi_o\tX\tY\tZ\n45\t30\t180\t7\t8\t24\n45\t0\t0\t2\t2\t5\n45\t65\t90\t1\t1\t1\n"
    )
    multiangle = flakes.ingest({"file": "x", **VIEWING}, path)
    assert multiangle["geometry"].values.tolist() == ["45:-30", "45:0", "45,0:65,90"]
    assert multiangle["tristimulus"].values[0].tolist() == [7.0, 8.0, 24.0]


@pytest.mark.parametrize(("scale", "factor"), [("percent", 100), ("fraction", 1)])
def test_spectra_are_read_and_sorted(tmp_path, scale, factor):
    wavelength = np.arange(700, 399, -20)
    titles = ",".join(f"R{value}nm" for value in wavelength)
    rows = "\n".join(f"{name}," + ",".join(str(factor * k / 1000) for k in wavelength) for name in LAB)
    multiangle = flakes.ingest({"file": "x", "scale": scale}, written(tmp_path, f"geometry,{titles}\n{rows}\n"))
    vocabulary.validate(multiangle, "multiangle")
    assert multiangle["wavelength"].values.tolist() == wavelength[::-1].tolist()
    assert multiangle["reflectance_factor"].values[0] == pytest.approx(wavelength[::-1] / 1000)


def test_a_geometry_that_yaml_reads_as_minutes_is_recognised():
    colours = [dict(item) for item in inline()["colours"]]
    colours[1]["geometry"] = 45 * 60
    assert flakes.ingest(inline(colours=colours))["theta_o"].values[1] == 0


def test_a_geometry_measured_twice_is_numbered():
    multiangle = flakes.ingest(inline(colours=inline()["colours"] * 2))
    assert multiangle.sizes["geometry"] == 6
    assert multiangle["geometry"].values[3] == "45:-30 (2)"


def test_a_geometry_in_the_gloss_is_warned_about():
    colours = [*inline()["colours"], {"geometry": "45as5", "lab": [80, 0, 0]}]
    assert "45as5: closer than 10 degree" in vocabulary.warnings(flakes.ingest(inline(colours=colours)))[0]


@given(
    st.lists(st.tuples(st.floats(0, 120), st.floats(-60, 60), st.floats(-60, 60)), min_size=3, max_size=10),
    st.sampled_from(["D65", "A", "D50"]),
    st.sampled_from([2, 10]),
)
def test_colours_go_to_xyz_and_back(labs, illuminant, observer):
    white = colorimetry.weights(illuminant, observer).white
    colours = [{"geometry": f"45as{15 + 5 * k}", "lab": list(lab)} for k, lab in enumerate(labs)]
    spec = {"colours": colours, "illuminant": illuminant, "observer": observer}
    if (colorimetry.lab_to_xyz(labs, white) < -1e-8 * white).any():
        with pytest.raises(InputError, match="X or Z below 0"):
            flakes.ingest(spec)
        return
    if (colorimetry.lab_to_xyz(labs, white) < 0).any():
        return
    multiangle = flakes.ingest(spec)
    # The steepest part of L*a*b* is 3900 a unit of relative XYZ.
    assert colorimetry.xyz_to_lab(multiangle["tristimulus"].values, white) == pytest.approx(np.array(labs), abs=1e-9)


def test_black_with_no_chroma_is_a_colour():
    colours = [{"geometry": name, "lab": [0, 0, 0]} for name in LAB]
    assert (flakes.ingest(inline(colours=colours))["tristimulus"].values == 0).all()


@pytest.mark.parametrize(
    ("changes", "pattern"),
    [
        ({"colours": inline()["colours"][:2]}, "wrong number of colours; found 2"),
        ({"colours": []}, "wrong number of colours; found 0"),
        ({"colours": "45:0"}, "`colours` is not a list of colours"),
        ({"colours": [{"geometry": "45:0"}] * 3}, "entry 1: each entry needs one colour"),
        ({"colours": [{"lab": [1, 1, 1]}] * 3}, "entry 1: either `geometry` or its angles are required"),
        ({"colours": [{"geometry": "45:0", "theta_i": 3, "lab": [1, 1, 1]}] * 3}, "either `geometry` or its angles"),
        ({"colours": [{"geometry": "x", "lab": [1, 1, 1]}] * 3}, "entry 1: geometry 'x': unknown geometry"),
        ({"colours": [{"geometry": "45:0", "lab": [1, 1]}] * 3}, "lab has the wrong length; found 2"),
        ({"colours": [{"geometry": "45:0", "lab": [1, 1, float("nan")]}] * 3}, "not a list of finite numbers"),
        ({"colours": [{"geometry": "45:0", "lab": [-1, 1, 1]}] * 3}, r"L\*a\*b\* out of range"),
        ({"colours": [{"geometry": "45:0", "lab": [0, 90, 1]}] * 3}, "tristimulus value out of range"),
        (
            {"colours": [{"theta_i": 45, "theta_o": 90, "phi_o": 0, "lab": [1, 1, 1]}] * 3},
            "invalid theta_o; found 90",
        ),
        (
            {"colours": [{"theta_i": 45, "theta_o": True, "phi_o": 0, "lab": [1, 1, 1]}] * 3},
            "invalid theta_o; found True",
        ),
        ({"illuminant": "D66"}, "unknown illuminant.*set `multiangle.illuminant`"),
        ({"observer": 5}, "set `multiangle.observer`"),
        ({"file": "a.csv"}, "exactly one of `file` and `colours` is required"),
        (
            {"colours": [{"geometry": "45:0", "reflectance": [0.1] * 5}] * 3, "wavelength": [400, 450, 500, 550, 600]},
            "must cover 400–700",
        ),
        (
            {"colours": [{"geometry": "45:0", "reflectance": [0.1] * 7}] * 3, "wavelength": list(range(400, 701, 50))},
            "scale of the reflectance factors",
        ),
    ],
)
def test_unusable_colours_are_refused_with_their_entry(changes, pattern):
    with pytest.raises(InputError, match=pattern):
        flakes.ingest(inline(**changes))


@pytest.mark.parametrize("key", ["illuminant", "observer"])
def test_colours_without_illuminant_or_observer_are_refused(key):
    spec = inline()
    del spec[key]
    with pytest.raises(InputError, match=f"the {key} of the colours is missing"):
        flakes.ingest(spec)


U_LAB = (0.3, 0.2, 0.4)


@pytest.mark.parametrize(
    "titles",
    ["L,a,b,u_L,u_a,u_b", "u(L*),L*,u(a*),a*,u(b*),b*", "L,L_std,a,a_std,b,b std", "L,a,b,sigma_a,SIGMA_L,σ b"],
)
def test_uncertainties_are_recognised_by_several_titles(tmp_path, titles):
    plain = {"L": 0, "a": 1, "b": 2}
    order = [
        next(letter for letter in plain if letter in re.sub("std|sigma|SIGMA|σ|u", "", t)) for t in titles.split(",")
    ]
    known = [bool(re.search("std|sigma|SIGMA|σ|u", title)) for title in titles.split(",")]
    rows = "\n".join(
        f"{name}," + ",".join(str(U_LAB[plain[letter]] if u else lab[plain[letter]]) for letter, u in zip(order, known, strict=True))
        for name, lab in LAB.items()
    )  # fmt: skip
    multiangle = flakes.ingest({"file": "x", **VIEWING}, written(tmp_path, f"geometry,{titles}\n{rows}\n"))
    vocabulary.validate(multiangle, "multiangle")
    assert multiangle["tristimulus"].identical(flakes.ingest(inline())["tristimulus"])
    assert (multiangle["tristimulus_u"] > 0).all()
    assert "independent standard uncertainties (k = 1)" in multiangle.attrs["history"]


def test_uncertainties_of_lab_become_those_of_xyz_as_many_draws_show(tmp_path):
    rows = "\n".join(f"{name},{lab[0]},{lab[1]},{lab[2]},0.3,0.2,0.4" for name, lab in LAB.items())
    path = written(tmp_path, f"geometry,L,a,b,u_L,u_a,u_b\n{rows}\n")
    multiangle = flakes.ingest({"file": "x", **VIEWING}, path)
    random = np.random.default_rng(1)
    draws = np.array(list(LAB.values())) + np.array(U_LAB) * random.standard_normal((20000, 3, 3))
    xyz = colorimetry.lab_to_xyz(draws, colorimetry.weights("D65", 10).white)
    # 20000 draws know a standard deviation to 0.5 %; L* = 3.07 lies in the linear part of the scale, 12.29 near its end.
    assert multiangle["tristimulus_u"].values == pytest.approx(xyz.std(axis=0), rel=0.02)


def test_uncertainties_of_xyz_and_of_spectra_are_kept_in_their_scale(tmp_path):
    path = written(
        tmp_path, "geometry,X,Y,Z,u_X,u_Y,u_Z\n45:-30,7,8,24,.1,.2,.3\n45:0,2,2,5,.1,.1,.1\n45:65,1,1,1,.1,.1,.1\n"
    )
    assert flakes.ingest({"file": "x", **VIEWING}, path)["tristimulus_u"].values[0].tolist() == [0.1, 0.2, 0.3]
    nm = np.arange(700, 399, -50)
    titles = ",".join([*(f"R{value}" for value in nm), *(f"u_{value} nm" for value in nm)])
    rows = "\n".join(",".join([name, *["50"] * nm.size, *(str(value / 100) for value in nm)]) for name in LAB)
    multiangle = flakes.ingest({"file": "x", "scale": "percent"}, written(tmp_path, f"geometry,{titles}\n{rows}\n"))
    vocabulary.validate(multiangle, "multiangle")
    assert multiangle["reflectance_factor_u"].values[0] == pytest.approx(nm[::-1] / 1e4)


def test_one_uncertainty_of_all_colours_is_that_of_every_column(tmp_path):
    rows = {
        u: "\n".join(f"{name},{lab[0]},{lab[1]},{lab[2]}{u}" for name, lab in LAB.items()) for u in ("", ",.2,.2,.2")
    }
    stated = {"file": "x", "colour_uncertainty": 0.2, **VIEWING}
    of_key = flakes.ingest(stated, written(tmp_path, f"geometry,L,a,b\n{rows['']}\n"))
    columns = written(tmp_path, f"geometry,L,a,b,u_L,u_a,u_b\n{rows[',.2,.2,.2']}\n")
    of_columns = flakes.ingest({"file": "x", **VIEWING}, columns)
    for name in ("tristimulus_u", "lab_u"):
        np.testing.assert_array_equal(of_key[name], of_columns[name])
    with pytest.raises(InputError, match="the file has columns of uncertainties; accepted: either these or"):
        flakes.ingest(stated, columns)


def test_columns_that_are_not_used_are_named(tmp_path):
    rows = "\n".join(f"{name},{lab[0]},{lab[1]},{lab[2]},x" for name, lab in LAB.items())
    multiangle = flakes.ingest({"file": "x", **VIEWING}, written(tmp_path, f"geometry,L,a,b,operator\n{rows}\n"))
    assert "tristimulus_u" not in multiangle
    assert "colours.csv: ignored columns: operator" in multiangle.attrs["history"]


@pytest.mark.parametrize(
    ("titles", "cells", "pattern"),
    [
        ("L,a,b,u_L,u_b", "9,1,1,.1,.1", "titles: the uncertainty of a is missing; found geometry, L, a, b, u_L, u_b"),
        (
            "L,a,b,u_L,u_a,u_b",
            "9,1,1,.1,0,.1",
            "line 2, column u_a: invalid standard uncertainty; found 0; accepted: above 0",
        ),
        ("L,a,b,u_L,u_a,u_b", "9,1,1,.1,-1,.1", "line 2, column u_a: invalid standard uncertainty; found -1"),
        ("L,a,b,u_L,u_a,u_b", "9,1,1,.1,,.1", "line 2, column u_a: not a number; found ''"),
    ],
)
def test_invalid_uncertainties_are_refused_with_their_column(tmp_path, titles, cells, pattern):
    rows = "\n".join(f"{name},{cells}" for name in LAB)
    with pytest.raises(InputError, match=pattern):
        flakes.ingest({"file": "x", **VIEWING}, written(tmp_path, f"geometry,{titles}\n{rows}\n"))


@pytest.mark.parametrize(
    ("text", "pattern"),
    [
        ("", "the table is empty"),
        ("geometry,L,a\n45:0,1,2\n", "no colour columns in the title line; found geometry, L, a"),
        ("L,a,b\n1,2,3\n1,2,3\n1,2,3\n", "line 2: either `geometry` or its angles"),
        ("geometry,L,a,b\n45:0,1,2\n", "line 2: the row has a different number of cells than the title line; found 3"),
        ("geometry,L,a,b\n45:0,1,2,three\n", "line 2, column b: not a number; found 'three'"),
        ("geometry,L,a,b\n45:0,1,2,nan\n", "not a number"),
        ("geometry,L,a,b\n\0,1,2,3\n", "not text"),
        ("geometry,L,a,b\n" + 200_000 * "4" + ",1,2,3\n", "not a table"),
    ],
)
def test_a_damaged_table_of_colours_is_refused_with_its_line(tmp_path, text, pattern):
    with pytest.raises(InputError, match=pattern):
        flakes.ingest({"file": "x", **VIEWING}, written(tmp_path, text))


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        flakes.ingest({"file": "x", **VIEWING}, tmp_path / "none.csv")


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_damaged_file_is_read_or_refused_but_never_crashes(tmp_path, data):
    good = b"geometry,L*,a*,b*\n45:-30,33.9,-7.58,-36.61\n45:0,12.29,1.19,-25.77\n45:65,3.07,2.09,-13.24\n"
    at = data.draw(st.integers(0, len(good) - 1))
    damage = data.draw(st.binary(max_size=4))
    path = tmp_path / "colours.csv"
    path.write_bytes(good[:at] + damage + good[at + data.draw(st.integers(0, 5)) :])
    try:
        multiangle = flakes.ingest({"file": "x", **VIEWING}, path)
    except BrdfpipeError:
        return
    vocabulary.validate(multiangle, "multiangle")


SIX = ["as-15", "as15", "as25", "as45", "as75", "as110"]


def test_an_export_of_six_angles_with_hyphens_as_signs_is_not_misread(tmp_path):
    path = written(tmp_path, "geometry;L;a;b\n" + "".join(f"{name};{40 - k};0;0\n" for k, name in enumerate(SIX)))
    with pytest.raises(InputError, match="45as-15 for 15 degree beyond the mirror") as refusal:
        flakes.ingest({"file": path.name, **VIEWING}, path)
    assert refusal.value.key == "multiangle.file"
    with pytest.raises(InputError, match="45as-15 for 15 degree beyond the mirror") as refusal:
        flakes.ingest(inline(colours=[{"geometry": name, "lab": [40, 0, 0]} for name in SIX]))
    assert refusal.value.key == "multiangle.colours"
