/* The light of a scene, in planes of one colour each or pixel by pixel. */

#ifndef RENDER_LIGHT_H
#define RENDER_LIGHT_H

#include "decklander_sim.h"

enum { CHANNELS = 3, LIGHT_MOST = 32767 };

/* A scene of some pixels, the paint of the pad on it, or none, and what light falls on both. */
typedef struct {
    const uint16_t *scene;
    const uint8_t *kinds;
    const int16_t *gain;
} lit_scene;

/* The light of paint at full gain: the upper half of what is reflected times `of_one`, doubled so many times; and the light of the
 * pad's paints, in parts of a count's GAIN_ONE x SCENE_ONE. */
typedef struct {
    uint16_t of_one[CHANNELS], paint[PAD_PAINTS][CHANNELS];
    float paint_light[PAD_PAINTS][CHANNELS + 1];
    int doubled;
} exposure16;

exposure16 exposure_of(const float *exposure, const uint16_t *pad_scene);

/* The light of n pixels, 0 to LIGHT_MOST, in a plane of each colour. */
void expose_planes(const exposure16 *e, int32_t n, const lit_scene *seen, uint16_t *blue, uint16_t *green, uint16_t *red);

/* Where the light of a pixel lies: `step` numbers after that of the pixel before, its colours `apart` from each other. */
typedef struct {
    uint16_t *first;
    int64_t step, apart;
} light_place;

/* Mix the light of pixels that show several paints from what they show around the pad and the paints, by their shares. */
void mix_paints(const exposure16 *e, int32_t edges, const int32_t *where, const float *shares, const lit_scene *seen,
                const light_place *light);

#endif
