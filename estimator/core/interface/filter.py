"""What C and Python share of the filter: its state, its structures, its functions."""

from __future__ import annotations

import itertools

from .describe import Field, Function, doubles, integers

STATE = {
    "ATT_ERR": 3, "POS_REL": 3, "VEL": 3, "GYRO_BIAS": 3, "ACCEL_BIAS": 3, "VEL_SCALE": 1, "VESSEL_VEL": 2, "WAVES": 20,
    "PAD_YAW": 1, "YAW_RATE": 1, "DECK_TRIM": 2, "CAMERA_DELAY": 1, "CAMERA_MOUNT": 3, "BARO_OFFSET": 1, "ATT_BIAS": 2,
    "RANGE_OFFSET": 1, "WAVE_YAW": 1, "TURN_RATE": 1, "SWAY_PER_HEAVE": 2,
}  # fmt: skip
"""The parts of the filter's state and their sizes, in order. `estimator.ekf.state` says what they are."""
N = sum(STATE.values())
STATE_AT = dict(zip(STATE, itertools.accumulate(STATE.values(), initial=0), strict=False))
"""Index of the first component of each part."""

ORDER_MAX = N
"""The largest number of states that a linear-algebra function takes."""
ROWS_MAX = 9
"""The largest number of measured numbers that a linear-algebra function takes."""
COLUMNS_MAX = 14
"""The largest number of states on which one kind of aiding depends."""
KINDS = 4
"""Number of kinds of aiding."""
DIRECTIONS = 5
"""Directions in which a deck moves on waves: north, east, down, roll, pitch."""
OSCILLATORS = 28
"""Number of different oscillators in the bank of a direction: the one at rest, then the others."""
MEMBER_SIZES = 5
"""Number of sizes in which each oscillator but the one at rest comes; they lie side by side."""
MEMBERS = 1 + (OSCILLATORS - 1) * MEMBER_SIZES
"""Number of oscillators of some size that the bank of each direction compares."""
WAVE_STATES = 4
"""Number of states of a wave: displacement, rate, force, its rate."""
WAVE_PAIRS = WAVE_STATES * (WAVE_STATES + 1) // 2
"""Numbers of a wave's covariance: its upper triangle in rows."""
MEMBER_STATES = 7
"""Number of states of one: displacement, rate, force, its rate; offset of the IMU's carrying on, its rate, acceleration."""
MEMBER_PAIRS = MEMBER_STATES * (MEMBER_STATES + 1) // 2
"""Numbers of a member's covariance, which is symmetric: its upper triangle in rows."""
SKILL_HORIZONS = 3
"""Number of horizons at which past forecasts are compared with what happened."""
EXCESSES_MAX = 24
"""The largest number of recent sightings whose innovations are compared with what the filter claimed."""
ISSUED_MAX = 9
"""The largest number of forecasts whose comparison is not over."""

CONSTANTS = {
    "N": N, **STATE_AT, "ORDER_MAX": ORDER_MAX, "ROWS_MAX": ROWS_MAX, "COLUMNS_MAX": COLUMNS_MAX, "KINDS": KINDS,
    "DIRECTIONS": DIRECTIONS, "OSCILLATORS": OSCILLATORS, "MEMBER_SIZES": MEMBER_SIZES, "WAVE_PAIRS": WAVE_PAIRS,
    "MEMBERS": MEMBERS, "MEMBER_STATES": MEMBER_STATES, "MEMBER_PAIRS": MEMBER_PAIRS,
    "SKILL_HORIZONS": SKILL_HORIZONS, "ISSUED_MAX": ISSUED_MAX,
    "EXCESSES_MAX": EXCESSES_MAX,
    "ATTITUDE": 0, "VELOCITY": 1, "RANGE": 2, "HEIGHT": 3, "IMU": 4, "VESSEL": 5, "SIGHTING": 6,
    "FUSED": 0, "GATED": 1, "SINGULAR": 2, "LOW_CONFIDENCE": 3,
    "OVER_GROUND": 0, "OVER_PAD": 1, "OVER_EITHER": 2,
    "STATE_ALONE": 0, "WITH_COVARIANCE": 1, "WITH_AIDING": 2,
}  # fmt: skip
"""Numbers by their names in the header: the state's indices, kinds of samples (the first are those of aiding), verdicts, surfaces
below a velocity sensor, and how much `filter_propagate` does."""

