/* The quadcopter: a rigid body under rotor thrust, drag, wind and contact, flown by an AR.Drone's inner loops.
 *
 * Source: body and gains are those of the thesis' simulator, hector_quadrotor (Meyer et al., Comprehensive simulation of quadrotor
 * UAVs using ROS and Gazebo, SIMPAR 2012).
 */

#include <math.h>
#include <string.h>

#include "physics/physics.h"

/* A stick this near to its middle requests no climb. */
static const double STICK_MIDDLE = 1e-3;
/* The vehicle stops climbing within this time, s, so that it holds the height where it will have come to a stop. */
static const double STOP_S = 0.3;
/* A contact after less time in the air belongs to the one before, s. */
static const double AIRBORNE_S = 0.3;
/* Below this height over the deck a foot may touch it, m. */
static const double CONTACT_M = 0.4;
enum { CONTACT_PARTS = 5 };

/* What one step works with besides parameters and state. */
typedef struct {
    const dl_sim_deck *g;
    relative r;
    double sea_z, sea_vz;
    double ahead[3], height;
    int over, wet, motors, touching;
    double tilt_cos;
    int64_t phase;
    const double *effect_noise;
} step;

static void quaternion_of_rpy(double roll, double pitch, double yaw, double q[4])
{
    const double cr = cos(0.5 * roll), sr = sin(0.5 * roll), cp = cos(0.5 * pitch), sp = sin(0.5 * pitch);
    const double cy = cos(0.5 * yaw), sy = sin(0.5 * yaw);
    q[0] = cr * cp * cy + sr * sp * sy;
    q[1] = sr * cp * cy - cr * sp * sy;
    q[2] = cr * sp * cy + sr * cp * sy;
    q[3] = cr * cp * sy - sr * sp * cy;
}

static void quaternion_of(const double R[9], double q[4])
{
    quaternion_of_rpy(atan2(R[7], R[8]), asin(clip(-R[6], -1.0, 1.0)), atan2(R[3], R[0]), q);
}

/* The Hamilton product: q_a_c from q_a_b and q_b_c. */
static void quaternion_product(const double p[4], const double q[4], double pq[4])
{
    pq[0] = p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3];
    pq[1] = p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2];
    pq[2] = p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1];
    pq[3] = p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0];
}

static void rotation_of(const double q[4], double R[9])
{
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    R[0] = 1.0 - 2.0 * (y * y + z * z), R[1] = 2.0 * (x * y - w * z), R[2] = 2.0 * (x * z + w * y);
    R[3] = 2.0 * (x * y + w * z), R[4] = 1.0 - 2.0 * (x * x + z * z), R[5] = 2.0 * (y * z - w * x);
    R[6] = 2.0 * (x * z - w * y), R[7] = 2.0 * (y * z + w * x), R[8] = 1.0 - 2.0 * (x * x + y * y);
}

/* Gusts, errors of the optical flow and of the drone's own attitude: first-order Gauss-Markov processes. */
static void disturb(const dl_sim_vehicle_params *o, dl_sim_vehicle *v, const double noise[DL_FLIGHT_NOISE])
{
    const double part[3] = {1.0, 1.0, 0.5};
    if (o->gust_sigma_m_s > 0.0) {
        for (int i = 0; i < 3; i++) {
            v->gust[i] = o->gust_keep * v->gust[i] + part[i] * o->gust_fresh * noise[i];
        }
    }
    for (int i = 0; i < 2; i++) {
        v->flow_error[i] = o->flow_keep * v->flow_error[i] + o->flow_fresh * noise[3 + i];
        v->tilt_drift[i] = o->tilt_keep * v->tilt_drift[i] + o->tilt_fresh * noise[5 + i];
    }
}

/* Errors by which the loops fly, turbulence of the own downwash, and the turning of the rotors. */
static void roughen(const dl_sim_vehicle_params *o, dl_sim_vehicle *v, const double noise[DL_EFFECT_NOISE])
{
    const dl_sim_effects *e = &o->effects;
    for (int i = 0; i < 3; i++) {
        v->rough[i] = e->downwash_keep * v->rough[i] + e->downwash_fresh * noise[i];
    }
    v->climb_error = e->climb_keep * v->climb_error + e->climb_fresh * noise[3];
    v->revolutions = fmod(v->revolutions + o->step_s * e->revolution_hz * sqrt(fmax(0.0, v->thrust_n / o->mass_kg / GRAVITY_M_S2)), 1.0);
}

