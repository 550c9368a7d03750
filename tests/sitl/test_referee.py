"""The referee of simulated flights, by crafted truths: each count just inside and just outside its limit, and invariances."""

import math
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Struct, field
from msgspec.structs import replace

from companion.base.mission import FlightOutcome
from companion.base.orders import StickPositions
from companion.guidance.operator.arbiter import BY_HAND, LANDING_FOR_PERSON
from companion.settings.guidance import GuidanceOptions, PidOptions
from companion.settings.load import SHIPPED
from companion.settings.load import load as load_settings
from drivers.ardrone.at import REF_BASE, REF_EMERGENCY, REF_TAKE_OFF, ComWdg, Pcmd, Ref
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import mav
from drivers.mavlink.setpoint import velocity_setpoint
from drivers.mavlink.vehicle import HOLD_MODE, LAND_MODE, VELOCITY_MODE, Stack, custom_mode, reposition, set_mode
from estimator.contracts.commands import Velocity
from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import GeoPoint, Rotation
from estimator.contracts.time import MonoNs, after
from sitl.emulators.autopilots.observed_body import MavlinkWires
from sitl.flight.ending import AtEnd, Grade, grade, on_pad_m, outside_commit
from sitl.flight.grader import RECEIVERS_M, UNREACHED_STOP_M, errand_of
from sitl.flight.hands import Asks, SentPacket, of_at
from sitl.flight.referee import STAMP_ERROR_MAX_S, Errand, Referee, SightWatch, limits_of, unsafe_contacts
from sitl.scenario.scenario import load
from sitl.vehicle.airframe import ContactSettings
from sitl.vehicle.airframe import load as load_vehicle
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.truth import Touchdown, Truth

START = MonoNs(0)
FRAME, CONTACT, RADIUS_M = load_vehicle(SHIPPED / "vehicles/quad_1_5kg.toml").airframe(), ContactSettings(), 0.39
FEET = FRAME.feet
ERRAND = Errand(highest_m=7.0, farthest_m=5.0, fastest_m_s=1.5, unreached_m=(1.7, 2.0), battery_life_s=1000.0)
FLIES, LANDS, LANDED, CUT = VehiclePhase.FLYING, VehiclePhase.LANDING, VehiclePhase.LANDED, VehiclePhase.EMERGENCY
STARTS = VehiclePhase.TAKING_OFF


