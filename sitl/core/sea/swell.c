/* The light that the sea sends up before its ripples: mirrored sky, the swell's slope, and the sun's glitter.
 *
 * It varies slowly and is computed for every second one of the cells of DL_CELL_PX x DL_CELL_PX pixels.
 */

#include <math.h>

#include "decklander_sim.h"
#include "base/wide.h"

/* Number of rays that are followed together. */
enum { TOGETHER = 32 };

static const double SLOPE_NORTH = 0.75; /* Weight of the slope to north. */
static const double SLOPE_EAST = 0.66; /* Weight of the slope to east. */
static const double PER_SLOPE = 150.0; /* Brightness of a slope of one. */
static const double FAR_M = 1e4;
/* Standard deviation of the facets' slopes that mirror the sun. */
static const double GLITTER_SLOPE = 0.16;

static inline double limited(double value, double least, double most)
{
    return value < least ? least : value > most ? most : value;
}

static inline int32_t nearer(int32_t i, int32_t n)
{
    return i < n ? i : n - 1;
}

/* Where rays meet calm water, m, and the swell's slope there. */
typedef struct {
    double north[TOGETHER], east[TOGETHER], slope[TOGETHER];
} swell_shore;

static void follow(const float *ray, const double *H, int k, swell_shore *s)
{
    const double depth = H[6] * ray[0] + H[7] * ray[1] + H[8], per_depth = fabs(depth) > 1e-12 ? 1.0 / depth : 0.0;
    s->north[k] = limited((H[0] * ray[0] + H[1] * ray[1] + H[2]) * per_depth, -FAR_M, FAR_M);
    s->east[k] = limited((H[3] * ray[0] + H[4] * ray[1] + H[5]) * per_depth, -FAR_M, FAR_M);
    s->slope[k] = 0.0;
}

/* The sine of an angle in turns, to four parts of a million: its series about zero, up to a quarter of a turn. */
static inline double sine_of_turns(double turns)
{
    const double part = turns - (double)(int32_t)(turns + (turns < 0.0 ? -0.5 : 0.5)), whole = fabs(part);
    const double x = 6.283185307179586 * (whole > 0.25 ? 0.5 - whole : whole), x2 = x * x;
    const double sine = x * (1.0 - x2 * (1.0 / 6.0 - x2 * (1.0 / 120.0 - x2 * (1.0 / 5040.0 - x2 * (1.0 / 362880.0)))));
    return part < 0.0 ? -sine : sine;
}

WIDE
static void add_wave(const dl_sim_wave *v, double t_s, swell_shore *s)
{
    const double per_turn = 1.0 / 6.283185307179586, north = v->k[0] * per_turn, east = v->k[1] * per_turn;
    const double from = (v->phase_rad - v->w_rad_s * t_s) * per_turn;
    const double first = from - floor(from), steep = v->amplitude_m * (v->k[0] * SLOPE_NORTH + v->k[1] * SLOPE_EAST);
    for (int k = 0; k < TOGETHER; k++) {
        s->slope[k] -= steep * sine_of_turns(s->north[k] * north + s->east[k] * east + first);
    }
}

/* Level and contrast in the direction of a ray over a slope of the water. */
static void light_at(const float *ray, const double *R, const double *to_sun, double slope, float *light)
{
    const double x = ray[0], y = ray[1], per_length = 1.0 / sqrt(1.0 + x * x + y * y);
    double bisector[3], d[3];
    for (int i = 0; i < 3; i++) {
        d[i] = (R[3 * i] * x + R[3 * i + 1] * y + R[3 * i + 2]) * per_length;
        bisector[i] = to_sun[i] - d[i];
    }
    const double up = 1.0 - limited(d[2], 0.02, 1.0), steep = bisector[2] < -0.05 ? bisector[2] : -0.05;
    const double tilt2 = (bisector[0] * bisector[0] + bisector[1] * bisector[1]) / (steep * steep);
    const double glitter = exp(-0.5 * tilt2 / (GLITTER_SLOPE * GLITTER_SLOPE));
    light[0] = (float)(52.0 + 95.0 * up * up + PER_SLOPE * slope + 22.0 * glitter);
    light[1] = (float)(26.0 + 70.0 * glitter);
}

/* The mean of the two values of a row or column beside one that is left out. */
static inline float beside(const float *at, int32_t i, int32_t n, int64_t step)
{
    return i + 1 < n ? 0.5f * (at[-step] + at[step]) : at[-step];
}

/* The slopes in every second column of a row, and between them. */
static void slopes_along(const float *rays, int32_t columns, const dl_sim_swell *sea, int32_t w, float *out)
{
    for (int32_t first = 0; first < w; first += 2 * TOGETHER) {
        swell_shore s;
        for (int32_t k = 0; k < TOGETHER; k++) {
            follow(rays + 2 * (int64_t)nearer(2 * nearer(first + 2 * k, w), columns), sea->plane_from_ray, k, &s);
        }
        for (int64_t i = 0; i < sea->harmonics; i++) {
            add_wave(&sea->waves[i], sea->t_s, &s);
        }
        for (int32_t k = 0; k < TOGETHER && first + 2 * k < w; k++) {
            out[2 * (first + 2 * k)] = (float)s.slope[k];
        }
    }
    for (int32_t column = 1; column < w; column += 2) {
        out[2 * column] = beside(out + 2 * column, column, w, 2);
    }
}

void dl_sim_render_swell(int32_t rows, int32_t columns, const float *rays, const dl_sim_swell *s, float *light)
{
    const int32_t h = rows / 2 + 1, w = columns / 2 + 1;
    for (int32_t row = 0; row < h; row += 2) {
        slopes_along(rays + 2 * (int64_t)nearer(2 * row, rows) * columns, columns, s, w, light + 2 * (int64_t)row * w);
    }
    for (int32_t row = 1; row < h; row += 2) {
        for (int32_t column = 0; column < w; column++) {
            float *out = light + 2 * ((int64_t)row * w + column);
            *out = beside(out, row, h, 2 * (int64_t)w);
        }
    }
    for (int32_t row = 0; row < h; row++) {
        for (int32_t column = 0; column < w; column++) {
            const float *ray = rays + 2 * ((int64_t)nearer(2 * row, rows) * columns + nearer(2 * column, columns));
            float *out = light + 2 * ((int64_t)row * w + column);
            light_at(ray, s->R_ned_cam, s->to_sun, (double)out[0], out);
        }
    }
}
