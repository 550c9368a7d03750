/* A deck's drawing seen through the simulated lens, and flat colours over a part of a scene.
 *
 * Where rays meet a plane is given for the middles of cells of DL_CELL_PX x DL_CELL_PX pixels, with one cell more on each side than the
 * frame has, and is linear between them. A pixel is four numbers of sixteen bits, as in light.c.
 */

#include "decklander_sim.h"
#include "base/lanes.h"
#include "base/wide.h"

/* Cells beside each other are drawn together, as many as keep the texels that they read in the processor's nearest cache. */
enum { FRACTION = 16, CELL_BITS = 3, TEXEL_MOST = 16000, STEPS = 32, BLOCK_CELLS = 8, BLOCK = BLOCK_CELLS * DL_CELL_PX };

/* a + (b - a) f / 65536, to one part of 65536; two truncations are corrected once. */
static inline lanes between(lanes a, lanes b, lanes f)
{
    const lanes rest = ~f;
    return lanes_times(a, rest) + lanes_times(b, f) + 1;
}

/* The texel's number, reflected at the drawing's borders. */
static inline int32_t reflected(int32_t i, int32_t n)
{
    int32_t m = i % (2 * n);
    m = m < 0 ? m + 2 * n : m;
    return m < n ? m : 2 * n - 1 - m;
}

/* The shares of two rows, and of the left and the right texel of a row, in the middle of each of STEPS steps between two texels. */
typedef struct {
    uint16_t upper[8 * STEPS], lower[8 * STEPS], across[8 * STEPS];
} steps;

static void set_steps(steps *s)
{
    for (int i = 0; i < 8 * STEPS; i++) {
        const uint16_t later = (uint16_t)((2 * (i / 8) + 1) * (32768 / STEPS)), earlier = (uint16_t)(65536 - later);
        s->upper[i] = earlier;
        s->lower[i] = later;
        s->across[i] = i % 8 < 4 ? earlier : later;
    }
}

/* The place of a position's step in each of them. */
static inline uint16_t step_of(int32_t position)
{
    return (uint16_t)((position >> 8) & (8 * STEPS - 8));
}

/* Two rows of two texels each, side by side, by their shares; the sums of both halves are the pixel. */
static inline lanes interpolate(const steps *s, lanes upper, lanes lower, uint16_t across, uint16_t down)
{
    const lanes a = lanes_times(upper, lanes_load(s->upper + down)), b = lanes_times(lower, lanes_load(s->lower + down));
    return lanes_times(a + b + 1, lanes_load(s->across + across));
}

static inline lanes pixel_of(lanes weighed)
{
    return lanes_fold(weighed) + 1;
}

static lanes read_reflected(const dl_sim_drawing *d, const steps *s, int32_t x, int32_t y)
{
    const int32_t column = x >> FRACTION, row = y >> FRACTION;
    uint16_t pair[2][8];
    for (int i = 0; i < 2; i++) {
        const uint16_t *texels = d->texels + 4 * (int64_t)d->w * reflected(row + i, d->h);
        memcpy(pair[i], texels + 4 * reflected(column, d->w), 8);
        memcpy(pair[i] + 4, texels + 4 * reflected(column + 1, d->w), 8);
    }
    return pixel_of(interpolate(s, lanes_load(pair[0]), lanes_load(pair[1]), step_of(x), step_of(y)));
}

