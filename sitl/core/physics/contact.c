/* Contact forces of a moving deck, and buoyancy in the water, for a vehicle that touches them. */

#include <math.h>

#include "base/rotation.h"
#include "physics/physics.h"

/* The mass of water that a vehicle's foam displaces is reached at this depth, m. */
static const double AFLOAT_M = 0.06;
/* Below this cosine of the tilt the upper corners may touch too. */
static const double ON_ITS_SIDE = 0.7;

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

/* The height of the thing that lies on the deck under a point. */
static double thing_under(const dl_sim_vehicle_params *o, double x, double y)
{
    const double *thing = o->effects.thing, ahead = x - thing[0], aside = y - thing[1];
    return thing[3] > 0.0 && ahead * ahead + aside * aside < thing[2] * thing[2] ? thing[3] : 0.0;
}

/* A spring and a damper act normal to the deck under each foot (and each upper corner of a body on its side), and friction acts
 * along the deck. The friction would stop the foot within a few steps, but is at most the coefficient times the normal force: it
 * neither chatters nor depends on a made-up slip speed. It cannot hold a body still on a slope for ever, so the vehicle ties a
 * resting body to the deck. */
int contact_force(const dl_sim_vehicle_params *o, const relative *r, double force[3], double torque[3])
{
    const int corners = r->R[8] < ON_ITS_SIDE ? 8 : 4;
    int touching = 0;
    for (int i = 0; i < 3; i++) {
        force[i] = torque[i] = 0.0;
    }
    for (int i = 0; i < corners; i++) {
        const double corner[3] = {i & 2 ? -o->foot_m : o->foot_m, i & 1 ? -o->foot_m : o->foot_m, i < 4 ? o->feet_below_m : -o->hull_top_m};
        double arm[3], slip[3], moment[3];
        rotated(r->R, corner, arm);
        const double deep = r->d[2] + arm[2] + thing_under(o, r->d[0] + arm[0], r->d[1] + arm[1]);
        if (!(deep > 0.0 && deep < DEEPEST_M && deck_holds(o, r->d[0] + arm[0], r->d[1] + arm[1]))) {
            continue;
        }
        cross(r->w, arm, slip);
        const double vx = r->v[0] + slip[0], vy = r->v[1] + slip[1], vz = r->v[2] + slip[2];
        const double normal = clip(o->foot_n_m * deep + o->foot_n_s_m * vz, 0.0, 1e6);
        const double speed = sqrt(vx * vx + vy * vy);
        const double grip = clip(o->foot_stop_kg_s * speed, 0.0, o->friction * normal) / clip(speed, 1e-9, 1e9);
        const double pushed[3] = {-grip * vx, -grip * vy, -normal};
        cross(arm, pushed, moment);
        for (int k = 0; k < 3; k++) {
            force[k] += pushed[k];
            torque[k] += moment[k];
        }
        touching++;
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
