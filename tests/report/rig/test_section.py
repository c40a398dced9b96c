from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import xarray as xr
from samples import beckmann_bsdf, spectrum

from brdfpipe import store, vocabulary
from brdfpipe.bsdf.lambert_gauss import lambertian
from brdfpipe.bsdf.measured import completion, smoothing
from brdfpipe.report import rendering
from brdfpipe.report.cards import Chapter, Table
from brdfpipe.report.plots import indicatrix
from brdfpipe.report.plots.svg import Figure
from brdfpipe.report.rig import figures, fit, reciprocity, section
from brdfpipe.rig.description import Rig
from brdfpipe.rig.reduction import cells as rig_cells
from brdfpipe.rig.reduction import thumbnails
from brdfpipe.rig.reduction.budget import dominant
from brdfpipe.rig.reduction.control_chart import chart_points
from brdfpipe.rig.templates import start
from brdfpipe.specular_directions import cos_view

Datasets = dict[str, xr.Dataset]

INCIDENCES = (10.0, 45.0)
WAVELENGTHS = (500.0, 550.0)


@pytest.fixture(scope="session")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    """A rig of full size: 150 fibres, 320 × 240 pixels."""
    folder = tmp_path_factory.mktemp("bench")
    start(folder)
    return Rig.load(folder / "rig.yaml")


@pytest.fixture(scope="session")
def run(bench: Rig) -> Datasets:
    return _run(bench)


@pytest.fixture(scope="session")
def chapter(run: Datasets) -> Chapter:
    return _chapter(run)


@pytest.fixture(scope="session")
def six(bench: Rig) -> Datasets:
    return _run(bench, (10.0, 20.0, 30.0, 45.0, 60.0, 70.0))


def _run(bench: Rig, incidences: tuple[float, ...] = INCIDENCES, **options) -> Datasets:
    """The results of the stages for a plastic: a lobe of 10 sr⁻¹ and 3° on a base of 0.1 sr⁻¹, with the noise that is stated."""
    primary = _primary(bench, incidences, **options)
    smoothed = smoothing.smooth(primary, strength=5.0, about="mirror")
    reduced = {
        f"reduced-sample-reflection-{incidence:g}": _reduced(bench, primary, incidence) for incidence in incidences
    }
    return {
        **reduced,
        "calibration": _calibration(bench),
        "primary-reflection": primary,
        "smoothed-reflection": smoothed,
        "bsdf": completion.complete(smoothed, reciprocity=False),
    }


def _primary(
    bench: Rig, incidences: tuple[float, ...], *, noise: float = 0.02, common: float = 0.005, lean: float = 0.0
) -> xr.Dataset:
    cells = rig_cells.cells_of(bench)
    dims = ("incidence", "wavelength", "cell")
    truth = 0.1 + 10 * np.exp(-(cells.theta_s**2) / 18)
    truth = truth * (1 + lean * np.sin(np.radians(cells.phi_s)) * cells.of_disc)
    truth = np.broadcast_to(truth, (len(incidences), len(WAVELENGTHS), truth.size))
    seen = np.broadcast_to(
        (cos_view(np.array(incidences)[:, None], cells.theta_s, cells.phi_s) > 0)[:, None], truth.shape
    )
    value = truth * (1 + noise * np.random.default_rng(0).standard_normal(truth.shape))
    quality = np.where(seen, vocabulary.quality("measured"), vocabulary.quality("shadowed")).astype(np.int8)
    fields = {"brdf": value, "brdf_u": truth * np.hypot(noise, common)}
    parts = {"noise": (noise, "independent"), "certificate": (common, "common")}
    variables = {name: (dims, np.where(seen, field, np.nan)) for name, field in fields.items()}
    variables |= {
        f"brdf_u_{name}": (dims, np.where(seen, share * truth, np.nan), {"correlation": correlation})
        for name, (share, correlation) in parts.items()
    }
    coords = {"cell": np.array(cells.names), "kind": ("cell", np.array(cells.kinds))}
    coords |= {name: ("cell", getattr(cells, name)) for name in ("theta_s", "phi_s", "solid_angle")}
    coords |= {"incidence": np.array(incidences), "wavelength": np.array(WAVELENGTHS)}
    attrs = {"rig": "bench-1", "rig_digest": "0", "sample": "tile", "day": "2026-03-12", "side": "reflection"}
    attrs |= {"certificate": "PTB-1", "calibrated": "2026-03-02"}
    primary = xr.Dataset({**variables, "brdf_quality": (dims, quality)}, coords, attrs)
    return vocabulary.validate(vocabulary.label(primary, "primary"), "primary")


