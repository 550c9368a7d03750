"""The filter as Python calls it: events in, results out, and answers at any instant that it remembers.

The native core keeps the recent events and the state after each (estimator/core/filter/filter.c). It inserts a late event at the
instant when it was measured and processes the later ones again.

To a forecast of the deck's motion in the next seconds, with bands, every member of the bank contributes by its weight.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache, cached_property
from typing import Any, Self

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from estimator.contracts.estimates import (
    COMPONENTS,
    UNKNOWN_YAW_VAR,
    Details,
    FusionResult,
    RelativeState,
    Source,
    Verdict,
    components_of,
    source_of,
    uncompared,
)
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.time import MonoNs
from estimator.core.library import CORE
from estimator.ekf.event import Event, packed
from estimator.ekf.options import EkfOptions
from estimator.ekf.params import (
    ACCEL_BIAS,
    BARO_OFFSET,
    CAMERA_DELAY,
    CAMERA_LEVER,
    CAMERA_MOUNT,
    GYRO_BIAS,
    RANGE_OFFSET,
    REST_ODDS,
    TURN_RATE,
    VEL_SCALE,
    VESSEL_VEL,
    FilterParams,
)

_SCALARS = ("height", "sigma_height", "rise", "sigma_rise", "roll", "sigma_roll", "pitch", "sigma_pitch")
_Z = {0.5: 0.6745, 0.68: 0.9945, 0.8: 1.2816, 0.9: 1.6449, 0.95: 1.9600, 0.99: 2.5758}
_CONSISTENT_NIS = 2.0  # Recent mean of NIS over degrees of freedom below which the innovations agree with the covariance
_ANSWERS_KEPT = 8
"""Number of answers that are kept.

Guidance, recorder and links each request the same instant, and vision the one whose sighting comes later.
"""


class Forecast(Struct, frozen=True, eq=False):
    """The deck at H instants ahead of `at`. Axes are those of `level` at `at`; the body is taken to keep its velocity.

    What the body really does is up to whoever steers it: subtract the planned departure from uniform motion.
    """

    at: MonoNs
    horizons_s: F64
    """(H,)"""
    d_body_pad_level: F64
    """(H, 3) m."""
    cov_d_level: F64
    """(H, 3, 3) m^2."""
    v_pad_level: F64
    """(H, 3) velocity of the pad's centre over the ground, m/s."""
    deck_height_m: F64
    """(H,) of the pad's centre above its mean level, positive up."""
    sigma_deck_height_m: F64
    rise_m_s: F64
    """(H,) vertical speed of the pad's centre, positive up."""
    sigma_rise_m_s: F64
    roll_rad: F64
    """(H,) of the deck about the arrow, starboard down positive."""
    sigma_roll_rad: F64
    pitch_rad: F64
    """(H,) of the deck, arrow up positive."""
    sigma_pitch_rad: F64
    """The fields from `deck_height_m` on are `_SCALARS` of the core's `dl_deck_ahead`, in order."""

    @classmethod
    def of(cls, at: MonoNs, horizons_s: F64, found: NDArray[Any]) -> Self:
        """Return the forecast that the core wrote as `dl_deck_ahead`, one for each horizon."""
        n = horizons_s.size
        cov_d = found["cov_d"].reshape(n, 3, 3)
        return cls(at, horizons_s, found["d"], cov_d, found["v_pad"], *(found[name] for name in _SCALARS))

    def band(self, name: str, probability: float) -> tuple[F64, F64]:
        """Return the lower and upper end of a quantity's central band.

        Each is (H,) for `deck_height_m`, `rise_m_s`, `roll_rad` and `pitch_rad`, and (H, 3) for `d_body_pad_level`.

        Raises:
            KeyError: another probability than 0.5, 0.68, 0.8, 0.9, 0.95, 0.99.
            AttributeError: another name.
        """
        z = _Z[probability]
        mean: F64 = getattr(self, name)
        if name == "d_body_pad_level":
            sigma = np.sqrt(np.maximum(np.diagonal(self.cov_d_level, axis1=1, axis2=2), 0.0))
        else:
            sigma = getattr(self, f"sigma_{name}")
        return mean - z * sigma, mean + z * sigma


def log_evidence_of_rest(rest: float) -> float:
    """Return the log of how much likelier all that was seen is from a deck at rest than from one that moves.

    Args:
        rest: the probability that the deck is at rest, by the bank.
    """
    rest = min(max(rest, 1e-12), 1.0 - 1e-12)
    return math.log(rest / (1.0 - rest)) - REST_ODDS


