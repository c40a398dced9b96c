"""Jobs of one material follow each other, and no core waits while a job is ready."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from brdfpipe.jobs.scheduling import Queue


def queue(**jobs: str) -> Queue[str]:
    made: Queue[str] = Queue()
    made.add((owner, f"{owner}{letter}") for owner, letters in jobs.items() for letter in letters)
    return made


def test_a_free_core_goes_on_with_its_material():
    waiting = queue(a="12", b="12", c="1")
    assert waiting.take(2, ()) == ["a1", "b1"]
    assert waiting.take(1, ["b"]) == ["a2"]
    waiting.add([("a", "a3")])
    assert waiting.take(1, ["b"]) == ["a3"]
    assert waiting.take(1, ["b"]) == ["c1"]


def test_a_material_is_shared_only_where_no_other_is_ready():
    waiting = queue(a="123", b="1")
    assert waiting.take(3, ()) == ["a1", "b1", "a2"]
    assert waiting.take(3, ["a", "b"]) == ["a3"]
    assert waiting.take(1, ()) == []


def test_a_job_may_come_again():
    waiting = queue(a="1")
    waiting.take(1, ())
    waiting.add([("a", "a1")])
    assert waiting.take(1, ()) == ["a1"]


def test_every_job_is_taken_once_and_few_materials_are_under_way():
    random = np.random.default_rng(3)
    chains = {f"m{number:02d}": [f"m{number:02d}-{job}" for job in range(6)] for number in range(40)}
    waiting: Queue[str] = Queue()
    waiting.add((owner, jobs[0]) for owner, jobs in chains.items())
    running: list[str] = []
    done: list[str] = []
    while len(done) < 240:
        running += waiting.take(3 - len(running), [job[:3] for job in running])
        assert len(running) == min(3, 240 - len(done)) or len(chains) * 6 - len(done) < 18
        ended = running.pop(random.integers(len(running)))
        done.append(ended)
        jobs = chains[ended[:3]]
        waiting.add((ended[:3], job) for job in jobs[jobs.index(ended) + 1 :][:1])
        begun = {job[:3] for job in done} - {job[:3] for job in done if job.endswith("5")}
        assert len(begun) <= 3
    assert len(set(done)) == 240


def test_the_workflow_has_no_pipes_and_services_whose_search_is_left_out():
    rules = sorted((Path(__file__).parents[2] / "workflow" / "rules").glob("*.smk"))
    assert len(rules) > 5
    assert [rule.name for rule in rules if re.search(r"\b(pipe|service)\(", rule.read_text())] == []
