/* Find the straight border of what covers a part of the pad. */

#include <math.h>
#include <string.h>

#include "vision/align/align.h"
#include "base/wide.h"

/* Something that covers a part of the pad is one region with a border. About the pad this border is taken for straight, and beyond
 * it everything for another thing of one colour: of all lines that one is searched for which this explains best. */
enum { WAYS = 24, BINS = 24, ENOUGH = 400, LEAST = 30, COVER_WORK = 600 };
static const double LEAST_LEFT = 0.25; /* Least share of the samples on the line's near side. */
static const double LEAST_COVERED = 0.06; /* Least share on its far side. */
static const double FLOOR = 2e-4; /* Residual variance that a right drawing leaves anyway. */

/* What is certain of a sum of squares after rounding. */
static const double ROUNDED = 0.999;

/* A line on the pad: its direction, place and worth. */
typedef struct {
    double angle, offset_m, value, left;
} line;

/* A share of the negative logarithm of the likelihood. */
static double cost(double n, double squares)
{
    return n > 0.0 ? n * log(squares / (3.0 * n) + FLOOR) : 0.0;
}

/* The sums of the samples in strips across a direction. */
WIDE
static void sum_strips(const samples *s, int every, double angle, double reach_m, fit_sums of[BINS])
{
    const float along = (float)cos(angle), across = (float)sin(angle), per = (float)(BINS / (2.0 * reach_m));
    memset(of, 0, BINS * sizeof *of);
    for (int i = 0; i < s->n; i += every) {
        const int at = (int)((along * s->x[i] + across * s->y[i] + (float)reach_m) * per);
        align_add(s, i, of[at < 0 ? 0 : at < BINS ? at : BINS - 1]);
    }
}

/* The best line across a direction, or against it from the last strip on, if it is better than `best`. With each strip on this side
 * the squares that are left can only grow: those of a line before say of most lines that they are not better. */
static void try_direction(fit_sums strips[BINS], const fit_sums all, double angle, int against, double reach_m, line *best)
{
    fit_sums left, covered;
    double so_far = 0.0;
    const double n = align_number(all);
    memset(left, 0, sizeof left);
    for (int k = 0; k < BINS - 1; k++) {
        for (int i = 0; i < SUM_ROWS; i++) {
            left[i] += strips[against ? BINS - 1 - k : k][i];
            covered[i] = all[i] - left[i];
        }
        if (align_number(left) < LEAST_LEFT * n || align_number(left) < LEAST || align_number(covered) < LEAST_COVERED * n) {
            continue;
        }
        const double beyond = cost(align_number(covered), align_varied(covered));
        if (cost(align_number(left), ROUNDED * so_far) + beyond >= best->value) {
            continue;
        }
        const double squares = align_unexplained(left);
        const double value = cost(align_number(left), squares) + beyond;
        so_far = squares;
        if (value < best->value) {
            best->value = value;
            best->angle = against ? angle + acos(-1.0) : angle;
            best->offset_m = (2.0 * (k + 1) / BINS - 1.0) * reach_m;
            best->left = squares / fmax(align_varied(left), 1e-9);
        }
    }
}

/* The line as a cut: a ray r meets the pad at p, and (n p) (m r) = (n r) (m t) - (n t) (m r) with the pad's normal m. */
static void cut_of(const dl_pad_pose *pose, const line *of, double inward_m, double cut[3])
{
    const double *R = pose->R, *t = pose->t, x = cos(of->angle), y = sin(of->angle);
    double n[3], n_t = 0.0, m_t = 0.0;
    for (int i = 0; i < 3; i++) {
        n[i] = R[3 * i] * x + R[3 * i + 1] * y;
        n_t += n[i] * t[i];
        m_t += R[3 * i + 2] * t[i];
    }
    for (int i = 0; i < 3; i++) {
        cut[i] = (of->offset_m - inward_m + n_t) * R[3 * i + 2] - m_t * n[i];
    }
    const double size = fmax(hypot(cut[0], cut[1]), 1e-12);
    for (int i = 0; i < 3; i++) {
        cut[i] /= size;
    }
}

int align_cover(const dl_tracker *t, const seen_part *seen, const dl_pad_pose *pose, dl_cover_line *out)
{
    const dl_lens *c = &t->camera.lens;
    const dl_pad_template *p = &t->pad.drawn;
    const double nothing[3] = {0.0, 0.0, 0.0}, reach_m = AROUND_RADII * p->disc_radius_m;
    pixels from;
    samples s;
    fit_sums strips[BINS], all;
    line best = {0.0, 0.0, INFINITY, 1.0};
    align_divide(seen->part.width, seen->part.height, t->scratch, &from, &s);
    align_light(t, seen, pose->t[2], 0, s.squared, &from);
    align_trust(nothing, &from);
    if (!align_samples(p, align_map(p, t->maps, align_blur_at(c, p, from.side_m, pose->t[2])), &from, pose, 0, &s)) {
        return 0;
    }
    align_take(from.light, &s);
    const int every = s.n / ENOUGH > 1 ? s.n / ENOUGH : 1;
    count_work(t, s.n / every, COVER_WORK);
    for (int k = 0; k < WAYS / 2; k++) {
        const double angle = 2.0 * acos(-1.0) * k / WAYS;
        sum_strips(&s, every, angle, reach_m, strips);
        if (k == 0) {
            align_total(BINS, strips, all);
        }
        try_direction(strips, all, angle, 0, reach_m, &best);
        try_direction(strips, all, angle, 1, reach_m, &best);
    }
    if (!isfinite(best.value)) {
        return 0;
    }
    cut_of(pose, &best, 0.5 * from.side_m, out->cut);
    out->gain = (cost(align_number(all), align_unexplained(all)) - best.value) / align_number(all);
    out->left = best.left;
    return 1;
}
