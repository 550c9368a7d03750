"""Identity of the pad: motion explains a place, or it is another pad; and an arbiter follows by sightings alone."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude
from estimator.integrity.options import IntegrityOptions
from estimator.integrity.tracks import (
    Arbiter,
    Place,
    TrackCandidate,
    Tracks,
    add_fused,
    arbitrate,
    asks_clear,
    associate,
    cleared,
    compare_estimate,
    follow,
    record_fused,
)
from tests.make import stamp

LIMITS = IntegrityOptions()
ASSUMED = Attitude(stamp(0.0), Rotation.identity(), 0.01 * np.eye(3))
HZ = 30
Point = tuple[float, float, float]
HERE, ASIDE, FAR = (0.1, 0.0, 2.0), (1.1, 0.0, 2.0), (-2.0, 0.5, 2.0)


def place(t_s: float, d: Point, sigma_m: float = 0.01, sigma_down_m: float | None = None) -> Place:
    return Place(round(t_s * 1e9), d, sigma_m, sigma_m if sigma_down_m is None else sigma_down_m)


def track(looks: list[Place], expected: Place | None = None, tracks: Tracks | None = None) -> tuple[Tracks, list[bool]]:
    """Return the tracks after some sightings, of which the explained ones are fused, and which were explained."""
    tracks, out = tracks or Tracks(), []
    for seen in looks:
        tracks, explained = associate(tracks, seen, None if expected is None else expected._replace(t=seen.t), LIMITS)
        tracks = add_fused(tracks, seen) if explained else tracks
        out.append(explained)
    return tracks, out


def steady(begin_s: float, end_s: float, *d: Point) -> list[Place]:
    """Return thirty sightings a second, of these places in turn."""
    return [place(i / HZ, d[i % len(d)]) for i in range(round(begin_s * HZ), round(end_s * HZ))]


def known(d: Point = HERE) -> Tracks:
    """Return the tracks of a pad that was seen there for two seconds."""
    return track(steady(0, 2, d))[0]


def test_a_pad_that_moves_as_things_move_is_one_track() -> None:
    rng = np.random.default_rng(2)
    looks = [place(i / HZ, (0.5 * i / HZ + 0.01 * rng.normal(), 0.01 * rng.normal(), 4.0 - 0.5 * i / HZ)) for i in range(200)]
    tracks, explained = track(looks)
    assert (tracks.number, all(explained)) == (1, True)


@pytest.mark.parametrize(
    ("looks", "expected", "number", "explained", "disputed"),
    [
        (steady(2, 3.9, ASIDE), place(0, HERE, 0.05), 1, [False] * 57, True),
        (steady(2, 5, ASIDE), None, 2, [False] * 60 + [True] * 30, False),
        (steady(2, 3.5, ASIDE) + steady(3.5, 6, HERE), place(0, HERE, 0.05), 1, [False] * 45 + [True] * 75, False),
        (steady(2, 10, HERE, ASIDE), None, 1, [True, False] * 120, True),
        (steady(2, 2.1, HERE, ASIDE, HERE), None, 1, [True, False, True], False),
        (steady(2, 2.1, HERE, ASIDE) + steady(2.1, 2.2, HERE, FAR), None, 1, [True, False, True, False, True, False], False),
        (steady(2, 13, FAR, ASIDE), None, 1, [False] * 330, True),
        (steady(6, 8, (0.7, 0.0, 2.3)), place(0, (0.6, 0.1, 2.2), 0.3), 1, [True] * 60, False),
        (steady(25, 26, (4.0, 0.0, 2.0)), place(0, HERE, 50.0), 1, [False] * 30, True),
    ],
    ids=[
        "it jumps", "a new one after its time", "the old place again", "half of the frames", "one false look", "two false looks",
        "two other places", "found where it is expected", "a wide estimate",
    ],
)  # fmt: skip
def test_a_place_is_the_track_s_or_another_pad_s(looks, expected, number, explained, disputed):
    tracks, found = track(looks, expected, known())
    assert tracks.number == number
    assert sum(a != b for a, b in zip(found, explained, strict=True)) <= 2 * (number == 2)
    assert (tracks.disputed_at == looks[-1].t or tracks.disputed_at == looks[-2].t) is disputed


@pytest.mark.parametrize(
    ("aside_m", "down_m", "number"), [(0.38, 0.0, 1), (0.4, 0.0, 2), (0.3, 0.3, 1), (0.0, 1.5, 1), (0.4, 1.5, 2)]
)
def test_where_no_other_pad_can_lie_it_is_the_tracked_one_after_that_time(aside_m: float, down_m: float, number: int) -> None:
    expected = place(0, (HERE[0] + aside_m, HERE[1], HERE[2] + down_m))
    tracks, explained = track(steady(4, 7, HERE), expected, known())
    assert tracks.number == number
    assert explained.index(True) == pytest.approx(LIMITS.adopt_s * HZ, abs=2)
    assert all(explained[explained.index(True) :])


def alone(height_m: float, half_m: float, second: bool = False) -> Tracks:
    """Return the tracks of a pad about which a frame showed this much of the deck, with a second pad on it or none."""
    tracks, x, y = known((0.0, 0.0, height_m)), 3.0, half_m
    shown = np.empty((0, 2)) if second else np.array([(x, -y), (x, y), (-x, y), (-x, -y)])
    return cleared(tracks, place(2.0, (0.0, 0.0, height_m)), shown)


@pytest.mark.parametrize(
    ("half_m", "second", "aside_m", "sigma_m", "number"),
    [
        (2.1, False, 0.65, 1.9, 1), (2.1, False, 0.65, 0.2, 2), (2.1, False, 0.75, 1.9, 2), (1.5, False, 0.65, 1.9, 2),
        (2.1, True, 0.65, 1.9, 2), (9.0, False, 0.95, 1.9, 1), (9.0, False, 1.05, 1.9, 2),
    ],
)  # fmt: skip
def test_the_only_pad_ever_seen_is_itself_as_far_as_the_estimate_doubts_and_the_deck_was_shown(
    half_m: float, second: bool, aside_m: float, sigma_m: float, number: int
) -> None:
    """WHY: 5 s out of sight the estimate was off by 0.65 m, and the ship's only pad was asked about for a minute."""
    tracks = alone(7.0, half_m, second)
    back = steady(7, 10, (aside_m, 0.0, 7.0))
    tracks, explained = track(back, place(0, (0.0, 0.0, 7.0), sigma_m), tracks)
    assert tracks.number == number
    assert explained[-1]


