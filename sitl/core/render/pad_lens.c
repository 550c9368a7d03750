/* What the blur of the lens makes of the pad's edges, beyond what a blur of pixels makes of them.
 *
 * A lens blurs light before pixels sample it. Blurring what pixels have sampled leaves their aliasing in the frame, which moves all
 * edges of a frame together. Near edges of the pad, whose coverage is known for parts of pixels, both blurs are computed: of the
 * parts, by a kernel as fine as they are, and of the pixels, by the kernel of the lens on pixels. Their difference is added to the
 * blurred frame, where it is the light of the paints. It is zero in places that show one paint as far as the blur reaches.
 */

#include <math.h>

#include "render/light.h"
#include "base/wide.h"

enum { BLOCK = DL_LENS_BLOCK };

/* A coverage whose light is less than half a count of full scale. */
static const float NONE = 5e-5f;
/* The most light that is added or taken, counts. */
static const float COUNTS_MOST = 32767.0f;

/* Part of a frame around the pad; the number of each of its pixels among the edges, -1 for those that show one paint; how far the
 * blur reaches, px, and its kernels for parts and for pixels.
 *
 * A row is as long as its blocks are. */
typedef struct {
    int32_t x0, y0, columns, rows, w, blocks, wide, fine, reach;
    const dl_sim_lit_scene *seen;
    const float *exact, *sampled;
    int32_t *numbers, *busy;
} window;

/* A row of a paint's coverage, by parts of pixels and then whole, with its ends repeated as far as the blur reaches; all rows
 * blurred along themselves, of parts and of pixels. */
typedef struct {
    float *row, *parts, *pixels;
} space;

static inline int32_t limited_to(int32_t i, int32_t n)
{
    return i < 0 ? 0 : i < n ? i : n - 1;
}

static void number_pixels(const window *v)
{
    const int32_t *where = v->seen->where;
    for (int32_t i = 0; i < v->wide * v->rows; i++) {
        v->numbers[i] = -1;
    }
    for (int32_t e = 0; e < v->seen->edges; e++) {
        v->numbers[v->wide * (where[e] / v->w - v->y0) + where[e] % v->w - v->x0] = e;
    }
}

/* Note the blocks of columns that the blur of a paint's edges reaches in each row; whether there are any. */
static int find_edges(const window *v, int paint)
{
    const int32_t *where = v->seen->where;
    int any = 0;
    memset(v->busy, 0, (size_t)(v->blocks * v->rows) * sizeof *v->busy);
    for (int32_t e = 0; e < v->seen->edges; e++) {
        const int32_t x = where[e] % v->w - v->x0, y = where[e] / v->w - v->y0;
        if (v->seen->shares[DL_PAD_PAINTS * (int64_t)e + paint] != 0.0f) {
            any = v->busy[v->blocks * y + limited_to(x - v->reach, v->columns) / BLOCK] = 1;
            v->busy[v->blocks * y + limited_to(x + v->reach, v->columns) / BLOCK] = 1;
        }
    }
    return any;
}

/* Whether the lens blurs an edge into a block of a row: one lies in the same block within the blur's reach up or down. */
static int reached(const window *v, int32_t y, int32_t block)
{
    int any = 0;
    for (int32_t i = limited_to(y - v->reach, v->rows); i <= limited_to(y + v->reach, v->rows); i++) {
        any |= v->busy[v->blocks * i + block];
    }
    return any;
}

WIDE
static void mark_paint(int32_t n, const uint8_t *restrict kinds, int paint, float *restrict row)
{
    for (int32_t x = 0; x < n; x++) {
        row[x] = kinds[x] == paint ? 1.0f : 0.0f;
    }
}

static void repeat_ends(const window *v, float *row)
{
    for (int32_t x = 0; x < v->reach; x++) {
        row[x] = row[v->reach];
    }
    for (int32_t x = v->reach + v->columns; x < v->wide + 2 * v->reach; x++) {
        row[x] = row[v->reach + v->columns - 1];
    }
}

