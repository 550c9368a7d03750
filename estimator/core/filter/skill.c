/* Compare past forecasts with the waves that came, and scale new ones by the regression of the two. */

#include "filter/skill.h"

#include <math.h>
#include <string.h>

#include "filter/propagate.h"

const double SKILL_HORIZONS_S[SKILL_HORIZONS] = {1.0, 2.0, 3.0}; /* Horizons at which forecasts are compared, s. */
/* Interval between forecasts, and between comparisons, ns. */
static const int64_t PERIOD_NS = 500000000;
/* Age at which the longest horizon of a forecast has surely been compared, ns. */
static const int64_t KEPT_NS = 4000000000;
/* Time constant with which old comparisons fade, s. */
static const double SKILL_MEMORY_S = 60.0;
/* The factor for a forecast much shorter than a period of the waves, before the first comparison. */
static const double PRIOR = 0.8;
/* The number of comparisons that the prior weighs: the first, plus the second times (horizon / period)^4. A wave that passes once
 * is over before its forecasts can be compared, so beyond a period the prior decides. */
static const double PRIOR_COUNT = 20.0, PRIOR_COUNT_FAR = 100.0;
/* The number of comparisons that the claimed variance weighs; those of neighbouring instants miss alike. */
static const double CLAIMED_COUNT = 8.0;
/* Sum of squares below which nothing was forecast. */
static const double NOTHING = 1e-12;

/* Where a horizon lies among those that are compared. */
typedef struct {
    /* The compared horizons before (-1 for the present) and after it, and the part of the way from one to the other. */
    int before, after;
    double part;
} interval;

static interval interval_of(double horizon_s)
{
    int after = 0;
    while (after < SKILL_HORIZONS - 1 && SKILL_HORIZONS_S[after] <= horizon_s) {
        after++;
    }
    const double start = after == 0 ? 0.0 : SKILL_HORIZONS_S[after - 1];
    const interval found = {after - 1, after, fmin((horizon_s - start) / (SKILL_HORIZONS_S[after] - start), 1.0)};
    return found;
}

int skill_due(const dl_forecast_skill *known, int64_t t)
{
    return known->issued_n == 0 || t - known->issued[known->issued_n - 1].t >= PERIOD_NS;
}

/* Sightings are irregular in time: interpolate between the two forecasts that were made before and after `then`. */
static void compare_one(dl_forecast_skill *known, int horizon, int64_t then, double now[DL_DIRECTIONS][2], const dl_issued_forecast *a,
                        const dl_issued_forecast *b)
{
    const double weight = (double)(then - a->t) / (double)(b->t - a->t);
    known->n[horizon] += 1.0;
    for (int k = 0; k < DL_DIRECTIONS; k++) {
        for (int r = 0; r < 2; r++) {
            const int at = (horizon * DL_DIRECTIONS + k) * 2 + r;
            const double f = (1.0 - weight) * a->waves[at] + weight * b->waves[at];
            known->product[at] += f * now[k][r];
            known->square[at] += f * f;
            known->came[at] += now[k][r] * now[k][r];
        }
    }
}

static void fade(dl_forecast_skill *known, double factor)
{
    for (int k = 0; k < SKILL_HORIZONS; k++) {
        known->n[k] *= factor;
    }
    for (int i = 0; i < SKILL_HORIZONS * DL_DIRECTIONS * 2; i++) {
        known->product[i] *= factor;
        known->square[i] *= factor;
        known->came[i] *= factor;
    }
}

/* Drop the forecasts whose longest horizon has passed, and at least one if there is no room for another. */
static void drop_passed(dl_forecast_skill *known, int64_t t)
{
    int gone = known->issued_n == ISSUED_MAX;
    while (gone < known->issued_n && t - known->issued[gone].t > KEPT_NS) {
        gone++;
    }
    known->issued_n -= gone;
    memmove(known->issued, known->issued + gone, (size_t)known->issued_n * sizeof *known->issued);
}

