"""Look-up tables of OpenMATERIAL 3D: valid by its schema, read back by this package, and row by row by rules of the format alone."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import samples
from damaged_files import check_garbled_files

from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import error_of, fresh_pairs
from brdfpipe.errors import InputError
from brdfpipe.exchange.reading import read
from brdfpipe.exchange.registry import ExchangeError, write

COARSE = {"tolerance": 0.1, "albedo_tolerance": 0.02, "largest": 40_000}


@pytest.fixture(scope="module")
def grey():
    return samples.beckmann_bsdf(0.3).assign_attrs(material="grey", digest="abc")


@pytest.fixture(scope="module")
def file(grey, tmp_path_factory):
    path = tmp_path_factory.mktemp("openmaterial") / "grey_brdf.xompt"
    write(grey, path, **COARSE, author="A. Person")
    return path


def test_the_file_is_valid_by_the_schema(file, shared_data):
    schema = json.loads((shared_data / "schemas" / "openmaterial" / "material_brdf_schema.json").read_text())
    content = json.loads(file.read_text())
    jsonschema.Draft7Validator(schema).validate(content)
    assert content["metadata"]["authors"] == ["A. Person"]


def test_the_file_read_back_errs_by_what_its_record_says(grey, file):
    record = json.loads(Path(f"{file}.json").read_text())
    model = grey.bsdf.nonspectral()
    found = error_of(model, representation(read(file)).evaluate, fresh_pairs(model, 11, incidences=24))
    assert found.percentile_95 <= 1.4 * record["error"]["percentile_95"] + 1e-4
    assert found.albedo <= record["error"]["albedo"] + 5e-4


def test_rows_are_sorted_and_hold_metres_radians_and_the_brdf(grey, file):
    rows = np.array(json.loads(file.read_text())["brdf"]["lookupTable"])
    assert (np.lexsort(rows[:, 3::-1].T) == np.arange(len(rows))).all()
    assert set(rows[:, 0]) == {5.55e-7}
    assert rows[0, 3] == 0
    assert rows[:, 3].max() == 6.283185
    plain = grey.bsdf.nonspectral()
    chosen = rows[(rows[:, 1] > 0.3) & (rows[:, 2] < 1.2)][:: len(rows) // 40]
    theta_i, theta_o, phi_o = np.degrees(chosen[:, 1:4]).T
    # The table is scaled by at most its tolerance so that it keeps the reflectance, and has five digits.
    assert chosen[:, 4] == pytest.approx(plain.bsdf.evaluate(theta_i, 0.0, theta_o, phi_o).values, rel=0.1002)
    # The mirror direction of 45 degree has the azimuth π.
    near = np.abs(rows[:, 1] - rows[:, 2]) < 0.1
    at = rows[near & (rows[:, 1] > 0.5)]
    assert at[at[:, 4].argmax(), 3] == pytest.approx(np.pi, abs=1e-5)


def test_a_spectrum_has_a_table_for_each_wavelength(tmp_path):
    coloured = samples.beckmann_bsdf(0.3, reflectance=np.linspace(0.1, 0.6, samples.WAVELENGTH.size))
    few = coloured.isel(wavelength=[10, 40, 70])
    write(few, tmp_path / "x_brdf.xompt", spectral=True, **{**COARSE, "largest": 10_000})
    back = read(tmp_path / "x_brdf.xompt")
    assert back["wavelength"].values == pytest.approx(few["wavelength"].values)
    assert back.bsdf.albedo(30.0).values.ravel() == pytest.approx(few.bsdf.albedo(30.0).values.ravel(), rel=0.03)


def test_a_lay_is_refused(tmp_path):
    with pytest.raises(ExchangeError, match="lay"):
        write(samples.brushed_bsdf(0.4, 0.2), tmp_path / "x_brdf.xompt")


def test_null_is_a_missing_value_and_receivers_are_noted(file, tmp_path):
    content = json.loads(file.read_text())
    content["brdf"]["lookupTable"][40][4] = None
    content["brdf"]["receiverSolidAngles"] = [{"wavelength": 5.55e-7, "solidAngle": 1e-4}]
    (tmp_path / "x.xompt").write_text(json.dumps(content))
    back = read(tmp_path / "x.xompt")
    assert "1 of" in back.attrs["warnings"]
    assert "0.0001 sr at 555 nm" in back.attrs["history"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda brdf: brdf.pop("lookupTable"), "no look-up table"),
        (lambda brdf: brdf["lookupTable"][3].pop(), "not five values"),
        (lambda brdf: brdf["lookupTable"].append(brdf["lookupTable"][0]), "occurs twice"),
        (lambda brdf: brdf["lookupTable"][0].__setitem__(4, "x"), "must be numbers"),
        (lambda brdf: brdf["lookupTable"][0].__setitem__(4, []), "must be numbers"),
        (lambda brdf: brdf["lookupTable"][0].__setitem__(1, None), "no value of theta_i"),
        (lambda brdf: brdf["lookupTable"][0].__setitem__(0, -1), "wavelength is out of range"),
        (lambda brdf: brdf.update(lookupTable=brdf["lookupTable"][:: len(brdf["lookupTable"]) // 13]), "no grid"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused_with_what_was_found(file, tmp_path, change, message):
    content = json.loads(file.read_text())
    change(content["brdf"])
    (tmp_path / "bad.xompt").write_text(json.dumps(content))
    with pytest.raises(InputError, match=message):
        read(tmp_path / "bad.xompt")


def test_properties_of_other_kinds_are_refused(shared_data):
    with pytest.raises(InputError, match="no look-up table of a BRDF"):
        read(shared_data / "schemas" / "openmaterial" / "example_material_optical.xompt")


@pytest.mark.parametrize("count", [30, pytest.param(300, marks=pytest.mark.slow)])
def test_damaged_files_are_read_or_refused_and_never_crash(file, tmp_path, count):
    check_garbled_files(file.read_bytes(), tmp_path / "x.xompt", "openmaterial", count)
