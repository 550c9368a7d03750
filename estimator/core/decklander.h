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

/* ---- filter/: the error-state filter ---- */

/* The parts of the filter's state by their first index, and its size. estimator.ekf.params describes them. */
enum dl_filter_state {
    DL_ATT_ERR = 0, DL_POS_REL = 3, DL_VEL = 6, DL_GYRO_BIAS = 9, DL_ACCEL_BIAS = 12, DL_VEL_SCALE = 15, DL_VESSEL_VEL = 16,
    DL_WAVES = 18, DL_PAD_YAW = 38, DL_YAW_RATE = 39, DL_DECK_TRIM = 40, DL_CAMERA_DELAY = 42, DL_CAMERA_MOUNT = 43,
    DL_BARO_OFFSET = 46, DL_ATT_BIAS = 47, DL_RANGE_OFFSET = 49, DL_WAVE_YAW = 50, DL_TURN_RATE = 51, DL_CAMERA_LEVER = 52,
    DL_N = 55,
};

enum {
    /* The largest number of measured numbers that are fused together. */
    DL_ROWS_MAX = 9,
    /* Number of kinds of aiding. */
    DL_KINDS = 4,
    /* Directions in which a deck moves on waves: north, east, down, roll, pitch. */
    DL_DIRECTIONS = 5,
    /* Number of different oscillators in the bank of a direction: the one at rest, then the others. */
    DL_OSCILLATORS = 28,
    /* Number of sizes in which each oscillator but the one at rest comes; they lie side by side. */
    DL_MEMBER_SIZES = 5,
    /* Number of oscillators of some size that the bank of each direction compares. */
    DL_MEMBERS = 1 + (DL_OSCILLATORS - 1) * DL_MEMBER_SIZES,
};

/* Kinds of events; the first DL_KINDS are those of aiding. */
enum dl_event_kind {
    DL_ATTITUDE, DL_VELOCITY, DL_RANGE, DL_HEIGHT, DL_IMU, DL_VESSEL, DL_SIGHTING, DL_MOTION,
};

/* What became of an event: fused; refused by the gate, or with nothing to compare it with; its covariance was not positive definite;
 * a sighting below `min_confidence`; measured before the oldest event that is kept; measured after every time of reception so far;
 * received before any sample showed which way is down. */
enum dl_verdict {
    DL_FUSED, DL_GATED, DL_SINGULAR, DL_LOW_CONFIDENCE, DL_TOO_OLD, DL_TOO_NEW, DL_NO_ATTITUDE,
};

/* The surface below a velocity sensor. */
enum dl_velocity_surface {
    DL_OVER_GROUND, DL_OVER_PAD, DL_OVER_EITHER,
};

/* The oscillators that the bank of a direction compares, by member. */
typedef struct {
    /* Natural frequency, rad/s. */
    double w[DL_MEMBERS];
    /* Damping ratio. */
    double zeta[DL_MEMBERS];
    /* Its natural logarithm. */
    double log_zeta[DL_MEMBERS];
    /* Natural logarithm of the probability before any sighting. */
    double log_prior[DL_MEMBERS];
    /* Standard deviation of the displacement, m or rad; by direction, then by member. */
    double sigma[DL_DIRECTIONS * DL_MEMBERS];
} dl_bank_members;