@given(
    clear_m=st.floats(0.0, 3.0), beyond_m=st.floats(0.0, 4.0), towards_rad=st.floats(-math.pi, math.pi),
    drift_m=st.floats(0.0, 6.0), drifts_rad=st.floats(-math.pi, math.pi), sigma_m=st.floats(0.05, 3.0),
)  # fmt: skip
def test_a_second_pad_is_taken_for_the_first_only_by_a_drift_of_more_than_half_of_what_was_clear(
    clear_m, beyond_m, towards_rad, drift_m, drifts_rad, sigma_m
):
    """The second one lies beyond what was shown, and no nearer than two pads lie side by side."""
    tracks, away_m = known((0.0, 0.0, 9.0))._replace(clear_m=clear_m), max(clear_m, LIMITS.pads_apart_m) + beyond_m
    other = (away_m * math.cos(towards_rad), away_m * math.sin(towards_rad), 9.0)
    drifted = (drift_m * math.cos(drifts_rad), drift_m * math.sin(drifts_rad), 9.0)
    tracks, explained = track(steady(7, 10, other), place(0, drifted, sigma_m), tracks)
    if tracks.number == 1 and not explained[0]:
        assert drift_m > 0.49 * max(clear_m, LIMITS.pads_apart_m)
        assert drift_m > 1.9 * math.dist(drifted, other) or math.dist(drifted, other) < 0.5 * LIMITS.pads_apart_m


