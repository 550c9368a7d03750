/* Cut the patch of a frame that shows a distant pad, in linear light. */

#include "vision/register/patch.h"

#include <math.h>
#include <stddef.h>

#include "vision/tracker.h"

/* The fewest pixels that a fit is tried with, and the fewest lines and columns of their grid. */
enum { PIXELS_MIN = 24, SIDE_MIN = 4, RIM_POINTS = 24 };
/* Depth below which a point of the disc's rim counts as behind the camera, m. */
static const double IN_FRONT_M = 0.02;
/* Reach of the smoothing and of a cut's own blur, px of the reduced grid. */
static const double SMOOTHED_PX = 2.0;

/* Sampling step of pixels for the noise, by the light's slope over this many values to either side; the light that a dark sensor's noise
 * amounts to. */
enum { NOISE_EVERY = 4, NOISE_REACH = 8 };
static const double DARK_PATCH = 0.01; /* That light. */

/* Part of the frame: px, upper limits excluded. */
typedef struct {
    int x0, y0, x1, y1;
} part;

/* A number in 0 to `most`; nan counts as 0. */
static int within(double value, int most)
{
    return value > 0.0 ? value < most ? (int)value : most : 0;
}

/* The disc's rim in `cam`; returns how many of its points lie in front of the camera. */
static int rim_of(const dl_pad_shape *pad, const fit_state *s, double rim[RIM_POINTS][3])
{
    int front = 0;
    for (int i = 0; i < RIM_POINTS; i++) {
        const double a = i * (2.0 * 3.14159265358979323846 / RIM_POINTS);
        in_camera(s, pad->disc_radius_m * cos(a), pad->disc_radius_m * sin(a), rim[i]);
        front += rim[i][2] > IN_FRONT_M;
    }
    return front;
}

static part around_rim(const dl_lens *camera, double rim[RIM_POINTS][3], double margin_px)
{
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
    for (int i = 0; i < RIM_POINTS; i++) {
        double uv[2];
        camera_project(camera, rim[i], uv);
        for (int k = 0; k < 2; k++) {
            low[k] = fmin(low[k], uv[k]);
            high[k] = fmax(high[k], uv[k]);
        }
    }
    const int w = (int)camera->width, h = (int)camera->height;
    const part out = {within(floor(low[0] - margin_px), w), within(floor(low[1] - margin_px), h),
                      within(ceil(high[0] + margin_px) + 1.0, w), within(ceil(high[1] + margin_px) + 1.0, h)};
    return out;
}

/* The part of the frame about the disc, and the whole factor that reduces it; 0 if it is too small. */
static int choose_part(const view *v, const dl_pad_shape *pad, const fit_state *s, double margin_px, part *p, int *factor)
{
    double rim[RIM_POINTS][3];
    const int front = rim_of(pad, s, rim);
    int k = 1;
    for (int round = 0; round < 2 && front > 0; round++) {
        const part whole = {0, 0, (int)v->camera->width, (int)v->camera->height};
        *p = front == RIM_POINTS ? around_rim(v->camera, rim, margin_px * k) : whole;
        if (p->x1 - p->x0 < SIDE_MIN || p->y1 - p->y0 < SIDE_MIN) {
            return 0;
        }
        k = (int)fmax(1.0, ceil(sqrt((double)(p->x1 - p->x0) * (p->y1 - p->y0) / DENSE_PIXELS)));
        if (k == 1) {
            break;
        }
    }
    *factor = k;
    return front > 0 && (p->x1 - p->x0) / k >= SIDE_MIN && (p->y1 - p->y0) / k >= SIDE_MIN;
}

/* The mean linear light of squares of k by k pixels, channel after channel. */
static void average(const view *v, const part *p, int k, int columns, int lines, float *out)
{
    const float per = 1.0f / (float)(k * k);
    const int64_t width = v->camera->width;
    for (int j = 0; j < lines; j++) {
        for (int i = 0; i < columns; i++) {
            float sum[CHANNELS] = {0.0f};
            for (int b = 0; b < k; b++) {
                const uint8_t *px = v->pixels + 3 * ((p->y0 + j * k + b) * width + p->x0 + i * k);
                for (int a = 0; a < 3 * k; a += 3) {
                    sum[0] += v->light[px[a]], sum[1] += v->light[px[a + 1]], sum[2] += v->light[px[a + 2]];
                }
            }
            for (int c = 0; c < CHANNELS; c++) {
                out[(c * lines + j) * columns + i] = sum[c] * per;
            }
        }
    }
}

/* (1, 2, 1) / 4 in both directions at a place inside the grid. After this filter the remaining fine detail resembles a Gaussian blur
 * for any lens, pixel and colour filter interpolation. Without it their true shape, which is unknown, biases thin strokes. */
static float smoothed(const float *at, int columns)
{
    const float *above = at - columns, *below = at + columns;
    return 0.0625f * ((above[-1] + above[1]) + (below[-1] + below[1]) + 2.0f * ((above[0] + below[0]) + (at[-1] + at[1])) + 4.0f * at[0]);
}

