/* Where rays meet a plane. */

#include <math.h>

#include "decklander_sim.h"
#include "base/wide.h"

/* Rays that do not meet the plane are at its origin; places are limited, for beyond the horizon they have no meaning. */
WIDE
void dl_sim_render_meet(int32_t count, const float *rays, const double *plane_from_ray, double most, float *places)
{
    double H[9];
    memcpy(H, plane_from_ray, sizeof H);
    for (int32_t i = 0; i < count; i++) {
        const double x = rays[2 * i], y = rays[2 * i + 1], depth = H[6] * x + H[7] * y + H[8];
        const double met = fabs(depth) > 1e-12 ? 1.0 : 0.0, per_depth = met / (fabs(depth) > 1e-12 ? depth : 1.0);
        const double u = (H[0] * x + H[1] * y + H[2]) * per_depth, v = (H[3] * x + H[4] * y + H[5]) * per_depth;
        const double right = u > -most ? u : -most, down = v > -most ? v : -most;
        places[2 * i] = (float)(right < most ? right : most);
        places[2 * i + 1] = (float)(down < most ? down : most);
    }
}
