"""The code digest of a stage: changes when the stage's own code changes, and only then.

Snakemake does not see changes inside the package. So each rule carries this digest as a parameter: of the stage's script
and every module of the package it imports, directly or not, comments and docstrings aside; of the data files beside those
modules; and of the versions of the libraries that compute and store, and of an optional one where a module reads with it.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

LIBRARIES = ("defusedxml", "jinja2", "netCDF4", "numpy", "pandas", "pillow", "scipy", "xarray")

EXTRAS = {
    "brdfpipe.spectra.colour_science": "colour-science",
    "brdfpipe.surfaces.instruments": "SurfaceTopography",
}
"""Module → the library that only it imports; an optional one may be missing."""

UNFOLLOWED = ("brdfpipe.jobs.", "brdfpipe.cli.")
"""The machinery: it carries results and does not shape them."""

PACKAGE = "brdfpipe"


def digest(script: Path, root: Path | None = None) -> str:
    """Digest of a stage's code.

    Parameters
    ----------
    script : the stage's script
    root : the folder that holds the package; default the one this module runs from

    Returns
    -------
    str : hexadecimal
    """
    root = (root or Path(__file__).resolve().parents[2]).resolve()
    content = hashlib.sha256()
    for library in LIBRARIES:
        content.update(f"{library} {version(library)}\n".encode())
    content.update(f"script {_read(script, script.stat().st_mtime_ns).digest}\n".encode())
    for name in modules(script, root):
        path = _path(name, root)
        assert path is not None
        content.update(f"{name} {_read(path, path.stat().st_mtime_ns).digest}\n".encode())
        if name in EXTRAS:
            content.update(f"{EXTRAS[name]} {_installed(EXTRAS[name])}\n".encode())
        if path.name == "__init__.py":
            for data in _data_files(path.parent):
                content.update(f"{data.relative_to(path.parent)} {_bytes_digest(data)}\n".encode())
    return content.hexdigest()[:32]


def _installed(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return "none"


def modules(script: Path, root: Path) -> tuple[str, ...]:
    """Names of the package's modules that a script imports, directly or not, in whatever function the import stands."""
    found: set[str] = set()
    waiting = list(_read(script, script.stat().st_mtime_ns).imports)
    while waiting:
        name = waiting.pop()
        if name in found or f"{name}.".startswith(UNFOLLOWED):
            continue
        path = _path(name, root)
        if path is None:
            continue  # an attribute of the module that was added with it
        found.add(name)
        waiting.extend(_absolute(_read(path, path.stat().st_mtime_ns).imports, name, path))
        waiting.extend(_parents(name))
    return tuple(sorted(found))


class _Source:
    """A module as far as its digest goes: what it says and what it imports."""

    def __init__(self, text: str) -> None:
        tree = ast.parse(text)
        self.imports = tuple(dict.fromkeys(_imports(tree)))
        _strip_docstrings(tree)
        self.digest = hashlib.sha256(ast.dump(tree).encode()).hexdigest()


@cache
def _read(path: Path, changed: int) -> _Source:
    return _Source(path.read_text(encoding="utf-8"))


def _imports(tree: ast.AST) -> Iterator[str]:
    """Dotted names a module might mean; relative ones keep their leading dots."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.split(".")[0] == PACKAGE)
        elif isinstance(node, ast.ImportFrom):
            base = "." * node.level + (node.module or "")
            if node.level or base.split(".")[0] == PACKAGE:
                yield base
                separator = "" if base.endswith(".") else "."
                yield from (f"{base}{separator}{alias.name}" for alias in node.names)


def _absolute(names: tuple[str, ...], module: str, path: Path) -> Iterator[str]:
    for name in names:
        level = len(name) - len(name.lstrip("."))
        if not level:
            yield name
            continue
        package = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
        yield ".".join([*package[: len(package) - level + 1], *filter(None, name.lstrip(".").split("."))])


def _parents(name: str) -> Iterator[str]:
    # Importing a.b.c runs a/__init__ and a.b/__init__ too.
    while "." in name:
        name = name.rpartition(".")[0]
        yield name


def _path(module: str, root: Path) -> Path | None:
    base = root.joinpath(*module.split("."))
    for path in (base.with_suffix(".py"), base / "__init__.py"):
        if path.is_file():
            return path
    return None


def _data_files(package: Path) -> list[Path]:
    """Tables, templates and the like that belong to a package, not to a package below it."""
    files = []
    for item in sorted(package.iterdir()):
        if item.is_file() and item.suffix not in (".py", ".pyc", ".pyi") and not item.name.startswith("."):
            files.append(item)
        elif item.is_dir() and not item.name.startswith(("_", ".")) and not (item / "__init__.py").exists():
            files += [path for path in sorted(item.rglob("*")) if path.is_file() and path.suffix not in (".py", ".pyc")]
    return files


@cache
def _bytes_digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _strip_docstrings(tree: ast.AST) -> None:
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            # A string on its own line does nothing, wherever it stands.
            node.body = [  # type: ignore[attr-defined]
                item
                for item in body
                if not (
                    isinstance(item, ast.Expr)
                    and isinstance(item.value, ast.Constant)
                    and isinstance(item.value.value, str)
                )
            ]
