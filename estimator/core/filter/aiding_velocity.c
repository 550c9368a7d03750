/* Compare a velocity with the belief, over the ground or over the deck, whichever the evidence says, and gather it. */

#include <math.h>
#include <string.h>

#include "filter/aiding.h"
#include "filter/correction.h"
#include "filter/gathering.h"
#include "base/kalman.h"
#include "base/rotation.h"

/* Time constant with which the evidence of velocity samples about the surface below decays. */
static const double OVER_MEMORY_S = 3.0;
/* Log-odds of measuring against the deck when the body is surely over it, and against the water when it surely is not. */
static const double OVER_EXPECTED = 3.0;
/* Log-odds of the deck while the pad was never seen, and the least then: samples count as over the water until they say otherwise,
 * and three that do are enough. */
static const double UNSEEN_EXPECTED = -4.0;
/* Variance of the vessel's velocity, (m/s)^2, below which her reports give the motion of an unseen deck below the body. */
static const double KNOWN_VAR = 0.25;
/* NIS above which a hypothesis is refuted by its own covariance; one true sample in twenty exceeds it. */
static const double REFUTED = 6.0;

/* The derivatives by the states of a velocity, in their order in a row of its Jacobian. */
enum { BY_ATT = 0, BY_VEL = 3, BY_VESSEL = 6, BY_DECK = 8, BY_SCALE = 11 };

/* What a sensor with that scale measures of a velocity, m/s in `level`. */
static void measured_velocity(const double v[3], const double R[9], double scale, double out[3])
{
    const double k = scale / hypot(R[0], R[3]);
    out[0] = k * (R[0] * v[0] + R[3] * v[1]);
    out[1] = k * (R[0] * v[1] - R[3] * v[0]);
    out[2] = v[2];
}

/* The Jacobian of the measured velocity body_weight v + deck_weight v_pad, (3, COLUMNS_MAX). */
static void by_velocity(const double x[DL_N], const double R[9], double body_weight, double deck_weight, double H[3 * COLUMNS_MAX])
{
    const double scale = x[DL_VEL_SCALE], flat = hypot(R[0], R[3]), c = scale * R[0] / flat, s = scale * R[3] / flat;
    const double to_level[3][3] = {{c, s, 0.0}, {-s, c, 0.0}, {0.0, 0.0, 1.0}};
    double v_pad[3], v[3], level[3], turning[3];
    pad_velocity(x, v_pad);
    for (int i = 0; i < 3; i++) {
        v[i] = body_weight * x[DL_VEL + i] + deck_weight * v_pad[i];
    }
    measured_velocity(v, R, scale, level);
    heading_by_rotation(R, turning);
    for (int i = 0; i < 3; i++) {
        double *row = H + i * COLUMNS_MAX;
        for (int j = 0; j < 3; j++) {
            row[BY_ATT + j] = i == 0 ? level[1] * turning[j] : i == 1 ? -level[0] * turning[j] : 0.0;
            row[BY_VEL + j] = body_weight * to_level[i][j];
            row[BY_DECK + j] = deck_weight * to_level[i][j];
        }
        for (int j = 0; j < 2; j++) {
            row[BY_VESSEL + j] = deck_weight * to_level[i][j];
        }
        row[BY_SCALE] = i < 2 ? level[i] / scale : 0.0;
    }
}

/* Keep of (3, width) rows those that an axis mask names; returns their number. */
static int pick_rows(int axes, int width, double *rows)
{
    int m = 0;
    for (int i = 0; i < 3; i++) {
        if (axes >> i & 1) {
            memmove(rows + m * width, rows + i * width, (size_t)width * sizeof *rows);
            m++;
        }
    }
    return m;
}

/* The rows and columns of a (3, 3) matrix that an axis mask names. */
static void pick(int axes, const double A[9], double *out)
{
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            if (axes >> i & axes >> j & 1) {
                *out++ = A[3 * i + j];
            }
        }
    }
}

static int measured_axes(const dl_filter_params *o, const double cov[9])
{
    int axes = 0;
    for (int i = 0; i < 3; i++) {
        axes |= (cov[4 * i] < o->not_measured_var) << i;
    }
    return axes;
}

