"""Reflectance spectra from colours as mixtures of four basis spectra: in closed form, and by random search.

The mixture is S = Σ wᵢ Sᵢ with w >= 0 and S <= 1, of :func:`brdfpipe.spectra.colorimetry.basis`. Four weights for three
tristimulus values leave one freedom: the closed form takes the smoothest spectrum, the searches what they come upon first.
"""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from brdfpipe import store
from brdfpipe.geometry import Array
from brdfpipe.spectra import colorimetry

SEARCHES = ("random4", "adaptive4")
"""Methods of :func:`search`."""
THRESHOLD = 1.0
"""ΔE*ab at which a search ends unless told otherwise."""
LIMIT = {"random4": 20_000_000, "adaptive4": 200_000}
"""Weights tried at most: some ten seconds, and as many as the steps need to shrink to nothing."""

_BLOCK = {"random4": 4096, "adaptive4": 64}
_FIRST_STEP = 0.25
_WIDER, _NARROWER = 1.5, 0.6
_LEAST_STEP = 1e-9
_ROUNDING = 1e-9


class Mixtures(NamedTuple):
    """Mixtures of the basis spectra for many colours."""

    weights: Array
    """(B, 4)"""
    reflectance: Array
    """(B, n) in [0, 1]; NaN where no mixture has the colour."""
    reached: NDArray[np.bool_]
    """(B,)"""


class Found(NamedTuple):
    """Where a search ended."""

    weights: Array
    """(4,)"""
    delta_e: float
    """ΔE*ab to the colour wanted"""
    tried: int
    """weights tried altogether"""
    ended: str
    """``threshold`` reached, ``limit`` of trials, or ``stopped`` on request"""


class _State(NamedTuple):
    block: int
    """blocks done"""
    weights: tuple[float, ...]
    delta_e: float
    step: float


def closed_form(xyz: ArrayLike, *, illuminant: str, observer: int) -> Mixtures:
    """Smoothest mixtures that have given colours exactly (method ``basis4``).

    Parameters
    ----------
    xyz : (B, 3) tristimulus values, Y = 100 for the perfect diffuser
    illuminant, observer : see :func:`brdfpipe.spectra.colorimetry.weights`

    Returns
    -------
    Mixtures : NaN and ``reached`` False where no mixture within [0, 1] has the colour

    Notes
    -----
    w = w₀ + t v, v the null vector of the basis' tristimulus values. w >= 0 and S <= 1 leave an interval of t; within it
    Σ (S_{i+1} − S_i)², a parabola in t, is smallest.
    """
    basis = colorimetry.basis()[1]
    primaries = basis @ colorimetry.weights(illuminant, observer).weights
    colours = np.atleast_2d(np.asarray(xyz, dtype=float))
    w_0 = colours @ np.linalg.pinv(primaries)
    null = np.linalg.svd(primaries.T)[2][3]
    s_0, along = w_0 @ basis, null @ basis
    offset = np.concatenate([w_0, 1 - s_0], axis=1)
    slope = np.concatenate([null, -along])
    # offset + t slope >= 0 for every weight and wavelength.
    with np.errstate(divide="ignore", invalid="ignore"):
        bound = -offset / slope
    lowest = np.where(slope > 0, bound, -np.inf).max(axis=1)
    highest = np.where(slope < 0, bound, np.inf).min(axis=1)
    still = (offset[:, slope == 0] >= 0).all(axis=1)
    smoothest = -(np.diff(s_0, axis=1) @ np.diff(along)) / (np.diff(along) @ np.diff(along))
    reached = still & (lowest <= highest + _ROUNDING) & np.isfinite(colours).all(axis=1)
    t = np.where(reached, np.clip(smoothest, lowest, np.maximum(lowest, highest)), np.nan)
    weights = np.where(reached[:, None], np.maximum(w_0 + t[:, None] * null, 0.0), np.nan)
    return Mixtures(weights, np.minimum(weights @ basis, 1.0), np.asarray(reached))