/* The filter's options, and the noises that follow from them. estimator.ekf.options gives advice on each. */
typedef struct {
    /* How long an event and the state after it are kept, ns. */
    int64_t history_ns;
    /* By how much an event may be measured after every time of reception so far, ns. */
    int64_t max_ahead_ns;
    /* Difference between two times of reception beyond which one of them is wrong, ns. */
    int64_t leap_ns;
    /* Number of such times of reception in a row that agree and are believed. */
    int64_t leap_count;
    /* How long an IMU sample holds, ns. */
    int64_t hold_ns;
    /* Number of rejected sightings that agree and reset the state of the pad. */
    int64_t reopen_count;
    /* The surface over which velocities are measured. */
    enum dl_velocity_surface velocity_is_over;
    /* Longest time between two propagations of the covariance, s. */
    double tick_s;
    /* Time without a sighting after which the pad is forgotten, s. */
    double forget_s;
    /* Time over which samples of aiding are averaged before they are fused, s. */
    double aiding_period_s;
    /* Largest change between two IMU samples that a vehicle can make, m/s^2. */
    double accel_step_m_s2;
    /* The same of its rates, rad/s. */
    double gyro_step_rad_s;
    /* Radius about the pad within which the deck is level ground for a range or velocity sensor, m. */
    double deck_radius_m;
    /* Variance of a component from which on it was not measured. */
    double not_measured_var;
    /* Time over which the errors of a kind of aiding are alike, s. */
    double correlation_s[DL_KINDS];
    /* Limit of the NIS by the number of measured numbers less one. */
    double nis_max[DL_ROWS_MAX];
    /* Noise densities of the states whose variance grows with time, unit^2/s. */
    double psd[DL_N];
    /* Noise density of the accelerometer, (m/s^2)^2/Hz. */
    double psd_accel;
    /* Noise density of the force while no IMU sample holds, (m/s^2)^2/Hz. */
    double psd_coast;
    /* Noise density of the rate while no IMU sample holds, (rad/s)^2/Hz. */
    double psd_coast_turn;
    /* Frequency of the vessel's yaw on waves, rad/s. */
    double wave_yaw_rad_s;
    /* Standard deviation of its rate, rad/s. */
    double sigma_wave_yaw_rate_rad_s;
    /* Noise density of the acceleration of a position that the IMU propagates, by direction, (m/s^2)^2/Hz. */
    double carrying_psd_accel[DL_DIRECTIONS];
    /* Density of the random walk of that acceleration, by direction, (m/s^3)^2/Hz. */
    double carrying_psd_drift[DL_DIRECTIONS];
    /* Density of the random walk of the tilt that moves a measured position, by direction, rad^2/s. */
    double carrying_psd_tilt[DL_DIRECTIONS];
    /* Least confidence of a sighting that is fused, 0..1. */
    double min_confidence;
    /* Least time between the first and the last of the sightings that reset the state of the pad, s. */
    double reopen_s;
    /* Longest time for which agreement with a heading counts, s. */
    double heading_memory_s;
    /* Standard deviation of the vessel's steady rate of turn, rad/s. */
    double sigma_turn_rate_rad_s;
    /* Heading of the pad's arrow against the vessel's bow, rad. */
    double pad_yaw_in_vessel_rad;
    /* The pad from the place whose velocity the vessel reports, towards her bow and to starboard, m. */
    double pad_in_vessel_m[2];
    /* Scale of the velocity sensor at the beginning: measured over true. */
    double velocity_scale;
    /* Standard deviation of the tilt of the first attitude, rad. */
    double sigma_initial_tilt_rad;
    /* Standard deviation of the heading of the first attitude, rad. */
    double sigma_initial_heading_rad;
    /* Standard deviation of the constant error of the vehicle's own attitude, rad. */
    double sigma_attitude_bias_rad;
    /* Variances of the states at the beginning, unit^2; those of attitude and waves are computed. */
    double initial_var[DL_N];
    /* The oscillators that the deck's motion is compared with. */
    dl_bank_members members;
} dl_filter_params;

/* A sample of the IMU, in the body's axes. */
typedef struct {
    /* Rate, rad/s. */
    double w_body[3];
    /* Specific force, m/s^2. */
    double f_body[3];
    /* For how long before the sample the gyro measured nothing, s. */
    double gyro_lost_s;
    /* For how long before the sample the accelerometer measured nothing, s. */
    double accel_lost_s;
} dl_imu;

