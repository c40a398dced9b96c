"""The microfacet BSDF against SCATMECH, the polarised-scatter library of NIST, written apart from this package.

SCATMECH evaluates D from a closed form, the package from a table: the table's nodes are laid so close here that the difference is
below 1e-9 of the value. Its scattering plane has the light travel towards φ = 0: w_i lies at φ = 180.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
import xarray as xr
from scipy.special import ndtr

from brdfpipe import facets, psd, vocabulary
from brdfpipe.bsdf import microfacet, wave
from brdfpipe.bsdf.microfacet.microsurface import Microsurface
from brdfpipe.bsdf.microfacet.polarised import mueller
from brdfpipe.bsdf.representations.flake import ClearCoat
from brdfpipe.facets.facet_dataset import radial_dataset
from brdfpipe.facets.radial_density import RadialDensity
from brdfpipe.flakes.refraction import flake_angle
from brdfpipe.geometry import half_vector

brdf = pytest.importorskip("pySCATMECH.brdf", reason="pySCATMECH is not there: make peers")

A = 0.5
DIELECTRIC = (1.5, 0.0)
ALUMINIUM = (1.02, 6.63)
REFLECTION, TRANSMISSION, REFLECTION_BELOW, TRANSMISSION_UP = range(4)
UNMASKED = {None: "Unit_Shadow_Function"}
V_GROOVES = {None: "Torrance_Sparrow_Shadow_Function"}
BEYOND_THE_TABLE = 1e-30
"""The package takes a density below this share of its peak as 0 [sr-1]."""

SLOPES = {
    "gaussian": {None: "Gaussian_Slope_Distribution_Function", "s": A},
    # Ellipsoidal bumps are GGX: a = rz/r, where they cover the surface once.
    "ggx": {None: "Ellipsoid_Slope_Distribution_Function", "rx": 1, "ry": 1, "rz": A, "density": 1 / np.pi},
    "exponential": {None: "Exponential_Slope_Distribution_Function", "s": A},
}


class Directions(NamedTuple):
    """Pairs of directions in degree, each measured from the normal of its own side."""

    theta_i: np.ndarray
    theta_o: np.ndarray
    phi_o: np.ndarray


def density(name: str) -> RadialDensity:
    """SCATMECH's slope density of this name, on nodes that interpolate it to 1e-10."""
    if name == "exponential":
        # Its cusp at s = 0 is no smooth function of s²: the nodes crowd there.
        slope = np.concatenate([[0.0], np.geomspace(1e-6, 60 * A, 4000)])
        return RadialDensity(slope, 3 / (np.pi * A**2) * np.exp(-np.sqrt(6) * slope / A))
    if name == "ggx":
        slope = A * np.sinh(np.linspace(0, np.arcsinh(1e6), 4000))
        return RadialDensity(slope, A**2 / (np.pi * (A**2 + slope**2) ** 2))
    slope = A * np.linspace(0, 9, 500)
    return RadialDensity(slope, np.exp(-((slope / A) ** 2)) / (np.pi * A**2))


def material(name: str, index: tuple[float, float], **options) -> xr.Dataset:
    """The facets of a named density on a body of index n + ik, without a diffuse part."""
    table = radial_dataset(density(name), A)
    table.attrs |= {"method": name, "band": "none"}
    n, k = index
    refractive = xr.Dataset(
        {"n": ("wavelength", [n, n]), "k": ("wavelength", [k, k])},
        coords={"wavelength": [360.0, 780.0]},
        attrs={"source": "a number", "dispersion": "constant"},
    )
    facet_table, index_table = vocabulary.label(table, "facets"), vocabulary.label(refractive, "index")
    options = {"multiple_scattering": "none"} | options
    return microfacet.build(facet_table, index=index_table, diffuse="none", **options)


def random_directions() -> Directions:
    """A thousand pairs, uniform over the hemisphere."""
    rng = np.random.default_rng(4)
    theta_i, theta_o = np.degrees(np.arccos(rng.random((2, 1000))))
    return Directions(theta_i, theta_o, 360 * rng.random(1000))


def scatmech(
    slopes: dict, index: tuple[float, float], shadow: dict, where: Directions, *, kind: int = 0, turned: float = 0.0
) -> np.ndarray:
    """Mueller matrix BSDFs of SCATMECH, (directions, 4, 4), of a sample turned by so many degrees."""
    substrate = f"({index[0]!r},{index[1]!r})"
    model = brdf.BRDF_Model(
        "Shadowed_Facet_BRDF_Model", wavelength=0.55, substrate=substrate, type=kind, sdf=slopes, shadow=shadow
    )
    radians = zip(*np.radians(where), strict=True)
    return np.array([model.MuellerBRDF(*pair, rotation=np.radians(turned)) for pair in radians], dtype=float)


