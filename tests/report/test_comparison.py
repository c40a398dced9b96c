"""The figures and tables of two routes to one BRDF."""

from __future__ import annotations

import json
import re
from xml.etree import ElementTree

import comparison_primary
import numpy as np
import pytest
import samples
import xarray as xr

from brdfpipe import comparison as routes
from brdfpipe import facets, vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.report import comparison as page
from brdfpipe.report import rendering


@pytest.fixture(scope="module")
def compared() -> xr.Dataset:
    finish, spectrum = facets.analytic("beckmann", 0.15), samples.spectrum(0.2)
    truth = comparison_primary.deviating(finish, 1.5, spectrum)
    primary = comparison_primary.measured(truth, 1, incidences=(10.0, 60.0), wavelengths=(500.0, 540.0, 600.0))
    predicted = microfacet.build(finish, index=1.5, spectrum=spectrum, multiple_scattering="none")
    return routes.compare(primary, predicted, facets=finish, index=1.5, spectrum=spectrum)


def test_each_incidence_has_a_figure_and_all_have_one_of_ratios(compared) -> None:
    figures = page.figures(compared)
    assert [figure.title for figure in figures] == [
        "Measured over modelled BRDF",
        "Measured and predicted at 10°",
        "Measured and predicted at 60°",
    ]
    for figure in figures[1:]:
        assert [label for *_, label in figure.legend] == ["predicted", "adjusted", "measured ± u"]
        assert "at 540 nm" in figure.note
    assert f"{compared.attrs['values']} values at 2 incidences and 3 wavelengths" in figures[0].note
    assert page.figures(compared) == figures


def test_a_figure_shows_the_cells_near_the_plane_that_were_measured(compared) -> None:
    figure = page.figures(compared)[2]
    turn = (compared["phi_s"].values + 90) % 180 - 90
    near = (np.abs(turn) < 12) & np.isfinite(compared["brdf"].values[1, 1])
    (dots,) = re.findall(r'class="p c0 tiny" d="([^"]*)"', figure.svg)
    assert dots.count("h0") == near.sum() > 20
    nothing = compared.assign(brdf=compared["brdf"] * np.nan)
    assert [figure.title for figure in page.figures(nothing)] == ["Measured over modelled BRDF"]


def test_every_bar_of_the_differences_is_within_its_frame_or_counted(compared) -> None:
    for figure in page.figures(compared)[1:]:
        _, below = (
            figure.svg.split("</svg></svg>", 1) if "</svg></svg>" in figure.svg else figure.svg.rsplit("<svg class", 1)
        )
        tall = float(re.search(r'<svg x="\d+" y="\d+" width="\d+" height="(\d+)">', below)[1])
        bars = re.findall(r'<path class="l c[12] thin" d="([^"]*)"', below)
        ends = np.array([float(y) for data in bars for y in re.findall(r"[ML][-\d.]+ ([-\d.]+)", data)])
        assert len(bars) == 2
        assert ends.size > 80
        outside = int(((ends < 0) | (ends > tall)).sum())
        assert outside == 0 or "Outside the range of the lower chart" in figure.note


def test_a_difference_of_the_measured_to_a_model_is_drawn_with_its_uncertainty(compared) -> None:
    figure = page.figures(compared)[2]
    one = compared.sel(model="adjusted").isel(incidence=1).sel(wavelength=540)
    turn = (one["phi_s"].values + 90) % 180 - 90
    one = one.isel(cell=np.flatnonzero((np.abs(turn) < 12) & np.isfinite(one["brdf"].values)))
    below = figure.svg.rsplit('<svg class="fig"', 1)[1]
    (data,) = re.findall(r'<path class="l c2 thin" d="([^"]*)"', below)
    low, high = np.array([float(y) for y in re.findall(r"[ML][-\d.]+ ([-\d.]+)", data)]).reshape(-1, 2).T
    tall = float(re.search(r'<svg x="\d+" y="\d+" width="\d+" height="(\d+)">', below)[1])
    ratio = (one["brdf"] / one["brdf_model"]).values
    u = (one["brdf_u"] / one["brdf_model"]).values
    # Half of the frame is the largest difference shown: its scale follows from one bar, and all others with it.
    scale = (low - high) / (2 * u)
    assert scale == pytest.approx(np.full(u.size, np.median(scale)), rel=0.15)
    assert np.sort(tall / 2 - (low + high) / 2) == pytest.approx(np.sort((ratio - 1) * np.median(scale)), abs=0.3)


