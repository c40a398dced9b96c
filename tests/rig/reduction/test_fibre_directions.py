"""Directions of fibres from a turned mirror."""

from __future__ import annotations

import numpy as np
import pytest

from brdfpipe.geometry import angles_of, unit_vector
from brdfpipe.rig.reduction.fibre_directions import fit_directions
from brdfpipe.rig.turned_mirror import grid, normal_angles, normals, towards_light

ENTRANCE = 10.0


def aims() -> tuple[np.ndarray, np.ndarray]:
    return np.array(grid(20.0, 80.0)).T[0], np.array(grid(20.0, 80.0)).T[1]


def angle(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Degrees between unit vectors."""
    return np.degrees(2 * np.arcsin(np.linalg.norm(one - other, axis=1) / 2))


def signals(direction: np.ndarray, seed: int, *, noise: float = 0.005, width: float = 0.1) -> np.ndarray:
    """Light (aim, cell) of a lobe that is neither Gaussian nor that of the emulator, of cells that differ in sensitivity."""
    random = np.random.default_rng(seed)
    normal, light = normals(ENTRANCE, *aims()), towards_light(ENTRANCE)
    half = direction + light
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    tangent = np.tan(np.arccos(np.clip(normal @ half.T, 0.05, 1)))
    lobe = 1 / np.cosh(1.3 * tangent / width)
    sensitivity = np.exp(0.2 * random.standard_normal(len(direction)))
    return lobe * sensitivity / (normal @ light)[:, None] * (1 + noise * random.standard_normal(lobe.shape))


@pytest.mark.parametrize("off", [0.3, 0.7])
def test_directions_are_recovered_to_a_tenth_of_a_degree(off):
    random = np.random.default_rng(1)
    fibres = 40
    theta = np.concatenate([np.linspace(15, 75, fibres), np.linspace(1, 9, 20)])
    phi = np.arange(theta.size) * 137.5 % 360
    fixed = np.arange(theta.size) >= fibres
    aside = random.standard_normal((theta.size, 3))
    described = unit_vector(theta, phi)
    aside -= (aside * described).sum(axis=1, keepdims=True) * described
    true = (
        described
        + np.where(fixed, 0, np.tan(np.radians(off)))[:, None] * aside / np.linalg.norm(aside, axis=1)[:, None]
    )
    true /= np.linalg.norm(true, axis=1, keepdims=True)
    signal = signals(true, 2)
    found = fit_directions(ENTRANCE, aims(), (theta, phi), fixed, signal, 0.005 * signal)
    error = angle(unit_vector(found.theta_s, found.phi_s), true)[:fibres]
    known = found.found[:fibres]
    assert known.mean() > 0.9
    assert np.sqrt((error[known] ** 2).mean()) < 0.1
    assert np.sqrt((angle(described, true)[:fibres][known] ** 2).mean()) == pytest.approx(off, rel=1e-3)
    assert 0.4 < np.sqrt(((error / found.u[:fibres])[known] ** 2).mean()) < 1.4


def test_a_turned_mount_is_no_move_of_the_fibres():
    """The cells of the disc tie the mount to the mirror direction."""
    theta, phi = np.concatenate([np.linspace(15, 75, 40), np.linspace(1, 9, 20)]), np.arange(60) * 137.5 % 360
    axis = np.radians(0.3) * np.array([0.6, 0.8, 0.0])
    true = unit_vector(theta, phi)
    # Turning mirror, light and cells together changes nothing: cells turned the other way stand for a turned mirror with turned light.
    turned = true + np.cross(axis, true)
    signal = signals(true, 3)
    found = fit_directions(ENTRANCE, aims(), angles_of(turned), np.arange(60) >= 40, signal, 0.005 * signal)
    error = angle(unit_vector(found.theta_s, found.phi_s), turned / np.linalg.norm(turned, axis=1, keepdims=True))[:40]
    assert 0.05 < found.turn < 0.6
    assert np.sqrt(np.nanmean(error[found.found[:40]] ** 2)) < 0.3


def test_a_fibre_without_light_stays_where_it_is_described():
    theta, phi = np.linspace(5, 60, 30), np.arange(30) * 137.5 % 360
    signal = signals(unit_vector(theta, phi), 4)
    signal[:, 7] = np.nan
    found = fit_directions(ENTRANCE, aims(), (theta, phi), theta < 10, signal, 0.005 * signal)
    assert not found.found[7]
    assert (found.theta_s[7], found.phi_s[7]) == (theta[7], phi[7])
    with pytest.raises(ValueError, match="no fibre is lit"):
        fit_directions(ENTRANCE, aims(), (theta, phi), theta < 10, np.full_like(signal, np.nan), signal)


def test_the_normal_of_the_mirror_halves_light_and_aim():
    assert normal_angles(10.0, (0.0, 0.0)) == pytest.approx((10.0, 0.0))
    assert normal_angles(10.0, (20.0, 0.0)) == pytest.approx((20.0, 0.0))
    assert normal_angles(10.0, (60.0, 180.0)) == pytest.approx((20.0, 180.0))


def test_a_grid_has_neighbours_of_its_step():
    points = unit_vector(*np.array(grid(15.0, 90.0)).T)
    nearest = np.sort(np.degrees(np.arccos(np.clip(points @ points.T, -1, 1))), axis=1)[:, 1]
    assert 10 < nearest.min() <= nearest.max() < 20
