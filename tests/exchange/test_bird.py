"""Universal BRDF files of BiRD: valid by the schemas, read back by this package with their uncertainties, and refused where they contradict themselves."""

from __future__ import annotations

import json
import re
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import referencing
import samples
from damaged_files import check_garbled_files

from brdfpipe import optics
from brdfpipe.bsdf.input_uncertainty import uncertainty
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import error_of, fresh_pairs
from brdfpipe.errors import InputError
from brdfpipe.exchange.reading import read
from brdfpipe.exchange.registry import write

COARSE = {"tolerance": 0.1, "albedo_tolerance": 0.02, "largest": 40_000}


@pytest.fixture(scope="module")
def grey():
    """Of an index that is known to 0.01."""
    bsdf = samples.beckmann_bsdf(0.3)
    changes = uncertainty(bsdf, index=optics.refractive_index(1.55, uncertainty=0.01), spectrum=samples.spectrum(0.3))
    known = bsdf.merge(changes, combine_attrs="override")
    return known.assign_attrs(material="grey", digest="abc", uncertainty_not_stated="facets")


@pytest.fixture(scope="module")
def file(grey, tmp_path_factory):
    path = tmp_path_factory.mktemp("bird") / "grey.bird.json"
    write(grey, path, **COARSE, organization="A laboratory", timestamp="2026-01-02T03:04:05Z")
    return path


def validate(path: Path, shared_data: Path) -> None:
    # Among the published schemas one has a comma too many, and one a bracket.
    texts = (one.read_text() for one in (shared_data / "schemas" / "bird").glob("*.json"))
    schemas = [json.JSONDecoder().raw_decode(re.sub(r",(\s*[}\]])", r"\1", text).strip())[0] for text in texts]
    registry = referencing.Registry().with_resources(
        (schema["$id"], referencing.Resource.from_contents(schema)) for schema in schemas if "$id" in schema
    )
    (whole,) = (schema for schema in schemas if schema.get("$id", "").endswith("/brdf_json_schema_v1.0.json"))
    jsonschema.Draft202012Validator(whole, registry=registry).validate(json.loads(path.read_text()))


def test_the_file_is_valid_by_the_schemas(file, shared_data):
    validate(file, shared_data)
    metadata = json.loads(file.read_text())["metadata"]
    assert metadata["provenance"]["organization"] == "A laboratory"
    assert metadata["method"] == "simulation"
    assert metadata["sample"]["name"] == "grey"


def test_a_spectral_file_of_a_surface_with_a_lay_is_valid_and_read(tmp_path, shared_data):
    brushed = samples.brushed_bsdf(0.4, 0.2)
    write(brushed, tmp_path / "x.bird.json", **{**COARSE, "tolerance": 0.5, "albedo_tolerance": 0.1, "largest": 20_000})
    validate(tmp_path / "x.bird.json", shared_data)
    back, plain = read(tmp_path / "x.bird.json"), brushed.bsdf.nonspectral()
    along, across = (float(back.bsdf.evaluate(30, phi, 0, 0)) for phi in (0.0, 90.0))
    expected = [float(plain.bsdf.evaluate(30, phi, 0, 0)) for phi in (0.0, 90.0)]
    assert along / across == pytest.approx(expected[0] / expected[1], rel=0.3)


def test_the_file_read_back_errs_by_what_its_record_says(grey, file):
    record = json.loads(Path(f"{file}.json").read_text())
    model = grey.bsdf.nonspectral()
    found = error_of(model, representation(read(file)).evaluate, fresh_pairs(model, 11, incidences=24))
    assert found.percentile_95 <= 1.4 * record["error"]["percentile_95"] + 1e-4
    assert "uncertainty" not in record["left_out"]


def test_uncertainties_are_those_of_the_bsdf(grey, file):
    back = read(file)
    node = back.isel(theta_i=2, theta_o=3, phi_o=1)
    at = (float(node[name]) for name in ("theta_i", "theta_o", "phi_o"))
    theta_i, theta_o, phi_o = at
    expected = float(grey.bsdf.nonspectral().bsdf.uncertainty(theta_i, 0.0, theta_o, phi_o))
    # Three digits.
    assert float(node["brdf_u"]) == pytest.approx(expected, rel=6e-3)
    assert expected > 0


def test_points_are_listed_without_those_that_a_turn_repeats(file):
    data = json.loads(file.read_text())["data"]
    lengths = {len(data[name]["values"]) for name in ("theta_i", "phi_i", "theta_r", "phi_r", "BRDF", "uBRDF")}
    assert len(lengths) == 1
    assert max(data["phi_r"]["values"]) < 360
    assert set(data["phi_i"]["values"]) == {0.0}
    values, theta_r, theta_i = (np.array(data[name]["values"]) for name in ("BRDF", "theta_r", "theta_i"))
    phi_r = np.array(data["phi_r"]["values"])
    oblique = (theta_i > 30) & (np.abs(theta_r - theta_i) < 10)
    assert phi_r[oblique][values[oblique].argmax()] == 180


def test_other_units_and_relative_uncertainties_are_read(file, tmp_path):
    content = json.loads(file.read_text())
    for name in ("theta_i", "theta_r", "phi_r"):
        values = content["data"][name]["values"]
        content["data"][name] = {"unit": "rad", "values": np.radians(values).tolist()}
    brdf = np.array(content["data"]["BRDF"]["values"])
    content["data"]["uBRDF"] = {"unit": "%", "values": np.full(brdf.size, 5.0).tolist()}
    (tmp_path / "x.brdf").write_text(json.dumps(content))
    back, first = read(tmp_path / "x.brdf"), read(file)
    assert back["brdf"].values == pytest.approx(first["brdf"].values)
    assert back["brdf_u"].values == pytest.approx(0.05 * first["brdf"].values)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: data.pop("BRDF"), "no BRDF data"),
        (lambda data: data["theta_i"].update(unit="gon"), "unknown unit"),
        (lambda data: data["theta_i"]["values"].pop(), "differ in length"),
        (lambda data: data["BRDF"].update(values={"a": 1}), "must be numbers"),
        (lambda data: data["BRDF"].update(values=[]), "no list of numbers"),
        (lambda data: data["uBRDF"]["values"].pop(), "do not fit"),
        (lambda data: data.update(polarization_i={"notation": "sp", "values": ["s"]}), "polarised"),
        (lambda data: data["theta_r"]["values"].__setitem__(0, 120.0), "out of range"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused_with_what_was_found(file, tmp_path, change, message):
    content = json.loads(file.read_text())
    change(content["data"])
    (tmp_path / "bad.bird.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=message):
        read(tmp_path / "bad.bird.json")


@pytest.mark.parametrize("count", [30, pytest.param(300, marks=pytest.mark.slow)])
def test_damaged_files_are_read_or_refused_and_never_crash(file, tmp_path, count):
    check_garbled_files(file.read_bytes(), tmp_path / "x.json", "bird", count)
