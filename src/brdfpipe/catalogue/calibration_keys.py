"""The keys of ``calibration.yaml``: a run of the etalon on a rig."""

from typing import Annotated, Any

from brdfpipe.descriptions.keys import WHOLE, Choice, Keys, by_key, key


class EtalonEmulation(Keys):
    """A run of the emulator instead of a measurement."""

    seed: Annotated[int, WHOLE] = key("seed of the emulated rig's random properties", default=0, ge=0, le=1_000_000)
    session: Annotated[int, WHOLE] = key("seed of the random properties of a day", default=0, ge=0, le=1_000_000)


class _Calibration(Keys):
    certificate: str = key(
        "the etalon's certificate, a certificate.yaml in the calibration's own folder",
        required=True,
        min_length=1,
        max_length=255,
    )
    previous: str = key(
        "the calibration of the same rig before this one, the name of a folder in calibrations/",
        default_words="begins a chart",
        details="See [the chart](#the-chart-of-the-profiles).",
        min_length=1,
        max_length=64,
    )
    valid_days: Annotated[int, WHOLE] = key(
        "days the profile may be used", default=90, unit="d", ge=1, le=36_500, stage="calibration"
    )
    valid_hours: float = key(
        "operating hours of the lamp the profile may be used",
        default=200,
        unit="h",
        ge=0,
        le=100_000,
        stage="calibration",
    )
    lamp_hours: float = key(
        "hour counter of the lamp at the calibration", default=0, unit="h", ge=0, le=100_000, stage="calibration"
    )
    override: bool = key(
        "true uses frames that contradict the rig's description, and an expired certificate; the results record it",
        default=False,
        stage="reduced calibration",
    )


class MeasuredCalibration(_Calibration):
    """A calibration from a run of the rig."""

    run: str = key(
        "folder of a finished run, in the calibration's own folder", required=True, min_length=1, max_length=200
    )


class EmulatedCalibration(_Calibration):
    """A calibration from a run of the emulator."""

    plan: str = key(
        "the plan of the run, a plan.yaml in the calibration's own folder",
        default_words="instead of `run`",
        required=True,
        min_length=1,
        max_length=255,
    )
    emulate: EtalonEmulation = key("emulator instead of a measurement {seed, session}", required=True, stage="rig_run")


Calibration: Any = Annotated[
    MeasuredCalibration | EmulatedCalibration, Choice(by_key("run", "emulate"), (("run", "emulate"),))
]
