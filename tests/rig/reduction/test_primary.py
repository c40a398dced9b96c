"""The primary BRDF in closed form: every factor of the reduced data is known; and profiles that are refused."""

from __future__ import annotations

from dataclasses import replace
from datetime import date

import numpy as np
import pytest
import rig_accuracy as accuracy
import rig_emulated
from hypothesis import given, settings
from hypothesis import strategies as st
from rig_reduced import NAMES, PATHS, WAVELENGTHS, above, brdf_of, certificate, directions, reduced, sample_brdf, shape

from brdfpipe import specular_directions, vocabulary
from brdfpipe.rig.reduction.arrangements import ENTRANCE_EXCLUSION_RADIUS, CalibrationError
from brdfpipe.rig.reduction.calibration import calibrate
from brdfpipe.rig.reduction.primary import apply_profile
from brdfpipe.rig.reduction.relative_light import COMPONENTS


def test_the_brdf_is_recovered_exactly():
    primary = brdf_of(reduced("sample"))
    vocabulary.validate(primary, "primary")
    for place, incidence in enumerate((10.0, 30.0)):
        seen = above(incidence)
        true = sample_brdf(incidence, *directions())
        assert primary["brdf"].values[place][:, seen] == pytest.approx(true[:, seen], rel=1e-9)


def test_the_published_example_of_both_cosines():
    """σ = 45, σ_st = 10, (20, 30): cos γ = 0.8739067326, cos ϑ_st = 0.9843279494."""
    cosine, facing = (
        specular_directions.cos_view(45.0, 20.0, 30.0),
        specular_directions.cos_view_etalon(10.0, 20.0, 30.0),
    )
    assert (cosine, facing) == pytest.approx((0.8739067326, 0.9843279494), abs=1e-10)
    etalon, sample = reduced("etalon", (10.0,)), reduced("sample", (45.0,))
    for dataset, signal in ((etalon, 3.0), (sample, 2.0)):
        dataset["theta_s"][0], dataset["phi_s"][0] = 20.0, 30.0
        dataset["signal"][..., 0] = signal
    primary = apply_profile(sample, calibrate(etalon, certificate()))
    angle = np.degrees(np.arccos(facing))
    f_st = 0.9 / np.pi * np.interp(angle, np.arange(0.0, 91.0), shape(np.arange(0.0, 91.0)))
    # What cells below the horizon see, nothing but rounding here, was taken off.
    assert primary["brdf"].values[0, :, 0] == pytest.approx(f_st * facing / cosine * 2 / 3, rel=1e-8)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_the_efficiency_of_a_cell_divides_out(seed):
    """What a cell's path does to light it does to the etalon's and to the sample's."""
    efficiency = np.random.default_rng(seed).uniform(0.3, 3.0, directions()[0].size)
    plain = brdf_of(reduced("sample"))
    bent = apply_profile(
        reduced("sample", efficiency=efficiency), calibrate(reduced("etalon", efficiency=efficiency), certificate())
    )
    for name in ("brdf", "brdf_u", *(f"brdf_u_{component}" for component in NAMES)):
        assert np.array_equal(np.isnan(plain[name].values), np.isnan(bent[name].values))
        valid = np.isfinite(plain[name].values)
        size = np.abs(plain["brdf"].values[valid])
        assert (np.abs(plain[name].values - bent[name].values)[valid] / size).max() < 1e-12


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_the_spectral_reflectance_of_an_entrances_mirrors_divides_out(seed):
    """Each entrance with a spectrum of its own, some percent up and down, the same for etalon and sample."""
    etalon, sample = reduced("etalon"), reduced("sample")
    plain = apply_profile(sample, calibrate(etalon, certificate()))
    spectra = np.random.default_rng(seed).uniform(0.95, 1.05, (2, WAVELENGTHS.size, 1))
    for dataset in (etalon, sample):
        for name in ("signal", *(f"signal_u_{component}" for component in COMPONENTS)):
            dataset[name] = dataset[name] * spectra
            dataset[name].attrs["correlation"] = COMPONENTS.get(name.removeprefix("signal_u_"), "")
    etalon, sample = (vocabulary.label(dataset, "reduced") for dataset in (etalon, sample))
    bent = apply_profile(sample, calibrate(etalon, certificate()))
    valid = np.isfinite(plain["brdf"].values)
    assert np.array_equal(valid, np.isfinite(bent["brdf"].values))
    assert bent["brdf"].values[valid] == pytest.approx(plain["brdf"].values[valid], rel=1e-9)