/* Every inner pixel of the grid, with its ray. */
static void list_pixels(const view *v, const part *p, patch *out)
{
    const int k = out->reduced;
    const double offset = 0.5 * (k - 1);
    out->n = 0;
    for (int j = 1; j < out->lines - 1; j++) {
        for (int i = 1; i < out->columns - 1; i++) {
            double ray[2];
            if (k == 1) {
                pixel_ray(v->camera, v->rays, p->x0 + i, p->y0 + j, ray);
            } else {
                camera_ray(v->camera, p->x0 + k * i + offset, p->y0 + k * j + offset, ray);
            }
            out->ray_x[out->n] = (float)ray[0], out->ray_y[out->n] = (float)ray[1];
            out->at[out->n++] = j * out->columns + i;
        }
    }
}

/* Keep the pixels within `reach_m` of the centre, and away from what a cut hides. */
static void keep_near(const view *v, const fit_state *s, double reach_m, footprint *f, patch *out)
{
    const double margin = SMOOTHED_PX * out->reduced / v->camera->fx * hypot(v->cut[0], v->cut[1]);
    const float a = (float)v->cut[0], b = (float)v->cut[1], c = (float)(v->cut[2] - margin);
    const float most = (float)(reach_m * reach_m);
    int kept = 0;
    f->n = out->n;
    look_at(s, out->ray_x, out->ray_y, f);
    for (int i = 0; i < out->n; i++) {
        out->ray_x[kept] = out->ray_x[i], out->ray_y[kept] = out->ray_y[i], out->at[kept] = out->at[i];
        kept += f->x[i] * f->x[i] + f->y[i] * f->y[i] < most && a * out->ray_x[i] + b * out->ray_y[i] + c >= 0.0f;
    }
    out->n = kept;
}

static void read_light(const float *light, patch *out)
{
    const int columns = out->columns, lines = out->lines;
    for (int i = 0; i < out->n; i++) {
        const int at = out->at[i];
        out->slope[0][i] = (float)(2.0 * (at % columns) / (columns - 1) - 1.0);
        out->slope[1][i] = (float)(2.0 * (at / columns) / (lines - 1) - 1.0);
        for (int c = 0; c < CHANNELS; c++) {
            out->light[c][i] = smoothed(light + c * lines * columns + at, columns);
        }
    }
}

/* Fill up to whole lanes with copies of the last pixel, whose weights are zero everywhere. */
static void fill_up(patch *p)
{
    float *all[] = {p->ray_x, p->ray_y, p->light[0], p->light[1], p->light[2], p->slope[0], p->slope[1]};
    for (int i = p->n; i % LANES; i++) {
        for (size_t k = 0; k < sizeof all / sizeof *all; k++) {
            all[k][i] = all[k][p->n - 1];
        }
    }
}

/* The variance over light that the frame's noise leaves in smoothed light, mean of some pixels; the light's slope over their values
 * turns one into the other. */
static double expected_noise(const view *v, const part *p, const patch *cut)
{
    const double value = 255.0 * v->noise, left = value * value * NOISE_LEFT / (cut->reduced * cut->reduced);
    double sum = 0.0;
    int count = 0;
    for (int i = 0; i < cut->n && value > 0.0; i += NOISE_EVERY) {
        const int k = cut->reduced, row = p->y0 + k * (cut->at[i] / cut->columns), column = p->x0 + k * (cut->at[i] % cut->columns);
        const uint8_t *px = v->pixels + 3 * (row * v->camera->width + column);
        for (int c = 0; c < CHANNELS; c++, count++) {
            const int low = px[c] > NOISE_REACH ? px[c] - NOISE_REACH : 0, high = px[c] < 255 - NOISE_REACH ? px[c] + NOISE_REACH : 255;
            const double slope = (double)(v->light[high] - v->light[low]) / (high - low);
            sum += slope * slope / ((double)v->light[px[c]] + DARK_PATCH);
        }
    }
    return count ? left * sum / count : 0.0;
}

int cut_patch(const view *v, const dl_pad_shape *pad, const fit_state *s, double margin_px, rows *r, const patch_work *work,
              patch *out)
{
    part p;
    int k;
    float *all = take_rows(r, PATCH_ROWS);
    if (!all || !choose_part(v, pad, s, margin_px, &p, &k)) {
        return 0;
    }
    out->columns = (p.x1 - p.x0) / k, out->lines = (p.y1 - p.y0) / k, out->reduced = k;
    out->ray_x = all, out->ray_y = all + r->length;
    for (int c = 0; c < CHANNELS; c++) {
        out->light[c] = all + (2 + c) * r->length;
    }
    out->slope[0] = all + 5 * r->length, out->slope[1] = all + 6 * r->length;
    out->at = (int32_t *)(void *)(all + 7 * r->length);
    average(v, &p, k, out->columns, out->lines, work->light);
    out->state = reduced(s, k, SMOOTHING_PX2);
    list_pixels(v, &p, out);
    keep_near(v, &out->state, pad->disc_radius_m + margin_px * out->state.m_per_px, work->f, out);
    read_light(work->light, out);
    if (out->n < PIXELS_MIN) {
        return 0;
    }
    fill_up(out);
    out->noise = expected_noise(v, &p, out);
    return 1;
}
