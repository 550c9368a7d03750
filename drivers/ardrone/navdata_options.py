"""The options of navdata: the fields of each that something reads or the simulator fills in, with their places on the wire.

All options are packed, little-endian. Source: Parrot SDK 2.0.1 `navdata_common.h`, checked against a datagram of firmware 2.4.8.
Angles of the drone: theta nose up, phi right side down, psi clockwise from above.
"""

import re
import struct
from collections.abc import Callable
from typing import Annotated, Any, TypeVar, get_type_hints

from msgspec import Struct

U8 = Annotated[int, "B"]
U16 = Annotated[int, "H"]
I16 = Annotated[int, "h"]
U32 = Annotated[int, "I"]
I32 = Annotated[int, "i"]
F32 = Annotated[float, "f"]
F64 = Annotated[float, "d"]
Ints = tuple[int, ...]
Floats = tuple[float, ...]

OPTION_HEADER = struct.Struct("<HH")
"""The tag, and the size in bytes of the whole option with this header."""
_CODE = re.compile(r"(?:(\d+)x)?(\d*)(\w)")
_ZERO3 = (0.0, 0.0, 0.0)


class OptionLayout:
    """The wire layout of one option class.

    A field `Annotated[int, "I"]` is one number, `Annotated[tuple[float, ...], "9f"]` nine, `Annotated[int, "12xi"]` one after 12
    bytes that nobody reads and that are written as 0; the letters are those of the `struct` module.

    Args:
        unread: number of bytes after the last field.
    """

    def __init__(self, tag: int, cls: type[Any], unread: int) -> None:
        hints = get_type_hints(cls, include_extras=True)
        self.tag = tag
        self.cls = cls
        self.names: tuple[str, ...] = cls.__struct_fields__
        self._codes = [hints[name].__metadata__[0] for name in self.names]
        self.body = struct.Struct("<" + "".join(self._codes) + f"{unread}x")
        self.size = OPTION_HEADER.size + self.body.size
        self._plan: list[tuple[int, int | None]] = []
        at = 0
        for code in self._codes:
            count = int(_CODE.fullmatch(code)[2] or 0)  # type: ignore[index]
            self._plan.append((at, at + count if count else None))
            at += count or 1
        self._flat = all(stop is None for _, stop in self._plan)

    def field(self, name: str) -> tuple[int, str]:
        """Return where a field begins in the body, bytes, and its letters of the `struct` module."""
        place = self.names.index(name)
        unread, count, letter = _CODE.fullmatch(self._codes[place]).groups()  # type: ignore[union-attr]
        return struct.calcsize("<" + "".join(self._codes[:place])) + int(unread or 0), count + letter

    def unpack(self, data: bytes, offset: int) -> Any:
        """Return the option whose body begins at `offset`; the caller has checked that the body is whole."""
        values = self.body.unpack_from(data, offset)
        if self._flat:
            return self.cls(*values)
        return self.cls(*[values[start] if stop is None else values[start:stop] for start, stop in self._plan])

    def pack(self, option: Any) -> bytes:
        """Return the option's header and body.

        Raises:
            struct.error: a value does not fit its field.
        """
        values: list[Any] = []
        for name, (_, stop) in zip(self.names, self._plan, strict=True):
            value = getattr(option, name)
            if stop is None:
                values.append(value)
            else:
                values.extend(value)
        return OPTION_HEADER.pack(self.tag, self.size) + self.body.pack(*values)


LAYOUT_OF_CLASS: dict[type[Any], OptionLayout] = {}
TAG_OF_CLASS: dict[type[Any], int] = {}
C = TypeVar("C", bound=type[Any])


def option(tag: int, unread: int = 0) -> Callable[[C], C]:
    """Enter a class into the table of options under its tag, with the number of bytes that follow its fields."""

    def enter(cls: C) -> C:
        LAYOUT_OF_CLASS[cls], TAG_OF_CLASS[cls] = OptionLayout(tag, cls, unread), tag
        return cls

    return enter


UNREAD_BYTES = {4: 12, 7: 12, 8: 20, 11: 12, 12: 40, 14: 104, 15: 360, 16: 324, 18: 36, 20: 8, 23: 52, 26: 4, 27: 8}
"""Sizes of the bodies of options that nobody reads, by tag; 27 is that of firmware up to 2.3, without GPS."""


@option(0, unread=108)
class Demo(Struct, frozen=True):
    """The short summary, which is also sent in demo mode."""

    ctrl_state: U32
    """The `ControlState` in the high half and its detail in the low half."""
    battery_percent: U32
    theta_mdeg: F32
    phi_mdeg: F32
    psi_mdeg: F32
    altitude_mm: I32
    vx_mm_s: F32
    """The forward velocity in the level frame, mm/s."""
    vy_mm_s: F32
    """The velocity to the right in the level frame, mm/s."""
    vz_mm_s: F32
    """The vertical velocity, which was 0 in every flight seen and is not usable."""


@option(1)
class NavdataTime(Struct, frozen=True):
    """The drone's clock: seconds in the high 11 bits, microseconds in the low 21; wraps every 2048 s."""

    time: U32

    @staticmethod
    def of_us(time_us: int) -> "NavdataTime":
        """Return the option for a time of the drone's clock, microseconds, wrapped as the drone wraps it."""
        seconds, micros = divmod(time_us, 1_000_000)
        return NavdataTime((seconds % 2048) << 21 | micros)

    @property
    def time_us(self) -> int:
        """The time of the drone's clock, microseconds, from 0 to 2048 s."""
        return (self.time >> 21) * 1_000_000 + (self.time & 0x1FFFFF)


