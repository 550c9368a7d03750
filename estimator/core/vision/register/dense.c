/* Linearise the light of all pixels of a distant pad about a state. */

#include "vision/register/dense.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

#include "base/wide.h"

static const float DARK = 0.01f; /* Light at which a sensor's noise in the dark, read-out and rounding, equals the noise of the light. */
/* Light, of the brightest, from which pixels set the scale: darker ones are clipped at zero and look quieter. */
static const float BRIGHT = 0.1f;
/* Initial residual variance of light over light above which a reflection is searched for. */
static const double GLARE_DOUBTED = 5e-4;
/* Light above which a sensor's smoothed pixel may be clipped. */
static const float CLIPPED = 0.9f;
/* Coverage from which a pixel shows the pad alone, and the fewest such pixels for its noise. */
static const float ON_PAD = 0.98f;
enum { ON_PAD_PIXELS = 64 };
static const double LEAST_NOISE = 1e-7; /* Least variance of light over light. */

int take_dense_rows(rows *r, dense_rows *out)
{
    float **all[] = {&out->f.x, &out->f.y, &out->f.k1, &out->f.k2, &out->f.m, &out->round.seen, &out->round.per, &out->round.per_sigma,
                     &out->round.m_cc, &out->round.m_cs, &out->round.m_ss};
    float **by_channel[] = {out->model, out->steep2, out->weight, out->level, out->unsharp, out->w, out->residual, out->added, out->judged};
    int ok = 1;
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) {
        ok &= (*all[i] = take_rows(r, 1)) != NULL;
    }
    for (size_t i = 0; i < sizeof by_channel / sizeof *by_channel; i++) {
        for (int c = 0; c < CHANNELS; c++) {
            ok &= (by_channel[i][c] = take_rows(r, 1)) != NULL;
        }
    }
    for (int i = 0; i < COEFFICIENTS_MAX; i++) {
        ok &= (out->values[i] = take_rows(r, 1)) != NULL;
    }
    for (int i = 0; i < DL_PAD_CONTRASTS * BY; i++) {
        ok &= (out->changes[i / BY][i % BY] = take_rows(r, 1)) != NULL;
    }
    for (int i = 0; i < DENSE_SPARE; i++) {
        ok &= (out->spare[i] = take_rows(r, 1)) != NULL;
    }
    return ok;
}

/* The regressors at a state, and the derivatives of the regions'. */
static void draw(const dl_pad_shape *pad, const patch *cut, const fit_state *s, dense_rows *d)
{
    const int n = whole_lanes(cut->n);
    float *const spare[2] = {d->spare[0], d->spare[1]};
    const stretch all = {&d->f, &d->round, 0, n};
    d->f.n = cut->n;
    look_at(s, cut->ray_x, cut->ray_y, &d->f);
    prepare_circles(&d->f, &d->round);
    for (int i = 0; i < n; i++) {
        d->values[0][i] = 1.0f, d->values[1][i] = cut->slope[0][i], d->values[2][i] = cut->slope[1][i];
    }
    for (int k = 0; k < pad->contrast_count; k++) {
        cover(pad, &pad->contrasts[k], &all, d->values[FIRST_REGION + k], d->changes[k], spare);
    }
}

/* Mark the pixels that set the scale of the noise: bright ones, not clipped ones if there is a reflection. */
WIDE
static void judge(const patch *cut, const float *const light[CHANNELS], int k, int reflection, dense_rows *d)
{
    float top = -INFINITY;
    for (int c = 0; c < CHANNELS; c++) {
        for (int i = 0; i < cut->n; i++) {
            top = light[c][i] > top ? light[c][i] : top;
        }
    }
    for (int c = 0; c < CHANNELS; c++) {
        float *judged = d->judged[c];
        int bright = 0, sound = 0;
        for (int i = 0; i < cut->n; i++) {
            judged[i] = light[c][i] > BRIGHT * top ? 1.0f : 0.0f;
            bright += judged[i] > 0.0f;
        }
        for (int i = 0; i < cut->n && bright < 3 * k; i++) {
            judged[i] = 1.0f;
        }
        for (int i = 0; i < cut->n; i++) {
            sound += judged[i] > 0.0f && cut->light[c][i] < CLIPPED;
        }
        for (int i = 0; i < cut->n && reflection && sound >= 3 * k; i++) {
            judged[i] = cut->light[c][i] < CLIPPED ? judged[i] : 0.0f;
        }
    }
}

