/* Hold a registration's state: pose and blur, moved, compared and scaled. */

#include "vision/register/state.h"

#include <math.h>
#include <stddef.h>

#include "base/rotation.h"
#include "base/wide.h"
#include "vision/tracker.h"

static const double PIXEL_VAR = 1.0 / 12.0; /* Variance of a square pixel along any direction, px^2. */
static const double MAX_BLUR_PX2 = 49.0; /* Largest blur, px^2. */
/* The least depth of a pixel's ray along the normal for which the plane is met. */
static const float FLATTEST = 1e-3f;

float *take_rows(rows *r, int count)
{
    const int64_t wanted = (int64_t)count * r->length;
    if (wanted > r->left) {
        return NULL;
    }
    float *taken = r->next;
    r->next += wanted, r->left -= (int32_t)wanted;
    return taken;
}

void pixel_ray(const dl_lens *camera, const double *rays, int32_t u, int32_t v, double ray[2])
{
    if (rays) {
        const double *at = rays + 2 * ((int64_t)v * camera->width + u);
        ray[0] = at[0], ray[1] = at[1];
    } else {
        ray[0] = (u - camera->cx) / camera->fx, ray[1] = (v - camera->cy) / camera->fy;
    }
}

void in_camera(const fit_state *s, double x, double y, double p[3])
{
    for (int i = 0; i < 3; i++) {
        p[i] = s->R[3 * i] * x + s->R[3 * i + 1] * y + s->t[i];
    }
}

/* The depth of the pad's plane at the part of it that is in the frame, m. */
static double depth_in_view(const dl_lens *camera, const double R[9], const double t[3])
{
    double uv[2] = {camera->cx, camera->cy}, ray[2];
    if (t[2] > 0.05) {
        camera_project(camera, t, uv);
        uv[0] = fmin(fmax(uv[0], 0.0), (double)camera->width - 1.0);
        uv[1] = fmin(fmax(uv[1], 0.0), (double)camera->height - 1.0);
    }
    camera_ray(camera, uv[0], uv[1], ray);
    const double down = R[2] * ray[0] + R[5] * ray[1] + R[8], reach = R[2] * t[0] + R[5] * t[1] + R[8] * t[2];
    return fmax(fabs(down) > 0.05 ? reach / down : sqrt(dot(t, t)), 0.03);
}

void begin_state(const dl_lens *camera, const double R[9], const double t[3], double blur_px, fit_state *s)
{
    const double var = blur_px * blur_px + PIXEL_VAR;
    for (int i = 0; i < 9; i++) {
        s->R[i] = R[i];
    }
    for (int i = 0; i < 3; i++) {
        s->t[i] = t[i];
        s->blur_px2[i] = i == 1 ? 0.0 : var;
    }
    s->depth_m = depth_in_view(camera, R, t);
    s->m_per_px = s->depth_m / (0.5 * (camera->fx + camera->fy));
}

double sigma_px(const fit_state *s)
{
    return sqrt(0.5 * (s->blur_px2[0] + s->blur_px2[2]));
}

/* The nearest covariance that is no smaller than a pixel's in any direction. */
static void make_possible(double blur_px2[3])
{
    const double xx = blur_px2[0], xy = blur_px2[1], yy = blur_px2[2];
    if (fmin(xx, yy) > PIXEL_VAR && fmax(xx, yy) < 0.9 * MAX_BLUR_PX2 && (xx - PIXEL_VAR) * (yy - PIXEL_VAR) > xy * xy) {
        return;
    }
    const double turn = 0.5 * atan2(2.0 * xy, xx - yy), c = cos(turn), s = sin(turn), apart = hypot(0.5 * (xx - yy), xy);
    const double large = fmin(fmax(0.5 * (xx + yy) + apart, PIXEL_VAR), MAX_BLUR_PX2);
    const double small = fmin(fmax(0.5 * (xx + yy) - apart, PIXEL_VAR), MAX_BLUR_PX2);
    blur_px2[0] = large * c * c + small * s * s;
    blur_px2[1] = (large - small) * c * s;
    blur_px2[2] = large * s * s + small * c * c;
}

static double added_blur(int k, double smoothing_px2)
{
    return PIXEL_VAR * (1.0 - 1.0 / ((double)k * k)) + smoothing_px2;
}

