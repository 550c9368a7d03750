"""Measure the filter over many seeded flights, beside the two other paths.

    python -m benches.estimator [--runs 200] [--workers 2]

The flights alternate between sea states 0, 2 and 4, and between sightings at 10 and 30 Hz. Every flight has its own camera delay,
mount error, velocity scale and biases, 2 % wrong sightings, and a velocity sensor that measures relative to the ground or (every
other time) to the deck. Sightings have the errors of the thesis' methods: 2 mm per metre across, 5 mm per metre along, 1 mm more
in each, and one degree of heading; they arrive 120 +- 40 ms late. The vehicle's own attitude has a constant error of 0.2 degrees
and a wandering one of 0.3.
"""

import argparse
import math
import multiprocessing
import os
import sys
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from estimator import ekf
from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.geometry import F64
from estimator.ekf.state import N
from estimator.paths import DeadReckoningPath, MedianMeanPath
from tests.support.approach_settings import DURATION_S, OPTIONS, setting
from tests.support.estimator_truth import TruthFlight, events, ns

HOLD_S = (12.0, 26.0)
"""Begin and end of the hold, in which the body stays about 2 m over the pad's mean position, seconds."""
HORIZONS_S = (1.0, 2.0, 3.0)
MOUNT_GOAL_RAD = math.radians(0.3)
CHI2_7 = (1.690, 16.013)
"""The 2.5 % and 97.5 % quantiles of chi-square with 7 degrees of freedom."""
CHI2_NIS = {3: (0.216, 9.348), 4: (0.484, 11.143), 6: (1.237, 14.449)}


@dataclass
class Result:
    """The result of one flight."""

    sea: int
    rate_hz: float
    position: dict[str, float] = field(default_factory=dict)
    """Mean square position error over the hold by path, m^2."""
    velocity: dict[str, float] = field(default_factory=dict)
    nees: float = 0.0
    nees_inside: float = 0.0
    nis: float = 0.0
    nis_inside: float = 0.0
    covered: dict[tuple[str, float, float], list[int]] = field(default_factory=dict)
    """Number of forecasts inside the bound and of all, by (quantity, horizon, probability)."""
    delay_error_s: float = 0.0
    mount_error_rad: float = 0.0
    """Mount error of the worst axis, rad."""
    mount_expected: float = 0.0
    """Probability, by the filter's own covariance, that the worst axis is within 0.3 degrees."""
    scale_error: float = 0.0
    moving: float = 0.0
    cost_s: dict[str, float] = field(default_factory=dict)
    """Median processor time of a step by kind, of an answer and of a forecast at three horizons, seconds."""
    floor_s: float = 0.0
    """Median time of a product of two (50, 50) matrices, seconds; a sighting needs some twenty of them."""
    bytes: int = 0
    nodes: int = 0
    verdicts: dict[str, int] = field(default_factory=dict)


