/* Find from the newest innovations how much of the deck's motion the filter does not know, and widen the belief by it. */

#include "filter/deck_jolt.h"

#include <math.h>
#include <string.h>

#include "filter/correction.h"
#include "base/kalman.h"

/* Squared innovation over its variance above which the covariance grows; the median of five honest ones is above this once in
 * seventy times. */
static const double RATIO_MAX = 2.5;
/* A sighting farther off than both is not counted: it is another pad or none, and the gate decides about it. A ship that brakes by
 * 4 m/s^2 is off by the latter, m^2, after 0.3 s. */
static const double RATIO_COUNTED = 49.0, COUNTED_M2 = 0.18 * 0.18;
/* Sightings older than this, against the newest, are not counted, ns. */
static const int64_t MEMORY_NS = 350000000;
/* The median is of at least this many sightings that span at least so long, ns. */
static const int64_t NEEDED = 3, SPAN_NS = 120000000;
/* Time for which an unknown acceleration is assumed to have acted, of a wave and of the ship, s. */
static const double ACTED_S = 0.3, STEERED_S = 0.15;
/* A ship manoeuvres where so many sightings in a row show it to the same side, each with a likelihood ratio above this, a chi-square
 * of one. By chance that happens once in some minutes, and costs a few cm/s of certainty. */
enum { RUN_NEEDED = 2 };
/* A place, m, or heading, rad, that is further off is not that of a ship that steers. */
static const double STEERED_MOST = 0.25;
static const double RUN_LIKELIHOOD = 5.0;

/* Drop the sightings that are too old, and at least one if there is no room for another. */
static void drop_old(dl_innovation_excesses *excesses, int64_t t)
{
    int gone = excesses->n == EXCESSES_MAX;
    while (gone < excesses->n && excesses->t[gone] < t - MEMORY_NS) {
        gone++;
    }
    excesses->n -= gone;
    memmove(excesses->t, excesses->t + gone, (size_t)excesses->n * sizeof *excesses->t);
    memmove(excesses->values, excesses->values + EXCESS_NUMBERS * gone,
            (size_t)(excesses->n * EXCESS_NUMBERS) * sizeof *excesses->values);
}

void jolt_extend(dl_innovation_excesses *excesses, int64_t t, const double innov_ned[3], const double cov_ned[9],
                 const double likelihood[STEERINGS])
{
    double excess[EXCESS_NUMBERS];
    memcpy(excess + 3, likelihood, STEERINGS * sizeof *likelihood);
    for (int i = 0; i < 3; i++) {
        const double square = innov_ned[i] * innov_ned[i], var = cov_ned[4 * i];
        if (square > fmax(RATIO_COUNTED * var, COUNTED_M2)) {
            return;
        }
        excess[i] = square - RATIO_MAX * var;
    }
    drop_old(excesses, t);
    excesses->t[excesses->n] = t;
    memcpy(excesses->values + EXCESS_NUMBERS * excesses->n, excess, sizeof excess);
    excesses->n += 1;
}

/* The median along an axis, by insertion. */
static double median(const dl_innovation_excesses *excesses, int axis)
{
    double ordered[EXCESSES_MAX];
    const int n = (int)excesses->n, half = n / 2;
    for (int i = 0; i < n; i++) {
        const double value = excesses->values[EXCESS_NUMBERS * i + axis];
        int at = i;
        while (at > 0 && ordered[at - 1] > value) {
            ordered[at] = ordered[at - 1];
            at--;
        }
        ordered[at] = value;
    }
    return n % 2 == 1 ? ordered[half] : 0.5 * (ordered[half - 1] + ordered[half]);
}

int jolt_missing(const dl_innovation_excesses *excesses, double missing[3])
{
    int some = 0;
    if (excesses->n < NEEDED || excesses->t[excesses->n - 1] - excesses->t[0] < SPAN_NS) {
        return 0;
    }
    for (int i = 0; i < 3; i++) {
        missing[i] = fmax(median(excesses, i), 0.0);
        some |= missing[i] > 0.0;
    }
    return some;
}

