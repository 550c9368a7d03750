/* Trace the outline of a blob and fit its area's ellipse. */

#include <math.h>
#include <string.h>

#include "vision/search/search.h"

enum { CHANNELS = 3, SIDE_MAX = 60, AREA_MAX = SIDE_MAX * SIDE_MAX, SHADES = 256, BINS = 64, LARGE = 6, TRIES = 2, FEWEST = 12 };
/* Histograms that count by turns, and places of a row in the queue. */
enum { TURNS = 4, QUEUED = 64 };
static const double PER_DEVIATION = 1.4826; /* Standard deviations of a normal distribution in its median absolute deviation. */
static const double STEPS = 2.0; /* What a camera's steps and noise add. */
/* Noise of the half-size image above which pixels are smoothed twice, values of a pixel. */
static const double NOISY = 2.5;
/* Deviations at which a pixel differs from its surroundings, of those of a tenth of the pixels in the box. */
static const double DIFFERS[TRIES] = {0.35, 0.6};
static const double LEAST_DIFFERS = 2.0; /* The same at least. */
static const double UPPER = 0.9; /* Share of the pixels below that tenth. */
/* The outline is where this fraction of the component's mean difference is left. */
static const double EDGE = 0.5;
/* Least fraction of the area that the ellipse of the same moments has. */
static const double LEAST_OUTLINE_FILLED = 0.8;

/* What a pixel of the window is. */
enum { NOTHING, DIFFERENT, SEEN, CHOSEN, OUTSIDE };

/* A square about a peak: its pixels less their surroundings, their sizes in deviations, and marks. */
typedef struct {
    int side_x, side_y, left, top, step;
    float px[CHANNELS][AREA_MAX], off[AREA_MAX];
    uint8_t label[AREA_MAX], inside[AREA_MAX];
    /* Columns and QUEUED times the rows. */
    int16_t queue[AREA_MAX];
} blob_window;

/* One channel of an image from a corner on, its outermost pixels repeated. */
static void load(const dl_image *of, int channel, int left, int top, int side_x, int side_y, float *out)
{
    const int w = (int)of->width, h = (int)of->height, from = left < 0 ? -left : 0, to = left + side_x > w ? w - left : side_x;
    for (int i = 0; i < side_y; i++, out += side_x) {
        const int y = top + i, row = y < 0 ? 0 : y < h ? y : h - 1;
        const uint8_t *at = of->px + (size_t)row * (size_t)of->stride + CHANNELS * (left + from) + channel;
        for (int j = from; j < to; j++, at += CHANNELS) {
            out[j] = (float)*at;
        }
        for (int j = 0; j < from; j++) {
            out[j] = out[from];
        }
        for (int j = to; j < side_x; j++) {
            out[j] = out[to - 1];
        }
    }
}

/* Every pixel but the outermost ones as a mean of those around it, weighted by binomial coefficients. */
static void smooth(int side_x, int side_y, const float *in, float *out)
{
    for (int i = 1; i < side_y - 1; i++) {
        const float *here = in + i * side_x, *above = here - side_x, *below = here + side_x;
        float column[SIDE_MAX], *to = out + (i - 1) * (side_x - 2);
        for (int j = 0; j < side_x; j++) {
            column[j] = 0.25f * (above[j] + 2.0f * here[j] + below[j]);
        }
        for (int j = 1; j < side_x - 1; j++) {
            to[j - 1] = 0.25f * (column[j - 1] + 2.0f * column[j] + column[j + 1]);
        }
    }
}

/* Counts of shades, by turns: pixels side by side have the same, and no count waits for the one before. */
typedef struct {
    int32_t of[TURNS][SHADES];
} shade_counts;

/* The shade below which half of the counted pixels are. */
static double median(const shade_counts *counts, int all)
{
    int32_t count[SHADES];
    int below = 0, k = 0;
    for (int shade = 0; shade < SHADES; shade++) {
        count[shade] = counts->of[0][shade] + counts->of[1][shade] + counts->of[2][shade] + counts->of[3][shade];
    }
    while (k < SHADES - 1 && 2 * (below + count[k]) < all) {
        below += count[k++];
    }
    return k + (count[k] > 0 ? (0.5 * all - below) / count[k] : 0.0) - 0.5;
}

