"""Identity of the pad at each edge: how far motion explains a place, and how often and long another one must be seen."""

import math

import pytest

from estimator.integrity.options import IntegrityOptions
from estimator.integrity.tracks import Place, TrackCandidate, Tracks, associate, fused

LIMITS = IntegrityOptions()
S, MS = 1_000_000_000, 1_000_000
T = 100 * S


def place(t: int, side_m: float = 0.0, down_m: float = 2.0, sigma_m: float = 0.0, sigma_down_m: float | None = None) -> Place:
    return Place(t, (0.6 * side_m, -0.8 * side_m, down_m), sigma_m, sigma_m if sigma_down_m is None else sigma_down_m)


def followed(n: int = 20, *candidates: TrackCandidate, t: int = T) -> Tracks:
    return Tracks(3, n, place(t), candidates)


def explains(tracks: Tracks, seen: Place, expected: Place | None = None) -> bool:
    after, explained = associate(tracks, seen, expected, LIMITS)
    assert not explained or after.number == tracks.number
    return explained


def away(at_m: float, by_m: float) -> list[tuple[float, float]]:
    """So far to the side, below and above; two metres below the pad's expected place the sight may err by a share of its own."""
    share = LIMITS.place_step_fraction
    return [(at_m + by_m, 0.0), (0.0, (at_m + by_m) / (1.0 - share)), (0.0, -(at_m + by_m) / (1.0 + share))]


@pytest.mark.parametrize("by_m", [-1e-3, 1e-3])
@pytest.mark.parametrize(
    ("after_ms", "sigma_m", "moved_m", "doubt_m"),
    [
        (0, 0.0, 0.0, 0.0),
        (50, 0.0, 0.05 + 3.0 * 0.0025, 0.0),
        (-50, 0.0, 0.05 + 3.0 * 0.0025, 0.0),
        (100, 0.0, 0.1 + 3.0 * 0.01, 0.0),
        (0, 0.01, 0.0, 4.0 * math.hypot(0.01, 0.01)),
        (0, 0.5, 0.0, 0.3),
    ],
)
def test_the_sighting_before_explains_its_neighbourhood(after_ms, sigma_m, moved_m, doubt_m, by_m):
    """Its doubt adds to the attitude's in squares sideways, and as it is in height."""
    tracks = Tracks(3, 20, place(T, sigma_m=sigma_m))
    aside = away(math.hypot(0.16, doubt_m) + moved_m, by_m)[:1]
    for side_m, down_m in aside + away(0.16 + doubt_m + moved_m, by_m)[1:]:
        assert explains(tracks, place(T + after_ms * MS, side_m, 2.0 + down_m, sigma_m)) is (by_m < 0.0)


@pytest.mark.parametrize("by_m", [-1e-3, 1e-3])
@pytest.mark.parametrize(
    ("belief_m", "seen_m", "side_m", "down_m"),
    [
        (0.0, 0.0, 0.16, 0.16),
        (0.1, 0.0, 0.34, 0.46),
        (0.1, 0.05, math.hypot(0.16, 0.3, 0.2), 0.66),
        (0.2, 0.1, math.hypot(0.16, 0.4, 0.3), 1.06),
        (9.0, 9.0, math.hypot(0.16, 0.4, 0.3), 1.96),
    ],
)
def test_the_belief_explains_as_far_as_its_doubt_up_to_a_bound(belief_m, seen_m, side_m, down_m, by_m):
    t = T + S
    expected = place(t, sigma_m=belief_m)
    aside, (_, below), (_, above) = away(side_m, by_m)[0], away(down_m, by_m)[1], away(down_m, by_m)[2]
    for side, down in (aside, (0.0, below), (0.0, above)):
        assert explains(followed(), place(t, side, 2.0 + down, seen_m), expected) is (by_m < 0.0)
    assert not explains(followed(), place(t, 9.0, 9.0, seen_m), expected)


def test_sideways_and_height_have_a_doubt_each() -> None:
    t = T + S
    assert explains(followed(), place(t, 0.33), place(t, sigma_m=0.1, sigma_down_m=0.0))
    assert not explains(followed(), place(t, 0.33), place(t, sigma_m=0.0, sigma_down_m=0.1))
    assert not explains(followed(), place(t, 0.0, 2.4), place(t, sigma_m=0.1, sigma_down_m=0.0))
    assert explains(followed(), place(t, 0.0, 2.4), place(t, sigma_m=0.0, sigma_down_m=0.1))
    for seen, ok in ((place(t, 0.3, sigma_m=0.1, sigma_down_m=0.0), True), (place(t, 0.3, sigma_m=0.0, sigma_down_m=0.1), False)):
        assert explains(followed(), seen, place(t)) is ok


