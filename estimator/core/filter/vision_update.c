/* Fuse a sighting: gate, reset, correct, and teach the bank. */

#include "filter/vision_update.h"

#include <math.h>
#include <string.h>

#include "filter/correction.h"
#include "filter/deck_jolt.h"
#include "filter/gate.h"
#include "base/kalman.h"
#include "base/rotation.h"
#include "filter/baseline.h"
#include "filter/reset.h"
#include "filter/sighting.h"

/* Fraction of the correction of the camera's mounting that is withheld on a rough sea, and of the covariance's root with it. */
static const double WITHHELD_MOUNT = 0.95;
/* Fraction of the correction of the camera's delay that is withheld on a rough sea. */
static const double WITHHELD_DELAY = 0.85;
/* Fraction of the reduction of the covariance's root that is withheld: on waves the errors of ten sightings in a row are alike. */
static const double WITHHELD_DELAY_COV = 0.975;
/* Heave rate of the deck, m/s, separating a rough sea from a calm one: far below it, no part of the correction is withheld. */
static const double ROUGH_M_S = 0.1;
/* Variance of the rate of what a sighting measures, (m/s)^2, above which the camera's delay is not corrected. */
static const double RATE_KNOWN_VAR = 0.35 * 0.35;
/* Sigma of the pad's place, m, above which a sighting begins the count of those that agreed. */
static const double LOST_SIGMA_M = 0.3;
/* Longest time between two sightings that counts for a heading, s. */
static const double COUNTED_S = 0.5;
/* Turn beyond the believed one in one sighting that swings a pad aside, rad; a ship that turns as ships do is followed. */
static const double SWUNG_RAD = 0.012;
/* Change of the pad's speed across the ship's way by which a manoeuvre swings it; braking changes that along it. */
static const double ASIDE_M_S = 0.5;
static const double ASIDE_S = 0.5; /* Age of the manoeuvre up to which it does, s. */
static const double OUTVOTED_S = 0.5; /* Age of the newest picture up to which a baseline that contradicts the belief is outvoted, s. */
/* Time for which baselines alone have to agree with one another, s: a wrong solution lasts for seconds. */
static const double FOLLOWED_S = 3.0;
/* Variance of a baseline up to which it is as good as sight, m^2. */
static const double SURE_VAR = 0.1 * 0.1;

/* A sighting compared with a belief, and the correction that it would make. */
typedef struct {
    sighting_rows seen;
    int ok;
    double S[SEEN_MAX * SEEN_MAX], dx[DL_N], P[DL_N * DL_N], nis;
} comparison;

/* The covariance of the rate of the measured position, (3, 3). */
static void rate_covariance(const double *by_rate, const double *P, double cov[9])
{
    for (int i = 0; i < 3; i++) {
        double row[DL_N] = {0.0};
        for (int k = 0; k < DL_N; k++) {
            const double by = AT(by_rate, i, k);
            if (by != 0.0) {
                for (int j = 0; j < DL_N; j++) {
                    row[j] += by * AT(P, k, j);
                }
            }
        }
        for (int j = 0; j < 3; j++) {
            cov[3 * i + j] = 0.0;
            for (int k = 0; k < DL_N; k++) {
                cov[3 * i + j] += row[k] * AT(by_rate, j, k);
            }
        }
    }
}

static void compare(const dl_filter_params *o, const dl_belief *b, const double *P, const dl_sighting *s, int place_only, comparison *out)
{
    const double yaw_sigma = b->heading_known ? sqrt(AT(P, DL_PAD_YAW, DL_PAD_YAW)) : INFINITY;
    sighting_rows *seen = &out->seen;
    double cov_rate[9];
    if (s->by_baseline) {
        baseline_model(o, b, P, s, seen);
    } else {
        sighting_model(b, s, b->cov_levelled_by, yaw_sigma, place_only, seen);
    }
    const int m = seen->m;
    /* The part of an innovation that is due to the delay grows with the rate of the measured position. While that rate is poorly
     * known, the delay is not corrected and its effect counts as noise. */
    rate_covariance(seen->by_rate, P, cov_rate);
    if (cov_rate[0] + cov_rate[4] + cov_rate[8] > RATE_KNOWN_VAR) {
        const double var = AT(P, DL_CAMERA_DELAY, DL_CAMERA_DELAY);
        for (int i = 0; i < m; i++) {
            for (int j = 0; j < m; j++) {
                const double doubt = i < 3 && j < 3 ? cov_rate[3 * i + j] : 0.0;
                seen->R[i * m + j] += var * (AT(seen->H, i, DL_CAMERA_DELAY) * AT(seen->H, j, DL_CAMERA_DELAY) + doubt);
            }
        }
        for (int i = 0; i < m; i++) {
            AT(seen->H, i, DL_CAMERA_DELAY) = 0.0;
        }
    }
    out->ok = kalman_correct(DL_N, P, &(measured){m, seen->innov, seen->H, seen->R}, out->dx, out->P, out->S, &out->nis);
}

