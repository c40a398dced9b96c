"""Two BSDFs compared: the differences that were put in are found, by direction, in reflectance, gloss and colour."""

from __future__ import annotations

import numpy as np
import pytest
import samples
import xarray as xr

from brdfpipe import facets, optics
from brdfpipe.bsdf import microfacet
from brdfpipe.bsdf.lambert_gauss import lambertian
from brdfpipe.bsdf.nonspectral import nonspectral
from brdfpipe.comparison.bsdf_difference import as_text, difference
from brdfpipe.spectra import colorimetry


def diffuse(reflectance: float) -> xr.Dataset:
    """Lambert's law, without colour."""
    return nonspectral(lambertian(samples.spectrum(reflectance)))


def test_a_bsdf_does_not_differ_from_itself() -> None:
    bsdf = samples.beckmann_bsdf(0.2)
    found = difference(bsdf, bsdf)
    assert found.percentile_95 == 0
    assert np.nanmax(np.abs(found.by_region)) == 0
    assert found.albedo[0] == pytest.approx(found.albedo[1])
    assert found.colour == 0


def test_ten_per_cent_more_diffuse_light_is_found_everywhere() -> None:
    found = difference(diffuse(0.30), diffuse(0.33))
    # 0.03 over the mean of 0.315.
    assert found.median == pytest.approx(0.03 / 0.315, rel=1e-6)
    assert found.percentile_95 == pytest.approx(0.03 / 0.315, rel=1e-6)
    regions = found.by_region[np.isfinite(found.by_region)]
    assert regions == pytest.approx(np.full(regions.size, 0.03 / 0.315), rel=1e-6)
    assert found.albedo == pytest.approx(np.array([[0.30] * 5, [0.33] * 5]), abs=2e-4)
    assert np.isnan(found.colour)


def test_a_file_without_colours_is_named_beside_the_colour_difference() -> None:
    grey, coloured = diffuse(0.3), lambertian(samples.spectrum(np.linspace(0.1, 0.5, 85)))
    found = difference(coloured, grey)
    assert found.grey == (False, True)
    assert found.colour > 5
    assert as_text(found).endswith("; the second file has no colours and counts as a grey")
    assert "counts as a grey" not in as_text(difference(coloured, coloured))


def test_exchanging_the_files_turns_the_signs() -> None:
    first, second = samples.beckmann_bsdf(0.2), samples.beckmann_bsdf(0.1)
    there, back = difference(first, second), difference(second, first)
    assert there.percentile_95 == pytest.approx(back.percentile_95)
    assert there.by_region == pytest.approx(-back.by_region, nan_ok=True)
    assert there.albedo[::-1] == pytest.approx(back.albedo)


def test_a_wider_lobe_is_darker_in_the_mirror_direction_and_less_glossy() -> None:
    found = difference(samples.beckmann_bsdf(0.1), samples.beckmann_bsdf(0.2))
    assert found.by_region[1, 0] < -0.5
    assert found.by_region[1, 3] > 0.1
    assert found.gloss[1, 1] < found.gloss[0, 1]


def test_colours_of_diffusers_are_those_of_their_spectra() -> None:
    spectra = [samples.spectrum(np.linspace(*ends, 85)) for ends in ((0.5, 0.5), (0.1, 0.9))]
    white = colorimetry.weights("D65", 10).white
    xyz = [colorimetry.reflectance_to_xyz(samples.WAVELENGTH, one["total_reflectance"].values) for one in spectra]
    labs = [colorimetry.xyz_to_lab(one, white) for one in xyz]
    found = difference(*(lambertian(one) for one in spectra))
    assert found.colour == pytest.approx(float(colorimetry.delta_e_00(*labs)), rel=1e-3)


def test_mirrored_light_counts_in_reflectance_and_gloss() -> None:
    smooth = nonspectral(
        microfacet.build(facets.flat(), index=optics.refractive_index(1.567), spectrum=samples.spectrum(0.05))
    )
    found = difference(smooth, smooth)
    assert found.gloss[0] == pytest.approx([100.0, 100.0, 100.0], abs=0.5)
    assert found.albedo[0, 0] == pytest.approx(0.05, rel=0.05)


def test_the_table_for_a_terminal_has_every_figure() -> None:
    text = as_text(difference(diffuse(0.30), diffuse(0.33)))
    assert "+9.5%" in text
    assert "albedo 45°" in text
    assert "+0.0300" in text
    assert "gloss 60°" in text
    assert "ΔE00" not in text
