from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from brdfpipe.appearance.luminous import luminous_reflectance
from brdfpipe.bsdf import microfacet

Datasets = dict[str, xr.Dataset]


def test_the_luminous_reflectance_of_a_constant_spectrum_is_that_constant(full: Datasets) -> None:
    grey = full["spectrum"].assign(total_reflectance=xr.full_like(full["spectrum"]["total_reflectance"], 0.25))
    # Y = 100 for the perfect diffuser by definition of the weights: only rounding remains.
    assert luminous_reflectance({"spectrum": grey}) == pytest.approx(0.25, rel=1e-12)


def test_the_luminous_reflectance_is_nan_without_a_spectrum(full: Datasets) -> None:
    assert np.isnan(luminous_reflectance({"facets": full["facets"]}))


def test_a_reflectance_without_its_specular_part_is_not_the_luminous_one(full: Datasets) -> None:
    excluded = full["spectrum"].assign_attrs(geometry="sce")
    assert np.isnan(luminous_reflectance({"spectrum": excluded}))
    bsdf = microfacet.build(full["facets"], index=full["index"], spectrum=excluded)
    both = luminous_reflectance({"spectrum": excluded, "bsdf": bsdf})
    # The facets of n = 1.55 mirror 4.9 % at most, of which the measurement excluded some.
    assert 0 < both - luminous_reflectance({"spectrum": full["spectrum"]}) < 0.05


def test_the_total_of_a_measurement_is_not_that_of_the_spectrum_given_for_a_prediction(full: Datasets) -> None:
    measured = full["bsdf"].drop_vars("total_reflectance").assign_attrs(route="measured")
    assert np.isnan(luminous_reflectance({"spectrum": full["spectrum"], "bsdf": measured}))
