#include <math.h>
#include <string.h>

#include "camera.h"
#include "search.h"
#include "vectors.h"
#include "wide.h"

enum { CELLS = POLAR_RADII * POLAR_ANGLES, VALUES = 4, LANES = 8 };
/* Area of a paint in view, as a fraction of the whole, below which the paint is ignored. */
static const double LEAST_PAINT = 1e-3;
/* Fraction of the disc in view below which nothing is told, and the factor on a score whose paints are on the wrong sides. */
static const double LEAST_IN_VIEW = 0.02, WRONG_SIDE = 0.25;

/* Width of the disc's edge, px: what is nearer to it sees the surroundings, too, which no paint of the drawing explains. From afar
 * they outweigh the H and the ring. The greatest share of the radius that is left out for it. */
static const double RIM_PX = 1.2, WIDEST_RIM = 0.5;
/* Radius of the disc, px, below which a pixel between H and ring has light of both: there the ring is compared with what is outside
 * of it alone. */
static const double RESOLVED_PX = 20.0;

/* The weight of each cell, and with it its blue, green and red, 0..1. */
typedef struct {
    float of[VALUES][CELLS];
    double squares, weight, whole;
} polar_view;

/* Between the four pixels about a place at most half a pixel outside of the image, where the edge is repeated. */
static void pixel_at(const uint8_t *px, int32_t stride, int w, int h, double u, double v, float out[3])
{
    const double x = u > 0.0 ? u < w - 1.0 ? u : w - 1.0 : 0.0, y = v > 0.0 ? v < h - 1.0 ? v : h - 1.0 : 0.0;
    const int i = (int)x, j = (int)y, right = i + 1 < w ? 3 : 0;
    const float across = (float)(x - i), along = (float)(y - j);
    const uint8_t *top = px + (size_t)j * (size_t)stride + 3 * (size_t)i, *low = j + 1 < h ? top + stride : top;
    for (int c = 0; c < 3; c++) {
        const float upper = (float)top[c] + across * (float)(top[right + c] - top[c]);
        const float lower = (float)low[c] + across * (float)(low[right + c] - low[c]);
        out[c] = upper + along * (lower - upper);
    }
}

static void look(const camera_lens *c, const polar_pad *pad, const pad_pose *pose, int32_t step, int w, int h, const uint8_t *px,
                 int32_t stride, const double *side, polar_view *out)
{
    memset(out, 0, sizeof *out);
    const double rim_m = RIM_PX * step * pose->t[2] / c->fx, within = pad->radius_m - fmin(rim_m, WIDEST_RIM * pad->radius_m);
    for (int k = 0; k < CELLS; k++) {
        const double x = pad->xy_m[2 * k], y = pad->xy_m[2 * k + 1], area = pad->area_inside[k / POLAR_ANGLES];
        double at[3], uv[2];
        out->whole += area;
        for (int i = 0; i < 3; i++) {
            at[i] = pose->R[3 * i] * x + pose->R[3 * i + 1] * y + pose->t[i];
        }
        if (!(at[2] > 1e-3) || x * x + y * y > within * within || (side != NULL && x * side[0] + y * side[1] <= 0.0)) {
            continue;
        }
        camera_project(c, at, uv);
        const double u = (uv[0] + 0.5) / step - 0.5, v = (uv[1] + 0.5) / step - 0.5;
        if (u > -0.5 && u < w - 0.5 && v > -0.5 && v < h - 0.5) {
            float seen[3];
            const float weight = (float)area;
            pixel_at(px, stride, w, h, u, v, seen);
            out->of[0][k] = weight;
            out->weight += area;
            for (int i = 0; i < 3; i++) {
                const float light = seen[i] * (1.0f / 255.0f);
                out->of[1 + i][k] = weight * light;
                out->squares += area * (double)light * (double)light;
            }
        }
    }
}

/* Weighted light under a shape that is turned by every whole number of cells: correlation along the angle. */
WIDE
static void turned_sums(const polar_view *seen, const double *shape, float out[POLAR_ANGLES][VALUES])
{
    memset(out, 0, sizeof(float) * POLAR_ANGLES * VALUES);
    for (int r = 0; r < POLAR_RADII; r++) {
        float twice[2 * POLAR_ANGLES], any = 0.0f;
        for (int a = 0; a < POLAR_ANGLES; a++) {
            twice[a] = twice[a + POLAR_ANGLES] = (float)shape[POLAR_ANGLES * r + a];
            any += twice[a];
        }
        for (int k = 0; k < POLAR_ANGLES && any > 0.0f; k++) {
            float *under = twice + POLAR_ANGLES - k;
            for (int value = 0; value < VALUES; value++) {
                float8 sum = {0.0f};
                const float *row = seen->of[value] + POLAR_ANGLES * r;
                for (int a = 0; a < POLAR_ANGLES; a += LANES) {
                    float8 light;
                    memcpy(&light, row + a, sizeof light);
                    sum += *eight(under + a) * light;
                }
                out[k][value] += ((sum[0] + sum[4]) + (sum[1] + sum[5])) + ((sum[2] + sum[6]) + (sum[3] + sum[7]));
            }
        }
    }
}

