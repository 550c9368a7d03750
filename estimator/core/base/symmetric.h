/* Symmetric matrices of a few rows. */
#ifndef DECKLANDER_SYMMETRIC_H
#define DECKLANDER_SYMMETRIC_H

#include "decklander.h"

/* A = V diag(values) V' by Jacobi's rotations; A is used up.
 * Source: Golub, Van Loan, Matrix Computations, 4th ed., 2013, sec. 8.5.2 and 8.5.3. */
void symmetric_eigen(int m, double A[DL_ROWS_MAX][DL_ROWS_MAX], double values[DL_ROWS_MAX], double V[DL_ROWS_MAX][DL_ROWS_MAX]);
/* The part of a measurement's covariance that an attitude's errors made is removed: cov - J cov_attitude J', (m, m) in rows.
 *
 * J is (m, 3). At least a small fraction of each direction remains. A `cov` that is clearly too small to contain that part in some
 * direction comes from an attitude that was taken as exact, and stays. */
void remove_attitude(int m, double *cov, const double *J, const double *cov_attitude);

#endif
