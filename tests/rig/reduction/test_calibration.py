"""Calibration in closed form: profiles and BRDFs of reduced data of which every factor is known, and profiles that may not be used."""

from __future__ import annotations

import functools
from dataclasses import replace
from datetime import date

import numpy as np
import pytest
import rig_accuracy as accuracy
import rig_emulated
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from brdfpipe import specular_directions, store, vocabulary
from brdfpipe.rig.reduction.calibration import HOLE, CalibrationError, apply, calibrate, charted, joined
from brdfpipe.rig.reduction.certificate import Certificate
from brdfpipe.rig.reduction.relative_light import COMPONENTS

WAVELENGTHS = np.array([430.0, 470.0, 510.0, 550.0, 650.0])
LAMP = np.array([5e4, 1.6e5, 1.2e5, 1.25e5, 1.1e5])
PATHS = {0.0: 0.9, 10.0: 1.0, 30.0: 1.08, 45.0: 1.03, 60.0: 0.95}
NAMES = ("noise", "repeat", "reference", "calibration", "certificate", "nd", "glare", "geometry", "path")


def certificate(u: float = 0.005, until: date = date(2030, 1, 1)) -> Certificate:
    theta = np.arange(0.0, 91.0, 1.0)
    return Certificate(
        "C-1", until, np.array([300.0, 900.0]), np.array([0.9, 0.9]), np.full(2, u), theta, shape(theta), 0 * theta
    )


def shape(theta):
    return 1 - 0.05 * (theta / 60) ** 2


def directions(count: int = 80, seed: int = 0):
    random = np.random.default_rng(seed)
    return np.sort(random.uniform(0.5, 105, count)), random.uniform(-180, 180, count)


def sample_brdf(incidence, theta_s, phi_s):
    """Some BRDF (wavelength, cell)."""
    return (0.1 + 0.3 * WAVELENGTHS[:, None] / 650) * (1 + np.exp(-theta_s / 20))


def etalon_brdf(entrance, theta_s, phi_s):
    angle = np.degrees(np.arccos(np.clip(specular_directions.cos_view_etalon(entrance, theta_s, phi_s), 0, 1)))
    return np.broadcast_to(
        0.9 / np.pi * np.interp(angle, np.arange(0.0, 91.0), shape(np.arange(0.0, 91.0))), (5, angle.size)
    )


def reduced(
    load: str,
    incidences=(10.0, 30.0),
    *,
    efficiency=1.0,
    hidden=None,
    stray: float = 0.0,
    relative: float = 1e-3,
    day: str = "2026-03-01",
    **attrs: object,
) -> xr.Dataset:
    """What a perfect reduction gives; ``hidden(incidence)`` says which share of each cell's light is missing."""
    theta, phi = directions()
    signal = []
    for incidence in incidences:
        if load == "etalon":
            cosine, brdf = (
                specular_directions.cos_view_etalon(incidence, theta, phi),
                etalon_brdf(incidence, theta, phi),
            )
        else:
            cosine, brdf = specular_directions.cos_view(incidence, theta, phi), sample_brdf(incidence, theta, phi)
        seen = (brdf * np.maximum(cosine, 0) + stray) * PATHS[incidence] * (1 + 0.1 * np.sin(WAVELENGTHS[:, None] / 70))
        signal.append(seen * efficiency * (1.0 if hidden is None else 1 - hidden(incidence)))
    values = np.array(signal)
    dims = ("incidence", "wavelength", "cell")
    variables = {"signal": (dims, values), "signal_quality": (dims, np.zeros(values.shape, dtype=np.int8))}
    floor = 1e-6 * np.broadcast_to(efficiency, theta.shape)
    variables |= {
        f"signal_u_{name}": (
            dims,
            np.hypot(relative * np.abs(values), floor) if name == "noise" else relative * np.abs(values),
            {"correlation": correlation},
        )
        for name, correlation in COMPONENTS.items()
    }
    variables["reference"] = (("incidence", "wavelength"), np.tile(LAMP, (len(incidences), 1)))
    variables["elapsed"] = (("incidence", "wavelength"), np.tile(60.0 * np.arange(5), (len(incidences), 1)))
    dataset = xr.Dataset(
        variables,
        coords={
            "incidence": list(incidences),
            "wavelength": WAVELENGTHS,
            "cell": ("cell", np.array([f"F{k}" for k in range(theta.size)])),
            "kind": ("cell", np.full(theta.size, "fibre")),
            "theta_s": ("cell", theta),
            "phi_s": ("cell", phi),
            "solid_angle": ("cell", np.full(theta.size, np.nan)),
        },
        attrs={"rig": "bench", "rig_digest": "abc", "sample": "tile", "side": "reflection", "load": load, "day": day}
        | {"filter": 1, "filter_u": 0.0, "disc_scale_u": 0.01}
        | attrs,
    )
    return vocabulary.validate(vocabulary.label(dataset, "reduced"), "reduced")


def brdf_of(sample: xr.Dataset, **told: object) -> xr.Dataset:
    return apply(sample, calibrate(reduced("etalon"), certificate()), **told)


def above(incidence, least=0.1):
    theta, phi = directions()
    facing = np.max([specular_directions.cos_view_etalon(entrance, theta, phi) for entrance in (10.0, 30.0)], axis=0)
    return (specular_directions.cos_view(incidence, theta, phi) > least) & (facing > 0.11)


