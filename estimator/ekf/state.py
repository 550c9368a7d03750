"""The filter's state at one instant, and the index of each quantity in its vectors. Derivation: docs/estimator.md."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from estimator.contracts.geometry import F64
from estimator.contracts.motion import G_M_S2
from estimator.core import abi
from estimator.core.library import CORE
from estimator.ekf.deck_motion_bank import DeckMotionBank
from estimator.ekf.options import EkfOptions
from estimator.ekf.so3 import Vec3

_FIRST = CORE.names("filter_state")


def _part(name: str) -> slice:
    first = _FIRST[f"DL_{name}"]
    return slice(first, min(other for other in _FIRST.values() if other > first))


N = abi.DL_N
"""Number of states."""
G_NED = np.array([0.0, 0.0, G_M_S2])
G_NED.setflags(write=False)

ATT_ERR = _part("ATT_ERR")
"""Attitude error, rad, in `body`: `R_true = R @ exp(x[ATT_ERR])`. `Belief.R` is the nominal, so `x[ATT_ERR]` is always zero."""
ATT_AXES = range(N)[ATT_ERR]
"""Indices of the components of `ATT_ERR`."""
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
LOST_VAR_M2 = 1e4
"""Variance of the pad's relative position before the first sighting, per axis."""

ATTITUDE, VELOCITY, RANGE, HEIGHT = range(4)
"""Kinds of aiding that are averaged before they are fused."""
SAMPLE_COLUMNS = (
    [*ATT_AXES, *ATT_BIAS],
    [*ATT_AXES, *VEL_AXES, *range(N)[VESSEL_VEL], *DECK_RATE[:3], VEL_SCALE],
    [*ATT_AXES, *POS_AXES, DECK_DISP[3], DECK_TRIM[0], DECK_DISP[4], DECK_TRIM[1], PAD_YAW, RANGE_OFFSET],
    [POS_DOWN, DECK_DISP[2], BARO_OFFSET],
)
"""The states on which each kind of aiding depends, in the order of the core's Jacobians."""


NO_VEC3: Vec3 = (0.0, 0.0, 0.0)


class Gathered(NamedTuple):
    """The samples of one kind of aiding that wait to be fused together."""

    n: int
    since: int
    """Instant of the first sample, ns."""
    axes: tuple[int, ...]
    """The components of a velocity that were measured."""
    deck_weight: float
    """Weight of the hypothesis that the velocity is relative to the deck: 0 over the ground, 1 over the deck."""
    H: F64
    """(m, N) Jacobian at `since`."""
    ambiguity: F64
    """(m, m) covariance that the uncertainty of `deck_weight` adds to the noise."""
    spread: F64
    """(m, m) covariance of the prediction at `since`, including `ambiguity`."""
    innov: tuple[float, ...]
    """(m,) sum of the innovations."""
    R: F64
    """(m, m) sum of the samples' covariances."""


class Aid(NamedTuple):
    """The state of one kind of aiding."""

    gathered: Gathered | None = None
    fused: int = -1
    """Instant of the last fusion, ns; -1 if there was none."""
    refused: int = -1
    """Instant of the first sample in the current rejection streak, ns; -1 if there is none."""


class RejectionStreak(NamedTuple):
    """Consecutive rejected sightings that agree with one another."""

    n: int = 0
    since: int = 0
    last: int = 0
    offset_ned: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Pad position of the newest sighting minus the predicted one, m, in ned."""
    var_m2: float = 0.0


class InnovationExcesses(NamedTuple):
    """Excess of the newest sightings' squared innovations over their largest expected value, oldest first."""

    t: tuple[int, ...] = ()
    """Instants of the sightings, ns."""
    values: tuple[tuple[float, ...], ...] = ()
    """Excess of each sighting along north, east, down, m^2, and how likely the ship accelerates north, east and in heading
    (`estimator/core/filter/deck_jolt.h`)."""


