/* A scene under a light: the light that its pixels send into the lens of the simulated camera.
 *
 * A pixel of a scene is four numbers of sixteen bits: what it reflects of blue, green and red, and the wear of its paint, parts of
 * DL_SCENE_ONE. Light is counted in three of them; factors on it are parts of DL_GAIN_ONE.
 */

#include "render/light.h"
#include "base/lanes.h"
#include "base/wide.h"

/* Factors on the light stay below this, part of 65536; this many pixels are exposed together. */
enum { SHARPEST = 32767, EIGHT = 8 };

/* The exposure as factors below a half, to keep all of sixteen bits; what that takes off is doubled again. */
exposure16 exposure_of(const dl_sim_lit_scene *seen)
{
    const float *exposure = seen->exposure;
    const uint16_t *pad_scene = seen->pad_scene;
    float most = 0.0f, scale = 65536.0f;
    exposure16 made;
    memset(&made, 0, sizeof made);
    for (int c = 0; c < CHANNELS; c++) {
        most = exposure[c] > most ? exposure[c] : most;
    }
    for (; most * scale > (float)SHARPEST && made.doubled < 15; scale *= 0.5f) {
        made.doubled++;
    }
    for (int c = 0; c < CHANNELS; c++) {
        const float factor = 2.0f * scale * exposure[c] + 0.5f;
        made.of_one[c] = (uint16_t)(factor < 65535.0f ? factor : 65535.0f);
        for (int k = 0; k < DL_PAD_PAINTS && pad_scene; k++) {
            made.paint[k][c] = pad_scene[4 * k + c];
            made.paint_light[k][c] = exposure[c] * (float)pad_scene[4 * k + c] * (1.0f / DL_GAIN_ONE / DL_SCENE_ONE);
        }
    }
    return made;
}

/* What eight pixels reflect of each colour, and their wear. */
typedef struct {
    lanes colour[CHANNELS], wear;
} eight;

static inline eight load_eight(const uint16_t *scene)
{
    const lanes a = lanes_load(scene), b = lanes_load(scene + 8), c = lanes_load(scene + 16), d = lanes_load(scene + 24);
    const lanes even = lanes_zip_lower(a, b), odd = lanes_zip_upper(a, b);
    const lanes later_even = lanes_zip_lower(c, d), later_odd = lanes_zip_upper(c, d);
    const lanes blue_green = lanes_zip_lower(even, odd), red_wear = lanes_zip_upper(even, odd);
    const lanes later_blue_green = lanes_zip_lower(later_even, later_odd), later_red_wear = lanes_zip_upper(later_even, later_odd);
    const eight made = {{lanes_lower_halves(blue_green, later_blue_green), lanes_upper_halves(blue_green, later_blue_green),
                         lanes_lower_halves(red_wear, later_red_wear)},
                        lanes_upper_halves(red_wear, later_red_wear)};
    return made;
}

/* Twice the factors on the light of the pad's paint, as worn as the scene is there. */
static inline lanes worn(lanes wear, lanes twice_gain)
{
    return 2 * lanes_saturated(lanes_times(twice_gain, wear));
}

/* Put the pad's paint on what it covers, and its wear onto the factors. */
static inline void put_paints(const exposure16 *e, lanes kinds, eight *p, lanes *twice_gain)
{
    lanes on = lanes_all(0);
    for (uint16_t paint = DL_PAD_NONE + 1; paint < DL_PAD_PAINTS; paint++) {
        const lanes here = (lanes)(kinds == lanes_all(paint));
        on |= here;
        for (int c = 0; c < CHANNELS; c++) {
            p->colour[c] = lanes_choose(here, lanes_all(e->paint[paint][c]), p->colour[c]);
        }
    }
    *twice_gain = lanes_choose(on, worn(p->wear, *twice_gain), *twice_gain);
}

static inline lanes lit(lanes reflected, uint16_t of_one, lanes twice_gain)
{
    return lanes_saturated(lanes_times_rounded(reflected, lanes_times(lanes_all(of_one), twice_gain)));
}

/* Light that is kept at a part of itself, doubled up to its limit. */
static inline lanes redoubled(lanes light, int doubled)
{
    for (; doubled > 0; doubled--) {
        light = lanes_saturated(light + light);
    }
    return light;
}

static inline void store_light(const exposure16 *e, const lanes *colour, lanes twice_gain, uint16_t *const *light)
{
    lanes_store(light[0], redoubled(lit(colour[0], e->of_one[0], twice_gain), e->doubled));
    lanes_store(light[1], redoubled(lit(colour[1], e->of_one[1], twice_gain), e->doubled));
    lanes_store(light[2], redoubled(lit(colour[2], e->of_one[2], twice_gain), e->doubled));
}

/* The light of eight pixels that show one paint of the pad. */
static inline void expose_paint(const exposure16 *e, uint8_t paint, const uint16_t *scene, lanes twice_gain, uint16_t *const *light)
{
    lanes colour[CHANNELS];
    for (int c = 0; c < CHANNELS; c++) {
        colour[c] = lanes_all(e->paint[paint][c]);
    }
    store_light(e, colour, worn(load_eight(scene).wear, twice_gain), light);
}

