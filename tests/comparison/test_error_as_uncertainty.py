"""The error of a model as a standard uncertainty of what it predicts."""

from __future__ import annotations

import numpy as np
import pytest
import random_surfaces
import samples
import xarray as xr

from brdfpipe import facets
from brdfpipe import psd as roughness
from brdfpipe.appearance.computation import compute_appearance
from brdfpipe.bsdf import microfacet, wave
from brdfpipe.bsdf.input_uncertainty import uncertainty
from brdfpipe.comparison.error_as_uncertainty import LARGEST_ERROR, gloss_error, relative_light_error
from brdfpipe.comparison.model_error import model_error

PLANES = ["along the lay", "across the lay"]
REFERENCES = ["traced", "kirchhoff"]
BY_REGION = ("reference", "plane", "theta_i", "region")
BY_GLOSS = ("reference", "plane", "gloss_angle")


def compared(light: np.ndarray, reference: np.ndarray, valid: list[list[int]], relative_u: float = 0.03) -> xr.Dataset:
    """Light of a prediction (plane, theta_i, region) and of references, which is uncertain by a share of it."""
    light = np.broadcast_to(light, reference.shape[1:])
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(reference > 0, light / reference, np.nan)
    return xr.Dataset(
        {
            "light": (BY_REGION[1:], light),
            "reference_light": (BY_REGION, reference),
            "light_error": (BY_REGION, ratio - 1),
            "light_error_u": (BY_REGION, relative_u * ratio),
            "valid": (("reference", "theta_i"), valid),
        },
        {
            "reference": REFERENCES,
            "plane": PLANES[: reference.shape[1]],
            "theta_i": [0.0, 60.0, 85.0][: reference.shape[2]],
            "region": ["peak", "shoulder", "rest"][: reference.shape[3]],
        },
    )


def test_relative_error_is_that_of_the_reference_that_holds_in_the_worse_plane():
    reference = np.array([[1.03, 0.96], [1.06, 1.08]])[:, :, None, None] * np.ones((1, 1, 2, 1))
    found = relative_light_error(compared(np.ones(()), reference, [[1, 0], [1, 1]]))
    assert found["relative_error"].dims == ("theta_i", "region")
    # The prediction shares the map of diffraction, and not the rays.
    np.testing.assert_allclose(found["relative_error"][:, 0], [np.hypot(0.04, 0.03 * 0.96), 0.08])
    np.testing.assert_allclose(found["reference_light_u"][:, 0], [0.0, 0.03 * 1.08])


def test_relative_error_is_missing_where_no_reference_holds():
    error = relative_light_error(compared(np.ones(()), np.full((2, 2, 2, 1), 1.1), [[0, 1], [0, 0]]))["relative_error"]
    assert error.isnull().values.ravel().tolist() == [True, False]


@pytest.mark.parametrize("share", [0.2, 0.5, 2.0, 10.0])
def test_the_stated_error_covers_light_that_is_predicted_too_dark_or_too_bright(share):
    # A prediction of 0.2 of the light is wrong by 4 times what it predicts, not by 0.8 times.
    result = compared(np.full((1, 1, 1), share), np.ones((2, 1, 1, 1)), [[1], [1]], relative_u=0.0)
    assert share * float(relative_light_error(result)["relative_error"][0, 0]) == pytest.approx(abs(1 - share))


def test_the_stated_error_is_bounded_where_hardly_any_light_is_predicted():
    result = compared(np.full((1, 1, 1), 1e-6), np.ones((2, 1, 1, 1)), [[1], [1]])
    assert float(relative_light_error(result)["relative_error"][0, 0]) == LARGEST_ERROR


def test_a_region_without_light_has_the_error_of_its_neighbour_and_no_incidence_is_dropped():
    light = np.array([[[1.0, 1.0, 0.0], [1.0, 1.0, 1.0], [1.0, 0.0, 0.0]]])
    reference = np.array([1.1, 1.2, 1.3]) * (light > 0) * np.ones((2, 1, 1, 1))
    error = relative_light_error(compared(light, reference, [[1, 1, 1], [0, 0, 0]], relative_u=0.0))["relative_error"]
    np.testing.assert_allclose(error, [[0.1, 0.2, 0.2], [0.1, 0.2, 0.3], [0.1, 0.1, 0.1]])


