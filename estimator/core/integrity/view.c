/* Compare the pad's way through the image with the body's turns: a view that stands still, is mirrored, or is late.
 *
 * The drone's drift is slower than its rotation: each bearing's distance from a line through those of half a second is free of it, and
 * the sums of these distances over some seconds decide. */

#include <math.h>
#include <string.h>

#include "base/rotation.h"
#include "decklander.h"

/* Time for which bearings are kept, the least of them, and the least time between the first and the last that shows anything. */
static const int64_t SPAN_NS = 500000000, LEAST_SPAN_NS = 300000000;
enum { LEAST = 8 };
/* Time after which a rotation counts a third for which way the view moves, and for the delay, s. */
static const double FORGET_S = 6.0, LAG_FORGET_S = 3.0;
/* A bearing that leaves the one before by more, beyond the rotation of the body, is that of something else. */
static const double JUMP_RAD = 0.1;
/* Root of the sum of squares of the rotations that say which way the view moves, and that show a delay. */
static const double LEAST_TURNED_RAD = 0.015, LAG_TURNED_RAD = 0.03;
/* Correlation of view and rotation along one axis, below which the view moves against the body. */
static const double AGAINST = -0.2;
/* Delays of the attitude behind the image for which both are compared: from one to the other end in even steps, s. */
static const double LAG_STEP_S = 0.02;
enum { NO_LAG = DL_VIEW_LAGS / 2 };
static const double LATE_S = 0.06; /* Least delay that makes an alert, s. */
static const double LAG_ALIKE = 0.8; /* Least correlation with it. */
static const double LAG_BETTER = 0.05; /* How much better the square of that is than the one without delay. */
/* Least distance to the pad, m: nearer, a drone's way aside moves the pad more than its lean does, and later. */
static const double LAG_FROM_M = 1.0;
/* Rate of the pad's way through the level view after which nothing is compared for LAG_FORGET_S: after a ship that stops or turns a drone
 * leans. */
static const double LAG_ASIDE_RAD_S = 0.5;
/* Number of sightings in a row that show a delay, of those in which the body turns by so much beside a line: the other ones repeat what
 * these showed. A lean that begins and stays is one turn, which the push of a gust makes look late. */
enum { LAG_LASTS = 15 };
static const double LAG_TURN_RAD = 0.004;

/* The courses of half a second: three of bearings in the body that the rotation alone makes, three of those in the image, and two of those
 * in level, forward and right. */
enum { EXPECTED = 0, FOUND = 3, LEVEL = 6, COURSES = 8 };

/* Courses over instants s from their mean, s, each with its mean and its slope, 1/s. */
typedef struct {
    int64_t n;
    double s[DL_VIEW_MAX], y[COURSES][DL_VIEW_MAX], mean[COURSES], slope[COURSES];
} window;

/* Forget the bearings that are older than the span, or newer than the instant, and those for which there is no room. */
static void keep(dl_view *v, int64_t t)
{
    int64_t n = 0;
    const int64_t first = v->n < DL_VIEW_MAX ? 0 : v->n - DL_VIEW_MAX + 1;
    for (int64_t i = first; i < v->n; i++) {
        if (t - v->bearings[i].t >= 0 && t - v->bearings[i].t <= SPAN_NS) {
            v->bearings[n++] = v->bearings[i];
        }
    }
    v->n = n;
}

static void fill(const dl_view *v, window *w)
{
    double mean[3] = {0.0, 0.0, 0.0}, mean_s = 0.0, ss = 0.0;
    memset(w, 0, sizeof *w);
    w->n = v->n;
    for (int64_t i = 0; i < w->n; i++) {
        w->s[i] = (double)(v->bearings[i].t - v->bearings[w->n - 1].t) * 1e-9;
        mean_s += w->s[i] / (double)w->n;
        for (int k = 0; k < 3; k++) {
            mean[k] += v->bearings[i].level[k] / (double)w->n;
        }
    }
    for (int64_t i = 0; i < w->n; i++) {
        const dl_bearing *one = &v->bearings[i];
        double now[COURSES];
        w->s[i] -= mean_s;
        ss += w->s[i] * w->s[i];
        rotated_back(one->R_level_body, mean, now + EXPECTED);
        rotated_back(one->R_level_body, one->level, now + FOUND);
        memcpy(now + LEVEL, one->level, 2 * sizeof *now);
        for (int k = 0; k < COURSES; k++) {
            w->y[k][i] = now[k];
            w->mean[k] += now[k] / (double)w->n;
        }
    }
    for (int k = 0; k < COURSES; k++) {
        for (int64_t i = 0; i < w->n; i++) {
            w->slope[k] += w->s[i] / ss * (w->y[k][i] - w->mean[k]);
        }
    }
}

