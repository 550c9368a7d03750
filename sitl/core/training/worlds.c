/* Many flights of one scenario for controllers that learn: episodes, steps, observations, rewards. */

#include <math.h>
#include <string.h>

#include "base/rotation.h"
#include "base/wide.h"
#include "physics/physics.h"

enum { MODES = 6, ROLL = 3, PITCH = 4, YAW = 5, HEIGHT = 2, HEADING = 3 };

static const double TURN = 6.283185307179586; /* A turn, rad. */
/* An estimate without sightings for longer than this ends as one that is lost, s. */
static const double AGE_MAX_S = 5.0;

/* ---- random numbers ---- */

/* Source: Blackman & Vigna, Scrambled linear pseudorandom number generators, ACM TOMS 47(4), 2021: xoshiro256++. */
static uint64_t random_bits(uint64_t s[4])
{
    const uint64_t sum = s[0] + s[3], out = ((sum << 23) | (sum >> 41)) + s[0], t = s[1] << 17;
    s[2] ^= s[0];
    s[3] ^= s[1];
    s[1] ^= s[2];
    s[0] ^= s[3];
    s[2] ^= t;
    s[3] = (s[3] << 45) | (s[3] >> 19);
    return out;
}

static double uniform(uint64_t s[4])
{
    return (double)(random_bits(s) >> 11) * (1.0 / 9007199254740992.0);
}

/* A number of mean 0 and variance 1, the sum of four uniform ones of 16 bits. Gusts and errors pass it through lags, after which
 * its distribution is normal within what a flight can notice. */
static double normal(uint64_t s[4])
{
    const uint64_t bits = random_bits(s);
    const int64_t sum = (int64_t)((bits & 0xffff) + ((bits >> 16) & 0xffff) + ((bits >> 32) & 0xffff) + (bits >> 48));
    return (double)(sum - 131070) * (1.7320508075688772 / 65536.0);
}

static void normals(uint64_t s[4], int n, double *out)
{
    for (int i = 0; i < n; i++) {
        out[i] = normal(s);
    }
}

/* ---- the deck ---- */

/* The vessel's displacement (6) and rate (6) by the phasors. */
WIDE
static void sway(const dl_sim_training *o, const dl_sim_training_world *w, double out[12])
{
    double sum[12] = {0.0};
    for (int64_t k = 0; k < o->harmonics; k++) {
        const double re = w->phasor_re[k], im = w->phasor_im[k];
        for (int j = 0; j < 12; j++) {
            sum[j] += o->sway[k].by_re[j] * re + o->sway[k].by_im[j] * im;
        }
    }
    memcpy(out, sum, sizeof sum);
}

/* Turn the phasors by a step of the controller, and find the deck at its end. */
static void move_deck(const dl_sim_training *o, dl_sim_training_world *w)
{
    memcpy(w->deck_at[0], w->deck_at[1], sizeof w->deck_at[0]);
    for (int64_t k = 0; k < o->harmonics; k++) {
        const double re = w->phasor_re[k], im = w->phasor_im[k], c = o->sway[k].turn_re, s = o->sway[k].turn_im;
        w->phasor_re[k] = re * c - im * s;
        w->phasor_im[k] = re * s + im * c;
    }
    sway(o, w, w->deck_at[1]);
}

