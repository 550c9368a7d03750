/* The simulated flight, several steps in one call. */

#include <math.h>

#include "physics/physics.h"

/* The height of the water's surface over mean water at a place, for waves that run over deep water. */
static double elevation(int32_t harmonics, const wave *waves, const double p[3], double t_s)
{
    double sum = 0.0;
    for (int32_t i = 0; i < harmonics; i++) {
        const wave *h = &waves[i];
        sum += h->amplitude_m * cos(p[0] * h->k[0] + p[1] * h->k[1] - h->w_rad_s * t_s + h->phase_rad);
    }
    return sum;
}

/* The water under the vehicle, for the next few steps. */
static void meet_sea(const vehicle_params *o, const vehicle *v, water *sea, int32_t harmonics, const wave *waves)
{
    const double t = (double)sea->tick * o->step_s, dt = (double)sea->every * o->step_s;
    const double now = elevation(harmonics, waves, v->p, t);
    sea->z = -now;
    sea->vz = -(elevation(harmonics, waves, v->p, t + dt) - now) / dt;
}

int32_t sim_run(const vehicle_params *o, vehicle *v, const sensor_params *e, sensors *s, water *sea, int32_t harmonics,
                const wave *waves, int32_t n, const deck *decks, const double *noise, const double *air_noise,
                const double *sensor_noise)
{
    if (sea->tick == 0) {
        meet_sea(o, v, sea, harmonics, waves);
    }
    for (int32_t i = 0; i < n; i++) {
        const double touched_s = v->touched_s;
        sea->tick++;
        const int64_t since = sea->tick % sea->every;
        if (since == 0) {
            meet_sea(o, v, sea, harmonics, waves);
        }
        const double z = sea->z + sea->vz * (double)since * o->step_s;
        vehicle_step(o, v, &decks[i], z, sea->vz, noise + FLIGHT_NOISE * i, air_noise + FLIGHT_NOISE * i);
        sensors_step(o, v, e, s, &decks[i], z, sensor_noise + SENSOR_NOISE * i);
        if (v->touched_what != 0 && v->touched_s != touched_s) {
            return i + 1;
        }
    }
    return n;
}
