#include <math.h>
#include <string.h>

#include "vision/search/search.h"

/* Peaks that are fitted for each circle that is asked for, at most. */
enum { TRIES = 3 };
/* Circles nearer to each other than this, in radii, with radii nearer than this factor, are one. */
static const double SAME_PLACE = 0.25, SAME_RADIUS = 1.15;

/* The place of some floats, and of those behind them. */
static float *next(float **at, int64_t count)
{
    float *here = *at;
    if (here != NULL) {
        *at += count;
    }
    return here;
}

int64_t search_divide(const search_image *image, float *scratch, search_rows *r)
{
    const int64_t w = image->width, h = image->height, n = w * h, room = image->room;
    const int64_t columns = (w + 2 * image->margin) / SEARCH_CELL, high = (h + 2 * image->margin) / SEARCH_CELL;
    block_grid *b = &r->blocks;
    vote_tiles *t = &r->tiles;
    b->columns = (int)((w + SEARCH_BLOCK - 1) / SEARCH_BLOCK);
    b->rows = (int)((h + SEARCH_BLOCK - 1) / SEARCH_BLOCK);
    t->columns = (int)((columns + TILE_CELLS - 1) / TILE_CELLS);
    t->rows = (int)((high + TILE_CELLS - 1) / TILE_CELLS);
    const int64_t blocks = (int64_t)b->columns * b->rows, tiles = (int64_t)t->columns * t->rows;
    const int64_t sizes[] = {
        4 * room, (n + 1) / 2, (n + 1) / 2, (n + 1) / 2, 2 * (b->columns + 1) * (int64_t)(b->rows + 1), 4 * blocks, blocks,
        room, room, room, room, h + 1, (2 * SEARCH_RADII * columns * high + 4) / 4, columns + TILE_CELLS,
        5 * (tiles > blocks ? tiles : blocks), 2 * tiles, (w + 1) / 2, (w + 11) / 4, room,
    };
    enum { COUNT = sizeof sizes / sizeof *sizes };
    float *at = scratch, *parts[COUNT];
    int64_t total = 0;
    for (int k = 0; k < COUNT; k++) {
        parts[k] = next(&at, sizes[k]);
        total += sizes[k];
    }
    r->chosen.places = (double *)(void *)parts[0];
    r->slope_x = (int16_t *)(void *)parts[1], r->slope_y = (int16_t *)(void *)parts[2];
    r->strength = (uint16_t *)(void *)parts[3];
    b->corners = parts[4], b->scale = parts[5], b->least = parts[6];
    r->edges.x = parts[7], r->edges.y = parts[8], r->edges.to_x = parts[9], r->edges.to_y = parts[10];
    r->edges.first = (int32_t *)(void *)parts[11];
    r->votes = (uint8_t *)(void *)parts[12], r->row = (uint16_t *)(void *)parts[13];
    t->score = parts[14], t->plane = (int32_t *)(void *)parts[15];
    r->least = (int16_t *)(void *)parts[16], r->marks = (uint8_t *)(void *)parts[17];
    r->chosen.edge = (int32_t *)(void *)parts[18];
    return total;
}

int64_t search_room(const search_image *image)
{
    search_rows rows;
    return search_divide(image, NULL, &rows);
}

static int known(const search_circle *one, const search_circle *others, int n)
{
    for (int k = 0; k < n; k++) {
        const double apart = hypot(one->centre[0] - others[k].centre[0], one->centre[1] - others[k].centre[1]);
        const double ratio = one->radius / others[k].radius;
        if (apart < SAME_PLACE * others[k].radius && ratio < SAME_RADIUS && ratio * SAME_RADIUS > 1.0
            && one->bright_inside == others[k].bright_inside) {
            return 1;
        }
    }
    return 0;
}

int32_t search_circles(const search_image *image, const uint8_t *grey, const float *rays, const search_radii *radii, float *scratch,
                       search_circle *out)
{
    search_rows rows;
    vote_peak peak;
    int n = 0;
    search_divide(image, scratch, &rows);
    search_edges(image, grey, rays, &rows);
    search_votes(image, radii, &rows);
    for (int tries = 0; tries < TRIES * (int)radii->most && n < (int)radii->most; tries++) {
        if (!search_peak(image, &rows, &peak)) {
            break;
        }
        n += search_fit(image, radii, &rows, &peak, &out[n]) && !known(&out[n], out, n);
    }
    return n;
}
