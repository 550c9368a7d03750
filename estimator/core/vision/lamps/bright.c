/* Find the bright places of a dark frame. */

#include <math.h>
#include <string.h>

#include "base/arena.h"
#include "vision/lamps/lamps.h"
#include "base/wide.h"

/* Half the window whose mean is a pixel's background, which lamps are smaller than; the rows that it takes; half of the blur. */
enum { CHANNELS = 3, BACKGROUND = 15, WINDOW = 2 * BACKGROUND + 1, RING = 32, BLUR = 3 };
/* A Gaussian of 0.7 px. */
static const float GAUSSIAN[BLUR + 1] = {37346.0f / 65536.0f, 13461.0f / 65536.0f, 630.0f / 65536.0f, 4.0f / 65536.0f};
/* A pixel is bright above a part of the brightest within this many. Rows are compared in segments. */
enum { PEAK = 3, SEGMENT = 32 };
/* Sampling step of rows and columns for the noise. */
enum { NOISE_STEP = 4 };
static const double FULL = 65535.0; /* The largest value of the light. */
static const double LEAST = 0.004; /* Least brightness over the background, linear light. */
static const double NOISES = 7.0; /* The same, in standard deviations of the noise. */
static const double BRIGHTEST = 0.03; /* The same, of the brightest one's: the halo of a lamp near by has faint peaks. */
/* 0.6 */
enum { OF_PEAK = 3, OF_PEAKS = 5 };
/* Median of the absolute value of a standard normal number. */
static const double NORMAL = 0.6745;

/* Working memory. Rows of `over` have margins of zeros that are as wide as a peak reaches, and so has the whole; rows of sums and of
 * the blur have mirrored ones. */
typedef struct {
    int width, height, pitch, segments;
    uint32_t *sums, *twos, *fours, *eights;
    float *down;
    uint16_t *ring, *smooth, *over, *highest, *differences;
    uint8_t *largest;
    bright_run *run;
} bright_space;

static int64_t segments_of(int64_t width)
{
    return (width + SEGMENT - 1) / SEGMENT;
}

static int64_t pitch_of(int64_t width)
{
    return segments_of(width) * SEGMENT + 2 * PEAK;
}

/* Numbers of four bytes in a row of sums, which vectors read beyond its end. */
static int64_t sums_of(int64_t width)
{
    return pitch_of(width) + 2 * BACKGROUND + SEGMENT;
}

static bright_space divide(int64_t width, int64_t height, arena *a)
{
    const int64_t pitch = pitch_of(width), segments = segments_of(width), sums = 4 * sums_of(width), half = sizeof(uint16_t);
    bright_space w = {.width = (int)width, .height = (int)height, .pitch = (int)pitch, .segments = (int)segments};
    w.run = take(a, BRIGHT_RUNS * (int64_t)sizeof *w.run);
    w.sums = take(a, sums), w.twos = take(a, sums), w.fours = take(a, sums), w.eights = take(a, sums);
    w.down = take(a, sums);
    w.ring = take(a, RING * pitch * half);
    w.smooth = take(a, height * pitch * half);
    w.over = take(a, (height + 2 * PEAK + NOISE_STEP) * pitch * half);
    w.highest = take(a, segments * height * half);
    w.differences = take(a, (width / NOISE_STEP + 1) * (height / NOISE_STEP + 1) * half);
    w.largest = take(a, CHANNELS * pitch + SEGMENT);
    return w;
}

int64_t bright_room(int64_t width, int64_t height)
{
    arena counted = {NULL, 0};
    divide(width, height, &counted);
    return arena_numbers(&counted);
}

/* The row or column that lies at a place beyond the edge, mirrored about the outermost one. */
static int mirrored(int at, int n)
{
    while (n > 1 && (at < 0 || at >= n)) {
        at = at < 0 ? -at : 2 * n - 2 - at;
    }
    return n > 1 ? at : 0;
}

