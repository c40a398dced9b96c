"""Visibility traced on lines, against maps of the same isotropic surface."""

from __future__ import annotations

import numpy as np
import pytest
import relief_maps
import samples

from brdfpipe import vocabulary
from brdfpipe.bsdf.microfacet.builder import build
from brdfpipe.bsdf.registry import representation
from brdfpipe.facets.estimation import estimate
from brdfpipe.masking.line_visibility import tabulate_line
from brdfpipe.masking.traced_visibility import VisibilityError, tabulate
from brdfpipe.masking.visibility_choice import choose
from brdfpipe.references.height_mesh import HeightMapError, HeightMesh


def line_across(height):
    """One line that runs over the rows of a periodic map one after the other, in both directions by turns."""
    rows = height.copy()
    rows[1::2] = rows[1::2, ::-1]
    # Beside each other, the ends of two rows have nearly the same height.
    return samples.surface(rows.ravel())


@pytest.mark.parametrize("sign", [1, -1])
def test_a_line_tells_cells_from_their_negative_as_the_map_does(sign):
    height = sign * relief_maps.cells(256, 0)
    facets, mesh = estimate(samples.surface(height), isotropic=True), HeightMesh.of(samples.surface(height))
    on_line = tabulate_line(HeightMesh.of_line(line_across(height)), mesh.typical_slope * np.sqrt(2 * np.log(2)))
    theta_i, theta_o, phi_o = (angle.ravel() for angle in np.meshgrid([75.0], [60.0, 70, 75, 80], [150.0, 180]))
    light = []
    for options in (
        {},
        *(
            {"visibility": vocabulary.label(table, "visibility"), "masking": "measured"}
            for table in (on_line, tabulate(mesh))
        ),
    ):
        with samples.coarse_albedo_tables():  # the light that facets reflect once does not depend on it
            bsdf = build(facets, index=1.5, multiple_scattering="none", **options)
        brdf = representation(bsdf).evaluate(theta_i, 0 * theta_i, theta_o, phi_o, None)
        light.append(brdf[:, 0] @ np.cos(np.radians(theta_o)))
    smith, line, traced = light
    assert sign * (1 - smith / traced) > 0.2
    # The line knows the slope along it alone; of Smith's error, more than two thirds vanish.
    assert abs(line / traced - 1) < abs(smith / traced - 1) / 3


def test_a_gaussian_line_keeps_smiths_masking():
    line = line_across(samples.gaussian_surface(256, sigma=0.15, correlation=8)["height"].values)
    choice = choose(line, estimate(line, isotropic=True), samples=2**9)
    assert choice.attrs["masking"] == "height-correlated"
    assert choice.attrs["method"] == "traced on the line"


def test_a_line_of_cells_gets_its_own_visibility():
    line = line_across(relief_maps.cells(256, 0))
    facets = estimate(line, isotropic=True)
    choice = choose(line, facets, samples=2**9)
    assert choice.attrs["masking"] == "measured"
    assert vocabulary.validate(choice, "visibility") is choice
    assert build(facets, index=1.5, visibility=choice, multiple_scattering="none").attrs["masking"] == "measured"


def test_lines_without_slopes_and_maps_are_refused():
    with pytest.raises(VisibilityError, match="more than half of the slopes are 0"):
        tabulate_line(HeightMesh.of_line(samples.surface(np.eye(1, 64, 32)[0])), 0.1)
    with pytest.raises(HeightMapError, match="accepted: a line of 16 or more"):
        HeightMesh.of_line(samples.surface(np.zeros((32, 32))))
    with pytest.raises(HeightMapError, match="no two heights beside each other"):
        HeightMesh.of_line(samples.surface(np.where(np.arange(64) % 2, np.nan, 1.0)))
