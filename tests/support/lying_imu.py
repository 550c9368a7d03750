"""Flights of the estimator alone, pixels left out, in which half of an IMU lies, and their errors by truth."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from msgspec.structs import replace

from estimator.contracts.geometry import F64
from estimator.contracts.samples import Imu
from estimator.options import EstimatorOptions
from estimator.pipeline import RelativeEstimator
from tests.support.estimator_truth import EPOCH_NS, Event, Setting, TruthFlight, events, ns

BEGIN_S, BEFORE_S, STEP_S = 8.0, 5.0, 0.05
STREAMS = {
    "sea": 4, "duration_s": 16.0, "imu_hz": 100.0, "attitude_hz": 25.0, "velocity_hz": 20.0, "range_hz": 10.0, "baro_hz": 25.0,
    "sighting_hz": 15.0,
}  # fmt: skip
Fault = Callable[[Imu], Imu]


@dataclass
class Flown:
    """Outputs of the estimator in a flight, every `STEP_S` from `BEFORE_S` on."""

    t: list[float] = field(default_factory=list)
    error_m: list[float] = field(default_factory=list)
    sigma_m: list[float] = field(default_factory=list)
    nees: list[float] = field(default_factory=list)
    """NEES of position and velocity, over their six dimensions."""
    consistent: list[bool] = field(default_factory=list)
    named: dict[str, float] = field(default_factory=dict)
    """Instant from which a sensor is left out, by the sentence, s after the fault's beginning."""
    lost: tuple[str, ...] = ()
    restarts: int = 0

    def during(self, since: float, until: float) -> slice:
        return slice(*np.searchsorted(self.t, [since, until]))

    def deceived_s(self) -> float:
        """Return for how long it was wrong by more than it said and called itself consistent."""
        all_of = zip(self.error_m, self.sigma_m, self.consistent, strict=True)
        return STEP_S * sum(error > max(0.3, 4.0 * sigma) and consistent for error, sigma, consistent in all_of)

    def named_after_s(self, words: str) -> float:
        """Return the time from the fault's beginning until a sentence has these words; infinity if none has."""
        return min((t for text, t in self.named.items() if words in text), default=math.inf)


def fly_lying(setting: Setting, fault: Fault, lasts_s: float, blind: Callable[[Event], bool] = lambda e: False) -> Flown:
    """Fly with a fault of the IMU from `BEGIN_S` on.

    Args:
        blind: which events the estimator does not get.
    """
    flight, memory, out = TruthFlight(setting), RelativeEstimator(EstimatorOptions()), Flown()
    now = BEFORE_S
    for event in events(flight):
        while event.stamp.received_at >= ns(now):
            state, (d, v, _) = memory.at(ns(now)), (x[0] for x in flight.relative(np.array([now])))
            assert state is not None or memory.guard.restarts, f"nothing is believed at {now:.2f} s"
            if state is not None:
                off: F64 = np.concatenate([state.d_body_pad_level - d, state.v_pad_level - v])
                out.t.append(now)
                out.error_m.append(float(np.linalg.norm(off[:3])))
                out.sigma_m.append(math.sqrt(state.cov.diagonal()[:3].sum()))
                out.nees.append(float(off.dot(np.linalg.solve(state.cov[:6, :6], off))) / 6.0)
                out.consistent.append(state.consistent)
            now += STEP_S
        if blind(event):
            continue
        since_s = (event.stamp.measured_at - EPOCH_NS) * 1e-9 - BEGIN_S
        memory.put([fault(event) if isinstance(event, Imu) and 0.0 <= since_s < lasts_s else event])
        for text in memory.guard.lost:
            out.named.setdefault(text, since_s)
    out.restarts, out.lost = memory.guard.restarts, memory.guard.lost
    return out


def setting(seed: int, **fields: float) -> Setting:
    return Setting(seed=seed, **{**STREAMS, **fields})  # type: ignore[arg-type]


def frozen(half: str) -> Fault:
    first: list[F64] = []

    def spoil(imu: Imu) -> Imu:
        first.append(getattr(imu, half))
        return replace(imu, **{half: first[0]})

    return spoil


def changed(f: float = 1.0, f_by: F64 | None = None, w_by_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Fault:
    by = np.zeros(3) if f_by is None else f_by
    return lambda imu: replace(imu, f_body=f * imu.f_body + by, w_body=imu.w_body + np.radians(w_by_deg))
