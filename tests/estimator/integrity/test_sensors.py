"""Check what is received by itself: impossible readings, frozen ones, repeated frames, stamps alone with their time."""

import csv
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, BodyVelocity
from estimator.integrity.options import IntegrityOptions
from estimator.integrity.sensors import (
    ClockWatch,
    FrameWatch,
    Reading,
    SensorWatch,
    digest,
    watch_arrival,
    watch_delay,
    watch_frame,
    watch_reading,
)
from tests.make import attitude, baro, imu, range_down, stamp, velocity, vessel

LIMITS = IntegrityOptions()
RNG = np.random.default_rng(5)
FLIGHT = Path(__file__).parents[3] / "../shared/data/flight_with_mocap"
IMPOSSIBLE, FROZEN, TOO_OLD, TOO_NEW = Verdict.IMPOSSIBLE, Verdict.FROZEN, Verdict.TOO_OLD, Verdict.TOO_NEW


def judge(*events: Reading, flying: bool = True) -> list[Verdict | None]:
    """Return the verdicts on the readings of one stream."""
    state, out = SensorWatch(), []
    for event in events:
        state, verdict = watch_reading(state, event, LIMITS, flying)
        out.append(verdict)
    return out


def speed(axis: int, v_m_s: float) -> BodyVelocity:
    """Return a velocity along one axis; the other components were not measured and say anything."""
    v, var = np.full(3, 500.0), np.full(3, 1e3)
    v[axis], var[axis] = v_m_s, 0.01
    return velocity(1.0, v, var=var)


@pytest.mark.parametrize(
    ("event", "verdict"),
    [
        (imu(1.0, f=(1e4, 0, 0)), IMPOSSIBLE), (imu(1.0, f=(0, 0, -81.0)), IMPOSSIBLE), (imu(1.0, f=(0, 0, -79.0)), None),
        (imu(1.0, w=(0, 36.0, 0)), IMPOSSIBLE), (imu(1.0, w=(34.0, 0, 0)), None),
        *((speed(axis, sign * 20.0), None) for axis in range(3) for sign in (1, -1)),
        *((speed(axis, sign * 20.01), IMPOSSIBLE) for axis in range(3) for sign in (1, -1)),
        (vessel(1.0, (21.0, 0, 0)), IMPOSSIBLE), (vessel(1.0, (19.0, 0, 0)), None), (vessel(1.0, None, 1.0), None),
    ],
)  # fmt: skip
def test_what_no_vehicle_does_is_impossible(event: Reading, verdict: Verdict | None) -> None:
    assert judge(event) == [verdict]


@pytest.mark.parametrize(
    ("make", "frozen_s"),
    [
        (lambda t: imu(t, (0.1, 0.2, -9.8)), LIMITS.imu_frozen_s),
        (lambda t: attitude(t), LIMITS.attitude_frozen_s),
        (lambda t: velocity(t), LIMITS.velocity_frozen_s),
        (lambda t: range_down(t, 1.234), LIMITS.range_frozen_s),
        (lambda t: baro(t, 1.234), LIMITS.baro_frozen_s),
        (lambda t: vessel(t, (0.0, 1.0, 0.0)), math.inf),
    ],
    ids=["imu", "attitude", "velocity", "range", "baro", "vessel"],
)
def test_a_reading_that_holds_to_the_bit_is_frozen_after_its_time_and_in_flight_alone(make, frozen_s):
    n = round(min(frozen_s, 3.0) / 0.005)
    events = [make(0.005 * i) for i in range(n + 20)]
    found = judge(*events)
    assert found[:n] == [None] * n
    assert found[-1] is (FROZEN if frozen_s < math.inf else None)
    assert set(judge(*events, flying=False)) == {None}
    assert judge(*events, imu(9.0, RNG.normal(0, 0.01, 3), RNG.normal((0.0, 0.0, -9.8), 0.01)))[-1] is None, "one bit has changed"


@pytest.mark.parametrize(
    ("make", "high"),
    [
        (lambda t, v: velocity(t, (v + 1e-3 * np.sin(t), 0, 0)), 6.0),
        (lambda t, roll: attitude(t, roll + 1e-3 * np.sin(t), 0.0, 1.0), 1.4),
        (lambda t, h: baro(t, h + 1e-3 * np.sin(t)), 30.0),
    ],
)
def test_a_spike_is_refused_and_a_lasting_step_is_let_through(make: Callable[[float, float], Reading], high: float) -> None:
    found = judge(*(make(0.02 * i, high if i >= 50 else 0.0) for i in range(100)))
    assert found[:50] == [None] * 50
    assert found[50:74] == [IMPOSSIBLE] * 24
    assert found[-1] is None


