/* Compute the coverage of blurred pixels by the regions of a drawing, and its derivatives. */

#include "vision/register/coverage.h"

#include <math.h>
#include <string.h>

#include "base/wide.h"
#include "vision/register/exponential.h"

/* sqrt(2 / pi), and the coefficient of the cube with it. Source of the form: Page, Approximations to the cumulative normal
 * function, Applied Statistics 26(1), 1977. */
static const float PHI_A = 0.7978845608f, PHI_B = 0.0356774081f;
/* Standard deviations of the blur beyond which a figure covers nothing. */
static const float REACH = 5.0f;
/* Rectangles of a figure from which those beyond the blur's reach are left out: a fiducial has a hundred, most of them far off. */
enum { MANY = 9 };
/* Correlation of the blur along both axes up to which two terms of a series hold. */
static const double SLANT_MOST = 0.5;
/* The logarithm of the largest odds of the normal integral that the exponential function takes; its slope is zero there. */
static const float MOST = 80.0f;

/* The normal integral of d / sigma and its derivatives by d and by sigma squared; `per` is 1 / sigma. Good to 3e-4, and smooth. */
static inline void phi(float d, float per, float *value, float *slope, float *by_var)
{
    const float z = d * per, z2 = z * z, odds = 2.0f * z * (PHI_A + PHI_B * z2);
    const float low = odds < MOST ? odds : MOST, bounded = low > -MOST ? low : -MOST;
    const float outside = 1.0f / (1.0f + exponential(bounded)), inside = 1.0f - outside;
    const float steep = 2.0f * outside * inside * (PHI_A + 3.0f * PHI_B * z2) * per;
    *value = inside;
    *slope = steep;
    *by_var = -0.5f * z * per * steep;
}

WIDE
void prepare_circles(const footprint *f, round_points *p)
{
    const float *restrict x = f->x, *restrict y = f->y, *restrict m = f->m;
    float *restrict seen = p->seen, *restrict per = p->per, *restrict per_sigma = p->per_sigma;
    float *restrict m_cc = p->m_cc, *restrict m_cs = p->m_cs, *restrict m_ss = p->m_ss;
    const float xx = (float)f->blur_m2[0], xy = (float)f->blur_m2[1], yy = (float)f->blur_m2[2];
    const int n = whole_lanes(f->n);
    for (int i = 0; i < n; i++) {
        const float x2 = x[i] * x[i], r2 = x2 + y[i] * y[i], per_r2 = m[i] / (r2 > 1e-8f ? r2 : 1e-8f);
        const float cc = x2 * per_r2, cs = 2.0f * (x[i] * y[i]) * per_r2, ss = m[i] - cc, slant = cs * xy;
        const float along = cc * xx + ss * yy + slant, across = ss * xx + cc * yy - slant, effective = sqrtf(r2 + across);
        m_cc[i] = cc, m_cs[i] = cs, m_ss[i] = ss;
        seen[i] = effective;
        per[i] = 1.0f / effective;
        per_sigma[i] = 1.0f / sqrtf(along);
    }
}

/* Add a circle's coverage, and its derivatives by distance and variance to `by_d` and `by_v`. */
WIDE
static void add_circle(const round_points *p, float radius, float sign, int begin, int count, float *restrict value,
                       float *restrict by_d, float *restrict by_v)
{
    const float *restrict seen = p->seen + begin, *restrict per_sigma = p->per_sigma + begin;
    for (int i = 0; i < count; i++) {
        float c, slope, var;
        phi(radius - seen[i], per_sigma[i], &c, &slope, &var);
        value[i] += sign * c, by_d[i] += sign * slope, by_v[i] += sign * var;
    }
}

/* d += the derivatives of circles' coverages by place and blur, from those by distance and variance. */
WIDE
static void add_change(const footprint *f, const round_points *p, int begin, int count, const float *restrict by_d,
                       const float *restrict by_v, float *const d[BY])
{
    const float *restrict x = f->x + begin, *restrict y = f->y + begin, *restrict per = p->per + begin;
    const float *restrict cc = p->m_cc + begin, *restrict cs = p->m_cs + begin, *restrict ss = p->m_ss + begin;
    float *restrict dx = d[0], *restrict dy = d[1], *restrict dxx = d[2], *restrict dxy = d[3], *restrict dyy = d[4];
    for (int i = 0; i < count; i++) {
        const float outward = by_d[i] * per[i], inward = -0.5f * outward;
        dx[i] += -outward * x[i];
        dy[i] += -outward * y[i];
        dxx[i] += by_v[i] * cc[i] + inward * ss[i];
        dxy[i] += (by_v[i] - inward) * cs[i];
        dyy[i] += by_v[i] * ss[i] + inward * cc[i];
    }
}

