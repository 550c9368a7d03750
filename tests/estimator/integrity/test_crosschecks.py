"""One witness checks another: the gyro a reported heading, range and barometer the camera's height, the body's turns the view."""

import math
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.samples import Attitude
from estimator.integrity.crosschecks import (
    HeadingWatch,
    HeightWatch,
    ViewWatch,
    add_baro,
    add_gyro,
    add_range,
    add_sighting,
    hold_heading,
    watch_view,
)
from estimator.integrity.options import IntegrityOptions
from estimator.options import EstimatorOptions
from estimator.pipeline import RelativeEstimator
from tests.make import attitude, baro, imu, range_down, sighting, stamp

DT = 0.005
LIMITS = IntegrityOptions()
TILT = (math.radians(6.0), math.radians(-4.0))
Error = Callable[[float, np.random.Generator], float]


# The heading


def headings(error_deg: Error, seconds: float = 10.0, bias_deg_s: float = 0.0, *, gyro: bool = True) -> F64:
    """Return the true heading, the reported one and the one that is used, (n, 3) deg, for a body that turns to and fro."""
    watch, rows, rng = HeadingWatch(), [], np.random.default_rng(3)
    for i in range(round(seconds / DT)):
        t = i * DT
        true, rate = math.radians(20.0) * math.sin(t), math.radians(20.0) * math.cos(t) + math.radians(bias_deg_s)
        if gyro:
            watch = add_gyro(watch, imu(t, Rotation.from_rpy(*TILT, 0.0).matrix.T @ [0.0, 0.0, rate]))
        event = attitude(t, *TILT, wrap_pi(true + math.radians(error_deg(t, rng))))
        watch, used = hold_heading(watch, event, LIMITS)
        assert used.R_ned_body.rpy_rad[:2] == pytest.approx(TILT, abs=1e-9)
        assert (used is event) is (watch.off_rad == 0.0)
        rows.append([true, event.R_ned_body.rpy_rad[2], used.R_ned_body.rpy_rad[2]])
    return np.degrees(rows)


def off_deg(rows: F64, column: int) -> F64:
    return np.asarray((rows[:, column] - rows[:, 0] + 180.0) % 360.0 - 180.0)


def test_a_heading_that_turns_as_the_body_does_passes_unchanged_and_so_does_any_without_a_gyro() -> None:
    for rows in (
        headings(lambda t, rng: 3.0 * math.sin(0.3 * t) + rng.normal(0.0, 0.5), bias_deg_s=0.8),
        headings(lambda t, rng: 15.0 * t, gyro=False),
    ):
        np.testing.assert_array_equal(rows[:, 1], rows[:, 2])


@pytest.mark.parametrize(
    "error_deg",
    [
        lambda t, rng: 15.0 * max(0.0, t - 2.0),
        lambda t, rng: (50.0 + rng.normal(0.0, 5.0)) * (t > 2.0),
        lambda t, rng: 90.0 * (t > 2.0),
    ],
    ids=["drifts by 15 degrees a second", "bent by steel, noisy", "jumps by 90 degrees"],
)
def test_one_that_turns_by_itself_is_replaced_by_the_gyros(error_deg: Error) -> None:
    """WHY: such a compass turned the whole estimate; the pad seemed to be elsewhere, and the flight was given up."""
    rows = headings(error_deg)
    assert np.abs(off_deg(rows, 1)).max() > 45.0
    assert np.abs(off_deg(rows, 2)).max() < 12.0


def test_another_north_is_taken_over_in_time_and_without_a_large_jump() -> None:
    off = off_deg(headings(lambda t, rng: 30.0 * (t > 2.0), seconds=70.0), 2)
    assert off[-1] == pytest.approx(30.0)
    assert np.abs(np.diff(off)).max() < LIMITS.heading_tolerance_deg + 0.1


def test_a_report_from_before_the_last_one_is_not_followed() -> None:
    watch, _ = hold_heading(HeadingWatch(0.0, 40_000_000, 0.0, held_rad=0.0, held_at=80_000_000), attitude(0.04, yaw=0.1), LIMITS)
    assert watch.held_rad == 0.0


