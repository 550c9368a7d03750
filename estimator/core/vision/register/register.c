/* Register a drawing with a frame from a start pose, near or far. */

#include <math.h>
#include <string.h>

#include "base/linear.h"
#include "base/rotation.h"
#include "vision/register/near.h"
#include "vision/register/register.h"
#include "vision/register/solver.h"
#include "vision/tracker.h"

/* Deviations of the blur that must fit between edges of different kinds for profiles. */
static const double APART_SIGMAS = 4.5;
/* Largest number of pixels of a profile and of what fills its group up; rows are as long as whole groups of ROW_LANES. */
enum { PROFILE_PIXELS = 24, ROW_LANES = 16 };
/* Standard deviation of the lens' point spread at the start, which is estimated, px. */
static const double BLUR_PX = 0.6;
/* Pixels of margin about the disc when its pixels are counted; of the edges' points every so many are in the outline. */
enum { MARGIN_PX = 8, OUTLINE_STEP = 4 };

/* Whether edges of different kinds are far enough apart for profiles. */
static int spacing_ok(const dl_pad_shape *pad, const fit_state *s)
{
    return pad->gap_m > APART_SIGMAS * sigma_px(s) * s->m_per_px;
}

/* Fit by profiles where the pad is large, as a whole where its edges merge or its pixels are few. */
static int refine(const fit_task *k, const fit_state *start, fit_solved *out)
{
    const double side_px = 2.0 * k->pad->disc_radius_m / start->m_per_px + MARGIN_PX;
    fit_state s = *start;
    if (side_px * side_px > DENSE_PIXELS && spacing_ok(k->pad, start)) {
        const int found = register_near(k, start, out);
        if (spacing_ok(k->pad, &out->state)) {
            return found;
        }
        s = found ? out->state : *start;
    }
    return register_far(k, &s, out);
}

/* Whether a mark of the pointer turned by 180 degrees lies in the frame. */
static int opposite_in_view(const fit_task *k, const fit_state *s)
{
    const dl_lens *camera = k->seen.camera;
    int some = 0;
    for (int i = 0; i < DL_POINTER_MARKS && k->pad->pointer_kind >= 0; i++) {
        double p[3], uv[2];
        in_camera(s, -k->pad->pointer_marks_m[2 * i], -k->pad->pointer_marks_m[2 * i + 1], p);
        camera_project(camera, p, uv);
        some |= uv[0] > 0.0 && uv[0] < (double)camera->width && uv[1] > 0.0 && uv[1] < (double)camera->height;
    }
    return some;
}

/* Fit again with the drawing turned by 180 degrees if the pointer is seen there. */
static void try_opposite(const fit_task *k, fit_solved *found)
{
    fit_solved again;
    fit_state turned = found->state;
    if (!opposite_in_view(k, &found->state) || !is_opposite(k, &found->state)) {
        return;
    }
    for (int i = 0; i < 9; i++) {
        turned.R[i] *= i % 3 < 2 ? -1.0 : 1.0;
    }
    if (refine(k, &turned, &again) && again.arrow_seen) {
        *found = again;
    }
}

/* T A T' of (6, 6) blocks of three with T = diag(R, R); A is the upper left of rows of `stride`. Symmetric. */
static void in_camera_axes(const double R[9], int stride, const double *A, double out[POSE * POSE])
{
    for (int b = 0; b < 4; b++) {
        double block[9], left[9], whole[9];
        for (int i = 0; i < 9; i++) {
            block[i] = A[(3 * (b / 2) + i / 3) * stride + 3 * (b % 2) + i % 3];
        }
        product(R, block, left);
        product_by_transposed(left, R, whole);
        for (int i = 0; i < 9; i++) {
            out[(3 * (b / 2) + i / 3) * POSE + 3 * (b % 2) + i % 3] = whole[i];
        }
    }
    for (int i = 0; i < POSE; i++) {
        for (int j = 0; j < i; j++) {
            out[i * POSE + j] = out[j * POSE + i] = 0.5 * (out[i * POSE + j] + out[j * POSE + i]);
        }
    }
}

/* The information on the pose alone. The blur is uncertain too, so it is eliminated and not held constant. */
static int pose_information(const double H[STATES * STATES], double out[POSE * POSE])
{
    double blur[9], answer[3 * POSE];
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            blur[3 * i + j] = H[(POSE + i) * STATES + POSE + j] + (i == j) / (WEAK_BLUR_PX2 * WEAK_BLUR_PX2);
        }
        for (int j = 0; j < POSE; j++) {
            answer[i * POSE + j] = H[(POSE + i) * STATES + j];
        }
    }
    if (!solve_symmetric(3, 3, blur, POSE, answer)) {
        return 0;
    }
    for (int i = 0; i < POSE; i++) {
        for (int j = 0; j < POSE; j++) {
            out[i * POSE + j] = H[i * STATES + j];
            for (int k = 0; k < 3; k++) {
                out[i * POSE + j] -= H[i * STATES + POSE + k] * answer[k * POSE + j];
            }
        }
    }
    return 1;
}

/* The cosine between a contrast and that of the pad's paints; 1 where that is unknown. */
static double likeness(const double nominal[CHANNELS], const double contrast[CHANNELS])
{
    const double size = sqrt(dot(contrast, contrast));
    return dot(nominal, nominal) > 0.0 && size >= 1e-6 ? dot(nominal, contrast) / size : 1.0;
}

