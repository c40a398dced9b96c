"""The plan of one measurement: ``plan.yaml`` → every exposure, in order. The keys: :mod:`brdfpipe.rig.plan_keys`.

The order is fixed and needs the fewest changes by hand. For each run (target, etalon, sample), each side and each incidence there is one
arrangement of mirrors and holder; in it each wavelength, and at each wavelength the frames of the bracket. The lamp is read through the reference
fibre before the first frame, after every ``drift.every`` frames, and after the last. Dark frames of every exposure time open and close
the measurement, without a move of mirrors or devices.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

from brdfpipe import documents
from brdfpipe.descriptions import reading
from brdfpipe.errors import InputError
from brdfpipe.rig.description import SENSOR_KEYS, Rig
from brdfpipe.rig.plan_keys import PlanKeys
from brdfpipe.rig.turned_mirror import Aim, grid

TRANSMISSION_LIMIT = 75.0
"""Incidence [degree] from which no transmission can be measured."""

DRIFT_WAVELENGTH = 550.0
"""Nanometres; the lamp is read at the plan's wavelength nearest to it."""

MAX_SHOTS = 99_999

LINE_RANGE = 0.9
"""Distance from a line up to which it is read, in widths of the slit."""

LINE_PLACES = tuple(place / 4 for place in range(-4, 5))
"""Places within that distance."""

LINE_LAMP, MIRROR = "line-lamp", "mirror"
"""Loads, and purposes of the frames, of a check of the wavelength and of a calibration of the fibres."""

ETALON_AFTER = "etalon-after"
"""Purpose of the frames of an etalon that is measured again after the sample."""


@dataclass(frozen=True)
class Step:
    """One frame of a bracket: exposure [s], position of the filter wheel."""

    exposure: float
    position: int


@dataclass(frozen=True)
class Drift:
    """How often, and at which wavelength, the lamp is read; meaning and units as of the keys in plan.yaml."""

    every: int
    wavelength: float
    step: int
    tolerance: float


@dataclass(frozen=True)
class LineCheck:
    """Lines whose wavelengths are read; meaning and units as of the keys in plan.yaml."""

    lines: tuple[float, ...]
    step: int
    tolerance: float

    def wavelengths(self, slit: float) -> tuple[float, ...]:
        """At which the lines are read [nm]: evenly over the band of a slit [nm] about each."""
        return tuple(round(line + LINE_RANGE * slit * share, 3) for line in self.lines for share in LINE_PLACES)


@dataclass(frozen=True)
class Arrangement:
    """What an operator arranges by hand."""

    load: str
    """Load of the holder: ``sample``, ``etalon``, ``target`` or ``mirror``; with ``line-lamp`` a line lamp burns in place of the rig's lamp, whatever is in the holder."""
    side: str
    """``reflection`` or ``transmission``."""
    incidence: float
    """Entrance of the light [degree]."""
    again: bool = False
    """Whether the same was arranged before, in the same run."""
    aim: Aim | None = None
    """Direction to which a mirror in the holder sends the light."""

    @property
    def purpose(self) -> str:
        """Purpose of the frames of its brackets."""
        return ETALON_AFTER if self.again else self.load


@dataclass(frozen=True)
class Shot:
    """One exposure of a plan."""

    ordinal: int
    """From 1, in the order they are made."""
    purpose: str
    """``sample``, ``etalon``, ``etalon-after``, ``target``, ``mirror``, ``line-lamp``, ``dark`` or ``drift``."""
    arrangement: Arrangement
    wavelength: float
    """Nanometres."""
    position: int
    exposure: float
    """Seconds."""
    step: int = 0
    """Frame of the bracket, from 1; 0 outside a bracket."""

    @property
    def dark(self) -> bool:
        """Whether the shutter stays closed."""
        return self.purpose == "dark"

    @property
    def name(self) -> str:
        """Name of its file."""
        return f"{self.ordinal:05d}-{self.purpose}-{self.arrangement.incidence:g}deg-{self.wavelength:g}nm.fits"


