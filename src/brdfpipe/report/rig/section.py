"""Section of the page on a rig measurement: the run, its uncertainty, and the fit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.measured.agreement import asymmetry
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.representations.measured import Measured
from brdfpipe.report.cards import Chapter, Table
from brdfpipe.report.formatting import MISSING, fixed, number, percent
from brdfpipe.report.plots.bsdf_sections import REFERENCE_WAVELENGTH
from brdfpipe.report.plots.indicatrix import indicatrix
from brdfpipe.report.plots.svg import Figure
from brdfpipe.report.rig import figures as rig_figures
from brdfpipe.report.rig import fit as rig_fit
from brdfpipe.report.rig import reciprocity as rig_reciprocity
from brdfpipe.report.rig.figures import FITTED, HIDDEN, uncertainty_percent
from brdfpipe.rig.reduction.budget import BY_NAME, dominant
from brdfpipe.rig.reduction.calibration import GRAZING
from brdfpipe.specular_directions import cos_view_etalon

MOST_PICTURES, MOST_FITS = 6, 5
"""Largest number of incidences with a picture, and with figures of the fit, both sides together: more would make a large file."""

LOBE_INCIDENCE = 45.0
"""Angle of incidence nearest to which the lobe is shown in 3-D [degree]."""

EMULATED = (
    "Frames, noise and errors are simulated. The sample in the holder is the model of another material. Nothing here describes "
    "a real sample. It shows what the rig and the reduction from frames to BSDF would do."
)

_MOST_LISTED = 20
_FEW = 0.5
"""Share of fitted cells, of those above the horizon, below which the table advises on exposures."""


@dataclass(frozen=True)
class Side:
    """What was measured on one side of the sample."""

    name: str
    """``reflection`` or ``transmission``"""
    reduced: tuple[xr.Dataset, ...]
    """Sorted by incidence."""
    primary: xr.Dataset
    smoothed: xr.Dataset


def chapter(datasets: Mapping[str, xr.Dataset]) -> Chapter | None:
    """The rig section of a material; None for one that was not measured on a rig.

    It shows the datasets of kind ``reduced``, ``primary``, ``smoothed``, ``calibration`` and ``bsdf``.
    """
    measured_sides = sides(datasets)
    if not measured_sides:
        return None
    profile = next(iter(_of_kind(datasets, "calibration")), None)

    def shown(most: int) -> list[tuple[Side, int]]:
        return [
            (side, index)
            for side in measured_sides
            for index in _evenly_spaced(side.smoothed.sizes["incidence"], most // len(measured_sides))
        ]

    parts: list[Figure | Table | None] = [
        rig_figures.frames([picture for side, index in shown(MOST_PICTURES) for picture in _pictures(side, index)]),
        measurement_table(measured_sides, profile),
        rig_figures.drift([arrangement for side in measured_sides for arrangement in side.reduced]),
        None if profile is None else rig_figures.profiles(profile),
        coverage_table(measured_sides, profile, len(shown(MOST_FITS))),
    ]
    for side in measured_sides:
        parts += [rig_figures.budget(side.primary, kind) for kind in ("disc", "fibre")]
        parts.append(_uncertainty_table(side, named=len(measured_sides) > 1))
        parts.append(_dominant_table(side, named=len(measured_sides) > 1))
    parts.append(_lobe(datasets, measured_sides))
    for side, index in shown(MOST_FITS):
        arguments = side.primary, side.smoothed, index
        parts += [rig_fit.fit_figure(*arguments), rig_fit.residual_map(*arguments)]
    for side in measured_sides:
        parts += [rig_fit.cross_validation(side.smoothed), rig_fit.l_curve(side.smoothed)]
    parts.append(_reciprocity(datasets, measured_sides))
    return Chapter(
        "Rig measurement",
        "rig",
        "the rig's stages",
        _warnings(datasets),
        [part for part in parts if part is not None],
        emulated=EMULATED if emulated(datasets) else "",
    )


def emulated(datasets: Mapping[str, xr.Dataset]) -> bool:
    """Whether the camera that took the frames is that of the emulated rig, by its name."""
    frames = [*_of_kind(datasets, "reduced"), *_of_kind(datasets, "primary")]
    return any("emulated" in str(dataset.attrs.get("camera", "")).lower() for dataset in frames)


def sides(datasets: Mapping[str, xr.Dataset]) -> list[Side]:
    """The measured sides with primary and smoothed data, reflection first."""
    measured_sides = []
    for name in ("reflection", "transmission"):
        reduced, primary, smoothed = (
            [dataset for dataset in _of_kind(datasets, kind) if dataset.attrs.get("side", "reflection") == name]
            for kind in ("reduced", "primary", "smoothed")
        )
        if primary and smoothed:
            of_sample = (arrangement for arrangement in reduced if arrangement.attrs.get("load") == "sample")
            by_incidence = sorted(of_sample, key=lambda arrangement: float(arrangement["incidence"][0]))
            measured_sides.append(Side(name, tuple(by_incidence), primary[0], smoothed[0]))
    return measured_sides


def _of_kind(datasets: Mapping[str, xr.Dataset], kind: str) -> Iterator[xr.Dataset]:
    return (dataset for dataset in datasets.values() if dataset.attrs.get("kind") == kind)


def _evenly_spaced(count: int, most: int) -> list[int]:
    """At most ``most`` of ``count`` indices, evenly spaced, with the first and the last."""
    return sorted({int(index) for index in np.linspace(0, count - 1, min(count, most)).round()})


def _pictures(side: Side, index: int) -> Iterator[tuple[xr.Dataset, NDArray[np.str_]]]:
    incidence = float(side.smoothed["incidence"][index])
    for reduced in side.reduced:
        if float(reduced["incidence"][0]) == incidence:
            yield reduced, rig_figures.cell_states(side.primary, side.smoothed, index)


def _warnings(datasets: Mapping[str, xr.Dataset]) -> list[str]:
    """Warnings of the rig's stages that the BSDF does not repeat."""
    kinds = ("calibration", "reduced", "primary", "smoothed")
    rig_stages = [dataset for kind in kinds for dataset in _of_kind(datasets, kind)]
    repeated = {text for dataset in _of_kind(datasets, "bsdf") for text in vocabulary.warnings(dataset)}
    texts = dict.fromkeys(text for dataset in rig_stages for text in vocabulary.warnings(dataset))
    return [text for text in texts if text not in repeated]


