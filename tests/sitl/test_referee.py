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

from companion.base.mission import FlightOutcome, State
from companion.base.orders import StickPositions
from companion.guidance.operator.arbiter import BY_HAND
from companion.settings.guidance import GuidanceOptions, PidOptions
from companion.settings.load import load as load_settings
from decklander.place import SHIPPED
from drivers.ardrone.at import REF_BASE, REF_EMERGENCY, REF_TAKE_OFF, ComWdg, Pcmd, Ref
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.setpoint import velocity_setpoint
from drivers.mavlink.vehicle import HOLD_MODE, LAND_MODE, VELOCITY_MODE, Stack, custom_mode, reposition, set_mode
from estimator.contracts.commands import Velocity
from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import GeoPoint, Rotation
from estimator.contracts.time import MonoNs, after
from sitl.ardrone.flight import of_at
from sitl.emulators.autopilots.watch import MavlinkWires
from sitl.flight.ending import AtEnd, Grade, grade, on_pad_m, outside_commit
from sitl.flight.grader import RECEIVERS_M, UNREACHED_STOP_M, errand_of
from sitl.flight.hands import Decides, SentPacket, WireRequest
from sitl.flight.limits import Errand, limits_of
from sitl.flight.referee import STAMP_ERROR_MAX_S, Referee, SightWatch, unsafe_contacts
from sitl.scenario.scenario import load
from sitl.vehicle.airframe import ContactSettings
from sitl.vehicle.airframe import load as load_vehicle
from sitl.vehicle.vehicle import VehiclePhase
from sitl.vessel.contact import DeckShape
from sitl.world.truth import Touchdown, Truth

