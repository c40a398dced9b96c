"""What the rules of the workflow take from the catalogue: input files, parameters, and the run of a stage."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from brdfpipe.catalogue.calibration import Calibration
from brdfpipe.catalogue.catalogue import load
from brdfpipe.catalogue.configuration import load_config
from brdfpipe.catalogue.material import Material
from brdfpipe.catalogue.names import CALIBRATIONS, CatalogueError
from brdfpipe.jobs import code, pool
from brdfpipe.jobs.runs import planned_runs, results_folder
from brdfpipe.jobs.stage import Job
from brdfpipe.stages import STAGES, Stage, Subject
from brdfpipe.store import canonical_json

InputFunction = Callable[[Any], Any]
"""Called by snakemake with the wildcards of a job; returns its files, or a parameter."""


class Pipeline:
    """The files that a stage reads, its parameters, and its run.

    Parameters
    ----------
    config : snakemake's: ``catalogue`` (folder), optionally ``settings`` (a configuration file), ``failures`` (material →
        stage and message, of materials to leave out because a stage failed)
    scripts : folder of the stages' scripts
    """

    def __init__(self, config: Mapping[str, Any], scripts: Path) -> None:
        if "catalogue" not in config:
            raise CatalogueError("no catalogue; give its folder: --config catalogue=/path/to/catalogue")
        settings = config.get("settings")
        self.catalogue = load(Path(config["catalogue"]), load_config(Path(settings) if settings else None))
        self.runs, unplanned = planned_runs(self.catalogue)
        self.scripts = scripts
        refused = {**self.catalogue.failures, **unplanned}
        self.failures = {name: {"stage": "check", "message": text} for name, text in refused.items()}
        self.failures |= dict(config.get("failures") or {})
        self.names = [material.name for material in self.catalogue.materials if material.name not in self.failures]
        self._outputs: dict[str, list[str]] = {}
        self._subjects: dict[str, Subject] = {}

    def subject(self, owner: Material | Calibration) -> Subject:
        """The material or calibration, the configuration and the planned arrangements."""
        folder = results_folder(owner)
        if folder not in self._subjects:
            arrangements = self.runs[folder].arrangements if folder in self.runs else ()
            self._subjects[folder] = Subject(owner, self.catalogue.config, arrangements)
        return self._subjects[folder]

    # --- input files

    def results_of(self, *stages: str, **renamed: str) -> dict[str, InputFunction]:
        """Results of other stages as input of a rule, by stage, or by a name of its own: ``results_of(surface="back_surface")``.

        A stage that the material does not have gives no file. A stage with several jobs gives the list of those that agree with
        the wildcards of the rule.
        """
        names = {stage: stage for stage in stages} | renamed
        return {name: self._result(STAGES[stage]) for name, stage in names.items()}

    def reported(self, wildcards: Any) -> dict[str, Any]:
        """The datasets that the report reads, by stage, in the order of the declarations."""
        results = {
            name: self._result(stage)(wildcards) for name, stage in STAGES.items() if stage.kind and stage.reported
        }
        return {name: files for name, files in results.items() if files}

    def raw_file(self, part: str) -> InputFunction:
        """The raw file of a part of the material, if it has one: ``surface``, or ``surface-{scan}`` for a further scan."""
        return lambda wildcards: str(self._owner(wildcards).files.get(part.format(**wildcards), "")) or []

    def rig_sources(self, wildcards: Any) -> list[str]:
        """Plan, rig and fibres of a run to be emulated."""
        return self.runs[results_folder(self._owner(wildcards))].sources

    def rig_truth(self, wildcards: Any) -> str:
        """The BSDF that the emulated rig measures."""
        return f"{self._owner(wildcards).content['rig']['emulate']['truth']}/bsdf.nc"

    def rig_journal(self, wildcards: Any) -> str:
        """The journal of a run, measured or emulated."""
        owner = self._owner(wildcards)
        emulated = "emulate" in self.subject(owner).section("rig")
        return f"{results_folder(owner)}/run/journal.jsonl" if emulated else str(owner.files["rig"])

    def previous_calibration(self, wildcards: Any) -> Any:
        """The profile of the previous calibration, if the description names one."""
        previous = self.catalogue.calibrations[wildcards.calibration].previous
        return f"{CALIBRATIONS}/{previous}.nc" if previous else []

    def files(self) -> list[str]:
        """All results of all materials, without the intermediate ones."""
        return [
            pattern.format(material=name, **job)
            for name in self.names
            for stage in STAGES.values()
            if stage.owner_kind == "material" and not stage.intermediate
            for job in stage.jobs(self.subject(self.catalogue[name]))
            for pattern in self._outputs[stage.name]
        ]

    # --- what follows from the declaration of a stage

    def declare_stage_properties(self, workflow: Any) -> None:
        """Set log, parameters, message and memory of each rule from the stage of its name."""
        from snakemake.io import strip_wildcard_constraints  # type: ignore[import-untyped]

        stages = [STAGES[rule.name] for rule in workflow.rules if rule.name in STAGES]
        with code.remember_parsed(Path(".snakemake", "code.json")):
            digests = {stage.name: code.digest(self._script(stage), extra_modules=stage.modules) for stage in stages}
        owners = {"material": "{material}", "calibration": f"{CALIBRATIONS}.{{calibration}}"}
        for rule in workflow.rules:
            rule.log_modifier = workflow.modifier.path_modifier
            if rule.name not in STAGES:
                rule.set_log(f"logs/{rule.name}.log")  # never written; the workflow's lint wants one
                continue
            stage = STAGES[rule.name]
            self._outputs[stage.name] = [strip_wildcard_constraints(str(pattern)) for pattern in rule.output]
            owner = owners.get(stage.owner_kind, stage.owner_kind)
            rule.set_log(f"logs/{owner}/{stage.job_title}.log")
            rule.set_params(spec=self.spec(stage), code=digests[stage.name])
            rule.message = f"{stage.job_title} of {owner}".replace("{", "{wildcards.")
            rule.resources["mem_mb"] = stage.memory

    def preload(self, jobs: Iterable[Any]) -> None:
        """Import the slow modules that some jobs use once, in the server of the workers; call it before the first job."""
        stages = [STAGES[name] for name in {job.rule.name for job in jobs} if name in STAGES]
        covered = (code.modules(self._script(stage), extra_modules=stage.modules) for stage in stages)
        pool.preload(name for modules in covered for name in modules)

    def spec(self, stage: Stage) -> InputFunction:
        """Parameters of a stage as canonical JSON; their change reruns the stage."""

        def spec(wildcards: Any) -> str:
            if stage.owner_kind == "catalogue":
                return canonical_json({"failures": self.failures})
            job = {name: value for name, value in wildcards.items() if name not in ("material", "calibration")}
            return canonical_json(stage.parameters(self.subject(self._owner(wildcards)), job))

        return spec

    def run(self, rule: str, wildcards: Any, input: Any, output: Any, params: Any) -> None:
        """Run the stage of a rule in a worker. Raises StageError: it refused or failed, in one line."""
        stage = STAGES[rule]
        calibration = wildcards.get("calibration")
        job = Job(
            title=stage.job_title.format(**wildcards),
            material=f"{CALIBRATIONS}.{calibration}" if calibration else wildcards.get("material", stage.owner_kind),
            script=str(self._script(stage)),
            folder=str(Path.cwd()),
            input=_existing_paths(input),
            output=_existing_paths(output),
            spec=json.loads(params.spec),
        )
        outcome = pool.shared_pool().perform(job)
        if outcome.error:
            raise pool.StageError(f"{job.description}: {outcome.error}")

    def _script(self, stage: Stage) -> Path:
        return self.scripts / f"{stage.script}.py"

    def _result(self, stage: Stage) -> InputFunction:
        """The first output of each job of a stage, as input of a rule."""

        def files(wildcards: Any) -> Any:
            owner: Material | Calibration | None = self._owner(wildcards)
            if stage.owner_kind == "calibration" and isinstance(owner, Material):
                rig = owner.content.get("rig")
                owner = self.catalogue.calibrations[rig["calibration"]] if rig else None
            jobs = stage.jobs(self.subject(owner)) if owner else []
            paths = [
                self._outputs[stage.name][0].format(**{stage.owner_kind: owner.name}, **job)
                for job in jobs
                if owner and all(wildcards.get(name, value) == value for name, value in job.items())
            ]
            return paths if stage.instances or not paths else paths[0]

        return files

    def _owner(self, wildcards: Any) -> Material | Calibration:
        name = wildcards.get("calibration")
        return self.catalogue.calibrations[name] if name else self.catalogue[wildcards.material]


def _existing_paths(files: Any) -> dict[str, str | list[str]]:
    """Paths by the names that the rule gave, without files that the material does not have."""
    return {
        name: str(value) if isinstance(value, str) else [str(item) for item in value]
        for name, value in files.items()
        if value
    }
