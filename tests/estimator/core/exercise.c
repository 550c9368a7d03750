/* Calls every function of the core with random arguments of every size, for the sanitizers to watch; prints what it called. */

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "interface.h"

static double uniform(void)
{
    return 2.0 * rand() / RAND_MAX - 1.0;
}

/* Exactly as long as it must be, so that the sanitizer sees one step beyond. */
static double *numbers(int n)
{
    double *made = malloc((size_t)n * sizeof(double));
    for (int i = 0; i < n; i++) {
        made[i] = uniform();
    }
    return made;
}

/* A A' + I */
static double *covariance(int n)
{
    double *A = numbers(n * n), *P = numbers(n * n);
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) {
            P[i * n + j] = i == j;
            for (int k = 0; k < n; k++) {
                P[i * n + j] += A[i * n + k] * A[j * n + k];
            }
        }
    }
    free(A);
    return P;
}

static void algebra(int n, int m, double poison)
{
    double *P = covariance(n), *F = numbers(n * n), *Q = covariance(n), *after = numbers(n * n);
    double *innov = numbers(m), *H = numbers(m * n), *R = covariance(m), *dx = numbers(n), *S = numbers(m * m), nis;
    P[0] *= poison;
    kalman_predict(n, P, F, Q, after);
    kalman_correct(n, m, P, innov, H, R, dx, after, S, &nis);
    double *all[] = {P, F, Q, after, innov, H, R, dx, S};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) {
        free(all[i]);
    }
}

int main(void)
{
    printf("core_digest %u\n", core_digest());
    const double poisons[] = {1.0, 0.0, -1e300, 1e300, NAN, INFINITY};
    for (int n = 1; n <= ORDER_MAX; n += 7) {
        for (int m = 1; m <= ROWS_MAX; m++) {
            algebra(n, m, poisons[(n + m) % 6]);
        }
    }
    algebra(ORDER_MAX, ROWS_MAX, 1.0);
    printf("kalman_predict kalman_correct\n");
    return 0;
}
