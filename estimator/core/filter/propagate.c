/* Propagate the belief by the IMU, the waves and the vessel's motion, and its covariance with it. */

#include "filter/propagate.h"

#include <math.h>
#include <string.h>

#include "filter/oscillator.h"
#include "base/kalman.h"
#include "base/rotation.h"


/* Fraction of a direction's energy that lies in waves too short for the learned oscillators; it enters as white acceleration. */
static const double SHORT_FRACTION = 0.002;
static const double YAW_DAMPING = 0.5; /* Damping ratio of the yaw on waves. */
static const double STEERS_S = 0.4; /* Time for which a ship that manoeuvres is assumed to go on after sightings showed it, s. */
static const double STEERS_PSD = 2.0 * 2.0 * 0.1; /* Density of her acceleration meanwhile: 2 m/s^2 for a tenth of a second. */
static const double STEERS_TURN_PSD = 0.5 * 0.5 * 0.1; /* Density of her turn's: 0.5 rad/s^2 for a tenth of a second. */

/* A pad that a turning ship swings aside has her speed again after the turn: its velocity and turn come back to what they were before. */
static const double SWINGS_S = 1.0; /* Time since the newest sighting of a turn within which a lost pad was swung, s. */
static const double BEGINS_S = 0.1; /* The same since one of any manoeuvre, s: what leaves so soon is swung. */
static const double SWING_UNSEEN_S = 0.3; /* Time unseen after which velocity and turn come back, s. */
static const double SETTLES_S = 0.3; /* Time within which they do, s. */
/* Time after the last sighting at which the swing is over, and velocities show again how the body moves, s. */
static const double SWUNG_S = 2.0;
static const double SETTLED_M_S = 0.7; /* Standard deviation that the velocity keeps, m/s. */
static const double SETTLED_RAD_S = 0.5; /* The same of the turn, rad/s. */

int happened(int64_t t)
{
    return t >= 0;
}

double seconds(int64_t since, int64_t until)
{
    return (double)(until - since) * 1e-9;
}

double *free_place(const covariance *c)
{
    return c->places[c->P == c->places[0]];
}

/* The velocity changes steadily by dv within dt. */
static void move_by(dl_belief *b, const double dv[3], double dt)
{
    for (int i = 0; i < 3; i++) {
        b->dp[i] += b->dv[i] * dt + dv[i] * 0.5 * dt;
        b->dv[i] += dv[i];
    }
}

void propagate_state(const dl_filter_params *o, dl_belief *b, int64_t t, const double w[3], const double f[3])
{
    const double dt = seconds(b->t, t);
    if (dt <= 0.0) {
        return;
    }
    if (!happened(b->t_imu) || t - b->t_imu > o->hold_ns) {
        const double weightless[3] = {0.0, 0.0, -GRAVITY_M_S2 * dt};
        move_by(b, weightless, dt);
        for (int i = 0; i < 9; i++) {
            b->turned[i] += b->R[i] * dt;
        }
        b->coast_s += dt;
        b->t = t;
        return;
    }
    double angle[3], force[3], turn[9], R[9], step[9], dv[3];
    for (int i = 0; i < 3; i++) {
        angle[i] = (w[i] - b->x[DL_GYRO_BIAS + i]) * dt;
        force[i] = f[i] - b->x[DL_ACCEL_BIAS + i];
    }
    exp_rotation(angle, turn);
    product(b->R, turn, R);
    for (int i = 0; i < 9; i++) {
        step[i] = (b->R[i] + R[i]) * (0.5 * dt);
        b->turned[i] += step[i];
    }
    rotated(step, force, dv);
    move_by(b, dv, dt);
    memcpy(b->R, R, sizeof R);
    if (b->is_levelled) {
        product(b->levelled_by, turn, R);
        memcpy(b->levelled_by, R, sizeof R);
    }
    b->t = t;
}

