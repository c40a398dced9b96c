"""Judgement of each frame before the next is taken: what a camera, a lamp or an operator did wrong, and where to look.

Every rule compares a frame with its description, with its dark frames, or with frames of the same run. Frames that were accepted are learnt.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from brdfpipe import specular_directions
from brdfpipe.geometry import Array
from brdfpipe.rig import screen as screens
from brdfpipe.rig.checks.frame_summary import FrameSummary, block_directions, hot_pixels
from brdfpipe.rig.description import Rig
from brdfpipe.rig.plan import ETALON_AFTER, LINE_LAMP, MIRROR, Arrangement, Shot
from brdfpipe.rig.raw_frame import Counts
from brdfpipe.rig.reduction import cosmic_hits
from brdfpipe.rig.reduction.arrangements import ENTRANCE_EXCLUSION_RADIUS
from brdfpipe.rig.reduction.registration import SEARCH

SATURATED = 0.9
"""Share of pixels out of the linear range from which a frame is bad: disc and fibres, which may be, are a third of it."""

SHIFT = 1.0
"""Shift of the picture [pixel] since the first frame of the run from which a frame is bad."""

NOTED_SHIFT = 0.3
"""Shift of the picture [pixel] that gives a warning: 0.1 degree on the disc of a rig as `brdfpipe rig new` writes it."""

REFERENCE_CHANGE = 0.05
"""Relative change of the reference light at one wavelength, beside that of the lamp as a whole, from which a frame is bad."""

WAVELENGTH_NOTED = 0.1
"""Difference [nm] of the wavelength read back from the planned one that gives a warning."""

ALIKE = 0.003
"""Relative scatter of the ratio of two pictures below which they show the same arrangement."""

_ALIKE_LEVEL = 0.03  # relative difference of their light within which they are the same; flicker is below 2 %
_ALIKE_BLOCKS = 12  # well exposed blocks that a comparison of pictures needs
_ALIKE_SNR = 100.0  # ratio of light to noise of a well exposed block
_SAME_COSINES = (
    0.01  # scatter of the ratio of cosines below which even a white sample would look the same in two arrangements
)
_SHOWN = 10.0  # ratio of light to noise from which a spot is there
_EXPECTED_SHOWN = 30.0  # expected ratio of light to noise from which its absence is an error
_ABSENT = 0.2  # share of the expected light below which it is absent
_TREND = 5  # last frames whose mean change is that of the lamp as a whole
_FLICKER = 0.006  # relative standard deviation of the lamp from frame to frame
_FIRST_CHANGE = (
    1.0  # largest change of the logarithm of the lamp as a whole between two frames: a cold lamp doubles its light
)
_COMPARED = ("etalon", ETALON_AFTER, "sample")
"""Purposes of the frames whose reference light is compared closely between arrangements. Target and monitor readings are of few wavelengths
and far from the brackets in time: a lamp that warms between them would look like another wavelength. So they show coarse errors alone."""

_WARMING = 0.75  # change of the logarithm of the light of a lamp that warms from half of its light
_SIGMA = 5.0
_ENOUGH_SPOTS = 0.6  # share of the fibres of a lit etalon whose spots must be found
_FEWEST_FIBRES = 12  # fibres that a statement on their spots needs
_SEEN_COSINE = 0.2  # cosine of view of the etalon above which a fibre must be bright
_UNEVEN = (
    2.0  # ratio of the brightest part of the disc to its median above which what is measured as etalon is not diffuse
)
_FEWEST_TARGET_SPOTS = 3

Severity = Literal["bad", "warning"]


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a frame."""

    name: str
    """Short name: identical, constant, saturated, dark, shifted, reference, spots, alike, …"""
    severity: Severity
    """``bad``: the frame is not to be used."""
    text: str
    """What was found, and where to look."""
    arrangement: bool = False
    """Whether the whole arrangement is wrong: taking the frame again is of no use."""


@dataclass(frozen=True)
class _Reading:
    """Reference light of one accepted frame."""

    arrangement: Arrangement
    light: float
    noise: float
    of_bracket: bool
    """Whether it is of a bracket of etalon or sample."""


@dataclass(frozen=True)
class _Picture:
    """Blocks of one accepted frame."""

    shot: Shot
    blocks: Array
    noise: Array
    reference: float