def evaluated(bsdf: xr.Dataset, where: Directions, *, in_below: bool = False, out_below: bool = False) -> np.ndarray:
    """The package's BSDF for SCATMECH's directions."""
    theta_i = 180 - where.theta_i if in_below else where.theta_i
    theta_o = 180 - where.theta_o if out_below else where.theta_o
    return bsdf.bsdf.evaluate(theta_i, 180.0, theta_o, where.phi_o).values


@pytest.mark.parametrize("index", [DIELECTRIC, ALUMINIUM], ids=["dielectric", "metal"])
@pytest.mark.parametrize("name", SLOPES)
@pytest.mark.parametrize(("masking", "shadow"), [("none", UNMASKED), ("blinn", V_GROOVES)], ids=["unmasked", "blinn"])
def test_the_brdf_is_that_of_scatmech(name, masking, shadow, index):
    where = random_directions()
    expected = scatmech(SLOPES[name], index, shadow, where)[:, 0, 0]
    values = evaluated(material(name, index, masking=masking), where)
    assert values == pytest.approx(expected, rel=1e-9, abs=BEYOND_THE_TABLE)


def test_the_separable_masking_is_that_of_scatmech_once_the_facets_face_the_viewer():
    # SCATMECH keeps Smith's factor P(p < cot θ), that a facet taken at random faces the viewer at all; one that mirrors the
    # light there does. The rest is the same G1, but for the interpolation in the package's table of it.
    sigma, where = A / np.sqrt(2), random_directions()
    shadow = {None: "Smith_Shadow_Function", "w": sigma}
    theirs = scatmech(SLOPES["gaussian"], DIELECTRIC, shadow, where)[:, 0, 0]
    faces_i, faces_o = (ndtr(1 / np.tan(np.radians(theta)) / sigma) for theta in where[:2])
    values = evaluated(material("gaussian", DIELECTRIC, masking="separable"), where)
    assert values == pytest.approx(theirs / (faces_i * faces_o), rel=1e-6, abs=BEYOND_THE_TABLE)


def test_the_brdf_of_a_surface_with_a_lay_is_that_of_scatmech():
    # A table over two axes holds its density to 1e-5; the turn of the sample is exact.
    a_x, a_y, azimuth, where = 0.5, 0.2, 20.0, random_directions()
    ellipsoids = {"rx": 1 / a_x, "ry": 1 / a_y, "rz": 1, "density": a_x * a_y / np.pi}
    expected = scatmech(SLOPES["ggx"] | ellipsoids, DIELECTRIC, V_GROOVES, where, turned=azimuth)[:, 0, 0]
    brushed = facets.analytic("ggx", a_x=a_x, a_y=a_y, azimuth=azimuth)
    bsdf = microfacet.build(brushed, index=DIELECTRIC[0], masking="blinn", diffuse="none")
    assert evaluated(bsdf, where) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("upwards", [False, True], ids=["into the body", "out of the body"])
def test_the_btdf_is_that_of_scatmech_from_either_side(upwards):
    where, kind = random_directions(), TRANSMISSION_UP if upwards else TRANSMISSION
    expected = scatmech(SLOPES["gaussian"], DIELECTRIC, UNMASKED, where, kind=kind)[:, 0, 0]
    assert np.count_nonzero(expected) > 100
    bsdf = material("gaussian", DIELECTRIC, masking="none", transparent=True)
    values = evaluated(bsdf, where, in_below=upwards, out_below=not upwards)
    assert values == pytest.approx(expected, rel=1e-9, abs=BEYOND_THE_TABLE)


def test_the_brdf_from_within_the_body_is_that_of_scatmech():
    where = random_directions()
    expected = scatmech(SLOPES["gaussian"], DIELECTRIC, UNMASKED, where, kind=REFLECTION_BELOW)[:, 0, 0]
    bsdf = material("gaussian", DIELECTRIC, masking="none", transparent=True)
    values = evaluated(bsdf, where, in_below=True, out_below=True)
    zeta = np.degrees(np.arccos(half_vector(where.theta_i, 180.0, where.theta_o, where.phi_o).cos_zeta))
    total = zeta > np.degrees(np.arcsin(1 / DIELECTRIC[0]))
    assert values[~total] == pytest.approx(expected[~total], rel=1e-9, abs=BEYOND_THE_TABLE)
    # To pick its root in total reflection, SCATMECH gives the sine an imaginary part of 1e-10: F falls short of 1 by as much,
    # times the steepness of the root near the critical angle.
    assert values[total] == pytest.approx(expected[total], rel=1e-7, abs=BEYOND_THE_TABLE)


