/* Keep the half of the disc that nothing covers. */

#include <math.h>
#include <string.h>

#include "vision/align/align.h"
#include "base/wide.h"

/* An occluder that covers a half of the disc and has its own light biases every paint, and then nothing fits. The other half alone
 * gives the pad's paints, and the occluder shows as residuals against them. */
enum { SECTORS = 8, ENOUGH = 650, LEAST = 30 };
/* A half is trusted first if its unexplained fraction of the light's variation is below this multiple of the whole's. */
static const double MUCH = 0.4;
static const float NEXT_TO_NOTHING = 1e-3f; /* Weight of samples on the side that is covered. */

int align_sector(float x, float y)
{
    const int above = y > 0.0f || (y == 0.0f && x >= 0.0f);
    const float p = above ? x : -x, q = above ? y : -y;
    const int octant = p > 0.0f ? q >= p : q > -p || q == 0.0f ? 2 : 3;
    return (above ? 4 : 0) + octant;
}

WIDE
static void sum_products(const samples *s, int every, fit_sums of[SECTORS])
{
    for (int i = 0; i < s->n; i += every) {
        align_add(s, i, of[align_sector(s->x[i], s->y[i])]);
    }
}

/* The fraction of the light's variation that least-squares paints leave; 1 if there are few samples. */
static double unexplained(const fit_sums of)
{
    return align_number(of) > LEAST ? fmax(align_unexplained(of), 1e-9) / fmax(align_varied(of), 1e-6) : 1.0;
}

void align_uncovered(samples *s)
{
    fit_sums of[SECTORS], half;
    double least = INFINITY;
    int best = 0;
    const int every = s->n / ENOUGH > 1 ? s->n / ENOUGH : 1;
    memset(of, 0, sizeof of);
    sum_products(s, every, of);
    /* For k < SECTORS the half of the disc that begins at sector k; for k == SECTORS the whole disc. */
    for (int k = 0; k <= SECTORS; k++) {
        memset(half, 0, sizeof half);
        for (int j = 0; j < (k < SECTORS ? SECTORS / 2 : SECTORS); j++) {
            for (int i = 0; i < SUM_ROWS; i++) {
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
        s->weight[i] = best < 0 || (sector - best + SECTORS) % SECTORS < SECTORS / 2 ? 1.0f : NEXT_TO_NOTHING;
    }
}
