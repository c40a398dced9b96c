"""What the rules of the workflow take from the catalogue: input files, parameters, and the run of a stage."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import wraps
from pathlib import Path
from typing import Any, NamedTuple

from brdfpipe.catalogue.calibration import Calibration
from brdfpipe.catalogue.catalogue import Catalogue, load
from brdfpipe.catalogue.configuration import load_config
from brdfpipe.catalogue.material import Material
from brdfpipe.catalogue.names import CALIBRATIONS, CHANGES, CatalogueError
from brdfpipe.jobs import code, pool
from brdfpipe.jobs.index import digest_of, shared_index
from brdfpipe.jobs.runs import planned_runs, results_folder
from brdfpipe.jobs.stage import Job
from brdfpipe.scenes.scene import DEFAULT, FOLDER, Scene
from brdfpipe.stages import STAGES, Stage, Subject, source_of_bsdf
from brdfpipe.store import canonical_json

InputFunction = Callable[[Any], Any]
"""Called by snakemake with the wildcards of a job; returns its files, or a parameter."""


def _input_function(method: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """A method of the pipeline that the rules name as input."""

    @wraps(method)
    def give(self: Any, wildcards: Any) -> Any:
        return self._given(lambda wildcards: method(self, wildcards))(wildcards)

    return give


class JobWildcards(dict[str, str]):
    """Wildcards of a job, also as attributes, as snakemake gives them."""

    def __getattr__(self, name: str) -> str:
        try:
            return self[name]
        except KeyError:
            raise AttributeError(name) from None


class PlannedJob(NamedTuple):
    """A job that may have to run."""

    stage: Stage
    wildcards: JobWildcards
    outputs: tuple[str, ...]


class Pipeline:
    """The files that a stage reads, its parameters, and its run.

    Parameters
    ----------
    config : snakemake's: ``catalogue`` (folder), optionally ``settings`` (a configuration file), ``scene`` (instead of those that the
        configuration and the materials name), ``failures`` (material → stage and message, of materials to leave out because a stage failed),
        ``names`` (of the only materials to build, without the catalogues of the scenes)
    scripts : folder of the stages' scripts
    """

    def __init__(self, config: Mapping[str, Any], scripts: Path) -> None:
        if "catalogue" not in config:
            raise CatalogueError("no catalogue; give its folder: --config catalogue=/path/to/catalogue")
        settings = config.get("settings")
        configuration = load_config(Path(settings) if settings else None)
        self.catalogue = load(Path(config["catalogue"]), configuration, config.get("scene"))
        self.runs, unplanned = planned_runs(self.catalogue)
        self.scripts = scripts
        refused = {**self.catalogue.failures, **unplanned}
        self.failures = {name: {"stage": "check", "message": text} for name, text in refused.items()}
        self.failures |= dict(config.get("failures") or {})
        self._only = frozenset(config["names"]) if "names" in config else None
        self.names = [material.name for material in self.catalogue.materials if material.name not in self.failures]
        self.scenes_present = scenes_present(Path(), self.catalogue)
        """Scenes with a page in the current folder, that of the results, now or after the build."""
        self._outputs: dict[str, list[str]] = {}
        self._inputs: dict[str, list[InputFunction | str]] = {}
        self._code: dict[str, str] = {}
        self._before_planning: list[Callable[[Pipeline], None]] = []
        self._subjects: dict[tuple[str, str], Subject] = {}
        self.current: dict[str, str] = {}
        """Results that need not be made again → their absolute paths, by which snakemake takes them for given files and plans no job for them."""

    def subject(self, owner: Material | Calibration, scene: Scene | None = None) -> Subject:
        """The material or calibration, the configuration, the planned arrangements, and the scene of its results."""
        folder, name = results_folder(owner), scene.name if scene else ""
        if (folder, name) not in self._subjects:
            arrangements = self.runs[folder].arrangements if folder in self.runs else ()
            self._subjects[folder, name] = Subject(owner, self.catalogue.config, arrangements, scene)
        return self._subjects[folder, name]

    # --- input files

    def results_of(self, *stages: str, **renamed: str) -> dict[str, InputFunction]:
        """Results of other stages as input of a rule, by stage, or by a name of its own: ``results_of(surface="back_surface")``.

        A stage that the material does not have gives no file. A stage with several jobs gives the list of those that agree with
        the wildcards of the rule.
        """
        names = {stage: stage for stage in stages} | renamed
        return {name: self._given(self._result(STAGES[stage])) for name, stage in names.items()}

    @_input_function
    def reported(self, wildcards: Any) -> dict[str, Any]:
        """The datasets that the report reads, by stage, in the order of the declarations."""
        results = {
            name: self._result(stage)(wildcards) for name, stage in STAGES.items() if stage.kind and stage.reported
        }
        return {name: files for name, files in results.items() if files}

    def raw_file(self, part: str) -> InputFunction:
        """The raw file of a part of the material, if it has one: ``surface``, or ``surface-{scan}`` for a further scan."""
        return self._given(lambda wildcards: str(self._owner(wildcards).files.get(part.format(**wildcards), "")) or [])

    def raw_files(self, part: str) -> InputFunction:
        """The raw files of a part of the material that may have several, ``texture-1``, ``texture-2`` …, in their order."""
        return self._given(
            lambda wildcards: [
                str(path) for name, path in self._owner(wildcards).files.items() if name.startswith(f"{part}-")
            ]
        )

    @_input_function
    def source_of_bsdf(self, wildcards: Any) -> dict[str, str]:
        """The dataset that becomes the BSDF, by its stage."""
        source = source_of_bsdf(self.subject(self._owner(wildcards)))
        return {source: self._result(STAGES[source])(wildcards)}

    @_input_function
    def experience(self, wildcards: Any) -> Any:
        """The errors that were measured for the scene of a material on other materials, if there are any."""
        file = self.catalogue[wildcards.material].scene.experience_file
        return [] if file is None else str(file)

    def of_materials(self, stage: str) -> InputFunction:
        """The result of a stage, of all materials of a scene that have it."""

        def files(wildcards: Any) -> list[str]:
            materials = [self.catalogue[name] for name in self.names]
            return [
                self._outputs[stage][0].format(scene=wildcards.scene, material=material.name)
                for material in materials
                if material.scene.folder == wildcards.scene
                and STAGES[stage].jobs(self.subject(material, material.scene))
            ]

        return self._given(files)

    @_input_function
    def rig_sources(self, wildcards: Any) -> list[str]:
        """Plan, rig and fibres of a run to be emulated."""
        return self.runs[results_folder(self._owner(wildcards))].sources

    @_input_function
    def rig_truth(self, wildcards: Any) -> str:
        """The BSDF that the emulated rig measures."""
        truth = self.catalogue[self._owner(wildcards).content["rig"]["emulate"]["truth"]]
        return self._outputs[source_of_bsdf(self.subject(truth))][0].format(material=truth.name)

    @_input_function
    def rig_journal(self, wildcards: Any) -> str:
        """The journal of a run, measured or emulated."""
        owner = self._owner(wildcards)
        emulated = "emulate" in self.subject(owner).section("rig")
        return f"{results_folder(owner)}/run/journal.jsonl" if emulated else str(owner.files["rig"])

    @_input_function
    def previous_calibration(self, wildcards: Any) -> Any:
        """The profile of the previous calibration, if the description names one."""
        previous = self.catalogue.calibrations[wildcards.calibration].previous
        return f"{CALIBRATIONS}/{previous}.nc" if previous else []

    def files(self) -> list[str]:
        """All results of all materials for their scenes, without the intermediate ones, and the catalogues of these scenes.

        Where only some materials are asked for, their results alone.
        """
        of_materials = [
            pattern.format(scene=material.scene.folder, material=material.name, **job)
            for material in (self.catalogue[name] for name in self.names if self._only is None or name in self._only)
            for stage in STAGES.values()
            if stage.owner_kind == "material" and not stage.intermediate
            for job in stage.jobs(self.subject(material, material.scene))
            for pattern in self._outputs[stage.name]
        ]
        scenes = self.catalogue.scenes if self._only is None else ()
        return [
            pattern.format(scene=scene.folder) for scene in scenes for pattern in self._outputs["catalogue"]
        ] + of_materials

    @_input_function
    def targets(self, wildcards: Any) -> list[str]:
        """The results that have to be made, or one of them if there is none: snakemake runs a rule without files always.

        On the node of a cluster, which gets the list of its jobs, all results.
        """
        files = self.files()
        return [path for path in files if path not in self.current] or files[:1]

    def _given(self, files: InputFunction) -> InputFunction:
        """A function as snakemake gets it: it asks first what has to run, and marks given files, whose times have no effect."""

        def give(wildcards: Any) -> Any:
            if self._before_planning:
                actions, self._before_planning = self._before_planning, []
                for action in actions:
                    action(self)
            return _ageless(files(wildcards), self.current)

        return give

    # --- jobs, as snakemake will plan them

    def jobs(self) -> dict[str, PlannedJob]:
        """Every job that a result may need, by each of its outputs."""
        jobs = []
        for stage in STAGES.values():
            of_scene = "{scene}" in self._outputs[stage.name][0]
            if stage.owner_kind == "material":
                for material in (self.catalogue[name] for name in self.names):
                    wildcards = {"material": material.name} | ({"scene": material.scene.folder} if of_scene else {})
                    # What all scenes share may be needed by a stage of the scene, or by one that they share.
                    subjects = [self.subject(material, material.scene), *([] if of_scene else [self.subject(material)])]
                    jobs += [
                        self._planned(stage, wildcards | job) for subject in subjects for job in stage.jobs(subject)
                    ]
            elif stage.owner_kind == "calibration":
                for calibration in self.catalogue.calibrations.values():
                    wildcards = {"calibration": calibration.name}
                    jobs += [self._planned(stage, wildcards | job) for job in stage.jobs(self.subject(calibration))]
        jobs += [self._planned(STAGES["catalogue"], {"scene": scene.folder}) for scene in self.catalogue.scenes]
        return {path: job for job in jobs for path in job.outputs}

    def inputs_of(self, job: PlannedJob) -> list[str]:
        """The input files of a job."""
        paths: list[str] = []
        for item in self._inputs[job.stage.name]:
            found = item(job.wildcards) if callable(item) else item.format(**job.wildcards)
            for value in found.values() if isinstance(found, dict) else [found]:
                paths += [value] if isinstance(value, str) else value
        return paths

    def parameters_of(self, job: PlannedJob) -> str:
        """Digest of the parameters of a job."""
        return digest_of(self.spec(job.stage)(job.wildcards))

    def code_of(self, job: PlannedJob) -> str:
        """Digest of the code of a job."""
        return self._code[job.stage.name]

    def _planned(self, stage: Stage, wildcards: Mapping[str, str]) -> PlannedJob:
        outputs = tuple(pattern.format(**wildcards) for pattern in self._outputs[stage.name])
        return PlannedJob(stage, JobWildcards(wildcards), outputs)

    # --- what follows from the declaration of a stage

    def declare_stage_properties(self, workflow: Any) -> None:
        """Set log, parameters, message and memory of each rule from the stage of its name."""
        from snakemake.io import strip_wildcard_constraints  # type: ignore[import-untyped]

        stages = [STAGES[rule.name] for rule in workflow.rules if rule.name in STAGES]
        with code.remember_parsed(Path(".snakemake", "code.json")):
            self._code = {stage.name: code.digest(self._script(stage), extra_modules=stage.modules) for stage in stages}
        owners = {"material": "{material}", "calibration": f"{CALIBRATIONS}.{{calibration}}"}
        for rule in workflow.rules:
            rule.log_modifier = workflow.modifier.path_modifier
            rule.input_modifier = None  # it would drop the marks of files
            if rule.name not in STAGES:
                rule.set_log(f"logs/{rule.name}.log")  # never written; the workflow's lint wants one
                continue
            stage = STAGES[rule.name]
            self._outputs[stage.name] = [strip_wildcard_constraints(str(pattern)) for pattern in rule.output]
            owner = owners.get(stage.owner_kind, stage.owner_kind)
            if "{scene}" in self._outputs[stage.name][0]:
                owner = f"{{scene}}{owner}"
            rule.set_log(f"logs/{owner}/{stage.job_title}.log")
            rule.set_params(spec=self.spec(stage))
            self._inputs[stage.name] = [_function_of(item) or str(item) for item in rule.input]
            rule.message = f"{stage.job_title} of {owner}".replace("{", "{wildcards.")
            given = workflow.resource_settings.overwrite_resources.get(rule.name, {})
            for name, value in declared_resources(stage, given).items():
                rule.resources[name] = value

    def before_planning(self, action: Callable[[Pipeline], None]) -> None:
        """Call a function before snakemake decides which jobs run: when it asks for the first input files."""
        self._before_planning.append(action)

    def preload(self, jobs: Iterable[Any]) -> None:
        """Import the slow modules that some jobs use once, in the server of the workers; call it before the first job."""
        stages = [STAGES[name] for name in {job.rule.name for job in jobs} if name in STAGES]
        covered = (code.modules(self._script(stage), extra_modules=stage.modules) for stage in stages)
        pool.preload(name for modules in covered for name in modules)

    def spec(self, stage: Stage) -> InputFunction:
        """Parameters of a stage as canonical JSON; their change reruns the stage."""

        def spec(wildcards: Any) -> str:
            if stage.owner_kind == "catalogue":
                return canonical_json(self._of_catalogue(wildcards.scene))
            job = {name: value for name, value in wildcards.items() if name not in ("scene", "material", "calibration")}
            return canonical_json(stage.parameters(self._subject(wildcards), job))

        return spec

    def _of_catalogue(self, folder: str) -> dict[str, Any]:
        """Parameters of the catalogue of a scene: its failures, and what it is for; the default scene needs no words."""
        scene = next(scene for scene in self.catalogue.scenes if scene.folder == folder)
        failures = {name: text for name, text in self.failures.items() if self.catalogue.scene_of(name) == scene}
        parameters: dict[str, Any] = {"failures": failures}
        if scene.folder:
            parameters["scene"] = {"name": scene.name, "purpose": scene.content["purpose"]}
        if others := sorted(name for name in self.scenes_present if name != scene.name):
            parameters["others"] = [(name, _link(name, scene.name)) for name in others]
        if Path(CHANGES).is_file():
            parameters["changes"] = f"{'../../' if folder else ''}{CHANGES}"
        return parameters

    def run(self, rule: str, wildcards: Any, input: Any, output: Any, params: Any) -> None:
        """Run the stage of a rule in a worker. Raises StageError: it refused or failed, in one line."""
        stage = STAGES[rule]
        calibration = wildcards.get("calibration")
        limits = {} if stage.owner_kind == "catalogue" else self.catalogue.config["job_limits"]
        job = Job(
            title=stage.job_title.format(**wildcards),
            material=f"{CALIBRATIONS}.{calibration}" if calibration else wildcards.get("material", stage.owner_kind),
            scene=wildcards.get("scene", ""),
            script=str(self._script(stage)),
            folder=str(Path.cwd()),
            input={name: self._as_planned(_existing(value)) for name, value in input.items() if value},
            output={name: _existing(value) for name, value in output.items() if value},
            spec=json.loads(params.spec),
            inherited=self._inherited(wildcards),
            most_seconds=limits.get("seconds"),
            most_memory=limits.get("memory"),
        )
        index, inputs, outputs = (
            shared_index(Path.cwd()),
            self._as_planned(list(map(str, input))),
            list(map(str, output)),
        )
        read = index.inputs(inputs)
        index.start(outputs)
        outcome = pool.shared_pool().perform(job)
        if outcome.error:
            raise pool.StageError(f"{job.description}: {outcome.error}")
        if index.inputs(inputs) == read:  # a file that changed meanwhile is read again by the next build
            beside = _files_below(Path(outputs[0]).parent) if stage.fills_folder else _present(stage, wildcards)
            index.finish(digest_of(params.spec), self._code[rule], read, list(dict.fromkeys([*outputs, *beside])))

    def _inherited(self, wildcards: Any) -> Mapping[str, str]:
        """Keys of the material of a job that stand in ``catalogue.yaml``; none of a calibration or the catalogue."""
        material = self.catalogue.by_name.get(wildcards.get("material", ""))
        return material.inherited if material is not None else {}

    def _as_planned(self, files: Any) -> Any:
        """Input files, those of :attr:`current` by their paths in the results."""
        if not isinstance(files, str):
            return [self._as_planned(file) for file in files]
        path = files.removeprefix(f"{Path.cwd()}/")
        return path if path in self.current else files

    def _script(self, stage: Stage) -> Path:
        return self.scripts / f"{stage.script}.py"

    def _result(self, stage: Stage) -> InputFunction:
        """The first output of each job of a stage, as input of a rule; of the one that stands for it, where the scene has that one."""
        candidates = [stage, *(other for other in STAGES.values() if other.stands_for == stage.name)]

        def files(wildcards: Any) -> Any:
            subject: Subject | None = self._subject(wildcards)
            if stage.owner_kind == "calibration" and subject and isinstance(subject.owner, Material):
                rig = subject.owner.content.get("rig")
                subject = self.subject(self.catalogue.calibrations[rig["calibration"]]) if rig else None
            paths = [
                self._outputs[one.name][0].format(
                    **{"scene": wildcards.get("scene", ""), stage.owner_kind: subject.owner.name}, **job
                )
                for one in candidates
                if subject
                for job in one.jobs(subject)
                if all(wildcards.get(name, value) == value for name, value in job.items())
            ]
            return paths if stage.instances or not paths else paths[0]

        return files

    def _subject(self, wildcards: Any) -> Subject:
        """The owner of a job; with its scene where the results are those of a scene."""
        owner = self._owner(wildcards)
        of_scene = isinstance(owner, Material) and wildcards.get("scene") is not None
        return self.subject(owner, owner.scene if of_scene else None)  # type: ignore[union-attr]

    def _owner(self, wildcards: Any) -> Material | Calibration:
        name = wildcards.get("calibration")
        return self.catalogue.calibrations[name] if name else self.catalogue[wildcards.material]


def scenes_present(results: Path, catalogue: Catalogue) -> list[str]:
    """Names of the scenes that have a page in the results, the default one first, or will have one after the build."""
    default = [DEFAULT] if (results / "index.html").exists() else []
    present = default + sorted(page.parent.name for page in (results / FOLDER).glob("*/index.html"))
    return list(dict.fromkeys([*present, *(scene.name for scene in catalogue.scenes)]))


def _link(scene: str, source: str) -> str:
    """The page of a scene's catalogue in relation to that of another one."""
    folder = "" if scene == DEFAULT else f"{FOLDER}/{scene}/"
    return f"{'' if source == DEFAULT else '../../'}{folder}index.html"


