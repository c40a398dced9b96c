"""From the frames of one arrangement to the relative light of each cell: q = L / (L′/T), with what is uncertain about it.

Each frame is divided by the light of its own reference spot, so that neither the lamp nor the exposure time is left in it; the
bracket is merged, the glare removed, and cells are summed with one sparse matrix (:mod:`brdfpipe.rig.reduction.cells`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy import ndimage, sparse

from brdfpipe import vocabulary
from brdfpipe.errors import BrdfpipeError
from brdfpipe.geometry import Array
from brdfpipe.rig import screen as screens
from brdfpipe.rig.description import Rig, Screen
from brdfpipe.rig.frame_checks import overlap_check
from brdfpipe.rig.frames import NOT_MEASURED
from brdfpipe.rig.reduction import brackets, exposures, registration, thumbnails
from brdfpipe.rig.reduction import cells as celled
from brdfpipe.rig.reduction import glare as glares
from brdfpipe.rig.reduction.arrangements import ENTRANCE_EXCLUSION_RADIUS
from brdfpipe.rig.reduction.brackets import Bracket, Darkness, Scale, Spot
from brdfpipe.rig.reduction.exposures import Mask, Merged
from brdfpipe.rig.reduction.registration import Registration

COMPONENTS = {
    "noise": "independent",
    "repeat": "common",
    "reference": "common",
    "nd": "common",
    "glare": "common",
    "geometry": "independent",
}
"""Components of the uncertainty of q, and whether they are independent from cell to cell or common to all of a picture."""

_MARGIN = 4.0
"""Distance from disc and spots at which the picture holds glare alone [pixel]."""

_BELOW_NOISE = 2.0
"""A cell is below the noise if its light is less than so many times its noise."""

_BLIND = 0.99
"""Share of pixels out of range from which a frame shows nothing."""

_SMOOTH = 1.5
"""Standard deviation of the Gaussian [pixel] over which the curvature of the light on the disc is taken."""

_REACH = 6.0
"""How many of these it goes; ended at four, its second derivative would find a curvature of 1e-4 in even light."""

_LIFTED = 1.2
"""Most of the light of a cell over its smoothed light."""

_CLEAR_OF_RIM = 3.5
"""How many of these from the rim of the disc the curvature is not taken: the rim itself would bend it."""

CURVATURE_U, _CURVATURE_NEXT = 0.05, 0.15
"""Relative standard uncertainty of what the curvature changes in a cell's mean; and half of the term beyond it over its square, as of
the exponential that the flank of a lobe is: sinh x / x = 1 + b + 0.3 b² + …, b = x²/6."""

_WHOLE = 0.98
"""Share of a cell within the picture, and within the rim of the disc, below which it is vignetted."""

REPEAT_U = 0.01 / 3**0.5
"""Relative standard uncertainty of light over its reference that is expected before a run tells how well it repeats: of ±1 %, evenly, the
better end of the 1 to 3 % that are told of such a rig (Voloboy et al. 2005)."""

_FEWEST_REPEATED = 2
"""Repetitions from which more is told of it than was expected."""

_JUDGED = 5
"""Wavelengths whose overlaps tell where the filters stand."""

_TOLD = 8
"""Of a list in a message."""


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
    incidence : the entrance [degree]; may be left out where the frames are of one
    target : kind ``frames`` with pictures of the rig's angular target, if not among the others; without any the disc's centre is as
        described
    override : go on where overlapping frames contradict ``nd_location``

    Returns
    -------
    Dataset of kind ``reduced``: ``signal(incidence, wavelength, cell)`` and its components of uncertainty, ``reference(incidence,
    wavelength)`` [e⁻/s] and when it was seen, ``elapsed``. A wavelength at which no frame shows the reference has no values, and is named
    in the warnings. Looks at the lamp through this entrance are in ``drift_reference(look)`` [e⁻/s], with ``drift_elapsed`` [s] and
    ``drift_wavelength`` [nm].

    Raises
    ------
    ReductionError : there are no such frames, or no light; overlapping frames contradict ``nd_location``.
    ExposureError : there are no dark frames of an exposure time.
    """
    vocabulary.validate(frames, "frames")
    _check_rig(frames, rig)
    chosen = _chosen(frames, load, side, incidence)
    darkness = Darkness.of(frames, rig)
    notes = [*_few_darks(darkness), *_checked_filters(frames, chosen, rig, override)]
    wavelengths = np.unique(chosen["wavelength"].values)
    spot: Spot | None = None
    scales: list[Scale] = []
    merged: list[Merged | None] = []
    for wavelength in wavelengths:
        own = chosen.isel(frame=chosen["wavelength"].values == wavelength)
        bracket = brackets.bracket(own, darkness, rig)
        notes += _blind(own, bracket)
        spot = spot or brackets.reference_spot(rig, bracket)
        scales.append(brackets.scaled(bracket, spot, rig))
        merged.append(_merged(bracket, scales[-1]))
    notes += _unlit(wavelengths, scales)
    assert spot is not None
    found = _registered(rig, _without_glare(rig, *_mean(merged, scales)), frames, chosen, darkness)
    found = _centred(rig, found, frames, frames if target is None else target, darkness)
    looks = _looks(frames, chosen, darkness, spot, rig)
    repeat, said = _repeat(frames, darkness, spot, rig)
    notes += said
    reduced = _cells(rig, found, wavelengths, merged, scales, repeat)
    reduced = reduced.assign(_times(chosen, wavelengths) | _drift(looks, rig))
    return _labelled(reduced, chosen, rig, found, [*notes, *_too_bright(reduced), *_no_glare(reduced)])


