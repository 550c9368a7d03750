/* Count rejected sightings that agree with one another, and average the consistency of all. */

#include "filter/gate.h"

#include <math.h>
#include <string.h>

#include "base/kalman.h"
#include "filter/propagate.h"
#include "filter/sighting.h"

/* Rate at which two sightings of one object may come to differ: a deck whose heave is not learned moves at 1 to 2 m/s. */
static const double GROWTH_M_S = 2.0;
static const double GROWTH_MAX_M = 0.6; /* The most that the drift of the belief between them makes, m. */
static const double SIGMAS = 4.0; /* Standard deviations by which two sightings of one object may differ. */
static const double FRACTION = 0.02; /* Fraction of the offset by which they may besides. */
/* Pause that ends a streak, s. */
static const double STREAK_PAUSE_S = 2.0;
/* Number of sightings that make a belief one of many. */
enum { MANY = 3 };
static const double RENEWED = 0.05; /* Fraction by which one sighting renews the mean of the NIS. */
static const double COUNTED_MAX = 20.0; /* The most that one counts for. */
static const double SLIGHT_M = 0.008; /* Difference of place that a landing does not notice, m. */
static const double SLIGHT_RAD = 0.01; /* Difference of angle that it does not notice, rad. */

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
    if (streak->n == 0 || t < streak->last || length(step) > limit || dt > STREAK_PAUSE_S) {
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
