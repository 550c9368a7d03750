/* Gather the samples of one kind over the aiding period, gate them, and fuse their means. */

#include "filter/gathering.h"

#include <math.h>
#include <string.h>

#include "filter/correction.h"
#include "base/kalman.h"
#include "base/rotation.h"

/* Length of a rejection streak after which a kind of aiding is accepted again, with what it contradicts made uncertain. */
static const double STUCK_S = 1.0;
/* Time before such a streak in which an error may have grown up to the gate. */
static const double GREW_S = 2.0;

/* The deck's velocity along each axis that a drift of body and deck together changes. */
static const int DRIFTS[] = {DL_VESSEL_VEL, DL_VESSEL_VEL + 1, HEAVING};

/* The bits of an axis mask for forward and right. */
enum { HORIZONTAL = 3 };

/* The states on which each kind of aiding depends; a row of a Jacobian holds their derivatives in this order. */
static const int ATTITUDE_BY[] = {DL_ATT_ERR, DL_ATT_ERR + 1, DL_ATT_ERR + 2, DL_ATT_BIAS, DL_ATT_BIAS + 1};
static const int VELOCITY_BY[] = {DL_ATT_ERR,    DL_ATT_ERR + 1,    DL_ATT_ERR + 2, DL_VEL,  DL_VEL + 1, DL_VEL + 2,
                                  DL_VESSEL_VEL, DL_VESSEL_VEL + 1, SURGING,        SWAYING, HEAVING,    DL_VEL_SCALE};
static const int RANGE_BY[] = {DL_ATT_ERR,     DL_ATT_ERR + 1, DL_ATT_ERR + 2, DL_POS_REL,        DL_POS_REL + 1, DL_POS_REL + 2,
                               ROLL,           DL_DECK_TRIM,   PITCH,          DL_DECK_TRIM + 1,  DL_PAD_YAW,     DL_RANGE_OFFSET};
static const int HEIGHT_BY[] = {DL_POS_REL + 2, HEAVE, DL_BARO_OFFSET};
static const int *const BY[] = {ATTITUDE_BY, VELOCITY_BY, RANGE_BY, HEIGHT_BY};
#define SIZE_OF(list) ((int)(sizeof(list) / sizeof *(list)))
static const int BY_SIZE[] = {SIZE_OF(ATTITUDE_BY), SIZE_OF(VELOCITY_BY), SIZE_OF(RANGE_BY), SIZE_OF(HEIGHT_BY)};

void spread_of(int m, int kind, const double *H, const double *P, double *out)
{
    const int *by = BY[kind], size = BY_SIZE[kind];
    for (int i = 0; i < m; i++) {
        double HP[COLUMNS_MAX];
        for (int k = 0; k < size; k++) {
            HP[k] = 0.0;
            for (int l = 0; l < size; l++) {
                HP[k] += H[i * COLUMNS_MAX + l] * AT(P, by[l], by[k]);
            }
        }
        for (int j = 0; j < m; j++) {
            out[i * m + j] = 0.0;
            for (int k = 0; k < size; k++) {
                out[i * m + j] += HP[k] * H[j * COLUMNS_MAX + k];
            }
        }
    }
}

/* Samples from before a pause: their innovations belong to a state long past. */
static int is_stale(const dl_filter_params *o, const dl_aid *a, int64_t t)
{
    return seconds(a->since, t) > 2.0 * o->aiding_period_s;
}

