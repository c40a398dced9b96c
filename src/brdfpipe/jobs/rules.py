"""What the workflow's rules ask for: conditions, raw files, parameters, and running a stage."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from brdfpipe.catalogue import names
from brdfpipe.catalogue.calibration import Calibration
from brdfpipe.catalogue.catalogue import load
from brdfpipe.catalogue.configuration import load_config
from brdfpipe.catalogue.material import Material
from brdfpipe.jobs import code, pool, runs
from brdfpipe.jobs.stage import Job
from brdfpipe.store import canonical_json

ALWAYS = ("bsdf", "checks", "appearance", "table", "lambert_gauss", "summary")
"""Datasets that every material has."""

Asked = Callable[[Any], Any]
"""What snakemake calls with a job's wildcards."""


class Stages:
    """The catalogue as the rules see it.

    Parameters
    ----------
    config : snakemake's: ``catalogue`` (folder), optionally ``settings`` (a configuration file), ``failures`` (material →
        stage and message, of materials to leave out because a stage failed)
    scripts : folder of the stages' scripts
    """

    def __init__(self, config: Mapping[str, Any], scripts: Path) -> None:
        if "catalogue" not in config:
            raise names.CatalogueError("say which catalogue: --config catalogue=/path/to/catalogue")
        settings = config.get("settings")
        loaded = load(Path(config["catalogue"]), load_config(Path(settings) if settings else None))
        excluded = dict(config.get("failures") or {})
        self.catalogue = loaded
        self.scripts = scripts
        self.runs, unplanned = runs.of(loaded)
        checked = {**loaded.failures, **unplanned}
        self.failures = {name: {"stage": "check", "message": text} for name, text in checked.items()} | excluded
        self.names = [material.name for material in loaded.materials if material.name not in self.failures]

    def has(self, part: str) -> Callable[[Any], bool]:
        """Whether a material has a part: surface, index, spectrum, slab, back."""
        return lambda wildcards: self.catalogue[wildcards.material].has(part)

    def measured(self, part: str) -> Callable[[Any], bool]:
        """Whether a material brings a raw file for a part."""
        return lambda wildcards: part in self.catalogue[wildcards.material].files

    def validates_masking(self, wildcards: Any) -> bool:
        """Whether rays are cast over a material's heights: it brings some, and the configuration asks for it."""
        return bool(self.catalogue.config["raycast"]) and "surface" in self.catalogue[wildcards.material].files

    def previewed(self, wildcards: Any) -> bool:
        """Whether the configuration asks for pictures of the materials."""
        return bool(self.catalogue.config["preview"])

    def raw(self, part: str) -> Asked:
        """The raw file a material brings for a part, if any."""
        return lambda wildcards: str(self.catalogue[wildcards.material].files.get(part, "")) or []

    def spec(self, stage: str) -> Asked:
        """A stage's own part of the description and the configuration, as canonical JSON: editing it reruns the stage."""
        return lambda wildcards: canonical_json(self.catalogue.spec(wildcards.material, stage))

    def failures_spec(self, wildcards: Any) -> str:
        """What the catalogue page depends on beside its inputs: the failures to list."""
        return canonical_json({"failures": self.failures})

    def code(self, stage: str) -> str:
        """Digest of a stage's own code: changing it reruns the stage."""
        return code.digest(self.scripts / f"{stage}.py")

    def preload(self, jobs: Iterable[Any]) -> None:
        """Let the workers' server import the slow modules that the stages of a run's jobs use."""
        scripts = {self.scripts / f"{job.rule.name}.py" for job in jobs}
        source = Path(__file__).resolve().parents[2]
        pool.preload(name for script in scripts if script.exists() for name in code.modules(script, source))

    def exports(self, pattern_of: Mapping[str, str]) -> list[str]:
        """The export files every material asks for."""
        return [
            pattern_of[export].format(material=name) for name in self.names for export in self.catalogue[name].exports
        ]

    def files(self) -> list[str]:
        """Every file of every material."""
        materials = [self.catalogue[name] for name in self.names]
        masking = [
            f"{m.name}/masking.nc" for m in materials if self.catalogue.config["raycast"] and "surface" in m.files
        ]
        comparisons = [f"{m.name}/comparison.nc" for m in materials if self._compares(m)]
        pictures = ("preview.nc", "preview.png") if self.catalogue.config["preview"] else ()
        return [f"{m.name}/{file}" for m in materials for file in (*_files_of(m), *pictures)] + masking + comparisons

    def raw_scan(self, wildcards: Any) -> str:
        """The raw file of a further scan."""
        return str(self.catalogue[wildcards.material].files[f"surface-{wildcards.scan}"])

    def scan_spec(self, wildcards: Any) -> str:
        """How a further scan is read, as canonical JSON."""
        return canonical_json(self.catalogue[wildcards.material].scan_spec(int(wildcards.scan)))

    def scans(self, wildcards: Any) -> list[str]:
        """The further scans of a material's surface."""
        material = self.catalogue[wildcards.material]
        return [f"{material.name}/surface-{number}.nc" for number in material.scans]

    def run(self, stage: str, wildcards: Any, input: Any, output: Any, params: Any, script: str | None = None) -> None:
        """Run a rule's stage in a worker; ``script`` where it is not named like the stage.

        Raises
        ------
        StageError : it refused or failed, in one line.
        """
        job = Job(
            stage=stage,
            material=_of(wildcards),
            script=str(self.scripts / f"{script or stage}.py"),
            folder=str(Path.cwd()),
            input=_named(input),
            output=_named(output),
            spec=json.loads(params.spec),
        )
        outcome = pool.pool().perform(job)
        if outcome.error:
            raise pool.StageError(f"{job.title}: {outcome.error}")

    # --- the camera rig

    def emulated(self, wildcards: Any) -> bool:
        """Whether the emulator makes a run, of a material or a calibration."""
        return "emulate" in self._rig(wildcards)

    def rig_sources(self, wildcards: Any) -> list[str]:
        """Plan, rig and fibres of a run to be emulated."""
        return self._run(wildcards).sources

    def rig_truth(self, wildcards: Any) -> str:
        """What the emulated rig measures."""
        return f"{self._rig(wildcards)['emulate']['truth']}/bsdf.nc"

    def rig_journal(self, wildcards: Any) -> str:
        """The journal of a run: the laboratory's, or the one the emulator makes."""
        owner = self._owner(wildcards)
        return f"{runs.place(owner)}/run/journal.jsonl" if self.emulated(wildcards) else str(owner.files["rig"])

    def rig_spec(self, stage: str) -> Asked:
        """A stage's part of the description of a rig's material or calibration, as canonical JSON."""

        def spec(wildcards: Any) -> str:
            owner = self._owner(wildcards)
            told = owner.spec(stage) if isinstance(owner, Calibration) else owner.spec(stage, {})
            if stage == "reduced":
                told |= {"load": wildcards.load, "side": wildcards.side, "incidence": float(wildcards.incidence)}
            return canonical_json(told)

        return spec

    def reduced(self, load: str) -> Asked:
        """What a run gives of each arrangement with a load; of the sample, on one side where the rule has one."""

        def files(wildcards: Any) -> list[str]:
            place = runs.place(self._owner(wildcards))
            return [
                f"{place}/reduced-{load}-{each.side}-{each.incidence:g}.nc"
                for each in self._run(wildcards).arrangements
                if each.load == load and each.side == wildcards.get("side", each.side)
            ]

        return files

    def by_side(self, stage: str) -> Asked:
        """What a stage makes of a rig's material, on each side that was measured."""

        def files(wildcards: Any) -> list[str]:
            sides = dict.fromkeys(each.side for each in self._run(wildcards).arrangements if each.load == "sample")
            return [f"{wildcards.material}/{stage}-{side}.nc" for side in sides]

        return files

    def compared(self, wildcards: Any) -> bool:
        """Whether what the rig measured of a material is compared with what its surface predicts."""
        return self._compares(self.catalogue[wildcards.material])

    def _compares(self, material: Material) -> bool:
        if not (material.has("rig") and material.has("surface")):
            return False
        # A perfectly flat surface mirrors light into one direction, of which no cell shows a BRDF.
        flat = material.content["surface"].get("distribution") == "flat"
        arrangements = self.runs[runs.place(material)].arrangements
        return not flat and any(each.load == "sample" and each.side == "reflection" for each in arrangements)

    def calibration_of(self, wildcards: Any) -> str:
        """The profile a material goes by."""
        return f"calibrations/{self._rig(wildcards)['calibration']}.nc"

    def certificate(self, wildcards: Any) -> str:
        """The certificate a calibration goes by."""
        return str(self.catalogue.calibrations[wildcards.calibration].files["certificate"])

    def previous(self, wildcards: Any) -> Any:
        """The profile before that of a calibration, if it tells of one."""
        previous = self.catalogue.calibrations[wildcards.calibration].previous
        return f"calibrations/{previous}.nc" if previous else []

    def _owner(self, wildcards: Any) -> Material | Calibration:
        name = wildcards.get("calibration")
        return self.catalogue[wildcards.material] if name is None else self.catalogue.calibrations[name]

    def _rig(self, wildcards: Any) -> Mapping[str, Any]:
        owner = self._owner(wildcards)
        return owner.content if isinstance(owner, Calibration) else owner.content["rig"]

    def _run(self, wildcards: Any) -> runs.Run:
        return self.runs[runs.place(self._owner(wildcards))]


