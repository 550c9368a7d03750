/* The beginning of the state, and the attitude that is set outright. */
#ifndef DECKLANDER_BEGIN_H
#define DECKLANDER_BEGIN_H

#include "filter/belief.h"

/* Begin the belief, its covariance and its bank with an event that shows which way is down: an attitude, or an IMU sample at about 1 g.
 * Return false, with that outcome, for any other event. */
bool begin_belief(const dl_filter_params *o, const dl_event *e, dl_belief *b, double *P, dl_bank *bank, dl_outcome *out);
/* Replace the attitude of a belief outright by one of its instant. If it is the first that has a heading, the whole belief turns to it. */
void set_attitude(const dl_filter_params *o, dl_belief *b, double *P, const dl_attitude *seen);

#endif
