/* Fit profiles across edges: coverage, paints, residuals and noise. */

#include <math.h>
#include <string.h>

#include "vision/register/near.h"
#include "base/wide.h"

/* How far an edge may still be off while the pose moves: the residuals that this causes are no outliers. */
static const double STILL_OFF_PX = 0.1;
/* Limits on a group's contrast relative to its kind's: shade, sun and wear stay within them, a foreign edge does not. */
static const double CONTRAST_LEAST = 0.4, CONTRAST_MOST = 2.5;
/* Coverage varies within a group by more than this, as a variance, where an edge passes through it. */
static const double SPREAD_LEAST = 0.02;
/* Squares of residuals beyond this many variances are outliers, for the line over coverage and, in usual variances, for the mean. */
static const double OUTLIER = 16.0, UNUSUAL = 9.0;
static const double VARIANCE_LEAST = 0.05; /* Least variance, of the usual one. */
static const double NOISE_LEAST = 1e-9; /* Least variance, in squares of a contrast. */
/* The fraction of its greatest value below which a determinant counts as zero. */
static const double DEGENERATE = 1e-4;
/* The fewest pixels of a kind for its noise, and for its colours. */
enum { NOISE_PIXELS = 12, COLOUR_PIXELS = 8 };

void cover_profiles(const dl_pad_shape *pad, const fit_state *s, const profiles *p, int looked, near_rows *d)
{
    float *const spare[2] = {d->spare[0], d->spare[1]};
    const float m_per_px2 = (float)(s->m_per_px * s->m_per_px);
    d->f.n = p->n;
    if (!looked) {
        look_at(s, p->ray_x, p->ray_y, &d->f);
    }
    prepare_circles(&d->f, &d->round);
    for (int kind = 0; kind < DL_EDGE_KINDS; kind++) {
        const int begin = p->kind_begin[kind], count = p->kind_begin[kind + 1] - begin;
        float *const by[BY] = {d->d[0] + begin, d->d[1] + begin, d->d[2] + begin, d->d[3] + begin, d->d[4] + begin};
        if (count) {
            const stretch at = {&d->f, &d->round, begin, count};
            cover(pad, &pad->kinds[kind], &at, d->value + begin, by, spare);
        }
    }
    for (int i = 0; i < p->n; i++) {
        d->per_px[i] = sqrtf((d->d[0][i] * d->d[0][i] + d->d[1][i] * d->d[1][i]) * d->f.m[i] * m_per_px2);
    }
    const float *const by[BY] = {d->d[0], d->d[1], d->d[2], d->d[3], d->d[4]};
    by_state(&d->f, by, 0, p->n, d->J);
}

/* Sums of a kind: pixels, coverage and its square, light and light times coverage by channel. */
typedef struct {
    double n, s, ss, light[CHANNELS], lit[CHANNELS];
} colour_sums;

static colour_sums sum_colours(const profiles *p, int kind, const near_rows *d)
{
    colour_sums out = {0.0, 0.0, 0.0, {0.0}, {0.0}};
    for (int i = p->kind_begin[kind]; i < p->kind_begin[kind + 1]; i++) {
        const double w = p->usable[i], s = w * d->value[i];
        out.n += w, out.s += s, out.ss += s * d->value[i];
        for (int c = 0; c < CHANNELS; c++) {
            out.light[c] += w * p->light[c][i];
            out.lit[c] += s * p->light[c][i];
        }
    }
    return out;
}

