/* Where the rays of many pixels meet the pad's plane, and how deep they lie in its regions. */

#include "render/pad.h"

/* The homographies in rows, whose times run from -1 in the first to 1 in the last, by a parabola through three. */
WIDE
static void planes_in_rows(const stroke *k, sheaf *s)
{
    for (int i = 0; i < 9; i++) {
        const float slope = 0.5f * (k->last[i] - k->first[i]), middle = k->middle[i];
        const float bend = 0.5f * (k->last[i] + k->first[i]) - middle;
        for (int j = 0; j < TOGETHER; j++) {
            const float t = s->time[j];
            s->plane[i][j] = middle + t * slope + t * t * bend;
        }
    }
}

void begin_rays(const dl_sim_pad_view *v, const stroke *k, sheaf *s)
{
    for (int j = 0; j < TOGETHER; j++) {
        s->x[j] = s->y[j] = 0.0f;
        for (int i = 0; i < 9; i++) {
            s->plane[i][j] = k->middle[i];
        }
        for (int i = 0; i < 4; i++) {
            s->change[i][j] = v->change[i];
        }
    }
}

void gather_rays(const dl_sim_pad_view *v, int32_t n, const int32_t *pixels, sheaf *s)
{
    for (int32_t i = 0; i < TOGETHER; i++) {
        const float *ray = v->rays + 2 * (int64_t)pixels[i < n ? i : n - 1];
        s->x[i] = ray[0];
        s->y[i] = ray[1];
    }
}

void gather_changes(const dl_sim_pad_view *v, const stroke *k, int32_t n, const int32_t *pixels, sheaf *s)
{
    for (int32_t j = 0; v->bent && j < TOGETHER; j++) {
        const float *change = v->change + 4 * (int64_t)pixels[j < n ? j : n - 1];
        for (int i = 0; i < 4; i++) {
            s->change[i][j] = change[i];
        }
    }
    if (k->first) {
        for (int32_t i = 0; i < TOGETHER; i++) {
            s->time[i] = (float)(pixels[i < n ? i : n - 1] / v->w) * (2.0f / (float)(v->h - 1)) - 1.0f;
        }
        planes_in_rows(k, s);
    }
}

WIDE
void meet(const sheaf *rays, const float *turn, float parts, spots *s)
{
    float D[9];
    memcpy(D, turn, sizeof D);
    for (int k = 0; k < TOGETHER; k++) {
        float M[9];
        for (int i = 0; i < 9; i++) {
            M[i] = rays->plane[i][k];
        }
        const float x = rays->x[k], y = rays->y[k], depth = M[6] * x + M[7] * y + M[8];
        const float there = depth > 1e-9f ? 1.0f : 0.0f, w = there / (depth > 1e-9f ? depth : 1.0f);
        const float u = (M[0] * x + M[1] * y + M[2]) * w, v = (M[3] * x + M[4] * y + M[5]) * w;
        const float ux = (M[0] - u * M[6]) * w * parts, uy = (M[1] - u * M[7]) * w * parts;
        const float vx = (M[3] - v * M[6]) * w * parts, vy = (M[4] - v * M[7]) * w * parts;
        const float right = D[6] * x + D[7] * y + D[8];
        s->u[k] = u + FAR_AWAY * (1.0f - there);
        s->v[k] = v;
        s->right_u[k] = ux * rays->change[0][k] + uy * rays->change[2][k];
        s->right_v[k] = vx * rays->change[0][k] + vy * rays->change[2][k];
        s->down_u[k] = ux * rays->change[1][k] + uy * rays->change[3][k];
        s->down_v[k] = vx * rays->change[1][k] + vy * rays->change[3][k];
        s->way_u[k] = (D[0] * x + D[1] * y + D[2] - u * right) * w;
        s->way_v[k] = (D[3] * x + D[4] * y + D[5] - v * right) * w;
    }
}

WIDE
void sizes_of(const spots *s, float *restrict radius, float *restrict way)
{
    for (int k = 0; k < TOGETHER; k++) {
        const float au = s->right_u[k] + s->down_u[k], av = s->right_v[k] + s->down_v[k];
        const float bu = s->right_u[k] - s->down_u[k], bv = s->right_v[k] - s->down_v[k];
        const float a2 = au * au + av * av, b2 = bu * bu + bv * bv;
        radius[k] = 0.5f * sqrtf(a2 > b2 ? a2 : b2);
        way[k] = sqrtf(s->way_u[k] * s->way_u[k] + s->way_v[k] * s->way_v[k]);
    }
}

WIDE
void depths_in(const float *g, const float *restrict u, const float *restrict v, float *restrict depth)
{
    switch ((int)g[DL_PAD_SHAPE]) {
    case DL_PAD_ANNULUS:
        for (int k = 0; k < TOGETHER; k++) {
            depth[k] = in_annulus(g, u[k], v[k]);
        }
        break;
    case DL_PAD_RECTANGLE:
        for (int k = 0; k < TOGETHER; k++) {
            depth[k] = in_rectangle(g, u[k], v[k]);
        }
        break;
    case DL_PAD_POLYGON:
        for (int k = 0; k < TOGETHER; k++) {
            depth[k] = in_polygon(g, u[k], v[k]);
        }
        break;
    default:
        for (int k = 0; k < TOGETHER; k++) {
            depth[k] = in_arrow(g, u[k], v[k]);
        }
    }
}
