/* One horizontal axis of the law: observer, commands under way, and the tilt to command.
 *
 * The observer, the regulator and their sources: companion/guidance/law/gains.py. */

#include <math.h>
#include <string.h>

#include "law/law.h"

/* The most that the air pushes, and that a vehicle leans by itself against it: more than any tilt that is flown answers. */
static const double PUSH_MAX_M_S2 = 10.0;
/* Weight of the gyro against the model in the rate of the tilt. */
static const double GYRO_SHARE = 0.25;
/* Time constants of the mean of the vehicle's own part: while the law steers, and while all of the tilt is its own. */
static const double OWN_FLOWN_S = 0.7, OWN_HOVERED_S = 2.0;

double law_limited(double value, double most)
{
    return value < -most ? -most : value > most ? most : value;
}

double law_between(const dl_law_cycle *in, double later, double earlier)
{
    return in->share == 1.0 ? later : in->share * later + (1.0 - in->share) * earlier;
}

void axis_begin(int64_t remembered, const dl_axis_measured *z, const dl_law_axis *before, dl_law_axis *after)
{
    memset(after, 0, sizeof *after);
    after->p = z->p, after->w = z->w, after->d = before->d, after->b = before->b;
    after->lean = after->lag = z->lean;
    for (int64_t k = 0; k < remembered; k++) {
        after->under_way[k] = z->lean;
    }
}

void under_way_note(int64_t remembered, double command, double *under_way)
{
    memmove(under_way + 1, under_way, (size_t)(remembered - 1) * sizeof *under_way);
    under_way[0] = command;
}

/* p, w, d and b of the observer after dt: its rows hold the gains of p, w, d and b, its columns those by place, speed and
 * acceleration. */
static void observe(const dl_law_observer *observer, double dt, double a_lean, double a_lately, const dl_law_axis *before,
                    const dl_axis_measured *z, dl_law_axis *after)
{
    const double push = z->a_deck - a_lean - before->d;
    const double p = before->p + dt * before->w + 0.5 * dt * dt * push, w = before->w + dt * push;
    const double off[3] = {z->p - p, z->w - w, z->a_body - a_lately - before->d - before->b};
    const double was[4] = {p, w, before->d, before->b};
    double is[4];
    for (int i = 0; i < 4; i++) {
        const double *gains = observer->gains[i];
        is[i] = was[i] + gains[0] * off[0] + gains[1] * off[1] + gains[2] * off[2];
    }
    after->p = is[0], after->w = is[1], after->d = law_limited(is[2], PUSH_MAX_M_S2), after->b = is[3];
}

/* A tilt and its rate after h by the response: rate' = frequency^2 (lag - lean) - 2 damping frequency rate. */
static void tilt_flown(const dl_law_params *o, double h, double lag, double *lean, double *rate)
{
    const double w = o->frequency_rad_s;
    *rate += h * (w * w * (lag - *lean) - 2.0 * o->damping * w * *rate);
    *lean += h * *rate;
}

/* The command that arrived so many periods ago, an acceleration. */
static double arrived(const dl_law_in_use *law, const dl_law_cycle *in, int64_t ago, const double *under_way)
{
    const int64_t now = law->gains.tilt_delay - 1 + ago, earlier = law->gains_before.tilt_delay - 1 + ago, last = law->params.remembered - 1;
    return law_between(in, under_way[now < last ? now : last], under_way[earlier < last ? earlier : last]);
}

void axis_observe(const dl_law_in_use *law, const dl_law_cycle *in, int64_t n, const dl_law_axis *before, const dl_axis_measured *z,
                  dl_law_axis *after)
{
    const dl_law_params *o = &law->params;
    const double h = in->dt / (double)n, keep = exp(-h / o->lag_s);
    double lean = before->lean, rate = before->rate, lag = before->lag, lately = lean, all = 0.5 * (z->lean - lean);
    for (int64_t k = 1; k <= n; k++) {
        lately = lean, all += lean;
        tilt_flown(o, h, lag, &lean, &rate);
        lag = keep * lag + (1.0 - keep) * arrived(law, in, n - k, before->under_way);
    }
    observe(&law->observer, in->dt, all / (double)n, 0.5 * (z->lean + lately), before, z, after);
    after->lag = lag;
    after->rate = rate + GYRO_SHARE * (z->rate - rate);
    after->lean = z->lean;
    memcpy(after->under_way, before->under_way, sizeof after->under_way);
}

double axis_reference(const dl_law_axis *x, double a_deck)
{
    return a_deck - x->d;
}

double axis_tilt(const dl_law_axis *x, const dl_law_gains *gains, double off_m, double a_deck, double a_deck_then)
{
    const double now = axis_reference(x, a_deck);
    double off = gains->p * off_m + gains->w * x->w + gains->a * (x->lean - now) + gains->rate * x->rate;
    off += gains->lag * (x->lag - now);
    for (int64_t k = 0; k < gains->n; k++) {
        off += gains->under_way[k] * (x->under_way[k] - now);
    }
    return axis_reference(x, a_deck_then) - off;
}

static int is_number_of_commands(int64_t n)
{
    return n >= 1 && n <= DL_UNDER_WAY_MAX;
}

static int gains_fit(const dl_law_gains *gains)
{
    return gains->n >= 0 && gains->n <= DL_UNDER_WAY_MAX && is_number_of_commands(gains->tilt_delay) &&
           is_number_of_commands(gains->climb_delay);
}

int law_fits(const dl_law_in_use *law)
{
    return is_number_of_commands(law->params.remembered) && gains_fit(&law->gains) && gains_fit(&law->gains_before);
}

double dl_law_axis_step(const dl_law_in_use *law, double dt, const dl_law_axis *before, const dl_axis_measured *z, dl_law_axis *after)
{
    if (!law_fits(law)) {
        return NAN;
    }
    const dl_law_cycle in = {.dt = dt, .share = 1.0};
    axis_observe(law, &in, 1, before, z, after);
    return axis_tilt(after, &law->gains, after->p, 0.0, 0.0);
}

void own_flown(const dl_law_params *o, double dt, int64_t n, const dl_law_axis *x, const dl_law_own *before, dl_law_own *after)
{
    double explained = before->lean, rate = before->rate;
    for (int64_t k = 0; k < n; k++) {
        tilt_flown(o, dt / (double)n, x->lag, &explained, &rate);
    }
    const double own = before->own + (1.0 - exp(-dt / OWN_FLOWN_S)) * (x->lean - explained);
    after->own = law_limited(own, PUSH_MAX_M_S2), after->lean = explained, after->rate = rate;
}

void own_hovered(double dt, double lean, const dl_law_own *before, dl_law_own *after)
{
    const double own = before->own + (1.0 - exp(-dt / OWN_HOVERED_S)) * (lean - before->own);
    after->own = law_limited(own, PUSH_MAX_M_S2), after->lean = lean, after->rate = 0.0;
}