# --- which frames


def _check_rig(frames: xr.Dataset, rig: Rig) -> None:
    if frames.attrs["rig_digest"] != rig.digest:
        raise ReductionError(
            f"the frames were taken with another rig ({frames.attrs['rig']}) than {rig.name} as described; "
            "reduce a run with the rig.yaml in its own folder"
        )


def _chosen(frames: xr.Dataset, load: str, side: str, incidence: float | None) -> xr.Dataset:
    """The light frames of one arrangement."""
    kept = (frames["purpose"].values == load) & (frames["side"].values == side)
    if incidence is not None:
        kept &= frames["incidence"].values == incidence
    chosen = frames.isel(frame=kept)
    found = np.unique(chosen["incidence"].values)
    where = "" if incidence is None else f" at {incidence:g} degree"
    if not found.size:
        # What is missing and how to have it comes last there.
        lost = [text for text in reversed(vocabulary.warnings(frames)) if text != NOT_MEASURED]
        listed = "; ".join(lost[:_TOLD]) + ("; …" if len(lost) > _TOLD else "")
        raise ReductionError(
            f"no frame of the {load} in {side}{where}; check the plan's `runs`, `side` and `incidences`"
            + (f". What was lost: {listed}" if lost else "")
        )
    if found.size > 1:
        listed = ", ".join(f"{each:g}" for each in found)
        raise ReductionError(f"the frames are of several incidences ({listed} degree); say which")
    return chosen


def _few_darks(darkness: Darkness) -> Iterator[str]:
    for exposure, dark in darkness.darks.items():
        if dark.frames < exposures.FEWEST_DARKS:
            yield (
                f"dark frames of {exposure:g} s: only {dark.frames}, whose own noise adds to that of every frame; "
                f"take {exposures.FEWEST_DARKS} or more (`darks` of the plan)"
            )


