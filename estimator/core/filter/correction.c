/* Apply a correction to the belief and rewrite its covariance about the turned attitude. */

#include "filter/correction.h"

#include <math.h>
#include <string.h>

#include "base/rotation.h"

void pad_velocity(const double x[DL_N], double v[3])
{
    v[0] = x[SURGING] + x[DL_VESSEL_VEL];
    v[1] = x[SWAYING] + x[DL_VESSEL_VEL + 1];
    v[2] = x[HEAVING];
}

void pad_axes(double pitch, double yaw, double by_roll[3], double by_pitch[3])
{
    by_roll[0] = cos(yaw) * cos(pitch), by_roll[1] = sin(yaw) * cos(pitch), by_roll[2] = -sin(pitch);
    by_pitch[0] = -sin(yaw), by_pitch[1] = cos(yaw), by_pitch[2] = 0.0;
}

/* P = T P T' where T adds A theta to the three states from `state` on. */
static void add_attitude(double *P, int state, const double A[9])
{
    for (int k = 0; k < DL_N; k++) {
        const double column[3] = {AT(P, DL_ATT_ERR, k), AT(P, DL_ATT_ERR + 1, k), AT(P, DL_ATT_ERR + 2, k)};
        for (int i = 0; i < 3; i++) {
            AT(P, state + i, k) += dot(A + 3 * i, column);
        }
    }
    for (int k = 0; k < DL_N; k++) {
        const double row[3] = {AT(P, k, DL_ATT_ERR), AT(P, k, DL_ATT_ERR + 1), AT(P, k, DL_ATT_ERR + 2)};
        for (int i = 0; i < 3; i++) {
            AT(P, k, state + i) += dot(A + 3 * i, row);
        }
    }
}

/* The pad was seen from the body: its corrected place tilts as the body does, by whatever the attitude is off. Otherwise corrections
 * to and fro would teach the filter a tilt that nothing shows (Barrau, Bonnabel, The invariant extended Kalman filter as a stable
 * observer, IEEE Trans. Automatic Control 62(4), 2017; docs/decisions/filter-tilt.md#a-place-leans-with-the-attitudes-correction). */
static void lean(const double R[9], const double dx[DL_N], double *P)
{
    const double back[3] = {-dx[DL_POS_REL], -dx[DL_POS_REL + 1], -dx[DL_POS_REL + 2]};
    double across[9], A[9];
    skew(back, across);
    product(across, R, A);
    add_attitude(P, DL_POS_REL, A);
}

/* The error is an error about the turned attitude, so its axes turn by half the step (Sola, Quaternion kinematics for the error-state
 * Kalman filter, 2017, eq. 287). */
static void turn_axes(const double dx[DL_N], double *P)
{
    const double half[3] = {-0.5 * dx[DL_ATT_ERR], -0.5 * dx[DL_ATT_ERR + 1], -0.5 * dx[DL_ATT_ERR + 2]};
    double A[9];
    skew(half, A);
    add_attitude(P, DL_ATT_ERR, A);
}

void correct_belief(dl_belief *b, covariance *c, const double dx[DL_N], double *P)
{
    double turn[9], R[9];
    lean(b->R, dx, P);
    turn_axes(dx, P);
    for (int i = 0; i < DL_N; i++) {
        b->x[i] += dx[i];
    }
    memset(b->x + DL_ATT_ERR, 0, 3 * sizeof(double));
    b->x[DL_PAD_YAW] = wrapped(b->x[DL_PAD_YAW]);
    b->x[DL_VEL_SCALE] = fmin(fmax(b->x[DL_VEL_SCALE], 0.2), 3.0);
    exp_rotation(dx + DL_ATT_ERR, turn);
    product(b->R, turn, R);
    memcpy(b->R, R, sizeof R);
    memcpy(b->R_cov, R, sizeof R);
    c->P = P;
}

double *changeable(covariance *c)
{
    double *P = free_place(c);
    memcpy(P, c->P, DL_N * DL_N * sizeof *P);
    c->P = P;
    return P;
}

void forget_state(double *P, int state, double var)
{
    for (int k = 0; k < DL_N; k++) {
        AT(P, state, k) = AT(P, k, state) = 0.0;
    }
    AT(P, state, state) = var;
}

void uncompared(dl_outcome *out, enum dl_verdict verdict)
{
    memset(out, 0, sizeof *out);
    out->nis = out->nis_max = NAN;
    out->verdict = verdict;
}

void write_outcome(dl_outcome *out, int verdict, int m, int axes, const double *innov, const double *S, double nis, double nis_max)
{
    out->nis = nis;
    out->nis_max = nis_max;
    out->verdict = verdict;
    out->m = m;
    out->axes = axes;
    out->has_S = S != NULL;
    memcpy(out->innov, innov, (size_t)m * sizeof *innov);
    if (S != NULL) {
        memcpy(out->S, S, (size_t)(m * m) * sizeof *S);
    }
}

static bool is_velocity(int state)
{
    return state == DL_VEL || state == DL_VEL + 1 || state == DL_VESSEL_VEL || state == DL_VESSEL_VEL + 1;
}

/* All other states keep their values and what is known of them together, and what they share with the velocities changes.
 * Source: Brink, Partial-update Schmidt-Kalman filter, J. Guidance, Control, and Dynamics 40(9), 2017. */
static void keep_others(const double *before, double dx[DL_N], double *P)
{
    for (int i = 0; i < DL_N; i++) {
        dx[i] = is_velocity(i) ? dx[i] : 0.0;
        for (int j = 0; j < DL_N; j++) {
            AT(P, i, j) = is_velocity(i) || is_velocity(j) ? AT(P, i, j) : AT(before, i, j);
        }
    }
}

bool fuse_gated(const dl_filter_params *o, dl_belief *b, covariance *c, const measured *z, int axes, bool velocities_alone, dl_outcome *out)
{
    double S[DL_ROWS_MAX * DL_ROWS_MAX], dx[DL_N], nis, *P = free_place(c);
    if (!kalman_correct(DL_N, c->P, z, dx, P, S, &nis)) {
        write_outcome(out, DL_SINGULAR, z->m, axes, z->innov, NULL, NAN, NAN);
        return false;
    }
    write_outcome(out, nis > o->nis_max[z->m - 1] ? DL_GATED : DL_FUSED, z->m, axes, z->innov, S, nis, o->nis_max[z->m - 1]);
    if (out->verdict == DL_FUSED) {
        if (velocities_alone) {
            keep_others(c->P, dx, P);
        }
        correct_belief(b, c, dx, P);
    }
    return out->verdict == DL_FUSED;
}
