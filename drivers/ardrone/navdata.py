"""Decode and encode the navdata datagrams of UDP port 5554. No I/O.

A datagram is a header of 16 bytes, options (tag, size with these four bytes, body) and last the checksum option: the sum of
all bytes before it, modulo 2^32. All are packed, little-endian. Source: Parrot SDK 2.0.1 `navdata_common.h`, checked against a
datagram of firmware 2.4.8. Angles of the drone: theta nose up, phi right side down, psi clockwise from above.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import Any, NamedTuple

from msgspec import Struct

from drivers.ardrone.counters import Refusal

MAGIC = 0x55667788
"""First word of a navdata datagram."""
CHECKSUM_TAG = 0xFFFF
"""Tag of the last option, which holds the sum of the bytes before it."""
_HEADER = struct.Struct("<IIII")
_OPTION_HEADER = struct.Struct("<HH")
"""The tag, and the size in bytes of the whole option with this header."""
_CHECKSUM = struct.Struct("<HHI")
_OLD_GPS_BYTES = 8
"""Size of the body of option 27 of firmware up to 2.3, without GPS."""
_OUTLINES_MOST = 16  # outlines of datagrams that are kept; one more, and all are dropped


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


class Navdata(Struct, frozen=True):
    """One navdata datagram: its header, and the fields that the service reads; those of an option that it lacks are None."""

    state: int
    """The header's state field, whose bits are those of `NavdataState`."""
    sequence: int
    options: tuple[int, ...] = ()
    """The tags of the options that it holds whole, in the order of the wire."""
    skipped: tuple[int, ...] = ()
    """The tags of the options that were left out: unknown, shorter than known, or present twice."""

    ctrl_state: int | None = None
    """The `ControlState` in the high half and its detail in the low half."""
    battery_percent: int | None = None
    theta_mdeg: float | None = None
    phi_mdeg: float | None = None
    psi_mdeg: float | None = None
    altitude_mm: int | None = None
    vx_mm_s: float | None = None
    """The forward velocity in the level frame, mm/s."""
    vy_mm_s: float | None = None
    """The velocity to the right in the level frame, mm/s."""
    clock: int | None = None
    """The drone's clock: seconds in the high 11 bits, microseconds in the low 21; wraps every 2048 s."""
    nb_echo: int | None = None
    sum_echo: int | None = None
    ax_mg: float | None = None
    """Accelerometer, mg forward; at rest and level the three read about (0, 0, -1000)."""
    ay_mg: float | None = None
    az_mg: float | None = None
    wx_deg_s: float | None = None
    wy_deg_s: float | None = None
    wz_deg_s: float | None = None
    altitude_raw_mm: int | None = None
    """The ultrasound's own reading along the body's down axis, mm."""
    up: int | None = None
    ut: int | None = None
    temperature_dc: int | None = None
    """The barometer's temperature, tenths of a degree Celsius."""
    pressure_pa: int | None = None
    lat_deg: float | None = None
    lon_deg: float | None = None
    elevation_m: float | None = None
    hdop: float | None = None
    data_available: int | None = None
    last_frame_timestamp: int | None = None
    nb_satellites: int | None = None
    gps_plugged: int | None = None

    @property
    def control_state(self) -> ControlState | None:
        """The control state; None if the option is absent or its number is not known."""
        return None if self.ctrl_state is None else _CONTROL_STATES.get(self.ctrl_state >> 16)

    @property
    def altitude_m(self) -> float | None:
        """The height over what is below by ultrasound, metres; None if the datagram does not hold it."""
        return None if self.altitude_mm is None else 1e-3 * self.altitude_mm

    @property
    def flying(self) -> bool:
        """True if the drone is in the air, a landing under way included."""
        return bool(self.state & NavdataState.FLYING)

    @property
    def time_us(self) -> int | None:
        """The time of the drone's clock, microseconds, from 0 to 2048 s; None if the datagram does not hold it."""
        return None if self.clock is None else (self.clock >> 21) * 1_000_000 + (self.clock & 0x1FFFFF)

    @staticmethod
    def of(state: int, sequence: int, **fields: float) -> Navdata:
        """Build a datagram with the options to which the fields belong."""
        tags = tuple(tag for tag, layout in LAYOUTS.items() if not layout.fields.keys().isdisjoint(fields))
        return Navdata(state, sequence, tags, **fields)  # type: ignore[arg-type]


