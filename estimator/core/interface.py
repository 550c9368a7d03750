"""The interface of the native core: one description, from which the C header is generated and Python's calls are declared.

`python -m supply.core --header` writes it as `interface.h`, which every C file includes, so the compiler holds the sources to it.
The library carries the digest of the header that it was compiled with. This file imports nothing of ours: the generator reads it
where no library is built yet.
"""

from __future__ import annotations

import itertools
import zlib
from typing import NamedTuple

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
RATIOS_MAX = 24
"""The largest number of recent sightings whose innovations are compared with what the filter claimed."""
ISSUED_MAX = 9
"""The largest number of forecasts whose comparison is not over."""
GAIN_ONE = 16384
"""Value of a factor of one on simulated light."""
SCENE_ONE = 32768
"""Value of a scene's pixel that reflects all light, and of wear that does not change it."""
CELL_PX = 8
"""Distance between the rays at which planes are met exactly, px."""
BLUR_RADIUS_MAX = 30
"""The widest blur of the simulated lens, px."""
SMEAR_MAX = 256
"""The largest number of pixels that the motion blur of a scene adds up."""
PAINTS = ("PAD_NONE", "PAD_RIM", "PAD_DISC", "PAD_ORANGE", "PAD_WHITE")
"""The paints of a pad, in the order of their shares; the first is what lies around it."""
PAD_EDGE = 255
"""Kind of a pixel that shows several paints."""
DRAWING = (
    "PAD_DISC_RADIUS", "PAD_RIM_INNER", "PAD_RING_OUTER", "PAD_RING_INNER",
    "PAD_ARROW_TIP", "PAD_ARROW_BASE", "PAD_ARROW_COS", "PAD_ARROW_SIN",
    "PAD_H_HALF_LENGTH", "PAD_H_HALF_WIDTH", "PAD_H_INNER", "PAD_BAR_HALF",
    "PAD_CLEAR_RADIUS",
)  # fmt: skip
"""The numbers of a pad's drawing, in their order: m, and the direction of the arrowhead's sides."""
STROKE_NUMBERS = 36
"""Numbers of one part of an exposure: homographies in its middle, their change during it, in the first row and in the last."""

ROTORS_MAX = 6
"""The largest number of rotors of a simulated vehicle."""
GUSTS_MAX = 100
"""The largest number of single gusts in the simulated air."""
COMMANDS_MAX = 1024
"""The largest number of steps of physics that a stick command may be under way."""
ECHOES_MAX = 64
"""The largest number of ultrasound echoes under way to the telemetry."""
FLIGHT_NOISE = 7
"""Standard normal numbers that a vehicle takes at a step: gust (3), optical flow (2), tilt (2); the air takes as many."""
SENSOR_NOISE = {"IMU_NOISE": 6, "FIELD_NOISE": 3, "PRESSURE_NOISE": 1, "HEADING_DRIFT": 1, "PRESSURE_DRIFT": 1, "ECHO_NOISE": 1}
"""The standard normal numbers that the sensors take at a step, in order."""
PHASES = ("LANDED", "TAKING_OFF", "HOVERING", "FLYING", "LANDING", "EMERGENCY")
"""What a simulated vehicle is doing."""

