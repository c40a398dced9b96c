"""Imports point downwards only, in the layers that CONTRIBUTING.md lists, and name the module that defines what they import.

A stage runs again when a module that it imports changes (``brdfpipe.jobs.code`` follows plain imports in the source). So an
import through a package, through a string or through the accessor ``.bsdf`` would hide code from the digest or put too much into it.
"""

from __future__ import annotations

import ast
import importlib
import itertools
import re
import sys
import tomllib
from pathlib import Path

import pytest
from source_tree import PACKAGE, PROJECT, Import, definitions, imports, modules, packages, tree

from brdfpipe.jobs.code import DISTRIBUTIONS, LIBRARIES_BEHIND

SCRIPTS = sorted(path for folder in ("workflow", "scripts") for path in (PROJECT / folder).rglob("*.py"))


def layers() -> list[list[str]]:
    """The top-level names of each layer, lowest first, from the block after the heading "Layers" of CONTRIBUTING.md."""
    text = (PROJECT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    block = re.search(r"## Layers\n.*?```text\n(.*?)```", text, re.DOTALL)
    assert block, "CONTRIBUTING.md has no block of layers"
    return [line.split() for line in block[1].splitlines()]


def top_package(module: str) -> str:
    """The part of the package that a module belongs to: the first name below ``brdfpipe``."""
    return module.split(".")[1]


def described(path: Path) -> str:
    return str(path.relative_to(PROJECT))


def test_every_top_level_name_is_in_exactly_one_layer():
    listed = [name for layer in layers() for name in layer]
    assert sorted(listed) == sorted({top_package(module) for module in modules() if module != PACKAGE})


def test_no_import_points_upwards():
    rank = {name: height for height, layer in enumerate(layers()) for name in layer}
    upward = [
        f"{described(path)}, {statement}: {top_package(statement.target)} is above {top_package(module)}"
        for module, path in modules().items()
        for statement in imports(path, module)
        if module != PACKAGE
        and statement.target != PACKAGE
        and rank[top_package(statement.target)] > rank[top_package(module)]
    ]
    assert not upward, "\n".join(upward)


def test_no_modules_import_each_other_in_a_circle():
    edges = {
        module: {statement.target for statement in imports(path, module) if not statement.types_only} - {module}
        for module, path in modules().items()
    }
    # Importing a.b runs a/__init__.py too, unless it is what imports a.b.
    for targets in edges.values():
        targets |= {parent for target in targets for parent in _parents(target)}
    edges = {
        module: {target for target in targets if target in modules() and not f"{module}.".startswith(f"{target}.")}
        for module, targets in edges.items()
    }
    circle = _circle(edges)
    assert not circle, " → ".join(circle)


def test_every_package_is_lazy_or_empty():
    heavy = []
    for path in packages().values():
        for node in tree(path).body:
            lazy = ast.unparse(node).endswith("lazy_loader.attach_stub(__name__, __file__)")
            docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
            registration = "register_dataset_accessor('bsdf')" in ast.unparse(node)
            library = isinstance(node, ast.Import) and {alias.name for alias in node.names} <= {"lazy_loader", "xarray"}
            if not (lazy or docstring or registration or library):
                heavy.append(f"{described(path)}, line {node.lineno}: {ast.unparse(node)}")
    assert not heavy, "\n".join(heavy)


def test_names_are_imported_from_the_module_that_defines_them():
    files = [(path, module) for module, path in modules().items()] + [(path, "") for path in SCRIPTS]
    indirect = [
        f"{described(path)}, {statement}: {fault}"
        for path, module in files
        for statement in imports(path, module)
        if (fault := _indirect(statement))
    ]
    assert not indirect, "\n".join(indirect)


def test_every_name_that_a_benchmark_imports_is_there():
    missing = [
        f"{described(path)}, {statement}"
        for path in sorted((PROJECT / "benchmarks").glob("*.py"))
        for statement in imports(path)
        if statement.target not in modules()
        or (
            statement.name
            and statement.target == statement.module
            and not hasattr(importlib.import_module(statement.module), statement.name)
        )
    ]
    assert not missing, "\n".join(missing)


def test_no_module_of_the_package_is_imported_by_a_string():
    importers = {"import_module", "__import__", "find_spec", "resolve_name", "run_module"}
    hidden = [
        f"{described(path)}, line {node.lineno}: {ast.unparse(node)}"
        for path in [*modules().values(), *SCRIPTS]
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Call)
        and node.args
        and ast.unparse(node.func).split(".")[-1] in importers
        and ast.unparse(node.args[0]).lstrip("f'\"").startswith((PACKAGE, "."))
    ]
    assert not hidden, "\n".join(hidden)


