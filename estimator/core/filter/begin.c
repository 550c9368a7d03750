/* Begin the state, and set its attitude where the small-angle approximation does not hold. */

#include "filter/begin.h"

#include <math.h>
#include <string.h>

#include "base/rotation.h"
#include "filter/bank.h"
#include "filter/correction.h"
#include "filter/oscillator.h"

/* Standard deviation of the tilt from the accelerometer alone, rad: a multirotor measures its thrust, which tilts with the body. */
static const double FELT_TILT_RAD = 12.0 * 0.017453292519943295;
/* Standard deviation of the heading where the body first pointed, rad: north is that direction. */
static const double FELT_HEADING_RAD = 2.0 * 0.017453292519943295;
/* Part of gravity by which a specific force may be off and still show which way is down. */
static const double NOT_GRAVITY = 0.5;

/* P = the covariance of an attitude's error: sideways of the tilt, along the down axis of the heading. */
static void set_tilt_var(const double R[9], double sigma_tilt_rad, double sigma_heading_rad, double *P)
{
    const double *down = R + 6, tilt = sigma_tilt_rad * sigma_tilt_rad, heading = sigma_heading_rad * sigma_heading_rad;
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            const double along = down[i] * down[j];
            AT(P, DL_ATT_ERR + i, DL_ATT_ERR + j) = tilt * ((i == j) - along) + heading * along;
        }
    }
}

static void begin(const dl_filter_params *o, int64_t t, const double R[9], const double sigmas_rad[2], dl_belief *b, double *P, dl_bank *bank)
{
    memset(b, 0, sizeof *b);
    memset(P, 0, DL_N * DL_N * sizeof *P);
    bank_begin(&o->members, bank);
    b->t = b->t_cov = t;
    b->t_imu = b->t_velocity = b->sighted = b->heading_seen = b->steered = b->swung = b->pictured = b->baselined = b->reported = -1;
    b->turn_since = b->turn_last = b->turn_heading = b->turn_left_out = -1;
    memcpy(b->R, R, sizeof b->R);
    memcpy(b->R_cov, R, sizeof b->R_cov);
    b->x[DL_VEL_SCALE] = o->velocity_scale;
    b->nis_mean = b->nis_claimed = 1.0;
    for (int kind = 0; kind < DL_KINDS; kind++) {
        b->aids[kind].fused = b->aids[kind].refused = -1;
    }
    memcpy(b->wave_w, bank->w_rad_s, sizeof b->wave_w);
    memcpy(b->wave_zeta, bank->zeta, sizeof b->wave_zeta);
    memcpy(b->wave_sigma, bank->sigma, sizeof b->wave_sigma);
    set_tilt_var(R, sigmas_rad[0], sigmas_rad[1], P);
    for (int i = 0; i < DL_N; i++) {
        AT(P, i, i) += o->initial_var[i];
    }
    for (int k = 0; k < DL_DIRECTIONS; k++) {
        const int first = DL_WAVES + WAVE_STATES * k;
        double at_rest[WAVE_STATES][WAVE_STATES];
        oscillator_at_rest(b->wave_w[k], b->wave_zeta[k], at_rest);
        for (int i = 0; i < WAVE_STATES; i++) {
            for (int j = 0; j < WAVE_STATES; j++) {
                AT(P, first + i, first + j) = b->wave_sigma[k] * b->wave_sigma[k] * at_rest[i][j];
            }
        }
    }
}

/* The attitude was just set by the vehicle's own: its error is that of the vehicle's, with the constant part of it. */
static void level_by(const dl_filter_params *o, dl_belief *b, double *P, const dl_attitude *seen)
{
    const double var = o->sigma_attitude_bias_rad * o->sigma_attitude_bias_rad;
    for (int i = 0; i < 2; i++) {
        forget_state(P, DL_ATT_BIAS + i, var);
    }
    for (int i = 0; i < 2; i++) {
        AT(P, DL_ATT_ERR + i, DL_ATT_ERR + i) += var;
        AT(P, DL_ATT_ERR + i, DL_ATT_BIAS + i) = AT(P, DL_ATT_BIAS + i, DL_ATT_ERR + i) = -var;
    }
    memcpy(b->levelled_by, seen->R_ned_body, sizeof b->levelled_by);
    memcpy(b->cov_levelled_by, seen->cov_body, sizeof b->cov_levelled_by);
    b->is_levelled = b->heading_is_given = 1;
}

