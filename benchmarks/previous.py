"""What became slower or less accurate since the measurement that is kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

SLOWER = 1.5
"""Time over that of the reference in the same run, against what it was before, above which an option is slower."""
LESS_ACCURATE = 1.1
"""Error against what it was before, above which an option is less accurate."""

Row = Mapping[str, Any]
"""What was measured of one option of a choice, as JSON keeps it.

``choice`` and ``option`` are its names. ``relative_time`` has by name of an action its time over that of the reference option in the same
run. ``errors`` has by name ``value`` >= 0, and ``negligible``: a change that says nothing, such as rounding or the noise of a reference;
0 if it is left out.
"""


def compare(previous: Sequence[Row], rows: Sequence[Row]) -> list[str]:
    """One sentence for each figure that is worse than before, and for each option or figure that is no longer measured.

    Parameters
    ----------
    previous, rows : of the kept measurement, and of the new one; new options and new figures are not judged

    Notes
    -----
    Times are compared as ratios to a reference in the same run, because seconds depend on the machine and on what else it does.
    """
    new = {(row["choice"], row["option"]): row for row in rows}
    found = []
    for old in previous:
        name = f"{old['choice']}, {old['option']}"
        row = new.get((old["choice"], old["option"]))
        if row is None:
            found.append(f"{name}: no longer measured")
            continue
        found += [f"{name}: {text}" for text in _slower(old["relative_time"], row["relative_time"])]
        found += [f"{name}: {text}" for text in _less_accurate(old["errors"], row["errors"])]
    return found


def _slower(previous: Mapping[str, float], now: Mapping[str, float]) -> list[str]:
    found = []
    for action, before in previous.items():
        if action not in now:
            found.append(f"the time of {action} is no longer measured")
        elif now[action] > SLOWER * before:
            found.append(f"{action} takes {now[action]:.3g} times its reference, before {before:.3g} times")
    return found


def _less_accurate(previous: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    found = []
    for error, before in previous.items():
        if error not in now:
            found.append(f"the error {error} is no longer measured")
            continue
        value, was = now[error]["value"], before["value"]
        # Written so that an error that is not a number counts as worse.
        if not (value <= LESS_ACCURATE * was or value - was <= now[error].get("negligible", 0.0)):
            found.append(f"{error} is {value:.3g}, before {was:.3g}")
    return found
