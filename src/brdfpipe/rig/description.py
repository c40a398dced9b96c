"""A camera rig as its laboratory describes it: ``rig.yaml`` and the table of its fibres. The keys: :mod:`brdfpipe.rig.rig_keys`.

The rig of the Keldysh preprint: monochromator → splitter with the reference fibre → neutral filters → one of the entrances σ →
sample at the centre of a hemisphere of fibres; a lens maps the directions about the mirror direction onto a frosted disc; disc, ends
of the fibres and reference spot lie on one screen before one camera.
"""

from __future__ import annotations

import csv
import hashlib
import io
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from brdfpipe import documents, store
from brdfpipe.descriptions import reading
from brdfpipe.errors import InputError
from brdfpipe.rig.rig_keys import BAUD, Camera, Monochromator, NeutralFilter, RigKeys, ScreenGeometry, Wheel

SENSOR_KEYS = ("width", "height", "gain", "read_noise", "linear_to", "bits")
"""Keys of the camera that decide what its counts mean."""

COLUMNS = ("name", "theta_s", "phi_s", "x", "y")
"""Columns of the table of fibres: direction about the mirror direction [degree], end on the screen [mm]."""

DIRECTION_COLUMN = "u"
"""Optional column: standard uncertainty of the direction [degree]."""

DIRECTION_U = 0.1
"""Where it is not stated."""

MAX_FIBRES = 10_000

_SCREEN_FIELDS = {"disc": "disc_centre", "reference": "reference_centre"}
"""Key of ``screen`` in rig.yaml → field of :class:`Screen`, where they differ."""


@dataclass(frozen=True)
class SerialSettings:
    """One device on a serial port: meaning, units and defaults as of its keys in rig.yaml."""

    dialect: str
    port: str
    baud: int
    case: str = Monochromator.default_of("case")
    serial_number: str = Monochromator.default_of("serial_number")
    query_timeout: float = Monochromator.default_of("query_timeout")
    motion_timeout: float = Monochromator.default_of("motion_timeout")
    grating: int = Monochromator.default_of("grating")
    speed: float = Monochromator.default_of("speed")
    wavelength_u: float = Monochromator.default_of("wavelength_u")
    polarisation: float = Monochromator.default_of("polarisation")
    positions: int = Wheel.default_of("positions")


@dataclass(frozen=True)
class CameraSettings:
    """The camera, its sensor and its connection: meaning, units and defaults as of the keys in rig.yaml."""

    kind: str
    folder: str = ""
    """Absolute."""
    address: str = ""
    device: int = Camera.default_of("device")
    width: int = Camera.default_of("width")
    height: int = Camera.default_of("height")
    gain: float = Camera.default_of("gain")
    read_noise: float = Camera.default_of("read_noise")
    linear_to: float = Camera.default_of("linear_to")
    bits: int = Camera.default_of("bits")
    linearity_u: float = Camera.default_of("linearity_u")
    timeout: float = Camera.default_of("timeout")

    @property
    def full(self) -> int:
        """The largest count."""
        return 2**self.bits - 1


@dataclass(frozen=True)
class Filter:
    """One neutral filter of the wheel."""

    position: int
    transmittance: float
    u: float = NeutralFilter.default_of("u")
    """Relative standard uncertainty of the transmittance."""


@dataclass(frozen=True)
class Fibre:
    """Direction of a fibre about the mirror direction [degree], and its end on the screen [mm]."""

    name: str
    theta_s: float
    phi_s: float
    x: float
    y: float
    u: float = DIRECTION_U
    """Root mean square angle of the true direction from the described one [degree]."""


@dataclass(frozen=True)
class Target:
    """An angular target: bright spots in known directions about the mirror direction [degree]."""

    theta_s: tuple[float, ...]
    phi_s: tuple[float, ...]
    radius: float


@dataclass(frozen=True)
class Screen:
    """Geometry of the screen [mm] and of its picture [pixel], as of the keys in rig.yaml; see :mod:`brdfpipe.rig.screen`."""

    focal_length: float
    disc_radius: float
    disc_centre: tuple[float, float]
    reference_centre: tuple[float, float]
    fibre_radius: float
    reference_radius: float
    scale: float
    centre: tuple[float, float]
    radial: float = ScreenGeometry.default_of("radial")


