/* Compute the sandwich covariance of a dense fit whose residuals are correlated. */

#include <math.h>
#include <string.h>

#include "vision/register/dense.h"
#include "base/wide.h"

static const double SEEN_PIXELS = 4.0; /* Pixels of a paint below which it takes the mean variance of the light. */
static const double LEAST_VAR = 1e-10; /* Least variance of the light. */
/* The least fraction of the noise that the fit is taken to have left in the residuals. */
static const double LEFT_LEAST = 0.3;
/* The paints: surroundings, then the regions. */
enum { PAINTS_MAX = 1 + DL_PAD_CONTRASTS };
/* Smoothings, (1, 2, 1) / 4, that the grain of what is seen has at most before the patch is smoothed; as many by single pixels as make
 * one by pairs. The reach of all of them, px, and the least correlation between channels from which there is such grain. */
enum { GRAIN_MOST = 8, BY_PAIRS = 4, GRAIN_REACH = 2 * (1 + GRAIN_MOST) };
static const double GRAIN_LEAST = 0.05; /* That correlation. */

/* The fraction of a pixel that each paint covers: a region less those that lie on it. */
static void paint_fractions(const dl_pad_shape *pad, const dense_rows *d, int i, double out[PAINTS_MAX])
{
    for (int k = 0; k < PAINTS_MAX; k++) {
        out[k] = k == 0;
    }
    for (int k = 0; k < pad->contrast_count; k++) {
        const double covered = fmin(fmax(d->values[FIRST_REGION + k][i], 0.0f), 1.0f);
        out[1 + k] += covered;
        out[1 + pad->lies_on[k]] -= covered;
    }
    for (int k = 0; k < PAINTS_MAX; k++) {
        out[k] = fmax(out[k], 0.0);
    }
}

/* The mean over a pixel's paints, where paints with too few pixels have the mean of all. */
static double mean_of_paints(const double fractions[PAINTS_MAX], const double by_paint[PAINTS_MAX])
{
    double sum = 0.0;
    for (int k = 0; k < PAINTS_MAX; k++) {
        sum += by_paint[k] * fractions[k];
    }
    return sum;
}

/* Divide sums by the pixels of their paints. */
static void by_paint_of(const double total[PAINTS_MAX], const double sums[PAINTS_MAX], double out[PAINTS_MAX])
{
    double all = 0.0, pixels = 0.0;
    for (int k = 0; k < PAINTS_MAX; k++) {
        all += sums[k], pixels += total[k];
    }
    for (int k = 0; k < PAINTS_MAX; k++) {
        out[k] = total[k] > SEEN_PIXELS ? sums[k] / total[k] : all / fmax(1.0, pixels);
    }
}

/* The variance of each channel's light from its residuals: each paint has its own, and a pixel the mean over its paints. */
static void noise_of_paints(const dl_pad_shape *pad, const patch *cut, const dense_sums *s, const dense_rows *d, float *const seen[CHANNELS])
{
    double total[CHANNELS][PAINTS_MAX] = {{0.0}}, squares[CHANNELS][PAINTS_MAX] = {{0.0}}, var[CHANNELS][PAINTS_MAX], fractions[PAINTS_MAX];
    for (int i = 0; i < cut->n; i++) {
        paint_fractions(pad, d, i, fractions);
        for (int c = 0; c < CHANNELS; c++) {
            const double square = (double)d->residual[c][i] * d->residual[c][i] * s->spent[c];
            for (int k = 0; k < PAINTS_MAX && d->weight[c][i] > 0.0f; k++) {
                total[c][k] += fractions[k], squares[c][k] += fractions[k] * square;
            }
        }
    }
    for (int c = 0; c < CHANNELS; c++) {
        by_paint_of(total[c], squares[c], var[c]);
    }
    for (int i = 0; i < cut->n; i++) {
        paint_fractions(pad, d, i, fractions);
        for (int c = 0; c < CHANNELS; c++) {
            seen[c][i] = (float)fmax(mean_of_paints(fractions, var[c]), LEAST_VAR);
        }
    }
}

/* The correlation of the channels' residuals, 0 to 1, of each pixel the mean over its paints: noise of a sensor is of each channel
 * alone, what lies on a paint or beside the pad darkens all of them. */
static void correlation_of_channels(const dl_pad_shape *pad, const patch *cut, const dense_rows *d, float *const seen[CHANNELS],
                                    float *shared)
{
    double total[PAINTS_MAX] = {0.0}, products[PAINTS_MAX] = {0.0}, correlation[PAINTS_MAX], fractions[PAINTS_MAX];
    for (int i = 0; i < cut->n; i++) {
        double sum = 0.0, squares = 0.0;
        int counts = 1;
        for (int c = 0; c < CHANNELS; c++) {
            const double u = d->residual[c][i] / sqrt(seen[c][i]);
            counts &= d->weight[c][i] > 0.0f;
            sum += u, squares += u * u;
        }
        paint_fractions(pad, d, i, fractions);
        for (int k = 0; k < PAINTS_MAX && counts; k++) {
            total[k] += fractions[k], products[k] += fractions[k] * (sum * sum - squares) / (CHANNELS * (CHANNELS - 1));
        }
    }
    by_paint_of(total, products, correlation);
    for (int i = 0; i < cut->n; i++) {
        paint_fractions(pad, d, i, fractions);
        shared[i] = (float)fmin(fmax(mean_of_paints(fractions, correlation), 0.0), 1.0);
    }
}

