"""From what a laboratory has to a BSDF in one call: the stages of a build for one material, without a catalogue."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from brdfpipe import installation, store, vocabulary
from brdfpipe.catalogue import material_keys
from brdfpipe.catalogue.configuration import load_config
from brdfpipe.catalogue.material import FILE_PARTS, Material, completed, raw_files
from brdfpipe.descriptions import reading
from brdfpipe.errors import InputError
from brdfpipe.jobs.stage import main_of
from brdfpipe.scenes.scene import DEFAULT, load_scene
from brdfpipe.stages import STAGES, Subject

NAME = "predict"
"""In messages, the place of a file's name."""

READS: Mapping[str, tuple[str, ...]] = {
    "surface": (),
    "scan": (),
    "back_surface": (),
    "base_surface": (),
    "index": (),
    "base_index": (),
    "interior": (),
    "multiangle": (),
    "imported": (),
    "spectrum": ("index",),
    "facets": ("surface", "scan"),
    "gloss_facets": ("index", "spectrum"),
    "back_facets": ("surface=back_surface",),
    "base_facets": ("surface=base_surface",),
    "psd": ("surface", "scan"),
    "back_psd": ("surface=back_surface",),
    "visibility": ("surface", "facets"),
    "interreflection": ("surface", "facets", "index", "spectrum"),
    "predicted": ("facets", "psd", "visibility", "interreflection", "index", "spectrum"),
    "sheet": ("facets", "psd", "back_facets", "back_psd", "interior", "index"),
    "coated": ("facets", "base_facets", "interior", "index", "base_index", "spectrum"),
    "wave": ("predicted", "psd", "facets", "visibility", "index", "spectrum"),
    "reference": ("surface", "index", "spectrum"),
    "flake": ("multiangle",),
    "model_error": ("surface", "scan", "facets", "predicted", "wave"),
    "uncertainty": ("predicted", "wave", "facets", "psd", "index", "spectrum", "model_error"),
    "sheet_uncertainty": ("sheet", "facets", "psd", "back_facets", "back_psd", "interior", "index"),
    "coated_uncertainty": ("coated", "facets", "base_facets", "interior", "index", "base_index", "spectrum"),
    "flake_uncertainty": ("multiangle", "flake"),
    "bsdf": (
        *("predicted", "wave", "sheet", "coated", "reference", "flake", "imported"),
        *("uncertainty", "flake_uncertainty", "sheet_uncertainty", "coated_uncertainty"),
    ),
}
"""Stage → the stages whose results it reads, as in ``workflow/rules``, in an order in which they can run."""

RAW: Mapping[str, Mapping[str, str]] = {
    "surface": {"raw": "surface", "picture": "mask"},
    "scan": {"raw": "surface-{scan}"},
    "back_surface": {"raw": "back_surface"},
    "base_surface": {"raw": "base_surface"},
    "base_index": {"raw": "base_index"},
    "interior": {"raw": "interior"},
    "index": {"raw": "index"},
    "multiangle": {"raw": "multiangle"},
    "spectrum": {"raw": "spectrum", "excluded": "spectrum_sce"},
    "imported": {"raw": "table"},
}
"""Stage → the raw files that it reads: name of the input → part of the description."""

_KINDS: Mapping[str, str] = {
    "surface": "surface",
    "surface.scans": "surface",
    "index": "index",
    "spectrum": "spectrum",
    "multiangle": "multiangle",
    "table": "bsdf",
}
"""Key in which a dataset may stand for a file → kind of the dataset."""

_KEYS_AFTER_READING: Mapping[str, tuple[str, ...]] = {
    key: tuple(dict.fromkeys([*others, *(name for stage in stages for name in declared.read_by(stage))]))
    for key, declared, stages, others in (
        ("surface", material_keys.MeasuredSurface, ("facets", "psd"), ("scans",)),
        ("multiangle", material_keys.MultiangleFile, ("flake", "flake_uncertainty"), ()),
    )
}
"""Key of a file → keys beside it that later stages read, so that they have an effect beside a dataset too."""

_OF_UNCERTAINTY = ("model_error", "uncertainty", "sheet_uncertainty", "coated_uncertainty", "flake_uncertainty")


