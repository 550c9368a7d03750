/* Light through the lens onto the sensor of the simulated camera: blur, noise and tone curve, row by row.
 *
 * The blur of the lens is separable, and only as many rows as it is wide are kept between its two passes. Light is exposed just
 * before the first of them: a row never leaves the processor's cache between scene and frame. Rows of light are planes: all of
 * blue, then green, then red.
 */

#include "render/light.h"
#include "base/wide.h"

/* What the passes work on: rows blurred along themselves, in a ring; a row of one colour with its ends repeated; a row in counts
 * and as places in the table of codes; light of some rows. */
typedef struct {
    int32_t h, w, values, radius;
    const uint16_t *taps;
    uint16_t *ring, *wide, *counts, *places, *band;
    const int32_t *window;
    const int16_t *added;
} lens;

/* Divide what there is to work on; return whether it suffices. */
static int begin(int32_t h, int32_t w, const dl_sim_lens_blur *blur, lens *l)
{
    const int32_t values = CHANNELS * w, radius = blur->radius;
    const lens made = {h, w, values, radius, blur->taps, blur->scratch, 0, 0, 0, 0, blur->window, blur->added};
    *l = made;
    l->wide = l->ring + (2 * radius + 1) * (int64_t)values;
    l->counts = l->wide + w + 2 * radius;
    l->places = l->counts + values;
    l->band = l->places + values;
    return radius <= DL_BLUR_RADIUS_MAX && l->band + DL_CELL_PX * (int64_t)values - l->ring <= blur->numbers;
}

static inline uint16_t times(uint16_t a, uint16_t b)
{
    return (uint16_t)((uint32_t)a * b >> 16);
}

/* Add the share of one more pair of values around the middle. */
WIDE
static void add_pair(int32_t n, const uint16_t *a, const uint16_t *b, uint16_t tap, uint16_t *restrict out)
{
    for (int32_t x = 0; x < n; x++) {
        out[x] = (uint16_t)(out[x] + times((uint16_t)(a[x] + b[x]), tap));
    }
}

/* The share of the five values in the middle. */
WIDE
static void convolve_five(int32_t n, uint16_t add, const uint16_t *const *before, const uint16_t *const *after, const uint16_t *taps,
                       uint16_t *restrict out)
{
    const uint16_t *middle = before[0], *a = before[1], *b = after[1], *c = before[2], *d = after[2];
    const uint16_t tap = taps[0], next_tap = taps[1], last_tap = taps[2];
    for (int32_t x = 0; x < n; x++) {
        const uint16_t near = (uint16_t)(add + times(middle[x], tap) + times((uint16_t)(a[x] + b[x]), next_tap));
        out[x] = (uint16_t)(near + times((uint16_t)(c[x] + d[x]), last_tap));
    }
}

/* The three values in the middle. */
WIDE
static void convolve_three(int32_t n, uint16_t add, const uint16_t *const *before, const uint16_t *const *after, const uint16_t *taps,
                        uint16_t *restrict out)
{
    const uint16_t *middle = before[0], *a = before[1], *b = after[1], tap = taps[0], next_tap = taps[1];
    for (int32_t x = 0; x < n; x++) {
        out[x] = (uint16_t)(add + times(middle[x], tap) + times((uint16_t)(a[x] + b[x]), next_tap));
    }
}

/* taps[0] middle + sum over t of taps[t] (before[t] + after[t]), for n values; the radius is 1 or more.
 *
 * Each product loses half a count on average, but none in the dark: what is added keeps both within a count of the truth.
 */
static void convolve(int32_t n, int radius, const uint16_t *const *before, const uint16_t *const *after, const uint16_t *taps,
                  uint16_t *out)
{
    const uint16_t add = (uint16_t)((radius + 1) / 2);
    if (radius == 1) {
        convolve_three(n, add, before, after, taps, out);
        return;
    }
    convolve_five(n, add, before, after, taps, out);
    for (int t = 3; t <= radius; t++) {
        add_pair(n, before[t], after[t], taps[t], out);
    }
}

static uint16_t *slot(const lens *l, int32_t row)
{
    return l->ring + row % (2 * l->radius + 1) * (int64_t)l->values;
}

