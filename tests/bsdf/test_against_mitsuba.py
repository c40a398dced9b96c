"""The microfacet BSDF against Mitsuba 3, a renderer written apart from this package.

Mitsuba computes in single precision: its values hold to about 1e-6, and its directions are handed to the package as it rounds
them. Its Beckmann masking is a rational fit of Smith's, off by up to 3e-3, so that D and F are compared with its own G on both sides.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
import pytest
import xarray as xr

from brdfpipe import facets, vocabulary
from brdfpipe.bsdf import microfacet
from brdfpipe.geometry import angles_of, unit_vector

mitsuba = pytest.importorskip("mitsuba", reason="Mitsuba is not there: make peers")
mitsuba.set_variant("scalar_spectral")

GLASS = (1.5, 0.0)
COPPER = (0.6, 2.6)
PAIRS = 300
FINE = 1e-5
"""Ten times the rounding of Mitsuba."""


class Directions(NamedTuple):
    """Unit vectors (directions, 3) from the surface, and of the facets between them."""

    w_i: np.ndarray
    w_o: np.ndarray
    m: np.ndarray


def random_directions(
    widths: tuple[float, float], n_i: float = 1.0, n_o: float = 1.0, *, through: bool = False
) -> Directions:
    """Random pairs on the same side, or on opposite ones, whose facets are no steeper than three widths.

    Steeper ones count in no integral, and there the exponent of a Beckmann density magnifies the rounding.
    """
    rng = np.random.default_rng(7)
    w_i, w_o = (
        np.float32(unit_vector(np.degrees(np.arccos(rng.random(40_000))), 360 * rng.random(40_000))).astype(float)
        for _ in range(2)
    )
    if through:
        w_o[:, 2] *= -1
    if n_i > n_o:
        w_i, w_o = w_o, w_i
    m = n_i * w_i + n_o * w_o
    m *= np.sign(m[:, 2:]) / np.linalg.norm(m, axis=1, keepdims=True)
    steepness = np.hypot(m[:, 0] / widths[0], m[:, 1] / widths[1]) / np.maximum(m[:, 2], 1e-9)
    # Of light that grazes a surface or a facet little passes: 1 − F is lost in the rounding of F.
    clear = (np.abs(w_i[:, 2]) > 0.05) & (np.abs(w_o[:, 2]) > 0.05)
    for w in (w_i, w_o):
        clear &= (w * m).sum(axis=1) * np.sign(w[:, 2]) > 0.1
    chosen = np.flatnonzero((steepness < 3) & clear)[:PAIRS]
    assert chosen.size == PAIRS
    return Directions(w_i[chosen], w_o[chosen], m[chosen])


def renderers(kind: str, distribution: str, widths: tuple[float, float], index: tuple[float, float]) -> Any:
    """Mitsuba's BSDF."""
    material: dict[str, Any] = {"eta": uniform(index[0]), "k": uniform(index[1])}
    if kind == "roughdielectric":
        material = {"int_ior": index[0], "ext_ior": 1.0}
    shape = {"type": kind, "distribution": distribution, "alpha_u": widths[0], "alpha_v": widths[1]}
    return mitsuba.load_dict(shape | material)


def uniform(value: float) -> dict[str, Any]:
    return {"type": "uniform", "value": value}


def renderers_values(bsdf: Any, where: Directions) -> np.ndarray:
    """BSDFs of Mitsuba [sr-1], light followed from the lamp: its eval holds the cosine of the outgoing direction."""
    context = mitsuba.BSDFContext(mitsuba.TransportMode.Importance)
    interaction = mitsuba.SurfaceInteraction3f()
    interaction.wavelengths = [550.0] * 4
    values = []
    for w_i, w_o in zip(where.w_i, where.w_o, strict=True):
        interaction.wi = mitsuba.Vector3f(w_i)
        values.append(bsdf.eval(context, interaction, mitsuba.Vector3f(w_o))[0] / abs(w_o[2]))
    return np.array(values)


def renderers_masking(distribution: str, widths: tuple[float, float], where: Directions) -> np.ndarray:
    """G of Mitsuba."""
    name = {"beckmann": mitsuba.MicrofacetType.Beckmann, "ggx": mitsuba.MicrofacetType.GGX}[distribution]
    facet_normals = mitsuba.MicrofacetDistribution(name, *widths)
    return np.array(
        [facet_normals.G(*(mitsuba.Vector3f(vector) for vector in three)) for three in zip(*where, strict=True)]
    )


@functools.cache
def material(distribution: str, widths: tuple[float, float], index: tuple[float, float], **options) -> xr.Dataset:
    """The same surface of the package, without a diffuse part."""
    n, k = index
    refractive = xr.Dataset(
        {"n": ("wavelength", [n, n]), "k": ("wavelength", [k, k])},
        coords={"wavelength": [360.0, 780.0]},
        attrs={"source": "a number", "dispersion": "constant"},
    )
    lay = {"a": widths[0]} if widths[0] == widths[1] else {"a_x": widths[0], "a_y": widths[1]}
    return microfacet.build(
        facets.analytic(distribution, **lay),
        index=vocabulary.label(refractive, "index"),
        diffuse="none",
        **options,
        multiple_scattering="none",
    )


def evaluated(bsdf: xr.Dataset, where: Directions) -> np.ndarray:
    return bsdf.bsdf.evaluate(*angles_of(where.w_i), *angles_of(where.w_o)).values


SURFACES = pytest.mark.parametrize("widths", [(0.3, 0.3), (0.5, 0.15)], ids=["isotropic", "with a lay"])
DISTRIBUTIONS = pytest.mark.parametrize("distribution", facets.DISTRIBUTIONS)


@DISTRIBUTIONS
@SURFACES
def test_density_and_reflectance_of_a_metal_are_those_of_mitsuba(distribution, widths):
    where = random_directions(widths)
    expected = renderers_values(renderers("roughconductor", distribution, widths, COPPER), where)
    values = evaluated(material(distribution, widths, COPPER, masking="none"), where)
    assert values * renderers_masking(distribution, widths, where) == pytest.approx(expected, rel=FINE)


@DISTRIBUTIONS
@SURFACES
def test_density_and_reflectance_of_glass_are_those_of_mitsuba(distribution, widths):
    where = random_directions(widths)
    expected = renderers_values(renderers("roughdielectric", distribution, widths, GLASS), where)
    values = evaluated(material(distribution, widths, GLASS, masking="none"), where)
    assert values * renderers_masking(distribution, widths, where) == pytest.approx(expected, rel=FINE)


@SURFACES
def test_the_separable_masking_of_ggx_is_that_of_mitsuba(widths):
    where = random_directions(widths)
    expected = renderers_values(renderers("roughconductor", "ggx", widths, COPPER), where)
    values = evaluated(material("ggx", widths, COPPER, masking="separable"), where)
    assert values == pytest.approx(expected, rel=FINE)


@DISTRIBUTIONS
@SURFACES
@pytest.mark.parametrize(("n_i", "n_o"), [(1.0, 1.5), (1.5, 1.0)], ids=["into the body", "out of the body"])
def test_the_transmission_of_glass_is_that_of_mitsuba_from_either_side(distribution, widths, n_i, n_o):
    where = random_directions(widths, n_i, n_o, through=True)
    expected = renderers_values(renderers("roughdielectric", distribution, widths, GLASS), where)
    values = evaluated(material(distribution, widths, GLASS, masking="none", transparent=True), where)
    assert values * renderers_masking(distribution, widths, where) == pytest.approx(expected, rel=FINE)