/* The vehicle's own attitude. */
typedef struct {
    /* Rotation from body to ned, in rows. */
    double R_ned_body[9];
    /* Covariance of its small rotation error in the body's axes, rad^2, in rows. */
    double cov_body[9];
} dl_attitude;

/* The vehicle's own velocity, in level. */
typedef struct {
    /* Forward, right, down, m/s. */
    double v_level[3];
    /* Covariance, (m/s)^2, in rows. */
    double cov_level[9];
} dl_velocity;

/* A range or a height. */
typedef struct {
    /* Distance along the body's down axis, or height, m. */
    double measured_m;
    /* Its standard deviation, m. */
    double sigma_m;
} dl_distance;

/* What a ship reports of her own motion. */
typedef struct {
    /* Whether it holds a velocity. */
    bool has_velocity;
    /* Whether it holds a heading. */
    bool has_heading;
    /* Velocity in ned, m/s. */
    double v_ned[3];
    /* Its covariance, (m/s)^2, in rows. */
    double cov_v_ned[9];
    /* Heading of the bow, rad. */
    double heading_rad;
    /* Its standard deviation, rad. */
    double sigma_heading_rad;
    /* Whether it holds a rate of turn. */
    bool has_turn;
    /* Rate of turn, clockwise seen from above, rad/s. */
    double turn_rad_s;
    /* Its standard deviation, rad/s. */
    double sigma_turn_rad_s;
} dl_vessel_report;

/* The deck's motion on the waves by the ship's motion sensor, at the pad and along its axes, without what is constant. */
typedef struct {
    /* Whether it holds a displacement. */
    bool has_heave;
    /* Whether it holds roll and pitch. */
    bool has_tilt;
    /* Displacement of the pad's centre, down positive, m. */
    double down_m;
    /* Its standard deviation, m. */
    double sigma_down_m;
    /* Roll about the arrow and pitch, rad. */
    double tilt_rad[2];
    /* The standard deviation of each, rad. */
    double sigma_tilt_rad;
} dl_motion;

/* What vision saw of the pad, in level. */
typedef struct {
    /* Whether it holds a heading. */
    bool has_yaw;
    /* Whether the heading may be half a turn off. */
    bool yaw_ambiguous;
    /* Whether it holds a whole pose. */
    bool has_pose6;
    /* Confidence that it is the pad, 0..1. */
    double confidence;
    /* Standard deviation of the instant, s. */
    double sigma_s;
    /* From the body to the pad's centre, m. */
    double d_level[3];
    /* Heading of the body against the arrow, rad. */
    double yaw_rad;
    /* Covariance of place and heading, m^2 and rad^2, in rows. */
    double cov[16];
    /* The place by the whole pose, m. */
    double pose_d_level[3];
    /* Rotation from pad to level, in rows. */
    double pose_R[9];
    /* Covariance of place and small rotation in level, m^2 and rad^2, in rows. */
    double pose_cov[36];
    /* Whether it is no picture but a baseline: d_level and cov are those of the vector from the drone's antenna to the ship's in ned. */
    bool by_baseline;
    /* Whether such a baseline may begin the belief, which else a picture has to. */
    bool alone;
    /* Time over which the errors of such baselines are alike, so that all of them count as one, s. */
    double alike_s;
    /* The drone's antenna in the body's axes, m. */
    double antenna_body[3];
    /* The ship's antenna from the pad's centre in the ship's axes, m. */
    double antenna_vessel[3];
} dl_sighting;

/* A sample or a sighting. */
typedef struct {
    /* Its kind, by which one member of the union counts. */
    enum dl_event_kind kind;
    /* Instant at which it was measured, ns. */
    int64_t t;
    /* Instant at which it was received, ns. */
    int64_t received_at;
    /* Order of events of one kind and instant: a sighting's frame. */
    int64_t seq;
    /* The same of one frame: a sighting's method. */
    uint64_t method;
    union {
        /* Of an IMU event. */
        dl_imu imu;
        /* Of an attitude event. */
        dl_attitude attitude;
        /* Of a body velocity. */
        dl_velocity velocity;
        /* Of a range or a barometer's height. */
        dl_distance distance;
        /* Of a report of the vessel's motion. */
        dl_vessel_report vessel;
        /* Of a report of the ship's motion sensor. */
        dl_motion motion;
        /* Of a sighting of the pad. */
        dl_sighting sighting;
    } sample; /* The measurement. */
} dl_event;

