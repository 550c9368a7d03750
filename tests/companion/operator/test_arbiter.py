"""Command of the vehicle: every order in every situation, what no input of people may ever cause, and orders to a real pilot."""

import itertools
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.base.loop_lag import STOOD_S
from companion.base.mission import FlightOutcome, State
from companion.base.observer import Decision
from companion.base.orders import HandledOrder, OperatorOrder, OrderSender, OrderSource, StickPositions
from companion.guidance.controller import Knowledge
from companion.guidance.mission.progress import GuidanceCycle, Progress
from companion.guidance.operator.arbiter import BY_HAND, OperatorArbiter
from companion.guidance.operator.precedence import CROSSING_S, RANKED, REASONS, TABLE, ControlSituation, Rule
from companion.guidance.pilot import Pilot, make_pilot
from companion.guidance.pilot_operator import FlightWatch, PilotOperator
from companion.settings.load import load
from companion.settings.operator import LimitOptions
from estimator.contracts.commands import CutMotors, Hover, Land, LeaveEmergency, TakeOff, Velocity
from estimator.contracts.samples import Range, VehicleStatus
from estimator.contracts.time import MonoNs, Stamp, after
from tests.make import attitude, estimate, status, velocity
from tests.support.mqtt_service import vehicle_status

PAD, OTHER = OrderSender(OrderSource.GAMEPAD, "pad"), OrderSender(OrderSource.MAVLINK)
GUIDED = Velocity(np.array([0.1, 0.0, 0.2]), 0.0)
PERIOD_S = 0.02


@dataclass
class Guidance:
    """Guidance as the arbiter sees it: what it was told, and what it would command."""

    vehicle: VehicleStatus | None = None
    outcome: Enum | None = None
    paused: bool = False
    lands_here: bool = False
    told: list[str] = field(default_factory=list)
    barred: Callable[[], tuple[str, bool]] = lambda: ("a crate", True)

    @property
    def may_begin(self) -> bool:
        return self.vehicle is not None and self.vehicle.flying is not False

    def begin(self, at: MonoNs, word: str = "begin") -> None:
        self.told.append(word)
        self.outcome, self.paused, self.lands_here = None, False, word == "land"

    def land(self, at: MonoNs) -> None:
        self.begin(at, "land")

    def stay(self, at: MonoNs) -> None:
        self.begin(at, "stay")

    def hold(self, why: object = None) -> None:
        self.told.append("hold")
        self.paused, self.lands_here = True, False

    def overrule(self) -> None:
        self.told.append("overrule")

    def abort(self) -> None:
        self.told.append("abort")
        self.outcome, self.lands_here = self.outcome or FlightOutcome.ABORTED, False


class Bridge:
    """An arbiter, its guidance and its clock."""

    def __init__(self, limits: LimitOptions | None = None) -> None:
        self.guidance = Guidance()
        self.arbiter = OperatorArbiter(self.guidance, limits=limits)
        self.reported: list[HandledOrder] = []
        self.arbiter.on_order = self.reported.append
        self.now = MonoNs(10**9)

    def vehicle(self, flying: bool | None = True, *, emergency: bool = False, taken: str | None = None) -> None:
        stamp = Stamp(self.now, self.now, 0.001, "sim")
        self.guidance.lands_here &= flying is not False and not emergency and taken is None
        self.guidance.vehicle = VehicleStatus(stamp, flying, "hovering", 0.9, emergency, True, taken)

    def order(self, order: OperatorOrder, sender: OrderSender = PAD) -> str | None:
        return self.arbiter.take(order, sender, self.now).refusal

    def cycle(self, seconds: float = PERIOD_S, *, heard: bool = True) -> object:
        """Run guidance cycles for this long, and return the last command."""
        command: object = None
        for _ in range(max(1, round(seconds / PERIOD_S))):
            self.now = after(self.now, PERIOD_S)
            if heard and self.guidance.vehicle is not None:
                self.vehicle(self.guidance.vehicle.flying, emergency=self.guidance.vehicle.emergency)
            self.arbiter.tick(self.now)
            guided = Land() if self.guidance.lands_here else Hover() if self.guidance.paused else GUIDED
            command = self.arbiter.choose(self.now, guided).command
        return command

    def sticks(self, sender: OrderSender = PAD, **positions: float) -> None:
        self.arbiter.move(sender, StickPositions(**positions), self.now)