def _ageless(files: Any, current: Mapping[str, str]) -> Any:
    """Input files, the raw and the current ones marked so that snakemake does not look at their times."""
    if isinstance(files, dict):
        return {name: _ageless(value, current) for name, value in files.items()}
    if isinstance(files, str):
        given = current.get(files, files)
        return _ancient(given) if given.startswith("/") or Path(given).is_absolute() else given
    return [_ageless(file, current) for file in files]


def _ancient(path: str) -> Any:
    from snakemake.io import ancient

    return ancient(path)


def _function_of(item: Any) -> InputFunction | None:
    """The function that a rule names as input, also where ``unpack`` flags it."""
    return item if callable(item) else getattr(_flagged(item), "callable", None)


def _flagged(item: Any) -> Any:
    """Snakemake's object with the flags of an input, which other objects may hold."""
    return getattr(item, "_file", item)


def _present(stage: Stage, wildcards: Any) -> list[str]:
    """The files that a job wrote beside its result."""
    return [path for pattern in stage.beside if Path(path := pattern.format(**wildcards)).is_file()]


def _files_below(folder: Path) -> list[str]:
    return sorted(str(path) for path in folder.rglob("*") if path.is_file())


def declared_resources(stage: Stage, given: Collection[str]) -> dict[str, Callable[[Any, int], int]]:
    """Memory [MB] and time [min] of a stage by attempt, without those that ``--set-resources`` gives for its rule."""
    declared = {"mem_mb": _times_attempt(stage.memory), "runtime": _times_attempt(stage.minutes)}
    names = {"mem_mb" if name == "mem" else name for name in given}
    return {name: value for name, value in declared.items() if name not in names}


def _times_attempt(value: int) -> Callable[[Any, int], int]:
    """A resource of which each retry has as much more as the first attempt had."""
    return lambda wildcards, attempt: value * attempt


def _existing(files: Any) -> str | list[str]:
    return str(files) if isinstance(files, str) else [str(file) for file in files]
