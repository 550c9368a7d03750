"""Autopilot messages to samples in SI units and aerospace axes. No I/O; nothing on the wire raises.

An autopilot's own frames are ours: body forward-right-down, local north-east-down. What a message does not measure is left out
(`drivers.mavlink.fields`), its parts are judged apart, and of several sensors that measure the same, one is used all the time.

Gyro and accelerometer are older than their stamps: ArduPilot's RAW_IMU has passed a low-pass filter, a Butterworth one of the
second order, and is stamped as it is sent; PX4's HIGHRES_IMU is the mean over an interval, stamped at its end. Attitude and
velocity are late in neither. A filter that fuses both as they are stamped takes the difference for a camera that is slow.

Sources: ArduPilot, LowPassFilter2p and the parameters INS_GYRO_FILTER and INS_ACCEL_FILTER, equal by default; PX4,
HIGHRES_IMU.hpp and the parameter IMU_INTEG_RATE.
"""

import math
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from msgspec import Struct

from drivers.clock_map import ClockMap, ClockMapOptions
from drivers.mavlink.boot_clock import MS_WRAP_NS, BootClock, boot_ms, boot_us
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.failsafe import FailsafeWatch
from drivers.mavlink.fields import measured
from drivers.mavlink.vehicle import ARMED, Condition, Stack, flying_of, mode_name
from drivers.one_source import SILENT_S, SourceChoice
from estimator.contracts import samples as contract
from estimator.contracts.geometry import F64, GeoPoint, Rotation, fixed_matrix, fixed_vector, height_of_pressure_m
from estimator.contracts.motion import G_M_S2
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, GeoFix, Imu, Range, Sample, VehicleStatus, VesselReport
from estimator.contracts.time import NS_PER_S, MonoNs, Stamp, seconds_between

_SIGMA_TILT_RAD = math.radians(0.5)  # standard deviation of roll and pitch
_SIGMA_YAW_RAD = math.radians(3.0)  # standard deviation of the heading
_SIGMA_VELOCITY_M_S = 0.1  # standard deviation of each axis of the velocity
_SIGMA_RANGE_M = 0.03  # standard deviation of the rangefinder if its messages do not give it
_SIGMA_BARO_M = 0.5  # standard deviation of the barometer
_SIGMA_FIX_M = 2.0  # standard deviation of the autopilot's place on the Earth, on each horizontal axis
_SIGMA_VESSEL_FIX_M = 2.5  # standard deviation of the place that the ship reports, unless she claims a larger one
_SIGMA_VESSEL_VELOCITY_M_S = 0.2  # standard deviation of each axis of the velocity that the ship reports
_SIGMA_VESSEL_HEADING_RAD = math.radians(3.0)  # standard deviation of the heading that the ship reports
_STATUS_PERIOD_S = 0.5  # interval at which an unchanged status is repeated
_ATTITUDE_GAP_S = 0.2  # largest time between a velocity and the newest attitude; other velocities are not used
DOWN = 25
"""MAV_SENSOR_ROTATION_PITCH_270: looking down."""
_ACC_AND_GYRO = 0b111111  # bits of HIGHRES_IMU's fields_updated for the six inertial values
_PRESSURE = 1 << 9  # bit of HIGHRES_IMU's fields_updated for the absolute pressure
_HEADING_MAX_CDEG = 36_000  # largest heading, hundredths of a degree
_ANGLE_MAX_RAD = 4.0 * math.pi  # limit of roll and pitch
_YAW_MAX_RAD = 1000.0 * math.pi  # limit of a yaw, which may count turns
_TURN_MAX_RAD_S = 100.0  # rate beyond what a multicopter's gyros can measure: 4,000 degrees/s is the widest range there is
_FORCE_MAX_M_S2 = 400.0  # specific force beyond what its accelerometers can measure: 32 g is the widest range there is
_RESTART_NS = NS_PER_S
"""A stamp that is this much older than the newest is that of an autopilot that has booted, as `BootClock` has it."""
_AGES_S = {"HEARTBEAT": 5.0, "EXTENDED_SYS_STATE": 5.0, "SYS_STATUS": 15.0}
"""Ages beyond which the parts of the vehicle's condition are unknown again, by the message that they come from: several of its
intervals, and longer than a link usually stands still."""
_LANDED_S = 0.5
"""Time for which an armed vehicle that flew must report that it stands: a detector is wrong for a moment in a still hover."""
_LANDED_STATE_WITHIN_S = 3.0
"""Time from the first heartbeat: every PX4 sends EXTENDED_SYS_STATE by then, also over a slow link."""
_SHIP_CLOCK = ClockMapOptions(resolution_s=0.001, floor_sigma_s=0.05, window_s=600.0, jump_s=5.0, name="the ship")
"""The ship's clock over a radio link. The window is long, so that a link that becomes slow is reported as late reports."""
_HAS_PLACE = 1 << 0  # bit of FOLLOW_TARGET's est_capabilities
_HAS_VELOCITY = 1 << 1  # bit of FOLLOW_TARGET's est_capabilities
_PLACE_MAX_M = 1e6  # distances from the origin beyond this are damaged
_SPEED_MAX_M_S = 150.0  # speeds beyond this are damaged
_PRESSURE_HPA = (100.0, 1200.0)
_M_S2_PER_MG = 1e-3 * G_M_S2  # factor from thousandths of g to m/s^2

