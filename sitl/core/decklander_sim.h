/* The interface of the library that simulates. Python's side is made from this file, as decklander.h says. */
#ifndef DECKLANDER_SIM_H
#define DECKLANDER_SIM_H

#include <stdint.h>

/* The digest of this file. */
uint32_t dl_digest(void);

/* ---- video/: the AR.Drone 1.0's pictures ---- */

typedef struct {
    int64_t width, height, quantizer, number;
} sim_uvlc_picture;

/* Encode (height, width, 3) bytes as one picture. Return its length in bytes, 0 if it is longer than the room, -1 for a picture
 * that the format cannot hold. `bytes` is the size of `bgr`. */
int32_t sim_uvlc_encode(const uint8_t *bgr, int32_t bytes, const sim_uvlc_picture *picture, uint8_t *out, int32_t room);

/* ---- physics/: vehicle, air, contacts, sensors, vessel ---- */

/* Where the standard normal numbers lie that the sensors take at a step, and how many they are. */
enum sensor_noise {
    IMU_NOISE = 0, FIELD_NOISE = 6, PRESSURE_NOISE = 9, HEADING_DRIFT = 10, PRESSURE_DRIFT = 11, ECHO_NOISE = 12,
    SENSOR_NOISE = 13,
};

/* What a simulated vehicle is doing. */
enum flight_phase {
    PHASE_LANDED, PHASE_TAKING_OFF, PHASE_HOVERING, PHASE_FLYING, PHASE_LANDING, PHASE_EMERGENCY,
};

enum touched {
    TOUCHED_NOTHING, TOUCHED_DECK, TOUCHED_SEA,
};

enum {
    /* The largest number of rotors of a simulated vehicle. */
    ROTORS_MAX = 6,
    /* The largest number of single gusts in the simulated air. */
    GUSTS_MAX = 100,
    /* The largest number of steps of physics that a stick command may be under way. */
    COMMANDS_MAX = 1024,
    /* The largest number of ultrasound echoes under way to the telemetry. */
    ECHOES_MAX = 64,
    /* Standard normal numbers that a vehicle takes at a step: gust (3), optical flow (2), tilt (2); the air takes as many. */
    FLIGHT_NOISE = 7,
    /* Standard normal numbers of its disturbing effects: downwash (3), climb rate and turn rates by which the loops fly (1, 3). */
    EFFECT_NOISE = 7,
};

typedef struct {
    double p[3], v[3], R[9], w[3];
} sim_deck;

typedef struct {
    double at_s, rise_s, hold_s, v[2];
} sim_gust;

typedef struct {
    int64_t on, logarithmic, dryden, kaimal, wake, hull_wake, gusts;
    double speed_m_s, along[2], roughness_m, log10m, keep_ship, block_m[2], block_size[3], wake_decay, pad_yaw[2], deck_m[4],
        edge_m, edge_decay;
    sim_gust gust[GUSTS_MAX];
} sim_air_params;

/* Effects that are off unless `on`; loop_mass_kg, tilt_gain and lift_share hold always. */
typedef struct {
    int64_t on, saturates, moving_deck, rotor_drag;
    double sag, hover_share, drag_per_m, downwash, downwash_keep, downwash_fresh, cushion_share, induced_m_s, climb_keep, climb_fresh,
        rate_sigma, loop_mass_kg, tilt_gain, lift_share, thing[4], revolution_hz;
} sim_effects;

typedef struct {
    int64_t quad_x, rotors, effect_by_rotor, flow_sees_deck, flow_works, motor_driven, all_healthy, delay_steps;
    double step_s, mass_kg, inertia_kg_m2[3], thrust_max_n, torque_max_n_m[3], motor_lag, arm_m, rotor_radius_m,
        rotors_above_m, yaw_torque_per_thrust_m, drag_per_s[3], rotor_forward[ROTORS_MAX], rotor_right[ROTORS_MAX],
        rotor_spin[ROTORS_MAX], rotor_squares[2], effect_radius_m, rotor_health[ROTORS_MAX], landing_speed_m_s,
        take_off_speed_m_s, take_off_height_m, motors_off_after_s, tilt_cut_off_cos, tilt_p, tilt_d, yaw_rate_p, velocity_p,
        velocity_d, velocity_i, velocity_i_max_m_s2, climb_p, climb_d, climb_i, climb_i_max_m_s2, height_p, observer_share,
        unasked_max_rad_s2[3], flow_scale, flow_lag, foot_m, feet_below_m, hull_top_m, foot_n_m, foot_n_s_m, foot_stop_kg_s,
        friction, deck_fore_m, deck_aft_m, deck_middle_m, deck_half_m, deck_taper_m, deck_yaw[2], gust_sigma_m_s, gust_keep,
        gust_fresh, flow_keep, flow_fresh, tilt_keep, tilt_fresh, wind[3], tilt_max_rad, extra_wind[3], current[2],
        euler_angle_max_rad, vz_max_m_s, yaw_rate_max_rad_s;
    sim_effects effects;
    sim_air_params air;
} sim_vehicle_params;

