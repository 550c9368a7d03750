/* The interface of the library that flies. Python's side is made from this file.
 *
 * It is plain C99 that the binding generator reads too: structures, enumerations with their values, and prototypes. Lengths that
 * both sides need are named here. Matrices are row-major; what an entry writes overlaps nothing that it reads. */
#ifndef DECKLANDER_H
#define DECKLANDER_H

#include <stdint.h>

/* The digest of this file, by which a library and the Python code that calls it know each other. */
uint32_t dl_digest(void);

/* ---- video/: the AR.Drone 1.0's pictures ---- */

/* The results of reading a picture: done, or why not. The data are shorter than a header; they do not begin as a picture
 * does; its size is none that is decoded; it is coded as the change of another one; they end before it does; they hold a
 * code that the format does not have. */
enum dl_uvlc_result {
    UVLC_DONE, UVLC_SHORT, UVLC_NO_PICTURE, UVLC_SIZE, UVLC_INTER, UVLC_TORN, UVLC_BAD_CODE,
};

/* The size of the largest picture, px. */
enum {
    UVLC_WIDTH_MAX = 640, UVLC_HEIGHT_MAX = 480,
};

/* A picture's header; intra is 1 if the picture needs no other one. */
typedef struct {
    int64_t width, height, intra, quantizer, number;
} dl_uvlc_picture;

/* Read a picture's header. Return a dl_uvlc_result. */
int32_t dl_uvlc_header(const uint8_t *data, int32_t bytes, dl_uvlc_picture *picture);

/* Decode a picture whose header is known into (height, width, 3) bytes; `room` is how many there are. If it fails, they hold a part
 * of it. Return a dl_uvlc_result. */
int32_t dl_uvlc_decode(const uint8_t *data, int32_t bytes, const dl_uvlc_picture *picture, uint8_t *bgr, int32_t room);

/* ---- filter/: the error-state filter and the bank of oscillators ---- */

/* The parts of the filter's state by their first index, and its size. estimator.ekf.state describes them. */
enum filter_state {
    DL_ATT_ERR = 0, DL_POS_REL = 3, DL_VEL = 6, DL_GYRO_BIAS = 9, DL_ACCEL_BIAS = 12, DL_VEL_SCALE = 15, DL_VESSEL_VEL = 16,
    DL_WAVES = 18, DL_PAD_YAW = 38, DL_YAW_RATE = 39, DL_DECK_TRIM = 40, DL_CAMERA_DELAY = 42, DL_CAMERA_MOUNT = 43,
    DL_BARO_OFFSET = 46, DL_ATT_BIAS = 47, DL_RANGE_OFFSET = 49, DL_WAVE_YAW = 50, DL_TURN_RATE = 51, DL_N = 52,
};

enum {
    /* The largest number of states that a linear-algebra function takes. */
    ORDER_MAX = DL_N,
    /* The largest number of measured numbers that a linear-algebra function takes. */
    ROWS_MAX = 9,
    /* The largest number of states on which one kind of aiding depends. */
    COLUMNS_MAX = 12,
    /* Number of kinds of aiding. */
    KINDS = 4,
    /* Directions in which a deck moves on waves: north, east, down, roll, pitch. */
    DIRECTIONS = 5,
    /* Number of different oscillators in the bank of a direction: the one at rest, then the others. */
    OSCILLATORS = 28,
    /* Number of sizes in which each oscillator but the one at rest comes; they lie side by side. */
    MEMBER_SIZES = 5,
    /* Number of states of a wave: displacement, rate, force, its rate. */
    WAVE_STATES = 4,
    /* Numbers of a wave's covariance: its upper triangle in rows. */
    WAVE_PAIRS = WAVE_STATES * (WAVE_STATES + 1) / 2,
    /* Number of oscillators of some size that the bank of each direction compares. */
    MEMBERS = 1 + (OSCILLATORS - 1) * MEMBER_SIZES,
    /* Number of states of one: displacement, rate, force, its rate; offset of the IMU's carrying on, its rate, acceleration. */
    MEMBER_STATES = 7,
    /* Numbers of a member's covariance, which is symmetric: its upper triangle in rows. */
    MEMBER_PAIRS = MEMBER_STATES * (MEMBER_STATES + 1) / 2,
    /* Number of horizons at which past forecasts are compared with what happened. */
    SKILL_HORIZONS = 3,
    /* The largest number of forecasts whose comparison is not over. */
    ISSUED_MAX = 9,
    /* The largest number of recent sightings whose innovations are compared with what the filter claimed. */
    EXCESSES_MAX = 24,
    /* Numbers of each: the excess along north, east, down, and how likely the ship accelerates north, east and in heading. */
    EXCESS_NUMBERS = 6,
};

/* Kinds of samples; the first KINDS are those of aiding. */
enum event_kind {
    DL_ATTITUDE, DL_VELOCITY, DL_RANGE, DL_HEIGHT, DL_IMU, DL_VESSEL, DL_SIGHTING,
};

