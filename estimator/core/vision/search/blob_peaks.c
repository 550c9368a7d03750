/* Find places that differ from their surroundings, at several sizes. */

#include <math.h>
#include <string.h>

#include "base/arena.h"
#include "base/wide.h"
#include "vision/search/best.h"
#include "vision/search/search.h"

/* Cells of two by two pixels, and those that the largest surroundings reach beyond the image. */
enum { CHANNELS = 3, SUMS = CHANNELS + 1, CELL = 2, REACH = 11, ROWS = 6 };
const int BLOB_HALF[BLOB_SIZES] = {4, 6, 10}; /* Half of the surroundings' sides, cells. */
static const float LEAST_PEAK_CONTRAST = 4.0f; /* A contrast too low to use, values of a pixel. */
static const float LEAST_PEAK_SCORE = 1.0f; /* Least score of a peak. */
/* A peak is the best place within this many half sides of its box. */
static const float SAME_PEAK = 0.8f;

/* Sums of the cells in all rows and columns before, of each channel and of the squares of all, with a border of nothing. */
typedef struct {
    int width, height, side, channels;
    const uint32_t *sum[SUMS];
} blob_sums;

/* Of the boxes about each place of a row: one over their pixels and over those around them, their squared difference from what is
 * around them, and the spread of that. */
typedef struct {
    float *each, *by, *differs, *spread;
} row_scores;

static int64_t cells_of(int64_t px)
{
    return px / CELL;
}

static int64_t sums_of(const dl_image *half)
{
    return (cells_of(half->width) + 2 * REACH + 1) * (cells_of(half->height) + 2 * REACH + 1);
}

static int64_t scores_of(const dl_image *half)
{
    return cells_of(half->width) * cells_of(half->height);
}

/* The sums of the cells, the scores of places with the sizes that have them, and rows to work in. */
typedef struct {
    uint32_t *sums;
    float *score, *size, *rows;
} peak_space;

static peak_space divide(const dl_image *half, arena *a)
{
    const int64_t number = sizeof(float);
    peak_space w;
    w.sums = take(a, SUMS * sums_of(half) * number);
    w.score = take(a, scores_of(half) * number);
    w.size = take(a, scores_of(half) * number);
    w.rows = take(a, ROWS * cells_of(half->width) * number);
    return w;
}

int64_t blob_room(const dl_image *half)
{
    arena counted = {NULL, 0};
    divide(half, &counted);
    return arena_numbers(&counted);
}

/* The sums of one row of cells of each channel, and of the squares of all, added to those above. */
static void add_row(const blob_image *image, const uint8_t *px, size_t side, size_t channels, uint32_t *const sums[SUMS])
{
    const int w = (int)cells_of(image->half->width);
    const uint8_t *below = px + image->half->stride;
    uint32_t sum[SUMS] = {0};
    for (int i = 0; i < w; i++, px += CELL * CHANNELS, below += CELL * CHANNELS) {
        for (size_t c = 0; c < channels; c++) {
            const uint32_t one = px[c], two = px[CHANNELS + c], three = below[c], four = below[CHANNELS + c];
            sum[c] += one + two + three + four;
            sum[CHANNELS] += one * one + two * two + three * three + four * four;
            sums[c][side + REACH + 1 + (size_t)i] = sums[c][REACH + 1 + i] + sum[c];
        }
        sums[CHANNELS][side + REACH + 1 + (size_t)i] = sums[CHANNELS][REACH + 1 + i] + sum[CHANNELS];
    }
    for (int k = 0; k < SUMS; k++) {
        memset(sums[k] + side, 0, (REACH + 1) * sizeof **sums);
        for (int i = 0; i < REACH; i++) {
            sums[k][side + REACH + 1 + (size_t)(w + i)] = sums[k][REACH + 1 + w + i] + sum[k];
        }
    }
}

static void integrals(const blob_image *image, const uint8_t *px, uint32_t *scratch, blob_sums *out)
{
    const size_t all = (size_t)sums_of(image->half);
    uint32_t *sums[SUMS];
    out->width = (int)cells_of(image->half->width), out->height = (int)cells_of(image->half->height);
    out->side = out->width + 2 * REACH + 1;
    out->channels = image->grey ? 1 : CHANNELS;
    const size_t side = (size_t)out->side;
    for (int k = 0; k < SUMS; k++) {
        sums[k] = scratch + (size_t)k * all;
        out->sum[k] = sums[k];
        memset(sums[k], 0, (REACH + 1) * side * sizeof *scratch);
        sums[k] += REACH * side;
    }
    for (int row = 0; row < out->height; row++) {
        add_row(image, px + (size_t)row * CELL * (size_t)image->half->stride, side, (size_t)out->channels, sums);
        for (int k = 0; k < SUMS; k++) {
            sums[k] += side;
        }
    }
    for (int k = 0; k < SUMS; k++) {
        for (int row = 0; row < REACH; row++, sums[k] += side) {
            memcpy(sums[k] + side, sums[k], side * sizeof *scratch);
        }
    }
}

/* How many pixels of a box about a place lie within this many cells. */
static float inside(int at, int half, int count)
{
    const int low = at - half > 0 ? at - half : 0, high = at + half < count ? at + half : count;
    return (float)(CELL * (high - low));
}

