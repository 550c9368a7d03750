/* The filter's state after an event, with all that the next event needs. Matrices are row-major. */
#ifndef DECKLANDER_BELIEF_H
#define DECKLANDER_BELIEF_H

#include "decklander.h"

/* An element of a matrix of the state, in rows. */
#define AT(M, row, column) ((M)[(row) * DL_N + (column)])

enum {
    /* The largest number of states on which one kind of aiding depends. */
    COLUMNS_MAX = 12,
    /* Number of states of a wave: displacement, rate, force, its rate. */
    WAVE_STATES = 4,
    /* Numbers of a wave's covariance: its upper triangle in rows. */
    WAVE_PAIRS = WAVE_STATES * (WAVE_STATES + 1) / 2,
    /* Number of states of a member of the bank: those of a wave; offset of the IMU's carrying on, its rate, acceleration. */
    MEMBER_STATES = 7,
    /* Numbers of a member's covariance, which is symmetric: its upper triangle in rows. */
    MEMBER_PAIRS = MEMBER_STATES * (MEMBER_STATES + 1) / 2,
    /* Number of horizons at which past forecasts are compared with what happened. */
    SKILL_HORIZONS = 3,
    /* The largest number of forecasts whose comparison is not over. */
    ISSUED_MAX = 9,
    /* The largest number of recent sightings whose innovations are compared with what the filter claimed. */
    EXCESSES_MAX = 24,
    /* Numbers of each: the excess along north, east, down, m^2, and how likely the ship accelerates north, east and in heading. */
    EXCESS_NUMBERS = 6,
};

/* A forecast that was made at instant t, ns: displacement and rate by horizon and direction, m, m/s; rad, rad/s of roll and pitch. */
typedef struct {
    int64_t t;
    double waves[SKILL_HORIZONS * DL_DIRECTIONS * 2];
} dl_issued_forecast;

/* The sums over past comparisons of forecast and observed waves, which fade with time.
 *
 * A sea with two wave systems is no single oscillator, so the member of the bank that fits the recent motion best may forecast the next
 * seconds badly, with full amplitude. The regression slope of the observed on the forecast motion is the factor that minimises the
 * squared error. What the scaled forecasts have missed nonetheless widens the bands of the next ones. */
typedef struct {
    int64_t issued_n;
    /* The forecasts whose longest horizon has not passed yet, oldest first. */
    dl_issued_forecast issued[ISSUED_MAX];
    /* Faded number of comparisons by horizon. */
    double n[SKILL_HORIZONS];
    /* Faded sums of forecast times observed, squared forecast and squared observed motion, by horizon, direction, and displacement or
     * rate. */
    double product[SKILL_HORIZONS * DL_DIRECTIONS * 2], square[SKILL_HORIZONS * DL_DIRECTIONS * 2],
        came[SKILL_HORIZONS * DL_DIRECTIONS * 2];
} dl_forecast_skill;

/* What the bank has learned. Arrays are by direction, then by state or pair of states, then by member. */
typedef struct {
    /* Instants of the newest look and of the newest by a sighting, ns; -1 before the first. */
    int64_t t, sighted;
    /* Frequency, rad/s, damping ratio and size, m or rad, of each direction's mixture. */
    double w_rad_s[DL_DIRECTIONS], zeta[DL_DIRECTIONS], sigma[DL_DIRECTIONS];
    dl_forecast_skill skill;
    /* The members' evidence and weights, states and covariances. */
    double log_weight[DL_DIRECTIONS * DL_MEMBERS], weight[DL_DIRECTIONS * DL_MEMBERS],
        x[DL_DIRECTIONS * MEMBER_STATES * DL_MEMBERS], P[DL_DIRECTIONS * MEMBER_PAIRS * DL_MEMBERS];
} dl_bank;

/* One kind of aiding: its samples that wait to be fused together. */
typedef struct {
    /* Instants of the last fusion and of the first sample in the rejection streak, ns; -1 if there is none. */
    int64_t fused, refused;
    /* Innovation of the first sample in that streak. */
    double first[3];
    /* Number of samples that wait, instant of the first, ns, number of components, and which of a velocity's, a bit each. */
    int64_t n, since, m, axes;
    /* Weight of the hypothesis that the velocity is relative to the deck: 0 over the ground, 1 over the deck. */
    double deck_weight;
    /* Sums of the innovations and of the samples' covariances (m, m). */
    double innov[3], R[9];
    /* Covariance (m, m) that the uncertainty of deck_weight adds to the noise, and of the prediction with it, at `since`. */
    double ambiguity[9], spread[9];
    /* Jacobian (m, COLUMNS_MAX) at `since` by the states on which the kind depends. */
    double H[3 * COLUMNS_MAX];
} dl_aid;

