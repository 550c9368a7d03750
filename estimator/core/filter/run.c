/* The processing of one event that is not older than the belief. */

#include "filter/run.h"

#include <math.h>
#include <string.h>

#include "filter/aiding.h"
#include "filter/begin.h"
#include "filter/correction.h"
#include "filter/gate.h"
#include "filter/gathering.h"
#include "filter/motion.h"
#include "filter/vessel.h"

/* Time constant of the smoothed body rate, s. */
static const double SMOOTH_S = 0.03;
/* Variance of the attitude error, rad^2, above which the small-angle approximation no longer holds. */
static const double DIVERGED_VAR = 0.35 * 0.35;

static const double TURN_BY_ATTITUDE = 0.02; /* Noise of a turn by differences of the vehicle's own attitude, of that of an unknown one. */
static const double FORCE_BY_THRUST = 0.03; /* Noise of a force by a thrust that carries the weight, of that of an unknown one. */
/* The cosine of the largest tilt at which a thrust is taken to carry the weight. */
static const double LEAST_UPRIGHT = 0.7;

static double largest_step(const double a[3], const double b[3])
{
    return fmax(fabs(a[0] - b[0]), fmax(fabs(a[1] - b[1]), fabs(a[2] - b[2])));
}

/* Cut a sample's change to what the vehicle can do; returns the variance that the part cut off adds. */
static double limit(double sample[3], const double before[3], double step, double step_max, double dt)
{
    if (step <= step_max) {
        return 0.0;
    }
    for (int i = 0; i < 3; i++) {
        sample[i] = before[i] + step_max / step * (sample[i] - before[i]);
    }
    return step * dt * step * dt;
}

static void forget_the_pad(const dl_filter_params *o, dl_belief *b)
{
    if (seconds(b->sighted, b->t) > o->forget_s) {
        b->sighted = -1;
        b->agreed = 0;
        streak_end(b);
    }
}

/* The share of the noise of a body that coasts: a loss that is found late has spoilt all since it began. */
static double unknown_share(const dl_filter_params *o, double lost_s, double substitute)
{
    return lost_s * 1e9 > o->hold_ns ? 1.0 : substitute;
}

/* Put what is known without it in place of a half that is no measurement. Its bias is added, because it is removed afterwards. A
 * multirotor's thrust is along its own vertical axis and carries its weight. */
static void replace_lost(const dl_filter_params *o, dl_belief *b, const dl_imu *imu, double w[3], double f[3])
{
    if (imu->gyro_lost_s > 0.0) {
        for (int i = 0; i < 3; i++) {
            w[i] += b->x[DL_GYRO_BIAS + i];
        }
        b->jolt_var_rad2 += unknown_share(o, imu->gyro_lost_s, TURN_BY_ATTITUDE) * o->psd_coast_turn * imu->gyro_lost_s;
    }
    if (imu->accel_lost_s > 0.0) {
        memcpy(f, b->x + DL_ACCEL_BIAS, 3 * sizeof *f);
        f[2] -= GRAVITY_M_S2 / fmax(b->R[8], LEAST_UPRIGHT);
        b->jolt_var_m2_s2 += unknown_share(o, imu->accel_lost_s, FORCE_BY_THRUST) * o->psd_coast * imu->accel_lost_s;
    }
}

static void fuse_imu(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_event *e)
{
    double w[3], f[3], smooth[3], mean_w[3], mean_f[3];
    memcpy(w, e->sample.imu.w_body, sizeof w);
    memcpy(f, e->sample.imu.f_body, sizeof f);
    replace_lost(o, b, &e->sample.imu, w, f);
    memcpy(smooth, w, sizeof smooth);
    if (happened(b->t_imu) && e->t - b->t_imu <= o->hold_ns) {
        const double dt = seconds(b->t, e->t), weight = -expm1(-seconds(b->t_imu, e->t) / SMOOTH_S);
        b->jolt_var_m2_s2 += limit(f, b->f, largest_step(f, b->f), o->accel_step_m_s2, dt);
        b->jolt_var_rad2 += limit(w, b->w, largest_step(w, b->w), o->gyro_step_rad_s, dt);
        for (int i = 0; i < 3; i++) {
            smooth[i] = b->w_smooth[i] + weight * (w[i] - b->w_smooth[i]);
            mean_w[i] = 0.5 * (b->w[i] + w[i]);
            mean_f[i] = 0.5 * (b->f[i] + f[i]);
        }
        propagate_state(o, b, e->t, mean_w, mean_f);
    } else {
        propagate_to(o, b, c, e->t);
    }
    b->t_imu = e->t;
    memcpy(b->w, w, sizeof w);
    memcpy(b->w_smooth, smooth, sizeof smooth);
    memcpy(b->f, f, sizeof f);
    if (seconds(b->t_cov, b->t) >= o->tick_s) {
        propagate_covariance(o, b, c);
    }
    forget_the_pad(o, b);
}

/* Whether an attitude sets the belief's own outright: the first gives a heading, or the belief's own diverged. */
static int sets_the_attitude(const dl_belief *b, const double *P)
{
    double var = 0.0;
    for (int i = 0; i < 3; i++) {
        var = fmax(var, P[(DL_ATT_ERR + i) * (DL_N + 1)]);
    }
    return !b->heading_is_given || var > DIVERGED_VAR;
}

void ready_to_fuse(const dl_filter_params *o, dl_belief *b, covariance *c, int64_t t)
{
    propagate_to(o, b, c, t);
    propagate_covariance(o, b, c);
    fuse_gathered(o, b, c);
}

/* One of the vehicle's samples. */
static void process_sample(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_event *e, dl_outcome *out)
{
    if (e->kind == DL_IMU) {
        fuse_imu(o, b, c, e);
        return;
    }
    propagate_to(o, b, c, e->t);
    switch (e->kind) {
    case DL_ATTITUDE:
        if (sets_the_attitude(b, c->P)) {
            propagate_covariance(o, b, c);
            set_attitude(o, b, changeable(c), &e->sample.attitude);
        } else {
            fuse_attitude(o, b, c, &e->sample.attitude, out);
        }
        return;
    case DL_VELOCITY:
        fuse_velocity(o, b, c, &e->sample.velocity, out);
        return;
    case DL_RANGE:
        fuse_range(o, b, c, &e->sample.distance, out);
        return;
    case DL_HEIGHT:
        fuse_height(o, b, c, &e->sample.distance, out);
        return;
    default:
        return;
    }
}

void process_event(const dl_filter_params *o, dl_belief *b, covariance *c, sea_ref *bank, const dl_event *e, dl_outcome *out)
{
    const dl_sighting *s = &e->sample.sighting;
    uncompared(out, DL_FUSED);
    if (e->kind == DL_VESSEL) {
        ready_to_fuse(o, b, c, e->t);
        fuse_vessel(o, b, c, &e->sample.vessel, out);
    } else if (e->kind == DL_MOTION) {
        ready_to_fuse(o, b, c, e->t);
        fuse_motion(o, b, c, bank, &e->sample.motion, out);
    } else if (e->kind != DL_SIGHTING) {
        process_sample(o, b, c, e, out);
    } else if (s->confidence < o->min_confidence) {
        out->verdict = DL_LOW_CONFIDENCE;
    } else {
        ready_to_fuse(o, b, c, e->t);
        forget_the_pad(o, b);
        fuse_sighting(o, b, c, bank, s, out);
    }
}
