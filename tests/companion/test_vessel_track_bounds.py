"""Bounds of the ship's track: old reports, speeds and jumps at their limits, and the uncertainty of the place in numbers."""

import math

import numpy as np
import pytest

from companion.base.reason import Reason, ReasonCause
from companion.guidance.mission import rendezvous
from companion.guidance.mission.cycle import VesselPosition
from companion.guidance.mission.rendezvous import VesselTrack
from companion.settings.rendezvous import ReportLimits
from estimator.contracts.geodesy import GeoPoint, moved
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, GeoFix, VesselReport
from tests.companion.test_vessel_track import HARBOUR, ns, stamp

LIMITS = ReportLimits()
BELOW, ABOVE = 1.0 - 1e-4, 1.0 + 1e-4


def fix(whose, t, d=(0.0, 0.0, 0.0), *, late_s=0.0, sigma_m=2.0, v=None, origin=HARBOUR) -> GeoFix:
    place = moved(origin, np.array(d, dtype=float))
    return GeoFix(stamp(t, late_s), whose, place, sigma_m, None if v is None else np.array(v, dtype=float))


def nose(t, yaw=0.0) -> Attitude:
    return Attitude(stamp(t), Rotation.from_rpy(0.05, -0.1, yaw), 1e-4 * np.eye(3))


def report(t, v=None, var=(0.04, 0.01), heading=None, late_s=0.0) -> VesselReport:
    has_v = v is not None
    return VesselReport(
        stamp(t, late_s), np.array([*v, 9.0]) if has_v else None, np.diag([*var, 25.0]) if has_v else None,
        heading, None if heading is None else 0.05,
    )  # fmt: skip


def track_of(*samples, limits: ReportLimits = LIMITS) -> VesselTrack:
    track = VesselTrack(limits)
    for sample in samples:
        track = rendezvous.on_sample(track, sample)
    return track


def found(track: VesselTrack, t: float) -> VesselPosition | ReasonCause:
    place = rendezvous.position(track, ns(t))
    return place.cause if isinstance(place, Reason) else place


def known(track: VesselTrack, t: float) -> VesselPosition:
    place = found(track, t)
    assert isinstance(place, VesselPosition), place
    return place


# How old a report may be


def test_the_ship_s_place_counts_until_its_age_reports_it() -> None:
    old = LIMITS.age_max_s
    for age_s, counts in ((old, True), (old + 0.001, False)):
        t = 20.0 + age_s
        reason = rendezvous.position(track_of(fix("vessel", 20.0), fix("vehicle", t), nose(t)), ns(t))
        assert isinstance(reason, VesselPosition) is counts
        if isinstance(reason, Reason):
            assert (reason.cause, reason.measured, reason.limit) == (ReasonCause.VESSEL_OLD, pytest.approx(age_s), old)


def test_her_velocity_counts_until_it_is_forgotten() -> None:
    for age_s, counts in ((LIMITS.forget_s, True), (LIMITS.forget_s + 0.001, False)):
        t = 100.0
        track = track_of(report(t - age_s, (2.0, -1.0)), fix("vessel", t, (30.0, 0.0, 0.0)), fix("vehicle", t), nose(t))
        v = rendezvous.velocity_ned(track, ns(t))
        assert (v is not None) is counts
        assert known(track, t).v_level == pytest.approx([2.0, -1.0] if counts else [0.0, 0.0])
    assert rendezvous.velocity_ned(VesselTrack(), ns(1.0)) is None


# What cannot be


def test_a_speed_beyond_the_limit_is_refused_of_the_ship_and_of_the_vehicle() -> None:
    top = LIMITS.speed_max_m_s
    for factor, taken in ((1.0, True), (ABOVE, False)):
        assert (track_of(fix("vessel", 5.0, v=(0.6 * factor * top, 0.8 * factor * top, 0.0))).vessel is not None) is taken
        assert (track_of(report(5.0, (-0.6 * factor * top, 0.8 * factor * top))).velocity is not None) is taken
        assert (track_of(fix("vehicle", 5.0, v=(0.0, 24.0 * factor, -32.0 * factor))).vehicle is not None) is taken
    fast = track_of(
        fix("vessel", 5.0, v=(0.0, 2.0 * top, 0.0)), report(5.0, (2.0 * top, 0.0)), fix("vehicle", 5.0, v=(0.0, 0.0, 41.0))
    )
    assert fast.counted() == {"taken": 0, "vessel_too_fast": 2, "vehicle_too_fast": 1}


def test_after_a_long_silence_any_place_is_accepted() -> None:
    for gap_s, estimate in ((LIMITS.forget_s, False), (LIMITS.forget_s + 0.001, True)):
        track = track_of(fix("vessel", 7.0), fix("vessel", 7.0 + gap_s, (9000.0, 0.0, 0.0)))
        assert (track.counted()["taken"] == 2) is estimate


def test_why_she_is_refused_is_reported_while_her_reports_arrive_and_forgotten_with_the_next_good_one() -> None:
    jumped = fix("vessel", 10.0, (5000.0, 0.0, 0.0), late_s=0.5)
    before = fix("vessel", 9.0)
    for since_s, cause in ((LIMITS.age_max_s, ReasonCause.VESSEL_JUMPED), (LIMITS.age_max_s + 0.001, ReasonCause.VESSEL_OLD)):
        t = 10.5 + since_s
        assert found(track_of(before, jumped, fix("vehicle", t), nose(t)), t) is cause
    assert track_of(before, jumped, fix("vessel", 11.0)).newest_refusal is None
    again = rendezvous.restarted(track_of(before, jumped, fix("vehicle", 10.6), nose(10.6)))
    assert found(again, 10.6) is ReasonCause.VESSEL_SILENT
    t = 8.5
    earlier = track_of(before, fix("vessel", t), fix("vehicle", t), nose(t))
    assert found(rendezvous.restarted(earlier), t) is ReasonCause.VESSEL_SILENT
    alone = track_of(fix("vessel", 9.0, v=(99.0, 0.0, 0.0)), fix("vehicle", 9.0), nose(9.0))
    assert found(alone, 9.0) is ReasonCause.VESSEL_TOO_FAST


# Where the pad is, and how well that is known


def test_both_places_are_carried_on_to_the_instant_by_their_velocities() -> None:
    t = 20.0
    track = track_of(
        report(18.0, (3.0, -1.0), heading=0.5), fix("vessel", 18.0, (40.0, 10.0, -4.0)),
        fix("vehicle", 19.0, (2.0, 1.0, -30.0), v=(1.0, 2.0, -0.5)), nose(t, 0.9),
    )  # fmt: skip
    place = known(track, t)
    ned = np.array([40.0 + 6.0 - 2.0 - 1.0, 10.0 - 2.0 - 1.0 - 2.0])
    c, s = math.cos(0.9), math.sin(0.9)
    assert place.d_body_pad_level == pytest.approx([c * ned[0] + s * ned[1], c * ned[1] - s * ned[0]], abs=0.01)
    assert place.v_level == pytest.approx([c * 3.0 - s, -c - s * 3.0])
    assert place.height_m == pytest.approx(30.0 - 4.0 + 0.5, abs=0.01)
    assert place.axis_rad == pytest.approx(0.5 - 0.9)
    assert place.at == ns(t)


def test_a_place_that_is_too_uncertain_is_none_and_says_by_how_much() -> None:
    limits = ReportLimits(sigma_max_m=5.0)
    for sigma_m, counts in ((4.0, True), (4.001, False)):
        samples = fix("vessel", 9.0, sigma_m=3.0), fix("vehicle", 9.0, sigma_m=sigma_m, v=(0.0, 0.0, 0.0))
        reason = rendezvous.position(track_of(*samples, nose(9.0), limits=limits), ns(9.0))
        assert isinstance(reason, VesselPosition) is counts
        if isinstance(reason, Reason):
            assert (reason.cause, reason.limit) == (ReasonCause.VESSEL_SIGMA, 5.0)
            assert reason.measured == pytest.approx(math.hypot(3.0, sigma_m))


def test_her_height_is_the_newest_that_she_reported_and_that_of_the_sea_before() -> None:
    flat = GeoPoint(HARBOUR.latitude_rad, HARBOUR.longitude_rad)
    limits = ReportLimits(pad_up_m=1.5)
    own = fix("vehicle", 9.0, (0.0, 0.0, -30.0), v=(0.0, 0.0, 0.0)), nose(9.0)
    without = fix("vessel", 9.0, (20.0, 0.0, 0.0), origin=flat)
    assert known(track_of(without, *own, limits=limits), 9.0).height_m == pytest.approx(28.5, abs=0.01)
    noted = fix("vessel", 8.9, (20.0, 0.0, -6.0))
    assert known(track_of(noted, without, *own, limits=limits), 9.0).height_m == pytest.approx(22.5, abs=0.01)
    blind = fix("vehicle", 9.0, (0.0, 0.0, 0.0), origin=flat), nose(9.0)
    assert known(track_of(noted, *blind), 9.0).height_m is None
