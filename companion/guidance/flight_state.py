"""An observer that knows the state of the flight as the senders of orders see it."""

from companion.base.observer import Decision, NullObserver
from companion.base.orders import OrderSender
from companion.facts.wire import FlightState
from companion.guidance.pilot import Pilot
from estimator.contracts.ports import Clock
from estimator.contracts.samples import Range, Sample
from estimator.contracts.time import seconds_between

_RANGE_S = 1.0


class FlightWatch(NullObserver):
    """Keeps the newest decision and the newest range."""

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

    def state(self, sender: OrderSender) -> FlightState:
        """Return the present state as this sender sees it."""
        now, decision = self._clock.now(), self.decision
        status = self._pilot.operator.newest_status(now)
        belief = None if decision is None else decision.belief
        height_m = None if belief is None else belief.height_m
        if height_m is None and self._range is not None and seconds_between(self._range.stamp.received_at, now) < _RANGE_S:
            height_m = self._range.range_m
        hand = self._pilot.operator.hand
        return FlightState(
            situation=self._pilot.operator.situation(now).value,
            phase="" if decision is None else decision.phase,
            reason="" if decision is None else decision.reason,
            hand=None if hand is None else str(hand),
            yours=hand == sender,
            flying=None if status is None else status.flying,
            mode=None if status is None else status.mode,
            battery_fraction=None if status is None else status.battery_fraction,
            height_m=height_m,
            lateral_m=None if belief is None else belief.lateral_m,
        )
