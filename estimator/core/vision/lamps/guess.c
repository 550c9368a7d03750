/* Guesses of the pad's pose from pairs of spots, with no idea where it is.
 *
 * Seen level, the pad's plane is a similarity of the drawing: two spots that are two lamps give place, height and heading. Every pair of
 * spots is tried as each of some pairs of lamps, and each of these poses is scored by the number of spots it explains. */

#include <math.h>
#include <string.h>

#include "base/arena.h"
#include "base/rotation.h"
#include "vision/lamps/lamps.h"
#include "vision/tracker.h"

/* At most this many of the brightest spots are paired. A lamp explains spots within `REACH` cells, a focal length having as many as pixels, and one of
 * a small pattern those within `CLOSE`; what lies `CELLS` from the first spot's side of the frame is left out. */
enum { PAIRED = 18, REACH = 2, CLOSE = 1, CELLS = 8192, MARGIN = REACH + 1, LEAST_EXPLAINED = 3 };
/* Largest distance of a small pattern's lamps from its centre, along the worse axis of the pad, px. */
static const double SMALL_PX = 30.0;
/* Heights of the camera that are tried. */
static const double LOWEST_M = 0.1, HIGHEST_M = 40.0;
/* Cosine of the flattest ray that is looked at. */
static const double LEAST_DOWN = 0.2;
static const double ONE_PLACE = 0.02; /* Part of the range within which two guesses are one. */
static const double ONE_HEADING = 0.9950041652780258; /* Cosine of the turn between them within which they are: 0.1 rad. */

/* Forward and right over down as a complex number: a turn clockwise, seen from above, is a factor. */
typedef struct {
    double re, im;
} level_place;

/* z = by lamp + at */
typedef struct {
    level_place by, at;
} similarity;

/* Where in a word the bits of spots are that lie within `REACH`, just `REACH` away, and within `CLOSE`. */
enum { WITHIN = 0, EDGE = 20, BESIDE = 40, ALL = (1 << PAIRED) - 1 };

/* Spots in the level plane, and for each column and row of cells which of them it is near, in three parts of a word. */
typedef struct {
    int n, columns, rows;
    double focal_px, reach_m, left, top;
    level_place spot[PAIRED];
    uint64_t *column, *row;
} spot_table;

typedef struct {
    double height;
    level_place at, turn;
} level_guess;

/* Divide the scratch into the cells of the table and the counts of each pair of spots as each pair of lamps. */
static uint8_t *divide(arena *a, spot_table *t)
{
    t->column = take(a, CELLS * (int64_t)sizeof *t->column);
    t->row = take(a, CELLS * (int64_t)sizeof *t->row);
    return take(a, DL_LAMP_PAIRS_MAX * PAIRED * (PAIRED - 1));
}

int64_t guess_room(void)
{
    spot_table table;
    arena counted = {NULL, 0};
    divide(&counted, &table);
    return arena_numbers(&counted);
}

