/* A scene under a light: the light that its pixels send into the lens of the simulated camera.
 *
 * A pixel of a scene is four numbers of sixteen bits: what it reflects of blue, green and red, and the wear of its paint, parts of
 * SCENE_ONE. Light is counted in three of them; factors on it are parts of GAIN_ONE.
 */

#include "interface.h"
#include "lanes.h"

enum { CHANNELS = 3, MOST = 32767, SHARPEST = 32767 };

/* The light of a scene at full gain: the upper half of reflected times `of_one`, doubled so many times. */
typedef struct {
    lanes of_one;
    int doubled;
} exposure16;

/* The exposure as factors below a half, to keep all of sixteen bits; what that takes off is doubled again. */
static exposure16 exposure_of(const float *exposure)
{
    uint16_t factors[8];
    float most = 0.0f, scale = 65536.0f;
    exposure16 made = {lanes_all(0), 0};
    for (int c = 0; c < CHANNELS; c++) {
        most = exposure[c] > most ? exposure[c] : most;
    }
    for (; most * scale > (float)SHARPEST && made.doubled < 15; scale *= 0.5f) {
        made.doubled++;
    }
    for (int c = 0; c < 8; c++) {
        const float factor = 2.0f * scale * exposure[c % 4] + 0.5f;
        factors[c] = (uint16_t)(factor < 65535.0f ? factor : 65535.0f);
    }
    made.of_one = lanes_load(factors);
    return made;
}

/* The light of pixels under factors on it, in all lanes of each pixel; 32767 at most. */
static inline lanes lit(const exposure16 *e, lanes pixels, lanes gain)
{
    lanes light = lanes_times_rounded(pixels, lanes_times(e->of_one, lanes_add(gain, gain)));
    for (int i = 0; i < e->doubled; i++) {
        light = lanes_add_limited(light, light);
    }
    return lanes_at_most(light, MOST);
}

/* A factor on the light of the pad's paint, as worn as the scene is there. */
static inline uint16_t worn(const uint16_t *scene, int16_t gain)
{
    const uint32_t factor = (uint32_t)gain * scene[3] / SCENE_ONE;
    return (uint16_t)(factor < MOST ? factor : MOST);
}

/* The number of pixels from the first on that show what lies around the pad, in part at least. */
static inline int32_t around_pad(const uint8_t *kinds, int32_t pixels)
{
    int32_t n = 0;
    while (n < pixels && (kinds[n] == PAD_NONE || kinds[n] == PAD_EDGE)) {
        n++;
    }
    return n;
}

static inline int32_t alike(const uint8_t *kinds, int32_t pixels)
{
    int32_t n = 1;
    while (n < pixels && kinds[n] == kinds[0]) {
        n++;
    }
    return n;
}

/* Store the light of two pixels; the fourth number of each falls where the next pixel's light follows. */
static inline void store_two(int16_t *light, lanes two)
{
    lanes_store_four(light, two);
    lanes_store_four(light + CHANNELS, lanes_upper(two));
}

static void expose_scene(const exposure16 *e, int32_t pixels, const uint16_t *scene, const int16_t *gain, int16_t *light)
{
    int32_t i = 0;
    for (; i + 2 <= pixels; i += 2, light += 2 * CHANNELS) {
        store_two(light, lit(e, lanes_load(scene + 4 * i), lanes_of_two((uint16_t)gain[i], (uint16_t)gain[i + 1])));
    }
    if (i < pixels) {
        lanes_store_four(light, lit(e, lanes_load_four(scene + 4 * i), lanes_all((uint16_t)gain[i])));
    }
}

static void expose_paint(const exposure16 *e, int32_t pixels, const uint16_t *paint, const uint16_t *scene, const int16_t *gain,
                         int16_t *light)
{
    const lanes two = lanes_join(paint, paint);
    int32_t i = 0;
    for (; i + 2 <= pixels; i += 2, light += 2 * CHANNELS) {
        store_two(light, lit(e, two, lanes_of_two(worn(scene + 4 * i, gain[i]), worn(scene + 4 * i + 4, gain[i + 1]))));
    }
    if (i < pixels) {
        lanes_store_four(light, lit(e, two, lanes_all(worn(scene + 4 * i, gain[i]))));
    }
}

void render_expose(int32_t pixels, const uint16_t *scene, const uint8_t *kinds, const int16_t *gain, const float *exposure,
                   const uint16_t *pad_scene, int16_t *light)
{
    const exposure16 e = exposure_of(exposure);
    for (int32_t i = 0; i < pixels;) {
        const int32_t n = kinds ? around_pad(kinds + i, pixels - i) : pixels;
        expose_scene(&e, n, scene + 4 * (int64_t)i, gain + i, light + CHANNELS * (int64_t)i);
        i += n;
        if (i < pixels) {
            const int32_t same = alike(kinds + i, pixels - i);
            const int64_t at = i;
            expose_paint(&e, same, pad_scene + 4 * kinds[i], scene + 4 * at, gain + i, light + CHANNELS * at);
            i += same;
        }
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
