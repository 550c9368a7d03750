/* The triangles that the Kalman correction and others need. */
#ifndef DECKLANDER_KALMAN_H
#define DECKLANDER_KALMAN_H

#include "decklander.h"

enum { NOT_POSITIVE = 0, DONE = 1 };

/* S = L L', lower triangle in place of S; NOT_POSITIVE if S is not positive definite. */
int cholesky(int m, double S[ROWS_MAX][ROWS_MAX]);
/* b <- inv(L) b */
void solve_lower(int m, double L[ROWS_MAX][ROWS_MAX], double b[ROWS_MAX]);

#endif
