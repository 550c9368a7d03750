/* Let edges vote for the centres of circles, and find the peaks. */

#include <math.h>
#include <string.h>

#include "vision/search/search.h"
#include "base/wide.h"

enum { CELLS_ACROSS = 2, MOST_VOTES = 255 };
static const float VOTES_AGAINST = 2.0f; /* Votes of the neighbourhood that count against a peak, in means. */
static const float LEAST_OF_CIRCLE = 0.12f; /* Fraction of a circle that a peak must have at least. */
static const float TURN = 6.2831853f;

static int cells(const search_image *image, int64_t px)
{
    return (int)((px + 2 * image->margin) / DL_SEARCH_CELL);
}

static float radius_of(const dl_circle_search *radii, int k)
{
    return (float)(radii->least * pow(radii->ratio, k));
}

/* The cell of the centre of a circle of this radius that each edge belongs to; `outside` beyond the cells. */
WIDE
static void cells_of(const edge_list *edges, float radius, float margin, int columns, int rows, int32_t *restrict out)
{
    const float by = 1.0f / DL_SEARCH_CELL, right = (float)columns, low = (float)rows;
    const float *at_x = edges->x, *at_y = edges->y, *to_x = edges->to_x, *to_y = edges->to_y;
    const int32_t outside = columns * rows;
    for (int i = 0, n = edges->n; i < n; i++) {
        const float x = (at_x[i] + radius * to_x[i] + margin) * by, y = (at_y[i] + radius * to_y[i] + margin) * by;
        const int inside = (x >= 0.0f) & (y >= 0.0f) & (x < right) & (y < low);
        const int32_t cell = (int32_t)(inside ? y : 0.0f) * columns + (int32_t)(inside ? x : 0.0f);
        out[i] = inside ? cell : outside;
    }
}

/* One vote of each edge for its cell. Votes beyond the cells are counted in the last one, which is none of them.
 *
 * Source: Loy and Zelinsky, Fast radial symmetry for detecting points of interest, PAMI 25(8), 2003, section 3. */
static void vote(int n, const int32_t *cells, uint8_t *out)
{
    for (int i = 0; i < n; i++) {
        uint8_t *cell = out + cells[i];
        *cell = (uint8_t)(*cell + (*cell < MOST_VOTES));
    }
}

/* The votes in two by two cells, and the larger of them and what was in `most`; `sum` has the votes of each column. The `last` row
 * has no window. */
WIDE
static void windows(int columns, const uint8_t *here, const uint8_t *below, int last, uint16_t *most, uint16_t *sum)
{
    for (int i = 0; i < columns; i++) {
        sum[i] = (uint16_t)(sum[i] + here[i]);
    }
    for (int i = 0; i < columns - 1 && !last; i++) {
        const uint16_t four = (uint16_t)(here[i] + here[i + 1] + below[i] + below[i + 1]);
        most[i] = most[i] > four ? most[i] : four;
    }
}

/* The largest of each number and the seven after it; those that one of a row's tiles begins with are the tiles'. */
WIDE
static void largest_of_eight(int columns, uint16_t *row)
{
    for (int apart = 1; apart < TILE_CELLS; apart *= 2) {
        for (int i = 0; i < columns; i++) {
            row[i] = row[i] > row[i + apart] ? row[i] : row[i + apart];
        }
    }
}

/* The sum of each number and the seven after it. */
WIDE
static void sums_of_eight(int columns, uint16_t *row)
{
    for (int apart = 1; apart < TILE_CELLS; apart *= 2) {
        for (int i = 0; i < columns; i++) {
            row[i] = (uint16_t)(row[i] + row[i + apart]);
        }
    }
}

/* The largest window and the mean of the votes of each tile. */
static void rate_tiles(int columns, int rows, const uint8_t *votes, uint16_t *row, const vote_tiles *tiles, float *most,
                       float *mean)
{
    const size_t length = (size_t)columns + TILE_CELLS;
    for (int i = 0; i < tiles->rows; i++) {
        const int top = i * TILE_CELLS, low = top + TILE_CELLS < rows ? top + TILE_CELLS : rows;
        memset(row, 0, 2 * length * sizeof *row);
        for (int k = top; k < low; k++) {
            const uint8_t *here = votes + (size_t)k * (size_t)columns;
            windows(columns, here, here + columns, k == rows - 1, row, row + length);
        }
        largest_of_eight(columns, row);
        sums_of_eight(columns, row + length);
        for (int j = 0; j < tiles->columns; j++) {
            const int left = j * TILE_CELLS, right = left + TILE_CELLS < columns ? left + TILE_CELLS : columns;
            most[i * tiles->columns + j] = (float)row[left];
            mean[i * tiles->columns + j] = (float)row[length + (size_t)left] / (float)((right - left) * (low - top));
        }
    }
}