def test_what_the_belief_did_not_explain_at_first_it_does_not_explain_later() -> None:
    seen = place(T + S, 0.4)
    tracks, explained = associate(followed(), seen, place(T + S, sigma_m=0.1), LIMITS)
    assert not explained
    assert tracks.candidates[0].sigmas_m == (0.1, 0.1)
    for vague_m in (0.1, 0.2, 5.0):
        assert not explains(tracks, place(T + S + 30 * MS, 0.4), place(T + S, sigma_m=vague_m))
    assert explains(followed(), place(T + S + 30 * MS, 0.4), place(T + S, sigma_m=0.2)), "another one may"
    unsure, _ = associate(followed(), seen, None, LIMITS)
    assert unsure.candidates[0].sigmas_m == (math.inf, math.inf)
    assert explains(unsure, place(T + S + 30 * MS, 0.4), place(T + S, sigma_m=0.2))


def other(n: int, first: int, last: int, side_m: float = 1.0) -> TrackCandidate:
    return TrackCandidate(first, n, place(last, side_m), n_alone=n)


@pytest.mark.parametrize(("track_n", "needs"), [(0, 4), (2, 4), (3, 4), (4, 5), (7, 8)])
def test_before_a_track_is_established_the_place_seen_more_often_is_the_pad(track_n: int, needs: int) -> None:
    t = T + 500 * MS
    for n in (needs - 1, needs):
        after, explained = associate(followed(track_n, other(n - 1, T, t)), place(t, 1.0), None, LIMITS)
        assert explained is (n == needs)
        assert (after.number, after.n) == (3, n if explained else track_n)
        assert after.candidates == () if explained else after.candidates[-1].n == n


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
    after, explained = associate(followed(track_n, other(n - 1, T, t - S), t=track_t), place(t, 1.0), None, LIMITS)
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
    after, explained = associate(tracks, place(t, 1.0), None, LIMITS)
    assert explained is goes_on
    assert after.number == 3


@pytest.mark.parametrize(("n", "ago", "alone"), [(2, 0, True), (3, S, False), (3, S + 1, True), (9, S // 2, False)])
def test_alone_is_who_has_no_rival_within_a_second(n: int, ago: int, alone: bool) -> None:
    t = T + 3 * S
    tracks = followed(20, other(n, T, t - ago, -9.0), other(20, T, t - 30 * MS), t=T - S)
    assert associate(tracks, place(t, 1.0), None, LIMITS)[1] is alone


def test_a_look_joins_its_place_within_a_second_and_begins_another_one_after() -> None:
    for after, n in ((S, 6), (S + 1, 1), (-S, 6), (-S - 1, 1)):
        tracks, _ = associate(followed(20, other(5, T, T + 5 * S), t=T - 1), place(T + 5 * S + after, 1.0), None, LIMITS)
        assert (tracks.candidates[-1].n, tracks.candidates[-1].last.t) == (n, T + 5 * S + after)
        assert tracks.candidates[-1].first == (T if n == 6 else T + 5 * S + after)


def test_what_the_estimator_took_is_counted_and_compared_with_by_its_instant() -> None:
    tracks = followed(20, other(4, T, T))
    newer = fused(tracks, place(T + 2 * S, 0.1))
    assert (newer.n, newer.last, newer.candidates) == (21, place(T + 2 * S, 0.1), tracks.candidates)
    assert fused(tracks, place(T + 2 * S + 1)).candidates == ()
    assert fused(tracks, place(T - 1, 0.1)).last == tracks.last
    assert fused(tracks, place(T, 0.1)).last == place(T, 0.1)
    assert fused(Tracks(), place(T)).last == place(T)


def test_the_first_sighting_begins_track_one_that_no_estimator_has_taken() -> None:
    assert associate(Tracks(), place(T), None, LIMITS) == (Tracks(1, 0, place(T)), True)


def test_looks_at_another_place_count_from_the_first_one_after_the_pad_was_seen() -> None:
    t = T + S
    new, _ = associate(followed(), place(t, 1.0), None, LIMITS)
    assert (new.candidates[0].n, new.candidates[0].n_alone, new.candidates[0].first) == (1, 1, t)
    again, _ = associate(followed(20, other(5, T - S, t - 30 * MS)), place(t, 1.0), None, LIMITS)
    assert (again.candidates[0].n, again.candidates[0].n_alone, again.candidates[0].first) == (6, 1, t)
    more, _ = associate(again, place(t + 30 * MS, 1.0), None, LIMITS)
    assert (more.candidates[0].n, more.candidates[0].n_alone, more.candidates[0].first) == (7, 2, t)
