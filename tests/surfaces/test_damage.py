"""Damaged, cut and mislabelled files of every format: one clear refusal, or a surface that can be one; never anything else."""

from __future__ import annotations

import importlib.util
import io
import re
import zipfile
from collections.abc import Iterator
from pathlib import Path

import instrument_files
import numpy as np
import pytest
import samples
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.errors import InputError
from brdfpipe.surfaces import level, parameters, read_surface, write_x3p
from brdfpipe.surfaces.heights import EXTENT_MAX, PITCH_RANGE, SLOPE_RANGE, STEP_WARN

INSTALLED = importlib.util.find_spec("SurfaceTopography") is not None
UNSTATED = {"unit": "um", "pitch": 1.0}
OPTIONS = {"txt": UNSTATED, "csv": {"unit": "um"}, "npy": UNSTATED}
"""Extension → what the format does not state."""
TEXT = ("txt", "csv", "hfm")
OLDER_X3P = "older.x3p"
FORMATS = ("txt", "csv", "hfm", "npy", "npz", "x3p", OLDER_X3P, *instrument_files.WRITERS)
"""Ends of the names of the files, of which the last part is the extension."""
SAME_READER = ({*TEXT}, {"vk4", "vk6"}, {"x3p", OLDER_X3P})
COPIES = 200
MISREAD, SPOILED = 7, 50
"""Most of the copies of a file that are read without a warning though they differ: as another map, and in a few heights (docs/materials.md)."""
REAL = (
    "al3d-1.al3d",
    "frt-1.frt",
    "hfm-1.hfm",
    "mitutoyo_2_mock.xlsx",
    "nms-2.nms",
    "opd-1.opd",
    "plu-1.plu",
    "x3p-2.x3p",
)

Files = dict[str, bytes]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """A small, sound file of each format, by extension."""
    folder = tmp_path_factory.mktemp("whole")
    surface = samples.gaussian_surface(48, sigma=0.15, correlation=4)
    height = surface.height.values
    write_x3p(surface, folder / "map.x3p")
    single, archive = io.BytesIO(), io.BytesIO()
    np.save(single, height)
    np.savez_compressed(archive, height=height, pitch=1.0, unit="um")
    profile = np.column_stack([np.arange(height.size) * 1e-3, height.ravel() * 1e-3])
    files = {
        "txt": "\n".join(" ".join(f"{z:.6f}" for z in row) for row in height).encode(),
        "csv": "\n".join(f"{x * 1e3:.1f};{z * 1e3:.6f}" for x, z in profile).encode(),
        "hfm": ("X;Y;valid\n[mm];[mm];[1/0]\n" + "\n".join(f"{x:.4f};{z:.9f};1" for x, z in profile)).encode(),
        "npy": single.getvalue(),
        "npz": archive.getvalue(),
        "x3p": (folder / "map.x3p").read_bytes(),
    }
    with zipfile.ZipFile(folder / "map.x3p") as packed:
        xml = packed.read("main.xml").replace(b"ISO5436_2", b"ISO5436")
        older = {
            "main.xml": re.sub(rb"<MD5.*?</MD5\w+>", b"", xml),
            "bindata/data.bin": packed.read("bindata/data.bin"),
        }
    files[OLDER_X3P] = instrument_files.archive(older)
    if INSTALLED:
        files |= {suffix: write(height) for suffix, write in instrument_files.WRITERS.items()}
    return files


def altered(content: bytes, count: int, seed: int) -> Iterator[bytes]:
    """Copies with flipped bits that archives do not betray: one entry after another is changed, and all are packed again."""
    entries, pack = instrument_files.parts(content)
    changes = {name: flips(entry, count, seed) for name, entry in entries.items() if entry}
    names = sorted(changes)
    for number in range(count):
        name = names[number % len(names)]
        yield pack(entries | {name: next(changes[name])})