/* Subtract the median of the box's surroundings from one channel, and add the deviations squared. */
static void add_deviations(blob_window *o, int channel, float share)
{
    const int area = o->side_x * o->side_y;
    float *px = o->px[channel];
    shade_counts counts;
    int around = 0;
    memset(&counts, 0, sizeof counts);
    for (int k = 0; k < area; k++) {
        if (!o->inside[k]) {
            counts.of[k % TURNS][(int)(px[k] + 0.5f)]++;
            around++;
        }
    }
    const float mean = (float)median(&counts, around);
    memset(&counts, 0, sizeof counts);
    for (int k = 0; k < area; k++) {
        px[k] -= mean;
        if (!o->inside[k]) {
            const int size = (int)(fabsf(px[k]) + 0.5f);
            counts.of[k % TURNS][size < SHADES ? size : SHADES - 1]++;
        }
    }
    const float by = (float)(1.0 / (PER_DEVIATION * fmax(0.0, median(&counts, around)) + STEPS));
    for (int k = 0; k < area; k++) {
        o->off[k] += share * (px[k] * by) * (px[k] * by);
    }
}

/* Place the window about a peak, in the half-size image if it is large there; returns whether its box lies in the image. */
static int place(const blob_peak *peak, int w, int h, blob_window *o)
{
    const int size = BLOB_HALF[peak->size], per = size >= LARGE ? 1 : 2, half = per * size, reach = 2 * half + 2;
    const int x = per * peak->x, y = per * peak->y;
    o->step = per == 1 ? 2 : 1;
    o->left = x > reach ? x - reach : 0, o->top = y > reach ? y - reach : 0;
    o->side_x = (x + reach < w ? x + reach : w) - o->left;
    o->side_y = (y + reach < h ? y + reach : h) - o->top;
    uint8_t *inside = o->inside;
    for (int dy = o->top - y; dy < o->top - y + o->side_y; dy++) {
        for (int dx = o->left - x; dx < o->left - x + o->side_x; dx++) {
            *inside++ = dx < half && dx >= -half && dy < half && dy >= -half;
        }
    }
    return x >= half && y >= half && x + half <= w && y + half <= h && o->side_x > 2 * half && o->side_y > 2 * half;
}

/* Fill the window about a peak. */
static int cut(const blob_image *image, const blob_peak *peak, blob_window *o)
{
    const int large = BLOB_HALF[peak->size] >= LARGE, channels = image->grey ? 1 : CHANNELS;
    const dl_image *of = large ? image->half : image->full;
    const int times = image->noise > NOISY ? 2 : 1;
    float raw[AREA_MAX], once[AREA_MAX];
    if (!place(peak, (int)of->width, (int)of->height, o)) {
        return 0;
    }
    memset(o->off, 0, sizeof o->off);
    for (int c = 0; c < channels; c++) {
        const int side_x = o->side_x + 2 * times, side_y = o->side_y + 2 * times;
        load(of, c, o->left - times, o->top - times, side_x, side_y, raw);
        smooth(side_x, side_y, raw, times == 1 ? o->px[c] : once);
        if (times == 2) {
            smooth(side_x - 2, side_y - 2, once, o->px[c]);
        }
        add_deviations(o, c, 1.0f / (float)channels);
    }
    for (int k = 0; k < o->side_x * o->side_y; k++) {
        o->off[k] = sqrtf(o->off[k]);
    }
    return 1;
}

/* What a tenth of the pixels in the box exceed. */
static double upper(const blob_window *o)
{
    int32_t count[BINS];
    float most = 0.0f;
    int all = 0, above = 0, bin = BINS;
    memset(count, 0, sizeof count);
    for (int k = 0; k < o->side_x * o->side_y; k++) {
        most = o->inside[k] && o->off[k] > most ? o->off[k] : most;
    }
    const float by = most > 0.0f ? (float)BINS / most : 0.0f;
    for (int k = 0; k < o->side_x * o->side_y; k++) {
        if (o->inside[k]) {
            const int at = (int)(o->off[k] * by);
            count[at < BINS ? at : BINS - 1]++;
            all++;
        }
    }
    while (bin > 0 && above < (1.0 - UPPER) * all) {
        above += count[--bin];
    }
    return (double)most * bin / BINS;
}

/* Mark what is connected with a pixel and has the mark `from` with `to`; `near` neighbours count. Returns how many pixels of it
 * lie in the box. */
