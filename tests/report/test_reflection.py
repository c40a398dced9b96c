from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest
import xarray as xr
from samples import beckmann_bsdf, spectrum

from brdfpipe.bsdf import microfacet, slab
from brdfpipe.bsdf.lambert_gauss import lambertian
from brdfpipe.facets import analytic, flat
from brdfpipe.report import reflection
from brdfpipe.report.scattering import Plane

Datasets = dict[str, xr.Dataset]

_NORMAL = Plane(0.0, "")


def _titles(bsdf: xr.Dataset) -> list[str]:
    figures = reflection.cuts(bsdf)
    for figure in figures:
        if figure.svg:
            ElementTree.fromstring(figure.svg)
        assert not re.search(r"nan|inf\b", "".join(re.findall(r' d="([^"]*)"', figure.svg)))
    return [figure.title for figure in figures]


def test_the_cuts_of_a_surface_are_those_of_its_planes_and_sides() -> None:
    rough = analytic("beckmann", 0.3)
    assert _titles(microfacet.build(rough, index=1.5)) == ["BRDF, goniometric", "BRDF, Cartesian"]
    assert _titles(microfacet.build(rough, index=1.5, transparent=True)) == [
        "BSDF, goniometric",
        "BRDF, Cartesian",
        "BTDF, Cartesian",
    ]
    brushed = analytic("beckmann", a_x=0.1, a_y=0.4, azimuth=30.0)
    assert _titles(microfacet.build(brushed, index=1.5)) == ["BRDF along the lay", "BRDF across the lay"]


def test_a_narrow_lobe_is_also_shown_about_its_mirror_direction() -> None:
    assert "BRDF about the mirror direction" in _titles(beckmann_bsdf(0.01))
    assert "BRDF about the mirror direction" not in _titles(beckmann_bsdf(0.1))


def test_every_incidence_has_its_line_and_its_colour() -> None:
    cuts = reflection.cuts(beckmann_bsdf())
    assert [label for _, _, label in cuts[0].legend] == ["incidence 0°", "30°", "45°", "60°", "75°"]
    assert len({style for _, style, _ in cuts[0].legend}) == 5


def test_both_planes_of_a_lay_share_one_scale() -> None:
    brushed = microfacet.build(analytic("beckmann", a_x=0.05, a_y=0.4), index=1.5)
    along, across = (re.findall(r">(10[⁻⁰-⁹]+|[\d.]+)</text>", cut.svg)[7:] for cut in reflection.cuts(brushed))
    assert along == across


def test_a_mirrored_ray_is_told_with_its_share_and_not_drawn_as_a_density() -> None:
    smooth = reflection.cuts(microfacet.build(flat(), index=1.5, spectrum=spectrum(0.3)))
    assert [figure.title for figure in smooth] == ["BRDF, Cartesian"]
    assert "Dotted: light mirrored into one direction" in smooth[0].note
    assert "4.00\u202f% at 0°" in smooth[0].note  # (n − 1)² / (n + 1)²


def test_what_has_no_density_at_all_is_a_sentence() -> None:
    figures = reflection.cuts(microfacet.build(flat(), index=1.5, transparent=True))
    assert [figure.title for figure in figures] == ["BRDF", "BTDF"]
    assert not any(figure.svg for figure in figures)
    assert "transmitted into one direction" in figures[1].note
    assert "96.0\u202f% at 0°" in figures[1].note


def test_a_black_material_says_that_it_reflects_nothing() -> None:
    (figure,) = reflection.cuts(lambertian(spectrum(0.0)))
    assert figure.note == "No light is reflected in these planes."
    assert not figure.svg


# --- how much light goes where


def test_the_parts_of_the_reflectance_add_up_to_the_total(full: Datasets) -> None:
    parts = reflection.reflectance_parts(full["bsdf"], _NORMAL, reflection.GRAZING)
    assert parts.facets is not None
    assert parts.below is not None
    assert (parts.facets <= parts.total).all()
    np.testing.assert_allclose(parts.mirrored + parts.facets + parts.below, parts.total, rtol=1e-12)
    assert not parts.mirrored.any()


def test_of_a_smooth_surface_the_mirrored_part_is_that_of_fresnel() -> None:
    smooth = microfacet.build(flat(), index=1.5, spectrum=spectrum(0.3))
    parts = reflection.reflectance_parts(smooth, _NORMAL, np.array([0.0, 8.0]))
    assert parts.facets is not None
    assert parts.mirrored[0] == pytest.approx(0.04, rel=1e-12)
    assert np.abs(parts.facets).max() < 1e-15
    assert parts.total[1] == pytest.approx(0.3, abs=1e-9)