def _reduced(bench: Rig, primary: xr.Dataset, incidence: float) -> xr.Dataset:
    own = primary.sel(incidence=[incidence])
    weights = rig_cells.weights(bench, bench.screen)
    light = np.nan_to_num(own["brdf"].values[0].mean(axis=0))
    picture = (weights.T @ light).reshape(bench.camera.height, bench.camera.width)
    elapsed = 60 * (incidence + np.array([0.0, 5.0]))
    looks = {
        "drift_elapsed": ("look", elapsed),
        "drift_wavelength": ("look", np.full(2, 550.0)),
        "drift_reference": ("look", 9e4 * (1 + elapsed / 1e5)),
        "drift_reference_u": ("look", np.full(2, 90.0)),
    }
    # Between the readings; at 500 nm there is more light, which is no drift.
    time = elapsed.mean() + np.array([[-30.0, 30.0]])
    bracket = {
        "elapsed": time,
        "reference": [9.9e4, 9e4] * (1 + time / 1e5),
        "reference_u": np.full((1, len(WAVELENGTHS)), 50.0),
    }
    spectral = ("incidence", "wavelength")
    reduced = xr.Dataset(
        {"signal": own["brdf"]} | {name: (spectral, values) for name, values in bracket.items()}
    ).drop_attrs()
    reduced = reduced.assign(thumbnails.drawing(picture, bench, bench.screen, weights)).assign(looks)
    attrs = {**own.attrs, "load": "sample", "camera": "ASI 174", "registration_spots": 99, "registration_u": 0.002}
    attrs |= {"registration_shift": [0.3, -0.4], "disc_centre_u": 0.003}
    attrs.pop("kind")
    return vocabulary.validate(vocabulary.label(reduced.assign_attrs(attrs), "reduced"), "reduced")


def _calibration(bench: Rig, changes: tuple[float, ...] = (0.0, 0.004, -0.002)) -> xr.Dataset:
    """A profile at the end of a chart of levels; the spectrum of the last one leans by half of its own."""
    cells = rig_cells.cells_of(bench)
    scale = np.ones((len(WAVELENGTHS), len(cells.names)))
    scale[:, 3] = np.nan  # F004, which faces the etalon
    coords = {"cell": np.array(cells.names), "kind": ("cell", np.array(cells.kinds))}
    coords |= {name: ("cell", getattr(cells, name)) for name in ("theta_s", "phi_s")}
    coords |= {"incidence": np.array([10.0]), "wavelength": np.array(WAVELENGTHS)}
    fields = {
        "cell_scale": (("wavelength", "cell"), scale),
        "path": (("incidence", "wavelength"), np.ones((1, len(WAVELENGTHS)))),
    }
    attrs = {"certificate": "PTB-1", "day": "2026-03-02", "rig_digest": "0", "valid_days": 90}
    profile = xr.Dataset({**fields, "lamp": ("wavelength", np.full(len(WAVELENGTHS), 9e4))}, coords, attrs)
    change = np.outer(changes, np.ones(len(WAVELENGTHS)))
    change[-1] += 0.5 * np.abs(changes[-1]) * np.array([1, -1])
    count = len(changes)
    names, days = (np.array([f"{word}{number}" for number in range(1, count + 1)]) for word in ("bench-", "2026-03-0"))
    profile = profile.assign(chart_points(names, days, change, profile["wavelength"].values))
    return vocabulary.validate(vocabulary.label(profile, "calibration"), "calibration")


def _chapter(datasets: Datasets) -> Chapter:
    chapter = section.chapter(datasets)
    assert chapter is not None
    return chapter


def _part(chapter: Chapter, title: str) -> Figure | Table | None:
    return next((part for part in chapter.parts if title in part.title), None)


def _coverage(datasets: Datasets) -> Table:
    return section.coverage_table(section.sides(datasets), datasets.get("calibration"), 2)


def _measurement(datasets: Datasets) -> Table:
    return section.measurement_table(section.sides(datasets), datasets.get("calibration"))


def _drift(datasets: Datasets) -> Figure:
    return figures.drift([arrangement for side in section.sides(datasets) for arrangement in side.reduced])


def _frames(datasets: Datasets) -> Figure:
    sides = section.sides(datasets)
    pictures = [picture for side in sides for at in range(2) for picture in section._pictures(side, at)]
    drawn = figures.frames(pictures)
    assert drawn is not None
    return drawn


def _fits(chapter: Chapter) -> list[Figure]:
    return [part for part in chapter.parts if "in the plane, fit against data" in part.title]


def _page(datasets: Datasets) -> str:
    return rendering.render("chapter.html.j2", chapter=section.chapter(datasets))


def _figures(chapter: Chapter) -> list[Figure]:
    return [part for part in chapter.parts if isinstance(part, Figure)]