class Step(Struct, frozen=True):
    """One instant of a crafted flight: lengths in m, in the pad frame of a deck at rest unless it says otherwise."""

    at_s: float
    clearance: float = 3.0
    aside: float = 0.0
    tilt_deg: float = 0.0
    v: tuple[float, float, float] = (0.0, 0.0, 0.0)
    deck_up: float = 0.0
    deck_falls: float = 0.0
    phase: VehiclePhase = FLIES
    battery: float = 0.9
    reached: bool = True
    served: bool = True
    seen: bool = True
    contacts: tuple[Touchdown, ...] = ()
    acts: tuple[tuple[str, StickPositions], ...] = ()
    sent: tuple[SentPacket, ...] = field(default=())

    ship: float = 0.0
    """Way that the ship has gone ahead, and its speed unless that is given."""
    ship_m_s: float | None = None

    def truth(self, yaw_rad: float = 0.0, at_ned: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Truth:
        """Return the true state, with the whole world turned and moved."""
        turned = Rotation.from_rpy(0.0, 0.0, yaw_rad)
        R = turned @ Rotation.from_rpy(math.radians(self.tilt_deg), 0.0, 0.0)
        lowest = float((R.matrix @ FEET.corners_m.T)[2].max())
        pad = turned.matrix @ np.array([self.ship, 0.0, -self.deck_up]) + at_ned
        body = pad + turned.matrix @ np.array([self.aside, 0.0, -self.clearance - lowest])
        v_pad = turned.matrix @ np.array([self.ship if self.ship_m_s is None else self.ship_m_s, 0.0, self.deck_falls])
        return Truth(
            after(START, self.at_s), body, turned.matrix @ np.array(self.v), R, pad, v_pad, turned, self.phase,
            self.contacts[-1] if self.contacts else None, self.contacts, battery=self.battery,
        )  # fmt: skip


def judged(steps: list[Step], errand: Errand = ERRAND, **world: Any) -> Referee:
    """Return a referee that saw all steps."""
    referee = Referee(START, errand, CONTACT, FRAME, RADIUS_M)
    for step in steps:
        at = after(START, step.at_s)
        for act, sticks in step.acts:
            referee.hands.acts(act, at, sticks)
        for wire in step.sent:
            referee.hands.sent(wire)
        if step.seen:
            referee.frame(at, Verdict.FUSED, true_view=True, stamp_error_s=0.0)
        referee.step(step.truth(**world), reached=step.reached, served=step.served)
    return referee


def touched(surface: Literal["pad", "deck", "water"] = "pad", at_s: float = 0.0, **over: Any) -> Touchdown:
    base = Touchdown(after(START, at_s), surface, np.zeros(3), 0.1, 0.0, 0.4, 0.0, LANDS, True, "commit", over_rim_m=-0.1)
    return replace(base, **over)


def contact(**over: Any) -> list[Step]:
    return [Step(0.0, contacts=(touched(**over),))]


def holds(seconds: float, **of: Any) -> list[Step]:
    """Return steps in one state for this long, and one in the safe air after it."""
    return [*(Step(0.25 * n, **of) for n in range(round(4 * seconds))), Step(seconds)]


def bounced(times: int, height: float = 0.2) -> list[Step]:
    heights = [0.0, *([height, 0.0] * times)]
    return [Step(0.1 * n, clearance) for n, clearance in enumerate(heights)]


def ordered(act: str, sent_s: float, asks: Asks) -> list[Step]:
    """Return a flight in which the last packet of a kind that does not obey is sent this long after an act."""
    act_at = Step(1.0, acts=((act, StickPositions()),))
    return [Step(0.0), act_at, Step(1.0 + sent_s, sent=(SentPacket(after(START, 1.0 + sent_s), asks),))]


HOLD = (("hold", StickPositions()),)
TIPS, LEANS = FRAME.falls_deg, FRAME.contact_tilt_deg(CONTACT.into_deck_max_m_s)
DROP_M = CONTACT.into_deck_max_m_s**2 / (2 * 9.80665)
EDGES: dict[str, tuple[Callable[[float], list[Step]], float, float]] = {
    "in_water": (lambda n: contact(surface="water") if n else [Step(0.0)], 0, 1),
    "off_pad": (lambda n: contact(surface="deck", over_rim_m=0.02) if n else contact(), 0, 1),
    "into_deck_m_s": (lambda v: contact(foot_speed_m_s=v), 1.0, 1.01),
    "along_deck_m_s": (lambda v: contact(lateral_speed_m_s=v), 0.5, 0.51),
    "contact_tilt_deg": (lambda tilt: contact(tilt_rad=math.radians(tilt)), LEANS - 0.1, LEANS + 0.1),
    "tipped_deg": (lambda tilt: [Step(0.0, 0.0, tilt_deg=tilt, phase=LANDED)], TIPS - 0.1, TIPS + 0.1),
    "bounces": (lambda n: bounced(round(n)), 2, 3),
    "motors_off_m": (lambda h: [Step(0.0, h), Step(0.05, h, phase=CUT)], DROP_M - 1e-3, DROP_M + 1e-3),
    "on_deck_s": (lambda s: holds(s, clearance=0.0, aside=0.1), 3.0, 3.25),
    "low_outside_s": (lambda s: holds(s, clearance=0.9, aside=RADIUS_M + 0.01), 5.0, 5.25),
    "away_m": (lambda d: [Step(0.0, aside=5.0), Step(1.0, aside=d)], 24.9, 25.1),
    "fast_m_s": (lambda v: [Step(0.0, v=(0.0, v, 0.0))], 4.5, 4.6),
    "high_m": (lambda h: [Step(0.0, h - FEET.below_m)], 9.99, 10.01),
    "ending_battery": (lambda s: holds(s, battery=0.05), 25.0, 25.25),
    "held_sank_m": (lambda h: [Step(0.0, acts=HOLD), Step(0.1), Step(0.2, 3.0 - h)], 0.49, 0.51),
    "disobeyed_s": (lambda s: ordered("land", s, Asks.MOVE), 0.3, 0.31),
    "unordered": (lambda n: [Step(0.0, 0.0, phase=LANDED), Step(1.0, 0.0, phase=STARTS if n else LANDED)], 0, 1),
    "blind_m": (lambda h: [Step(0.0), Step(1.5, seen=False), Step(1.6, 3.0 - h, seen=False)], 0.49, 0.51),
    "unreached_m": (lambda h: [Step(0.0), Step(0.5, reached=False), Step(0.6, 3.0 - h, reached=False)], 1.69, 1.71),
}  # fmt: skip
"""A flight by its value for each count, and values just inside and just outside the limit."""


@pytest.mark.parametrize("name", EDGES)
def test_each_count_is_safe_just_inside_its_limit_and_unsafe_just_outside(name: str) -> None:
    flight, inside, outside = EDGES[name]
    within, beyond = judged(flight(inside)), judged(flight(outside))
    assert within.unsafe == ()
    assert [count for count, of in beyond.counts.items() if of.over] == [name]
    assert len(beyond.unsafe) == 1
    assert beyond.as_json()[name][0] > beyond.as_json()[name][1]


def test_every_count_has_a_source_and_an_edge() -> None:
    limits = limits_of(ERRAND, CONTACT, FRAME)
    assert limits.keys() == EDGES.keys() | {"died", "flew_into"}, "those two are events that are handed in"
    assert all(limit.source for limit in limits.values())
    given = limits_of(ERRAND, ContactSettings(tilt_max_deg=15.0), FRAME)
    assert given["contact_tilt_deg"].most == 15.0, "the vehicle's file"
    hard = limits_of(ERRAND, ContactSettings(into_deck_max_m_s=2.0), FRAME)["motors_off_m"]
    assert hard.most == pytest.approx(4.0 * DROP_M)
    referee = judged([])
    referee.died("KeyError: 'x' (pilot.py:3)")
    referee.hit("flew into a bird, 0.20 m from its middle")
    assert referee.counts["flew_into"].over
    referee.hit("touched a vest on the pad, 0.01 m from its middle")
    assert referee.unsafe == (
        "the service died in flight: KeyError: 'x' (pilot.py:3)",
        "flew into a bird, 0.20 m from its middle; touched a vest on the pad, 0.01 m from its middle",
    )


def test_a_ship_that_goes_on_leaves_a_vehicle_that_hovers_over_the_ground() -> None:
    left = [Step(0.0), Step(1.0, aside=-90.0, ship=90.0)]
    assert judged(left).unsafe == ()
    assert judged([*left, Step(2.0, aside=-90.0 - 21.0, ship=90.0)]).unsafe == (
        "flew 26 m away from the pad, where 25 m are the most",
    )
    hovers = [Step(0.0), Step(1.0, aside=-40.0, ship=10.0, phase=VehiclePhase.HOVERING)]
    assert judged(hovers).unsafe == (), "its own hover drifts with the wind, and nobody flies it there"
    assert judged([hovers[0], replace(hovers[1], phase=FLIES)]).unsafe != ()
    rides = [Step(float(n), aside=-10.0, ship=90.0 * n, ship_m_s=90.0, v=(90.0, 0.0, 0.0)) for n in range(4)]
    behind = Step(4.0, aside=-100.0, ship=360.0, ship_m_s=90.0)
    assert judged([*rides, behind]).unsafe == (), "nor one that she has carried with her before"
    assert judged([*rides, replace(behind, aside=-150.0)]).unsafe != ()
    with_her = Step(1.0, ship=90.0, v=(90.0, 0.0, 0.0))
    assert judged([Step(0.0), with_her]).unsafe == (), "nor is one that goes with her fast"


def test_a_contact_counts_once_and_nothing_before_the_first_step() -> None:
    once = contact(surface="deck", over_rim_m=0.2)
    assert judged([*once, replace(once[0], at_s=0.1)]).counts["off_pad"].value == 1.0
    assert judged(contact(motors=False, lateral_speed_m_s=2.0)).unsafe == (), "what slides on the deck without its motors"
    places: list[dict[str, Any]] = [{"clearance": 0.0}, {"clearance": 0.5, "aside": 1.0}, {"battery": 0.05}]
    for of in places:
        assert judged([Step(9.0, **of)]).as_json().keys() <= {"away_m", "high_m"}


@pytest.mark.parametrize("name", ["on_deck_s", "low_outside_s", "away_m", "fast_m_s", "high_m", "ending_battery"])
@pytest.mark.parametrize("whose", [{"reached": False}, {"served": False}, {"phase": LANDED}])
def test_what_nobody_can_answer_is_not_charged(name: str, whose: dict[str, Any]) -> None:
    flight, _, outside = EDGES[name]
    assert name not in judged([replace(step, **whose) for step in flight(outside)]).as_json()


NOBODYS = {"held_sank_m", "disobeyed_s", "unordered", "unreached_m", "tipped_deg", "motors_off_m"}
"""Counts that go on whoever flies."""


@pytest.mark.parametrize("act", ["manual", "land", "emergency"])
@pytest.mark.parametrize("name", sorted(EDGES.keys() - NOBODYS))
def test_a_flight_that_a_person_has_is_his(name: str, act: str) -> None:
    flight, _, outside = EDGES[name]
    obeyed = {"manual": Asks.HOVER, "land": Asks.LAND, "emergency": Asks.STOP}[act]
    first = Step(-0.1, acts=((act, StickPositions(climb=-0.5)),), sent=(SentPacket(START, obeyed),))
    assert judged([first, *flight(outside)]).unsafe == ()
    assert len(judged([first, Step(-0.05, acts=(("begin", StickPositions()),)), *flight(outside)]).unsafe) == 1, "given back"


def test_a_cut_that_a_person_ordered_is_no_stop_of_ours_and_one_that_the_service_sends_is() -> None:
    cut = EDGES["motors_off_m"][0](3.0)
    assert judged(cut).unsafe == ("the motors stopped 3.00 m over the deck, where 0.05 m are the most",)
    his = Step(-0.1, acts=(("emergency", StickPositions()),), sent=(SentPacket(START, Asks.STOP),))
    assert judged([his, *cut]).unsafe == ()


STILL, GOES = Pcmd(0, 0.0, 0.0, 0.0, 0.0), Pcmd(1, 0.1, -0.2, 0.3, 0.4)
UP = Ref(REF_BASE | REF_TAKE_OFF)


def test_a_datagram_asks_for_the_gravest_of_its_commands() -> None:
    assert of_at([ComWdg()], START) is None
    assert of_at([UP, STILL], START) == SentPacket(START, Asks.HOVER)
    assert of_at([STILL], START) == SentPacket(START, Asks.CENTRED)
    assert of_at([UP, GOES], START) == of_at([GOES], START) == SentPacket(START, Asks.MOVE)
    assert of_at([Ref(REF_BASE), GOES], START) == SentPacket(START, Asks.LAND)
    assert of_at([Ref(REF_BASE | REF_TAKE_OFF | REF_EMERGENCY), GOES], START) == SentPacket(START, Asks.STOP)


@pytest.mark.parametrize(
    ("act", "obeys", "not_"),
    [
        ("hold", [Asks.HOVER, Asks.MOVE], [Asks.LAND, Asks.STOP]),
        ("abort", [Asks.HOVER, Asks.MOVE], [Asks.LAND, Asks.STOP]),
        ("land", [Asks.LAND], [Asks.MOVE, Asks.HOVER, Asks.CENTRED, Asks.STOP]),
        ("emergency", [Asks.STOP], [Asks.MOVE, Asks.HOVER, Asks.LAND]),
        ("manual", [Asks.HOVER, Asks.MOVE], [Asks.LAND, Asks.STOP]),
    ],
)
def test_an_act_is_obeyed_by_what_it_means_from_a_third_of_a_second_on(act: str, obeys: list[Asks], not_: list[Asks]) -> None:
    for asks in obeys:
        assert judged([*ordered(act, 0.1, asks), *ordered(act, 9.0, asks)[2:]]).unsafe == ()
    for asks in not_:
        assert judged(ordered(act, 0.29, asks)).unsafe == ()
        (line,) = judged(ordered(act, 5.0, asks)).unsafe
        assert line == f"a person ordered {act}, and was sent: {asks.value}, still 5.0 s later"
    late = Step(6.0, sent=(SentPacket(after(START, 6.0), not_[0]),))
    assert len(judged([*ordered(act, 0.1, obeys[0]), late]).unsafe) == 1, "to the end"


def test_a_landing_goes_on_with_the_sticks_in_the_middle_once_it_was_sent() -> None:
    """WHY: a person's landing that a dying service's sender left alone counted as disobeyed."""
    centred = Step(9.0, sent=(SentPacket(after(START, 9.0), Asks.CENTRED),))
    assert judged([*ordered("land", 0.1, Asks.LAND), centred]).unsafe == ()
    hover = replace(centred, sent=(SentPacket(after(START, 9.0), Asks.HOVER),))
    assert len(judged([*ordered("land", 0.1, Asks.LAND), hover]).unsafe) == 1, "which takes off again"


def test_silence_is_no_obedience_unless_the_motors_stand_or_no_service_runs() -> None:
    order = Step(0.0, acts=(("hold", StickPositions()),))
    assert judged([order, Step(0.4)]).unsafe == ("a person ordered hold, and was sent: nothing that obeys, still 0.4 s later",)
    assert judged([replace(order, clearance=0.0), Step(0.4, 0.0, phase=LANDED)]).unsafe == ()
    assert judged([order, Step(0.1, served=False), Step(0.5)]).unsafe == (), "a new service knows of no act"


def test_a_held_vehicle_follows_the_deck_and_is_not_charged_for_what_it_did_alone() -> None:
    held = [Step(0.0, acts=HOLD), Step(0.1)]
    assert judged([*held, Step(1.0, deck_up=-1.0)]).hands.sank_m == 0.0
    alone = [*held, Step(0.2, reached=False), Step(1.0, 2.0, reached=False), Step(1.1, 2.0)]
    assert judged(alone).hands.sank_m == 0.0
    assert judged([*alone, Step(2.0, 1.4)]).hands.sank_m == pytest.approx(0.6)
    for climb, sank_m in ((0.0, 1.0), (0.2, 1.0), (-0.2, 0.0)):
        by_hand = Step(0.0, acts=(("manual", StickPositions(climb=climb)),))
        assert judged([by_hand, Step(0.1), Step(1.0, 2.0)]).hands.sank_m == pytest.approx(sank_m), "down only by his stick"
    assert judged([*held, Step(0.2, acts=(("clear", StickPositions()),)), Step(1.0, 2.0)]).hands.sank_m == pytest.approx(1.0)


def test_nothing_starts_that_nobody_ordered() -> None:
    assert judged([Step(0.0, 0.0, phase=STARTS)]).unsafe == ("nobody ordered it: the motors started",)
    assert judged([Step(1.0), Step(2.0, sent=(SentPacket(after(START, 2.0), Asks.MODE),))]).unsafe == (), "nobody has it but we"
    down, up = Step(0.0, 0.0, phase=LANDED), Step(1.0, 0.0, phase=STARTS)
    again = [Step(2.0), Step(3.0, 0.0, phase=LANDED), Step(4.0, 0.0, phase=STARTS)]
    begins = ERRAND._replace(takes_off=True)
    assert judged([down, up], begins).unsafe == ()
    assert judged([down, up, *again], begins).unsafe == ("nobody ordered it: the motors started",)
    ask = replace(again[1], acts=(("takeoff", StickPositions()),))
    assert judged([down, up, again[0], ask, again[2]], begins).unsafe == ()
    stopped = Step(0.5, 0.0, phase=LANDED, acts=(("emergency", StickPositions()),))
    assert judged([down, stopped, up], begins).unsafe == ("nobody ordered it: the motors started",), "a cut takes the start back"
    arms = (Step(2.0, phase=LANDED, sent=(SentPacket(after(START, 2.0), Asks.ARM),)),)
    assert judged([Step(1.0, 0.0, phase=LANDED), *arms]).unsafe == ("nobody ordered it: arm",)
    assert judged([Step(1.0, 0.0, phase=LANDED), *arms], begins).unsafe == ()
    shut = [Step(0.0), Step(1.0, acts=(("disarm", StickPositions()),)), Step(1.1, phase=LANDED)]
    assert judged([*shut, *arms]).unsafe == ("nobody ordered it: arm after a person's disarm",)
    assert judged([*shut, Step(1.9, phase=LANDED, acts=(("begin", StickPositions()),)), *arms]).unsafe == ()
    by_rc = [Step(0.0, 0.0, phase=LANDED), Step(1.0, 0.0, phase=FLIES)]
    assert judged(by_rc).unsafe == ("nobody ordered it: the motors started",), "an autopilot has no phase of taking off"


SERVICE, VEHICLE = Codec(1, 191), Codec(1, 1)


def beat(stack: Stack, mode: str, *, armed: bool = True) -> bytes:
    firmware = 12 if stack is Stack.PX4 else 3
    return VEHICLE.pack(mav.MAVLink_heartbeat_message(2, firmware, 1 | 128 * armed, custom_mode(stack, mode), 4, 3))


def packed_command(number: int, *of: float) -> bytes:
    return SERVICE.pack(mav.MAVLink_command_long_message(1, 1, number, 0, *of, *[0.0] * (7 - len(of))))


def asks_mode(stack: Stack, mode: str) -> bytes:
    return SERVICE.pack(set_mode(stack, (1, 1), mode))


MOVES = SERVICE.pack(velocity_setpoint(0, (1, 1), Velocity(np.zeros(3), 0.0), 0.0))
OFF, ON = (packed_command(mav.MAV_CMD_COMPONENT_ARM_DISARM, arms) for arms in (0.0, 1.0))
AWAY = SERVICE.pack(reposition((1, 1), GeoPoint.of_degrees(54.0, 10.0, 20.0)))
UP_S = packed_command(mav.MAV_CMD_NAV_TAKEOFF)
Log = list[tuple[float, Literal["out", "in"], bytes]]


def acts_of(log: Log) -> list[tuple[float, str]]:
    """Return what a log shows as a person's, and when."""
    wires, found = MavlinkWires(), []
    for at_s, way, data in log:
        if way == "out":
            wires.to_vehicle(data, after(START, at_s))
        elif (act := wires.from_vehicle(data, after(START, at_s))) is not None:
            found.append((at_s, act))
    return found


@pytest.mark.parametrize("stack", [Stack.ARDUPILOT, Stack.PX4])
def test_a_mode_or_a_disarm_that_the_service_did_not_request_is_a_persons(stack: Stack) -> None:
    ours, his, land = VELOCITY_MODE[stack], HOLD_MODE[stack], LAND_MODE[stack]
    flies: Log = [(0.0, "in", beat(stack, ours)), (0.25, "in", beat(stack, ours))]
    assert acts_of(flies) == [], "the first mode is there, and nobody's act"
    assert acts_of([*flies, (1.0, "in", beat(stack, his)), (1.2, "in", beat(stack, his))]) == [(1.0, "mode")]
    for asked, mode in ((asks_mode(stack, land), land), (AWAY, his if stack is Stack.PX4 else ours)):
        returns: Log = [(0.0, "in", beat(stack, "auto.rtl" if stack is Stack.PX4 else "rtl"))]
        assert acts_of([*returns, (0.5, "out", asked), (3.5, "in", beat(stack, mode))]) == []
        late: Log = [(0.5, "out", asks_mode(stack, land)), (3.6, "in", beat(stack, land))]
        assert acts_of([*flies, *late]) == [(3.6, "mode")], "too late"
    landed: Log = [(0.5, "out", asks_mode(stack, land)), (1.0, "in", beat(stack, land)), (1.1, "in", beat(stack, ours))]
    assert acts_of([*flies, *landed]) == [(1.1, "mode")], "a request is used up"
    assert acts_of([*flies, *landed[:2], (1.1, "in", beat(stack, ours)), (1.2, "in", beat(stack, land))])[-1] == (1.2, "mode")
    assert acts_of([*flies, (1.0, "in", beat(stack, his, armed=False))]) == [(1.0, "disarm")]
    assert acts_of([*flies, (0.5, "out", OFF), (1.0, "in", beat(stack, his, armed=False))]) == []
    assert acts_of([*flies, (0.5, "out", ON), (1.0, "in", beat(stack, his, armed=False))]) == [(1.0, "disarm")]
    assert acts_of([(0.0, "in", beat(stack, his, armed=False)), (1.0, "in", beat(stack, ours, armed=False))]) == [], "on deck"
    gimbal = Codec(1, 154).pack(mav.MAVLink_heartbeat_message(26, 8, 0, 0, 4, 3))
    assert acts_of([*flies, (1.0, "in", gimbal)]) == []
    if stack is Stack.PX4:
        climbs: Log = [(0.5, "out", UP_S), (0.7, "in", beat(stack, "auto.takeoff")), (9.0, "in", beat(stack, his))]
        assert acts_of([*flies, *climbs]) == []
        assert acts_of([*flies, (0.3, "out", MOVES), (1.0, "in", beat(stack, his))]) == [], "it leaves OFFBOARD where they end"
        assert acts_of([*flies, (0.9, "out", MOVES), (1.0, "in", beat(stack, his))]) == [(1.0, "mode")]


def test_a_datagram_of_the_service_asks_by_its_command() -> None:
    wires = MavlinkWires()
    wires.from_vehicle(beat(Stack.PX4, "offboard"), START)

    def asks(*data: bytes) -> list[Asks]:
        return [packet.asks for one in data for packet in wires.to_vehicle(one, START)]

    modes = [asks_mode(Stack.PX4, mode) for mode in ("auto.land", "auto.rtl", "offboard", "auto.loiter")]
    assert asks(*modes) == [Asks.LAND, Asks.LEAVE, Asks.MODE, Asks.MODE]
    assert asks(OFF, ON, UP_S, AWAY, MOVES) == [Asks.STOP, Asks.ARM, Asks.ARM, Asks.LEAVE, Asks.MOVE]
    assert asks(b"\xfd\xff\x00", OFF) == [Asks.STOP], "after one that broke off"
    assert asks(MOVES + OFF) == [Asks.MOVE, Asks.STOP], "two in one datagram"
    assert asks(beat(Stack.PX4, "offboard"), packed_command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 30.0), b"\xfd\x00") == []