typedef struct {
    int64_t phase, tied, ditched, touched_what, touched_phase, pending_at, ship_known;
    double seconds, p[3], v[3], q[4], R[9], w[3], a[3], thrust_n, torque_n_m[3], flow[2], integral[3], unasked_w[3],
        unasked[3], z_hold, attached_d[3], attached_q[4], contact_s, airborne_s, touched_s, touched_d[3], touched_v[3],
        touched_R[9], touched_w[3], gust[3], flow_error[2], tilt_bias[2], tilt_drift[2], air_u[2], air_v[2], air_w[2], eddy[3],
        ship[2], air[3], driven_n, driven_n_m[3], rough[3], cushion, climb_error, revolutions, command[5], pending[5 * COMMANDS_MAX];
} sim_vehicle;

typedef struct {
    int64_t echo_every, echo_delay;
    double step_s, accel_sigma[2], gyro_sigma[2], accel_scale, gyro_scale, vibration, accel_bias[3], gyro_bias[3], heading_bias, field_bias[3], field_sigma,
        heading_keep, heading_fresh, pressure_keep, pressure_fresh, pressure_sigma, cone_rad, echo_sigma, echo_min_m,
        echo_max_m, battery_life_s, hover_n;
    int64_t motor[4];
} sim_sensor_params;

typedef struct {
    int64_t tick, echoes, first_echo;
    double heading_drift, pressure_drift, noise[SENSOR_NOISE], battery, echo_m, echo_due[ECHOES_MAX],
        echo_under_way_m[ECHOES_MAX];
} sim_sensors;

typedef struct {
    double f_body[3], w_body[3], rpy_rad[3], v_level_m_s[2], magnetometer[3], ultrasound_m, pressure_pa, battery,
        motors_pwm[4];
} sim_readings;

typedef struct {
    int64_t tick, every;
    double z, vz;
} sim_water;

typedef struct {
    double amplitude_m, k[2], w_rad_s, phase_rad;
} sim_wave;

typedef struct {
    double w_rad_s, re[6], im[6];
} sim_harmonic;

typedef struct {
    double eta[6], eta_dot[6], eta_ddot[6];
} sim_vessel_motion;

typedef struct {
    double p[3], v[3], a[3], heading_rad;
} sim_vessel_origin;

typedef struct {
    double d[3], R[9];
} sim_mount;

typedef struct {
    double p[3], v[3], a[3], R[9], w[3];
} sim_mounted;

/* A vehicle with its sensors over a sea of some waves, at the addresses of what its steps read and write. */
typedef struct {
    const sim_vehicle_params *vehicle_params;
    sim_vehicle *vehicle;
    const sim_sensor_params *sensor_params;
    sim_sensors *sensors;
    sim_water *water;
    const sim_wave *waves;
    int64_t harmonics;
} sim_flight;

/* Take n steps over a deck, up to a contact after flight; return how many. FLIGHT_NOISE numbers a step, EFFECT_NOISE, SENSOR_NOISE. */
int32_t sim_run(const sim_flight *f, int32_t n, const sim_deck *decks, const double *noise, const double *air_noise,
    const double *effect_noise, const double *sensor_noise);
void sim_vehicle_step(const sim_vehicle_params *o, sim_vehicle *v, const sim_deck *g, double sea_z, double sea_vz, const double *noise,
    const double *air_noise, const double *effect_noise);
void sim_vehicle_carry(sim_vehicle *v, const sim_deck *g);
void sim_sensors_read(const sim_vehicle_params *o, const sim_vehicle *v, const sim_sensor_params *e, const sim_sensors *s, sim_readings *out);

