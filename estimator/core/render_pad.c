/* The pad in a frame: which pixels show one paint, and the shares of the paints where edges are.
 *
 * The frame is divided into squares, and those that an edge may touch into four, down to single pixels. The pixels that are left
 * are integrated: for each subpixel and each part of the exposure, the signed distance to every edge that can be near becomes a
 * coverage. Seen along the normal of a straight edge, a square subpixel that moves is three boxes convolved: its two sides and its
 * way. The widest is integrated exactly, the others together by two-point Gauss quadrature, so that mean, variance and skewness
 * are right: edges lie where the drawing has them in any direction, and areas add up even if a shape is thinner than a pixel.
 */

#include <math.h>
#include <string.h>

#include "interface.h"

enum { SQUARE = 8, EDGE = PAD_EDGE };

/* Up to so much change of the distance across a square, the plane is linear in it to a twentieth of a pixel. */
static const float TILT_MOST = 0.02f;

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

static stroke stroke_at(const float *strokes, int rolling, int which)
{
    const float *s = strokes + STROKE_NUMBERS * which;
    const stroke made = {s, s + 9, rolling ? s + 18 : 0, rolling ? s + 27 : 0};
    return made;
}

/* The homography in a row at s, from -1 in the first row to 1 in the last, by a parabola through three. */
static void in_row(const stroke *k, float s, float *out)
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

static int on_h(const float *pad, float u, float v, float reach)
{
    const float au = fabsf(u), av = fabsf(v);
    const int legs = both(within(pad[PAD_H_HALF_LENGTH] - au, reach),
                          both(within(pad[PAD_H_HALF_WIDTH] - av, reach), within(av - pad[PAD_H_INNER], reach)));
    const int bar = both(within(pad[PAD_BAR_HALF] - au, reach), within(pad[PAD_H_INNER] - av, reach));
    return legs == 1 || bar == 1 ? 1 : legs == EDGE || bar == EDGE ? EDGE : 0;
}

static int on_arrow(const float *pad, float u, float v, float reach)
{
    const float ahead = pad[PAD_ARROW_COS] * (pad[PAD_ARROW_TIP] - u), aside = pad[PAD_ARROW_SIN] * v;
    return both(within(u - pad[PAD_ARROW_BASE], reach), both(within(ahead - aside, reach), within(ahead + aside, reach)));
}

/* The paint of all points within `reach` of (u, v), or EDGE if there may be several. */
static int paint_at(const float *pad, float u, float v, float reach)
{
    const float r = sqrtf(u * u + v * v);
    if (r < pad[PAD_CLEAR_RADIUS] - reach) {
        const int h = on_h(pad, u, v, reach);
        return h == 1 ? PAD_WHITE : h == EDGE ? EDGE : PAD_DISC;
    }
    const int disc = within(pad[PAD_DISC_RADIUS] - r, reach), inner = within(pad[PAD_RIM_INNER] - r, reach);
    if (disc != 1) {
        return disc == 0 ? PAD_NONE : EDGE;
    }
    if (inner != 1) {
        return inner == 0 ? PAD_RIM : EDGE;
    }
    const int outer = within(pad[PAD_RING_OUTER] - r, reach), hole = within(pad[PAD_RING_INNER] - r, reach);
    const int arrow = on_arrow(pad, u, v, reach);
    if (arrow == 1 || (outer == 1 && hole == 0)) {
        return PAD_ORANGE;
    }
    if (arrow == EDGE || outer == EDGE || hole == EDGE) {
        return EDGE;
    }
    const int h = on_h(pad, u, v, reach);
    return h == 1 ? PAD_WHITE : h == EDGE ? EDGE : PAD_DISC;
}

/* What the division of the frame into squares works on, and what it writes. */
typedef struct {
    const view *seen;
    const stroke *whole;
    const float *pad;
    uint8_t *kinds;
    int32_t *edges, count;
} division;

static float row_time(const view *v, int32_t row)
{
    return (float)row * (2.0f / (float)(v->h - 1)) - 1.0f;
}

/* Set the paint of a square of the frame, and note it as an edge's if it is a pixel with several. */
static void set_kind(division *d, int32_t x0, int32_t y0, int32_t size, int paint)
{
    const int32_t w = d->seen->w;
    if (paint == EDGE) {
        d->edges[d->count++] = y0 * w + x0;
    }
    for (int32_t y = y0; y < y0 + size; y++) {
        memset(d->kinds + (int64_t)y * w + x0, paint, (size_t)size);
    }
}