enum verdict {
    DL_FUSED, DL_GATED, DL_SINGULAR, DL_LOW_CONFIDENCE,
};

/* The surface below a velocity sensor. */
enum velocity_surface {
    DL_OVER_GROUND, DL_OVER_PAD, DL_OVER_EITHER,
};

/* How far dl_filter_propagate goes: state and covariance to the instant, or with the means of all gathered samples fused as well. */
enum propagation {
    DL_WITH_COVARIANCE, DL_WITH_AIDING,
};

/* Members mean what those of Belief, Aid and Gathered in estimator.ekf.state, of DeckMotionBank and Skill of the same
 * names mean; matrices are in rows, instants are in ns. In a bank and its members, arrays are by direction, then by state or
 * pair of states, then by member of the bank. An answer has numbers of pad and deck where it has a pad, and of the body
 * where it has a body; estimator.ekf.answers describes them. A horizon_reach has, for one horizon and by oscillator,
 * the rows of the transition to displacement and rate, their noise, and the products of the numbers of these rows and of
 * the first one's change. A deck_ahead has what Forecast has for one horizon. */
typedef struct {
    double w[MEMBERS], zeta[MEMBERS], log_zeta[MEMBERS], log_prior[MEMBERS], sigma[DIRECTIONS * MEMBERS];
} dl_bank_members;

typedef struct {
    int64_t t;
    double waves[SKILL_HORIZONS * DIRECTIONS * 2];
} dl_issued_forecast;

typedef struct {
    int64_t issued_n;
    dl_issued_forecast issued[ISSUED_MAX];
    double n[SKILL_HORIZONS], product[SKILL_HORIZONS * DIRECTIONS * 2], square[SKILL_HORIZONS * DIRECTIONS * 2],
        came[SKILL_HORIZONS * DIRECTIONS * 2];
} dl_forecast_skill;

typedef struct {
    int64_t t;
    double w_rad_s[DIRECTIONS], zeta[DIRECTIONS], sigma[DIRECTIONS];
    dl_forecast_skill skill;
    double log_weight[DIRECTIONS * MEMBERS], weight[DIRECTIONS * MEMBERS], x[DIRECTIONS * MEMBER_STATES * MEMBERS],
        P[DIRECTIONS * MEMBER_PAIRS * MEMBERS];
} dl_bank;

typedef struct {
    int64_t hold_ns, velocity_is_over, reopen_count, sighting_has_attitude_error;
    double tick_s, forget_s, aiding_period_s, accel_step_m_s2, gyro_step_rad_s, deck_radius_m, not_measured_var,
        correlation_s[KINDS], nis_max[ROWS_MAX], psd[DL_N], psd_accel, psd_coast, psd_coast_turn, wave_yaw_rad_s,
        sigma_wave_yaw_rate_rad_s, carrying_psd_accel[DIRECTIONS], carrying_psd_drift[DIRECTIONS],
        carrying_psd_tilt[DIRECTIONS], min_confidence, reopen_s, heading_memory_s, sigma_turn_rate_rad_s,
        pad_yaw_in_vessel_rad;
    dl_bank_members members;
} dl_filter_params;

typedef struct {
    int64_t fused, refused, n, since, m, axes;
    double deck_weight, innov[3], R[9], ambiguity[9], spread[9], H[3 * COLUMNS_MAX];
} dl_aid;

typedef struct {
    int64_t n, t[EXCESSES_MAX];
    double values[EXCESS_NUMBERS * EXCESSES_MAX];
} dl_innovation_excesses;

typedef struct {
    int64_t n, since, last;
    double offset_ned[3], var_m2;
} dl_rejection_streak;

typedef struct {
    int64_t t, t_cov, t_imu, t_velocity, sighted, agreed, is_levelled, heading_is_given, heading_known, heading_seen,
        steered, swung;
    double R[9], x[DL_N], R_cov[9], dv[3], dp[3], turned[9], coast_s, w[3], w_smooth[3],
        f[3], levelled_by[9], cov_levelled_by[9], ins_p[3], ins_v[3], ins_var_m2_s2, jolt_var_m2_s2, jolt_var_rad2, over_pad,
        wave_w[5], wave_zeta[5], wave_sigma[5], nis_mean, nis_claimed, heading_held_s, vessel_before[2];
    dl_rejection_streak rejections;
    dl_aid aids[KINDS];
    dl_innovation_excesses excesses;
} dl_belief;

/* Half of a sample may be no measurement: for how long before it, s, nothing was measured by the gyro, the accelerometer. */
typedef struct {
    double w_body[3], f_body[3], gyro_lost_s, accel_lost_s;
} dl_imu;

typedef struct {
    double R_ned_body[9], cov_body[9];
} dl_attitude;

typedef struct {
    double v_level[3], cov_level[9];
} dl_velocity;

/* A range or a height, m. */
typedef struct {
    double measured_m, sigma_m;
} dl_distance;

