/* Measure the centres of bright spots. */

#include <math.h>
#include <string.h>

#include "vision/lamps/lamps.h"
#include "vision/search/best.h"

/* Distance from the edge within which a spot counts as cut, px. */
enum { EDGE = 3 };
static const double LARGEST_SPOT = 0.02; /* Largest part of the frame that a spot covers. */
static const double LONGEST_SPOT = 4.0; /* Largest ratio of its sides: motion draws a lamp out, a lit edge is longer. */
static const double LONGER_PX = 3.0; /* What a side may be longer besides, px. */
static const double MUCH_SMALLER = 0.4; /* Radius of a spot over that of another one below which it may be a part of the other's halo. */
static const double HALO = 2.7; /* Distance, in radii of the other, below which it is. */
static const double HALO_PX = 4.0; /* The same, px, besides. */
static const double CENTRE_PX = 0.06; /* Standard deviation of a spot's centre that saturation and the lens leave besides noise, px. */
static const double OF_RADIUS = 0.015; /* The same as a part of its radius. */
static const double CROWDED_PX = 0.3; /* Standard deviation that the light of another spot in the same place would leave, px. */
static const double CROWDED_WITHIN_PX = 7.0; /* Distance from which on it leaves none, px. */
/* At most this many of the brightest are examined. */
enum { COMPARED = 128 };

/* Sums over the pixels of a spot: number, places and their squares; brightness, and places weighted by it. */
typedef struct {
    int64_t n, u, v, squares, light, light_u, light_v;
    int left, top, right, low;
} spot_sums;

/* A spot with its brightness. */
typedef struct {
    double light;
    lamp_spot spot;
} ranked_spot;

static int32_t root_of(bright_run *run, int32_t k)
{
    while (run[k].root != k) {
        run[k].root = run[run[k].root].root;
        k = run[k].root;
    }
    return k;
}

/* Give pieces that touch, along a side or a corner, the same root: the first of them. */
static void join(int n, bright_run *run)
{
    int above = 0;
    for (int k = 0; k < n; k++) {
        while (run[above].row < run[k].row - 1 || (run[above].row == run[k].row - 1 && run[above].last < run[k].first - 1)) {
            above++;
        }
        for (int i = above; i < k && run[i].row == run[k].row - 1 && run[i].first <= run[k].last + 1; i++) {
            const int32_t a = root_of(run, i), b = root_of(run, k);
            run[a > b ? a : b].root = a > b ? b : a;
        }
    }
}

static void add_run(const bright_part *part, const bright_run *run, spot_sums *s)
{
    const uint16_t *light = part->smooth + (int64_t)run->row * part->pitch;
    for (int u = run->first; u <= run->last; u++) {
        s->u += u, s->squares += (int64_t)u * u + (int64_t)run->row * run->row;
        s->light += light[u], s->light_u += (int64_t)light[u] * u, s->light_v += (int64_t)light[u] * run->row;
    }
    const int pixels = run->last - run->first + 1;
    s->n += pixels, s->v += (int64_t)run->row * pixels;
    s->left = run->first < s->left ? run->first : s->left;
    s->right = run->last > s->right ? run->last : s->right;
    s->low = run->row;
}

/* Sum up the pieces from the first of a spot on; they end where a whole row has none of them. */
static void sum_up(const bright_part *part, int first, spot_sums *s)
{
    memset(s, 0, sizeof *s);
    s->left = part->width, s->top = s->low = part->run[first].row;
    for (int k = first; k < part->runs && part->run[k].row <= s->low + 1; k++) {
        if (root_of(part->run, k) == first) {
            add_run(part, &part->run[k], s);
        }
    }
}

/* Whether a spot lies wholly in the part, and has the size and shape of a lamp. */
static int is_lamp(const bright_part *part, const spot_sums *s)
{
    const int width = s->right - s->left + 1, height = s->low - s->top + 1;
    const int longer = width > height ? width : height, shorter = width > height ? height : width;
    return (double)s->n <= LARGEST_SPOT * part->width * part->height && longer <= LONGEST_SPOT * shorter + LONGER_PX && s->left >= EDGE &&
           s->top >= EDGE && s->right + 1 + EDGE <= part->width && s->low + 1 + EDGE <= part->height;
}

static lamp_spot spot_at(const bright_part *part, const lit_part *of, const spot_sums *s)
{
    const double light = fmax((double)s->light, 1.0), u = (double)s->light_u / light, v = (double)s->light_v / light;
    const double n = (double)s->n;
    const double squares = (double)s->squares - 2.0 * (u * (double)s->u + v * (double)s->v) + n * (u * u + v * v);
    lamp_spot spot = {{u + of->left, v + of->top}, 0.0, sqrt(n / LAMPS_PI)};
    const double by_noise = fmax(part->noise, 1.0) * sqrt(fmax(squares, 0.0) / 2.0) / light;
    spot.sigma = hypot(hypot(CENTRE_PX, OF_RADIUS * spot.radius), by_noise);
    return spot;
}

/* Whether a spot lies in the halo of a much larger one, where its light breaks up. */
static int in_halo(const lamp_spot *spot, int n, const ranked_spot *all)
{
    for (int k = 0; k < n; k++) {
        const lamp_spot *other = &all[k].spot;
        const double away = hypot(spot->uv[0] - other->uv[0], spot->uv[1] - other->uv[1]);
        if (spot->radius < MUCH_SMALLER * other->radius && away < HALO * other->radius + HALO_PX) {
            return 1;
        }
    }
    return 0;
}

/* Take the light of its nearest neighbour into each spot's standard deviation. */
static void allow_for_neighbours(lamp_spots *spots)
{
    for (int k = 0; k < spots->n; k++) {
        double least = CROWDED_WITHIN_PX;
        for (int i = 0; i < spots->n; i++) {
            const double away = hypot(spots->spot[i].uv[0] - spots->spot[k].uv[0], spots->spot[i].uv[1] - spots->spot[k].uv[1]);
            least = i != k && away < least ? away : least;
        }
        spots->spot[k].sigma = hypot(spots->spot[k].sigma, CROWDED_PX * (1.0 - least / CROWDED_WITHIN_PX));
    }
}

void spots_of(const bright_part *part, const lit_part *of, lamp_spots *out)
{
    ranked_spot all[COMPARED];
    spot_sums sums;
    int n = 0;
    out->n = 0;
    join(part->runs, part->run);
    for (int k = 0; k < part->runs; k++) {
        if (part->run[k].root == k) {
            sum_up(part, k, &sums);
            if (is_lamp(part, &sums)) {
                const ranked_spot one = {(double)sums.light, spot_at(part, of, &sums)};
                n = insert_best(&one, sizeof one, offsetof(ranked_spot, light), n, COMPARED, all);
            }
        }
    }
    for (int k = 0; k < n && out->n < DL_LAMP_SPOTS_MAX; k++) {
        if (!in_halo(&all[k].spot, n, all)) {
            out->spot[out->n++] = all[k].spot;
        }
    }
    allow_for_neighbours(out);
}
