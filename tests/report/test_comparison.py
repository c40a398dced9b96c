"""The figures and tables of two routes to one BRDF."""

from __future__ import annotations

import numpy as np
import pytest
import routes_primary
import samples
import xarray as xr

from brdfpipe import facets, routes
from brdfpipe.bsdf import microfacet
from brdfpipe.report import comparison as page


@pytest.fixture(scope="module")
def compared() -> xr.Dataset:
    finish, spectrum = facets.analytic("beckmann", 0.15), samples.spectrum(0.2)
    truth = routes_primary.deviating(finish, 1.5, spectrum)
    primary = routes_primary.measured(truth, 1, incidences=(10.0, 60.0), wavelengths=(500.0, 540.0, 600.0))
    predicted = microfacet.build(finish, index=1.5, spectrum=spectrum)
    return routes.compare(primary, predicted, facets=finish, index=1.5, spectrum=spectrum)


def test_each_incidence_has_a_figure_and_all_have_one_of_ratios(compared) -> None:
    figures = page.figures(compared)
    assert [figure.title for figure in figures] == [
        "Measured and predicted at 10°",
        "Measured and predicted at 60°",
        "Measured over modelled BRDF",
    ]
    for figure in figures[:2]:
        assert [label for *_, label in figure.legend] == ["predicted", "adjusted", "measured ± u"]
        assert "at 540 nm" in figure.note
    assert f"{compared.attrs['values']} values at 2 incidences and 3 wavelengths" in figures[2].note
    assert page.figures(compared) == figures


def test_a_figure_shows_the_cells_near_the_plane_that_were_measured(compared) -> None:
    figure = page.figures(compared)[1]
    turn = (compared["phi_s"].values + 90) % 180 - 90
    near = (np.abs(turn) < 12) & np.isfinite(compared["brdf"].values[1, 1])
    assert figure.svg.count("h0") - figure.svg.count("h0M-") >= near.sum()
    nothing = compared.assign(brdf=compared["brdf"] * np.nan)
    assert [each.title for each in page.figures(nothing)] == ["Measured over modelled BRDF"]


def test_the_inputs_are_told_before_and_after(compared) -> None:
    index, slope, diffuse = page.inputs(compared)
    assert index[:2] == ("Refractive index, shift", "+0.000 ± 0.020")
    assert slope[:2] == ("Slope scale", "1.00 ± 0.10")
    assert slope[2].startswith("1.1")
    assert diffuse[:2] == ("Diffuse scale", "1.000 ± 0.050")
    assert float(slope[3]) == pytest.approx(1.0, abs=0.05)
    assert {len(row) for row in (index, slope, diffuse)} == {len(page.INPUTS_HEADER)}


def test_each_incidence_is_told_for_each_model(compared) -> None:
    rows = page.incidences(compared)
    assert [row[:2] for row in rows] == [
        ("10°", "predicted"),
        ("10°", "adjusted"),
        ("60°", "predicted"),
        ("60°", "adjusted"),
    ]
    assert {len(row) for row in rows} == {len(page.INCIDENCES_HEADER)}
    assert float(rows[0][3]) > float(rows[1][3])


def test_what_was_not_fitted_is_shown_without_a_fit(compared) -> None:
    inputs = [name for name in compared.variables if "input" in compared[name].dims or name == "correlation"]
    alone = compared.isel(model=[0]).drop_vars(inputs)
    assert page.inputs(alone) == []
    assert [label for *_, label in page.figures(alone)[0].legend] == ["predicted", "measured ± u"]
    assert page.figures(alone)[-1].legend == ()
