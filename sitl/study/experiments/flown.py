"""Fly an experiment and keep what every method and path estimated beside the truth."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec
import numpy as np

from companion.base.observer import Decision, NullObserver, ProcessedFrame
from companion.guidance.pilot import Pilot, make_pilot
from companion.settings.model import Settings
from estimator.contracts.estimates import PathName
from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs, seconds_between
from sitl.flight.ending import Ending
from sitl.flight.stepped import Timing, new_flight
from sitl.scenario.scenario import Scenario, load
from sitl.study.experiments.hand import HandPilot, HeldPose, Path, level_axes, thesis_axes, thesis_yaw_rad
from sitl.world.truth import Truth

METHODS = ("ellipse", "arrow", "corners", "registration", "best")
"""The thesis' three methods as they are here, the fourth, and the estimate that all of them make together."""
SHADOWS: tuple[PathName, ...] = ("median_mean", "dead_reckoning")
THESIS_RATE_HZ = 10.0
_AT_REST_S, _LANDS_WITHIN_S = 3.0, 60.0
"""Time that the hand gets to arrive before anything counts, and a pilot to land."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """One estimate beside the truth, in the thesis' axes."""

    t_s: float
    name: str
    """Method of a sighting, or path of a belief."""
    xyz_m: F64
    yaw_rad: float | None
    true_xyz_m: F64
    true_yaw_rad: float
    sigma_m: float
    """Claimed standard deviation of the horizontal position, one axis."""


@dataclass(slots=True)
class ExperimentFlight:
    """A flown experiment."""

    sightings: list[Estimate] = field(default_factory=list)
    beliefs: list[Estimate] = field(default_factory=list)
    truth: list[tuple[float, F64, float]] = field(default_factory=list)
    """(t_s, (3,) m x, y, z, heading in rad) at 50 Hz."""
    frames: int = 0
    """Number of frames that were searched."""
    result: Ending | None = None

    def of(self, name: str) -> list[Estimate]:
        """Return the estimates of one method or path."""
        return [e for e in (*self.sightings, *self.beliefs) if e.name == name]


class _Notes(NullObserver):
    """Keeps what the observers of a service hear, with the truth of the same instant."""

    def __init__(self, flown: ExperimentFlight, after_s: float, least: float) -> None:
        self.flown = flown
        self.least = least
        """Confidence from which the service takes a sighting."""
        self.after_s = after_s
        self.started = MonoNs(0)
        self.truth: dict[int, Truth] = {}
        """The truth by instant, ns, at every exposure."""
        self.now: Callable[[], Truth]

    def on_frame(self, processed: ProcessedFrame) -> None:
        true = self.truth.get(processed.frame.stamp.measured_at) or min(
            self.truth.values(), key=lambda one: abs(one.at - processed.frame.stamp.measured_at)
        )
        t_s = seconds_between(self.started, true.at)
        if t_s < self.after_s or processed.detection is None:
            return
        self.flown.frames += 1
        for name, one in (*processed.detection.methods.items(), ("best", processed.detection.selected)):
            if one is not None and one.confidence >= self.least:
                self.flown.sightings.append(_beside(t_s, name, one.d_body_pad_level, one.yaw_rad, one.cov, true))

    def on_decision(self, decision: Decision) -> None:
        true = self.now()
        t_s = seconds_between(self.started, decision.at)
        self.flown.truth.append((t_s, thesis_axes(true.d_body_pad_level), thesis_yaw_rad(true.yaw_rad)))
        for belief in (decision.belief, *decision.shadows):
            if belief is not None:
                self.flown.beliefs.append(_beside(t_s, belief.path, belief.d_body_pad_level, belief.yaw_rad, belief.cov, true))


