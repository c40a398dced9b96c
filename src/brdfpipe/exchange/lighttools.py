"""LightTools: tabular BSDF, text (``.bsdf``), distinguished from a Zemax file by its blocks ``AOI``.

Angles of scatter are counted about the normal. ``ScatterAzimuth`` is counted from the plane of incidence, whose source is at 90 and whose mirror direction at 270
degree. Each block has its ``AOI``, angle of incidence, and ``POI``, azimuth of the plane of incidence; ``TIS`` is the integral of the block.

References
----------
libbsdf (reader, 2026), which takes one ``POI`` per file.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import store
from brdfpipe.bsdf.one_side import Side
from brdfpipe.errors import InputError
from brdfpipe.exchange import gridded, number_text, records
from brdfpipe.exchange.azimuths import closed, from_source_at, with_source_at
from brdfpipe.exchange.read_table import Channels, ReadTable
from brdfpipe.exchange.registry import Format
from brdfpipe.exchange.text_lines import Lines
from brdfpipe.geometry import Array

FORMAT = Format(
    description="a table about the normal, for LightTools",
    files={
        "reflection": {"write": (".lighttools.bsdf",)},
        "transmission": {"write_transmission": (".transmission.lighttools.bsdf",)},
    },
    takes="grid",
    carries=("transmission", "lay", "colour"),
    options={"colour": False},
    read="read",
    begins=("\nAOI",),
)

_SIDES = {"brdf": "reflection", "btdf": "transmission"}
_TRISTIMULUS = ("TrisX", "TrisY", "TrisZ")
_SOURCE = 90.0
"""Azimuth of the source [degree]."""
_PHOTOPIC = 555.0
"""Wavelength that blocks weighted with V(λ) state [nm]: the maximum of V(λ)."""
_AZIMUTHS = "ScatterAzimuth is counted from the plane of incidence of each POI: the source is at 90, the mirror direction at 270 degree"
_MOST_VALUES = 40_000_000


def write(bsdf: xr.Dataset, path: Path, *, colour: bool = False, **grid: Any) -> records.Record:
    """Write the reflecting side.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    path : the file; it appears whole or not at all
    colour : X, Y and Z under D65 instead of one table weighted with V(λ) and D65
    grid : options of :func:`brdfpipe.exchange.gridded.gridded`

    Raises
    ------
    ExchangeError : an option is out of range.
    """
    return _write(bsdf, path, "reflection", colour, grid)


def write_transmission(bsdf: xr.Dataset, path: Path, *, colour: bool = False, **grid: Any) -> records.Record:
    """Write the light that passes a sheet from its front; as :func:`write`."""
    return _write(bsdf, path, "transmission", colour, grid)


def _write(bsdf: xr.Dataset, path: Path, side: Side, colour: bool, grid: Mapping[str, Any]) -> records.Record:
    seen = gridded.side_of(bsdf, side, path)
    channels = gridded.tristimulus(seen) if colour else gridded.photopic(seen)
    table = gridded.gridded(seen, "uniform", channels, **grid)
    record = records.record(table, FORMAT, bsdf)
    with store.atomic_path(path) as temporary, temporary.open("wb") as file:
        file.writelines(_header(table, [*records.sentences(record, records.VALUES[side]), _AZIMUTHS], colour))
        file.writelines(_data(table, side, colour))
        file.write(b"DataEnd\n")
    return record


def _header(table: gridded.Gridded, notes: list[str], colour: bool) -> Iterator[bytes]:
    yield "".join(f"# {note}\n" for note in notes).encode("ascii", "replace")
    symmetric = "phi_i" not in table.axes and table.axes["phi_o"][-1] <= 180
    yield f"Symmetry {'PlaneSymmetrical' if symmetric else 'Asymmetric'}\n".encode()
    yield f"SpectralContent {'XYZ' if colour else 'Monochrome'}\n".encode()
    azimuth, _ = with_source_at(_SOURCE, table.axes["phi_o"], np.zeros((1, table.axes["phi_o"].size)))
    for name, angles in (("ScatterAzimuth", azimuth), ("ScatterRadial", table.axes["theta_o"])):
        yield f"{name} {angles.size}\n{' '.join(f'{angle:g}' for angle in angles)}\n".encode()
    yield b"DataBegin\n"


def _data(table: gridded.Gridded, side: Side, colour: bool) -> Iterator[bytes]:
    """Blocks by incidence, its azimuth and colour; rows by azimuth."""
    with_lay = "phi_i" in table.axes
    scatter = "BRDF" if side == "reflection" else "BTDF"
    for theta_i, of_incidence, reflectance in table.blocks():
        for number, phi_i in enumerate(table.axes["phi_i"] if with_lay else np.zeros(1)):
            values, tis = (of_incidence[number], reflectance[number]) if with_lay else (of_incidence, reflectance)
            for channel, name in enumerate(_TRISTIMULUS if colour else ("",)):
                _, rows = with_source_at(_SOURCE, table.axes["phi_o"], np.maximum(values[..., channel], 0.0))
                head = f"AOI {theta_i:g}\nPOI {phi_i:g}\nSide Front\nWavelength {_PHOTOPIC:g}\nScatterType {scatter}\n"
                head += f"TristimulusValue {name}\n" if colour else ""
                yield f"{head}TIS {tis[channel]:.6f}\n".encode() + number_text.rows(rows.T, " ")


class _Block(NamedTuple):
    poi: float
    aoi: float
    wavelength: float
    tristimulus: int
    side: str


def read(path: Path) -> ReadTable:
    """Read the blocks of light that falls on the front: reflected, or in a file without such blocks transmitted.

    Raises InputError: the file contradicts itself, or is not of this format.
    """
    lines = Lines(path)
    header: dict[str, str] = {}
    axes: dict[str, Array] = {}
    while (line := lines.next("a line of the header or DataBegin")).lower() != "databegin":
        key, _, rest = " ".join(line.lower().split()).partition(" ")
        if key in ("scatterazimuth", "scatterradial"):
            count, _, begun = rest.partition(" ")
            axes[key] = lines.gathered(lines.count(count, 4000), key, begun)
        elif key in ("symmetry", "spectralcontent", "samplerotation", "angleofincidence"):
            header[key] = rest
        else:
            raise lines.error(
                "unknown word of the header", found=repr(key)[:40], accepted="Symmetry, …, ScatterRadial, DataBegin"
            )
    if len(axes) < 2:
        raise lines.error("the header has no angles of scatter", accepted="ScatterAzimuth and ScatterRadial")
    content = header.get("spectralcontent", "")
    if content not in ("monochrome", "xyz"):
        raise lines.error("unknown SpectralContent", found=repr(content)[:40], accepted="Monochrome, XYZ")
    blocks, tis, passed = _blocks(lines, axes["scatterazimuth"].size, axes["scatterradial"].size, content == "xyz")
    if not blocks:
        raise InputError(path, "no block of light that falls on the front", accepted="Side Front")
    side = "reflection" if any(block.side == "reflection" for block in blocks) else "transmission"
    chosen = {block: values for block, values in blocks.items() if block.side == side}
    passed += len(blocks) - len(chosen)
    notes = (f"{passed} blocks of the back, or of transmitted light, were not read",) if passed else ()
    return _table(path, axes, chosen, {block: tis[block] for block in chosen}, content == "xyz", notes)


def _blocks(
    lines: Lines, azimuths: int, radials: int, colour: bool
) -> tuple[dict[_Block, Array], dict[_Block, float], int]:
    """Values (azimuth, radial) and TIS of each block of the front's reflection, and the number of other blocks."""
    blocks: dict[_Block, Array] = {}
    tis: dict[_Block, float] = {}
    passed, words = 0, dict[str, str]()
    while (line := lines.next("a block or DataEnd")).lower() != "dataend":
        key, _, rest = " ".join(line.split()).partition(" ")
        key = key.lower()
        if key not in ("aoi", "poi", "side", "wavelength", "scattertype", "tristimulusvalue", "tis"):
            raise lines.error(
                "unknown word of a block", found=repr(key)[:40], accepted="AOI, POI, …, TIS and its values"
            )
        words[key] = rest
        if key != "tis":
            continue
        block = _block(lines, words, colour)
        share = lines.number(rest)
        values = lines.gathered(azimuths * radials, "values").reshape(azimuths, radials)
        if words.get("side", "Front").lower() != "front":
            passed += 1
        elif block in blocks:
            raise lines.error("a block appears twice", found=f"AOI {block.aoi:g}, POI {block.poi:g}")
        else:
            blocks[block], tis[block] = values, share
        if len(blocks) * azimuths * radials > _MOST_VALUES:
            raise lines.error("the table is too large", accepted=f"at most {_MOST_VALUES} values")
        words = {}
    return blocks, tis, passed


