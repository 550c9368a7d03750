/* The shadow of a quadcopter on the pad's plane: four rotors inside guards, and a slim hull.
 *
 * Where rays meet the plane is given for the middles of cells, as in deck.c, in metres along and across the vehicle that
 * casts the shadow. The width of the sun softens its edge. Squares between the middles of cells that the shadow does not reach stay
 * as they are.
 */

#include <math.h>

#include "decklander_sim.h"
#include "base/wide.h"

enum { PIXELS = DL_CELL_PX * DL_CELL_PX };

/* Without a branch, so that the compiler takes many pixels at once. */
static inline float larger(float a, float b)
{
    return a > b ? a : b;
}

static inline float smaller(float a, float b)
{
    return a < b ? a : b;
}

/* The value limited to 0..1. */
static inline float share_of(float value)
{
    return smaller(larger(value, 0.0f), 1.0f);
}

/* The factors that the shadow leaves in a square whose pixels are at (u, v), below a mask of 0 to 255.
 *
 * The distance to a rotor is that to first order near its rim; a smooth step as wide as `soft` is the edge. */
WIDE
static void darken(const float *restrict u, const float *restrict v, const dl_sim_drone_shade *shade, const uint8_t *restrict mask, int16_t *restrict gain)
{
    const float at = shade->rotor_at_m, radius = shade->rotor_radius_m, per_radius = 0.5f / radius, per_soft = 1.0f / shade->soft_m;
    const float half_length = shade->half_length_m, half_width = shade->half_width_m, part = shade->share / 255.0f;
    for (int32_t i = 0; i < PIXELS; i++) {
        const float a = fabsf(u[i]), b = fabsf(v[i]);
        const float rotor = ((a - at) * (a - at) + (b - at) * (b - at) - radius * radius) * per_radius;
        const float hull = larger(a - half_length, b - half_width);
        const float step = share_of(0.5f - smaller(rotor, hull) * per_soft);
        const float depth = step * step * (3.0f - 2.0f * step) * (float)mask[i];
        gain[i] = (int16_t)((float)gain[i] * (1.0f - part * depth) + 0.5f);
    }
}

/* The square_corners of a square on the plane: those above, then those below. */
typedef struct {
    float u[4], v[4];
} square_corners;

static square_corners corners_at(const float *upper, int32_t columns)
{
    const float *at[4] = {upper, upper + 2, upper + 2 * columns, upper + 2 * columns + 2};
    square_corners made;
    for (int i = 0; i < 4; i++) {
        made.u[i] = at[i][0];
        made.v[i] = at[i][1];
    }
    return made;
}

/* Where the pixels of a square are, between its square_corners. */
WIDE
static void between(const float *corner, float *restrict at)
{
    for (int row = 0; row < DL_CELL_PX; row++) {
        const float down = (float)(2 * row + 1) / (float)(2 * DL_CELL_PX);
        const float left = corner[0] + down * (corner[2] - corner[0]), right = corner[1] + down * (corner[3] - corner[1]);
        for (int i = 0; i < DL_CELL_PX; i++) {
            at[DL_CELL_PX * row + i] = left + (float)(2 * i + 1) / (float)(2 * DL_CELL_PX) * (right - left);
        }
    }
}

/* Whether the shadow may reach a square: its middle is no further from rotor or hull than a corner and half of the soft edge. */
static int reached(const square_corners *k, const dl_sim_drone_shade *shade)
{
    const float u = 0.25f * (k->u[0] + k->u[1] + k->u[2] + k->u[3]), v = 0.25f * (k->v[0] + k->v[1] + k->v[2] + k->v[3]);
    const float a = fabsf(u) - shade->rotor_at_m, b = fabsf(v) - shade->rotor_at_m;
    float around2 = 0.0f;
    for (int i = 0; i < 4; i++) {
        around2 = larger(around2, (k->u[i] - u) * (k->u[i] - u) + (k->v[i] - v) * (k->v[i] - v));
    }
    const float reach = 0.5f * shade->soft_m + sqrtf(around2), rim = shade->rotor_radius_m + reach;
    return a * a + b * b < rim * rim || (fabsf(u) - shade->half_length_m < reach && fabsf(v) - shade->half_width_m < reach);
}

/* The columns and rows of a frame that a square which begins at (left, top) lies on. */
typedef struct {
    int32_t w, left, top, x0, x1, y0, y1;
} square;

static square square_at(int32_t h, int32_t w, int32_t left, int32_t top)
{
    const square made = {w, left, top, left > 0 ? left : 0, left + DL_CELL_PX < w ? left + DL_CELL_PX : w,
                         top > 0 ? top : 0, top + DL_CELL_PX < h ? top + DL_CELL_PX : h};
    return made;
}

/* Copy a row of a square, whose width is known as a rule. */
static inline void copy_row(void *to, const void *from, size_t pixels, size_t size)
{
    if (pixels == DL_CELL_PX && size == 1) {
        memcpy(to, from, DL_CELL_PX);
    } else if (pixels == DL_CELL_PX) {
        memcpy(to, from, DL_CELL_PX * sizeof(int16_t));
    } else {
        memcpy(to, from, pixels * size);
    }
}

static void darken_square(const square *q, const square_corners *k, const dl_sim_drone_shade *shade, const uint8_t *mask, int16_t *gain)
{
    float u[PIXELS], v[PIXELS];
    uint8_t covered[PIXELS];
    int16_t made[PIXELS] = {0};
    const size_t n = (size_t)(q->x1 - q->x0);
    between(k->u, u);
    between(k->v, v);
    memset(covered, UINT8_MAX, sizeof covered);
    for (int32_t y = q->y0; y < q->y1; y++) {
        const int64_t from = (int64_t)y * q->w + q->x0;
        const int32_t to = DL_CELL_PX * (y - q->top) + q->x0 - q->left;
        copy_row(made + to, gain + from, n, sizeof *gain);
        if (mask) {
            copy_row(covered + to, mask + from, n, sizeof *mask);
        }
    }
    darken(u, v, shade, covered, made);
    for (int32_t y = q->y0; y < q->y1; y++) {
        copy_row(gain + (int64_t)y * q->w + q->x0, made + DL_CELL_PX * (y - q->top) + q->x0 - q->left, n, sizeof *gain);
    }
}

static void widen(int32_t *bounds, int32_t from, int32_t to)
{
    const int empty = bounds[0] == bounds[1];
    bounds[0] = empty || from < bounds[0] ? from : bounds[0];
    bounds[1] = empty || to > bounds[1] ? to : bounds[1];
}

void dl_sim_render_shadow(int32_t h, int32_t w, const dl_sim_plane_cells *cells, const dl_sim_drone_shade *shade, const uint8_t *mask, int16_t *gain,
                   int32_t *bounds)
{
    memset(bounds, 0, 4 * sizeof *bounds);
    for (int32_t top = -DL_CELL_PX / 2; top < h; top += DL_CELL_PX) {
        const float *row = cells->at + 2 * (int64_t)cells->columns * ((top + DL_CELL_PX / 2) / DL_CELL_PX);
        for (int32_t left = -DL_CELL_PX / 2; left < w; left += DL_CELL_PX, row += 2) {
            const square_corners k = corners_at(row, cells->columns);
            if (reached(&k, shade)) {
                const square q = square_at(h, w, left, top);
                darken_square(&q, &k, shade, mask, gain);
                widen(bounds, q.x0, q.x1);
                widen(bounds + 2, q.y0, q.y1);
            }
        }
    }
}