_CUTOFF_HZ, _INTERVALS_HZ = "INS_GYRO_FILTER", "IMU_INTEG_RATE"
_JERKS_M_S3 = ("PSC_JERK_XY", "PSC_JERK_NE", "Q_P_JERK_XY")
_TILTS_DEG = {
    Stack.ARDUPILOT: {"ANGLE_MAX": 0.01, "ATC_ANGLE_MAX": 1.0, "PSC_ANGLE_MAX": 1.0},
    Stack.PLANE: {"Q_ANGLE_MAX": 0.01},
    Stack.PX4: {"MPC_TILTMAX_AIR": 1.0},
}
"""Parameters that limit the tilt, each with its unit in degrees; the least limit is flown."""
SAMPLE_PARAMETERS: dict[Stack, tuple[str, ...]] = {
    Stack.ARDUPILOT: (_CUTOFF_HZ, *_JERKS_M_S3, *_TILTS_DEG[Stack.ARDUPILOT]),
    Stack.PLANE: (_CUTOFF_HZ, _JERKS_M_S3[-1], *_TILTS_DEG[Stack.PLANE]),
    Stack.PX4: (_INTERVALS_HZ, *_TILTS_DEG[Stack.PX4]),
}
"""Parameters that samples depend on, by stack; the first one is that of the inertial delay."""
_MOST_S = 0.05
"""Longest delay that is accepted: a cutoff of 4.5 Hz, with which nothing flies."""


def inertial_delay_s(stack: Stack, values: Mapping[str, float]) -> float:
    """Return the delay of gyro and accelerometer, s; 0 while the parameter is not known, and where it switches the filter off.

    A Butterworth filter of the second order has a group delay of sqrt(2) / (2 pi cutoff) far below its cutoff.
    """
    name = SAMPLE_PARAMETERS.get(stack, ("",))[0]
    rate_hz = values.get(name, 0.0)
    if not rate_hz > 0.0:
        return 0.0
    return min(_MOST_S, (math.sqrt(2.0) / math.tau if name == _CUTOFF_HZ else 0.5) / rate_hz)


def jerk_max_m_s3(values: Mapping[str, float]) -> float | None:
    """Return the largest rate at which the autopilot changes its acceleration along the ground; None while it is not known."""
    found = [values[name] for name in _JERKS_M_S3 if values.get(name, 0.0) > 0.0]
    return found[0] if found else None


