"""The moulded part of a preview: its shape, and that it is lit as the material is."""

from __future__ import annotations

import numpy as np
import pytest
import samples

from brdfpipe.appearance import moulded_part as part
from brdfpipe.appearance.lights import lights
from brdfpipe.appearance.preview import channels_of, radiance
from brdfpipe.appearance.preview_geometry import Points, sphere
from brdfpipe.appearance.transport import Table

SIDE = 128
UP = np.array([0.0, -np.sin(part._TILT), np.cos(part._TILT)])
"""Direction of the mould."""


def normals():
    """Unit normals (side, side, 3) of the pixels, NaN beside the part."""
    centre = ((np.arange(SIDE) + 0.5) / SIDE * 2 - 1) * part._HALF_FIELD
    x, z = (axis.ravel() for axis in np.meshgrid(centre, -centre))
    return part._seen_normals(x, z).reshape(SIDE, SIDE, 3)


@pytest.mark.parametrize(
    "bsdf", [samples.glossy_bsdf(0.1, 1.55), samples.brushed_bsdf(0.1, 0.3)], ids=["isotropic", "brushed"]
)
def test_a_pixel_has_the_light_that_its_normal_reflects(bsdf):
    table, studio, shape = Table.of(bsdf, *channels_of(bsdf)), lights("studio"), part.moulded_part(SIDE)
    found = np.zeros((SIDE, SIDE))
    found[shape.coverage > 0] = shape.lit_as(radiance(table, sphere(SIDE), studio))[:, 1]
    normal = normals()
    rows, columns = np.nonzero(~part._bent(normal) & (normal[..., 1] < -0.3))
    chosen = np.random.default_rng(1).choice(rows.size, 200, replace=False)
    facing = normal[rows[chosen], columns[chosen]]
    lay = np.stack([-facing[:, 1], facing[:, 0], np.zeros(200)], axis=-1)
    lay /= np.linalg.norm(lay, axis=1, keepdims=True)
    camera = np.broadcast_to([0.0, -1.0, 0.0], facing.shape)
    points = Points(facing, camera, lay, np.full(200, 1 / SIDE))
    expected = (table.near_light(points, studio) + table.far_light(points, studio))[:, 1] * studio.exposure
    assert found[rows[chosen], columns[chosen]] == pytest.approx(expected, rel=0.02, abs=0.003)


def test_an_even_sphere_gives_an_even_part():
    shape = part.moulded_part(SIDE)
    lit = shape.lit_as(np.ones((np.count_nonzero(sphere(SIDE).coverage), 3)))
    assert lit == pytest.approx(np.ones_like(lit), abs=1e-6)


def test_the_part_is_inside_its_picture_and_whole():
    coverage = part.moulded_part(SIDE).coverage
    assert np.concatenate([coverage[[0, -1]].ravel(), coverage[:, [0, -1]].ravel()]).max() == 0
    assert 0.3 < coverage.mean() < 0.6
    # No hole: along each row the covered pixels follow each other.
    for row in coverage > 0:
        assert np.count_nonzero(np.diff(row.astype(int))) in (0, 2)


def test_walls_have_the_draft_and_the_top_its_crown():
    normal = normals()
    along_mould = np.degrees(np.arcsin(np.clip(normal @ UP, -1, 1)))[np.isfinite(normal[..., 0])]
    walls = along_mould[along_mould < 10]
    # The crown leans the walls by at most 5 degree more or less.
    assert np.median(walls) == pytest.approx(np.degrees(np.arctan(part.DRAFT)), abs=2.5)
    top = along_mould[along_mould > 85]
    assert top.size > 0.3 * along_mould.size
    assert np.ptp(top) > 2


def test_ribs_boss_and_fillets_show_every_slope_between():
    normal = normals()
    along_mould = np.degrees(np.arcsin(np.clip(normal @ UP, -1, 1)))[np.isfinite(normal[..., 0])]
    counts, _ = np.histogram(along_mould, np.arange(0, 91, 5))
    assert counts.min() > 20