static int flood(blob_window *o, int start, int near, uint8_t from, uint8_t to)
{
    static const int ACROSS[] = {1, 0, -1, 0, 1, -1, -1, 1}, DOWN[] = {0, 1, 0, -1, 1, 1, -1, -1};
    int n = 1, inside = 0;
    o->queue[0] = (int16_t)(start / o->side_x * QUEUED + start % o->side_x);
    o->label[start] = to;
    while (n > 0) {
        const int at = o->queue[--n], x = at % QUEUED, y = at / QUEUED;
        inside += o->inside[y * o->side_x + x];
        for (int i = 0; i < near; i++) {
            const int column = x + ACROSS[i], row = y + DOWN[i], next = row * o->side_x + column;
            if (column >= 0 && row >= 0 && column < o->side_x && row < o->side_y && o->label[next] == from) {
                o->label[next] = to;
                o->queue[n++] = (int16_t)(row * QUEUED + column);
            }
        }
    }
    return inside;
}

static int on_border(const blob_window *o, int k)
{
    const int x = k % o->side_x, y = k / o->side_x;
    return x == 0 || y == 0 || x == o->side_x - 1 || y == o->side_y - 1;
}

/* Choose the component with most pixels in the box; returns whether there is one that does not reach the border. */
static int component(blob_window *o, double least)
{
    const int area = o->side_x * o->side_y;
    int best = -1, most = 0;
    for (int k = 0; k < area; k++) {
        o->label[k] = (double)o->off[k] > least ? DIFFERENT : NOTHING;
    }
    for (int k = 0; k < area; k++) {
        if (o->label[k] == DIFFERENT && o->inside[k]) {
            const int inside = flood(o, k, 8, DIFFERENT, SEEN);
            best = inside > most ? k : best;
            most = inside > most ? inside : most;
        }
    }
    if (best < 0) {
        return 0;
    }
    flood(o, best, 8, SEEN, CHOSEN);
    for (int k = 0; k < area; k++) {
        if (o->label[k] == CHOSEN && on_border(o, k)) {
            return 0;
        }
        o->label[k] = o->label[k] == CHOSEN ? CHOSEN : NOTHING;
    }
    return 1;
}

/* The mean size of the differences in the component, in deviations. */
static double mean_off(const blob_window *o)
{
    double sum = 0.0;
    int n = 0;
    for (int k = 0; k < o->side_x * o->side_y; k++) {
        if (o->label[k] == CHOSEN) {
            sum += (double)o->off[k];
            n++;
        }
    }
    return sum / n;
}

/* Mark what the component does not enclose. */
static void mark_outside(blob_window *o)
{
    for (int y = 0; y < o->side_y; y++) {
        const int each = y == 0 || y == o->side_y - 1 || o->side_x == 1 ? 1 : o->side_x - 1;
        for (int x = 0; x < o->side_x; x += each) {
            if (o->label[y * o->side_x + x] == NOTHING) {
                flood(o, y * o->side_x + x, 4, NOTHING, OUTSIDE);
            }
        }
    }
}

/* The ellipse with the second moments of what the component encloses. */
static int moments(const blob_window *o, blob_ellipse *out)
{
    double n = 0.0, x = 0.0, y = 0.0, xx = 0.0, xy = 0.0, yy = 0.0, light = 0.0;
    for (int row = 0, k = 0; row < o->side_y; row++) {
        for (int column = 0; column < o->side_x; column++, k++) {
            if (o->label[k] != OUTSIDE) {
                const double u = column, v = row;
                n += 1.0;
                x += u, y += v, xx += u * u, xy += u * v, yy += v * v;
                light += o->label[k] == CHOSEN ? (double)o->px[0][k] : 0.0;
            }
        }
    }
    const double by = 4.0 * o->step * o->step, cx = x / n, cy = y / n;
    out->M[0] = by * (xx / n - cx * cx), out->M[1] = by * (xy / n - cx * cy), out->M[2] = by * (yy / n - cy * cy);
    out->centre[0] = (o->left + cx + 0.5) * o->step - 0.5;
    out->centre[1] = (o->top + cy + 0.5) * o->step - 0.5;
    out->bright = light > 0.0;
    const double det = out->M[0] * out->M[2] - out->M[1] * out->M[1];
    out->filled = det > 0.0 ? n * o->step * o->step / (acos(-1.0) * sqrt(det)) : 0.0;
    return n >= FEWEST && out->filled >= LEAST_OUTLINE_FILLED;
}

int blob_outline(const blob_image *image, const blob_peak *peak, blob_ellipse *out)
{
    blob_window o;
    if (!cut(image, peak, &o)) {
        return 0;
    }
    const double most = upper(&o);
    for (int k = 0; k < TRIES; k++) {
        const double least = fmax(LEAST_DIFFERS, DIFFERS[k] * most);
        if (component(&o, least) && component(&o, fmax(least, EDGE * mean_off(&o)))) {
            mark_outside(&o);
            if (moments(&o, out)) {
                return 1;
            }
        }
    }
    return 0;
}
