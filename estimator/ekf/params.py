"""The parameters that every step of the filter needs and no step changes: its options, and the noises that follow from them.

Beside them stand the index of each quantity in the vectors of the filter's state, and the members of the bank of learned deck
motion that the core compares. Derivation: docs/estimator.md, section "Motion".

Learned deck motion is a bank of oscillators for each direction, weighted by their likelihood. The core learns and forecasts
(bank.h and bank_ahead.h in estimator/core/filter). A member models the deck's motion in one direction as a damped oscillator
driven by the rate of a second, equal one:

    x'' = -w^2 x - 2 zeta w x' + f'        f'' = -w^2 f - 2 zeta w f' + white noise

A single oscillator driven by white noise has a discontinuous acceleration, which no hull has. Driven by f instead of f' it would
have power at low frequencies, where a sea has none (docs/estimator.md). The noise intensity is such that x has the standard
deviation `sigma`. The states are [x, x', f, f'].
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.contracts.samples import UNKNOWN_VAR
from estimator.core import abi
from estimator.core.abi import DL_ROWS_MAX
from estimator.core.library import CORE
from estimator.ekf.options import EkfOptions

PERIODS_S = np.geomspace(2.2, 14.0, 9)
ZETAS = np.array([0.2, 0.35, 0.55])
SIGMAS_M = np.array([0.02, 0.055, 0.15, 0.42, 1.15])
SIGMAS_RAD = np.radians([0.25, 0.7, 2.0, 5.5, 15.0])
STATIC_PRIOR = 0.5
"""Probability, before the first sighting, that the deck stands still."""
REST_ODDS = math.log(STATIC_PRIOR / (1.0 - STATIC_PRIOR))  # The same as log odds
LOST_VAR_M2 = 1e4
"""Variance of the pad's relative position before the first sighting, per axis."""


def _grid() -> tuple[F64, F64, F64, F64]:
    period, zeta, size = (a.ravel() for a in np.meshgrid(PERIODS_S, ZETAS, np.arange(SIGMAS_M.size), indexing="ij"))
    size = size.astype(int)
    w = np.concatenate([[1.0], math.tau / period])
    sigma = np.stack([np.concatenate([[1e-7], a[size]]) for a in (*(SIGMAS_M,) * 3, *(SIGMAS_RAD,) * 2)])
    prior = np.full(w.size, (1.0 - STATIC_PRIOR) / (w.size - 1))
    prior[0] = STATIC_PRIOR
    return w, np.concatenate([[0.5], zeta]), sigma, np.log(prior)


W, ZETA, SIGMA, LOG_PRIOR = _grid()
"""(G,) rad/s, (G,), (5, G) m or rad, (G,): the members."""
CARRIED = np.array([1.0, 1.0, 1.0, 0.0, 0.0])
"""1 for directions that the IMU's errors affect, (5,); a deck's roll and pitch are measured directly."""


class Carrying(NamedTuple):
    """The errors of the position propagated by the IMU, (5,) by direction; a deck's roll and pitch are measured directly."""

    asd_accel: F64
    """Noise density of the acceleration, m/s^2/sqrt(Hz)."""
    asd_drift: F64
    """Random walk of the acceleration's error, m/s^3/sqrt(Hz)."""
    asd_tilt: F64
    """Random walk of the tilt, rad/sqrt(s), which moves the measured position by the tilt times the distance."""


def carrying(asd_accel_m_s2: float, asd_gyro_rad_s: float, asd_accel_bias_m_s3: float) -> Carrying:
    """Return the dead-reckoning errors of an IMU.

    The accelerometer's noise acts in every direction, its bias drift acts downwards, and the tilt drift times gravity acts
    sideways. A tilt that is held level drifts by the gyro's noise and by as much again from the levelling.
    """
    sideways, asd_tilt = np.array([1.0, 1.0, 0.0, 0.0, 0.0]), math.sqrt(2.0) * asd_gyro_rad_s
    return Carrying(
        asd_accel_m_s2 * CARRIED,
        9.81 * asd_tilt * sideways + np.array([0.0, 0.0, asd_accel_bias_m_s3, 0.0, 0.0]),
        asd_tilt * sideways,
    )


@lru_cache(maxsize=1)
def packed_members() -> NDArray[Any]:
    """Return the core's `dl_bank_members`."""
    members = CORE.record("dl_bank_members", w=W, zeta=ZETA, log_zeta=np.log(ZETA), log_prior=LOG_PRIOR, sigma=SIGMA)
    members.setflags(write=False)
    return members


