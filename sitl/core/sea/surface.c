/* The surface of the sea, seen through the simulated lens.
 *
 * Water has no sharp edges: its brightness is computed for squares of 2 x 2 pixels and interpolated. Where rays meet calm water is
 * given for the middles of cells of DL_CELL_PX x DL_CELL_PX pixels, with one cell more on each side than the frame has.
 */

#include <math.h>

#include "decklander_sim.h"
#include "base/lanes.h"
#include "base/wide.h"

/* The squares of a cell in one row; the cells and squares that are computed together, and room for the cells' ends. */
enum { SPAN = DL_CELL_PX / 2, RUN_CELLS = 16, RUN = RUN_CELLS * SPAN, ENDS = RUN_CELLS + 8 };

/* Bits of a position in a tile, and of the place between two texels; the largest way on a tile, in parts of its side. */
enum { TILE_BITS = 24, PLACE_BITS = 14, WAY_MOST = 1 << 30 };

/* A periodic texture on the sea: its texels with the first row and column repeated, its frequency and shift. */
typedef struct {
    const int16_t *texels;
    int bits;
    double per_m, shift_x, shift_y;
} tile;

static tile tile_of(const dl_sim_sea_layer *of)
{
    tile made = {of->texels, 0, of->per_m, of->shift_x, of->shift_y};
    while (1 << made.bits < of->n) {
        made.bits++;
    }
    return made;
}

/* A position in periods of a tile as a part of 2^TILE_BITS: it wraps by itself. */
static inline uint32_t wrapped(double periods)
{
    return (uint32_t)(int64_t)(periods * (1 << TILE_BITS));
}

/* Where the water is met at the first end of a run's cells, m; and at all ends and in the middles of its squares, m from there. */
typedef struct {
    double north, east;
    float ends_north[ENDS], ends_east[ENDS], to_north[RUN], to_east[RUN];
} shore;

/* Values between the ends of cells, for the middles of their squares. */
WIDE
static void spread(const float *restrict ends, float *restrict values)
{
    for (int c = 0; c < RUN_CELLS; c++) {
        const float half = (ends[c + 1] - ends[c]) * (0.5f / SPAN);
        for (int i = 0; i < SPAN; i++) {
            values[SPAN * c + i] = ends[c] + (float)(2 * i + 1) * half;
        }
    }
}

/* Where the water is met in a row that lies a part f of a cell below the upper row of ends. */
WIDE
static void meet(const float *upper, const float *lower, float f, int32_t cells, shore *s)
{
    const float north = upper[0], east = upper[1], more_north = lower[0] - north, more_east = lower[1] - east;
    for (int32_t k = 0; k <= cells; k++) {
        const float along = upper[2 * k] - north, across = upper[2 * k + 1] - east;
        s->ends_north[k] = along + f * (lower[2 * k] - north - more_north - along);
        s->ends_east[k] = across + f * (lower[2 * k + 1] - east - more_east - across);
    }
    for (int32_t k = cells + 1; k < ENDS; k++) {
        s->ends_north[k] = s->ends_north[cells];
        s->ends_east[k] = s->ends_east[cells];
    }
    s->north = (double)north + (double)f * (double)more_north;
    s->east = (double)east + (double)f * (double)more_east;
    spread(s->ends_north, s->to_north);
    spread(s->ends_east, s->to_east);
}

/* The texels around positions, the weights of the left and the right one, twice, and how far below the upper ones they lie. */
typedef struct {
    uint32_t texel[RUN], weights[2 * RUN];
    float down[RUN];
    int32_t sums[2 * RUN];
} sampling;

static inline float within(float value, float most)
{
    const float some = value > -most ? value : -most;
    return some < most ? some : most;
}

WIDE
static void locate(const shore *s, float per_m, uint32_t x0, uint32_t y0, int bits, sampling *p)
{
    const uint32_t last = (1u << bits) - 1, row = (1u << bits) + 1, most = (1u << PLACE_BITS) - 1;
    const int shift = TILE_BITS - bits, fine = shift - PLACE_BITS;
    for (int k = 0; k < RUN; k++) {
        const uint32_t x = x0 + (uint32_t)(int32_t)within(s->to_north[k] * per_m, WAY_MOST);
        const uint32_t y = y0 + (uint32_t)(int32_t)within(s->to_east[k] * per_m, WAY_MOST);
        const uint32_t right = x >> fine & most;
        p->texel[k] = (y >> shift & last) * row + (x >> shift & last);
        p->down[k] = (float)(int32_t)(y >> fine & most) * (1.0f / (1 << PLACE_BITS));
        p->weights[2 * k] = p->weights[2 * k + 1] = ((1u << PLACE_BITS) - right) | right << 16;
    }
}

