"""Check what is received by itself: impossible readings, frozen ones, repeated frames, stamps alone with their time."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import UNKNOWN_VAR, Attitude, Baro, BodyVelocity, Imu, Range, VesselReport
from estimator.contracts.time import MonoNs, Stamp
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
from tests.make import stamp, stamp_at

LIMITS = IntegrityOptions()
RNG = np.random.default_rng(5)
FLIGHT = Path(__file__).parents[3] / "../shared/data/flight_with_mocap"


def imu(t_s: float, f: tuple[float, float, float] | None = None, w: tuple[float, float, float] | None = None) -> Imu:
    noise = RNG.normal(0, 0.01, 3)
    return Imu(stamp(t_s), noise if w is None else np.array(w), np.array([0, 0, -9.8]) + noise if f is None else np.array(f))


def velocity(t_s: float, v: tuple[float, float, float]) -> BodyVelocity:
    return BodyVelocity(stamp(t_s), np.array(v), np.diag([0.01, 0.01, UNKNOWN_VAR]))


def run(events: list[Reading], flying: bool = True) -> list[Verdict | None]:
    state, out = SensorWatch(), []
    for event in events:
        state, verdict = watch_reading(state, event, LIMITS, flying)
        out.append(verdict)
    return out


@pytest.mark.parametrize(
    "event",
    [
        imu(1.0, f=(1e4, 0, 0)),
        imu(1.0, f=(0, 0, -81.0)),
        imu(1.0, w=(0, 36.0, 0)),
        velocity(1.0, (20.1, 0, 0)),
        VesselReport(stamp(1.0), np.array([21.0, 0, 0]), np.eye(3), None, None),
    ],
    ids=["accelerometer spike", "9 g", "gyro", "velocity", "vessel"],
)
def test_what_no_vehicle_does_is_impossible(event: Reading) -> None:
    assert run([event]) == [Verdict.IMPOSSIBLE]


@pytest.mark.parametrize(
    "event",
    [
        imu(1.0, f=(0, 0, -79.0)),
        imu(1.0, w=(34.0, 0, 0)),
        velocity(1.0, (19.9, 0, 999.0)),
        VesselReport(stamp(1.0), None, None, 1.0, 0.1),
    ],
    ids=["8 g", "gyro", "velocity whose unmeasured axis says anything", "vessel without velocity"],
)
def test_what_a_vehicle_may_do_is_let_through(event: Reading) -> None:
    assert run([event]) == [None]


@pytest.mark.parametrize(
    ("make", "frozen_s"),
    [
        (lambda t: imu(t, (0.1, 0.2, -9.8), (0.0, 0.0, 0.1)), LIMITS.imu_frozen_s),
        (lambda t: Attitude(stamp(t), Rotation.identity(), np.eye(3)), LIMITS.attitude_frozen_s),
        (lambda t: velocity(t, (0.0, 0.0, 0.0)), LIMITS.velocity_frozen_s),
        (lambda t: Range(stamp(t), 1.234, 0.02), LIMITS.range_frozen_s),
        (lambda t: Baro(stamp(t), 1.234, 0.02), LIMITS.baro_frozen_s),
    ],
    ids=["imu", "attitude", "velocity", "range", "baro"],
)
def test_a_reading_that_holds_to_the_bit_is_frozen_after_its_time_and_in_flight_alone(make, frozen_s: float) -> None:
    events = [make(0.005 * i) for i in range(round(frozen_s / 0.005) + 20)]
    output = run(events)
    assert output[: round(frozen_s / 0.005)] == [None] * round(frozen_s / 0.005)
    assert output[-1] is Verdict.FROZEN
    assert set(run(events, flying=False)) == {None}


def test_one_changed_bit_thaws_it() -> None:
    still = [imu(0.005 * i, (0.1, 0.2, -9.8), (0.0, 0.0, 0.1)) for i in range(100)]
    assert run([*still, imu(0.6)])[-2:] == [Verdict.FROZEN, None]


def test_a_spike_of_velocity_or_tilt_or_height_is_refused_and_a_lasting_step_is_let_through() -> None:
    def stepping(make, low, high) -> list[Reading]:
        return [make(0.02 * i, high if i >= 50 else low) for i in range(100)]

    for make, low, high in (
        (lambda t, v: velocity(t, (v + 1e-3 * np.sin(t), 0, 0)), 0.0, 6.0),
        (lambda t, roll: Attitude(stamp(t), Rotation.from_rpy(roll + 1e-3 * np.sin(t), 0, 1.0), np.eye(3)), 0.0, 1.4),
        (lambda t, h: Baro(stamp(t), h + 1e-3 * np.sin(t), 0.5), 0.0, 30.0),
    ):
        output = run(stepping(make, low, high))
        assert output[:50] == [None] * 50
        assert output[50:74] == [Verdict.IMPOSSIBLE] * 24
        assert output[-1] is None


def test_a_turn_of_heading_is_no_step_of_tilt() -> None:
    assert run([Attitude(stamp(0.02 * i), Rotation.from_rpy(0.001 * i, 0, 1.5 * i), np.eye(3)) for i in range(20)]) == [None] * 20


@pytest.mark.skipif(not FLIGHT.is_dir(), reason="the recorded flight is not on this machine")
def test_nothing_of_a_real_flight_is_refused() -> None:
    """Real noise, real repeats: 41 s of an AR.Drone's IMU, velocity and ultrasound."""
    with (FLIGHT / "imu.csv").open() as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    output = run([imu(r["t_stamp_s"], (r["ax"], r["ay"], -r["az"]), (r["wx"], r["wy"], r["wz"])) for r in rows])
    assert set(output) == {None}
    with (FLIGHT / "navdata.csv").open() as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    rows = [r for r in rows if r["motor1"] > 0 and r["altd_mm"] > 0]
    assert len(rows) > 7000
    assert set(run([velocity(r["t_stamp_s"], (1e-3 * r["vx_mm_s"], 1e-3 * r["vy_mm_s"], 0)) for r in rows])) == {None}
    assert set(run([Range(stamp(r["t_stamp_s"]), 1e-3 * r["altd_mm"], 0.02) for r in rows])) == {None}


