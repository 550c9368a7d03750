"""The landing beside its mission: what samples, frames and estimates become for a guidance cycle, and what the operator reads."""

import asyncio
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace
from numpy.typing import NDArray

from companion.base.containment import RESTART
from companion.base.mission import Event, FlightOutcome, Reason, ReasonCause, State
from companion.guidance.controller import Knowledge
from companion.guidance.landing import LandingGuidance, PilotOptions
from companion.guidance.mission.charge import DWELL_S
from companion.guidance.mission.gate import Gate
from companion.guidance.mission.machine import mission_step
from companion.guidance.mission.progress import VesselPosition
from companion.guidance.pilot import Pilot
from companion.service.daemon import Daemon, DaemonSetup
from companion.settings.guidance import ClimbResponse, GuidanceOptions
from estimator.contracts.commands import Command, Hover, Lean, Velocity
from estimator.contracts.estimates import FusionResult, IntegrityAlert, Verdict
from estimator.contracts.geometry import GeoPoint, Rotation, moved
from estimator.contracts.motion import G_M_S2, DeckMotion
from estimator.contracts.samples import GeoFix
from estimator.integrity.parity import Parity
from estimator.options import EstimatorOptions
from estimator.vision.detection import NearThing, PadCheck, PadThing
from estimator.vision.track.rehearsal import drawn
from tests.companion.test_daemon import EYES
from tests.companion.test_limits import forecast, swell
from tests.companion.test_mission_flights import guided
from tests.companion.virtual_flight import TICK_S, FakeFlight, VirtualClock, fly
from tests.fly import ObservedCalls
from tests.make import attitude, baro, body, deck, estimate, gimbal, imu, ns, range_down, stamp, status, velocity, vessel

DT, NO_SENSOR = 0.02, SimpleNamespace(confirmed=lambda now: False)
WHY, THING = Reason(ReasonCause.DECK_TILT, 3.0, 2.5), PadThing(0.2, 0.3, 0.4)
FOLLOWS = replace(GuidanceOptions(), controller="follow_deck")
DOWN = Lean(np.zeros(2), np.zeros(2), np.array([0.0, 0.0, 0.5]), 0.0)


def in_flight(guidance: GuidanceOptions | None = None, *, at: State = State.DESCEND, **options: Any) -> LandingGuidance:
    """Return the landing of a vehicle that took off at 0 s."""
    landing = LandingGuidance(guidance or GuidanceOptions(), PilotOptions(**options))
    landing.on_samples([status(0.0)])
    return enter(landing, at)


def enter(landing: LandingGuidance, state: State, **memory: Any) -> LandingGuidance:
    landing.mission = replace(landing.mission, state=state, begun=True, stood=False, since=ns(0.0), **memory)
    return landing


def knowing(
    t: float, landing: LandingGuidance, seen: Any = None, moves: DeckMotion | None = None, *,
    of_body: Any = None, trusts: bool = True, unfelt: bool = False, ahead: Any = lambda now, horizons_s: None,
) -> Any:  # fmt: skip
    """Return what the landing knows by an estimator with these answers."""
    guard = SimpleNamespace(trusts_velocity=trusts, inertial=SimpleNamespace(accel_lost=unfelt, parity=Parity()))
    estimator: Any = SimpleNamespace(motion=lambda now: (of_body, moves), guard=guard, forecast=ahead, ship_motion=NO_SENSOR)
    return landing.knowledge(ns(t), seen, estimator)


def cycle(t: float, landing: LandingGuidance, *args: Any, **more: Any) -> Any:
    """Run a guidance cycle and return what the mission got."""
    with patch("companion.guidance.landing.mission_step", wraps=mission_step) as step:
        landing.command(knowing(t, landing, *args, **more))
    return step.call_args.args[1]


def push(landing: LandingGuidance, t: float, *pushes_m_s2: float, late_s: float = 0.0) -> None:
    for k, up in enumerate((0.0, *pushes_m_s2)):
        landing.on_samples([imu(stamp(t + 0.005 * k - late_s, late_s), f=(0.0, 0.0, -G_M_S2 - up))])


