"""The accessor: broadcasting, labels, and refusals in the user's words."""

from __future__ import annotations

import numpy as np
import pytest
import samples
import xarray as xr

from brdfpipe import facets, psd
from brdfpipe.bsdf import microfacet, slab, wave
from brdfpipe.bsdf.lambert_gauss import lambertian
from brdfpipe.errors import VocabularyError


@pytest.fixture(scope="module")
def bsdf():
    return samples.beckmann_bsdf(0.2)


def test_plain_arrays_are_paired_into_directions(bsdf):
    brdf = bsdf.bsdf.evaluate(30, 0, [10, 30, 50], 180, wavelength=[450, 550])
    assert brdf.dims == ("direction", "wavelength")
    assert brdf.shape == (3, 2)
    assert brdf.attrs["units"] == "sr-1"


def test_labelled_arrays_broadcast_by_name(bsdf):
    theta_i = xr.DataArray([0.0, 30.0], dims="theta_i", coords={"theta_i": [0.0, 30.0]})
    theta_o = xr.DataArray([0.0, 30.0, 60.0], dims="theta_o", coords={"theta_o": [0.0, 30.0, 60.0]})
    brdf = bsdf.bsdf.evaluate(theta_i, 0, theta_o, 180, wavelength=550)
    assert brdf.sizes == {"theta_i": 2, "theta_o": 3, "wavelength": 1}
    alone = bsdf.bsdf.evaluate(30, 0, 60, 180, wavelength=550)
    assert brdf.sel(theta_i=30, theta_o=60).values == alone.values


def test_scalars_give_no_direction(bsdf):
    assert bsdf.bsdf.evaluate(0, 0, 0, 0).dims == ("wavelength",)


def test_no_directions_give_no_values(bsdf):
    assert bsdf.bsdf.evaluate([], [], [], [], wavelength=550).shape == (0, 1)


def test_wavelengths_between_the_data_are_interpolated(bsdf):
    coarse = samples.beckmann_bsdf(0.2, reflectance=np.linspace(0.1, 0.6, samples.WAVELENGTH.size))
    left, middle, right = coarse.bsdf.evaluate(0, 0, 40, 0, wavelength=[500, 502.5, 505]).values
    assert middle == pytest.approx((left + right) / 2, rel=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"theta_i": 200}, "theta_i spans 200 to 200"),
        ({"theta_o": [0, -1]}, "theta_o spans -1 to 0"),
        ({"phi_o": np.nan}, "phi_o is not finite"),
        ({"wavelength": 300}, "the data cover 360 to 780 nm"),
        ({"wavelength": np.nan}, r"accepted: finite numbers in one dimension"),
        ({"theta_i": xr.DataArray(0.5, attrs={"units": "radian"})}, "accepted: degree"),
    ],
)
def test_bad_arguments_are_refused(bsdf, arguments, message):
    with pytest.raises(VocabularyError, match=message):
        bsdf.bsdf.evaluate(**{"theta_i": 0, "phi_i": 0, "theta_o": 0, "phi_o": 0, **arguments})


def test_the_albedo_keeps_the_shape_of_its_angles(bsdf):
    assert bsdf.bsdf.albedo([0, 45, 80]).dims == ("direction", "wavelength")
    assert bsdf.bsdf.albedo(45, wavelength=550).shape == (1,)


@pytest.mark.parametrize("weight", [[1.0, 2.0], np.zeros(85), -np.ones(85)])
def test_an_unusable_weight_is_refused(bsdf, weight):
    with pytest.raises(VocabularyError, match="the weight needs 85 finite values"):
        bsdf.bsdf.nonspectral(weight)


def test_a_dataset_that_is_not_a_bsdf_is_refused():
    with pytest.raises(VocabularyError, match="unknown representation"):
        samples.spectrum().bsdf.evaluate(0, 0, 0, 0)


def test_wavelengths_in_another_unit_are_refused():
    bsdf = samples.beckmann_bsdf()
    with pytest.raises(VocabularyError, match="in 'um'; accepted: nm"):
        bsdf.bsdf.evaluate(0, 0, 0, 0, xr.DataArray([550.0], dims="wavelength", attrs={"units": "um"}))


def test_the_mueller_matrix_of_transmission_is_nan():
    bsdf = microfacet.build(facets.analytic("beckmann", 0.2), index=1.5, transparent=True)
    assert np.isnan(bsdf.bsdf.mueller(30, 0, 150, 180).values).all()
    assert np.isfinite(bsdf.bsdf.mueller(30, 0, 30, 180).values).all()


@pytest.mark.parametrize(
    "build",
    [
        lambda: samples.beckmann_bsdf(0.2),
        lambda: samples.brushed_bsdf(0.1, 0.2),
        lambda: microfacet.build(facets.flat(), index=1.5, spectrum=samples.spectrum(0.3)),
        lambda: wave.build(psd.analytic("gaussian", sigma=0.1, length=5.0), index=1.5, wavelength=[550.0]),
        lambda: slab.build(facets.flat(), facets.flat(), index=1.5),
        lambda: lambertian(samples.spectrum(0.3)),
        lambda: table_of(lambertian(samples.spectrum(0.3))),
    ],
    ids=["facets", "lay", "flat", "wave", "slab", "lambert", "table"],
)
def test_no_incidences_give_no_values_of_any_representation(build):
    accessor, none = build().bsdf, np.empty(0)
    assert accessor.evaluate(none, 0, none, 0).shape[0] == 0
    assert accessor.mueller(none, 0, none, 0).shape[0] == 0
    assert accessor.albedo(none).shape[0] == 0
    assert accessor.transmittance(none).shape[0] == 0


def table_of(bsdf: xr.Dataset) -> xr.Dataset:
    return bsdf.bsdf.tabulate({"theta_i": [0, 30, 60], "theta_o": [0, 30, 60], "phi_o": [0, 90, 180, 270, 360]})
