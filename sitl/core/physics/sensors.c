/* The vehicle's sensors, with the errors measured on a real AR.Drone 2.0 (provenance: `sitl.scenario.scenario.SensorSettings`). */

#include <math.h>
#include <string.h>

#include "physics/physics.h"

/* Tesla north, east, down at Trondheim: 52 uT, 75 degrees dip, 4 degrees of declination, to the percent. */
static const double EARTH_FIELD_NED_T[3] = {1.36e-5, 0.9e-6, 5.0e-5};
static const double SEA_LEVEL_PA = 101325.0; /* Air pressure at sea level, Pa (ICAO standard atmosphere). */
/* PWM in hover out of 255, as recorded in flight with a battery at half charge. */
static const double HOVER_PWM = 170.0;
/* Vibration is felt at the second harmonic of the blades of a two-bladed rotor, over half of any rate of samples. */
static const double HARMONIC = 4.0;
static const double ROTOR_TURN = 6.283185307179586; /* A rotor's turn, rad. */

/* The distance along a ray (unit, in ned) to the deck or else to the water; infinite where it meets neither. */
static double reach(const dl_sim_vehicle_params *o, const dl_sim_deck *g, const double d[3], double above_water, const double ray[3])
{
    double u[3];
    rotated_back(g->R, ray, u);
    if (u[2] > 1e-6 && d[2] < 0.0) {
        const double t = -d[2] / u[2];
        if (deck_holds(o, d[0] + t * u[0], d[1] + t * u[1])) {
            return t;
        }
    }
    return ray[2] > 1e-6 && above_water > 0.0 ? above_water / ray[2] : INFINITY;
}

/* The distance from the body's origin to the nearest surface within a cone about the body's down axis: nine rays as in the thesis'
 * simulator, and the plumb lines of water and deck where they lie in the cone. */
static double nearest_surface(const dl_sim_vehicle_params *o, const dl_sim_vehicle *v, const dl_sim_deck *g, double sea_z, double cone_rad)
{
    const double to[3] = {v->p[0] - g->p[0], v->p[1] - g->p[1], v->p[2] - g->p[2]}, above_water = sea_z - v->p[2];
    const double spread[3] = {tan(-0.5 * cone_rad), 0.0, tan(0.5 * cone_rad)};
    const double down[3] = {v->R[2], v->R[5], v->R[8]};
    const double plumbs[2][3] = {{0.0, 0.0, 1.0}, {g->R[2], g->R[5], g->R[8]}};
    double d[3], best = INFINITY;
    rotated_back(g->R, to, d);
    for (int i = 0; i < 9; i++) {
        const double ray[3] = {spread[i / 3], spread[i % 3], 1.0};
        double ned[3];
        rotated(v->R, ray, ned);
        const double length = sqrt(dot(ned, ned));
        for (int k = 0; k < 3; k++) {
            ned[k] /= length;
        }
        best = fmin(best, reach(o, g, d, above_water, ned));
    }
    for (int i = 0; i < 2; i++) {
        if (dot(plumbs[i], down) >= cos(0.5 * cone_rad)) {
            best = fmin(best, reach(o, g, d, above_water, plumbs[i]));
        }
    }
    return best;
}

/* Measure the distance; the echo is known to the telemetry later. */
static void send_echo(const dl_sim_vehicle_params *o, const dl_sim_vehicle *v, const dl_sim_sensor_params *e, dl_sim_sensors *s, const dl_sim_deck *g, double sea_z)
{
    const double heard = nearest_surface(o, v, g, sea_z, e->cone_rad) + e->echo_sigma * s->noise[DL_ECHO_NOISE];
    const int64_t place = (s->first_echo + s->echoes) % DL_ECHOES_MAX;
    s->echo_due[place] = (double)(s->tick + e->echo_delay);
    s->echo_under_way_m[place] = e->echo_min_m <= heard && heard <= e->echo_max_m ? heard : NAN;
    s->echoes++;
}

