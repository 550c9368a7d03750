/* The interface of the library that flies. Python's side is made from this file.
 *
 * It is plain C99 that the binding generator reads too: structures, enumerations with their values, and prototypes. Lengths that
 * both sides need are named here. Matrices are row-major; what an entry writes overlaps nothing that it reads. */
#ifndef DECKLANDER_H
#define DECKLANDER_H

#include <stdbool.h>
#include <stdint.h>

/* The digest of this file, by which a library and the Python code that calls it know each other. */
uint32_t dl_digest(void);

/* ---- video/: the AR.Drone 1.0's pictures ---- */

/* The results of reading a picture. */
enum dl_uvlc_result {
    DL_UVLC_DONE,
    /* The data are shorter than a header. */
    DL_UVLC_SHORT,
    /* They do not begin as a picture does. */
    DL_UVLC_NO_PICTURE,
    /* The picture's size is none that is decoded. */
    DL_UVLC_SIZE,
    /* The picture is coded as the change of another one. */
    DL_UVLC_INTER,
    /* The data end before the picture does. */
    DL_UVLC_TORN,
    /* They hold a code that the format does not have. */
    DL_UVLC_BAD_CODE,
};

/* The size of the largest picture, px. */
enum { DL_UVLC_WIDTH_MAX = 640, DL_UVLC_HEIGHT_MAX = 480 };

/* A picture's header. */
typedef struct {
    int64_t width, height; /* Size, px. */
    bool intra;            /* The picture needs no other one. */
    int64_t quantizer;     /* Step of the quantization, 0 to 31. */
    int64_t number;        /* The sender's count of pictures. */
} dl_uvlc_picture;

/* Read a picture's header. */
enum dl_uvlc_result dl_uvlc_header(const uint8_t *data, int32_t bytes, dl_uvlc_picture *picture);

/* Decode a picture whose header is known into (height, width, 3) bytes; `room` is how many there are. If it fails, they hold a part
 * of it. */
enum dl_uvlc_result dl_uvlc_decode(const uint8_t *data, int32_t bytes, const dl_uvlc_picture *picture, uint8_t *bgr, int32_t room);

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
    /* In place of an index where there is nothing to point to. */
    DL_NONE = -1,
    /* Kinds of edges, by the paints that meet: the disc's edge, ring, pointer, lettering, lettering of a second paint. */
    DL_EDGE_KINDS = 5,
    /* The largest number of regions whose paint differs from the one below. */
    DL_PAD_CONTRASTS = 5,
    /* The largest number of circles that bound a region. */
    DL_REGION_CIRCLES = 2,
    /* The largest number of figures made of rectangles and of what straight sides of any direction enclose. */
    DL_PAD_FIGURES = 4,
    /* The largest number of limits of a figure's rectangles along one axis. */
    DL_FIGURE_CUTS = 64,
    /* The largest number of rectangles of a figure. */
    DL_FIGURE_RECTANGLES = 320,
    /* The largest number of a figure's straight sides of any direction. */
    DL_FIGURE_SIDES = 64,
    /* The largest number of sides of a wedge. */
    DL_WEDGE_SIDES = 4,
    /* Number of points of the pointer; at least one is in the frame if it can be seen. */
    DL_POINTER_MARKS = 4,
};

/* A painted region: the sum of what its circles, its figure and the wedge cover. */
typedef struct {
    int64_t circles;                    /* Number of circles. */
    int64_t figure;                     /* Index of its figure, or DL_NONE. */
    bool has_wedge;                     /* The pad's wedge belongs to it. */
    double radius_m[DL_REGION_CIRCLES]; /* Radii of the circles about the centre, m. */
    double sign[DL_REGION_CIRCLES];     /* 1 for a circle that adds its disc, -1 for one that takes it away. */
} dl_pad_region;

