/* Sums over pixels. */
#ifndef DECKLANDER_REGISTER_SUMS_H
#define DECKLANDER_REGISTER_SUMS_H

#include "vision/register/state.h"
#include "base/linear.h"

/* Cut-off in standard deviations: 95 % efficient under Gaussian noise. Source: Holland, Welsch, 1977. */
#define TUKEY 4.7
/* The mean of its weights under Gaussian noise. */
#define MEAN_WEIGHT 0.9
/* The square of a normal number's median. */
#define MEDIAN_SQUARE 0.4549

/* The most paint coefficients of a dense fit: light and its two slopes, the regions, a reflection's four. */
enum { COEFFICIENTS_MAX = 3 + DL_PAD_CONTRASTS + 4, SUM_BLOCK = 128 };

/* out[i][j] += sum_n A[i][n] B[j][n], i < a, j < b; the rows of `out` are `stride` apart. Rows are zero from n to the next multiple
 * of `LANES`. Products of floats are summed over short blocks in single precision, and the blocks in double. */
void add_products(int n, int a, const float *const A[], int b, const float *const B[], int stride, double *out);
/* Add weighted products for A = B: the upper triangle alone, out[i][j] for i <= j. */
void add_squares(int n, int a, const float *const A[], const float *const B[], int stride, double *out);
/* Copy the upper triangle to the lower one. */
void mirror(int n, int stride, double *M);

/* The k-th smallest, from 0, of n finite numbers; `spare` has room for as many. */
float order_statistic(int k, int n, const float *values, uint32_t *spare);
/* The upper median of n finite numbers; `spare` has room for as many. */
float median_of(int n, const float *values, uint32_t *spare);

#endif