def predict(
    surface: Any = None,
    index: Any = None,
    spectrum: Any = None,
    *,
    uncertainty: bool = True,
    progress: bool | None = None,
    **keys: Any,
) -> xr.Dataset:
    """The BSDF that a build would make of the same inputs.

    Every argument is a key of ``material.yaml``, with its defaults: docs/materials.md explains them. In place of a mapping
    ``{"file": path}`` a path alone is accepted, and in place of a path of ``surface`` (and its ``scans``), ``index``, ``spectrum``,
    ``multiangle`` or ``table`` a dataset of that kind, without keys that say how a file is read.

    Parameters
    ----------
    surface : a scan (path, dataset of kind ``surface``, or ``{"file": path, "unit": "um", …}``), or an assumed finish as
        ``{"distribution": "ggx", "a": 0.2}``; without a surface the material is a perfect diffuser of its spectrum
    index : a number, the name of a plastic, ``{"n": 0.2, "k": 3.4}``, a path of a table, or a dataset of kind ``index``
    spectrum : the total reflectance: a path, a dataset of kind ``spectrum``, ``{"file": path, "geometry": "sci", …}``, or a colour as
        ``{"lab": [50, 0, 0], "illuminant": "D65", "observer": 10, "geometry": "sci"}``
    uncertainty : whether to compute the changes by the uncertainties of the inputs too, and the error of the model, which takes longer
        than the BSDF itself. The values are the same without
    progress : whether to name the stage that runs, on the standard error; by default on a terminal
    keys : further keys: ``name``, ``slab`` of a clear body, ``coat`` of a coated one, ``multiangle`` of an effect paint, ``table``, ``model``, ``measured``, ``index_uncertainty``

    Returns
    -------
    Dataset of kind ``bsdf``: evaluate it with ``dataset.bsdf``. The attribute ``warnings`` (JSON) lists what the stages warn of

    Raises
    ------
    InputError : an unknown key, a value that is not accepted, no such file, or a file that cannot be read; what was found, what is
        accepted and what to give.
    """
    given = {"surface": surface, "index": index, "spectrum": spectrum, **keys}
    if "rig" in given:
        raise InputError(
            NAME, "a rig is measured in a build", found="rig", accepted="`brdfpipe build`; see docs/rig.md"
        )
    config = load_config()
    with TemporaryDirectory(prefix="brdfpipe-") as folder:
        datasets = _Datasets(Path(folder))
        written = {
            key: datasets.stored(_description(key, value), key) for key, value in given.items() if value is not None
        }
        content = completed(reading.check(written, material_keys.Material, NAME), config)
        files = {part: _existing(file, key) for part, key, file in raw_files(content)}
        material = Material(content.get("name", "material"), Path(folder), content, files, load_scene(DEFAULT))
        steps = [step for step in _steps(Subject(material, config)) if uncertainty or step.stage not in _OF_UNCERTAINTY]
        results: defaultdict[str, list[str]] = defaultdict(list)
        with store.remembering():
            for step in _shown(steps, progress):
                results[step.result].append(_run(step, material, results, datasets))
        return store.open_dataset(results["bsdf"][0], "bsdf").load()


class _Step(NamedTuple):
    """One job of a stage."""

    stage: str
    wildcards: Mapping[str, str]
    spec: Mapping[str, Any]

    @property
    def result(self) -> str:
        return STAGES[self.stage].stands_for or self.stage


def _steps(subject: Subject) -> list[_Step]:
    """The jobs of a material up to its BSDF, in an order in which they can run."""
    stages = [STAGES[name] for name in READS]
    return [_Step(one.name, job, one.parameters(subject, job)) for one in stages for job in one.jobs(subject)]


def _shown(steps: list[_Step], progress: bool | None) -> Iterator[_Step]:
    from tqdm import tqdm

    disable = None if progress is None else not progress
    with tqdm(steps, desc=NAME, unit="stage", leave=False, disable=disable, delay=1.0) as bar:
        for step in bar:
            bar.set_postfix_str(step.stage)
            yield step