def test_a_contact_is_felt_in_flight_alone_by_a_live_accelerometer_and_by_our_own_clock() -> None:
    """A stamp that lies would put the contact before the commit."""
    for pushes, felt, touched, feels in (
        ((20.0, 20.0), True, True, True), ((7.0, 5.0), False, True, True), ((1.0,), False, False, True),
        ((0.0,) * 40, False, False, False),
    ):  # fmt: skip
        landing = in_flight()
        push(landing, 1.0, *pushes, late_s=5.0)
        s = cycle(1.2, landing)
        assert (s.knowledge.impact is not None and s.knowledge.impact.at == ns(1.01)) is felt
        assert (s.touch is not None and s.touch.at == ns(1.01)) is touched
        assert s.feels is feels
    assert not cycle(1.2, in_flight(), unfelt=True).feels
    stands = in_flight()
    stands.on_samples([status(0.5, False)])
    push(stands, 1.0, 20.0, 20.0)
    s = cycle(1.2, stands)
    assert s.knowledge.impact is s.touch is None


def hold_up(
    landing: LandingGuidance, deck_m_s: Any = lambda t: 0.0, *, known_deck: bool = True, trusts: bool = True, by: float = 0.5
) -> bool:
    """Return whether a vehicle has touched that goes with the deck for 4 s while it is ordered down to it."""
    for k in range(200):
        t, v = DT * k, deck_m_s(DT * k)
        impact = knowing(t, landing, None, deck(t, (0.0, 0.0, v)) if known_deck else None, trusts=trusts).impact
        landing.on_samples([velocity(t, (0.0, 0.0, v))])
        landing.on_command(ns(t), replace(DOWN, v_level=np.array([0.0, 0.0, v + by])))
    return impact is not None and impact.by == "velocity"


def test_an_autopilot_s_vehicle_that_is_held_up_against_its_orders_has_touched() -> None:
    """A deck that falls ever faster has passed the least of the orders over the ground: there the speed to it counts."""
    for more in ({}, {"known_deck": False}, {"deck_m_s": lambda t: 0.4 * t - 0.5}):
        assert hold_up(in_flight(over_ground=True), **more)
    assert not hold_up(in_flight(over_ground=True), by=0.2)
    assert not hold_up(in_flight(over_ground=True), trusts=False)
    assert not any(hold_up(landing) for landing in (in_flight(), in_flight(over_ground=True, at=State.LANDED)))


def test_a_flight_begins_with_nothing_of_the_flight_before() -> None:
    landing = in_flight()
    push(landing, 1.0, 20.0, 20.0)
    landing.on_pad(PadCheck(ns(1.0), 1.0, THING))
    s = cycle(1.1, landing)
    assert None not in (s.knowledge.impact, s.touch, s.thing)
    landing.on_samples([status(1.2, False), status(1.3)])
    assert (s := cycle(1.4, landing)).knowledge.impact is s.touch is s.thing is None


def test_a_range_counts_for_a_fifth_of_a_second_and_a_frame_until_one_is_fused() -> None:
    landing = in_flight()
    assert cycle(0.9, landing).range_m is None
    landing.on_samples([range_down(1.0, 1.7)])
    assert [cycle(1.0 + age_s, landing).range_m for age_s in (0.0, 0.2, 0.21)] == [1.7, 1.7, None]
    for verdict in (Verdict.GATED, Verdict.NO_PAD, Verdict.GATED):
        landing.on_verdict(verdict)
    assert cycle(1.0, landing).frames == {Verdict.GATED: 2, Verdict.NO_PAD: 1}
    landing.on_verdict(Verdict.FUSED)
    assert cycle(1.0, landing).frames == {}


def fuse(landing: LandingGuidance, delay_s: float, nis: float = math.nan, sigma_s: float = 0.001) -> Any:
    result = FusionResult("ekf", "sighting", Verdict.FUSED, ns(1.0), ns(1.0), components=("x_m", "y_m"), nis=nis)
    landing.on_fused(result, stamp(1.0, delay_s, sigma_s=sigma_s))
    return cycle(1.0, landing)


