"""Fuzz files and streams by their grammar.

Valid ones are made record by record, then cut, doubled, reordered, re-defined and filled with numbers that no sensor gives. Three
things hold: a reader raises nothing but the project's own errors, no file is taken for one of another kind, and what is read of
records that are only missing, doubled or in another order is what they say, or a fault is reported.
"""

import math
import struct
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pyais

from companion.settings.load import read_camera
from drivers.camera.images import ImageRefused, decode
from drivers.imports import ardrone_capture, dataflash, image_folder, px4_ulog, tlog
from drivers.imports.kinds import FileKind, kind_of
from drivers.imports.log_history import parameters_of
from drivers.imports.stamps import Tell
from drivers.nmea.sentences import NmeaReader
from estimator.contracts.errors import BadInput
from estimator.contracts.samples import GeoFix, Range
from estimator.contracts.time import MonoNs
from fuzz.nmea import sealed
from fuzz.target import SHARED_MEMORY, Choices, Target, refused
from tests.support import foreign_logs as made

_BEGAN, _COUNT = 20_000_000, 24
_TIMES = [_BEGAN + 100_000 * n for n in range(_COUNT)]
_HEIGHTS = [5.0 - 0.09 * n for n in range(_COUNT)]
_EXTREME = [b"nan", b"-inf", b"1e308", b"-9223372036854775808", b"18446744073709551615", b"", b"-0", b"0x1p9"]
_BITS = [
    bytes(8), b"\xff" * 8, struct.pack("<d", math.nan), struct.pack("<f", math.nan) * 2, struct.pack("<q", -(2**63)),
    struct.pack("<Q", 2**63), struct.pack("<d", 1e308), struct.pack("<f", -math.inf) * 2,
]  # fmt: skip


@dataclass(frozen=True)
class Grammar:
    """One format."""

    kind: FileKind | None
    """Kind of file; None for data of a wire, or for no file of its own."""
    records: tuple[bytes, ...]
    read: Callable[[Path, Tell], set[float]]
    """Returns the figures that a file gives."""
    text: bool = False
    define: tuple[bytes, ...] = ()
    """Definitions that contradict those in the records."""
    true: set[float] = field(default_factory=set)


def _heights(read: Callable[[Path, Tell], object]) -> Callable[[Path, Tell], set[float]]:
    def figures(path: Path, tell: Tell) -> set[float]:
        found = read(path, tell)
        assert isinstance(found, list)
        at = [one.stamp.received_at for one in found]
        assert at == sorted(at)
        return {round(one.range_m, 2) for one in found if isinstance(one, Range)}

    return figures


def _parameters(path: Path, _: Tell) -> set[float]:
    return {round(value, 6) for value in parameters_of(path).parameters.values()}


def _camera(path: Path, _: Tell) -> set[float]:
    camera = read_camera(path)
    return {round(camera.fx, 3), round(camera.fy, 3)}


def _places(path: Path, _: Tell) -> set[float]:
    reader, out = NmeaReader(_MMSI), set()
    for n, line in enumerate(path.read_bytes().splitlines(keepends=True)):
        for sample in reader.samples(line, MonoNs(1_000_000_000 + 200_000_000 * n)):
            if isinstance(sample, GeoFix):
                out.add(round(math.degrees(sample.place.latitude_rad), 4))
    return out


def _picture(path: Path, _: Tell) -> set[float]:
    px = decode(path.read_bytes())
    assert px.dtype == np.uint8
    assert px.ndim == 3
    return set()


def _folder(path: Path, tell: Tell) -> set[float]:
    """Read a folder that has the file as its table."""
    with tempfile.TemporaryDirectory(dir=SHARED_MEMORY) as folder:
        for n in range(6):
            (Path(folder) / f"{n}.png").write_bytes(_png(n))
        (Path(folder) / "times.csv").write_bytes(path.read_bytes())
        return {float(frame.px[0, 0, 0]) for frame in image_folder.frames(Path(folder), (8, 8), tell)}


@cache
def _png(grey: int) -> bytes:
    return cv2.imencode(".png", np.full((8, 8, 3), grey, np.uint8))[1].tobytes()


