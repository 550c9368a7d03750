/* Calls the simulated vehicle's functions: flights over a deck and beside it, with every kind of air and of rotors. */

static void vehicle_parameters(dl_sim_vehicle_params *o, int kind)
{
    memset(o, 0, sizeof *o);
    o->rotors = kind % 2 ? 6 : 4, o->quad_x = kind % 2 == 0, o->effect_by_rotor = kind % 2;
    o->flow_sees_deck = 1, o->flow_works = kind != 3, o->motor_driven = kind == 4, o->all_healthy = kind != 2;
    o->delay_steps = kind == 5 ? 0 : kind == 6 ? DL_COMMANDS_MAX : 10;
    o->step_s = 0.004, o->mass_kg = 1.477, o->thrust_max_n = 30.0, o->motor_lag = 0.08, o->arm_m = 0.127;
    o->rotor_radius_m = 0.1, o->effect_radius_m = 0.2, o->rotors_above_m = 0.03, o->yaw_torque_per_thrust_m = 0.02;
    for (int i = 0; i < 3; i++) {
        o->inertia_kg_m2[i] = 0.0115, o->torque_max_n_m[i] = 1.0, o->drag_per_s[i] = 0.3, o->unasked_max_rad_s2[i] = 80.0;
    }
    for (int i = 0; i < DL_ROTORS_MAX; i++) {
        o->rotor_forward[i] = i < 2 ? 1.0 : -1.0, o->rotor_right[i] = i % 3 ? 1.0 : -1.0, o->rotor_spin[i] = i % 2 ? 1.0 : -1.0;
        o->rotor_health[i] = i ? 1.0 : 0.5;
    }
    o->rotor_squares[0] = o->rotor_squares[1] = (double)o->rotors;
    o->landing_speed_m_s = 0.4, o->take_off_speed_m_s = 0.5, o->take_off_height_m = 1.0, o->motors_off_after_s = 0.2;
    o->tilt_cut_off_cos = 0.36, o->tilt_p = 10.0, o->tilt_d = 5.0, o->yaw_rate_p = 2.0, o->velocity_p = 5.0, o->velocity_d = 1.0;
    o->velocity_i = 1.0, o->velocity_i_max_m_s2 = 3.0, o->climb_p = 5.0, o->climb_d = 1.0, o->climb_i = 2.5;
    o->climb_i_max_m_s2 = 4.0, o->height_p = 1.0, o->observer_share = 0.04, o->flow_scale = 0.83, o->flow_lag = 0.1;
    o->foot_m = 0.13, o->feet_below_m = 0.045, o->hull_top_m = 0.06, o->foot_n_m = 1500.0, o->foot_n_s_m = 33.0;
    o->friction = 0.6, o->deck_fore_m = o->deck_aft_m = 2.0, o->deck_half_m = 1.5;
    o->deck_taper_m = kind % 2, o->deck_yaw[0] = 1.0, o->gust_sigma_m_s = 0.5, o->gust_keep = o->flow_keep = o->tilt_keep = 0.99;
    o->gust_fresh = o->flow_fresh = o->tilt_fresh = 0.01, o->tilt_max_rad = 0.5;
    o->euler_angle_max_rad = 0.21, o->vz_max_m_s = 0.7, o->yaw_rate_max_rad_s = 1.7;
    dl_sim_effects *e = &o->effects;
    e->on = kind == 1 || kind == 2, e->saturates = e->moving_deck = e->rotor_drag = e->on, e->sag = 0.15, e->hover_share = 0.5, e->drag_per_m = 0.006;
    e->downwash = 0.5, e->downwash_keep = 0.99, e->downwash_fresh = 0.1, e->cushion_share = 0.04, e->induced_m_s = 6.0;
    e->climb_keep = 0.99, e->climb_fresh = 0.01, e->rate_sigma = 0.03, e->loop_mass_kg = 1.4, e->tilt_gain = e->lift_share = 1.0;
    e->thing[2] = 0.1, e->thing[3] = 0.02, e->revolution_hz = 60.0;
    dl_sim_air_params *air = &o->air;
    air->on = kind > 1, air->logarithmic = kind % 2, air->dryden = kind == 3, air->wake = kind == 2;
    air->kaimal = kind == 5, air->hull_wake = kind == 6, air->edge_m = 1.2, air->edge_decay = 0.03, air->deck_m[0] = air->deck_m[1] = 2.0;
    air->gusts = kind == 4 ? DL_GUSTS_MAX : 0, air->speed_m_s = 7.0, air->along[0] = -1.0, air->roughness_m = 0.0002;
    air->log10m = 10.8, air->keep_ship = 0.001, air->block_m[0] = -6.0, air->wake_decay = 0.03, air->pad_yaw[0] = 1.0;
    for (int i = 0; i < 3; i++) {
        air->block_size[i] = 5.0;
    }
    for (int i = 0; i < DL_GUSTS_MAX; i++) {
        air->gust[i].rise_s = air->gust[i].hold_s = 0.1, air->gust[i].v[0] = 0.1;
    }
}

