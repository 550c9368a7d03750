"""Kind of a foreign file by its content, not by its suffix."""

import re
from enum import Enum
from pathlib import Path

from drivers.files import Largest, opened, seen_in
from drivers.ship_reports import NETWORK_LINE, SENTENCE
from estimator.contracts.errors import refused
from estimator.contracts.text import utf8_of

ULOG_MAGIC = b"ULog\x01\x12\x35"
DATAFLASH_MAGIC = b"\xa3\x95"
NAVDATA_MAGIC = b"\x88\x77\x66\x55"
_HEAD = 1 << 16  # bytes at the begin of a file that show what it is
_TLOG_STAMP = 8  # length of a telemetry log's stamp before each frame, bytes
_TLOG_BEGAN_US = 1_000_000_000_000_000  # earliest stamp of a telemetry log, Unix time of 2001, us
_TLOG_ENDS_US = 4_000_000_000_000_000  # latest stamp of a telemetry log, Unix time of 2096, us
_FRAMES = {0xFE: 8, 0xFD: 12}
"""Bytes around the payload of an unsigned frame of MAVLink, by its first byte."""
_IN_A_ROW = 4  # frames in a row from which bytes are MAVLink
_MCAP = b"\x89MCAP"
_TEXT = frozenset(range(32, 127)) | frozenset(b"\t\r\n\f\b\x1b\x02\x03") | frozenset(range(128, 256))
"""Bytes of a text; STX and ETX stand about the lines of some instruments."""
_NUMBER = rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_PARAMETER = re.compile(rb"(?:\d+\t\d+\t)?([A-Z][A-Z0-9_]{0,15})[\s,;=]+\"?" + _NUMBER + rb"(?:\s+\d+|\s*[,;#].*)?\s*")
_LOGGED = re.compile(rb"[-\d:/.,;TZ\[\]()+\s]{0,48}")
"""Text that a logger writes before or after a sentence: a time."""


class FileKind(Enum):
    """The kinds of file, with what a user may call them."""

    ULOG = "a PX4 log"
    ENCRYPTED = "an encrypted PX4 log"
    DATAFLASH = "a dataflash log"
    TLOG = "a telemetry log of a ground station"
    NAVDATA = "navdata of an AR.Drone"
    PAVE = "video of an AR.Drone"
    PARAMETERS = "a file of parameters"
    SENTENCES = "sentences of a ship's receiver (NMEA 0183)"
    NETWORK = "a log of a ship's network (NMEA 2000)"
    TABLE = "a table"
    RECORDING = "a recording"
    MCAP = "an MCAP file of another program"
    MAVLINK = "messages of MAVLink without their times"
    ROS_BAG = "a bag of ROS"
    IMAGES = "a folder of images"
    DATABASE = "an SQLite database"
    TEXT = "text"
    OTHER = "a file of another kind"


DECRYPT = "decrypt it with the vehicle's private key (PX4's Tools/log_encryption), and give the .ulg"


def kind_of(path: Path) -> FileKind:
    """Return what a file is.

    Raises:
        BadInput: it cannot be read.
    """
    if path.is_dir():
        with refused(str(path), OSError):
            inside = seen_in(path)
        bag = any(file.name == "metadata.yaml" or file.suffix in (".db3", ".mcap", ".bag") for file in inside)
        return FileKind.ROS_BAG if bag else FileKind.IMAGES
    with opened(path, Largest.RECORDING) as file, refused(str(path), OSError):
        head = utf8_of(file.read(_HEAD))
    if _is_ros2(head):
        return FileKind.ROS_BAG
    if head.startswith(_MCAP):
        return FileKind.RECORDING if b"decklander" in head[: len(_MCAP) + 64] else FileKind.MCAP
    for magic, kind in _MAGICS:
        if head.startswith(magic):
            return kind
    if is_dataflash_text(head):
        return FileKind.DATAFLASH
    if _is_tlog(head):
        return FileKind.TLOG
    if _is_mavlink(head):
        return FileKind.MAVLINK
    if head and _is_text(head):
        return _kind_of_text(head, path.suffix.lower())
    return _HEADLESS.get(path.suffix.lower(), FileKind.OTHER)


def is_dataflash_text(head: bytes) -> bool:
    """Return whether a file begins as the text form of a dataflash log, as ground stations write it."""
    return any(re.match(rb"FMT, ?\d+, ?\d+, ?\w+", line) for line in head.splitlines()[:20])


_MAGICS = (
    (ULOG_MAGIC, FileKind.ULOG), (b"ULogEnc", FileKind.ENCRYPTED), (b"ULogKey", FileKind.ENCRYPTED),
    (DATAFLASH_MAGIC, FileKind.DATAFLASH), (NAVDATA_MAGIC, FileKind.NAVDATA), (b"PaVE", FileKind.PAVE),
    (b"#ROSBAG V", FileKind.ROS_BAG), (b"SQLite format 3", FileKind.DATABASE),
)  # fmt: skip
_HEADLESS = {".ulgc": FileKind.ENCRYPTED, ".ulgk": FileKind.ENCRYPTED, ".pave": FileKind.PAVE}
"""Kinds by the endings of files that their first bytes do not show: PX4's encrypted logs and their keys before release 1.16,
and video that an AR.Drone began to send before it was captured."""


def _is_ros2(head: bytes) -> bool:
    """Return whether a database or an MCAP file says that it is a bag of ROS 2: by its tables, or by its profile."""
    if head.startswith(b"SQLite format 3"):
        return b"CREATE TABLE topics" in head and b"CREATE TABLE messages" in head
    return head.startswith(_MCAP) and head[21:25] == b"ros2"


def _is_text(head: bytes) -> bool:
    try:
        head.decode("utf-8")
    except UnicodeDecodeError as why:
        if why.start < len(head) - 8:
            return False
    return all(byte in _TEXT for byte in head[:4096])


def _kind_of_text(head: bytes, suffix: str) -> FileKind:
    lines = [line.strip() for line in head.splitlines()[:200] if line.strip()]
    output = [line for line in lines if not line.startswith((b"#", b"//"))]
    if output and sum(map(_is_sentence, output)) > len(output) // 2:
        return FileKind.SENTENCES
    if output and sum(NETWORK_LINE.fullmatch(line) is not None for line in output) > len(output) // 2:
        return FileKind.NETWORK
    # By different names: the rows of a log have few.
    if output and len({found[1] for line in output if (found := _PARAMETER.fullmatch(line))}) > len(output) // 2:
        return FileKind.PARAMETERS
    return FileKind.TABLE if suffix == ".csv" or (output and output[0].startswith(b"time_s,")) else FileKind.TEXT


def _is_sentence(line: bytes) -> bool:
    found = SENTENCE.search(line)
    return found is not None and all(map(_LOGGED.fullmatch, (line[: found.start()], line[found.end() :])))


def _is_tlog(head: bytes) -> bool:
    if len(head) <= _TLOG_STAMP or head[_TLOG_STAMP] not in _FRAMES:
        return False
    return _TLOG_BEGAN_US < int.from_bytes(head[:_TLOG_STAMP], "big") < _TLOG_ENDS_US


def _is_mavlink(head: bytes) -> bool:
    at = 0
    for _ in range(_IN_A_ROW):
        if at + 2 > len(head) or head[at] not in _FRAMES:
            return False
        at += _FRAMES[head[at]] + head[at + 1]
    return at <= len(head)
