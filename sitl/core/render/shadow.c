/* The shadow of a quadcopter on the pad's plane: four rotors inside guards, and a slim hull.
 *
 * Where rays meet the plane is given for the middles of cells, as in deck.c, in metres along and across the vehicle that
 * casts the shadow. The width of the sun softens its edge. Squares between the middles of cells that the shadow does not reach stay
 * as they are.
 */

#include <math.h>

#include "decklander_sim.h"
#include "base/wide.h"

enum { ROTOR_AT, ROTOR_RADIUS, HALF_LENGTH, HALF_WIDTH, PIXELS = CELL_PX * CELL_PX };

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
static void darken(const float *restrict u, const float *restrict v, const float *shape, float soft, float share,
                   const uint8_t *restrict mask, int16_t *restrict gain)
{
    const float at = shape[ROTOR_AT], radius = shape[ROTOR_RADIUS], per_radius = 0.5f / radius, per_soft = 1.0f / soft;
    const float half_length = shape[HALF_LENGTH], half_width = shape[HALF_WIDTH], part = share / 255.0f;
    for (int32_t i = 0; i < PIXELS; i++) {
        const float a = fabsf(u[i]), b = fabsf(v[i]);
        const float rotor = ((a - at) * (a - at) + (b - at) * (b - at) - radius * radius) * per_radius;
        const float hull = larger(a - half_length, b - half_width);
        const float step = share_of(0.5f - smaller(rotor, hull) * per_soft);
        const float depth = step * step * (3.0f - 2.0f * step) * (float)mask[i];
        gain[i] = (int16_t)((float)gain[i] * (1.0f - part * depth) + 0.5f);
    }
}

/* The corners of a square on the plane: those above, then those below. */
typedef struct {
    float u[4], v[4];
} corners;

static corners corners_at(const float *upper, int32_t columns)
{
    const float *at[4] = {upper, upper + 2, upper + 2 * columns, upper + 2 * columns + 2};
    corners made;
    for (int i = 0; i < 4; i++) {
        made.u[i] = at[i][0];
        made.v[i] = at[i][1];
    }
    return made;
}

/* Where the pixels of a square are, between its corners. */
WIDE
static void between(const float *corner, float *restrict at)
{
    for (int row = 0; row < CELL_PX; row++) {
        const float down = (float)(2 * row + 1) / (float)(2 * CELL_PX);
        const float left = corner[0] + down * (corner[2] - corner[0]), right = corner[1] + down * (corner[3] - corner[1]);
        for (int i = 0; i < CELL_PX; i++) {
            at[CELL_PX * row + i] = left + (float)(2 * i + 1) / (float)(2 * CELL_PX) * (right - left);
        }
    }
}

/* Whether the shadow may reach a square: its middle is no further from rotor or hull than a corner and half of the soft edge. */
static int reached(const corners *k, const float *shape, float soft)
{
    const float u = 0.25f * (k->u[0] + k->u[1] + k->u[2] + k->u[3]), v = 0.25f * (k->v[0] + k->v[1] + k->v[2] + k->v[3]);
    const float a = fabsf(u) - shape[ROTOR_AT], b = fabsf(v) - shape[ROTOR_AT];
    float around2 = 0.0f;
    for (int i = 0; i < 4; i++) {
        around2 = larger(around2, (k->u[i] - u) * (k->u[i] - u) + (k->v[i] - v) * (k->v[i] - v));
    }
    const float reach = 0.5f * soft + sqrtf(around2), rim = shape[ROTOR_RADIUS] + reach;
    return a * a + b * b < rim * rim || (fabsf(u) - shape[HALF_LENGTH] < reach && fabsf(v) - shape[HALF_WIDTH] < reach);
}

/* The columns and rows of a frame that a square which begins at (left, top) lies on. */
typedef struct {
    int32_t w, left, top, x0, x1, y0, y1;
} square;

static square square_at(int32_t h, int32_t w, int32_t left, int32_t top)
{
    const square made = {w, left, top, left > 0 ? left : 0, left + CELL_PX < w ? left + CELL_PX : w,
                         top > 0 ? top : 0, top + CELL_PX < h ? top + CELL_PX : h};
    return made;
}

/* Copy a row of a square, whose width is known as a rule. */
static inline void copy_row(void *to, const void *from, size_t pixels, size_t size)
{
    if (pixels == CELL_PX && size == 1) {
        memcpy(to, from, CELL_PX);
    } else if (pixels == CELL_PX) {
        memcpy(to, from, CELL_PX * sizeof(int16_t));
    } else {
        memcpy(to, from, pixels * size);
    }
}

static void darken_square(const square *q, const corners *k, const float *shape, float soft, float share, const uint8_t *mask,
                          int16_t *gain)
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
        const int32_t to = CELL_PX * (y - q->top) + q->x0 - q->left;
        copy_row(made + to, gain + from, n, sizeof *gain);
        if (mask) {
            copy_row(covered + to, mask + from, n, sizeof *mask);
        }
    }
    darken(u, v, shape, soft, share, covered, made);
    for (int32_t y = q->y0; y < q->y1; y++) {
        copy_row(gain + (int64_t)y * q->w + q->x0, made + CELL_PX * (y - q->top) + q->x0 - q->left, n, sizeof *gain);
    }
}

static void widen(int32_t *bounds, int32_t from, int32_t to)
{
    const int empty = bounds[0] == bounds[1];
    bounds[0] = empty || from < bounds[0] ? from : bounds[0];
    bounds[1] = empty || to > bounds[1] ? to : bounds[1];
}

void render_shadow(int32_t h, int32_t w, const float *cells, int32_t columns, const float *shape, float soft, float share,
                   const uint8_t *mask, int16_t *gain, int32_t *part)
{
    memset(part, 0, 4 * sizeof *part);
    for (int32_t top = -CELL_PX / 2; top < h; top += CELL_PX) {
        const float *row = cells + 2 * (int64_t)columns * ((top + CELL_PX / 2) / CELL_PX);
        for (int32_t left = -CELL_PX / 2; left < w; left += CELL_PX, row += 2) {
            const corners k = corners_at(row, columns);
            if (reached(&k, shape, soft)) {
                const square q = square_at(h, w, left, top);
                darken_square(&q, &k, shape, soft, share, mask, gain);
                widen(part, q.x0, q.x1);
                widen(part + 2, q.y0, q.y1);
            }
        }
    }
}
