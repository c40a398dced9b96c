"""The rig section of a page: the measurement, its uncertainty, and the fit to it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from brdfpipe import vocabulary
from brdfpipe.bsdf.registry import representation
from brdfpipe.bsdf.representations.measured import Measured
from brdfpipe.report.cards import Table
from brdfpipe.report.formatting import MISSING, fixed, number
from brdfpipe.report.plots.indicatrix import indicatrix
from brdfpipe.report.plots.svg import Figure
from brdfpipe.report.rig import figures as rig_figures
from brdfpipe.report.rig import fit as rig_fit
from brdfpipe.report.rig import reciprocity as rig_reciprocity
from brdfpipe.report.rig.figures import FITTED, HIDDEN, percent
from brdfpipe.rig.reduction.calibration import GRAZING
from brdfpipe.specular_directions import cos_view_etalon

MOST_PICTURES, MOST_FITS = 6, 5
"""Incidences with a picture, and with figures of the fit, both sides together: more would make the page heavy."""

LOBE_INCIDENCE = 45.0
"""Angle of incidence near which the lobe is shown as a body [degree]."""

EMULATED = (
    "Frames, noise and errors are simulated. The sample in the holder is the model of another material. Nothing here describes "
    "a real sample. It shows what the rig and the reduction from frames to BSDF would do."
)

_LISTED = 20
_FEW = 0.5
"""Share of the cells above the horizon that are fitted below which a remark is made."""


@dataclass(frozen=True)
class Side:
    """What was measured on one side of the sample."""

    name: str
    """``reflection`` or ``transmission``"""
    reduced: tuple[xr.Dataset, ...]
    """By incidence."""
    primary: xr.Dataset
    smoothed: xr.Dataset


@dataclass(frozen=True)
class Chapter:
    """The part of a page about the rig."""

    emulated: str
    """Loud words where nothing was measured, else empty."""
    warnings: Sequence[str]
    frames: Figure | None
    run: Sequence[Figure | Table]
    coverage: Table
    budget: Sequence[Figure | Table]
    fits: Sequence[tuple[Figure, Figure]]
    """Of each incidence shown: the fit against data, and its residuals."""
    smoothing: Sequence[Figure]
    reciprocity: Figure | None
    lobe: Figure | None


def chapter(datasets: Mapping[str, xr.Dataset]) -> Chapter | None:
    """The chapter of a material that was measured on a rig; None of any other.

    Parameters
    ----------
    datasets : any stages of a material; looked at are those of kind ``reduced``, ``primary``, ``smoothed``, ``calibration``
        and ``bsdf``
    """
    measured_sides = sides(datasets)
    if not measured_sides:
        return None
    profile = next(iter(_of_kind(datasets, "calibration")), None)

    def shown(most: int) -> list[tuple[Side, int]]:
        return [
            (side, at)
            for side in measured_sides
            for at in _spread(side.smoothed.sizes["incidence"], most // len(measured_sides))
        ]

    return Chapter(
        emulated=EMULATED if emulated(datasets) else "",
        warnings=_warnings(datasets),
        frames=rig_figures.frames([look for side, at in shown(MOST_PICTURES) for look in _look(side, at)]),
        run=[
            _measurement(measured_sides, profile),
            rig_figures.drift([arrangement for side in measured_sides for arrangement in side.reduced]),
            *([] if profile is None else [rig_figures.profiles(profile)]),
        ],
        coverage=_coverage(measured_sides, profile, len(shown(MOST_FITS))),
        budget=[part for side in measured_sides for part in _budget(side, named=len(measured_sides) > 1)],
        fits=[
            (rig_fit.fit(side.primary, side.smoothed, at), rig_fit.residuals(side.primary, side.smoothed, at))
            for side, at in shown(MOST_FITS)
        ],
        smoothing=[
            figure
            for side in measured_sides
            for figure in (rig_fit.cross_validation(side.smoothed), rig_fit.l_curve(side.smoothed))
        ],
        reciprocity=_reciprocity(datasets, measured_sides),
        lobe=_lobe(datasets, measured_sides),
    )


def emulated(datasets: Mapping[str, xr.Dataset]) -> bool:
    """Whether frames of the emulated rig's camera are behind the datasets: its name for itself says so."""
    return any(
        "emulated" in str(dataset.attrs.get("camera", "")).lower()
        for kind in ("reduced", "primary")
        for dataset in _of_kind(datasets, kind)
    )


def sides(datasets: Mapping[str, xr.Dataset]) -> list[Side]:
    """What was measured, reflection first; a side without primary and smoothed data is left out."""
    measured_sides = []
    for name in ("reflection", "transmission"):
        reduced, primary, smoothed = (
            [dataset for dataset in _of_kind(datasets, kind) if dataset.attrs.get("side", "reflection") == name]
            for kind in ("reduced", "primary", "smoothed")
        )
        if primary and smoothed:
            own = [arrangement for arrangement in reduced if arrangement.attrs.get("load") == "sample"]
            by_incidence = tuple(sorted(own, key=lambda arrangement: float(arrangement["incidence"][0])))
            measured_sides.append(Side(name, by_incidence, primary[0], smoothed[0]))
    return measured_sides