def bridge_in(situation: ControlSituation) -> Bridge:
    """Return an arbiter in this situation; `PAD` has the hand or ordered the landing where there is one."""
    bridge = Bridge()
    if situation is not ControlSituation.UNHEARD:
        bridge.vehicle(
            situation not in (ControlSituation.GROUND, ControlSituation.DONE), emergency=situation is ControlSituation.EMERGENCY
        )
    match situation:
        case ControlSituation.DONE:
            bridge.guidance.outcome = FlightOutcome.LANDED
        case ControlSituation.OVER:
            bridge.guidance.outcome = FlightOutcome.ABORTED
        case ControlSituation.EMERGENCY:
            bridge.guidance.outcome = FlightOutcome.EMERGENCY
        case ControlSituation.HELD:
            bridge.guidance.paused = True
        case ControlSituation.MANUAL:
            assert bridge.order(OperatorOrder.MANUAL) is None
        case ControlSituation.LANDING:
            assert bridge.order(OperatorOrder.LAND) is None
        case ControlSituation.CUTTING:
            assert bridge.order(OperatorOrder.EMERGENCY) is None
    bridge.now = after(bridge.now, 0.1)
    assert bridge.arbiter.situation(bridge.now) is situation
    return bridge


def test_every_order_has_a_rule_in_every_situation_and_every_refusal_a_text() -> None:
    assert set(TABLE) == set(OperatorOrder)
    assert all(set(row) == set(ControlSituation) for row in TABLE.values())
    assert set(REASONS) == set(Rule) - {Rule.YES}
    assert [o for o in TABLE if o in RANKED] == list(RANKED), "the table lists the orders by rank"


@pytest.mark.hazard("H5")
@pytest.mark.parametrize("situation", ControlSituation)
@pytest.mark.parametrize("order", OperatorOrder)
def test_the_arbiter_answers_by_the_table(order: OperatorOrder, situation: ControlSituation) -> None:
    bridge = bridge_in(situation)
    bridge.now = after(bridge.now, CROSSING_S)  # another sender's order before is no longer crossing
    rule = TABLE[order][situation]
    refused = bridge.order(order, OTHER)
    if rule is Rule.YES:
        assert refused is None
    else:
        assert refused is not None
        if rule in (Rule.HOLDER, Rule.IDLE):
            assert "gamepad pad" in refused
    assert bridge.reported[-1].refusal == refused
    bridge.guidance.barred = lambda: ("a man", False)
    assert order is not OperatorOrder.CLEAR or bridge.order(order) is not None, "what moves is not ignored"
    still = bridge_in(situation)
    still.arbiter.tick(still.now)
    still.now = after(still.now, STOOD_S + 0.1)
    for _ in range(2):
        old = "2.1 s: give it again" in str(still.order(order, OTHER))
        assert old is (order not in (OperatorOrder.HOLD, OperatorOrder.ABORT, OperatorOrder.RELEASE))
        still.cycle()
    still.cycle(1.1)
    assert "give it again" not in str(still.order(order, OTHER))
    if rule in (Rule.HOLDER, Rule.IDLE):
        own = bridge_in(situation).order(order)
        assert own == ("the vehicle flies already" if order is OperatorOrder.TAKE_OFF else None)


