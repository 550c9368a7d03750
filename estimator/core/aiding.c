#include "aiding.h"

#include <math.h>
#include <string.h>

#include "correction.h"
#include "rotation.h"

/* Length of a rejection streak after which a kind of aiding is accepted again, with what it contradicts made uncertain. */
static const double STUCK_S = 1.0;
/* Time constant with which the evidence of velocity samples about the surface below decays. */
static const double OVER_MEMORY_S = 3.0;
/* Log-odds of measuring against the deck when the body is surely over it, and against the water when it surely is not. */
static const double OVER_EXPECTED = 3.0;
/* NIS above which a hypothesis is refuted by its own covariance; one true sample in twenty exceeds it. */
static const double REFUTED = 6.0;

enum { ALL_AXES = 7 };

/* The states on which each kind of aiding depends; a row of a Jacobian holds their derivatives in this order. */
static const int ATTITUDE_BY[] = {ATT_ERR, ATT_ERR + 1, ATT_ERR + 2, ATT_BIAS, ATT_BIAS + 1};
static const int VELOCITY_BY[] = {ATT_ERR, ATT_ERR + 1, ATT_ERR + 2, VEL, VEL + 1, VEL + 2, VESSEL_VEL, VESSEL_VEL + 1, SURGING,
                                  SWAYING, HEAVING, SWAY_PER_HEAVE, SWAY_PER_HEAVE + 1, VEL_SCALE};
static const int RANGE_BY[] = {ATT_ERR, ATT_ERR + 1, ATT_ERR + 2, POS_REL, POS_REL + 1, POS_REL + 2, ROLL, DECK_TRIM, PITCH,
                               DECK_TRIM + 1, PAD_YAW, RANGE_OFFSET};
static const int HEIGHT_BY[] = {POS_REL + 2, HEAVE, BARO_OFFSET};
static const int *const BY[] = {ATTITUDE_BY, VELOCITY_BY, RANGE_BY, HEIGHT_BY};
static const int BY_SIZE[] = {5, 14, 12, 3};
enum { BY_ATT = 0, BY_VEL = 3, BY_VESSEL = 6, BY_DECK = 8, BY_SWAY = 11, BY_SCALE = 13 };

/* out = H P H', (m, m), of sparse Jacobians */
static void spread_of(int m, int kind, const double *H, const double *P, double *out)
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
static int is_stale(const filter_params *o, const aid *a, int64_t t)
{
    return seconds(a->since, t) > 2.0 * o->aiding_period_s;
}

