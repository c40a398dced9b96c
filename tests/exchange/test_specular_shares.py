"""Shares of mirrored light, read by the rules of the format alone."""

from __future__ import annotations

import numpy as np
import pytest
import samples
from damaged_files import garbled

from brdfpipe import facets, optics, psd, vocabulary
from brdfpipe.bsdf import microfacet, slab, wave
from brdfpipe.errors import InputError
from brdfpipe.exchange import specular_shares
from brdfpipe.exchange.conversion import open_bsdf
from brdfpipe.exchange.reading import read
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


SHARES = """;; a lacquer
Source Measured
TypeColorModel RGB
sigma 3
0 45
90
red
def
0.04 0.05 1
enddef
green
def
0.03 0.04 1
enddef
blue
def
0.02 0.03 1
enddef
"""


def test_shares_are_read_back_with_their_six_digits(tmp_path):
    bsdf = microfacet.build(facets.flat(), index=1.5)
    write(bsdf, tmp_path / "p.sdr")
    found = specular_shares.read(tmp_path / "p.sdr")
    assert found.theta_i == pytest.approx(specular_shares.INCIDENCES)
    assert found.values[:, 0] == pytest.approx(specular_shares.shares(bsdf, "reflection"), rel=1e-5)
    assert found.wavelength is None


def test_shares_of_three_colours_and_of_wavelengths_are_read(tmp_path):
    path = tmp_path / "x.sdr"
    path.write_text(SHARES)
    assert specular_shares.read(path).values.tolist() == [[0.04, 0.03, 0.02], [0.05, 0.04, 0.03], [1, 1, 1]]
    spectral = (
        SHARES.replace("RGB", "spectral 3")
        .replace("red", "wl 450")
        .replace("green", "wl 550")
        .replace("blue", "WL 650")
    )
    path.write_text(spectral)
    assert specular_shares.read(path).wavelength.tolist() == [450, 550, 650]


def test_shares_beside_a_table_are_a_warning_and_alone_no_bsdf(tmp_path):
    waves = wave.build(psd.analytic("gaussian", sigma=0.05, length=2.0), index=1.5, wavelength=[500.0, 600.0])
    FORMATS["integra"].write(waves, tmp_path / "w", tolerance=0.2, albedo_tolerance=0.1, largest=3000)
    (warning,) = [text for text in vocabulary.warnings(open_bsdf(tmp_path / "w.ddr")) if "single direction" in text]
    share = float(np.ravel(waves.bsdf.nonspectral().bsdf.specular(0.0)[0])[0])
    assert f"{share:.4f} at 0°" in warning
    with pytest.raises(InputError, match=r"single directions alone.*\.ddr"):
        read(tmp_path / "w.sdr")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("sigma 3", "sigma 1000000000", "line 4.*1 to 4000"),
        ("0 45", "45 0", "do not increase"),
        ("0.04 0.05 1", "0.04 0.05 1.2", "0 to 1"),
        ("0.04 0.05 1", "0.04 nan 1", "not finite"),
        ("RGB", "spectral 999999999", "1 to 2000"),
        ("RGB", "HSV", "BW, RGB, spectral"),
        ("green", "blue", "gre"),
        ("\nenddef\nblue", "\nblue", "enddef"),
        ("sigma 3\n0 45\n90\n", "", "no sigma"),
    ],
)
def test_a_file_of_shares_that_contradicts_itself_is_refused(tmp_path, old, new, message):
    assert old in SHARES
    (tmp_path / "x.sdr").write_text(SHARES.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        specular_shares.read(tmp_path / "x.sdr")


@pytest.mark.parametrize("count", [40, pytest.param(300, marks=pytest.mark.slow)])
def test_garbled_files_are_read_or_refused_and_never_crash(tmp_path, count):
    write(microfacet.build(facets.flat(), index=1.5), tmp_path / "p.sdr")
    refused = 0
    for damaged in garbled((tmp_path / "p.sdr").read_bytes(), count):
        (tmp_path / "x.sdr").write_bytes(damaged)
        try:
            found = specular_shares.read(tmp_path / "x.sdr")
        except InputError:
            refused += 1
            continue
        assert ((found.values >= 0) & (found.values <= 1)).all()
    assert refused >= count / 4
