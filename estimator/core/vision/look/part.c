#include <stddef.h>
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
        /* Four bytes at once, of which the next pixel takes the last. */
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

void look_reduced(const uint8_t *from, ptrdiff_t row_bytes, int levels, int columns, int rows, uint8_t *out)
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

const uint8_t *look_part(const uint8_t *frame, int32_t width, const frame_part *part, uint8_t *parts, int32_t *stride)
{
    const ptrdiff_t row_bytes = CHANNELS * (ptrdiff_t)width;
    const int level = (int)part->level, columns = (int)part->width, rows = (int)part->height;
    const uint8_t *at = frame + (part->top << level) * row_bytes + CHANNELS * (part->left << level);
    if (level == 0) {
        *stride = (int32_t)row_bytes;
        return at;
    }
    *stride = CHANNELS * columns;
    look_reduced(at, row_bytes, level, columns, rows, parts);
    return parts;
}