/* The share of thrust that the battery leaves: the voltage falls with the load, and thrust goes with its square. */
static double sagging(const dl_sim_vehicle_params *o, const dl_sim_vehicle *v)
{
    const dl_sim_effects *e = &o->effects;
    const double voltage = (1.0 - e->sag * v->thrust_n / o->thrust_max_n) / (1.0 - e->sag * e->hover_share);
    return voltage * voltage;
}

/* The gain by the ground effect over a deck that moves: the wake needs time to follow, and a gap that closes pushes.
 *
 * Source: the inflow of a rotor over moving ground follows with a lag and with the ground's speed (Xin, Prasad & Peters, Dynamic inflow
 * modeling for simulation of a helicopter operating in ground effect, AIAA 99-4114, 1999). The lag of 0.1 s and the push, half of the gap's
 * speed by the induced one, fading over a radius, are assumed. */
static double cushioned(const dl_sim_vehicle_params *o, dl_sim_vehicle *v, const step *s, double gain)
{
    const dl_sim_effects *e = &o->effects;
    v->cushion = v->cushion > 0.0 ? v->cushion + e->cushion_share * (gain - v->cushion) : gain;
    const double closing = s->over ? clip(s->r.v[2], -3.0, 3.0) : 0.0;
    return v->cushion * (1.0 + 0.5 * closing / e->induced_m_s * exp(-clip(s->height, 0.0, 50.0) / o->effect_radius_m));
}

/* The turbulence of the own downwash, which the deck throws back: full below 0.5 m, none from 0.7 m on, half as strong upwards. */
static void stir(const dl_sim_vehicle_params *o, const dl_sim_vehicle *v, const step *s, double a[3])
{
    const double share = s->over && s->motors && v->contact_s <= 0.0 ? clip((0.7 - s->height) / 0.2, 0.0, 1.0) : 0.0;
    for (int i = 0; i < 3; i++) {
        a[i] += share * o->effects.downwash * (i < 2 ? 1.0 : 0.5) * v->rough[i];
    }
}

/* Put the newest stick command on its way and take the one that arrives. */
static void delay_command(const dl_sim_vehicle_params *o, dl_sim_vehicle *v, double command[5])
{
    memcpy(command, v->command, sizeof v->command);
    if (o->delay_steps == 0) {
        return;
    }
    double *place = v->pending + 5 * v->pending_at;
    memcpy(command, place, sizeof v->command);
    memcpy(place, v->command, sizeof v->command);
    v->pending_at = (v->pending_at + 1) % o->delay_steps;
}

/* The angular acceleration that the loops did not request.
 *
 * The loops know the torque that they requested, and the gyro says how the body turned. The difference is a disturbance. Added to
 * what the loops request, it acts as an integral that holds nothing while the vehicle follows its command: without a disturbance
 * the loops are those of the thesis' simulator.
 * Source: Smeur, Chu & de Croon, Adaptive incremental nonlinear dynamic inversion for attitude control of micro air vehicles,
 * Journal of Guidance, Control, and Dynamics 39(3), 2016, section III, whose increment of the torque is the same sum. */
static void observe_torque(const dl_sim_vehicle_params *o, dl_sim_vehicle *v)
{
    const double *I = o->inertia_kg_m2, *w = v->unasked_w;
    const double gyroscopic[3] = {(I[2] - I[1]) * w[1] * w[2], (I[0] - I[2]) * w[2] * w[0], (I[1] - I[0]) * w[0] * w[1]};
    const double share = motors_turn(v) && v->contact_s <= 0.0 ? o->observer_share : 0.0;
    for (int i = 0; i < 3; i++) {
        const double unasked = (v->w[i] - w[i]) / o->step_s - (v->torque_n_m[i] - gyroscopic[i]) / I[i], was = v->unasked[i];
        v->unasked[i] = clip(was + share * (unasked - was), -o->unasked_max_rad_s2[i], o->unasked_max_rad_s2[i]);
    }
    memcpy(v->unasked_w, v->w, sizeof v->w);
}

