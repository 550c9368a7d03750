/* What a ship reports of itself. */
#ifndef DECKLANDER_VESSEL_H
#define DECKLANDER_VESSEL_H

#include "filter/belief.h"
#include "filter/propagate.h"

/* Fuse a vessel's report: the velocity that its own navigation has, steady and wave motion together, its heading, its rate of turn. One
 * that shows a manoeuvre loosens what is believed of her way first, unless sight contradicted her reports a moment ago. */
void fuse_vessel(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_vessel_report *report, dl_outcome *out);

#endif
