"""Every Python example and every command of the documentation runs as it stands."""

from __future__ import annotations

import ast
import importlib
import json
import re
import shlex
import shutil
from pathlib import Path

import click
import pytest
import samples
import xarray as xr
from built_examples import build_examples
from click.testing import CliRunner
from source_tree import PACKAGE, modules

from brdfpipe import appearance, columns, documents, exchange, flakes, spectra, store
from brdfpipe.bsdf import flake, lambert_gauss
from brdfpipe.catalogue import generated_files, material_keys
from brdfpipe.cli.main import main
from brdfpipe.descriptions import reading
from brdfpipe.exchange.registry import FORMATS
from brdfpipe.spectra import colorimetry
from brdfpipe.spectra.formats import excel, jcamp
from brdfpipe.stages import STAGES
from brdfpipe.surfaces import archives, arrays, instruments, x3p

PROJECT = Path(__file__).parents[1]
PAGES = [PROJECT / "README.md", PROJECT / "CONTRIBUTING.md", *sorted((PROJECT / "docs").rglob("*.md"))]
FILE_TYPES = ("csv", "html", "ipynb", "json", "nc", "py", "pyi", "yaml")


def examples(document: str) -> list[str]:
    text = (PROJECT / document).read_text(encoding="utf-8")
    return re.findall(r"^```python\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)


def run(document: str, names: dict[str, object]) -> list[str]:
    codes = examples(document)
    for code in codes:
        exec(compile(code, document, "exec"), names)
    return codes


def diffuser() -> xr.Dataset:
    return lambert_gauss.lambertian(spectra.recover([48, 34, 22], illuminant="D65", observer=10))


def paint(darker: float) -> xr.Dataset:
    labs = {"45as15": [33.9 - darker, -7.6, -36.6], "45as45": [12.3, 1.2, -25.8], "45as110": [3.1, 2.1, -13.2]}
    listed = [{"geometry": name, "lab": lab} for name, lab in labs.items()]
    return flake.build(flakes.ingest({"colours": listed, "illuminant": "D65", "observer": 10}))


def test_the_examples_of_the_readme_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = tmp_path / "results" / "abs-grain" / "bsdf.nc"
    place.parent.mkdir(parents=True)
    store.save_dataset(diffuser(), place, stage="bsdf", material="abs-grain", inputs={}, parameters={})
    (tmp_path / "examples").symlink_to(PROJECT / "examples")
    monkeypatch.chdir(tmp_path)
    codes = run("README.md", {})
    for name in ("gloss", "gloss_with_uncertainty", "reflectance_haze", "flop_index", "recover", "read_spectrum"):
        assert any(f".{name}(" in code for code in codes), name


def test_the_examples_of_a_paint_run() -> None:
    assert run("docs/materials.md", {"bsdf": paint(0.0), "other": paint(2.0)})


def test_the_examples_of_the_model_run() -> None:
    names: dict[str, object] = {}
    assert run("docs/model.md", names)
    assert names["lacquer"].attrs["representation"] == "coated"  # type: ignore[attr-defined]


def test_the_example_of_the_grain_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copy(PROJECT / "examples" / "abs-grain" / "grain.x3p", tmp_path)
    monkeypatch.chdir(tmp_path)
    assert run("docs/texture.md", {})
    assert len(list(Path("maps").iterdir())) == 5


@pytest.mark.parametrize("page", ["exchange", "metrics", "veiling-glare"])
def test_the_examples_of_a_page_with_a_bsdf_run(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    one, other = samples.beckmann_bsdf(0.4), samples.beckmann_bsdf(0.35)
    assert run(f"docs/{page}.md", {"material": one, "candidate": one, "reference": other, "appearance": appearance})


def sh_commands(page: Path) -> list[list[str]]:
    """The words of every command ``brdfpipe …`` in the shell blocks of a page."""
    blocks = re.findall(r"^```sh\n(.*?)^```$", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    lines = [shlex.split(line, comments=True) for block in blocks for line in block.splitlines()]
    return [line[1:] for line in lines if line[:1] == ["brdfpipe"]]


def commands(page: Path) -> list[list[str]]:
    """The words of the commands ``brdfpipe convert``, ``compare`` and ``formats`` in the blocks of a page."""
    return [words for words in sh_commands(page) if words[0] in ("convert", "compare", "formats")]


EXCHANGE_PAGES = [PROJECT / "docs" / "exchange.md", *sorted((PROJECT / "docs" / "programs").glob("*.md"))]


@pytest.mark.parametrize("page", EXCHANGE_PAGES, ids=lambda page: page.name)
def test_the_commands_of_a_page_on_other_programs_run(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "results" / "abs-grain" / "bsdf.nc"
    place.parent.mkdir(parents=True)
    store.save_dataset(samples.beckmann_bsdf(0.4), place, stage="bsdf", material="abs-grain", inputs={}, parameters={})
    monkeypatch.chdir(tmp_path)
    if "vinyl" in page.read_text(encoding="utf-8"):
        for name in ("vinyl.bsdf", "vinyl.zemax.bsdf"):
            exchange.write(diffuser(), tmp_path / name, "zemax", tolerance=0.1)
    found = commands(page)
    assert found or page.name in ("mitsuba.md", "radiance.md")
    for words in found:
        result = CliRunner().invoke(main, words)
        assert result.exit_code == 0, (words, result.output)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_of_a_page_exists_with_its_options(page: Path) -> None:
    for words in sh_commands(page):
        command: click.Command = main
        while isinstance(command, click.Group):
            assert words[0] in command.commands, words
            command, words = command.commands[words[0]], words[1:]
        context = click.Context(command)
        command.make_parser(context).parse_args(list(words))


TAUGHT = [PROJECT / "docs" / f"{name}.md" for name in ("tutorial", "commands", "notebook")]
TAUGHT += sorted((PROJECT / "docs" / "guides").glob("*.md"))
"""Pages whose commands and Python are run one after the other, in a folder with the catalogue ``materials`` and its ``results``."""


@pytest.fixture
def taught(made_once, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:  # type: ignore[no-untyped-def]
    base = made_once("workflow", build_examples)
    shutil.copytree(base / "catalogue", tmp_path / "materials")
    shutil.copytree(base / "results", tmp_path / "results", symlinks=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run_page(page: Path, left_out: tuple[str, ...]) -> None:
    """Run the blocks of a page in their order; commands whose first word is left out are not run."""
    names: dict[str, object] = {}
    text = page.read_text(encoding="utf-8")
    for kind, code in re.findall(r"^```(python|sh)\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL):
        if kind == "python":
            exec(compile(code, page.name, "exec"), names)
            continue
        for line in code.splitlines():
            words = [
                str(part)
                for word in shlex.split(line, comments=True)
                for part in (sorted(Path().glob(word)) if "*" in word else [word])
            ]
            if words and words[1] not in left_out:
                assert words[0] == "brdfpipe", line
                result = CliRunner().invoke(main, words[1:])
                assert result.exit_code == 0, (line, result.output)


@pytest.mark.parametrize("page", TAUGHT, ids=lambda page: page.name)
def test_what_a_page_teaches_runs(page: Path, taught: Path) -> None:
    if "plot" in page.read_text(encoding="utf-8"):
        pytest.importorskip("matplotlib")
    run_page(page, ("examples", "build", "doctor"))


GUIDES = sorted((PROJECT / "docs" / "guides").glob("*.md"))


@pytest.mark.parametrize("page", GUIDES, ids=lambda page: page.name)
def test_every_description_of_a_guide_is_accepted(page: Path, tmp_path: Path) -> None:
    for block in re.findall(r"^```yaml\n(.*?)^```$", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL):
        (tmp_path / "material.yaml").write_text(block, encoding="utf-8")
        written, _ = documents.parse(tmp_path / "material.yaml")
        base = {} if "table" in written else {"surface": {"distribution": "ggx", "a": 0.2}, "index": 1.5}
        assert reading.check(base | written, material_keys.Material, page.name)


@pytest.mark.slow
def test_the_tutorial_runs_from_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run_page(PROJECT / "docs" / "tutorial.md", ())
    assert (tmp_path / "grain.svg").stat().st_size > 10_000


def test_no_page_has_python_that_no_test_runs() -> None:
    elsewhere = {"README.md", "materials.md", "model.md", "exchange.md", "metrics.md", "veiling-glare.md"}
    elsewhere |= {"rig.md", "texture.md"}  # tests/rig/test_documentation.py; test_the_example_of_the_grain_runs
    with_mitsuba_or_radiance = {"mitsuba.md", "radiance.md"}  # which `make peers` installs
    with_python = {page for page in PAGES if "\n```python\n" in page.read_text(encoding="utf-8")}
    assert {page.name for page in with_python - set(TAUGHT)} <= elsewhere | with_mitsuba_or_radiance


@pytest.mark.parametrize(
    "notebook", sorted((PROJECT / "docs" / "notebooks").glob("*.ipynb")), ids=lambda path: path.stem
)
def test_a_notebook_runs_and_its_figures_are_shown(
    notebook: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    figures = 0
    for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"]:
        assert not cell.get("outputs"), "notebooks are kept without results"
        if cell["cell_type"] != "code":
            continue
        body = ast.parse("".join(cell["source"])).body
        shown = body.pop() if isinstance(body[-1], ast.Expr) else None
        exec(compile(ast.Module(body, []), notebook.name, "exec"), names)
        if isinstance(shown, ast.Expr):
            value = eval(compile(ast.Expression(shown.value), notebook.name, "eval"), names)
            figures += hasattr(value, "_repr_png_") and value._repr_png_().startswith(b"\x89PNG")
    assert figures >= 2


def test_every_picture_of_a_page_is_there_and_every_figure_is_used(tmp_path: Path) -> None:
    shown = {
        (page.parent / path).resolve()
        for page in PAGES
        for path in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", page.read_text(encoding="utf-8"))
    }
    assert {path for path in shown if not path.exists()} == set()
    assert set((PROJECT / "docs" / "figures").iterdir()) <= shown


def test_the_exit_codes_of_the_page_are_those_of_the_commands() -> None:
    page = (PROJECT / "docs" / "commands.md").read_text(encoding="utf-8")
    table = set(re.findall(r"^\| (\d+) \|", page, re.MULTILINE))
    source = (PROJECT / "src/brdfpipe/cli/console.py").read_text(encoding="utf-8")
    assert table == {"0", "1"} | set(re.findall(r"code = (\d+)", source)) | set(re.findall(r"(\d{3}) if ", source)) | {
        "130"
    }


def test_a_page_for_each_format_of_a_program_is_linked() -> None:
    text = (PROJECT / "docs" / "exchange.md").read_text(encoding="utf-8")
    linked = set(re.findall(r"\]\(programs/([\w.]+)\)", text))
    assert linked == {page.name for page in EXCHANGE_PAGES[1:]}
    for name in FORMATS:
        assert f"`{name}`" in text, name


def test_the_documentation_lists_the_illuminants_that_are_known() -> None:
    text = (PROJECT / "docs/materials.md").read_text(encoding="utf-8")
    listed = text.split("## Illuminants")[1].split("in Python: ")[1].split(", in any case")[0].split(", ")
    assert sorted(listed) == sorted(colorimetry.illuminants())


def test_the_documentation_states_the_largest_raw_files() -> None:
    text = (PROJECT / "docs/materials.md").read_text(encoding="utf-8").split("## Largest raw files")[1].split("##")[0]
    limits = {
        "excel": f"{excel._UNPACKED >> 20} MiB unpacked; {excel._MOST_ROWS} rows, {excel._MOST_COLUMNS} columns and {excel._MOST_CELLS} cells",
        "x3p": f"{x3p._MAX_ENTRIES} entries; {x3p._MAX_XML >> 20} MiB of XML",
        "npz": f"{arrays._MAX_ENTRIES} entries",
        "jcamp": f"2^{jcamp._MOST.bit_length() - 1} points",
        "columns": f"columns in text | {columns._MAX_BYTES >> 20} MiB",
        "instruments": f"of instruments | {instruments._MAX_BYTES >> 20} MiB",
        "scans": f"2^{archives.MAX_POINTS.bit_length() - 1} points",
        "archives": f"more than {archives._RATIO_FROM >> 20} MiB is at most {archives._MAX_RATIO} times",
    }
    assert [name for name, words in limits.items() if words not in text] == []


def dotted_names(text: str) -> set[str]:
    """Names in backticks that begin with a package or a module of ``brdfpipe`` and are no names of files; arguments are left out."""
    top_names = {PACKAGE, *(module.split(".")[1] for module in modules() if module != PACKAGE)}
    names = set(re.findall(r"`(\w+(?:\.\w+)+)(?:\([^`]*\))?`", text))
    return {name for name in names if name.split(".")[0] in top_names and name.split(".")[-1] not in FILE_TYPES}


def resolves(name: str) -> bool:
    parts = name.removeprefix(f"{PACKAGE}.").split(".")
    paths = [".".join([PACKAGE, *parts[:count]]) for count in range(len(parts), -1, -1)]
    module = next(path for path in paths if path in modules())
    rest = parts[module.count(".") :]
    return not rest or _has(importlib.import_module(module), rest)


def _has(value: object, names: list[str]) -> bool:
    return not names or (hasattr(value, names[0]) and _has(getattr(value, names[0]), names[1:]))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_module_and_function_that_a_page_names_is_there(page: Path) -> None:
    tables = "".join(table for tables in generated_files.key_tables().values() for table in tables.values())
    keys = set(re.findall(r"^\| `([\w.]+)` \|", tables, re.MULTILINE))
    keys |= {key for stage in STAGES.values() for key in (*stage.keys.description, *stage.keys.config)}
    blocks = {key[: dot.start()] for key in keys for dot in re.finditer(r"\.", key)}
    names = dotted_names(page.read_text(encoding="utf-8")) - keys - blocks
    assert sorted(name for name in names if not resolves(name)) == []


def test_a_name_that_is_not_there_is_noticed() -> None:
    text = "`surfaces.level`, `surfaces.levelling.tilt`, `rig.raycast`, `catalogue.csv`, `spectra.recover([1], 2)`, `plain.words`"
    names = dotted_names(text)
    assert names == {"surfaces.level", "surfaces.levelling.tilt", "rig.raycast", "spectra.recover"}
    assert {name for name in names if resolves(name)} == {"surfaces.level", "spectra.recover"}