/* The velocity past what the optical flow looks at: past the point of the deck straight below, or past the water.
 * A deck that only tilts carries that point along by its arm on the deck, not by the height of the drone above it. */
static void velocity_past(const dl_sim_vehicle_params *o, const dl_sim_vehicle *v, const step *s, double seen[2])
{
    seen[0] = v->v[0] - o->current[0], seen[1] = v->v[1] - o->current[1];
    if (!s->over || !o->flow_sees_deck) {
        return;
    }
    const double *R = s->g->R, *d = s->r.d, above = d[2] / R[8];
    const double below[3] = {d[0] - above * R[6], d[1] - above * R[7], 0.0};
    double turning[3], carried[3];
    cross(s->g->w, below, turning);
    rotated(R, turning, carried);
    for (int i = 0; i < 2; i++) {
        seen[i] = v->v[i] - s->g->v[i] - carried[i];
    }
}

/* The velocity that the drone itself estimates, by its optical flow against the deck or the water. */
static void measure_flow(const dl_sim_vehicle_params *o, dl_sim_vehicle *v, const step *s, double cos_psi, double sin_psi)
{
    if (!o->flow_works) {
        v->flow[0] = v->flow[1] = 0.0;
        return;
    }
    double seen[2];
    velocity_past(o, v, s, seen);
    const double ahead = o->flow_scale * (cos_psi * seen[0] + sin_psi * seen[1]) + v->flow_error[0];
    const double aside = o->flow_scale * (cos_psi * seen[1] - sin_psi * seen[0]) + v->flow_error[1];
    v->flow[0] += o->flow_lag * (ahead - v->flow[0]);
    v->flow[1] += o->flow_lag * (aside - v->flow[1]);
}

/* Roll, pitch and yaw rate requested: the stick's, or those that hold the vehicle by its optical flow. */
static void asked_attitude(const dl_sim_vehicle_params *o, dl_sim_vehicle *v, const double command[5], double cos_psi, double sin_psi,
                           double asked[3])
{
    const int flying = v->phase == DL_PHASE_FLYING;
    const double forward = cos_psi * v->a[0] + sin_psi * v->a[1], right = cos_psi * v->a[1] - sin_psi * v->a[0];
    const double gain = flying || v->contact_s > 0.0 ? 0.0 : o->velocity_i * o->step_s, top = o->velocity_i_max_m_s2;
    v->integral[0] = clip(v->integral[0] - gain * v->flow[0], -top, top);
    v->integral[1] = clip(v->integral[1] - gain * v->flow[1], -top, top);
    if (flying) {
        const double tilt = o->euler_angle_max_rad < o->tilt_max_rad ? o->euler_angle_max_rad : o->tilt_max_rad;
        asked[0] = command[0] * tilt * o->effects.tilt_gain;
        asked[1] = command[1] * tilt * o->effects.tilt_gain;
        asked[2] = command[3] * o->yaw_rate_max_rad_s;
        return;
    }
    const double hold_x = -o->velocity_p * v->flow[0] - o->velocity_d * forward + v->integral[0];
    const double hold_y = -o->velocity_p * v->flow[1] - o->velocity_d * right + v->integral[1];
    asked[0] = clip(hold_y / GRAVITY_M_S2, -o->tilt_max_rad, o->tilt_max_rad);
    asked[1] = clip(-hold_x / GRAVITY_M_S2, -o->tilt_max_rad, o->tilt_max_rad);
    asked[2] = 0.0;
}

