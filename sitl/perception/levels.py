"""The levels of perception by name, and the level `truth`, which needs neither vision nor filter.

At the level `truth` guidance flies by the true state with an error as the filter's would be. The draw of whether the pad is seen
is that of the level `model`, because the estimate ages without sight. The error is a Gauss-Markov process for each component,
with the covariance that was fitted for the height and the time since the newest sighting; the estimate claims that same
covariance, so it is honest. The motion of body and deck has an error in the same way.
"""

import math
from bisect import bisect_right
from collections.abc import Sequence
from functools import lru_cache, partial
from types import MappingProxyType
from typing import Any

import numpy as np

from companion.guidance.pilot import Look, Pilot, make_pilot
from companion.settings.model import Settings
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import FusionResult, PathName, RelativeState, Sighting, Verdict
from estimator.contracts.geometry import F64, known_rotation, rpy_matrix, wrap_pi
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.samples import Attitude, Frame, known
from estimator.contracts.time import NS_PER_S, MonoNs, Stamp, seconds_between
from estimator.ekf import Forecast
from estimator.paths import Event
from estimator.pipeline import RelativeEstimator
from estimator.vision.detection import Detection
from sitl.faults.fault import Fault
from sitl.faults.kinds import FrameStream, VesselReports
from sitl.perception.model import DrawingPilot, Model, detection_table, model_for, root_of, symmetric
from sitl.perception.parameters import EstimateModel, PerceptionModel
from sitl.perception.port import LEVELS, Level, Perception
from sitl.world.world import World

SIGMA_ACCEL_M_S2, ACCEL_TIME_S = 0.06, 4.0
"""Levelled acceleration: the tilt that the filter errs by, times g, and how fast it changes."""
SIGMA_SAMPLE_M_S2 = 0.043
"""One sample of the accelerometer beside that."""
SIGMA_DECK_M_S, DECK_TIME_S = (0.05, 0.05, 0.02), 1.5
"""The deck's velocity over the ground, north, east, down."""
SIGMA_DECK_M_S2 = (0.04, 0.04, 0.04)
SIGMA_TILT_RAD, SIGMA_TILT_RATE_RAD_S = 0.004, 0.006
AHEAD_S = (0.0, 0.3, 1.0, 2.0, 3.0)
AHEAD_FRACTION = (0.0, 0.06, 0.2, 0.4, 0.6)
"""Error of the forecast change of velocity, as a fraction of the deck's own rms velocity on waves."""
_CHANNELS = 3 + 3 + 3 + 4 + 3
_EYE = np.eye(3)
_SIGMA_DECK = np.array([*SIGMA_DECK_M_S, *SIGMA_DECK_M_S2])
_SIGMA_TILT = np.array([SIGMA_TILT_RAD, SIGMA_TILT_RAD, SIGMA_TILT_RATE_RAD_S, SIGMA_TILT_RATE_RAD_S])
_COV_ACCEL, _COV_DECK, _COV_TILT = (
    (SIGMA_ACCEL_M_S2**2 + SIGMA_SAMPLE_M_S2**2) * np.eye(3),
    np.diag(_SIGMA_DECK**2).copy(),
    np.diag(_SIGMA_TILT**2).copy(),
)
for _cov in (_COV_ACCEL, _COV_DECK, _COV_TILT):
    _cov.setflags(write=False)


