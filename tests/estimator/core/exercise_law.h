/* The law that follows the deck: cycles of all kinds with any numbers, by one set of gains and between two. */

static void gains_of(dl_law_gains *gains, int64_t remembered)
{
    memset(gains, 0, sizeof *gains);
    gains->n = draw() % (remembered + 1);
    gains->tilt_delay = 1 + draw() % remembered;
    gains->climb_delay = 1 + draw() % remembered;
    double *values = &gains->slowness_s;
    for (int i = 0; i < 6 + UNDER_WAY_MAX; i++) {
        values[i] = uniform();
    }
    poisoned(values, 6 + UNDER_WAY_MAX);
}

static void law_parameters(dl_law_params *o)
{
    memset(o, 0, sizeof *o);
    o->remembered = 1 + draw() % UNDER_WAY_MAX;
    o->over_ground = draw() % 2, o->keeps_in_view = draw() % 2, o->looks_ahead = draw() % 4 != 0;
    o->period_s = 0.02, o->frequency_rad_s = 9.0, o->damping = 0.7, o->lag_s = draw() % 2 ? 0.08 : 0.0, o->tilt_max_m_s2 = 3.5;
    o->climb_lag_s = 0.3, o->climb_max_m_s = 1.0, o->half_forward_rad = 0.4, o->half_right_rad = 0.6;
    poisoned(&o->period_s, 11);
}

static void cycle_of(dl_law_cycle *in, int horizons)
{
    memset(in, 0, sizeof *in);
    in->goes_on = draw() % 8 != 0, in->steers = draw() % 4 != 0, in->has_deck = draw() % 4 != 0, in->horizons = horizons;
    in->has_yaw = draw() % 4 != 0, in->has_rate = draw() % 2, in->has_wanted_yaw = draw() % 2, in->has_lean_max = draw() % 2;
    double *values = &in->dt;
    const int n = (int)(sizeof *in / sizeof *values) - 8;
    for (int i = 0; i < n; i++) {
        values[i] = uniform();
    }
    in->dt = 0.02, in->share = draw() % 2 ? 1.0 : 0.3, in->forecast_age_s = 0.01 * (draw() % 60);
    poisoned(values, n);
}

static void law(int rounds, double poison)
{
    dl_law_params o;
    dl_law_gains gains[2];
    dl_law_memory memory, after;
    dl_law_command command;
    double *observer = numbers(12);
    law_parameters(&o);
    gains_of(&gains[0], o.remembered), gains_of(&gains[1], o.remembered);
    memset(&memory, 0, sizeof memory);
    poisoned(observer, 12);
    for (int k = 0; k < rounds; k++) {
        dl_law_cycle in;
        const int n = draw() % 12;
        double *horizons = numbers(n > 0 ? n : 1), *rates = numbers(n > 0 ? 3 * n : 1);
        for (int i = 1; i < n; i++) {
            horizons[i] = horizons[i - 1] + 0.2;
        }
        poisoned(horizons, n > 0 ? n : 1), poisoned(rates, n > 0 ? 3 * n : 1);
        cycle_of(&in, n);
        in.v[0] *= poison;
        dl_law_step(&o, &gains[0], &gains[draw() % 2], observer, &in, horizons, rates, &memory, &after, &command);
        memory = after;
        fold(&command.a[0], 8), fold(&memory.pushed_down_m_s2, 3);
        free(horizons), free(rates);
    }
    const dl_axis_measured z = {0.1, 0.2, 0.3 * poison, 0.4, 0.5, 0.6};
    dl_law_axis one;
    law_observe(&o, observer, 0.02, uniform(), &memory.axes[0], &z, &one);
    /* Compilers differ in the order in which they take arguments. */
    const double off_m = uniform(), a_deck = uniform(), a_deck_then = uniform();
    const double u = law_tilt(&one, &gains[0], off_m, a_deck, a_deck_then);
    fold(&u, 1);
    free(observer);
}