def test_the_error_of_gloss_has_its_sign_and_of_rays_their_noise():
    error = np.array([[[-36.0, 2.0, np.nan]], [[-30.0, 3.0, 4.0]]])
    result = xr.Dataset(
        {
            "gloss_error": (BY_GLOSS, error),
            "gloss_error_u": (BY_GLOSS, np.full_like(error, 0.5)),
            "gloss_valid": (("reference", "gloss_angle"), [[1, 0, 0], [1, 1, 0]]),
        },
        {"reference": REFERENCES, "plane": PLANES[:1], "gloss_angle": [20.0, 60.0, 85.0]},
    )
    found = gloss_error(result)
    np.testing.assert_allclose(found["model_gloss_error"], [-np.hypot(36, 0.5), 3.0, np.nan])
    # The prediction shares the map of diffraction, and not the rays.
    np.testing.assert_allclose(found["reference_gloss_u"], [0.0, 0.5, np.nan])


def predicted_gloss(parts: list[tuple[float, float]], pitch: float, seed: int) -> tuple[np.ndarray, ...]:
    """Gloss at 20, 60 and 85 degree predicted from a map of 256² Gaussian heights, its stated uncertainty without that of the instrument, and the gloss
    of the reference solution (NaN where none holds)."""

    def spectrum(frequency: np.ndarray) -> np.ndarray:
        return sum(random_surfaces.gaussian(*part)(frequency) for part in parts)

    scan = samples.surface(random_surfaces.heights(spectrum, (256, 256), (pitch, pitch), seed), (pitch, pitch))
    counted, psd = facets.estimate(scan, isotropic=True, noise=0.0), roughness.estimate(scan, noise=0.0)
    with samples.coarse_albedo_tables():
        predicted = microfacet.build(counted, index=1.5, multiple_scattering="none")
        bsdf = wave.build(psd, index=1.5, facets=counted, predicted=predicted, optics="auto", wavelength=[550.0])
    compared = model_error(scan, bsdf, counted)
    errors = {**relative_light_error(compared).data_vars, "gloss_error": gloss_error(compared)}
    changes = uncertainty(bsdf, facets=counted, psd=psd, **errors)
    appearance = compute_appearance(bsdf.merge(changes, combine_attrs="override"))
    parts_of_u = np.nan_to_num(appearance["gloss_u_source"].drop_sel(source="instrument").values)
    reference = compared["reference_gloss"].max("reference").isel(plane=0)
    return appearance["gloss"].values, np.sqrt(np.square(parts_of_u).sum(axis=0)), reference.values


@pytest.mark.slow
@pytest.mark.parametrize(
    ("parts", "pitch"),
    [([(0.1, 20.0), (0.02, 1.0)], 0.5), ([(0.05, 5.0)], 0.5), ([(0.013, 5.0)], 0.5), ([(0.57, 8.0)], 1.0)],
    ids=["waves with fine roughness", "50 nm", "13 nm", "slope 0.1"],
)
def test_gloss_of_twelve_maps_is_as_far_from_that_of_the_surface_as_each_states(parts, pitch):
    gloss, u, reference = map(
        np.array, zip(*(predicted_gloss(parts, pitch, seed) for seed in range(1000, 1012)), strict=True)
    )
    known = np.isfinite(reference).all(axis=0)
    # Gloss of the surface: the mean of the references, which share the maps; where none holds, that of the predictions.
    bias = np.where(known, (gloss - reference).mean(axis=0), 0.0)
    error = np.sqrt(gloss.var(axis=0, ddof=1) + bias**2)
    ratio = np.sqrt(np.mean(u**2, axis=0)) / error
    assert (ratio > 0.6).all()
    assert (ratio < 2).all()
