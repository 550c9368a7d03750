"""Watch a flight by the simulator's truth while it is flown, and grade it."""

import math
from dataclasses import dataclass
from functools import partial
from typing import Protocol

from companion.base.health import Health
from companion.base.mission import REFUSALS, FlightOutcome, State
from companion.base.observer import Decision
from companion.guidance.precedence import ControlSituation
from companion.settings.model import Settings
from estimator.contracts.estimates import IntegrityAlert, Verdict
from estimator.contracts.time import MonoNs, seconds_between
from sitl.camera.solids import Solid
from sitl.faults.kinds import Bystander, ObjectOnPad
from sitl.faults.timer import FaultTimer
from sitl.flight.safety import (
    BLIND_DESCENT_MAX_M,
    GO_AROUND_PHASES,
    AtEnd,
    BlindDescent,
    Grade,
    MotionWatch,
    SightWatch,
    UnreachedContacts,
    called_for_m,
    dangers,
    grade,
    on_pad_m,
    unreached_descent_max_m,
)
from sitl.scenario.scenario import Scenario
from sitl.world.truth import RenderedFrame, Touchdown, Truth

_FEET_M = 0.12
"""Reach of a vehicle's feet from its body's origin, m."""
_BLAMES = frozenset(
    {
        IntegrityAlert.CAMERA_FROZEN,
        IntegrityAlert.IMU_FROZEN,
        IntegrityAlert.ATTITUDE_FROZEN,
        IntegrityAlert.IMU_LATE,
        IntegrityAlert.RANGE,
        IntegrityAlert.HEIGHT,
    }
)
"""Alerts that name a sensor; the other ones say that two disagree, or that no sensor is meant."""


class GradedWorld(Protocol):
    """Interface of a flight's world that the grader needs."""

    @property
    def scenario(self) -> Scenario: ...

    @property
    def started(self) -> MonoNs: ...

    @property
    def now(self) -> MonoNs: ...

    @property
    def at(self) -> MonoNs:
        """Instant of the newest step of the physics."""
        ...

    @property
    def faults(self) -> FaultTimer: ...

    @property
    def reached(self) -> bool:
        """True if commands reach the vehicle."""
        ...

    @property
    def guidance_phase(self) -> str | None: ...

    def active(self, kind: str) -> bool: ...

    def truth(self) -> Truth: ...


@dataclass(frozen=True, slots=True)
class FlightResult:
    """The result of one flight."""

    outcome: FlightOutcome | None
    """The pilot's outcome; None if the scenario's time ran out."""
    duration_s: float
    touchdown: Touchdown | None
    """The newest contact."""
    health: Health
    truth: Truth
    """The true state at the end of the flight."""
    blind: BlindDescent
    """The deepest descent without true sight of the pad."""
    unsafe: tuple[str, ...]
    """The unsafe events, one line each."""
    grade: Grade
    because: str
    """The reason for the grade."""
    refused: str | None
    """The reason why the pilot gave up; None if it did not."""
    go_arounds: int
    """Number of go-arounds."""
    faults: tuple[tuple[str, float], ...]
    """Each fault that began, in words, and the time at which it began, in seconds after the start."""
    highest_m: float = -math.inf
    """Highest height over the highest level of the pad so far, while guidance commanded."""
    named: tuple[tuple[str, float], ...] = ()
    """The estimator's words on each sensor that it did not trust, and when they came first, in seconds after the start."""

    @property
    def landed_on_pad(self) -> bool:
        return self.outcome is FlightOutcome.LANDED and self.touchdown is not None and self.touchdown.on_pad


