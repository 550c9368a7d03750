#include "deck_jolt.h"

#include <math.h>
#include <string.h>

#include "correction.h"

/* Median squared innovation over its variance above which the covariance grows; of five honest ones it is above this once in
 * seventy times. */
static const double RATIO_MAX = 2.5;
/* A sighting farther off than this is not counted: it is another pad or none, and the gate decides about it. */
static const double RATIO_COUNTED = 49.0;
/* Sightings older than this, against the newest, are not counted, ns. */
static const int64_t MEMORY_NS = 350000000;
/* The median is of at least so many sightings that span at least so long, ns. */
static const int64_t NEEDED = 3, SPAN_NS = 120000000;
/* Time for which the unknown acceleration is assumed to have acted, s. */
static const double ACTED_S = 0.3;

/* Drop the sightings that are too old, and at least one if there is no room for another. */
static void drop_old(innovation_ratios *ratios, int64_t t)
{
    int gone = ratios->n == RATIOS_MAX;
    while (gone < ratios->n && ratios->t[gone] < t - MEMORY_NS) {
        gone++;
    }
    ratios->n -= gone;
    memmove(ratios->t, ratios->t + gone, (size_t)ratios->n * sizeof *ratios->t);
    memmove(ratios->values, ratios->values + 3 * gone, (size_t)ratios->n * 3 * sizeof *ratios->values);
}

void jolt_extend(innovation_ratios *ratios, int64_t t, const double innov_ned[3], const double cov_ned[9])
{
    double ratio[3];
    for (int i = 0; i < 3; i++) {
        ratio[i] = innov_ned[i] * innov_ned[i] / cov_ned[4 * i];
    }
    if (fmax(ratio[0], fmax(ratio[1], ratio[2])) > RATIO_COUNTED) {
        return;
    }
    drop_old(ratios, t);
    ratios->t[ratios->n] = t;
    memcpy(ratios->values + 3 * ratios->n, ratio, sizeof ratio);
    ratios->n += 1;
}

/* The median along an axis, by insertion. */
static double median(const innovation_ratios *ratios, int axis)
{
    double ordered[RATIOS_MAX];
    const int n = (int)ratios->n, half = n / 2;
    for (int i = 0; i < n; i++) {
        const double value = ratios->values[3 * i + axis];
        int at = i;
        while (at > 0 && ordered[at - 1] > value) {
            ordered[at] = ordered[at - 1];
            at--;
        }
        ordered[at] = value;
    }
    return n % 2 == 1 ? ordered[half] : 0.5 * (ordered[half - 1] + ordered[half]);
}

int jolt_missing(const innovation_ratios *ratios, const double cov_ned[9], double missing[3])
{
    int some = 0;
    if (ratios->n < NEEDED || ratios->t[ratios->n - 1] - ratios->t[0] < SPAN_NS) {
        return 0;
    }
    for (int i = 0; i < 3; i++) {
        const double excess = median(ratios, i) - RATIO_MAX;
        some |= excess > 0.0;
        missing[i] = fmax(excess, 0.0) * cov_ned[4 * i];
    }
    return some;
}

void jolt_widen(const double x[N], const double missing[3], double *P)
{
    /* White acceleration for T seconds: displacement T^3 / 3, rate T, both together T^2 / 2. */
    const double across = 1.5 / ACTED_S, rate = 3.0 / (ACTED_S * ACTED_S);
    for (int axis = 0; axis < 3; axis++) {
        const int wave = WAVES + 4 * axis, states[5] = {POS_REL + axis, wave, wave + 1, POS_REL, POS_REL + 1};
        const double displaced[5] = {1.0, 1.0, 0.0, x[SWAY_PER_HEAVE], x[SWAY_PER_HEAVE + 1]};
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