@pytest.mark.parametrize("sent", [MOVES, OFF, ON, AWAY, asks_mode(Stack.ARDUPILOT, "guided"), asks_mode(Stack.ARDUPILOT, "land")])
def test_nothing_is_sent_after_a_persons_mode_until_he_gives_the_vehicle_back(sent: bytes) -> None:
    def log(sent_s: float, *acts: tuple[float, str]) -> Referee:
        wires, steps = MavlinkWires(), [Step(0.0)]
        for at_s, mode in ((0.5, "guided"), (1.0, "brake")):
            if (act := wires.from_vehicle(beat(Stack.ARDUPILOT, mode), after(START, at_s))) is not None:
                steps.append(Step(at_s, acts=((act, StickPositions()),)))
        steps += [Step(at_s, acts=((act, StickPositions()),)) for at_s, act in acts]
        return judged([*steps, Step(sent_s, sent=tuple(wires.to_vehicle(sent, after(START, sent_s))))])

    assert log(1.29).unsafe == ()
    lines = log(2.0).unsafe
    assert lines[0].startswith("a person ordered mode, and was sent: "), lines
    assert log(2.0, (1.5, "hold")).unsafe == lines, "the remote control is above the computer"
    assert log(2.0, (1.5, "begin")).unsafe == ()


