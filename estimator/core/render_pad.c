/* Which pixels of a frame show one paint of the pad, and which an edge may touch.
 *
 * The frame is divided into squares, and those that an edge may touch into four, down to single pixels.
 */

#include <string.h>

#include "render_pad.h"

enum { SQUARE = 8 };

/* Up to so much change of the distance across a square, the plane is linear in it to a twentieth of a pixel. */
static const float TILT_MOST = 0.02f;

/* What the division of the frame into squares works on, and what it writes. */
typedef struct {
    const view *seen;
    const stroke *whole;
    const painting *pad;
    uint8_t *kinds;
    int32_t *edges, count;
} division;

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
                         int32_t rolling, int32_t regions, const float *pad, uint8_t *kinds, int32_t *edges)
{
    const view seen = {h, w, rays, change, bent};
    const stroke all = stroke_at(whole, rolling, 0);
    const painting drawn = {regions, pad};
    division d = {&seen, &all, &drawn, kinds, edges, 0};
    for (int32_t y = 0; y < h; y += SQUARE) {
        for (int32_t x = 0; x < w; x += SQUARE) {
            divide_from(&d, x, y, SQUARE);
        }
    }
    return d.count;
}
