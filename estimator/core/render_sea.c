/* The surface of the sea, seen through the simulated lens.
 *
 * Water has no sharp edges: its brightness is computed for squares of 2 x 2 pixels and interpolated. Where rays meet calm water is
 * given for the middles of cells of CELL_PX x CELL_PX pixels, with one cell more on each side than the frame has.
 */

#include <string.h>

#include "interface.h"

enum { SPAN = CELL_PX / 2 };

/* A periodic texture on the sea: its texels with the first row and column repeated, its frequency and shift. */
typedef struct {
    const float *texels;
    int32_t n;
    int bits;
    double per_m, shift_x, shift_y;
} tile;

static tile tile_of(const float *texels, int32_t n, const double *numbers)
{
    tile made = {texels, n, 0, numbers[0], numbers[1], numbers[2]};
    while (1 << made.bits < n) {
        made.bits++;
    }
    return made;
}

/* A position in periods of the tile as a part of 2^32: it wraps by itself. */
static inline uint32_t wrapped(double periods)
{
    return (uint32_t)(int64_t)(periods * 4294967296.0);
}

/* The positions of a tile along a cell of the plane: the first square's, and from square to square. */
typedef struct {
    uint32_t x, y, dx, dy;
} walk;

static inline walk walk_of(const tile *t, const double *a, const double *b)
{
    const double dx = (b[0] - a[0]) * t->per_m / SPAN, dy = (b[1] - a[1]) * t->per_m / SPAN;
    const walk made = {wrapped(a[0] * t->per_m + t->shift_x + 0.5 * dx), wrapped(a[1] * t->per_m + t->shift_y + 0.5 * dy),
                       wrapped(dx), wrapped(dy)};
    return made;
}

/* The tile's values at the SPAN squares of a walk. */
static void read_tile(const tile *t, const walk *w, float *values)
{
    uint32_t x[SPAN], y[SPAN], at[SPAN];
    float fx[SPAN], fy[SPAN], corner[4][SPAN];
    for (uint32_t k = 0; k < SPAN; k++) {
        x[k] = w->x + k * w->dx;
        y[k] = w->y + k * w->dy;
        at[k] = (y[k] >> (32 - t->bits)) * (uint32_t)(t->n + 1) + (x[k] >> (32 - t->bits));
    }
    for (int k = 0; k < SPAN; k++) {
        fx[k] = (float)(int32_t)(x[k] << t->bits >> 8) * (1.0f / 16777216.0f);
        fy[k] = (float)(int32_t)(y[k] << t->bits >> 8) * (1.0f / 16777216.0f);
    }
    for (int k = 0; k < SPAN; k++) {
        const float *upper = t->texels + at[k], *lower = upper + t->n + 1;
        corner[0][k] = upper[0];
        corner[1][k] = upper[1];
        corner[2][k] = lower[0];
        corner[3][k] = lower[1];
    }
    for (int k = 0; k < SPAN; k++) {
        const float above = corner[0][k] + fx[k] * (corner[1][k] - corner[0][k]);
        const float below = corner[2][k] + fx[k] * (corner[3][k] - corner[2][k]);
        values[k] = above + fy[k] * (below - above);
    }
}

static inline float limited(float value, float most)
{
    return value < 0.0f ? 0.0f : value > most ? most : value;
}

/* Where the plane is in a cell's middle, at a height between two rows of cells. */
static inline void place_at(const float *upper, const float *lower, double f, int32_t cell, double *place)
{
    for (int i = 0; i < 2; i++) {
        const double a = upper[2 * cell + i], b = lower[2 * cell + i];
        place[i] = a + f * (b - a);
    }
}

static int any(const float *values, int32_t n)
{
    for (int32_t k = 0; k < n; k++) {
        if (values[k] > 0.0f) {
            return 1;
        }
    }
    return 0;
}

/* Whether something lies over all of the pixels around the squares `from` to `to` of a row, as far as interpolation reaches. */
static int hidden(const uint8_t *mask, int32_t h, int32_t w, int32_t row, int32_t from, int32_t to)
{
    const int32_t left = 2 * from - 2 > 0 ? 2 * from - 2 : 0, right = 2 * to + 2 < w ? 2 * to + 2 : w;
    const int32_t top = 2 * row - 2 > 0 ? 2 * row - 2 : 0, end = 2 * row + 4 < h ? 2 * row + 4 : h;
    for (int32_t y = top; y < end; y++) {
        for (int32_t x = left; x < right; x++) {
            if (mask[(int64_t)y * w + x] != UINT8_MAX) {
                return 0;
            }
        }
    }
    return 1;
}

