/* Aiding by the vehicle's own sensors. Models and derivation: docs/estimator.md, section "Measurements". */
#ifndef DECKLANDER_AIDING_H
#define DECKLANDER_AIDING_H

#include "filter/belief.h"
#include "filter/propagate.h"

/* Each takes one sample at the belief's instant; `out` receives its outcome. */
void fuse_attitude(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_attitude *seen, dl_outcome *out);
void fuse_velocity(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_velocity *seen, dl_outcome *out);
void fuse_range(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_distance *seen, dl_outcome *out);
void fuse_height(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_distance *seen, dl_outcome *out);
/* The distance from the pad's centre at which the body's down axis meets the deck, and its sigma, m. */
void foot_of(const dl_belief *b, const double *P, const double x[DL_N], double *away, double *spread);

#endif
