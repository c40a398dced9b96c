"""Instruments' formats: the right orientation, unit and gaps from each, and words where the library has none."""

from __future__ import annotations

import sys
import tracemalloc
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import instrument_files
import numpy as np
import pytest
import xarray as xr

from brdfpipe import facets, vocabulary
from brdfpipe.errors import InputError
from brdfpipe.report.plots.raster import false_colour
from brdfpipe.surfaces import ingest, instruments, level, parameters, read_surface
from brdfpipe.surfaces.reading import check_readable


@pytest.fixture
def library() -> Any:
    return pytest.importorskip("SurfaceTopography.IO", reason="the extra `instruments` is not installed")


@pytest.mark.usefixtures("library")
@pytest.mark.parametrize("suffix", instrument_files.WRITERS)
def test_a_map_keeps_its_orientation_its_scale_and_its_gaps(
    tmp_path: Path, asymmetric: xr.Dataset, suffix: str
) -> None:
    height = asymmetric.height.values
    path = tmp_path / f"map.{suffix}"
    path.write_bytes(instrument_files.WRITERS[suffix](height))
    surface = read_surface(path)
    expected = height if suffix in instrument_files.MARKS_MISSING else np.nan_to_num(height, nan=np.nanmin(height))
    if suffix in instrument_files.COUNTS:
        expected = expected - expected.min()
    # Integers of 1e-4 um, or single precision.
    np.testing.assert_allclose(surface.height, expected, rtol=0, atol=5.1e-5)
    pitch_x, pitch_y = instrument_files.PITCH
    pitches = (pitch_x, pitch_x if suffix in instrument_files.SQUARE else pitch_y)
    assert (surface.attrs["pitch_x"], surface.attrs["pitch_y"]) == pytest.approx(pitches, rel=1e-6)


@pytest.mark.usefixtures("library")
@pytest.mark.parametrize("suffix", sorted(instrument_files.POINTS))
def test_a_header_that_claims_a_milliard_points_is_refused(tmp_path: Path, asymmetric: xr.Dataset, suffix: str) -> None:
    path = tmp_path / f"map.{suffix}"
    for change in instrument_files.POINTS[suffix]:
        path.write_bytes(change(instrument_files.WRITERS[suffix](asymmetric.height.values)))
        tracemalloc.start()
        with pytest.raises(InputError, match=rf"^map\.{suffix}: "):
            read_surface(path)
        assert tracemalloc.get_traced_memory()[1] < 2**26
        tracemalloc.stop()


@pytest.mark.usefixtures("library")
def test_archives_of_instruments_with_entities_or_beyond_the_limit_are_refused(
    tmp_path: Path, asymmetric: xr.Dataset
) -> None:
    bomb = '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]>'
    for suffix in ("plux", "zon"):
        content = instrument_files.WRITERS[suffix](asymmetric.height.values)
        path = tmp_path / f"map.{suffix}"
        path.write_bytes(instrument_files.with_prolog(content, bomb))
        with pytest.raises(InputError, match=r"EntitiesForbidden|DTDForbidden"):
            read_surface(path)
        path.write_bytes(instrument_files.with_prolog(content, '<?xml version="1.0"?>'))
        read_surface(path)
        path.write_bytes(instrument_files.with_entry(content, "more", bytes(2**26)))
        with pytest.raises(InputError, match="suspiciously large"):
            read_surface(path)


@pytest.mark.usefixtures("library")
def test_the_unit_of_a_format_that_states_none_is_asked_for(shared_data: Path) -> None:
    path = shared_data / "surfaces" / "tmd-1.tmd"
    assumed, stated = read_surface(path), read_surface(path, unit="um")
    (warning,) = vocabulary.warnings(assumed)
    assert "read in mm, which gives a pitch of 63.19 x 63.19 um" in warning
    assert vocabulary.warnings(stated) == vocabulary.warnings(read_surface(path, unit="mm")) == []
    assert stated.attrs["pitch_x"] == pytest.approx(assumed.attrs["pitch_x"] / 1000)
    np.testing.assert_allclose(stated.height, assumed.height / 1000, rtol=1e-12)
    np.testing.assert_array_equal(read_surface(path, unit="mm").height, assumed.height)


