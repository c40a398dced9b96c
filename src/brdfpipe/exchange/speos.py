"""Ansys Speos: anisotropic BSDF, text (``.anisotropicbsdf``).

Blocks by anisotropy angle and incidence hold values that are proportional to the BRDF, without wavelength. The reflectance of one incidence, by wavelength and in
percent, gives the scale of all of them. The anisotropy angle is that of the plane of incidence from the anisotropy vector of the file.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe import store
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import rules
from brdfpipe.exchange import gridded, records, speos_text
from brdfpipe.exchange.azimuths import closed, from_source_at
from brdfpipe.exchange.read_table import ReadTable
from brdfpipe.exchange.registry import Format
from brdfpipe.exchange.text_lines import Lines
from brdfpipe.geometry import Array

FORMAT = Format(
    description="a table about the normal and one spectrum for all directions, for Ansys Speos",
    files={"reflection": {"write": (".anisotropicbsdf",)}},
    takes="grid",
    carries=("lay",),
    read="read",
    begins=("\nOPTIS",),
)

_KIND = "Anisotropic BSDF"
_RANGE = (350.0, 850.0)
"""Wavelengths between which a reflectance without wavelength holds [nm]."""
_VALUES = "BRDF in sr-1, not multiplied by the cosine, weighted with V(lambda) and D65; the spectrum is that of the first incidence"


def write(bsdf: xr.Dataset, path: Path, **grid: Any) -> records.Record:
    """Write the reflecting side.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    path : the file; it appears whole or not at all
    grid : options of :func:`brdfpipe.exchange.gridded.gridded`

    Raises
    ------
    ExchangeError : an option is out of range.
    """
    seen = gridded.side_of(bsdf, "reflection", path)
    table = gridded.gridded(seen, "uniform", gridded.photopic(seen), **grid)
    record = records.record(table, FORMAT, bsdf)
    if "spectrum" in record["left_out"]:
        record["left_out"]["spectrum"] = (
            "the spectrum by direction: one spectrum, that of the first incidence, holds for all"
        )
    blocks = [of_incidence if "phi_i" in table.axes else of_incidence[None] for _, of_incidence, _ in table.blocks()]
    with store.atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write(speos_text.title(_KIND, records.sentences(record, _VALUES)).encode())
        file.writelines(_header(table, blocks[0]))
        for azimuth in range(blocks[0].shape[0]):
            file.writelines(speos_text.block(table, values[azimuth, ..., 0]) for values in blocks)
        file.write(b"End of file\n")
    return record


def _header(table: gridded.Gridded, first: Array) -> Iterator[bytes]:
    rotations, theta_i = table.axes.get("phi_i", np.zeros(1)), table.axes["theta_i"]
    # From the vector −x, X of the light's own direction, opposite to its source, is at φ_i.
    yield f"-1\t0\t0\n1\t0\n1\n{rotations.size}\n".encode()
    yield ("\t".join(f"{angle:g}" for angle in rotations) + "\n").encode()
    listed = "\t".join(f"{angle:g}" for angle in theta_i)
    yield f"{theta_i.size}\n{listed}\n".encode() * rotations.size
    wavelength, share = _spectrum(table, first)
    yield f"{theta_i[0]:g}\t{rotations[0]:g}\nreflectance of this incidence\n{wavelength.size}\n".encode()
    for one, reflectance in zip(wavelength, share, strict=True):
        yield f"{one:g}\t{speos_text.percent(reflectance)}\n".encode()


def _spectrum(table: gridded.Gridded, first: Array) -> tuple[Array, Array]:
    """Wavelength [nm] and reflectance of the first incidence; the table's own integral is its mean weighted with V(λ) and D65."""
    theta_i = float(table.axes["theta_i"][0])
    phi_i = float(table.axes["phi_i"][0]) if "phi_i" in table.axes else 0.0
    own = float(table.integral(theta_i, first if "phi_i" in table.axes else first[0]).ravel()[0])
    if "wavelength" not in table.bsdf.coords:
        return np.array(_RANGE), np.array([own, own])
    rule = rules(table.bsdf, theta_i, phi_i)[0]
    at = np.full_like(rule.theta, theta_i), np.full_like(rule.theta, phi_i), rule.theta, rule.phi
    spectrum = rule.weight @ representation(table.bsdf).evaluate(*at, None)
    mean = float(rule.weight @ representation(table.channels.source).evaluate(*at, None)[:, 0])
    return table.bsdf["wavelength"].values, spectrum * (own / mean if mean > 0 else 1.0)


