"""What materials inherit from ``catalogue.yaml``, how they override it, and what names its file and line."""

from __future__ import annotations

import contextlib
import pickle
from pathlib import Path

import pytest
from click.testing import CliRunner

from brdfpipe import catalogue, installation
from brdfpipe.catalogue.default_keys import SpectrumDefaults, SurfaceDefaults
from brdfpipe.catalogue.defaults import load_defaults
from brdfpipe.catalogue.material_keys import Colour, MeasuredSpectrum, MeasuredSurface, SpectrumOfPair, SpectrumPair
from brdfpipe.catalogue.raw_reading import describe_files
from brdfpipe.cli.main import main
from brdfpipe.errors import InputError
from brdfpipe.jobs.stage import Job, perform
from brdfpipe.report.material.page import material_page
from brdfpipe.spectra.ingestion import ingest
from brdfpipe.stages import STAGES, Subject

DEFAULTS = """\
index: ABS
index_uncertainty: 0.005
surface: {form: polynomial-2, lambda_s: 2.5}
spectrum:
  geometry: sci
  scale: percent
  illuminant: D50
  observer: 10
exports: [astm, merl]
scene: gloss-sheet
"""
SCAN = "surface: {file: a.txt, unit: um, pitch: 1}\n"


def write(folder: Path, defaults: str = DEFAULTS, **materials: str) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "catalogue.yaml").write_text(defaults)
    for name, text in materials.items():
        (folder / name).mkdir(exist_ok=True)
        (folder / name / "material.yaml").write_text(text)
        (folder / name / "a.txt").write_text("1 2\n")
    return folder


def test_materials_inherit_what_they_do_not_say(tmp_path: Path) -> None:
    loaded = catalogue.load(write(tmp_path, m=SCAN + "spectrum: {file: a.txt}\n"))
    content, material = loaded["m"].content, loaded["m"]
    assert content["index"] == "ABS"
    assert content["index_uncertainty"] == 0.005
    assert content["surface"]["form"] == "polynomial-2"
    assert content["surface"]["lambda_s"] == 2.5
    assert content["spectrum"] == {
        "file": "a.txt",
        "geometry": "sci",
        "scale": "percent",
        "allow_fluorescent": False,
    }
    assert material.exports == ("astm", "merl")
    assert material.scene.name == loaded.scene.name == "gloss-sheet"


def test_materials_override_what_they_inherit(tmp_path: Path) -> None:
    own = (
        "surface: {file: a.txt, unit: um, pitch: 1, form: plane, noise: 0.01}\nindex: 1.5\nexports: []\n"
        "spectrum: {lab: [50, 0, 0], illuminant: A, geometry: sce}\n"
    )
    content = catalogue.load(write(tmp_path, m=own))["m"].content
    assert content["index"] == 1.5
    assert "index_uncertainty" not in content, "that of another index"
    assert content["surface"]["form"] == "plane"
    assert "lambda_s" not in content["surface"], "excluded by `noise`"
    assert content["spectrum"] == {
        "lab": [50, 0, 0],
        "illuminant": "A",
        "observer": 10,
        "geometry": "sce",
    }
    assert content["exports"] == []


@pytest.mark.parametrize(
    "text",
    [
        "multiangle: {colours: [{geometry: 45as15, lab: [50, 0, 0]}, {geometry: 45as45, lab: [40, 0, 0]}, {geometry: 45as110, lab: [30, 0, 0]}], illuminant: D65, observer: 10}\n",
        "spectrum: {lab: [50, 0, 0]}\n",
        "surface: {distribution: flat}\n",
    ],
)
def test_a_material_inherits_only_keys_that_have_a_place_in_it(tmp_path: Path, text: str) -> None:
    loaded = catalogue.load(write(tmp_path, DEFAULTS.replace("scene: gloss-sheet\n", ""), m=text))
    assert loaded.failures == {}
    content = loaded["m"].content
    assert ("index" in content) == ("surface" in text)
    assert "scale" not in content.get("spectrum", {})
    assert "form" not in content.get("surface", {})


def test_both_spectra_of_a_sample_inherit_their_scale(tmp_path: Path) -> None:
    content = catalogue.load(write(tmp_path, m="spectrum: {sci: {file: a.txt}, sce: {file: a.txt, scale: fraction}}\n"))
    spectrum = content["m"].content["spectrum"]
    assert (spectrum["sci"]["scale"], spectrum["sce"]["scale"]) == ("percent", "fraction")
    assert "spectrum.scale" not in content.unused_defaults


def test_a_material_overrides_the_uncertainty_of_an_index_that_it_inherits(tmp_path: Path) -> None:
    defaults = "index: 1.5\nindex_uncertainty: 0.001\n"
    loaded = catalogue.load(write(tmp_path, defaults, m=SCAN + "index_uncertainty: 0.05\n", n=SCAN))
    assert {name: (one.content["index"], one.content["index_uncertainty"]) for name, one in loaded.by_name.items()} == {
        "m": (1.5, 0.05),
        "n": (1.5, 0.001),
    }


