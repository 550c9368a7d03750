#include <math.h>
#include <string.h>

#include "align.h"
#include "wide.h"

/* An occluder that covers a half of the disc and has its own light biases every paint, and then nothing fits. The other half alone
 * gives the pad's paints, and the occluder shows as residuals against them. */
enum { SECTORS = 8, ENOUGH = 650, NUMBERS = 8, LEAST = 30 };
/* A half is trusted first if its unexplained fraction of the light's variation is below this multiple of the whole's. */
static const double MUCH = 0.4;
static const double RIDGE = 1e-4;
static const float COVERED = 1e-3f;

/* Sums of products of a sample's numbers: coverage (4), light (3) and one. */
typedef float8 sums[NUMBERS];

int align_sector(float x, float y)
{
    const int above = y > 0.0f || (y == 0.0f && x >= 0.0f);
    const float p = above ? x : -x, q = above ? y : -y;
    const int octant = p > 0.0f ? q >= p : q > -p || q == 0.0f ? 2 : 3;
    return (above ? 4 : 0) + octant;
}

WIDE
static void sum_products(const samples *s, int every, sums of[SECTORS])
{
    for (int i = 0; i < s->n; i += every) {
        const float8 number = {s->coverage[0][i], s->coverage[1][i], s->coverage[2][i], s->coverage[3][i],
                               s->light[0][i],    s->light[1][i],    s->light[2][i],    1.0f};
        float8 *to = of[align_sector(s->x[i], s->y[i])];
        for (int k = 0; k < NUMBERS; k++) {
            to[k] += number[k] * number;
        }
    }
}

/* The fraction of the light's variation that least-squares paints leave; 1 if there are few samples. */
static double unexplained(sums of)
{
    double A[16], b[12], squares = 0.0, left, total;
    const double n = (double)of[7][7];
    if (!(n > LEAST)) {
        return 1.0;
    }
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) {
            A[4 * i + j] = (double)of[i][j] + (i == j ? RIDGE * n : 0.0);
        }
        for (int c = 0; c < 3; c++) {
            b[3 * i + c] = (double)of[i][4 + c];
        }
    }
    if (!align_solve(4, 3, A, b)) {
        return 1.0;
    }
    for (int c = 0; c < 3; c++) {
        squares += (double)of[4 + c][4 + c];
    }
    left = total = squares;
    for (int c = 0; c < 3; c++) {
        for (int k = 0; k < 4; k++) {
            left -= (double)of[k][4 + c] * b[3 * k + c];
        }
        total -= (double)of[7][4 + c] * (double)of[7][4 + c] / n;
    }
    return fmax(left, 1e-9) / fmax(total, 1e-6);
}

void align_uncovered(samples *s)
{
    sums of[SECTORS], half;
    double least = INFINITY;
    int best = 0;
    const int every = s->n / ENOUGH > 1 ? s->n / ENOUGH : 1;
    memset(of, 0, sizeof of);
    sum_products(s, every, of);
    /* Halves from each sector on, and last the whole. */
    for (int k = 0; k <= SECTORS; k++) {
        memset(half, 0, sizeof half);
        for (int j = 0; j < (k < SECTORS ? SECTORS / 2 : SECTORS); j++) {
            for (int i = 0; i < NUMBERS; i++) {
                half[i] += of[(k + j) % SECTORS][i];
            }
        }
        const double here = unexplained(half);
        if (k < SECTORS && here < least) {
            least = here;
            best = k;
        } else if (k == SECTORS && !(least < MUCH * here)) {
            best = -1;
        }
    }
    for (int i = 0; i < s->n; i++) {
        const int sector = align_sector(s->x[i], s->y[i]);
        s->weight[i] = best < 0 || (sector - best + SECTORS) % SECTORS < SECTORS / 2 ? 1.0f : COVERED;
    }
}
