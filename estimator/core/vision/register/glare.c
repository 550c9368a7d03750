/* Model glare as a spot of light over the pad. */

#include "vision/register/dense.h"

#include <math.h>
#include <string.h>

#include "base/wide.h"
#include "vision/register/exponential.h"
#include "vision/register/sums.h"

/* Radii within which half of the light lies, and distances from the centre, as fractions of the disc's radius; directions of each. */
enum { RADII = 3, RINGS = 3, TRIED_MAX = RADII * 15, FEATURES_MAX = COEFFICIENTS_MAX + CHANNELS };
static const double RADIUS[RADII] = {0.35, 0.6, 0.9}, DISTANCE[RINGS] = {0.0, 0.35, 0.75};
static const int DIRECTION_COUNT[RINGS] = {1, 6, 8};
/* Smallest fraction of the squared residuals that a reflection has to explain. */
static const double LEAST_GAIN = 0.35;
static const double MOST_MOVED = 0.15; /* Largest move in one linearisation, of the disc's radius. */
static const double SMALLEST_GLARE = 0.2; /* Smallest radius of a glare, of the disc's. */
static const double LARGEST_GLARE = 1.5; /* Largest radius, of the disc's. */
static const double LN2 = 0.69314718055994530942;

/* The light of a reflection of strength one. */
WIDE
static void glare_light(const glare *g, const footprint *f, float *restrict light)
{
    const float gx = (float)g->x, gy = (float)g->y, per2 = (float)(1.0 / (g->radius * g->radius));
    const float *restrict x = f->x, *restrict y = f->y;
    const int n = whole_lanes(f->n);
    for (int i = 0; i < n; i++) {
        const float dx = x[i] - gx, dy = y[i] - gy, q = (dx * dx + dy * dy) * per2, power = (float)-LN2 * q * q;
        light[i] = exponential(power > -80.0f ? power : -80.0f);
    }
}

WIDE
void glare_columns(const glare *g, const footprint *f, float *const columns[GLARE_COLUMNS])
{
    const float gx = (float)g->x, gy = (float)g->y, per2 = (float)(1.0 / (g->radius * g->radius)), radius = (float)g->radius;
    const float per_slope = 4.0f * (float)LN2 * per2, *restrict light = columns[0];
    float *restrict by_x = columns[1], *restrict by_y = columns[2], *restrict by_radius = columns[3];
    const int n = whole_lanes(f->n);
    glare_light(g, f, columns[0]);
    for (int i = 0; i < n; i++) {
        const float dx = f->x[i] - gx, dy = f->y[i] - gy, q = (dx * dx + dy * dy) * per2, steep = light[i] * q * per_slope;
        by_x[i] = steep * dx, by_y[i] = steep * dy, by_radius[i] = steep * q * radius;
    }
}

static double limited(double value, double least, double most)
{
    return value > least ? (value < most ? value : most) : least;
}

glare glare_moved(const glare *g, const double amplitudes[GLARE_COLUMNS], double disc_radius_m)
{
    if (!(amplitudes[0] > 0.0)) {
        return *g;
    }
    const double most = MOST_MOVED * disc_radius_m, per = 1.0 / amplitudes[0];
    const double wider = limited(amplitudes[3] * per, -most, most);
    const glare out = {g->x + limited(amplitudes[1] * per, -most, most), g->y + limited(amplitudes[2] * per, -most, most),
                       limited(g->radius + wider, SMALLEST_GLARE * disc_radius_m, LARGEST_GLARE * disc_radius_m)};
    return out;
}

static glare tried(int index, double disc_radius_m)
{
    const int radius = index / (TRIED_MAX / RADII);
    int direction = index % (TRIED_MAX / RADII), ring = 0;
    while (direction >= DIRECTION_COUNT[ring]) {
        direction -= DIRECTION_COUNT[ring++];
    }
    const double a = direction * 2.0 * 3.14159265358979323846 / DIRECTION_COUNT[ring], d = DISTANCE[ring] * disc_radius_m;
    const glare out = {d * cos(a), d * sin(a), RADIUS[radius] * disc_radius_m};
    return out;
}

/* What the weighted squares of residuals and of candidates are made of. `weighted` has the values times the weight, then the
 * residuals times the weight. */
typedef struct {
    int k;
    double M[COEFFICIENTS_MAX * COEFFICIENTS_MAX], by_residual[COEFFICIENTS_MAX * CHANNELS], total;
    const float *weighted[FEATURES_MAX];
} products_left;