S, MS = 1_000_000_000, 1_000_000


T = 10 * S


def imu_at(t: int, f: float = 9.8, w: float = 0.1) -> Imu:
    return Imu(stamp_at(t), np.array([w, 0.0, 0.0]), np.array([0.0, 0.0, -f]))


def vessel(t: int, v: float) -> VesselReport:
    return VesselReport(stamp_at(t), np.array([0.0, v, 0.0]), np.eye(3), None, None)


def baro(t: int, height_m: float) -> Baro:
    return Baro(stamp_at(t), height_m, 0.5)


def said(*events: Reading) -> list[Verdict | None]:
    state, out = SensorWatch(), []
    for event in events:
        state, verdict = watch_reading(state, event, LIMITS, True)
        out.append(verdict)
    return out


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_speed_is_that_of_the_components_that_were_measured(axis: int) -> None:
    var = np.full(3, 1e3)
    var[axis] = 0.01
    for speed, verdict in ((20.0, None), (-20.0, None), (20.01, Verdict.IMPOSSIBLE)):
        v = np.full(3, 500.0)
        v[axis] = speed
        assert said(BodyVelocity(stamp_at(T), v, np.diag(var))) == [verdict]


@pytest.mark.parametrize(
    ("roll_rad", "pitch_rad"), [(2.315840312948539, -0.08309898974996566), (0.6869503213152144, -0.3514859733064353)]
)
def test_upside_down_is_a_step_though_rounding_puts_the_poles_farther_apart_than_two(roll_rad: float, pitch_rad: float) -> None:
    poles = [Rotation.from_rpy(roll_rad, pitch_rad, 1.0), Rotation.from_rpy(roll_rad + math.pi, -pitch_rad, 1.0)]
    assert math.dist(*(pole.matrix[2].tolist() for pole in poles)) > 2.0
    upright, over = (Attitude(stamp_at(T + i * 20 * MS), pole, np.eye(3)) for i, pole in enumerate(poles))
    assert said(upright, over) == [None, Verdict.IMPOSSIBLE]


def test_readings_that_nobody_compares_may_step() -> None:
    assert said(imu_at(T, f=0.0), imu_at(T + MS, f=79.0)) == [None, None]
    assert said(vessel(T, 0.0), vessel(T + MS, 19.0)) == [None, None]


def test_a_reading_of_the_same_instant_or_from_before_is_compared_with_none() -> None:
    for t in (T, T - MS):
        assert said(baro(T, 0.0), baro(t, 30.0)) == [None, None]


def test_a_repeat_beyond_the_limits_is_impossible_first() -> None:
    assert said(imu_at(T, f=90.0), imu_at(T + S, f=90.0)) == [Verdict.IMPOSSIBLE] * 2
    assert said(imu_at(T), imu_at(T + 140 * MS), imu_at(T + 160 * MS)) == [None, None, Verdict.FROZEN]


def test_a_vessels_report_may_repeat_for_ever() -> None:
    assert said(vessel(T, 1.0), vessel(T + 3600 * S, 1.0)) == [None, None]


