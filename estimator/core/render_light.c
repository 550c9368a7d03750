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

static inline int is_paint(int kind)
{
    return kind != PAD_NONE && kind != PAD_EDGE;
}

void render_expose(int32_t pixels, const uint16_t *scene, const uint8_t *kinds, const int16_t *gain, const float *exposure,
                   const uint16_t *pad_scene, int16_t *light)
{
    const exposure16 e = exposure_of(exposure);
    for (int32_t i = 0; i < pixels; i += 2) {
        const int alone = i + 1 == pixels;
        const int kind = kinds ? kinds[i] : PAD_NONE, next = alone ? kind : kinds ? kinds[i + 1] : PAD_NONE;
        const uint16_t *pixel = scene + 4 * (int64_t)i, *other = alone ? pixel : pixel + 4;
        uint16_t factor = (uint16_t)gain[i], other_factor = (uint16_t)gain[i + !alone];
        lanes two = alone ? lanes_load_four(pixel) : lanes_load(pixel);
        if (is_paint(kind) || is_paint(next)) {
            factor = is_paint(kind) ? worn(pixel, gain[i]) : factor;
            other_factor = is_paint(next) ? worn(other, gain[i + !alone]) : other_factor;
            two = lanes_join(is_paint(kind) ? pad_scene + 4 * kind : pixel, is_paint(next) ? pad_scene + 4 * next : other);
        }
        two = lit(&e, two, lanes_of_two(factor, other_factor));
        /* The fourth number of a pixel falls where the next pixel's light follows. */
        lanes_store_four(light + CHANNELS * (int64_t)i, two);
        if (!alone) {
            lanes_store_four(light + CHANNELS * (int64_t)(i + 1), lanes_upper(two));
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