def _files_of(material: Material) -> list[str]:
    exports = [f"exports/{material.name}.lambert_gauss.csv"]
    if "astm" in material.exports:
        exports += [f"exports/{material.name}.astm", f"exports/{material.name}.total_reflectance.csv"]
    if "astm" in material.exports and material.has("slab"):
        through = ("transmission.astm", "total_transmittance.csv")
        exports += [f"exports/{material.name}.{file}" for file in through]
    return [*(f"{stage}.nc" for stage in _stages_of(material)), "report.html", *exports]


def _stages_of(material: Material) -> list[str]:
    own = {"surface": "surface" in material.files, "facets": material.has("surface")}
    own |= {"back_surface": "back_surface" in material.files, "back_facets": material.has("back")}
    own |= {part: material.has(part) for part in ("index", "spectrum", "multiangle", "predicted")}
    own |= {"interior": material.has("slab"), "flake": material.has("multiangle"), "measured": material.has("rig")}
    scans = [f"surface-{number}" for number in material.scans]
    return [*(stage for stage, there in own.items() if there), *scans, *ALWAYS]


def _of(wildcards: Any) -> str:
    """Whose stage it is, for its log and its failure: a material, ``calibrations.NAME``, or the catalogue."""
    if (calibration := wildcards.get("calibration")) is not None:
        return f"{names.CALIBRATIONS}.{calibration}"
    return str(wildcards.get("material", "catalogue"))


def _named(files: Any) -> dict[str, str | list[str]]:
    """Plain strings under the names the rule gave; what a material does not have is left out."""
    return {
        name: str(value) if isinstance(value, str) else [str(item) for item in value]
        for name, value in files.items()
        if value
    }
