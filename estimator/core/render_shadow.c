/* The shadow of a quadcopter on the pad's plane: four rotors inside guards, and a slim hull.
 *
 * Where rays meet the plane is given for the middles of cells, as in render_deck.c, in metres along and across the vehicle that
 * casts the shadow. The width of the sun softens its edge.
 */

#include <math.h>

#include "interface.h"
#include "wide.h"

enum { ROTOR_AT, ROTOR_RADIUS, HALF_LENGTH, HALF_WIDTH, SPAN = 256 };

/* Without a branch, so that the compiler takes many pixels at once. */
static inline float larger(float a, float b)
{
    return 0.5f * (a + b + fabsf(a - b));
}

static inline float smaller(float a, float b)
{
    return 0.5f * (a + b - fabsf(a - b));
}

/* The value limited to 0..1. */
static inline float share_of(float value)
{
    return 0.5f * (fabsf(value) - fabsf(value - 1.0f) + 1.0f);
}

/* Darken a row of pixels at (u, v).
 *
 * The distance to a rotor is that to first order near its rim; a smooth step as wide as `soft` is the edge. */
WIDE
static void darken(int32_t n, const float *restrict u, const float *restrict v, const float *shape, float soft, float share,
                   const uint8_t *restrict mask, int16_t *restrict gain)
{
    const float at = shape[ROTOR_AT], radius = shape[ROTOR_RADIUS], per_radius = 0.5f / radius, per_soft = 1.0f / soft;
    const float half_length = shape[HALF_LENGTH], half_width = shape[HALF_WIDTH], part = share / 255.0f;
    for (int32_t i = 0; i < n; i++) {
        const float a = fabsf(u[i]), b = fabsf(v[i]);
        const float rotor = ((a - at) * (a - at) + (b - at) * (b - at) - radius * radius) * per_radius;
        const float hull = larger(a - half_length, b - half_width);
        const float step = share_of(0.5f - smaller(rotor, hull) * per_soft);
        const float depth = step * step * (3.0f - 2.0f * step) * (float)mask[i];
        gain[i] = (int16_t)((float)gain[i] * (1.0f - part * depth) + 0.5f);
    }
}

/* Where the rays of a strip's pixels meet the plane: from the middle of one cell to that of the `n`th after it, in row `y`. */
static void places(const float *cells, int32_t columns, int32_t column, int32_t n, int32_t y, float *u, float *v)
{
    const float *upper = cells + 2 * ((int64_t)((y + CELL_PX / 2) / CELL_PX) * columns + column), *lower = upper + 2 * columns;
    const float f = (float)(2 * ((y + CELL_PX / 2) % CELL_PX) + 1) / (float)(2 * CELL_PX);
    float ua = upper[0] + f * (lower[0] - upper[0]), va = upper[1] + f * (lower[1] - upper[1]);
    for (int32_t k = 1; k <= n; k++, u += CELL_PX, v += CELL_PX) {
        const float ub = upper[2 * k] + f * (lower[2 * k] - upper[2 * k]);
        const float vb = upper[2 * k + 1] + f * (lower[2 * k + 1] - upper[2 * k + 1]);
        for (int i = 0; i < CELL_PX; i++) {
            const float along = (float)(2 * i + 1) / (float)(2 * CELL_PX);
            u[i] = ua + along * (ub - ua);
            v[i] = va + along * (vb - va);
        }
        ua = ub;
        va = vb;
    }
}

void render_shadow(int32_t w, int32_t x0, int32_t x1, int32_t y0, int32_t y1, const float *cells, int32_t columns,
                   const float *shape, float soft, float share, const uint8_t *mask, int16_t *gain)
{
    float u[SPAN + CELL_PX], v[SPAN + CELL_PX];
    uint8_t whole[SPAN];
    memset(whole, UINT8_MAX, sizeof whole);
    for (int32_t y = y0; y < y1; y++) {
        for (int32_t x = x0; x < x1; x += SPAN) {
            const int32_t n = x1 - x < SPAN ? x1 - x : SPAN, column = (x + CELL_PX / 2) / CELL_PX;
            const int32_t skipped = (x + CELL_PX / 2) % CELL_PX;
            const int64_t at = (int64_t)y * w + x;
            places(cells, columns, column, (skipped + n + CELL_PX - 1) / CELL_PX, y, u, v);
            darken(n, u + skipped, v + skipped, shape, soft, share, mask ? mask + at : whole, gain + at);
        }
    }
}