static level_place times(level_place a, level_place b)
{
    const level_place product = {a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
    return product;
}

static level_place over(level_place a, level_place b)
{
    const double per = 1.0 / (b.re * b.re + b.im * b.im);
    const level_place quotient = {(a.re * b.re + a.im * b.im) * per, (a.im * b.re - a.re * b.im) * per};
    return quotient;
}

static level_place lamp_at(const dl_lamp_pattern *pad, int64_t k)
{
    const level_place lamp = {pad->x_m[k], pad->y_m[k]};
    return lamp;
}

/* The spots' places in the level plane, as far as their rays point down. */
static void put_level(const dl_lens *camera, const double R_level_cam[9], const lamp_spots *spots, spot_table *out)
{
    out->n = 0;
    for (int k = 0; k < spots->n && k < PAIRED; k++) {
        double ray[3] = {0.0, 0.0, 1.0}, r[3];
        camera_ray(camera, spots->spot[k].uv[0], spots->spot[k].uv[1], ray);
        rotated(R_level_cam, ray, r);
        if (r[2] > LEAST_DOWN * sqrt(dot(r, r))) {
            const level_place at = {r[0] / r[2], r[1] / r[2]};
            out->spot[out->n++] = at;
        }
    }
}

/* Mark the cells along one axis that a spot is near. */
static void mark(uint64_t *cells, double cell, int k)
{
    for (int i = -REACH; i <= REACH; i++) {
        const uint64_t edge = i == -REACH || i == REACH, beside = i >= -CLOSE && i <= CLOSE;
        cells[(int)cell + i] |= ((uint64_t)1 << WITHIN | edge << EDGE | beside << BESIDE) << k;
    }
}

/* Fill the table; spots beyond its cells are left out. */
static void fill(const dl_lamp_pattern *pad, double focal_px, spot_table *t)
{
    t->reach_m = 0.0;
    for (int k = 0; k < (int)pad->lamps; k++) {
        t->reach_m = fmax(t->reach_m, fmax(fabs(pad->x_m[k]), fabs(pad->y_m[k])));
    }
    t->focal_px = focal_px, t->left = INFINITY, t->top = INFINITY;
    double right = -INFINITY, low = -INFINITY;
    for (int k = 0; k < t->n; k++) {
        const double column = rint(t->spot[k].re * focal_px), row = rint(t->spot[k].im * focal_px);
        t->left = fmin(t->left, column - MARGIN), t->top = fmin(t->top, row - MARGIN);
        right = fmax(right, column + MARGIN), low = fmax(low, row + MARGIN);
    }
    t->columns = (int)fmax(0.0, fmin(right - t->left + 1.0, CELLS)), t->rows = (int)fmax(0.0, fmin(low - t->top + 1.0, CELLS));
    memset(t->column, 0, (size_t)t->columns * sizeof *t->column), memset(t->row, 0, (size_t)t->rows * sizeof *t->row);
    for (int k = 0; k < t->n; k++) {
        const double column = rint(t->spot[k].re * focal_px) - t->left, row = rint(t->spot[k].im * focal_px) - t->top;
        if (column >= REACH && row >= REACH && column < t->columns - REACH && row < t->rows - REACH) {
            mark(t->column, column, k), mark(t->row, row, k);
        }
    }
}

static int bits_of(uint32_t x)
{
    x -= x >> 1 & 0x55555555u;
    x = (x & 0x33333333u) + (x >> 2 & 0x33333333u);
    x = (x + (x >> 4)) & 0x0f0f0f0fu;
    return (int)(x * 0x01010101u >> 24);
}

/* How many different spots a similarity explains. A spot that is `REACH` away along both axes is farther than that. */
static int explained(const spot_table *t, const dl_lamp_pattern *pad, const similarity *s)
{
    const int is_small = hypot(s->by.re, s->by.im) * t->reach_m * t->focal_px < SMALL_PX;
    uint64_t spots = 0;
    for (int k = 0; k < (int)pad->lamps; k++) {
        const level_place lamp = times(s->by, lamp_at(pad, k));
        const double column = rint((s->at.re + lamp.re) * t->focal_px) - t->left, row = rint((s->at.im + lamp.im) * t->focal_px) - t->top;
        if (column >= 0.0 && row >= 0.0 && column < t->columns && row < t->rows) {
            const uint64_t near = t->column[(int)column] & t->row[(int)row];
            spots |= is_small ? near >> BESIDE : near >> WITHIN & ~(near >> EDGE);
        }
    }
    return bits_of((uint32_t)(spots & ALL));
}

/* The similarity by which two spots are a pair of lamps. */
static similarity of_pair(const spot_table *t, const dl_lamp_pattern *pad, int i, int j, int pair)
{
    const level_place a = lamp_at(pad, pad->pair[2 * pair]), b = lamp_at(pad, pad->pair[2 * pair + 1]);
    const level_place apart = {b.re - a.re, b.im - a.im}, seen = {t->spot[j].re - t->spot[i].re, t->spot[j].im - t->spot[i].im};
    similarity s;
    s.by = over(seen, apart);
    const level_place back = times(s.by, a);
    s.at.re = t->spot[i].re - back.re, s.at.im = t->spot[i].im - back.im;
    return s;
}

/* The n-th ordered pair of different spots. */
static void spots_of_pair(int n, int spots, int *i, int *j)
{
    *i = n / (spots - 1);
    *j = n % (spots - 1);
    *j += *j >= *i;
}

static double height_of(const similarity *s)
{
    return 1.0 / fmax(hypot(s->by.re, s->by.im), 1e-9);
}

/* Count what each pair of spots explains as each pair of lamps; returns the most. */
static int rate(const spot_table *t, const dl_lamp_pattern *pad, uint8_t *counts)
{
    const int tried = t->n * (t->n - 1);
    int most = 0, i, j;
    for (int n = 0; n < tried; n++) {
        spots_of_pair(n, t->n, &i, &j);
        for (int pair = 0; pair < (int)pad->pairs; pair++) {
            const similarity s = of_pair(t, pad, i, j, pair);
            const double height = height_of(&s);
            const int count = height > LOWEST_M && height < HIGHEST_M ? explained(t, pad, &s) : 0;
            counts[n * (int)pad->pairs + pair] = (uint8_t)count;
            most = count > most ? count : most;
        }
    }
    return most;
}

static level_guess guess_of(const similarity *s)
{
    const double height = height_of(s);
    const level_guess g = {height, {height * s->at.re, height * s->at.im}, {height * s->by.re, height * s->by.im}};
    return g;
}

static int is_another(const level_guess *a, int n, const level_guess *before)
{
    const double range = sqrt(a->at.re * a->at.re + a->at.im * a->at.im + a->height * a->height);
    for (int k = 0; k < n; k++) {
        const level_guess *b = &before[k];
        const double re = a->at.re - b->at.re, im = a->at.im - b->at.im, down = a->height - b->height;
        const double turned = a->turn.re * b->turn.re + a->turn.im * b->turn.im;
        if (sqrt(re * re + im * im + down * down) <= ONE_PLACE * range && turned >= ONE_HEADING) {
            return 0;
        }
    }
    return 1;
}

/* The best guesses that differ, those that explain the most first. */
static int choose(const spot_table *t, const dl_lamp_pattern *pad, const uint8_t *counts, int most, level_guess out[LAMP_GUESSES])
{
    const int pairs = (int)pad->pairs, tried = t->n * (t->n - 1) * pairs;
    int n = 0, i, j;
    for (int count = most; count >= LEAST_EXPLAINED; count--) {
        for (int k = 0; k < tried && n < LAMP_GUESSES; k++) {
            if (counts[k] == count) {
                spots_of_pair(k / pairs, t->n, &i, &j);
                const similarity s = of_pair(t, pad, i, j, k % pairs);
                out[n] = guess_of(&s);
                n += is_another(&out[n], n, out);
            }
        }
    }
    return n;
}

static void pose_of(const double R_level_cam[9], const level_guess *g, dl_pad_pose *out)
{
    const double t[3] = {g->at.re, g->at.im, g->height}, turn[9] = {g->turn.re, -g->turn.im, 0.0, g->turn.im, g->turn.re, 0.0, 0.0, 0.0, 1.0};
    product_of_transposed(R_level_cam, turn, out->R);
    rotated_back(R_level_cam, t, out->t);
}

int guess_lamps(const dl_lens *camera, const dl_lamp_pattern *pad, const dl_tilt_prior *prior, const lamp_spots *spots, uint32_t *scratch,
                dl_pad_pose out[LAMP_GUESSES])
{
    double R_level_cam[9];
    level_guess guesses[LAMP_GUESSES + 1];
    spot_table table;
    level_of_camera(camera, prior, R_level_cam);
    put_level(camera, R_level_cam, spots, &table);
    if (table.n < LEAST_EXPLAINED) {
        return 0;
    }
    arena memory = {scratch, 0};
    uint8_t *counts = divide(&memory, &table);
    fill(pad, camera->fx, &table);
    const int n = choose(&table, pad, counts, rate(&table, pad, counts), guesses);
    for (int k = 0; k < n; k++) {
        pose_of(R_level_cam, &guesses[k], &out[k]);
    }
    return n;
}

double guesses_tried(const dl_lamp_pattern *pad, const lamp_spots *spots)
{
    const int n = spots->n < PAIRED ? spots->n : PAIRED;
    return fmax(1.0, (double)(n * (n - 1)) * (double)pad->pairs);
}