@pytest.mark.parametrize("half", ["sci", "sce"])
def test_a_pair_of_spectra_with_a_column_of_uncertainties_inherits_no_uncertainty(tmp_path: Path, half: str) -> None:
    files = dict.fromkeys(("sci", "sce"), "{file: a.txt}") | {half: "{file: a.txt, uncertainty: u}"}
    pair = f"spectrum: {{sci: {files['sci']}, sce: {files['sce']}}}\n"
    plain = "spectrum: {sci: {file: a.txt}, sce: {file: a.txt}}\n"
    loaded = catalogue.load(write(tmp_path, "spectrum: {reflectance_uncertainty: 0.005}\n", m=pair, n=plain))
    assert "reflectance_uncertainty" not in loaded["m"].content["spectrum"]
    assert loaded["n"].content["spectrum"]["reflectance_uncertainty"] == 0.005


@pytest.mark.parametrize("pair", [False, True])
def test_uncertainties_in_a_file_replace_the_inherited_one(tmp_path: Path, pair: bool) -> None:
    titled = "wavelength [nm],R,u_R\n" + "".join(f"{nm},0.4,{0.001 + 1e-6 * nm}\n" for nm in range(400, 701, 10))
    block = "{sci: {file: a.txt, scale: fraction}, sce: {file: b.txt}}" if pair else "{file: a.txt, geometry: sci}"
    folder = write(tmp_path, "spectrum: {reflectance_uncertainty: 0.02, scale: fraction}\n", m=f"spectrum: {block}\n")
    (folder / "m" / "a.txt").write_text(titled)
    (folder / "m" / "b.txt").write_text(titled.replace("0.4,", "0.36,"))
    loaded = catalogue.load(folder)
    beside = folder / "m" / "b.txt" if pair else None
    spectrum = ingest(loaded.spec("m", "spectrum"), folder / "m" / "a.txt", excluded=beside)
    assert spectrum["total_reflectance_u"].values[0] == pytest.approx(0.0014)
    assert "`reflectance_uncertainty` 0.02 of the catalogue was left out" in spectrum.attrs["history"]
    (folder / "m" / "a.txt").write_text("\n".join(line.rpartition(",")[0] for line in titled.splitlines()))
    spectrum = ingest(loaded.spec("m", "spectrum"), folder / "m" / "a.txt", excluded=beside)
    assert (spectrum["total_reflectance_u"] == 0.02).all()


def test_the_scene_of_a_catalogue_lies_in_it(tmp_path: Path) -> None:
    (tmp_path / "out.yaml").write_text("name: x\n")
    folder = write(tmp_path / "c", "exports: []\nscene: ../out.yaml\n", m=SCAN + "index: 1.5\n")
    with pytest.raises(InputError, match=r"catalogue\.yaml, line 2, scene: leads outside the catalogue"):
        catalogue.load(folder)


