"""Colorimetry against printed values, closed forms and its own inverses, and its batches against colour-science one by one."""

from __future__ import annotations

import subprocess
import sys
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brdfpipe.errors import BrdfpipeError
from brdfpipe.spectra import colorimetry
from brdfpipe.spectra.colour_science import colour

GRID = colorimetry.GRID
ILLUMINANTS = ["D65", "A", "D50", "C", "E", "FL2", "LED-B3", "FL11", "ID65"]


def bump(centre: float, width: float) -> np.ndarray:
    return 0.05 + 0.9 * np.exp(-(((GRID - centre) / width) ** 2))


def oracle_xyz(reflectance: np.ndarray, illuminant: str, observer: int) -> np.ndarray:
    shape = colour.SpectralShape(360, 780, 5)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        power = colour.SDS_ILLUMINANTS[illuminant].copy()
        power.extrapolate(shape, extrapolator_kwargs={"method": "Constant", "left": 0, "right": 0})
        return colour.sd_to_XYZ(
            colour.SpectralDistribution(reflectance, GRID),
            colour.MSDS_CMFS[colorimetry.OBSERVERS[observer]].copy().align(shape),
            power.align(shape),
            method="Integration",
        )


@pytest.mark.parametrize("observer", [2, 10])
@pytest.mark.parametrize("illuminant", ILLUMINANTS)
def test_tristimulus_values_are_those_of_colour_science(illuminant: str, observer: int) -> None:
    reflectance = bump(560, 70)
    ours = colorimetry.reflectance_to_xyz(GRID, reflectance, illuminant, observer)
    # Both sum over 5 nm; the tables are rounded to eight digits.
    assert ours == pytest.approx(oracle_xyz(reflectance, illuminant, observer), rel=1e-6)


@pytest.mark.parametrize(
    ("illuminant", "observer", "white"),
    [
        ("D65", 2, (95.04, 100, 108.88)),
        ("D65", 10, (94.81, 100, 107.32)),
        ("A", 2, (109.85, 100, 35.58)),
        ("D50", 2, (96.42, 100, 82.51)),
        ("C", 2, (98.07, 100, 118.22)),
        ("FL2", 2, (99.19, 100, 67.39)),
        ("E", 2, (100.00, 100, 100.00)),
    ],
)
def test_white_points_are_those_cie_and_astm_print(illuminant: str, observer: int, white: tuple[float, ...]) -> None:
    # Printed to 0.01; sums from 360 to 780 nm by 5 and from 360 to 830 nm by 1 differ by up to 0.034 (Z of E).
    assert colorimetry.weights(illuminant, observer).white == pytest.approx(white, abs=0.04)


def test_the_perfect_diffuser_has_y_of_100_and_is_white() -> None:
    table = colorimetry.weights("LED-B3", 10)
    xyz = colorimetry.reflectance_to_xyz([400, 700], [1.0, 1.0], "LED-B3", 10)
    assert xyz[1] == pytest.approx(100, rel=1e-14)
    assert colorimetry.xyz_to_lab(xyz, table.white) == pytest.approx((100, 0, 0), abs=1e-10)


def test_a_grey_has_the_lightness_of_its_reflectance() -> None:
    white = colorimetry.weights("D65", 10).white
    lab = colorimetry.xyz_to_lab(colorimetry.reflectance_to_xyz(GRID, np.full(85, 0.18)), white)
    assert lab == pytest.approx((116 * 0.18 ** (1 / 3) - 16, 0, 0), abs=1e-10)


@pytest.mark.parametrize(("lightness", "y"), [(33.90, 7.96026763), (12.29, 1.45052385)])
def test_luminance_of_lightness_is_that_of_the_dupont_example(lightness: float, y: float) -> None:
    assert colorimetry.lab_to_xyz([lightness, 0, 0], [100, 100, 100])[1] == pytest.approx(y, abs=5.1e-9)


def test_luminance_below_the_junction_is_a_straight_line() -> None:
    # L* = κ Y/Yn with κ = 24389/27; the DuPont example prints 0.33986494 from κ rounded to 903.3.
    assert colorimetry.lab_to_xyz([3.07, 0, 0], [100, 100, 100])[1] == pytest.approx(3.07 * 27 / 24389 * 100, rel=1e-13)
    assert colorimetry.lab_to_xyz([3.07, 0, 0], [100, 100, 100])[1] == pytest.approx(0.33986494, rel=5e-6)


