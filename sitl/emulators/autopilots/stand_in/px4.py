"""A stand-in for PX4 1.16: its take-off, arming checks, land detector, OFFBOARD failsafe and texts, as the program was measured.

Sources: PX4 user guide 1.16 (OFFBOARD mode, takeoff mode, land detector configuration, safety) and its parameter reference; the
behaviour on a deck was measured on the program itself (docs/px4.md).
"""

import math
from collections.abc import Mapping

import numpy as np

from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import ReceivedMessage
from drivers.mavlink.setpoint import velocity_setpoint
from drivers.mavlink.vehicle import Stack
from estimator.contracts.commands import Velocity
from estimator.contracts.geometry import F64, GeoPoint, ned_between
from estimator.contracts.motion import G_M_S2
from estimator.contracts.time import Clock
from sitl.emulators.autopilots.body import BodyState
from sitl.emulators.autopilots.programs import px4
from sitl.emulators.autopilots.stand_in.base import IN_AIR, ON_GROUND, STILL, StandIn, toward
from sitl.emulators.autopilots.stand_in.cascade import PX4_GAINS, Cascade
from sitl.emulators.autopilots.stand_in.tuning import tuned
from sitl.sensors.sensors import ORIGIN
from sitl.vehicle.airframe import Airframe, ardrone2
from sitl.world.drives import Motors

DEFAULTS: dict[str, float] = {
    "COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 0, "COM_DISARM_LAND": 2.0, "COM_DISARM_PRFLT": 10.0, "COM_SPOOLUP_TIME": 1.0,
    "MPC_TKO_RAMP_T": 3.0, "MPC_XY_P": 0.95, "MPC_Z_P": 1.0, "MPC_XY_CRUISE": 5.0, "MPC_XY_VEL_MAX": 12.0,
    "MPC_Z_VEL_MAX_DN": 1.5, "MPC_Z_VEL_MAX_UP": 3.0, "MPC_THR_MIN": 0.12, "MPC_THR_HOVER": 0.48, "MPC_TILTMAX_LND": 12.0,
    "MIS_TAKEOFF_ALT": 2.5, "EKF2_GPS_CHECK": 1023, "EKF2_REQ_GPS_H": 10.0, "EKF2_REQ_HDRIFT": 0.1, "EKF2_REQ_VDRIFT": 0.2,
    "LNDMC_Z_VEL_MAX": 0.25, "LNDMC_XY_VEL_MAX": 1.5, "LNDMC_TRIG_TIME": 1.0, "MPC_LAND_CRWL": 0.3, "MPC_LAND_SPEED": 0.7,
    "EKF2_HGT_REF": 1, "EKF2_EV_CTRL": 0, "IMU_INTEG_RATE": 250,
    "PLD_HACC_RAD": 0.2, "PLD_BTOUT": 5.0, "LTEST_MODE": 0, "RTL_PLD_MD": 0, "NAV_RCL_ACT": 2, "COM_RC_IN_MODE": 3,
}  # fmt: skip
"""PX4's defaults of the parameters that the stand-in reads or that are requested."""
_HORIZONTAL_DRIFT, _VERTICAL_DRIFT, _HORIZONTAL_SPEED = 1 << 5, 1 << 6, 1 << 7
"""Bits of EKF2_GPS_CHECK that compare what GNSS says with a vehicle at rest."""
_SPEED_S = 10.0
"""Time constant of the filtered GNSS velocity that the drift checks compare, s."""
_NO_POSITION = "Arming denied: Resolve system health failures first"
"""The words that came in two chunks; the second held one letter."""
_LOST = "Failsafe activated: Offboard signal lost, entering Hold"
_LOW_THRUST, _NO_THRUST = 0.6, 0.1
"""Thrusts of the land detector between the least and hovering: possible contact with the ground, and no thrust."""
_WANTS_UP_M_S = 0.3
"""Climb from which on the thrust ramps up for a take-off. Source: Takeoff.cpp of mc_pos_control."""
_MEASURED = 0b111111 | 1 << 9
"""Bits of HIGHRES_IMU's fields_updated: acceleration, turn rate and pressure."""