# --- the formula


def test_the_brdf_is_recovered_exactly():
    found = brdf_of(reduced("sample"))
    vocabulary.validate(found, "primary")
    for place, incidence in enumerate((10.0, 30.0)):
        seen = above(incidence)
        true = sample_brdf(incidence, *directions())
        assert found["brdf"].values[place][:, seen] == pytest.approx(true[:, seen], rel=1e-9)


def test_the_published_example_of_both_cosines():
    """σ = 45, σ_st = 10, (20, 30): cos γ = 0.8739067326, cos ϑ_st = 0.9843279494 (PHYSICS, rig)."""
    cosine, facing = (
        specular_directions.cos_view(45.0, 20.0, 30.0),
        specular_directions.cos_view_etalon(10.0, 20.0, 30.0),
    )
    assert (cosine, facing) == pytest.approx((0.8739067326, 0.9843279494), abs=1e-10)
    etalon, sample = reduced("etalon", (10.0,)), reduced("sample", (45.0,))
    for dataset, signal in ((etalon, 3.0), (sample, 2.0)):
        dataset["theta_s"][0], dataset["phi_s"][0] = 20.0, 30.0
        dataset["signal"][..., 0] = signal
    found = apply(sample, calibrate(etalon, certificate()))
    angle = np.degrees(np.arccos(facing))
    f_st = 0.9 / np.pi * np.interp(angle, np.arange(0.0, 91.0), shape(np.arange(0.0, 91.0)))
    # What cells below the horizon see, nothing but rounding here, was taken off.
    assert found["brdf"].values[0, :, 0] == pytest.approx(f_st * facing / cosine * 2 / 3, rel=1e-8)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_an_efficiency_of_each_cell_changes_nothing(seed):
    """What a cell's path does to light it does to the etalon's and to the sample's."""
    efficiency = np.random.default_rng(seed).uniform(0.3, 3.0, directions()[0].size)
    plain = brdf_of(reduced("sample"))
    bent = apply(
        reduced("sample", efficiency=efficiency), calibrate(reduced("etalon", efficiency=efficiency), certificate())
    )
    for name in ("brdf", "brdf_u", *(f"brdf_u_{each}" for each in NAMES)):
        assert np.array_equal(np.isnan(plain[name].values), np.isnan(bent[name].values))
        kept = np.isfinite(plain[name].values)
        size = np.abs(plain["brdf"].values[kept])
        assert (np.abs(plain[name].values - bent[name].values)[kept] / size).max() < 1e-12


def test_paths_are_told_by_the_cells_that_entrances_share():
    profile = calibrate(reduced("etalon", tuple(PATHS)), certificate())
    expected = np.array(list(PATHS.values())) / PATHS[0.0]
    assert profile["path"].values == pytest.approx(np.tile(expected[:, None], (1, 5)), rel=1e-9)
    assert (profile["path_u"].values[0] == 0).all()
    assert (profile["path_u"].values[1:] < 1e-3).all()
    assert not profile["hidden"].values.any()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_what_mirrors_of_an_entrance_do_to_a_spectrum_changes_nothing(seed):
    """Each entrance with a spectrum of its own, some percent up and down, the same for etalon and sample."""
    etalon, sample = reduced("etalon"), reduced("sample")
    plain = apply(sample, calibrate(etalon, certificate()))
    spectra = np.random.default_rng(seed).uniform(0.95, 1.05, (2, WAVELENGTHS.size, 1))
    for dataset in (etalon, sample):
        for name in ("signal", *(f"signal_u_{each}" for each in COMPONENTS)):
            dataset[name] = dataset[name] * spectra
            dataset[name].attrs["correlation"] = COMPONENTS.get(name.removeprefix("signal_u_"), "")
    etalon, sample = (vocabulary.label(each, "reduced") for each in (etalon, sample))
    bent = apply(sample, calibrate(etalon, certificate()))
    kept = np.isfinite(plain["brdf"].values)
    assert np.array_equal(kept, np.isfinite(bent["brdf"].values))
    assert bent["brdf"].values[kept] == pytest.approx(plain["brdf"].values[kept], rel=1e-9)


def test_the_light_of_an_entrance_is_as_uncertain_as_its_spread_over_the_shared_cells():
    """Cells that scatter by 1 % tell each wavelength's path to 1 % over the root of their number."""
    etalon = reduced("etalon", relative=0.01)
    noise = np.random.default_rng(3).standard_normal(etalon["signal"].shape)
    etalon["signal"] = etalon["signal"] * (1 + 0.01 * np.sqrt(2) * noise)
    profile = calibrate(etalon, certificate())
    count = (
        (np.array([specular_directions.cos_view_etalon(each, *directions()) for each in (10.0, 30.0)]) > 0.1)
        .all(axis=0)
        .sum()
    )
    path, u = profile["path"].values[1], profile["path_u"].values[1]
    # Noise and geometry are each cell's own, through both entrances.
    assert u / path == pytest.approx(0.02 / np.sqrt(count), rel=0.25)
    assert np.sqrt((((path - 1.08) / u) ** 2).mean()) < 2


