/* The measurement model of a baseline between two GNSS antennas, one on the drone and one on the ship. */
#ifndef DECKLANDER_BASELINE_H
#define DECKLANDER_BASELINE_H

#include "filter/sighting.h"

/* Variance along north, east and down that fixed solutions share for minutes, m^2. */
static const double WANDER_VAR[3] = {0.01 * 0.01, 0.01 * 0.01, 0.015 * 0.015};

/* The pad from the body in ned at the time of the pictures, whose deck the state holds, m. */
void baseline_place(const dl_filter_params *o, const dl_belief *b, const dl_sighting *s, double place[3]);
/* The comparison of a baseline with the belief, in the axes in which the camera's are written. Delay and mounting of the camera are not
 * in it. What the deck's tilt and heading do to the ship's antenna is, by the belief's own: where the heading is not known, it is noise. */
void baseline_model(const dl_filter_params *o, const dl_belief *b, const double *P, const dl_sighting *s, sighting_rows *out);

#endif