def _reciprocity(datasets: Mapping[str, xr.Dataset], measured_sides: Sequence[Side]) -> Figure | None:
    completed = [bsdf for bsdf in _of_kind(datasets, "bsdf") if isinstance(representation(bsdf), Measured)]
    reflected = [side.smoothed for side in measured_sides if side.name == "reflection"]
    return rig_reciprocity.figure(completed[0], reflected[0]) if completed and reflected else None


def _lobe(datasets: Mapping[str, xr.Dataset], measured_sides: Sequence[Side]) -> Figure | None:
    bsdf = datasets.get("bsdf")
    reflected = next((side for side in measured_sides if side.name == "reflection"), None)
    if bsdf is None or reflected is None:
        return None
    return indicatrix(bsdf, min(reflected.smoothed["incidence"].values, key=lambda angle: abs(angle - LOBE_INCIDENCE)))


# --- measurement


def measurement_table(measured_sides: Sequence[Side], profile: xr.Dataset | None) -> Table:
    primary = measured_sides[0].primary
    arrangements = [arrangement for side in measured_sides for arrangement in side.reduced]
    attrs = {name: value for dataset in (*arrangements, primary) for name, value in dataset.attrs.items()}
    rows = [
        ("Rig", str(attrs.get("rig", MISSING))),
        ("Camera", str(attrs.get("camera", MISSING))),
        ("Sample", f"{attrs.get('sample', MISSING)}, on {attrs.get('day', MISSING)}"),
    ]
    for side in measured_sides:
        listed = ", ".join(f"{angle:g}" for angle in side.primary["incidence"].values)
        rows.append((f"Incidences, {side.name}", f"{listed} °"))
    wavelength = primary["wavelength"].values
    rows.append(("Wavelengths", f"{wavelength.size}, {wavelength[0]:g} to {wavelength[-1]:g} nm"))
    kinds = primary["kind"].values
    rows.append(("Cells", f"{int((kinds == 'fibre').sum())} fibres, {int((kinds == 'disc').sum())} of the disc"))
    rows += list(_calibration(attrs, profile))
    about = {"half": "about the half vector", "mirror": "about the mirror direction"}
    for side in measured_sides:
        smoothing = side.smoothed.attrs
        rows.append(
            (f"Smoothing, {side.name}", f"{smoothing['mode']}, {about.get(smoothing['about'], smoothing['about'])}")
        )
    rows += list(_registration(arrangements))
    reasons = str(attrs.get("overridden", ""))
    remark = f"The calibration profile is invalid, and was used by `rig.override`: {reasons}. Measure the etalon again."
    return Table("Measurement", ("What", "Value"), rows, remark=remark if reasons else "")


