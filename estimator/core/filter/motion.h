/* The deck's motion by the ship's motion sensor. */
#ifndef DECKLANDER_MOTION_H
#define DECKLANDER_MOTION_H

#include "filter/belief.h"
#include "filter/propagate.h"
#include "filter/vision_update.h"

/* Fuse a report of the ship's motion sensor with the waves in the state; out of sight of the pad the bank learns by it. */
void fuse_motion(const dl_filter_params *o, dl_belief *b, covariance *c, sea_ref *bank, const dl_motion *report, dl_outcome *out);
/* Whether the deck's motion is known at instant t, ns: by a tracked pad, or by a motion sensor that reports. */
bool knows_deck(const dl_filter_params *o, const dl_belief *b, int64_t t);

#endif