def fly(seed: int) -> Result:
    s = setting(seed)
    flight = TruthFlight(s)
    out = Result(s.sea, s.sighting_hz)
    memory = ekf.start(OPTIONS)
    others: dict[str, MedianMeanPath | DeadReckoningPath] = {
        "median_mean": MedianMeanPath(),
        "dead_reckoning": DeadReckoningPath(),
    }
    squares: dict[str, list[tuple[float, float]]] = defaultdict(list)
    nees, nis, cost = [], [], defaultdict(list)
    covered: dict[tuple[str, float, float], list[int]] = defaultdict(lambda: [0, 0])
    verdicts: dict[str, int] = defaultdict(int)
    next_s, next_forecast_s = 5.0, 10.0
    for event in events(flight):
        while event.stamp.received_at >= ns(next_s):
            d, v, yaw = (x[0] for x in flight.relative(np.array([next_s])))
            began = time.process_time()
            answer = ekf.at(memory, ns(next_s))
            cost["answer"].append(time.process_time() - began)
            states = {name: path.at(ns(next_s)) for name, path in others.items()} | {"ekf": answer}
            for name, state in states.items():
                if state is not None and HOLD_S[0] <= next_s < HOLD_S[1]:
                    dd, dv = state.d_body_pad_level - d, state.v_pad_level - v
                    squares[name].append((float(dd @ dd), float(dv @ dv)))
            state = states["ekf"]
            if state is not None and state.yaw_rad is not None and next_s > 8.0:
                turn = math.remainder(state.yaw_rad - yaw, math.tau)
                error = np.concatenate([state.d_body_pad_level - d, state.v_pad_level - v, [turn]])
                nees.append(float(error @ np.linalg.solve(state.cov, error)))
            if next_s >= next_forecast_s and next_s < DURATION_S - 3.5:
                next_forecast_s += 1.0
                began = time.process_time()
                predicted = ekf.forecast(memory, ns(next_s), HORIZONS_S)
                cost["forecast"].append(time.process_time() - began)
                compare(predicted, flight, next_s, covered)
            next_s += 0.1
        began = time.process_time()
        memory, outcomes = ekf.step(memory, event)
        cost[type(event).__name__].append(time.process_time() - began)
        outcome = outcomes[0]
        verdicts[outcome.verdict.value] += 1
        if isinstance(event, Sighting) and outcome.verdict is Verdict.FUSED and outcome.innovation is not None and event.seq > 20:
            low, high = CHI2_NIS[outcome.innovation.size]
            nis.append((outcome.nis / outcome.innovation.size, low <= outcome.nis <= high))
        for name, path in others.items():
            others[name] = path.step(event)[0] if isinstance(event, Sighting) else path.step_samples([event])[0]
    for name, rows in squares.items():
        out.position[name], out.velocity[name] = (float(x) for x in np.mean(rows, axis=0))
    out.nees = float(np.mean(nees)) / 7.0
    out.nees_inside = float(np.mean([CHI2_7[0] <= x <= CHI2_7[1] for x in nees]))
    out.nis, out.nis_inside = (float(x) for x in np.mean(nis, axis=0))
    out.covered = dict(covered)
    final = ekf.at(memory, ns(DURATION_S - 0.05))
    if final is not None:
        named = dict(final.details)
        out.delay_error_s = named["camera_delay_s"] - s.hidden_delay_s
        mount = np.array([named[f"mount_{k}_rad"] for k in "xyz"]) - np.radians(s.mount_deg)
        out.mount_error_rad = float(np.abs(mount).max())
        sigmas = [named[f"sigma_mount_{k}_rad"] for k in "xyz"]
        out.mount_expected = math.prod(math.erf(MOUNT_GOAL_RAD / (math.sqrt(2.0) * sigma)) for sigma in sigmas)
        out.scale_error = named["velocity_scale"] / s.velocity_scale - 1.0
        out.moving = named["probability_moving"]
    out.cost_s = {kind: float(np.median(values[len(values) // 4 :])) for kind, values in cost.items()}
    out.floor_s = floor()
    out.bytes, out.nodes = memory_of(memory)
    out.verdicts = dict(verdicts)
    return out


def floor() -> float:
    """Return the processor time that this machine takes for a product of two (50, 50) matrices, seconds."""
    a, took = np.random.default_rng(0).standard_normal((50, 50)), []
    for _ in range(100):
        began = time.process_time()
        for _ in range(10):
            a.dot(a)
        took.append((time.process_time() - began) / 10)
    return float(np.median(took))


def compare(
    predicted: ekf.Forecast | None, flight: TruthFlight, now_s: float, covered: dict[tuple[str, float, float], list[int]]
) -> None:
    """Compare one forecast with the truth."""
    if predicted is None:
        return
    t = now_s + np.array(HORIZONS_S)
    p, v, R = flight.pad(t)
    body, v_body, _ = flight.body(np.array([now_s]))
    psi = math.atan2(*flight.attitude(np.array([now_s]))[0, [1, 0], 0])
    Z = np.array([[math.cos(psi), math.sin(psi), 0.0], [-math.sin(psi), math.cos(psi), 0.0], [0.0, 0.0, 1.0]])
    truth: dict[str, F64] = {
        "d_body_pad_level": (p - body - v_body * np.array(HORIZONS_S)[:, None]) @ Z.T,
        "deck_height_m": flight.p0[2] - p[:, 2],
        "rise_m_s": -v[:, 2],
    }
    if flight.s.pose6:
        truth["roll_rad"] = np.arctan2(R[:, 2, 1], R[:, 2, 2])
        truth["pitch_rad"] = -np.arcsin(R[:, 2, 0])
    for what, true in truth.items():
        for probability in (0.68, 0.95):
            low, high = predicted.band(what, probability)
            inside = (low <= true) & (true <= high)
            for k, h in enumerate(HORIZONS_S):
                counter = covered[what, h, probability]
                counter[0] += int(np.sum(inside[k]))
                counter[1] += int(np.size(inside[k]))


def memory_of(memory: ekf.Ekf) -> tuple[int, int]:
    """Return the bytes of the history's beliefs and of their distinct covariances, and its length."""
    nodes = memory.history.nodes
    packed = [node.packed for node in nodes if node.packed is not None]
    covariances = {belief.P.ctypes.data for belief in packed}
    return sum(belief.numbers.nbytes for belief in packed) + len(covariances) * N * N * 8, len(nodes)


def report(results: Sequence[Result]) -> None:
    print(f"{len(results)} flights; rmse of the 3-vectors over the hold at 2 m")
    print(
        "sea  Hz |   position cm: ekf  median_mean  dead_reckoning | velocity cm/s: ekf  median_mean  dead_reckoning "
        "|  NEES/7 inside |   NIS inside"
    )
    for sea in (0, 2, 4):
        for rate in (10.0, 30.0):
            some = [r for r in results if r.sea == sea and r.rate_hz == rate]
            if not some:
                continue
            p, v = (
                [
                    100 * math.sqrt(np.mean([getattr(r, what)[name] for r in some]))
                    for name in ("ekf", "median_mean", "dead_reckoning")
                ]
                for what in ("position", "velocity")
            )
            print(
                f"{sea:3d} {rate:3.0f} | {p[0]:17.1f} {p[1]:12.1f} {p[2]:15.1f} | {v[0]:18.1f} {v[1]:12.1f} {v[2]:15.1f} "
                f"| {np.mean([r.nees for r in some]):7.2f} {100 * np.mean([r.nees_inside for r in some]):5.0f}% "
                f"| {np.mean([r.nis for r in some]):5.2f} {100 * np.mean([r.nis_inside for r in some]):4.0f}%"
            )
    print("forecasts: share of truths inside the 68 % / 95 % band at 1, 2, 3 s")
    for sea in sorted({r.sea for r in results}):
        for what in ("d_body_pad_level", "deck_height_m", "rise_m_s", "roll_rad", "pitch_rad"):
            cells = []
            for h in HORIZONS_S:
                shares = []
                for probability in (0.68, 0.95):
                    pairs = [r.covered.get((what, h, probability), [0, 0]) for r in results if r.sea == sea]
                    inside, total = np.sum(pairs, axis=0)
                    shares.append(100 * inside / max(total, 1))
                cells.append(f"{shares[0]:3.0f} / {shares[1]:3.0f}")
            print(f"{sea:3d} {what:18s} " + "    ".join(cells))
    print(
        "recovered after 40 s: sea | delay: rms ms, within 5 ms | mount: rms of the worst axis deg, within 0.3, so expected "
        "| scale: rms %, within 3 % | moving"
    )
    for sea in sorted({r.sea for r in results}):
        some = [r for r in results if r.sea == sea]
        delay = np.array([r.delay_error_s for r in some]) * 1e3
        mount = np.degrees([r.mount_error_rad for r in some])
        scale = np.array([r.scale_error for r in some]) * 100
        print(
            f"{sea:3d} | {rms(delay):5.1f} {share(np.abs(delay) < 5):4.0f}% | {rms(mount):5.2f} {share(mount < 0.3):4.0f}% "
            f"{100 * np.mean([r.mount_expected for r in some]):4.0f}% "
            f"| {rms(scale):5.1f} {share(np.abs(scale) < 3):4.0f}% | {np.mean([r.moving for r in some]):.2f}"
        )
    for kind in ("Imu", "Attitude", "BodyVelocity", "Sighting", "answer", "forecast"):
        cost = np.array([r.cost_s[kind] for r in results]) * 1e6
        what = kind if kind in ("answer", "forecast") else f"step of a {kind}"
        print(f"{what:23s} {np.min(cost):6.0f} us in the quickest flight, {np.median(cost):6.0f} us in the median one")
    print(f"product of two (50, 50) matrices {1e6 * np.median([r.floor_s for r in results]):6.1f} us")
    print(f"history: {np.median([r.bytes for r in results]) / 1e6:.1f} MB in {np.median([r.nodes for r in results]):.0f} events")
    verdicts: dict[str, int] = defaultdict(int)
    for r in results:
        for name, count in r.verdicts.items():
            verdicts[name] += count
    print("verdicts:", ", ".join(f"{name} {count}" for name, count in sorted(verdicts.items())))


def rms(x: F64) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def share(x: NDArray[np.bool_]) -> float:
    return 100.0 * float(np.mean(x))


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description="The filter over many seeded flights.")
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    chosen = parser.parse_args(arguments)
    if chosen.runs < 1 or chosen.workers < 1:
        parser.error("--runs and --workers are 1 or more")
    began = time.perf_counter()
    results = []
    with multiprocessing.get_context("spawn").Pool(chosen.workers) as pool:
        for n, result in enumerate(pool.imap_unordered(fly, range(chosen.runs)), 1):
            results.append(result)
            if sys.stderr.isatty():
                print(f"\r{n}/{chosen.runs} flights", end="", file=sys.stderr, flush=True)
    print(f"\r{time.perf_counter() - began:.0f} s", file=sys.stderr)
    report(results)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
