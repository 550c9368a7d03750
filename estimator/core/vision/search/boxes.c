/* Fit the strokes of an H by sums over boxes. */

#include <math.h>
#include <string.h>

#include "base/wide.h"
#include "vision/search/search.h"

enum { BOXES = 4, REACH_MAX = 80 };
/* Width of a stroke at which the mask is halved, thirded ..., px: strokes of the mask that is searched are 5 to 10 px wide. */
static const double STROKE_PX = 5.0;
static const float LEAST_FRACTION = 0.22f; /* Smallest fraction of the H that must be in view. */
static const float LEAST_SCORE = 0.3f; /* Least score: a half-covered H has a half. */

/* A box about the H's centre, cells: rows from top to below, columns from left to right. */
typedef struct {
    int top, below, left, right;
} box;

int64_t strokes_sums(int64_t n)
{
    return 2 * (n + 2 * REACH_MAX + 1) * (n + 2 * REACH_MAX + 1);
}

/* Add a cell's pixels to a row's sums. */
static inline void add_cell(const int8_t *corner, int n, int step, int32_t *sum, int32_t *count)
{
    for (int k = 0; k < step; k++, corner += n) {
        for (int l = 0; l < step; l++) {
            *sum += corner[l];
            *count += corner[l] != 0;
        }
    }
}

/* The sums of one row of cells, added to those above. */
static void add_row(const int8_t *from, int n, int step, int cells, int reach, int side, int32_t *here, int32_t *known)
{
    int32_t sum = 0, count = 0;
    const int32_t *above = here - side, *known_above = known - side;
    memset(here, 0, (size_t)(reach + 1) * sizeof *here);
    memset(known, 0, (size_t)(reach + 1) * sizeof *known);
    for (int i = 0, at = reach + 1; i < cells; i++, at++) {
        if (step == 1) {
            add_cell(from + i, n, 1, &sum, &count);
        } else {
            add_cell(from + i * step, n, step, &sum, &count);
        }
        here[at] = above[at] + sum;
        known[at] = known_above[at] + count;
    }
    for (int at = reach + cells + 1; at < side; at++) {
        here[at] = above[at] + sum;
        known[at] = known_above[at] + count;
    }
}

/* Sums of the mask, and of its cells in view, over all rows and columns before; cells are `step` px wide, with a border. */
static void integrals(int n, const int8_t *mask, int step, int cells, int reach, int32_t *sums, int32_t *seen)
{
    const int side = cells + 2 * reach + 1;
    memset(sums, 0, (size_t)side * sizeof *sums);
    memset(seen, 0, (size_t)side * sizeof *seen);
    for (int row = 0; row < side - 1; row++) {
        int32_t *here = sums + (row + 1) * side, *known = seen + (row + 1) * side;
        if (row >= reach && row < reach + cells) {
            add_row(mask + (row - reach) * step * n, n, step, cells, reach, side, here, known);
        } else {
            memcpy(here, here - side, (size_t)side * sizeof *here);
            memcpy(known, known - side, (size_t)side * sizeof *known);
        }
    }
}

/* The scores of a row of places: the mean of the mask on the H minus the mean around it, halved. */
WIDE
static void score_row(int cells, int side, const box boxes[BOXES], const int32_t *sums, const int32_t *seen, float area,
                      float area_around, float *out)
{
    for (int i = 0; i < cells; i++) {
        int32_t of[BOXES], known[BOXES];
        for (int k = 0; k < BOXES; k++) {
            const int32_t *low = sums + boxes[k].below * side + i, *top = sums + boxes[k].top * side + i;
            const int32_t *low_seen = seen + boxes[k].below * side + i, *top_seen = seen + boxes[k].top * side + i;
            of[k] = low[boxes[k].right] - top[boxes[k].right] - low[boxes[k].left] + top[boxes[k].left];
            known[k] = low_seen[boxes[k].right] - top_seen[boxes[k].right] - low_seen[boxes[k].left] + top_seen[boxes[k].left];
        }
        const float h = (float)(of[0] + of[1] + of[2]), h_seen = (float)(known[0] + known[1] + known[2]);
        const float around = (float)of[3] - h, around_seen = (float)known[3] - h_seen;
        const float least = LEAST_FRACTION * area, least_around = LEAST_FRACTION * area_around;
        const float fraction = h_seen < area ? h_seen / area : 1.0f;
        const float on = h / (h_seen > least ? h_seen : least);
        const float beside = around / (around_seen > least_around ? around_seen : least_around);
        out[i] = h_seen < least || around_seen < least_around ? -1.0f : 0.5f * (on - beside) * (0.7f + 0.3f * fraction);
    }
}

