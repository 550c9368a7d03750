/* Contact forces of a moving deck, and buoyancy in the water, for a vehicle that touches them. */

#include <math.h>

#include "base/rotation.h"
#include "physics/physics.h"

/* The mass of water that a vehicle's foam displaces is reached at this depth, m. */
static const double AFLOAT_M = 0.06;
/* Below this cosine of the tilt the upper corners may touch too. */
static const double ON_ITS_SIDE = 0.7;
/* The share of a foot's slip that friction, within its limit, stops in a step. */
static const double STOPS = 0.3;
static const double UP[3] = {0.0, 0.0, -1.0}; /* Upwards in ned. */

void relative_to_deck(const dl_sim_deck *g, const double p[3], const double v[3], const double R[9], const double w[3], relative *r)
{
    const double to[3] = {p[0] - g->p[0], p[1] - g->p[1], p[2] - g->p[2]};
    const double past[3] = {v[0] - g->v[0], v[1] - g->v[1], v[2] - g->v[2]};
    double carried[3], turned[3];
    rotated_back(g->R, to, r->d);
    rotated_back(g->R, past, r->v);
    cross(g->w, r->d, carried);
    product_of_transposed(g->R, R, r->R);
    rotated(r->R, w, turned);
    for (int i = 0; i < 3; i++) {
        r->v[i] -= carried[i];
        r->w[i] = turned[i] - g->w[i];
    }
}

/* Where the fore end of the deck is at a distance from its middle line, as a share of its half width; or where its taper begins, if
 * nothing from `along` on reaches that. */
static double fore_end(const dl_sim_vehicle_params *o, double share, double along)
{
    const double straight = o->deck_fore_m - o->deck_taper_m;
    return along > straight ? o->deck_fore_m - o->deck_taper_m * pow(share * share, 1.1) : straight;
}

int deck_holds(const dl_sim_vehicle_params *o, double x, double y)
{
    const double along = o->deck_yaw[0] * x - o->deck_yaw[1] * y;
    const double across = o->deck_yaw[1] * x + o->deck_yaw[0] * y - o->deck_middle_m;
    const int inside = along >= -o->deck_aft_m && along <= o->deck_fore_m && across <= o->deck_half_m && across >= -o->deck_half_m;
    return inside && along <= fore_end(o, across / o->deck_half_m, along);
}

double deck_coverage(const dl_sim_vehicle_params *o, double x, double y, double radius)
{
    const double along = o->deck_yaw[0] * x - o->deck_yaw[1] * y;
    const double across = o->deck_yaw[1] * x + o->deck_yaw[0] * y - o->deck_middle_m;
    const double fore = fore_end(o, clip(across / o->deck_half_m, -1.0, 1.0), along + radius);
    const double inside[4] = {fore - along, along + o->deck_aft_m, o->deck_half_m - across, o->deck_half_m + across};
    const double pi = acos(-1.0);
    double share = 1.0;
    for (int i = 0; i < 4; i++) {
        const double d = clip(inside[i] / radius, -1.0, 1.0);
        if (d < 1.0) {
            share *= 0.5 + (d * sqrt(1.0 - d * d) + asin(d)) / pi;
        }
    }
    return share;
}

/* Press a point that moves at v out of a surface into which it is `deep`, m, along the surface's normal: a spring, a damper, and
 * friction along the surface. The friction would stop the point within a few steps of dt, but is at most the coefficient times the
 * normal force: it neither chatters nor depends on a made-up slip speed. It cannot hold a body still on a slope for ever, so the
 * vehicle ties a resting body to the deck. */
static void press(const dl_sim_vehicle_params *o, double dt, double deep, const double normal[3], const double v[3], double pushed[3])
{
    const double away = dot(v, normal), slip[3] = {v[0] - away * normal[0], v[1] - away * normal[1], v[2] - away * normal[2]};
    const double size = clip(o->foot_n_m * deep - o->foot_n_s_m * away, 0.0, 1e6), speed = sqrt(dot(slip, slip));
    const double grip = clip(STOPS * o->mass_kg / (4.0 * dt) * speed, 0.0, o->friction * size) / clip(speed, 1e-9, 1e9);
    for (int i = 0; i < 3; i++) {
        pushed[i] += size * normal[i] - grip * slip[i];
    }
}

/* The thing that lies on the deck presses a point out of its top or its side, whichever is nearer. */
static int press_from_thing(const dl_sim_vehicle_params *o, double dt, const double at[3], const double v[3], double pushed[3])
{
    const double *thing = o->effects.thing, out[3] = {at[0] - thing[0], at[1] - thing[1], 0.0}, far = sqrt(dot(out, out));
    const double below_top = at[2] + thing[3], inside = thing[2] - far;
    if (!(thing[3] > 0.0 && below_top > 0.0 && inside > 0.0)) {
        return 0;
    }
    const int by_side = inside < below_top && far > 0.0;
    const double side[3] = {out[0] / far, out[1] / far, 0.0};
    press(o, dt, by_side ? inside : below_top, by_side ? side : UP, v, pushed);
    return 1;
}

int contact_force(const dl_sim_vehicle_params *o, double dt, const relative *r, double force[3], double torque[3])
{
    const int corners = r->R[8] < ON_ITS_SIDE ? 8 : 4;
    int touching = 0;
    for (int i = 0; i < 3; i++) {
        force[i] = torque[i] = 0.0;
    }
    for (int i = 0; i < corners; i++) {
        const double corner[3] = {i & 2 ? -o->foot_m : o->foot_m, i & 1 ? -o->foot_m : o->foot_m, i < 4 ? o->feet_below_m : -o->hull_top_m};
        double at[3], v[3], arm[3], moment[3], pushed[3] = {0.0, 0.0, 0.0};
        rotated(r->R, corner, arm);
        cross(r->w, arm, v);
        for (int k = 0; k < 3; k++) {
            at[k] = r->d[k] + arm[k];
            v[k] += r->v[k];
        }
        if (!(at[2] < DEEPEST_M && deck_holds(o, at[0], at[1]))) {
            continue;
        }
        int touches = press_from_thing(o, dt, at, v, pushed);
        if (at[2] > 0.0) {
            press(o, dt, at[2], UP, v, pushed);
            touches = 1;
        }
        cross(arm, pushed, moment);
        for (int k = 0; k < 3; k++) {
            force[k] += pushed[k];
            torque[k] += moment[k];
        }
        touching += touches;
    }
    return touching;
}

/* The vehicle is full of foam, so it is buoyant, and it is heavily damped. */
void buoyancy(const dl_sim_vehicle_params *o, double depth, const double v[3], const double w[3], double sea_vz, double a[3],
              double torque[3])
{
    const double up = clip(depth / AFLOAT_M, 0.0, 3.0) * GRAVITY_M_S2;
    a[0] = -6.0 * v[0];
    a[1] = -6.0 * v[1];
    a[2] = -up - 12.0 * (v[2] - sea_vz);
    for (int i = 0; i < 3; i++) {
        torque[i] = -8.0 * o->inertia_kg_m2[i] * w[i];
    }
}
