/* Integrate a blurred pixel over straight sides of any direction. */

#include "vision/register/coverage.h"

#include <math.h>

#include "base/wide.h"
#include "vision/register/exponential.h"

/* Standard deviations of the blur beyond which a side changes nothing. */
static const float SIDE_REACH = 5.5f;
static const float PER_TURN = 0.15915494f; /* 1 / (2 pi). */
static const float QUARTER = 0.25f; /* A quarter. */
static const float PEAK = 0.39894228f; /* 1 / sqrt(2 pi). */
/* Half of the largest square whose exponential function is taken; it is 1e-34 there. */
static const float FARTHEST_SIDE = 78.0f;
/* Places and weights of quadrature from 0 to 1. Source: Abramowitz, Stegun, Handbook of Mathematical Functions, table 25.4. */
enum { NODES = 5 };
static const float PLACE[NODES] = {0.04691008f, 0.23076535f, 0.5f, 0.76923465f, 0.95308992f};
static const float WEIGHT[NODES] = {0.11846344f, 0.23931434f, 0.28444444f, 0.23931434f, 0.11846344f};

void prepare_sides(const dl_pad_figure *g, const double blur_m2[3], round_sides *out)
{
    const double first = sqrt(blur_m2[0]), shared = blur_m2[1] / first, second = sqrt(fmax(blur_m2[2] - shared * shared, 1e-18));
    const double a = 1.0 / first, b = -shared / (first * second), c = 1.0 / second;
    out->n = (int)g->sides, out->a = (float)a, out->b = (float)b, out->c = (float)c;
    out->low[0] = out->low[1] = INFINITY, out->high[0] = out->high[1] = -INFINITY;
    for (int k = 0; k < out->n; k++) {
        const double from[2] = {a * g->from_x_m[k], b * g->from_x_m[k] + c * g->from_y_m[k]};
        const double to[2] = {a * g->to_x_m[k], b * g->to_x_m[k] + c * g->to_y_m[k]};
        const double length = fmax(hypot(to[0] - from[0], to[1] - from[1]), 1e-12);
        const double along[2] = {(to[0] - from[0]) / length, (to[1] - from[1]) / length};
        out->along_x[k] = (float)along[0], out->along_y[k] = (float)along[1];
        out->out[k] = (float)(along[1] * from[0] - along[0] * from[1]);
        out->begin[k] = (float)(along[0] * from[0] + along[1] * from[1]);
        out->end[k] = (float)(along[0] * to[0] + along[1] * to[1]);
        for (int i = 0; i < 2; i++) {
            out->low[i] = fminf(out->low[i], (float)from[i]);
            out->high[i] = fmaxf(out->high[i], (float)from[i]);
        }
    }
}

/* The normal density at x, and its integral from 0 to |x|.
 * Source: Hastings, Approximations for Digital Computers, 1955 (Abramowitz, Stegun, 26.2.17). Good to 1e-7. */
static inline void normal(float x, float *density, float *half)
{
    const float square = 0.5f * x * x, size = x < 0.0f ? -x : x, k = 1.0f / (1.0f + 0.2316419f * size);
    const float beyond = k * (0.31938153f + k * (-0.35656378f + k * (1.78147794f + k * (-1.82125598f + k * 1.33027443f))));
    *density = PEAK * exponential(-(square < FARTHEST_SIDE ? square : FARTHEST_SIDE));
    *half = 0.5f - *density * beyond;
}

static inline float with_sign(float size, float h, float t)
{
    return (h < 0.0f) != (t < 0.0f) ? -size : size;
}

/* The angle at a point of the right triangle to a line at distance h and t along it, in turns. */
static inline float angle(float h, float t)
{
    const float a = h < 0.0f ? -h : h, b = t < 0.0f ? -t : t, more = a > b ? a : b, less = a > b ? b : a;
    const float ratio = less / (more > 1e-20f ? more : 1e-20f), ratio2 = ratio * ratio;
    float sum = 0.0f;
    for (int k = 0; k < NODES; k++) {
        sum += WEIGHT[k] / (1.0f + ratio2 * (PLACE[k] * PLACE[k]));
    }
    sum *= PER_TURN * ratio;
    return with_sign(a >= b ? sum : QUARTER - sum, h, t);
}

/* The share of the normal distribution in that triangle. The two triangles of a rectangle have its share together, and the one with
 * the shorter side across is a smooth integral. `half_h` and `half_t` are the normal integrals from 0. */