void fuse_gathered(const filter_params *o, belief *b, covariance *c)
{
    double innov[ROWS_MAX], H[ROWS_MAX * N], R[ROWS_MAX * ROWS_MAX], S[ROWS_MAX * ROWS_MAX], dx[N], nis;
    int m = 0, waiting = 0;
    for (int kind = 0; kind < KINDS; kind++) {
        const aid *a = &b->aids[kind];
        waiting += a->n > 0;
        m += a->n > 0 && !is_stale(o, a, b->t) ? (int)a->m : 0;
    }
    if (waiting == 0) {
        return;
    }
    propagate_covariance(o, b, c);
    memset(H, 0, sizeof H);
    memset(R, 0, sizeof R);
    int at = 0;
    for (int kind = 0; kind < KINDS; kind++) {
        aid *a = &b->aids[kind];
        if (a->n > 0 && !is_stale(o, a, b->t)) {
            /* Errors with correlation time tau leave one independent sample in 2 tau, however many samples there are. */
            const double window = a->fused >= 0 ? seconds(a->fused, b->t) : INFINITY;
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
    if (m > 0 && kalman_correct(N, m, c->P, innov, H, R, dx, place, S, &nis)) {
        correct_belief(b, c, dx, place);
    }
}

/* P gains var g g' */
static void inflate_along(double *P, const double g[N], double var)
{
    for (int i = 0; i < N; i++) {
        if (g[i] != 0.0) {
            for (int j = 0; j < N; j++) {
                AT(P, i, j) += var * g[i] * g[j];
            }
        }
    }
}

/* Make uncertain what a rejected sensor contradicts, in directions that leave the pad's position certain. */
static void inflate(const belief *b, covariance *c, int kind, const double *innov)
{
    double *P = changeable(c), g[N] = {0.0};
    const double *x = b->x;
    if (kind == ATTITUDE) {
        /* All directions turn together about the vertical, as they do when the attitude source redefines north. */
        const int turning[] = {POS_REL, VEL, VESSEL_VEL, SWAY_PER_HEAVE};
        const double down[3] = {b->R[6], b->R[7], b->R[8]}, angle = dot(innov, down), size = fmin(dot(innov, innov), 0.1);
        memcpy(g + ATT_ERR, down, sizeof down);
        g[PAD_YAW] = 1.0;
        for (int i = 0; i < 4; i++) {
            g[turning[i]] = -x[turning[i] + 1];
            g[turning[i] + 1] = x[turning[i]];
        }
        for (int i = 0; i < 4; i++) {
            g[WAVES + i] = -x[WAVES + 4 + i];
            g[WAVES + 4 + i] = x[WAVES + i];
        }
        inflate_along(P, g, angle * angle);
        for (int i = 0; i < 3; i++) {
            AT(P, ATT_ERR + i, ATT_ERR + i) += 0.1 * size;
        }
        for (int i = 0; i < 2; i++) {
            AT(P, ATT_BIAS + i, ATT_BIAS + i) += size;
        }
    } else if (kind == VELOCITY) {
        /* Body and vessel drift together. */
        const double var = innov[0] * innov[0] + innov[1] * innov[1];
        for (int i = 0; i < 2; i++) {
            memset(g, 0, sizeof g);
            g[VEL + i] = g[VESSEL_VEL + i] = 1.0;
            inflate_along(P, g, var);
        }
        AT(P, VEL_SCALE, VEL_SCALE) += 0.01;
    } else if (kind == HEIGHT) {
        AT(P, BARO_OFFSET, BARO_OFFSET) += innov[0] * innov[0];
    }
}

/* Begin to gather a kind of sample: the prediction's Jacobian and covariance hold for the whole period. */
static void begin(aid *a, const belief *b, const covariance *c, int kind, int m, int axes, double deck_weight, const double *H,
                  const double *ambiguity)
{
    a->n = 0;
    a->since = b->t;
    a->m = m;
    a->axes = axes;
    a->deck_weight = deck_weight;
    memset(a->innov, 0, sizeof a->innov);
    memset(a->R, 0, sizeof a->R);
    memcpy(a->H, H, sizeof a->H);
    spread_of(m, kind, H, c->P, a->spread);
    for (int i = 0; i < m * m; i++) {
        a->ambiguity[i] = ambiguity == NULL ? 0.0 : ambiguity[i];
        a->spread[i] += a->ambiguity[i];
    }
}

static int continues(const filter_params *o, const belief *b, int kind, int axes, double deck_weight)
{
    const aid *a = &b->aids[kind];
    return a->n > 0 && a->axes == axes && a->deck_weight == deck_weight && !is_stale(o, a, b->t);
}

/* Add a sample to those that are fused at the end of the aiding period, unless the gate rejects it.
 *
 * `begun` is the kind's gathering with this sample's prediction if it begins a period, else as it is in the belief. */
static void gather(const filter_params *o, belief *b, covariance *c, int kind, const aid *begun, const double *innov,
                   const double *R, outcome *out)
{
    aid *a = &b->aids[kind];
    const int m = (int)begun->m;
    double S[9], nis;
    for (int i = 0; i < m * m; i++) {
        S[i] = begun->spread[i] + R[i];
    }
    if (!nis_of(m, innov, S, &nis)) {
        tell(out, SINGULAR, m, (int)begun->axes, innov, S);
        return;
    }
    const double nis_max = o->nis_max[m - 1];
    tell(out, nis > nis_max ? GATED : FUSED, m, (int)begun->axes, innov, S);
    out->nis = nis;
    out->nis_max = nis_max;
    if (nis > nis_max) {
        int64_t since = a->refused >= 0 ? a->refused : b->t;
        if (seconds(since, b->t) > STUCK_S) {
            inflate(b, c, kind, innov);
            since = -1;
        }
        a->refused = since;
        return;
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
    for (int other = 0; other < KINDS; other++) {
        if (b->aids[other].n > 0 && b->aids[other].since < first) {
            first = b->aids[other].since;
        }
    }
    if (seconds(first, b->t) >= o->aiding_period_s || fused < 0) {
        fuse_gathered(o, b, c);
    }
}

void take_attitude(const filter_params *o, belief *b, covariance *c, const double *R_ned_body, const double *cov, outcome *out)
{
    double gap[9], innov[3];
    aid begun = b->aids[ATTITUDE];
    product_of_transposed(b->R, R_ned_body, gap);
    log_rotation(gap, innov);
    innov[0] -= b->x[ATT_BIAS];
    innov[1] -= b->x[ATT_BIAS + 1];
    if (!continues(o, b, ATTITUDE, 0, 0.0)) {
        double H[3 * COLUMNS_MAX] = {0.0};
        for (int i = 0; i < 3; i++) {
            H[i * COLUMNS_MAX + i] = 1.0;
        }
        for (int i = 0; i < 2; i++) {
            H[i * COLUMNS_MAX + 3 + i] = 1.0;
        }
        begin(&begun, b, c, ATTITUDE, 3, 0, 0.0, H, NULL);
    }
    gather(o, b, c, ATTITUDE, &begun, innov, cov, out);
    memcpy(b->levelled_by, R_ned_body, sizeof b->levelled_by);
    memcpy(b->cov_levelled_by, cov, sizeof b->cov_levelled_by);
    b->is_levelled = b->heading_is_given = 1;
}

void take_height(const filter_params *o, belief *b, covariance *c, double height_m, double sigma_m, outcome *out)
{
    const double T = seconds(b->t_cov, b->t), var = sigma_m * sigma_m;
    aid begun = b->aids[HEIGHT];
    if (b->sighted < 0) {
        out->verdict = GATED;
        return;
    }
    const double depth = b->x[POS_REL + 2] - b->x[HEAVE] - b->x[VEL + 2] * T - b->dp[2] - 0.5 * GRAVITY_M_S2 * T * T;
    const double innov = height_m - (depth + b->x[BARO_OFFSET]);
    if (!continues(o, b, HEIGHT, 0, 0.0)) {
        const double H[3 * COLUMNS_MAX] = {1.0, -1.0, 1.0};
        begin(&begun, b, c, HEIGHT, 1, 0, 0.0, H, NULL);
    }
    gather(o, b, c, HEIGHT, &begun, &innov, &var, out);
}

/* The distance from the pad's centre at which the body's down axis meets the deck, and its sigma, m. */
static void foot_of(const belief *b, const double *P, const double x[N], double *away, double *spread)
{
    const double c[3] = {b->R[2], b->R[5], b->R[8]}, reach = x[POS_REL + 2] / fmax(c[2], 0.3);
    const double var = (AT(P, POS_REL, POS_REL) + AT(P, POS_REL + 1, POS_REL + 1)) / 2.0;
    *away = hypot(x[POS_REL] - c[0] * reach, x[POS_REL + 1] - c[1] * reach);
    *spread = sqrt(fmax(var, 0.0));
}

/* The distance along the body's down axis to the deck's plane and its Jacobian; 0 if they do not meet. */
static int distance(const double R[9], const double x[N], double *r, double H[3 * COLUMNS_MAX])
{
    const double roll = x[ROLL] + x[DECK_TRIM], pitch = x[PITCH] + x[DECK_TRIM + 1], yaw = x[PAD_YAW];
    double pad[9], by_n[3], reach[3];
    from_rpy(roll, pitch, yaw, pad);
    const double n[3] = {pad[2], pad[5], pad[8]}, c[3] = {R[2], R[5], R[8]}, cosine = dot(n, c);
    if (cosine < 0.3) {
        return 0;
    }
    *r = dot(n, x + POS_REL) / cosine;
    rotated_back(R, n, by_n);
    memset(H, 0, 3 * COLUMNS_MAX * sizeof *H);
    H[0] = *r / cosine * by_n[1];
    H[1] = -*r / cosine * by_n[0];
    for (int i = 0; i < 3; i++) {
        H[3 + i] = n[i] / cosine;
        reach[i] = (x[POS_REL + i] - *r * c[i]) / cosine;
    }
    double cross[9], turned[3], by_roll[3], by_pitch[3];
    pad_axes(pitch, yaw, by_roll, by_pitch);
    skew(n, cross);
    rotated(cross, reach, turned);
    H[6] = H[7] = dot(turned, by_roll);
    H[8] = H[9] = dot(turned, by_pitch);
    H[10] = turned[2];
    H[11] = 1.0;
    return 1;
}

void take_range(const filter_params *o, belief *b, covariance *c, double range_m, double sigma_m, outcome *out)
{
    double x[N], away, spread, r, H[3 * COLUMNS_MAX];
    const double var = sigma_m * sigma_m;
    out->verdict = GATED;
    if (b->sighted < 0) {
        return;
    }
    peek(b, x);
    foot_of(b, c->P, x, &away, &spread);
    /* There is water beyond the deck's edge. */
    if (away + 2.0 * spread > o->deck_radius_m || !distance(b->R, x, &r, H)) {
        return;
    }
    const double innov = range_m - r - x[RANGE_OFFSET];
    aid begun = b->aids[RANGE];
    if (!continues(o, b, RANGE, 0, 0.0)) {
        begin(&begun, b, c, RANGE, 1, 0, 0.0, H, NULL);
    }
    gather(o, b, c, RANGE, &begun, &innov, &var, out);
}

/* What a sensor with that scale measures of a velocity, m/s in `level`. */
static void measured_velocity(const double v[3], const double R[9], double scale, double out[3])
{
    const double k = scale / hypot(R[0], R[3]);
    out[0] = k * (R[0] * v[0] + R[3] * v[1]);
    out[1] = k * (R[0] * v[1] - R[3] * v[0]);
    out[2] = v[2];
}

/* The Jacobian of the measured velocity body_weight v + deck_weight v_pad, (3, COLUMNS_MAX). */
static void by_velocity(const double x[N], const double R[9], double body_weight, double deck_weight, double H[3 * COLUMNS_MAX])
{
    const double scale = x[VEL_SCALE], flat = hypot(R[0], R[3]), c = scale * R[0] / flat, s = scale * R[3] / flat;
    const double to_level[3][3] = {{c, s, 0.0}, {-s, c, 0.0}, {0.0, 0.0, 1.0}};
    double v_pad[3], v[3], level[3], turning[3];
    pad_velocity(x, v_pad);
    for (int i = 0; i < 3; i++) {
        v[i] = body_weight * x[VEL + i] + deck_weight * v_pad[i];
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
            row[BY_SWAY + j] = deck_weight * to_level[i][j] * x[HEAVING];
            row[BY_DECK + 2] += deck_weight * to_level[i][j] * x[SWAY_PER_HEAVE + j];
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

static int measured_axes(const filter_params *o, const double cov[9])
{
    int axes = 0;
    for (int i = 0; i < 3; i++) {
        axes |= (cov[4 * i] < o->not_measured_var) << i;
    }
    return axes;
}

/* A velocity that is measured against a surface that moves with weight `deck_weight` as the deck does: innovation and H P H'. */
static int compare_velocity(const belief *b, const double *P, const double x[N], const double v[3], int axes, double deck_weight,
                            double innov[3], double spread[9])
{
    double over[3], H[3 * COLUMNS_MAX], expected[3];
    pad_velocity(x, over);
    for (int i = 0; i < 3; i++) {
        over[i] = x[VEL + i] - deck_weight * over[i];
    }
    measured_velocity(over, b->R, x[VEL_SCALE], expected);
    for (int i = 0; i < 3; i++) {
        innov[i] = v[i] - expected[i];
    }
    by_velocity(x, b->R, 1.0, -deck_weight, H);
    pick_rows(axes, COLUMNS_MAX, H);
    const int m = pick_rows(axes, 1, innov);
    spread_of(m, VELOCITY, H, P, spread);
    return m;
}

/* The log-odds, -3..3, by which one sample favours a velocity over the deck against one over the ground. */
static double evidence_for_the_deck(const belief *b, const double *P, const double x[N], const double v[3], const double cov[9],
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

/* Update the log-odds between the two hypotheses about a velocity. Correlated samples count as one. */
static void look_below(const filter_params *o, belief *b, const double *P, const double v[3], const double cov[9], int axes)
{
    const double since = b->t_velocity < 0 ? 1.0 : seconds(b->t_velocity, b->t);
    double x[N], away, spread, expected = 0.0;
    if (since < 0.5 * o->correlation_s[VELOCITY] || axes == 0) {
        return;
    }
    peek(b, x);
    foot_of(b, P, x, &away, &spread);
    if (away + 2.0 * spread < o->deck_radius_m) {
        expected = OVER_EXPECTED;
    } else if (away - 2.0 * spread > 4.0 * o->deck_radius_m) {
        expected = -OVER_EXPECTED;
    }
    double odds = expected + (b->over_pad - expected) * exp(-since / OVER_MEMORY_S);
    odds += evidence_for_the_deck(b, P, x, v, cov, axes) * fmin(1.0, 0.5 * since / o->correlation_s[VELOCITY]);
    b->over_pad = fmax(-6.0, fmin(6.0, odds));
    b->t_velocity = b->t;
}

static double deck_weight_of(const filter_params *o, const belief *b)
{
    if (o->velocity_is_over != OVER_EITHER) {
        return o->velocity_is_over == OVER_PAD ? 1.0 : 0.0;
    }
    if (b->sighted < 0) {
        return 0.0;
    }
    const double weight = 1.0 / (1.0 + exp(-b->over_pad));
    return weight < 0.03 ? 0.0 : weight > 0.97 ? 1.0 : weight;
}

/* The noise that an uncertain deck weight adds, by the deck's velocity as a body at rest would measure it. */
static void ambiguity_of(const belief *b, const double *P, const double x[N], int axes, double deck_weight, double out[9])
{
    const double doubt = deck_weight * (1.0 - deck_weight);
    double H[3 * COLUMNS_MAX], v_pad[3], gap[3];
    pad_velocity(x, v_pad);
    measured_velocity(v_pad, b->R, x[VEL_SCALE], gap);
    by_velocity(x, b->R, 0.0, 1.0, H);
    pick_rows(axes, COLUMNS_MAX, H);
    const int m = pick_rows(axes, 1, gap);
    spread_of(m, VELOCITY, H, P, out);
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < m; j++) {
            out[i * m + j] = doubt * (gap[i] * gap[j] + out[i * m + j] + (i == j ? 1e-9 : 0.0));
        }
    }
}

void take_velocity(const filter_params *o, belief *b, covariance *c, const double v[3], const double *cov, outcome *out)
{
    const int axes = measured_axes(o, cov);
    if (o->velocity_is_over == OVER_EITHER && b->sighted >= 0) {
        look_below(o, b, c->P, v, cov, axes);
    }
    const double deck_weight = deck_weight_of(o, b);
    out->verdict = GATED;
    if (axes == 0 || (deck_weight == 1.0 && b->sighted < 0)) {
        return;
    }
    double over[3], expected[3], innov[3], R[9];
    pad_velocity(b->x, over);
    for (int i = 0; i < 3; i++) {
        over[i] = b->x[VEL + i] + b->dv[i] - deck_weight * over[i];
    }
    over[2] += GRAVITY_M_S2 * seconds(b->t_cov, b->t);
    measured_velocity(over, b->R, b->x[VEL_SCALE], expected);
    for (int i = 0; i < 3; i++) {
        innov[i] = v[i] - expected[i];
    }
    pick(axes, cov, R);
    const int m = pick_rows(axes, 1, innov);
    aid begun = b->aids[VELOCITY];
    if (!continues(o, b, VELOCITY, axes, deck_weight)) {
        double x[N], H[3 * COLUMNS_MAX], ambiguity[9] = {0.0};
        peek(b, x);
        by_velocity(x, b->R, 1.0, -deck_weight, H);
        pick_rows(axes, COLUMNS_MAX, H);
        if (deck_weight > 0.0 && deck_weight < 1.0) {
            ambiguity_of(b, c->P, x, axes, deck_weight, ambiguity);
        }
        begin(&begun, b, c, VELOCITY, m, axes, deck_weight, H, ambiguity);
    }
    gather(o, b, c, VELOCITY, &begun, innov, R, out);
}
