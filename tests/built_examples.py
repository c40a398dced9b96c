"""The examples without those of a camera rig, and their build, which several test modules read."""

from __future__ import annotations

import shutil
from pathlib import Path

from brdfpipe.jobs.build import build as build_catalogue

PROJECT = Path(__file__).parents[1]
EXAMPLES = ("abs-grain", "metallic-blue", "paint-lab", "pp-moulding")


def build_examples(base: Path) -> None:
    # What a camera rig measured is built by the tests of the rig, and textures by a test of their own.
    rig, textures = (
        ("calibrations", "milk-glass", "metallic-paint", "opal-glass"),
        ("leather-texture", "sparkling-texture"),
    )
    others = shutil.ignore_patterns("*.py", "__pycache__", *rig, *textures)
    shutil.copytree(PROJECT / "examples", base / "catalogue", ignore=others)
    summary = build_catalogue(base / "catalogue", base / "results", cores=2)
    assert summary.failures == {}
    assert summary.built == EXAMPLES
