/* Turn an image upright along the strokes of an H. */

#include <math.h>
#include <string.h>

#include "base/rotation.h"
#include "base/wide.h"
#include "vision/search/search.h"
#include "vision/tracker.h"

/* Gradients, in fractions of the strongest, squared, that give a direction, and the fewest of them. */
enum { FEW_STRONG = 20, FEW_ABOVE = 50, UPPER_BY = 12, SHADES = 256 };
static const float STRONG_EDGE = 0.15f; /* Gradient that gives a direction, of the strongest, squared. */
/* Least cosine between a ray and the plane's normal. */
static const double LEAST_FACING = 0.15;

/* The darkest channel of each pixel, or the darkest of what is left to white if the marks are dark. */
WIDE
static void darkest_row(int w, const uint8_t *px, uint8_t flip, uint8_t *out)
{
    for (int i = 0; i < w; i++) {
        const uint8_t b = px[3 * i] ^ flip, g = px[3 * i + 1] ^ flip, r = px[3 * i + 2] ^ flip;
        const uint8_t less = b < g ? b : g;
        out[i] = less < r ? less : r;
    }
}

int64_t strokes_size(const strokes_image *image)
{
    return (int64_t)hypot((double)image->width, (double)image->height) + 2;
}

void strokes_darkest(const strokes_image *image, const uint8_t *px, uint8_t *out)
{
    const int w = (int)image->width;
    for (int row = 0; row < (int)image->height; row++) {
        darkest_row(w, px + (size_t)row * (size_t)image->stride, image->bright ? 0 : 255, out + (size_t)row * (size_t)w);
    }
}

/* The shade, from `from` on, that separates a histogram into two classes of the largest variance between them.
 *
 * Source: Otsu, A threshold selection method from gray-level histograms, IEEE Trans. Systems, Man and Cybernetics 9(1), 1979. */
static int otsu(const int32_t *count, int from)
{
    double all = 0.0, sum = 0.0, below = 0.0, sum_below = 0.0, most = 0.0;
    int best = from;
    for (int k = from; k < SHADES; k++) {
        all += count[k];
        sum += (double)k * count[k];
    }
    for (int k = from; k < SHADES; k++) {
        below += count[k];
        sum_below += (double)k * count[k];
        if (below > 0.0 && below < all) {
            const double apart = sum_below / below - (sum - sum_below) / (all - below);
            const double between = below * (all - below) * apart * apart;
            if (between > most) {
                most = between;
                best = k;
            }
        }
    }
    return best;
}

int strokes_limits(int n, const uint8_t *grey, int limits[2])
{
    int32_t count[SHADES];
    int above = 0;
    memset(count, 0, sizeof count);
    for (int i = 0; i < n; i++) {
        count[grey[i]]++;
    }
    limits[0] = otsu(count, 0);
    for (int k = limits[0] + 1; k < SHADES; k++) {
        above += count[k];
    }
    if (above <= FEW_ABOVE || limits[0] + 1 >= SHADES) {
        return 1;
    }
    limits[1] = otsu(count, limits[0] + 1);
    return limits[1] > limits[0] + UPPER_BY ? 2 : 1;
}

/* Sobel's gradient at a pixel. */
static void slope_at(const uint8_t *at, int w, int slope[2])
{
    const uint8_t *above = at - w, *below = at + w;
    slope[0] = (above[1] - above[-1]) + 2 * (at[1] - at[-1]) + (below[1] - below[-1]);
    slope[1] = (below[-1] - above[-1]) + 2 * (below[0] - above[0]) + (below[1] - above[1]);
}