/* What became of an event. */
typedef struct {
    /* The verdict. */
    enum dl_verdict verdict;
    /* Number of innovations; 0 if the event was compared with nothing. */
    int32_t m;
    /* The components that were compared, a bit each; 0 if they are the first m. */
    int32_t axes;
    /* Whether S holds a covariance. */
    bool has_S;
    /* Innovations: measured less predicted, in the unit of each. */
    double innov[6];
    /* Their covariance (m, m), in rows. */
    double S[36];
    /* Normalized innovation squared; nan if the event was compared with nothing. */
    double nis;
    /* The gate's limit of it. */
    double nis_max;
} dl_outcome;

/* The deck at an instant ahead, in level at the instant of the forecast, if the body keeps its velocity. */
typedef struct {
    /* From the body to the pad's centre, m. */
    double d[3];
    /* Its covariance, m^2, in rows. */
    double cov_d[9];
    /* Velocity of the pad's centre over the ground, m/s. */
    double v_pad[3];
    /* Height of the pad's centre over its mean level, m. */
    double height;
    /* Its standard deviation, m. */
    double sigma_height;
    /* Vertical speed of the pad's centre, positive up, m/s. */
    double rise;
    /* Its standard deviation, m/s. */
    double sigma_rise;
    /* Roll of the deck about the arrow, starboard down positive, rad. */
    double roll;
    /* Its standard deviation, rad. */
    double sigma_roll;
    /* Pitch of the deck, arrow up positive, rad. */
    double pitch;
    /* Its standard deviation, rad. */
    double sigma_pitch;
} dl_deck_ahead;

/* The pad, the body's motion and the deck's motion at one instant; vectors are in level. */
typedef struct {
    /* Whether a pad is tracked: without one, members of the pad are zero. */
    bool has_pad;
    /* Whether the deck's motion is known, by the pad or by the ship's motion sensor: otherwise members of the deck are zero. */
    bool has_deck;
    /* Whether an IMU sample and an attitude hold: without them, members of the body's motion are zero. */
    bool has_body;
    /* Whether the heading against the arrow is known. */
    bool heading_known;
    /* Whether the ship swung the pad out of sight, so that nobody knows its speed. */
    bool adrift;
    /* Whether sightings showed a manoeuvre of the ship that may go on. */
    bool steers;
    /* Whether the ship's rate of turn is left out, as sightings contradicted it. */
    bool turn_left_out;
    /* Number of sightings that were fused since the state of the pad was set. */
    int64_t agreed;
    /* Instant of the newest fused sighting, ns; -1 if there is none. */
    int64_t sighted;
    /* Instant of the newest fused velocity, ns; -1 if there is none. */
    int64_t velocity_fused;
    /* Recent mean of the sightings' NIS over their numbers. */
    double nis_mean;
    /* Heading of the body, rad. */
    double heading;
    /* From the body to the pad's centre, m. */
    double d[3];
    /* Its rate, m/s. */
    double v[3];
    /* Heading of the body against the arrow, rad. */
    double yaw;
    /* Covariance of d, v and yaw (7, 7), in rows. */
    double cov[49];
    /* Acceleration of the body, m/s^2. */
    double a_body[3];
    /* Its covariance, (m/s^2)^2, in rows. */
    double cov_a_body[9];
    /* Rate of the body in its own axes, rad/s. */
    double w_body[3];
    /* The vehicle's own attitude, propagated by the gyro: body to ned, in rows. */
    double levelled_by[9];
    /* Its covariance in the body's axes, rad^2, in rows. */
    double cov_levelled_by[9];
    /* Velocity of the pad's centre over the ground, m/s. */
    double v_deck[3];
    /* Its acceleration, m/s^2. */
    double a_deck[3];
    /* Covariance of v_deck and a_deck (6, 6), in rows. */
    double cov_deck[36];
    /* Roll and pitch of the deck, rad, and their rates, rad/s. */
    double tilt[4];
    /* Their covariance (4, 4), in rows. */
    double cov_tilt[16];
    /* The state. */
    double x[DL_N];
    /* Its variances. */
    double var[DL_N];
    /* Covariance of the two components of the vessel's velocity, (m/s)^2. */
    double cov_vessel;
    /* Frequency of the waves by direction, rad/s. */
    double wave_w[DL_DIRECTIONS];
    /* Their damping ratio. */
    double wave_zeta[DL_DIRECTIONS];
    /* Standard deviation of the displacement, m and rad. */
    double wave_sigma[DL_DIRECTIONS];
    /* Probability that the deck is at rest on the waves, 0..1. */
    double rest;
    /* Place of the body by the IMU alone, downward from where it began, m. */
    double carried_down_m;
} dl_answer;