CONSTANTS = {
    "N": N, **STATE_AT, "ORDER_MAX": ORDER_MAX, "ROWS_MAX": ROWS_MAX, "COLUMNS_MAX": COLUMNS_MAX, "KINDS": KINDS,
    "DIRECTIONS": DIRECTIONS, "OSCILLATORS": OSCILLATORS, "MEMBER_SIZES": MEMBER_SIZES, "WAVE_PAIRS": WAVE_PAIRS,
    "MEMBERS": MEMBERS, "MEMBER_STATES": MEMBER_STATES, "MEMBER_PAIRS": MEMBER_PAIRS,
    "SKILL_HORIZONS": SKILL_HORIZONS, "ISSUED_MAX": ISSUED_MAX,
    "RATIOS_MAX": RATIOS_MAX,
    "ATTITUDE": 0, "VELOCITY": 1, "RANGE": 2, "HEIGHT": 3, "IMU": 4, "VESSEL": 5, "SIGHTING": 6,
    "FUSED": 0, "GATED": 1, "SINGULAR": 2,
    "OVER_GROUND": 0, "OVER_PAD": 1, "OVER_EITHER": 2,
    "STATE_ALONE": 0, "WITH_COVARIANCE": 1, "WITH_AIDING": 2,
    "GAIN_ONE": GAIN_ONE, "SCENE_ONE": SCENE_ONE, "CELL_PX": CELL_PX, "BLUR_RADIUS_MAX": BLUR_RADIUS_MAX, "SMEAR_MAX": SMEAR_MAX,
    "PAD_PAINTS": len(PAINTS), "PAD_EDGE": PAD_EDGE, "STROKE_NUMBERS": STROKE_NUMBERS,
    **{name: value for names in (PAINTS, DRAWING) for value, name in enumerate(names)},
    "ROTORS_MAX": ROTORS_MAX, "GUSTS_MAX": GUSTS_MAX, "COMMANDS_MAX": COMMANDS_MAX, "ECHOES_MAX": ECHOES_MAX,
    "FLIGHT_NOISE": FLIGHT_NOISE, "SENSOR_NOISE": sum(SENSOR_NOISE.values()),
    **dict(zip(SENSOR_NOISE, itertools.accumulate(SENSOR_NOISE.values(), initial=0), strict=False)),
    **{f"PHASE_{name}": value for value, name in enumerate(PHASES)},
    "TOUCHED_DECK": 1, "TOUCHED_SEA": 2,
}  # fmt: skip
"""Numbers that C and Python share, by their names in the header: the state's indices, kinds of samples (the first are those of
aiding), verdicts, surfaces below a velocity sensor, how much `filter_propagate` does; what simulated frames are made of; and the
simulated vehicle."""


class Field(NamedTuple):
    """A member of a structure: an integer, a double, another structure, or an array of one of them."""

    name: str
    type: str
    length: int = 1


def _doubles(**lengths: int) -> tuple[Field, ...]:
    return tuple(Field(name, "double", length) for name, length in lengths.items())


def _integers(*names: str) -> tuple[Field, ...]:
    return tuple(Field(name, "int64_t") for name in names)