def test_the_camera_s_delay_is_the_least_of_late_and_its_agreement_a_mean_of_late() -> None:
    landing = in_flight()
    delays = [fuse(landing, delay_s).quality.delay_s for delay_s in (0.2, 0.1, 0.3, 0.3, 0.05)]
    assert delays[:2] == [0.2, 0.1], "it falls at once"
    assert 0.1 < delays[2] < delays[3] < 0.12, "one that is late is jitter"
    assert delays[4] == 0.05
    for _ in range(500):
        s = fuse(landing, 0.3, sigma_s=0.004)
    assert (s.quality.delay_s, s.quality.time_sigma_s) == (pytest.approx(0.3, abs=0.001), 0.004)
    assert s.quality.normalized_nis is None
    means = [fuse(landing, 0.3, nis).quality.normalized_nis for nis in (4.0, math.nan, 8.0, *[8.0] * 90)]
    assert means[:2] == [2.0, 2.0]
    assert 2.0 < means[2] < 2.5
    assert means[-1] == pytest.approx(4.0, abs=0.01)


def test_what_lies_on_the_pad_comes_first_and_counts_until_it_is_old() -> None:
    landing, lasts_s = in_flight(), GuidanceOptions().limits.on_pad_s
    for thing, words in ((THING, "something 20 cm wide lies 50 cm from"), (None, "something stands 170 cm out of the deck")):
        landing.on_pad(PadCheck(ns(1.0), 1.0, thing, NearThing(0.3, -0.4, 1.7), 0.31))
        landing.on_pad(None)  # a frame that says nothing takes nothing back
        s = cycle(1.0 + lasts_s, landing)
        assert (s.thing.text.startswith(words), s.unseen.measured) == (True, pytest.approx(31.0))
        s = cycle(1.01 + lasts_s, landing)
        assert s.thing is s.unseen is None


MOVES, ENDS = NearThing(0.3, -0.4, 0.0), (State.GO_AROUND, State.PAUSED, State.ABORTED, State.LANDED)
SEEN = (None, THING, replace(THING, width_m=0.5), replace(THING, right_m=0.1), replace(MOVES, height_m=1.7), MOVES, 0.3)


@pytest.mark.hazard("H5")
@given(st.lists(st.tuples(st.sampled_from(SEEN), st.sampled_from(["clear", "clear", "look", "late", *ENDS])), max_size=12))
def test_what_bars_is_ignored_as_it_was_seen_in_one_attempt_for_a_minute_and_never_what_moves(acts: Any) -> None:
    landing, t, ignored = in_flight(), 1.0, list[Any]()
    for seen, act in acts:
        t += 61.0 if act == "late" else 1.0
        landing.mission = replace(landing.mission, state=act if act in ENDS else State.DESCEND, since=ns(t))
        ignored = [] if act == "late" or act in ENDS else ignored
        on, near, glare = (seen if isinstance(seen, kind) else None for kind in (PadThing, NearThing, float))
        landing.on_pad(PadCheck(ns(t), 1.0, on, near, glare or 0.0))
        s = cycle(t, landing)
        assert ((s.thing or s.unseen) is not None) == (seen is not None and seen not in ignored)
        assert bool(landing.ignoring) is bool(ignored)
        if act == "clear" and landing.barred()[1]:
            landing.overrule()
            ignored.append(seen)
        assert MOVES not in ignored


def test_only_samples_of_the_vehicle_break_its_silence_and_late_ones_are_still_old() -> None:
    landing = in_flight()
    hers = GeoFix(stamp(2.0), "vessel", GeoPoint(0.9, 0.1, 0.0), 2.0)
    landing.on_samples([hers, vessel(2.0, heading_rad=0.5), gimbal(2.0, Rotation.identity())])
    s = cycle(2.0, landing)
    assert (s.silent_s, s.age_s) == (2.0, 2.0)
    for delay_s in (0.3, 0.4):
        landing.on_samples([attitude(stamp(3.0 - delay_s, delay_s))])
        s = cycle(3.0, landing)
        assert (s.silent_s, s.age_s) == pytest.approx((0.0, 0.3))