FRAMES_RNG = np.random.default_rng(3)


def noisy(level: int = 100) -> np.ndarray:
    """Return a still scene as a sensor sees it."""
    return FRAMES_RNG.normal(level, 2.0, (360, 640, 3)).astype(np.uint8)


def test_frames_of_a_still_scene_differ_by_the_sensors_noise_and_are_let_through() -> None:
    state = FrameWatch()
    for _ in range(30):
        state, repeated = watch_frame(state, noisy())
        assert not repeated
    assert not state.frozen


def test_a_frame_that_repeats_is_refused_at_once_and_the_camera_is_frozen_at_the_third() -> None:
    state, still = FrameWatch(), noisy()
    state, _ = watch_frame(state, still)
    runs = []
    for _ in range(4):
        state, repeated = watch_frame(state, still.copy())
        runs.append((repeated, state.frozen))
    assert runs == [(True, False), (True, False), (True, True), (True, True)]
    state, repeated = watch_frame(state, noisy())
    assert (repeated, state.frozen) == (False, False)


def test_a_ring_of_buffers_handed_out_again_and_again_is_frozen() -> None:
    state, ring = FrameWatch(), [noisy() for _ in range(8)]
    for frame in ring:
        state, _ = watch_frame(state, frame)
    for frame in ring[:3]:
        state, repeated = watch_frame(state, frame)
        assert repeated
    assert state.frozen


def test_an_image_that_is_one_row_in_memory_is_known_by_that_row() -> None:
    row = noisy()[0]
    assert digest(np.broadcast_to(row, (360, *row.shape))) == digest(np.broadcast_to(row, (9, *row.shape)))
    assert digest(np.repeat(row[None], 360, axis=0)) != digest(row[None].repeat(9, axis=0))


HOUR_S = 3600.0


def received(received_at_s: float, delay_s: float = 0.01) -> Stamp:
    return Stamp(MonoNs(round((received_at_s - delay_s) * 1e9)), MonoNs(round(received_at_s * 1e9)), 0.001, "sim")


def run_clock(kinds_and_times: list[tuple[str, float]]) -> list[Verdict | None]:
    state, out = ClockWatch(), []
    for kind, t in kinds_and_times:
        state, verdict = watch_arrival(state, kind, received(t), 1.0)
        out.append(verdict)
    return out


def test_one_sample_an_hour_ahead_is_refused_and_poisons_nothing() -> None:
    output = run_clock([("Imu", 0.01 * i) for i in range(20)] + [("Imu", HOUR_S)] + [("Imu", 0.2 + 0.01 * i) for i in range(20)])
    assert output[20] is Verdict.TOO_NEW
    assert output[:20] == output[21:] == [None] * 20


def test_a_stream_that_alternates_between_now_and_an_hour_ahead_never_moves_the_time() -> None:
    output = run_clock([("Imu", 0.01 * i + (HOUR_S if i % 2 else 0.0)) for i in range(200)])
    assert output[::2] == [None] * 100
    assert set(output[1::2]) == {Verdict.TOO_NEW}


def test_after_a_pause_two_streams_confirm_the_time_at_once_and_one_within_a_quarter_of_a_second() -> None:
    assert run_clock([("Imu", 0.0), ("Imu", 60.0), ("Attitude", 60.01), ("Imu", 60.02)]) == [None, Verdict.TOO_NEW, None, None]
    alone = run_clock([("Imu", 0.0), *(("Imu", 60.0 + 0.02 * i) for i in range(15))])
    assert None in alone[1:]
    assert alone[12:] == [None] * 4


def test_a_clock_that_was_misled_comes_back() -> None:
    output = run_clock(
        [("Imu", 0.0)] + [("Imu", HOUR_S + 0.05 * i) for i in range(10)] + [("Imu", 1.0 + 0.05 * i) for i in range(10)]
    )
    assert output[-1] is None


def delays(values: list[float], keep_s: float = math.inf) -> list[Verdict | None]:
    state, out = ClockWatch(), []
    for i, d in enumerate(values):
        state, verdict = watch_delay(state, "Sighting", received(100.0 + i / 30.0, d), 0.15, 10.0, keep_s)
        out.append(verdict)
    return out


def test_a_delay_that_steps_is_refused_until_it_has_settled() -> None:
    output = delays([0.09] * 60 + [0.39] * 400)
    assert output[:60] == [None] * 60
    assert output[60:360] == [Verdict.TOO_OLD] * 300
    assert output[-1] is None
    assert delays([0.39] * 60 + [0.09])[-1] is Verdict.TOO_NEW


