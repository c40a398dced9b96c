"""``brdfpipe convert`` and ``brdfpipe compare``."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import samples
from click.testing import CliRunner, Result

from brdfpipe import store
from brdfpipe.cli.main import main
from brdfpipe.exchange.registry import FORMATS


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bsdf") / "bsdf.nc"
    store.save_dataset(samples.beckmann_bsdf(0.3), path, stage="bsdf", material="grain")
    return path


def run(*words: object) -> Result:
    return CliRunner().invoke(main, [str(word) for word in words])


def test_convert_states_the_error_and_what_is_left_out(saved: Path, tmp_path: Path) -> None:
    target = tmp_path / "grain.zemax.bsdf"
    found = run("convert", saved, target, "--tolerance", 0.03)
    assert found.exit_code == 0, found.output
    record = json.loads(Path(f"{target}.json").read_text())
    assert f"error {record['error']['percentile_95']:.2%}" in found.output
    assert "left out: polarisation" in found.output


def test_an_error_above_the_tolerance_names_the_option(saved: Path, tmp_path: Path) -> None:
    found = run("convert", saved, tmp_path / "grain.zemax.bsdf", "--tolerance", 1e-4, "--largest", 2000)
    assert found.exit_code == 0, found.output
    assert "MORE than the tolerance of 0.0001" in found.output
    assert ": `brdfpipe convert --largest` allows more values" in found.output


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["grain.xyz"], "no format has files that end with '.xyz'"),
        (["grain.ddr", "--option", "binary=true"], "integra: unknown option 'binary'"),
        (["grain.zemax.bsdf", "--wavelengths", "550"], "the format has no wavelengths"),
        (["grain.nc", "--tolerance", "0.1"], "netCDF has no option 'tolerance'"),
    ],
)
def test_a_target_that_cannot_be_written_is_refused_before_the_source_is_read(
    tmp_path: Path, words: list[str], named: str
) -> None:
    (tmp_path / "in.zemax.bsdf").write_text("no table")
    found = run("convert", tmp_path / "in.zemax.bsdf", tmp_path / words[0], *words[1:])
    assert found.exit_code != 0
    assert named in found.output


def test_an_error_of_the_reflectance_alone_above_its_limit_is_named(saved: Path, tmp_path: Path) -> None:
    words = "--tolerance", 0.5, "--option", "albedo_tolerance=1e-9", "--largest", 2000
    found = run("convert", saved, tmp_path / "grain.zemax.bsdf", *words)
    assert "MORE than the albedo_tolerance of 1e-09: `brdfpipe convert --largest` allows more" in found.output
    assert "that is MORE than the albedo_tolerance of 1e-09" in (tmp_path / "grain.zemax.bsdf").read_text()


def test_wavelengths_and_options_of_the_format(saved: Path, tmp_path: Path) -> None:
    found = run("convert", saved, tmp_path / "a.ddr", "--tolerance", 0.1, "--wavelengths", "450, 550")
    assert found.exit_code == 0, found.output
    assert "spectral 2" in (tmp_path / "a.ddr").read_text()
    found = run("convert", saved, tmp_path / "b.ddr", "--tolerance", 0.1, "--option", "colour=rgb")
    assert found.exit_code == 0, found.output
    assert "TypeColorModel RGB" in (tmp_path / "b.ddr").read_text()
    for words in (["--wavelengths", "blue"], ["--option", "colour"]):
        found = run("convert", saved, tmp_path / "c.ddr", *words)
        assert found.exit_code == 2
        assert words[0] in found.output


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("hue=1", "unknown option 'hue'; accepted: albedo_tolerance"),
        # Names of what the command itself gives to the conversion.
        ("path=elsewhere.ddr", "unknown option 'path'"),
        ("wavelengths=1", "unknown option 'wavelengths'"),
        ("views=10", "integra: unknown option 'views'"),
        ("largest=many", "largest is 'many'; accepted: a number"),
        ("tolerance=true", "tolerance is True; accepted: a number"),
        ("tolerance=NaN", "tolerance is nan; accepted: a number"),
    ],
)
def test_options_that_the_format_does_not_take_are_one_error(
    saved: Path, tmp_path: Path, option: str, words: str
) -> None:
    found = run("convert", saved, tmp_path / "c.ddr", "--option", option)
    assert found.exit_code == 2
    assert words in found.output
    assert not list(tmp_path.iterdir())


def test_a_word_is_no_truth_value(saved: Path, tmp_path: Path) -> None:
    found = run("convert", saved, tmp_path / "c.zemax.bsdf", "--option", "colour=no")
    assert found.exit_code == 2
    assert "colour is 'no'; accepted: true or false" in found.output


def test_compare_finds_the_stated_error(saved: Path, tmp_path: Path) -> None:
    target = tmp_path / "grain.zemax.bsdf"
    run("convert", saved, target, "--tolerance", 0.03)
    found = run("compare", saved, target, "--json")
    assert found.exit_code == 0, found.output
    figures = json.loads(found.output)
    stated = json.loads(Path(f"{target}.json").read_text())["error"]["percentile_95"]
    assert 0.3 * stated < figures["percentile_95"] < 1.5 * stated
    assert figures["colour"] == pytest.approx(0.0, abs=0.1)
    text = run("compare", saved, target).output
    assert f"95th percentile {figures['percentile_95']:.2%}" in text


def test_a_file_that_is_no_bsdf_is_one_error_that_names_the_option(saved: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.bsdf"
    path.write_text("nothing\n")
    commands = {
        "--from": ("convert", path, tmp_path / "b.nc"),
        "--first-from": ("compare", path, saved),
        "--second-from": ("compare", saved, path),
    }
    for option, words in commands.items():
        found = run(*words)
        assert found.exit_code == 2
        assert "Traceback" not in found.output
        assert (
            f"a.bsdf: no format has such files; found .bsdf; accepted: a format that is read; `brdfpipe formats` lists the formats; give {option}"
            in found.output
        )
        assert "material.yaml" not in found.output
    assert not (tmp_path / "b.nc").exists()


def test_formats_and_quantities_of_both_files_can_be_stated(saved: Path, tmp_path: Path) -> None:
    target = tmp_path / "grain.zemax.bsdf"
    run("convert", saved, target, "--tolerance", 0.1)
    renamed = target.rename(tmp_path / "grain.txt")
    stated = ("--second-from", "zemax", "--second-quantity", "brdf", "--json")
    found = run("compare", saved, renamed, *stated)
    assert found.exit_code == 0, found.output
    same = json.loads(found.stdout)
    found = run("compare", saved, renamed, *stated[:3], "pi_brdf", "--json")
    assert json.loads(found.stdout)["albedo"][1][0] == pytest.approx(same["albedo"][1][0] / 3.14159, rel=1e-3)
    refused = run("compare", saved, saved, "--first-from", "zemax")
    assert refused.exit_code == 2
    assert "states its own format" in refused.output


def test_the_errors_of_fits_are_printed_by_formula(saved: Path, tmp_path: Path) -> None:
    target = tmp_path / "grain.parameters.json"
    found = run("convert", saved, target)
    assert found.exit_code == 0, found.output
    for one in json.loads(target.read_text())["fits"]:
        (line,) = (line for line in found.output.splitlines() if line.startswith(f"{one['formula']}: "))
        assert f"error {one['error']['median']:.2%} in the median" in line
        assert f"{one['error']['albedo']:.2%} of the directional reflectance" in line
        assert ("not written" in line) == ("refused" in one)


def test_a_folder_that_is_not_there_is_not_made(saved: Path, tmp_path: Path) -> None:
    found = run("convert", saved, tmp_path / "new" / "a.ddr")
    assert found.exit_code == 2
    assert "does not exist; make it first" in " ".join(found.output.split())
    assert not (tmp_path / "new").exists()


def test_formats_lists_every_format_and_what_it_reads_and_writes() -> None:
    listed = run("formats").output
    assert [line.partition(":")[0] for line in listed.splitlines() if not line.startswith(" ")] == list(FORMATS)
    lines = listed.splitlines()
    integra = lines[next(k for k, line in enumerate(lines) if line.startswith("integra: ")) :]
    assert integra[1].split() == ["written:", ".ddr", ".sdr", ".ddt", ".sdt"]
    assert integra[2].split() == ["read:", ".ddr", ".ddt", ".sdr", ".sdt"]
    assert "colour=bw" in integra[3]


def test_a_file_is_never_replaced_by_its_own_conversion(saved: Path) -> None:
    before = saved.read_bytes()
    found = run("convert", saved, saved)
    assert found.exit_code == 2
    assert "is the file that is read" in found.output
    assert saved.read_bytes() == before


def test_a_file_that_is_only_written_says_so(saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = run("convert", saved, tmp_path / "a.mtlx", "--option", "largest_error=2")
    assert found.exit_code == 0, found.output
    monkeypatch.setitem(FORMATS, "openpbr", replace(FORMATS["openpbr"], read=""))
    assert "files of openpbr are written, not read" in run("compare", saved, tmp_path / "a.mtlx").output


def test_the_results_of_a_material_are_compared_by_their_folder(saved: Path, tmp_path: Path) -> None:
    by_folder, by_file = run("compare", saved.parent, saved), run("compare", saved, saved)
    assert by_folder.exit_code == 0, by_folder.output
    assert by_folder.output == by_file.output
    empty = run("compare", tmp_path, saved)
    assert empty.exit_code == 2
    assert "no BSDF in this folder" in empty.output
