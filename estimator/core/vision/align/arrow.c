/* Measure the arrowhead at its place and at the opposite one, each sampled finely. */

#include <math.h>
#include <string.h>

#include "vision/align/align.h"

/* The arrowhead is small: the sampling that suffices for disc, ring and H covers it with one or two samples. Here the two places
 * alone are sampled finely. The light is projected on the line from disc paint to ring paint, and fitted with a linear slope, the
 * ring, and an arrowhead of unknown strength. */
/* Residual variance of the projected light (disc 0, ring 1) that halves, roughly, the trust that nothing else lies there. */
static const double CLEAR_VAR = 0.05;
static const double LEAST_ARROW_CONTRAST = 1e-4; /* Contrast below which an arrowhead has no light of its own. */
static const double LEAST_SEEN = 0.6; /* Share of its place in view from which it counts. */
static const double SAMPLE_DEPTH_M = 1e-3; /* Least depth of a sample, m. */
/* Strength of a whole arrowhead, in deviations of the noise, up to which it is hidden, and from which it is plain. */
static const double ARROW_HIDDEN = 2.0, ARROW_PLAIN = 5.0;
/* The regressors: constant, two slopes, ring; then the arrowhead; then the light. */
enum { OTHERS = 4, ARROW = 4, LIGHT = 5, TERMS = 6 };

/* The frame about the arrowhead's places. */
typedef struct {
    const frame_part *part;
    const uint8_t *px;
    int32_t stride;
    const float *root;
    double way[3];
} picture;

/* The frame's square root of light along the way from disc paint to ring paint, between pixels. Returns whether it is in view. */
static int light_at(const picture *of, const double uv_full[2], double *light)
{
    const double step = (double)(1 << of->part->level);
    const int w = (int)of->part->width, h = (int)of->part->height;
    const double u = (uv_full[0] + 0.5) / step - 0.5 - (double)of->part->left, v = (uv_full[1] + 0.5) / step - 0.5 - (double)of->part->top;
    if (!(u > -0.5 && u < w - 0.5 && v > -0.5 && v < h - 0.5)) {
        return 0;
    }
    const int left = u < 0.0 ? 0 : (int)u, top = v < 0.0 ? 0 : (int)v;
    const int right = left + 1 < w ? left + 1 : left, below = top + 1 < h ? top + 1 : top;
    const double across = fmax(0.0, u - left), down = fmax(0.0, v - top);
    const uint8_t *upper = of->px + (size_t)top * (size_t)of->stride, *lower = of->px + (size_t)below * (size_t)of->stride;
    *light = 0.0;
    for (int c = 0; c < 3; c++) {
        const double a = (double)of->root[upper[3 * left + c]], b = (double)of->root[upper[3 * right + c]];
        const double d = (double)of->root[lower[3 * left + c]], e = (double)of->root[lower[3 * right + c]];
        *light += of->way[c] * ((1.0 - down) * (a + across * (b - a)) + down * (d + across * (e - d)));
    }
    return 1;
}

/* Constant, slope and ring are projected out of light and arrowhead; the remainders give the strength.
 * Source: Frisch, Waugh, Partial time regressions as compared with individual trends, Econometrica 1(4), 1933. */
static void eliminate(double sums[TERMS][TERMS])
{
    for (int k = 0; k < OTHERS; k++) {
        for (int i = k + 1; i < TERMS && sums[k][k] > 1e-12; i++) {
            const double by = sums[k][i] / sums[k][k];
            for (int j = i; j < TERMS; j++) {
                sums[i][j] -= by * sums[k][j];
            }
        }
    }
}

/* What is known of one place: sums of products of the terms, its samples in view, and the arrowhead's squared coverage there. */
typedef struct {
    double sums[TERMS][TERMS], energy;
    int n;
} place;

/* Add a sample at (x, y) on the pad to what is known of a place. */
static void add(const dl_lens *c, const picture *of, const dl_pad_pose *pose, double x, double y, double term[TERMS], place *to)
{
    double at[3], uv[2];
    for (int k = 0; k < 3; k++) {
        at[k] = pose->t[k] + pose->R[3 * k] * x + pose->R[3 * k + 1] * y;
    }
    if (!(at[2] > SAMPLE_DEPTH_M)) {
        return;
    }
    camera_project(c, at, uv);
    if (!light_at(of, uv, &term[LIGHT])) {
        return;
    }
    to->n++;
    to->energy += term[ARROW] * term[ARROW];
    for (int k = 0; k < TERMS; k++) {
        for (int l = k; l < TERMS; l++) {
            to->sums[k][l] += term[k] * term[l];
        }
    }
}

