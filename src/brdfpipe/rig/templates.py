"""A rig to start from: commented descriptions of a bench like that of the Keldysh preprint, and a table of its fibres."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from brdfpipe import installation, store
from brdfpipe.errors import InputError
from brdfpipe.rig.description import COLUMNS

MIN_THETA_S, MAX_THETA_S = 12.0, 105.0
"""Range of the fibres' angles from the mirror direction [degree]; the lens sees smaller ones."""

GOLDEN_ANGLE = 180 * (3 - 5**0.5)
"""Degrees from the azimuth of one fibre to the next: no two fibres share an azimuth."""

SPACING = 4.5
"""Distance of the ends of fibres on the screen [mm], 13 pixels."""

_COLUMNS, _FIRST_COLUMN, _ROWS = 5, 31.0, 17
_REFERENCE = (49.0, 36.0)

MAX_FIBRES = 2 * _COLUMNS * _ROWS - 1
"""Number of places on the screen beside the disc and the reference spot."""


def start(folder: Path, fibres: int = 150) -> Path:
    """Write ``rig.yaml``, ``fibres.csv`` (1 to :data:`MAX_FIBRES` fibres) and ``plan.yaml`` to start from; return the plan's path.

    Raises InputError: one of the files exists already, or the screen has no places for so many fibres.
    """
    if not 1 <= fibres <= MAX_FIBRES:
        raise InputError("fibres.csv", "wrong number of fibres", found=fibres, accepted=f"1 to {MAX_FIBRES}")
    config = installation.project_folder() / "config"
    texts = {
        "fibres.csv": _fibre_table(fibres),
        **{f"{name}.yaml": (config / f"{name}.template.yaml").read_text(encoding="utf-8") for name in ("rig", "plan")},
    }
    if present := [name for name in texts if (folder / name).exists()]:
        raise InputError(folder, "the file exists already", found=present[0], accepted="another folder")
    for name, text in texts.items():
        store.write_text(folder / name, text)
    return folder / "plan.yaml"


def _fibre_table(count: int) -> str:
    """Directions evenly spaced in theta_s, ends in columns left and right of the disc."""
    theta = MIN_THETA_S + (MAX_THETA_S - MIN_THETA_S) * (np.arange(count) + 0.5) / count
    phi = np.arange(count) * GOLDEN_ANGLE % 360
    lines = [
        "# Directions about the mirror direction [degree], phi_s = 0 towards the sample's normal; ends on the screen [mm].",
        ",".join(COLUMNS),
        *(
            f"F{number:03d},{angle:.2f},{azimuth:.2f},{x:g},{y:g}"
            for number, (angle, azimuth, (x, y)) in enumerate(zip(theta, phi, _end_positions(), strict=False), start=1)
        ),
    ]
    return "\n".join(lines) + "\n"


def _end_positions() -> list[tuple[float, float]]:
    """Positions for the ends of fibres on the screen [mm], from the disc outwards, without that of the reference spot."""
    columns = _FIRST_COLUMN + SPACING * np.arange(_COLUMNS)
    rows = SPACING * (np.arange(_ROWS) - (_ROWS - 1) / 2)
    positions = [(float(side * x), float(y)) for x in columns for side in (-1, 1) for y in rows]
    return [position for position in positions if position != _REFERENCE]