def test_lab_has_the_values_of_its_definition_above_and_below_the_junction() -> None:
    xyz = np.random.default_rng(1).uniform(0, 1, (200, 3)) ** 4 * 100
    white = colorimetry.weights("D65", 2).white
    t = xyz / white
    # CIE 15:2018 with the junction in exact fractions.
    f = np.where(t > 216 / 24389, np.cbrt(t), (24389 / 27 * t + 16) / 116)
    expected = [116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])]
    assert colorimetry.xyz_to_lab(xyz, white) == pytest.approx(np.stack(expected, axis=1), abs=1e-10)


@given(st.tuples(st.floats(0, 120), st.floats(0, 120), st.floats(0, 120)))
def test_lab_and_back_is_the_same_colour(xyz: tuple[float, float, float]) -> None:
    white = colorimetry.weights("D65", 10).white
    back = colorimetry.lab_to_xyz(colorimetry.xyz_to_lab(xyz, white), white)
    # L* = 116 f − 16 is about 100 with 16 digits, and black keeps what is left of them.
    assert back == pytest.approx(xyz, rel=1e-11, abs=1e-12)


def test_the_colour_difference_is_the_distance() -> None:
    assert colorimetry.delta_e_ab([[50, 3, 4], [50, 0, 0]], [50, 0, 0]).tolist() == [5, 0]


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        # Sharma, Wu & Dalal 2005, table 1: pairs 1, 7, 8, 9, 10, 13, 16, 17, 25 and 34.
        ((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425),
        ((50, 0, 0), (50, -1, 2), 2.3669),
        ((50, -1, 2), (50, 0, 0), 2.3669),
        ((50, 2.49, -0.001), (50, -2.49, 0.0009), 7.1792),
        ((50, 2.49, -0.001), (50, -2.49, 0.0010), 7.1792),
        ((50, -0.001, 2.49), (50, 0.0009, -2.49), 4.8045),
        ((50, 2.5, 0), (50, 0, -2.5), 4.3065),
        ((50, 2.5, 0), (73, 25, -18), 27.1492),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
        ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
    ],
)
def test_ciede2000_has_the_values_of_its_test_table(first: tuple, second: tuple, expected: float) -> None:
    assert colorimetry.delta_e_00(first, second) == pytest.approx(expected, abs=5.1e-5)


def test_ciede2000_is_symmetric_and_zero_between_equal_colours() -> None:
    rng = np.random.default_rng(0)
    first = rng.uniform([0, -100, -100], [100, 100, 100], (2000, 3))
    second = first + rng.normal(0, 1, (2000, 3)) * rng.uniform(0, 60, (2000, 1))
    assert colorimetry.delta_e_00(second, first) == pytest.approx(colorimetry.delta_e_00(first, second), abs=1e-9)
    assert (colorimetry.delta_e_00(first, first) == 0).all()


def test_white_grey_and_black_are_so_on_the_screen() -> None:
    srgb = colorimetry.reflectance_to_srgb([400, 700], [[1, 1], [0.21404114, 0.21404114], [0, 0]])
    # 0.21404114 is the linear value of 0.5 (IEC 61966-2-1).
    assert srgb == pytest.approx(np.array([[1, 1, 1], [0.5, 0.5, 0.5], [0, 0, 0]]), abs=1e-7)