class TrueMotion:
    """Draws the motion that guidance receives. One generator; the errors are Gauss-Markov processes."""

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        self._world, self._rng = world, rng
        self._standard = rng.standard_normal(_CHANNELS)
        self._at: MonoNs | None = None
        times = np.linspace(0.0, 60.0, 121)
        pad = world.vessel.pad(times)
        self._level_m = float(np.mean(pad.p_ned[0, :, 2]))
        v = pad.v_ned[0]
        self._rms_m_s = np.sqrt(np.mean((v - v.mean(axis=0)) ** 2, axis=0))

    def motion(self, now: MonoNs, reported: Attitude | None) -> tuple[BodyMotion | None, DeckMotion]:
        """Return the motion at an instant."""
        standard = self._wander(now)
        truth, pad = self._world.truth(), self._world.pad_motion()
        heading = truth.R_ned_body.rpy_rad[2]
        Z = rpy_matrix(0.0, 0.0, -heading)
        body = None
        if reported is not None:
            a = Z.dot(truth.a_body_ned) + SIGMA_ACCEL_M_S2 * standard[:3] + SIGMA_SAMPLE_M_S2 * self._rng.standard_normal(3)
            a.setflags(write=False)
            truth.w_body.setflags(write=False)
            body = BodyMotion(now, heading, a, _COV_ACCEL, truth.w_body, reported.R_ned_body, reported.cov_body)
        v = Z.dot(pad.v_ned + _SIGMA_DECK[:3] * standard[3:6])
        a = Z.dot(pad.a_ned + _SIGMA_DECK[3:] * standard[6:9])
        v.setflags(write=False)
        a.setflags(write=False)
        roll, pitch, _ = truth.R_ned_pad.rpy_rad
        off = (_SIGMA_TILT * standard[9:13]).tolist()
        roll_rate, pitch_rate, _ = pad.w.tolist()
        return body, DeckMotion(
            now, v, a, _COV_DECK, roll + off[0], pitch + off[1], roll_rate + off[2], pitch_rate + off[3], _COV_TILT
        )

    def forecast(self, now: MonoNs, horizons_s: Sequence[float], d_body_pad_level: F64) -> Forecast:
        """Return the deck ahead of an instant.

        Args:
            d_body_pad_level: (3,) m, the reported place of the pad now.
        """
        standard = self._wander(now)
        h = np.asarray(horizons_s, dtype=float)
        truth, pad, here = self._world.truth(), self._world.pad_ahead(h), self._world.pad_motion()
        Z = rpy_matrix(0.0, 0.0, -truth.R_ned_body.rpy_rad[2])
        fraction = np.interp(h, AHEAD_S, AHEAD_FRACTION)[:, None]
        spread = fraction * self._rms_m_s
        off = spread * standard[13:16]
        v = pad.v_ned[0] + off + _SIGMA_DECK[:3] * standard[3:6]
        moved = pad.p_ned[0] - here.p_ned + off * (h[:, None] / 3.0)
        d = d_body_pad_level + (moved - h[:, None] * truth.v_body_ned) @ Z.T
        sigma_d = 0.02 + spread * h[:, None] / 2.0
        tilts = np.array([known_rotation(R).rpy_rad[:2] for R in pad.R_ned[0]])
        tilt_off = np.radians(1.0) * fraction * standard[9:11]
        tilt_sigma = SIGMA_TILT_RAD + np.radians(1.0) * fraction[:, 0]
        return Forecast(
            now, h, d, _EYE * (sigma_d * sigma_d)[:, None, :], v @ Z.T,
            self._level_m - pad.p_ned[0, :, 2], sigma_d[:, 2],
            -v[:, 2], np.hypot(spread[:, 2], _SIGMA_DECK[2]),
            tilts[:, 0] + tilt_off[:, 0], tilt_sigma, tilts[:, 1] + tilt_off[:, 1], tilt_sigma,
        )  # fmt: skip

    def _wander(self, now: MonoNs) -> F64:
        """Carry the standard normal numbers of the errors on to another instant."""
        if self._at is not None and now != self._at:
            keep, new = _carried(max(0, now - self._at))
            self._standard = keep * self._standard + new * self._rng.standard_normal(_CHANNELS)
        self._at = now
        return self._standard


@lru_cache(maxsize=8)
def _carried(ns: int) -> tuple[F64, F64]:
    """Return how much of the errors' standard normal numbers stays over a time, and how much is new, both (16,)."""
    dt = ns / NS_PER_S
    keep = np.repeat(np.exp([-dt / ACCEL_TIME_S, -dt / DECK_TIME_S]), [3, _CHANNELS - 3])
    return keep, np.sqrt(1.0 - keep * keep)