def test_a_second_pad_is_looked_for_where_a_frame_can_show_more_of_the_deck_and_never_again_once_it_was_seen() -> None:
    tracks = alone(7.0, 1.5)
    for height_m, asks in ((4.0, False), (5.0, True), (9.0, True)):
        assert asks_clear(tracks, place(3.0, (0.0, 0.0, height_m))) is asks
    for half_m, clear_m in ((1.0, 1.5), (2.5, 2.5)):
        shown = np.array([(4.0, -half_m), (4.0, half_m), (-4.0, half_m), (-4.0, -half_m)])
        assert cleared(tracks, place(3.0, (0.0, 0.0, 7.0)), shown).clear_m == pytest.approx(clear_m)
        assert cleared(tracks, place(3.0, (5.0, 0.0, 7.0)), shown) == tracks, "its own middle is not in the frame"
    both = cleared(tracks, place(3.0, (0.0, 0.0, 7.0)), np.empty((0, 2)))
    assert not asks_clear(both, place(4.0, (0.0, 0.0, 9.0)))
    assert track(steady(3, 4, (0.0, 0.0, 7.0)), None, both)[0].clear_m == -math.inf
    assert not asks_clear(Tracks(1, 3, place(0.0, HERE)), place(0.1, (0.0, 0.0, 9.0)))


def test_an_estimate_that_drifts_off_meanwhile_does_not_make_another_pad_of_it() -> None:
    tracks, explained = known(), []
    for seen in steady(4, 7, HERE):
        drifted = place(seen.t * 1e-9, (HERE[0] + 0.3 + 0.2 * (seen.t * 1e-9 - 4.0), *HERE[1:]))
        tracks, about = associate(tracks, seen, drifted, LIMITS)
        explained.append(about)
    assert tracks.number == 1
    assert explained.index(True) == pytest.approx(LIMITS.adopt_s * HZ, abs=2)


def test_a_pad_followed_from_frame_to_frame_stays_the_tracked_one_while_the_estimator_refuses_it() -> None:
    tracks = known()
    for seen in (place(2 + i / HZ, (HERE[0] + 0.02 * i, *HERE[1:])) for i in range(90)):
        tracks, explained = associate(tracks, seen, place(seen.t * 1e-9, HERE), LIMITS)
        assert explained
    assert tracks.number == 1
    assert not any(track(steady(5.5, 7, HERE), place(0, (5.0, 0.0, 2.0)), tracks)[1]), "after a gap it is not followed any more"


def test_a_step_as_far_as_another_pad_is_not_followed() -> None:
    """The allowed step at 15 m reaches a pad beside the tracked one."""
    beside, expected = (0.1 + LIMITS.pads_apart_m, 0.0, 15.0), place(0, (3.0, 0.0, 15.0))
    tracks, explained = known((0.1, 0.0, 15.0)), []
    for seen in steady(2, 3, beside):
        tracks, about = associate(tracks, seen, expected._replace(t=seen.t), LIMITS)
        explained.append(about)
    assert not any(explained[3:])


def test_a_place_seen_before_the_pad_was_last_seen_begins_a_new_track_too() -> None:
    """It was seen between two sightings of the pad, and then alone: it must not stay a candidate for good."""
    tracks, _ = track(steady(2, 3.03, HERE, ASIDE), None, known())
    assert tracks.number == 1
    tracks, explained = track(steady(91 / HZ, 6, ASIDE), None, tracks)
    assert tracks.number == 2
    assert explained.index(True) == pytest.approx(LIMITS.adopt_s * HZ, abs=2), "counted from the last sight of the pad"


def test_before_a_track_is_established_the_place_seen_more_often_is_the_pad() -> None:
    tracks, explained = track([place(0.0, ASIDE), *steady(0.1, 1, HERE)])
    assert (tracks.number, explained[-1], tracks.last.d) == (1, True, HERE)


