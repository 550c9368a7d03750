/* The law that follows the deck: cycles of all kinds with any numbers, by one set of gains and between two. */

static void gains_of(dl_law_gains *gains, int64_t remembered)
{
    memset(gains, 0, sizeof *gains);
    gains->n = draw() % (remembered + 1);
    gains->tilt_delay = 1 + draw() % remembered;
    gains->climb_delay = 1 + draw() % remembered;
    double *values = &gains->slowness_s;
    for (int i = 0; i < 6 + DL_UNDER_WAY_MAX; i++) {
        values[i] = uniform();
    }
    poisoned(values, 6 + DL_UNDER_WAY_MAX);
}

static void law_parameters(dl_law_params *o)
{
    memset(o, 0, sizeof *o);
    o->remembered = 1 + draw() % DL_UNDER_WAY_MAX;
    o->over_ground = draw() % 2, o->keeps_in_view = draw() % 2;
    o->period_s = 0.02, o->frequency_rad_s = 9.0, o->damping = 0.7, o->lag_s = draw() % 2 ? 0.08 : 0.0, o->tilt_max_m_s2 = 3.5;
    o->climb_lag_s = 0.3, o->climb_max_m_s = 1.0, o->half_forward_rad = 0.4, o->half_right_rad = 0.6;
    poisoned(&o->period_s, 11);
}

static void cycle_of(dl_law_cycle *in)
{
    memset(in, 0, sizeof *in);
    in->goes_on = draw() % 8 != 0, in->steers = draw() % 4 != 0, in->has_deck = draw() % 4 != 0;
    in->has_yaw = draw() % 4 != 0, in->has_rate = draw() % 2, in->has_wanted_yaw = draw() % 2, in->has_lean_max = draw() % 2;
    double *values = &in->dt;
    const int n = (int)(sizeof *in / sizeof *values) - 7;
    for (int i = 0; i < n; i++) {
        values[i] = uniform();
    }
    in->dt = 0.02, in->share = draw() % 2 ? 1.0 : 0.3, in->forecast_age_s = 0.01 * (draw() % 60);
    poisoned(values, n);
}

/* Up to this many horizons, and now and then more than the law takes. */
static void course_of(dl_law_course *course)
{
    memset(course, 0, sizeof *course);
    course->n = draw() % 12 ? draw() % (DL_HORIZONS_MAX + 1) : DL_HORIZONS_MAX + 1;
    for (int i = 0; i < DL_HORIZONS_MAX; i++) {
        course->horizons_s[i] = i == 0 ? uniform() : course->horizons_s[i - 1] + 0.2;
        for (int k = 0; k < 3; k++) {
            course->rates_m_s[i][k] = uniform();
        }
    }
    poisoned(course->horizons_s, DL_HORIZONS_MAX), poisoned(course->rates_m_s[0], 3 * DL_HORIZONS_MAX);
}

static void law(int rounds, double poison)
{
    dl_law_in_use flown;
    dl_law_memory memory, after;
    dl_law_command command;
    law_parameters(&flown.params);
    gains_of(&flown.gains, flown.params.remembered), gains_of(&flown.gains_before, flown.params.remembered);
    for (int i = 0; i < 12; i++) {
        flown.observer.gains[i / 3][i % 3] = uniform();
    }
    poisoned(flown.observer.gains[0], 12);
    memset(&memory, 0, sizeof memory);
    for (int k = 0; k < rounds; k++) {
        dl_law_cycle in;
        dl_law_course course;
        const int64_t delay = flown.gains.tilt_delay;
        course_of(&course), cycle_of(&in);
        in.v[0] *= poison;
        flown.gains.tilt_delay = draw() % 20 ? delay : DL_UNDER_WAY_MAX + 1;
        if (dl_law_step(&flown, &in, &course, &memory, &after, &command)) {
            memory = after;
            fold(&command.a[0], 8), fold(&memory.pushed_down_m_s2, 3);
        }
        flown.gains.tilt_delay = delay;
    }
    const dl_axis_measured z = {0.1, 0.2, 0.3 * poison, 0.4, 0.5, 0.6};
    dl_law_axis one;
    const double u = dl_law_axis_step(&flown, 0.02, &memory.axes[0], &z, &one);
    fold(&u, 1);
}
