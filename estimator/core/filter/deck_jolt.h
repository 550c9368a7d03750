/* Widen the belief about the deck where sightings keep missing it by more than the filter claims.
 *
 * The oscillators of the main filter have the size and period that the bank has learned. A wave that nothing announced, such as
 * another ship's wake after a calm, is neither, and until the bank has learned it the filter takes the deck's motion for its own.
 * The innovations say so at once. Along each axis of `ned` the filter keeps by how much the newest squared innovations exceed
 * the largest that their claimed variances let expect. If the median is positive, the wave along that axis has received an
 * acceleration that the model does not have, and the covariance gains the median (covariance matching: Mehra, Approaches to
 * adaptive filtering, IEEE Trans. Automatic Control 17(5), 1972). The median ignores single wrong sightings, and a sighting
 * with little information on an axis neither adds to it nor scales it. */
#ifndef DECKLANDER_DECK_JOLT_H
#define DECKLANDER_DECK_JOLT_H

#include "decklander.h"

/* Count one more sighting; innov_ned in m, cov_ned (3, 3) in m^2 as the filter claims it. */
void jolt_extend(dl_innovation_excesses *excesses, int64_t t, const double innov_ned[3], const double cov_ned[9]);
/* The variance, m^2, by which the claimed one falls short along north, east, down; returns whether it does anywhere. */
int jolt_missing(const dl_innovation_excesses *excesses, double missing[3]);
/* Widen P for unknown accelerations that add so much variance, m^2, to the pad's displacement along north, east, down. */
void jolt_widen(const double x[DL_N], const double missing[3], double *P);

#endif