START = MonoNs(0)
FRAME, CONTACT, RADIUS_M = load_vehicle(SHIPPED / "vehicles/quad_1_5kg.toml").airframe(), ContactSettings(), 0.39
FEET = FRAME.feet
ERRAND = Errand(highest_m=7.0, farthest_m=5.0, fastest_m_s=1.5, unreached_m=(1.7, 2.0), battery_life_s=1000.0, last_charge=0.05)
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
    turn_deg_s: float = 0.0
    right: float = 0.0

    def truth(self, yaw_rad: float = 0.0, at_ned: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Truth:
        """Return the true state, with the whole world turned and moved."""
        turned = Rotation.from_rpy(0.0, 0.0, yaw_rad)
        R = turned @ Rotation.from_rpy(math.radians(self.tilt_deg), 0.0, 0.0)
        lowest = float((R.matrix @ FEET.corners_m.T)[2].max())
        pad = turned.matrix @ np.array([self.ship, 0.0, -self.deck_up]) + at_ned
        body = pad + turned.matrix @ np.array([self.aside, self.right, -self.clearance - lowest])
        v_pad = turned.matrix @ np.array([self.ship if self.ship_m_s is None else self.ship_m_s, 0.0, self.deck_falls])
        return Truth(
            after(START, self.at_s), body, turned.matrix @ np.array(self.v), R, pad, v_pad, turned, self.phase,
            self.contacts[-1] if self.contacts else None, self.contacts, battery=self.battery,
            w_body=np.array([0.0, 0.0, math.radians(self.turn_deg_s)]),
        )  # fmt: skip


def judged(steps: list[Step], errand: Errand = ERRAND, deck: DeckShape | None = None, **world: Any) -> Referee:
    """Return a referee that saw all steps."""
    referee = Referee(START, errand, CONTACT, FRAME, RADIUS_M, deck)
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


def ordered(act: str, sent_s: float, request: WireRequest) -> list[Step]:
    """Return a flight in which the last packet of a kind that does not obey is sent this long after an act."""
    act_at = Step(1.0, acts=((act, StickPositions()),))
    return [Step(0.0), act_at, Step(1.0 + sent_s, sent=(SentPacket(after(START, 1.0 + sent_s), request),))]


HOLD, LAND = (("hold", StickPositions()),), (("land", StickPositions()),)


def held(last: Step) -> list[Step]:
    """Return a flight that a person holds 1 m aside, with its last step."""
    return [Step(0.0, acts=HOLD, sent=(SentPacket(START, WireRequest.HOVER),), aside=1.0), last]


def ordered_land(aside_m: float, **of: Any) -> list[Step]:
    """Return a flight that a person orders to land 2 m aside of the pad, and that touches this far from there."""
    there = touched("deck", at_s=3.0, p_body_pad=np.array([2.0 + aside_m, 0.0, 0.0]), lateral_m=2.0 + aside_m, over_rim_m=2.0)
    return [
        Step(0.0, aside=2.0, acts=LAND, sent=(SentPacket(START, WireRequest.LAND),), **of),
        Step(3.0, aside=2.0, contacts=(there,)),
    ]


def ended(charge: float, unseen_s: float, lateral_m: float = 1.0) -> list[Step]:
    """Return a flight that comes down 3 m and touches the deck with this charge, so long after the newest true sight."""
    there = touched("deck", at_s=unseen_s, lateral_m=lateral_m, over_rim_m=lateral_m)
    ends: dict[str, Any] = {"battery": charge, "seen": False}
    return [Step(0.0), Step(unseen_s - 2.0, **ends), Step(unseen_s, 0.0, aside=lateral_m, phase=LANDS, contacts=(there,), **ends)]


TIPS, LEANS = FRAME.falls_deg, FRAME.contact_tilt_deg(CONTACT.into_deck_max_m_s)
DROP_M = CONTACT.into_deck_max_m_s**2 / (2 * 9.80665)
EDGES: dict[str, tuple[Callable[[float], list[Step]], float, float]] = {
    "in_water": (lambda n: contact(surface="water") if n else [Step(0.0)], 0, 1),
    "off_pad": (lambda n: contact(surface="deck", over_rim_m=0.02) if n else contact(), 0, 1),
    "landed_aside_m": (lambda m: ordered_land(m), 0.49, 0.51),
    "landed_unseen": (lambda m: ended(0.05, 30.0, m), 3.49, 3.51),
    "into_deck_m_s": (lambda v: contact(foot_speed_m_s=v), 1.0, 1.01),
    "along_deck_m_s": (lambda v: contact(lateral_speed_m_s=v), 0.5, 0.51),
    "contact_tilt_deg": (lambda tilt: contact(tilt_rad=math.radians(tilt)), LEANS - 0.1, LEANS + 0.1),
    "tipped_deg": (lambda tilt: [Step(0.0, 0.0, tilt_deg=tilt, phase=LANDED)], TIPS - 0.1, TIPS + 0.1),
    "bounces": (lambda n: bounced(round(n)), 2, 3),
    "touches": (lambda n: [Step(1.0, contacts=tuple(touched(at_s=0.1 * i) for i in range(round(n))))], 5, 6),
    "slid_m": (lambda m: [Step(0.0, 0.0, phase=LANDED), Step(1.0, 0.0, aside=m, phase=LANDED)], 0.99, 1.01),
    "motors_off_m": (lambda h: [Step(0.0, h), Step(0.05, h, phase=CUT)], DROP_M - 1e-3, DROP_M + 1e-3),
    "on_deck_s": (lambda s: holds(s, clearance=0.0, aside=0.1), 3.0, 3.25),
    "low_outside_s": (lambda s: holds(s, clearance=0.9, aside=RADIUS_M + 0.01), 5.0, 5.25),
    "knee_outside_s": (lambda s: holds(s, clearance=0.4, aside=RADIUS_M + 0.01), 3.0, 3.25),
    "low_over_pad_s": (lambda s: holds(s, clearance=0.9, aside=RADIUS_M - 0.01), 120.0, 120.25),
    "turned_deg_s": (lambda w: [Step(0.0, turn_deg_s=-w)], 179.0, 181.0),
    "leaned_deg": (lambda tilt: [Step(0.0, tilt_deg=tilt)], 74.0, 76.0),
    "away_m": (lambda d: [Step(0.0, aside=5.0), Step(1.0, aside=d)], 24.9, 25.1),
    "fast_m_s": (lambda v: [Step(0.0, v=(0.0, v, 0.0))], 4.5, 4.6),
    "high_m": (lambda h: [Step(0.0, h - FEET.below_m)], 9.99, 10.01),
    "strayed_m": (lambda m: held(Step(5.0, aside=1.0 + m)), 4.99, 5.01),
    "rose_m": (lambda m: held(Step(5.0, 3.0 + m)), 2.99, 3.01),
    "ending_battery": (lambda s: holds(s, battery=0.05), 25.0, 25.25),
    "empty_s": (lambda s: [*(Step(0.25 * n, battery=0.0) for n in range(round(4 * s))), Step(s, 0.0)], 1.0, 1.25),
    "held_sank_m": (lambda h: [Step(0.0, acts=HOLD), Step(0.1), Step(0.2, 3.0 - h)], 0.49, 0.51),
    "lands_late": (lambda s: [Step(0.0, acts=LAND, sent=(SentPacket(START, WireRequest.LAND),)), Step(s)], 35.5, 35.6),
    "disobeyed_s": (lambda s: ordered("hold", s, WireRequest.LAND), 0.3, 0.31),
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
    assert set(given["contact_tilt_deg"].most.values()) == {15.0}, "the vehicle's file"
    hard = limits_of(ERRAND, ContactSettings(into_deck_max_m_s=2.0), FRAME)["motors_off_m"]
    assert hard.most[Decides.GUIDANCE] == pytest.approx(4.0 * DROP_M)
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


BY_ACT = {
    Decides.HOLD: ("hold", WireRequest.HOVER),
    Decides.HAND: ("manual", WireRequest.MOVE),
    Decides.LANDING: ("land", WireRequest.LAND),
    Decides.AUTOPILOT: ("mode", None),
    Decides.AUTOPILOT_LANDS: ("landing mode", None),
    Decides.CUT: ("emergency", WireRequest.STOP),
}
"""The act after which each of them decides, and what obeys it."""
OF_AN_ACT = {
    "landed_unseen",
    "landed_aside_m",
    "strayed_m",
    "rose_m",
    "held_sank_m",
    "lands_late",
    "disobeyed_s",
    "unordered",
    "blind_m",
    "unreached_m",
}
"""Counts whose flights have an act of their own, or that hold whoever decides."""


def under(whose: Decides, flight: list[Step]) -> list[Step]:
    """Return the flight under another one who decides."""
    if whose is Decides.GUIDANCE:
        return flight
    if whose is Decides.NOBODY:
        return [replace(step, reached=False) for step in flight]
    if whose is Decides.CHARGE:
        blind = [replace(step, at_s=step.at_s + 20.0, battery=min(0.05, step.battery), seen=False) for step in flight]
        return [Step(0.0), *blind]
    act, request = BY_ACT[whose]
    sent = () if request is None else (SentPacket(START, request),)
    return [Step(-10.0, acts=((act, StickPositions(forward=0.5)),), sent=sent), *flight]


@pytest.mark.parametrize("whose", Decides)
@pytest.mark.parametrize("name", sorted(EDGES.keys() - OF_AN_ACT))
def test_who_decides_changes_the_limit_and_never_that_it_is_watched(name: str, whose: Decides) -> None:
    """Each count has the limit of the table under each who decides, whatever the flight was before."""
    flight, inside, outside = EDGES[name]
    limit = limits_of(ERRAND, CONTACT, FRAME)[name].most
    if whose not in limit:
        assert name not in judged(under(whose, flight(outside))).as_json()
        return
    more = limit[whose] - limit[Decides.GUIDANCE]
    assert not judged(under(whose, flight(inside + more))).counts[name].over
    assert judged(under(whose, flight(outside + more))).counts[name].over


@pytest.mark.parametrize("name", sorted(EDGES.keys() - OF_AN_ACT - {"died"}))
def test_what_a_person_gives_back_is_guidances_again(name: str) -> None:
    flight, _, outside = EDGES[name]
    given = [*under(Decides.HAND, []), Step(-0.05, acts=(("begin", StickPositions()),))]
    assert judged([*given, *flight(outside)]).counts[name].over


def test_a_person_at_whose_contacts_nobody_looked_is_watched_like_anybody() -> None:
    """The kinds of contacts and ends that no order excuses."""
    nobody = {"in_water", "into_deck_m_s", "contact_tilt_deg", "tipped_deg", "turned_deg_s", "leaned_deg", "motors_off_m"}
    table = limits_of(ERRAND, CONTACT, FRAME)
    for whose in (Decides.HOLD, Decides.HAND, Decides.LANDING, Decides.CHARGE, Decides.AUTOPILOT, Decides.NOBODY):
        assert nobody <= {name for name, limit in table.items() if whose in limit.most}
    assert not nobody & {name for name, limit in table.items() if Decides.CUT in limit.most}, "he stopped the motors"


def test_the_last_charge_long_out_of_sight_excuses_the_blind_way_down_and_what_else_it_touches_at_does_not() -> None:
    excused = {"blind_m", "off_pad"}
    assert not judged(ended(0.05, 30.0)).unsafe
    for charge, unseen_s in ((0.06, 30.0), (0.05, 9.0)):
        assert excused <= {name for name, count in judged(ended(charge, unseen_s)).counts.items() if count.over}
    hard = ended(0.05, 30.0)
    hard[-1] = replace(hard[-1], contacts=(replace(hard[-1].contacts[0], vertical_speed_m_s=1.1),))
    assert judged(hard).counts["into_deck_m_s"].over
    hard[-1] = replace(hard[-1], contacts=(replace(hard[-1].contacts[0], surface="water"),))
    assert judged(hard).counts["in_water"].over
    assert judged(ended(0.05, 30.0), ERRAND._replace(last_charge=0.0)).unsafe, "where nothing comes down with a last charge"


def test_what_the_frames_show_and_what_stands_still_is_not_charged() -> None:
    down = [Step(0.0), Step(1.5, seen=False), Step(1.6, 2.0, seen=False)]
    assert judged(down).counts["blind_m"].over
    assert judged([down[0], Step(1.5), Step(1.6, 2.0, seen=False)]).unsafe == (), "the frame before it showed the pad"
    watch = SightWatch(START)
    for verdict, true_view in ((Verdict.NO_PAD, True), (Verdict.FUSED, True), (Verdict.GATED, True)):
        watch.frame(START, verdict, true_view=true_view, stamp_error_s=0.0)
    assert watch.since_sight == {Verdict.GATED: 1}, "of the frames since the pad was last seen"
    spins = [Step(0.0, 0.0, phase=LANDED, turn_deg_s=400.0), Step(1.0, 3.0, phase=CUT, tilt_deg=170.0, reached=False)]
    assert judged(spins).unsafe == (), "nothing turns with its motors off"
    falls = [Step(0.0, phase=CUT, reached=False), Step(0.5, phase=CUT, reached=False), Step(1.0, 0.5, phase=CUT, reached=False)]
    assert judged(falls).sight.unreached_m == 0.0, "one whose motors stand falls, and nobody flew it down"


SHIP = DeckShape(6.0, 6.0, 2.0, 2.0)
"""A deck of 12 m by 4 m with the pad in its middle."""


def test_a_landing_that_a_person_orders_is_his_place_and_in_sight_of_the_pad_it_is_where_he_ordered_it() -> None:
    assert judged(ordered_land(0.3)).unsafe == ()
    assert judged(ordered_land(3.0)).counts["landed_aside_m"].value == pytest.approx(3.0)
    unseen = [replace(step, at_s=step.at_s + 5.0, seen=False) for step in ordered_land(3.0)]
    assert judged(unseen).unsafe == (), "he was told that nobody sees it"
    on_pad = touched(at_s=3.0, p_body_pad=np.array([0.1, 0.0, 0.0]))
    start = Step(0.0, aside=2.0, acts=LAND, sent=(SentPacket(START, WireRequest.LAND),))
    assert judged([start, Step(3.0, contacts=(on_pad,))]).unsafe == (), "the pad is right wherever he ordered it"
    wet = Step(3.0, aside=9.0, contacts=(touched("water", at_s=3.0, lateral_m=9.0),))
    assert judged([replace(start, aside=9.0), wet], deck=SHIP).unsafe == (), "he ordered it over the water"
    assert judged([start, wet], deck=SHIP).counts["in_water"].over


def test_a_landing_that_a_person_ordered_may_stop_the_motors_on_the_deck_and_not_above_it() -> None:
    down = Step(2.0, 0.0, phase=LANDS)
    stop = SentPacket(after(START, 2.1), WireRequest.STOP)
    ordered_it = Step(0.0, acts=LAND, sent=(SentPacket(START, WireRequest.MOVE),))
    assert judged([ordered_it, down, Step(2.1, 0.0, sent=(stop,)), Step(2.2, 0.0, phase=LANDED)]).unsafe == ()
    (line,) = judged([ordered_it, replace(down, clearance=0.2), Step(2.1, 0.2, sent=(stop,))]).unsafe
    assert line == "a person ordered land, and was sent: stop the motors, still 2.1 s later"


def test_a_held_vehicle_may_stop_first_and_go_with_the_deck_or_stand_over_the_ground() -> None:
    fast = [Step(0.25 * n, aside=1.0 + 1.0 * n, v=(4.0, 0.0, 0.0)) for n in range(16)]
    order = replace(fast[0], acts=HOLD, sent=(SentPacket(START, WireRequest.HOVER),))
    stopped = [order, *fast[1:], Step(4.5, aside=20.0)]
    assert judged(stopped).unsafe == (), "four seconds to stop"
    assert judged([*stopped, Step(9.0, aside=24.5)]).unsafe == ()
    (line,) = judged([*stopped, Step(9.0, aside=25.5)]).unsafe
    assert line == "a person ordered hold, and it flew 5.5 m away from there", "from where it stopped, or had to"
    assert "fast_m_s" in judged([*stopped, Step(9.0, aside=20.0, v=(3.1, 0.0, 0.0))]).as_json()
    left = [order, Step(1.0, aside=1.0), Step(9.0, aside=-29.0, ship=30.0)]
    assert judged(left).unsafe == (), "the ship goes on below it"
    carried = [order, Step(1.0, aside=1.0), Step(9.0, aside=1.0, ship=30.0, v=(30.0, 0.0, 0.0))]
    assert judged(carried).unsafe == (), "it goes with her"
    drifts = [order, Step(1.0, aside=1.0), Step(9.0, aside=20.0, phase=VehiclePhase.HOVERING)]
    assert judged(drifts).unsafe == (), "its own hover drifts with the wind"
    low = [replace(order, clearance=0.5), Step(1.0, 0.5), Step(9.0, 5.3)]
    assert judged(low).unsafe == (), "a low one climbs clear of the deck"
    assert judged([*low, Step(10.0, 6.0)]).counts["rose_m"].over


def test_who_holds_it_low_answers_for_how_long_it_stays_there() -> None:
    """WHY: holds at the gate, which nobody ended, were graded as guidance that hangs over the pad (weather_3, seed 903000)."""
    names = {"low_outside_s", "knee_outside_s", "low_over_pad_s"}
    for aside in (RADIUS_M - 0.1, RADIUS_M + 0.1):
        low = holds(200.0, clearance=0.4, aside=aside)
        for ordered_m, stays_m in ((0.4, 0.4), (1.3, 0.9)):
            order = Step(-1.0, ordered_m, aside=aside, acts=HOLD, sent=(SentPacket(after(START, -1.0), WireRequest.HOVER),))
            assert judged([order, *holds(200.0, clearance=stays_m, aside=aside)]).unsafe == ()
        assert names & judged(under(Decides.HOLD, low)).as_json().keys(), "held high, it came down by itself"
        assert not names & judged(under(Decides.HAND, low)).as_json().keys(), "he flies it there"
        centred = Step(-1.0, 0.4, acts=(("manual", StickPositions()),), sent=(SentPacket(START, WireRequest.HOVER),))
        assert not names & judged([*under(Decides.HAND, []), centred, *low]).as_json().keys(), "and leaves it there"
        again = Step(0.0, 0.4, aside=aside, acts=(("begin", StickPositions()),))
        assert names & judged([centred, again, *low[1:]]).as_json().keys(), "what is given back low is guidance's"


def test_what_a_person_flew_by_hand_is_not_charged_to_guidance_that_gets_it_back_there() -> None:
    away = [*under(Decides.HAND, []), Step(-5.0, 20.0, aside=80.0)]
    back = Step(0.0, 20.0, aside=80.0, acts=(("begin", StickPositions()),))
    assert judged([*away, back, Step(1.0, 20.0, aside=82.0)]).unsafe == ()
    assert {"away_m", "high_m"} <= judged([*away, back, Step(9.0, 25.0, aside=110.0)]).as_json().keys()
    assert len(judged([*away, back, Step(9.0, 25.0, aside=110.0)]).unsafe) == 2


def test_low_counts_where_people_may_be_and_on_the_deck_standing_goes_on_through_hops() -> None:
    for aside, unsafe in ((5.9, 1), (6.1, 0)):
        assert len(judged(holds(6.0, clearance=0.9, aside=aside), deck=SHIP).unsafe) == unsafe
    excused = ERRAND._replace(unreached_contacts=True)
    alone = [replace(step, served=False) for step in holds(6.0, clearance=0.9, aside=3.0)]
    assert [len(judged(alone, errand).unsafe) for errand in (ERRAND, excused)] == [1, 0]
    for up, stood_s in ((0.49, 3.0), (0.51, 1.0)):
        hops = [*holds(2.0, clearance=0.0)[:-1], Step(2.0, up), *(Step(2.25 + 0.25 * n, 0.0) for n in range(5))]
        assert judged(hops).counts["on_deck_s"].value == pytest.approx(max(2.0, stood_s), abs=0.26)
    slides = [Step(0.0, 0.0), Step(1.0, 0.6, aside=2.0), Step(2.0, 0.0, aside=2.0)]
    assert judged(slides).counts["slid_m"].value == 0.0, "it flew there"
    across = [Step(0.0, 0.0, right=0.7), Step(1.0, 0.0, right=-0.6)]
    assert judged(across).counts["slid_m"].value == pytest.approx(1.3)
    for errand, unsafe in ((ERRAND, 1), (excused, 0)):
        assert len(judged([replace(step, served=False) for step in across], errand).unsafe) == unsafe
    above = [holds(70.0, clearance=clearance, aside=aside) for clearance, aside in ((1.01, 0.1), (1.01, 2.0))]
    assert [judged(flight).unsafe for flight in above] == [(), ()], "higher than it reaches"
    assert judged(holds(4.0, clearance=0.51, aside=2.0)).unsafe == ()


def test_the_height_that_is_reported_is_that_of_the_service() -> None:
    for whose in (Decides.GUIDANCE, Decides.HOLD, Decides.AUTOPILOT, Decides.HAND):
        highest_m = judged(under(whose, [Step(0.0, 8.0)])).highest_m
        assert highest_m == pytest.approx(8.0 + FEET.below_m if whose in (Decides.GUIDANCE, Decides.HOLD) else -math.inf)


def every(seconds: float, of: Callable[[float], dict[str, Any]], each_s: float = 0.05) -> list[Step]:
    return [Step(round(each_s * n, 3), **of(each_s * n)) for n in range(round(seconds / each_s))]


def after_order(act: str, request: WireRequest, steps: list[Step]) -> list[Step]:
    return [Step(0.0, acts=((act, StickPositions()),), sent=(SentPacket(START, request),)), *steps[1:]]


AROUND = [
    step
    for k in range(100)
    for step in (
        Step(10.0 * k, 0.0, contacts=tuple(touched(at_s=10.0 * j, foot_speed_m_s=0.9) for j in range(k + 1))),
        Step(10.0 * k + 1.0, 0.6),
        Step(10.0 * k + 5.0, 2.0),
    )
]
HARD = touched("deck", at_s=1.0, foot_speed_m_s=4.0, lateral_speed_m_s=6.0, tilt_rad=1.05, lateral_m=5.0, over_rim_m=5.0)
UNSEEN: dict[str, list[Step]] = {
    "by hand with the sticks centred, 300 m away at 15 m/s": after_order(
        "manual", WireRequest.MOVE, every(20.0, lambda t: {"aside": 15.0 * t, "v": (15.0, 0.0, 0.0)})
    ),
    "ordered to land, it strikes the deck": after_order(
        "land", WireRequest.LAND, [*every(0.1, lambda t: {}), Step(1.0, 0.0, contacts=(HARD,))]
    ),
    "ordered to land, in the water": after_order(
        "land", WireRequest.LAND, [*every(0.1, lambda t: {}), Step(1.0, 0.0, contacts=(touched("water", at_s=1.0),))]
    ),
    "held, 20 m aside": after_order(
        "hold", WireRequest.HOVER, every(6.0, lambda t: {"aside": min(24.0, 4.4 * t), "v": (4.4, 0.0, 0.0)})
    ),
    "held, it climbs away": after_order(
        "hold", WireRequest.HOVER, every(6.0, lambda t: {"clearance": 3.0 + min(6.5, 4.0 * t), "v": (0.0, 0.0, -4.0)})
    ),
    "10 cm over the pad for ten minutes": every(600.0, lambda t: {"clearance": 0.1}, 0.25),
    "along the deck in hops of 4 cm": every(600.0, lambda t: {"clearance": 0.04 * (t % 2.5 > 2.39), "aside": 0.2}, 0.1),
    "a hundred touches": AROUND,
    "at knee height beside the pad": holds(4.5, clearance=0.3, aside=2.0),
    "spins": every(10.0, lambda t: {"clearance": max(0.0, 3.0 - 0.3 * t), "turn_deg_s": 400.0}),
    "upside down at 3 m": every(1.0, lambda t: {"tilt_deg": 179.0}),
    "held with an empty battery": after_order("hold", WireRequest.HOVER, every(600.0, lambda t: {"battery": 0.0}, 0.25)),
    "20 cm over people's feet, far from the pad": every(60.0, lambda t: {"clearance": 0.2, "aside": 24.0}),
    "low over the deck without a service": every(8.0, lambda t: {"clearance": 0.1, "aside": 3.0, "served": False}),
    "slides over the deck's edge": [
        Step(0.0, 0.0, contacts=(touched(),)), *(Step(0.5 + 0.1 * n, 0.0, aside=0.1 * n, phase=LANDED) for n in range(60)),
    ],
}  # fmt: skip
"""WHY: each of these was safe for the referee."""


@pytest.mark.parametrize("what", UNSEEN)
def test_a_truth_that_hurts_is_seen_whoever_has_the_vehicle(what: str) -> None:
    assert judged(UNSEEN[what]).unsafe != ()


def test_who_gives_the_sticks_back_holds_it_until_he_orders_to_go_on() -> None:
    """WHY: after his release it waited 0.9 m over the deck for him, and that was charged to guidance."""
    taken = Step(0.0, 0.9, aside=1.0, acts=(("manual", StickPositions()),))
    released = Step(
        0.1, 0.9, aside=1.0, acts=(("release", StickPositions()),), sent=(SentPacket(after(START, 0.1), WireRequest.MOVE),)
    )
    waits = [Step(0.25 * n, 0.9, aside=1.0) for n in range(1, 60)]
    assert judged([taken, released, *waits]).unsafe == ()
    goes_on = replace(waits[0], acts=(("begin", StickPositions()),))
    assert len(judged([taken, released, goes_on, *waits[1:]]).unsafe) == 1


def test_who_gives_it_back_at_the_deck_answers_for_its_contacts_until_it_can_have_climbed() -> None:
    """WHY: a person flew it along the deck at 2 m/s and gave it back there: it touched 0.04 s later (weather_3, 894245)."""

    def given(*, height_m: float, after_s: float, **over: Any) -> set[str]:
        flown = Step(0.0, height_m, aside=3.0, acts=(("manual", StickPositions(forward=0.3)),))
        back = Step(0.1, height_m, aside=3.0, acts=(("release", StickPositions()), ("begin", StickPositions())))
        met = touched("deck", 0.1 + after_s, lateral_m=3.0, lateral_speed_m_s=2.0, over_rim_m=2.5, **over)
        counts = judged([flown, back, Step(0.1 + after_s, 0.0, aside=3.0, contacts=(met,))]).counts
        return {name for name in ("off_pad", "along_deck_m_s", "into_deck_m_s") if counts[name].over}

    assert given(height_m=0.1, after_s=0.9) == set()
    assert given(height_m=0.1, after_s=0.9, vertical_speed_m_s=1.5) == {"into_deck_m_s"}, "hard is hard, whoever flew it"
    assert given(height_m=0.1, after_s=1.1) == given(height_m=0.6, after_s=0.9) == {"off_pad", "along_deck_m_s"}


def test_beside_the_ship_nothing_stands_slides_or_tips_at_the_height_of_her_deck() -> None:
    """WHY: ArduCopter held over the ground where the ship had been, and "slid 3.7 m over the deck" 50 m behind her."""
    left = [Step(0.1 * n, 0.04 * (n % 2), aside=8.0 + 0.2 * n, tilt_deg=40.0) for n in range(40)]
    mode = [Step(0.0, 3.0, aside=8.0, acts=(("mode", StickPositions()),))]
    counts = judged([*mode, *left], deck=SHIP).counts
    assert not any(counts[name].value for name in ("slid_m", "tipped_deg", "bounces", "on_deck_s"))
    over = [replace(step, aside=step.aside - 8.0) for step in left[:8]]
    assert judged([*mode, *over], deck=SHIP).counts["tipped_deg"].over


def test_a_deck_that_goes_on_under_an_autopilot_that_holds_is_no_slide_of_it() -> None:
    """WHY: a pilot chose BRAKE at the contact, and the ship went on: "slid 19.5 m over the deck" (weather_3, 903051)."""
    for ship_m_s, motors, slid in ((1.5, FLIES, False), (0.0, FLIES, True), (1.5, LANDED, True)):
        goes = [Step(0.1 * n, 0.0, -0.15 * n, ship=0.1 * n * ship_m_s, ship_m_s=ship_m_s, phase=motors) for n in range(1, 40)]
        chosen = Step(0.0, 0.0, ship_m_s=ship_m_s, acts=(("mode", StickPositions()),))
        assert judged([chosen, *goes]).counts["slid_m"].over is slid
    ours = [Step(0.1 * n, 0.0, -0.15 * n, ship=0.15 * n, ship_m_s=1.5) for n in range(40)]
    assert judged(ours).counts["slid_m"].over, "guidance goes with the deck"


def test_a_cut_that_a_person_ordered_is_no_stop_of_ours_and_one_that_the_service_sends_is() -> None:
    cut = EDGES["motors_off_m"][0](3.0)
    assert judged(cut).unsafe == ("the motors stopped 3.00 m over the deck, where 0.05 m are the most",)
    his = Step(-0.1, acts=(("emergency", StickPositions()),), sent=(SentPacket(START, WireRequest.STOP),))
    assert judged([his, *cut]).unsafe == ()


STILL, GOES = Pcmd(0, 0.0, 0.0, 0.0, 0.0), Pcmd(1, 0.1, -0.2, 0.3, 0.4)
UP = Ref(REF_BASE | REF_TAKE_OFF)


def test_a_datagram_asks_for_the_gravest_of_its_commands() -> None:
    assert of_at([ComWdg()], START) is None
    assert of_at([UP, STILL], START) == SentPacket(START, WireRequest.HOVER)
    assert of_at([STILL], START) == SentPacket(START, WireRequest.CENTRED)
    assert of_at([UP, GOES], START) == of_at([GOES], START) == SentPacket(START, WireRequest.MOVE)
    assert of_at([Ref(REF_BASE), GOES], START) == SentPacket(START, WireRequest.LAND)
    assert of_at([Ref(REF_BASE | REF_TAKE_OFF | REF_EMERGENCY), GOES], START) == SentPacket(START, WireRequest.STOP)


@pytest.mark.parametrize(
    ("act", "obeys", "not_"),
    [
        ("hold", [WireRequest.HOVER, WireRequest.MOVE], [WireRequest.LAND, WireRequest.STOP]),
        ("abort", [WireRequest.HOVER, WireRequest.MOVE], [WireRequest.LAND, WireRequest.STOP]),
        (
            "land",
            [WireRequest.LAND, WireRequest.MOVE, WireRequest.MODE],
            [WireRequest.HOVER, WireRequest.CENTRED, WireRequest.STOP],
        ),
        ("emergency", [WireRequest.STOP], [WireRequest.MOVE, WireRequest.HOVER, WireRequest.LAND]),
        ("manual", [WireRequest.HOVER, WireRequest.MOVE], [WireRequest.LAND, WireRequest.STOP]),
    ],
)
def test_an_act_is_obeyed_by_what_it_means_from_a_third_of_a_second_on(
    act: str, obeys: list[WireRequest], not_: list[WireRequest]
) -> None:
    for request in obeys:
        assert judged([*ordered(act, 0.1, request), *ordered(act, 9.0, request)[2:]]).unsafe == ()
    for request in not_:
        assert judged(ordered(act, 0.29, request)).unsafe == ()
        (line,) = judged(ordered(act, 5.0, request)).unsafe
        assert line == f"a person ordered {act}, and was sent: {request.value}, still 5.0 s later"
    late = Step(6.0, sent=(SentPacket(after(START, 6.0), not_[0]),))
    assert len(judged([*ordered(act, 0.1, obeys[0]), late]).unsafe) == 1, "to the end"


def test_a_landing_goes_on_with_the_sticks_in_the_middle_once_it_was_sent() -> None:
    """WHY: a person's landing that a dying service's sender left alone counted as disobeyed."""
    centred = Step(9.0, sent=(SentPacket(after(START, 9.0), WireRequest.CENTRED),))
    assert judged([*ordered("land", 0.1, WireRequest.LAND), centred]).unsafe == ()
    hover = replace(centred, sent=(SentPacket(after(START, 9.0), WireRequest.HOVER),))
    assert len(judged([*ordered("land", 0.1, WireRequest.LAND), hover]).unsafe) == 1, "which takes off again"


def test_silence_is_no_obedience_unless_the_motors_stand_or_no_service_runs() -> None:
    order = Step(0.0, acts=(("hold", StickPositions()),))
    assert judged([order, Step(0.4)]).unsafe == ("a person ordered hold, and was sent: nothing that obeys, still 0.4 s later",)
    assert judged([replace(order, clearance=0.0), Step(0.4, 0.0, phase=LANDED)]).unsafe == ()
    assert judged([order, Step(0.1, served=False), Step(0.5), Step(0.75)]).unsafe == ()


@pytest.mark.parametrize(
    ("act", "killed_s", "stands"), [("hold", 5.0, True), ("land", 5.0, True), ("land", 31.0, False), ("manual", 5.0, False)]
)
def test_what_a_person_holds_or_lands_is_his_when_the_service_comes_back_soon(act: str, killed_s: float, stands: bool) -> None:
    """WHY: a service that was killed in a person's landing went on with it, and was charged for the place (898519)."""
    killed = [Step(0.1 + n * 0.1, served=False, seen=False) for n in range(round(10.0 * killed_s))]
    back = Step(killed_s + 0.2)
    referee = judged([Step(0.0, acts=((act, StickPositions()),)), *killed, back])
    assert (referee.hands.act == act) is stands
    assert referee.hands.late_s == 0.0
    at = after(START, killed_s + 0.6)
    referee.step(replace(back, at_s=killed_s + 0.6).truth(), reached=True, served=True)
    referee.hands.sent(SentPacket(at, WireRequest.STOP))
    assert (referee.hands.late_s > 0.3) is stands, "and is obeyed within a person's time of reaction"


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


def test_an_order_that_was_given_before_a_stop_is_not_carried_out_after_it() -> None:
    for act, late_s, unsafe in (("begin", 2.1, 1), ("land", 2.1, 1), ("begin", 1.9, 0), ("hold", 9.0, 0), ("clear", 9.0, 0)):
        referee = judged([Step(0.0), Step(1.0, acts=HOLD, sent=(SentPacket(after(START, 1.0), WireRequest.HOVER),))])
        referee.hands.acts(act, after(START, 3.0), late_s=late_s)
        assert len(referee.hands.unordered) == unsafe
    before = judged([Step(0.0)])
    before.hands.acts("begin", after(START, 3.0), late_s=9.0)
    assert before.hands.unordered == [], "nobody had stopped it"


def test_nothing_starts_that_nobody_ordered() -> None:
    assert judged([Step(0.0, 0.0, phase=STARTS)]).unsafe == (), "it was started before anybody watched"
    assert judged([Step(1.0), Step(2.0, sent=(SentPacket(after(START, 2.0), WireRequest.MODE),))]).unsafe == (), (
        "nobody has it but we"
    )
    down, up = Step(0.0, 0.0, phase=LANDED), Step(1.0, 0.0, phase=STARTS)
    again = [Step(2.0), Step(3.0, 0.0, phase=LANDED), Step(4.0, 0.0, phase=STARTS)]
    begins = ERRAND._replace(takes_off=True)
    assert judged([down, up]).unsafe == ("nobody ordered it: the motors started",)
    assert judged([down, up], begins).unsafe == ()
    assert judged([down, up, *again], begins).unsafe == ("nobody ordered it: the motors started",)
    ask = replace(again[1], acts=(("takeoff", StickPositions()),))
    assert judged([down, up, again[0], ask, again[2]], begins).unsafe == ()
    stopped = Step(0.5, 0.0, phase=LANDED, acts=(("emergency", StickPositions()),))
    assert judged([down, stopped, up], begins).unsafe == ("nobody ordered it: the motors started",), "a cut takes the start back"
    arms = (Step(2.0, phase=LANDED, sent=(SentPacket(after(START, 2.0), WireRequest.ARM),)),)
    assert judged([Step(1.0, 0.0, phase=LANDED), *arms]).unsafe == ("nobody ordered it: arm",)
    assert judged([Step(1.0, 0.0, phase=LANDED), *arms], begins).unsafe == ()
    shut = [Step(0.0), Step(1.0, acts=(("disarm", StickPositions()),)), Step(1.1, phase=LANDED)]
    assert judged([*shut, *arms]).unsafe == ("nobody ordered it: arm after a person's disarm",)
    assert judged([*shut, Step(1.9, phase=LANDED, acts=(("begin", StickPositions()),)), *arms]).unsafe == ()
    by_rc = [Step(0.0, 0.0, phase=LANDED), Step(1.0, 0.0, phase=FLIES)]
    assert judged(by_rc).unsafe == ("nobody ordered it: the motors started",), "an autopilot has no phase of taking off"


SERVICE, VEHICLE = Codec(1, 191), Codec(1, 1)


def beat(stack: Stack, mode: str, *, armed: bool = True, status: int = 4) -> bytes:
    firmware = 12 if stack is Stack.PX4 else 3
    return VEHICLE.pack(mav.MAVLink_heartbeat_message(2, firmware, 1 | 128 * armed, custom_mode(stack, mode), status, 3))


def packed_command(number: int, *of: float) -> bytes:
    return SERVICE.pack(mav.MAVLink_command_long_message(1, 1, number, 0, *of, *[0.0] * (7 - len(of))))


def asks_mode(stack: Stack, mode: str) -> bytes:
    return SERVICE.pack(set_mode(stack, (1, 1), mode))


MOVES = SERVICE.pack(velocity_setpoint(0, (1, 1), Velocity(np.zeros(3), 0.0), 0.0))
OFF, ON = (packed_command(mav.MAV_CMD_COMPONENT_ARM_DISARM, arms) for arms in (0.0, 1.0))
AWAY = SERVICE.pack(reposition((1, 1), GeoPoint.of_degrees(54.0, 10.0, 20.0)))
UP_S = packed_command(mav.MAV_CMD_NAV_TAKEOFF)
Log = list[tuple[float, Literal["out", "in"], bytes]]


def decoded(data: bytes) -> Message:
    """Return the one message in a datagram."""
    (found,) = Codec(0, 0, datagrams=True).feed(data)
    return found


def acts_of(log: Log) -> list[tuple[float, str]]:
    """Return what a log shows as a person's, and when."""
    wires, found = MavlinkWires(), []
    for at_s, way, data in log:
        one = decoded(data)
        if way == "out":
            wires.to_vehicle(one, after(START, at_s))
        elif (act := wires.from_vehicle(one, after(START, at_s))) is not None:
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
        assert acts_of([*flies, *late]) == [(3.6, "landing mode")], "too late"
    landed: Log = [(0.5, "out", asks_mode(stack, land)), (1.0, "in", beat(stack, land)), (1.1, "in", beat(stack, ours))]
    assert acts_of([*flies, *landed]) == [(1.1, "mode")], "a request is used up"
    again: Log = [(1.1, "in", beat(stack, ours)), (1.2, "in", beat(stack, land))]
    assert acts_of([*flies, *landed[:2], *again])[-1] == (1.2, "landing mode")
    ours_too: Log = [(0.5, "out", asks_mode(stack, land)), (1.0, "in", beat(stack, land))]
    fails: Log = [(1.5, "in", beat(stack, land, status=5)), (1.7, "in", beat(stack, land, status=5))]
    assert acts_of([*flies, *ours_too, *fails]) == [(1.5, "landing mode")], "a failsafe that takes the mode which is there"
    assert acts_of([*flies, (1.0, "in", beat(stack, ours, status=6))]) == [(1.0, "mode")]
    assert acts_of([(0.0, "in", beat(stack, his, armed=False, status=5))]) == []
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


def test_a_message_of_the_service_asks_by_its_command() -> None:
    wires = MavlinkWires()
    wires.from_vehicle(decoded(beat(Stack.PX4, "offboard")), START)

    def requests(*data: bytes) -> list[WireRequest]:
        packets = [wires.to_vehicle(decoded(one), START) for one in data]
        return [packet.request for packet in packets if packet is not None]

    modes = [asks_mode(Stack.PX4, mode) for mode in ("auto.land", "auto.rtl", "offboard", "auto.loiter")]
    assert requests(*modes) == [WireRequest.LAND, WireRequest.LEAVE, WireRequest.MODE, WireRequest.MODE]
    assert requests(OFF, ON, UP_S, AWAY, MOVES) == [
        WireRequest.STOP,
        WireRequest.ARM,
        WireRequest.ARM,
        WireRequest.LEAVE,
        WireRequest.MOVE,
    ]
    assert requests(beat(Stack.PX4, "offboard"), packed_command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 30.0)) == []


@pytest.mark.parametrize("sent", [MOVES, OFF, ON, AWAY, asks_mode(Stack.ARDUPILOT, "guided"), asks_mode(Stack.ARDUPILOT, "land")])
def test_nothing_is_sent_after_a_persons_mode_until_he_gives_the_vehicle_back(sent: bytes) -> None:
    def log(sent_s: float, *acts: tuple[float, str]) -> Referee:
        wires, steps = MavlinkWires(), [Step(0.0)]
        for at_s, mode in ((0.5, "guided"), (1.0, "brake")):
            if (act := wires.from_vehicle(decoded(beat(Stack.ARDUPILOT, mode)), after(START, at_s))) is not None:
                steps.append(Step(at_s, acts=((act, StickPositions()),)))
        steps += [Step(at_s, acts=((act, StickPositions()),)) for at_s, act in acts]
        packet = wires.to_vehicle(decoded(sent), after(START, sent_s))
        return judged([*steps, Step(sent_s, sent=() if packet is None else (packet,))])

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
    meant = [touched(), touched(guidance_phase=State.LAND_HERE.value), touched(guidance_phase=BY_HAND), still]
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
    (FlightOutcome.ABORTED, "", "either", AtEnd(held=True), RIGHT, "left to the person who ordered abort"),
    (FlightOutcome.ABORTED, "", "land", AtEnd(held=True), FAILED, ""),
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
def test_a_flight_is_worth_what_its_scenario_expects(outcome, surface, expect, end, worth, because):
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
    assert (near.last_charge, near.held_to) == pytest.approx((0.055, 0.105)), "it is reported in whole percent"
    assert errand(replace(options, last_charge=0.0, held_ends="hold"), height_m=6.0)[-2:] == (0.0, 0.0)
    assert errand(options, where="pad")[:2] == (options.tries.safe_height_m, 0.0)
    assert errand(options, where="pad").takes_off
    there = errand(replace(options, rendezvous=replace(options.rendezvous, enabled=True, height_m=12.0)), height_m=3.0)
    assert (there.highest_m, there.fastest_m_s) == (12.0 + RECEIVERS_M, options.rendezvous.speed_m_s)
    slow = GuidanceOptions(controller="pid", pid=PidOptions(descent_rate_max_m_s=0.2))
    assert errand(slow).unreached_m[0] == pytest.approx(0.7)
    thesis = GuidanceOptions(mission="thesis")
    assert errand(thesis).unreached_m[0] == pytest.approx(2.0 * thesis.thesis.speed_m_s + 0.3)