def probability_of_motion(
    evidence_of_rest: float, v_ned: Sequence[float], var_ned: tuple[float, float, float], prior_rest: float = 0.5
) -> float:
    """Return the probability that the vessel is under way or rocks, by the bank's evidence and the steady velocity.

    Args:
        evidence_of_rest: of the bank, `log_evidence_of_rest`.
        v_ned: (2,) the vessel's steady velocity north and east, m/s.
        var_ned: variance north, covariance, and variance east of that, (m/s)^2.
        prior_rest: the probability of rest before any evidence.
    """
    evidence = evidence_of_rest
    north, east = v_ned
    nn, ne, ee = var_ned
    # Standing still to a few cm/s against moving with some 1 m/s.
    for var, sign in ((0.03**2, 1.0), (1.0, -1.0)):
        n, e = nn + var, ee + var
        det = n * e - ne * ne
        evidence += sign * -0.5 * (math.log(det) + (e * north * north - 2.0 * ne * north * east + n * east * east) / det)
    odds = prior_rest / (1.0 - prior_rest) * math.exp(max(-60.0, min(60.0, evidence)))
    return 1.0 / (1.0 + odds)


_VERDICTS = {value: Verdict[name.removeprefix("DL_")] for name, value in CORE.names("dl_verdict").items()}
_EVENTS = CORE.ffi.typeof("dl_event[]")
_TURN_LIES = "her rate of turn contradicts the camera; flying without it"


class Filter:
    """An error-state Kalman filter of the recent past. One thread at a time may use it. It can be pickled.

    Args:
        options: the filter's options, by default `EkfOptions()`.
    """

    def __init__(self, options: EkfOptions | None = None, saved: bytes | None = None) -> None:
        self.options: EkfOptions = options or EkfOptions()
        self._params = FilterParams(self.options)
        kept = CORE.ffi.NULL if saved is None else CORE.ffi.from_buffer(saved)
        made = CORE.lib.dl_filter_new(self._params.core, kept, 0 if saved is None else len(saved))
        if made == CORE.ffi.NULL:
            raise MemoryError("the filter has no memory") if saved is None else ValueError("this is no saved filter")
        self._core = CORE.ffi.gc(made, CORE.lib.dl_filter_free)
        self._answers: dict[MonoNs, FilterAnswer | None] = {}

    def save(self) -> bytes:
        """Return all that the filter remembers, for `Filter(options, saved)` on the same kind of machine."""
        n = CORE.lib.dl_filter_save(self._core, CORE.ffi.NULL, 0)
        made = bytearray(n)
        CORE.lib.dl_filter_save(self._core, CORE.ffi.from_buffer(made), n)
        return bytes(made)

    def __reduce__(self) -> tuple[type[Filter], tuple[EkfOptions, bytes]]:
        return type(self), (self.options, self.save())

    def put(self, events: Sequence[Event], *, wanted: bool = True) -> list[FusionResult]:
        """Process samples and sightings in the order in which they were received; they may be out of sequence.

        Returns:
            The result of each event, if `wanted`. Its verdict is FUSED; GATED (implausible, or nothing to compare it with yet);
            LOW_CONFIDENCE (a sighting with less than `min_confidence`); TOO_OLD (before the history); TOO_NEW (measured after
            every time of reception so far); SINGULAR; or NO_ATTITUDE (no sample has shown which way is down yet). A measurement
            that was compared with a prediction has its innovation, the innovation's covariance, NIS and test ratio, whatever the
            verdict.

        Raises:
            TypeError: an event is not a measurement (a frame, for example).
        """
        if not events:
            return []
        records = CORE.ffi.from_buffer(_EVENTS, b"".join([packed(event) for event in events]))
        outcomes, pointer = CORE.room("dl_outcome", len(events))
        changed = CORE.lib.dl_filter_put(self._core, len(events), records, pointer)
        if changed < 0:
            raise MemoryError("the filter has no memory")
        self._answers = {at: answer for at, answer in self._answers.items() if at < changed}
        if not wanted:
            return []
        outcomes.setflags(write=False)
        innovations, covariances = outcomes["innov"], outcomes["S"]
        return [
            _result(event, pointer[i], innovations[i], covariances[i])
            if pointer[i].m
            else uncompared("ekf", event, _VERDICTS[pointer[i].verdict])
            for i, event in enumerate(events)
        ]

    def answer(self, now: MonoNs) -> FilterAnswer | None:
        """Return the estimate of an instant, propagated from the last event before it.

        None before the first attitude, and of an instant before the history.
        """
        if now not in self._answers:
            if len(self._answers) >= _ANSWERS_KEPT:
                self._answers.clear()
            made, pointer = CORE.room("dl_answer", 1)
            known = CORE.lib.dl_filter_answer(self._core, now, pointer)
            self._answers[now] = FilterAnswer(made, pointer[0], now, self.options) if known else None
        return self._answers[now]

    def at(self, now: MonoNs) -> RelativeState | None:
        """Return the estimate of the pad at an instant, or None if no pad is tracked."""
        answer = self.answer(now)
        return None if answer is None else answer.pad

    def motion(self, now: MonoNs) -> tuple[BodyMotion | None, DeckMotion | None]:
        """Return the motion of body and deck at an instant; each is None while it is not known."""
        answer = self.answer(now)
        return (None, None) if answer is None else (answer.body, answer.deck)

    def forecast(self, now: MonoNs, horizons_s: Sequence[float] | F64) -> Forecast | None:
        """Return the forecast of the deck at `now` plus each of the horizons; None if nothing shows its motion.

        Without a pad, but with the reports of a ship's motion sensor, the pad's place in it is unknown to some hundred metres.

        Args:
            now: the instant from which the horizons count.
            horizons_s: (H,) s, each 0 or more.

        Raises:
            ValueError: a horizon that is negative or not finite.
        """
        h = np.array(horizons_s, dtype=float).ravel()
        if not all(0.0 <= x < math.inf for x in h.tolist()):
            raise ValueError(f"horizons must be seconds of 0 or more, got {horizons_s!r}")
        made, pointer = CORE.room("dl_deck_ahead", h.size)
        known = CORE.lib.dl_filter_forecast(self._core, now, h.size, CORE.array("double", h), pointer)
        return Forecast.of(now, h, made) if known else None


