"""What the filter says of one instant, as the native core wrote it (estimator/core/filter/answer.c)."""

import math
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.estimates import UNKNOWN_YAW_VAR, Details, RelativeState
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.time import MonoNs
from estimator.core.library import CORE
from estimator.ekf import gate
from estimator.ekf.forecast import probability_of_motion
from estimator.ekf.options import EkfOptions
from estimator.ekf.packed_belief import PackedBelief
from estimator.ekf.params import FilterParams
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


class FilterAnswer:
    """The pad, the body's motion and the deck's motion at one instant; each is put together when it is first asked for.

    Attributes:
        before: the last belief before the instant.
        params: the parameters by which it was propagated.
    """

    def __init__(self, before: PackedBelief, now: MonoNs, params: FilterParams) -> None:
        self.before, self.params = before, params
        self._now, self._options, self._evidence_of_rest = now, params.options, before.sea.log_evidence_of_rest
        made, pointer = CORE.room("dl_answer", 1)
        CORE.lib.dl_filter_answer(params.core, now, before.whole, pointer)
        self._answer = made[0, ...]
        self._answer.setflags(write=False)

    @cached_property
    def pad(self) -> RelativeState | None:
        """The estimate of the pad; None if no pad is tracked."""
        if not self._number("has_pad"):
            return None
        cov = self._matrix("cov", 7)
        yaw: float | None = wrap_pi(self._number("yaw"))
        if not self._number("heading_known"):
            yaw = None
            cov = cov.copy()
            cov[6, :] = cov[:, 6] = 0.0
            cov[6, 6] = UNKNOWN_YAW_VAR
        fits = gate.consistent(self._number("nis_mean")) and self._number("agreed") >= 3
        return RelativeState(
            at=self._now,
            path="ekf",
            d_body_pad_level=self._vector("d"),
            v_pad_level=self._vector("v"),
            yaw_rad=yaw,
            cov=cov,
            sighted=MonoNs(self._number("sighted")),
            consistent=fits and self._confirmed(cov, self._options),
            details=Details(_figures(self._answer, self._evidence_of_rest)),
        )

    @cached_property
    def body(self) -> BodyMotion | None:
        """The body's motion by the newest IMU sample; None while there is none or no attitude was reported."""
        if not self._number("has_body"):
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
        if not self._number("has_pad"):
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
        newest = max(self._number("sighted"), self._number("velocity_fused"))
        var_max = float(max(cov.diagonal()[:3].tolist()))
        return (self._now - newest) * 1e-9 <= o.confirm_s and var_max <= o.consistent_sigma_m**2

    def _number(self, name: str) -> Any:
        return self._answer[name].item()

    def _vector(self, name: str) -> F64:
        return self._answer[name]

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


def _figures(answer: NDArray[Any], evidence_of_rest: float) -> Callable[[], tuple[tuple[str, float], ...]]:
    """Return what puts the figures for the records together."""

    def figures() -> tuple[tuple[str, float], ...]:
        x, var = answer["x"], answer["var"]
        (nn, ee), ne = var[VESSEL_VEL].tolist(), answer["cov_vessel"].item()
        moving = probability_of_motion(evidence_of_rest, x[VESSEL_VEL].tolist(), (nn, ne, ee))
        values = [answer["nis_mean"].item(), moving, *x[_PLAIN].tolist()]
        values += np.sqrt(np.maximum(var[_SURE], 0.0)).tolist()
        values += [*x[CAMERA_MOUNT].tolist(), *x[GYRO_BIAS].tolist(), *x[ACCEL_BIAS].tolist()]
        values += [*(math.tau / answer["wave_w"]).tolist(), *answer["wave_zeta"].tolist(), *answer["wave_sigma"].tolist()]
        return tuple(zip(_NAMES, values, strict=True))

    return figures