def _paths(svg: object, style: str) -> list[str]:
    return re.findall(rf'<path class="{re.escape(style)}" d="([^"]*)"', str(svg))


def _points(data: str) -> np.ndarray:
    """Absolute points of a path of M and L."""
    return np.array([[float(x) for x in pair.split()] for pair in re.split("[MLZ]", data) if pair.strip()])


def _rows(table: Table) -> dict[str, tuple[str, ...]]:
    return {row[0]: tuple(row[1:]) for row in table.rows}


# --- the chapter


def test_a_material_that_no_rig_measured_has_no_chapter() -> None:
    assert section.chapter({"bsdf": beckmann_bsdf()}) is None


def test_every_figure_is_well_formed(chapter: Chapter) -> None:
    figures = _figures(chapter)
    assert len(figures) == 13
    for figure in figures:
        ElementTree.fromstring(f"<div>{figure.svg}</div>")
        drawn = re.sub(r"base64,[^\"]*", "", str(figure.svg))
        assert drawn.count("<svg") >= 1
        assert not re.search(r"nan|inf\b", drawn)


def test_six_incidences_take_less_than_165_kb_and_the_data_of_their_charts_40_kb(six: Datasets) -> None:
    page = _page(six).encode()
    data = sum(map(len, re.findall(b"<metadata>.*?</metadata>", page, re.DOTALL)))
    assert 0 < data < 40_000
    assert len(page) - data < 165_000


def test_equal_data_gives_equal_bytes_also_when_stored(run: Datasets, tmp_path: Path) -> None:
    stored = {}
    for name, dataset in run.items():
        store.save_dataset(dataset, tmp_path / f"{name}.nc", stage=name, material="m")
        stored[name] = store.open_dataset(tmp_path / f"{name}.nc")
    page = _page(run)
    assert page == _page(run)
    assert page == _page(stored)


def test_a_notice_states_that_frames_are_emulated(run: Datasets) -> None:
    assert "not measured" not in _page(run)
    made = {name: dataset.assign_attrs(camera="emulated camera, 320 x 240 pixels") for name, dataset in run.items()}
    assert section.emulated(made)
    assert re.search(r'class="notice fail"[^>]*><h2>Made by the emulator, not measured</h2>', _page(made))


def test_text_from_files_is_never_markup(run: Datasets) -> None:
    evil = "<img src=x onerror=alert(1)>"
    datasets = dict(run)
    for name in ("primary-reflection", "reduced-sample-reflection-10"):
        attrs = {"rig": evil, "sample": evil, "day": evil, "certificate": evil, "overridden": evil, "camera": evil}
        datasets[name] = vocabulary.add_warning(datasets[name].assign_attrs(attrs), f"look at {evil}")
    names = run["calibration"]["cell"].values.astype("U40")
    names[3] = evil
    datasets["calibration"] = run["calibration"].assign_coords(cell=names)
    page = _page(datasets)
    assert "<img" not in page
    assert page.count("&lt;img") >= 6


def test_warnings_of_the_stages_appear_once_unless_the_bsdf_repeats_them(run: Datasets) -> None:
    datasets = dict(run)
    for name in ("reduced-sample-reflection-10", "primary-reflection"):
        datasets[name] = vocabulary.add_warning(datasets[name], "frame 7 is damaged; take it again", "known")
    datasets["bsdf"] = vocabulary.add_warning(datasets["bsdf"], "known")
    assert list(_chapter(datasets).warnings) == ["frame 7 is damaged; take it again"]


def test_at_most_five_fits_are_shown_and_the_note_states_the_number(six: Datasets) -> None:
    chapter = _chapter(six)
    assert [figure.title.split("°")[0] for figure in _fits(chapter)] == ["10", "20", "30", "60", "70"]
    coverage, frames = _part(chapter, "Coverage and fit"), _part(chapter, "Camera pictures")
    assert isinstance(coverage, Table)
    assert len(coverage.rows) == 6
    assert "5 of the 6 incidences" in coverage.note
    assert isinstance(frames, Figure)
    assert frames.full
    assert str(frames.svg).count("<figcaption>") == 6


def test_both_sides_of_a_sample_have_their_parts(run: Datasets) -> None:
    other = {
        name.replace("reflection", "transmission"): dataset.assign_attrs(side="transmission")
        for name, dataset in run.items()
        if "reflection" in name
    }
    chapter = _chapter({**run, **other})
    assert sum("BTDF" in figure.title for figure in _fits(chapter)) == 2
    assert sum("BRDF" in figure.title for figure in _fits(chapter)) == 2
    coverage = _part(chapter, "Coverage and fit")
    assert isinstance(coverage, Table)
    assert [row[0] for row in coverage.rows] == [
        f"{incidence:g}° {side}" for side in ("reflection", "transmission") for incidence in INCIDENCES
    ]


