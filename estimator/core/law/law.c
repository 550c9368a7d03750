/* One cycle of the law that follows the deck, down to contact: horizontally a disturbance observer and a regulator over tilt and
 * commands under way, one axis at a time; vertically a predictor with the deck's forecast. Everything horizontal is kept in axes
 * that do not turn with the nose (docs/guidance.md). */

#include "law/law.h"

#include <math.h>
#include <string.h>

#include "base/rotation.h"

/* Lean beside the trim that the view never takes away, m/s^2: without any, the wind would carry the drone off. */
static const double LEAN_LEAST_M_S2 = 0.6;
/* A pad so far outside the field of a level camera is not kept in view but flown to, rad. */
static const double OUT_RAD = 0.1;
/* Below this height the pad leaves the picture anyway, and the tilt is left alone. */
static const double VIEW_FROM_M = 0.6;
/* An estimate that leaps is another one, as when the pad is found again after a while. The observer would come after it for seconds
 * and fly there; corrections of a pad in view stay below half of this. */
static const double LEAP_M = 0.5;
/* A speed that leaps is that of a ship that brakes or turns, which nothing announces. What pushes the drone, its accelerometer feels. */
static const double LEAP_M_S = 0.12;
/* The tangent of a larger angle is never needed. */
static const double ANGLE_MOST_RAD = 1.2;

/* The heading of `level`: between it and the axes of the memory. */
typedef struct {
    double c, s;
} nose;

static void to_ned(nose n, const double level[2], double ned[2])
{
    ned[0] = n.c * level[0] - n.s * level[1];
    ned[1] = n.s * level[0] + n.c * level[1];
}

static void to_level(nose n, const double ned[2], double level[2])
{
    level[0] = n.c * ned[0] + n.s * ned[1];
    level[1] = n.c * ned[1] - n.s * ned[0];
}

/* What is measured on both axes. */
static void measure(nose n, const dl_law_cycle *in, const deck_then *here, dl_axis_measured z[2])
{
    const double turning[2] = {-GRAVITY_M_S2 * in->w_body[1], GRAVITY_M_S2 * in->w_body[0]};
    double p[2], w[2], lean[2], rate[2], a_body[2], a_deck[2];
    to_ned(n, in->d, p), to_ned(n, in->v, w), to_ned(n, in->lean, lean), to_ned(n, turning, rate);
    to_ned(n, in->a_body, a_body), to_ned(n, here->a, a_deck);
    for (int i = 0; i < 2; i++) {
        z[i] = (dl_axis_measured){p[i], w[i], lean[i], rate[i], a_body[i], a_deck[i]};
    }
}

/* Whether the pad is far from where the axes expect it after dt. */
static int leapt(double dt, const dl_law_axis was[2], const dl_axis_measured z[2])
{
    return hypot(z[0].p - was[0].p - dt * was[0].w, z[1].p - was[1].p - dt * was[1].w) > LEAP_M;
}

static void observe_axes(const dl_law_in_use *law, const dl_law_cycle *in, int64_t periods, const dl_axis_measured z[2],
                         const dl_law_memory *before, dl_law_axis after[2])
{
    const int anew = leapt(in->dt, before->axes, z);
    const int brakes = hypot(z[0].w - before->axes[0].w, z[1].w - before->axes[1].w) > LEAP_M_S;
    for (int i = 0; i < 2; i++) {
        if (!in->goes_on) {
            axis_begin(law->params.remembered, &z[i], &before->axes[i], &after[i]);
            continue;
        }
        dl_law_axis was = before->axes[i];
        if (anew || brakes) {
            was.p = anew ? z[i].p - in->dt * z[i].w : was.p;
            was.w = z[i].w;
        }
        axis_observe(law, in, periods, &was, &z[i], &after[i]);
    }
}

/* What a vehicle with a velocity loop of its own adds to the tilt. */
static void observe_own(const dl_law_params *o, const dl_law_cycle *in, int64_t periods, const dl_law_axis axes[2], const dl_law_own before[2],
                        dl_law_own after[2])
{
    for (int i = 0; i < 2 && o->over_ground; i++) {
        if (!in->goes_on) {
            after[i] = (dl_law_own){axes[i].lean, axes[i].lean, 0.0};
        } else if (in->steers) {
            own_flown(o, in->dt, periods, &axes[i], &before[i], &after[i]);
        } else {
            own_hovered(in->dt, axes[i].lean, &before[i], &after[i]);
        }
    }
}

