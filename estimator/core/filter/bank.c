/* Move every member of the bank on to a sighting, correct it, and weigh it by how well it predicted. */

#include "filter/bank.h"

#include <math.h>
#include <string.h>

#include "filter/oscillator.h"
#include "filter/propagate.h"
#include "filter/skill.h"
#include "base/wide.h"

enum { STATES = MEMBER_STATES, OFFSET = 4 };

/* Evidence fades over this time, so that another sea is learned. */
static const double MEMORY_S = 180.0;
/* NIS beyond which an innovation counts no more against a member. */
static const double NIS_MAX = 16.0;
/* The least logarithm of a member's weight against the best one's. */
static const double LOG_WEIGHT_MIN = -30.0;
/* Prior of offset, its rate, acceleration: of places, and of a deck's list, which is an offset that does not drift. */
static const double DRIFT_VAR[3] = {25.0, 9.0, 1.0};
static const double LIST_RAD = 2.0 * 3.14159265358979323846 / 180.0; /* Standard deviation of that list. */
/* Prior of the mean that is left in the numbers of a motion sensor, m^2 or rad^2, as a part of the size that is usual, and its random
 * walk: it takes her slow motion off itself. */
static const double SENSOR_MEAN_VAR[2] = {0.1 * 0.1, 0.005 * 0.005}, SENSOR_DRIFT_PSD[2] = {0.01 * 0.01, 0.0005 * 0.0005};

/* The least logarithm of a member's weight against the best one's by a sensor alone, which sightings may contradict. */
static const double UNPROVEN_MIN = -5.0;

/* What moves every member on by the same time. Arrays are by member. */
typedef struct {
    double one[DL_MEMBERS], dt[DL_MEMBERS], half[DL_MEMBERS];
    /* The transition of displacement and rate, of the force and its rate, and of the former by the latter. */
    double own[2][2][DL_MEMBERS], driven[2][2][DL_MEMBERS];
    double q[4][4][DL_MEMBERS];
} member_step;

int member_pair(int i, int j)
{
    return i <= j ? i * (2 * STATES - 1 - i) / 2 + j : j * (2 * STATES - 1 - j) / 2 + i;
}

/* Whether a member's oscillator is that of the member before: they differ in size alone, which no transition depends on. */
static int moves_alike(const dl_bank_members *m, int g)
{
    return g > 0 && m->w[g] == m->w[g - 1] && m->zeta[g] == m->zeta[g - 1];
}

static void step_members(const dl_bank_members *m, double T, member_step *s)
{
    double A[4][4] = {{0.0}}, q[4][4] = {{0.0}};
    for (int g = 0; g < DL_MEMBERS; g++) {
        if (!moves_alike(m, g)) {
            oscillator_transition(m->w[g], m->zeta[g], T, A, q);
        }
        s->one[g] = 1.0;
        s->dt[g] = T;
        s->half[g] = 0.5 * T * T;
        for (int i = 0; i < 2; i++) {
            for (int j = 0; j < 2; j++) {
                s->own[i][j][g] = A[i][j];
                s->driven[i][j][g] = A[i][2 + j];
            }
        }
        for (int i = 0; i < 4; i++) {
            for (int j = 0; j < 4; j++) {
                s->q[i][j][g] = q[i][j];
            }
        }
    }
}

/* The members' transition, (7, 7): NULL where it is zero. */
static void transition_of(const member_step *s, const double *F[STATES][STATES])
{
    memset(F, 0, STATES * sizeof F[0]);
    for (int i = 0; i < 2; i++) {
        for (int j = 0; j < 2; j++) {
            F[i][j] = F[2 + i][2 + j] = s->own[i][j];
            F[i][2 + j] = s->driven[i][j];
        }
    }
    for (int i = 0; i < 3; i++) {
        F[OFFSET + i][OFFSET + i] = s->one;
    }
    F[OFFSET][OFFSET + 1] = F[OFFSET + 1][OFFSET + 2] = s->dt;
    F[OFFSET][OFFSET + 2] = s->half;
}

/* The products that make one number of every member: at most four, as no row of a transition has more entries. */
typedef struct {
    int n;
    const double *a[4], *x[4];
} products;

static void add_product(products *sum, const double *a, const double *x)
{
    if (a != NULL) {
        sum->a[sum->n] = a;
        sum->x[sum->n++] = x;
    }
}

