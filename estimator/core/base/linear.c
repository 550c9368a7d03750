/* Small systems of symmetric equations, by Cholesky's triangles, and by elimination where a matrix has none.
 *
 * Source: Golub, Van Loan, Matrix Computations, 4th ed., 2013, sec. 3.4 and 4.2.
 */

#include <math.h>
#include <string.h>

#include "base/linear.h"
#include "base/wide.h"

int cholesky(int n, int stride, double *A)
{
    for (int j = 0; j < n; j++) {
        for (int i = j; i < n; i++) {
            double rest = A[i * stride + j];
            for (int k = 0; k < j; k++) {
                rest -= A[i * stride + k] * A[j * stride + k];
            }
            if (i == j && (!(rest > 0.0) || !isfinite(rest))) {
                return NOT_POSITIVE;
            }
            A[i * stride + j] = i == j ? sqrt(rest) : rest / A[j * stride + j];
        }
    }
    return DONE;
}

static inline void divide(int n, double by, double *row)
{
    for (int k = 0; k < n; k++) {
        row[k] /= by;
    }
}

/* B <- inv(L') B */
static inline void solve_upper(int n, int stride, const double *L, int m, int width, double *B)
{
    for (int i = n - 1; i >= 0; i--) {
        for (int k = i + 1; k < n; k++) {
            add_scaled(m, -L[k * stride + i], B + k * width, B + i * width);
        }
        divide(m, L[i * stride + i], B + i * width);
    }
}

WIDE
void solve_lower(int n, int stride, const double *L, int m, int width, double *B)
{
    for (int i = 0; i < n; i++) {
        for (int k = 0; k < i; k++) {
            add_scaled(m, -L[i * stride + k], B + k * width, B + i * width);
        }
        divide(m, L[i * stride + i], B + i * width);
    }
}

WIDE
void solve_factored(int n, int stride, const double *L, int m, int width, double *B)
{
    solve_lower(n, stride, L, m, width, B);
    solve_upper(n, stride, L, m, width, B);
}

int solve_positive(int n, double *A, int m, double *B)
{
    if (!cholesky(n, n, A)) {
        return NOT_POSITIVE;
    }
    solve_factored(n, n, A, m, m, B);
    return DONE;
}

static void swap_rows(int n, double *a, double *b)
{
    for (int k = 0; k < n; k++) {
        const double kept = a[k];
        a[k] = b[k], b[k] = kept;
    }
}

/* B <- inv(M) B by elimination with the largest pivot; M is lost. */
static int eliminate(int n, double *M, int m, double *B)
{
    for (int k = 0; k < n; k++) {
        int best = k;
        for (int i = k + 1; i < n; i++) {
            best = fabs(M[i * n + k]) > fabs(M[best * n + k]) ? i : best;
        }
        if (!(fabs(M[best * n + k]) > 0.0)) {
            return 0;
        }
        if (best != k) {
            swap_rows(n, M + k * n, M + best * n);
            swap_rows(m, B + k * m, B + best * m);
        }
        for (int i = k + 1; i < n; i++) {
            const double factor = -M[i * n + k] / M[k * n + k];
            add_scaled(n - k, factor, M + k * n + k, M + i * n + k);
            add_scaled(m, factor, B + k * m, B + i * m);
        }
    }
    for (int i = n - 1; i >= 0; i--) {
        for (int k = i + 1; k < n; k++) {
            add_scaled(m, -M[i * n + k], B + k * m, B + i * m);
        }
        divide(m, M[i * n + i], B + i * m);
    }
    return 1;
}

int solve_symmetric(int n, int stride, const double *M, int m, double *B)
{
    double A[UNKNOWNS_MAX * UNKNOWNS_MAX];
    for (int i = 0; i < n; i++) {
        memcpy(A + i * n, M + i * stride, (size_t)n * sizeof *M);
    }
    if (solve_positive(n, A, m, B)) {
        return 1;
    }
    for (int i = 0; i < n; i++) {
        memcpy(A + i * n, M + i * stride, (size_t)n * sizeof *M);
    }
    return eliminate(n, A, m, B);
}
