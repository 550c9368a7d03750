#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "interface.h"

/* The noise of a frame, of whatever the frame shows: second differences along both axes let no plane and no straight edge along an
 * axis through. Quiet places say it: the lower quartile of what they let through. Waves, rust and letters raise the upper ones.
 * Source: Immerkaer, Fast noise variance estimation, Computer Vision and Image Understanding 64(2), 1996. */
enum { CHANNELS = 3, LARGEST = 16 * 255, EVERY_ROW = 12, EVERY_COLUMN = 5 };
/* The lower quartile of the absolute of a standard normal number, and the deviation of the differences of such numbers. */
static const double QUARTILE = 0.3186, OF_DIFFERENCES = 6.0;
/* Noise, in values of a pixel, that what reads a frame allows for anyway. */
static const double USUAL = 3.0;

static int second_differences(const uint8_t *at, ptrdiff_t stride)
{
    const uint8_t *above = at - stride, *below = at + stride;
    const int sides = above[0] + below[0] + at[-CHANNELS] + at[CHANNELS];
    const int corners = above[-CHANNELS] + above[CHANNELS] + below[-CHANNELS] + below[CHANNELS];
    return abs(4 * at[0] - 2 * sides + corners);
}

double frame_noise(const uint8_t *px, int32_t stride, int32_t width, int32_t height)
{
    int32_t counts[LARGEST + 1], places = 0, below = 0;
    memset(counts, 0, sizeof counts);
    for (int row = 1; row < height - 1; row += EVERY_ROW) {
        const uint8_t *line = px + (ptrdiff_t)row * stride;
        for (int k = CHANNELS; k < CHANNELS * (width - 1); k += EVERY_COLUMN) {
            counts[second_differences(line + k, stride)]++;
            places++;
        }
    }
    int value = 0;
    while (value < LARGEST && 4 * (below + counts[value]) < places) {
        below += counts[value++];
    }
    /* Differences are whole numbers: the quartile lies within those of this value. */
    const double share = counts[value] > 0 ? (0.25 * places - below) / counts[value] : 0.0;
    const double sigma = fmax(0.0, value - 0.5 + share) / (QUARTILE * OF_DIFFERENCES);
    return sigma > USUAL ? sqrt(sigma * sigma - USUAL * USUAL) / 255.0 : 0.0;
}
