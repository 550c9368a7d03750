/* The deck a short time ahead: its present rate carried on by the forecast's change of rate, or by its acceleration alone; and
 * how fast it turns.
 *
 * The forecast is some cycles old and comes less often than guidance runs, so only what changes in it is used, from its own age
 * on. */

#include <math.h>
#include <string.h>

#include "law/law.h"
#include "base/rotation.h"

/* A forecast older than this is not used, s. */
static const double OLD_S = 0.5;
/* Both poles of the observer of the deck's turn: as slow as a ship begins to turn, and slow enough that the noise of single
 * sightings makes no rate. */
static const double POLE_RAD_S = 0.7;
/* No ship turns faster: 10 degrees a second. */
#define TURN_MOST_RAD_S (10.0 * acos(-1.0) / 180.0)
static const double HEADING_GAIN_1_S = 0.8; /* Rate of turn for an error of the heading, 1/s. */
static const double TURN_COMMAND_MAX_RAD_S = 0.6; /* Largest rate of turn that is commanded, rad/s. */

/* The number of the horizon from which the straight line to the next one holds at t. */
static int64_t span(const dl_law_course *course, double t)
{
    int64_t i = 0;
    while (i < course->n - 2 && course->horizons_s[i + 1] <= t) {
        i++;
    }
    return i;
}

/* The slope of the rates from horizon i to the next one. */
static double slope(const dl_law_course *course, int64_t i, int axis)
{
    return (course->rates_m_s[i + 1][axis] - course->rates_m_s[i][axis]) / (course->horizons_s[i + 1] - course->horizons_s[i]);
}

void deck_ahead_of(const dl_law_cycle *in, const dl_law_course *course, double ahead_s, deck_then *out)
{
    memset(out, 0, sizeof *out);
    if (!in->has_deck) {
        return;
    }
    const double age = in->forecast_age_s, until = age + ahead_s;
    const int64_t n = course->n;
    const int forecast = n >= 2 && age >= 0.0 && age <= OLD_S && until <= course->horizons_s[n - 1];
    const int64_t i = forecast ? span(course, age) : 0, k = forecast ? span(course, until) : 0;
    for (int axis = 0; axis < 3; axis++) {
        double change = in->a_deck[axis] * ahead_s;
        out->a[axis] = in->a_deck[axis];
        if (forecast) {
            out->a[axis] = slope(course, k, axis);
            const double now = course->rates_m_s[i][axis] + slope(course, i, axis) * (age - course->horizons_s[i]);
            change = (course->rates_m_s[k][axis] + out->a[axis] * (until - course->horizons_s[k])) - now;
        }
        out->moved[axis] = ahead_s * (in->v_deck[axis] + 0.5 * change);
        out->v[axis] = in->v_deck[axis] + change;
    }
}

/* The same angle in (-pi, pi]. */
static double turned(double angle)
{
    const double about = wrapped(angle);
    return about == -acos(-1.0) ? -about : about;
}

/* The heading against the arrow runs with the body's rate less the deck's. An observer of that course finds the deck's rate: fed
 * forward, it takes away the error with which a nose would follow a ship that turns, and unlike an integral it does not wind up
 * while the nose comes round to the arrow.
 * Source: Luenberger, An introduction to observers, IEEE Trans. Automatic Control 16(6), 1971. */
void turn_observe(const dl_law_cycle *in, const dl_law_memory *before, dl_law_memory *after)
{
    after->has_turn = in->has_yaw != 0;
    after->turn_yaw_rad = in->yaw_rad;
    after->turn_rate_rad_s = 0.0;
    if (!in->has_yaw || !in->goes_on || !before->has_turn) {
        return;
    }
    const double expected = before->turn_yaw_rad + in->dt * (in->w_body[2] - before->turn_rate_rad_s);
    const double off = turned(in->yaw_rad - expected);
    const double rate = before->turn_rate_rad_s - POLE_RAD_S * POLE_RAD_S * in->dt * off;
    after->turn_yaw_rad = turned(expected + 2.0 * POLE_RAD_S * in->dt * off);
    after->turn_rate_rad_s = law_limited(rate, TURN_MOST_RAD_S);
}

double turn_command(const dl_law_cycle *in, const dl_law_memory *memory)
{
    if (!in->has_wanted_yaw || !memory->has_turn) {
        return 0.0;
    }
    const double off = turned(in->wanted_yaw_rad - in->yaw_rad);
    return law_limited(memory->turn_rate_rad_s + HEADING_GAIN_1_S * off, TURN_COMMAND_MAX_RAD_S);
}