/* Sums of weight and light of some cells. */
typedef struct {
    double whole[VALUES], ring[VALUES], outside[VALUES];
} disc_sums;

/* The sums of the whole disc, of its ring, and of what lies outside of the ring. */
static void sums_of(const polar_view *seen, const polar_pad *pad, disc_sums *out)
{
    int outermost = POLAR_RADII - 1;
    while (outermost > 0 && !(pad->ring[outermost] > 0.0)) {
        outermost--;
    }
    memset(out, 0, sizeof *out);
    for (int value = 0; value < VALUES; value++) {
        for (int r = 0; r < POLAR_RADII; r++) {
            double sum = 0.0;
            for (int a = 0; a < POLAR_ANGLES; a++) {
                sum += (double)seen->of[value][POLAR_ANGLES * r + a];
            }
            out->whole[value] += sum;
            out->ring[value] += sum * pad->ring[r];
            out->outside[value] += r > outermost ? sum : 0.0;
        }
    }
}

/* How much brighter the ring is in red than the disc about it, or than the disc outside of it where pixels mix it with the H. */
static double ring_over_disc(const double ring[VALUES], const double disc[VALUES], const float arrow[VALUES], const disc_sums *of,
                             double least, int resolved)
{
    const double n = of->outside[0] - (double)arrow[0], outside = of->outside[VALUES - 1] - (double)arrow[VALUES - 1];
    const double beside = resolved || !(n > least) ? disc[VALUES - 1] / disc[0] : outside / n;
    return ring[VALUES - 1] / ring[0] - beside;
}

/* The variance between the paints at one heading, as a fraction of all; less if a paint lies on the wrong side of another. */
static double score_at(const float h[VALUES], const float arrow[VALUES], const disc_sums *of, double least, double spread,
                       double polarity, int resolved)
{
    double paint[3][VALUES], mean[3][3], between = 0.0, right = 1.0;
    for (int value = 0; value < VALUES; value++) {
        paint[0][value] = (double)h[value];
        paint[1][value] = of->ring[value] + (double)arrow[value];
        paint[2][value] = of->whole[value] - paint[0][value] - paint[1][value];
    }
    for (int c = 0; c < 3; c++) {
        between -= of->whole[1 + c] * of->whole[1 + c] / of->whole[0];
        for (int k = 0; k < 3; k++) {
            mean[k][c] = paint[k][1 + c] / fmax(paint[k][0], least);
            between += paint[k][0] > least ? paint[k][1 + c] * mean[k][c] : 0.0;
        }
    }
    if (paint[2][0] > least) {
        for (int c = 0; c < 3 && paint[0][0] > least; c++) {
            right = fmin(right, polarity * (mean[0][c] - mean[2][c]));
        }
        const double ring = paint[1][0] > least ? ring_over_disc(paint[1], paint[2], arrow, of, least, resolved) : polarity;
        right = fmin(right, polarity * ring);
    }
    return (right > 0.0 ? 1.0 : WRONG_SIDE) * between / spread;
}

int32_t search_heading(const camera_lens *c, const polar_pad *pad, const pad_pose *pose, int32_t step, int32_t width,
                       int32_t height, const uint8_t *px, int32_t stride, const double *side, polar_fit *out)
{
    polar_view seen;
    float h[POLAR_ANGLES][VALUES], arrow[POLAR_ANGLES][VALUES];
    double score[POLAR_ANGLES];
    disc_sums of;
    look(c, pad, pose, step, width, height, px, stride, side, &seen);
    if (!(seen.weight >= LEAST_IN_VIEW * seen.whole)) {
        return 0;
    }
    sums_of(&seen, pad, &of);
    const int resolved = c->fx * pad->radius_m >= RESOLVED_PX * step * pose->t[2];
    double spread = seen.squares;
    for (int k = 0; k < 3; k++) {
        spread -= of.whole[1 + k] * of.whole[1 + k] / of.whole[0];
    }
    if (!(spread > 1e-6 * seen.whole)) {
        return 0;
    }
    turned_sums(&seen, pad->h_marking, h);
    turned_sums(&seen, pad->arrow, arrow);
    int best = 0;
    for (int k = 0; k < POLAR_ANGLES; k++) {
        score[k] = score_at(h[k], arrow[k], &of, LEAST_PAINT * seen.whole, spread, pad->polarity, resolved);
        best = score[k] > score[best] ? k : best;
    }
    const double before = score[(best + POLAR_ANGLES - 1) % POLAR_ANGLES], after = score[(best + 1) % POLAR_ANGLES];
    const double bend = before - 2.0 * score[best] + after;
    const double fine = bend < -1e-9 ? 0.5 * (before - after) / bend : 0.0;
    out->turn_rad = (best + fine) * 2.0 * acos(-1.0) / POLAR_ANGLES;
    out->score = score[best];
    out->arrow = score[best] - score[(best + POLAR_ANGLES / 2) % POLAR_ANGLES];
    out->in_view = seen.weight / seen.whole;
    return 1;
}