/* Divide a square that shows the parallelogram `s`, one pixel of its middle, until each part has one paint or is a pixel. */
static void divide(division *d, int32_t x0, int32_t y0, int32_t size, float u, float v, const spot *s, float pixel, float way)
{
    const float reach = size == 1 ? 1.1f * pixel + way : 1.05f * (float)size * pixel + way;
    const int paint = paint_at(d->pad, u, v, reach);
    if (paint != EDGE || size == 1) {
        set_kind(d, x0, y0, size, paint);
        return;
    }
    const int32_t half = size / 2;
    for (int i = 0; i < 4; i++) {
        const float right = 0.5f * (float)half * (i & 1 ? 1.0f : -1.0f), down = 0.5f * (float)half * (i >> 1 ? 1.0f : -1.0f);
        divide(d, x0 + (i & 1) * half, y0 + (i >> 1) * half, half, u + right * s->right_u + down * s->down_u,
               v + right * s->right_v + down * s->down_v, s, pixel, way);
    }
}

/* The parallelogram of the pixel-sized square in the middle of a square; 0 if the ray does not meet the plane. */
static int middle_of(const division *d, int32_t x0, int32_t y0, int32_t size, spot *s, float *tilt)
{
    const view *v = d->seen;
    const int32_t x = x0 + size / 2, y = y0 + size / 2, pixel = y * v->w + x;
    const float *ray = v->rays + 2 * (int64_t)pixel, *change = change_at(v, pixel), *M = d->whole->middle;
    const float back = size > 1 ? -0.5f : 0.0f;
    float row[9];
    if (d->whole->first) {
        in_row(d->whole, row_time(v, y), row);
        M = row;
    }
    const float rx = ray[0] + back * (change[0] + change[1]), ry = ray[1] + back * (change[2] + change[3]);
    const float depth = M[6] * rx + M[7] * ry + M[8];
    *tilt = (fabsf(M[6] * change[0] + M[7] * change[2]) + fabsf(M[6] * change[1] + M[7] * change[3])) / depth;
    return meet(M, d->whole->turn, rx, ry, change, 1.0f, s);
}

static void divide_from(division *d, int32_t x0, int32_t y0, int32_t size)
{
    spot s = {0};
    float tilt;
    const int whole = x0 + size <= d->seen->w && y0 + size <= d->seen->h;
    if (whole && middle_of(d, x0, y0, size, &s, &tilt) && (size == 1 || tilt * (float)size < TILT_MOST)) {
        divide(d, x0, y0, size, s.u, s.v, &s, around(&s), 0.55f * sqrtf(s.way_u * s.way_u + s.way_v * s.way_v));
    } else if (size == 1) {
        set_kind(d, x0, y0, 1, PAD_NONE);
    } else {
        for (int32_t y = y0; y < y0 + size && y < d->seen->h; y++) {
            for (int32_t x = x0; x < x0 + size && x < d->seen->w; x++) {
                divide_from(d, x, y, 1);
            }
        }
    }
}

int32_t render_pad_kinds(int32_t h, int32_t w, const float *rays, const float *change, int32_t bent, const float *whole,
                         int32_t rolling, const float *pad, uint8_t *kinds, int32_t *edges)
{
    const view seen = {h, w, rays, change, bent};
    const stroke all = stroke_at(whole, rolling, 0);
    division d = {&seen, &all, pad, kinds, edges, 0};
    for (int32_t y = 0; y < h; y += SQUARE) {
        for (int32_t x = 0; x < w; x += SQUARE) {
            divide_from(&d, x, y, SQUARE);
        }
    }
    return d.count;
}

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

/* The share between -half and +half; it is also right for a strip thinner than a subpixel. */
static inline float strip(float x, float half, box b)
{
    return covered(x + half, b) - covered(x - half, b);
}

/* A subpixel seen along the drawing's straight edges: of the H, and of the arrowhead's two sides. */
typedef struct {
    box along_u, along_v, left, right;
} boxes;

/* The boxes of a subpixel that lies with all others of its pixel within `reach` of (u, v): only those that its shares need. */
static boxes boxes_of(const float *pad, float u, float v, const spot *s, float reach)
{
    const float cu = pad[PAD_ARROW_COS], cv = pad[PAD_ARROW_SIN];
    boxes made = {{0.0f, 0.0f}, {0.0f, 0.0f}, {0.0f, 0.0f}, {0.0f, 0.0f}};
    if (fabsf(u) <= pad[PAD_H_HALF_LENGTH] + reach && fabsf(v) <= pad[PAD_H_HALF_WIDTH] + reach) {
        made.along_u = box_along(s, 1.0f, 0.0f);
        made.along_v = box_along(s, 0.0f, 1.0f);
    }
    if (on_arrow(pad, u, v, reach) == EDGE) {
        made.along_u = box_along(s, 1.0f, 0.0f);
        made.left = box_along(s, cu, cv);
        made.right = box_along(s, cu, -cv);
    }
    return made;
}