_WAVES = SKILL_HORIZONS * DIRECTIONS * 2
STRUCTS: dict[str, tuple[Field, ...]] = {
    "bank_members": doubles(w=MEMBERS, zeta=MEMBERS, log_zeta=MEMBERS, log_prior=MEMBERS, sigma=DIRECTIONS * MEMBERS),
    "issued_forecast": (*integers("t"), *doubles(waves=_WAVES)),
    "forecast_skill": (
        *integers("issued_n"),
        Field("issued", "issued_forecast", ISSUED_MAX),
        *doubles(n=SKILL_HORIZONS, product=_WAVES, square=_WAVES, came=_WAVES),
    ),
    "sea": (
        *integers("t"),
        *doubles(w_rad_s=DIRECTIONS, zeta=DIRECTIONS, sigma=DIRECTIONS),
        Field("skill", "forecast_skill"),
        *doubles(
            log_weight=DIRECTIONS * MEMBERS, weight=DIRECTIONS * MEMBERS,
            x=DIRECTIONS * MEMBER_STATES * MEMBERS, P=DIRECTIONS * MEMBER_PAIRS * MEMBERS,
        ),
    ),
    "filter_params": (
        *integers("hold_ns", "velocity_is_over", "reopen_count", "sighting_has_attitude_error"),
        *doubles(
            tick_s=1, forget_s=1, aiding_period_s=1, accel_step_m_s2=1, gyro_step_rad_s=1, deck_radius_m=1, not_measured_var=1,
            correlation_s=KINDS, nis_max=ROWS_MAX, psd=N, psd_accel=1, psd_coast=1, psd_coast_turn=1, wave_yaw_rad_s=1,
            sigma_wave_yaw_rate_rad_s=1, carrying_psd_accel=DIRECTIONS, carrying_psd_drift=DIRECTIONS,
            carrying_psd_tilt=DIRECTIONS, min_confidence=1, reopen_s=1, heading_memory_s=1, sigma_sway_per_heave=1,
            sigma_turn_rate_rad_s=1, pad_yaw_in_vessel_rad=1,
        ),
        Field("members", "bank_members"),
    ),
    "aid": (
        *integers("fused", "refused", "n", "since", "m", "axes"),
        *doubles(deck_weight=1, innov=3, R=9, ambiguity=9, spread=9, H=3 * COLUMNS_MAX),
    ),
    "innovation_excesses": (
        *integers("n"), Field("t", "int64_t", EXCESSES_MAX), *doubles(values=3 * EXCESSES_MAX),
    ),
    "belief": (
        *integers(
            "t", "t_cov", "t_imu", "t_velocity", "sighted", "agreed", "is_levelled", "heading_is_given",
            "rejected_n", "rejected_since", "rejected_last", "heading_known", "heading_seen",
        ),
        *doubles(
            rejected_offset_ned=3, rejected_var_m2=1,
            R=9, x=N, R_cov=9, dv=3, dp=3, turned=9, coast_s=1, w=3, w_smooth=3, f=3, levelled_by=9, cov_levelled_by=9,
            ins_p=3, ins_v=3, ins_var_m2_s2=1, jolt_var_m2_s2=1, jolt_var_rad2=1, over_pad=1,
            wave_w=5, wave_zeta=5, wave_sigma=5, nis_mean=1, heading_held_s=1,
        ),
        Field("aids", "aid", KINDS),
        Field("excesses", "innovation_excesses"),
    ),
    "event": (*integers("kind", "t"), *doubles(value=18)),
    "sighting": (
        *integers("has_yaw", "yaw_ambiguous", "has_pose6"),
        *doubles(confidence=1, sigma_s=1, d_level=3, yaw_rad=1, cov=16, pose_d_level=3, pose_R=9, pose_cov=36),
    ),
    "outcome": (*integers("verdict", "m", "axes", "has_S"), *doubles(innov=6, S=36, nis=1, nis_max=1)),
    "horizon_reach": doubles(
        row=2 * WAVE_STATES * OSCILLATORS, noise=2 * OSCILLATORS, squares=3 * WAVE_PAIRS * OSCILLATORS,
    ),
    "deck_ahead": doubles(
        d=3, cov_d=9, v_pad=3, height=1, sigma_height=1, rise=1, sigma_rise=1, roll=1, sigma_roll=1, pitch=1, sigma_pitch=1,
    ),
    "answer": (
        *integers("has_pad", "has_body", "sighted", "agreed", "velocity_fused", "heading_known"),
        *doubles(
            nis_mean=1, heading=1, d=3, v=3, yaw=1, cov=49,
            a_body=3, cov_a_body=9, w_body=3, levelled_by=9, cov_levelled_by=9,
            v_deck=3, a_deck=3, cov_deck=36, tilt=4, cov_tilt=16,
            x=N, var=N, cov_vessel=1, wave_w=DIRECTIONS, wave_zeta=DIRECTIONS, wave_sigma=DIRECTIONS,
        ),
    ),
}  # fmt: skip
"""Members mean what those of `Belief`, `Aid` and `Gathered` in
`estimator.ekf.state`, of `DeckMotionBank` and `Skill` of the same names mean; matrices are in rows, instants are in ns. In `sea`
and `bank_members`, arrays are by direction, then by state or pair of states, then by member of the bank. An `answer` has
numbers of pad and deck where it has a pad, and of the body where it has a body; `estimator.ekf.answers` says what they are. A
`horizon_reach` has, for one horizon and by oscillator, the rows of the transition to displacement and rate, their noise, and the
products of the numbers of these rows and of the first one's change. A `deck_ahead` has what `Forecast` has for one horizon."""

