"""Faults of a vehicle's sensors and commands, in the datagrams between an autopilot and the service.

The autopilot itself goes on with the right readings, as a vehicle's own loops do behind the sockets of an AR.Drone. A program
shares the sensor: its filter estimates an accelerometer's bias up to a limit, beyond which its own velocity errs too.
Source: EK3_ACC_BIAS_LIM, 1 m/s^2 (AP_NavEKF3.cpp); EKF2_ABL_LIM, 0.4 m/s^2 (PX4's EKF/common.h).
"""

import copy
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from estimator.contracts.geometry import F64, GeoPoint, Rotation, moved, ned_between
from estimator.contracts.motion import G_M_S2
from estimator.contracts.time import Clock, seconds_between
from sitl.faults.faulty_streams import FlightFaults
from sitl.faults.readings import FaultyReadings, NavdataMisstamped, ReadingName
from sitl.sensors.sensors import ORIGIN

_M_S2_PER_MG = 1e-3 * G_M_S2
"""Milli-g, the unit of RAW_IMU's accelerations."""
_TESLA_PER_GAUSS = 1e-4
"""Gauss, the unit of magnetic fields; RAW_IMU has a thousandth."""
_PA_PER_HPA = 100.0
"""Hectopascal, the unit of pressures."""
_INT16 = 32_767
"""Largest value of a signed field of two bytes."""
_UINT16 = 65_535
"""Largest value of an unsigned one."""
_FULL_M_S = (-3.0, 3.0, -1.0)
"""Velocity forward, right and down of a full stick that pitches, rolls and climbs, in whose units commands are corrupted: about
that of an AR.Drone at its usual limits."""
_F, _W, _FIELD = ("xacc", "yacc", "zacc"), ("xgyro", "ygyro", "zgyro"), ("xmag", "ymag", "zmag")