/* A vessel's motion at n times about her steady course, by harmonics with complex amplitudes of the six modes; and that of a point
 * which is fixed to her, with axes fixed to it. */
void sim_vessel_moved(int32_t harmonics, const sim_harmonic *h, int32_t n, const double *t_s, sim_vessel_motion *out);
void sim_vessel_mounted(int32_t n, const sim_vessel_origin *origin, const sim_vessel_motion *m, const sim_mount *at, sim_mounted *out);

/* ---- training/: many flights of one scenario, step by step, for controllers that learn ---- */

/* The numbers of an action, each -1 to 1: acceleration (or velocity) forward and right, velocity down against the deck, yaw rate. */
enum action_number {
    ACTION_FORWARD, ACTION_RIGHT, ACTION_DOWN, ACTION_YAW, ACTION_NUMBERS,
};

/* Where the parts of an observation begin: the pad's place (3) m and its velocity against the body (3) m/s in level axes, the body's
 * tilt and the trim against wind and drag as accelerations (2 + 2) m/s^2 forward and right, the deck's velocity and acceleration down, its roll and pitch
 * about the body's heading, sine and cosine of the heading against the arrow, the last action, seconds since the last sighting. */
enum view_number {
    VIEW_PLACE = 0, VIEW_VELOCITY = 3, VIEW_LEAN = 6, VIEW_TRIM = 8, VIEW_DECK = 10, VIEW_DECK_TILT = 12, VIEW_HEADING = 14,
    VIEW_ACTION = 16, VIEW_AGE = 20, VIEW_NUMBERS = 21,
};

/* The terms of a reward, before their weights. */
enum reward_term {
    REWARD_NEARER, REWARD_OUTSIDE, REWARD_EFFORT, REWARD_TIME, REWARD_LANDED, REWARD_MISSED_BY, REWARD_SPEED, REWARD_FAILED,
    REWARD_TERMS,
};

/* How an episode ended. */
enum episode_end {
    EPISODE_GOES_ON, EPISODE_LANDED, EPISODE_OFF_PAD, EPISODE_HARD, EPISODE_IN_WATER, EPISODE_LEFT, EPISODE_TIMED_OUT,
};

/* What a wrong model changes: factors on the vehicle's, and seconds of delay more. */
enum wrong_number {
    WRONG_TILT_FREQUENCY, WRONG_TILT_DAMPING, WRONG_THRUST, WRONG_DRAG, WRONG_COMMAND_DELAY_S, WRONG_NUMBERS,
};

enum {
    /* The largest number of harmonics of a vessel's motion. */
    HARMONICS_MAX = 256,
    /* The largest number of observations that may be under way. */
    VIEWS_MAX = 16,
};

/* A vessel's motion by harmonics: displacement (6) and rate (6) by the real and by the imaginary part of each one's phasor, and by
 * how much a step of the controller turns it. */
typedef struct {
    double by_re[12], by_im[12], turn_re, turn_im;
} sim_sway;

/* What is the same for all worlds: the scenario, and the rules of the training. */
typedef struct {
    int64_t harmonics, physics_steps, steps_max, velocity_actions, true_view, view_delay;
    double step_s, cos_course, sin_course, acceleration_max_m_s2, velocity_max_m_s, velocity_gain, down_max_m_s, yaw_rate_max_rad_s,
        start_low[4], start_high[4], pad_radius_m, vertical_max_m_s, lateral_max_m_s, reach_m, trim_keep, place_sigma_m, place_sigma_by_height, velocity_sigma_m_s, velocity_sigma_by_height,
        error_keep, error_fresh, tilt_sigma_rad, lost_share, found_share, wrong_sigma[WRONG_NUMBERS];
    sim_vessel_origin course;
    sim_mount pad;
    sim_vehicle_params vehicle_params;
    sim_vehicle vehicle;
    sim_sway sway[HARMONICS_MAX];
} sim_training;

/* One world: the vehicle, the sea's phasors, the deck at both ends of a step, the errors of the estimate. */
typedef struct {
    uint64_t random[4];
    int64_t steps, lost, view_at;
    double t_s, deck_at[2][12], error[6], tilt_error[2], trim[2], action[ACTION_NUMBERS], goal_m, phasor_re[HARMONICS_MAX],
        phasor_im[HARMONICS_MAX];
    float views[VIEWS_MAX * VIEW_NUMBERS];
    sim_deck deck;
    sim_vehicle_params vehicle_params;
    sim_vehicle vehicle;
} sim_training_world;