/* The deck at a share of the present step, by the cubic that meets displacement and rate at both ends. */
static void deck_between(const dl_sim_training *o, const dl_sim_training_world *w, double share, dl_sim_deck *deck)
{
    const double c = o->cos_course, s = o->sin_course, t = w->t_s + share * o->step_s;
    const double u = share, u2 = u * u, u3 = u2 * u, dt = o->step_s;
    const double at[4] = {2 * u3 - 3 * u2 + 1, (u3 - 2 * u2 + u) * dt, 3 * u2 - 2 * u3, (u3 - u2) * dt};
    const double rate[4] = {6 * (u2 - u) / dt, 3 * u2 - 4 * u + 1, 6 * (u - u2) / dt, 3 * u2 - 2 * u};
    const double *a = w->deck_at[0], *b = w->deck_at[1];
    dl_sim_vessel_motion m = {{0.0}, {0.0}, {0.0}};
    for (int i = 0; i < MODES; i++) {
        m.eta[i] = at[0] * a[i] + at[1] * a[i + MODES] + at[2] * b[i] + at[3] * b[i + MODES];
        m.eta_dot[i] = rate[0] * a[i] + rate[1] * a[i + MODES] + rate[2] * b[i] + rate[3] * b[i + MODES];
    }
    dl_sim_vessel_origin origin = o->course;
    const double to[3] = {c * m.eta[0] - s * m.eta[1], s * m.eta[0] + c * m.eta[1], m.eta[2]};
    const double with[3] = {c * m.eta_dot[0] - s * m.eta_dot[1], s * m.eta_dot[0] + c * m.eta_dot[1], m.eta_dot[2]};
    for (int i = 0; i < 3; i++) {
        origin.p[i] += o->course.v[i] * t + to[i];
        origin.v[i] += with[i];
    }
    dl_sim_mounted pad;
    dl_sim_vessel_mounted(1, &origin, &m, &o->pad, &pad);
    memcpy(deck->p, pad.p, sizeof deck->p);
    memcpy(deck->v, pad.v, sizeof deck->v);
    memcpy(deck->R, pad.R, sizeof deck->R);
    memcpy(deck->w, pad.w, sizeof deck->w);
}

/* ---- episodes ---- */

/* Another vehicle than the file's, by as much as its owner's identification leaves. */
static void draw_vehicle(const dl_sim_training *o, dl_sim_training_world *w)
{
    double by[DL_WRONG_NUMBERS];
    for (int i = 0; i < DL_WRONG_NUMBERS; i++) {
        by[i] = o->wrong_sigma[i] * normal(w->random);
    }
    dl_sim_vehicle_params *p = &w->vehicle_params;
    *p = o->vehicle_params;
    const double frequency = exp(by[DL_WRONG_TILT_FREQUENCY]);
    p->tilt_p *= frequency * frequency;
    p->tilt_d *= frequency * exp(by[DL_WRONG_TILT_DAMPING]);
    p->effects.lift_share *= exp(by[DL_WRONG_THRUST]);
    p->effects.on = p->effects.on || o->wrong_sigma[DL_WRONG_THRUST] > 0.0;
    for (int i = 0; i < 3; i++) {
        p->drag_per_s[i] *= exp(by[DL_WRONG_DRAG]);
    }
    const double steps = by[DL_WRONG_COMMAND_DELAY_S] / p->step_s;
    p->delay_steps = (int64_t)clip((double)p->delay_steps + rint(steps), 0.0, DL_COMMANDS_MAX);
}

/* The steady state of turbulence, eddies, gusts and errors (`Vehicle._begin_errors`, `_begin_air`). */
static void draw_disturbances(const dl_sim_vehicle_params *p, double tilt_sigma_rad, uint64_t random[4], dl_sim_vehicle *v)
{
    double n[13];
    normals(random, 13, n);
    for (int i = 0; i < 2; i++) {
        v->gust[i] = p->gust_sigma_m_s * n[i];
        v->tilt_bias[i] = tilt_sigma_rad * n[2 + i];
    }
    v->gust[2] = 0.5 * p->gust_sigma_m_s * n[4];
    double *const air[3] = {v->air_u, v->air_v, v->air_w};
    for (int i = 0; i < 3; i++) {
        air[i][0] = n[5 + i];
        air[i][1] = 0.5 * (n[5 + i] + n[8 + i]);
    }
    v->eddy[0] = n[11];
    v->eddy[1] = n[12];
}

static void quaternion_about_down(double angle, double q[4])
{
    q[0] = cos(0.5 * angle);
    q[1] = q[2] = 0.0;
    q[3] = sin(0.5 * angle);
}