def test_data_without_pictures_and_monitor_readings_has_a_chapter(run: Datasets) -> None:
    bare = {
        name: dataset.drop_vars(["picture", "elapsed", "reference_u"], errors="ignore").drop_dims(
            "look", errors="ignore"
        )
        for name, dataset in run.items()
        if name != "calibration"
    }
    chapter = _chapter(bare)
    assert _part(chapter, "Camera pictures") is None
    assert "`drift.every`" in _drift(bare).note
    assert "Dead" not in _coverage(bare).note


# --- tables


def test_the_measurement_table_states_the_age_of_the_profile(run: Datasets) -> None:
    measurement = _measurement(run)
    rows = _rows(measurement)
    assert rows["Calibration profile"] == ("of 2026-03-02, 10 days before; valid for 90 days",)
    assert rows["Certificate"] == ("PTB-1",)
    assert rows["Cells"] == ("150 fibres, 376 of the disc",)
    assert rows["Largest shift"] == ("0.50 ± 0.002 px, by 99 spots or more",)
    assert measurement.remark == ""


def test_a_remark_states_that_the_profile_was_overridden(run: Datasets) -> None:
    primary = run["primary-reflection"].assign_attrs(overridden="the profile has expired")
    measurement = _measurement({**run, "primary-reflection": primary})
    assert "the profile has expired" in measurement.remark
    assert "Measure the etalon again" in measurement.remark


def test_the_counts_of_cells_add_up_to_all_of_them(run: Datasets) -> None:
    coverage = _coverage(run)
    for row in coverage.rows:
        counts = dict(zip(coverage.header, row, strict=True))
        parts = [int(counts[name]) for name in ("Fitted", "Saturated", "Below horizon", "Otherwise left out")]
        assert sum(parts) == run["primary-reflection"].sizes["cell"]
        assert parts[2] > 0


def test_saturated_cells_and_cells_below_noise_are_counted(run: Datasets) -> None:
    primary = run["primary-reflection"].copy(deep=True)
    quality = primary["brdf_quality"].values
    quality[0, :, 160:170] = vocabulary.quality("saturated")
    quality[0, :, 170:175] = vocabulary.quality("below_noise")
    smoothed = smoothing.smooth(primary, strength=5.0, about="mirror")
    datasets = {**run, "primary-reflection": primary, "smoothed-reflection": smoothed}
    coverage = _coverage(datasets)
    first, second = (dict(zip(coverage.header, row, strict=True)) for row in coverage.rows)
    assert (first["Saturated"], first["Fitted, below noise"]) == ("10", "5")
    assert (second["Saturated"], second["Fitted, below noise"]) == ("0", "0")


def test_dead_fibres_are_named_but_not_fibres_that_do_not_see_the_etalon(run: Datasets) -> None:
    note = _coverage(run).note
    assert "without light from the etalon: F004." in note
    profile = run["calibration"].copy(deep=True)
    profile["cell_scale"].values[:, [3, 149]] = 1.0, np.nan  # F150 looks from 88°, away from the etalon's normal
    profile["phi_s"].values[149] = 180.0
    note = _coverage({**run, "calibration": profile}).note
    assert "No fibre is dead" in note
    assert "1 fibres see the etalon at grazing angles" in note


def test_a_remark_names_fits_with_few_cells(run: Datasets) -> None:
    smoothed = run["smoothed-reflection"].copy(deep=True)
    assert _coverage(run).remark == ""
    smoothed["residual"].values[1, :, 100:] = np.nan
    remark = _coverage({**run, "smoothed-reflection": smoothed}).remark
    assert "45° (" in remark
    assert "10° (" not in remark
    assert "`bracket`" in remark


def test_a_remark_states_that_the_two_sides_of_the_plane_of_incidence_differ(bench: Rig) -> None:
    leaning = _run(bench, lean=0.05)
    remark = _coverage(leaning).remark
    assert "`rig.smoothing.isotropic: false` and `mirror_symmetric: false`" in remark
    free = smoothing.smooth(
        leaning["primary-reflection"], strength=5.0, about="mirror", isotropic=False, mirror_symmetric=False
    )
    assert "symmetric" not in _coverage({**leaning, "smoothed-reflection": free}).remark


# --- pictures


