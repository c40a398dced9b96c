from __future__ import annotations

import re
from xml.etree import ElementTree

import samples
import xarray as xr
from samples import beckmann_bsdf, spectrum

from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.lambert_gauss import lambertian
from brdfpipe.facets import analytic, flat
from brdfpipe.report.plots import bsdf_cuts


def _titles(bsdf: xr.Dataset) -> list[str]:
    figures = bsdf_cuts.cuts(bsdf)
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
    assert _titles(samples.brushed_bsdf(0.1, 0.4, 30.0)) == ["BRDF along the lay", "BRDF across the lay"]


def test_a_narrow_lobe_is_also_shown_about_its_mirror_direction() -> None:
    assert "BRDF about the mirror direction" in _titles(beckmann_bsdf(0.01))
    assert "BRDF about the mirror direction" not in _titles(beckmann_bsdf(0.1))


def test_every_incidence_has_its_line_and_its_colour() -> None:
    cuts = bsdf_cuts.cuts(beckmann_bsdf())
    assert [label for _, _, label in cuts[0].legend] == ["incidence 0°", "30°", "45°", "60°", "75°"]
    assert len({style for _, style, _ in cuts[0].legend}) == 5


def test_both_planes_of_a_lay_share_one_scale() -> None:
    brushed = samples.brushed_bsdf(0.05, 0.4)
    along, across = (re.findall(r">(10[⁻⁰-⁹]+|[\d.]+)</text>", cut.svg)[7:] for cut in bsdf_cuts.cuts(brushed))
    assert along == across


def test_the_share_of_a_mirrored_ray_is_in_the_note_and_not_drawn_as_a_density() -> None:
    smooth = bsdf_cuts.cuts(microfacet.build(flat(), index=1.5, spectrum=spectrum(0.3)))
    assert [figure.title for figure in smooth] == ["BRDF, Cartesian"]
    assert "Dotted: light mirrored into one direction" in smooth[0].note
    assert "4.00\u202f% at 0°" in smooth[0].note  # (n − 1)² / (n + 1)²


def test_light_without_a_density_has_a_note_instead_of_a_chart() -> None:
    figures = bsdf_cuts.cuts(microfacet.build(flat(), index=1.5, transparent=True))
    assert [figure.title for figure in figures] == ["BRDF", "BTDF"]
    assert not any(figure.svg for figure in figures)
    assert "transmitted into one direction" in figures[1].note
    assert "96.0\u202f% at 0°" in figures[1].note


def test_the_note_on_a_black_material_states_that_it_reflects_nothing() -> None:
    (figure,) = bsdf_cuts.cuts(lambertian(spectrum(0.0)))
    assert figure.note == "No light is reflected in these planes."
    assert not figure.svg


# --- how much light goes where


# --- several reflections