static float white_share(const float *pad, float u, float v, const boxes *b, float reach)
{
    if (fabsf(u) > pad[PAD_H_HALF_LENGTH] + reach || fabsf(v) > pad[PAD_H_HALF_WIDTH] + reach) {
        return 0.0f;
    }
    const float between = strip(v, pad[PAD_H_INNER], b->along_v);
    const float legs = (strip(v, pad[PAD_H_HALF_WIDTH], b->along_v) - between) * strip(u, pad[PAD_H_HALF_LENGTH], b->along_u);
    return legs + between * strip(u, pad[PAD_BAR_HALF], b->along_u);
}

static float arrow_share(const float *pad, float u, float v, const boxes *b, float reach)
{
    const int kind = on_arrow(pad, u, v, reach);
    if (kind != EDGE) {
        return (float)kind;
    }
    const float cu = pad[PAD_ARROW_COS], cv = pad[PAD_ARROW_SIN];
    const float ahead = cu * (pad[PAD_ARROW_TIP] - u), aside = cv * v;
    return covered(u - pad[PAD_ARROW_BASE], b->along_u) * covered(ahead - aside, b->left) * covered(ahead + aside, b->right);
}

/* Add the shares of the paints in the subpixel at (u, v). */
static void add_shares(const float *pad, float u, float v, const spot *s, const boxes *b, float reach, float *total)
{
    const float r = sqrtf(u * u + v * v) + 1e-9f;
    if (r > pad[PAD_DISC_RADIUS] + reach) {
        total[PAD_NONE] += 1.0f;
        return;
    }
    float inside = 1.0f, inner = 1.0f, ring = 0.0f;
    if (r > pad[PAD_RING_INNER] - reach) {
        const box radial = box_along(s, u / r, v / r);
        inside = covered(pad[PAD_DISC_RADIUS] - r, radial);
        inner = covered(pad[PAD_RIM_INNER] - r, radial);
        ring = covered(pad[PAD_RING_OUTER] - r, radial) - covered(pad[PAD_RING_INNER] - r, radial);
    }
    const float arrow = arrow_share(pad, u, v, b, reach), white = white_share(pad, u, v, b, reach);
    const float orange = ring + arrow - ring * arrow;
    total[PAD_NONE] += 1.0f - inside;
    total[PAD_RIM] += inside - inner;
    total[PAD_DISC] += inner - orange - white;
    total[PAD_ORANGE] += orange;
    total[PAD_WHITE] += white;
}

/* Add the shares of all subpixels of a pixel during one of the parts of the exposure. The plane is linear within a pixel.
 *
 * Most pixels that an edge crosses during a long way see one paint during a part of it. */
static void add_pixel(const view *v, const stroke *k, int parts, int32_t pixel, int fine, const float *pad, float *total)
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
    const boxes b = boxes_of(pad, s.u, s.v, &s, all);
    for (int j = 0; j < fine; j++) {
        for (int i = 0; i < fine; i++) {
            const float right = (float)i - 0.5f * (float)(fine - 1), down = (float)j - 0.5f * (float)(fine - 1);
            const float u_here = s.u + right * s.right_u + down * s.down_u, v_here = s.v + right * s.right_v + down * s.down_v;
            add_shares(pad, u_here, v_here, &s, &b, reach, total);
        }
    }
}

void render_pad_shares(int32_t h, int32_t w, const float *rays, const float *change, int32_t bent, int32_t strokes,
                       const float *stroke_numbers, int32_t rolling, const float *pad, int32_t fine, int32_t count,
                       const int32_t *edges, float *shares)
{
    const view seen = {h, w, rays, change, bent};
    const float each = 1.0f / (float)(strokes * fine * fine);
    for (int32_t e = 0; e < count; e++) {
        float *total = shares + PAD_PAINTS * (int64_t)e;
        memset(total, 0, PAD_PAINTS * sizeof *total);
        for (int i = 0; i < strokes; i++) {
            const stroke k = stroke_at(stroke_numbers, rolling, i);
            add_pixel(&seen, &k, strokes, edges[e], fine, pad, total);
        }
        for (int k = 0; k < PAD_PAINTS; k++) {
            total[k] *= each;
        }
    }
}
