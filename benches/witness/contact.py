"""Land the vehicle in MuJoCo and in our physics.

The vehicle of configs/vehicles/quad_1_5kg.toml lands by the same commands on the same moving deck. MuJoCo's contact is the
spring and damper of the vehicle's file with Coulomb's friction, in steps of .5 ms. The motors stop .3 s after the first contact,
or where the row says so. Slides are from the first contact to rest: ours without ground effect, MuJoCo's, which knows none, and
ours with it.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace

from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import G_M_S2
from sitl.vehicle.airframe import Airframe, load
from sitl.vehicle.disturbances import Wind
from sitl.vehicle.vehicle import Vehicle
from sitl.vessel.contact import DeckShape, Ground

TITLE = "Contact: MuJoCo"
VEHICLE = Path(__file__).parents[2] / "configs/vehicles/quad_1_5kg.toml"
STEP_S, FINER = 0.0025, 5
LASTS_S, MOTORS_OFF_S = 2.0, 0.3
PERIOD_S, PHASES = 9.0, np.array([2.5, 1.7, 0.4])
SOFT, STOP_PER_S, IMPRATIO, FOOT_M = 0.001, 500.0, 1000.0, 0.002
"""MuJoCo's impedance, so low that its contact is a plain spring and damper; the rate at which friction stops a slip within its
limit, 1/s; how much stiffer friction is than the spring. Three times as much or as little changes no slide by 2 mm."""
FALLEN_DEG = 20.0
ALIKE, ALIKE_CM, ALIKE_DEG = 0.2, 0.5, 3.0
"""Largest differences of slide (a share, or cm where that is more) and tilt of rows that agree."""
MODEL = Path(__file__).with_suffix(".xml")


@dataclass(frozen=True)
class Case:
    """A landing: the state at its begin against the deck, and what the deck and the air do."""

    name: str
    v: tuple[float, float, float] = (0.0, 0.0, 0.35)
    rp_deg: tuple[float, float] = (0.0, 0.0)
    height_m: float = 0.02
    thrust: float = 0.6
    wind: float = 0.0
    cut: bool = False
    sea: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Amplitudes of surge and heave, m, and of roll, rad."""
    thing: tuple[float, float, float, float] = field(default=(0.0, 0.0, 0.0, 0.0))
    """Place on the deck, radius and height of a disc that lies there, m."""

    def deck(self, t: float) -> tuple[F64, F64]:
        """Return surge, heave and roll, and their rates."""
        size, w = np.array(self.sea), math.tau / PERIOD_S
        return size * np.sin(w * t + PHASES), size * w * np.cos(w * t + PHASES)

    def frame(self, t: float) -> tuple[F64, F64, F64, F64]:
        """Return the deck's place, velocity and rotation in ned, and its turn rate in its own axes."""
        (x, z, roll), (vx, vz, rate) = self.deck(t)
        R = Rotation.from_rpy(roll, 0.0, 0.0).matrix
        return np.array([x, 0.0, z]), np.array([vx, 0.0, vz]), R, np.array([rate, 0.0, 0.0])

    def start(self, f: Airframe) -> tuple[F64, F64, F64, F64]:
        """Return place, velocity, rotation and turn rate of the vehicle, its lowest foot over the deck."""
        p, v, R, w = self.frame(0.0)
        roll, pitch = np.radians(self.rp_deg)
        R_deck_body = Rotation.from_rpy(roll, pitch, 0.0).matrix
        d = np.array([0.0, 0.0, -self.height_m - float((f.feet.corners_m @ R_deck_body.T)[:, 2].max())])
        return p + R @ d, v + R @ (np.array(self.v) + np.cross(w, d)), R @ R_deck_body, R_deck_body.T @ w


