"""Navdata options of an AR.Drone from the readings of the simulated sensors.

Fields that nothing here measures stay zero, as they are on a real drone that lacks the part.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from msgspec import Struct, field

from drivers.ardrone import navdata
from drivers.ardrone.navdata import Navdata
from drivers.ardrone.navdata_options import UNREAD_BYTES
from estimator.contracts.motion import G_M_S2
from sitl.sensors.sensors import Readings
from sitl.vehicle.airframe import StickLimits
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.world import Stick

TESLA_PER_MILLIGAUSS = 1e-7
MILLIGAUSS_PER_COUNT = 3.4
"""Scale of the magnetometer, as a captured datagram relates its counts to its field."""


class SentFrame(Struct, frozen=True):
    """The last frame that was sent, as navdata reports it."""

    number: int = 0
    time_ms: int = 0
    """Time of the drone's clock at mid-exposure."""
    rpy_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    altitude_m: float = 0.0
    bytes_sent: int = 0
    bitrate_kbps: int = 0


class Situation(Struct, frozen=True):
    """The values that one datagram holds."""

    state: int
    control_state: int
    readings: Readings
    phase: VehiclePhase
    altitude_m: float
    """Altitude by the drone's own estimate: the last ultrasound echo, corrected for the tilt."""
    time_us: int
    """Time of the drone's clock."""
    stick: Stick
    limits: StickLimits
    shot: SentFrame
    echoes: int
    """Number of ultrasound echoes so far; a new echo may read the same as the last."""
    ticks: int
    """Number of cycles of the drone's control loop, for its watchdog count."""
    gps: navdata.Gps = field(default_factory=navdata.Gps)
    """The flight recorder's receiver; all zero without one."""


def datagram(situation: Situation, sequence: int, mask: int) -> Navdata:
    """Header and the options whose bit `1 << tag` is in `mask`; a mask of 0 is the bootstrap's bare state word."""
    return Navdata(situation.state, sequence, 1, Options(situation, mask))


class Options(Mapping[int, Any]):
    """The options of one datagram by tag, in the order of the wire; each is made when somebody reads it.

    In virtual time nothing encodes them, and five of the 28 are read.
    """

    __slots__ = ("_made", "_mask", "_situation")

    def __init__(self, situation: Situation, mask: int) -> None:
        self._situation = situation
        self._mask = mask
        self._made: dict[int, Any] = {}

    def __getitem__(self, tag: int) -> Any:
        made = self.get(tag)
        if made is None:
            raise KeyError(tag)
        return made

    def get(self, tag: int, default: Any = None) -> Any:
        """Return the option of this tag, or `default` if the datagram does not hold it."""
        made = self._made.get(tag)
        if made is None:
            if not self._mask >> tag & 1:
                return default
            made = self._made[tag] = _OPTIONS[tag](self._situation)
        return made

    def __iter__(self) -> Iterator[int]:
        return (tag for tag in _OPTIONS if self._mask >> tag & 1)

    def __len__(self) -> int:
        return sum(self._mask >> tag & 1 for tag in _OPTIONS)


def upright_m(slant_m: float, rpy_rad: tuple[float, float, float]) -> float:
    """Height over a level ground from a range along the body's down axis."""
    return slant_m * math.cos(rpy_rad[0]) * math.cos(rpy_rad[1])


def _mdeg(angle_rad: float) -> float:
    return math.degrees(angle_rad) * 1e3


def _demo(s: Situation) -> navdata.Demo:
    roll, pitch, yaw = s.readings.rpy_rad
    vx, vy = s.readings.v_level_m_s
    return navdata.Demo(
        ctrl_state=s.control_state,
        battery_percent=round(100 * s.readings.battery_fraction),
        theta_mdeg=_mdeg(pitch),
        phi_mdeg=_mdeg(roll),
        psi_mdeg=_mdeg(yaw),
        altitude_mm=0 if s.phase is VehiclePhase.LANDED else round(1e3 * s.altitude_m),
        vx_mm_s=1e3 * vx,
        vy_mm_s=1e3 * vy,
        # No real drone was ever seen to fill this in.
        vz_mm_s=0.0,
    )


def _raw_measures(s: Situation) -> navdata.RawMeasures:
    readings, echo = s.readings, s.readings.ultrasound_m
    x, y, z = readings.f_body
    p, q, r = readings.w_body
    return navdata.RawMeasures(
        raw_accs=_counts(_raw_acc(x), _raw_acc(-y), _raw_acc(-z), 0, 4095),
        raw_gyros=_counts(math.degrees(p) * 16.4, math.degrees(q) * 16.4, math.degrees(r) * 16.4, -(2**15), 2**15 - 1),
        vbat_raw_mv=round(10_772 + 1_828 * readings.battery_fraction),
        flag_echo_ini=1,
        nb_echo=0 if echo is None else 1,
        sum_echo=s.echoes % 2**32,
        alt_temp_raw_mm=0 if echo is None else round(1e3 * echo),
    )


def _raw_acc(f_m_s2: float) -> float:
    return 2048 + 0.512 * (1e3 * f_m_s2 / G_M_S2)