@pytest.mark.parametrize(
    ("events", "verdicts"),
    [
        ((imu(1.0, f=(0, 0, 0)), imu(1.001, f=(0, 0, -79.0))), [None, None]),
        ((vessel(1.0, (0, 0, 0)), vessel(1.001, (0, 19.0, 0))), [None, None]),
        ((baro(1.0, 0.0), baro(1.0, 30.0)), [None, None]),
        ((baro(1.0, 0.0), baro(0.999, 30.0)), [None, None]),
        ((imu(1.0, f=(0, 0, -90.0)), imu(2.0, f=(0, 0, -90.0))), [IMPOSSIBLE, IMPOSSIBLE]),
        ((imu(1.0), imu(1.14), imu(1.16)), [None, None, FROZEN]),
        (tuple(attitude(0.02 * i, 0.001 * i, 0.0, 1.5 * i) for i in range(9)), [None] * 9),
    ],
    ids=["forces step", "reports step", "one instant", "from before", "impossible first", "150 ms", "a heading turns"],
)
def test_what_is_a_step_and_what_is_none(events: tuple[Reading, ...], verdicts: list[Verdict | None]) -> None:
    assert judge(*events) == verdicts


@pytest.mark.parametrize(
    ("roll", "pitch"), [(2.315840312948539, -0.08309898974996566), (0.6869503213152144, -0.3514859733064353)]
)
def test_upside_down_is_a_step_though_rounding_puts_the_poles_farther_apart_than_two(roll: float, pitch: float) -> None:
    poles = [Rotation.from_rpy(roll, pitch, 1.0), Rotation.from_rpy(roll + math.pi, -pitch, 1.0)]
    assert math.dist(*(pole.matrix[2].tolist() for pole in poles)) > 2.0
    assert judge(*(Attitude(stamp(1.0 + 0.02 * i), pole, np.eye(3)) for i, pole in enumerate(poles))) == [None, IMPOSSIBLE]


@pytest.mark.skipif(not FLIGHT.is_dir(), reason="the recorded flight is not on this machine")
def test_nothing_of_a_real_flight_is_refused() -> None:
    """Real noise, real repeats: 41 s of an AR.Drone's IMU, velocity and ultrasound."""

    def rows(name: str) -> list[dict[str, float]]:
        with (FLIGHT / name).open() as file:
            return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]

    moving = [r for r in rows("navdata.csv") if r["motor1"] > 0 and r["altd_mm"] > 0]
    assert len(moving) > 7000
    sensed = (imu(r["t_stamp_s"], (r["wx"], r["wy"], r["wz"]), (r["ax"], r["ay"], -r["az"])) for r in rows("imu.csv"))
    assert set(judge(*sensed)) == {None}
    assert set(judge(*(velocity(r["t_stamp_s"], (1e-3 * r["vx_mm_s"], 1e-3 * r["vy_mm_s"], 0)) for r in moving))) == {None}
    assert set(judge(*(range_down(r["t_stamp_s"], 1e-3 * r["altd_mm"]) for r in moving))) == {None}


# Frames


def still_scene() -> np.ndarray:
    """Return a still scene with a sensor's noise."""
    return RNG.normal(100, 2.0, (360, 640, 3)).astype(np.uint8)


def test_a_frame_that_repeats_is_refused_at_once_and_the_camera_is_frozen_at_the_third() -> None:
    state, ring, found = FrameWatch(), [still_scene() for _ in range(8)], []
    for image in (*ring, *(ring[k].copy() for k in (0, 1, 2, 2)), still_scene()):
        state, repeated = watch_frame(state, image)
        found.append((repeated, state.frozen))
    assert found == [(False, False)] * 8 + [(True, False)] * 2 + [(True, True)] * 2 + [(False, False)]


def test_an_image_that_is_one_row_in_memory_is_known_by_that_row() -> None:
    row = still_scene()[0]
    assert digest(np.broadcast_to(row, (360, *row.shape))) == digest(np.broadcast_to(row, (9, *row.shape)))
    assert digest(np.repeat(row[None], 360, axis=0)) != digest(row[None].repeat(9, axis=0))


# Arrivals and delays


def arrivals(*received: tuple[str, float], state: ClockWatch | None = None) -> tuple[ClockWatch, list[Verdict | None]]:
    """Return the clock after samples of some kinds were received at these seconds, and the verdicts."""
    state, out = state or ClockWatch(), []
    for kind, t in received:
        state, verdict = watch_arrival(state, kind, stamp(t - 0.01, 0.01), 1.0)
        out.append(verdict)
    return state, out


def imus(since_s: float, step_s: float, n: int) -> list[tuple[str, float]]:
    return [("Imu", since_s + step_s * i) for i in range(n)]