def test_of_two_crossing_orders_the_first_in_the_table_wins_whichever_arrives_first() -> None:
    for first, second in (
        (OperatorOrder.ABORT, OperatorOrder.BEGIN),
        (OperatorOrder.HOLD, OperatorOrder.BEGIN),
        (OperatorOrder.STAY, OperatorOrder.BEGIN),
        (OperatorOrder.HOLD, OperatorOrder.STAY),
        (OperatorOrder.HOLD, OperatorOrder.LAND),
        (OperatorOrder.ABORT, OperatorOrder.LAND),
    ):
        bridge = bridge_in(ControlSituation.GUIDED)
        assert bridge.order(first, OTHER) is None
        bridge.cycle(0.1)
        refused = bridge.order(second)
        assert refused is not None
        bridge = bridge_in(ControlSituation.GUIDED)
        assert bridge.order(second) is None
        bridge.cycle(0.1)
        assert bridge.order(first, OTHER) is None
    bridge = bridge_in(ControlSituation.GUIDED)
    assert bridge.order(OperatorOrder.HOLD, OTHER) is None
    assert bridge.order(OperatorOrder.BEGIN, OTHER) is None, "one sender's orders are in order"
    bridge = bridge_in(ControlSituation.GUIDED)
    assert bridge.order(OperatorOrder.HOLD, OTHER) is None
    bridge.cycle(CROSSING_S + 0.1)
    assert bridge.order(OperatorOrder.BEGIN) is None, "a person who saw the hold may end it"


def test_sticks_command_only_with_the_hand_and_centred_sticks_hover() -> None:
    bridge = bridge_in(ControlSituation.GUIDED)
    bridge.sticks(forward=1.0)
    assert bridge.cycle() is GUIDED
    assert bridge.arbiter.ignored_sticks == 1
    assert bridge.order(OperatorOrder.MANUAL) is None
    assert bridge.cycle() == Hover()
    bridge.sticks(forward=0.5, right=-1.0, climb=1.0, turn=0.5)
    command = bridge.cycle()
    assert isinstance(command, Velocity)
    assert command.v_level.tolist() == [0.5, -1.0, -0.5]
    assert command.yaw_rate_rad_s == pytest.approx(0.5 * np.radians(45.0))
    bridge.sticks(OTHER, forward=-1.0)
    again = bridge.cycle()
    assert isinstance(again, Velocity)
    assert again.v_level.tolist() == command.v_level.tolist()
    assert bridge.arbiter.choose(bridge.now, GUIDED).phase == BY_HAND
    assert bridge.order(OperatorOrder.RELEASE) is None
    assert bridge.cycle() == Hover(), "guidance stays paused after the hand is given back"
    assert bridge.order(OperatorOrder.BEGIN) is None
    assert bridge.cycle() is GUIDED


@pytest.mark.hazard("H5")
@pytest.mark.parametrize("stop", [OperatorOrder.HOLD, OperatorOrder.ABORT])
def test_anybody_stops_a_vehicle_that_another_person_flies_by_hand(stop: OperatorOrder) -> None:
    bridge = bridge_in(ControlSituation.MANUAL)
    bridge.sticks(forward=1.0, climb=-1.0)
    assert isinstance(bridge.cycle(CROSSING_S), Velocity)
    assert bridge.order(stop, OTHER) is None
    assert bridge.arbiter.hand is None
    assert bridge.arbiter.hand_taken == (PAD, f'{OTHER} ordered "{stop.value}"')
    for _ in range(5):
        bridge.sticks(forward=1.0, climb=-1.0)
        assert isinstance(bridge.cycle(0.1), Hover), "sticks that are still pushed move nothing"
    assert bridge.arbiter.ordered_by == OTHER
    bridge.cycle(CROSSING_S)
    assert bridge.order(OperatorOrder.MANUAL) is None, "who saw the stop may fly on"
    bridge.sticks(forward=1.0)
    assert isinstance(bridge.cycle(0.1), Velocity)


def test_an_idle_hand_may_be_taken_by_another_person_and_a_moving_one_may_not() -> None:
    """A remote shell that hangs leaves a process that sends centred sticks for nobody."""
    bridge = bridge_in(ControlSituation.GUIDED)
    bridge.order(OperatorOrder.MANUAL)
    for second in range(8):
        bridge.sticks(forward=1.0 if second < 4 else 0.0)
        bridge.cycle(0.4)
        bridge.sticks(forward=1.0 if second < 4 else 0.0)
        assert bridge.order(OperatorOrder.MANUAL, OTHER) == "gamepad pad has the hand, and moved it in the last 3 s"
        bridge.cycle(0.1)
    for _ in range(8):
        bridge.sticks()
        bridge.cycle(0.2)
    assert bridge.order(OperatorOrder.MANUAL, OTHER) is None
    assert bridge.arbiter.hand == OTHER
    bridge.sticks(forward=1.0)
    assert bridge.cycle() == Hover()