def test_each_fibre_is_outlined_once_in_the_style_of_its_state(run: Datasets) -> None:
    datasets = {name: dataset for name, dataset in run.items() if name != "reduced-sample-reflection-45"}
    primary, smoothed = run["primary-reflection"], run["smoothed-reflection"].copy(deep=True)
    smoothed["residual"].values[0, :, 7] = np.nan
    frames = _frames({**datasets, "smoothed-reflection": smoothed})
    drawn = {name: "".join(_paths(frames.svg, f"cells {style}")).count("z") for name, style in figures.STYLES.items()}
    hidden = int((cos_view(10.0, primary["theta_s"].values, primary["phi_s"].values) <= 0).sum())
    assert drawn == {figures.FITTED: 149 - hidden, figures.HIDDEN: hidden, figures.LEFT_OUT: 1}
    rings = run["reduced-sample-reflection-10"]["ring_radius"]
    assert _paths(frames.svg, "v")[0].count("z") == int((rings > 0).sum())


def test_an_outline_is_a_circle_about_the_fibre(run: Datasets) -> None:
    datasets = {name: dataset for name, dataset in run.items() if name != "reduced-sample-reflection-45"}
    frames = _frames(datasets)
    steps = re.findall(r"m(-?\d+)([+-]\d+)a(\d+) ", "".join(_paths(frames.svg, "cells fit")))
    starts = np.array(steps, dtype=int)[:, :2].cumsum(axis=0).T / 2
    reduced = run["reduced-sample-reflection-10"]
    fitted = np.isfinite(run["smoothed-reflection"]["residual"].values[0, 0, :150])
    # The path starts on top of each circle; all is to half a pixel.
    assert starts[0] == pytest.approx(reduced["column"].values[:150][fitted], abs=0.26)
    top = reduced["row"].values[:150] - reduced["aperture"].values[:150]
    assert starts[1] == pytest.approx(top[fitted], abs=0.51)


# --- the lamp


def test_the_drift_of_the_lamp_is_relative_to_its_first_reading(run: Datasets) -> None:
    figure = _drift(run)
    # From 10 to 50 minutes, at 1e-5 a second on 1.006; two readings and a bracket of each incidence.
    assert "at 550\u202fnm: 6 values" in figure.note
    assert f"{100 * 2400e-5 / 1.006:.1f}\u202f%" in figure.note
    assert [label for _, _, label in figure.legend] == ["10°", "45°"]
    line = _points(_paths(figure.svg, "l ref")[0])
    # What grows evenly lies on one line, readings and brackets alike.
    slope, start = np.polyfit(line[:, 0], line[:, 1], 1)
    assert line[:, 1] == pytest.approx(start + slope * line[:, 0], abs=0.2)
    for style in ("c0", "c2"):
        assert _paths(figure.svg, f"p {style}")[0].count("h0") == 3


def test_without_monitor_readings_the_brackets_show_the_drift(run: Datasets) -> None:
    figure = _drift({name: dataset.drop_dims("look", errors="ignore") for name, dataset in run.items()})
    # At 500 nm, of most light, half a minute before the middle.
    assert "at 500\u202fnm: 2 values" in figure.note
    assert f"{100 * 2100e-5 / (1 + 720e-5):.1f}\u202f%" in figure.note


def test_the_tolerance_of_the_drift_is_drawn(run: Datasets) -> None:
    assert not _paths(_drift(run).svg, "l c3 d")
    tolerant = {name: dataset.assign_attrs(drift_tolerance=0.03) for name, dataset in run.items()}
    figure = _drift(tolerant)
    assert len(_paths(figure.svg, "l c3 d")) == 2
    assert "±\u202f3\u202f%" in figure.note


def test_the_time_of_a_long_session_is_in_hours(run: Datasets) -> None:
    assert "run, min<" in _drift(run).svg
    late = run["reduced-sample-reflection-45"].copy(deep=True)
    late["drift_elapsed"] = late["drift_elapsed"] + 10_000
    assert "run, h<" in _drift({**run, "reduced-sample-reflection-45": late}).svg


# --- the profiles