void mix_channels(const dl_pad_shape *pad, const profiles *p, const near_rows *d, channel_mix *out)
{
    int good[DL_EDGE_KINDS];
    memset(out, 0, sizeof *out);
    for (int kind = 0; kind < DL_EDGE_KINDS; kind++) {
        const colour_sums sums = sum_colours(p, kind, d);
        const double total = fmax(sums.n, 1e-9), spread = fmax(sums.ss - sums.s * sums.s / total, 1e-9);
        double contrast[CHANNELS], weight[CHANNELS], norm = 0.0;
        for (int c = 0; c < CHANNELS; c++) {
            const double mean = sums.light[c] / total;
            contrast[c] = (sums.lit[c] - mean * sums.s) / spread;
            weight[c] = contrast[c] / (mean + 0.02);
            norm += contrast[c] * weight[c];
        }
        good[kind] = sums.n >= COLOUR_PIXELS && norm >= 1e-6;
        for (int c = 0; c < CHANNELS && good[kind]; c++) {
            out->contrast[kind][c] = contrast[c], out->mix[kind][c] = weight[c] / norm;
        }
    }
    for (int kind = 0; kind < DL_EDGE_KINDS; kind++) {
        /* Of kinds with one paint: where there is no pointer, a mix of its own would make one out of the ring. */
        const int from = (int)pad->paint_of_kind[kind];
        if (from != kind && good[from]) {
            memcpy(out->mix[kind], out->mix[from], sizeof out->mix[kind]);
            memcpy(out->contrast[kind], out->contrast[from], sizeof out->contrast[kind]);
        }
    }
}

/* The least squares of a line over coverage 0..1, by its values at both ends, neither of them below `least`. */
static void fit_line(const double A[3], const double b[2], double least, double ends[2])
{
    const double det = A[0] * A[2] - A[1] * A[1];
    if (!(det > DEGENERATE * A[0] * A[2])) {
        return;
    }
    ends[0] = (A[2] * b[0] - A[1] * b[1]) / det, ends[1] = (A[0] * b[1] - A[1] * b[0]) / det;
    if (ends[0] < least) {
        ends[0] = least, ends[1] = fmax(least, (b[1] - A[1] * least) / A[2]);
    } else if (ends[1] < least) {
        ends[1] = least, ends[0] = fmax(least, (b[0] - A[1] * least) / A[0]);
    }
}

/* The normal equations of a line by the values at its ends. */
typedef struct {
    double A[3], b[2];
} line_sums;

/* Of n pixels those with a weight count, by the variance that the line between `ends` gives them. */
WIDE
static line_sums sum_line(int n, const float *restrict r, const float *restrict weight, const float *restrict value,
                          const double ends[2])
{
    const float outside = (float)ends[0], more = (float)(ends[1] - ends[0]), outlier = (float)OUTLIER;
    float oo[LANES] = {0.0f}, oi[LANES] = {0.0f}, ii[LANES] = {0.0f}, oq[LANES] = {0.0f}, iq[LANES] = {0.0f};
    for (int i = 0; i < n; i += LANES) {
        for (int l = 0; l < LANES; l++) {
            const float s = value[i + l], per = 1.0f / (outside + more * s), q = r[i + l] * r[i + l] * per;
            const float w = weight[i + l] > 0.0f && q < outlier ? per : 0.0f, in = w * s, out = w - in;
            oo[l] += out * out, oi[l] += out * in, ii[l] += in * in, oq[l] += out * q, iq[l] += in * q;
        }
    }
    line_sums sums = {{0.0, 0.0, 0.0}, {0.0, 0.0}};
    for (int l = 0; l < LANES; l++) {
        sums.A[0] += oo[l], sums.A[1] += oi[l], sums.A[2] += ii[l];
        sums.b[0] += oq[l], sums.b[1] += iq[l];
    }
    return sums;
}

/* The variances of a kind outside and inside of its edges: of the line over coverage that the squares of its residuals follow. Means
 * by side would mix both: paints as dark or bright as a frame can show have a fraction of the noise of the pixels between them. */
static void fit_variances(const profiles *p, int kind, const float *r, const float *weight, const float *value, double usual,
                          double var[2])
{
    const int begin = p->kind_begin[kind], n = p->kind_begin[kind + 1] - begin;
    var[0] = var[1] = fmax(usual, NOISE_LEAST);
    for (int pass = 0; pass < 2; pass++) {
        const line_sums sums = sum_line(n, r + begin, weight + begin, value + begin, var);
        fit_line(sums.A, sums.b, fmax(VARIANCE_LEAST * usual, NOISE_LEAST), var);
    }
}

/* The mean of the squares of a kind's residuals. */
static double mean_square(const profiles *p, int kind, const float *r, const float *weight, double usual)
{
    double sum = 0.0;
    int n = 0;
    for (int i = p->kind_begin[kind]; i < p->kind_begin[kind + 1]; i++) {
        const double q = (double)r[i] * r[i];
        const int counts = weight[i] > 0.0f && q < UNUSUAL * usual;
        sum += counts ? q : 0.0, n += counts;
    }
    return n ? sum / n : usual;
}