class Belief(NamedTuple):
    """The state at `t`. Its values are never written to: each step makes a new one.

    `x` and `P` hold at `t_cov`. `dv`, `dp`, `turned` and `coast_s` accumulate the IMU samples since then and enter with the next
    `motion.propagate_covariance`.
    """

    t: int
    R: F64
    """(3, 3) R_ned_body at `t`."""
    x: F64
    """(N,) state."""
    P: F64
    """(N, N) covariance of the error state."""
    t_cov: int
    R_cov: F64
    """`R` at `t_cov`."""
    dv: Vec3
    """(3,) integral of the specific force in ned since `t_cov`, m/s."""
    dp: Vec3
    """(3,) second integral of the specific force in ned since `t_cov`, m."""
    turned: F64
    """(3, 3) integral of `R` since `t_cov`, s."""
    coast_s: float
    """Time since `t_cov` without an IMU, s."""
    t_imu: int
    """Instant of the newest IMU sample, ns; -1 if there is none."""
    w: Vec3
    """(3,) rate as the gyro measured it, rad/s."""
    w_smooth: Vec3
    """(3,) gyro rate after a first-order low-pass, rad/s: as far as the newest is from it, a stamp's error misses the rate."""
    f: Vec3
    """(3,) specific force as the accelerometer measured it, m/s^2."""
    levelled_by: F64 | None
    """(3, 3) R_ned_body of the vehicle's own attitude, propagated by the gyro; None before the first attitude sample."""
    cov_levelled_by: F64
    """(3, 3) covariance that the attitude sample reported, rad^2."""
    heading_is_given: bool
    """True if north comes from an attitude sample. If not, north is the direction in which the body first pointed."""
    ins_p: F64
    """(3,) position of the body by the IMU alone, m. The deck motion bank learns the sea from it."""
    ins_v: F64
    ins_var_m2_s2: float
    """Variance, (m/s)^2, that `ins_v` gained beyond the IMU's noise since the deck motion bank last received a sighting."""
    jolt_var_m2_s2: float
    """Variance since `t_cov`, (m/s)^2, from accelerometer samples beyond what the vehicle can do."""
    jolt_var_rad2: float
    """Variance since `t_cov`, rad^2, from gyro samples beyond what the vehicle can do."""
    aids: tuple[Aid, ...]
    """One entry for each kind of aiding."""
    over_pad: float
    """Log-odds that the velocity sensor sees the pad's deck and not the ground."""
    t_velocity: int
    """Instant of the newest velocity sample, ns; -1 if there is none."""
    sea: DeckMotionBank
    rejections: RejectionStreak
    sighted: int
    """Instant of measurement of the newest fused sighting, ns; -1 if there is none or it was forgotten."""
    agreed: int
    """Number of sightings fused since the belief was last initialized or reset."""
    nis_mean: float
    """Recent mean of the sightings' NIS over their degrees of freedom; rejected sightings count."""
    nis_claimed: float
    """The same by what sightings claim to the last tenth of a millimetre, for how much less than that they are off."""
    excesses: InnovationExcesses
    """Excess of the last sightings' errors over what the filter claimed."""
    heading_known: bool
    """True if a sighting or a vessel report has given the heading of the pad's arrow."""
    heading_held_s: float
    """Time for which sightings have agreed with the heading minus the time for which they have contradicted it, s."""
    heading_seen: int
    """Instant of the newest sighting that measured a heading, ns; -1 if there is none."""
    steered: int
    """Instant of the newest sighting that showed a manoeuvre of the ship, ns; -1 if there is none."""
    swung: int
    """Instant of the newest sighting that showed a hard turn of the ship, ns; -1 if there is none."""
    vessel_before: F64
    """The vessel's velocity before her newest manoeuvre in the frame of `ins_v`, (2,) m/s north and east."""

    def changed(self, **fields: Any) -> Belief:
        """Return the belief with these fields replaced: `_replace` in a third of its time, for what every sample does."""
        values = list(self)
        for name, value in fields.items():
            values[_FIELD[name]] = value
        return Belief._make(values)


_FIELD = {name: i for i, name in enumerate(Belief._fields)}


def waves_unknown(sea: DeckMotionBank) -> F64:
    """Return the (5, 4, 4) covariance of the oscillators while only their amplitude is known."""
    return np.asarray((sea.sigma**2)[:, None, None] * sea.at_rest)


def initial(options: EkfOptions, t: int, R: F64, sigma_tilt_rad: float, sigma_heading_rad: float, sea: DeckMotionBank) -> Belief:
    """Return a belief that knows an attitude and nothing else."""
    x = np.zeros(N)
    x[VEL_SCALE] = options.velocity_scale
    P = np.zeros((N, N))
    down = R.T[:, 2]
    P[ATT_ERR, ATT_ERR] = sigma_tilt_rad**2 * (np.eye(3) - np.outer(down, down)) + sigma_heading_rad**2 * np.outer(down, down)
    var = np.zeros(N)
    var[POS_REL] = LOST_VAR_M2
    var[VEL] = options.sigma_initial_velocity_m_s**2
    var[GYRO_BIAS] = options.sigma_gyro_bias_rad_s**2
    var[ACCEL_BIAS] = options.sigma_accel_bias_m_s2**2, options.sigma_accel_bias_m_s2**2, options.sigma_accel_bias_down_m_s2**2
    var[VEL_SCALE] = options.sigma_velocity_scale**2
    var[VESSEL_VEL] = options.sigma_vessel_velocity_m_s**2
    var[PAD_YAW] = math.pi**2 / 3.0
    var[YAW_RATE] = options.sigma_wave_yaw_rate_rad_s**2
    var[WAVE_YAW] = (options.sigma_wave_yaw_rate_rad_s * options.wave_yaw_period_s / math.tau) ** 2
    var[TURN_RATE] = options.sigma_turn_rate_rad_s**2
    var[DECK_TRIM] = options.sigma_list_rad**2
    var[CAMERA_DELAY] = options.sigma_delay_s**2
    var[CAMERA_MOUNT] = options.sigma_mount_rad**2
    var[BARO_OFFSET] = options.sigma_baro_offset_m**2
    var[ATT_BIAS] = options.sigma_attitude_bias_rad**2
    var[RANGE_OFFSET] = options.sigma_range_offset_m**2
    P[np.diag_indices(N)] += var
    P[WAVES[:, :, None], WAVES[:, None, :]] = waves_unknown(sea)
    z3 = np.zeros(3)
    return Belief(
        t=t, R=R, x=x, P=P, t_cov=t, R_cov=R, dv=NO_VEC3, dp=NO_VEC3, turned=np.zeros((3, 3)), coast_s=0.0,
        t_imu=-1, w=NO_VEC3, w_smooth=NO_VEC3, f=NO_VEC3, levelled_by=None, cov_levelled_by=np.zeros((3, 3)),
        heading_is_given=False, ins_p=z3, ins_v=z3, ins_var_m2_s2=0.0, jolt_var_m2_s2=0.0, jolt_var_rad2=0.0,
        aids=(Aid(),) * 4, over_pad=0.0, t_velocity=-1, sea=sea, rejections=RejectionStreak(),
        sighted=-1, agreed=0, nis_mean=1.0, nis_claimed=1.0, excesses=InnovationExcesses(), heading_known=False,
        heading_held_s=0.0, heading_seen=-1, steered=-1, swung=-1, vessel_before=np.zeros(2),
    )  # fmt: skip
