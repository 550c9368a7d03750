"""The quadcopter: a rigid body under rotor thrust, drag, wind and contact, flown by an AR.Drone's inner loops.

The formulae and their sources are in `sitl/core/physics/vehicle.c`; here are one vehicle's parameters and state.
"""

import math
from collections.abc import Sequence
from enum import IntEnum
from typing import Any

import numpy as np

from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import G_M_S2
from sitl.core.abi import DL_COMMANDS_MAX, DL_EFFECT_NOISE, DL_FLIGHT_NOISE, DL_ROTORS_MAX, DL_TOUCHED_DECK, DL_TOUCHED_SEA
from sitl.core.library import SIM, Number, Numbers
from sitl.vehicle.airframe import Airframe, StickLimits, rotors
from sitl.vehicle.disturbances import EffectSettings, NoiseRows, Wind, keep_and_fresh
from sitl.vessel.air import AirModel
from sitl.vessel.contact import DeckShape, Ground

DECK, SEA = DL_TOUCHED_DECK, DL_TOUCHED_SEA
"""Codes of `Vehicle.touched_what`; 0 before any contact."""

_KAIMAL_LAGS = (0.4444, 0.5448, 0.6623)
"""Correlation of the two lags along, across and up, by their times in `physics/air.c`."""
_AIR_SEED = 0xA12  # stream of random numbers of the air
_EFFECT_SEED = 0xA13  # stream of random numbers of the unkind effects
_DOWNWASH_S = 0.3  # correlation time of the downwash's turbulence (assumed)
_CLIMB_S = 1.0  # correlation time of the loops' climb rate (assumed)
_GROUND_EFFECT_S = 0.1  # lag of the ground effect (assumed)
_AIR_DENSITY = 1.225  # density of air, kg/m^3
_THRUST_COEFFICIENT = 0.12
"""Thrust over density, squared revolutions and the fourth power of the diameter (small propellers: 0.1 to 0.15)."""


class VehiclePhase(IntEnum):
    """Phase of the vehicle's flight."""

    LANDED = 0
    TAKING_OFF = 1
    HOVERING = 2
    FLYING = 3
    LANDING = 4
    EMERGENCY = 5


assert {f"DL_PHASE_{phase.name}": phase.value for phase in VehiclePhase} == SIM.names("dl_sim_phase")
MOTORS_TURN = (VehiclePhase.TAKING_OFF, VehiclePhase.HOVERING, VehiclePhase.FLYING, VehiclePhase.LANDING)
"""Phases of a vehicle in which its motors turn."""
_CAN_LAND = (VehiclePhase.TAKING_OFF, VehiclePhase.HOVERING, VehiclePhase.FLYING)


