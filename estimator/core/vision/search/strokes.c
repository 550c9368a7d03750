/* Search a frame for the strokes of an H. */

#include <math.h>
#include <string.h>

#include "base/arena.h"
#include "base/rotation.h"
#include "base/wide.h"
#include "vision/search/best.h"
#include "vision/search/search.h"

enum { LONGEST = 72, LEAST_WIDTH = 4, MOST_WIDTH = 70, WIDE_FROM = 9, FEWEST = 8, WIDTHS = 2, LIMITS = 2 };
/* Work of a pixel, and of looking for an H of one size in it. */
enum { IMAGE_WORK = 16, SIZE_WORK = 17 };
/* Weights of runs one and two pixels longer or shorter. */
static const double NEXT = 0.7, SECOND = 0.4;
/* Widths within this fraction of each other are one. */
static const double SAME_WIDTH = 0.15;
/* Least depth of the H, m. */
static const double LEAST_STROKE_DEPTH_M = 0.02;

/* The darkest channel, the upright view, its marks, the sums over these, the scores of places, and the beginnings of runs. */
typedef struct {
    uint8_t *grey;
    int16_t *upright;
    int8_t *mask;
    int32_t *sums, *starts;
    float *score;
} stroke_space;

static stroke_space divide(const strokes_image *image, arena *a)
{
    const int64_t n = strokes_size(image), number = sizeof(int32_t);
    stroke_space w;
    w.grey = take(a, image->width * image->height);
    w.upright = take(a, n * n * (int64_t)sizeof *w.upright);
    w.mask = take(a, n * n);
    w.sums = take(a, strokes_sums(n) * number);
    w.score = take(a, n * n * number);
    w.starts = take(a, n * number);
    return w;
}

int64_t strokes_room(int64_t width, int64_t height)
{
    const strokes_image image = {.width = width, .height = height};
    arena counted = {NULL, 0};
    divide(&image, &counted);
    return arena_numbers(&counted);
}

WIDE
static void mask_of(int n, const int16_t *grey, int limit, int8_t *out)
{
    for (int i = 0; i < n; i++) {
        out[i] = (int8_t)(grey[i] < 0 ? 0 : grey[i] > limit ? 1 : -1);
    }
}

/* Count the runs of marks between background along rows and columns. `starts` has the beginning of each column's run, or -1. */
static void count_runs(int n, const int8_t *mask, int32_t *starts, double count[LONGEST])
{
    for (int i = 0; i < n; i++) {
        starts[i] = -1;
    }
    for (int row = 0; row < n; row++) {
        const int8_t *here = mask + row * n, *above = here - n;
        int start = -1;
        for (int i = 1; i < n; i++) {
            if (here[i] != here[i - 1]) {
                const int length = i - start;
                if (here[i] < 0 && here[i - 1] > 0 && start >= 0 && length < LONGEST) {
                    count[length] += 1.0;
                }
                start = here[i] > 0 && here[i - 1] < 0 ? i : -1;
            }
        }
        for (int i = 0; row > 0 && i < n; i++) {
            if (here[i] != above[i]) {
                const int length = row - starts[i];
                if (here[i] < 0 && above[i] > 0 && starts[i] >= 0 && length < LONGEST) {
                    count[length] += 1.0;
                }
                starts[i] = here[i] > 0 && above[i] < 0 ? row : -1;
            }
        }
    }
}

static double count_about(const double count[LONGEST], int k)
{
    const double side = count[k - 1] + (k + 1 < LONGEST ? count[k + 1] : 0.0);
    const double beyond = count[k - 2] + (k + 2 < LONGEST ? count[k + 2] : 0.0);
    return count[k] + NEXT * side + (k >= WIDE_FROM ? SECOND * beyond : 0.0);
}

