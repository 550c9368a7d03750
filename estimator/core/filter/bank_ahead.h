/* The bank's forecast of the waves: every member contributes by its weight. */
#ifndef DECKLANDER_BANK_AHEAD_H
#define DECKLANDER_BANK_AHEAD_H

#include "decklander.h"

/* Transition and noise of every oscillator over the time since the bank's last look; for the members, the transition and the noise
 * of the rate. */
typedef struct {
    double A[OSCILLATORS][4][4], q[OSCILLATORS][4][4];
    double by_member[4][4][MEMBERS], noise[4][MEMBERS];
} oscillator_steps;

/* One direction's members at an instant. Those of one oscillator, which differ in size alone, are taken together, as a forecast
 * is linear in their states. Arrays are by oscillator. */
typedef struct {
    /* Sums of the weights and of the weights times the variance of the size. */
    double weight[OSCILLATORS], energy[OSCILLATORS];
    /* The weighted mean state, and the upper triangle in rows of the sum of the weighted covariances about it. */
    double mean[4][OSCILLATORS], spread[WAVE_PAIRS][OSCILLATORS];
    /* The displacement's mean. */
    double displacement;
} waves_now;

/* One direction at a horizon. */
typedef struct {
    /* The mean of displacement and rate, and its derivative by the present rate. */
    double mean[2], by_rate[2];
    /* The variance without the part that the uncertainty of the present rate adds. */
    double var[2];
    /* The displacement minus the present one, and its variance, as above. */
    double change, var_change;
} waves_then;

/* From the bank's last look to instant t, ns. */
void steps_to(const dl_bank_members *m, const dl_bank *s, int64_t t, oscillator_steps *steps);
/* The members of direction k after these steps, with the present rate of the main filter, which has seen more. */
void waves_at(const dl_bank_members *m, const dl_bank *s, const oscillator_steps *steps, int k, double rate, waves_now *now);
/* The direction at a horizon, without regard to the forecasts' skill. */
void waves_ahead(waves_now *now, const dl_horizon_reach *there, waves_then *then);
/* Scale a forecast by the skill of past ones; what is left out is uncertain. */
void scale_by_skill(const waves_now *now, const double factors[2], waves_then *then);

#endif
