#include "skill.h"

#include <math.h>
#include <string.h>

#include "propagate.h"

const double SKILL_HORIZONS_S[SKILL_HORIZONS] = {1.0, 2.0, 3.0};
/* Interval between forecasts, and between comparisons, ns. */
static const int64_t PERIOD_NS = 500000000;
/* Age at which the longest horizon of a forecast has surely been compared, ns. */
static const int64_t KEPT_NS = 4000000000;
/* Time constant with which old comparisons fade, s. */
static const double MEMORY_S = 60.0;

int skill_due(const forecast_skill *known, int64_t t)
{
    return known->issued_n == 0 || t - known->issued[known->issued_n - 1].t >= PERIOD_NS;
}

/* Sightings are irregular in time: interpolate between the two forecasts that were made before and after `then`. */
static void compare_one(forecast_skill *known, int horizon, int64_t then, double now[DIRECTIONS][2], const issued_forecast *a,
                        const issued_forecast *b)
{
    const double weight = (double)(then - a->t) / (double)(b->t - a->t);
    known->n[horizon] += 1.0;
    for (int k = 0; k < DIRECTIONS; k++) {
        for (int r = 0; r < 2; r++) {
            const int at = (horizon * DIRECTIONS + k) * 2 + r;
            const double f = (1.0 - weight) * a->waves[at] + weight * b->waves[at];
            known->product[at] += f * now[k][r];
            known->square[at] += f * f;
        }
    }
}

static void fade(forecast_skill *known, double factor)
{
    for (int k = 0; k < SKILL_HORIZONS; k++) {
        known->n[k] *= factor;
    }
    for (int i = 0; i < SKILL_HORIZONS * DIRECTIONS * 2; i++) {
        known->product[i] *= factor;
        known->square[i] *= factor;
    }
}

/* Drop the forecasts whose longest horizon has passed, and at least one if there is no room for another. */
static void drop_passed(forecast_skill *known, int64_t t)
{
    int gone = known->issued_n == ISSUED_MAX;
    while (gone < known->issued_n && t - known->issued[gone].t > KEPT_NS) {
        gone++;
    }
    known->issued_n -= gone;
    memmove(known->issued, known->issued + gone, (size_t)known->issued_n * sizeof *known->issued);
}

void skill_compare(forecast_skill *known, int64_t t, double now[DIRECTIONS][2], double ahead[SKILL_HORIZONS][DIRECTIONS][2])
{
    if (known->issued_n > 0) {
        fade(known, exp(-seconds(known->issued[known->issued_n - 1].t, t) / MEMORY_S));
    }
    for (int k = 0; k < SKILL_HORIZONS; k++) {
        const int64_t then = t - llround(SKILL_HORIZONS_S[k] * 1e9);
        for (int i = 1; i < known->issued_n; i++) {
            const issued_forecast *a = &known->issued[i - 1], *b = &known->issued[i];
            if (a->t <= then && then < b->t && b->t - a->t <= 2 * PERIOD_NS) {
                compare_one(known, k, then, now, a, b);
            }
        }
    }
    drop_passed(known, t);
    issued_forecast *one = &known->issued[known->issued_n++];
    one->t = t;
    memcpy(one->waves, ahead, sizeof one->waves);
}
