/* Initialise what is known of the pad from a sighting, or reset it to one. */

#include "filter/reset.h"

#include <math.h>
#include <string.h>

#include "filter/bank.h"
#include "filter/baseline.h"
#include "filter/correction.h"
#include "filter/gate.h"
#include "filter/oscillator.h"
#include "filter/sighting.h"
#include "base/rotation.h"

static const double RESET_VELOCITY_VAR = 4.0; /* Variance of the vessel's velocity when the belief about the pad is reset, (m/s)^2. */
static const double PLACE_VAR = 1e2; /* Variance of a place beside its own square, m^2. */

static double uniform_var(void)
{
    return acos(-1.0) * acos(-1.0) / 3.0;
}

/* The pad's heading by a sighting, with a uniform prior on it. */
static void set_heading(dl_belief *b, double *P, double yaw)
{
    b->x[DL_PAD_YAW] = wrapped(heading_of(b->R) - yaw);
    forget_state(P, DL_PAD_YAW, uniform_var());
}

/* Make the waves of some directions as uncertain as those of a sea of their size, (5,) m or rad. */
static void open_waves(const dl_belief *b, const double *sigma, double *P, int first, int end)
{
    for (int i = WAVE_STATES * first; i < WAVE_STATES * end; i++) {
        forget_state(P, DL_WAVES + i, 0.0);
    }
    for (int k = first; k < end; k++) {
        double at_rest[4][4];
        oscillator_at_rest(b->wave_w[k], b->wave_zeta[k], at_rest);
        for (int i = 0; i < 4; i++) {
            for (int j = 0; j < 4; j++) {
                AT(P, DL_WAVES + 4 * k + i, DL_WAVES + 4 * k + j) = sigma[k] * sigma[k] * at_rest[i][j];
            }
        }
    }
}

/* Forget what another pad's vessel does not share: its velocity, turn and waves. */
static void reset_vessel(const dl_filter_params *o, dl_belief *b, double *P)
{
    for (int i = 0; i < 2; i++) {
        forget_state(P, DL_VESSEL_VEL + i, RESET_VELOCITY_VAR);
    }
    forget_state(P, DL_TURN_RATE, o->sigma_turn_rate_rad_s * o->sigma_turn_rate_rad_s);
    b->x[DL_TURN_RATE] = 0.0;
    b->swung = -1;
    memset(b->x + DL_WAVES, 0, 3 * WAVE_STATES * sizeof *b->x);
    open_waves(b, b->wave_sigma, P, 0, 3);
}

double place_of(const dl_filter_params *o, const dl_belief *b, const dl_sighting *s, const double late[3], double place[3])
{
    double A[9], seen[3], back[9], lever[3];
    if (s->by_baseline) {
        baseline_place(o, b, s, place);
        return dot(place, place);
    }
    levelling(b, A);
    seen_from_body(s, A, seen);
    camera_to_ned(b, back);
    for (int i = 0; i < 3; i++) {
        seen[i] -= late[i];
    }
    rotated(back, seen, place);
    rotated(b->R, b->x + DL_CAMERA_LEVER, lever);
    for (int i = 0; i < 3; i++) {
        place[i] += lever[i];
    }
    return dot(seen, seen);
}

void initialise_pad(const dl_filter_params *o, dl_belief *b, covariance *c, const dl_sighting *s, int reset)
{
    static const double in_time[3] = {0.0};
    double *P = changeable(c);
    const double away = place_of(o, b, s, in_time, b->x + DL_POS_REL);
    for (int i = 0; i < 3; i++) {
        forget_state(P, DL_POS_REL + i, PLACE_VAR + away);
    }
    if (reset) {
        reset_vessel(o, b, P);
    } else if (happened(b->reported)) {
        /* What a motion sensor said before any sighting is where the waves begin, and proves nothing: not even a calm. */
        double sigma[DL_DIRECTIONS];
        for (int k = 0; k < DL_DIRECTIONS; k++) {
            sigma[k] = fmax(b->wave_sigma[k], prior_size(&o->members, k));
        }
        open_waves(b, sigma, P, 2, DL_DIRECTIONS);
    }
    /* A velocity that counted as over the water may have been over a ship that reported hers. */
    for (int k = 0; k < 4 && !happened(b->sighted) && o->velocity_is_over == DL_OVER_EITHER; k++) {
        AT(P, DL_VEL + k / 2, DL_VEL + k % 2) += b->x[DL_VESSEL_VEL + k / 2] * b->x[DL_VESSEL_VEL + k % 2];
    }
    if ((reset || !b->heading_known) && s->has_yaw && !s->yaw_ambiguous) {
        set_heading(b, P, s->yaw_rad);
    }
    streak_end(b);
    b->heading_held_s = 0.0;
}

void reset_heading(dl_belief *b, covariance *c, const dl_sighting *s)
{
    if (!s->has_pose6 && !s->has_yaw) {
        return;
    }
    set_heading(b, changeable(c), s->has_pose6 ? -heading_of(s->pose_R) : s->yaw_rad);
    b->x[DL_YAW_RATE] = b->x[DL_WAVE_YAW] = 0.0;
    b->heading_held_s = 0.0;
}
