/* Fuse a vessel's report of her velocity, heading and rate of turn, and believe a manoeuvre that it shows. */

#include "filter/vessel.h"

#include <math.h>
#include <string.h>

#include "filter/correction.h"
#include "filter/deck_jolt.h"
#include "filter/jacobian.h"
#include "base/rotation.h"

enum { ROWS = 4 };
/* A rate of turn shows a manoeuvre where it is off by so many deviations, or by so many twice in a row to the same side. */
static const double MANY = 5.0, FEW = 3.0;
/* Standard deviation of a rate of turn besides the sensor's own, rad/s, where it is judged and where it is fused: it is filtered and
 * late, and so weak that sight contradicts one that lies. */
static const double JUDGED_RAD_S = 0.01, FUSED_RAD_S = 0.05;
/* A heading beside a rate of turn is fused so seldom, s: the errors of a compass are alike from one report to the next. */
static const double HEADING_EACH_S = 1.0;
static const double POINT_SIGMA_M = 1.0; /* Standard deviation of the turning point's place, m. */
static const double SWUNG_RAD_S = 0.2; /* Rate of turn that swings a pad aside, rad/s. */
/* A sensor that is off after a manoeuvre while the pad is in sight is contradicted by it. */
static const double OFF_RAD_S = 0.1; /* Rate by which it is off, rad/s. */
static const double PAUSE_S = 1.0; /* Pause that ends it, s. */
static const double CONTRADICTED_S = 1.5; /* Time for which it goes on, s. */
static const double IN_SIGHT_S = 0.6; /* Age of a sighting that still is sight, s. */
static const double LEFT_OUT_S = 10.0; /* Time for which the sensor is left out, s. */
/* Number of sightings that know the pad's motion. */
enum { ESTABLISHED = 8 };
/* Standard deviation of the velocity over the ground of a body whose sensor may be over the deck instead, m/s. */
static const double EITHER_M_S = 0.5;

/* The pad from the place that reports its velocity, north and east, m. */
static void pad_arm(const dl_filter_params *o, const dl_belief *b, double arm[2])
{
    const double bow = b->x[DL_PAD_YAW] - o->pad_yaw_in_vessel_rad, c = cos(bow), s = sin(bow);
    arm[0] = c * o->pad_in_vessel_m[0] - s * o->pad_in_vessel_m[1];
    arm[1] = s * o->pad_in_vessel_m[0] + c * o->pad_in_vessel_m[1];
}

/* The reported velocity at the pad: that of the ship's point with what her turn adds. */
static void compare_velocity(const dl_filter_params *o, const dl_belief *b, const double v[3], double innov[3], double *H)
{
    double v_pad[3], arm[2];
    const double turn = b->x[DL_TURN_RATE] + b->x[DL_YAW_RATE];
    pad_velocity(b->x, v_pad);
    pad_arm(o, b, arm);
    const double swing[3] = {-turn * arm[1], turn * arm[0], 0.0};
    for (int i = 0; i < 3; i++) {
        innov[i] = v[i] + swing[i] - v_pad[i];
    }
    add_pad_velocity(H);
    for (int i = 0; i < 2; i++) {
        AT(H, i, DL_TURN_RATE) = AT(H, i, DL_YAW_RATE) = i == 0 ? arm[1] : -arm[0];
    }
}

/* Whether an innovation of the rate of turn, rad/s, with its deviation shows a manoeuvre that sight does not contradict. */
static int shows_manoeuvre(dl_belief *b, double innov, double sigma)
{
    const double before = b->turn_deviate, now = innov / sigma;
    const int shows = fabs(now) > MANY || (fabs(now) > FEW && fabs(before) > FEW && now * before > 0.0);
    const int goes_on = happened(b->turn_last) && seconds(b->turn_last, b->t) <= PAUSE_S;
    b->turn_deviate = now;
    if (!(shows || (goes_on && fabs(innov) > OFF_RAD_S)) || b->agreed < ESTABLISHED || seconds(b->sighted, b->t) > IN_SIGHT_S) {
        return 0;
    }
    b->turn_since = goes_on ? b->turn_since : b->t;
    b->turn_last = b->t;
    if (seconds(b->turn_since, b->t) > CONTRADICTED_S) {
        b->turn_left_out = b->t + (int64_t)(LEFT_OUT_S * 1e9);
    }
    return shows && b->t >= b->turn_left_out;
}

