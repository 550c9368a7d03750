/* Covariance propagation, and the Kalman correction in Joseph form.
 *
 * Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, eq. 5.2.3-18.
 */

#include <math.h>
#include <string.h>

#include "base/kalman.h"
#include "base/wide.h"

int cholesky(int m, double S[DL_ROWS_MAX][DL_ROWS_MAX])
{
    for (int j = 0; j < m; j++) {
        double pivot = S[j][j];
        for (int k = 0; k < j; k++) {
            pivot -= S[j][k] * S[j][k];
        }
        if (!(pivot > 0.0) || !isfinite(pivot)) {
            return NOT_POSITIVE;
        }
        S[j][j] = sqrt(pivot);
        for (int i = j + 1; i < m; i++) {
            double rest = S[i][j];
            for (int k = 0; k < j; k++) {
                rest -= S[i][k] * S[j][k];
            }
            S[i][j] = rest / S[j][j];
        }
    }
    return DONE;
}

void solve_lower(int m, double L[DL_ROWS_MAX][DL_ROWS_MAX], double b[DL_ROWS_MAX])
{
    for (int i = 0; i < m; i++) {
        for (int k = 0; k < i; k++) {
            b[i] -= L[i][k] * b[k];
        }
        b[i] /= L[i][i];
    }
}

/* row -= factor other */
static void subtract(int n, double factor, const double *restrict other, double *restrict row)
{
    for (int k = 0; k < n; k++) {
        row[k] -= factor * other[k];
    }
}

/* B <- inv(L L') B, of m rows of n numbers. */
static void solve_rows(int n, int m, double L[DL_ROWS_MAX][DL_ROWS_MAX], double B[DL_ROWS_MAX][ORDER_MAX])
{
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < i; j++) {
            subtract(n, L[i][j], B[j], B[i]);
        }
        for (int k = 0; k < n; k++) {
            B[i][k] /= L[i][i];
        }
    }
    for (int i = m - 1; i >= 0; i--) {
        for (int j = i + 1; j < m; j++) {
            subtract(n, L[j][i], B[j], B[i]);
        }
        for (int k = 0; k < n; k++) {
            B[i][k] /= L[i][i];
        }
    }
}

WIDE
void kalman_predict(int n, const double *P, const double *F, const double *Q, double *P_after)
{
    double FP[ORDER_MAX][ORDER_MAX];
    int column[ORDER_MAX][ORDER_MAX], count[ORDER_MAX];
    for (int i = 0; i < n; i++) {
        count[i] = 0;
        memset(FP[i], 0, sizeof FP[i]);
        for (int k = 0; k < n; k++) {
            const double f = F[i * n + k];
            if (f != 0.0) {
                column[i][count[i]++] = k;
                for (int j = 0; j < n; j++) {
                    FP[i][j] += f * P[k * n + j];
                }
            }
        }
    }
    /* (F P F')' = F (F P)': its rows are sums of columns of F P. */
    double columns[ORDER_MAX][ORDER_MAX];
    for (int i = 0; i < n; i++) {
        for (int k = 0; k < n; k++) {
            columns[k][i] = FP[i][k];
        }
    }
    for (int j = 0; j < n; j++) {
        double row[ORDER_MAX];
        for (int i = 0; i <= j; i++) {
            row[i] = 0.5 * (Q[i * n + j] + Q[j * n + i]);
        }
        for (int k = 0; k < count[j]; k++) {
            const double f = F[j * n + column[j][k]], *summand = columns[column[j][k]];
            for (int i = 0; i <= j; i++) {
                row[i] += summand[i] * f;
            }
        }
        for (int i = 0; i <= j; i++) {
            P_after[i * n + j] = P_after[j * n + i] = row[i];
        }
    }
}

