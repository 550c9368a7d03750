/* What the filter says of one instant: the pad, and the motion of body and deck. Only the rows that leave it are propagated. */

#include "filter/answer.h"

#include <math.h>
#include <string.h>

#include "filter/jacobian.h"
#include "filter/motion.h"
#include "filter/propagate.h"
#include "base/rotation.h"

/* Each direction of the deck has displacement, rate, force and its rate. */
enum { PER_DIRECTION = 4, DISP = DL_WAVES, RATE = DL_WAVES + 1, FORCE_RATE = DL_WAVES + 3, IN_ROLL = 3 };

/* Rate at which a noise density is the noise of one sample, Hz. */
static const double IMU_HZ = 200.0;

/* A settled belief, and access to its parts. */
typedef struct {
    const dl_belief *b;
    const double *P;
    /* The state with the deck at the body's time. */
    double x[DL_N];
    level_axes level;
} settled;

/* Place and velocity of the pad in level and the body's heading against the arrow, with the covariance at the instant. */
static void answer_pad(const settled *now, const double *F, const double *Q, dl_answer *out)
{
    double J[7 * DL_N] = {0.0}, JF[7 * DL_N];
    for (int i = 0; i < 3; i++) {
        AT(J, i, DL_POS_REL + i) = 1.0;
        AT(J, 3 + i, DL_VEL + i) = -1.0;
    }
    memcpy(out->d, now->x + DL_POS_REL, sizeof out->d);
    pad_velocity(now->x, out->v);
    add_pad_velocity(J + 3 * DL_N);
    for (int i = 0; i < 3; i++) {
        out->v[i] -= now->x[DL_VEL + i];
    }
    turn_rows(&now->level, J);
    turn_rows(&now->level, J + 3 * DL_N);
    turn_vector(&now->level, out->d);
    turn_vector(&now->level, out->v);
    add_turning(&now->level, out->d, J);
    add_turning(&now->level, out->v, J + 3 * DL_N);
    memcpy(J + 6 * DL_N + DL_ATT_ERR, now->level.turning, sizeof now->level.turning);
    AT(J, 6, DL_PAD_YAW) = -1.0;
    out->yaw = out->heading - now->x[DL_PAD_YAW];
    through_alignment(7, now->b->x, J);
    add_spread(7, J, Q, out->cov);
    rows_times(7, J, F, JF);
    add_spread(7, JF, now->P, out->cov);
}

/* Acceleration and rates of the body by the newest IMU sample. */
static void answer_body(const dl_filter_params *o, const settled *now, dl_answer *out)
{
    const dl_belief *b = now->b;
    double J[3 * DL_N] = {0.0}, force[3], cross[9], by_attitude[9];
    for (int i = 0; i < 3; i++) {
        force[i] = b->f[i] - b->x[DL_ACCEL_BIAS + i];
        out->w_body[i] = b->w[i] - b->x[DL_GYRO_BIAS + i];
    }
    rotated(b->R, force, out->a_body);
    skew(out->a_body, cross);
    product(cross, b->R, by_attitude);
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) {
            AT(J, i, DL_ATT_ERR + k) = -by_attitude[3 * i + k];
            AT(J, i, DL_ACCEL_BIAS + k) = -b->R[3 * i + k];
        }
        out->cov_a_body[4 * i] = o->psd_accel * IMU_HZ;
    }
    turn_rows(&now->level, J);
    turn_vector(&now->level, out->a_body);
    out->a_body[2] += GRAVITY_M_S2;
    add_spread(3, J, now->P, out->cov_a_body);
    memcpy(out->levelled_by, b->levelled_by, sizeof out->levelled_by);
    memcpy(out->cov_levelled_by, b->cov_levelled_by, sizeof out->cov_levelled_by);
}