/* A velocity that is measured against a surface that moves with weight `deck_weight` as the deck does: innovation and H P H'. */
static int compare_velocity(const dl_belief *b, const double *P, const double x[DL_N], const double v[3], int axes, double deck_weight,
                            double innov[3], double spread[9])
{
    double over[3], H[3 * COLUMNS_MAX], expected[3];
    pad_velocity(x, over);
    for (int i = 0; i < 3; i++) {
        over[i] = x[DL_VEL + i] - deck_weight * over[i];
    }
    measured_velocity(over, b->R, x[DL_VEL_SCALE], expected);
    for (int i = 0; i < 3; i++) {
        innov[i] = v[i] - expected[i];
    }
    by_velocity(x, b->R, 1.0, -deck_weight, H);
    pick_rows(axes, COLUMNS_MAX, H);
    const int m = pick_rows(axes, 1, innov);
    spread_of(m, DL_VELOCITY, H, P, spread);
    return m;
}

/* The log-odds, -3..3, by which one sample favours a velocity over the deck against one over the ground. */
static double evidence_for_the_deck(const dl_belief *b, const double *P, const double x[DL_N], const double v[3], const double cov[9],
                                    int axes)
{
    double ground[3], deck[3], by_ground[9], by_deck[9], both[9], R[9], misfit_ground, misfit_deck, least = REFUTED;
    const int m = compare_velocity(b, P, x, v, axes, 0.0, ground, by_ground);
    compare_velocity(b, P, x, v, axes, 1.0, deck, by_deck);
    pick(axes, cov, R);
    for (int i = 0; i < m * m; i++) {
        both[i] = by_ground[i] + by_deck[i] + R[i];
        by_ground[i] += R[i];
        by_deck[i] += R[i];
    }
    if (!nis_of(m, ground, by_ground, &misfit_ground) || !nis_of(m, deck, by_deck, &misfit_deck)) {
        return 0.0;
    }
    if (fmax(misfit_ground, misfit_deck) < REFUTED) {
        /* Neither hypothesis is refuted. Both are tested with the sum of both covariances; otherwise the current hypothesis would
         * win because it has made itself certain. */
        least = 0.0;
        if (!nis_of(m, ground, both, &misfit_ground) || !nis_of(m, deck, both, &misfit_deck)) {
            return 0.0;
        }
    }
    return fmax(-3.0, fmin(3.0, 0.5 * (fmax(misfit_ground, least) - fmax(misfit_deck, least))));
}

/* Whether samples can distinguish the deck from the water: once the pad was seen, or while the vessel reports her velocity. A drone
 * that comes from astern is over a large deck before it sees the pad. */
static int surface_is_open(const dl_filter_params *o, const dl_belief *b, const double *P)
{
    const double *var = P + DL_VESSEL_VEL * (DL_N + 1);
    return o->velocity_is_over == DL_OVER_EITHER && (happened(b->sighted) || var[0] + var[DL_N + 1] < KNOWN_VAR);
}

/* Update the log-odds between the two hypotheses about a velocity. Correlated samples count as one. */
static void update_surface_odds(const dl_filter_params *o, dl_belief *b, const double *P, const double v[3], const double cov[9], int axes)
{
    const double since = happened(b->t_velocity) ? seconds(b->t_velocity, b->t) : 1.0;
    double x[DL_N], away, spread, expected = 0.0;
    if (since < 0.5 * o->correlation_s[DL_VELOCITY] || axes == 0) {
        return;
    }
    state_at_first_order(b, x);
    foot_of(b, P, x, &away, &spread);
    if (!happened(b->sighted)) {
        expected = UNSEEN_EXPECTED;
    } else if (away + 2.0 * spread < o->deck_radius_m) {
        expected = OVER_EXPECTED;
    } else if (away - 2.0 * spread > 4.0 * o->deck_radius_m) {
        expected = -OVER_EXPECTED;
    }
    double odds = expected + (b->over_pad - expected) * exp(-since / OVER_MEMORY_S);
    odds += evidence_for_the_deck(b, P, x, v, cov, axes) * fmin(1.0, 0.5 * since / o->correlation_s[DL_VELOCITY]);
    b->over_pad = fmax(happened(b->sighted) ? -6.0 : UNSEEN_EXPECTED, fmin(6.0, odds));
    b->t_velocity = b->t;
}

static double deck_weight_of(const dl_filter_params *o, const dl_belief *b, int is_open)
{
    if (!is_open) {
        return o->velocity_is_over == DL_OVER_PAD ? 1.0 : 0.0;
    }
    const double weight = 1.0 / (1.0 + exp(-b->over_pad));
    return weight < 0.03 ? 0.0 : weight > 0.97 ? 1.0 : weight;
}

