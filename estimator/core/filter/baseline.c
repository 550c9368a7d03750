/* Compare a baseline with the belief: innovation, Jacobian and noise of the vector between the antennas. */

#include "filter/baseline.h"

#include <math.h>
#include <string.h>

#include "base/rotation.h"
#include "filter/correction.h"

/* Shortest time between two baselines that counts: receivers give twenty a second at most. */
static const double LEAST_S = 0.05;
/* Age of a picture up to which baselines may not lead a belief that knows the place better than they, s. */
static const double PICTURE_S = 0.5;
/* How much less they count then: a hundred, ten seconds', are one where place and common wander are alike. */
static const double ALIKE = 100.0;
static const double ALIKE_MOST = 200.0; /* The most of that: the fewer count, the better the place is known. */

/* The antennas from the body's origin and from the pad's centre, in ned. */
static void arms(const dl_filter_params *o, const dl_belief *b, const dl_sighting *s, double drone[3], double ship[3])
{
    const double *x = b->x;
    double turn[9], pad[9], by_pad[3];
    about_down(-o->pad_yaw_in_vessel_rad, turn);
    rotated(turn, s->antenna_vessel, by_pad);
    from_rpy(x[ROLL] + x[DL_DECK_TRIM], x[PITCH] + x[DL_DECK_TRIM + 1], x[DL_PAD_YAW], pad);
    rotated(pad, by_pad, ship);
    rotated(b->R, s->antenna_body, drone);
}

/* Rates of the waves' displacement: the state holds the deck later than the belief's instant by the camera's delay. */
static void rates_of(const dl_belief *b, double rates[3])
{
    rates[0] = b->x[SURGING];
    rates[1] = b->x[SWAYING];
    rates[2] = b->x[HEAVING];
}

void baseline_place(const dl_filter_params *o, const dl_belief *b, const dl_sighting *s, double place[3])
{
    double drone[3], ship[3], rates[3];
    arms(o, b, s, drone, ship);
    rates_of(b, rates);
    for (int i = 0; i < 3; i++) {
        place[i] = s->d_level[i] + drone[i] - ship[i] + b->x[DL_CAMERA_DELAY] * rates[i];
    }
}

/* The rows of the Jacobian in ned. */
static void by_state(const dl_belief *b, const dl_sighting *s, const double ship[3], double *H)
{
    double by_roll[3], by_pitch[3], along[3], arm[9], by_attitude[9];
    const double by_yaw[3] = {0.0, 0.0, 1.0};
    memset(H, 0, 3 * DL_N * sizeof *H);
    pad_axes(b->x[PITCH] + b->x[DL_DECK_TRIM + 1], b->x[DL_PAD_YAW], by_roll, by_pitch);
    const double *const axes[3] = {by_roll, by_pitch, by_yaw};
    const int columns[3][2] = {{ROLL, DL_DECK_TRIM}, {PITCH, DL_DECK_TRIM + 1}, {DL_PAD_YAW, DL_PAD_YAW}};
    for (int k = 0; k < 2 + (b->heading_known != 0); k++) {
        cross(axes[k], ship, along);
        for (int i = 0; i < 3; i++) {
            AT(H, i, columns[k][0]) = AT(H, i, columns[k][1]) = along[i];
        }
    }
    skew(s->antenna_body, arm);
    product(b->R, arm, by_attitude);
    for (int i = 0; i < 3; i++) {
        AT(H, i, DL_POS_REL + i) = 1.0;
        AT(H, i, SURGING + i * (SWAYING - SURGING)) = -b->x[DL_CAMERA_DELAY];
        for (int j = 0; j < 3; j++) {
            AT(H, i, DL_ATT_ERR + j) = by_attitude[3 * i + j];
        }
    }
}

/* The noise in ned: of the solution, of its instant, of the camera's delay, which shifts the deck, and of a heading that is not known. */
static void noise_of(const dl_belief *b, const double *P, const dl_sighting *s, const double ship[3], double R[9])
{
    double rates[3], v[3];
    const double since = happened(b->baselined) ? fmax(seconds(b->baselined, b->t), LEAST_S) : INFINITY;
    const int seen = happened(b->pictured) && seconds(b->pictured, b->t) < PICTURE_S;
    const double alike = fmax(1.0, s->alike_s / since), late_var = AT(P, DL_CAMERA_DELAY, DL_CAMERA_DELAY);
    rates_of(b, rates);
    pad_velocity(b->x, v);
    for (int i = 0; i < 3; i++) {
        v[i] -= b->x[DL_VEL + i];
    }
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            R[3 * i + j] = alike * s->cov[4 * i + j] + s->sigma_s * s->sigma_s * v[i] * v[j] + late_var * rates[i] * rates[j];
        }
        if (seen) {
            const double known = AT(P, DL_POS_REL + i, DL_POS_REL + i);
            R[4 * i] += WANDER_VAR[i] * fmin(ALIKE * WANDER_VAR[i] / known, ALIKE_MOST);
        }
        if (i < 2 && !b->heading_known) {
            R[4 * i] += ship[0] * ship[0] + ship[1] * ship[1];
        }
    }
}

void baseline_model(const dl_filter_params *o, const dl_belief *b, const double *P, const dl_sighting *s, sighting_rows *out)
{
    double drone[3], ship[3], place[3], back[9], gap[3], H[3 * DL_N], R[9], half[9], turned[9];
    arms(o, b, s, drone, ship);
    baseline_place(o, b, s, place);
    camera_to_ned(b, back);
    for (int i = 0; i < 3; i++) {
        gap[i] = place[i] - b->x[DL_POS_REL + i];
    }
    rotated_back(back, gap, out->innov);
    by_state(b, s, ship, H);
    memset(out->by_rate, 0, sizeof out->by_rate);
    memset(out->H, 0, 3 * DL_N * sizeof *out->H);
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            for (int k = 0; k < DL_N; k++) {
                AT(out->H, i, k) += back[3 * j + i] * AT(H, j, k);
            }
        }
    }
    noise_of(b, P, s, ship, R);
    product_of_transposed(back, R, half);
    product(half, back, turned);
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            out->R[3 * i + j] = 0.5 * (turned[3 * i + j] + turned[3 * j + i]);
        }
    }
    out->m = 3;
}
