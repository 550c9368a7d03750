#include <math.h>
#include <string.h>

#include "align.h"

enum { LIGHT = 4, ONE = 7 };
/* Ridge of a fit, per sample: a paint may cover none of them. */
static const double RIDGE = 1e-4;

void align_total(int n, fit_sums *of, fit_sums out)
{
    memset(out, 0, sizeof(fit_sums));
    for (int k = 0; k < n; k++) {
        for (int i = 0; i < FIT_NUMBERS; i++) {
            out[i] += of[k][i];
        }
    }
}

double align_number(const fit_sums of)
{
    return (double)of[ONE][ONE];
}

double align_varied(const fit_sums of)
{
    double out = 0.0;
    for (int c = LIGHT; c < ONE; c++) {
        out += (double)of[c][c] - (double)of[ONE][c] * (double)of[ONE][c] / fmax(align_number(of), 1.0);
    }
    return fmax(out, 0.0);
}

double align_unexplained(const fit_sums of)
{
    double A[16], b[12], left = 0.0;
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) {
            A[4 * i + j] = (double)of[i][j] + (i == j ? RIDGE * align_number(of) : 0.0);
        }
        for (int c = 0; c < 3; c++) {
            b[3 * i + c] = (double)of[i][LIGHT + c];
        }
    }
    if (!align_solve(4, 3, A, b)) {
        return align_varied(of);
    }
    for (int c = 0; c < 3; c++) {
        left += (double)of[LIGHT + c][LIGHT + c];
        for (int k = 0; k < 4; k++) {
            left -= (double)of[k][LIGHT + c] * b[3 * k + c];
        }
    }
    return fmax(left, 0.0);
}