/* The tilt that one set of gains commands north and east, m/s^2, not limited yet. */
static void regulate(const dl_law_axis axes[2], const dl_law_gains *gains, const double far_m[2], double speed_max_m_s,
                     const double a_deck[2], const double a_deck_then[2], double u[2])
{
    /* A place far off calls for no more than the allowed speed. */
    const double size = hypot(far_m[0], far_m[1]), reach = speed_max_m_s * gains->w / gains->p;
    const double shrink = fmin(1.0, reach / size);
    for (int i = 0; i < 2; i++) {
        u[i] = axis_tilt(&axes[i], gains, shrink * far_m[i], a_deck[i], a_deck_then[i]);
    }
}

static double within_view(double lean, double trim, double bearing_rad, double half_rad)
{
    if (fabs(bearing_rad) > half_rad + OUT_RAD) {
        return lean;
    }
    const double most = GRAVITY_M_S2 * tan(fmax(0.0, fmin(ANGLE_MOST_RAD, half_rad - bearing_rad)));
    const double least = -GRAVITY_M_S2 * tan(fmax(0.0, fmin(ANGLE_MOST_RAD, half_rad + bearing_rad)));
    return fmin(fmax(most, trim + LEAN_LEAST_M_S2), fmax(fmin(least, trim - LEAN_LEAST_M_S2), lean));
}

/* Cut the tilt so that the pad's centre stays in the picture. Leaning forward turns the camera astern, so the pad moves towards
 * the picture's forward edge by as much. */
static void keep_in_view(const dl_law_params *o, const double d[3], const double trim[2], double lean[2])
{
    if (!o->keeps_in_view || d[2] < VIEW_FROM_M) {
        return;
    }
    lean[0] = within_view(lean[0], trim[0], atan2(d[0] - o->view_forward_m, d[2]), o->half_forward_rad);
    lean[1] = within_view(lean[1], trim[1], atan2(d[1] - o->view_right_m, d[2]), o->half_right_rad);
}

/* Cut the tilt to the vehicle's limit. The trim that holds against the wind comes first: a cut of both alike would let the drone be
 * blown off while it corrects aside. */
static void shorten(const dl_law_params *o, const dl_law_cycle *in, const double trim[2], double lean[2])
{
    const double asked = in->has_lean_max ? GRAVITY_M_S2 * tan(in->lean_max_rad) : INFINITY;
    const double most = fmin(o->tilt_max_m_s2, asked), held = hypot(trim[0], trim[1]);
    const double keep = fmin(1.0, most / held);
    const double base[2] = {keep * trim[0], keep * trim[1]}, more[2] = {lean[0] - base[0], lean[1] - base[1]};
    const double a = more[0] * more[0] + more[1] * more[1], b = base[0] * more[0] + base[1] * more[1];
    const double c = fmax(0.0, most * most - base[0] * base[0] - base[1] * base[1]);
    if (hypot(lean[0], lean[1]) <= most) {
        return;
    }
    const double share = a > 0.0 ? fmin(1.0, fmax(0.0, (sqrt(b * b + a * c) - b) / a)) : 0.0;
    lean[0] = base[0] + share * more[0], lean[1] = base[1] + share * more[1];
}

/* The tilt to command, m/s^2 forward and right, and the part of it that is trim; the deck now and when the command acts. */
static void lean_to(const dl_law_in_use *law, const dl_law_cycle *in, nose n, const dl_law_axis axes[2], const deck_then *here,
                    const deck_then *then, double lean[2], double trim[2])
{
    double now[2], later[2], offset[2], u[2], earlier[2];
    to_ned(n, here->a, now), to_ned(n, then->a, later), to_ned(n, in->wanted, offset);
    const double far[2] = {axes[0].p - offset[0], axes[1].p - offset[1]};
    regulate(axes, &law->gains, far, in->speed_max_m_s, now, later, u);
    regulate(axes, &law->gains_before, far, in->speed_max_m_s, now, later, earlier);
    for (int i = 0; i < 2; i++) {
        u[i] = law_between(in, u[i], earlier[i]);
    }
    const double kept[2] = {axis_reference(&axes[0], 0.0), axis_reference(&axes[1], 0.0)};
    to_level(n, kept, trim);
    to_level(n, u, lean);
    keep_in_view(&law->params, in->d, trim, lean);
    shorten(&law->params, in, trim, lean);
}

/* Change the tilt in dt no faster than the vehicle's own limit of the jerk allows: what it would not follow is not under way. */
static void within_jerk(const dl_law_params *o, double dt, const dl_law_memory *memory, double ned[2])
{
    const double was[2] = {memory->axes[0].under_way[0], memory->axes[1].under_way[0]};
    const double step = hypot(ned[0] - was[0], ned[1] - was[1]), most = o->jerk_max_m_s3 * dt;
    for (int i = 0; i < 2 && o->jerk_max_m_s3 > 0.0 && step > most; i++) {
        ned[i] = was[i] + most / step * (ned[i] - was[i]);
    }
}

