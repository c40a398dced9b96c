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
from typing import Any, TypeVar

from brdfpipe import documents, store
from brdfpipe.descriptions import reading
from brdfpipe.errors import InputError
from brdfpipe.rig.rig_keys import BAUD, Camera, Monochromator, NeutralFilter, RigKeys, ScreenGeometry, Wheel

COLUMNS = ("name", "theta_s", "phi_s", "x", "y")
"""Columns of the table of fibres: direction about the mirror direction [degree], end on the screen [mm]."""

MAX_FIBRES = 10_000


@dataclass(frozen=True)
class SerialSettings:
    """One device on a serial port. Defaults are those of the keys in rig.yaml."""

    dialect: str
    port: str
    baud: int
    case: str = Monochromator.default_of("case")
    """Letter case of commands: some units accept only lower case."""
    serial_number: str = Monochromator.default_of("serial_number")
    """Serial number that the device must answer with; empty accepts any."""
    query_timeout: float = Monochromator.default_of("query_timeout")
    """Seconds."""
    motion_timeout: float = Monochromator.default_of("motion_timeout")
    """Seconds."""
    grating: int = Monochromator.default_of("grating")
    """Grating to select and verify; 0 leaves the one in place."""
    speed: float = Monochromator.default_of("speed")
    """Speed of moves [nm/min]; 0 is the device's fastest."""
    positions: int = Wheel.default_of("positions")
    """Positions of a wheel."""


@dataclass(frozen=True)
class CameraSettings:
    """The camera, its sensor and its connection. Defaults are those of the keys in rig.yaml."""

    kind: str
    folder: str = ""
    """Absolute."""
    address: str = ""
    device: int = Camera.default_of("device")
    width: int = Camera.default_of("width")
    height: int = Camera.default_of("height")
    gain: float = Camera.default_of("gain")
    """Electrons per count."""
    read_noise: float = Camera.default_of("read_noise")
    """Electrons."""
    linear_to: float = Camera.default_of("linear_to")
    """Electrons up to which counts are proportional to light."""
    bits: int = Camera.default_of("bits")
    timeout: float = Camera.default_of("timeout")
    """Seconds to wait for a frame beyond its exposure."""

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


@dataclass(frozen=True)
class Target:
    """An angular target: bright spots in known directions about the mirror direction [degree]."""

    theta_s: tuple[float, ...]
    phi_s: tuple[float, ...]
    radius: float


@dataclass(frozen=True)
class Screen:
    """Geometry of the screen [mm] and of its picture [pixel]; see :mod:`brdfpipe.rig.screen`."""

    focal_length: float
    disc_radius: float
    disc: tuple[float, float]
    reference: tuple[float, float]
    fibre_radius: float
    reference_radius: float
    scale: float
    """Pixels per mm."""
    centre: tuple[float, float]
    """Pixel (column, row) of the screen's origin."""
    radial: float = ScreenGeometry.default_of("radial")
    """Radial distortion r (1 + radial r²) [1/mm²]."""


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
    etalon_entrance: float
    fibres: tuple[Fibre, ...]
    screen: Screen
    slit: float
    wavelengths: tuple[float, float]
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
        content = reading.read(path, RigKeys)
        fibres = read_fibres(documents.file_beside(path, content["fibres"]["file"], "fibres.file", "the rig's folder"))
        rig = cls(
            name=content["name"],
            monochromator=_serial(content["monochromator"]),
            wheel=_serial(content["wheel"]),
            camera=_camera(content["camera"], path),
            nd_location=content["nd_location"],
            filters=tuple(Filter(**item) for item in content["filters"]),
            entrances=tuple(map(float, content["entrances"])),
            etalon_entrance=float(content["etalon_entrance"]),
            fibres=fibres,
            screen=Screen(**{key: _plain(value) for key, value in content["screen"].items()}),
            slit=float(content["slit"]),
            wavelengths=(float(content["wavelengths"]["low"]), float(content["wavelengths"]["high"])),
            target=_target(content.get("target")),
            digest=_digest(content, documents.plain(path), fibres),
        )
        _check(path, rig)
        return rig

    def transmittance(self, position: int) -> Filter:
        """The filter at a position of the wheel.

        Raises
        ------
        InputError : the rig has no filter there.
        """
        for neutral_filter in self.filters:
            if neutral_filter.position == position:
                return neutral_filter
        positions = ", ".join(str(neutral_filter.position) for neutral_filter in self.filters)
        raise InputError("rig.yaml", "no filter at this position of the wheel", found=position, accepted=positions)


