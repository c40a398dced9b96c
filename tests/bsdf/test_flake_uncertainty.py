"""Changes of the BSDF of an effect paint by its inputs, against fits to changed inputs and against their scatter."""

import numpy as np
import pytest
import xarray as xr

from brdfpipe import flakes, vocabulary
from brdfpipe.appearance.colours import colour
from brdfpipe.bsdf import flake
from brdfpipe.bsdf.flake_uncertainty import uncertainty
from brdfpipe.bsdf.nonspectral import nonspectral, normalised_response
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.source_changes import SourceChanges
from brdfpipe.flakes.fitting import fit
from brdfpipe.flakes.forms import curve
from brdfpipe.spectra import colorimetry

LAB = {"45:-30": (33.90, -7.58, -36.61), "45:0": (12.29, 1.19, -25.77), "45:65": (3.07, 2.09, -13.24)}
NAMES = ("45as15", "45as25", "45as45", "45as60", "45as75", "45as110")
WAVELENGTH = np.arange(400.0, 701.0, 50.0)
COAT = {"model": "flake-physical", "clear_coat": 0.05, "index": 1.5}
NOT_ASKED = np.zeros(85)
"""Total reflectance."""
AT = np.array([45.0, 20.0, 45.0, 60.0]), np.zeros(4), np.array([30.0, 5.0, 45.0, 70.0]), np.full(4, 180.0), None


def three_colours(u: float | None = 0.2) -> xr.Dataset:
    listed = [{"geometry": name, "lab": list(lab)} for name, lab in LAB.items()]
    stated = {} if u is None else {"colour_uncertainty": u}
    return flakes.ingest({"colours": listed, "illuminant": "D65", "observer": 10} | stated)


def spectra(factor: float = 1.0, second_decay: float = 5.0, **stated) -> xr.Dataset:
    """A paint of two decays, which one term fits exactly if both are the same."""
    turn = (WAVELENGTH - 400) / 300
    listed = []
    for name in NAMES:
        theta = float(flakes.flake_angle(*flakes.directions(name), 1.5))
        values = sum(
            curve(theta, (0.3 - 0.2 * turn)[None], (b + turn)[None], 0.02 + 0 * turn, 1) for b in (5.0, second_decay)
        )
        listed.append({"geometry": name, "reflectance": (factor * (values + 0.02)).tolist()})
    return flakes.ingest({"colours": listed, "wavelength": WAVELENGTH.tolist(), "scale": "fraction"} | stated)


def beside(bsdf: xr.Dataset, multiangle: xr.Dataset, **stated) -> xr.Dataset:
    changes = vocabulary.validate(uncertainty(bsdf, multiangle, **stated), "uncertainty")
    return vocabulary.validate(bsdf.merge(changes, combine_attrs="override"), "bsdf")


def test_a_three_point_fit_is_as_uncertain_as_its_colours_where_they_were_measured():
    multiangle = three_colours(0.2)
    changes = SourceChanges(beside(flake.build(multiangle, **COAT | {"clear_coat": 0.02}), multiangle))
    assert set(changes.sources) == {"colours"}
    lab = [
        colour(changes.given.dataset, list(LAB), reflector=one, total=NOT_ASKED).values[1:]
        for one in (changes.given, *changes.changed)
    ]
    # The coat mirrors 0.2 % of what is seen at 45:-30, so that all of the uncertainty is that of the flakes.
    np.testing.assert_allclose(np.sqrt(np.square(np.array(lab[1:]) - lab[0]).sum(axis=0)), 0.2, rtol=0.03)


def test_the_stated_covariance_is_the_scatter_of_fits_to_colours_with_errors():
    multiangle = three_colours(0.1)
    theta, values, share = flake.below_coat(multiangle, flake.ClearCoat(1.5, True, None))
    changes = uncertainty(flake.build(multiangle, model="flake-physical"), multiangle)
    stated = np.sqrt(np.square(changes["flake_decay_change"][:, 0]).sum("uncertain_change")).values
    random = np.random.default_rng(1)
    white = colorimetry.weights("D65", 10).white
    lab = np.array(list(LAB.values())) + 0.1 * random.standard_normal((400, 3, 3))
    decays = [fit(theta, xyz / share).decay[0] for xyz in colorimetry.lab_to_xyz(lab, white)]
    # 400 fits know their scatter to 3.5 %.
    np.testing.assert_allclose(np.std(decays, axis=0), stated, rtol=0.1)
    assert values.shape == (3, 3)