def _checked_filters(frames: xr.Dataset, chosen: xr.Dataset, rig: Rig, override: bool) -> list[str]:
    """What overlapping frames say against the description of the filters; the better part of the wavelengths tells no more."""
    wavelengths = np.unique(chosen["wavelength"].values)
    some = chosen.isel(frame=np.isin(chosen["wavelength"].values, wavelengths[:: -(-wavelengths.size // _JUDGED)]))
    found = overlap_check(xr.concat([some, _purpose(frames, "dark")], "frame"), rig)
    if found.overlaps and found.nd_location != rig.nd_location and not override:
        raise ReductionError("; ".join(found.warnings))
    return list(found.warnings)


def _purpose(frames: xr.Dataset, purpose: str) -> xr.Dataset:
    return frames.isel(frame=frames["purpose"].values == purpose)


def _blind(frames: xr.Dataset, bracket: Bracket) -> Iterator[str]:
    """Frames that show nothing."""
    for shot, usable in zip(frames["shot"].values, bracket.usable, strict=True):
        if usable.mean() < 1 - _BLIND:
            wavelength = float(frames["wavelength"].values[0])
            yield (
                f"frame {shot} ({wavelength:g} nm) is beyond the linear range everywhere and tells nothing; was the shutter stuck, or the "
                "room lit? `brdfpipe rig scan … --resume` takes it again once its file is deleted"
            )


def _unlit(wavelengths: Array, scales: list[Scale]) -> Iterator[str]:
    """Wavelengths without a reference.

    Raises
    ------
    ReductionError : all of them.
    """
    dim = [f"{each:g}" for each, scale in zip(wavelengths, scales, strict=True) if not np.isfinite(scale.lamp)]
    if len(dim) == len(scales):
        raise ReductionError(
            "the reference spot is out of range, or dark, in every frame; see that the lamp burns, and shorten or lengthen an exposure "
            "of the plan's `bracket`"
        )
    if dim:
        listed = ", ".join(dim[:_TOLD]) + (", …" if len(dim) > _TOLD else "")
        yield (
            f"{len(dim)} of {len(scales)} wavelengths have no values: the reference spot is out of range, or dark, in every frame at "
            f"{listed} nm; shorten or lengthen an exposure of the plan's `bracket`"
        )


def _too_bright(reduced: xr.Dataset) -> Iterator[str]:
    saturated = (reduced["signal_quality"] == vocabulary.quality("saturated")).sum("cell").values
    if saturated.any():
        where = float(reduced["wavelength"].values[int(saturated.argmax())])
        yield (
            f"up to {saturated.max()} cells ({where:g} nm) are brighter than any frame of the bracket holds: they have no value, and the glare "
            "they cause is not known; add a shorter exposure, or a darker filter, to the plan's `bracket`"
        )


def _no_glare(reduced: xr.Dataset) -> Iterator[str]:
    if not np.isfinite(reduced.attrs["glare_share"]):
        yield (
            "veiling glare was not removed, nor is it in the uncertainty: too few pixels lie between disc and fibres to tell it; let the camera "
            "see more of the screen"
        )


# --- pictures


def _merged(bracket: Bracket, scale: Scale) -> Merged | None:
    if not np.isfinite(scale.lamp):
        return None
    return exposures.merge(bracket.light, bracket.usable, scale.k, bracket.floor)


def _filled(merged: Merged) -> Array:
    """A merged picture for the glare: what is brighter than every frame holds at least what the fastest of them could."""
    brightest = np.nanmax(merged.light, initial=0.0)
    return np.where(merged.saturated, brightest, merged.light).astype(float)


def _mean(merged: list[Merged | None], scales: list[Scale]) -> tuple[Array, Array]:
    """A picture of all wavelengths, weighted as the lamp has them, and its variance."""
    known = [(each, scale.lamp) for each, scale in zip(merged, scales, strict=True) if each is not None]
    lamp = sum(each for _, each in known)
    total = sum((each * _filled(picture) for picture, each in known), np.zeros(()))
    noise = (np.where(picture.saturated, np.nanmax(picture.variance), picture.variance) for picture, _ in known)
    variance = sum((each**2 * of_picture for of_picture, (_, each) in zip(noise, known, strict=True)), np.zeros(()))
    return np.asarray(total / lamp), np.asarray(variance / lamp**2, dtype=float)


def _without_glare(rig: Rig, picture: Array, variance: Array) -> tuple[Array, Array]:
    """The glare of a bright lobe falls off across a faint spot, and would draw its centroid."""
    background = _background(rig, registration.register(rig, picture, variance).screen)
    return glares.removed(picture, glares.estimate(picture, variance, background)), variance


def _one_picture(frames: xr.Dataset, darkness: Darkness, rig: Rig) -> tuple[Array, Array] | None:
    """A picture of one wavelength and its variance."""
    bracket = brackets.bracket(frames, darkness, rig)
    scale = brackets.scaled(bracket, brackets.reference_spot(rig, bracket), rig)
    merged = _merged(bracket, scale)
    return None if merged is None else _mean([merged], [scale])


def _registered(
    rig: Rig, picture: tuple[Array, Array], frames: xr.Dataset, chosen: xr.Dataset, darkness: Darkness
) -> Registration:
    """Where the pictures lie; scale and radial term, where few fibres shine, by what else was in the holder that session."""
    found = registration.register(rig, *picture)
    if found.spots >= registration.FIBRES_ENOUGH:
        return found
    others = frames.isel(
        frame=np.isin(frames["purpose"].values, ("sample", "etalon"))
        & ~np.isin(frames["shot"].values, chosen["shot"].values)
    )
    for _, of_arrangement in others.groupby(["purpose", "side", "incidence"]) if others.sizes["frame"] else ():
        wavelengths = np.unique(of_arrangement["wavelength"].values)
        middle = of_arrangement["wavelength"].values == wavelengths[wavelengths.size // 2]
        other = _one_picture(of_arrangement.isel(frame=middle), darkness, rig)
        if other and (seen := registration.register(rig, *other)).spots >= registration.FIBRES_ENOUGH:
            return registration.register(rig, *picture, seen.screen)
    return found


def _centred(rig: Rig, found: Registration, frames: xr.Dataset, target: xr.Dataset, darkness: Darkness) -> Registration:
    """Where the mirror direction falls on the disc, by the pictures of the rig's angular target."""
    own = _purpose(target, "target")
    if rig.target is None or not own.sizes["frame"]:
        return found
    _check_rig(target, rig)
    dark_target = darkness if target is frames else Darkness.of(target, rig)
    picture = _one_picture(own, dark_target, rig)
    if picture is None:
        return found
    # Where little but the target shines the reference tells the shift of its pictures; the lens is the same in every session.
    there = registration.register(rig, *picture, found.screen)
    spots, kept = rig.target, _kept(rig, found, frames, darkness)
    if kept is None and target is not frames:
        kept = _kept(rig, there, target, dark_target)
    centred = registration.centre_disc(there, *picture, spots.theta_s, spots.phi_s, spots.radius, kept)
    screen = replace(found.screen, disc=centred.screen.disc, focal_length=centred.screen.focal_length)
    return replace(found, screen=screen, direction_u=centred.direction_u, scale_u=centred.scale_u)


def _kept(rig: Rig, found: Registration, frames: xr.Dataset, darkness: Darkness) -> Array | None:
    """What the lens keeps of the light of each pixel, by a picture of the etalon; None if there is none.

    It is taken through the entrance that tilts the etalon least without hiding a part of the disc.
    """
    etalon = _purpose(frames, "etalon")
    rim = np.degrees(np.arctan(rig.screen.disc_radius / rig.screen.focal_length))
    entrances = np.unique(etalon["incidence"].values)
    # Towards an entrance σ the fixed direction is turned by 2σ.
    clear = entrances[(2 * entrances > rim + ENTRANCE_EXCLUSION_RADIUS) & (2 * entrances + rim < 90)]
    if not clear.size:
        return None
    etalon = etalon.isel(frame=etalon["incidence"].values == clear[0])
    wavelengths = np.unique(etalon["wavelength"].values)
    etalon = etalon.isel(frame=etalon["wavelength"].values == wavelengths[wavelengths.size // 2])
    picture = _one_picture(etalon, darkness, rig)
    return None if picture is None else registration.falloff(found, picture[0], float(clear[0]))


# --- the lamp


class _Looks(NamedTuple):
    """Looks at one state."""

    frames: xr.Dataset
    seen: Bracket
    reference: Array
    """(look,) electrons of the reference spot."""
    u: Array
    """Relative."""


def _looks(frames: xr.Dataset, chosen: xr.Dataset, darkness: Darkness, spot: Spot, rig: Rig) -> _Looks | None:
    """The looks at the lamp through the entrance of the arrangement, whatever was in the holder; None if there are none."""
    looks = _purpose(frames, "drift")
    here = np.ones(looks.sizes["frame"], dtype=bool)
    for name in ("side", "incidence"):
        here &= looks[name].values == chosen[name].values[0]
    if not here.any():
        return None
    looks = looks.isel(frame=here)
    seen = brackets.bracket(looks, darkness, rig)
    return _Looks(looks.drop_vars("counts"), seen, *brackets.reference_light(seen, spot))


def _repeat(frames: xr.Dataset, darkness: Darkness, spot: Spot, rig: Rig) -> tuple[float, list[str]]:
    """Relative scatter of the light over its reference between frames of one state, and what is to be said of it.

    A look at the lamp repeats a frame of its arrangement: all repetitions that the run holds count, whatever lay in the holder, if they are
    bright enough to tell more than :data:`REPEAT_U`, which counts as one of them. What noise makes of them is taken off.
    """
    scatter, freedom = 0.0, 0
    for of_state in _states(frames, darkness):
        seen = brackets.bracket(of_state, darkness, rig)
        reference, u = brackets.reference_light(seen, spot)
        lit = seen.usable.all(axis=0) & spot.away & (seen.light.mean(axis=0) > np.sqrt(seen.floor.mean()))
        light = np.where(lit, seen.light, 0.0).sum(axis=(1, 2), dtype=float)
        if not ((light > 0) & np.isfinite(reference)).all():
            continue
        chance = float(((light + lit.sum() * seen.floor) / light**2 + u**2).mean())
        if chance < REPEAT_U**2:
            ratio, more = light / reference, light.size - 1
            scatter += more * (float(ratio.var(ddof=1) / ratio.mean() ** 2) - chance)
            freedom += more
    found = float(np.sqrt((max(scatter, 0.0) + REPEAT_U**2) / (freedom + 1)))
    if freedom >= _FEWEST_REPEATED:
        return found, []
    return found, [
        f"the looks at the lamp hardly tell how well the light repeats over its reference, for they are too few or too dim: {found:.1%} is taken "
        "for its standard uncertainty; look more often (`drift.every` of the plan), at a brighter frame of the bracket (`drift.step`)"
    ]


def _states(frames: xr.Dataset, darkness: Darkness) -> Iterator[xr.Dataset]:
    """Frames that are alike: looks at the lamp of one arrangement, and the frame of its bracket that they repeat."""
    names = ("load", "side", "incidence", "wavelength", "nd_position", "exposure")
    of_frame = list(zip(*(frames[name].values.tolist() for name in names), strict=True))
    purpose = frames["purpose"].values
    for state in sorted({of_frame[place] for place in np.flatnonzero(purpose == "drift")}):
        alike = np.array([each == state for each in of_frame]) & (purpose != "dark")
        if alike.sum() > 1 and state[-1] in darkness.darks:
            yield frames.isel(frame=alike)


def _drift(looks: _Looks | None, rig: Rig) -> dict[str, tuple[str, Array]]:
    """The light of the lamp at each look."""
    if looks is None:
        return {}
    rate = looks.reference / brackets.per_rate(looks.seen, rig)
    found = {"reference": rate, "reference_u": rate * looks.u}
    found |= {name: looks.frames[name].values for name in ("elapsed", "wavelength")}
    return {f"drift_{name}": ("look", each) for name, each in found.items()}


def _times(chosen: xr.Dataset, wavelengths: Array) -> dict[str, tuple[str, Array]]:
    """When the frames of each wavelength were exposed, on average."""
    elapsed = [chosen["elapsed"].values[chosen["wavelength"].values == each].mean() for each in wavelengths]
    return {"elapsed": ("wavelength", np.array(elapsed))}


# --- cells


def _cells(
    rig: Rig, found: Registration, wavelengths: Array, merged: list[Merged | None], scales: list[Scale], repeat: float
) -> xr.Dataset:
    """Sums over cells of the merged pictures, without their glare; wavelengths without a reference stay missing."""
    cells, weights = celled.cells_of(rig), celled.weights(rig, found.screen)
    area, whole = _areas(rig, found.screen, cells, weights)
    lit = [place for place, each in enumerate(merged) if each is not None]
    pictures = [each for each in merged if each is not None]
    background = _background(rig, found.screen)
    light = np.array([_filled(each) for each in pictures], dtype=float)
    halo = glares.estimate(*_mean(merged, scales), background)
    clean = glares.removed(light, halo)
    clean -= clean[:, background].mean(axis=1)[:, None, None] if background.any() else 0.0
    flat = clean.reshape(len(clean), -1)
    bend, bends = _curvature(rig, found, weights, clean, area, cells.of_disc)
    signal = _summed(weights, flat) - bend
    saturated = _summed(weights, np.array([each.saturated for each in pictures], dtype=float)) > 0
    variance = np.array([np.nan_to_num(each.variance) for each in pictures])
    # Each picture's light over that of their mean; of what is black nothing but noise is left.
    total = np.maximum(flat.sum(axis=1, keepdims=True), 0.0)
    brightness = total / max(float(total.mean()), 1e-300)
    reference, nd = _of_frames(weights, clean, pictures, [scales[place] for place in lit])
    u = {
        # Noise bends the light too.
        "noise": np.sqrt(_summed((weights - bends).power(2), variance)),
        "repeat": repeat * np.abs(signal),
        "reference": reference * np.abs(signal),
        "nd": nd * np.abs(signal),
        "glare": brightness * glares.uncertainty(clean.mean(axis=0), halo, weights),
        "geometry": np.hypot(_misplaced(rig, found, weights, clean, cells.of_disc), _curvature_u(bend, signal)),
    }
    quality = np.full(signal.shape, vocabulary.quality("measured"), dtype=np.int8)
    quality[np.abs(signal) < _BELOW_NOISE * u["noise"]] = vocabulary.quality("below_noise")
    quality[saturated] = vocabulary.quality("saturated")
    quality[:, ~whole] = vocabulary.quality("vignetted")
    lost = saturated | ~whole
    everywhere = np.full((len(merged), len(area)), vocabulary.quality("below_noise"), dtype=np.int8)
    everywhere[lit] = quality
    values = {"signal": signal} | {f"signal_u_{name}": each for name, each in u.items()}
    variables = {
        name: _at(lit, np.where(lost, np.nan, each / np.maximum(area, 1e-9)), len(merged))
        for name, each in values.items()
    }
    drawn = thumbnails.drawing(light.mean(axis=0), rig, found.screen, weights)
    drawn.attrs["glare_share"] = halo.share if np.isfinite(halo.misfit) else np.nan
    return drawn.assign(
        {name: (("wavelength", "cell"), each) for name, each in variables.items()}
        | {"signal_quality": (("wavelength", "cell"), everywhere)}
        | {"reference": ("wavelength", np.array([scale.lamp for scale in scales]))}
        | {"reference_u": ("wavelength", np.array([scale.lamp_u for scale in scales]))}
    ).assign_coords(
        wavelength=("wavelength", wavelengths),
        cell=("cell", np.array(cells.names)),
        kind=("cell", np.array(cells.kinds)),
        theta_s=("cell", cells.theta_s),
        phi_s=("cell", cells.phi_s),
        solid_angle=("cell", cells.solid_angle),
    )


def _areas(rig: Rig, screen: Screen, cells: celled.Cells, weights: sparse.csr_array) -> tuple[Array, Mask]:
    """Area that the light of each cell is referred to [pixel], and whether the cell is seen whole.

    A fibre's end lies within its own margin: the area is the same in every session.
    """
    seen = weights.sum(axis=1)
    radius = celled.fibre_radii(rig, screen)
    ends = np.pi * radius**2
    stretch = screen.scale**2 / screens.disc_solid_angle(screen, cells.theta_s[radius.size :])
    expected = np.append(ends, cells.solid_angle[radius.size :] * stretch)
    within = np.append(np.ones(radius.size), weights[radius.size :] @ _within(rig, screen, 0.0).ravel())
    within[radius.size :] /= np.maximum(seen[radius.size :], 1e-9)
    nominal = np.pi * celled.fibre_radii(rig, rig.screen) ** 2
    return np.append(nominal, seen[radius.size :]), (seen >= 1) & (np.minimum(seen / expected, 1) * within >= _WHOLE)


def _background(rig: Rig, screen: Screen) -> Mask:
    """Pixels that hold glare alone."""
    margin = _MARGIN / screen.scale
    lit = _within(rig, screen, margin)
    places = [(fibre.x, fibre.y, screen.fibre_radius) for fibre in rig.fibres]
    for x, y, radius in (*places, (*screen.reference, screen.reference_radius)):
        lit |= _near(rig, screen, x, y, radius + margin)
    return ~lit


def _within(rig: Rig, screen: Screen, margin: float) -> Mask:
    """Pixels within the rim of the disc, widened by a margin [mm]."""
    return _near(rig, screen, *screen.disc, screen.disc_radius + margin)


def _near(rig: Rig, screen: Screen, x: float, y: float, radius: float) -> Mask:
    """Pixels that see the screen within a distance of a place [mm]."""
    found = np.zeros((rig.camera.height, rig.camera.width), dtype=bool)
    column, row = (float(each) for each in screens.to_pixel(screen, x, y))
    reach = 1.1 * radius * screen.scale + 2
    rows, columns = (
        np.arange(max(int(middle - reach), 0), min(int(middle + reach) + 2, size))
        for middle, size in ((row, rig.camera.height), (column, rig.camera.width))
    )
    place = screens.to_place(screen, columns, rows[:, None])
    found[np.ix_(rows, columns)] = np.hypot(place.x - x, place.y - y) < radius
    return found


def _curvature(
    rig: Rig, found: Registration, weights: sparse.csr_array, clean: Array, area: Array, of_disc: Mask
) -> tuple[Array, sparse.csr_array]:
    """What curvature adds to sums over the disc's cells, (wavelength, cell), and the weights of the light (cell, pixel) it comes from.

    The mean over a cell of second moments M about its middle is f + ½ Σ M_jk ∂_j∂_k f, and the core of the point spread adds its own to M.
    Derivatives are taken of the smoothed light, over that light: smoothing lifts both alike on the flank of a lobe. Near the rim they
    follow from the part of a cell that lies further in.
    """
    inner = _within(rig, found.screen, -_CLEAR_OF_RIM * _SMOOTH / found.screen.scale)
    within = sparse.csr_array(
        sparse.diags_array(of_disc.astype(float)) @ weights @ sparse.diags_array(inner.ravel() * 1.0)
    )
    within.eliminate_zeros()
    whole = area / np.maximum(within.sum(axis=1), 1.0)
    y, x = np.indices(inner.shape).reshape(2, -1)
    middle = [weights @ each / np.maximum(area, 1.0) for each in (y, x)]
    coefficients = {}
    for first, second in ((0, 0), (1, 1), (0, 1)):
        moment = weights @ ((y, x)[first] * (y, x)[second]) / np.maximum(area, 1.0) - middle[first] * middle[second]
        orders = ((first == 0) + (second == 0), (first == 1) + (second == 1))
        # Half of either second derivative, and of the mixed one twice; a pixel has 1/12 itself.
        coefficients[orders] = whole * ((moment + 1 / 12 + found.blur**2) / 2 if first == second else moment)
    bends, smooth = _smoothed(within, inner.shape, [coefficients, {(0, 0): whole}])
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.nan_to_num(_summed(weights, clean) / _summed(smooth, clean))
    # No more than that, whatever noise makes of faint light.
    return _summed(bends, clean) * np.clip(share, 0.0, _LIFTED), bends


def _smoothed(
    weights: sparse.csr_array, shape: tuple[int, ...], wanted: list[dict[tuple[int, int], Array]]
) -> list[sparse.csr_array]:
    """Weights (cell, pixel) that give sums over cells of derivatives of the smoothed light, each order times a coefficient of the cell.

    The Gaussian and its even derivatives are their own adjoints: in place of the light each cell's weights are filtered, within a
    box about it.
    """
    height, width = shape
    kept = np.flatnonzero(np.diff(weights.indptr))
    cell = np.repeat(np.arange(kept.size), np.diff(weights.indptr)[kept])
    row, column = np.divmod(weights.indices, width)
    reach = int(_REACH * _SMOOTH + 0.5) + 1
    starts = weights.indptr[kept]
    low = [np.minimum.reduceat(each, starts) - reach if kept.size else each for each in (row, column)]
    box = [int((each - least[cell]).max(initial=0)) + reach + 1 for each, least in zip((row, column), low, strict=True)]
    cut = np.zeros((kept.size, *box))
    cut[cell, row - low[0][cell], column - low[1][cell]] = weights.data
    y, x = (least[:, None] + np.arange(size) for least, size in zip(low, box, strict=True))
    seen = ((y >= 0) & (y < height))[:, :, None] & ((x >= 0) & (x < width))[:, None, :]
    place = (y[:, :, None] * width + x[:, None, :])[seen]
    owner = np.broadcast_to(kept[:, None, None], seen.shape)[seen]
    found = []
    for coefficients in wanted:
        filtered = sum(
            (
                each[kept, None, None]
                * ndimage.gaussian_filter(cut, (0, _SMOOTH, _SMOOTH), (0, *orders), mode="constant", truncate=_REACH)
                for orders, each in coefficients.items()
            ),
            np.zeros(cut.shape),
        )
        found.append(sparse.csr_array((filtered[seen], (owner, place)), shape=weights.shape))
    return found


def _curvature_u(bend: Array, signal: Array) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.nan_to_num(np.abs(bend / signal), posinf=1.0)
    return np.abs(bend) * np.minimum(CURVATURE_U + _CURVATURE_NEXT * share, 1.0)


def _misplaced(rig: Rig, found: Registration, weights: sparse.csr_array, clean: Array, of_disc: Mask) -> Array:
    """What the cells' light may be off because the picture, or on the disc the mirror direction, lies elsewhere.

    Where a fibre looks is taken as described.
    """
    centre = np.radians(found.direction_u) * rig.screen.focal_length * rig.screen.scale
    # Only on the disc does a wrong centre mean another direction.
    step = np.hypot(found.shift_u, np.where(of_disc, centre, 0.0))
    down, across = (np.asarray(each) for each in np.gradient(clean, axis=(1, 2)))
    return np.hypot(_summed(weights, across), _summed(weights, down)) * step


def _of_frames(
    weights: sparse.csr_array, clean: Array, pictures: list[Merged], scales: list[Scale]
) -> tuple[Array, Array]:
    """Relative uncertainties (wavelength, cell) that the frames' references and filters leave, by their shares in each cell."""
    found = []
    for picture, each, scale in zip(clean, pictures, scales, strict=True):
        shares = _summed(weights, each.shares * np.abs(picture))
        shares /= np.maximum(shares.sum(axis=0), 1e-300)
        found.append(
            [np.einsum("fc,fg,gc->c", shares, covariance, shares) for covariance in (scale.reference, scale.filters)]
        )
    reference, nd = np.sqrt(np.maximum(np.array(found).swapaxes(0, 1), 0.0))
    return reference, nd


def _summed(weights: sparse.csr_array, pictures: Array) -> Array:
    """Sums over cells of pictures, (picture, cell)."""
    return np.asarray((weights @ pictures.reshape(len(pictures), -1).T).T, dtype=float)


def _at(places: list[int], values: Array, count: int) -> Array:
    """Values of some wavelengths among all, which are missing elsewhere."""
    whole = np.full((count, values.shape[1]), np.nan)
    whole[places] = values
    return whole


def _labelled(reduced: xr.Dataset, chosen: xr.Dataset, rig: Rig, found: Registration, notes: list[str]) -> xr.Dataset:
    """The dataset of kind ``reduced``, with its one incidence."""
    incidence = float(chosen["incidence"].values[0])
    spectral = [name for name, each in reduced.data_vars.items() if "wavelength" in each.dims]
    reduced = reduced.assign(reduced[spectral].expand_dims(incidence=[incidence]))
    for name, correlation in COMPONENTS.items():
        reduced[f"signal_u_{name}"].attrs["correlation"] = correlation
    clearest = max(
        (rig.transmittance(int(position)) for position in np.unique(chosen["nd_position"].values)),
        key=lambda each: each.transmittance,
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
        "registration_spots": found.spots,
        "registration_shift": list(found.shift(rig)),
        "registration_u": found.shift_u,
        "disc_centre": list(found.screen.disc),
        "disc_centre_u": found.direction_u,
        "disc_scale_u": found.scale_u,
    }
    carried = vocabulary.add_warning(reduced, *vocabulary.warnings(chosen), *dict.fromkeys(notes))
    return vocabulary.validate(vocabulary.label(carried, "reduced"), "reduced")