/* A figure of rectangles, and of what straight sides enclose; neither covers a part of the other. */
typedef struct {
    int64_t rectangles;                                          /* Number of rectangles. */
    int64_t x_cuts, y_cuts;                                      /* Number of limits along x and along y. */
    int64_t sides;                                               /* Number of straight sides. */
    int64_t x0[DL_FIGURE_RECTANGLES], x1[DL_FIGURE_RECTANGLES];  /* First and last limit of each rectangle, indices in x_m. */
    int64_t y0[DL_FIGURE_RECTANGLES], y1[DL_FIGURE_RECTANGLES];  /* The same along y, indices in y_m. */
    double x_m[DL_FIGURE_CUTS], y_m[DL_FIGURE_CUTS];             /* The limits, ascending, m. */
    double from_x_m[DL_FIGURE_SIDES], from_y_m[DL_FIGURE_SIDES]; /* Where each side begins, m; inside is to the right of it, */
    double to_x_m[DL_FIGURE_SIDES], to_y_m[DL_FIGURE_SIDES];     /* seen from above, on the way to where it ends, m. */
} dl_pad_figure;

/* A convex wedge, where n p < offset for all its sides, beyond a circle about the centre. */
typedef struct {
    int64_t sides;                                 /* Number of sides. */
    double nx[DL_WEDGE_SIDES], ny[DL_WEDGE_SIDES]; /* Unit normal of each, outward. */
    double offset_m[DL_WEDGE_SIDES];               /* Distance of each from the centre, m. */
    double beyond_m;                               /* Radius of the circle, m. */
} dl_pad_wedge;

/* Where an edge of another kind is too near for an edge to be measured. */
typedef struct {
    int64_t on_figure;     /* Where this figure does not cover a pixel wholly, or DL_NONE. */
    int64_t beside_figure; /* Where this figure covers a part of a pixel, or DL_NONE. */
    double inside_m;       /* Within this radius, m. */
    double outside_m;      /* Outside of this radius, m. */
    double thinnest_m;     /* Anywhere, where the blur is too wide for something as thin as this, m. */
    double box_m[4];       /* In a box: least and greatest x, least and greatest y, m, */
    double box_radius_m;   /* and nearer to the centre than this, m. */
} dl_edge_zone;

/* A pad as painted. */
typedef struct {
    int64_t contrast_count;                       /* Number of painted regions. */
    int64_t pointer_kind;                         /* Kind of the pointer's edges, or DL_NONE. It tells headings apart. */
    int64_t pointer_contrast;                     /* Index of the region that the pointer belongs to, or DL_NONE. */
    int64_t pointer_figure;                       /* Index of the pointer's figure. */
    int64_t lies_on[DL_PAD_CONTRASTS];            /* The region that each lies on, or DL_NONE for the surroundings. */
    int64_t contrast_of_kind[DL_EDGE_KINDS];      /* The region that edges of each kind bound, or DL_NONE for a missing kind. */
    int64_t paint_of_kind[DL_EDGE_KINDS];         /* The kind whose paint is inside of the edges of each kind. */
    double disc_radius_m;                         /* Radius of the whole pad, m. */
    double half_length_m;                         /* Half of the lettering's length, m. */
    double pointer_clear_m;                       /* Radius within which no part of the pointer lies, m. */
    double gap_m;                                 /* Least distance of edges of different kinds, m. */
    double pointer_marks_m[2 * DL_POINTER_MARKS]; /* Points of the pointer, (DL_POINTER_MARKS, 2) m. */
    double nominal[3 * DL_EDGE_KINDS];            /* BGR unit vectors from the paint below to that inside, 0 if unknown. */
    dl_pad_region contrasts[DL_PAD_CONTRASTS];    /* The regions as painted, each over the one that it lies on. */
    dl_pad_region kinds[DL_EDGE_KINDS];           /* The inside of each kind of edge. */
    dl_pad_figure figures[DL_PAD_FIGURES];        /* The figures of all regions. */
    dl_pad_wedge wedge;                           /* The wedge of all regions that have one. */
    dl_edge_zone zones[DL_EDGE_KINDS];            /* Where edges of each kind cannot be measured. */
} dl_pad_shape;