def _ulog_records() -> tuple[bytes, ...]:
    data, at, out = made.px4_flight(_BEGAN, _COUNT), 16, []
    out.append(data[:at])
    while at < len(data):
        size = 3 + int.from_bytes(data[at : at + 2], "little")
        out.append(data[at : at + size])
        at += size
    return tuple(out)


def _tlog_records() -> tuple[bytes, ...]:
    data, at, out = made.telemetry_log(_COUNT), 0, []
    while at < len(data):
        size = 8 + (data[at + 9] + (8 if data[at + 8] == 0xFE else 12))
        out.append(data[at : at + size])
        at += size
    return tuple(out)


def _dataflash_records() -> tuple[bytes, ...]:
    empty = made.dataflash([])
    formats = tuple(empty[at : at + 89] for at in range(0, len(empty), 89))
    return formats + tuple(made.dataflash([row])[len(empty) :] for row in made.flight(_TIMES, _HEIGHTS))


def _jpeg_records() -> tuple[bytes, ...]:
    px = np.add.outer(np.arange(48), np.arange(64)).astype(np.uint8)
    data, at = cv2.imencode(".jpg", cv2.merge([px, px, px]))[1].tobytes(), 2
    exif = b"Exif\0\0MM\0*\0\0\0\x08\0\1\x01\x12\0\3\0\0\0\1\0\6\0\0\0\0\0\0"
    out = [data[:2], b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif]
    while data[at + 1] != 0xDA:
        size = 2 + int.from_bytes(data[at + 2 : at + 4], "big")
        out.append(data[at : at + size])
        at += size
    return (*out, data[at:-2], data[-2:])