typedef struct {
    int64_t has_velocity, has_heading;
    double v_ned[3], cov_v_ned[9], heading_rad, sigma_heading_rad;
} dl_vessel_report;

/* A sample, by its kind. A sighting is an event without a sample; the sighting itself is beside it. */
typedef struct {
    int64_t kind, t;
    union {
        dl_imu imu;
        dl_attitude attitude;
        dl_velocity velocity;
        dl_distance distance;
        dl_vessel_report vessel;
    } sample;
} dl_event;

typedef struct {
    int64_t has_yaw, yaw_ambiguous, has_pose6;
    double confidence, sigma_s, d_level[3], yaw_rad, cov[16], pose_d_level[3], pose_R[9], pose_cov[36];
} dl_sighting;

typedef struct {
    int64_t verdict, m, axes, has_S;
    double innov[6], S[36], nis, nis_max;
} dl_outcome;

typedef struct {
    double horizon_s, row[2 * WAVE_STATES * OSCILLATORS], noise[2 * OSCILLATORS], squares[3 * WAVE_PAIRS * OSCILLATORS];
} dl_horizon_reach;

typedef struct {
    double d[3], cov_d[9], v_pad[3], height, sigma_height, rise, sigma_rise, roll, sigma_roll, pitch, sigma_pitch;
} dl_deck_ahead;

typedef struct {
    int64_t has_pad, has_body, sighted, agreed, velocity_fused, heading_known, adrift, steers;
    double nis_mean, heading, d[3], v[3], yaw, cov[49], a_body[3], cov_a_body[9], w_body[3], levelled_by[9],
        cov_levelled_by[9], v_deck[3], a_deck[3], cov_deck[36], tilt[4], cov_tilt[16], x[DL_N], var[DL_N], cov_vessel,
        wave_w[DIRECTIONS], wave_zeta[DIRECTIONS], wave_sigma[DIRECTIONS];
} dl_answer;

/* A belief with its covariance (N, N) and its bank, each in memory of its own: later beliefs share what no event changed. */
typedef struct {
    const dl_belief *numbers;
    const double *P;
    const dl_bank *bank;
} dl_whole_belief;

/* The belief after an event, the event's outcome, and the indices of the belief's covariance and bank among those that dl_filter_run
 * wrote; -1 for the ones before all events. */
typedef struct {
    dl_belief after;
    dl_outcome outcome;
    int64_t P_index, bank_index;
} dl_filter_step;

/* Where dl_filter_run writes: a step and room for a covariance for each event, and room for a bank for each sighting. */
typedef struct {
    dl_filter_step *steps;
    double *P;
    dl_bank *banks;
} dl_filter_row;

/* Write the bank before any sighting. */
void dl_bank_begin(const dl_bank_members *m, dl_bank *out);
/* Write what a forecast needs of n horizons. It depends on nothing but them and the members, and serves any number of forecasts. */
void dl_bank_reach(const dl_bank_members *m, int32_t n, const double *horizons_s, dl_horizon_reach *out);
/* Process events in their order; those of kind SIGHTING take the sightings one by one. Return how many were processed: the next
 * one needs a belief that is set outright, or has no sighting left. A covariance or a bank that an event changed is written once. */
int32_t dl_filter_run(const dl_filter_params *o, int32_t n, const dl_event *events, int32_t sightings_n, const dl_sighting *sightings,
    const dl_whole_belief *before, const dl_filter_row *out);
/* Write the belief at instant t and its covariance; `what` is one of enum propagation. */
void dl_filter_propagate(const dl_filter_params *o, int32_t what, int64_t t, const dl_whole_belief *before, dl_belief *after,
    double *P_after);
/* Write the deck's forecast from instant t at n horizons; return 0 if no pad is tracked. */
int32_t dl_filter_forecast(const dl_filter_params *o, int64_t t, const dl_whole_belief *before, int32_t n,
    const dl_horizon_reach *reach, dl_deck_ahead *out);
/* Write what the filter says of instant t. */
void dl_filter_answer(const dl_filter_params *o, int64_t t, const dl_whole_belief *before, dl_answer *out);

/* ---- law/: the law that follows the deck ---- */

enum {
    /* The largest number of commands that the law remembers: 0.65 s at 200 cycles a second. */
    UNDER_WAY_MAX = 132,
    /* The largest number of horizons of a forecast that the law takes. */
    HORIZONS_MAX = 16,
};

/* companion.guidance.law_records says what the members mean where their names do not. Vectors are written in level, axes
 * and commands under way in axes that do not turn with the nose; delays are numbers of periods, commands come newest
 * first. */
typedef struct {
    int64_t remembered, over_ground, keeps_in_view, looks_ahead;
    double period_s, frequency_rad_s, damping, lag_s, tilt_max_m_s2, jerk_max_m_s3, climb_lag_s, climb_max_m_s, view_forward_m,
        view_right_m, half_forward_rad, half_right_rad;
} dl_law_params;

