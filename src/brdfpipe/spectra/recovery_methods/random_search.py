"""Methods ``random4`` and ``adaptive4``: mixtures of four basis spectra by random search, which can be stopped and resumed."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from brdfpipe import store
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array
from brdfpipe.spectra.colorimetry import Weights
from brdfpipe.spectra.recovery_methods.basis4 import ROUNDING, distance_to, peaks, rescaled

SEARCHES = ("random4", "adaptive4")
"""Methods of :func:`search`."""
THRESHOLD = 1.0
"""Default ΔE*ab at which a search ends."""
LIMIT = {"random4": 20_000_000, "adaptive4": 200_000}
"""Weights tried at most in one go: some ten seconds, and as many as the steps need to shrink to nothing."""

_BLOCK = {"random4": 4096, "adaptive4": 64}
_FIRST_STEP = 0.25
_WIDER, _NARROWER = 1.5, 0.6
_LEAST_STEP = 1e-9
_MOST_BLOCKS = 2**40


class SearchResult(NamedTuple):
    """Result of a search."""

    weights: Array
    """(4,)"""
    delta_e: float
    """ΔE*ab to the given colour"""
    tried: int
    """number of weights tried"""
    ended: str
    """``threshold`` reached, ``limit`` of trials, or ``stopped`` on request"""


class _State(NamedTuple):
    block: int
    """blocks done"""
    weights: tuple[float, ...]
    delta_e: float
    step: float
    since: int
    """blocks that do not count towards the limit: those before the search was continued after reaching it"""


def search(
    lab: ArrayLike,
    table: Weights,
    *,
    method: str = "random4",
    threshold: float = THRESHOLD,
    seed: int = 0,
    floor: ArrayLike = 0.0,
    limit: int | None = None,
    checkpoint: Path | None = None,
    stop: Callable[[], bool] | None = None,
    progress: bool = False,
) -> SearchResult:
    """Random search for a mixture of the four basis spectra that has a colour.

    Parameters
    ----------
    lab : (3,) the colour wanted
    table : of :func:`brdfpipe.spectra.colorimetry.weights`
    method : ``random4``, weights drawn anew each time from [0, 1]⁴ and divided by the largest reflectance where that exceeds 1;
        ``adaptive4``, random steps from the best so far, wider after a success and narrower after a failure
    threshold : ΔE*ab below which the search ends
    seed : of the random numbers; one seed has one answer
    floor : () or (n,), reflectance that wavelengths have at least (specular), 0 <= floor < 1
    limit : weights tried at most; by default :data:`LIMIT`
    checkpoint : JSON file with the best so far, rewritten whole after every improvement and removed once the threshold is reached.
        A search that was killed resumes from it with the same result; one that was stopped or reached its limit continues from it,
        for another ``limit``. A damaged file, or one of another search, is dropped
    stop : called after every block; once true, the best so far is accepted. So it is on the first SIGINT, and when a file named
        like ``checkpoint`` with ``.stop`` appended appears; one from before the search is removed
    progress : show a progress bar on a terminal

    Returns
    -------
    SearchResult

    Raises
    ------
    BrdfpipeError : no mixture has a finite ΔE to ``lab``.

    Notes
    -----
    Each block has a random generator of its own, seeded with the seed and the block's number, so that a search can resume.

    References
    ----------
    Patent US 9,395,299 (CRF), reconstruction of a spectrum from L*a*b*.
    """
    from tqdm import tqdm

    wanted = np.asarray(lab, dtype=float)
    distance = distance_to(wanted, table, floor)
    problem = store.canonical_json(
        {
            "lab": wanted.tolist(),
            "illuminant": table.illuminant,
            "observer": table.observer,
            "method": method,
            "threshold": threshold,
            "seed": seed,
            "floor": np.asarray(floor, dtype=float).tolist(),
        }
    )
    state, ended = _resumed(checkpoint, problem, distance), "threshold"
    most = LIMIT[method] if limit is None else limit
    _stop_file(checkpoint)
    bar = tqdm(desc="spectrum", unit="mixture", unit_scale=True, disable=None if progress else True)
    with _interrupts() as interrupted, bar:
        while state.delta_e >= threshold:
            after = _advanced(method, state, seed, distance)
            if not np.isfinite(after.delta_e):
                raise BrdfpipeError(f"no mixture has a finite ΔE to L*a*b* {wanted.tolist()}")
            if after.delta_e < state.delta_e:
                _save(checkpoint, problem, after)
            state = after
            bar.set_postfix_str(f"ΔE {state.delta_e:.3g}", refresh=False)
            bar.update(_BLOCK[method])
            if state.delta_e < threshold:
                break
            if interrupted() or (stop is not None and stop()) or _stop_file(checkpoint):
                ended = "stopped"
                break
            if (state.block - state.since) * _BLOCK[method] >= most:
                ended = "limit"
                break
    if ended != "threshold":
        # At the limit the steps have shrunk to nothing; to go on they start wide again.
        step = _FIRST_STEP if ended == "limit" else state.step
        _save(checkpoint, problem, state._replace(step=step, since=state.block))
    elif checkpoint is not None:
        checkpoint.unlink(missing_ok=True)
    return SearchResult(np.array(state.weights), state.delta_e, state.block * _BLOCK[method], ended)


def _advanced(method: str, state: _State, seed: int, distance: Callable[[Array], Array]) -> _State:
    """The state after one more block of weights: ``random4`` draws them anew, ``adaptive4`` around the best so far."""
    rng, count, adaptive = np.random.default_rng([seed, state.block]), _BLOCK[method], method == "adaptive4"
    if adaptive and state.block > 0:
        w = np.array(state.weights) + state.step * rng.standard_normal((count, 4))
    else:
        w = rng.random((count, 4))
    w = rescaled(np.clip(w, 0.0, 1.0)) if adaptive else w
    delta_e, step = distance(w), state.step
    best = int(np.argmin(delta_e))
    improved = delta_e[best] < state.delta_e
    if adaptive:
        step = min(step * _WIDER, _FIRST_STEP) if improved else max(step * _NARROWER, _LEAST_STEP)
    state = state._replace(block=state.block + 1, step=step)
    if not improved:
        return state
    weights = w[best] if adaptive else rescaled(w[best : best + 1])[0]
    return state._replace(weights=tuple(weights.tolist()), delta_e=float(delta_e[best]))


def _save(checkpoint: Path | None, problem: str, state: _State) -> None:
    if checkpoint is not None:
        store.write_text(checkpoint, json.dumps({"problem": problem, "state": state}) + "\n")


def _resumed(checkpoint: Path | None, problem: str, distance: Callable[[Array], Array]) -> _State:
    """State of an interrupted search; a new one if the checkpoint is missing, damaged or of another search."""
    fresh = _State(0, (0.0, 0.0, 0.0, 0.0), float("inf"), _FIRST_STEP, 0)
    if checkpoint is None:
        return fresh
    try:
        stored: Any = json.loads(checkpoint.read_text(encoding="utf-8"))
        if stored["problem"] == problem and _is_sound(state := _State(*stored["state"]), distance):
            return state._replace(weights=tuple(state.weights))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        pass
    checkpoint.unlink(missing_ok=True)
    return fresh


def _is_sound(state: _State, distance: Callable[[Array], Array]) -> bool:
    """Whether a state from a file is consistent: its ΔE is that of its mixture."""
    whole = all(type(count) is int for count in (state.block, state.since))
    if not whole or not 0 <= state.since <= state.block <= _MOST_BLOCKS or state.block == 0:
        return False
    w = np.array(state.weights, dtype=float)
    if w.shape != (4,) or not ((w >= 0) & (w <= 1)).all() or not 0 < state.step <= _FIRST_STEP:
        return False
    # A product of many rows rounds otherwise than that of one.
    mixes = bool((w @ peaks()).max() <= 1 + ROUNDING)
    return mixes and bool(abs(distance(w[None])[0] - state.delta_e) <= ROUNDING * (1 + state.delta_e))


def _stop_file(checkpoint: Path | None) -> bool:
    if checkpoint is None:
        return False
    request = checkpoint.with_name(checkpoint.name + ".stop")
    requested = request.exists()
    request.unlink(missing_ok=True)
    return requested


@contextmanager
def _interrupts() -> Iterator[Callable[[], bool]]:
    """Whether SIGINT was received; a second one interrupts as usual. Only the main thread receives signals."""
    received = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield received.is_set
        return
    usual = signal.getsignal(signal.SIGINT) or signal.default_int_handler

    def handle(number: int, frame: Any) -> None:
        received.set()
        signal.signal(signal.SIGINT, usual)

    signal.signal(signal.SIGINT, handle)
    try:
        yield received.is_set
    finally:
        signal.signal(signal.SIGINT, usual)
