"""The operations of one sender of orders on the pilot, each through the arbiter, and the state of the flight that it sees."""

from collections.abc import Callable
from typing import Protocol

from companion.base.mission import FLOWN, ORDERED, State
from companion.base.observer import Decision, NullObserver
from companion.base.orders import HandledOrder, OperatorOrder, OrderSender
from companion.facts.wire import FlightState, OrderAnswer, OrderRequest
from companion.guidance.operator.arbiter import NEVER_OLD
from companion.guidance.operator.order_time import given_at
from companion.guidance.operator.precedence import ControlSituation
from companion.guidance.pilot import Pilot
from estimator.contracts.estimates import RelativeState
from estimator.contracts.samples import Range, Sample
from estimator.contracts.time import Clock, MonoNs, seconds_between

_OLD_S = 3.0
"""Age of what a screen showed from which its order is refused, s; it has reported by then that no answer came."""
_RANGE_S = 1.0
"""Age up to which a range stands for a height that is not seen, s."""
_SURE_S = 1.0  # age of the newest sight up to which a vehicle that stands knows its place
_LOWER_M = 0.5  # depth below the deck from which on what is below is no deck of hers


class Operated(Protocol):
    """The operations that MQTT and MAVLink offer; each returns None if it was carried out, else the reason why it cannot be."""

    def order(self, order: OperatorOrder, given_at: MonoNs | None = None) -> str | None: ...

    def record(self, on: bool) -> str | None: ...


class PilotOperator:
    """Carries out operations; each returns None if it was carried out, else the reason why it cannot be.

    Args:
        recording: switches the recorder; None if there is no recorder.
    """

    def __init__(
        self, pilot: Pilot, sender: OrderSender, clock: Clock, recording: Callable[[bool], str | None] | None = None
    ) -> None:
        self._pilot = pilot
        self._sender = sender
        self._clock = clock
        self._recording = recording

    def order(self, order: OperatorOrder, given_at: MonoNs | None = None) -> str | None:
        """Give an order to the arbiter; `given_at` as its `take` has it."""
        return self._pilot.operator.take(order, self._sender, self._clock.now(), given_at=given_at).refusal

    def answer(self, request: OrderRequest, at_s: float | None = None) -> OrderAnswer:
        """Give an order of a screen or terminal to the arbiter, and return the answer.

        Args:
            at_s: present time of the states that a screen saw, s; None for a terminal of this computer.
        """
        age_s = request.age_s if at_s is None else None if request.seen_at_s is None else at_s - request.seen_at_s
        seen_s = age_s or 0.0
        refusal: str | None = f"it comes {seen_s:.1f} s after what you saw when you gave it: give it again"
        # Who cuts the motors sees the drone itself, whatever its screen still shows.
        if seen_s > _OLD_S and request.order not in (*NEVER_OLD, OperatorOrder.EMERGENCY):
            self._tell(request.order, refusal, "")
        elif request.order is OperatorOrder.RECORD:
            refusal = f"{request.order.value} is an order of MQTT and MAVLink"
        else:
            refusal = self.order(request.order, given_at(self._clock.now(), age_s))
        accepted = "sent until the vehicle reports it" if request.order is OperatorOrder.EMERGENCY else "accepted"
        text = accepted if refusal is None else f"refused: {self._sender.reads(refusal)}"
        return OrderAnswer(number=request.number, accepted=refusal is None, text=text)

    def record(self, on: bool) -> str | None:
        """Start or stop recording."""
        refusal = "there is no recorder in this service" if self._recording is None else self._recording(on)
        return self._tell(OperatorOrder.RECORD, refusal, "on" if on else "off")

    def _tell(self, order: OperatorOrder, refusal: str | None, detail: str) -> str | None:
        return self._pilot.operator.tell(HandledOrder(self._clock.now(), self._sender, order, refusal, detail)).refusal


class FlightWatch(NullObserver):
    """Observes the state of the flight as the senders of orders see it."""

    def __init__(self, pilot: Pilot, clock: Clock) -> None:
        self._pilot = pilot
        self._clock = clock
        self.decision: Decision | None = None
        """The newest decision; None before the first."""
        self._range: Range | None = None

    def on_decision(self, decision: Decision) -> None:
        self.decision = decision

    def on_sample(self, sample: Sample) -> None:
        if type(sample) is Range:
            self._range = sample

    def _reason(self, decision: Decision | None, situation: ControlSituation) -> str:
        mission, by = self._pilot.landing.mission, self._pilot.operator.ordered_by
        goal = "" if mission.state not in FLOWN else "to stay over the pad" if mission.stays else "to land"
        if by is not None and (mission.lands_here or mission.state in (State.PAUSED, State.ABORTED)):
            goal = f"ordered by {by}"
        # With the motors cut nothing flies, and the sensors of a drone that lies there say nothing of interest.
        silent = decision is None or decision.reason == ORDERED.text or situation is ControlSituation.EMERGENCY
        reason = "" if decision is None or silent else decision.reason
        return "; ".join(filter(None, (goal if by is not None or not reason else "", reason)))

    def state(self, sender: OrderSender) -> FlightState:
        """Return the present state as this sender sees it."""
        now, decision = self._clock.now(), self.decision
        status = self._pilot.operator.newest_status(now)
        belief = self.belief(now)
        height_m = self._range_m(now) if belief is None else belief.height_m
        hand, (below, over_pad) = self._pilot.operator.hand, self.below(now)
        taken_from, why = self._pilot.operator.hand_taken or (None, "")
        situation = self._pilot.operator.situation(now)
        return FlightState(
            situation=situation.value,
            phase="" if decision is None else decision.phase,
            reason=sender.reads(self._reason(decision, situation)),
            hand=None if hand is None else sender.reads(str(hand)),
            yours=hand == sender,
            hand_taken=sender.reads(why) if sender == taken_from else "",
            flying=None if status is None else status.flying,
            mode=None if status is None else status.mode,
            battery_fraction=None if status is None else status.battery_fraction,
            height_m=height_m,
            lateral_m=None if belief is None else belief.lateral_m,
            below=below,
            over_pad=over_pad,
            bars=self._pilot.barred()[0],
        )

    def belief(self, now: MonoNs) -> RelativeState | None:
        """Return the steering estimate if its place may be shown; what stands on a deck and does not see it knows no place."""
        belief, status = None if self.decision is None else self.decision.belief, self._pilot.operator.newest_status(now)
        stands = status is not None and status.flying is False
        return belief if belief is not None and belief.placed and not (stands and belief.age_s(now) > _SURE_S) else None

    def below(self, now: MonoNs) -> tuple[str, bool]:
        """Return where a landing that is ordered now touches, in words, and whether that is surely the pad, and it is clear."""
        touch, belief, bars = self._pilot.landing.touch(), self.belief(now), self._pilot.barred()[0]
        text, range_m = touch.text, self._range_m(now)
        if belief is not None and not touch.on_pad:
            # Nothing else knows where a deck ends.
            lower_m = 0.0 if range_m is None or not belief.consistent else range_m - belief.height_m
            what = "over deck or water" if lower_m < _LOWER_M else f"over water, or a deck that is {lower_m:.1f} m lower"
            text = f"{text}; now {what}"
        sure = touch.on_pad and not touch.unsure and touch.spread_m <= self._pilot.pad.disc_radius_m and not bars
        return "; ".join(filter(None, (text, bars))), sure

    def _range_m(self, now: MonoNs) -> float | None:
        fresh = self._range is not None and seconds_between(self._range.stamp.received_at, now) < _RANGE_S
        return self._range.range_m if fresh and self._range is not None else None