/* A filter: the recent events in the order of their instants, and the state after each. One thread at a time may use it; its functions
 * may run at once with those of another filter. */
typedef struct dl_filter dl_filter;

/* Return the filter that was saved in these bytes by a library for the same machine, which continues with these parameters; without bytes
 * one that has received nothing. NULL if there is no memory, or if the bytes are not a filter. */
dl_filter *dl_filter_new(const dl_filter_params *params, const uint8_t *saved, int64_t bytes);
void dl_filter_free(dl_filter *f);
/* Insert n events, in the order of their reception, each at the instant when it was measured: it and all later events are processed
 * again. The result is the one of events that were received in the order of their instants. Write the outcome of each. Return the
 * earliest instant of an answer that may have changed, ns; INT64_MAX if none has, -1 if there is no memory. */
int64_t dl_filter_put(dl_filter *f, int32_t n, const dl_event *events, dl_outcome *outcomes);
/* Write the estimate of instant t, ns, propagated from the last event before it. Return false, and write nothing, before the first
 * attitude and if the events that are kept do not reach back so far. */
bool dl_filter_answer(dl_filter *f, int64_t t, dl_answer *out);
/* Write the deck's forecast from instant t, ns, at n horizons, s. Return false if the deck's motion is not known
 * then: no pad is tracked, and no motion sensor reports. Without a pad its place is not known to some hundred metres. */
bool dl_filter_forecast(dl_filter *f, int64_t t, int32_t n, const double *horizons_s, dl_deck_ahead *out);
/* Write all that the filter keeps into `room` bytes, if there are enough; return how many it takes. */
int64_t dl_filter_save(const dl_filter *f, uint8_t *out, int64_t room);

/* ---- integrity/: checks of one witness by another ---- */

enum {
    /* The largest number of bearings that are compared: half a second at 128 frames a second. */
    DL_VIEW_MAX = 64,
    /* The number of delays for which view and rotation are compared. */
    DL_VIEW_LAGS = 17,
};

/* A bearing of the pad. */
typedef struct {
    /* Instant of the exposure, ns. */
    int64_t t;
    /* Unit vector to the pad in level. */
    double level[3];
    /* Roll and pitch of the body, (3, 3). */
    double R_level_body[9];
} dl_bearing;

