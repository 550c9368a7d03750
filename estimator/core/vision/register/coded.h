/* What a video codec adds to the errors of a pose. */
#ifndef DECKLANDER_REGISTER_CODED_H
#define DECKLANDER_REGISTER_CODED_H

#include "vision/register/near.h"

/* Add the covariance of a pose whose picture a codec has moved by patches: each by `sigma_px` along both of the frame's axes. The fit
 * is taken to weigh all edges in the frame alike, by their length. All are in `cam`; `with_prior` is the covariance of a fit with this
 * information of the frame and the prior. */
void add_coded(const dl_lens *camera, const edge_points *edges, const fit_state *pose, double sigma_px,
               const double information[POSE * POSE], const double with_prior[POSE * POSE], double cov[POSE * POSE]);

#endif