@dataclass
class FrameJudge:
    """Judges frames of one rig in the order in which they are taken."""

    rig: Rig
    steady_lamp: bool = False
    """Whether target and monitor readings too are compared closely with brackets, where those of other arrangements are missing."""
    _darks: dict[float, list[Counts]] = field(default_factory=dict)
    _mean_darks: dict[float, tuple[Array, NDArray[np.bool_] | None]] = field(default_factory=dict)
    _digests: dict[bytes, Shot] = field(default_factory=dict)
    _first_offset: tuple[float, float] | None = None
    _readings: dict[tuple[float, int, float], list[_Reading]] = field(default_factory=dict)
    _changes: dict[tuple[Arrangement, bool], list[tuple[float, float]]] = field(default_factory=dict)
    _pictures: dict[tuple[float, int, float], list[_Picture]] = field(default_factory=dict)
    _distinct: set[frozenset[Arrangement]] = field(default_factory=set)
    _spots_found: dict[Arrangement, set[int]] = field(default_factory=dict)
    _last: tuple[Shot, FrameSummary] | None = None

    def judge(
        self, shot: Shot, counts: Counts, *, wavelength_read: float | None = None, last_of_bracket: bool = False
    ) -> list[Finding]:
        """Findings on a frame. Nothing is learnt from it but which fibres or target spots its arrangement shows.

        Parameters
        ----------
        shot, counts : the frame (y, x)
        wavelength_read : wavelength that the monochromator reported [nm]
        last_of_bracket : whether the frames of its arrangement and wavelength are complete with this one
        """
        summary = self._summary(shot, counts)
        self._last = shot, summary
        findings = [*self._stuck(shot, summary)]
        if findings:
            return findings
        findings += self._dark_frame(summary) if shot.dark else self._light_frame(shot, summary, last_of_bracket)
        if wavelength_read is not None and abs(wavelength_read - shot.wavelength) > WAVELENGTH_NOTED:
            findings.append(_wavelength_off(shot, wavelength_read))
        if summary.cosmic_hits > max(cosmic_hits.MANY * counts.size, 10) and summary.saturated < SATURATED:
            text = (
                f"{summary.cosmic_hits} cosmic hits or other isolated bright pixels; they are removed in the reduction. Look for a source of "
                "radiation, a light leak or electrical interference near the camera, and take new dark frames"
            )
            findings.append(Finding("cosmic", "warning", text))
        return findings

    def learn(self, shot: Shot, counts: Counts) -> None:
        """Accept a frame: later ones are compared with it."""
        if self._last is not None and self._last[0] == shot:
            summary = self._last[1]
        else:
            summary = self._summary(shot, counts)
            self._remember_spots(shot, summary)
        self._last = None
        self._digests.setdefault(summary.digest, shot)
        if shot.dark:
            self._darks.setdefault(shot.exposure, []).append(counts)
            self._mean_darks.pop(shot.exposure, None)
            return
        if shot.arrangement.load == LINE_LAMP:
            return
        reference, settings = summary.reference, _settings(shot)
        if reference.offset is not None and self._first_offset is None:
            self._first_offset = reference.offset
        if not reference.saturated and reference.snr > _SHOWN:
            change = self._reference_change(shot, summary)
            if change is not None:
                self._changes.setdefault((shot.arrangement, change[2]), []).append(change[:2])
            readings = self._readings.setdefault(settings, [])
            readings.append(_Reading(shot.arrangement, reference.light, reference.noise, shot.purpose in _COMPARED))
        light = np.nan if reference.saturated or reference.snr < _SHOWN else reference.light
        pictures = self._pictures.setdefault(settings, [])
        if all(picture.shot.arrangement != shot.arrangement for picture in pictures):
            pictures.append(_Picture(shot, summary.blocks, summary.blocks_noise, light))

    def _summary(self, shot: Shot, counts: Counts) -> FrameSummary:
        if shot.exposure in self._darks and shot.exposure not in self._mean_darks:
            mean = np.mean(self._darks[shot.exposure], axis=0)
            self._mean_darks[shot.exposure] = mean, hot_pixels(mean, self.rig)
        dark, hot = self._mean_darks.get(shot.exposure, (None, None))
        return FrameSummary.of(counts, dark, self.rig, hot)

    # --- camera

    def _stuck(self, shot: Shot, summary: FrameSummary) -> Iterator[Finding]:
        camera = self.rig.camera
        # Light has noise of its own, unless the camera is described as an ideal one.
        without_noise = camera.read_noise == 0 or (shot.dark and camera.read_noise <= camera.gain)
        if summary.lowest == summary.highest:
            if summary.highest >= self.rig.camera.full:
                yield Finding("saturated", "bad", _SATURATED.format(share=1.0))
                return
            # Only a camera without noise can take an even dark frame.
            if not (shot.dark and without_noise):
                where = "restart the camera and its software, and check its cable"
                yield Finding("constant", "bad", f"every pixel has the count {summary.lowest}; {where}")
            return
        earlier = self._digests.get(summary.digest)
        # Nor can another take the same picture twice.
        if earlier is not None and not without_noise:
            text = (
                f"identical to frame {earlier.ordinal}, count by count: the camera, or the program that serves its folder, repeats an old "
                "frame; restart both"
            )
            yield Finding("identical", "bad", text)

    def _dark_frame(self, summary: FrameSummary) -> Iterator[Finding]:
        reference = summary.reference
        if summary.saturated > SATURATED:
            yield Finding("saturated", "bad", _SATURATED.format(share=summary.saturated))
        elif reference.plateau > _SHOWN:
            text = (
                f"the dark frame shows the reference spot, {reference.plateau:.0f} times its noise: the shutter did not close, or frames are "
                "labelled in another order than they were taken; check the shutter"
            )
            yield Finding("dark shows light", "bad", text)

    # --- light

    def _light_frame(self, shot: Shot, summary: FrameSummary, last_of_bracket: bool) -> Iterator[Finding]:
        if summary.saturated > SATURATED:
            yield Finding("saturated", "bad", _SATURATED.format(share=summary.saturated))
            return
        shifted = list(self._shift(summary))
        yield from shifted
        if any(finding.severity == "bad" for finding in shifted):
            return
        if shot.arrangement.load == LINE_LAMP:
            return  # beside its lines it is dark
        self._remember_spots(shot, summary)
        yield from self._light_missing(shot, summary, last_of_bracket)
        yield from self._reference_spectrum(shot, summary)
        if shot.arrangement.load == "etalon":
            yield from self._etalon(shot, summary, last_of_bracket)
        if shot.purpose == "target":
            yield from self._target(shot, summary, last_of_bracket)
        if not shot.dark:
            yield from self._alike(shot, summary)

    def _light_missing(self, shot: Shot, summary: FrameSummary, last_of_bracket: bool) -> Iterator[Finding]:
        """Frames that equal their dark frame."""
        reference = summary.reference
        if reference.saturated or reference.snr > _SHOWN:
            return
        expected = self._expected_reference(shot)
        if expected is not None:
            if expected > _EXPECTED_SHOWN * reference.noise and reference.light < _ABSENT * expected:
                text = (
                    f"no light in the reference spot, {expected:.3g} electrons expected: the lamp went out, the shutter did not open, or the frame "
                    "is a dark one; check lamp and shutter"
                )
                yield Finding("equal to its dark", "bad", text)
        elif last_of_bracket:
            where = "check that the lamp burns and the shutter opens"
            if not self._readings:
                text = f"no frame shows the reference spot so far, this one equals its dark frame; {where}"
                yield Finding("equal to its dark", "bad", text)
            else:
                text = (
                    f"no frame of the bracket at {shot.wavelength:g} nm shows the reference spot; {where}, lengthen an exposure, or leave the "
                    "wavelength out"
                )
                yield Finding("no reference", "warning", text)

    def _expected_reference(self, shot: Shot) -> float | None:
        """Light of the reference spot from other frames of the wavelength [e⁻], from the most similar exposure; None if unknown."""
        both_beams = self.rig.nd_location == "reference"
        expected, nearest = None, np.inf
        for (wavelength, position, exposure), readings in self._readings.items():
            if wavelength == shot.wavelength:
                factor = shot.exposure / exposure
                if both_beams:
                    factor *= (
                        self.rig.filter_at(shot.position).transmittance / self.rig.filter_at(position).transmittance
                    )
                if abs(np.log(factor)) < nearest:
                    nearest, expected = abs(float(np.log(factor))), factor * readings[-1].light
        return expected

    def _shift(self, summary: FrameSummary) -> Iterator[Finding]:
        """Shift of the picture against the description and since the first frame of the run."""
        offset = summary.reference.offset
        if offset is None:
            return
        distance = float(np.hypot(*offset))
        if distance > SEARCH:
            text = (
                f"the reference spot is {distance:.1f} pixels from where rig.yaml describes it ({offset[0]:+.1f} columns, {offset[1]:+.1f} rows), "
                f"at most {SEARCH:g} are accepted: the camera or the screen was moved; correct `screen.centre`, or move them back"
            )
            yield Finding("shifted", "bad", text)
        elif self._first_offset is not None:
            moved = (offset[0] - self._first_offset[0], offset[1] - self._first_offset[1])
            size = float(np.hypot(*moved))
            if size > NOTED_SHIFT:
                text = (
                    f"the picture moved by {size:.1f} pixels since the first frame of the run ({moved[0]:+.1f} columns, {moved[1]:+.1f} rows); "
                    "check the mounts of camera and screen, and their cables"
                )
                yield Finding("shifted", "bad" if size > SHIFT else "warning", text)

    def _reference_change(self, shot: Shot, summary: FrameSummary) -> tuple[float, float, bool] | None:
        """ln of the reference light over that of the same settings in the first other arrangement, its noise, and whether both are of brackets."""
        reference = summary.reference
        if reference.saturated or reference.snr < _SHOWN:
            return None
        readings = [one for one in self._readings.get(_settings(shot), ()) if one.arrangement != shot.arrangement]
        if not readings:
            return None
        reading = next((one for one in readings if one.of_bracket), readings[0])
        noise = float(np.hypot(reference.noise / reference.light, reading.noise / reading.light))
        return (
            float(np.log(reference.light / reading.light)),
            noise,
            self.steady_lamp or (reading.of_bracket and shot.purpose in _COMPARED),
        )

    def _reference_spectrum(self, shot: Shot, summary: FrameSummary) -> Iterator[Finding]:
        """Whether the reference has changed at this wavelength otherwise than at the wavelengths before."""
        found = self._reference_change(shot, summary)
        if found is None:
            return
        change, noise, of_brackets = found
        before = np.array(self._changes.get((shot.arrangement, of_brackets), [])[-_TREND:]).reshape(-1, 2)
        trend, tolerance = 0.0, max(_FIRST_CHANGE, _SIGMA * noise)
        if before.size:
            weight = 1 / (before[:, 1] ** 2 + _FLICKER**2)
            trend = float((weight * before[:, 0]).sum() / weight.sum())
            least = REFERENCE_CHANGE if of_brackets else _WARMING
            tolerance = max(least, _SIGMA * float(np.hypot(noise, weight.sum() ** -0.5)))
            tolerance += float(np.ptp(before[:, 0]))
        if abs(change - trend) > tolerance:
            text = (
                f"the reference light at {shot.wavelength:g} nm changed by {np.expm1(change - trend):+.0%} against the other arrangements of the run, "
                "beside that of the lamp as a whole: the wavelength, filter or exposure is not that of the label, or the lamp flickers; check the "
                "monochromator's display, and whether frames are exchanged"
            )
            yield Finding("reference", "bad", text)

    # --- etalon and target

    def _etalon(self, shot: Shot, summary: FrameSummary, last_of_bracket: bool) -> Iterator[Finding]:
        """Whether what lies as etalon lights the fibres and the disc as a diffuse standard does."""
        yield from self._etalon_disc(shot, summary)
        if shot.purpose not in ("etalon", ETALON_AFTER):
            return
        found, expected = self._spots_found[shot.arrangement], int(self._seen_fibres(shot).sum())
        if last_of_bracket and expected >= _FEWEST_FIBRES and len(found) < _ENOUGH_SPOTS * expected:
            expected_light = summary.reference.saturated or summary.reference.snr > _EXPECTED_SHOWN
            text = (
                f"only {len(found)} of {expected} fibres that see the etalon show a spot where fibres.csv describes it; check that the etalon is in "
                "the holder and lit, `screen.scale` and the positions in fibres.csv, and lengthen an exposure if the frames are too dark"
            )
            yield Finding("spots", "bad" if not found and expected_light else "warning", text, arrangement=not found)

    def _etalon_disc(self, shot: Shot, summary: FrameSummary) -> Iterator[Finding]:
        theta, phi = block_directions(self.rig)
        rim = np.degrees(np.arctan(self.rig.screen.disc_radius / self.rig.screen.focal_length))
        cosine = specular_directions.cos_view_etalon(shot.arrangement.incidence, theta, phi)
        used = (theta < rim) & np.isfinite(summary.blocks) & (cosine > _SEEN_COSINE)
        if np.count_nonzero(used) < _ALIKE_BLOCKS:
            return
        light, noise = summary.blocks[used] / cosine[used], summary.blocks_noise[used] / cosine[used]
        middle = float(np.median(light))
        if middle <= 0 or np.median(noise) * _SHOWN > middle:
            # A lobe may be the only thing that is bright.
            middle = max(middle, _SHOWN * float(np.median(noise)))
        brightest = float(np.percentile(light, 95))
        if brightest > _UNEVEN * middle:
            text = (
                f"what is measured as etalon is not diffuse: the brightest part of the disc has {brightest / middle:.1f} times the light of its median; "
                "check that the etalon is in the holder and turned to the entrance"
            )
            yield Finding("etalon", "bad", text, arrangement=True)

    def _target(self, shot: Shot, summary: FrameSummary, last_of_bracket: bool) -> Iterator[Finding]:
        target = self.rig.target
        if target is None:
            return
        theta, phi = np.array(target.theta_s), np.array(target.phi_s)
        found = self._spots_found[shot.arrangement]
        if not last_of_bracket or len(found) == theta.size:
            return
        missing = [f"({theta[at]:g}, {phi[at]:g})" for at in range(theta.size) if at not in found]
        text = (
            f"{len(found)} of {theta.size} spots of the angular target found; missing at (theta_s, phi_s) = {', '.join(missing[:6])}"
            f"{' …' if len(missing) > 6 else ''} degree. Check that the target is in the holder and upright, the mirrors at its entrance, and "
            "`target.spots` of rig.yaml"
        )
        few = len(found) < max(_FEWEST_TARGET_SPOTS, theta.size / 2)
        yield Finding("target", "bad" if few else "warning", text, arrangement=few)

    def _remember_spots(self, shot: Shot, summary: FrameSummary) -> None:
        """Add the fibres or target spots that a frame shows to those of its arrangement, which its frames show together."""
        if shot.purpose not in ("etalon", ETALON_AFTER, "target") or summary.saturated > SATURATED:
            return
        screen, target = self.rig.screen, self.rig.target
        found = self._spots_found.setdefault(shot.arrangement, set())
        if shot.arrangement.load == "etalon":
            fibres, seen = self.rig.fibres, self._seen_fibres(shot)
            if len(found) > _ENOUGH_SPOTS * seen.sum():
                return
            column, row = screens.to_pixel(
                screen, np.array([fibre.x for fibre in fibres]), np.array([fibre.y for fibre in fibres])
            )
            shown = np.isfinite(summary.spots(column, row, screen.fibre_radius * screen.scale).u)
            found |= set(np.flatnonzero(shown & seen).tolist())
        elif target is not None and len(found) < len(target.theta_s):
            position = screens.disc_position(screen, np.array(target.theta_s), np.array(target.phi_s))
            radius = float(np.radians(target.radius)) * screen.focal_length * screen.scale
            spots = summary.spots(*screens.to_pixel(screen, *position), radius)
            # A lit disc has light everywhere; a spot is narrow.
            narrow = np.isfinite(spots.u) & (spots.variance < ((radius + 2) / 2) ** 2 * 1.5)
            found |= set(np.flatnonzero(narrow).tolist())

    def _seen_fibres(self, shot: Shot) -> NDArray[np.bool_]:
        """Fibres (fibre,) that see the etalon, which must be bright, and not the entrance."""
        theta, phi = (np.array([getattr(fibre, angle) for fibre in self.rig.fibres]) for angle in ("theta_s", "phi_s"))
        cosine = specular_directions.cos_view_etalon(shot.arrangement.incidence, theta, phi)
        return np.asarray((cosine > _SEEN_COSINE) & (cosine < np.cos(np.radians(ENTRANCE_EXCLUSION_RADIUS))))

    # --- arrangements

    def _alike(self, shot: Shot, summary: FrameSummary) -> Iterator[Finding]:
        """An arrangement that should look different from an earlier one and does not."""
        reference = summary.reference
        light = np.nan if reference.saturated or reference.snr < _SHOWN else reference.light
        own = _Picture(shot, summary.blocks, summary.blocks_noise, light)
        for other in self._pictures.get(_settings(shot), ()):
            pair = frozenset((shot.arrangement, other.shot.arrangement))
            # An etalon that is measured again must look the same.
            same = replace(shot.arrangement, again=False) == replace(other.shot.arrangement, again=False)
            if same or pair in self._distinct:
                continue
            verdict = _compare(own, other, self.rig)
            if verdict == "distinct":
                self._distinct.add(pair)
            if verdict == "alike":
                text = (
                    f"the picture is that of {_described(other.shot.arrangement)} (frame {other.shot.ordinal}): the mirrors or the object in the holder "
                    f"were not changed for {_described(shot.arrangement)}; arrange them and take both again where in doubt"
                )
                yield Finding("alike", "bad", text, arrangement=True)


