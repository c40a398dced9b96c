"""The code digest of a stage, a parameter of its rule: snakemake does not see changes inside the package.

It covers the script of the stage and all modules of the package that it imports, directly or not, without comments and docstrings;
data files beside these modules; and the versions of the libraries that they import.
"""

from __future__ import annotations

import ast
import hashlib
import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache, wraps
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple, ParamSpec, TypeVar

from brdfpipe.store import write_text

DISTRIBUTIONS = {
    "alpaca": "alpyca",
    "PIL": "pillow",
    "colour": "colour-science",
    "serial": "pyserial",
    "yaml": "PyYAML",
}
"""Imported name → distribution, where they differ."""

LIBRARIES_BEHIND = {"xarray": ("netCDF4", "numpy", "pandas")}
"""Library → the libraries that it uses to compute and store."""

OPTIONAL = {"brdfpipe.surfaces.instruments": "SurfaceTopography"}
"""Module → optional library that it imports by a string."""

LIBRARIES_WITHOUT_EFFECT = frozenset({"lazy_loader", "tqdm"})
"""Libraries that do not change results."""

MODULES_WITHOUT_EFFECT = ("brdfpipe.jobs.", "brdfpipe.cli.")
"""Modules that run stages and do not change results."""

PACKAGE = "brdfpipe"

SOURCE = Path(__file__).resolve().parents[2]
"""The folder that holds the package."""

_P = ParamSpec("_P")
_R = TypeVar("_R")
_kept: dict[tuple[object, ...], object] | None = None
"""Results of the functions below while :func:`remember_parsed` lasts."""


def _kept_meanwhile(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """A function that :func:`remember_parsed` calls once for each file or library, not once for each stage that uses it."""

    @wraps(function)
    def once(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        if _kept is None:
            return function(*args, **kwargs)
        key = (function.__name__, *args)
        if key not in _kept:
            _kept[key] = function(*args, **kwargs)
        return _kept[key]  # type: ignore[return-value]

    return once


def digest(script: Path, root: Path | None = None, extra_modules: Iterable[str] = ()) -> str:
    """Digest of a stage's code.

    Parameters
    ----------
    script : the stage's script
    root : the folder that holds the package; default :data:`SOURCE`
    extra_modules : modules that the script imports by a name known only at run time

    Returns
    -------
    str : hexadecimal
    """
    root = root or SOURCE
    covered = _module_files(script, root, extra_modules)
    content = hashlib.sha256()
    for library in _libraries(script, covered):
        content.update(f"{library} {_installed(library)}\n".encode())
    content.update(f"script {_source(script).digest}\n".encode())
    for name, path in covered.items():
        content.update(f"{name} {_source(path).digest}\n".encode())
        if path.name == "__init__.py":
            for data in _data_files(path.parent):
                content.update(f"{data.relative_to(path.parent)} {_bytes_digest(data)}\n".encode())
    return content.hexdigest()[:32]


def modules(script: Path, root: Path | None = None, extra_modules: Iterable[str] = ()) -> tuple[str, ...]:
    """Modules of the package that a script imports, directly or not, in functions too; parameters as for :func:`digest`."""
    return tuple(_module_files(script, root or SOURCE, extra_modules))


def _module_files(script: Path, root: Path, extra_modules: Iterable[str]) -> dict[str, Path]:
    covered: dict[str, Path] = {}
    waiting = [*_source(script).imports, *extra_modules]
    while waiting:
        name = waiting.pop()
        if name in covered or f"{name}.".startswith(MODULES_WITHOUT_EFFECT) or name.split(".")[0] != PACKAGE:
            continue
        path = _module_path(name, root)
        if path is None:
            continue  # a name defined in a module
        covered[name] = path
        waiting.extend(_imported(name, path))
    return dict(sorted(covered.items()))


@_kept_meanwhile
def _imported(name: str, path: Path) -> tuple[str, ...]:
    """What importing a module imports: modules of the package, perhaps names within them, and libraries."""
    return (*_absolute(_source(path).imports, name, path), *_parents(name))


def libraries(script: Path, root: Path | None = None, extra_modules: Iterable[str] = ()) -> tuple[str, ...]:
    """Distributions that the code of a stage imports; parameters as for :func:`digest`."""
    return _libraries(script, _module_files(script, root or SOURCE, extra_modules))


def _libraries(script: Path, covered: Mapping[str, Path]) -> tuple[str, ...]:
    sources = [_source(script), *map(_source, covered.values())]
    names = {name.split(".")[0] for source in sources for name in source.imports if not name.startswith(".")}
    names |= {OPTIONAL[name] for name in covered if name in OPTIONAL}
    names |= {implied for name in names for implied in LIBRARIES_BEHIND.get(name, ())}
    names -= {PACKAGE} | LIBRARIES_WITHOUT_EFFECT | sys.stdlib_module_names
    return tuple(sorted(DISTRIBUTIONS.get(name, name) for name in names))


@_kept_meanwhile
def _installed(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return "none"


class _Source(NamedTuple):
    """What the digest of a stage needs of a module."""

    imports: tuple[str, ...]
    digest: str
    """Of the code without comments and docstrings."""


_parsed: dict[str, _Source] = {}
"""By path, time of the last change, and version of Python."""
_remembered: dict[str, _Source] = {}


@_kept_meanwhile
def _source(path: Path) -> _Source:
    key = f"{path} {path.stat().st_mtime_ns} {sys.hexversion}"
    if key not in _parsed and key in _remembered:
        _parsed[key] = _remembered[key]
    elif key not in _parsed:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        imports = tuple(dict.fromkeys(_imports(tree)))
        _strip_docstrings(tree)
        _parsed[key] = _Source(imports, hashlib.sha256(ast.dump(tree).encode()).hexdigest())
    return _parsed[key]


@contextmanager
def remember_parsed(file: Path) -> Iterator[None]:
    """Reuse what an earlier process has parsed, from a file: parsing all modules takes seconds. Meanwhile the code is taken as unchanged."""
    global _kept
    _remembered.clear()
    with suppress(OSError, ValueError):  # no such file, or a damaged one
        # A changed bit could hide an import, and with it a change of code, so the content has a digest.
        check, _, content = file.read_text(encoding="utf-8").partition("\n")
        if check == hashlib.sha256(content.encode()).hexdigest():
            _remembered.update({key: _Source(tuple(imports), digest) for key, imports, digest in json.loads(content)})
    _kept = {}
    try:
        yield
    finally:
        _kept = None
    if _parsed.keys() != _remembered.keys():
        content = json.dumps([(key, *source) for key, source in _parsed.items()])
        write_text(file, f"{hashlib.sha256(content.encode()).hexdigest()}\n{content}")


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
def _module_path(module: str, root: Path) -> Path | None:
    base = root.joinpath(*module.split("."))
    return next((path for path in (base.with_suffix(".py"), base / "__init__.py") if path.is_file()), None)


@_kept_meanwhile
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