/* out = their sum, for every member */
static inline void evaluate(const products *sum, double *restrict out)
{
    const double *const a0 = sum->a[0], *const x0 = sum->x[0];
    const double *const a1 = sum->a[1], *const x1 = sum->x[1], *const a2 = sum->a[2], *const x2 = sum->x[2];
    const double *const a3 = sum->a[3], *const x3 = sum->x[3];
    switch (sum->n) {
    case 1:
        for (int g = 0; g < DL_MEMBERS; g++) {
            out[g] = a0[g] * x0[g];
        }
        return;
    case 2:
        for (int g = 0; g < DL_MEMBERS; g++) {
            out[g] = a0[g] * x0[g] + a1[g] * x1[g];
        }
        return;
    case 3:
        for (int g = 0; g < DL_MEMBERS; g++) {
            out[g] = a0[g] * x0[g] + a1[g] * x1[g] + a2[g] * x2[g];
        }
        return;
    default:
        for (int g = 0; g < DL_MEMBERS; g++) {
            out[g] = a0[g] * x0[g] + a1[g] * x1[g] + a2[g] * x2[g] + a3[g] * x3[g];
        }
    }
}

/* after = F x */
static void carry_states(const double *F[STATES][STATES], const double *x, double *after)
{
    for (int i = 0; i < STATES; i++) {
        products sum = {0};
        for (int k = 0; k < STATES; k++) {
            add_product(&sum, F[i][k], x + k * DL_MEMBERS);
        }
        evaluate(&sum, after + i * DL_MEMBERS);
    }
}

/* after = F P F', the upper triangle; F has the blocks of displacement and rate, of force and its rate, of the offset. */
static void carry_covariances(const double *F[STATES][STATES], const double *P, double *after)
{
    double FP[STATES][DL_MEMBERS];
    for (int i = 0; i < STATES; i++) {
        const int first = i < OFFSET ? i / 2 * 2 : i;
        for (int k = first; k < STATES; k++) {
            products sum = {0};
            for (int l = 0; l < STATES; l++) {
                add_product(&sum, F[i][l], P + member_pair(l, k) * DL_MEMBERS);
            }
            evaluate(&sum, FP[k]);
        }
        for (int j = i; j < STATES; j++) {
            products sum = {0};
            for (int k = first; k < STATES; k++) {
                add_product(&sum, F[j][k], FP[k]);
            }
            evaluate(&sum, after + member_pair(i, j) * DL_MEMBERS);
        }
    }
}

/* The errors with which the body was carried for T: of the offset, its rate, its acceleration. */
static void carrying_noise(double psd_accel, double psd_drift, double psd_tilt, double reach_m, double T, double noise[3][3])
{
    const double T2 = T * T, T3 = T2 * T;
    noise[0][0] = psd_accel * T3 / 3.0 + psd_drift * T3 * T2 / 20.0 + reach_m * reach_m * psd_tilt * T;
    noise[0][1] = psd_accel * T2 / 2.0 + psd_drift * T2 * T2 / 8.0;
    noise[0][2] = psd_drift * T3 / 6.0;
    noise[1][1] = psd_accel * T + psd_drift * T3 / 3.0;
    noise[1][2] = psd_drift * T2 / 2.0;
    noise[2][2] = psd_drift * T;
}

static void add_noises(const member_step *s, const double *sigma, double noise[3][3], double *P)
{
    for (int i = 0; i < 4; i++) {
        for (int j = i; j < 4; j++) {
            double *row = P + member_pair(i, j) * DL_MEMBERS;
            for (int g = 0; g < DL_MEMBERS; g++) {
                row[g] += sigma[g] * sigma[g] * s->q[i][j][g];
            }
        }
    }
    for (int i = 0; i < 3; i++) {
        for (int j = i; j < 3; j++) {
            double *row = P + member_pair(OFFSET + i, OFFSET + j) * DL_MEMBERS;
            for (int g = 0; g < DL_MEMBERS; g++) {
                row[g] += noise[i][j];
            }
        }
    }
}

/* Move one direction of the bank on. */
static void carry(const dl_filter_params *o, const member_step *s, double T, const bank_look *seen, int k, const dl_bank *before,
                  dl_bank *after)
{
    const double *F[STATES][STATES];
    double noise[3][3] = {{0.0}}, *P = after->P + k * MEMBER_PAIRS * DL_MEMBERS;
    transition_of(s, F);
    carry_states(F, before->x + k * STATES * DL_MEMBERS, after->x + k * STATES * DL_MEMBERS);
    carry_covariances(F, before->P + k * MEMBER_PAIRS * DL_MEMBERS, P);
    if (seen->by_sensor) {
        noise[0][0] = SENSOR_DRIFT_PSD[k > 2] * T;
    } else {
        carrying_noise(o->carrying_psd_accel[k] + (k < 3 ? seen->ins_var / T : 0.0), o->carrying_psd_drift[k], o->carrying_psd_tilt[k],
                       seen->reach_m, T, noise);
    }
    add_noises(s, o->members.sigma + k * DL_MEMBERS, noise, P);
}