@pytest.mark.usefixtures("library")
@pytest.mark.parametrize(
    ("name", "options", "shape", "pitch", "heights", "slope", "missing"),
    [
        ("opd-1.opd", {}, (480, 640), (0.1967, 0.1967), 0.0067, 0.0181, 0.0004),
        ("al3d-1.al3d", {}, (296, 200), (0.438, 0.438), 0.290, 0.090, 0),
        ("plu-1.plu", {}, (576, 768), (1.66, 1.66), 0.0183, 0.0046, 0),
        ("frt-1.frt", {}, (500, 500), (24, 24), 4.40, 0.0126, 0.3058),
        ("x3p-2.x3p", {}, (650, 650), (0.1277, 0.3146), 0.077, 0.062, 0),
        ("dektak-1.csv", {"unit": "um"}, (9600,), (0.15625,), 0.094, 0.0095, 0),
        ("hfm-1.hfm", {}, (9600,), (0.5,), None, None, 0),
        ("mitutoyo_2_mock.xlsx", {}, (6664,), (1.5,), None, None, 0),
        ("nms-2.nms", {}, (512, 512), (0.3125, 0.3125), None, None, 0),
        ("nanovea_test1.txt", {"unit": "um", "lateral_unit": "mm"}, (101, 101), (5, 5), None, None, 0),
    ],
)
def test_real_files_give_the_known_roughness(
    shared_data: Path,
    name: str,
    options: dict[str, str],
    shape: tuple[int, ...],
    pitch: tuple[float, ...],
    heights: float | None,
    slope: float | None,
    missing: float,
) -> None:
    surface = read_surface(shared_data / "surfaces" / name, **options)
    assert surface.height.shape == shape
    assert [surface.attrs[f"pitch_{dim}"] for dim in ("x", "y")[: len(shape)]] == pytest.approx(pitch, rel=1e-3)
    texture = parameters(level(surface))
    assert float(texture.missing_fraction) == pytest.approx(missing, abs=5e-5)
    if heights is not None:
        letter = "S" if len(shape) == 2 else "R"
        # Reference values, levelled by a plane and taken over four triangles, are given to two or three digits.
        assert float(texture[f"{letter}q"]) == pytest.approx(heights, rel=0.02)
        assert float(texture[f"{letter}dq"]) == pytest.approx(slope, rel=0.02)


@pytest.mark.usefixtures("library")
def test_the_real_al3d_map_has_the_orientation_of_its_bytes(shared_data: Path) -> None:
    path = shared_data / "surfaces" / "al3d-1.al3d"
    # The depth image stands before the texture, row by row, at an offset its tags name.
    content = path.read_bytes()
    offset = int(content[content.index(b"DepthImageOffset") + 20 :][:30].strip(b"\0 "))
    raw = np.frombuffer(content, "<f4", 200 * 296, offset).reshape(296, 200) * 1e6
    surface = read_surface(path)
    # The bytes run from the upper edge of the picture down, y runs up.
    np.testing.assert_allclose(surface.height, raw[::-1], rtol=1e-6)
    picture, _ = false_colour(surface.height.values, float(raw.min()), float(raw.max()))
    assert np.corrcoef(picture.ravel(), raw.ravel())[0, 1] > 0.999


@pytest.mark.usefixtures("library")
def test_the_lay_of_the_real_al3d_map_is_that_of_its_camera_picture(shared_data: Path) -> None:
    path = shared_data / "surfaces" / "al3d-1.al3d"
    lay = float(facets.estimate(level(read_surface(path)))["lay"])
    # The camera's picture of the same spot stands in the file too, from its upper edge down; its scratches rise to the right.
    picture = np.frombuffer(path.read_bytes(), np.uint8, 296 * 200, 238061).reshape(296, 200).astype(float)
    gradients = np.stack([np.diff(picture, axis=1)[:-1].ravel(), -np.diff(picture, axis=0)[:, :-1].ravel()])
    _, axes = np.linalg.eigh(np.cov(gradients))
    along = np.degrees(np.arctan2(axes[1, 0], axes[0, 0]))
    # 42 degree by brightness and 49 by height, which are not the same; mirrored, heights would lie along 131.
    assert abs((lay - along + 90) % 180 - 90) < 20


@pytest.mark.usefixtures("library")
def test_a_third_missing_stays_missing_through_the_whole_stage(shared_data: Path) -> None:
    path = shared_data / "surfaces" / "frt-1.frt"
    gaps = np.isnan(read_surface(path).height.values)
    surface = ingest(path, {"form": "polynomial-2", "lambda_s": 100.0, "lambda_c": 2500.0})
    np.testing.assert_array_equal(np.isnan(surface.height), gaps)
    assert surface.attrs["levelling"] == "polynomial-2"
    assert surface.attrs["band"] == "24 um pitch; λs 100 um, λc 2500 um filter"
    assert 0 < float(parameters(surface).Sq) < 4.40