def test_the_package_calls_functions_and_leaves_the_accessor_to_people():
    (accessor,) = (
        node
        for node in ast.walk(tree(modules()["brdfpipe.bsdf.accessor"]))
        if isinstance(node, ast.ClassDef) and node.name == "BSDFAccessor"
    )
    methods = {
        node.name for node in accessor.body if isinstance(node, ast.FunctionDef) if not node.name.startswith("_")
    }
    assert {"evaluate", "albedo", "tabulate"} <= methods
    uses = [
        f"{described(path)}, line {node.lineno}: {ast.unparse(node)}"
        for path in [*modules().values(), *SCRIPTS]
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Attribute)
        and node.attr in methods
        and isinstance(node.value, ast.Attribute)
        and node.value.attr == "bsdf"
    ]
    assert not uses, "\n".join(uses)


@pytest.mark.parametrize("package", sorted(packages()))
def test_public_names_of_a_package_load_and_are_no_names_of_its_modules(package):
    # A submodule of the same name would replace the public one as soon as anything imports it.
    stub = packages()[package].with_suffix(".pyi")
    statements = imports(stub, package) if stub.exists() else ()
    for statement in statements:
        value = getattr(importlib.import_module(package), str(statement.name))
        if f"{package}.{statement.name}" in modules():
            assert value is importlib.import_module(f"{package}.{statement.name}")
            assert statement.module == package, (
                f"{package}.{statement.name} is a module and a public name of {statement.module}"
            )
        elif statement.target in modules() and statement.target != statement.module:
            assert value is importlib.import_module(statement.target)
        else:
            assert statement.name in definitions(modules()[statement.module])


def test_the_libraries_that_are_imported_are_those_declared():
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    runtime, optional = (
        {_distribution(re.match(r"[\w.-]+", requirement)[0]) for requirement in requirements}
        for requirements in (project["dependencies"], itertools.chain(*project["optional-dependencies"].values()))
    )
    imported = {
        name.split(".")[0]
        for path in (*modules().values(), *SCRIPTS)
        for node in ast.walk(tree(path))
        for name in _absolute_imports(node)
    }
    libraries = {
        _distribution(DISTRIBUTIONS.get(name, name)) for name in imported - sys.stdlib_module_names - {PACKAGE}
    }
    assert libraries - runtime - optional == set()
    assert runtime - libraries - {_distribution(name) for name in LIBRARIES_BEHIND["xarray"]} == set()


def _absolute_imports(node: ast.AST) -> list[str]:
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    return [str(node.module)] if isinstance(node, ast.ImportFrom) and not node.level else []


def _distribution(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _indirect(statement: Import) -> str:
    """Why an import does not name the module that defines its name; empty if it does."""
    if statement.module not in modules():
        return "there is no such module"
    if statement.target in packages():
        return "this is a package; import from the module that defines the name"
    if statement.name and statement.target == statement.module:
        return "" if statement.name in definitions(modules()[statement.module]) else "the name is defined elsewhere"
    return ""


def _parents(module: str) -> set[str]:
    parts = module.split(".")
    return {".".join(parts[:length]) for length in range(1, len(parts))}


def _circle(edges: dict[str, set[str]]) -> list[str]:
    """One circle of a graph, its first node repeated at the end; empty if there is none."""
    finished: set[str] = set()

    def search(node: str, path: list[str]) -> list[str]:
        if node in path:
            return [*path[path.index(node) :], node]
        if node in finished:
            return []
        for target in sorted(edges[node]):
            circle = search(target, [*path, node])
            if circle:
                return circle
        finished.add(node)
        return []

    return next((circle for node in edges if (circle := search(node, []))), [])


def test_a_circle_is_found():
    assert _circle({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": set()}) == ["b", "c", "b"]
    assert _circle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []
