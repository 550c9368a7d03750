"""Identity of the pad: motion explains a place, or it is another pad; and an arbiter follows by sightings alone."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs, Stamp
from estimator.integrity.options import IntegrityOptions
from estimator.integrity.tracks import (
    Arbiter,
    Place,
    TrackCandidate,
    Tracks,
    add_fused,
    arbitrate,
    associate,
    compare_estimate,
    follow,
    record_fused,
)

LIMITS = IntegrityOptions()
ASSUMED = Attitude(Stamp(MonoNs(0), MonoNs(0), 0.0, "sim"), Rotation.identity(), 0.01 * np.eye(3))


def place(t_s: float, d: tuple[float, float, float], sigma_m: float = 0.01) -> Place:
    return Place(round(t_s * 1e9), d, sigma_m, sigma_m)


def follow_all(tracks: Tracks, looks: list[Place], expected: Place | None = None) -> tuple[Tracks, list[bool]]:
    out = []
    for seen in looks:
        tracks, explained = associate(tracks, seen, None if expected is None else expected._replace(t=seen.t), LIMITS)
        if explained:
            tracks = add_fused(tracks, seen)
        out.append(explained)
    return tracks, out


def steady(begin_s: float, end_s: float, d: tuple[float, float, float], every: int = 1) -> list[Place]:
    return [place(i / 30, d) for i in range(round(begin_s * 30), round(end_s * 30), every)]


HERE, ASIDE = (0.1, 0.0, 2.0), (1.1, 0.0, 2.0)


def test_a_pad_that_moves_as_things_move_is_one_track() -> None:
    rng = np.random.default_rng(2)
    looks = [place(i / 30, (0.5 * i / 30 + 0.01 * rng.normal(), 0.01 * rng.normal(), 4.0 - 0.5 * i / 30)) for i in range(200)]
    tracks, explained = follow_all(Tracks(), looks)
    assert tracks.number == 1
    assert all(explained)


@pytest.mark.parametrize("aside_m", [0.5, 1.0, 2.5])
@pytest.mark.parametrize("height_m", [0.6, 1.0, 2.7])
def test_a_jump_is_another_pad_and_the_track_is_not_moved_to_it(aside_m: float, height_m: float) -> None:
    tracks, _ = follow_all(Tracks(), steady(0, 2, (0.0, 0.0, height_m)))
    tracks, explained = follow_all(tracks, steady(2, 3.9, (aside_m, 0.0, height_m)), place(0, (0.0, 0.0, height_m), 0.05))
    assert not any(explained)
    assert tracks.number == 1
    assert tracks.disputed_at == pytest.approx(3.9e9, abs=0.04e9)


def test_only_after_its_time_a_new_track_with_a_new_number_begins() -> None:
    tracks, _ = follow_all(Tracks(), steady(0, 2, HERE))
    tracks, explained = follow_all(tracks, steady(2, 5, ASIDE))
    assert tracks.number == 2
    assert explained.index(True) == pytest.approx(LIMITS.adopt_s * 30, abs=2)
    assert all(explained[explained.index(True) :])


@pytest.mark.parametrize(
    ("aside_m", "down_m", "number"), [(0.38, 0.0, 1), (0.4, 0.0, 2), (0.3, 0.3, 1), (0.0, 1.5, 1), (0.4, 1.5, 2)]
)
def test_where_no_other_pad_can_lie_it_is_the_tracked_one_after_that_time(aside_m: float, down_m: float, number: int) -> None:
    expected = (HERE[0] + aside_m, HERE[1], HERE[2] + down_m)
    tracks, _ = follow_all(Tracks(), steady(0, 2, HERE))
    tracks, explained = follow_all(tracks, steady(4, 7, HERE), place(0, expected))
    assert tracks.number == number
    assert explained.index(True) == pytest.approx(LIMITS.adopt_s * 30, abs=2)
    assert all(explained[explained.index(True) :])


def test_an_estimate_that_drifts_off_meanwhile_does_not_make_another_pad_of_it() -> None:
    tracks, _ = follow_all(Tracks(), steady(0, 2, HERE))
    explained = []
    for seen in steady(4, 7, HERE):
        drifted = HERE[0] + 0.3 + 0.2 * (seen.t * 1e-9 - 4.0)
        tracks, about = associate(tracks, seen, place(seen.t * 1e-9, (drifted, HERE[1], HERE[2])), LIMITS)
        explained.append(about)
    assert tracks.number == 1
    assert explained.index(True) == pytest.approx(LIMITS.adopt_s * 30, abs=2)


def test_a_pad_followed_from_frame_to_frame_stays_the_tracked_one_while_the_estimator_refuses_it() -> None:
    tracks, _ = follow_all(Tracks(), steady(0, 2, HERE))
    for seen in (place(2 + i / 30, (HERE[0] + 0.02 * i, HERE[1], HERE[2])) for i in range(90)):
        tracks, explained = associate(tracks, seen, place(seen.t * 1e-9, HERE), LIMITS)
        assert explained
    assert tracks.number == 1
    tracks, explained_again = follow_all(tracks, steady(5.5, 7, HERE), place(0, (5.0, 0.0, 2.0)))
    assert not any(explained_again), "after a gap it is not followed any more"


def test_a_step_as_far_as_another_pad_is_not_followed() -> None:
    """The allowed step at 15 m reaches a pad beside the tracked one."""
    high, beside = (0.1, 0.0, 15.0), (0.1 + LIMITS.pads_apart_m, 0.0, 15.0)
    tracks, _ = follow_all(Tracks(), steady(0, 2, high))
    explained = []
    for seen in steady(2, 3, beside):
        tracks, about = associate(tracks, seen, place(seen.t * 1e-9, (3.0, 0.0, 15.0)), LIMITS)
        explained.append(about)
    assert not any(explained[3:])


def test_the_old_place_seen_again_meanwhile_goes_on_as_the_old_track() -> None:
    tracks, _ = follow_all(Tracks(), steady(0, 2, HERE))
    tracks, _ = follow_all(tracks, steady(2, 3.5, ASIDE))
    tracks, explained = follow_all(tracks, steady(3.5, 6, HERE), place(0, HERE, 0.05))
    assert tracks.number == 1
    assert all(explained)
    assert tracks.disputed_at is None


def test_a_place_seen_before_the_pad_was_last_seen_begins_a_new_track_too() -> None:
    """It was seen between two sightings of the pad, and then alone: it must not stay a candidate for good."""
    tracks, _ = follow_all(Tracks(), steady(0, 2, HERE))
    tracks, explained = follow_all(tracks, [place(i / 30, ASIDE if i % 2 else HERE) for i in range(60, 91)])
    assert tracks.number == 1
    assert explained[-1]
    tracks, explained = follow_all(tracks, steady(91 / 30, 6, ASIDE))
    assert tracks.number == 2
    assert explained.index(True) == pytest.approx(LIMITS.adopt_s * 30, abs=2), "counted from the last sight of the pad"


def test_half_of_the_frames_elsewhere_never_take_the_track_and_dispute_it() -> None:
    tracks, _ = follow_all(Tracks(), steady(0, 2, HERE))
    looks = [place(i / 30, ASIDE if i % 2 else HERE) for i in range(60, 300)]
    tracks, explained = follow_all(tracks, looks)
    assert tracks.number == 1
    assert explained == [seen.d == HERE for seen in looks]
    assert tracks.disputed_at == looks[-1].t


def test_one_false_look_is_no_dispute() -> None:
    tracks, _ = follow_all(Tracks(), steady(0, 2, HERE))
    tracks, explained = follow_all(tracks, [place(2.0, ASIDE), place(2.03, HERE), place(2.07, (0.1, 1.4, 2.0)), place(2.1, HERE)])
    assert explained == [False, True, False, True]
    assert tracks.disputed_at is None


def test_two_other_places_at_once_are_adopted_by_none() -> None:
    tracks, _ = follow_all(Tracks(), steady(0, 2, HERE))
    looks = [place(i / 30, ASIDE if i % 2 else (-2.0, 0.5, 2.0)) for i in range(60, 400)]
    tracks, explained = follow_all(tracks, looks)
    assert tracks.number == 1
    assert not any(explained)


def test_a_pad_found_again_where_the_belief_expects_it_is_the_same_one() -> None:
    tracks, _ = follow_all(Tracks(), steady(0, 2, HERE))
    tracks, explained = follow_all(tracks, steady(6, 8, (0.7, 0.0, 2.3)), place(0, (0.6, 0.1, 2.2), 0.3))
    assert all(explained)
    assert tracks.number == 1


def test_a_wide_belief_explains_no_more_than_a_bounded_distance() -> None:
    tracks, _ = follow_all(Tracks(), steady(0, 2, HERE))
    _, explained = follow_all(tracks, steady(25, 26, (4.0, 0.0, 2.0)), place(0, HERE, 50.0))
    assert not any(explained)


def test_before_a_track_is_established_the_place_seen_more_often_is_the_pad() -> None:
    tracks, _ = follow_all(Tracks(), [place(0.0, ASIDE)])
    tracks, explained = follow_all(tracks, steady(0.1, 1, HERE))
    assert tracks.number == 1
    assert explained[-1]
    assert tracks.last is not None
    assert tracks.last.d == HERE


def swinging(t_s: float, d: tuple[float, float, float]) -> Place:
    """A place under an assumed attitude, while the body truly swings as fast as one that hovers does."""
    tilt = 0.25 * math.sin(0.95 / 0.25 * (t_s - 2.0))
    return place(t_s, (d[0] - math.tan(tilt) * d[2], d[1], d[2]))


@pytest.mark.parametrize("height_m", [0.6, 2.0, 5.0, 9.0])
def test_without_an_attitude_a_pad_in_sight_goes_on_and_one_that_takes_its_place_does_not(height_m: float) -> None:
    """Tried with the body's turn between two looks that brings the other pad nearest to where the first one was."""
    tracks, _ = follow_all(Tracks(), steady(0, 2, (0.1, 0.0, height_m)))
    for n in range(60, 150):
        following = follow(tracks, swinging(n / 30, (0.1, 0.0, height_m)), ASSUMED, LIMITS)
        assert following is not None
        assert following.last is not None
        tracks, last = following, following.last
        for turned_rad in (-0.95 / 30, 0.0, 0.95 / 30):
            aside_m = LIMITS.pads_apart_m + math.tan(turned_rad) * height_m
            other = place((n + 1) / 30, (last.d[0] + aside_m, 0.0, height_m))
            assert follow(tracks, other, ASSUMED, LIMITS) is None
    late = follow(tracks, place(5.37, last.d), ASSUMED, LIMITS)
    assert (late is None) == (height_m > 0.6), "after a pause another pad may have come there, save close by"
    assert tracks.n == 60, "no look without an attitude is a sighting"


def corners(right_m: float, half_m: float = 1.8) -> NDArray[np.float64]:
    """Return what a frame shows of the deck that is so far to the right: 6 m to each side, `half_m` before and behind."""
    return np.array([(half_m, right_m - 6.0), (half_m, right_m + 6.0), (-half_m, right_m + 6.0), (-half_m, right_m - 6.0)])


@pytest.mark.parametrize(
    ("back", "out_s", "before", "after", "same"),
    [
        ((1.7, 0.2), 0.4, corners(0.0), corners(0.0), True),
        ((1.7, 0.2), 0.4, corners(0.0), None, False),
        ((1.7, 0.2), 0.4, None, corners(0.0), False),
        ((1.7, 0.2), 0.4, corners(0.0, 1.75), corners(0.0, 1.0), False),
        ((1.7, 0.5), 0.4, corners(0.0), corners(0.0), True),
        ((1.6, 0.1), 0.04, None, None, True),
        ((1.6, 0.1), 0.04, None, np.empty((0, 2)), False),
        ((1.7, 0.2), 0.4, np.empty((0, 2)), corners(0.0), False),
        ((1.7, 0.2), 0.4, corners(-5.0), corners(4.6), False),
        ((-1.7, 0.2), 0.4, corners(0.0), corners(0.0), False),
        ((1.7, 0.2), 2.4, corners(0.0), corners(0.0), False),
    ],
)
def test_a_pad_that_left_the_picture_is_known_again_where_any_other_one_would_have_shown(
    back: tuple[float, float],
    out_s: float,
    before: NDArray[np.float64] | None,
    after: NDArray[np.float64] | None,
    same: bool,
) -> None:
    tracks, _ = follow_all(Tracks(), steady(0, 2, (1.6, 0.0, 4.4)))
    there = follow(tracks, place(1.98, (1.6, 0.0, 4.4)), ASSUMED, LIMITS, before)
    assert there is not None
    assert (follow(there, place(1.98 + out_s, (*back, 4.4)), ASSUMED, LIMITS, after) is not None) is same


def test_from_so_high_that_a_turn_can_hide_a_change_of_pads_none_is_followed() -> None:
    tracks, _ = follow_all(Tracks(), steady(0, 2, (0.1, 0.0, 12.0)))
    assert follow(tracks, place(2.0, (0.1, 0.0, 12.0)), ASSUMED, LIMITS) is not None
    assert follow(tracks, place(2.03, (0.1, 0.0, 12.0)), ASSUMED, LIMITS) is None, "with half as many frames"


S, MS = 1_000_000_000, 1_000_000


T = 100 * S


def place_at(t: int, side_m: float = 0.0, down_m: float = 2.0, sigma_m: float = 0.0, sigma_down_m: float | None = None) -> Place:
    return Place(t, (0.6 * side_m, -0.8 * side_m, down_m), sigma_m, sigma_m if sigma_down_m is None else sigma_down_m)


def followed(n: int = 20, *candidates: TrackCandidate, t: int = T) -> Tracks:
    return Tracks(3, n, place_at(t), candidates)


def explains(tracks: Tracks, seen: Place, expected: Place | None = None) -> bool:
    after, explained = associate(tracks, seen, expected, LIMITS)
    assert not explained or after.number == tracks.number
    return explained


def test_sideways_and_height_have_a_doubt_each() -> None:
    t = T + S
    assert explains(followed(), place_at(t, 0.33), place_at(t, sigma_m=0.1, sigma_down_m=0.0))
    assert not explains(followed(), place_at(t, 0.33), place_at(t, sigma_m=0.0, sigma_down_m=0.1))
    assert not explains(followed(), place_at(t, 0.0, 2.4), place_at(t, sigma_m=0.1, sigma_down_m=0.0))
    assert explains(followed(), place_at(t, 0.0, 2.4), place_at(t, sigma_m=0.0, sigma_down_m=0.1))
    for seen, ok in (
        (place_at(t, 0.3, sigma_m=0.1, sigma_down_m=0.0), True),
        (place_at(t, 0.3, sigma_m=0.0, sigma_down_m=0.1), False),
    ):
        assert explains(followed(), seen, place_at(t)) is ok


def test_what_the_belief_did_not_explain_at_first_it_does_not_explain_later() -> None:
    seen = place_at(T + S, 0.4)
    tracks, explained = associate(followed(), seen, place_at(T + S, sigma_m=0.1), LIMITS)
    assert not explained
    assert tracks.candidates[0].sigmas_m == (0.1, 0.1)
    for vague_m in (0.1, 0.2, 5.0):
        assert not explains(tracks, place_at(T + S + 30 * MS, 0.4), place_at(T + S, sigma_m=vague_m))
    assert explains(followed(), place_at(T + S + 30 * MS, 0.4), place_at(T + S, sigma_m=0.2)), "another one may"
    unsure, _ = associate(followed(), seen, None, LIMITS)
    assert unsure.candidates[0].sigmas_m == (math.inf, math.inf)
    assert explains(unsure, place_at(T + S + 30 * MS, 0.4), place_at(T + S, sigma_m=0.2))


def other(n: int, first: int, last: int, side_m: float = 1.0) -> TrackCandidate:
    return TrackCandidate(first, n, place_at(last, side_m), n_alone=n)


@pytest.mark.parametrize(
    ("track_n", "n", "lasted", "track_t", "adopted"),
    [
        (8, 8, 2 * S, T - 1, True),
        (8, 8, 2 * S - 1, T - 1, False),
        (8, 7, 2 * S, T - 1, False),
        (8, 8, 2 * S, T, False),
        (8, 80, 9 * S, T + S, False),
        (80, 9, 3 * S, T - S, True),
    ],
)
def test_an_established_track_gives_way_to_one_that_alone_was_seen_for_its_time(track_n, n, lasted, track_t, adopted):
    t = T + lasted
    after, explained = associate(followed(track_n, other(n - 1, T, t - S), t=track_t), place_at(t, 1.0), None, LIMITS)
    assert explained is adopted
    assert (after.number, after.n) == ((4, n) if adopted else (3, track_n))


@pytest.mark.parametrize(
    ("track_n", "n", "rival_n", "track_t", "goes_on"),
    [
        (8, 8, 0, T - 1, False), (8, 9, 0, T - 1, True), (29, 30, 0, T - 1, True), (30, 99, 0, T - 1, False),
        (16, 17, 2, T - 1, True), (16, 17, 3, T - 1, False), (16, 99, 0, T, False),
    ],
)  # fmt: skip
def test_a_track_of_one_second_goes_on_where_a_pad_alone_is_seen_more_often_than_it_was(track_n, n, rival_n, track_t, goes_on):
    """WHY: a pad that was lost half a second after its first sight came back as another one (weather_4, seed 7603)."""
    t = T + S
    tracks = followed(track_n, other(rival_n, T, t, -9.0), other(n - 1, T, t - 30 * MS), t=track_t)
    after, explained = associate(tracks, place_at(t, 1.0), None, LIMITS)
    assert explained is goes_on
    assert after.number == 3


@pytest.mark.parametrize(("n", "ago", "alone"), [(2, 0, True), (3, S, False), (3, S + 1, True), (9, S // 2, False)])
def test_alone_is_who_has_no_rival_within_a_second(n: int, ago: int, alone: bool) -> None:
    t = T + 3 * S
    tracks = followed(20, other(n, T, t - ago, -9.0), other(20, T, t - 30 * MS), t=T - S)
    assert associate(tracks, place_at(t, 1.0), None, LIMITS)[1] is alone


ARBITER_T = 5_000_000_000


SURE = (1e-4,) * 6


def swaying(t_s: float) -> tuple[float, float, float]:
    return 0.5 * math.sin(t_s), -0.3 * t_s, 3.0 + 0.4 * math.cos(1.3 * t_s)


def place_arbiter(t_s: float, at: tuple[float, float, float]) -> Place:
    return Place(ARBITER_T + round(t_s * 1e9), at, 0.02, 0.03)


def followed_arbiter(
    seconds: float, believed: Callable[[float], tuple[float, float, float]], *, fused: bool = True, hz: float = 30.0
) -> tuple[Arbiter, list[float]]:
    """Return the arbiter after a flight by a filter with this belief, and the instants at which it overruled it."""
    state, overruled, rng = Arbiter(), [], np.random.default_rng(3)
    for n in range(round(seconds * hz)):
        t = n / hz
        x, y, z = np.array(swaying(t)) + 0.02 * rng.standard_normal(3)
        state = arbitrate(state, place_arbiter(t, (x, y, z)))
        v = [(b - a) / 0.02 for a, b in zip(swaying(t - 0.01), swaying(t + 0.01), strict=True)]
        state = compare_estimate(state, believed(t), tuple(v), SURE)
        state = record_fused(state, state.t, fused)
        if state.overrules:
            overruled.append(t)
            break
    return state, overruled


def test_it_follows_a_swaying_deck_and_leaves_a_right_filter_alone() -> None:
    state, overruled = followed_arbiter(20.0, swaying)
    assert not overruled
    assert not state.apart
    assert state.n == 600, "no sighting is lost"
    off = np.array([a.p for a in state.axes]) - swaying(599 / 30.0)
    assert np.abs(off).max() < 0.05
    assert np.abs([a.v for a in state.axes] - np.array([0.5 * math.cos(20.0), -0.3, -0.52 * math.sin(26.0)])).max() < 0.4


@pytest.mark.hazard("H1")
def test_a_filter_five_sigma_apart_is_reported_after_half_a_second_and_overruled_after_two() -> None:
    def away(t: float) -> tuple[float, float, float]:
        x, y, z = swaying(t)
        return x, y, z + max(0.0, t - 5.0)

    _, overruled = followed_arbiter(20.0, away)
    assert overruled == [pytest.approx(7.8, abs=0.3)]
    reported, _ = followed_arbiter(7.0, away)
    assert reported.apart
    early, _ = followed_arbiter(6.0, away)
    assert not early.apart


def test_a_filter_that_refuses_all_sightings_is_overruled_though_it_is_near() -> None:
    _, overruled = followed_arbiter(20.0, swaying, fused=False)
    assert overruled == [pytest.approx(2.0, abs=0.1)]


def test_it_explains_what_goes_on_from_where_it_is_and_nothing_beside_or_later() -> None:
    state, _ = followed_arbiter(5.0, swaying)
    x, y, z = swaying(5.0)
    assert state.explains(place_arbiter(5.0, (x, y, z)))
    assert not state.explains(place_arbiter(5.0, (x + 0.78, y, z))), "another pad"
    assert not state.explains(place_arbiter(5.5, swaying(5.5))), "after a pause it is not sure"
    assert not Arbiter().explains(place_arbiter(5.0, (x, y, z)))


def test_single_sightings_elsewhere_do_not_move_it_and_five_in_a_row_do() -> None:
    state, _ = followed_arbiter(5.0, swaying)
    aside = (swaying(5.0)[0] + 1.0, *swaying(5.0)[1:])
    for n in range(4):
        state = arbitrate(state, place_arbiter(5.0 + n / 30.0, aside))
    assert state.misses == 4
    assert abs(state.axes[0].p - swaying(5.0)[0]) < 0.1
    assert not state.overrules
    state = arbitrate(state, place_arbiter(5.0 + 4 / 30.0, aside))
    assert (state.n, state.misses, state.axes[0].p) == (1, 0, aside[0])
