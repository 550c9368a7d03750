/* The shares of the paints in the pixels that an edge touches.
 *
 * For each subpixel and each part of the exposure, the signed distance to every edge that can be near becomes a
 * coverage. Seen along the normal of a straight edge, a square subpixel that moves is three boxes convolved: its two sides and its
 * way. The widest is integrated exactly, the others together by two-point Gauss quadrature, so that mean, variance and skewness
 * are right: edges lie where the drawing has them in any direction, and areas add up even if a shape is thinner than a pixel.
 */

#include "render/pad.h"

/* A subpixel along a direction: a box blurred by two points, one over its width and their distance from its middle in widths. */
typedef struct {
    float per_width, offset;
} box;

typedef struct {
    float per_width[TOGETHER], offset[TOGETHER];
} boxes;

static inline box box_along(const spots *s, int k, float gu, float gv)
{
    const float a = gu * s->right_u[k] + gv * s->right_v[k], b = gu * s->down_u[k] + gv * s->down_v[k];
    const float c = gu * s->way_u[k] + gv * s->way_v[k], a2 = a * a, b2 = b * b, c2 = c * c;
    float widest = a2 > b2 ? a2 : b2;
    widest = widest > c2 ? widest : c2;
    widest = widest > 1e-14f ? widest : 1e-14f;
    const float rest = ((a2 + b2 + c2) / widest - 1.0f) * (1.0f / 12.0f);
    const box made = {1.0f / sqrtf(widest), sqrtf(rest > 0.0f ? rest : 0.0f)};
    return made;
}

WIDE
static void boxes_along(const spots *s, float gu, float gv, boxes *made)
{
    for (int k = 0; k < TOGETHER; k++) {
        const box b = box_along(s, k, gu, gv);
        made->per_width[k] = b.per_width;
        made->offset[k] = b.offset;
    }
}

static inline float limited(float share)
{
    const float some = share > 0.0f ? share : 0.0f;
    return some < 1.0f ? some : 1.0f;
}

/* The share of a subpixel on the positive side of an edge. */
static inline float covered(float distance, float per_width, float offset)
{
    const float share = distance * per_width + 0.5f;
    return 0.5f * (limited(share + offset) + limited(share - offset));
}

/* The share between two parallel edges; it is also right for a strip thinner than a subpixel. */
static inline float between(float from, float to, float x, float per_width, float offset)
{
    return covered(x - from, per_width, offset) - covered(x - to, per_width, offset);
}

/* Subpixels of some pixels during a part of the exposure: their images, where one of each pixel is, and what the straight edges of
 * the pad see of all of them. */
typedef struct {
    spots met;
    float u[TOGETHER], v[TOGETHER];
    boxes along_u, along_v, left, right;
} grid;

WIDE
static void shares_of_annulus(const float *g, const grid *s, float *restrict share)
{
    const float inner = g[DL_PAD_ANNULUS_INNER], outer = g[DL_PAD_ANNULUS_OUTER];
    for (int k = 0; k < TOGETHER; k++) {
        const float u = s->u[k], v = s->v[k], r = sqrtf(u * u + v * v) + 1e-9f, per_r = 1.0f / r;
        const box b = box_along(&s->met, k, u * per_r, v * per_r);
        share[k] = between(inner, outer, r, b.per_width, b.offset);
    }
}

WIDE
static void shares_of_rectangle(const float *g, const grid *s, float *restrict share)
{
    const float u0 = g[DL_PAD_RECTANGLE_U0], u1 = g[DL_PAD_RECTANGLE_U1], v0 = g[DL_PAD_RECTANGLE_V0], v1 = g[DL_PAD_RECTANGLE_V1];
    for (int k = 0; k < TOGETHER; k++) {
        share[k] = between(u0, u1, s->u[k], s->along_u.per_width[k], s->along_u.offset[k]) *
                   between(v0, v1, s->v[k], s->along_v.per_width[k], s->along_v.offset[k]);
    }
}

WIDE
static void shares_of_arrow(const float *g, const grid *s, float *restrict share)
{
    const float cosine = g[DL_PAD_ARROW_COS], sine = g[DL_PAD_ARROW_SIN], tip = g[DL_PAD_ARROW_TIP], base = g[DL_PAD_ARROW_BASE];
    for (int k = 0; k < TOGETHER; k++) {
        const float ahead = cosine * (tip - s->u[k]), aside = sine * s->v[k];
        share[k] = covered(s->u[k] - base, s->along_u.per_width[k], s->along_u.offset[k]) *
                   covered(ahead - aside, s->left.per_width[k], s->left.offset[k]) *
                   covered(ahead + aside, s->right.per_width[k], s->right.offset[k]);
    }
}

