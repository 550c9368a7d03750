/* Fusing a sighting: gate it, reset the belief after a consistent streak of rejections, correct, and feed the bank. */
#ifndef DECKLANDER_VISION_H
#define DECKLANDER_VISION_H

#include "filter/bank.h"
#include "filter/propagate.h"

/* The bank that belongs to a belief. What writes it takes the place. */
typedef struct {
    const dl_bank *now;
    dl_bank *place;
} sea_ref;

/* Let the bank learn by a look, and take the size and period of the waves from it. */
void learn_waves(const dl_filter_params *o, dl_belief *b, sea_ref *bank, const bank_look *look);
/* Fuse a sighting at the belief's instant, to which the belief was propagated with all gathered samples fused. */
void fuse_sighting(const dl_filter_params *o, dl_belief *b, covariance *c, sea_ref *bank, const dl_sighting *s, dl_outcome *out);

#endif