def test_the_chart_of_the_profiles_shows_their_level_and_their_limits(bench: Rig) -> None:
    profile = _calibration(bench, (0.0, 0.004, -0.002, 0.006))
    figure = figures.profiles(profile)
    level, spectrum = (_points(_paths(figure.svg, f"l {style}")[0]) for style in ("c0", "c2"))
    band = _points(_paths(figure.svg, "b c0")[0])
    ticks = re.findall(r'<text x="48.0" y="([\d.]+)" text-anchor="end">([−\d.]+)</text>', str(figure.svg))
    places, values = np.array([(float(at) - 4 - 28, float(value.replace("−", "-"))) for at, value in ticks]).T
    slope, start = np.polyfit(places, values, 1)
    assert start + slope * level[:, 1] == pytest.approx([0, 0.4, -0.2, 0.6], abs=0.02)
    assert abs(start + slope * spectrum[-1, 1]) == pytest.approx(0.3, abs=0.02)
    at = profile.sel(watched="level").isel(profile=-1)
    middle = 0.006 - float(at["change"])
    assert start + slope * band[:, 1].max() == pytest.approx(-100 * 0.0424, abs=0.1)  # the second, against one alone
    limit = 100 * (middle + float(at["limit"]))
    assert start + slope * band[len(band) // 2 - 1, 1] == pytest.approx(limit, abs=0.1)
    assert figure.note.startswith("From 1, bench-1 of 2026-03-01, to 4, bench-4 of 2026-03-04, which is in use")
    assert figure.note.endswith("No profile is beyond them.")


def test_violations_are_marked_and_named(bench: Rig) -> None:
    figure = figures.profiles(_calibration(bench, (0.0, 0.001, 0.09, -0.001, 0.002)))
    assert _paths(figure.svg, "p c3")[0].count("h0") == 1
    assert figure.note.endswith("Violations: bench-3 of 2026-03-03.")
    assert "violation" in [label for _, _, label in figure.legend]


def test_the_note_on_a_single_profile_states_how_to_get_a_chart(bench: Rig) -> None:
    figure = figures.profiles(_calibration(bench, (0.0,)))
    assert not figure.svg
    assert "`previous` in calibration.yaml" in figure.note


# --- the uncertainty


def test_components_are_stacked_with_independent_ones_below_the_line(bench: Rig) -> None:
    primary = _primary(bench, INCIDENCES, noise=0.03, common=0.01)
    figure = figures.budget(primary, "fibre")
    assert figure is not None
    assert [label for _, _, label in figure.legend] == ["noise (independent)", "certificate (common)"]
    tall = 226.0
    (line,) = _paths(figure.svg, "l edge")
    assert _points(line)[:, 1] == pytest.approx(tall * 0.1, abs=0.06)  # 9 parts of 10 are independent
    below, above = (_points(_paths(figure.svg, f"b f {style}")[0])[:, 1] for style in ("i0", "k0"))
    assert (below.min(), below.max()) == pytest.approx((tall * 0.1, tall), abs=0.06)
    assert (above.min(), above.max()) == pytest.approx((0, tall * 0.1), abs=0.06)


def test_the_table_of_components_gives_medians(bench: Rig) -> None:
    primary = _primary(bench, INCIDENCES, noise=0.03, common=0.01)
    # Values scatter about the truth by 3 %, and so does what is stated, relative to them; medians do not.
    assert figures.median_uncertainty(primary, "disc", "noise") == pytest.approx(0.03, rel=0.01)
    assert figures.median_uncertainty(primary, "fibre") == pytest.approx(np.hypot(0.03, 0.01), rel=0.01)
    assert np.isnan(figures.median_uncertainty(primary.where(primary["kind"] == "disc"), "fibre"))


def test_many_components_share_the_colours_and_their_rest_is_summed(bench: Rig) -> None:
    primary = _primary(bench, INCIDENCES, noise=0.03, common=0.01)
    for k, name in enumerate(("repeat", "reference", "nd", "glare", "stray", "path", "linearity", "band")):
        primary[f"brdf_u_{name}"] = (0.001 * (k + 1) * primary["brdf"]).assign_attrs(correlation="common")
    figure = figures.budget(primary, "fibre")
    assert figure is not None
    labels = [label for _, _, label in figure.legend]
    assert len(labels) == 7
    assert labels[-1] == "others, common"
    assert "band (common)" in labels
    assert "repeatability (common)" not in labels


def test_the_largest_component_of_each_incidence_is_in_a_table(bench: Rig) -> None:
    primary = _primary(bench, INCIDENCES, noise=0.03, common=0.01)
    assert {entry.name for entry in dominant(primary)} == {"noise"}
    assert [entry.incidence for entry in dominant(primary)] == list(INCIDENCES)


def test_without_cells_of_a_kind_there_is_no_budget_of_them(run: Datasets) -> None:
    primary = run["primary-reflection"]
    assert figures.budget(primary.isel(cell=primary["kind"].values == "disc"), "fibre") is None


# --- the fit


def _decoded(svg: str, y: float) -> float:
    """Value at a height of a logarithmic chart, from its labels."""
    labels = re.findall(r'<text x="48.0" y="([\d.]+)" text-anchor="end">([\d.]+)</text>', svg)
    places, values = np.array([(float(place) - 4 - 28, float(value)) for place, value in labels]).T
    slope, start = np.polyfit(places, np.log10(values), 1)
    return float(10 ** (start + slope * y))


def test_the_curve_is_the_smoothed_bsdf(run: Datasets) -> None:
    smoothed = run["smoothed-reflection"]
    figure = fit.fit_figure(run["primary-reflection"], smoothed, 1)
    upper = str(figure.svg).split('aria-label="45° incidence: BRDF in the plane, fit against data, difference')[0]
    curve = _points(_paths(upper, "l c4")[0])
    peak = float(smoothing.evaluate(smoothed, 0.0, 0.0).sel(incidence=45, wavelength=550).squeeze())
    lowest = smoothing.evaluate(smoothed, [30.0, 60.0], [0.0, 0.0]).sel(incidence=45, wavelength=550).values.min()
    # A tenth of a unit of some 80 a decade is 0.3 %.
    assert _decoded(upper, curve[:, 1].min()) == pytest.approx(peak, rel=0.01)
    assert _decoded(upper, curve[:, 1].max()) <= lowest * 1.01


def test_points_are_the_fitted_cells_near_the_plane(run: Datasets) -> None:
    primary = run["primary-reflection"]
    figure = fit.fit_figure(primary, run["smoothed-reflection"], 0)
    azimuth = np.abs((primary["phi_s"].values + 180) % 360 - 180)
    near = (azimuth <= 10) | (azimuth >= 170) | (primary["theta_s"].values == 0)
    fitted = np.isfinite(run["smoothed-reflection"]["residual"].values[0, 1])
    shown = sum(data.count("h0") for style in ("p c0 small", "p c2 small") for data in _paths(figure.svg, style))
    assert shown == 2 * int((near & fitted).sum())
    assert figure.note.startswith(f"{int((near & fitted).sum())} cells")


def test_the_side_towards_the_normal_is_on_the_right(bench: Rig) -> None:
    run = _run(bench, (45.0,))
    figure = fit.fit_figure(run["primary-reflection"], run["smoothed-reflection"], 0)
    labels = re.findall(r'text-anchor="middle">([−\d]+)</text>', str(figure.svg))
    # At 45° the horizon is 45° from the mirror direction on one side, and 135° on the other.
    assert "90" in labels
    assert "−60" not in labels


def test_a_linear_fit_that_becomes_negative_is_drawn_where_it_is_positive(bench: Rig) -> None:
    primary = _primary(bench, (45.0,))
    smoothed = smoothing.smooth(primary, "keldysh", scales=2)
    figure = fit.fit_figure(primary, smoothed, 0)
    assert figure.svg
    assert "nan" not in str(figure.svg)


def test_an_incidence_without_values_has_notes_instead_of_figures(run: Datasets) -> None:
    smoothed = run["smoothed-reflection"].copy(deep=True)
    for name in ("residual", "coefficient", "coefficient_factor", "gcv", "chi_squared_dof"):
        smoothed[name].values[1] = np.nan
    for figure in (function(run["primary-reflection"], smoothed, 1) for function in (fit.fit_figure, fit.residual_map)):
        assert not figure.svg
        assert figure.note


def test_every_fitted_cell_is_a_dot_of_the_map(run: Datasets) -> None:
    residual = run["smoothed-reflection"]["residual"].values[1, 1]
    figure = fit.residual_map(run["primary-reflection"], run["smoothed-reflection"], 1)
    drawing, _, key = str(figure.svg).partition("residual / u")
    dots = [sum(data.count("h0") for data in _paths(drawing, f"dot z{place}")) for place in range(7)]
    counts = np.histogram(residual, [-np.inf, -3, -2, -1, 1, 2, 3, np.inf])[0].tolist()
    assert dots == counts
    assert [int(count) for count in re.findall(r"[^d]: (\d+)<", key)][::-1] == counts


def test_strong_residuals_are_red_above_and_blue_below(run: Datasets) -> None:
    smoothed = run["smoothed-reflection"].copy(deep=True)
    smoothed["residual"].values[:] = 0.0
    smoothed["residual"].values[1, 1, [200, 201]] = 9.0, -9.0
    svg = fit.residual_map(run["primary-reflection"], smoothed, 1).svg
    assert [_paths(svg, f"dot z{place}")[0].count("h0") for place in (0, 3, 6)] == [1, 524, 1]


def test_the_strength_used_is_marked_on_its_curves(run: Datasets) -> None:
    for figure in (function(run["smoothed-reflection"]) for function in (fit.cross_validation, fit.l_curve)):
        curves = [_points(_paths(figure.svg, f"l {style}")[0]) for style in ("c0", "c1")]
        for style, curve in zip(("c0", "c1"), curves, strict=True):
            (mark,) = (data for data in _paths(figure.svg, f"p {style}") if "h0" in data)
            place = np.array([float(value) for value in re.findall(r"[\d.]+", mark)[:2]])
            # To a few units of the nearest point of the curve, which is tried at 41 strengths.
            assert np.hypot(*(curve - place).T).min() < 12


# --- the lobe


def _meshes(svg: str) -> list[np.ndarray]:
    """Corners of the meshes, in figure units."""
    outlines = re.findall(r'<path fill="#[0-9a-f]{6}" d="M(-?\d+) (-?\d+)l([^z]*)z"', svg)
    return [
        np.cumsum([[int(x), int(y)], *([int(a), int(b)] for a, b in re.findall(r"(-?\d+)([+-]\d+)", steps))], axis=0)
        / 2
        for x, y, steps in outlines
    ]


def _lobe(bsdf: xr.Dataset, incidence: float) -> Figure:
    figure = indicatrix.indicatrix(bsdf, incidence)
    assert figure is not None
    ElementTree.fromstring(figure.svg)
    return figure


def test_the_body_of_a_perfect_diffuser_is_a_hemisphere() -> None:
    corners = np.concatenate(_meshes(str(_lobe(lambertian(spectrum(0.5)), 30.0).svg)))
    distance = np.hypot(*(corners - [260, 240]).T)
    assert distance.max() == pytest.approx(230, abs=1)
    above = corners[corners[:, 1] < 240 - 150]
    # The outline of a sphere is a circle.
    assert np.hypot(*(above - [260, 240]).T).max() == pytest.approx(230, abs=4)


def test_the_body_is_longest_towards_the_mirror_direction() -> None:
    corners = np.concatenate(_meshes(str(_lobe(beckmann_bsdf(0.03), 60.0).svg)))
    tip = corners[np.argmax(np.hypot(*(corners - [260, 240]).T))]
    # (sin 60°, 0, cos 60°) seen along (1, −1, 1)/√3.
    aim = np.array(
        [np.sin(np.pi / 3) / np.sqrt(2), np.sin(np.pi / 3) / np.sqrt(6) - np.cos(np.pi / 3) * np.sqrt(2 / 3)]
    )
    assert (tip - [260, 240]) / 230 == pytest.approx(aim, abs=0.05)


def test_meshes_that_face_away_are_not_drawn_and_far_ones_come_first() -> None:
    meshes = _meshes(str(_lobe(lambertian(spectrum(0.5)), 0.0).svg))
    x, y = np.moveaxis(np.array(meshes), -1, 0)
    around = (x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y).sum(axis=1)
    assert (around <= 0).all()  # the corners of those that face away would go around the other way
    height = [mesh[:, 1].mean() for mesh in meshes]
    assert np.mean(height[:50]) < np.mean(height[-50:])


@pytest.mark.parametrize("incidence", [0.0, 10.0, 60.0, 85.0])
def test_the_lobe_stays_within_its_picture(incidence: float) -> None:
    svg = str(_lobe(beckmann_bsdf(0.2), incidence).svg)
    for mesh in _meshes(svg):
        assert (mesh >= 0).all()
        assert (mesh <= [520, 390]).all()


def test_a_black_material_has_no_lobe() -> None:
    assert indicatrix.indicatrix(lambertian(spectrum(0.0)), 30.0) is None


def test_the_lobe_of_a_chapter_is_that_of_the_incidence_nearest_45(chapter: Chapter) -> None:
    lobe = _part(chapter, "3-D lobe")
    assert lobe is not None
    assert lobe.title == "3-D lobe at 45° incidence"


def test_the_chapter_shows_reciprocity(run: Datasets) -> None:
    completed = completion.complete(run["smoothed-reflection"])
    assert reciprocity.TITLE in _page({**run, "bsdf": completed})
    assert reciprocity.TITLE not in _page({**run, "bsdf": beckmann_bsdf()})


def test_the_axis_of_differences_contains_all_bars_except_a_few_large_ones() -> None:
    off, u = np.linspace(-2.0, 2.0, 40), np.full(40, 0.5)
    axis, words = fit.axis_about_zero("", off, u)
    assert axis.high == -axis.low > 2.5
    assert words == ""
    axis, words = fit.axis_about_zero("", np.r_[off, 40.0], np.r_[u, 0.5])
    assert 2.5 < axis.high < 8
    assert words == " Outside the range of the lower chart: 1 value."
    axis, words = fit.axis_about_zero("", np.r_[off, 1.0], np.r_[u, 60.0])
    assert 2.5 < axis.high < 8
    assert words == " Outside the range of the lower chart: ends of 1 bar."


@pytest.mark.parametrize("count", [0, 1])
def test_the_axis_of_differences_is_never_empty(count: int) -> None:
    axis, words = fit.axis_about_zero("", np.full(3, np.nan)[:count], np.full(3, np.nan)[:count])
    assert axis.high >= 1
    assert words == ""
