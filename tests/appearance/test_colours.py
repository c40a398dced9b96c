"""Colours of materials whose colour is known."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
import samples

from brdfpipe import appearance, facets, vocabulary
from brdfpipe.appearance import computation
from brdfpipe.appearance.colours import TOTAL, colour, colour_uncertainty, colour_without_specular, flop_index
from brdfpipe.bsdf import lambert_gauss, microfacet
from brdfpipe.errors import BrdfpipeError
from brdfpipe.flakes import SETS
from brdfpipe.spectra import colorimetry


def test_flop_index_is_the_printed_one():
    assert flop_index(120, 60, 30) == pytest.approx(11.74225183, abs=5e-9)


@pytest.mark.parametrize("lightness", [(30, 60, 120), (50, 0, 10), (np.nan, 50, 20)])
def test_flop_index_is_missing_where_it_is_not_defined(lightness):
    assert np.isnan(flop_index(*lightness))


def test_a_white_lambertian_is_white_from_everywhere():
    lab = colour(lambert_gauss.lambertian(samples.spectrum(1.0)))
    assert lab.sel(component="L*").values == pytest.approx(100, abs=1e-9)
    assert lab.sel(component=["a*", "b*"]).values == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(("observer", "illuminant"), [(2, "D65"), (10, "A")])
def test_the_total_reflectance_gives_the_colour_of_its_spectrum(observer, illuminant):
    reflectance = 0.1 + 0.5 * (samples.WAVELENGTH > 580)
    lab = colour(samples.beckmann_bsdf(0.2, reflectance=reflectance), illuminant=illuminant, observer=observer)
    xyz = colorimetry.reflectance_to_xyz(samples.WAVELENGTH, reflectance, illuminant, observer)
    white = colorimetry.weights(illuminant, observer).white
    assert lab.sel(geometry="8:total").values == pytest.approx(colorimetry.xyz_to_lab(xyz, white), abs=1e-9)


def test_a_geometry_near_the_mirror_direction_sees_the_gloss():
    lightness = colour(samples.beckmann_bsdf(0.15, reflectance=0.1)).sel(component="L*")
    assert lightness.sel(geometry="45as15") > lightness.sel(geometry="45as45") > 0


def test_a_material_without_colour_is_neutral():
    lab = colour(samples.beckmann_bsdf(0.2, reflectance=None))
    assert lab.sel(component=["a*", "b*"]).values == pytest.approx(0, abs=1e-9)


def test_the_appearance_is_consistent():
    computed = appearance.compute_appearance(samples.beckmann_bsdf(0.1, reflectance=0.2))
    gloss = computed["gloss"].sel(gloss_angle=[60, 20]).values
    assert float(computed["haze"]) == pytest.approx(gloss[0] - gloss[1])
    assert float(computed["luminous_reflectance"]) == pytest.approx(0.2, abs=1e-9)
    assert computed["srgb"].values == pytest.approx(np.full(3, 0.4845), abs=1e-3)
    assert json.dumps(computed.attrs)


@pytest.mark.parametrize("name", SETS)
def test_a_white_lambertian_is_white_at_every_geometry(name):
    lab = colour(lambert_gauss.lambertian(samples.spectrum(1.0)), [name])
    assert lab["geometry"].values.tolist() == ["8:total", *SETS[name]]
    assert lab.sel(component="L*").values == pytest.approx(100, abs=1e-9)


def test_colours_of_a_set_are_those_of_the_prediction():
    bsdf = samples.beckmann_bsdf(0.3, reflectance=0.2)
    expected = appearance.predicted_colours(bsdf, "MA-T12")["lab"].values
    assert colour(bsdf, ["MA-T12"]).values[1:] == pytest.approx(expected, abs=1e-9)


def test_an_appraisal_at_further_geometries_keeps_those_that_are_always_there():
    bsdf = samples.beckmann_bsdf(0.3, reflectance=0.2)
    plain, more = (
        appearance.compute_appearance(bsdf),
        appearance.compute_appearance(bsdf, geometries=["E2194", "DIN 6175-2", "E2539"]),
    )
    names = more["geometry"].values.tolist()
    assert names[:5] == plain["geometry"].values.tolist() == ["8:total", "45:0", "45as15", "45as45", "45as110"]
    assert sorted(names[5:]) == ["15as-15", "15as15", "45as-15", "45as25", "45as75"]
    assert more["lab"].sel(geometry=names[:5]).values == pytest.approx(plain["lab"].values, abs=1e-12)


def test_an_unknown_set_of_geometries_is_refused_with_the_nearest():
    with pytest.raises(ValueError, match="nearest is E2194"):
        colour(samples.beckmann_bsdf(0.1), ["E2195"])


def test_a_paint_that_brightens_away_from_the_mirror_direction_has_no_flop_index_but_a_warning(monkeypatch):
    def upside_down(*arguments, **choices):
        lab = colour(*arguments, **choices)
        lab.loc[{"geometry": ["45as15", "45as110"], "component": "L*"}] = [30.0, 120.0]
        return lab

    monkeypatch.setattr(computation, "colour", upside_down)
    computed = appearance.compute_appearance(samples.beckmann_bsdf(0.1, reflectance=0.2))
    assert np.isnan(float(computed["flop_index"]))
    assert vocabulary.warnings(computed)[0].startswith("No flop index: L* rises from 30.0 at 15°")


def test_a_perfect_diffuser_has_a_flop_index_of_0_and_no_warning():
    computed = appearance.compute_appearance(lambert_gauss.lambertian(samples.spectrum(0.5)))
    assert float(computed["flop_index"]) == pytest.approx(0, abs=1e-8)
    assert not vocabulary.warnings(computed)


def test_the_appearance_contains_uncertainties_and_reflectance_haze():
    computed = vocabulary.validate(appearance.compute_appearance(samples.beckmann_bsdf(0.1)), "appearance")
    assert ((computed["gloss_u"] > 0) & (computed["gloss_u"] < computed["gloss"])).all()
    assert computed["reflectance_haze"].sizes == {"haze_window": 1}
    assert "reflectance_haze" not in appearance.compute_appearance(samples.beckmann_bsdf(0.1), haze=[])


def test_haze_needs_both_of_its_geometries():
    assert np.isnan(float(appearance.compute_appearance(samples.beckmann_bsdf(0.1), gloss_angles=[60])["haze"]))


def test_an_unknown_illuminant_is_refused():
    with pytest.raises(ValueError, match="D99"):
        colour(samples.beckmann_bsdf(0.1), illuminant="D99")


@cache
def brushed(azimuth):
    surface = facets.analytic("beckmann", a_x=0.05, a_y=0.3, azimuth=azimuth)
    with samples.coarse_albedo_tables():
        return microfacet.build(surface, index=1.5, spectrum=samples.spectrum(0.2), multiple_scattering="none")


def test_colours_of_a_surface_with_a_lay_are_those_of_the_mean_over_the_azimuth():
    first, turned = colour(brushed(0)), colour(brushed(37))
    # The directional albedo is tabulated every 15° of azimuth.
    assert turned.values == pytest.approx(first.values, abs=5e-3)
    lightness = [
        float(colour(brushed(37), azimuth=azimuth).sel(geometry="45as15", component="L*")) for azimuth in (37, 127)
    ]
    # 15° from the mirror direction, only slopes across the lay reach far enough.
    assert lightness[1] > float(first.sel(geometry="45as15", component="L*")) > lightness[0]


def test_the_appearance_of_a_surface_with_a_lay_contains_both_planes():
    computed = vocabulary.validate(appearance.compute_appearance(brushed(37), gloss_angles=[60], haze=()), "appearance")
    assert float(computed["lay"]) == pytest.approx(37, abs=1e-6)
    assert float(computed["gloss_along"][0]) > float(computed["gloss"][0]) > float(computed["gloss_across"][0])
    assert computed["lab_along"].sel(geometry="8:total").values == pytest.approx(
        computed["lab"].sel(geometry="8:total").values, abs=1e-12
    )
    assert not {"gloss_along", "lay"} & set(
        appearance.compute_appearance(samples.beckmann_bsdf(0.1), haze=()).variables
    )


def test_geometries_off_the_mirror_direction_of_a_polished_surface_see_its_base_alone():
    lab = colour(microfacet.build(facets.flat(), index=1.5))
    assert lab.sel(component="L*").values[1:] == pytest.approx(0, abs=1e-12)
    # All of F(8°) = 0.0400063 is in the total: L* = 116 (0.0400063)^(1/3) − 16.
    assert float(lab.sel(geometry="8:total", component="L*")) == pytest.approx(
        116 * 0.0400063 ** (1 / 3) - 16, abs=1e-4
    )


def test_the_tolerance_of_directions_leaves_a_perfect_diffuser_as_it_is():
    uncertainty = colour_uncertainty(lambert_gauss.lambertian(samples.spectrum(0.5)))
    assert uncertainty["lab_u"].values[1:] == pytest.approx(0, abs=1e-9)
    assert float(uncertainty["flop_index_u"]) == pytest.approx(0, abs=1e-6) or np.isnan(uncertainty["flop_index_u"])


@pytest.mark.parametrize("a", [0.2, 0.4])
def test_the_uncertainty_of_a_colour_is_that_of_instruments_off_by_the_tolerance(a):
    glossy = samples.beckmann_bsdf(a)
    # In the plane of incidence; by symmetry a turn out of it changes nothing to first order. View and mirror lie at azimuth 180.
    asked = {
        "light-": (44.5, 30.0, 180.0),
        "light+": (45.5, 30.0, 180.0),
        "view-": (45.0, 29.5, 180.0),
        "view+": (45.0, 30.5, 180.0),
    }
    lightness = colour(glossy, asked).sel(component="L*").values[1:]
    expected = np.sqrt((np.diff(lightness)[[0, 2]] ** 2).sum() / 12)
    lightness_u = colour_uncertainty(glossy)["lab_u"].sel(geometry="45as15", component="L*")
    assert float(lightness_u) == pytest.approx(expected, rel=1e-3)
    assert float(lightness_u) > 0


def test_the_uncertainty_of_a_flop_index_has_one_light_for_all_geometries():
    glossy = samples.beckmann_bsdf(0.3)

    def index(light, views):
        asked = {f"{k}": (45 + light, abs(theta), 180.0 if theta < 0 else 0.0) for k, theta in enumerate(views)}
        return flop_index(*colour(glossy, asked).sel(component="L*").values[1:])

    nominal = np.array([-30.0, 0.0, 65.0])
    half = [(index(0.5, nominal) - index(-0.5, nominal)) / 2]
    half += [(index(0, nominal + 0.5 * one) - index(0, nominal - 0.5 * one)) / 2 for one in np.eye(3)]
    expected = np.sqrt(np.sum(np.square(half)) / 3)
    assert float(colour_uncertainty(glossy)["flop_index_u"]) == pytest.approx(expected, rel=0.01)


def test_without_the_three_geometries_of_e2194_there_is_no_uncertainty_of_a_flop_index():
    assert np.isnan(colour_uncertainty(samples.beckmann_bsdf(0.3), ["45:0"])["flop_index_u"])


def test_short_names_with_two_meanings_are_refused_among_geometries():
    with pytest.raises(BrdfpipeError, match="ambiguous together"):
        colour(samples.beckmann_bsdf(0.3), ["as-15", "as15"])


def test_a_paint_that_is_black_at_45_degree_has_no_flop_index():
    assert np.isnan(flop_index(20.0, 0.0, 0.0))
    assert np.isnan(flop_index(20.0, 0.05, 0.0))
    assert flop_index(20.0, 0.5, 0.0) > 0


@pytest.mark.parametrize(("a", "trap"), [(0.01, 5.0), (0.05, 5.0), (0.3, 5.0)])
def test_the_colour_without_specular_is_that_of_the_spectrum_measured_so(a: float, trap: float) -> None:
    """A body of which an instrument with a gloss trap read the spectrum has the colour of that spectrum in that instrument."""
    read = samples.spectrum(0.2 + 0.1 * np.sin(samples.WAVELENGTH / 40), geometry="sce").assign_attrs(
        specular_trap=trap
    )
    bsdf = microfacet.build(facets.analytic("beckmann", a), index=1.5, spectrum=read)
    xyz = colorimetry.reflectance_to_xyz(samples.WAVELENGTH, read["total_reflectance"].values, "D65", 10)
    expected = colorimetry.xyz_to_lab(xyz, colorimetry.weights("D65", 10).white)
    # The trap takes a little of the base too, which the spectrum has (0.8 % of the light in a cone of 5°): 0.3 of L*.
    found = colour_without_specular(bsdf).values
    assert found == pytest.approx(expected, abs=0.3)
    assert found[0] < expected[0]


def test_the_colour_without_specular_of_a_polished_body_is_without_its_mirror_image() -> None:
    grey = samples.spectrum(0.3)
    bsdf = microfacet.build(facets.flat(), index=1.5, spectrum=grey)
    total = colour(bsdf, ()).sel(geometry=TOTAL, component="L*")
    # 4 % of the light are mirrored: L* of 0.26 instead of 0.3, and of the base in the trap 0.8 % of it.
    assert float(total - colour_without_specular(bsdf)[0]) == pytest.approx(3.65, abs=0.3)
