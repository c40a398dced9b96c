from pathlib import Path

from brdfpipe.jobs import cluster, scheduling
from brdfpipe.jobs.rules import Pipeline
from brdfpipe.jobs.staleness import force_stale
from brdfpipe.stages import EXPORTS

pipeline = Pipeline(config, Path(workflow.basedir) / "workflow" / "scripts")
results_of, raw_file = pipeline.results_of, pipeline.raw_file


wildcard_constraints:
    scene="(scenes/[A-Za-z0-9][A-Za-z0-9._-]*/)?",
    material="[A-Za-z0-9][A-Za-z0-9._-]*",
    calibration="[A-Za-z0-9][A-Za-z0-9._-]*",
    scan=r"\d+",
    load="sample|etalon",
    side="reflection|transmission",
    incidence="[0-9.]+",


# No job of its own: each rule inherits this one. Its log, params, message and memory follow from its entry in brdfpipe/stages.py.
rule stage_template:
    run:
        pipeline.run(rule, wildcards, input, output, params)


onstart:
    pipeline.preload(workflow.dag.needrun_jobs())


include: "workflow/rules/predicted.smk"
include: "workflow/rules/flake.smk"
include: "workflow/rules/imported.smk"
include: "workflow/rules/rig.smk"
include: "workflow/rules/outputs.smk"
include: "workflow/rules/catalogue.smk"


pipeline.declare_stage_properties(workflow)
pipeline.before_planning(lambda pipeline: cluster.prepare(workflow))
pipeline.before_planning(lambda pipeline: force_stale(pipeline, workflow))
scheduling.by_material()


rule all:
    default_target: True
    input:
        pipeline.targets,