/* Put a row of one colour into the ring, blurred along itself. */
static void enter(const lens *l, int32_t row, int colour, const uint16_t *light)
{
    const uint16_t *before[DL_BLUR_RADIUS_MAX + 1] = {NULL}, *after[DL_BLUR_RADIUS_MAX + 1] = {NULL};
    uint16_t *inside = l->wide + l->radius, *out = slot(l, row) + colour * l->w;
    if (!l->radius) {
        memcpy(out, light, (size_t)l->w * sizeof *out);
        return;
    }
    memcpy(inside, light, (size_t)l->w * sizeof *inside);
    for (int32_t x = 0; x < l->radius; x++) {
        l->wide[x] = light[0];
        inside[l->w + x] = light[l->w - 1];
    }
    for (int t = 0; t <= l->radius; t++) {
        before[t] = inside - t;
        after[t] = inside + t;
    }
    convolve(l->w, l->radius, before, after, l->taps, out);
}

/* Put a row of light, pixel by pixel, into the ring. */
static void enter_pixels(const lens *l, int32_t row, const int16_t *light)
{
    for (int c = 0; c < CHANNELS; c++) {
        for (int32_t x = 0; x < l->w; x++) {
            l->band[x] = (uint16_t)light[CHANNELS * x + c];
        }
        enter(l, row, c, l->band);
    }
}

static inline uint16_t lesser(uint16_t a, uint16_t b)
{
    return a < b ? a : b;
}

/* Add what the exact blur of the pad's edges differs by to a blurred row. */
static void add_exact(const lens *l, int32_t row)
{
    const int32_t *v = l->window, inside = row - v[DL_LENS_Y], columns = v[DL_LENS_COLUMNS];
    if (inside < 0 || inside >= v[DL_LENS_ROWS]) {
        return;
    }
    for (int c = 0; c < CHANNELS; c++) {
        const int16_t *added = l->added + (CHANNELS * (int64_t)inside + c) * columns;
        uint16_t *counts = l->counts + (int64_t)c * l->w + v[DL_LENS_X];
        for (int32_t x = 0; x < columns; x++) {
            const int32_t sum = counts[x] + added[x];
            counts[x] = (uint16_t)(sum > 0 ? sum : 0);
        }
    }
}

/* The blurred row in counts; the rows of the ring outside the frame are its first and its last one. */
static const uint16_t *blurred(const lens *l, int32_t row)
{
    const uint16_t *before[DL_BLUR_RADIUS_MAX + 1] = {NULL}, *after[DL_BLUR_RADIUS_MAX + 1] = {NULL};
    for (int t = 0; t <= l->radius; t++) {
        before[t] = slot(l, row - t > 0 ? row - t : 0);
        after[t] = slot(l, row + t < l->h - 1 ? row + t : l->h - 1);
    }
    if (!l->radius) {
        return before[0];
    }
    convolve(l->values, l->radius, before, after, l->taps, l->counts);
    if (l->added) {
        add_exact(l, row);
    }
    return l->counts;
}

bool dl_sim_render_blur(int32_t h, int32_t w, const int16_t *light, const dl_sim_lens_blur *blur, int16_t *out)
{
    lens l;
    if (!begin(h, w, blur, &l)) {
        return false;
    }
    for (int32_t row = 0, entered = 0; row < h; row++) {
        for (; entered < h && entered <= row + l.radius; entered++) {
            enter_pixels(&l, entered, light + (int64_t)entered * l.values);
        }
        const uint16_t *counts = blurred(&l, row);
        for (int32_t x = 0; x < w; x++, out += CHANNELS) {
            for (int c = 0; c < CHANNELS; c++) {
                out[c] = (int16_t)lesser(counts[c * w + x], LIGHT_MOST);
            }
        }
    }
    return true;
}

/* The places in the table of codes for a row of light with noise: DL_LIGHT_LEVELS levels of light, each with DL_GRAIN_LEVELS of noise.
 *
 * A level is a count in the dark, where the tone curve is steep, then four, then eight. */
