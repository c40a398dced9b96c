"""What a page tells of light that goes there and back."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest
import rig_primary
import xarray as xr

from brdfpipe.bsdf.measured import completion, smoothing
from brdfpipe.bsdf.measured.reciprocity import reciprocity
from brdfpipe.report.plots.svg import Figure
from brdfpipe.report.rig import reciprocity as reciprocity_figure

INCIDENCES = (10.0, 30.0, 60.0)


def _flat(incidence: float, theta: np.ndarray, phi: np.ndarray, wavelength: np.ndarray) -> np.ndarray:
    return np.full((wavelength.size, theta.size), 0.3)


def _figure(
    incidences: tuple[float, ...] = INCIDENCES, *, wrong: float | None = None, isotropic: bool = True, **options
) -> Figure:
    """Of a perfect diffuser, one incidence of which may be stated 30 % too bright."""
    primary = rig_primary.measured(_flat, incidences, (500.0, 600.0), noise=0.02)
    factor = xr.where(primary["incidence"] == wrong, 1.3, 1.0) if wrong is not None else 1.0
    brdf = (primary["brdf"] * factor).assign_attrs(primary["brdf"].attrs)
    smoothed = smoothing.smooth(primary.assign(brdf=brdf.transpose(*primary["brdf"].dims)), isotropic=isotropic)
    return reciprocity_figure.figure(completion.complete(smoothed, **options), smoothed)


def _ends(svg: str, style: str) -> list[np.ndarray]:
    """Heights of dots, by panel."""
    return [
        np.array([float(y) for y in re.findall(r"M[-\d.]+ ([-\d.]+)h0", data)])
        for data in re.findall(rf'<path class="p {style} small" d="([^"]*)"', svg)
    ]


def test_every_pair_is_drawn_before_and_after(on_rig: xr.Dataset, smoothed_on_rig: xr.Dataset) -> None:
    figure = reciprocity_figure.figure(on_rig, smoothed_on_rig)
    ElementTree.fromstring(f"<div>{figure.svg}</div>")
    assert not re.search(r"nan|inf\b", str(figure.svg))
    (before,), (forward,), (backward,) = (_ends(figure.svg, style) for style in ("c0", "c2", "c4"))
    assert before.size == forward.size == backward.size == 3 * reciprocity_figure.AZIMUTHS
    for name in ("10°–30°", "10°–60°", "30°–60°"):
        assert figure.svg.count(f">{name}</text>") == 2
    assert len(figure.legend) == 3
    assert reciprocity_figure.figure(on_rig, smoothed_on_rig) == figure


def test_the_points_are_the_values_of_the_completion(on_rig: xr.Dataset, smoothed_on_rig: xr.Dataset) -> None:
    compared = reciprocity(on_rig, reciprocity_figure.AZIMUTHS)
    apart = 100 * (compared["forward"] / compared["backward"] - 1).median("wavelength").values.ravel()
    moved = 100 * (compared["averaged"] / compared["forward"] - 1).median("wavelength").values.ravel()
    figure = reciprocity_figure.figure(on_rig, smoothed_on_rig)
    (before,), (after,) = (_ends(figure.svg, style) for style in ("c0", "c2"))
    # Both panels have one scale, upwards.
    slope, level = np.polyfit(apart, before, 1)
    assert slope < 0
    assert before == pytest.approx(slope * apart + level, abs=0.11)
    assert after == pytest.approx(slope * moved + level, abs=0.11)


def test_the_bsdf_is_between_the_values_there_and_back(on_rig: xr.Dataset, smoothed_on_rig: xr.Dataset) -> None:
    (there,), (back,) = (_ends(reciprocity_figure.figure(on_rig, smoothed_on_rig).svg, style) for style in ("c2", "c4"))
    (before,) = _ends(reciprocity_figure.figure(on_rig, smoothed_on_rig).svg, "c0")
    assert np.ptp(np.concatenate([there, back])) < np.ptp(before)


def test_the_note_states_that_no_pair_differs_significantly(on_rig: xr.Dataset, smoothed_on_rig: xr.Dataset) -> None:
    assert reciprocity_figure.figure(on_rig, smoothed_on_rig).note.endswith("No pair differs significantly.")


def test_the_note_names_the_pairs_of_a_wrong_incidence_and_the_remedy() -> None:
    note = _figure(wrong=30.0).note
    assert "Different by more than 2 standard uncertainties: 10°–30°, 30°–60°." in note
    assert "`runs` in plan.yaml" in note
    assert re.search(r"was therefore enlarged .*[\d.]+ times at 30°", note)


@pytest.mark.parametrize("wrong", [None, 30.0])
def test_all_bars_are_within_their_frame(wrong: float | None) -> None:
    svg = _figure(wrong=wrong).svg
    tall = float(re.search(r'<svg x="\d+" y="\d+" width="\d+" height="(\d+)">', svg)[1])
    bars = [
        data for style in ("c0", "c2", "c4") for data in re.findall(rf'<path class="e {style} small" d="([^"]*)"', svg)
    ]
    ends = np.array(
        [
            float(y)
            for data in bars
            for pair in re.findall(r"M[-\d.]+ ([-\d.]+)(?:V([-\d.]+))?", data)
            for y in pair
            if y
        ]
    )
    assert len(bars) == 3
    assert 0 < ends.min() < ends.max() < tall


def test_the_two_ways_of_a_surface_with_a_lay_need_not_agree() -> None:
    figure = _figure(isotropic=False)
    assert figure.svg.count('<svg class="fig"') == 1
    assert "For a surface with a lay they need not be equal" in figure.note


def test_without_averaging_there_is_only_before() -> None:
    figure = _figure(reciprocity=False)
    assert figure.svg.count('<svg class="fig"') == 1
    assert "there is no average" in figure.note


def test_of_many_pairs_those_that_differ_most_are_shown() -> None:
    figure = _figure((10.0, 20.0, 30.0, 45.0, 60.0), wrong=45.0)
    names = re.findall(r">(\d+°–\d+°)</text>", figure.svg)
    assert len(names) == 2 * reciprocity_figure.MOST_PAIRS
    assert {"10°–45°", "20°–45°", "30°–45°", "45°–60°"} < set(names)
    assert figure.note.startswith("The 8 of 10 pairs that differ most.")


def test_one_incidence_has_no_pair() -> None:
    figure = _figure((30.0,))
    assert figure.svg == ""
    assert "Fewer than two incidences" in figure.note
