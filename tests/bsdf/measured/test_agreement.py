from __future__ import annotations

import numpy as np
import pytest
import rig_primary
import samples
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.bsdf.measured import completion, smoothing
from brdfpipe.bsdf.measured.agreement import asymmetry, pair_differences, uncertainty_enlargement
from brdfpipe.bsdf.measured.reciprocity import reciprocity
from brdfpipe.errors import VocabularyError

INCIDENCES = (10.0, 30.0, 60.0)


@pytest.fixture(scope="module")
def smoothed() -> xr.Dataset:
    """A plastic that a rig measured at 10, 30 and 60 degree."""
    truth = rig_primary.of_model(samples.beckmann_bsdf(0.1, n=1.5).bsdf.nonspectral())
    return smoothing.smooth(rig_primary.measured(truth, INCIDENCES, (500.0, 550.0), noise=0.01))


@pytest.fixture(scope="module")
def completed(smoothed: xr.Dataset) -> xr.Dataset:
    """The same in all directions."""
    return completion.complete(smoothed)


def test_an_uncertainty_that_was_not_enlarged_is_that_of_the_smoothed_incidence(
    completed: xr.Dataset, smoothed: xr.Dataset
) -> None:
    assert uncertainty_enlargement(completed, smoothed) == pytest.approx(dict.fromkeys(INCIDENCES, 1.0), abs=1e-6)
    grown = completed.assign(coefficient_factor=2.5 * completed["coefficient_factor"])
    assert uncertainty_enlargement(grown, smoothed) == pytest.approx(dict.fromkeys(INCIDENCES, 2.5), rel=1e-6)


def test_the_uncertainties_of_a_pair_are_those_before_the_enlargement(completed: xr.Dataset) -> None:
    pairs = reciprocity(completed, 5)
    plain, reduced = (pair_differences(pairs, dict.fromkeys(INCIDENCES, factor)) for factor in (1.0, 2.0))
    for name, factor in {"difference": 1.0, "change_u": 1.0, "difference_u": 0.5, "score": 2.0}.items():
        np.testing.assert_allclose(reduced[name], factor * plain[name], rtol=1e-12)
    ratio = (pairs["forward"] / pairs["backward"]).median("wavelength")
    np.testing.assert_allclose(1 + plain["difference"], ratio, rtol=1e-12)
    product = (1 + plain["change_of_backward"]) / (1 + plain["change_of_forward"])
    # The medians of two wavelengths are means, which do not commute with a ratio.
    np.testing.assert_allclose(product, ratio, rtol=1e-3)


def test_only_a_significant_difference_of_the_two_sides_is_an_asymmetry(smoothed: xr.Dataset) -> None:
    one = smoothed.isel(incidence=1).sel(wavelength=500.0)
    assert asymmetry(one) == 0
    side = np.sign(np.sin(np.radians(one["phi_s"])))
    assert asymmetry(one.assign(residual=one["residual"] + 2 * side)) == pytest.approx(4.0, abs=1.0)


def warned(truth, incidences=(0.0, 30.0), **options) -> list[str]:
    primary = rig_primary.measured(truth, incidences, (500.0, 550.0), noise=0.01)
    return [text for text in vocabulary.warnings(smoothing.smooth(primary, **options)) if "isotropic" in text]


def brushed(_, theta, phi, wavelength):
    """A lobe that is wider along one direction, as of brushed metal with the lay in the plane of incidence."""
    across, along = (np.tan(np.radians(theta)) * part(np.radians(phi)) for part in (np.sin, np.cos))
    brdf = 0.05 + 5 * np.exp(-((across / 0.3) ** 2) - (along / 0.15) ** 2)
    return np.broadcast_to(np.where(theta < 90, brdf, 0.05), (wavelength.size, theta.size))


def leaning(_, theta, phi, wavelength):
    brdf = 0.2 * (1 + 0.5 * np.sin(np.radians(theta)) * np.sin(np.radians(phi)))
    return np.broadcast_to(brdf, (wavelength.size, theta.size))


def test_a_lay_that_shows_at_normal_incidence_is_warned_of_and_kept_where_it_is_described() -> None:
    (warning,) = warned(brushed)
    assert "depends on the azimuth at 0°" in warning
    assert warned(brushed, isotropic=False) == []
    primary = rig_primary.measured(brushed, (0.0, 30.0), (500.0,), noise=0.01)
    at = np.full(2, 12.0), np.array([0.0, 90.0])
    along, across = smoothing.evaluate(smoothing.smooth(primary, isotropic=False), *at).values[0, 0]
    expected = brushed(0.0, *at, np.ones(1))[0]
    assert (along, across) == pytest.approx(tuple(expected), rel=0.05)


def test_two_sides_that_differ_are_warned_of() -> None:
    (warning,) = warned(leaning, (30.0, 45.0))
    assert "differ at 30°" in warning
    assert "mirror_symmetric: false" in warning
    assert warned(leaning, (30.0, 45.0), mirror_symmetric=False, isotropic=False) == []


def test_an_isotropic_surface_is_not_warned_of() -> None:
    for name in rig_primary.LOBES:
        assert warned(rig_primary.lobe(name), (30.0, 45.0)) == []


def test_an_isotropic_surface_is_symmetric_about_every_plane() -> None:
    with pytest.raises(VocabularyError, match="isotropic surface is symmetric"):
        warned(leaning, mirror_symmetric=False)
