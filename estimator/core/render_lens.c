/* Light through the lens onto the sensor of the simulated camera: blur, noise and tone curve, row by row.
 *
 * The blur of the lens is separable, and only as many rows as it is wide are kept between its two passes. Light is exposed just
 * before the first of them: a row never leaves the processor's cache between scene and frame.
 */

#include "interface.h"
#include "wide.h"

enum { CHANNELS = 3, MOST = 32767 };

/* What the passes work on: rows blurred along themselves, in a ring; a row with its ends repeated; a row in counts and as places
 * in the table of codes; light of some rows. */
typedef struct {
    int32_t h, values, radius;
    const uint16_t *taps;
    uint16_t *ring, *wide, *counts, *places;
    int16_t *band;
} lens;

static lens lens_of(int32_t h, int32_t w, int32_t radius, const uint16_t *taps, uint16_t *scratch)
{
    const int32_t values = CHANNELS * w;
    lens made = {h, values, radius, taps, scratch, 0, 0, 0, 0};
    made.wide = made.ring + (2 * radius + 1) * (int64_t)values;
    made.counts = made.wide + values + 2 * CHANNELS * radius;
    made.places = made.counts + values;
    made.band = (int16_t *)(made.places + values);
    return made;
}

static inline uint16_t times(uint16_t a, uint16_t b)
{
    return (uint16_t)((uint32_t)a * b >> 16);
}

/* Add the share of two more pairs of values around the middle. */
WIDE
static void add_pairs(int32_t n, const uint16_t *a, const uint16_t *b, uint16_t tap, const uint16_t *c, const uint16_t *d,
                      uint16_t next_tap, uint16_t *restrict out)
{
    for (int32_t x = 0; x < n; x++) {
        const uint16_t pair = times((uint16_t)(a[x] + b[x]), tap), next = times((uint16_t)(c[x] + d[x]), next_tap);
        out[x] = (uint16_t)(out[x] + pair + next);
    }
}

WIDE
static void weigh_three(int32_t n, uint16_t add, const uint16_t *a, const uint16_t *middle, const uint16_t *b, const uint16_t *taps,
                        uint16_t *restrict out)
{
    const uint16_t tap = taps[0], next_tap = taps[1];
    for (int32_t x = 0; x < n; x++) {
        out[x] = (uint16_t)(add + times(middle[x], tap) + times((uint16_t)(a[x] + b[x]), next_tap));
    }
}

/* taps[0] middle + sum over t of taps[t] (before[t] + after[t]), for n values; the radius is 1 or more.
 *
 * Each product loses half a count on average, but none in the dark: what is added keeps both within a count of the truth.
 */
static void weigh(int32_t n, int radius, const uint16_t *const *before, const uint16_t *const *after, const uint16_t *taps,
                  uint16_t *out)
{
    weigh_three(n, (uint16_t)((radius + 1) / 2), before[1], before[0], after[1], taps, out);
    for (int t = 2; t <= radius; t += 2) {
        const int last = t + 1 <= radius ? t + 1 : t;
        add_pairs(n, before[t], after[t], taps[t], before[last], after[last], last > t ? taps[last] : 0, out);
    }
}

static uint16_t *slot(const lens *l, int32_t row)
{
    return l->ring + row % (2 * l->radius + 1) * (int64_t)l->values;
}

/* Put a row of light into the ring, blurred along itself. */
static void enter(const lens *l, int32_t row, const int16_t *light)
{
    const uint16_t *before[BLUR_RADIUS_MAX + 1], *after[BLUR_RADIUS_MAX + 1];
    const int32_t margin = CHANNELS * l->radius;
    uint16_t *inside = l->wide + margin;
    memcpy(l->radius ? inside : slot(l, row), light, (size_t)l->values * sizeof *inside);
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
    weigh(l->values, l->radius, before, after, l->taps, slot(l, row));
}

/* The blurred row in counts; the rows of the ring outside the frame are its first and its last one. */
static const uint16_t *blurred(const lens *l, int32_t row)
{
    const uint16_t *before[BLUR_RADIUS_MAX + 1], *after[BLUR_RADIUS_MAX + 1];
    for (int t = 0; t <= l->radius; t++) {
        before[t] = slot(l, row - t > 0 ? row - t : 0);
        after[t] = slot(l, row + t < l->h - 1 ? row + t : l->h - 1);
    }
    if (!l->radius) {
        return before[0];
    }
    weigh(l->values, l->radius, before, after, l->taps, l->counts);
    return l->counts;
}