typedef struct {
    int64_t n, tilt_delay, climb_delay;
    double slowness_s, p, w, a, rate, lag, under_way[UNDER_WAY_MAX];
} dl_law_gains;

/* The observer's gains: rows for p, w, d and b, columns by place, speed and acceleration. */
typedef struct {
    double gains[4][3];
} dl_law_observer;

/* The law as it is flown in one cycle; the command goes over from gains_before to gains. */
typedef struct {
    dl_law_params params;
    dl_law_gains gains, gains_before;
    dl_law_observer observer;
} dl_law_in_use;

/* The horizons of a forecast, and the pad's velocity there in level. */
typedef struct {
    int64_t n;
    double horizons_s[HORIZONS_MAX], rates_m_s[HORIZONS_MAX][3];
} dl_law_course;

typedef struct {
    double p, w, d, b, lean, rate, lag, under_way[UNDER_WAY_MAX];
} dl_law_axis;

typedef struct {
    double p, w, lean, rate, a_body, a_deck;
} dl_axis_measured;

typedef struct {
    double own, lean, rate;
} dl_law_own;

typedef struct {
    int64_t begun, has_turn;
    double pushed_down_m_s2, turn_yaw_rad, turn_rate_rad_s, climbs[UNDER_WAY_MAX];
    dl_law_axis axes[2];
    dl_law_own own[2];
} dl_law_memory;

typedef struct {
    int64_t goes_on, steers, has_deck, has_yaw, has_rate, has_wanted_yaw, has_lean_max;
    double dt, share, forecast_age_s, heading_rad, d[3], v[3], yaw_rad, a_body[3], w_body[3], lean[2], v_deck[3], a_deck[3],
        wanted[3], rate_m_s, rate_max_m_s, speed_max_m_s, wanted_yaw_rad, lean_max_rad;
} dl_law_cycle;

typedef struct {
    double a[2], trim[2], v[3], yaw_rate_rad_s;
} dl_law_command;

/* Step one horizontal axis by dt with a measurement, and return the tilt to command over a still deck, m/s^2, by `gains` alone: what
 * the law's stability margins query. The command that has arrived is an acceleration. Return NAN if the law has no room for its
 * commands. */
double dl_law_axis_step(const dl_law_in_use *law, double dt, double arrived, const dl_law_axis *before,
    const dl_axis_measured *z, dl_law_axis *after);
/* Run one cycle. Where no target steers, the memory notes what the vehicle does and the command is zero. Return 0, and write nothing,
 * if the law has no room for its commands or for the horizons. */
int32_t dl_law_step(const dl_law_in_use *law, const dl_law_cycle *in, const dl_law_course *course, const dl_law_memory *before,
    dl_law_memory *after, dl_law_command *out);

/* ---- vision/register/: the drawing registered with a frame ---- */

enum {
    /* Kinds of edges, by the paints that meet. */
    EDGE_KINDS = 5,
    /* The largest number of regions whose paint differs from the one below. */
    PAD_CONTRASTS = 5,
    /* The largest number of circles that bound a region. */
    REGION_CIRCLES = 2,
    /* The largest number of figures made of rectangles and of what straight sides of any direction enclose. */
    PAD_FIGURES = 4,
    /* The largest number of limits of a figure's rectangles along one axis. */
    FIGURE_CUTS = 64,
    /* The largest number of rectangles of a figure. */
    FIGURE_RECTANGLES = 320,
    /* The largest number of a figure's straight sides of any direction. */
    FIGURE_SIDES = 64,
    /* The largest number of sides of a wedge. */
    WEDGE_SIDES = 4,
    /* Number of points of the pointer; at least one is in the frame if it can be seen. */
    POINTER_MARKS = 4,
};

/* A pad_region is what its circles (sums with a sign), its figure's rectangles, and the wedge cover. A figure's rectangles
 * lie between its limits along both axes, which ascend; its sides, whose inside is to the right of their direction seen
 * from above, go around what else it covers, which no rectangle does. A wedge is where all n p < offset, beyond a circle
 * about the centre. A pad_shape has the regions as painted (contrasts: paint over the one that each lies_on, -1 for the
 * surroundings) and the inside of each kind of edge (kinds); an edge_zone is where an edge of another kind is too near:
 * within and outside of two radii, in a box, anywhere if the blur is too wide for something thin, where the figure
 * on_figure does not cover a pixel wholly, and where beside_figure covers any of it (-1 for neither). The pointer is the
 * part of the drawing that distinguishes its two headings. The other structures have what Camera, Orientation and Registration
 * have. A camera_sighting is a pose in cam with the attitude and the mount; a level_sighting is the same pose in level: its
 * place, rotation and their covariance, the body's heading against the arrow, and the covariance of place and heading. */
typedef struct {
    int64_t circles, figure, has_wedge;
    double radius_m[REGION_CIRCLES], sign[REGION_CIRCLES];
} pad_region;

