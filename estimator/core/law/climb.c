/* From the deck's heave to the vertical speed to command: follow the deck as it will be when the command arrives.
 *
 * The vehicle's vertical speed is predicted through the commands under way, the deck's by the forecast of its rate. The command is
 * the one that brings the first to the second plus the wanted rate against the deck, through the vehicle's own lag:
 *     u = v + lag (a_wanted + k (v_wanted - v) - d)
 * d is what accelerates the body beside its answer to commands (ground effect, draught, an integral in its own loop), by the
 * accelerometer. */

#include <math.h>

#include "law/law.h"

static const double SPEED_GAIN_1_S = 4.0; /* Acceleration for an error of the climb rate, 1/s. */
static const double HEIGHT_GAIN_1_S = 1.5; /* Climb rate for an error of the height, 1/s. */
static const double DISTURBANCE_S = 0.15; /* Time in which d is learned, s. */
/* The most of it as a speed, m/s: a filter whose speed over the ground is wrong by so much finds it in d. */
static const double DISTURBANCE_MAX_M_S = 1.0;

double climb_pushed(const dl_law_params *o, double dt, double d, double a_down, double v, double arrived)
{
    const double beside = a_down - (arrived - v) / o->climb_lag_s;
    return law_limited(d + (1.0 - exp(-dt / DISTURBANCE_S)) * (beside - d), DISTURBANCE_MAX_M_S / o->climb_lag_s);
}

double climb_predicted(const dl_law_params *o, double *v, double d, int64_t n, const double *under_way)
{
    double way = 0.0;
    for (int64_t k = n - 1; k >= 0; k--) {
        const double a = (under_way[k] - *v) / o->climb_lag_s + d;
        way += o->period_s * (*v + 0.5 * o->period_s * a);
        *v += o->period_s * a;
    }
    return way;
}

double climb_command(const dl_law_params *o, const dl_law_cycle *in, double v, double d, const deck_then *deck, double height_error_m)
{
    double wanted = deck->v[2], a = deck->a[2];
    if (in->has_rate) {
        wanted += in->rate_m_s;
    } else {
        const double closing = HEIGHT_GAIN_1_S * height_error_m, limited = law_limited(closing, in->rate_max_m_s);
        a -= limited == closing ? HEIGHT_GAIN_1_S * (v - wanted) : 0.0;
        wanted += limited;
    }
    return v + o->climb_lag_s * (a + SPEED_GAIN_1_S * (wanted - v) - d);
}