static void sum_weighted(int n, int k, float *const *values, float *const residual[CHANNELS], float *const weight[CHANNELS], float *w,
                  float *const *room, products_left *out)
{
    const float *right[COEFFICIENTS_MAX], *const left[CHANNELS] = {residual[0], residual[1], residual[2]};
    double squares[CHANNELS * CHANNELS] = {0.0};
    for (int i = 0; i < whole_lanes(n); i++) {
        w[i] = (weight[0][i] + weight[1][i] + weight[2][i]) / 3.0f;
    }
    for (int j = 0; j < k + CHANNELS; j++) {
        const float *row = j < k ? values[j] : residual[j - k];
        for (int i = 0; i < whole_lanes(n); i++) {
            room[j][i] = row[i] * w[i];
        }
        out->weighted[j] = room[j];
    }
    for (int j = 0; j < k; j++) {
        right[j] = values[j];
    }
    memset(out->M, 0, sizeof out->M);
    memset(out->by_residual, 0, sizeof out->by_residual);
    add_squares(n, k, out->weighted, right, COEFFICIENTS_MAX, out->M);
    add_products(n, k, out->weighted, CHANNELS, left, CHANNELS, out->by_residual);
    add_squares(n, CHANNELS, out->weighted + k, left, CHANNELS, squares);
    mirror(k, COEFFICIENTS_MAX, out->M);
    out->k = k;
    out->total = squares[0] + squares[CHANNELS + 1] + squares[2 * CHANNELS + 2];
    /* The first value is the constant, so its square is the sum of the weights. */
    const double sum = out->M[0];
    for (int j = 0; j < k; j++) {
        out->M[j * (COEFFICIENTS_MAX + 1)] += 1e-7 * sum;
    }
}

/* What a candidate explains of the residuals: its light's weighted square, the square of the part that no paint explains, and that
 * part's products with the residuals. */
typedef struct {
    double square, own, explained[CHANNELS];
} glare_trial;

static glare_trial try_glare(int n, const products_left *all, const float *light, const float *w, float *lit)
{
    const float *const one[1] = {light}, *const weighted[1] = {lit};
    double sums[FEATURES_MAX] = {0.0}, answer[COEFFICIENTS_MAX];
    glare_trial out = {0.0, 0.0, {0.0}};
    for (int i = 0; i < whole_lanes(n); i++) {
        lit[i] = light[i] * w[i];
    }
    add_products(n, all->k + CHANNELS, all->weighted, 1, one, 1, sums);
    add_products(n, 1, weighted, 1, one, 1, &out.square);
    memcpy(answer, sums, sizeof answer);
    if (!solve_symmetric(all->k, COEFFICIENTS_MAX, all->M, 1, answer)) {
        return out;
    }
    out.own = out.square;
    for (int c = 0; c < CHANNELS; c++) {
        out.explained[c] = sums[all->k + c];
    }
    for (int j = 0; j < all->k; j++) {
        out.own -= answer[j] * sums[j];
        for (int c = 0; c < CHANNELS; c++) {
            out.explained[c] -= answer[j] * all->by_residual[j * CHANNELS + c];
        }
    }
    return out;
}

glare glare_found(const footprint *f, float *const residual[CHANNELS], float *const weight[CHANNELS], int k, float *const *values,
                  double disc_radius_m, float *const spare[GLARE_SPARE])
{
    products_left all;
    glare_trial trials[TRIED_MAX];
    double largest = 0.0, best = 0.0;
    glare out = {0.0, 0.0, 0.0};
    sum_weighted(f->n, k, values, residual, weight, spare[0], spare + 3, &all);
    for (int t = 0; t < TRIED_MAX; t++) {
        const glare g = tried(t, disc_radius_m);
        glare_light(&g, f, spare[1]);
        trials[t] = try_glare(f->n, &all, spare[1], spare[0], spare[2]);
        largest = fmax(largest, trials[t].square);
    }
    for (int t = 0; t < TRIED_MAX; t++) {
        const double *e = trials[t].explained, size = fmax(trials[t].own, 1e-3 * largest);
        const double gain = e[0] + e[1] + e[2] > 0.0 ? (e[0] * e[0] + e[1] * e[1] + e[2] * e[2]) / size : 0.0;
        if (gain > best && gain > LEAST_GAIN * all.total) {
            best = gain;
            out = tried(t, disc_radius_m);
        }
    }
    return out;
}