/* One direction of the sea over T: A, and q for its size with what waves too short for the oscillators add as white acceleration. */
static void wave_transition(double w, double zeta, double sigma, double T, double A[4][4], double q[4][4])
{
    const double psd = 4.0 * SHORT_FRACTION * zeta * w * w * w;
    const double white[2][2] = {{psd * T * T * T / 3.0, psd * T * T / 2.0}, {psd * T * T / 2.0, psd * T}};
    oscillator_transition(w, zeta, T, A, q);
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) {
            const double more = i < 2 && j < 2 ? white[i][j] : 0.0;
            q[i][j] = sigma * sigma * (q[i][j] + more);
        }
    }
}

/* Yaw on waves and its rate over T, a damped oscillator: A, and q for a unit rate. */
static void yaw_transition(double w, double T, double A[2][2], double q[2][2])
{
    const double delta = YAW_DAMPING * w, wd = sqrt(w * w - delta * delta), e = exp(-delta * T);
    const double c = e * cos(wd * T), s = e * sin(wd * T) / wd;
    const double a = c + delta * s, b = s, d = -w * w * s, f = c - delta * s, at_rest = 1.0 / (w * w);
    A[0][0] = a, A[0][1] = b, A[1][0] = d, A[1][1] = f;
    q[0][0] = at_rest - (a * a * at_rest + b * b);
    q[0][1] = q[1][0] = -(a * d * at_rest + b * f);
    q[1][1] = 1.0 - (d * d * at_rest + f * f);
}

/* M[row.., column..] = scale B, three by three */
static void set_block(double *M, int row, int column, double scale, const double B[9])
{
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            AT(M, row + i, column + j) = scale * B[3 * i + j];
        }
    }
}

static void set_symmetric(double *M, int row, int column, double value)
{
    AT(M, row, column) = AT(M, column, row) = value;
}

/* The parts of F and Q that belong to sea and yaw, which are moved on. */
static void move_deck(const dl_filter_params *o, dl_belief *b, double T, double moved[3], double *F, double *Q)
{
    for (int k = 0; k < 5; k++) {
        const int at = DL_WAVES + 4 * k;
        double A[4][4], q[4][4], before[4];
        wave_transition(b->wave_w[k], b->wave_zeta[k], b->wave_sigma[k], T, A, q);
        memcpy(before, b->x + at, sizeof before);
        for (int i = 0; i < 4; i++) {
            b->x[at + i] = 0.0;
            for (int j = 0; j < 4; j++) {
                b->x[at + i] += A[i][j] * before[j];
                AT(F, at + i, at + j) = A[i][j];
                AT(Q, at + i, at + j) = q[i][j];
            }
        }
        if (k < 3) {
            moved[k] = b->x[at] - before[0];
            AT(Q, DL_POS_REL + k, DL_POS_REL + k) += q[0][0];
            for (int j = 0; j < 4; j++) {
                AT(F, DL_POS_REL + k, at + j) = A[0][j] - (j == 0);
                set_symmetric(Q, DL_POS_REL + k, at + j, q[0][j]);
            }
        }
    }
    double A[2][2], q[2][2];
    const double var = o->sigma_wave_yaw_rate_rad_s * o->sigma_wave_yaw_rate_rad_s;
    const int yaw[2] = {DL_WAVE_YAW, DL_YAW_RATE};
    yaw_transition(o->wave_yaw_rad_s, T, A, q);
    const double before[2] = {b->x[DL_WAVE_YAW], b->x[DL_YAW_RATE]};
    for (int i = 0; i < 2; i++) {
        b->x[yaw[i]] = A[i][0] * before[0] + A[i][1] * before[1];
        AT(F, DL_PAD_YAW, yaw[i]) = A[0][i] - (i == 0);
        set_symmetric(Q, DL_PAD_YAW, yaw[i], q[0][i] * var);
        for (int j = 0; j < 2; j++) {
            AT(F, yaw[i], yaw[j]) = A[i][j];
            AT(Q, yaw[i], yaw[j]) = q[i][j] * var;
        }
    }
    b->x[DL_PAD_YAW] += b->x[DL_TURN_RATE] * T + b->x[DL_WAVE_YAW] - before[0];
    AT(F, DL_PAD_YAW, DL_TURN_RATE) = T;
    const double turning = AT(Q, DL_TURN_RATE, DL_TURN_RATE);
    AT(Q, DL_PAD_YAW, DL_PAD_YAW) = q[0][0] * var + turning * (T * T / 3.0);
    set_symmetric(Q, DL_PAD_YAW, DL_TURN_RATE, 0.5 * T * turning);
}