/* The variance of each kind's pixels, from residuals and weights. */
static void noise_of(const profiles *p, const float *r, const float *weight, near_rows *d, near_fit *fit)
{
    for (int kind = 0; kind < DL_EDGE_KINDS; kind++) {
        double *noise = fit->noise[kind];
        int count = 0;
        noise[0] = noise[1] = fit->mean_noise[kind] = 1.0;
        for (int i = p->kind_begin[kind]; i < p->kind_begin[kind + 1]; i++) {
            d->spare[1][count] = r[i] * r[i];
            count += weight[i] > 0.0f;
        }
        if (count < NOISE_PIXELS) {
            continue;
        }
        /* Each group spends two of its pixels on its light levels. */
        const int free = count - 2 * p->groups_of_kind[kind];
        const double usual = median_of(count, d->spare[1], (uint32_t *)(void *)d->spare[2]) / MEDIAN_SQUARE;
        const double grow = (double)count / (free > 1 ? free : 1);
        fit_variances(p, kind, r, weight, d->value, usual, noise);
        noise[0] = fmax(grow * noise[0], NOISE_LEAST), noise[1] = fmax(grow * noise[1], NOISE_LEAST);
        fit->mean_noise[kind] = fmax(grow * mean_square(p, kind, r, weight, usual), NOISE_LEAST);
    }
}

/* Sums over a group: weight, and with it coverage, light, and their products; then what counts of pixels whatever their noise, their
 * coverage and its square. */
typedef struct {
    double w, s, y, ss, sy, n, ns, nss;
} level_sums;

WIDE
static level_sums sum_levels(const near_rows *d, int begin, int end)
{
    float w[LANES] = {0.0f}, s[LANES] = {0.0f}, y[LANES] = {0.0f}, ss[LANES] = {0.0f}, sy[LANES] = {0.0f};
    float n[LANES] = {0.0f}, ns[LANES] = {0.0f}, nss[LANES] = {0.0f};
    for (int i = begin; i < end; i += LANES) {
        for (int l = 0; l < LANES; l++) {
            const float weight = d->w[i + l], covered = weight * d->value[i + l], light = d->mixed[i + l];
            const float kept = d->weight[i + l], kept_covered = kept * d->value[i + l];
            w[l] += weight, s[l] += covered, y[l] += weight * light;
            ss[l] += covered * d->value[i + l], sy[l] += covered * light;
            n[l] += kept, ns[l] += kept_covered, nss[l] += kept_covered * d->value[i + l];
        }
    }
    level_sums out = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
    for (int l = 0; l < LANES; l++) {
        out.w += w[l], out.s += s[l], out.y += y[l], out.ss += ss[l], out.sy += sy[l];
        out.n += n[l], out.ns += ns[l], out.nss += nss[l];
    }
    return out;
}

/* The light levels of a group and what they leave of its light. */
static level_sums fit_levels(const group *g, near_rows *d, group_fit *fit)
{
    level_sums sums = sum_levels(d, g->begin, g->end);
    sums.w += 1e-9;
    const double spread = sums.ss - sums.s * sums.s / sums.w;
    fit->contrast = (sums.sy - sums.s * sums.y / sums.w) / fmax(spread, 1e-6 * sums.w);
    fit->outside = (sums.y - fit->contrast * sums.s) / sums.w;
    fit->accepted = CONTRAST_LEAST < fit->contrast && fit->contrast < CONTRAST_MOST &&
                    sums.n * sums.nss - sums.ns * sums.ns > SPREAD_LEAST * sums.n * sums.n;
    const float a = (float)fit->outside, b = (float)fit->contrast;
    for (int i = g->begin; i < g->end; i++) {
        d->residual[i] = d->mixed[i] - a - b * d->value[i];
    }
    return sums;
}

