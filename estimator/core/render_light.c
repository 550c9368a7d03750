/* A scene under a light, and the light through the lens onto the sensor of the simulated camera.
 *
 * A pixel of a scene is four numbers of sixteen bits: what it reflects of blue, green and red, and the wear of its paint, parts of
 * SCENE_ONE. Light is counted in three of them; factors on it are parts of GAIN_ONE. The blur of the lens is separable, and only
 * as many rows as it is wide are kept between its two passes.
 */

#include "interface.h"
#include "lanes.h"

enum { CHANNELS = 3, MOST = 32767, LANES = 8, BLOCK = 16 };

void render_expose(int32_t pixels, const uint16_t *scene, const uint8_t *kinds, const int16_t *gain, const float *exposure,
                   const uint16_t *pad_scene, int16_t *light)
{
    const four full = four_scaled(four_load(exposure), 1.0f / GAIN_ONE);
    for (int32_t i = 0; i < pixels; i++) {
        const uint16_t *pixel = scene + 4 * (int64_t)i;
        const int kind = kinds ? kinds[i] : PAD_NONE;
        float factor = gain[i];
        if (kind != PAD_NONE && kind != PAD_EDGE) {
            factor *= (float)pixel[3] * (1.0f / SCENE_ONE);
            pixel = pad_scene + 4 * kind;
        }
        /* The fourth number falls where the next pixel's light follows. */
        lanes_store_four(light + CHANNELS * (int64_t)i, lanes_lit(lanes_load_four(pixel), four_scaled(full, factor)));
    }
}

void render_mix(int32_t edges, const int32_t *where, const float *shares, const uint16_t *scene, const int16_t *gain,
                const float *exposure, const uint16_t *pad_scene, int16_t *light)
{
    for (int32_t e = 0; e < edges; e++) {
        const int64_t i = where[e];
        const float *share = shares + PAD_PAINTS * (int64_t)e;
        const float factor = (float)gain[i] * (float)scene[4 * i + 3] * (1.0f / GAIN_ONE / SCENE_ONE);
        int16_t *mixed = light + CHANNELS * i;
        for (int c = 0; c < CHANNELS; c++) {
            float own = 0.0f;
            for (int k = 1; k < PAD_PAINTS; k++) {
                own += share[k] * (float)pad_scene[4 * k + c];
            }
            const float sum = share[PAD_NONE] * (float)mixed[c] + own * (exposure[c] * factor) + 0.5f;
            mixed[c] = (int16_t)(sum < (float)MOST ? sum : (float)MOST);
        }
    }
}

/* What the two passes of the blur work on: rows blurred along themselves, in a ring, and one row with its ends repeated. */
typedef struct {
    int32_t h, values, stride;
    int radius;
    const uint16_t *taps;
    const int16_t *light;
    uint16_t *ring, *wide;
} lens;

static lens lens_of(int32_t h, int32_t w, int32_t radius, const uint16_t *taps, const int16_t *light, uint16_t *scratch)
{
    const int32_t values = CHANNELS * w, stride = (values + BLOCK - 1) / BLOCK * BLOCK;
    const lens made = {h, values, stride, radius, taps, light, scratch, scratch + (2 * radius + 1) * stride};
    return made;
}

/* taps[0] middle + sum over t of taps[t] (before[-t] + after[+t]), for eight values.
 *
 * Each product loses half a count on average, but none in the dark: what is added keeps both within a count of the truth.
 */
static inline lanes weighted(const lens *l, const uint16_t *const *before, const uint16_t *const *after, int32_t x)
{
    lanes sum = lanes_add(lanes_all((uint16_t)((l->radius + 1) / 2)), lanes_times(lanes_load(before[0] + x), lanes_all(l->taps[0])));
    for (int t = 1; t <= l->radius; t++) {
        const lanes pair = lanes_add(lanes_load(before[t] + x), lanes_load(after[t] + x));
        sum = lanes_add(sum, lanes_times(pair, lanes_all(l->taps[t])));
    }
    return sum;
}

static uint16_t *slot(const lens *l, int32_t row)
{
    return l->ring + row % (2 * l->radius + 1) * l->stride;
}