def _compare(own: _Picture, other: _Picture, rig: Rig) -> Literal["alike", "distinct", "unknown"]:
    """Whether two pictures of the same settings show the same arrangement."""
    theta, phi = block_directions(rig)
    used = np.isfinite(theta)
    for picture in (own, other):
        with np.errstate(invalid="ignore"):
            used = used & (picture.blocks > _ALIKE_SNR * picture.noise)
    if np.count_nonzero(used) < _ALIKE_BLOCKS:
        return "unknown"
    noise = np.hypot(*(picture.noise[used] / picture.blocks[used] for picture in (own, other)))
    ratio = own.blocks[used] / other.blocks[used]
    level = float(np.median(ratio))
    deviation = ratio / level - 1
    # The median of squares ignores a few blocks at edges; that of a normal distribution is 0.455 of its variance.
    variance = float(np.median(deviation**2 - 0.455 * noise**2)) / 0.455
    variance_u = 2.5 * float(np.median(noise**2)) / np.sqrt(noise.size)
    if np.isfinite(own.reference) and np.isfinite(other.reference):
        level *= other.reference / own.reference
    if variance - 4 * variance_u > ALIKE**2 or abs(level - 1) > _ALIKE_LEVEL:
        return "distinct"
    if variance + 2 * variance_u > (2 * ALIKE) ** 2:
        return "unknown"
    # Even a white sample shows the same cosines in some pairs of arrangements.
    cosines = [_cosine(picture.shot.arrangement, theta[used], phi[used]) for picture in (own, other)]
    if cosines[0] is not None and cosines[1] is not None:
        lit = (cosines[0] > _SEEN_COSINE) & (cosines[1] > _SEEN_COSINE)
        expected = np.log(cosines[0][lit] / cosines[1][lit])
        if lit.any() and float(expected.std()) < _SAME_COSINES:
            return "unknown"
    return "alike"


