/* What a ship reports of itself. */
#ifndef DECKLANDER_VESSEL_H
#define DECKLANDER_VESSEL_H

#include "decklander.h"
#include "filter/propagate.h"

/* Fuse a vessel's report: the velocity that its own navigation has, steady and wave motion together, its heading, or both.
 *
 * values are velocity in ned (3), its covariance (9), heading and its sigma, and whether there is either. */
void take_vessel(const filter_params *o, belief *b, covariance *c, const double values[16], outcome *out);

#endif