def test_contacts_that_no_order_could_prevent_are_excused_where_the_scenario_says_so_and_water_never() -> None:
    """The link is lost from 1 s to 4 s; contacts before, then, in the landing begun then, and long after."""
    excused = ERRAND._replace(unreached_contacts=True)

    def strays(*contacts: Touchdown, landing: tuple[float, float] = (0.0, 0.0), errand: Errand = excused) -> int:
        steps = [
            Step(
                t := 0.05 * n, 1.0, phase=LANDS if landing[0] < t < landing[1] else FLIES, reached=not 1.0 <= t < 4.0,
                contacts=tuple(c for c in contacts if c.at <= after(START, t)),
            )
            for n in range(200)
        ]  # fmt: skip
        return len(judged(steps, errand).unsafe)

    def stray(at_s: float, phase: VehiclePhase = FLIES, surface: Literal["deck", "water"] = "deck") -> Touchdown:
        return touched(surface, at_s, phase=phase, over_rim_m=0.2)

    assert [strays(stray(at_s)) for at_s in (0.5, 2.0, 4.5, 6.0)] == [1, 0, 0, 1]
    assert strays(stray(6.0, LANDS), landing=(3.9, 6.02)) == 0, "in the landing that it began without us"
    assert strays(stray(6.0, LANDS), landing=(5.5, 6.02)) == 1, "that landing somebody ordered"
    assert strays(stray(2.0, surface="water")) == 1
    assert strays(stray(2.0), errand=ERRAND) == 1