def test_more_entrances_calibrate_more_cells_with_less_noise():
    one, all_ = (calibrate(reduced("etalon", entrances), certificate()) for entrances in ((10.0,), tuple(PATHS)))
    counted = [int(np.isfinite(each["cell_scale"].values[0]).sum()) for each in (one, all_)]
    assert counted[1] > counted[0]
    shared = np.isfinite(one["cell_scale"].values)
    ratio = (all_["cell_scale_u_calibration"] / all_["cell_scale"]).values[shared] / (
        one["cell_scale_u_calibration"] / one["cell_scale"]
    ).values[shared]
    assert ratio.max() <= 1
    assert ratio.min() == pytest.approx(1 / np.sqrt(5), rel=1e-4)


def test_an_entrance_the_etalon_was_not_seen_through_is_uncertain_by_five_percent():
    found = brdf_of(reduced("sample", (10.0, 45.0)))
    relative = (found["brdf_u_path"] / found["brdf"]).values
    assert np.nanmedian(relative[0]) < 0.005
    assert np.nanmedian(relative[1]) == pytest.approx(0.05, rel=0.01)


def test_cells_that_the_etalon_grazes_or_that_are_below_the_horizon_have_no_value_and_say_why():
    found = apply(reduced("sample", (60.0,)), calibrate(reduced("etalon", (10.0,)), certificate()))
    theta, phi = directions()
    shadowed = specular_directions.cos_view(60.0, theta, phi) <= 0
    grazed = (
        (specular_directions.cos_view_etalon(10.0, theta, phi) < 0.1)
        & ~shadowed
        & (specular_directions.cos_view(60.0, theta, phi) > 0.01)
    )
    quality = found["brdf_quality"].values[0]
    assert shadowed.any()
    assert grazed.any()
    assert (quality[:, shadowed] == vocabulary.quality("shadowed")).all()
    assert (quality[:, grazed] == vocabulary.quality("vignetted")).all()
    assert np.isnan(found["brdf"].values[0][:, shadowed | grazed]).all()


def test_a_dead_fibre_has_no_value():
    efficiency = np.ones(directions()[0].size)
    efficiency[7] = 1e-4
    profile = calibrate(reduced("etalon", efficiency=efficiency), certificate())
    assert np.isnan(profile["cell_scale"].values[:, 7]).all()
    assert np.isfinite(profile["cell_scale"].values[:, 6]).all()
    found = apply(reduced("sample", efficiency=efficiency), profile)
    assert np.isnan(found["brdf"].values[:, :, 7]).all()
    assert (found["brdf_quality"].values[:, :, 7] == vocabulary.quality("vignetted")).all()


@pytest.mark.parametrize("share", [1.0, 0.3], ids=["wholly", "partly"])
def test_a_cell_that_one_entrance_hides_is_left_out_there_and_calibrated_by_the_others(share):
    def hidden(incidence):
        missing = np.zeros(directions()[0].size)
        missing[[3, 4]] = share if incidence == 30.0 else 0.0
        return missing

    profile = calibrate(reduced("etalon", (10.0, 30.0, 45.0), hidden=hidden), certificate())
    assert profile["hidden"].values[1].nonzero()[0].tolist() == [3, 4]
    assert not profile["hidden"].values[[0, 2]].any()
    found = apply(reduced("sample", (10.0, 30.0), hidden=hidden), profile)
    true = sample_brdf(10.0, *directions())
    assert found["brdf"].values[0][:, 3] == pytest.approx(true[:, 3], rel=1e-6)
    assert np.isnan(found["brdf"].values[1][:, [3, 4]]).all()
    assert profile["path"].values == pytest.approx(np.tile([[1.0], [1.08], [1.03]], (1, 5)), rel=1e-6)


def test_next_to_an_entrance_of_which_nothing_is_known_nothing_is_trusted():
    profile = calibrate(reduced("etalon", (10.0, 30.0)), certificate())
    theta, phi = directions()
    near = specular_directions.cos_view_etalon(0.0, theta, phi) > np.cos(np.radians(HOLE))
    assert near.any()
    found = apply(reduced("sample", (0.0,)), profile)
    assert np.isnan(found["brdf"].values[0][:, near]).all()
    # Through a sample the light comes from behind.
    through = apply(reduced("sample", (0.0,), side="transmission"), profile)
    assert np.isfinite(through["brdf"].values[0][:, near]).all()


def test_light_that_walls_send_everywhere_is_told_by_cells_below_the_horizon():
    sample = reduced("sample", (60.0,), stray=1e-3)
    found = apply(sample, calibrate(reduced("etalon", tuple(PATHS)), certificate()))
    assert found.attrs["stray"] == pytest.approx([1e-3], rel=1e-3)
    assert 0 < found.attrs["stray_u"][0] < 1e-4
    seen = above(60.0)
    true = sample_brdf(60.0, *directions())
    assert found["brdf"].values[0][:, seen] == pytest.approx(true[:, seen], rel=1e-3)


