/* The rotors: the allocation of thrust and torque, the loss by a weak one, and the ground effect. */

#include <math.h>

#include "base/rotation.h"
#include "physics/physics.h"

static void quad_thrusts(const dl_sim_vehicle_params *o, double thrust, const double torque[3], double each[DL_ROTORS_MAX])
{
    const double t = 0.25 * thrust, x = torque[0] / (4.0 * o->arm_m), y = torque[1] / (4.0 * o->arm_m);
    const double z = torque[2] / (4.0 * o->yaw_torque_per_thrust_m);
    each[0] = t + x + y + z;
    each[1] = t - x + y - z;
    each[2] = t - x - y + z;
    each[3] = t + x - y - z;
}

void rotor_thrusts(const dl_sim_vehicle_params *o, double thrust, const double torque[3], double each[DL_ROTORS_MAX])
{
    if (o->quad_x) {
        quad_thrusts(o, thrust, torque, each);
        return;
    }
    const double n = (double)o->rotors, t = thrust / n;
    const double x = torque[0] / (o->rotor_squares[1] * o->arm_m), y = torque[1] / (o->rotor_squares[0] * o->arm_m);
    const double z = torque[2] / (n * o->yaw_torque_per_thrust_m);
    for (int i = 0; i < o->rotors; i++) {
        each[i] = t - o->rotor_right[i] * x + o->rotor_forward[i] * y + o->rotor_spin[i] * z;
    }
}

/* No rotor is driven harder than to its part of the largest thrust, and none pushes downwards. */
void delivered(const dl_sim_vehicle_params *o, double *thrust, double torque[3], const double share[DL_ROTORS_MAX])
{
    const double most = o->thrust_max_n / (double)o->rotors;
    double each[DL_ROTORS_MAX], lift = 0.0, x = 0.0, y = 0.0, z = 0.0;
    rotor_thrusts(o, *thrust, torque, each);
    for (int i = 0; i < o->rotors; i++) {
        const double t = share[i] * clip(each[i], 0.0, most);
        lift += t;
        x -= o->rotor_right[i] * t;
        y += o->rotor_forward[i] * t;
        z += o->rotor_spin[i] * t;
    }
    *thrust = lift;
    torque[0] = o->arm_m * x;
    torque[1] = o->arm_m * y;
    torque[2] = o->yaw_torque_per_thrust_m * z;
}

/* Source: Cheeseman & Bennett, The effect of the ground on a helicopter rotor in forward flight, ARC R&M 3021, 1955:
 * T/T_free = 1 / (1 - (R/4z)^2); R is the radius of one disc with the area of all rotors. It overstates close to the ground:
 * below z = 0.7 R the gain is held at 15 % (assumed). */
double ground_effect(const dl_sim_vehicle_params *o, double height)
{
    const double radius = o->effect_radius_m;
    const double ratio = 0.25 * radius / clip(height + o->rotors_above_m, 0.7 * radius, 1e9);
    return 1.0 / (1.0 - ratio * ratio);
}

/* The part of a rotor's disc over the deck feels the deck, the rest the water: a vehicle that comes in over the deck's edge is
 * lifted and tilted by degrees. The weighting by area is assumed. */
void ground_effect_by_rotor(const dl_sim_vehicle_params *o, const relative *r, double over_water, double factor[DL_ROTORS_MAX])
{
    const double water = ground_effect(o, over_water);
    for (int i = 0; i < o->rotors; i++) {
        const double axis[3] = {o->arm_m * o->rotor_forward[i], o->arm_m * o->rotor_right[i], 0.0};
        double arm[3];
        rotated(r->R, axis, arm);
        const double height = -(r->d[2] + arm[2]);
        factor[i] = water;
        if (height > -o->rotors_above_m) {
            const double share = deck_coverage(o, r->d[0] + arm[0], r->d[1] + arm[1], o->rotor_radius_m);
            factor[i] += share * (ground_effect(o, height) - water);
        }
    }
}