/* The sums of the boxes about each place of a row; a place is the corner between four cells. */
WIDE
static void box_row(const blob_sums *s, int sum, int row, int half, float *out)
{
    const uint32_t *top = s->sum[sum] + (size_t)(row + REACH - half) * (size_t)s->side + REACH;
    const uint32_t *low = s->sum[sum] + (size_t)(row + REACH + half) * (size_t)s->side + REACH;
    for (int i = 0; i < s->width; i++) {
        out[i] = (float)(int32_t)(low[i + half] - low[i - half] - top[i + half] + top[i - half]);
    }
}

/* Begin the scores of a row with the squares of all channels. */
WIDE
static void begin_row(int n, const float *restrict in, const float *restrict whole, const row_scores *to)
{
    const float *restrict each = to->each, *restrict by = to->by;
    float *restrict differs = to->differs, *restrict spread = to->spread;
    for (int i = 0; i < n; i++) {
        differs[i] = in[i] * each[i];
        spread[i] = (whole[i] - in[i]) * by[i];
    }
}

/* Subtract the mean of the surroundings from a channel. */
WIDE
static void add_channel(int n, const float *restrict in, const float *restrict whole, const row_scores *to)
{
    const float *restrict each = to->each, *restrict by = to->by;
    float *restrict differs = to->differs, *restrict spread = to->spread;
    for (int i = 0; i < n; i++) {
        const float mean = (whole[i] - in[i]) * by[i];
        differs[i] += mean * (mean - 2.0f * each[i] * in[i]);
        spread[i] -= mean * mean;
    }
}

/* Keep the size with the better score. */
WIDE
static void keep_best(int n, float least, int size, const row_scores *of, float *restrict best, float *restrict best_size)
{
    const float *restrict differs = of->differs, *restrict spread = of->spread;
    for (int i = 0; i < n; i++) {
        const float score = differs[i] / ((spread[i] > 0.0f ? spread[i] : 0.0f) + least), better = score > best[i] ? 1.0f : 0.0f;
        best[i] += better * (score - best[i]);
        best_size[i] += better * ((float)size - best_size[i]);
    }
}

/* Whether a place is the best of those within its box: nothing is a peak beside a better one. */
static int is_peak(int w, int rows, const float *score, int row, int column, int reach)
{
    const float here = score[row * w + column];
    const int top = row > reach ? row - reach : 0, low = row + reach < rows ? row + reach : rows - 1;
    const int left = column > reach ? column - reach : 0, right = column + reach < w ? column + reach : w - 1;
    for (int i = top; i <= low; i++) {
        for (int j = left; j <= right; j++) {
            const int before = i < row || (i == row && j < column);
            if (score[i * w + j] > here || (before && score[i * w + j] == here)) {
                return 0;
            }
        }
    }
    return 1;
}

/* Count the pixels of the boxes of a row. */
static void count_row(int w, int h, int row, int half, int wide, const row_scores *to)
{
    const float rows = inside(row, half, h), rows_around = inside(row, wide, h);
    for (int i = 0; i < w; i++) {
        const float count = rows * inside(i, half, w);
        to->each[i] = 1.0f / count;
        to->by[i] = 1.0f / (rows_around * inside(i, wide, w) - count);
    }
}

/* The score of every place, and the size that has it. */
static void rate(const blob_image *image, const blob_sums *sums, float *rows, float *score, float *size)
{
    const int w = sums->width, h = sums->height;
    const float noise = (float)image->noise, least = (float)sums->channels * (LEAST_PEAK_CONTRAST * LEAST_PEAK_CONTRAST + noise * noise);
    float *in = rows, *whole = rows + w;
    const row_scores to = {rows + 2 * w, rows + 3 * w, rows + 4 * w, rows + 5 * w};
    for (int k = 0; k < BLOB_SIZES; k++) {
        const int half = BLOB_HALF[k] / CELL, wide = 2 * half + 1;
        for (int row = 0; row < h; row++) {
            count_row(w, h, row, half, wide, &to);
            for (int sum = CHANNELS; sum >= 0; sum -= sum == CHANNELS ? SUMS - sums->channels : 1) {
                box_row(sums, sum, row, half, in);
                box_row(sums, sum, row, wide, whole);
                if (sum == CHANNELS) {
                    begin_row(w, in, whole, &to);
                } else {
                    add_channel(w, in, whole, &to);
                }
            }
            keep_best(w, least, k, &to, score + row * w, size + row * w);
        }
    }
}

int blob_peaks(const blob_image *image, float *scratch, blob_peak *out)
{
    const int w = (int)cells_of(image->half->width), rows = (int)cells_of(image->half->height);
    arena memory = {scratch, 0};
    const peak_space work = divide(image->half, &memory);
    blob_sums sums;
    int n = 0;
    memset(work.score, 0, (size_t)scores_of(image->half) * sizeof *work.score);
    memset(work.size, 0, (size_t)scores_of(image->half) * sizeof *work.size);
    integrals(image, image->half->px, work.sums, &sums);
    rate(image, &sums, work.rows, work.score, work.size);
    for (int row = 0; row < rows; row++) {
        for (int i = 0; i < w; i++) {
            const float here = work.score[row * w + i];
            const int of = (int)work.size[row * w + i], full = n == (int)image->most;
            const int reach = (int)(SAME_PEAK / CELL * (float)BLOB_HALF[of] + 0.5f);
            if (here > LEAST_PEAK_SCORE && !(full && here <= out[n - 1].score) && is_peak(w, rows, work.score, row, i, reach)) {
                const blob_peak one = {here, CELL * i, CELL * row, of};
                n = insert_best(&one, sizeof one, offsetof(blob_peak, score), n, (int)image->most, out);
            }
        }
    }
    return n;
}
