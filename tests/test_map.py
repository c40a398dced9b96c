"""The map of the README and the list of tests in CONTRIBUTING.md are true."""

from __future__ import annotations

import re

import pytest
from source_tree import PACKAGE, PROJECT, SOURCE, imports, modules, packages

README = (PROJECT / "README.md").read_text(encoding="utf-8")
CONTRIBUTING = (PROJECT / "CONTRIBUTING.md").read_text(encoding="utf-8")


def test_the_map_of_the_readme_names_every_package_and_module_of_the_first_level():
    section = README.split("## The map\n")[1].split("\n## ")[0]
    names = set(re.findall(r"^src/brdfpipe/\n(.*?)^workflow", section, re.MULTILINE | re.DOTALL)[0].split())
    present = {
        path.name + ("/" if path.is_dir() else "")
        for path in (SOURCE / PACKAGE).iterdir()
        if not path.name.startswith("_") and (path.suffix == ".py" or (path / "__init__.py").exists())
    }
    assert present - names == set()
    assert {name for name in names if re.fullmatch(r"\w+(/|\.py)", name)} - present <= {
        "acquisition/",
        "emulator/",
        "reduction/",
        "microfacet/",
        "slab/",
        "measured/",
    }
    assert len(section.splitlines()) <= 40


@pytest.mark.parametrize("text", [README, CONTRIBUTING], ids=["README.md", "CONTRIBUTING.md"])
def test_every_file_that_a_page_names_is_there(text):
    for path, link in re.findall(
        r"`((?:src|tests|workflow|docs|benchmarks|config)/[\w./]+)`|\]\(((?!http)[\w./-]+)", text
    ):
        assert (PROJECT / (path or link)).exists(), path or link


def test_every_place_in_the_map_is_there():
    """A place without a folder is in the folder of the place before it."""
    rows = README.split("| Where is … |")[1].split("\n\n")[0].splitlines()[2:]
    assert len(rows) > 8
    for row in rows:
        folder = SOURCE / PACKAGE
        for place in re.findall(r"`([\w/]+(?:\.py|/))`", row.split("|")[2]):
            path = SOURCE / PACKAGE / place if "/" in place or (SOURCE / PACKAGE / place).exists() else folder / place
            assert path.exists(), place
            folder = path.parent


def test_every_module_has_a_test():
    """Its own, that of a module of its folder which is built on it, or the one that CONTRIBUTING.md names."""
    plain = set(modules()) - set(packages())
    own = {module for module in plain if _test(module).exists()}
    covered = own | {part for module in own for part in _parts(module, own)}
    listed = dict(re.findall(r"^\| `(brdfpipe[\w.]+)` \| `([\w./]+)` \|$", CONTRIBUTING, re.MULTILINE))
    assert plain - covered - set(listed) == set(), (
        "write a test of that name, or list the one that covers it in CONTRIBUTING.md"
    )
    assert set(listed) - plain == set(), "listed in CONTRIBUTING.md, but there is no such module"
    assert set(listed) & covered == set(), "listed in CONTRIBUTING.md without need"
    assert all((PROJECT / test).exists() for test in listed.values())


def _test(module: str):
    *folders, name = module.split(".")[1:]
    return PROJECT.joinpath("tests", *folders, f"test_{name}.py")


def _parts(module: str, own: set[str]) -> set[str]:
    """The modules of the same folder, or below it, that a module is built on and that have no test of their own."""
    folder = module.rpartition(".")[0]
    parts, waiting = set(), [module]
    while waiting:
        name = waiting.pop()
        targets = {statement.target for statement in imports(modules()[name], name)}
        direct = {target for target in targets if target.startswith(f"{folder}.")} - own - parts
        parts |= direct
        waiting.extend(direct)
    return parts
