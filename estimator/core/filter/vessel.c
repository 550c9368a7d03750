/* Fuse a vessel's report of her velocity and heading. */

#include "filter/vessel.h"

#include <string.h>

#include "filter/correction.h"
#include "filter/jacobian.h"
#include "base/kalman.h"
#include "base/rotation.h"

enum { ROWS = 4 };

static void compare_velocity(const double x[DL_N], const double v[3], double innov[3], double *H)
{
    double v_pad[3];
    pad_velocity(x, v_pad);
    for (int i = 0; i < 3; i++) {
        innov[i] = v[i] - v_pad[i];
    }
    add_pad_velocity(H);
}

void fuse_vessel(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_vessel_report *report, dl_outcome *out)
{
    double innov[ROWS], H[ROWS * DL_N] = {0.0}, R[ROWS * ROWS] = {0.0}, S[ROWS * ROWS], dx[DL_N], nis;
    const int has_velocity = report->has_velocity != 0, has_heading = report->has_heading != 0;
    const int m = 3 * has_velocity + has_heading, axes = 7 * has_velocity | 8 * has_heading;
    out->verdict = DL_GATED;
    if (m == 0) {
        return;
    }
    if (has_velocity) {
        compare_velocity(b->x, report->v_ned, innov, H);
        for (int i = 0; i < 9; i++) {
            R[i / 3 * m + i % 3] = report->cov_v_ned[i];
        }
    }
    if (has_heading) {
        innov[m - 1] = wrapped(report->heading_rad + o->pad_yaw_in_vessel_rad - b->x[DL_PAD_YAW]);
        AT(H, m - 1, DL_PAD_YAW) = 1.0;
        R[m * m - 1] = report->sigma_heading_rad * report->sigma_heading_rad;
    }
    double *P = free_place(c);
    if (!kalman_correct(DL_N, c->P, &(measured){m, innov, H, R}, dx, P, S, &nis)) {
        write_outcome(out, DL_SINGULAR, m, axes, innov, NULL);
        return;
    }
    out->nis = nis;
    out->nis_max = o->nis_max[m - 1];
    write_outcome(out, nis > out->nis_max ? DL_GATED : DL_FUSED, m, axes, innov, S);
    if (out->verdict == DL_FUSED) {
        correct_belief(b, c, dx, P);
        b->heading_known |= has_heading;
    }
}