_WAVES = SKILL_HORIZONS * DIRECTIONS * 2
STRUCTS = {
    "bank_members": _doubles(w=MEMBERS, zeta=MEMBERS, log_zeta=MEMBERS, log_prior=MEMBERS, sigma=DIRECTIONS * MEMBERS),
    "issued_forecast": (*_integers("t"), *_doubles(waves=_WAVES)),
    "forecast_skill": (
        *_integers("issued_n"),
        Field("issued", "issued_forecast", ISSUED_MAX),
        *_doubles(n=SKILL_HORIZONS, product=_WAVES, square=_WAVES),
    ),
    "sea": (
        *_integers("t"),
        *_doubles(w_rad_s=DIRECTIONS, zeta=DIRECTIONS, sigma=DIRECTIONS),
        Field("skill", "forecast_skill"),
        *_doubles(
            log_weight=DIRECTIONS * MEMBERS, weight=DIRECTIONS * MEMBERS,
            x=DIRECTIONS * MEMBER_STATES * MEMBERS, P=DIRECTIONS * MEMBER_PAIRS * MEMBERS,
        ),
    ),
    "filter_params": (
        *_integers("hold_ns", "velocity_is_over", "reopen_count", "sighting_has_attitude_error"),
        *_doubles(
            tick_s=1, forget_s=1, aiding_period_s=1, accel_step_m_s2=1, gyro_step_rad_s=1, deck_radius_m=1, not_measured_var=1,
            correlation_s=KINDS, nis_max=ROWS_MAX, psd=N, psd_accel=1, psd_coast=1, psd_coast_turn=1, wave_yaw_rad_s=1,
            sigma_wave_yaw_rate_rad_s=1, carrying_psd_accel=DIRECTIONS, carrying_psd_drift=DIRECTIONS,
            carrying_psd_tilt=DIRECTIONS, min_confidence=1, reopen_s=1, heading_memory_s=1, sigma_sway_per_heave=1,
            sigma_turn_rate_rad_s=1, pad_yaw_in_vessel_rad=1,
        ),
        Field("members", "bank_members"),
    ),
    "aid": (
        *_integers("fused", "refused", "n", "since", "m", "axes"),
        *_doubles(deck_weight=1, innov=3, R=9, ambiguity=9, spread=9, H=3 * COLUMNS_MAX),
    ),
    "innovation_ratios": (
        *_integers("n"), Field("t", "int64_t", RATIOS_MAX), *_doubles(values=3 * RATIOS_MAX),
    ),
    "belief": (
        *_integers(
            "t", "t_cov", "t_imu", "t_velocity", "sighted", "agreed", "is_levelled", "heading_is_given",
            "rejected_n", "rejected_since", "rejected_last", "heading_known", "heading_seen",
        ),
        *_doubles(
            rejected_offset_ned=3, rejected_var_m2=1,
            R=9, x=N, R_cov=9, dv=3, dp=3, turned=9, coast_s=1, w=3, w_smooth=3, f=3, levelled_by=9, cov_levelled_by=9,
            ins_p=3, ins_v=3, ins_var_m2_s2=1, jolt_var_m2_s2=1, jolt_var_rad2=1, over_pad=1,
            wave_w=5, wave_zeta=5, wave_sigma=5, nis_mean=1, heading_held_s=1,
        ),
        Field("aids", "aid", KINDS),
        Field("ratios", "innovation_ratios"),
    ),
    "event": (*_integers("kind", "t"), *_doubles(value=18)),
    "sighting": (
        *_integers("has_yaw", "yaw_ambiguous", "has_pose6"),
        *_doubles(confidence=1, sigma_s=1, d_level=3, yaw_rad=1, cov=16, pose_d_level=3, pose_R=9, pose_cov=36),
    ),
    "outcome": (*_integers("verdict", "m", "axes", "has_S"), *_doubles(innov=6, S=36, nis=1, nis_max=1)),
    "horizon_reach": _doubles(
        row=2 * WAVE_STATES * OSCILLATORS, noise=2 * OSCILLATORS, squares=3 * WAVE_PAIRS * OSCILLATORS,
    ),
    "deck_ahead": _doubles(
        d=3, cov_d=9, v_pad=3, height=1, sigma_height=1, rise=1, sigma_rise=1, roll=1, sigma_roll=1, pitch=1, sigma_pitch=1,
    ),
    "answer": (
        *_integers("has_pad", "has_body", "sighted", "agreed", "velocity_fused", "heading_known"),
        *_doubles(
            nis_mean=1, heading=1, d=3, v=3, yaw=1, cov=49,
            a_body=3, cov_a_body=9, w_body=3, levelled_by=9, cov_levelled_by=9,
            v_deck=3, a_deck=3, cov_deck=36, tilt=4, cov_tilt=16,
            x=N, var=N, cov_vessel=1, wave_w=DIRECTIONS, wave_zeta=DIRECTIONS, wave_sigma=DIRECTIONS,
        ),
    ),
    "deck": _doubles(p=3, v=3, R=9, w=3),
    "gust": _doubles(at_s=1, rise_s=1, hold_s=1, v=2),
    "air_params": (
        *_integers("on", "logarithmic", "dryden", "wake", "gusts"),
        *_doubles(
            speed_m_s=1, along=2, roughness_m=1, log10m=1, keep_ship=1, block_m=2, block_size=3, wake_decay=1, pad_yaw=2,
        ),
        Field("gust", "gust", GUSTS_MAX),
    ),
    "vehicle_params": (
        *_integers(
            "quad_x", "rotors", "effect_by_rotor", "flow_sees_deck", "flow_works", "motor_driven", "all_healthy", "delay_steps",
        ),
        *_doubles(
            step_s=1, mass_kg=1, inertia_kg_m2=3, thrust_max_n=1, torque_max_n_m=3, motor_lag=1, arm_m=1, rotor_radius_m=1,
            rotors_above_m=1, yaw_torque_per_thrust_m=1, drag_per_s=3, rotor_forward=ROTORS_MAX, rotor_right=ROTORS_MAX,
            rotor_spin=ROTORS_MAX, rotor_squares=2, effect_radius_m=1, rotor_health=ROTORS_MAX,
            landing_speed_m_s=1, take_off_speed_m_s=1, take_off_height_m=1, motors_off_after_s=1, tilt_cut_off_cos=1,
            tilt_p=1, tilt_d=1, yaw_rate_p=1, velocity_p=1, velocity_d=1, velocity_i=1, velocity_i_max_m_s2=1,
            climb_p=1, climb_d=1, climb_i=1, climb_i_max_m_s2=1, height_p=1, observer_share=1, unasked_max_rad_s2=3,
            flow_scale=1, flow_lag=1, foot_m=1, feet_below_m=1, hull_top_m=1, foot_n_m=1, foot_n_s_m=1, foot_stop_kg_s=1,
            friction=1, deck_fore_m=1, deck_aft_m=1, deck_middle_m=1, deck_half_m=1, deck_taper_m=1, deck_yaw=2,
            gust_sigma_m_s=1, gust_keep=1, gust_fresh=1, flow_keep=1, flow_fresh=1, tilt_keep=1, tilt_fresh=1, wind=3,
            tilt_max_rad=1, extra_wind=3, current=2, euler_angle_max_rad=1, vz_max_m_s=1, yaw_rate_max_rad_s=1,
        ),
        Field("air", "air_params"),
    ),
    "vehicle": (
        *_integers("phase", "tied", "ditched", "touched_what", "touched_phase", "pending_at", "ship_known"),
        *_doubles(
            seconds=1, p=3, v=3, q=4, R=9, w=3, a=3, thrust_n=1, torque_n_m=3, flow=2, integral=3, unasked_w=3, unasked=3,
            z_hold=1, attached_d=3, attached_q=4, contact_s=1, airborne_s=1,
            touched_s=1, touched_d=3, touched_v=3, touched_yaw=1, gust=3, flow_error=2, tilt_bias=2, tilt_drift=2,
            air_u=1, air_v=2, air_w=2, eddy=3, ship=2, air=3, driven_n=1, driven_n_m=3,
            command=5, pending=5 * COMMANDS_MAX,
        ),
    ),
    "sensor_params": (
        *_integers("echo_every", "echo_delay"),
        *_doubles(
            step_s=1, accel_sigma=2, gyro_sigma=2, accel_bias=3, gyro_bias=3, heading_bias=1, field_bias=3, field_sigma=1,
            heading_keep=1, heading_fresh=1, pressure_keep=1, pressure_fresh=1, pressure_sigma=1, cone_rad=1, echo_sigma=1,
            echo_min_m=1, echo_max_m=1, battery_life_s=1, hover_n=1,
        ),
        Field("motor", "int64_t", 4),
    ),
    "sensors": (
        *_integers("tick", "echoes", "first_echo"),
        *_doubles(
            heading_drift=1, pressure_drift=1, noise=sum(SENSOR_NOISE.values()), battery=1, echo_m=1,
            echo_due=ECHOES_MAX, echo_under_way_m=ECHOES_MAX,
        ),
    ),
    "readings": _doubles(
        f_body=3, w_body=3, rpy_rad=3, v_level_m_s=2, magnetometer=3, ultrasound_m=1, pressure_pa=1, battery=1, motors_pwm=4,
    ),
    "water": (*_integers("tick", "every"), *_doubles(z=1, vz=1)),
    "wave": _doubles(amplitude_m=1, k=2, w_rad_s=1, phase_rad=1),
}  # fmt: skip
"""The structures, without padding: every member is of eight bytes. Members mean what those of `Belief`, `Aid` and `Gathered` in
`estimator.ekf.state`, of `DeckMotionBank` and `Skill` of the same names mean; matrices are in rows, instants are in ns. In `sea`
and `bank_members`, arrays are by direction, then by state or pair of states, then by member of the bank. An `answer` has
numbers of pad and deck where it has a pad, and of the body where it has a body; `estimator.ekf.answers` says what they are. A
`horizon_reach` has, for one horizon and by oscillator, the rows of the transition to displacement and rate, their noise, and the
products of the numbers of these rows and of the first one's change. A `deck_ahead` has what `Forecast` has for one horizon."""