/* A camera's lens and its direction. */
typedef struct {
    int64_t width, height; /* Size of its frames, px. */
    bool distorted;        /* The lens distorts. */
    bool fisheye;          /* It is a fisheye, else Brown's model holds. */
    double fx, fy;         /* Focal lengths, px. */
    double cx, cy;         /* Principal point, px; the middle of the top left pixel is at 0, 0. */
    double distortion[5];  /* k1, k2, p1, p2, k3; of a fisheye k1, k2, k3, k4. */
    double focal_sigma;    /* Standard deviation of the focal length, as a fraction of it. */
    double R_body_cam[9];  /* Its rotation in the body. */
} dl_lens;

/* What is known of the tilt of body and deck. */
typedef struct {
    bool given;                 /* Something is known. */
    double roll_rad, pitch_rad; /* The body's roll and pitch at the exposure, rad. */
    double cov_tilt[4];         /* Their covariance, rad^2. */
    double sigma_deck_rad;      /* Standard deviation of the deck's tilt, rad. */
} dl_tilt_prior;

/* A frame's support for one kind of edge. */
typedef struct {
    double contrast_bgr[3]; /* Linear light inside minus outside, 1 is full scale. */
    double snr;             /* Contrast over its standard deviation, for the best mixture of channels. */
    double in_view;         /* Fraction of these edges within the frame. */
    double inliers;         /* Fraction of those within it that agree with the drawing. */
    double likeness;        /* Cosine between the contrast and the nominal one, 1 where that is unknown. */
} dl_edge_support;

/* A pose registered with a frame. Covariances are of its place, m, and of a small rotation of the pad, rad, in cam. */
typedef struct {
    bool dense;                           /* Fitted to all pixels of the disc, not to profiles across edges. */
    bool yaw_ambiguous;                   /* No pointer has resolved the headings. */
    double R[9], t[3];                    /* R_cam_pad, and the pad's centre in cam, m. */
    double cov[36];                       /* Covariance of the pose, with the prior. */
    double information[36];               /* Information on the pose by the frame alone. */
    double blur_px2[3];                   /* Covariance uu, uv, vv of the point spread at the pad beyond a pixel's square, px^2. */
    double noise_light;                   /* Standard deviation of the residuals, linear light. */
    double edge_rms_px;                   /* Displacement of the edges beyond what noise explains, rms, px. */
    double visible;                       /* Fraction of the drawing's edges within the frame. */
    double inliers;                       /* Fraction of those that agree with it. */
    double last_step_px;                  /* Length of the last step, px; small if converged. */
    dl_edge_support edges[DL_EDGE_KINDS]; /* The support for each kind of edge. */
} dl_registration;

/* A pose in cam, with the attitude and the mount. */
typedef struct {
    double roll_rad, pitch_rad;          /* The body's roll and pitch, rad. */
    double cov_tilt[4];                  /* Their covariance, rad^2. */
    double sigma_deck_rad;               /* Standard deviation of the deck's tilt, rad. */
    double R_body_cam[9], t_body_cam[3]; /* The camera's rotation and place in the body, m. */
    double R_cam_pad[9], t_cam_pad[3];   /* The pose; m. */
    double cov_pose[36];                 /* Its covariance. */
} dl_camera_sighting;

/* A pose in level. */
typedef struct {
    double d[3];           /* The pad's centre from the body's origin, m. */
    double R_level_pad[9]; /* The pad's rotation. */
    double cov_pose[36];   /* Covariance of place, m, and of a small rotation of the pad, rad, in level. */
    double yaw_rad;        /* The body's heading against the pad's arrow, rad. */
    double cov[16];        /* Covariance of place, m, and heading, rad. */
} dl_level_sighting;

/* Bring a pose to level. */
void dl_sighting_in_level(const dl_camera_sighting *in, dl_level_sighting *out);

/* ---- vision/align/: the whole drawing aligned with a frame ---- */

