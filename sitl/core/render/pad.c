/* Which pixels of a frame show one paint of the pad, and which an edge may touch.
 *
 * The frame is divided into squares, and those that an edge may touch into pixels.
 */

#include "render/pad.h"

enum { SQUARE = DL_CELL_PX };

/* Largest change of the distance across a square for which the plane is linear in it to a twentieth of a pixel. */
static const float TILT_MOST = 0.02f;

/* Inputs and results of the frame's division. */
typedef struct {
    const dl_sim_pad_view *seen;
    const stroke *whole;
    uint8_t *kinds;
    int32_t *edges, count;
    sheaf rays;
} division;

/* Points on the plane, how far around each of them its paint matters, the paint there, or EDGE if there may be several. */
typedef struct {
    float u[TOGETHER], v[TOGETHER], reach[TOGETHER];
    int32_t paint[TOGETHER];
} patch;

/* Put a region's paint over the paint below; near the region's edges both show. */
WIDE
static void put(int32_t paint, const float *restrict depth, patch *p)
{
    for (int k = 0; k < TOGETHER; k++) {
        const int32_t below = p->paint[k], beside = below == paint ? paint : EDGE;
        const int32_t on = depth[k] >= p->reach[k] ? paint : beside;
        p->paint[k] = depth[k] <= -p->reach[k] ? below : on;
    }
}

static void put_region(const float *g, patch *p)
{
    float depth[TOGETHER];
    depths_in(g, p->u, p->v, depth);
    put((int32_t)g[DL_PAD_PAINT], depth, p);
}

static void clear(patch *p)
{
    for (int k = 0; k < TOGETHER; k++) {
        p->paint[k] = DL_PAD_NONE;
    }
}

/* Set the paint of the pixels of a square that lie in the frame, and note those that an edge touches. */
static void set_kinds(division *d, int32_t x0, int32_t y0, const int32_t *paint)
{
    const int32_t w = d->seen->w, right = w - x0, below = d->seen->h - y0;
    const int32_t columns = right < SQUARE ? right : SQUARE, rows = below < SQUARE ? below : SQUARE;
    for (int32_t y = 0; y < rows; y++) {
        const int32_t first = (y0 + y) * w + x0;
        for (int32_t x = 0; x < columns; x++) {
            const int32_t here = paint[SQUARE * y + x];
            d->kinds[first + x] = (uint8_t)here;
            d->edges[d->count] = first + x;
            d->count += here == EDGE;
        }
    }
}

/* Each pixel of a square by its own ray. */
static void divide_exactly(division *d, int32_t x0, int32_t y0)
{
    const int32_t h = d->seen->h, w = d->seen->w;
    int32_t pixels[TOGETHER];
    float radius[TOGETHER], way[TOGETHER];
    spots met;
    patch p;
    for (int32_t k = 0; k < TOGETHER; k++) {
        const int32_t x = x0 + k % SQUARE, y = y0 + k / SQUARE;
        pixels[k] = (y < h ? y : h - 1) * w + (x < w ? x : w - 1);
    }
    gather_rays(d->seen, TOGETHER, pixels, &d->rays);
    gather_changes(d->seen, d->whole, TOGETHER, pixels, &d->rays);
    meet(&d->rays, d->whole->turn, 1.0f, &met);
    sizes_of(&met, radius, way);
    memcpy(p.u, met.u, sizeof p.u);
    memcpy(p.v, met.v, sizeof p.v);
    for (int k = 0; k < TOGETHER; k++) {
        p.reach[k] = 1.1f * radius[k] + 0.55f * way[k];
    }
    clear(&p);
    for (int i = 0; i < d->seen->regions; i++) {
        put_region(region_of(d->seen, i), &p);
    }
    set_kinds(d, x0, y0, p.paint);
}

/* The pixels of a square, between which the plane is linear; `k` is the square's number in the row, `wide` its reach. */
static void divide(division *d, int32_t x0, int32_t y0, const spots *s, int k, float wide, float reach)
{
    patch p;
    for (int i = 0; i < TOGETHER; i++) {
        const float right = (float)(i % SQUARE) - 0.5f * (SQUARE - 1), down = (float)(i / SQUARE) - 0.5f * (SQUARE - 1);
        p.u[i] = s->u[k] + right * s->right_u[k] + down * s->down_u[k];
        p.v[i] = s->v[k] + right * s->right_v[k] + down * s->down_v[k];
        p.reach[i] = reach;
    }
    clear(&p);
    for (int i = 0; i < d->seen->regions; i++) {
        if (depth_in(region_of(d->seen, i), s->u[k], s->v[k]) > -wide) {
            put_region(region_of(d->seen, i), &p);
        }
    }
    set_kinds(d, x0, y0, p.paint);
}

/* How much the distance changes from a pixel to the next, in parts of itself. */
WIDE
static void tilts_of(const sheaf *s, float *restrict tilt)
{
    for (int k = 0; k < TOGETHER; k++) {
        const float right = s->plane[6][k] * s->change[0][k] + s->plane[7][k] * s->change[2][k];
        const float down = s->plane[6][k] * s->change[1][k] + s->plane[7][k] * s->change[3][k];
        const float depth = s->plane[6][k] * s->x[k] + s->plane[7][k] * s->y[k] + s->plane[8][k];
        tilt[k] = depth > 1e-9f ? (fabsf(right) + fabsf(down)) / depth : 1.0f;
    }
}

