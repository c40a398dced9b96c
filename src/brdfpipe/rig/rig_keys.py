"""The keys of ``rig.yaml``. The example values are a bench like that of the Keldysh preprint."""

from typing import Annotated, Any, Self

from pydantic import Field, Strict, model_validator

from brdfpipe.descriptions.keys import NAME, NAME_WORDS, WHOLE, Items, Keys, OneOf, key
from brdfpipe.errors import InputError

MONOCHROMATORS = {"acton": 9600}
WHEELS = {"acton-wheel": 9600, "thorlabs": 115200}
"""Dialect of a device → its baud rate, where the description gives none."""

BAUD = MONOCHROMATORS | WHEELS

Angle = Annotated[float, Field(ge=0, lt=90, description="an angle of incidence in degree")]
Entrances = Annotated[list[Angle], Items()]
Coordinate = Annotated[float, Field(ge=-10_000, le=10_000, description="a coordinate in mm")]
Direction = Annotated[
    tuple[
        Annotated[float, Field(ge=0, le=30, description="theta_s in degree")],
        Annotated[float, Field(ge=-360, le=360, description="phi_s in degree")],
    ],
    Strict(False),
    Field(description="one direction [theta_s, phi_s] in degree"),
]
Point = Annotated[tuple[Coordinate, Coordinate], Strict(False)]


def _length(help: str, **options: Any) -> Any:
    return key(help, unit="mm", gt=0, le=10_000, **options)


class _SerialDevice(Keys):
    baud: Annotated[int, OneOf((300, 600, 1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200))] = key(
        "baud rate of the line",
        unit="1/s",
        default_words="; ".join(f"{baud} for `{dialect}`" for dialect, baud in BAUD.items()),
    )
    case: Annotated[str, OneOf(("auto", "upper", "lower"))] = key(
        "letter case of Acton commands: upper, lower, or auto (tried, upper first)",
        default="auto",
    )
    serial_number: str = key(
        "serial number that the device must answer with; empty accepts any",
        default="",
        max_length=64,
        details="It reveals exchanged cables. The Thorlabs wheel reports none.",
    )
    query_timeout: float = key(
        "time to wait for the answer to a question",
        default=1,
        unit="s",
        gt=0,
        le=60,
        details="A question is asked three times.",
    )
    motion_timeout: float = key("time to wait for a move", default=30, unit="s", gt=0, le=600)


class Monochromator(_SerialDevice):
    """The monochromator."""

    dialect: Annotated[str, OneOf(tuple(MONOCHROMATORS))] = key(
        "acton (Acton and Princeton SpectraPro)", required=True, example="acton"
    )
    port: str = key(
        "serial port: /dev/ttyUSB0, COM3, …; on Linux /dev/serial/by-id/… keeps its name when cables change place",
        required=True,
        min_length=1,
        max_length=200,
        example="/dev/ttyUSB0",
    )
    grating: Annotated[int, WHOLE] = key(
        "grating to select and verify, 1 to 9, or 0 for the one in place", default=0, ge=0, le=9
    )
    speed: float = key(
        "speed of moves, or 0 for the device's fastest",
        default=0,
        unit="nm/min",
        ge=0,
        le=10_000,
        details="A move with a speed can be stopped.",
    )
    wavelength_u: float = key(
        "standard uncertainty (k = 1) of the wavelength",
        default=0.1,
        unit="nm",
        ge=0,
        le=10,
        details="For [the budget](#the-budget).",
    )
    polarisation: float = key(
        "degree of linear polarisation of the beam, unknown in direction, as a standard uncertainty",
        default=0,
        ge=0,
        le=1,
        details="Gratings polarise: measure it with a polariser, or use a depolariser.",
    )


class Wheel(_SerialDevice):
    """The wheel of neutral filters."""

    dialect: Annotated[str, OneOf(tuple(WHEELS))] = key(
        "acton-wheel (FA-448) or thorlabs (FW102C and FW212C)", required=True, example="thorlabs"
    )
    port: str = key(
        "serial port, as above",
        required=True,
        min_length=1,
        max_length=200,
        details="The monochromator's own, for an `acton-wheel` on its controller.",
        example="/dev/ttyUSB1",
    )
    positions: Annotated[int, WHOLE] = key("number of positions, with filters or empty", default=6, ge=1, le=12)


