/* The simulated vehicle, its contacts, its air and its sensors. */
#ifndef DECKLANDER_PHYSICS_H
#define DECKLANDER_PHYSICS_H

#include "decklander_sim.h"
#include "base/rotation.h"

/* Depth below the deck's plane beyond which a point is under the deck and not in contact. No fall reaches it in one step. */
#define DEEPEST_M 0.3

/* The body's motion relative to the deck, in the pad frame; R is R_pad_body. */
typedef struct {
    double d[3], v[3], R[9], w[3];
} relative;

static inline double clip(double x, double low, double high)
{
    return x < low ? low : x > high ? high : x;
}

static inline int motors_turn(const dl_sim_vehicle *v)
{
    return v->phase != DL_PHASE_LANDED && v->phase != DL_PHASE_EMERGENCY;
}

/* The motion of a body at p relative to the deck. */
void relative_to_deck(const dl_sim_deck *g, const double p[3], const double v[3], const double R[9], const double w[3], relative *r);
/* Whether a point of the pad's plane lies on the deck. */
int deck_holds(const dl_sim_vehicle_params *o, double x, double y);
/* The share of a disc about a point of the pad's plane that lies over the deck: exact along a straight edge; at a corner the
 * shares of the two edges are multiplied. */
double deck_coverage(const dl_sim_vehicle_params *o, double x, double y, double radius);
/* The force and the torque about the body's origin of the deck on the body over a step of dt, s, in the pad frame; returns the feet
 * in contact. */
int contact_force(const dl_sim_vehicle_params *o, double dt, const relative *r, double force[3], double torque[3]);
/* The acceleration in ned and the torque in body of a vehicle that lies `depth` deep in the water. */
void buoyancy(const dl_sim_vehicle_params *o, double depth, const double v[3], const double w[3], double sea_vz, double a[3],
              double torque[3]);
/* The thrust of each rotor; together they give this thrust and torque, with the least sum of squares. */
void rotor_thrusts(const dl_sim_vehicle_params *o, double thrust, const double torque[3], double each[DL_ROTORS_MAX]);
/* The thrust and torque that result when each rotor gives only its share of its command. */
void delivered(const dl_sim_vehicle_params *o, double *thrust, double torque[3], const double share[DL_ROTORS_MAX]);
/* The factor of the ground effect on thrust at a height of the body's origin over a surface. */
double ground_effect(const dl_sim_vehicle_params *o, double height);
/* The factor for each rotor by itself over a deck's edge. */
void ground_effect_by_rotor(const dl_sim_vehicle_params *o, const relative *r, double over_water, double factor[DL_ROTORS_MAX]);
/* Advance the air by one step; v->air becomes its velocity at the vehicle, in ned. */
void air_step(const dl_sim_air_params *o, double step_s, dl_sim_vehicle *v, const dl_sim_deck *g, const relative *r, double height,
              const double noise[DL_FLIGHT_NOISE]);
/* Advance the sensors by one step, after the vehicle's. */
void sensors_step(const dl_sim_vehicle_params *o, const dl_sim_vehicle *v, const dl_sim_sensor_params *e, dl_sim_sensors *s, const dl_sim_deck *g, double sea_z,
                  const double noise[DL_SENSOR_NOISE]);

#endif
