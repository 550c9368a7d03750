/* A deck's drawing seen through the simulated lens, and flat colours over a part of a scene.
 *
 * Where rays meet a plane is given for the middles of cells of CELL_PX x CELL_PX pixels, with one cell more on each side than the
 * frame has, and is linear between them. A pixel is four numbers of sixteen bits, as in render_light.c.
 */

#include "interface.h"
#include "lanes.h"

enum { FRACTION = 16, TEXEL_MOST = 16000 };

/* a + (b - a) f / 65536, to one part of 65536; what is cut off twice is made up for once. */
static inline lanes between(lanes a, lanes b, lanes f)
{
    const lanes rest = lanes_xor(f, lanes_all(UINT16_MAX));
    return lanes_add(lanes_all(1), lanes_add(lanes_times(a, rest), lanes_times(b, f)));
}

/* The texel's number, reflected at the drawing's borders. */
static inline int32_t reflected(int32_t i, int32_t n)
{
    int32_t m = i % (2 * n);
    m = m < 0 ? m + 2 * n : m;
    return m < n ? m : 2 * n - 1 - m;
}

typedef struct {
    const uint16_t *texels;
    int32_t h, w;
} drawing;

/* Two rows of two texels each, side by side, weighted by the fractions of a position. */
static inline lanes bilinear(lanes upper, lanes lower, int32_t x, int32_t y)
{
    static const uint16_t left_half[8] = {UINT16_MAX, UINT16_MAX, UINT16_MAX, UINT16_MAX};
    const lanes row = between(upper, lower, lanes_all((uint16_t)y));
    return lanes_add(lanes_all(1), lanes_fold(lanes_times(row, lanes_xor(lanes_all((uint16_t)x), lanes_load(left_half)))));
}

static lanes read_reflected(const drawing *d, int32_t x, int32_t y)
{
    const int32_t column = x >> FRACTION, row = y >> FRACTION;
    uint16_t pair[2][8];
    for (int i = 0; i < 2; i++) {
        const uint16_t *texels = d->texels + 4 * (int64_t)d->w * reflected(row + i, d->h);
        memcpy(pair[i], texels + 4 * reflected(column, d->w), 8);
        memcpy(pair[i] + 4, texels + 4 * reflected(column + 1, d->w), 8);
    }
    return bilinear(lanes_load(pair[0]), lanes_load(pair[1]), x, y);
}

static inline lanes read_inside(const drawing *d, int32_t x, int32_t y)
{
    const uint16_t *upper = d->texels + 4 * ((int64_t)d->w * (y >> FRACTION) + (x >> FRACTION));
    return bilinear(lanes_load(upper), lanes_load(upper + 4 * d->w), x, y);
}

static inline int32_t fixed(float texels)
{
    const float most = TEXEL_MOST, limited = texels < -most ? -most : texels > most ? most : texels;
    return (int32_t)(limited * (float)(1 << FRACTION));
}

static inline int inside(const drawing *d, int32_t x, int32_t y)
{
    return x >= 0 && y >= 0 && x >> FRACTION < d->w - 1 && y >> FRACTION < d->h - 1;
}

/* Put a pixel on a scene as far as a mask of 0 to 255 covers it. */
static inline void cover(uint16_t *scene, lanes pixel, uint8_t mask)
{
    if (mask == UINT8_MAX) {
        lanes_store_four(scene, pixel);
    } else if (mask) {
        lanes_store_four(scene, between(lanes_load_four(scene), pixel, lanes_all((uint16_t)(mask * 257))));
    }
}

/* A part of the frame: columns x0 to x1 and rows y0 to y1, without the last. */
typedef struct {
    int32_t w, x0, x1, y0, y1;
} window;

/* Four texel positions in fixed point, between which a tile's lie. */
typedef struct {
    int32_t x[4], y[4];
} corners;

static corners corners_at(const float *upper, int32_t columns)
{
    const float *at[4] = {upper, upper + 2, upper + 2 * columns, upper + 2 * columns + 2};
    corners made;
    for (int i = 0; i < 4; i++) {
        made.x[i] = fixed(at[i][0]);
        made.y[i] = fixed(at[i][1]);
    }
    return made;
}

