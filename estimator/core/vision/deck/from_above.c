/* Draw a plane as seen from above, between places in the frame that were projected. */

#include <string.h>

#include "vision/tracker.h"

/* A frame's sides are FRAME_SIDE_MAX at most, so that places in it fit 32 bits. */
enum { NODES_MAX = 512, BETWEEN_MAX = 64 };

/* Interpolate between four pixels, of which `at` is the first; the place lies along and down from it, in 1/64 px. */
static inline uint8_t between_four(const uint8_t *at, int64_t stride, int along, int down)
{
    const int above = at[0] * (64 - along) + at[3] * along, below = at[stride] * (64 - along) + at[stride + 3] * along;
    return (uint8_t)((above * (64 - down) + below * down + 2048) >> 12);
}

/* Draw a run of pixels from u, v on, in 1/65536 px; all of them are in the image. */
static void run_of(const dl_image *image, const int32_t *from, const int32_t *step, int count, int channels, uint8_t *out)
{
    for (int k = 0; k < count; k++) {
        const int32_t u = from[0] + k * step[0], v = from[1] + k * step[1];
        const uint8_t *at = image->px + (int64_t)(v >> 16) * image->stride + 3 * (u >> 16);
        const int along = (u >> 10) & 63, down = (v >> 10) & 63;
        if (channels == 1) {
            out[k] = between_four(at + 1, image->stride, along, down);
            continue;
        }
        for (int channel = 0; channel < 3; channel++) {
            out[3 * k + channel] = between_four(at + channel, image->stride, along, down);
        }
    }
}

static inline int32_t fixed(float px)
{
    return (int32_t)(65536.0f * px);
}

/* A run of pixels on a straight line through the image, px: its begin, its step, the image's end, and whether all of it is inside the
 * image or outside. */
typedef struct {
    float at[2], step[2], end[2];
    int inside, outside;
} way;

/* Return the run between two nodes, at a share `down` of the distance to the nodes below them. */
static way way_of(const dl_image *image, const float *from, const float *to, float down, int between)
{
    way out = {.end = {(float)image->width - 2.0f, (float)image->height - 2.0f}, .inside = 1};
    for (int k = 0; k < 2; k++) {
        const float end = out.end[k], at = from[k] + down * (to[k] - from[k]), next = from[k + 2] + down * (to[k + 2] - from[k + 2]);
        out.at[k] = at, out.step[k] = (next - at) / (float)between;
        out.inside = out.inside && at >= 1.5f && at < end - 0.5f && next >= 1.5f && next < end - 0.5f;
        out.outside = out.outside || (at < 1.0f && next < 1.0f) || (at > end && next > end);
    }
    return out;
}

static inline float limited_to(float value, float most)
{
    return value > 0.0f ? (value < most ? value : most) : 0.0f;
}

/* Draw a run that is not all inside the image. Outside, the nearest pixels of the image are taken; a run that lies all outside repeats its
 * first pixel. */
static void run_beyond(const dl_image *image, const way *along, int count, int channels, uint8_t *out, uint8_t *shown)
{
    for (int k = 0; k < count; k++) {
        if (along->outside && k > 0) {
            memcpy(out + channels * k, out, (size_t)channels);
            shown[k] = 0;
            continue;
        }
        const float u = along->at[0] + (float)k * along->step[0], v = along->at[1] + (float)k * along->step[1];
        const int32_t begin[2] = {fixed(limited_to(u, along->end[0])), fixed(limited_to(v, along->end[1]))}, still[2] = {0, 0};
        run_of(image, begin, still, 1, channels, out + channels * k);
        shown[k] = u >= 1.0f && v >= 1.0f && u <= along->end[0] && v <= along->end[1] ? 255 : 0;
    }
}

int32_t dl_from_above(const dl_image *image, const float *places, int32_t nodes, int32_t between, int32_t channels, uint8_t *out,
    uint8_t *shown)
{
    if (!is_image(image, 3) || image->width < 4 || image->height < 4 || !lies_within(nodes, 2, NODES_MAX)
        || !lies_within(between, 1, BETWEEN_MAX) || (channels != 1 && channels != 3)) {
        return DL_WRONG_SIZE;
    }
    const int n = (nodes - 1) * between + 1;
    for (int row = 0; row < n; row++) {
        const int above = row / between < nodes - 1 ? row / between : nodes - 2;
        const float down = (float)(row - above * between) / (float)between;
        for (int cell = 0; cell < nodes - 1; cell++) {
            const float *from = places + 2 * ((int64_t)above * nodes + cell);
            const int count = cell == nodes - 2 ? between + 1 : between;
            const int64_t first = (int64_t)row * n + cell * between;
            const way along = way_of(image, from, from + 2 * nodes, down, between);
            if (!along.inside) {
                run_beyond(image, &along, count, channels, out + channels * first, shown + first);
                continue;
            }
            const int32_t begin[2] = {fixed(along.at[0]), fixed(along.at[1])}, each[2] = {fixed(along.step[0]), fixed(along.step[1])};
            run_of(image, begin, each, count, channels, out + channels * first);
            memset(shown + first, 255, (size_t)count);
        }
    }
    return n;
}
