"""What changed between the results of two builds, for each material: colour, gloss, BRDF, quantities, verdict, and the causes."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from brdfpipe import store
from brdfpipe.errors import BrdfpipeError, abbreviated
from brdfpipe.releases.causes import Cause, causes
from brdfpipe.releases.provenance import of_material

UNCHANGED, CHANGED, ADDED, REMOVED = "unchanged", "changed", "added", "removed"

_HEMISPHERE = {"hemisphere": {"theta_i": [0, 75], "phi_i": [0, 360]}, "side": "both"}
_DIRECTIONS = 512
"""Pairs of directions at which two BRDFs of a material are compared; their rms is certain to some percent of itself."""
_SAME = 1e-9
"""Relative difference of quantities that is no change."""


@dataclass(frozen=True)
class Difference:
    """What changed for one material of one scene."""

    material: str
    scene: str
    """Empty for the default scene."""
    status: str
    """:data:`CHANGED`, :data:`ADDED`, :data:`REMOVED` or :data:`UNCHANGED` (then nothing else is set)."""
    built: tuple[bool, bool] = (True, True)
    """Whether the material could be built, before and now."""
    failure: str = ""
    """Why it could not be built now, where the reason is new."""
    colour: float | None = None
    """Difference of the colours in the table of the catalogue, ΔE00; None where one release has none."""
    brdf: Mapping[str, float] = field(default_factory=dict)
    """``rms`` and ``percentile_95`` of the relative difference of BRDF·cos θ_o, ``albedo`` of that of the directional reflectance [1]."""
    quantities: Mapping[str, tuple[float | None, float | None]] = field(default_factory=dict)
    """Column of the catalogue's table → value before and now, of those that differ; None where there is none."""
    verdict: tuple[str, str] = ("", "")
    causes: tuple[Cause, ...] = ()
    problem: str = ""
    """Why the BRDFs or the causes could not be compared."""


def differences(old: Releases, new: Releases) -> list[Difference]:
    """What changed between two builds.

    Parameters
    ----------
    old, new : results of ``brdfpipe build``, as :func:`read_releases` reads them

    Returns
    -------
    One entry for each material of each scene, in the order of scenes and names, unchanged ones included

    Raises
    ------
    BrdfpipeError : the two have no scene in common.
    """
    if not old.keys() & new.keys():
        words = [f"{_folder(one)} has {', '.join(scene or 'catalogue' for scene in one)}" for one in (old, new)]
        raise BrdfpipeError(f"no scene in common: {'; '.join(words)}; build the same scene")
    return [difference for scene in new if scene in old for difference in _of_scene(old[scene], new[scene])]


def read_releases(results: Path) -> Releases:
    """The results of a build by scene, the default one first.

    Raises BrdfpipeError: there are none, or a table is damaged, or of earlier results.
    """
    return {scene: Release(results, scene) for scene in scene_folders(results)}


def scene_folders(results: Path) -> list[str]:
    """Folders of the scenes in relation to the results, the default one first, as ``""``. Raises BrdfpipeError: there are none."""
    tables = [results / "catalogue.nc", *sorted((results / "scenes").glob("*/catalogue.nc"))]
    folders = [table.parent.relative_to(results) for table in tables if table.is_file()]
    if not folders:
        raise BrdfpipeError(f"{results}: no results of a catalogue; give the folder that `brdfpipe build` wrote")
    return ["" if folder == Path() else str(folder) for folder in folders]


