"""A small rig, as its laboratory would describe it."""

from __future__ import annotations

from pathlib import Path

import pytest

from brdfpipe.rig.description import Rig

RIG = """\
name: bench-1
monochromator: {dialect: acton, port: /dev/ttyUSB0, query_timeout: 0.2, motion_timeout: 0.4}
wheel: {dialect: thorlabs, port: /dev/ttyUSB1, query_timeout: 0.2, motion_timeout: 0.4}
camera: {kind: drop-folder, folder: camera}
nd_location: sample
filters:
  - {position: 1, transmittance: 1, u: 0}
  - {position: 2, transmittance: 0.1}
  - {position: 3, transmittance: 0.01}
entrances: [0, 10, 20, 45]
fibres: {file: fibres.csv}
screen: {scale: 3, centre: [159.5, 119.5], reference: [48, 34], radial: 1.0e-6}
"""

FIBRES = """\
# Directions about the mirror direction [degree], ends on the screen [mm].
name,theta_s,phi_s,x,y
A1,15,0,32,0
A2,30,90,36,5
A3,45,180,-32,10
A4,60,270,-40,-12
"""


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    """``rig.yaml`` of a rig with four fibres, in its own folder."""
    folder = tmp_path / "bench"
    folder.mkdir()
    (folder / "fibres.csv").write_text(FIBRES)
    path = folder / "rig.yaml"
    path.write_text(RIG)
    return path


@pytest.fixture
def rig(rig_file: Path) -> Rig:
    return Rig.load(rig_file)