/* The weighted derivatives less what the paints answer, by state, into `projected`; adds the sectors'. */
WIDE
static void project_scores(const patch *cut, int c, float m_per_px2, const dense_rows *d, const dense_sums *s,
                           float *const projected[STATES], dense_fit *fit)
{
    for (int start = 0; start < cut->n; start += SUM_BLOCK) {
        const int length = whole_lanes(cut->n - start < SUM_BLOCK ? cut->n - start : SUM_BLOCK);
        float J[STATES][SUM_BLOCK], Jw[STATES][SUM_BLOCK];
        const float *restrict w = d->w[c] + start;
        dense_derivatives(d, s, c, start, length, m_per_px2, J, Jw);
        for (int r = 0; r < STATES; r++) {
            float *restrict out = projected[r] + start, answered[SUM_BLOCK] = {0.0f};
            for (int k = 0; k < s->total; k++) {
                const float part = (float)s->answer[c][k * STATES + r], *restrict value = d->values[k] + start;
                for (int i = 0; i < length; i++) {
                    answered[i] += part * value[i];
                }
            }
            for (int i = 0; i < length; i++) {
                out[i] = Jw[r][i] - answered[i] * w[i];
            }
        }
        const int within = cut->n - start < SUM_BLOCK ? cut->n - start : SUM_BLOCK;
        add_sectors(d, c, start, within, (const float (*)[SUM_BLOCK])J, projected, sqrtf(m_per_px2), fit);
    }
}

/* Write a row's values to their places in the grid, which has two lines of zeros more on either side than the patch; return the place
 * of the patch's first pixel. */
static inline float *laid_out(const patch *cut, const float *row, float *grid)
{
    const int columns = cut->columns;
    float *inside = grid + 2 * (columns + 1);
    memset(grid, 0, (size_t)(columns * (cut->lines + 4) + 4) * sizeof *grid);
    for (int i = 0; i < cut->n; i++) {
        inside[cut->at[i]] = row[i];
    }
    return inside;
}

/* Smoothing shares noise between neighbours `step` apart; its transpose, which is itself, maps the sums back to pixels. */
WIDE
static void share_back(const patch *cut, int step, float *restrict grid, float *restrict row)
{
    const int columns = cut->columns;
    const float *inside = laid_out(cut, row, grid);
    for (int i = 0; i < cut->n; i++) {
        const float *at = inside + cut->at[i], *above = at - step * columns, *below = at + step * columns;
        row[i] = 0.0625f * ((above[-step] + above[step]) + (below[-step] + below[step]) +
                            2.0f * ((above[0] + below[0]) + (at[-step] + at[step])) + 4.0f * at[0]);
    }
}

/* Add the products of a row's values one and two pixels apart, along both axes, to their sums. */
static void add_lags(const patch *cut, double sign, float *grid, const float *row, double sums[2])
{
    const int columns = cut->columns;
    const float *inside = laid_out(cut, row, grid);
    for (int i = 0; i < cut->n; i++) {
        const float *at = inside + cut->at[i];
        sums[0] += sign * at[0] * (at[1] + at[columns]);
        sums[1] += sign * at[0] * (at[2] + at[2 * columns]);
    }
}

/* How often what all channels see has been smoothed before the patch is, as its correlation over one and two pixels says: a sensor's
 * noise never, what lies on paints by their grain and by the lens. Of n smoothings in all, (1, 2, 1) / 4, the ratio of both is
 * (2n - 1) / (2n + 2). */
static int grain_of(const patch *cut, float *const seen[CHANNELS], const dense_rows *d, const float *shared, float *grid, float *row,
                    float *all)
{
    double sums[2] = {0.0, 0.0}, correlation = 0.0;
    memset(all, 0, (size_t)cut->n * sizeof *all);
    for (int c = 0; c < CHANNELS; c++) {
        for (int i = 0; i < cut->n; i++) {
            row[i] = d->weight[c][i] > 0.0f ? d->residual[c][i] / sqrtf(seen[c][i]) : 0.0f;
            all[i] += row[i];
        }
        add_lags(cut, -1.0, grid, row, sums);
    }
    add_lags(cut, 1.0, grid, all, sums);
    for (int i = 0; i < cut->n; i++) {
        correlation += shared[i];
    }
    if (correlation < GRAIN_LEAST * cut->n || sums[0] <= 0.0) {
        return 0;
    }
    const double ratio = fmin(sums[1] / sums[0], 0.95), smoothings = (2.0 * ratio + 1.0) / (2.0 * (1.0 - ratio)) - 1.0;
    return (int)fmin(fmax(smoothings + 0.5, 0.0), GRAIN_MOST);
}