class Vehicle:
    """One vehicle.

    Args:
        step_s: length of a step; 2 to 5 ms keeps the feet's springs stable.
        seed: of its wind and of its own errors.
        air: the air, where it is more than the uniform wind with its gusts.

    Attributes:
        p: m in ned.
        v: m/s in ned.
        q: unit quaternion (w, x, y, z) of R_ned_body.
        w: rad/s in body.
        a: mean acceleration over the last step, m/s^2 in ned.
        flow: velocity forward and right that the drone itself estimates, m/s.
        gust: m/s in ned, on top of the steady wind.
        air_ned: velocity of the air at the vehicle, without `gust` and `extra_wind`, m/s.
        unasked_rad_s2: angular acceleration about the body's axes that the loops did not request, as they observe it.
        tied: whether it stands still on the deck and is carried with it.
        touched_s: seconds since the first step of the newest contact after flight; nan before any.
        touched_phase: phase before that contact.
        touched_d: body's origin from the pad's centre in the pad frame at that contact, m.
        touched_v: velocity against the deck (against the water) just before it, in the pad frame, m/s.
        touched_rows: R_pad_body at it, rows of the matrix.
        touched_w: turn rates against the deck just before it, in the pad frame, rad/s.
        tilt_max_rad: largest roll or pitch that any loop requests.
        extra_wind: m/s in ned, on top of the wind: a single gust as it passes.
        current: velocity of the water, m/s north and east, against which the optical flow measures beside the deck.

    Raises:
        ValueError: the step is too long for the springs, or too short for the delay of the commands.
    """

    p = Numbers("state", "p")
    v = Numbers("state", "v")
    w = Numbers("state", "w")
    a = Numbers("state", "a")
    thrust_n = Number("state", "thrust_n")
    torque_n_m = Numbers("state", "torque_n_m")
    flow = Numbers("state", "flow")
    gust = Numbers("state", "gust")
    air_ned = Numbers("state", "air")
    unasked_rad_s2 = Numbers("state", "unasked")
    seconds = Number("state", "seconds")
    phase = Number("state", "phase")
    tied = Number("state", "tied")
    ditched = Number("state", "ditched")
    touched_what = Number("state", "touched_what")
    touched_phase = Number("state", "touched_phase")
    touched_s = Number("state", "touched_s")
    touched_d = Numbers("state", "touched_d")
    touched_v = Numbers("state", "touched_v")
    touched_rows = Numbers("state", "touched_R")
    touched_w = Numbers("state", "touched_w")
    tilt_max_rad = Number("params", "tilt_max_rad")
    extra_wind = Numbers("params", "extra_wind")
    current = Numbers("params", "current")
    flow_works = Number("params", "flow_works")
    _motor_driven = Number("params", "motor_driven")
    _driven_n = Number("state", "driven_n")
    _driven_n_m = Numbers("state", "driven_n_m")
    _q = Numbers("state", "q")
    _R = Numbers("state", "R")
    _rotor_health = Numbers("params", "rotor_health")

    def __init__(
        self,
        airframe: Airframe,
        shape: DeckShape,
        step_s: float,
        seed: np.random.SeedSequence,
        wind: Wind | None = None,
        air: AirModel | None = None,
    ) -> None:
        if not 0.0 < step_s <= 0.01:
            raise ValueError(f"step_s must lie in (0, 0.01] s, got {step_s!r}")
        if airframe.command_delay_s > DL_COMMANDS_MAX * step_s:
            raise ValueError(f"a delay of {airframe.command_delay_s} s is more than {DL_COMMANDS_MAX} steps of {step_s} s")
        self.airframe, self.shape, self.step_s = airframe, shape, step_s
        self.limits = StickLimits()
        self.wind = wind or Wind()
        self.params = _packed_params(airframe, shape, self.wind, step_s)
        """The core's `dl_sim_vehicle_params`."""
        self.state = SIM.new(
            "dl_sim_vehicle", q=(1.0, 0.0, 0.0, 0.0), R=np.eye(3), attached_q=(1.0, 0.0, 0.0, 0.0),
            touched_s=math.nan, touched_d=math.nan, touched_v=math.nan, touched_R=math.nan, touched_w=math.nan,
        )  # fmt: skip
        """The core's `dl_sim_vehicle`."""
        self._deck = SIM.new("dl_sim_deck")
        self.noise = NoiseRows.of(seed, DL_FLIGHT_NOISE)
        """The numbers of its own errors and of the gusts."""
        self.effect_noise: NoiseRows | None = None
        """The numbers of the unkind effects, where there are any."""
        if self.params.effects.on:
            child = np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, _EFFECT_SEED))
            self.effect_noise = NoiseRows.of(child, DL_EFFECT_NOISE)
        self._begin_errors()
        self.air_noise: NoiseRows | None = None
        """The numbers of the air, where it is more than a uniform wind."""
        if air is not None:
            self.params.air = air.packed(step_s)[0]
            self.air_noise = NoiseRows.of(
                np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, _AIR_SEED)), DL_FLIGHT_NOISE
            )
            self._begin_air(self.air_noise, air.turbulence == "kaimal")

    def _begin_errors(self) -> None:
        """Start the random processes in their steady state."""
        start, bias, av = self.noise.next(), self.noise.next(), self.airframe.avionics
        gust, flow, drift = self.wind.gust_sigma_m_s, av.flow_noise_sigma_m_s, av.tilt_drift_sigma_rad
        SIM.fill(
            self.state,
            gust=(gust * start[0], gust * start[1], 0.5 * gust * start[2]),
            flow_error=(flow * start[3], flow * start[4]),
            tilt_bias=(av.tilt_bias_sigma_rad * bias[0], av.tilt_bias_sigma_rad * bias[1]),
            tilt_drift=(drift * start[5], drift * start[6]),
        )  # fmt: skip

    def _begin_air(self, noise: NoiseRows, two_lags: bool) -> None:
        """Start turbulence and eddies in their steady state.

        The lag of the lag of white noise has half the variance of the lag, and a covariance of a half with it. Two lags of the
        same noise have a correlation of twice the root of their times' product over their sum.

        Args:
            two_lags: whether each component has two lags of one noise (Kaimal's), instead of a lag of a lag (Dryden's).
        """
        start, second = noise.next(), noise.next()
        pairs = [
            (x, rho * x + math.sqrt(1.0 - rho * rho) * y) if two_lags else (x, 0.5 * (x + y))
            for x, y, rho in zip(start, second, _KAIMAL_LAGS, strict=False)
        ]
        SIM.fill(self.state, air_u=pairs[0], air_v=pairs[1], air_w=pairs[2], eddy=start[3:6])

    def place(self, p_ned: F64, v_ned: F64, yaw_rad: float) -> None:
        """Put it into the air, hovering and tilting against the steady wind: (3,) m and m/s, and the heading."""
        k, air = self.airframe.drag_per_s, self.wind.v_ned
        against_x, against_y = k[0] * (float(v_ned[0]) - air[0]), k[1] * (float(v_ned[1]) - air[1])
        c, s = math.cos(yaw_rad), math.sin(yaw_rad)
        forward, right = c * against_x + s * against_y, c * against_y - s * against_x
        self.q = quaternion_of_rpy(right / G_M_S2, -forward / G_M_S2, yaw_rad)
        SIM.fill(
            self.state,
            p=p_ned, v=v_ned, z_hold=p_ned[2], airborne_s=1.0, phase=VehiclePhase.HOVERING, integral=(forward, right, 0.0),
            thrust_n=self.airframe.mass_kg * math.sqrt(against_x * against_x + against_y * against_y + G_M_S2**2),
        )  # fmt: skip

    def stand(self, ground: Ground, d_pad: F64, yaw_rad: float) -> None:
        """Put it on the deck, motors off: (3,) m from the pad's centre in the pad frame, heading against the arrow."""
        SIM.fill(
            self.state,
            attached_d=d_pad, attached_q=quaternion_of_rpy(0.0, 0.0, yaw_rad), tied=1, phase=VehiclePhase.LANDED,
            thrust_n=0.0, airborne_s=0.0, a=0.0,
        )  # fmt: skip
        ground.write_deck(self._deck)
        SIM.lib.dl_sim_vehicle_carry(self.state, self._deck)

    def command(self, roll: float, pitch: float, gaz: float, yaw: float, progressive: bool) -> None:
        """Stick fractions -1..1 with PCMD's signs: right, nose up, up, clockwise; ignored without `progressive` (hover)."""
        self.state.command = (*(min(max(x, -1.0), 1.0) for x in (roll, pitch, gaz, yaw)), progressive)

    def drive(self, thrust_n: float, torque_n_m: Sequence[float]) -> None:
        """Fly by thrust, N, and torques about the body's axes, (3,) N m, from now on, in place of its own loops."""
        self._motor_driven, self._driven_n, self._driven_n_m = 1, thrust_n, torque_n_m

    def take_off(self) -> None:
        """Take off if it is landed with its motors off."""
        if self.phase == VehiclePhase.LANDED:
            self.phase = VehiclePhase.TAKING_OFF

    def land(self) -> None:
        """Land if it flies."""
        if self.phase in _CAN_LAND:
            self.phase = VehiclePhase.LANDING

    def stay_up(self) -> None:
        """Hover instead if it is landing."""
        if self.phase == VehiclePhase.LANDING:
            self.phase = VehiclePhase.HOVERING

    def cut_motors(self) -> None:
        """Stop the motors at once, in any phase."""
        self.phase = VehiclePhase.EMERGENCY

    def leave_emergency(self) -> None:
        """End the emergency if it lies still on deck and not in the water."""
        if self.phase == VehiclePhase.EMERGENCY and self.tied and not self.ditched:
            self.phase = VehiclePhase.LANDED

    @property
    def q(self) -> tuple[float, ...]:
        return self._q

    @q.setter
    def q(self, q: Sequence[float]) -> None:
        self._q = tuple(q)
        self._R = tuple(Rotation.from_quat(np.array(q)).matrix.ravel().tolist())

    @property
    def rotor_health(self) -> tuple[float, ...]:
        """Share of its thrust that each rotor (in the order of `sitl.vehicle.airframe.rotors`) delivers."""
        return self._rotor_health[: len(rotors(self.airframe))]

    @rotor_health.setter
    def rotor_health(self, shares: Sequence[float]) -> None:
        missing = DL_ROTORS_MAX - len(shares)
        self._rotor_health = (*shares, *[1.0] * missing)
        self.params.all_healthy = all(share == 1.0 for share in shares)

    @property
    def p_ned(self) -> F64:
        """(3,) m."""
        return np.array(self.p)

    @property
    def v_ned(self) -> F64:
        """(3,) m/s."""
        return np.array(self.v)

    @property
    def R_ned_body(self) -> F64:
        """(3, 3)."""
        return np.array(self._R).reshape(3, 3)

    @property
    def w_body(self) -> F64:
        """(3,) rad/s."""
        return np.array(self.w)

    @property
    def a_ned(self) -> F64:
        """(3,) m/s^2."""
        return np.array(self.a)

    @property
    def f_body(self) -> F64:
        """(3,) m/s^2, specific force: at rest and level (0, 0, -9.81)."""
        return np.asarray((self.a_ned - [0.0, 0.0, G_M_S2]) @ self.R_ned_body)

    def keep_limits(self) -> None:
        """Give the core the stick's limits, whose fields may have been set."""
        s, params = self.limits, self.params
        params.euler_angle_max_rad, params.vz_max_m_s = s.euler_angle_max_rad, s.vz_max_m_s
        params.yaw_rate_max_rad_s = s.yaw_rate_max_rad_s

    def step(self, ground: Ground) -> None:
        """Advance by `step_s` to the instant for which `ground` holds."""
        self.keep_limits()
        ground.write_deck(self._deck)
        air, effects = self.air_noise or self.noise, self.effect_noise or self.noise
        rows = tuple(dict.fromkeys((self.noise, air, effects)))
        for noise in rows:
            noise.prepare()
        SIM.lib.dl_sim_vehicle_step(
            self.params, self.state, self._deck, ground.sea_z, ground.sea_vz, self.noise.row, air.row, effects.row
        )
        for noise in rows:
            noise.used(1)