def read(path: Path) -> ReadTable:
    """Read the reflecting side.

    Raises InputError: the file contradicts itself, or is not of this format.
    """
    lines = speos_text.after_title(path, _KIND)
    lines.numbers(3, "components of the anisotropy vector")
    transmits, quantity = speos_text.read_flags(lines)
    phi_i, theta_i = _incidences(lines)
    if transmits:
        _incidences(lines)
    measured, wavelength, share = _read_spectrum(lines)
    if transmits:
        _read_spectrum(lines)
    axes: dict[str, Array] = {}
    blocks = []
    for _ in range(phi_i.size * theta_i.size):
        blocks.append(speos_text.read_block(lines, axes))
        speos_text.check_size(lines, phi_i.size * theta_i.size, blocks[0].size, wavelength.size)
    values = np.array(blocks).reshape(phi_i.size, theta_i.size, *blocks[0].shape, 1)
    notes = ["the transmitted light was not read"] if transmits else []
    if not transmits:
        lines.expect("End of file")
    phi_o, values = from_source_at(speos_text.SOURCE, axes["phi"], values, path)
    row, rotation = (int(np.abs(angles - at).argmin()) for angles, at in ((theta_i, measured[0]), (phi_i, measured[1])))
    if theta_i[row] != measured[0]:
        notes.append(
            f"the reflectance is that of {measured[0]:g} degree; it was taken for the incidence {theta_i[row]:g}"
        )
    neutral = bool((share == share[0]).all())
    declared = np.full((phi_i.size, theta_i.size, 1 if neutral else share.size), np.nan)
    declared[rotation, row] = share[:1] if neutral else share
    values = values if neutral else np.repeat(values, share.size, axis=-1)
    ordered = {"theta_i": theta_i, "theta_o": axes["theta"], "phi_o": phi_o}
    if with_lay := phi_i.size > 1:
        azimuth, values = closed(phi_i, values, 0)
        declared = closed(phi_i, declared, 0)[1]
        ordered = {"phi_i": azimuth, **ordered}
    return ReadTable(
        "uniform",
        ordered,
        values if with_lay else values[0],
        channels="photopic" if neutral else "spectral",
        wavelength=None if neutral else wavelength,
        declared_integral=declared if with_lay else declared[0],
        quantity=quantity,
        relative=True,
        notes=(f"values on the scale of the reflectance at {measured[0]:g} degree", *notes),
    )


def _incidences(lines: Lines) -> tuple[Array, Array]:
    """Anisotropy angles, and the incidences that they have in common."""
    rotations = lines.numbers(lines.count(lines.next("the number of anisotropy angles"), 4000), "anisotropy angles")
    common: Array | None = None
    for _ in rotations:
        incidences = lines.numbers(lines.count(lines.next("the number of incidences"), 4000), "incidences")
        if common is not None and not np.array_equal(common, incidences):
            raise lines.error("the incidences of the anisotropy angles differ", accepted="the same incidences")
        common = incidences
    assert common is not None
    if common.min() < 0 or common.max() > 90:
        raise lines.error("an incidence is out of range", found=f"{common.max():g}", accepted="0 to 90")
    return rotations, common


def _read_spectrum(lines: Lines) -> tuple[Array, Array, Array]:
    """Incidence and azimuth at which it was measured, wavelength [nm] and reflectance [1]."""
    measured = lines.numbers(2, "angles of the spectrum")
    count = lines.next("the number of wavelengths")
    if not count.isdecimal():
        # The spectrum may have a description.
        count = lines.next("the number of wavelengths")
    rows = np.array([lines.numbers(2, "wavelength and percent") for _ in range(lines.count(count, 4000))])
    wavelength, share = rows[:, 0], rows[:, 1] / 100
    if wavelength[0] <= 0 or not (np.diff(wavelength) > 0).all():
        raise lines.error("the wavelengths do not increase", found=f"{wavelength[0]:g} to {wavelength[-1]:g}")
    if share.min() < 0:
        raise lines.error("a percentage is negative", found=f"{100 * share.min():g}", accepted="0 and more")
    return measured, wavelength, share