/* The normal integrals at one cut for some points, and their derivatives. */
typedef struct {
    float value[LANES], slope[LANES], by_var[LANES];
} cut;

static inline void cut_at(float at, const float *x, const float *per, cut *c)
{
    for (int l = 0; l < LANES; l++) {
        phi(at - x[l], per[l], &c->value[l], &c->slope[l], &c->by_var[l]);
    }
}

/* Points of a footprint side by side, the inverse deviations of the blur along both axes there, and the reach of the widest. */
typedef struct {
    float x[LANES], y[LANES], m[LANES], per_x[LANES], per_y[LANES], reach;
} few;

/* The limits of a few points along an axis, moved out by a reach. */
typedef struct {
    float low, high;
} span;

static inline span span_of(const float *x, float reach)
{
    span s = {x[0], x[0]};
    for (int l = 1; l < LANES; l++) {
        s.low = x[l] < s.low ? x[l] : s.low;
        s.high = x[l] > s.high ? x[l] : s.high;
    }
    s.low -= reach, s.high += reach;
    return s;
}

/* The cuts of a figure along one axis; if there are many rectangles, those beyond the reach are before all points or behind them. */
static inline void cuts_at(const double *at, int64_t count, int many, span near, const float *x, const float *per, cut *out)
{
    for (int64_t k = 0; k < count; k++) {
        const float here = (float)at[k];
        if (!many || (here > near.low && here < near.high)) {
            cut_at(here, x, per, &out[k]);
            continue;
        }
        for (int l = 0; l < LANES; l++) {
            out[k].value[l] = here > near.low ? 1.0f : 0.0f, out[k].slope[l] = 0.0f, out[k].by_var[l] = 0.0f;
        }
    }
}

static inline int apart(const double *at, int64_t from, int64_t to, span near)
{
    return (float)at[to] <= near.low || (float)at[from] >= near.high;
}

/* Whether one of a few points is within the blur's reach of the figure's bounding box. */
static inline int is_near(const dl_pad_figure *g, const few *p)
{
    const float *x = p->x, *y = p->y, reach = p->reach;
    const float x0 = (float)g->x_m[0] - reach, x1 = (float)g->x_m[g->x_cuts - 1] + reach;
    const float y0 = (float)g->y_m[0] - reach, y1 = (float)g->y_m[g->y_cuts - 1] + reach;
    int near = 0;
    for (int l = 0; l < LANES; l++) {
        near |= (x[l] > x0) & (x[l] < x1) & (y[l] > y0) & (y[l] < y1);
    }
    return near;
}

/* Find how wide the blur is at a few points. */
static inline void spread(const footprint *f, few *p)
{
    const float xx = (float)f->blur_m2[0], yy = (float)f->blur_m2[2];
    float most = 0.0f;
    for (int l = 0; l < LANES; l++) {
        const float wide = p->m[l] * xx, high = p->m[l] * yy, larger = wide > high ? wide : high;
        p->per_x[l] = 1.0f / sqrtf(wide);
        p->per_y[l] = 1.0f / sqrtf(high);
        most = larger > most ? larger : most;
    }
    p->reach = REACH * sqrtf(most);
}

/* The blur's covariance along both axes, as far as a short series in the correlation holds. */
static inline float slant_of(const footprint *f)
{
    const double most = SLANT_MOST * sqrt(f->blur_m2[0] * f->blur_m2[2]);
    return (float)fmin(fmax(f->blur_m2[1], -most), most);
}

/* Add the rectangles of a figure at `LANES` points. The blur's covariance `xy` enters by the first two terms of the series in the
 * correlation, whose derivatives by x and y are those of the normal integrals (heat equation); the third is a thousandth where a
 * tilt of 25 degrees slants the blur. An H that its blur merges turns by degrees without them.
 * Source: Kendall, Proof of relations connected with the tetrachoric series, Biometrika 32(2), 1941. */
