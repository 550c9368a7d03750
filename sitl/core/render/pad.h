/* What both stages of drawing the pad share: where rays of pixels meet its plane, and how deep points lie in its regions. */

#ifndef RENDER_PAD_H
#define RENDER_PAD_H

#include <math.h>

#include "decklander_sim.h"
#include "base/wide.h"

/* Number of pixels that are computed together. */
enum { EDGE = DL_PAD_EDGE, TOGETHER = 64 };

/* The homographies of one part of the exposure: in its middle, its change during it, and in the first and last row. */
typedef struct {
    const float *middle, *turn, *first, *last;
} stroke;

static inline stroke stroke_at(const float *strokes, int rolling, int which)
{
    const float *s = strokes + DL_STROKE_NUMBERS * which;
    const stroke made = {s, s + 9, rolling ? s + 18 : 0, rolling ? s + 27 : 0};
    return made;
}

/* Rays of pixels: their directions, the change of these for a pixel to the right and one down, the homography in their row. */
typedef struct {
    float x[TOGETHER], y[TOGETHER], change[4][TOGETHER], plane[9][TOGETHER], time[TOGETHER];
} sheaf;

/* Parallelograms on the pad's plane, m: the images of pixels or of parts of them, with their way during a part of the exposure.
 * Rays that do not meet the plane are FAR_AWAY. */
typedef struct {
    float u[TOGETHER], v[TOGETHER], right_u[TOGETHER], right_v[TOGETHER], down_u[TOGETHER], down_v[TOGETHER], way_u[TOGETHER],
        way_v[TOGETHER];
} spots;

#define FAR_AWAY 1e6f

/* Set what the rays of all pixels have in common. */
void begin_rays(const dl_sim_pad_view *v, const stroke *k, sheaf *s);

/* Take what is different for n pixels, 1 to TOGETHER: the last one stands for those that are missing. */
void gather_rays(const dl_sim_pad_view *v, int32_t n, const int32_t *pixels, sheaf *s);
void gather_changes(const dl_sim_pad_view *v, const stroke *k, int32_t n, const int32_t *pixels, sheaf *s);

/* Where rays meet the plane, and the images there of pixels divided by 1 / `parts`. */
void meet(const sheaf *rays, const float *turn, float parts, spots *s);

/* The radii of the circles around parallelograms, and the lengths of their ways. */
void sizes_of(const spots *s, float *radius, float *way);

static inline const float *region_of(const dl_sim_pad_view *v, int i)
{
    return v->pad + DL_PAD_REGION * i;
}

static inline float lesser_of(float a, float b)
{
    return a < b ? a : b;
}

static inline float in_annulus(const float *g, float u, float v)
{
    const float r = sqrtf(u * u + v * v);
    return lesser_of(g[DL_PAD_ANNULUS_OUTER] - r, r - g[DL_PAD_ANNULUS_INNER]);
}

static inline float in_rectangle(const float *g, float u, float v)
{
    return lesser_of(lesser_of(g[DL_PAD_RECTANGLE_U1] - u, u - g[DL_PAD_RECTANGLE_U0]),
                     lesser_of(g[DL_PAD_RECTANGLE_V1] - v, v - g[DL_PAD_RECTANGLE_V0]));
}

static inline float in_arrow(const float *g, float u, float v)
{
    const float ahead = g[DL_PAD_ARROW_COS] * (g[DL_PAD_ARROW_TIP] - u), aside = g[DL_PAD_ARROW_SIN] * v;
    return lesser_of(u - g[DL_PAD_ARROW_BASE], lesser_of(ahead - aside, ahead + aside));
}

static inline float in_polygon(const float *g, float u, float v)
{
    const int sides = (int)g[DL_PAD_POLYGON_SIDES];
    float depth = INFINITY;
    for (int k = 0; k < sides; k++) {
        const float *side = g + DL_PAD_POLYGON_FIRST + 3 * k;
        depth = lesser_of(depth, side[2] - side[0] * u - side[1] * v);
    }
    return depth;
}

/* How far the point (u, v) lies inside the nearest edge of a region, m; it is negative outside. */
static inline float depth_in(const float *g, float u, float v)
{
    switch ((int)g[DL_PAD_SHAPE]) {
    case DL_PAD_ANNULUS:
        return in_annulus(g, u, v);
    case DL_PAD_RECTANGLE:
        return in_rectangle(g, u, v);
    case DL_PAD_POLYGON:
        return in_polygon(g, u, v);
    default:
        return in_arrow(g, u, v);
    }
}

/* `depth_in` for many points. */
void depths_in(const float *g, const float *u, const float *v, float *depth);

#endif
