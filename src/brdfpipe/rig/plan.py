"""The plan of one measurement: ``plan.yaml`` → every exposure, in order. The keys: :mod:`brdfpipe.rig.plan_keys`.

The order is fixed. Work by hand comes outermost: for each run (target, etalon, sample), each side and each incidence, one arrangement
of mirrors and holder; in it each wavelength, and at each wavelength the frames of the bracket. The lamp is read through the reference
fibre before the first frame, after every ``drift.every`` frames, and after the last. Dark frames of every exposure time open and close
the measurement, without a move of mirrors or devices.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

from brdfpipe import documents
from brdfpipe.descriptions import reading
from brdfpipe.errors import InputError
from brdfpipe.rig.description import Rig
from brdfpipe.rig.plan_keys import PlanKeys

TRANSMISSION_LIMIT = 75.0
"""Incidence [degree] from which no transmission can be measured."""

DRIFT_WAVELENGTH = 550.0
"""Nanometres; the lamp is read at the plan's wavelength nearest to it."""

MAX_SHOTS = 99_999


@dataclass(frozen=True)
class Step:
    """One frame of a bracket: exposure [s], position of the filter wheel."""

    exposure: float
    position: int


@dataclass(frozen=True)
class Drift:
    """How often, and at which wavelength, the lamp is read."""

    every: int
    """Number of frames from one lamp reading to the next."""
    wavelength: float
    """Nanometres."""
    step: int
    """Frame of the bracket it repeats, from 1."""
    tolerance: float
    """Relative change of the signal that gives a warning."""


@dataclass(frozen=True)
class Arrangement:
    """What an operator arranges by hand."""

    load: str
    """Load of the holder: ``sample``, ``etalon`` or ``target``."""
    side: str
    """``reflection`` or ``transmission``."""
    incidence: float
    """Entrance of the light [degree]."""