WIDE
static void add_rectangles(const dl_pad_figure *g, const few *p, float xy, float *value, float *const d[BY])
{
    cut across[DL_FIGURE_CUTS], along[DL_FIGURE_CUTS];
    const float *m = p->m;
    const int many = g->rectangles >= MANY;
    const span near_x = span_of(p->x, p->reach), near_y = span_of(p->y, p->reach);
    cuts_at(g->x_m, g->x_cuts, many, near_x, p->x, p->per_x, along);
    cuts_at(g->y_m, g->y_cuts, many, near_y, p->y, p->per_y, across);
    for (int r = 0; r < g->rectangles; r++) {
        if (many && (apart(g->x_m, g->x0[r], g->x1[r], near_x) || apart(g->y_m, g->y0[r], g->y1[r], near_y))) {
            continue;
        }
        const cut *x0 = &along[g->x0[r]], *x1 = &along[g->x1[r]], *y0 = &across[g->y0[r]], *y1 = &across[g->y1[r]];
        for (int l = 0; l < LANES; l++) {
            const float a = x1->value[l] - x0->value[l], b = y1->value[l] - y0->value[l], slant = xy * m[l];
            const float a1 = x1->slope[l] - x0->slope[l], b1 = y1->slope[l] - y0->slope[l];
            const float a2 = x1->by_var[l] - x0->by_var[l], b2 = y1->by_var[l] - y0->by_var[l];
            value[l] += a * b + slant * (a1 * b1 + 2.0f * slant * a2 * b2);
            d[0][l] -= a1 * b + 2.0f * slant * a2 * b1;
            d[1][l] -= a * b1 + 2.0f * slant * a1 * b2;
            d[2][l] += a2 * b * m[l];
            d[3][l] += (a1 * b1 + 4.0f * slant * a2 * b2) * m[l];
            d[4][l] += a * b2 * m[l];
        }
    }
}

/* Take points of a footprint; those beyond the last repeat it. */
static inline void points_at(const footprint *f, int begin, int count, int i, few *p)
{
    for (int l = 0; l < LANES; l++) {
        const int at = begin + (i + l < count ? i + l : count - 1);
        p->x[l] = f->x[at], p->y[l] = f->y[at], p->m[l] = f->m[at];
    }
}

WIDE
static void add_figure(const dl_pad_figure *g, const footprint *f, int begin, int count, float *value, float *const d[BY])
{
    for (int i = 0; i < count; i += LANES) {
        few p;
        float sum[1 + BY][LANES] = {{0.0f}};
        float *const by[BY] = {sum[1], sum[2], sum[3], sum[4], sum[5]};
        points_at(f, begin, count, i, &p);
        spread(f, &p);
        if (!is_near(g, &p)) {
            continue;
        }
        add_rectangles(g, &p, slant_of(f), sum[0], by);
        for (int l = 0; l < LANES && i + l < count; l++) {
            value[i + l] += sum[0][l];
            for (int k = 0; k < BY; k++) {
                d[k][i + l] += by[k][l];
            }
        }
    }
}

/* Add what straight sides of any direction enclose, at points turned by half a turn if `sign` is -1. */
static void add_slanted(const dl_pad_figure *g, const footprint *f, int begin, int count, float sign, float *value, float *const d[BY])
{
    round_sides sides;
    prepare_sides(g, f->blur_m2, &sides);
    for (int i = 0; i < count; i += LANES) {
        few p;
        float sum[1 + BY][LANES] = {{0.0f}};
        float *const by[BY] = {sum[1], sum[2], sum[3], sum[4], sum[5]};
        points_at(f, begin, count, i, &p);
        for (int l = 0; l < LANES; l++) {
            p.x[l] *= sign, p.y[l] *= sign;
        }
        add_sides(&sides, p.x, p.y, p.m, sum[0], by);
        for (int l = 0; l < LANES && i + l < count; l++) {
            value[i + l] += sum[0][l];
            for (int k = 0; k < BY && d; k++) {
                d[k][i + l] += by[k][l];
            }
        }
    }
}

