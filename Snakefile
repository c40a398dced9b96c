from pathlib import Path

from brdfpipe.jobs.rules import Stages

stages = Stages(config, Path(workflow.basedir) / "workflow" / "scripts")


wildcard_constraints:
    material="[A-Za-z0-9][A-Za-z0-9._-]*",


onstart:
    stages.preload(workflow.dag.needrun_jobs())


include: "workflow/rules/catalogue.smk"
include: "workflow/rules/predicted.smk"
include: "workflow/rules/flake.smk"
include: "workflow/rules/rig.smk"
include: "workflow/rules/outputs.smk"


rule all:
    default_target: True
    input:
        rules.catalogue.output,
        # A deleted file is made again only where it is asked for.
        stages.files(),
