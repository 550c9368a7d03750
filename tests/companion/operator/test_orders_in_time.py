"""Orders in time: through no door is something begun or taken that was given before a stop, and every stop is carried out."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.base.orders import HandledOrder, OrderSender, OrderSource
from companion.base.orders import OperatorOrder as Order
from companion.guidance.operator.arbiter import OperatorArbiter
from companion.guidance.operator.order_time import BEGINS, UNKNOWN, Stops, given_at
from estimator.contracts.samples import VehicleStatus
from estimator.contracts.time import MonoNs, Stamp
from tests.make import ns
from tests.support.doors import DOORS, LATE_DOORS, Deliver, Doors
from tests.support.toy_autopilot import PAGE, Guidance

OTHER = OrderSender(OrderSource.TERMINAL, "another")


class Flight:
    """A service in flight in virtual time, with its doors."""

    def __init__(self) -> None:
        self.t_s = 10.0
        self.others_at: MonoNs | None = None
        self.guidance = Guidance()
        self.arbiter = OperatorArbiter(self.guidance)
        self.handled: list[HandledOrder] = []
        self.arbiter.on_order = self.handled.append
        self.give = Doors(self.arbiter, self.now, self.pass_s).give
        self.pass_s(0.1)

    def now(self) -> MonoNs:
        return ns(self.t_s)

    def pass_s(self, seconds: float, others_at: MonoNs | None = None) -> None:
        """Go on; the vehicle reports that it flies, and what others did."""
        self.others_at = others_at or self.others_at
        for _ in range(round(seconds / 0.05)):
            self.t_s += 0.05
            stamp = Stamp(self.now(), self.now(), 0.0, "arrival")
            self.guidance.vehicle = VehicleStatus(stamp, True, "guided", 0.9, False, True, others_at=self.others_at)
            self.arbiter.tick(self.now())
            self.arbiter.choose(self.now(), None)


STOPS = (Order.HOLD, Order.ABORT, Order.LAND, Order.MANUAL, Order.EMERGENCY, None)
"""Stops by another person; None is a pilot's mode."""
GIVEN = st.sampled_from([(door, order) for door, orders in DOORS.items() for order in orders])


@pytest.mark.hazard("H5", "H6", "A3")
@settings(max_examples=150, deadline=None)
@given(st.lists(st.one_of(GIVEN, st.sampled_from(STOPS), st.sampled_from([0.05, 0.4, 1.0, 2.5])), max_size=14), st.randoms())
def test_nothing_begins_by_any_door_that_was_given_before_a_stop(acts: Any, random: Any) -> None:
    flight, under_way, stopped_at = Flight(), list[tuple[float, str, Order, Deliver]](), -1.0
    for act in acts:
        if isinstance(act, float):
            flight.pass_s(act)
        elif isinstance(act, tuple):
            under_way.append((flight.t_s, *act, flight.give(*act)))
        elif act is None:
            stopped_at = flight.t_s
            flight.pass_s(0.05, flight.now())
        elif flight.arbiter.take(act, OTHER, flight.now()).accepted:
            stopped_at = flight.t_s
            if act is Order.EMERGENCY:
                flight.arbiter.take(Order.RESET, OTHER, flight.now())
                flight.pass_s(1.0)
            if act is Order.MANUAL:
                flight.arbiter.take(Order.RELEASE, OTHER, flight.now())
        if under_way and random.random() < 0.5:
            drawn = random.choice(under_way)
            one_connection = drawn[1] in ("page", "terminal")  # which keeps the order
            arrives = next(one for one in under_way if one is drawn or (one_connection and one[1] == drawn[1]))
            under_way.remove(arrives)
            given_s, door, order, deliver = arrives
            flight.pass_s(0.55)
            flight.handled.clear()
            deliver()
            late = door in LATE_DOORS and given_s < stopped_at
            begun = [h.order for h in flight.handled if h.accepted and h.order in BEGINS]
            assert not (late and begun), f"{door}: {begun} of {given_s:.2f} after the stop of {stopped_at:.2f}"
            if order in (Order.HOLD, Order.ABORT) and flight.guidance.outcome is None:
                assert [h.order for h in flight.handled if h.accepted] == [order]
            if any(h.accepted and h.order in (Order.HOLD, Order.ABORT, Order.LAND, Order.MANUAL) for h in flight.handled):
                stopped_at = flight.t_s


@pytest.mark.hazard("A2", "A10")
@pytest.mark.parametrize("door", [door for door, orders in DOORS.items() if Order.HOLD in orders])
def test_a_stop_is_carried_out_each_time_it_comes_and_a_new_begin_follows_it(door: str) -> None:
    flight = Flight()
    for _ in range(3):
        deliver = flight.give(door, Order.HOLD)
        for _ in range(2):
            flight.pass_s(0.6)
            assert flight.arbiter.take(Order.BEGIN, OTHER, flight.now()).accepted
            flight.pass_s(0.3)
            deliver()
            assert flight.guidance.paused, "a copy that comes later stops again"
    flight.pass_s(0.6)
    if Order.BEGIN in DOORS[door]:
        flight.give(door, Order.BEGIN)()
        assert not flight.guidance.paused


def test_a_late_begin_is_refused_in_words_and_its_sender_reads_what_came_since() -> None:
    flight = Flight()
    late = flight.give("mqtt", Order.BEGIN)
    flight.pass_s(2.0)
    flight.pass_s(6.0, flight.now())
    late()
    refusal = flight.handled[-1].refusal
    assert refusal == "it was given 8.0 s ago, and since then somebody else chose for the vehicle: give it again"
    flight.arbiter.take(Order.EMERGENCY, OTHER, flight.now())
    assert flight.arbiter.take(Order.RESET, PAGE, flight.now(), given_at=ns(17.0)).refusal.endswith('"emergency": give it again')
    assert flight.arbiter.take(Order.RESET, PAGE, flight.now()).accepted


def test_an_age_that_cannot_be_counts_as_older_than_everything() -> None:
    now = ns(100.0)
    assert given_at(now, 2.0) == ns(98.0)
    assert given_at(now, -0.1) == now, "who counts on from our time may be a little ahead"
    assert all(given_at(now, age_s) == UNKNOWN for age_s in (None, -1.0, float("nan"), float("-inf")))


def test_a_release_that_was_given_before_the_sticks_were_taken_gives_nothing_back() -> None:
    """WHY: one that came 4 s late took the sticks from the person who had taken them since (weather_3, 894114)."""
    pilot = OrderSender(OrderSource.GAMEPAD, "pilot")
    taken = Stops().on_order(Order.MANUAL, pilot, ns(10.0))
    assert taken.since(Order.RELEASE, pilot, ns(6.0), ns(10.1)) is not None
    assert taken.since(Order.RELEASE, pilot, ns(10.5), ns(10.6)) is None