/* The product of the normal integrals of a wedge's sides, and its derivatives. */
static inline float inside_wedge(const dl_pad_wedge *w, const double blur_m2[3], float x, float y, float m, float d[BY])
{
    float value = 1.0f;
    memset(d, 0, BY * sizeof *d);
    for (int k = 0; k < w->sides; k++) {
        const float nx = (float)w->nx[k], ny = (float)w->ny[k];
        const float var = nx * nx * (float)blur_m2[0] + 2.0f * nx * ny * (float)blur_m2[1] + ny * ny * (float)blur_m2[2];
        float c, slope, by_var;
        phi((float)w->offset_m[k] - nx * x - ny * y, 1.0f / sqrtf(var * m), &c, &slope, &by_var);
        for (int i = 0; i < BY; i++) {
            d[i] *= c;
        }
        d[0] -= value * slope * nx, d[1] -= value * slope * ny;
        d[2] += value * by_var * m * nx * nx;
        d[3] += value * by_var * m * 2.0f * nx * ny;
        d[4] += value * by_var * m * ny * ny;
        value *= c;
    }
    return value;
}

/* Add a wedge where its circle does not cover it. `circle` is free: it takes the circle's coverage and derivatives at a point. */
static void add_wedge(const dl_pad_wedge *w, const footprint *f, const round_points *p, int begin, int count, float *value,
                      float *const d[BY])
{
    for (int i = 0; i < count; i++) {
        const int at = begin + i;
        float by[BY], circle, by_d, by_v, by_circle[BY] = {0.0f};
        const float whole = inside_wedge(w, f->blur_m2, f->x[at], f->y[at], f->m[at], by);
        phi((float)w->beyond_m - p->seen[at], p->per_sigma[at], &circle, &by_d, &by_v);
        if (d) {
            float *const one[BY] = {by_circle, by_circle + 1, by_circle + 2, by_circle + 3, by_circle + 4};
            add_change(f, p, at, 1, &by_d, &by_v, one);
            for (int k = 0; k < BY; k++) {
                d[k][i] += by[k] * (1.0f - circle) - whole * by_circle[k];
            }
        }
        value[i] += whole * (1.0f - circle);
    }
}

void cover(const dl_pad_shape *pad, const dl_pad_region *region, const stretch *at, float *value, float *const d[BY],
           float *const spare[2])
{
    const footprint *f = at->f;
    const round_points *p = at->round;
    const int begin = at->begin, count = at->count;
    const size_t size = (size_t)count * sizeof *value;
    memset(value, 0, size);
    for (int k = 0; k < BY; k++) {
        memset(d[k], 0, size);
    }
    if (region->circles) {
        memset(spare[0], 0, size), memset(spare[1], 0, size);
        for (int k = 0; k < region->circles; k++) {
            add_circle(p, (float)region->radius_m[k], (float)region->sign[k], begin, count, value, spare[0], spare[1]);
        }
        add_change(f, p, begin, count, spare[0], spare[1], d);
    }
    if (region->figure >= 0) {
        const dl_pad_figure *g = &pad->figures[region->figure];
        if (g->rectangles) {
            add_figure(g, f, begin, count, value, d);
        }
        if (g->sides) {
            add_slanted(g, f, begin, count, 1.0f, value, d);
        }
    }
    if (region->has_wedge) {
        add_wedge(&pad->wedge, f, p, begin, count, value, d);
    }
}

void cover_figure(const dl_pad_figure *g, const footprint *f, int begin, int count, int turned, float *value)
{
    const float sign = turned ? -1.0f : 1.0f;
    memset(value, 0, (size_t)count * sizeof *value);
    for (int i = 0; i < count && g->rectangles; i += LANES) {
        few p;
        float sum[1 + BY][LANES] = {{0.0f}};
        float *const by[BY] = {sum[1], sum[2], sum[3], sum[4], sum[5]};
        points_at(f, begin, count, i, &p);
        for (int l = 0; l < LANES; l++) {
            p.x[l] *= sign, p.y[l] *= sign;
        }
        spread(f, &p);
        if (is_near(g, &p)) {
            add_rectangles(g, &p, slant_of(f), sum[0], by);
        }
        for (int l = 0; l < LANES && i + l < count; l++) {
            value[i + l] = sum[0][l];
        }
    }
    if (g->sides) {
        add_slanted(g, f, begin, count, sign, value, 0);
    }
}

void cover_pointer(const dl_pad_shape *pad, const footprint *f, const round_points *p, int begin, int count, float *value)
{
    if (!pad->wedge.sides) {
        cover_figure(&pad->figures[pad->pointer_figure], f, begin, count, 0, value);
        return;
    }
    memset(value, 0, (size_t)count * sizeof *value);
    add_wedge(&pad->wedge, f, p, begin, count, value, 0);
}
