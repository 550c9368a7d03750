#include <math.h>
#include <string.h>

#include "register_dense.h"
#include "wide.h"

/* Pixels of a paint below which it takes the mean variance of the light, and the least variance. */
static const double SEEN_PIXELS = 4.0, LEAST_VAR = 1e-10;
/* The paints: surroundings, then the regions. */
enum { PAINTS_MAX = 1 + PAD_CONTRASTS };

/* The fraction of a pixel that each paint covers: a region less those that lie on it. */
static void paint_fractions(const pad_shape *pad, const dense_rows *d, int i, double out[PAINTS_MAX])
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

/* The variance of a channel's light from its residuals: each paint has its own, and a pixel the mean over its paints. */
static void noise_of_paints(const pad_shape *pad, const patch *cut, int c, double grow, const dense_rows *d, float *seen)
{
    double total[PAINTS_MAX] = {0.0}, squares[PAINTS_MAX] = {0.0}, var[PAINTS_MAX], all = 0.0, inside = 0.0, fractions[PAINTS_MAX];
    for (int i = 0; i < cut->n; i++) {
        if (!(d->weight[c][i] > 0.0f)) {
            continue;
        }
        const double square = (double)d->residual[c][i] * d->residual[c][i] * grow;
        paint_fractions(pad, d, i, fractions);
        all += square, inside += 1.0;
        for (int k = 0; k < PAINTS_MAX; k++) {
            total[k] += fractions[k];
            squares[k] += fractions[k] * square;
        }
    }
    for (int k = 0; k < PAINTS_MAX; k++) {
        var[k] = total[k] > SEEN_PIXELS ? squares[k] / total[k] : all / fmax(1.0, inside);
    }
    for (int i = 0; i < cut->n; i++) {
        double sum = 0.0;
        paint_fractions(pad, d, i, fractions);
        for (int k = 0; k < PAINTS_MAX; k++) {
            sum += var[k] * fractions[k];
        }
        seen[i] = (float)(fmax(sum, LEAST_VAR) / NOISE_LEFT);
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
        add_sectors(d, c, start, within, J[0], J[1], projected, sqrtf(m_per_px2), fit);
    }
}

/* Smoothing shares noise between neighbours; its transpose, which is itself, maps the sums back to pixels. */
WIDE
static void share_back(const patch *cut, float *restrict grid, float *restrict row)
{
    const int columns = cut->columns;
    memset(grid, 0, (size_t)(columns * cut->lines) * sizeof *grid);
    for (int i = 0; i < cut->n; i++) {
        grid[cut->at[i]] = row[i];
    }
    for (int i = 0; i < cut->n; i++) {
        const float *at = grid + cut->at[i], *above = at - columns, *below = at + columns;
        row[i] = 0.0625f * ((above[-1] + above[1]) + (below[-1] + below[1]) + 2.0f * ((above[0] + below[0]) + (at[-1] + at[1])) +
                            4.0f * at[0]);
    }
}

int add_meat(const pad_shape *pad, const patch *cut, int c, float m_per_px2, dense_rows *d, const dense_sums *s, dense_fit *fit)
{
    float *const *projected = d->spare, *const *noisy = d->spare + STATES, *seen = d->spare[2 * STATES], *grid = d->spare[2 * STATES + 1];
    const float *left[STATES], *right[STATES];
    double var[COEFFICIENTS_MAX * COEFFICIENTS_MAX];
    const int n = whole_lanes(cut->n);
    for (int i = 0; i < s->total * s->total; i++) {
        var[i] = i % (s->total + 1) == 0;
    }
    if (!solve_symmetric(s->total, COEFFICIENTS_MAX, s->M[c], s->total, var)) {
        return 0;
    }
    for (int k = 0; k < s->k; k++) {
        fit->var_paints[k][c] = var[k * (s->total + 1)];
    }
    /* The weights have a fixed shape, so that a wrong start cannot adapt them to itself; the covariance uses the actual noise. */
    noise_of_paints(pad, cut, c, s->spent[c], d, seen);
    project_scores(cut, c, m_per_px2, d, s, projected, fit);
    for (int r = 0; r < STATES; r++) {
        share_back(cut, grid, projected[r]);
        for (int i = 0; i < n; i++) {
            projected[r][i] = i < cut->n ? projected[r][i] : 0.0f;
            noisy[r][i] = i < cut->n ? projected[r][i] * seen[i] : 0.0f;
        }
        left[r] = noisy[r], right[r] = projected[r];
    }
    add_squares(cut->n, STATES, left, right, STATES, fit->meat);
    return 1;
}