def tilt_max_deg(stack: Stack, values: Mapping[str, float]) -> float | None:
    """Return the largest tilt that the autopilot flies; None while it is not known."""
    limits = _TILTS_DEG.get(stack, {})
    return min((unit * values[name] for name, unit in limits.items() if values.get(name, 0.0) > 0.0), default=None)


class LocalPosition(Struct, frozen=True, eq=False):
    """The autopilot's estimate of its position, from the origin of its own filter (not from home)."""

    stamp: Stamp
    p_body_ned: F64
    """(3,) m."""
    v_body_ned: F64
    """(3,) m/s."""


class MavlinkSampler:
    """Messages of one autopilot (and of the vessel, where it reports) to samples.

    Args:
        ranges: hand on DISTANCE_SENSOR; off where the autopilot only echoes what we sent it.
        tell: takes a line about a sensor that is used or not used beside another.
    """

    def __init__(
        self,
        stack: Stack,
        clock: BootClock,
        *,
        ranges: bool = True,
        tell: Callable[[str], None] = lambda text: None,
    ) -> None:
        self._stack = stack
        self._clock = clock
        tilt_var, yaw_var, velocity_var = (s**2 for s in (_SIGMA_TILT_RAD, _SIGMA_YAW_RAD, _SIGMA_VELOCITY_M_S))
        self._cov_attitude = fixed_matrix(tilt_var, 0.0, 0.0, 0.0, tilt_var, 0.0, 0.0, 0.0, yaw_var)
        self._cov_velocity = fixed_matrix(velocity_var, 0.0, 0.0, 0.0, velocity_var, 0.0, 0.0, 0.0, velocity_var)
        self.ranges = ranges
        self._tell, self._choice = tell, SourceChoice()
        self._used: dict[str, str] = {}
        """The chosen sensor by quantity."""
        self._unused: set[tuple[str, str]] = set()
        self.inertial_delay_s = 0.0
        """The time by which gyro and accelerometer are older than the stamps of their messages."""
        self.jerk_max_m_s3: float | None = None
        """Its limit of the jerk, as the status hands it on; None while it is not known."""
        self.tilt_max_deg: float | None = None
        """Its limit of the tilt, likewise."""
        self.condition = Condition()
        self.taken: str | None = None
        """Holder of the vehicle if it was taken from this program, for the vehicle's status; None otherwise."""
        self.others_at: MonoNs | None = None
        """Newest report in which somebody else chose for the vehicle, likewise."""
        self.failsafes = FailsafeWatch()
        self.motors_cut = False
        """True if a person cut the motors by this program and it has reported that, likewise."""
        self.attitude: Attitude | None = None
        """The newest attitude sample."""
        self.positions: deque[LocalPosition] = deque(maxlen=64)
        """The newest local positions, oldest first."""
        self.refused: Counter[str] = Counter()
        """Messages that made no sense, whole or in part, by name."""
        self.out_of_order: Counter[str] = Counter()
        """Messages that a newer one overtook on the way, or that came twice, by name."""
        self._newest: dict[tuple[str, int], tuple[int, bytes]] = {}
        """The newest message of each kind and sensor: its stamp since boot, ns, and its bytes."""
        self._landed_state = 0
        self._landed_since: MonoNs | None = None
        self._ages: dict[str, MonoNs] = {}
        """Arrival of the newest message by name, of those that the condition comes from."""
        self._first_heartbeat: MonoNs | None = None
        self._quaternion_at: MonoNs | None = None
        self._status_at: MonoNs | None = None
        self._vessel_clock = ClockMap(replace(_SHIP_CLOCK, wrap_ns=MS_WRAP_NS))
        self._follow_clock = ClockMap(_SHIP_CLOCK)
        self._table: dict[str, Callable[[Message, MonoNs], list[Sample]]] = {
            "HEARTBEAT": self._heartbeat,
            "EXTENDED_SYS_STATE": self._extended,
            "SYS_STATUS": self._sys_status,
            "ATTITUDE_QUATERNION": self._attitude,
            "ATTITUDE": self._attitude_angles,
            "LOCAL_POSITION_NED": self._position,
            "GLOBAL_POSITION_INT": self._global,
            "RAW_IMU": self._raw_imu,
            "HIGHRES_IMU": self._highres_imu,
            "FENCE_STATUS": self._fence,
            "EVENT": self._event,
            "DISTANCE_SENSOR": self._distance,
            "SCALED_PRESSURE": self._pressure,
        }

    def samples(self, message: Message, received_at: MonoNs) -> list[Sample]:
        """Every sample in one message of the autopilot."""
        name = message.get_type()
        handle = self._table.get(name)
        if handle is None:
            return []
        key, place = (name, getattr(message, "id", 0)), _place_in_order(message)
        if _overtaken(place, self._newest.get(key)):
            self.out_of_order[name] += 1
            return []
        if name in _AGES_S:
            self._ages[name] = received_at
        try:
            out = handle(message, received_at)
            self._newest[key] = place
            return out
        except ValueError:  # the contracts refuse what is not finite or not possible
            self.refused[name] += 1
            return []

    def vessel(self, message: Message, received_at: MonoNs) -> list[Sample]:
        """GLOBAL_POSITION_INT or FOLLOW_TARGET of the ship's own system."""
        name = message.get_type()
        if name not in ("GLOBAL_POSITION_INT", "FOLLOW_TARGET"):
            return []
        try:
            return self._vessel_position(message, received_at) if name[0] == "G" else self._follow_target(message, received_at)
        except ValueError:
            self.refused[name] += 1
            return []

    def _vessel_position(self, message: Message, received_at: MonoNs) -> list[Sample]:
        place, v_ned, heading_rad = self._parts(
            message, lambda: _place(message, 1e-3 * message.alt), lambda: _cm_s(message), lambda: _heading(message)
        )
        source = _of_component(message)
        if heading_rad is not None and not self._takes("ship's heading", source, received_at):
            heading_rad = None
        if not self._takes_way(place, v_ned, source, received_at):
            place = v_ned = None
        if place is None and v_ned is None and heading_rad is None:
            return []
        stamp = self._vessel_clock.stamp(boot_ms(message.time_boot_ms), received_at)
        return self._of_vessel(stamp, place, _SIGMA_VESSEL_FIX_M, v_ned, heading_rad)

    def _follow_target(self, m: Message, received_at: MonoNs) -> list[Sample]:
        """Take the ship's place from a ground station or a beacon on board; its covariances count if they are larger."""
        place, v_ned = self._parts(
            m,
            lambda: _place(m, m.alt) if m.est_capabilities & _HAS_PLACE else None,
            lambda: _within(_SPEED_MAX_M_S, *m.vel) if m.est_capabilities & _HAS_VELOCITY else None,
        )
        if not self._takes_way(place, v_ned, _of_component(m), received_at):
            return []
        claimed_m = m.position_cov[0] if math.isfinite(m.position_cov[0]) else 0.0
        stamp = self._follow_clock.stamp(m.timestamp * 1_000_000, received_at)
        return self._of_vessel(stamp, place, max(claimed_m, _SIGMA_VESSEL_FIX_M), v_ned, None)

    def _of_vessel(
        self, stamp: Stamp, place: GeoPoint | None, sigma_m: float, v_ned: F64 | None, heading_rad: float | None
    ) -> list[Sample]:
        out: list[Sample] = [] if place is None else [GeoFix(stamp, "vessel", place, sigma_m, v_ned)]
        if v_ned is not None or heading_rad is not None:
            cov = None if v_ned is None else np.eye(3) * _SIGMA_VESSEL_VELOCITY_M_S**2
            sigma_rad = None if heading_rad is None else _SIGMA_VESSEL_HEADING_RAD
            out.append(VesselReport(stamp, v_ned, cov, heading_rad, sigma_rad))
        return out

    def _parts(self, m: Message, *makes: Callable[[], Any]) -> list[Any]:
        """Return what each part of a message says, None for a part that cannot be; one bad field costs its own part alone.

        Raises:
            ValueError: no part can be.
        """
        made, wrong = list[Any](), 0
        for make in makes:
            try:
                made.append(make())
            except ValueError:
                made.append(None)
                wrong += 1
        if wrong == len(makes):
            raise ValueError("no part of it can be")
        if wrong:
            self.refused[m.get_type()] += 1
        return made

    def _takes_way(self, place: GeoPoint | None, v_ned: F64 | None, source: str, received_at: MonoNs) -> bool:
        """Return whether a component's report of the ship's way is used: of several, one that knows the place."""
        reports = place is not None or v_ned is not None
        return reports and self._takes("ship's way", source, received_at, 2.0 if place is None else 1.0)

    def _takes(self, quantity: str, source: str, received_at: MonoNs, sigma: float = 1.0) -> bool:
        """Return whether a sensor, or another source, is the one that is used; report a change, and each other one."""
        used, takes = self._used.get(quantity), self._choice.takes(quantity, source, sigma, received_at)
        if takes and used != source:
            self._used[quantity] = source
            if used is not None:
                self._tell(f"the {quantity} is that of {source} from now on, not of {used}")
        elif not takes and (quantity, source) not in self._unused:
            self._unused.add((quantity, source))
            self._tell(f"the {quantity} is that of {used}; that of {source} is not used beside it")
        return takes

    def status(self, now: MonoNs, *, link_ok: bool) -> VehicleStatus:
        """Return the newest condition as a sample."""
        c = self.condition
        if not self._fresh("HEARTBEAT", now):
            c = replace(c, mode=Condition().mode, flying=c.flying if self._fresh("EXTENDED_SYS_STATE", now) else None)
        if not self._fresh("SYS_STATUS", now):
            c = replace(c, battery_fraction=None)
        self._status_at = now
        stamp = Stamp(now, now, 0.0, "arrival")
        return VehicleStatus(
            stamp, c.flying, c.mode, c.battery_fraction, c.terminated or self.motors_cut, link_ok, self.taken,
            self.jerk_max_m_s3, self.tilt_max_deg, self.others_at,
        )  # fmt: skip

    def _fresh(self, name: str, now: MonoNs) -> bool:
        """Return whether the newest message of this name is young enough that what it says still holds."""
        return name in self._ages and seconds_between(self._ages[name], now) <= _AGES_S[name]

    def _status_samples(self, condition: Condition, received_at: MonoNs) -> list[Sample]:
        changed = condition != self.condition
        self.condition = condition
        due = self._status_at is None or seconds_between(self._status_at, received_at) >= _STATUS_PERIOD_S
        return [self.status(received_at, link_ok=True)] if changed or due else []

    def _heartbeat(self, m: Message, received_at: MonoNs) -> list[Sample]:
        armed = bool(m.base_mode & ARMED)
        self.failsafes.on_heartbeat(m, received_at)
        if not self._fresh("EXTENDED_SYS_STATE", received_at):
            self._landed_state = 0
        if self._first_heartbeat is None:
            self._first_heartbeat = received_at
        flying = self._lasting(flying_of(self._landed_state, m.system_status, armed), armed, received_at)
        awaited = self._landed_state == 0 and seconds_between(self._first_heartbeat, received_at) < _LANDED_STATE_WITHIN_S
        if flying and self._stack is Stack.PX4 and awaited:
            # PX4 is active as soon as it is armed. One that stood on the deck would be taken for one that has come down there.
            flying = None
        condition = replace(
            self.condition,
            mode=mode_name(self._stack, m.custom_mode),
            armed=armed,
            flying=flying,
            terminated=m.system_status == mav.MAV_STATE_FLIGHT_TERMINATION,
            failsafe=self.failsafes.now,
        )
        return self._status_samples(condition, received_at)

    def _extended(self, m: Message, received_at: MonoNs) -> list[Sample]:
        self._landed_state = m.landed_state
        flying = flying_of(m.landed_state, mav.MAV_STATE_UNINIT, bool(self.condition.armed))
        if m.landed_state == 0:
            flying = self.condition.flying
        flying = self._lasting(flying, bool(self.condition.armed), received_at)
        taking_off = m.landed_state == mav.MAV_LANDED_STATE_TAKEOFF
        return self._status_samples(replace(self.condition, flying=flying, taking_off=taking_off), received_at)

    def _lasting(self, flying: bool | None, armed: bool, at: MonoNs) -> bool | None:
        """Return whether it flies, where a report that it stands must last."""
        if flying is not False:
            self._landed_since = None
            return flying
        self._landed_since = self._landed_since or at
        lasts = seconds_between(self._landed_since, at) >= _LANDED_S
        return bool(armed and self.condition.flying and not lasts)

    def on_text(self, text: str, received_at: MonoNs) -> None:
        """Take a whole STATUSTEXT of the autopilot, which may name a failsafe."""
        self.failsafes.on_text(text, received_at)
        self.condition = replace(self.condition, failsafe=self.failsafes.now)

    def _fence(self, m: Message, received_at: MonoNs) -> list[Sample]:
        self.failsafes.on_fence(m, received_at)
        return self._status_samples(replace(self.condition, failsafe=self.failsafes.now), received_at)

    def _event(self, m: Message, received_at: MonoNs) -> list[Sample]:
        self.failsafes.on_event(m, received_at)
        return self._status_samples(replace(self.condition, failsafe=self.failsafes.now), received_at)

    def _sys_status(self, m: Message, received_at: MonoNs) -> list[Sample]:
        percent, volts = measured(m, "battery_remaining"), measured(m, "voltage_battery")
        # 0 % of a battery without a voltage comes from an autopilot that measures none.
        known = percent is not None and percent >= 0 and (percent > 0 or volts is not None)
        share = min(1.0, percent / 100.0) if known and percent is not None else None
        self.condition = replace(self.condition, battery_fraction=share)
        return []

    def _attitude(self, m: Message, received_at: MonoNs) -> list[Sample]:
        rotation = Rotation.from_quat([m.q1, m.q2, m.q3, m.q4])
        self._quaternion_at = received_at
        return self._to_level(m, rotation, received_at)

    def _attitude_angles(self, m: Message, received_at: MonoNs) -> list[Sample]:
        if self._quaternion_at is not None and seconds_between(self._quaternion_at, received_at) <= SILENT_S:
            return []  # the same once more
        return self._to_level(
            m, Rotation.from_rpy(*_within(_ANGLE_MAX_RAD, m.roll, m.pitch), *_within(_YAW_MAX_RAD, m.yaw)), received_at
        )

    def _to_level(self, m: Message, rotation: Rotation, received_at: MonoNs) -> list[Sample]:
        stamp = self._clock.stamp(boot_ms(m.time_boot_ms), received_at)
        self.attitude = contract.known(Attitude, stamp, rotation, self._cov_attitude)
        return [self.attitude]

    def _position(self, m: Message, received_at: MonoNs) -> list[Sample]:
        p_body_ned, v_body_ned = self._parts(
            m, lambda: _within(_PLACE_MAX_M, m.x, m.y, m.z), lambda: _within(_SPEED_MAX_M_S, m.vx, m.vy, m.vz)
        )
        if v_body_ned is None:
            return []
        stamp = self._clock.stamp(boot_ms(m.time_boot_ms), received_at)
        if p_body_ned is not None:
            self.positions.append(LocalPosition(stamp, p_body_ned, v_body_ned))
        attitude = self.attitude
        if attitude is None or abs(seconds_between(attitude.stamp.measured_at, stamp.measured_at)) > _ATTITUDE_GAP_S:
            return []
        yaw_rad = attitude.R_ned_body.rpy_rad[2]
        c, s = math.cos(yaw_rad), math.sin(yaw_rad)
        v_level = fixed_vector(c * m.vx + s * m.vy, c * m.vy - s * m.vx, m.vz)
        return [contract.known(BodyVelocity, stamp, v_level, self._cov_velocity)]

    def _global(self, m: Message, received_at: MonoNs) -> list[Sample]:
        place, v_ned = self._parts(m, lambda: _place(m, 1e-3 * m.alt), lambda: _cm_s(m))
        if place is None:
            return []
        return [GeoFix(self._clock.stamp(boot_ms(m.time_boot_ms), received_at), "vehicle", place, _SIGMA_FIX_M, v_ned)]

    def _raw_imu(self, m: Message, received_at: MonoNs) -> list[Sample]:
        if not self._stack.is_ardupilot:
            # Only there is "raw" known to mean milli-g and mrad/s in body axes.
            return []
        if not _inertial_measured(m) or not self._takes("IMU", _sensor(m), received_at):
            return []
        f_body = fixed_vector(m.xacc * _M_S2_PER_MG, m.yacc * _M_S2_PER_MG, m.zacc * _M_S2_PER_MG)
        w_body = fixed_vector(m.xgyro * 1e-3, m.ygyro * 1e-3, m.zgyro * 1e-3)
        return [contract.known(Imu, self._inertial(self._clock.stamp(boot_us(m.time_usec), received_at)), w_body, f_body)]

    def _inertial(self, stamp: Stamp) -> Stamp:
        if self.inertial_delay_s == 0.0:
            return stamp
        earlier = MonoNs(stamp.measured_at - round(self.inertial_delay_s * NS_PER_S))
        return Stamp(earlier, stamp.received_at, stamp.sigma_s, stamp.source)

    def _highres_imu(self, m: Message, received_at: MonoNs) -> list[Sample]:
        moved = m.fields_updated & _ACC_AND_GYRO == _ACC_AND_GYRO and _inertial_measured(m)
        pressed = bool(m.fields_updated & _PRESSURE) and measured(m, "abs_pressure") is not None
        makes: list[Callable[[], Any]] = []
        if moved:
            makes.append(
                lambda: (_within(_TURN_MAX_RAD_S, m.xgyro, m.ygyro, m.zgyro), _within(_FORCE_MAX_M_S2, m.xacc, m.yacc, m.zacc))
            )
        if pressed:
            makes.append(lambda: _height_m(m.abs_pressure))
        if not makes:
            return []
        made = self._parts(m, *makes)
        stamp = self._clock.stamp(boot_us(m.time_usec), received_at)
        out: list[Sample] = []
        # RAW_IMU, which is requested of ArduPilot, comes faster.
        if moved and made[0] is not None and self._takes("IMU", _sensor(m), received_at, 2.0):
            out.append(contract.known(Imu, self._inertial(stamp), *made[0]))
        if pressed and made[-1] is not None and self._takes("pressure", _sensor(m), received_at):
            out.append(Baro(stamp, made[-1], _SIGMA_BARO_M))
        return out

    def _distance(self, m: Message, received_at: MonoNs) -> list[Sample]:
        # At its own limits a sensor reports that it sees nothing, or something nearer or farther than it can measure.
        cm = measured(m, "current_distance")
        usable = cm is not None and m.min_distance < cm < m.max_distance and measured(m, "signal_quality") is not None
        if not self.ranges or m.orientation != DOWN or not usable or not self._takes("range", _sensor(m), received_at):
            return []
        covariance = measured(m, "covariance")
        sigma_m = _SIGMA_RANGE_M if covariance is None else 0.01 * math.sqrt(covariance)
        return [Range(self._clock.stamp(boot_ms(m.time_boot_ms), received_at), 0.01 * m.current_distance, max(sigma_m, 0.005))]

    def _pressure(self, m: Message, received_at: MonoNs) -> list[Sample]:
        if measured(m, "press_abs") is None:
            return []
        height_m = _height_m(m.press_abs)
        if not self._takes("pressure", _sensor(m), received_at):
            return []
        return [Baro(self._clock.stamp(boot_ms(m.time_boot_ms), received_at), height_m, _SIGMA_BARO_M)]


