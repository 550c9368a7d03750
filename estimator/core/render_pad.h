/* What both stages of drawing the pad share: where a pixel's ray meets its plane, and where a point is against its regions. */

#ifndef RENDER_PAD_H
#define RENDER_PAD_H

#include <math.h>

#include "interface.h"

enum { EDGE = PAD_EDGE };

/* A parallelogram on the pad's plane, m: the image of a pixel or of a part of one, with its way during a part of the exposure. */
typedef struct {
    float u, v;
    float right_u, right_v, down_u, down_v, way_u, way_v;
} spot;

typedef struct {
    int32_t h, w;
    const float *rays, *change;
    int bent;
} view;

/* The homographies of one part of the exposure: in its middle, its change during it, and in the first and last row. */
typedef struct {
    const float *middle, *turn, *first, *last;
} stroke;

static inline stroke stroke_at(const float *strokes, int rolling, int which)
{
    const float *s = strokes + STROKE_NUMBERS * which;
    const stroke made = {s, s + 9, rolling ? s + 18 : 0, rolling ? s + 27 : 0};
    return made;
}

/* The homography in a row at s, from -1 in the first row to 1 in the last, by a parabola through three. */
static inline void in_row(const stroke *k, float s, float *out)
{
    for (int i = 0; i < 9; i++) {
        const float a = k->first[i], b = k->middle[i], c = k->last[i];
        out[i] = b + s * (0.5f * (c - a)) + s * s * (0.5f * (c + a) - b);
    }
}

static inline const float *change_at(const view *v, int32_t pixel)
{
    return v->change + (v->bent ? 4 * (int64_t)pixel : 0);
}

/* Where the ray (x, y) meets the plane, and the image there of a pixel divided by `parts`; 0 if it does not. */
static inline int meet(const float *M, const float *D, float x, float y, const float *change, float parts, spot *s)
{
    const float depth = M[6] * x + M[7] * y + M[8];
    if (!(depth > 1e-9f)) {
        return 0;
    }
    const float w = 1.0f / depth;
    const float u = (M[0] * x + M[1] * y + M[2]) * w, v = (M[3] * x + M[4] * y + M[5]) * w;
    const float ux = (M[0] - u * M[6]) * w * parts, uy = (M[1] - u * M[7]) * w * parts;
    const float vx = (M[3] - v * M[6]) * w * parts, vy = (M[4] - v * M[7]) * w * parts;
    const float turn = D[6] * x + D[7] * y + D[8];
    s->u = u;
    s->v = v;
    s->right_u = ux * change[0] + uy * change[2];
    s->right_v = vx * change[0] + vy * change[2];
    s->down_u = ux * change[1] + uy * change[3];
    s->down_v = vx * change[1] + vy * change[3];
    s->way_u = (D[0] * x + D[1] * y + D[2] - u * turn) * w;
    s->way_v = (D[3] * x + D[4] * y + D[5] - v * turn) * w;
    return 1;
}

/* The radius of the circle around a parallelogram of these sides. */
static inline float around(const spot *s)
{
    const float au = s->right_u + s->down_u, av = s->right_v + s->down_v;
    const float bu = s->right_u - s->down_u, bv = s->right_v - s->down_v;
    const float a2 = au * au + av * av, b2 = bu * bu + bv * bv;
    return 0.5f * sqrtf(a2 > b2 ? a2 : b2);
}

/* Where a point is against an interval moved out by `reach` and one moved in by it: 0 outside, 1 inside, EDGE between. */
static inline int within(float distance, float reach)
{
    return distance <= -reach ? 0 : distance >= reach ? 1 : EDGE;
}

static inline int both(int a, int b)
{
    return a == 0 || b == 0 ? 0 : a == 1 && b == 1 ? 1 : EDGE;
}

/* The regions of a pad, the lowest first: PAD_REGION numbers each. */
typedef struct {
    int count;
    const float *rows;
} painting;

static inline const float *region_of(const painting *p, int i)
{
    return p->rows + PAD_REGION * i;
}

static inline int on_annulus(const float *g, float r, float reach)
{
    return both(within(g[PAD_ANNULUS_OUTER] - r, reach), within(r - g[PAD_ANNULUS_INNER], reach));
}

static inline int on_rectangle(const float *g, float u, float v, float reach)
{
    const int along = both(within(g[PAD_RECTANGLE_U1] - u, reach), within(u - g[PAD_RECTANGLE_U0], reach));
    return both(along, both(within(g[PAD_RECTANGLE_V1] - v, reach), within(v - g[PAD_RECTANGLE_V0], reach)));
}

static inline int on_arrow(const float *g, float u, float v, float reach)
{
    const float ahead = g[PAD_ARROW_COS] * (g[PAD_ARROW_TIP] - u), aside = g[PAD_ARROW_SIN] * v;
    return both(within(u - g[PAD_ARROW_BASE], reach), both(within(ahead - aside, reach), within(ahead + aside, reach)));
}

/* Where (u, v), at r from the centre, is against a region moved out and in by `reach`. */
static inline int on_region(const float *g, float u, float v, float r, float reach)
{
    if (r + reach < g[PAD_NEAREST] || r - reach > g[PAD_FARTHEST]) {
        return 0;
    }
    switch ((int)g[PAD_SHAPE]) {
    case PAD_ANNULUS:
        return on_annulus(g, r, reach);
    case PAD_RECTANGLE:
        return on_rectangle(g, u, v, reach);
    default:
        return on_arrow(g, u, v, reach);
    }
}

/* The paint of all points within `reach` of (u, v), or EDGE if there may be several. */
static inline int paint_at(const painting *p, float u, float v, float reach)
{
    const float r = sqrtf(u * u + v * v);
    int upper = EDGE;
    for (int i = p->count - 1; i >= 0; i--) {
        const float *g = region_of(p, i);
        const int on = on_region(g, u, v, r, reach), paint = (int)g[PAD_PAINT];
        if (on != 0 && upper != EDGE && upper != paint) {
            return EDGE;
        }
        if (on == 1) {
            return paint;
        }
        upper = on == EDGE ? paint : upper;
    }
    return upper == EDGE ? PAD_NONE : EDGE;
}

static inline float row_time(const view *v, int32_t row)
{
    return (float)row * (2.0f / (float)(v->h - 1)) - 1.0f;
}

#endif