/* How far a value at an instant is from the line through a course. */
static double off_line(const window *w, int k, double s, double y)
{
    return y - w->mean[k] - s * w->slope[k];
}

/* The root of the mean squared distance of three courses from their means, rad. */
static double spread(const window *w, int first)
{
    double sum = 0.0;
    for (int k = first; k < first + 3; k++) {
        for (int64_t i = 0; i < w->n; i++) {
            sum += (w->y[k][i] - w->mean[k]) * (w->y[k][i] - w->mean[k]);
        }
    }
    return sqrt(sum / (double)w->n);
}

/* Whether a bearing leaps otherwise than the rotation takes it. */
static int leaps(const window *w)
{
    double most = 0.0;
    for (int k = 0; k < 3; k++) {
        const double *found = w->y[FOUND + k], *expected = w->y[EXPECTED + k];
        for (int64_t i = 1; i < w->n; i++) {
            most = fmax(most, fabs(found[i] - expected[i] - (found[i - 1] - expected[i - 1])));
        }
    }
    return most >= JUMP_RAD;
}

/* Whether view and rotation run against each other along the axis on which they agree least. */
static int runs_against(const double moments[16])
{
    const double p = 2.0 * moments[2], q = moments[3] + moments[6], r = 2.0 * moments[7];
    /* The eigenvector of the smaller eigenvalue of ((p, q), (q, r)). */
    const double angle = 0.5 * atan2(2.0 * q, p - r), axis[2] = {-sin(angle), cos(angle)};
    double turned = 0.0, together = 0.0, seen = 0.0;
    for (int i = 0; i < 2; i++) {
        for (int j = 0; j < 2; j++) {
            const double both = axis[i] * axis[j];
            turned += both * moments[4 * i + j];
            together += both * moments[4 * i + 2 + j];
            seen += both * moments[4 * (2 + i) + 2 + j];
        }
    }
    return turned > LEAST_TURNED_RAD * LEAST_TURNED_RAD && together < AGAINST * sqrt(fmax(turned * seen, 0.0));
}

/* A value of a course between its instants, which ascend. */
static double between(const window *w, int k, double s)
{
    int64_t i = 0;
    while (i < w->n - 2 && w->s[i + 1] <= s) {
        i++;
    }
    return w->y[k][i] + (s - w->s[i]) * (w->y[k][i + 1] - w->y[k][i]) / (w->s[i + 1] - w->s[i]);
}

/* Forget what showed a delay, by a time without sight of the pad. */
static void forget_delays(dl_view *v, double unseen_s)
{
    const double kept = exp(-unseen_s / LAG_FORGET_S);
    for (int lag = 0; lag < DL_VIEW_LAGS; lag++) {
        v->turned[lag] *= kept;
        v->together[lag] *= kept;
    }
    v->seen *= kept;
    v->late_s = 0.0;
    v->lags_shown = 0;
}

/* Compare the view in the middle of half a second with the rotation at instants before and after. The delay is where both agree best
 * (Knapp, Carter, The generalized correlation method for estimation of time delay, IEEE Trans. ASSP 24(4), 1976). */