void fuse_gathered(const dl_filter_params *o, dl_belief *b, covariance *c)
{
    double innov[DL_ROWS_MAX], H[DL_ROWS_MAX * DL_N], R[DL_ROWS_MAX * DL_ROWS_MAX], S[DL_ROWS_MAX * DL_ROWS_MAX], dx[DL_N], nis;
    int m = 0;
    for (int kind = 0; kind < DL_KINDS; kind++) {
        const dl_aid *a = &b->aids[kind];
        m += a->n > 0 && !is_stale(o, a, b->t) ? (int)a->m : 0;
    }
    propagate_covariance(o, b, c);
    memset(H, 0, sizeof H);
    memset(R, 0, sizeof R);
    int at = 0;
    for (int kind = 0; kind < DL_KINDS; kind++) {
        dl_aid *a = &b->aids[kind];
        if (a->n > 0 && !is_stale(o, a, b->t)) {
            /* Errors with correlation time tau leave one independent sample in 2 tau, however many samples there are. */
            const double window = happened(a->fused) ? seconds(a->fused, b->t) : INFINITY;
            const double inflation = fmax(1.0 / (double)a->n, 2.0 * o->correlation_s[kind] / fmax(window, 1e-3));
            const int rows = (int)a->m;
            for (int i = 0; i < rows; i++) {
                innov[at + i] = a->innov[i] / (double)a->n;
                for (int k = 0; k < BY_SIZE[kind]; k++) {
                    AT(H, at + i, BY[kind][k]) = a->H[i * COLUMNS_MAX + k];
                }
                for (int j = 0; j < rows; j++) {
                    const int here = i * rows + j;
                    R[(at + i) * m + at + j] = (a->R[here] / (double)a->n + a->ambiguity[here]) * inflation;
                }
            }
            at += rows;
            a->fused = b->t;
        }
        a->n = 0;
    }
    double *place = free_place(c);
    if (m > 0 && kalman_correct(DL_N, c->P, &(measured){m, innov, H, R}, dx, place, S, &nis)) {
        correct_belief(b, c, dx, place);
    }
}

/* P gains var g g' */
static void inflate_along(double *P, const double g[DL_N], double var)
{
    for (int i = 0; i < DL_N; i++) {
        if (g[i] != 0.0) {
            for (int j = 0; j < DL_N; j++) {
                AT(P, i, j) += var * g[i] * g[j];
            }
        }
    }
}

/* Body and vessel drift together: their common velocity becomes uncertain. */
static void drift_together(double *P, int m, const double *innov)
{
    const double level = innov[0] * innov[0] + innov[1] * innov[1];
    for (int i = 0; i < m; i++) {
        double g[DL_N] = {0.0};
        g[DL_VEL + i] = g[DRIFTS[i]] = 1.0;
        inflate_along(P, g, i < 2 ? level : innov[i] * innov[i]);
    }
}

/* A vector in `level` along north, east and down. */
static void along_north(double c, double s, const double level[3], double ned[3])
{
    ned[0] = c * level[0] - s * level[1];
    ned[1] = s * level[0] + c * level[1];
    ned[2] = level[2];
}

/* Explain a streak of refused velocities: the error that it began with is a leap of body and vessel together, and the error that has
 * grown since is the accelerometer's bias. */
static void split_leap_and_bias(const dl_belief *b, double *P, const dl_aid *begun, const double *innov)
{
    const dl_aid *streak = &b->aids[DL_VELOCITY];
    const int m = (int)begun->m;
    const double lasted_s = seconds(streak->refused, b->t), flat = hypot(b->R[0], b->R[3]), c = b->R[0] / flat, s = b->R[3] / flat;
    double now[3] = {0.0}, grows[3] = {0.0}, leap[3], v[3], a[3], bias[3], g[DL_N] = {0.0};
    for (int i = 0; i < m; i++) {
        now[i] = innov[i];
        grows[i] = (innov[i] - streak->first[i]) / lasted_s;
    }
    const double grew_s = fmax(0.0, fmin(GREW_S, dot(streak->first, grows) / fmax(dot(grows, grows), 1e-9)));
    for (int i = 0; i < 3; i++) {
        leap[i] = streak->first[i] - grew_s * grows[i];
    }
    drift_together(P, m, leap);
    along_north(c, s, now, v);
    along_north(c, s, grows, a);
    rotated_back(b->R, a, bias);
    for (int i = 0; i < 3; i++) {
        g[DL_ACCEL_BIAS + i] = -bias[i];
        g[DL_VEL + i] = v[i];
        /* Sightings took the deck with the body. */
        g[DRIFTS[i]] = b->sighted > streak->refused ? v[i] : 0.0;
    }
    inflate_along(P, g, 1.0);
}