void skill_compare(dl_forecast_skill *known, int64_t t, double now[DL_DIRECTIONS][2], double ahead[SKILL_HORIZONS][DL_DIRECTIONS][2])
{
    if (known->issued_n > 0) {
        fade(known, exp(-seconds(known->issued[known->issued_n - 1].t, t) / SKILL_MEMORY_S));
    }
    for (int k = 0; k < SKILL_HORIZONS; k++) {
        const int64_t then = t - llround(SKILL_HORIZONS_S[k] * 1e9);
        for (int i = 1; i < known->issued_n; i++) {
            const dl_issued_forecast *a = &known->issued[i - 1], *b = &known->issued[i];
            if (a->t <= then && then < b->t && b->t - a->t <= 2 * PERIOD_NS) {
                compare_one(known, k, then, now, a, b);
            }
        }
    }
    drop_passed(known, t);
    dl_issued_forecast *one = &known->issued[known->issued_n++];
    one->t = t;
    memcpy(one->waves, ahead, sizeof one->waves);
}

void skill_factors(const dl_forecast_skill *known, const double w[DL_DIRECTIONS], double factors[SKILL_HORIZONS][DL_DIRECTIONS][2])
{
    for (int h = 0; h < SKILL_HORIZONS; h++) {
        for (int k = 0; k < DL_DIRECTIONS; k++) {
            const double periods = SKILL_HORIZONS_S[h] * w[k] / (2.0 * acos(-1.0)), squared = periods * periods;
            const double prior = PRIOR * exp(-squared), count = PRIOR_COUNT + PRIOR_COUNT_FAR * squared * squared;
            for (int r = 0; r < 2; r++) {
                const int at = (h * DL_DIRECTIONS + k) * 2 + r;
                const double slope = known->product[at] / fmax(known->square[at], NOTHING);
                const double mean = (count * prior + known->n[h] * slope) / (count + known->n[h]);
                factors[h][k][r] = fmin(fmax(mean, 0.0), 1.0);
            }
        }
    }
}

void skill_between(double factors[SKILL_HORIZONS][DL_DIRECTIONS][2], double horizon_s, double found[DL_DIRECTIONS][2])
{
    const interval at = interval_of(horizon_s);
    for (int k = 0; k < DL_DIRECTIONS; k++) {
        for (int r = 0; r < 2; r++) {
            const double before = at.before < 0 ? 1.0 : factors[at.before][k][r];
            found[k][r] = (1.0 - at.part) * before + at.part * factors[at.after][k][r];
        }
    }
}

void skill_misses(const dl_forecast_skill *known, double factors[SKILL_HORIZONS][DL_DIRECTIONS][2], forecast_misses *misses)
{
    for (int h = 0; h < SKILL_HORIZONS; h++) {
        misses->trust[h] = known->n[h] / (CLAIMED_COUNT + known->n[h]);
        for (int k = 0; k < DL_DIRECTIONS; k++) {
            for (int r = 0; r < 2; r++) {
                const int at = (h * DL_DIRECTIONS + k) * 2 + r;
                const double f = factors[h][k][r];
                const double sum = known->came[at] + f * (f * known->square[at] - 2.0 * known->product[at]);
                misses->rms[h][k][r] = known->n[h] > 0.0 ? sqrt(fmax(sum, 0.0) / known->n[h]) : 0.0;
            }
        }
    }
}

double missed_var(const forecast_misses *misses, double horizon_s, int direction, int r, double claimed)
{
    const interval at = interval_of(horizon_s);
    const double rms = at.before < 0 ? at.part * misses->rms[at.after][direction][r]
                                     : (1.0 - at.part) * misses->rms[at.before][direction][r] + at.part * misses->rms[at.after][direction][r];
    const double trust = misses->trust[at.after];
    return claimed + trust * fmax(rms * rms - claimed, 0.0);
}