def _result(event: Event, outcome: Any, innov: F64, S: F64) -> FusionResult:
    """Return the result of a measurement that was compared with a prediction."""
    source, stamp, m = source_of(event), event.stamp, outcome.m
    cov = S[: m * m].reshape(m, m) if outcome.has_S else None
    components = _components(source, outcome.axes, m)
    nis, ratio = outcome.nis, outcome.nis / outcome.nis_max
    at, received_at = stamp.measured_at, stamp.received_at
    return FusionResult("ekf", source, _VERDICTS[outcome.verdict], at, received_at, innov[:m], cov, components, nis, ratio)


@cache
def _components(source: Source, axes: int, m: int) -> tuple[str, ...]:
    """Return the names of the components of an innovation; `axes` are the bits of those of a velocity or a vessel's report."""
    if not axes:
        return components_of(source, m)
    return tuple(name for i, name in enumerate(COMPONENTS[source]) if axes >> i & 1)


class FilterAnswer:
    """The pad, the body's motion and the deck's motion at one instant; each is put together when it is first requested.

    Args:
        made: the core's `dl_answer`, (1,). No later event changes it.
        core: the same as C sees it.
    """

    def __init__(self, made: NDArray[Any], core: Any, now: MonoNs, options: EkfOptions) -> None:
        # Nobody can write to it any more, so that what is taken from it needs no copy.
        for array in (np.asarray(made.base), made):
            array.setflags(write=False)
        self._answer, self._core, self._now, self._options = made[0, ...], core, now, options

    @cached_property
    def pad(self) -> RelativeState | None:
        """The estimate of the pad; None if no pad is tracked."""
        if not self._core.has_pad:
            return None
        cov = self._matrix("cov", 7)
        yaw: float | None = wrap_pi(self._core.yaw)
        if not self._core.heading_known:
            yaw = None
            cov = cov.copy()
            cov[6, :] = cov[:, 6] = 0.0
            cov[6, 6] = UNKNOWN_YAW_VAR
        fits = self._core.nis_mean < _CONSISTENT_NIS and self._core.agreed >= 3
        return RelativeState(
            at=self._now,
            path="ekf",
            d_body_pad_level=self._answer["d"],
            v_pad_level=self._answer["v"],
            yaw_rad=yaw,
            cov=cov,
            sighted=MonoNs(self._core.sighted),
            consistent=fits and self._confirmed(cov, self._options),
            adrift=bool(self._core.adrift),
            lost=(_TURN_LIES,) if self._core.turn_left_out else (),
            steers=bool(self._core.steers),
            details=Details(lambda: _figures(self._answer)),
        )

    @cached_property
    def body(self) -> BodyMotion | None:
        """The body's motion by the newest IMU sample; None while there is none or no attitude was reported."""
        if not self._core.has_body:
            return None
        return BodyMotion(
            self._now,
            self._core.heading,
            self._answer["a_body"],
            self._matrix("cov_a_body", 3),
            self._answer["w_body"],
            Rotation(self._matrix("levelled_by", 3)),
            self._matrix("cov_levelled_by", 3),
        )

    @property
    def lens(self) -> tuple[F64, F64]:
        """The error of the lens' place in the camera's file, true minus the file's, and its standard deviations, (3,) m each.

        Axes are those of `body`; the place is taken as exact unless `EkfOptions.sigma_lever_m` is positive.
        """
        return self._answer["x"][CAMERA_LEVER], np.sqrt(np.maximum(self._answer["var"][CAMERA_LEVER], 0.0))

    @property
    def carried_down_m(self) -> float:
        """The body's place by the IMU alone, m below where it began."""
        return float(self._core.carried_down_m)

    @cached_property
    def deck(self) -> DeckMotion | None:
        """The deck's motion by the oscillators of the main state (docs/estimator.md, section "Waves").

        None without a pad and without a ship's motion sensor that reports; with that one alone it is her motion on the waves.
        The covariance is the one of at most `EkfOptions.tick_s` before.
        """
        if not self._core.has_deck:
            return None
        roll, pitch, roll_rate, pitch_rate = self._answer["tilt"].tolist()
        return DeckMotion(
            self._now,
            self._answer["v_deck"],
            self._answer["a_deck"],
            self._matrix("cov_deck", 6),
            roll,
            pitch,
            roll_rate,
            pitch_rate,
            self._matrix("cov_tilt", 4),
        )

    def _confirmed(self, cov: F64, o: EkfOptions) -> bool:
        """Return whether a recent aiding measurement confirms the estimate and its position is certain enough to use.

        Either a sighting or a fused velocity confirms it: both bound the drift of the position.
        """
        newest = max(self._core.sighted, self._core.velocity_fused)
        var_max = float(max(cov.diagonal()[:3].tolist()))
        return (self._now - newest) * 1e-9 <= o.confirm_s and var_max <= o.consistent_sigma_m**2

    def _matrix(self, name: str, n: int) -> F64:
        return self._answer[name].reshape(n, n)


