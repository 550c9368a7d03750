/* Fusing a sighting: gate it, reset the belief after a consistent streak of rejections, correct, and feed the bank. */
#ifndef DECKLANDER_VISION_H
#define DECKLANDER_VISION_H

#include "filter/learn.h"
#include "filter/propagate.h"

/* Fuse a sighting at the belief's instant, to which the belief was propagated with all gathered samples fused. */
void fuse_sighting(const dl_filter_params *o, dl_belief *b, covariance *c, sea_ref *bank, const dl_sighting *s, dl_outcome *out);

#endif
