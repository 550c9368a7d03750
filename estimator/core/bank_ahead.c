#include "bank_ahead.h"

#include <math.h>
#include <string.h>

#include "bank.h"
#include "oscillator.h"
#include "propagate.h"

enum { STATES = 4, OF_RATE = 1 };

/* A rate's variance below which the rate is known. */
static const double KNOWN_VAR = 1e-18;

/* The first member with oscillator k: the member at rest has one of its own, the others come in all sizes. */
static int first_member(int k)
{
    return k == 0 ? 0 : 1 + (k - 1) * MEMBER_SIZES;
}

static int last_member(int k)
{
    return k * MEMBER_SIZES;
}

/* The place of (i, j), i <= j, in the rows of the upper triangle of an oscillator's covariance. */
static int wave_pair(int i, int j)
{
    return i * (2 * STATES - 1 - i) / 2 + j;
}

/* Ax = A x */
static void carried(double A[STATES][STATES], const double x[STATES], double Ax[STATES])
{
    for (int i = 0; i < STATES; i++) {
        Ax[i] = 0.0;
        for (int j = 0; j < STATES; j++) {
            Ax[i] += A[i][j] * x[j];
        }
    }
}

static void covariance_of(const sea *s, int k, int g, double P[STATES][STATES])
{
    const double *all = s->P + k * MEMBER_PAIRS * MEMBERS + g;
    for (int i = 0; i < STATES; i++) {
        for (int j = i; j < STATES; j++) {
            P[i][j] = P[j][i] = all[member_pair(i, j) * MEMBERS];
        }
    }
}

static void state_of(const sea *s, int k, int g, double x[STATES])
{
    for (int i = 0; i < STATES; i++) {
        x[i] = s->x[(k * MEMBER_STATES + i) * MEMBERS + g];
    }
}

/* Add a member's covariance to the sum, and what its rate, once known, takes from the covariance at t. */
static void add_covariance(double A[STATES][STATES], double q[STATES][STATES], double P[STATES][STATES], double size_var,
                           double weight, double sum[STATES][STATES], double known[STATES][STATES])
{
    double half[STATES], column[STATES];
    carried(P, A[OF_RATE], half);
    carried(A, half, column);
    for (int i = 0; i < STATES; i++) {
        column[i] += size_var * q[i][OF_RATE];
    }
    const double scale = weight / fmax(column[OF_RATE], KNOWN_VAR);
    for (int i = 0; i < STATES; i++) {
        for (int j = i; j < STATES; j++) {
            sum[i][j] += weight * P[i][j];
            known[i][j] += scale * column[i] * column[j];
        }
    }
}

/* The weighted covariances of an oscillator's members at t, about their own states and for a known rate: the upper triangle. */
static void add_own_spread(const bank_members *m, const sea *s, int k, int oscillator, double A[STATES][STATES],
                           double q[STATES][STATES], const double *weight, waves_now *now)
{
    double sum[STATES][STATES] = {{0.0}}, known[STATES][STATES] = {{0.0}}, half[STATES][STATES], P[STATES][STATES];
    for (int g = first_member(oscillator); g <= last_member(oscillator); g++) {
        const double sigma = m->sigma[k * MEMBERS + g];
        covariance_of(s, k, g, P);
        add_covariance(A, q, P, sigma * sigma, weight[g], sum, known);
    }
    for (int i = 0; i < STATES; i++) {
        for (int j = 0; j < i; j++) {
            sum[i][j] = sum[j][i];
        }
    }
    /* A sum A', of which half is the transposed product of the first two. */
    for (int j = 0; j < STATES; j++) {
        carried(A, sum[j], half[j]);
    }
    for (int i = 0; i < STATES; i++) {
        for (int j = i; j < STATES; j++) {
            double moved = 0.0;
            for (int l = 0; l < STATES; l++) {
                moved += A[j][l] * half[l][i];
            }
            now->spread[wave_pair(i, j)][oscillator] += moved + now->energy[oscillator] * q[i][j] - known[i][j];
        }
    }
}

/* Weighted mean and spread of the states of an oscillator's members. */
static void add_states(int oscillator, double x[MEMBERS][STATES], const double *weight, waves_now *now)
{
    const int first = first_member(oscillator), last = last_member(oscillator);
    if (now->weight[oscillator] <= 0.0) {
        return;
    }
    for (int i = 0; i < STATES; i++) {
        for (int g = first; g <= last; g++) {
            now->mean[i][oscillator] += weight[g] / now->weight[oscillator] * x[g][i];
        }
    }
    for (int g = first; g <= last; g++) {
        for (int i = 0; i < STATES; i++) {
            const double off = weight[g] * (x[g][i] - now->mean[i][oscillator]);
            for (int j = i; j < STATES; j++) {
                now->spread[wave_pair(i, j)][oscillator] += off * (x[g][j] - now->mean[j][oscillator]);
            }
        }
    }
}

void steps_to(const bank_members *m, const sea *s, int64_t t, oscillator_steps *steps)
{
    const double T = s->t >= 0 && t > s->t ? seconds(s->t, t) : 0.0;
    for (int o = 0; o < OSCILLATORS; o++) {
        oscillator_transition(m->w[first_member(o)], m->zeta[first_member(o)], T, steps->A[o], steps->q[o]);
    }
}