/* The view of the pad against the body's turns. All zero but aside_at, it has seen nothing. */
typedef struct {
    /* Number of bearings. */
    int64_t n;
    /* The bearings of the last half second, oldest first. */
    dl_bearing bearings[DL_VIEW_MAX];
    /* Sum of the products of [expected forward, right, seen forward, right] in the body, (4, 4) rad^2, older ones less. */
    double moments[16];
    /* Sum of squares of the view, rad^2, older ones less. */
    double seen;
    /* The same of the rotation, for each delay. */
    double turned[DL_VIEW_LAGS];
    /* Sum of the products of both, for each delay. */
    double together[DL_VIEW_LAGS];
    /* Number of sightings in a row that show a delay, of those in which the body turns. */
    int64_t lags_shown;
    /* Delay of the attitude against the image, s; 0 while nothing shows that it is. */
    double late_s;
    /* Instant of the newest way of the pad that is too fast to show a delay, ns; -1 if there was none. */
    int64_t aside_at;
    /* Whether the pad stands still in the image while the body turns. */
    bool frozen;
    /* Whether the pad moves in the image against the rotation of the body, along some axis. */
    bool reversed;
} dl_view;

/* Process a sighting at instant t, ns, with the pad at d_level, (3,) m, from a body of this roll and pitch, rad. A view counts as frozen
 * while the spread of its bearings is less than still_ratio of that of the rotations, if those have turned_min_rad. */
void dl_view_watch(dl_view *view, int64_t t, const double *d_level, double roll, double pitch, double turned_min_rad, double still_ratio);

/* ---- law/: the law that follows the deck ---- */

enum {
    /* The largest number of commands that the law remembers: 0.65 s at 200 cycles a second. */
    DL_UNDER_WAY_MAX = 132,
    /* The largest number of horizons of a forecast that the law takes. */
    DL_HORIZONS_MAX = 16,
};

/* What the law is made for. Vectors are written in level, axes and commands under way in axes that do not turn with the nose; delays
 * are numbers of periods, commands come newest first. */
typedef struct {
    /* Number of commands under way that are kept. */
    int64_t remembered;
    /* Whether the vehicle's own hover holds over the ground, and its driver adds the deck's velocity. */
    bool over_ground;
    /* Whether the tilt is limited so that the pad stays in the camera's view. */
    bool keeps_in_view;
    /* Period of the cycles, s. */
    double period_s;
    /* Frequency of the vehicle's answer to a tilt command, rad/s. */
    double frequency_rad_s;
    /* Damping ratio of that answer. */
    double damping;
    /* Time constant of that answer's lag, s. */
    double lag_s;
    /* Largest tilt, m/s^2. */
    double tilt_max_m_s2;
    /* Largest rate of a commanded tilt, m/s^3; 0 for no limit. */
    double jerk_max_m_s3;
    /* Time constant of the answer to a climb command, s. */
    double climb_lag_s;
    /* Largest climb command, m/s. */
    double climb_max_m_s;
    /* Where the camera is in the body, forward, m. */
    double view_forward_m;
    /* The same to the right, m. */
    double view_right_m;
    /* Half the angle of its view forward, rad. */
    double half_forward_rad;
    /* The same to the right, rad. */
    double half_right_rad;
} dl_law_params;

/* The gains on the state of an axis, and on the commands under way. */
typedef struct {
    /* Number of commands under way that have a gain. */
    int64_t n;
    /* Delay of a tilt command, periods. */
    int64_t tilt_delay;
    /* Delay of a climb command, periods. */
    int64_t climb_delay;
    /* How late a slowly changing tilt is behind its command, s. */
    double slowness_s;
    /* On the place, 1/s^2. */
    double p;
    /* On the velocity, 1/s. */
    double w;
    /* On the tilt's acceleration. */
    double a;
    /* On its rate, s. */
    double rate;
    /* On the lagged command. */
    double lag;
    /* On each command under way. */
    double under_way[DL_UNDER_WAY_MAX];
} dl_law_gains;

/* The observer's gains. */
typedef struct {
    /* Rows for p, w, d and b of an axis, columns by place, speed and acceleration. */
    double gains[4][3];
} dl_law_observer;

/* The law as it is flown in one cycle; the command goes over from gains_before to gains. */
typedef struct {
    /* What it is made for. */
    dl_law_params params;
    /* The gains, and those before. */
    dl_law_gains gains, gains_before;
    /* The observer. */
    dl_law_observer observer;
} dl_law_in_use;