/* The pad's acceleration in ned by the oscillators and the vessel's turn, and its three rows, added to J. */
static void pad_acceleration(const dl_belief *b, const double x[DL_N], double a[3], double *J)
{
    const double rate = x[DL_TURN_RATE];
    for (int k = 0; k < 3; k++) {
        const int at = PER_DIRECTION * k;
        const double w2 = b->wave_w[k] * b->wave_w[k], damping = 2.0 * b->wave_zeta[k] * b->wave_w[k];
        AT(J, k, DISP + at) = -w2;
        AT(J, k, RATE + at) = -damping;
        AT(J, k, FORCE_RATE + at) = 1.0;
        a[k] = -w2 * x[DISP + at] - damping * x[RATE + at] + x[FORCE_RATE + at];
    }
    /* A vector that turns at r has the rate r (-east, north). */
    const double quarter[2] = {-1.0, 1.0};
    for (int i = 0; i < 2; i++) {
        const double across = quarter[i] * x[DL_VESSEL_VEL + 1 - i];
        AT(J, i, DL_VESSEL_VEL + 1 - i) = quarter[i] * rate;
        AT(J, i, DL_TURN_RATE) = across;
        a[i] += rate * across;
    }
}

/* Velocity and acceleration of the pad's centre over the ground, and the deck's tilt with its rates. */
static void answer_deck(const settled *now, dl_answer *out)
{
    double J[6 * DL_N] = {0.0}, tilt[4 * DL_N] = {0.0};
    pad_velocity(now->x, out->v_deck);
    add_pad_velocity(J);
    pad_acceleration(now->b, now->x, out->a_deck, J + 3 * DL_N);
    for (int i = 0; i < 6; i += 3) {
        turn_rows(&now->level, J + i * DL_N);
    }
    turn_vector(&now->level, out->v_deck);
    turn_vector(&now->level, out->a_deck);
    for (int k = 0; k < 2; k++) {
        const int at = PER_DIRECTION * (IN_ROLL + k);
        AT(tilt, k, DISP + at) = AT(tilt, k, DL_DECK_TRIM + k) = AT(tilt, 2 + k, RATE + at) = 1.0;
        out->tilt[k] = now->x[DISP + at] + now->x[DL_DECK_TRIM + k];
        out->tilt[2 + k] = now->x[RATE + at];
    }
    through_alignment(6, now->b->x, J);
    through_alignment(4, now->b->x, tilt);
    add_spread(6, J, now->P, out->cov_deck);
    add_spread(4, tilt, now->P, out->cov_tilt);
}

void answer_at(const dl_filter_params *o, int64_t t, const whole_belief *before, dl_answer *out)
{
    double places[2][DL_N * DL_N], F[DL_N * DL_N], Q[DL_N * DL_N];
    covariance c = {before->P, {places[0], places[1]}};
    dl_belief b = *before->numbers;
    settled now;
    memset(out, 0, sizeof *out);
    propagate_to(o, &b, &c, t);
    propagated_belief(o, &b, F, Q);
    now.b = &b;
    now.P = c.P;
    align(b.x, now.x);
    out->heading = atan2(b.R[3], b.R[0]);
    level_axes_of(b.R, &now.level);
    out->sighted = b.sighted;
    out->agreed = b.agreed;
    out->heading_known = b.heading_known;
    out->nis_mean = b.nis_mean;
    out->velocity_fused = b.aids[DL_VELOCITY].fused;
    out->adrift = is_adrift(&b, t);
    out->steers = steers(&b, t);
    out->turn_left_out = t < b.turn_left_out;
    out->has_pad = happened(b.sighted) && seconds(b.sighted, t) <= o->forget_s;
    out->has_deck = knows_deck(o, &b, t);
    out->carried_down_m = b.ins_p[2];
    out->has_body = happened(b.t_imu) && t - b.t_imu <= o->hold_ns && b.is_levelled;
    if (out->has_body) {
        answer_body(o, &now, out);
    }
    if (out->has_pad) {
        answer_pad(&now, F, Q, out);
    }
    if (out->has_deck) {
        answer_deck(&now, out);
    }
    if (out->has_pad) {
        memcpy(out->x, b.x, sizeof out->x);
        for (int i = 0; i < DL_N; i++) {
            out->var[i] = AT(c.P, i, i);
        }
        memcpy(out->wave_w, b.wave_w, sizeof out->wave_w);
        memcpy(out->wave_zeta, b.wave_zeta, sizeof out->wave_zeta);
        memcpy(out->wave_sigma, b.wave_sigma, sizeof out->wave_sigma);
        out->rest = before->bank->weight[0];
        out->cov_vessel = AT(c.P, DL_VESSEL_VEL, DL_VESSEL_VEL + 1);
    }
}