def clock_of_us(time_us: int) -> int:
    """Return the clock's field for a time, microseconds, wrapped as the drone wraps it."""
    seconds, micros = divmod(time_us, 1_000_000)
    return (seconds % 2048) << 21 | micros


_READ = Navdata.__struct_fields__[4:]
"""The fields that the service reads, in the order of the wire."""

_WIRE = """
0 ctrl_state:I battery_percent:I theta_mdeg:f phi_mdeg:f psi_mdeg:f altitude_mm:i vx_mm_s:f vy_mm_s:f vz_mm_s:f 108x
1 clock:I
2 raw_ax:H raw_ay:H raw_az:H raw_wx:h raw_wy:h raw_wz:h 4x vbat_raw_mv:I 14x flag_echo_ini:H nb_echo:H sum_echo:I
  alt_temp_raw_mm:i 2x
3 accs_temp_c:f gyro_temp:H ax_mg:f ay_mg:f az_mg:f wx_deg_s:f wy_deg_s:f wz_deg_s:f 12x
4 12x
5 theta_a_mdeg:f phi_a_mdeg:f
6 ref_theta:i ref_phi:i 16x ref_yaw:i 56x
7 12x
8 20x
9 motor_1:B motor_2:B motor_3:B motor_4:B sat_motor_1:B sat_motor_2:B sat_motor_3:B sat_motor_4:B 64x
10 altitude_vision_mm:i 8x altitude_raw_mm:i 4x obs_alt:f 16x est_vx:f est_vy:f 4x
11 12x
12 40x
13 vision_state:I 24x theta_capture_rad:f phi_capture_rad:f psi_capture_rad:f altitude_capture_mm:i time_capture_ms:I
  body_vx:f body_vy:f body_vz:f 28x
14 104x
15 360x
16 324x
17 watchdog:i
18 36x
19 1x frame_size:I frame_number:I 16x out_bitrate:I desired_bitrate:I 28x
20 8x
21 up:i ut:h temperature_dc:i pressure_pa:i
22 mx:h my:h mz:h magneto_raw_x:f magneto_raw_y:f magneto_raw_z:f magneto_rectified_x:f magneto_rectified_y:f
  magneto_rectified_z:f 12x heading_unwrapped_deg:f heading_gyro_unwrapped_deg:f heading_fusion_unwrapped_deg:f
  calibration_ok:B magneto_state:I radius:f 8x
23 52x
24 offset_pressure_pa:f est_z:f 60x
25 20x recorder_frame_number:I 4x
26 4x
27 lat_deg:d lon_deg:d elevation_m:d hdop:d data_available:i 40x gps_state:I 56x speed:f last_frame_timestamp:I degree:f
  16x nb_satellites:I 24x gps_plugged:i 16x
"""
"""The options by tag: the fields that something reads or the simulator fills in, and the numbers of bytes of all others.

The letters are those of the `struct` module. Units are in the names; attitudes that end in `_a_mdeg` are what the accelerometer
alone gives; motors count from the front left one clockwise; `time_capture_ms` is plain milliseconds of the drone's clock;
`vz_mm_s` was 0 in every flight seen.
"""


class OptionLayout:
    """The body of one option.

    Args:
        words: its fields as `name:letter`, and gaps as `12x`, in the order of the wire.
    """

    def __init__(self, words: list[str]) -> None:
        self.fields: dict[str, tuple[int, str]] = {}
        """The offset and the letter of each field, by name."""
        form = "<"
        for word in words:
            name, named, letter = word.rpartition(":")
            if named:
                self.fields[name] = struct.calcsize(form), letter
            form += letter
        self.body = struct.Struct(form)


LAYOUTS: Mapping[int, OptionLayout] = {
    int(line.split()[0]): OptionLayout(line.split()[1:]) for line in _WIRE.replace("\n ", "").strip().splitlines()
}
"""The layout of each option by its tag."""


class _Outline(NamedTuple):
    """Options of a datagram and their offsets. A flying drone sends datagrams of few outlines."""

    headers: struct.Struct
    """The headers of all options and of the checksum, each as four bytes, without what lies between them."""
    tags_and_sizes: tuple[bytes, ...]
    """The values of these headers."""
    options: tuple[int, ...]
    skipped: tuple[int, ...]
    read: Callable[[bytes], tuple[Any, ...]]
    """Returns the values of `_READ`."""


_outlines: dict[int, _Outline] = {}
"""The newest good outline by a datagram's size: where it fits, one comparison stands for the walk along the options."""