_AXES = "xyz"
_CHANNELS = ("north", "east", "down", "roll", "pitch")
_NAMES = (
    "nis_mean", "probability_moving", "velocity_scale", "camera_delay_s", "baro_offset_m", "range_offset_m",
    "v_vessel_north_m_s", "v_vessel_east_m_s", "turn_rate_rad_s", "sigma_velocity_scale", "sigma_camera_delay_s",
    *(f"sigma_mount_{k}_rad" for k in _AXES), *(f"mount_{k}_rad" for k in _AXES),
    *(f"gyro_bias_{k}_rad_s" for k in _AXES), *(f"accel_bias_{k}_m_s2" for k in _AXES),
    *(f"period_{k}_s" for k in _CHANNELS), *(f"damping_{k}" for k in _CHANNELS), *(f"swing_{k}" for k in _CHANNELS),
)  # fmt: skip
_PLAIN = np.r_[VEL_SCALE, CAMERA_DELAY, BARO_OFFSET, RANGE_OFFSET, VESSEL_VEL, TURN_RATE]
_SURE = np.r_[VEL_SCALE, CAMERA_DELAY, CAMERA_MOUNT]


def _figures(answer: NDArray[Any]) -> tuple[tuple[str, float], ...]:
    """Return the figures for the records."""
    x, var = answer["x"], answer["var"]
    (nn, ee), ne = var[VESSEL_VEL].tolist(), answer["cov_vessel"].item()
    evidence = log_evidence_of_rest(answer["rest"].item())
    moving = probability_of_motion(evidence, x[VESSEL_VEL].tolist(), (nn, ne, ee))
    values = [answer["nis_mean"].item(), moving, *x[_PLAIN].tolist()]
    values += np.sqrt(np.maximum(var[_SURE], 0.0)).tolist()
    values += [*x[CAMERA_MOUNT].tolist(), *x[GYRO_BIAS].tolist(), *x[ACCEL_BIAS].tolist()]
    values += [*(math.tau / answer["wave_w"]).tolist(), *answer["wave_zeta"].tolist(), *answer["wave_sigma"].tolist()]
    return tuple(zip(_NAMES, values, strict=True))
