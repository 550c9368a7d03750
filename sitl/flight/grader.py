"""Watch a flight by the simulator's truth while it is flown, and grade it."""

import math
from collections import Counter

from msgspec.structs import replace

from companion.base.health import Health
from companion.base.mission import REFUSALS, FlightOutcome, State
from companion.base.observer import Decision
from companion.base.orders import HandledOrder, OperatorOrder, StickPositions
from companion.guidance.operator.precedence import ControlSituation
from companion.settings.model import Settings
from estimator.contracts.estimates import IntegrityAlert, Verdict
from estimator.contracts.time import seconds_between
from sitl.faults.kinds import Bystander, ObjectOnPad
from sitl.flight.ending import AtEnd, Ending, FlightGrade, Grade, grade, on_pad_m, outside_commit
from sitl.flight.hands import Decides
from sitl.flight.limits import Errand
from sitl.flight.referee import Referee
from sitl.scenario.scenario import Scenario, pad_model, ship_model, vehicle_model
from sitl.world.stage import deck_shape
from sitl.world.truth import RenderedFrame, Truth
from sitl.world.world import World

GO_AROUND_PHASES = frozenset({State.GO_AROUND.value, State.ANOTHER_PAD.value})
"""The phases of guidance that end an attempt by climbing."""
_ASKS = frozenset({State.ANOTHER_PAD.value, State.STAY.value})
"""The phases of guidance that wait for a person's decision, which nobody makes in a simulation."""
RECEIVERS_M = 10.0
"""Error of a place over the ship by two receivers of 2.5 m each, three standard deviations: the way to her is flown by it."""
UNREACHED_STOP_M = 0.3
"""Way down that an AR.Drone needs to stop when nothing reaches it and it begins to hover by itself."""
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


_ROUNDED = 0.005
"""Charge by which a report in whole percent is less than what is left, at most."""


def errand_of(scenario: Scenario, settings: Settings, com_watchdog_s: float) -> Errand:
    """Return what a flight calls for.

    Without commands an AR.Drone flies on for `com_watchdog_s`, at most at the fastest rate of the way down against the deck, and
    then hovers; a landing that it begins by itself goes deeper.
    """
    g, start = settings.guidance, scenario.start
    in_air = start.where == "air"
    heights, distance_m = [start.height_m if in_air else 0.0, g.tries.safe_height_m], 0.0
    if in_air:
        distance_m = math.hypot(start.pad_forward_m, start.pad_right_m)
    rate_m_s, speed_m_s = g.cone.descent_rate_m_s, g.cone.intercept_speed_m_s
    if g.mission == "thesis":
        heights.append(g.thesis.approach_height_m)
        rate_m_s = g.thesis.speed_m_s
    if g.controller == "pid":
        rate_m_s = min(rate_m_s, g.pid.descent_rate_max_m_s)
    if g.rendezvous.enabled:
        heights.append(g.rendezvous.height_m + RECEIVERS_M)
        distance_m += RECEIVERS_M
        speed_m_s = max(speed_m_s, g.rendezvous.speed_m_s)
    if not start.with_vessel:
        speed_m_s += scenario.vessel.speed_m_s
    return Errand(
        max(heights),
        distance_m,
        speed_m_s,
        (com_watchdog_s * rate_m_s + UNREACHED_STOP_M, com_watchdog_s),
        takes_off=not in_air,
        unreached_contacts=scenario.unreached_contacts,
        battery_life_s=scenario.sensors.battery_life_s,
        safe_m=g.tries.safe_height_m,
        by_hand_m_s=settings.operator.manual.speed_max_m_s,
        held_to=0.0 if g.held_ends == "hold" else g.limits.battery + _ROUNDED,
        last_charge=g.last_charge and g.last_charge + _ROUNDED,
    )