def rises(rate_m_s: float, *, climbs: bool = True, at: State = State.DESCEND, every: int = 1, seen: bool = False) -> Any:
    """Return what a cycle says of a vehicle that moves at a rate for 12 s while it is ordered to keep its height."""
    landing = in_flight(climb=ClimbResponse(0.1, 0.2, 1.0) if climbs else None, at=at)
    for k in range(120):
        t = 0.1 * k
        if k % every == 0:
            landing.on_samples([baro(t, rate_m_s * t)])
        enter(landing, at)
        s = cycle(t, landing, estimate(t) if seen else None)
        landing.on_command(ns(t), replace(DOWN, v_level=np.zeros(3)))
    return s.off_orders


def test_a_vehicle_that_rises_or_sinks_against_its_orders_is_off_them() -> None:
    for rate_m_s, words in ((1.5, "higher"), (-1.5, "lower")):
        found = rises(rate_m_s)
        assert (found.cause, found.detail) == (ReasonCause.OFF_ORDERS, words)
        assert found.measured >= 1.2
    for more in ({"climbs": False}, {"at": State.COMMIT}, {"at": State.LANDED}, {"every": 200}):
        assert rises(1.5, **more) is None
    assert rises(0.2) is None
    assert rises(1.5, seen=True) is None, "a pad that stays as near rises with it"
    assert rises(1.5, every=10) is not None, "an autopilot sends one reading a second"


def test_a_forecast_is_made_again_after_a_fifth_of_a_second_and_none_of_an_impossible_deck() -> None:
    landing, calm = in_flight(), deck(1.0)

    def ahead(now: int, horizons_s: Any) -> Any:
        return forecast(swell(0.5), now * 1e-9)

    made = [knowing(t, landing, None, calm, ahead=ahead).forecast for t in (1.0, 1.1, 1.19, 1.2, 1.3)]
    assert [None if f is None else f.at for f in made] == [ns(1.0)] * 3 + [ns(1.2)] * 2
    assert landing.forecast_made(ns(1.2)) is made[-1]
    assert landing.forecast_made(ns(1.3)) is None
    wild = knowing(1.4, landing, estimate(1.4), deck(1.4, (0.0, 0.0, 8.0)), ahead=ahead)
    assert wild.deck is wild.forecast is None
    assert (wild.relative.consistent, wild.relative.alerts) == (False, (IntegrityAlert.DECK,))
    for t, seen in ((2.4, False), (2.41, True)):
        assert (knowing(t, landing, None, calm, ahead=ahead).deck is not None) is seen
    assert [landing.doubted(ns(t)) for t in (1.5, 2.4, 2.41)] == [IntegrityAlert.DECK, IntegrityAlert.DECK, None]


def test_nobody_lands_after_a_second_without_the_accelerometer() -> None:
    landing = in_flight()
    assert all(knowing(t, landing, unfelt=True).unfelt for t in (1.0, 2.0, 2.1))
    assert [landing.doubted(ns(t)) for t in (1.5, 2.0, 2.01)] == [None, None, IntegrityAlert.UNFELT]
    assert not knowing(2.2, landing).unfelt
    assert landing.doubted(ns(9.0)) is None


@pytest.mark.parametrize(("own_deg", "flown_deg"), [(None, None), (25.0, 23.0), (45.0, 40.0), (3.0, 2.0)])
def test_the_vehicle_s_own_limits_count_up_to_the_owner_s(own_deg: float | None, flown_deg: float | None) -> None:
    landing = in_flight(guided(follow_deck={"tilt_max_deg": 40.0}))
    assert knowing(0.0, landing).jerk_max_m_s3 is None
    landing.on_samples([status(0.1, tilt_max_deg=own_deg, jerk_max_m_s3=9.0)])
    assert (found := knowing(0.2, landing)).tilt_max_deg == flown_deg
    assert found.jerk_max_m_s3 == 9.0


