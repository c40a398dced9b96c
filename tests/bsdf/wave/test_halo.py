"""The halo of wave optics: reference values, limits, reciprocity, positivity, polarisation, and SCATMECH."""

from __future__ import annotations

import hypothesis.strategies as st
import numpy as np
import pytest
import xarray as xr
from hypothesis import given

from brdfpipe import psd
from brdfpipe.bsdf import microfacet, wave
from brdfpipe.bsdf.microfacet.polarised import mueller as facet_mueller
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.wave.halo import Halo, amplitudes
from brdfpipe.facets import analytic
from brdfpipe.geometry import half_vector
from brdfpipe.hemisphere import around_mirror
from brdfpipe.masking.modes import HALOS
from brdfpipe.optics import fresnel

REFERENCE = """
    gaussian 5 0 0 1.86938e-03 1.86465e-03 2.59245e-03 2.58589e-03 2.59244e-03 2.58588e-03
    gaussian 5 2 0 9.89264e-02 9.80358e-02 9.68426e-02 9.59707e-02 9.68424e-02 9.59705e-02
    gaussian 5 5 0 9.18554e-01 9.00034e-01 8.60337e-01 8.42990e-01 8.60337e-01 8.42990e-01
    gaussian 5 6 0 7.18508e-01 7.01078e-01 6.74979e-01 6.58605e-01 6.74978e-01 6.58604e-01
    gaussian 5 8 0 1.01262e-01 9.79213e-02 9.90851e-02 9.58157e-02 9.90842e-02 9.58149e-02
    gaussian 5 10 0 2.06385e-03 1.97627e-03 2.80578e-03 2.68672e-03 2.80569e-03 2.68663e-03
    gaussian 5 15 0 3.37681e-11 3.14427e-11 2.36317e-07 2.20043e-07 2.36260e-07 2.19991e-07
    gaussian 5 30 0 4.00916e-61 3.34483e-61 1.05800e-19 8.82682e-20 1.05283e-19 8.78369e-20
    gaussian 5 5 90 3.80443e-06 3.80465e-06 4.69429e-05 4.69456e-05 4.69429e-05 4.69456e-05
    gaussian 5 30 90 4.92631e-92 5.35403e-92 9.35083e-25 1.01627e-24 9.30514e-25 1.01130e-24
    gaussian 5 20 180 5.27979e-66 5.37941e-66 2.07423e-20 2.11336e-20 2.07246e-20 2.11156e-20
    gaussian 45 30 0 6.53588e-16 1.68656e-16 2.00962e-09 5.18576e-10 1.98911e-09 5.13284e-10
    gaussian 45 40 0 3.57949e-02 4.89242e-03 3.64285e-02 4.97903e-03 3.63702e-02 4.97106e-03
    gaussian 45 43 0 6.28408e-01 6.82628e-02 6.09504e-01 6.62093e-02 6.09331e-01 6.61905e-02
    gaussian 45 45 0 1.05382e+00 9.69655e-02 1.01957e+00 9.38145e-02 1.01957e+00 9.38145e-02
    gaussian 45 46 0 9.33761e-01 7.87333e-02 9.04629e-01 7.62769e-02 9.04557e-01 7.62709e-02
    gaussian 45 47 0 6.53689e-01 5.03503e-02 6.35219e-01 4.89276e-02 6.35011e-01 4.89116e-02
    gaussian 45 50 0 6.21753e-02 3.57437e-03 6.23779e-02 3.58601e-03 6.22363e-02 3.57787e-03
    gaussian 45 60 0 1.16785e-09 1.79356e-11 3.43167e-07 5.27030e-09 3.33065e-07 5.11516e-09
    gaussian 45 75 0 1.49759e-24 1.67015e-28 4.09409e-13 4.56585e-17 3.21227e-13 3.58241e-17
    gaussian 45 45 5 4.72363e-02 4.56422e-03 4.75899e-02 4.59839e-03 4.75899e-02 4.59839e-03
    k-correlation 5 0 0 1.40142e-02 1.39787e-02 1.38253e-02 1.37903e-02 1.38252e-02 1.37902e-02
    k-correlation 5 2 0 5.88300e-02 5.83004e-02 5.71534e-02 5.66388e-02 5.71532e-02 5.66387e-02
    k-correlation 5 5 0 1.83711e+00 1.80007e+00 1.70177e+00 1.66745e+00 1.70177e+00 1.66745e+00
    k-correlation 5 6 0 6.57398e-01 6.41451e-01 6.15813e-01 6.00874e-01 6.15812e-01 6.00874e-01
    k-correlation 5 8 0 5.97415e-02 5.77703e-02 5.80449e-02 5.61297e-02 5.80444e-02 5.61292e-02
    k-correlation 5 10 0 1.43983e-02 1.37873e-02 1.42052e-02 1.36024e-02 1.42047e-02 1.36019e-02
    k-correlation 5 15 0 1.93765e-03 1.80422e-03 1.93061e-03 1.79767e-03 1.93016e-03 1.79724e-03
    k-correlation 5 30 0 1.45259e-04 1.21189e-04 1.45881e-04 1.21708e-04 1.45168e-04 1.21113e-04
    k-correlation 5 60 0 2.18726e-05 1.45177e-05 2.45727e-05 1.63099e-05 2.18701e-05 1.45161e-05
    k-correlation 5 5 90 5.09599e-03 5.09628e-03 5.05842e-03 5.05871e-03 5.05842e-03 5.05871e-03
    k-correlation 5 30 90 7.19592e-05 7.82069e-05 7.22823e-05 7.85581e-05 7.19291e-05 7.81743e-05
    k-correlation 5 20 180 1.26652e-04 1.29042e-04 1.26680e-04 1.29070e-04 1.26572e-04 1.28960e-04
"""
"""sigma 13 nm, length 5 um, n 1.5, 550 nm: spectrum, theta_i, theta_o, azimuth from the forward plane [degree]; BRDF [sr-1] of Rayleigh-Rice
s and p, GHS s and p, SSA1 s and p, computed apart from this package (series in plain floating point; Rayleigh-Rice agrees with SCATMECH)."""