@pytest.mark.hazard("H6")
@pytest.mark.parametrize("how", ["silence", "lost"])
def test_a_lost_hand_is_a_hold_and_never_the_last_stick(how: str) -> None:
    bridge = bridge_in(ControlSituation.GUIDED)
    bridge.order(OperatorOrder.MANUAL)
    bridge.sticks(forward=1.0)
    assert isinstance(bridge.cycle(), Velocity)
    if how == "lost":
        bridge.arbiter.lost(OTHER, bridge.now, "unplugged")
        assert bridge.arbiter.hand == PAD
        bridge.arbiter.lost(PAD, bridge.now, "unplugged")
        assert bridge.cycle() == Hover()
    else:
        assert isinstance(bridge.cycle(0.44), Velocity)
        assert bridge.cycle(0.1) == Hover()
    assert bridge.arbiter.hand is None
    assert bridge.guidance.paused
    assert (bridge.reported[-1].order, bridge.reported[-1].accepted) == (OperatorOrder.HOLD, True)
    assert str(bridge.arbiter.hand_taken).endswith(": it hovers')"), "who lost the hand learns why"
    bridge.sticks(forward=1.0)
    assert bridge.cycle() == Hover(), "sticks that come back do not take the hand back"
    bridge.order(OperatorOrder.MANUAL)
    bridge.order(OperatorOrder.EMERGENCY, OTHER)
    assert bridge.arbiter.hand_taken == (PAD, f'{OTHER} ordered "emergency"')


def test_a_persons_landing_is_guidances_own_and_is_called_off_by_the_hand_without_starting_motors() -> None:
    bridge = bridge_in(ControlSituation.GUIDED)
    assert bridge.order(OperatorOrder.LAND) is None
    assert bridge.guidance.told == ["land"]
    assert bridge.arbiter.choose(bridge.now, GUIDED).command is GUIDED, "guidance flies it"
    ends = (OperatorOrder.MANUAL, OperatorOrder.TAKE_OFF, OperatorOrder.HOLD, OperatorOrder.ABORT)
    for calls_off, sender in itertools.product(ends, (PAD, OTHER)):
        bridge = bridge_in(ControlSituation.LANDING)
        bridge.cycle(CROSSING_S)
        assert bridge.order(calls_off, sender) is None
        assert bridge.cycle() == Hover(calls_off=True)
        commands = [bridge.cycle() for _ in range(50)]
        assert not any(isinstance(c, TakeOff | Land) for c in commands)
        assert bridge.arbiter.situation(bridge.now) is not ControlSituation.LANDING
    bridge = bridge_in(ControlSituation.LANDING)
    bridge.vehicle(False)
    bridge.cycle()
    assert bridge.arbiter.situation(bridge.now) is ControlSituation.GROUND


def test_a_take_off_is_sent_once_and_again_if_the_link_did_not_take_it() -> None:
    bridge = bridge_in(ControlSituation.GROUND)
    assert bridge.order(OperatorOrder.TAKE_OFF) is None
    assert bridge.cycle() == TakeOff()
    assert bridge.cycle() is GUIDED
    bridge.arbiter.undelivered(TakeOff(), bridge.now)
    assert bridge.cycle() == TakeOff()
    bridge.cycle(1.0)
    bridge.arbiter.undelivered(TakeOff(), bridge.now)
    assert bridge.cycle() is GUIDED, "not a second later, unexpectedly"


@pytest.mark.hazard("H6")
def test_an_order_is_passed_on_however_late_the_next_cycle_comes() -> None:
    """On a machine that is too slow a hold was accepted, expired before the next cycle, and the landing went on."""
    for late_s in (0.02, 0.3, 2.0):
        bridge = bridge_in(ControlSituation.GUIDED)
        for order, command in ((OperatorOrder.LAND, Land()), (OperatorOrder.HOLD, Hover(calls_off=True))):
            assert bridge.order(order) is None
            bridge.now = after(bridge.now, late_s)
            assert bridge.cycle() == command, (order, late_s)
        assert bridge.cycle(0.2) == Hover()