/* The vessel's way and turn, which move the pad by more than the sea did. */
static void move_vessel(dl_belief *b, double T, double moved[3], double *F)
{
    const double u[2] = {b->x[DL_VESSEL_VEL], b->x[DL_VESSEL_VEL + 1]};
    double by[2][2], reach[2][2];
    steady_turn(b->x[DL_TURN_RATE], T, by, reach);
    for (int i = 0; i < 2; i++) {
        b->x[DL_VESSEL_VEL + i] = by[i][0] * u[0] + by[i][1] * u[1];
        moved[i] += reach[i][0] * u[0] + reach[i][1] * u[1];
        for (int j = 0; j < 2; j++) {
            AT(F, DL_POS_REL + i, DL_VESSEL_VEL + j) = reach[i][j];
            AT(F, DL_VESSEL_VEL + i, DL_VESSEL_VEL + j) = by[i][j];
        }
    }
    /* A vector that turns at r has the rate r (-east, north). */
    const double quarter[2] = {-1.0, 1.0};
    for (int i = 0; i < 2; i++) {
        AT(F, DL_VESSEL_VEL + i, DL_TURN_RATE) = T * quarter[i] * b->x[DL_VESSEL_VEL + 1 - i];
        AT(F, DL_POS_REL + i, DL_TURN_RATE) = 0.5 * T * T * quarter[i] * u[1 - i];
    }
}

/* The body: its derivatives by attitude, velocity and the IMU's biases. */
static void move_body(const dl_belief *b, double T, double *F)
{
    double back[9], cross[9], dv_R[9], dp_R[9], half[9];
    product_of_transposed(b->R, b->R_cov, back);
    skew(b->dv, cross);
    product(cross, b->R_cov, dv_R);
    skew(b->dp, cross);
    product(cross, b->R_cov, dp_R);
    for (int i = 0; i < 9; i++) {
        half[i] = back[i] + (i % 4 == 0);
    }
    set_block(F, DL_ATT_ERR, DL_ATT_ERR, 1.0, back);
    set_block(F, DL_ATT_ERR, DL_GYRO_BIAS, -0.5 * T, half);
    set_block(F, DL_VEL, DL_ATT_ERR, -1.0, dv_R);
    set_block(F, DL_VEL, DL_GYRO_BIAS, 0.5 * T, dv_R);
    set_block(F, DL_VEL, DL_ACCEL_BIAS, -1.0, b->turned);
    set_block(F, DL_POS_REL, DL_ATT_ERR, 1.0, dp_R);
    set_block(F, DL_POS_REL, DL_GYRO_BIAS, -T / 3.0, dp_R);
    set_block(F, DL_POS_REL, DL_ACCEL_BIAS, 0.5 * T, b->turned);
    for (int i = 0; i < 3; i++) {
        AT(F, DL_POS_REL + i, DL_VEL + i) = -T;
    }
}

