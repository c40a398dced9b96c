"""Small files in instruments' formats, written byte by byte from the formats' descriptions, and not by the library under test.

Each writer takes heights ``(y, x)`` in µm at the pitches of :data:`PITCH`, y upwards as brdfpipe counts it, and writes them
in the order of the format: mostly as a picture, from the upper edge down.
"""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Callable

import numpy as np

PITCH = (0.5, 0.75)
"""x, y [µm]; exact in single precision."""


def al3d(height: np.ndarray) -> bytes:
    rows, columns = height.shape
    tags = {
        "Cols": columns,
        "Rows": rows,
        "PixelSizeXMeter": PITCH[0] * 1e-6,
        "PixelSizeYMeter": PITCH[1] * 1e-6,
        "InvalidPixelValue": 1e10,
    }
    offset = 17 + 52 * (len(tags) + 3) + 256
    entries = {"Version": 1, "TagCount": len(tags) + 1, **tags, "DepthImageOffset": offset}
    head = b"AliconaImaging\0\r\n" + b"".join(
        struct.pack("20s30s2s", key.encode(), str(value).encode(), b"\r\n") for key, value in entries.items()
    )
    # Rows are padded to whole groups of 8 bytes.
    padded = np.pad(np.nan_to_num(height[::-1] * 1e-6, nan=1e10), ((0, 0), (0, columns % 2)))
    return (head + bytes(256)).ljust(offset, b"\0") + padded.astype("<f4").tobytes()


def gwy(height: np.ndarray) -> bytes:
    """Typed, named components of nested objects; lengths in m, rows from the upper edge down."""

    def component(name: str, kind: str, value: bytes) -> bytes:
        return name.encode() + b"\0" + kind.encode() + value

    def nested(name: str, content: bytes) -> bytes:
        return name.encode() + b"\0" + struct.pack("<I", len(content)) + content

    rows, columns = height.shape
    metre = component("unitstr", "s", b"m\0")
    data = (np.nan_to_num(height[::-1]) * 1e-6).astype("<f8")
    gaps = np.isnan(height[::-1]).astype("<f8")
    field = component("xres", "i", struct.pack("<i", columns)) + component("yres", "i", struct.pack("<i", rows))
    for axis, extent in (("x", PITCH[0] * columns), ("y", PITCH[1] * rows)):
        field += component(f"{axis}real", "d", struct.pack("<d", extent * 1e-6))
    units = b"".join(component(f"si_unit_{axes}", "o", nested("GwySIUnit", metre)) for axes in ("xy", "z"))
    fields = [
        component(
            f"/0/{name}",
            "o",
            nested(
                "GwyDataField",
                field + units + component("data", "D", struct.pack("<I", values.size) + values.tobytes()),
            ),
        )
        for name, values in (("data", data), ("mask", gaps))
    ]
    return b"GWYP" + nested("GwyContainer", b"".join(fields) + component("/0/data/title", "s", b"Topography\0"))


def os3d(height: np.ndarray) -> bytes:
    rows, columns = height.shape
    words = b"".join(struct.pack("<I", len(text)) + text for text in (b"map", b"2024-05-07"))
    head = b"OmniSurf3D" + struct.pack("<2i", 1, 0) + words + struct.pack("<2i4d", columns, rows, *PITCH, 0, 0)
    return head + np.nan_to_num(height[::-1], nan=np.finfo(np.float32).min).astype("<f4").tobytes()


def plux(height: np.ndarray) -> bytes:
    rows, columns = height.shape
    general = {
        "IMAGE_SIZE_X": columns,
        "IMAGE_SIZE_Y": rows,
        "FOV_X": PITCH[0],
        "FOV_Y": PITCH[1],
        "DATE": "Tue May 7 10:00:00 2024",
    }
    items = "".join(f"<{name}>{value}</{name}>" for name, value in general.items())
    index = f"<xml><GENERAL>{items}</GENERAL><INFO><SIZE>0</SIZE></INFO><LAYER_0><FILENAME_Z>LAYER_0.raw</FILENAME_Z></LAYER_0></xml>"
    return archive({"index.xml": index.encode(), "LAYER_0.raw": height[::-1].astype("<f4").tobytes()})


