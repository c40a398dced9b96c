"""Mixtures of four basis spectra: closed form and random search, interrupted and not."""

from __future__ import annotations

import json
import os
import signal
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brdfpipe.errors import BrdfpipeError
from brdfpipe.spectra import colorimetry
from brdfpipe.spectra.colour_science import colour
from brdfpipe.spectra.recovery_methods import basis4, random_search

VIEW = colorimetry.weights("D65", 10)
RED = [40.0, 30.0, 20.0]


def lab_of(weights: np.ndarray, floor: float = 0.0) -> np.ndarray:
    table = VIEW
    return colorimetry.xyz_to_lab((floor + (1 - floor) * weights @ basis4.basis()) @ table.weights, table.white)


def test_the_basis_is_that_of_smits_with_peak_one() -> None:
    basis = basis4.basis()
    assert basis.shape == (4, 85)
    assert basis.max(axis=1).tolist() == [1, 1, 1, 1]
    assert basis.min() >= 0
    # Smits 1999, the values of ten bins, here at the centres from 380 to 720 nm, which colour-science rounds to four digits.
    printed = {
        0: [0.1012, 0.0515, 0, 0, 0, 0, 0.8325, 1.0149, 1.0149, 1.0149],
        1: [0, 0, 0.0273, 0.7937, 1, 0.9418, 0.1719, 0, 0, 0.0025],
        2: [1, 1, 0.8916, 0.3323, 0, 0, 0.0003, 0.0369, 0.0483, 0.0496],
        3: [0.9710, 0.9426, 1.0007, 1.0007, 1.0007, 1.0007, 0.1564, 0, 0, 0],
    }
    for row, values in printed.items():
        expected = np.interp(colorimetry.GRID, np.linspace(380, 720, 10), values)
        assert basis[row] == pytest.approx(expected / expected.max(), abs=1e-6)
    for name, spectrum in zip(("red", "green", "blue", "cyan"), basis, strict=True):
        peer = colour.recovery.SDS_SMITS1999[name]
        values = np.interp(colorimetry.GRID, peer.wavelengths, peer.values)
        assert spectrum == pytest.approx(values / values.max(), abs=1e-8)


@settings(deadline=None)
@given(st.lists(st.floats(0, 1), min_size=4, max_size=4))
def test_the_colour_of_every_mixture_is_recovered(weights: list[float]) -> None:
    basis = basis4.basis()
    mixture = np.array(weights) @ basis
    mixture /= max(mixture.max(), 1.0)
    xyz = mixture @ VIEW.weights
    recovered = basis4.closed_form(xyz, VIEW)
    assert recovered.reached.all()
    assert recovered.weights.min() >= 0
    assert recovered.reflectance.max() <= 1
    # At the very edge of reach the interval is closed by rounding, and the mixture cut to 1.
    assert recovered.reflectance @ VIEW.weights == pytest.approx(xyz[None], abs=1e-6)
    assert (np.diff(recovered.reflectance) ** 2).sum() <= (np.diff(mixture) ** 2).sum() + 1e-9


def test_no_mixture_of_the_colour_is_smoother() -> None:
    table = VIEW
    xyz = colorimetry.lab_to_xyz(RED, table.white)
    recovered = basis4.closed_form(xyz, VIEW)
    basis = basis4.basis()
    null = np.linalg.svd((basis @ table.weights).T)[2][3]
    smoothness = (np.diff(recovered.reflectance) ** 2).sum()
    for t in np.linspace(-0.3, 0.3, 61):
        other = recovered.weights[0] + t * null
        if other.min() >= 0 and (other @ basis).max() <= 1:
            assert (np.diff(other @ basis) ** 2).sum() >= smoothness - 1e-12


def test_colours_no_mixture_has_are_marked_and_do_not_disturb_the_others() -> None:
    table = VIEW
    recovered = basis4.closed_form(
        colorimetry.lab_to_xyz([RED, [50, 120, 0], [99, 0, 0], [np.nan, 0, 0]], table.white), VIEW
    )
    assert recovered.reached.tolist() == [True, False, False, False]
    assert np.isnan(recovered.reflectance[1:]).all()


def test_the_nearest_mixture_is_reachable_and_none_of_many_is_nearer() -> None:
    wanted = [70.0, -60.0, -50.0]
    near = basis4.nearest(wanted, VIEW)
    rng = np.random.default_rng(3)
    w = rng.random((20000, 4))
    w /= np.maximum((w @ basis4.basis()).max(axis=1, keepdims=True), 1)
    apart = colorimetry.delta_e_ab(near, wanted)
    assert colorimetry.delta_e_ab(lab_of(w), wanted).min() >= apart - 1e-6
    inside = np.array(near) * [1, 0.999, 0.999]
    assert basis4.closed_form(colorimetry.lab_to_xyz(inside, VIEW.white), VIEW).reached.all()