typedef struct {
    int64_t rectangles, x_cuts, y_cuts, sides, x0[FIGURE_RECTANGLES], x1[FIGURE_RECTANGLES], y0[FIGURE_RECTANGLES],
        y1[FIGURE_RECTANGLES];
    double x_m[FIGURE_CUTS], y_m[FIGURE_CUTS], from_x_m[FIGURE_SIDES], from_y_m[FIGURE_SIDES], to_x_m[FIGURE_SIDES],
        to_y_m[FIGURE_SIDES];
} pad_figure;

typedef struct {
    int64_t sides;
    double nx[WEDGE_SIDES], ny[WEDGE_SIDES], offset_m[WEDGE_SIDES], beyond_m;
} pad_wedge;

typedef struct {
    int64_t on_figure, beside_figure;
    double inside_m, outside_m, thinnest_m, box_m[4], box_radius_m;
} edge_zone;

typedef struct {
    int64_t contrast_count, pointer_kind, pointer_contrast, pointer_figure, lies_on[PAD_CONTRASTS],
        contrast_of_kind[EDGE_KINDS], paint_of_kind[EDGE_KINDS];
    double disc_radius_m, half_length_m, pointer_clear_m, gap_m, pointer_marks_m[2 * POINTER_MARKS], nominal[3 * EDGE_KINDS];
    pad_region contrasts[PAD_CONTRASTS], kinds[EDGE_KINDS];
    pad_figure figures[PAD_FIGURES];
    pad_wedge wedge;
    edge_zone zones[EDGE_KINDS];
} pad_shape;

/* A lens: Brown's distortion k1, k2, p1, p2, k3, or a fisheye's k1, k2, k3, k4. focal_sigma is the standard deviation of the
 * focal length as a fraction of it. */
typedef struct {
    int64_t width, height, distorted, fisheye;
    double fx, fy, cx, cy, distortion[5], focal_sigma, R_body_cam[9];
} camera_lens;

typedef struct {
    int64_t given;
    double roll_rad, pitch_rad, cov_tilt[4], sigma_deck_rad;
} tilt_prior;

typedef struct {
    double contrast_bgr[3], snr, in_view, inliers, likeness;
} edge_support;

typedef struct {
    int64_t dense, yaw_ambiguous;
    double R[9], t[3], cov[36], information[36], blur_px2[3], noise_light, edge_rms_px, visible, inliers, last_step_px;
    edge_support edges[EDGE_KINDS];
} registration;

typedef struct {
    double roll_rad, pitch_rad, cov_tilt[4], sigma_deck_rad, R_body_cam[9], t_body_cam[3], R_cam_pad[9], t_cam_pad[3],
        cov_pose[36];
} camera_sighting;

typedef struct {
    double d[3], R_level_pad[9], cov_pose[36], yaw_rad, cov[16];
} level_sighting;

/* Bring a pose to level. */
void dl_sighting_in_level(const camera_sighting *in, level_sighting *out);

/* ---- vision/align/: the whole drawing aligned with a frame ---- */

enum {
    /* The highest level of a frame's pyramid: level k is 2**k times smaller. */
    FRAME_LEVELS = 5,
    /* Number of maps of the drawing, each blurred more than the one before. */
    TEMPLATE_BLURS = 5,
    /* Value of full coverage in a map. */
    TEMPLATE_ONE = 16384,
};

/* The verification's features; estimator.vision.detect.verification describes them. */
enum align_feature {
    FEATURE_ONE, FEATURE_H_MARKING, FEATURE_RING, FEATURE_EDGE, FEATURE_H_MARKING_ALL, FEATURE_RING_ALL, FEATURE_EDGE_ALL,
    FEATURE_H_AND_RING, FEATURE_H_AND_EDGE, FEATURE_RING_AND_EDGE, FEATURE_TWO_OF_THREE, FEATURE_SOME_RING, FEATURE_SOME_EDGE,
    FEATURE_SOME_TWO, FEATURE_H_ALONE, FEATURE_NO_H, FEATURE_NO_RING, FEATURE_NO_EDGE, FEATURE_RING_LAGS, FEATURE_FLANKS,
    FEATURE_ARROW, FEATURE_NO_ARROW, FEATURE_TEMPLATE_GAIN, FEATURE_INLIERS, FEATURE_WHITE, FEATURE_ORANGE_PLACE,
    FEATURE_ORANGE_ODD, FEATURE_DISC_PLACE, FEATURE_SIZE, FEATURE_IN_VIEW, FEATURE_TILT, FEATURES,
};