/* The noise that an uncertain deck weight adds, by the deck's velocity as a body at rest would measure it. */
static void ambiguity_of(const dl_belief *b, const double *P, const double x[DL_N], int axes, double deck_weight, double out[9])
{
    const double doubt = deck_weight * (1.0 - deck_weight);
    double H[3 * COLUMNS_MAX], v_pad[3], gap[3];
    pad_velocity(x, v_pad);
    measured_velocity(v_pad, b->R, x[DL_VEL_SCALE], gap);
    by_velocity(x, b->R, 0.0, 1.0, H);
    pick_rows(axes, COLUMNS_MAX, H);
    const int m = pick_rows(axes, 1, gap);
    spread_of(m, DL_VELOCITY, H, P, out);
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < m; j++) {
            out[i * m + j] = doubt * (gap[i] * gap[j] + out[i * m + j] + (i == j ? 1e-9 : 0.0));
        }
    }
}

/* Whether a sample is refused because it contradicts the assumed surface and not the other one: the body has come over
 * an edge. Fused, it would be taken for a leap of the body's velocity before the odds have turned. */
static int refused_at_an_edge(const dl_filter_params *o, const dl_belief *b, const double *P, const double v[3], const double cov[9],
                              const dl_aid *begun, const double innov[3], dl_outcome *out)
{
    const int m = (int)begun->m, axes = (int)begun->axes;
    double S[9], nis, x[DL_N];
    pick(axes, cov, S);
    for (int i = 0; i < m * m; i++) {
        S[i] += begun->spread[i];
    }
    if (!nis_of(m, innov, S, &nis) || nis < REFUTED) {
        return 0;
    }
    state_at_first_order(b, x);
    if ((begun->deck_weight < 0.5 ? 1.0 : -1.0) * evidence_for_the_deck(b, P, x, v, cov, axes) <= 0.0) {
        return 0;
    }
    write_outcome(out, DL_GATED, m, axes, innov, S, nis, o->nis_max[m - 1]);
    return 1;
}

void fuse_velocity(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_velocity *seen, dl_outcome *out)
{
    const double *v = seen->v_level, *cov = seen->cov_level;
    const int axes = measured_axes(o, cov), is_open = surface_is_open(o, b, c->P);
    if (is_open) {
        update_surface_odds(o, b, c->P, v, cov, axes);
    }
    const double deck_weight = deck_weight_of(o, b, is_open);
    out->verdict = DL_GATED;
    /* Below a body whose pad was swung away the deck moves like no deck, and then the water does. */
    if (axes == 0 || (deck_weight == 1.0 && !happened(b->sighted) && !is_open) || is_swung(b, b->t)) {
        return;
    }
    double over[3], expected[3], innov[3], R[9];
    pad_velocity(b->x, over);
    for (int i = 0; i < 3; i++) {
        over[i] = b->x[DL_VEL + i] + b->dv[i] - deck_weight * over[i];
    }
    over[2] += GRAVITY_M_S2 * seconds(b->t_cov, b->t);
    measured_velocity(over, b->R, b->x[DL_VEL_SCALE], expected);
    for (int i = 0; i < 3; i++) {
        innov[i] = v[i] - expected[i];
    }
    pick(axes, cov, R);
    const int m = pick_rows(axes, 1, innov);
    dl_aid begun = b->aids[DL_VELOCITY];
    if (!still_gathers(o, b, DL_VELOCITY, axes, deck_weight)) {
        double x[DL_N], H[3 * COLUMNS_MAX], ambiguity[9] = {0.0};
        state_at_first_order(b, x);
        by_velocity(x, b->R, 1.0, -deck_weight, H);
        pick_rows(axes, COLUMNS_MAX, H);
        if (deck_weight > 0.0 && deck_weight < 1.0) {
            ambiguity_of(b, c->P, x, axes, deck_weight, ambiguity);
        }
        begun.m = m, begun.axes = axes, begun.deck_weight = deck_weight;
        begin_gathering(&begun, b, c, DL_VELOCITY, H, ambiguity);
    }
    if (is_open && refused_at_an_edge(o, b, c->P, v, cov, &begun, innov, out)) {
        return;
    }
    gather(o, b, c, DL_VELOCITY, &begun, innov, R, out);
}