def test_an_entrance_without_an_etalon_measurement_has_an_uncertainty_of_five_percent():
    primary = brdf_of(reduced("sample", (10.0, 45.0)))
    relative = (primary["brdf_u_path"] / primary["brdf"]).values
    assert np.nanmedian(relative[0]) < 0.005
    assert np.nanmedian(relative[1]) == pytest.approx(0.05, rel=0.01)


def test_cells_below_the_horizon_or_grazing_the_etalon_are_missing_and_flagged():
    primary = apply_profile(reduced("sample", (60.0,)), calibrate(reduced("etalon", (10.0,)), certificate()))
    theta, phi = directions()
    shadowed = specular_directions.cos_view(60.0, theta, phi) <= 0
    grazed = (
        (specular_directions.cos_view_etalon(10.0, theta, phi) < 0.1)
        & ~shadowed
        & (specular_directions.cos_view(60.0, theta, phi) > 0.01)
    )
    quality = primary["brdf_quality"].values[0]
    assert shadowed.any()
    assert grazed.any()
    assert (quality[:, shadowed] == vocabulary.quality("shadowed")).all()
    assert (quality[:, grazed] == vocabulary.quality("vignetted")).all()
    assert np.isnan(primary["brdf"].values[0][:, shadowed | grazed]).all()


def test_a_dead_fibre_has_no_value():
    efficiency = np.ones(directions()[0].size)
    efficiency[7] = 1e-4
    profile = calibrate(reduced("etalon", efficiency=efficiency), certificate())
    assert np.isnan(profile["cell_scale"].values[:, 7]).all()
    assert np.isfinite(profile["cell_scale"].values[:, 6]).all()
    primary = apply_profile(reduced("sample", efficiency=efficiency), profile)
    assert np.isnan(primary["brdf"].values[:, :, 7]).all()
    assert (primary["brdf_quality"].values[:, :, 7] == vocabulary.quality("vignetted")).all()


@pytest.mark.parametrize("share", [1.0, 0.3], ids=["wholly", "partly"])
def test_a_cell_hidden_from_one_entrance_is_calibrated_through_the_others(share):
    def hidden(incidence):
        missing = np.zeros(directions()[0].size)
        missing[[3, 4]] = share if incidence == 30.0 else 0.0
        return missing

    profile = calibrate(reduced("etalon", (10.0, 30.0, 45.0), hidden=hidden), certificate())
    assert profile["hidden"].values[1].nonzero()[0].tolist() == [3, 4]
    assert not profile["hidden"].values[[0, 2]].any()
    primary = apply_profile(reduced("sample", (10.0, 30.0), hidden=hidden), profile)
    true = sample_brdf(10.0, *directions())
    assert primary["brdf"].values[0][:, 3] == pytest.approx(true[:, 3], rel=1e-6)
    assert np.isnan(primary["brdf"].values[1][:, [3, 4]]).all()
    assert profile["path"].values == pytest.approx(np.tile([[1.0], [1.08], [1.03]], (1, 5)), rel=1e-6)


def test_cells_near_an_entrance_without_an_etalon_measurement_are_excluded():
    profile = calibrate(reduced("etalon", (10.0, 30.0)), certificate())
    theta, phi = directions()
    near = specular_directions.cos_view_etalon(0.0, theta, phi) > np.cos(np.radians(ENTRANCE_EXCLUSION_RADIUS))
    assert near.any()
    primary = apply_profile(reduced("sample", (0.0,)), profile)
    assert np.isnan(primary["brdf"].values[0][:, near]).all()
    # Through a sample the light comes from behind.
    through = apply_profile(reduced("sample", (0.0,), side="transmission"), profile)
    assert np.isfinite(through["brdf"].values[0][:, near]).all()


