/* Covariance propagation, and the Kalman correction in Joseph form.
 *
 * Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, eq. 5.2.3-18.
 */

#include <math.h>
#include <string.h>

#include "interface.h"

enum { NOT_POSITIVE = 0, DONE = 1 };

/* S = L L', lower triangle in place of S; NOT_POSITIVE if S is not positive definite. */
static int cholesky(int m, double S[ROWS_MAX][ROWS_MAX])
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

/* b <- inv(L) b */
static void solve_lower(int m, double L[ROWS_MAX][ROWS_MAX], double b[ROWS_MAX])
{
    for (int i = 0; i < m; i++) {
        for (int k = 0; k < i; k++) {
            b[i] -= L[i][k] * b[k];
        }
        b[i] /= L[i][i];
    }
}

/* b <- inv(L') b */
static void solve_upper(int m, double L[ROWS_MAX][ROWS_MAX], double b[ROWS_MAX])
{
    for (int i = m - 1; i >= 0; i--) {
        for (int k = i + 1; k < m; k++) {
            b[i] -= L[k][i] * b[k];
        }
        b[i] /= L[i][i];
    }
}

/* out = F M for a symmetric M, transposed. Most entries of a transition are zero. */
static void transposed_product(int n, const double *F, const double *M, double *out)
{
    double row[ORDER_MAX];
    for (int i = 0; i < n; i++) {
        memset(row, 0, sizeof row);
        for (int k = 0; k < n; k++) {
            const double f = F[i * n + k];
            if (f != 0.0) {
                for (int j = 0; j < n; j++) {
                    row[j] += f * M[k * n + j];
                }
            }
        }
        for (int j = 0; j < n; j++) {
            out[j * n + i] = row[j];
        }
    }
}

/* A <- (A + A') / 2 */
static void symmetrize(int n, double *A)
{
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < i; j++) {
            A[i * n + j] = A[j * n + i] = 0.5 * (A[i * n + j] + A[j * n + i]);
        }
    }
}

/* The symmetric part of F P F' + Q. */
void kalman_predict(int32_t n, const double *P, const double *F, const double *Q, double *P_after)
{
    double PF[ORDER_MAX * ORDER_MAX];
    transposed_product(n, F, P, PF);
    transposed_product(n, F, PF, P_after);
    for (int i = 0; i < n * n; i++) {
        P_after[i] += Q[i];
    }
    symmetrize(n, P_after);
}

/* The normalised innovation squared, innov' inv(S) innov. */
int32_t nis_of(int32_t m, const double *innov, const double *S, double *nis)
{
    double L[ROWS_MAX][ROWS_MAX], y[ROWS_MAX];
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

/* C = P H', (n, m). Most entries of a Jacobian are zero. */
static void by_jacobian(int n, int m, const double *P, double H[ROWS_MAX][ORDER_MAX], double C[ORDER_MAX][ROWS_MAX])
{
    for (int i = 0; i < n; i++) {
        memset(C[i], 0, sizeof C[i]);
    }
    for (int j = 0; j < m; j++) {
        for (int k = 0; k < n; k++) {
            const double h = H[j][k];
            if (h != 0.0) {
                for (int i = 0; i < n; i++) {
                    C[i][j] += P[i * n + k] * h;
                }
            }
        }
    }
}

/* The error state's correction dx = K y and (I - K H) P (I - K H)' + K R K', with K = P H' inv(S), S = H P H' + R. */
int32_t kalman_correct(int32_t n, int32_t m, const double *P, const double *innov, const double *H, const double *R, double *dx,
                       double *P_after, double *S, double *nis)
{
    double h[ROWS_MAX][ORDER_MAX], r[ROWS_MAX][ROWS_MAX], y[ROWS_MAX], scale[ROWS_MAX], L[ROWS_MAX][ROWS_MAX];
    double C[ORDER_MAX][ROWS_MAX], K[ORDER_MAX][ROWS_MAX], D[ORDER_MAX][ROWS_MAX];

    for (int i = 0; i < m; i++) {
        memcpy(h[i], H + i * n, (size_t)n * sizeof(double));
    }
    by_jacobian(n, m, P, h, C);
    /* Units and variances differ by many orders of magnitude: rows of unit innovation variance keep S well conditioned. */
    for (int i = 0; i < m; i++) {
        double var = R[i * m + i];
        for (int k = 0; k < n; k++) {
            var += h[i][k] * C[k][i];
        }
        if (!(var > 0.0) || !isfinite(var)) {
            return NOT_POSITIVE;
        }
        scale[i] = 1.0 / sqrt(var);
    }
    for (int i = 0; i < m; i++) {
        y[i] = innov[i] * scale[i];
        for (int k = 0; k < n; k++) {
            h[i][k] *= scale[i];
            C[k][i] *= scale[i];
        }
        for (int j = 0; j < m; j++) {
            r[i][j] = R[i * m + j] * scale[i] * scale[j];
        }
    }
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < m; j++) {
            L[i][j] = r[i][j];
            for (int k = 0; k < n; k++) {
                L[i][j] += h[i][k] * C[k][j];
            }
            S[i * m + j] = L[i][j] / (scale[i] * scale[j]);
        }
    }
    if (cholesky(m, L) == NOT_POSITIVE) {
        return NOT_POSITIVE;
    }
    for (int i = 0; i < n; i++) {
        memcpy(K[i], C[i], sizeof K[i]);
        solve_lower(m, L, K[i]);
        solve_upper(m, L, K[i]);
    }
    double size = 0.0;
    for (int i = 0; i < n; i++) {
        dx[i] = 0.0;
        for (int j = 0; j < m; j++) {
            dx[i] += K[i][j] * y[j];
        }
        size += dx[i] * dx[i];
    }
    solve_lower(m, L, y);
    *nis = 0.0;
    for (int i = 0; i < m; i++) {
        *nis += y[i] * y[i];
    }
    if (!isfinite(*nis) || !isfinite(size)) {
        return NOT_POSITIVE;
    }
    /* A = (I - K H) P = P - K C', in P_after; then A (I - K H)' + K R K' = A + (K R - A H') K'. */
    for (int i = 0; i < n; i++) {
        double *row = P_after + i * n;
        memcpy(row, P + i * n, (size_t)n * sizeof(double));
        for (int j = 0; j < m; j++) {
            const double gain = K[i][j];
            for (int k = 0; k < n; k++) {
                row[k] -= gain * C[k][j];
            }
        }
        for (int j = 0; j < m; j++) {
            D[i][j] = 0.0;
            for (int k = 0; k < m; k++) {
                D[i][j] += K[i][k] * r[k][j];
            }
            for (int k = 0; k < n; k++) {
                D[i][j] -= row[k] * h[j][k];
            }
        }
    }
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < m; j++) {
            const double d = D[i][j];
            for (int k = 0; k < n; k++) {
                P_after[i * n + k] += d * K[k][j];
            }
        }
    }
    symmetrize(n, P_after);
    return DONE;
}