def test_an_incidence_without_cells_below_the_horizon_takes_the_stray_light_of_the_others():
    sample = reduced("sample", (0.0, 60.0), stray=1e-3).sel(cell=above(0.0, 0.05) | ~above(60.0, -0.1))
    profile = calibrate(reduced("etalon", tuple(PATHS)), certificate()).sel(cell=sample["cell"])
    dark = specular_directions.cos_view(0.0, sample["theta_s"].values, sample["phi_s"].values) < -0.05
    assert (dark & np.isfinite(profile["cell_scale"].values[0])).sum() < 5
    found = apply(sample, profile)
    assert found.attrs["stray"] == pytest.approx([1e-3, 1e-3], rel=2e-3)
    # As uncertain there as it is large.
    assert found.attrs["stray_u"][0] == pytest.approx(1e-3, rel=0.01)
    assert found.attrs["stray_u"][1] < 1e-4


# --- uncertainties


def test_components_add_up_and_each_says_whether_it_is_common():
    found = brdf_of(reduced("sample"))
    parts = [found[f"brdf_u_{name}"].values for name in NAMES]
    assert np.sqrt(np.sum(np.square(parts), axis=0)) == pytest.approx(found["brdf_u"].values, nan_ok=True)
    common = {name for name in NAMES if found[f"brdf_u_{name}"].attrs["correlation"] == "common"}
    assert common == {"repeat", "reference", "certificate", "nd", "glare", "path"}


def test_what_is_common_to_all_cells_of_the_etalon_stays_common():
    """The etalon's noise averages out over cells, its reference does not: neither may pass for the other."""
    etalon = reduced("etalon", (10.0,), relative=0.0)
    for name, size in (("noise", 0.01), ("geometry", 0.004), ("reference", 0.003), ("nd", 0.002), ("glare", 0.001)):
        etalon[f"signal_u_{name}"] = size * np.abs(etalon["signal"])
        etalon[f"signal_u_{name}"].attrs = {"units": "1", "correlation": COMPONENTS[name]}
    found = apply(reduced("sample", (10.0,), relative=0.0), calibrate(etalon, certificate(0.005)))
    seen = above(10.0)
    expected = {
        "calibration": np.hypot(0.01, 0.004),
        "reference": 0.003,
        "nd": 0.002,
        "certificate": 0.005,
        "repeat": 0.0,
    }
    for name, size in expected.items():
        relative = (found[f"brdf_u_{name}"] / found["brdf"]).values[0][:, seen]
        assert relative == pytest.approx(size, rel=1e-6, abs=1e-9), name


def test_the_shape_of_the_etalon_is_uncertain_as_the_certificate_states_or_as_such_etalons_are():
    """Light of an etalon that falls by 5 % towards 60°, once by a certificate that says so, once by one that has nothing to say of it."""
    etalon, sample = reduced("etalon", (10.0,), relative=1e-4), reduced("sample", (10.0,), relative=1e-4)
    stated = certificate()
    silent = replace(stated, theta=np.zeros(1), shape=np.ones(1), shape_u=np.zeros(1))
    theta = np.degrees(np.arccos(np.clip(specular_directions.cos_view_etalon(10.0, *directions()), 0, 1)))
    seen = above(10.0, 0.15) & (theta < 83)
    true = sample_brdf(10.0, *directions())[:, seen]
    # Cells below the horizon see nothing here.
    for each, expected, told in ((stated, 0 * theta, 0), (silent, 0.05 * (theta / 60) ** 2, 1)):
        found = apply(sample, calibrate(etalon, each))
        relative = (found["brdf_u_certificate"] / found["brdf"]).values[0][:, seen]
        assert relative == pytest.approx(np.tile(np.hypot(0.005, expected[seen]), (5, 1)), rel=1e-6)
        z = ((found["brdf"].values[0][:, seen] - true) / found["brdf_u"].values[0][:, seen])[:, theta[seen] > 30]
        assert np.abs(z).max() < 1.3
        warnings = vocabulary.warnings(calibrate(etalon, each))
        assert len([text for text in warnings if "state `angles` in certificate.yaml" in text]) == told


def test_a_wrong_shape_of_the_etalon_counts_in_the_light_of_entrances():
    """Cells see the etalon at other angles through another entrance: what its shape is uncertain by looks like light."""
    silent = replace(certificate(), theta=np.zeros(1), shape=np.ones(1), shape_u=np.zeros(1))
    profile = calibrate(reduced("etalon", (10.0, 45.0)), silent)
    path, u = profile["path"].values[1], profile["path_u"].values[1]
    assert np.abs(path - 1.03).min() > 1e-3
    assert (np.abs(path - 1.03) / u).max() < 1.5


def test_the_albedo_of_common_errors_does_not_average_out():
    """1 % independent with 3 % common: the mean of many cells is uncertain by 3.0 %, not by 0.04 % (RIG)."""
    sample, etalon = reduced("sample", (10.0,), relative=0.0), reduced("etalon", (10.0,), relative=0.0)
    sample["signal_u_noise"] = (0.01 * np.abs(sample["signal"])).assign_attrs(sample["signal_u_noise"].attrs)
    found = apply(sample, calibrate(etalon, certificate(0.03)))
    seen = above(10.0)
    value = found["brdf"].values[0, 0, seen]
    independent = np.hypot(found["brdf_u_noise"], found["brdf_u_calibration"]).values[0, 0, seen]
    common = found["brdf_u_certificate"].values[0, 0, seen]
    mean_u = np.hypot(np.sqrt((independent**2).sum()), common.sum()) / value.sum()
    assert mean_u == pytest.approx(np.hypot(0.03, 0.01 / np.sqrt(seen.sum())), rel=0.02)