static inline void expose_eight(const exposure16 *e, const uint16_t *scene, const uint8_t *kinds, const int16_t *gain,
                                uint16_t *const *light)
{
    const uint64_t each = UINT64_C(0x0101010101010101);
    const lanes twice_gain = 2 * lanes_load(gain);
    uint64_t all = DL_PAD_NONE;
    if (kinds) {
        memcpy(&all, kinds, sizeof all);
    }
    if (all == each * DL_PAD_NONE || all == each * DL_PAD_EDGE) {
        store_light(e, load_eight(scene).colour, twice_gain, light);
    } else if (all == each * kinds[0]) {
        expose_paint(e, kinds[0], scene, twice_gain, light);
    } else {
        eight p = load_eight(scene);
        lanes worn_gain = twice_gain;
        put_paints(e, lanes_load_bytes(kinds), &p, &worn_gain);
        store_light(e, p.colour, worn_gain, light);
    }
}

/* Fewer than eight pixels. */
static void expose_rest(const exposure16 *e, const dl_sim_lit_scene *seen, int64_t first, int32_t n, uint16_t *const *light)
{
    uint16_t scene[4 * EIGHT] = {0}, made[CHANNELS][EIGHT];
    uint8_t kinds[EIGHT] = {DL_PAD_NONE};
    int16_t gain[EIGHT] = {0};
    uint16_t *const all[CHANNELS] = {made[0], made[1], made[2]};
    memcpy(scene, seen->scene + 4 * first, (size_t)n * 4 * sizeof *scene);
    memcpy(gain, seen->gain + first, (size_t)n * sizeof *gain);
    if (seen->kinds) {
        memcpy(kinds, seen->kinds + first, (size_t)n);
    }
    expose_eight(e, scene, kinds, gain, all);
    for (int c = 0; c < CHANNELS; c++) {
        memcpy(light[c], made[c], (size_t)n * sizeof *made[c]);
    }
}

WIDE
void expose_planes(const exposure16 *e, const dl_sim_lit_scene *seen, int64_t first, int32_t n, uint16_t *light, int64_t apart)
{
    const exposure16 here = *e;
    int32_t i = 0;
    for (; i + EIGHT <= n; i += EIGHT) {
        uint16_t *const planes[CHANNELS] = {light + i, light + apart + i, light + 2 * apart + i};
        const int64_t at = first + i;
        expose_eight(&here, seen->scene + 4 * at, seen->kinds ? seen->kinds + at : 0, seen->gain + at, planes);
    }
    if (i < n) {
        uint16_t *const planes[CHANNELS] = {light + i, light + apart + i, light + 2 * apart + i};
        expose_rest(&here, seen, first + i, n - i, planes);
    }
}

void mix_paints(const exposure16 *e, const dl_sim_lit_scene *seen, int32_t from, int32_t to, const light_place *light)
{
    for (int32_t i = from; i < to; i++) {
        const int64_t pixel = seen->where[i];
        const float *share = seen->shares + DL_PAD_PAINTS * (int64_t)i;
        const float factor = (float)seen->gain[pixel] * (float)seen->scene[4 * pixel + 3];
        float own[CHANNELS + 1] = {0.0f};
        for (int k = 1; k < DL_PAD_PAINTS; k++) {
            for (int c = 0; c <= CHANNELS; c++) {
                own[c] += share[k] * e->paint_light[k][c];
            }
        }
        for (int c = 0; c < CHANNELS; c++) {
            uint16_t *mixed = light->first + light->step * pixel + light->apart * c;
            const float sum = share[DL_PAD_NONE] * (float)*mixed + own[c] * factor + 0.5f;
            *mixed = (uint16_t)(sum > 0.0f ? sum < (float)LIGHT_MOST ? sum : (float)LIGHT_MOST : 0.0f);
        }
    }
}

void dl_sim_render_expose(const dl_sim_lit_scene *seen, int16_t *light)
{
    const exposure16 e = exposure_of(seen);
    const int32_t pixels = seen->h * seen->w;
    uint16_t planes[CHANNELS][EIGHT];
    for (int32_t i = 0; i < pixels; i += EIGHT) {
        const int32_t n = pixels - i < EIGHT ? pixels - i : EIGHT;
        expose_planes(&e, seen, i, n, planes[0], EIGHT);
        for (int32_t k = 0; k < n; k++) {
            for (int c = 0; c < CHANNELS; c++) {
                light[CHANNELS * ((int64_t)i + k) + c] = (int16_t)planes[c][k];
            }
        }
    }
}

void dl_sim_render_mix(const dl_sim_lit_scene *seen, int16_t *light)
{
    const exposure16 e = exposure_of(seen);
    const light_place place = {(uint16_t *)light, CHANNELS, 1};
    mix_paints(&e, seen, 0, seen->edges, &place);
}
