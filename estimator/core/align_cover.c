#include <math.h>
#include <string.h>

#include "align.h"
#include "wide.h"

/* Something that covers a part of the pad is one region with a border. About the pad this border is taken for straight, and beyond
 * it everything for another thing of one colour: of all lines that one is searched for which this explains best. */
enum { WAYS = 24, BINS = 24, ENOUGH = 400, NUMBERS = 8, LEAST = 30 };
/* Least share of the samples on either side of the line, residual variance that a right drawing leaves anyway, and ridge. */
static const double LEAST_LEFT = 0.25, LEAST_COVERED = 0.06, FLOOR = 2e-4, RIDGE = 1e-4;

/* Sums of products of a sample's numbers: coverage (4), light (3) and one. */
typedef float8 sums[NUMBERS];

/* A line on the pad: its direction and place, and what it is worth. */
typedef struct {
    double angle, offset_m, value, left;
} line;

static double number_of(const sums of)
{
    return (double)of[7][7];
}

/* The light's variation that one colour leaves. */
static double varied(const sums of)
{
    double out = 0.0;
    for (int c = 0; c < 3; c++) {
        out += (double)of[4 + c][4 + c] - (double)of[7][4 + c] * (double)of[7][4 + c] / fmax(number_of(of), 1.0);
    }
    return fmax(out, 0.0);
}

/* The light's variation that least-squares paints leave. */
static double unexplained(const sums of)
{
    double A[16], b[12], left = 0.0;
    const double n = number_of(of);
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) {
            A[4 * i + j] = (double)of[i][j] + (i == j ? RIDGE * n : 0.0);
        }
        for (int c = 0; c < 3; c++) {
            b[3 * i + c] = (double)of[i][4 + c];
        }
    }
    if (!align_solve(4, 3, A, b)) {
        return varied(of);
    }
    for (int c = 0; c < 3; c++) {
        left += (double)of[4 + c][4 + c];
        for (int k = 0; k < 4; k++) {
            left -= (double)of[k][4 + c] * b[3 * k + c];
        }
    }
    return fmax(left, 0.0);
}

/* A share of the negative logarithm of the likelihood. */
static double cost(double n, double squares)
{
    return n > 0.0 ? n * log(squares / (3.0 * n) + FLOOR) : 0.0;
}

/* The sums of the samples in strips across a direction. */
WIDE
static void sum_strips(const samples *s, int every, double angle, double reach_m, sums of[BINS])
{
    const float along = (float)cos(angle), across = (float)sin(angle), per = (float)(BINS / (2.0 * reach_m));
    memset(of, 0, BINS * sizeof *of);
    for (int i = 0; i < s->n; i += every) {
        const float8 number = {s->coverage[0][i], s->coverage[1][i], s->coverage[2][i], s->coverage[3][i],
                               s->light[0][i],    s->light[1][i],    s->light[2][i],    1.0f};
        const int at = (int)((along * s->x[i] + across * s->y[i] + (float)reach_m) * per);
        float8 *to = of[at < 0 ? 0 : at < BINS ? at : BINS - 1];
        for (int k = 0; k < NUMBERS; k++) {
            to[k] += number[k] * number;
        }
    }
}

/* The best line across a direction, if it is better than `best`. */
static void try_direction(sums strips[BINS], double angle, double reach_m, line *best)
{
    sums all, left, covered;
    memset(all, 0, sizeof all);
    memset(left, 0, sizeof left);
    for (int k = 0; k < BINS; k++) {
        for (int i = 0; i < NUMBERS; i++) {
            all[i] += strips[k][i];
        }
    }
    const double n = number_of(all);
    for (int k = 0; k < BINS - 1; k++) {
        for (int i = 0; i < NUMBERS; i++) {
            left[i] += strips[k][i];
            covered[i] = all[i] - left[i];
        }
        if (number_of(left) < LEAST_LEFT * n || number_of(left) < LEAST || number_of(covered) < LEAST_COVERED * n) {
            continue;
        }
        const double squares = unexplained(left), value = cost(number_of(left), squares) + cost(number_of(covered), varied(covered));
        if (value < best->value) {
            best->value = value;
            best->angle = angle;
            best->offset_m = (2.0 * (k + 1) / BINS - 1.0) * reach_m;
            best->left = squares / fmax(varied(left), 1e-9);
        }
    }
}

/* The line as a cut: a ray r meets the pad at p, and (n p) (m r) = (n r) (m t) - (n t) (m r) with the pad's normal m. */
static void cut_of(const pad_pose *pose, const line *of, double inward_m, double cut[3])
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

int32_t align_cover(const camera_lens *c, const pad_template *p, const int16_t *maps, const float *light, const frame_part *part,
                    const uint8_t *px, int32_t stride, const pad_pose *pose, float *scratch, cover_line *out)
{
    const double nothing[3] = {0.0, 0.0, 0.0}, reach_m = AROUND_RADII * p->disc_radius_m;
    pixels from;
    samples s;
    sums strips[BINS], all;
    line best = {0.0, 0.0, INFINITY, 1.0};
    align_rows((int)(part->width * part->height), scratch, &from, &s);
    align_light(c, p, part, px, stride, light, pose->t[2], 0, s.squared, &from);
    align_trust(nothing, &from);
    if (!align_samples(p, align_map(p, maps, align_blur_at(c, p, from.side_m, pose->t[2])), &from, pose, 0, &s)) {
        return 0;
    }
    align_take(from.light, &s);
    const int every = s.n / ENOUGH > 1 ? s.n / ENOUGH : 1;
    for (int k = 0; k < WAYS; k++) {
        const double angle = 2.0 * acos(-1.0) * k / WAYS;
        sum_strips(&s, every, angle, reach_m, strips);
        try_direction(strips, angle, reach_m, &best);
    }
    if (!isfinite(best.value)) {
        return 0;
    }
    memset(all, 0, sizeof all);
    for (int k = 0; k < BINS; k++) {
        for (int i = 0; i < NUMBERS; i++) {
            all[i] += strips[k][i];
        }
    }
    cut_of(pose, &best, 0.5 * from.side_m, out->cut);
    out->gain = (cost(number_of(all), unexplained(all)) - best.value) / number_of(all);
    out->left = best.left;
    return 1;
}