def test_noise_of_etalon_and_sample_is_stated_as_it_comes_out():
    """Monte Carlo: every run with another noise."""
    z = []
    for seed in range(60):
        random = np.random.default_rng(seed)
        etalon, sample = reduced("etalon", (10.0, 30.0), relative=0.01), reduced("sample", (10.0,), relative=0.01)
        for dataset in (etalon, sample):
            noise = dataset["signal_u_noise"].values * random.standard_normal(dataset["signal"].shape)
            dataset["signal"] = dataset["signal"] + noise
        found = apply(sample, calibrate(etalon, certificate()))
        seen = above(10.0)
        error = found["brdf"].values[0][:, seen] - sample_brdf(10.0, *directions())[:, seen]
        own = found["brdf_u_calibration"].values[0][:, seen]
        # The etalon's geometry counts as 1 % too, and was not drawn.
        u = np.hypot(found["brdf_u_noise"].values[0][:, seen], own / np.sqrt(2))
        z.append(error / u)
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1, abs=0.05)


def test_other_filters_than_the_etalons_add_their_uncertainty():
    same, other = (brdf_of(reduced("sample", filter=place, filter_u=u)) for place, u in ((1, 0.0), (2, 0.02)))
    relative = (other["brdf_u_nd"] / other["brdf"]).values
    assert np.nanmedian(relative) == pytest.approx(0.02, rel=0.02)
    assert np.nanmedian((same["brdf_u_nd"] / same["brdf"]).values) < 0.002


# --- what may not be used


def test_a_profile_may_be_used_for_as_long_as_it_says_and_no_longer():
    profile = calibrate(reduced("etalon"), certificate(), valid_days=90)
    apply(reduced("sample", day="2026-05-30"), profile)
    with pytest.raises(CalibrationError, match="has expired: it is 91 days old"):
        apply(reduced("sample", day="2026-05-31"), profile)
    with pytest.raises(CalibrationError, match="after the sample was measured"):
        apply(reduced("sample", day="2026-02-28"), profile)


def test_a_profile_may_be_used_for_so_many_hours_of_the_lamp():
    profile = calibrate(reduced("etalon"), certificate(), lamp_hours=100.0, valid_hours=50.0)
    apply(reduced("sample"), profile, lamp_hours=150.0)
    with pytest.raises(CalibrationError, match="lamp has burnt 51 h since"):
        apply(reduced("sample"), profile, lamp_hours=151.0)
    with pytest.raises(CalibrationError, match="lamp was changed"):
        apply(reduced("sample"), profile, lamp_hours=3.0)


def test_a_certificate_that_has_run_out_makes_no_profile_and_ends_the_use_of_one():
    with pytest.raises(CalibrationError, match="was valid until 2026-02-28"):
        calibrate(reduced("etalon"), certificate(until=date(2026, 2, 28)))
    profile = calibrate(reduced("etalon"), certificate(until=date(2026, 3, 15)))
    with pytest.raises(CalibrationError, match="C-1 was valid until 2026-03-15"):
        apply(reduced("sample", day="2026-03-16"), profile)


def test_what_is_overridden_is_recorded():
    stale = calibrate(reduced("etalon"), certificate(until=date(2026, 2, 28)), override=True)
    assert "valid until 2026-02-28" in stale.attrs["overridden"]
    found = apply(reduced("sample", day="2027-03-01"), stale, override=True)
    assert "has expired" in found.attrs["overridden"]
    assert sum("used nevertheless" in warning for warning in vocabulary.warnings(found)) == 2
    assert "overridden" not in brdf_of(reduced("sample")).attrs


@pytest.mark.parametrize("order", [[0, 2, 1, 3, 4], [4, 3, 2, 1, 0]], ids=["swapped", "reversed"])
def test_wavelengths_in_another_order_are_told_by_the_lamps_spectrum(order):
    sample = reduced("sample")
    for name in ("signal", "reference"):
        sample[name].values = sample[name].values[:, order]
    with pytest.raises(CalibrationError, match="lamp's spectrum differs"):
        brdf_of(sample)


def test_a_lamp_that_grew_dimmer_at_all_wavelengths_is_the_same_lamp():
    sample = reduced("sample")
    sample["reference"] = 0.5 * sample["reference"]
    plain = brdf_of(reduced("sample"))
    assert brdf_of(sample)["brdf"].values == pytest.approx(plain["brdf"].values, nan_ok=True)


def test_wavelengths_the_etalon_was_not_measured_at_are_refused():
    etalon = reduced("etalon").isel(wavelength=[0, 1, 3, 4])
    with pytest.raises(CalibrationError, match="not measured at 510 nm"):
        apply(reduced("sample"), calibrate(etalon, certificate()))


def test_a_wavelength_without_a_reference_makes_no_profile_of_itself():
    etalon = reduced("etalon")
    etalon["reference"][:, 2] = np.nan
    etalon["signal"][:, 2] = np.nan
    assert calibrate(etalon, certificate())["wavelength"].values.tolist() == [430.0, 470.0, 550.0, 650.0]
    etalon["reference"][:] = np.nan
    with pytest.raises(CalibrationError, match="no frame of the etalon shows the reference"):
        calibrate(etalon, certificate())