/* One direction's members after it was seen at y: a scalar Kalman correction each, and the evidence that it gives. */
static inline void look(double y, double var, double *x, double *P, double *log_weight)
{
    double PH[STATES][DL_MEMBERS], S[DL_MEMBERS], innov[DL_MEMBERS];
    for (int i = 0; i < STATES; i++) {
        const double *displacement = P + member_pair(0, i) * DL_MEMBERS, *offset = P + member_pair(OFFSET, i) * DL_MEMBERS;
        for (int g = 0; g < DL_MEMBERS; g++) {
            PH[i][g] = displacement[g] + offset[g];
        }
    }
    for (int g = 0; g < DL_MEMBERS; g++) {
        S[g] = PH[0][g] + PH[OFFSET][g] + var;
        innov[g] = y - x[g] - x[OFFSET * DL_MEMBERS + g];
        log_weight[g] -= 0.5 * (log(S[g]) + fmin(innov[g] * innov[g] / S[g], NIS_MAX));
    }
    for (int i = 0; i < STATES; i++) {
        double K[DL_MEMBERS];
        for (int g = 0; g < DL_MEMBERS; g++) {
            K[g] = PH[i][g] / S[g];
            x[i * DL_MEMBERS + g] += K[g] * innov[g];
        }
        for (int j = i; j < STATES; j++) {
            double *row = P + member_pair(i, j) * DL_MEMBERS;
            for (int g = 0; g < DL_MEMBERS; g++) {
                row[g] -= K[g] * PH[j][g];
            }
        }
    }
}

/* Forecast the waves at the horizons of the skill, and compare what was forecast of the present with it. */
static void forecast_and_compare(const dl_bank_members *m, dl_bank *s, int64_t t)
{
    double now[DL_DIRECTIONS][2] = {{0.0}}, ahead[SKILL_HORIZONS][DL_DIRECTIONS][2] = {{{0.0}}}, weight[DL_DIRECTIONS][DL_MEMBERS];
    for (int k = 0; k < DL_DIRECTIONS; k++) {
        forecast_weights(m, s->log_weight + k * DL_MEMBERS, s->weight[0], weight[k]);
        for (int g = 0; g < DL_MEMBERS; g++) {
            for (int r = 0; r < 2; r++) {
                now[k][r] += weight[k][g] * s->x[(k * STATES + r) * DL_MEMBERS + g];
            }
        }
    }
    for (int h = 0; h < SKILL_HORIZONS; h++) {
        double A[4][4] = {{0.0}}, q[4][4];
        for (int g = 0; g < DL_MEMBERS; g++) {
            if (!moves_alike(m, g)) {
                oscillator_transition(m->w[g], m->zeta[g], SKILL_HORIZONS_S[h], A, q);
            }
            for (int k = 0; k < DL_DIRECTIONS; k++) {
                const double *x = s->x + k * STATES * DL_MEMBERS + g;
                for (int r = 0; r < 2; r++) {
                    const double there = A[r][0] * x[0] + A[r][1] * x[DL_MEMBERS] + A[r][2] * x[2 * DL_MEMBERS] + A[r][3] * x[3 * DL_MEMBERS];
                    ahead[h][k][r] += weight[k][g] * there;
                }
            }
        }
    }
    skill_compare(&s->skill, t, now, ahead);
}

/* Begin the offset of one direction's members with what is known of the origin of its looks. */
static void open_offset(int k, int by_sensor, double *P)
{
    for (int i = 0; i < 3; i++) {
        const double of_sensor = i == 0 ? SENSOR_MEAN_VAR[k > 2] : 0.0;
        const double var = by_sensor ? of_sensor : k < 3 ? DRIFT_VAR[i] : i == 0 ? LIST_RAD * LIST_RAD : 0.0;
        for (int j = 0; j < STATES; j++) {
            double *row = P + member_pair(OFFSET + i, j) * DL_MEMBERS;
            for (int g = 0; g < DL_MEMBERS; g++) {
                row[g] = j == OFFSET + i ? var : 0.0;
            }
        }
    }
}

