"""Calibration profiles in closed form: every factor of the etalon's reduced data is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rig_reduced import PATHS, certificate, directions, reduced

from brdfpipe import specular_directions
from brdfpipe.rig.reduction.arrangements import CalibrationError
from brdfpipe.rig.reduction.calibration import calibrate


def test_the_light_of_an_entrance_follows_from_the_cells_it_shares():
    profile = calibrate(reduced("etalon", tuple(PATHS)), certificate())
    expected = np.array(list(PATHS.values())) / PATHS[0.0]
    assert profile["path"].values == pytest.approx(np.tile(expected[:, None], (1, 5)), rel=1e-9)
    assert (profile["path_u"].values[0] == 0).all()
    assert (profile["path_u"].values[1:] < 1e-3).all()
    assert not profile["hidden"].values.any()


def test_the_uncertainty_of_an_entrances_light_is_its_scatter_over_the_shared_cells():
    """Cells that scatter by 1 % give the path of each wavelength to 1 % over the root of their number."""
    etalon = reduced("etalon", relative=0.01)
    noise = np.random.default_rng(3).standard_normal(etalon["signal"].shape)
    etalon["signal"] = etalon["signal"] * (1 + 0.01 * np.sqrt(2) * noise)
    profile = calibrate(etalon, certificate())
    count = (
        (np.array([specular_directions.cos_view_etalon(entrance, *directions()) for entrance in (10.0, 30.0)]) > 0.1)
        .all(axis=0)
        .sum()
    )
    path, u = profile["path"].values[1], profile["path_u"].values[1]
    # Noise and geometry are independent from cell to cell, through both entrances.
    assert u / path == pytest.approx(0.02 / np.sqrt(count), rel=0.25)
    assert np.sqrt((((path - 1.08) / u) ** 2).mean()) < 2


def test_more_entrances_calibrate_more_cells_with_less_noise():
    one, all_ = (calibrate(reduced("etalon", entrances), certificate()) for entrances in ((10.0,), tuple(PATHS)))
    counted = [int(np.isfinite(profile["cell_scale"].values[0]).sum()) for profile in (one, all_)]
    assert counted[1] > counted[0]
    shared = np.isfinite(one["cell_scale"].values)
    ratio = (all_["cell_scale_u_calibration"] / all_["cell_scale"]).values[shared] / (
        one["cell_scale_u_calibration"] / one["cell_scale"]
    ).values[shared]
    assert ratio.max() <= 1
    assert ratio.min() == pytest.approx(1 / np.sqrt(5), rel=1e-4)


def test_a_wrong_angular_shape_of_the_etalon_is_within_the_uncertainty_of_the_entrances_light():
    """Cells see the etalon at other angles through another entrance: an error of its shape looks like more light."""
    silent = replace(certificate(), theta=np.zeros(1), shape=np.ones(1), shape_u=np.zeros(1))
    profile = calibrate(reduced("etalon", (10.0, 45.0)), silent)
    path, u = profile["path"].values[1], profile["path_u"].values[1]
    assert np.abs(path - 1.03).min() > 1e-3
    assert (np.abs(path - 1.03) / u).max() < 1.5


def test_a_wavelength_without_reference_light_is_left_out_of_the_profile():
    etalon = reduced("etalon")
    etalon["reference"][:, 2] = np.nan
    etalon["signal"][:, 2] = np.nan
    assert calibrate(etalon, certificate())["wavelength"].values.tolist() == [430.0, 470.0, 550.0, 650.0]
    etalon["reference"][:] = np.nan
    with pytest.raises(CalibrationError, match="no frame of the etalon shows the reference"):
        calibrate(etalon, certificate())