/* Attitude to torque: P and D on roll and pitch, P on the yaw rate, less what the observer found. */
static void attitude_loop(const dl_sim_vehicle_params *o, dl_sim_vehicle *v, const double command[5], const step *s, double torque[3])
{
    const double sigma = o->effects.on ? o->effects.rate_sigma : 0.0, *noise = s->effect_noise + 4;
    double w[3];
    for (int i = 0; i < 3; i++) {
        w[i] = sigma > 0.0 ? v->w[i] + sigma * noise[i] : v->w[i];
    }
    const double *R = v->R, c = clip(sqrt(R[0] * R[0] + R[3] * R[3]), 1e-6, 1.0), cos_psi = R[0] / c, sin_psi = R[3] / c;
    const double phi = atan2(R[7], R[8]) + (v->tilt_bias[0] + v->tilt_drift[0]);
    const double theta = atan2(-R[6], c) + (v->tilt_bias[1] + v->tilt_drift[1]);
    double asked[3];
    measure_flow(o, v, s, cos_psi, sin_psi);
    asked_attitude(o, v, command, cos_psi, sin_psi, asked);
    observe_torque(o, v);
    const double turn[3] = {
        o->tilt_p * (asked[0] - phi) - o->tilt_d * w[0] - v->unasked[0],
        o->tilt_p * (asked[1] - theta) - o->tilt_d * w[1] - v->unasked[1],
        o->yaw_rate_p * (asked[2] - w[2]) - v->unasked[2],
    };
    for (int i = 0; i < 3; i++) {
        torque[i] = clip(o->inertia_kg_m2[i] * turn[i], -o->torque_max_n_m[i], o->torque_max_n_m[i]);
    }
}

/* Climb rate to thrust: the stick's, the one that holds the height, or that of take-off and landing. */
static double climb_loop(const dl_sim_vehicle_params *o, dl_sim_vehicle *v, const double command[5])
{
    const double z = v->p[2], vz = v->v[2] + v->climb_error, gaz = command[2];
    const int flying = v->phase == DL_PHASE_FLYING;
    const int holding = v->phase == DL_PHASE_HOVERING || (flying && gaz < STICK_MIDDLE && gaz > -STICK_MIDDLE);
    v->z_hold = holding ? v->z_hold : z + STOP_S * vz;
    double down = v->phase == DL_PHASE_LANDING ? o->landing_speed_m_s : -o->take_off_speed_m_s;
    if (holding) {
        down = clip(o->height_p * (v->z_hold - z), -o->vz_max_m_s, o->vz_max_m_s);
    } else if (flying) {
        down = -gaz * o->vz_max_m_s;
    }
    const double e = down - vz, gain = v->contact_s > 0.0 || v->phase == DL_PHASE_LANDED ? 0.0 : o->climb_i * o->step_s;
    v->integral[2] = clip(v->integral[2] + gain * e, -o->climb_i_max_m_s2, o->climb_i_max_m_s2);
    const double acceleration = o->climb_p * e - o->climb_d * v->a[2] + v->integral[2];
    return clip(o->effects.loop_mass_kg * (GRAVITY_M_S2 - acceleration) / clip(v->R[8], 0.5, 1.0), 0.0, o->thrust_max_n);
}

/* What reaches the body of the motors' thrust and torque where the unkind effects act. */
static void drive_unkindly(const dl_sim_vehicle_params *o, dl_sim_vehicle *v, const step *s, double *lift, double turn[3])
{
    const dl_sim_effects *e = &o->effects;
    const double sag = e->lift_share * (e->sag > 0.0 ? sagging(o, v) : 1.0), asked = *lift;
    double share[DL_ROTORS_MAX], free[DL_ROTORS_MAX], plain = asked, aside[3] = {turn[0], turn[1], turn[2]};
    for (int i = 0; i < o->rotors; i++) {
        free[i] = share[i] = sag * o->rotor_health[i];
    }
    if (o->effect_by_rotor) {
        double factor[DL_ROTORS_MAX];
        ground_effect_by_rotor(o, &s->r, s->sea_z - s->ahead[2], factor);
        for (int i = 0; i < o->rotors; i++) {
            share[i] *= factor[i];
        }
        delivered(o, &plain, aside, free);
        delivered(o, lift, turn, share);
    } else {
        if (e->saturates || !o->all_healthy) {
            delivered(o, lift, turn, share);
        } else {
            *lift *= sag;
        }
        plain = *lift;
        *lift *= ground_effect(o, s->height);
    }
    if (e->moving_deck && plain > 1e-3) {
        *lift = plain * cushioned(o, v, s, *lift / plain);
    }
}