@dataclass(frozen=True)
class Rig:
    """A rig: devices, filters, entrances, fibres and screen."""

    name: str
    monochromator: SerialSettings
    wheel: SerialSettings
    camera: CameraSettings
    nd_location: str
    """``reference``: the light of the reference fibre passes the filter too; ``sample``: it does not."""
    filters: tuple[Filter, ...]
    entrances: tuple[float, ...]
    """Possible angles of incidence [degree]."""
    etalon_entrance: float
    """Degree."""
    fibres: tuple[Fibre, ...]
    screen: Screen
    slit: float
    """Spectral width, full at half maximum [nm]."""
    wavelengths: tuple[float, float]
    """Shortest and longest of the monochromator [nm]."""
    target: Target | None
    """``None`` where the laboratory has none."""
    digest: str
    """Digest of geometry, filters and sensor, without ports and timeouts."""

    @classmethod
    def load(cls, path: str | Path) -> Rig:
        """Read and validate ``rig.yaml`` and the table of fibres that it names.

        Raises
        ------
        InputError : naming the file, the line, the key, what was found and what is accepted.
        """
        path = Path(path)
        description = reading.read_with_lines(path, RigKeys)
        content = description.content
        fibres = read_fibres(documents.file_beside(path, content["fibres"]["file"], "fibres.file", "the rig's folder"))
        screen: dict[str, Any] = {
            _SCREEN_FIELDS.get(key, key): _floats(value) if isinstance(value, list) else float(value)
            for key, value in content["screen"].items()
        }
        rig = cls(
            name=content["name"],
            monochromator=_serial(content["monochromator"]),
            wheel=_serial(content["wheel"]),
            camera=_camera(content["camera"], path),
            nd_location=content["nd_location"],
            filters=tuple(Filter(**item) for item in content["filters"]),
            entrances=_floats(content["entrances"]),
            etalon_entrance=float(content["etalon_entrance"]),
            fibres=fibres,
            screen=Screen(**screen),
            slit=float(content["slit"]),
            wavelengths=(float(content["wavelengths"]["low"]), float(content["wavelengths"]["high"])),
            target=_target(content.get("target")),
            digest=_digest(description, fibres),
        )
        _check(description, rig)
        return rig

    @property
    def shared_port(self) -> bool:
        """Whether the controller of the monochromator turns the wheel, too."""
        return self.monochromator.port == self.wheel.port

    def filter_at(self, position: int) -> Filter:
        """The filter at a position of the wheel. Raises InputError: the rig has no filter there."""
        for neutral_filter in self.filters:
            if neutral_filter.position == position:
                return neutral_filter
        positions = ", ".join(str(neutral_filter.position) for neutral_filter in self.filters)
        raise InputError("rig.yaml", "no filter at this position of the wheel", found=position, accepted=positions)


def read_fibres(path: Path) -> tuple[Fibre, ...]:
    """Read the table of the fibres: CSV with the columns :data:`COLUMNS` and maybe :data:`DIRECTION_COLUMN`, in any order; lines with # are
    comments.

    Raises InputError: naming the file, the line, what was found and what is accepted.
    """
    rows = read_csv(path)
    if not rows:
        accepted = f"a line of column titles ({', '.join(COLUMNS)}) and one line per fibre"
        raise InputError(path, "empty", accepted=accepted)
    where, titles = rows.pop(0)
    if sorted(titles) not in (sorted(COLUMNS), sorted((*COLUMNS, DIRECTION_COLUMN))):
        found, accepted = ", ".join(titles), f"{', '.join(COLUMNS)} and maybe {DIRECTION_COLUMN}"
        raise InputError(path, "unknown or missing column titles", where=where, found=found, accepted=accepted)
    if not 1 <= len(rows) <= MAX_FIBRES:
        raise InputError(path, "wrong number of fibres", found=len(rows), accepted=f"1 to {MAX_FIBRES}")
    fibres = tuple(_fibre(path, where, titles, cells) for where, cells in rows)
    if repeated := _repeated(fibre.name for fibre in fibres):
        raise InputError(path, "duplicate fibre name", found=repeated, accepted="each name once")
    return fibres


def fibre_table(fibres: Iterable[Fibre], remark: str) -> str:
    """The table of fibres as CSV, with a remark on its first line."""
    text = io.StringIO()
    text.write(f"# {remark}\n")
    table = csv.writer(text, lineterminator="\n")
    table.writerow((*COLUMNS, DIRECTION_COLUMN))
    for fibre in fibres:
        angles = f"{fibre.theta_s:.3f}", f"{fibre.phi_s:.3f}"
        table.writerow((fibre.name, *angles, f"{fibre.x:g}", f"{fibre.y:g}", f"{fibre.u:.3g}"))
    return text.getvalue()


