"""Measure the filter over seeded flights beside the two other paths, and in rough seas.

    python -m benches.estimator flights [--runs 200] [--workers 2]
    python -m benches.estimator rough [--runs 6] [--first 0] [--sea NAME] [--ideal]

`flights` alternate between sea states 0, 2 and 4, and between sightings at 10 and 30 Hz. Every flight has its own camera delay,
mount error, velocity scale and biases, 2 % wrong sightings, and a velocity sensor that measures relative to the ground or (every
other time) to the deck. Sightings have the errors of the thesis' methods: 2 mm per metre across, 5 mm per metre along, 1 mm more
in each, and one degree of heading; they arrive 120 +- 40 ms late. The vehicle's own attitude has a constant error of 0.2 degrees
and a wandering one of 0.3.

`rough` has truth and sensors of tests/support/voyage_truth.py, which share nothing with the simulator: rough seas, a turning
ship, and every sensor error at once. Each row is the mean of its flights: position rms, NEES over its 7 degrees of freedom, the
fraction of it inside the central 95 % of chi-square, the fraction of true values inside the 68 / 95 % bands of the forecast
position and vertical speed, and the rms error of the forecast vertical speed over the rms of the true one (a forecast of zero
would give 1). The delay's columns are the rms error (estimated minus true) and the same in estimated sigmas.
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
from estimator.options import DeadReckoningOptions
from estimator.paths import DeadReckoningPath, MedianMeanPath
from tests.support import voyage_truth
from tests.support.estimator_truth import DURATION_S, OPTIONS, TruthFlight, events, ns, setting
from tests.support.voyage_score import Score, fly_voyage
from tests.support.voyage_truth import SEAS, VoyageScene

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


def fly(seed: int) -> Result:
    s = setting(seed)
    flight = TruthFlight(s)
    out = Result(s.sea, s.sighting_hz)
    memory = ekf.Filter(OPTIONS)
    others: dict[str, MedianMeanPath | DeadReckoningPath] = {
        "median_mean": MedianMeanPath(0.5),
        "dead_reckoning": DeadReckoningPath(0.5, DeadReckoningOptions()),
    }
    squares: dict[str, list[tuple[float, float]]] = defaultdict(list)
    nees, nis, cost = [], [], defaultdict(list)
    covered: dict[tuple[str, float, float], list[int]] = defaultdict(lambda: [0, 0])
    next_s, next_forecast_s = 5.0, 10.0
    for event in events(flight):
        while event.stamp.received_at >= ns(next_s):
            d, v, yaw = (x[0] for x in flight.relative(np.array([next_s])))
            began = time.process_time()
            answer = memory.at(ns(next_s))
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
                predicted = memory.forecast(ns(next_s), HORIZONS_S)
                cost["forecast"].append(time.process_time() - began)
                compare(predicted, flight, next_s, covered)
            next_s += 0.1
        began = time.process_time()
        outcomes = memory.put([event])
        cost[type(event).__name__].append(time.process_time() - began)
        outcome = outcomes[0]
        if isinstance(event, Sighting) and outcome.verdict is Verdict.FUSED and outcome.innovation is not None and event.seq > 20:
            low, high = CHI2_NIS[outcome.innovation.size]
            nis.append((outcome.nis / outcome.innovation.size, low <= outcome.nis <= high))
        for path in others.values():
            path.sight(event) if isinstance(event, Sighting) else path.put([event])
    for name, rows in squares.items():
        out.position[name], out.velocity[name] = (float(x) for x in np.mean(rows, axis=0))
    out.nees = float(np.mean(nees)) / 7.0
    out.nees_inside = float(np.mean([CHI2_7[0] <= x <= CHI2_7[1] for x in nees]))
    out.nis, out.nis_inside = (float(x) for x in np.mean(nis, axis=0))
    out.covered = dict(covered)
    final = memory.at(ns(DURATION_S - 0.05))
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
    return out


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


def rms(x: F64) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def share(x: NDArray[np.bool_]) -> float:
    return 100.0 * float(np.mean(x))


def row(name: str, scores: Sequence[Score]) -> str:
    cells = [
        f"{name:15s} {100 * np.mean([s.rms_m for s in scores]):5.1f} cm",
        f"NEES {np.mean([np.mean(s.nees) for s in scores]) / 7:5.2f}",
        f"{100 * np.mean([s.inside for s in scores]):3.0f} % (worst {100 * min(s.inside for s in scores):3.0f})",
    ]
    for what in ("d_body_pad_level", "rise_m_s"):
        shares = []
        for h in HORIZONS_S:
            inside = [100 * np.mean([np.mean(s.bands[what, h, p]) for s in scores]) for p in (0.68, 0.95)]
            shares.append(f"{inside[0]:3.0f}/{inside[1]:3.0f}")
        cells.append(" ".join(shares))
    rise = np.concatenate([np.array(s.rise) for s in scores])
    ratio = np.sqrt(np.mean(rise[:, :3] ** 2, axis=0) / np.maximum(np.mean(rise[:, 3:] ** 2, axis=0), 1e-12))
    cells.append(" ".join(f"{x:.2f}" for x in ratio))
    delay = np.array([s.delay_error_s / s.delay_sigma_s for s in scores])
    cells.append(
        f"delay off {1e3 * np.sqrt(np.mean([s.delay_error_s**2 for s in scores])):4.1f} ms"
        f" = {np.sqrt(np.mean(delay**2)):.1f} sigma  moving {np.mean([s.moving for s in scores]):.2f}"
    )
    return " | ".join(cells)


def fly_rough(args: argparse.Namespace) -> None:
    """Print a row for each sea."""
    print("sea | position rms | NEES/7 | inside 95 % | position bands 1, 2, 3 s 68/95 | rise bands | rise error over truth")
    for sea in args.sea or [name for name in SEAS if name != "calm"]:
        scores = []
        for seed in range(args.first, args.first + (args.runs or 6)):
            scene = VoyageScene(seed=seed, sea=sea, hidden_delay_s=0.03 if seed % 4 < 2 else -0.03)
            scores.append(fly_voyage(voyage_truth.without_errors(scene) if args.ideal else scene))
        print(row(sea, scores), flush=True)


def fly_flights(args: argparse.Namespace) -> None:
    """Print the report of the seeded flights."""
    began, results, runs = time.perf_counter(), [], args.runs or 200
    with multiprocessing.get_context("spawn").Pool(args.workers) as pool:
        for n, result in enumerate(pool.imap_unordered(fly, range(runs)), 1):
            results.append(result)
            if sys.stderr.isatty():
                print(f"\r{n}/{runs} flights", end="", file=sys.stderr, flush=True)
    print(f"\r{time.perf_counter() - began:.0f} s", file=sys.stderr)
    report(results)


ONLY = {"flights": fly_flights, "rough": fly_rough}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("only", nargs="?", choices=ONLY, default="flights")
    parser.add_argument("--runs", type=int, help="number of flights (default: 200, or 6 in each rough sea)")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--first", type=int, default=0, help="first seed in rough seas")
    parser.add_argument("--sea", choices=sorted(SEAS), action="append")
    parser.add_argument("--ideal", action="store_true", help="white sensor noise alone")
    args = parser.parse_args()
    ONLY[args.only](args)


if __name__ == "__main__":
    main()