/* Weights from the noise of each side of the edges. */
static void weigh_by_noise(const profiles *p, const near_fit *fit, near_rows *d)
{
    for (int g = 0; g < p->groups; g++) {
        const group *one = &p->each[g];
        const float outside = (float)fit->noise[one->kind][0], more = (float)(fit->noise[one->kind][1] - fit->noise[one->kind][0]);
        for (int i = one->begin; i < one->end; i++) {
            d->per_var[i] = 1.0f / (outside + more * d->value[i]);
            d->w[i] = p->usable[i] * d->per_var[i];
        }
    }
}

/* Tukey's weights of a group's pixels. The state may still be slightly off; the residuals that this causes are no outliers. */
static void weigh_robustly(const profiles *p, const group *g, const group_fit *fit, near_rows *d)
{
    const float tukey2 = (float)(TUKEY * TUKEY), off = (float)(fmin(fabs(fit->contrast), 2.0) * STILL_OFF_PX);
    for (int i = g->begin; i < g->end; i++) {
        const float aside = off * d->per_px[i], most = tukey2 * (aside * aside + 1.0f / d->per_var[i]);
        const float u = 1.0f - d->residual[i] * d->residual[i] / most, kept = u > 0.0f ? u * u : 0.0f;
        d->weight[i] = p->usable[i] * kept;
        d->w[i] *= kept;
    }
}

/* The first linearisation has no noise: one from equal weights serves, the larger of both sides. */
static void weigh_first(const profiles *p, near_rows *d, near_fit *fit)
{
    memcpy(d->w, p->usable, (size_t)p->n * sizeof *d->w);
    memcpy(d->weight, p->usable, (size_t)p->n * sizeof *d->weight);
    for (int g = 0; g < p->groups; g++) {
        fit_levels(&p->each[g], d, &fit->groups[g]);
    }
    noise_of(p, d->residual, d->weight, d, fit);
    for (int kind = 0; kind < DL_EDGE_KINDS; kind++) {
        fit->noise[kind][0] = fit->noise[kind][1] = fmax(fit->noise[kind][0], fit->noise[kind][1]);
    }
    weigh_by_noise(p, fit, d);
}

/* Scale a group's derivatives by its contrast and weigh them. */
WIDE
static void weigh_derivatives(const group *g, float contrast, near_rows *d)
{
    for (int r = 0; r < STATES; r++) {
        float *restrict J = d->J[r], *restrict Jw = d->Jw[r];
        const float *restrict w = d->w;
        for (int i = g->begin; i < g->end; i++) {
            J[i] *= contrast;
            Jw[i] = J[i] * w[i];
        }
    }
}

/* Add a group's information and gradient, its light levels eliminated. */
static void add_group(const group *g, const level_sums *s, near_rows *d, group_fit *fit, near_fit *all)
{
    const float *Jw[STATES], *J[STATES], *const residual[1] = {d->residual + g->begin}, *const value[1] = {d->value + g->begin};
    const int length = g->end - g->begin;
    const double per = 1.0 / fmax(s->w * s->ss - s->s * s->s, 1e-12);
    weigh_derivatives(g, (float)fit->contrast, d);
    memset(fit->sums, 0, sizeof fit->sums);
    for (int i = g->begin; i < g->end; i++) {
        d->spare[0][i - g->begin] = 1.0f;
    }
    const float *const ones[1] = {d->spare[0]};
    for (int r = 0; r < STATES; r++) {
        Jw[r] = d->Jw[r] + g->begin, J[r] = d->J[r] + g->begin;
    }
    add_products(length, STATES, Jw, 1, ones, 1, fit->sums[0]);
    add_products(length, STATES, Jw, 1, value, 1, fit->sums[1]);
    add_products(length, STATES, Jw, 1, residual, 1, all->g);
    add_squares(length, STATES, Jw, J, STATES, all->H);
    fit->inverse[0] = s->ss * per, fit->inverse[1] = -s->s * per, fit->inverse[2] = s->w * per;
    for (int r = 0; r < STATES; r++) {
        fit->levels[0][r] = fit->sums[0][r] * fit->inverse[0] + fit->sums[1][r] * fit->inverse[1];
        fit->levels[1][r] = fit->sums[0][r] * fit->inverse[1] + fit->sums[1][r] * fit->inverse[2];
    }
    for (int i = 0; i < STATES; i++) {
        for (int j = i; j < STATES; j++) {
            all->H[i * STATES + j] -= fit->sums[0][i] * fit->levels[0][j] + fit->sums[1][i] * fit->levels[1][j];
        }
    }
}

