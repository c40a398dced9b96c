"""From frames of a turned mirror to a table of fibres."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rig_accuracy as accuracy
from click.testing import CliRunner

from brdfpipe.cli.main import main
from brdfpipe.geometry import unit_vector
from brdfpipe.rig.description import fibre_table, read_fibres
from brdfpipe.rig.emulator.camera_view import fibre_directions
from brdfpipe.rig.emulator.effects import Effects
from brdfpipe.rig.emulator.emulated_scan import make_run
from brdfpipe.rig.reduction.mirror_frames import MirrorError, calibrate_directions
from brdfpipe.rig.turned_mirror import grid


def angle(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Degrees between unit vectors."""
    return np.degrees(2 * np.arcsin(np.linalg.norm(one - other, axis=1) / 2))


def test_a_run_without_a_mirror_is_refused():
    plan = replace(accuracy.plan_of((550.0,), (10.0,), 12), runs=("etalon",))
    frames = accuracy.frames_of(plan, None)
    with pytest.raises(MirrorError, match=r"runs: \[target, mirror\]"):
        calibrate_directions(frames, plan.rig)
    with pytest.raises(MirrorError, match="another rig"):
        calibrate_directions(frames, replace(plan.rig, digest="x"))


def test_a_table_of_fibres_is_read_as_it_was_written(tmp_path: Path) -> None:
    fibres = accuracy.plan_of((550.0,), (10.0,), 12).rig.fibres
    (tmp_path / "fibres.csv").write_text(fibre_table(fibres, "a remark"))
    assert read_fibres(tmp_path / "fibres.csv") == fibres


@pytest.mark.slow
@pytest.mark.parametrize(("off", "seed"), [(0.3, 2), (0.7, 3)])
def test_emulated_frames_recover_directions_to_a_tenth_of_a_degree(off, seed):
    plan = replace(accuracy.plan_of(), runs=("target", "mirror"), aims=grid(20.0, 100.0))
    effects = Effects(fibre_directions=off)
    frames = accuracy.frames_of(plan, None, seed=seed, session=1, effects=effects)
    found = calibrate_directions(frames, plan.rig)
    count = len(plan.rig.fibres)
    error = angle(
        unit_vector(*(getattr(found.directions, name)[:count] for name in ("theta_s", "phi_s"))),
        unit_vector(*fibre_directions(plan.rig, effects, seed)),
    )
    known = found.directions.found[:count]
    assert known.sum() > 0.8 * count
    assert np.sqrt((error[known] ** 2).mean()) < 0.06
    assert np.percentile(error[known], 95) < 0.1
    assert 0.5 < np.sqrt(((error / found.directions.u[:count])[known] ** 2).mean()) < 1.3
    assert np.median(found.moved[known]) == pytest.approx(off, abs=0.05)


@pytest.mark.slow
def test_the_command_writes_a_table_from_an_emulated_run(tmp_path: Path) -> None:
    runner, bench, out = CliRunner(), tmp_path / "bench", tmp_path / "new.csv"
    assert runner.invoke(main, ["rig", "new", str(bench), "--fibres", "40"]).exit_code == 0
    text = (bench / "plan.yaml").read_text().replace("runs: [target, etalon, sample]", "runs: [target, mirror]")
    (bench / "plan.yaml").write_text(text)
    make_run(bench / "plan.yaml", tmp_path / "run", None, seed=1)
    result = runner.invoke(main, ["rig", "directions", str(tmp_path / "run"), "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert "of 40 fibres" in result.output
    assert all(fibre.u < 0.5 for fibre in read_fibres(out))
    again = runner.invoke(main, ["rig", "directions", str(tmp_path / "run"), "--out", str(out)])
    assert again.exit_code == 2