def _ais_records() -> tuple[bytes, ...]:
    out = []
    for n in range(15):
        kind, talker, sentence = _AIS_KINDS[n % len(_AIS_KINDS)]
        fields = {"lat": 54.5 + 0.01 * n, "lon": 10.2, "speed": 4.0, "course": 90.0, "heading": 91, "second": 4 * n}
        parts = pyais.encode_dict({"type": kind, "mmsi": _MMSI + n // 12, "shipname": "DECK", **fields}, talker, sentence)
        out.append("".join(part + "\r\n" for part in parts).encode())
    return tuple(out)


def _lines(text: bytes) -> tuple[bytes, ...]:
    return tuple(text.splitlines(keepends=True))


_ROS = b"""image_width: 640
image_height: 480
camera_name: c
camera_matrix:
  rows: 3
  cols: 3
  data: [500.0, 0, 319.5, 0, 501.0, 239.5, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.01, -0.02, 0.0, 0.0, 0.0]
"""
_PARAMETERS = b"".join(b"INS_TEST_%d,%d.25\n" % (n, n) for n in range(12))
_TABLE = b"#timestamp [ns],filename\n" + b"".join(b"%d,%d.png\n" % (1_700_000_000_000_000_000 + n * 10**8, n) for n in range(6))
_MMSI = 211_234_560
_AIS_KINDS = ((1, "AI", "VDM"), (3, "AI", "VDO"), (18, "BS", "VDM"), (19, "AI", "VDM"), (5, "AI", "VDM"))
"""Kinds of reports and talkers: of both classes, the long one of class B, and one without a place."""
_NMEA = "".join(made.sentence(f"GPGGA,1015{n:02d}.00,54{n:02d}.4000,N,01010.22,E,1,09,0.9,4.0,M,42.1,M,,") for n in range(12))


@cache
def grammars() -> dict[str, Grammar]:
    """Return each format with a valid file of it."""
    heights = {round(h, 2) for h in _HEIGHTS}
    other = struct.pack("<BB4s16s64s", 131, 17, b"RFND", b"QBfBB", b"TimeUS,Instance,Alt,Stat,Orient")
    text = made.text_dataflash(made.flight(_TIMES, _HEIGHTS))
    return {
        "dataflash": Grammar(
            FileKind.DATAFLASH, _dataflash_records(), _heights(dataflash.read), define=(b"\xa3\x95\x80" + other,), true=heights
        ),
        "text_dataflash": Grammar(
            FileKind.DATAFLASH, _lines(text), _heights(dataflash.read), True,
            (b"FMT, 131, 89, RFND, QBfBB, TimeUS,Instance,Alt,Stat,Orient\n",), heights,
        ),
        "ulog": Grammar(
            FileKind.ULOG, _ulog_records(), _heights(px4_ulog.read),
            define=(made.px4_flight(_BEGAN, 0)[16 + 43 :][:60],), true={round(5.0 - 0.09 * n, 2) for n in range(_COUNT)},
        ),
        "tlog": Grammar(
            FileKind.TLOG, _tlog_records(), _heights(tlog.read), true={round(5.0 - 0.04 * n, 2) for n in range(_COUNT)}
        ),
        "navdata": Grammar(
            FileKind.NAVDATA, tuple(made.navdata(n + 1, 5000 * n) for n in range(12)), _heights(ardrone_capture.samples),
            true={1.5},
        ),
        "parameters": Grammar(
            FileKind.PARAMETERS, _lines(_PARAMETERS), _parameters, True, (b"INS_TEST_3,4.25\n",), {n + 0.25 for n in range(12)}
        ),
        "camera": Grammar(None, _lines(_ROS), _camera, True, (b"camera_matrix: 7\n",), {500.0, 501.0}),
        "nmea": Grammar(
            FileKind.SENTENCES, _lines(_NMEA.encode()), _places, True, true={round(54 + (n + 0.4) / 60, 4) for n in range(12)}
        ),
        "ais": Grammar(FileKind.SENTENCES, _ais_records(), _places, True, true={round(54.5 + 0.01 * n, 4) for n in range(12)}),
        "jpeg": Grammar(FileKind.OTHER, _jpeg_records(), _picture),
        "folder": Grammar(None, _lines(_TABLE), _folder, True, (b"time_s,source\n",), {float(n) for n in range(6)}),
    }  # fmt: skip


def run(data: bytes) -> None:
    """Make a file of one format, damage it as the bytes say, and read it."""
    choices = Choices(data)
    name = list(grammars())[choices.number(1) % len(grammars())]
    one = grammars()[name]
    records, honest = list(one.records), True
    for _ in range(1 + choices.number(1) % 4):
        how, at = choices.number(1) % 7, choices.number(2) % max(1, len(records))
        count = 1 + choices.number(1) % 8
        if how == 0:
            del records[at : at + count]
        elif how == 1:
            records[at:at] = records[at : at + count]
        elif how == 2:
            records[at : at + count] = records[at : at + count][::-1]
        elif how == 3 and one.define:
            records.insert(at, one.define[count % len(one.define)])
            honest = False
        elif how == 4 and records:
            cut = choices.number(1) % max(1, len(records[at]))
            records[at] = records[at][:cut]
            honest = honest and not one.text
        elif records:
            records[at], honest = _filled(records[at], one.text, count, choices), False
    _check(name, one, b"".join(records), honest)


def _filled(record: bytes, text: bool, which: int, choices: Choices) -> bytes:
    if text:
        words = record.split(b",")
        words[which % len(words)] = _EXTREME[choices.number(1) % len(_EXTREME)]
        line = b",".join(words)
        # A sentence with a wrong checksum is refused for that alone.
        return sealed(line.partition(b"*")[0]) + b"\r\n" if line[:1] in (b"$", b"!") else line
    at, bits = choices.number(1) % max(1, len(record)), _BITS[choices.number(1) % len(_BITS)]
    return record[:at] + bits + record[at + 8 :]


def _check(name: str, one: Grammar, data: bytes, honest: bool) -> None:
    with tempfile.TemporaryDirectory(dir=SHARED_MEMORY) as folder:
        path = Path(folder) / "x.yaml"
        path.write_bytes(data)
        if one.kind is not None and data:
            kind = kind_of(path)
            assert kind in (one.kind, FileKind.OTHER, FileKind.TEXT), f"{name} taken for {kind.value}"
        reports: list[str] = []
        try:
            figures = one.read(path, reports.append)
        except (BadInput, ImageRefused) as why:
            refused(why)
            return
        if honest and not reports:
            assert figures <= one.true, f"{name}: {figures - one.true} is in none of its records, and nothing is told"


def seeds() -> Iterator[bytes]:
    """Yield one input for each format and each kind of damage."""
    for n in range(len(grammars())):
        for how in (0, 1, 3, 4, 5):
            yield bytes([n, 1, how, 3, 0, 4, 1, 2, (how + 2) % 7, 40, 0, 1, 7])


TARGETS = {"grammar": Target(run, seeds, 64)}
