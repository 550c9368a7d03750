/* Find the edges of a grey image and their directions. */

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "vision/search/search.h"
#include "base/wide.h"

static const float LEAST_STRENGTH = 14.0f; /* Least strength of an edge, in Sobel's sums of bytes. */
static const float LEAST_RELATIVE = 1.9f; /* The same relative to the mean of the blocks around it. */
/* Least cosine between a ray and the plane's normal. */
static const double LEAST_EDGE_FACING = 0.15;
/* Tangent of 67.5 degrees. */
static const int STEEP_NUM = 169, STEEP_DEN = 70;
/* More than any strength of Sobel's sums, and marks that are read at once. */
enum { STRONGEST = 32767, MARKS = 8 };

/* Sobel's gradient of a row, and its length. */
WIDE
static void gradient_row(int w, const uint8_t *above, const uint8_t *here, const uint8_t *below, int16_t *gx, int16_t *gy,
                         uint16_t *strength)
{
    for (int i = 1; i < w - 1; i++) {
        const int x = (above[i + 1] - above[i - 1]) + 2 * (here[i + 1] - here[i - 1]) + (below[i + 1] - below[i - 1]);
        const int y = (below[i - 1] - above[i - 1]) + 2 * (below[i] - above[i]) + (below[i + 1] - above[i + 1]);
        gx[i] = (int16_t)x;
        gy[i] = (int16_t)y;
    }
    for (int i = 1; i < w - 1; i++) {
        strength[i] = (uint16_t)sqrtf((float)(gx[i] * gx[i] + gy[i] * gy[i]));
    }
    gx[0] = gy[0] = gx[w - 1] = gy[w - 1] = 0;
    strength[0] = strength[w - 1] = 0;
}

static void gradients(const search_image *image, const uint8_t *grey, search_rows *rows)
{
    const int w = (int)image->width, h = (int)image->height;
    const size_t stride = (size_t)image->stride;
    for (int row = 0; row < h; row++) {
        const uint8_t *here = grey + (size_t)row * stride;
        int16_t *gx = rows->slope_x + (size_t)row * (size_t)w, *gy = rows->slope_y + (size_t)row * (size_t)w;
        uint16_t *strength = rows->strength + (size_t)row * (size_t)w;
        if (row == 0 || row == h - 1) {
            for (int i = 0; i < w; i++) {
                gx[i] = gy[i] = 0;
                strength[i] = 0;
            }
        } else {
            gradient_row(w, here - stride, here, here + stride, gx, gy, strength);
        }
    }
}

/* The mean strength of each block. */
WIDE
static void block_means(const search_image *image, const search_rows *rows, float *out)
{
    const block_grid *b = &rows->blocks;
    const int w = (int)image->width, h = (int)image->height;
    for (int i = 0; i < b->rows; i++) {
        for (int j = 0; j < b->columns; j++) {
            const int left = j * DL_SEARCH_BLOCK, right = left + DL_SEARCH_BLOCK < w ? left + DL_SEARCH_BLOCK : w;
            const int top = i * DL_SEARCH_BLOCK, low = top + DL_SEARCH_BLOCK < h ? top + DL_SEARCH_BLOCK : h;
            uint32_t sum = 0;
            for (int row = top; row < low; row++) {
                for (int k = left; k < right; k++) {
                    sum += rows->strength[(size_t)row * (size_t)w + (size_t)k];
                }
            }
            out[i * b->columns + j] = (float)sum / (float)((right - left) * (low - top));
        }
    }
}

/* The least strength of an edge in each block. Blocks whose plane cannot be seen have no edges. */
static void least_strengths(const float *means, block_grid *b)
{
    for (int i = 0; i < b->rows; i++) {
        for (int j = 0; j < b->columns; j++) {
            float sum = 0.0f;
            int n = 0;
            for (int y = i > 0 ? i - 1 : 0; y <= i + 1 && y < b->rows; y++) {
                for (int x = j > 0 ? j - 1 : 0; x <= j + 1 && x < b->columns; x++) {
                    sum += means[y * b->columns + x];
                    n++;
                }
            }
            const float *scale = b->scale + 4 * (i * b->columns + j);
            const int seen = isfinite(scale[0] + scale[1] + scale[2] + scale[3]);
            b->least[i * b->columns + j] = seen ? fmaxf(LEAST_STRENGTH, LEAST_RELATIVE * sum / (float)n) : INFINITY;
        }
    }
}