_FIRST = CORE.names("dl_filter_state")


def _part(name: str) -> slice:
    first = _FIRST[f"DL_{name}"]
    return slice(first, min(other for other in _FIRST.values() if other > first))


N = abi.DL_N
"""Number of states."""

ATT_ERR = _part("ATT_ERR")
"""Attitude error, rad, in `body`: `R_true = R @ exp(x[ATT_ERR])`. The nominal is `R`, so `x[ATT_ERR]` is always zero."""
POS_REL = _part("POS_REL")
"""d_body_pad_ned, m."""
POS_NORTH, POS_EAST, POS_DOWN = POS_AXES = range(N)[POS_REL]
"""Indices of the components of `POS_REL`."""
POS_HORIZONTAL = slice(POS_NORTH, POS_DOWN)
"""North and east of `POS_REL`."""
VEL = _part("VEL")
"""v_body_ned, m/s over the ground."""
VEL_NORTH, VEL_EAST, VEL_DOWN = VEL_AXES = range(N)[VEL]
"""Indices of the components of `VEL`."""
GYRO_BIAS = _part("GYRO_BIAS")
"""Gyro bias, rad/s, in `body`: measured minus true."""
ACCEL_BIAS = _part("ACCEL_BIAS")
"""Accelerometer bias, m/s^2, in `body`: measured minus true."""
VEL_SCALE = abi.DL_VEL_SCALE
"""Scale of the horizontal velocity: measured over true."""
VESSEL_VEL = _part("VESSEL_VEL")
"""The vessel's steady velocity, north and east, m/s."""
VESSEL_NORTH, VESSEL_EAST = range(N)[VESSEL_VEL]
"""Indices of the components of `VESSEL_VEL`."""
WAVES = np.arange(N)[_part("WAVES")].reshape(5, 4)
"""(5, 4) indices of [displacement, rate, force, rate of the force] for the pad's motion north, east, down (m) and the deck's
roll and pitch (rad)."""
DECK_DISP, DECK_RATE = WAVES[:, 0], WAVES[:, 1]
PAD_YAW = abi.DL_PAD_YAW
"""Heading of the pad's arrow, rad clockwise from north."""
YAW_RATE = abi.DL_YAW_RATE
"""Rate of the pad's yaw on waves, rad/s; the steady turn is `TURN_RATE`."""
DECK_TRIM = np.arange(N)[_part("DECK_TRIM")]
"""Constant list and trim of the deck, rad."""
CAMERA_DELAY = abi.DL_CAMERA_DELAY
"""Camera delay, s: sightings show the world this much later than their stamps say."""
CAMERA_LEVER = _part("CAMERA_LEVER")
"""Error of the lens' place in the camera's file, m, in `body`: true minus the file's."""
CAMERA_MOUNT = _part("CAMERA_MOUNT")
"""Rotation vector, rad, in `body`: the camera is rotated by `exp(x[CAMERA_MOUNT])` from the mounting in its file."""
BARO_OFFSET = abi.DL_BARO_OFFSET
"""Height that the barometer shows minus the height over the pad's mean level, m."""
ATT_BIAS = np.arange(N)[_part("ATT_BIAS")]
"""Constant error of the vehicle's own attitude about the body's x and y axes, rad: measured minus true."""
RANGE_OFFSET = abi.DL_RANGE_OFFSET
"""Constant error of the range sensor, m: measured minus true. The sensor's position and the air temperature cause it."""
WAVE_YAW = abi.DL_WAVE_YAW
"""The vessel's yaw on waves, rad; it is a part of `PAD_YAW`."""
TURN_RATE = abi.DL_TURN_RATE
"""Steady rate at which the vessel turns, rad/s clockwise from above. Its velocity turns with it (coordinated turn)."""


NOT_MEASURED_VAR = 0.1 * UNKNOWN_VAR
"""Variance of a component of a sample from which it was not measured."""