@dataclass(frozen=True)
class Shot:
    """One exposure of a plan."""

    ordinal: int
    """From 1, in the order they are made."""
    purpose: str
    """``sample``, ``etalon``, ``target``, ``dark`` or ``drift``."""
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
    path: Path = field(compare=False, repr=False)
    """The file of the plan."""

    @classmethod
    def load(cls, path: str | Path) -> Plan:
        """Read and validate a plan, and the rig that it names.

        Raises
        ------
        InputError : naming the file, the line, the key, what was found and what is accepted.
        """
        path = Path(path)
        content = _content(path)
        rig = Rig.load(_rig_file(path, content))
        wavelengths = _wavelengths(content["wavelengths"])
        drift = content["drift"]
        nearest = min(wavelengths, key=lambda wavelength: abs(wavelength - DRIFT_WAVELENGTH))
        plan = cls(
            rig=rig,
            sample=content["sample"],
            incidences=tuple(map(float, content["incidences"])),
            wavelengths=wavelengths,
            bracket=tuple(Step(float(item["exposure"]), item["position"]) for item in content["bracket"]),
            darks=content["darks"],
            drift=Drift(
                drift["every"], float(drift.get("wavelength", nearest)), drift["step"], float(drift["tolerance"])
            ),
            runs=tuple(content["runs"]),
            side=tuple(content["side"]),
            etalon_entrances=tuple(map(float, content.get("etalon_entrances", [rig.etalon_entrance]))),
            path=path,
        )
        _check(path, plan)
        return plan

    @cached_property
    def shots(self) -> tuple[Shot, ...]:
        """Every exposure, in order."""
        return tuple(self._numbered())

    @property
    def arrangements(self) -> tuple[Arrangement, ...]:
        """The arrangements that an operator makes, in order."""
        arrangements = {
            "target": [Arrangement("target", "reflection", self.rig.etalon_entrance)],
            "etalon": [Arrangement("etalon", "reflection", entrance) for entrance in self.etalon_entrances],
            "sample": [Arrangement("sample", side, incidence) for side in self.side for incidence in self.incidences],
        }
        return tuple(arrangement for run in self.runs for arrangement in arrangements[run])

    def sample_id(self, arrangement: Arrangement) -> str:
        """Name of the sample in the holder."""
        return self.sample if arrangement.load == "sample" else arrangement.load

    def differences(self, other: Plan) -> list[str]:
        """Keys of the plan and of its rig that differ between two plans, each with both values; ports and timeouts do not count."""
        keys = [item.name for item in fields(self) if item.compare and item.name != "rig"]
        differences = _differences(self, other, keys)
        if self.rig.digest != other.rig.digest:
            of_rig = _differences(self.rig, other.rig, _RIG_KEYS) + _differences(
                self.rig.camera, other.rig.camera, _SENSOR_KEYS
            )
            differences += [f"rig {difference}" for difference in of_rig]
        return differences

    def _numbered(self) -> Iterator[Shot]:
        light = list(self._light())
        first, last = light[0], light[-1]
        ordered = [*self._darks(first), *light, *self._darks(last)]
        for ordinal, shot in enumerate(ordered, start=1):
            yield replace(shot, ordinal=ordinal)

    def _light(self) -> Iterator[Shot]:
        count = 0
        for arrangement in self.arrangements:
            # The target shows where things are, which no wavelength changes.
            for wavelength in (self.drift.wavelength,) if arrangement.load == "target" else self.wavelengths:
                for number, step in enumerate(self.bracket, start=1):
                    if count % self.drift.every == 0:
                        yield self._lamp_reading(arrangement)
                    yield Shot(0, arrangement.load, arrangement, wavelength, step.position, step.exposure, number)
                    count += 1
        yield self._lamp_reading(arrangement)

    def _lamp_reading(self, arrangement: Arrangement) -> Shot:
        step = self.bracket[self.drift.step - 1]
        return Shot(0, "drift", arrangement, self.drift.wavelength, step.position, step.exposure)

    def _darks(self, beside: Shot) -> Iterator[Shot]:
        for exposure in sorted({step.exposure for step in self.bracket}):
            for _ in range(self.darks):
                yield Shot(0, "dark", beside.arrangement, beside.wavelength, beside.position, exposure)


def sources(path: Path) -> dict[str, Path]:
    """The files of a plan by their names in the folder of a run: the plan itself, its rig and the rig's fibres.

    Raises
    ------
    InputError : two of them would have the same name.
    """
    rig = PurePosixPath(_content(path)["rig"])
    fibres = rig.parent / documents.plain(path.parent / rig)["fibres"]["file"]
    files = {PLAN: path}
    for name in (rig.as_posix(), fibres.as_posix()):
        if name in files or name.split("/")[0] in RESERVED:
            raise InputError(
                path, "a file name that the folder of a run needs itself", found=name, accepted="another file name"
            )
        files[name] = path.parent / name
    return files


PLAN, JOURNAL, FRAMES, LOCK = "plan.yaml", "journal.jsonl", "frames", ".scan.lock"
"""Files and folders of a run beside the description of the rig."""

RESERVED = (JOURNAL, FRAMES, LOCK)

_RIG_KEYS = (
    *("name", "nd_location", "filters", "entrances", "etalon_entrance", "fibres", "screen", "slit"),
    *("wavelengths", "target"),
)

_SENSOR_KEYS = ("width", "height", "gain", "read_noise", "linear_to", "bits")


def _content(path: Path) -> dict[str, Any]:
    return reading.read(path, PlanKeys)


def _rig_file(path: Path, content: Mapping[str, Any]) -> Path:
    return documents.file_beside(path, content["rig"], "rig", "the plan's folder")


def _wavelengths(wavelengths: Any) -> tuple[float, ...]:
    if isinstance(wavelengths, list):
        return tuple(map(float, wavelengths))
    low, high, step = (float(wavelengths[key]) for key in ("from", "to", "step"))
    # Rounded to what a monochromator can be set to.
    return tuple(round(low + number * step, 3) for number in range(round((high - low) / step) + 1))


