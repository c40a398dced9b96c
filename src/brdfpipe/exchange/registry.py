"""Formats of other programs, each declared by a module of this package.

The module is named like the format (``-`` becomes ``_``) and declares it by one statement of literals::

    FORMAT = Format(
        description="what the files hold, in one sentence",
        files={"reflection": {"write": (".ext",)}},
        takes="bsdf",
    )

and defines the writers that ``files`` names: ``write(bsdf, path, **options)``. The accepted values of ``exports``, the rules of
the workflow and the documentation follow. Declarations are read without importing the modules, which is slow.
"""

from __future__ import annotations

import ast
import importlib
import json
import os
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

from brdfpipe.errors import BrdfpipeError

if TYPE_CHECKING:
    import xarray as xr


PROPERTIES: Mapping[str, str] = {
    "transmission": "light that passes to the other side",
    "lay": "dependence on the azimuth of incidence",
    "spectrum": "values by wavelength",
    "colour": "three values of a colour",
    "specular": "light that is mirrored into a single direction",
    "uncertainty": "standard uncertainties",
    "polarisation": "Mueller matrices",
}
"""What a BSDF may have and a format may lose."""

LOSSES: Mapping[str, str] = {
    **PROPERTIES,
    "gamut": "colours outside sRGB",
    "reciprocity": "differences between both orders of the directions",
    "resolution": "detail within the fixed cells of the format",
}
"""What a record may say to be left out: keys of ``left_out`` in words."""

QUANTITIES = ("brdf", "brdf_cos", "pi_brdf")
"""What the numbers of a table that is read are: BRDF [sr-1], BRDF·cos θ_o [sr-1], or the reflectance factor π·BRDF."""

GRID_OPTIONS: Mapping[str, Any] = {"tolerance": 0.01, "albedo_tolerance": 0.001, "largest": 400_000}
"""Options of all formats on a grid of directions: limits of the error at the 95th percentile of directions, relative to BRDF·cos θ_o, and of
the directional reflectance [1]; and the largest number of values of one channel, about 4 MB of text: a file by wavelength is larger by the number
of its wavelengths."""

_OPTION_KINDS: Mapping[type, tuple[type, str]] = {
    bool: (bool, "true or false"),
    int: (Real, "a number"),
    float: (Real, "a number"),
}
"""Type of an option's default → what the option takes, and this in words."""

LISTED = "`brdfpipe formats` lists the formats"
"""Where a message would be too long with all of them."""

REFUSAL_ADVICE = (
    "Refused formats: take them out of `exports` of the material, the scene or the configuration, name one with a table, give options to "
    "`brdfpipe convert`, or accept the refusal by `accept` in material.yaml"
)
"""What to change, said once for all refusals of a build or a page."""

_COMMON_SUFFIXES = (".zemax.bsdf", ".ddr", ".astm", ".nc")

RECORD = ".json"
"""Suffix of the record beside a file."""


class ExchangeError(BrdfpipeError):
    """A BSDF cannot be written in this format."""