/* The largest of each three bytes that follow one another. */
WIDE
static void largest_of_three(int n, const uint8_t *restrict px, uint8_t *restrict out)
{
    for (int i = 0; i < n; i++) {
        const uint8_t two = px[i] > px[i + 1] ? px[i] : px[i + 1];
        out[i] = two > px[i + 2] ? two : px[i + 2];
    }
}

/* The light of the brightest channel of each pixel of a row. */
static uint16_t *light_row(const lit_part *part, const bright_space *w, int row)
{
    uint16_t *out = w->ring + (int64_t)(row % RING) * w->pitch;
    largest_of_three(CHANNELS * w->width - 2, part->px + (int64_t)row * part->stride, w->largest);
    for (int i = 0; i < w->width; i++) {
        out[i] = part->light[w->largest[CHANNELS * i]];
    }
    return out;
}

WIDE
static void add_row(int n, const uint16_t *restrict in, uint32_t *restrict sums)
{
    for (int i = 0; i < n; i++) {
        sums[i] += in[i];
    }
}

WIDE
static void sum_row(int n, const uint16_t *restrict in, uint32_t *restrict sums)
{
    for (int i = 0; i < n; i++) {
        sums[i] -= in[i];
    }
}

WIDE
static void add_shifted(int n, const uint32_t *restrict in, int by, uint32_t *restrict out)
{
    for (int i = 0; i < n; i++) {
        out[i] = in[i] + in[i + by];
    }
}

/* Sums of sixteen columns, and `eights` take their place. */
static void window_sums(const bright_space *w)
{
    const int n = w->width;
    uint32_t *sums = w->sums;
    for (int k = 0; k < BACKGROUND; k++) {
        sums[BACKGROUND - 1 - k] = sums[BACKGROUND + mirrored(-1 - k, n)];
        sums[BACKGROUND + n + k] = sums[BACKGROUND + mirrored(n + k, n)];
    }
    const int all = n + 2 * BACKGROUND;
    add_shifted(all - 1, sums, 1, w->twos);
    add_shifted(all - 3, w->twos, 2, w->fours);
    add_shifted(all - 7, w->fours, 4, w->eights);
}

/* Blur along the columns. */
WIDE
static void blur_down(int n, const uint16_t *const row[2 * BLUR + 1], float *restrict out)
{
    const uint16_t *restrict a = row[0], *restrict b = row[1], *restrict c = row[2], *restrict d = row[3], *restrict e = row[4],
                   *restrict f = row[5], *restrict g = row[6];
    for (int i = 0; i < n; i++) {
        out[i] = GAUSSIAN[0] * (float)d[i] + GAUSSIAN[1] * (float)(c[i] + e[i]) + GAUSSIAN[2] * (float)(b[i] + f[i]) +
                 GAUSSIAN[3] * (float)(a[i] + g[i]);
    }
}

/* Blur along a row, and how far that is over the mean of the window about each pixel. */
WIDE
static void blur_across(int n, const float *restrict in, const uint32_t *restrict sums, const uint32_t *restrict twos,
                        const uint32_t *restrict fours, const uint32_t *restrict eights, uint16_t *restrict smooth,
                        uint16_t *restrict over)
{
    for (int i = 0; i < n; i++) {
        const float *at = in + i;
        const int value = (int)(GAUSSIAN[0] * at[3] + GAUSSIAN[1] * (at[2] + at[4]) + GAUSSIAN[2] * (at[1] + at[5]) +
                                GAUSSIAN[3] * (at[0] + at[6]) + 0.5f);
        const int32_t sum = (int32_t)(eights[i] + eights[i + 8] + eights[i + 16] + fours[i + 24] + twos[i + 28] + sums[i + 30]);
        const int mean = (int)((float)sum * (1.0f / (WINDOW * WINDOW)) + 0.5f);
        smooth[i] = (uint16_t)value;
        over[i] = (uint16_t)(value > mean ? value - mean : 0);
    }
}