/* A pad_pose takes the pad's axes to the camera's. In pad_template, a map has n rows along x and n columns along y, and the
 * centre in its middle; log_blur are the logarithms of the maps' standard deviations, m; h_side is -1 in a channel in which
 * the H is darker than the disc, else 1. A dl_alignment moves a pose by this many steps of Gauss and Newton, with the light minus
 * its mean in the neighbourhood (local) and on the half of the disc on one side alone, if that is requested; the first half of the
 * steps use a drawing blurred twice as much. Then the drawing is verified at the pose, or with cover only the line is looked
 * for beyond which something covers the pad. In aligned_pad, paints are (4, 3); arrow has found, seen and clear at its place
 * and at the opposite one; light_* are number, mean and variance of the light's logarithm where one paint shows alone. A cut is
 * a line across the frame: rays (x, y) with cut[0] x + cut[1] y + cut[2] < 0 do not count, so that zeros cut nothing off; the
 * first two are a unit vector. In cover_line, gain is by how much the logarithm of the residuals' variance falls, on average,
 * if what lies beyond the cut is another thing of one colour, and left the share of the light's variation that the drawing
 * leaves on this side of it. */
typedef struct {
    double R[9], t[3];
} pad_pose;

typedef struct {
    int64_t n, disc_channel, arrow_rows, arrow_columns, disc_drawn;
    double per_m, log_blur[TEMPLATE_BLURS], local_m, reach_m, disc_radius_m, disc_edge_m, h_half_length_m, h_half_width_m,
        ring_inner_m, ring_outer_m, arrow_tip_m, arrow_depth_m, arrow_half_base_m, arrow_margin_m, arrow_pitch_m,
        orange_place[3], h_side[3];
} pad_template;

typedef struct {
    int64_t steps, local, one_side, cover;
    double sigma_tilt_rad, side[2], cut[3];
} dl_alignment;

typedef struct {
    double cut[3], gain, left;
} cover_line;

/* Support of a pad's drawing: the log-likelihood ratio of the light about it against light of the same variation without it
 * (support), what that would be if all followed the drawing (could), and the shares of this by cells that follow it and by cells
 * where it makes the light less likely. Pixels that share a blur count once; a cell that may be hidden counts little against. */
typedef struct {
    double support, could, share, against;
} drawing_support;

typedef struct {
    double paints[12], local_paints[12], sample_m, in_view, tilt_sigmas, arrow[6], features[FEATURES], light_n[4],
        light_mean[12], light_var[12];
    cover_line cover;
    drawing_support support;
} aligned_pad;

/* ---- vision/look/: a registration, verified ---- */

/* The inputs of the verification of a registration; estimator.vision.register.fit_verification describes them. The
 * weights of the first EVIDENCE_FITTED are fitted, the others are set by hand. */
enum look_evidence {
    EVIDENCE_ONE, EVIDENCE_TEMPLATE_SCORE, EVIDENCE_INLIERS, EVIDENCE_DISC_OFF, EVIDENCE_RING_OFF, EVIDENCE_H_OFF,
    EVIDENCE_RING_UNSEEN, EVIDENCE_H_UNSEEN, EVIDENCE_DENSE, EVIDENCE_DENSE_INLIERS, EVIDENCE_RMS, EVIDENCE_VISIBLE,
    EVIDENCE_DENSE_TEMPLATE_SCORE, EVIDENCE_DENSE_DISC, EVIDENCE_DENSE_ORANGE, EVIDENCE_NO_RING, EVIDENCE_NO_H,
    EVIDENCE_DISC_UNSEEN, EVIDENCE_PAINTED, EVIDENCE_NO_DISC, EVIDENCE_H_CONTRAST_ODD, EVIDENCE_DISAGREES,
    EVIDENCE_NOT_BRIGHTER, EVIDENCE_CORNER, EVIDENCE_EDGES_ASTRAY, EVIDENCE_H_ASTRAY, EVIDENCE_HALF_DISAGREES,
    EVIDENCE_NO_H_IN_VIEW, EVIDENCE_H_DISAGREES, EVIDENCE,
};

enum { EVIDENCE_FITTED = EVIDENCE_DENSE_ORANGE + 1 };

/* A pad_judge has what the verification knows of a pad, by channel the H's nominal side of the disc and the ring's place
 * between disc (0) and H (1), the weights of the template's model, and those of the second model where a search led to the
 * place and where a track did. A pad_paint has what is known of the logarithm of each paint's light, (4, 3). In a looked_pad,
 * paint is what is known of the paints if this is the pad, and log_odds is without priors. A dl_start is a pose to register
 * the drawing from: coarse if it is approached on a reduced frame first, with a tilt of so much; registered alone, nothing is
 * verified. coded_px is what a video codec may have moved, and rays beyond the cut do not count. */
typedef struct {
    int64_t has_field, has_ring, has_letters, has_fiducials, disc_has_colour;
    double orange_side[3], orange_place[3], template_weights[FEATURES], searched[EVIDENCE], tracked[EVIDENCE];
} pad_judge;

typedef struct {
    double mean[12], var[12], trust;
} pad_paint;

typedef struct {
    registration found;
    aligned_pad aligned;
    level_sighting seen;
    pad_paint paint;
    double evidence[EVIDENCE], log_odds;
} looked_pad;

typedef struct {
    pad_pose pose;
    tilt_prior prior;
    pad_paint known;
    int64_t coarse, tracked, alone;
    double sigma_tilt_rad, coded_px, cut[3];
} dl_start;

