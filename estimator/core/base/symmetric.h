/* Symmetric matrices of a few rows. */
#ifndef DECKLANDER_SYMMETRIC_H
#define DECKLANDER_SYMMETRIC_H

#include "decklander.h"

/* A = V diag(values) V' by Jacobi's rotations; A is used up.
 * Source: Golub, Van Loan, Matrix Computations, 4th ed., 2013, sec. 8.5.2 and 8.5.3. */
void symmetric_eigen(int m, double A[ROWS_MAX][ROWS_MAX], double values[ROWS_MAX], double V[ROWS_MAX][ROWS_MAX]);

#endif
