/* The light of a scene, in planes of one colour each or pixel by pixel. */

#ifndef RENDER_LIGHT_H
#define RENDER_LIGHT_H

#include "decklander_sim.h"

enum { CHANNELS = 3, LIGHT_MOST = 32767 };

/* The light of paint at full gain: the upper half of what is reflected times `of_one`, doubled this many times; and the light of the
 * pad's paints, in parts of a count's DL_GAIN_ONE x DL_SCENE_ONE. */
typedef struct {
    uint16_t of_one[CHANNELS], paint[DL_PAD_PAINTS][CHANNELS];
    float paint_light[DL_PAD_PAINTS][CHANNELS + 1];
    int doubled;
} exposure16;

exposure16 exposure_of(const dl_sim_lit_scene *seen);

/* The light of n pixels from the first on, 0 to LIGHT_MOST, in a plane of each colour; planes are `apart` numbers. */
void expose_planes(const exposure16 *e, const dl_sim_lit_scene *seen, int64_t first, int32_t n, uint16_t *light, int64_t apart);

/* Where the light of a pixel lies: `step` numbers after that of the pixel before, its colours `apart` from each other. */
typedef struct {
    uint16_t *first;
    int64_t step, apart;
} light_place;

/* Mix the light of pixels that show several paints from what they show around the pad and the paints, by their shares: of the edges
 * `from` to `to`, without the last. */
void mix_paints(const exposure16 *e, const dl_sim_lit_scene *seen, int32_t from, int32_t to, const light_place *light);

#endif
