"""Choice of the masking by the heights of a surface: gentle Gaussian ones keep Smith's, cells, their negative and two scales do not."""

from __future__ import annotations

import numpy as np
import pytest
import relief_maps
import samples

from brdfpipe import vocabulary
from brdfpipe.bsdf.microfacet.builder import build
from brdfpipe.facets.analytic_distributions import flat
from brdfpipe.facets.estimation import estimate
from brdfpipe.masking.traced_visibility import VisibilityError
from brdfpipe.masking.visibility_choice import THETA, choose
from brdfpipe.references.height_mesh import HeightMapError


def chosen(height, **options):
    surface = samples.surface(height) if isinstance(height, np.ndarray) else height
    return choose(surface, estimate(surface, isotropic=True), samples=2**9, **options)


@pytest.fixture(scope="module")
def cells():
    return chosen(relief_maps.cells(256, 0))


@pytest.mark.parametrize("sigma", [0.02, 0.15, 0.4])
def test_a_gaussian_map_keeps_smiths_masking(sigma):
    choice = chosen(samples.gaussian_surface(256, sigma=sigma, correlation=8))
    assert choice.attrs["masking"] == "height-correlated"
    assert choice.attrs["reason"].startswith("Smith's masking is kept: the largest difference from the heights is ")
    assert "visibility_ratio" not in choice
    assert vocabulary.validate(choice, "visibility") is choice


def test_cells_and_their_negative_get_their_own_visibility(cells):
    negative = chosen(-relief_maps.cells(256, 0))
    peak = {name: choice.sel(region="peak", theta_i=75.0) for name, choice in (("up", cells), ("down", negative))}
    # Round cells hide less than Smith says at grazing angles, cells upside down hide more.
    assert peak["up"]["smith_error"] < -0.2
    assert peak["down"]["smith_error"] > 0.4
    for choice in (cells, negative):
        assert choice.attrs["masking"] == "measured"
        assert choice.attrs["reason"].startswith("Smith's masking would give ")
        assert vocabulary.validate(choice, "visibility") is choice


def test_the_model_follows_the_choice_and_says_so(cells):
    facets = estimate(samples.surface(relief_maps.cells(256, 0)), isotropic=True)
    bsdf = build(facets, index=1.5, visibility=cells, multiple_scattering="none")
    assert bsdf.attrs["masking"] == "measured"
    assert f"masking measured: {cells.attrs['reason']}" in bsdf.attrs["history"]
    clear = build(facets, index=1.5, visibility=cells, transparent=True)
    assert clear.attrs["masking"] == "height-correlated"
    assert "a transparent interface needs Smith's masking" in clear.attrs["history"]
    gaussian = samples.gaussian_surface(128, sigma=0.15)
    smith = build(
        estimate(gaussian, isotropic=True), index=1.5, visibility=chosen(gaussian), multiple_scattering="none"
    )
    assert (
        smith.attrs["masking"]
        == build(facets, index=1.5, multiple_scattering="none").attrs["masking"]
        == "height-correlated"
    )


def test_shares_are_whole_towards_the_normal_and_fall_towards_grazing(cells):
    share = cells["visible_share"].sel(region="all").values
    assert THETA.size == share.size
    assert share[0] > 0.8
    assert share[-1] < share[0]


def test_fine_roughness_upon_coarse_waviness_gets_its_own_visibility():
    # Rays traced over the same map find Smith's light in the peak 10.8 % ± 1.6 % too bright at 75 degree.
    choice = chosen(relief_maps.two_scales(256, 11))
    error, u = (float(choice[name].sel(region="peak", theta_i=75.0)) for name in ("smith_error", "smith_error_u"))
    assert choice.attrs["masking"] == "measured"
    assert u < 0.02
    assert error == pytest.approx(0.108, abs=3 * np.hypot(u, 0.016))


def test_the_uncertainty_is_that_of_chance_among_the_facets_of_one_map():
    rough = samples.gaussian_surface(128, sigma=0.3)
    facets = estimate(rough, isotropic=True)
    judged = [
        choose(rough, facets, samples=16, seed=seed).sel(region="peak", theta_i=slice(60.0, 75.0)) for seed in range(6)
    ]
    scatter = np.std([one["smith_error"] for one in judged], axis=0, ddof=1)
    u = np.mean([one["smith_error_u"] for one in judged], axis=0)
    # Evenly spread facets scatter no more than independent ones.
    assert 0.3 < np.sqrt(np.mean((scatter / u) ** 2)) < 1.5


@pytest.mark.slow
def test_gentle_gaussian_maps_of_any_seed_keep_smiths_masking():
    for sigma in (0.05, 0.1):
        for seed in range(5):
            rough = samples.gaussian_surface(512, sigma=sigma, correlation=12, seed=seed)
            assert choose(rough, estimate(rough, isotropic=True)).attrs["masking"] == "height-correlated", (sigma, seed)


# --- what is refused


def test_a_surface_with_a_lay_keeps_smiths_masking_and_says_so():
    height = samples.gaussian_surface(128, sigma=0.3)["height"].values
    ground = samples.surface(height, pitch=(1.0, 4.0))
    facets = estimate(ground, isotropic=False)
    choice = choose(ground, facets)
    assert choice.attrs["masking"] == "height-correlated"
    assert "no visibility was traced: " in choice.attrs["reason"]
    assert "has a lay" in choice.attrs["reason"]
    # Without its lay it would be another surface.
    assert "isotropic: true" not in choice.attrs["reason"]
    with samples.coarse_albedo_tables():
        bsdf = build(facets, index=1.5, visibility=choice, multiple_scattering="none")
    assert bsdf.attrs["masking"] == "height-correlated"
    with pytest.raises(VisibilityError, match=r"the surface has a lay; .*`model\.masking: auto`"):
        choose(ground, facets, masking="measured")


def test_too_small_and_flat_surfaces_keep_smiths_masking():
    rough = samples.gaussian_surface(128, sigma=0.3)
    facets = estimate(rough, isotropic=True)
    small = samples.surface(rough["height"].values[:8, :8])
    assert "accepted: 16 × 16 or more" in choose(small, facets).attrs["reason"]
    with pytest.raises(HeightMapError, match="16 × 16"):
        choose(small, facets, masking="measured")
    assert "flat" in choose(rough, flat()).attrs["reason"]


def test_measured_masking_is_traced_even_where_smiths_agrees():
    choice = chosen(samples.gaussian_surface(128, sigma=0.15), masking="measured")
    assert choice.attrs["masking"] == "measured"
    assert choice.attrs["reason"].startswith("`model.masking: measured`; Smith's masking is kept")
    assert "visibility_ratio" in choice
