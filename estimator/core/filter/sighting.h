/* The measurement model of a sighting. Derivation: docs/estimator.md, section "Measurements". */
#ifndef DECKLANDER_SIGHTING_H
#define DECKLANDER_SIGHTING_H

#include "filter/belief.h"

/* The largest number of numbers that a sighting measures: a place and an orientation. */
enum { SEEN_MAX = 6 };

/* A sighting compared with a belief: m numbers, measured less predicted, their Jacobian (m, N) and noise (m, m), and the Jacobian of
 * the rate of the position (3, N). */
typedef struct {
    int m;
    double innov[SEEN_MAX], H[SEEN_MAX * DL_N], R[SEEN_MAX * SEEN_MAX], by_rate[3 * DL_N];
} sighting_rows;

/* R_level_body that vision used. */
void levelling(const dl_belief *b, double A[9]);
/* The pad's position in body axes by the mounting in the camera's file, m. */
void seen_from_body(const dl_sighting *s, const double A[9], double seen[3]);
/* The rotation from the camera's axes, as its file has them in the body, to ned. */
void camera_to_ned(const dl_belief *b, double back[9]);

/* The measurement of the pad's position in body axes, and of its heading or whole orientation.
 *
 * A sighting is written in `level`, which vision found with the vehicle's own attitude. The inverse rotation by that attitude
 * gives what the camera saw, without that attitude's error.
 *
 * When the frame is later than its stamp, the deck in it is later too. The state holds the deck that the camera shows: its waves
 * cannot be distinguished from the same waves a little later. So only the body's motion is corrected by the delay; the answers move the
 * deck.
 *
 * cov_levelled_by (3, 3) is the part of the covariance that comes from the levelling attitude; yaw_sigma, rad: an ambiguous heading
 * is of use only when it is small. */
void sighting_model(const dl_belief *b, const dl_sighting *s, const double *cov_levelled_by, double yaw_sigma, int place_only,
                    sighting_rows *out);

#endif