/* Whether the sizes are those of an H no larger than the sums have room for: then its boxes lie within them. */
static int fits_sums(const dl_pad_strokes *h, double per_m)
{
    const double across = 0.5 * fmax(h->length_m, h->width_m) + h->margin_m;
    const int drawn = h->leg_m > 0.0 && h->bar_m > 0.0 && h->margin_m >= 0.0 && h->width_m >= 2.0 * h->leg_m && h->length_m >= h->bar_m;
    return drawn && across * per_m <= REACH_MAX - 1;
}

/* The boxes of the legs, of the cross-bar, and of the H with its margin, from a pixel of the sums. */
static int boxes_of(const dl_pad_strokes *h, double per_m, int across, box out[BOXES], float *area, float *area_around)
{
    const double length = 0.5 * h->length_m * per_m, width = 0.5 * h->width_m * per_m, leg = h->leg_m * per_m;
    const double bar = 0.5 * h->bar_m * per_m, margin = h->margin_m * per_m;
    const double sides[BOXES][4] = {
        {-length, length, -width, leg - width}, {-length, length, width - leg, width}, {-bar, bar, leg - width, width - leg},
        {-length - margin, length + margin, -width - margin, width + margin},
    };
    const int reach = (int)ceil(fmax(length, width) + margin) + 1;
    for (int k = 0; k < BOXES; k++) {
        int at[4];
        for (int i = 0; i < 4; i++) {
            at[i] = reach + (int)floor(sides[k][across ? (i + 2) % 4 : i] + 1.0);
        }
        out[k].left = at[0], out[k].right = at[1], out[k].top = at[2], out[k].below = at[3];
    }
    *area = (float)(4.0 * length * leg + 2.0 * bar * 2.0 * (width - leg));
    *area_around = (float)(4.0 * (length + margin) * (width + margin)) - *area;
    return reach;
}

/* Whether a row has a score that counts. */
WIDE
static int any_good(int n, const float *score)
{
    int any = 0;
    for (int i = 0; i < n; i++) {
        any |= score[i] >= LEAST_SCORE;
    }
    return any;
}

/* The best place, or -1 if none is good enough. */
static int best_place(int cells, const float *score)
{
    int best = -1;
    for (int row = 0; row < cells; row++) {
        const float *here = score + row * cells;
        const int until = any_good(cells, here) ? cells : 0;
        for (int i = 0; i < until; i++) {
            best = here[i] >= LEAST_SCORE && (best < 0 || here[i] > score[best]) ? row * cells + i : best;
        }
    }
    return best;
}

/* Take the best places from the scores. */
static int best_places(int cells, float *score, int across, int apart, stroke_place *out)
{
    int n = 0;
    for (; n < STROKES_BEST; n++) {
        const int best = best_place(cells, score);
        if (best < 0) {
            break;
        }
        const int row = best / cells, column = best % cells;
        out[n].score = score[best], out[n].x = (float)column, out[n].y = (float)row, out[n].across = across;
        for (int i = row > apart ? row - apart : 0; i <= row + apart && i < cells; i++) {
            for (int j = column > apart ? column - apart : 0; j <= column + apart && j < cells; j++) {
                score[i * cells + j] = -1.0f;
            }
        }
    }
    return n;
}

int strokes_fit(const dl_pad_strokes *h, int n, const int8_t *mask, double width, int32_t *sums, float *score, stroke_place out[STROKES_PLACES])
{
    const int step = width >= 2.0 * STROKE_PX ? (int)(width / STROKE_PX) : 1, cells = n / step;
    const double stroke = width / step, per_m = stroke / h->leg_m;
    float area, area_around;
    box boxes[BOXES];
    int found = 0;
    if (cells < 2 || !fits_sums(h, per_m)) {
        return 0;
    }
    const int reach = boxes_of(h, per_m, 0, boxes, &area, &area_around), side = cells + 2 * reach + 1;
    int32_t *seen = sums + (size_t)side * (size_t)side;
    integrals(n, mask, step, cells, reach, sums, seen);
    for (int across = 0; across < 2; across++) {
        boxes_of(h, per_m, across, boxes, &area, &area_around);
        const float by = (float)(step * step);
        for (int row = 0; row < cells; row++) {
            score_row(cells, side, boxes, sums + row * side, seen + row * side, area * by, area_around * by, score + row * cells);
        }
        found += best_places(cells, score, across, (int)floor(stroke + 0.5), out + found);
    }
    for (int k = 0; k < found; k++) {
        out[k].x = (out[k].x + 0.5f) * (float)step - 0.5f;
        out[k].y = (out[k].y + 0.5f) * (float)step - 0.5f;
    }
    return found;
}