WIDE
static void highest_of(int segments, const uint16_t *restrict over, uint16_t *restrict out)
{
    for (int k = 0; k < segments; k++, over += SEGMENT) {
        uint16_t highest = 0;
        for (int i = 0; i < SEGMENT; i++) {
            highest = over[i] > highest ? over[i] : highest;
        }
        out[k] = highest;
    }
}

/* Begin the sums of the columns with the window about the first row. */
static void first_window(const lit_part *part, const bright_space *w)
{
    for (int row = 0; row <= BACKGROUND && row < w->height; row++) {
        light_row(part, w, row);
    }
    for (int k = -BACKGROUND; k <= BACKGROUND; k++) {
        add_row(w->width, w->ring + (int64_t)(mirrored(k, w->height) % RING) * w->pitch, w->sums + BACKGROUND);
    }
}

/* Move the window from a row to the next one. */
static void next_window(const lit_part *part, const bright_space *w, int row)
{
    const int ahead = row + BACKGROUND + 1;
    if (ahead < w->height) {
        light_row(part, w, ahead);
    }
    add_row(w->width, w->ring + (int64_t)(mirrored(ahead, w->height) % RING) * w->pitch, w->sums + BACKGROUND);
    sum_row(w->width, w->ring + (int64_t)(mirrored(row - BACKGROUND, w->height) % RING) * w->pitch, w->sums + BACKGROUND);
}

static void blur_row(const bright_space *w, int row)
{
    const uint16_t *rows[2 * BLUR + 1];
    const int n = w->width;
    float *down = w->down;
    for (int k = 0; k < 2 * BLUR + 1; k++) {
        rows[k] = w->ring + (int64_t)(mirrored(row + k - BLUR, w->height) % RING) * w->pitch;
    }
    blur_down(n, rows, down + BLUR);
    for (int k = 0; k < BLUR; k++) {
        down[BLUR - 1 - k] = down[BLUR + mirrored(-1 - k, n)];
        down[BLUR + n + k] = down[BLUR + mirrored(n + k, n)];
    }
}

/* Smooth a part's light and take its background off; returns the number of differences for the noise. */
static int brighten(const lit_part *part, const bright_space *w)
{
    int n = 0;
    memset(w->over, 0, (size_t)PEAK * (size_t)w->pitch * sizeof *w->over);
    memset(w->over + (int64_t)(PEAK + w->height) * w->pitch, 0, (size_t)PEAK * (size_t)w->pitch * sizeof *w->over);
    first_window(part, w);
    for (int row = 0; row < w->height; row++) {
        uint16_t *smooth = w->smooth + (int64_t)row * w->pitch, *over = w->over + (int64_t)(row + PEAK) * w->pitch;
        window_sums(w);
        blur_row(w, row);
        memset(over, 0, PEAK * sizeof *over);
        memset(over + PEAK + w->width, 0, (size_t)(w->pitch - PEAK - w->width) * sizeof *over);
        blur_across(w->width, w->down, w->sums, w->twos, w->fours, w->eights, smooth, over + PEAK);
        highest_of(w->segments, over + PEAK, w->highest + (int64_t)row * w->segments);
        for (int i = NOISE_STEP; row % NOISE_STEP == 0 && i < w->width; i += NOISE_STEP) {
            const int step = smooth[i] - smooth[i - NOISE_STEP];
            w->differences[n++] = (uint16_t)(step < 0 ? -step : step);
        }
        if (row + 1 < w->height) {
            next_window(part, w, row);
        }
    }
    return n;
}