@option(2, unread=2)
class RawMeasures(Struct, frozen=True):
    """Converter counts, battery, and the ultrasound's last echo."""

    raw_accs: Annotated[Ints, "3H"] = (0, 0, 0)
    raw_gyros: Annotated[Ints, "3h"] = (0, 0, 0)
    vbat_raw_mv: Annotated[int, "4xI"] = 0
    flag_echo_ini: Annotated[int, "14xH"] = 0
    nb_echo: U16 = 0
    sum_echo: U32 = 0
    alt_temp_raw_mm: I32 = 0


@option(3, unread=12)
class PhysMeasures(Struct, frozen=True):
    """Calibrated accelerometer (at rest and level about (0, 0, -1000) mg) and rate gyro, in forward-right-down axes."""

    accs_temp_c: F32
    gyro_temp: U16
    phys_accs_mg: Annotated[Floats, "3f"]
    phys_gyros_deg_s: Annotated[Floats, "3f"]


@option(5)
class EulerAngles(Struct, frozen=True):
    """The tilt that the accelerometer alone gives, millidegrees."""

    theta_a_mdeg: F32 = 0.0
    phi_a_mdeg: F32 = 0.0


@option(6, unread=56)
class References(Struct, frozen=True):
    """The setpoints of the inner loops, millidegrees and millidegrees per second."""

    ref_theta: I32 = 0
    ref_phi: I32 = 0
    ref_yaw: Annotated[int, "16xi"] = 0


@option(9, unread=64)
class Pwm(Struct, frozen=True):
    """The motor commands."""

    motor: Annotated[Ints, "4B"] = (0, 0, 0, 0)
    """The commands of the front left, front right, rear right and rear left motor, 0..255."""
    sat_motor: Annotated[Ints, "4B"] = (255, 255, 255, 255)


@option(10, unread=4)
class Altitude(Struct, frozen=True):
    """The altitude loop; `altitude_raw_mm` is the ultrasound's own reading along the body's down axis."""

    altitude_vision_mm: I32 = 0
    altitude_raw_mm: Annotated[int, "8xi"] = 0
    obs_alt: Annotated[float, "4xf"] = 0.0
    est_vb: Annotated[Floats, "16x2f"] = (0.0, 0.0)


@option(13, unread=28)
class Vision(Struct, frozen=True):
    """The state of the flow sensor, with the attitude at the frame that it used last."""

    vision_state: U32 = 0
    theta_capture_rad: Annotated[float, "24xf"] = 0.0
    phi_capture_rad: F32 = 0.0
    psi_capture_rad: F32 = 0.0
    altitude_capture_mm: I32 = 0
    time_capture_ms: U32 = 0
    """The capture time on the drone's clock; unlike `Time` it is plain milliseconds (in two captures 10 and 19 ms before it)."""
    body_v: Annotated[Floats, "3f"] = _ZERO3
    """The body velocity, mm/s."""


@option(17)
class Watchdog(Struct, frozen=True):
    """Count of the control loop's watchdog."""

    watchdog: I32 = 0


@option(19, unread=28)
class VideoStream(Struct, frozen=True):
    """The live encoder."""

    frame_size: Annotated[int, "1xI"] = 0
    frame_number: U32 = 0
    out_bitrate: Annotated[int, "16xI"] = 0
    desired_bitrate: U32 = 0


@option(21)
class PressureRaw(Struct, frozen=True):
    """Barometer."""

    up: I32
    ut: I16
    temperature_dc: I32
    """The temperature, tenths of a degree Celsius."""
    pressure_pa: I32


@option(22, unread=8)
class Magneto(Struct, frozen=True):
    """Magnetometer, milligauss and degrees."""

    mx: I16 = 0
    my: I16 = 0
    mz: I16 = 0
    magneto_raw_mg: Annotated[Floats, "3f"] = _ZERO3
    magneto_rectified_mg: Annotated[Floats, "3f"] = _ZERO3
    heading_unwrapped_deg: Annotated[float, "12xf"] = 0.0
    heading_gyro_unwrapped_deg: F32 = 0.0
    heading_fusion_unwrapped_deg: F32 = 0.0
    calibration_ok: U8 = 0
    state: U32 = 0
    radius: F32 = 0.0


@option(24, unread=60)
class KalmanPressure(Struct, frozen=True):
    """The drone's own height filter over pressure, ultrasound and motors."""

    offset_pressure_pa: F32 = 0.0
    est_z: F32 = 0.0


@option(25, unread=4)
class HdvideoStream(Struct, frozen=True):
    """The recorder."""

    frame_number: Annotated[int, "20xI"] = 0


@option(27, unread=16)
class Gps(Struct, frozen=True):
    """Option 27 of firmware 2.4.8 with the flight recorder; that of older firmware is shorter and is left out."""

    lat_deg: F64 = 0.0
    lon_deg: F64 = 0.0
    elevation_m: F64 = 0.0
    hdop: F64 = 0.0
    data_available: I32 = 0
    gps_state: Annotated[int, "40xI"] = 0
    speed: Annotated[float, "56xf"] = 0.0
    last_frame_timestamp: U32 = 0
    degree: F32 = 0.0
    nb_satellites: Annotated[int, "16xI"] = 0
    gps_plugged: Annotated[int, "24xi"] = 0