bool begin_belief(const dl_filter_params *o, const dl_event *e, dl_belief *b, double *P, dl_bank *bank, dl_outcome *out)
{
    uncompared(out, DL_FUSED);
    if (e->kind == DL_ATTITUDE) {
        const double sigmas_rad[2] = {o->sigma_initial_tilt_rad, o->sigma_initial_heading_rad};
        begin(o, e->t, e->sample.attitude.R_ned_body, sigmas_rad, b, P, bank);
        level_by(o, b, P, &e->sample.attitude);
        return true;
    }
    const double *f = e->sample.imu.f_body, sigmas_rad[2] = {FELT_TILT_RAD, FELT_HEADING_RAD};
    if (e->kind == DL_IMU && fabs(sqrt(dot(f, f)) - GRAVITY_M_S2) < NOT_GRAVITY * GRAVITY_M_S2) {
        double R[9];
        from_rpy(atan2(-f[1], -f[2]), atan2(f[0], hypot(f[1], f[2])), 0.0, R);
        begin(o, e->t, R, sigmas_rad, b, P, bank);
        b->t_imu = e->t;
        memcpy(b->w, e->sample.imu.w_body, sizeof b->w);
        memcpy(b->w_smooth, b->w, sizeof b->w_smooth);
        memcpy(b->f, f, sizeof b->f);
        return true;
    }
    out->verdict = DL_NO_ATTITUDE;
    return false;
}

/* Vectors north and east in the state, by their first index: the waves' come apart by a direction's states. */
static void turn_state(double *x, int north, int east, double c, double s)
{
    const double n = x[north], e = x[east];
    x[north] = c * n - s * e;
    x[east] = s * n + c * e;
}

/* Turn rows and columns of P as the state's vectors. */
static void turn_covariance(double *P, int north, int east, double c, double s)
{
    for (int k = 0; k < DL_N; k++) {
        const double n = AT(P, north, k), e = AT(P, east, k);
        AT(P, north, k) = c * n - s * e;
        AT(P, east, k) = s * n + c * e;
    }
    for (int k = 0; k < DL_N; k++) {
        turn_state(P + k * DL_N, north, east, c, s);
    }
}

/* Turn the whole belief about the vertical by an angle to a heading that is now known. */
static void turn_belief(double angle, dl_belief *b, double *P)
{
    const double c = cos(angle), s = sin(angle);
    int pairs[3 + WAVE_STATES][2] = {
        {DL_POS_REL, DL_POS_REL + 1}, {DL_VEL, DL_VEL + 1}, {DL_VESSEL_VEL, DL_VESSEL_VEL + 1}};
    for (int i = 0; i < WAVE_STATES; i++) {
        pairs[3 + i][0] = DL_WAVES + i, pairs[3 + i][1] = DL_WAVES + WAVE_STATES + i;
    }
    for (int i = 0; i < 3 + WAVE_STATES; i++) {
        turn_state(b->x, pairs[i][0], pairs[i][1], c, s);
        turn_covariance(P, pairs[i][0], pairs[i][1], c, s);
    }
    b->x[DL_PAD_YAW] = wrapped(b->x[DL_PAD_YAW] + angle);
    turn_state(b->ins_p, 0, 1, c, s);
    turn_state(b->ins_v, 0, 1, c, s);
}

void set_attitude(const dl_filter_params *o, dl_belief *b, double *P, const dl_attitude *seen)
{
    if (!b->heading_is_given) {
        turn_belief(heading_of(seen->R_ned_body) - heading_of(b->R), b, P);
    }
    for (int i = 0; i < 3; i++) {
        forget_state(P, DL_ATT_ERR + i, 0.0);
    }
    set_tilt_var(seen->R_ned_body, o->sigma_initial_tilt_rad, o->sigma_initial_heading_rad, P);
    memcpy(b->R, seen->R_ned_body, sizeof b->R);
    memcpy(b->R_cov, seen->R_ned_body, sizeof b->R_cov);
    level_by(o, b, P, seen);
}
