/* Search a frame for circles that its edges vote for. */

#include <math.h>
#include <string.h>

#include "base/arena.h"
#include "vision/search/search.h"

/* Peaks that are fitted for each circle that is requested, at most. */
enum { TRIES = 3 };
static const double SAME_PLACE = 0.25; /* Distance below which two circles are one, in radii. */
static const double SAME_RADIUS = 1.15; /* Factor of their radii below which they are. */
/* Most edges of an image, per pixel. */
static const double MOST_EDGES = 0.4;
/* The margin of an image at full size, and the largest of any, px. */
enum { MARGIN_PX = 8, MARGIN_MAX = 16384 };
/* Work of a pixel, of an edge and its vote for a radius, of a cell of votes, and of fitting a peak. */
enum { PIXEL_WORK = 6, EDGE_WORK = 40, VOTE_WORK = 10, CELL_WORK = 1, FIT_WORK = 12000 };

int64_t search_divide(const search_image *image, float *scratch, search_rows *r)
{
    const int64_t w = image->width, h = image->height, n = w * h, room = image->room;
    const int64_t columns = (w + 2 * image->margin) / DL_SEARCH_CELL, high = (h + 2 * image->margin) / DL_SEARCH_CELL;
    block_grid *b = &r->blocks;
    vote_tiles *t = &r->tiles;
    b->columns = (int)((w + DL_SEARCH_BLOCK - 1) / DL_SEARCH_BLOCK);
    b->rows = (int)((h + DL_SEARCH_BLOCK - 1) / DL_SEARCH_BLOCK);
    t->columns = (int)((columns + TILE_CELLS - 1) / TILE_CELLS);
    t->rows = (int)((high + TILE_CELLS - 1) / TILE_CELLS);
    const int64_t blocks = (int64_t)b->columns * b->rows, tiles = (int64_t)t->columns * t->rows;
    const int64_t scores = tiles > blocks ? tiles : blocks, half = sizeof(int16_t), number = sizeof(float);
    arena a = {scratch, 0};
    r->chosen.places = take(&a, 2 * room * (int64_t)sizeof *r->chosen.places);
    r->slope_x = take(&a, n * half), r->slope_y = take(&a, n * half), r->strength = take(&a, n * half);
    b->corners = take(&a, 2 * (b->columns + 1) * (int64_t)(b->rows + 1) * number);
    b->scale = take(&a, 4 * blocks * number), b->least = take(&a, blocks * number);
    r->edges.x = take(&a, room * number), r->edges.y = take(&a, room * number);
    r->edges.to_x = take(&a, room * number), r->edges.to_y = take(&a, room * number);
    r->edges.first = take(&a, (h + 1) * number);
    r->votes = take(&a, 2 * DL_SEARCH_RADII * columns * high + 4);
    r->row = take(&a, (columns + TILE_CELLS) * number);
    t->score = take(&a, 5 * scores * number), t->plane = take(&a, 2 * tiles * number);
    r->least = take(&a, (w + 1) * half), r->marks = take(&a, w + 11);
    r->chosen.edge = take(&a, room * number);
    return arena_numbers(&a);
}

/* Edges of an image of this many pixels, at most: two neighbours are seldom both a ridge of the gradient. */
static int64_t most_edges(int64_t pixels)
{
    return (int64_t)floor(MOST_EDGES * (double)pixels + 0.5);
}

int64_t search_most(int64_t width, int64_t height)
{
    const search_image whole = {.width = width, .height = height, .room = most_edges(width * height), .margin = MARGIN_PX};
    const dl_image half = {.width = (width + 1) / 2, .height = (height + 1) / 2};
    search_rows rows;
    const int64_t circles = search_divide(&whole, NULL, &rows), strokes = strokes_room(width, height), blobs = blob_room(&half);
    const int64_t most = circles > strokes ? circles : strokes;
    return most > blobs ? most : blobs;
}

static int is_among(const dl_circle *one, const dl_circle *others, int n)
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

/* Whether a frame is there at full and at half size. */
static int is_halved(const dl_frame *frame)
{
    const dl_image *full = &frame->level[0], *half = &frame->level[1];
    return is_image(full, 3) && is_image(half, 3) && (half->width == full->width / 2 || half->width == 1)
           && (half->height == full->height / 2 || half->height == 1);
}

int32_t dl_search_circles(dl_tracker *t, const dl_frame *frame, const dl_image *grey, const float *rays, const dl_circle_search *how,
                          dl_circle *out)
{
    search_rows rows;
    vote_peak peak;
    int n = 0;
    if (grey == NULL) {
        return frame != NULL && is_halved(frame) && blob_room(&frame->level[1]) <= t->floats ? search_areas(t, frame, how, out) : DL_WRONG_SIZE;
    }
    if (!is_image(grey, 1) || rays == NULL || how->radii < 1 || how->radii > DL_SEARCH_RADII || how->step < 1 || how->margin < 0
        || how->margin > MARGIN_MAX) {
        return DL_WRONG_SIZE;
    }
    search_image image = {grey->width, grey->height, grey->stride, most_edges(grey->width * grey->height), how->margin, how->step, {0.0}};
    memcpy(image.R_cam_plane, how->R_cam_plane, sizeof image.R_cam_plane);
    if (search_divide(&image, NULL, &rows) > t->floats) {
        return DL_WRONG_SIZE;
    }
    search_divide(&image, t->scratch, &rows);
    search_edges(&image, grey->px, rays, &rows);
    search_votes(&image, how, &rows);
    const int64_t planes = how->radii * (how->only_bright ? 1 : 2), tiles = (int64_t)rows.tiles.columns * rows.tiles.rows;
    count_work(t, image.width * image.height, PIXEL_WORK);
    count_work(t, rows.edges.n, EDGE_WORK + planes * VOTE_WORK);
    count_work(t, planes * tiles, TILE_CELLS * TILE_CELLS * CELL_WORK);
    for (int tries = 0; tries < TRIES * (int)how->most && n < (int)how->most; tries++) {
        if (!search_peak(&image, &rows, &peak)) {
            break;
        }
        count_work(t, 1, FIT_WORK);
        n += search_fit(&image, how, &rows, &peak, &out[n]) && !is_among(&out[n], out, n);
    }
    return n;
}