enum {
    /* The highest level of a frame's pyramid: level k is 2**k times smaller. */
    DL_FRAME_LEVELS = 5,
    /* Number of maps of the drawing, each blurred more than the one before. */
    DL_TEMPLATE_BLURS = 5,
    /* Value of full coverage in a map. */
    DL_TEMPLATE_ONE = 16384,
    /* Number of the verification's features (vision/align/align.h); estimator.vision.detect.verification has their names. */
    DL_FEATURES = 31,
};

/* A pose of the pad in cam. */
typedef struct {
    double R[9]; /* R_cam_pad. */
    double t[3]; /* The pad's centre, m. */
} dl_pad_pose;

/* The lengths of a drawing and of its maps, whose paints are lettering, ring or arrowhead, disc, surroundings. */
typedef struct {
    int64_t n;                               /* Rows (along x) and columns (along y) of a map, with the centre in its middle. */
    int64_t disc_channel;                    /* Channel (0 is blue) in which the disc is brightest. */
    int64_t arrow_rows, arrow_columns;       /* Samples about the arrowhead along x and along y. */
    bool disc_drawn;                         /* The disc has a paint of its own. */
    double per_m;                            /* Cells of a map for each metre. */
    double log_blur[DL_TEMPLATE_BLURS];      /* Logarithms of the maps' standard deviations, m. */
    double local_m;                          /* Standard deviation of the neighbourhood whose mean is subtracted, m. */
    double reach_m;                          /* Half of a map's side, m. */
    double disc_radius_m;                    /* Radius of the whole pad, m. */
    double disc_edge_m;                      /* Radius at which the disc's own paint ends, m. */
    double h_half_length_m, h_half_width_m;  /* Half of the lettering's length (along x) and width, m. */
    double ring_inner_m, ring_outer_m;       /* The ring's radii, m; 0 without one. */
    double arrow_tip_m;                      /* Distance of the arrowhead's tip from the centre, m; 0 without one. */
    double arrow_depth_m, arrow_half_base_m; /* Its depth along x, and half of its base, m. */
    double arrow_margin_m;                   /* Width of the border around it that is compared with it, m. */
    double arrow_pitch_m;                    /* Distance between samples about it, m. */
    double orange_place[3];                  /* Place of the ring's paint from disc (0) to lettering (1), roots of light, BGR. */
    double h_side[3];                        /* -1 for a channel in which the lettering is darker than the disc, else 1. */
} dl_pad_template;

/* How to align. Steps are Gauss and Newton's; the first half of them uses a drawing blurred twice as much.
 *
 * A cut is a line across the frame: rays (x, y) with cut[0] x + cut[1] y + cut[2] < 0 do not count, so that zeros cut nothing off;
 * the first two are a unit vector. */
typedef struct {
    int64_t steps;         /* Number of steps; 0 leaves the pose. */
    bool local;            /* Use the light minus its mean in the neighbourhood. */
    bool one_side;         /* Use only the half of the disc towards `side`. */
    bool cover;            /* Do not verify the drawing, but find the line beyond which something covers the pad. */
    double sigma_tilt_rad; /* Standard deviation of the start's tilt, rad. */
    double side[2];        /* Unit direction on the pad. */
    double cut[3];         /* The cut. */
} dl_alignment;

/* The line beyond which something may cover the pad. */
typedef struct {
    double cut[3]; /* The line, as a cut. */
    double gain;   /* Mean fall of the logarithm of the residuals' variance, if a thing of one colour lies beyond it. */
    double left;   /* Share of the light's variation on this side of it that the drawing leaves. */
} dl_cover_line;

/* Support of a frame for the drawing. Pixels that share a blur count once; a cell that may be hidden counts little against. */
typedef struct {
    double support; /* Log-likelihood ratio of the light with the drawing against light of the same variation without it. */
    double could;   /* What that would be if all of the light followed the drawing. */
    double share;   /* Share of this by cells that follow the drawing. */
    double against; /* Share of this by cells in which the drawing makes the light less likely. */
} dl_drawing_support;