void bank_begin(const dl_bank_members *m, dl_bank *after)
{
    memset(after, 0, sizeof *after);
    after->t = after->sighted = -1;
    for (int k = 0; k < DL_DIRECTIONS; k++) {
        const double *sigma = m->sigma + k * DL_MEMBERS;
        double *P = after->P + k * MEMBER_PAIRS * DL_MEMBERS;
        memcpy(after->log_weight + k * DL_MEMBERS, m->log_prior, sizeof m->log_prior);
        for (int g = 0; g < DL_MEMBERS; g++) {
            double at_rest[4][4];
            oscillator_at_rest(m->w[g], m->zeta[g], at_rest);
            for (int i = 0; i < 4; i++) {
                for (int j = i; j < 4; j++) {
                    P[member_pair(i, j) * DL_MEMBERS + g] = sigma[g] * sigma[g] * at_rest[i][j];
                }
            }
        }
        open_offset(k, 0, P);
    }
    summarise(m, after);
}

/* Evidence by a sensor alone counts for little where sightings begin, and none of it for a deck at rest. */
static void temper(const dl_bank_members *m, double *log_weight)
{
    double moving = 0.0;
    for (int g = 1; g < DL_MEMBERS; g++) {
        log_weight[g] = m->log_prior[g] + fmax(log_weight[g] - m->log_prior[g], UNPROVEN_MIN);
        moving += exp(log_weight[g]);
    }
    log_weight[0] = m->log_prior[0] + log(moving) - log1p(-exp(m->log_prior[0]));
}

/* Where a direction's looks begin again: by a sensor at the mean that it took off itself, by the IMU wherever the first is. */
static void begin_origin(const dl_bank_members *m, int k, const bank_look *seen, const dl_bank *before, double *x, double *P,
                         double *log_weight)
{
    const int anywhere = !seen->by_sensor && k < 3 && seen->var[k] < UNSEEN_VAR;
    open_offset(k, seen->by_sensor, P);
    memset(x + OFFSET * DL_MEMBERS, 0, 3 * DL_MEMBERS * sizeof *x);
    for (int g = 0; g < DL_MEMBERS && anywhere; g++) {
        x[OFFSET * DL_MEMBERS + g] = seen->y[k] - x[g];
    }
    if (happened(before->t) && !seen->by_sensor) {
        temper(m, log_weight);
    }
}

WIDE
void bank_observe(const dl_filter_params *o, int64_t t, const bank_look *seen, const dl_bank *before, dl_bank *after)
{
    const dl_bank_members *m = &o->members;
    const double T = seconds(before->t, t);
    double fade = 1.0;
    if (happened(before->t) && T > 0.0) {
        member_step s;
        step_members(m, T, &s);
        for (int k = 0; k < DL_DIRECTIONS; k++) {
            carry(o, &s, T, seen, k, before, after);
        }
        fade = exp(-T / MEMORY_S);
    } else {
        memcpy(after->x, before->x, sizeof after->x);
        memcpy(after->P, before->P, sizeof after->P);
    }
    for (int k = 0; k < DL_DIRECTIONS; k++) {
        double *x = after->x + k * STATES * DL_MEMBERS, *log_weight = after->log_weight + k * DL_MEMBERS;
        const double *known = before->log_weight + k * DL_MEMBERS;
        for (int g = 0; g < DL_MEMBERS; g++) {
            log_weight[g] = fade * (known[g] - m->log_prior[g]) + m->log_prior[g];
        }
        /* The first look sets the offset's origin; the prior is about it, not about the world's. */
        if (!happened(before->t) || happened(before->sighted) == seen->by_sensor) {
            begin_origin(m, k, seen, before, x, after->P + k * MEMBER_PAIRS * DL_MEMBERS, log_weight);
        }
        if (seen->var[k] < UNSEEN_VAR) {
            look(seen->y[k], seen->var[k], x, after->P + k * MEMBER_PAIRS * DL_MEMBERS, log_weight);
        }
        const double top = largest(DL_MEMBERS, log_weight);
        for (int g = 0; g < DL_MEMBERS; g++) {
            log_weight[g] = fmax(log_weight[g] - top, LOG_WEIGHT_MIN);
        }
    }
    after->t = t;
    after->sighted = seen->by_sensor ? -1 : t;
    after->skill = before->skill;
    summarise(m, after);
    if (skill_due(&after->skill, t)) {
        forecast_and_compare(m, after, t);
    }
}