WIDE
static void shares_of_polygon(const float *g, const grid *s, float *restrict share)
{
    const int sides = (int)g[DL_PAD_POLYGON_SIDES];
    boxes along;
    for (int side = 0; side < sides; side++) {
        const float *of = g + DL_PAD_POLYGON_FIRST + 3 * side;
        boxes_along(&s->met, of[0], of[1], &along);
        for (int k = 0; k < TOGETHER; k++) {
            const float within = covered(of[2] - of[0] * s->u[k] - of[1] * s->v[k], along.per_width[k], along.offset[k]);
            share[k] = side ? share[k] * within : within;
        }
    }
}

static void shares_of(const float *g, const grid *s, float *share)
{
    switch ((int)g[DL_PAD_SHAPE]) {
    case DL_PAD_ANNULUS:
        shares_of_annulus(g, s, share);
        break;
    case DL_PAD_RECTANGLE:
        shares_of_rectangle(g, s, share);
        break;
    case DL_PAD_POLYGON:
        shares_of_polygon(g, s, share);
        break;
    default:
        shares_of_arrow(g, s, share);
    }
}

/* What the pixels of a group have of each paint, in subpixels. */
typedef struct {
    float of[DL_PAD_PAINTS][TOGETHER], ring[TOGETHER];
} sums;

/* A region takes its share from the paint that it lies on. */
WIDE
static void add(const float *restrict share, float *restrict below, float *restrict paint)
{
    for (int k = 0; k < TOGETHER; k++) {
        below[k] -= share[k];
        paint[k] += share[k];
    }
}

/* The arrowhead takes none of what the ring, which has its paint, covers already. */
WIDE
static void subtract_ring(const float *restrict ring, float *restrict share)
{
    for (int k = 0; k < TOGETHER; k++) {
        share[k] *= 1.0f - ring[k];
    }
}

static void add_region(const float *g, const grid *s, sums *total)
{
    float share[TOGETHER];
    const int paint = (int)g[DL_PAD_PAINT], below = (int)g[DL_PAD_BELOW];
    shares_of(g, s, share);
    if (paint == DL_PAD_ORANGE && (int)g[DL_PAD_SHAPE] == DL_PAD_ARROW) {
        subtract_ring(total->ring, share);
    } else if (paint == DL_PAD_ORANGE) {
        for (int k = 0; k < TOGETHER; k++) {
            total->ring[k] += share[k];
        }
    }
    if (paint != below) {
        add(share, total->of[below], total->of[paint]);
    }
}

static void add_all(float value, float *sum)
{
    for (int k = 0; k < TOGETHER; k++) {
        sum[k] += value;
    }
}

/* The regions that a group of pixels shows a part of, the lowest first, and the subpixels that one paint covers altogether. */
typedef struct {
    int count;
    const float *near[DL_PAD_REGIONS_MOST];
    float whole[DL_PAD_PAINTS];
} choice;

/* Whether all of the points lie inside a region, or all outside it, by more than they reach. */
static void inside_or_outside(const float *depth, const float *reach, int *all_inside, int *all_outside)
{
    int in = 1, out = 1;
    for (int k = 0; k < TOGETHER; k++) {
        in &= depth[k] >= reach[k];
        out &= depth[k] <= -reach[k];
    }
    *all_inside = in;
    *all_outside = out;
}

/* Choose regions for pixels whose subpixels reach so far. The ring's share is needed where the arrowhead's is. */
static void choose(const dl_sim_pad_view *p, const spots *s, const float *reach, choice *c)
{
    float depth[TOGETHER];
    memset(c->whole, 0, sizeof c->whole);
    c->whole[DL_PAD_NONE] = 1.0f;
    c->count = 0;
    for (int i = 0; i < p->regions; i++) {
        const float *g = region_of(p, i);
        int all_inside, all_outside;
        depths_in(g, s->u, s->v, depth);
        inside_or_outside(depth, reach, &all_inside, &all_outside);
        if (all_inside && (int)g[DL_PAD_PAINT] != DL_PAD_ORANGE) {
            c->whole[(int)g[DL_PAD_BELOW]] -= 1.0f;
            c->whole[(int)g[DL_PAD_PAINT]] += 1.0f;
        } else if (!all_outside) {
            c->near[c->count++] = g;
        }
    }
}