/* The mean over a tile and those around it. */
static float mean_around(const vote_tiles *t, const float *mean, int i, int j)
{
    float sum = 0.0f;
    int n = 0;
    for (int y = i > 0 ? i - 1 : 0; y <= i + 1 && y < t->rows; y++) {
        for (int x = j > 0 ? j - 1 : 0; x <= j + 1 && x < t->columns; x++) {
            sum += mean[y * t->columns + x];
            n++;
        }
    }
    return sum / (float)n;
}

/* The outline of a circle of unit radius in the plane about each tile, px. */
static void outlines(const search_image *image, const block_grid *blocks, const vote_tiles *t, float *out)
{
    for (int k = 0; k < t->rows * t->columns; k++) {
        const int i = k / t->columns, j = k % t->columns;
        const float x = (float)(j * TILE_CELLS * DL_SEARCH_CELL - (int)image->margin);
        const float y = (float)(i * TILE_CELLS * DL_SEARCH_CELL - (int)image->margin);
        out[k] = TURN * search_scale(blocks, x, y);
    }
}

/* The score is in standard deviations of what chance adds to the votes: the longer an outline, the less a fraction of it is chance. */
void search_votes(const search_image *image, const dl_circle_search *radii, search_rows *rows)
{
    const int columns = cells(image, image->width), high = cells(image, image->height), planes = 2 * (int)radii->radii;
    const size_t plane_cells = (size_t)columns * (size_t)high;
    vote_tiles *t = &rows->tiles;
    const int tiles = t->rows * t->columns;
    float *most = t->score + 2 * tiles, *mean = most + tiles, *unit = mean + tiles;
    for (int k = 0; k < 2 * tiles; k++) {
        t->score[k] = 0.0f;
        t->plane[k] = -1;
    }
    outlines(image, &rows->blocks, t, unit);
    const int each = radii->only_bright ? 2 : 1;
    for (int plane = each - 1; plane < planes; plane += each) {
        uint8_t *votes = rows->votes + plane_cells * (size_t)plane;
        const float radius = radius_of(radii, plane / 2);
        cells_of(&rows->edges, plane % 2 ? radius : -radius, (float)image->margin, columns, high, rows->chosen.edge);
        memset(votes, 0, plane_cells);
        vote(rows->edges.n, rows->chosen.edge, votes);
        rate_tiles(columns, high, votes, rows->row, t, most, mean);
        for (int k = 0; k < tiles; k++) {
            const int at = plane % 2 * tiles + k;
            const float around = radius * unit[k], some = LEAST_OF_CIRCLE * around;
            if (!(most[k] > some)) {
                continue;
            }
            const float root = sqrtf(around), best = t->score[at] * root, least = best > some ? best : some;
            if (!(most[k] > least)) {
                continue;
            }
            const float around_it = mean_around(t, mean, k / t->columns, k % t->columns);
            const float left = most[k] - VOTES_AGAINST * CELLS_ACROSS * CELLS_ACROSS * around_it;
            if (left > least) {
                t->score[at] = left / root;
                t->plane[at] = plane;
            }
        }
    }
}

int search_peak(const search_image *image, search_rows *rows, vote_peak *out)
{
    const int columns = cells(image, image->width), high = cells(image, image->height);
    vote_tiles *t = &rows->tiles;
    int best = 0, most = -1;
    for (int k = 1; k < 2 * t->rows * t->columns; k++) {
        best = t->score[k] > t->score[best] ? k : best;
    }
    if (t->plane[best] < 0 || !(t->score[best] > 0.0f)) {
        return 0;
    }
    const uint8_t *votes = rows->votes + (size_t)columns * (size_t)high * (size_t)t->plane[best];
    const int tile = best % (t->rows * t->columns);
    const int top = tile / t->columns * TILE_CELLS, left = tile % t->columns * TILE_CELLS;
    for (int i = top; i < top + TILE_CELLS && i < high - 1; i++) {
        for (int j = left; j < left + TILE_CELLS && j < columns - 1; j++) {
            const uint8_t *cell = votes + (size_t)i * (size_t)columns + (size_t)j;
            const int sum = cell[0] + cell[1] + cell[columns] + cell[columns + 1];
            if (sum > most) {
                most = sum;
                out->x = (float)((j + 1) * DL_SEARCH_CELL - (int)image->margin);
                out->y = (float)((i + 1) * DL_SEARCH_CELL - (int)image->margin);
            }
        }
    }
    out->radius = t->plane[best] / 2;
    out->bright_inside = t->plane[best] % 2;
    t->score[best] = 0.0f;
    return most > 0;
}
