/* Samples of one kind gathered over the aiding period and fused as one, and the gate in front of it.
 *
 * A Jacobian is sparse: a row holds the derivatives by the states of its kind alone, `COLUMNS_MAX` numbers at most. */
#ifndef DECKLANDER_GATHERING_H
#define DECKLANDER_GATHERING_H

#include "filter/belief.h"
#include "filter/propagate.h"

/* Fuse the means of all gathered samples together. */
void fuse_gathered(const dl_filter_params *o, dl_belief *b, covariance *c);
/* out = H P H', (m, m). */
void spread_of(int m, int kind, const double *H, const double *P, double *out);
/* Whether a kind still gathers against the same axes and surface. */
int still_gathers(const dl_filter_params *o, const dl_belief *b, int kind, int axes, double deck_weight);
/* Begin to gather a kind of sample, with m, axes and deck_weight set: the prediction's Jacobian and covariance hold for the
 * whole period. */
void begin_gathering(dl_aid *a, const dl_belief *b, const covariance *c, int kind, const double *H, const double *ambiguity);
/* Add a sample to those that are fused at the end of the aiding period, unless the gate rejects it.
 *
 * `begun` is the kind's gathering with this sample's prediction if it begins a period, else as it is in the belief. */
void gather(const dl_filter_params *o, dl_belief *b, covariance *c, int kind, const dl_aid *begun, const double *innov, const double *R,
            dl_outcome *out);

#endif