/* The course of the pad by a forecast. */
typedef struct {
    /* Number of horizons; 0 without a forecast. */
    int64_t n;
    /* The horizons, s. */
    double horizons_s[DL_HORIZONS_MAX];
    /* The pad's velocity there, in level, m/s. */
    double rates_m_s[DL_HORIZONS_MAX][3];
} dl_law_course;

/* What the law knows of one horizontal axis. */
typedef struct {
    /* The pad against the body, m. */
    double p;
    /* Its rate, m/s. */
    double w;
    /* What accelerates the body beside its tilt, m/s^2. */
    double d;
    /* Error of the levelled accelerometer, m/s^2. */
    double b;
    /* Acceleration by the tilt, m/s^2. */
    double lean;
    /* Its rate, m/s^3. */
    double rate;
    /* The lagged command, m/s^2. */
    double lag;
    /* The commands under way, m/s^2. */
    double under_way[DL_UNDER_WAY_MAX];
} dl_law_axis;

/* What was measured of one horizontal axis. */
typedef struct {
    /* The pad against the body, m. */
    double p;
    /* Its rate, m/s. */
    double w;
    /* Acceleration by the tilt, m/s^2. */
    double lean;
    /* Its rate, m/s^3. */
    double rate;
    /* Acceleration of the body, m/s^2. */
    double a_body;
    /* Acceleration of the deck, m/s^2. */
    double a_deck;
} dl_axis_measured;

/* The tilt that the vehicle adds by itself, along one axis. */
typedef struct {
    /* That tilt, m/s^2. */
    double own;
    /* The tilt that the commands explain, m/s^2. */
    double lean;
    /* Its rate, m/s^3. */
    double rate;
} dl_law_own;

/* What the law keeps from one cycle to the next. */
typedef struct {
    /* Whether the deck's turn is known. */
    bool has_turn;
    /* Acceleration of the body beside its answer to climb commands, m/s^2 down. */
    double pushed_down_m_s2;
    /* Heading of the body against the arrow, rad. */
    double turn_yaw_rad;
    /* Rate at which the deck turns, rad/s. */
    double turn_rate_rad_s;
    /* Part of a guidance period by which the commands under way are short of the time that passed, -0.5..0.5. */
    double periods_left;
    /* The tilt that was commanded last, north and east, m/s^2: the vehicle comes to it by its jerk. */
    double commanded[2];
    /* The climb commands under way, m/s. */
    double climbs[DL_UNDER_WAY_MAX];
    /* The two horizontal axes. */
    dl_law_axis axes[2];
    /* The vehicle's own tilt along each. */
    dl_law_own own[2];
} dl_law_memory;

/* What is known, and what is wanted, in one cycle. */
typedef struct {
    /* Whether the cycle before was not too long ago. */
    bool goes_on;
    /* Whether the law commands: it has a target. */
    bool steers;
    /* Whether the deck's motion is known. */
    bool has_deck;
    /* Whether the heading against the arrow is known. */
    bool has_yaw;
    /* Whether a rate of descent is wanted. */
    bool has_rate;
    /* Whether a heading is wanted. */
    bool has_wanted_yaw;
    /* Whether the target limits the tilt. */
    bool has_lean_max;
    /* Time since the cycle before, s. */
    double dt;
    /* Share of `gains` against `gains_before`, 0..1. */
    double share;
    /* Age of the forecast, s. */
    double forecast_age_s;
    /* Heading of the body, rad. */
    double heading_rad;
    /* From the body to the pad, m. */
    double d[3];
    /* Its rate, m/s. */
    double v[3];
    /* Heading of the body against the arrow, rad. */
    double yaw_rad;
    /* Acceleration of the body, m/s^2. */
    double a_body[3];
    /* Rate of the body in its own axes, rad/s. */
    double w_body[3];
    /* Acceleration by the tilt, forward and right, m/s^2. */
    double lean[2];
    /* Velocity of the deck, m/s. */
    double v_deck[3];
    /* Its acceleration, m/s^2. */
    double a_deck[3];
    /* Where the pad is wanted from the body, m. */
    double wanted[3];
    /* The wanted rate of descent against the deck, m/s. */
    double rate_m_s;
    /* Largest vertical rate, m/s. */
    double rate_max_m_s;
    /* Largest horizontal speed, m/s. */
    double speed_max_m_s;
    /* The wanted heading against the arrow, rad. */
    double wanted_yaw_rad;
    /* The target's limit of the tilt, rad. */
    double lean_max_rad;
} dl_law_cycle;