int nis_of(int m, const double *innov, const double *S, double *nis)
{
    double L[DL_ROWS_MAX][DL_ROWS_MAX], y[DL_ROWS_MAX];
    for (int i = 0; i < m; i++) {
        y[i] = innov[i];
        for (int j = 0; j < m; j++) {
            L[i][j] = S[i * m + j];
        }
    }
    if (cholesky(m, L) == NOT_POSITIVE) {
        return NOT_POSITIVE;
    }
    solve_lower(m, L, y);
    *nis = 0.0;
    for (int i = 0; i < m; i++) {
        *nis += y[i] * y[i];
    }
    return isfinite(*nis) ? DONE : NOT_POSITIVE;
}

/* Multiplied out, Joseph's form is P - K C' + (K S - C) K' with C = P H'. The bracket vanishes except for the errors of K, which so
 * enter in the second order alone, as they do in Joseph's form. */
WIDE
int kalman_correct(int n, const double *P, const measured *z, double *dx, double *P_after, double *S, double *nis)
{
    const int m = z->m;
    const double *innov = z->innov, *H = z->H, *R = z->R;
    double y[DL_ROWS_MAX], scale[DL_ROWS_MAX], s[DL_ROWS_MAX][DL_ROWS_MAX], L[DL_ROWS_MAX][DL_ROWS_MAX];
    double C[DL_ROWS_MAX][ORDER_MAX], K[DL_ROWS_MAX][ORDER_MAX], rest[DL_ROWS_MAX][ORDER_MAX];

    /* C', row by row: most entries of a Jacobian are zero, and P is symmetric. */
    for (int i = 0; i < m; i++) {
        memset(C[i], 0, sizeof C[i]);
        for (int k = 0; k < n; k++) {
            const double h = H[i * n + k];
            if (h != 0.0) {
                for (int j = 0; j < n; j++) {
                    C[i][j] += h * P[k * n + j];
                }
            }
        }
    }
    /* Units and variances differ by many orders of magnitude: rows of unit innovation variance keep S well conditioned. */
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < m; j++) {
            double sum = R[i * m + j];
            for (int k = 0; k < n; k++) {
                sum += C[i][k] * H[j * n + k];
            }
            S[i * m + j] = sum;
        }
        const double var = S[i * m + i];
        if (!(var > 0.0) || !isfinite(var)) {
            return NOT_POSITIVE;
        }
        scale[i] = 1.0 / sqrt(var);
        y[i] = innov[i] * scale[i];
        for (int k = 0; k < n; k++) {
            C[i][k] *= scale[i];
        }
    }
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < m; j++) {
            L[i][j] = s[i][j] = S[i * m + j] * scale[i] * scale[j];
        }
    }
    if (cholesky(m, L) == NOT_POSITIVE) {
        return NOT_POSITIVE;
    }
    memcpy(K, C, (size_t)m * sizeof K[0]);
    solve_rows(n, m, L, K);
    for (int k = 0; k < n; k++) {
        dx[k] = 0.0;
        for (int i = 0; i < m; i++) {
            dx[k] += K[i][k] * y[i];
        }
    }
    double size = 0.0;
    for (int k = 0; k < n; k++) {
        size += dx[k] * dx[k];
    }
    solve_lower(m, L, y);
    *nis = 0.0;
    for (int i = 0; i < m; i++) {
        *nis += y[i] * y[i];
    }
    if (!isfinite(*nis) || !isfinite(size)) {
        return NOT_POSITIVE;
    }
    for (int i = 0; i < m; i++) {
        for (int k = 0; k < n; k++) {
            rest[i][k] = -C[i][k];
            for (int j = 0; j < m; j++) {
                rest[i][k] += s[i][j] * K[j][k];
            }
        }
    }
    for (int i = 0; i < n; i++) {
        double row[ORDER_MAX];
        memcpy(row, P + i * n, (size_t)n * sizeof(double));
        for (int j = 0; j < m; j++) {
            const double gain = K[j][i], left = rest[j][i];
            for (int k = i; k < n; k++) {
                row[k] += left * K[j][k] - gain * C[j][k];
            }
        }
        for (int k = i; k < n; k++) {
            P_after[i * n + k] = P_after[k * n + i] = row[k];
        }
    }
    return DONE;
}