int strokes_widths(int n, const int8_t *mask, int32_t *starts, double widths[2])
{
    double count[LONGEST];
    int found = 0;
    memset(count, 0, sizeof count);
    count_runs(n, mask, starts, count);
    memset(count, 0, LEAST_WIDTH * sizeof *count);
    memset(count + MOST_WIDTH, 0, (LONGEST - MOST_WIDTH) * sizeof *count);
    while (found < WIDTHS) {
        int best = LEAST_WIDTH;
        for (int k = LEAST_WIDTH; k < MOST_WIDTH; k++) {
            best = count_about(count, k) > count_about(count, best) ? k : best;
        }
        if (count_about(count, best) < FEWEST) {
            break;
        }
        const int reach = SAME_WIDTH * best > 1.0 ? (int)floor(SAME_WIDTH * best + 0.5) : 1;
        double all = 0.0, sum = 0.0;
        for (int k = best - reach; k <= best + reach && k < LONGEST; k++) {
            all += count[k];
            sum += count[k] * k;
            count[k] = 0.0;
        }
        widths[found++] = all > 0.0 ? sum / all : (double)best;
    }
    return found;
}

/* The pose of an H found in an upright view; returns whether it is in front of the lens. */
static int pose_of(const strokes_image *image, const upright_view *view, const dl_pad_strokes *h, const stroke_place *at, double width,
                   dl_guess *out)
{
    const double quarter = acos(0.0), depth = h->leg_m * view->focal / width, *to = view->to_plane;
    const double x = (double)at->x, y = (double)at->y;
    const double place[3] = {(to[0] * x + to[1] * y + to[2]) * depth, (to[3] * x + to[4] * y + to[5]) * depth, depth};
    double turn[9];
    about_down(view->turn + (at->across ? quarter : 0.0), turn);
    product(image->R_cam_plane, turn, out->R);
    rotated(image->R_cam_plane, place, out->t);
    out->turn_rad = out->support = out->side[0] = out->side[1] = 0.0;
    out->drawing = (double)at->score;
    out->known = image->plane_known;
    out->one_sided = 0;
    return out->t[2] > LEAST_STROKE_DEPTH_M;
}

/* Find the strokes of an H in an image; returns how many places. */
static int32_t find(const dl_tracker *t, const strokes_image *image, const uint8_t *px, int32_t most, dl_guess *out)
{
    const dl_lens *c = &t->camera.lens;
    const dl_pad_strokes *h = &t->pad.strokes;
    const int64_t pixels = image->width * image->height, n = strokes_size(image);
    arena memory = {t->scratch, 0};
    const stroke_space w = divide(image, &memory);
    int32_t found = 0;
    double angle, widths[WIDTHS];
    int limits[LIMITS];
    upright_view view;
    count_work(t, pixels, IMAGE_WORK);
    strokes_darkest(image, px, w.grey);
    if (!strokes_direction((int)image->width, (int)image->height, w.grey, &angle) || !strokes_place(c, image, angle, &view)) {
        return 0;
    }
    const int shades = strokes_limits((int)pixels, w.grey, limits);
    strokes_upright(image, &view, w.grey, w.upright);
    count_work(t, n * n, IMAGE_WORK);
    for (int k = 0; k < shades; k++) {
        mask_of((int)(n * n), w.upright, limits[k], w.mask);
        const int sizes = strokes_widths((int)n, w.mask, w.starts, widths);
        for (int i = 0; i < sizes; i++) {
            stroke_place places[STROKES_PLACES];
            count_work(t, n * n, SIZE_WORK);
            const int fits = strokes_fit(h, (int)n, w.mask, widths[i], w.sums, w.score, places);
            for (int j = 0; j < fits; j++) {
                dl_guess one;
                if (pose_of(image, &view, h, &places[j], widths[i], &one)) {
                    found = insert_best(&one, sizeof one, offsetof(dl_guess, drawing), found, most, out);
                }
            }
        }
    }
    return found;
}

int32_t dl_search_strokes(dl_tracker *t, const dl_image *of, const dl_stroke_search *how, dl_guess *out)
{
    if (!t->has_drawing || !is_image(of, 3) || how->step < 1 || strokes_room(of->width, of->height) > t->floats) {
        return DL_WRONG_SIZE;
    }
    strokes_image seen = {of->width, of->height, of->stride, how->step, how->bright, how->plane_known, {0.0}};
    memcpy(seen.R_cam_plane, how->R_cam_plane, sizeof seen.R_cam_plane);
    return find(t, &seen, of->px, (int32_t)how->most, out);
}