static void sail(int kind, int steps, double poison)
{
    dl_sim_vehicle_params *o = malloc(sizeof *o);
    dl_sim_vehicle *v = calloc(1, sizeof *v);
    dl_sim_sensor_params *e = calloc(1, sizeof *e);
    dl_sim_sensors *s = calloc(1, sizeof *s);
    dl_sim_readings *out = malloc(sizeof *out);
    dl_sim_water *sea = calloc(1, sizeof *sea);
    dl_sim_wave *waves = calloc(3, sizeof *waves);
    dl_sim_deck *decks = calloc((size_t)steps, sizeof *decks);
    double *noise = numbers(DL_FLIGHT_NOISE * steps), *air = numbers(DL_FLIGHT_NOISE * steps), *sensed = numbers(DL_SENSOR_NOISE * steps);
    double *rough = numbers(DL_EFFECT_NOISE * steps);
    vehicle_parameters(o, kind);
    for (int i = 0; i < steps; i++) {
        decks[i].p[2] = -0.5, decks[i].R[0] = decks[i].R[4] = decks[i].R[8] = 1.0;
    }
    for (int i = 0; i < 3; i++) {
        waves[i].amplitude_m = 0.1, waves[i].k[0] = 0.3, waves[i].w_rad_s = 1.0 + i;
    }
    sea->every = 5;
    e->echo_every = 1 + kind, e->echo_delay = 15, e->step_s = 0.004, e->cone_rad = 0.7, e->echo_max_m = 6.0;
    e->battery_life_s = 1200.0, e->hover_n = 3.6, e->accel_scale = e->gyro_scale = 1.0, e->vibration = kind == 1;
    v->phase = kind % 2 ? DL_PHASE_LANDING : DL_PHASE_FLYING, v->q[0] = v->R[0] = v->R[4] = v->R[8] = v->attached_q[0] = 1.0;
    v->p[1] = kind == 6 ? 3.0 : 0.0, v->p[2] = -1.1 * poison, v->airborne_s = 1.0, v->thrust_n = 14.0, v->touched_s = NAN;
    v->driven_n = 10.0;
    dl_sim_vehicle_step(o, v, decks, 0.0, 0.0, noise, air, rough);
    const dl_sim_flight flown = {o, v, e, s, sea, waves, 3};
    for (int done = 0; done < steps;) {
        done += dl_sim_run(&flown, steps - done, decks + done, noise + DL_FLIGHT_NOISE * done, air + DL_FLIGHT_NOISE * done,
                        rough + DL_EFFECT_NOISE * done, sensed + DL_SENSOR_NOISE * done);
    }
    dl_sim_sensors_read(o, v, e, s, out);
    fold(v->p, 3), fold(v->v, 3), fold(v->air, 3), fold(out->f_body, 3), fold(&out->pressure_pa, 1);
    dl_sim_vehicle_carry(v, decks);
    void *all[] = {o, v, e, s, out, sea, waves, decks, noise, air, sensed, rough};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) {
        free(all[i]);
    }
}

