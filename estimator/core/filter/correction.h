/* What every measurement needs: the deck's own motion by the state, the correction of a belief, and its statistics. */
#ifndef DECKLANDER_CORRECTION_H
#define DECKLANDER_CORRECTION_H

#include "base/kalman.h"
#include "filter/belief.h"
#include "filter/propagate.h"

/* Displacement and rate of the deck on waves. */
enum {
    SURGING = DL_WAVES + 1,
    SWAYING = DL_WAVES + 5,
    HEAVE = DL_WAVES + 8,
    HEAVING = DL_WAVES + 9,
    ROLL = DL_WAVES + 12,
    PITCH = DL_WAVES + 16
};

/* The velocity of the pad's centre in ned, m/s. */
void pad_velocity(const double x[DL_N], double v[3]);
/* The axes, in ned, about which roll and pitch turn the pad; its heading turns it about the down axis. */
void pad_axes(double pitch, double yaw, double by_roll[3], double by_pitch[3]);
/* b and its covariance after the correction dx, P; the covariance is rewritten about the turned attitude. */
void correct_belief(dl_belief *b, covariance *c, const double dx[DL_N], double *P);
/* A copy of the covariance, in a place where it may be changed. */
double *changeable(covariance *c);
/* Everything that is known of a state is forgotten but the variance that it gets. */
void forget_state(double *P, int state, double var);
/* Outcome of an event that was compared with nothing. */
void uncompared(dl_outcome *out, enum dl_verdict verdict);
/* Outcome of a measurement of m numbers; S is NULL where there is none, and neither are a NIS and its limit. */
void write_outcome(dl_outcome *out, int verdict, int m, int axes, const double *innov, const double *S, double nis, double nis_max);
/* Fuse a measurement that the gate lets through, and write its outcome; returns whether it is fused. Of `velocities_alone` it corrects
 * the horizontal velocities of body and vessel only. */
bool fuse_gated(const dl_filter_params *o, dl_belief *b, covariance *c, const measured *z, int axes, bool velocities_alone, dl_outcome *out);

#endif
