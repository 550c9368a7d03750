/* Add to a covariance what a video codec's moved patches do to a pose. */

#include "vision/register/near.h"

#include <math.h>
#include <string.h>

#include "base/rotation.h"
#include "vision/register/sums.h"
#include "vision/tracker.h"

/* A codec moves blocks of 16 px, and neighbours mostly together. Patches that are PATCHES apart share a place in the sums: no pad
 * that is so large is seen whole. */
enum { PATCH_PX = 32, PATCHES = 16, AXES = 2, POINT_STEP = 4 };
/* Step of the derivative by a point's place, m. */
static const double STEP_M = 1e-4;
/* Fraction by which the squares are raised: the edges in the frame may not determine all of a pose. */
static const double HELD = 1e-4;

/* Derivatives of a pixel's place by that of its point, px/m; 0 outside of the frame. */
static int place_by_point(const dl_lens *camera, const double p[3], double uv[2], double by[AXES][3])
{
    camera_project(camera, p, uv);
    if (!(uv[0] >= 0.0 && uv[0] < (double)camera->width && uv[1] >= 0.0 && uv[1] < (double)camera->height)) {
        return 0;
    }
    for (int k = 0; k < 3; k++) {
        double moved[3] = {p[0], p[1], p[2]}, there[2];
        moved[k] += STEP_M;
        camera_project(camera, moved, there);
        by[0][k] = (there[0] - uv[0]) / STEP_M, by[1][k] = (there[1] - uv[1]) / STEP_M;
    }
    return isfinite(by[0][0] + by[0][1] + by[0][2] + by[1][0] + by[1][1] + by[1][2]);
}

/* The normal of an edge in the frame, and its length in pixels for each metre on the pad. */
static double edge_in_frame(const fit_state *pose, const double by[AXES][3], const double normal[2], double n[AXES])
{
    const double *R = pose->R, x = -normal[1], y = normal[0];
    const double along[3] = {R[0] * x + R[1] * y, R[3] * x + R[4] * y, R[6] * x + R[7] * y};
    const double u = dot(by[0], along), v = dot(by[1], along), px = hypot(u, v);
    n[0] = px > 0.0 ? -v / px : 0.0, n[1] = px > 0.0 ? u / px : 0.0;
    return px;
}

/* The derivatives of an edge's place along its normal by the pose in `cam`: t, and a small rotation about the pad's centre. */
static void place_by_pose(const fit_state *pose, const double p[3], const double by[AXES][3], const double n[AXES], double J[POSE])
{
    const double q[3] = {p[0] - pose->t[0], p[1] - pose->t[1], p[2] - pose->t[2]};
    for (int k = 0; k < 3; k++) {
        J[k] = n[0] * by[0][k] + n[1] * by[1][k];
    }
    cross(q, J, J + 3);
}

/* out = A B */
static void times(const double A[POSE * POSE], const double B[POSE * POSE], double out[POSE * POSE])
{
    for (int i = 0; i < POSE * POSE; i++) {
        out[i] = 0.0;
        for (int k = 0; k < POSE; k++) {
            out[i] += A[i / POSE * POSE + k] * B[k * POSE + i % POSE];
        }
    }
}

static void transpose(const double A[POSE * POSE], double out[POSE * POSE])
{
    for (int i = 0; i < POSE * POSE; i++) {
        out[i] = A[i % POSE * POSE + i / POSE];
    }
}

/* The sums of squares of all edges in the frame by the pose, and of what each patch adds to its gradient. */
static void squares_of(const dl_lens *camera, const edge_points *edges, const fit_state *pose, double alike[POSE * POSE],
                       double patches[POSE * POSE])
{
    double sums[PATCHES * PATCHES][AXES][POSE];
    memset(sums, 0, sizeof sums);
    memset(alike, 0, POSE * POSE * sizeof *alike);
    memset(patches, 0, POSE * POSE * sizeof *patches);
    for (int i = 0; i < edges->points; i += POINT_STEP) {
        const double *at = edges->at + 5 * i;
        double p[3], uv[2], by[AXES][3], n[AXES], J[POSE];
        in_camera(pose, at[0], at[1], p);
        if (!place_by_point(camera, p, uv, by)) {
            continue;
        }
        const double length = POINT_STEP * at[4] * edge_in_frame(pose, by, at + 2, n);
        double(*sum)[POSE] = sums[(int)(uv[1] / PATCH_PX) % PATCHES * PATCHES + (int)(uv[0] / PATCH_PX) % PATCHES];
        place_by_pose(pose, p, by, n, J);
        for (int r = 0; r < POSE; r++) {
            sum[0][r] += length * n[0] * J[r], sum[1][r] += length * n[1] * J[r];
        }
        for (int k = 0; k < POSE * POSE; k++) {
            alike[k] += length * J[k / POSE] * J[k % POSE];
        }
    }
    for (int s = 0; s < AXES * PATCHES * PATCHES; s++) {
        const double *sum = sums[s / AXES][s % AXES];
        for (int i = 0; i < POSE * POSE; i++) {
            patches[i] += sum[i / POSE] * sum[i % POSE];
        }
    }
}

void add_coded(const dl_lens *camera, const edge_points *edges, const fit_state *pose, double sigma_px,
               const double information[POSE * POSE], const double with_prior[POSE * POSE], double cov[POSE * POSE])
{
    double alike[POSE * POSE], left[POSE * POSE], right[POSE * POSE], share[POSE * POSE], back[POSE * POSE];
    squares_of(camera, edges, pose, alike, left);
    for (int r = 0; r < POSE; r++) {
        alike[r * (POSE + 1)] *= 1.0 + HELD;
    }
    if (!solve_symmetric(POSE, POSE, alike, POSE, left)) {
        return;
    }
    transpose(left, right);
    if (!solve_symmetric(POSE, POSE, alike, POSE, right)) {
        return;
    }
    times(with_prior, information, share);
    times(share, right, left);
    transpose(share, back);
    times(left, back, right);
    for (int i = 0; i < POSE * POSE; i++) {
        cov[i] += 0.5 * sigma_px * sigma_px * (right[i] + right[i % POSE * POSE + i / POSE]);
    }
}