class Camera(Keys):
    """The camera."""

    kind: Annotated[str, OneOf(("drop-folder", "alpaca"))] = key(
        "drop-folder (another program answers requests put into a folder) or alpaca (a camera on the network)",
        required=True,
        example="drop-folder",
    )
    folder: str = key(
        "for drop-folder: folder of requests and frames, absolute or beside rig.yaml",
        default_words="needed with `drop-folder`",
        max_length=1000,
        example="camera",
        details="It must exist.",
    )
    address: str = key(
        "for alpaca: address of the server, host:port",
        default_words="needed with `alpaca`",
        max_length=200,
        pattern="^[A-Za-z0-9.-]+:[0-9]{1,5}$",
    )
    device: Annotated[int, WHOLE] = key("for alpaca: number of the camera on the server", default=0, ge=0, le=99)
    width: Annotated[int, WHOLE] = key("width of a frame, not binned", default=320, unit="pixel", ge=16, le=20_000)
    height: Annotated[int, WHOLE] = key("height of a frame", default=240, unit="pixel", ge=16, le=20_000)
    gain: float = key("electrons per count", default=3, unit="e⁻/count", gt=0, le=1000)
    read_noise: float = key("read noise", default=20, unit="e⁻", ge=0, le=10_000)
    linear_to: float = key(
        "electrons up to which counts are proportional to light; brighter pixels are not used",
        default=25_000,
        unit="e⁻",
        gt=0,
    )
    linearity_u: float = key(
        "relative standard uncertainty (k = 1) of ratios of counts below `linear_to`", default=0.001, ge=0, le=0.1
    )
    bits: Annotated[int, WHOLE] = key("bits of a count", default=16, ge=8, le=16)
    timeout: float = key("time to wait for a frame beyond its exposure", default=60, unit="s", gt=0, le=3600)

    @model_validator(mode="after")
    def _check_folder_or_address(self) -> Self:
        needed = "folder" if self.kind == "drop-folder" else "address"
        if getattr(self, needed) is None:
            accepted = str(Camera.declared_keys()[needed].description)
            raise InputError("", f"the key {needed!r} is missing", accepted=accepted)
        return self


class NeutralFilter(Keys):
    """One neutral filter."""

    position: Annotated[int, WHOLE] = key(
        "position of the wheel",
        required=True,
        ge=1,
        le=12,
        details="An empty hole is a filter of transmittance 1 with u 0.",
    )
    transmittance: float = key("transmittance of the filter", required=True, gt=0, le=1)
    u: float = key("relative standard uncertainty (k = 1) of the transmittance", default=0.02, ge=0, le=1)


class FibreTable(Keys):
    """Where the fibres are listed."""

    file: str = key(
        "CSV file beside rig.yaml, a line per fibre: name, theta_s and phi_s [degree], x and y on the screen [mm]",
        required=True,
        max_length=1000,
        example="fibres.csv",
        details="See [fibres.csv](#fibrescsv).",
    )


class ScreenGeometry(Keys):
    """The screen in front of the camera."""

    focal_length: float = _length(
        "focal length f of the lens; a direction ϑ from the mirror direction is imaged at f tan ϑ from the centre of the disc",
        default=150,
    )
    disc_radius: float = _length("radius of the frosted disc; 26.4 at f = 150 is 10 degree", default=26.4)
    disc: Point = key("centre [x, y] of the disc", default=[0, 0], unit="mm")
    reference: Point = key("centre [x, y] of the reference spot", required=True, unit="mm", example=[49, 36])
    fibre_radius: float = _length("radius of the end of a fibre", default=1)
    reference_radius: float = _length("radius of the reference spot", default=1.5)
    scale: float = key("scale of the picture", required=True, unit="pixel/mm", gt=0, le=1000, example=3)
    centre: Annotated[tuple[float, float], Strict(False)] = key(
        "pixel [column, row] of the screen's origin, counted from 0 at the middle of the first pixel",
        required=True,
        unit="pixel",
        example=[159.5, 119.5],
    )
    radial: float = key(
        "radial distortion of the camera's lens; a point at r appears at r (1 + radial r²)",
        default=0,
        unit="1/mm²",
        ge=-0.001,
        le=0.001,
    )


