"""A camera rig as its laboratory describes it: ``rig.yaml`` and the table of its fibres.

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

from brdfpipe import documents, installation, store
from brdfpipe.errors import InputError

BAUD = {"acton": 9600, "acton-wheel": 9600, "thorlabs": 115200}
"""Speed of the line by dialect, where the description says none."""

COLUMNS = ("name", "theta_s", "phi_s", "x", "y")
"""Columns of the table of fibres: direction about the mirror direction [degree], end on the screen [mm]."""

MAX_FIBRES = 10_000


@dataclass(frozen=True)
class SerialSettings:
    """One device on a serial port, and how it is spoken to."""

    dialect: str
    port: str
    baud: int
    case: str = "upper"
    """How words are sent: some units accept only lower case."""
    serial_number: str = ""
    """What the device must answer with; empty accepts any."""
    query_timeout: float = 1.0
    """Seconds."""
    motion_timeout: float = 30.0
    """Seconds."""
    grating: int = 0
    """Grating to select and verify; 0 leaves the one in place."""
    speed: float = 0.0
    """Speed of moves [nm/min]; 0 is the device's fastest."""
    positions: int = 6
    """Positions of a wheel."""


@dataclass(frozen=True)
class CameraSettings:
    """The camera, its sensor, and how frames are had from it."""

    kind: str
    folder: str = ""
    """Absolute."""
    address: str = ""
    device: int = 0
    width: int = 320
    height: int = 240
    gain: float = 3.0
    """Electrons per count."""
    read_noise: float = 20.0
    """Electrons."""
    linear_to: float = 25000.0
    """Electrons up to which counts are in proportion."""
    bits: int = 16
    timeout: float = 60.0
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
    u: float = 0.02
    """Relative standard uncertainty of the transmittance."""


@dataclass(frozen=True)
class Fibre:
    """Where a fibre looks from, about the mirror direction [degree], and where it ends on the screen [mm]."""

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
    """Where things are on the screen [mm], and how the camera sees it [pixel]; see :mod:`brdfpipe.rig.screen`."""

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
    radial: float = 0.0
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
    """Of all that bears on what is measured: geometry, filters, sensor; not of ports and timeouts."""

    @classmethod
    def load(cls, path: str | Path) -> Rig:
        """Read and validate ``rig.yaml`` and the fibres' table it names.

        Raises
        ------
        InputError : naming the file, the line, the key, what stands there and what could.
        """
        path = Path(path)
        content = documents.read(path, installation.project_folder() / "config" / "schemas" / "rig.schema.yaml")
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
            digest=_digest(content, fibres),
        )
        _check(path, rig)
        return rig

    def transmittance(self, position: int) -> Filter:
        """The filter at a position of the wheel.

        Raises
        ------
        InputError : the rig has no filter there.
        """
        for each in self.filters:
            if each.position == position:
                return each
        known = ", ".join(str(each.position) for each in self.filters)
        raise InputError("rig.yaml", "no filter at this position of the wheel", found=position, accepted=known)