/* Solve a channel's weighted least squares for the coefficients, and find the light that they explain and leave. */
WIDE
static int fit_paints(const patch *cut, int c, dense_rows *d, dense_sums *s)
{
    const int n = cut->n, total = s->total;
    double *M = s->M[c], *a = s->a[c], weight = 0.0;
    memset(M, 0, sizeof s->M[c]);
    memset(a, 0, sizeof s->a[c]);
    for (int start = 0; start < n; start += SUM_BLOCK) {
        const int length = whole_lanes(n - start < SUM_BLOCK ? n - start : SUM_BLOCK);
        float weighted[COEFFICIENTS_MAX][SUM_BLOCK];
        const float *left[COEFFICIENTS_MAX], *right[COEFFICIENTS_MAX], *const light[1] = {cut->light[c] + start};
        const float *restrict w = d->w[c] + start;
        for (int k = 0; k < total; k++) {
            const float *restrict value = d->values[k] + start;
            for (int i = 0; i < length; i++) {
                weighted[k][i] = value[i] * w[i];
            }
            left[k] = weighted[k], right[k] = value;
        }
        add_squares(length, total, left, right, COEFFICIENTS_MAX, M);
        add_products(length, total, left, 1, light, 1, a);
    }
    mirror(total, COEFFICIENTS_MAX, M);
    weight = M[0];
    for (int k = 0; k < total; k++) {
        M[k * COEFFICIENTS_MAX + k] += 1e-7 * weight;
    }
    if (!solve_symmetric(total, COEFFICIENTS_MAX, M, 1, a)) {
        return 0;
    }
    float *restrict model = d->model[c], *restrict residual = d->residual[c];
    memset(model, 0, (size_t)whole_lanes(n) * sizeof *model);
    for (int k = 0; k < total; k++) {
        const float part = (float)a[k], *restrict value = d->values[k];
        for (int i = 0; i < whole_lanes(n); i++) {
            model[i] += part * value[i];
        }
    }
    for (int i = 0; i < whole_lanes(n); i++) {
        residual[i] = cut->light[c][i] - model[i];
    }
    return 1;
}

/* The median of squared residuals less the edges' part, over light, times a factor for the noise of Gaussian light: of the pixels that
 * are judged. */
WIDE
static double typical(const patch *cut, int c, int less_edges, const float *judged, const dense_rows *d)
{
    const float *r = d->residual[c], *level = d->level[c], *unsharp = d->unsharp[c];
    int count = 0;
    for (int i = 0; i < cut->n; i++) {
        d->spare[0][count] = (r[i] * r[i] - (less_edges ? unsharp[i] : 0.0f)) / level[i];
        count += judged[i] > 0.0f;
    }
    return count ? median_of(count, d->spare[0], (uint32_t *)(void *)d->spare[1]) / MEDIAN_SQUARE : 0.0;
}

/* The same of a channel's judged pixels that show the pad alone: what lies around it says nothing of what lies on it. Of all judged
 * ones where there are too few. */
static double typical_on_pad(const dl_pad_shape *pad, const patch *cut, int c, dense_rows *d)
{
    float *on = d->spare[2];
    int count = 0;
    for (int i = 0; i < cut->n; i++) {
        float covered = 0.0f;
        for (int k = 0; k < pad->contrast_count; k++) {
            covered += pad->lies_on[k] < 0 ? d->values[FIRST_REGION + k][i] : 0.0f;
        }
        on[i] = covered > ON_PAD ? d->judged[c][i] : 0.0f;
        count += on[i] > 0.0f;
    }
    return typical(cut, c, 0, count >= ON_PAD_PIXELS ? on : d->judged[c], d);
}

/* Tukey's weights of a channel's pixels from their residuals. */
WIDE
static void set_robust_weights(const patch *cut, int c, double noise, int reflection, dense_rows *d)
{
    const float *restrict r = d->residual[c], *restrict level = d->level[c], *restrict unsharp = d->unsharp[c];
    const float *restrict light = cut->light[c], scale = (float)noise, per = (float)(1.0 / (TUKEY * TUKEY));
    const float clipped = reflection ? CLIPPED : INFINITY;
    float *restrict weight = d->weight[c], *restrict w = d->w[c];
    for (int i = 0; i < cut->n; i++) {
        const float per_var = 1.0f / (scale * level[i] + unsharp[i]), u = 1.0f - r[i] * r[i] * per_var * per;
        const float kept = u > 0.0f ? u * u : 0.0f, sound = light[i] < clipped ? kept : 0.0f;
        weight[i] = sound;
        w[i] = sound * per_var;
    }
}

