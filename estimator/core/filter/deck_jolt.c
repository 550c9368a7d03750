/* Find from the newest innovations how much of the deck's motion the filter does not know, and widen the belief by it. */

#include "filter/deck_jolt.h"

#include <math.h>
#include <string.h>

#include "filter/correction.h"
#include "base/kalman.h"

/* Squared innovation over its variance above which the covariance grows; the median of five honest ones is above this once in
 * seventy times. */
static const double RATIO_MAX = 2.5;
/* Square of the ratio to what is claimed beyond which a sighting is not counted: another pad or none. */
static const double RATIO_COUNTED = 49.0;
static const double COUNTED_M2 = 0.18 * 0.18; /* What it has to be off by besides, m^2: a ship that brakes by 4 m/s^2 is, after 0.3 s. */
/* Sightings older than this, against the newest, are not counted, ns. */
static const int64_t MEMORY_NS = 350000000;
/* The median is of at least this many sightings that span at least so long, ns. */
static const int64_t NEEDED = 3, SPAN_NS = 120000000;
static const double ACTED_S = 0.3; /* Time for which an unknown acceleration of a wave is assumed to have acted, s. */
static const double STEERED_S = 0.15; /* The same of the ship's, s. */
/* A ship manoeuvres where the last two or three sightings are off to one side. Measured in docs/decisions/ship-manoeuvres.md. */
enum { TOGETHER = 3 };
static const double TOGETHER_S = 0.16; /* Time within which they are, s. */
static const double DEVIATES_NEEDED = 5.0; /* Standard deviations of their sum by which they have to be off. */
/* Deviations that each counts for at most: of places so few that one alone shows nothing. */
static const double DEVIATE_MOST[STEERINGS] = {5.0, 5.0, 9.0};
static const double LEFT_MOST = 12.0; /* What her acceleration may leave of an innovation, a chi-square: more is of a wrong sighting. */
/* One of whose innovation so small a share is left is not, nor so much while she steers. */
static const double LEFT_SHARE = 0.05, LEFT_SHARE_ON = 0.25;
/* Sightings are off by less than they claim: the deviations that are usual are the root of the mean of their NIS. */
static const double CLAIMED_RENEWED = 0.1; /* Share of it that each renews. */
static const double CLAIMED_MOST = 5.0;    /* What each counts for at most. */
static const double CLAIMED_LEAST = 0.2;   /* The least mean. */
/* A place, m, or heading, rad, that is further off is not that of a ship that steers. */
static const double STEERED_MOST = 0.25;
/* Time since the newest sign of a manoeuvre after which the next one is another manoeuvre, s. */
static const double MANOEUVRE_S = 2.0;

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
                 const double deviate[STEERINGS])
{
    double excess[EXCESS_NUMBERS];
    memcpy(excess + 3, deviate, STEERINGS * sizeof *deviate);
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

/* Accelerations: along the way, across it, in heading. */
enum { ALONG, ACROSS, TURNING };

/* The derivative in a row of M by a displacement of an acceleration's kind, or by its rate. */
static double moved_by(const double *M, int row, const double way[2], int acceleration, int rate)
{
    const int north = rate ? DL_VESSEL_VEL : DL_POS_REL;
    switch (acceleration) {
    case ALONG:
        return way[0] * AT(M, row, north) + way[1] * AT(M, row, north + 1);
    case ACROSS:
        return way[0] * AT(M, row, north + 1) - way[1] * AT(M, row, north);
    default:
        return AT(M, row, rate ? DL_TURN_RATE : DL_PAD_YAW);
    }
}

/* What accelerations across the way and in heading leave of a whitened innovation's square nis, and what they leave with those along
 * it. Rows of `by`, of these squares, lose what those before explain. */
static void unexplained(int m, double by[STEERINGS][DL_ROWS_MAX], const double *y, const double *square, double nis, double *by_turn,
                        double *by_all)
{
    static const int order[STEERINGS] = {ACROSS, TURNING, ALONG};
    for (int n = 0; n < STEERINGS; n++) {
        double *row = by[order[n]], own = 0.0, of_y = 0.0;
        for (int i = 0; i < m; i++) {
            own += row[i] * row[i];
            of_y += row[i] * y[i];
        }
        if (own > 1e-9 * square[order[n]]) {
            nis -= of_y * of_y / own;
            for (int later = n + 1; later < STEERINGS; later++) {
                double shared = 0.0;
                for (int i = 0; i < m; i++) {
                    shared += row[i] * by[order[later]][i];
                }
                for (int i = 0; i < m; i++) {
                    by[order[later]][i] -= shared / own * row[i];
                }
            }
        }
        *by_turn = order[n] == TURNING ? nis : *by_turn;
    }
    *by_all = nis;
}

void jolt_steering(int m, const double *innov, const double *S, const double *H, dl_belief *b, steering *out)
{
    double L[DL_ROWS_MAX][DL_ROWS_MAX], y[DL_ROWS_MAX], by[STEERINGS][DL_ROWS_MAX], square[STEERINGS] = {0.0}, along[STEERINGS] = {0.0};
    double nis = 0.0, by_turn = 0.0, by_all = 0.0, explained[STEERINGS];
    const double *v = b->x + DL_VESSEL_VEL, speed = hypot(v[0], v[1]), moves = speed > UNDER_WAY_M_S;
    const double usual = fmin(1.0, fmax(CLAIMED_LEAST, b->nis_claimed));
    memset(out, 0, sizeof *out);
    out->way[0] = moves ? v[0] / speed : 1.0;
    out->way[1] = moves ? v[1] / speed : 0.0;
    for (int i = 0; i < m; i++) {
        y[i] = innov[i];
        memcpy(L[i], S + i * m, (size_t)m * sizeof *S);
    }
    if (cholesky(m, DL_ROWS_MAX, *L) == NOT_POSITIVE) {
        return;
    }
    solve_lower(m, DL_ROWS_MAX, *L, 1, 1, y);
    for (int k = 0; k < STEERINGS; k++) {
        for (int i = 0; i < m; i++) {
            by[k][i] = moved_by(H, i, out->way, k, 0) + 2.0 / STEERED_S * moved_by(H, i, out->way, k, 1);
        }
        solve_lower(m, DL_ROWS_MAX, *L, 1, 1, by[k]);
        for (int i = 0; i < m; i++) {
            square[k] += by[k][i] * by[k][i];
            along[k] += by[k][i] * y[i];
        }
    }
    for (int i = 0; i < m; i++) {
        nis += y[i] * y[i];
    }
    b->nis_claimed += CLAIMED_RENEWED * (fmin(CLAIMED_MOST, nis / m) - b->nis_claimed);
    unexplained(m, by, y, square, nis, &by_turn, &by_all);
    for (int k = 0; k < STEERINGS; k++) {
        explained[k] = square[k] > 0.0 ? along[k] * along[k] / square[k] : 0.0;
    }
    /* A ship that turns hard swings her pad aside, and along her way as she comes round; a sighting of few features errs in heading. */
    const int aside = fmax(explained[ALONG], explained[ACROSS]) > explained[TURNING];
    const int wholly = aside && by_all < nis * (steers(b, b->t) ? LEFT_SHARE_ON : LEFT_SHARE);
    for (int k = 0; k < STEERINGS; k++) {
        if (square[k] > 0.0 && fabs(along[k]) < STEERED_MOST * square[k]) {
            if (wholly || (k == ALONG ? nis - explained[ALONG] : by_turn) < LEFT_MOST) {
                out->deviate[k] = along[k] / sqrt(square[k] * usual);
                out->var[k] = fmax(explained[k] - usual, 0.0) / square[k];
            }
        }
    }
}

int jolt_steered(const dl_innovation_excesses *excesses, int64_t t, steering *newest)
{
    int some = 0;
    /* One that is too far off was not counted. */
    const int64_t last = excesses->n > 0 && excesses->t[excesses->n - 1] == t ? excesses->n - 1 : -1;
    for (int k = 0; k < STEERINGS; k++) {
        int shows = 0, n = 0;
        double sum = 0.0;
        for (int64_t i = last; i >= 0 && n < TOGETHER && seconds(excesses->t[i], t) <= TOGETHER_S; i--) {
            sum += fmax(-DEVIATE_MOST[k], fmin(DEVIATE_MOST[k], excesses->values[EXCESS_NUMBERS * i + 3 + k]));
            n += 1;
            shows |= n > 1 && fabs(sum) > DEVIATES_NEEDED * sqrt(n);
        }
        newest->var[k] = shows ? newest->var[k] : 0.0;
        some |= newest->var[k] > 0.0;
    }
    return some;
}

void jolt_steer(const steering *shown, double *P)
{
    const double across = 1.5 / STEERED_S, rate = 3.0 / (STEERED_S * STEERED_S);
    const double *way = shown->way, turn = shown->var[TURNING], along = shown->var[ALONG], aside = shown->var[ACROSS];
    const double cov[3] = {
        along * way[0] * way[0] + aside * way[1] * way[1],
        (along - aside) * way[0] * way[1],
        along * way[1] * way[1] + aside * way[0] * way[0],
    };
    for (int i = 0; i < 2; i++) {
        for (int j = 0; j < 2; j++) {
            const int place[2] = {DL_POS_REL + i, DL_POS_REL + j}, velocity[2] = {DL_VESSEL_VEL + i, DL_VESSEL_VEL + j};
            AT(P, place[0], place[1]) += cov[i + j];
            AT(P, velocity[0], velocity[1]) += rate * cov[i + j];
            AT(P, place[0], velocity[1]) += across * cov[i + j];
            AT(P, velocity[0], place[1]) += across * cov[i + j];
        }
    }
    AT(P, DL_PAD_YAW, DL_PAD_YAW) += turn;
    AT(P, DL_TURN_RATE, DL_TURN_RATE) += rate * turn;
    AT(P, DL_PAD_YAW, DL_TURN_RATE) += across * turn;
    AT(P, DL_TURN_RATE, DL_PAD_YAW) += across * turn;
}

void jolt_note_manoeuvre(dl_belief *b)
{
    if (!happened(b->steered) || seconds(b->steered, b->t) > MANOEUVRE_S) {
        for (int i = 0; i < 2; i++) {
            b->vessel_before[i] = b->x[DL_VESSEL_VEL + i] - b->x[DL_VEL + i] + b->ins_v[i];
        }
    }
    b->steered = b->t;
}

void jolt_widen(const double missing[3], double *P)
{
    /* White acceleration for T seconds: displacement T^3 / 3, rate T, both together T^2 / 2. */
    const double across = 1.5 / ACTED_S, rate = 3.0 / (ACTED_S * ACTED_S);
    const double added[3][3] = {{1.0, 1.0, across}, {1.0, 1.0, across}, {across, across, rate}};
    for (int axis = 0; axis < 3; axis++) {
        const int wave = DL_WAVES + 4 * axis, states[3] = {DL_POS_REL + axis, wave, wave + 1};
        if (missing[axis] <= 0.0) {
            continue;
        }
        for (int i = 0; i < 3; i++) {
            for (int j = 0; j < 3; j++) {
                AT(P, states[i], states[j]) += missing[axis] * added[i][j];
            }
        }
    }
}