def in_wind(landing: LandingGuidance, lean_rad: float = 0.3, seconds: float = 20.0, **more: Any) -> Any:
    """Return the last cycle of a vehicle that leans into a steady wind from ahead."""
    leaning, state = Rotation.from_rpy(0.0, -lean_rad, 0.0), landing.state
    for k in range(round(seconds / 0.1)):
        t = 0.1 * k
        landing.on_samples([attitude(t, 0.0, -lean_rad)])
        s = cycle(t, landing, estimate(t, **more), deck(t), of_body=body(t, reported=leaning))
        enter(landing, state)
    return s


def test_against_the_wind_the_contact_is_wanted_to_lee_and_expected_with_its_gusts() -> None:
    near: dict[str, Any] = {"d": (0.1, 0.0, 0.6)}
    s = in_wind(in_flight(FOLLOWS, at=State.GATE), **near)
    contact = s.knowledge.at_contact
    assert s.wind.into_level == pytest.approx((1.0, 0.0), abs=1e-6)
    assert s.knowledge.aim_level == s.wind.aim_level(GuidanceOptions().cone.feet_below_m)
    assert s.knowledge.aim_level[0] < -0.01
    assert (contact.gust_m_s, contact.gust_most_m_s) == (s.wind.begins_m_s, s.wind.begins_most_m_s)
    assert contact.error_m > 0.0
    assert in_wind(in_flight(FOLLOWS), seconds=1.0, **near).knowledge.at_contact is None, "far from the deck nobody looks ahead"
    early = in_wind(in_flight(FOLLOWS, at=State.GATE), seconds=0.5, **near)
    contact = early.knowledge.at_contact
    assert (early.wind, contact.sigma_m, contact.gust_most_m_s) == (None, pytest.approx(0.01), math.inf)
    ends, less = in_flight(FOLLOWS, at=State.GATE), in_flight()
    ends.on_samples([status(0.1 * k, battery_fraction=0.05) for k in range(40)])
    assert in_wind(ends, **near).knowledge.at_contact.gust_most_m_s == math.inf, "no gust bars it while the battery ends"
    less.on_samples([status(0.0, tilt_max_deg=14.0)])
    assert in_wind(less).wind.limit_m_s < s.wind.limit_m_s, "it tilts less than its file says"


def test_without_a_measured_velocity_the_loop_is_closed_on_the_sight_and_the_tilt_that_holds_against_the_wind() -> None:
    forward = Velocity(np.array([0.5, 0.0, -0.3]), 0.1)

    def instead(landing: LandingGuidance, seen: Any = None, of_body: Any = None, *, guided: bool = True) -> Any:
        return landing.without_velocity(forward, knowing(20.0, landing, seen, of_body=of_body), guided=guided)

    landing, back = in_flight(), (-0.5, 0.0, 0.0)
    in_wind(landing)
    for of_body in (body(20.0, reported=Rotation.from_rpy(0.0, -0.3, 0.0)), None):
        given = [instead(landing, seen, of_body) for seen in (estimate(20.0, v=back), None, estimate(20.0, v=back, age=3.0))]
        assert given[0].trim_level == pytest.approx([G_M_S2 * math.tan(0.3), 0.0], rel=0.01)
        assert [lean.a_level[0] > 0.0 for lean in given] == [True, False, False], "guidance flies nowhere without sight"
    assert instead(landing, guided=False).a_level[0] > 0.0
    assert instead(in_flight()).trim_level.tolist() == [0.0, 0.0]
    assert instead(in_flight(over_ground=True), estimate(20.0)) is forward


def test_only_what_somebody_else_sends_takes_the_known_height_from_the_mission() -> None:
    for mine, height_m in ((True, 5.0), (False, math.inf)):
        landing = enter(in_flight(), State.PAUSED, seen_height_m=5.0)
        ordered = landing.command(knowing(1.0, landing))
        landing.on_command(ns(1.0), ordered if mine else DOWN)
        assert landing.mission.seen_height_m == height_m
    landing = enter(in_flight(), State.SEARCH, seen_height_m=0.2)
    landing.on_samples([status(1.0)])
    ordered = landing.command(knowing(1.0, landing))
    assert isinstance(ordered, Velocity)
    landing.on_command(ns(1.0), landing.without_velocity(ordered, knowing(1.0, landing, trusts=False), guided=True))
    assert landing.mission.climbs_m_s > 0.0, "the tilt that stands for a climb climbs as ordered"