/* The corners of the blocks on the plane; nan where a ray misses it. */
static void corners_on_plane(const search_image *image, const float *rays, block_grid *b)
{
    const double *R = image->R_cam_plane;
    for (int k = 0; k < (b->rows + 1) * (b->columns + 1); k++) {
        const double x = (double)rays[2 * k], y = (double)rays[2 * k + 1], z = R[2] * x + R[5] * y + R[8];
        const double by = z > LEAST_EDGE_FACING ? 1.0 / z : (double)NAN;
        b->corners[2 * k] = (float)((R[0] * x + R[3] * y + R[6]) * by);
        b->corners[2 * k + 1] = (float)((R[1] * x + R[4] * y + R[7]) * by);
    }
}

/* The pixels per unit of the plane in each block: the inverse of the plane's differences between its corners. */
static void block_scales(block_grid *b)
{
    const float by = 0.5f / DL_SEARCH_BLOCK;
    for (int i = 0; i < b->rows; i++) {
        for (int j = 0; j < b->columns; j++) {
            const float *top = b->corners + 2 * (i * (b->columns + 1) + j), *low = top + 2 * (b->columns + 1);
            float d[4], *scale = b->scale + 4 * (i * b->columns + j);
            for (int k = 0; k < 2; k++) {
                d[2 * k] = (top[2 + k] - top[k] + low[2 + k] - low[k]) * by;
                d[2 * k + 1] = (low[k] - top[k] + low[2 + k] - top[2 + k]) * by;
            }
            const float over = 1.0f / (d[0] * d[3] - d[1] * d[2]);
            scale[0] = d[3] * over, scale[1] = -d[1] * over, scale[2] = -d[2] * over, scale[3] = d[0] * over;
        }
    }
}

/* How far the ridge is from a pixel along a direction, in steps to its neighbours; nan if it lies elsewhere. */
static float ridge(const uint16_t *at, ptrdiff_t step)
{
    const float before = (float)at[-step], here = (float)*at, after = (float)at[step];
    if (!(here > before && here >= after)) {
        return NAN;
    }
    return 0.5f * (before - after) / (before - 2.0f * here + after);
}

/* Add the edge at a pixel if the gradient is largest there along its own direction.
 *
 * Source: Canny, A computational approach to edge detection, PAMI 8(6), 1986, section VI, with four directions. */
static void add_edge(int w, int row, int column, const search_rows *rows, const float *scale, edge_list *edges)
{
    const size_t i = (size_t)row * (size_t)w + (size_t)column;
    const int gx = rows->slope_x[i], gy = rows->slope_y[i];
    const int dx = abs(gx) * STEEP_NUM > abs(gy) * STEEP_DEN, dy = abs(gy) * STEEP_NUM > abs(gx) * STEEP_DEN;
    const int down = dx && (gx > 0) != (gy > 0) ? -dy : dy;
    const float off = ridge(rows->strength + i, (ptrdiff_t)down * w + dx);
    if (!(fabsf(off) <= 0.5f)) {
        return;
    }
    const float u = scale[0] * (float)gx + scale[2] * (float)gy, v = scale[1] * (float)gx + scale[3] * (float)gy;
    const float by = 1.0f / sqrtf(u * u + v * v);
    const int n = edges->n++;
    edges->x[n] = (float)column + off * (float)dx;
    edges->y[n] = (float)row + off * (float)down;
    edges->to_x[n] = (scale[0] * u + scale[1] * v) * by;
    edges->to_y[n] = (scale[2] * u + scale[3] * v) * by;
}

