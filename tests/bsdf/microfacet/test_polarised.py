"""Mueller matrices of microfacet BRDFs: against SCATMECH, against field vectors, reciprocity, and the edges of the geometry."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mueller_matrices import RECIPROCAL, physical

from brdfpipe import optics
from brdfpipe.bsdf.microfacet import polarised
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import half_vector, unit_vector

polar = st.floats(0, 89.99)
azimuth = st.floats(-360, 360)
indices = st.sampled_from(
    [(1.55, 0.0), (1.0001, 0.0), (4.0, 0.0), (0.2, 3.4), (2.5, 0.7), (0.7, 0.0), (0.5, 100.0), (np.inf, 0.0)]
)

SCATMECH = [
    # (n, k, θ_i, θ_o, φ_s), M / M00 of Facet_BRDF_Model in the basis "psps"; its φ_s is 0 at the mirror direction.
    (
        (1.55, 0, 30, 50, 40),
        [
            [1, 0.2815761197, -0.5160627333, 0],
            [0.4573892394, -0.0734684340, -0.9263916287, 0],
            [-0.3693249783, -0.8533941906, 0.2500268768, 0],
            [0, 0, 0, -0.8089463172],
        ],
    ),
    (
        (1.55, 0, 0, 20, 30),
        [
            [1, 0.0198713954, -0.0344182665, 0],
            [0.0397427908, 0.5, -0.8660254038, 0],
            [0, -0.8653411945, -0.4996049716, 0],
            [0, 0, 0, -0.9992099432],
        ],
    ),
    (
        (0.2, 3.4, 30, 50, 40),
        [
            [1, 0.0071772210, -0.0131541562, 0],
            [0.0116586010, -0.1593774421, -0.9732656298, 0.1651188160],
            [-0.0094138913, -0.9597879040, 0.1919759325, 0.2044908255],
            [0, -0.2307227307, -0.1258878176, -0.9647252119],
        ],
    ),
    (
        (0.2, 3.4, 75, 60, -110),
        [
            [1, -0.0068661234, 0.0091324489, 0],
            [-0.0113296237, 0.4945624518, -0.8687589658, -0.0257615168],
            [0.0014781409, -0.8543954788, -0.4805111863, -0.1974563378],
            [0, 0.1591632668, 0.1196650140, -0.9799065229],
        ],
    ),
    (
        (0.7, 0, 60, 55, -20),
        [
            [1, 0, 0, 0],
            [0, 0.9186228482, 0.0776957174, -0.3874215253],
            [0, 0.1422286426, 0.8497408061, 0.5076530071],
            [0, 0.3686503438, -0.5214440890, 0.7695407631],
        ],
    ),
]


def matrix(*directions, n=1.55, k=0.0, shape_factor=1.0, diffuse=0.0):
    return polarised.mueller(shape_factor, *directions, n, k, diffuse)[..., 0, :, :]


def stokes(field_s, field_p):
    """Stokes vector of a field, straight from its definition."""
    cross = np.conj(field_s) * field_p
    return np.array(
        [abs(field_s) ** 2 + abs(field_p) ** 2, abs(field_s) ** 2 - abs(field_p) ** 2, 2 * cross.real, 2 * cross.imag]
    )


def frame(k):
    s = np.cross(k, [0.0, 0.0, 1.0])
    return s / np.linalg.norm(s), np.cross(k, s / np.linalg.norm(s))


def reflected(field, k_i, k_o, n, k):
    """A field vector after one facet: split on the facet's axes, times the textbook amplitudes."""
    normal = (k_o - k_i) / np.linalg.norm(k_o - k_i)
    s = np.cross(k_i, normal)
    s = s / np.linalg.norm(s)
    cosine, index = -k_i @ normal, complex(n, k)
    q = np.sqrt(index**2 - 1 + cosine**2)
    r_s, r_p = (cosine - q) / (cosine + q), (index**2 * cosine - q) / (index**2 * cosine + q)
    return r_s * (field @ s) * s + r_p * (field @ np.cross(k_i, s)) * np.cross(k_o, s)


