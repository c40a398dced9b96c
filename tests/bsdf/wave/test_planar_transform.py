"""The halo of a surface with a lay: its table, its spectrum from a map, and whole BSDFs."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import relief_maps
import samples
import xarray as xr
from mirror_halo import halo_of_mirrors
from scipy.ndimage import map_coordinates

from brdfpipe import appearance, facets, psd, store, vocabulary
from brdfpipe.bsdf import summary, wave
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.wave import height_transform
from brdfpipe.bsdf.wave.builder import LAY_ENERGY_NODES, _directions
from brdfpipe.bsdf.wave.halo import Stretch
from brdfpipe.bsdf.wave.planar_transform import spectrum_with_lay, tabulated
from brdfpipe.bsdf.wave.two_scale import RoughSurface

LENGTH, RATIO, LAY = 5.0, 2.0, 30.0
"""Geometric mean of both correlation lengths of a Gaussian surface [um], the longer over it, and its azimuth [degree]."""


def elliptic(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return height_transform.gaussian(LENGTH).spectrum(Stretch(LAY, RATIO)(x, y)[0])


def ridges(sigma: float, seed: int, size: int = 256, pitch: float = 0.5) -> xr.Dataset:
    """A periodic Gaussian map, 10 um long along the lay of 30 degree and 2.5 um across it."""
    f = np.fft.fftfreq(size, pitch)
    spectrum = sigma**2 * elliptic(f, f[:, None])
    return samples.surface(relief_maps.of_spectrum(spectrum, pitch, seed), (pitch, pitch))


def test_an_elliptic_spectrum_is_an_isotropic_one_in_the_stretched_plane():
    table = tabulated(elliptic, Stretch(LAY, RATIO), LENGTH, 300.0, 2.0)
    assert table.nbytes < 50e6
    for row in range(0, table.sizes["phase_variance"] - 5, 12):
        g = float(table["phase_variance"][row])
        expected = height_transform._by_series(height_transform.gaussian(LENGTH), g, table["halo_frequency"].values)
        lobe = expected > expected.max() - np.log(1e4)
        # Towards frequency 0 the table holds its value at the first node, 1e-4 off.
        assert table["log_halo"].values[row, lobe] == pytest.approx(
            np.repeat(expected[lobe, None], table.sizes["halo_azimuth"], axis=1), abs=2e-4
        )


@pytest.mark.parametrize("g", [0.5, 4.0, 30.0])
def test_crossing_ridges_are_those_of_a_transform_over_the_plane(g):
    def crossing(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return (elliptic(x, y) + elliptic(y, -x)) / 2

    table = tabulated(crossing, Stretch(LAY, 1.0), LENGTH, 100.0, 1.0)
    size, pitch = 512, 0.4
    f = np.fft.fftfreq(size, pitch)
    rho = np.fft.ifft2(crossing(f, f[:, None])).real / pitch**2
    expected = np.fft.fftshift(np.fft.fft2(np.exp(g * rho - g) - np.exp(-g)).real) * pitch**2 / g
    row = int(np.abs(table["phase_variance"].values - g).argmin())
    at = np.log(g / table["phase_variance"].values[0]) / np.log(
        table["phase_variance"].values[1] / table["phase_variance"].values[0]
    )
    assert abs(at - row) < 0.6
    radius = table["halo_frequency"].values
    turn = np.radians(table["halo_azimuth"].values + LAY)
    x, y = radius[:, None] * np.cos(turn), radius[:, None] * np.sin(turn)
    inside = radius < 0.15
    place = [np.full(x[inside].shape, at), *np.meshgrid(np.flatnonzero(inside), np.arange(turn.size), indexing="ij")]
    found = np.exp(map_coordinates(table["log_halo"].values, place, order=3, mode="nearest"))
    step = 1 / (size * pitch)
    grid = [size // 2 + y[inside] / step, size // 2 + x[inside] / step]
    # Smoothing around the ring widens crossing ridges a little.
    assert found == pytest.approx(map_coordinates(expected, grid, order=3), abs=0.02 * expected.max())


def test_a_map_gives_the_azimuth_and_the_width_of_its_lay():
    spectrum = psd.estimate(ridges(0.1, seed=1))
    assert "psd_planar" in spectrum
    from brdfpipe.bsdf.wave.roughness import roughness

    _, stretch = spectrum_with_lay(spectrum, roughness(spectrum)[0])
    assert stretch.lay == pytest.approx(LAY, abs=3)
    assert stretch.ratio == pytest.approx(RATIO, rel=0.1)


@cache
def with_lay(sigma: float) -> tuple[xr.Dataset, xr.Dataset]:
    """BSDF of ridges, and their facets."""
    surface = ridges(sigma, seed=1)
    found = facets.estimate(surface)
    return wave.build(psd.estimate(surface), facets=found, index=1.5, wavelength=550.0, optics="auto"), found


def elliptic_spectrum(sigma: float) -> xr.Dataset:
    """A spectrum like a measured one, of the elliptic surface, to 1 um-1."""
    frequency = np.geomspace(2e-3, 1.0, 200)
    turn = np.radians(np.arange(720) / 4)
    mean = sigma**2 * elliptic(frequency[:, None] * np.cos(turn), frequency[:, None] * np.sin(turn)).mean(axis=1)
    half = 2e-3 * np.sinh(np.linspace(0, np.arcsinh(500.0), 33))
    axis = np.concatenate([-half[:0:-1], half])
    planar = sigma**2 * elliptic(*np.meshgrid(axis, axis))
    known = psd.analytic("gaussian", sigma=sigma, length=LENGTH).drop_dims("frequency")
    result = known.assign(
        psd=("frequency", mean), psd_uncertainty=("frequency", 0 * mean), band_low=2e-3, band_high=1.0
    )
    result = result.assign(psd_planar=(("frequency_y", "frequency_x"), planar))
    result = result.assign_coords(frequency=frequency, frequency_x=axis, frequency_y=axis)
    result.attrs = known.attrs | {"form": "measured", "method": "a test"}
    return vocabulary.label(result, "psd")


@pytest.mark.parametrize(("azimuth", "length"), [(LAY, LENGTH * RATIO), (LAY + 90, LENGTH / RATIO)])
def test_waves_along_and_across_a_lay_have_their_own_halo(azimuth, length):
    bsdf = wave.build(elliptic_spectrum(0.05), index=1.5, wavelength=550.0)
    assert not representation(bsdf).isotropic
    assert representation(bsdf).lay == pytest.approx(LAY, abs=0.5)
    view = np.array([18.5, 19.25, 20.75, 21.5])
    found = bsdf.bsdf.evaluate(20.0, azimuth, view, azimuth + 180).values.squeeze()
    # In this plane of incidence the halo of an elliptic spectrum is that of one length, but for the area of the ellipse.
    equal = wave.build(psd.analytic("gaussian", sigma=float(bsdf["sigma"]), length=length), index=1.5, wavelength=550.0)
    expected = (LENGTH / length) ** 2 * equal.bsdf.evaluate(20.0, 0.0, view, 180.0).values.squeeze()
    # The 65 nodes of the spectrum on either axis, and its smoothing.
    assert found == pytest.approx(expected, rel=0.06)


@pytest.mark.slow
def test_rough_ridges_reflect_as_their_facets():
    bsdf, found = with_lay(0.2)
    from brdfpipe.bsdf import microfacet

    of_facets = microfacet.build(found, index=1.5, multiple_scattering="none")
    for azimuth in (LAY, LAY + 90):
        units = [appearance.gloss(each, [20], azimuth=azimuth).values for each in (bsdf, of_facets)]
        # The phase variance is 18: the next order of geometrical optics is 1/g.
        assert units[0] == pytest.approx(units[1], rel=0.12)


@pytest.fixture(scope="module")
def low_ridges(made_once) -> xr.Dataset:
    """BSDF of ridges of 0.06 um, which takes 12 s."""

    def make(folder: Path) -> None:
        store.save_dataset(with_lay(0.06)[0], folder / "bsdf.nc", stage="wave", material="ridges")

    return store.open_dataset(made_once("low-ridges", make) / "bsdf.nc")


@pytest.mark.parametrize("sigma", [0.06, pytest.param(0.2, marks=pytest.mark.slow)])
def test_every_check_of_a_surface_with_a_lay_passes(sigma, low_ridges):
    bsdf = low_ridges if sigma == 0.06 else with_lay(sigma)[0]
    checked = bsdf.bsdf.check()
    assert {verdict["verdict"] for verdict in json.loads(checked.attrs["verdicts"]).values()} == {"pass"}


def test_the_lay_is_that_of_the_facets_everywhere(low_ridges):
    lay = float(facets.estimate(ridges(0.06, seed=1))["lay"])
    # The roughness spectrum has another, by half a degree.
    assert float(low_ridges["halo_lay"]) != pytest.approx(lay, abs=0.1)
    assert representation(low_ridges).lay == pytest.approx(lay, abs=1e-9)
    assert float(appearance.compute_appearance(low_ridges, parts=("gloss",))["lay"]) == pytest.approx(lay, abs=1e-9)
    assert summary.properties(low_ridges)["lay"] == f"{round(lay, 1):g}°"


@pytest.mark.parametrize("theta", [70.0, 85.0, 88.5])
def test_a_perfect_mirror_with_a_lay_returns_all_light_of_every_azimuth(theta, low_ridges):
    bsdf, wavelength = low_ridges, np.array([550.0])
    surface = RoughSurface.of(bsdf)
    closure, cosine = surface.closure, np.cos(np.radians(theta))
    assert closure is not None
    azimuths = LAY + np.array([0.0, 10.0, 30.0, 60.0, 90.0, 200.0, 230.0, 270.0])
    for azimuth, (weight, angles) in zip(azimuths, _directions(bsdf, azimuths, LAY_ENERGY_NODES)(theta), strict=True):
        halo = halo_of_mirrors(surface, angles, wavelength)[:, 0, :2].sum(axis=-1)
        factor = closure.of_halo(np.cos(np.radians(angles[2])), angles[3], wavelength)[:, 0]
        at = np.array([cosine]), np.array([azimuth]), wavelength
        coherent = closure.coherent_share(*at).item()
        # What docs/model.md states between the incidences at which the energy is closed.
        assert closure.of_halo(*at).item() * (weight * factor) @ halo + coherent == pytest.approx(1, abs=2e-3)


def test_facets_without_a_lay_average_the_halo():
    surface = ridges(0.06, seed=1)
    found = facets.estimate(surface, isotropic=True)
    bsdf = wave.build(psd.estimate(surface), facets=found, index=1.5, wavelength=550.0, optics="auto")
    assert representation(bsdf).isotropic


@pytest.mark.slow
@pytest.mark.parametrize(
    ("anisotropy", "sigma"),
    [
        (24.0, 0.2),
        *((anisotropy, sigma) for anisotropy in (1.5, 4.0, 12.0, 30.0) for sigma in (0.06, 0.2, 0.5)),
    ],
)
def test_the_reflectance_of_a_strong_lay_is_that_of_its_brdf_and_the_given_one(anisotropy, sigma):
    f = np.fft.fftfreq(256, 0.5)
    length = 2.5 * np.sqrt(anisotropy)
    turned = Stretch(LAY, np.sqrt(anisotropy))(f, f[:, None])[0]
    spectrum = sigma**2 * height_transform.gaussian(length).spectrum(turned)
    surface = samples.surface(relief_maps.of_spectrum(spectrum, 0.5, 1), (0.5, 0.5))
    found = facets.estimate(surface, isotropic=False)
    given = vocabulary.label(samples.spectrum(0.06).sel(wavelength=[550.0]), "spectrum")
    with samples.coarse_albedo_tables():
        bsdf = wave.build(psd.estimate(surface), facets=found, index=1.5, spectrum=given, optics="auto")
    # Light from the normal has no azimuth.
    assert bsdf["directional_albedo"].sel(theta_i=slice(0, 89.99)).max() < 1
    around = bsdf.bsdf.albedo(theta_i=0.0, phi_i=np.arange(0.0, 360.0, 15.0), wavelength=550.0).values
    assert np.ptp(around) < 1e-9
    model, nm = representation(bsdf), np.array([550.0])
    for theta, phi in ((0.0, 0.0), (8.0, LAY), (8.0, LAY + 90), (45.0, LAY + 30)):
        at = np.array([theta]), np.array([phi])
        expected = model.integrate(*at, nm, relative=1e-4).value + model.specular(*at, nm)[0]
        assert model.albedo(*at, nm) == pytest.approx(expected, abs=1e-3)
    eight = bsdf.bsdf.albedo(theta_i=8.0, phi_i=np.arange(0.0, 360.0, 45.0), wavelength=550.0).values
    assert eight.mean() == pytest.approx(0.06, abs=1e-9)
    assert around == pytest.approx(0.06, abs=1e-3)