# Without an attitude


@pytest.mark.parametrize("height_m", [0.6, 2.0, 5.0, 9.0])
def test_without_an_attitude_a_pad_in_sight_goes_on_and_one_that_takes_its_place_does_not(height_m: float) -> None:
    """Tried with the body's turn between two looks that brings the other pad nearest to where the first one was."""
    tracks = known((0.1, 0.0, height_m))
    last = tracks.last
    for n in range(60, 150):
        tilt = 0.25 * math.sin(0.95 / 0.25 * (n / HZ - 2.0))  # the body swings as fast as one that hovers does
        following = follow(tracks, place(n / HZ, (0.1 - math.tan(tilt) * height_m, 0.0, height_m)), ASSUMED, LIMITS)
        assert following is not None
        assert following.last is not None
        tracks, last = following, following.last
        for turned_rad in (-0.95 / HZ, 0.0, 0.95 / HZ):
            aside_m = LIMITS.pads_apart_m + math.tan(turned_rad) * height_m
            other = place((n + 1) / HZ, (last.d[0] + aside_m, 0.0, height_m))
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
def test_a_pad_that_left_the_picture_is_known_again_where_any_other_one_would_have_shown(back, out_s, before, after, same):
    there = follow(known((1.6, 0.0, 4.4)), place(1.98, (1.6, 0.0, 4.4)), ASSUMED, LIMITS, before)
    assert there is not None
    assert (follow(there, place(1.98 + out_s, (*back, 4.4)), ASSUMED, LIMITS, after) is not None) is same


def test_from_so_high_that_a_turn_can_hide_a_change_of_pads_none_is_followed() -> None:
    tracks = known((0.1, 0.0, 12.0))
    assert follow(tracks, place(2.0, (0.1, 0.0, 12.0)), ASSUMED, LIMITS) is not None
    assert follow(tracks, place(2.03, (0.1, 0.0, 12.0)), ASSUMED, LIMITS) is None, "with half as many frames"


# Single decisions about a track that was last seen at `T_S`

T_S = 100.0


def aside(t_s: float, side_m: float = 0.0, down_m: float = 2.0, sigma_m: float = 0.0, sigma_down_m: float | None = None) -> Place:
    return place(t_s, (0.6 * side_m, -0.8 * side_m, down_m), sigma_m, sigma_down_m)


def followed(n: int = 20, *candidates: TrackCandidate, t_s: float = T_S) -> Tracks:
    return Tracks(3, n, aside(t_s), candidates)


def other(n: int, last_s: float, side_m: float = 1.0) -> TrackCandidate:
    return TrackCandidate(round(T_S * 1e9), n, aside(last_s, side_m), n_alone=n)


@pytest.mark.parametrize(("seen_by", "sigma_m", "sigma_down_m"), [(0, 0.1, 0.0), (1, 0.0, 0.1)])
@pytest.mark.parametrize(("side_m", "down_m"), [(0.33, 2.0), (0.0, 2.4), (0.3, 2.0)])
def test_sideways_and_height_have_a_doubt_each(side_m, down_m, seen_by, sigma_m, sigma_down_m):
    t = T_S + 1.0
    sure, doubt = aside(t), aside(t, 0.0, 2.0, sigma_m, sigma_down_m)
    expected = sure if side_m == 0.3 else doubt
    seen = aside(t, side_m, down_m, *((sigma_m, sigma_down_m) if side_m == 0.3 else (0.0, 0.0)))
    assert associate(followed(), seen, expected, LIMITS)[1] is (sigma_m > 0.0 if side_m else sigma_down_m > 0.0)


