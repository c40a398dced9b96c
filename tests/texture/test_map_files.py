"""Files of height and normal maps."""

from __future__ import annotations

import json

import numpy as np
import pytest
import relief_maps
import samples
from PIL import Image

from brdfpipe import facets
from brdfpipe.texture.grain import grain
from brdfpipe.texture.map_files import write_maps


def test_files_hold_heights_and_normals_with_the_first_row_at_the_upper_edge(tmp_path):
    surface = samples.surface(relief_maps.two_scales(256, 1) * 0.4)
    found = grain(surface, facets.estimate(surface), 4.0, size=96, seed=1)
    record = write_maps(found, tmp_path, "panel")
    assert json.loads((tmp_path / "panel.maps.json").read_text()) == record
    with Image.open(tmp_path / "panel.height.png") as picture:
        read = np.asarray(picture).astype(float)
    span = record["height"]["um_at_65535"] - record["height"]["um_at_0"]
    heights = record["height"]["um_at_0"] + read[::-1] / 65535 * span
    assert heights == pytest.approx(found.height, abs=span / 65535)
    with Image.open(tmp_path / "panel.normal.png") as picture:
        assert picture.size == (96, 96)
        # Pillow reads the upper 8 bits of 16-bit colours.
        coarse = np.asarray(picture)[::-1] / 255 * 2 - 1
    assert coarse == pytest.approx(found.normals, abs=0.02)