def test_an_order_of_a_person_counts_from_the_newest_instant_that_is_known() -> None:
    landing = enter(in_flight(), State.REFUSED)
    landing.on_samples([status(stamp(3.0, 0.1)), imu(stamp(2.0, 0.1))])
    landing.order(Event.BEGIN)
    assert landing.mission.asked_at == ns(3.1)
    landing = in_flight()
    landing.command(knowing(4.0, landing))
    landing.order(Event.HOLD)
    assert [(c.at, c.target) for c in landing.changed()][-1] == (ns(4.0), State.PAUSED)
    assert landing.changed() == ()


def test_a_vehicle_that_a_person_took_is_commanded_again_once_he_gives_it_back() -> None:
    for resumes, then in ((True, State.SEARCH), (False, State.TAKEN)):
        landing = in_flight(resumes=resumes)
        landing.on_samples([status(1.0, taken="a person took it")])
        assert landing.state is State.TAKEN
        assert landing.command(knowing(1.1, landing, estimate(1.1))) == Hover()
        assert landing.reason == "a person took it"
        landing.on_samples([status(2.0)])
        assert landing.state is then
    pilot = Pilot(EYES, EstimatorOptions(), GuidanceOptions())
    pilot.landing = enter(in_flight(), State.GAVE_UP)
    pilot.on_sample(status(1.0, taken="a person took it"))
    assert (pilot.state, pilot.outcome) == (State.TAKEN, FlightOutcome.GAVE_UP)


def test_a_dip_of_the_battery_lands_no_refused_drone_where_it_is() -> None:
    """WHY: one report of 4 % while a climb loaded the battery brought it down into the sea."""
    landing = enter(in_flight(), State.REFUSED)
    for n in range(600):
        charge = 0.04 if 5.0 <= 0.02 * n < 7.5 or 0.02 * n >= 8.0 else 0.3
        landing.on_samples([status(0.02 * n, battery_fraction=charge)])
        landing.command(Knowledge(ns(0.02 * n), None))
        assert (landing.state is State.LAND_HERE) is (0.02 * n >= 8.0 + DWELL_S), 0.02 * n


@pytest.mark.parametrize(
    ("state", "memory", "text"),
    [
        (State.GATE, {"kept": Gate(waits_for=WHY)}, WHY.text), (State.GATE, {"kept": Gate()}, ""),
        (State.DESCEND, {"fault": WHY, "reason": WHY}, ""), (State.REFUSED, {"fault": WHY}, WHY.text),
        (State.GO_AROUND, {"fault": WHY}, WHY.text), (State.HOLD_BLIND, {"reason": WHY, "fault": None}, WHY.text),
        (State.REFUSED, {"reason": WHY}, ""), (State.PAUSED, {"reason": WHY}, ""),
    ],
)  # fmt: skip
def test_the_operator_reads_why_it_does_not_simply_descend(state: State, memory: dict[str, Any], text: str) -> None:
    assert enter(in_flight(), state, **memory).reason == text


def test_over_the_pad_the_operator_reads_what_lies_there_and_on_the_way_that_video_is_late() -> None:
    landing = in_flight(at=State.INTERCEPT)
    landing.on_pad(PadCheck(ns(1.0), 1.0, THING))
    cycle(1.0, landing)
    thing = "something 20 cm wide lies 50 cm from the pad's centre"
    assert [enter(landing, state).reason for state in (State.INTERCEPT, State.DESCEND)] == [thing, ""]
    for delay_s, late in ((0.14, False), (0.15, True)):
        landing = in_flight()
        fuse(landing, delay_s)
        assert enter(landing, State.DESCEND).reason.startswith("video is 0.15 s late: ") is late
        assert enter(landing, State.PAUSED).reason == ""