/* Take the rays of the middles of a row of squares. */
static void gather_middles(division *d, int32_t x0, int32_t y0, int32_t n)
{
    const dl_sim_pad_view *v = d->seen;
    const int32_t columns = (v->w + SQUARE - 1) / SQUARE + 2, y = y0 + SQUARE / 2 < v->h ? y0 + SQUARE / 2 : v->h - 1;
    const float *middle = v->middles + 2 * ((int64_t)columns * (y0 / SQUARE + 1) + x0 / SQUARE + 1);
    int32_t pixels[TOGETHER];
    for (int32_t k = 0; k < TOGETHER; k++) {
        const int32_t here = k < n ? k : n - 1, x = x0 + SQUARE * here + SQUARE / 2;
        pixels[k] = y * v->w + (x < v->w ? x : v->w - 1);
        d->rays.x[k] = middle[2 * here];
        d->rays.y[k] = middle[2 * here + 1];
    }
    gather_changes(v, d->whole, TOGETHER, pixels, &d->rays);
}

/* Divide n squares beside each other, TOGETHER at most. */
static void divide_squares(division *d, int32_t x0, int32_t y0, int32_t n)
{
    float radius[TOGETHER], way[TOGETHER], tilt[TOGETHER];
    spots met;
    patch p;
    gather_middles(d, x0, y0, n);
    meet(&d->rays, d->whole->turn, 1.0f, &met);
    tilts_of(&d->rays, tilt);
    sizes_of(&met, radius, way);
    memcpy(p.u, met.u, sizeof p.u);
    memcpy(p.v, met.v, sizeof p.v);
    for (int k = 0; k < TOGETHER; k++) {
        p.reach[k] = 1.05f * SQUARE * radius[k] + 0.55f * way[k];
    }
    clear(&p);
    for (int i = 0; i < d->seen->regions; i++) {
        put_region(region_of(d->seen, i), &p);
    }
    for (int32_t k = 0; k < n; k++) {
        const int32_t x = x0 + SQUARE * k;
        if (x + SQUARE > d->seen->w || y0 + SQUARE > d->seen->h || !(tilt[k] * SQUARE < TILT_MOST)) {
            divide_exactly(d, x, y0);
        } else if (p.paint[k] == EDGE) {
            divide(d, x, y0, &met, k, p.reach[k], 1.1f * radius[k] + 0.55f * way[k]);
        } else {
            for (int32_t y = y0; y < y0 + SQUARE; y++) {
                memset(d->kinds + (int64_t)y * d->seen->w + x, p.paint[k], SQUARE);
            }
        }
    }
}

/* How far points of the pad are from its centre at most, m. */
static float farthest_of(const dl_sim_pad_view *pad)
{
    float most = 0.0f;
    for (int i = 0; i < pad->regions; i++) {
        most = region_of(pad, i)[DL_PAD_FARTHEST] > most ? region_of(pad, i)[DL_PAD_FARTHEST] : most;
    }
    return most;
}

/* Whether a row of squares cannot show the pad: the line on the plane on which their middles lie passes it by.
 *
 * Lines are straight without distortion, if all rows are exposed at once. The size of a square is largest at one of the ends. */
static int passes_by(division *d, int32_t y0, float farthest)
{
    const dl_sim_pad_view *v = d->seen;
    const int32_t squares = (v->w + SQUARE - 1) / SQUARE;
    const float *first = v->middles + 2 * (int64_t)(squares + 2) * (y0 / SQUARE + 1);
    float radius[TOGETHER], way[TOGETHER];
    spots ends;
    if (v->bent || d->whole->first) {
        return 0;
    }
    for (int i = 0; i < 2; i++) {
        d->rays.x[i] = first[2 * i * (squares + 1)];
        d->rays.y[i] = first[2 * i * (squares + 1) + 1];
    }
    meet(&d->rays, d->whole->turn, 1.0f, &ends);
    sizes_of(&ends, radius, way);
    const float along_u = ends.u[1] - ends.u[0], along_v = ends.v[1] - ends.v[0];
    const float length = sqrtf(along_u * along_u + along_v * along_v);
    const float wide = 2.0f * SQUARE * (radius[0] > radius[1] ? radius[0] : radius[1]) + (way[0] > way[1] ? way[0] : way[1]);
    const int seen = ends.u[0] < FAR_AWAY && ends.u[1] < FAR_AWAY;
    return seen && fabsf(ends.u[0] * along_v - ends.v[0] * along_u) > (farthest + wide) * length;
}

int32_t dl_sim_render_pad_kinds(const dl_sim_pad_view *v, const float *whole, uint8_t *kinds, int32_t *edges)
{
    const int32_t h = v->h, w = v->w;
    const stroke all = stroke_at(whole, v->rolling, 0);
    division d;
    d.seen = v;
    d.whole = &all;
    d.kinds = kinds;
    d.edges = edges;
    d.count = 0;
    begin_rays(v, &all, &d.rays);
    for (int32_t y = 0; y < h; y += SQUARE) {
        const int32_t rows = h - y < SQUARE ? h - y : SQUARE;
        if (passes_by(&d, y, farthest_of(v))) {
            memset(kinds + (int64_t)y * w, DL_PAD_NONE, (size_t)(rows * w));
            continue;
        }
        for (int32_t x = 0; x < w; x += SQUARE * TOGETHER) {
            const int32_t left = (w - x + SQUARE - 1) / SQUARE;
            divide_squares(&d, x, y, left < TOGETHER ? left : TOGETHER);
        }
    }
    return d.count;
}