@pytest.mark.hazard("H4")
def test_an_emergency_that_does_not_arrive_is_sent_until_it_does_and_its_sender_is_told() -> None:
    """It was sent for half a second, and dropped while the vehicle was silent."""
    bridge = bridge_in(ControlSituation.GROUND)
    assert bridge.order(OperatorOrder.TAKE_OFF) is None
    assert bridge.order(OperatorOrder.EMERGENCY) is None
    for _ in range(200):
        assert bridge.cycle(heard=False) == CutMotors()
        assert bridge.arbiter.situation(bridge.now) is ControlSituation.CUTTING
        bridge.arbiter.undelivered(CutMotors(), bridge.now, "no autopilot is connected")
        assert bridge.order(OperatorOrder.TAKE_OFF) is not None
    (said,) = [one for one in bridge.reported if one.order is OperatorOrder.EMERGENCY and not one.accepted]
    assert said.sender == PAD
    assert said.refusal == "not obeyed yet, and sent until it is: no autopilot is connected"
    bridge.vehicle(False, emergency=True)
    assert not isinstance(bridge.cycle(), CutMotors | TakeOff)
    assert (bridge.reported[-1].order, bridge.reported[-1].detail) == (OperatorOrder.EMERGENCY, "(obeyed)")
    assert bridge.arbiter.situation(bridge.now) is ControlSituation.EMERGENCY


@pytest.mark.hazard("H4")
def test_a_reset_that_is_not_obeyed_is_reported_and_no_order_points_to_it_again() -> None:
    bridge = bridge_in(ControlSituation.EMERGENCY)
    assert bridge.order(OperatorOrder.TAKE_OFF) == 'the motors were cut: "reset" first'
    assert bridge.order(OperatorOrder.RESET) is None
    bridge.cycle(0.4)
    assert bridge.cycle() == LeaveEmergency()
    assert bridge.cycle(1.8) != LeaveEmergency()
    _, said = [one for one in bridge.reported if not one.accepted]
    assert (said.order, said.sender) == (OperatorOrder.RESET, PAD)
    assert "switch it off and on" in str(said.refusal)
    assert "switch it off and on" in str(bridge.order(OperatorOrder.TAKE_OFF))
    bridge.vehicle(False)
    bridge.cycle()
    assert (bridge.reported[-1].order, bridge.reported[-1].detail) == (OperatorOrder.RESET, "(obeyed)")
    assert bridge.order(OperatorOrder.TAKE_OFF) is None


@pytest.mark.hazard("H6")
@pytest.mark.parametrize("order", [OperatorOrder.HOLD, OperatorOrder.ABORT])
def test_a_hold_and_an_abort_end_a_take_off_whether_it_was_sent_or_not(order: OperatorOrder) -> None:
    for sent in (False, True):
        bridge = bridge_in(ControlSituation.GROUND)
        bridge.order(OperatorOrder.TAKE_OFF)
        assert not sent or bridge.cycle() == TakeOff()
        assert bridge.order(order) is None
        assert bridge.cycle() == Hover(calls_off=True)
        assert bridge.cycle(0.2) != TakeOff()


def test_a_landing_ends_with_the_pilot_who_takes_the_vehicle_and_another_order_takes_it_back() -> None:
    bridge = bridge_in(ControlSituation.LANDING)
    bridge.vehicle(taken="mode loiter")
    bridge.cycle(heard=False)
    assert bridge.arbiter.situation(bridge.now) is not ControlSituation.LANDING
    assert bridge.order(OperatorOrder.LAND) is None
    assert bridge.guidance.told[-1] == "land", "which takes it back"
    assert bridge.cycle() == Land()


