"""A stand-in for ArduCopter 4.5: GUIDED with its time limit and its shaping, take-off, LAND on targets, armed on deck for ever.

Sources: ArduPilot's documentation of Copter (GUIDED mode, landing detector, precision landing) and its parameter reference; the
behaviour on a deck was measured on the program itself (docs/ardupilot.md).
"""

import math
from collections.abc import Mapping

import numpy as np

from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import ReceivedMessage
from drivers.mavlink.vehicle import Stack
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.motion import G_M_S2
from estimator.contracts.time import Clock
from sitl.emulators.autopilots.body import BodyState
from sitl.emulators.autopilots.programs import arducopter
from sitl.emulators.autopilots.programs.arducopter import CURVE
from sitl.emulators.autopilots.stand_in.base import IN_AIR, ON_GROUND, STILL, StandIn, toward
from sitl.emulators.autopilots.stand_in.cascade import COPTER_GAINS, Cascade
from sitl.emulators.autopilots.stand_in.tuning import tuned
from sitl.vehicle.airframe import Airframe, ardrone2
from sitl.world.drives import Motors

_ROOT = math.sqrt(2.0)
"""Twice the damping of a Butterworth filter of the second order."""


class LowPass:
    """A Butterworth filter of the second order for vectors, by the bilinear transform.

    Source: Oppenheim, Schafer, Discrete-Time Signal Processing, section 7.2.

    Args:
        start: the vector before the first step, at which it has settled.
        step_s: interval between steps.
    """

    def __init__(self, start: F64, step_s: float) -> None:
        self._step_s = step_s
        self._in, self._out = [start, start], [start, start]

    @property
    def value(self) -> F64:
        """Output of the filter."""
        return self._out[0]

    def step(self, value: F64, cutoff_hz: float) -> None:
        """Pass one more vector; a cutoff of 0 switches the filter off."""
        passed = np.asarray(value, dtype=float)
        if cutoff_hz > 0.0:
            k = math.tan(math.pi * min(cutoff_hz * self._step_s, 0.4))
            scale = 1.0 + _ROOT * k + k * k
            gathered = k * k * (value + 2.0 * self._in[0] + self._in[1])
            passed = (gathered - 2.0 * (k * k - 1.0) * self._out[0] - (1.0 - _ROOT * k + k * k) * self._out[1]) / scale
        self._in, self._out = [value, self._in[0]], [passed, self._out[0]]


DEFAULTS: dict[str, float] = {
    "GUID_TIMEOUT": 3.0, "LAND_SPEED": 50.0, "WPNAV_ACCEL": 250.0, "WPNAV_ACCEL_Z": 100.0, "WPNAV_SPEED_DN": 150.0,
    "WPNAV_SPEED_UP": 250.0, "PSC_JERK_XY": 5.0, "PSC_JERK_Z": 5.0, "INS_ACCEL_FILTER": 20.0, "INS_GYRO_FILTER": 20.0,
    "ANGLE_MAX": 3000.0, "PLND_XY_DIST_MAX": 2.5,
    "PLND_ALT_MAX": 8.0, "PLND_ORIENT": 25, "PLND_YAW_ALIGN": 0, "INS_GYR_CAL": 0, "EK3_SRC1_POSXY": 3, "EK3_SRC1_VELXY": 3,
    "EK3_SRC1_POSZ": 1, "EK3_SRC1_VELZ": 3, "EK3_SRC1_YAW": 1, "EK3_RNG_USE_HGT": -1,
    **{f"PLND_CAM_POS_{axis}": 0.0 for axis in "XYZ"},
}  # fmt: skip
"""ArduCopter's defaults of the parameters that the stand-in reads or that are requested."""
READY_S = 1.0
"""Time after the start for which there is no position; the program needs some 40 s."""
_STILL_M_S2, _DETECT_S, _LOW_THRUST = 1.0, 1.0, 0.25
"""LAND_DETECTOR_ACCEL_MAX and LAND_DETECTOR_TRIGGER_SEC of the program; the thrust that counts as the least."""
_ACCEL_MEAN_S = 0.16
"""Time constant of the filtered acceleration that the landing detector reads: 1 Hz."""
_IDLES = 0.1
"""Command of a motor while it is armed, at the least (MOT_SPIN_ARM's default)."""
_RAMP_S = 0.5
"""Time in which its rotors spool up for a take-off (MOT_SPOOL_TIME)."""
_TARGET_S = 0.15
"""Time constant of the target's position and velocity in the precision-landing estimator."""
_SLOW_BELOW_M = 10.0
"""Height below which it lands by LAND_SPEED (LAND_ALT_LOW)."""
_SEEN_S = 2.0
"""Time without a target after which it is lost (LANDING_TARGET_TIMEOUT_MS of AC_PrecLand)."""