def test_preview_colours_are_those_of_the_rounded_matrix_of_the_standard() -> None:
    xyz = np.array([[20.0, 21, 19], [41, 35, 12], [3, 2, 8]])
    matrix = colorimetry.srgb_from_xyz(colorimetry.weights("D65", 2).white)
    # IEC 61966-2-1 prints four digits; ours comes from the primaries: half a step of eight bits apart at most.
    printed = [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
    theirs = colorimetry.encoded_srgb(xyz / 100 @ np.transpose(printed))
    assert colorimetry.encoded_srgb(xyz @ matrix.T) == pytest.approx(theirs, abs=0.5 / 255)


def test_colours_out_of_the_screens_reach_are_clipped() -> None:
    srgb = colorimetry.reflectance_to_srgb(GRID, np.stack([bump(520, 12), 1.5 * bump(600, 90)]))
    assert srgb.min() == 0
    assert srgb.max() == pytest.approx(1, abs=1e-15)


@pytest.mark.parametrize("step", [10, 20])
def test_curved_interpolation_loses_less_colour_than_straight_lines(step: int) -> None:
    white = colorimetry.weights("D65", 10).white
    truth = np.stack([bump(centre, 40) for centre in range(420, 700, 7)])
    coarse = np.arange(360.0, 781, step)
    sampled = np.stack([np.interp(coarse, GRID, row) for row in truth])
    straight = np.stack([np.interp(GRID, coarse, row) for row in sampled])

    def lab(wavelength: np.ndarray, reflectance: np.ndarray) -> np.ndarray:
        return colorimetry.xyz_to_lab(colorimetry.reflectance_to_xyz(wavelength, reflectance), white)

    ours = colorimetry.delta_e_ab(lab(coarse, sampled), lab(GRID, truth))
    lines = colorimetry.delta_e_ab(lab(GRID, straight), lab(GRID, truth))
    assert ours.mean() < lines.mean() / 2


def test_missing_ends_are_held_constant() -> None:
    inside = (GRID >= 400) & (GRID <= 700)
    reflectance = bump(650, 100)
    held = np.interp(GRID, GRID[inside], reflectance[inside])
    assert colorimetry.reflectance_to_xyz(GRID[inside], reflectance[inside]) == pytest.approx(
        colorimetry.reflectance_to_xyz(GRID, held), rel=1e-13
    )


def test_many_spectra_go_in_one_call() -> None:
    many = np.stack([bump(450, 30), bump(650, 30)]).reshape(2, 1, -1)
    xyz = colorimetry.reflectance_to_xyz(GRID, many, "A", 2)
    assert xyz.shape == (2, 1, 3)
    assert xyz[1, 0] == pytest.approx(colorimetry.reflectance_to_xyz(GRID, many[1, 0], "A", 2), rel=1e-13)


@pytest.mark.parametrize(
    ("wavelength", "reflectance"),
    [([500, 400], [0, 0]), ([400, 400], [0, 0]), ([400, 500], [0, np.nan]), ([400, 500], [0, 0, 0]), ([], [])],
)
def test_invalid_wavelengths_and_reflectances_are_refused(wavelength: list[float], reflectance: list[float]) -> None:
    with pytest.raises(BrdfpipeError, match="increas"):
        colorimetry.reflectance_to_xyz(wavelength, reflectance)


def test_an_unknown_illuminant_is_refused_with_the_known_ones() -> None:
    with pytest.raises(BrdfpipeError) as refusal:
        colorimetry.weights("D56", 10)
    assert str(refusal.value) == (
        "unknown illuminant 'D56' (nearest is D65); accepted: D65, A, D50, C, E, FL2, FL11, LED-B3, … (docs/materials.md lists all)"
    )


@pytest.mark.parametrize("observer", [0, 5, "10", None])
def test_an_unknown_observer_is_refused(observer: int) -> None:
    with pytest.raises(BrdfpipeError, match=r"accepted: 2 or 10 \(degree\)"):
        colorimetry.weights("D65", observer)


def test_every_illuminant_of_colour_science_is_known_in_any_case() -> None:
    for name in colour.SDS_ILLUMINANTS:
        assert colorimetry.illuminant_name(name.upper()) == name
        assert colorimetry.weights(name.lower(), 2).white[1] == pytest.approx(100, rel=1e-12)
    assert set(colorimetry._USUAL_ILLUMINANTS) <= set(colorimetry.illuminants())


def test_illuminants_are_known_in_any_case() -> None:
    assert colorimetry.weights("led-b3", 2) is colorimetry.weights("LED-B3", 2)


@given(st.lists(st.integers(300, 900), min_size=1, max_size=40, unique=True))
def test_luminous_weights_of_any_grid_are_an_average(wavelength: list[int]) -> None:
    weight = colorimetry.luminous_weight(np.sort(wavelength))
    assert weight.sum() == pytest.approx(1, rel=1e-13)
    assert weight.min() >= 0


def test_luminous_weights_of_the_grid_are_v_times_s() -> None:
    expected = colour.MSDS_CMFS[colorimetry.OBSERVERS[2]][GRID][:, 1] * colour.SDS_ILLUMINANTS["A"][GRID]
    assert colorimetry.luminous_weight(GRID, "A") == pytest.approx(expected / expected.sum(), rel=1e-12)


def test_luminous_weights_average_a_straight_line_equally_on_every_grid() -> None:
    coarse = np.array([360.0, 500, 530, 780])
    assert (coarse * colorimetry.luminous_weight(coarse)).sum() == pytest.approx(
        (GRID * colorimetry.luminous_weight(GRID)).sum(), rel=1e-13
    )


def test_usual_names_are_recognised_without_loading_colour_science() -> None:
    code = "import sys, brdfpipe.spectra, brdfpipe.spectra.colorimetry as c; c.illuminant_name('d65'); sys.exit('colour' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_colour_science_changes_no_print_options_and_does_not_warn_without_matplotlib() -> None:
    code = (
        "import sys; sys.modules['matplotlib'] = None; import numpy as np; "
        "from brdfpipe.spectra import colour_science; print(repr(np.float64(1)), np.array([1.0]))"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("np.float64(1.0) [1.]\n", "")


def test_differences_of_screens_follow_the_formula_of_bt_2124() -> None:
    def ictcp(xyz: np.ndarray) -> np.ndarray:
        """ITU-R BT.2100 with its rounded matrix, written out; the primaries of BT.2020 from ITU-R BT.2020 table 3."""
        to_rgb = [[1.716651, -0.355671, -0.253366], [-0.666684, 1.616481, 0.015769], [0.017640, -0.042771, 0.942103]]
        lms = np.array([[1688, 2146, 262], [683, 2951, 462], [99, 309, 3688]]) / 4096 @ (np.array(to_rgb) @ xyz)
        power = (lms / 10_000) ** (2610 / 16384)
        coded = ((3424 / 4096 + 2413 / 128 * power) / (1 + 2392 / 128 * power)) ** (2523 / 32)
        return np.array([[2048, 2048, 0], [6610, -13613, 7003], [17933, -17390, -543]]) / 4096 @ coded

    for first, second in (
        ([95.0, 100, 108.9], [95.5, 101, 108]),
        ([20.0, 15, 3], [22, 15, 4]),
        ([1900.0, 2000, 2178], [95, 100, 108.9]),
    ):
        i, t, p = ictcp(np.array(first)) - ictcp(np.array(second))
        expected = 720 * np.sqrt(i**2 + 0.25 * t**2 + p**2)
        # The matrix to the primaries is rounded to 1e-6; differences of nearly equal colours keep four digits.
        assert colorimetry.delta_e_itp(first, second) == pytest.approx(expected, rel=1e-3)
    assert colorimetry.delta_e_itp([[95.0, 100, 108.9]] * 2, [95.0, 100, 108.9]).tolist() == [0, 0]


def test_differences_of_screens_are_those_of_colour_science() -> None:
    random = np.random.default_rng(4)
    first, second = colour.xyY_to_XYZ(
        np.stack([*random.uniform(0.3, 0.35, (2, 50)), random.uniform(1, 5000, 50)], axis=1)
    ).reshape(2, 25, 3)
    encoded = (
        colour.XYZ_to_ICtCp(xyz, chromatic_adaptation_transform=None, method="ITU-R BT.2100-2 PQ")
        for xyz in (first, second)
    )
    assert colorimetry.delta_e_itp(first, second) == pytest.approx(colour.delta_E(*encoded, method="ITP"), rel=1e-9)


@pytest.mark.parametrize("scale", [1e-9, 1e-3, 1e3])
def test_wavelengths_in_other_units_are_refused(scale: float) -> None:
    with pytest.raises(BrdfpipeError, match="accepted: 100 to 100000 nm"):
        colorimetry.reflectance_to_xyz(GRID * scale, np.full(GRID.size, 0.5))
    with pytest.raises(BrdfpipeError, match="Are they in nm"):
        colorimetry.luminous_weight(GRID * scale)