/* What a step of `count` worlds gives: an observation each, the terms of its reward, how its episode ended, and for episodes that did
 * the last observation and the touchdown's place (lateral distance, m) and speeds (down, along the deck, m/s). */
typedef struct {
    float *views, *terms, *last_views, *touchdowns;
    int8_t *ends;
} sim_training_step;

/* Begin an episode of every world with its random state; write the observations. */
void sim_training_begin(const sim_training *rules, int32_t count, sim_training_world *worlds, float *views);
/* Take one step of the controller in every world by ACTION_NUMBERS each. A world whose episode ends begins the next one. */
void sim_training_step_all(const sim_training *rules, int32_t count, sim_training_world *worlds, const float *actions,
    const sim_training_step *out);

/* ---- render/ and sea/: what a camera sees ---- */

/* The paints of a pad, in the order of their shares; the first is what lies around it. */
enum pad_paint_kind {
    PAD_NONE, PAD_RIM, PAD_DISC, PAD_ORANGE, PAD_WHITE, PAD_UPPER, PAD_PAINTS,
};

/* The first numbers of a painted region: its shape, its paint, the paint that it lies on, and its least and largest
 * distance from the centre, m; then those of its shape. */
enum pad_region_number {
    PAD_SHAPE, PAD_PAINT, PAD_BELOW, PAD_NEAREST, PAD_FARTHEST, PAD_SHAPE_NUMBERS,
};

/* The shapes of regions, and their numbers: m from the centre, and the direction of the arrowhead's sides. A convex
 * polygon of up to four sides has for each its normal outward and its distance from the centre, m, one after the other
 * from the first. */
enum pad_shape_kind {
    PAD_ANNULUS, PAD_RECTANGLE, PAD_ARROW, PAD_POLYGON,
};

enum {
    PAD_ANNULUS_INNER = PAD_SHAPE_NUMBERS, PAD_ANNULUS_OUTER,
};

enum {
    PAD_RECTANGLE_U0 = PAD_SHAPE_NUMBERS, PAD_RECTANGLE_U1, PAD_RECTANGLE_V0, PAD_RECTANGLE_V1,
};

enum {
    PAD_ARROW_TIP = PAD_SHAPE_NUMBERS, PAD_ARROW_BASE, PAD_ARROW_COS, PAD_ARROW_SIN,
};

enum {
    PAD_POLYGON_SIDES = PAD_SHAPE_NUMBERS, PAD_POLYGON_FIRST, PAD_POLYGON_1, PAD_POLYGON_2, PAD_POLYGON_3, PAD_POLYGON_4,
    PAD_POLYGON_5, PAD_POLYGON_6, PAD_POLYGON_7, PAD_POLYGON_8, PAD_POLYGON_9, PAD_POLYGON_10, PAD_POLYGON_11, PAD_REGION,
};

/* The strengths of what lies on the sea: small and large ripples, the height below which no crest breaks, the brightness
 * of those that do, the largest share of light that a ship's shade takes, and the brightness of full foam beside and
 * behind her. */
enum sea_weight {
    SEA_SMALL, SEA_LARGE, SEA_CALM, SEA_CAP, SEA_SHADE, SEA_WASH, SEA_WAKE, SEA_WEIGHTS,
};

/* A part of the frame, px: its first column and row, and their numbers. */
enum lens_window {
    LENS_X, LENS_Y, LENS_COLUMNS, LENS_ROWS, LENS_NUMBERS,
};

