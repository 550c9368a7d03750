/* Solve for the paints' light with weights that leave out what does not fit. */

#include <math.h>
#include <string.h>

#include "vision/align/align.h"
#include "vision/register/sums.h"
#include "base/linear.h"
#include "base/vectors.h"
#include "base/wide.h"

/* Residual, as a fraction of full scale, that the model leaves even where it is right (wear, noise, ripples). */
static const double MODEL_NOISE = 0.02;
static const double SOUND = 0.25; /* Fraction of the samples that are certainly neither occluded nor overexposed. */
static const double SPREAD = 2.0; /* Factor from their largest residual to a usual one while the pose moves. */
static const double SPREAD_SHARP = 1.6; /* The same at the final pose, where a sample that still does not fit shows something else. */
/* Deviations of the noise's sum below which nothing is left to explain. */
static const double CHANCE_SIGMAS = 4.0;
/* Products of four coverages with each other and with three channels of light. */
enum { PRODUCTS = 22 };

double align_sum(const float8 *lanes)
{
    double sum = 0.0;
    for (int l = 0; l < SAMPLE_LANES; l++) {
        sum += (double)(*lanes)[l];
    }
    return sum;
}

/* Weighted products of the coverages with each other, i <= j, then with each channel. */
WIDE
static void products(const samples *s, double out[PRODUCTS])
{
    float8 sums[PRODUCTS];
    memset(sums, 0, sizeof sums);
    for (int at = 0; at < s->room; at += SAMPLE_LANES) {
        float8 coverage[4], light[3];
        for (int i = 0; i < 4; i++) {
            coverage[i] = *eight(s->coverage[i] + at);
        }
        for (int c = 0; c < 3; c++) {
            light[c] = *eight(s->light[c] + at);
        }
        const float8 weight = *eight(s->weight + at);
        float8 *sum = sums, *lit = sums + 10;
        for (int i = 0; i < 4; i++) {
            const float8 weighted = coverage[i] * weight;
            for (int j = i; j < 4; j++) {
                *sum++ += weighted * coverage[j];
            }
            for (int c = 0; c < 3; c++) {
                *lit++ += weighted * light[c];
            }
        }
    }
    for (int row = 0; row < PRODUCTS; row++) {
        out[row] = align_sum(&sums[row]);
    }
}

static int paints_of(const samples *s, float paints[4][3])
{
    double sums[PRODUCTS], A[16], B[12];
    products(s, sums);
    int row = 0;
    for (int i = 0; i < 4; i++) {
        for (int j = i; j < 4; j++, row++) {
            A[4 * i + j] = A[4 * j + i] = sums[row] + (i == j ? RIDGE * s->n : 0.0);
        }
    }
    memcpy(B, sums + row, sizeof B);
    if (!solve_positive(4, A, 3, B)) {
        return 0;
    }
    for (int i = 0; i < 12; i++) {
        paints[i / 3][i % 3] = (float)B[i];
    }
    return 1;
}

WIDE
static void residuals(const float paints[4][3], samples *s)
{
    for (int at = 0; at < s->room; at += SAMPLE_LANES) {
        const float8 h = *eight(s->coverage[0] + at), orange = *eight(s->coverage[1] + at);
        const float8 disc = *eight(s->coverage[2] + at), around = *eight(s->coverage[3] + at);
        float8 squared = {0.0f};
        for (int c = 0; c < 3; c++) {
            const float8 light = paints[0][c] * h + paints[1][c] * orange + paints[2][c] * disc + paints[3][c] * around;
            const float8 left = *eight(s->light[c] + at) - light;
            *eight(s->residual[c] + at) = left;
            squared += left * left;
        }
        *eight(s->squared + at) = squared;
    }
}

/* Cauchy's weights; Geman and McClure's at the final pose, which drop outliers completely. */
WIDE
static void set_robust_weights(double spread, int final, samples *s)
{
    const float by = (float)(0.25 / (spread * spread));
    for (int at = 0; at < s->room; at += SAMPLE_LANES) {
        float8 weight = 1.0f / (1.0f + by * *eight(s->squared + at));
        if (final) {
            weight *= weight;
        }
        *eight(s->weight + at) = weight;
    }
    for (int i = s->n; i < s->room; i++) {
        s->weight[i] = 0.0f;
    }
}

WIDE
static double largest_light(const samples *s)
{
    float most = 0.0f;
    for (int at = 0; at < s->room; at += SAMPLE_LANES) {
        float8 sum = {0.0f};
        for (int c = 0; c < 3; c++) {
            sum += *eight(s->light[c] + at) * *eight(s->light[c] + at);
        }
        for (int l = 0; l < SAMPLE_LANES; l++) {
            most = sum[l] > most ? sum[l] : most;
        }
    }
    return (double)most;
}

int align_paint(samples *s, int final, painted *out)
{
    const double least = fmax(1e-4, MODEL_NOISE * sqrt(largest_light(s)));
    for (int i = s->n; i < s->room; i++) {
        s->weight[i] = 0.0f;
    }
    for (int i = final ? 4 : 2; i > 0; i--) {
        if (!paints_of(s, out->paints)) {
            return 0;
        }
        residuals(out->paints, s);
        const double sound = sqrt((double)order_statistic((int)(SOUND * s->n), s->n, s->squared, s->spare));
        out->spread = fmax(least, (final ? SPREAD_SHARP : SPREAD) * sound);
        set_robust_weights(out->spread, final, s);
    }
    return 1;
}

WIDE
double align_explained(const samples *s, double noise_var)
{
    float8 weight = {0.0f}, left = {0.0f}, mean[3], square[3];
    memset(mean, 0, sizeof mean), memset(square, 0, sizeof square);
    for (int at = 0; at < s->room; at += SAMPLE_LANES) {
        const float8 w = *eight(s->weight + at);
        weight += w;
        left += w * *eight(s->squared + at);
        for (int c = 0; c < 3; c++) {
            const float8 light = *eight(s->light[c] + at);
            mean[c] += w * light;
            square[c] += w * light * light;
        }
    }
    double total = 0.0;
    for (int c = 0; c < 3; c++) {
        const double sum = align_sum(&mean[c]);
        total += align_sum(&square[c]) - sum * sum / align_sum(&weight);
    }
    const double count = 3.0 * align_sum(&weight), by_chance = CHANCE_SIGMAS * noise_var * sqrt(2.0 * count);
    return (total - align_sum(&left)) / fmax(fmax(total - noise_var * count, by_chance), 1e-12);
}