def test_stray_light_is_measured_by_the_cells_below_the_horizon():
    sample = reduced("sample", (60.0,), stray=1e-3)
    primary = apply_profile(sample, calibrate(reduced("etalon", tuple(PATHS)), certificate()))
    assert primary.attrs["stray"] == pytest.approx([1e-3], rel=1e-3)
    assert 0 < primary.attrs["stray_u"][0] < 1e-4
    seen = above(60.0)
    true = sample_brdf(60.0, *directions())
    assert primary["brdf"].values[0][:, seen] == pytest.approx(true[:, seen], rel=1e-3)


def test_an_incidence_without_cells_below_the_horizon_takes_the_stray_light_of_the_others():
    sample = reduced("sample", (0.0, 60.0), stray=1e-3).sel(cell=above(0.0, 0.05) | ~above(60.0, -0.1))
    profile = calibrate(reduced("etalon", tuple(PATHS)), certificate()).sel(cell=sample["cell"])
    dark = specular_directions.cos_view(0.0, sample["theta_s"].values, sample["phi_s"].values) < -0.05
    assert (dark & np.isfinite(profile["cell_scale"].values[0])).sum() < 5
    primary = apply_profile(sample, profile)
    assert primary.attrs["stray"] == pytest.approx([1e-3, 1e-3], rel=2e-3)
    # As uncertain there as it is large.
    assert primary.attrs["stray_u"][0] == pytest.approx(1e-3, rel=0.01)
    assert primary.attrs["stray_u"][1] < 1e-4


def test_uncertainty_components_add_in_quadrature_and_state_their_correlation():
    primary = brdf_of(reduced("sample"))
    parts = [primary[f"brdf_u_{name}"].values for name in NAMES]
    assert np.sqrt(np.sum(np.square(parts), axis=0)) == pytest.approx(primary["brdf_u"].values, nan_ok=True)
    common = {name for name in NAMES if primary[f"brdf_u_{name}"].attrs["correlation"] == "common"}
    of_frames = {"repeat", "reference", "certificate", "etalon", "nd", "glare", "path", "stray"}
    assert common == of_frames | {"wavelength", "band", "polarisation", "linearity"}


def test_common_errors_of_the_etalon_stay_common():
    """The etalon's noise averages out over cells, its reference does not: neither may pass for the other."""
    etalon = reduced("etalon", (10.0,), relative=0.0)
    for name, size in (("noise", 0.01), ("geometry", 0.004), ("reference", 0.003), ("nd", 0.002), ("glare", 0.001)):
        etalon[f"signal_u_{name}"] = size * np.abs(etalon["signal"])
        etalon[f"signal_u_{name}"].attrs = {"units": "1", "correlation": COMPONENTS[name]}
    primary = apply_profile(reduced("sample", (10.0,), relative=0.0), calibrate(etalon, certificate(0.005)))
    seen = above(10.0)
    expected = {
        "calibration": np.hypot(0.01, 0.004),
        "reference": 0.003,
        "nd": 0.002,
        "certificate": 0.005,
        "repeat": 0.0,
    }
    for name, size in expected.items():
        relative = (primary[f"brdf_u_{name}"] / primary["brdf"]).values[0][:, seen]
        assert relative == pytest.approx(size, rel=1e-6, abs=1e-9), name