def test_frames_and_paths_get_the_held_heading() -> None:
    memory = RelativeEstimator(EstimatorOptions())
    for i in range(600):
        t, noise = i * DT, 1e-9 * math.sin(5.0 * i)  # what repeats its bits is refused as frozen
        memory.put([imu(t, np.full(3, noise)), attitude(t, *TILT, math.radians(60.0) * (t > 1.5) + noise)])
    held = memory.attitude_at(stamp(2.9))
    assert abs(math.degrees(held.R_ned_body.rpy_rad[2])) < 3.0
    assert abs(math.degrees(memory.guard.heading.off_rad)) > 50.0


# The height

Height = Callable[[float], float]


def watched(seen_m: Height, range_m: Height, seconds: float = 3.0, aside_m: float = 0.1, tilt_rad: float = 0.05) -> HeightWatch:
    """Return the watch after camera and range sensor had these heights for a while."""
    rng, state = np.random.default_rng(1), HeightWatch()
    for t in (1.0 + i / 25 for i in range(round(seconds * 25))):
        state = add_sighting(state, sighting(t - 0.1, (aside_m, 0.0, seen_m(t))), Rotation.from_rpy(tilt_rad, 0.0, 0.5))
        state = add_range(state, range_down(t, range_m(t) + abs(rng.normal(0, 0.005))), LIMITS)
    return state


