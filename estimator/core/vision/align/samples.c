/* Sample a part of a frame: its light, the drawing's coverage there, and the trust in each sample. */

#include <math.h>
#include <stddef.h>
#include <string.h>

#include "base/arena.h"
#include "vision/align/align.h"
#include "base/lanes.h"
#include "base/wide.h"

/* Fewest samples that are used. */
enum { LEAST_SAMPLES = 40 };
/* Work of a pixel's light, and of smoothing it over each pixel beside it. */
enum { LIGHT_WORK = 45, SMOOTH_WORK = 8 };
/* Samples between the one that is read and the one whose cells are fetched. */
enum { AHEAD = 8 };
/* Length over depth, in `pad`, of a ray beyond which it meets the pad's plane too far away. */
static const float MOST_PER_DEPTH = 20.0f;

int64_t align_divide(int64_t width, int64_t height, float *scratch, pixels *from, samples *s)
{
    const int64_t n = width * height, number = sizeof(float), row = (n + SAMPLE_LANES - 1) / SAMPLE_LANES * SAMPLE_LANES * number;
    arena a = {scratch, 0};
    float **rows[] = {
        &from->x, &from->y, &from->light[0], &from->light[1], &from->light[2], &from->local[0], &from->local[1], &from->local[2],
        &s->light[0], &s->light[1], &s->light[2], &s->coverage[0], &s->coverage[1], &s->coverage[2], &s->coverage[3],
        &s->slope_x[0], &s->slope_x[1], &s->slope_x[2], &s->slope_x[3], &s->slope_y[0], &s->slope_y[1], &s->slope_y[2],
        &s->slope_y[3], &s->x, &s->y, &s->a, &s->b, &s->weight, &s->residual[0], &s->residual[1], &s->residual[2], &s->squared,
        &from->trust,
    };
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        *rows[i] = take(&a, row);
    }
    s->pixel = take(&a, row), s->spare = take(&a, row);
    from->wide = take(&a, (width + 2 * LOCAL_MAX) * number);
    from->n = (int)n;
    return arena_numbers(&a);
}

/* The taps of a Gaussian, from the middle; returns how many there are beside it. A neighbourhood wider than LOCAL_MAX is cut. */
static int gaussian(double sigma, float taps[LOCAL_MAX + 1])
{
    const double narrowed = fmin(sigma, LOCAL_MAX / 4.0);
    const int radius = (int)fmax(0.0, fmin(LOCAL_MAX, (double)((lrint(narrowed * 8.0 + 1.0) | 1) / 2)));
    double sum = 0.0, exact[LOCAL_MAX + 1];
    for (int k = 0; k <= radius; k++) {
        exact[k] = exp(-0.5 * k * k / (narrowed * narrowed));
        sum += k == 0 ? exact[k] : 2.0 * exact[k];
    }
    for (int k = 0; k <= radius; k++) {
        taps[k] = (float)(exact[k] / sum);
    }
    return radius;
}

/* Rows smoothed along themselves, the last value repeated at the ends. */
WIDE
static void smooth_rows(int w, int h, int radius, const float *taps, const float *in, float *wide, float *out)
{
    for (int row = 0; row < h; row++, in += w, out += w) {
        for (int i = 0; i < radius; i++) {
            wide[i] = in[0];
            wide[radius + w + i] = in[w - 1];
        }
        memcpy(wide + radius, in, (size_t)w * sizeof *in);
        for (int i = 0; i < w; i++) {
            out[i] = taps[0] * wide[radius + i];
        }
        for (int k = 1; k <= radius; k++) {
            const float tap = taps[k], *left = wide + radius - k, *right = wide + radius + k;
            for (int i = 0; i < w; i++) {
                out[i] += tap * (left[i] + right[i]);
            }
        }
    }
}

/* Subtract from each row of an image the rows around it, smoothed. */
WIDE
static void subtract_smoothed(int w, int h, int radius, const float *taps, const float *rows, float *wide, float *image)
{
    for (int row = 0; row < h; row++, image += w) {
        for (int i = 0; i < w; i++) {
            wide[i] = taps[0] * rows[row * w + i];
        }
        for (int k = 1; k <= radius; k++) {
            const float tap = taps[k], *above = rows + (row > k ? row - k : 0) * w;
            const float *below = rows + (row + k < h ? row + k : h - 1) * w;
            for (int i = 0; i < w; i++) {
                wide[i] += tap * (above[i] + below[i]);
            }
        }
        for (int i = 0; i < w; i++) {
            image[i] -= wide[i];
        }
    }
}

