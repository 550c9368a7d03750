/* Measure a frame's noise, its contrast, and whether it is grey. */

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "vision/tracker.h"

/* The noise of a frame, of whatever the frame shows: second differences along both axes let no plane and no straight edge along an
 * axis through. Quiet places say it: the lower quartile of what they let through. Waves, rust and letters raise the upper ones.
 * Source: Immerkaer, Fast noise variance estimation, Computer Vision and Image Understanding 64(2), 1996. */
enum { CHANNELS = 3, LARGEST = 16 * 255, EVERY_ROW = 12, EVERY_COLUMN = 5 };
static const double QUARTILE = 0.3186; /* Lower quartile of the absolute of a standard normal number. */
static const double OF_DIFFERENCES = 6.0; /* Deviation of the differences of such numbers. */
/* Noise, in values of a pixel, that what reads a clear frame allows for anyway. */
static const double USUAL_VALUES = 3.0;
static const double CLEAR_RANGE = 90.0; /* Range of a frame's values from which it is clear: airlight narrows it. */
static const double OUTERMOST = 0.005; /* Share of the outermost values that are left out of it. */
static const double LEAST_FRAME_CONTRAST = 0.15; /* The least contrast. */

static int second_differences(const uint8_t *at, ptrdiff_t stride)
{
    const uint8_t *above = at - stride, *below = at + stride;
    const int sides = above[0] + below[0] + at[-CHANNELS] + at[CHANNELS];
    const int corners = above[-CHANNELS] + above[CHANNELS] + below[-CHANNELS] + below[CHANNELS];
    return abs(4 * at[0] - 2 * sides + corners);
}

/* The largest difference between the channels of a pixel. */
static int spread_of(const uint8_t *px)
{
    const int low = px[0] < px[1] ? px[0] : px[1], high = px[0] < px[1] ? px[1] : px[0];
    return (px[2] > high ? px[2] : high) - (px[2] < low ? px[2] : low);
}

/* The value, between whole numbers, below which a share of counted values is. */
static double quantile(const int32_t *counts, int largest, double share, int places)
{
    double below = 0.0;
    int value = 0;
    while (value < largest && below + counts[value] < share * places) {
        below += counts[value++];
    }
    return value - 0.5 + (counts[value] > 0 ? (share * places - below) / counts[value] : 0.0);
}

int32_t dl_frame_quality(const dl_image *image, dl_quality *out)
{
    if (!is_image(image, CHANNELS)) {
        return DL_WRONG_SIZE;
    }
    const uint8_t *px = image->px;
    const ptrdiff_t stride = image->stride;
    const int32_t width = (int32_t)image->width, height = (int32_t)image->height;
    int32_t counts[LARGEST + 1], values[256], places = 0, chroma = 0;
    memset(counts, 0, sizeof counts), memset(values, 0, sizeof values);
    for (int row = 1; row < height - 1; row += EVERY_ROW) {
        const uint8_t *line = px + row * stride;
        for (int k = CHANNELS; k < CHANNELS * (width - 1); k += EVERY_COLUMN, places++) {
            counts[second_differences(line + k, stride)]++;
            values[line[k]]++;
            const int spread = spread_of(line + k / CHANNELS * CHANNELS);
            chroma = spread > chroma ? spread : chroma;
        }
    }
    out->chroma = chroma;
    const double range = quantile(values, 255, 1.0 - OUTERMOST, places) - quantile(values, 255, OUTERMOST, places);
    out->contrast = fmin(1.0, fmax(LEAST_FRAME_CONTRAST, range / CLEAR_RANGE));
    const double sigma = quantile(counts, LARGEST, 0.25, places) / (QUARTILE * OF_DIFFERENCES), usual = USUAL_VALUES * out->contrast;
    out->noise = sigma > usual ? sqrt(sigma * sigma - usual * usual) / 255.0 : 0.0;
    return 1;
}
