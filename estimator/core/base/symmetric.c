/* Eigenvalues of a small symmetric matrix, and the removal of an attitude's share from a covariance. */


#include <math.h>
#include <string.h>

#include "base/kalman.h"

/* The least fraction of a covariance that remains when a part of it is removed. */
static const double KEPT = 0.02;
/* An attitude covariance above this many times the covariance that should contain it is no part of it. The different
 * linearisations of vision and filter cause a few hundredths. */
static const double NOT_A_PART = 1.5;
/* Jacobi's sweeps converge quadratically; random matrices of DL_ROWS_MAX rows needed 8 at most. */
enum { SWEEPS_MAX = 12 };

/* Rotate rows and columns p and q so that A[p][q] vanishes. */
static void jacobi_rotate(int m, int p, int q, double A[DL_ROWS_MAX][DL_ROWS_MAX], double V[DL_ROWS_MAX][DL_ROWS_MAX])
{
    const double theta = 0.5 * (A[q][q] - A[p][p]) / A[p][q];
    const double t = (theta < 0.0 ? -1.0 : 1.0) / (fabs(theta) + hypot(theta, 1.0)), c = 1.0 / hypot(t, 1.0), s = t * c;
    for (int k = 0; k < m; k++) {
        const double kp = A[k][p], kq = A[k][q], vp = V[k][p], vq = V[k][q];
        A[k][p] = c * kp - s * kq;
        A[k][q] = s * kp + c * kq;
        V[k][p] = c * vp - s * vq;
        V[k][q] = s * vp + c * vq;
    }
    for (int k = 0; k < m; k++) {
        const double pk = A[p][k], qk = A[q][k];
        A[p][k] = c * pk - s * qk;
        A[q][k] = s * pk + c * qk;
    }
}

void symmetric_eigen(int m, double A[DL_ROWS_MAX][DL_ROWS_MAX], double values[DL_ROWS_MAX], double V[DL_ROWS_MAX][DL_ROWS_MAX])
{
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < m; j++) {
            V[i][j] = i == j;
        }
    }
    for (int sweep = 0; sweep < SWEEPS_MAX; sweep++) {
        double off = 0.0, size = 0.0;
        for (int i = 0; i < m; i++) {
            size += A[i][i] * A[i][i];
            for (int j = i + 1; j < m; j++) {
                off += A[i][j] * A[i][j];
            }
        }
        if (off <= 1e-32 * size) {
            break;
        }
        for (int p = 0; p < m; p++) {
            for (int q = p + 1; q < m; q++) {
                if (A[p][q] != 0.0) {
                    jacobi_rotate(m, p, q, A, V);
                }
            }
        }
    }
    for (int i = 0; i < m; i++) {
        values[i] = A[i][i];
    }
}

/* part = J cov_attitude J', (m, m) */
static void attitude_part(int m, const double *J, const double cov_attitude[9], double part[DL_ROWS_MAX][DL_ROWS_MAX])
{
    for (int i = 0; i < m; i++) {
        double row[3];
        for (int k = 0; k < 3; k++) {
            row[k] = J[3 * i] * cov_attitude[k] + J[3 * i + 1] * cov_attitude[3 + k] + J[3 * i + 2] * cov_attitude[6 + k];
        }
        for (int j = 0; j < m; j++) {
            part[i][j] = row[0] * J[3 * j] + row[1] * J[3 * j + 1] + row[2] * J[3 * j + 2];
        }
    }
}

/* inv(L) part inv(L)': the part in units of the whole. */
static void in_units_of(int m, double L[DL_ROWS_MAX][DL_ROWS_MAX], double part[DL_ROWS_MAX][DL_ROWS_MAX], double out[DL_ROWS_MAX][DL_ROWS_MAX])
{
    double left[DL_ROWS_MAX][DL_ROWS_MAX];
    for (int j = 0; j < m; j++) {
        for (int i = 0; i < m; i++) {
            left[j][i] = part[i][j];
        }
        solve_lower(m, DL_ROWS_MAX, *L, 1, 1, left[j]);
    }
    for (int j = 0; j < m; j++) {
        for (int i = 0; i < m; i++) {
            out[j][i] = left[i][j];
        }
        solve_lower(m, DL_ROWS_MAX, *L, 1, 1, out[j]);
    }
}

/* cov <- half diag(kept) half' with half = L axes. */
static void assemble(int m, double L[DL_ROWS_MAX][DL_ROWS_MAX], double axes[DL_ROWS_MAX][DL_ROWS_MAX], const double kept[DL_ROWS_MAX], double *cov)
{
    double half[DL_ROWS_MAX][DL_ROWS_MAX];
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < m; j++) {
            half[i][j] = 0.0;
            for (int k = 0; k <= i; k++) {
                half[i][j] += L[i][k] * axes[k][j];
            }
        }
    }
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < m; j++) {
            cov[i * m + j] = 0.0;
            for (int k = 0; k < m; k++) {
                cov[i * m + j] += half[i][k] * kept[k] * half[j][k];
            }
        }
    }
}

void remove_attitude(int m, double *cov, const double *J, const double *cov_attitude)
{
    double part[DL_ROWS_MAX][DL_ROWS_MAX], rest[DL_ROWS_MAX][DL_ROWS_MAX], L[DL_ROWS_MAX][DL_ROWS_MAX];
    attitude_part(m, J, cov_attitude, part);
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < m; j++) {
            L[i][j] = cov[i * m + j];
            rest[i][j] = (1.0 - KEPT) * cov[i * m + j] - part[i][j];
        }
    }
    if (cholesky(m, DL_ROWS_MAX, *rest) != NOT_POSITIVE) {
        for (int i = 0; i < m * m; i++) {
            cov[i] -= part[i / m][i % m];
        }
        return;
    }
    double whitened[DL_ROWS_MAX][DL_ROWS_MAX], fraction[DL_ROWS_MAX], axes[DL_ROWS_MAX][DL_ROWS_MAX];
    if (cholesky(m, DL_ROWS_MAX, *L) == NOT_POSITIVE) {
        return;
    }
    in_units_of(m, L, part, whitened);
    symmetric_eigen(m, whitened, fraction, axes);
    for (int i = 0; i < m; i++) {
        if (fraction[i] > NOT_A_PART) {
            return;
        }
        fraction[i] = fmax(1.0 - fraction[i], KEPT);
    }
    assemble(m, L, axes, fraction, cov);
}