/* ---- vision/lamps/: a lit pad ---- */

enum {
    /* The largest number of lamps of a pad. */
    LAMPS = 40,
    /* The largest number of pairs of lamps that a search tries. */
    LAMP_PAIRS = 20,
    /* At most this many of a frame's brightest spots are kept. */
    LAMP_SPOTS = 40,
};

/* A lamp_pattern has places and radii of the lamps, the pairs that a search tries, and the standard deviation of the pattern's
 * size at its outermost lamp. reach_px is how far the pad may be from where it is expected. In lamps_seen, cov is of the
 * place and of a small rotation of the pad, both in cam; log10_odds are those that these spots are the pad's lamps and no
 * other lights; uv_px has the lit spots that are lamps. */
typedef struct {
    int64_t lamps, pairs, pair[2 * LAMP_PAIRS];
    double x_m[LAMPS], y_m[LAMPS], radius_m[LAMPS], size_sigma_m;
} lamp_pattern;

typedef struct {
    pad_pose pose;
    double reach_px;
} lamps_expected;

typedef struct {
    int64_t lit;
    pad_pose pose;
    level_sighting seen;
    double cov[36], confidence, log10_odds, uv_px[2 * LAMP_SPOTS];
} lamps_seen;

/* ---- vision/search/: the pad in a whole frame ---- */

enum {
    /* Side of the blocks of a frame in which contrast is compared and the plane is taken as flat, px. */
    SEARCH_BLOCK = 16,
    /* Side of the cells that votes are counted in, px. */
    SEARCH_CELL = 2,
    /* The largest number of radii of one search. */
    SEARCH_RADII = 12,
    /* Sectors of a circle in which an edge is looked for; each gives one point of the outline. */
    SEARCH_SECTORS = 36,
    /* Sizes of a frame that guesses are compared at: full, half, quarter ... size. */
    SEARCH_LEVELS = 5,
    /* Polar cells of the drawing. */
    POLAR_RADII = 18,
    POLAR_ANGLES = 48,
};

/* A dl_circle_search is for circles of edges in a grey image step times smaller than the frame, whose centres may lie in a
 * margin around it, px. Their radii are least in the plane that the pad is taken to lie in, at unit distance from the lens, and
 * those that follow, each ratio times the one before; it may be for circles that are bright inside only. Of outlines of areas
 * only the plane counts, the largest number, and whether the frame's channels are equal (grey). A search_circle lies in the
 * plane; support is the fraction of its outline with an edge, and outline_px has their places in the frame, px. A polar_pad has
 * the drawing in polar cells, radius by radius: places, area within the disc's paint, and coverage. polarity is 1 where the H is
 * brighter than the disc, else -1. A dl_guess_search has the plane, whether its tilt is known, the largest number of guesses,
 * and the circles of the drawing: radius, and 1 if it is brighter inside, -1 if darker, 0 if that depends on the deck. A
 * search_guess is a pose, the angle by which it is to be turned about its own z axis, the fraction of the variance that the
 * drawing explains there, the support of the circle that it came from, and in x and y of the turned pad the direction of the
 * half of the disc that counts, if only one does. pad_strokes are the sizes of the H and the width of the disc around it that
 * counts; a dl_stroke_search is in an image step times smaller than the frame, in which the marks may be bright or dark. */
typedef struct {
    int64_t step, margin, radii, most, only_bright, grey;
    double least, ratio, R_cam_plane[9];
} dl_circle_search;

typedef struct {
    int64_t bright_inside, points;
    double centre[2], radius, support, outline_px[2 * SEARCH_SECTORS];
} search_circle;

typedef struct {
    double xy_m[2 * POLAR_RADII * POLAR_ANGLES], area_inside[POLAR_RADII], ring[POLAR_RADII],
        h_marking[POLAR_RADII * POLAR_ANGLES], arrow[POLAR_RADII * POLAR_ANGLES], polarity, radius_m;
} polar_pad;

typedef struct {
    double turn_rad, score, arrow, in_view;
} polar_fit;

typedef struct {
    int64_t plane_known, radii, most, before;
    double R_cam_plane[9], radius_m[4], sign[4];
} dl_guess_search;

typedef struct {
    double length_m, width_m, leg_m, bar_m, margin_m;
} pad_strokes;

typedef struct {
    int64_t step, bright, plane_known, most;
    double R_cam_plane[9];
} dl_stroke_search;

typedef struct {
    int64_t known, one_sided;
    double R[9], t[3], turn_rad, drawing, support, side[2];
} search_guess;

/* ---- vision/: what follows one pad in the frames of one camera ---- */

/* Rows of pixels of this many channels, one byte each; stride is from row to row, bytes. */
typedef struct {
    int64_t width, height, stride, channels;
    const uint8_t *px;
} dl_image;

/* What a frame can show: the standard deviation of its noise beyond a camera's usual, 1 is full scale; its contrast; and the
 * largest difference between the channels of a pixel. */
typedef struct {
    double noise, contrast, chroma;
} frame_quality;