def tmd(height: np.ndarray) -> bytes:
    """Lengths and heights in mm. The format, as far as it is known, marks no missing height."""
    rows, columns = height.shape
    head = b"Binary TrueMap Data File v2.0\r\n\0" + b"Created by TrueMap v6\r\n\0"
    sizes = struct.pack("<2I4f", columns, rows, PITCH[0] * columns * 1e-3, PITCH[1] * rows * 1e-3, 0, 0)
    return head + sizes + (np.nan_to_num(height[::-1], nan=np.nanmin(height)) * 1e-3).astype("<f4").tobytes()


def vk4(height: np.ndarray) -> bytes:
    """Counts of 0.1 nm below 17 offsets and the settings of the measurement; lengths in pm. No height is marked as missing."""
    rows, columns = height.shape
    start = 12 + 72 + 4 * 83
    offsets = [84, *[0] * 5, start, *[0] * 11]
    settings = [0] * 83
    settings[0], settings[1:4] = 4 * 83, [2024, 5, 7]
    settings[42:45] = [round(PITCH[0] * 1e6), round(PITCH[1] * 1e6), 100]
    raw = np.round((np.nan_to_num(height[::-1], nan=np.nanmin(height)) - np.nanmin(height)) * 1e4).astype("<u4")
    image = struct.pack("<7I", columns, rows, 32, 0, raw.nbytes, 0, 0) + bytes(768) + raw.tobytes()
    return b"VK4_" + bytes(8) + struct.pack("<18I", *offsets) + struct.pack("<83I", *settings) + image


def vk6(height: np.ndarray) -> bytes:
    return b"VK6" + bytes(5) + archive({"Vk4File": vk4(height)})


def zmg(height: np.ndarray) -> bytes:
    """Counts of 0.1 nm, 16 bits. The format, as far as it is known, marks no missing height."""
    rows, columns = height.shape
    head = b"Zeta-Instruments" + bytes(69) + struct.pack("<2I4x3f8xI10x68s6x", columns, rows, *PITCH, 1e-4, 0, b"map")
    raw = np.round((np.nan_to_num(height[::-1], nan=np.nanmin(height)) - np.nanmin(height)) * 1e4)
    return head + raw.astype("<u2").tobytes()


def zon(height: np.ndarray) -> bytes:
    """A picture, then an archive of XML and of arrays, counts of 0.1 nm and their validity."""
    rows, columns = height.shape
    scale = f"<C><XYCalibration><MeterPerPixel>{PITCH[0] * 1e-6}</MeterPerPixel></XYCalibration>"
    scale += "<ZCalibration><MeterPerUnit>1e-10</MeterPerUnit></ZCalibration></C>"
    raw = np.round(np.nan_to_num(height[::-1]) * 1e4).astype("<i4")
    gaps = np.isnan(height[::-1]).astype("u1")
    entries = {
        "cbc1d39b-215f-4d56-a20e-cf8e5f570755": b"<D><DeviceModelName>VR</DeviceModelName><DeviceSerialId>1</DeviceSerialId></D>",
        "1d35862b-3b48-4df2-9235-833ef590b043": b"<S><ScanDateTime>2024-05-07T10:00:00</ScanDateTime></S>",
        "686613b8-27b5-4a29-8ffc-438c2780873e": scale.encode(),
        "4cdb0c75-5706-48cc-a9a1-adf395d609ae": struct.pack("<4i", columns, rows, 4, 4 * columns) + raw.tobytes(),
        "9e7ca6dd-0e6a-4d7b-8986-f0a7b773c916": struct.pack("<4i", columns, rows, 1, columns) + gaps.tobytes(),
    }
    return b"KPK0" + struct.pack("<I", 4) + bytes(4) + archive(entries)