@pytest.mark.parametrize(
    ("source", "stated", "changed"),
    [
        ("colours", {"scale_uncertainty": 0.01}, {"factor": 1.01}),
        ("index", {"index_uncertainty": 0.005}, {"index": 1.505}),
        ("clear_coat", {"clear_coat_uncertainty": 0.001}, {"clear_coat": 0.051}),
    ],
)
def test_an_input_changes_the_bsdf_as_if_it_was_fitted_with_it(source, stated, changed):
    multiangle = spectra()
    bsdf = flake.build(multiangle, **COAT)
    rebuilt = flake.build(spectra(changed.pop("factor", 1.0)), **COAT | changed)
    changes = SourceChanges(beside(bsdf, multiangle, **stated))
    number = max(row for row, name in enumerate(changes.sources) if name == source)
    wanted = representation(rebuilt).evaluate(*AT) - changes.given.evaluate(*AT)
    np.testing.assert_allclose(changes.of_brdf(*AT)[number], wanted, atol=0.03 * np.abs(wanted).max())


def test_a_fit_is_as_uncertain_as_it_misses_its_colours():
    multiangle = spectra(second_decay=15.0)
    bsdf = beside(flake.build(multiangle, model="flake-physical"), multiangle)
    assert bsdf.attrs.get("uncertainty_not_stated", "") == ""
    assert bsdf.bsdf.uncertainty_sources == ("colours", "model")
    at = [multiangle[name].values for name in ("theta_i", "phi_i", "theta_o", "phi_o")]
    missed = np.pi * bsdf.bsdf.evaluate(*at).values - multiangle["reflectance_factor"].values
    u = np.pi * bsdf.bsdf.uncertainty(*at, source="model").values
    # Six misfits have three degrees of freedom: their rms is 0.71 of the stated uncertainty.
    np.testing.assert_allclose(np.sqrt(np.square(missed / u).mean(axis=0)), np.sqrt(0.5), rtol=0.2)


def test_misfits_that_the_uncertainty_of_the_colours_explains_are_not_counted_twice():
    multiangle = spectra(second_decay=15.0, colour_uncertainty=0.1)
    found = uncertainty(flake.build(multiangle, model="flake-physical"), multiangle)
    of_model = found["uncertainty_source"] == "model"
    assert of_model.any()
    assert not found["flake_amplitude_change"][of_model.values].any()


def test_what_is_not_known_is_named():
    exact = three_colours(None)
    found = uncertainty(flake.build(exact, model="flake-physical"), exact)
    assert found.attrs["uncertainty_not_stated"] == "colours, index, clear_coat, model"
    without_coat = uncertainty(flake.build(exact), exact, index_uncertainty=0.01)
    assert without_coat.attrs["uncertainty_not_stated"] == "colours, model"


def test_the_uncertainty_of_a_mean_over_wavelength_is_the_mean_of_the_changes():
    multiangle = spectra(second_decay=15.0)
    bsdf = beside(flake.build(multiangle, **COAT), multiangle, index_uncertainty=0.01)
    mean = SourceChanges(nonspectral(bsdf)).of_brdf(*AT)[..., 0]
    wanted = SourceChanges(bsdf).of_brdf(*AT) @ normalised_response(bsdf)
    np.testing.assert_allclose(mean, wanted, atol=1e-12 * np.abs(wanted).max())


def test_large_uncertainties_leave_a_possible_paint():
    multiangle = three_colours(5.0)
    changes = SourceChanges(beside(flake.build(multiangle, model="flake-physical"), multiangle, index_uncertainty=0.4))
    for one in changes.changed:
        assert (one.evaluate(*AT) >= 0).all()
        assert np.isfinite(one.evaluate(*AT)).all()