void align_light(const dl_tracker *t, const seen_part *seen, double depth_m, int with_local, float *spare, pixels *out)
{
    const frame_part *part = &seen->part;
    const float *light = t->lights;
    const int w = (int)part->width, h = (int)part->height;
    camera_rays(&t->camera.lens, part, out->x, out->y);
    count_work(t, out->n, LIGHT_WORK);
    out->side_m = (double)(1 << part->level) * depth_m / t->camera.lens.fx;
    for (int row = 0; row < h; row++) {
        const uint8_t *from = seen->px + (size_t)row * (size_t)seen->stride;
        for (int k = 0; k < 3; k++) {
            float *linear = out->light[k] + row * w, *root = out->local[k] + row * w;
            for (int i = 0; i < w; i++) {
                linear[i] = light[from[3 * i + k]];
                root[i] = light[256 + from[3 * i + k]];
            }
        }
    }
    if (with_local) {
        float taps[LOCAL_MAX + 1];
        const int radius = gaussian(t->pad.drawn.local_m / out->side_m, taps);
        count_work(t, out->n, SMOOTH_WORK * radius);
        for (int k = 0; k < 3; k++) {
            smooth_rows(w, h, radius, taps, out->local[k], out->wide, spare);
            subtract_smoothed(w, h, radius, taps, spare, out->wide, out->local[k]);
        }
    }
}

/* Where each ray meets the pad's plane; its length over its depth there is left in `squared`. */
WIDE
static void meet_plane(const pixels *from, const dl_pad_pose *pose, samples *s)
{
    float R[9], c[3];
    for (int j = 0; j < 3; j++) {
        for (int i = 0; i < 3; i++) {
            R[3 * j + i] = (float)pose->R[3 * i + j];
        }
        c[j] = (float)(pose->R[j] * pose->t[0] + pose->R[3 + j] * pose->t[1] + pose->R[6 + j] * pose->t[2]);
    }
    for (int at = 0; at < from->n; at += SAMPLE_LANES) {
        const float8 x = *eight(from->x + at), y = *eight(from->y + at);
        const float8 by = 1.0f / (R[6] * x + R[7] * y + R[8]);
        const float8 a = (R[0] * x + R[1] * y + R[2]) * by, b = (R[3] * x + R[4] * y + R[5]) * by;
        *eight(s->squared + at) = by;
        *eight(s->a + at) = a;
        *eight(s->b + at) = b;
        *eight(s->x + at) = a * c[2] - c[0];
        *eight(s->y + at) = b * c[2] - c[1];
    }
}

/* Keep the rays that meet the plane within a radius, and fill the last group of samples with zeros. */
static void keep_within(double limit, const pixels *from, samples *s)
{
    const float limit2 = (float)(limit * limit);
    int n = 0;
    for (int i = 0; i < from->n; i++) {
        const int faces = s->squared[i] > 0.0f && s->squared[i] < MOST_PER_DEPTH && from->trust[i] > 0.0f;
        if (faces && s->x[i] * s->x[i] + s->y[i] * s->y[i] < limit2) {
            s->x[n] = s->x[i], s->y[n] = s->y[i], s->a[n] = s->a[i], s->b[n] = s->b[i];
            s->pixel[n++] = i;
        }
    }
    s->n = n;
    s->room = (n + SAMPLE_LANES - 1) / SAMPLE_LANES * SAMPLE_LANES;
    for (int i = n; i < s->room; i++) {
        s->x[i] = s->y[i] = s->a[i] = s->b[i] = 0.0f;
    }
}

int align_trust(const double cut[3], pixels *from)
{
    const float a = (float)cut[0], b = (float)cut[1], c = (float)cut[2];
    int used = 0;
    for (int i = 0; i < from->n; i++) {
        const int beyond = a * from->x[i] + b * from->y[i] + c < 0.0f;
        from->trust[i] = beyond ? 0.0f : 1.0f;
        used += !beyond;
    }
    return used;
}

const int16_t *align_map(const dl_pad_template *p, const int16_t *maps, int blur)
{
    return maps + (size_t)blur * (size_t)(p->n * p->n) * 4;
}

int align_blur(const dl_pad_template *p, double sigma_m)
{
    int best = 0;
    for (int k = 1; k < DL_TEMPLATE_BLURS; k++) {
        if (fabs(p->log_blur[k] - log(sigma_m)) < fabs(p->log_blur[best] - log(sigma_m))) {
            best = k;
        }
    }
    return best;
}

