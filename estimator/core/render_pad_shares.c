/* The shares of the paints in the pixels that an edge touches.
 *
 * For each subpixel and each part of the exposure, the signed distance to every edge that can be near becomes a
 * coverage. Seen along the normal of a straight edge, a square subpixel that moves is three boxes convolved: its two sides and its
 * way. The widest is integrated exactly, the others together by two-point Gauss quadrature, so that mean, variance and skewness
 * are right: edges lie where the drawing has them in any direction, and areas add up even if a shape is thinner than a pixel.
 */

#include <string.h>

#include "render_pad.h"

/* Circles around a subpixel with its way, beyond which two-point quadrature of its boxes sees nothing either. */
static const float CLEAR = 1.5f;

/* A subpixel seen along a direction: a box blurred by two points, one over its width and their distance from its middle in widths. */
typedef struct {
    float per_width, offset;
} box;

static inline box box_along(const spot *s, float gu, float gv)
{
    const float a = gu * s->right_u + gv * s->right_v, b = gu * s->down_u + gv * s->down_v, c = gu * s->way_u + gv * s->way_v;
    const float a2 = a * a, b2 = b * b, c2 = c * c;
    float widest = a2 > b2 ? a2 : b2;
    widest = widest > c2 ? widest : c2;
    widest = widest > 1e-14f ? widest : 1e-14f;
    const float rest = ((a2 + b2 + c2) / widest - 1.0f) * (1.0f / 12.0f);
    const box made = {1.0f / sqrtf(widest), sqrtf(rest > 0.0f ? rest : 0.0f)};
    return made;
}

static inline float limited(float share)
{
    return share < 0.0f ? 0.0f : share > 1.0f ? 1.0f : share;
}

/* The share of a subpixel on the positive side of an edge. */
static inline float covered(float distance, box b)
{
    const float share = distance * b.per_width + 0.5f;
    return 0.5f * (limited(share + b.offset) + limited(share - b.offset));
}

/* The share between two parallel edges; it is also right for a strip thinner than a subpixel. */
static inline float between(float from, float to, float x, box b)
{
    return covered(x - from, b) - covered(x - to, b);
}

/* The regions that a pixel shows a part of, and the shares of what it shows all of. */
typedef struct {
    int count;
    const float *near[PAD_REGIONS_MOST];
    float whole[PAD_PAINTS];
    box along_u, along_v, left, right;
} choice;

/* What the subpixels of a pixel have in common, all of which lie within `reach` of (u, v): which regions they can show, and the
 * boxes along the straight edges of those. */
static void choose(const painting *p, float u, float v, const spot *s, float reach, choice *c)
{
    const float r = sqrtf(u * u + v * v);
    int straight = 0;
    memset(c, 0, sizeof *c);
    c->whole[PAD_NONE] = 1.0f;
    for (int i = 0; i < p->count; i++) {
        const float *g = region_of(p, i);
        const int on = on_region(g, u, v, r, reach), shape = (int)g[PAD_SHAPE];
        if (on == 1 && shape != PAD_ARROW) {
            c->whole[(int)g[PAD_BELOW]] -= 1.0f;
            c->whole[(int)g[PAD_PAINT]] += 1.0f;
        } else if (on != 0) {
            c->near[c->count++] = g;
            straight |= shape != PAD_ANNULUS;
            if (shape == PAD_ARROW) {
                c->left = box_along(s, g[PAD_ARROW_COS], g[PAD_ARROW_SIN]);
                c->right = box_along(s, g[PAD_ARROW_COS], -g[PAD_ARROW_SIN]);
            }
        }
    }
    if (straight) {
        c->along_u = box_along(s, 1.0f, 0.0f);
        c->along_v = box_along(s, 0.0f, 1.0f);
    }
}

/* The share of the subpixel at (u, v), which lies at r from the centre, that an edge of a region may cross. */
static inline float share_of(const float *g, float u, float v, float r, const spot *s, const choice *c)
{
    switch ((int)g[PAD_SHAPE]) {
    case PAD_ANNULUS:
        return between(g[PAD_ANNULUS_INNER], g[PAD_ANNULUS_OUTER], r, box_along(s, u / r, v / r));
    case PAD_RECTANGLE:
        return between(g[PAD_RECTANGLE_U0], g[PAD_RECTANGLE_U1], u, c->along_u) *
               between(g[PAD_RECTANGLE_V0], g[PAD_RECTANGLE_V1], v, c->along_v);
    default: {
        const float ahead = g[PAD_ARROW_COS] * (g[PAD_ARROW_TIP] - u), aside = g[PAD_ARROW_SIN] * v;
        return covered(u - g[PAD_ARROW_BASE], c->along_u) * covered(ahead - aside, c->left) * covered(ahead + aside, c->right);
    }
    }
}

