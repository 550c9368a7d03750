/* Find from the newest innovations how much of the deck's motion the filter does not know, and widen the belief by it. */

#include "filter/deck_jolt.h"

#include <math.h>
#include <string.h>

#include "filter/correction.h"

/* Squared innovation over its variance above which the covariance grows; the median of five honest ones is above this once in
 * seventy times. */
static const double RATIO_MAX = 2.5;
/* A sighting farther off than this is not counted: it is another pad or none, and the gate decides about it. */
static const double RATIO_COUNTED = 49.0;
/* Sightings older than this, against the newest, are not counted, ns. */
static const int64_t MEMORY_NS = 350000000;
/* The median is of at least this many sightings that span at least so long, ns. */
static const int64_t NEEDED = 3, SPAN_NS = 120000000;
/* Time for which the unknown acceleration is assumed to have acted, s. */
static const double ACTED_S = 0.3;

/* Drop the sightings that are too old, and at least one if there is no room for another. */
static void drop_old(dl_innovation_excesses *excesses, int64_t t)
{
    int gone = excesses->n == EXCESSES_MAX;
    while (gone < excesses->n && excesses->t[gone] < t - MEMORY_NS) {
        gone++;
    }
    excesses->n -= gone;
    memmove(excesses->t, excesses->t + gone, (size_t)excesses->n * sizeof *excesses->t);
    memmove(excesses->values, excesses->values + 3 * gone, (size_t)excesses->n * 3 * sizeof *excesses->values);
}

void jolt_extend(dl_innovation_excesses *excesses, int64_t t, const double innov_ned[3], const double cov_ned[9])
{
    double excess[3];
    for (int i = 0; i < 3; i++) {
        const double square = innov_ned[i] * innov_ned[i], var = cov_ned[4 * i];
        if (square > RATIO_COUNTED * var) {
            return;
        }
        excess[i] = square - RATIO_MAX * var;
    }
    drop_old(excesses, t);
    excesses->t[excesses->n] = t;
    memcpy(excesses->values + 3 * excesses->n, excess, sizeof excess);
    excesses->n += 1;
}

/* The median along an axis, by insertion. */
static double median(const dl_innovation_excesses *excesses, int axis)
{
    double ordered[EXCESSES_MAX];
    const int n = (int)excesses->n, half = n / 2;
    for (int i = 0; i < n; i++) {
        const double value = excesses->values[3 * i + axis];
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