def _calibration(attrs: Mapping[str, object], profile: xr.Dataset | None) -> Iterator[tuple[str, str]]:
    yield "Certificate", str(attrs.get("certificate", MISSING))
    calibrated, day = _date(attrs.get("calibrated")), _date(attrs.get("day"))
    if calibrated is None:
        return
    age = f", {(day - calibrated).days} days before" if day is not None else ""
    validity = "" if profile is None else f"; valid for {int(profile.attrs['valid_days'])} days"
    yield "Calibration profile", f"of {calibrated}{age}{validity}"
    if profile is not None:
        yield "Etalon through", f"{', '.join(f'{angle:g}' for angle in profile['incidence'].values)} °"


def _date(text: object) -> date | None:
    try:
        return date.fromisoformat(str(text))
    except ValueError:
        return None


def _registration(reduced: Sequence[xr.Dataset]) -> Iterator[tuple[str, str]]:
    registered = [arrangement.attrs for arrangement in reduced if "registration_shift" in arrangement.attrs]
    if not registered:
        return
    shift = np.array([np.asarray(attrs["registration_shift"], dtype=float) for attrs in registered])
    u, centre_u = (max(float(attrs[name]) for attrs in registered) for name in ("registration_u", "disc_centre_u"))
    spots = min(int(attrs["registration_spots"]) for attrs in registered)
    yield "Largest shift", f"{fixed(float(np.hypot(*shift.T).max()), 2)} ± {fixed(u, 3)} px, by {spots} spots or more"
    yield "Mirror direction", f"± {number(centre_u, 2)}°"


# --- coverage


def coverage_table(measured_sides: Sequence[Side], profile: xr.Dataset | None, shown: int) -> Table:
    counts = ("Fitted", "Fitted, below noise", "Saturated", "Below horizon", "Otherwise left out")
    header = ("Incidence", *counts, "rms of residual / u", "χ² / dof", "Strength ε")
    rows, few, asymmetric = [], [], []
    for side in measured_sides:
        for index, incidence in enumerate(side.smoothed["incidence"].values.tolist()):
            name = f"{incidence:g}°" + (f" {side.name}" if len(measured_sides) > 1 else "")
            rows.append((name, *_counted(side, index), *_misfit(side.smoothed, index)))
            states = rig_figures.cell_states(side.primary, side.smoothed, index)
            fitted, above = int((states == FITTED).sum()), int((states != HIDDEN).sum())
            few += [f"{name} ({fitted} of {above})"] if fitted < _FEW * above else []
            at_incidence = side.smoothed.isel(incidence=index)
            difference = asymmetry(at_incidence.sel(wavelength=REFERENCE_WAVELENGTH, method="nearest"))
            asymmetric += [f"{number(difference, 2)} at {name}"] if difference else []
    note = (
        "Number of cells, mean over the wavelengths. Otherwise left out: vignetted, or not calibrated by the profile. The rms of the "
        "residuals over their uncertainties should be slightly below 1. Above 1, the fit misses features of the data, or the "
        f"uncertainties are too small. Far below 1, the uncertainties are too large.{_dead_fibres(profile)}"
    )
    if shown < len(rows):
        note += f" The fits at {shown} of the {len(rows)} incidences are shown."
    return Table("Coverage and fit", header, rows, note, " ".join(_advice(few, asymmetric)))


def _advice(few: Sequence[str], asymmetric: Sequence[str]) -> Iterator[str]:
    """Advice where few cells were fitted, and where the two sides of the plane of incidence differ."""
    if few:
        yield (
            f"Fewer than half of the cells above the horizon were fitted at {', '.join(few)}. Where many are saturated, add a "
            "shorter exposure or a denser filter to `bracket` in plan.yaml. Where many are below noise, add a longer exposure."
        )
    if asymmetric:
        yield (
            "The fit assumes symmetry about the plane of incidence, but cells on the two sides differ. Mean difference in standard "
            f"uncertainties: {', '.join(asymmetric)}. Either the mirror direction is not where the angular target places it: measure the target "
            "in this run too (`target` first in `runs` of plan.yaml). Or the sample has a lay: set `rig.smoothing.isotropic: false` and `mirror_symmetric: false` "
            "in material.yaml."
        )