/* See the pixels along the normals of the straight edges that are near. */
static void look_along_edges(const choice *c, grid *s)
{
    int straight = 0;
    for (int i = 0; i < c->count; i++) {
        const float *g = c->near[i];
        straight |= (int)g[DL_PAD_SHAPE] == DL_PAD_RECTANGLE || (int)g[DL_PAD_SHAPE] == DL_PAD_ARROW;
        if ((int)g[DL_PAD_SHAPE] == DL_PAD_ARROW) {
            boxes_along(&s->met, g[DL_PAD_ARROW_COS], g[DL_PAD_ARROW_SIN], &s->left);
            boxes_along(&s->met, g[DL_PAD_ARROW_COS], -g[DL_PAD_ARROW_SIN], &s->right);
        }
    }
    if (straight) {
        boxes_along(&s->met, 1.0f, 0.0f, &s->along_u);
        boxes_along(&s->met, 0.0f, 1.0f, &s->along_v);
    }
}

WIDE
static void place(float right, float down, grid *s)
{
    for (int k = 0; k < TOGETHER; k++) {
        s->u[k] = s->met.u[k] + right * s->met.right_u[k] + down * s->met.down_u[k];
        s->v[k] = s->met.v[k] + right * s->met.right_v[k] + down * s->met.down_v[k];
    }
}

/* Add what a subpixel of each of n pixels has of each paint to the sums of the pixels, and to the subpixels where they are kept. */
static void keep_part(const sums *one, int32_t n, int part, int parts, sums *total, float *kept)
{
    for (int paint = 0; paint < DL_PAD_PAINTS; paint++) {
        for (int k = 0; k < TOGETHER; k++) {
            total->of[paint][k] += one->of[paint][k];
        }
        for (int32_t k = 0; kept && k < n; k++) {
            kept[(DL_PAD_PAINTS * (int64_t)k + paint) * parts + part] += one->of[paint][k];
        }
    }
}

/* Add the shares of all subpixels of some pixels during one of the parts of the exposure. The plane is linear within a pixel. */
static void add_pixels(const dl_sim_pad_view *v, const stroke *k, int32_t n, const int32_t *pixels, int fine, sums *total, float *kept)
{
    float radius[TOGETHER], way[TOGETHER];
    sheaf rays;
    grid s;
    sums one;
    choice c;
    begin_rays(v, k, &rays);
    gather_rays(v, n, pixels, &rays);
    gather_changes(v, k, n, pixels, &rays);
    meet(&rays, k->turn, 1.0f / (float)fine, &s.met);
    sizes_of(&s.met, radius, way);
    for (int i = 0; i < TOGETHER; i++) {
        radius[i] = 1.01f * (float)fine * (radius[i] + 0.5f * way[i]);
    }
    choose(v, &s.met, radius, &c);
    look_along_edges(&c, &s);
    for (int part = 0; part < fine * fine; part++) {
        place((float)(part % fine) - 0.5f * (float)(fine - 1), (float)(part / fine) - 0.5f * (float)(fine - 1), &s);
        memset(&one, 0, sizeof one);
        for (int paint = 0; paint < DL_PAD_PAINTS; paint++) {
            add_all(c.whole[paint], one.of[paint]);
        }
        for (int i = 0; i < c.count; i++) {
            add_region(c.near[i], &s, &one);
        }
        keep_part(&one, n, part, fine * fine, total, kept);
    }
}

void dl_sim_render_pad_shares(const dl_sim_pad_view *v, int32_t strokes, const float *stroke_numbers, int32_t fine, int32_t count,
                       const int32_t *edges, float *shares, float *parts)
{
    const float each = 1.0f / (float)(strokes * fine * fine);
    const int64_t numbers = DL_PAD_PAINTS * (int64_t)fine * fine;
    sums total;
    if (parts) {
        memset(parts, 0, (size_t)(count * numbers) * sizeof *parts);
    }
    for (int32_t first = 0; first < count; first += TOGETHER) {
        const int32_t n = count - first < TOGETHER ? count - first : TOGETHER;
        memset(&total, 0, sizeof total);
        for (int i = 0; i < strokes; i++) {
            const stroke k = stroke_at(stroke_numbers, v->rolling, i);
            add_pixels(v, &k, n, edges + first, fine, &total, parts ? parts + first * numbers : 0);
        }
        for (int32_t e = 0; e < n; e++) {
            for (int k = 0; k < DL_PAD_PAINTS; k++) {
                shares[DL_PAD_PAINTS * (int64_t)(first + e) + k] = total.of[k][e] * each;
            }
        }
    }
    for (int64_t i = 0; parts && strokes > 1 && i < count * numbers; i++) {
        parts[i] *= 1.0f / (float)strokes;
    }
}