int strokes_direction(int w, int h, const uint8_t *grey, double *angle)
{
    int most = 0, strong = 0, slope[2];
    double across = 0.0, along = 0.0;
    for (int row = 1; row < h - 1; row++) {
        for (int i = 1; i < w - 1; i++) {
            slope_at(grey + row * w + i, w, slope);
            const int squared = slope[0] * slope[0] + slope[1] * slope[1];
            most = squared > most ? squared : most;
        }
    }
    const int least = (int)(STRONG_EDGE * (float)most);
    for (int row = 1; row < h - 1; row++) {
        for (int i = 1; i < w - 1; i++) {
            slope_at(grey + row * w + i, w, slope);
            const int squared = slope[0] * slope[0] + slope[1] * slope[1];
            if (squared > least) {
                const double re = (double)(slope[0] * slope[0] - slope[1] * slope[1]), im = 2.0 * slope[0] * slope[1];
                const double by = 1.0 / ((double)squared * sqrt((double)squared));
                across += (re * re - im * im) * by;
                along += 2.0 * re * im * by;
                strong++;
            }
        }
    }
    *angle = 0.25 * atan2(along, across);
    return strong >= FEW_STRONG;
}

/* A place of the small frame on the plane; returns whether its ray meets the plane. */
static int on_plane(const dl_lens *c, const strokes_image *image, double u, double v, double out[2])
{
    const double step = (double)image->step;
    double ray[3] = {0.0, 0.0, 1.0}, at[3];
    camera_ray(c, (u + 0.5) * step - 0.5, (v + 0.5) * step - 0.5, ray);
    rotated_back(image->R_cam_plane, ray, at);
    out[0] = at[0] / at[2], out[1] = at[1] / at[2];
    return at[2] > LEAST_FACING;
}

int strokes_place(const dl_lens *c, const strokes_image *image, double angle, upright_view *out)
{
    const double u = 0.5 * (double)(image->width - 1), v = 0.5 * (double)(image->height - 1), step = (double)image->step;
    double centre[2], ahead[2];
    if (!on_plane(c, image, u, v, centre) || !on_plane(c, image, u + 4.0 * cos(angle), v + 4.0 * sin(angle), ahead)) {
        return 0;
    }
    out->turn = atan2(ahead[1] - centre[1], ahead[0] - centre[0]);
    out->focal = c->fx / step;
    out->size = (int)strokes_size(image);
    const double cs = cos(out->turn) / out->focal, sn = sin(out->turn) / out->focal, mid = 0.5 * (out->size - 1);
    const double to[9] = {cs, -sn, centre[0] - (cs - sn) * mid, sn, cs, centre[1] - (sn + cs) * mid, 0.0, 0.0, 1.0};
    const double K[9] = {out->focal, 0.0, (c->cx + 0.5) / step - 0.5, 0.0, c->fy / step, (c->cy + 0.5) / step - 0.5, 0.0, 0.0, 1.0};
    double across[9];
    memcpy(out->to_plane, to, sizeof to);
    product(image->R_cam_plane, to, across);
    product(K, across, out->to_frame);
    return 1;
}

/* A row of the frame seen from straight above; -1 outside of the frame. */
WIDE
static void upright_row(const strokes_image *image, const double M[9], int n, int row, const uint8_t *grey, int16_t *out)
{
    const int w = (int)image->width, h = (int)image->height;
    const float y[3] = {(float)(M[1] * row + M[2]), (float)(M[4] * row + M[5]), (float)(M[7] * row + M[8])};
    const float x[3] = {(float)M[0], (float)M[3], (float)M[6]};
    for (int i = 0; i < n; i++) {
        const float z = x[2] * (float)i + y[2], by = z > 1e-3f ? 1.0f / z : 0.0f;
        const float u = z > 1e-3f ? (x[0] * (float)i + y[0]) * by : -1.0f, v = (x[1] * (float)i + y[1]) * by;
        if (!(u >= 0.0f && v >= 0.0f && u < (float)(w - 1) && v < (float)(h - 1))) {
            out[i] = -1;
            continue;
        }
        const int left = (int)u, top = (int)v;
        const float across = u - (float)left, along = v - (float)top;
        const uint8_t *at = grey + top * w + left;
        const float upper = (float)at[0] + across * (float)(at[1] - at[0]);
        const float lower = (float)at[w] + across * (float)(at[w + 1] - at[w]);
        out[i] = (int16_t)(upper + along * (lower - upper) + 0.5f);
    }
}

void strokes_upright(const strokes_image *image, const upright_view *view, const uint8_t *grey, int16_t *out)
{
    for (int row = 0; row < view->size; row++) {
        upright_row(image, view->to_frame, view->size, row, grey, out + (size_t)row * (size_t)view->size);
    }
}