/* A drawing aligned with a frame. Paints are (4, 3), each in blue, green and red. */
typedef struct {
    double paints[12];            /* Linear light of each paint, 1 is full scale. */
    double local_paints[12];      /* Roots of light of each paint, minus the mean in the neighbourhood. */
    double sample_m;              /* Side of a sample on the pad, m. */
    double in_view;               /* Fraction of the disc's area within the frame. */
    double tilt_sigmas;           /* Tilt against the start's, in standard deviations. */
    double arrow[6];              /* Found, seen and clear (0 to 1) at the arrowhead's place, then at the opposite one. */
    double features[DL_FEATURES]; /* Inputs of the verification. */
    double light_n[4];            /* Number of pixels where one paint shows alone, by paint, */
    double light_mean[12];        /* mean of the logarithm of their light, */
    double light_var[12];         /* and its variance. */
    dl_cover_line cover;          /* The line of a search for a cover. */
    dl_drawing_support support;   /* Support for the drawing. */
} dl_aligned_pad;

/* ---- vision/look/: a registration, verified ---- */

/* Number of inputs of the verification of a registration (vision/look/look.h), whose names
 * estimator.vision.register.fit_verification has. */
enum { DL_EVIDENCE = 29 };

/* What the verification knows of a pad. */
typedef struct {
    bool has_field;                       /* The disc has a paint of its own. */
    bool has_ring;                        /* There is a ring, */
    bool has_letters;                     /* lettering, */
    bool has_fiducials;                   /* a fiducial marker. */
    bool disc_has_colour;                 /* The disc's paint is not grey. */
    double orange_side[3];                /* By channel, -1 where the lettering is darker than the disc, else 1. */
    double orange_place[3];               /* By channel, the ring's place between disc (0) and lettering (1), linear light. */
    double template_weights[DL_FEATURES]; /* Weights of the aligned drawing's features. */
    double searched[DL_EVIDENCE];         /* Weights of the inputs where a search led to the place, */
    double tracked[DL_EVIDENCE];          /* and where a track did. */
} dl_pad_verification;

/* What is known of the logarithm of each paint's light, (4, 3). */
typedef struct {
    double mean[12]; /* Mean. */
    double var[12];  /* Variance. */
    double trust;    /* Trust in both, 0 to 1. */
} dl_pad_paint;

/* A registration, verified. */
typedef struct {
    dl_registration found;        /* The registration. */
    dl_aligned_pad aligned;       /* The drawing aligned at its pose. */
    dl_level_sighting seen;       /* The pose in level. */
    dl_pad_paint paint;           /* What is known of the paints if this is the pad. */
    double evidence[DL_EVIDENCE]; /* Inputs of the verification. */
    double log_odds;              /* Log-odds that this is the pad, without priors. */
} dl_registered_pad;

/* Where to register the drawing from. */
typedef struct {
    dl_pad_pose pose;      /* The start. */
    dl_tilt_prior prior;   /* What is known of the tilt. */
    dl_pad_paint known;    /* What is known of the paints. */
    bool coarse;           /* Approach on a reduced frame first. */
    bool tracked;          /* A track led here. */
    bool alone;            /* Register only; verify nothing. */
    double sigma_tilt_rad; /* Standard deviation of the start's tilt on that approach, rad. */
    double coded_px;       /* Standard deviation of the place of what a video codec has moved, px; 0 without one. */
    double cut[3];         /* The cut beyond which rays do not count. */
} dl_start;

/* ---- vision/lamps/: a lit pad ---- */

enum {
    /* The largest number of lamps of a pad. */
    DL_LAMPS_MAX = 40,
    /* The largest number of pairs of lamps that a search tries. */
    DL_LAMP_PAIRS_MAX = 20,
    /* At most this many of a frame's brightest spots are kept. */
    DL_LAMP_SPOTS_MAX = 40,
};

/* The lamps of a pad. */
typedef struct {
    int64_t lamps;                               /* Number of lamps. */
    int64_t pairs;                               /* Number of pairs that a search tries. */
    int64_t pair[2 * DL_LAMP_PAIRS_MAX];         /* Both lamps of each pair. */
    double x_m[DL_LAMPS_MAX], y_m[DL_LAMPS_MAX]; /* Places of the lamps on the pad, m. */
    double radius_m[DL_LAMPS_MAX];               /* Their radii, m. */
    double size_sigma_m;                         /* Standard deviation of the pattern's size at its outermost lamp, m. */
} dl_lamp_pattern;

