/* The air over a ship: wind that grows with height, Dryden's or Kaimal's turbulence, discrete gusts, and the wakes of superstructure and
 * hull. */

#include <math.h>

#include "base/rotation.h"
#include "physics/physics.h"

static const double FOOT_M = 0.3048; /* A foot, m. */
/* Below this height over the water the wind is taken as at it, m. */
static const double LOWEST_M = 0.5;
/* Share of the wind that the wake can take: Perera's formula is not for the near wake, where it would take more than all. */
static const double DEFICIT_MAX = 0.9;
static const double WAKE_TURBULENCE = 0.32; /* Turbulence in a wake, of its deficit. */

/* Source: logarithmic profile of neutral air, U = U10 ln(h / z0) / ln(10 / z0), as in DNV-RP-C205 (2010), 2.3.2.4. */
static double mean_wind(const dl_sim_air_params *o, double height)
{
    if (!o->logarithmic) {
        return o->speed_m_s;
    }
    return o->speed_m_s * log(clip(height, LOWEST_M, 1e4) / o->roughness_m) / o->log10m;
}

/* White noise through one lag (variance 1), and that through the same lag again (variance 1/2, covariance 1/2). */
static void lag_twice(double state[2], double keep, double fresh, double noise)
{
    const double first = state[0];
    state[0] = keep * first + fresh * noise;
    state[1] = keep * state[1] + (1.0 - keep) * first;
}

/* (1 + sqrt(3) T s) / (1 + T s)^2 of white noise, with variance 1: sqrt(3) a + (1 - sqrt(3)) b has variance 2. */
static double shaped(const double state[2])
{
    return sqrt(0.5) * (sqrt(3.0) * state[0] + (1.0 - sqrt(3.0)) * state[1]);
}

/* The turbulence along and across the wind and downwards.
 *
 * Source: MIL-F-8785C, 3.7.1.2 and 3.7.3.4 (low altitude): sigma_w = 0.1 W20, sigma_u = sigma_w / (0.177 + 0.000823 h)^0.4,
 * L_w = h, L_u = h / (0.177 + 0.000823 h)^1.2 in feet, from 10 to 1000 ft. Spectra: along, first order; across and vertical,
 * (1 + sqrt(3) T s) / (1 + T s)^2, T being length over airspeed. */
static void dryden(const dl_sim_air_params *o, double dt, dl_sim_vehicle *v, double mean, double height, const double noise[DL_FLIGHT_NOISE],
                   double turbulence[3])
{
    const double h = clip(height / FOOT_M, 10.0, 1000.0), term = 0.177 + 0.000823 * h;
    const double sigma_w = 0.1 * mean_wind(o, 20.0 * FOOT_M), sigma_u = sigma_w / pow(term, 0.4);
    const double length_u = FOOT_M * h / pow(term, 1.2), length_w = FOOT_M * h;
    const double x = mean * o->along[0] - v->v[0], y = mean * o->along[1] - v->v[1];
    const double speed = clip(sqrt(x * x + y * y), 1.0, 1e3);
    double keep = exp(-dt * speed / length_u);
    const double fresh = sqrt(1.0 - keep * keep);
    v->air_u[0] = keep * v->air_u[0] + fresh * noise[0];
    lag_twice(v->air_v, keep, fresh, noise[1]);
    keep = exp(-dt * speed / length_w);
    lag_twice(v->air_w, keep, sqrt(1.0 - keep * keep), noise[2]);
    turbulence[0] = sigma_u * v->air_u[0];
    turbulence[1] = sigma_u * shaped(v->air_v);
    turbulence[2] = sigma_w * shaped(v->air_w);
}

/* Kaimal's spectrum along, across and up as two lags of one noise: times of the lags by height over airspeed, their weights for a
 * variance of 1, and sigma by friction velocity. */
static const struct {
    double time[2], weight[2], sigma;
} KAIMAL[3] = {
    {{5.348, 0.2939}, {0.80466, 0.33549}, 2.184},
    {{2.031, 0.1783}, {0.69280, 0.43652}, 1.638},
    {{0.4098, 0.05874}, {0.81591, 0.25102}, 1.236},
};