@dataclass(frozen=True)
class Format:
    """A file format that a BSDF can be written in."""

    description: str
    """What the files hold, in one sentence."""
    files: Mapping[str, Mapping[str, tuple[str, ...]]]
    """Files of each side of the material, ``reflection`` and ``transmission``: name of a writer → suffixes of the files it writes; empty of a
    format that is read alone.

    A writer is a function of the module. It is called with the path of the first file and writes the others beside it. A material
    without transmission has the files of ``reflection`` alone; a format with both sides in one file declares it there."""
    takes: str = "bsdf"
    """``bsdf``: the writers take the BSDF; ``grid``: they take the BSDF and :data:`GRID_OPTIONS`, and return a record that is written beside
    each file, with the suffix ``.json``; ``cells``: the same without these options, because the format fixes its cells."""
    beside: tuple[str, ...] = ()
    """Writers of small tables beside the others: they take no options and return no record"""
    carries: tuple[str, ...] = ()
    """What survives, of :data:`PROPERTIES`."""
    refuses: tuple[str, ...] = ()
    """What a BSDF must not have, of :data:`PROPERTIES`; what it has and the files do not carry is lost otherwise."""
    longest_name: int = 0
    """Of a file that the program reads, in characters; 0: any."""
    read: str = ""
    """Name of the function that reads the files; empty if none does."""
    reads: tuple[str, ...] = ()
    """Suffixes of files that are read, beside those that are written."""
    begins: tuple[str, ...] = ()
    """Words of which the beginning of a file holds one, where several formats have its suffix."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Keyword of the writers → its default, such as ``tolerance``."""
    spectral: Mapping[str, Any] = field(default_factory=dict)
    """Options with which the files have a value for each wavelength, where they do not always."""
    name: str = ""
    """Name of the module, set by the registry."""

    @property
    def module(self) -> str:
        """Name of the format's module."""
        return f"{__package__}.{self.name.replace('-', '_')}"

    @property
    def readable_suffixes(self) -> list[str]:
        """Suffixes of the files that are read: those that are written, but for the tables beside them, and others; empty of a format that is not read."""
        if not self.read:
            return []
        written = [
            suffix
            for side in self.files.values()
            for writer, group in side.items()
            for suffix in group
            if writer not in self.beside
        ]
        return [*written, *self.reads]

    def refusals(self, material: str, has: Collection[str], sides: Collection[str] = ("reflection",)) -> list[str]:
        """Why no file of a material is written, as far as it is known without its BSDF; empty if nothing is.

        Parameters
        ----------
        material : its name
        has : what is known that it has, of :data:`PROPERTIES`
        sides : of :attr:`files` that it has
        """
        reasons = [
            f"the format does not take a material with {PROPERTIES[name]}" for name in self.refuses if name in has
        ]
        names = [
            f"{material}{suffix}" for side in sides for group in self.files.get(side, {}).values() for suffix in group
        ]
        if self.longest_name and (long := [name for name in names if len(name) > self.longest_name]):
            reasons.append(f"the program reads names of at most {self.longest_name} characters; found {len(long[0])}")
        return reasons

    @property
    def has_record(self) -> bool:
        """Whether a record stands beside each file."""
        return self.takes in ("grid", "cells")

    def suffixes(self, side: str) -> list[str]:
        """Suffixes of the files of one side, the main one first."""
        written = self.files[side].items()
        named = [suffix for _, group in written for suffix in group]
        recorded = [
            suffix for writer, group in written for suffix in group if self.has_record and writer not in self.beside
        ]
        return [*named, *(f"{suffix}{RECORD}" for suffix in recorded)]

    def write(
        self, bsdf: xr.Dataset, stem: str | os.PathLike[str], side: str = "reflection", **keywords: Any
    ) -> dict[str, Mapping[str, Any]]:
        """Write all files of one side: ``stem`` and the suffixes of the format.

        Returns the records of the writers that have one, by the name of their first file.

        Raises
        ------
        ExchangeError : the format cannot hold such a BSDF, or it has no such option.
        """
        paths = {writer: f"{stem}{suffixes[0]}" for writer, suffixes in self.files[side].items()}
        records = {Path(path).name: self.run(writer, bsdf, path, keywords) for writer, path in paths.items()}
        return {name: record for name, record in records.items() if record}

    def run(
        self, writer: str, bsdf: xr.Dataset, path: str | os.PathLike[str], keywords: Mapping[str, Any]
    ) -> Mapping[str, Any]:
        """Call one of the writers, and write the record that it returns beside the file, unless the file itself has it; the record, empty where there is none."""
        options = self.keywords(keywords)
        if writer in self.beside:
            self.function(writer)(bsdf, Path(path))
            return {}
        record: Mapping[str, Any] = self.function(writer)(bsdf, Path(path), **options) or {}
        if self.has_record:
            self.write_record(path, record)
        return record

    def write_record(self, path: str | os.PathLike[str], record: Mapping[str, Any]) -> None:
        """Write what a writer returned beside its file."""
        from brdfpipe import store

        record = {"format": self.name, "file": Path(path).name, **record}
        store.write_text(f"{path}{RECORD}", json.dumps(record, indent=1, ensure_ascii=False, sort_keys=True) + "\n")

    def function(self, name: str) -> Callable[..., Any]:
        """A function of the format's module, which this imports."""
        function: Callable[..., Any] = getattr(importlib.import_module(self.module), name)
        return function

    def keywords(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Keywords of the writers: the options with their defaults."""
        options = {**(GRID_OPTIONS if self.takes == "grid" else {}), **self.options}
        if unknown := sorted(set(given) - set(options)):
            accepted = ", ".join(sorted(options)) or "no option"
            raise ExchangeError(f"{self.name}: unknown option {unknown[0]!r}; accepted: {accepted}")
        for name, value in given.items():
            kind, words = _OPTION_KINDS.get(type(options[name]), (object, ""))
            if not isinstance(value, kind) or (kind is Real and (isinstance(value, bool) or value != value)):
                raise ExchangeError(f"{self.name}: {name} is {repr(value)[:40]}; accepted: {words}")
        return {**options, **given}


def write(bsdf: xr.Dataset, path: str | os.PathLike[str], format: str | None = None, **options: Any) -> None:
    """Write a BSDF for another program.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    path : the file; it appears whole or not at all. Its suffix says which file of the format it is, ``.astm`` or
        ``.transmission.astm``; another suffix needs ``format``, and gives the first file
    format : a key of :data:`FORMATS`; by default the one of the suffix
    options : keywords of the format, see :attr:`Format.options`

    Raises
    ------
    ExchangeError : the format or an option is unknown, or the format does not take such a BSDF.
    """
    declared, writer = writer_of(path, format)
    declared.run(writer, bsdf, path, options)


def writer_of(path: str | os.PathLike[str], format: str | None = None) -> tuple[Format, str]:
    """The format of a file to be written, and the name of its writer; parameters and errors as for :func:`write`."""
    name = Path(path).name
    if format is not None and format not in WRITTEN:
        raise ExchangeError(f"{name}: unknown format {format!r}; {LISTED}")
    writers = {
        (declared.name, writer): suffixes[0]
        for declared in ([FORMATS[format]] if format else FORMATS.values())
        for files in declared.files.values()
        for writer, suffixes in files.items()
    }
    matches = {key: suffix for key, suffix in writers.items() if name.endswith(suffix)}
    longest = {key for key, suffix in matches.items() if len(suffix) == max(map(len, matches.values()))}
    if len(longest) > 1:
        formats = ", ".join(sorted(declared for declared, _ in longest))
        raise ExchangeError(f"{name}: several formats have this suffix; name the format, one of {formats}")
    if not longest and format is None:
        ending = Path(path).suffix or "no suffix"
        near = sorted(suffix for suffix in writers.values() if suffix.endswith(ending))
        hint = f" such as {' or '.join(near)}" if near else f" such as {', '.join(_COMMON_SUFFIXES)}"
        raise ExchangeError(
            f"{name}: no format has files that end with {ending!r}; accepted: an ending{hint}; {LISTED}"
        )
    declared, writer = longest.pop() if longest else next(iter(writers))
    return FORMATS[declared], writer


def _declaration(path: Path) -> Format | None:
    """The format that a module declares; None where it declares none."""
    text = path.read_text(encoding="utf-8")
    if "FORMAT = Format(" not in text:
        return None
    for statement in ast.parse(text).body:
        match statement:
            case ast.Assign(targets=[ast.Name("FORMAT")], value=ast.Call(args=[], keywords=keywords)):
                try:
                    values = {str(keyword.arg): ast.literal_eval(keyword.value) for keyword in keywords}
                except ValueError as error:
                    raise ExchangeError(f"{path.name}: FORMAT must be declared with literals only ({error})") from error
                return Format(**{**values, "name": path.stem.replace("_", "-")})
    return None


FORMATS: Mapping[str, Format] = {
    format.name: format for path in sorted(Path(__file__).parent.glob("*.py")) if (format := _declaration(path))
}
"""Formats by name."""

WRITTEN = tuple(name for name, format in FORMATS.items() if format.files)
"""Names of the formats that a BSDF can be written in."""
