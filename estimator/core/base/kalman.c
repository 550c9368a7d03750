/* Covariance propagation, and the Kalman correction in Joseph form.
 *
 * Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, eq. 5.2.3-18.
 */

#include <math.h>
#include <string.h>

#include "base/kalman.h"
#include "base/wide.h"

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

/* The squares of y = inv(L) innov, which takes its place. */
static double squared(int m, double L[DL_ROWS_MAX][DL_ROWS_MAX], double y[DL_ROWS_MAX])
{
    double sum = 0.0;
    solve_lower(m, DL_ROWS_MAX, *L, 1, 1, y);
    for (int i = 0; i < m; i++) {
        sum += y[i] * y[i];
    }
    return sum;
}

int nis_of(int m, const double *innov, const double *S, double *nis)
{
    double L[DL_ROWS_MAX][DL_ROWS_MAX], y[DL_ROWS_MAX];
    for (int i = 0; i < m; i++) {
        y[i] = innov[i];
        memcpy(L[i], S + i * m, (size_t)m * sizeof *S);
    }
    if (cholesky(m, DL_ROWS_MAX, *L) == NOT_POSITIVE) {
        return NOT_POSITIVE;
    }
    *nis = squared(m, L, y);
    return isfinite(*nis) ? DONE : NOT_POSITIVE;
}

/* A measurement in rows of unit innovation variance: units and variances differ by many orders of magnitude, and S so stays well
 * conditioned. C = H P, S = C H' + R = L L', K = inv(S) C. */
typedef struct {
    double y[DL_ROWS_MAX], S[DL_ROWS_MAX][DL_ROWS_MAX], L[DL_ROWS_MAX][DL_ROWS_MAX];
    double C[DL_ROWS_MAX][ORDER_MAX], K[DL_ROWS_MAX][ORDER_MAX];
} gain;

/* row = h P: most entries of a Jacobian are zero, and P is symmetric. */
static inline void times_covariance(int n, const double *h, const double *P, double *row)
{
    memset(row, 0, (size_t)n * sizeof *row);
    for (int k = 0; k < n; k++) {
        if (h[k] != 0.0) {
            add_scaled(n, h[k], P + k * n, row);
        }
    }
}

/* S = C H' + R, unscaled. */
static inline void innovation_covariance(int n, const measured *z, double C[DL_ROWS_MAX][ORDER_MAX], double *S)
{
    for (int i = 0; i < z->m; i++) {
        for (int j = 0; j < z->m; j++) {
            double sum = z->R[i * z->m + j];
            for (int k = 0; k < n; k++) {
                sum += C[i][k] * z->H[j * n + k];
            }
            S[i * z->m + j] = sum;
        }
    }
}

/* Scale a measurement's rows and solve for its gain; NOT_POSITIVE if S is not positive definite. */
static inline int scaled_gain(int n, const measured *z, const double *S, gain *of)
{
    const int m = z->m;
    double scale[DL_ROWS_MAX];
    for (int i = 0; i < m; i++) {
        const double var = S[i * m + i];
        if (!(var > 0.0) || !isfinite(var)) {
            return NOT_POSITIVE;
        }
        scale[i] = 1.0 / sqrt(var);
        of->y[i] = z->innov[i] * scale[i];
        for (int k = 0; k < n; k++) {
            of->C[i][k] *= scale[i];
        }
    }
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < m; j++) {
            of->L[i][j] = of->S[i][j] = S[i * m + j] * scale[i] * scale[j];
        }
    }
    if (cholesky(m, DL_ROWS_MAX, *of->L) == NOT_POSITIVE) {
        return NOT_POSITIVE;
    }
    memcpy(of->K, of->C, (size_t)m * sizeof of->K[0]);
    solve_factored(m, DL_ROWS_MAX, *of->L, n, ORDER_MAX, *of->K);
    return DONE;
}

/* Multiplied out, Joseph's form is P - K C' + (K S - C) K' with C = P H'. The bracket vanishes except for the errors of K, which so
 * enter in the second order alone, as they do in Joseph's form. */
static inline void joseph(int n, int m, const double *P, const gain *of, double *P_after)
{
    double rest[DL_ROWS_MAX][ORDER_MAX];
    for (int i = 0; i < m; i++) {
        for (int k = 0; k < n; k++) {
            rest[i][k] = -of->C[i][k];
        }
        for (int j = 0; j < m; j++) {
            add_scaled(n, of->S[i][j], of->K[j], rest[i]);
        }
    }
    for (int i = 0; i < n; i++) {
        double row[ORDER_MAX];
        memcpy(row, P + i * n, (size_t)n * sizeof(double));
        for (int j = 0; j < m; j++) {
            const double by = of->K[j][i], left = rest[j][i];
            for (int k = i; k < n; k++) {
                row[k] += left * of->K[j][k] - by * of->C[j][k];
            }
        }
        for (int k = i; k < n; k++) {
            P_after[i * n + k] = P_after[k * n + i] = row[k];
        }
    }
}

WIDE
int kalman_correct(int n, const double *P, const measured *z, double *dx, double *P_after, double *S, double *nis)
{
    gain of;
    for (int i = 0; i < z->m; i++) {
        times_covariance(n, z->H + i * n, P, of.C[i]);
    }
    innovation_covariance(n, z, of.C, S);
    if (scaled_gain(n, z, S, &of) == NOT_POSITIVE) {
        return NOT_POSITIVE;
    }
    memset(dx, 0, (size_t)n * sizeof *dx);
    double size = 0.0;
    for (int i = 0; i < z->m; i++) {
        add_scaled(n, of.y[i], of.K[i], dx);
    }
    for (int k = 0; k < n; k++) {
        size += dx[k] * dx[k];
    }
    *nis = squared(z->m, of.L, of.y);
    if (!isfinite(*nis) || !isfinite(size)) {
        return NOT_POSITIVE;
    }
    joseph(n, z->m, P, &of, P_after);
    return DONE;
}