class CopterStandIn(StandIn):
    """Flies a body as ArduCopter does.

    Args:
        airframe: the vehicle that it is set up for; None for an AR.Drone's.
    """

    def __init__(
        self,
        clock: Clock,
        parameters: Mapping[str, float] | None = None,
        step_s: float = 0.0025,
        airframe: Airframe | None = None,
    ) -> None:
        given = {**DEFAULTS, **arducopter.PARAMETERS, **(parameters or {})}
        super().__init__(Stack.ARDUPILOT, clock, given, "stabilize")
        self.step_s = step_s
        frame = airframe or ardrone2()
        self._cascade = Cascade(tuned(COPTER_GAINS, frame, step_s), frame, CURVE, step_s)
        self._v_wanted, self._a_wanted, self._yaw_rate = np.zeros(3), np.zeros(3), 0.0
        self._wanted_s = -math.inf
        self._attitude_rad: tuple[float, float, float] | None = None
        """Roll, pitch and yaw of the newest setpoint; None if it was one of a velocity."""
        self._v_shaped, self._a_shaped = np.zeros(3), np.zeros(3)
        self._place = np.zeros(3)
        self._take_off_to_m: float | None = None
        self._goal: F64 | None = None
        self._lift_s = self._idle_s = self._still_s = 0.0
        self._f_slow = np.array([0.0, 0.0, -G_M_S2])
        self._f_filtered, self._w_filtered = LowPass(self._f_slow, step_s), LowPass(np.zeros(3), step_s)
        self._target: tuple[float, F64, F64] | None = None

    # Commands to it

    def why_not_armed(self) -> str | None:
        """Return the refusal before there is a position, and in modes without one."""
        early = self.now_s - self._began_s < READY_S
        return "Arm: Need Position Estimate" if early or self.mode not in ("guided", "loiter") else None

    def _on_arm_disarm(self, m: Message) -> int:
        self._idle_s = self._lift_s = 0.0
        return super()._on_arm_disarm(m)

    def _on_take_off(self, m: Message) -> int:
        """Climb from here: ArduCopter reads no place in it. On the ground it is the only way up in GUIDED."""
        if not self.armed or self.mode != "guided" or self.landed_state != ON_GROUND:
            return int(mav.MAV_RESULT_FAILED)
        self._take_off_to_m, self._lift_s = float(m.param7), 0.0
        return int(mav.MAV_RESULT_ACCEPTED)

    def _on_set_position_target_local_ned(self, m: Message, received: ReceivedMessage) -> None:
        super()._on_set_position_target_local_ned(m, received)
        del self.setpoints[:-200]
        if self.mode != "guided" or self.landed_state == ON_GROUND:
            return
        if m.coordinate_frame != 1 or m.type_mask not in (0x05C7, 0x0407):
            self._v_wanted, self._a_wanted, self._yaw_rate = np.zeros(3), np.zeros(3), 0.0
            return
        self._take_off_to_m = self._goal = None
        self._v_wanted, self._wanted_s, self._yaw_rate = np.array([m.vx, m.vy, m.vz]), self.now_s, m.yaw_rate
        self._a_wanted = np.array([m.afx, m.afy, m.afz]) if m.type_mask == 0x0407 else np.zeros(3)
        self._attitude_rad = None

    def _on_set_attitude_target(self, m: Message, received: ReceivedMessage) -> None:
        """Fly an attitude and its rate of yaw; other rates are not read. By default its thrust is a rate of climb."""
        if self.mode != "guided" or self.landed_state == ON_GROUND or m.type_mask != 0:
            return
        self._take_off_to_m = self._goal = None
        self._attitude_rad = Rotation.from_quat(np.array(m.q)).rpy_rad
        up, down = 0.01 * self.parameter("WPNAV_SPEED_UP"), 0.01 * self.parameter("WPNAV_SPEED_DN")
        climb = 2.0 * (m.thrust - 0.5)
        self._v_wanted = np.array([0.0, 0.0, -climb * (up if climb > 0.0 else down)])
        self._a_wanted, self._wanted_s, self._yaw_rate = np.zeros(3), self.now_s, m.body_yaw_rate

    def _on_landing_target(self, m: Message, received: ReceivedMessage) -> None:
        reported = m.frame == 12 and m.position_valid == 1 and m.distance > 0
        if self.state is None or not self.parameter("PLND_ENABLED") or not reported:
            return
        seen = self.state.p_ned + self.state.R_ned_body @ np.array([m.x, m.y, m.z])
        if self._target is None or self.now_s - self._target[0] > _SEEN_S:
            self._target = (self.now_s, seen, np.zeros(3))
            return
        at, place, velocity = self._target
        dt = max(self.now_s - at, 1e-3)
        carried = place + velocity * dt
        share = 1.0 - math.exp(-dt / _TARGET_S)
        moving = bool(int(self.parameter("PLND_OPTIONS")) & 1)
        velocity = velocity + (0.3 * share / dt) * (seen - carried) if moving else np.zeros(3)
        self._target = (self.now_s, carried + share * (seen - carried), velocity)

    def begin_in_air(self, s: BodyState) -> None:
        """Begin as it flies by setpoints of the velocity that it has."""
        super().begin_in_air(s)
        self._v_wanted, self._wanted_s = s.v_ned, self.now_s
        self._v_shaped = s.v_ned.copy()

    def goes_to(self, p_ned: F64) -> None:
        """Fly to a place in GUIDED until another setpoint comes."""
        if self.mode != "guided":
            self._enter("guided")
        self._goal = p_ned

    def entered(self, name: str) -> None:
        """Hold where it stops from here, over the ground. Source: ArduCopter, ModeBrake::run, ModeLand."""
        self._goal = self._attitude_rad = None
        if self.state is not None:
            v, stops_s = self.state.v_ned, math.hypot(*self.state.v_ned[:2]) / (0.02 * self.parameter("WPNAV_ACCEL"))
            self._place = self.state.p_ned + v * (stops_s, stops_s, 0.0)
            self._v_shaped, self._a_shaped = self.state.v_ned.copy(), np.zeros(3)
        if name != "guided":
            self._take_off_to_m = None

    # What it does

    def imu(self, s: BodyState) -> Message:
        """Return RAW_IMU behind the filters of INS_*_FILTER, stamped as it is sent; its last digits never stand still."""
        milli = [round(1e3 * c) + self._samples % 7 - 3 for c in (*(self._f_filtered.value / G_M_S2), *self._w_filtered.value)]
        return mav.MAVLink_raw_imu_message(self.boot_ns // 1000, *milli, 0, 0, 0)

    def fly(self, s: BodyState) -> Motors:
        """Return the motors for the body's state."""
        self._f_filtered.step(s.f_body, self.parameter("INS_ACCEL_FILTER"))
        self._w_filtered.step(s.w_body, self.parameter("INS_GYRO_FILTER"))
        self._f_slow = self._f_slow + (1.0 - math.exp(-self.step_s / _ACCEL_MEAN_S)) * (s.f_body - self._f_slow)
        if not self.armed:
            self.landed_state, self._take_off_to_m = ON_GROUND, None
            self._cascade.reset()
            self.entered(self.mode)
            return STILL
        if self.landed_state == ON_GROUND and not self._lifts(s):
            return (_IDLES, _IDLES, _IDLES, _IDLES)
        v_wanted, a_wanted = self._wanted(s)
        v, a = self._shaped(s, v_wanted, a_wanted)
        lean_max_rad = math.radians(0.01 * self.parameter("ANGLE_MAX"))
        wanted, yaw_rate = self._cascade.accelerations(s, v, a), self._yaw_rate if self.mode == "guided" else 0.0
        if self._attitude_rad is not None:
            (roll, pitch, heading), yaw = self._attitude_rad, s.R_ned_body.rpy_rad[2]
            lean = Rotation.from_rpy(0.0, 0.0, yaw) @ np.array([-math.tan(pitch), math.tan(roll), 0.0])
            wanted = G_M_S2 * lean + wanted * (0.0, 0.0, 1.0)
            yaw_rate += self.parameter("ATC_ANG_YAW_P") * wrap_pi(heading - yaw)
        one, two, three, four = self._cascade.motors(s, wanted, yaw_rate, lean_max_rad=lean_max_rad)
        self._detect_landing(s, descends=v_wanted[2] > 0.0)
        return (max(one, _IDLES), max(two, _IDLES), max(three, _IDLES), max(four, _IDLES))

    def _lifts(self, s: BodyState) -> bool:
        """Return whether the rotors have spooled up for a take-off; without one the motors idle, and it disarms at last."""
        self._cascade.reset()
        self.entered(self.mode)
        if self._take_off_to_m is None:
            self._idle_s += self.step_s
            if self._idle_s >= self.parameter("DISARM_DELAY") > 0.0:
                self._disarm()
            return False
        self._lift_s += self.step_s
        if self._lift_s < _RAMP_S:
            return False
        self.landed_state, self._still_s, self._v_wanted = IN_AIR, 0.0, np.zeros(3)
        return True

    def _wanted(self, s: BodyState) -> tuple[F64, F64]:
        nothing = np.zeros(3)
        if self.mode == "guided":
            if self._take_off_to_m is not None:
                return np.array([0.0, 0.0, max(-1.0, min(0.0, -(self._take_off_to_m + self.p_ned[2])))]), nothing
            if self._goal is not None:
                return toward(self._goal - s.p_ned, 1.0, 5.0), nothing
            fresh = self.now_s - self._wanted_s <= self.parameter("GUID_TIMEOUT")
            if self._attitude_rad is not None:
                # No horizontal loop runs: it wants what it has.
                return np.array([*s.v_ned[:2], self._v_wanted[2] if fresh else 0.0]), nothing
            return (self._v_wanted, self._a_wanted) if fresh else (nothing, nothing)
        if self.mode == "land":
            v = toward(self._place - s.p_ned, 1.0, 1.0)
            if self._target is not None and self.now_s - self._target[0] <= _SEEN_S:
                at, place, velocity = self._target
                v = velocity + toward(place + velocity * (self.now_s - at) - s.p_ned, 1.0, 1.0)
                self._place = s.p_ned.copy()
            v[2] = 0.01 * self.parameter("LAND_SPEED") if (s.range_m or 0.0) < _SLOW_BELOW_M else 1.5
            return v, nothing
        return toward(self._place - s.p_ned, 1.0, 5.0), nothing

    def _shaped(self, s: BodyState, v_wanted: F64, a_wanted: F64) -> tuple[F64, F64]:
        """Return velocity and acceleration behind the limits of acceleration and jerk through which every mode is flown."""
        most = np.array([self.parameter("WPNAV_ACCEL"), self.parameter("WPNAV_ACCEL"), self.parameter("WPNAV_ACCEL_Z")]) * 0.01
        jerk = np.array([self.parameter("PSC_JERK_XY"), self.parameter("PSC_JERK_XY"), self.parameter("PSC_JERK_Z")])
        up, down = 0.01 * self.parameter("WPNAV_SPEED_UP"), 0.01 * self.parameter("WPNAV_SPEED_DN")
        v_wanted = np.array([v_wanted[0], v_wanted[1], min(max(v_wanted[2], -up), down)])
        a = np.clip(a_wanted + (jerk / most) * (v_wanted - self._v_shaped), -most, most)
        self._a_shaped = self._a_shaped + np.clip(a - self._a_shaped, -jerk * self.step_s, jerk * self.step_s)
        self._v_shaped = self._v_shaped + self._a_shaped * self.step_s
        # The shaped target stays near the flown state: on deck, or at a limit, it does not run away.
        self._v_shaped = s.v_ned + np.clip(self._v_shaped - s.v_ned, -1.0, 1.0)
        return self._v_shaped, self._a_shaped

    def _detect_landing(self, s: BodyState, *, descends: bool) -> None:
        """Detect the ground by the least thrust and a small acceleration while a descent is wanted.

        Whoever stands on a deck and holds has not landed, so that setpoints lift it and a take-off is refused
        (`Copter::update_throttle_mix`, descent_not_demanded). Only LAND disarms on the ground, other modes stay armed.
        """
        least = self._cascade.thrust_fraction < _LOW_THRUST
        shaken = float(np.linalg.norm(self._f_slow)) - G_M_S2
        still = descends and least and abs(shaken) < _STILL_M_S2 and (s.range_m is None or s.range_m < 2.0)
        self._still_s = self._still_s + self.step_s if still else 0.0
        if self._still_s < _DETECT_S:
            return
        self.landed_state, self._idle_s = ON_GROUND, 0.0
        if self.mode == "land":
            self._disarm()

    def _disarm(self) -> None:
        self.armed = False
        self.text(6, "Disarming motors")
        self.send(self.heartbeat())