def size_of(name: str) -> int:
    """Return the size of a structure in words of eight bytes."""
    return sum(member.length * (size_of(member.type) if member.type in STRUCTS else 1) for member in STRUCTS[name])


def places_of(name: str) -> dict[str, slice]:
    """Return where the members of a structure lie, in words."""
    found, at = {}, 0
    for member in STRUCTS[name]:
        size = member.length * (size_of(member.type) if member.type in STRUCTS else 1)
        found[member.name] = slice(at, at + size)
        at += size
    return found


class Function(NamedTuple):
    """One function of the library."""

    name: str
    result: str
    """Its C type."""
    parameters: str
    """Its C parameters, as in a prototype."""
    source: str
    """The file that defines it."""


FUNCTIONS = (
    Function("core_digest", "uint32_t", "void", "core.c"),
    Function("nis_of", "int32_t", "int32_t m, const double *innov, const double *S, double *nis", "kalman.c"),
    Function(
        "kalman_predict",
        "void",
        "int32_t n, const double *P, const double *F, const double *Q, double *P_after",
        "kalman.c",
    ),
    Function(
        "kalman_correct",
        "int32_t",
        "int32_t n, int32_t m, const double *P, const double *innov, const double *H, const double *R, "
        "double *dx, double *P_after, double *S, double *nis",
        "kalman.c",
    ),
    Function("bank_begin", "void", "const bank_members *m, sea *after", "bank.c"),
    Function(
        "bank_observe",
        "void",
        "const filter_params *o, int64_t t, const double *y, const double *var, double ins_var, double reach_m, "
        "const sea *before, sea *after",
        "bank.c",
    ),
    Function(
        "filter_run",
        "int32_t",
        "const filter_params *o, int32_t n, const event *events, const sighting *sightings, const belief *before, "
        "const double *P_before, const sea *sea_before, belief *after, double *P_after, sea *sea_after, int64_t *P_index, "
        "int64_t *sea_index, outcome *outcomes",
        "filter.c",
    ),
    Function(
        "filter_propagate",
        "int32_t",
        "const filter_params *o, int32_t what, int64_t t, const belief *before, const double *P_before, belief *after, "
        "double *P_after",
        "filter.c",
    ),
    Function(
        "filter_settle",
        "void",
        "const filter_params *o, const belief *before, belief *after, double *F, double *Q",
        "filter.c",
    ),
    Function(
        "sighting_model",
        "int32_t",
        "const belief *b, const sighting *s, const double *cov_levelled_by, double yaw_sigma, int32_t place_only, "
        "double *innov, double *H, double *R, double *by_rate",
        "sighting.c",
    ),
    Function(
        "bank_reach",
        "void",
        "const bank_members *m, int32_t n, const double *horizons_s, horizon_reach *out",
        "bank_ahead.c",
    ),
    Function(
        "filter_forecast",
        "int32_t",
        "const filter_params *o, int64_t t, const belief *before, const double *P_before, const sea *bank, int32_t n, "
        "const double *horizons_s, const horizon_reach *reach, deck_ahead *out",
        "forecast.c",
    ),
    Function(
        "filter_answer",
        "void",
        "const filter_params *o, int64_t t, const belief *before, const double *P_before, answer *out",
        "answer.c",
    ),
    Function(
        "sim_run",
        "int32_t",
        "const vehicle_params *o, vehicle *v, const sensor_params *e, sensors *s, water *sea, int32_t harmonics, "
        "const wave *waves, int32_t n, const deck *decks, const double *noise, const double *air_noise, "
        "const double *sensor_noise",
        "sim_run.c",
    ),
    Function(
        "vehicle_step",
        "void",
        "const vehicle_params *o, vehicle *v, const deck *g, double sea_z, double sea_vz, const double *noise, "
        "const double *air_noise",
        "sim_vehicle.c",
    ),
    Function("vehicle_carry", "void", "vehicle *v, const deck *g", "sim_vehicle.c"),
    Function(
        "sensors_read",
        "void",
        "const vehicle_params *o, const vehicle *v, const sensor_params *e, const sensors *s, readings *out",
        "sim_sensors.c",
    ),
    Function(
        "render_deck",
        "void",
        "int32_t w, int32_t x0, int32_t x1, int32_t y0, int32_t y1, const float *cells, int32_t columns, const uint16_t *texels, "
        "int32_t texel_rows, int32_t texel_columns, const uint8_t *mask, uint16_t *scene",
        "render_deck.c",
    ),
    Function(
        "render_fill",
        "void",
        "int32_t w, int32_t x0, int32_t x1, int32_t y0, int32_t y1, const uint8_t *mask, const uint16_t *colour, uint16_t *scene",
        "render_deck.c",
    ),
    Function(
        "render_smear",
        "void",
        "int32_t h, int32_t w, const uint16_t *scene, int32_t count, const int32_t *shifts, const uint16_t *weights, "
        "int32_t reach, uint16_t *smeared",
        "render_smear.c",
    ),
    Function(
        "render_sea",
        "void",
        "int32_t h, int32_t w, const uint8_t *mask, int32_t x0, int32_t x1, int32_t y0, int32_t y1, const float *cells, "
        "int32_t columns, const float *small_texels, const float *large_texels, const float *caps_texels, "
        "const float *streak_texels, const int32_t *sizes, const double *drift, const float *weights, const float *slow, "
        "const float *shade, const float *white, uint8_t *codes",
        "render_sea.c",
    ),
    Function(
        "render_water",
        "void",
        "int32_t w, int32_t x0, int32_t x1, int32_t y0, int32_t y1, const uint8_t *codes, const uint16_t *colours, "
        "uint16_t *scene",
        "render_sea.c",
    ),
    Function(
        "render_pad_kinds",
        "int32_t",
        "int32_t h, int32_t w, const float *rays, const float *change, int32_t bent, const float *whole, int32_t rolling, "
        "const float *pad, uint8_t *kinds, int32_t *edges",
        "render_pad.c",
    ),
    Function(
        "render_pad_shares",
        "void",
        "int32_t h, int32_t w, const float *rays, const float *change, int32_t bent, int32_t strokes, "
        "const float *stroke_numbers, int32_t rolling, const float *pad, int32_t fine, int32_t count, const int32_t *edges, "
        "float *shares",
        "render_pad.c",
    ),
    Function(
        "render_expose",
        "void",
        "int32_t pixels, const uint16_t *scene, const uint8_t *kinds, const int16_t *gain, const float *exposure, "
        "const uint16_t *pad_scene, int16_t *light",
        "render_light.c",
    ),
    Function(
        "render_mix",
        "void",
        "int32_t edges, const int32_t *where, const float *shares, const uint16_t *scene, const int16_t *gain, "
        "const float *exposure, const uint16_t *pad_scene, int16_t *light",
        "render_light.c",
    ),
    Function(
        "render_blur",
        "void",
        "int32_t h, int32_t w, const int16_t *light, int32_t radius, const uint16_t *taps, uint16_t *scratch, int16_t *blurred",
        "render_light.c",
    ),
    Function(
        "render_frame",
        "void",
        "int32_t h, int32_t w, const int16_t *light, int32_t radius, const uint16_t *taps, const uint16_t *even, "
        "const int16_t *noise, const uint8_t *codes, uint16_t *scratch, uint8_t *frame",
        "render_light.c",
    ),
)
"""Every function that Python calls. Matrices are row-major; what a function writes overlaps nothing that it reads."""