/* Add the shares of the paints in the subpixel at (u, v). A region takes its share from the paint that it lies on; the arrowhead
 * takes none of what the ring, which has its paint, covers already. */
static void add_shares(float u, float v, const spot *s, const choice *c, float reach, float *total)
{
    const float r = sqrtf(u * u + v * v) + 1e-9f;
    float ring = c->whole[PAD_ORANGE];
    for (int i = 0; i < c->count; i++) {
        const float *g = c->near[i];
        const int on = on_region(g, u, v, r, CLEAR * reach), paint = (int)g[PAD_PAINT];
        if (on == 0) {
            continue;
        }
        float share = on == EDGE ? share_of(g, u, v, r, s, c) : 1.0f;
        if (paint == PAD_ORANGE && (int)g[PAD_SHAPE] == PAD_ARROW) {
            share *= 1.0f - ring;
        } else if (paint == PAD_ORANGE) {
            ring += share;
        }
        total[(int)g[PAD_BELOW]] -= share;
        total[paint] += share;
    }
}

/* Add the shares of all subpixels of a pixel during one of the parts of the exposure. The plane is linear within a pixel.
 *
 * Most pixels that an edge crosses during a long way see one paint during a part of it. */
static void add_pixel(const view *v, const stroke *k, int parts, int32_t pixel, int fine, const painting *pad, float *total)
{
    float row[9];
    const float *M = k->middle, *change = change_at(v, pixel), *ray = v->rays + 2 * (int64_t)pixel;
    const float size = 1.0f / (float)fine;
    if (k->first) {
        in_row(k, row_time(v, pixel / v->w), row);
        M = row;
    }
    spot s;
    if (!meet(M, k->turn, ray[0], ray[1], change, size, &s)) {
        total[PAD_NONE] += (float)(fine * fine);
        return;
    }
    const float reach = around(&s) + 0.5f * sqrtf(s.way_u * s.way_u + s.way_v * s.way_v);
    const float all = 1.01f * (float)fine * reach;
    const int paint = parts > 1 ? paint_at(pad, s.u, s.v, all) : EDGE;
    if (paint != EDGE) {
        total[paint] += (float)(fine * fine);
        return;
    }
    choice c;
    choose(pad, s.u, s.v, &s, all, &c);
    for (int shown = 0; shown < PAD_PAINTS; shown++) {
        total[shown] += (float)(fine * fine) * c.whole[shown];
    }
    for (int j = 0; j < fine; j++) {
        for (int i = 0; i < fine; i++) {
            const float right = (float)i - 0.5f * (float)(fine - 1), down = (float)j - 0.5f * (float)(fine - 1);
            const float u_here = s.u + right * s.right_u + down * s.down_u, v_here = s.v + right * s.right_v + down * s.down_v;
            add_shares(u_here, v_here, &s, &c, reach, total);
        }
    }
}

void render_pad_shares(int32_t h, int32_t w, const float *rays, const float *change, int32_t bent, int32_t strokes,
                       const float *stroke_numbers, int32_t rolling, int32_t regions, const float *pad, int32_t fine, int32_t count,
                       const int32_t *edges, float *shares)
{
    const view seen = {h, w, rays, change, bent};
    const painting drawn = {regions, pad};
    const float each = 1.0f / (float)(strokes * fine * fine);
    for (int32_t e = 0; e < count; e++) {
        float *total = shares + PAD_PAINTS * (int64_t)e;
        memset(total, 0, PAD_PAINTS * sizeof *total);
        for (int i = 0; i < strokes; i++) {
            const stroke k = stroke_at(stroke_numbers, rolling, i);
            add_pixel(&seen, &k, strokes, edges[e], fine, &drawn, total);
        }
        for (int k = 0; k < PAD_PAINTS; k++) {
            total[k] *= each;
        }
    }
}
