/* Forecast skill: past forecasts of the waves compared with what happened. `Skill` in estimator/ekf/params.py explains it. */
#ifndef DECKLANDER_SKILL_H
#define DECKLANDER_SKILL_H

#include "filter/belief.h"

/* Horizons of the forecasts that are compared, s. */
extern const double SKILL_HORIZONS_S[SKILL_HORIZONS];

/* Forecasts that have been compared, by horizon, direction, and displacement or rate. */
typedef struct {
    /* Root mean square of the outcome minus the forecast. */
    double rms[SKILL_HORIZONS][DL_DIRECTIONS][2];
    /* How far it is trusted, 0..1. */
    double trust[SKILL_HORIZONS];
} forecast_misses;

/* Whether the next forecast is to be made at t. */
int skill_due(const dl_forecast_skill *known, int64_t t);
/* Compare the present motion (displacement and rate by direction) with earlier forecasts of it, and add one. */
void skill_compare(dl_forecast_skill *known, int64_t t, double now[DL_DIRECTIONS][2], double ahead[SKILL_HORIZONS][DL_DIRECTIONS][2]);
/* The factors, 0..1, by which to scale a forecast of displacement and rate, by horizon and direction; waves of frequency w, rad/s.
 *
 * A regression of what came on what was forecast, with a prior. */
void skill_factors(const dl_forecast_skill *known, const double w[DL_DIRECTIONS], double factors[SKILL_HORIZONS][DL_DIRECTIONS][2]);
/* The factors at any horizon, s: 1 at zero, constant beyond the longest that was compared. */
void skill_between(double factors[SKILL_HORIZONS][DL_DIRECTIONS][2], double horizon_s, double found[DL_DIRECTIONS][2]);
/* By how much past forecasts, scaled by these factors, have missed what came. */
void skill_misses(const dl_forecast_skill *known, double factors[SKILL_HORIZONS][DL_DIRECTIONS][2], forecast_misses *misses);
/* The variance of a forecast of displacement (r = 0) or rate (1) in a direction at a horizon, s: the one that is claimed, or a larger
 * one as far as the misses, however few they are, show it. */
double missed_var(const forecast_misses *misses, double horizon_s, int direction, int r, double claimed);

#endif