/* Put the vehicle into the air over the deck, level, with the vessel's way. */
static void place(const dl_sim_training *o, dl_sim_training_world *w)
{
    dl_sim_vehicle *v = &w->vehicle;
    double at[4];
    for (int i = 0; i < 4; i++) {
        at[i] = o->start_low[i] + uniform(w->random) * (o->start_high[i] - o->start_low[i]);
    }
    const double heading = heading_of(w->deck.R) + at[HEADING], c = cos(heading), s = sin(heading);
    v->p[0] = w->deck.p[0] - (c * at[0] - s * at[1]);
    v->p[1] = w->deck.p[1] - (s * at[0] + c * at[1]);
    v->p[2] = w->deck.p[2] - at[HEIGHT];
    memcpy(v->v, o->course.v, sizeof v->v);
    quaternion_about_down(heading, v->q);
    about_down(heading, v->R);
    v->z_hold = v->p[2];
    v->airborne_s = 1.0;
    v->phase = DL_PHASE_FLYING;
    v->thrust_n = w->vehicle_params.mass_kg * GRAVITY_M_S2;
}

/* ---- observations ---- */

/* Cosine and sine of the heading of a rotation. */
static void direction_of(const double R[9], double *c, double *s)
{
    const double by = 1.0 / sqrt(fmax(1e-12, R[0] * R[0] + R[3] * R[3]));
    *c = by * R[0], *s = by * R[3];
}

/* The pad from the body in level axes, its velocity against the body, and cosine and sine of the body's heading. */
static void relative_in_level(const dl_sim_training_world *w, double place_m[3], double velocity[3], double *cos_psi, double *sin_psi)
{
    const dl_sim_vehicle *v = &w->vehicle;
    double d[3], u[3], c, s;
    direction_of(v->R, &c, &s);
    for (int i = 0; i < 3; i++) {
        d[i] = w->deck.p[i] - v->p[i];
        u[i] = w->deck.v[i] - v->v[i];
    }
    place_m[0] = c * d[0] + s * d[1], place_m[1] = c * d[1] - s * d[0], place_m[2] = d[2];
    velocity[0] = c * u[0] + s * u[1], velocity[1] = c * u[1] - s * u[0], velocity[2] = u[2];
    *cos_psi = c, *sin_psi = s;
}

/* The reported tilt as the acceleration that hovering thrust gives with it, forward and right. */
static void lean_of(const dl_sim_vehicle *v, double lean[2])
{
    const double *R = v->R, level = sqrt(fmax(1e-9, 1.0 - R[6] * R[6]));
    lean[0] = GRAVITY_M_S2 * (R[6] / level - v->tilt_bias[1]);
    lean[1] = GRAVITY_M_S2 * (R[7] / (fmax(1e-3, R[8]) * level) + v->tilt_bias[0]);
}

/* Carry the errors of the estimate on by a step. Without sightings the place drifts with the error of the velocity. */
static void carry_errors(const dl_sim_training *o, dl_sim_training_world *w)
{
    const double share = uniform(w->random);
    const int lost = w->lost > 0 ? share >= o->found_share : share < o->lost_share;
    w->lost = lost ? w->lost + 1 : 0;
    for (int i = 0; i < 3; i++) {
        w->error[3 + i] = o->error_keep * w->error[3 + i] + o->error_fresh * normal(w->random);
        w->error[i] = lost ? w->error[i] : o->error_keep * w->error[i] + o->error_fresh * normal(w->random);
    }
}