/* Thrust and torque follow their commands with the motors' lag, and reach the body through weak rotors and the ground effect. */
static void drive(const dl_sim_vehicle_params *o, dl_sim_vehicle *v, const double command[5], const step *s, double *lift, double turn[3])
{
    double thrust = v->driven_n, torque[3] = {v->driven_n_m[0], v->driven_n_m[1], v->driven_n_m[2]}, share[DL_ROTORS_MAX];
    if (!o->motor_driven) {
        attitude_loop(o, v, command, s, torque);
        thrust = climb_loop(o, v, command);
    }
    v->thrust_n += o->motor_lag * ((s->motors ? thrust : 0.0) - v->thrust_n);
    for (int i = 0; i < 3; i++) {
        v->torque_n_m[i] += o->motor_lag * ((s->motors ? torque[i] : 0.0) - v->torque_n_m[i]);
        turn[i] = v->torque_n_m[i];
    }
    const dl_sim_effects *e = &o->effects;
    *lift = v->thrust_n;
    if (e->on) {
        drive_unkindly(o, v, s, lift, turn);
        return;
    }
    if (o->effect_by_rotor) {
        ground_effect_by_rotor(o, &s->r, s->sea_z - s->ahead[2], share);
        for (int i = 0; i < o->rotors; i++) {
            share[i] *= o->rotor_health[i];
        }
        delivered(o, lift, turn, share);
        return;
    }
    if (!o->all_healthy) {
        delivered(o, lift, turn, o->rotor_health);
    }
    *lift *= ground_effect(o, s->height);
}

/* The acceleration in ned by rotors, air and weight. */
static void accelerate(const dl_sim_vehicle_params *o, const dl_sim_vehicle *v, double lift, double a[3])
{
    double past[3], body[3];
    for (int i = 0; i < 3; i++) {
        past[i] = v->v[i] - v->gust[i] - o->extra_wind[i] - v->air[i];
    }
    rotated_back(v->R, past, body);
    const double quadratic = o->effects.drag_per_m > 0.0 ? o->effects.drag_per_m * sqrt(dot(past, past)) : 0.0;
    /* A rotor's drag goes with its speed, and that with the root of its thrust: what stands with its motors off has none. */
    const double spin = o->effects.rotor_drag ? sqrt(clip(v->thrust_n / (o->mass_kg * GRAVITY_M_S2), 0.0, 4.0)) : 1.0;
    for (int i = 0; i < 3; i++) {
        body[i] *= -(o->drag_per_s[i] * spin + quadratic);
    }
    body[2] -= lift / o->mass_kg;
    rotated(v->R, body, a);
    a[2] += GRAVITY_M_S2;
}

/* What the water adds to acceleration and torque. */
static void swim(const dl_sim_vehicle_params *o, const dl_sim_vehicle *v, step *s, double a[3], double turn[3])
{
    const double depth = s->ahead[2] + o->feet_below_m - s->sea_z;
    double push[3], moment[3];
    s->wet = !s->over && depth > 0.0;
    if (s->wet) {
        buoyancy(o, depth, v->v, v->w, s->sea_vz, push, moment);
        for (int i = 0; i < 3; i++) {
            a[i] += push[i];
            turn[i] += moment[i];
        }
    }
}

