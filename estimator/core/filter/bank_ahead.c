/* Forecast the waves of one direction as the mixture over the bank's members. */

#include "filter/bank_ahead.h"

#include <math.h>
#include <string.h>

#include "filter/bank.h"
#include "filter/oscillator.h"
#include "filter/propagate.h"
#include "base/wide.h"

enum { STATES = 4, OF_RATE = 1 };

/* A rate's variance below which the rate is known. */
static const double AHEAD_KNOWN_VAR = 1e-18;

/* The first member with oscillator k: the member at rest has one of its own, the others come in all sizes. */
static int first_member(int k)
{
    return k == 0 ? 0 : 1 + (k - 1) * DL_MEMBER_SIZES;
}

static int last_member(int k)
{
    return k * DL_MEMBER_SIZES;
}

/* The place of (i, j), i <= j, in the rows of the upper triangle of an oscillator's covariance. */
static int wave_pair(int i, int j)
{
    return i * (2 * STATES - 1 - i) / 2 + j;
}

static const double *covariance_of(const dl_bank *s, int k, int i, int j)
{
    return s->P + (k * MEMBER_PAIRS + member_pair(i, j)) * DL_MEMBERS;
}

/* sum += a x, for every member */
static void add_product(const double *a, const double *x, double *restrict sum)
{
    for (int g = 0; g < DL_MEMBERS; g++) {
        sum[g] += a[g] * x[g];
    }
}

/* after = A before, for every member; its displacement and rate do not drive its force. */
static void carry(const oscillator_steps *steps, double before[STATES][DL_MEMBERS], double after[STATES][DL_MEMBERS])
{
    memset(after, 0, STATES * sizeof after[0]);
    for (int i = 0; i < STATES; i++) {
        for (int j = i / 2 * 2; j < STATES; j++) {
            add_product(steps->by_member[i][j], before[j], after[i]);
        }
    }
}

/* The column of the rate in every member's covariance after the step. */
static void rate_column(const dl_bank_members *m, const dl_bank *s, const oscillator_steps *steps, int k, double column[STATES][DL_MEMBERS])
{
    double half[STATES][DL_MEMBERS] = {{0.0}};
    const double *sigma = m->sigma + k * DL_MEMBERS;
    for (int i = 0; i < STATES; i++) {
        for (int j = 0; j < STATES; j++) {
            add_product(covariance_of(s, k, i, j), steps->by_member[OF_RATE][j], half[i]);
        }
    }
    carry(steps, half, column);
    for (int i = 0; i < STATES; i++) {
        for (int g = 0; g < DL_MEMBERS; g++) {
            column[i][g] += sigma[g] * sigma[g] * steps->noise[i][g];
        }
    }
}

/* The sum of a x over the members of an oscillator. */
static double sum_of(int oscillator, const double *a, const double *x)
{
    double sum = 0.0;
    for (int g = first_member(oscillator); g <= last_member(oscillator); g++) {
        sum += a[g] * x[g];
    }
    return sum;
}

/* A sum A' for the weighted covariances before the step, added to the spread: the upper triangle. */
static void add_carried(const dl_bank *s, const oscillator_steps *steps, int k, int o, const double *weight, waves_now *now)
{
    double sum[STATES][STATES], half[STATES][STATES] = {{0.0}};
    for (int i = 0; i < STATES; i++) {
        for (int j = i; j < STATES; j++) {
            sum[i][j] = sum[j][i] = sum_of(o, weight, covariance_of(s, k, i, j));
        }
    }
    for (int i = 0; i < STATES; i++) {
        for (int j = 0; j < STATES; j++) {
            for (int l = i / 2 * 2; l < STATES; l++) {
                half[i][j] += steps->A[o][i][l] * sum[l][j];
            }
        }
    }
    for (int i = 0; i < STATES; i++) {
        for (int j = i; j < STATES; j++) {
            for (int l = j / 2 * 2; l < STATES; l++) {
                now->spread[wave_pair(i, j)][o] += half[i][l] * steps->A[o][j][l];
            }
        }
    }
}