def test_the_etalon_of_another_rig_is_refused():
    profile = calibrate(reduced("etalon", rig_digest="other", rig="bench-2"), certificate())
    with pytest.raises(CalibrationError, match=r"of another rig \(bench-2\)"):
        apply(reduced("sample"), profile)


def test_other_cells_are_refused():
    profile = calibrate(reduced("etalon"), certificate())
    with pytest.raises(CalibrationError, match="other cells"):
        apply(reduced("sample").isel(cell=slice(0, 70)), profile)


def test_a_profile_is_made_of_the_etalon_and_used_on_the_sample():
    with pytest.raises(CalibrationError, match="frames are of the sample"):
        calibrate(reduced("sample"), certificate())
    with pytest.raises(CalibrationError, match="frames are of the etalon"):
        brdf_of(reduced("etalon"))


@pytest.mark.parametrize("load", ["sample", "etalon"])
def test_missing_values_that_were_stored_as_zeros_are_refused(load):
    etalon, sample = reduced("etalon"), reduced("sample")
    dataset = sample if load == "sample" else etalon
    lost = np.random.default_rng(0).random(dataset["signal"].shape) < 0.05
    dataset["signal"] = dataset["signal"].where(~lost, 0.0)
    with pytest.raises(CalibrationError, match="exactly 0"):
        apply(sample, calibrate(etalon, certificate()))


def test_whole_cells_of_zeros_are_refused_where_the_etalon_had_light():
    sample = reduced("sample")
    sample["signal"][:, :, [3, 20, 33, 47]] = 0.0
    with pytest.raises(CalibrationError, match="exactly 0"):
        brdf_of(sample)


def test_missing_values_that_are_missing_are_no_trouble():
    sample = reduced("sample")
    lost = np.random.default_rng(0).random(sample["signal"].shape) < 0.05
    sample["signal"] = sample["signal"].where(~lost)
    found, plain = brdf_of(sample), brdf_of(reduced("sample"))
    kept = np.isfinite(found["brdf"].values)
    assert found["brdf"].values[kept] == pytest.approx(plain["brdf"].values[kept])
    assert np.isnan(found["brdf"].values[lost]).all()


# --- joining


def test_arrangements_are_joined_by_rising_incidence_with_each_warning_once():
    late, early = (
        vocabulary.add_warning(reduced("sample", (incidence,)), "the same", f"of {incidence:g}")
        for incidence in (30.0, 10.0)
    )
    found = joined([late, early])
    assert found["incidence"].values.tolist() == [10.0, 30.0]
    assert sorted(vocabulary.warnings(found)) == ["of 10", "of 30", "the same"]
    assert found["theta_s"].dims == ("cell",)
    assert found["signal"].values[0] == pytest.approx(early["signal"].values[0])


@pytest.mark.parametrize("name", ["rig_digest", "load", "side", "filter"])
def test_what_does_not_belong_together_is_not_joined(name):
    one, other = reduced("sample", (10.0,)), reduced("sample", (30.0,)).assign_attrs({name: "another"})
    with pytest.raises(CalibrationError, match=f"differ in {name}"):
        joined([one, other])


def test_a_wavelength_that_an_arrangement_lost_is_missing_there_and_named_with_what_to_do():
    whole, holed = reduced("sample", (10.0,)), reduced("sample", (30.0,)).isel(wavelength=[0, 1, 3, 4])
    found = joined([holed, whole])
    assert found["wavelength"].values.tolist() == WAVELENGTHS.tolist()
    assert np.isnan(found["signal"].values[1, 2]).all()
    assert (found["signal_quality"].values[1, 2] == vocabulary.quality("missing")).all()
    assert found["signal_quality"].dtype == np.int8
    assert found["signal"].values[1, [0, 1, 3, 4]] == pytest.approx(holed["signal"].values[0])
    (warning,) = vocabulary.warnings(found)
    assert "no frame that can be used of 30° at 510 nm" in warning
    assert "`brdfpipe rig scan … --resume`" in warning
    primary, plain = brdf_of(found), brdf_of(joined([whole, reduced("sample", (30.0,))]))
    assert (primary["brdf_quality"].values[1, 2, above(30.0)] == vocabulary.quality("missing")).all()
    rest = np.ones(primary["brdf"].shape, dtype=bool)
    rest[1, 2] = False
    assert primary["brdf"].values[rest] == pytest.approx(plain["brdf"].values[rest], nan_ok=True)


@pytest.mark.parametrize("lost", [10.0, 30.0], ids=["the first entrance", "another entrance"])
def test_a_wavelength_the_etalon_lost_through_one_entrance_is_told_through_the_others(lost):
    """The light of the entrance at that wavelength is told from those next to it, and as uncertain as of one not looked through."""
    parts = [
        reduced("etalon", (entrance,)).isel(wavelength=[0, 1, 3, 4] if entrance == lost else slice(None))
        for entrance in (10.0, 30.0)
    ]
    etalon = joined(parts)
    profile = calibrate(etalon, certificate())
    assert profile["wavelength"].values.tolist() == WAVELENGTHS.tolist()
    (warning,) = vocabulary.warnings(profile)
    assert "the etalon in reflection" in warning
    assert f"{lost:g}° at 510 nm" in warning
    found = apply(reduced("sample"), profile)
    plain = brdf_of(reduced("sample"))
    both = np.isfinite(found["brdf"].values) & np.isfinite(plain["brdf"].values)
    others = specular_directions.cos_view_etalon(40.0 - lost, *directions()) > 0.11
    assert np.isfinite(found["brdf"].values[:, 2])[np.array([others & above(each) for each in (10.0, 30.0)])].all()
    # These paths are the same at all wavelengths.
    assert found["brdf"].values[both] == pytest.approx(plain["brdf"].values[both], rel=1e-6)
    relative = np.hypot(found["brdf_u_path"].values, found["brdf_u_reference"].values) / found["brdf"].values
    assert np.nanmax(relative[:, [0, 1, 3, 4]]) < 0.01
    assert np.nanmin(relative[1, 2]) > 0.03


