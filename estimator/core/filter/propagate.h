/* Propagation of the belief between measurements. Derivation: docs/estimator.md, section "Motion". */
#ifndef DECKLANDER_PROPAGATE_H
#define DECKLANDER_PROPAGATE_H

#include "filter/belief.h"
#include "base/rotation.h"

/* The covariance that belongs to a belief. What writes it takes the free one of two places. */
typedef struct {
    const double *P;
    double *places[2];
} covariance;

/* A place for the next covariance, which is not where the present one lies. */
double *free_place(const covariance *c);
/* Whether something happened: the instant, ns, of what never did is -1. */
int happened(int64_t t);
/* Seconds from one instant to another, ns. */
double seconds(int64_t since, int64_t until);
/* Whether sightings showed a manoeuvre of the ship that may still go on at t. */
int steers(const dl_belief *b, int64_t t);
/* Whether the pad went out of sight while its ship swung it aside, and whether the swing may still go on at t, so that nobody knows the
 * speed of the pad. */
int is_adrift(const dl_belief *b, int64_t t);
int is_swung(const dl_belief *b, int64_t t);
/* Propagate the nominal state to instant t by a rate and a specific force; coast if no IMU sample holds. */
void propagate_state(const dl_filter_params *o, dl_belief *b, int64_t t, const double w[3], const double f[3]);
/* Everything but P from t_cov to t, with the F and Q that propagate P. */
void propagated_belief(const dl_filter_params *o, dl_belief *b, double *F, double *Q);
/* Bring x and P from t_cov to t. */
void propagate_covariance(const dl_filter_params *o, dl_belief *b, covariance *c);
/* Propagate to t by the IMU sample that holds, and the covariance as often as the parameters require. */
void propagate_to(const dl_filter_params *o, dl_belief *b, covariance *c, int64_t t);
/* x = the state at t without propagating the covariance; the sea's motion has an error of order (t - t_cov)^2. */
void state_at_first_order(const dl_belief *b, double x[DL_N]);

#endif
