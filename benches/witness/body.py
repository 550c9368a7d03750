"""Fly the vehicle in RotorPy, in our physics, and beside what others measured.

The vehicle of configs/vehicles/quad_1_5kg.toml with the air's effects of `weather_N` flies by the same loops and commands in our
physics and in RotorPy. RotorPy's aerodynamics are those of its Hummingbird (.5 kg, 8-inch propellers, identified from flights),
scaled to the size. Measured elsewhere: APC 10x4.7 propellers in a wind tunnel (UIUC); the ground effect of two bare rotors on a
test bench (Garofano-Soldado), of a quadrotor of rotor radius .12 m (the formula that Sanchez-Cuevas, Heredia & Ollero fitted to
it, Int. J. Aerospace Eng. 2017, eq. 4) and of a Crazyflie (gym-pybullet-drones); turbulence by MIL-F-8785C. This needs scipy and
`pip install --no-deps rotorpy==3.0.0`.
"""

import math
import tomllib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace

from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import G_M_S2
from sitl.vehicle.airframe import Airframe, Avionics, load
from sitl.vehicle.disturbances import EffectSettings
from sitl.vehicle.vehicle import Vehicle
from sitl.vessel.air import AirModel
from sitl.vessel.contact import DeckShape, Ground

TITLE = "Body and air: RotorPy and wind tunnels"
VEHICLE = Path(__file__).parents[2] / "configs/vehicles/quad_1_5kg.toml"
MEASURED = tomllib.loads(Path(__file__).with_suffix(".toml").read_text())
STEP_S, AIR_STEP_S, HEIGHT_M, WIND_M_S = 0.0025, 0.01, 50.0, 10.0
ALIKE, LEAST = 0.2, {"cm": 0.5, "deg": 0.5, "ms": 5.0, "%": 1.0}
"""Largest difference of rows that agree, as a share or in the row's unit."""
TO_FLU = np.diag([1.0, -1.0, -1.0])
"""Turns north-east-down and forward-right-down into RotorPy's axes, and back."""
AIR_DENSITY, THRUST_COEFFICIENT = 1.225, 0.12
SCALED = {"k_d": 3, "k_z": 3, "k_h": 2, "c_Dx": 2, "c_Dy": 2, "c_Dz": 2}
"""Powers of the rotor's radius with which RotorPy's aerodynamics grow."""


class Ours:
    """Our physics, under the vehicle's own loops."""

    def __init__(self, f: Airframe) -> None:
        self.vehicle, self.weight_n = Vehicle(f, DeckShape(9, 9, 9, 9), STEP_S, np.random.SeedSequence(1)), f.mass_kg * G_M_S2
        self.vehicle.place(np.array([0.0, 0.0, -HEIGHT_M]), np.zeros(3), 0.0)
        self.vehicle.limits.euler_angle_max_rad = self.most_rad = f.loops.tilt_max_rad

    @property
    def rpy(self) -> F64:
        return np.array(Rotation(self.vehicle.R_ned_body).rpy_rad)

    @property
    def thrust_n(self) -> float:
        return self.vehicle.thrust_n

    def step(self, roll: float, pitch: float, wind: F64) -> None:
        """Advance with these angles and the present height commanded."""
        self.vehicle.extra_wind = tuple(wind)
        self.vehicle.command(roll / self.most_rad, pitch / self.most_rad, 0.0, 0.0, progressive=True)
        self.vehicle.step(Ground.nowhere())

    def drive(self, thrust_n: float, v_ned: F64 | None = None) -> None:
        """Advance with this thrust and no torque commanded, at first with this velocity."""
        self.vehicle.params.motor_driven, self.vehicle.state.driven_n = 1, thrust_n
        self.vehicle.v = tuple(self.vehicle.v if v_ned is None else v_ned)
        self.vehicle.step(Ground.nowhere())