/* The vertical speed to command by one set of gains, m/s down. */
static double climb_by(const dl_law_params *o, const dl_law_gains *gains, const dl_law_cycle *in, const dl_law_course *course,
                       const dl_law_memory *memory, double v_down)
{
    double v = v_down;
    deck_then then;
    const double d = memory->pushed_down_m_s2, way = climb_predicted(o, &v, d, gains->climb_delay, memory->climbs);
    deck_ahead_of(in, course, (double)gains->climb_delay * o->period_s, &then);
    const double height = in->d[2] + then.moved[2] - way;
    return law_limited(climb_command(o, in, v, d, &then, height - in->wanted[2]), o->climb_max_m_s);
}

/* A period, in which the vehicle comes towards the tilt that was commanded last by the jerk of so many seconds. */
static void note(const dl_law_params *o, double jerk_s, double down, dl_law_memory *memory)
{
    double ned[2] = {memory->commanded[0], memory->commanded[1]};
    within_jerk(o, jerk_s, memory, ned);
    under_way_note(o->remembered, ned[0], memory->axes[0].under_way);
    under_way_note(o->remembered, ned[1], memory->axes[1].under_way);
    under_way_note(o->remembered, down, memory->climbs);
}

/* Let the commands act for as long as the cycle took; return the number of periods in it. The one noted as it began is the first's. */
static int64_t held(const dl_law_params *o, const dl_law_cycle *in, dl_law_memory *memory)
{
    const double periods = memory->periods_left + in->dt / o->period_s, whole = fmin(fmax(floor(periods + 0.5), 1.0), DL_UNDER_WAY_MAX);
    memory->periods_left = fmin(fmax(periods - whole, -0.5), 0.5);
    for (int64_t k = 1; k < (int64_t)whole; k++) {
        note(o, o->period_s, memory->climbs[0], memory);
    }
    return (int64_t)whole;
}

bool dl_law_step(const dl_law_in_use *law, const dl_law_cycle *in, const dl_law_course *course, const dl_law_memory *before, dl_law_memory *after,
                 dl_law_command *out)
{
    const dl_law_params *o = &law->params;
    const dl_law_gains *gains = &law->gains, *gains_before = &law->gains_before;
    const nose n = {cos(in->heading_rad), sin(in->heading_rad)};
    deck_then here, then;
    dl_axis_measured z[2];
    if (!law_fits(law) || course->n < 0 || course->n > DL_HORIZONS_MAX) {
        return 0;
    }
    dl_law_memory was = *before;
    const int64_t periods = in->goes_on ? held(o, in, &was) : 1;
    *after = was;
    deck_ahead_of(in, course, 0.0, &here);
    measure(n, in, &here, z);
    observe_axes(law, in, periods, z, &was, after->axes);
    const double v_down = (in->has_deck ? in->v_deck[2] : 0.0) - in->v[2];
    const double arrived = law_between(in, was.climbs[gains->climb_delay - 1], was.climbs[gains_before->climb_delay - 1]);
    after->pushed_down_m_s2 = climb_pushed(o, in->goes_on ? in->dt : o->period_s, was.pushed_down_m_s2, in->a_body[2], v_down, arrived);
    observe_own(o, in, periods, after->axes, was.own, after->own);
    turn_observe(in, &was, after);
    if (!in->steers) {
        after->commanded[0] = after->axes[0].lean, after->commanded[1] = after->axes[1].lean;
        note(o, INFINITY, v_down, after);
        return 1;
    }
    double soon = law_between(in, gains->slowness_s, gains_before->slowness_s), lean[2];
    deck_ahead_of(in, course, soon, &then);
    lean_to(law, in, n, after->axes, &here, &then, lean, out->trim);
    const double later = climb_by(o, gains, in, course, after, v_down);
    const double earlier = climb_by(o, gains_before, in, course, after, v_down);
    out->v[2] = law_between(in, later, earlier);
    to_ned(n, lean, after->commanded);
    within_jerk(o, in->goes_on ? fmax(in->dt, o->period_s) : o->period_s, after, after->commanded);
    to_level(n, after->commanded, lean);
    note(o, o->period_s, out->v[2], after);
    if (o->over_ground) {
        /* A velocity loop of its own gets its own velocity, so that only its integral adds to the acceleration. */
        const double own[2] = {after->own[0].own, after->own[1].own};
        soon = 0.0;
        to_level(n, own, out->trim);
    }
    for (int i = 0; i < 2; i++) {
        out->a[i] = lean[i] - out->trim[i];
        out->v[i] = in->has_deck ? in->v_deck[i] + soon * out->a[i] - in->v[i] : 0.0;
    }
    out->yaw_rate_rad_s = turn_command(in, after);
    return 1;
}