class Px4StandIn(StandIn):
    """Flies a body as PX4 does: OFFBOARD velocities with accelerations, AUTO.TAKEOFF, AUTO.LOITER, AUTO.LAND.

    Args:
        airframe: the vehicle that it is set up for; None for an AR.Drone's.
    """

    def __init__(self, clock: Clock, parameters: Mapping[str, float] | None = None, airframe: Airframe | None = None) -> None:
        super().__init__(Stack.PX4, clock, {**DEFAULTS, **px4.PARAMETERS, **(parameters or {})}, "auto.loiter")
        frame = airframe or ardrone2()
        self._cascade = Cascade(tuned(PX4_GAINS, frame, px4.STEP_S), frame, 0.0, px4.STEP_S)
        self._place: F64 | None = None
        """Target of AUTO modes, (3,) m ned."""
        self._v_wanted, self._a_wanted, self._yaw_rate = np.zeros(3), np.zeros(3), 0.0
        self._v_rest = np.zeros(3)
        self._checked_s = self._armed_s = self._climb_s = -math.inf
        self._contact_s = self._still_s = self._landed_s = 0.0
        self._lifted = self._lost_offboard = False

    # Commands to it

    def why_not_armed(self) -> str | None:
        """Return the refusal while there is no position: GNSS is not used before its checks have passed for a while."""
        passed = self.now_s - self._checked_s >= self.parameter("EKF2_REQ_GPS_H")
        return None if passed else _NO_POSITION

    def _on_arm_disarm(self, m: Message) -> int:
        was = self.armed
        result = super()._on_arm_disarm(m)
        if self.armed and not was:
            self._armed_s, self._climb_s, self._lifted = self.now_s, -math.inf, False
            self._cascade.reset()
            self.entered(self.mode)
        return result

    def _on_take_off(self, m: Message) -> int:
        """Take a place: latitude and longitude 0 are one, off Africa; only NaN means here. The altitude is above the sea."""
        if not self.armed or self.state is None:
            return int(mav.MAV_RESULT_TEMPORARILY_REJECTED)
        here = self.state.p_ned
        if math.isfinite(m.param5) and math.isfinite(m.param6):
            try:
                place = GeoPoint.of_degrees(m.param5, m.param6)
            except ValueError:
                return int(mav.MAV_RESULT_DENIED)
            here = np.array([*ned_between(ORIGIN, place)[:2], here[2]])
        self._enter("auto.takeoff")
        down = -m.param7 if math.isfinite(m.param7) else here[2] - self.parameter("MIS_TAKEOFF_ALT")
        self._place = np.array([here[0], here[1], down])
        return int(mav.MAV_RESULT_ACCEPTED)

    def _on_set_position_target_local_ned(self, m: Message, received: ReceivedMessage) -> None:
        super()._on_set_position_target_local_ned(m, received)
        if m.coordinate_frame not in (1, 8) or m.type_mask not in (0x05C7, 0x0407):
            return
        limit = (self.parameter("MPC_XY_VEL_MAX"), self.parameter("MPC_Z_VEL_MAX_UP"), self.parameter("MPC_Z_VEL_MAX_DN"))
        v = np.array([m.vx, m.vy, 0.0])
        self._v_wanted = v * min(1.0, limit[0] / max(math.hypot(m.vx, m.vy), 1e-9))
        self._v_wanted[2] = min(max(m.vz, -limit[1]), limit[2])
        self._a_wanted = np.array([m.afx, m.afy, m.afz]) if m.type_mask == 0x0407 else np.zeros(3)
        self._yaw_rate = m.yaw_rate

    def begin_in_air(self, s: BodyState) -> None:
        """Begin as it flies by setpoints of the velocity that it has."""
        super().begin_in_air(s)
        self._v_wanted, self._lifted, self._armed_s = s.v_ned, True, self.now_s
        setpoint = velocity_setpoint(self.boot_ms, (self.system, 1), Velocity(s.v_ned, 0.0), 0.0)
        self.setpoints.append((self.now_s, setpoint))

    def goes_to(self, p_ned: F64) -> None:
        """Fly to a place in Hold and stay there."""
        self._enter("auto.loiter")
        self._place = p_ned

    def entered(self, name: str) -> None:
        """Fix the place that a mode goes to: where the vehicle is now, over the ground."""
        self._lost_offboard = False
        if self.state is None:
            return
        self._place = self.state.p_ned.copy()
        if name == "auto.takeoff":
            self._place[2] -= self.parameter("MIS_TAKEOFF_ALT")

    def _enter(self, name: str) -> int:
        landed = self.landed_state
        result = super()._enter(name)
        self.landed_state = landed  # a mode lifts nothing off the ground
        return result

    @property
    def ground_contact(self) -> bool:
        """True if its land detector reports contact with the ground."""
        return self._contact_s >= self.parameter("LNDMC_TRIG_TIME") / 3.0

    # What it does

    def imu(self, s: BodyState) -> Message:
        """Return HIGHRES_IMU, whose accelerations are means over the sensor's own period."""
        readings = (*map(float, s.f_body), *map(float, s.w_body), 0, 0, 0, 0.01 * s.pressure_pa, 0, 0, 20.0, _MEASURED)
        return mav.MAVLink_highres_imu_message(self.boot_ns // 1000, *readings)

    def fly(self, s: BodyState) -> Motors:
        """Return the motors for the body's state."""
        self._check_gnss(s)
        self._watch_offboard()
        self._detect_landing(s)
        if not self.armed:
            return STILL
        v, a = self._wanted(s)
        thrust_max, lean_max = self._take_off_ramp(float(v[2]))
        if thrust_max == 0.0:
            self._cascade.reset()
            return (0.05, 0.05, 0.05, 0.05)
        if not self._lifted:
            self._cascade.wind_ned = np.zeros(3)
        wanted = self._cascade.accelerations(s, v, a)
        if self._lifted and self.ground_contact:
            self._cascade.reset()
            wanted = np.array([0.0, 0.0, G_M_S2])
        return self._cascade.motors(
            s, wanted, self._yaw_rate if self.mode == "offboard" else 0.0,
            thrust_max=thrust_max, thrust_min=min(self.parameter("MPC_THR_MIN"), thrust_max), lean_max_rad=lean_max,
        )  # fmt: skip

    def _wanted(self, s: BodyState) -> tuple[F64, F64]:
        if self.mode == "offboard":
            return self._v_wanted, self._a_wanted
        assert self._place is not None
        off = self._place - s.p_ned
        v = toward(off * (1.0, 1.0, 0.0), self.parameter("MPC_XY_P"), self.parameter("MPC_XY_CRUISE"))
        v[2] = min(max(self.parameter("MPC_Z_P") * off[2], -1.5), 0.7)
        if self.mode == "auto.land":
            v[2] = 0.7
        return v, np.zeros(3)

    def _take_off_ramp(self, v_down: float) -> tuple[float, float | None]:
        """Return the limits of thrust and tilt: after arming the rotors spool up, and after the wish to climb thrust ramps up.

        The horizontal loops act during the ramp already, so a vehicle that holds its place over the ground tilts on a deck that
        carries it away.
        """
        if self._lifted:
            return 1.0, None
        if self.now_s - self._armed_s < self.parameter("COM_SPOOLUP_TIME"):
            return 0.0, None
        if v_down < -_WANTS_UP_M_S and not math.isfinite(self._climb_s):
            self._climb_s = self.now_s
        if not math.isfinite(self._climb_s):
            return 0.0, None
        ramp = (self.now_s - self._climb_s) / max(self.parameter("MPC_TKO_RAMP_T"), 1e-3)
        if ramp >= 1.0:
            self._lifted, self.landed_state = True, IN_AIR
        return max(min(ramp, 1.0), 1e-3), math.radians(self.parameter("MPC_TILTMAX_LND"))

    def _check_gnss(self, s: BodyState) -> None:
        """Compare GNSS with a vehicle that its inertial sensors take to be at rest; in flight nothing is compared."""
        if self.armed:
            return
        keep = math.exp(-px4.STEP_S / _SPEED_S)
        self._v_rest = keep * self._v_rest + (1.0 - keep) * s.v_ned
        bits, drift = int(self.parameter("EKF2_GPS_CHECK")), math.hypot(self._v_rest[0], self._v_rest[1])
        failed = (
            (bits & _HORIZONTAL_DRIFT and drift > self.parameter("EKF2_REQ_HDRIFT"))
            or (bits & _VERTICAL_DRIFT and abs(self._v_rest[2]) > self.parameter("EKF2_REQ_VDRIFT"))
            or (bits & _HORIZONTAL_SPEED and drift > self.parameter("EKF2_REQ_HDRIFT"))
        )
        if failed or not math.isfinite(self._checked_s):
            self._checked_s = self.now_s

    def _watch_offboard(self) -> None:
        """Hold while the setpoints of OFFBOARD are gone, by a failsafe that ends once they come again or a mode is chosen."""
        newest = self.setpoints[-1][0] if self.setpoints else -math.inf
        del self.setpoints[:-200]
        lost = self.now_s - newest > self.parameter("COM_OF_LOSS_T")
        if self.mode == "offboard" and self.armed and lost:
            self.failsafes.append(_LOST)
            self.text(2, _LOST)
            self.set_mode("auto.loiter")
            self.critical = self._lost_offboard = True
        elif self._lost_offboard and (not lost or not self.armed):
            self.set_mode("offboard" if self.armed else self.mode)

    def _detect_landing(self, s: BodyState) -> None:
        """Detect the ground in three steps: low thrust in a descent without speed, then no thrust at all, then for a while.

        Speeds are over the ground, which those of a heaving deck or of a ship under way are not. With ground contact it takes the
        thrust away, and what follows is quick. Source: PX4 user guide 1.16, land detector configuration.
        """
        most_m_s = min(self.parameter("MPC_LAND_CRWL"), self.parameter("MPC_LAND_SPEED")) / 1.2
        self.parameters["LNDMC_Z_VEL_MAX"] = min(self.parameter("LNDMC_Z_VEL_MAX"), most_m_s)  # as the program does by itself
        if self.armed and not self._lifted:
            self.landed_state = ON_GROUND
            return
        each_s = self.parameter("LNDMC_TRIG_TIME") / 3.0
        least, hover = self.parameter("MPC_THR_MIN"), self.parameter("MPC_THR_HOVER")
        above = (self._cascade.thrust_fraction - least) / max(hover - least, 1e-6)
        was_landed = self.landed_state == ON_GROUND
        slow = abs(s.v_ned[2]) < self.parameter("LNDMC_Z_VEL_MAX") * (2.5 if was_landed else 1.0)
        slow = slow and math.hypot(s.v_ned[0], s.v_ned[1]) <= self.parameter("LNDMC_XY_VEL_MAX")
        down_m_s = float(self._v_wanted[2]) if self.mode == "offboard" else 0.7 if self.mode == "auto.land" else 0.0
        descends = down_m_s >= 1.1 * self.parameter("LNDMC_Z_VEL_MAX") or self._still_s >= each_s
        contact = not self.armed or (above <= _LOW_THRUST and slow and descends)
        self._contact_s = self._contact_s + px4.STEP_S if contact else 0.0
        turning = math.hypot(s.w_body[0], s.w_body[1]) > math.radians(20.0) * (2.5 if was_landed else 1.0)
        still = not self.armed or (self.ground_contact and above <= _NO_THRUST and not turning)
        self._still_s = self._still_s + px4.STEP_S if still else 0.0
        landed = not self.armed or self._still_s >= 2.0 * each_s
        self.landed_state = ON_GROUND if landed else IN_AIR
        self._landed_s = self._landed_s + px4.STEP_S if landed and self.armed else 0.0
        if self._landed_s >= self.parameter("COM_DISARM_LAND") > 0.0:
            self.armed = False
            self.text(6, "Disarmed by landing")
