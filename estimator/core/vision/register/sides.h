/* The coverage of blurred pixels by what straight sides of any direction enclose.
 *
 * In coordinates in which the blur is round, a figure's share of the normal distribution about a point is a sum over its sides of the
 * shares of the triangles between the point and each side. That of a triangle is its angle at the point less Owen's function at both
 * ends; it is exact at corners, for any blur, and wherever the sides do not cross. By Gauss's theorem, its derivatives by the place
 * need the side alone, and those by the blur are second ones by the place (heat equation). */
#ifndef DECKLANDER_REGISTER_SIDES_H
#define DECKLANDER_REGISTER_SIDES_H

#include "vision/register/state.h"

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
