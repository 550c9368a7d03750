"""The target locked to the lag: what is left of the tilt, whatever the lag of the receiver."""

import itertools
import math
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from companion.parts.mavlink.outputs import TargetTrack, effective_lag_s, lag_locked, landing_target, position_at
from drivers.mavlink.samples import LocalPosition
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs, Stamp
from tests.companion.mavlink.receivers import ArduPilotReceiver, Euler

S = 1_000_000_000
START = 100 * S
TRANSIT_S = 0.004


def instant(t: float) -> MonoNs:
    return MonoNs(START + round(t * S))


def rpy(t: float) -> Euler:
    """Twenty degrees of roll and some pitch, turning slowly."""
    return (math.radians(20) * math.sin(2 * math.pi * 0.7 * t), math.radians(6) * math.sin(2 * math.pi * 0.45 * t + 1), 0.2 * t)


def d_ned(t: float) -> F64:
    """Return the pad from a body at 5 m that swings as its roll makes it."""
    return np.array([0.4 + 0.2 * math.sin(1.1 * t), -0.3 + 0.18 * math.sin(2 * math.pi * 0.7 * t), 5.0])


def v_ned(t: float) -> F64:
    return (d_ned(t + 1e-4) - d_ned(t - 1e-4)) / 2e-4


def estimate_at(t: float, d: F64 | None = None) -> RelativeState:
    to_level = Rotation.from_rpy(0, 0, rpy(t)[2]).inv
    return RelativeState(
        instant(t), "dead_reckoning", to_level @ (d_ned(t) if d is None else d), to_level @ v_ned(t), 0.3, np.eye(7) * 1e-4,
        instant(t), True,
    )  # fmt: skip


def attitude_at(t: float) -> Attitude:
    return Attitude(Stamp(instant(t), instant(t), 0.0005, "synced"), Rotation.from_rpy(*rpy(t)), np.eye(3) * 1e-6)


def errors_m(lag_s: float, sends: list[tuple[float, Callable[[], object | None]]], seconds: float) -> list[float]:
    """Horizontal error of what a receiver with that lag makes of each message, against the pad at the lagged instant.

    `sends` are (when the message is taken up, what makes it).
    """
    receiver = ArduPilotReceiver(lag_s=lag_s)
    out: list[Any] = []
    queue = deque(sorted(sends, key=lambda s: s[0]))
    period = 1.0 / receiver.loop_rate_hz
    for n in itertools.count():
        t = n * period
        if t > seconds:
            return out
        receiver.loop(rpy(t))
        while queue and queue[0][0] <= t:
            message = queue.popleft()[1]()
            found = receiver.on_message(message) if message is not None else None
            if found is not None and t > 1.0:
                truth = d_ned(t - effective_lag_s(lag_s))
                out.append(math.hypot(found[0] - truth[0], found[1] - truth[1]))
    return out


@pytest.mark.parametrize("lag_s", [0.02, 0.1, 0.25])
def test_what_is_locked_to_the_lag_is_right_to_two_centimetres(lag_s: float) -> None:
    rng = np.random.default_rng(5)
    seconds = 12.0
    locked: list[tuple[float, Callable[[], object | None]]] = []
    track = TargetTrack()
    attitudes = deque(k / 100 for k in range(round(seconds * 100)))
    beliefs = deque(k / 50 for k in range(round(seconds * 50)))
    for n in range(round(seconds * 25)):
        now = n / 25 + 0.003
        while attitudes and attitudes[0] + 0.006 <= now:
            track.on_attitude(attitude_at(attitudes.popleft()))
        while beliefs and beliefs[0] <= now - 0.002:
            at = beliefs.popleft()
            # What the estimator knows is good to a centimetre
            track.believe(estimate_at(at, d_ned(at) + rng.normal(0.0, 0.003, 3)))
        seen = lag_locked(track, instant(now), lag_s, TRANSIT_S)
        if seen is not None:
            message = landing_target(0, seen.d_body_pad_ned, seen.R_ned_body, pad_radius_m=0.39)
            locked.append((now + TRANSIT_S, lambda m=message: m))  # type: ignore[misc]
    assert len(locked) > 0.95 * 25 * seconds
    errors = errors_m(lag_s, locked, seconds)
    assert len(errors) > 200
    assert max(errors) < 0.02


def filled(rate_hz: float = 50.0, seconds: float = 1.0) -> TargetTrack:
    track = TargetTrack()
    for k in range(round(seconds * 100) + 5):
        track.on_attitude(attitude_at(k / 100))
    for k in range(round(seconds * rate_hz) + 1):
        track.believe(estimate_at(k / rate_hz))
    return track


def test_between_beliefs_and_a_little_beyond() -> None:
    track = filled()
    for t in (0.333, 0.777, 1.0, 1.03):
        seen = track.at(instant(t))
        assert seen is not None
        assert seen.d_body_pad_ned == pytest.approx(d_ned(t), abs=0.003)
        assert seen.R_ned_body.angle_to(Rotation.from_rpy(*rpy(t))) < 0.003
        assert seen.R_ned_pad is not None
        # The arrow stands at the body's heading less the heading against it
        assert seen.R_ned_pad.rpy_rad[2] == pytest.approx(rpy(t)[2] - 0.3, abs=0.01)


def test_nothing_is_reported_where_nothing_is_known() -> None:
    track = filled()
    assert track.at(instant(1.5)) is None, "too far ahead"
    assert track.at(instant(-0.1)) is None, "before the first"
    track.believe(None)
    assert track.at(instant(0.9)) is None, "the pad was lost"
    slow = filled(rate_hz=2.0)
    assert slow.at(instant(0.75)) is None, "a gap is not bridged"
    assert TargetTrack().at(instant(0.0)) is None


def test_an_ambiguous_heading_is_not_passed_on() -> None:
    track = filled()
    state = estimate_at(1.02)
    ambiguous = RelativeState(
        state.at, "dead_reckoning", state.d_body_pad_level, state.v_pad_level, 0.3, state.cov, state.sighted, True,
        (("yaw_ambiguous", 1.0),),
    )  # fmt: skip
    track.believe(ambiguous)
    seen = track.at(instant(1.02))
    assert seen is not None
    assert seen.R_ned_pad is None


def position(t: float) -> LocalPosition:
    return LocalPosition(Stamp(instant(t), instant(t), 0.001, "synced"), np.array([t, 2 * t, -t]), np.array([1.0, 2.0, -1.0]))


def test_local_position_at_an_instant() -> None:
    reports = tuple(position(k / 20) for k in range(10))
    for t in (0.0, 0.13, 0.45, 0.6):
        assert position_at(reports, instant(t)) == pytest.approx((t, 2 * t, -t), abs=1e-9)
    assert position_at(reports, instant(2.0)) is None
    assert position_at(reports, instant(-2.0)) is None
    assert position_at((), instant(0.0)) is None
