/* The reset criterion for a belief that was wrong, and the recent consistency of sightings. */
#ifndef DECKLANDER_GATE_H
#define DECKLANDER_GATE_H

#include "filter/belief.h"

/* End the streak of rejected sightings. */
void streak_end(dl_belief *b);
/* One more rejected sighting, or a new streak if it contradicts the last one.
 *
 * offset_ned is the measured minus the predicted position, m; var_m2 the variance of one component of the measured one. */
void streak_extend(dl_belief *b, int64_t t, const double offset_ned[3], double var_m2);
/* Whether the streak outweighs the belief. A belief made by few sightings is reset by few. */
int streak_resets(const dl_filter_params *o, const dl_belief *b);
/* The recent mean of NIS over degrees of freedom after one more innovation (m), with S (m, m) widened by what a landing does not
 * notice: close to the deck a sighting claims a millimetre, and whether it is off by five does not contradict the estimate.
 * Some fourteen sightings renew half of it. */
double nis_mean_of(double nis_mean, const double *innov, const double *S, int m);

#endif