@pytest.mark.parametrize(
    ("received", "verdicts"),
    [
        ([*imus(1.0, 0.01, 20), ("Imu", 3600.0), *imus(1.2, 0.01, 20)], [None] * 20 + [TOO_NEW] + [None] * 20),
        ([("Imu", 1.0 + 0.01 * i + 3600.0 * (i % 2)) for i in range(200)], [None, TOO_NEW] * 100),
        ([("Imu", 1.0), ("Imu", 60.0), ("Attitude", 60.01), ("Imu", 60.02)], [None, TOO_NEW, None, None]),
        ([("Imu", 1.0), ("Imu", 60.0), ("Imu", 60.0)], [None, TOO_NEW, TOO_NEW]),
        ([("Imu", 1.0), *imus(60.0, 0.02, 15)], [None] + [TOO_NEW] * 10 + [None] * 5),
        (
            [("Imu", 1.0), *imus(3600.0, 0.05, 10), *imus(1.1, 0.05, 10)],
            [None] + [TOO_NEW] * 4 + [None] * 6 + [TOO_OLD] * 4 + [None] * 6,
        ),
    ],
    ids=["one an hour ahead", "every other", "two streams after a pause", "two of one stream", "one stream", "misled, and back"],
)  # fmt: skip
def test_a_time_that_others_do_not_confirm_is_refused(received: list[tuple[str, float]], verdicts: list[Verdict | None]) -> None:
    assert arrivals(*received)[1] == verdicts


def test_a_confirmed_time_is_the_newest_of_those_that_confirm_it_and_delays_are_learned_again() -> None:
    now, _ = watch_delay(ClockWatch(round(100e9)), "Imu", stamp(99.9, 0.1), 0.5, 1.0)
    assert arrivals(("Imu", 200.0), ("Attitude", 199.999), state=now)[0] == ClockWatch(round(200e9))


def delays(*seconds: float, keep_s: float = math.inf) -> list[Verdict | None]:
    """Return the verdicts on sightings with these delays, thirty a second."""
    state, out = ClockWatch(), []
    for i, delay_s in enumerate(seconds):
        state, verdict = watch_delay(state, "Sighting", stamp(100.0 + i / 30.0 - delay_s, delay_s), 0.15, 10.0, keep_s)
        out.append(verdict)
    return out


def test_a_delay_that_steps_is_refused_until_it_has_settled_and_one_that_held_gives_way_to_none() -> None:
    found = delays(*[0.09] * 60, *[0.39] * 1000, keep_s=3.0)
    assert found == [None] * 60 + [TOO_OLD] * 300 + [None] * 700, "two seconds are too short to be kept"
    assert delays(*[0.09] * 60, *[0.39] * 361)[-2:] == [None, None]
    assert delays(*[0.39] * 60, 0.09)[-1] is TOO_NEW
    assert delays(*[0.09] * 120, *[0.39] * 1000, 0.09, keep_s=3.0) == [None] * 120 + [TOO_OLD] * 1000 + [None]
    assert set(delays(*(0.09 + 0.04 * (i % 3) for i in range(200)))) == {None}, "it jitters"
    assert set(delays(*(0.09 + 0.001 * i for i in range(300)))) == {None}, "it creeps"


def test_a_clock_that_stands_is_reported_by_the_arrivals_and_one_that_goes_on_is_taken_at_once() -> None:
    state, out = ClockWatch(), []
    for t in (0.005 * i for i in range(200)):
        measured = t if t > 0.75 else min(t, 0.5)
        state, verdict = watch_delay(state, "Imu", stamp(measured, t + 0.01 - measured), 0.5, 1.0)
        out.append((t, verdict, state.off("Imu")))
    refused = [t for t, verdict, _ in out if verdict is TOO_OLD]
    assert 0.6 <= refused[0] < 0.61, "0.1 s after the newest stamp"
    assert refused[-1] == 0.75
    assert not any(off for t, _, off in out if t > 0.75)


def test_samples_that_come_twice_or_after_a_pause_have_a_clock_that_goes() -> None:
    state = ClockWatch()
    for t in (1.0, 1.01, 1.02, 1.9, 1.91, 2.9):
        for late_s in (0.01, 0.03):
            state, verdict = watch_delay(state, "Imu", stamp(t, late_s), 0.5, 1.0)
            assert verdict is None


def test_another_delay_is_the_stream_s_own_after_its_time_unbroken() -> None:
    def delayed(state: ClockWatch, delay_s: float, at_s: float, kind: str = "Imu") -> tuple[ClockWatch, Verdict | None]:
        return watch_delay(state, kind, stamp(at_s - delay_s, delay_s), 0.125, 1.0)

    state = ClockWatch()
    for _ in range(9):
        for kind, delay_s in (("Imu", 0.125), ("Baro", 0.4)):
            state, verdict = delayed(state, delay_s, 100.0, kind)
            assert verdict is None, "each stream has its own"
    state, verdict = delayed(state, 0.4, 101.0)
    assert (verdict, state.off("Imu"), state.off("Baro")) == (TOO_OLD, True, False)
    broken, _ = delayed(state, 0.125, 101.5)
    assert not broken.off("Imu")
    assert delayed(broken, 0.4, 102.0)[1] is TOO_OLD
    assert delayed(state, 0.4, 101.999)[1] is TOO_OLD
    lasting, verdict = delayed(state, 0.4, 102.0)
    assert (verdict, lasting.off("Imu"), lasting.delays["Imu"].median_s) == (None, False, pytest.approx(0.4))