def test_a_contact_on_the_pad_within_its_limits_is_safe_whatever_the_phase() -> None:
    still = touched(phase=CUT, motors=False, guidance_phase="descend")
    strays = [touched(guidance_phase="descend"), touched(guidance_phase=None)]
    meant = [touched(), touched(guidance_phase=LANDING_FOR_PERSON), touched(guidance_phase=BY_HAND), still]
    assert outside_commit([*strays, *meant]) == 2
    assert unsafe_contacts([*strays, *meant], CONTACT, FRAME) == ()
    assert unsafe_contacts([touched("deck", lateral_m=0.48, over_rim_m=0.21)] * 2, CONTACT, FRAME) == (
        "touched the deck 0.48 m from the pad's centre, a foot 0.21 m over the rim, 2 times so",
    )


steps = st.builds(
    Step,
    at_s=st.just(0.0),
    clearance=st.sampled_from([-0.01, 0.0, 0.02, 0.1, 0.3, 0.9, 1.1, 4.0]),
    aside=st.sampled_from([0.0, 0.3, 0.5, 9.0, 12.0, 30.0]),
    tilt_deg=st.sampled_from([0.0, 10.0, 60.0]),
    v=st.tuples(*[st.floats(-6.0, 6.0)] * 3),
    phase=st.sampled_from([FLIES, LANDS, LANDED, CUT]),
    battery=st.sampled_from([0.9, 0.08]),
    reached=st.booleans(),
    served=st.booleans(),
)
flights = st.lists(st.tuples(st.integers(1, 18), steps), min_size=2, max_size=12)