def read_fibres(path: Path) -> tuple[Fibre, ...]:
    """Read the table of the fibres: CSV with the columns :data:`COLUMNS`, in any order; lines with # are comments.

    Raises
    ------
    InputError : naming the file, the line, what stands there and what could.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(path, "not UTF-8 text", where=f"byte {error.start}", accepted="a CSV file") from error
    lines = [(number, line) for number, line in enumerate(text.splitlines(), start=1) if _says_something(line)]
    if not lines:
        raise InputError(path, "empty", accepted=f"a line of titles ({', '.join(COLUMNS)}) and a line a fibre")
    rows = list(csv.reader(io.StringIO("\n".join(line for _, line in lines))))
    titles = [title.strip() for title in rows[0]]
    if sorted(titles) != sorted(COLUMNS):
        raise InputError(
            path,
            "the titles are not those of fibres",
            where=f"line {lines[0][0]}",
            found=", ".join(titles),
            accepted=", ".join(COLUMNS),
        )
    if not 1 <= len(rows) - 1 <= MAX_FIBRES:
        raise InputError(path, "the number of fibres", found=len(rows) - 1, accepted=f"1 to {MAX_FIBRES}")
    fibres = tuple(_fibre(path, number, titles, row) for (number, _), row in zip(lines[1:], rows[1:], strict=True))
    repeated = _repeated(fibre.name for fibre in fibres)
    if repeated:
        raise InputError(path, "a fibre stands twice", found=repeated, accepted="each name once")
    return fibres


def _says_something(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _fibre(path: Path, line: int, titles: list[str], row: list[str]) -> Fibre:
    where = f"line {line}"
    if len(row) != len(titles):
        raise InputError(path, "the number of cells", where=where, found=len(row), accepted=str(len(titles)))
    cells = {title: cell.strip() for title, cell in zip(titles, row, strict=True)}
    values = {title: _number(path, where, title, cells[title]) for title in COLUMNS[1:]}
    if not 0 <= values["theta_s"] <= 180:
        raise InputError(path, "theta_s", where=where, found=cells["theta_s"], accepted="0 to 180 degree")
    return Fibre(name=cells["name"] or f"line-{line}", **values)


def _number(path: Path, where: str, title: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = float("nan")
    if not abs(value) < 1e6:
        raise InputError(path, f"{title} is no number", where=where, found=repr(cell), accepted="a number")
    return value


def _serial(content: Mapping[str, Any]) -> SerialSettings:
    return SerialSettings(**{"baud": BAUD[content["dialect"]], **content})


def _camera(content: Mapping[str, Any], path: Path) -> CameraSettings:
    """The camera; its folder, if it is no absolute path, lies beside the description."""
    folder = content.get("folder")
    return (
        CameraSettings(**content)
        if folder is None
        else CameraSettings(**{**content, "folder": str(path.resolve().parent / folder)})
    )


def _target(content: Mapping[str, Any] | None) -> Target | None:
    if content is None:
        return None
    theta_s, phi_s = zip(*content["spots"], strict=True)
    return Target(tuple(map(float, theta_s)), tuple(map(float, phi_s)), float(content["radius"]))


def _plain(value: Any) -> Any:
    return tuple(map(float, value)) if isinstance(value, list) else float(value)


def _digest(content: Mapping[str, Any], fibres: tuple[Fibre, ...]) -> str:
    """A digest of the rig as an instrument: two rigs alike but for their ports measure the same."""
    told = {key: value for key, value in content.items() if key not in ("monochromator", "wheel", "fibres", "camera")}
    sensor = {key: content["camera"][key] for key in ("width", "height", "gain", "read_noise", "linear_to", "bits")}
    places = [[fibre.name, fibre.theta_s, fibre.phi_s, fibre.x, fibre.y] for fibre in fibres]
    text = store.canonical_json({**told, "camera": sensor, "fibres": places})
    return hashlib.sha256(text.encode()).hexdigest()


def _check(path: Path, rig: Rig) -> None:
    """Refuse what each key allows and the whole does not."""
    positions = [each.position for each in rig.filters]
    if repeated := _repeated(positions):
        raise InputError(path, "a position of the wheel stands twice", where="filters", found=repeated)
    if max(positions) > rig.wheel.positions:
        accepted = f"1 to {rig.wheel.positions} (`wheel.positions`)"
        raise InputError(path, "a position beyond the wheel", where="filters", found=max(positions), accepted=accepted)
    if rig.etalon_entrance not in rig.entrances:
        accepted = ", ".join(f"{each:g}" for each in rig.entrances)
        raise InputError(
            path, "no such entrance", where="etalon_entrance", found=f"{rig.etalon_entrance:g}", accepted=accepted
        )
    if rig.wavelengths[0] >= rig.wavelengths[1]:
        raise InputError(path, "low is not below high", where="wavelengths", found=list(rig.wavelengths))
    if rig.monochromator.port == rig.wheel.port:
        raise InputError(path, "two devices on one port", where="wheel.port", found=rig.wheel.port)


Item = TypeVar("Item", str, int)


def _repeated(items: Iterable[Item]) -> Item | None:
    return next((item for item, count in Counter(items).items() if count > 1), None)