/* Compare again with a wider belief if the last sightings missed the deck by more than the filter claims. */
static comparison *compare_jolted(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_sighting *s, comparison *first,
                                  comparison *second)
{
    double back[9], innov_ned[3], cov[9], half[9], cov_ned[9], missing[3];
    steering shown;
    camera_to_ned(b, back);
    rotated(back, first->seen.innov, innov_ned);
    for (int i = 0; i < 9; i++) {
        cov[i] = first->S[i / 3 * first->seen.m + i % 3];
    }
    product(back, cov, half);
    product_by_transposed(half, back, cov_ned);
    jolt_steering(first->seen.m, first->seen.innov, first->S, first->seen.H, b, &shown);
    jolt_extend(&b->excesses, b->t, innov_ned, cov_ned, shown.deviate);
    const int missed = jolt_missing(&b->excesses, missing), manoeuvres = jolt_steered(&b->excesses, b->t, &shown);
    if (!missed && !manoeuvres) {
        return first;
    }
    const double *before = c->P;
    double *P = changeable(c);
    if (missed) {
        const int horizontally = shown.var[0] > 0.0 || shown.var[1] > 0.0;
        missing[0] = horizontally ? 0.0 : missing[0];
        missing[1] = horizontally ? 0.0 : missing[1];
        jolt_widen(missing, P);
    }
    jolt_steer(&shown, P);
    compare(o, b, c->P, s, 0, second);
    if (!second->ok) {
        c->P = before;
        return first;
    }
    b->excesses.n = manoeuvres ? b->excesses.n : 0;
    if (manoeuvres) {
        jolt_note_manoeuvre(b);
    }
    b->swung = shown.var[2] > SWUNG_RAD * SWUNG_RAD ? b->t : b->swung;
    return second;
}

/* Count the time for which sightings agreed with the heading, minus the time for which they contradicted it. */
static void count_heading_agreement(const dl_filter_params *o, dl_belief *b, int agrees)
{
    const double since = happened(b->heading_seen) ? fmin(seconds(b->heading_seen, b->t), COUNTED_S) : 0.0;
    b->heading_held_s = fmin(b->heading_held_s + (agrees ? since : -since), o->heading_memory_s);
    b->heading_seen = b->t;
}

/* Withhold a part of a correction for the camera's mounting and delay, with as much of its gain in certainty as is honest.
 *
 * A deck's sway and heave belong to one wave, but the model takes them as independent. From their correlation over a few waves it
 * would learn a camera tilt or a delay that does not exist. With the covariance's fraction equal to the correction's it is that of
 * the smaller correction if the innovations are white. On waves they are alike for many sightings in a row, and a greater fraction
 * counts them as fewer.
 * Source: Brink, Partial-update Schmidt-Kalman filter, J. Guidance, Control, and Dynamics 40(9), 2017. */
static void withhold(const dl_belief *b, const double *before, double dx[DL_N], double *P)
{
    const double heave = b->wave_sigma[2] * b->wave_w[2], rough = heave * heave / (heave * heave + ROUGH_M_S * ROUGH_M_S);
    const int states[4] = {DL_CAMERA_DELAY, DL_CAMERA_MOUNT, DL_CAMERA_MOUNT + 1, DL_CAMERA_MOUNT + 2};
    double fraction[4] = {WITHHELD_DELAY_COV * rough};
    dx[DL_CAMERA_DELAY] *= 1.0 - WITHHELD_DELAY * rough;
    for (int i = 1; i < 4; i++) {
        fraction[i] = WITHHELD_MOUNT * rough;
        dx[states[i]] *= 1.0 - fraction[i];
    }
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) {
            const double gained = AT(before, states[i], states[j]) - AT(P, states[i], states[j]);
            AT(P, states[i], states[j]) += fraction[i] * gained * fraction[j];
        }
    }
}