def in_time(flight: list[tuple[int, Step]]) -> list[Step]:
    """Return the steps, each after a rest of some hundredths of a second."""
    at = np.cumsum([rest for rest, _ in flight]) * 0.05
    return [replace(step, at_s=float(at_s)) for at_s, (_, step) in zip(at, flight, strict=True)]


def numbers(referee: Referee) -> dict[str, float]:
    return {name: count.value for name, count in referee.counts.items()}


@given(flights, st.floats(-3.1, 3.1), st.tuples(*[st.floats(-100.0, 100.0)] * 3))
def test_the_world_may_be_turned_or_moved(flight: list[tuple[int, Step]], yaw_rad: float, at: tuple[float, float, float]) -> None:
    assert numbers(judged(in_time(flight), yaw_rad=yaw_rad, at_ned=at)) == pytest.approx(
        numbers(judged(in_time(flight))), abs=1e-6
    )


@given(flights, st.floats(0.1, 0.9))
def test_a_step_may_be_split_in_two(flight: list[tuple[int, Step]], share: float) -> None:
    whole = in_time(flight)
    split = [whole[0]]
    for step in whole[1:]:
        last = split[-1]
        split += [replace(last, at_s=last.at_s + share * (step.at_s - last.at_s)), step]
    assert numbers(judged(split)) == pytest.approx(numbers(judged(whole)), abs=1e-6)


