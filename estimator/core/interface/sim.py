"""What C and Python share of the simulated vehicle: its structures and functions."""

from __future__ import annotations

import itertools

from .describe import Field, Function, doubles, integers

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
    "ROTORS_MAX": ROTORS_MAX, "GUSTS_MAX": GUSTS_MAX, "COMMANDS_MAX": COMMANDS_MAX, "ECHOES_MAX": ECHOES_MAX,
    "FLIGHT_NOISE": FLIGHT_NOISE, "SENSOR_NOISE": sum(SENSOR_NOISE.values()),
    **dict(zip(SENSOR_NOISE, itertools.accumulate(SENSOR_NOISE.values(), initial=0), strict=False)),
    **{f"PHASE_{name}": value for value, name in enumerate(PHASES)},
    "TOUCHED_DECK": 1, "TOUCHED_SEA": 2,
}  # fmt: skip
"""Numbers by their names in the header: the simulated vehicle's sizes, noises and phases, and what a foot touched."""

STRUCTS: dict[str, tuple[Field, ...]] = {
    "deck": doubles(p=3, v=3, R=9, w=3),
    "gust": doubles(at_s=1, rise_s=1, hold_s=1, v=2),
    "air_params": (
        *integers("on", "logarithmic", "dryden", "wake", "gusts"),
        *doubles(
            speed_m_s=1, along=2, roughness_m=1, log10m=1, keep_ship=1, block_m=2, block_size=3, wake_decay=1, pad_yaw=2,
        ),
        Field("gust", "gust", GUSTS_MAX),
    ),
    "vehicle_params": (
        *integers(
            "quad_x", "rotors", "effect_by_rotor", "flow_sees_deck", "flow_works", "motor_driven", "all_healthy", "delay_steps",
        ),
        *doubles(
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
        *integers("phase", "tied", "ditched", "touched_what", "touched_phase", "pending_at", "ship_known"),
        *doubles(
            seconds=1, p=3, v=3, q=4, R=9, w=3, a=3, thrust_n=1, torque_n_m=3, flow=2, integral=3, unasked_w=3, unasked=3,
            z_hold=1, attached_d=3, attached_q=4, contact_s=1, airborne_s=1,
            touched_s=1, touched_d=3, touched_v=3, touched_yaw=1, gust=3, flow_error=2, tilt_bias=2, tilt_drift=2,
            air_u=1, air_v=2, air_w=2, eddy=3, ship=2, air=3, driven_n=1, driven_n_m=3,
            command=5, pending=5 * COMMANDS_MAX,
        ),
    ),
    "sensor_params": (
        *integers("echo_every", "echo_delay"),
        *doubles(
            step_s=1, accel_sigma=2, gyro_sigma=2, accel_bias=3, gyro_bias=3, heading_bias=1, field_bias=3, field_sigma=1,
            heading_keep=1, heading_fresh=1, pressure_keep=1, pressure_fresh=1, pressure_sigma=1, cone_rad=1, echo_sigma=1,
            echo_min_m=1, echo_max_m=1, battery_life_s=1, hover_n=1,
        ),
        Field("motor", "int64_t", 4),
    ),
    "sensors": (
        *integers("tick", "echoes", "first_echo"),
        *doubles(
            heading_drift=1, pressure_drift=1, noise=sum(SENSOR_NOISE.values()), battery=1, echo_m=1,
            echo_due=ECHOES_MAX, echo_under_way_m=ECHOES_MAX,
        ),
    ),
    "readings": doubles(
        f_body=3, w_body=3, rpy_rad=3, v_level_m_s=2, magnetometer=3, ultrasound_m=1, pressure_pa=1, battery=1, motors_pwm=4,
    ),
    "water": (*integers("tick", "every"), *doubles(z=1, vz=1)),
    "wave": doubles(amplitude_m=1, k=2, w_rad_s=1, phase_rad=1),
    "harmonic": doubles(w_rad_s=1, re=6, im=6),
    "vessel_motion": doubles(eta=6, eta_dot=6, eta_ddot=6),
    "vessel_origin": doubles(p=3, v=3, a=3, heading_rad=1),
    "mount": doubles(d=3, R=9),
    "mounted": doubles(p=3, v=3, a=3, R=9, w=3),
}  # fmt: skip

FUNCTIONS = (
    Function(
        "sim_run",
        "int32_t",
        "const vehicle_params *o, vehicle *v, const sensor_params *e, sensors *s, water *sea, int32_t harmonics, "
        "const wave *waves, int32_t n, const deck *decks, const double *noise, const double *air_noise, "
        "const double *sensor_noise",
        "sitl/core/physics/run.c",
    ),
    Function(
        "vehicle_step",
        "void",
        "const vehicle_params *o, vehicle *v, const deck *g, double sea_z, double sea_vz, const double *noise, "
        "const double *air_noise",
        "sitl/core/physics/vehicle.c",
    ),
    Function("vehicle_carry", "void", "vehicle *v, const deck *g", "sitl/core/physics/vehicle.c"),
    Function(
        "sensors_read",
        "void",
        "const vehicle_params *o, const vehicle *v, const sensor_params *e, const sensors *s, readings *out",
        "sitl/core/physics/sensors.c",
    ),
    Function(
        "vessel_moved",
        "void",
        "int32_t harmonics, const harmonic *h, int32_t n, const double *t_s, vessel_motion *out",
        "sitl/core/physics/vessel.c",
    ),
    Function(
        "vessel_mounted",
        "void",
        "int32_t n, const vessel_origin *origin, const vessel_motion *m, const mount *at, mounted *out",
        "sitl/core/physics/vessel.c",
    ),
)
"""Functions that step a simulated vehicle and its sensors, and tell a vessel's motion at some times: about her steady course, by
harmonics with complex amplitudes of the six modes; and that of a point which is fixed to her, with axes fixed to it."""
