"""Integra's Lumicept and Inspirer: diffuse distribution of reflected (``.ddr``) and transmitted light (``.ddt``), text.

Angles of scatter are counted about the specular ray, as in a Zemax file: ``theta`` from it, ``phi`` 0 towards the normal, counter-clockwise. ``sigma`` is
the angle of incidence and ``psi`` its azimuth. Values of a channel have the unit π·BRDF / kbdf (``Luminance Absolute``), where ``kbdf`` is the
reflectance at each incidence. With ``Intensity`` the values hold the cosine of the outgoing angle; ``Relative`` values have an arbitrary scale and are those whose
integral is ``kbdf``.

References
----------
Voloboy et al. 2005 (Keldysh Institute preprint), angles about the specular ray; libbsdf (reader and writer, 2026).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import store
from brdfpipe.bsdf.one_side import Side
from brdfpipe.errors import InputError
from brdfpipe.exchange import gridded, number_text, records, specular_shares
from brdfpipe.exchange.azimuths import circle, closed
from brdfpipe.exchange.read_table import Channels, ReadTable
from brdfpipe.exchange.registry import ExchangeError, Format
from brdfpipe.exchange.text_lines import Lines
from brdfpipe.geometry import Array

FORMAT = Format(
    description="a table about the specular ray, for Integra's Lumicept and Inspirer",
    files={
        "reflection": {"write": (".ddr",), "write_mirrored": (".sdr",)},
        "transmission": {"write_transmission": (".ddt",), "write_undeviated": (".sdt",)},
    },
    takes="grid",
    beside=("write_mirrored", "write_undeviated"),
    carries=("transmission", "lay", "colour", "spectrum"),
    options={"colour": "bw"},
    spectral={"colour": "spectral"},
    read="read",
    reads=(".sdr", ".sdt"),
)

_COLOURS = ("bw", "rgb", "spectral")
_RGB = ("red", "gre", "blu")
_SYMMETRIES = ("axisymmetrical", "dirsymmetrical", "planesymmetrical", "asymmetrical", "asymmetrical 4d")
_AXES = {"psi": "phi_i", "sigma": "theta_i", "phi": "phi_s", "theta": "theta_s"}
_VALUES = {
    side: f"{text}: value kbdf / pi, where kbdf is the share of the light that this table itself sends there"
    for side, text in records.VALUES.items()
}
_MOST_VALUES = 40_000_000


def write(bsdf: xr.Dataset, path: Path, *, colour: str = "bw", **grid: Any) -> records.Record:
    """Write the reflecting side.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    path : the file; it appears whole or not at all
    colour : ``bw``, weighted with V(λ) and D65; ``rgb``, linear sRGB under D65, negative values 0; or ``spectral``, a table for each wavelength of the BSDF
    grid : options of :func:`brdfpipe.exchange.gridded.gridded`

    Raises
    ------
    ExchangeError : an option is unknown or out of range.
    """
    return _write(bsdf, path, "reflection", colour, grid)


def write_transmission(bsdf: xr.Dataset, path: Path, *, colour: str = "bw", **grid: Any) -> records.Record:
    """Write the light that passes a sheet, about the ray that goes straight on; as :func:`write`."""
    return _write(bsdf, path, "transmission", colour, grid)


def write_mirrored(bsdf: xr.Dataset, path: Path) -> None:
    """Write the share of light that is mirrored into a single direction, weighted with V(λ) and D65."""
    specular_shares.write(bsdf, path, "reflection")


def write_undeviated(bsdf: xr.Dataset, path: Path) -> None:
    """Write the share of light that passes a sheet in a single direction, weighted with V(λ) and D65."""
    specular_shares.write(bsdf, path, "transmission")


def _write(bsdf: xr.Dataset, path: Path, side: Side, colour: str, grid: Mapping[str, Any]) -> records.Record:
    if colour not in _COLOURS:
        raise ExchangeError(f"colour is {colour!r}; accepted: {', '.join(_COLOURS)}")
    seen = gridded.side_of(bsdf, side, path)
    channels, names = _channels(seen, colour)
    table = gridded.gridded(seen, "specular", channels, **grid)
    record = records.record(table, FORMAT, bsdf)
    azimuths = table.axes["phi_i"].size if "phi_i" in table.axes else 1
    blocks, shares = [], np.empty((azimuths, table.axes["theta_i"].size, table.channel_count))
    for row, theta_i in enumerate(table.axes["theta_i"]):
        values = np.maximum(table.block(row), 0.0)
        shares[:, row] = table.integral(float(theta_i), values)
        # Single precision has more digits than the text, and a spectral table may have many channels.
        blocks.append((values if "phi_i" in table.axes else values[None]).astype(np.float32))
    kbdf = np.array([float(f"{share:.6g}") for share in shares.ravel()]).reshape(shares.shape)
    with store.atomic_path(path) as temporary, temporary.open("wb") as file:
        file.writelines(_header(table, records.sentences(record, _VALUES[side]), side))
        for channel, name in enumerate(names):
            file.writelines(_data(name, [block[..., channel] for block in blocks], kbdf[..., channel]))
    return record


def _channels(bsdf: xr.Dataset, colour: str) -> tuple[gridded.Channels, tuple[str, ...]]:
    if colour == "spectral" and "wavelength" in bsdf.coords:
        wavelength = bsdf["wavelength"].values
        return gridded.spectral(bsdf, wavelength), tuple(f"wl {one:g}" for one in wavelength)
    if colour == "rgb" and "wavelength" in bsdf.coords:
        rgb = gridded.linear_rgb(bsdf)
        return replace(rgb, convert=lambda values: np.maximum(rgb.convert(values), 0.0)), _RGB
    return gridded.photopic(bsdf), ("bw",)


def _header(table: gridded.Gridded, notes: list[str], side: Side) -> Iterator[bytes]:
    symmetry = "PlaneSymmetrical" if table.axes["phi_s"][-1] <= 180 else "ASymmetrical"
    symmetry = "ASymmetrical 4D" if "phi_i" in table.axes else symmetry
    model = {1: "BW", 3: "RGB"}.get(table.channel_count, "") if table.channels.wavelength is None else ""
    yield "".join(f";; {note}\n" for note in notes).encode("ascii", "replace")
    if model == "RGB":
        yield b";; red gre blu: linear sRGB under D65, negative values are 0\n"
    yield f"Source Generated\nTypeSym {symmetry}\nTypeColorModel {model or f'spectral {table.channel_count}'}\n".encode()
    yield b"TypeData Luminance Absolute\n"
    for name, axis in _AXES.items():
        if axis in table.axes:
            angles = table.axes[axis]
            listed = f"{angles.size}\n{' '.join(f'{angle:g}' for angle in angles)}\n"
            yield f"{name} {listed}".encode()
            if side == "transmission" and name == "sigma":
                yield f"sigmaT {listed}".encode()


def _data(name: str, blocks: list[NDArray[np.float32]], kbdf: Array) -> Iterator[bytes]:
    """One channel: blocks by azimuth of incidence and incidence, rows by azimuth."""
    yield f"{name}\nkbdf\n{' '.join(f'{share:.6g}' for share in kbdf.ravel())}\ndef\n".encode()
    for azimuth in range(kbdf.shape[0]):
        for block, share in zip(blocks, kbdf[azimuth], strict=True):
            scale = np.pi / share if share > 0 else np.pi
            yield number_text.rows(block[azimuth].T.astype(float) * scale, " ")
    yield b"enddef\n"


def read(path: Path) -> ReadTable:
    """Read scattered light.

    Raises InputError: the file contradicts itself, is not of this format, or holds shares of light in single directions alone.
    """
    if path.suffix.lower() in specular_shares.SUFFIXES.values():
        shares = specular_shares.read(path)
        found = f"{shares.values.mean(axis=1)[0]:.4g} of the light at {shares.theta_i[0]:g}°"
        accepted = "the table of scattered light beside it (.ddr, .ddt)"
        raise InputError(path, "light in single directions alone is no BSDF", found=found, accepted=accepted)
    lines = Lines(path, ";")
    header, axes, first = _read_header(lines, path)
    for name in ("theta_i", "phi_s", "theta_s"):
        if name not in axes:
            word = next(key for key, axis in _AXES.items() if axis == name)
            raise lines.error(f"the header has no {word}", found=repr(first)[:40], accepted=f"{word} and its angles")
    azimuths = axes.get("phi_i", np.zeros(1))
    content, _, count = header.get("typecolormodel", "").partition(" ")
    if content not in _COLOURS:
        raise lines.error("unknown TypeColorModel", found=repr(content)[:40], accepted="BW, RGB, spectral")
    channels = lines.count(count, 2000) if content == "spectral" else {"bw": 1, "rgb": 3}[content]
    shape = azimuths.size, axes["theta_i"].size, axes["phi_s"].size, axes["theta_s"].size, channels
    if np.prod([float(size) for size in shape]) > _MOST_VALUES:
        raise InputError(path, "the table is too large", found=str(shape), accepted=f"at most {_MOST_VALUES} values")
    values, kbdf = np.empty(shape), np.full((*shape[:2], channels), np.nan)
    wavelength = np.empty(channels)
    for channel in range(channels):
        line = first if channel == 0 else lines.next("the next channel")
        wavelength[channel] = _channel(lines, line, content, channel)
        word, _, begun = lines.next("kbdf").partition(" ")
        if word.lower() == "kbdf":
            kbdf[..., channel] = lines.gathered(shape[0] * shape[1], "kbdf", begun).reshape(shape[:2])
            word = lines.next("def")
        if word.lower() != "def":
            raise lines.error("values begin with def", found=repr(word)[:40], accepted="def")
        for index in np.ndindex(shape[:2]):
            values[*index, ..., channel] = lines.gathered(shape[2] * shape[3], "values").reshape(shape[2:4])
        lines.expect("enddef")
    if content == "spectral" and not (wavelength[0] > 0 and (np.diff(wavelength) > 0).all()):
        found = ", ".join(f"{one:g}" for one in wavelength[:8])
        raise InputError(path, "the wavelengths do not increase", found=found, accepted="increasing nm")
    return _table(path, header, axes, values, kbdf, content, wavelength)


def _read_header(lines: Lines, path: Path) -> tuple[dict[str, str], dict[str, Array], str]:
    """Words and angles of the header, and the line of the first channel."""
    header: dict[str, str] = {}
    axes: dict[str, Array] = {}
    while True:
        line = lines.next("a line of the header or of a channel")
        key, _, rest = " ".join(line.split()).partition(" ")
        key = key.lower()
        if key in ("bw", "wl", *_RGB, "green", "blue"):
            break
        if key == "sigmat":
            count, _, begun = rest.partition(" ")
            straight = lines.gathered(lines.count(count, 4000), key, begun)
            if not np.array_equal(straight, axes.get("theta_i", np.empty(0))):
                found, accepted = f"{straight[0]:g} to {straight[-1]:g}", "the angles sigma, as of a sheet in air"
                raise lines.error("light is transmitted about refracted directions", found=found, accepted=accepted)
            header[key] = "straight"
        elif key in _AXES:
            count, _, begun = rest.partition(" ")
            axes[_AXES[key]] = lines.gathered(lines.count(count, 4000), key, begun)
        elif key in ("source", "typesym", "typecolormodel", "typedata"):
            header[key] = rest.lower()
        else:
            raise lines.error(
                "unknown word of the header", found=repr(key)[:40], accepted="Source, TypeSym, …, sigma, phi, theta"
            )
    if header.get("typesym", "asymmetrical") not in _SYMMETRIES:
        raise lines.error("unknown TypeSym", found=header["typesym"][:40], accepted=", ".join(_SYMMETRIES))
    return header, axes, line


def _channel(lines: Lines, line: str, content: str, number: int) -> float:
    """Wavelength [nm] of a spectral channel, NaN of others."""
    word, _, rest = line.lower().partition(" ")
    if content == "spectral":
        if word != "wl":
            raise lines.error("unexpected channel", found=repr(line)[:40], accepted="wl and a wavelength in nm")
        return lines.number(rest)
    wanted = ("bw",) if content == "bw" else _RGB
    if word[:3] != wanted[number][:3]:
        raise lines.error("unexpected channel", found=repr(line)[:40], accepted=wanted[number])
    return np.nan


def _table(
    path: Path,
    header: dict[str, str],
    axes: dict[str, Array],
    values: Array,
    kbdf: Array,
    content: str,
    wavelength: Array,
) -> ReadTable:
    unit, _, scale = header.get("typedata", "luminance absolute").partition(" ")
    if unit not in ("luminance", "intensity") or scale not in ("absolute", "relative"):
        found, accepted = repr(header["typedata"])[:40], "Luminance or Intensity, Absolute or Relative"
        raise InputError(path, "unknown TypeData", found=found, accepted=accepted)
    relative = scale == "relative"
    with np.errstate(over="ignore", invalid="ignore"):
        factor = np.where(np.isnan(kbdf) | relative, 1.0, kbdf)[:, :, None, None]
        # Intensity: the values hold the cosine, and no π.
        values = values * factor / (np.pi if unit == "luminance" else 1.0)
    if not np.isfinite(values).all():
        raise InputError(path, "a value times kbdf is not finite", accepted="numbers below 1e300")
    phi_s, values = circle(axes["phi_s"], values.swapaxes(2, 3), path, "phi")
    axes = {**axes, "phi_s": phi_s}
    phi_i, with_lay = axes.get("phi_i", np.zeros(1)), axes.get("phi_i", np.zeros(1)).size > 1
    if with_lay:
        axes["phi_i"], values = closed(phi_i, values, 0)
        kbdf = closed(phi_i, kbdf, 0)[1]
    names = (("phi_i",) if with_lay else ()) + ("theta_i", "theta_s", "phi_s")
    kinds: dict[str, Channels] = {"bw": "photopic", "rgb": "rgb", "spectral": "spectral"}
    return ReadTable(
        "specular",
        {name: axes[name] for name in names},
        values if with_lay else values[0],
        channels=kinds[content],
        wavelength=wavelength if content == "spectral" else None,
        declared_integral=kbdf if with_lay else kbdf[0],
        quantity="brdf" if unit == "luminance" else "brdf_cos",
        side="transmission" if "sigmat" in header or path.suffix.lower() == ".ddt" else "reflection",
        relative=relative,
        notes=("relative values, on the scale of kbdf",) if relative else (),
    )
