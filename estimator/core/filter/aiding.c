/* Compare attitude, range and height with the belief, and gather them. Models: docs/estimator.md, section "Measurements". */

#include "filter/aiding.h"

#include <math.h>
#include <string.h>

#include "filter/correction.h"
#include "filter/gathering.h"
#include "base/rotation.h"

void fuse_attitude(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_attitude *seen, dl_outcome *out)
{
    double gap[9], innov[3];
    dl_aid begun = b->aids[DL_ATTITUDE];
    begun.m = 3;
    product_of_transposed(b->R, seen->R_ned_body, gap);
    log_rotation(gap, innov);
    innov[0] -= b->x[DL_ATT_BIAS];
    innov[1] -= b->x[DL_ATT_BIAS + 1];
    if (!still_gathers(o, b, DL_ATTITUDE, 0, 0.0)) {
        double H[3 * COLUMNS_MAX] = {0.0};
        for (int i = 0; i < 3; i++) {
            H[i * COLUMNS_MAX + i] = 1.0;
        }
        for (int i = 0; i < 2; i++) {
            H[i * COLUMNS_MAX + 3 + i] = 1.0;
        }
        begin_gathering(&begun, b, c, DL_ATTITUDE, H, NULL);
    }
    gather(o, b, c, DL_ATTITUDE, &begun, innov, seen->cov_body, out);
    memcpy(b->levelled_by, seen->R_ned_body, sizeof b->levelled_by);
    memcpy(b->cov_levelled_by, seen->cov_body, sizeof b->cov_levelled_by);
    b->is_levelled = b->heading_is_given = 1;
}

void fuse_height(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_distance *seen, dl_outcome *out)
{
    const double T = seconds(b->t_cov, b->t), var = seen->sigma_m * seen->sigma_m;
    dl_aid begun = b->aids[DL_HEIGHT];
    begun.m = 1;
    if (!happened(b->sighted)) {
        out->verdict = DL_GATED;
        return;
    }
    const double depth = b->x[DL_POS_REL + 2] - b->x[HEAVE] - b->x[DL_VEL + 2] * T - b->dp[2] - 0.5 * GRAVITY_M_S2 * T * T;
    const double innov = seen->measured_m - (depth + b->x[DL_BARO_OFFSET]);
    if (!still_gathers(o, b, DL_HEIGHT, 0, 0.0)) {
        const double H[3 * COLUMNS_MAX] = {1.0, -1.0, 1.0};
        begin_gathering(&begun, b, c, DL_HEIGHT, H, NULL);
    }
    gather(o, b, c, DL_HEIGHT, &begun, &innov, &var, out);
}

void foot_of(const dl_belief *b, const double *P, const double x[DL_N], double *away, double *spread)
{
    const double c[3] = {b->R[2], b->R[5], b->R[8]}, reach = x[DL_POS_REL + 2] / fmax(c[2], 0.3);
    const double var = (AT(P, DL_POS_REL, DL_POS_REL) + AT(P, DL_POS_REL + 1, DL_POS_REL + 1)) / 2.0;
    *away = hypot(x[DL_POS_REL] - c[0] * reach, x[DL_POS_REL + 1] - c[1] * reach);
    *spread = sqrt(fmax(var, 0.0));
}

/* The distance along the body's down axis to the deck's plane and its Jacobian; 0 if they do not meet. */
static int distance(const double R[9], const double x[DL_N], double *r, double H[3 * COLUMNS_MAX])
{
    const double roll = x[ROLL] + x[DL_DECK_TRIM], pitch = x[PITCH] + x[DL_DECK_TRIM + 1], yaw = x[DL_PAD_YAW];
    double pad[9], by_n[3], reach[3];
    from_rpy(roll, pitch, yaw, pad);
    const double n[3] = {pad[2], pad[5], pad[8]}, c[3] = {R[2], R[5], R[8]}, cosine = dot(n, c);
    if (cosine < 0.3) {
        return 0;
    }
    *r = dot(n, x + DL_POS_REL) / cosine;
    rotated_back(R, n, by_n);
    memset(H, 0, 3 * COLUMNS_MAX * sizeof *H);
    H[0] = *r / cosine * by_n[1];
    H[1] = -*r / cosine * by_n[0];
    for (int i = 0; i < 3; i++) {
        H[3 + i] = n[i] / cosine;
        reach[i] = (x[DL_POS_REL + i] - *r * c[i]) / cosine;
    }
    double cross[9], turned[3], by_roll[3], by_pitch[3];
    pad_axes(pitch, yaw, by_roll, by_pitch);
    skew(n, cross);
    rotated(cross, reach, turned);
    H[6] = H[7] = dot(turned, by_roll);
    H[8] = H[9] = dot(turned, by_pitch);
    H[10] = turned[2];
    H[11] = 1.0;
    return 1;
}

void fuse_range(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_distance *seen, dl_outcome *out)
{
    double x[DL_N], away, spread, r, H[3 * COLUMNS_MAX];
    const double var = seen->sigma_m * seen->sigma_m;
    out->verdict = DL_GATED;
    if (!happened(b->sighted)) {
        return;
    }
    state_at_first_order(b, x);
    foot_of(b, c->P, x, &away, &spread);
    /* There is water beyond the deck's edge. */
    if (away + 2.0 * spread > o->deck_radius_m || !distance(b->R, x, &r, H)) {
        return;
    }
    const double innov = seen->measured_m - r - x[DL_RANGE_OFFSET];
    dl_aid begun = b->aids[DL_RANGE];
    begun.m = 1;
    if (!still_gathers(o, b, DL_RANGE, 0, 0.0)) {
        begin_gathering(&begun, b, c, DL_RANGE, H, NULL);
    }
    gather(o, b, c, DL_RANGE, &begun, &innov, &var, out);
}
