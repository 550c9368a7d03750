/* Differentiate the light of a distant pad by its state. */

#include <string.h>

#include "vision/register/dense.h"
#include "base/wide.h"

WIDE
void dense_derivatives(const dense_rows *d, const dense_sums *s, int c, int start, int length, float m_per_px2,
                       float J[STATES][SUM_BLOCK], float Jw[STATES][SUM_BLOCK])
{
    float change[BY][SUM_BLOCK];
    for (int b = 0; b < BY; b++) {
        memset(change[b], 0, sizeof change[b]);
        for (int k = 0; k < s->regions; k++) {
            const float *restrict from = d->changes[k][b] + start, contrast = (float)s->a[c][FIRST_REGION + k];
            for (int i = 0; i < length; i++) {
                change[b][i] += contrast * from[i];
            }
        }
    }
    const float *const by[BY] = {change[0], change[1], change[2], change[3], change[4]};
    float *const rows_of_J[STATES] = {J[0], J[1], J[2], J[3], J[4], J[5], J[6], J[7], J[8]}, *restrict steep2 = d->steep2[c] + start;
    const float *restrict w = d->w[c] + start;
    by_state(&d->f, by, start, length, rows_of_J);
    for (int i = 0; i < length; i++) {
        steep2[i] = (change[0][i] * change[0][i] + change[1][i] * change[1][i]) * m_per_px2;
    }
    for (int r = 0; r < STATES; r++) {
        for (int i = 0; i < length; i++) {
            Jw[r][i] = J[r][i] * w[i];
        }
    }
}