@pytest.mark.parametrize(("case", "printed"), SCATMECH)
def test_the_mueller_matrix_is_scatmechs(case, printed):
    n, k, theta_i, theta_o, phi = case
    mueller = matrix(theta_i, 0.0, theta_o, 180.0 + phi, n=n, k=k)
    # Ten printed decimals.
    assert mueller / mueller[0, 0] == pytest.approx(np.array(printed), abs=5.1e-11)


@given(theta_i=st.floats(0.1, 89), phi_i=azimuth, theta_o=st.floats(0.1, 89), phi_o=azimuth, state=st.integers(0, 3))
@settings(max_examples=60, deadline=None)
@pytest.mark.parametrize(("n", "k"), [(1.55, 0.0), (0.2, 3.4), (0.7, 0.0)])
def test_stokes_vectors_are_those_of_reflected_field_vectors(n, k, theta_i, phi_i, theta_o, phi_o, state):
    k_i, k_o = -unit_vector(theta_i, phi_i), unit_vector(theta_o, phi_o)
    if np.linalg.norm(np.cross(k_i, k_o)) < 1e-3:
        return  # the construction divides by this sine; retro-reflection has tests of its own
    amplitudes = [(1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (0.3, 0.8j)][state]
    (s_i, p_i), (s_o, p_o) = frame(k_i), frame(k_o)
    out = reflected(amplitudes[0] * s_i + amplitudes[1] * p_i, k_i, k_o, n, k)
    stokes_reflected = polarised.stokes_out(
        matrix(theta_i, phi_i, theta_o, phi_o, n=n, k=k), stokes(*map(complex, amplitudes))
    )
    # Cross products of nearly parallel vectors lose up to three of sixteen digits, frames near the normal as many again.
    assert stokes_reflected == pytest.approx(stokes(out @ s_o, out @ p_o), abs=1e-9)


@given(theta_i=polar, phi_i=azimuth, theta_o=polar, phi_o=azimuth, index=indices, diffuse=st.floats(0, 1))
@settings(max_examples=200, deadline=None)
def test_unpolarised_light_has_the_scalar_brdf(theta_i, phi_i, theta_o, phi_o, index, diffuse):
    fresnel = optics.fresnel(half_vector(theta_i, phi_i, theta_o, phi_o).cos_zeta, *index).mean
    brdf = matrix(theta_i, phi_i, theta_o, phi_o, n=index[0], k=index[1], shape_factor=2.5, diffuse=diffuse)[0, 0]
    assert brdf == pytest.approx(2.5 * fresnel + diffuse, rel=1e-12)


@given(theta_i=polar, phi_i=azimuth, theta_o=polar, phi_o=azimuth, index=indices)
@settings(max_examples=200, deadline=None)
def test_reversed_light_has_the_transposed_matrix(theta_i, phi_i, theta_o, phi_o, index):
    there = matrix(theta_i, phi_i, theta_o, phi_o, n=index[0], k=index[1])
    back = matrix(theta_o, phi_o, theta_i, phi_i, n=index[0], k=index[1])
    assert back == pytest.approx(RECIPROCAL @ there.T @ RECIPROCAL, abs=1e-12)


@given(theta_i=st.floats(0, 90), phi_i=azimuth, theta_o=st.floats(0, 90), phi_o=azimuth, index=indices)
@settings(max_examples=200, deadline=None)
def test_every_matrix_is_finite_and_physical_and_one_facet_never_depolarises(theta_i, phi_i, theta_o, phi_o, index):
    mueller = matrix(theta_i, phi_i, theta_o, phi_o, n=index[0], k=index[1])
    assert np.isfinite(mueller).all()
    assert physical(mueller)
    if mueller[0, 0] > 0:
        out = polarised.stokes_out(mueller, [1.0, 0.6, 0.0, 0.8])
        assert polarised.degree_of_polarisation(out) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("theta", [1e-9, 10.0, 45.0, 89.0, 89.999])
@pytest.mark.parametrize("phi", [0.0, 77.0])
def test_the_matrix_is_continuous_at_retro_reflection(theta, phi):
    # Seen along the incident beam a facet is met at normal incidence: it exchanges the hands and the diagonals.
    step = 1e-8 * min(theta, 1.0)
    expected = matrix(theta, phi, theta, phi)[0, 0] * np.diag([1.0, 1.0, -1.0, -1.0])
    assert matrix(theta, phi, theta, phi) == pytest.approx(expected, abs=1e-15)
    for d_theta, d_phi in [(step, 0), (-step, 0), (0, step), (0, -step), (step, step), (-step, 3 * step)]:
        near = matrix(theta, phi, theta + d_theta, phi + d_phi)
        # Rounding of the angles to 1e-16 of the frame's, over the step of 1e-10 between the directions in radian.
        assert near == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("phi_i", [0.0, 30.0])
@pytest.mark.parametrize("phi_o", [0.0, 30.0, 130.0, 180.0, 301.0])
def test_at_the_normal_the_frames_follow_the_azimuth(phi_i, phi_o):
    exact = matrix(0.0, phi_i, 0.0, phi_o)
    for theta_i, theta_o in [(1e-7, 0.0), (0.0, 1e-7), (1e-7, 1e-7), (1e-7, 3e-7)]:
        # F_s − F_p grows with the square of the 1e-7 degree.
        assert matrix(theta_i, phi_i, theta_o, phi_o) == pytest.approx(exact, abs=1e-14)


def test_polarisation_along_x_at_the_normal_is_independent_of_the_given_azimuth():
    # From straight above, mirrored straight back; the s axes in space are (−sin φ_i, cos φ_i) and (sin φ_o, −cos φ_o).
    for phi_i, phi_o in [(0.0, 0.0), (90.0, 0.0), (20.0, 75.0)]:
        a, b = np.radians(phi_i), np.radians(phi_o)
        field_s, field_p = -np.sin(a), np.cos(a)  # x on s and on p = k × s, k downwards
        out = polarised.stokes_out(matrix(0.0, phi_i, 0.0, phi_o), stokes(complex(field_s), complex(field_p)))
        expected = stokes(complex(np.sin(b)), complex(np.cos(b)))
        assert out / out[0] == pytest.approx(expected, abs=1e-14)


@pytest.mark.parametrize(("theta_i", "theta_o"), [(90.0, 90.0), (90.0, 89.999), (90.0, 30.0), (0.0, 90.0)])
def test_the_matrix_is_continuous_up_to_grazing(theta_i, theta_o):
    for phi in (180.0, 179.0, 120.0):
        at, near = matrix(theta_i, 0.0, theta_o, phi), matrix(theta_i - 1e-9, 0.0, theta_o, phi)
        # Reflection falls off grazing no faster than 8 per radian here: 1e-9 degree are 2e-11 radian.
        assert near == pytest.approx(at, abs=2e-10)


def test_s_and_p_do_not_mix_in_the_mirror_direction():
    mueller = matrix(60.0, 20.0, 60.0, 200.0, n=1.8)
    s, p = (0.26911389, 0.00017270)  # Fresnel reflectances at 60°, n = 1.8
    assert mueller[0, :2] == pytest.approx([(s + p) / 2, (s - p) / 2], abs=5e-9)
    assert mueller[:2, 2:] == pytest.approx(np.zeros((2, 2)), abs=1e-15)


def test_light_reflected_at_brewsters_angle_is_s_polarised():
    theta = np.degrees(np.arctan(1.55))
    out = polarised.stokes_out(matrix(theta, 0.0, theta, 180.0), [1.0, 0.0, 0.0, 0.0])
    assert polarised.degree_of_polarisation(out) == pytest.approx(1.0, abs=1e-14)
    assert out[1:] == pytest.approx([out[0], 0.0, 0.0], abs=1e-12 * out[0])


def test_total_reflection_retards_p_against_s_as_in_fresnels_rhomb():
    # Born & Wolf §1.5.4: tan(δ/2) = cos ζ √(sin²ζ − n²) / sin²ζ; 45° at ζ = 54°37' for n = 1/1.51.
    zeta, n = np.radians(54 + 37 / 60), 1 / 1.51
    delay = 2 * np.arctan(np.cos(zeta) * np.sqrt(np.sin(zeta) ** 2 - n**2) / np.sin(zeta) ** 2)
    mueller = polarised.facet_mueller(np.cos(zeta), n)
    assert mueller[:2, :2] == pytest.approx(np.eye(2), abs=1e-15)
    assert np.hypot(mueller[2, 2], mueller[3, 2]) == pytest.approx(1.0, abs=1e-14)
    assert abs(np.arctan2(mueller[3, 2], mueller[2, 2])) == pytest.approx(delay, abs=1e-14)
    assert np.degrees(delay) == pytest.approx(45.0, abs=0.02)  # the angle is printed to a minute


def test_a_perfect_mirror_is_the_limit_of_a_good_one():
    for cosine in (1.0, 0.5, 0.05):
        # r falls short of 1 by 2 / (n cos ζ).
        assert polarised.facet_mueller(cosine, 1e9) == pytest.approx(polarised.facet_mueller(cosine, np.inf), abs=1e-6)


def test_an_index_of_1_reflects_nothing():
    assert not polarised.facet_mueller([0.0, 0.5, 1.0], 1.0).any()


def test_an_invalid_refractive_index_is_refused():
    with pytest.raises(BrdfpipeError, match="refractive index"):
        matrix(10.0, 0.0, 20.0, 30.0, n=-1.0)


def test_directions_and_wavelengths_broadcast():
    theta_o = np.linspace(0, 80, 5)
    n, k = np.array([1.5, 1.6, 0.3]), np.array([0.0, 0.0, 2.0])
    diffuse = np.full((5, 3), 0.1)
    matrices = polarised.mueller(np.ones(5), 30.0, 0.0, theta_o, 150.0, n, k, diffuse)
    assert matrices.shape == (5, 3, 4, 4)
    alone = polarised.mueller(1.0, 30.0, 0.0, theta_o[3], 150.0, n[2], k[2], 0.1)[0]
    assert matrices[3, 2] == pytest.approx(alone, abs=1e-16)


def test_the_diffuse_part_has_no_polarisation():
    out = polarised.stokes_out(matrix(30.0, 0.0, 40.0, 90.0, shape_factor=0.0, diffuse=0.2), [1.0, 1.0, 0.0, 0.0])
    assert out == pytest.approx([0.2, 0.0, 0.0, 0.0], abs=0)
    assert polarised.degree_of_polarisation(out) == 0


@pytest.mark.parametrize(
    ("vector", "degree"),
    [
        ([2, 2, 0, 0], 1),
        ([2, -1, 0, 0], 0.5),
        ([1, 0, 1, 0], 1),
        ([1, 0, -0.6, 0.8], 1),
        ([1, 0, 0, -0.3], 0.3),
        ([0, 0, 0, 0], 0),
    ],
)
def test_the_degree_of_polarisation_is_that_of_plain_states(vector, degree):
    assert polarised.degree_of_polarisation(vector) == pytest.approx(degree, abs=1e-15)


def test_a_matrix_that_polarises_by_more_than_1_is_not_physical():
    assert physical(np.diag([1.0, 0.0, 0.0, 0.0]))
    assert physical(np.eye(4))
    # Cloude: a matrix may keep the degree of polarisation below 1 and still belong to no sum of Jones matrices.
    assert not physical(np.diag([1.0, 1.0, 1.0, -1.0]))
    too_much = np.zeros((4, 4))
    too_much[0, 0], too_much[1, 0] = 1.0, 1.1
    assert not physical(too_much)