static void observe(const dl_sim_training *o, dl_sim_training_world *w, float *view)
{
    double place_m[3], velocity[3], lean[2], c, s;
    const double *R = w->deck.R, height = w->deck.p[2] - w->vehicle.p[2];
    relative_in_level(w, place_m, velocity, &c, &s);
    lean_of(&w->vehicle, lean);
    const double age_s = (double)w->lost * o->step_s, h = clip(height, 0.0, 20.0);
    const double sigma = o->place_sigma_m + o->place_sigma_by_height * h, rate = o->velocity_sigma_m_s + o->velocity_sigma_by_height * h;
    float *now = w->views + DL_VIEW_NUMBERS * w->view_at;
    for (int i = 0; i < 3; i++) {
        const double drift = age_s * rate * w->error[3 + i];
        now[DL_VIEW_PLACE + i] = (float)(place_m[i] + (o->true_view ? 0.0 : sigma * w->error[i] + drift));
        now[DL_VIEW_VELOCITY + i] = (float)(velocity[i] + (o->true_view ? 0.0 : rate * w->error[3 + i]));
    }
    for (int i = 0; i < 2; i++) {
        now[DL_VIEW_LEAN + i] = (float)lean[i];
        now[DL_VIEW_TRIM + i] = (float)w->trim[i];
    }
    const double down = w->deck.v[2] + (o->true_view ? 0.0 : rate * w->error[5]);
    now[DL_VIEW_DECK] = (float)down;
    now[DL_VIEW_DECK + 1] = (float)((w->deck_at[1][2 + MODES] - w->deck_at[0][2 + MODES]) / o->step_s);
    /* The deck's normal, seen along and across the body's heading. */
    now[DL_VIEW_DECK_TILT] = (float)-(c * R[5] - s * R[2]);
    now[DL_VIEW_DECK_TILT + 1] = (float)(c * R[2] + s * R[5]);
    double cos_deck, sin_deck;
    direction_of(R, &cos_deck, &sin_deck);
    now[DL_VIEW_HEADING] = (float)(s * cos_deck - c * sin_deck);
    now[DL_VIEW_HEADING + 1] = (float)(c * cos_deck + s * sin_deck);
    for (int i = 0; i < DL_ACTION_NUMBERS; i++) {
        now[DL_VIEW_ACTION + i] = (float)w->action[i];
    }
    now[DL_VIEW_AGE] = (float)(o->true_view ? 0.0 : age_s);
    const int64_t oldest = (w->view_at + DL_VIEWS_MAX - (w->steps < o->view_delay ? w->steps : o->view_delay)) % DL_VIEWS_MAX;
    memcpy(view, w->views + DL_VIEW_NUMBERS * oldest, DL_VIEW_NUMBERS * sizeof *view);
    w->view_at = (w->view_at + 1) % DL_VIEWS_MAX;
}

/* Remaining way: the distance beside the pad, and half of the height above it, m. */
static double distance_to_go(const dl_sim_training_world *w, double *lateral, double *height)
{
    relative r;
    relative_to_deck(&w->deck, w->vehicle.p, w->vehicle.v, w->vehicle.R, w->vehicle.w, &r);
    *lateral = sqrt(r.d[0] * r.d[0] + r.d[1] * r.d[1]);
    *height = -r.d[2];
    return *lateral + 0.5 * fabs(*height);
}

static void begin_episode(const dl_sim_training *o, dl_sim_training_world *w, float *view)
{
    double lateral, height;
    draw_vehicle(o, w);
    w->vehicle = o->vehicle;
    draw_disturbances(&w->vehicle_params, o->tilt_sigma_rad, w->random, &w->vehicle);
    w->t_s = 0.0;
    w->steps = w->lost = w->view_at = 0;
    for (int64_t k = 0; k < o->harmonics; k++) {
        const double phase = TURN * uniform(w->random);
        w->phasor_re[k] = cos(phase);
        w->phasor_im[k] = sin(phase);
    }
    sway(o, w, w->deck_at[1]);
    memcpy(w->deck_at[0], w->deck_at[1], sizeof w->deck_at[0]);
    deck_between(o, w, 0.0, &w->deck);
    place(o, w);
    memset(w->trim, 0, sizeof w->trim);
    memset(w->action, 0, sizeof w->action);
    normals(w->random, 6, w->error);
    w->goal_m = distance_to_go(w, &lateral, &height);
    observe(o, w, view);
}