def test_what_the_estimate_did_not_explain_at_first_it_does_not_explain_later() -> None:
    def explains(tracks: Tracks, sigma_m: float) -> bool:
        return associate(tracks, aside(T_S + 1.03, 0.4), aside(T_S + 1.0, sigma_m=sigma_m), LIMITS)[1]

    (refused, no), (unsure, _) = (
        associate(followed(), aside(T_S + 1.0, 0.4), expected, LIMITS) for expected in (aside(T_S + 1.0, sigma_m=0.1), None)
    )
    assert (no, refused.candidates[0].sigmas_m) == (False, (0.1, 0.1))
    assert not any(explains(refused, sigma_m) for sigma_m in (0.1, 0.2, 5.0))
    assert explains(followed(), 0.2), "another one may"
    assert unsure.candidates[0].sigmas_m == (math.inf, math.inf)
    assert explains(unsure, 0.2)


@pytest.mark.parametrize(
    ("track_n", "n", "lasted_s", "track_s", "adopted"),
    [
        (8, 8, 2.0, T_S - 1e-9, True), (8, 8, 1.999, T_S - 1e-9, False), (8, 7, 2.0, T_S - 1e-9, False), (8, 8, 2.0, T_S, False),
        (8, 80, 9.0, T_S + 1.0, False), (80, 9, 3.0, T_S - 1.0, True),
    ],
)  # fmt: skip
def test_an_established_track_gives_way_to_one_that_alone_was_seen_for_its_time(track_n, n, lasted_s, track_s, adopted):
    t = T_S + lasted_s
    after, explained = associate(followed(track_n, other(n - 1, t - 1.0), t_s=track_s), aside(t, 1.0), None, LIMITS)
    assert explained is adopted
    assert (after.number, after.n) == ((4, n) if adopted else (3, track_n))


@pytest.mark.parametrize(
    ("track_n", "n", "rival_n", "track_s", "goes_on"),
    [
        (8, 8, 0, T_S - 1e-9, False), (8, 9, 0, T_S - 1e-9, True), (29, 30, 0, T_S - 1e-9, True), (30, 99, 0, T_S - 1e-9, False),
        (16, 17, 2, T_S - 1e-9, True), (16, 17, 3, T_S - 1e-9, False), (16, 99, 0, T_S, False),
    ],
)  # fmt: skip
def test_a_track_of_one_second_goes_on_where_a_pad_alone_is_seen_more_often_than_it_was(track_n, n, rival_n, track_s, goes_on):
    """WHY: a pad that was lost half a second after its first sight came back as another one (weather_4, seed 7603)."""
    t = T_S + 1.0
    tracks = followed(track_n, other(rival_n, t, -9.0), other(n - 1, t - 0.03), t_s=track_s)
    after, explained = associate(tracks, aside(t, 1.0), None, LIMITS)
    assert (explained, after.number) == (goes_on, 3)


@pytest.mark.parametrize(("n", "ago_s", "alone"), [(2, 0.0, True), (3, 1.0, False), (3, 1.001, True), (9, 0.5, False)])
def test_alone_is_who_has_no_rival_within_a_second(n: int, ago_s: float, alone: bool) -> None:
    t = T_S + 3.0
    tracks = followed(20, other(n, t - ago_s, -9.0), other(20, t - 0.03), t_s=T_S - 1.0)
    assert associate(tracks, aside(t, 1.0), None, LIMITS)[1] is alone


# The arbiter


def swaying(t_s: float) -> Point:
    return 0.5 * math.sin(t_s), -0.3 * t_s, 3.0 + 0.4 * math.cos(1.3 * t_s)


def arbiter_place(t_s: float, at: Point) -> Place:
    return place(5.0 + t_s, at, 0.02, 0.03)