static void compare_delays(dl_view *v, const window *w)
{
    const int64_t now = v->bearings[w->n - 1].t;
    const double middle = w->s[w->n / 2], most_s = NO_LAG * LAG_STEP_S;
    if (middle - most_s < w->s[0] || middle + most_s > w->s[w->n - 1]) {
        return;
    }
    if (hypot(w->slope[LEVEL], w->slope[LEVEL + 1]) > LAG_ASIDE_RAD_S) {
        forget_delays(v, HUGE_VAL);
        v->aside_at = now;
        return;
    }
    if (v->aside_at >= 0 && now >= v->aside_at && (double)(now - v->aside_at) * 1e-9 < LAG_FORGET_S) {
        return;
    }
    const double kept = exp((double)(v->bearings[w->n - 2].t - now) * 1e-9 / LAG_FORGET_S);
    double seen[2], alike[DL_VIEW_LAGS], turns[DL_VIEW_LAGS] = {0.0};
    int best = 0;
    v->seen *= kept;
    for (int k = 0; k < 2; k++) {
        seen[k] = off_line(w, FOUND + k, middle, w->y[FOUND + k][w->n / 2]);
        v->seen += seen[k] * seen[k];
    }
    for (int lag = 0; lag < DL_VIEW_LAGS; lag++) {
        const double there = middle + (lag - NO_LAG) * LAG_STEP_S;
        v->turned[lag] *= kept;
        v->together[lag] *= kept;
        for (int k = 0; k < 2; k++) {
            const double turned = off_line(w, EXPECTED + k, there, between(w, EXPECTED + k, there));
            turns[lag] += turned * turned;
            v->together[lag] += turned * seen[k];
        }
        v->turned[lag] += turns[lag];
        alike[lag] = v->together[lag] / sqrt(fmax(v->seen * v->turned[lag], 1e-18));
        best = alike[lag] > alike[best] ? lag : best;
    }
    const double late_s = (best - NO_LAG) * LAG_STEP_S;
    const double better = alike[best] * fabs(alike[best]) - alike[NO_LAG] * fabs(alike[NO_LAG]);
    const int shows = fabs(late_s) > LATE_S - 1e-9 && alike[best] > LAG_ALIKE && better > LAG_BETTER && v->seen > LAG_TURNED_RAD * LAG_TURNED_RAD;
    v->lags_shown = shows ? v->lags_shown + (turns[best] > LAG_TURN_RAD * LAG_TURN_RAD) : 0;
    v->late_s = v->lags_shown >= LAG_LASTS ? late_s : 0.0;
}

void dl_view_watch(dl_view *view, int64_t t, const double *d_level, double roll, double pitch, double turned_min_rad, double still_ratio)
{
    const double distance_m = sqrt(dot(d_level, d_level));
    if (distance_m < 1e-6) {
        return;
    }
    const int64_t before = view->n > 0 ? view->bearings[view->n - 1].t : t;
    keep(view, t);
    if (view->n == 0 && before < t) {
        forget_delays(view, (double)(t - before) * 1e-9);
    }
    dl_bearing *newest = &view->bearings[view->n++];
    newest->t = t;
    from_rpy(roll, pitch, 0.0, newest->R_level_body);
    for (int k = 0; k < 3; k++) {
        newest->level[k] = d_level[k] / distance_m;
    }
    if (view->n < LEAST || t - view->bearings[0].t < LEAST_SPAN_NS) {
        view->frozen = false;
        return;
    }
    window w;
    fill(view, &w);
    const double turned = spread(&w, EXPECTED);
    view->frozen = turned > turned_min_rad && spread(&w, FOUND) < still_ratio * turned;
    if (!leaps(&w)) {
        const double kept = exp((double)(view->bearings[w.n - 2].t - t) * 1e-9 / FORGET_S);
        const int rows[4] = {EXPECTED, EXPECTED + 1, FOUND, FOUND + 1};
        double apart[4];
        for (int k = 0; k < 4; k++) {
            apart[k] = off_line(&w, rows[k], w.s[w.n - 1], w.y[rows[k]][w.n - 1]);
        }
        for (int k = 0; k < 16; k++) {
            view->moments[k] = apart[k / 4] * apart[k % 4] + kept * view->moments[k];
        }
        if (distance_m > LAG_FROM_M) {
            compare_delays(view, &w);
        }
    }
    view->reversed = runs_against(view->moments);
}