@dataclass(frozen=True)
class Plan:
    """A measurement: one rig, one sample, and everything that is exposed."""

    rig: Rig
    sample: str
    incidences: tuple[float, ...]
    wavelengths: tuple[float, ...]
    bracket: tuple[Step, ...]
    darks: int
    """Number of dark frames of each exposure time, at the start and again at the end."""
    drift: Drift
    runs: tuple[str, ...]
    side: tuple[str, ...]
    etalon_entrances: tuple[float, ...]
    etalon_after: bool
    """Whether the etalon is measured again after the sample."""
    path: Path = field(compare=False, repr=False)
    """The file of the plan."""
    bad_frames: str = field(default="retake", compare=False)
    """What a scan does with a bad frame; another choice does not make another plan."""
    exposures: str = field(default="all", compare=False)
    """Which frames of a bracket a scan takes; another choice does not make another plan."""
    aims: tuple[Aim, ...] = ()
    """Directions to which the mirror is turned; none without a run of it."""
    lines: LineCheck | None = None
    """None without a run of the line lamp."""

    @classmethod
    def load(cls, path: str | Path) -> Plan:
        """Read and validate a plan, and the rig that it names.

        Raises
        ------
        InputError : naming the file, the line, the key, what was found and what is accepted.
        """
        path = Path(path)
        description = reading.read_with_lines(path, PlanKeys)
        content = description.content
        rig = Rig.load(documents.file_beside(path, content["rig"], "rig", "the plan's folder"))
        wavelengths = _wavelengths(content["wavelengths"])
        nearest = min(wavelengths, key=lambda wavelength: abs(wavelength - DRIFT_WAVELENGTH))
        drift = {"wavelength": nearest, **content["drift"]}
        plan = cls(
            rig=rig,
            sample=content["sample"],
            incidences=tuple(map(float, content["incidences"])),
            wavelengths=wavelengths,
            bracket=tuple(Step(float(item["exposure"]), item["position"]) for item in content["bracket"]),
            darks=content["darks"],
            drift=Drift(drift["every"], float(drift["wavelength"]), drift["step"], float(drift["tolerance"])),
            runs=tuple(content["runs"]),
            side=tuple(content["side"]),
            etalon_entrances=tuple(map(float, content.get("etalon_entrances", [rig.etalon_entrance]))),
            etalon_after=content["etalon_after"],
            path=path,
            bad_frames=content["bad_frames"],
            exposures=content["exposures"],
            aims=grid(**content["mirror"]) if MIRROR in content["runs"] else (),
            lines=_lines(description),
        )
        _check(description, plan)
        return plan

    @cached_property
    def shots(self) -> tuple[Shot, ...]:
        """Every exposure, in order."""
        light = list(self._light())
        shots = (*self._darks(light[0]), *light, *self._darks(light[-1]))
        return tuple(replace(shot, ordinal=ordinal) for ordinal, shot in enumerate(shots, start=1))

    @property
    def arrangements(self) -> tuple[Arrangement, ...]:
        """The arrangements that an operator makes, in order."""
        arrangements = {
            LINE_LAMP: [Arrangement(LINE_LAMP, "reflection", self.rig.etalon_entrance)],
            "target": [Arrangement("target", "reflection", self.rig.etalon_entrance)],
            MIRROR: [Arrangement(MIRROR, "reflection", self.rig.etalon_entrance, aim=aim) for aim in self.aims],
            "etalon": [Arrangement("etalon", "reflection", entrance) for entrance in self.etalon_entrances],
            "sample": [Arrangement("sample", side, incidence) for side in self.side for incidence in self.incidences],
        }
        again = [replace(arrangement, again=True) for arrangement in arrangements["etalon"] if self.etalon_after]
        return (*(arrangement for run in self.runs for arrangement in arrangements[run]), *again)

    def sample_id(self, arrangement: Arrangement) -> str:
        """Name of the sample in the holder."""
        return self.sample if arrangement.load == "sample" else arrangement.load

    def differences(self, other: Plan) -> list[str]:
        """Keys of the plan and of its rig that differ between two plans, each with both values; ports and timeouts do not count."""
        keys = [item.name for item in fields(self) if item.compare and item.name != "rig"]
        differences = _differences(self, other, keys)
        if self.rig.digest != other.rig.digest:
            keys = [item.name for item in fields(Rig) if item.name not in _NOT_COMPARED]
            of_rig = _differences(self.rig, other.rig, keys)
            of_rig += _differences(self.rig.camera, other.rig.camera, SENSOR_KEYS)
            differences += [f"rig {difference}" for difference in of_rig]
        return differences

    def _light(self) -> Iterator[Shot]:
        count, read = 0, None
        for arrangement in self.arrangements:
            if arrangement.load == LINE_LAMP:
                yield from self._line_readings(arrangement)
                continue
            read = arrangement
            # Target and mirror show where things are, which no wavelength changes.
            single = arrangement.load in ("target", MIRROR)
            for wavelength in (self.drift.wavelength,) if single else self.wavelengths:
                for number, step in enumerate(self.bracket, start=1):
                    if count % self.drift.every == 0:
                        yield self._lamp_reading(arrangement)
                    yield Shot(0, arrangement.purpose, arrangement, wavelength, step.position, step.exposure, number)
                    count += 1
        if read is not None:
            yield self._lamp_reading(read)

    def _line_readings(self, arrangement: Arrangement) -> Iterator[Shot]:
        """Another lamp burns: no reading of this one."""
        assert self.lines is not None
        step = self.bracket[self.lines.step - 1]
        for wavelength in self.lines.wavelengths(self.rig.slit):
            yield Shot(0, LINE_LAMP, arrangement, wavelength, step.position, step.exposure, self.lines.step)

    def _lamp_reading(self, arrangement: Arrangement) -> Shot:
        step = self.bracket[self.drift.step - 1]
        return Shot(0, "drift", arrangement, self.drift.wavelength, step.position, step.exposure)

    def _darks(self, beside: Shot) -> Iterator[Shot]:
        for exposure in sorted({step.exposure for step in self.bracket}):
            for _ in range(self.darks):
                yield Shot(0, "dark", beside.arrangement, beside.wavelength, beside.position, exposure)