def test_a_landing_that_is_ordered_before_the_vehicle_was_heard_is_its_own_until_guidance_knows_of_a_flight() -> None:
    bridge = bridge_in(ControlSituation.UNHEARD)
    assert bridge.order(OperatorOrder.LAND) is None
    assert bridge.cycle(1.0) == Land(here=True)
    assert bridge.arbiter.situation(bridge.now) is ControlSituation.LANDING
    bridge.vehicle(True)
    bridge.cycle()
    assert bridge.guidance.told == ["land"]
    for flying in (True, False):
        ground = bridge_in(ControlSituation.GROUND)
        assert ground.order(OperatorOrder.LAND) is None
        assert ground.cycle() == Land(here=True), "motors that turn on the deck are stopped"
        ground.vehicle(flying)
        ground.cycle(0.3)
        assert ground.guidance.told == [], "nobody lands what lifts off after"
        assert ground.arbiter.situation(ground.now) is not ControlSituation.LANDING


@pytest.mark.parametrize("fenced", [False, True])
def test_no_limit_holds_a_persons_landing_back(fenced: bool) -> None:
    """A fence that brakes it would tear it off the deck that it follows; one that pauses it would reverse his order."""
    limits = LimitOptions(fence="start", fence_radius_m=5.0) if fenced else LimitOptions()
    bridge = Bridge(limits)
    bridge.vehicle(True)
    moves = {"velocity": velocity(0.0, (0.1, 0.0, 0.0)), "attitude": attitude(0.0), "flying": True}
    bridge.arbiter._place = msgspec.structs.replace(bridge.arbiter._place, p_start_ned=(9.0, 0.0), **moves)
    held = bridge.cycle(2.9)
    assert (held is not GUIDED) is fenced
    bridge.order(OperatorOrder.LAND)
    for _ in range(100):
        bridge.now = after(bridge.now, PERIOD_S)
        assert bridge.arbiter.choose(bridge.now, GUIDED).command is GUIDED
    assert not bridge.guidance.paused


ENDS_LANDING = {OperatorOrder(name) for name in ("manual", "takeoff", "emergency", "hold", "abort", "begin", "stay")}
EVENTS = st.lists(
    st.one_of(
        st.tuples(st.sampled_from(OperatorOrder), st.sampled_from([PAD, OTHER])),
        st.tuples(st.just("sticks"), st.sampled_from([PAD, OTHER])),
        st.tuples(st.just("lost"), st.sampled_from([PAD, OTHER])),
        st.tuples(st.just("vehicle"), st.sampled_from(["flies", "stands", "emergency", "says nothing"])),
        st.tuples(st.just("wait"), st.sampled_from([0.02, 0.2, 0.6, 4.0])),
    ),
    max_size=40,
)


@pytest.mark.hazard("H6")
@settings(max_examples=150)
@given(EVENTS)
def test_whatever_people_do_nothing_commands_without_its_order(events: list[tuple[object, object]]) -> None:
    bridge = Bridge()
    bridge.vehicle(True)
    landed_by, cut, emergency, moved_at = False, False, False, dict[object, MonoNs]()
    for what, whom in events:
        if isinstance(what, OperatorOrder):
            accepted = bridge.order(what, whom) is None  # type: ignore[arg-type]
            landed_by = (landed_by or (what is OperatorOrder.LAND and accepted)) and not (accepted and what in ENDS_LANDING)
            assert not (accepted and cut and what in RANKED[1:]), "nothing is ordered behind a cut that is not confirmed"
            cut = (cut or (what is OperatorOrder.EMERGENCY and accepted)) and not (what is OperatorOrder.RESET and accepted)
            if accepted and what is OperatorOrder.MANUAL:
                moved_at[whom] = bridge.now
        elif what == "sticks":
            bridge.sticks(whom, forward=1.0)  # type: ignore[arg-type]
            moved_at[whom] = bridge.now
        elif what == "lost":
            bridge.arbiter.lost(whom, bridge.now, "unplugged")  # type: ignore[arg-type]
        elif what == "vehicle":
            flying = {"flies": True, "stands": False}.get(str(whom))
            emergency = whom == "emergency"
            bridge.vehicle(flying, emergency=emergency)
        command = bridge.cycle(float(whom) if what == "wait" else PERIOD_S)  # type: ignore[arg-type]
        hand = bridge.arbiter.hand
        cut = cut and not emergency
        assert cut == isinstance(command, CutMotors) == (bridge.arbiter.situation(bridge.now) is ControlSituation.CUTTING)
        assert landed_by or not isinstance(command, Land)
        if hand is not None:
            assert (bridge.now - moved_at[hand]) * 1e-9 <= 0.5 + 2 * PERIOD_S
            assert command is not GUIDED, "guidance never flies while a person has the hand"
        if isinstance(command, Velocity) and command is not GUIDED:
            assert hand is not None