/* Mark the pixels of a row, `first` to `end`, that are as strong as an edge, and stronger than their neighbours in some direction. */
WIDE
static void mark_ridges(int first, int end, ptrdiff_t w, const uint16_t *strength, const int16_t *least, uint8_t *restrict marks)
{
    const int16_t *at = (const int16_t *)(const void *)strength, *above = at - w, *below = at + w;
    for (int i = first; i < end; i++) {
        const int16_t here = at[i];
        const int on_row = (here > at[i - 1]) & (here >= at[i + 1]), on_column = (here > above[i]) & (here >= below[i]);
        const int on_falling = (here > above[i - 1]) & (here >= below[i + 1]);
        const int on_rising = (here > below[i - 1]) & (here >= above[i + 1]);
        marks[i] = (uint8_t)((on_row | on_column | on_falling | on_rising) & (here >= least[i]));
    }
}

/* The least strength of an edge in each column of a row of blocks. */
static void least_of_columns(int w, int row_of_blocks, const block_grid *b, int16_t *out)
{
    for (int block = 0; block < b->columns; block++) {
        const float strength = b->least[row_of_blocks * b->columns + block];
        const int left = block * DL_SEARCH_BLOCK, right = left + DL_SEARCH_BLOCK < w ? left + DL_SEARCH_BLOCK : w;
        const int16_t least = strength < (float)STRONGEST ? (int16_t)ceilf(strength) : STRONGEST;
        for (int i = left; i < right; i++) {
            out[i] = least;
        }
    }
}

void search_edges(const search_image *image, const uint8_t *grey, const float *rays, search_rows *rows)
{
    const int w = (int)image->width, h = (int)image->height;
    block_grid *b = &rows->blocks;
    edge_list *edges = &rows->edges;
    gradients(image, grey, rows);
    corners_on_plane(image, rays, b);
    block_scales(b);
    block_means(image, rows, rows->tiles.score);
    least_strengths(rows->tiles.score, b);
    edges->n = 0;
    memset(rows->marks, 0, (size_t)w + MARKS);
    for (int row = 0; row < h; row++) {
        const size_t at = (size_t)row * (size_t)w;
        const float *scale = b->scale + (size_t)4 * (size_t)(row / DL_SEARCH_BLOCK * b->columns);
        edges->first[row] = edges->n;
        if (row % DL_SEARCH_BLOCK == 0) {
            least_of_columns(w, row / DL_SEARCH_BLOCK, b, rows->least);
        }
        if (row == 0 || row >= h - 1) {
            continue;
        }
        mark_ridges(1, w - 1, w, rows->strength + at, rows->least, rows->marks);
        for (int i = 0; i < w; i += MARKS) {
            uint64_t some;
            memcpy(&some, rows->marks + i, sizeof some);
            for (int k = i; some != 0 && k < i + MARKS && edges->n < image->room; k++) {
                if (rows->marks[k]) {
                    add_edge(w, row, k, rows, scale + 4 * (k / DL_SEARCH_BLOCK), edges);
                }
            }
        }
    }
    edges->first[h] = edges->n;
}

/* The block at a place along one side, or the one nearest to it. */
static int block_at(float at, int count)
{
    const float block = at / DL_SEARCH_BLOCK;
    return block > 0.0f ? block < (float)count ? (int)block : count - 1 : 0;
}

float search_scale(const block_grid *b, float x, float y)
{
    const float *s = b->scale + 4 * (block_at(y, b->rows) * b->columns + block_at(x, b->columns));
    return sqrtf(fabsf(s[0] * s[3] - s[1] * s[2]));
}

int search_place(const block_grid *b, float x, float y, double out[2])
{
    const int j = block_at(x, b->columns), i = block_at(y, b->rows);
    const double u = (double)x / DL_SEARCH_BLOCK - j, v = (double)y / DL_SEARCH_BLOCK - i;
    const float *top = b->corners + 2 * (i * (b->columns + 1) + j), *low = top + 2 * (b->columns + 1);
    for (int k = 0; k < 2; k++) {
        out[k] = (1.0 - v) * ((1.0 - u) * (double)top[k] + u * (double)top[2 + k])
                 + v * ((1.0 - u) * (double)low[k] + u * (double)low[2 + k]);
    }
    return isfinite(out[0]) && isfinite(out[1]);
}