/* Worlds to train in: episodes that end on the deck, beside it and by time, with every kind of action and of view. */
static void train(int kind, int steps)
{
    enum { WORLDS = 3 };
    dl_sim_training *rules = calloc(1, sizeof *rules);
    dl_sim_training_world *worlds = calloc(WORLDS, sizeof *worlds);
    float *views = calloc(WORLDS * DL_VIEW_NUMBERS, sizeof *views), *last = calloc(WORLDS * DL_VIEW_NUMBERS, sizeof *last);
    float actions[WORLDS * DL_ACTION_NUMBERS], terms[WORLDS * DL_REWARD_TERMS], touchdowns[WORLDS * 3];
    int8_t ends[WORLDS];
    const dl_sim_training_step out = {views, terms, last, touchdowns, ends};
    vehicle_parameters(&rules->vehicle_params, kind);
    rules->harmonics = kind % 3 ? DL_HARMONICS_MAX : 0, rules->physics_steps = 5, rules->steps_max = 40, rules->step_s = 0.02;
    rules->velocity_actions = kind % 2, rules->true_view = kind == 3, rules->view_delay = kind % 4 == 1 ? DL_VIEWS_MAX - 1 : kind % 4;
    rules->acceleration_max_m_s2 = 3.0, rules->velocity_max_m_s = 1.0, rules->velocity_gain = 2.0, rules->down_max_m_s = 0.8;
    rules->yaw_rate_max_rad_s = 1.0, rules->start_high[0] = rules->start_high[1] = 0.5, rules->start_low[2] = 0.5;
    rules->start_high[2] = 1.0, rules->pad_radius_m = 0.39, rules->vertical_max_m_s = 1.0, rules->lateral_max_m_s = 0.5;
    rules->reach_m = kind == 5 ? 0.1 : 10.0, rules->trim_keep = rules->error_keep = 0.9, rules->error_fresh = 0.4;
    rules->place_sigma_m = rules->tilt_sigma_rad = 0.02, rules->lost_share = 0.1, rules->found_share = 0.3;
    rules->pad.R[0] = rules->pad.R[4] = rules->pad.R[8] = 1.0;
    rules->vehicle.phase = DL_PHASE_FLYING, rules->vehicle.q[0] = rules->vehicle.attached_q[0] = 1.0;
    rules->vehicle.R[0] = rules->vehicle.R[4] = rules->vehicle.R[8] = 1.0, rules->vehicle.thrust_n = 14.0, rules->vehicle.touched_s = NAN;
    for (int i = 0; i < DL_HARMONICS_MAX; i++) {
        rules->sway[i].by_re[2] = 0.01, rules->sway[i].turn_re = 0.9998, rules->sway[i].turn_im = 0.02;
    }
    for (int i = 0; i < WORLDS; i++) {
        worlds[i].random[0] = (uint64_t)draw() + 1;
    }
    dl_sim_training_begin(rules, WORLDS, worlds, views);
    for (int n = 0; n < steps; n++) {
        for (int i = 0; i < WORLDS * DL_ACTION_NUMBERS; i++) {
            actions[i] = (float)uniform();
        }
        dl_sim_training_step_all(rules, WORLDS, worlds, actions, &out);
    }
    for (int i = 0; i < WORLDS; i++) {
        found += ends[i] + terms[i * DL_REWARD_TERMS] * 1e-3;
    }
    free(rules), free(worlds), free(views), free(last);
}

/* A vessel's motion at equal and at other steps of time, and that of a point on her. */
static void ride(int harmonics, int n)
{
    dl_sim_harmonic *h = calloc((size_t)harmonics, sizeof *h);
    double *t_s = numbers(n);
    dl_sim_vessel_motion *moved = malloc((size_t)n * sizeof *moved);
    dl_sim_vessel_origin *origin = calloc((size_t)n, sizeof *origin);
    dl_sim_mounted *out = malloc((size_t)n * sizeof *out);
    dl_sim_mount at = {{1.0, 0.5, -2.0}, {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0}};
    for (int i = 0; i < n / 2; i++) {
        t_s[i] = 0.1 * i;
    }
    for (int i = 0; i < harmonics; i++) {
        h[i].w_rad_s = 0.5 + 0.1 * i, h[i].re[i % 6] = 0.1, h[i].im[(i + 3) % 6] = uniform();
    }
    poisoned(t_s, n);
    dl_sim_vessel_moved(harmonics, h, n, t_s, moved);
    dl_sim_vessel_mounted(n, origin, moved, &at, out);
    fold(moved->eta, 18), fold(out[n - 1].p, 21);
    void *all[] = {h, t_s, moved, origin, out};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) {
        free(all[i]);
    }
}

static void simulator(void)
{
    const double poisons[] = {1.0, NAN, INFINITY, -1e300};
    for (int kind = 0; kind <= 6; kind++) {
        sail(kind, 1500, 1.0);
        sail(kind, 20, poisons[kind % 4]);
        train(kind, 120);
        ride(kind, 1 + 20 * kind);
    }
}