@pytest.mark.parametrize("index", [DIELECTRIC, ALUMINIUM], ids=["dielectric", "metal"])
def test_the_mueller_matrix_is_that_of_scatmech(index):
    # Elements over M00; both take their frames s = k × z and p = k × s and absorb with n + ik, so that all signs agree.
    where = random_directions()
    expected = scatmech(SLOPES["gaussian"], index, UNMASKED, where)
    surface = Microsurface.of(material("gaussian", index, masking="none"))
    pair = half_vector(where.theta_i, 180.0, where.theta_o, where.phi_o)
    shape_factor = surface.reflected(pair, 180.0, where.phi_o, "none")
    values = mueller(shape_factor, where.theta_i, 180.0, where.theta_o, where.phi_o, *index)[:, 0]
    there = expected[:, 0, 0] > BEYOND_THE_TABLE
    scale = expected[there, :1, :1]
    assert values[there] / scale == pytest.approx(expected[there] / scale, abs=1e-9)


def test_the_interface_above_flakes_is_that_of_scatmech():
    # Flakes of a metal with k = 3000 mirror s and p alike to 1e-3 of a percent.
    where, index = random_directions(), 1.524
    model = brdf.BRDF_Model(
        "Subsurface_Facet_BRDF_Model",
        **{"lambda": 0.55},
        substrate="(1e-4,3000)",
        type=REFLECTION,
        overcoat=f"({index},0)",
        sdf=SLOPES["gaussian"],
        stack="No_StackModel",
        overcoat_films="No_StackModel",
    )
    expected = np.array([model.MuellerBRDF(*pair) for pair in zip(*np.radians(where), strict=True)], dtype=float)[
        :, 0, 0
    ]
    coat = ClearCoat(index, physical=True, slope=None)
    incidence = np.full(where.theta_i.size, 180.0)
    tilt = np.radians(flake_angle(where.theta_i, 180.0, where.theta_o, where.phi_o, index))
    flake_density = density("gaussian")(np.tan(tilt) ** 2) / np.cos(tilt) ** 4
    share = coat.share(where.theta_i, incidence, where.theta_o, where.phi_o)
    values = flake_density * share * coat.normal_transmittance**2 / (4 * index**2)
    assert values == pytest.approx(expected, rel=1e-6, abs=BEYOND_THE_TABLE)


PSDS = {
    "gaussian": {None: "Gaussian_PSD_Function", "sigma": 0.013, "length": 5},
    # Its exponent is C/2: a slope of 3 is C = 3.
    "k-correlation": {None: "ABC_PSD_Function", "A": 2 * np.pi * 0.013**2 * 5**2, "B": 2 * np.pi * 5, "C": 3},
}


@pytest.mark.parametrize("index", [DIELECTRIC, ALUMINIUM], ids=["dielectric", "metal"])
@pytest.mark.parametrize("name", PSDS)
def test_rayleigh_rice_is_that_of_scatmech(name, index):
    where = random_directions()
    model = brdf.BRDF_Model(
        "Microroughness_BRDF_Model", wavelength=0.55, substrate=f"({index[0]!r},{index[1]!r})", type=0, psd=PSDS[name]
    )
    expected = np.array([model.MuellerBRDF(*pair) for pair in zip(*np.radians(where), strict=True)], dtype=float)
    n, k = index
    refractive = vocabulary.label(
        xr.Dataset(
            {"n": ("wavelength", [n, n]), "k": ("wavelength", [k, k])},
            coords={"wavelength": [360.0, 780.0]},
            attrs={"source": "a number", "dispersion": "constant"},
        ),
        "index",
    )
    spectrum = psd.analytic(name, sigma=0.013, length=5.0)
    bsdf = wave.build(spectrum, index=refractive, wavelength=550.0, form="rayleigh-rice")
    values = bsdf.bsdf.mueller(where.theta_i, 180.0, where.theta_o, where.phi_o).values.squeeze()
    seen = expected[:, 0, 0] > BEYOND_THE_TABLE
    scale = np.abs(expected[seen]).max(axis=(1, 2), keepdims=True)
    # Rounding: SCATMECH takes the index apart into real and imaginary parts.
    assert np.abs(values[seen, 0, 0] / expected[seen, 0, 0] - 1).max() < 1e-9
    assert (np.abs(values[seen] - expected[seen]) / scale).max() < 1e-9
