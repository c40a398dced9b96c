"""``brdfpipe check --read``: what files hold, and refusals in the words of the build."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import samples
from click.testing import CliRunner

from brdfpipe.catalogue.catalogue import load
from brdfpipe.catalogue.raw_reading import describe_files
from brdfpipe.cli import main as cli
from brdfpipe.errors import InputError
from brdfpipe.jobs.build import build
from brdfpipe.surfaces import write_x3p

COLOUR = "spectrum: {lab: [50, 0, 0], illuminant: D65, observer: 10, geometry: sci}\n"
SPECTRUM = "nm;R [%]\n" + "".join(f"{nm};{20 + nm / 100:.2f}\n" for nm in range(400, 701, 20))


def material(folder: Path, name: str, text: str, **files: str | bytes) -> None:
    (folder / name).mkdir(parents=True)
    (folder / name / "material.yaml").write_text(text)
    for file, content in files.items():
        path = folder / name / file.replace("__", ".")
        path.write_bytes(content if isinstance(content, bytes) else content.encode())


def x3p(tmp_path: Path, seed: int = 1) -> bytes:
    write_x3p(samples.gaussian_surface(48, sigma=0.15, correlation=4, seed=seed), tmp_path / "map.x3p")
    return (tmp_path / "map.x3p").read_bytes()


def line() -> str:
    heights = np.cumsum(np.random.default_rng(2).normal(scale=0.02, size=2000))
    return "# unit: um\n# pitch: 0.5\n" + "".join(f"{z:.5f}\n" for z in heights)


def test_every_kind_of_raw_file_is_described(tmp_path: Path) -> None:
    folder = tmp_path / "catalogue"
    files = {
        "a__x3p": x3p(tmp_path),
        "b__x3p": x3p(tmp_path, 2),
        "r__csv": SPECTRUM,
        "n__txt": "400 1.5\n550 1.49\n700 1.48\n",
    }
    spectrum = "spectrum: {file: r.csv, geometry: sci}\n"
    material(
        folder,
        "full",
        f"surface: {{file: a.x3p, scans: [{{file: b.x3p}}]}}\nindex: {{file: n.txt}}\n{spectrum}",
        **files,
    )
    slab = "surface: {distribution: flat}\nindex: 1.5\nslab: {thickness: 2, internal_transmittance: {file: t.txt, scale: fraction}}\n"
    material(folder, "clear", slab, t__txt="".join(f"{nm} {0.8 + nm / 5000}\n" for nm in range(400, 701, 50)))
    colours = "geometry,L,a,b\n45as15,60,0,-10\n45as45,40,0,-10\n45as110,25,0,-10\n"
    material(folder, "paint", "multiangle: {file: c.csv, illuminant: D65, observer: 10}\n", c__csv=colours)
    loaded = load(folder)
    lines = describe_files(loaded, loaded["full"])
    text = "\n".join(lines)
    assert [item.partition(":")[0] for item in lines if not item.startswith(" ")] == [
        "a.x3p",
        "n.txt",
        "r.csv",
        "b.x3p",
    ]
    assert "a.x3p: map of 48 × 48 heights, pitch 1 × 1 µm, extent 48 × 48 µm" in text
    assert "at 16 wavelengths from 400 to 700 nm, sci at 8°" in text
    assert "columns: nm, R [%]" in text
    assert "from 1.48 to 1.5 at 3 wavelengths from 400 to 700 nm" in text
    assert "from 0.88 to 0.94 at 7 wavelengths" in describe_files(loaded, loaded["clear"])[0]
    assert describe_files(loaded, loaded["paint"])[0].startswith("c.csv: multiangle of 3 × geometry")


def test_a_warning_of_a_reader_is_a_line(tmp_path: Path) -> None:
    material(
        tmp_path, "m", "spectrum: {file: r.csv, geometry: sci}\n", r__csv=SPECTRUM.replace("500;25.00", "500;35.00")
    )
    loaded = load(tmp_path)
    assert any(text.startswith("  warning: 0.35 at 500 nm differs") for text in describe_files(loaded, loaded["m"]))


def test_the_marks_of_missing_heights_that_a_refusal_lists_are_accepted_as_they_stand(tmp_path: Path) -> None:
    heights = line().splitlines()
    heights[100:103], heights[200:202] = ["-25400"] * 3, ["-1e10"] * 2

    def described(missing: str) -> str:
        return f"surface: {{file: a.txt, isotropic: true{missing}}}\nindex: PP\n{COLOUR}"

    material(tmp_path, "m", described(""), a__txt="\n".join(heights) + "\n")
    check = ["check", str(tmp_path), "--read"]
    refusal = CliRunner().invoke(cli.main, check).output
    stated = re.search(r"`(missing: \[[^`]*\])`", refusal)
    assert stated is not None, refusal
    (tmp_path / "m" / "material.yaml").write_text(described(f", {stated[1]}"))
    done = CliRunner().invoke(cli.main, check)
    assert "0.25% missing" in done.output
    (tmp_path / "m" / "material.yaml").write_text(described(", missing: [-25400, -25400]"))
    assert "surface.missing: an item is listed twice" in load(tmp_path).failures["m"]
    (tmp_path / "m" / "material.yaml").write_text(described(", missing: none"))
    assert "surface.missing: not an accepted value; found 'none'" in load(tmp_path).failures["m"]


def test_two_spectra_of_a_sample_are_read_together_and_refused_with_their_own_keys(tmp_path: Path) -> None:
    text = "spectrum: {sci: {file: i.csv}, sce: {file: e.csv}}\n"
    excluded = "nm;R [%]\n" + "".join(f"{nm};{16 + nm / 100:.2f}\n" for nm in range(400, 701, 20))
    material(tmp_path, "m", text, i__csv=SPECTRUM, e__csv=excluded)
    loaded = load(tmp_path)
    assert loaded.failures == {}
    lines = describe_files(loaded, loaded["m"])
    assert lines[0].startswith("i.csv: total (diffuse and specular) reflectance from 0.24 to 0.27 at 16 wavelengths")
    assert "  SCE: percent was converted to a fraction" in lines
    done = CliRunner().invoke(cli.main, ["check", str(tmp_path), "--read"])
    assert done.output.startswith("m: ok (spectrum i.csv and e.csv)")
    (tmp_path / "m" / "e.csv").write_text(excluded.replace("R [%]", "T [%]"))
    with pytest.raises(InputError, match=r"not a reflectance.*`spectrum\.sce\.column`"):
        describe_files(loaded, loaded["m"])
    (tmp_path / "m" / "material.yaml").write_text("spectrum: {sci: {file: i.csv}}\n")
    assert "the key 'sce' is missing" in load(tmp_path).failures["m"]


def test_a_spectrum_without_the_specular_component_is_not_called_total(tmp_path: Path) -> None:
    material(tmp_path, "m", "spectrum: {file: e.csv, geometry: sce}\n", e__csv=SPECTRUM)
    loaded = load(tmp_path)
    (line, *_) = describe_files(loaded, loaded["m"])
    assert line.startswith("e.csv: reflectance without the specular component from 0.24 to 0.27 at 16 wavelengths")


def wrong_catalogue(folder: Path, tmp_path: Path) -> None:
    """Materials whose mistake only the content of a raw file shows."""
    surface, index = x3p(tmp_path), "index: PP\n"
    plain = "\n".join(
        " ".join(f"{z:.5f}" for z in row)
        for row in samples.gaussian_surface(48, sigma=0.15, correlation=4).height.values
    )
    material(folder, "no-unit", f"surface: {{file: a.txt, pitch: 1}}\n{index}{COLOUR}", a__txt=plain)
    material(folder, "one-line", f"surface: {{file: a.txt}}\n{index}{COLOUR}", a__txt=line())
    material(folder, "turned", f"surface: {{file: a.x3p, azimuth: 30}}\n{index}{COLOUR}", a__x3p=surface)
    material(folder, "too-long", f"surface: {{file: a.x3p, lambda_c: 500}}\n{index}{COLOUR}", a__x3p=surface)
    twice = "surface: {file: a.x3p, scans: [{file: b.x3p}]}\n"
    material(folder, "twice", f"{twice}{index}{COLOUR}", a__x3p=surface, b__x3p=surface)
    fractions = SPECTRUM.replace("[%]", "").replace(";2", ";0.2")
    material(folder, "fractions", "spectrum: {file: r.csv, geometry: sci, scale: percent}\n", r__csv=fractions)
    row = ",".join(["red", "SCE", *(["0.2"] * 16)])
    head = ",".join(["name", "Mode", *map(str, range(400, 701, 20))])
    material(
        folder, "sce", "spectrum: {file: r.csv, geometry: sci, scale: fraction, sample: 1}\n", r__csv=f"{head}\n{row}\n"
    )


def test_check_reads_and_refuses_what_the_build_refuses_in_its_words(tmp_path: Path) -> None:
    folder = tmp_path / "catalogue"
    wrong_catalogue(folder, tmp_path)
    plain = CliRunner().invoke(cli.main, ["check", str(folder)])
    assert (plain.exit_code, plain.output.splitlines()[-1]) == (0, "7 ok, 0 wrong")
    done = CliRunner().invoke(cli.main, ["check", str(folder), "--read"])
    assert done.exit_code == 1
    checked = dict(text.split(": ", 1) for text in done.output.splitlines()[:-1])
    built = build(folder, tmp_path / "results", cores=1).failures
    assert set(checked) == set(built) == {item.name for item in folder.iterdir()}
    for name, message in checked.items():
        # The stage of the facets names no file.
        words = message.removeprefix("a.txt: ").removeprefix("a.x3p: ")
        assert words in built[name], name


def test_a_back_face_is_refused_with_its_own_key(tmp_path: Path) -> None:
    text = "surface: {distribution: flat}\nindex: 1.5\nslab: {thickness: 2, back: {file: a.txt}}\n"
    material(tmp_path, "m", text, a__txt="\n".join(" ".join(["0.5"] * 48) for _ in range(48)))
    loaded = load(tmp_path)
    with pytest.raises(InputError, match=r"`slab\.back\.unit`"):
        describe_files(loaded, loaded["m"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("index: {file: k.txt}\ncoat: {thickness: 0.05, internal_transmittance: 0.9, base: {index: 1.6, surface: {distribution: flat}}}\n", "the index of the coat absorbs.*k up to 0.1.*index.file"),
        ("index: {file: k.txt}\nslab: {thickness: 0.05, internal_transmittance: 0.9}\n", "the index of the slab absorbs.*k up to 0.1.*index.file"),
        ("index: 1.5\ncoat: {thickness: 0.05, internal_transmittance: 0.9, base: {index: {file: k.txt}, surface: {distribution: flat}}}\n", "below the face of a metal.*coat.base.index.file"),
    ],
)  # fmt: skip
def test_an_index_that_absorbs_is_refused_where_the_model_needs_a_real_one(
    tmp_path: Path, text: str, message: str
) -> None:
    folder = tmp_path / "m"
    folder.mkdir()
    (folder / "k.txt").write_text("".join(f"{nm / 1000} 1.5 0.1\n" for nm in range(380, 781, 20)))
    colour = "" if "slab" in text else "spectrum: {lab: [40, 5, 5], illuminant: D65, observer: 10, geometry: sci}\n"
    (folder / "material.yaml").write_text(f"surface: {{distribution: beckmann, slope_rms: 0.1}}\n{text}{colour}")
    loaded = load(tmp_path)
    assert loaded.failures == {}
    with pytest.raises(InputError, match=message):
        describe_files(loaded, loaded["m"])
