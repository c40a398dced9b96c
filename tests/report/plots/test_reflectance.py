from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from samples import beckmann_bsdf

from brdfpipe.bsdf import microfacet, slab
from brdfpipe.facets import analytic, flat
from brdfpipe.report.plots import reflectance

Datasets = dict[str, xr.Dataset]


def test_without_a_bsdf_the_checks_give_the_directional_reflectance(full: Datasets) -> None:
    (curve,) = reflectance.shares(full["checks"], None)
    assert curve.legend == ()
    assert reflectance.shares(None, None) == []


def test_a_masking_that_gains_energy_is_drawn_to_scale_with_a_note() -> None:
    (figure,) = reflectance.shares(None, beckmann_bsdf(0.3, recipe="crf"))
    assert "on more light leaves than arrives" in figure.note
    assert "`model.masking: height-correlated`" in figure.note
    assert ">1.00<" in figure.svg
    (sound,) = reflectance.shares(None, beckmann_bsdf(0.3))
    assert "leaves than arrives" not in sound.note


def test_the_compensated_light_is_a_line_of_its_own() -> None:
    (figure,) = reflectance.shares(None, beckmann_bsdf(0.5, n=2.5, multiple_scattering="compensated"))
    assert "by one facet alone" in [label for *_, label in figure.legend]


def test_the_balance_of_a_smooth_interface_closes() -> None:
    (figure,) = reflectance.shares(None, microfacet.build(flat(), index=1.5, transparent=True))
    assert figure.title == "Balance of the light"
    assert [label for *_, label in figure.legend] == ["R, mirrored", "T, refracted"]
    assert "R + T = 1.0000 at every incidence." in figure.note


def test_the_balance_of_rough_facets_states_their_loss() -> None:
    (figure,) = reflectance.shares(None, microfacet.build(analytic("ggx", 0.4), index=1.5, transparent=True))
    assert [label for *_, label in figure.legend] == ["R, reflected", "T, transmitted", "lost between facets"]
    assert "The rest would leave after a second reflection between facets" in figure.note


def test_the_balance_of_a_slab_states_its_absorption() -> None:
    sheet = slab.build(flat(), flat(), index=1.5, internal_transmittance=0.8)
    (figure,) = reflectance.shares(None, sheet)
    assert [label for *_, label in figure.legend] == ["R, mirrored", "T, straight", "absorbed"]
    # R = ρ + ρ (1−ρ)² τ² / (1 − ρ² τ²), T = (1−ρ)² τ / (1 − ρ² τ²) with ρ = 0.04, τ = 0.8: A = 1 − R − T = 0.1983
    assert "R + T + A = 1.0000; A, absorbed by the body, is 19.8\u202f% at 0°" in figure.note


@pytest.mark.parametrize(
    ("reflected", "passed", "total", "words"),
    [
        (0.1, 0.9, None, "R + T = 1.0000 at every incidence."),
        (0.1, 0.6, 1.0, "R + T + A = 1.0000; A, absorbed by the body, is 30.0\u202f% at 0°"),
        (0.1, 0.6, None, "R + T = 0.7000 at 0°"),
        (0.2, 0.9, None, "R + T reaches 1.1000 at 0° incidence: more light leaves than arrives"),
    ],
)
def test_the_note_on_a_balance_states_its_sum(reflected: float, passed: float, total: float | None, words: str) -> None:
    assert words in reflectance.balance_words(np.array([0.0, 60.0]), np.full(2, reflected), np.full(2, passed), total)