def _beside(t_s: float, name: str, d: F64, yaw_rad: float | None, cov: F64, true: Truth) -> Estimate:
    yaw = None if yaw_rad is None else thesis_yaw_rad(yaw_rad)
    sigma_m = math.sqrt(max(0.0, 0.5 * float(cov[0, 0] + cov[1, 1])))
    return Estimate(t_s, name, thesis_axes(d), yaw, thesis_axes(true.d_body_pad_level), thesis_yaw_rad(true.yaw_rad), sigma_m)


def calm_scenario(start: HeldPose, duration_s: float, *, exact_attitude: bool) -> Scenario:
    """Return the thesis' surroundings: flat water, no wind, a motionless ship; the drone begins in the air at a pose.

    Args:
        exact_attitude: whether the drone reports its attitude without error, as the thesis' simulator nearly did.
    """
    calm = load("calm")
    d = level_axes(start)
    heading_deg = float(np.degrees(thesis_yaw_rad(np.radians(start.yaw_deg))))
    begin = msgspec.structs.replace(
        calm.start,
        height_m=max(0.3, start.z_m),
        pad_forward_m=float(d[0]),
        pad_right_m=float(d[1]),
        heading_deg=heading_deg,
    )
    sensors = calm.sensors
    if exact_attitude:
        exact = dict.fromkeys(
            ("tilt_bias_sigma_deg", "tilt_drift_sigma_deg", "heading_bias_sigma_deg", "heading_drift_sigma_deg"), 0.0
        )
        sensors = msgspec.structs.replace(sensors, **exact)
    return msgspec.structs.replace(calm, start=begin, duration_limit_s=duration_s, sensors=sensors)


def fly_by_hand(settings: Settings, path: Path, duration_s: float, seed: int, *, exact_attitude: bool = True) -> ExperimentFlight:
    """Fly a path by hand at the thesis' ten frames a second; nothing of the first seconds, in which the hand arrives, is kept.

    Args:
        exact_attitude: whether the drone reports its attitude without error.

    Raises:
        BadInput: the settings name a camera or pad file with a fault.
    """
    first = path(0.0)
    arrives_s = _AT_REST_S + (0.0 if first.z_m >= 0.3 else 2.0)
    settings = msgspec.structs.replace(settings, guidance=msgspec.structs.replace(settings.guidance, start="signal"))
    pilot = make_pilot(settings, SHADOWS, HandPilot)
    assert isinstance(pilot, HandPilot)
    scenario = calm_scenario(first, arrives_s + duration_s, exact_attitude=exact_attitude)
    pilot.path = lambda t_s: path(max(0.0, t_s - arrives_s))
    flown = _flown(settings, scenario, seed, pilot, arrives_s, 1.0 / THESIS_RATE_HZ)
    flown.beliefs[:] = [one for one in flown.beliefs if one.t_s >= arrives_s]
    return flown


def fly_pilot(settings: Settings, start: HeldPose, seed: int, kind: Callable[..., Pilot] = Pilot) -> ExperimentFlight:
    """Fly a pilot that lands by itself from a pose."""
    pilot = make_pilot(settings, SHADOWS, kind)
    return _flown(settings, calm_scenario(start, _LANDS_WITHIN_S, exact_attitude=False), seed, pilot, 0.0, 1.0 / 30.0)


def _flown(
    settings: Settings, scenario: Scenario, seed: int, pilot: Pilot, after_s: float, frame_period_s: float
) -> ExperimentFlight:
    flown = ExperimentFlight()
    notes = _Notes(flown, after_s, settings.estimator.min_confidence)
    flight = new_flight(scenario, seed, settings, pilot, observers=[notes], timing=Timing(frame_period_s=frame_period_s))
    notes.started, notes.now = flight.world.started, flight.world.truth
    if isinstance(pilot, HandPilot):
        pilot.truth = flight.world.truth
    exposures = 0
    while flight.step():
        if flight.exposures > exposures:
            exposures = flight.exposures
            truth = flight.world.truth()
            notes.truth[truth.at] = truth
            if len(notes.truth) > 200:
                del notes.truth[next(iter(notes.truth))]
    flown.result = flight.result()
    return flown