def test_the_table_of_inputs_shows_values_before_and_after(compared) -> None:
    table, _ = page.tables(compared)
    index, slope, diffuse = table.rows
    assert index[:2] == ("Refractive index, shift", "+0.000 ± 0.020")
    assert slope[:2] == ("Slope scale", "1.00 ± 0.10")
    assert float(slope[2].split()[0]) == pytest.approx(1.1, abs=0.005)
    assert diffuse[:2] == ("Diffuse scale", "1.000 ± 0.050")
    assert float(slope[3]) == pytest.approx(1.0, abs=0.05)
    assert {len(row) for row in table.rows} == {len(table.header)}


def test_the_table_of_agreement_has_a_row_for_each_incidence_and_model(compared) -> None:
    *_, table = page.tables(compared)
    incidences = [row[:2] for row in table.rows]
    assert incidences == [("10°", "predicted"), ("10°", "adjusted"), ("60°", "predicted"), ("60°", "adjusted")]
    assert {len(row) for row in table.rows} == {len(table.header)}
    assert float(table.rows[0][3]) > float(table.rows[1][3])


def test_a_note_states_enlarged_uncertainties(compared) -> None:
    assert "enlarged" not in page.tables(compared)[0].note
    assert "enlarged 3.0 times" in page.tables(compared.assign_attrs(enlarged=3.0))[0].note


def test_a_prediction_that_was_not_fitted_is_shown_without_a_fit(compared) -> None:
    inputs = [name for name in compared.variables if "input" in compared[name].dims or name == "correlation"]
    alone = compared.isel(model=[0]).drop_vars(inputs)
    assert [table.title for table in page.tables(alone)] == ["Agreement at each incidence"]
    assert [label for *_, label in page.figures(alone)[1].legend] == ["predicted", "measured ± u"]
    assert page.figures(alone)[0].legend == ()


def test_the_chapter_is_well_formed_and_lists_the_findings(compared) -> None:
    html = rendering.render("chapter.html.j2", chapter=page.chapter(compared))
    root = ElementTree.fromstring(html)
    assert [item.text for item in root.iter("h2")] == ["Measured and predicted"]
    findings = ["".join(item.itertext()).strip() for item in root.iter("li")]
    assert findings[0].startswith("Measured over predicted, median at 10°, 60° of incidence:")
    assert any("rougher than its facets say." in text for text in findings)
    assert len(list(root.iter("figure"))) == 3
    assert len(list(root.iter("table"))) == 2


def test_warnings_are_listed_in_the_chapter(compared) -> None:
    assert "notice warn" not in rendering.render("chapter.html.j2", chapter=page.chapter(compared))
    warned = vocabulary.add_warning(compared, "raise `comparison.slope_u`")
    html = rendering.render("chapter.html.j2", chapter=page.chapter(warned))
    assert "1 warning of the comparison" in html
    assert "raise <code>comparison.slope_u</code>" in html


def test_without_a_comparison_there_is_no_chapter() -> None:
    assert page.chapter(None) is None


def test_text_of_a_dataset_is_escaped(compared) -> None:
    wild = compared.assign_attrs(findings=json.dumps(["<script>alert(1)</script>"]))
    assert "<script" not in rendering.render("chapter.html.j2", chapter=page.chapter(wild))