/* Make uncertain what a rejected sensor contradicts, in directions that leave the pad's position certain. */
static void inflate(const dl_belief *b, covariance *c, int kind, const dl_aid *begun, const double *innov)
{
    double *P = changeable(c), g[DL_N] = {0.0};
    const double *x = b->x;
    if (kind == DL_ATTITUDE) {
        /* All directions turn together about the vertical, as they do when the attitude source redefines north. */
        const int turning[] = {DL_POS_REL, DL_VEL, DL_VESSEL_VEL};
        const double down[3] = {b->R[6], b->R[7], b->R[8]}, angle = dot(innov, down), size = fmin(dot(innov, innov), 0.1);
        memcpy(g + DL_ATT_ERR, down, sizeof down);
        g[DL_PAD_YAW] = 1.0;
        for (int i = 0; i < 3; i++) {
            g[turning[i]] = -x[turning[i] + 1];
            g[turning[i] + 1] = x[turning[i]];
        }
        for (int i = 0; i < 4; i++) {
            g[DL_WAVES + i] = -x[DL_WAVES + 4 + i];
            g[DL_WAVES + 4 + i] = x[DL_WAVES + i];
        }
        inflate_along(P, g, angle * angle);
        for (int i = 0; i < 3; i++) {
            AT(P, DL_ATT_ERR + i, DL_ATT_ERR + i) += 0.1 * size;
        }
        for (int i = 0; i < 2; i++) {
            AT(P, DL_ATT_BIAS + i, DL_ATT_BIAS + i) += size;
        }
    } else if (kind == DL_VELOCITY) {
        AT(P, DL_VEL_SCALE, DL_VEL_SCALE) += 0.01;
        if ((begun->axes & HORIZONTAL) == HORIZONTAL) {
            split_leap_and_bias(b, P, begun, innov);
        }
    } else if (kind == DL_HEIGHT) {
        AT(P, DL_BARO_OFFSET, DL_BARO_OFFSET) += innov[0] * innov[0];
    }
}

void begin_gathering(dl_aid *a, const dl_belief *b, const covariance *c, int kind, const double *H, const double *ambiguity)
{
    const int m = (int)a->m;
    a->n = 0;
    a->since = b->t;
    memset(a->innov, 0, sizeof a->innov);
    memset(a->R, 0, sizeof a->R);
    memcpy(a->H, H, sizeof a->H);
    spread_of(m, kind, H, c->P, a->spread);
    for (int i = 0; i < m * m; i++) {
        a->ambiguity[i] = ambiguity == NULL ? 0.0 : ambiguity[i];
        a->spread[i] += a->ambiguity[i];
    }
}

int still_gathers(const dl_filter_params *o, const dl_belief *b, int kind, int axes, double deck_weight)
{
    const dl_aid *a = &b->aids[kind];
    return a->n > 0 && a->axes == axes && a->deck_weight == deck_weight && !is_stale(o, a, b->t);
}

void gather(const dl_filter_params *o, dl_belief *b, covariance *c, int kind, const dl_aid *begun, const double *innov, const double *R,
            dl_outcome *out)
{
    dl_aid *a = &b->aids[kind];
    const int m = (int)begun->m;
    double S[9], nis;
    for (int i = 0; i < m * m; i++) {
        S[i] = begun->spread[i] + R[i];
    }
    if (!nis_of(m, innov, S, &nis)) {
        write_outcome(out, DL_SINGULAR, m, (int)begun->axes, innov, S, NAN, NAN);
        return;
    }
    const double nis_max = o->nis_max[m - 1];
    write_outcome(out, nis > nis_max ? DL_GATED : DL_FUSED, m, (int)begun->axes, innov, S, nis, nis_max);
    if (nis > nis_max) {
        if (!happened(a->refused)) {
            a->refused = b->t;
            memset(a->first, 0, sizeof a->first);
            memcpy(a->first, innov, (size_t)m * sizeof *innov);
        }
        if (seconds(a->refused, b->t) > STUCK_S) {
            inflate(b, c, kind, begun, innov);
            a->refused = -1;
        }
        return;
    }
    if (kind == DL_VELOCITY && happened(a->refused) && (begun->axes & HORIZONTAL) == HORIZONTAL) {
        /* The uncertainty of coasting has grown to cover a leap, and would explain it by a tilt and a bias that do not exist. An
         * autopilot that finds its first GNSS fix on a ship under way leaps. */
        drift_together(changeable(c), m, innov);
    }
    const int64_t fused = a->fused;
    *a = *begun;
    a->fused = fused;
    a->refused = -1;
    a->n += 1;
    for (int i = 0; i < m; i++) {
        a->innov[i] += innov[i];
    }
    for (int i = 0; i < m * m; i++) {
        a->R[i] += R[i];
    }
    int64_t first = a->since;
    for (int other = 0; other < DL_KINDS; other++) {
        if (b->aids[other].n > 0 && b->aids[other].since < first) {
            first = b->aids[other].since;
        }
    }
    if (seconds(first, b->t) >= o->aiding_period_s || fused < 0) {
        fuse_gathered(o, b, c);
    }
}