def _of_kind(datasets: Mapping[str, xr.Dataset], kind: str) -> Iterator[xr.Dataset]:
    return (dataset for dataset in datasets.values() if dataset.attrs.get("kind") == kind)


def _spread(count: int, most: int) -> list[int]:
    """Up to so many of some places, evenly, with the first and the last."""
    return sorted({int(place) for place in np.linspace(0, count - 1, min(count, most)).round()})


def _look(side: Side, at: int) -> Iterator[tuple[xr.Dataset, NDArray[np.str_]]]:
    incidence = float(side.smoothed["incidence"][at])
    for reduced in side.reduced:
        if float(reduced["incidence"][0]) == incidence:
            yield reduced, rig_figures.states(side.primary, side.smoothed, at)


def _warnings(datasets: Mapping[str, xr.Dataset]) -> list[str]:
    """Warnings of the rig's stages that the BSDF did not take over."""
    kinds = ("calibration", "reduced", "primary", "smoothed")
    rig_warnings = [
        text for kind in kinds for dataset in _of_kind(datasets, kind) for text in vocabulary.warnings(dataset)
    ]
    known = {text for dataset in _of_kind(datasets, "bsdf") for text in vocabulary.warnings(dataset)}
    return [text for text in dict.fromkeys(rig_warnings) if text not in known]


def _reciprocity(datasets: Mapping[str, xr.Dataset], measured_sides: Sequence[Side]) -> Figure | None:
    completed = [bsdf for bsdf in _of_kind(datasets, "bsdf") if isinstance(representation(bsdf), Measured)]
    reflected = [side.smoothed for side in measured_sides if side.name == "reflection"]
    return rig_reciprocity.figure(completed[0], reflected[0]) if completed and reflected else None


def _lobe(datasets: Mapping[str, xr.Dataset], measured_sides: Sequence[Side]) -> Figure | None:
    bsdf = datasets.get("bsdf")
    measured = [
        float(angle)
        for side in measured_sides
        if side.name == "reflection"
        for angle in side.smoothed["incidence"].values
    ]
    if bsdf is None or not measured:
        return None
    return indicatrix(bsdf, min(measured, key=lambda angle: abs(angle - LOBE_INCIDENCE)))


# --- in words


def _measurement(measured_sides: Sequence[Side], profile: xr.Dataset | None) -> Table:
    primary = measured_sides[0].primary
    every = [arrangement for side in measured_sides for arrangement in side.reduced]
    attrs = {name: value for dataset in (*every, primary) for name, value in dataset.attrs.items()}
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
    rows += [(f"Smoothing, {side.name}", _smoothing(side.smoothed)) for side in measured_sides]
    rows += list(_registration(every))
    return Table("Measurement", ("What", "Value"), rows, remark=_override(attrs))


def _calibration(attrs: Mapping[str, object], profile: xr.Dataset | None) -> Iterator[tuple[str, str]]:
    yield "Certificate", str(attrs.get("certificate", MISSING))
    made, day = _day(attrs.get("calibrated")), _day(attrs.get("day"))
    if made is None:
        return
    age = f", {(day - made).days} days before" if day is not None else ""
    if profile is None:
        yield "Calibration profile", f"of {made}{age}"
    else:
        yield "Calibration profile", f"of {made}{age}; valid for {int(profile.attrs['valid_days'])} days"
        entrances = ", ".join(f"{angle:g}" for angle in profile["incidence"].values)
        yield "Etalon through", f"{entrances} °"


def _override(attrs: Mapping[str, object]) -> str:
    doubts = str(attrs.get("overridden", ""))
    if not doubts:
        return ""
    return f"The calibration profile is not valid, and was used by `rig.override`: {doubts}. Measure the etalon again."


def _day(text: object) -> date | None:
    try:
        return date.fromisoformat(str(text))
    except ValueError:
        return None


def _smoothing(smoothed: xr.Dataset) -> str:
    about = {"half": "about the half vector", "mirror": "about the mirror direction"}
    return f"{smoothed.attrs['mode']}, {about.get(str(smoothed.attrs['about']), smoothed.attrs['about'])}"


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