void sensors_step(const dl_sim_vehicle_params *o, const dl_sim_vehicle *v, const dl_sim_sensor_params *e, dl_sim_sensors *s, const dl_sim_deck *g, double sea_z,
                  const double noise[DL_SENSOR_NOISE])
{
    memcpy(s->noise, noise, sizeof s->noise);
    s->tick++;
    s->heading_drift = e->heading_keep * s->heading_drift + e->heading_fresh * noise[DL_HEADING_DRIFT];
    s->pressure_drift = e->pressure_keep * s->pressure_drift + e->pressure_fresh * noise[DL_PRESSURE_DRIFT];
    if (motors_turn(v)) {
        s->battery = fmax(0.0, s->battery - e->step_s / e->battery_life_s);
    }
    if (s->tick % e->echo_every == 0 && s->echoes < DL_ECHOES_MAX) {
        send_echo(o, v, e, s, g, sea_z);
    }
    while (s->echoes > 0 && s->echo_due[s->first_echo] <= (double)s->tick) {
        s->echo_m = s->echo_under_way_m[s->first_echo];
        s->first_echo = (s->first_echo + 1) % DL_ECHOES_MAX;
        s->echoes--;
    }
}

/* Rotor thrust is proportional to the square of the speed, and the speed to the pulse width. */
static void read_motors(const dl_sim_vehicle_params *o, const dl_sim_vehicle *v, const dl_sim_sensor_params *e, dl_sim_readings *out)
{
    double thrust[DL_ROTORS_MAX];
    rotor_thrusts(o, v->thrust_n, v->torque_n_m, thrust);
    for (int i = 0; i < 4; i++) {
        out->motors_pwm[i] = fmin(255.0, rint(HOVER_PWM * sqrt(fmax(0.0, thrust[e->motor[i]]) / e->hover_n)));
    }
}

void dl_sim_sensors_read(const dl_sim_vehicle_params *o, const dl_sim_vehicle *v, const dl_sim_sensor_params *e, const dl_sim_sensors *s, dl_sim_readings *out)
{
    const int turning = motors_turn(v);
    const double felt[3] = {v->a[0], v->a[1], v->a[2] - GRAVITY_M_S2}, *noise = s->noise;
    double force[3], field[3];
    rotated_back(v->R, felt, force);
    rotated_back(v->R, EARTH_FIELD_NED_T, field);
    for (int i = 0; i < 3; i++) {
        const double shaken = e->vibration > 0.0 && turning ? e->vibration * sin(HARMONIC * ROTOR_TURN * v->revolutions + (double)i) : 0.0;
        out->f_body[i] = e->accel_scale * force[i] + shaken + e->accel_bias[i] + e->accel_sigma[turning] * noise[DL_IMU_NOISE + i];
        out->w_body[i] = e->gyro_scale * v->w[i] + e->gyro_bias[i] + e->gyro_sigma[turning] * noise[DL_IMU_NOISE + 3 + i];
        out->magnetometer[i] = field[i] + e->field_bias[i] + e->field_sigma * noise[DL_FIELD_NOISE + i];
    }
    out->rpy_rad[0] = atan2(v->R[7], v->R[8]) + (v->tilt_bias[0] + v->tilt_drift[0]);
    out->rpy_rad[1] = asin(clip(-v->R[6], -1.0, 1.0)) + (v->tilt_bias[1] + v->tilt_drift[1]);
    out->rpy_rad[2] = wrapped(atan2(v->R[3], v->R[0]) + e->heading_bias + s->heading_drift);
    out->v_level_m_s[0] = v->flow[0];
    out->v_level_m_s[1] = v->flow[1];
    out->ultrasound_m = s->echo_m;
    out->pressure_pa = SEA_LEVEL_PA * pow(1.0 - 2.25577e-5 * -v->p[2], 5.25588) + s->pressure_drift
                       + e->pressure_sigma * noise[DL_PRESSURE_NOISE];
    out->battery = s->battery;
    read_motors(o, v, e, out);
}