def _block(lines: Lines, words: dict[str, str], colour: bool) -> _Block:
    if "aoi" not in words:
        raise lines.error("a block has no AOI", accepted="AOI and an angle from 0 to 90")
    names = [name.lower() for name in _TRISTIMULUS]
    tristimulus = words.get("tristimulusvalue", "").lower()
    if colour and tristimulus not in names:
        raise lines.error("unknown TristimulusValue", found=repr(tristimulus)[:40], accepted=", ".join(_TRISTIMULUS))
    if (scatter := words.get("scattertype", "BRDF").lower()) not in _SIDES:
        raise lines.error("unknown ScatterType", found=repr(scatter)[:40], accepted="BRDF, BTDF")
    return _Block(
        lines.number(words.get("poi", "0")),
        lines.number(words["aoi"]),
        0.0 if colour else lines.number(words.get("wavelength", "0")),
        names.index(tristimulus) if colour else 0,
        _SIDES[scatter],
    )


def _table(
    path: Path,
    axes: dict[str, Array],
    blocks: dict[_Block, Array],
    declared: dict[_Block, float],
    colour: bool,
    notes: tuple[str, ...],
) -> ReadTable:
    poi, aoi, wavelength, tristimulus, (side, *_) = (sorted(set(column)) for column in zip(*blocks, strict=True))
    complete = len(poi) * len(aoi) * len(wavelength) * (3 if colour else 1)
    if len(blocks) != complete or not 0 <= aoi[0] <= aoi[-1] <= 90:
        found = f"{len(blocks)} blocks with AOI {aoi[0]:g} to {aoi[-1]:g}"
        raise InputError(path, "the blocks are no grid", found=found, accepted=f"{complete}, AOI 0 to 90")
    shape = len(poi), len(aoi), len(tristimulus) if colour else len(wavelength)
    values = np.empty((*shape[:2], axes["scatterradial"].size, axes["scatterazimuth"].size, shape[2]))
    tis = np.empty(shape)
    for block, of_block in blocks.items():
        channel = block.tristimulus if colour else wavelength.index(block.wavelength)
        at = poi.index(block.poi), aoi.index(block.aoi)
        values[*at, ..., channel], tis[*at, channel] = of_block.T, declared[block]
    phi_o, values = from_source_at(_SOURCE, axes["scatterazimuth"], values, path)
    ordered = {"theta_i": np.array(aoi), "theta_o": axes["scatterradial"], "phi_o": phi_o}
    if with_lay := len(poi) > 1:
        azimuth = np.array(poi)
        phi_i, values = closed(azimuth, values, 0)
        tis = closed(azimuth, tis, 0)[1]
        ordered = {"phi_i": phi_i, **ordered}
    spectral = not colour and len(wavelength) > 1
    channels: Channels = "xyz" if colour else "spectral" if spectral else "photopic"
    if not colour and not spectral and wavelength[0] not in (0.0, _PHOTOPIC):
        notes = (*notes, f"the values are those of {wavelength[0]:g} nm, and stand for all wavelengths")
    return ReadTable(
        "uniform",
        ordered,
        values if with_lay else values[0],
        channels=channels,
        wavelength=np.array(wavelength) if spectral else None,
        declared_integral=tis if with_lay else tis[0],
        side=side,
        notes=notes,
    )
