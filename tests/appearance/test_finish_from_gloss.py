"""A finish from gloss readings: what they determine, with which uncertainty, and what the BRDF makes of it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
import samples
import xarray as xr

from brdfpipe import optics, vocabulary
from brdfpipe.appearance import compute_appearance, gloss
from brdfpipe.appearance.finish_from_gloss import GlossFinishError, facets_of_finishes, finish_from_gloss
from brdfpipe.appearance.gloss_of_finishes import ANGLES, MULTIPLE_SCATTERING, TAILS, WIDTHS, GlossOfFinishes
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.input_uncertainty import uncertainty
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.source_changes import SourceChanges
from brdfpipe.errors import BrdfpipeError
from brdfpipe.facets import analytic, student_slopes

INDEX = 1.5
NOISE = 1.0
"""Standard deviation of a reading [gloss units]."""

LOW, HIGH = 0.8, 1.2
"""Of the rms of z: an uncertainty is neither too small nor too large by more than a fifth."""


@pytest.fixture(scope="module")
def known() -> GlossOfFinishes:
    return GlossOfFinishes(INDEX, samples.spectrum(0.06))


def readings(values: np.ndarray) -> dict[float, float]:
    return dict(zip(ANGLES, values.tolist(), strict=True))


def u(given: dict[float, float]) -> dict[float, float]:
    return dict.fromkeys(given, NOISE)


class Truth(NamedTuple):
    name: str
    width: float
    bsdf: xr.Dataset
    gloss: np.ndarray

    @property
    def log_median(self) -> float:
        return math.log(self.width * student_slopes.median_over_width(1.0 if self.name == "ggx" else 0.0))


@cache
def truth(name: str, width: float) -> Truth:
    bsdf = bsdf_of(analytic(name, width))
    return Truth(name, width, bsdf, gloss(bsdf, ANGLES).values)


def bsdf_of(facets: xr.Dataset) -> xr.Dataset:
    spectrum = samples.spectrum(0.06)
    return microfacet.build(facets, index=INDEX, spectrum=spectrum, multiple_scattering=MULTIPLE_SCATTERING)


def uncertain_bsdf(facets: xr.Dataset) -> xr.Dataset:
    bsdf = bsdf_of(facets)
    changes = uncertainty(bsdf, facets=facets, spectrum=samples.spectrum(0.06))
    return bsdf.merge(changes, combine_attrs="override")


@pytest.mark.cases(3)
@pytest.mark.parametrize(
    ("name", "width"), [("beckmann", 0.003), ("ggx", 0.01), ("beckmann", 0.04), ("ggx", 0.05), ("beckmann", 0.4)]
)
def test_gloss_of_the_family_is_that_of_the_whole_model(known: GlossOfFinishes, name: str, width: float) -> None:
    expected = truth(name, width).gloss
    found = known.finishes(readings(expected), dict.fromkeys(ANGLES, 0.3))
    # The readings of the model are explained to a small part of the uncertainty of a meter.
    assert 0.3 * math.sqrt(found.chi_squared) < 0.3


@pytest.mark.cases(1)
@pytest.mark.parametrize("name", ["ggx", "beckmann"])
def test_exact_readings_give_width_and_tail(known: GlossOfFinishes, name: str) -> None:
    expected = truth(name, 0.012)
    facets = finish_from_gloss(readings(expected.gloss), index=INDEX, spectrum=samples.spectrum(0.06), gloss_u=0.3)
    # Five tails on a grid, and gloss to 0.1 units of rule and spline: 1 % of the slope.
    assert float(facets["median_slope"]) == pytest.approx(math.exp(expected.log_median), rel=0.03)
    assert float(facets["tail"]) == pytest.approx(1.0 if name == "ggx" else 0.0, abs=0.1)
    assert vocabulary.warnings(facets) == []


def test_finishes_drawn_from_what_is_assumed_lie_within_their_uncertainty(known: GlossOfFinishes) -> None:
    """Of 300 finishes, glossy ones, whose light is not reflected twice: the others are in the slow test."""
    rng = np.random.default_rng(17)
    whole = known.finishes({60.0: 50.0, 20.0: 50.0}, {60.0: 1e3, 20.0: 1e3})
    glossy = np.flatnonzero(np.exp(whole.log_width) < 0.01)
    share = whole.weight[glossy] / whole.weight[glossy].sum()
    z, tails = [], []
    for one in rng.choice(glossy, size=300, p=share):
        read = readings(whole.gloss[one] + rng.normal(scale=NOISE, size=3))
        found = known.finishes(read, u(read))
        z.append((found.mean(found.log_median) - whole.log_median[one]) / found.deviation(found.log_median))
        tails.append((found.mean(found.tail) - whole.tail[one]) / max(found.deviation(found.tail), 1e-3))
    # 300 values of unit variance scatter by 4 %, those of long tails by twice as much; the range ends at 0.01 and the assumption does not.
    assert LOW < np.sqrt(np.mean(np.square(z))) < HIGH
    assert LOW < np.sqrt(np.mean(np.square(tails))) < HIGH


def directions(rng: np.random.Generator, bsdf: xr.Dataset) -> list[np.ndarray]:
    """1000 pairs of directions up to 80°: half of them where the material sends its light, half anywhere."""
    polar = np.degrees(np.arcsin(np.sqrt(0.97 * rng.random((2, 500)))))
    incidence = float(rng.choice([10.0, 30.0, 50.0, 70.0]))
    sampled = bsdf.bsdf.sample(n=600, seed=int(rng.integers(2**31)), theta_i=incidence)
    seen = np.flatnonzero(sampled["theta_o"].values < 80)[:500]
    anywhere = [polar[0], np.zeros(500), polar[1], 360 * rng.random(500)]
    of_light = [
        np.full(seen.size, incidence),
        np.zeros(seen.size),
        *(sampled[n].values[seen] for n in ("theta_o", "phi_o")),
    ]
    return [np.concatenate(pair) for pair in zip(anywhere, of_light, strict=True)]


def twenty(rng: np.random.Generator) -> Iterator[Truth]:
    """Widths drawn over the whole range, one in each twentieth of it, and both forms in turn."""
    low, high = np.log(WIDTHS)
    for number in range(20):
        width = math.exp(low + (number + rng.random()) / 20 * (high - low))
        yield truth("ggx" if number % 2 else "beckmann", width)


def rms(values: list) -> float:
    return float(np.sqrt(np.mean(np.square(np.concatenate([np.ravel(one) for one in values])))))


@pytest.mark.slow
def test_twenty_materials_known_by_three_readings_lie_within_their_uncertainty(
    known: GlossOfFinishes,
) -> None:
    """Slope, gloss at the third angle and the BRDF at 1000 directions, of 20 materials with 6 sets of readings each."""
    rng = np.random.default_rng(20)
    slope, third, brdf = [], [], []
    for one in [*twenty(rng)]:
        for left_out in 2 * ANGLES:
            read = readings(one.gloss + rng.normal(scale=NOISE, size=3))
            found = known.finishes(read, u(read))
            facets = facets_of_finishes(found, read, found.chi_squared)
            z = math.log(float(facets["median_slope"])) - one.log_median
            slope.append(z / float(facets["median_slope_log_u"]))
            bsdf, at = uncertain_bsdf(facets), directions(rng, one.bsdf)
            green = np.array([550.0])
            deviation = np.sqrt(SourceChanges.of(bsdf).variance(*at, green))
            difference = representation(bsdf).evaluate(*at, green) - representation(one.bsdf).evaluate(*at, green)
            brdf.append(difference / deviation)
            two = {angle: value for angle, value in read.items() if angle != left_out}
            fewer = known.finishes(two, u(two))
            of_two = compute_appearance(
                uncertain_bsdf(facets_of_finishes(fewer, two, fewer.chi_squared)),
                gloss_angles=[left_out],
                parts=["gloss"],
            )
            off = float(of_two["gloss"][0]) - one.gloss[ANGLES.index(left_out)]
            third.append(off / float(of_two["gloss_u_source"].sel(source="facets")[0]))
    for name, values in (("slope", slope), ("third gloss", third), ("BRDF", brdf)):
        print(name, f"z-rms {rms(values):.3f}")
        assert LOW < rms(values) < HIGH, name


def test_a_mirror_says_that_it_is_not_determined(known: GlossOfFinishes) -> None:
    facets = finish_from_gloss(readings(truth("beckmann", 0.001).gloss), index=INDEX, spectrum=samples.spectrum(0.06))
    (warning,) = vocabulary.warnings(facets)
    assert "does not tell how smooth" in warning
    assert float(facets["median_slope_log_u"]) > 0.2


def test_a_matt_finish_says_that_it_is_not_determined(known: GlossOfFinishes) -> None:
    found = known.finishes({60.0: 0.6, 85.0: 0.2}, {60.0: 1.0, 85.0: 1.0})
    facets = facets_of_finishes(found, {60.0: 0.6, 85.0: 0.2}, found.chi_squared)
    (warning,) = vocabulary.warnings(facets)
    assert "does not tell how rough" in warning
    assert "tail not determined" in facets.attrs["history"]


def test_impossible_readings_enlarge_their_uncertainty_and_say_so() -> None:
    # More at 20° than at 60°: no surface of this index has that.
    facets = finish_from_gloss({20.0: 80.0, 60.0: 40.0}, index=INDEX, slopes="ggx")
    assert "no slopes from Beckmann's to GGX have this gloss" in vocabulary.warnings(facets)[0]
    assert float(facets["gloss_chi_squared"]) > 100


def test_the_changes_keep_the_variance_of_the_densities(known: GlossOfFinishes) -> None:
    read = readings(truth("ggx", 0.01).gloss)
    found = known.finishes(read, u(read))
    facets = facets_of_finishes(found, read, 0.0)
    slope = facets["slope"].values
    each = np.array(
        [student_slopes.density(slope, np.exp(w), t) for w, t in zip(found.log_width, found.tail, strict=True)]
    )
    seen = slope < 0.1
    deviation = found.deviation(each)[seen]
    stated = np.sqrt(np.square(facets["slope_density_change"].values[:, seen]).sum(axis=0))
    # Eight components or 99 % of the variance; less where a density cannot fall by more than itself.
    assert np.median(stated / deviation) == pytest.approx(1, abs=0.02)
    assert (facets["slope_density"].values + facets["slope_density_change"].values > 0).all()


@pytest.mark.slow
def test_an_uncertain_index_widens_the_slopes() -> None:
    # Of two readings: a third tells Fresnel's reflectance by the ratio of gloss at 20 and 60°.
    read = {60.0: 41.0, 85.0: 44.0}
    sure = finish_from_gloss(read, index=INDEX)
    index = optics.refractive_index(INDEX)
    index = index.assign(n_u=("wavelength", np.full(index.sizes["wavelength"], 0.05), {"units": "1"}))
    unsure = finish_from_gloss(read, index=vocabulary.label(index, "index"))
    # 0.05 of the index is 8 % of Fresnel's reflectance, more than the noise of these readings.
    assert float(unsure["median_slope_log_u"]) > 1.3 * float(sure["median_slope_log_u"])


@pytest.mark.parametrize(
    ("given", "options", "message"),
    [
        ({60.0: 40.0}, {}, "gloss readings at 60°; accepted: two or three"),
        ({60.0: 40.0, 45.0: 50.0}, {}, "accepted: two or three of 20°, 60° and 85°"),
        ({20.0: 5.0, 60.0: 40.0}, {"slopes": "phong"}, "unknown slopes 'phong'; accepted: any, beckmann, ggx"),
        ({20.0: 5.0, 60.0: 40.0}, {"gloss_u": 0.0}, "uncertainty of gloss is 0"),
    ],
)
def test_readings_from_which_nothing_follows_are_refused(given: dict, options: dict, message: str) -> None:
    with pytest.raises(GlossFinishError, match=message):
        finish_from_gloss(given, index=INDEX, **options)
    assert issubclass(GlossFinishError, BrdfpipeError)


def test_the_tails_of_a_word_have_a_probability_of_one() -> None:
    assert [sum(tails.values()) for tails in TAILS.values()] == pytest.approx([1, 1, 1])