class AngularTarget(Keys):
    """An angular target: bright spots in known directions."""

    spots: list[Direction] = key(
        "directions [theta_s, phi_s] of the spots about the mirror direction, a list",
        default_words="no target",
        required=True,
        unit="degree",
        min_length=3,
        max_length=200,
        details="See [the angular target](#the-angular-target).",
    )
    radius: float = key("radius of a spot", default=0.3, unit="degree", gt=0, le=5)


class Range(Keys):
    """A range of wavelengths."""

    low: float = key(
        "shortest wavelength that monochromator, lamp and camera reach",
        default=380,
        unit="nm",
        ge=100,
        le=20_000,
        example=390,
    )
    high: float = key("longest wavelength", default=780, unit="nm", ge=100, le=20_000, example=730)


class RigKeys(Keys):
    """One camera rig, its devices, optics and geometry."""

    name: str = key(
        f"name of the rig, in every frame; {NAME_WORDS}", required=True, pattern=f"^{NAME}$", example="bench-1"
    )
    monochromator: Monochromator = key("the monochromator {dialect: acton, port: /dev/ttyUSB0, …}", required=True)
    wheel: Wheel = key(
        "the wheel of neutral filters {dialect: acton-wheel or thorlabs, port: /dev/ttyUSB1, …}", required=True
    )
    camera: Camera = key(
        "the camera {kind: drop-folder, folder: camera} or {kind: alpaca, address: host:port}", required=True
    )
    nd_location: Annotated[str, OneOf(("sample", "reference"))] = key(
        "position of the neutral filters: sample (in the sample's beam alone) or reference (before the reference fibre too)",
        required=True,
        example="sample",
        details="The scan warns where frames contradict it.",
    )
    filters: Annotated[list[NeutralFilter], Field(min_length=1, max_length=12)] = key(
        "neutral filters of the wheel, [{position: 1, transmittance: 1, u: 0}, {position: 2, transmittance: 0.1, u: 0.02}, …]",
        required=True,
        example=[
            {"position": 1, "transmittance": 1, "u": 0},
            {"position": 2, "transmittance": 0.1, "u": 0.02},
            {"position": 3, "transmittance": 0.01, "u": 0.02},
        ],
    )
    entrances: Entrances = key(
        "angles of incidence that the mirrors can be set to, a list from 0 to below 90",
        required=True,
        unit="degree",
        min_length=1,
        max_length=32,
        example=[0, 10, 20, 30, 45, 60],
    )
    etalon_entrance: float = key(
        "entrance that lights the etalon at normal incidence", default=10, unit="degree", ge=0, lt=90
    )
    fibres: FibreTable = key("fibres of the hemisphere {file: fibres.csv}", required=True)
    screen: ScreenGeometry = key(
        "the screen in front of the camera: frosted disc, ends of the fibres, reference spot", required=True
    )
    target: AngularTarget = key(
        "an angular target that finds the disc's centre {spots: [[0, 0], [4, 0], [4, 90], …], radius: 0.3}, if there is one",
        default_words="no target",
        example={
            "spots": [
                [0, 0],
                *([theta, phi] for theta, first in ((3, 0), (6, 0), (9, 45)) for phi in range(first, 360, 90)),
            ],
            "radius": 0.3,
        },
    )
    slit: float = key("spectral width of the slit", default=10, unit="nm", gt=0, le=200)
    wavelengths: Range = key(
        "wavelengths that monochromator, lamp and camera reach {low, high}", default=Range.model_construct()
    )
