/* Sum products of coverage and light, and solve for the variation that paints leave. */

#include <math.h>
#include <string.h>

#include "vision/align/align.h"
#include "base/linear.h"

enum { LIGHT = 4, ONE = 7 };

void align_total(int n, fit_sums *of, fit_sums out)
{
    memset(out, 0, sizeof(fit_sums));
    for (int k = 0; k < n; k++) {
        for (int i = 0; i < SUM_ROWS; i++) {
            out[i] += of[k][i];
        }
    }
}

double align_number(const fit_sums of)
{
    return (double)of[SUM_ONCE][ONE];
}

double align_varied(const fit_sums of)
{
    double out = 0.0;
    for (int c = LIGHT; c < ONE; c++) {
        out += (double)of[SUM_SQUARED][c] - (double)of[SUM_ONCE][c] * (double)of[SUM_ONCE][c] / fmax(align_number(of), 1.0);
    }
    return fmax(out, 0.0);
}

double align_unexplained(const fit_sums of)
{
    double A[4][4], b[4][3], left = 0.0;
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) {
            A[i][j] = (double)of[i][j] + (i == j ? RIDGE * align_number(of) : 0.0);
        }
        for (int c = 0; c < 3; c++) {
            b[i][c] = (double)of[i][LIGHT + c];
        }
    }
    if (!solve_positive(4, *A, 3, *b)) {
        return align_varied(of);
    }
    for (int c = 0; c < 3; c++) {
        left += (double)of[SUM_SQUARED][LIGHT + c];
        for (int k = 0; k < 4; k++) {
            left -= (double)of[k][LIGHT + c] * b[k][c];
        }
    }
    return fmax(left, 0.0);
}
