"""Files of the texture of an effect paint."""

from __future__ import annotations

import json

import numpy as np
import pytest
from flake_pictures import flakes
from PIL import Image

from brdfpipe.texture.picture_files import write_pictures
from brdfpipe.texture.picture_texture import of_pictures


def test_files_hold_the_light_over_its_mean(tmp_path):
    texture = of_pictures({"45as15": flakes(128), "diffuse": flakes(128) + 1}, pixel=20.0, size=64)
    record = write_pictures(texture, tmp_path, "paint")
    assert json.loads((tmp_path / "paint.texture.json").read_text()) == record
    for number, listed in enumerate(record["textures"]):
        with Image.open(tmp_path / listed["png"]["file"]) as picture:
            light = np.asarray(picture)[::-1] / 65535 * listed["png"]["light_at_65535"]
        wanted = texture["relative_light"].values[number].astype(float)
        assert light == pytest.approx(wanted, abs=wanted.max() / 65535)
        assert (tmp_path / listed["exr"]["file"]).is_file()
    write_pictures(texture.isel(geometry=[0]), tmp_path, "paint")
    assert len(list(tmp_path.iterdir())) == 3
