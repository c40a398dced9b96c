"""Fresnel reflection against closed forms and arbitrary precision."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brdfpipe import optics
from brdfpipe.errors import BrdfpipeError


def exact(cos_zeta: float, n: float, k: float = 0.0) -> tuple[float, float]:
    """Textbook Fresnel reflectances in 60 digits."""
    with mpmath.workdps(60):
        c, index = mpmath.mpf(cos_zeta), mpmath.mpc(n, k)
        q = mpmath.sqrt(index**2 - 1 + c**2)
        s = (c - q) / (c + q)
        p = (index**2 * c - q) / (index**2 * c + q)
        return float(abs(s) ** 2), float(abs(p) ** 2)


@pytest.mark.parametrize(
    ("angle", "expected"), [(0, 0.0465205690), (45, 0.0572876433), (60, 0.0973437404), (85, 0.6177349814)]
)
def test_fresnel_gives_the_reference_values_of_the_physics_sheet(angle: float, expected: float) -> None:
    # Ten printed decimals.
    assert optics.fresnel(np.cos(np.radians(angle)), 1.55).mean == pytest.approx(expected, abs=5.1e-11)


@pytest.mark.parametrize(("angle", "expected"), [(20, 0.0490781010), (60, 0.1000560322), (85, 0.6191482118)])
def test_black_glass_of_the_gloss_standard_has_its_reflectance(angle: float, expected: float) -> None:
    assert optics.fresnel(np.cos(np.radians(angle)), 1.567).mean == pytest.approx(expected, abs=5.1e-11)


def test_polarised_reflectances_are_those_printed_by_liu_2015() -> None:
    s, p, mean = optics.fresnel(0.5, 1.8)
    assert (s, p, mean) == (
        pytest.approx(0.26911389, abs=5e-9),
        pytest.approx(0.00017270, abs=5e-9),
        pytest.approx(0.13464330, abs=5e-9),
    )


@pytest.mark.parametrize("n", [1 + 1e-12, 1 + 1e-6, 1.0003, 1.33, 1.55, 4.0, 1 - 1e-9, 0.7])
@pytest.mark.parametrize("cos_zeta", [1.0, 0.9, 0.5, 0.1, 1e-3, 1e-6, 1e-12])
def test_fresnel_keeps_its_digits_where_the_textbook_form_cancels(n: float, cos_zeta: float) -> None:
    s, p, _ = optics.fresnel(cos_zeta, n)
    # A dozen roundings of 1.1e-16 each, doubled by squaring.
    assert (s, p) == pytest.approx(exact(cos_zeta, n), rel=1e-14)


@given(cos_zeta=st.floats(0, 1), n=st.floats(0.05, 10), k=st.floats(0, 10) | st.floats(1e-6, 1e-3))
def test_fresnel_of_an_absorbing_medium_agrees_with_arbitrary_precision(cos_zeta: float, n: float, k: float) -> None:
    s, p, mean = optics.fresnel(cos_zeta, n, k)
    # Near the critical and Brewster angles the reflectance itself turns with the last bit of its arguments: compare absolutely.
    assert (s, p) == pytest.approx(exact(cos_zeta, n, k) if (n, k) != (1, 0) else (0, 0), rel=1e-9, abs=1e-7)
    assert 0 <= mean <= 1


@given(cos_zeta=st.floats(0, 1), n=st.floats(1.01, 5))
def test_light_going_out_is_reflected_as_light_coming_in(cos_zeta: float, n: float) -> None:
    inside = np.sqrt(1 - (1 - cos_zeta**2) / n**2)
    # The last bit of the cosine inside moves the one outside by n √ε at grazing, and F by 2 (n + 1/n) times that: 8e-7 at n = 5.
    assert optics.fresnel(inside, 1 / n).mean == pytest.approx(optics.fresnel(cos_zeta, n).mean, abs=2e-6)


def test_beyond_the_critical_angle_reflection_is_total() -> None:
    for part in optics.fresnel(np.cos(np.radians([42, 60, 89, 90])), 1 / 1.55):
        assert (part == 1).all()


def test_a_medium_like_its_surroundings_reflects_nothing_at_any_angle() -> None:
    for part in optics.fresnel([0.0, 1e-9, 0.3, 1.0], 1.0):
        assert (part == 0).all()


def test_grazing_incidence_is_reflected_whole() -> None:
    for part in optics.fresnel(0.0, [0.5, 1.0001, 1.55, 30.0]):
        assert (part == 1).all()


def test_an_infinite_index_is_a_perfect_mirror() -> None:
    for part in optics.fresnel([0.0, 0.4, 1.0], np.inf):
        assert (part == 1).all()


def test_light_polarised_in_the_plane_vanishes_at_brewsters_angle() -> None:
    n = np.array([1.33, 1.55, 2.4])
    # The zero is double in F: an error of 1e-16 in the cosine leaves its square.
    assert optics.fresnel(1 / np.sqrt(1 + n**2), n).p == pytest.approx(np.zeros(3), abs=1e-30)


def test_a_transparent_medium_is_the_limit_of_an_absorbing_one() -> None:
    cos_zeta = np.linspace(0, 1, 11)
    faint = optics.fresnel(cos_zeta, 1.55, np.full(11, 1e-12))
    assert faint.mean == pytest.approx(optics.fresnel(cos_zeta, 1.55).mean, rel=1e-10)


def test_arguments_broadcast_together() -> None:
    mixed = optics.fresnel(np.linspace(0, 1, 5)[:, None], [1.0, 1.5, 0.2], [0.0, 0.0, 3.0])
    assert mixed.mean.shape == (5, 3)
    assert mixed.mean[:, 1] == pytest.approx(optics.fresnel(np.linspace(0, 1, 5), 1.5).mean, rel=1e-14)


def test_a_cosine_above_one_by_rounding_is_one() -> None:
    assert optics.fresnel(1 + 1e-13, 1.55).mean == optics.fresnel(1.0, 1.55).mean


@pytest.mark.parametrize("cos_zeta", [1.1, -0.1, np.nan, 45.0])
def test_a_cosine_outside_its_range_is_refused(cos_zeta: float) -> None:
    with pytest.raises(BrdfpipeError, match=r"cos_zeta.*accepted: cosines in \[0, 1\]"):
        optics.fresnel([0.5, cos_zeta], 1.55)


@pytest.mark.parametrize("n", [0.0, -1.5, np.nan])
def test_an_index_that_is_not_positive_is_refused(n: float) -> None:
    with pytest.raises(BrdfpipeError, match="accepted: n > 0"):
        optics.fresnel(0.5, [1.5, n])


@pytest.mark.parametrize("k", [-0.1, np.nan, np.inf])
def test_an_extinction_that_is_negative_or_undefined_is_refused(k: float) -> None:
    with pytest.raises(BrdfpipeError, match="accepted: finite k >= 0"):
        optics.fresnel(0.5, 1.5, k)


def test_a_complex_index_is_refused_with_the_place_of_its_imaginary_part() -> None:
    with pytest.raises(BrdfpipeError, match="the imaginary part as k"):
        optics.fresnel(0.5, 1.5 + 1j)  # type: ignore[arg-type]