def test_a_delay_that_has_held_gives_way_to_no_other() -> None:
    output = delays([0.09] * 60 + [0.39] * 1_000, keep_s=3.0)
    assert output[60:360] == [Verdict.TOO_OLD] * 300
    assert set(output[360:]) == {None}, "two seconds are too short to be kept"
    output = delays([0.09] * 120 + [0.39] * 1_000 + [0.09], keep_s=3.0)
    assert output[120:-1] == [Verdict.TOO_OLD] * 1_000
    assert output[-1] is None


def test_a_delay_that_jitters_or_creeps_is_a_delay() -> None:
    assert set(delays([0.09 + 0.04 * (i % 3) for i in range(200)])) == {None}
    assert set(delays([0.09 + 0.001 * i for i in range(300)])) == {None}


def test_a_clock_that_stands_is_reported_by_the_arrivals_and_one_that_goes_on_is_taken_at_once() -> None:
    state, out = ClockWatch(), []
    times = [0.005 * i for i in range(200)]
    for t in times:
        stood = Stamp(MonoNs(round(min(t, 0.5) * 1e9)), MonoNs(round((t + 0.01) * 1e9)), 0.001, "sim")
        if t > 0.75:
            stood = received(t + 0.01)
        state, verdict = watch_delay(state, "Imu", stood, 0.5, 1.0)
        out.append((t, verdict, state.off("Imu")))
    refused = [t for t, verdict, _ in out if verdict is Verdict.TOO_OLD]
    assert 0.6 <= refused[0] < 0.61, "0.1 s after the newest stamp"
    assert refused[-1] == 0.75
    assert [off for t, _, off in out if t > 0.75] == [False] * sum(t > 0.75 for t in times)


def test_samples_that_come_twice_or_after_a_pause_have_a_clock_that_goes() -> None:
    state = ClockWatch()
    for t in (0.0, 0.01, 0.02, 0.9, 0.91, 1.9):
        for late in (0.0, 0.02):
            twice = Stamp(MonoNs(round(t * 1e9)), MonoNs(round((t + 0.01 + late) * 1e9)), 0.001, "sim")
            state, verdict = watch_delay(state, "Imu", twice, 0.5, 1.0)
            assert verdict is None


NOW = ClockWatch(100 * S)


def arrive(state: ClockWatch, kind: str, t: int) -> tuple[ClockWatch, Verdict | None]:
    return watch_arrival(state, kind, Stamp(MonoNs(t), MonoNs(t), 0.001, "sim"), 1.0)


def test_two_looks_of_one_stream_confirm_nothing_and_of_two_streams_they_do() -> None:
    state, _ = arrive(NOW, "Imu", 200 * S)
    assert arrive(state, "Imu", 200 * S)[1] is Verdict.TOO_NEW
    confirmed, output = arrive(state, "Attitude", 200 * S - MS)
    assert output is None
    assert confirmed == ClockWatch(200 * S), "the newest of them is the time, and delays are learned again"


def delay(state: ClockWatch, delay_ms: float, received_at: int = 100 * S, kind: str = "Imu") -> tuple[ClockWatch, Verdict | None]:
    stamp = Stamp(MonoNs(received_at - round(delay_ms * MS)), MonoNs(received_at), 0.001, "sim")
    return watch_delay(state, kind, stamp, 0.125, 1.0)


def settled(n: int, delay_ms: float = 125.0) -> ClockWatch:
    state = ClockWatch()
    for _ in range(n):
        state, _ = delay(state, delay_ms)
    return state


def test_another_delay_is_the_streams_own_after_its_time_unbroken() -> None:
    state, output = delay(settled(9), 400.0, 101 * S)
    assert (output, state.off("Imu"), state.off("Baro")) == (Verdict.TOO_OLD, True, False)
    state, output = delay(state, 400.0, 102 * S - 1)
    assert output is Verdict.TOO_OLD
    lasting, output = delay(state, 400.0, 102 * S)
    assert (output, lasting.off("Imu"), lasting.delays["Imu"].median_s) == (None, False, 0.4)
    broken, _ = delay(state, 125.0, 102 * S - 1)
    assert not broken.off("Imu")
    assert delay(broken, 400.0, 102 * S)[1] is Verdict.TOO_OLD


def test_each_stream_has_a_delay_of_its_own() -> None:
    state = settled(9)
    for _ in range(9):
        state, output = delay(state, 400.0, kind="Baro")
        assert output is None
    assert (state.delays["Imu"].median_s, state.delays["Baro"].median_s) == (0.125, 0.4)
