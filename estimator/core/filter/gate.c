/* Count rejected sightings that agree with one another, and average the consistency of all. */

#include "filter/gate.h"

#include <math.h>
#include <string.h>

#include "base/kalman.h"
#include "filter/propagate.h"
#include "filter/sighting.h"

/* Rate at which two sightings of the same object may come to differ because the belief drifts between them, and the most that it
 * may. A deck whose heave is not learned yet moves away from the belief at 1 to 2 m/s. */
static const double GROWTH_M_S = 2.0, GROWTH_MAX_M = 0.6;
/* Sigmas of their difference, and fraction of the offset, by which two sightings of the same object may differ. */
static const double SIGMAS = 4.0, FRACTION = 0.02;
/* Pause that ends a streak, s. */
static const double PAUSE_S = 2.0;
/* Number of sightings that make a belief one of many. */
enum { MANY = 3 };
/* Fraction by which one sighting renews the mean, and the most that one counts for. */
static const double RENEWED = 0.05, COUNTED_MAX = 20.0;
/* Differences of place, m, and of angle, rad, that a landing does not notice. */
static const double SLIGHT_M = 0.008, SLIGHT_RAD = 0.01;

static double length(const double v[3])
{
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

void streak_end(dl_belief *b)
{
    memset(&b->rejections, 0, sizeof b->rejections);
}

void streak_extend(dl_belief *b, int64_t t, const double offset_ned[3], double var_m2)
{
    dl_rejection_streak *streak = &b->rejections;
    const double dt = seconds(streak->last, t);
    double step[3];
    for (int i = 0; i < 3; i++) {
        step[i] = offset_ned[i] - streak->offset_ned[i];
    }
    const double grown = fmin(GROWTH_M_S * dt, GROWTH_MAX_M);
    const double limit = SIGMAS * sqrt(var_m2 + streak->var_m2) + grown + FRACTION * length(offset_ned);
    if (streak->n == 0 || t < streak->last || length(step) > limit || dt > PAUSE_S) {
        streak->n = 0;
        streak->since = t;
    }
    streak->n += 1;
    streak->last = t;
    memcpy(streak->offset_ned, offset_ned, sizeof streak->offset_ned);
    streak->var_m2 = var_m2;
}

int streak_resets(const dl_filter_params *o, const dl_belief *b)
{
    if (b->agreed < MANY) {
        return b->rejections.n > b->agreed;
    }
    return b->rejections.n >= o->reopen_count && seconds(b->rejections.since, b->rejections.last) >= o->reopen_s;
}

double nis_mean_of(double nis_mean, const double *innov, const double *S, int m)
{
    double widened[SEEN_MAX * SEEN_MAX], nis;
    for (int i = 0; i < m; i++) {
        const double slight = i < 3 ? SLIGHT_M : SLIGHT_RAD;
        for (int j = 0; j < m; j++) {
            widened[i * m + j] = S[i * m + j] + (i == j ? slight * slight : 0.0);
        }
    }
    const double ratio = nis_of(m, innov, widened, &nis) == DONE ? nis / m : COUNTED_MAX;
    return nis_mean + RENEWED * (fmin(ratio, COUNTED_MAX) - nis_mean);
}