def _place_in_order(m: Message) -> tuple[int, bytes]:
    """Return a message's stamp since boot, ns, 0 where it has none, and the bytes that came, none where it came by no wire."""
    boot_ns = 1_000_000 * m.time_boot_ms if hasattr(m, "time_boot_ms") else 1_000 * getattr(m, "time_usec", 0)
    return boot_ns, bytes(m.get_msgbuf() or b"")


def _overtaken(place: tuple[int, bytes], newest: tuple[int, bytes] | None) -> bool:
    """Return whether a newer message, or the very same one, came before; an autopilot that has booted starts again."""
    if newest is None or place[0] == 0:
        return False
    return newest[0] - _RESTART_NS < place[0] < newest[0] or (place == newest and place[1] != b"")


def _place(m: Message, height_m: float) -> GeoPoint | None:
    """Return the place in a message; None where it has none.

    Raises:
        ValueError: there is no such place.
    """
    lat, lon = measured(m, "lat"), measured(m, "lon")
    if lat is None or lon is None or (lat == 0 and lon == 0):  # autopilots without a fix are at 0 N 0 E
        return None
    return GeoPoint.reported(1e-7 * lat, 1e-7 * lon, height_m)


def _sensor(m: Message) -> str:
    """Return the name of the sensor that a message is of."""
    return f"{m.get_type()} {m.id}" if "id" in m.fieldnames else str(m.get_type())