def archive(entries: dict[str, bytes]) -> bytes:
    """A zip archive of these entries."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in entries.items():
            packed.writestr(name, content)
    return buffer.getvalue()


def nms(height: np.ndarray) -> bytes:
    """The pitch counts in nm. The format, as far as it is known, marks no missing height."""
    rows, columns = height.shape
    low, high = np.nanmin(height), np.nanmax(height)
    head = bytearray(3468)
    struct.pack_into("<2d", head, 16, low, high)
    struct.pack_into("<2I2d", head, 1368, columns, rows, PITCH[0] * 1e3, PITCH[1] * 1e3)
    levels = np.round((np.nan_to_num(height[::-1], nan=low) - low) / (high - low) * (2**16 - 2))
    return bytes(head) + levels.astype("<u2").tobytes()


def opd(height: np.ndarray) -> bytes:
    """Columns run fastest from the lower edge of the image up."""
    rows, columns = height.shape
    wavelength = 500.0
    raw = np.nan_to_num(height * 1e3 / wavelength, nan=2e38).T
    blocks = [
        (b"Raw", 3, struct.pack("<3H", columns, rows, 4) + raw.astype("<f4").tobytes()),
        (b"Wavelength", 7, struct.pack("<f", wavelength)),
        (b"Pixel_size", 7, struct.pack("<f", PITCH[0] * 1e-3)),
        (b"Aspect", 7, struct.pack("<f", PITCH[1] / PITCH[0])),
    ]
    directory = [(b"Directory", 1, bytes(24 * (len(blocks) + 1))), *blocks]
    head = b"".join(struct.pack("<16shlH", name, kind, len(data), 0) for name, kind, data in directory)
    return b"\x01\x00" + head + b"".join(data for _, _, data in blocks)


def metropro(height: np.ndarray) -> bytes:
    """Of phase resolution 1: 32 768 counts a fringe. The format has no extension of its own."""
    rows, columns = height.shape
    wavelength, counts, head = 633e-9, 32768, bytearray(834)
    for place, code, values in (
        (0, ">4sHI", (b"\x88\x1b\x03\x6f", 1, 834)),
        (64, ">4HI", (0, 0, columns, rows, 4 * height.size)),
        (164, ">6f", (0.5, wavelength, 0, 1, 0, PITCH[0] * 1e-6)),
        (218, ">h", (1,)),
    ):
        struct.pack_into(code, head, place, *values)
    phase = np.round(height[::-1] * 1e-6 * counts / (0.5 * wavelength))
    return bytes(head) + phase.astype(">i4").tobytes()


def plu(height: np.ndarray) -> bytes:
    rows, columns = height.shape
    head = struct.pack("<128sI256s", b"Mon Jan 03 10:00:00 2011", 0, b"")
    calibration = struct.pack("<3I7f", rows, columns, 1, 1, *PITCH, 0, 0, 1, 0)
    settings = struct.pack("<5I", 3, 0, 0, 10, 6) + struct.pack("<2fI2fI3f4B", *[0] * 13)
    configuration = struct.pack("<8BI", 0, 1, 0, 0, 0, 0, 0, 0, 1)
    data = np.nan_to_num(height[::-1], nan=1000001).astype("<f4").tobytes()
    return head + calibration + settings + configuration + struct.pack("<2I", rows, columns) + data + bytes(8)


def sdf(height: np.ndarray) -> bytes:
    """The text variant. Its coordinates are right-handed: the first row is the lowest."""
    rows, columns = height.shape
    head = {
        "ManufacID": "none",
        "NumPoints": columns,
        "NumProfiles": rows,
        "Xscale": PITCH[0] * 1e-6,
        "Yscale": PITCH[1] * 1e-6,
        "Zscale": 1e-6,
        "Zresolution": -1,
        "Compression": 0,
        "DataType": 7,
        "CheckType": 0,
    }
    lines = ["aISO-1.0", *(f"{key} = {value}" for key, value in head.items()), "*"]
    lines += [" ".join("BAD" if np.isnan(z) else repr(float(z)) for z in row) for row in height]
    return ("\n".join(lines) + "\n*\n").encode()


def sur(height: np.ndarray) -> bytes:
    rows, columns = height.shape
    step = 1e-4
    raw = np.round(height[::-1] / step)
    low, high = int(np.nanmin(raw)), int(np.nanmax(raw))
    units = [b"um", b"um", b"um"]
    head = b"".join(
        [
            struct.pack("<12s4H30s30s", b"DIGITAL SURF", 0, 1, 1, 2, b"map", b"none"),
            struct.pack("<5H2IH", 0, 0, 0, 1, 0, 0, 0, 32),
            struct.pack("<4iI3f", low, high, columns, rows, columns * rows, *PITCH, step),
            struct.pack("<9s7x9s7x9s7x", b"X", b"Y", b"Z"),
            b"".join(unit.ljust(16, b"\0") for unit in 2 * units),
            struct.pack("<3f3H3I", 1, 1, 1, 0, 0, 0, 0, 0, 0),
            struct.pack("<7Hf2IH2H128s3f34x", 0, 0, 10, 3, 1, 2011, 0, 0, 0, 0, 0, 0, 0, b"", 0, 0, 0),
        ]
    )
    return head + np.nan_to_num(raw, nan=low - 2).astype("<i4").tobytes()


def mnt(height: np.ndarray) -> bytes:
    """A compound document whose one stream is a tree of tag, size and content; counts of 0.1 nm and a picture of what was measured, in blocks with check sums."""
    rows, columns = height.shape

    def tag(number: int, *content: bytes) -> bytes:
        joined = b"".join(content)
        return struct.pack("<HQ", number, len(joined)) + joined

    def number(place: int, kind: str, value: float) -> bytes:
        return tag(place, struct.pack(f"<{kind}", value))

    def scale(step: float) -> bytes:
        micrometres = b"\x04" + "µm".encode("utf-16-le")
        return tag(0xFFFF, number(1, "d", step), tag(2, micrometres), tag(3, micrometres), number(5, "d", 0))

    def of_class(name: int) -> bytes:
        return tag(1, number(1, "I", name))

    def array(name: int, values: np.ndarray) -> bytes:
        block = zlib.compress(values.tobytes(), 0)
        data = struct.pack("<2Q2I", values.nbytes, 0, values.size, len(block)) + block
        return of_class(name) + tag(2, number(1, "I", values.size), tag(2, data))

    def axis(count: int, step: float) -> bytes:
        return tag(0xFFFF, scale(step), number(1, "I", count))

    counts = np.round(np.nan_to_num(height[::-1]) * 1e4).astype("<i4")
    measured = np.pad(np.where(np.isnan(height[::-1]), 22, 9).astype("u1"), 1)
    picture = number(1, "I", columns) + number(2, "I", rows) + tag(5, array(9048, measured))
    axes = tag(1, axis(columns, PITCH[0])) + tag(2, axis(rows, PITCH[1]))
    grid = axes + tag(3, of_class(9056), tag(2, picture))
    data = tag(0xFFFF, grid) + tag(1, array(9049, counts)) + tag(2, scale(1e-4))
    surface = tag(1, of_class(9062), tag(2, tag(0xFFFF, data)))
    item = tag(1, of_class(9012), tag(2, surface))
    document = tag(0x2BD, number(1, "B", 1), tag(2, tag(1, bytes(8), item)))
    main = tag(1, document)
    return compound(struct.pack("<Q", len(main)) + main)


_STORED = zlib.compress(b"", 0)[:2] + b"\1"
"""Begin of a block of zlib that is not compressed, and is the last one."""


def compound(stream: bytes) -> bytes:
    """A compound document of one stream, ``ScopedContents``: header, table of sectors, directory, stream."""
    sectors = -(-len(stream) // 512)
    end, free, table = 0xFFFFFFFE, 0xFFFFFFFF, 0xFFFFFFFD
    chain = [table, end, *range(3, sectors + 2), end]
    head = struct.pack("<8s16x5H6x2I", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", 0x3E, 3, 0xFFFE, 9, 6, 0, 1)
    head += struct.pack("<9I", 1, 0, 4096, end, 0, end, 0, 0, free) + struct.pack("<I", free) * 107

    def entry(name: str, kind: int, child: int, start: int, size: int) -> bytes:
        letters = (name + "\0").encode("utf-16-le")
        links = struct.pack("<64sH2B3I", letters, len(letters), kind, 1, free, free, child)
        return links + bytes(36) + struct.pack("<IQ", start, size)

    directory = entry("Root Entry", 5, 1, end, 0) + entry("ScopedContents", 2, free, 2, len(stream))
    pointers = struct.pack(f"<{len(chain)}I", *chain)
    # Other streams have other tables.
    assert len(stream) >= 4096
    assert len(pointers) <= 512
    return head + pointers.ljust(512, b"\xff") + directory.ljust(512, b"\0") + stream.ljust(512 * sectors, b"\0")


WRITERS: dict[str, Callable[[np.ndarray], bytes]] = {
    "al3d": al3d,
    "gwy": gwy,
    "mnt": mnt,
    "nms": nms,
    "opd": opd,
    "os3d": os3d,
    "plu": plu,
    "plux": plux,
    "sdf": sdf,
    "sur": sur,
    "tmd": tmd,
    "vk4": vk4,
    "vk6": vk6,
    "zmg": zmg,
    "zon": zon,
}
"""Extension → writer."""

MARKS_MISSING = {"al3d", "gwy", "mnt", "opd", "os3d", "plu", "plux", "sdf", "sur", "zon"}
SQUARE = {"zon"}
"""Formats that state one pitch for both axes."""

COUNTS = {"vk4", "vk6", "zmg"}
"""Formats of unsigned counts, whose lowest height is 0."""

_MANY = struct.pack("<I", 40_000)
"""Points along an axis: 1.6e9 along both."""


def _with(content: bytes, place: int, length: int = 2) -> bytes:
    return content[:place] + _MANY * length + content[place + 4 * length :]


POINTS: dict[str, list[Callable[[bytes], bytes]]] = {
    "gwy": [
        lambda content: content.replace(b"xres\0i2\0\0\0", b"xres\0i" + _MANY).replace(
            b"yres\0i(\0\0\0", b"yres\0i" + _MANY
        )
    ],
    "os3d": [lambda content: _with(content, 10 + 8 + 7 + 14)],
    "plux": [lambda content: replaced(content, "index.xml", b"_X>50<", b"_X>40000<", b"_Y>40<", b"_Y>40000<")],
    "tmd": [lambda content: _with(content, 32 + 24)],
    "vk4": [lambda content: _with(content, 12 + 72 + 4 * 83)],
    "zmg": [lambda content: _with(content, 16 + 69)],
    "zon": [
        lambda content: replaced(
            content,
            "4cdb0c75-5706-48cc-a9a1-adf395d609ae",
            struct.pack("<2I", 50, 40),
            2 * _MANY,
            struct.pack("<I", 200),
            struct.pack("<I", 160_000),
        )
    ],
}
"""Changes of the size that a file states, by extension."""


def replaced(content: bytes, entry: str, *changes: bytes) -> bytes:
    """The archive at the end of a file, with bytes of one entry replaced: old, new, old, new …"""
    prefix, entries = _taken_apart(content)
    for old, new in zip(changes[::2], changes[1::2], strict=True):
        assert old in entries[entry]
        entries[entry] = entries[entry].replace(old, new, 1)
    return prefix + archive(entries)


def with_prolog(content: bytes, prolog: str) -> bytes:
    """Every XML document of the archive at the end of a file, behind a prolog."""
    prefix, entries = _taken_apart(content)
    return prefix + archive(
        {name: prolog.encode() + data if data[:1] == b"<" else data for name, data in entries.items()}
    )


def with_entry(content: bytes, name: str, data: bytes) -> bytes:
    """The archive at the end of a file, with one more entry."""
    prefix, entries = _taken_apart(content)
    return prefix + archive(entries | {name: data})


def parts(content: bytes) -> tuple[dict[str, bytes], Callable[[dict[str, bytes]], bytes]]:
    """What check sums protect in an archive or a compound document, piece by piece, and how to put them together with new sums.

    A file without check sums is one piece.
    """
    if content[:4] == b"\xd0\xcf\x11\xe0":
        return _stream_taken_apart(content[1536:])
    if b"PK\3\4" not in content:
        return {"": content}, lambda changed: changed[""]
    prefix, entries = _taken_apart(content)
    return entries, lambda changed: prefix + archive(changed)


def _stream_taken_apart(stream: bytes) -> tuple[dict[str, bytes], Callable[[dict[str, bytes]], bytes]]:
    """The blocks of zlib in a stream, and what stands between them."""
    pieces: dict[str, bytes] = {}
    while (place := stream.find(_STORED)) >= 0:
        block = zlib.decompressobj()
        pieces[f"bytes {len(pieces)}"] = stream[:place]
        pieces[f"block {len(pieces)}"] = block.decompress(stream[place:])
        stream = block.unused_data
    pieces["end"] = stream

    def put_together(changed: dict[str, bytes]) -> bytes:
        packed = [zlib.compress(piece, 0) if name[:5] == "block" else piece for name, piece in changed.items()]
        return compound(b"".join(packed))

    return pieces, put_together


def _taken_apart(content: bytes) -> tuple[bytes, dict[str, bytes]]:
    with zipfile.ZipFile(io.BytesIO(content)) as packed:
        return content[: content.index(b"PK\3\4")], {name: packed.read(name) for name in packed.namelist()}
