/* Learning the deck's motion: a bank of oscillators for each direction, weighted by the likelihood of each.
 *
 * Every member is a Kalman filter of its own on one number: where the pad was seen plus where the IMU has carried the body since
 * the start; the IMU's drift (an offset, its rate, a wandering acceleration) is part of each member's state. The main filter is
 * not involved, so its estimate of the sea cannot confirm itself. Member 0 says that the deck stands still: it does so in all
 * directions or in none, because no vessel surges without heaving. In `sea` the numbers of one kind lie side by side for all
 * members, and of a covariance, which is symmetric, the upper triangle in rows.
 *
 * Source: Magill, Optimal adaptive estimation of sampled stochastic processes, IEEE Trans. Automatic Control 10(4), 1965. */
#ifndef DECKLANDER_BANK_H
#define DECKLANDER_BANK_H

#include "filter/belief.h"

/* Members look at most this often, s; a wave is seen dozens of times anyway. */
#define BANK_PERIOD_S 0.2

/* Write the bank before any sighting. */
void bank_begin(const dl_bank_members *m, dl_bank *out);
/* One look at the deck: by a sighting, or by the ship's motion sensor, which needs no IMU. */
typedef struct {
    int by_sensor;
    /* What was measured and its variance, by direction. */
    double y[DL_DIRECTIONS], var[DL_DIRECTIONS];
    /* Variance that the IMU's velocity gained beyond its noise since the last look, (m/s)^2; distance to the pad, m. */
    double ins_var, reach_m;
} bank_look;

/* Variance from which a direction was not seen. */
#define UNSEEN_VAR 1e5
/* Move the bank on to instant t, ns, and correct it by a look. */
void bank_observe(const dl_filter_params *o, int64_t t, const bank_look *seen, const dl_bank *before, dl_bank *after);
/* The weights of one direction's members for a forecast, with `rest` for the member at rest.
 *
 * No sea is exactly one of the members, so the evidence counts for less than if one of them were the truth.
 * Source: Grunwald and van Ommen, Inconsistency of Bayesian inference for misspecified linear models, Bayesian Analysis, 2017. */
void forecast_weights(const dl_bank_members *m, const double *log_weight, double rest, double weight[DL_MEMBERS]);
/* The members' weights, and frequency, damping and size of each direction's mixture. Its variances of displacement and rate are kept:
 * while the period is unknown, the quick members count. */
void summarise(const dl_bank_members *m, dl_bank *s);
/* The size of the waves in direction k before any look, m or rad. */
double prior_size(const dl_bank_members *m, int k);
/* The largest of n numbers. */
double largest(int n, const double *values);
/* The place of (i, j) in the rows of the upper triangle of a member's covariance. */
int member_pair(int i, int j);

#endif