def _counted(side: Side, index: int) -> Iterator[str]:
    quality = side.primary["brdf_quality"].values[index]
    fitted = np.isfinite(side.smoothed["residual"].values[index])
    dim = quality == vocabulary.quality("below_noise")
    saturated, hidden = (~fitted & (quality == vocabulary.quality(name)) for name in ("saturated", "shadowed"))
    columns = fitted, fitted & dim, saturated, hidden, ~(fitted | saturated | hidden)
    return (f"{column.sum(axis=1).mean():.0f}" for column in columns)


def _misfit(smoothed: xr.Dataset, index: int) -> tuple[str, str, str]:
    residual, reduced = smoothed["residual"].values[index], smoothed["chi_squared_dof"].values[index]
    rms = float(np.sqrt(np.nanmean(residual**2))) if np.isfinite(residual).any() else np.nan
    median = float(np.nanmedian(reduced)) if np.isfinite(reduced).any() else np.nan
    return number(rms), number(median), number(float(smoothed["chosen_strength"][index]))


def _dead_fibres(profile: xr.Dataset | None) -> str:
    """Note on fibres without light from the etalon, by name."""
    if profile is None:
        return ""
    entrance = profile["incidence"].values[:, None]
    lit = cos_view_etalon(entrance, profile["theta_s"].values, profile["phi_s"].values) > GRAZING
    lit &= ~profile["hidden"].values.astype(bool) if "hidden" in profile else True
    dark = np.isnan(profile["cell_scale"].values).all(axis=0) & (profile["kind"].values == "fibre")
    dead = profile["cell"].values[dark & lit.any(axis=0)].tolist()
    grazing = int((dark & ~lit.any(axis=0)).sum())
    note = " No fibre is dead."
    if dead:
        listed = ", ".join(dead[:_MOST_LISTED]) + (", …" if len(dead) > _MOST_LISTED else "")
        remedy = "Clean or replace them, or remove them from the table of fibres."
        note = f" Dead fibres, without light from the etalon: {listed}. {remedy}"
    not_seen = f" {grazing} fibres see the etalon at grazing angles, or not at all. They cannot be calibrated."
    return (not_seen if grazing else "") + note


# --- uncertainty


def _uncertainty_table(side: Side, *, named: bool) -> Table:
    rows = [
        (
            rig_figures.COMPONENT_NAMES.get(name, name),
            correlation,
            *_declared(name),
            *(
                uncertainty_percent(rig_figures.median_uncertainty(side.primary, kind, name))
                for kind in ("disc", "fibre")
            ),
        )
        for name, correlation in rig_figures.components(side.primary).items()
    ]
    combined = (uncertainty_percent(rig_figures.median_uncertainty(side.primary, kind)) for kind in ("disc", "fibre"))
    title = "Standard uncertainty of a cell's value" + (f", {side.name}" if named else "")
    note = "k = 1, relative. Medians over cells, wavelengths and incidences; the combined median is not the root sum of squares of the others."
    header = ("Component", "from cell to cell", "evaluated", "from", "Disc", "Fibres")
    return Table(title, header, [*rows, ("combined", "", "", "", *combined)], note)


def _declared(name: str) -> tuple[str, str]:
    """Evaluation and distribution, and origin, of a term of the budget."""
    term = BY_NAME.get(name)
    return (f"{term.evaluation}, {term.distribution}", term.origin.replace("`", "")) if term else ("", "")


def _dominant_table(side: Side, *, named: bool) -> Table | None:
    """The largest term of each incidence; None without values."""
    rows = [
        (
            f"{entry.incidence:g}°",
            rig_figures.COMPONENT_NAMES.get(entry.name, entry.name),
            percent(entry.share),
            uncertainty_percent(entry.u),
        )
        for entry in dominant(side.primary)
    ]
    title = "What limits the uncertainty" + (f", {side.name}" if named else "")
    note = "Medians over measured values of all cells and wavelengths."
    header = ("Incidence", "Largest component", "share of the variance", "Standard uncertainty")
    return Table(title, header, rows, note) if rows else None