def test_nothing_is_not_joined():
    with pytest.raises(CalibrationError, match="no arrangement"):
        joined([])


# --- the chart


def profile_of(place: int, level: float = 0.0, spectrum=0.0, cells=0.0, entrances=(10.0, 30.0), **attrs) -> xr.Dataset:
    """The profile of a day, its scales changed by logarithms of all, of each wavelength and of each cell."""
    told = {"day": f"2026-03-{place + 1:02d}", **attrs}
    etalon = reduced("etalon", entrances, efficiency=np.exp(-level - np.asarray(cells)), **told)
    etalon["signal"] = etalon["signal"] * np.exp(-np.broadcast_to(spectrum, WAVELENGTHS.shape))[:, None]
    return calibrate(etalon, certificate(), name=f"bench-{place + 1}")


def chain(*told: dict[str, object] | float) -> xr.Dataset:
    """The last of several profiles, each with the one before it as previous; a number is a change of the level."""
    given = [each if isinstance(each, dict) else {"level": each} for each in told]
    return functools.reduce(
        lambda previous, profile: charted(profile, previous),
        [profile_of(place, **each) for place, each in enumerate(given)],
    )


STEADY = (0.0, 0.003, -0.004, 0.001, 0.002)


def test_the_chart_tells_a_step_from_scatter():
    found = chain(*STEADY, 0.08)
    assert found["profile"].values.tolist() == [f"bench-{number}" for number in range(1, 7)]
    assert found["profile_day"].values.tolist() == [f"2026-03-0{number}" for number in range(1, 7)]
    assert found["scale_change"].values == pytest.approx(np.tile([*STEADY, 0.08], (5, 1)).T, abs=1e-9)
    level = found.sel(watched="level")
    before = [0.0, *(np.mean(STEADY[:count]) for count in range(1, 6))]
    assert level["change"].values == pytest.approx(np.subtract([*STEADY, 0.08], before), abs=1e-9)
    assert level["violation"].values.tolist() == [False] * 5 + [True]
    assert not found.sel(watched="spectrum")["violation"].values.any()


def test_the_limit_is_that_of_a_prediction_from_those_before_and_from_what_is_expected():
    """Three expected values of a scatter of 1 %, and the sum of squares of four seen with three degrees of freedom."""
    found = chain(*STEADY)
    seen = np.array(STEADY[:4])
    scatter = np.sqrt((3 * 0.01**2 + ((seen - seen.mean()) ** 2).sum()) / 6)
    assert found.sel(watched="level")["limit"].values[-1] == pytest.approx(3 * scatter * np.sqrt(1 + 1 / 4), rel=1e-6)
    assert np.isnan(found["limit"].values[0]).all()
    # One of five is beyond 3.4602 standard deviations as seldom as one alone is beyond 3: Φ(−3) / 5 = 2.70e-4 = Φ(−3.4602).
    expected = 3.4602 * 0.003 * np.sqrt(3 / 6) * np.sqrt(1 + 1 / 4)
    assert found.sel(watched="spectrum")["limit"].values[-1] == pytest.approx(expected, rel=1e-3)


def test_an_alarm_is_as_seldom_false_as_it_promises():
    """A rig of exactly the scatter that is expected of one: over many charts the first comparison is false in 0.27 % of them."""
    random = np.random.default_rng(0)
    z = random.normal(0, 0.01, (200_000, 2))
    limit = float(chain(0.0, 0.001).sel(watched="level")["limit"][-1])
    assert np.mean(np.abs(z[:, 1] - z[:, 0]) > limit) == pytest.approx(0.0027, rel=0.15)


def test_a_profile_that_the_chart_forbids_is_not_used_unless_overridden_and_recorded():
    marked = chain(0.0, 0.003, -0.004, 0.08)
    assert "differs by +8.4% from those before" in marked.attrs["drift_violation"]
    sample = reduced("sample", day="2026-03-05")
    with pytest.raises(CalibrationError, match="etalon is dirty or aged"):
        apply(sample, marked)
    found = apply(sample, marked, override=True)
    assert "dirty or aged" in found.attrs["overridden"]
    assert "drift_violation" not in chain(0.0, 0.003, -0.004).attrs


def test_an_etalon_that_turned_yellow_is_told_though_the_mean_hides_it():
    """3 % of the light lost at one end is won at the other: of all wavelengths together nothing changed."""
    found = chain(0.0, 0.002, -0.001, {"spectrum": [0.03, 0.01, 0.0, -0.015, -0.025]})
    assert found["violation"].values[-1].tolist() == [False, True]
    assert "differs by +3.0% more at 430 nm than at all wavelengths together" in found.attrs["drift_violation"]
    assert found["departing_wavelength"].values[-1] == 430
    with pytest.raises(CalibrationError, match="430 nm"):
        apply(reduced("sample", day="2026-03-05"), found)