enum {
    /* Value of a factor of one on simulated light. */
    GAIN_ONE = 16384,
    /* Value of a scene's pixel that reflects all light, and of wear that does not change it. */
    SCENE_ONE = 32768,
    /* Distance between the rays at which planes are met exactly, px. */
    CELL_PX = 8,
    /* The widest blur of the simulated lens, px. */
    BLUR_RADIUS_MAX = 30,
    /* Light up to this many counts is distinguished by single counts when noise is added to it, then by four. */
    LEVELS_BY_ONE = 512,
    /* Light from this many counts on is distinguished by eight. */
    COUNTS_BY_EIGHT = 4096,
    /* The number of levels below that. */
    LEVELS_BY_EIGHT = LEVELS_BY_ONE + (COUNTS_BY_EIGHT - LEVELS_BY_ONE) / 4,
    /* The number of levels of light; the last one holds all light that is brighter. */
    LIGHT_LEVELS = 2048,
    /* The number of levels of noise. */
    GRAIN_LEVELS = 32,
    /* Value of one in a texture of the sea. */
    TILE_ONE = 4096,
    /* The number of outlines of a ship on the water: her shadow, her hull, and her wake. */
    SEA_OUTLINES = 3,
    /* The largest number of points of one of them. */
    SEA_OUTLINE_POINTS = 48,
    /* Kind of a pixel that shows several paints. */
    PAD_EDGE = 255,
    /* Numbers of one part of an exposure: homographies in its middle, their change during it, in the first row and in the last. */
    STROKE_NUMBERS = 36,
    /* Number of columns of a row that are blurred exactly together, or left as they are. */
    LENS_BLOCK = 16,
    /* The largest number of regions: disc, rim, ring, arrowhead, and the rectangles and convex pieces of lettering of two paints. */
    PAD_REGIONS_MOST = 784,
};

/* Columns x0 to x1 and rows y0 to y1, without the last, of a frame of w columns. */
typedef struct {
    int32_t w, x0, x1, y0, y1;
} sim_frame_part;

/* Where rays meet a plane, two numbers for the middles of cells of CELL_PX x CELL_PX pixels, with one cell more on each side than
 * the frame has. */
typedef struct {
    const float *at;
    int32_t columns;
} sim_plane_cells;

/* A drawing of h x w texels of four numbers: what it reflects of blue, green and red, and its wear, parts of SCENE_ONE. */
typedef struct {
    const uint16_t *texels;
    int32_t h, w;
} sim_drawing;

/* Where rays meet a plane, (count, 2). */
void sim_render_meet(int32_t count, const float *rays, const double *plane_from_ray, double most, float *places);
/* The bounds x0, x1, y0, y1 of what a mask covers, and of what it leaves open. */
void sim_render_bounds(int32_t h, int32_t w, const uint8_t *mask, int32_t *covered, int32_t *open);
/* Draw on a part of a scene as far as a mask of the whole frame covers it, or wholly without one. */
void sim_render_deck(const sim_frame_part *part, const sim_plane_cells *cells, const sim_drawing *drawn, const uint8_t *mask, uint16_t *scene);
/* Colour a part of a scene as far as a mask of this part covers it. */
void sim_render_fill(const sim_frame_part *part, const uint8_t *mask, const uint16_t *colour, uint16_t *scene);

/* A drone's shadow: the rotors' place along and across, their guards' radius, half the hull's length and width, and the width of
 * its soft edge, m; the share of light that it takes. */
typedef struct {
    float rotor_at_m, rotor_radius_m, half_length_m, half_width_m, soft_m, share;
} sim_drone_shade;

/* Darken factors on the light, (h, w), by a shadow; its bounds are x0, x1, y0, y1. */
void sim_render_shadow(int32_t h, int32_t w, const sim_plane_cells *cells, const sim_drone_shade *shade, const uint8_t *mask, int16_t *gain,
    int32_t *bounds);
/* Sum `count` shifted scenes by their weights, parts of 65536; and average two. */
void sim_render_smear(int32_t h, int32_t w, const uint16_t *scene, int32_t count, const int32_t *shifts, const uint16_t *weights,
    uint16_t *smeared);
void sim_render_average(int32_t h, int32_t w, const uint16_t *scene, const int32_t *shifts, uint16_t *averaged);

/* A periodic texture on the sea: n x n texels with the first row and column repeated, its frequency and shift. */
typedef struct {
    const int16_t *texels;
    int32_t n;
    double per_m, shift_x, shift_y;
} sim_sea_layer;

/* What the sea's surface is painted from: ripples of two sizes, whitecaps, streaks of foam; the strengths of sea_weight; level and
 * contrast of the light for every second cell (`sim_render_swell`); the outlines of a ship's shadow, hull and wake, one after the other,
 * their points, and the widths of their soft edges, m. */
typedef struct {
    sim_sea_layer small, large, caps, streaks;
    float weights[SEA_WEIGHTS];
    const float *slow;
    const double *outlines;
    int32_t outline_points[SEA_OUTLINES];
    float soft_m[SEA_OUTLINES];
} sim_sea_surface;

