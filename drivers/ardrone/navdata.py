"""Decode and encode the navdata datagrams of UDP port 5554. No I/O.

A datagram is a header of 16 bytes, options (tag, size with these four bytes, body) and last the checksum option: the sum of
all bytes before it, modulo 2^32. Source: Parrot SDK 2.0.1; checked against a datagram of firmware 2.4.8.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from enum import IntEnum
from typing import Any, NamedTuple, TypeVar

from msgspec import Struct

from drivers.ardrone.navdata_options import (
    LAYOUT_OF_CLASS,
    OPTION_HEADER,
    TAG_OF_CLASS,
    UNREAD_BYTES,
    Altitude,
    Demo,
    EulerAngles,
    Gps,
    HdvideoStream,
    KalmanPressure,
    Magneto,
    NavdataTime,
    OptionLayout,
    PhysMeasures,
    PressureRaw,
    Pwm,
    RawMeasures,
    References,
    VideoStream,
    Vision,
    Watchdog,
)
from drivers.ardrone.navdata_readings import NavdataReadings, reader, readings_of
from drivers.ardrone.refusal import Refusal

__all__ = [
    "CHECKSUM_TAG",
    "MAGIC",
    "NO_OPTIONS",
    "Altitude",
    "ControlState",
    "Demo",
    "EulerAngles",
    "Gps",
    "HdvideoStream",
    "KalmanPressure",
    "Magneto",
    "Navdata",
    "NavdataState",
    "NavdataTime",
    "PhysMeasures",
    "PressureRaw",
    "Pwm",
    "RawMeasures",
    "References",
    "VideoStream",
    "Vision",
    "Watchdog",
    "decode",
    "encode",
]

MAGIC = 0x55667788
CHECKSUM_TAG = 0xFFFF
_HEADER = struct.Struct("<IIII")
_CHECKSUM = struct.Struct("<HHI")

T = TypeVar("T")

_LAYOUT_OF_TAG = {layout.tag: layout for layout in LAYOUT_OF_CLASS.values()}


class NavdataState(IntEnum):
    """The bits of the header's state field. Their unions are plain numbers, which are tested hundreds of times a second."""

    FLYING = 1 << 0
    VIDEO_ENABLED = 1 << 1
    VISION_ENABLED = 1 << 2
    RATE_CONTROL = 1 << 3
    ALTITUDE_CONTROL = 1 << 4
    START_BUTTON = 1 << 5
    COMMAND_ACK = 1 << 6
    CAMERA_READY = 1 << 7
    TRAVELLING = 1 << 8
    USB_READY = 1 << 9
    NAVDATA_DEMO = 1 << 10
    NAVDATA_BOOTSTRAP = 1 << 11
    MOTOR_PROBLEM = 1 << 12
    COMMUNICATION_LOST = 1 << 13
    SOFTWARE_FAULT = 1 << 14
    BATTERY_LOW = 1 << 15
    USER_EMERGENCY = 1 << 16
    TIMER_ELAPSED = 1 << 17
    MAGNETO_NEEDS_CALIBRATION = 1 << 18
    ANGLES_OUT_OF_RANGE = 1 << 19
    TOO_MUCH_WIND = 1 << 20
    ULTRASOUND_DEAF = 1 << 21
    CUTOUT = 1 << 22
    PIC_VERSION_OK = 1 << 23
    AT_CODEC_ON = 1 << 24
    NAVDATA_ON = 1 << 25
    VIDEO_ON = 1 << 26
    ACQUISITION_ON = 1 << 27
    CONTROL_WATCHDOG = 1 << 28
    ADC_WATCHDOG = 1 << 29
    COM_WATCHDOG = 1 << 30
    EMERGENCY = 1 << 31


class ControlState(IntEnum):
    """The control state, which is the high half of `Demo.ctrl_state`."""

    DEFAULT = 0
    INIT = 1
    LANDED = 2
    FLYING = 3
    HOVERING = 4
    TEST = 5
    TAKING_OFF = 6
    GOTO_FIX = 7
    LANDING = 8
    LOOPING = 9

    @property
    def word(self) -> int:
        """The value of `Demo.ctrl_state` for this state, with no detail."""
        return self.value << 16