@pytest.mark.usefixtures("library")
def test_an_assumed_unit_of_the_pitch_of_an_nms_file_is_warned_about(shared_data: Path) -> None:
    (warning,) = vocabulary.warnings(read_surface(shared_data / "surfaces" / "nms-2.nms"))
    assert "states the pitch 312.5 x 312.5 without a unit. It was read in nm" in warning
    assert "set `surface.lateral_unit`" in warning


@pytest.mark.usefixtures("library")
def test_a_stated_unit_of_the_pitch_of_an_nms_file_is_used(shared_data: Path) -> None:
    path = shared_data / "surfaces" / "nms-2.nms"
    confirmed = ingest(path, {"file": "nms-2.nms", "lateral_unit": "nm"})
    assert confirmed.attrs["pitch_x"] == pytest.approx(0.3125)
    assert vocabulary.warnings(confirmed) == []
    assert instruments._of_unstated_unit([312.5e3], "um", path) == ([312.5], ())
    with pytest.raises(InputError, match=r"unknown unit; found 'inch'.*`surface\.lateral_unit`"):
        read_surface(path, lateral_unit="inch")


def test_a_plausible_pitch_of_an_nms_file_is_not_converted() -> None:
    for pitches in ([0.5, 0.7], [5e8, 0.7]):
        assert instruments._of_unstated_unit(pitches, None, Path("map.nms")) == (pitches, ())


@pytest.mark.usefixtures("library")
def test_a_unit_of_the_pitch_is_refused_for_a_format_that_states_it(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"surface\.lateral_unit: this key does not apply to the format"):
        read_surface(tmp_path / "map.opd", lateral_unit="nm")


@pytest.mark.usefixtures("library")
def test_every_format_is_one_the_library_reads(library: Any) -> None:
    for name, instrument in instruments.INSTRUMENTS.items():
        known = library.lookup_reader_by_format[name].file_extensions()
        assert {suffix.removeprefix(".") for suffix in instrument.extensions} <= set(known)


def test_without_the_extra_the_refusal_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "SurfaceTopography.IO", None)
    (tmp_path / "map.opd").write_bytes(b"x")
    with pytest.raises(InputError, match=r"^map\.opd: .*not installed.*pip install 'brdfpipe\[instruments\]'"):
        read_surface(tmp_path / "map.opd")


def test_a_missing_extra_is_reported_before_anything_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "SurfaceTopography", None)
    with pytest.raises(InputError, match=r"^map\.opd: .*not installed.*pip install 'brdfpipe\[instruments\]'"):
        check_readable("absent/map.opd")
    with pytest.raises(InputError, match="not installed"):
        check_readable("map.dat", "metropro")
    check_readable("map.dat")
    check_readable("map.x3p")


def test_the_library_is_not_imported_for_other_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "SurfaceTopography.IO", None)
    (tmp_path / "line.txt").write_text("\n".join(f"{np.sin(i / 5):.6f}" for i in range(100)))
    assert read_surface(tmp_path / "line.txt", unit="um", pitch=1).sizes["x"] == 100


@pytest.mark.usefixtures("library")
def test_a_file_of_another_kind_is_refused_in_words(tmp_path: Path) -> None:
    (tmp_path / "map.opd").write_text("not at all")
    with pytest.raises(
        InputError, match=r"^map\.opd: not a Wyko OPD file, or damaged.*accepted: a whole Wyko OPD file"
    ):
        read_surface(tmp_path / "map.opd")
    with pytest.raises(InputError, match=r"^absent\.opd: cannot be read"):
        read_surface(tmp_path / "absent.opd")


@pytest.mark.usefixtures("library")
def test_messages_name_no_key_that_cannot_help(shared_data: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="too few points") as refused:
        read_surface(shared_data / "surfaces" / "sdf-1.sdf")
    assert "set `" not in str(refused.value)
    with zipfile.ZipFile(tmp_path / "map.plux", "w") as archive:
        archive.writestr("index.xml", "<xml></xml>")
    with pytest.raises(InputError, match=r"damaged.*accepted: a whole Sensofar PLUX file") as refused:
        read_surface(tmp_path / "map.plux")
    assert "set `" not in str(refused.value)
    with zipfile.ZipFile(tmp_path / "stripped.plux", "w") as archive:
        archive.writestr("LAYER_0.raw", bytes(400))
    with pytest.raises(InputError, match=r"`index\.xml` is missing.*accepted: a whole Sensofar PLUX file") as refused:
        read_surface(tmp_path / "stripped.plux")
    assert "set `" not in str(refused.value)


