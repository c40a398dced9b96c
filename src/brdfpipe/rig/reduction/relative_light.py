"""From the frames of one arrangement to the relative light of each cell, q = L / (L′/T), with its uncertainty.

Each frame is divided by the light of its own reference spot, which removes the lamp and the exposure time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import xarray as xr

from brdfpipe import vocabulary
from brdfpipe.errors import BrdfpipeError, abbreviated
from brdfpipe.geometry import Array
from brdfpipe.rig.checks.frame_judge import Finding
from brdfpipe.rig.checks.run_checks import relevant, run_findings
from brdfpipe.rig.description import Rig
from brdfpipe.rig.filter_location import check_overlaps
from brdfpipe.rig.frames import NOT_MEASURED
from brdfpipe.rig.plan import Shot
from brdfpipe.rig.reduction import brackets, etalon_change, exposures, line_lamp, pictures
from brdfpipe.rig.reduction.brackets import Bracket, DarkFrames, ReferenceSpot, Scale
from brdfpipe.rig.reduction.cell_signals import cell_signals
from brdfpipe.rig.reduction.exposures import Merged
from brdfpipe.rig.reduction.lamp_monitor import lamp_monitor_readings, lamp_repeatability
from brdfpipe.rig.reduction.registration import Registration
from brdfpipe.rig.reduction.session_registration import centre_disc, register_fibres

COMPONENTS = {
    "noise": "independent",
    "repeat": "common",
    "reference": "common",
    "nd": "common",
    "glare": "common",
    "geometry": "independent",
}
"""Uncertainty components of q, independent from cell to cell or common to all cells of a picture."""

_OUT_OF_RANGE = 0.99  # share of pixels out of the linear range above which a frame is unusable
_USELESS = ("constant", "identical", "dark shows light", "equal to its dark")
"""Checks whose bad frames contradict no label: those of light frames are left out like missing ones."""

_USELESS_DARK = ("constant", "saturated", "dark shows light")
"""Checks whose bad dark frames are left out like missing ones."""

_HARMLESS = (*_USELESS, "saturated")
"""Checks whose bad frames do not contradict their labels."""

_LEFT_OUT = "The frame is not used; delete its file, and `brdfpipe rig scan … --resume` takes it again."
_CHECKED = 5  # wavelengths whose overlapping frames are checked for the position of the filters
_LISTED = 8  # most entries of a list in a message


Findings = list[tuple[Shot, Finding]]


class ReductionError(BrdfpipeError):
    """Frames that do not make a measurement."""


def reduce(
    frames: xr.Dataset,
    rig: Rig,
    *,
    load: str = "sample",
    side: str = "reflection",
    incidence: float | None = None,
    target: xr.Dataset | None = None,
    override: bool = False,
) -> xr.Dataset:
    """Relative light of each cell, of one arrangement.

    Parameters
    ----------
    frames : kind ``frames``; those of the arrangement are used, and the dark ones
    rig : as described
    load : ``sample`` or ``etalon``
    side : ``reflection`` or ``transmission``
    incidence : the entrance [degree]; optional if all frames are of one
    target : kind ``frames`` with pictures of the rig's angular target, if not among the others; without any the disc's centre is as
        described
    override : continue although overlapping frames contradict ``nd_location``

    Returns
    -------
    Dataset of kind ``reduced``: ``signal(incidence, wavelength, cell)`` and its components of uncertainty, ``reference(incidence,
    wavelength)`` [e⁻/s] and its mean time, ``elapsed``. A wavelength at which no frame shows the reference has no values; a warning names
    it. Monitor readings of the lamp through this entrance are in ``drift_reference(look)`` [e⁻/s], with ``drift_elapsed`` [s] and
    ``drift_wavelength`` [nm]. An etalon that was measured before and after the sample is interpolated to the time of the sample, and its
    change is in ``etalon_change(incidence, wavelength, cell)``.

    Raises
    ------
    ReductionError : there are no such frames, or no light; overlapping frames contradict ``nd_location``.
    ExposureError : there are no dark frames of an exposure time.
    """
    vocabulary.validate(frames, "frames")
    if load == "etalon" and etalon_change.measured_twice(frames, incidence):
        first, second = (
            reduce(part, rig, load=load, side=side, incidence=incidence, target=target, override=override)
            for part in etalon_change.before_and_after(frames)
        )
        return etalon_change.interpolated(first, second, frames)
    _check_same_rig(frames, rig)
    target = frames if target is None else target
    if rig.target is not None and target is not frames and (target["purpose"] == "target").any():
        _check_same_rig(target, rig)
    chosen = _frames_of_arrangement(frames, load, side, incidence)
    frames, target, frame_warnings = _without_bad_frames(frames, target, chosen, rig, override)
    chosen = _frames_of_arrangement(frames, load, side, incidence)
    darks = DarkFrames.of(frames, rig)
    warnings = [*_too_few_darks(darks), *_filter_warnings(frames, chosen, rig, override)]
    warnings += frame_warnings
    wavelengths = np.unique(chosen["wavelength"].values)
    spot: ReferenceSpot | None = None
    scales: list[Scale] = []
    merged: list[Merged | None] = []
    elapsed: list[float] = []
    hits = 0
    for wavelength in wavelengths:
        own = chosen.isel(frame=chosen["wavelength"].values == wavelength)
        bracket = brackets.read_bracket(own, darks, rig)
        hits += bracket.cosmic_hits
        warnings += _unusable_frames(own, bracket)
        spot = spot or brackets.locate_reference_spot(rig, bracket)
        scales.append(brackets.scale_bracket(bracket, spot, rig))
        merged.append(pictures.merge_bracket(bracket, scales[-1]))
        elapsed.append(float(own["elapsed"].values.mean()))
    warnings += _without_reference(wavelengths, scales)
    assert spot is not None
    mean = pictures.lamp_weighted_mean(merged, scales)
    registration = register_fibres(rig, *mean, frames, chosen, darks)
    registration = centre_disc(rig, registration, frames, target, darks)
    repeat_u, repeat_warnings = lamp_repeatability(frames, darks, spot, rig)
    reduced = cell_signals(rig, registration, wavelengths, merged, scales, repeat_u)
    reduced = reduced.assign(elapsed=("wavelength", elapsed))
    reduced = reduced.assign(lamp_monitor_readings(frames, chosen, darks, spot, rig))
    lines = line_lamp.read_lines(frames, rig)
    warnings += [*repeat_warnings, *_cell_warnings(reduced)]
    warnings += line_lamp.line_warnings(lines, float(frames.attrs.get("line_tolerance", np.inf)))
    reduced = _reduced_dataset(reduced, chosen, rig, registration, warnings)
    reduced.attrs["wavelength_u"] = line_lamp.wavelength_u(lines, rig.monochromator.wavelength_u)
    return (
        vocabulary.add_history(reduced, f"{hits} isolated bright pixels were removed as cosmic hits.")
        if hits
        else reduced
    )


def _check_same_rig(frames: xr.Dataset, rig: Rig) -> None:
    if frames.attrs["rig_digest"] != rig.digest:
        raise ReductionError(
            f"the frames were taken with another rig ({frames.attrs['rig']}) than {rig.name} as described; "
            "reduce a run with the rig.yaml in its own folder"
        )


def _frames_of_arrangement(frames: xr.Dataset, load: str, side: str, incidence: float | None) -> xr.Dataset:
    """The light frames of one arrangement."""
    matching = (frames["purpose"].values == load) & (frames["side"].values == side)
    chosen = frames.isel(frame=matching & ((incidence is None) | (frames["incidence"].values == incidence)))
    incidences = np.unique(chosen["incidence"].values)
    if not incidences.size:
        where = "" if incidence is None else f" at {incidence:g} degree"
        # The last warnings name what is missing and how to take it.
        lost = [text for text in reversed(vocabulary.warnings(frames)) if text != NOT_MEASURED]
        raise ReductionError(
            f"no frame of the {load} in {side}{where}; check the plan's `runs`, `side` and `incidences`"
            + (f". Missing frames: {abbreviated(lost, _LISTED, '; ')}" if lost else "")
        )
    if incidences.size > 1:
        listed = ", ".join(f"{angle:g}" for angle in incidences)
        raise ReductionError(f"the frames are of several incidences ({listed} degree); choose one as `incidence`")
    return chosen


def _filter_warnings(frames: xr.Dataset, chosen: xr.Dataset, rig: Rig, override: bool) -> list[str]:
    """Contradictions of overlapping frames to the description of the filters; a few wavelengths are enough to find them."""
    wavelengths = np.unique(chosen["wavelength"].values)
    checked = wavelengths[:: -(-wavelengths.size // _CHECKED)]
    some = chosen.isel(frame=np.isin(chosen["wavelength"].values, checked))
    dark = frames.isel(frame=frames["purpose"].values == "dark")
    check = check_overlaps(xr.concat([some, dark], "frame"), rig)
    if check.overlaps and check.nd_location != rig.nd_location and not override:
        raise ReductionError("; ".join(check.warnings))
    return list(check.warnings)


def _without_bad_frames(
    frames: xr.Dataset, target: xr.Dataset, chosen: xr.Dataset, rig: Rig, override: bool
) -> tuple[xr.Dataset, xr.Dataset, list[str]]:
    """The frames and those of the target without the ones that show nothing, and warnings.

    ReductionError if frames contradict their labels and this is not accepted by ``override``: which of them are wrong is unknown. So too if
    no dark frame of an exposure time, or no frame of the arrangement, can be used.
    """
    load, side, incidence = (chosen[name].values[0].item() for name in ("purpose", "side", "incidence"))
    found = run_findings(relevant(frames, load, side, incidence), rig)
    of_target: Findings = []
    if target is not frames:
        of_target = run_findings(target.isel(frame=np.isin(target["purpose"].values, ("target", "dark"))), rig)
    if not override:
        _refuse_contradictions(found, of_target)
    useless = _useless(found)
    kept, lost = _underexposed(chosen, found, useless)
    useless -= kept
    usable = _without(frames, useless)
    used_target = usable if target is frames else _without(target, _useless(of_target))
    warnings = [
        f"{text[0].upper()}{text[1:]}.{f' {_LEFT_OUT}' if left_out else ''}"
        for _, left_out, text in (*_sentences(found, "", kept), *_sentences(of_target, "target run, "))
    ]
    for before, after in ((frames, usable), (target, used_target)):
        _refuse_lost_darks(before, after, warnings)
    if lost:
        listed = abbreviated([f"{nm:g}" for nm in lost], _LISTED)
        if len(lost) == np.unique(chosen["wavelength"].values).size:
            raise ReductionError(f"no frame of the {load} at {incidence:g} degree can be used. {' '.join(warnings)}")
        warnings.append(
            f"{len(lost)} wavelengths are left out of the {load} at {incidence:g} degree, since none of their frames can be used: {listed} nm. "
            "Delete these frames, and take them again with `brdfpipe rig scan … --resume`."
        )
    return usable, used_target, warnings


def _is_useless(shot: Shot, finding: Finding) -> bool:
    return finding.severity == "bad" and finding.name in (_USELESS_DARK if shot.dark else _USELESS)


def _useless(found: Findings) -> set[int]:
    """Ordinals of the frames that are left out."""
    return {shot.ordinal for shot, finding in found if _is_useless(shot, finding)}


def _without(frames: xr.Dataset, useless: set[int]) -> xr.Dataset:
    return frames.isel(frame=~np.isin(frames["shot"].values, list(useless)))


def _sentences(found: Findings, prefix: str = "", kept: Iterable[int] = ()) -> list[tuple[str, bool, str]]:
    """For each check, and for frames that are left out and others: its name, whether they are left out, and the first of them in words.

    Frames ``kept`` are not left out.
    """
    texts: dict[tuple[str, bool], list[str]] = {}
    for shot, finding in found:
        left_out = _is_useless(shot, finding) and shot.ordinal not in kept
        texts.setdefault((finding.name, left_out), []).append(f"{prefix}frame {shot.ordinal}: {finding.text}")
    return [
        (name, left_out, f"{lines[0]}{f' ({len(lines)} such frames)' if len(lines) > 1 else ''}")
        for (name, left_out), lines in texts.items()
    ]


def _refuse_contradictions(found: Findings, of_target: Findings) -> None:
    bad = [
        [(shot, finding) for shot, finding in findings if finding.severity == "bad" and finding.name not in _HARMLESS]
        for findings in (found, of_target)
    ]
    sentences = [*_sentences(bad[0]), *_sentences(bad[1], "target run, ")]
    if sentences:
        raise ReductionError(
            f"frames contradict their labels: {'; '.join(text for *_, text in sentences)}. Take the frames again, or "
            "accept them with `override: true`, which the results record"
        )


def _underexposed(chosen: xr.Dataset, found: Findings, useless: set[int]) -> tuple[set[int], list[float]]:
    """Among wavelengths without a usable frame: the frames that are only too dark, and the wavelengths without such frames [nm].

    Frames that are too dark keep their wavelength in the result, without values and with a warning. Others would give it wrong values.
    """
    otherwise = {
        shot.ordinal for shot, finding in found if _is_useless(shot, finding) and finding.name != "equal to its dark"
    }
    kept: set[int] = set()
    lost = []
    for wavelength in np.unique(chosen["wavelength"].values):
        own = set(chosen["shot"].values[chosen["wavelength"].values == wavelength].tolist())
        if own <= useless:
            kept |= own - otherwise
            if own <= otherwise:
                lost.append(float(wavelength))
    return kept, lost


def _refuse_lost_darks(frames: xr.Dataset, usable: xr.Dataset, warnings: list[str]) -> None:
    """Raise ReductionError if every dark frame of an exposure time is left out."""
    before, after = (
        set(some["exposure"].values[some["purpose"].values == "dark"].tolist()) for some in (frames, usable)
    )
    if lost := sorted(before - after):
        listed = abbreviated([f"{exposure:g}" for exposure in lost], _LISTED)
        raise ReductionError(f"no dark frame of {listed} s can be used. {' '.join(warnings)}")


def _too_few_darks(darks: DarkFrames) -> Iterator[str]:
    for exposure, dark in darks.by_exposure.items():
        if dark.frames < exposures.FEWEST_DARKS:
            yield (
                f"Too few dark frames of {exposure:g} s: only {dark.frames}, so their noise adds to that of every frame. "
                f"Take {exposures.FEWEST_DARKS} or more (`darks` of the plan)."
            )


def _unusable_frames(frames: xr.Dataset, bracket: Bracket) -> Iterator[str]:
    """Frames with next to no pixel in the linear range."""
    for shot, usable in zip(frames["shot"].values, bracket.usable, strict=True):
        if usable.mean() < 1 - _OUT_OF_RANGE:
            wavelength = float(frames["wavelength"].values[0])
            yield (
                f"Frame {shot} ({wavelength:g} nm) exceeds the camera's linear range everywhere and is not used. Check the shutter and the "
                "light of the room; delete its file, and `brdfpipe rig scan … --resume` takes it again."
            )


def _without_reference(wavelengths: Array, scales: list[Scale]) -> Iterator[str]:
    """Wavelengths at which no frame shows the reference; :class:`ReductionError` if these are all."""
    dark = [f"{nm:g}" for nm, scale in zip(wavelengths, scales, strict=True) if not np.isfinite(scale.lamp)]
    if len(dark) == len(scales):
        raise ReductionError(
            "the reference spot is out of range, or dark, in every frame; check that the lamp burns, and shorten or lengthen an exposure "
            "of the plan's `bracket`"
        )
    if dark:
        yield (
            f"{len(dark)} of {len(scales)} wavelengths have no values: the reference spot is out of range, or dark, in every frame at "
            f"{abbreviated(dark, _LISTED)} nm. Shorten or lengthen an exposure of the plan's `bracket`."
        )


def _cell_warnings(reduced: xr.Dataset) -> Iterator[str]:
    saturated = (reduced["signal_quality"] == vocabulary.quality("saturated")).sum("cell").values
    if saturated.any():
        wavelength = float(reduced["wavelength"].values[int(saturated.argmax())])
        yield (
            f"Up to {saturated.max()} cells ({wavelength:g} nm) are saturated in every frame of the bracket. They have no value, and the glare "
            "they cause is unknown. Add a shorter exposure, or a darker filter, to the plan's `bracket`."
        )
    if not np.isfinite(reduced.attrs["glare_share"]):
        yield (
            "Veiling glare was not subtracted, nor is it in the uncertainty: too few pixels between disc and fibres show it. Let the camera "
            "see more of the screen."
        )


def _reduced_dataset(
    reduced: xr.Dataset, chosen: xr.Dataset, rig: Rig, registration: Registration, warnings: list[str]
) -> xr.Dataset:
    """The dataset of kind ``reduced``, with its one incidence."""
    incidence = float(chosen["incidence"].values[0])
    fibres = np.array([fibre.u for fibre in rig.fibres])
    reduced = reduced.assign_coords(direction_u=("cell", np.pad(fibres, (0, reduced.sizes["cell"] - fibres.size))))
    spectral = [name for name, field in reduced.data_vars.items() if "wavelength" in field.dims]
    reduced = reduced.assign(reduced[spectral].expand_dims(incidence=[incidence]))
    for name, correlation in COMPONENTS.items():
        reduced[f"signal_u_{name}"].attrs["correlation"] = correlation
    clearest = max(
        (rig.filter_at(int(position)) for position in np.unique(chosen["nd_position"].values)),
        key=lambda nd_filter: nd_filter.transmittance,
    )
    reduced.attrs = {
        **{name: chosen.attrs[name] for name in ("rig", "rig_digest", "sample", "day")},
        "camera": chosen.attrs.get("camera", ""),
        **{name: chosen.attrs[name] for name in ("drift_tolerance",) if name in chosen.attrs},
        "load": str(chosen["purpose"].values[0]),
        "side": str(chosen["side"].values[0]),
        "filter": clearest.position,
        "filter_u": clearest.u,
        "glare_share": reduced.attrs["glare_share"],
        "registration_spots": registration.spots,
        "registration_shift": list(registration.shift(rig)),
        "registration_u": registration.shift_u,
        "disc_centre": list(registration.screen.disc_centre),
        "disc_centre_u": registration.direction_u,
        "disc_scale_u": registration.scale_u,
        "slit": rig.slit,
        "polarisation": rig.monochromator.polarisation,
        "linearity_u": rig.camera.linearity_u,
    }
    reduced = vocabulary.add_warning(reduced, *vocabulary.warnings(chosen), *dict.fromkeys(warnings))
    return vocabulary.validate(vocabulary.label(reduced, "reduced"), "reduced")