/* A frame in BGR at full, half, quarter ... size. The first is the camera's; px is null for sizes that were not made. */
typedef struct {
    dl_image level[FRAME_LEVELS + 1];
    frame_quality quality;
} dl_frame;

/* A camera, its place in the body, and for each value of a pixel its linear light, 0 to 1, and log1p of that over a floor. */
typedef struct {
    camera_lens lens;
    double t_body_cam[3], light[256], log_light[256];
} dl_camera;

/* A pad's drawing: regions, maps, polar cells, the strokes of its H, what the verification knows of it, the standard deviation
 * of its painted sizes, and the number of points on its edges. */
typedef struct {
    pad_shape shape;
    pad_template drawn;
    polar_pad polar;
    pad_strokes strokes;
    pad_judge judge;
    double size_sigma_m;
    int64_t edge_points;
} dl_pad;

/* Holds what stays the same from frame to frame, and all memory that is worked in. One thread at a time may use it. */
typedef struct dl_tracker dl_tracker;

/* Make a tracker, which keeps addresses and not copies of: rays, those of all pixels, (height, width, 2), null if the lens does
 * not distort; the maps of coverage by each paint and of coverage minus its mean in the neighbourhood, (TEMPLATE_BLURS, n, n, 4)
 * each; edges, (edge_points, 5), the place, the normal and the distance to the next point; edge_of, (edge_points, 2), its kind
 * and piece. All but camera and rays may be null for what needs no drawing. Return null without memory, or if a size or a
 * number of a part is none. */
dl_tracker *dl_tracker_new(const dl_camera *camera, const double *rays, const dl_pad *pad, const int16_t *coverage,
    const int16_t *local, const double *edges, const int32_t *edge_of);
void dl_tracker_free(dl_tracker *t);

/* The entries below return a number of results, or 1 or 0 for one or none; DL_WRONG_SIZE of what the tracker does not hold. */
enum { DL_WRONG_SIZE = -2 };

/* Measure what a frame can show. */
int32_t dl_frame_quality(const dl_image *image, frame_quality *out);

/* Draw a plane as seen from above, (n, n, channels) with n = (nodes - 1) between + 1, from where points of it are in an image of
 * three channels, (nodes, nodes, 2) px: the picture, or of one channel the green of it, and 255 where the image shows it, (n, n). Return n. */
int32_t dl_from_above(const dl_image *image, const float *places, int32_t nodes, int32_t between, int32_t channels, uint8_t *out,
    uint8_t *shown);

/* Take from the light of one paint's cells, (cells, 3), what light can make of that paint, and a plane over their places, (cells, 2):
 * out gets the rest, (cells, 3) of the paint's light. white is the light of white; spare has room for two numbers a cell. */
int32_t dl_paint_rest(const float *light, const float *place, int32_t cells, const float *white, float *out, float *spare);

/* Look at where the pad may lie: register the drawing from a start, verify it there, and bring it to level. outline takes the
 * pixel of every fourth point of the edges; there are outline_points of them. */
int32_t dl_look(dl_tracker *t, const dl_frame *frame, const dl_start *start, looked_pad *out, double *outline,
    int64_t outline_points);

/* Align the drawing with a frame from a pose, which moves. */
int32_t dl_align(dl_tracker *t, const dl_frame *frame, const dl_alignment *how, pad_pose *pose, aligned_pad *out);

/* Find circles, most prominent first: of edges in a grey image, or if that is null outlines of areas of a frame at full and half
 * size. rays are those of the corners of the image's blocks, (rows + 1, columns + 1, 2). */
int32_t dl_search_circles(dl_tracker *t, const dl_frame *frame, const dl_image *grey, const float *rays,
    const dl_circle_search *how, search_circle *out);

/* Guess poses from circles, likeliest first. rated has for each circle how many guesses of it are in before, one circle's after
 * the other's, or -1; it gets that number for each circle whose guesses were computed and are complete. */
int32_t dl_search_guesses(dl_tracker *t, const dl_frame *frame, const dl_guess_search *how, int32_t circles,
    const search_circle *circle, int64_t *rated, const search_guess *before, search_guess *out);

/* Find the heading of the drawing at a pose, in an image step times smaller than the frame. side is null, or the direction on the
 * pad of the half of the disc that counts. */
int32_t dl_search_heading(dl_tracker *t, const dl_image *image, int32_t step, const pad_pose *pose, const double *side,
    polar_fit *out);

/* Find the strokes of the H in an image, likeliest places first. */
int32_t dl_search_strokes(dl_tracker *t, const dl_image *image, const dl_stroke_search *how, search_guess *out);

/* Look for lamps where the pad is expected, and in the whole frame if it is not there, or at is null. Return -1 if the frame has
 * more bright places than a dark deck. */
int32_t dl_find_lamps(dl_tracker *t, const dl_image *image, const lamp_pattern *pad, const tilt_prior *prior,
    const lamps_expected *at, lamps_seen *out);

#endif
