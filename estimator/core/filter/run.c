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

static void forget_the_pad(const filter_params *o, belief *b)
{
    if (b->sighted >= 0 && seconds(b->sighted, b->t) > o->forget_s) {
        b->sighted = -1;
        b->agreed = 0;
        streak_end(b);
    }
}

static void take_imu(const filter_params *o, belief *b, covariance *c, const event *e)
{
    double w[3], f[3], smooth[3], mean_w[3], mean_f[3];
    memcpy(w, e->value, sizeof w);
    memcpy(f, e->value + 3, sizeof f);
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

/* An attitude that sets the belief's own outright is none of ours. */
static int sets_the_attitude(const belief *b, const double *P)
{
    double var = 0.0;
    for (int i = 0; i < 3; i++) {
        var = fmax(var, P[(ATT_ERR + i) * (N + 1)]);
    }
    return !b->heading_is_given || var > DIVERGED_VAR;
}

/* State and covariance at t, with the means of all gathered samples fused: otherwise another correction would count twice. */
static void ready_to_fuse(const filter_params *o, belief *b, covariance *c, int64_t t)
{
    propagate_to(o, b, c, t);
    propagate_covariance(o, b, c);
    fuse_gathered(o, b, c);
}

/* One of the vehicle's samples; returns 0 if it is none of ours. */
static int take_sample(const filter_params *o, belief *b, covariance *c, const event *e, outcome *out)
{
    if (e->kind == IMU) {
        take_imu(o, b, c, e);
        return 1;
    }
    propagate_to(o, b, c, e->t);
    switch (e->kind) {
    case ATTITUDE:
        if (sets_the_attitude(b, c->P)) {
            return 0;
        }
        take_attitude(o, b, c, e->value, e->value + 9, out);
        return 1;
    case VELOCITY:
        take_velocity(o, b, c, e->value, e->value + 3, out);
        return 1;
    case RANGE:
        take_range(o, b, c, e->value[0], e->value[1], out);
        return 1;
    case HEIGHT:
        take_height(o, b, c, e->value[0], e->value[1], out);
        return 1;
    default:
        return 0;
    }
}

static int take(const filter_params *o, belief *b, covariance *c, sea_ref *bank, const event *e, const sighting *s, outcome *out)
{
    memset(out, 0, sizeof *out);
    out->nis = out->nis_max = NAN;
    out->verdict = FUSED;
    if (e->kind == VESSEL) {
        ready_to_fuse(o, b, c, e->t);
        take_vessel(o, b, c, e->value, out);
        return 1;
    }
    if (e->kind != SIGHTING) {
        return take_sample(o, b, c, e, out);
    }
    if (s->confidence < o->min_confidence) {
        out->verdict = LOW_CONFIDENCE;
        return 1;
    }
    ready_to_fuse(o, b, c, e->t);
    forget_the_pad(o, b);
    take_sighting(o, b, c, bank, s, out);
    return 1;
}

/* The events in their order, of which those of kind SIGHTING take the sightings one by one. Returns how many were processed: the
 * next one is none of ours. A covariance or a bank that an event changed is written once; its index says which of those written
 * belongs to the belief after an event, -1 the one before all of them. */
int32_t filter_run(const filter_params *o, int32_t n, const event *events, const sighting *sightings, const belief *before,
                   const double *P_before, const sea *sea_before, belief *after, double *P_after, sea *sea_after,
                   int64_t *P_index, int64_t *sea_index, outcome *outcomes)
{
    double places[2][N * N];
    const double *P = P_before;
    sea_ref bank = {sea_before, sea_after};
    int32_t used = 0;
    for (int32_t i = 0; i < n; i++) {
        covariance c = {P, {places[0], places[1]}};
        after[i] = i == 0 ? *before : after[i - 1];
        if (!take(o, &after[i], &c, &bank, &events[i], sightings, &outcomes[i])) {
            return i;
        }
        if (c.P != P) {
            P = memcpy(P_after + (size_t)used * N * N, c.P, sizeof places[0]);
            used++;
        }
        P_index[i] = used - 1;
        sightings += events[i].kind == SIGHTING;
        bank.place += bank.now == bank.place;
        sea_index[i] = bank.place - sea_after - 1;
    }
    return n;
}

int32_t filter_propagate(const filter_params *o, int32_t what, int64_t t, const belief *before, const double *P_before,
                         belief *after, double *P_after)
{
    double places[2][N * N];
    covariance c = {P_before, {places[0], places[1]}};
    *after = *before;
    if (what >= WITH_AIDING) {
        ready_to_fuse(o, after, &c, t);
    } else {
        propagate_to(o, after, &c, t);
    }
    if (what == WITH_COVARIANCE) {
        propagate_covariance(o, after, &c);
    }
    if (c.P != P_before) {
        memcpy(P_after, c.P, sizeof places[0]);
    }
    return c.P != P_before;
}

void filter_settle(const filter_params *o, const belief *before, belief *after, double *F, double *Q)
{
    *after = *before;
    propagated_belief(o, after, F, Q);
}
