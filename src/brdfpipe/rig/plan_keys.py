"""The keys of ``plan.yaml``: one measurement of one sample on a camera rig."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from brdfpipe.descriptions.keys import NAME, NAME_WORDS, WHOLE, Choice, Items, Keys, OneOf, key, mapping_or_value
from brdfpipe.errors import InputError
from brdfpipe.rig.rig_keys import Entrances

STEP_SLACK = 1e-6
"""Part of a step by which rounded wavelengths may miss the last one."""

BAD_FRAMES = {
    "retake": "take it again, at most twice, then stop",
    "stop": "stop at once",
    "warn": "keep it with a warning",
    "accept": "keep it unchecked",
}
"""What a scan does with a bad frame."""

EXPOSURES = {
    "all": "all",
    "needed": "those that the last frames of the same cells show to be needed",
}
"""Which frames of a bracket a scan takes."""

RESERVED_NAMES = ("etalon", "target", "mirror", "line-lamp")
"""Loads that no sample may be named like."""

Wavelength = Annotated[float, Field(ge=100, le=20_000, description="a wavelength in nm")]
Wavelengths = Annotated[list[Wavelength], Items(rising=True), Field(min_length=1, max_length=2000)]


class Steps(Keys):
    """Wavelengths in equal steps."""

    from_: float = key("first wavelength", alias="from", required=True, unit="nm", ge=100, le=20_000)
    to: float = key("last wavelength", required=True, unit="nm", ge=100, le=20_000)
    step: float = key("distance of neighbouring wavelengths", required=True, unit="nm", ge=0.1, le=1000)

    @model_validator(mode="after")
    def _check_last_wavelength(self) -> Self:
        count = round((self.to - self.from_) / self.step)
        if count < 0 or abs(self.from_ + count * self.step - self.to) > STEP_SLACK * self.step:
            problem = "the steps do not lead from the first wavelength to the last"
            found = f"{self.from_:g} to {self.to:g} by {self.step:g}"
            raise InputError("", problem, found=found, accepted="a whole number of steps, upwards")
        return self


class Frame(Keys):
    """One frame of a bracket."""

    exposure: float = key("exposure of the frame", required=True, unit="s", gt=0, le=3600)
    position: Annotated[int, WHOLE] = key(
        "position of the filter wheel, one of the rig's filters", required=True, ge=1, le=12
    )


class DriftKeys(Keys):
    """Monitoring of the lamp."""

    every: Annotated[int, WHOLE] = key(
        "number of frames from one lamp reading to the next", default=70, ge=1, le=100_000
    )
    wavelength: float = key(
        "wavelength of lamp readings, and of frames of the target",
        default_words="the plan's nearest to 550",
        unit="nm",
        ge=100,
        le=20_000,
    )
    step: Annotated[int, WHOLE] = key(
        "frame of the bracket that a lamp reading repeats, counted from 1", default=1, ge=1, le=16, example=3
    )
    tolerance: float = key("relative change of the lamp that gives a warning", default=0.03, gt=0, le=1)


class MirrorKeys(Keys):
    """Directions to which the mirror of a calibration of the fibres sends the light."""

    step: float = key("distance of neighbouring directions", default=20, unit="degree", ge=5, le=45)
    to: float = key("largest angle from the mirror direction", default=100, unit="degree", ge=10, le=150)


class LineLampKeys(Keys):
    """A check of the wavelength by the lines of a lamp."""

    lines: Wavelengths = key(
        "wavelengths of the lines in air, a list; for mercury [435.83, 546.07]",
        required=True,
        default_words="no check",
        unit="nm",
        max_length=16,
    )
    step: Annotated[int, WHOLE] = key("frame of the bracket with which lines are read, from 1", default=1, ge=1, le=16)
    tolerance: float = key("distance from its line that gives a warning", default=0.3, unit="nm", gt=0, le=20)


class PlanKeys(Keys):
    """One measurement of one sample on a camera rig."""

    rig: str = key(
        "description of the rig, a file beside plan.yaml",
        required=True,
        min_length=1,
        max_length=200,
        example="rig.yaml",
    )
    sample: str = key(
        f"name of the sample, in every frame and of the run's folder; {NAME_WORDS}; not {', '.join(RESERVED_NAMES[:-1])} or {RESERVED_NAMES[-1]}",
        required=True,
        pattern=f"^{NAME}$",
        example="sample-1",
    )
    incidences: Entrances = key(
        "angles of incidence, each an entrance of the rig, in the order of measurement",
        required=True,
        unit="degree",
        min_length=1,
        max_length=32,
        example=[10, 20, 30, 45, 60],
    )
    wavelengths: Annotated[Steps | Wavelengths, Choice(mapping_or_value)] = key(
        "wavelengths: {from: 390, to: 730, step: 10} or an increasing list [450, 550, 650]",
        required=True,
        unit="nm",
        example={"from": 390, "to": 730, "step": 10},
        details="The steps must lead from the first wavelength to the last.",
    )
    bracket: list[Frame] = key(
        "frames of each wavelength, [{exposure: 0.5, position: 3}, {exposure: 0.5, position: 1}, …]; "
        "each must overlap the next, from the darkest to the brightest",
        required=True,
        min_length=1,
        max_length=16,
        example=[
            {"exposure": 0.2, "position": 3},
            {"exposure": 2, "position": 3},
            {"exposure": 2, "position": 2},
            {"exposure": 2, "position": 1},
            {"exposure": 10, "position": 1},
        ],
    )
    darks: Annotated[int, WHOLE] = key(
        "dark frames of each exposure time, at the start and again at the end", default=5, ge=5, le=1000
    )
    drift: DriftKeys = key(
        "how often the lamp is read through the reference fibre {every, wavelength, step, tolerance}",
        default=DriftKeys.model_construct(),
    )
    runs: Annotated[list[Annotated[str, OneOf(("line-lamp", "target", "mirror", "etalon", "sample"))]], Items()] = key(
        "what is measured, in this order: line-lamp (a check of the wavelength), target (the rig's angular target, at one wavelength), "
        "mirror (the directions of the fibres, at one wavelength), etalon and sample",
        default=["etalon", "sample"],
        min_length=1,
        max_length=5,
        example=["target", "etalon", "sample"],
    )
    side: Annotated[list[Annotated[str, OneOf(("reflection", "transmission"))]], Items()] = key(
        "sides of the sample, in this order: reflection and transmission",
        default=["reflection"],
        min_length=1,
        max_length=2,
        details="Transmission needs incidences below 75°.",
    )
    etalon_entrances: Entrances = key(
        "entrances through which the etalon is measured, the rig's etalon_entrance among them",
        default_words="the rig's `etalon_entrance`",
        unit="degree",
        min_length=1,
        max_length=32,
        details="An entrance without a measurement of the etalon counts as known to 5 %.",
        example=[10, 20, 30, 45, 60],
    )
    exposures: Annotated[str, OneOf(tuple(EXPOSURES))] = key(
        "frames of a bracket that a scan takes: "
        + "; ".join(f"{name}: {words}" if name != words else name for name, words in EXPOSURES.items()),
        default="all",
        details="See [fewer frames](#fewer-frames).",
    )
    etalon_after: bool = key(
        "whether the etalon is measured again after the sample",
        default=False,
        details="The calibration then interpolates between both, and states their difference.",
    )
    mirror: MirrorKeys = key(
        "directions to which the mirror is turned {step, to}",
        default=MirrorKeys.model_construct(),
        details="See [directions of the fibres](#directions-of-the-fibres).",
    )
    line_lamp: LineLampKeys = key(
        "lines whose wavelengths are read {lines, step, tolerance}",
        default_words="no check",
        details="See [wavelengths](#wavelengths).",
    )
    bad_frames: Annotated[str, OneOf(tuple(BAD_FRAMES))] = key(
        "what a scan does with a frame that its checks find bad: "
        + "; ".join(f"{name}: {words}" for name, words in BAD_FRAMES.items()),
        default="retake",
    )

    @model_validator(mode="after")
    def _check_sample_name(self) -> Self:
        if self.sample in RESERVED_NAMES:
            accepted = f"any name, not {', '.join(RESERVED_NAMES[:-1])} or {RESERVED_NAMES[-1]}"
            raise InputError("", "a reserved name", where="sample", found=repr(self.sample), accepted=accepted)
        return self
