"""Scenes are read, refused in words, and chosen by the command line, a material or the configuration."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from brdfpipe.appearance import computation
from brdfpipe.appearance.cabin import Cabin, cabin_of
from brdfpipe.catalogue.catalogue import load
from brdfpipe.catalogue.configuration import load_config
from brdfpipe.errors import BrdfpipeError, InputError
from brdfpipe.scenes import geometries, scene
from brdfpipe.scenes.metrics import METRICS
from brdfpipe.scenes.results import PARTS, RESULTS
from brdfpipe.scenes.scene import Scene, SceneError, different, load_scene, shipped_scenes
from brdfpipe.scenes.scene_keys import METRIC_UNITS
from brdfpipe.stages import STAGES, Subject

COLOUR = "spectrum: {lab: [50, 0, 0], illuminant: D65, observer: 10, geometry: sci}\n"

MINIMAL = """\
purpose: a test
domain: {geometries: [{theta_i: 45, theta_o: 0, phi_o: 180}]}
results: [colour]
metric: colour
tolerance: 1
"""


def written(folder: Path, name: str, text: str = MINIMAL) -> Path:
    path = folder / f"{name}.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def test_every_shipped_scene_is_read_by_its_name() -> None:
    assert next(iter(shipped_scenes())) == "catalogue"
    for name in shipped_scenes():
        scene = load_scene(name)
        assert (scene.name, scene.folder) == (name, "" if name == "catalogue" else f"scenes/{name}/")
    everything = load_scene("metrology-full")
    assert everything.asks(*RESULTS)
    assert all(everything.asks(result) for result in RESULTS)


def test_the_vocabulary_agrees_with_what_computes_it() -> None:
    assert computation.PARTS == PARTS
    assert list(METRICS) == list(METRIC_UNITS)


def test_an_absent_key_has_its_default(tmp_path: Path) -> None:
    content = load_scene(written(tmp_path, "mine")).content
    assert (content["bands"], content["polarisation"], content["exports"]) == ("photopic", "unpolarised", [])
    assert "budget" not in content


def test_the_digest_is_of_the_content_with_its_defaults(tmp_path: Path) -> None:
    first, same = written(tmp_path, "first"), written(tmp_path, "same", f"{MINIMAL}bands: photopic # the default\n")
    other = written(tmp_path, "other", MINIMAL.replace("tolerance: 1", "tolerance: 2"))
    digests = [load_scene(path).digest for path in (first, same, other)]
    assert digests[0] == digests[1] != digests[2]


def test_the_scene_of_the_documentation_is_accepted(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "scenes.md").read_text(encoding="utf-8")
    scene = load_scene(written(tmp_path, "mine", page.split("```yaml\n")[1].split("```")[0]))
    assert scene.parts == ("gloss", "colour")
    assert geometries.gloss_angles(scene.domain, [20, 60, 85]) == [60]
    assert geometries.colour_geometries(scene.domain, ["45:0"]) == ["45:0"]


def test_a_scene_of_its_own_uses_the_errors_of_a_shipped_one_with_the_same_metric_and_domain(tmp_path: Path) -> None:
    shipped = load_scene("multiangle-qc")
    text = shipped_scenes()["multiangle-qc"].read_text(encoding="utf-8")
    changes = {"tolerance: 0.5": "tolerance: 2", "results: [colour]": "results: [colour, preview]"}
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    same = load_scene(written(tmp_path, "mine", text))
    assert same.plans
    assert same.experience_file == shipped.experience_file
    turned = yaml.safe_load(text)
    turned["domain"]["geometries"].reverse()
    assert load_scene(written(tmp_path, "turned", yaml.safe_dump(turned))).experience_file == shipped.experience_file
    turned["domain"]["geometries"].pop()
    fewer = load_scene(written(tmp_path, "fewer", yaml.safe_dump(turned)))
    assert fewer.experience_file is None
    assert not fewer.plans
    assert not load_scene(written(tmp_path, "fullest", f"{text}model: fullest\n")).plans


def test_gloss_and_pictures_have_the_same_errors_in_every_domain(tmp_path: Path) -> None:
    for metric, shipped in (("gloss", "gloss-sheet"), ("rendering", "render-preview")):
        bands = "bands: rgb\n" if metric == "rendering" else ""
        mine = load_scene(written(tmp_path, metric, MINIMAL.replace("metric: colour", f"metric: {metric}") + bands))
        assert mine.experience_file == load_scene(shipped).experience_file
        other = load_scene(
            written(tmp_path, metric, MINIMAL.replace("metric: colour", f"metric: {metric}\nbands: [555]"))
        )
        assert other.experience_file is None
    assert load_scene(written(tmp_path, "colour")).experience_file is None


def test_a_file_that_is_not_of_measured_errors_is_none_of_a_scene(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(scene.installation, "project_folder", lambda: tmp_path)
    content = {"metric": "gloss", "bands": "photopic", "polarisation": "unpolarised", "domain": {}}
    mine, file = Scene("mine", content), scene.measured_errors_file("mine")
    file.parent.mkdir(parents=True)
    for text in ("", "no JSON", "[]", '{"scene": "another", "parameters": {\n'):
        file.write_text(text)
        assert mine.experience_file is None
        file.unlink()
    other = file.with_name("shipped.json")
    other.write_text(f'{{"scene": "{mine.errors_of}", "parameters": {{\n')
    assert mine.experience_file == other
    file.write_text(other.read_text())
    assert mine.experience_file == file, "its own comes first"


def test_an_edited_file_is_read_again(tmp_path: Path) -> None:
    path = written(tmp_path, "mine")
    assert load_scene(path).content["tolerance"] == 1
    written(tmp_path, "mine", MINIMAL.replace("tolerance: 1", "tolerance: 25"))
    assert load_scene(path).content["tolerance"] == 25


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("gloss-shet", "no scene 'gloss-shet'; did you mean 'gloss-sheet'?"),
        (f"two words {'x' * 60}", "no scene 'two words…'"),
        ("absent.yaml", "no such file"),
        ("deeper/absent", "no such file"),
    ],
)
def test_an_unknown_scene_is_refused_with_those_that_exist(given: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(BrdfpipeError) as refusal:
        load_scene(given, tmp_path)
    assert words in str(refusal.value)
    assert f"accepted: {', '.join(shipped_scenes())}" in str(refusal.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (MINIMAL.replace("[colour]", "[color]"), "results"),
        (MINIMAL.replace("[colour]", "[]"), "the scene asks for nothing"),
        (MINIMAL.replace("[colour]", "[gloss]") + "bands: rgb\n", "no result of the scene has these bands"),
        (MINIMAL + "bands: [500, 400]\n", "the values do not increase"),
        (MINIMAL.replace("[colour]", "[table]") + "bands: rgb\n", "the table has no such bands"),
        (MINIMAL + "polarisation: mueller\n", "no result of the scene is polarised"),
        (MINIMAL.replace("tolerance: 1", "tolerance: 0"), "tolerance"),
        (MINIMAL.replace("purpose: a test\n", ""), "purpose"),
        (MINIMAL + "budget: {}\n", "the budget is empty"),
        (MINIMAL + "exports: [pdf]\n", "astm"),
        (MINIMAL + "glare: {distance: 0.3}\n", "no result of the scene has this geometry"),
    ],
)
def test_a_mistake_is_refused_in_words(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(InputError) as refusal:
        load_scene(written(tmp_path, "mine", text))
    assert words in str(refusal.value)
    assert str(refusal.value).startswith("mine.yaml")


def test_names_that_would_mix_results_are_refused(tmp_path: Path) -> None:
    for name in ("catalogue", "gloss-sheet", "Gloss-Sheet"):
        with pytest.raises(BrdfpipeError, match=f"{name.lower()} is the name of a shipped scene"):
            load_scene(written(tmp_path / name, name))
    copied = written(tmp_path / "copy", "gloss-sheet", shipped_scenes()["gloss-sheet"].read_text(encoding="utf-8"))
    assert load_scene(copied) == load_scene("gloss-sheet")
    with pytest.raises(BrdfpipeError, match="not an accepted name"):
        load_scene(written(tmp_path, "my scene"))
    one, other = Scene("mine", {"tolerance": 1}), Scene("mine", {"tolerance": 2})
    assert different({"a": one}, one) == []
    assert different({"a": one, "b": other}, load_scene("catalogue")) == ["b"]
    assert different({"a": one}, other) == ["a"]


def test_the_command_line_comes_before_the_material_and_that_before_the_configuration(tmp_path: Path) -> None:
    for name, own in (("plain", ""), ("own", "scene: render-preview\n"), ("file", "scene: mine.yaml\n")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "material.yaml").write_text(COLOUR + own)
    written(tmp_path / "file", "mine")
    config = tmp_path / "settings" / "config.yaml"
    config.parent.mkdir()
    config.write_text("scene: ../of-all.yaml\n")
    written(tmp_path, "of-all")

    def chosen(*arguments: object) -> dict[str, str]:
        return {item.name: item.scene.name for item in load(tmp_path, *arguments).materials}  # type: ignore[arg-type]

    assert chosen() == {"file": "mine", "own": "render-preview", "plain": "catalogue"}
    assert chosen(load_config(config)) == {"file": "mine", "own": "render-preview", "plain": "of-all"}
    assert set(chosen(load_config(config), "gloss-sheet").values()) == {"gloss-sheet"}


def test_a_material_with_another_scene_of_the_same_name_stops_no_other(tmp_path: Path) -> None:
    for name, tolerance in (("a", 1), ("b", 2)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "material.yaml").write_text(COLOUR + "scene: mine.yaml\n")
        written(tmp_path / name, "mine", MINIMAL.replace("tolerance: 1", f"tolerance: {tolerance}") + f"# {name}\n")
    loaded = load(tmp_path)
    assert [item.name for item in loaded.materials] == ["a"]
    assert "another scene of the same name" in loaded.failures["b"]


@pytest.mark.parametrize("path", ["../../mine.yaml", "link.yaml"])
def test_a_scene_outside_the_catalogue_is_refused_and_not_quoted(tmp_path: Path, path: str) -> None:
    folder = tmp_path / "catalogue" / "bad"
    folder.mkdir(parents=True)
    (tmp_path / "mine.yaml").write_text("secret: 1\n")
    (folder / "link.yaml").symlink_to(tmp_path / "mine.yaml")
    (folder / "material.yaml").write_text(COLOUR + f"scene: {path}\n")
    reason = load(tmp_path / "catalogue").failures["bad"]
    assert "leads outside the catalogue" in reason
    assert "secret" not in reason


def test_a_material_with_an_unknown_scene_stops_no_other(tmp_path: Path) -> None:
    for name, own in (("good", ""), ("bad", "scene: none-such\n")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "material.yaml").write_text(COLOUR + own)
    loaded = load(tmp_path)
    assert [item.name for item in loaded.materials] == ["good"]
    assert loaded.failures["bad"].startswith("material.yaml, scene: no scene 'none-such'")


def test_formats_are_those_of_the_material_where_the_scene_says_so() -> None:
    assert load_scene("catalogue").exports(["astm"]) == ("astm",)
    assert load_scene("gloss-sheet").exports(["astm"]) == ()
    assert Scene("mine", {"exports": ["astm"]}).exports([]) == ("astm",)


@pytest.fixture
def subjects(tmp_path: Path) -> dict[str, Subject]:
    """A material with a scan, for every shipped scene."""
    folder = tmp_path / "catalogue"
    (folder / "m").mkdir(parents=True)
    (folder / "m" / "a.txt").write_text("0 1\n1 0\n")
    (folder / "m" / "material.yaml").write_text("surface: {file: a.txt, unit: um, pitch: 1}\nindex: 1.5\n" + COLOUR)
    loaded = load(folder)
    return {name: Subject(loaded["m"], loaded.config, (), load_scene(name)) for name in shipped_scenes()}


def stages_of(subject: Subject) -> set[str]:
    return {name for name, stage in STAGES.items() if stage.owner_kind == "material" and stage.jobs(subject)}


def test_a_stage_runs_only_where_its_result_is_asked_for(
    subjects: dict[str, Subject], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(scene, "measured_errors_file", lambda name: tmp_path / f"{name}.json")
    shared = {"surface", "facets", "psd", "visibility", "spectrum", "index", "interreflection", "predicted", "wave"}
    nominal = {*shared, "nominal_bsdf", "summary"}
    everything = stages_of(subjects["metrology-full"])
    assert stages_of(subjects["gloss-sheet"]) == {*nominal, "appearance"}
    assert stages_of(subjects["multiangle-qc"]) == {*nominal, "appearance"}
    assert stages_of(subjects["dashboard-veiling-glare"]) == {*nominal, "appearance"}
    assert stages_of(subjects["render-preview"]) == {*nominal, "preview"}
    assert stages_of(subjects["luminaire-raytrace"]) == {*nominal, "appearance", "table", "checks"}
    # A table on a grid of one's own is not what a catalogue is for.
    assert stages_of(subjects["catalogue"]) == everything - {"table"}
    assert everything >= {*shared, "bsdf", "model_error", "uncertainty", "lambert_gauss", "report"}
    assert "nominal_bsdf" not in everything
    # Errors are measured for the scenes that accept the cheapest model, before any of them takes it.
    accepting = {name for name in shipped_scenes() if load_scene(name).accepts_cheapest}
    assert accepting == set(shipped_scenes()) - {"catalogue", "metrology-full"}
    assert not any(load_scene(name).plans for name in accepting)


def test_a_model_is_planned_where_errors_were_measured_for_the_scene(subjects: dict[str, Subject]) -> None:
    planned = {"surface", "facets", "psd", "spectrum", "index", "plan", "planned", "summary"}
    assert stages_of(subjects["gloss-sheet"]) == {*planned, "appearance"}
    for name in ("catalogue", "metrology-full"):
        assert not {"plan", "planned"} & stages_of(subjects[name])
    content = {**load_scene("gloss-sheet").content, "model": "fullest"}
    fullest = Subject(subjects["catalogue"].owner, subjects["catalogue"].config, (), Scene("mine", content))
    assert {"predicted", "wave", "nominal_bsdf"} <= stages_of(fullest)
    assert "plan" not in stages_of(fullest)


def test_the_appearance_is_computed_at_the_geometries_of_the_scene_alone(subjects: dict[str, Subject]) -> None:
    def settings(name: str) -> dict[str, object]:
        return STAGES["appearance"].parameters(subjects[name])

    assert settings("catalogue") | {"cabin": {}} == settings("metrology-full")
    assert settings("catalogue") == STAGES["appearance"].parameters(
        Subject(subjects["catalogue"].owner, subjects["catalogue"].config)
    )
    assert "parts" not in settings("catalogue")
    gloss = settings("gloss-sheet")
    assert (gloss["parts"], gloss["gloss_angles"], set(gloss)) == (
        ["gloss", "haze"],
        [20, 60, 85],
        {"parts", "gloss_angles", "haze"},
    )
    colour = settings("multiangle-qc")
    assert set(colour["geometries"]) == {"45as-15", "45as15", "45as25", "45as45", "45as75", "45as110"}  # type: ignore[call-overload]
    assert colour["standard_geometries"] is False
    assert settings("luminaire-raytrace") == {"parts": ["transmission"]}
    content = {**load_scene("gloss-sheet").content, "results": ["colour"]}
    of_total = STAGES["appearance"].parameters(
        Subject(subjects["catalogue"].owner, subjects["catalogue"].config, (), Scene("mine", content))
    )
    assert (of_total["geometries"], of_total["standard_geometries"]) == ([], False)
    dashboard = settings("dashboard-veiling-glare")
    assert dashboard["parts"] == []
    assert cabin_of(dashboard["cabin"]) == Cabin()  # type: ignore[arg-type]


def test_a_measured_material_has_no_prediction_unless_it_is_compared(tmp_path: Path) -> None:
    examples = load(Path(__file__).parents[2] / "examples")
    subject = Subject(examples["milk-glass"], examples.config, (), load_scene("gloss-sheet"))
    assert not {"facets", "predicted", "spectrum", "index"} & stages_of(subject)
    assert "predicted" in stages_of(Subject(examples["milk-glass"], examples.config, (), load_scene("catalogue")))


def test_gloss_without_a_gloss_angle_in_the_domain_is_refused(tmp_path: Path) -> None:
    beside = "purpose: beside\ndomain: {cones: [{theta_i: 45, half_angle: 5}]}\nresults: [gloss]\nmetric: gloss\ntolerance: 1\n"
    for name, key in (("a", "scene: beside.yaml\n"), ("b", "")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "material.yaml").write_text(COLOUR + key)
    written(tmp_path / "a", "beside", beside)
    reason = "scene beside: asks for `gloss`, but its domain contains the mirror direction of no gloss angle"
    loaded = load(tmp_path)
    assert [item.name for item in loaded.materials] == ["b"]
    assert loaded.failures["a"].startswith(reason)
    with pytest.raises(SceneError, match=r"20° or 60° or 85°"):
        load(tmp_path, scene=str(tmp_path / "a" / "beside.yaml"))