class FlightGrader:
    """Feeds the referee of one flight, and grades the flight by what it found.

    Args:
        world: the flight's world.
        settings: the settings that are flown.
        com_watchdog_s: time for which the vehicle flies on with its last command when nothing reaches it.
    """

    def __init__(self, world: World, settings: Settings, com_watchdog_s: float) -> None:
        self.world, scenario = world, world.scenario
        vehicle = vehicle_model(scenario)
        self.feet = vehicle.airframe().feet
        """The vehicle's."""
        self.disc_radius_m = pad_model(scenario).disc_radius_m
        """Radius of the pad."""
        self.referee = Referee(
            world.now,
            errand_of(scenario, settings, com_watchdog_s),
            vehicle.contact,
            vehicle.airframe(),
            self.disc_radius_m,
            deck_shape(ship_model(scenario).hull, math.radians(scenario.vessel.pad_yaw_deg)),
        )
        """Counts, also after the outcome."""
        self._reason = ""
        self._go_arounds = 0
        self._named: dict[str, float] = {}
        self._met = False
        """True once the vehicle flew into something."""
        self._contacts = 0

    def step(self) -> None:
        """Note the true state; call it in order of time."""
        truth = self.world.truth()
        served = self.world.guidance_phase is not None
        self.referee.step(truth, reached=self.world.reached, served=served)
        self._meet(truth)

    def _meet(self, truth: Truth) -> None:
        """Note the new contacts where something lies, and the drone's first way into something that stands or flies there."""
        x, y, z = (truth.R_ned_pad.matrix.T @ (truth.p_body_ned - truth.p_pad_ned)).tolist()
        for fault, _ in self.world.faults.on(Bystander):
            words = "" if self._met else fault.met((x, y, z), seconds_between(self.world.started, truth.at))
            if words:
                self._met = True
                self.referee.hit(words)
        new, self._contacts = truth.contacts[self._contacts :], len(truth.contacts)
        for contact in new:
            x, y, _ = contact.p_body_pad.tolist()
            for thing, _ in self.world.faults.on(ObjectOnPad):
                if words := thing.touched(x, y, contact.surface):
                    self.referee.hit(words)

    def on_act(self, handled: HandledOrder, sticks: StickPositions, late_s: float = 0.0) -> None:
        """Note an order of a person and its answer; one that was refused with a reason commands nothing, but EMERGENCY does."""
        if handled.accepted or handled.order is OperatorOrder.EMERGENCY:
            self.referee.hands.acts(handled.order.value, handled.at, sticks, late_s)

    def on_verdict(self, view: RenderedFrame, verdict: Verdict) -> None:
        """Note the service's verdict on a frame."""
        self.referee.frame(view.exposed_at, verdict, true_view=view.true_view, stamp_error_s=view.stamp_error_s)

    def on_decision(self, decision: Decision) -> None:
        """Note a guidance cycle's decision, before the world learns its phase."""
        goes_around, went_around = (phase in GO_AROUND_PHASES for phase in (decision.phase, self.world.guidance_phase))
        self._go_arounds += goes_around and not went_around
        self._reason = decision.reason or self._reason
        if (belief := decision.belief) is not None:
            for output in (*belief.lost, *(alert.value for alert in belief.alerts if alert in _BLAMES)):
                self._named.setdefault(output, seconds_between(self.world.started, self.world.at))

    def result(self, outcome: FlightOutcome | None, situation: ControlSituation, health: Health) -> Ending:
        """Return how the flight ended, or the result so far; the scenario is named by its title.

        Args:
            outcome: the pilot's.
            situation: who commands now.
            health: of the service.
        """
        self.step()
        world, truth, referee = self.world, self.world.truth(), self.referee
        scenario, refused = world.scenario, self._refused(outcome)
        unreached = referee.unreached.at if scenario.unreached_contacts else ()
        unsafe, unreached_m = referee.unsafe, referee.sight.unreached_m
        worth, because = grade(
            outcome,
            on_pad_m(truth.contacts),
            unsafe,
            scenario.expect,
            AtEnd(
                left_alone=world.faults.left_alone,
                asks=world.guidance_phase in _ASKS,
                held=outcome is FlightOutcome.ABORTED or situation in (ControlSituation.HELD, ControlSituation.MANUAL),
                theirs=referee.hands.act or "",
                go_arounds=self._go_arounds,
                refusal=(scenario.refusal, refused or ""),
                put_down=bool(truth.contacts) and truth.contacts[-1].at in unreached,
            ),
        )
        if unreached_m > referee.counts["blind_m"].limit.most[Decides.GUIDANCE] and not unsafe:
            because += f"; came down {unreached_m:.2f} m while nothing reached it"
        if unreached and not unsafe:
            because += (
                "; touched "
                + ", ".join(
                    f"the {c.surface} {c.lateral_m:.2f} m from the pad's centre" for c in truth.contacts if c.at in unreached
                )
                + " then"
            )
        lowest_m = referee.sight.worst.lowest_m
        judged = FlightGrade(
            worth,
            because,
            unsafe,
            refused,
            outside_commit(truth.contacts),
            round(lowest_m, 3) if math.isfinite(lowest_m) else None,
            self._go_arounds,
            tuple((fault.words, began_s) for fault, began_s in world.faults.begun),
            scenario.expect,
            0.0,
            round(referee.highest_m, 3) if math.isfinite(referee.highest_m) else None,
            tuple(self._named.items()),
            referee.as_json(),
        )
        return Ending(
            scenario.title,
            world.seed,
            outcome,
            truth.contacts,
            seconds_between(world.started, world.at),
            Counter(health.frames),
            judged=judged,
            without_outcome="the service died" if referee.counts["died"].over else "time ran out",
            wrong_model=scenario.wrong_model.as_json(),
        )

    def regraded(self, judged: FlightGrade | None, unsafe: tuple[str, ...], spent_s: float) -> FlightGrade | None:
        """Return a grade with what was counted since; `unsafe` are the lines of counts that went over their limits since."""
        if judged is None:
            return None
        highest_m = self.referee.highest_m
        judged = replace(
            judged,
            cpu_s=spent_s,
            counts=self.referee.as_json(),
            highest_m=round(highest_m, 3) if math.isfinite(highest_m) else None,
        )
        lines = (*judged.unsafe, *unsafe)
        return replace(judged, grade=Grade.FAILED, because="; ".join(lines), unsafe=lines) if unsafe else judged

    def _refused(self, outcome: FlightOutcome | None) -> str | None:
        """Return why the pilot gave up; None if it did not."""
        if outcome not in REFUSALS:
            return None
        frames = self.referee.sight.since_sight
        counts = ", ".join(f"{n} {verdict.value}" for verdict, n in frames.most_common())
        reason = self._reason or outcome.value
        return f"{reason}; frames since the pad was last truly seen: {counts or 'none'}"
