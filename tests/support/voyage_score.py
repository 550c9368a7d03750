"""One simulated voyage through the filter, and the errors of it that tests and benches judge.

Truth and sensors are those of `voyage_truth`, which shares nothing with the simulator.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from estimator import ekf
from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64
from estimator.contracts.samples import Imu
from estimator.dead_reckoning import DeadReckoningPath
from estimator.integrity import sensors as sensors_guard
from estimator.integrity.options import IntegrityOptions
from estimator.integrity.sensors import SensorWatch
from estimator.median_mean import MedianMeanPath
from tests.support import voyage_truth
from tests.support.voyage_truth import OPTIONS, Event, Voyage, VoyageScene, ns

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
    memory: ekf.Filter | None = None
    others_m: dict[str, list[float]] = field(default_factory=dict)
    """Position errors of other paths on the same events, by name."""

    @property
    def inside(self) -> float:
        return float(np.mean([CHI2_7[0] <= x <= CHI2_7[1] for x in self.nees]))

    @property
    def rms_m(self) -> float:
        return float(np.sqrt(np.mean(np.square(self.error_m))))


def fly_voyage(
    scene: VoyageScene,
    options: ekf.EkfOptions = OPTIONS,
    *,
    since_s: float = 8.0,
    from_s: float = 0.0,
    spoil: Callable[[Event, float], Sequence[Event]] | None = None,
    forecasts: bool = True,
    others: Mapping[str, MedianMeanPath | DeadReckoningPath] | None = None,
) -> Score:
    """One flight through the filter.

    Args:
        since_s: the time from which it is scored.
        from_s: events before this time are left out: a cold start in flight.
        spoil: given each event and its instant, s; what is received instead.
        others: paths that get the same events, by name.
    """
    voyage = Voyage(scene)
    memory, out, next_s, next_forecast_s = ekf.Filter(options), Score(), since_s, since_s + 2.0
    watch = SensorWatch()
    for event in voyage_truth.events(voyage):
        t = (event.stamp.measured_at - voyage_truth.EPOCH_NS) * 1e-9
        while event.stamp.received_at >= ns(next_s):
            score(out, memory, voyage, next_s)
            for name, path in (others or {}).items():
                if (state := path.at(ns(next_s))) is not None:
                    error = state.d_body_pad_level - voyage.relative(next_s)[0]
                    out.others_m.setdefault(name, []).append(float(np.linalg.norm(error)))
            if forecasts and next_s >= next_forecast_s and next_s < scene.duration_s - 3.1:
                next_forecast_s += 0.5
                score_forecast(out, memory, voyage, next_s)
            next_s += 0.1
        if t < from_s:
            continue
        for one in (event,) if spoil is None else spoil(event, t):
            if isinstance(one, Imu):  # a guard is before the filter, as in flight
                watch, refusal = sensors_guard.watch_reading(watch, one, IntegrityOptions(), flying=True)
                if refusal is not None:
                    continue
            memory.put([one])
            for path in (others or {}).values():
                path.sight(one) if isinstance(one, Sighting) else path.put([one])
    final = memory.at(ns(scene.duration_s - 0.05))
    if final is not None:
        named = dict(final.details)
        out.delay_error_s = named["camera_delay_s"] - scene.hidden_delay_s
        out.delay_sigma_s = named["sigma_camera_delay_s"]
        out.moving = named["probability_moving"]
    out.memory = memory
    return out


def score(out: Score, memory: ekf.Filter, voyage: Voyage, now_s: float) -> None:
    state = memory.at(ns(now_s))
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


def score_forecast(out: Score, memory: ekf.Filter, voyage: Voyage, now_s: float) -> None:
    reported = memory.forecast(ns(now_s), HORIZONS_S)
    if reported is None:
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
            low, high = reported.band(what, probability)
            for k, horizon in enumerate(HORIZONS_S):
                out.bands.setdefault((what, horizon, probability), []).append(
                    float(np.mean(((low <= value) & (value <= high))[k]))
                )
    out.rise.append((*(reported.rise_m_s - true["rise_m_s"]).tolist(), *true["rise_m_s"].tolist()))