def test_the_etalons_angular_shape_has_the_certified_uncertainty_or_that_of_diffuse_standards():
    """An etalon whose BRDF decreases by 5 % towards 60°, with and without this ratio in its certificate."""
    etalon, sample = reduced("etalon", (10.0,), relative=1e-4), reduced("sample", (10.0,), relative=1e-4)
    stated = certificate()
    silent = replace(stated, theta=np.zeros(1), shape=np.ones(1), shape_u=np.zeros(1))
    theta = np.degrees(np.arccos(np.clip(specular_directions.cos_view_etalon(10.0, *directions()), 0, 1)))
    seen = above(10.0, 0.15) & (theta < 83)
    true = sample_brdf(10.0, *directions())[:, seen]
    # Cells below the horizon see nothing here.
    tilted = replace(stated, tilt_u=0.1)
    tangent = np.tan(np.radians(theta)) * np.radians(0.1) / np.sqrt(2)
    cases = (stated, 0 * theta, 0), (silent, 0.05 * (theta / 60) ** 2, 1), (tilted, tangent, 0)
    for certified, expected, warning_count in cases:
        primary = apply_profile(sample, calibrate(etalon, certified))
        level, shape = (
            (primary[f"brdf_u_{name}"] / primary["brdf"]).values[0][:, seen] for name in ("certificate", "etalon")
        )
        assert level == pytest.approx(np.full(level.shape, 0.005), rel=1e-6)
        assert shape == pytest.approx(np.tile(expected[seen], (5, 1)), rel=1e-6, abs=1e-12)
        z = ((primary["brdf"].values[0][:, seen] - true) / primary["brdf_u"].values[0][:, seen])[:, theta[seen] > 30]
        assert np.abs(z).max() < 1.3
        warnings = vocabulary.warnings(calibrate(etalon, certified))
        assert len([text for text in warnings if "state `angles` in certificate.yaml" in text]) == warning_count


def test_common_errors_do_not_average_out_in_an_albedo():
    """1 % independent with 3 % common: the mean of many cells is uncertain by 3.0 %, not by 0.04 %."""
    sample, etalon = reduced("sample", (10.0,), relative=0.0), reduced("etalon", (10.0,), relative=0.0)
    sample["signal_u_noise"] = (0.01 * np.abs(sample["signal"])).assign_attrs(sample["signal_u_noise"].attrs)
    primary = apply_profile(sample, calibrate(etalon, certificate(0.03)))
    seen = above(10.0)
    value = primary["brdf"].values[0, 0, seen]
    independent = np.hypot(primary["brdf_u_noise"], primary["brdf_u_calibration"]).values[0, 0, seen]
    common = primary["brdf_u_certificate"].values[0, 0, seen]
    mean_u = np.hypot(np.sqrt((independent**2).sum()), common.sum()) / value.sum()
    assert mean_u == pytest.approx(np.hypot(0.03, 0.01 / np.sqrt(seen.sum())), rel=0.02)


def test_the_stated_noise_of_etalon_and_sample_is_the_observed_one():
    """Monte Carlo: every run with another noise."""
    z = []
    for seed in range(60):
        random = np.random.default_rng(seed)
        etalon, sample = reduced("etalon", (10.0, 30.0), relative=0.01), reduced("sample", (10.0,), relative=0.01)
        for dataset in (etalon, sample):
            noise = dataset["signal_u_noise"].values * random.standard_normal(dataset["signal"].shape)
            dataset["signal"] = dataset["signal"] + noise
        primary = apply_profile(sample, calibrate(etalon, certificate()))
        seen = above(10.0)
        error = primary["brdf"].values[0][:, seen] - sample_brdf(10.0, *directions())[:, seen]
        own = primary["brdf_u_calibration"].values[0][:, seen]
        # The etalon's geometry counts as 1 % too, and was not drawn.
        u = np.hypot(primary["brdf_u_noise"].values[0][:, seen], own / np.sqrt(2))
        z.append(error / u)
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1, abs=0.05)


def test_other_filters_than_the_etalons_add_their_uncertainty():
    same, other = (brdf_of(reduced("sample", filter=place, filter_u=u)) for place, u in ((1, 0.0), (2, 0.02)))
    relative = (other["brdf_u_nd"] / other["brdf"]).values
    assert np.nanmedian(relative) == pytest.approx(0.02, rel=0.02)
    assert np.nanmedian((same["brdf_u_nd"] / same["brdf"]).values) < 0.002


def test_a_profile_expires_after_its_days():
    profile = calibrate(reduced("etalon"), certificate(), valid_days=90)
    apply_profile(reduced("sample", day="2026-05-30"), profile)
    with pytest.raises(CalibrationError, match="has expired: it is 91 days old"):
        apply_profile(reduced("sample", day="2026-05-31"), profile)
    with pytest.raises(CalibrationError, match="after the sample was measured"):
        apply_profile(reduced("sample", day="2026-02-28"), profile)


