/* The processing of events in the order of their instants, one after the other in one call. */

#include <math.h>
#include <string.h>

#include "filter/aiding.h"
#include "filter/gate.h"
#include "filter/gathering.h"
#include "decklander.h"
#include "filter/propagate.h"
#include "filter/vessel.h"
#include "filter/vision_update.h"

/* Time constant of the smoothed body rate, s. */
static const double SMOOTH_S = 0.03;
/* Variance of the attitude error, rad^2, above which the small-angle approximation no longer holds. */
static const double DIVERGED_VAR = 0.35 * 0.35;

/* Noise of a turn by differences of the vehicle's own attitude, and of a force by a thrust that carries the weight, as parts of that
 * of a body of which neither is known. */
static const double TURN_BY_ATTITUDE = 0.02, FORCE_BY_THRUST = 0.03;
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
    if (b->sighted >= 0 && seconds(b->sighted, b->t) > o->forget_s) {
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

static void take_imu(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_event *e)
{
    double w[3], f[3], smooth[3], mean_w[3], mean_f[3];
    memcpy(w, e->sample.imu.w_body, sizeof w);
    memcpy(f, e->sample.imu.f_body, sizeof f);
    replace_lost(o, b, &e->sample.imu, w, f);
    memcpy(smooth, w, sizeof smooth);
    if (b->t_imu >= 0 && e->t - b->t_imu <= o->hold_ns) {
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

/* An attitude that sets the belief's own outright is handled elsewhere. */
static int sets_the_attitude(const dl_belief *b, const double *P)
{
    double var = 0.0;
    for (int i = 0; i < 3; i++) {
        var = fmax(var, P[(DL_ATT_ERR + i) * (DL_N + 1)]);
    }
    return !b->heading_is_given || var > DIVERGED_VAR;
}

/* State and covariance at t, with the means of all gathered samples fused: otherwise another correction would count twice. */
static void ready_to_fuse(const dl_filter_params *o, dl_belief *b, covariance *c, int64_t t)
{
    propagate_to(o, b, c, t);
    propagate_covariance(o, b, c);
    fuse_gathered(o, b, c);
}

/* One of the vehicle's samples; returns 0 for other samples. */
static int take_sample(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_event *e, dl_outcome *out)
{
    if (e->kind == DL_IMU) {
        take_imu(o, b, c, e);
        return 1;
    }
    propagate_to(o, b, c, e->t);
    switch (e->kind) {
    case DL_ATTITUDE:
        if (sets_the_attitude(b, c->P)) {
            return 0;
        }
        take_attitude(o, b, c, &e->sample.attitude, out);
        return 1;
    case DL_VELOCITY:
        take_velocity(o, b, c, &e->sample.velocity, out);
        return 1;
    case DL_RANGE:
        take_range(o, b, c, &e->sample.distance, out);
        return 1;
    case DL_HEIGHT:
        take_height(o, b, c, &e->sample.distance, out);
        return 1;
    default:
        return 0;
    }
}

static int take(const dl_filter_params *o, dl_belief *b, covariance *c, sea_ref *bank, const dl_event *e, const dl_sighting *s, dl_outcome *out)
{
    memset(out, 0, sizeof *out);
    out->nis = out->nis_max = NAN;
    out->verdict = DL_FUSED;
    if (e->kind == DL_VESSEL) {
        ready_to_fuse(o, b, c, e->t);
        take_vessel(o, b, c, &e->sample.vessel, out);
        return 1;
    }
    if (e->kind != DL_SIGHTING) {
        return take_sample(o, b, c, e, out);
    }
    if (s->confidence < o->min_confidence) {
        out->verdict = DL_LOW_CONFIDENCE;
        return 1;
    }
    ready_to_fuse(o, b, c, e->t);
    forget_the_pad(o, b);
    take_sighting(o, b, c, bank, s, out);
    return 1;
}

int32_t dl_filter_run(const dl_filter_params *o, int32_t n, const dl_event *events, int32_t sightings_n, const dl_sighting *sightings,
                   const dl_whole_belief *before, const dl_filter_row *out)
{
    double places[2][DL_N * DL_N];
    const double *P = before->P;
    sea_ref bank = {before->bank, out->banks};
    int32_t used = 0, seen = 0;
    for (int32_t i = 0; i < n; i++) {
        dl_filter_step *step = &out->steps[i];
        covariance c = {P, {places[0], places[1]}};
        const int shows_the_pad = events[i].kind == DL_SIGHTING;
        step->after = i == 0 ? *before->numbers : out->steps[i - 1].after;
        if (seen + shows_the_pad > sightings_n || !take(o, &step->after, &c, &bank, &events[i], sightings + seen, &step->outcome)) {
            return i;
        }
        if (c.P != P) {
            P = memcpy(out->P + (size_t)used * DL_N * DL_N, c.P, sizeof places[0]);
            used++;
        }
        step->P_index = used - 1;
        seen += shows_the_pad;
        bank.place += bank.now == bank.place;
        step->bank_index = bank.place - out->banks - 1;
    }
    return n;
}

void dl_filter_propagate(const dl_filter_params *o, int32_t what, int64_t t, const dl_whole_belief *before, dl_belief *after, double *P_after)
{
    double places[2][DL_N * DL_N];
    covariance c = {before->P, {places[0], places[1]}};
    *after = *before->numbers;
    if (what == DL_WITH_AIDING) {
        ready_to_fuse(o, after, &c, t);
    } else {
        propagate_to(o, after, &c, t);
        propagate_covariance(o, after, &c);
    }
    memcpy(P_after, c.P, sizeof places[0]);
}
