/* The coverage of blurred pixels by the regions of a drawing.
 *
 * A pixel of a blurred frame mixes the paints; the weight of a paint is its region convolved with the point spread function. Across
 * a straight edge that is the normal distribution's integral. In a rectangle it is a product of two, because an isotropic Gaussian
 * separates into its axes; `sides.h` says what it is between sides of other directions. A circle's edge moves inward as it is blurred. For the heat equation in polar coordinates the drift is
 * 1/r, whose characteristics are r0^2 = r^2 + sigma^2, so the coverage of a circle of radius R at radius r is
 * Phi((R - sqrt(r^2 + sigma^2)) / sigma). */
#ifndef DECKLANDER_REGISTER_COVERAGE_H
#define DECKLANDER_REGISTER_COVERAGE_H

#include "vision/register/state.h"

/* Points prepared for the coverage of circles about the centre: the effective radius sqrt(r^2 + sigma^2), its inverse, the inverse
 * deviation of the blur along the radius, and the squared ratio of depths times cc, 2 cs and ss of the radius' direction. */
enum { ROUND_ROWS = 6 };

typedef struct {
    float *seen, *per, *per_sigma, *m_cc, *m_cs, *m_ss;
} round_points;

void prepare_circles(const footprint *f, round_points *p);

/* Some of a footprint's points: `count` from `begin` on. */
typedef struct {
    const footprint *f;
    const round_points *round;
    int begin, count;
} stretch;

/* The coverage of points by a region, and its derivatives. `spare`: two rows that are written over. */
void cover(const dl_pad_shape *pad, const dl_pad_region *region, const stretch *at, float *value, float *const d[BY],
           float *const spare[2]);

/* The coverage by a figure alone, turned by half a turn if `turned`; without derivatives. */
void cover_figure(const dl_pad_figure *figure, const footprint *f, int begin, int count, int turned, float *value);

/* The coverage by the pointer alone, a wedge beyond its circle or a figure; without derivatives. */
void cover_pointer(const dl_pad_shape *pad, const footprint *f, const round_points *p, int begin, int count, float *value);

/* The coverage of blurred pixels by what straight sides of any direction enclose.
 *
 * In coordinates in which the blur is round, a figure's share of the normal distribution about a point is a sum over its sides of the
 * shares of the triangles between the point and each side. That of a triangle is its angle at the point less Owen's function at both
 * ends; it is exact at corners, for any blur, and wherever the sides do not cross. By Gauss's theorem, its derivatives by the place
 * need the side alone, and those by the blur are second ones by the place (heat equation). */
/* The sides of a figure where the blur is round: their directions, their distances from the origin outward, and where they begin and
 * end along their directions. Places become `a` x, `b` x + `c` y. */
typedef struct {
    int n;
    float a, b, c, low[2], high[2];
    float along_x[DL_FIGURE_SIDES], along_y[DL_FIGURE_SIDES], out[DL_FIGURE_SIDES], begin[DL_FIGURE_SIDES], end[DL_FIGURE_SIDES];
} round_sides;

void prepare_sides(const dl_pad_figure *g, const double blur_m2[3], round_sides *out);

/* Add the coverage of `LANES` points at (x, y) with squared ratios m of depths, and its derivatives. */
void add_sides(const round_sides *s, const float *x, const float *y, const float *m, float *value, float *const d[BY]);

#endif