_CONTROL_STATES = {state.value: state for state in ControlState}


def control_state_of(ctrl_state: int) -> ControlState | None:
    """Return the control state of `Demo.ctrl_state`; None if its number is not known."""
    return _CONTROL_STATES.get(ctrl_state >> 16)


NO_OPTIONS: Mapping[int, Any] = {}


class _Bodies(Mapping[int, Any]):
    """The options of a datagram by tag; each is unpacked when somebody reads it. The service reads eight of the 28.

    Args:
        outline: the layout of each option, and the place of its body, which is whole.
    """

    __slots__ = ("_bodies", "_datagram", "_read", "_readings", "_unpacked")

    def __init__(self, datagram: bytes, outline: _Outline) -> None:
        self._datagram = datagram
        self._bodies = outline.bodies
        self._read = outline.read
        self._readings: NavdataReadings | None = None
        self._unpacked: dict[int, Any] = {}

    @property
    def readings(self) -> NavdataReadings:
        """The fields that the service reads of every datagram."""
        found = self._readings
        if found is None:
            found = self._readings = self._read(self._datagram)
        return found

    def __getitem__(self, tag: int) -> Any:
        found = self.get(tag)
        if found is None:
            raise KeyError(tag)
        return found

    def get(self, tag: int, default: Any = None) -> Any:
        """Return the option of this tag, or `default` if the datagram does not hold it."""
        found = self._unpacked.get(tag)
        if found is None:
            body = self._bodies.get(tag)
            if body is None:
                return default
            found = self._unpacked[tag] = body[0].unpack(self._datagram, body[1])
        return found

    def __iter__(self) -> Iterator[int]:
        return iter(self._bodies)

    def __len__(self) -> int:
        return len(self._bodies)


class Navdata(Struct, frozen=True):
    """One navdata datagram. `options` maps a tag to its option in the order of the wire.

    `decode` leaves out an option that nobody reads; for `encode` it is the bytes of its body.
    """

    state: int
    """The header's state field, whose bits are those of `NavdataState`."""
    sequence: int
    vision_defined: int
    options: Mapping[int, Any]
    skipped: tuple[int, ...] = ()
    """The tags of the options that were left out: unknown, shorter than known, or present twice."""

    def get(self, cls: type[T]) -> T | None:
        """Return the option of this class; None if the datagram does not hold it."""
        found = self.options.get(TAG_OF_CLASS[cls])
        return found if type(found) is cls else None

    @property
    def readings(self) -> NavdataReadings:
        """The fields that the service reads of every datagram."""
        options = self.options
        return options.readings if type(options) is _Bodies else readings_of(options)

    @property
    def state_and_height(self) -> tuple[int, int] | None:
        """`Demo.ctrl_state` and `Demo.altitude_mm`; None if the option is absent."""
        options = self.options
        found = options.readings if type(options) is _Bodies else self.get(Demo)
        if found is None or found.ctrl_state is None or found.altitude_mm is None:
            return None
        return found.ctrl_state, found.altitude_mm

    @property
    def control_state(self) -> ControlState | None:
        """The control state of the `Demo` option; None if the option is absent or its number is not known."""
        demo = self.options.get(0)
        return None if demo is None else control_state_of(demo.ctrl_state)

    @staticmethod
    def of(state: int, sequence: int, options: tuple[Any, ...] = (), vision_defined: int = 1) -> Navdata:
        """Build a datagram from option objects, ordered by tag as the drone orders them."""
        by_tag = {LAYOUT_OF_CLASS[type(o)].tag: o for o in options}
        return Navdata(state, sequence, vision_defined, {tag: by_tag[tag] for tag in sorted(by_tag)})


class _Outline(NamedTuple):
    """Options of a datagram and their offsets. A flying drone sends datagrams of few outlines."""

    headers: struct.Struct
    """The headers of all options, each as four bytes, and the checksum, without what lies between them."""
    tags_and_sizes: tuple[bytes, ...]
    """The values of these headers."""
    bodies: dict[int, tuple[OptionLayout, int]]
    skipped: tuple[int, ...]
    read: Callable[[bytes], NavdataReadings]