/* Widen the belief by a change of her rate of turn, which swings the pad. */
static void loosen_turn(const dl_filter_params *o, dl_belief *b, covariance *c, double innov)
{
    double *P = changeable(c), arm[2];
    pad_arm(o, b, arm);
    const int states[3] = {DL_TURN_RATE, DL_VESSEL_VEL, DL_VESSEL_VEL + 1};
    const double by[3] = {innov, -innov * arm[1], innov * arm[0]}, point = POINT_SIGMA_M * innov;
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            AT(P, states[i], states[j]) += by[i] * by[j] + (i == j && i > 0 ? point * point : 0.0);
        }
    }
    jolt_note_manoeuvre(b);
    b->swung = fabs(innov) > SWUNG_RAD_S ? b->t : b->swung;
}

static void fuse_turn(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_vessel_report *report, dl_outcome *out)
{
    double H[DL_N] = {0.0};
    dl_outcome beside;
    const double innov = report->turn_rad_s - b->x[DL_TURN_RATE] - b->x[DL_YAW_RATE];
    const double own = report->sigma_turn_rad_s * report->sigma_turn_rad_s, R = own + FUSED_RAD_S * FUSED_RAD_S;
    const measured z = {1, &innov, H, &R};
    H[DL_TURN_RATE] = H[DL_YAW_RATE] = 1.0;
    const double var = AT(c->P, DL_TURN_RATE, DL_TURN_RATE) + AT(c->P, DL_YAW_RATE, DL_YAW_RATE) + 2.0 * AT(c->P, DL_TURN_RATE, DL_YAW_RATE);
    if (shows_manoeuvre(b, innov, sqrt(fmax(var, 0.0) + own + JUDGED_RAD_S * JUDGED_RAD_S))) {
        loosen_turn(o, b, c, innov);
    }
    if (b->t >= b->turn_left_out) {
        fuse_gated(o, b, c, &z, 1 << ROWS, false, out->m == 0 ? out : &beside);
    }
}

/* Whether something happened so lately that a picture is still fresh. */
static bool lately(int64_t t, const dl_belief *b)
{
    return happened(t) && seconds(t, b->t) <= IN_SIGHT_S;
}

/* Fuse velocity, heading, or both. In sight of the pad a velocity says only how fast body and vessel move together: what it
 * contradicts there is a sensor over the wrong surface, and no tilt or bias. */
static void fuse_way(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_vessel_report *report, int has_heading, dl_outcome *out)
{
    double innov[ROWS], H[ROWS * DL_N] = {0.0}, R[ROWS * ROWS] = {0.0};
    const int has_velocity = report->has_velocity != 0, either = o->velocity_is_over == DL_OVER_EITHER;
    const int m = 3 * has_velocity + has_heading, axes = 7 * has_velocity | 8 * has_heading;
    if (has_velocity) {
        compare_velocity(o, b, report->v_ned, innov, H);
        for (int i = 0; i < 9; i++) {
            R[i / 3 * m + i % 3] = report->cov_v_ned[i] + (either && i % 4 == 0 ? EITHER_M_S * EITHER_M_S : 0.0);
        }
    }
    if (has_heading) {
        innov[m - 1] = wrapped(report->heading_rad + o->pad_yaw_in_vessel_rad - b->x[DL_PAD_YAW]);
        AT(H, m - 1, DL_PAD_YAW) = 1.0;
        R[m * m - 1] = report->sigma_heading_rad * report->sigma_heading_rad;
    }
    if (fuse_gated(o, b, c, &(measured){m, innov, H, R}, axes, !has_heading && lately(b->sighted, b), out)) {
        b->heading_known |= has_heading;
        b->turn_heading = has_heading ? b->t : b->turn_heading;
    }
}

void fuse_vessel(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_vessel_report *report, dl_outcome *out)
{
    const int due = !happened(b->turn_heading) || seconds(b->turn_heading, b->t) >= HEADING_EACH_S;
    /* A picture knows the arrow better against the body than two compasses do. */
    const int has_heading = report->has_heading && (due || !report->has_turn) && !lately(b->heading_seen, b);
    out->verdict = DL_GATED;
    if (report->has_velocity || has_heading) {
        fuse_way(o, b, c, report, has_heading, out);
    }
    if (report->has_turn) {
        fuse_turn(o, b, c, report, out);
    }
}