/* Give every pixel its full weight, over the variance that the last linearisation's noise assumes. */
WIDE
static void set_weights(const patch *cut, double noise, int first, dense_rows *d)
{
    const float edge_var = (float)(EDGE_SIGMA_PX * EDGE_SIGMA_PX), scale = (float)noise;
    for (int c = 0; c < CHANNELS; c++) {
        const float *light = first ? cut->light[c] : d->model[c];
        for (int i = 0; i < whole_lanes(cut->n); i++) {
            const float level = (light[i] > 0.0f ? light[i] : 0.0f) + DARK, unsharp = first ? 0.0f : edge_var * d->steep2[c][i];
            d->level[c][i] = level, d->unsharp[c][i] = unsharp;
            d->weight[c][i] = i < cut->n ? 1.0f : 0.0f;
            d->w[c][i] = i < cut->n ? 1.0f / (first ? level : scale * level + unsharp) : 0.0f;
        }
    }
}

/* Look for a reflection if the first paints leave too much. */
static int find_glare(const dl_pad_shape *pad, const patch *cut, dense_rows *d, dense_sums *s, glare *found)
{
    double left = 0.0;
    for (int c = 0; c < CHANNELS; c++) {
        if (!fit_paints(cut, c, d, s)) {
            return 0;
        }
        for (int i = 0; i < cut->n; i++) {
            left += (double)d->w[c][i] * d->residual[c][i] * d->residual[c][i];
        }
    }
    if (left / (CHANNELS * cut->n) > GLARE_DOUBTED + NOISE_DOUBT * cut->noise) {
        *found = glare_found(&d->f, d->residual, d->w, s->k, d->values, pad->disc_radius_m, d->spare);
    }
    return 1;
}

/* Divide a channel's weights by what its residuals say of the assumed variances. */
static void scale_noise(const patch *cut, int c, dense_rows *d, dense_sums *s)
{
    int count = 0, kept = 0;
    double chi2 = 0.0;
    for (int i = 0; i < cut->n; i++) {
        const int inside = d->weight[c][i] > 0.0f, counts = inside && d->judged[c][i] > 0.0f;
        count += inside;
        kept += counts;
        /* The variance is the weight over the weight divided by it. */
        chi2 += counts ? (double)d->residual[c][i] * d->residual[c][i] * d->w[c][i] / d->weight[c][i] : 0.0;
    }
    const int free = count - s->total - 3;
    s->spent[c] = (double)count / (free > 1 ? free : 1);
    const double scale = kept ? fmax(chi2 / kept * s->spent[c], LEAST_NOISE) : 1.0;
    for (int i = 0; i < cut->n; i++) {
        d->w[c][i] *= (float)(1.0 / scale);
    }
    for (int i = 0; i < COEFFICIENTS_MAX * COEFFICIENTS_MAX; i++) {
        s->M[c][i] /= scale;
    }
}

/* Add a channel's information and gradient, with its paints eliminated. */
static int add_channel(const patch *cut, int c, float m_per_px2, dense_rows *d, dense_sums *s, dense_fit *fit)
{
    double *C = s->C[c], *answer = s->answer[c];
    memset(C, 0, sizeof s->C[c]);
    for (int start = 0; start < cut->n; start += SUM_BLOCK) {
        const int length = whole_lanes(cut->n - start < SUM_BLOCK ? cut->n - start : SUM_BLOCK);
        float J[STATES][SUM_BLOCK], Jw[STATES][SUM_BLOCK];
        dense_derivatives(d, s, c, start, length, m_per_px2, J, Jw);
        const float *left[STATES], *right[STATES], *values[COEFFICIENTS_MAX], *const residual[1] = {d->residual[c] + start};
        for (int r = 0; r < STATES; r++) {
            left[r] = Jw[r], right[r] = J[r];
        }
        for (int k = 0; k < s->total; k++) {
            values[k] = d->values[k] + start;
        }
        add_squares(length, STATES, left, right, STATES, fit->H);
        add_products(length, STATES, left, s->total, values, COEFFICIENTS_MAX, C);
        add_products(length, STATES, left, 1, residual, 1, fit->g);
    }
    for (int k = 0; k < s->total; k++) {
        for (int r = 0; r < STATES; r++) {
            answer[k * STATES + r] = C[r * COEFFICIENTS_MAX + k];
        }
    }
    if (!solve_symmetric(s->total, COEFFICIENTS_MAX, s->M[c], STATES, answer)) {
        return 0;
    }
    for (int i = 0; i < STATES; i++) {
        for (int j = i; j < STATES; j++) {
            for (int k = 0; k < s->total; k++) {
                fit->H[i * STATES + j] -= C[i * COEFFICIENTS_MAX + k] * answer[k * STATES + j];
            }
        }
    }
    return 1;
}