/* Put a row into the ring, blurred along itself. */
static void enter(const lens *l, int32_t row)
{
    const uint16_t *before[BLUR_RADIUS_MAX + 1], *after[BLUR_RADIUS_MAX + 1];
    const int32_t margin = CHANNELS * l->radius;
    uint16_t *inside = l->wide + margin, *out = slot(l, row);
    memcpy(l->radius ? inside : out, l->light + (int64_t)row * l->values, (size_t)l->values * sizeof *out);
    if (!l->radius) {
        return;
    }
    for (int32_t x = 0; x < margin; x++) {
        l->wide[x] = inside[x % CHANNELS];
        inside[l->values + x] = inside[l->values - CHANNELS + x % CHANNELS];
    }
    for (int t = 0; t <= l->radius; t++) {
        before[t] = inside - CHANNELS * t;
        after[t] = inside + CHANNELS * t;
    }
    for (int32_t x = 0; x < l->stride; x += LANES) {
        lanes_store(out + x, weighted(l, before, after, x));
    }
}

/* The rows of the ring around a row of the frame; those outside it are its first and its last one. */
static void around(const lens *l, int32_t row, const uint16_t **before, const uint16_t **after)
{
    for (int t = 0; t <= l->radius; t++) {
        before[t] = slot(l, row - t > 0 ? row - t : 0);
        after[t] = slot(l, row + t < l->h - 1 ? row + t : l->h - 1);
    }
}

/* One block of the blurred row, in counts; the block may reach over the row's end. */
static inline void counted(const lens *l, const uint16_t *const *before, const uint16_t *const *after, int32_t x, uint16_t *counts)
{
    for (int32_t k = 0; k < BLOCK; k += LANES) {
        const lanes here = l->radius ? weighted(l, before, after, x + k)
                                     : lanes_load(before[0] + x + k);
        lanes_store(counts + k, here);
    }
}

static inline int block_at(const lens *l, int32_t x)
{
    return l->values - x < BLOCK ? l->values - x : BLOCK;
}

void render_blur(int32_t h, int32_t w, const int16_t *light, int32_t radius, const uint16_t *taps, uint16_t *scratch,
                 int16_t *blurred)
{
    const uint16_t *before[BLUR_RADIUS_MAX + 1], *after[BLUR_RADIUS_MAX + 1];
    const lens l = lens_of(h, w, radius, taps, light, scratch);
    uint16_t counts[BLOCK];
    for (int32_t row = 0, entered = 0; row < h; row++) {
        while (entered < h && entered <= row + radius) {
            enter(&l, entered++);
        }
        around(&l, row, before, after);
        int16_t *out = blurred + (int64_t)row * l.values;
        for (int32_t x = 0; x < l.values; x += BLOCK) {
            counted(&l, before, after, x, counts);
            for (int k = 0; k < block_at(&l, x); k++) {
                out[x + k] = (int16_t)(counts[k] < MOST ? counts[k] : MOST);
            }
        }
    }
}

/* The values of a frame for a block of light: even noise is added to transformed light, and the tone curve follows. */
static inline void develop(int n, const uint16_t *counts, const uint16_t *even, const int16_t *grain, const uint8_t *codes,
                           uint8_t *out)
{
    if (grain && n == BLOCK) {
        for (int k = 0; k < BLOCK; k += 4) {
            const uint16_t a = even[counts[k]], b = even[counts[k + 1]], c = even[counts[k + 2]], d = even[counts[k + 3]];
            out[k] = codes[(uint16_t)(a + grain[k])];
            out[k + 1] = codes[(uint16_t)(b + grain[k + 1])];
            out[k + 2] = codes[(uint16_t)(c + grain[k + 2])];
            out[k + 3] = codes[(uint16_t)(d + grain[k + 3])];
        }
        return;
    }
    for (int k = 0; k < n; k++) {
        out[k] = codes[grain ? (uint16_t)(even[counts[k]] + grain[k]) : counts[k]];
    }
}

void render_frame(int32_t h, int32_t w, const int16_t *light, int32_t radius, const uint16_t *taps, const uint16_t *even,
                  const int16_t *noise, const uint8_t *codes, uint16_t *scratch, uint8_t *frame)
{
    const uint16_t *before[BLUR_RADIUS_MAX + 1], *after[BLUR_RADIUS_MAX + 1];
    const lens l = lens_of(h, w, radius, taps, light, scratch);
    uint16_t counts[BLOCK];
    for (int32_t row = 0, entered = 0; row < h; row++) {
        while (entered < h && entered <= row + radius) {
            enter(&l, entered++);
        }
        around(&l, row, before, after);
        uint8_t *out = frame + (int64_t)row * l.values;
        const int16_t *grain = noise ? noise + (int64_t)row * l.values : 0;
        for (int32_t x = 0; x < l.values; x += BLOCK) {
            counted(&l, before, after, x, counts);
            develop(block_at(&l, x), counts, even, grain ? grain + x : 0, codes, out + x);
        }
    }
}