/* The k-th smallest of some numbers: by their upper bytes, and those alike by the lower ones. */
static int order_statistic(int n, const uint16_t *values, int k)
{
    int counts[256] = {0}, high = 0, low = 0;
    for (int i = 0; i < n; i++) {
        counts[values[i] >> 8]++;
    }
    for (; high < 255 && k >= counts[high]; high++) {
        k -= counts[high];
    }
    memset(counts, 0, sizeof counts);
    for (int i = 0; i < n; i++) {
        counts[values[i] & 255] += values[i] >> 8 == high;
    }
    for (; low < 255 && k >= counts[low]; low++) {
        k -= counts[low];
    }
    return high << 8 | low;
}

/* Standard deviation of the smoothed light from pixel to pixel. */
static double noise_of(int n, const uint16_t *differences)
{
    if (n == 0) {
        return 0.0;
    }
    return 0.5 * (order_statistic(n, differences, n / 2) + order_statistic(n, differences, (n - 1) / 2)) / (NORMAL * sqrt(2.0));
}

static double least_of(const bright_space *w, double noise)
{
    int highest = 0;
    for (int64_t k = 0; k < (int64_t)w->segments * w->height; k++) {
        highest = w->highest[k] > highest ? w->highest[k] : highest;
    }
    return fmax(fmax(LEAST * FULL, NOISES * noise), BRIGHTEST * highest);
}

/* Which pixels of a segment are bright: above the least, and above a part of the brightest about them. */
WIDE
static void mark_segment(const uint16_t *over, int pitch, int least, uint8_t *restrict out)
{
    uint16_t peak[SEGMENT + 2 * PEAK];
    const uint16_t *row = over - PEAK - PEAK * pitch, *here = over;
    memcpy(peak, row, sizeof peak);
    for (int k = 0; k < 2 * PEAK; k++) {
        row += pitch;
        for (int i = 0; i < SEGMENT + 2 * PEAK; i++) {
            peak[i] = row[i] > peak[i] ? row[i] : peak[i];
        }
    }
    for (int i = 0; i < SEGMENT; i++) {
        uint16_t most = peak[i];
        for (int k = 1; k <= 2 * PEAK; k++) {
            most = peak[i + k] > most ? peak[i + k] : most;
        }
        const int least_here = (OF_PEAK * most + OF_PEAKS / 2) / OF_PEAKS;
        out[i] = here[i] > least_here && here[i] > least;
    }
}

/* Add the pieces of a row that a segment's bright pixels make or lengthen; 0 if there is no room for them. */
static int add_runs(const uint8_t *bright, int row, int from, int *n, bright_run *run)
{
    for (int i = 0; i < SEGMENT; i++) {
        if (!bright[i]) {
            continue;
        }
        if (*n > 0 && run[*n - 1].row == row && run[*n - 1].last == from + i - 1) {
            run[*n - 1].last++;
        } else if (*n == BRIGHT_RUNS) {
            return 0;
        } else {
            const bright_run one = {row, from + i, from + i, *n};
            run[(*n)++] = one;
        }
    }
    return 1;
}

int bright_places(const lit_part *part, uint32_t *scratch, bright_part *out)
{
    uint8_t bright[SEGMENT];
    arena memory = {scratch, 0};
    bright_space w = divide(part->width, part->height, &memory);
    memset(w.sums, 0, (size_t)((char *)w.ring - (char *)w.sums));
    const int differences = brighten(part, &w);
    out->width = w.width, out->height = w.height, out->pitch = w.pitch, out->runs = 0;
    out->noise = noise_of(differences, w.differences);
    out->smooth = w.smooth, out->run = w.run;
    const int least = (int)lrint(least_of(&w, out->noise));
    for (int row = 0; row < w.height; row++) {
        for (int k = 0; k < w.segments; k++) {
            if (w.highest[(int64_t)row * w.segments + k] <= least) {
                continue;
            }
            mark_segment(w.over + (int64_t)(row + PEAK) * w.pitch + PEAK + k * SEGMENT, w.pitch, least, bright);
            if (!add_runs(bright, row, k * SEGMENT, &out->runs, w.run)) {
                return 0;
            }
        }
    }
    return 1;
}