class Theirs(Ours):
    """RotorPy's vehicle, whose state our vehicle takes on after each step, so that its loops fly it."""

    def __init__(self, f: Airframe) -> None:
        from rotorpy.vehicles.hummingbird_params import quad_params as known
        from rotorpy.vehicles.multirotor import Multirotor

        super().__init__(f)
        size, places = f.rotor_radius_m / known["rotor_radius"], f.arm_m * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
        k_eta = THRUST_COEFFICIENT * AIR_DENSITY * (2.0 * f.rotor_radius_m) ** 4 / math.tau**2
        self.engine: Any = Multirotor({
            **known, **{name: known[name] * size**power for name, power in SCALED.items()},
            **dict(zip(("Ixx", "Iyy", "Izz"), f.inertia_kg_m2, strict=True)),
            "mass": f.mass_kg, "tau_m": f.motor_lag_s, "k_eta": k_eta, "k_m": k_eta * f.yaw_torque_per_thrust_m,
            "rotor_speed_max": math.sqrt(f.thrust_max_n / 4.0 / k_eta),
            "rotor_pos": {k: np.array([*at, f.rotors_above_m]) for k, at in enumerate(places)},
        }, control_abstraction="cmd_ctbm")  # fmt: skip
        self.now: dict[str, F64] = {
            "x": np.array([0.0, 0.0, HEIGHT_M]), "v": np.zeros(3), "q": np.array([0.0, 0.0, 0.0, 1.0]), "w": np.zeros(3),
            "wind": np.zeros(3), "rotor_speeds": np.full(4, math.sqrt(self.weight_n / 4.0 / k_eta)),
        }  # fmt: skip

    @property
    def thrust_n(self) -> float:
        return float(self.engine.k_eta * (self.now["rotor_speeds"] ** 2).sum())

    def step(self, roll: float, pitch: float, wind: F64) -> None:
        v = self.vehicle
        before = np.array([v.thrust_n, *v.torque_n_m])
        super().step(roll, pitch, wind)
        asked = before + (np.array([v.thrust_n, *v.torque_n_m]) - before) / v.params.motor_lag
        self.now["wind"] = TO_FLU @ wind
        self._fly(asked[0], TO_FLU @ asked[1:])

    def drive(self, thrust_n: float, v_ned: F64 | None = None) -> None:
        self.now["v"] = self.now["v"] if v_ned is None else TO_FLU @ v_ned
        self._fly(thrust_n, np.zeros(3))

    def _fly(self, thrust_n: float, moment: F64) -> None:
        before, v = self.now["v"], self.vehicle
        self.now = self.engine.step(self.now, {"cmd_thrust": thrust_n, "cmd_moment": moment}, STEP_S)
        x, y, z, w = self.now["q"].tolist()
        v.p, v.v, v.w = (tuple(TO_FLU @ self.now[name]) for name in "xvw")
        v.q, v.a = (w, x, -y, -z), tuple(TO_FLU @ (self.now["v"] - before) / STEP_S)


def tilt_step(body: Ours, deg: float) -> dict[str, float]:
    """Return how the roll follows a step of its command."""
    angle = []
    for _ in range(round(1.5 / STEP_S)):
        body.step(math.radians(deg), 0.0, np.zeros(3))
        angle.append(math.degrees(body.rpy[0]) / deg)
    first, last = (1e3 * STEP_S * (1 + int(np.argmax(np.array(angle) > share))) for share in (0.1, 0.9))
    return {"10 % after, ms": first, "10 to 90 %, ms": last - first, "overshoot, %": 100.0 * (max(angle) - 1.0)}


def thrust_step(body: Ours, start: float, end: float) -> dict[str, float]:
    """Return the time in which the thrust goes 63 % of the way between two shares of the weight."""
    for _ in range(round(0.5 / STEP_S)):
        body.drive(start * body.weight_n)
    steps, begin_n = 0, body.thrust_n
    while abs(body.thrust_n - begin_n) < (1.0 - math.exp(-1.0)) * abs(end * body.weight_n - begin_n):
        body.drive(end * body.weight_n)
        steps += 1
    return {"63 % after, ms": 1e3 * STEP_S * steps}


def moving(body: Ours, forward_m_s: float, climb_m_s: float) -> dict[str, float]:
    """Return how the air accelerates it while it is level and its rotors turn as in hovering."""
    v = np.array([forward_m_s, 0.0, -climb_m_s])
    body.drive(body.weight_n, v)
    back, _, down = (v - body.vehicle.v_ned) / STEP_S
    return {"drag, m/s^2": back, "lift, m/s^2": down} if forward_m_s else {"lift, m/s^2": down}


