"""Materials of Mitsuba: the dictionary and its file, and in Mitsuba itself the values, the samples and a picture."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import samples

import brdfpipe.mitsuba as ours
from brdfpipe import facets, optics
from brdfpipe.bsdf import microfacet, slab
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.table_error import fresh_pairs
from brdfpipe.exchange import gridded, tensor_file

COARSE = {"tolerance": 0.2, "albedo_tolerance": 0.05, "largest": 10_000}


def polished(reflectance=0.4):
    """A smooth face of index 1.5 over a diffuse body."""
    spectrum = None if reflectance is None else samples.spectrum(reflectance)
    return microfacet.build(facets.flat(), index=optics.refractive_index(1.5), spectrum=spectrum).assign_attrs(
        material="gloss"
    )


def test_a_rough_surface_is_a_measured_material_on_both_sides(tmp_path):
    grey = samples.beckmann_bsdf(0.3).assign_attrs(material="grey")
    found = ours.material(grey, tmp_path, **COARSE)
    assert found == {"type": "twosided", "bsdf": {"type": "measured", "filename": str(tmp_path / "grey.rgb.bsdf")}}
    record = json.loads((tmp_path / "grey.rgb.bsdf.json").read_text())
    assert record["format"] == "rgl"
    assert "specular" not in record["left_out"]
    front = ours.material(grey, tmp_path, "other", spectral=True, two_sided=False, **COARSE)
    assert front == {"type": "measured", "filename": str(tmp_path / "other.spectral.bsdf")}
    assert "wavelengths" in tensor_file.read(tmp_path / "other.spectral.bsdf")


def test_a_mirror_part_is_blended_with_twice_the_values(tmp_path):
    found = ours.material(polished(), tmp_path, two_sided=False, **COARSE)
    assert (found["type"], found["weight"]) == ("blendbsdf", 0.5)
    assert found["mirror"]["eta"]["value"] == pytest.approx(1.5)
    assert found["mirror"]["specular_reflectance"]["value"] == pytest.approx(2.0, rel=1e-3)
    path = Path(found["scattering"]["filename"])
    record = json.loads(Path(f"{path}.json").read_text())
    assert "twice" in record["values_are"]
    assert "specular" not in record["left_out"]
    assert b"2 times the BRDF" in tensor_file.read(path)["description"].tobytes()


def test_a_bare_mirror_needs_no_file(tmp_path):
    found = ours.material(polished(None), tmp_path, two_sided=False)
    assert found["type"] == "conductor"
    assert list(tmp_path.iterdir()) == []


def test_light_that_passes_a_sheet_is_said_to_be_left_out(tmp_path):
    rough = facets.analytic("beckmann", 0.3)
    sheet = slab.build(rough, rough, index=1.5, internal_transmittance=0.9).assign_attrs(material="sheet")
    ours.material(sheet, tmp_path, **COARSE)
    assert "transmission" in json.loads((tmp_path / "sheet.rgb.bsdf.json").read_text())["left_out"]


@pytest.fixture
def mitsuba():
    """Mitsuba's variant is global: the one found is put back."""
    module = pytest.importorskip("mitsuba", reason="Mitsuba is not there: make peers")
    before = module.variant()
    yield module
    if before is not None:
        module.set_variant(before)


def vectors(mitsuba, theta, phi):
    theta, phi = np.radians(theta), np.radians(phi)
    components = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)
    return mitsuba.Vector3f(*(one if np.ndim(one) else float(one) for one in components))