/* Source: Kaimal, Wyngaard, Izumi & Cote, Spectral characteristics of surface-layer turbulence, QJRMS 98 (1972): n S / u*^2 of the
 * frequency f = n z / U is 105 f / (1 + 33 f)^(5/3) along, 17 f / (1 + 9.5 f)^(5/3) across and 2.1 f / (1 + 5.3 f^(5/3)) up. The lags
 * are within 25 % of them from f = 0.005 to 3. Friction velocity of the logarithmic profile, with von Karman's constant 0.4. */
static void kaimal(const dl_sim_air_params *o, double dt, dl_sim_vehicle *v, double mean, double height, const double noise[DL_FLIGHT_NOISE],
                   double turbulence[3])
{
    const double friction = 0.4 * o->speed_m_s / o->log10m, x = mean * o->along[0] - v->v[0], y = mean * o->along[1] - v->v[1];
    const double passing_s = clip(height, LOWEST_M, 1e4) / clip(sqrt(x * x + y * y), 1.0, 1e3);
    double *states[3] = {v->air_u, v->air_v, v->air_w};
    for (int i = 0; i < 3; i++) {
        double sum = 0.0;
        for (int k = 0; k < 2; k++) {
            const double keep = exp(-dt / (KAIMAL[i].time[k] * passing_s));
            states[i][k] = keep * states[i][k] + sqrt(1.0 - keep * keep) * noise[i];
            sum += KAIMAL[i].weight[k] * states[i][k];
        }
        turbulence[i] = KAIMAL[i].sigma * friction * sum;
    }
}

static double rises(double x)
{
    return 1.0 / (1.0 + exp(-clip(x, -40.0, 40.0)));
}

/* The share of the wind that is missing `far` heights behind a solid fence, `z` heights over the ground.
 *
 * Source: Perera, Shelter behind two-dimensional solid and porous fences, J. Wind Eng. Ind. Aerodyn. 8 (1981), in the form of the
 * European Wind Atlas (Troen & Petersen 1989). The limit of the near wake is assumed. */
static double fence_deficit(double far, double z, double decay)
{
    const double eta = clip(z, 0.02, 50.0) * pow(decay * far, -0.47);
    return clip(9.75 / far * eta * exp(-0.67 * pow(eta, 1.5)), 0.0, DEFICIT_MAX);
}

/* The share of the wind past the ship that is missing behind the superstructure.
 *
 * Source: a fence's deficit, spread sideways as by Taylor & Salmon, J. Appl. Meteorology 32 (1993), for obstacles of finite width. The
 * spread sideways of a tenth of the distance is assumed. */
static double wake_deficit(const dl_sim_air_params *o, const relative *r, double ahead, double aside, double speed)
{
    const double cy = o->pad_yaw[0], sy = o->pad_yaw[1], ex = ahead / speed, ey = aside / speed;
    const double length = o->block_size[0], broad = o->block_size[1], h = o->block_size[2];
    const double x = cy * r->d[0] - sy * r->d[1] + o->block_m[0], y = sy * r->d[0] + cy * r->d[1] + o->block_m[1];
    const double along = x * ex + y * ey, across = y * ex - x * ey, size_x = fabs(ex), size_y = fabs(ey);
    const double half_width = 0.5 * (broad * size_x + length * size_y);
    const double behind = along - 0.5 * (length * size_x + broad * size_y);
    const double far = clip(behind / h, 0.5, 1e4), deficit = fence_deficit(far, -r->d[2] / h, o->wake_decay);
    const double width = 0.551 * (0.1 * h * far) + 0.02 * h;
    const double inside = rises((half_width - across) / width) * rises((half_width + across) / width);
    return deficit * inside * clip(behind / (0.5 * h), 0.0, 1.0);
}

/* The share that is missing over the deck because the air separates where it meets the hull's edge: that of a fence on the windward edge,
 * as high as the separated flow of a step of the freeboard's height (Sherry, Lo Jacono & Sheridan, An experimental investigation of the
 * recirculation zone formed downstream of a forward facing step, J. Wind Eng. Ind. Aerodyn. 98, 2010; 0.4 of the step assumed). */