def quaternion_of_rpy(roll: float, pitch: float, yaw: float) -> Sequence[float]:
    """Return the unit quaternion (w, x, y, z) of Rz(yaw) Ry(pitch) Rx(roll)."""
    return Rotation.from_rpy(roll, pitch, yaw).quat_wxyz.tolist()  # type: ignore[no-any-return]


def _packed_params(f: Airframe, shape: DeckShape, wind: Wind, step_s: float) -> Any:
    """Return the core's `dl_sim_vehicle_params`, without the stick's limits and the air."""
    k, av, feet, each = f.loops, f.avionics, f.feet, rotors(f)
    spare = [0.0] * (DL_ROTORS_MAX - len(each))
    cos_yaw, sin_yaw, middle, half = shape.turned
    gust, flow, tilt = (
        keep_and_fresh(*process, step_s)
        for process in (
            (wind.gust_sigma_m_s, wind.gust_time_s),
            (av.flow_noise_sigma_m_s, av.flow_noise_time_s),
            (av.tilt_drift_sigma_rad, av.tilt_drift_time_s),
        )
    )
    # What the header has by the name that the file has it by is taken as it is.
    members = set(SIM.dtype("dl_sim_vehicle_params").names or ()) - {"effects"}
    made = SIM.new("dl_sim_vehicle_params", **{n: getattr(of, n) for of in (f, k, av, feet) for n in members if hasattr(of, n)})
    SIM.fill(
        made,
        quad_x=f.layout == "quad_x", rotors=len(each), effect_by_rotor=f.ground_effect == "rotors",
        flow_works=1, all_healthy=1, delay_steps=round(f.command_delay_s / step_s),
        step_s=step_s, motor_lag=_lag(f.motor_lag_s, step_s), tilt_cut_off_cos=math.cos(f.tilt_cut_off_rad),
        rotor_forward=[r.forward for r in each] + spare, rotor_right=[r.right for r in each] + spare,
        rotor_spin=[r.spin for r in each] + spare, rotor_health=1.0,
        rotor_squares=(sum(r.forward**2 for r in each), sum(r.right**2 for r in each)),
        effect_radius_m=math.sqrt(len(each)) * f.rotor_radius_m,
        observer_share=step_s / (step_s + k.disturbance_s),
        unasked_max_rad_s2=[most / inertia for most, inertia in zip(f.torque_max_n_m, f.inertia_kg_m2, strict=True)],
        flow_lag=_lag(av.flow_lag_s, step_s),
        foot_m=feet.half_base_m, feet_below_m=feet.below_m, hull_top_m=feet.top_m, foot_n_m=feet.stiffness_n_m / 4.0,
        foot_n_s_m=2.0 * feet.DAMPING_RATIO * math.sqrt(feet.stiffness_n_m * f.mass_kg) / 4.0,
        deck_fore_m=shape.fore_m, deck_aft_m=shape.aft_m, deck_middle_m=middle, deck_half_m=half,
        deck_taper_m=shape.taper_m, deck_yaw=(cos_yaw, sin_yaw),
        gust_sigma_m_s=wind.gust_sigma_m_s, gust_keep=gust[0], gust_fresh=gust[1], flow_keep=flow[0], flow_fresh=flow[1],
        tilt_keep=tilt[0], tilt_fresh=tilt[1], wind=wind.v_ned, effects=_packed_effects(f, step_s),
    )  # fmt: skip
    return made


