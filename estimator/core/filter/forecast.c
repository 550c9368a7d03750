/* Forecast of the deck in the next seconds, with bands. Derivation: docs/estimator.md, section "Forecast". */

#include <math.h>
#include <string.h>

#include "filter/answer.h"
#include "filter/belief.h"
#include "filter/jacobian.h"
#include "filter/motion.h"
#include "filter/oscillator.h"
#include "filter/propagate.h"
#include "base/rotation.h"
#include "filter/skill.h"

enum { PER_DIRECTION = 4, DISP = DL_WAVES, RATE = DL_WAVES + 1, ALONG_DOWN = 2, IN_ROLL = 3 };

/* The belief at the instant from which the horizons count. */
typedef struct {
    const dl_filter_params *o;
    const dl_belief *b;
    const double *P;
    /* The state with the deck at the body's time. */
    double x[DL_N];
    level_axes level;
} present;

/* What the vessel's turn and way, and the waves, add to the pad's place in ned by a horizon: covariance in level. */
static void noise_of(const present *now, double T, const double curving[2], const waves_then *waves, double noise[9])
{
    const double way = now->o->psd[DL_VESSEL_VEL] * T * T * T / 3.0;
    /* The rate of turn wanders by asd sqrt(t): integrated three times against the velocity. */
    const double turn = 0.2 * now->o->psd[DL_TURN_RATE] * T;
    const double c = now->level.c, s = now->level.s;
    const double Z[9] = {c, s, 0.0, -s, c, 0.0, 0.0, 0.0, 1.0}, back[9] = {c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0};
    double ned[9], half[9];
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            ned[3 * i + j] = i == j ? waves[i].var_change : 0.0;
            if (i < 2 && j < 2) {
                ned[3 * i + j] += curving[i] * curving[j] * turn + (i == j ? way : 0.0);
            }
        }
    }
    product(Z, ned, half);
    product(half, back, noise);
}

/* Place and velocity of the pad at a horizon if the body keeps its velocity. */
static void forecast_place(const present *now, double T, const waves_then *waves, dl_deck_ahead *out)
{
    const double *x = now->x, *u = x + DL_VESSEL_VEL, half = 0.5 * T * T;
    const double curving[2] = {-half * u[1], half * u[0]};
    double J[3 * DL_N] = {0.0}, by[2][2], reach[2][2], d[3];
    steady_turn(x[DL_TURN_RATE], T, by, reach);
    for (int i = 0; i < 3; i++) {
        AT(J, i, DL_POS_REL + i) = 1.0;
        AT(J, i, DL_VEL + i) = -T;
        AT(J, i, RATE + PER_DIRECTION * i) = waves[i].by_rate[0];
        out->d[i] = x[DL_POS_REL + i] - T * x[DL_VEL + i] + waves[i].change;
        out->v_pad[i] = waves[i].mean[1];
    }
    for (int i = 0; i < 2; i++) {
        for (int j = 0; j < 2; j++) {
            AT(J, i, DL_VESSEL_VEL + j) = reach[i][j];
            out->d[i] += reach[i][j] * u[j];
            out->v_pad[i] += by[i][j] * u[j];
        }
        AT(J, i, DL_TURN_RATE) = curving[i];
    }
    turn_rows(&now->level, J);
    turn_vector(&now->level, out->d);
    turn_vector(&now->level, out->v_pad);
    memcpy(d, x + DL_POS_REL, sizeof d);
    turn_vector(&now->level, d);
    add_turning(&now->level, d, J);
    through_alignment(3, now->b->x, J);
    noise_of(now, T, curving, waves, out->cov_d);
    add_spread(3, J, now->P, out->cov_d);
}

/* Height and rise of the pad's centre, positive up. */
static void forecast_heave(const present *now, const waves_then *heave, dl_deck_ahead *out)
{
    const double var_rate = AT(now->P, HEAVING, HEAVING);
    double *value[2] = {&out->height, &out->rise}, *sigma[2] = {&out->sigma_height, &out->sigma_rise};
    for (int r = 0; r < 2; r++) {
        *value[r] = -heave->mean[r];
        *sigma[r] = sqrt(heave->var[r] + heave->by_rate[r] * heave->by_rate[r] * var_rate);
    }
}

/* Roll (0) or pitch (1) of the deck. */
static void forecast_tilt(const present *now, int axis, const waves_then *waves, double *value, double *sigma)
{
    const int at = DISP + PER_DIRECTION * (IN_ROLL + axis);
    double row[DL_N] = {0.0}, var = 0.0;
    row[DL_DECK_TRIM + axis] = row[at] = 1.0;
    *value = now->x[at] + now->x[DL_DECK_TRIM + axis] + waves->change;
    row[at + 1] = waves->by_rate[0];
    through_alignment(1, now->b->x, row);
    add_spread(1, row, now->P, &var);
    *sigma = sqrt(fmax(var + waves->var_change, 0.0));
}

/* A band is no narrower than past forecasts have missed. */
static void widen_by_misses(const forecast_misses *misses, double horizon_s, int k, waves_then *then)
{
    for (int r = 0; r < 2; r++) {
        then->var[r] = missed_var(misses, horizon_s, k, r, then->var[r]);
    }
    then->var_change = missed_var(misses, horizon_s, k, 0, then->var_change);
}

bool forecast_deck(const dl_filter_params *o, int64_t t, const whole_belief *before, reach_table *reaches, int32_t n,
                   const double *horizons_s, dl_deck_ahead *out)
{
    double places[2][DL_N * DL_N], factors[SKILL_HORIZONS][DL_DIRECTIONS][2];
    covariance c = {before->P, {places[0], places[1]}};
    const dl_bank *bank = before->bank;
    dl_belief b = *before->numbers;
    present now;
    oscillator_steps steps;
    waves_now sea_now[DL_DIRECTIONS];
    forecast_misses misses;
    if (!knows_deck(o, &b, t)) {
        return false;
    }
    propagate_to(o, &b, &c, t);
    propagate_covariance(o, &b, &c);
    now.o = o;
    now.b = &b;
    now.P = c.P;
    align(b.x, now.x);
    level_axes_of(b.R, &now.level);
    skill_factors(&bank->skill, bank->w_rad_s, factors);
    skill_misses(&bank->skill, factors, &misses);
    steps_to(&o->members, bank, t, &steps);
    for (int k = 0; k < DL_DIRECTIONS; k++) {
        waves_at(&o->members, bank, &steps, k, now.x[RATE + PER_DIRECTION * k], &sea_now[k]);
    }
    for (int h = 0; h < n; h++) {
        const horizon_reach *reach = reach_of(&o->members, reaches, horizons_s[h]);
        waves_then waves[DL_DIRECTIONS];
        double kept[DL_DIRECTIONS][2];
        skill_between(factors, horizons_s[h], kept);
        for (int k = 0; k < DL_DIRECTIONS; k++) {
            waves_ahead(&sea_now[k], reach, &waves[k]);
            scale_by_skill(&sea_now[k], kept[k], &waves[k]);
            widen_by_misses(&misses, horizons_s[h], k, &waves[k]);
        }
        forecast_place(&now, horizons_s[h], waves, &out[h]);
        forecast_heave(&now, &waves[ALONG_DOWN], &out[h]);
        forecast_tilt(&now, 0, &waves[IN_ROLL], &out[h].roll, &out[h].sigma_roll);
        forecast_tilt(&now, 1, &waves[IN_ROLL + 1], &out[h].pitch, &out[h].sigma_pitch);
    }
    return true;
}