SEA = (0.2, 0.5, math.radians(4.0))
CASES = (
    Case("straight down"), Case(".3 m/s aside", (0.3, 0.0, 0.35)), Case(".6 m/s aside", (0.6, 0.0, 0.35)),
    Case("1 m/s aside", (1.0, 0.0, 0.5)), Case("tilted 8 deg, .3 m/s", (0.3, 0.1, 0.35), (3.0, 8.0)),
    Case("sea", (0.2, 0.0, 0.35), (4.0, 2.0), sea=SEA),
    Case("sea, 12 m/s of wind", (0.2, 0.0, 0.35), (0.0, -12.0), thrust=0.9, wind=12.0, sea=SEA),
    Case("as weather_4 touches: .15 m/s, tilted 10 deg into 10 m/s of wind", (0.15, 0.0, 0.36), (0.0, -10.0), wind=10.0, sea=SEA),
    Case("motors stop at .1 m", (0.2, 0.0, 0.2), height_m=0.1, thrust=1.0, cut=True),
    Case("motors stop at .2 m", (0.2, 0.0, 0.2), height_m=0.2, thrust=1.0, cut=True),
    Case("motors stop at .4 m, tilted 5 deg", (0.3, 0.0, 0.2), (0.0, 5.0), height_m=0.4, thrust=1.0, cut=True),
    Case("1.2 m/s down, sea, tilted 10 deg", (0.8, 0.0, 1.2), (10.0, 0.0), sea=SEA),
    Case("1.5 m/s aside, tilted 15 deg", (1.5, 0.0, 1.0), (0.0, 15.0)), Case("2 m/s aside", (2.0, 0.0, 1.0), (0.0, 15.0)),
    Case("a foot on a disc 3 cm high", thing=(0.12, 0.12, 0.05, 0.03), height_m=0.05),
    Case("a foot catches on an edge of 3 cm", (0.6, 0.0, 0.35), thing=(0.19, 0.12, 0.05, 0.03)),
)  # fmt: skip


class Ours:
    """Our physics."""

    step_s = STEP_S

    def __init__(self, f: Airframe, case: Case, cushion: bool = False) -> None:
        self.case = case
        self.vehicle = Vehicle(f, DeckShape(9, 9, 9, 9), STEP_S, np.random.SeedSequence(1), Wind((case.wind, 0, 0)))
        p, v, R, w = case.start(f)
        self.vehicle.place(p, v, 0.0)
        self.vehicle.q, self.vehicle.w = Rotation(R).quat_wxyz.tolist(), tuple(w)
        self.vehicle.thrust_n = self.vehicle.state.driven_n = case.thrust * f.mass_kg * G_M_S2
        self.vehicle.params.motor_driven, self.vehicle.params.effects.thing = 1, case.thing
        if not cushion:
            self.vehicle.params.effect_radius_m = 1e-9

    def step(self, t: float, motors: bool) -> tuple[F64, F64, bool]:
        """Advance to an instant; return place, rotation, and whether a foot touches."""
        if not motors:
            self.vehicle.cut_motors()
        self.vehicle.step(Ground.of(*self.case.frame(t), 50.0))
        return self.vehicle.p_ned, self.vehicle.R_ned_body, self.vehicle.state.contact_s > 0.0


class Theirs:
    """MuJoCo."""

    step_s = STEP_S / FINER

    def __init__(self, f: Airframe, case: Case) -> None:
        import mujoco

        self.engine: Any = mujoco
        self.case, self.f, feet = case, f, f.feet
        spring, damper = feet.stiffness_n_m, 2.0 * feet.DAMPING_RATIO * math.sqrt(feet.stiffness_n_m * f.mass_kg)
        share = (1.0 - SOFT) / (4.0 * f.mass_kg)
        contact = (
            f'condim="3" friction="{feet.friction} {feet.friction} 0 0 0" solimp="{SOFT} {SOFT} 1" '
            f'solref="{-spring * share} {-damper * share}" solreffriction="-1e-9 {-STOP_PER_S * SOFT}"'
        )
        x, y, radius, height = case.thing
        on_deck = ("plate", "thing")[: 1 + (height > 0.0)]
        ends = [(x, y, z) for z in (feet.below_m - FOOT_M, FOOT_M - feet.top_m) for x, y, _ in feet.corners_m]
        model = mujoco.MjModel.from_xml_string(MODEL.read_text().format(
            step=self.step_s, g=G_M_S2, imp=IMPRATIO, mass=f.mass_kg, inertia="{} {} {}".format(*f.inertia_kg_m2),
            thing=f'<geom name="thing" type="cylinder" pos="{x} {y} 0" size="{radius} {height}"/>' if height > 0.0 else "",
            feet="".join(f'<geom name="{k}" size="{FOOT_M}" pos="{x} {y} {z}"/>' for k, (x, y, z) in enumerate(ends)),
            pairs="".join(f'<pair geom1="{on}" geom2="{k}" {contact}/>' for on in on_deck for k in range(len(ends))),
        ))  # fmt: skip
        self.model, self.data = model, mujoco.MjData(model)
        p, v, R, w = case.start(f)
        self.data.qpos[3:], self.data.qvel[3:] = (*p, *Rotation(R).quat_wxyz), (*v, *w)
        self.thrust_n = self.asked_n = case.thrust * f.mass_kg * G_M_S2

    def step(self, t: float, motors: bool) -> tuple[F64, F64, bool]:
        """Advance to an instant; return place, rotation, and whether a foot touches."""
        d, f = self.data, self.f
        d.qpos[:3], d.qvel[:3] = self.case.deck(t - self.step_s)
        self.thrust_n += (1.0 - math.exp(-self.step_s / f.motor_lag_s)) * (self.asked_n * motors - self.thrust_n)
        R = Rotation.from_quat(d.qpos[6:10].copy()).matrix
        drag = -f.mass_kg * np.array(f.drag_per_s) * (R.T @ (d.qvel[3:6] - (self.case.wind, 0.0, 0.0)))
        d.xfrc_applied[2, :3] = R @ (drag - (0.0, 0.0, self.thrust_n))
        self.engine.mj_step(self.model, d)
        return d.qpos[3:6].copy(), Rotation.from_quat(d.qpos[6:10].copy()).matrix, d.ncon > 0