WIDE
static void interpolate_across(const int16_t *texels, int64_t row, sampling *p)
{
    for (int k = 0; k < RUN; k += 2) {
        const int16_t *left = texels + p->texel[k], *right = texels + p->texel[k + 1];
        const lanes two = lanes_of_pairs(left, left + row, right, right + row);
        lanes_store(p->sums + 2 * k, lanes_dot_pairs(two, lanes_load(p->weights + 2 * k)));
    }
}

WIDE
static void interpolate(const sampling *p, float *restrict values)
{
    for (int k = 0; k < RUN; k++) {
        const float upper = (float)p->sums[2 * k], lower = (float)p->sums[2 * k + 1];
        values[k] = (upper + p->down[k] * (lower - upper)) * (1.0f / ((float)DL_TILE_ONE * (1 << PLACE_BITS)));
    }
}

/* The tile's values at the squares of a run. */
static void read_tile(const tile *t, const shore *s, float *values)
{
    sampling p;
    const uint32_t x0 = wrapped(s->north * t->per_m + t->shift_x), y0 = wrapped(s->east * t->per_m + t->shift_y);
    locate(s, (float)(t->per_m * (1 << TILE_BITS)), x0, y0, t->bits, &p);
    interpolate_across(t->texels, (1 << t->bits) + 1, &p);
    interpolate(&p, values);
}

/* The value limited to 0..most, without a branch. */
static inline float limited(float value, float most)
{
    return 0.5f * (fabsf(value) - fabsf(value - most) + most);
}

/* The light on a run of squares, and what lies on them: level and contrast, ripples, whitecaps, the ship's shade and foam. */
typedef struct {
    float level[RUN], contrast[RUN], fine[RUN], coarse[RUN], cap[RUN], streak[RUN], shade[RUN], white[RUN];
} surface;

/* Level and contrast from their grid of every second cell, in a row of squares from a cell on. */
static void light_up(const float *slow, int32_t columns, int32_t row, int32_t cell, int32_t cells, surface *s)
{
    enum { NODES = RUN_CELLS / 2 + 2 };
    const int32_t stride = 2 * (columns / 2 + 1), first = cell / 2, nodes = (cell + cells + 1) / 2 - first + 1;
    const float *upper = slow + (2 * row + 5) / 16 * (int64_t)stride + 2 * first, *lower = upper + stride;
    const float f = (float)((2 * row + 5) % 16) * (1.0f / 16.0f);
    float node[2 * NODES], ends[2][ENDS];
    for (int32_t k = 0; k < 2 * nodes; k++) {
        node[k] = upper[k] + f * (lower[k] - upper[k]);
    }
    for (int32_t k = 0; k < ENDS; k++) {
        const int32_t here = cell + (k < cells ? k : cells), left = 2 * (here / 2 - first), right = 2 * ((here + 1) / 2 - first);
        ends[0][k] = 0.5f * (node[left] + node[right]);
        ends[1][k] = 0.5f * (node[left + 1] + node[right + 1]);
    }
    spread(ends[0], s->level);
    spread(ends[1], s->contrast);
}

WIDE
static void add_ripples(const surface *s, const float *weights, float *restrict value)
{
    const float small = weights[DL_SEA_SMALL], large = weights[DL_SEA_LARGE];
    for (int k = 0; k < RUN; k++) {
        value[k] = s->level[k] + s->contrast[k] * (small * s->fine[k] + large * s->coarse[k]);
    }
}

WIDE
static void add_caps(const surface *s, const float *weights, float *restrict value)
{
    const float calm = weights[DL_SEA_CALM], cap = weights[DL_SEA_CAP];
    for (int k = 0; k < RUN; k++) {
        value[k] += cap * limited((s->cap[k] + 0.5f * s->coarse[k] - calm) * 3.0f, 1.0f);
    }
}