REPRESENTED = frozenset(
    {
        "lens_covered", "frames", "commands", "low_battery", "gust", "weak_rotor", "tilt_limited", "link_lost", "service_killed",
        "operator", "pad_covered", "light_falls", "magnetometer", "ship_speed", "ship_turn", "deck_roll", "ferry_wake",
        "vessel_reports", "failsafe",
    }
)  # fmt: skip
"""Kinds of faults that act on the vessel, the vehicle, the link or sight, or on what the filter does not read. Every other one
acts through the filter, which does not run."""
_SPAWN_KEY = 1302
_N = 7
_AGREED = 3
"""Number of sightings after which the filter's estimate counts as consistent."""
_TRUE_TILT_COV, _LEAST_COV = 1e-12 * np.eye(3), 1e-12 * np.eye(_N)
_TRUE_TILT_COV.setflags(write=False)
_SEEN, _LEAST_SEEN_COV = np.ix_([0, 1, 2, 6], [0, 1, 2, 6]), 1e-12 * np.eye(4)
"""Indices of position and heading in the estimate's covariance, and the least covariance of a sighting."""


class EstimateTable:
    """The error model of the estimate, ready for use."""

    def __init__(self, model: EstimateModel) -> None:
        self.model = model
        cells = {(c.height, c.age): root_of(symmetric(c.error, _N)) for c in model.cell}
        self._heights, self._ages = list(model.heights_m), list(model.ages_s)
        squares = {cell: (root, 0.5 * ((square := root.dot(root.T)) + square.T)) for cell, root in cells.items()}
        self._roots = [
            [squares[min(cells, key=lambda c: (abs(c[1] - j) + 2 * abs(c[0] - i), c))] for j in range(len(self._ages) + 1)]
            for i in range(len(self._heights) + 1)
        ]
        self._rates = 1.0 / np.array(model.correlation_s)
        self._carried: tuple[int, F64, F64] = 0, np.ones(_N), np.zeros(_N)

    def carried(self, ns: int) -> tuple[F64, F64]:
        """Return how much of the error's standard normal numbers stays over a time, and how much is new, both (7,)."""
        if self._carried[0] != ns:  # most cycles are as long as the one before
            keep = np.exp(-ns / NS_PER_S * self._rates)
            self._carried = ns, keep, np.sqrt(1.0 - keep * keep)
        return self._carried[1:]

    def root(self, height_m: float, age_s: float) -> tuple[F64, F64]:
        """Return the root of the covariance and the covariance, both (7, 7), positions over the height."""
        return self._roots[bisect_right(self._heights, height_m)][bisect_right(self._ages, age_s)]


@lru_cache(maxsize=8)
def _estimate_table(model: EstimateModel) -> EstimateTable:
    """Return the table of a model; the flights of one process share it."""
    return EstimateTable(model)


class TruthLevel(Model):
    """The estimate is the truth with an error model of the filter."""

    level: Level = "truth"
    world: World
    """The world of the flight, from its beginning on."""
    _rng: np.random.Generator

    def pilot(self, settings: Settings, shadows: Sequence[PathName] = ()) -> Pilot:
        """Return a pilot that flies by the truth."""
        return make_pilot(settings, shadows, partial(TruthPilot, self, model_for(settings, self._given), settings))

    def refuse(self, faults: Sequence[Fault]) -> None:
        """Refuse a fault that acts on what does not run at this level."""
        super().refuse(faults)
        for fault in faults:
            only_order = isinstance(fault, FrameStream) and not fault.delay_s and not fault.dropped_fraction
            of_filter = isinstance(fault, VesselReports) and any(
                (fault.north_m_s, fault.east_m_s, fault.heading_deg, fault.frozen)
            )
            if fault.kind not in REPRESENTED or only_order or of_filter:
                raise BadInput(
                    f"the fault {fault.kind} acts on vision or the filter, which --perception truth leaves out; "
                    "use --perception model"
                )

    def begin(self, world: World) -> None:
        """Begin a flight in this world."""
        super().begin(world)
        self.world = world
        self._rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(world.seed, spawn_key=(_SPAWN_KEY,))))

    def fresh(self) -> F64:
        """Return (7,) new standard normal numbers."""
        return self._rng.standard_normal(_N)