@dataclass(frozen=True)
class Landing:
    """The end of a landing: slide, cm, largest tilt, deg, and whether the vehicle stands."""

    slide: float
    tilt: float
    stands: bool


def landing(body: Ours | Theirs) -> Landing:
    """Land, and return how that went."""
    path, touched_s = list[tuple[float, ...]](), math.inf
    for t in body.step_s * np.arange(1, round(LASTS_S / body.step_s)):
        p, R_ned_body, touches = body.step(t, not body.case.cut and t - touched_s < MOTORS_OFF_S)
        touched_s = min(touched_s, t) if touches else touched_s
        at, _, R, _ = body.case.frame(t)
        if t >= touched_s:
            path.append((*(R.T @ (p - at)), math.degrees(math.acos(np.clip((R.T @ R_ned_body)[2, 2], -1.0, 1.0)))))
    x, y, _, tilt = np.array(path).T
    return Landing(100 * math.hypot(x[-1] - x[0], y[-1] - y[0]), float(tilt.max()), bool(tilt[-1] < FALLEN_DEG))


def agree(ours: Landing, theirs: Landing) -> bool:
    """Return whether two landings are alike."""
    near = abs(ours.slide - theirs.slide) <= max(ALIKE_CM, ALIKE * theirs.slide)
    return near and abs(ours.tilt - theirs.tilt) <= ALIKE_DEG and ours.stands == theirs.stands


def of_friction(friction: float) -> Airframe:
    """Return the vehicle on a deck of this friction."""
    quad = load(VEHICLE).airframe()
    return replace(quad, feet=replace(quad.feet, friction=friction))


def table(every: int = 1, frictions: tuple[float, ...] = (0.2, 0.4, 0.6, 0.9)) -> Iterator[str]:
    """Yield the lines of the table, of every Nth case, and how many landings agree."""
    alike, vehicles = 0, [of_friction(friction) for friction in frictions]
    yield "| slide, cm, on a friction of | " + " | ".join(f"{friction:g}" for friction in frictions) + " |"
    yield "|" + "---|" * (1 + len(frictions))
    for case in CASES[::every]:
        cells = [case.name]
        for f in vehicles:
            a, b, c = landing(Ours(f, case)), landing(Theirs(f, case)), landing(Ours(f, case, cushion=True))
            alike += agree(a, b)
            mark = "" if agree(a, b) else f" **!** tilt {a.tilt:.0f}, {b.tilt:.0f} deg"
            cells.append(f"{a.slide:.1f}, {b.slide:.1f}, {c.slide:.1f}{mark}")
        yield f"| {' | '.join(cells)} |"
    within = f"slide within {100 * ALIKE:.0f} % or {ALIKE_CM:g} cm, tilt within {ALIKE_DEG:g} degrees, standing"
    yield f"\n{alike} of {len(CASES[::every]) * len(frictions)} landings agree ({within}); **!** marks the others."
