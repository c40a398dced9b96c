"""What the page shows of a paint with effect pigments."""

from __future__ import annotations

import numpy as np
import pytest

from brdfpipe import flakes, report
from brdfpipe.bsdf import flake
from brdfpipe.report.plots import flake_angle_plot

WAVELENGTH = list(range(400, 701, 50))


def multiangle(kind):
    names = ["45as15", "45as25", "45as45", "45as75", "45as110"]
    if kind == "lab":
        listed = [{"geometry": name, "lab": [60.0 / (k + 1), 0.0, -5.0 / (k + 1)]} for k, name in enumerate(names)]
        return flakes.ingest({"colours": listed, "illuminant": "D65", "observer": 10})
    fall = 0.02 + np.exp(-np.array([4.2, 7.0, 13.8, 22.0, 31.0]) / 5)
    listed = [{"geometry": name, "reflectance": [value] * 7} for name, value in zip(names, fall.tolist(), strict=True)]
    return flakes.ingest({"colours": listed, "wavelength": WAVELENGTH, "scale": "fraction"})


@pytest.mark.parametrize("kind", ["lab", "spectra"])
@pytest.mark.parametrize("model", ["flake", "flake-physical"])
def test_the_page_has_geometries_parameters_and_their_uncertainty(kind, model):
    measured = multiangle(kind)
    bsdf = flake.build(measured, model=model)
    html = report.material_page({"multiangle": measured, "flake": bsdf, "bsdf": bsdf.assign_attrs(route="flake")})
    assert "Flake from colours at 5 geometries" in html
    assert "45as110" in html
    assert "Fit along the flake angle" in html
    assert " ± " in html
    assert "no spectrum is known" not in html.lower()


def test_the_table_contains_the_errors_of_left_out_geometries():
    measured = multiangle("lab")
    header, rows = flake_angle_plot.geometry_rows(flake.build(measured), measured)
    assert len(header) == len(rows[0]) == 7
    assert rows[0][:3] == ("45as15", "4.33°", "60.00")
    assert all(float(row[-1]) > 0 for row in rows)


def test_of_three_geometries_none_can_be_left_out():
    measured = multiangle("lab").isel(geometry=[0, 2, 4])
    _, rows = flake_angle_plot.geometry_rows(flake.build(measured), measured)
    assert [row[-1] for row in rows] == ["–"] * 3