/* The blur in the frame's axes without the pixel's own square. */
static void blur_in_frame(const fit_state *s, const double R[9], double out[3])
{
    const double *b = s->blur_px2;
    for (int k = 0; k < 3; k++) {
        const double *one = R + (k == 2 ? 3 : 0), *two = R + (k == 0 ? 0 : 3);
        out[k] = one[0] * (b[0] * two[0] + b[1] * two[1]) + one[1] * (b[1] * two[0] + b[2] * two[1]) - (k == 1 ? 0.0 : 1.0 / 12.0);
    }
}

/* Whether the pose's covariance is positive definite: that of a fit which ran away, with little of the pad in view, need not be. */
static int positive(const double cov[STATES * STATES])
{
    double S[STATES * STATES];
    memcpy(S, cov, sizeof S);
    return cholesky(POSE, STATES, S) == DONE;
}

/* Add to the covariance of a found pose what a codec may have moved in the frame, if one predicted it. */
static void doubt_coded(const fit_task *k, const fit_state *pose, const double H[STATES * STATES], const double of_frame[POSE * POSE],
                        dl_registration *out)
{
    solver priors;
    double of_fit[STATES * STATES], with_prior[POSE * POSE];
    if (!(k->coded_px > 0.0)) {
        return;
    }
    begin_solver(pose, &k->tilt, k->pad->disc_radius_m, &priors);
    if (covariance_of(&priors, pose, H, of_fit)) {
        in_camera_axes(pose->R, STATES, of_fit, with_prior);
        add_coded(k->seen.camera, &k->edges, pose, k->coded_px, of_frame, with_prior, out->cov);
    }
}

/* Write what was found in the camera's axes; 0 if it is no pose in front of the camera, or nothing is known of its errors. */
static int conclude(const fit_task *k, const fit_solved *s, dl_registration *out, double *outline)
{
    double information[POSE * POSE], of_frame[POSE * POSE], sum = 0.0;
    fit_state pose = s->state;
    for (int i = 0; i < STATES * STATES; i++) {
        sum += s->cov[i];
    }
    if (!isfinite(sum + pose.t[0] + pose.t[1] + pose.t[2]) || !(pose.R[2] * pose.t[0] + pose.R[5] * pose.t[1] + pose.R[8] * pose.t[2] > 0.0) ||
        !positive(s->cov) || !pose_information(s->H, information)) {
        return 0;
    }
    orthonormalise(pose.R);
    out->dense = s->dense, out->yaw_ambiguous = !s->arrow_seen;
    memcpy(out->pose.R, pose.R, sizeof pose.R);
    memcpy(out->pose.t, pose.t, sizeof pose.t);
    in_camera_axes(pose.R, STATES, s->cov, out->cov);
    in_camera_axes(pose.R, POSE, information, of_frame);
    doubt_coded(k, &pose, s->H, of_frame, out);
    add_focal_doubt(k->seen.camera, pose.t, out->cov);
    blur_in_frame(&pose, pose.R, out->blur_px2);
    out->noise_light = s->noise_light, out->edge_rms_px = s->edge_rms_px, out->visible = s->visible;
    out->inliers = s->inliers;
    for (int kind = 0; kind < DL_EDGE_KINDS; kind++) {
        out->edges[kind] = s->edges[kind];
        out->edges[kind].likeness = likeness(k->pad->nominal + CHANNELS * kind, s->edges[kind].contrast_bgr);
    }
    for (int i = 0; i < k->edges.points; i += OUTLINE_STEP, outline += 2) {
        double p[3];
        in_camera(&pose, k->edges.at[5 * i], k->edges.at[5 * i + 1], p);
        camera_project(k->seen.camera, p, outline);
    }
    return 1;
}

int32_t register_row(int64_t edge_points)
{
    const int64_t profiled = PROFILE_PIXELS * (PROFILES + 2), most = profiled > DENSE_PIXELS ? profiled : DENSE_PIXELS;
    return (int32_t)(((edge_points > most ? edge_points : most) + ROW_LANES - 1) / ROW_LANES * ROW_LANES);
}

int register_pad(const dl_tracker *t, const dl_frame *frame, const dl_start *how, const dl_pad_pose *start, dl_registration *out, double *outline)
{
    fit_task k = {
        .seen = {&t->camera.lens, t->rays, frame->level[0].px, t->lights, how->cut, frame->quality.noise}, .pad = &t->pad.shape,
        .edges = {(int)t->pad.edge_points, t->edges, t->edge_of}, .size_sigma_m = t->pad.size_sigma_m, .coded_px = how->coded_px,
        .free = {t->scratch, FIT_ROWS * t->row, t->row}, .work = t->work,
    };
    fit_state s;
    fit_solved solved;
    predict_tilt(k.seen.camera, &how->prior, &k.tilt);
    begin_state(k.seen.camera, start->R, start->t, BLUR_PX, &s);
    if (!refine(&k, &s, &solved)) {
        return 0;
    }
    if (!solved.arrow_seen && !solved.doubted) {
        try_opposite(&k, &solved);
    }
    return conclude(&k, &solved, out, outline);
}