void render_blur(int32_t h, int32_t w, const int16_t *light, int32_t radius, const uint16_t *taps, uint16_t *scratch,
                 int16_t *out)
{
    const lens l = lens_of(h, w, radius, taps, scratch);
    for (int32_t row = 0, entered = 0; row < h; row++) {
        for (; entered < h && entered <= row + radius; entered++) {
            enter(&l, entered, light + (int64_t)entered * l.values);
        }
        const uint16_t *counts = blurred(&l, row);
        for (int32_t x = 0; x < l.values; x++, out++) {
            *out = (int16_t)(counts[x] < MOST ? counts[x] : MOST);
        }
    }
}

static inline uint16_t lesser(uint16_t a, uint16_t b)
{
    return a < b ? a : b;
}

/* The places in the table of codes for a row of light with noise: LIGHT_LEVELS levels of light, each with GRAIN_LEVELS of noise.
 *
 * A level is a count in the dark, where the tone curve is steep, then four, then eight. */
WIDE
static void find_places(int32_t n, const uint16_t *restrict counts, const uint8_t *restrict grain, uint16_t *restrict places)
{
    for (int32_t x = 0; x < n; x++) {
        const uint16_t by_four = (uint16_t)(LEVELS_BY_ONE - LEVELS_BY_ONE / 4 + (counts[x] >> 2));
        const uint16_t by_eight = (uint16_t)(LEVELS_BY_EIGHT - COUNTS_BY_EIGHT / 8 + (counts[x] >> 3));
        const uint16_t level = lesser(lesser(counts[x], by_four), lesser(by_eight, LIGHT_LEVELS - 1));
        places[x] = (uint16_t)(level * GRAIN_LEVELS + grain[x]);
    }
}

/* A row of the frame: the tone curve, after noise if there is some. */
static void develop(const lens *l, const uint16_t *counts, const uint8_t *grain, const uint8_t *codes, uint8_t *out)
{
    const uint16_t *places = counts;
    if (grain) {
        find_places(l->values, counts, grain, l->places);
        places = l->places;
    }
    for (int32_t x = 0; x < l->values; x += CHANNELS) {
        out[x] = codes[places[x]];
        out[x + 1] = codes[places[x + 1]];
        out[x + 2] = codes[places[x + 2]];
    }
}

void render_frame(int32_t h, int32_t w, const int16_t *light, int32_t radius, const uint16_t *taps, const uint8_t *noise,
                  const uint8_t *codes, uint16_t *scratch, uint8_t *frame)
{
    const lens l = lens_of(h, w, radius, taps, scratch);
    for (int32_t row = 0, entered = 0; row < h; row++) {
        for (; entered < h && entered <= row + radius; entered++) {
            enter(&l, entered, light + (int64_t)entered * l.values);
        }
        const int64_t at = (int64_t)row * l.values;
        develop(&l, blurred(&l, row), noise ? noise + at : 0, codes, frame + at);
    }
}

void render_image(int32_t h, int32_t w, const uint16_t *scene, const uint8_t *kinds, const int16_t *gain, const float *exposure,
                  const uint16_t *pad_scene, int32_t edges, const int32_t *where, const float *shares, int32_t radius,
                  const uint16_t *taps, const uint8_t *noise, const uint8_t *codes, uint16_t *scratch, uint8_t *frame)
{
    const lens l = lens_of(h, w, radius, taps, scratch);
    int32_t row = 0, e = 0;
    for (int32_t top = 0; top < h; top += CELL_PX) {
        const int32_t end = top + CELL_PX < h ? top + CELL_PX : h, first = e;
        const int64_t i = (int64_t)top * w;
        render_expose((end - top) * w, scene + 4 * i, kinds ? kinds + i : 0, gain + i, exposure, pad_scene, l.band);
        while (e < edges && where[e] < end * w) {
            e++;
        }
        render_mix(e - first, where + first, shares + PAD_PAINTS * (int64_t)first, scene, gain, exposure, pad_scene,
                   l.band - CHANNELS * i);
        for (int32_t entered = top; entered < end; entered++) {
            enter(&l, entered, l.band + (int64_t)(entered - top) * l.values);
            for (; row + radius <= entered || (entered == h - 1 && row < h); row++) {
                const int64_t at = (int64_t)row * l.values;
                develop(&l, blurred(&l, row), noise ? noise + at : 0, codes, frame + at);
            }
        }
    }
}