/* The cell of a map before each sample, as `align_cell`, and the ways to the next, along x and along y. */
WIDE
static void find_cells(const dl_pad_template *p, samples *s, float *restrict ahead_x, float *restrict ahead_y)
{
    const float per_m = (float)p->per_m, mid = (float)(p->n / 2), last = (float)(p->n - 3);
    const int n = (int)p->n;
    uint32_t *restrict cells = s->spare;
    for (int i = 0; i < s->n; i++) {
        const float x = s->x[i] * per_m + mid, y = s->y[i] * per_m + mid;
        const float inside_x = x > 1.0f ? x < last ? x : last : 1.0f, inside_y = y > 1.0f ? y < last ? y : last : 1.0f;
        const int cell_x = (int)inside_x, cell_y = (int)inside_y;
        ahead_x[i] = inside_x - (float)cell_x;
        ahead_y[i] = inside_y - (float)cell_y;
        cells[i] = (uint32_t)(cell_x * n + cell_y);
    }
}

/* Bring near what a sample some way ahead needs of a map: it is larger than what lies near a processor. */
static inline void fetch_rows(const samples *s, const int16_t *map, int i, int down, int first, int end)
{
    const uint32_t cell = s->spare[i + AHEAD < s->n ? i + AHEAD : s->n - 1];
    for (int k = first; k < end; k++) {
        lanes_fetch((uintptr_t)(map + 4 * (size_t)cell) + (uintptr_t)((ptrdiff_t)sizeof *map * down * k));
    }
}

WIDE
void align_coverage(const dl_pad_template *p, const int16_t *map, samples *s)
{
    const int down = 4 * (int)p->n;
    find_cells(p, s, s->coverage[0], s->coverage[1]);
    for (int i = 0; i < s->n; i++) {
        const float along = s->coverage[0][i], across = s->coverage[1][i];
        const int16_t *cell = map + 4 * (size_t)s->spare[i];
        fetch_rows(s, map, i, down, 0, 2);
        const float4 here = four_between(cell, cell + 4, across), next = four_between(cell + down, cell + down + 4, across);
        const float4 at = (here + along * (next - here)) * (1.0f / DL_TEMPLATE_ONE);
        for (int k = 0; k < 4; k++) {
            s->coverage[k][i] = at[k];
        }
    }
    for (int k = 0; k < 4; k++) {
        for (int i = s->n; i < s->room; i++) {
            s->coverage[k][i] = 0.0f;
        }
    }
}

/* Coverage and its slopes: central differences between the cells of the map, and linear between these. */
WIDE
static void sample_slopes(const dl_pad_template *p, const int16_t *map, samples *s)
{
    const int down = 4 * (int)p->n;
    const float one = 1.0f / DL_TEMPLATE_ONE, half = (float)(0.5 * p->per_m) / DL_TEMPLATE_ONE;
    find_cells(p, s, s->slope_x[0], s->slope_y[0]);
    for (int i = 0; i < s->n; i++) {
        const float fx = s->slope_x[0][i], fy = s->slope_y[0][i];
        const int16_t *cell = map + 4 * (size_t)s->spare[i];
        fetch_rows(s, map, i, down, -1, 3);
        float4 row[4], column[4];
        for (int k = 0; k < 4; k++) {
            row[k] = four_between(cell + down * (k - 1), cell + down * (k - 1) + 4, fy);
            column[k] = four_between(cell + 4 * (k - 1), cell + 4 * (k - 1) + down, fx);
        }
        const float4 at = (row[1] + fx * (row[2] - row[1])) * one;
        const float4 by_x = (row[2] - row[0] + fx * (row[3] - row[1] - row[2] + row[0])) * half;
        const float4 by_y = (column[2] - column[0] + fy * (column[3] - column[1] - column[2] + column[0])) * half;
        for (int k = 0; k < 4; k++) {
            s->coverage[k][i] = at[k], s->slope_x[k][i] = by_x[k], s->slope_y[k][i] = by_y[k];
        }
    }
    for (int k = 0; k < 4; k++) {
        for (int i = s->n; i < s->room; i++) {
            s->coverage[k][i] = s->slope_x[k][i] = s->slope_y[k][i] = 0.0f;
        }
    }
}

void align_take(float *const light[3], samples *s)
{
    for (int k = 0; k < 3; k++) {
        const float *from = light[k];
        float *to = s->light[k];
        for (int i = 0; i < s->n; i++) {
            to[i] = from[s->pixel[i]];
        }
        for (int i = s->n; i < s->room; i++) {
            to[i] = 0.0f;
        }
    }
}

int align_samples(const dl_pad_template *p, const int16_t *map, const pixels *from, const dl_pad_pose *pose, int slopes, samples *s)
{
    meet_plane(from, pose, s);
    keep_within(fmin(p->reach_m - 2.0 / p->per_m, AROUND_RADII * p->disc_radius_m + from->side_m), from, s);
    if (s->n < LEAST_SAMPLES) {
        return 0;
    }
    if (slopes) {
        sample_slopes(p, map, s);
    } else {
        align_coverage(p, map, s);
    }
    return 1;
}