void render_sea(int32_t h, int32_t w, const uint8_t *mask, int32_t x0, int32_t x1, int32_t y0, int32_t y1, const float *cells,
                int32_t columns, const float *small_texels, const float *large_texels, const float *caps_texels, const float
                *streak_texels, const int32_t *sizes, const double *drift, const float *weights, const float *slow, const
                float *shade, const float *white, uint8_t *codes)
{
    const tile small = tile_of(small_texels, sizes[0], drift), large = tile_of(large_texels, sizes[1], drift + 3);
    const tile caps = tile_of(caps_texels, sizes[2], drift + 6), streaks = tile_of(streak_texels, sizes[3], drift + 9);
    int64_t i = 0;
    for (int32_t row = y0; row < y1; row++) {
        const int32_t place = 2 * row + SPAN + 1, first = (2 * x0 + SPAN + 1) / CELL_PX;
        const double f = (double)(place % CELL_PX) / CELL_PX;
        const float *upper = cells + 2 * (int64_t)columns * (place / CELL_PX), *lower = upper + 2 * columns;
        double a[2], b[2];
        place_at(upper, lower, f, first, b);
        for (int32_t cell = first, begin = first * SPAN - SPAN / 2; begin < x1; cell++, begin += SPAN) {
            a[0] = b[0];
            a[1] = b[1];
            place_at(upper, lower, f, cell + 1, b);
            const int32_t from = begin < x0 ? x0 : begin, to = begin + SPAN < x1 ? begin + SPAN : x1;
            if (mask && hidden(mask, h, w, row, from, to)) {
                i += to - from;
                continue;
            }
            const walk on_small = walk_of(&small, a, b), on_large = walk_of(&large, a, b);
            float fine[SPAN], coarse[SPAN], cap[SPAN] = {0}, streak[SPAN] = {0};
            read_tile(&small, &on_small, fine);
            read_tile(&large, &on_large, coarse);
            if (weights[3] > 0.0f) {
                const walk on_caps = walk_of(&caps, a, b);
                read_tile(&caps, &on_caps, cap);
            }
            if (white && any(white + i, to - from)) {
                const walk on_streaks = walk_of(&streaks, a, b);
                read_tile(&streaks, &on_streaks, streak);
            }
            for (int32_t k = from - begin; k < to - begin; k++, i++) {
                float value = slow[2 * i] + slow[2 * i + 1] * (weights[0] * fine[k] + weights[1] * coarse[k]);
                value += weights[3] * limited((cap[k] + 0.5f * coarse[k] - weights[2]) * 3.0f, 1.0f);
                value *= shade ? 1.0f - shade[i] : 1.0f;
                value += white ? white[i] * limited(0.5f * streak[k] + 0.35f, 1.0f) : 0.0f;
                codes[i] = (uint8_t)(limited(value, 255.0f) + 0.5f);
            }
        }
    }
}

static inline int32_t nearer(int32_t i, int32_t n)
{
    return i < 0 ? 0 : i >= n ? n - 1 : i;
}

void render_water(int32_t w, int32_t x0, int32_t x1, int32_t y0, int32_t y1, const uint8_t *codes, const uint16_t *colours,
                  uint16_t *scene)
{
    const int32_t columns = (x1 - x0) / 2, rows = (y1 - y0) / 2;
    for (int32_t row = y0; row < y1; row++) {
        const int32_t own = (row - y0) / 2, other = nearer(own + ((row - y0) % 2 ? 1 : -1), rows);
        const uint8_t *near = codes + (int64_t)own * columns, *far = codes + (int64_t)other * columns;
        uint16_t *out = scene + 4 * ((int64_t)row * w + x0);
        int32_t before = 3 * near[0] + far[0], here = before;
        for (int32_t column = 0; column < columns; column++, out += 8) {
            const int32_t next = nearer(column + 1, columns), after = 3 * near[next] + far[next];
            memcpy(out, colours + 4 * ((3 * here + before + 8) >> 4), 8);
            memcpy(out + 4, colours + 4 * ((3 * here + after + 8) >> 4), 8);
            before = here;
            here = after;
        }
    }
}