static void reject(dl_belief *b, const comparison *row, int by_baseline)
{
    double back[9], offset[3];
    if (b->rejections.by_baseline != by_baseline) {
        streak_end(b);
        b->rejections.by_baseline = by_baseline;
    }
    camera_to_ned(b, back);
    rotated(back, row->seen.innov, offset);
    streak_extend(b, b->t, offset, (row->seen.R[0] + row->seen.R[row->seen.m + 1] + row->seen.R[2 * row->seen.m + 2]) / 3.0);
}

/* Whether a baseline is more alike to those that were just rejected than to the belief, which meanwhile knows too little to reject it. */
static int is_as_rejected(const dl_belief *b, const dl_sighting *s, const comparison *row)
{
    double back[9], offset[3], apart[3];
    if (!s->by_baseline || !b->rejections.by_baseline || b->rejections.n == 0) {
        return 0;
    }
    camera_to_ned(b, back);
    rotated(back, row->seen.innov, offset);
    for (int i = 0; i < 3; i++) {
        apart[i] = offset[i] - b->rejections.offset_ned[i];
    }
    return dot(apart, apart) < dot(offset, offset);
}

static int is_sure(const dl_sighting *s)
{
    return fmax(s->cov[0], fmax(s->cov[5], s->cov[10])) <= SURE_VAR;
}

/* Fuse a baseline: more of them do not know the place better than the wander that all share. One that is not sure is no sight. */
static void fuse_baseline(dl_belief *b, covariance *c, comparison *row, int fresh, int sure)
{
    for (int i = 0; i < 3; i++) {
        double *after = &AT(row->P, DL_POS_REL + i, DL_POS_REL + i);
        *after = fmax(*after, fmin(AT(c->P, DL_POS_REL + i, DL_POS_REL + i), WANDER_VAR[i]));
    }
    correct_belief(b, c, row->dx, memcpy(free_place(c), row->P, sizeof row->P));
    b->baselined = b->t;
    if (sure) {
        b->sighted = b->t;
        b->agreed = fresh ? 1 : b->agreed + 1;
    }
    if (b->rejections.by_baseline) {
        streak_end(b);
    }
}

static void fuse(dl_belief *b, covariance *c, comparison *row, int fresh, int shows_heading)
{
    const double var = AT(c->P, DL_POS_REL, DL_POS_REL) + AT(c->P, DL_POS_REL + 1, DL_POS_REL + 1) + AT(c->P, DL_POS_REL + 2, DL_POS_REL + 2);
    const int lost = sqrt(fmax(var / 3.0, 0.0)) > LOST_SIGMA_M;
    withhold(b, c->P, row->dx, row->P);
    correct_belief(b, c, row->dx, memcpy(free_place(c), row->P, sizeof row->P));
    b->sighted = b->pictured = b->t;
    b->agreed = fresh || lost ? 1 : b->agreed + 1;
    streak_end(b);
    b->heading_known |= shows_heading;
}

/* Note a pad that a manoeuvre moves aside, also where too little of it is in view for its heading. */
static void mark_swing(dl_belief *b)
{
    double was[2], change[2];
    if (!happened(b->steered) || seconds(b->steered, b->t) > ASIDE_S) {
        return;
    }
    for (int i = 0; i < 2; i++) {
        was[i] = b->x[DL_VEL + i] - b->ins_v[i] + b->vessel_before[i];
        change[i] = b->x[DL_VESSEL_VEL + i] - was[i];
    }
    const double speed = hypot(was[0], was[1]), across = change[0] * was[1] - change[1] * was[0];
    const double aside = speed > UNDER_WAY_M_S ? fabs(across) / speed : hypot(change[0], change[1]);
    b->swung = aside > ASIDE_M_S ? b->t : b->swung;
}

/* Compare a sighting with the belief: once more with a wider one after a jolt, and by its place alone if its heading contradicts. A
 * heading that is contradicted for as long as it was confirmed is reset. */
