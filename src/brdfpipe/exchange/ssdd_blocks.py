"""Reading the blocks of files of surface scattering distribution data, see :mod:`brdfpipe.exchange.ssdd`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from brdfpipe.errors import InputError
from brdfpipe.exchange.azimuths import circle, closed
from brdfpipe.exchange.direction_rows import RowGrid, Rows, gridded_rows
from brdfpipe.exchange.read_table import Channels, ReadTable
from brdfpipe.exchange.text_lines import LARGEST_FILE
from brdfpipe.geometry import Array

_TABLES = {"brdf": "reflection", "btdf": "transmission"}
_SHARES = {"specular_reflectance": "mirrored", "specular_transmittance": "passed"}
_LAYOUTS = {
    "spherical_coordinate_system": ("uniform", "theta_i", "phi_i", "theta_o", "phi_o"),
    "specular_coordinate_system": ("specular", "theta_i", "phi_i", "theta_s", "phi_s"),
    "half_difference_coordinate_system": ("half", "theta_h", "phi_h", "theta_d", "phi_d"),
}
_MODELS: dict[str, Channels] = {"monochrome": "photopic", "rgb": "rgb", "xyz": "xyz", "spectrum": "spectral"}
_REDUCTIONS = {"bilateral_symmetry", "reciprocity"}
_WORDS = {"COLOR_MODEL", "PARAM_TYPE", "REDUCTION_TYPE"}
_LISTS = {"WAVELENGTH_LIST", *(f"PARAM{number}_LIST" for number in range(5))}
_IGNORED = {"SOFTWARE", "API", "DATE", "NAME", "SOURCE_TYPE", "DEVICE", "CREATION_DATE", "MEASUREMENT_DATE"}
_MOST_VALUES = 40_000_000
_LONGEST_LINE = 2**20
_BATCH = 2**16


@dataclass
class _Block:
    kind: str
    words: dict[str, list[str]] = field(default_factory=dict)
    lists: dict[str, Array] = field(default_factory=dict)
    values: Array | None = None
    """(parameter 3, 2, 1, 0, channels)"""


class _Bytes:
    """A file as lines of text and blocks of numbers."""

    def __init__(self, path: Path) -> None:
        if path.stat().st_size > LARGEST_FILE:
            raise InputError(path, "the file is too large", accepted=f"at most {LARGEST_FILE >> 20} MiB")
        self.path, self._content, self._at, self._line = path, path.read_bytes(), 0, 0

    def line(self) -> str | None:
        """The next line that is neither blank nor a comment; None at the end."""
        while self._at < len(self._content):
            end = self._content.find(b"\n", self._at, self._at + _LONGEST_LINE)
            if end < 0:
                end = min(len(self._content), self._at + _LONGEST_LINE)
            text, self._at, self._line = self._content[self._at : end], end + 1, self._line + 1
            line = text.decode("utf-8", "replace").strip()
            if line and not line.startswith("#"):
                return line
        return None

    def numbers(self, rows: int, columns: int) -> Array:
        """Rows of text."""
        # In batches: words of a whole table take many times the memory of its numbers.
        parts, words = [np.empty(0)], list[str]()
        for row in range(rows):
            line = self.line()
            if line is None:
                raise self.error("the file ends early", found=f"{row} colours", accepted=str(rows))
            of_row = line.split()
            if len(of_row) != columns:
                raise self.error("wrong number of channels", found=f"{len(of_row)} numbers", accepted=str(columns))
            words += of_row
            if len(words) > _BATCH:
                parts.append(self.finite(words))
                words = []
        return np.concatenate([*parts, self.finite(words)]).reshape(rows, columns)

    def singles(self, count: int) -> Array:
        """Numbers of four bytes, little endian."""
        end = self._at + 4 * count
        if end > len(self._content):
            found = f"{len(self._content) - self._at} bytes"
            raise self.error("the file ends early", found=found, accepted=f"{4 * count} bytes of numbers")
        values = np.frombuffer(self._content[self._at : end], dtype="<f4").astype(float)
        self._at = end
        if not np.isfinite(values).all():
            raise self.error("a number is not finite")
        return values

    def finite(self, words: list[str]) -> Array:
        try:
            values = np.array(words, dtype=float)
        except ValueError as error:
            raise self.error("not a number", found=str(error)[-60:], accepted="numbers") from error
        if not np.isfinite(values).all():
            raise self.error("a number is not finite")
        return values

    def error(self, problem: str, **words: str) -> InputError:
        return InputError(self.path, problem, where=f"line {self._line}", **words)


def read(path: Path) -> ReadTable:
    """Read the reflected light, or the transmitted light of a file without reflected light.

    Raises InputError: the file contradicts itself, or has no table that can be read.
    """
    file, blocks = _Bytes(path), dict[str, _Block]()
    if not (first := file.line() or "").startswith("VERSION 0."):
        raise file.error("no SSDD file", found=repr(first)[:60], accepted="VERSION 0.3")
    block: _Block | None = None
    while (line := file.line()) is not None:
        word, *values = line.split()
        if word == "DATA_TYPE":
            kind = values[0] if values else ""
            if kind not in {*_TABLES, *_SHARES} or kind in blocks:
                accepted = f"one each of {', '.join((*_TABLES, *_SHARES))}"
                raise file.error("unknown or repeated DATA_TYPE", found=repr(kind)[:40], accepted=accepted)
            block = blocks[kind] = _Block(kind)
        elif word in _IGNORED:
            continue
        elif block is None:
            raise file.error("an entry before DATA_TYPE", found=repr(word)[:40])
        elif word == "DATA":
            _read_values(block, values[0] if values else "", file)
            block = None
        elif word in _WORDS:
            block.words[word] = values
        elif word in _LISTS:
            block.lists[word] = file.finite(values)
        else:
            raise file.error("unknown entry", found=repr(word)[:40])
    if block is not None:
        raise file.error("the file ends early", found=f"no DATA of {block.kind}")
    return _table(blocks, path)


def _read_values(block: _Block, mode: str, file: _Bytes) -> None:
    model = (block.words.get("COLOR_MODEL") or [""])[0]
    if model not in _MODELS:
        raise file.error("unknown COLOR_MODEL", found=repr(model)[:40], accepted=", ".join(_MODELS))
    wavelength = block.lists.get("WAVELENGTH_LIST", np.empty(0))
    if model == "spectrum" and (wavelength.size == 0 or wavelength[0] <= 0 or not (np.diff(wavelength) > 0).all()):
        raise file.error("WAVELENGTH_LIST does not increase", found=f"{wavelength.size} wavelengths")
    channels = {"monochrome": 1, "spectrum": wavelength.size}.get(model, 3)
    names = ("PARAM3_LIST", "PARAM2_LIST", "PARAM1_LIST", "PARAM0_LIST")
    for name in names[:2] if block.kind in _TABLES else ():
        if name not in block.lists:
            raise file.error("a list is missing", found=f"no {name}")
    shape = [block.lists.get(name, np.zeros(1)).size for name in (names if block.kind in _TABLES else names[2:])]
    if "PARAM0_LIST" not in block.lists or 0 in shape:
        raise file.error("a list is missing or empty", accepted="PARAM0_LIST")
    count = float(np.prod([float(size) for size in shape]))
    if count * channels > _MOST_VALUES:
        raise file.error("the table is too large", found=f"{count * channels:.3g} values", accepted=f"{_MOST_VALUES}")
    if mode not in ("ascii", "binary"):
        raise file.error("unknown DATA", found=repr(mode)[:40], accepted="ascii, binary")
    rows = int(count)
    values = file.numbers(rows, channels) if mode == "ascii" else file.singles(rows * channels)
    block.values = values.reshape(*shape, channels)


def _table(blocks: dict[str, _Block], path: Path) -> ReadTable:
    kind = next((kind for kind in _TABLES if kind in blocks), None)
    if kind is None:
        found = ", ".join(blocks) or "no block"
        raise InputError(path, "the file has no table", found=found, accepted="a block brdf or btdf")
    block = blocks[kind]
    notes, warnings = [], [_share(blocks[name]) for name in _SHARES if name in blocks]
    if kind == "brdf" and "btdf" in blocks:
        notes.append("the transmitted light was not read")
    parameters = " ".join(block.words.get("PARAM_TYPE", []))
    if parameters not in _LAYOUTS:
        raise InputError(path, "unknown PARAM_TYPE", found=repr(parameters)[:60], accepted=", ".join(_LAYOUTS))
    if np.any(block.lists.get("PARAM4_LIST", 0.0) != 0):
        raise InputError(path, "offsets of the specular direction are not read", found="PARAM4_LIST", accepted="none")
    layout, *names = _LAYOUTS[parameters]
    assert block.values is not None
    values = block.values.transpose(3, 2, 1, 0, 4)
    axes = dict(zip(names, (block.lists.get(f"PARAM{number}_LIST", np.zeros(1)) for number in range(4)), strict=True))
    _, azimuth, _, around = names
    with_lay = axes[azimuth].size > 1
    reductions = set(block.words.get("REDUCTION_TYPE", []))
    if reductions - _REDUCTIONS:
        found = ", ".join(reductions - _REDUCTIONS)[:60]
        raise InputError(path, "unknown REDUCTION_TYPE", found=found, accepted=", ".join(sorted(_REDUCTIONS)))
    axes[around], values = _unreduced(axes[around], values, reductions if layout == "half" else set())
    if layout == "uniform" and (with_lay or axes[azimuth][0] != 0):
        # Azimuths of scatter count from the same direction as the one azimuth of incidence.
        grid = _relative(axes, values, path)
        axes, values, notes = dict(grid.axes), grid.values, [*notes, *grid.notes]
    else:
        axes[around], values = circle(axes[around], values, path, f"of {around}")
        if with_lay:
            axes[azimuth], values = closed(axes[azimuth], values.swapaxes(0, 1), 0)
            axes = {azimuth: axes[azimuth], **{name: axes[name] for name in names if name != azimuth}}
        else:
            values = values[:, 0]
            axes.pop(azimuth)
    model = block.words["COLOR_MODEL"][0]
    if model == "rgb":
        notes.append("the format does not define its red, green and blue; they were taken as linear sRGB")
    return ReadTable(
        layout,
        axes,
        values,
        channels=_MODELS[model],
        wavelength=block.lists["WAVELENGTH_LIST"] if model == "spectrum" else None,
        side=_TABLES[kind],
        notes=tuple(notes),
        warnings=tuple(warnings),
    )


def _unreduced(around: Array, values: Array, reductions: set[str]) -> tuple[Array, Array]:
    """Differences of azimuth that reciprocity leaves out: values (…, φ_d, channels) have a period of 180 degree."""
    if "reciprocity" not in reductions or around[-1] > 180:
        return around, values
    if "bilateral_symmetry" in reductions:
        # Both together mirror at 90 degree.
        kept = around <= 90
        around, values = around[kept], values[..., kept, :]
        first = -2 if around[-1] == 90 else -1
        return np.append(around, 180 - around[first::-1]), np.concatenate([values, values[..., first::-1, :]], axis=-2)
    first = 1 if around[-1] == 180 else 0
    return np.append(around, 180 + around[first:]), np.concatenate([values, values[..., first:, :]], axis=-2)


def _relative(axes: dict[str, Array], values: Array, path: Path) -> RowGrid:
    """A grid whose azimuths of scatter count from a fixed direction, values (θ_i, φ_i, θ_o, φ_o, channels)."""
    angles = np.meshgrid(*axes.values(), indexing="ij")
    theta_i, phi_i, theta_o, phi_o = (angle.ravel() for angle in angles)
    return gridded_rows(Rows(theta_i, phi_i, theta_o, phi_o, values.reshape(-1, values.shape[-1])), path)


def _share(block: _Block) -> str:
    """What a table does not hold, in words."""
    assert block.values is not None
    angles, share = block.lists["PARAM0_LIST"], block.values.mean(axis=(0, 2))
    chosen = np.unique(np.linspace(0, angles.size - 1, 5).round().astype(int))
    listed = " ".join(f"{angles[one]:g}:{share[one]:.4f}" for one in chosen)
    return f"the file has light that is {_SHARES[block.kind]} into a single direction, which this table does not hold; its share by theta_i in degree: {listed}"