DOWN = [(0.5 * n, 3.0 - 0.25 * n) for n in range(11)]
"""Descent from 3 m to 0.5 m in 5 s."""


def sight(*frames: tuple[float, Verdict, bool, float], unreached: tuple[float, float] = (9.0, 9.0)) -> SightWatch:
    watch = SightWatch(START)
    for at_s, verdict, true_view, error_s in frames:
        watch.frame(after(START, at_s), verdict, true_view=true_view, stamp_error_s=error_s)
    for at_s, height_m in DOWN:
        watch.step(Step(at_s, height_m - FEET.below_m).truth(), reached=not unreached[0] <= at_s < unreached[1], ours=True)
    return watch


def test_a_blind_descent_counts_from_a_second_without_true_sight_on() -> None:
    blind = sight()
    assert blind.worst.descent_m == pytest.approx(3.0 - 0.25 * 3 - 0.5)
    assert (blind.worst.lowest_m, blind.worst.blind_s) == (pytest.approx(0.5), 5.0)
    raised = judged([Step(at_s, height_m - FEET.below_m, deck_up=2.0, seen=False) for at_s, height_m in DOWN]).sight
    assert raised.worst.lowest_m == pytest.approx(0.5), "over the deck"
    assert sight((4.0, Verdict.FUSED, True, 0.99 * STAMP_ERROR_MAX_S)).worst.descent_m == 0.0
    wrong = -1.01 * STAMP_ERROR_MAX_S
    for frame in ((4.0, Verdict.FUSED, False, 0.0), (4.0, Verdict.GATED, True, 0.0), (4.0, Verdict.FUSED, True, wrong)):
        assert sight(frame).worst.descent_m > 1.0
        assert sight(frame).since_sight == {frame[1]: 1}


def test_a_descent_while_nothing_reaches_the_vehicle_is_kept_apart() -> None:
    """An AR.Drone flies on with its last command for two seconds; no order of the service could end that."""
    lost, back = sight(unreached=(2.5, 9.0)), sight(unreached=(2.0, 4.0))
    assert (lost.worst.descent_m, lost.unreached_m) == (pytest.approx(0.25), pytest.approx(1.25))
    assert back.worst.descent_m == pytest.approx(0.75), "what it did alone is not charged"
    assert back.unreached_m == pytest.approx(0.75)
    deck = ((0.0, True, 0.4), (0.1, False, 0.05), (0.5, False, 0.1), (0.7, False, 0.4), (0.8, True, 0.4), (0.9, False, -0.2))
    falls = [Step(at_s, deck_falls=m_s, reached=reached) for at_s, reached, m_s in deck]
    assert judged(falls).sight.deck_fell_m_s == pytest.approx(0.1), "as long as the last command was meant to meet the deck"
    lower = [*falls[:3], Step(0.6, 1.2, reached=False)]
    assert judged(lower).counts["unreached_m"].value == pytest.approx(1.8 - 2.0 * 0.1)


def test_a_heaving_deck_under_a_hovering_vehicle_is_neither_a_descent_nor_a_climb() -> None:
    heaves = [Step(0.5 * n, 6.0 - 2.0 * math.sin(0.3 * n), deck_up=2.0 * math.sin(0.3 * n), seen=False) for n in range(40)]
    referee = judged(heaves)
    assert referee.counts["blind_m"].value == pytest.approx(0.0, abs=1e-9)
    assert referee.highest_m < 6.2, "over the crests, and not over the troughs"