ROWS = [
    (name, np.array(values, dtype=float)) for name, *values in (row.split() for row in REFERENCE.strip().splitlines())
]
SURFACES = ("gaussian", "k-correlation")

ENERGY = [
    ("gaussian", 5, (0.087553, 0.087553), (0.083830, 0.083830), (0.083829, 0.083830)),
    ("gaussian", 45, (0.044090, 0.044555), (0.043145, 0.043609), (0.043131, 0.043596)),
    ("k-correlation", 5, (0.085955, 0.085981), (0.082350, 0.082375), (0.082234, 0.082260)),
    ("k-correlation", 45, (0.042527, 0.049665), (0.041720, 0.048985), (0.041570, 0.048693)),
]
"""Integral of the halo over Fresnel's reflectance, s and p, of Rayleigh-Rice, GHS and SSA1, by a quadrature of its own."""

COLUMN = {"rayleigh-rice": 0, "ghs": 1, "ssa1": 2}


def surface(
    name: str, form: str = "ssa1", *, sigma: float = 0.013, length: float = 5.0, index=1.5, nm=550.0
) -> xr.Dataset:
    return wave.build(psd.analytic(name, sigma=sigma, length=length), index=index, wavelength=nm, form=form)


@pytest.fixture(scope="module")
def surfaces() -> dict[tuple[str, str], xr.Dataset]:
    return {(name, form): surface(name, form) for name in SURFACES for form in HALOS}


def polarised(bsdf: xr.Dataset, theta_i, theta_o, azimuth) -> np.ndarray:
    """BRDF of light incident polarised s and p, all exits, (2, directions); the azimuth counts from the forward plane."""
    theta_i, theta_o, phi_o = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(angle, dtype=float)) for angle in (theta_i, theta_o, np.asarray(azimuth) + 180))
    )
    matrix = representation(bsdf).mueller(theta_i, np.zeros_like(theta_i), theta_o, phi_o, None)[:, 0]
    return np.array([matrix[:, 0, 0] + matrix[:, 0, 1], matrix[:, 0, 0] - matrix[:, 0, 1]])


@pytest.mark.parametrize("form", HALOS)
@pytest.mark.parametrize("name", SURFACES)
def test_the_halo_has_the_reference_values(surfaces, name, form):
    rows = np.array([values for row, values in ROWS if row == name])
    found = polarised(surfaces[name, form], *rows.T[:3]).T
    expected = rows[:, 3 + 2 * COLUMN[form] :][:, :2]
    last_digit = 10.0 ** (np.floor(np.log10(expected)) - 5)
    # Half the last printed digit, and 1e-6 of interpolation between the nodes of the table.
    assert (np.abs(found - expected) <= last_digit / 2 + 1e-6 * expected).all()


@pytest.mark.parametrize(("name", "angle", "rayleigh_rice", "ghs", "ssa1"), ENERGY)
def test_the_halo_has_the_reference_energy(surfaces, name, angle, rayleigh_rice, ghs, ssa1):
    rule = around_mirror(angle, 2e-3, order=6, turns=24)
    reflectance = np.array(fresnel(np.cos(np.radians(angle)), 1.5)[:2])
    for form, values in (("rayleigh-rice", rayleigh_rice), ("ghs", ghs), ("ssa1", ssa1)):
        found = polarised(surfaces[name, form], angle, rule.theta, rule.phi - 180) @ rule.weight / reflectance
        # Six printed decimals; GHS does not vanish at the horizon, where the reference clips its quadrature.
        assert found == pytest.approx(values, abs=6e-6 if form == "ghs" else 1.1e-6)


@pytest.mark.parametrize(("angle", "share"), [(5, 0.08382940), (45, 0.04315266)])
def test_the_total_integrated_scatter_is_that_of_the_phase_variance(surfaces, angle, share):
    coherent = Halo.of(surfaces["gaussian", "ghs"]).coherent_share(np.array([float(angle)]), np.array([550.0]))
    # Eight printed decimals.
    assert 1 - coherent == pytest.approx(share, abs=1e-8)