/* A command, in level. */
typedef struct {
    /* Acceleration by the tilt beside the trim, forward and right, m/s^2. */
    double a[2];
    /* The tilt that holds against the wind, m/s^2. */
    double trim[2];
    /* Velocity, m/s. */
    double v[3];
    /* Rate of turn, rad/s. */
    double yaw_rate_rad_s;
} dl_law_command;

/* Step one horizontal axis by dt with a measurement, and return the tilt to command over a still deck, m/s^2, by `gains` alone: what
 * the law's stability margins query. Return NAN if the law has no room for its commands. */
double dl_law_axis_step(const dl_law_in_use *law, double dt, const dl_law_axis *before, const dl_axis_measured *z,
    dl_law_axis *after);
/* Run one cycle. Where no target steers, the memory notes what the vehicle does and the command is zero. Return false, and write
 * nothing, if the law has no room for its commands or for the horizons. */
bool dl_law_step(const dl_law_in_use *law, const dl_law_cycle *in, const dl_law_course *course, const dl_law_memory *before,
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

/* A pose of the pad in cam. */
typedef struct {
    double R[9]; /* R_cam_pad. */
    double t[3]; /* The pad's centre, m. */
} dl_pad_pose;

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
    dl_pad_pose pose;                     /* The pose. */
    double cov[36];                       /* Covariance of the pose, with the prior. */
    double blur_px2[3];                   /* Covariance uu, uv, vv of the point spread at the pad beyond a pixel's square, px^2. */
    double noise_light;                   /* Standard deviation of the residuals, linear light. */
    double edge_rms_px;                   /* Displacement of the edges beyond what noise explains, rms, px. */
    double visible;                       /* Fraction of the drawing's edges within the frame. */
    double inliers;                       /* Fraction of those that agree with it. */
    dl_edge_support edges[DL_EDGE_KINDS]; /* The support for each kind of edge. */
} dl_registration;

/* A pose in level. */
typedef struct {
    double d[3];           /* The pad's centre from the body's origin, m. */
    double R_level_pad[9]; /* The pad's rotation. */
    double cov_pose[36];   /* Covariance of place, m, and of a small rotation of the pad, rad, in level. */
    double yaw_rad;        /* The body's heading against the pad's arrow, rad. */
    double cov[16];        /* Covariance of place, m, and heading, rad. */
} dl_level_sighting;

/* Bring a pose in cam to level, by the camera's lens, its place in the body, m, and what is known of the tilt. */
void dl_sighting_in_level(const dl_lens *lens, const double *t_body_cam, const dl_tilt_prior *prior, const dl_pad_pose *pose,
    const double *cov_pose, dl_level_sighting *out);

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
 * estimator.vision.detect.verification has. */
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
 * All but camera and rays may be null for what needs no drawing. The entries add what they do to `work`, unless that is null, in
 * millionths of a floor: one BGR to HSV conversion and one inRange of 640x360 px. Return null without memory, or if a size is none. */
dl_tracker *dl_tracker_new(const dl_camera *camera, const double *rays, const dl_pad *pad, const int16_t *coverage,
    const int16_t *local, const double *edges, const int32_t *edge_of, int64_t *work);
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
