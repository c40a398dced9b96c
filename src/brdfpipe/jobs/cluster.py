"""What a run of snakemake on the node of a cluster needs beside what snakemake hands on to it.

A group job of a scheduler is a snakemake of its own, which gets no profile. So the settings of the default profile are made here.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from brdfpipe.jobs.index import record_apart
from brdfpipe.stages import STAGES

GROUPS = {"material": "materials", "calibration": "calibrations"}
"""Group of the stages, by the owner of their results: profiles say how many materials one job of the scheduler builds (``group-components``).

Materials share calibrations; in one group with them, all materials of a rig would be one job of the scheduler.
"""


def prepare(workflow: Any) -> None:
    """Group the jobs where they go to a scheduler, and change the settings of a run on a node; call it before snakemake plans."""
    if not workflow.local_exec:
        for rule in workflow.rules:
            if rule.name in STAGES and rule.group is None:
                rule.group = GROUPS.get(STAGES[rule.name].owner_kind)
    if workflow.remote_exec:
        _prepare_node(workflow)


def _prepare_node(workflow: Any) -> None:
    record_apart(Path.cwd())
    settings = workflow.execution_settings
    settings.use_threads = True  # else each stage would start a snakemake; now they share the warm workers of one pool
    settings.no_hooks = False  # the hook at the start preloads what the workers need
    settings.keep_going = True  # one bad material never stops the others of its group
    # The run that SLURM starts runs one more inside a job step; without this, one for each material.
    groups = workflow.group_settings
    groups.group_components = dict.fromkeys([*GROUPS.values(), groups.local_groupid], sys.maxsize)