def _run(step: _Step, material: Material, results: Mapping[str, list[str]], datasets: _Datasets) -> str:
    """Run a job as a build does; return the path of its result."""
    stage, number = STAGES[step.stage], step.wildcards.get("scan", "")
    raw = {name: material.files.get(part.format(**step.wildcards)) for name, part in RAW.get(step.stage, {}).items()}
    if raw.get("raw") in datasets.paths:
        return str(raw["raw"])
    inputs: dict[str, Any] = {name: str(path) for name, path in raw.items() if path is not None}
    for read in READS[step.stage]:
        name, _, source = read.rpartition("=")
        if found := results.get(source):
            inputs[name or source] = found if STAGES[source].instances else found[0]
    path = str(material.folder / f"{step.stage}{number}.nc")
    script = installation.project_folder() / "workflow" / "scripts" / f"{stage.script}.py"
    parameters = {"material": material.name, "spec": dict(step.spec)}
    try:
        main_of(str(script))(inputs, defaultdict(lambda: path), parameters)
    except InputError as refusal:
        key = refusal.key or ""
        part, _, inner = key.partition(".")
        words = f"`{part}={{…, {inner!r}: …}}` to `{NAME}`" if inner else f"`{part}=…` to `{NAME}`"
        raise refusal.at_command_line({key: words}) from None
    return path


class _Datasets:
    """Datasets that were given in place of files, stored as the results of the stages that read those files."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.paths: set[Path] = set()

    def stored(self, value: Any, key: str) -> Any:
        """A description with the paths of its datasets in their places.

        Raises
        ------
        InputError : a dataset where only a file is accepted, or of another kind; or keys beside it that say how a file is read.
        """
        if isinstance(value, xr.Dataset):
            return self._path(value, key)
        if isinstance(value, Mapping):
            written = {
                str(name): self.stored(item, key if name == "file" else f"{key}.{name}") for name, item in value.items()
            }
            if isinstance(value.get("file"), xr.Dataset):
                _refuse_keys_of_reading(written.keys() - {"file"}, key)
            return written
        if isinstance(value, list | tuple):
            return [self.stored(item, key) for item in value]
        if isinstance(value, np.ndarray | np.generic):
            return value.tolist()
        return os.fspath(value) if isinstance(value, os.PathLike) else value

    def _path(self, dataset: xr.Dataset, key: str) -> str:
        kind, accepted = dataset.attrs.get("kind"), _KINDS.get(key)
        if accepted is None:
            problem = "no dataset is accepted here"
            raise InputError(NAME, problem, where=key, found="a dataset", accepted="the path of a file")
        if kind != accepted:
            found = f"a dataset of kind {kind!r}" if kind else "a dataset without the attribute `kind`"
            raise InputError(
                NAME, "not the dataset of this input", where=key, found=found, accepted=f"kind {accepted!r}"
            )
        vocabulary.validate(dataset, kind, key)
        path = self._folder / f"given-{len(self.paths)}.nc"
        stage = key.partition(".")[0]
        store.save_dataset(dataset, path, stage=stage, material="material", inputs={}, parameters={})
        self.paths.add(path)
        return str(path)


def _refuse_keys_of_reading(names: Iterable[str], key: str) -> None:
    """Refuse keys that would have no effect, because the stage that reads the file does not run."""
    later = _KEYS_AFTER_READING.get(key, ())
    if unused := sorted(set(names).difference(later)):
        problem = "a dataset is used as it is; these keys say how a file is read"
        accepted = f"the dataset alone{', or with ' if later else ''}{', '.join(later)}"
        raise InputError(NAME, problem, where=key, found=", ".join(unused), accepted=accepted)


def _description(key: str, value: Any) -> Any:
    """A path or a dataset as the mapping that it stands for."""
    if isinstance(value, xr.Dataset | os.PathLike):
        return {"file": value}
    if isinstance(value, str) and key in FILE_PARTS and (key != "index" or _is_path(value)):
        return {"file": value}
    return value


def _is_path(text: str) -> bool:
    """Whether the index is a file and not the name of a plastic, as PC/ABS."""
    return Path(text).is_file() or Path(text).suffix.lower() in (".txt", ".csv", ".yml", ".yaml")


def _existing(file: str, key: str) -> Path:
    path = Path(file).expanduser().absolute()
    if not path.is_file():
        beside = (
            sorted(item.name for item in path.parent.iterdir() if item.is_file())[:10] if path.parent.is_dir() else []
        )
        accepted = f"the path of a file; {path.parent} holds {', '.join(beside) or 'no file'}"
        raise InputError(NAME, "no such file", where=key, found=repr(file), accepted=accepted)
    return path