/* The weighted covariances of the members after the step, about their own states and for a known rate. */
WIDE
static void add_own_spread(const dl_bank_members *m, const dl_bank *s, const oscillator_steps *steps, int k, const double *weight,
                           waves_now *now)
{
    double column[STATES][DL_MEMBERS], known[DL_MEMBERS], scaled[DL_MEMBERS];
    rate_column(m, s, steps, k, column);
    for (int g = 0; g < DL_MEMBERS; g++) {
        known[g] = weight[g] / fmax(column[OF_RATE][g], AHEAD_KNOWN_VAR);
    }
    for (int o = 0; o < DL_OSCILLATORS; o++) {
        add_carried(s, steps, k, o, weight, now);
    }
    for (int i = 0; i < STATES; i++) {
        for (int g = 0; g < DL_MEMBERS; g++) {
            scaled[g] = known[g] * column[i][g];
        }
        for (int j = i; j < STATES; j++) {
            double *spread = now->spread[wave_pair(i, j)];
            for (int o = 0; o < DL_OSCILLATORS; o++) {
                spread[o] += now->energy[o] * steps->q[o][i][j] - sum_of(o, scaled, column[j]);
            }
        }
    }
}

/* Weighted mean and spread of the members' states. */
WIDE
static void add_states(double x[STATES][DL_MEMBERS], const double *weight, waves_now *now)
{
    double off[STATES][DL_MEMBERS], weighted[DL_MEMBERS];
    for (int i = 0; i < STATES; i++) {
        for (int o = 0; o < DL_OSCILLATORS; o++) {
            if (now->weight[o] > 0.0) {
                now->mean[i][o] = sum_of(o, weight, x[i]) / now->weight[o];
            }
            for (int g = first_member(o); g <= last_member(o); g++) {
                off[i][g] = x[i][g] - now->mean[i][o];
            }
        }
    }
    for (int i = 0; i < STATES; i++) {
        for (int g = 0; g < DL_MEMBERS; g++) {
            weighted[g] = weight[g] * off[i][g];
        }
        for (int j = i; j < STATES; j++) {
            for (int o = 0; o < DL_OSCILLATORS; o++) {
                now->spread[wave_pair(i, j)][o] += sum_of(o, weighted, off[j]);
            }
        }
    }
}

void steps_to(const dl_bank_members *m, const dl_bank *s, int64_t t, oscillator_steps *steps)
{
    const double T = happened(s->t) && t > s->t ? seconds(s->t, t) : 0.0;
    for (int o = 0; o < DL_OSCILLATORS; o++) {
        oscillator_transition(m->w[first_member(o)], m->zeta[first_member(o)], T, steps->A[o], steps->q[o]);
        for (int i = 0; i < STATES; i++) {
            for (int g = first_member(o); g <= last_member(o); g++) {
                steps->noise[i][g] = steps->q[o][i][OF_RATE];
                for (int j = 0; j < STATES; j++) {
                    steps->by_member[i][j][g] = steps->A[o][i][j];
                }
            }
        }
    }
}

WIDE
void waves_at(const dl_bank_members *m, const dl_bank *s, const oscillator_steps *steps, int k, double rate, waves_now *now)
{
    double weight[DL_MEMBERS], before[STATES][DL_MEMBERS], x[STATES][DL_MEMBERS], believed = 0.0;
    const double *sigma = m->sigma + k * DL_MEMBERS;
    memset(now, 0, sizeof *now);
    memcpy(before, s->x + k * MEMBER_STATES * DL_MEMBERS, sizeof before);
    forecast_weights(m, s->log_weight + k * DL_MEMBERS, s->weight[k * DL_MEMBERS], weight);
    carry(steps, before, x);
    for (int o = 0; o < DL_OSCILLATORS; o++) {
        for (int g = first_member(o); g <= last_member(o); g++) {
            now->weight[o] += weight[g];
            now->energy[o] += weight[g] * sigma[g] * sigma[g];
        }
    }
    for (int g = 0; g < DL_MEMBERS; g++) {
        believed += weight[g] * x[OF_RATE][g];
    }
    for (int g = 0; g < DL_MEMBERS; g++) {
        x[OF_RATE][g] += rate - believed;
        now->displacement += weight[g] * x[0][g];
    }
    add_own_spread(m, s, steps, k, weight, now);
    add_states(x, weight, now);
}

/* of = row mean, by oscillator */
static void row_of(const double *row, double mean[STATES][DL_OSCILLATORS], double of[DL_OSCILLATORS])
{
    memset(of, 0, DL_OSCILLATORS * sizeof *of);
    for (int i = 0; i < STATES; i++) {
        for (int o = 0; o < DL_OSCILLATORS; o++) {
            of[o] += row[i * DL_OSCILLATORS + o] * mean[i][o];
        }
    }
}