def read_fibres(path: Path) -> tuple[Fibre, ...]:
    """Read the table of the fibres: CSV with the columns :data:`COLUMNS`, in any order; lines with # are comments.

    Raises
    ------
    InputError : naming the file, the line, what was found and what is accepted.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(path, "not UTF-8 text", where=f"byte {error.start}", accepted="a CSV file") from error
    lines = [(number, line) for number, line in enumerate(text.splitlines(), start=1) if _is_data(line)]
    if not lines:
        raise InputError(
            path, "empty", accepted=f"a line of column titles ({', '.join(COLUMNS)}) and one line per fibre"
        )
    rows = list(csv.reader(io.StringIO("\n".join(line for _, line in lines))))
    titles = [title.strip() for title in rows[0]]
    if sorted(titles) != sorted(COLUMNS):
        raise InputError(
            path,
            "unknown or missing column titles",
            where=f"line {lines[0][0]}",
            found=", ".join(titles),
            accepted=", ".join(COLUMNS),
        )
    if not 1 <= len(rows) - 1 <= MAX_FIBRES:
        raise InputError(path, "wrong number of fibres", found=len(rows) - 1, accepted=f"1 to {MAX_FIBRES}")
    fibres = tuple(_fibre(path, number, titles, row) for (number, _), row in zip(lines[1:], rows[1:], strict=True))
    repeated = _repeated(fibre.name for fibre in fibres)
    if repeated:
        raise InputError(path, "duplicate fibre name", found=repeated, accepted="each name once")
    return fibres


def _is_data(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _fibre(path: Path, line: int, titles: list[str], row: list[str]) -> Fibre:
    where = f"line {line}"
    if len(row) != len(titles):
        raise InputError(path, "wrong number of cells", where=where, found=len(row), accepted=str(len(titles)))
    cells = {title: cell.strip() for title, cell in zip(titles, row, strict=True)}
    values = {title: _number(path, where, title, cells[title]) for title in COLUMNS[1:]}
    if not 0 <= values["theta_s"] <= 180:
        raise InputError(path, "theta_s out of range", where=where, found=cells["theta_s"], accepted="0 to 180 degree")
    return Fibre(name=cells["name"] or f"line-{line}", **values)


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
    return Target(tuple(map(float, theta_s)), tuple(map(float, phi_s)), float(content["radius"]))


def _plain(value: Any) -> Any:
    return tuple(map(float, value)) if isinstance(value, list) else float(value)


def _digest(content: Mapping[str, Any], written: Mapping[str, Any], fibres: tuple[Fibre, ...]) -> str:
    """Digest of the rig as an instrument: rigs that differ in their ports alone measure the same.

    Every frame of a run carries it, so the digest of a description must never change. That is why the numbers of filters and sensor
    enter as they are written (``u`` only where it is given, 640 and 640.0 apart).
    """
    optics = {key: value for key, value in content.items() if key not in ("monochromator", "wheel", "fibres", "camera")}
    camera = {**content["camera"], **written["camera"]}
    sensor = {key: camera[key] for key in ("width", "height", "gain", "read_noise", "linear_to", "bits")}
    ends = [[fibre.name, fibre.theta_s, fibre.phi_s, fibre.x, fibre.y] for fibre in fibres]
    text = store.canonical_json({**optics, "filters": written["filters"], "camera": sensor, "fibres": ends})
    return hashlib.sha256(text.encode()).hexdigest()


def _check(path: Path, rig: Rig) -> None:
    """Refuse keys that contradict each other."""
    positions = [neutral_filter.position for neutral_filter in rig.filters]
    if repeated := _repeated(positions):
        raise InputError(path, "two filters at one position of the wheel", where="filters", found=repeated)
    if max(positions) > rig.wheel.positions:
        accepted = f"1 to {rig.wheel.positions} (`wheel.positions`)"
        raise InputError(
            path, "a position that the wheel does not have", where="filters", found=max(positions), accepted=accepted
        )
    if rig.etalon_entrance not in rig.entrances:
        accepted = ", ".join(f"{entrance:g}" for entrance in rig.entrances)
        raise InputError(
            path,
            "the rig has no such entrance",
            where="etalon_entrance",
            found=f"{rig.etalon_entrance:g}",
            accepted=accepted,
        )
    if rig.wavelengths[0] >= rig.wavelengths[1]:
        raise InputError(path, "`low` is not below `high`", where="wavelengths", found=list(rig.wavelengths))
    if rig.monochromator.port == rig.wheel.port:
        raise InputError(path, "two devices on one port", where="wheel.port", found=rig.wheel.port)


Item = TypeVar("Item", str, int)


def _repeated(items: Iterable[Item]) -> Item | None:
    return next((item for item, count in Counter(items).items() if count > 1), None)