/* Excess of the newest sightings' squared innovations over their largest expected value, oldest first; instants in ns. */
typedef struct {
    int64_t n, t[EXCESSES_MAX];
    double values[EXCESS_NUMBERS * EXCESSES_MAX];
} dl_innovation_excesses;

/* Consecutive rejected sightings that agree with one another: their number, the instants of the first and the last, ns, the measured
 * minus the predicted place of the last in ned, m, and the variance of one component of it, m^2. */
typedef struct {
    int64_t n, since, last;
    double offset_ned[3], var_m2;
    /* Whether they are baselines. */
    int64_t by_baseline;
} dl_rejection_streak;

/* The state. x and the covariance P hold at t_cov; dv, dp, turned and coast_s have gathered the IMU's samples since then. */
typedef struct {
    /* Instants, ns: of the state, of its covariance, of the newest IMU sample and of the newest velocity (-1 if there is none). */
    int64_t t, t_cov, t_imu, t_velocity;
    /* Instant of the newest fused sighting, ns, -1 if there is none or it was forgotten; number of those fused since the pad was set. */
    int64_t sighted, agreed;
    /* Whether the vehicle reported an attitude, whether north comes from it, and whether the heading of the pad's arrow is known. */
    int64_t is_levelled, heading_is_given, heading_known;
    /* Instants, ns, of the newest sighting that measured a heading, showed a manoeuvre of the ship, a hard turn; -1 if there is none. */
    int64_t heading_seen, steered, swung;
    /* Instants, ns, of the newest fused picture, and of the newest fused baseline; -1 if there is none. */
    int64_t pictured, baselined;
    /* Instant of the newest fused report of the ship's motion sensor, ns; -1 if there is none. */
    int64_t reported;
    /* R_ned_body at t, the state at t_cov, and R_ned_body at t_cov. */
    double R[9], x[DL_N], R_cov[9];
    /* Integrals since t_cov: of the specific force in ned, m/s, the same twice, m, and of R, s; time without an IMU, s. */
    double dv[3], dp[3], turned[9], coast_s;
    /* The gyro's newest rate, rad/s, the same after a first-order low-pass, and the accelerometer's specific force, m/s^2. */
    double w[3], w_smooth[3], f[3];
    /* R_ned_body of the vehicle's own attitude, propagated by the gyro, and the covariance that it reported, rad^2. */
    double levelled_by[9], cov_levelled_by[9];
    /* Place and velocity of the body by the IMU alone, m and m/s: the bank learns the sea from them. The variance that the velocity
     * gained beyond the IMU's noise since the bank's last look, (m/s)^2. */
    double ins_p[3], ins_v[3], ins_var_m2_s2;
    /* Variances since t_cov of samples beyond what the vehicle can do, (m/s)^2 and rad^2. */
    double jolt_var_m2_s2, jolt_var_rad2;
    /* Log-odds that the velocity sensor is over the pad's deck and not over the ground. */
    double over_pad;
    /* The bank's frequency, rad/s, damping ratio and size of the waves by direction. */
    double wave_w[DL_DIRECTIONS], wave_zeta[DL_DIRECTIONS], wave_sigma[DL_DIRECTIONS];
    /* Recent mean of the sightings' NIS over their numbers; the same by what they claim to the last tenth of a millimetre. */
    double nis_mean, nis_claimed;
    /* Time for which sightings have agreed with the heading minus the time for which they have contradicted it, s. */
    double heading_held_s;
    /* Instants, ns, of the first and the last rate of turn in a row that the vessel reported and that showed a manoeuvre, of the last
     * heading fused beside one, and until which they are left out; -1 if there is none. The newest one's innovation in deviations. */
    int64_t turn_since, turn_last, turn_heading, turn_left_out;
    double turn_deviate;
    /* The vessel's velocity before her newest manoeuvre in the frame of ins_v, north and east, m/s. */
    double vessel_before[2];
    dl_rejection_streak rejections;
    dl_aid aids[DL_KINDS];
    dl_innovation_excesses excesses;
} dl_belief;

#endif
