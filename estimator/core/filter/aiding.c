#include "filter/aiding.h"

#include <math.h>
#include <string.h>

#include "filter/correction.h"
#include "filter/gathering.h"
#include "base/rotation.h"

void take_attitude(const filter_params *o, belief *b, covariance *c, const double *R_ned_body, const double *cov, outcome *out)
{
    double gap[9], innov[3];
    aid begun = b->aids[ATTITUDE];
    product_of_transposed(b->R, R_ned_body, gap);
    log_rotation(gap, innov);
    innov[0] -= b->x[ATT_BIAS];
    innov[1] -= b->x[ATT_BIAS + 1];
    if (!still_gathers(o, b, ATTITUDE, 0, 0.0)) {
        double H[3 * COLUMNS_MAX] = {0.0};
        for (int i = 0; i < 3; i++) {
            H[i * COLUMNS_MAX + i] = 1.0;
        }
        for (int i = 0; i < 2; i++) {
            H[i * COLUMNS_MAX + 3 + i] = 1.0;
        }
        begin_gathering(&begun, b, c, ATTITUDE, 3, 0, 0.0, H, NULL);
    }
    gather(o, b, c, ATTITUDE, &begun, innov, cov, out);
    memcpy(b->levelled_by, R_ned_body, sizeof b->levelled_by);
    memcpy(b->cov_levelled_by, cov, sizeof b->cov_levelled_by);
    b->is_levelled = b->heading_is_given = 1;
}

void take_height(const filter_params *o, belief *b, covariance *c, double height_m, double sigma_m, outcome *out)
{
    const double T = seconds(b->t_cov, b->t), var = sigma_m * sigma_m;
    aid begun = b->aids[HEIGHT];
    if (b->sighted < 0) {
        out->verdict = GATED;
        return;
    }
    const double depth = b->x[POS_REL + 2] - b->x[HEAVE] - b->x[VEL + 2] * T - b->dp[2] - 0.5 * GRAVITY_M_S2 * T * T;
    const double innov = height_m - (depth + b->x[BARO_OFFSET]);
    if (!still_gathers(o, b, HEIGHT, 0, 0.0)) {
        const double H[3 * COLUMNS_MAX] = {1.0, -1.0, 1.0};
        begin_gathering(&begun, b, c, HEIGHT, 1, 0, 0.0, H, NULL);
    }
    gather(o, b, c, HEIGHT, &begun, &innov, &var, out);
}

void foot_of(const belief *b, const double *P, const double x[N], double *away, double *spread)
{
    const double c[3] = {b->R[2], b->R[5], b->R[8]}, reach = x[POS_REL + 2] / fmax(c[2], 0.3);
    const double var = (AT(P, POS_REL, POS_REL) + AT(P, POS_REL + 1, POS_REL + 1)) / 2.0;
    *away = hypot(x[POS_REL] - c[0] * reach, x[POS_REL + 1] - c[1] * reach);
    *spread = sqrt(fmax(var, 0.0));
}

/* The distance along the body's down axis to the deck's plane and its Jacobian; 0 if they do not meet. */
static int distance(const double R[9], const double x[N], double *r, double H[3 * COLUMNS_MAX])
{
    const double roll = x[ROLL] + x[DECK_TRIM], pitch = x[PITCH] + x[DECK_TRIM + 1], yaw = x[PAD_YAW];
    double pad[9], by_n[3], reach[3];
    from_rpy(roll, pitch, yaw, pad);
    const double n[3] = {pad[2], pad[5], pad[8]}, c[3] = {R[2], R[5], R[8]}, cosine = dot(n, c);
    if (cosine < 0.3) {
        return 0;
    }
    *r = dot(n, x + POS_REL) / cosine;
    rotated_back(R, n, by_n);
    memset(H, 0, 3 * COLUMNS_MAX * sizeof *H);
    H[0] = *r / cosine * by_n[1];
    H[1] = -*r / cosine * by_n[0];
    for (int i = 0; i < 3; i++) {
        H[3 + i] = n[i] / cosine;
        reach[i] = (x[POS_REL + i] - *r * c[i]) / cosine;
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

void take_range(const filter_params *o, belief *b, covariance *c, double range_m, double sigma_m, outcome *out)
{
    double x[N], away, spread, r, H[3 * COLUMNS_MAX];
    const double var = sigma_m * sigma_m;
    out->verdict = GATED;
    if (b->sighted < 0) {
        return;
    }
    peek(b, x);
    foot_of(b, c->P, x, &away, &spread);
    /* There is water beyond the deck's edge. */
    if (away + 2.0 * spread > o->deck_radius_m || !distance(b->R, x, &r, H)) {
        return;
    }
    const double innov = range_m - r - x[RANGE_OFFSET];
    aid begun = b->aids[RANGE];
    if (!still_gathers(o, b, RANGE, 0, 0.0)) {
        begin_gathering(&begun, b, c, RANGE, 1, 0, 0.0, H, NULL);
    }
    gather(o, b, c, RANGE, &begun, &innov, &var, out);
}