def search(
    lab: ArrayLike,
    *,
    illuminant: str,
    observer: int,
    method: str = "random4",
    threshold: float = THRESHOLD,
    seed: int = 0,
    floor: float = 0.0,
    limit: int | None = None,
    checkpoint: Path | None = None,
    stop: Callable[[], bool] | None = None,
    progress: bool = False,
) -> Found:
    """Random search for a mixture of the four basis spectra that has a colour.

    Parameters
    ----------
    lab : (3,) the colour wanted
    illuminant, observer : see :func:`brdfpipe.spectra.colorimetry.weights`
    method : ``random4``, weights drawn anew each time from [0, 1]⁴ and divided by the largest reflectance where that exceeds 1;
        ``adaptive4``, random steps from the best so far, wider after a success and narrower after a failure
    threshold : ΔE*ab below which the search ends
    seed : of the random numbers; one seed has one answer
    floor : reflectance every wavelength has at least (specular) [1]
    limit : weights tried at most; by default :data:`LIMIT`
    checkpoint : JSON file that keeps the best so far, rewritten whole after every improvement and removed at the end. A search
        that was killed resumes from it and ends where it would have ended. A file of another search is ignored
    stop : asked now and then; once true, the best so far is accepted. So it is on the first SIGINT, and when a file named like
        ``checkpoint`` with ``.stop`` appended appears
    progress : show a progress bar on a terminal

    Returns
    -------
    Found

    Notes
    -----
    Numbers of each block come from a generator of their own, seeded with the seed and the block's number: to resume needs
    nothing but that number.

    References
    ----------
    Patent US 9,395,299 (CRF), reconstruction of a spectrum from L*a*b*.
    """
    wanted = np.asarray(lab, dtype=float)
    distance = _distance(wanted, illuminant, observer, floor)
    problem = _problem(wanted, illuminant, observer, method, seed, floor)
    state, ended = _resumed(checkpoint, problem), "threshold"
    most = LIMIT[method] if limit is None else limit
    with _interrupts() as interrupted, _bar(progress) as show:
        while state.delta_e >= threshold:
            if interrupted() or (stop is not None and stop()) or _stop_file(checkpoint):
                ended = "stopped"
                break
            if state.block * _BLOCK[method] >= most:
                ended = "limit"
                break
            after = _ADVANCE[method](state, seed, distance)
            if checkpoint is not None and after.delta_e < state.delta_e:
                store.write_text(checkpoint, json.dumps({"problem": problem, "state": after}) + "\n")
            state = after
            show(_BLOCK[method], state.delta_e)
    if checkpoint is not None:
        checkpoint.unlink(missing_ok=True)
    return Found(np.array(state.weights), state.delta_e, state.block * _BLOCK[method], ended)


def nearest(lab: ArrayLike, *, illuminant: str, observer: int, floor: float = 0.0) -> Array:
    """Colour (3,) of a mixture nearest to a given one by ΔE*ab."""
    from scipy.optimize import LinearConstraint, minimize

    wanted, basis = np.asarray(lab, dtype=float), colorimetry.basis()[1]
    distance = _distance(wanted, illuminant, observer, floor, rescale=False)
    table = colorimetry.weights(illuminant, observer)
    found = minimize(  # type: ignore[call-overload]
        lambda w: float(distance(w[None])[0] ** 2),
        np.full(4, 0.3),
        bounds=[(0, 1)] * 4,
        constraints=LinearConstraint(basis.T, -np.inf, 1.0),
        method="SLSQP",
        options={"maxiter": 300, "ftol": 1e-10},
    )
    w = np.clip(found.x, 0, 1)
    s = floor + (1 - floor) * (w / max(float((w @ basis).max()), 1.0)) @ basis
    return colorimetry.xyz_to_lab(s @ table.weights, table.white)


def _advance_random(state: _State, seed: int, distance: Callable[[Array], Array]) -> _State:
    w = np.random.default_rng([seed, state.block]).random((_BLOCK["random4"], 4))
    delta_e = distance(w)
    best = int(np.argmin(delta_e))
    if delta_e[best] < state.delta_e:
        return _State(state.block + 1, tuple(_rescaled(w[best : best + 1])[0].tolist()), float(delta_e[best]), 0.0)
    return state._replace(block=state.block + 1)