/* The noise of the random walks, and of the body's velocity and position. */
static void add_noise(const dl_filter_params *o, const dl_belief *b, double T, double *Q)
{
    const double coast = b->coast_s, force = o->psd_accel * T + o->psd_coast * coast, jolt = b->jolt_var_m2_s2;
    for (int i = 0; i < DL_N; i++) {
        AT(Q, i, i) = o->psd[i] * T;
    }
    if (steers(b, b->t_cov)) {
        AT(Q, DL_VESSEL_VEL, DL_VESSEL_VEL) += STEERS_PSD * T;
        AT(Q, DL_VESSEL_VEL + 1, DL_VESSEL_VEL + 1) += STEERS_PSD * T;
        AT(Q, DL_TURN_RATE, DL_TURN_RATE) += STEERS_TURN_PSD * T;
    }
    /* The whole jolt is assumed to have come at the beginning, which makes the position most uncertain. */
    for (int i = 0; i < 3; i++) {
        AT(Q, DL_ATT_ERR + i, DL_ATT_ERR + i) += o->psd_coast_turn * coast + b->jolt_var_rad2;
        AT(Q, DL_VEL + i, DL_VEL + i) = force + jolt;
        AT(Q, DL_POS_REL + i, DL_POS_REL + i) = force * (T * T / 3.0) + jolt * T * T;
        set_symmetric(Q, DL_POS_REL + i, DL_VEL + i, -0.5 * T * force - jolt * T);
    }
}

int steers(const dl_belief *b, int64_t t)
{
    return happened(b->steered) && seconds(b->steered, t) < STEERS_S;
}

int is_adrift(const dl_belief *b, int64_t t)
{
    const int swings = happened(b->swung) && seconds(b->swung, b->sighted) < SWINGS_S;
    const int begins = happened(b->steered) && seconds(b->steered, b->sighted) < BEGINS_S;
    return happened(b->sighted) && (swings || begins) && seconds(b->sighted, t) > SWING_UNSEEN_S;
}

int is_swung(const dl_belief *b, int64_t t)
{
    return is_adrift(b, t) && seconds(b->sighted, t) < SWUNG_S;
}

/* Let velocity and turn of a pad that is adrift settle: a first-order Gauss-Markov process about those before. The velocity before is
 * kept against the body's, of which the IMU alone knows the change since: the body's error over the ground is the ship's as well. */
static void settle(dl_belief *b, double T, double *F, double *Q)
{
    const int states[3] = {DL_VESSEL_VEL, DL_VESSEL_VEL + 1, DL_TURN_RATE};
    const double sigma[3] = {SETTLED_M_S, SETTLED_M_S, SETTLED_RAD_S};
    const double stays = exp(-T / SETTLES_S);
    for (int k = 0; k < 3; k++) {
        const int at = states[k], body = DL_VEL + k;
        const double comes = k < 2 ? 1.0 - stays : 0.0;
        const double about = k < 2 ? b->x[body] + b->dv[k] - b->ins_v[k] + b->vessel_before[k] : 0.0;
        b->x[at] = about + stays * (b->x[at] - about);
        for (int i = 0; i < DL_N; i++) {
            AT(F, at, i) = stays * AT(F, at, i) + comes * AT(F, body, i);
            AT(Q, at, i) = stays * AT(Q, at, i) + comes * AT(Q, body, i);
        }
        for (int i = 0; i < DL_N; i++) {
            AT(Q, i, at) = stays * AT(Q, i, at) + comes * AT(Q, i, body);
        }
        AT(Q, at, at) += (1.0 - stays * stays) * sigma[k] * sigma[k];
    }
}

/* The position of the body by the IMU alone. The downward accelerometer bias is not removed: a change of its estimate in flight
 * would look like a jerk of the deck. */
static void move_dead_reckoning(const dl_filter_params *o, dl_belief *b, double T)
{
    const double biased = dot(b->turned + 6, b->x + DL_ACCEL_BIAS), fall = 0.5 * GRAVITY_M_S2 * T * T;
    for (int i = 0; i < 3; i++) {
        b->ins_p[i] += b->ins_v[i] * T + b->dp[i];
        b->ins_v[i] += b->dv[i];
    }
    b->ins_p[2] += 0.5 * T * biased + fall;
    b->ins_v[2] += biased + GRAVITY_M_S2 * T;
    b->ins_var_m2_s2 += b->jolt_var_m2_s2 + o->psd_coast * b->coast_s;
}