/* Where lamps are expected. */
typedef struct {
    dl_pad_pose pose; /* The pad's pose. */
    double reach_px;  /* How far from there the pad may be in the frame, px. */
} dl_expected_lamps;

/* Lamps that were found. */
typedef struct {
    int64_t lit;                         /* Number of spots that are lamps. */
    dl_pad_pose pose;                    /* The pad's pose. */
    dl_level_sighting seen;              /* The pose in level. */
    double cov[36];                      /* Covariance of place, m, and of a small rotation of the pad, rad, in cam. */
    double confidence;                   /* Confidence that these are the pad's lamps, 0 to 1. */
    double log10_odds;                   /* Logarithm of the odds that they are, and no other lights. */
    double uv_px[2 * DL_LAMP_SPOTS_MAX]; /* Places of these spots, (lit, 2) px. */
} dl_found_lamps;

/* ---- vision/search/: the pad in a whole frame ---- */

enum {
    /* Side of the blocks of a frame in which contrast is compared and the plane is taken as flat, px. */
    DL_SEARCH_BLOCK = 16,
    /* Side of the cells that votes are counted in, px. */
    DL_SEARCH_CELL = 2,
    /* The largest number of radii of one search. */
    DL_SEARCH_RADII = 12,
    /* Sectors of a circle in which an edge is looked for; each gives one point of the outline. */
    DL_SEARCH_SECTORS = 36,
    /* Sizes of a frame that guesses are compared at: full, half, quarter ... size. */
    DL_SEARCH_LEVELS = 5,
    /* Polar cells of the drawing. */
    DL_POLAR_RADII = 18,
    DL_POLAR_ANGLES = 48,
};

/* What circles to look for. For outlines of areas only the plane, the largest number and `grey` count. */
typedef struct {
    int64_t step;          /* The image is so many times smaller than the frame. */
    int64_t margin;        /* Width of the margin around it in which centres may lie, px. */
    int64_t radii;         /* Number of radii. */
    int64_t most;          /* The largest number of circles to return. */
    bool only_bright;      /* Look only for circles that are bright inside. */
    bool grey;             /* The frame's channels are equal. */
    double least;          /* The least radius, in the plane at unit distance from the lens, */
    double ratio;          /* and how many times larger each of the others is than the one before. */
    double R_cam_plane[9]; /* Rotation of the plane that the pad is taken to lie in. */
} dl_circle_search;

/* A circle in the plane, lengths at unit distance of the plane from the lens. */
typedef struct {
    bool bright_inside;                       /* It is brighter inside than outside. */
    int64_t points;                           /* Number of points of its outline. */
    double centre[2];                         /* Centre in the plane. */
    double radius;                            /* Radius. */
    double support;                           /* Fraction of its outline with an edge. */
    double outline_px[2 * DL_SEARCH_SECTORS]; /* Places of these edges in the frame, (points, 2) px. */
} dl_circle;

/* A drawing in polar cells, radius by radius. */
typedef struct {
    double xy_m[2 * DL_POLAR_RADII * DL_POLAR_ANGLES];  /* Places of the cells' middles, m. */
    double area_inside[DL_POLAR_RADII];                 /* Relative area of a cell within the disc's paint. */
    double ring[DL_POLAR_RADII];                        /* Coverage by the ring, */
    double h_marking[DL_POLAR_RADII * DL_POLAR_ANGLES]; /* by lettering, */
    double arrow[DL_POLAR_RADII * DL_POLAR_ANGLES];     /* and by the arrowhead. */
    double polarity;                                    /* 1 where lettering is brighter than the disc, else -1. */
    double radius_m;                                    /* Radius of the whole pad, m. */
} dl_polar_pad;

