"""Navdata of an AR.Drone from the readings of the simulated sensors.

Fields that nothing here measures stay zero, as they are on a real drone that lacks the part.
"""

import math
from collections.abc import Mapping
from functools import cache

from msgspec import Struct

from drivers.ardrone.navdata import LAYOUTS, Navdata, clock_of_us
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
    gps: Mapping[str, float]
    """The fields of the flight recorder's receiver."""


@cache
def _tags(mask: int) -> tuple[int, ...]:
    return tuple(tag for tag in LAYOUTS if mask >> tag & 1)


def datagram(s: Situation, sequence: int, mask: int) -> Navdata:
    """Return the datagram with the options whose bit `1 << tag` is in `mask`; 0 is the bootstrap's bare state word."""
    values: dict[str, float] = {}
    readings, echo = s.readings, s.readings.ultrasound_m
    if mask & 1 << 0:
        roll, pitch, yaw = readings.rpy_rad
        vx, vy = readings.v_level_m_s
        values.update(
            ctrl_state=s.control_state,
            battery_percent=round(100 * readings.battery_fraction),
            theta_mdeg=_mdeg(pitch),
            phi_mdeg=_mdeg(roll),
            psi_mdeg=_mdeg(yaw),
            altitude_mm=0 if s.phase is VehiclePhase.LANDED else round(1e3 * s.altitude_m),
            vx_mm_s=1e3 * vx,
            vy_mm_s=1e3 * vy,
        )
    if mask & 1 << 1:
        values["clock"] = clock_of_us(s.time_us)
    if mask & 1 << 2:
        values.update(nb_echo=0 if echo is None else 1, sum_echo=s.echoes % 2**32)
    if mask & 1 << 3:
        x, y, z = readings.f_body
        p, q, r = readings.w_body
        values.update(ax_mg=1e3 * x / G_M_S2, ay_mg=1e3 * y / G_M_S2, az_mg=1e3 * z / G_M_S2)
        values.update(wx_deg_s=math.degrees(p), wy_deg_s=math.degrees(q), wz_deg_s=math.degrees(r))
    if mask & 1 << 10:
        values["altitude_raw_mm"] = 0 if echo is None else round(1e3 * echo)
    if mask & 1 << 21:
        temperature_dc, pressure_pa = round(10 * readings.temperature_c), round(readings.pressure_pa)
        values.update(up=0, ut=0, temperature_dc=temperature_dc, pressure_pa=pressure_pa)
    if mask & 1 << 27:
        values.update(s.gps)
    return Navdata(s.state, sequence, _tags(mask), **values)  # type: ignore[arg-type]


def further_fields(s: Situation) -> Mapping[str, float]:
    """Return the fields that the service does not read, for `encode`."""
    readings, stick, echo = s.readings, s.stick, s.readings.ultrasound_m
    x, y, z = readings.f_body
    roll, pitch, yaw = s.shot.rpy_rad
    vx, vy = (1e3 * v for v in readings.v_level_m_s)
    tilt = s.limits.euler_angle_max_rad if stick.progressive else 0.0
    values: dict[str, float] = {
        "vbat_raw_mv": round(10_772 + 1_828 * readings.battery_fraction),
        "flag_echo_ini": 1,
        "alt_temp_raw_mm": 0 if echo is None else round(1e3 * echo),
        "accs_temp_c": readings.temperature_c,
        "theta_a_mdeg": _mdeg(math.atan2(x, math.hypot(y, z))),
        "phi_a_mdeg": _mdeg(math.atan2(-y, -z)),
        "ref_theta": round(_mdeg(stick.pitch * tilt)),
        "ref_phi": round(_mdeg(stick.roll * tilt)),
        "ref_yaw": round(_mdeg(stick.yaw * s.limits.yaw_rate_max_rad_s)) if stick.progressive else 0,
        "altitude_vision_mm": round(1e3 * s.altitude_m),
        "obs_alt": s.altitude_m,
        "est_vx": vx,
        "est_vy": vy,
        "vision_state": 2,
        "theta_capture_rad": pitch,
        "phi_capture_rad": roll,
        "psi_capture_rad": yaw,
        "altitude_capture_mm": round(1e3 * s.shot.altitude_m),
        "time_capture_ms": s.shot.time_ms,
        "body_vx": vx,
        "body_vy": vy,
        "watchdog": s.ticks % 2**31,
        "frame_size": s.shot.bytes_sent,
        "frame_number": s.shot.number,
        "out_bitrate": s.shot.bitrate_kbps,
        "desired_bitrate": s.shot.bitrate_kbps,
        "offset_pressure_pa": float(readings.pressure_pa),
        "est_z": 1e3 * s.altitude_m,
        "recorder_frame_number": s.shot.number,
        "gps_state": s.gps["gps_plugged"],
    }
    for axis, f_m_s2 in zip("xyz", (x, -y, -z), strict=True):
        values[f"raw_a{axis}"] = _clip(2048 + 0.512 * (1e3 * f_m_s2 / G_M_S2), 0, 4095)
    for axis, w_rad_s in zip("xyz", readings.w_body, strict=True):
        values[f"raw_w{axis}"] = _clip(math.degrees(w_rad_s) * 16.4, -(2**15), 2**15 - 1)
    for n, pwm in enumerate(readings.motors_pwm, 1):
        values[f"motor_{n}"], values[f"sat_motor_{n}"] = _clip(pwm, 0, 255), 255
    if readings.magnetometer is not None:
        field_mg = [v / TESLA_PER_MILLIGAUSS for v in readings.magnetometer]
        for axis, mg in zip("xyz", field_mg, strict=True):
            values[f"m{axis}"] = _clip(mg / MILLIGAUSS_PER_COUNT, -(2**15), 2**15 - 1)
            values[f"magneto_raw_{axis}"] = values[f"magneto_rectified_{axis}"] = mg
        for name in ("heading_unwrapped_deg", "heading_gyro_unwrapped_deg", "heading_fusion_unwrapped_deg"):
            values[name] = math.degrees(readings.rpy_rad[2])
        values.update(calibration_ok=1, magneto_state=2, radius=math.hypot(*field_mg))
    return values


def upright_m(slant_m: float, rpy_rad: tuple[float, float, float]) -> float:
    """Height over a level ground from a range along the body's down axis."""
    return slant_m * math.cos(rpy_rad[0]) * math.cos(rpy_rad[1])


def _mdeg(angle_rad: float) -> float:
    return math.degrees(angle_rad) * 1e3


def _clip(value: float, low: int, high: int) -> int:
    return min(high, max(low, round(value)))