ON_PAD, RIGHT, FAILED = Grade.ON_PAD, Grade.REFUSED_RIGHTLY, Grade.FAILED
ON_IT, OTHERS, REFUSED, CUT_OFF = (
    FlightOutcome.LANDED,
    FlightOutcome.LANDED_BY_OTHERS,
    FlightOutcome.GAVE_UP,
    FlightOutcome.EMERGENCY,
)
GRADES: list[tuple[FlightOutcome | None, str, str, AtEnd, Grade, str]] = [
    (ON_IT, "pad", "land", AtEnd(), ON_PAD, ""),
    (ON_IT, "pad", "refuse", AtEnd(), ON_PAD, ""),
    (ON_IT, "deck", "either", AtEnd(), FAILED, ""),
    (ON_IT, "", "either", AtEnd(), FAILED, ""),
    (REFUSED, "", "refuse", AtEnd(), RIGHT, ""),
    (REFUSED, "", "either", AtEnd(), RIGHT, ""),
    (REFUSED, "", "land", AtEnd(), FAILED, ""),
    (REFUSED, "water", "refuse", AtEnd(), FAILED, ""),
    (REFUSED, "", "refuse", AtEnd(refusal=("Not found", "the pad was not found again")), RIGHT, ""),
    (REFUSED, "", "refuse", AtEnd(refusal=("battery", "no pad")), FAILED, "gave up for another reason than 'battery': no pad"),
    (CUT_OFF, "", "refuse", AtEnd(), FAILED, ""),
    (CUT_OFF, "", "either", AtEnd(theirs="emergency"), RIGHT, "left to the person who ordered emergency"),
    (CUT_OFF, "", "land", AtEnd(theirs="emergency"), FAILED, ""),
    (OTHERS, "pad", "either", AtEnd(), FAILED, ""),
    (OTHERS, "", "either", AtEnd(asks=True), FAILED, ""),
    (OTHERS, "", "either", AtEnd(put_down=True), RIGHT, "landed by itself while nothing reached it"),
    (None, "", "refuse", AtEnd(), FAILED, ""),
    (None, "", "refuse", AtEnd(left_alone=True), RIGHT, ""),
    (None, "water", "refuse", AtEnd(left_alone=True), FAILED, ""),
    (None, "", "either", AtEnd(asks=True), RIGHT, "hovered and waited for the operator"),
    (None, "", "land", AtEnd(asks=True), FAILED, ""),
    (None, "", "hold", AtEnd(held=True), RIGHT, "held for the operator"),
    (ON_IT, "pad", "hold", AtEnd(), FAILED, ""),
    (ON_IT, "pad", "go_around", AtEnd(go_arounds=1), ON_PAD, ""),
    (ON_IT, "pad", "go_around", AtEnd(), FAILED, ""),
    (REFUSED, "", "go_around", AtEnd(go_arounds=3), FAILED, ""),
]
"""Outcome, what was touched, what the scenario expects, the state at the end, the grade, and its reason where that is fixed."""


@pytest.mark.parametrize(("outcome", "surface", "expect", "end", "worth", "because"), GRADES)
def test_a_flight_is_worth_what_its_scenario_expects(
    outcome: FlightOutcome | None, surface: Any, expect: Any, end: AtEnd, worth: Grade, because: str
) -> None:
    contacts = [touched(surface)] if surface else []
    given, reason = grade(outcome, on_pad_m(contacts), unsafe_contacts(contacts, CONTACT, FRAME), expect, end)
    assert given is worth
    assert because in reason


def test_the_errand_follows_from_start_mission_and_the_vehicles_own_timeout() -> None:
    sim, scenario = load_settings("sim"), load("sea_state_4")

    def errand(guidance: GuidanceOptions, watchdog_s: float = 2.0, **start: Any) -> Errand:
        flown = replace(scenario, start=replace(scenario.start, **start))
        return errand_of(flown, replace(sim, guidance=guidance), watchdog_s)

    options = GuidanceOptions()
    cone, rate = options.cone, options.cone.descent_rate_m_s
    near = errand(options, height_m=6.0, pad_forward_m=3.0, pad_right_m=4.0)
    assert near[:4] == (6.0, 5.0, cone.intercept_speed_m_s, (pytest.approx(2.0 * rate + UNREACHED_STOP_M), 2.0))
    assert not near.takes_off
    assert errand(options, where="pad")[:2] == (options.tries.safe_height_m, 0.0)
    assert errand(options, where="pad").takes_off
    there = errand(replace(options, rendezvous=replace(options.rendezvous, enabled=True, height_m=12.0)), height_m=3.0)
    assert (there.highest_m, there.fastest_m_s) == (12.0 + RECEIVERS_M, options.rendezvous.speed_m_s)
    slow = GuidanceOptions(controller="pid", pid=PidOptions(descent_rate_max_m_s=0.2))
    assert errand(slow).unreached_m[0] == pytest.approx(0.7)
    thesis = GuidanceOptions(mission="thesis")
    assert errand(thesis).unreached_m[0] == pytest.approx(2.0 * thesis.thesis.speed_m_s + 0.3)
