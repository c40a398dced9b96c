"""Klems matrices of LBNL WINDOW and Radiance (``.xml``): means of the BSDF over 145 × 145 pairs of patches of the hemispheres.

Patches are rings of polar angle, each of equal parts in azimuth of which the first is centred at 0. A column belongs to the patch of incidence and a row to that of
the outgoing light; the vector of patch j on the side of incidence is (−x, −y, z) of outgoing patch j, so the mirror direction of each patch has the
same number. Radiance names the sides in reverse of WINDOW: light from +Z that is reflected is ``Reflection Back``, and that passes is ``Transmission Back``.
Radiance takes the value of a patch for all its directions.

References
----------
WINDOW 6 BSDF schema 1.4; Radiance (bsdf_m.c, 2026); Klems 1994, ASHRAE Trans. 100 (1), 1065.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import store
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_nodes import TOLERANCE
from brdfpipe.errors import InputError
from brdfpipe.exchange import cell_means, number_text, records, window_xml
from brdfpipe.exchange.read_table import ReadTable
from brdfpipe.exchange.registry import Format
from brdfpipe.geometry import Array

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

FORMAT = Format(
    description="Klems matrices of 145 patches, for Radiance and LBNL WINDOW",
    files={"reflection": {"write": (".klems.xml",)}},
    takes="cells",
    carries=("transmission", "lay"),
    read="read",
    begins=("Columns", "Rows"),
)

BOUNDS = np.array([0.0, 5, 15, 25, 35, 45, 55, 65, 75, 90])
"""Polar angles between the rings [degree]"""
RING = np.array([1, 8, 16, 20, 24, 24, 24, 16, 12])
"""Patches of each ring"""
PATCHES = 145
_CENTRES = np.array([0.0, 10, 20, 30, 40, 50, 60, 70, 82.5])
_FIRST = np.concatenate([[0], np.cumsum(RING)[:-1]])
_STEP = 0.75
"""Steps of azimuth that fill the patches of every ring, and lie at their centres [degree]"""
_STEP_WIDTH = 1e-3
"""Half of the polar angle in which a table that is read changes from ring to ring [degree]."""
_WITHIN_PATCHES = (
    f"detail within the {PATCHES} patches of 5 to 15 degree, which the format fixes: they limit the error, and no option reduces it. The light of each pair "
    "of patches is kept; where a lobe falls off the mean of a patch is a multiple of the BSDF, so errors exceed 100%, and one value stands for all "
    "incidences from 75 to 90 degree. A tensor tree has finer cells"
)
_BASIS = "LBNL/Klems Full"
Brdf = Callable[[Array, Array, Array, Array], Array]
"""Luminous values of pairs of directions"""


def write(bsdf: xr.Dataset, path: Path) -> records.Record:
    """Write what light from above becomes: reflected, and behind a sheet transmitted.

    Means over patches are weighted with the projected solid angle, so that the reflectance is kept. A sheet is lit from above alone;
    programs derive the transmission of the other direction by reciprocity.
    """
    model = representation(nonspectral(bsdf))

    def brdf(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        return model.evaluate(theta_i, phi_i, theta_o, phi_o, None)[..., 0]

    sides = {name: passes for name, passes in window_xml.SIDES.items() if model.is_slab or not passes}
    means = {name: _means(brdf, passes, model.isotropic) for name, passes in sides.items()}
    error = cell_means.table_error(bsdf, lambda *at: _lookup(means, *at[:4]), transmission=model.is_slab)
    stacked = np.stack(list(means.values()))[..., None]
    record = records.record(cell_means.CellTable(bsdf, stacked, error, "one value for each patch"), FORMAT)
    if error.percentile_95 > TOLERANCE:
        record["left_out"]["resolution"] = _WITHIN_PATCHES
    blocks = {
        name: window_xml.Block(
            f"<ColumnAngleBasis>{_BASIS}</ColumnAngleBasis><RowAngleBasis>{_BASIS}</RowAngleBasis>",
            number_text.rows(np.maximum(values, 0.0), separator=" "),
        )
        for name, values in means.items()
    }
    with store.atomic_path(path) as temporary, temporary.open("wb") as file:
        file.writelines(window_xml.document(record, "Columns", _basis(), blocks))
    return record


def patch(theta: Array, phi: Array) -> NDArray[np.intp]:
    """Number of the patch of outgoing directions above the surface [degree]; of incident ones with φ + 180."""
    ring = np.clip(np.searchsorted(BOUNDS, theta, side="right") - 1, 0, RING.size - 1)
    return _FIRST[ring] + np.rint(phi / 360 * RING[ring]).astype(np.intp) % RING[ring]


def _lookup(means: Mapping[str, Array], theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
    column, passes = patch(theta_i, phi_i + 180), theta_o > 90
    row = patch(np.where(passes, 180 - theta_o, theta_o), phi_o)
    values = means["Reflection Back"][row, column]
    if "Transmission Back" in means:
        values = np.where(passes, means["Transmission Back"][row, column], values)
    return values[:, None]


def _means(brdf: Brdf, passes: bool, isotropic: bool) -> Array:
    """Means over the patches, (outgoing, incident) [sr-1], weighted with the projected solid angle."""
    return _isotropic_means(brdf, passes) if isotropic else _means_with_lay(brdf, passes)


def _rings(nodes: int) -> tuple[Array, Array]:
    """Polar angles within each ring (rings, nodes) [degree], and their shares of its projected solid angle (nodes,)."""
    at, weight = np.polynomial.legendre.leggauss(nodes)
    low, high = np.sin(np.radians(BOUNDS[:-1])) ** 2, np.sin(np.radians(BOUNDS[1:])) ** 2
    squared = low[:, None] + (high - low)[:, None] * (at + 1) / 2
    return np.degrees(np.arcsin(np.sqrt(squared))), weight / 2


def _isotropic_means(brdf: Brdf, passes: bool) -> Array:
    """Each pair of rings depends on the difference of azimuths alone: its mean over both patches is a convolution."""
    nodes, weight = _rings(8)
    around = np.arange(0.0, 360.0, _STEP)
    means = np.empty((PATCHES, PATCHES))
    for ring, incident in enumerate(nodes):
        theta_i, theta_o, phi = np.meshgrid(incident, nodes.ravel(), around, indexing="ij")
        values = brdf(theta_i, np.zeros_like(phi), 180 - theta_o if passes else theta_o, phi)
        by_ring = np.einsum("ioqa,i,q->oa", values.reshape(weight.size, *nodes.shape, around.size), weight, weight)
        for other, line in enumerate(by_ring):
            smooth = _averaged(line, around.size // RING[ring], around.size // RING[other])
            columns, rows = np.arange(RING[ring]), np.arange(RING[other])
            # The incident vector of patch j lies at the azimuth of outgoing patch j and 180.
            turn = rows[:, None] / RING[other] - columns / RING[ring] - 0.5
            at = np.rint(turn * around.size).astype(int) % around.size
            means[_FIRST[other] + rows[:, None], _FIRST[ring] + columns] = smooth[at]
    return means


def _averaged(line: Array, length: int, other: int) -> Array:
    """Mean of a periodic line over ``length`` steps of one azimuth and ``other`` of the second, both even, about each difference."""
    transformed = np.fft.rfft(line)
    # The middles of steps lie half a step off the centre of an even number: once before it and once behind.
    for count, first in ((length, -(length // 2)), (other, 1 - other // 2)):
        box = np.zeros(line.size)
        box[:count] = 1 / count
        transformed *= np.fft.rfft(np.roll(box, first))
    return np.fft.irfft(transformed, line.size)


def _means_with_lay(brdf: Brdf, passes: bool) -> Array:
    incident, share = _rings(2)
    outgoing, weight = _rings(4)
    around = np.arange(_STEP / 2, 360.0, _STEP)
    turns = np.array([-0.375, -0.125, 0.125, 0.375])
    means = np.empty((PATCHES, PATCHES))
    for column in range(PATCHES):
        ring = int(np.searchsorted(_FIRST, column, side="right")) - 1
        azimuths = 360 * ((column - _FIRST[ring] + turns) / RING[ring] + 0.5)
        theta_i, phi_i, theta_o, phi = np.meshgrid(incident[ring], azimuths, outgoing.ravel(), around, indexing="ij")
        values = brdf(theta_i, phi_i, 180 - theta_o if passes else theta_o, phi).mean(axis=1)
        by_ring = np.einsum("ioqa,i,q->oa", values.reshape(2, *outgoing.shape, around.size), share, weight)
        for other, line in enumerate(by_ring):
            bins = np.rint(around / 360 * RING[other]).astype(int) % RING[other]
            sums = np.bincount(bins, line, RING[other]) / np.bincount(bins, minlength=RING[other])
            means[_FIRST[other] : _FIRST[other] + RING[other], column] = sums
    return means


def _basis() -> str:
    blocks = "".join(
        f"<AngleBasisBlock><Theta>{centre:g}</Theta><nPhis>{count}</nPhis><ThetaBounds><LowerTheta>{low:g}</LowerTheta>"
        f"<UpperTheta>{high:g}</UpperTheta></ThetaBounds></AngleBasisBlock>\n"
        for centre, count, low, high in zip(_CENTRES, RING, BOUNDS[:-1], BOUNDS[1:], strict=True)
    )
    return f"<AngleBasis><AngleBasisName>{_BASIS}</AngleBasisName>\n{blocks}</AngleBasis>"


def read(path: Path) -> ReadTable:
    """Read what light from +Z becomes, of a file with the full Klems basis.

    Values are constant in the polar angles of a ring, and interpolated linearly in azimuth between the centres of its patches: both keep the light of each ring.

    Raises InputError: the file contradicts itself, or is not of this format.
    """
    layer = window_xml.layer(path)
    structure = window_xml.text(layer, "DataDefinition/IncidentDataStructure")
    if structure not in ("Columns", "Rows"):
        found = repr(structure)[:40]
        raise InputError(path, "the data are not Klems matrices", found=found, accepted="Columns, Rows")
    blocks, notes = window_xml.from_above(path, layer)
    means = {name: _matrix(path, block, name) for name, block in blocks.items()}
    if structure == "Rows":
        means = {name: values.T for name, values in means.items()}
    return _table(means, ("patches are constant in polar angle, and interpolated linearly in azimuth", *notes))


def _matrix(path: Path, block: Element, name: str) -> Array:
    for side in ("ColumnAngleBasis", "RowAngleBasis"):
        if (basis := window_xml.text(block, side)) != _BASIS:
            raise InputError(path, "unknown angle basis", where=name, found=repr(basis)[:40], accepted=_BASIS)
    words = window_xml.text(block, "ScatteringData").replace(",", " ").split()
    if len(words) != PATCHES**2:
        found = f"{len(words)} numbers"
        raise InputError(path, "wrong number of values", where=name, found=found, accepted=f"{PATCHES**2}")
    try:
        values = np.array(words, dtype=float)
    except ValueError as error:
        raise InputError(path, "not a number", where=name, found=str(error)[-40:], accepted="numbers") from error
    if not (np.abs(values) < 1e30).all():
        raise InputError(path, "a value is not finite", where=name, found=f"{values[~(np.abs(values) < 1e30)][0]:g}")
    return values.reshape(PATCHES, PATCHES)


def _table(means: Mapping[str, Array], notes: tuple[str, ...]) -> ReadTable:
    """A table that is constant in the polar angles of a ring, and linear in azimuth between the centres of its patches.

    Both keep the light of a ring. Azimuths of incidence are those of the finest ring; the steps of the relative azimuth fit all rings but that of 16 patches, which keeps its
    light to 0.5 %.
    """
    azimuths, relative = np.arange(0.0, 361.0, 15.0), np.arange(0.0, 361.0, 3.0)
    parts = []
    for name, passes in window_xml.SIDES.items():
        if name in means:
            # (θ_i, φ_i, outgoing patch) and then (θ_i, φ_i, θ_o, φ_o relative to φ_i)
            columns = np.stack([_around(means[name].T, ring, azimuths + 180) for ring in range(RING.size)])
            turned = [
                np.stack([_around(columns[:, k].T, ring, relative + phi) for ring in range(RING.size)])
                for k, phi in enumerate(azimuths)
            ]
            values = np.repeat(np.moveaxis(np.stack(turned), -1, 0), 2, axis=2)
            parts.append(values[:, :, ::-1] if passes else values)
    polar = np.concatenate(
        [[0.0], np.repeat(BOUNDS[1:-1], 2) + np.tile([-_STEP_WIDTH, _STEP_WIDTH], RING.size - 1), [90.0]]
    )
    below = np.concatenate([[90.0 + _STEP_WIDTH], 180 - polar[-2::-1]])
    axes = {
        "phi_i": azimuths,
        "theta_i": polar,
        "theta_o": np.concatenate([polar, below]) if len(parts) == 2 else polar,
        "phi_o": relative,
    }
    values = np.repeat(np.concatenate(parts, axis=2).swapaxes(0, 1), 2, axis=1)[..., None]
    return ReadTable("uniform", axes, values, notes=notes)


def _around(values: Array, ring: int, azimuths: Array) -> Array:
    """Values (patches, …) of a ring at azimuths [degree], linear between its patches."""
    of_ring, count = values[_FIRST[ring] : _FIRST[ring] + RING[ring]], int(RING[ring])
    place = azimuths / 360 * count
    below = np.floor(place).astype(int)
    part = (place - below).reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray((1 - part) * of_ring[below % count] + part * of_ring[(below + 1) % count])
