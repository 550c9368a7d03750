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

#endif