/* The coverage of a row of parts by a paint, (fine + 1, wide + 2 reach): of the parts of pixels, and their means. */
static void cover_row(const window *v, int paint, int32_t y, int32_t down, float *row)
{
    const int32_t length = v->wide + 2 * v->reach, all = v->fine * v->fine;
    const int32_t *numbers = v->numbers + v->wide * y;
    float *mean = row + length * v->fine + v->reach;
    mark_paint(v->columns, v->seen->kinds + (int64_t)(v->y0 + y) * v->w + v->x0, paint, mean);
    for (int32_t s = 0; s < v->fine; s++) {
        memcpy(row + length * s + v->reach, mean, (size_t)v->columns * sizeof *row);
    }
    for (int32_t x = 0; x < v->columns; x++) {
        if (numbers[x] >= 0) {
            const float *parts = v->seen->parts + (DL_PAD_PAINTS * (int64_t)numbers[x] + paint) * all + v->fine * down;
            float sum = 0.0f;
            for (int32_t s = 0; s < v->fine; s++) {
                row[length * s + v->reach + x] = parts[s];
                sum += parts[s];
            }
            mean[x] = sum / (float)v->fine;
        }
    }
    for (int32_t s = 0; s <= v->fine; s++) {
        repeat_ends(v, row + length * s);
    }
}

/* sum[x] += weights[i] values[i step + x], of n weights, for a block. */
WIDE
static void add_weighted(int32_t n, const float *restrict weights, const float *restrict values, int64_t step, float *restrict sum)
{
    float kept[BLOCK];
    memcpy(kept, sum, sizeof kept);
    for (int32_t i = 0; i < n; i++) {
        for (int32_t x = 0; x < BLOCK; x++) {
            kept[x] += weights[i] * values[i * step + x];
        }
    }
    memcpy(sum, kept, sizeof kept);
}

/* A block of a row blurred along itself, and its share of the pixels'. `row` begins as far before the block as the blur reaches. */
static void blur_block(const window *v, const float *row, float *parts, float *pixels)
{
    const int32_t length = v->wide + 2 * v->reach, taps = 2 * v->reach + 1;
    memset(parts, 0, BLOCK * sizeof *parts);
    for (int32_t s = 0; s < v->fine; s++) {
        add_weighted(taps, v->exact + taps * s, row + length * s, 1, parts);
    }
    add_weighted(taps, v->sampled, row + length * v->fine, 1, pixels);
}

/* All rows of a paint's coverage blurred along themselves. Blocks that no edge is near show the same in all columns. */
static void blur_rows(const window *v, int paint, const space *s)
{
    memset(s->pixels, 0, (size_t)(v->wide * v->rows) * sizeof *s->pixels);
    for (int32_t y = 0; y < v->rows; y++) {
        float *pixels = s->pixels + v->wide * y;
        for (int32_t down = 0; down < v->fine; down++) {
            float *parts = s->parts + v->wide * (v->rows * down + y);
            cover_row(v, paint, y, down, s->row);
            for (int32_t block = 0, x = 0; block < v->blocks; block++, x += BLOCK) {
                if (v->busy[v->blocks * y + block]) {
                    blur_block(v, s->row + x, parts + x, pixels + x);
                    continue;
                }
                for (int32_t i = x; i < x + BLOCK; i++) {
                    parts[i] = s->row[v->reach + i];
                    pixels[i] += parts[i] / (float)v->fine;
                }
            }
        }
    }
}