def prototype(function: Function) -> str:
    """Return a function's prototype as one line of C."""
    return f"{function.result} {function.name}({function.parameters});"


def struct(name: str) -> str:
    """Return a structure's definition in C."""
    members = "".join(f"    {m.type} {m.name}{f'[{m.length}]' if m.length > 1 else ''};\n" for m in STRUCTS[name])
    return f"typedef struct {{\n{members}}} {name};\n"


def _body() -> str:
    constants = "\n".join(f"#define {name} {value}" for name, value in CONSTANTS.items())
    structs = "\n".join(map(struct, STRUCTS))
    files = sorted({function.source for function in FUNCTIONS})
    prototypes = "\n\n".join(
        "\n".join([f"/* {file} */", *(prototype(one) for one in FUNCTIONS if one.source == file)]) for file in files
    )
    return f"#include <stdint.h>\n\n{constants}\n\n{structs}\n{prototypes}\n"


def digest() -> int:
    """Return the digest that a library must carry to fit this interface."""
    return zlib.crc32(_body().encode())


def header() -> str:
    """Return the text of `interface.h`."""
    return (
        "/* Made from interface.py by `python -m supply.core --header`. */\n"
        "#ifndef DECKLANDER_INTERFACE_H\n#define DECKLANDER_INTERFACE_H\n\n"
        f"{_body()}\n#ifndef INTERFACE_DIGEST\n#define INTERFACE_DIGEST {digest()}u\n#endif\n\n#endif\n"
    )
