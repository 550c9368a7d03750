/* The simulated flight, several steps in one call. */

#include <math.h>

#include "physics/physics.h"

/* The height of the water's surface over mean water under the vehicle, for waves that run over deep water. */
static double elevation(const dl_sim_flight *f, double t_s)
{
    const double *p = f->vehicle->p;
    double sum = 0.0;
    for (int64_t i = 0; i < f->harmonics; i++) {
        const dl_sim_wave *h = &f->waves[i];
        sum += h->amplitude_m * cos(p[0] * h->k[0] + p[1] * h->k[1] - h->w_rad_s * t_s + h->phase_rad);
    }
    return sum;
}

/* The water under the vehicle, for the next few steps. */
static void meet_sea(const dl_sim_flight *f)
{
    dl_sim_water *sea = f->water;
    const double step_s = f->vehicle_params->step_s, t = (double)sea->tick * step_s, dt = (double)sea->every * step_s;
    const double now = elevation(f, t);
    sea->z = -now;
    sea->vz = -(elevation(f, t + dt) - now) / dt;
}

int32_t dl_sim_run(const dl_sim_flight *f, int32_t n, const dl_sim_deck *decks, const double *noise, const double *air_noise,
                const double *effect_noise, const double *dl_sim_noise)
{
    const dl_sim_vehicle_params *o = f->vehicle_params;
    dl_sim_vehicle *v = f->vehicle;
    dl_sim_water *sea = f->water;
    if (sea->tick == 0) {
        meet_sea(f);
    }
    for (int32_t i = 0; i < n; i++) {
        const double touched_s = v->touched_s;
        sea->tick++;
        const int64_t since = sea->tick % sea->every;
        if (since == 0) {
            meet_sea(f);
        }
        const double z = sea->z + sea->vz * (double)since * o->step_s;
        dl_sim_vehicle_step(o, v, &decks[i], z, sea->vz, noise + DL_FLIGHT_NOISE * i, air_noise + DL_FLIGHT_NOISE * i, effect_noise + DL_EFFECT_NOISE * i);
        sensors_step(o, v, f->sensor_params, f->sensors, &decks[i], z, dl_sim_noise + DL_SENSOR_NOISE * i);
        if (v->touched_what != 0 && v->touched_s != touched_s) {
            return i + 1;
        }
    }
    return n;
}