def _check(path: Path, plan: Plan) -> None:
    """Refuse values that the rig does not allow."""
    _check_entrances(path, plan)
    if "target" in plan.runs and plan.rig.target is None:
        accepted = "a rig with a `target`, or runs of etalon and sample alone"
        raise InputError(path, "the rig has no angular target", where="runs", accepted=accepted)
    low, high = plan.rig.wavelengths
    for key, wavelengths in (("wavelengths", plan.wavelengths), ("drift.wavelength", (plan.drift.wavelength,))):
        if beyond := [wavelength for wavelength in wavelengths if not low <= wavelength <= high]:
            raise InputError(
                path,
                "the rig's monochromator does not reach this wavelength",
                where=key,
                found=f"{beyond[0]:g} nm",
                accepted=f"{low:g} to {high:g} nm (`wavelengths` of the rig)",
            )
    for number, step in enumerate(plan.bracket):
        known = [neutral_filter.position for neutral_filter in plan.rig.filters]
        if step.position not in known:
            accepted = ", ".join(map(str, known)) + " (`filters` of the rig)"
            where = f"bracket.{number}.position"
            raise InputError(
                path, "the rig has no filter at this position", where=where, found=step.position, accepted=accepted
            )
        if step in plan.bracket[:number]:
            raise InputError(path, "duplicate frame of the bracket", where=f"bracket.{number}")
    if plan.drift.step > len(plan.bracket):
        accepted = f"1 to {len(plan.bracket)}"
        raise InputError(
            path, "the bracket has no such frame", where="drift.step", found=plan.drift.step, accepted=accepted
        )
    lights = len(plan.arrangements) * len(plan.wavelengths) * len(plan.bracket)
    shots = lights + lights // plan.drift.every + 2 + plan.darks * 2 * len(plan.bracket)
    if shots > MAX_SHOTS:
        raise InputError(
            path,
            "too many frames",
            found=shots,
            accepted=f"at most {MAX_SHOTS}, dark frames and lamp readings included",
        )


def _check_entrances(path: Path, plan: Plan) -> None:
    entrances = plan.rig.entrances
    accepted = ", ".join(f"{entrance:g}" for entrance in entrances) + " (`entrances` of the rig)"
    for key, angles in (("incidences", plan.incidences), ("etalon_entrances", plan.etalon_entrances)):
        if unknown := [angle for angle in angles if angle not in entrances]:
            found = f"{unknown[0]:g}"
            raise InputError(path, "the rig has no such entrance", where=key, found=found, accepted=accepted)
    if plan.rig.etalon_entrance not in plan.etalon_entrances:
        raise InputError(
            path,
            "`etalon_entrance` of the rig is missing; all other entrances are relative to it",
            where="etalon_entrances",
            accepted=f"a list with {plan.rig.etalon_entrance:g} in it",
        )
    grazing = [angle for angle in plan.incidences if angle >= TRANSMISSION_LIMIT]
    if "transmission" in plan.side and grazing:
        raise InputError(
            path,
            "transmission cannot be measured at this incidence",
            where="side",
            found=f"{grazing[0]:g} degree",
            accepted=f"reflection alone, or incidences below {TRANSMISSION_LIMIT:g} degree",
        )


def _differences(one: Any, other: Any, keys: Any) -> list[str]:
    pairs = [(key, getattr(one, key), getattr(other, key)) for key in keys]
    return [f"{key}: {_shown(first)} and {_shown(second)}" for key, first, second in pairs if first != second]


def _shown(value: Any) -> str:
    if isinstance(value, Step):
        return f"{value.exposure:g} s at {value.position}"
    text = ", ".join(map(_shown, value)) if isinstance(value, tuple) else str(value)
    return text if len(text) <= 200 else text[:199] + "…"