def _cosine(arrangement: Arrangement, theta: Array, phi: Array) -> Array | None:
    """Relative light of a white, matt surface in an arrangement; None for target and mirror."""
    if arrangement.load in ("target", MIRROR):
        return None
    cosine = specular_directions.cos_view_etalon if arrangement.load == "etalon" else specular_directions.cos_view
    return np.maximum(cosine(arrangement.incidence, theta, phi), 1e-9)


def _settings(shot: Shot) -> tuple[float, int, float]:
    return shot.wavelength, shot.position, shot.exposure


def _described(arrangement: Arrangement) -> str:
    side = " in transmission" if arrangement.side == "transmission" else ""
    aim = "" if arrangement.aim is None else ", turned to ({:g}, {:g})°".format(*arrangement.aim)
    return f"the {arrangement.load} at {arrangement.incidence:g}°{side}{aim}"


def _wavelength_off(shot: Shot, read: float) -> Finding:
    text = (
        f"the monochromator reports {read:g} nm where {shot.wavelength:g} nm was requested, a difference above {WAVELENGTH_NOTED:g} nm; the BSDF is "
        "stored at the requested wavelength. Calibrate the monochromator, or plan wavelengths that it reaches exactly"
    )
    return Finding("wavelength", "warning", text)


_SATURATED = "{share:.0%} of the pixels are out of the camera's linear range; check the shutter, the light of the room, and the exposures of the `bracket`"
