/* Aiding by the vehicle's own sensors. Models and derivation: docs/estimator.md, section "Measurements". */
#ifndef DECKLANDER_AIDING_H
#define DECKLANDER_AIDING_H

#include "decklander.h"
#include "filter/propagate.h"

/* Each takes one sample at the belief's instant; `out` tells what became of it. */
void take_attitude(const filter_params *o, belief *b, covariance *c, const double *R_ned_body, const double *cov, outcome *out);
void take_velocity(const filter_params *o, belief *b, covariance *c, const double v[3], const double *cov, outcome *out);
void take_range(const filter_params *o, belief *b, covariance *c, double range_m, double sigma_m, outcome *out);
void take_height(const filter_params *o, belief *b, covariance *c, double height_m, double sigma_m, outcome *out);
/* The distance from the pad's centre at which the body's down axis meets the deck, and its sigma, m. */
void foot_of(const belief *b, const double *P, const double x[N], double *away, double *spread);

#endif