FUNCTIONS = (
    Function("nis_of", "int32_t", "int32_t m, const double *innov, const double *S, double *nis", "estimator/core/base/kalman.c"),
    Function(
        "kalman_predict",
        "void",
        "int32_t n, const double *P, const double *F, const double *Q, double *P_after",
        "estimator/core/base/kalman.c",
    ),
    Function(
        "kalman_correct",
        "int32_t",
        "int32_t n, int32_t m, const double *P, const double *innov, const double *H, const double *R, "
        "double *dx, double *P_after, double *S, double *nis",
        "estimator/core/base/kalman.c",
    ),
    Function(
        "remove_attitude",
        "void",
        "int32_t m, double *cov, const double *J, const double *cov_attitude",
        "estimator/core/base/symmetric.c",
    ),
    Function("bank_begin", "void", "const bank_members *m, sea *after", "estimator/core/filter/bank.c"),
    Function(
        "bank_observe",
        "void",
        "const filter_params *o, int64_t t, const double *y, const double *var, double ins_var, double reach_m, "
        "const sea *before, sea *after",
        "estimator/core/filter/bank.c",
    ),
    Function(
        "filter_run",
        "int32_t",
        "const filter_params *o, int32_t n, const event *events, const sighting *sightings, const belief *before, "
        "const double *P_before, const sea *sea_before, belief *after, double *P_after, sea *sea_after, int64_t *P_index, "
        "int64_t *sea_index, outcome *outcomes",
        "estimator/core/filter/run.c",
    ),
    Function(
        "filter_propagate",
        "int32_t",
        "const filter_params *o, int32_t what, int64_t t, const belief *before, const double *P_before, belief *after, "
        "double *P_after",
        "estimator/core/filter/run.c",
    ),
    Function(
        "filter_settle",
        "void",
        "const filter_params *o, const belief *before, belief *after, double *F, double *Q",
        "estimator/core/filter/run.c",
    ),
    Function(
        "sighting_model",
        "int32_t",
        "const belief *b, const sighting *s, const double *cov_levelled_by, double yaw_sigma, int32_t place_only, "
        "double *innov, double *H, double *R, double *by_rate",
        "estimator/core/filter/sighting.c",
    ),
    Function(
        "bank_reach",
        "void",
        "const bank_members *m, int32_t n, const double *horizons_s, horizon_reach *out",
        "estimator/core/filter/bank_ahead.c",
    ),
    Function(
        "filter_forecast",
        "int32_t",
        "const filter_params *o, int64_t t, const belief *before, const double *P_before, const sea *bank, int32_t n, "
        "const double *horizons_s, const horizon_reach *reach, deck_ahead *out",
        "estimator/core/filter/forecast.c",
    ),
    Function(
        "filter_answer",
        "void",
        "const filter_params *o, int64_t t, const belief *before, const double *P_before, answer *out",
        "estimator/core/filter/answer.c",
    ),
)
"""Functions of the filter's algebra, of the bank and of the filter."""