/* A heading of the drawing. */
typedef struct {
    double turn_rad; /* The angle by which to turn the pose about its own z axis, rad. */
    double score;    /* Fraction of the light's variance that the drawing explains there. */
    double arrow;    /* Support for the arrowhead, -1 to 1. */
    double in_view;  /* Fraction of the disc's area within the frame. */
} dl_polar_fit;

/* What poses to guess. */
typedef struct {
    bool plane_known;      /* The plane's tilt is known. */
    int64_t radii;         /* Number of circles of the drawing. */
    int64_t most;          /* The largest number of guesses to return. */
    int64_t before;        /* Number of guesses that were computed before. */
    double R_cam_plane[9]; /* Rotation of the plane. */
    double radius_m[4];    /* Radii of the circles, m. */
    double sign[4];        /* 1 for one that is brighter inside, -1 for a darker one, 0 if that depends on the deck. */
} dl_guess_search;

/* The sizes of an H. */
typedef struct {
    double length_m, width_m; /* Its length (along x) and width, m. */
    double leg_m, bar_m;      /* Widths of legs and cross-bar, m. */
    double margin_m;          /* Width of the disc around it that counts, m. */
} dl_pad_strokes;

/* Where strokes are looked for. */
typedef struct {
    int64_t step;          /* The image is so many times smaller than the frame. */
    bool bright;           /* Only bright marks count. */
    bool plane_known;      /* The plane's tilt is known. */
    int64_t most;          /* The largest number of guesses to return. */
    double R_cam_plane[9]; /* Rotation of the plane. */
} dl_stroke_search;

/* A guessed pose. */
typedef struct {
    bool known;        /* The plane's tilt is known. */
    bool one_sided;    /* Only one half of the disc counts. */
    double R[9], t[3]; /* The pose in cam before it is turned; m. */
    double turn_rad;   /* The angle by which to turn it about its own z axis, rad. */
    double drawing;    /* Fraction of the light's variance that the drawing explains there. */
    double support;    /* Support of the circle that it came from. */
    double side[2];    /* Unit direction, on the turned pad, of the half that counts. */
} dl_guess;

/* ---- vision/: what follows one pad in the frames of one camera ---- */

/* An image: rows of pixels, one byte a channel. */
typedef struct {
    int64_t width, height; /* Size, px. */
    int64_t stride;        /* Distance from row to row, bytes. */
    int64_t channels;      /* Bytes of a pixel. */
    const uint8_t *px;     /* The pixels. */
} dl_image;

/* What a frame can show. */
typedef struct {
    double noise;    /* Standard deviation of its noise beyond a camera's usual, 1 is full scale. */
    double contrast; /* Range of its values over that of a clear frame, at most 1. */
    double chroma;   /* The largest difference between the channels of a pixel, 0 to 255. */
} dl_quality;

/* A frame in BGR. */
typedef struct {
    dl_image level[DL_FRAME_LEVELS + 1]; /* At full, half, quarter ... size; px is null for sizes that were not made. */
    dl_quality quality;                  /* What it can show. */
} dl_frame;

/* A camera. */
typedef struct {
    dl_lens lens;          /* Its lens. */
    double t_body_cam[3];  /* Its place in the body, m. */
    double light[256];     /* Linear light for each value of a pixel, 0 to 1, */
    double log_light[256]; /* and log1p of that over a floor. */
} dl_camera;

/* A pad's drawing. */
typedef struct {
    dl_pad_shape shape;               /* Its regions. */
    dl_pad_template drawn;            /* Its maps. */
    dl_polar_pad polar;               /* Its polar cells. */
    dl_pad_strokes strokes;           /* The strokes of its H. */
    dl_pad_verification verification; /* What the verification knows of it. */
    double size_sigma_m;              /* Standard deviation of its painted sizes, m. */
    int64_t edge_points;              /* Number of points on its edges. */
} dl_pad;

/* Holds what stays the same from frame to frame, and all memory that is worked in. One thread at a time may use it. */
typedef struct dl_tracker dl_tracker;

