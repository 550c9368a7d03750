/* Turn the members' evidence into weights, and the weights into one oscillator for each direction. */

#include <math.h>

#include "filter/bank.h"

/* Weight that a forecast gives to the evidence for a member. */
static const double EVIDENCE_WEIGHT = 0.6;
/* Heave, roll, pitch decide whether the deck is at rest. Sideways an attitude that errs looks like a deck that moves. */
static const int UPRIGHT = 2;

double largest(int n, const double *values)
{
    double found = values[0];
    for (int i = 1; i < n; i++) {
        found = fmax(found, values[i]);
    }
    return found;
}

/* The log-odds of rest that were there before any sighting. */
static double prior_log_odds(const dl_bank_members *m)
{
    return m->log_prior[0] - log1p(-exp(m->log_prior[0]));
}

double prior_size(const dl_bank_members *m, int k)
{
    double sum = 0.0;
    for (int g = 0; g < DL_MEMBERS; g++) {
        sum += exp(m->log_prior[g]) * m->sigma[k * DL_MEMBERS + g] * m->sigma[k * DL_MEMBERS + g];
    }
    return sqrt(sum);
}

void summarise(const dl_bank_members *m, dl_bank *s)
{
    double odds = 0.0, moving[DL_DIRECTIONS];
    for (int k = 0; k < DL_DIRECTIONS; k++) {
        const double *log_weight = s->log_weight + k * DL_MEMBERS, top = largest(DL_MEMBERS, log_weight);
        double *weight = s->weight + k * DL_MEMBERS;
        moving[k] = 0.0;
        for (int g = 1; g < DL_MEMBERS; g++) {
            weight[g] = exp(log_weight[g] - top);
            moving[k] += weight[g];
        }
        /* Each direction's odds of rest without its prior; the prior comes in once, for all of them. */
        odds += k < UPRIGHT ? 0.0 : log_weight[0] - top - log(moving[k]);
    }
    odds -= (DL_DIRECTIONS - UPRIGHT - 1) * prior_log_odds(m);
    const double rest = 1.0 / (1.0 + exp(fmin(-odds, 500.0)));
    for (int k = 0; k < DL_DIRECTIONS; k++) {
        const double *sigma = m->sigma + k * DL_MEMBERS;
        double *weight = s->weight + k * DL_MEMBERS, total = 0.0, w2 = 0.0, log_zeta = 0.0;
        weight[0] = rest;
        for (int g = 0; g < DL_MEMBERS; g++) {
            weight[g] *= g == 0 ? 1.0 : (1.0 - rest) / moving[k];
            const double energy = weight[g] * sigma[g] * sigma[g];
            total += energy;
            w2 += energy * m->w[g] * m->w[g];
            log_zeta += energy * m->log_zeta[g];
        }
        s->w_rad_s[k] = sqrt(w2 / total);
        s->zeta[k] = exp(log_zeta / total);
        s->sigma[k] = sqrt(total);
    }
}

void forecast_weights(const dl_bank_members *m, const double *log_weight, double rest, double weight[DL_MEMBERS])
{
    double sum = 0.0;
    for (int g = 0; g < DL_MEMBERS; g++) {
        weight[g] = EVIDENCE_WEIGHT * (log_weight[g] - m->log_prior[g]);
    }
    const double top = largest(DL_MEMBERS - 1, weight + 1);
    for (int g = 1; g < DL_MEMBERS; g++) {
        weight[g] = exp(weight[g] - top);
        sum += weight[g];
    }
    weight[0] = rest;
    for (int g = 1; g < DL_MEMBERS; g++) {
        weight[g] *= (1.0 - rest) / sum;
    }
}