static comparison *compared(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_sighting *s, int fresh, comparison rows[2])
{
    comparison *row = &rows[0];
    compare(o, b, c->P, s, 0, row);
    if (row->ok && !fresh && !s->by_baseline) {
        row = compare_jolted(o, b, c, s, row, &rows[1]);
    }
    if (!row->ok || row->seen.m <= 3) {
        return row;
    }
    comparison *other = row == &rows[0] ? &rows[1] : &rows[0];
    const double limit = o->nis_max[row->seen.m - 1];
    if (row->nis <= limit) {
        count_heading_agreement(o, b, 1);
        return row;
    }
    if (!b->heading_known || !(row->nis > limit)) {
        return row;
    }
    compare(o, b, c->P, s, 1, other);
    if (!other->ok || !(other->nis <= o->nis_max[2])) {
        return row;
    }
    count_heading_agreement(o, b, 0);
    if (b->heading_held_s <= 0.0) {
        reset_heading(b, c, s);
        compare(o, b, c->P, s, 0, other);
    }
    return other;
}

static int is_singular(const comparison *row, dl_outcome *out)
{
    if (!row->ok) {
        write_outcome(out, DL_SINGULAR, row->seen.m, 0, row->seen.innov, NULL, NAN, NAN);
    }
    return !row->ok;
}

/* Count a rejection of a sighting, unless it is outvoted. A streak of them resets the belief to it, and it is compared again; else the
 * outcome is written, and 0 returned. */
static int starts_again(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_sighting *s, comparison *row, int outvoted,
                        dl_outcome *out)
{
    if (!outvoted) {
        reject(b, row, s->by_baseline);
    }
    const double span = seconds(b->rejections.since, b->rejections.last);
    if (outvoted || (s->by_baseline && !(is_sure(s) && span >= FOLLOWED_S)) || !streak_resets(o, b)) {
        write_outcome(out, DL_GATED, row->seen.m, 0, row->seen.innov, row->S, row->nis, o->nis_max[row->seen.m - 1]);
        return 0;
    }
    initialise_pad(o, b, c, s, !s->by_baseline);
    b->nis_mean = 1.0;
    compare(o, b, c->P, s, 0, row);
    return !is_singular(row, out);
}

/* Whether a baseline contradicts the belief in vain: a picture was fused so lately. */
static int is_outvoted(const dl_belief *b, const dl_sighting *s)
{
    return s->by_baseline && happened(b->pictured) && seconds(b->pictured, b->t) < OUTVOTED_S;
}

/* Whether a belief about the pad may begin by a sighting: a baseline has to be sure, and alone. */
static int may_begin(const dl_sighting *s, int sure)
{
    return !s->by_baseline || (s->alone && sure);
}

void fuse_sighting(const dl_filter_params *o, dl_belief *b, covariance *c, sea_ref *bank, const dl_sighting *s, dl_outcome *out)
{
    comparison rows[2], *row;
    const int fresh = !happened(b->sighted), sure = !s->by_baseline || is_sure(s), outvoted = is_outvoted(b, s);
    if (fresh && !may_begin(s, sure)) {
        uncompared(out, DL_GATED);
        return;
    }
    if (fresh) {
        initialise_pad(o, b, c, s, 0);
    }
    row = compared(o, b, c, s, fresh, rows);
    if (is_singular(row, out)) {
        return;
    }
    const int dof = row->seen.m;
    if (!fresh && !outvoted) {
        b->nis_mean = nis_mean_of(b->nis_mean, row->seen.innov, row->S, dof);
    }
    const int refused = row->nis > o->nis_max[dof - 1] || is_as_rejected(b, s, row);
    if (refused && !starts_again(o, b, c, s, row, outvoted, out)) {
        return;
    }
    if (s->by_baseline) {
        fuse_baseline(b, c, row, fresh, sure);
    } else {
        fuse(b, c, row, fresh, dof >= 4 && !s->yaw_ambiguous);
        mark_swing(b);
    }
    if (sure) {
        learn_from_sighting(o, b, bank, s, &row->seen);
    }
    write_outcome(out, DL_FUSED, row->seen.m, 0, row->seen.innov, row->S, row->nis, o->nis_max[row->seen.m - 1]);
}
