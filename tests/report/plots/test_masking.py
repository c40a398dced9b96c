from __future__ import annotations

import re

import numpy as np
import pytest
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.facets import analytic
from brdfpipe.masking.analytic_smith import beckmann_lambda
from brdfpipe.report.plots import masking
from brdfpipe.report.plots.svg import Figure, Line


def _labels(figure: Figure) -> list[str]:
    return [label for *_, label in figure.legend]


def _masking(smith: np.ndarray | None = None) -> xr.Dataset:
    theta = np.array([0.0, 30.0, 60.0, 80.0])
    g1 = 1 / (1 + beckmann_lambda(theta, 0.2)) if smith is None else smith
    curves = {"g1_raycast": g1 - 0.01, "g1_raycast_u": np.array([0.0, 0.002, 0.003, np.nan]), "g1_smith": g1}
    result = xr.Dataset(
        {name: ("theta", values) for name, values in curves.items()}, coords={"theta": theta}, attrs={"method": "rays"}
    )
    return vocabulary.label(result, "masking")


def test_masking_along_the_lay_is_that_of_the_narrow_width(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Line] = []
    monkeypatch.setattr(masking, "_figure", lambda title, name, marks, note: drawn.extend(marks))
    masking.smith_masking_with_lay(analytic("beckmann", a_x=0.2, a_y=0.5, azimuth=30.0), 30.0)
    theta = np.array([70.0, 85.0])
    for line, width in zip(drawn, (0.2, 0.5), strict=True):
        np.testing.assert_allclose(np.interp(theta, line.x, line.y), 1 / (1 + beckmann_lambda(theta, width)), atol=5e-3)


def test_ray_casting_is_drawn_with_error_bars_where_they_are_known() -> None:
    figure = masking.raycast_figure(_masking())
    points, bars = (
        re.search(r'class="p c2" d="([^"]*)"', figure.svg),
        re.search(r'class="e c2" d="([^"]*)"', figure.svg),
    )
    assert points is not None
    assert bars is not None
    assert points[1].count("h0") == 4
    assert bars[1].count("V") == 3
    assert "nan" not in figure.svg


def test_smith_is_drawn_finely_only_where_it_is_the_facets_own() -> None:
    facets = analytic("beckmann", 0.2)
    assert masking._smith_curve(_masking(), facets)[0].size > 100
    assert masking._smith_curve(_masking(np.array([1.0, 0.9, 0.8, 0.7])), facets)[0].size == 4
    assert masking._smith_curve(_masking(), None)[0].size == 4


def test_ray_casting_without_uncertainty_has_no_bars() -> None:
    figure = masking.raycast_figure(_masking().drop_vars("g1_raycast_u"))
    assert 'class="e c2" d=""' in figure.svg


def test_g2_is_drawn_against_both_forms_of_smith_where_it_was_cast() -> None:
    comparison = _masking()
    assert masking.bistatic_figure(comparison) is None
    cast = {
        "g2_raycast": [1.0, 0.9, 0.5, np.nan],
        "g2_raycast_u": [0.0, 0.01, np.nan, np.nan],
        "g2_separable": [1.0, 0.85, 0.4, 0.1],
        "g2_height_correlated": [1.0, 0.9, 0.6, 0.2],
    }
    figure = masking.bistatic_figure(comparison.assign({name: ("theta", values) for name, values in cast.items()}))
    assert figure is not None
    assert _labels(figure)[:2] == ["Smith, height-correlated", "Smith, separable"]
    points = re.search(r'class="p c2" d="([^"]*)"', figure.svg)
    assert points is not None
    assert points[1].count("h0") == 3  # no facet faces both directions at the fourth
    assert "nan" not in figure.svg