def read_csv(path: Path) -> list[tuple[str, list[str]]]:
    """``line N`` and the cells of each line of a CSV file, without comments (#); :class:`InputError` if it is not text."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(path, "not UTF-8 text", where=f"byte {error.start}", accepted="a CSV file") from error
    return [
        (f"line {number}", [cell.strip() for cell in next(csv.reader([line]))])
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]


def _fibre(path: Path, where: str, titles: list[str], cells: list[str]) -> Fibre:
    if len(cells) != len(titles):
        raise InputError(path, "wrong number of cells", where=where, found=len(cells), accepted=str(len(titles)))
    row = dict(zip(titles, cells, strict=True))
    values = {title: _number(path, where, title, row[title]) for title in titles if title != "name"}
    if not 0 <= values.get(DIRECTION_COLUMN, 0.0) <= 10:
        raise InputError(path, "u out of range", where=where, found=row[DIRECTION_COLUMN], accepted="0 to 10 degree")
    if not 0 <= values["theta_s"] <= 180:
        raise InputError(path, "theta_s out of range", where=where, found=row["theta_s"], accepted="0 to 180 degree")
    return Fibre(name=row["name"] or where.replace(" ", "-"), **values)


def _number(path: Path, where: str, title: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = float("nan")
    if not abs(value) < 1e6:
        raise InputError(path, f"{title} is not a number", where=where, found=repr(cell), accepted="a number")
    return value


def _serial(content: Mapping[str, Any]) -> SerialSettings:
    return SerialSettings(**{"baud": BAUD[content["dialect"]], **content})


def _camera(content: Mapping[str, Any], path: Path) -> CameraSettings:
    """The camera; a relative folder is one beside the description."""
    beside = {"folder": str(path.resolve().parent / content["folder"])} if "folder" in content else {}
    return CameraSettings(**{**content, **beside})


def _target(content: Mapping[str, Any] | None) -> Target | None:
    if content is None:
        return None
    theta_s, phi_s = zip(*content["spots"], strict=True)
    return Target(_floats(theta_s), _floats(phi_s), float(content["radius"]))


def _floats(values: Iterable[Any]) -> tuple[Any, ...]:
    return tuple(map(float, values))


def _digest(description: reading.Description, fibres: tuple[Fibre, ...]) -> str:
    """Digest of the rig as an instrument: rigs that differ in their ports alone measure the same.

    Every frame of a run carries it, so the digest of a description must never change. That is why the numbers of filters and sensor
    enter as they are written (``u`` only where it is given, 640 and 640.0 apart).
    """
    content, written = description.content, description.written
    optics = {key: value for key, value in content.items() if key not in ("monochromator", "wheel", "fibres", "camera")}
    camera = {**content["camera"], **written["camera"]}
    sensor = {key: camera[key] for key in SENSOR_KEYS}
    ends = [[fibre.name, fibre.theta_s, fibre.phi_s, fibre.x, fibre.y] for fibre in fibres]
    text = store.canonical_json({**optics, "filters": written["filters"], "camera": sensor, "fibres": ends})
    return hashlib.sha256(text.encode()).hexdigest()


def _check(description: reading.Description, rig: Rig) -> None:
    """Refuse keys that contradict each other."""
    refusal = description.refusal
    positions = [neutral_filter.position for neutral_filter in rig.filters]
    if repeated := _repeated(positions):
        raise refusal("filters", "two filters at one position of the wheel", repeated)
    if max(positions) > rig.wheel.positions:
        accepted = f"1 to {rig.wheel.positions} (`wheel.positions`)"
        raise refusal("filters", "a position that the wheel does not have", max(positions), accepted)
    if rig.etalon_entrance not in rig.entrances:
        accepted = ", ".join(f"{entrance:g}" for entrance in rig.entrances)
        raise refusal("etalon_entrance", "the rig has no such entrance", f"{rig.etalon_entrance:g}", accepted)
    if rig.wavelengths[0] >= rig.wavelengths[1]:
        raise refusal("wavelengths", "`low` is not below `high`", list(rig.wavelengths))
    if rig.shared_port and rig.wheel.dialect != "acton-wheel":
        accepted = (
            "another port; only an `acton-wheel` can share that of the monochromator, whose controller then turns it"
        )
        raise refusal("wheel.port", "two devices on one port", rig.wheel.port, accepted)
    if rig.shared_port and rig.wheel.baud != rig.monochromator.baud:
        raise refusal("wheel.baud", "two baud rates of one port", rig.wheel.baud, str(rig.monochromator.baud))


def _repeated(items: Iterable[object]) -> object:
    return next((item for item, count in Counter(items).items() if count > 1), None)
