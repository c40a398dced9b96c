"""Shares of mirrored light, read by the rules of the format alone."""

from __future__ import annotations

import numpy as np
import pytest
import samples

from brdfpipe import facets, optics, psd
from brdfpipe.bsdf import microfacet, slab, wave
from brdfpipe.exchange.registry import FORMATS, write


def read_as_libbsdf_does(path):
    """Angles and values of the one channel: words one by one, after the lines of comments."""
    words = [word for line in path.read_text().splitlines() if not line.startswith(";;") for word in line.split()]
    at = words.index("sigma")
    count = int(words[at + 1])
    angles = np.array(words[at + 2 : at + 2 + count], dtype=float)
    begin = words.index("def")
    assert words[begin - 1] == "bw"
    assert words[begin + count + 1 :] == ["enddef"]
    assert words[words.index("TypeColorModel") + 1] == "BW"
    return angles, np.array(words[begin + 1 : begin + 1 + count], dtype=float)


def test_a_polished_surface_mirrors_what_fresnel_says(tmp_path):
    write(microfacet.build(facets.flat(), index=1.5), tmp_path / "p.sdr")
    angles, found = read_as_libbsdf_does(tmp_path / "p.sdr")
    assert (angles[0], angles[-1]) == (0, 89.9)
    assert found == pytest.approx(optics.fresnel(np.cos(np.radians(angles)), 1.5).mean, rel=1e-5)
    assert [path.name for path in tmp_path.iterdir()] == ["p.sdr"]


def test_a_rough_surface_mirrors_nothing(tmp_path):
    write(samples.beckmann_bsdf(0.3), tmp_path / "r.sdr")
    assert (read_as_libbsdf_does(tmp_path / "r.sdr")[1] == 0).all()


def test_a_coherent_part_grows_towards_grazing_incidence(tmp_path):
    waves = wave.build(psd.analytic("gaussian", sigma=0.05, length=2.0), index=1.5, wavelength=[500.0, 600.0])
    write(waves, tmp_path / "w.sdr")
    angles, found = read_as_libbsdf_does(tmp_path / "w.sdr")
    expected = waves.bsdf.nonspectral().bsdf.specular(60.0)[0]
    assert found[angles == 60] == pytest.approx(np.ravel(expected), rel=1e-5)
    assert found[80] > 3 * found[0] > 0


def test_each_side_of_a_clear_sheet_has_a_file_beside_its_table(tmp_path):
    sheet = slab.build(facets.flat(), facets.flat(), index=1.5).assign_attrs(material="glass")
    coarse = {"tolerance": 0.2, "albedo_tolerance": 0.1, "largest": 1000}
    for side in ("reflection", "transmission"):
        FORMATS["integra"].write(sheet, tmp_path / "glass", side, **coarse)
    assert {path.name for path in tmp_path.iterdir()} == {
        *(f"glass.{kind}" for kind in ("ddr", "ddr.json", "sdr", "ddt", "ddt.json", "sdt"))
    }
    mirrored, passed = (read_as_libbsdf_does(tmp_path / f"glass.{kind}")[1] for kind in ("sdr", "sdt"))
    # Nothing is absorbed; the numbers have six digits.
    assert mirrored + passed == pytest.approx(np.ones(mirrored.size), abs=2e-6)