def outcome(path: Path) -> str:
    """``refused`` with words, or ``read`` as a surface that can be one; any other exception is the test's failure."""
    suffix = path.suffix.removeprefix(".")
    try:
        surface = read_surface(path, **OPTIONS.get(suffix, {}))
    except InputError as error:
        refusal = str(error)
    else:
        check(surface)
        return "read"
    assert refusal.startswith(path.name)
    assert str(path.parent) not in refusal
    return "refused"


def check(surface: xr.Dataset) -> None:
    """What was read lies within the limits of a surface, beside what a warning names."""
    texture = parameters(level(surface))
    # The checks on reading take the mean slope away before, levelling after; a little room for that.
    gradient = float(texture.get("Sdq", texture.get("Rdq")))
    assert SLOPE_RANGE[0] / 2 < gradient < 2 * SLOPE_RANGE[1]
    assert float(texture.missing_fraction) <= 0.5
    # A lone height out of place may pass the rms slope, but not unsaid.
    steepest = max(float(np.nanmax(np.abs(np.diff(surface.height, axis=axis)))) for axis in range(surface.height.ndim))
    if steepest > STEP_WARN * max(surface.attrs[f"pitch_{dim}"] for dim in surface.height.dims):
        assert any("spike" in text for text in vocabulary.warnings(surface))
    for dim in surface.height.dims:
        assert PITCH_RANGE[0] <= surface.attrs[f"pitch_{dim}"] <= PITCH_RANGE[1]
        assert surface.attrs[f"pitch_{dim}"] * surface.sizes[dim] < EXTENT_MAX


def difference(surface: xr.Dataset, sound: xr.Dataset) -> str:
    """How a surface differs from the sound one: in more than a fiftieth of its pitch, or a fifth of the range of its heights, or not."""
    if surface.height.shape != sound.height.shape:
        return "another map"
    if any(abs(surface.attrs[f"pitch_{dim}"] / sound.attrs[f"pitch_{dim}"] - 1) > 0.02 for dim in sound.height.dims):
        return "another map"
    deviation = surface.height.values - sound.height.values
    deviation -= np.nanmedian(deviation)
    off = np.count_nonzero(np.abs(deviation) > 0.2 * np.ptp(sound.height.values))
    # At most eight bits are flipped in a copy.
    return "another map" if off > 8 else "a few heights" if off else ""


def flips(content: bytes, count: int, seed: int) -> Iterator[bytes]:
    """Copies with 1, 2, 4 … bits turned over, every other time within the first kilobyte, where the headers are."""
    rng = np.random.default_rng(seed)
    for number in range(count):
        data = np.frombuffer(content, np.uint8).copy()
        places = rng.integers(min(data.size, 1024) if number % 2 else data.size, size=2 ** (number % 4))
        data[places] ^= (1 << rng.integers(8, size=places.size)).astype(np.uint8)
        yield data.tobytes()


def test_the_sound_files_are_read(whole: Files, tmp_path: Path) -> None:
    for suffix, content in whole.items():
        (tmp_path / f"map.{suffix}").write_bytes(content)
        assert outcome(tmp_path / f"map.{suffix}") == "read"


def test_empty_files_and_random_bytes_are_refused(whole: Files, tmp_path: Path) -> None:
    rng = np.random.default_rng(11)
    for suffix in whole:
        for number, size in enumerate((0, 1, 12, 1000, 20000)):
            (tmp_path / f"{number}.{suffix}").write_bytes(rng.bytes(size))
            assert outcome(tmp_path / f"{number}.{suffix}") == "refused"


def test_files_under_the_extension_of_another_format_are_refused(whole: Files, tmp_path: Path) -> None:
    # Text is text under either of its extensions, and HFM is x, z and a third column to it.
    for suffix in whole:
        for other, content in whole.items():
            if other != suffix and not any({suffix, other} <= alike for alike in SAME_READER):
                (tmp_path / f"{other}.{suffix}").write_bytes(content)
                assert outcome(tmp_path / f"{other}.{suffix}") == "refused", f"{other} as {suffix}"