void waves_at(const bank_members *m, const sea *s, oscillator_steps *steps, int k, double rate, waves_now *now)
{
    double weight[MEMBERS], x[MEMBERS][STATES], believed = 0.0;
    memset(now, 0, sizeof *now);
    weigh_ahead(m, s->log_weight + k * MEMBERS, s->weight[k * MEMBERS], weight);
    for (int o = 0; o < OSCILLATORS; o++) {
        double before[STATES];
        for (int g = first_member(o); g <= last_member(o); g++) {
            const double sigma = m->sigma[k * MEMBERS + g];
            now->weight[o] += weight[g];
            now->energy[o] += weight[g] * sigma * sigma;
            state_of(s, k, g, before);
            carried(steps->A[o], before, x[g]);
            believed += weight[g] * x[g][OF_RATE];
        }
        add_own_spread(m, s, k, o, steps->A[o], steps->q[o], weight, now);
    }
    for (int g = 0; g < MEMBERS; g++) {
        x[g][OF_RATE] += rate - believed;
        now->displacement += weight[g] * x[g][0];
    }
    for (int o = 0; o < OSCILLATORS; o++) {
        add_states(o, x, weight, now);
    }
}

/* of = row mean, by oscillator */
static void row_of(const double *row, double mean[STATES][OSCILLATORS], double of[OSCILLATORS])
{
    memset(of, 0, OSCILLATORS * sizeof *of);
    for (int i = 0; i < STATES; i++) {
        for (int o = 0; o < OSCILLATORS; o++) {
            of[o] += row[i * OSCILLATORS + o] * mean[i][o];
        }
    }
}

/* The sum over the oscillators of row spread row', of which `squares` are the products of the row's numbers. */
static double spread_along(const double *squares, double spread[WAVE_PAIRS][OSCILLATORS])
{
    double along[OSCILLATORS] = {0.0}, sum = 0.0;
    for (int p = 0; p < WAVE_PAIRS; p++) {
        for (int o = 0; o < OSCILLATORS; o++) {
            along[o] += squares[p * OSCILLATORS + o] * spread[p][o];
        }
    }
    for (int o = 0; o < OSCILLATORS; o++) {
        sum += along[o];
    }
    return sum;
}

static double weighted_mean(const double *weight, const double *of)
{
    double sum = 0.0;
    for (int o = 0; o < OSCILLATORS; o++) {
        sum += weight[o] * of[o];
    }
    return sum;
}

/* The variance of means by oscillator about their own mean. */
static double variance_between(const double *weight, const double *of, double mean)
{
    double sum = 0.0;
    for (int o = 0; o < OSCILLATORS; o++) {
        sum += weight[o] * (of[o] - mean) * (of[o] - mean);
    }
    return sum;
}

/* By the law of total variance: what each oscillator's members spread, and how their means differ. */
void waves_ahead(waves_now *now, const horizon_reach *there, waves_then *then)
{
    double of[OSCILLATORS];
    for (int r = 0; r < 2; r++) {
        row_of(there->row + r * STATES * OSCILLATORS, now->mean, of);
        then->mean[r] = weighted_mean(now->weight, of);
        then->by_rate[r] = weighted_mean(now->weight, there->row + (r * STATES + OF_RATE) * OSCILLATORS);
        then->var[r] = spread_along(there->squares + r * WAVE_PAIRS * OSCILLATORS, now->spread) +
                       weighted_mean(now->energy, there->noise + r * OSCILLATORS) +
                       variance_between(now->weight, of, then->mean[r]);
    }
    row_of(there->row, now->mean, of);
    for (int o = 0; o < OSCILLATORS; o++) {
        of[o] -= now->mean[0][o];
    }
    then->change = then->mean[0] - now->displacement;
    then->var_change = spread_along(there->squares + 2 * WAVE_PAIRS * OSCILLATORS, now->spread) +
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

void bank_reach(const bank_members *m, int32_t n, const double *horizons_s, horizon_reach *out)
{
    for (int h = 0; h < n; h++) {
        for (int o = 0; o < OSCILLATORS; o++) {
            double A[STATES][STATES], q[STATES][STATES], rows[3][STATES];
            oscillator_transition(m->w[first_member(o)], m->zeta[first_member(o)], horizons_s[h], A, q);
            memcpy(rows, A, 2 * sizeof rows[0]);
            memcpy(rows[2], A[0], sizeof rows[2]);
            rows[2][0] -= 1.0;
            for (int r = 0; r < 3; r++) {
                for (int i = 0; i < STATES; i++) {
                    for (int j = i; j < STATES; j++) {
                        const int at = (r * WAVE_PAIRS + wave_pair(i, j)) * OSCILLATORS + o;
                        out[h].squares[at] = (i == j ? 1.0 : 2.0) * rows[r][i] * rows[r][j];
                    }
                }
            }
            for (int r = 0; r < 2; r++) {
                out[h].noise[r * OSCILLATORS + o] = q[r][r];
                for (int i = 0; i < STATES; i++) {
                    out[h].row[(r * STATES + i) * OSCILLATORS + o] = rows[r][i];
                }
            }
        }
    }
}