WIDE
static void add_ship(const surface *s, float *restrict value)
{
    for (int k = 0; k < RUN; k++) {
        value[k] = value[k] * (1.0f - s->shade[k]) + s->white[k] * limited(0.5f * s->streak[k] + 0.35f, 1.0f);
    }
}

WIDE
static void round_off(const float *restrict value, uint8_t *restrict codes)
{
    for (int k = 0; k < RUN; k++) {
        /* Of a large number `limited` is rounded beyond its limits. */
        const float code = limited(value[k], 255.0f) + 0.5f;
        codes[k] = (uint8_t)(int32_t)(code > 0.0f ? code < 255.0f ? code : 255.0f : 0.0f);
    }
}

/* A side of a convex outline on the water: the direction from there inwards, and what makes a place in it a distance, m. */
typedef struct {
    double north, east, from;
} side;

/* An outline's sides, and the width over which its edge is soft, m. */
typedef struct {
    side sides[DL_SEA_OUTLINE_POINTS];
    int count;
    float soft_m;
} outline;

/* Twice the area of an outline, positive if it runs from north to east. */
static double area_of(const double *points, int32_t n)
{
    double sum = 0.0;
    for (int32_t i = 0; i < n; i++) {
        const double *a = points + 2 * i, *b = points + 2 * ((i + 1) % n);
        sum += (a[0] - points[0]) * (b[1] - points[1]) - (b[0] - points[0]) * (a[1] - points[1]);
    }
    return sum;
}

static void set_outline(const double *points, int32_t n, float soft_m, outline *o)
{
    const double area = n > 2 ? area_of(points, n) : 0.0, turn = area > 0.0 ? 1.0 : -1.0;
    o->count = 0;
    o->soft_m = soft_m;
    for (int32_t i = 0; i < n && i < DL_SEA_OUTLINE_POINTS && fabs(area) > 1e-9; i++) {
        const double *a = points + 2 * i, *b = points + 2 * ((i + 1) % n);
        const double north = b[0] - a[0], east = b[1] - a[1], length = sqrt(north * north + east * east);
        if (length > 1e-6) {
            const double inwards_north = -turn * east / length, inwards_east = turn * north / length;
            const side made = {inwards_north, inwards_east, -(inwards_north * a[0] + inwards_east * a[1])};
            o->sides[o->count++] = made;
        }
    }
}

static inline float lesser(float a, float b)
{
    return a < b ? a : b;
}

/* How far inside an outline a run's ends lie, m. */
WIDE
static void measure(const outline *o, const shore *s, float *restrict inside)
{
    for (int k = 0; k < ENDS; k++) {
        inside[k] = o->count ? 1e9f : -1e9f;
    }
    for (int i = 0; i < o->count; i++) {
        const side *b = &o->sides[i];
        const float north = (float)b->north, east = (float)b->east;
        const float first = (float)(b->north * s->north + b->east * s->east + b->from);
        for (int k = 0; k < ENDS; k++) {
            inside[k] = lesser(inside[k], first + north * s->ends_north[k] + east * s->ends_east[k]);
        }
    }
}

/* Whether one of a run's ends lies further inside than `far_m`. */
static int reaches(const float *inside, float far_m)
{
    int some = 0;
    for (int k = 0; k < ENDS; k++) {
        some |= inside[k] > far_m;
    }
    return some;
}

/* Add as much of `strength` as the soft edge of an outline leaves. */
WIDE
static void add_softly(const float *restrict inside, float per_m, float strength, float *restrict sum)
{
    for (int k = 0; k < RUN; k++) {
        const float share = limited(0.5f + inside[k] * per_m, 1.0f);
        sum[k] += strength * (share * share * (3.0f - 2.0f * share));
    }
}

/* What a ship does to a run: nothing, shade it, or cover it with foam. */
enum { OPEN, SHADED, FOAMY };