/* Make a tracker. It keeps addresses, and no copies, of arrays: rays of all pixels, (height, width, 2), null if the lens does not
 * distort; maps of coverage by each paint, and of coverage minus its mean in the neighbourhood, (DL_TEMPLATE_BLURS, n, n, 4) each;
 * edges with place, normal and distance to the next point, (edge_points, 5) m, and edge_of with kind and piece, (edge_points, 2).
 * All but camera and rays may be null for what needs no drawing. Return null without memory, or if a size is none. */
dl_tracker *dl_tracker_new(const dl_camera *camera, const double *rays, const dl_pad *pad, const int16_t *coverage,
    const int16_t *local, const double *edges, const int32_t *edge_of);
void dl_tracker_free(dl_tracker *t);

/* The entries below return a number of results, 1 or 0 for one or none, or a failure. */
enum dl_failure {
    /* The frame has more bright places than a dark deck. */
    DL_TOO_BRIGHT = -1,
    /* An argument has a size that the tracker is not made for. */
    DL_WRONG_SIZE = -2,
};

/* Measure what a frame can show. */
int32_t dl_frame_quality(const dl_image *image, dl_quality *out);

/* Draw a plane as seen from above, (n, n, channels) with n = (nodes - 1) between + 1, from where points of it are in an image of
 * three channels, (nodes, nodes, 2) px; of one channel, its green. `shown`, (n, n), is 255 where the image shows it. Return n. */
int32_t dl_from_above(const dl_image *image, const float *places, int32_t nodes, int32_t between, int32_t channels, uint8_t *out,
    uint8_t *shown);

/* Subtract what light can make of one paint, and a plane over the places, (cells, 2), from the light of its cells, (cells, 3).
 * `out` gets the rest, (cells, 3) of the paint's light. `white` is the light of white; `spare` has room for two numbers a cell. */
int32_t dl_paint_rest(const float *light, const float *place, int32_t cells, const float *white, float *out, float *spare);

/* Register the drawing from a start, verify it there, and bring it to level. `outline` gets the pixel of every fourth point of the
 * edges; there are outline_points of them. */
int32_t dl_look(dl_tracker *t, const dl_frame *frame, const dl_start *start, dl_registered_pad *out, double *outline,
    int64_t outline_points);

/* Align the drawing with a frame from a pose, which moves. */
int32_t dl_align(dl_tracker *t, const dl_frame *frame, const dl_alignment *how, dl_pad_pose *pose, dl_aligned_pad *out);

/* Find circles, most prominent first: of edges in a grey image, or if that is null outlines of areas of a frame at full and half
 * size. `rays` are those of the corners of the image's blocks, (rows + 1, columns + 1, 2). */
int32_t dl_search_circles(dl_tracker *t, const dl_frame *frame, const dl_image *grey, const float *rays,
    const dl_circle_search *how, dl_circle *out);

/* Guess poses from circles, likeliest first. `rated` has for each circle how many guesses of it are in `before`, one circle's after
 * the other's, or DL_NONE; it gets that number for each circle whose guesses were computed and are complete. */
int32_t dl_search_guesses(dl_tracker *t, const dl_frame *frame, const dl_guess_search *how, int32_t circles,
    const dl_circle *circle, int64_t *rated, const dl_guess *before, dl_guess *out);

/* Find the heading of the drawing at a pose, in an image step times smaller than the frame. `side` is null, or the direction on the
 * pad of the half of the disc that counts. */
int32_t dl_search_heading(dl_tracker *t, const dl_image *image, int32_t step, const dl_pad_pose *pose, const double *side,
    dl_polar_fit *out);

/* Find the strokes of the H in an image, likeliest places first. */
int32_t dl_search_strokes(dl_tracker *t, const dl_image *image, const dl_stroke_search *how, dl_guess *out);

/* Look for lamps where the pad is expected, and in the whole frame if it is not there, or if `at` is null. */
int32_t dl_find_lamps(dl_tracker *t, const dl_image *image, const dl_lamp_pattern *pad, const dl_tilt_prior *prior,
    const dl_expected_lamps *at, dl_found_lamps *out);

#endif
