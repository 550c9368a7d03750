/* Widen the belief about the deck where sightings keep missing it by more than the filter claims.
 *
 * The oscillators of the main filter have the size and period that the bank has learned. A wave that nothing announced, such as
 * another ship's wake after a calm, is neither, and until the bank has learned it the filter takes the deck's motion for its own.
 * The innovations say so at once. Along each axis of `ned` the filter keeps by how much the newest squared innovations exceed
 * the largest that their claimed variances let expect. If the median is positive, the wave along that axis has received an
 * acceleration that the model does not have, and the covariance gains the median (covariance matching: Mehra, Approaches to
 * adaptive filtering, IEEE Trans. Automatic Control 17(5), 1972). The median ignores single wrong sightings, and a sighting
 * with little information on an axis neither adds to it nor scales it.
 *
 * A ship that brakes or turns hard is no wave, and shows sooner. A matched filter in whitened innovations tells an acceleration of the
 * ship herself, along her way, across it and in heading (Willsky, Jones, A generalized likelihood ratio approach to the detection and
 * estimation of jumps in linear systems, IEEE Trans. Automatic Control 21(1), 1976). Low over the deck few features are in view, and a
 * sighting may be wrong altogether: one that no such acceleration explains shows none. Where the newest ones together show it, her
 * steady velocity or rate of turn gains the variance that explains the newest. */
#ifndef DECKLANDER_DECK_JOLT_H
#define DECKLANDER_DECK_JOLT_H

#include "filter/belief.h"

/* A ship that is slower has no way, m/s: north and east are as good. */
#define UNDER_WAY_M_S 0.3

enum { STEERINGS = EXCESS_NUMBERS - 3 };

/* Of accelerations of the ship along `way`, a unit vector north and east, across it and in heading: the displacement in the
 * deviations that are usual, 0 of a sighting that they do not explain, and the variance, m^2 and rad^2, that they add to the displacement. */
typedef struct {
    double way[2], deviate[STEERINGS], var[STEERINGS];
} steering;

/* How an innovation (m), of covariance S (m, m) and Jacobian H (m, N), shows accelerations of the ship; it counts in the belief's mean. */
void jolt_steering(int m, const double *innov, const double *S, const double *H, dl_belief *b, steering *out);
/* Count one more sighting; innov_ned in m, cov_ned (3, 3) in m^2 as the filter claims it. */
void jolt_extend(dl_innovation_excesses *excesses, int64_t t, const double innov_ned[3], const double cov_ned[9],
                 const double deviate[STEERINGS]);
/* Leave only the variances of what the sighting at t and those before it show together; return whether they show anything. */
int jolt_steered(const dl_innovation_excesses *excesses, int64_t t, steering *newest);
/* Widen P for accelerations of the ship that add so much variance to displacement and heading. */
void jolt_steer(const steering *shown, double *P);
/* Note that the ship manoeuvres now, and her velocity before if she did not a moment ago. */
void jolt_note_manoeuvre(dl_belief *b);
/* The variance, m^2, by which the claimed one falls short along north, east, down; returns whether it does anywhere. */
int jolt_missing(const dl_innovation_excesses *excesses, double missing[3]);
/* Widen P for unknown accelerations that add so much variance, m^2, to the pad's displacement along north, east, down. */
void jolt_widen(const double missing[3], double *P);

#endif