void propagated_belief(const dl_filter_params *o, dl_belief *b, double *F, double *Q)
{
    const double T = seconds(b->t_cov, b->t);
    double moved[3], v[3];
    memset(F, 0, DL_N * DL_N * sizeof *F);
    memset(Q, 0, DL_N * DL_N * sizeof *Q);
    for (int i = 0; i < DL_N; i++) {
        AT(F, i, i) = 1.0;
    }
    memcpy(v, b->x + DL_VEL, sizeof v);
    add_noise(o, b, T, Q);
    move_body(b, T, F);
    move_dead_reckoning(o, b, T);
    move_deck(o, b, T, moved, F, Q);
    move_vessel(b, T, moved, F);
    if (is_swung(b, b->t_cov)) {
        settle(b, T, F, Q);
    }
    for (int i = 0; i < 3; i++) {
        b->x[DL_POS_REL + i] += moved[i] - v[i] * T - b->dp[i];
        b->x[DL_VEL + i] += b->dv[i];
    }
    b->x[DL_POS_REL + 2] -= 0.5 * GRAVITY_M_S2 * T * T;
    b->x[DL_VEL + 2] += GRAVITY_M_S2 * T;
    orthonormalise(b->R);
    memcpy(b->R_cov, b->R, sizeof b->R);
    memset(b->dv, 0, sizeof b->dv);
    memset(b->dp, 0, sizeof b->dp);
    memset(b->turned, 0, sizeof b->turned);
    b->coast_s = b->jolt_var_m2_s2 = b->jolt_var_rad2 = 0.0;
    b->t_cov = b->t;
}

void propagate_covariance(const dl_filter_params *o, dl_belief *b, covariance *c)
{
    double F[DL_N * DL_N], Q[DL_N * DL_N], *place = free_place(c);
    if (b->t <= b->t_cov) {
        return;
    }
    propagated_belief(o, b, F, Q);
    kalman_predict(DL_N, c->P, F, Q, place);
    c->P = place;
}

void propagate_to(const dl_filter_params *o, dl_belief *b, covariance *c, int64_t t)
{
    const int64_t held_until = b->t_imu + o->hold_ns;
    if (happened(b->t_imu) && b->t < held_until && held_until < t) {
        propagate_state(o, b, held_until, b->w, b->f);
    }
    propagate_state(o, b, t, b->w, b->f);
    if (seconds(b->t_cov, b->t) >= o->tick_s) {
        propagate_covariance(o, b, c);
    }
}

void state_at_first_order(const dl_belief *b, double x[DL_N])
{
    const double T = seconds(b->t_cov, b->t);
    memcpy(x, b->x, sizeof b->x);
    if (T <= 0.0) {
        return;
    }
    for (int i = 0; i < 3; i++) {
        x[DL_POS_REL + i] += b->x[DL_WAVES + 4 * i + 1] * T - b->x[DL_VEL + i] * T - b->dp[i];
        x[DL_VEL + i] += b->dv[i];
    }
    x[DL_POS_REL + 2] -= 0.5 * GRAVITY_M_S2 * T * T;
    x[DL_VEL + 2] += GRAVITY_M_S2 * T;
    for (int i = 0; i < 2; i++) {
        x[DL_POS_REL + i] += b->x[DL_VESSEL_VEL + i] * T;
    }
    for (int k = 0; k < 5; k++) {
        x[DL_WAVES + 4 * k] += b->x[DL_WAVES + 4 * k + 1] * T;
    }
    x[DL_PAD_YAW] += (b->x[DL_YAW_RATE] + b->x[DL_TURN_RATE]) * T;
}