class TruthEstimator(RelativeEstimator):
    """The true state, made uncertain, in place of the filter."""

    def __init__(self, level: TruthLevel, model: PerceptionModel, settings: Settings, shadows: Sequence[PathName]) -> None:
        super().__init__(settings.estimator, shadows)
        self._level = level
        self._estimates = _estimate_table(model.estimate)
        self._forget_s = settings.estimator.ekf.forget_s
        self._sigma_max_m = settings.estimator.ekf.consistent_sigma_m
        self._agreed = 0
        self._sighted: MonoNs | None = None
        self._standard: F64 | None = None
        self._drawn_at = MonoNs(0)
        self._drawn: tuple[MonoNs, RelativeState | None] | None = None
        self._reported: Attitude | None = None
        self._true_motion: TrueMotion | None = None

    def put(self, events: Sequence[Event], *, wanted: bool = True) -> list[tuple[FusionResult, ...]]:
        """Keep the attitude that the vehicle reports; no other sample is of use without a filter."""
        for event in events:
            if type(event) is Attitude:
                self._reported = event
        return [()] * len(events)

    def put_seen(
        self, tracked: Sighting | None, elsewhere: Sighting | None, alone_in: F64 | None = None
    ) -> tuple[FusionResult, ...]:
        """Remember when the pad was seen."""
        if tracked is not None:
            at = tracked.stamp.measured_at
            self._agreed = self._agreed + 1 if self._sighted is not None else 1
            self._sighted = at if self._sighted is None else max(self._sighted, at)
            self._drawn = None
        return ()

    def motion(self, now: MonoNs) -> tuple[BodyMotion | None, DeckMotion | None]:
        """Return the true motion of body and deck with an error; the deck's once the pad has been seen."""
        body, deck = self._moved().motion(now, self._reported)
        return body, None if self.at(now) is None else deck

    def forecast(self, now: MonoNs, horizons_s: Sequence[float]) -> Forecast | None:
        """Return the true deck ahead with an error."""
        state = self.at(now)
        return None if state is None else self._moved().forecast(now, horizons_s, state.d_body_pad_level)

    def attitude_at(self, stamp: Stamp) -> Attitude | None:
        """Return the true attitude now; nothing is computed from it."""
        return known(Attitude, stamp, self._level.world.truth().R_ned_body, _TRUE_TILT_COV)

    def admit(self, frame: Frame) -> Verdict | None:
        """Admit every frame: none is searched."""
        return None

    def at(self, instant: MonoNs) -> RelativeState | None:
        """Return the truth with an error, once the pad has been seen."""
        if self._drawn is None or self._drawn[0] != instant:
            self._drawn = instant, self._estimate(instant)
        return self._drawn[1]

    def all_at(self, instant: MonoNs) -> tuple[RelativeState, ...]:
        """Return the one estimate: no other path runs at this level."""
        state = self.at(instant)
        return () if state is None else (state,)

    def _moved(self) -> TrueMotion:
        if self._true_motion is None:
            # Made uncertain with a generator of its own.
            seed = np.random.SeedSequence(self._level.world.seed, spawn_key=(_SPAWN_KEY, 1))
            self._true_motion = TrueMotion(self._level.world, np.random.Generator(np.random.PCG64(seed)))
        return self._true_motion

    def _estimate(self, now: MonoNs) -> RelativeState | None:
        if self._sighted is None or seconds_between(self._sighted, now) > self._forget_s:
            self._sighted = None
            return None
        truth = self._level.world.truth()
        d = truth.d_body_pad_level
        height_m = max(0.05, d.item(2))
        root, square = self._estimates.root(height_m, seconds_between(self._sighted, now))
        scale = np.array([height_m, height_m, height_m, 1.0, 1.0, 1.0, 1.0])
        error = scale * root.dot(self._wander(now))
        cov = square * (scale[:, None] * scale)
        consistent = self._agreed >= _AGREED and math.sqrt(max(cov.diagonal()[:3].tolist())) <= self._sigma_max_m
        d += error[:3]
        v = truth.v_pad_level
        v += error[3:6]
        cov += _LEAST_COV
        for array in (d, v, cov):
            array.setflags(write=False)
        yaw = wrap_pi(truth.yaw_rad + error.item(6))
        return RelativeState(now, self.path, d, v, yaw, cov, self._sighted, consistent)

    def _wander(self, now: MonoNs) -> F64:
        """Carry the standard normal numbers of the error on to another instant."""
        fresh = self._level.fresh()
        if self._standard is None:
            self._standard = fresh
        else:
            keep, new = self._estimates.carried(max(0, now - self._drawn_at))
            self._standard = keep * self._standard + new * fresh
        self._drawn_at = now
        return self._standard


