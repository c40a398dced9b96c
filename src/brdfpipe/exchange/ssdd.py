"""Surface scattering distribution data (``.ssdd``) of libbsdf and BSDFProcessor, version 0.3: text, or numbers in single precision.

A file has a block for reflected and one for transmitted light, and one each for light that is mirrored, or passes, into a single direction. Tables are about the mirror direction, the azimuth 0
towards the normal, and for transmitted light about the ray that goes straight on. The angle of incidence changes fastest.

References
----------
libbsdf, Surface scattering distribution data (SSDD) file format, version 0.3 (2026).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import store
from brdfpipe.bsdf.one_side import Side
from brdfpipe.bsdf.registry import representation
from brdfpipe.exchange import gridded, number_text, records, specular_shares, ssdd_blocks
from brdfpipe.exchange.read_table import ReadTable
from brdfpipe.exchange.registry import ExchangeError, Format
from brdfpipe.geometry import Array

FORMAT = Format(
    description="tables about the specular ray and mirrored shares, for BSDFProcessor and libbsdf",
    files={"reflection": {"write": (".ssdd",)}},
    takes="grid",
    carries=("transmission", "lay", "colour", "spectrum", "specular"),
    options={"colour": "bw", "binary": False},
    spectral={"colour": "spectral"},
    read="read",
)

_MODELS = {"bw": "monochrome", "xyz": "xyz", "spectral": "spectrum"}
_TYPES: Mapping[Side, tuple[str, str]] = {
    "reflection": ("brdf", "specular_reflectance"),
    "transmission": ("btdf", "specular_transmittance"),
}
_NEGLIGIBLE_SHARE = 1e-6


def write(bsdf: xr.Dataset, path: Path, *, colour: str = "bw", binary: bool = False, **grid: Any) -> records.Record:
    """Write both sides.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    path : the file; it appears whole or not at all
    colour : ``bw``, weighted with V(λ) and D65; ``xyz``, under D65, Y of a perfect white diffuser is 1/π; or ``spectral``, the wavelengths of the BSDF
    binary : numbers in single precision instead of text
    grid : options of :func:`brdfpipe.exchange.gridded.gridded`

    Raises
    ------
    ExchangeError : an option is out of range.
    """
    if colour not in _MODELS:
        raise ExchangeError(f"colour is {colour!r}; accepted: {', '.join(_MODELS)}")
    colour = "bw" if colour == "spectral" and "wavelength" not in bsdf.coords else colour
    sides: tuple[Side, ...] = ("reflection", "transmission") if representation(bsdf).is_slab else ("reflection",)
    tables = {side: _table(gridded.side_of(bsdf, side, path), colour, grid) for side in sides}
    found = {side: records.record(table, FORMAT, bsdf) for side, table in tables.items()}
    record = dict(found["reflection"])
    if "transmission" in found:
        record["error_of_transmission"] = found["transmission"]["error"]
        record["values"] += found["transmission"]["values"]
    with store.atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write(b"VERSION 0.3\nSOFTWARE brdfpipe\n")
        for side, table in tables.items():
            notes = records.sentences(found[side], records.VALUES[side])
            file.write(b"\n" + "".join(f"# {note}\n" for note in notes).encode("ascii", "replace"))
            file.writelines(_block(table, _TYPES[side][0], _MODELS[colour], binary))
        for side, table in tables.items():
            file.writelines(_single_directions(table, _TYPES[side][1], _MODELS[colour], binary))
    return record


def _table(bsdf: xr.Dataset, colour: str, grid: Mapping[str, Any]) -> gridded.Gridded:
    channels = gridded.photopic(bsdf)
    if colour == "xyz":
        channels = gridded.tristimulus(bsdf)
    elif colour == "spectral":
        channels = gridded.spectral(bsdf, bsdf["wavelength"].values)
    return gridded.gridded(bsdf, "specular", channels, **grid)


def _block(table: gridded.Gridded, kind: str, model: str, binary: bool) -> Iterator[bytes]:
    lay = {"PARAM1_LIST": table.axes["phi_i"]} if "phi_i" in table.axes else {}
    lists = {
        "PARAM0_LIST": table.axes["theta_i"],
        **lay,
        "PARAM2_LIST": table.axes["theta_s"],
        "PARAM3_LIST": table.axes["phi_s"],
    }
    reduction = "REDUCTION_TYPE bilateral_symmetry\n" if table.axes["phi_s"][-1] <= 180 else ""
    yield _head(table, kind, model, f"PARAM_TYPE specular_coordinate_system\n{reduction}", lists, binary)
    # (φ_s, θ_s, φ_i, θ_i, channels), in single precision because a spectral table may have many values.
    order = (3, 2, 1, 0, 4) if lay else (2, 1, 0, 3)
    shape = tuple(
        axis.size for axis in (table.axes["theta_i"], *lay.values(), table.axes["theta_s"], table.axes["phi_s"])
    )
    values = np.empty((*shape, table.channel_count), dtype=np.float32)
    for row in range(shape[0]):
        values[row] = np.maximum(table.block(row), 0.0)
    for around in values.transpose(order):
        yield _data(around.reshape(-1, values.shape[-1]), binary)


def _single_directions(table: gridded.Gridded, kind: str, model: str, binary: bool) -> Iterator[bytes]:
    """The share of light in a single direction; nothing where there is none."""
    azimuths = table.axes.get("phi_i", np.zeros(1))
    phi_i, theta_i = (angles.ravel() for angles in np.meshgrid(azimuths, specular_shares.INCIDENCES, indexing="ij"))
    share = representation(table.channels.source).specular(theta_i, phi_i, table.channels.wavelength)[0]
    # A share of 1 is that of a perfect white diffuser, of which the BSDF is 1/π.
    share = np.asarray(table.channels.convert(share / np.pi)) * np.pi
    if share.max() <= _NEGLIGIBLE_SHARE:
        return
    lists = {"PARAM0_LIST": specular_shares.INCIDENCES, **({"PARAM1_LIST": azimuths} if azimuths.size > 1 else {})}
    yield b"\n" + _head(table, kind, model, "", lists, binary)
    yield _data(np.maximum(share, 0.0).astype(np.float32), binary)


def _head(
    table: gridded.Gridded, kind: str, model: str, parameters: str, lists: Mapping[str, Array], binary: bool
) -> bytes:
    name = " ".join(str(table.bsdf.attrs.get("material", "unnamed")).split())
    lines = [f"DATA_TYPE {kind}", f"COLOR_MODEL {model}"]
    if table.channels.wavelength is not None:
        lines.append(f"WAVELENGTH_LIST {' '.join(f'{one:g}' for one in table.channels.wavelength)}")
    angles = [f"{entry} {' '.join(f'{angle:.7g}' for angle in values)}" for entry, values in lists.items()]
    end = [f"NAME {name}", "SOURCE_TYPE generated", f"DATA {'binary' if binary else 'ascii'}", ""]
    return ("\n".join(lines) + "\n" + parameters + "\n".join([*angles, *end])).encode("utf-8", "replace")


def _data(values: NDArray[np.float32], binary: bool) -> bytes:
    """Lines, or numbers, of one colour each."""
    return values.astype("<f4").tobytes() if binary else number_text.rows(values.astype(float), " ")


def read(path: Path) -> ReadTable:
    """Read the reflected light, or the transmitted light of a file without reflected light.

    Raises InputError: the file contradicts itself, or is not of this format.
    """
    return ssdd_blocks.read(path)