def _counts(x: float, y: float, z: float, low: int, high: int) -> tuple[int, int, int]:
    a, b, c = round(x), round(y), round(z)
    if low <= a <= high and low <= b <= high and low <= c <= high:
        return a, b, c
    return _clip(x, low, high), _clip(y, low, high), _clip(z, low, high)


def _phys_measures(s: Situation) -> navdata.PhysMeasures:
    x, y, z = s.readings.f_body
    p, q, r = s.readings.w_body
    accs_mg = 1e3 * x / G_M_S2, 1e3 * y / G_M_S2, 1e3 * z / G_M_S2
    return navdata.PhysMeasures(s.readings.temperature_c, 0, accs_mg, (math.degrees(p), math.degrees(q), math.degrees(r)))


def _euler_angles(s: Situation) -> navdata.EulerAngles:
    x, y, z = s.readings.f_body
    return navdata.EulerAngles(_mdeg(math.atan2(x, math.hypot(y, z))), _mdeg(math.atan2(-y, -z)))


def _references(s: Situation) -> navdata.References:
    tilt = s.limits.euler_angle_max_rad if s.stick.progressive else 0.0
    return navdata.References(
        ref_theta=round(_mdeg(s.stick.pitch * tilt)),
        ref_phi=round(_mdeg(s.stick.roll * tilt)),
        ref_yaw=round(_mdeg(s.stick.yaw * s.limits.yaw_rate_max_rad_s)) if s.stick.progressive else 0,
    )


def _pwm(s: Situation) -> navdata.Pwm:
    return navdata.Pwm(motor=tuple(_clip(p, 0, 255) for p in s.readings.motors_pwm))


def _altitude(s: Situation) -> navdata.Altitude:
    echo = s.readings.ultrasound_m
    vx, vy = s.readings.v_level_m_s
    return navdata.Altitude(
        altitude_vision_mm=round(1e3 * s.altitude_m),
        altitude_raw_mm=0 if echo is None else round(1e3 * echo),
        obs_alt=s.altitude_m,
        est_vb=(1e3 * vx, 1e3 * vy),
    )


def _vision(s: Situation) -> navdata.Vision:
    roll, pitch, yaw = s.shot.rpy_rad
    vx, vy = s.readings.v_level_m_s
    return navdata.Vision(
        vision_state=2,
        theta_capture_rad=pitch,
        phi_capture_rad=roll,
        psi_capture_rad=yaw,
        altitude_capture_mm=round(1e3 * s.shot.altitude_m),
        time_capture_ms=s.shot.time_ms,
        body_v=(1e3 * vx, 1e3 * vy, 0.0),
    )


def _video_stream(s: Situation) -> navdata.VideoStream:
    return navdata.VideoStream(
        frame_size=s.shot.bytes_sent,
        frame_number=s.shot.number,
        out_bitrate=s.shot.bitrate_kbps,
        desired_bitrate=s.shot.bitrate_kbps,
    )


def _pressure(s: Situation) -> navdata.PressureRaw:
    return navdata.PressureRaw(
        up=0, ut=0, temperature_dc=round(10 * s.readings.temperature_c), pressure_pa=round(s.readings.pressure_pa)
    )


def _magneto(s: Situation) -> navdata.Magneto:
    if s.readings.magnetometer is None:
        return navdata.Magneto()
    field_mg = tuple(v / TESLA_PER_MILLIGAUSS for v in s.readings.magnetometer)
    heading = math.degrees(s.readings.rpy_rad[2])
    mx, my, mz = (_clip(v / MILLIGAUSS_PER_COUNT, -(2**15), 2**15 - 1) for v in field_mg)
    return navdata.Magneto(
        mx=mx,
        my=my,
        mz=mz,
        magneto_raw_mg=field_mg,
        magneto_rectified_mg=field_mg,
        heading_unwrapped_deg=heading,
        heading_gyro_unwrapped_deg=heading,
        heading_fusion_unwrapped_deg=heading,
        calibration_ok=1,
        state=2,
        radius=math.hypot(*field_mg),
    )


def _kalman_pressure(s: Situation) -> navdata.KalmanPressure:
    return navdata.KalmanPressure(offset_pressure_pa=float(s.readings.pressure_pa), est_z=1e3 * s.altitude_m)


def _clip(value: float, low: int, high: int) -> int:
    whole = round(value)
    return low if whole < low else high if whole > high else whole


def _zeros(tag: int) -> Callable[[Situation], bytes]:
    body = bytes(UNREAD_BYTES[tag])
    return lambda s: body


_FILLED: dict[int, Callable[[Situation], Any]] = {
    0: _demo,
    1: lambda s: navdata.NavdataTime.of_us(s.time_us),
    2: _raw_measures,
    3: _phys_measures,
    5: _euler_angles,
    6: _references,
    9: _pwm,
    10: _altitude,
    13: _vision,
    17: lambda s: navdata.Watchdog(s.ticks % 2**31),
    19: _video_stream,
    21: _pressure,
    22: _magneto,
    24: _kalman_pressure,
    25: lambda s: navdata.HdvideoStream(frame_number=s.shot.number),
    27: lambda s: s.gps,
}
_OPTIONS = {tag: _FILLED.get(tag) or _zeros(tag) for tag in range(28)}