_OUTLINES_MOST = 16
_outlines: dict[int, _Outline] = {}
"""The newest good outline by a datagram's size: where it fits, one comparison stands for the walk along the options."""


def decode(datagram: bytes) -> Navdata | Refusal:
    """Decode one whole datagram. Never raises; unknown options are skipped by size, longer bodies are read as far as known."""
    end = len(datagram)
    outline = _outlines.get(end)
    if outline is not None:
        *tags_and_sizes, checksum = outline.headers.unpack_from(datagram, _HEADER.size)
        if tuple(tags_and_sizes) == outline.tags_and_sizes:
            magic, state, sequence, vision_defined = _HEADER.unpack_from(datagram)
            if magic != MAGIC:
                return Refusal.BAD_MAGIC
            if checksum != _sum_before_checksum(datagram):
                return Refusal.BAD_CHECKSUM
            return Navdata(state, sequence, vision_defined, _Bodies(datagram, outline), outline.skipped)
    return _walk(datagram, end)


def _walk(datagram: bytes, end: int) -> Navdata | Refusal:
    """Decode a datagram of any outline, option by option."""
    if end < _HEADER.size + _CHECKSUM.size:
        return Refusal.TOO_SHORT
    magic, state, sequence, vision_defined = _HEADER.unpack_from(datagram)
    if magic != MAGIC:
        return Refusal.BAD_MAGIC
    bodies: dict[int, tuple[OptionLayout, int]] = {}
    skipped: list[int] = []
    format_, tags_and_sizes = "<", list[bytes]()
    at = _HEADER.size
    while at + OPTION_HEADER.size <= end:
        tag, size = OPTION_HEADER.unpack_from(datagram, at)
        if size < OPTION_HEADER.size or at + size > end:
            return Refusal.TORN
        if tag == CHECKSUM_TAG:
            if size != _CHECKSUM.size or at + size != end:
                return Refusal.TORN
            (checksum,) = struct.unpack_from("<I", datagram, at + OPTION_HEADER.size)
            if checksum != _sum_before_checksum(datagram):
                return Refusal.BAD_CHECKSUM
            if len(_outlines) >= _OUTLINES_MOST:
                _outlines.clear()
            tags_and_sizes.append(datagram[at : at + OPTION_HEADER.size])
            headers = struct.Struct(f"{format_}4sI")
            _outlines[end] = outline = _Outline(headers, tuple(tags_and_sizes), bodies, tuple(skipped), reader(bodies))
            return Navdata(state, sequence, vision_defined, _Bodies(datagram, outline), outline.skipped)
        layout = _LAYOUT_OF_TAG.get(tag)
        if layout is not None and layout.size <= size and tag not in bodies:
            bodies[tag] = layout, at + OPTION_HEADER.size
        elif tag in bodies or size - OPTION_HEADER.size < UNREAD_BYTES.get(tag, 1 << 16):
            skipped.append(tag)
        format_ += f"4s{size - OPTION_HEADER.size}x"
        tags_and_sizes.append(datagram[at : at + OPTION_HEADER.size])
        at += size
    return Refusal.TORN


def _sum_before_checksum(datagram: bytes) -> int:
    """Return the sum of all bytes before the checksum: the low half of Adler-32 is one more than that of up to 256 (RFC 1950)."""
    end = len(datagram) - _CHECKSUM.size
    return sum([(zlib.adler32(datagram[at : min(at + 256, end)]) & 0xFFFF) - 1 for at in range(0, end, 256)])


def encode(navdata: Navdata) -> bytes:
    """Return the bytes of the datagram with its checksum; they do not hold the `skipped` options.

    Raises:
        struct.error: a value does not fit its field.
    """
    parts = [_HEADER.pack(MAGIC, navdata.state, navdata.sequence, navdata.vision_defined)]
    for tag, option in navdata.options.items():
        layout = LAYOUT_OF_CLASS.get(type(option))
        parts.append(layout.pack(option) if layout else OPTION_HEADER.pack(tag, OPTION_HEADER.size + len(option)) + option)
    body = b"".join(parts)
    return body + _CHECKSUM.pack(CHECKSUM_TAG, _CHECKSUM.size, sum(body) & 0xFFFFFFFF)
