"""What the filter says of one instant, as the native core wrote it (estimator/core/filter/answer.c)."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property

import numpy as np

from estimator.contracts.estimates import UNKNOWN_YAW_VAR, Details, RelativeState
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.time import MonoNs
from estimator.core.interface import places_of, size_of
from estimator.core.library import CORE, start_of
from estimator.ekf import gate
from estimator.ekf.forecast import probability_of_motion
from estimator.ekf.motion import ProcessNoise
from estimator.ekf.options import EkfOptions
from estimator.ekf.packed_belief import PackedBelief
from estimator.ekf.state import (
    ACCEL_BIAS,
    BARO_OFFSET,
    CAMERA_DELAY,
    CAMERA_MOUNT,
    GYRO_BIAS,
    RANGE_OFFSET,
    TURN_RATE,
    VEL_SCALE,
    VESSEL_VEL,
)

_ANSWER = CORE.function("filter_answer")
_PLACES, _SIZE = places_of("answer"), size_of("answer")
_INTEGERS = slice(_PLACES["has_pad"].start, _PLACES["heading_known"].stop)


class FilterAnswer:
    """The pad, the body's motion and the deck's motion at one instant; each is put together when it is first asked for.

    Attributes:
        before: the last belief before the instant.
        noise: the process noise by which it was propagated.
    """

    def __init__(self, before: PackedBelief, now: MonoNs, noise: ProcessNoise) -> None:
        self.before, self.noise = before, noise
        self._now, self._options, self._evidence_of_rest = now, noise.options, before.sea.log_evidence_of_rest
        self._words = np.empty(_SIZE)
        _ANSWER(noise.packed_address, now, before.numbers.address, before.P.address, start_of(self._words))
        self._words.setflags(write=False)
        integers = self._words[_INTEGERS].view(np.int64).tolist()
        self._has_pad, self._has_body, self._sighted, self._agreed, self._velocity_fused, self._heading_known = integers

    @cached_property
    def pad(self) -> RelativeState | None:
        """The estimate of the pad; None if no pad is tracked."""
        if not self._has_pad:
            return None
        cov = self._matrix("cov", 7)
        yaw: float | None = wrap_pi(self._number("yaw"))
        if not self._heading_known:
            yaw = None
            cov = cov.copy()
            cov[6, :] = cov[:, 6] = 0.0
            cov[6, 6] = UNKNOWN_YAW_VAR
        fits = gate.consistent(self._number("nis_mean")) and self._agreed >= 3
        return RelativeState(
            at=self._now,
            path="ekf",
            d_body_pad_level=self._vector("d"),
            v_pad_level=self._vector("v"),
            yaw_rad=yaw,
            cov=cov,
            sighted=MonoNs(self._sighted),
            consistent=fits and self._confirmed(cov, self._options),
            details=Details(_figures(self._words, self._evidence_of_rest)),
        )

    @cached_property
    def body(self) -> BodyMotion | None:
        """The body's motion by the newest IMU sample; None while there is none or no attitude was reported."""
        if not self._has_body:
            return None
        return BodyMotion(
            self._now,
            self._number("heading"),
            self._vector("a_body"),
            self._matrix("cov_a_body", 3),
            self._vector("w_body"),
            Rotation(self._matrix("levelled_by", 3)),
            self._matrix("cov_levelled_by", 3),
        )

    @cached_property
    def deck(self) -> DeckMotion | None:
        """The deck's motion by the oscillators of the main state (docs/estimator.md, section "Waves"); None without a pad.

        The covariance is the one of at most `EkfOptions.tick_s` before.
        """
        if not self._has_pad:
            return None
        roll, pitch, roll_rate, pitch_rate = self._vector("tilt").tolist()
        return DeckMotion(
            self._now,
            self._vector("v_deck"),
            self._vector("a_deck"),
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
        newest = max(self._sighted, self._velocity_fused)
        var_max = float(max(cov.diagonal()[:3].tolist()))
        return (self._now - newest) * 1e-9 <= o.confirm_s and var_max <= o.consistent_sigma_m**2

    def _number(self, name: str) -> float:
        return self._words.item(_PLACES[name].start)

    def _vector(self, name: str) -> F64:
        return self._words[_PLACES[name]]

    def _matrix(self, name: str, n: int) -> F64:
        return self._words[_PLACES[name]].reshape(n, n)


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
_SEA = slice(_PLACES["wave_zeta"].start, _PLACES["wave_sigma"].stop)
_SURE = np.r_[VEL_SCALE, CAMERA_DELAY, CAMERA_MOUNT]


def _figures(words: F64, evidence_of_rest: float) -> Callable[[], tuple[tuple[str, float], ...]]:
    """Return what puts the figures for the records together."""

    def figures() -> tuple[tuple[str, float], ...]:
        x, var = words[_PLACES["x"]], words[_PLACES["var"]]
        (nn, ee), ne = var[VESSEL_VEL].tolist(), words.item(_PLACES["cov_vessel"].start)
        nis_mean = words.item(_PLACES["nis_mean"].start)
        values = [nis_mean, probability_of_motion(evidence_of_rest, x[VESSEL_VEL].tolist(), (nn, ne, ee)), *x[_PLAIN].tolist()]
        values += np.sqrt(np.maximum(var[_SURE], 0.0)).tolist()
        values += [*x[CAMERA_MOUNT].tolist(), *x[GYRO_BIAS].tolist(), *x[ACCEL_BIAS].tolist()]
        values += [*(math.tau / words[_PLACES["wave_w"]]).tolist(), *words[_SEA].tolist()]
        return tuple(zip(_NAMES, values, strict=True))

    return figures
