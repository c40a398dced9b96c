"""The code digest of a stage: changes when the stage's own code changes, and only then.

Snakemake does not see changes inside the package. So each rule has this digest as a parameter: of the stage's script and every
module of the package that it imports, directly or not, without comments and docstrings; of the data files beside those modules;
and of the versions of the libraries that those modules import.
"""

from __future__ import annotations

import ast
import hashlib
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

DISTRIBUTIONS = {
    "alpaca": "alpyca",
    "PIL": "pillow",
    "colour": "colour-science",
    "serial": "pyserial",
    "yaml": "PyYAML",
}
"""Imported name → distribution, where they differ."""

IMPLIED = {"xarray": ("netCDF4", "numpy", "pandas")}
"""Library → those that it computes and stores with."""

OPTIONAL = {"brdfpipe.surfaces.instruments": "SurfaceTopography"}
"""Module → the library that it imports by a string, where it is installed."""

UNCOUNTED = frozenset({"lazy_loader", "tqdm"})
"""Libraries that do not shape results."""

UNFOLLOWED = ("brdfpipe.jobs.", "brdfpipe.cli.")
"""Modules that run stages and do not shape results."""

PACKAGE = "brdfpipe"

SOURCE = Path(__file__).resolve().parents[2]
"""The folder that holds the package."""


def digest(script: Path, root: Path | None = None, also: Iterable[str] = ()) -> str:
    """Digest of a stage's code.

    Parameters
    ----------
    script : the stage's script
    root : the folder that holds the package; default :data:`SOURCE`
    also : modules that the script imports by a name that is known at run time alone

    Returns
    -------
    str : hexadecimal
    """
    root = root or SOURCE
    covered = modules(script, root, also)
    content = hashlib.sha256()
    for library in libraries(script, root, also):
        content.update(f"{library} {_installed(library)}\n".encode())
    content.update(f"script {_source(script).digest}\n".encode())
    for name in covered:
        path = _module_path(name, root)
        content.update(f"{name} {_source(path).digest}\n".encode())
        if path.name == "__init__.py":
            for data in _data_files(path.parent):
                content.update(f"{data.relative_to(path.parent)} {_bytes_digest(data)}\n".encode())
    return content.hexdigest()[:32]


def modules(script: Path, root: Path | None = None, also: Iterable[str] = ()) -> tuple[str, ...]:
    """Names of the package's modules that a script imports, directly or not, at the top or within a function.

    Parameters are those of :func:`digest`.
    """
    root = root or SOURCE
    covered: set[str] = set()
    waiting = [*_source(script).imports, *also]
    while waiting:
        name = waiting.pop()
        if name in covered or f"{name}.".startswith(UNFOLLOWED) or name.split(".")[0] != PACKAGE:
            continue
        if not _exists(name, root):
            continue  # a name defined in a module
        covered.add(name)
        path = _module_path(name, root)
        waiting.extend(_absolute(_source(path).imports, name, path))
        waiting.extend(_parents(name))
    return tuple(sorted(covered))


def libraries(script: Path, root: Path | None = None, also: Iterable[str] = ()) -> tuple[str, ...]:
    """Distributions that a script and the package's modules which it imports compute, read or store with; as for :func:`modules`."""
    root = root or SOURCE
    covered = modules(script, root, also)
    sources = [_source(script), *(_source(_module_path(name, root)) for name in covered)]
    names = {name.split(".")[0] for source in sources for name in source.imports if not name.startswith(".")}
    names |= {OPTIONAL[name] for name in covered if name in OPTIONAL}
    names |= {implied for name in names for implied in IMPLIED.get(name, ())}
    names -= {PACKAGE} | UNCOUNTED | sys.stdlib_module_names
    return tuple(sorted(DISTRIBUTIONS.get(name, name) for name in names))


def _installed(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return "none"


class _Source:
    """The parts of a module that its digest depends on: its code and what it imports."""

    def __init__(self, text: str) -> None:
        tree = ast.parse(text)
        self.imports = tuple(dict.fromkeys(_imports(tree)))
        _strip_docstrings(tree)
        self.digest = hashlib.sha256(ast.dump(tree).encode()).hexdigest()


def _source(path: Path) -> _Source:
    return _parsed(path, path.stat().st_mtime_ns)


@cache
def _parsed(path: Path, changed: int) -> _Source:
    return _Source(path.read_text(encoding="utf-8"))


def _imports(tree: ast.AST) -> Iterator[str]:
    """Dotted names that a module imports, and perhaps names within them; relative ones keep their leading dots."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = "." * node.level + (node.module or "")
            yield base
            separator = "" if base.endswith(".") else "."
            yield from (f"{base}{separator}{alias.name}" for alias in node.names)
        elif isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            waiting += node.orelse
        elif not isinstance(node, ast.expr):
            waiting += ast.iter_child_nodes(node)


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


@cache
def _candidates(module: str, root: Path) -> tuple[Path, Path]:
    base = root.joinpath(*module.split("."))
    return base.with_suffix(".py"), base / "__init__.py"


def _exists(module: str, root: Path) -> bool:
    return any(path.is_file() for path in _candidates(module, root))


def _module_path(module: str, root: Path) -> Path:
    return next(path for path in _candidates(module, root) if path.is_file())


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
