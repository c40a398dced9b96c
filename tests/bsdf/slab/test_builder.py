"""The slab: closed forms of smooth faces, energy balance, reciprocity, and an independent path tracer."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from sheet_tracer import Tracer

from brdfpipe import facets, optics, store, vocabulary
from brdfpipe.bsdf import microfacet, slab
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.slab.builder import ERROR_LIMIT
from brdfpipe.errors import VocabularyError
from brdfpipe.hemisphere import panel_rule

BOTH_SIDES = np.array([0.0, 8.0, 30.0, 60.0, 80.0, 89.0, 91.0, 120.0, 172.0, 180.0])
WAVELENGTH = np.linspace(400.0, 700.0, 41)


@cache
def finish(a: float) -> xr.Dataset:
    return facets.flat() if a == 0 else facets.analytic("beckmann", a)


@cache
def sheet(front: float, back: float, index: float = 1.5, transmittance: float = 1.0) -> xr.Dataset:
    return slab.build(finish(front), finish(back), index=index, internal_transmittance=transmittance)


def reflectance(bsdf: xr.Dataset, theta) -> np.ndarray:
    return representation(bsdf).albedo(np.atleast_1d(theta).astype(float), np.zeros(1), None)[:, 0]


def transmittance(bsdf: xr.Dataset, theta) -> np.ndarray:
    return representation(bsdf).transmittance(np.atleast_1d(theta).astype(float), np.zeros(1), None)[:, 0]


def inner_cosine(theta, index):
    return np.sqrt(1 - (np.sin(np.radians(theta)) / index) ** 2)


# --- closed forms


@pytest.mark.cases(5)
@pytest.mark.parametrize("index", [1.0, 1.01, 1.5, 2.4, 4.0])
@pytest.mark.parametrize("inside", [1.0, 0.999, 0.8, 0.0])
def test_two_smooth_faces_reflect_and_transmit_as_the_incoherent_sum_of_s_and_p(index, inside):
    bsdf = sheet(0, 0, index, inside)
    theta = np.concatenate([BOTH_SIDES, np.linspace(0.0, 89.9, 90), [89.999]])
    tau = inside ** (1 / inner_cosine(theta, index))
    reflected, transmitted = np.zeros((2, theta.size))
    for f in optics.fresnel(np.abs(np.cos(np.radians(theta))), index)[:2]:
        reflected += (f + (1 - f) ** 2 * tau**2 * f / (1 - (f * tau) ** 2)) / 2
        transmitted += (1 - f) ** 2 * tau / (1 - (f * tau) ** 2) / 2
    assert reflectance(bsdf, theta) == pytest.approx(reflected, abs=1e-9)
    assert transmittance(bsdf, theta) == pytest.approx(transmitted, abs=1e-9)


def test_a_clear_plate_has_its_published_reflectance_and_transmittance():
    # s and p summed apart; the mean of both between the faces would give .0647, .6142 and .4477, .2481.
    bsdf = sheet(0, 0, 1.5, 0.7)
    assert reflectance(bsdf, [40.0, 80.0]) == pytest.approx([0.0638, 0.4402], abs=5e-5)
    assert transmittance(bsdf, [40.0, 80.0]) == pytest.approx([0.6151, 0.2603], abs=5e-5)


def test_two_smooth_faces_do_not_scatter():
    bsdf = sheet(0, 0, 1.5, 0.8)
    mirrored, straight = representation(bsdf).specular(BOTH_SIDES, np.zeros(1), None)
    assert mirrored[:, 0] == pytest.approx(reflectance(bsdf, BOTH_SIDES), abs=1e-13)
    assert straight[:, 0] == pytest.approx(transmittance(bsdf, BOTH_SIDES), abs=1e-13)
    assert representation(bsdf).evaluate(30.0, 0.0, np.array([30.0, 150.0]), 180.0, None).max() < 1e-10


def test_a_black_body_reflects_as_its_front_face_does():
    bsdf, alone = sheet(0.3, 0, 1.5, 0.0), microfacet.build(finish(0.3), index=1.5, transparent=True)
    theta_o, phi = np.meshgrid(np.linspace(0, 85, 18), np.linspace(0, 180, 7))
    zero = np.zeros_like(phi)
    btdf = representation(bsdf).evaluate(40 + zero, zero, theta_o, phi, None)
    expected = representation(alone).evaluate(40 + zero, zero, theta_o, phi, None)
    # The loss of the facets is added as diffuse light on both sides: less than 4 % at 40° for a = 0.3.
    lost = (
        1
        - alone.bsdf.albedo(40.0).item()
        - representation(alone).transmittance(np.array([40.0]), np.zeros(1), None).item()
    )
    assert (btdf - expected >= 0).all()
    assert (btdf - expected).max() < lost
    assert transmittance(bsdf, BOTH_SIDES).max() == 0


def test_a_smooth_front_face_mirrors_as_a_single_interface_does():
    mirrored, straight = representation(sheet(0, 0.3)).specular(np.array([30.0, 150.0]), np.zeros(1), None)
    assert mirrored[0, 0] == pytest.approx(float(optics.fresnel(np.cos(np.pi / 6), 1.5).mean), abs=1e-9)
    assert mirrored[1, 0] == 0
    assert straight.max() == 0


def test_a_body_of_index_near_1_transmits_all_light():
    for faces in ((0, 0), (0.3, 0)):
        assert transmittance(sheet(*faces, index=1.0001), [0.0, 30.0, 60.0, 150.0]).min() > 1 - 1e-3


def test_behind_a_smooth_back_face_the_lobe_is_that_of_the_front_face_refracted_once_more():
    # Without reflections inside, f = f_t(i → x) (1 − F(x)) dω_x cos x / (dω_o cos o) = f_t (1 − F) / n²; those add F² ~ 0.0016 of the light.
    bsdf, alone = sheet(0.1, 0), microfacet.build(finish(0.1), index=1.5, transparent=True)
    theta_o = np.array([26.0, 28.0, 30.0, 32.0, 34.0])
    inside = np.degrees(np.arcsin(np.sin(np.radians(theta_o)) / 1.5))
    zero = np.zeros(theta_o.size)
    once = representation(alone).evaluate(30 + zero, zero, 180 - inside, 180 + zero, None)[:, 0]
    leaves = 1 - optics.fresnel(np.cos(np.radians(theta_o)), 1.5).mean
    btdf = representation(bsdf).evaluate(30 + zero, zero, 180 - theta_o, 180 + zero, None)[:, 0]
    assert btdf == pytest.approx(once * leaves / 1.5**2, rel=0.012)


# --- balance and reciprocity


@pytest.mark.cases(1)
@pytest.mark.parametrize(("front", "back", "index", "inside"), [(0.3, 0.3, 1.5, 0.8), (0.3, 0.0, 1.5, 1.0)])
def test_energy_is_balanced(front, back, index, inside):
    balance(front, back, index, inside)


@pytest.mark.slow
@given(
    front=st.sampled_from([0.05, 0.1, 0.3, 1.0]),
    back=st.sampled_from([0.0, 0.1, 1.0]),
    index=st.sampled_from([1.0, 1.01, 1.3, 1.5, 2.4]),
    inside=st.sampled_from([0.0, 1e-3, 0.9, 1.0]),
)
@settings(max_examples=5, deadline=None)
def test_what_is_not_reflected_or_transmitted_is_absorbed(front, back, index, inside):
    balance(front, back, index, inside)


def balance(front: float, back: float, index: float, inside: float) -> None:
    bsdf = sheet(front, back, index, inside)
    total = bsdf["reflectance"] + bsdf["transmittance"] + bsdf["absorptance"]
    assert total.values == pytest.approx(1.0, abs=1e-9)
    assert float(bsdf["absorptance"].min()) >= 0
    if inside == 1:
        assert float(bsdf["absorptance"].max()) == 0


@pytest.mark.cases(1)
@pytest.mark.parametrize("distribution", facets.DISTRIBUTIONS)
def test_energy_closes_between_the_nodes_too(distribution):
    table = facets.analytic(distribution, 0.4)
    bsdf = slab.build(table, finish(0), index=1.6, internal_transmittance=1.0)
    assert reflectance(bsdf, BOTH_SIDES) + transmittance(bsdf, BOTH_SIDES) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.cases(1)
@pytest.mark.parametrize("faces", [(0.3, 0.3), (0.3, 0.0), pytest.param((0.3, 0.1), marks=pytest.mark.slow)])
@given(theta_i=st.floats(0, 180), theta_o=st.floats(0, 180), phi=st.floats(-360, 360))
@settings(max_examples=40, deadline=None)
def test_a_slab_is_reciprocal_finite_and_not_negative(faces, theta_i, theta_o, phi):
    bsdf = sheet(*faces, transmittance=0.8 if faces[1] else 0.9)
    forward = representation(bsdf).evaluate(theta_i, 0.0, theta_o, phi, None)
    backward = representation(bsdf).evaluate(theta_o, phi, theta_i, 0.0, None)
    assert np.isfinite(forward).all()
    assert (forward >= 0).all()
    assert (forward == backward).all()


def test_light_along_the_normal_leaves_alike_in_every_azimuth():
    # The lobe behind a smooth front is sharp against the nodes: its tail must not ring.
    sheet = slab.build(facets.flat(), facets.analytic("ggx", 0.2), index=1.5, internal_transmittance=0.8)
    for theta_o in (140.0, 160.0, 20.0):
        around = sheet.bsdf.evaluate(0.0, 0.0, theta_o, [0.0, 1.0, 90.0, 179.0, 180.0]).values
        assert around == pytest.approx(around[0], rel=1e-3)


def test_equal_faces_give_equal_light_on_both_sides():
    bsdf = sheet(0.3, 0.3)
    assert reflectance(bsdf, [8.0, 60.0]) == pytest.approx(reflectance(bsdf, [172.0, 120.0]), abs=1e-12)
    there = representation(bsdf).evaluate(30.0, 0.0, np.array([20.0, 140.0]), 170.0, None)
    turned = representation(bsdf).evaluate(150.0, 0.0, np.array([160.0, 40.0]), 170.0, None)
    assert there == pytest.approx(turned, rel=1e-5)


@pytest.mark.slow
def test_a_slab_turned_over_is_the_same_slab_from_the_other_side():
    bsdf, turned = sheet(0.3, 0.1, 1.5, 0.8), sheet(0.1, 0.3, 1.5, 0.8)
    assert reflectance(bsdf, BOTH_SIDES) == pytest.approx(reflectance(turned, 180 - BOTH_SIDES), abs=1e-10)
    assert transmittance(bsdf, BOTH_SIDES) == pytest.approx(transmittance(turned, 180 - BOTH_SIDES), abs=1e-10)
    theta_o = np.array([10.0, 40.0, 120.0, 160.0])
    there = representation(bsdf).evaluate(30.0, 0.0, theta_o, 180.0, None)
    assert there == pytest.approx(representation(turned).evaluate(150.0, 0.0, 180 - theta_o, 180.0, None), rel=1e-4)


@pytest.mark.parametrize("faces", [(0.3, 0.3), (0.1, 0)])
@pytest.mark.parametrize("theta", [8.0, 60.0, 172.0])
def test_the_lobes_integrate_to_reflectance_and_transmittance(faces, theta):
    bsdf = sheet(*faces)
    at = np.array([theta]), np.zeros(1), None
    specular = representation(bsdf).specular(*at)
    for through, share in enumerate((representation(bsdf).albedo(*at), representation(bsdf).transmittance(*at))):
        lobe = representation(bsdf).integrate(at[0], at[1], None, transmitted_side=bool(through), relative=1e-4).value
        # The stated error of the interpolation is of the worst incidence, 1 %; these are better ones.
        assert lobe + specular[through] == pytest.approx(share, rel=4e-3)
    assert float(bsdf["interpolation_error"]) < ERROR_LIMIT


# --- a path tracer


def expected_share(bsdf, theta_i, low, high, forward):
    """∫ f |cos θ_o| dω_o over polar angles and the half of the azimuths towards, or away from, the straight direction."""
    theta, d_theta = panel_rule(np.linspace(low, high, 13), 6)
    phi, d_phi = panel_rule(np.linspace(90, 180, 13) if forward else np.linspace(0, 90, 7), 6)
    values = representation(bsdf).evaluate(theta_i, 0.0, theta[:, None], phi, None)[..., 0]
    weight = np.radians(d_theta) * np.abs(np.sin(2 * np.radians(theta))) / 2
    return 2 * float(weight @ values @ np.radians(d_phi))


BINS = [(0, 30), (30, 60), (60, 90), (90, 120), (120, 150), (150, 180)]


def compared_with_tracer(front, back, theta_i, inside, photons):
    """Shares of the light in bins of directions and on both sides: expected, traced, and the standard error of the second."""
    bsdf = sheet(front, back, 1.5, inside)
    travel, weight, who = Tracer(front, back, 1.5, inside, seed=7).trace(theta_i, photons)
    theta_o = np.degrees(np.arccos(np.clip(travel[:, 2], -1, 1)))
    # The photons set out in the plane of azimuth 0 and travel towards 180°.
    forward = travel[:, 0] < 0

    def traced(where):
        by_photon = np.bincount(who, np.where(where, weight, 0.0), photons)
        return by_photon.mean(), by_photon.std() / np.sqrt(photons)

    mirrored, straight = (each[0, 0] for each in representation(bsdf).specular(np.array([theta_i]), np.zeros(1), None))
    returned = theta_o < 90 if theta_i < 90 else theta_o > 90
    fluxes = [
        (share(bsdf, theta_i)[0], *traced(where))
        for where, share in ((returned, reflectance), (~returned, transmittance))
    ]
    lobes = []
    for low, high in BINS:
        for ahead in (True, False):
            delta = sum(
                part
                for part, angle in ((mirrored, theta_i), (straight, 180 - theta_i))
                if ahead and low <= angle < high
            )
            wanted = expected_share(bsdf, theta_i, low, high, ahead) + delta
            lobes.append((wanted, *traced((theta_o >= low) & (theta_o < high) & (forward == ahead))))
    return fluxes, lobes


@pytest.mark.cases(1)
@pytest.mark.parametrize(
    ("front", "back", "theta_i", "inside"),
    [
        pytest.param(0.3, 0.3, 30.0, 1.0, marks=pytest.mark.slow),
        (0.3, 0.3, 70.0, 0.8),
        (0.3, 0.0, 20.0, 0.9),
        pytest.param(0.3, 0.0, 140.0, 0.9, marks=pytest.mark.slow),
        pytest.param(1.0, 0.3, 110.0, 0.95, marks=pytest.mark.slow),
    ],
)
def test_a_path_tracer_finds_the_same_light_in_the_same_directions(front, back, theta_i, inside):
    fluxes, lobes = compared_with_tracer(front, back, theta_i, inside, 100_000)
    for wanted, value, error in fluxes:
        assert wanted == pytest.approx(value, abs=4 * error)
    for wanted, value, error in lobes:
        # A thousandth of the light in the bin for the interpolation, beside the noise.
        assert wanted == pytest.approx(value, abs=4 * error + 1e-3 * wanted)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("front", "back", "theta_i", "inside"), [(0.3, 0.3, 75.0, 0.8), (0.1, 0.1, 70.0, 0.9), (0.1, 0.0, 105.0, 0.7)]
)
def test_a_long_run_of_the_path_tracer_agrees_within_1_percent(front, back, theta_i, inside):
    # With the mean of s and p between the faces the last sheet would transmit 2.6 % too little, the second reflect 2.6 % too much.
    fluxes, lobes = compared_with_tracer(front, back, theta_i, inside, 2_000_000)
    for wanted, value, error in fluxes + [lobe for lobe in lobes if lobe[0] > 0.03]:
        assert error < 0.005 * value
        assert wanted == pytest.approx(value, rel=0.01)


# --- over wavelength


def spectral(values):
    return xr.DataArray(values, dims="wavelength", coords={"wavelength": WAVELENGTH})


@cache
def coloured() -> xr.Dataset:
    return slab.build(finish(0.3), finish(0.3), index=1.5, internal_transmittance=spectral(np.linspace(0, 1, 41) ** 3))


def directions(count=400):
    generator = np.random.default_rng(3)
    theta_i = np.degrees(np.arccos(generator.uniform(-1, 1, count)))
    theta_o = np.degrees(np.arccos(generator.uniform(-1, 1, count)))
    return theta_i, np.zeros(count), theta_o, generator.uniform(0, 360, count)


@pytest.mark.cases(1)
@pytest.mark.parametrize("k", [0, 25, *(pytest.param(k, marks=pytest.mark.slow) for k in (3, 38))])
def test_every_wavelength_is_the_slab_of_its_own_transmittance(k):
    bsdf = coloured()
    inside = float(bsdf["internal_transmittance"][k])
    alone = sheet(0.3, 0.3, 1.5, inside)
    at = directions()
    assert reflectance(alone, at[0]) == pytest.approx(representation(bsdf).albedo(at[0], at[1], None)[:, k], abs=1e-12)
    assert transmittance(alone, at[0]) == pytest.approx(
        representation(bsdf).transmittance(at[0], at[1], None)[:, k], abs=1e-12
    )
    spectral, expected = (
        representation(bsdf).evaluate(*at, WAVELENGTH[[k]])[:, 0],
        representation(alone).evaluate(*at, None)[:, 0],
    )
    flux = np.abs(np.cos(np.radians(at[2])))
    assert flux @ np.abs(spectral - expected) <= 0.01 * (flux @ expected)


@pytest.mark.slow
def test_dispersion_is_interpolated_over_few_indices():
    index = vocabulary.label(
        xr.Dataset(
            {"n": ("wavelength", np.linspace(1.52, 1.48, 41)), "k": ("wavelength", np.zeros(41))},
            coords={"wavelength": WAVELENGTH},
            attrs={"source": "a line"},
        ),
        "index",
    )
    bsdf = slab.build(finish(0.3), finish(0.3), index=index, internal_transmittance=0.9)
    assert bsdf.sizes["index_node"] == 3
    alone, at = sheet(0.3, 0.3, float(index["n"][7]), 0.9), directions(100)
    # A parabola through three indices 0.02 apart; the error goes with the cube of that.
    assert representation(bsdf).albedo(at[0], at[1], None)[:, 7] == pytest.approx(reflectance(alone, at[0]), abs=1e-5)
    spectral, expected = representation(bsdf).evaluate(*at, None)[:, 7], representation(alone).evaluate(*at, None)[:, 0]
    assert np.abs(spectral - expected).sum() < 3e-3 * expected.sum()


def test_an_absorption_coefficient_over_a_thickness_is_an_internal_transmittance():
    by_absorption = slab.build(finish(0), finish(0), index=1.5, absorption=0.1, thickness=2.0)
    assert float(by_absorption["internal_transmittance"]) == pytest.approx(np.exp(-0.2), rel=1e-15)
    alike = sheet(0, 0, 1.5, float(np.exp(-0.2)))
    assert reflectance(by_absorption, BOTH_SIDES) == pytest.approx(reflectance(alike, BOTH_SIDES), abs=1e-15)


def test_the_nonspectral_slab_is_the_mean_over_wavelength():
    bsdf, weight, at = coloured(), np.full(41, 1 / 41), directions()
    seen = representation(bsdf).nonspectral(weight)
    assert "wavelength" not in seen.dims
    mean = representation(bsdf).evaluate(*at, None) @ weight
    # The mean of logarithms between nodes is not the logarithm of the mean: within the error of the interpolation.
    assert np.abs(representation(seen).evaluate(*at, None)[:, 0] - mean).sum() < 0.005 * mean.sum()
    assert representation(seen).albedo(at[0], at[1], None)[:, 0] == pytest.approx(
        representation(bsdf).albedo(at[0], at[1], None) @ weight, abs=1e-12
    )


# --- what a user meets


def test_it_is_a_dataset_like_any_other(tmp_path):
    bsdf = vocabulary.validate(coloured(), "bsdf")
    store.save_dataset(bsdf, tmp_path / "slab.nc", stage="bsdf", material="sheet")
    stored = store.open_dataset(tmp_path / "slab.nc")
    at = 30.0, 0.0, np.array([30.0, 150.0]), 180.0
    assert stored.bsdf.evaluate(*at, wavelength=[450, 550]).values == pytest.approx(
        bsdf.bsdf.evaluate(*at, wavelength=[450, 550]).values, rel=1e-12
    )
    assert representation(stored).transmits
    assert representation(stored).isotropic
    assert representation(stored).index_below() == 1.0


def test_unresolved_lobes_are_specular_with_a_warning():
    bsdf = sheet(0.01, 0.0)
    assert "narrower than a slab resolves" in vocabulary.warnings(bsdf)[0]
    straight = representation(bsdf).specular(np.array([8.0]), np.zeros(1), None)[1]
    plate = transmittance(sheet(0, 0), 8.0)
    # A face of slope 0.01 transmits as much as a smooth one, to the square of the slope.
    assert straight[0] == pytest.approx(plate, abs=2e-4)
    assert transmittance(bsdf, 8.0) == pytest.approx(plate, abs=2e-4)


def test_a_lay_is_averaged_over_azimuth_with_a_warning():
    brushed = facets.analytic("beckmann", a_x=0.1, a_y=0.4)
    bsdf = slab.build(brushed, finish(0), index=1.5)
    assert any("averaged over azimuth" in text for text in vocabulary.warnings(bsdf))


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"masking": "blinn"}, "needs one of Smith's maskings"),
        ({"internal_transmittance": 1.2}, "accepted: 0 to 1"),
        ({"internal_transmittance": float("nan")}, "accepted: 0 to 1"),
        ({"absorption": 0.1}, "thickness"),
        ({"thickness": 1.0}, "absorption"),
        ({"absorption": 0.1, "thickness": 1.0, "internal_transmittance": 0.5}, "either"),
        ({"absorption": -0.1, "thickness": 1.0}, "accepted: finite"),
        ({"internal_transmittance": xr.DataArray([0.5, 0.6], dims="x")}, "over increasing `wavelength`"),
    ],
)
def test_impossible_input_of_a_slab_is_refused(given, says):
    with pytest.raises(microfacet.ModelError, match=says):
        slab.build(finish(0), finish(0), index=1.5, **given)


def test_an_absorbing_index_is_refused():
    index = vocabulary.label(
        xr.Dataset(
            {"n": ("wavelength", [0.2, 0.2]), "k": ("wavelength", [3.0, 3.0])},
            coords={"wavelength": [400.0, 700.0]},
            attrs={"source": "a metal"},
        ),
        "index",
    )
    with pytest.raises(microfacet.ModelError, match="absorbs"):
        slab.build(finish(0), finish(0), index=index)


def test_faces_must_be_facets():
    with pytest.raises(VocabularyError, match="facets"):
        slab.build(sheet(0, 0), finish(0), index=1.5)