void dl_sim_training_begin(const dl_sim_training *rules, int32_t count, dl_sim_training_world *worlds, float *views)
{
    for (int32_t i = 0; i < count; i++) {
        begin_episode(rules, &worlds[i], views + DL_VIEW_NUMBERS * i);
    }
}

/* ---- steps ---- */

/* Put an action onto the stick. The trim carries wind and drag, so that an action of zero keeps the velocity. */
static void command(const dl_sim_training *o, dl_sim_training_world *w, const float action[DL_ACTION_NUMBERS])
{
    const dl_sim_vehicle_params *p = &w->vehicle_params;
    double a[2], place_m[3], velocity[3], c, s;
    for (int i = 0; i < DL_ACTION_NUMBERS; i++) {
        w->action[i] = action[i] == action[i] ? clip((double)action[i], -1.0, 1.0) : 0.0;
    }
    relative_in_level(w, place_m, velocity, &c, &s);
    for (int i = 0; i < 2; i++) {
        a[i] = o->acceleration_max_m_s2 * w->action[i];
        if (o->velocity_actions) {
            a[i] = clip(o->velocity_gain * (o->velocity_max_m_s * w->action[i] + velocity[i]), -o->acceleration_max_m_s2,
                        o->acceleration_max_m_s2);
        }
        a[i] = clip(atan((a[i] + w->trim[i]) / GRAVITY_M_S2) / p->euler_angle_max_rad, -1.0, 1.0);
    }
    double *stick = w->vehicle.command;
    stick[0] = a[1];
    stick[1] = -a[0];
    stick[2] = clip(-(w->deck.v[2] + o->down_max_m_s * w->action[DL_ACTION_DOWN]) / p->vz_max_m_s, -1.0, 1.0);
    stick[3] = clip(o->yaw_rate_max_rad_s * w->action[DL_ACTION_YAW] / p->yaw_rate_max_rad_s, -1.0, 1.0);
    stick[4] = 1.0;
}

/* Carry on the mean of what the tilt gives beyond the acceleration that is measured: wind, drag and the attitude's error. */
static void learn_trim(const dl_sim_training *o, dl_sim_training_world *w)
{
    const dl_sim_vehicle *v = &w->vehicle;
    double lean[2], c, s;
    direction_of(v->R, &c, &s);
    const double a[2] = {c * v->a[0] + s * v->a[1], c * v->a[1] - s * v->a[0]};
    lean_of(v, lean);
    for (int i = 0; i < 2; i++) {
        w->trim[i] = o->trim_keep * w->trim[i] + (1.0 - o->trim_keep) * (lean[i] - a[i]);
    }
}

/* Fly up to the next command, or up to a contact; return whether there was one. */
static int fly(const dl_sim_training *o, dl_sim_training_world *w)
{
    double noise[2][DL_FLIGHT_NOISE], rough[DL_EFFECT_NOISE] = {0.0};
    dl_sim_vehicle *v = &w->vehicle;
    const double before = v->touched_s;
    for (int64_t i = 1; i <= o->physics_steps; i++) {
        deck_between(o, w, (double)i / (double)o->physics_steps, &w->deck);
        normals(w->random, 2 * DL_FLIGHT_NOISE, noise[0]);
        if (w->vehicle_params.effects.on) {
            normals(w->random, DL_EFFECT_NOISE, rough);
        }
        dl_sim_vehicle_step(&w->vehicle_params, v, &w->deck, 0.0, 0.0, noise[0], noise[1], rough);
        if (v->touched_what != 0 && v->touched_s != before) {
            return 1;
        }
    }
    return 0;
}

