"""Tensor trees of Radiance (``.xml``): means of the BSDF over cells of equal projected solid angle, finer where it changes.

Shirley and Chiu's map takes the disk of projected directions to a square, and rings about the normal to square rings. A tree of rank 4 divides both squares; one of rank 3,
of a surface without a lay, has the outgoing square, turned so that the mirror direction lies at azimuth 0, and (1 − sin θ_i)/2, of which Radiance uses the lower half. Each
branch halves all axes; of its number, bit i is that of axis i. The vector of incidence is taken reversed, so light that is mirrored, or goes straight on, is near the diagonal. Radiance takes
the value of a cell for all its directions.

References
----------
Shirley & Chiu 1997 (J. Graphics Tools 2 (3), 45); Ward et al. 2014, Lighting Res. Technol. 46, 271; Radiance (bsdf_t.c, 2026).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import store
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import FLOOR, Limits, TableError
from brdfpipe.errors import InputError
from brdfpipe.exchange import cell_means, gridded, records, window_xml
from brdfpipe.exchange.read_table import ReadTable
from brdfpipe.exchange.registry import Format
from brdfpipe.geometry import Array

FORMAT = Format(
    description="a tensor tree, cells that are finer where the BSDF changes, for Radiance",
    files={"reflection": {"write": (".tree.xml",)}},
    takes="grid",
    carries=("transmission", "lay"),
    read="read",
    begins=("TensorTree",),
)

_BASIS = "<AngleBasis>LBNL/Shirley-Chiu</AngleBasis>"
_DEPTHS = {3: range(3, 8), 4: range(3, 6)}
"""Halvings that are tried, of each rank."""
_DEEPEST = {3: 7, 4: 5}
"""Most halvings of a tree that is read: deeper ones have more values than a table takes."""
_COARSEST = 2.0
"""Largest difference of cells, relative to their mean, that are made one leaf to keep the size."""
_GAUSS = (0.5 - 0.5 / np.sqrt(3), 0.5 + 0.5 / np.sqrt(3))
_EDGE = 1e-3
"""Half of the polar angle in which a table that is read changes from ring to ring [degree]."""
_MOST_VALUES = 20_000_000

Brdf = Callable[[Array, Array, Array, Array], Array]
"""Luminous values of pairs of directions"""


@dataclass(frozen=True)
class _Tree:
    """Cells of the finest level, and where they are one leaf."""

    values: Array
    """(incident cells, outgoing, outgoing) or (incident, incident, outgoing, outgoing) [sr-1]; of rank 3 the upper half of the first axis is 0"""
    levels: list[NDArray[np.bool_]]
    """Whether a node is a leaf, from the root to the finest cells"""

    @property
    def rank(self) -> int:
        return self.values.ndim

    @property
    def leaves(self) -> int:
        """Number of values in the file."""
        count, above = 0, np.zeros((1,) * self.rank, dtype=bool)
        for level in self.levels:
            count += int((level & ~above).sum())
            above = _repeated(level | above, 2)
        return count


def write(bsdf: xr.Dataset, path: Path, *, tolerance: float, albedo_tolerance: float, largest: int) -> records.Record:
    """Write what light from above becomes: reflected, and behind a sheet transmitted.

    Parameters
    ----------
    bsdf : kind ``bsdf``
    path : the file; it appears whole or not at all
    tolerance, albedo_tolerance, largest : as of :func:`brdfpipe.exchange.gridded.gridded`; the depth is the least within the tolerances, or else that of the least error.
        Cells that differ by less than half of the tolerance from each other are one leaf; by more if the tree would be larger than ``largest``

    Raises
    ------
    ExchangeError : an option is out of range.
    """
    gridded.check_limits(tolerance, albedo_tolerance, largest, least=4096)
    model = representation(nonspectral(bsdf))

    def brdf(theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
        return model.evaluate(theta_i, phi_i, theta_o, phi_o, None)[..., 0]

    limits = Limits(tolerance, albedo_tolerance)
    sides = {name: passes for name, passes in window_xml.SIDES.items() if model.is_slab or not passes}
    rank, best = 3 if model.isotropic else 4, None
    for depth in _DEPTHS[rank]:
        if best is not None and len(sides) * 2 ** (depth * rank) > 8 * largest:
            break
        cells = {name: _means(brdf, depth, rank, passes) for name, passes in sides.items()}
        limit, trees = tolerance / 2, dict[str, _Tree]()
        while not trees or (limit < _COARSEST and sum(tree.leaves for tree in trees.values()) > largest):
            trees = {name: _merged(values, limit) for name, values in cells.items()}
            limit *= 2
        if best is not None and sum(tree.leaves for tree in trees.values()) > largest:
            break
        error = cell_means.table_error(
            bsdf, lambda *at, trees=trees: _lookup(trees, *at[:4]), transmission=model.is_slab
        )
        met = not limits.exceeded(error)
        if best is None or met or error.percentile_95 < best[1].percentile_95:
            best = trees, error
        if met:
            break
    assert best is not None
    trees, error = best
    size = sum(tree.leaves for tree in trees.values())
    record = records.record(_Written(bsdf, error, limits, size), FORMAT)
    blocks = {name: window_xml.Block(_BASIS, _text(tree).encode()) for name, tree in trees.items()}
    with store.atomic_path(path) as temporary, temporary.open("wb") as file:
        file.writelines(window_xml.document(record, f"TensorTree{rank}", "", blocks))
    return record


@dataclass(frozen=True)
class _Written:
    bsdf: xr.Dataset
    error: TableError
    limits: Limits
    size: int
    content: records.Content = "luminous"
    reading: str = "one value for each cell"


def square_of(theta: Array, phi: Array) -> tuple[Array, Array]:
    """Place of directions on the unit square, θ from the normal of their side [degree]."""
    radius, phi = np.sin(np.radians(theta)), (np.radians(phi) + np.pi / 4) % (2 * np.pi) - np.pi / 4
    quarter = np.minimum(((phi + np.pi / 4) / (np.pi / 2)).astype(int), 3)
    across = (phi - quarter * np.pi / 2) * radius / (np.pi / 4)
    a = np.choose(quarter, [radius, -across, -radius, across])
    b = np.choose(quarter, [across, radius, -across, -radius])
    return (a + 1) / 2, (b + 1) / 2


def directions_of(x: Array, y: Array) -> tuple[Array, Array]:
    """θ and φ [degree] of places on the unit square."""
    a, b = 2 * np.asarray(x) - 1, 2 * np.asarray(y) - 1
    radius = np.maximum(np.abs(a), np.abs(b))
    wide = np.abs(a) >= np.abs(b)
    ratio = np.where(wide, b, a) / np.where(radius > 0, np.where(wide, a, b), 1.0)
    phi = np.where(wide, 45 * ratio + np.where(a < 0, 180, 0), 90 - 45 * ratio + np.where(b < 0, 180, 0))
    return np.degrees(np.arcsin(np.minimum(radius, 1.0))), phi % 360


def _means(brdf: Brdf, depth: int, rank: int, passes: bool) -> Array:
    """Means over the cells of the finest level, by two Gauss-Legendre nodes along each axis."""
    count = 2**depth
    nodes = ((np.arange(count)[:, None] + _GAUSS) / count).ravel()
    theta_o, phi_o = directions_of(*np.meshgrid(nodes, nodes, indexing="ij"))
    theta_o = np.minimum(theta_o, 89.9)
    outgoing = 180 - theta_o if passes else theta_o

    def of_incidence(theta_i: float, phi_i: float) -> Array:
        values = brdf(np.full_like(outgoing, min(theta_i, 89.9)), np.full_like(outgoing, phi_i), outgoing, phi_o)
        return values.reshape(count, 2, count, 2).mean(axis=(1, 3))

    if rank == 3:
        theta = np.degrees(np.arcsin(1 - 2 * nodes[:count]))
        rows = np.stack([of_incidence(float(one), 180.0) for one in theta])
        return np.concatenate(
            [rows.reshape(count // 2, 2, count, count).mean(axis=1), np.zeros((count // 2, count, count))]
        )
    theta, phi = directions_of(*np.meshgrid(nodes, nodes, indexing="ij"))
    means = np.zeros((count, count, count, count))
    for row, column in np.ndindex(theta.shape):
        means[row // 2, column // 2] += of_incidence(float(theta[row, column]), float(phi[row, column]) + 180) / 4
    return means


def _merged(values: Array, limit: float) -> _Tree:
    """The tree whose leaves hold cells that differ by at most ``limit`` of their mean, with their mean."""
    low = high = values
    means, levels = [values], [np.ones(values.shape, dtype=bool)]
    while len(low) > 1:
        low, high = _halved(low, np.min), _halved(high, np.max)
        means.insert(0, _halved(means[0], np.mean))
        levels.insert(0, high - low <= limit * np.maximum(means[0], FLOOR))
    values, above = values.copy(), np.zeros((1,) * values.ndim, dtype=bool)
    for level, mean in zip(levels[:-1], means[:-1], strict=True):
        chosen, times = level & ~above, len(values) // len(level)
        np.copyto(values, _repeated(mean, times), where=_repeated(chosen, times))
        above = _repeated(level | above, 2)
    return _Tree(values, levels)


def _halved(values: Array, reduce: Any) -> Array:
    shape = [part for size in values.shape for part in (size // 2, 2)]
    return np.asarray(reduce(values.reshape(shape), axis=tuple(range(1, 2 * values.ndim, 2))))


def _lookup(trees: Mapping[str, _Tree], theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
    passes = theta_o > 90
    values = _read_at(trees["Reflection Back"].values, theta_i, phi_i, theta_o, phi_o)
    if "Transmission Back" in trees:
        behind = _read_at(trees["Transmission Back"].values, theta_i, phi_i, 180 - theta_o, phi_o)
        values = np.where(passes, behind, values)
    return values[:, None]


def _read_at(values: Array, theta_i: Array, phi_i: Array, theta_o: Array, phi_o: Array) -> Array:
    """What Radiance reads, polar angles from the normal of each side [degree]."""
    count, theta_o, places = values.shape[-1], np.minimum(theta_o, 90.0), tuple[Array, ...]()
    if values.ndim == 3:
        places = (
            np.minimum(0.5 - 0.5 * np.sin(np.radians(theta_i)), 0.5 - 1e-9),
            *square_of(theta_o, phi_o - phi_i - 180),
        )
    else:
        places = (*square_of(theta_i, phi_i + 180), *square_of(theta_o, phi_o))
    cells = [np.clip((place * count).astype(int), 0, count - 1) for place in places]
    return np.asarray(values[tuple(cells)])


def _text(tree: _Tree) -> str:
    """The tree in braces; branches by their number, in which bit i belongs to axis i."""
    rank, finest = tree.rank, tree.values.shape[-1]
    parts: list[str] = []

    def add(level: int, at: tuple[int, ...]) -> None:
        if tree.levels[level][at]:
            times = finest >> level
            parts.append(f"{{{tree.values[tuple(place * times for place in at)]:.5g}}}\n")
            return
        parts.append("{")
        for number in range(2**rank):
            below = tuple(2 * place + (number >> axis & 1) for axis, place in enumerate(at))
            add(level + 1, below)
        parts.append("}\n")

    add(0, (0,) * rank)
    return "".join(parts)


def read(path: Path) -> ReadTable:
    """Read what light from +Z becomes, of a tensor tree.

    Values are constant in the polar angles of a ring of the finest cells, and interpolated linearly in azimuth between their centres: both keep the light of each ring.

    Raises InputError: the file contradicts itself, or is not of this format.
    """
    layer = window_xml.layer(path)
    structure = window_xml.text(layer, "DataDefinition/IncidentDataStructure")
    if structure not in ("TensorTree3", "TensorTree4"):
        raise InputError(path, "not a tensor tree", found=repr(structure)[:40], accepted="TensorTree3, TensorTree4")
    blocks, notes = window_xml.from_above(path, layer)
    sides = {}
    for name, block in blocks.items():
        if (basis := window_xml.text(block, "AngleBasis")) != "LBNL/Shirley-Chiu":
            raise InputError(
                path, "unknown angle basis", where=name, found=repr(basis)[:40], accepted="LBNL/Shirley-Chiu"
            )
        sides[name] = _cells(path, window_xml.text(block, "ScatteringData"), int(structure[-1]), name)
    depth = max(values.shape[-1] for values in sides.values())
    sides = {name: _repeated(values, depth // values.shape[-1]) for name, values in sides.items()}
    return _table(path, sides, ("cells are constant in polar angle, and interpolated linearly in azimuth", *notes))


def _repeated(values: NDArray[Any], times: int) -> NDArray[Any]:
    for axis in range(values.ndim):
        values = np.repeat(values, times, axis=axis)
    return values


def _cells(path: Path, text: str, rank: int, name: str) -> Array:
    """All cells of the finest level of a tree."""
    # The cells of the deepest tree: a list of leaves would take many times their memory.
    finest = _DEEPEST[rank]
    cells = np.zeros((2**finest,) * rank)
    # Each open node: its place among the nodes of its level, and the number of the next branch.
    open_nodes: list[tuple[tuple[int, ...], int]] = []
    deepest, done = 0, False

    def refuse(problem: str, found: object, accepted: str = "nested braces of 2^rank branches") -> InputError:
        return InputError(path, problem, where=name, found=str(found)[:40], accepted=accepted)

    for token in re.finditer(r"\{|\}|[^{}]+", text):
        word = token[0].replace(",", " ").strip()
        if not word:
            continue
        if done:
            raise refuse("the tree goes on behind its end", word)
        if word == "{":
            if not open_nodes:
                open_nodes.append(((0,) * rank, 0))
                continue
            place, number = open_nodes[-1]
            if number >= 2**rank:
                raise refuse("a node has too many branches", f"level {len(open_nodes)}")
            if len(open_nodes) > finest:
                raise refuse("the tree is too deep", f"{len(open_nodes)} levels", f"at most {finest}")
            open_nodes[-1] = place, number + 1
            open_nodes.append((tuple(2 * one + (number >> axis & 1) for axis, one in enumerate(place)), 0))
        elif word == "}":
            if not open_nodes or open_nodes[-1][1] not in (-1, 2**rank):
                raise refuse("a brace closes no node", f"level {len(open_nodes)}")
            open_nodes.pop()
            done = not open_nodes
        else:
            if not open_nodes or open_nodes[-1][1] != 0:
                raise refuse("values stand outside a leaf", word)
            place, level = open_nodes[-1][0], len(open_nodes) - 1
            try:
                values = np.array(word.split(), dtype=float)
            except ValueError as error:
                raise refuse("not a number", error) from error
            side = round(values.size ** (1 / rank))
            if side**rank != values.size or side & (side - 1) or not (np.abs(values) < 1e30).all():
                raise refuse("a leaf has not 2^(rank k) finite values", f"{values.size} values")
            deepest = max(deepest, level + side.bit_length() - 1)
            if deepest > finest:
                raise refuse("the tree is too deep", f"{deepest} levels", f"at most {finest}")
            width = 2 ** (finest - level)
            block = _repeated(values.reshape((side,) * rank), width // side)
            cells[tuple(slice(one * width, (one + 1) * width) for one in place)] = block
            open_nodes[-1] = place, -1
    if not done:
        raise refuse("the tree ends early", f"{len(open_nodes)} open braces")
    return cells[(slice(None, None, 2 ** (finest - max(deepest, 1))),) * rank].copy()


def _table(path: Path, sides: Mapping[str, Array], notes: tuple[str, ...]) -> ReadTable:
    first = sides["Reflection Back"]
    half, rank = first.shape[-1] // 2, first.ndim
    # Twice as many azimuths as the widest ring has cells keep the light of narrow lobes.
    around = np.linspace(0.0, 360.0, 16 * half + 1)
    turns = np.linspace(0.0, 360.0, min(4 * half, 48) + 1)[: None if rank == 4 else 1]
    if (2 * half) ** 2 * around.size * turns.size * len(sides) > _MOST_VALUES:
        raise InputError(
            path, "the tree is too fine", found=f"{2 * half} cells along an axis", accepted="128, with a lay 16"
        )
    middles = np.degrees(np.arcsin((np.arange(half) + 0.5) / half))
    parts = []
    for name, passes in window_xml.SIDES.items():
        if name in sides:
            block = np.empty((turns.size, half, half, around.size))
            for (turn, phi_i), (row, theta_i) in ((t, r) for t in enumerate(turns) for r in enumerate(middles)):
                for ring in range(half):
                    block[turn, row, ring] = _on_ring(sides[name], theta_i, phi_i, ring, around)
            block = np.repeat(np.repeat(block, 2, axis=1), 2, axis=2)
            parts.append(block[:, :, ::-1] if passes else block)
    bounds = np.degrees(np.arcsin(np.arange(1, half) / half))
    polar = np.concatenate([[0.0], np.repeat(bounds, 2) + np.tile([-_EDGE, _EDGE], half - 1), [90.0]])
    below = np.concatenate([[90.0 + _EDGE], 180 - polar[-2::-1]])
    axes = {"theta_i": polar, "theta_o": np.concatenate([polar, below]) if len(parts) == 2 else polar, "phi_o": around}
    values = np.concatenate(parts, axis=2)[..., None]
    if rank == 4:
        return ReadTable("uniform", {"phi_i": turns, **axes}, values, notes=notes)
    return ReadTable("uniform", axes, values[0], notes=notes)


def _on_ring(values: Array, theta_i: float, phi_i: float, ring: int, around: Array) -> Array:
    """Values of an outgoing ring at azimuths relative to the incidence [degree], linear between the centres of its cells."""
    half, count = values.shape[-1] // 2, 8 * ring + 4
    centres = 360 * (np.arange(count) + 0.5) / count
    theta_o = np.full(count, np.degrees(np.arcsin((ring + 0.5) / half)))
    # Cells of rank 3 are counted from the mirror direction.
    shift = phi_i + 180 if values.ndim == 3 else 0.0
    of_cells = _read_at(values, np.full(count, theta_i), np.full(count, phi_i), theta_o, centres + shift)
    return np.interp(around + phi_i, centres + shift, of_cells, period=360)
