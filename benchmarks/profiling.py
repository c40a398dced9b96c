"""What benchmarks have in common: processor time of an action, and where in the package it goes."""

from __future__ import annotations

import cProfile
import pstats
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

MOST = 16
"""Functions of a profile that are worth reading."""


def best(action: Callable[[], Any], repeats: int) -> float:
    """Least processor time of several runs: what another process takes from the core does not count."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        action()
        times.append(time.process_time() - begin)
    return min(times)


def profile(action: Callable[[], Any], share: float = 0.01) -> list[dict[str, Any]]:
    """The package's functions that take more than a share of the time, costliest first. Element-wise numpy counts as their own."""
    profiler = cProfile.Profile()
    profiler.runcall(action)
    stats: Any = pstats.Stats(profiler)
    rows = [
        {
            "function": f"{Path(file).stem}.{name}",
            "calls": calls,
            "own_s": round(own, 4),
            "with_callees_s": round(cumulative, 4),
        }
        for (file, _, name), (_, calls, own, cumulative, _) in stats.stats.items()
        if "brdfpipe" in Path(file).parts and cumulative > share * stats.total_tt
    ]
    return sorted(rows, key=lambda row: -float(row["with_callees_s"]))


def lines(rows: Sequence[dict[str, Any]]) -> list[str]:
    """The same as a person reads it."""
    return [
        f"{'own s':>8}{'all s':>8}  function",
        *(f"{row['own_s']:8.3f}{row['with_callees_s']:8.3f}  {row['function']}" for row in rows),
    ]