@pytest.mark.parametrize("height_m", [0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("tilt_rad", [0.0, 0.2])
def test_true_heights_agree_at_any_tilt(height_m: float, tilt_rad: float) -> None:
    for along in (1.0, 1.0 / math.cos(tilt_rad)):
        state = watched(lambda t: height_m, lambda t, k=along: height_m * k, tilt_rad=tilt_rad, aside_m=0.0)  # type: ignore[misc]
        assert not state.contradicted
        assert state.confirmed(round(4e9)) or tilt_rad > 0.0


@pytest.mark.parametrize(
    ("seen_m", "range_m", "seconds", "aside_m", "contradicted"),
    [
        *((lambda t, k=k, h=h: k * h, lambda t, h=h: h, 3.0, 0.1, True) for k in (0.8, 1.25) for h in (1.7, 2.0, 3.0)),
        (lambda t: 2.0, lambda t: 4.5, 3.0, 0.1, True),
        (lambda t: 2.0, lambda t: 4.5, 3.0, 1.5, False),
        (lambda t: 2.0, lambda t: 4.5, 3.0, LIMITS.deck_radius_m, False),
        (lambda t: 2.0, lambda t: 2.6 if t < 1.7 else 2.0, 3.0, 0.1, False),
        (lambda t: 2.0, lambda t: 2.6 if t < 2.5 else 2.0, 6.0, 0.1, False),
        (lambda t: 2.0, lambda t: 2.6 if t < 2.5 else 2.0, 1.7, 0.1, True),
        (lambda t: max(0.1, 0.5 - 0.2 * (t - 1)), lambda t: max(0.2, 0.5 - 0.2 * (t - 1)), 3.0, 0.1, False),
    ],
    ids=[
        *(f"focal length {k}, {h} m" for k in (0.8, 1.25) for h in (1.7, 2.0, 3.0)), "water below", "beside the pad",
        "at its rim", "it passes", "agreement ends it", "not yet", "nothing nearer than its least",
    ],
)  # fmt: skip
def test_a_range_contradicts_over_the_pad_and_for_a_while(seen_m, range_m, seconds, aside_m, contradicted):
    state = watched(seen_m, range_m, seconds, aside_m)
    assert state.contradicted is contradicted
    assert aside_m == 0.1 or state.agreed_at < 0


def pressed(baro_m: Height, seen_m: Height = lambda t: 1.5, seconds: float = 12.0) -> bool:
    """Return whether the barometer contradicts after so long."""
    rng, state = np.random.default_rng(4), HeightWatch()
    for t in (1.0 + i / 20 for i in range(round(seconds * 20))):
        state = add_sighting(state, sighting(t - 0.1, (0.1, 0.0, seen_m(t))), Rotation.identity())
        state = add_baro(state, baro(t, baro_m(t) + rng.normal(0, 0.5), 0.7), LIMITS)
    return state.baro_contradicted


@pytest.mark.parametrize(("rate_m_s", "seconds"), [(0.8, 12.0), (0.9, 7.5), (-0.9, 7.5), (0.55, 11.5), (-0.55, 11.5)])
def test_a_drift_is_contradicted_the_sooner_the_faster_it_is(rate_m_s: float, seconds: float) -> None:
    assert pressed(lambda t: 30.0 + rate_m_s * t, seconds=seconds)


@pytest.mark.parametrize("period_s", [5.0, 7.0, 9.0, 12.0])
@pytest.mark.parametrize("phase", [0.0, 1.5, 3.0, 4.5])
def test_a_drone_that_follows_a_deck_in_a_high_sea_is_no_contradiction(period_s: float, phase: float) -> None:
    for end in (8.0, 12.0, 15.5, 19.0):
        assert not pressed(lambda t: 30.0 + 2.0 * math.sin(math.tau * t / period_s + phase), lambda t: 0.4, end), end


def test_a_heaving_deck_and_a_descent_are_no_contradiction() -> None:
    assert not pressed(lambda t: 30.0 - 0.4 * t, lambda t: 6.0 - 0.4 * t + 0.8 * math.sin(0.7 * t))


# The view


def frozen_shares(seed: int, frozen: bool, sway_rad: float, height_m: float = 1.5, seconds: float = 10.0) -> float:
    """Share of sightings after which the view counts as frozen; the body sways and drifts as a hovering drone does."""
    return sum(one.frozen for one in watched_view(seed, frozen, sway_rad, np.eye(3), height_m, seconds)) / (30 * seconds)


def looked(state: ViewWatch, t: float, reported: Rotation, d_body: F64) -> ViewWatch:
    """Return the watch after a sighting at `d_body` in the body, which the camera shows, (3,) m, under a reported attitude."""
    exposed = stamp(t, 0.09)
    seen = sighting(exposed, reported.without_heading() @ d_body, 0.1)
    return watch_view(state, seen, Attitude(exposed, reported, 1e-5 * np.eye(3)), LIMITS)


def watched_view(
    seed: int, frozen: bool, sway_rad: float, mirror: F64, height_m: float = 1.5, seconds: float = 10.0, late_s: float = 0.0,
    round_m_s: float = 0.0, noise: float = 0.0005,
) -> Iterator[ViewWatch]:  # fmt: skip
    """Yield the watch after each sighting; the camera turns bearings in the body by `mirror`, and the attitude is late.

    Args:
        round_m_s: speed of the pad on a circle of 2 m about the drone.
        noise: deviation of a place over the height.
    """
    rng = np.random.default_rng(seed)
    state = ViewWatch()
    phases, n = rng.uniform(0, 2 * math.pi, 6), round(seconds * 30)

    def swaying(t: float) -> tuple[list[float], Rotation]:
        sways = [math.sin(2 * math.pi * hz * t + p) for hz, p in zip((0.7, 0.9, 2.1), phases[:3], strict=True)]
        return sways, Rotation.from_rpy(sway_rad * (sways[0] + 0.3 * sways[2]), sway_rad * sways[1], 0.2 * t)

    for i in range(n):
        t = i / 30
        (sways, R), (_, reported) = swaying(t), swaying(t - late_s)
        # A body that tilts one way is pushed that way: g times the tilt, twice integrated, so the pad moves as the tilt moves it.
        drift_m = 9.81 * sway_rad / (2 * math.pi * 0.8) ** 2
        true = np.array([0.1 - drift_m * sways[1], drift_m * sways[0], height_m])
        if round_m_s:
            true[:2] += 2.0 * np.array([math.cos(0.5 * round_m_s * t), math.sin(0.5 * round_m_s * t)])
        if frozen:
            true = R.without_heading() @ np.array([0.1, 0.05, height_m])
        state = looked(state, t, reported, mirror @ (R.without_heading().inv @ true) + rng.normal(0, noise * height_m, 3))
        yield state


@pytest.mark.parametrize("seed", range(3))
def test_a_frozen_view_is_known_while_the_body_turns(seed: int) -> None:
    assert frozen_shares(seed, frozen=True, sway_rad=math.radians(2.0)) > 0.8


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("frozen", "sway_deg"), [(False, 0.2), (False, 1.0), (False, 5.0), (True, 0.2)])
def test_a_true_view_is_not_and_that_of_a_still_body_neither(seed: int, frozen: bool, sway_deg: float) -> None:
    assert frozen_shares(seed, frozen=frozen, sway_rad=math.radians(sway_deg)) == 0.0


@pytest.mark.hazard("H12")
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("axis_deg", [0.0, 90.0, 35.0])
def test_a_mirrored_view_is_known_within_two_seconds_of_a_flight_that_sways(seed: int, axis_deg: float) -> None:
    c, s = math.cos(2 * math.radians(axis_deg)), math.sin(2 * math.radians(axis_deg))
    mirror = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, 1.0]])
    for height_m, noise in ((0.5, 0.0005), (3.0, 0.0005), (2.0, 0.015)):
        seen = [one.reversed for one in watched_view(seed, False, math.radians(1.0), mirror, height_m, 5.0, noise=noise)]
        assert all(seen[60:]), f"first at {seen.index(True) / 30:.1f} s"


