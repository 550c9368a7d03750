/* The processing of one event that is not older than the belief. */
#ifndef DECKLANDER_RUN_H
#define DECKLANDER_RUN_H

#include "filter/vision_update.h"

/* State and covariance at t, with the means of all gathered samples fused: otherwise another correction would count twice. */
void ready_to_fuse(const dl_filter_params *o, dl_belief *b, covariance *c, int64_t t);
/* Process an event; a refused one leaves the state as it is propagated. */
void process_event(const dl_filter_params *o, dl_belief *b, covariance *c, sea_ref *bank, const dl_event *e, dl_outcome *out);

#endif