def flying() -> Pilot:
    pilot = make_pilot(load("sim"))
    pilot.on_sample(vehicle_status(MonoNs(1)))
    return pilot


class StillClock:
    """A clock that stands."""

    def now(self) -> MonoNs:
        return MonoNs(2)

    async def sleep(self, seconds: float) -> None:
        raise AssertionError(seconds)


def operating(pilot: Pilot, recording: Callable[[bool], str | None] | None = None) -> PilotOperator:
    return PilotOperator(pilot, OrderSender(OrderSource.MQTT), StillClock(), recording)


@pytest.mark.hazard("H6")
def test_start_pause_and_abort_reach_the_pilot_and_only_an_order_to_begin_follows_an_abort() -> None:
    pilot = flying()
    operator = operating(pilot)
    assert operator.order(OperatorOrder.HOLD) is None
    assert pilot.decide(MonoNs(2)).phase == "paused"
    assert operator.order(OperatorOrder.BEGIN) is None
    assert pilot.decide(MonoNs(3)).phase != "paused"
    assert operator.order(OperatorOrder.ABORT) is None
    assert pilot.outcome is FlightOutcome.ABORTED
    assert isinstance(pilot.decide(MonoNs(4)).command, Hover)
    assert operator.order(OperatorOrder.HOLD) is None, "a stop is accepted each time it comes"
    assert pilot.outcome is FlightOutcome.ABORTED, "a hold takes nothing from an abort"
    assert operator.order(OperatorOrder.BEGIN) is None
    assert pilot.state is State.SEARCH


@pytest.mark.hazard("H6")
@settings(max_examples=30)
@given(st.lists(st.sampled_from([*set(OperatorOrder) - {OperatorOrder.EMERGENCY}, "taken", "silent"]), max_size=8), st.booleans())
def test_who_lifts_the_vehicle_keeps_it_until_an_order_in_flight(said: list[object], taken: bool) -> None:
    """An order to begin on the ground never lapsed: the next lift-off by hand was put into the velocity mode at 2 cm."""
    pilot, now = flying(), MonoNs(1)
    pilot.landing.mission = Progress.start(automatic=False)

    def report(mode: str, seconds: float, *, his: bool) -> None:
        nonlocal now
        now = after(now, seconds)
        pilot.on_sample(msgspec.structs.replace(vehicle_status(now, mode), taken="mode loiter" if his else None))
        pilot.operator.tick(now)

    for what in (*said, "taken" if taken else "given back"):
        report("landed", 4.0 if what == "silent" else 1.0, his=what == "taken")
        accepted = isinstance(what, OperatorOrder) and pilot.operator.take(what, PAD, now).accepted
        assert not accepted or what not in (OperatorOrder.BEGIN, OperatorOrder.STAY)
    report("flying", 1.0, his=taken)
    assert pilot.state is State.READY, "an order to land is not kept on the ground either"
    assert pilot.operator.take(OperatorOrder.BEGIN, PAD, now).accepted
    report("flying", 0.0, his=True)
    assert pilot.state is State.SEARCH, "a report from before the order"
    report("flying", 1.0, his=True)
    assert pilot.state is State.TAKEN


@pytest.mark.parametrize("on", [True, False])
def test_recording_is_switched_where_there_is_a_recorder(on: bool) -> None:
    switched: list[bool] = []

    def switch(wanted: bool) -> str | None:
        switched.append(wanted)
        return "the disk is full" if wanted else None

    assert operating(flying()).record(on) == "there is no recorder in this service"
    assert operating(flying(), switch).record(on) == ("the disk is full" if on else None)
    assert switched == [on]


