/* Move a pose until the blurred drawing fits the frame: Gauss-Newton steps on the samples' light. */

#include <math.h>
#include <string.h>

#include "vision/align/align.h"
#include "base/linear.h"
#include "base/rotation.h"
#include "base/vectors.h"
#include "base/wide.h"

/* Number of samples below which a step is so cheap that twice as many are made. From afar a start may be off by a fifth. */
enum { FEW = 350, POSE = 6, SUMS = 27 };
/* Step, in samples, below which the pose is good enough to start a registration. */
static const double AT_REST = 0.12;
static const double STEP_DEPTHS = 0.12; /* Longest step, in depths. */
static const double STEP_RAD = 0.25; /* Longest step, rad. */
static const double DEPTH_CHANGE = 0.7; /* Largest change of the depth's logarithm in all. */
static const double LEAST_ALIGNED_FACING = 0.2; /* Least cosine between the pad's normal and the camera's axis. */
/* Fractions of the variation about the pad that the drawing must explain at the start of a search, after half of the steps, and at
 * the end. Of 290 pads that were found 2 % had less than 0.12 at the start and 0.55 at the end; of 2200 false candidates 40 % and
 * 65 %. */
static const double LEAST_AT_START = 0.10, LEAST_HALFWAY = 0.15, LEAST_AT_END = 0.40;
/* Least explained fractions for a disc with a radius up to FAR_PX, in pixels. An occluder can leave as little of it. */
static const double FAR_PX = 16.0, LEAST_FAR_AT_START = 0.05, LEAST_FAR_HALFWAY = 0.12, LEAST_FAR_AT_END = 0.25;
/* Work of a step for each sample. */
enum { STEP_WORK = 220 };

int align_blur_at(const dl_lens *c, const dl_pad_template *p, double side_m, double depth_m)
{
    return align_blur(p, hypot(PIXEL_SIGMA * side_m, LENS_BLUR_PX * depth_m / c->fx));
}

/* Use only the rays that meet the pad's plane beyond its centre in a direction on it. Returns their number. */
static int trust_side(const dl_pad_pose *pose, const double side[2], pixels *from)
{
    const double *R = pose->R, *t = pose->t;
    double across[3], n_t = 0.0, across_t = 0.0;
    for (int i = 0; i < 3; i++) {
        across[i] = R[3 * i] * side[0] + R[3 * i + 1] * side[1];
        n_t += R[3 * i + 2] * t[i];
        across_t += across[i] * t[i];
    }
    /* A ray's position on the pad is r (n t) / (n r) - t. Both sides are multiplied by n r, which is positive. */
    float over[3];
    for (int i = 0; i < 3; i++) {
        over[i] = (float)(across[i] * n_t - R[3 * i + 2] * across_t);
    }
    int used = 0;
    for (int i = 0; i < from->n; i++) {
        const int beyond = over[0] * from->x[i] + over[1] * from->y[i] + over[2] > 0.0f && from->trust[i] > 0.0f;
        from->trust[i] = beyond ? 1.0f : 0.0f;
        used += beyond;
    }
    return used;
}

/* The normal matrix, its upper triangle in rows, and the gradient of a small translation and rotation in `pad`.
 *
 * A row of the Jacobian is gx u + gy v with the slopes gx and gy of the modelled light, and u and v alike for all channels. */
WIDE
static void normal_sums(const samples *s, const float paints[4][3], double out[SUMS])
{
    float8 sums[SUMS];
    memset(sums, 0, sizeof sums);
    for (int at = 0; at < s->room; at += SAMPLE_LANES) {
        float8 xx = {0.0f}, xy = {0.0f}, yy = {0.0f}, xr = {0.0f}, yr = {0.0f};
        for (int c = 0; c < 3; c++) {
            const float8 r = *eight(s->residual[c] + at);
            float8 gx = {0.0f}, gy = {0.0f};
            for (int k = 0; k < 4; k++) {
                gx += paints[k][c] * *eight(s->slope_x[k] + at);
                gy += paints[k][c] * *eight(s->slope_y[k] + at);
            }
            xx += gx * gx, xy += gx * gy, yy += gy * gy, xr += gx * r, yr += gy * r;
        }
        const float8 x = *eight(s->x + at), y = *eight(s->y + at), w = *eight(s->weight + at);
        const float8 a = *eight(s->a + at), b = *eight(s->b + at), none = {0.0f};
        const float8 u[POSE] = {none - 1.0f, none, a, a * y, -a * x, y}, v[POSE] = {none, none - 1.0f, b, b * y, -b * x, -x};
        xx *= w, xy *= w, yy *= w, xr *= w, yr *= w;
        float8 *sum = sums;
        for (int i = 0; i < POSE; i++) {
            const float8 by_u = xx * u[i] + xy * v[i], by_v = xy * u[i] + yy * v[i];
            for (int j = i; j < POSE; j++) {
                *sum++ += by_u * u[j] + by_v * v[j];
            }
            sums[SUMS - POSE + i] += xr * u[i] + yr * v[i];
        }
    }
    for (int row = 0; row < SUMS; row++) {
        out[row] = align_sum(&sums[row]);
    }
}