def test_a_violation_is_no_part_of_what_later_ones_are_held_against():
    found = chain(*STEADY, 0.08, 0.001)
    assert found.sel(watched="level")["violation"].values.tolist() == [False] * 5 + [True, False]
    assert found.sel(watched="level")["change"].values[-1] == pytest.approx(0.001 - np.mean(STEADY), abs=1e-9)
    assert "drift_violation" not in found.attrs


def test_cells_that_changed_are_named_and_the_profile_is_good():
    """That is what a new profile is for; but a fibre that was moved, or exchanged for another, changes too."""
    cells = np.zeros(80)
    seen = np.flatnonzero(np.isfinite(profile_of(0)["cell_scale"].values).all(axis=0))
    cells[seen[[3, 8]]] = 0.5, -0.1
    found = chain(0.0, {"cells": cells})
    (warning,) = vocabulary.warnings(found)
    assert f"2 cells changed against the others since bench-1: F{seen[3]} by -39%, F{seen[8]} by +11%;" in warning
    assert "drift_violation" not in found.attrs
    assert found["scale_change"].values[-1] == pytest.approx(np.zeros(5), abs=1e-9)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000))
def test_cells_that_differ_by_their_noise_are_not_named(seed):
    random = np.random.default_rng(seed)
    one, other = (profile_of(place) for place in range(2))
    for profile in (one, other):
        u = (profile["cell_scale_u_calibration"] / profile["cell_scale"]).values
        profile["cell_scale"] = profile["cell_scale"] * np.exp(u * random.standard_normal(u.shape))
    assert vocabulary.warnings(charted(other, one)) == []


def test_a_scattering_rig_has_wider_limits():
    steady, wild = (chain(*(np.array([1, -1, 1, -1, 1, -1]) * size)) for size in (1e-3, 0.02))
    assert wild["limit"].values[-1, 0] > 1.5 * steady["limit"].values[-1, 0]


def test_the_chart_goes_on_through_another_first_entrance_and_with_other_wavelengths():
    """Scales are as through the first entrance, which sends 10 % less light here; that is no change of the rig."""
    through = chain(0.0, {"entrances": (0.0, 10.0, 30.0)}, {"level": 0.001, "entrances": (0.0, 10.0)})
    assert through["scale_change"].values[:, 0] == pytest.approx([0, 0, 0.001], abs=1e-9)
    fewer = profile_of(3).sel(wavelength=[430.0, 550.0])
    found = charted(profile_of(4, 0.002), charted(fewer, through))
    assert np.isfinite(found["scale_change"].values).all(axis=0).tolist() == [True, False, False, True, False]
    assert found["change"].sel(watched="level").values[-1] == pytest.approx(0.002 - 0.001 / 4, abs=1e-9)


def test_a_first_profile_begins_a_chart_and_violates_nothing():
    one = calibrate(reduced("etalon"), certificate())
    assert one["profile"].values.tolist() == ["2026-03-01"]
    assert not one["violation"].values.any()
    assert one["scale_change"].values == pytest.approx(np.zeros((1, 5)))


@pytest.mark.parametrize(
    ("previous", "words"),
    [
        ({"rig_digest": "other"}, "bench-1 of 2026-03-01, is of other optics.*drop `previous`"),
        ({"day": "2026-03-09"}, "bench-1 of 2026-03-09, was measured after this one"),
        ({"entrances": (60.0,)}, "other entrances.*`etalon_entrances`"),
    ],
)
def test_profiles_that_make_no_chart_say_what_to_do(previous, words):
    with pytest.raises(CalibrationError, match=words):
        charted(profile_of(1), profile_of(0, **previous))


def test_profiles_of_other_wavelengths_make_no_chart():
    with pytest.raises(CalibrationError, match="no wavelength, or no cell, in common"):
        charted(profile_of(1).isel(wavelength=[0, 1]), profile_of(0).isel(wavelength=[2, 3]))


def test_a_chart_is_kept_in_the_file_of_the_last_profile(tmp_path):
    found = chain(*STEADY)
    store.save_dataset(found, tmp_path / "bench-5.nc", stage="calibration", material="calibrations.bench-5")
    kept = store.open_dataset(tmp_path / "bench-5.nc", "calibration")
    xr.testing.assert_equal(charted(profile_of(5), kept)["change"], charted(profile_of(5), found)["change"])


# --- the chain


def test_emulated_frames_give_the_truth_within_its_uncertainty():
    truth = "plastic, 10 sr⁻¹, 3°"
    profile = calibrate(rig_emulated.reduced("etalon"), accuracy.certificate())
    found = accuracy.compared(apply(rig_emulated.reduced("sample"), profile), accuracy.TRUTHS[truth]())
    assert np.median(np.abs(found.on(disc=False))) < 0.012
    assert np.median(np.abs(found.on(disc=True))) < 0.012
    assert np.percentile(np.abs(found.on(disc=True)), 95) < 0.03
    assert np.sqrt(np.mean(found.z**2)) < 1.6
