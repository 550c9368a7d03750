/* Covariance propagation and the Kalman correction. */
#ifndef DECKLANDER_KALMAN_H
#define DECKLANDER_KALMAN_H

#include "base/linear.h"
#include "decklander.h"

enum {
    /* The largest number of states that a function takes. */
    ORDER_MAX = DL_N,
};

/* m numbers, measured less predicted, with their Jacobian (m, n) and their noise (m, m). */
typedef struct {
    int m;
    const double *innov, *H, *R;
} measured;

/* The symmetric part of F P F' + Q, for a symmetric P. Most entries of a transition are zero. */
void kalman_predict(int n, const double *P, const double *F, const double *Q, double *P_after);
/* The normalised innovation squared, innov' inv(S) innov; NOT_POSITIVE if S is not positive definite. */
int nis_of(int m, const double *innov, const double *S, double *nis);
/* The error state's correction dx = K y and (I - K H) P (I - K H)' + K R K', with K = P H' inv(S), S = H P H' + R; NOT_POSITIVE if
 * S is not positive definite. */
int kalman_correct(int n, const double *P, const measured *z, double *dx, double *P_after, double *S, double *nis);

/* Symmetric matrices of a few rows. */
/* A = V diag(values) V' by Jacobi's rotations; A is used up.
 * Source: Golub, Van Loan, Matrix Computations, 4th ed., 2013, sec. 8.5.2 and 8.5.3. */
void symmetric_eigen(int m, double A[DL_ROWS_MAX][DL_ROWS_MAX], double values[DL_ROWS_MAX], double V[DL_ROWS_MAX][DL_ROWS_MAX]);
/* The part of a measurement's covariance that an attitude's errors made is removed: cov - J cov_attitude J', (m, m) in rows.
 *
 * J is (m, 3). At least a small fraction of each direction remains. A `cov` that is clearly too small to contain that part in some
 * direction comes from an attitude that was taken as exact, and stays. */
void remove_attitude(int m, double *cov, const double *J, const double *cov_attitude);

#endif