/* Code the brightness of a part of the sea in squares of 2 x 2 pixels; the part counts squares, but its w is the frame's, px. */
void sim_render_sea(int32_t h, const sim_frame_part *part, const sim_plane_cells *cells, const sim_sea_surface *sea, const uint8_t *mask,
    uint8_t *codes);
/* Colour a part of a scene by the codes of its squares. */
void sim_render_water(const sim_frame_part *part, const uint8_t *codes, const uint16_t *colours, const uint8_t *mask, uint16_t *scene);

/* The swell under a camera: waves at a time, and the direction to the sun. */
typedef struct {
    double R_ned_cam[9], plane_from_ray[9], to_sun[3], t_s;
    const sim_wave *waves;
    int64_t harmonics;
} sim_swell;

/* Level and contrast of the sea's light for every second cell, (rows / 2 + 1, columns / 2 + 1, 2). */
void sim_render_swell(int32_t rows, int32_t columns, const float *rays, const sim_swell *s, float *light);

/* A pad in a frame of h x w pixels: the rays of these, their change from pixel to pixel (one for all, if the lens is not bent), the
 * rays of the middles of cells; whether rows are exposed one after the other; the regions of the pad, PAD_REGION numbers each. */
typedef struct {
    int32_t h, w, bent, rolling, regions;
    const float *rays, *change, *middles, *pad;
} sim_pad_view;

/* Tell the paint of each pixel by the homographies of the whole exposure, and the pixels that edges touch; return how many. */
int32_t sim_render_pad_kinds(const sim_pad_view *v, const float *whole, uint8_t *kinds, int32_t *edges);
/* Compute the coverage of `count` pixels by the paints during this many strokes, and of their fine x fine parts. */
void sim_render_pad_shares(const sim_pad_view *v, int32_t strokes, const float *stroke_numbers, int32_t fine, int32_t count,
    const int32_t *edges, float *shares, float *parts);

/* A scene of h x w pixels in a light: its pixels, the pad's paint on them or none, factors on the light; the exposure, the pad's
 * paints; the pixels that edges of the pad touch, their coverage by the paints, and that of their fine x fine parts. */
typedef struct {
    int32_t h, w, edges, fine;
    const uint16_t *scene;
    const uint8_t *kinds;
    const int16_t *gain;
    const float *exposure;
    const uint16_t *pad_scene;
    const int32_t *where;
    const float *shares, *parts;
} sim_lit_scene;

/* The light of a scene, (h, w, 3), without the pixels of edges; and these mixed into it. */
void sim_render_expose(const sim_lit_scene *seen, int16_t *light);
void sim_render_mix(const sim_lit_scene *seen, int16_t *light);

/* The kernels of a lens on parts of pixels and on pixels, and how far they reach, px. `room` has this many floats and numbers. */
typedef struct {
    int32_t reach, floats, numbers;
    const float *exact, *sampled;
    float *room;
    int32_t *places;
} sim_lens_kernels;

/* Compute what the blur of a lens makes of the pad's edges in a window beyond what a blur of pixels does, (rows, 3, columns). Return 0,
 * or -1 if there is no room for it. */
int32_t sim_render_pad_lens(const sim_lit_scene *seen, const int32_t *window, const sim_lens_kernels *k, int16_t *added);

/* The blur of a lens: its radius, weights, what is added in a window, or nothing; and this many numbers to work on. */
typedef struct {
    int32_t radius, numbers;
    const uint16_t *taps;
    const int32_t *window;
    const int16_t *added;
    uint16_t *scratch;
} sim_lens_blur;

/* The sensor: levels of noise for each value, or none, and the values of the frame by light and noise. */
typedef struct {
    const uint8_t *noise, *codes;
} sim_sensor_tone;

/* Blur light, (h, w, 3); make a frame of it; make a frame of a scene. Each returns 0, or -1 if there is no room. */
int32_t sim_render_blur(int32_t h, int32_t w, const int16_t *light, const sim_lens_blur *blur, int16_t *out);
int32_t sim_render_frame(int32_t h, int32_t w, const int16_t *light, const sim_lens_blur *blur, const sim_sensor_tone *tone, uint8_t *frame);
int32_t sim_render_image(const sim_lit_scene *seen, const sim_lens_blur *blur, const sim_sensor_tone *tone, uint8_t *frame);

#endif
