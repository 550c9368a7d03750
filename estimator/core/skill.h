/* Forecast skill: past forecasts of the waves compared with what happened. estimator/ekf/skill.py says what it is for. */
#ifndef DECKLANDER_SKILL_H
#define DECKLANDER_SKILL_H

#include "interface.h"

/* Horizons of the forecasts that are compared, s. */
extern const double SKILL_HORIZONS_S[SKILL_HORIZONS];

/* Whether the next forecast is to be made at t. */
int skill_due(const forecast_skill *known, int64_t t);
/* Compare the present motion (displacement and rate by direction) with earlier forecasts of it, and add one. */
void skill_compare(forecast_skill *known, int64_t t, double now[DIRECTIONS][2], double ahead[SKILL_HORIZONS][DIRECTIONS][2]);
/* The factors, 0..1, by which to scale a forecast of displacement and rate, by horizon and direction; waves of frequency w, rad/s.
 *
 * A regression of what came on what was forecast, with a prior. */
void skill_factors(const forecast_skill *known, const double w[DIRECTIONS], double factors[SKILL_HORIZONS][DIRECTIONS][2]);
/* The factors at any horizon, s: 1 at zero, constant beyond the longest that was compared. */
void skill_between(double factors[SKILL_HORIZONS][DIRECTIONS][2], double horizon_s, double found[DIRECTIONS][2]);

#endif