void linearise_profiles(const profiles *p, near_rows *d, near_fit *fit)
{
    memset(fit->H, 0, sizeof fit->H);
    memset(fit->g, 0, sizeof fit->g);
    if (fit->has_noise) {
        weigh_by_noise(p, fit, d);
    } else {
        weigh_first(p, d, fit);
    }
    for (int g = 0; g < p->groups; g++) {
        const group *one = &p->each[g];
        group_fit *of = &fit->groups[g];
        level_sums sums = fit_levels(one, d, of);
        if (fit->has_noise) {
            weigh_robustly(p, one, of, d);
            sums = fit_levels(one, d, of);
        }
        for (int i = one->begin; i < one->end && !of->accepted; i++) {
            d->w[i] = d->weight[i] = 0.0f;
        }
        add_group(one, &sums, d, of, fit);
    }
    mirror(STATES, STATES, fit->H);
}

void noise_after(const profiles *p, const double delta[STATES], near_rows *d, near_fit *fit)
{
    float *left = d->spare[0];
    for (int g = 0; g < p->groups; g++) {
        const group_fit *of = &fit->groups[g];
        double a = 0.0, b = 0.0;
        for (int r = 0; r < STATES; r++) {
            a += delta[r] * of->levels[0][r];
            b += delta[r] * of->levels[1][r];
        }
        for (int i = p->each[g].begin; i < p->each[g].end; i++) {
            left[i] = d->residual[i] + (float)a + (float)b * d->value[i];
        }
    }
    for (int r = 0; r < STATES; r++) {
        const float step = (float)delta[r], *J = d->J[r];
        for (int i = 0; i < p->n; i++) {
            left[i] -= step * J[i];
        }
    }
    noise_of(p, left, d->weight, d, fit);
    fit->has_noise = 1;
}

void pointer_amplitude(const dl_pad_shape *pad, const fit_state *s, const profiles *p, near_rows *d, double *amplitude, double *sigma)
{
    const int kind = (int)pad->pointer_kind, begin = kind < 0 ? 0 : p->kind_begin[kind], end = kind < 0 ? 0 : p->kind_begin[kind + 1];
    float *head = d->spare[2];
    double M[9] = {0.0}, a[3] = {0.0}, inverse[9] = {0.0}, squares = 0.0, free = 0.0;
    for (int i = begin; i < end; i++) {
        free += p->usable[i];
    }
    *amplitude = 0.0, *sigma = INFINITY;
    if (free < NOISE_PIXELS) {
        return;
    }
    cover_profiles(pad, s, p, 0, d);
    cover_pointer(pad, &d->f, &d->round, begin, end - begin, head);
    for (int pass = 0; pass < 2; pass++) {
        for (int i = begin; i < end; i++) {
            const double row[3] = {1.0, (double)d->value[i] - head[i - begin], head[i - begin]}, w = p->usable[i];
            const double left = w * (d->mixed[i] - a[0] * row[0] - a[1] * row[1] - a[2] * row[2]);
            squares += pass ? left * left : 0.0;
            for (int j = 0; j < 3 && pass == 0; j++) {
                inverse[4 * j] = 1.0;
                for (int k = 0; k < 3; k++) {
                    M[3 * j + k] += w * row[j] * row[k];
                }
            }
        }
        if (pass == 0) {
            for (int i = begin; i < end; i++) {
                a[0] += p->usable[i] * d->mixed[i], a[1] += p->usable[i] * (d->value[i] - head[i - begin]) * d->mixed[i];
                a[2] += p->usable[i] * head[i - begin] * d->mixed[i];
            }
            M[0] += 1e-6, M[4] += 1e-6, M[8] += 1e-6;
            if (!solve_symmetric(3, 3, M, 1, a) || !solve_symmetric(3, 3, M, 3, inverse)) {
                return;
            }
        }
    }
    *amplitude = a[2];
    *sigma = sqrt(squares / fmax(1.0, free - 3.0) * inverse[8]);
}
