"""The basis functions of a smoothed BSDF: values, gradients, roughness, and the solid angles of cells."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brdfpipe.bsdf.measured import basis
from brdfpipe.bsdf.measured.basis import Keldysh, PSpline

BASES = {
    "pspline": PSpline.default(),
    "pspline with sines": PSpline.default(symmetric=False),
    "keldysh": Keldysh(150.0, 6, 9),
    "keldysh with sines": Keldysh(150.0, 4, 5, symmetric=False),
    "keldysh-printed": Keldysh(printed=True),
}
SMOOTH = [name for name in BASES if "printed" not in name]


def rows(functions, theta, phi):
    theta, phi = np.broadcast_arrays(np.atleast_1d(theta).astype(float), phi)
    return functions.rows(theta, np.asarray(phi, dtype=float), np.full(theta.shape, 0.7))


def test_the_polynomials_of_the_preprint_have_the_values_of_the_physics_sheet():
    values = [float(basis.polynomial(n, np.array(0.3))) for n in range(5)]
    assert values == pytest.approx([0.8281, 0.8679786995, 0.50307075, 0.2440550644, 0.10732176], abs=5e-11)


@pytest.mark.parametrize("n", range(1, 9))
def test_each_polynomial_has_its_maximum_1_where_the_preprint_states_it(n):
    x = np.linspace(0, 1, 200001)
    values = basis.polynomial(n, x)
    assert values.max() == pytest.approx(1, abs=1e-9)
    assert x[values.argmax()] == pytest.approx(np.sqrt(n / (n + 4)), abs=1e-5)
    assert basis.polynomial(n, np.array(1.5)) == 0


@pytest.mark.parametrize("name", SMOOTH)
def test_the_basis_is_continuous_at_the_mirror_direction(name):
    around = rows(BASES[name], 0.0, np.linspace(0, 360, 7))
    assert np.ptp(around, axis=0) == pytest.approx(0, abs=1e-12)
    # and no kink: across ϑ = 0 the functions of even k are even, those of odd k odd, to first order.
    step = 1e-4
    slope = (rows(BASES[name], step, 30.0) - 2 * rows(BASES[name], 0.0, 30.0) + rows(BASES[name], step, 210.0)) / step
    assert np.abs(slope).max() < 1e-2 * np.abs(rows(BASES[name], step, 30.0) / step).max()


def test_the_printed_basis_is_ambiguous_at_the_mirror_direction():
    assert np.ptp(rows(BASES["keldysh-printed"], 0.0, np.linspace(0, 180, 7)), axis=0).max() == pytest.approx(2)


def test_only_the_constant_does_not_vanish_at_the_end_of_the_domain():
    values = rows(Keldysh(135.0, 3), 135.0, 20.0)[0]
    assert np.count_nonzero(values) == 1
    assert not rows(Keldysh(printed=True), 90.0, 20.0).any()


@pytest.mark.parametrize("name", list(BASES))
def test_sums_are_rows_times_coefficients(name):
    random = np.random.default_rng(4)
    theta, phi, cosine = random.uniform(0, 150, 50), random.uniform(0, 360, 50), random.uniform(-0.1, 1, 50)
    even, odd = random.random((2, 50))
    functions = BASES[name]
    coefficient = random.standard_normal((functions.harmonic.size, 3))
    share = np.where(functions.harmonic % 2, odd[:, None], even[:, None])
    expected = (functions.rows(theta, phi, cosine) * share) @ coefficient
    assert functions.sums(coefficient, theta, phi, cosine, even, odd) == pytest.approx(expected)


@pytest.mark.parametrize("name", list(BASES))
def test_a_stored_basis_is_the_same_functions(name):
    again = basis.from_json(basis.to_json(BASES[name]))
    assert again == BASES[name]
    assert (rows(again, [0.0, 20.0], 40.0) == rows(BASES[name], [0.0, 20.0], 40.0)).all()


@pytest.mark.parametrize("name", ["keldysh", "keldysh with sines"])
def test_the_roughness_of_the_preprint_is_the_squared_gradient_on_the_cells(name):
    random = np.random.default_rng(0)
    theta, phi = np.append(random.uniform(1, 140, 60), 0.0), random.uniform(0, 360, 61)
    c = random.standard_normal(BASES[name].harmonic.size)
    step = 1e-5

    def value(theta, phi):
        # Beyond ϑ = 0 the way goes on along the opposite azimuth.
        return rows(BASES[name], np.abs(theta), np.where(theta < 0, phi + 180, phi)) @ c

    slope = (value(theta + step, phi) - value(theta - step, phi)) / np.radians(2 * step)
    inside = np.maximum(theta, 1e-3)
    across = (value(inside, phi + step) - value(inside, phi - step)) / np.radians(2 * step) / np.sin(np.radians(inside))
    expected = (basis.solid_angles(theta, phi) * (slope**2 + across**2)).sum()
    energy = ((BASES[name].roughness(theta, phi) @ c) ** 2).sum()
    assert energy == pytest.approx(expected, rel=1e-4)


def test_the_roughness_of_a_spline_is_the_energy_of_a_thin_plate():
    functions = PSpline.default()
    c = np.random.default_rng(1).standard_normal(functions.harmonic.size)
    c[-2:] = 0  # those of the outgoing angle are counted apart
    # One interval of t, all round; a sum over even steps of φ is exact for so few harmonics.
    low, high = functions.edges[16:18]
    node, weight = np.polynomial.legendre.leggauss(12)
    t, phi = np.meshgrid(low + (high - low) * (node + 1) / 2, np.arange(32) * np.pi / 16, indexing="ij")
    step = 1e-3

    def value(i, j):
        moved = functions.scale * np.sinh(t + i * step), np.degrees(phi + j * step)
        return (rows(functions, moved[0].ravel(), moved[1].ravel()) @ c).reshape(t.shape)

    along = (value(1, 0) - 2 * value(0, 0) + value(-1, 0)) / step**2
    around = (value(0, 1) - 2 * value(0, 0) + value(0, -1)) / step**2
    mixed = (value(1, 1) - value(1, -1) - value(-1, 1) + value(-1, -1)) / (4 * step**2)
    lying = 5.0 / np.tanh(t) ** 2  # weight of bends along φ, per length along it
    energy = (along**2 + 2 * lying * mixed**2 + lying**2 * around**2).mean(axis=1)
    expected = (energy * weight).sum() * (high - low) / 2
    roughness = functions.roughness(np.empty(0), np.empty(0)) @ c
    assert (roughness[_rows_of_interval(functions, 16)] ** 2).sum() == pytest.approx(expected, rel=1e-4)


def _rows_of_interval(functions, interval):
    """Which rows of the roughness belong to one interval of t: four points of each block of derivatives."""
    points = 4 * (len(functions.edges) - 1)
    blocks = 1 + 3 * functions.harmonics
    at = np.arange(4) + 4 * interval
    return (np.arange(blocks)[:, None] * points + at).ravel()


def test_only_a_constant_has_no_roughness():
    size = np.linalg.svd(PSpline.default().roughness(np.empty(0), np.empty(0)))[1]
    assert size[-1] < 1e-10 * size[0]
    assert size[-2] > 1e-6 * size[0]


@given(st.lists(st.tuples(st.floats(0, 180), st.floats(-180, 360)), min_size=1, max_size=40))
@settings(max_examples=50, deadline=None)
def test_solid_angles_are_positive_and_no_more_than_a_sphere(directions):
    theta, phi = np.array(directions).T
    solid_angle = basis.solid_angles(theta, phi)
    assert (solid_angle > 0).all()
    assert solid_angle.sum() <= 4 * np.pi * (1 + 1e-9)


def test_cells_of_equal_direction_share_one_solid_angle():
    once = basis.solid_angles(np.array([10.0, 40.0]), np.array([0.0, 90.0]))
    twice = basis.solid_angles(np.array([10.0, 10.0, 40.0]), np.array([0.0, 360.0, 90.0]))
    assert twice == pytest.approx([once[0] / 2, once[0] / 2, once[1]])


def test_the_solid_angles_of_the_cells_of_a_disc_add_up_to_its_cone():
    theta, phi = [0.0], [0.0]
    for ring in np.arange(1.0, 20.0):
        count = round(2 * np.pi * ring)
        theta += [ring] * count
        phi += list(np.arange(count) * 360 / count)
    solid_angle = basis.solid_angles(np.array(theta), np.array(phi))
    inner = np.array(theta) < 15.5
    assert solid_angle[inner].sum() == pytest.approx(2 * np.pi * (1 - np.cos(np.radians(15.5))), rel=0.01)