/* A block of one row of the difference between both blurs; rows outside the window are like its first and last one. */
static void blur_down(const window *v, int32_t y, int32_t x, const space *s, float *difference)
{
    const int32_t taps = 2 * v->reach + 1, first = y - v->reach;
    const int32_t above = first < 0 ? -first : 0, below = first + taps > v->rows ? first + taps - v->rows : 0;
    const int32_t inside = taps - above - below;
    memset(difference, 0, BLOCK * sizeof *difference);
    for (int32_t plane = 0; plane <= v->fine; plane++) {
        const float *values = plane < v->fine ? s->parts + v->wide * v->rows * plane + x : s->pixels + x;
        const float *weights = plane < v->fine ? v->exact + taps * plane : v->sampled + taps;
        add_weighted(above, weights, values, 0, difference);
        add_weighted(inside, weights + above, values + v->wide * (first + above), v->wide, difference);
        add_weighted(below, weights + above + inside, values + v->wide * (v->rows - 1), 0, difference);
    }
}

static inline int16_t rounded(float counts)
{
    const float limited = fmaxf(-COUNTS_MOST, fminf(counts, COUNTS_MOST));
    return (int16_t)(limited + (limited < 0.0f ? -0.5f : 0.5f));
}

/* Add the light of some pixels in which a paint covers more than by the blur of pixels, in place of the pad's surroundings. */
static void add_light(const window *v, int paint, int32_t y, int32_t x, const float *difference, const exposure16 *e,
                      int16_t *added)
{
    const dl_sim_lit_scene *seen = v->seen;
    const int32_t n = v->columns - x < BLOCK ? v->columns - x : BLOCK;
    const int64_t first = (int64_t)(v->y0 + y) * v->w + v->x0 + x;
    for (int32_t i = 0; i < n; i++) {
        const uint16_t *scene = seen->scene + 4 * (first + i);
        const float gain = (float)seen->gain[first + i];
        if (fabsf(difference[i]) < NONE) {
            continue;
        }
        for (int c = 0; c < CHANNELS; c++) {
            int16_t *here = added + (CHANNELS * (int64_t)y + c) * v->columns + x + i;
            const float around = seen->exposure[c] * (float)scene[c] * gain * (1.0f / DL_GAIN_ONE);
            const float own = e->paint_light[paint][c] * (float)scene[3] * gain;
            const float most = (float)LIGHT_MOST;
            const float more = (own < most ? own : most) - (around < most ? around : most);
            *here = (int16_t)(*here + rounded(difference[i] * more));
        }
    }
}

bool dl_sim_render_pad_lens(const dl_sim_lit_scene *seen, const int32_t *place, const dl_sim_lens_kernels *k, int16_t *added)
{
    const int32_t columns = place[DL_LENS_COLUMNS], rows = place[DL_LENS_ROWS], blocks = (columns + BLOCK - 1) / BLOCK;
    const int32_t wide = BLOCK * blocks, fine = seen->fine, row = (fine + 1) * (wide + 2 * k->reach);
    const window v = {place[DL_LENS_X], place[DL_LENS_Y], columns, rows, seen->w, blocks, wide, fine, k->reach, seen,
                      k->exact, k->sampled, k->places, k->places + wide * rows};
    const exposure16 e = exposure_of(seen);
    float difference[BLOCK];
    space s;
    if (k->floats < row + (fine + 1) * wide * rows || k->numbers < (wide + blocks) * rows) {
        return false;
    }
    s.row = k->room;
    s.pixels = s.row + row;
    s.parts = s.pixels + wide * rows;
    memset(added, 0, (size_t)CHANNELS * (size_t)(columns * rows) * sizeof *added);
    number_pixels(&v);
    for (int paint = DL_PAD_NONE + 1; paint < DL_PAD_PAINTS; paint++) {
        if (!find_edges(&v, paint)) {
            continue;
        }
        blur_rows(&v, paint, &s);
        for (int32_t y = 0; y < rows; y++) {
            for (int32_t block = 0, x = 0; block < blocks; block++, x += BLOCK) {
                if (reached(&v, y, block)) {
                    blur_down(&v, y, x, &s, difference);
                    add_light(&v, paint, y, x, difference, &e, added);
                }
            }
        }
    }
    return true;
}