static double hull_deficit(const dl_sim_air_params *o, const relative *r, double ahead, double aside, double speed)
{
    const double cy = o->pad_yaw[0], sy = o->pad_yaw[1], ex = ahead / speed, ey = aside / speed;
    const double x = cy * r->d[0] - sy * r->d[1], y = sy * r->d[0] + cy * r->d[1];
    const double from_x = ex > 0.0 ? x + o->deck_m[1] : o->deck_m[0] - x, from_y = ey > 0.0 ? y + o->deck_m[2] : o->deck_m[3] - y;
    const double behind = fmin(from_x / fmax(fabs(ex), 1e-6), from_y / fmax(fabs(ey), 1e-6)), h = o->edge_m;
    return fence_deficit(clip(behind / h, 0.5, 1e4), -r->d[2] / h, o->edge_decay) * clip(behind / (0.5 * h), 0.0, 1.0);
}

/* The wind with what superstructure and hull take from it and the eddies that they shed: added turbulence of 0.32 of the deficit, that
 * of a plane self-preserving wake (Pope, Turbulent Flows, 2000, 5.4), in eddies of half the height. */
static void wake(const dl_sim_air_params *o, double dt, dl_sim_vehicle *v, const dl_sim_deck *g, const relative *r, const double noise[DL_FLIGHT_NOISE],
                 double wind[3])
{
    /* The ship's own velocity is that of the deck, smoothed: waves do not move the wake. */
    for (int i = 0; i < 2; i++) {
        v->ship[i] = v->ship_known ? v->ship[i] : g->v[i];
        v->ship[i] += o->keep_ship * (g->v[i] - v->ship[i]);
    }
    v->ship_known = 1;
    const double past[3] = {wind[0] - v->ship[0], wind[1] - v->ship[1], 0.0};
    double on_deck[3];
    rotated_back(g->R, past, on_deck);
    const double ahead = o->pad_yaw[0] * on_deck[0] - o->pad_yaw[1] * on_deck[1];
    const double aside = o->pad_yaw[1] * on_deck[0] + o->pad_yaw[0] * on_deck[1];
    const double speed = clip(sqrt(ahead * ahead + aside * aside), 1e-3, 1e3);
    const double of_block = o->wake ? wake_deficit(o, r, ahead, aside, speed) : 0.0;
    const double of_hull = o->hull_wake ? hull_deficit(o, r, ahead, aside, speed) : 0.0;
    const double deficit = of_block + of_hull - of_block * of_hull, sigma = WAKE_TURBULENCE * deficit * speed;
    const double eddy_m = 0.5 * (o->wake && of_block >= of_hull ? o->block_size[2] : o->edge_m);
    const double keep = exp(-dt * speed / eddy_m), fresh = sqrt(1.0 - keep * keep);
    for (int i = 0; i < 3; i++) {
        v->eddy[i] = keep * v->eddy[i] + fresh * noise[3 + i];
        wind[i] += sigma * v->eddy[i] - deficit * past[i];
    }
}

/* The share of its speed that a gust has: "1 - cosine" up, some time at its full speed, and down again (MIL-F-8785C, 3.7.1.3). */
static double gust_share(const dl_sim_gust *o, double t_s)
{
    const double x = t_s - o->at_s, whole = 2.0 * o->rise_s + o->hold_s;
    if (x <= 0.0 || x >= whole) {
        return 0.0;
    }
    const double inside = fmin(fmin(x, fmax(whole - x, 0.0)), o->rise_s);
    return 0.5 * (1.0 - cos(acos(-1.0) * inside / o->rise_s));
}

void air_step(const dl_sim_air_params *o, double step_s, dl_sim_vehicle *v, const dl_sim_deck *g, const relative *r, double height,
              const double noise[DL_FLIGHT_NOISE])
{
    const double mean = mean_wind(o, height), c = o->along[0], s = o->along[1];
    double wind[3] = {mean * c, mean * s, 0.0};
    if (o->wake || o->hull_wake) {
        wake(o, step_s, v, g, r, noise, wind);
    }
    if (o->dryden || o->kaimal) {
        double turbulence[3];
        (o->dryden ? dryden : kaimal)(o, step_s, v, mean, height, noise, turbulence);
        wind[0] += c * turbulence[0] - s * turbulence[1];
        wind[1] += s * turbulence[0] + c * turbulence[1];
        wind[2] += turbulence[2];
    }
    for (int i = 0; i < o->gusts; i++) {
        const double share = gust_share(&o->gust[i], v->seconds);
        wind[0] += share * o->gust[i].v[0];
        wind[1] += share * o->gust[i].v[1];
    }
    for (int i = 0; i < 3; i++) {
        v->air[i] = wind[i];
    }
}
