/* The bank's forecast of the waves: every member contributes by its weight. */
#ifndef DECKLANDER_BANK_AHEAD_H
#define DECKLANDER_BANK_AHEAD_H

#include "filter/belief.h"

/* Transition and noise of every oscillator over the time since the bank's last look; for the members, the transition and the noise
 * of the rate. */
typedef struct {
    double A[DL_OSCILLATORS][4][4], q[DL_OSCILLATORS][4][4];
    double by_member[4][4][DL_MEMBERS], noise[4][DL_MEMBERS];
} oscillator_steps;

/* One direction's members at an instant. Those of one oscillator, which differ in size alone, are taken together, as a forecast
 * is linear in their states. Arrays are by oscillator. */
typedef struct {
    /* Sums of the weights and of the weights times the variance of the size. */
    double weight[DL_OSCILLATORS], energy[DL_OSCILLATORS];
    /* The weighted mean state, and the upper triangle in rows of the sum of the weighted covariances about it. */
    double mean[4][DL_OSCILLATORS], spread[WAVE_PAIRS][DL_OSCILLATORS];
    /* The displacement's mean. */
    double displacement;
} waves_now;

/* What a forecast needs of one horizon, by oscillator: it depends on nothing but the horizon and the members. */
typedef struct {
    double horizon_s;
    /* The rows of the transition to displacement and rate, and their noise. */
    double row[2 * WAVE_STATES * DL_OSCILLATORS], noise[2 * DL_OSCILLATORS];
    /* The products of the numbers of these rows and of the first one's change. */
    double squares[3 * WAVE_PAIRS * DL_OSCILLATORS];
} horizon_reach;

enum { REACHES = 32 };

/* The newest horizons: guidance forecasts the same again and again. */
typedef struct {
    int n, next;
    horizon_reach kept[REACHES];
} reach_table;

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
/* The reach of a horizon, s; it lasts until the next one is requested. */
const horizon_reach *reach_of(const dl_bank_members *m, reach_table *table, double horizon_s);
/* The direction at a horizon, without regard to the forecasts' skill. */
void waves_ahead(waves_now *now, const horizon_reach *there, waves_then *then);
/* Scale a forecast by the skill of past ones; what is left out is uncertain. */
void scale_by_skill(const waves_now *now, const double factors[2], waves_then *then);

#endif