class Release:
    """The results of one scene of one build."""

    def __init__(self, results: Path, scene_folder: str) -> None:
        self.results, self.scene_folder = results, scene_folder
        folder = results / scene_folder
        table = store.open_dataset(folder / "catalogue.nc", "catalogue")
        names = [str(name) for name in table["material"].values]
        self.rows = {name: table.isel(material=row) for row, name in enumerate(names)}
        self.failures: dict[str, str] = {}
        try:
            with (folder / "catalogue.csv").open(encoding="utf-8", newline="") as lines:
                for line in csv.DictReader(lines):
                    if line["status"] == "failed":
                        self.failures[line["material"]] = f"{line['stage']}: {line['message']}"
        except (KeyError, ValueError, csv.Error) as error:
            raise BrdfpipeError(f"{folder / 'catalogue.csv'}: damaged; run `brdfpipe build`") from error
        if later := sorted(name for name in self.rows if self._was_built_later(name)):
            raise BrdfpipeError(
                f"{folder}: {abbreviated(later, 5)} built again after the table of the catalogue, which a build of some materials alone does "
                "not make; run `brdfpipe build` without names"
            )

    @property
    def names(self) -> set[str]:
        return self.rows.keys() | self.failures.keys()

    def _was_built_later(self, name: str) -> bool:
        """Whether the results of a material are not those of the table."""
        folder = self.results / self.scene_folder
        summary = folder / name / "summary.nc"
        # Times tell where reading is worthwhile; after a copy they may be in any order.
        if not summary.is_file() or summary.stat().st_mtime_ns <= (folder / "catalogue.nc").stat().st_mtime_ns:
            return False
        try:
            row = store.open_dataset(summary)
        except BrdfpipeError:  # `brdfpipe verify` finds damage
            return False
        return "digests" in row and json.loads(row["digests"].values.item()) != self.digests(name)

    def digests(self, name: str) -> Any:
        return json.loads(str(self.rows[name]["digests"].values))

    def bsdf(self, name: str) -> Path:
        own = self.results / self.scene_folder / name / "bsdf.nc"
        return own if own.is_file() else self.results / name / "bsdf.nc"


Releases = Mapping[str, Release]
"""The results of one build: folder of a scene → its results."""


def _folder(releases: Releases) -> Path:
    return next(iter(releases.values())).results


def _of_scene(old: Release, new: Release) -> Iterator[Difference]:
    from tqdm import tqdm

    scene = Path(new.scene_folder).name
    for name in tqdm(sorted(old.names | new.names), unit="material", delay=2.0, disable=None, leave=False):
        built = (name in old.rows, name in new.rows)
        failure = new.failures.get(name, "")
        if name not in new.names:
            yield Difference(name, scene, REMOVED, built)
        elif name not in old.names:
            yield Difference(name, scene, ADDED, built, failure)
        elif not all(built):
            same = built == (False, False) and failure == old.failures[name]
            yield Difference(name, scene, UNCHANGED if same else CHANGED, built, failure)
        elif old.digests(name) == new.digests(name):
            yield Difference(name, scene, UNCHANGED)
        else:
            yield _of_material(name, scene, old, new)


def _of_material(name: str, scene: str, old: Release, new: Release) -> Difference:
    before, after = old.rows[name], new.rows[name]
    brdf: dict[str, float] = {}
    found: tuple[Cause, ...] = ()
    problem = ""
    try:
        found = tuple(causes(*(of_material(item.results, item.scene_folder, name) for item in (old, new))))
        if old.digests(name).get("bsdf") != new.digests(name).get("bsdf"):
            brdf = _brdf_difference(*(store.open_dataset(item.bsdf(name), "bsdf") for item in (old, new)))
    except BrdfpipeError as error:
        problem = str(error)
    return Difference(
        name,
        scene,
        CHANGED,
        colour=_colour_difference(before, after),
        brdf=brdf,
        quantities=_quantity_differences(before, after),
        verdict=(str(before["verdict"].values), str(after["verdict"].values)),
        causes=found,
        problem=problem,
    )


def _brdf_difference(old: xr.Dataset, new: xr.Dataset) -> dict[str, float]:
    from brdfpipe.scenes.domain import Domain
    from brdfpipe.scenes.metrics import glare

    figures = glare(new, old, Domain(_HEMISPHERE), n=_DIRECTIONS)
    return dict(zip(("rms", "percentile_95", "albedo"), (figure.value for figure in figures), strict=True))


def _colour_difference(old: xr.Dataset, new: xr.Dataset) -> float | None:
    from brdfpipe.spectra.colorimetry import delta_e_00

    lab = np.array([[row[name].values if name in row else np.nan for name in "Lab"] for row in (old, new)], float)
    return None if np.isnan(lab).any() else float(delta_e_00(lab[0], lab[1]))


def _quantity_differences(old: xr.Dataset, new: xr.Dataset) -> dict[str, tuple[float | None, float | None]]:
    """Numbers of the table that differ; uncertainties and counts included."""
    found = {}
    for name in dict.fromkeys(map(str, [*new.data_vars, *old.data_vars])):
        variables = [row[name] for row in (old, new) if name in row]
        if any(variable.ndim or variable.dtype.kind not in "fiu" for variable in variables):
            continue
        was, now = (float(row[name]) if name in row else np.nan for row in (old, new))
        if not np.isclose(was, now, rtol=_SAME, atol=0, equal_nan=True):
            found[name] = (None if np.isnan(was) else was, None if np.isnan(now) else now)
    return found