class TruthPilot(DrawingPilot):
    """The pilot with the true state, made uncertain, in place of vision and filter."""

    def __init__(self, level: TruthLevel, model: PerceptionModel, settings: Settings, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._level = level
        self._detections, self._estimates = detection_table(model.detection), _estimate_table(model.estimate)
        self._found = False
        self.estimator = TruthEstimator(level, model, settings, ())

    def detect(self, look: Look) -> Detection:
        """Draw whether the pad is seen in a frame, and say where it truly was."""
        frame = look.frame
        scene = self._level.scenes.of(frame)
        view, light = scene.view, scene.light_stops
        self._found = view is not None and bool(scene.chance.uniform[0] < self._detections.probability(view, light, self._found))
        if not self._found or view is None:
            return Detection(None, None, MappingProxyType({"registration": None}))
        camera = self.camera
        R_ned_cam = scene.R_ned_body @ camera.T_body_cam.R.matrix
        body = known_rotation(scene.R_ned_body)
        d_ned = R_ned_cam @ view.t_cam_pad + scene.R_ned_body @ camera.T_body_cam.t
        heading = body.rpy_rad[2]
        c, s = math.cos(heading), math.sin(heading)
        d = np.array([c * d_ned[0] + s * d_ned[1], c * d_ned[1] - s * d_ned[0], d_ned[2]])
        arrow = R_ned_cam @ view.R_cam_pad[:, 0]
        yaw = wrap_pi(heading - math.atan2(arrow[1], arrow[0]))
        _, square = self._estimates.root(float(d[2]), 0.0)
        scale = np.array([d[2], d[2], d[2], 1.0])
        cov = square[_SEEN] * np.multiply.outer(scale, scale) + _LEAST_SEEN_COV
        seen = Sighting(frame.stamp, frame.seq, "registration", d, yaw, False, cov, 1.0)
        return Detection(seen, "registration", MappingProxyType({"registration": seen}))

    def on_detection(self, seen: Detection) -> tuple[Verdict, tuple[FusionResult, ...]]:
        """Remember when the pad was seen."""
        self.estimator.put_seen(seen.selected, None)
        return Verdict.NO_PAD if seen.selected is None else Verdict.FUSED, ()


def perceive(level: Level, model: str | None = None) -> Perception:
    """Return a perception of this level, for one flight.

    Args:
        model: the error model's file, or the name of a shipped one; None for the one of the settings' vision.

    Raises:
        BadInput: the level is not known, or the error model's file is missing or has a fault.
    """
    if level == "pixels":
        return Perception()
    if level in LEVELS:
        return Model(model) if level == "model" else TruthLevel(model)
    raise BadInput(f"there is no perception {level!r}; known are {', '.join(LEVELS)}")


def represents(level: Perception, faults: Sequence[Fault]) -> bool:
    """Return whether a level of perception represents all of these faults."""
    try:
        level.refuse(faults)
    except BadInput:
        return False
    return True
