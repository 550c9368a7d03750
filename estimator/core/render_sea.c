/* The surface of the sea, seen through the simulated lens.
 *
 * Water has no sharp edges: its brightness is computed for squares of 2 x 2 pixels and interpolated. Where rays meet calm water is
 * given for the middles of cells of CELL_PX x CELL_PX pixels, with one cell more on each side than the frame has.
 */

#include <math.h>

#include "interface.h"
#include "wide.h"

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

/* The squares of a run of cells in one row, which are computed together. */
enum { RUN_CELLS = 16, RUN = RUN_CELLS * SPAN };

/* Where the plane is met at the ends of a run's cells, m. */
typedef struct {
    double at[RUN_CELLS + 1][2];
} shore;

/* Positions on a tile, in parts of 2^32 of its side, and the texels around them: two in a row, two in the next. */
typedef struct {
    uint32_t x[RUN], y[RUN], texel[RUN];
    float across[RUN], down[RUN], upper[2 * RUN], lower[2 * RUN];
} sampling;

static void walk(const tile *t, const shore *s, int32_t cells, sampling *p)
{
    for (int32_t cell = 0; cell < cells; cell++) {
        const double *a = s->at[cell], *b = s->at[cell + 1];
        const double dx = (b[0] - a[0]) * t->per_m / SPAN, dy = (b[1] - a[1]) * t->per_m / SPAN;
        uint32_t x = wrapped(a[0] * t->per_m + t->shift_x + 0.5 * dx), y = wrapped(a[1] * t->per_m + t->shift_y + 0.5 * dy);
        const uint32_t right = wrapped(dx), down = wrapped(dy);
        for (int k = 0; k < SPAN; k++, x += right, y += down) {
            p->x[SPAN * cell + k] = x;
            p->y[SPAN * cell + k] = y;
        }
    }
}

WIDE
static void locate(int bits, uint32_t stride, sampling *p)
{
    for (int k = 0; k < RUN; k++) {
        p->texel[k] = (p->y[k] >> (32 - bits)) * stride + (p->x[k] >> (32 - bits));
        p->across[k] = (float)(int32_t)(p->x[k] << bits >> 8) * (1.0f / 16777216.0f);
        p->down[k] = (float)(int32_t)(p->y[k] << bits >> 8) * (1.0f / 16777216.0f);
    }
}

WIDE
static void interpolate(const sampling *p, float *restrict values)
{
    for (int k = 0; k < RUN; k++) {
        const float above = p->upper[2 * k] + p->across[k] * (p->upper[2 * k + 1] - p->upper[2 * k]);
        const float below = p->lower[2 * k] + p->across[k] * (p->lower[2 * k + 1] - p->lower[2 * k]);
        values[k] = above + p->down[k] * (below - above);
    }
}

/* The tile's values at the squares of a run; those after its cells are without meaning. */
static void read_tile(const tile *t, const shore *s, int32_t cells, sampling *p, float *values)
{
    walk(t, s, cells, p);
    locate(t->bits, (uint32_t)(t->n + 1), p);
    for (int32_t k = 0; k < SPAN * cells; k++) {
        const float *upper = t->texels + p->texel[k];
        memcpy(p->upper + 2 * k, upper, 2 * sizeof *upper);
        memcpy(p->lower + 2 * k, upper + t->n + 1, 2 * sizeof *upper);
    }
    interpolate(p, values);
}

/* The value limited to 0..most, without a branch. */
static inline float limited(float value, float most)
{
    return 0.5f * (fabsf(value) - fabsf(value - most) + most);
}

/* Where the plane is in a cell's middle, at a height between two rows of cells. */
static inline void place_at(const float *upper, const float *lower, double f, int32_t cell, double *place)
{
    for (int i = 0; i < 2; i++) {
        const double a = upper[2 * cell + i], b = lower[2 * cell + i];
        place[i] = a + f * (b - a);
    }
}

/* The light on a run of squares, and what lies on them: level and contrast, ripples, whitecaps, the ship's shade and foam. */
typedef struct {
    float level[RUN], contrast[RUN], fine[RUN], coarse[RUN], cap[RUN], streak[RUN], shade[RUN], white[RUN];
} surface;

/* Level and contrast for n squares from square x of a row on, from their grid of every second cell. */
static void light_up(const float *slow, int32_t columns, int32_t row, int32_t x, int32_t n, surface *s)
{
    const int32_t stride = 2 * (columns / 2 + 1);
    const float *upper = slow + (2 * row + 5) / 16 * (int64_t)stride, *lower = upper + stride;
    const float f = (float)((2 * row + 5) % 16) * (1.0f / 16.0f);
    for (int32_t k = 0; k < n;) {
        const int32_t j = (2 * (x + k) + 5) / 16, next = 8 * (j + 1) - 2 - x, end = next < n ? next : n;
        float at[4];
        for (int i = 0; i < 4; i++) {
            at[i] = upper[2 * j + i] + f * (lower[2 * j + i] - upper[2 * j + i]);
        }
        for (; k < end; k++) {
            const float along = (float)(2 * (x + k) + 5 - 16 * j) * (1.0f / 16.0f);
            s->level[k] = at[0] + along * (at[2] - at[0]);
            s->contrast[k] = at[1] + along * (at[3] - at[1]);
        }
    }
}