class FilterParams:
    """The options and what is computed from them once.

    `psd` has (N,) densities of noise whose variance grows with time, `initial_var` (N,) variances before anything is known.
    """

    def __init__(self, o: EkfOptions) -> None:
        self.options = o
        q = np.zeros(N)
        q[ATT_ERR] = o.asd_gyro_rad_s**2
        q[GYRO_BIAS] = o.asd_gyro_bias_rad_s2**2
        q[ACCEL_BIAS] = o.asd_accel_bias_m_s3**2
        q[VEL_SCALE] = o.asd_velocity_scale**2
        q[VESSEL_VEL] = o.asd_vessel_velocity_m_s2**2
        q[TURN_RATE] = o.asd_turn_rate_rad_s2**2
        q[CAMERA_DELAY] = o.delay_drift_s_sqrt_s**2
        q[CAMERA_MOUNT] = o.mount_drift_rad_sqrt_s**2
        q[BARO_OFFSET] = o.asd_baro_offset_m**2
        q[RANGE_OFFSET] = o.asd_range_offset_m**2
        q[ATT_BIAS] = o.asd_attitude_bias_rad_s**2
        self.psd = q
        self.initial_var: F64 = _initial_var(o)
        self.carrying: Carrying = carrying(o.asd_accel_m_s2, o.asd_gyro_rad_s, o.asd_accel_bias_m_s3)
        self.psd_accel: float = o.asd_accel_m_s2**2
        self.psd_coast: float = o.asd_coast_m_s2**2
        self.psd_coast_turn: float = o.asd_coast_rad_s**2
        self.not_measured_var = NOT_MEASURED_VAR
        self.core: Any = CORE.array("dl_filter_params", _packed(self))
        """The core's `dl_filter_params`."""


def _initial_var(o: EkfOptions) -> F64:
    """Return the variances (N,) before any event; those of attitude and waves are left out."""
    var = np.zeros(N)
    var[POS_REL] = LOST_VAR_M2
    var[VEL] = o.sigma_initial_velocity_m_s**2
    var[GYRO_BIAS] = o.sigma_gyro_bias_rad_s**2
    var[ACCEL_BIAS] = o.sigma_accel_bias_m_s2**2, o.sigma_accel_bias_m_s2**2, o.sigma_accel_bias_down_m_s2**2
    var[VEL_SCALE] = o.sigma_velocity_scale**2
    var[VESSEL_VEL] = o.sigma_vessel_velocity_m_s**2
    var[PAD_YAW] = math.pi**2 / 3.0
    var[YAW_RATE] = o.sigma_wave_yaw_rate_rad_s**2
    var[WAVE_YAW] = (o.sigma_wave_yaw_rate_rad_s * o.wave_yaw_period_s / math.tau) ** 2
    var[TURN_RATE] = o.sigma_turn_rate_rad_s**2
    var[DECK_TRIM] = o.sigma_list_rad**2
    var[CAMERA_DELAY] = o.sigma_delay_s**2
    var[CAMERA_MOUNT] = o.sigma_mount_rad**2
    var[CAMERA_LEVER] = o.sigma_lever_m**2
    var[BARO_OFFSET] = o.sigma_baro_offset_m**2
    var[ATT_BIAS] = o.sigma_attitude_bias_rad**2
    var[RANGE_OFFSET] = o.sigma_range_offset_m**2
    return var


NIS_MAX = (15.137, 18.421, 21.108, 23.513, 25.745, 27.856, 29.878, 31.828, 33.720)
"""Limits of the gate for 1 to 9 degrees of freedom: a consistent measurement exceeds one with a probability of 1e-4."""


_SURFACES = {"auto": abi.DL_OVER_EITHER, "either": abi.DL_OVER_EITHER, "pad": abi.DL_OVER_PAD, "ground": abi.DL_OVER_GROUND}


def _packed(params: FilterParams) -> NDArray[Any]:
    """Return the core's `dl_filter_params`: each member of the header is an option, a noise, or computed here."""
    o, by = params.options, params.carrying
    computed = {
        "hold_ns": round(o.hold_s * 1e9),
        "history_ns": round(o.history_s * 1e9),
        "max_ahead_ns": round(o.max_ahead_s * 1e9),
        "leap_ns": round(o.leap_s * 1e9),
        "velocity_is_over": _SURFACES[o.velocity_is_over],
        "pad_in_vessel_m": (o.pad_forward_m, o.pad_right_m),
        "correlation_s": (o.attitude_correlation_s, o.velocity_correlation_s, o.range_correlation_s, o.baro_correlation_s),
        "nis_max": NIS_MAX[:DL_ROWS_MAX],
        "carrying_psd_accel": by.asd_accel**2,
        "carrying_psd_drift": by.asd_drift**2,
        "carrying_psd_tilt": by.asd_tilt**2,
        "wave_yaw_rad_s": 2.0 * np.pi / o.wave_yaw_period_s,
    }
    others = set(CORE.dtype("dl_filter_params").names or ()) - {"members", *computed}
    given = {name: getattr(o if hasattr(o, name) else params, name) for name in others}
    record = CORE.record("dl_filter_params", **given, **computed)
    record["members"] = packed_members()
    record.setflags(write=False)
    return record