@pytest.mark.cases(1)
@pytest.mark.parametrize("method", random_search.SEARCHES)
@pytest.mark.parametrize("floor", [0.0, 0.0465])
def test_a_search_ends_below_its_threshold_at_the_stated_colour(method: str, floor: float) -> None:
    result = random_search.search(RED, VIEW, method=method, threshold=3.0, floor=floor)
    assert result.ended == "threshold"
    assert result.delta_e < 3
    assert result.weights.min() >= 0
    assert (result.weights @ basis4.basis()).max() <= 1 + 1e-12
    assert colorimetry.delta_e_ab(lab_of(result.weights, floor), RED) == pytest.approx(result.delta_e, rel=1e-9)


@pytest.mark.parametrize("method", random_search.SEARCHES)
def test_the_result_depends_on_the_seed_alone(method: str) -> None:
    first, again, other = (
        random_search.search(RED, VIEW, method=method, threshold=3.0, seed=seed).weights.tolist() for seed in (7, 7, 8)
    )
    assert first == again != other


def test_adaptive_steps_reach_thresholds_that_random_weights_do_not() -> None:
    result = random_search.search(RED, VIEW, method="adaptive4", threshold=1e-6)
    assert result.delta_e < 1e-6
    assert result.tried < 50_000


class _Killed(Exception):
    pass


def _killer(after: int):
    asked = iter(range(after + 1))

    def stop() -> bool:
        if next(asked, None) is None:
            raise _Killed
        return False

    return stop


@pytest.mark.cases(2)
@pytest.mark.parametrize(("method", "threshold"), [("random4", 3.0), ("adaptive4", 1e-5)])
@pytest.mark.parametrize("after", [1, 3])
def test_a_killed_search_resumes_to_the_same_result(tmp_path: Path, method: str, threshold: float, after: int) -> None:
    options = {"table": VIEW, "method": method, "threshold": threshold, "seed": 5}
    whole = random_search.search(RED, **options)
    checkpoint = tmp_path / "best.json"
    kills = 0
    while True:
        try:
            resumed = random_search.search(RED, **options, checkpoint=checkpoint, stop=_killer(after * 2**kills))
            break
        except _Killed:
            kills += 1
            assert json.loads(checkpoint.read_text(encoding="utf-8"))["state"][2] >= whole.delta_e
    assert kills > 0
    assert resumed.weights.tolist() == whole.weights.tolist()
    assert (resumed.delta_e, resumed.tried, resumed.ended) == (whole.delta_e, whole.tried, "threshold")
    assert not checkpoint.exists()


@pytest.mark.cases(2)
@pytest.mark.parametrize(
    "content", ["", "{", "[]", '{"problem": "another", "state": [1, [0, 0, 0, 0], 0.1, 0]}', '{"state": 3}']
)
def test_a_checkpoint_that_is_damaged_or_of_another_search_is_ignored(tmp_path: Path, content: str) -> None:
    checkpoint = tmp_path / "best.json"
    checkpoint.write_text(content, encoding="utf-8")
    options = {"table": VIEW, "threshold": 3.0}
    assert (
        random_search.search(RED, **options, checkpoint=checkpoint).weights.tolist()
        == random_search.search(RED, **options).weights.tolist()
    )


def test_a_request_to_stop_accepts_the_best_so_far(tmp_path: Path) -> None:
    asked = iter([False, False, True])
    result = random_search.search(RED, VIEW, threshold=1e-9, stop=lambda: next(asked))
    assert (result.ended, result.tried) == ("stopped", 3 * 4096)
    checkpoint, request = tmp_path / "best.json", tmp_path / "best.json.stop"
    result = random_search.search(RED, VIEW, threshold=1e-9, checkpoint=checkpoint, stop=lambda: bool(request.touch()))
    assert (result.ended, result.tried) == ("stopped", 4096)
    assert result.delta_e < 30
    assert not request.exists()


def test_a_stop_file_from_before_the_search_is_removed_without_effect(tmp_path: Path) -> None:
    request = tmp_path / "best.json.stop"
    request.touch()
    result = random_search.search(RED, VIEW, threshold=3.0, checkpoint=tmp_path / "best.json")
    assert result.ended == "threshold"
    assert not request.exists()


def test_a_colour_infinitely_far_from_all_mixtures_is_refused() -> None:
    with pytest.raises(BrdfpipeError, match="no mixture has a finite ΔE"):
        random_search.search([50.0, np.nan, 0.0], VIEW)


