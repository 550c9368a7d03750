"""The ship's place by reports: carried on, doubted with its age, and refused where it cannot be hers."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.base.mission import ReasonCause
from companion.guidance.mission.progress import VesselPosition
from companion.guidance.mission.vessel_track import VesselTrack
from companion.settings.vessel import ReportLimits
from estimator.contracts.geometry import GeoPoint, moved
from estimator.contracts.samples import GeoFix, VesselReport
from tests.make import attitude, ns, stamp

HARBOUR = GeoPoint.of_degrees(54.4, 10.2, 0.0)


def fix(whose, t, north, east, up=0.0, *, late_s=0.0, sigma_m=2.0, v=None) -> GeoFix:
    v_ned = None if v is None else np.array([*v, 0.0])
    return GeoFix(stamp(t, late_s, sigma_s=0.01), whose, moved(HARBOUR, np.array([north, east, -up])), sigma_m, v_ned)


def course(t: float, v: tuple[float, float], heading: float | None = None) -> VesselReport:
    sigma = None if heading is None else 0.05
    return VesselReport(stamp(t), np.array([*v, 0.0]), 0.01 * np.eye(3), heading, sigma)


def track_after(*samples, limits: ReportLimits | None = None, yaw: float = 0.0, until: float = 10.0) -> VesselTrack:
    """Return a track after these samples, of a vehicle 30 m up at the harbour whose own reports never stop."""
    track = VesselTrack(limits or ReportLimits())
    for sample in samples:
        track = track.on_sample(sample)
    track = track.on_sample(fix("vehicle", until, 0.0, 0.0, 30.0, v=(0.0, 0.0)))
    return track.on_sample(attitude(until, yaw=yaw))


def position_at(track: VesselTrack, t: float) -> VesselPosition:
    place = track.position(ns(t))
    assert isinstance(place, VesselPosition), place
    return place


def cause(track: VesselTrack, t: float) -> ReasonCause:
    why = track.position(ns(t))
    return why.cause


def test_the_place_goes_on_with_her_velocity_and_turns_into_the_drone_s_axes() -> None:
    track = track_after(course(8.0, (3.0, 0.0)), fix("vessel", 8.0, 40.0, 10.0, 4.0), yaw=math.pi / 2)
    place = position_at(track, 10.0)
    assert place.d_body_pad_level == pytest.approx([10.0, -46.0], abs=0.01), "46 m north, 10 m east, and the nose is east"
    assert place.v_level == pytest.approx([0.0, -3.0], abs=1e-6)
    assert place.height_m == pytest.approx(26.0, abs=0.01)
    assert place.bow_known
    assert place.axis_rad == pytest.approx(-math.pi / 2), "without a compass the course is the heading"


def test_a_ship_that_reports_her_rate_of_turn_is_carried_round() -> None:
    """Three seconds on a circle of 30 m at 3 m/s; the pad is 10 m behind the antenna and swings with her."""
    rate, v, t = 0.1, 3.0, 3.0
    turning = VesselReport(stamp(8.0), np.array([v, 0.0, 0.0]), 0.01 * np.eye(3), 0.0, 0.05, rate, 0.01)
    later = VesselReport(stamp(8.0 + t - 1.0), None, None, None, None, rate, 0.01)
    limits = ReportLimits(pad_forward_m=-10.0)
    place = position_at(track_after(turning, fix("vessel", 8.0, 40.0, 0.0, 4.0), later, limits=limits), 8.0 + t)
    bow = np.array([math.cos(rate * t), math.sin(rate * t)])
    antenna = np.array([40.0 + v / rate * math.sin(rate * t), v / rate * (1.0 - math.cos(rate * t))])
    assert place.d_body_pad_level == pytest.approx(antenna - 10.0 * bow, abs=0.05)
    assert place.v_level == pytest.approx(v * bow - 10.0 * rate * np.array([-bow[1], bow[0]]), abs=0.01)
    assert place.axis_rad == pytest.approx(rate * t)


def test_the_pad_lies_where_the_ship_s_heading_puts_it() -> None:
    limits = ReportLimits(pad_forward_m=-12.0, pad_right_m=3.0, pad_up_m=2.0)
    samples = course(9.0, (0.0, 0.0), heading=math.pi / 2), fix("vessel", 9.0, 0.0, 50.0, 4.0)
    place = position_at(track_after(*samples, limits=limits), 9.0)
    assert place.d_body_pad_level == pytest.approx([-3.0, 38.0], abs=0.01)
    assert place.height_m == pytest.approx(24.0, abs=0.01)
    adrift = position_at(track_after(course(9.0, (0.0, 0.0)), fix("vessel", 9.0, 0.0, 50.0, 4.0), limits=limits), 9.0)
    assert not adrift.bow_known
    assert adrift.sigma_m > 12.0, "a pad whose side nobody knows is as uncertain as it is far from the receiver"


def test_it_is_less_certain_with_age_and_unknown_in_the_end() -> None:
    track = track_after(course(5.0, (1.5, 0.0)), fix("vessel", 5.0, 60.0, 0.0), until=5.0)
    sigmas = []
    for t in (5.0, 6.0, 8.0, 9.9):
        track = track.on_sample(fix("vehicle", t, 0.0, 0.0, 30.0, v=(0.0, 0.0)))
        track = track.on_sample(attitude(t))
        sigmas.append(position_at(track, t).sigma_m)
    assert sigmas == sorted(sigmas)
    assert sigmas[-1] > sigmas[0] + 0.5
    track = track.on_sample(fix("vehicle", 10.2, 0.0, 0.0, 30.0))
    track = track.on_sample(attitude(10.2))
    assert cause(track, 10.2) is ReasonCause.VESSEL_OLD


@pytest.mark.parametrize(
    ("report", "counter", "why"),
    [
        (fix("vessel", 9.5, 100.0, 60.0), "vessel_jump", ReasonCause.VESSEL_JUMPED),
        (fix("vessel", 9.5, 41.0, 0.0, late_s=10.0), "vessel_stale", ReasonCause.VESSEL_LATE),
        (fix("vessel", 9.5, 41.0, 0.0, v=(30.0, 0.0)), "vessel_too_fast", ReasonCause.VESSEL_TOO_FAST),
    ],
)
def test_what_cannot_be_hers_is_refused_counted_and_named(report: GeoFix, counter: str, why: ReasonCause) -> None:
    before = fix("vessel", 9.0, 40.0, 0.0)
    track = track_after(before, report)
    assert track.counted() == {"taken": 1, counter: 1}
    assert position_at(track, 10.0).d_body_pad_level == pytest.approx([40.0, 0.0], abs=0.01), (
        "flown by the one before, while it is fresh"
    )
    late = report.stamp.received_at * 1e-9 + 4.9
    track = track.on_sample(fix("vehicle", late, 0.0, 0.0, 30.0))
    track = track.on_sample(attitude(late))
    assert cause(track, late) is why


def test_a_jump_is_accepted_when_a_person_begins_again_or_after_a_long_silence() -> None:
    jumped = fix("vessel", 9.5, 140.0, 0.0)
    track = track_after(fix("vessel", 9.0, 40.0, 0.0), jumped)
    again = track.restarted().on_sample(fix("vessel", 10.0, 140.0, 0.0))
    assert position_at(again, 10.0).distance_m == pytest.approx(140.0, abs=0.1)
    later = track_after(fix("vessel", 9.0, 40.0, 0.0), fix("vessel", 45.0, 140.0, 0.0), until=45.0)
    assert position_at(later, 45.0).distance_m == pytest.approx(140.0, abs=0.1)


def test_a_drone_without_a_place_or_a_heading_of_its_own_is_reported() -> None:
    track = VesselTrack().on_sample(fix("vessel", 1.0, 40.0, 0.0))
    assert cause(track, 1.0) is ReasonCause.NO_OWN_PLACE
    track = track.on_sample(fix("vehicle", 1.0, 0.0, 0.0))
    assert cause(track, 1.0) is ReasonCause.NO_OWN_HEADING
    assert cause(track_after(), 10.0) is ReasonCause.VESSEL_SILENT
    assert cause(track_after(fix("vessel", 9.9, 40.0, 0.0, sigma_m=40.0)), 10.0) is ReasonCause.VESSEL_SIGMA


REPORT = st.builds(
    lambda t, n, e, late, whose: fix(whose, t, n, e, late_s=late),
    st.floats(0, 60), st.floats(-500, 500), st.floats(-500, 500), st.floats(0, 20), st.sampled_from(["vehicle", "vessel"]),
)  # fmt: skip


@given(st.lists(REPORT, max_size=20))
def test_every_place_of_the_ship_is_taken_or_counted_and_no_taken_one_is_late(reports: list[GeoFix]) -> None:
    track, limits = VesselTrack(), ReportLimits()
    for report in reports:
        track = track.on_sample(report)
        if track.vessel is not None:
            assert track.vessel.stamp.delay_s <= limits.age_max_s
    ship = sum(report.whose == "vessel" for report in reports)
    assert track.taken + sum(n for name, n in track.refused.items() if name.startswith("vessel")) == ship
