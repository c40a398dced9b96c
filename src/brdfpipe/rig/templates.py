"""A rig to start from: descriptions of a bench like that of the Keldysh preprint, commented field by field."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from brdfpipe import installation, store
from brdfpipe.errors import InputError
from brdfpipe.rig.description import COLUMNS

LOW, HIGH = 12.0, 105.0
"""Fibres look from angles [degree] between these about the mirror direction: the lens has what is nearer."""

GOLDEN = 180 * (3 - 5**0.5)
"""Degree from the azimuth of one fibre to the next, so that no two stand in line."""

SPACING = 4.5
"""Millimetres between the ends of fibres, 13 pixels."""

_COLUMNS, _FIRST_COLUMN, _ROWS = 5, 31.0, 17
_REFERENCE = (49.0, 36.0)

MOST = 2 * _COLUMNS * _ROWS - 1
"""Fibres for which the screen has places beside the disc and the reference spot."""


def start(folder: Path, fibres: int = 150) -> Path:
    """Write ``rig.yaml``, ``fibres.csv`` and ``plan.yaml`` to start from; return the plan's path.

    Parameters
    ----------
    folder : made if it is not there
    fibres : how many, from 1 to :data:`MOST`

    Raises
    ------
    InputError : one of the files is there already, or there are no places for so many fibres.
    """
    if not 1 <= fibres <= MOST:
        raise InputError("fibres.csv", "the number of fibres", found=fibres, accepted=f"1 to {MOST}")
    config = installation.project_folder() / "config"
    texts = {
        "fibres.csv": _fibres(fibres),
        "rig.yaml": (config / "rig.template.yaml").read_text(encoding="utf-8"),
        "plan.yaml": (config / "plan.template.yaml").read_text(encoding="utf-8"),
    }
    if present := [name for name in texts if (folder / name).exists()]:
        raise InputError(folder, "holds such a file already", found=present[0], accepted="another folder")
    for name, text in texts.items():
        store.write_text(folder / name, text)
    return folder / "plan.yaml"


def _fibres(count: int) -> str:
    """Directions evenly spaced in theta_s, ends in columns left and right of the disc."""
    theta = LOW + (HIGH - LOW) * (np.arange(count) + 0.5) / count
    phi = np.arange(count) * GOLDEN % 360
    lines = [
        "# Directions about the mirror direction [degree], phi_s = 0 towards the sample's normal; ends on the screen [mm].",
        ",".join(COLUMNS),
        *(
            f"F{number:03d},{each:.2f},{azimuth:.2f},{x:g},{y:g}"
            for number, (each, azimuth, (x, y)) in enumerate(zip(theta, phi, _places(), strict=False), start=1)
        ),
    ]
    return "\n".join(lines) + "\n"


def _places() -> list[tuple[float, float]]:
    """Places for the ends of fibres [mm], from the disc outwards, without the one of the reference spot."""
    columns = _FIRST_COLUMN + SPACING * np.arange(_COLUMNS)
    rows = SPACING * (np.arange(_ROWS) - (_ROWS - 1) / 2)
    places = [(float(side * x), float(y)) for x in columns for side in (-1, 1) for y in rows]
    return [place for place in places if place != _REFERENCE]
