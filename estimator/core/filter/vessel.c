#include "filter/vessel.h"

#include <string.h>

#include "filter/correction.h"
#include "base/rotation.h"

enum { ROWS = 4, V_COV = 3, HEADING = 12, HEADING_SIGMA = 13, HAS_VELOCITY = 14, HAS_HEADING = 15 };

static void compare_velocity(const double x[N], const double v[3], double innov[3], double *H)
{
    double v_pad[3];
    pad_velocity(x, v_pad);
    for (int i = 0; i < 3; i++) {
        innov[i] = v[i] - v_pad[i];
        AT(H, i, SURGING + 4 * i) = 1.0;
    }
    for (int i = 0; i < 2; i++) {
        AT(H, i, VESSEL_VEL + i) = 1.0;
        AT(H, i, HEAVING) = x[SWAY_PER_HEAVE + i];
        AT(H, i, SWAY_PER_HEAVE + i) = x[HEAVING];
    }
}

void take_vessel(const filter_params *o, belief *b, covariance *c, const double values[16], outcome *out)
{
    double innov[ROWS], H[ROWS * N] = {0.0}, R[ROWS * ROWS] = {0.0}, S[ROWS * ROWS], dx[N], nis;
    const int has_velocity = values[HAS_VELOCITY] != 0.0, has_heading = values[HAS_HEADING] != 0.0;
    const int m = 3 * has_velocity + has_heading, axes = 7 * has_velocity | 8 * has_heading;
    out->verdict = GATED;
    if (m == 0) {
        return;
    }
    if (has_velocity) {
        compare_velocity(b->x, values, innov, H);
        for (int i = 0; i < 9; i++) {
            R[i / 3 * m + i % 3] = values[V_COV + i];
        }
    }
    if (has_heading) {
        innov[m - 1] = wrapped(values[HEADING] + o->pad_yaw_in_vessel_rad - b->x[PAD_YAW]);
        AT(H, m - 1, PAD_YAW) = 1.0;
        R[m * m - 1] = values[HEADING_SIGMA] * values[HEADING_SIGMA];
    }
    double *P = free_place(c);
    if (!kalman_correct(N, m, c->P, innov, H, R, dx, P, S, &nis)) {
        tell(out, SINGULAR, m, axes, innov, NULL);
        return;
    }
    out->nis = nis;
    out->nis_max = o->nis_max[m - 1];
    tell(out, nis > out->nis_max ? GATED : FUSED, m, axes, innov, S);
    if (out->verdict == FUSED) {
        correct_belief(b, c, dx, P);
        b->heading_known |= has_heading;
    }
}