def test_cut_files_are_refused(whole: Files, tmp_path: Path) -> None:
    for suffix, content in whole.items():
        if suffix in TEXT:
            continue
        for share in (0.02, 0.3, 0.7, 0.95):
            (tmp_path / f"cut.{suffix}").write_bytes(content[: int(share * len(content))])
            assert outcome(tmp_path / f"cut.{suffix}") == "refused", f"{suffix} cut at {share}"


@pytest.mark.parametrize("suffix", TEXT)
def test_text_cut_within_a_row_is_refused_or_doubted(whole: Files, tmp_path: Path, suffix: str) -> None:
    # Text has no end to miss: cut between two rows, it is a file of fewer rows.
    content = whole[suffix]
    for share in (0.3, 0.7, 0.95):
        start = content.index(b"\n", int(share * len(content))) + 1
        end = content.index(b"\n", start)
        for cut in {*range(start + 1, min(start + 30, end)), *range(max(start + 1, end - 30), end)}:
            path = tmp_path / f"{cut}.{suffix}"
            path.write_bytes(content[:cut])
            if outcome(path) == "read":
                surface = read_surface(path, **OPTIONS.get(suffix, {}))
                assert any("may be truncated" in text for text in vocabulary.warnings(surface)), content[start:cut]


def test_real_text_that_is_cut_is_doubted_and_the_whole_is_not(shared_data: Path, tmp_path: Path) -> None:
    for name, share, options, doubt in (
        ("dektak-1.csv", 0.5, {"unit": "um"}, "The header states a length of 1500 um, the data have 782"),
        ("nanovea_test1.txt", 0.9, {"unit": "um", "lateral_unit": "mm"}, "The last row of points is incomplete"),
    ):
        whole, cut = shared_data / "surfaces" / name, tmp_path / name
        content = whole.read_bytes()
        cut.write_bytes(content[: int(share * len(content))])
        assert not any("may be truncated" in text for text in vocabulary.warnings(read_surface(whole, **options)))
        assert any(f"may be truncated. {doubt}" in text for text in vocabulary.warnings(read_surface(cut, **options)))


def test_files_with_flipped_bits_are_refused_or_still_surfaces(whole: Files, tmp_path: Path) -> None:
    for seed, (suffix, content) in enumerate(whole.items()):
        for number, damaged in enumerate(flips(content, 24, seed)):
            path = tmp_path / f"{number}.{suffix}"
            path.write_bytes(damaged)
            outcome(path)


@pytest.mark.cases(6)
@pytest.mark.parametrize("suffix", FORMATS)
def test_damage_that_the_reader_has_to_find_is_mostly_refused_or_warned_of(
    whole: Files, tmp_path: Path, suffix: str
) -> None:
    if suffix not in whole:
        pytest.skip("the instruments' formats are not installed")
    path = tmp_path / f"map.{suffix}"
    options = OPTIONS.get(suffix, {})
    path.write_bytes(whole[suffix])
    sound = read_surface(path, **options)
    found = []
    for damaged in altered(whole[suffix], COPIES, seed=2):
        path.write_bytes(damaged)
        if outcome(path) == "read":
            surface = read_surface(path, **options)
            if not {*vocabulary.warnings(surface)} - {*vocabulary.warnings(sound)}:
                found.append(difference(surface, sound))
    # X3P has check sums of its own.
    assert found.count("another map") <= (0 if suffix == "x3p" else MISREAD)
    assert found.count("a few heights") <= (0 if suffix == "x3p" else SPOILED)
    # Not all are stopped before they reach the reader.
    assert found


@pytest.mark.parametrize("name", REAL)
def test_damaged_real_files_are_refused_or_still_surfaces(shared_data: Path, tmp_path: Path, name: str) -> None:
    if not INSTALLED and Path(name).suffix not in (".x3p", ".hfm"):
        pytest.skip("the instruments' formats are not installed")
    content = (shared_data / "surfaces" / name).read_bytes()
    cuts = [content[: int(share * len(content))] for share in (0.001, 0.5)]
    for number, damaged in enumerate([*cuts, *flips(content, 6, len(name))]):
        path = tmp_path / f"{number}{Path(name).suffix}"
        path.write_bytes(damaged)
        outcome(path)