def _coverage(measured_sides: Sequence[Side], profile: xr.Dataset | None, shown: int) -> Table:
    header = (
        "Incidence",
        "Fitted",
        "of them below noise",
        "Saturated",
        "Below horizon",
        "Otherwise left out",
        "rms of residual / u",
        "χ² / dof",
        "Strength ε",
    )
    rows, few, lopsided = [], [], []
    for side in measured_sides:
        for at, incidence in enumerate(side.smoothed["incidence"].values.tolist()):
            name = f"{incidence:g}°" + (f" {side.name}" if len(measured_sides) > 1 else "")
            rows.append((name, *_counted(side, at), *_misfit(side.smoothed, at)))
            became = rig_figures.states(side.primary, side.smoothed, at)
            fitted, above = int((became == FITTED).sum()), int((became != HIDDEN).sum())
            few += [f"{name} ({fitted} of {above})"] if fitted < _FEW * above else []
            differ = rig_fit.lopsided(side.smoothed, at)
            lopsided += [f"{number(differ, 2)} at {name}"] if differ else []
    note = (
        "Number of cells, mean over the wavelengths. Otherwise left out: vignetted, or not calibrated by the profile. The rms of the "
        "residuals over their uncertainties should be slightly below 1. Above 1, the fit misses features of the data, or the "
        f"uncertainties are too small. Far below 1, the uncertainties are too large.{_dead(profile)}"
    )
    if shown < len(rows):
        note += f" The fits at {shown} of the {len(rows)} incidences are shown."
    return Table("Coverage and fit", header, rows, note, " ".join(_advice(few, lopsided)))


def _advice(few: Sequence[str], lopsided: Sequence[str]) -> Iterator[str]:
    """What to do where few cells were fitted, and where those on either side of the plane of incidence differ."""
    if few:
        yield (
            f"Fewer than half of the cells above the horizon were fitted at {', '.join(few)}. Where many are saturated, add a "
            "shorter exposure or a denser filter to `bracket` in plan.yaml. Where many are below noise, add a longer exposure."
        )
    if lopsided:
        yield (
            "The fit assumes symmetry about the plane of incidence, but cells on the two sides differ. Mean difference in standard "
            f"uncertainties: {', '.join(lopsided)}. Either the mirror direction is not where the angular target places it: measure the target "
            "in this run too (`target` first in `runs` of plan.yaml). Or the sample has a lay: set `rig.smoothing.symmetric: false` "
            "in material.yaml."
        )


def _counted(side: Side, at: int) -> Iterator[str]:
    quality = side.primary["brdf_quality"].values[at]
    fitted = np.isfinite(side.smoothed["residual"].values[at])
    dim = quality == vocabulary.quality("below_noise")
    saturated, hidden = (~fitted & (quality == vocabulary.quality(name)) for name in ("saturated", "shadowed"))
    columns = fitted, fitted & dim, saturated, hidden, ~(fitted | saturated | hidden)
    return (f"{column.sum(axis=1).mean():.0f}" for column in columns)


def _misfit(smoothed: xr.Dataset, at: int) -> tuple[str, str, str]:
    residual, reduced = smoothed["residual"].values[at], smoothed["chi_squared_dof"].values[at]
    rms = float(np.sqrt(np.nanmean(residual**2))) if np.isfinite(residual).any() else np.nan
    median = float(np.nanmedian(reduced)) if np.isfinite(reduced).any() else np.nan
    return number(rms), number(median), number(float(smoothed["chosen_strength"][at]))


def _dead(profile: xr.Dataset | None) -> str:
    """Fibres without light from the etalon, by name."""
    if profile is None:
        return ""
    entrance = profile["incidence"].values[:, None]
    lit = cos_view_etalon(entrance, profile["theta_s"].values, profile["phi_s"].values) > GRAZING
    lit &= ~profile["hidden"].values.astype(bool) if "hidden" in profile else True
    dark = np.isnan(profile["cell_scale"].values).all(axis=0) & (profile["kind"].values == "fibre")
    dead = profile["cell"].values[dark & lit.any(axis=0)].tolist()
    grazing = int((dark & ~lit.any(axis=0)).sum())
    words = (
        f" {grazing} fibres see the etalon at grazing angles, or not at all. They cannot be calibrated."
        if grazing
        else ""
    )
    if not dead:
        return words + " No fibre is dead."
    listed = ", ".join(dead[:_LISTED]) + (", …" if len(dead) > _LISTED else "")
    return (
        f"{words} Dead fibres, without light from the etalon: {listed}. Clean or replace them, or remove them from the table "
        "of fibres."
    )


# --- uncertainty


def _budget(side: Side, *, named: bool) -> Iterator[Figure | Table]:
    for kind in ("disc", "fibre"):
        figure = rig_figures.budget(side.primary, kind)
        if figure is not None:
            yield figure
    yield _components(side, named=named)


def _components(side: Side, *, named: bool) -> Table:
    rows = [
        (
            rig_figures.NAMES.get(name, name),
            correlation,
            *(percent(rig_figures.relative(side.primary, kind, name)) for kind in ("disc", "fibre")),
        )
        for name, correlation in rig_figures.components(side.primary).items()
    ]
    whole = (percent(rig_figures.relative(side.primary, kind)) for kind in ("disc", "fibre"))
    title = "Standard uncertainty of a cell's value" + (f", {side.name}" if named else "")
    note = "k = 1, relative. Medians over cells, wavelengths and incidences; the combined median is not the root sum of squares of the others."
    return Table(title, ("Component", "from cell to cell", "Disc", "Fibres"), [*rows, ("combined", "", *whole)], note)
