/* Initialising the belief about the pad, and resetting it. */
#ifndef DECKLANDER_RESET_H
#define DECKLANDER_RESET_H

#include "filter/propagate.h"

/* The pad from the body in ned, by a picture, less `late` (3,) in the camera's axes, or by a baseline; returns its distance squared. */
double place_of(const dl_filter_params *o, const dl_belief *b, const dl_sighting *s, const double late[3], double place[3]);
/* Initialise the pad's position from a sighting; with `reset`, drop the rest of the belief about the pad as well. The states of
 * the body itself stay. */
void initialise_pad(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_sighting *s, int reset);
/* Set the pad's yaw from a sighting, whatever the state was. */
void reset_heading(dl_belief *b, covariance *c, const dl_sighting *s);

#endif
