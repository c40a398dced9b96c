"""The uncertainty budget: its declaration, and the terms that follow from the BRDF itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import rig_accuracy as accuracy
import rig_emulated
from rig_reduced import NAMES, brdf_of, directions, reduced

from brdfpipe.optics.index import refractive_index
from brdfpipe.rig.emulator.effects import Effects
from brdfpipe.rig.reduction.budget import BY_NAME, TERMS, dominant, terms_of_brdf


def sample(brdf, wavelengths=(500.0, 510.0, 520.0), **attrs):
    """A sample at 30°, with a BRDF of directions and wavelengths, and its terms."""
    theta, phi = directions()
    dataset = reduced("sample", (30.0,)).isel(wavelength=slice(0, len(wavelengths))).assign_attrs(attrs)
    dataset = dataset.assign_coords(wavelength=np.array(wavelengths))
    values = np.stack([brdf(theta, phi, wavelength) for wavelength in wavelengths])[None]
    return values, terms_of_brdf(dataset, values, np.array([10.0]))


def test_every_component_is_declared_once():
    primary = brdf_of(reduced("sample"))
    found = {str(name).removeprefix("brdf_u_") for name in primary.data_vars if str(name).startswith("brdf_u_")}
    assert found == set(NAMES) == set(BY_NAME)
    assert len(TERMS) == len(BY_NAME)
    for term in TERMS:
        assert term.evaluation in "AB"
        assert term.distribution in ("normal", "rectangular")
        assert term.freedom > 0
        assert term.origin


def test_the_wavelength_counts_by_the_slope_of_the_spectrum():
    _, terms = sample(lambda theta, phi, nm: np.full(theta.size, 0.1 + 0.002 * (nm - 500)), wavelength_u=0.2)
    assert terms["wavelength"] == pytest.approx(0.002 * 0.2)
    assert terms["band"] == pytest.approx(0.0, abs=1e-12)


def test_the_band_counts_by_the_curvature_of_the_spectrum():
    _, terms = sample(lambda theta, phi, nm: np.full(theta.size, 0.1 + 1e-4 * (nm - 500) ** 2), slit=20.0)
    # The mean of a parabola a x² over a triangle of the full width s at half maximum is a s²/6.
    assert terms["band"] == pytest.approx(1e-4 * 20**2 / 6)


@pytest.mark.parametrize("apart", [10.0, 40.0])
def test_a_bend_anywhere_between_distant_wavelengths_counts_as_often_as_it_lies_within_the_band(apart):
    slit, change, nodes = 10.0, 0.01, 500 + np.array([-1.0, 0.0, 1.0]) * apart
    offset = np.linspace(-slit, slit, 4001)
    triangle = (1 - np.abs(offset) / slit) / slit
    error, u = [], []
    for bend in 500 + np.linspace(-apart / 2, apart / 2, 101):
        # The same change of slope wherever it is: as large as that of the slopes in the middles of the intervals.
        seen = change / (1 - abs(bend - 500) / apart)
        spectrum = 0.1 + seen * np.maximum(nodes - bend, 0.0)
        _, terms = sample(
            lambda theta, phi, nm, s=spectrum: np.full(theta.size, s[nodes == nm].item()), nodes, slit=slit
        )
        u.append(float(terms["band"].max()))
        bent = np.maximum(500 + offset - bend, 0.0) - max(500 - bend, 0.0)
        error.append(change * np.sum(triangle * bent) * (offset[1] - offset[0]))
    assert u == pytest.approx([u[0]] * len(u))
    assert u[0] == pytest.approx(np.sqrt(np.mean(np.square(error))), rel=0.02)


def test_polarised_light_counts_by_the_surface_reflection():
    values, terms = sample(lambda theta, phi, nm: np.full(theta.size, 0.3), polarisation=0.2)
    # A matt surface depolarises.
    assert terms["polarisation"] == pytest.approx(0.0, abs=1e-15)
    values, terms = sample(lambda theta, phi, nm: 0.1 + np.exp(-theta / 10), polarisation=0.2)
    assert (terms["polarisation"] <= 0.2 * values).all()
    assert terms["polarisation"].max() > 0.01


def test_light_of_a_metal_is_polarised_less_than_that_of_a_plastic_of_unknown_index():
    theta, _ = directions()
    dataset = reduced("sample", (30.0,)).assign_attrs(polarisation=0.2)
    values = np.broadcast_to(0.1 + np.exp(-theta / 10), (1, dataset.sizes["wavelength"], theta.size))

    def polarised(index):
        return terms_of_brdf(dataset, values, np.array([10.0]), index)["polarisation"]

    unknown, plastic, metal = (
        polarised(spec if spec is None else refractive_index(spec)) for spec in (None, 1.5, {"n": 1.2, "k": 7.0})
    )
    assert plastic == pytest.approx(unknown, rel=1e-9)
    assert 0 < metal.max() < 0.3 * plastic.max()


def test_a_direction_counts_by_the_slope_of_the_brdf():
    theta, _ = directions()
    dataset = (
        reduced("sample", (0.0,)).isel(wavelength=[0]).assign_coords(direction_u=("cell", np.full(theta.size, 0.5)))
    )
    steep = np.exp(-theta / 5)[None, None]
    u = terms_of_brdf(dataset, steep, np.array([0.0]))["directions"] / steep
    inner = (theta > 8) & (theta < 60)
    # Both cosines are the same: the slope 1/5° of the BRDF alone remains, by an angle in any azimuth.
    assert np.median(u[0, 0, inner]) == pytest.approx(0.5 / 5 / np.sqrt(2), rel=0.1)
    exact = dataset.assign_coords(direction_u=("cell", np.zeros(theta.size)))
    assert not terms_of_brdf(exact, steep, np.array([0.0]))["directions"].any()


@pytest.mark.slow
@pytest.mark.cases(1)
@pytest.mark.parametrize(("off", "stated"), [(0.7, 0.7), (0.3, 0.3)])
def test_fibres_that_look_elsewhere_are_within_the_budget(off, stated):
    z = {}
    truth = accuracy.TRUTHS["narrow, 300 sr⁻¹, 1.5°, on metallic 14°"]()
    for u in (0.0, stated):
        plan = rig_emulated.plan()
        plan = replace(plan, rig=replace(plan.rig, fibres=tuple(replace(fibre, u=u) for fibre in plan.rig.fibres)))
        result = accuracy.measured(plan, truth, seed=1, session=1, effects=Effects(fibre_directions=off))
        z[u] = np.sqrt(np.mean(result.z[~result.of_disc] ** 2))
    assert z[0.0] > 2
    assert 0.6 < z[stated] <= 1.3


def test_the_dominant_term_of_each_incidence_is_named():
    primary = brdf_of(reduced("sample"))
    largest = primary.copy(deep=True)
    largest["brdf_u_nd"] = 0.05 * largest["brdf"]
    largest["brdf_u"] = np.sqrt(sum(largest[f"brdf_u_{name}"] ** 2 for name in NAMES))
    found = dominant(largest)
    assert [entry.incidence for entry in found] == [10.0, 30.0]
    assert {entry.name for entry in found} == {"nd"}
    assert all(entry.share > 0.8 and entry.u == pytest.approx(0.05, rel=0.1) for entry in found)