static inline int32_t fixed(float texels)
{
    const float most = TEXEL_MOST, limited = texels < -most ? -most : texels > most ? most : texels;
    return (int32_t)(limited * (float)(1 << FRACTION));
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

static inline int32_t least_of(int32_t a, int32_t b)
{
    return a < b ? a : b;
}

static inline int32_t most_of(int32_t a, int32_t b)
{
    return a > b ? a : b;
}

/* The corners of a block's cells on the drawing: those above, then those below. Missing cells end where the last one does. */
typedef struct {
    int32_t x[2][BLOCK_CELLS + 1], y[2][BLOCK_CELLS + 1];
} corners;

static void set_corners(const float *upper, int32_t columns, int32_t cells, corners *k)
{
    for (int i = 0; i < 2; i++) {
        for (int32_t c = 0; c <= BLOCK_CELLS; c++) {
            const float *at = upper + 2 * (i * columns + least_of(c, cells));
            k->x[i][c] = fixed(at[0]);
            k->y[i][c] = fixed(at[1]);
        }
    }
}

/* Whether all texels between the corners of a cell lie on the drawing, of `size` texels in one direction. */
static inline int all_inside(int32_t size, const int32_t *upper, const int32_t *lower)
{
    const int32_t least = least_of(least_of(upper[0], upper[1]), least_of(lower[0], lower[1]));
    const int32_t most = most_of(most_of(upper[0], upper[1]), most_of(lower[0], lower[1]));
    return least >= 0 && most >> FRACTION < size - 1;
}

/* Positions of a row of pixels, their ways to the next row, the texels there, and the steps beyond these. */
typedef struct {
    int32_t x[BLOCK], y[BLOCK], down_x[BLOCK], down_y[BLOCK], texel[BLOCK];
    uint16_t across[BLOCK], down[BLOCK];
} positions;

/* Values between corners, for pixels in the middles of their parts of the cells. */
static void along_corners(const int32_t *corner, int32_t *values)
{
    for (int32_t c = 0; c < BLOCK_CELLS; c++) {
        const int32_t half = (corner[c + 1] - corner[c]) >> (CELL_BITS + 1);
        for (int32_t i = 0; i < DL_CELL_PX; i++) {
            values[DL_CELL_PX * c + i] = corner[c] + (2 * i + 1) * half;
        }
    }
}

/* The positions in the first row of a block's pixels or a later one, given the corners above and below them. */
static void begin(int32_t (*corner)[BLOCK_CELLS + 1], int32_t row, int32_t *at, int32_t *down)
{
    int32_t lower[BLOCK];
    along_corners(corner[0], at);
    along_corners(corner[1], lower);
    for (int k = 0; k < BLOCK; k++) {
        const int32_t half = (lower[k] - at[k]) >> (CELL_BITS + 1);
        at[k] += (2 * row + 1) * half;
        down[k] = 2 * half;
    }
}

/* Find the texels of the pixels of a row, and go on to the next row. */
WIDE
static void locate(int32_t width, positions *p)
{
    for (int k = 0; k < BLOCK; k++) {
        const int32_t x = p->x[k], y = p->y[k];
        p->texel[k] = width * (y >> FRACTION) + (x >> FRACTION);
        p->across[k] = step_of(x);
        p->down[k] = step_of(y);
        p->x[k] = x + p->down_x[k];
        p->y[k] = y + p->down_y[k];
    }
}

static inline lanes interpolate_inside(const uint16_t *texels, int64_t row, const steps *s, const positions *p, int32_t k)
{
    const uint16_t *upper = texels + 4 * (int64_t)p->texel[k];
    return interpolate(s, lanes_load(upper), lanes_load(upper + row), p->across[k], p->down[k]);
}

/* Draw the pixels `from` to `to` of a row, which lie inside the drawing and cover what is below them. Ask for the texels of the
 * next block, that far ahead: a drawing larger than the cache waits for memory otherwise. */
WIDE
static void draw_inside(const dl_sim_drawing *d, const steps *s, const positions *p, int64_t ahead, int32_t from, int32_t to,
                        uint16_t *restrict scene)
{
    const uint16_t *texels = d->texels;
    const int64_t row = 4 * (int64_t)d->w;
    int32_t k = from;
    for (; k + 2 <= to; k += 2) {
        const lanes left = interpolate_inside(texels, row, s, p, k), right = interpolate_inside(texels, row, s, p, k + 1);
        const lanes sums = lanes_lower_halves(left, right) + lanes_upper_halves(left, right);
        lanes_fetch((uintptr_t)texels + 8 * (uintptr_t)(p->texel[k] + ahead));
        lanes_store(scene + 4 * k, sums + 1);
    }
    if (k < to) {
        lanes_store_four(scene + 4 * k, pixel_of(interpolate_inside(texels, row, s, p, k)));
    }
}

/* Draw pixels one by one; `locate` has gone on to the next row. */
static void draw_through(const dl_sim_drawing *d, const steps *s, const positions *p, int32_t from, int32_t to, const uint8_t *mask,
                         uint16_t *scene)
{
    for (int32_t k = from; k < to; k++) {
        const uint8_t covered = mask ? mask[k] : UINT8_MAX;
        if (covered) {
            const lanes pixel = read_reflected(d, s, p->x[k] - p->down_x[k], p->y[k] - p->down_y[k]);
            cover(scene + 4 * k, pixel, covered);
        }
    }
}

/* Whether the n pixels of a cell's row are covered alike. */
static inline int all_are(const uint8_t *mask, int32_t n, uint8_t value)
{
    uint64_t all = 0;
    int same = 1;
    if (n == DL_CELL_PX) {
        memcpy(&all, mask, sizeof all);
        return all == UINT64_C(0x0101010101010101) * value;
    }
    for (int32_t i = 0; i < n; i++) {
        same &= mask[i] == value;
    }
    return same;
}

/* What a block is drawn from and onto. */
typedef struct {
    const dl_sim_drawing *drawn;
    const steps *shares;
    const dl_sim_frame_part *part;
    const uint8_t *mask;
    uint16_t *scene;
} work;

/* Draw a row of a block that begins at column `left`: cells that are easy and covered together, the others one by one. */
static void draw_row(const work *d, const positions *p, int64_t ahead, int32_t cells, const int *easy, int32_t left, int32_t row)
{
    const int64_t first = (int64_t)row * d->part->w + left;
    const uint8_t *mask = d->mask ? d->mask + first : 0;
    uint16_t *scene = d->scene + 4 * first;
    int32_t run = -1, from = 0, to = 0;
    for (int32_t c = 0; c < cells; c++, from = to) {
        const int32_t begin = c * DL_CELL_PX, end = begin + DL_CELL_PX;
        from = left + begin < d->part->x0 ? d->part->x0 - left : begin;
        to = left + end < d->part->x1 ? end : d->part->x1 - left;
        const int whole = easy[c] && (!mask || all_are(mask + from, to - from, UINT8_MAX));
        if (whole && run < 0) {
            run = from;
        } else if (!whole && run >= 0) {
            draw_inside(d->drawn, d->shares, p, ahead, run, from, scene);
            run = -1;
        }
        if (!whole && !(mask && all_are(mask + from, to - from, 0))) {
            draw_through(d->drawn, d->shares, p, from, to, mask, scene);
        }
    }
    if (run >= 0) {
        draw_inside(d->drawn, d->shares, p, ahead, run, to, scene);
    }
}

/* Draw the part of a block that lies in the window; the block begins at (left, top). */
static void draw_block(const work *d, corners *k, int32_t cells, int32_t left, int32_t top)
{
    const int32_t first = top < d->part->y0 ? d->part->y0 : top, end = top + DL_CELL_PX < d->part->y1 ? top + DL_CELL_PX : d->part->y1;
    const int64_t across = (k->x[0][cells] - k->x[0][0]) >> FRACTION, along = (k->y[0][cells] - k->y[0][0]) >> FRACTION;
    int easy[BLOCK_CELLS];
    positions p;
    begin(k->x, first - top, p.x, p.down_x);
    begin(k->y, first - top, p.y, p.down_y);
    for (int32_t c = 0; c < cells; c++) {
        easy[c] = all_inside(d->drawn->w, k->x[0] + c, k->x[1] + c) && all_inside(d->drawn->h, k->y[0] + c, k->y[1] + c);
    }
    for (int32_t row = first; row < end; row++) {
        locate(d->drawn->w, &p);
        draw_row(d, &p, d->drawn->w * along + across, cells, easy, left, row);
    }
}

void dl_sim_render_deck(const dl_sim_frame_part *part, const dl_sim_plane_cells *cells, const dl_sim_drawing *drawn, const uint8_t *mask, uint16_t *scene)
{
    const int32_t half = DL_CELL_PX / 2, begin = (part->x0 + half) / DL_CELL_PX, end = (part->x1 + half + DL_CELL_PX - 1) / DL_CELL_PX;
    steps shares;
    corners k;
    const work d = {drawn, &shares, part, mask, scene};
    set_steps(&shares);
    for (int32_t r = (part->y0 + half) / DL_CELL_PX; r * DL_CELL_PX - half < part->y1; r++) {
        for (int32_t c = begin; c < end; c += BLOCK_CELLS) {
            const int32_t n = end - c < BLOCK_CELLS ? end - c : BLOCK_CELLS;
            set_corners(cells->at + 2 * ((int64_t)r * cells->columns + c), cells->columns, n, &k);
            draw_block(&d, &k, n, c * DL_CELL_PX - half, r * DL_CELL_PX - half);
        }
    }
}

void dl_sim_render_fill(const dl_sim_frame_part *part, const uint8_t *mask, const uint16_t *colour, uint16_t *scene)
{
    const lanes pixel = lanes_load_four(colour);
    for (int32_t row = part->y0; row < part->y1; row++) {
        for (int32_t column = part->x0; column < part->x1; column++) {
            cover(scene + 4 * ((int64_t)row * part->w + column), pixel, *mask++);
        }
    }
}