/* Places and rates that a manoeuvre changes: north, east, heading. */
static const int STEERED[STEERINGS][2] = {
    {DL_POS_REL, DL_VESSEL_VEL}, {DL_POS_REL + 1, DL_VESSEL_VEL + 1}, {DL_PAD_YAW, DL_TURN_RATE},
};

void jolt_steering(int m, const double *innov, const double *S, const double *H, steering *out)
{
    double L[ROWS_MAX][ROWS_MAX], y[ROWS_MAX], by[ROWS_MAX];
    memset(out, 0, sizeof *out);
    for (int i = 0; i < m; i++) {
        y[i] = innov[i];
        memcpy(L[i], S + i * m, (size_t)m * sizeof *S);
    }
    if (cholesky(m, L) == NOT_POSITIVE) {
        return;
    }
    solve_lower(m, L, y);
    for (int k = 0; k < STEERINGS; k++) {
        double square = 0.0, along = 0.0;
        for (int i = 0; i < m; i++) {
            by[i] = AT(H, i, STEERED[k][0]) + 2.0 / STEERED_S * AT(H, i, STEERED[k][1]);
        }
        solve_lower(m, L, by);
        for (int i = 0; i < m; i++) {
            square += by[i] * by[i];
            along += by[i] * y[i];
        }
        if (square > 0.0 && fabs(along) < STEERED_MOST * square) {
            out->likelihood[k] = along * fabs(along) / square;
            out->var[k] = fmax(along * along / square - 1.0, 0.0) / square;
        }
    }
}

int jolt_steered(const dl_innovation_excesses *excesses, int64_t t, steering *newest)
{
    int some = 0;
    for (int k = 0; k < STEERINGS; k++) {
        int64_t n = excesses->n, runs = n > 0 && excesses->t[n - 1] == t;
        while (runs && n > 0 && excesses->n - n < RUN_NEEDED) {
            n--;
            runs = excesses->values[EXCESS_NUMBERS * n + 3 + k] * newest->likelihood[k] > 0.0 &&
                   fabs(excesses->values[EXCESS_NUMBERS * n + 3 + k]) > RUN_LIKELIHOOD;
        }
        runs = runs && excesses->n - n == RUN_NEEDED;
        newest->var[k] = runs ? newest->var[k] : 0.0;
        some |= newest->var[k] > 0.0;
    }
    return some;
}

void jolt_steer(const double var[STEERINGS], double *P)
{
    for (int k = 0; k < STEERINGS; k++) {
        const int place = STEERED[k][0], rate = STEERED[k][1];
        const double across = 1.5 / STEERED_S * var[k];
        AT(P, place, place) += var[k];
        AT(P, rate, rate) += 3.0 / (STEERED_S * STEERED_S) * var[k];
        AT(P, place, rate) += across;
        AT(P, rate, place) += across;
    }
}

void jolt_widen(const double x[DL_N], const double missing[3], double *P)
{
    /* White acceleration for T seconds: displacement T^3 / 3, rate T, both together T^2 / 2. */
    const double across = 1.5 / ACTED_S, rate = 3.0 / (ACTED_S * ACTED_S);
    for (int axis = 0; axis < 3; axis++) {
        const int wave = DL_WAVES + 4 * axis, states[5] = {DL_POS_REL + axis, wave, wave + 1, DL_POS_REL, DL_POS_REL + 1};
        const double displaced[5] = {1.0, 1.0, 0.0, x[DL_SWAY_PER_HEAVE], x[DL_SWAY_PER_HEAVE + 1]};
        const double hastened[5] = {0.0, 0.0, 1.0, 0.0, 0.0};
        const int n = axis == 2 ? 5 : 3;
        if (missing[axis] <= 0.0) {
            continue;
        }
        for (int i = 0; i < n; i++) {
            for (int j = 0; j < n; j++) {
                const double both = displaced[i] * hastened[j] + hastened[i] * displaced[j];
                const double added = displaced[i] * displaced[j] + across * both + rate * hastened[i] * hastened[j];
                AT(P, states[i], states[j]) += missing[axis] * added;
            }
        }
    }
}