@pytest.mark.hazard("H9")
def test_every_order_is_reported_with_its_answer() -> None:
    pilot, reported = flying(), list[HandledOrder]()
    pilot.operator.on_order = reported.append
    operator = operating(pilot)
    operator.order(OperatorOrder.HOLD)
    operator.record(True)
    operator.order(OperatorOrder.ABORT)
    operator.order(OperatorOrder.TAKE_OFF)
    assert [h.order.value for h in reported] == ["hold", "record", "abort", "takeoff"]
    assert [h.accepted for h in reported] == [True, False, True, False]
    assert str(reported[-1]) == "mqtt: takeoff: refused, the vehicle flies already"


@pytest.mark.hazard("H9")
def test_a_person_reads_where_a_landing_would_end() -> None:
    """Beside the pad, and where sight is old or uncertain, nothing is surely the pad; a lower surface may be water."""
    pilot = flying()
    watch, page = FlightWatch(pilot, StillClock()), OrderSender(OrderSource.PAGE, "1 (::1)")
    radius_m = pilot.pad.disc_radius_m

    def below(off_m: float, sigma_m: float = 0.01, range_m: float = 2.0, age_s: float = 0.0, ok: bool = True) -> tuple[str, bool]:
        watch.on_sample(Range(Stamp(MonoNs(2), MonoNs(2), 0.001, "sim"), range_m, 0.02))
        belief = estimate(0.0, (off_m, 0.0, 2.0), sigma=sigma_m, age=age_s, consistent=ok)
        pilot.landing._cycle = GuidanceCycle(MonoNs(2), Knowledge(MonoNs(2), belief))
        watch.on_decision(Decision(MonoNs(2), "search", None, belief))
        state = watch.state(page)
        return state.below, state.over_pad

    assert watch.state(page).below == "where no pad is known: this may be deck, rail or water"
    assert below(0.1) == ("on the pad, within 15 cm of its centre, in 3 s", True)
    text, sure = below(0.1, age_s=3.0)
    where = r"toward the pad, up to \d\.\d m off its centre, in 5 s: this may be deck, rail or water"
    assert re.fullmatch(f"{where}; the place of the pad is not sure: last seen 3 s ago", text), text
    assert not sure
    assert below(2.9, ok=False)[0].startswith("where no pad is known")
    assert below(0.1, sigma_m=radius_m)[1] is False
    beside = "2.9 m beside the pad, +-15 cm, in 3 s; now over water, or a deck that is 1.9 m lower"
    assert below(2.9, range_m=3.9) == (beside, False)
    assert below(0.1, sigma_m=1.2, range_m=3.9)[0].startswith("0.1 m beside the pad, +-")
    assert (watch.state(page).height_m, watch.state(page).lateral_m) == (3.9, None), "what is not known is no figure"
    pilot.landing.barred = lambda: ("a crate", True)  # type: ignore[method-assign]
    pilot.barred = pilot.landing.barred
    assert below(0.1) == ("on the pad, within 15 cm of its centre, in 3 s; a crate", False)


def test_each_person_reads_his_own_orders_as_his_and_no_connection_s_number() -> None:
    one, two = OrderSender(OrderSource.PAGE, "1 (10.0.0.2)"), OrderSender(OrderSource.PAGE, "12 (10.0.0.3)")
    text = f"ordered by {one}, then by {two} and terminal 3 (process 7, user 0)"
    assert one.reads(text) == "ordered by you, then by another page (10.0.0.3) and a terminal (process 7, user 0)"
    assert two.reads(text) == "ordered by another page (10.0.0.2), then by you and a terminal (process 7, user 0)"


def test_after_a_fall_the_estimator_restarts_on_the_same_path() -> None:
    """WHY: after a cut, 25 s on the deck and a take-off the old filter had the drone 250 m under the pad."""
    pilot = make_pilot(load("sim"), shadows=["median_mean"])
    known = []
    for n, emergency in enumerate((False, True, True, False, False)):
        pilot.on_sample(status(100.0 + n, emergency=emergency))
        known.append(pilot.estimator)
    assert [known[0] is one for one in known] == [True, True, True, False, False]
    assert known[4] is known[3], "at the end of the emergency alone"
    assert known[3].paths == known[0].paths == ["ekf", "median_mean"]