/* Newton and Euler over a time of dt, s. */
static void integrate(const dl_sim_vehicle_params *o, dl_sim_vehicle *v, double dt, const double a[3], const double turn[3])
{
    const double h = 0.5 * dt, *I = o->inertia_kg_m2, *w = v->w;
    const double rate[3] = {
        w[0] + dt / I[0] * (turn[0] - (I[2] - I[1]) * w[1] * w[2]),
        w[1] + dt / I[1] * (turn[1] - (I[0] - I[2]) * w[2] * w[0]),
        w[2] + dt / I[2] * (turn[2] - (I[1] - I[0]) * w[0] * w[1]),
    };
    for (int i = 0; i < 3; i++) {
        const double after = v->v[i] + dt * a[i];
        v->p[i] += h * (v->v[i] + after);
        v->v[i] = after;
        v->w[i] = rate[i];
    }
    const double size = sqrt(dot(rate, rate)) + 1e-12, k = sin(h * size) / size;
    const double by[4] = {cos(h * size), k * rate[0], k * rate[1], k * rate[2]};
    double q[4];
    quaternion_product(v->q, by, q);
    const double unit = 1.0 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int i = 0; i < 4; i++) {
        v->q[i] = q[i] * unit;
    }
    rotation_of(v->q, v->R);
}

/* Move the body. Feet are stiff: near the deck it moves in CONTACT_PARTS of a step, over which all forces but theirs are the same. */
static void move(const dl_sim_vehicle_params *o, dl_sim_vehicle *v, step *s, const double a[3], const double turn[3])
{
    const int near = s->over && s->height < CONTACT_M, parts = near ? CONTACT_PARTS : 1;
    const double dt = o->step_s / parts;
    for (int left = parts - 1; left >= 0; left--) {
        double force[3], torque[3], push[3] = {0.0, 0.0, 0.0}, moment[3] = {0.0, 0.0, 0.0}, ahead[3];
        if (near) {
            relative r;
            for (int i = 0; i < 3; i++) {
                ahead[i] = v->p[i] + dt * v->v[i] + left * dt * s->g->v[i];
            }
            relative_to_deck(s->g, ahead, v->v, v->R, v->w, &r);
            const int touching = contact_force(o, dt, &r, force, torque);
            s->touching = touching > s->touching ? touching : s->touching;
            rotated(s->g->R, force, push);
            rotated_back(r.R, torque, moment);
        }
        for (int i = 0; i < 3; i++) {
            push[i] = a[i] + push[i] / o->mass_kg;
            moment[i] += turn[i];
        }
        integrate(o, v, dt, push, moment);
    }
}


void dl_sim_vehicle_carry(dl_sim_vehicle *v, const dl_sim_deck *g)
{
    const double *w = g->w, *d = v->attached_d;
    const double turned[3] = {w[1] * d[2] - w[2] * d[1], w[2] * d[0] - w[0] * d[2], w[0] * d[1] - w[1] * d[0]};
    double arm[3], past[3], q[4], R[9];
    rotated(g->R, d, arm);
    rotated(g->R, turned, past);
    for (int i = 0; i < 3; i++) {
        v->p[i] = g->p[i] + arm[i];
        v->v[i] = g->v[i] + past[i];
    }
    quaternion_of(g->R, q);
    quaternion_product(q, v->attached_q, v->q);
    rotation_of(v->q, v->R);
    rotation_of(v->attached_q, R);
    rotated_back(R, g->w, v->w);
}

/* Untie what the deck throws off; tie what lies still with its motors off to the deck. */
static void rest(const dl_sim_vehicle_params *o, dl_sim_vehicle *v, const step *s)
{
    const relative *r = &s->r;
    if (v->tied) {
        const double felt[3] = {v->a[0], v->a[1], v->a[2] - GRAVITY_M_S2};
        double f[3];
        rotated_back(s->g->R, felt, f);
        const double grip = o->friction * clip(-f[2], 0.0, 1e3);
        v->tied = !(f[0] * f[0] + f[1] * f[1] > grip * grip);
    }
    const int still = dot(r->v, r->v) < 9e-4 && dot(r->w, r->w) < 0.04;
    if (still && !s->motors && s->touching >= 3 && !v->tied) {
        const double to[3] = {v->p[0] - s->g->p[0], v->p[1] - s->g->p[1], v->p[2] - s->g->p[2]};
        double q[4];
        rotated_back(s->g->R, to, v->attached_d);
        quaternion_of(s->g->R, q);
        const double back[4] = {q[0], -q[1], -q[2], -q[3]};
        quaternion_product(back, v->q, v->attached_q);
        v->tied = 1;
    }
}