def decode(datagram: bytes) -> Navdata | Refusal:
    """Decode one whole datagram. Never raises; unknown options are skipped by size, longer bodies are read as far as known."""
    end = len(datagram)
    if end < _HEADER.size + _CHECKSUM.size:
        return Refusal.TOO_SHORT
    magic, state, sequence, _ = _HEADER.unpack_from(datagram)
    if magic != MAGIC:
        return Refusal.BAD_MAGIC
    outline = _outlines.get(end)
    if outline is None or outline.headers.unpack_from(datagram, _HEADER.size) != outline.tags_and_sizes:
        outline = _walk(datagram, end)
        if outline is None:
            return Refusal.TORN
    if _CHECKSUM.unpack_from(datagram, end - _CHECKSUM.size)[2] != _sum_before_checksum(datagram):
        return Refusal.BAD_CHECKSUM
    if len(_outlines) >= _OUTLINES_MOST and end not in _outlines:
        _outlines.clear()
    _outlines[end] = outline
    return Navdata(state, sequence, outline.options, outline.skipped, *outline.read(datagram))


def _walk(datagram: bytes, end: int) -> _Outline | None:
    """Return the outline of a datagram, option by option; None if it is torn."""
    bodies: dict[int, int] = {}
    skipped: list[int] = []
    form, tags_and_sizes = "<", list[bytes]()
    at = _HEADER.size
    while at + _OPTION_HEADER.size <= end:
        tag, size = _OPTION_HEADER.unpack_from(datagram, at)
        if size < _OPTION_HEADER.size or at + size > end:
            return None
        tags_and_sizes.append(datagram[at : at + _OPTION_HEADER.size])
        if tag == CHECKSUM_TAG:
            if size != _CHECKSUM.size or at + size != end:
                return None
            return _Outline(struct.Struct(f"{form}4s"), tuple(tags_and_sizes), tuple(bodies), tuple(skipped), _reader(bodies))
        layout, body_bytes = LAYOUTS.get(tag), size - _OPTION_HEADER.size
        if layout is not None and layout.body.size <= body_bytes and tag not in bodies:
            bodies[tag] = at + _OPTION_HEADER.size
        elif tag != 27 or tag in bodies or body_bytes < _OLD_GPS_BYTES:
            skipped.append(tag)
        form += f"4s{body_bytes}x"
        at += size
    return None


def _reader(bodies: Mapping[int, int]) -> Callable[[bytes], tuple[Any, ...]]:
    """Return what reads the fields of every datagram whose options have their bodies at these offsets, by tag."""
    places = sorted(
        (body + at, letter, _READ.index(name))
        for tag, body in bodies.items()
        for name, (at, letter) in LAYOUTS[tag].fields.items()
        if name in _READ
    )
    form, end, order = "<", 0, [-1] * len(_READ)
    for n, (at, letter, place) in enumerate(places):
        form += f"{at - end}x{letter}"
        end = at + struct.calcsize(f"<{letter}")
        order[place] = n
    unpack = struct.Struct(form).unpack_from
    if order == list(range(len(_READ))):
        return unpack

    def read(datagram: bytes) -> tuple[Any, ...]:
        found = (*unpack(datagram), None)
        return tuple([found[n] for n in order])

    return read


def _sum_before_checksum(datagram: bytes) -> int:
    """Return the sum of all bytes before the checksum: the low half of Adler-32 is one more than that of up to 256 (RFC 1950)."""
    end = len(datagram) - _CHECKSUM.size
    return sum([(zlib.adler32(datagram[at : min(at + 256, end)]) & 0xFFFF) - 1 for at in range(0, end, 256)])


def encode(navdata: Navdata, further: Mapping[str, float] | None = None) -> bytes:
    """Return the bytes of the datagram with its checksum.

    Args:
        further: values by name of fields that the service does not read; all others of its options are 0.

    Raises:
        struct.error: a value does not fit its field.
    """
    further = further or {}
    body = _HEADER.pack(MAGIC, navdata.state, navdata.sequence, 1)
    for tag in navdata.options:
        layout = LAYOUTS[tag]
        values = [getattr(navdata, name) if name in _READ else further.get(name, 0) for name in layout.fields]
        option = layout.body.pack(*[0 if value is None else value for value in values])
        body += _OPTION_HEADER.pack(tag, _OPTION_HEADER.size + len(option)) + option
    return body + _CHECKSUM.pack(CHECKSUM_TAG, _CHECKSUM.size, sum(body) & 0xFFFFFFFF)