@pytest.mark.parametrize(("charge", "reads"), [(0.19, True), (0.2, False), (None, False)])
def test_a_refused_drone_says_from_15_percent_over_the_last_charge_on_that_it_lands_there(charge: Any, reads: bool) -> None:
    landing = enter(in_flight(), State.REFUSED, fault=WHY)
    landing.on_samples([status(0.1 * k, battery_fraction=charge) for k in range(40)])
    words = "; battery at 19 %: at 5 % it lands where it is"
    assert landing.reason == WHY.text + (words if reads else "")


def test_the_operator_reads_the_way_to_the_ship_where_it_is_flown_by_her_reports() -> None:
    harbour = GeoPoint.of_degrees(54.4, 10.2, 0.0)
    landing = in_flight(guided(rendezvous={"enabled": True}), at=State.RENDEZVOUS)
    hers = GeoFix(stamp(1.0), "vessel", moved(harbour, np.array([37.0, 0.0, 0.0])), 2.0)
    landing.on_samples([attitude(1.0), GeoFix(stamp(1.0), "vehicle", harbour, 2.0), hers, vessel(1.0, (1.0, 0.5, 0.0))])
    s = cycle(1.0, landing)
    assert isinstance(s.vessel, VesselPosition)
    assert landing.reason == "the vessel is 37 m away"
    assert landing.vessel_track.velocity_ned(ns(1.0)) == pytest.approx([1.0, 0.5])
    assert landing.vessel_track.counted()["taken"] >= 1.0
    assert enter(landing, State.SEARCH).reason == enter(landing, State.DESCEND).reason == ""
    assert cycle(1.0, landing).vessel is None, "over the pad nobody flies by her reports"
    late = cycle(60.0, enter(landing, State.RENDEZVOUS))
    for state, text in ((State.RENDEZVOUS, late.vessel.text), (State.SEARCH, late.vessel.text), (State.DESCEND, "")):
        assert enter(landing, state).reason == text
    assert cycle(1.0, in_flight(at=State.SEARCH)).vessel is None, "the settings allow no rendezvous"


NEAR_M, HIGH_M = 5.0 * EYES.pad.disc_radius_m, 4.4
"""Heights over the pad: that of the drawn one, and one from which much of the deck is in the picture."""
PAD = drawn(EYES.camera, EYES.pad)[40:320, 180:460]
SILENT_S, ENDS_S = (1.2, 2.4), 2.8
"""Times between which no sample comes, and the end. It comes sooner than a pad elsewhere is adopted."""
BEFORE_M, AFTER_M = 0.0, 0.85
"""The pad is in the picture so far aside before and after. It is farther than two pads may lie apart."""


Places = list[tuple[float, float]]
"""Places of pads in the picture, m to the right of its centre and below it."""


class Filmed(FakeFlight):
    """A vehicle that holds still by its sensors; its pictures show pads by the time."""

    def __init__(self, clock: VirtualClock, pads: Callable[[float], Places], height_m: float) -> None:
        super().__init__(clock)
        self._pads, self._height_m = pads, height_m

    def command(self, command: Command) -> None:
        """Hold still by itself, whatever is ordered."""

    def sense(self, n: int) -> None:
        if not SILENT_S[0] <= n * TICK_S < SILENT_S[1]:
            super().sense(n)

    def picture(self, n: int) -> NDArray[np.uint8]:
        px_m = EYES.camera.fx / self._height_m
        small = cv2.resize(PAD, None, fx=NEAR_M / self._height_m, fy=NEAR_M / self._height_m, interpolation=cv2.INTER_AREA)
        px = np.empty((EYES.camera.height, EYES.camera.width, 3), np.uint8)
        px[:] = PAD[0, 0]
        for right_m, below_m in self._pads(n * TICK_S):
            u = round(EYES.camera.cx + px_m * right_m - 0.5 * len(small))
            v = round(EYES.camera.cy + px_m * below_m - 0.5 * len(small))
            shows = px[max(0, v) : max(0, v + len(small)), max(0, u) : max(0, u + len(small))]
            shows[:] = small[max(0, -v) :, max(0, -u) :][: shows.shape[0], : shows.shape[1]]
        return px + super().picture(n)


