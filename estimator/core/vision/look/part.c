/* The pixels of parts of a frame at reduced sizes, made from larger ones where a frame was not reduced. */

#include <string.h>

#include "vision/look/look.h"
#include "base/wide.h"

enum { CHANNELS = 3 };

/* Pixels that are halved at a time, so that their sums stay near. */
enum { AT_ONCE = 256, VALUES = 2 * CHANNELS * AT_ONCE };

/* A pair of rows to one of half the width: each pixel is the rounded mean of four. */
WIDE
static void halve_rows(const uint8_t *upper, const uint8_t *lower, int width, uint8_t *to)
{
    uint16_t sums[VALUES];
    uint8_t means[VALUES];
    for (int from = 0; from < width; from += AT_ONCE, upper += VALUES, lower += VALUES, to += CHANNELS * AT_ONCE) {
        const int pixels = width - from < AT_ONCE ? width - from : AT_ONCE, values = 2 * CHANNELS * pixels;
        for (int i = 0; i < values; i++) {
            sums[i] = (uint16_t)(upper[i] + lower[i]);
        }
        for (int i = 0; i < values - CHANNELS; i++) {
            means[i] = (uint8_t)((sums[i] + sums[i + CHANNELS] + 2) >> 2);
        }
        /* Four bytes at once; the next pixel overwrites the last. */
        for (int x = 0; x < pixels - 1; x++) {
            memcpy(to + CHANNELS * x, means + 2 * CHANNELS * x, CHANNELS + 1);
        }
        memcpy(to + CHANNELS * (pixels - 1), means + 2 * CHANNELS * (pixels - 1), CHANNELS);
    }
}

/* Rows of pixels to half their number and width. `to` may begin where `from` does: what is written has been read. */
static void halve(const uint8_t *from, ptrdiff_t stride, int rows, int width, uint8_t *to)
{
    for (int row = 0; row < rows; row++, from += 2 * stride, to += CHANNELS * width) {
        halve_rows(from, from + stride, width, to);
    }
}

/* Pixels of an image some levels higher, (rows, columns), from the pixel on where they begin; behind them `out` has room for as many
 * rows of the level below as one of them takes. */
static void reduce(const uint8_t *from, ptrdiff_t row_bytes, int levels, int columns, int rows, uint8_t *out)
{
    uint8_t *strip = out + (ptrdiff_t)rows * CHANNELS * columns;
    for (int row = 0; row < rows; row++, from += row_bytes << levels, out += CHANNELS * columns) {
        const uint8_t *at = from;
        ptrdiff_t bytes = row_bytes;
        for (int left = levels - 1; left >= 0; left--) {
            uint8_t *to = left > 0 ? strip : out;
            halve(at, bytes, 1 << left, columns << left, to);
            at = to, bytes = CHANNELS * ((ptrdiff_t)columns << left);
        }
    }
}

/* Make the pixels of a part from those of a lower level, which are given from where the part begins on; 0 without room. */
static int make(const dl_tracker *t, const uint8_t *from, ptrdiff_t row_bytes, int levels, uint8_t **at, seen_part *seen)
{
    const int columns = (int)seen->part.width, rows = (int)seen->part.height;
    const int64_t bytes = (int64_t)CHANNELS * columns * rows, strip = levels > 1 ? (int64_t)CHANNELS * columns << (2 * levels - 2) : 0;
    if (bytes + strip + 1 > t->parts + t->part_bytes - *at) {
        return 0;
    }
    reduce(from, row_bytes, levels, columns, rows, *at);
    seen->px = *at, seen->stride = CHANNELS * columns;
    *at += bytes;
    return 1;
}

int look_part(const dl_tracker *t, const dl_frame *frame, uint8_t **at, seen_part *seen)
{
    const frame_part *part = &seen->part;
    int made = (int)part->level;
    while (made > 0 && frame->level[made].px == NULL) {
        made--;
    }
    const dl_image *of = &frame->level[made];
    const int up = (int)part->level - made;
    if (part->left < 0 || part->top < 0 || (part->left + part->width) << up > of->width || (part->top + part->height) << up > of->height) {
        return 0;
    }
    const uint8_t *from = of->px + (part->top << up) * of->stride + CHANNELS * (part->left << up);
    if (up == 0) {
        seen->px = from, seen->stride = (int32_t)of->stride;
        return 1;
    }
    return make(t, from, of->stride, up, at, seen);
}

/* A part of a level that also holds what a part of a higher level is made of. */
static frame_part with_part(const frame_part *lower, const frame_part *higher)
{
    const int up = (int)(higher->level - lower->level);
    const int64_t left = higher->left << up, top = higher->top << up;
    const int64_t right = (higher->left + higher->width) << up, low = (higher->top + higher->height) << up;
    frame_part all = *lower;
    all.left = left < lower->left ? left : lower->left;
    all.top = top < lower->top ? top : lower->top;
    all.width = (right > lower->left + lower->width ? right : lower->left + lower->width) - all.left;
    all.height = (low > lower->top + lower->height ? low : lower->top + lower->height) - all.top;
    return all;
}

int look_parts(const dl_tracker *t, const dl_frame *frame, seen_part seen[2])
{
    const frame_part *whole = &seen[0].part, *arrow = &seen[1].part;
    uint8_t *at = t->parts;
    if (arrow->level == 0 || arrow->level >= whole->level || frame->level[whole->level].px != NULL) {
        return look_part(t, frame, &at, &seen[0]) && look_part(t, frame, &at, &seen[1]);
    }
    seen_part all = {with_part(arrow, whole), NULL, 0};
    const int up = (int)(whole->level - arrow->level);
    if (!look_part(t, frame, &at, &all)) {
        return 0;
    }
    const uint8_t *from = all.px + ((whole->top << up) - all.part.top) * all.stride + CHANNELS * ((whole->left << up) - all.part.left);
    seen[1].px = all.px + (arrow->top - all.part.top) * all.stride + CHANNELS * (arrow->left - all.part.left);
    seen[1].stride = all.stride;
    return make(t, from, all.stride, up, &at, &seen[0]);
}