fit_state reduced(const fit_state *s, int k, double smoothing_px2)
{
    fit_state out = *s;
    for (int i = 0; i < 3; i++) {
        out.blur_px2[i] = s->blur_px2[i] / ((double)k * k) + (i == 1 ? 0.0 : added_blur(k, smoothing_px2));
    }
    out.m_per_px = s->m_per_px * k;
    return out;
}

fit_state restored(const fit_state *s, int k, double smoothing_px2)
{
    fit_state out = *s;
    for (int i = 0; i < 3; i++) {
        out.blur_px2[i] = (s->blur_px2[i] - (i == 1 ? 0.0 : added_blur(k, smoothing_px2))) * ((double)k * k);
    }
    make_possible(out.blur_px2);
    out.m_per_px = s->m_per_px / k;
    return out;
}

fit_state moved(const fit_state *s, const double delta[STATES])
{
    fit_state out = *s;
    double turn[9], way[3];
    exp_rotation(delta + 3, turn);
    product(s->R, turn, out.R);
    rotated(s->R, delta, way);
    for (int i = 0; i < 3; i++) {
        out.t[i] = s->t[i] + way[i];
        out.blur_px2[i] = s->blur_px2[i] + delta[6 + i];
    }
    make_possible(out.blur_px2);
    return out;
}

void difference(const fit_state *a, const fit_state *b, double delta[STATES])
{
    double turn[9], way[3];
    product_of_transposed(a->R, b->R, turn);
    for (int i = 0; i < 3; i++) {
        way[i] = b->t[i] - a->t[i];
        delta[6 + i] = b->blur_px2[i] - a->blur_px2[i];
    }
    rotated_back(a->R, way, delta);
    delta[3] = 0.5 * (turn[7] - turn[5]);
    delta[4] = 0.5 * (turn[2] - turn[6]);
    delta[5] = 0.5 * (turn[3] - turn[1]);
}

WIDE
void look_at(const fit_state *s, const float *ray_x, const float *ray_y, footprint *f)
{
    /* Single precision is 1e-7 of the pad, and twice as many of its numbers fit into a register. */
    float R[9], *restrict x = f->x, *restrict y = f->y, *restrict k1 = f->k1, *restrict k2 = f->k2, *restrict m = f->m;
    double c[3];
    rotated_back(s->R, s->t, c);
    for (int i = 0; i < 9; i++) {
        R[i] = (float)s->R[i];
    }
    const float c0 = (float)-c[0], c1 = (float)-c[1], c2 = (float)-c[2], per_depth = (float)(c[2] / s->depth_m);
    const int n = whole_lanes(f->n);
    for (int i = 0; i < n; i++) {
        const float u = ray_x[i], v = ray_y[i], r2 = R[2] * u + R[5] * v + R[8];
        const float per = 1.0f / (r2 > FLATTEST ? r2 : FLATTEST);
        const float a = (R[0] * u + R[3] * v + R[6]) * per, b = (R[1] * u + R[4] * v + R[7]) * per, depth = per * per_depth;
        k1[i] = a, k2[i] = b;
        x[i] = c0 - c2 * a, y[i] = c1 - c2 * b;
        m[i] = depth * depth;
    }
    f->m2_per_px2 = s->m_per_px * s->m_per_px;
    for (int i = 0; i < 3; i++) {
        f->blur_m2[i] = s->blur_px2[i] * f->m2_per_px2;
    }
}

WIDE
void by_state(const footprint *f, const float *const d[BY], int begin, int count, float *const J[STATES])
{
    const float *restrict x = f->x + begin, *restrict y = f->y + begin, *restrict k1 = f->k1 + begin, *restrict k2 = f->k2 + begin;
    const float *restrict dx = d[0], *restrict dy = d[1], scale = (float)f->m2_per_px2;
    float *restrict j0 = J[0], *restrict j1 = J[1], *restrict j2 = J[2], *restrict j3 = J[3], *restrict j4 = J[4], *restrict j5 = J[5];
    for (int i = 0; i < count; i++) {
        const float g = k1[i] * dx[i] + k2[i] * dy[i];
        j0[i] = -dx[i], j1[i] = -dy[i], j2[i] = g;
        j3[i] = y[i] * g, j4[i] = -x[i] * g, j5[i] = y[i] * dx[i] - x[i] * dy[i];
    }
    for (int k = 2; k < BY; k++) {
        const float *restrict from = d[k];
        float *restrict to = J[4 + k];
        for (int i = 0; i < count; i++) {
            to[i] = from[i] * scale;
        }
    }
}
