"""The compiled halo, its table, polarisation factor and half vectors, and the light of waves and facets, against the arrays of numpy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from brdfpipe import facets
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.microfacet import evaluation_kernel
from brdfpipe.bsdf.representations.microfacet import Microfacet
from brdfpipe.bsdf.wave import halo_kernel, two_scale
from brdfpipe.bsdf.wave.halo import Halo, Stretch, amplitudes, polarisation_factor
from brdfpipe.bsdf.wave.two_scale import EnergyClosure, Relief, RoughSurface
from brdfpipe.facets.planar_density import Ellipse
from brdfpipe.geometry import HalfVector, half_vector


def directions(count: int = 400) -> tuple[np.ndarray, ...]:
    """Random pairs above the horizon, and some in the mirror direction and near grazing."""
    random = np.random.default_rng(2)
    theta = np.degrees(np.arccos(1 - random.random((2, count))))
    phi = random.uniform(-360, 360, (2, count))
    theta[:, :4], phi[:, :4] = [[0, 30, 89.9, 89.999], [0, 30, 89.9, 5]], [[0, 10, 0, 50], [0, 190, 180, 0]]
    return theta[0], phi[0], theta[1], phi[1]


def halo(form: str, stretch: Stretch | None) -> Halo:
    """A table of random coefficients, the last frequency of which many pairs exceed."""
    shape = (9, 12) if stretch is None else (9, 12, 14)
    spline = np.random.default_rng(3).normal(size=shape)
    return Halo(0.02, form, spline, -3.0, 0.4, 0.05, 0.25, None, stretch)


@pytest.mark.parametrize("form", ["ssa1", "rayleigh-rice"])
@pytest.mark.parametrize("stretch", [None, Stretch(30.0, 1.5)])
def test_the_table_is_read_as_by_scipy(form, stretch):
    numpy_halo, angles = halo(form, stretch), directions()
    pair, azimuths, wavelength = half_vector(*angles), (angles[1], angles[3]), np.array([400.0, 550.0, 700.0])
    expected = numpy_halo.strength(pair, azimuths, wavelength)
    found = replace(numpy_halo, compiled=True).strength(pair, azimuths, wavelength)
    # Half of the pairs are beyond the last frequency, where the table goes on as its mirror image.
    assert ((np.sqrt(pair.slope_squared) * (pair.cos_i + pair.cos_o) / 0.55) > 0.05 * np.sinh(0.25 * 11)).mean() > 0.5
    np.testing.assert_allclose(found, expected, rtol=1e-11)


@pytest.mark.parametrize("k", [0.0, 0.01, 3.0])
def test_the_polarisation_factor_is_that_of_the_amplitudes(k):
    angles, n = directions(), np.array([1.0, 1.3, 1.5, 2.5])
    n, k = (n, np.full(4, k)) if k < 1 else (np.append(n, 0.3), np.full(5, k))
    pair, azimuth = half_vector(*angles), angles[3] - angles[1]
    found = polarisation_factor(pair, azimuth, n, k, compiled=True)
    np.testing.assert_allclose(found, amplitudes(pair, azimuth, n, k).mean, rtol=1e-12, atol=1e-16)


@pytest.mark.parametrize("slope", [0.1, 0.3, 0.5])
def test_the_compiled_share_of_facets_is_that_of_numpy(slope):
    surface = RoughSurface(halo("ssa1", None), None, 0.3, slope, passage=10.0)
    cosines, wavelength = np.append(np.linspace(1e-6, 2.0, 50), 1e-12), np.array([400.0, 550.0, 700.0])
    found = halo_kernel.facet_share(surface.passage_of_pairs, cosines, wavelength)
    expected = two_scale.facet_share_at(0.3, slope, 10.0, cosines, wavelength)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)
    assert 0 == found.min() < found.max() == 1


def test_compiled_half_vectors_are_those_of_numpy():
    angles = directions()
    for name, found, expected in zip(
        HalfVector._fields, evaluation_kernel.half_vectors(*angles), half_vector(*angles), strict=True
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-16, err_msg=name)


def test_many_values_are_those_of_few(monkeypatch):
    surface = RoughSurface(halo("ssa1", None), None, 0.0, 0.0)
    arguments = directions(), np.array([550.0]), np.array([1.5]), np.zeros(1)
    few = surface.evaluate(*arguments)
    monkeypatch.setattr(two_scale, "MANY_HALO_VALUES", 1)
    np.testing.assert_allclose(surface.evaluate(*arguments), few, rtol=1e-11)


WAVELENGTH = np.array([400.0, 550.0, 700.0])


def rough_surface(
    *, lay: bool = False, form: str = "ssa1", fine: bool = False, further: str = "none", index: complex = 1.5
) -> RoughSurface:
    """Waves, facets and closed energy from tables of random numbers: in some directions a surface is one of facets alone, in others not."""
    random = np.random.default_rng(4)
    given = facets.analytic("beckmann", a_x=0.1, a_y=0.3) if lay else facets.analytic("ggx", 0.3)
    of_facets = Microfacet(
        microfacet.build(given, index={"n": index.real, "k": index.imag}, multiple_scattering=further)
    )
    waves = halo(form, Stretch(30.0, 1.5) if lay else None)
    waves = replace(waves, first_order=np.minimum(random.normal(-1.0, 0.7, waves.spline.shape), 0.1))
    shape = (7, 6, 2) if lay else (7, 2)
    factor = random.uniform(0.5, 2.0, shape)
    closure = EnergyClosure(factor, np.ones(shape), np.array([380.0, 780.0]), Ellipse(0.1, 0.3, 20.0) if lay else None)
    relief = Relief(of_facets, halo("ssa1", None) if fine else None, "height-correlated")
    return RoughSurface(waves, relief, 0.5, 0.3, 10.0, closure)


def check_against_numpy(surface: RoughSurface, index: complex = 1.5) -> np.ndarray:
    """The BRDF by compiled code, which is that of numpy, also of one direction and of one wavelength."""
    angles = directions()
    n, k = np.full(3, index.real), np.full(3, index.imag)
    found = replace(surface, compiled=True).evaluate(angles, WAVELENGTH, n, k)
    expected = surface.evaluate(angles, WAVELENGTH, n, k)
    # Above 89 degree numpy knows cosines to 1e-11 of their size.
    steep = np.maximum(angles[0], angles[2]) < 89
    np.testing.assert_allclose(found[steep], expected[steep], rtol=2e-12, atol=1e-16)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-16)
    for part in (slice(0, 1), slice(7, 8)):
        one = tuple(angle[part] for angle in angles)
        alone = replace(surface, compiled=True).evaluate(one, WAVELENGTH[1:2], n[1:2], k[1:2])
        np.testing.assert_allclose(alone, found[part, 1:2], rtol=1e-14)
    return found


@pytest.mark.parametrize("index", [1.5, 1 + 1e-9, 1.0, 1.2 + 4j, 0.2 + 3j])
@pytest.mark.parametrize("fine", [False, True])
def test_the_light_of_waves_and_facets_is_that_of_numpy(index, fine):
    surface = rough_surface(fine=fine, index=complex(index))
    pair = half_vector(*directions())
    share = surface.facet_share(pair.cos_i + pair.cos_o, WAVELENGTH)
    assert 0 == share.min() < share.max() == 1
    light = check_against_numpy(surface, complex(index))
    assert light.any() == (index != 1.0)


@pytest.mark.parametrize("further", ["compensated", "directional"])
def test_light_that_facets_reflect_more_than_once_is_that_of_numpy(further):
    once, light = (check_against_numpy(rough_surface(fine=True, further=name)) for name in ("none", further))
    assert (light >= once * (1 - 1e-12)).all()
    assert (light > 1.001 * once).any()


@pytest.mark.parametrize("lay", [False, True])
@pytest.mark.parametrize("form", ["ssa1", "ghs"])
def test_the_light_of_a_lay_and_of_other_theories_is_that_of_numpy(form, lay):
    check_against_numpy(rough_surface(form=form, lay=lay, fine=True))


@pytest.mark.parametrize("fine", [False, True])
def test_the_light_of_facets_alone_or_of_waves_alone_is_that_of_numpy(fine):
    surface = rough_surface(fine=fine)
    check_against_numpy(replace(surface, halo=None, closure=None))
    check_against_numpy(replace(surface, closure=None))
    flat = replace(surface, facet_sigma=1e-6)
    assert not flat.facet_share(np.linspace(0, 2, 9), WAVELENGTH).any()
    check_against_numpy(flat)


def test_other_maskings_are_those_of_numpy():
    surface = rough_surface(fine=True)
    assert surface.relief is not None
    check_against_numpy(replace(surface, relief=replace(surface.relief, masking="none")))