static int all_inside(const drawing *d, const corners *k)
{
    return inside(d, k->x[0], k->y[0]) && inside(d, k->x[1], k->y[1]) && inside(d, k->x[2], k->y[2]) && inside(d, k->x[3], k->y[3]);
}

/* A value in row `row` of a tile's CELL_PX rows, between its upper and its lower corner. */
static inline int32_t down(int32_t upper, int32_t lower, int32_t row)
{
    return upper + (int32_t)((int64_t)(lower - upper) * (2 * row + 1) / (2 * CELL_PX));
}

/* Ask for the texels at a position in the tile to the right: a deck larger than the cache waits for memory otherwise. */
static inline void fetch_ahead(const drawing *d, int32_t x, int32_t y)
{
    const int64_t texel = (int64_t)d->w * (y >> FRACTION) + (x >> FRACTION);
    lanes_fetch((uintptr_t)d->texels + 8 * (uintptr_t)texel);
}

/* Draw the part of a tile that lies in the window; it begins at (left, top). Tiles keep the texels that they read in the cache. */
static void tile(const drawing *d, const corners *k, int32_t left, int32_t top, const window *part, const uint8_t *mask,
                 uint16_t *scene)
{
    const int easy = all_inside(d, k);
    const int32_t from = left < part->x0 ? part->x0 : left, to = left + CELL_PX < part->x1 ? left + CELL_PX : part->x1;
    const int32_t first = top < part->y0 ? part->y0 : top, end = top + CELL_PX < part->y1 ? top + CELL_PX : part->y1;
    for (int32_t row = first; row < end; row++) {
        const int32_t xa = down(k->x[0], k->x[2], row - top), ya = down(k->y[0], k->y[2], row - top);
        const int32_t dx = (down(k->x[1], k->x[3], row - top) - xa) / CELL_PX;
        const int32_t dy = (down(k->y[1], k->y[3], row - top) - ya) / CELL_PX;
        int32_t x = xa + dx / 2 + (from - left) * dx, y = ya + dy / 2 + (from - left) * dy;
        int64_t at = (int64_t)row * part->w + from;
        for (const int64_t last = at + to - from; at < last; at++, x += dx, y += dy) {
            if (easy && at % 2) {
                fetch_ahead(d, x + CELL_PX * dx, y + CELL_PX * dy);
            }
            if (!mask && easy) {
                lanes_store_four(scene + 4 * at, read_inside(d, x, y));
            } else if (!mask || mask[at]) {
                cover(scene + 4 * at, easy ? read_inside(d, x, y) : read_reflected(d, x, y), mask ? mask[at] : UINT8_MAX);
            }
        }
    }
}

void render_deck(int32_t w, int32_t x0, int32_t x1, int32_t y0, int32_t y1, const float *cells, int32_t columns,
                 const uint16_t *texels, int32_t texel_rows, int32_t texel_columns, const uint8_t *mask, uint16_t *scene)
{
    const drawing d = {texels, texel_rows, texel_columns};
    const window part = {w, x0, x1, y0, y1};
    for (int32_t row = (y0 + CELL_PX / 2) / CELL_PX; row * CELL_PX - CELL_PX / 2 < y1; row++) {
        for (int32_t column = (x0 + CELL_PX / 2) / CELL_PX; column * CELL_PX - CELL_PX / 2 < x1; column++) {
            const corners k = corners_at(cells + 2 * ((int64_t)row * columns + column), columns);
            tile(&d, &k, column * CELL_PX - CELL_PX / 2, row * CELL_PX - CELL_PX / 2, &part, mask, scene);
        }
    }
}

void render_fill(int32_t w, int32_t x0, int32_t x1, int32_t y0, int32_t y1, const uint8_t *mask, const uint16_t *colour,
                 uint16_t *scene)
{
    const lanes pixel = lanes_load_four(colour);
    for (int32_t row = y0; row < y1; row++) {
        for (int32_t column = x0; column < x1; column++) {
            cover(scene + 4 * ((int64_t)row * w + column), pixel, *mask++);
        }
    }
}
