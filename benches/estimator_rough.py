"""The filter where its model is wrong: rough seas, a turning ship, and every sensor error at once.

    python -m benches.estimator_rough [--runs 6] [--first 0] [--sea NAME] [--ideal]

Truth and sensors are those of sitl/testing/voyage_truth.py, which share nothing with the simulator. A row is the mean of its
flights: position rms, NEES over its 7 degrees of freedom and the share of it inside the central 95 % of chi-square, the share
of truths inside the 68 / 95 % bands of the forecast position and vertical speed, and the rms error of the forecast vertical
speed over the rms of the truth (saying nothing would be 1). The delay's columns are the rms error (estimated minus true) and
the same in estimated sigmas.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from estimator import ekf
from estimator.contracts.geometry import F64
from sitl.testing import voyage_truth
from sitl.testing.voyage_truth import OPTIONS, SEAS, Event, Voyage, VoyageScene, ns

HORIZONS_S = (1.0, 2.0, 3.0)
CHI2_7 = (1.690, 16.013)
"""2.5 % and 97.5 % of chi-square with 7 degrees of freedom."""


@dataclass
class Score:
    """The errors of one flight, every 0.1 s from `since_s` on."""

    t: list[float] = field(default_factory=list)
    error_m: list[float] = field(default_factory=list)
    sigma_m: list[float] = field(default_factory=list)
    nees: list[float] = field(default_factory=list)
    consistent: list[bool] = field(default_factory=list)
    yaw_error: list[float] = field(default_factory=list)
    bands: dict[tuple[str, float, float], list[float]] = field(default_factory=dict)
    """Shares of truths inside the bands, keyed by (what, horizon, probability)."""
    rise: list[tuple[float, ...]] = field(default_factory=list)
    """Errors at the horizons, then truths."""
    delay_error_s: float = math.nan
    delay_sigma_s: float = math.nan
    moving: float = math.nan
    memory: ekf.Ekf | None = None

    @property
    def inside(self) -> float:
        return float(np.mean([CHI2_7[0] <= x <= CHI2_7[1] for x in self.nees]))

    @property
    def rms_m(self) -> float:
        return float(np.sqrt(np.mean(np.square(self.error_m))))


def fly(
    scene: VoyageScene,
    options: ekf.EkfOptions = OPTIONS,
    *,
    since_s: float = 8.0,
    from_s: float = 0.0,
    spoil: Callable[[Event, float], Sequence[Event]] | None = None,
    forecasts: bool = True,
) -> Score:
    """One flight through the filter.

    Args:
        since_s: the time from which it is scored.
        from_s: events before this time are left out: a cold start in flight.
        spoil: given each event and its instant, s; what is heard instead.
    """
    voyage = Voyage(scene)
    received_at, sensors = voyage_truth.events(voyage)
    memory, out, next_s, next_forecast_s = ekf.start(options), Score(), since_s, since_s + 2.0
    for event in received_at:
        t = (event.stamp.measured_at - voyage_truth.EPOCH_NS) * 1e-9
        while event.stamp.received_at >= ns(next_s):
            score(out, memory, voyage, next_s)
            if forecasts and next_s >= next_forecast_s and next_s < scene.duration_s - 3.1:
                next_forecast_s += 0.5
                score_forecast(out, memory, voyage, next_s)
            next_s += 0.1
        if t < from_s:
            continue
        for one in (event,) if spoil is None else spoil(event, t):
            memory, _ = ekf.step(memory, one)
    final = ekf.at(memory, ns(scene.duration_s - 0.05))
    if final is not None:
        named = dict(final.details)
        out.delay_error_s = named["camera_delay_s"] - sensors.delay_s
        out.delay_sigma_s = named["sigma_camera_delay_s"]
        out.moving = named["probability_moving"]
    out.memory = memory
    return out


def score(out: Score, memory: ekf.Ekf, voyage: Voyage, now_s: float) -> None:
    state = ekf.at(memory, ns(now_s))
    if state is None:
        return
    d, v, yaw = voyage.relative(now_s)
    turn = 0.0 if state.yaw_rad is None else math.remainder(state.yaw_rad - yaw, math.tau)
    e = np.concatenate([state.d_body_pad_level - d, state.v_pad_level - v, [turn]])
    out.t.append(now_s)
    out.error_m.append(float(np.linalg.norm(e[:3])))
    out.sigma_m.append(float(np.sqrt(np.trace(state.cov[:3, :3]))))
    out.nees.append(float(e @ np.linalg.solve(state.cov, e)))
    out.consistent.append(state.consistent)
    out.yaw_error.append(turn)


def score_forecast(out: Score, memory: ekf.Ekf, voyage: Voyage, now_s: float) -> None:
    told = ekf.forecast(memory, ns(now_s), HORIZONS_S)
    if told is None:
        return
    h = np.array(HORIZONS_S)
    p, v, _ = voyage.pad(now_s + h)
    body, v_body, _ = voyage.body(np.array([now_s]))
    R = voyage.attitude(np.array([now_s]))[0]
    psi = math.atan2(R[1, 0], R[0, 0])
    Z = np.array([[math.cos(psi), math.sin(psi), 0.0], [-math.sin(psi), math.cos(psi), 0.0], [0.0, 0.0, 1.0]])
    true: dict[str, F64] = {"d_body_pad_level": (p - body - v_body * h[:, None]) @ Z.T, "rise_m_s": -v[:, 2]}
    for what, value in true.items():
        for probability in (0.68, 0.95):
            low, high = told.band(what, probability)
            for k, horizon in enumerate(HORIZONS_S):
                out.bands.setdefault((what, horizon, probability), []).append(
                    float(np.mean(((low <= value) & (value <= high))[k]))
                )
    out.rise.append((*(told.rise_m_s - true["rise_m_s"]).tolist(), *true["rise_m_s"].tolist()))


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


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description="The filter in the rough.")
    parser.add_argument("--runs", type=int, default=6)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--sea", choices=sorted(SEAS), action="append")
    parser.add_argument("--ideal", action="store_true", help="white sensor noise alone")
    chosen = parser.parse_args(arguments)
    if chosen.runs < 1:
        parser.error("--runs is 1 or more")
    print("sea | position rms | NEES/7 | inside 95 % | position bands 1, 2, 3 s 68/95 | rise bands | rise error over truth")
    for sea in chosen.sea or [name for name in SEAS if name != "calm"]:
        scores = []
        for seed in range(chosen.first, chosen.first + chosen.runs):
            scene = VoyageScene(seed=seed, sea=sea, hidden_delay_s=0.03 if seed % 4 < 2 else -0.03)
            scores.append(fly(voyage_truth.without_errors(scene) if chosen.ideal else scene))
        print(row(sea, scores), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
