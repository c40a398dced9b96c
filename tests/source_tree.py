"""The modules of the package and what each imports, read from the source without running it."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path
from typing import NamedTuple

PROJECT = Path(__file__).parents[1]
SOURCE = PROJECT / "src"
PACKAGE = "brdfpipe"


class Import(NamedTuple):
    """One name that a file imports from the package."""

    line: int
    module: str
    """The module or package it is imported from, in full; the parent package if ``name`` is a module"""
    name: str | None
    """None for ``import module``"""
    types_only: bool
    """Whether it is read by type checkers alone (``if TYPE_CHECKING``)"""

    @property
    def target(self) -> str:
        """The module that is loaded: ``module.name`` if that is a module, else ``module``."""
        inner = f"{self.module}.{self.name}"
        return inner if self.name and inner in modules() else self.module

    def __str__(self) -> str:
        statement = f"from {self.module} import {self.name}" if self.name else f"import {self.module}"
        return f"line {self.line}: {statement}{' (types only)' if self.types_only else ''}"


@cache
def modules() -> dict[str, Path]:
    """Dotted name → file of every module and package."""
    files = {}
    for path in sorted((SOURCE / PACKAGE).rglob("*.py")):
        parts = path.relative_to(SOURCE).with_suffix("").parts
        files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return files


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


def packages() -> dict[str, Path]:
    """Dotted name → ``__init__.py`` of every package."""
    return {name: path for name, path in modules().items() if path.name == "__init__.py"}


@cache
def imports(path: Path, module: str = "") -> tuple[Import, ...]:
    """What a file imports from the package, in whatever function; ``module`` is its own name, for relative imports."""
    nodes = list(ast.walk(tree(path)))
    guards = [node for node in nodes if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)]
    guarded = {id(node) for guard in guards for statement in guard.body for node in ast.walk(statement)}
    statements: list[Import] = []
    for node in nodes:
        types_only = id(node) in guarded
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names if alias.name.split(".")[0] == PACKAGE]
            statements += [Import(node.lineno, name, None, types_only) for name in names]
        elif isinstance(node, ast.ImportFrom):
            origin = _absolute(node, module, path)
            if origin.split(".")[0] == PACKAGE:
                statements += [Import(node.lineno, origin, alias.name, types_only) for alias in node.names]
    return tuple(statements)


def definitions(path: Path) -> set[str]:
    """Names that a module itself defines at its top level; imported names are not among them."""
    names: set[str] = set()
    blocks: list[ast.AST] = [tree(path)]
    while blocks:
        for node in ast.iter_child_nodes(blocks.pop()):
            if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef):
                names.add(node.name)
            elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                names.add(node.id)
            elif not isinstance(node, ast.Import | ast.ImportFrom):
                blocks.append(node)
    return names


def _absolute(statement: ast.ImportFrom, module: str, path: Path) -> str:
    if not statement.level:
        return statement.module or ""
    package = module.split(".") if path.stem == "__init__" else module.split(".")[:-1]
    package = package[: len(package) - statement.level + 1]
    return ".".join([*package, *filter(None, [statement.module])])
