"""The entry point of the estimator: `step(memory, event) -> memory, results`, and `belief(memory, now)`.

The guard (`estimator.integrity`) runs before any path: an input that is not fresh, not possible or not about the tracked pad
reaches no path and gets a verdict of its own. Several paths can run on the same events; one steers, and the others are for
comparison.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from msgspec import structs

from estimator import dead_reckoning, ekf, filters, integrity
from estimator.attitude_history import AttitudeHistory
from estimator.contracts.estimates import PathName, RelativeState, Sighting, Verdict
from estimator.contracts.fusion import FusionResult, source_of
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.ekf import Forecast
from estimator.options import EstimatorOptions
from estimator.paths import DeadReckoningPath, EkfPath, Event, MedianMeanPath, Path


@dataclass(frozen=True, slots=True)
class Memory:
    """The state of the whole estimator. Immutable."""

    options: EstimatorOptions
    attitudes: AttitudeHistory
    paths: tuple[Path, ...]
    """The paths; the first one steers."""
    guard: integrity.IntegrityGuard = field(default_factory=integrity.IntegrityGuard)


def start(options: EstimatorOptions, shadows: Sequence[PathName] = ()) -> Memory:
    """Return an estimator without any input.

    Args:
        shadows: paths that run for comparison and never steer.
    """
    names = (options.path, *(name for name in shadows if name != options.path))
    paths = tuple(_path(name, options) for name in names)
    return Memory(options, AttitudeHistory(options.history_s), paths, integrity.IntegrityGuard(options.integrity))


def on_frame(memory: Memory, frame: Frame) -> tuple[Memory, Verdict | None]:
    """Check one frame before vision processes it; return REPEATED if it shows nothing new, else None."""
    guard, verdict = integrity.admit_frame(memory.guard, frame)
    return replace(memory, guard=guard), verdict


def step(memory: Memory, event: Event) -> tuple[Memory, tuple[FusionResult, ...]]:
    """Process one event; return the new memory and the results.

    A sighting gives one result for each path. A sample gives one result for each path that uses it, and one for each path if it
    is refused before the paths.
    """
    attitude, guard = None, memory.guard
    if isinstance(event, Sighting):
        attitude = attitude_at(memory, event.stamp)
        refusal = _refusal(memory.options, event)
        if refusal is None:
            before = memory.paths[0].at(event.stamp.measured_at)
            guard, refusal = integrity.admit_sighting(guard, event, attitude, before)
    else:
        guard, refusal = integrity.admit(guard, event)
    if refusal is not None:
        source, stamp = source_of(event), event.stamp
        refused = (FusionResult(path.name, source, refusal, stamp.measured_at, stamp.received_at) for path in memory.paths)
        return replace(memory, guard=guard), tuple(refused)
    if isinstance(event, Attitude):
        guard, event = integrity.steadied(guard, event)
    attitudes = memory.attitudes.add(event) if isinstance(event, Attitude) else memory.attitudes
    paths: list[Path] = []
    results: list[FusionResult] = []
    for path in memory.paths:
        stepped, result = path.step(event)
        paths.append(stepped)
        if result is not None:
            results.append(result)
    if isinstance(event, Sighting) and results[0].verdict is Verdict.FUSED:
        guard = integrity.fused(guard, event, attitude)
    return Memory(memory.options, attitudes, tuple(paths), guard), tuple(results)


def steer_by(memory: Memory, name: PathName) -> Memory:
    """Return the memory with another path steering; the previous one continues as a shadow.

    A path that did not run before starts empty and first has to see the pad.

    Raises:
        ValueError: there is no such path.
    """
    chosen = next((path for path in memory.paths if path.name == name), None) or _path(name, memory.options)
    others = tuple(path for path in memory.paths if path.name != name)
    return replace(memory, options=structs.replace(memory.options, path=name), paths=(chosen, *others))


def belief(memory: Memory, now: MonoNs) -> RelativeState | None:
    """Return the steering path's belief, with its track number and its alerts."""
    state = memory.paths[0].at(now)
    return None if state is None else _dressed(state, memory.guard, now)


def beliefs(memory: Memory, now: MonoNs) -> tuple[RelativeState, ...]:
    """Return every path's belief; the steering path's comes first if it has one."""
    return tuple(_dressed(state, memory.guard, now) for path in memory.paths if (state := path.at(now)) is not None)


def motion(memory: Memory, now: MonoNs) -> tuple[BodyMotion | None, DeckMotion | None]:
    """Return the motion of body and deck by the steering path; None for what it does not estimate or does not know yet."""
    return memory.paths[0].motion(now)


def forecast(memory: Memory, now: MonoNs, horizons_s: Sequence[float]) -> Forecast | None:
    """Return the deck at these times, s, after an instant by the steering path; None if it does not forecast."""
    return memory.paths[0].forecast(now, horizons_s)


def attitude_at(memory: Memory, stamp: Stamp) -> Attitude | None:
    """Return the attitude at the instant a frame was exposed; None if no sample covers it."""
    return memory.attitudes.at(stamp.measured_at, stamp)


def _dressed(state: RelativeState, guard: integrity.IntegrityGuard, now: MonoNs) -> RelativeState:
    alerts = integrity.alerts(guard, now)
    return replace(
        state,
        track=guard.tracks.number,
        alerts=alerts,
        consistent=state.consistent and not alerts,
        details=(
            *state.details,
            ("range_agrees", float(guard.heights.confirmed(now))),
            ("heading_off_rad", guard.heading.off_rad),
        ),
    )


def _refusal(options: EstimatorOptions, sighting: Sighting) -> Verdict | None:
    if sighting.stamp.delay_s > options.max_delay_s:
        return Verdict.TOO_OLD
    if sighting.confidence < options.min_confidence:
        return Verdict.GATED
    return None


def _path(name: PathName, options: EstimatorOptions) -> Path:
    match name:
        case "median_mean":
            return MedianMeanPath(filters.MedianMean(options.max_gap_s))
        case "dead_reckoning":
            own = options.dead_reckoning
            reckoning = structs.replace(own, history_s=max(own.history_s, options.max_delay_s))
            return DeadReckoningPath(filters.MedianMean(options.max_gap_s), dead_reckoning.DeadReckoning.start(reckoning))
        case "ekf":
            return EkfPath(ekf.start(options.ekf, limits=None))
        case _:
            raise ValueError(f"no such estimator path: {name}")
