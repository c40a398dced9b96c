"""What snakemake on a node of a cluster is told, and what the profiles say; tests/cluster runs them on a real scheduler."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

from brdfpipe.jobs import cluster
from brdfpipe.jobs.rules import declared_resources
from brdfpipe.stages import STAGES

PROFILES = Path(__file__).parents[2] / "workflow" / "profiles"


@pytest.mark.parametrize("remote", [False, True])
def test_the_settings_of_a_run_change_only_on_a_node(
    remote: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    settings = SimpleNamespace(use_threads=False, no_hooks=True, keep_going=False)
    groups = SimpleNamespace(group_components={"materials": 2}, local_groupid="of-this-job")
    cluster.prepare(
        SimpleNamespace(local_exec=True, remote_exec=remote, execution_settings=settings, group_settings=groups)
    )
    assert set(groups.group_components) == ({"of-this-job", *cluster.GROUPS.values()} if remote else {"materials"})
    assert (settings.use_threads, settings.no_hooks, settings.keep_going) == (remote, not remote, remote)


@pytest.mark.parametrize("local", [False, True])
def test_stages_are_grouped_only_where_jobs_go_to_a_scheduler(local: bool) -> None:
    rules = [SimpleNamespace(name=name, group=None) for name in ("surface", "calibration", "catalogue", "all")]
    named = SimpleNamespace(name="facets", group="my-own")
    cluster.prepare(SimpleNamespace(local_exec=local, remote_exec=False, rules=[*rules, named]))
    grouped = [None] * 4 if local else ["materials", "calibrations", None, None]
    assert [rule.group for rule in rules] == grouped
    assert named.group == "my-own"


@pytest.mark.parametrize("name", ["slurm", "generic"])
def test_the_profiles_of_clusters_differ_from_the_default_one_where_a_cluster_does(name: str) -> None:
    default, profile = _profile("default"), _profile(name)
    # Threads are set on the node.
    assert {key for key in default if profile.get(key) != default[key]} == {
        "force-use-threads",
        "retries",
        "latency-wait",
    }
    assert all(re.fullmatch(r"\w+=\d+", entry) for entry in profile["group-components"])
    groups = {entry.partition("=")[0] for entry in profile["group-components"]}
    assert groups == set(cluster.GROUPS.values())


def test_each_profile_of_a_cluster_groups_alike() -> None:
    slurm, generic = _profile("slurm"), _profile("generic")
    shared = {key for key in slurm if not key.startswith(("slurm-", "executor"))}
    assert {key: slurm[key] for key in shared} == {key: generic[key] for key in shared}


def test_stages_of_a_catalogue_are_jobs_of_their_own_and_others_are_grouped() -> None:
    assert {stage.owner_kind for stage in STAGES.values()} - cluster.GROUPS.keys() == {"catalogue"}


def test_every_group_of_stages_asks_for_some_time() -> None:
    # A scheduler may take no time at all for no limit, or refuse it. The last stage of an owner is always in its group.
    for last in ("summary", "calibration", "catalogue"):
        assert STAGES[last].minutes > 0


def _profile(name: str) -> dict[str, Any]:
    profile: dict[str, Any] = yaml.safe_load((PROFILES / name / "config.yaml").read_text())
    return profile


@pytest.mark.parametrize(
    ("given", "declared"),
    [
        ({}, {"mem_mb", "runtime"}),
        ({"mem_mb": 5}, {"runtime"}),
        ({"mem": "5 GB"}, {"runtime"}),
        ({"runtime": 5, "mem_mb": 5}, set()),
    ],
)
def test_resources_given_to_snakemake_replace_those_of_a_stage(given: dict[str, Any], declared: set[str]) -> None:
    stage = STAGES["appearance"]
    resources = declared_resources(stage, given)
    assert resources.keys() == declared
    for name, value in {"mem_mb": stage.memory, "runtime": stage.minutes}.items():
        if name in declared:
            assert [resources[name](None, attempt) for attempt in (1, 2)] == [value, 2 * value]