def sources(path: Path) -> dict[str, Path]:
    """The files of a plan by their names in the folder of a run: the plan itself, its rig and the rig's fibres.

    Raises InputError: two of them would have the same name.
    """
    rig = PurePosixPath(reading.read(path, PlanKeys)["rig"])
    fibres = rig.parent / documents.read_yaml(path.parent / rig)["fibres"]["file"]
    files = {PLAN: path}
    for name in (rig.as_posix(), fibres.as_posix()):
        if name in files or name.split("/")[0] in RESERVED:
            problem = "a file name that the folder of a run needs itself"
            raise InputError(path, problem, found=name, accepted="another file name")
        files[name] = path.parent / name
    return files


PLAN, JOURNAL, FRAMES, LOCK = "plan.yaml", "journal.jsonl", "frames", ".scan.lock"
"""Files and folders of a run beside the description of the rig."""

RESERVED = (JOURNAL, FRAMES, LOCK)

_NOT_COMPARED = ("monochromator", "wheel", "camera", "digest")


def _wavelengths(wavelengths: Any) -> tuple[float, ...]:
    if isinstance(wavelengths, list):
        return tuple(map(float, wavelengths))
    low, high, step = (float(wavelengths[key]) for key in ("from", "to", "step"))
    # Rounded to what a monochromator can be set to.
    return tuple(round(low + number * step, 3) for number in range(round((high - low) / step) + 1))


def _lines(description: reading.Description) -> LineCheck | None:
    content = description.content
    if LINE_LAMP not in content["runs"]:
        return None
    if "line_lamp" not in content:
        accepted = "line_lamp: {lines: [435.83, 546.07]}, for example, or runs without line-lamp"
        raise description.refusal("runs", "no lines of the lamp are stated", accepted=accepted)
    lamp = content["line_lamp"]
    return LineCheck(tuple(map(float, lamp["lines"])), lamp["step"], float(lamp["tolerance"]))