@pytest.mark.parametrize("method", random_search.SEARCHES)
def test_a_search_at_its_limit_continues_for_another_limit(tmp_path: Path, method: str) -> None:
    options = {"table": VIEW, "method": method, "threshold": 1e-12, "limit": 8192, "checkpoint": tmp_path / "best.json"}
    first, second = random_search.search(RED, **options), random_search.search(RED, **options)
    assert (first.ended, second.ended) == ("limit", "limit")
    assert (first.tried, second.tried) == (8192, 16384)
    assert second.delta_e <= first.delta_e
    if method == "random4":
        assert second.delta_e == random_search.search(RED, VIEW, threshold=1e-12, limit=16384).delta_e


def test_a_search_killed_before_its_limit_ends_with_the_same_result(tmp_path: Path) -> None:
    options = {"table": VIEW, "threshold": 1e-12, "limit": 40_000, "seed": 5}
    whole = random_search.search(RED, **options)
    with pytest.raises(_Killed):
        random_search.search(RED, **options, checkpoint=tmp_path / "best.json", stop=_killer(3))
    resumed = random_search.search(RED, **options, checkpoint=tmp_path / "best.json")
    assert (resumed.tried, resumed.delta_e, resumed.ended) == (whole.tried, whole.delta_e, "limit")


def _stopped(checkpoint: Path, threshold: float = 1e-9) -> dict[str, Any]:
    random_search.search(RED, VIEW, threshold=threshold, checkpoint=checkpoint, stop=lambda: True)
    kept: dict[str, Any] = json.loads(checkpoint.read_text(encoding="utf-8"))
    return kept


def test_another_threshold_is_another_search(tmp_path: Path) -> None:
    checkpoint = tmp_path / "best.json"
    _stopped(checkpoint)
    result = random_search.search(RED, VIEW, threshold=60.0, checkpoint=checkpoint, stop=lambda: True)
    assert result.tried == 4096
    assert not checkpoint.exists()


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (0, -3),
        (0, 0),
        (0, 1.5),
        (0, 10**30),
        (1, [0.1, 0.2]),
        (1, [0.1, 0.2, 0.3, float("nan")]),
        (1, [5.0, 0.0, 0.0, 0.0]),
        (1, [1.0, 1.0, 1.0, 1.0]),
        (1, [0.1, 0.2, 0.3, 0.4]),
        (2, 0.0),
        (2, float("nan")),
        (2, "near"),
        (3, 0.0),
        (3, float("inf")),
        (4, 7),
        (4, None),
    ],
)
def test_a_damaged_state_is_not_trusted(tmp_path: Path, place: int, value: object) -> None:
    checkpoint = tmp_path / "best.json"
    kept = _stopped(checkpoint)
    kept["state"][place] = value
    checkpoint.write_text(json.dumps(kept), encoding="utf-8")
    result = random_search.search(RED, VIEW, threshold=1e-9, checkpoint=checkpoint, stop=lambda: True)
    # From the start; a state taken up would have a block more.
    assert result.tried == 4096


def test_a_floor_may_differ_between_wavelengths() -> None:
    table, basis = VIEW, basis4.basis()
    floor, w = np.linspace(0.06, 0.04, 85), np.array([0.3, 0.2, 0.1, 0.2])
    truth = floor + (1 - floor) * (w @ basis)
    recovered = basis4.closed_form(truth @ table.weights, VIEW, floor=floor)
    assert recovered.reached.all()
    assert (recovered.reflectance >= floor).all()
    assert recovered.reflectance @ table.weights == pytest.approx((truth @ table.weights)[None], abs=1e-9)
    lab = colorimetry.xyz_to_lab(truth @ table.weights, table.white)
    assert random_search.search(lab, VIEW, method="adaptive4", threshold=1e-4, floor=floor).ended == "threshold"
    assert colorimetry.delta_e_ab(basis4.nearest(lab, VIEW, floor=floor), lab) < 1e-2


def test_an_interrupt_accepts_the_best_so_far_and_restores_the_handler() -> None:
    before = signal.getsignal(signal.SIGINT)
    asked = iter(range(100))

    def interrupt() -> bool:
        if next(asked) == 3:
            os.kill(os.getpid(), signal.SIGINT)
        return False

    result = random_search.search(RED, VIEW, threshold=1e-9, stop=interrupt)
    assert result.ended == "stopped"
    assert np.isfinite(result.delta_e)
    assert signal.getsignal(signal.SIGINT) is before


def test_a_search_runs_in_a_thread_that_gets_no_signals() -> None:
    results = []
    thread = threading.Thread(target=lambda: results.append(random_search.search(RED, VIEW, threshold=3.0)))
    thread.start()
    thread.join()
    assert results[0].ended == "threshold"


def test_a_search_ends_at_its_limit() -> None:
    result = random_search.search([50, 100, 0], VIEW, limit=10_000)
    assert (result.ended, result.tried) == ("limit", 12288)
