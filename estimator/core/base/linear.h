/* Small systems of symmetric equations. A matrix has n rows of numbers, `stride` from row to row; of a triangle only the lower one is
 * read. A right side B has n rows of m numbers, `width` from row to row. */
#ifndef DECKLANDER_LINEAR_H
#define DECKLANDER_LINEAR_H

enum {
    /* The most unknowns of `solve_symmetric`. */
    UNKNOWNS_MAX = 16,
};

enum { NOT_POSITIVE = 0, DONE = 1 };

/* row += factor other, of n numbers. */
static inline void add_scaled(int n, double factor, const double *restrict other, double *restrict row)
{
    for (int k = 0; k < n; k++) {
        row[k] += factor * other[k];
    }
}

/* A = L L', with L in place of A; NOT_POSITIVE if A is not positive definite. */
int cholesky(int n, int stride, double *A);
/* B <- inv(L) B */
void solve_lower(int n, int stride, const double *L, int m, int width, double *B);
/* B <- inv(L L') B */
void solve_factored(int n, int stride, const double *L, int m, int width, double *B);
/* B <- inv(A) B for a positive definite A (n, n), which is lost; NOT_POSITIVE if it is none. */
int solve_positive(int n, double *A, int m, double *B);
/* B <- inv(M) B for a symmetric M of at most UNKNOWNS_MAX rows, by elimination if it is not positive definite; 0 if it is singular. */
int solve_symmetric(int n, int stride, const double *M, int m, double *B);

#endif