def _advance_adaptive(state: _State, seed: int, distance: Callable[[Array], Array]) -> _State:
    rng = np.random.default_rng([seed, state.block])
    count = _BLOCK["adaptive4"]
    first = state.block == 0
    w = rng.random((count, 4)) if first else np.array(state.weights) + state.step * rng.standard_normal((count, 4))
    w = _rescaled(np.clip(w, 0.0, 1.0))
    delta_e = distance(w)
    best = int(np.argmin(delta_e))
    if delta_e[best] < state.delta_e:
        step = _FIRST_STEP if first else min(state.step * _WIDER, _FIRST_STEP)
        return _State(state.block + 1, tuple(w[best].tolist()), float(delta_e[best]), step)
    return state._replace(block=state.block + 1, step=max(state.step * _NARROWER, _LEAST_STEP))


_ADVANCE: dict[str, Callable[[_State, int, Callable[[Array], Array]], _State]] = {
    "random4": _advance_random,
    "adaptive4": _advance_adaptive,
}


def _distance(
    wanted: Array, illuminant: str, observer: int, floor: float, rescale: bool = True
) -> Callable[[Array], Array]:
    """ΔE*ab to a colour, of weights (B, 4)."""
    table = colorimetry.weights(illuminant, observer)
    primaries = colorimetry.basis()[1] @ table.weights

    def distance(w: Array) -> Array:
        xyz = floor * table.white + (1 - floor) * (_rescaled(w) if rescale else w) @ primaries
        return colorimetry.delta_e_ab(colorimetry.xyz_to_lab(xyz, table.white), wanted)

    return distance


def _rescaled(w: Array) -> Array:
    scaled: Array = w / np.maximum((w @ _peaks()).max(axis=1, keepdims=True), 1.0)
    return scaled


@cache
def _peaks() -> Array:
    """The basis at those wavelengths where a mixture can be largest: no other lies below one of them throughout."""
    basis = colorimetry.basis()[1].T
    unique = np.unique(basis, axis=0)
    dominated = [(np.delete(unique, i, axis=0) >= row).all(axis=1).any() for i, row in enumerate(unique)]
    kept: Array = unique[~np.array(dominated)].T
    kept.setflags(write=False)
    return kept


def _problem(lab: Array, illuminant: str, observer: int, method: str, seed: int, floor: float) -> str:
    return store.canonical_json(
        {
            "lab": lab.tolist(),
            "illuminant": illuminant,
            "observer": observer,
            "method": method,
            "seed": seed,
            "floor": floor,
        }
    )


def _resumed(checkpoint: Path | None, problem: str) -> _State:
    fresh = _State(0, (0.0, 0.0, 0.0, 0.0), float("inf"), _FIRST_STEP)
    if checkpoint is None:
        return fresh
    try:
        kept: Any = json.loads(checkpoint.read_text(encoding="utf-8"))
        block, weights, delta_e, step = kept["state"]
        if kept["problem"] == problem:
            return _State(int(block), tuple(float(w) for w in weights), float(delta_e), float(step))
    except (OSError, ValueError, KeyError, TypeError):
        # Lost or damaged: the search from the start has the same answer.
        return fresh
    return fresh


def _stop_file(checkpoint: Path | None) -> bool:
    if checkpoint is None:
        return False
    request = checkpoint.with_name(checkpoint.name + ".stop")
    found = request.exists()
    request.unlink(missing_ok=True)
    return found


@contextmanager
def _interrupts() -> Iterator[Callable[[], bool]]:
    """Whether SIGINT came since; a second one interrupts as ever. Threads other than the first get no signals."""
    seen = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield seen.is_set
        return
    usual = signal.getsignal(signal.SIGINT) or signal.default_int_handler

    def handle(number: int, frame: Any) -> None:
        seen.set()
        signal.signal(signal.SIGINT, usual)

    signal.signal(signal.SIGINT, handle)
    try:
        yield seen.is_set
    finally:
        signal.signal(signal.SIGINT, usual)


@contextmanager
def _bar(progress: bool) -> Iterator[Callable[[int, float], None]]:
    from tqdm import tqdm

    with tqdm(desc="spectrum", unit="mixture", unit_scale=True, disable=None if progress else True) as bar:

        def show(count: int, delta_e: float) -> None:
            bar.set_postfix_str(f"ΔE {delta_e:.3g}", refresh=False)
            bar.update(count)

        yield show