CASES = {
    "grey": (lambda: samples.beckmann_bsdf(0.25, reflectance=np.linspace(0.1, 0.6, samples.WAVELENGTH.size)), 400_000),
    "lay": (lambda: samples.brushed_bsdf(0.4, 0.25), 2_000_000),
    "gloss": (polished, 400_000),
}


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "llvm_ad_spectral"])
@pytest.mark.parametrize("case", CASES)
def test_mitsuba_evaluates_what_the_record_says(mitsuba, tmp_path, case, variant):
    make, largest = CASES[case]
    mitsuba.set_variant(variant)
    import drjit

    bsdf, by_wavelength = make(), variant.endswith("spectral")
    found = ours.material(bsdf, tmp_path, case, spectral=by_wavelength, largest=largest)
    (record,) = tmp_path.glob("*.json")
    stated = json.loads(record.read_text())["error"]["percentile_95"]
    assert stated < (0.04 if case == "lay" else 0.01)
    plugin, context = mitsuba.load_dict(found), mitsuba.BSDFContext()
    pairs = fresh_pairs(bsdf.bsdf.nonspectral(), 9)
    if case == "gloss":
        # Away from the mirror direction, where the mirror of the blend is no single direction.
        off = np.degrees(np.arccos(np.clip(np.cos(np.radians(pairs.theta_o)), -1, 1)))
        pairs = pairs.chosen(np.abs(off - pairs.theta_i) > 5)
    wavelength = np.array([450.0, 520.0, 590.0, 650.0])
    if by_wavelength:
        source = bsdf if "wavelength" in bsdf.coords else None
        wanted = representation(bsdf).evaluate(*pairs, wavelength if source is not None else None)
    else:
        channels = gridded.linear_rgb(bsdf)
        wanted = channels.convert(representation(channels.source).evaluate(*pairs, channels.wavelength))
    surface = drjit.zeros(mitsuba.SurfaceInteraction3f, pairs.theta_i.size)
    surface.wi = vectors(mitsuba, pairs.theta_i, pairs.phi_i)
    if by_wavelength:
        surface.wavelengths = [float(one) for one in wavelength]
    read = np.array(plugin.eval(context, surface, vectors(mitsuba, pairs.theta_o, pairs.phi_o))).T
    cosine = np.cos(np.radians(pairs.theta_o))[:, None]
    errors = np.abs(read - wanted * cosine) / np.maximum(wanted * cosine, 1e-3)
    # Those of other directions, in the worst channel.
    assert np.quantile(errors.max(axis=1), 0.95) < 1.5 * stated + 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_samples_are_distributed_as_their_density_says(mitsuba, tmp_path, case):
    make, largest = CASES[case]
    mitsuba.set_variant("llvm_ad_rgb")
    import drjit
    from mitsuba.chi2 import ChiSquareTest, SphericalDomain

    found = ours.material(make(), tmp_path, case, two_sided=False, largest=largest // 10, tolerance=0.1)
    plugin, context = mitsuba.load_dict(found), mitsuba.BSDFContext()
    for theta, phi in ((20.0, 30.0), (55.0, 190.0)):

        def surface(count, at=(theta, phi)):
            interaction = drjit.zeros(mitsuba.SurfaceInteraction3f, count)
            interaction.wi = vectors(mitsuba, *at)
            return interaction

        def draw(sample, surface=surface):
            drawn, weight = plugin.sample(
                context, surface(drjit.width(sample)), sample[0], mitsuba.Point2f(sample[1], sample[2])
            )
            return drawn.wo, drjit.select(drjit.max(weight) > 0, mitsuba.Float(1), mitsuba.Float(0))

        def density(directions, surface=surface):
            return plugin.pdf(context, surface(drjit.width(directions)), directions)

        # The mirror of the blend is 0.4 degree wide: only many nodes resolve its density.
        resolution = {"res": 201, "ires": 64} if case == "gloss" else {"res": 101}
        chi2 = ChiSquareTest(
            domain=SphericalDomain(),
            sample_func=draw,
            pdf_func=density,
            sample_dim=3,
            sample_count=400_000,
            **resolution,
        )
        assert chi2.run(significance_level=0.001, quiet=True), chi2.messages


@pytest.mark.slow
@pytest.mark.parametrize("case", ["grey", "gloss"])
def test_a_sphere_in_even_light_is_as_bright_as_its_albedo(mitsuba, tmp_path, case):
    mitsuba.set_variant("llvm_ad_rgb")
    bsdf = CASES[case][0]()
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2, "hide_emitters": True},
        "light": {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}},
        "panel": {"type": "rectangle", "material": ours.material(bsdf, tmp_path, case)},
        "camera": {
            "type": "perspective",
            "fov": 1.0,
            "to_world": mitsuba.ScalarTransform4f().look_at([0, -6, 6], [0, 0, 0], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": 16, "height": 16, "pixel_format": "rgb"},
        },
    }
    picture = np.array(mitsuba.render(mitsuba.load_dict(scene), spp=512))
    luminance = picture.mean(axis=(0, 1)) @ (0.2126, 0.7152, 0.0722)
    # The file's stated error of the reflectance, and the noise of 130 000 rays.
    assert luminance == pytest.approx(float(bsdf.bsdf.nonspectral().bsdf.albedo(45.0)), rel=0.01)
