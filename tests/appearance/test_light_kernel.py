"""The compiled look-up of lights, against that by NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from brdfpipe.appearance.light_kernel import mirrored_light
from brdfpipe.appearance.lights import STRAIGHT_DOWN, filtered, lights


@pytest.mark.parametrize("names", [["studio"], ["overcast"], ["studio", "spot", "tubes"]])
def test_facets_mirror_the_light_that_the_table_holds_there(names):
    random = np.random.default_rng(5)
    frame = np.linalg.qr(random.normal(size=(40, 3, 3)))[0]
    facets, view = random.normal(size=(60, 3)), random.normal(size=(40, 3))
    view[0] = [0.0, 0.0, 1.0]
    facets[0] = frame[0] @ [1.0, 0.0, 0.0]  # mirrors the first view straight down
    facets, view = (vectors / np.linalg.norm(vectors, axis=1, keepdims=True) for vectors in (facets, view))
    tables, blur = filtered(tuple(map(lights, names))), random.uniform(0.0, 0.2, 60)

    world = np.einsum("pca,fc->pfa", frame, facets)
    turned = 2 * (world @ view[:, :, None]) * world - view[:, None]
    expected = tables(*np.moveaxis(turned, -1, 0).astype(np.float32), blur)
    found = mirrored_light(frame, facets, view, tables.levels(blur), tables.table, STRAIGHT_DOWN)
    # Rounding moves a direction on the border of two texels to the other one.
    assert np.mean(found == expected) > 0.995
    assert (found[:, 0, 0] == expected[:, 0, 0]).all()