/* Parts of 255 as parts of `most`; nothing where there is no array. */
static void spread(const uint8_t *parts, float most, int32_t n, float *values)
{
    for (int32_t k = 0; k < n; k++) {
        values[k] = parts ? (float)parts[k] * (most / 255.0f) : 0.0f;
    }
}

WIDE
static void add_up(const surface *s, const float *weights, uint8_t *restrict codes)
{
    const float small = weights[SEA_SMALL], large = weights[SEA_LARGE], calm = weights[SEA_CALM], cap = weights[SEA_CAP];
    for (int k = 0; k < RUN; k++) {
        float value = s->level[k] + s->contrast[k] * (small * s->fine[k] + large * s->coarse[k]);
        value += cap * limited((s->cap[k] + 0.5f * s->coarse[k] - calm) * 3.0f, 1.0f);
        value = value * (1.0f - s->shade[k]) + s->white[k] * limited(0.5f * s->streak[k] + 0.35f, 1.0f);
        /* Of a large number `limited` is rounded beyond its limits. */
        const float code = limited(value, 255.0f) + 0.5f;
        codes[k] = (uint8_t)(code > 0.0f ? code < 255.0f ? code : 255.0f : 0.0f);
    }
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

/* What a run is computed from. */
typedef struct {
    tile small, large, caps, streaks;
    const float *cells, *weights, *slow;
    int32_t columns;
} open_sea;

/* The codes of n squares of a row from square x on; the first lies in cell `cell`, and `shade` and `white` begin with it. */
static void paint_run(const open_sea *s, int32_t row, int32_t x, int32_t n, const uint8_t *shade, const uint8_t *white, uint8_t *codes)
{
    const int32_t place = 2 * row + SPAN + 1, cell = (2 * x + SPAN) / CELL_PX, skipped = x - (cell * SPAN - SPAN / 2);
    const int32_t cells = (skipped + n + SPAN - 1) / SPAN;
    const double f = (double)(place % CELL_PX) / CELL_PX;
    const float *upper = s->cells + 2 * (int64_t)s->columns * (place / CELL_PX), *lower = upper + 2 * s->columns;
    shore met;
    sampling p = {0};
    surface seen = {0};
    uint8_t made[RUN];
    for (int32_t k = 0; k <= cells; k++) {
        place_at(upper, lower, f, cell + k, met.at[k]);
    }
    read_tile(&s->small, &met, cells, &p, seen.fine);
    read_tile(&s->large, &met, cells, &p, seen.coarse);
    if (s->weights[SEA_CAP] > 0.0f) {
        read_tile(&s->caps, &met, cells, &p, seen.cap);
    }
    light_up(s->slow, s->columns, row, x - skipped, skipped + n, &seen);
    spread(shade, s->weights[SEA_SHADE], n, seen.shade + skipped);
    spread(white, s->weights[SEA_WHITE], n, seen.white + skipped);
    if (white) {
        read_tile(&s->streaks, &met, cells, &p, seen.streak);
    }
    add_up(&seen, s->weights, made);
    memcpy(codes, made + skipped, (size_t)n);
}

static int any(const uint8_t *values, int32_t n)
{
    for (int32_t k = 0; k < n; k++) {
        if (values[k]) {
            return 1;
        }
    }
    return 0;
}

void render_sea(int32_t h, int32_t w, const uint8_t *mask, int32_t x0, int32_t x1, int32_t y0, int32_t y1, const float *cells,
                int32_t columns, const float *small_texels, const float *large_texels, const float *caps_texels, const float
                *streak_texels, const int32_t *sizes, const double *drift, const float *weights, const float *slow, const
                uint8_t *shade, const uint8_t *white, uint8_t *codes)
{
    const open_sea s = {tile_of(small_texels, sizes[0], drift), tile_of(large_texels, sizes[1], drift + 3),
                   tile_of(caps_texels, sizes[2], drift + 6), tile_of(streak_texels, sizes[3], drift + 9),
                   cells, weights, slow, columns};
    for (int32_t row = y0; row < y1; row++) {
        for (int32_t x = x0; x < x1;) {
            const int64_t i = (int64_t)(row - y0) * (x1 - x0) + x - x0;
            const int32_t end = (x + SPAN / 2) / SPAN * SPAN + SPAN / 2, most = (x + SPAN / 2) / SPAN * SPAN - SPAN / 2 + RUN;
            int32_t n = (end < x1 ? end : x1) - x;
            if (mask && hidden(mask, h, w, row, x, x + n)) {
                x += n;
                continue;
            }
            while (x + n < x1 && x + n < most) {
                const int32_t more = x1 - x - n < SPAN ? x1 - x - n : SPAN;
                if (mask && hidden(mask, h, w, row, x + n, x + n + more)) {
                    break;
                }
                n += more;
            }
            const uint8_t *foam = white && any(white + i, n) ? white + i : 0;
            paint_run(&s, row, x, n, shade ? shade + i : 0, foam, codes + i);
            x += n;
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