class FlightGrader:
    """Watches one flight and grades it.

    Args:
        world: the flight's world.
        settings: the settings that are flown.
        com_watchdog_s: time for which the vehicle flies on with its last command when nothing reaches it.
    """

    def __init__(self, world: GradedWorld, settings: Settings, com_watchdog_s: float) -> None:
        self.died: str | None = None
        """Reason for which the service died; None if it did not."""
        self._world = world
        self._watch = SightWatch(world.now)
        self._unreached = UnreachedContacts()
        start = world.scenario.start
        highest_m = called_for_m(settings.guidance, start.height_m if start.where == "air" else 0.0)
        self.motion = MotionWatch(highest_m, settings.guidance.cone.feet_below_m)
        """Watches height and standing, also after the outcome."""
        self._unreached_max_m = partial(unreached_descent_max_m, settings.guidance, com_watchdog_s)
        self._reason = ""
        self._go_arounds = 0
        self._named: dict[str, float] = {}
        self._on_things: list[str] = []
        """Contacts with things on the pad and about it."""
        self._flew_into: str | None = None
        self._contacts = 0

    def step(self) -> None:
        """Note the true state; call it in order of time."""
        truth, reached = self._world.truth(), self._world.reached
        self._watch.step(truth, reached=reached)
        self._unreached.step(truth, reached=reached)
        self.motion.step(truth, self._world.guidance_phase, reached=reached)
        self._meet(truth)

    def _meet(self, truth: Truth) -> None:
        """Note the new contacts where something lies, and the drone's first way into something that stands or flies there."""
        if self._flew_into is None and (bodies := self._world.faults.on(Bystander)):
            x, y, z = (truth.R_ned_pad.matrix.T @ (truth.p_body_ned - truth.p_pad_ned)).tolist()
            for fault, _ in bodies:
                at = Solid.of(fault).place_m(seconds_between(self._world.started, truth.at))
                off_m = math.hypot(x - float(at[0]), y - float(at[1]))
                over = -z < fault.height_m + _FEET_M and (fault.thing in ("box", "person") or -z > fault.height_m - _FEET_M)
                if over and off_m < 0.5 * fault.width_m + _FEET_M:
                    self._flew_into = f"flew into a {fault.thing}, {off_m:.2f} m from its middle"
                    self._on_things.append(self._flew_into)
        new, self._contacts = truth.contacts[self._contacts :], len(truth.contacts)
        for contact in new:
            x, y, _ = contact.p_body_pad.tolist()
            for thing, _ in self._world.faults.on(ObjectOnPad):
                off_m = math.hypot(x - thing.forward_m, y - thing.right_m)
                if thing.thing != "wet patch" and off_m < 0.5 * thing.size_m + _FEET_M:
                    self._on_things.append(f"touched a {thing.thing} on the {contact.surface}, {off_m:.2f} m from its middle")

    def on_verdict(self, view: RenderedFrame, verdict: Verdict) -> None:
        """Note the service's verdict on a frame."""
        self._watch.frame(view.exposed_at, verdict, true_view=view.true_view, stamp_error_s=view.stamp_error_s)

    def on_decision(self, decision: Decision) -> None:
        """Note a guidance cycle's decision, before the world learns its phase."""
        goes_around, went_around = (phase in GO_AROUND_PHASES for phase in (decision.phase, self._world.guidance_phase))
        self._go_arounds += goes_around and not went_around
        self._reason = decision.reason or self._reason
        if (belief := decision.belief) is not None:
            for output in (*belief.lost, *(alert.value for alert in belief.alerts if alert in _BLAMES)):
                self._named.setdefault(output, seconds_between(self._world.started, self._world.at))

    def result(self, outcome: FlightOutcome | None, situation: ControlSituation, health: Health) -> FlightResult:
        """Return the result of the flight so far.

        Args:
            outcome: the pilot's.
            situation: who commands now.
            health: of the service.
        """
        world, truth, unreached_m = self._world, self._world.truth(), self._watch.unreached_m
        scenario, refused = world.scenario, self._refused(outcome)
        self._unreached.step(truth, reached=world.reached)
        unreached = self._unreached.at if scenario.unreached_contacts else ()
        unreached_max_m = self._unreached_max_m(self._watch.deck_fell_m_s)
        self._meet(truth)
        unsafe = dangers(
            self._watch.worst,
            truth.contacts,
            self.died,
            unreached_m,
            unreached_max_m,
            unreached=unreached,
            motion=self.motion,
        )
        unsafe = (*unsafe, *self._on_things)
        worth, because = grade(
            outcome,
            on_pad_m(truth.contacts),
            unsafe,
            scenario.expect,
            AtEnd(
                left_alone=world.active("service_killed") or world.active("link_lost"),
                asks=world.guidance_phase == State.ANOTHER_PAD.value,
                held=outcome is FlightOutcome.ABORTED or situation in (ControlSituation.HELD, ControlSituation.MANUAL),
                go_arounds=self._go_arounds,
                refusal=(scenario.refusal, refused or ""),
                put_down=bool(truth.contacts) and truth.contacts[-1].at in unreached,
            ),
        )
        if unreached_m > BLIND_DESCENT_MAX_M and not unsafe:
            because += f"; came down {unreached_m:.2f} m while nothing reached it"
        if unreached and not unsafe:
            because += (
                "; touched "
                + ", ".join(
                    f"the {c.surface} {c.lateral_m:.2f} m from the pad's centre" for c in truth.contacts if c.at in unreached
                )
                + " then"
            )
        return FlightResult(
            outcome,
            seconds_between(world.started, world.at),
            truth.touchdown,
            health,
            truth,
            self._watch.worst,
            unsafe,
            worth,
            because,
            refused,
            self._go_arounds,
            tuple((fault.words, began_s) for fault, began_s in world.faults.begun),
            self.motion.highest_m,
            tuple(self._named.items()),
        )

    def _refused(self, outcome: FlightOutcome | None) -> str | None:
        """Return why the pilot gave up; None if it did not."""
        if outcome not in REFUSALS:
            return None
        frames = self._watch.since_sight
        counts = ", ".join(f"{n} {verdict.value}" for verdict, n in frames.most_common())
        reason = self._reason or outcome.value
        return f"{reason}; frames since the pad was last truly seen: {counts or 'none'}"