def test_the_directional_reflectance_is_that_of_the_bsdf(full: Datasets) -> None:
    total = reflection.reflectance_parts(full["bsdf"], _NORMAL, np.array([8.0])).total[0]
    # The BSDF closes on the spectrum at 8 degree, to the accuracy of the tabulated albedo.
    assert total == pytest.approx(float(full["spectrum"]["total_reflectance"].sel(wavelength=550.0)), abs=1e-6)


def test_without_a_bsdf_the_checks_give_the_directional_reflectance(full: Datasets) -> None:
    (curve,) = reflection.shares(full["checks"], None)
    assert curve.legend == ()
    assert reflection.shares(None, None) == []


def test_a_masking_that_gains_energy_is_drawn_to_scale_and_told() -> None:
    (figure,) = reflection.shares(None, beckmann_bsdf(0.3, recipe="crf"))
    assert "on more light leaves than arrives" in figure.note
    assert "`model.masking: height-correlated`" in figure.note
    assert ">1.00<" in figure.svg
    (sound,) = reflection.shares(None, beckmann_bsdf(0.3))
    assert "leaves than arrives" not in sound.note


def test_what_a_compensated_model_gives_back_is_a_line_of_its_own() -> None:
    (figure,) = reflection.shares(None, beckmann_bsdf(0.5, n=2.5, multiple_scattering="compensated"))
    assert "by one facet alone" in [label for *_, label in figure.legend]


def test_the_balance_of_a_smooth_interface_closes() -> None:
    (figure,) = reflection.shares(None, microfacet.build(flat(), index=1.5, transparent=True))
    assert figure.title == "Balance of the light"
    assert [label for *_, label in figure.legend] == ["R, mirrored", "T, refracted"]
    assert "R + T = 1.0000 at every incidence." in figure.note


def test_the_balance_of_rough_facets_names_what_they_lose() -> None:
    (figure,) = reflection.shares(None, microfacet.build(analytic("ggx", 0.4), index=1.5, transparent=True))
    assert [label for *_, label in figure.legend] == ["R, reflected", "T, transmitted", "lost between facets"]
    assert "the rest would leave after a second reflection between facets" in figure.note


def test_the_balance_of_a_slab_states_what_it_absorbs() -> None:
    sheet = slab.build(flat(), flat(), index=1.5, internal_transmittance=0.8)
    (figure,) = reflection.shares(None, sheet)
    assert [label for *_, label in figure.legend] == ["R, mirrored", "T, straight", "absorbed"]
    # R = ρ + ρ (1−ρ)² τ² / (1 − ρ² τ²), T = (1−ρ)² τ / (1 − ρ² τ²) with ρ = 0.04, τ = 0.8: A = 1 − R − T = 0.1983
    assert "R + T + A = 1.0000; A, what the body absorbs, is 19.8\u202f% at 0°" in figure.note


@pytest.mark.parametrize(
    ("reflected", "passed", "total", "words"),
    [
        (0.1, 0.9, None, "R + T = 1.0000 at every incidence."),
        (0.1, 0.6, 1.0, "R + T + A = 1.0000; A, what the body absorbs, is 30.0\u202f% at 0°"),
        (0.1, 0.6, None, "R + T = 0.7000 at 0°"),
        (0.2, 0.9, None, "R + T reaches 1.1000 at 0° incidence: more leaves than arrives"),
    ],
)
def test_the_sum_of_a_balance_is_told(reflected: float, passed: float, total: float | None, words: str) -> None:
    assert words in reflection.balance_words(np.array([0.0, 60.0]), np.full(2, reflected), np.full(2, passed), total)


# --- several reflections


def test_the_loss_of_the_plain_model_is_what_compensation_gives_back() -> None:
    rough = analytic("ggx", 0.5)
    for k in (0.0, 4.0):
        index = xr.Dataset(
            {"n": ("wavelength", [1.5, 1.5]), "k": ("wavelength", [k, k])}, {"wavelength": [400.0, 700.0]}
        )
        index = microfacet.vocabulary.label(index.assign_attrs(source="test"), "index")
        plain = reflection.multiple_scattering(microfacet.build(rough, index=index))
        given = reflection.multiple_scattering(microfacet.build(rough, index=index, multiple_scattering="compensated"))
        assert plain is not None
        assert given is not None
        assert (plain.compensated, given.compensated) == (False, True)
        assert plain.mirrors == pytest.approx(given.mirrors, abs=2e-5)  # the tabulated mean and the quick one
        assert plain.share == pytest.approx(given.share, rel=1e-3)  # of which 1 − Ē₁ has 1e-4


def test_what_has_no_facets_loses_nothing() -> None:
    assert reflection.multiple_scattering(lambertian(spectrum(0.3))) is None
    assert reflection.multiple_scattering(microfacet.build(flat(), index=1.5)) is None