def arbitrated(
    seconds: float, believed: Callable[[float], Point] = swaying, *, fused: bool = True
) -> tuple[Arbiter, list[float]]:
    """Return the arbiter after a flight by a filter with these estimates, and the instants at which it overruled it."""
    state, overruled, rng = Arbiter(), [], np.random.default_rng(3)
    for t in (n / HZ for n in range(round(seconds * HZ))):
        x, y, z = np.array(swaying(t)) + 0.02 * rng.standard_normal(3)
        state = arbitrate(state, arbiter_place(t, (x, y, z)))
        v = [(b - a) / 0.02 for a, b in zip(swaying(t - 0.01), swaying(t + 0.01), strict=True)]
        state = compare_estimate(state, believed(t), tuple(v), (1e-4,) * 6)
        state = record_fused(state, state.t, fused)
        if state.overrules:
            overruled.append(t)
            break
    return state, overruled


def away(t: float) -> Point:
    x, y, z = swaying(t)
    return x, y, z + max(0.0, t - 5.0)


def test_it_follows_a_swaying_deck_and_leaves_a_right_filter_alone() -> None:
    state, overruled = arbitrated(20.0)
    assert (overruled, state.apart, state.n) == ([], False, 600)
    off = np.array([a.p for a in state.axes]) - swaying(599 / HZ)
    assert np.abs(off).max() < 0.05
    assert np.abs([a.v for a in state.axes] - np.array([0.5 * math.cos(20.0), -0.3, -0.52 * math.sin(26.0)])).max() < 0.4


@pytest.mark.hazard("H1")
def test_a_filter_five_sigma_apart_is_reported_after_half_a_second_and_overruled_after_two() -> None:
    assert arbitrated(20.0, away)[1] == [pytest.approx(7.8, abs=0.3)]
    assert arbitrated(7.0, away)[0].apart
    assert not arbitrated(6.0, away)[0].apart


def test_a_filter_that_refuses_all_sightings_is_overruled_though_it_is_near() -> None:
    assert arbitrated(20.0, fused=False)[1] == [pytest.approx(2.0, abs=0.1)]


def test_it_explains_what_goes_on_from_where_it_is_and_nothing_beside_or_later() -> None:
    state, _ = arbitrated(5.0)
    x, y, z = swaying(5.0)
    assert state.explains(arbiter_place(5.0, (x, y, z)))
    assert not state.explains(arbiter_place(5.0, (x + 0.78, y, z))), "another pad"
    assert not state.explains(arbiter_place(5.5, swaying(5.5))), "after a pause it is not sure"
    assert not Arbiter().explains(arbiter_place(5.0, (x, y, z)))


def test_single_sightings_elsewhere_do_not_move_it_and_five_in_a_row_do() -> None:
    state, _ = arbitrated(5.0)
    x, y, z = swaying(5.0)
    for n in range(5):
        assert (state.misses, state.overrules, abs(state.axes[0].p - x) < 0.1) == (n, False, True)
        state = arbitrate(state, arbiter_place(5.0 + n / HZ, (x + 1.0, y, z)))
    assert (state.n, state.misses, state.axes[0].p) == (1, 0, x + 1.0)


def test_a_slow_camera_s_pad_is_followed_from_the_first_looks_on_and_adopted_elsewhere_after_as_many() -> None:
    drifted = place(0, (0.4, 1.0, 3.0), 2.0)
    slow, explained = track([place(1.5 * i, (1.0 + 0.3 * i, 0.0, 4.0)) for i in range(8)], drifted)
    assert (slow.number, slow.n, all(explained)) == (1, 8, True)
    tracks, explained = track([place(20.0 + 1.5 * i, FAR) for i in range(15)], place(0, HERE, 0.05), slow)
    assert (tracks.number, explained.index(True)) == (2, 7)


def test_where_no_second_pad_is_near_an_unsure_belief_explains_as_far_as_it_is_unsure() -> None:
    belief, alone = place(5, HERE, 0.6), IntegrityOptions(pads_apart_m=10.0)
    of = [
        associate(known(), place(5, (1.5, 0.0, 2.0)), belief._replace(sigma_m=s), o)[1]
        for o in (LIMITS, alone)
        for s in (0.6, 0.3)
    ]
    assert of == [False, False, True, False]