def test_a_camera_mounted_the_other_way_round_is_known_and_a_right_one_is_never_named() -> None:
    turned = [one.reversed for one in watched_view(1, False, math.radians(1.0), np.diag([-1.0, -1.0, 1.0]))]
    assert all(turned[60:])
    for sway_deg, height_m, noise in ((0.05, 0.3, 0.0005), (0.5, 1.0, 0.015), (3.0, 8.0, 0.0005)):
        seen = watched_view(2, False, math.radians(sway_deg), np.eye(3), height_m, 20.0, noise=noise)
        assert not any(one.reversed for one in seen)


@pytest.mark.parametrize(("late_s", "known"), [(0.1, True), (-0.1, True), (0.03, False), (0.0, False)])
def test_an_attitude_a_tenth_of_a_second_late_against_the_image_is_known_within_three_seconds(late_s: float, known: bool) -> None:
    for seed in range(3):
        found = [one.late_s for one in watched_view(seed, False, math.radians(3.0), np.eye(3), 3.0, 6.0, late_s)]
        assert all((s != 0.0) is known for s in found[90:])
        assert not known or abs(found[-1] - late_s) <= 0.021


def test_one_lean_that_stays_shows_no_delay_and_neither_does_what_came_before_a_silence() -> None:
    """WHY: a vehicle let into the wind leant once, in the first half second, and a landing much later was refused for it."""

    def lean(t: float) -> Rotation:
        return Rotation.from_rpy(0.0, -0.2 * min(max(t, 0.0) / 0.35, 1.0) - 0.02 * t, 0.0)

    once, place = ViewWatch(), np.array([1.0, 1.4, 7.0])
    for t in np.arange(0.0, 3.0, 1 / 30):
        once = looked(once, t, lean(t - 0.3), lean(t - 0.36).inv @ place)
        assert once.late_s == 0.0, t
    *_, late = watched_view(0, False, math.radians(3.0), np.eye(3), 3.0, 6.0, 0.1)
    assert late.late_s != 0.0
    for t in np.arange(14.0, 15.0, 1 / 30):
        late = looked(late, t, Rotation.identity(), place)
        assert late.late_s == 0.0, t


def test_close_to_the_pad_a_way_aside_is_no_delay() -> None:
    """The pad's bearing is the vehicle's way aside there, which follows its lean late; and so it is after a ship that stops."""
    for height_m, round_m_s, known in ((0.9, 0.0, False), (1.1, 0.0, True), (3.0, 1.0, True), (3.0, 2.5, False)):
        found = [one.late_s for one in watched_view(1, False, math.radians(3.0), np.eye(3), height_m, 6.0, 0.1, round_m_s)]
        assert any(found[90:]) is known