/* The step of Gauss and Newton, with the prior on the tilt; limited. Returns whether there is one. */
static int step_of(const samples *s, const painted *fit, const double tilt[2], double sigma_tilt, double depth_m, double step[POSE])
{
    double sums[SUMS], M[POSE * POSE], scale = 1.0 / (fit->spread * fit->spread), prior = 1.0 / (sigma_tilt * sigma_tilt);
    normal_sums(s, fit->paints, sums);
    for (int i = 0, row = 0; i < POSE; i++) {
        for (int j = i; j < POSE; j++, row++) {
            M[POSE * i + j] = M[POSE * j + i] = sums[row] * scale;
        }
        step[i] = sums[SUMS - POSE + i] * scale;
    }
    for (int k = 0; k < 2; k++) {
        M[(POSE + 1) * (3 + k)] += prior;
        step[3 + k] -= tilt[k] * prior;
    }
    for (int i = 0; i < POSE; i++) {
        M[(POSE + 1) * i] = M[(POSE + 1) * i] * 1.001 + 1e-6;
    }
    if (!solve_positive(POSE, M, 1, step)) {
        return 0;
    }
    const double way = sqrt(step[0] * step[0] + step[1] * step[1] + step[2] * step[2]);
    const double turn = sqrt(step[3] * step[3] + step[4] * step[4] + step[5] * step[5]);
    for (int i = 0; i < 3; i++) {
        step[i] *= fmin(1.0, STEP_DEPTHS * depth_m / fmax(1e-9, way));
        step[3 + i] *= fmin(1.0, STEP_RAD / fmax(1e-9, turn));
    }
    return 1;
}

/* Move and turn a pose by a step in its own axes. Returns whether the result can be seen. */
static int stepped(const double step[POSE], double depth_m, dl_pad_pose *pose)
{
    double moved[3], turn[9], R[9];
    rotated(pose->R, step, moved);
    exp_rotation(step + 3, turn);
    product(pose->R, turn, R);
    memcpy(pose->R, R, sizeof R);
    for (int i = 0; i < 3; i++) {
        pose->t[i] += moved[i];
    }
    return pose->t[2] > LEAST_DEPTH_M && fabs(log(pose->t[2] / depth_m)) < DEPTH_CHANGE && R[8] > LEAST_ALIGNED_FACING;
}

/* The least that the drawing must explain before step i, or 0 without a requirement. */
static double least_explained(int far, int i, int steps)
{
    if (i == 0) {
        return far ? LEAST_FAR_AT_START : LEAST_AT_START;
    }
    return i != steps / 2 ? 0.0 : far ? LEAST_FAR_HALFWAY : LEAST_HALFWAY;
}

/* Fit the paints to the samples for a pose, from the weights of the step before, and keep the new ones. */
static int fit_at(const dl_pad_template *p, const int16_t *map, float *const light[3], const dl_pad_pose *pose, pixels *from, samples *s,
                  painted *fit)
{
    if (!align_samples(p, map, from, pose, 1, s)) {
        return 0;
    }
    align_take(light, s);
    for (int i = 0; i < s->n; i++) {
        s->weight[i] = from->trust[s->pixel[i]];
    }
    if (!align_paint(s, 0, fit)) {
        return 0;
    }
    for (int i = 0; i < s->n; i++) {
        from->trust[s->pixel[i]] = s->weight[i];
    }
    return 1;
}

int align_move(const dl_tracker *t, const seen_part *seen, const dl_alignment *how, double noise, dl_pad_pose *pose, double *tilt_sigmas)
{
    const dl_lens *c = &t->camera.lens;
    const dl_pad_template *p = &t->pad.drawn;
    const int16_t *maps = how->local ? t->local_maps : t->maps;
    pixels from;
    samples s;
    painted fit;
    const double depth_m = pose->t[2], noise_var = noise * noise / (double)(1 << 2 * seen->part.level);
    double tilt[2] = {0.0, 0.0}, step[POSE];
    align_divide(seen->part.width, seen->part.height, t->scratch, &from, &s);
    align_light(t, seen, depth_m, (int)how->local, s.squared, &from);
    int used = align_trust(how->cut, &from);
    if (how->one_side) {
        used = trust_side(pose, how->side, &from);
    }
    const int sharp = align_blur_at(c, p, from.side_m, depth_m), soft = sharp + 1 < DL_TEMPLATE_BLURS ? sharp + 1 : sharp;
    const int far = c->fx * p->disc_radius_m < FAR_PX * depth_m, steps = (int)how->steps * (used < FEW ? 2 : 1);
    float *const *of = how->local ? from.local : from.light;
    for (int i = 0; i < steps; i++) {
        if (!fit_at(p, align_map(p, maps, i < steps / 2 ? soft : sharp), of, pose, &from, &s, &fit)) {
            return 0;
        }
        count_work(t, s.n, STEP_WORK);
        if (how->local && align_explained(&s, noise_var) < least_explained(far, i, steps)) {
            return 0;
        }
        if (!step_of(&s, &fit, tilt, how->sigma_tilt_rad, depth_m, step)) {
            return 0;
        }
        tilt[0] += step[3];
        tilt[1] += step[4];
        if (!stepped(step, depth_m, pose)) {
            return 0;
        }
        const double turned_m = p->disc_radius_m * (fabs(step[2]) / depth_m + fabs(step[5]));
        if (i >= steps / 2 && hypot(step[0], step[1]) + turned_m < AT_REST * from.side_m) {
            break;
        }
    }
    if (how->local && align_explained(&s, noise_var) < (far ? LEAST_FAR_AT_END : LEAST_AT_END)) {
        return 0;
    }
    orthonormalise(pose->R);
    *tilt_sigmas = hypot(tilt[0], tilt[1]) / how->sigma_tilt_rad;
    return 1;
}