static int put_ship(const outline *ship, const shore *s, const float *weights, surface *seen)
{
    static const int weight_of[DL_SEA_OUTLINES] = {DL_SEA_SHADE, DL_SEA_WASH, DL_SEA_WAKE};
    int found = OPEN;
    for (int i = 0; i < DL_SEA_OUTLINES; i++) {
        float ends[ENDS], inside[RUN];
        measure(&ship[i], s, ends);
        if (!reaches(ends, -0.5f * ship[i].soft_m)) {
            continue;
        }
        if (found == OPEN) {
            memset(seen->shade, 0, sizeof seen->shade);
            memset(seen->white, 0, sizeof seen->white);
            memset(seen->streak, 0, sizeof seen->streak);
        }
        spread(ends, inside);
        add_softly(inside, 1.0f / ship[i].soft_m, weights[weight_of[i]], i == 0 ? seen->shade : seen->white);
        found = i == 0 ? SHADED : FOAMY;
    }
    return found;
}

/* What a run is computed from. */
typedef struct {
    tile small, large, caps, streaks;
    const float *cells, *weights, *slow;
    int32_t columns;
    const outline *ship;
} open_sea;

/* The codes of a row of squares from the first of a cell on. */
static void paint_run(const open_sea *s, int32_t row, int32_t cell, int32_t cells, uint8_t *codes)
{
    const int32_t place = 2 * row + SPAN + 1;
    const float *upper = s->cells + 2 * ((int64_t)s->columns * (place / DL_CELL_PX) + cell);
    shore met;
    surface seen;
    float value[RUN];
    meet(upper, upper + 2 * s->columns, (float)(place % DL_CELL_PX) * (1.0f / DL_CELL_PX), cells, &met);
    read_tile(&s->small, &met, seen.fine);
    read_tile(&s->large, &met, seen.coarse);
    light_up(s->slow, s->columns, row, cell, cells, &seen);
    add_ripples(&seen, s->weights, value);
    if (s->weights[DL_SEA_CAP] > 0.0f) {
        read_tile(&s->caps, &met, seen.cap);
        add_caps(&seen, s->weights, value);
    }
    const int found = put_ship(s->ship, &met, s->weights, &seen);
    if (found == FOAMY) {
        read_tile(&s->streaks, &met, seen.streak);
    }
    if (found != OPEN) {
        add_ship(&seen, value);
    }
    round_off(value, codes);
}

static int all_covered(const uint8_t *mask, int32_t n)
{
    uint64_t first, last;
    if (n < 8) {
        for (int32_t i = 0; i < n && mask[i] == UINT8_MAX; i++) {
            if (i == n - 1) {
                return 1;
            }
        }
        return 0;
    }
    memcpy(&first, mask, sizeof first);
    memcpy(&last, mask + n - 8, sizeof last);
    return (first & last) == UINT64_MAX;
}

/* Whether something lies over all of the pixels around the squares of a cell in SPAN rows, as far as interpolation reaches. */
static int hidden(const uint8_t *mask, int32_t h, int32_t w, int32_t row, int32_t cell)
{
    const int32_t x = DL_CELL_PX * cell - SPAN, left = x - 2 > 0 ? x - 2 : 0, right = x + DL_CELL_PX + 2 < w ? x + DL_CELL_PX + 2 : w;
    const int32_t top = 2 * row - 2 > 0 ? 2 * row - 2 : 0, end = 2 * row + DL_CELL_PX + 2 < h ? 2 * row + DL_CELL_PX + 2 : h;
    for (int32_t y = top; y < end; y++) {
        if (!all_covered(mask + (int64_t)y * w + left, right - left)) {
            return 0;
        }
    }
    return 1;
}

/* The codes of a run of cells in some rows of squares, as far as they lie in the window. */
static void paint_rows(const open_sea *s, const dl_sim_frame_part *part, int32_t row, int32_t rows, int32_t cell, int32_t cells,
                       uint8_t *codes)
{
    const int32_t x = SPAN * cell - SPAN / 2, from = x > part->x0 ? x : part->x0;
    const int32_t end = x + SPAN * cells, to = end < part->x1 ? end : part->x1;
    for (int32_t y = row; y < row + rows && y < part->y1; y++) {
        uint8_t made[RUN];
        paint_run(s, y, cell, cells, made);
        memcpy(codes + (int64_t)(y - part->y0) * (part->x1 - part->x0) + from - part->x0, made + from - x, (size_t)(to - from));
    }
}

