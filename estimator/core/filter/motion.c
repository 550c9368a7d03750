/* Fuse what the ship's motion sensor reports of the waves: the pad's displacement downward, and the deck's roll and pitch.
 *
 * Which sensor, its place, delay, noise and mean are settled before (estimator/ship_motion.py). While the pad is in sight the bank
 * learns by sightings alone, so that a sensor cannot confirm itself in it; before and after, the sensor is all that there is. */

#include "filter/motion.h"

#include <string.h>

#include "filter/correction.h"

enum { ROWS = 3, ALONG_DOWN = 2, IN_ROLL = 3 };

static const double REPORTED_S = 3.0; /* Time after the newest report for which the deck's motion is known without a pad, s. */
static const double UNSEEN_S = 2.0; /* Time after the newest sighting that taught the bank from which on it learns by reports, s. */

bool knows_deck(const dl_filter_params *o, const dl_belief *b, int64_t t)
{
    return (happened(b->sighted) && seconds(b->sighted, t) <= o->forget_s)
        || (happened(b->reported) && seconds(b->reported, t) <= REPORTED_S);
}

static void learn(const dl_filter_params *o, dl_belief *b, sea_ref *bank, const dl_motion *report)
{
    bank_look look = {.by_sensor = 1};
    const dl_bank *known = bank->now;
    const bool in_sight = happened(known->sighted) && seconds(known->sighted, b->t) < UNSEEN_S;
    if (in_sight || (happened(known->t) && seconds(known->t, b->t) < 0.9 * BANK_PERIOD_S)) {
        return;
    }
    for (int k = 0; k < DL_DIRECTIONS; k++) {
        look.var[k] = 10.0 * UNSEEN_VAR;
    }
    if (report->has_heave) {
        look.y[ALONG_DOWN] = report->down_m;
        look.var[ALONG_DOWN] = report->sigma_down_m * report->sigma_down_m;
    }
    for (int i = 0; i < 2 && report->has_tilt; i++) {
        look.y[IN_ROLL + i] = report->tilt_rad[i];
        look.var[IN_ROLL + i] = report->sigma_tilt_rad * report->sigma_tilt_rad;
    }
    learn_waves(o, b, bank, &look);
}

void fuse_motion(const dl_filter_params *o, dl_belief *b, covariance *c, sea_ref *bank, const dl_motion *report, dl_outcome *out)
{
    const int states[ROWS] = {ROLL, PITCH, HEAVE}, has[ROWS] = {report->has_tilt, report->has_tilt, report->has_heave};
    const double y[ROWS] = {report->tilt_rad[0], report->tilt_rad[1], report->down_m};
    const double sigma[ROWS] = {report->sigma_tilt_rad, report->sigma_tilt_rad, report->sigma_down_m};
    const int m = 2 * report->has_tilt + report->has_heave, axes = 3 * report->has_tilt | 4 * report->has_heave;
    double innov[ROWS], H[ROWS * DL_N] = {0.0}, R[ROWS * ROWS] = {0.0};
    out->verdict = DL_GATED;
    if (m == 0) {
        return;
    }
    for (int i = 0, row = 0; i < ROWS; i++) {
        if (has[i]) {
            innov[row] = y[i] - b->x[states[i]];
            AT(H, row, states[i]) = 1.0;
            R[row * (m + 1)] = sigma[i] * sigma[i];
            row++;
        }
    }
    learn(o, b, bank, report);
    if (fuse_gated(o, b, c, &(measured){m, innov, H, R}, axes, false, out)) {
        b->reported = b->t;
    }
}