def channel(name: str, values: np.ndarray, **changes: Any) -> SimpleNamespace:
    """What the library hands out for a channel of heights, x first."""
    properties: dict[str, Any] = {
        "unit": "nm",
        "is_uniform": True,
        "nb_grid_pts": values.shape,
        "physical_sizes": [500.0 * count for count in values.shape],
        "heights": lambda: values,
    }
    topography = SimpleNamespace(**{**properties, **changes})
    kind = SimpleNamespace(name=changes.get("kind", "HEIGHT"))
    return SimpleNamespace(name=name, data_kind=kind, nb_grid_pts=topography.nb_grid_pts, topography=lambda: topography)


@pytest.fixture
def rigged(library: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Read a file for which the library hands out the channels given."""

    def read(*channels: SimpleNamespace, **options: Any) -> xr.Dataset:
        reader = SimpleNamespace(channels=list(channels))
        monkeypatch.setitem(library.lookup_reader_by_format, "opd", lambda handle: reader)
        (tmp_path / "map.opd").write_bytes(b"x")
        return read_surface(tmp_path / "map.opd", **options)

    return read


@pytest.fixture
def values(asymmetric: xr.Dataset) -> np.ndarray:
    return np.nan_to_num(asymmetric.height.values.T * 1e3)


def test_masked_and_infinite_heights_are_missing(rigged: Any, values: np.ndarray) -> None:
    values[1, 2], values[3, 4] = np.inf, -np.inf
    mask = np.zeros(values.shape, dtype=bool)
    mask[5, 6] = True
    surface = rigged(channel("Raw", np.ma.masked_array(values, mask)))
    assert np.argwhere(np.isnan(surface.height.values)).tolist() == [[33, 5], [35, 3], [37, 1]]
    assert "2 infinite heights taken as missing." in surface.attrs["history"]


def test_the_first_height_channel_is_taken_unless_one_is_named(rigged: Any, values: np.ndarray) -> None:
    channels = [
        channel("Light", values, kind="OTHER"),
        channel("Forward", values),
        channel("Backward", 2 * values),
    ]
    first, named = rigged(*channels), rigged(*channels, channel="Backward")
    np.testing.assert_allclose(first.height, values.T[::-1] * 1e-3, rtol=1e-12)
    np.testing.assert_allclose(named.height, values.T[::-1] * 2e-3, rtol=1e-12)
    assert "first of the height channels Forward, Backward" in first.attrs["history"]
    with pytest.raises(InputError, match=r"unknown height channel; found 'Light'.*Forward, Backward.*surface\.channel"):
        rigged(*channels, channel="Light")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "PHASE"}, "no height channel in the file; found 1 channels"),
        ({"unit": None}, "does not state a unit of length"),
        ({"unit": "V"}, "does not state a unit of length; found 'V'"),
        ({"physical_sizes": None}, "does not state a pitch"),
        ({"physical_sizes": [5e9, 5e9]}, "implausible pitch along ."),
        ({"is_uniform": False}, "unevenly spaced"),
        ({"nb_grid_pts": (10**6, 10**6)}, "too many points"),
        ({"heights": lambda: np.zeros((50, 40))}, "quantised to a few levels"),
        ({"heights": lambda: 1 / 0}, "not a Wyko OPD file, or damaged; found ZeroDivisionError"),
    ],
)
def test_results_of_the_library_are_checked(
    rigged: Any, values: np.ndarray, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        rigged(channel("Raw", values, **changes))


@pytest.mark.parametrize("shape", [(-1,), (-1, 1), (1, -1)])
def test_one_row_is_a_line(rigged: Any, values: np.ndarray, shape: tuple[int, ...]) -> None:
    surface = rigged(channel("Raw", values.reshape(shape)))
    assert surface.height.dims == ("x",)


def test_a_zip_bomb_is_refused_before_the_library_sees_it(library: Any, tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "map.plux", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("index.xml", bytes(2**25))
    with pytest.raises(InputError, match="suspiciously large"):
        read_surface(tmp_path / "map.plux")