static int8_t ended(const dl_sim_training *o, const dl_sim_training_world *w, int touched, const float touchdown[3], double lateral)
{
    if (touched && w->vehicle.touched_what == DL_TOUCHED_SEA) {
        return DL_EPISODE_IN_WATER;
    }
    if (touched && touchdown[0] > o->pad_radius_m) {
        return DL_EPISODE_OFF_PAD;
    }
    if (touched) {
        return touchdown[1] > o->vertical_max_m_s || touchdown[2] > o->lateral_max_m_s ? DL_EPISODE_HARD : DL_EPISODE_LANDED;
    }
    if (lateral > o->reach_m || w->deck.p[2] - w->vehicle.p[2] > o->reach_m || w->vehicle.phase == DL_PHASE_EMERGENCY
        || (double)w->lost * o->step_s > AGE_MAX_S) {
        return DL_EPISODE_LEFT;
    }
    return w->steps >= o->steps_max ? DL_EPISODE_TIMED_OUT : DL_EPISODE_GOES_ON;
}

static void step_world(const dl_sim_training *o, dl_sim_training_world *w, const float *action, const dl_sim_training_step *out, int32_t n)
{
    float *terms = out->terms + DL_REWARD_TERMS * n, *touchdown = out->touchdowns + 3 * n, *view = out->views + DL_VIEW_NUMBERS * n;
    double was[DL_ACTION_NUMBERS], lateral, height, effort = 0.0;
    memcpy(was, w->action, sizeof was);
    command(o, w, action);
    move_deck(o, w);
    const int touched = fly(o, w);
    w->t_s += o->step_s;
    w->steps++;
    learn_trim(o, w);
    for (int i = 0; i < DL_ACTION_NUMBERS; i++) {
        effort += (w->action[i] - was[i]) * (w->action[i] - was[i]);
    }
    const double goal = distance_to_go(w, &lateral, &height);
    const double *v = w->vehicle.touched_v, *d = w->vehicle.touched_d;
    touchdown[0] = touched ? (float)sqrt(d[0] * d[0] + d[1] * d[1]) : NAN;
    touchdown[1] = touched ? (float)v[2] : NAN;
    touchdown[2] = touched ? (float)sqrt(v[0] * v[0] + v[1] * v[1]) : NAN;
    const int8_t end = ended(o, w, touched, touchdown, lateral);
    const int down = end == DL_EPISODE_LANDED || end == DL_EPISODE_HARD;
    terms[DL_REWARD_NEARER] = (float)(w->goal_m - goal);
    terms[DL_REWARD_OUTSIDE] = (float)(-o->step_s * fmax(0.0, lateral - (o->pad_radius_m + 0.5 * fmax(0.0, height))));
    terms[DL_REWARD_EFFORT] = (float)-effort;
    terms[DL_REWARD_TIME] = (float)-o->step_s;
    terms[DL_REWARD_LANDED] = (float)(end == DL_EPISODE_LANDED);
    terms[DL_REWARD_MISSED_BY] = down ? -touchdown[0] / (float)o->pad_radius_m : 0.0f;
    terms[DL_REWARD_SPEED] = down ? -(touchdown[1] / (float)o->vertical_max_m_s + touchdown[2] / (float)o->lateral_max_m_s) : 0.0f;
    terms[DL_REWARD_FAILED] = (float)-(end != DL_EPISODE_GOES_ON && end != DL_EPISODE_TIMED_OUT && end != DL_EPISODE_LANDED);
    w->goal_m = goal;
    out->ends[n] = end;
    carry_errors(o, w);
    observe(o, w, view);
    if (end != DL_EPISODE_GOES_ON) {
        memcpy(out->last_views + DL_VIEW_NUMBERS * n, view, DL_VIEW_NUMBERS * sizeof *view);
        begin_episode(o, w, view);
    }
}

void dl_sim_training_step_all(const dl_sim_training *rules, int32_t count, dl_sim_training_world *worlds, const float *actions,
                           const dl_sim_training_step *out)
{
    for (int32_t i = 0; i < count; i++) {
        step_world(rules, &worlds[i], actions + DL_ACTION_NUMBERS * i, out, i);
    }
}