def _of_component(m: Message) -> str:
    return f"{m.get_type()} of component {m.get_srcComponent()}"


def _cm_s(m: Message) -> F64 | None:
    """Return the velocity in a GLOBAL_POSITION_INT, (3,) m/s in ned; None where it has none, as at 0 N 0 E at rest.

    Raises:
        ValueError: nothing moves like that.
    """
    v = [measured(m, name) for name in ("vx", "vy", "vz")]
    known = [0.01 * one for one in v if one is not None]
    nowhere = not any((m.lat, m.lon, *known))
    return None if nowhere or len(known) < len(v) else _within(_SPEED_MAX_M_S, *known)


def _heading(m: Message) -> float | None:
    """Return the bow's heading in a GLOBAL_POSITION_INT, rad; None where it has none.

    Raises:
        ValueError: there is no such heading.
    """
    hdg = measured(m, "hdg")
    if hdg is not None and hdg > _HEADING_MAX_CDEG:
        raise ValueError("no heading")
    return None if hdg is None else math.radians(0.01 * hdg)


def _inertial_measured(m: Message) -> bool:
    """Return whether a message has all of gyro and accelerometer. Six zeros are those of a sensor that is not there."""
    values = [measured(m, name) for name in ("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro")]
    return None not in values and any(values)


def _height_m(pressure_hpa: float) -> float:
    """Return the height by a pressure, m.

    Raises:
        ValueError: no air has such a pressure.
    """
    if not _PRESSURE_HPA[0] <= pressure_hpa <= _PRESSURE_HPA[1]:
        raise ValueError("pressure")
    return height_of_pressure_m(100.0 * pressure_hpa)


def _within(limit: float, *values: float) -> F64:
    """Return the values as an array.

    Raises:
        ValueError: one is not finite, or larger than the limit: no sensor can have measured it.
    """
    for value in values:
        if not abs(value) <= limit:
            raise ValueError("out of range")
    return fixed_vector(*values) if len(values) == 3 else np.array(values, dtype=float)