def hover(body: Ours, wind: F64) -> dict[str, float]:
    """Hold a place by its position and velocity in a wind, (n, 3) m/s; return what the wind does."""
    held, rows = np.zeros(2), []
    for air in wind:
        p = body.vehicle.p_ned
        held -= STEP_S * 0.4 * p[:2]
        a = held - 1.5 * p[:2] - 2.0 * body.vehicle.v_ned[:2]
        body.step(a[1] / G_M_S2, -a[0] / G_M_S2, air)
        rows.append([*p, *body.rpy])
    x, y, z, roll, pitch, _ = np.std(rows[len(rows) // 5 :], axis=0)
    return {"place, cm": 100.0 * math.hypot(x, y), "height, cm": 100.0 * z, "tilt, deg": math.degrees(math.hypot(roll, pitch))}


def our_air(f: Airframe, height_m: float, seconds: float, step_s: float, seed: int = 1) -> F64:
    """Return our Dryden turbulence at a point, (n, 3) m/s north, east and down; the wind blows to the north."""
    air, ground, rows = AirModel(WIND_M_S, 0.0, turbulence="dryden"), Ground.nowhere(), []
    vehicle, ground.sea_z = Vehicle(f, DeckShape(9, 9, 9, 9), step_s, np.random.SeedSequence(seed), air=air), 0.0
    for _ in range(round(seconds / step_s)):
        vehicle.place(np.array([0.0, 0.0, -height_m]), np.zeros(3), 0.0)
        vehicle.step(ground)
        rows.append(vehicle.air_ned)
    return np.array(rows)


def turbulence(x: F64) -> dict[str, float]:
    """Return the standard deviation, and the time in which the correlation falls to 1/e."""
    correlation = np.fft.irfft(np.abs(np.fft.rfft(x - x.mean(), 2 * x.size)) ** 2)[: x.size]
    return {"sd, m/s": float(x.std()), "lasts, s": AIR_STEP_S * int(np.argmax(correlation < math.exp(-1.0) * correlation[0]))}


def standard(height_m: float, up: bool) -> dict[str, float]:
    """Return the same by MIL-F-8785C at low altitude, where the mean wind is the same at all heights."""
    feet = max(10.0, height_m / 0.3048)
    term = 0.177 + 0.000823 * feet
    # Its vertical correlation is exp(-x) (1 - x / 2) of the time over length and airspeed, and 1/e at x = .66.
    lasts = 0.3048 * feet / WIND_M_S * (0.66 if up else term**-1.2)
    return {"sd, m/s": 0.1 * WIND_M_S * (1.0 if up else term**-0.4), "lasts, s": lasts}


def our_gain(f: Airframe, z_r: float) -> float:
    """Return the thrust gained, %, with the rotors this many of their radii over a deck at rest."""
    body = Ours(f)
    body.vehicle.place(np.array([0.0, 0.0, f.rotors_above_m - z_r * f.rotor_radius_m]), np.zeros(3), 0.0)
    body.vehicle.step(Ground.of(np.zeros(3), np.zeros(3), np.eye(3), np.zeros(3), 100.0))
    return -100.0 * body.vehicle.a[2] / G_M_S2


def quadrotor_gain(f: Airframe, z_r: float) -> float:
    """Return the same by Sanchez-Cuevas et al.: images of four rotors, and of what the body throws back."""
    R, z, d = f.rotor_radius_m, z_r * f.rotor_radius_m, 2.0 * f.arm_m
    places, weights = np.array([0.0, d, d, math.sqrt(2.0) * d, math.sqrt(2.0) * d]), np.array([1.0, 1.0, 1.0, 1.0, 8.0])
    lost = float((0.5 * weights * R * R * z * (places**2 + 4.0 * z * z) ** -1.5).sum())
    return 100.0 * lost / (1.0 - lost)


def cases(f: Airframe, seconds: float) -> Iterator[tuple[str, Callable[[Ours], dict[str, float]], str]]:
    """Yield each case's name, how it is flown, and what was measured elsewhere."""
    for deg in (5.0, 20.0):
        yield f"tilt step of {deg:g} deg: ", partial(tilt_step, deg=deg), ""
    for start, end in ((1.0, 1.2), (0.5, 1.0), (1.0, 0.0)):
        yield f"thrust from {start:g} to {end:g} of the weight: ", partial(thrust_step, start=start, end=end), ""
    for speed in (2.0, 5.0, 8.0, 12.0):
        yield f"level at {speed:g} m/s: ", partial(moving, forward_m_s=speed, climb_m_s=0.0), ""
    tunnel = MEASURED["propeller"]
    around_m_s = math.sqrt(f.mass_kg * G_M_S2 / 4.0 / (THRUST_COEFFICIENT * AIR_DENSITY * (2.0 * f.rotor_radius_m) ** 2))
    for climb in (-2.0, -1.0, 1.0, 2.0):
        kept = float(np.interp(abs(climb) / around_m_s, tunnel["advance_ratio"], tunnel["thrust"])) / tunnel["thrust"][0]
        lift = f"propeller {G_M_S2 * (kept - 1.0):.2f}" if climb > 0.0 else ""
        yield (
            f"{'climb' if climb > 0.0 else 'descent'} at {abs(climb):g} m/s: ",
            partial(moving, forward_m_s=0.0, climb_m_s=climb),
            lift,
        )
    for height_m in (3.0, 20.0):
        yield f"hovering in turbulence at {height_m:g} m: sd of ", partial(hover, wind=our_air(f, height_m, seconds, STEP_S)), ""
    t = STEP_S * np.arange(round(12.0 / STEP_S))
    gust = np.outer(2.5 * (1.0 - np.cos(math.pi * np.clip(np.minimum(t - 3.0, 7.0 - t), 0.0, 1.0))), [1.0, 0.0, 0.0])
    yield "gust of 5 m/s, 1 s up, 2 s, 1 s down: sd of ", partial(hover, wind=gust), ""


def table(every: int = 1, seconds: float = 60.0) -> Iterator[str]:
    """Yield the lines of the table, of every Nth flight."""
    exact = Avionics(tilt_bias_sigma_rad=0.0, tilt_drift_sigma_rad=0.0)
    effects = EffectSettings(rotor_saturation=True, rotor_drag=True, drag_per_m=0.006)
    f = replace(load(VEHICLE).airframe(), avionics=exact, effects=effects)
    yield "| what | ours | RotorPy | off | measured elsewhere |"
    yield "|" + "---|" * 5
    for name, fly, elsewhere in list(cases(f, seconds))[::every]:
        yield from compared(name, fly(Ours(f)), fly(Theirs(f)), elsewhere)
    for height_m in (3.0, 20.0):
        ours = our_air(f, height_m, 20.0 * seconds, AIR_STEP_S)
        for axis, way in ((0, "along"), (2, "up")):
            law = standard(height_m, axis == 2)
            for name, a in turbulence(ours[:, axis]).items():
                yield f"| Dryden at {height_m:g} m, {way}: {name} | {a:.2f} | | | {law[name]:.2f} ({a / law[name] - 1.0:+.0%}) |"
    pair, small = MEASURED["pair"], MEASURED["crazyflie"]
    for z_r in ((f.feet.below_m + f.rotors_above_m) / f.rotor_radius_m, 1.5, 2.0, 3.0, 4.0):
        bare = 100.0 * (float(np.interp(z_r, pair["z_r"], pair["thrust_n"])) / pair["thrust_n"][-1] - 1.0)
        fitted = 100.0 * small["gain"] * (0.25 / max(z_r, small["least_z_r"])) ** 2
        gain, quadrotor = our_gain(f, z_r), quadrotor_gain(f, z_r)
        yield (
            f"| ground effect at {z_r:.1f} rotor radii: thrust gained, % | {gain:.1f} | | | "
            f"quadrotor {quadrotor:.1f} ({gain / quadrotor - 1.0:+.0%}), bare pair {bare:.1f}, Crazyflie {fitted:.0f} |"
        )


def compared(what: str, ours: dict[str, float], theirs: dict[str, float], elsewhere: str) -> Iterator[str]:
    """Yield the rows of one comparison."""
    for name, a in ours.items():
        b = theirs[name]
        apart = abs(a - b) > max(ALIKE * abs(b), LEAST.get(name.split(", ")[-1], 0.0))
        off = f"{a / b - 1.0:+.0%}{' **!**' if apart else ''}"
        yield f"| {what}{name} | {a:.2f} | {b:.2f} | {off} | {elsewhere} |"