/* The variance that smoothing by single pixels, once for the patch and `times` before, leaves of independent values. */
static double variance_left(int times)
{
    double kernel[GRAIN_REACH + 1] = {1.0}, sum = 0.0;
    for (int n = 0; n < 2 * (1 + times); n++) {
        for (int i = n + 1; i > 0; i--) {
            kernel[i] = 0.5 * (kernel[i] + kernel[i - 1]);
        }
        kernel[0] *= 0.5;
    }
    for (int i = 0; i <= 2 * (1 + times); i++) {
        sum += kernel[i] * kernel[i];
    }
    return sum * sum;
}

/* Add the covariance that what all channels see has on the gradient, from scores times its deviation. */
static void add_grain(const patch *cut, int times, float *grid, float *const common[STATES], dense_fit *fit)
{
    const int n = whole_lanes(cut->n);
    const float per = (float)sqrt(1.0 / variance_left(times));
    const float *both[STATES];
    for (int r = 0; r < STATES; r++) {
        for (int k = 0; k < times / BY_PAIRS + times % BY_PAIRS; k++) {
            share_back(cut, k < times / BY_PAIRS ? 2 : 1, grid, common[r]);
        }
        for (int i = 0; i < n; i++) {
            common[r][i] = i < cut->n ? per * common[r][i] : 0.0f;
        }
        both[r] = common[r];
    }
    add_squares(cut->n, STATES, both, both, STATES, fit->gradient_cov);
}

/* The variances of a channel's paints. */
static int vary_paints(int c, const dense_sums *s, dense_fit *fit)
{
    double var[COEFFICIENTS_MAX * COEFFICIENTS_MAX];
    for (int i = 0; i < s->total * s->total; i++) {
        var[i] = i % (s->total + 1) == 0;
    }
    if (!solve_symmetric(s->total, COEFFICIENTS_MAX, s->M[c], s->total, var)) {
        return 0;
    }
    for (int k = 0; k < s->k; k++) {
        fit->var_paints[k][c] = var[k * (s->total + 1)];
    }
    return 1;
}

/* Put back what the fit has taken out of its own residuals. Paints and pose follow what is coarse in the noise, which smoothing
 * leaves more of: each takes as much more than a share of the mean as the gradient has more variance than
 * independent pixels would give it. */
static void restore_spent(const patch *cut, const dense_sums *s, dense_fit *fit)
{
    const double n = cut->n, taken = s->total + STATES / CHANNELS;
    double ratio = 0.0;
    for (int r = 0; r < STATES; r++) {
        ratio += fit->gradient_cov[r * (STATES + 1)] / fmax(fit->H[r * (STATES + 1)], 1e-300) / STATES;
    }
    const double left = fmax(n - fmax(ratio, 1.0) * taken, LEFT_LEAST * n), assumed = fmax(n - taken, LEFT_LEAST * n);
    for (int i = 0; i < STATES * STATES; i++) {
        fit->gradient_cov[i] *= assumed / left;
    }
}

int add_gradient_covariance(const dl_pad_shape *pad, const patch *cut, float m_per_px2, dense_rows *d, const dense_sums *s, dense_fit *fit)
{
    float *const *projected = d->spare, *const *noisy = d->spare + STATES, *const *common = d->spare + 2 * STATES;
    float *const *seen = d->spare + 3 * STATES, *shared = d->spare[3 * STATES + CHANNELS], *grid = d->spare[3 * STATES + CHANNELS + 1];
    const float *left[STATES], *right[STATES];
    const int n = whole_lanes(cut->n);
    /* The weights have a fixed shape, so that a wrong start cannot adapt them to itself; the covariance uses the actual noise. */
    noise_of_paints(pad, cut, s, d, seen);
    correlation_of_channels(pad, cut, d, seen, shared);
    for (int r = 0; r < STATES; r++) {
        memset(common[r], 0, (size_t)n * sizeof *common[r]);
        left[r] = noisy[r], right[r] = projected[r];
    }
    const int times = grain_of(cut, seen, d, shared, grid, projected[0], projected[1]);
    for (int c = 0; c < CHANNELS; c++) {
        if (!vary_paints(c, s, fit)) {
            return 0;
        }
        project_scores(cut, c, m_per_px2, d, s, projected, fit);
        for (int r = 0; r < STATES; r++) {
            share_back(cut, 1, grid, projected[r]);
            for (int i = 0; i < n; i++) {
                const float var = i < cut->n ? seen[c][i] : 0.0f, one = i < cut->n ? shared[i] : 0.0f;
                projected[r][i] = i < cut->n ? projected[r][i] : 0.0f;
                noisy[r][i] = projected[r][i] * var * (1.0f - one) / (float)NOISE_LEFT;
                common[r][i] += projected[r][i] * sqrtf(var * one);
            }
        }
        add_squares(cut->n, STATES, left, right, STATES, fit->gradient_cov);
    }
    add_grain(cut, times, grid, common, fit);
    restore_spent(cut, s, fit);
    return 1;
}