def test_every_default_is_a_key_of_materials() -> None:
    assert SurfaceDefaults.model_fields.keys() <= MeasuredSurface.model_fields.keys()
    of_spectra = {
        name for form in (MeasuredSpectrum, Colour, SpectrumPair, SpectrumOfPair) for name in form.model_fields
    }
    assert SpectrumDefaults.model_fields.keys() <= of_spectra


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (
            "index: ABS\nspectrum:\n  scale: perzent\n",
            r"catalogue\.yaml, line 3, spectrum\.scale: not an accepted value",
        ),
        ("index: nylon\n", r"catalogue\.yaml, line 1, index: unknown material name"),
        ("surface: {file: a.txt}\n", r"catalogue\.yaml, line 1, surface: unknown key 'file'"),
        ("index_uncertainty: 0.1\n", r"catalogue\.yaml"),
        ("exports: [photoshop]\n", r"catalogue\.yaml, line 1, exports\.0"),
        ("scene: nowhere\n", r"catalogue\.yaml, line 1, scene"),
        ("spectrum: {illuminant: D66}\n", r"catalogue\.yaml, spectrum\.illuminant"),
        ("a: &a [*a]\n", r"catalogue\.yaml"),
        ("", r"catalogue\.yaml: empty"),
    ],
)
def test_a_wrong_default_names_its_file_and_line(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        catalogue.load(write(tmp_path, text, m="spectrum: {lab: [50, 0, 0]}\n"))


def test_an_inherited_value_that_contradicts_a_material_names_the_line_of_the_catalogue(tmp_path: Path) -> None:
    slab = "surface: {distribution: flat}\nslab: {thickness: 1}\n"
    loaded = catalogue.load(
        write(
            tmp_path,
            "exports: []\nindex: {n: 1.2, k: 7}\n",
            m=slab,
            other="spectrum: {lab: [5, 0, 0], illuminant: A, observer: 2, geometry: sci}\n",
        )
    )
    assert loaded.failures["m"].startswith("catalogue.yaml, line 2, index.k: the body of a slab would be opaque")
    assert list(loaded.by_name) == ["other"], "one bad material does not stop the others"


def test_a_default_changes_the_stages_that_use_it_alone(tmp_path: Path) -> None:
    text = {"m": SCAN + "spectrum: {file: a.txt}\n", "own": SCAN + "index: 1.5\nspectrum: {file: a.txt}\n"}

    def parameters(defaults: str, name: str) -> dict[str, object]:
        loaded = catalogue.load(write(tmp_path, defaults, **text))
        subject = Subject(loaded[name], loaded.config)
        return {
            stage: STAGES[stage].parameters(subject)
            for stage in ("surface", "facets", "spectrum", "index", "predicted")
        }

    before, after = (parameters(each, "m") for each in (DEFAULTS, DEFAULTS.replace("ABS", "PP")))
    assert {stage for stage in before if before[stage] != after[stage]} == {"index"}
    before, after = (parameters(each, "own") for each in (DEFAULTS, DEFAULTS.replace("ABS", "PP")))
    assert before == after


def test_the_page_says_where_each_value_came_from(tmp_path: Path) -> None:
    loaded = catalogue.load(write(tmp_path, m=SCAN + "spectrum: {file: a.txt, geometry: sce}\nexports: [astm]\n"))
    rows = STAGES["report"].parameters(Subject(loaded["m"], loaded.config))["origins"]
    found = {key: (value, origin) for key, value, origin in rows}
    assert found["index"] == ("ABS", "catalogue.yaml")
    assert found["spectrum.scale"] == ("percent", "catalogue.yaml")
    assert found["spectrum.geometry"] == ("sce", "material.yaml")
    assert found["exports"] == ('["astm"]', "material.yaml")
    assert found["spectrum.allow_fluorescent"] == ("false", "the default")
    assert found["scene"] == ("gloss-sheet", "catalogue.yaml")
    page = material_page({}, origins=rows)
    assert "Keys of the material" in page
    assert "catalogue.yaml" in page


def test_the_page_names_the_file_where_it_overruled_an_inherited_value(tmp_path: Path) -> None:
    defaults = "spectrum: {geometry: sci, incidence: 10, scale: fraction}\n"
    loaded = catalogue.load(write(tmp_path, defaults, m="spectrum: {file: a.txt}\n"))
    path = tmp_path / "m" / "a.txt"
    path.write_text("# SCE\n" + "".join(f"{nm} 0.4\n" for nm in range(400, 701, 10)))
    spectrum = ingest(loaded.spec("m", "spectrum"), path).assign_attrs(stage="spectrum", material="m")
    rows = STAGES["report"].parameters(Subject(loaded["m"], loaded.config))["origins"]
    page = material_page({"spectrum": spectrum}, origins=rows)
    assert "the file, not catalogue.yaml (sci)" in page
    assert "the file, not catalogue.yaml (10)" not in page
    assert "the file, not" not in material_page({"spectrum": spectrum.assign_attrs(geometry="sci")}, origins=rows)


def test_check_names_defaults_that_no_material_inherits(tmp_path: Path) -> None:
    write(tmp_path, DEFAULTS.replace("scene: gloss-sheet\n", ""), m="spectrum: {lab: [50, 0, 0]}\n")
    shown = CliRunner().invoke(main, ["check", str(tmp_path)]).output
    for key in ("index", "surface.form", "spectrum.scale"):
        assert f"catalogue.yaml: `{key}` is not used: no material inherits it" in shown
    assert "`spectrum.illuminant`" not in shown


def test_a_catalogue_without_the_file_has_no_defaults(tmp_path: Path) -> None:
    assert load_defaults(tmp_path).content == {}
    (tmp_path / "catalogue.yaml").symlink_to("/etc/hostname")
    with pytest.raises(InputError, match="a symbolic link to another folder"):
        load_defaults(tmp_path)


def test_the_scale_is_for_files_that_do_not_state_theirs(tmp_path: Path) -> None:
    folder = write(tmp_path, "spectrum: {geometry: sci, scale: percent}\n", m="spectrum: {file: r.csv}\n")
    (folder / "m" / "r.csv").write_text("nm,R\n" + "".join(f"{nm},{0.2 * nm / 4:g}\n" for nm in range(400, 701, 10)))
    loaded = catalogue.load(folder)
    assert "0.2 to 0.35" in describe_files(loaded, loaded["m"])[0]


REFLECTANCES = "".join(f"{nm},0.2\n" for nm in range(400, 701, 10))


@pytest.mark.parametrize(
    ("content", "own", "geometry", "incidence"),
    [
        ("nm,R\n", "", "sci", 8),
        ("# Specular component: SCE\nnm,R\n", "", "sce", 8),
        ("# Specular component: SCI\nnm,R\n", "", "sci", 8),
        ("# light from 45 degree\nnm,R\n", "", "sci", 45),
        ("nm,R SCE\n", "", "sce", 8),
        ("# Specular component: SCE\nnm,R\n", ", geometry: sci", "sci", 8),
    ],
)
def test_what_a_spectrum_file_states_overrules_the_catalogue_and_not_the_material(
    tmp_path: Path, content: str, own: str, geometry: str, incidence: float
) -> None:
    defaults = "spectrum: {geometry: sci, incidence: 8, scale: fraction}\n"
    folder = write(tmp_path, defaults, m=f"spectrum: {{file: r.csv{own}}}\n")
    (folder / "m" / "r.csv").write_text(content + REFLECTANCES)
    loaded = catalogue.load(folder)
    spec = STAGES["spectrum"].parameters(Subject(loaded["m"], loaded.config))
    spectrum = ingest(spec, folder / "m" / "r.csv")
    assert (spectrum.attrs["geometry"], spectrum.attrs["theta_i"]) == (geometry, incidence)
    assert ("warnings" in spectrum.attrs) == bool(own), "of a contradiction of the material alone"


def test_a_file_with_the_specular_included_inherits_no_gloss_trap(tmp_path: Path) -> None:
    defaults = "spectrum: {geometry: sce, specular_trap: 4, scale: fraction}\n"
    folder = write(tmp_path, defaults, m="spectrum: {file: r.csv}\n")
    (folder / "m" / "r.csv").write_text(REFLECTANCES)
    loaded = catalogue.load(folder)
    spec = STAGES["spectrum"].parameters(Subject(loaded["m"], loaded.config))
    traps = {}
    for stated in ("SCI", "SCE"):
        (folder / "m" / "r.csv").write_text(f"# Specular component: {stated}\nnm,R\n{REFLECTANCES}")
        traps[stated] = ingest(spec, folder / "m" / "r.csv").attrs.get("specular_trap")
    assert traps == {"SCI": None, "SCE": 4}


def test_a_file_whose_format_has_a_scale_inherits_none(tmp_path: Path) -> None:
    for name, own in (("m", "file: r.cxf"), ("n", "file: r.txt"), ("o", "file: r.dat, format: qtx")):
        write(tmp_path, DEFAULTS, **{name: f"spectrum: {{{own}, geometry: sci}}\n"})
        (tmp_path / name / own.split()[1].rstrip(",")).write_text("x")
    scales = {name: item.content["spectrum"].get("scale") for name, item in catalogue.load(tmp_path).by_name.items()}
    assert scales == {"m": None, "n": "percent", "o": None}


@pytest.mark.parametrize("pair", [False, True])
def test_a_refusal_of_a_file_names_the_line_of_an_inherited_value(tmp_path: Path, pair: bool) -> None:
    block = "{sci: {file: a.txt}, sce: {file: a.txt}}" if pair else "{file: a.txt, geometry: sci}"
    folder = write(tmp_path, "exports: []\nspectrum:\n  scale: fraction\n", m=f"spectrum: {block}\n")
    (folder / "m" / "a.txt").write_text("".join(f"{nm} 40\n" for nm in range(400, 701, 10)))
    key = "spectrum.sci.scale" if pair else "spectrum.scale"
    expected = f"set `{key}` in material.yaml; the present value is that of catalogue.yaml, line 3"
    loaded = catalogue.load(folder)
    with pytest.raises(InputError) as by_check:
        describe_files(loaded, loaded["m"])
    assert str(by_check.value).endswith(expected)
    assert pickle.loads(pickle.dumps(by_check.value)).args == by_check.value.args
    inputs = {"raw": str(folder / "m" / "a.txt")} | ({"excluded": str(folder / "m" / "a.txt")} if pair else {})
    script = str(installation.project_folder() / "workflow" / "scripts" / "spectrum.py")
    output, spec = {"spectrum": "m/spectrum.nc"}, loaded.spec("m", "spectrum")
    job = Job("spectrum", "m", script, str(tmp_path), inputs, output, spec, inherited=loaded["m"].inherited)
    with contextlib.chdir(tmp_path):
        assert perform(job).error == str(by_check.value)
    own = block.replace("file: a.txt", "file: a.txt, scale: fraction")
    (folder / "m" / "material.yaml").write_text(f"spectrum: {own}\n")
    loaded = catalogue.load(folder)
    with pytest.raises(InputError, match=r"`spectrum\.(sci\.)?scale` in material\.yaml$"):
        describe_files(loaded, loaded["m"])