@pytest.mark.parametrize("name", SURFACES)
def test_a_surface_of_small_phases_scatters_as_rayleigh_and_rice_say(name):
    # g = 5e-8 at most: the next order is smaller by as much.
    rough = {form: surface(name, form, sigma=1e-5) for form in ("ssa1", "rayleigh-rice")}
    beside = [angle[:20] for angle in (np.linspace(0, 89, 20), np.linspace(5, 70, 20), np.linspace(-170, 180, 20))]
    first = polarised(rough["rayleigh-rice"], *beside)
    seen = first > 1e-25
    assert polarised(rough["ssa1"], *beside)[seen] == pytest.approx(first[seen], rel=1e-5)


@pytest.mark.parametrize("sigma", [0.5, pytest.param(1.0, marks=pytest.mark.slow)])
def test_the_peak_of_a_rough_surface_is_that_of_its_facets(sigma):
    rough = surface("gaussian", sigma=sigma, length=50.0)
    facets = microfacet.build(analytic("beckmann", a=2 * sigma / 50.0), index=1.5, masking="none")
    for angle in (0.0, 30.0, 60.0):
        wave_peak, facet_peak = (float(b.bsdf.evaluate(angle, 0, angle, 180).squeeze()) for b in (rough, facets))
        phase = (4 * np.pi * sigma * np.cos(np.radians(angle)) / 0.55) ** 2
        # The next term of the expansion in 1/g is the mean of 1/m over a Poisson distribution: 1/g + 1/g².
        assert wave_peak / facet_peak == pytest.approx(1 + 1 / phase, abs=4 / phase**2 + 1e-5)


polar, around = st.floats(0.0, 90.0), st.floats(-360.0, 360.0)


@given(
    sigma=st.sampled_from([0.0, 1e-4, 0.013, 0.3, 3.0]),
    form=st.sampled_from(HALOS),
    index=st.sampled_from(["1.5", "1", "1.0000001", "aluminium", "glass-like metal"]),
    theta_i=polar,
    phi_i=around,
    theta_o=polar,
    phi_o=around,
)
def test_the_halo_is_reciprocal_positive_and_finite_everywhere(sigma, form, index, theta_i, phi_i, theta_o, phi_o):
    model = representation(_cached(sigma, form, index))
    there, back = (
        model.evaluate(*(np.array([angle]) for angle in pair), None)
        for pair in ((theta_i, phi_i, theta_o, phi_o), (theta_o, phi_o, theta_i, phi_i))
    )
    assert np.isfinite(there).all()
    assert (there >= 0).all()
    assert there == pytest.approx(back, rel=1e-9, abs=1e-200)


_BUILT: dict[tuple, xr.Dataset] = {}


def _cached(sigma: float, form: str, index: str) -> xr.Dataset:
    """A surface of this rms height [um], built once."""
    if (sigma, form, index) not in _BUILT:
        n, k = {"aluminium": (1.02, 6.63), "glass-like metal": (1.5, 0.01)}.get(index) or (float(index), 0.0)
        refractive = xr.Dataset(
            {
                "n": ("wavelength", [n, n], {"units": "1"}),
                "k": ("wavelength", [k, k], {"units": "1"}),
            },
            coords={"wavelength": ("wavelength", [360.0, 780.0], {"units": "nm"})},
            attrs={"source": "a test", "kind": "index"},
        )
        _BUILT[sigma, form, index] = surface("gaussian", form, sigma=sigma, index=refractive)
    return _BUILT[sigma, form, index]


def test_the_factors_of_the_mirror_direction_are_the_fresnel_reflectances():
    theta = np.linspace(0, 90, 31)
    pair = half_vector(theta, 0.0, theta, 180.0)
    for n, k in ((1.5, 0.0), (1.02, 6.63), (1.0, 0.0)):
        factors = amplitudes(pair, np.full_like(theta, 180.0), np.array([n]), np.array([k]))
        expected = fresnel(np.cos(np.radians(theta)), n, k)
        assert factors.s[:, 0] == pytest.approx(expected.s, abs=1e-12)
        assert factors.p[:, 0] == pytest.approx(expected.p, abs=1e-12)


@pytest.mark.parametrize(("n", "k"), [(1.5, 0.0), (1.02, 6.63)])
def test_close_to_the_mirror_direction_light_is_polarised_as_by_a_facet(n, k):
    angles = np.array([45.0]), np.zeros(1), np.array([45.02]), np.array([180.03])
    found = amplitudes(half_vector(*angles), angles[3] - angles[1], np.array([n]), np.array([k])).mueller()[0, 0]
    expected = facet_mueller(np.ones(1), *angles, np.array([n]), np.array([k]))[0, 0]
    # Both are linear in the angle from the mirror direction, 6e-4 rad, and differ by its first order in the local incidence alone.
    assert found == pytest.approx(expected, abs=2e-3 * abs(expected).max())
    assert found[0, 2] == pytest.approx(expected[0, 2], rel=0.05)
    assert found[1, 2] == pytest.approx(expected[1, 2], rel=0.05)