class FaultyTelemetry:
    """Changes the messages of an autopilot and those to it. One call for each, in order of time.

    Args:
        faults: what is wrong now.
        seed: of dropped readings and of noise.
        clock: orders the samples.
    """

    def __init__(self, faults: FlightFaults, seed: int, clock: Clock) -> None:
        self._faults, self._corruptions, self._clock = faults, faults.corruptions, clock
        self._readings = FaultyReadings(faults, seed, faults.corruptions)
        others = faults.corruptions.signals & {"gnss", "sample_stamps"}
        self._reports_wrong = bool(self._readings.names or others or faults.listed(NavdataMisstamped))
        self._yaw_rad = 0.0
        self._handlers: Mapping[str, Callable[[Message], None]] = {
            "ATTITUDE_QUATERNION": self._attitude,
            "LOCAL_POSITION_NED": self._velocity,
            "GLOBAL_POSITION_INT": self._place,
            "RAW_IMU": self._raw_imu,
            "HIGHRES_IMU": self._highres_imu,
            "SCALED_PRESSURE": self._pressure,
            "DISTANCE_SENSOR": self._range,
        }

    def reported(self, m: Message) -> Message:
        """Return a message of the vehicle with the faults of its sensors, and leave the given one as it is."""
        change = self._handlers.get(m.get_type()) if self._reports_wrong else None
        if change is None:
            return m
        m = copy.copy(m)
        change(m)
        now = self._clock.now()
        late_s = seconds_between(now, self._readings.stamp(now))
        if hasattr(m, "time_usec"):
            m.time_usec = max(0, m.time_usec + round(1e6 * late_s))
        else:
            m.time_boot_ms = m.time_boot_ms + round(1e3 * late_s) & 0xFFFFFFFF
        return m

    def ordered(self, m: Message) -> Message:
        """Return a message to the vehicle with the corruption of its commands, and leave the given one as it is."""
        errors = {fault.error for fault, _ in self._corruptions.active("commands")}
        if m.get_type() != "SET_POSITION_TARGET_LOCAL_NED" or errors <= {"late", "doubled"}:
            return m
        m = copy.copy(m)
        true = tuple(v / full for v, full in zip((*self._level(m.vx, m.vy), m.vz), _FULL_M_S, strict=True))
        sticks = self._corruptions.of("commands", true, self._clock.now())
        ahead, right, m.vz = (stick * full for stick, full in zip(sticks, _FULL_M_S, strict=True))
        m.vx, m.vy = self._ned(ahead, right)
        return m

    def _level(self, north: float, east: float) -> tuple[float, float]:
        c, s = math.cos(self._yaw_rad), math.sin(self._yaw_rad)
        return c * north + s * east, c * east - s * north

    def _ned(self, ahead: float, right: float) -> tuple[float, float]:
        c, s = math.cos(self._yaw_rad), math.sin(self._yaw_rad)
        return c * ahead - s * right, s * ahead + c * right

    def _of(self, name: ReadingName, true: Sequence[float]) -> tuple[bool, F64 | None]:
        """Return whether a reading is wrong, and the reading in SI units and body axes; None where the sensor says nothing."""
        value = np.array(true)
        wrong = self._readings.of(name, value, self._clock.now())
        return wrong is not value, wrong

    def _put(self, m: Message, name: ReadingName, fields: Sequence[str], unit: float, whole: bool) -> None:
        """Change the fields of a reading, each in multiples of a unit; all are 0 where the sensor says nothing."""
        changed, value = self._of(name, [unit * getattr(m, field) for field in fields])
        if not changed:
            return
        for field, x in zip(fields, np.zeros(len(fields)) if value is None else value, strict=True):
            setattr(m, field, min(max(round(float(x) / unit), -_INT16), _INT16) if whole else float(x) / unit)

    def _attitude(self, m: Message) -> None:
        true = Rotation.from_quat((m.q1, m.q2, m.q3, m.q4)).rpy_rad
        self._yaw_rad, (changed, wrong) = true[2], self._of("rpy_rad", true)
        if changed and wrong is not None:
            m.q1, m.q2, m.q3, m.q4 = Rotation.from_rpy(*wrong.tolist()).quat_wxyz

    def _velocity(self, m: Message) -> None:
        changed, wrong = self._of("v_level_m_s", self._level(m.vx, m.vy))
        if changed and wrong is not None:
            m.vx, m.vy = self._ned(*wrong.tolist())

    def _place(self, m: Message) -> None:
        true = ned_between(ORIGIN, GeoPoint.of_degrees(1e-7 * m.lat, 1e-7 * m.lon, 1e-3 * m.alt))
        x, y, z = true.tolist()
        wrong = self._corruptions.of("gnss", (x, y, z), self._clock.now())
        if wrong != (x, y, z):
            place = moved(ORIGIN, np.array(wrong))
            m.lat, m.lon = (round(1e7 * math.degrees(a)) for a in (place.latitude_rad, place.longitude_rad))
            m.alt = round(1e3 * (place.height_m or 0.0))

    def _raw_imu(self, m: Message) -> None:
        self._put(m, "f_body", _F, _M_S2_PER_MG, whole=True)
        self._put(m, "w_body", _W, 1e-3, whole=True)
        self._put(m, "magnetometer", _FIELD, 1e-3 * _TESLA_PER_GAUSS, whole=True)

    def _highres_imu(self, m: Message) -> None:
        self._put(m, "f_body", _F, 1.0, whole=False)
        self._put(m, "w_body", _W, 1.0, whole=False)
        self._put(m, "magnetometer", _FIELD, _TESLA_PER_GAUSS, whole=False)
        self._put(m, "pressure_pa", ("abs_pressure",), _PA_PER_HPA, whole=False)

    def _pressure(self, m: Message) -> None:
        self._put(m, "pressure_pa", ("press_abs",), _PA_PER_HPA, whole=False)

    def _range(self, m: Message) -> None:
        changed, wrong = self._of("ultrasound_m", (0.01 * m.current_distance,))
        if changed:
            # A sensor without an echo reports its own limit.
            reach_m = 0.01 * m.max_distance if wrong is None else float(wrong[0])
            m.current_distance = min(max(round(100.0 * reach_m), 0), _UINT16)


def in_datagrams(change: Callable[[Message], Message]) -> Callable[[bytes], bytes]:
    """Return what changes the messages of a datagram; one that is not changed passes byte for byte."""
    codec, packer = Codec(0, 0, datagrams=True), mav.MAVLink(None)

    def packed(m: Message) -> bytes:
        changed = change(m)
        if changed is m:
            return bytes(m.get_msgbuf())
        packer.srcSystem, packer.srcComponent, packer.seq = m.get_srcSystem(), m.get_srcComponent(), m.get_seq()
        return bytes(changed.pack(packer))

    return lambda data: b"".join(map(packed, codec.feed(data)))