def _check(description: reading.Description, plan: Plan) -> None:
    """Refuse values that the rig does not allow."""
    refusal, rig = description.refusal, plan.rig
    accepted = ", ".join(f"{entrance:g}" for entrance in rig.entrances) + " (`entrances` of the rig)"
    for key, angles in (("incidences", plan.incidences), ("etalon_entrances", plan.etalon_entrances)):
        if unknown := [angle for angle in angles if angle not in rig.entrances]:
            raise refusal(key, "the rig has no such entrance", f"{unknown[0]:g}", accepted)
    if rig.etalon_entrance not in plan.etalon_entrances:
        problem = "`etalon_entrance` of the rig is missing; all other entrances are relative to it"
        raise refusal("etalon_entrances", problem, accepted=f"a list with {rig.etalon_entrance:g} in it")
    grazing = [angle for angle in plan.incidences if angle >= TRANSMISSION_LIMIT]
    if "transmission" in plan.side and grazing:
        accepted = f"reflection alone, or incidences below {TRANSMISSION_LIMIT:g} degree"
        raise refusal("side", "transmission cannot be measured at this incidence", f"{grazing[0]:g} degree", accepted)
    if "target" in plan.runs and rig.target is None:
        accepted = "a rig with a `target`, or runs of etalon and sample alone"
        raise refusal("runs", "the rig has no angular target", accepted=accepted)
    if plan.etalon_after and not {"etalon", "sample"} <= {*plan.runs}:
        raise refusal("etalon_after", "the plan does not measure both etalon and sample", accepted="runs with both")
    low, high = rig.wavelengths
    read = () if plan.lines is None else plan.lines.wavelengths(rig.slit)
    for key, wavelengths in (
        ("wavelengths", plan.wavelengths),
        ("drift.wavelength", (plan.drift.wavelength,)),
        ("line_lamp.lines", read),
    ):
        if beyond := [wavelength for wavelength in wavelengths if not low <= wavelength <= high]:
            problem = "the rig's monochromator does not reach this wavelength"
            raise refusal(key, problem, f"{beyond[0]:g} nm", f"{low:g} to {high:g} nm (`wavelengths` of the rig)")
    positions = [neutral_filter.position for neutral_filter in rig.filters]
    for number, step in enumerate(plan.bracket):
        if step.position not in positions:
            accepted = ", ".join(map(str, positions)) + " (`filters` of the rig)"
            where = f"bracket.{number}.position"
            raise refusal(where, "the rig has no filter at this position", step.position, accepted)
        if step in plan.bracket[:number]:
            raise refusal(f"bracket.{number}", "duplicate frame of the bracket")
    for key, number in (("drift.step", plan.drift.step), ("line_lamp.step", plan.lines.step if plan.lines else 1)):
        if number > len(plan.bracket):
            raise refusal(key, "the bracket has no such frame", number, f"1 to {len(plan.bracket)}")
    lights = len(plan.arrangements) * len(plan.wavelengths) * len(plan.bracket)
    shots = lights + lights // plan.drift.every + 2 + plan.darks * 2 * len(plan.bracket)
    if shots > MAX_SHOTS:
        accepted = f"at most {MAX_SHOTS}, dark frames and lamp readings included"
        raise InputError(description.path, "too many frames", found=shots, accepted=accepted)


def _differences(one: Any, other: Any, keys: Iterable[str]) -> list[str]:
    pairs = [(key, getattr(one, key), getattr(other, key)) for key in keys]
    return [f"{key}: {_shown(first)} and {_shown(second)}" for key, first, second in pairs if first != second]


def _shown(value: Any) -> str:
    if isinstance(value, Step):
        return f"{value.exposure:g} s at {value.position}"
    text = ", ".join(map(_shown, value)) if isinstance(value, tuple) else str(value)
    return text if len(text) <= 200 else text[:199] + "…"
