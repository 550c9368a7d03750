/* The motion blur of a scene: shifted copies of it are added up.
 *
 * A pixel is four numbers of sixteen bits, as in light.c. Beyond the frame its last pixels continue.
 */

#include "decklander_sim.h"
#include "base/wide.h"

enum { NUMBERS = 4 };

static inline int32_t limited(int32_t i, int32_t n)
{
    return i < 0 ? 0 : i >= n ? n - 1 : i;
}

static inline uint16_t times(uint16_t a, uint16_t b)
{
    return (uint16_t)((uint32_t)a * b >> 16);
}

static inline uint16_t middle_of(uint16_t a, uint16_t b)
{
    return (uint16_t)(((uint32_t)a + b + 1) >> 1);
}

WIDE
static void add_weighted(int32_t n, const uint16_t *restrict row, uint16_t weight, uint16_t *restrict sum)
{
    for (int32_t i = 0; i < n; i++) {
        sum[i] = (uint16_t)(sum[i] + times(row[i], weight));
    }
}

/* Columns that a shifted row covers without its ends; none, from the last one on, if it is shifted by its length or more. */
typedef struct {
    int32_t from, to;
} inner;

static inner inner_of(int32_t w, int32_t leftmost, int32_t rightmost)
{
    const inner seen = {leftmost < 0 ? -leftmost : 0, rightmost > 0 ? w - rightmost : w}, none = {w, w};
    return seen.from < seen.to ? seen : none;
}

/* Add a row that is shifted by some pixels. */
static void add_shifted(int32_t w, const uint16_t *row, int32_t shift, uint16_t weight, uint16_t *sum)
{
    const inner seen = inner_of(w, shift, shift);
    for (int32_t column = 0; column < seen.from; column++) {
        add_weighted(NUMBERS, row + NUMBERS * limited(column + shift, w), weight, sum + NUMBERS * column);
    }
    for (int32_t column = seen.to; column < w; column++) {
        add_weighted(NUMBERS, row + NUMBERS * limited(column + shift, w), weight, sum + NUMBERS * column);
    }
    if (seen.from < seen.to) {
        add_weighted(NUMBERS * (seen.to - seen.from), row + NUMBERS * (seen.from + shift), weight, sum + NUMBERS * seen.from);
    }
}

void dl_sim_render_smear(int32_t h, int32_t w, const uint16_t *scene, int32_t count, const int32_t *shifts, const uint16_t *weights,
                  uint16_t *smeared)
{
    for (int32_t row = 0; row < h; row++) {
        uint16_t *out = smeared + NUMBERS * (int64_t)row * w;
        for (int32_t i = 0; i < NUMBERS * w; i++) {
            out[i] = (uint16_t)count;
        }
        for (int32_t i = 0; i < count; i++) {
            const uint16_t *from = scene + NUMBERS * (int64_t)w * limited(row + shifts[2 * i + 1], h);
            add_shifted(w, from, shifts[2 * i], weights[i], out);
        }
    }
}

WIDE
static void average(int32_t n, const uint16_t *restrict a, const uint16_t *restrict b, uint16_t *restrict out)
{
    for (int32_t i = 0; i < n; i++) {
        out[i] = middle_of(a[i], b[i]);
    }
}

/* Columns in which a row ends under one of the shifts. */
static void average_ends(int32_t w, int32_t from, int32_t to, const uint16_t *a, const uint16_t *b, const int32_t *shifts,
                         uint16_t *out)
{
    for (int32_t column = from; column < to; column++) {
        average(NUMBERS, a + NUMBERS * limited(column + shifts[0], w), b + NUMBERS * limited(column + shifts[2], w),
                out + NUMBERS * column);
    }
}

void dl_sim_render_average(int32_t h, int32_t w, const uint16_t *scene, const int32_t *shifts, uint16_t *averaged)
{
    const int ordered = shifts[0] < shifts[2];
    const inner seen = inner_of(w, shifts[ordered ? 0 : 2], shifts[ordered ? 2 : 0]);
    for (int32_t row = 0; row < h; row++) {
        const uint16_t *a = scene + NUMBERS * (int64_t)w * limited(row + shifts[1], h);
        const uint16_t *b = scene + NUMBERS * (int64_t)w * limited(row + shifts[3], h);
        uint16_t *out = averaged + NUMBERS * (int64_t)row * w;
        average_ends(w, 0, seen.from, a, b, shifts, out);
        average_ends(w, seen.to, w, a, b, shifts, out);
        if (seen.from < seen.to) {
            average(NUMBERS * (seen.to - seen.from), a + NUMBERS * (seen.from + shifts[0]), b + NUMBERS * (seen.from + shifts[2]),
                    out + NUMBERS * seen.from);
        }
    }
}