def slides(t: float) -> Places:
    """Return the pad's place while the vehicle drifts over it during the silence."""
    return [(float(np.interp(t, SILENT_S, (BEFORE_M, AFTER_M))), 0.0)]


def leaves(t: float) -> Places:
    """Return the place of a pad that leaves the picture, and of one that comes into it at another place."""
    return [] if 1.6 <= t < 1.8 else [(BEFORE_M if t < 1.7 else AFTER_M, 0.0)]


def jumps(t: float) -> Places:
    """Return the place of one pad, and from one picture to the next that of another."""
    return [(BEFORE_M if t < 1.8 else AFTER_M, 0.0)]


def swings(t: float) -> Places:
    """Return the place of a pad that swings out of the picture for half a second and back, while the vehicle drifts over it."""
    return [(0.3, float(np.interp(t, (1.4, 1.6, 1.9, 2.1, 2.4), (-1.2, -3.0, -3.0, -1.3, -0.35))))]


def swings_on(t: float) -> Places:
    """Return a pad that swings out of the picture, and another one that swings near to its place; it was covered at first."""
    below_m = float(np.interp(t, (1.4, 1.6, 1.9, 2.1), (-1.2, -3.0, -3.0, -2.6)))
    return [(0.3, below_m), *([(1.1, below_m + 1.3)] if t > 0.9 else [])]


@pytest.mark.parametrize(
    ("pads", "height_m", "same"),
    [(slides, NEAR_M, True), (leaves, NEAR_M, False), (jumps, NEAR_M, False), (swings, HIGH_M, True), (swings_on, HIGH_M, False)],
)
def test_a_pad_is_known_again_after_a_silence_in_which_no_other_one_can_have_come(pads, height_m, same):
    clock, diary = VirtualClock(), ObservedCalls()
    vehicle = Filmed(clock, pads, height_m)
    pilot = Pilot(EYES, EstimatorOptions(), GuidanceOptions())
    daemon = Daemon(vehicle.open, pilot, clock, DaemonSetup(RESTART, 50.0), observers=[diary])
    asyncio.run(fly(daemon, vehicle, clock, ENDS_S))
    verdicts = [(f.frame.stamp.measured_at * 1e-9, f.verdict) for f in diary.frames]
    before, silent, after = ([v for t, v in verdicts if a < t < b] for a, b in ((0.5, 1.2), (1.3, 2.38), (2.45, ENDS_S)))
    assert set(before) == {Verdict.FUSED}
    assert set(silent) == {Verdict.NO_ATTITUDE}, "nothing is fused by an attitude that nobody knows"
    assert set(after) == ({Verdict.FUSED} if same else {Verdict.ELSEWHERE})
    assert pilot.estimator.guard.tracks.number == 1


@pytest.mark.hazard("H3")
@pytest.mark.parametrize(("mode", "until_s"), [("auto.loiter", 3.0), ("offboard", 0.0), ("flying", 0.0), ("auto.loiter", 99.0)])
def test_a_climb_counts_once_the_autopilot_flies_it_and_not_while_it_takes_the_mode(mode: str, until_s: float) -> None:
    """WHY: a PX4 in its failsafe's Hold took 2.5 s to obey; 4 m counted as climbed, and it searched 1.2 m over the deck."""
    landing = in_flight(at=State.SEARCH, over_ground=True, automatic=False)
    height_m, most_s = 0.4, 0.0
    for n in range(round(20.0 / DT)):
        t = n * DT
        obeys = t >= until_s
        landing.on_samples([status(t, mode="offboard" if obeys and until_s else mode), range_down(t, height_m)])
        command = landing.command(knowing(t, landing))
        landing.on_command(ns(t), command)
        if isinstance(command, Velocity) and command.v_level[2] < 0.0:
            height_m += DT * -float(command.v_level[2]) if obeys else 0.0
            most_s = t
    assert until_s > 20.0 or height_m > GuidanceOptions().tries.safe_height_m - 0.3
    assert most_s < 19.0, "and one that never takes it is not sent up for ever"