WIDE
static void fill(const patch *cut, int c, const dense_sums *s, const dense_rows *d, dense_fit *fit)
{
    float *restrict added = d->added[c];
    memset(added, 0, (size_t)whole_lanes(cut->n) * sizeof *added);
    for (int k = s->k; k < s->total; k++) {
        const float part = (float)s->a[c][k], *restrict value = d->values[k];
        for (int i = 0; i < whole_lanes(cut->n); i++) {
            added[i] += part * value[i];
        }
    }
    for (int k = 0; k < s->k; k++) {
        fit->paints[k][c] = s->a[c][k];
    }
}

/* Fit the paints with full weights, and again with robust ones; the first linearisation does not weigh. */
static int fit_robustly(const patch *cut, int first, int reflection, dense_rows *d, dense_sums *s)
{
    for (int c = 0; c < CHANNELS; c++) {
        if (!fit_paints(cut, c, d, s)) {
            return 0;
        }
        if (!first) {
            set_robust_weights(cut, c, fmax(typical(cut, c, 1, d->judged[c], d), LEAST_NOISE), reflection, d);
            if (!fit_paints(cut, c, d, s)) {
                return 0;
            }
        }
    }
    return 1;
}

/* Take a reflection into the fit: its light and derivatives are further regressors, and clipped pixels weigh nothing. */
static void admit_glare(const patch *cut, const glare *g, dense_rows *d, dense_sums *s)
{
    s->total = s->k + GLARE_COLUMNS;
    glare_columns(g, &d->f, d->values + s->k);
    for (int c = 0; c < CHANNELS; c++) {
        for (int i = 0; i < cut->n; i++) {
            d->w[c][i] = cut->light[c][i] < CLIPPED ? d->w[c][i] : 0.0f;
        }
    }
}

int linearise_dense(const dl_pad_shape *pad, const patch *cut, const fit_state *s, int first, int last, dense_rows *d, dense_fit *fit)
{
    dense_sums all = {.regions = (int)pad->contrast_count, .k = FIRST_REGION + (int)pad->contrast_count};
    const float m_per_px2 = (float)(s->m_per_px * s->m_per_px);
    glare reflection = first ? (glare){0.0, 0.0, 0.0} : fit->reflection;
    double left = 0.0, on_pad = 0.0, amplitudes[GLARE_COLUMNS] = {0.0};
    all.total = all.k;
    draw(pad, cut, s, d);
    set_weights(cut, fit->noise, first, d);
    const float *const light[CHANNELS] = {first ? cut->light[0] : d->model[0], first ? cut->light[1] : d->model[1],
                                          first ? cut->light[2] : d->model[2]};
    judge(cut, light, all.k, reflection.radius > 0.0, d);
    if (first && !find_glare(pad, cut, d, &all, &reflection)) {
        return 0;
    }
    if (reflection.radius > 0.0) {
        judge(cut, light, all.k, 1, d);
        admit_glare(cut, &reflection, d, &all);
    }
    memset(fit, 0, sizeof *fit);
    if (!fit_robustly(cut, first, reflection.radius > 0.0, d, &all)) {
        return 0;
    }
    for (int c = 0; c < CHANNELS; c++) {
        scale_noise(cut, c, d, &all);
        if (!add_channel(cut, c, m_per_px2, d, &all, fit)) {
            return 0;
        }
        left += typical(cut, c, 0, d->judged[c], d) / CHANNELS;
        on_pad += last ? typical_on_pad(pad, cut, c, d) / CHANNELS : 0.0;
        fill(cut, c, &all, d, fit);
        for (int k = all.k; k < all.total; k++) {
            amplitudes[k - all.k] += all.a[c][k];
        }
    }
    mirror(STATES, STATES, fit->H);
    if (last && !add_gradient_covariance(pad, cut, m_per_px2, d, &all, fit)) {
        return 0;
    }
    mirror(STATES, STATES, fit->gradient_cov);
    fit->noise = fmax(left, LEAST_NOISE), fit->noise_on_pad = on_pad;
    fit->reflection = reflection.radius > 0.0 ? glare_moved(&reflection, amplitudes, pad->disc_radius_m) : reflection;
    return 1;
}
