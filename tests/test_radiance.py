"""Materials of Radiance: the primitive and its file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import samples
from loaded_by_radiance import load
from spheres_by_radiance import rendered

from brdfpipe import radiance
from brdfpipe.appearance import preview
from brdfpipe.appearance.lights import lights
from brdfpipe.appearance.preview_geometry import sphere
from brdfpipe.exchange.registry import ExchangeError


def test_the_primitive_names_the_file_and_the_up_vector(tmp_path):
    grey = samples.beckmann_bsdf(0.3).assign_attrs(material="grey paint")
    text = radiance.material(grey, tmp_path, up=(0, 0, 1), largest=5_000)
    *notes, head, arguments, no_words, no_numbers = text.splitlines()
    assert head == "void BSDF grey_paint"
    assert arguments == f"6 0 {tmp_path / 'grey_paint.tree.xml'} 0 0 1 ."
    assert (no_words, no_numbers) == ("0", "0")
    assert all(note.startswith("# NOT in this material: ") for note in notes)
    assert any("polarisation" in note for note in notes)
    assert (tmp_path / "grey_paint.tree.xml").exists()


def test_klems_matrices_on_request(tmp_path):
    text = radiance.material(samples.beckmann_bsdf(0.3), tmp_path, "grey", format="klems", thickness=0.01)
    assert f"6 0.01 {tmp_path / 'grey.klems.xml'} 0 1 0 ." in text


def test_what_radiance_cannot_take_is_refused(tmp_path):
    with pytest.raises(ExchangeError, match="unknown format"):
        radiance.material(samples.beckmann_bsdf(0.3), tmp_path, "x", format="rgl")
    with pytest.raises(ExchangeError, match="blank"):
        radiance.material(samples.beckmann_bsdf(0.3), tmp_path / "a b", "x")


def test_radiance_loads_the_file(tmp_path):
    module = pytest.importorskip("pyradiance.bsdf", reason="pyradiance is not there")
    grey = samples.beckmann_bsdf(0.3)
    radiance.material(grey, tmp_path, "grey")
    loaded = load(module, tmp_path / "grey.tree.xml")
    total = module.direct_hemi(loaded, 30.0, 0.0, module.SAMPLE_ALL)
    assert total == pytest.approx(float(grey.bsdf.nonspectral().bsdf.albedo(30.0)), rel=0.01)
    assert np.isfinite(total)


@pytest.mark.slow
def test_a_sphere_rendered_by_radiance_is_that_of_the_preview(tmp_path):
    package = pytest.importorskip("pyradiance", reason="pyradiance is not there")
    grey, side = samples.beckmann_bsdf(0.3).bsdf.nonspectral(), 32
    primitive = radiance.material(grey, tmp_path, "grey", format="klems", up=(0, 0, 1))
    theirs = rendered(Path(package.__file__).parent, primitive, "grey", tmp_path, side)
    shot, ours = sphere(side), np.zeros((side, side))
    table = preview.Table.of(grey, *preview.channels_of(grey))
    ours[shot.coverage > 0] = preview.radiance(table, shot, lights("studio"))[:, 1]
    inside = (theirs > 0) & (shot.coverage >= 1)
    # Patches of 5 to 15 degree, and the noise of 512 and 256 samples of a pixel.
    assert theirs[inside].mean() == pytest.approx(ours[inside].mean(), rel=0.01)
    assert np.sqrt(np.mean((theirs - ours)[inside] ** 2)) < 0.04 * ours[inside].mean()


@pytest.mark.slow
def test_a_brushed_sphere_has_its_lay_along_the_latitude_as_in_the_preview(tmp_path):
    package = pytest.importorskip("pyradiance", reason="pyradiance is not there")
    # Azimuth 0 is along the lay, so that azimuth 90, which `up` fixes, is along the meridians.
    brushed, side = samples.brushed_bsdf(0.2, 0.6).bsdf.nonspectral(), 32
    shot, ours = sphere(side), np.zeros((side, side))
    table = preview.Table.of(brushed, *preview.channels_of(brushed))
    ours[shot.coverage > 0] = preview.radiance(table, shot, lights("studio"))[:, 1]
    agreement = {}
    for name, up in (("along", (0, 0, 1)), ("turned", (1, 0, 0))):
        primitive = radiance.material(
            brushed, tmp_path, "brushed", up=up, tolerance=0.1, albedo_tolerance=0.05, largest=150_000
        )
        theirs = rendered(Path(package.__file__).parent, primitive, "brushed", tmp_path, side)
        inside = (theirs > 0) & (shot.coverage >= 1)
        agreement[name] = np.corrcoef(theirs[inside], ours[inside])[0, 1]
    # Trees of a lay are coarse; a picture that is turned by 90 degree correlates by 0.8.
    assert agreement["along"] > 0.95
    assert agreement["turned"] < 0.9