/* The sum over the oscillators of row spread row', `squares` are the products of the row's numbers. */
static double spread_along(const double *squares, double spread[WAVE_PAIRS][DL_OSCILLATORS])
{
    double along[DL_OSCILLATORS] = {0.0}, sum = 0.0;
    for (int p = 0; p < WAVE_PAIRS; p++) {
        for (int o = 0; o < DL_OSCILLATORS; o++) {
            along[o] += squares[p * DL_OSCILLATORS + o] * spread[p][o];
        }
    }
    for (int o = 0; o < DL_OSCILLATORS; o++) {
        sum += along[o];
    }
    return sum;
}

static double weighted_mean(const double *weight, const double *of)
{
    double sum = 0.0;
    for (int o = 0; o < DL_OSCILLATORS; o++) {
        sum += weight[o] * of[o];
    }
    return sum;
}

/* The variance of means by oscillator about their own mean. */
static double variance_between(const double *weight, const double *of, double mean)
{
    double sum = 0.0;
    for (int o = 0; o < DL_OSCILLATORS; o++) {
        sum += weight[o] * (of[o] - mean) * (of[o] - mean);
    }
    return sum;
}

/* By the law of total variance: what each oscillator's members spread, and how their means differ. */
WIDE
void waves_ahead(waves_now *now, const horizon_reach *there, waves_then *then)
{
    double of[DL_OSCILLATORS];
    for (int r = 0; r < 2; r++) {
        row_of(there->row + r * STATES * DL_OSCILLATORS, now->mean, of);
        then->mean[r] = weighted_mean(now->weight, of);
        then->by_rate[r] = weighted_mean(now->weight, there->row + (r * STATES + OF_RATE) * DL_OSCILLATORS);
        then->var[r] = spread_along(there->squares + r * WAVE_PAIRS * DL_OSCILLATORS, now->spread) +
                       weighted_mean(now->energy, there->noise + r * DL_OSCILLATORS) +
                       variance_between(now->weight, of, then->mean[r]);
    }
    row_of(there->row, now->mean, of);
    for (int o = 0; o < DL_OSCILLATORS; o++) {
        of[o] -= now->mean[0][o];
    }
    then->change = then->mean[0] - now->displacement;
    then->var_change = spread_along(there->squares + 2 * WAVE_PAIRS * DL_OSCILLATORS, now->spread) +
                       weighted_mean(now->energy, there->noise) +
                       variance_between(now->weight, of, weighted_mean(now->weight, of));
}

void scale_by_skill(const waves_now *now, const double factors[2], waves_then *then)
{
    for (int r = 0; r < 2; r++) {
        const double left_out = (1.0 - factors[r]) * then->mean[r];
        then->var[r] += left_out * left_out;
        then->var_change += r == 0 ? left_out * left_out : 0.0;
        then->mean[r] *= factors[r];
    }
    then->change = then->mean[0] - now->displacement;
}

static void write_reach(const dl_bank_members *m, double horizon_s, horizon_reach *out)
{
    out->horizon_s = horizon_s;
    for (int o = 0; o < DL_OSCILLATORS; o++) {
        double A[STATES][STATES], q[STATES][STATES], rows[3][STATES];
        oscillator_transition(m->w[first_member(o)], m->zeta[first_member(o)], horizon_s, A, q);
        memcpy(rows, A, 2 * sizeof rows[0]);
        memcpy(rows[2], A[0], sizeof rows[2]);
        rows[2][0] -= 1.0;
        for (int r = 0; r < 3; r++) {
            for (int i = 0; i < STATES; i++) {
                for (int j = i; j < STATES; j++) {
                    const int at = (r * WAVE_PAIRS + wave_pair(i, j)) * DL_OSCILLATORS + o;
                    out->squares[at] = (i == j ? 1.0 : 2.0) * rows[r][i] * rows[r][j];
                }
            }
        }
        for (int r = 0; r < 2; r++) {
            out->noise[r * DL_OSCILLATORS + o] = q[r][r];
            for (int i = 0; i < STATES; i++) {
                out->row[(r * STATES + i) * DL_OSCILLATORS + o] = rows[r][i];
            }
        }
    }
}

const horizon_reach *reach_of(const dl_bank_members *m, reach_table *table, double horizon_s)
{
    for (int i = 0; i < table->n; i++) {
        if (table->kept[i].horizon_s == horizon_s) {
            return &table->kept[i];
        }
    }
    horizon_reach *made = &table->kept[table->next];
    write_reach(m, horizon_s, made);
    table->next = (table->next + 1) % REACHES;
    table->n += table->n < REACHES;
    return made;
}