static inline float triangle(float h, float t, float half_h, float half_t)
{
    const float a = h < 0.0f ? -h : h, b = t < 0.0f ? -t : t, more = a > b ? a : b, less = a > b ? b : a;
    const float ratio = less / (more > 1e-20f ? more : 1e-20f), ratio2 = ratio * ratio, half_square = 0.5f * more * more;
    float sum = 0.0f;
    for (int k = 0; k < NODES; k++) {
        const float longer = 1.0f + ratio2 * (PLACE[k] * PLACE[k]), square = half_square * longer;
        sum += WEIGHT[k] * (1.0f - exponential(-(square < FARTHEST_SIDE ? square : FARTHEST_SIDE))) / longer;
    }
    sum *= PER_TURN * ratio;
    return with_sign(a >= b ? sum : half_h * half_t - sum, h, t);
}

/* A side as some points see it: its distance outward, and where it begins and ends along its direction, in deviations. */
typedef struct {
    float h[LANES], begin[LANES], end[LANES];
} seen_side;

/* See a side from some points; returns whether one of them is near it. */
static inline int see(const round_sides *s, int k, const float *u, const float *v, const float *per, seen_side *out)
{
    const float ax = s->along_x[k], ay = s->along_y[k];
    int near = 0;
    for (int l = 0; l < LANES; l++) {
        const float along = ax * u[l] + ay * v[l];
        out->h[l] = per[l] * (s->out[k] - (ay * u[l] - ax * v[l]));
        out->begin[l] = per[l] * (s->begin[k] - along);
        out->end[l] = per[l] * (s->end[k] - along);
        near |= (out->h[l] < SIDE_REACH) & (out->h[l] > -SIDE_REACH) & (out->begin[l] < SIDE_REACH) & (out->end[l] > -SIDE_REACH);
    }
    return near;
}

/* What a near side adds to some points' coverage, and to the derivatives by the place where the blur is round: along both axes, then
 * twice along the first, along both, twice along the second. */
static inline void add_near(const round_sides *s, int k, const seen_side *side, float *value, float sums[BY][LANES])
{
    const float ax = s->along_x[k], ay = s->along_y[k], nx = ay, ny = -ax;
    for (int l = 0; l < LANES; l++) {
        const float h = side->h[l], begin = side->begin[l], end = side->end[l];
        float at_h, at_begin, at_end, half_h, half_begin, half_end;
        normal(h, &at_h, &half_h), normal(begin, &at_begin, &half_begin), normal(end, &at_end, &half_end);
        value[l] += triangle(h, end, half_h, half_end) - triangle(h, begin, half_h, half_begin);
        const float length = (end < 0.0f ? -half_end : half_end) - (begin < 0.0f ? -half_begin : half_begin);
        const float slope = at_h * length, bent = h * slope, turned = at_h * (at_end - at_begin);
        sums[0][l] -= nx * slope;
        sums[1][l] -= ny * slope;
        sums[2][l] -= nx * (bent * nx - turned * ax);
        sums[3][l] -= bent * nx * ny - 0.5f * turned * (nx * ay + ny * ax);
        sums[4][l] -= ny * (bent * ny - turned * ay);
    }
}

static inline void add_far(const seen_side *side, float *value)
{
    for (int l = 0; l < LANES; l++) {
        value[l] += angle(side->h[l], side->end[l]) - angle(side->h[l], side->begin[l]);
    }
}

WIDE
void add_sides(const round_sides *s, const float *x, const float *y, const float *m, float *value, float *const d[BY])
{
    float u[LANES], v[LANES], per[LANES], sums[BY][LANES] = {{0.0f}};
    const float a = s->a, b = s->b, c = s->c;
    int inside = 0;
    for (int l = 0; l < LANES; l++) {
        const float deviation = sqrtf(m[l]), reach = SIDE_REACH * deviation;
        u[l] = a * x[l], v[l] = b * x[l] + c * y[l], per[l] = 1.0f / deviation;
        inside |= (u[l] > s->low[0] - reach) & (u[l] < s->high[0] + reach) & (v[l] > s->low[1] - reach) & (v[l] < s->high[1] + reach);
    }
    for (int k = 0; k < s->n && inside; k++) {
        seen_side side;
        if (see(s, k, u, v, per, &side)) {
            add_near(s, k, &side, value, sums);
        } else {
            add_far(&side, value);
        }
    }
    for (int l = 0; l < LANES && inside; l++) {
        const float xx = sums[2][l], xy = sums[3][l], yy = sums[4][l];
        d[0][l] += per[l] * (a * sums[0][l] + b * sums[1][l]);
        d[1][l] += per[l] * c * sums[1][l];
        d[2][l] += 0.5f * (a * a * xx + 2.0f * a * b * xy + b * b * yy);
        d[3][l] += c * (a * xy + b * yy);
        d[4][l] += 0.5f * c * c * yy;
    }
}