void dl_sim_render_sea(int32_t h, const dl_sim_frame_part *part, const dl_sim_plane_cells *cells, const dl_sim_sea_surface *sea, const uint8_t *mask,
                uint8_t *codes)
{
    const double *points = sea->outlines;
    outline ship[DL_SEA_OUTLINES];
    for (int i = 0; i < DL_SEA_OUTLINES; points += 2 * sea->outline_points[i], i++) {
        set_outline(points, sea->outline_points[i], sea->soft_m[i], &ship[i]);
    }
    const open_sea s = {tile_of(&sea->small), tile_of(&sea->large), tile_of(&sea->caps), tile_of(&sea->streaks),
                        cells->at, sea->weights, sea->slow, cells->columns, ship};
    const int32_t end = (part->x1 + SPAN / 2 + SPAN - 1) / SPAN;
    for (int32_t row = part->y0; row < part->y1; row += SPAN) {
        for (int32_t cell = (part->x0 + SPAN / 2) / SPAN; cell < end;) {
            const int32_t n = end - cell < RUN_CELLS ? end - cell : RUN_CELLS;
            if (mask && hidden(mask, h, part->w, row, cell)) {
                cell++;
                continue;
            }
            paint_rows(&s, part, row, SPAN, cell, n, codes);
            cell += n;
        }
    }
}

static inline int32_t nearer(int32_t i, int32_t n)
{
    return i < 0 ? 0 : i >= n ? n - 1 : i;
}

/* Number of squares of a row that are interpolated together. */
enum { WATER = 256 };

/* The codes of squares mixed with those of the row beside them; their own count three times as much. */
WIDE
static void mix_rows(int32_t n, const uint8_t *restrict near, const uint8_t *restrict far, uint16_t *restrict mixed)
{
    for (int32_t i = 0; i < n; i++) {
        mixed[i] = (uint16_t)(3 * near[i] + far[i]);
    }
}

/* The codes of the two pixels of each square, from those of the squares to the left and to the right of them. */
WIDE
static void mix_columns(int32_t n, const uint16_t *restrict mixed, uint16_t *restrict code)
{
    for (int32_t i = 0; i < n; i++) {
        code[2 * i] = (uint16_t)((3 * mixed[i + 1] + mixed[i] + 8) >> 4);
        code[2 * i + 1] = (uint16_t)((3 * mixed[i + 1] + mixed[i + 2] + 8) >> 4);
    }
}

/* Colour n pixels of a row; what covers all of a cell's width leaves it as it is. */
static void colour_row(int32_t n, const uint16_t *code, const uint16_t *colours, const uint8_t *mask, uint16_t *out)
{
    for (int32_t i = 0; i < n; i += DL_CELL_PX) {
        const int32_t end = i + DL_CELL_PX < n ? i + DL_CELL_PX : n;
        if (mask && all_covered(mask + i, end - i)) {
            continue;
        }
        for (int32_t k = i; k < end; k += 2) {
            lanes_store(out + 4 * k, lanes_join(colours + 4 * code[k], colours + 4 * code[k + 1]));
        }
    }
}

void dl_sim_render_water(const dl_sim_frame_part *part, const uint8_t *codes, const uint16_t *colours, const uint8_t *mask, uint16_t *scene)
{
    const int32_t columns = (part->x1 - part->x0) / 2, rows = (part->y1 - part->y0) / 2;
    uint16_t mixed[WATER + 2], code[2 * WATER];
    for (int32_t row = part->y0; row < part->y1; row++) {
        const int32_t own = (row - part->y0) / 2, other = nearer(own + ((row - part->y0) % 2 ? 1 : -1), rows);
        const uint8_t *near = codes + (int64_t)own * columns, *far = codes + (int64_t)other * columns;
        for (int32_t x = 0; x < columns; x += WATER) {
            const int32_t n = columns - x < WATER ? columns - x : WATER;
            const int32_t before = nearer(x - 1, columns), after = nearer(x + n, columns);
            const int64_t at = (int64_t)row * part->w + part->x0 + 2 * x;
            mixed[0] = (uint16_t)(3 * near[before] + far[before]);
            mix_rows(n, near + x, far + x, mixed + 1);
            mixed[n + 1] = (uint16_t)(3 * near[after] + far[after]);
            mix_columns(n, mixed, code);
            colour_row(2 * n, code, colours, mask ? mask + at : 0, scene + 4 * at);
        }
    }
}
