"""A point over a pad that does what the machine says, with a lag: flights of the mission without estimator, law or vehicle."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from msgspec import structs

from companion.base.mission import Event, State, StateChange
from companion.base.response_in_use import ResponseInUse
from companion.guidance.controller import Impact, Knowledge, Target
from companion.guidance.mission.cycle import GuidanceCycle, VehicleHold
from companion.guidance.mission.machine import mission_step, take_order, take_status
from companion.guidance.mission.phase import Aim
from companion.guidance.mission.progress import Progress
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.commands import Hover, Land, Velocity
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64
from tests.make import change, deck, estimate, ns, status

DT = 0.05


def guided(mission="cone", **changes: dict[str, object]) -> GuidanceOptions:
    """Return options with some keys changed, by section: `guided(tries={"go_arounds_max": 1})`."""
    return change(GuidanceOptions(mission=mission), **changes)


def holding(s: GuidanceCycle, over_ground: bool) -> GuidanceCycle:
    """Return the cycle of a vehicle that holds over the ground, or of one that holds against the deck."""
    return structs.replace(s, hold=VehicleHold(over_ground))


@dataclass
class PointFlight:
    """A flight of a point with a lag of 0.3 s; on the deck it stands when told to stop the motors."""

    d: F64
    options: GuidanceOptions = field(default_factory=GuidanceOptions)
    sight: Callable[[float, F64], bool] = lambda t, d: True
    track: Callable[[float], int] = lambda t: 1
    pad_v: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rolled: Callable[[float, F64], float] = lambda t, d: 0.0
    """The deck's roll, rad."""
    response: ResponseInUse | None = None
    battery: float | None = None
    silent_s: float = 0.0
    """Time since the newest sample of the vehicle."""
    stands: bool = True
    feels: bool = True
    over_ground: bool = False
    """Its own hover holds over the ground, and the deck's velocity is added to every velocity."""
    t: float = 0.0
    v: F64 = field(default_factory=lambda: np.zeros(3))
    rows: list[tuple[float, F64, Aim, State]] = field(default_factory=list)
    changes: list[StateChange] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.d = np.array(self.d, float)
        self.progress, _ = take_status(Progress.start(automatic=True), status(0.0, True), self.options)
        self.seen: RelativeState | None = None
        self.seen_at = 0.0
        self.impact: Impact | None = None

    @property
    def states(self) -> list[State]:
        """The states in order, each once."""
        return [state for i, (*_, state) in enumerate(self.rows) if i == 0 or self.rows[i - 1][3] is not state]

    def order(self, event: Event) -> None:
        self.progress, changes = take_order(self.progress, event, ns(self.t), self.options)
        self.changes += changes

    def cycle(self) -> None:
        """Run one guidance cycle and move."""
        relative_v = np.array(self.pad_v) - self.v
        if self.sight(self.t, self.d):
            self.seen = estimate(self.t, self.d, relative_v, track=self.track(self.t))
            self.seen_at = self.t
        elif self.seen is not None:
            self.seen = estimate(self.t, self.d, relative_v, age=self.t - self.seen_at, track=self.track(self.t), sigma=0.1)
        moves = deck(self.t, self.pad_v, roll=self.rolled(self.t, self.d))
        knowledge = Knowledge(ns(self.t), self.seen, deck=moves, impact=self.impact, response=self.response)
        s = GuidanceCycle(ns(self.t), knowledge, self.battery, silent_s=self.silent_s)
        self.progress, aim, changes = mission_step(self.progress, holding(s, self.over_ground), self.options)
        self.changes += changes
        self.rows.append((self.t, self.d.copy(), aim, self.progress.state))
        self._move(aim)
        self.t += DT

    def _move(self, aim: Aim) -> None:
        wanted = np.array(self.pad_v)
        if isinstance(aim, Target):
            off = self.d - aim.d_body_pad_level
            aside = 0.9 * off[:2]
            aside *= min(1.0, aim.speed_max_m_s / max(1e-9, math.hypot(*aside)))
            rate = np.clip(1.5 * off[2], -aim.vertical_rate_max_m_s, aim.vertical_rate_max_m_s)
            wanted = wanted + np.array([*aside, rate if aim.descent_rate_m_s is None else aim.descent_rate_m_s])
        elif isinstance(aim, Velocity):
            wanted = wanted + aim.v_level
        elif isinstance(aim, Hover) and self.over_ground:
            wanted = np.zeros(3)
        elif isinstance(aim, Land):
            wanted = wanted + np.array([0.0, 0.0, 0.4])
        self.v = self.v + (wanted - self.v) * DT / 0.3
        self.d = self.d + (np.array(self.pad_v) - self.v) * DT
        if self.d[2] <= 0.0 and self.stands:
            if self.feels and self.v[2] > 0.1:
                self.impact = Impact(ns(self.t + DT), "accelerometer", 9.0)
            self.d[2], self.v[2] = 0.0, min(0.0, self.v[2])
            if isinstance(aim, Land):
                self.progress, changes = take_status(self.progress, status(self.t, False), self.options)
                self.changes += changes

    def run(self, seconds: float) -> PointFlight:
        """Fly for this long, or until it stands."""
        for _ in range(round(seconds / DT)):
            self.cycle()
            if self.progress.state is State.LANDED:
                break
        return self