/* 0..1: how surely a whole arrowhead would show in noise of this variance. */
static double visibility(double energy, double var)
{
    const double deviations = sqrt(energy / fmax(var, 1e-12));
    return clipped((deviations - ARROW_HIDDEN) / (ARROW_PLAIN - ARROW_HIDDEN), 0.0, 1.0);
}

/* Found, seen, clear; `var` is the variance of the noise in the projected light, which is no sign of anything else. */
static void support(place *from, double energy, double fine, double var, double out[3])
{
    const double seen = from->energy / energy;
    if (!(seen >= LEAST_SEEN)) {
        return;
    }
    eliminate(from->sums);
    const double total = from->sums[ARROW][ARROW], square = fmax(0.0, from->sums[LIGHT][LIGHT] - var * from->n);
    const double strength = total > 1e-9 ? from->sums[ARROW][LIGHT] / total : 0.0;
    const double explained = strength > 0.0 ? strength * strength * total / fmax(square, 1e-9) : 0.0;
    out[0] = clipped(strength, 0.0, 1.0) * fmin(1.0, explained);
    out[1] = seen * fmax(0.0, fine);
    out[2] = exp(-fmax(0.0, square - strength * strength * total) / from->n / CLEAR_VAR);
}

/* Sample both places. */
static double sample(const dl_lens *c, const dl_pad_template *p, const int16_t *map, const picture *of, const dl_pad_pose *pose,
                     place places[2])
{
    const double from_x = p->arrow_tip_m - p->arrow_depth_m - p->arrow_margin_m, pitch = p->arrow_pitch_m;
    const double from_y = -p->arrow_half_base_m - p->arrow_margin_m;
    const int columns = (int)p->arrow_columns, count = (int)p->arrow_rows * columns;
    double energy = 0.0;
    for (int i = 0; i < count; i++) {
        const double x = from_x + pitch * (i / columns), y = from_y + pitch * (i % columns);
        const double ring = (double)align_map_at(p, map, (float)-x, (float)-y)[PAINT_ORANGE];
        const double arrow = (double)align_map_at(p, map, (float)x, (float)y)[PAINT_ORANGE] - ring;
        double term[TERMS] = {1.0, x - p->arrow_tip_m, y, ring, arrow, 0.0};
        energy += arrow * arrow;
        add(c, of, pose, x, y, term, &places[0]);
        add(c, of, pose, -x, -y, term, &places[1]);
    }
    return energy;
}

void align_arrow(const dl_tracker *t, const seen_part *seen, const dl_pad_pose *pose, const float paints[4][3], double noise,
                 double out[6])
{
    const dl_lens *c = &t->camera.lens;
    const dl_pad_template *p = &t->pad.drawn;
    const frame_part *part = &seen->part;
    picture of = {part, seen->px, seen->stride, t->lights + 256, {0.0, 0.0, 0.0}};
    double length = 0.0;
    for (int k = 0; k < 3; k++) {
        of.way[k] = (double)paints[PAINT_ORANGE][k] - (double)paints[PAINT_DISC][k];
        length += of.way[k] * of.way[k];
    }
    memset(out, 0, 6 * sizeof *out);
    const double step = (double)(1 << part->level), pixel_m = step * pose->t[2] / c->fx;
    if (length < LEAST_ARROW_CONTRAST || pixel_m > 1.2 * p->arrow_depth_m) {
        return;
    }
    for (int k = 0; k < 3; k++) {
        of.way[k] /= length;
    }
    const int16_t *map = align_map(p, t->maps, align_blur(p, hypot(PIXEL_SIGMA * pixel_m, LENS_BLUR_PX * pixel_m / step)));
    const double fine = pixel_m > p->arrow_depth_m / 2.0 ? fmin(1.0, 2.0 * p->arrow_depth_m / pixel_m - 1.0) : 1.0;
    place places[2];
    memset(places, 0, sizeof places);
    const double energy = sample(c, p, map, &of, pose, places);
    const double value = noise / step, var = value * value / length, coarse = fmax(1.0, pixel_m / p->arrow_pitch_m);
    const double shown = visibility(energy / (coarse * coarse), var);
    support(&places[0], energy, fine * shown, var, out);
    support(&places[1], energy, fine * shown, var, out + 3);
}