def test_a_profile_expires_after_its_lamp_hours():
    profile = calibrate(reduced("etalon"), certificate(), lamp_hours=100.0, valid_hours=50.0)
    apply_profile(reduced("sample"), profile, lamp_hours=150.0)
    with pytest.raises(CalibrationError, match="lamp has run 51 h since"):
        apply_profile(reduced("sample"), profile, lamp_hours=151.0)
    with pytest.raises(CalibrationError, match="lamp was changed"):
        apply_profile(reduced("sample"), profile, lamp_hours=3.0)


def test_an_expired_certificate_is_refused_for_calibration_and_for_use():
    with pytest.raises(CalibrationError, match="was valid until 2026-02-28"):
        calibrate(reduced("etalon"), certificate(until=date(2026, 2, 28)))
    profile = calibrate(reduced("etalon"), certificate(until=date(2026, 3, 15)))
    with pytest.raises(CalibrationError, match="C-1 was valid until 2026-03-15"):
        apply_profile(reduced("sample", day="2026-03-16"), profile)


def test_an_override_is_recorded():
    stale = calibrate(reduced("etalon"), certificate(until=date(2026, 2, 28)), override=True)
    assert "valid until 2026-02-28" in stale.attrs["overridden"]
    primary = apply_profile(reduced("sample", day="2027-03-01"), stale, override=True)
    assert "has expired" in primary.attrs["overridden"]
    assert sum("used nevertheless" in warning for warning in vocabulary.warnings(primary)) == 2
    assert "overridden" not in brdf_of(reduced("sample")).attrs


@pytest.mark.parametrize("order", [[0, 2, 1, 3, 4], [4, 3, 2, 1, 0]], ids=["swapped", "reversed"])
def test_wavelengths_in_another_order_are_detected_by_the_lamps_spectrum(order):
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
        apply_profile(reduced("sample"), calibrate(etalon, certificate()))


def test_the_etalon_of_another_rig_is_refused():
    profile = calibrate(reduced("etalon", rig_digest="other", rig="bench-2"), certificate())
    with pytest.raises(CalibrationError, match=r"of another rig \(bench-2\)"):
        apply_profile(reduced("sample"), profile)


def test_other_cells_are_refused():
    profile = calibrate(reduced("etalon"), certificate())
    with pytest.raises(CalibrationError, match="different cells"):
        apply_profile(reduced("sample").isel(cell=slice(0, 70)), profile)


def test_a_profile_is_made_from_the_etalon_and_applied_to_the_sample():
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
        apply_profile(sample, calibrate(etalon, certificate()))


def test_whole_cells_of_zeros_are_refused_where_the_etalon_had_light():
    sample = reduced("sample")
    sample["signal"][:, :, [3, 20, 33, 47]] = 0.0
    with pytest.raises(CalibrationError, match="exactly 0"):
        brdf_of(sample)


def test_values_that_are_nan_leave_the_others_unchanged():
    sample = reduced("sample")
    lost = np.random.default_rng(0).random(sample["signal"].shape) < 0.05
    sample["signal"] = sample["signal"].where(~lost)
    primary, plain = brdf_of(sample), brdf_of(reduced("sample"))
    valid = np.isfinite(primary["brdf"].values)
    assert primary["brdf"].values[valid] == pytest.approx(plain["brdf"].values[valid])
    assert np.isnan(primary["brdf"].values[lost]).all()


def test_emulated_frames_reproduce_the_truth_within_its_uncertainty():
    truth = "plastic, 10 sr⁻¹, 3°"
    profile = calibrate(rig_emulated.reduced("etalon"), accuracy.certificate())
    measured = accuracy.compared(apply_profile(rig_emulated.reduced("sample"), profile), accuracy.TRUTHS[truth]())
    assert np.median(np.abs(measured.on(disc=False))) < 0.012
    assert np.median(np.abs(measured.on(disc=True))) < 0.012
    assert np.percentile(np.abs(measured.on(disc=True)), 95) < 0.03
    assert np.sqrt(np.mean(measured.z**2)) < 1.6
