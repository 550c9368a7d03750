"""Corrupted signals of a scenario, in the datagrams of an autopilot on their way to the service.

The autopilot itself goes on with the right ones, as a vehicle's own loops do behind the sockets of an AR.Drone.
"""

import copy
import math
from collections.abc import Callable, Mapping

from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from estimator.contracts.geometry import Rotation
from estimator.contracts.motion import G_M_S2
from estimator.contracts.time import Clock
from sitl.faults.carried import TELEMETRY
from sitl.faults.fault import Corruptions, Signal

_M_S2_PER_MG = 1e-3 * G_M_S2
_INT16, _UINT16 = 32_767, 65_535


class CorruptedTelemetry:
    """Changes datagrams of an autopilot. One call for each, in order of time.

    Args:
        corruptions: what is wrong now.
        clock: orders the samples.
    """

    def __init__(self, corruptions: Corruptions, clock: Clock) -> None:
        self._corruptions, self._clock = corruptions, clock
        self._any = bool(corruptions.signals & TELEMETRY)
        self._codec, self._packer = Codec(0, 0, datagrams=True), mav.MAVLink(None)
        self._yaw_rad = 0.0
        self._handlers: Mapping[str, Callable[[Message], None]] = {
            "ATTITUDE_QUATERNION": self._attitude,
            "LOCAL_POSITION_NED": self._velocity,
            "RAW_IMU": self._raw_imu,
            "HIGHRES_IMU": self._highres_imu,
            "DISTANCE_SENSOR": self._range,
        }

    def __call__(self, data: bytes) -> bytes:
        """Return a datagram with the corruption of its signals."""
        if not self._any:
            return data
        return b"".join(self._packed(message) for message in self._codec.feed(data))

    def corrupted(self, m: Message) -> Message:
        """Return a message with the corruption of its signals, and leave the given one as it is."""
        change = self._handlers.get(m.get_type()) if self._any else None
        if change is not None:
            m = copy.copy(m)
            change(m)
        return m

    def _packed(self, m: Message) -> bytes:
        if self._handlers.get(m.get_type()) is None:
            return bytes(m.get_msgbuf())
        m = self.corrupted(m)
        self._packer.srcSystem, self._packer.srcComponent = m.get_srcSystem(), m.get_srcComponent()
        self._packer.seq = m.get_seq()
        return bytes(m.pack(self._packer))

    def _of(self, signal: Signal, *true: float) -> tuple[float, ...]:
        return self._corruptions.of(signal, true, self._clock.now())

    def _attitude(self, m: Message) -> None:
        roll, pitch, yaw = Rotation.from_quat((m.q1, m.q2, m.q3, m.q4)).rpy_rad
        self._yaw_rad = yaw
        roll, pitch = self._of("attitude", roll, pitch)
        (yaw,) = self._of("heading", yaw)
        m.q1, m.q2, m.q3, m.q4 = Rotation.from_rpy(roll, pitch, yaw).quat_wxyz

    def _velocity(self, m: Message) -> None:
        c, s = math.cos(self._yaw_rad), math.sin(self._yaw_rad)
        forward, right = self._of("velocity", c * m.vx + s * m.vy, c * m.vy - s * m.vx)
        m.vx, m.vy = c * forward - s * right, s * forward + c * right

    def _raw_imu(self, m: Message) -> None:
        f = self._of("accelerometer", *(_M_S2_PER_MG * a for a in (m.xacc, m.yacc, m.zacc)))
        w = self._of("gyro", *(1e-3 * rate for rate in (m.xgyro, m.ygyro, m.zgyro)))
        m.xacc, m.yacc, m.zacc = (_whole(value / _M_S2_PER_MG) for value in f)
        m.xgyro, m.ygyro, m.zgyro = (_whole(1e3 * value) for value in w)

    def _highres_imu(self, m: Message) -> None:
        m.xacc, m.yacc, m.zacc = self._of("accelerometer", m.xacc, m.yacc, m.zacc)
        m.xgyro, m.ygyro, m.zgyro = self._of("gyro", m.xgyro, m.ygyro, m.zgyro)

    def _range(self, m: Message) -> None:
        (range_m,) = self._of("range", 0.01 * m.current_distance)
        m.current_distance = min(max(round(100.0 * range_m), 0), _UINT16)


def _whole(value: float) -> int:
    return min(max(round(value), -_INT16), _INT16)
