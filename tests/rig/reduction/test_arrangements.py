"""Arrangements of one load joined into one dataset."""

from __future__ import annotations

import numpy as np
import pytest
from rig_reduced import WAVELENGTHS, above, brdf_of, certificate, directions, reduced

from brdfpipe import specular_directions, vocabulary
from brdfpipe.rig.reduction.arrangements import CalibrationError, join_arrangements
from brdfpipe.rig.reduction.calibration import calibrate
from brdfpipe.rig.reduction.primary import apply_profile


def test_arrangements_are_joined_by_rising_incidence_with_each_warning_once():
    late, early = (
        vocabulary.add_warning(reduced("sample", (incidence,)), "the same", f"of {incidence:g}")
        for incidence in (30.0, 10.0)
    )
    joined = join_arrangements([late, early])
    assert joined["incidence"].values.tolist() == [10.0, 30.0]
    assert sorted(vocabulary.warnings(joined)) == ["of 10", "of 30", "the same"]
    assert joined["theta_s"].dims == ("cell",)
    assert joined["signal"].values[0] == pytest.approx(early["signal"].values[0])


@pytest.mark.parametrize("name", ["rig_digest", "load", "side", "filter"])
def test_arrangements_of_another_rig_load_side_or_filter_are_not_joined(name):
    one, other = reduced("sample", (10.0,)), reduced("sample", (30.0,)).assign_attrs({name: "another"})
    with pytest.raises(CalibrationError, match=f"differ in {name}"):
        join_arrangements([one, other])


def test_a_wavelength_that_one_arrangement_lacks_is_missing_there_and_named_in_a_warning():
    whole, holed = reduced("sample", (10.0,)), reduced("sample", (30.0,)).isel(wavelength=[0, 1, 3, 4])
    joined = join_arrangements([holed, whole])
    assert joined["wavelength"].values.tolist() == WAVELENGTHS.tolist()
    assert np.isnan(joined["signal"].values[1, 2]).all()
    assert (joined["signal_quality"].values[1, 2] == vocabulary.quality("missing")).all()
    assert joined["signal_quality"].dtype == np.int8
    assert joined["signal"].values[1, [0, 1, 3, 4]] == pytest.approx(holed["signal"].values[0])
    (warning,) = vocabulary.warnings(joined)
    assert "no usable frame at 30° at 510 nm" in warning
    assert "`brdfpipe rig scan … --resume`" in warning
    primary, plain = brdf_of(joined), brdf_of(join_arrangements([whole, reduced("sample", (30.0,))]))
    assert (primary["brdf_quality"].values[1, 2, above(30.0)] == vocabulary.quality("missing")).all()
    rest = np.ones(primary["brdf"].shape, dtype=bool)
    rest[1, 2] = False
    assert primary["brdf"].values[rest] == pytest.approx(plain["brdf"].values[rest], nan_ok=True)


@pytest.mark.parametrize("lost", [10.0, 30.0], ids=["the first entrance", "another entrance"])
def test_a_wavelength_the_etalon_lacks_through_one_entrance_is_interpolated(lost):
    """The light of the entrance there is interpolated over wavelength, with the uncertainty of an entrance without an etalon measurement."""
    parts = [
        reduced("etalon", (entrance,)).isel(wavelength=[0, 1, 3, 4] if entrance == lost else slice(None))
        for entrance in (10.0, 30.0)
    ]
    etalon = join_arrangements(parts)
    profile = calibrate(etalon, certificate())
    assert profile["wavelength"].values.tolist() == WAVELENGTHS.tolist()
    (warning,) = vocabulary.warnings(profile)
    assert "the etalon in reflection" in warning
    assert f"{lost:g}° at 510 nm" in warning
    primary = apply_profile(reduced("sample"), profile)
    plain = brdf_of(reduced("sample"))
    both = np.isfinite(primary["brdf"].values) & np.isfinite(plain["brdf"].values)
    others = specular_directions.cos_view_etalon(40.0 - lost, *directions()) > 0.11
    assert np.isfinite(primary["brdf"].values[:, 2])[
        np.array([others & above(incidence) for incidence in (10.0, 30.0)])
    ].all()
    # These paths are the same at all wavelengths.
    assert primary["brdf"].values[both] == pytest.approx(plain["brdf"].values[both], rel=1e-6)
    relative = np.hypot(primary["brdf_u_path"].values, primary["brdf_u_reference"].values) / primary["brdf"].values
    assert np.nanmax(relative[:, [0, 1, 3, 4]]) < 0.01
    assert np.nanmin(relative[1, 2]) > 0.03


def test_joining_no_arrangement_is_refused():
    with pytest.raises(CalibrationError, match="no arrangement"):
        join_arrangements([])
