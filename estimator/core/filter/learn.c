/* Let the bank of wave oscillators learn from what a sighting or a motion sensor measures. */

#include "filter/learn.h"

#include <math.h>
#include <string.h>

#include "filter/reset.h"
#include "base/rotation.h"

/* Roll and pitch of a pad that was seen whole, and their variances. */
static void measure_tilt(const dl_sighting *s, const double R_ned_level[9], const double *R, double y[DL_DIRECTIONS], double var[DL_DIRECTIONS])
{
    double pad[9], into_pad[9];
    product(R_ned_level, s->pose_R, pad);
    y[3] = atan2(pad[7], pad[8]);
    y[4] = asin(fmax(-1.0, fmin(1.0, -pad[6])));
    product_of_transposed(pad, R_ned_level, into_pad);
    for (int k = 0; k < 2; k++) {
        var[3 + k] = 0.0;
        for (int i = 0; i < 3; i++) {
            for (int j = 0; j < 3; j++) {
                var[3 + k] += into_pad[3 * k + i] * R[(3 + i) * SEEN_MAX + 3 + j] * into_pad[3 * k + j];
            }
        }
    }
}

void learn_waves(const dl_filter_params *o, dl_belief *b, sea_ref *bank, const bank_look *look)
{
    bank_observe(o, b->t, look, bank->now, bank->place);
    bank->now = bank->place;
    memcpy(b->wave_w, bank->now->w_rad_s, sizeof b->wave_w);
    memcpy(b->wave_zeta, bank->now->zeta, sizeof b->wave_zeta);
    memcpy(b->wave_sigma, bank->now->sigma, sizeof b->wave_sigma);
}

void learn_from_sighting(const dl_filter_params *o, dl_belief *b, sea_ref *bank, const dl_sighting *s, const sighting_rows *seen)
{
    double A[9], back[9], late[3], place[3];
    bank_look look = {0};
    double *const y = look.y, *const var = look.var;
    if (happened(bank->now->sighted) && seconds(bank->now->sighted, b->t) < 0.9 * BANK_PERIOD_S) {
        return;
    }
    levelling(b, A);
    camera_to_ned(b, back);
    for (int i = 0; i < 3; i++) {
        late[i] = AT(seen->H, i, DL_CAMERA_DELAY) * b->x[DL_CAMERA_DELAY];
    }
    const double away = place_of(o, b, s, late, place);
    for (int k = 0; k < DL_DIRECTIONS; k++) {
        var[k] = k < 3 ? 0.0 : 10.0 * UNSEEN_VAR;
    }
    for (int k = 0; k < 3; k++) {
        y[k] = place[k] + b->ins_p[k];
        for (int i = 0; i < 3; i++) {
            for (int j = 0; j < 3; j++) {
                var[k] += back[3 * k + i] * seen->R[i * seen->m + j] * back[3 * k + j];
            }
        }
    }
    if (seen->m == SEEN_MAX) {
        double R_ned_level[9];
        product_by_transposed(back, A, R_ned_level);
        measure_tilt(s, R_ned_level, seen->R, y, var);
    }
    look.ins_var = b->ins_var_m2_s2;
    look.reach_m = sqrt(away);
    learn_waves(o, b, bank, &look);
    b->ins_var_m2_s2 = 0.0;
}