/* The record of a contact after flight. */
static void record_contact(dl_sim_vehicle *v, const step *s)
{
    v->touched_what = s->wet ? DL_TOUCHED_SEA : DL_TOUCHED_DECK;
    v->touched_phase = s->phase;
    v->touched_s = v->seconds;
    memcpy(v->touched_d, s->r.d, sizeof v->touched_d);
    memcpy(v->touched_v, s->r.v, sizeof v->touched_v);
    memcpy(v->touched_R, s->r.R, sizeof v->touched_R);
    memcpy(v->touched_w, s->r.w, sizeof v->touched_w);
}

/* Timers, record of the contact, resting, changes of phase. */
static void conclude(const dl_sim_vehicle_params *o, dl_sim_vehicle *v, const step *s)
{
    const double dt = o->step_s;
    const int supported = s->touching > 0 || v->tied;
    if (supported || s->wet) {
        if (v->airborne_s > AIRBORNE_S) {
            record_contact(v, s);
        }
        rest(o, v, s);
        v->ditched = v->ditched || s->wet;
    }
    v->airborne_s = supported || s->wet ? 0.0 : v->airborne_s + dt;
    v->contact_s = supported ? v->contact_s + dt : clip(v->contact_s - dt, 0.0, o->motors_off_after_s);
    if (v->phase == DL_PHASE_LANDING && v->contact_s > o->motors_off_after_s) {
        v->phase = DL_PHASE_LANDED;
    }
    if (v->phase == DL_PHASE_TAKING_OFF && s->height > 0.9 * o->take_off_height_m) {
        v->phase = DL_PHASE_HOVERING;
    }
    if (s->wet || (s->tilt_cos < o->tilt_cut_off_cos && s->motors)) {
        v->phase = DL_PHASE_EMERGENCY;
    }
}

static void begin(const dl_sim_vehicle_params *o, dl_sim_vehicle *v, step *s, double command[5])
{
    for (int i = 0; i < 3; i++) {
        s->ahead[i] = v->p[i] + o->step_s * v->v[i];
    }
    relative_to_deck(s->g, s->ahead, v->v, v->R, v->w, &s->r);
    s->over = deck_holds(o, s->r.d[0], s->r.d[1]) && s->r.d[2] < DEEPEST_M;
    s->height = s->over ? -s->r.d[2] : s->sea_z - s->ahead[2];
    s->tilt_cos = v->R[8];
    delay_command(o, v, command);
    if (v->phase == DL_PHASE_HOVERING || v->phase == DL_PHASE_FLYING) {
        v->phase = command[4] != 0.0 ? DL_PHASE_FLYING : DL_PHASE_HOVERING;
    }
    s->motors = motors_turn(v);
    v->tied = v->tied && !s->motors;
}

void dl_sim_vehicle_step(const dl_sim_vehicle_params *o, dl_sim_vehicle *v, const dl_sim_deck *g, double sea_z, double sea_vz, const double *noise,
                  const double *air_noise, const double *effect_noise)
{
    step s = {.g = g, .sea_z = sea_z, .sea_vz = sea_vz, .phase = v->phase, .effect_noise = effect_noise};
    double command[5], lift, turn[3], a[3], before[3];
    v->seconds += o->step_s;
    disturb(o, v, noise);
    if (o->effects.on) {
        roughen(o, v, effect_noise);
    }
    begin(o, v, &s, command);
    drive(o, v, command, &s, &lift, turn);
    if (o->air.on) {
        air_step(&o->air, o->step_s, v, g, &s.r, sea_z - s.ahead[2], air_noise);
    } else {
        memcpy(v->air, o->wind, sizeof v->air);
    }
    accelerate(o, v, lift, a);
    if (o->effects.on) {
        stir(o, v, &s, a);
    }
    swim(o, v, &s, a, turn);
    memcpy(before, v->v, sizeof before);
    if (v->tied) {
        dl_sim_vehicle_carry(v, g);
    } else {
        move(o, v, &s, a, turn);
    }
    for (int i = 0; i < 3; i++) {
        v->a[i] = 1.0 / o->step_s * (v->v[i] - before[i]);
    }
    conclude(o, v, &s);
}