def _packed_effects(f: Airframe, step_s: float) -> dict[str, Any]:
    """Return the members of the core's `dl_sim_effects`."""
    e, weight_n, each = f.effects, f.mass_kg * G_M_S2, len(rotors(f))
    downwash, climb = keep_and_fresh(1.0, _DOWNWASH_S, step_s), keep_and_fresh(e.loop_climb_sigma_m_s, _CLIMB_S, step_s)
    area_m2 = each * math.pi * f.rotor_radius_m**2
    return {
        "on": e != EffectSettings() or f.lift_share != 1.0,
        "saturates": e.rotor_saturation,
        "moving_deck": e.moving_deck,
        "rotor_drag": e.rotor_drag,
        "sag": e.battery_sag,
        "hover_share": weight_n / f.thrust_max_n,
        "drag_per_m": e.drag_per_m,
        "downwash": e.downwash_m_s2 * f.downwash_share,
        "downwash_keep": downwash[0],
        "downwash_fresh": downwash[1],
        "cushion_share": step_s / (_GROUND_EFFECT_S + step_s),
        "induced_m_s": math.sqrt(weight_n / (2.0 * _AIR_DENSITY * area_m2)),
        "climb_keep": climb[0],
        "climb_fresh": climb[1],
        "rate_sigma": math.radians(e.loop_rate_sigma_deg_s),
        "loop_mass_kg": f.mass_kg - e.unknown_mass_kg,
        "tilt_gain": f.loops.tilt_gain,
        "lift_share": f.lift_share,
        "thing": (e.thing_forward_m, e.thing_right_m, e.thing_radius_m, e.thing_height_m),
        "revolution_hz": math.sqrt(weight_n / each / (_THRUST_COEFFICIENT * _AIR_DENSITY * (2.0 * f.rotor_radius_m) ** 4)),
    }


def _lag(time_s: float, step_s: float) -> float:
    """Return the share of the way to its input that a first-order lag goes in a step."""
    return 1.0 - math.exp(-step_s / time_s) if time_s > 0 else 1.0