WIDE
static void find_places(int32_t n, const uint16_t *restrict counts, const uint8_t *restrict grain, uint16_t *restrict places)
{
    for (int32_t x = 0; x < n; x++) {
        const uint16_t by_four = (uint16_t)(DL_LEVELS_BY_ONE - DL_LEVELS_BY_ONE / 4 + (counts[x] >> 2));
        const uint16_t by_eight = (uint16_t)(DL_LEVELS_BY_EIGHT - DL_COUNTS_BY_EIGHT / 8 + (counts[x] >> 3));
        const uint16_t level = lesser(lesser(counts[x], by_four), lesser(by_eight, DL_LIGHT_LEVELS - 1));
        places[x] = (uint16_t)(level * DL_GRAIN_LEVELS + grain[x]);
    }
}

static inline void store_four(uint8_t *out, uint8_t a, uint8_t b, uint8_t c, uint8_t d)
{
    const uint8_t four[4] = {a, b, c, d};
    memcpy(out, four, sizeof four);
}

/* A row of the frame: the tone curve, after noise if there is some. Four bytes are stored at once: stores take the time here. */
static void develop(const lens *l, const uint16_t *counts, const uint8_t *grain, const uint8_t *codes, uint8_t *out)
{
    const uint16_t *blue = counts;
    if (grain) {
        find_places(l->values, counts, grain, l->places);
        blue = l->places;
    }
    const uint16_t *green = blue + l->w, *red = green + l->w;
    int32_t x = 0;
    for (; x + 4 <= l->w; x += 4, out += 4 * CHANNELS) {
        store_four(out, codes[blue[x]], codes[green[x]], codes[red[x]], codes[blue[x + 1]]);
        store_four(out + 4, codes[green[x + 1]], codes[red[x + 1]], codes[blue[x + 2]], codes[green[x + 2]]);
        store_four(out + 8, codes[red[x + 2]], codes[blue[x + 3]], codes[green[x + 3]], codes[red[x + 3]]);
    }
    for (; x < l->w; x++, out += CHANNELS) {
        out[0] = codes[blue[x]];
        out[1] = codes[green[x]];
        out[2] = codes[red[x]];
    }
}

/* Finish a row of the frame from the rows around it. */
static void finish(const lens *l, int32_t row, const dl_sim_sensor_tone *tone, uint8_t *frame)
{
    const int64_t at = (int64_t)row * l->values;
    develop(l, blurred(l, row), tone->noise ? tone->noise + at : 0, tone->codes, frame + at);
}

bool dl_sim_render_frame(int32_t h, int32_t w, const int16_t *light, const dl_sim_lens_blur *blur, const dl_sim_sensor_tone *tone, uint8_t *frame)
{
    lens l;
    if (!begin(h, w, blur, &l)) {
        return false;
    }
    for (int32_t row = 0, entered = 0; row < h; row++) {
        for (; entered < h && entered <= row + l.radius; entered++) {
            enter_pixels(&l, entered, light + (int64_t)entered * l.values);
        }
        finish(&l, row, tone, frame);
    }
    return true;
}

bool dl_sim_render_image(const dl_sim_lit_scene *seen, const dl_sim_lens_blur *blur, const dl_sim_sensor_tone *tone, uint8_t *frame)
{
    const int32_t h = seen->h, w = seen->w;
    const exposure16 exposed = exposure_of(seen);
    const int64_t plane = DL_CELL_PX * (int64_t)w;
    lens l;
    if (!begin(h, w, blur, &l)) {
        return false;
    }
    int32_t row = 0, e = 0;
    for (int32_t top = 0; top < h; top += DL_CELL_PX) {
        const int32_t end = top + DL_CELL_PX < h ? top + DL_CELL_PX : h, first = e;
        const int64_t i = (int64_t)top * w;
        const light_place place = {l.band - i, 1, plane};
        expose_planes(&exposed, seen, i, (end - top) * w, l.band, plane);
        while (e < seen->edges && seen->where[e] < end * w) {
            e++;
        }
        mix_paints(&exposed, seen, first, e, &place);
        for (int32_t entered = top; entered < end; entered++) {
            for (int c = 0; c < CHANNELS; c++) {
                enter(&l, entered, c, l.band + plane * c + (int64_t)(entered - top) * w);
            }
            for (; row + l.radius <= entered || (entered == h - 1 && row < h); row++) {
                finish(&l, row, tone, frame);
            }
        }
    }
    return true;
}
