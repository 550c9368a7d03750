/* Rows of a Jacobian of the whole state, and the deck in the state. Most entries of a row are zero. */
#ifndef DECKLANDER_JACOBIAN_H
#define DECKLANDER_JACOBIAN_H

#include "filter/correction.h"

/* JF = J F, (m, N) */
void rows_times(int m, const double *J, const double *F, double *JF);
/* cov += J C J', (m, m), for a symmetric (N, N) C */
void add_spread(int m, const double *J, const double *C, double *cov);
/* The axes of the body's heading: cosine and sine of it, and its derivative by the attitude error. */
typedef struct {
    double c, s, turning[3];
} level_axes;

/* The axes of level of a body with attitude R. */
void level_axes_of(const double R[9], level_axes *level);
/* Three rows of ned, turned to level. */
void turn_rows(const level_axes *level, double *J);
/* A vector in ned, turned to level. */
void turn_vector(const level_axes *level, double v[3]);
/* J += the three rows by which a vector, (3,) in level, turns against the heading's error. */
void add_turning(const level_axes *level, const double v[3], double *J);
/* x = the state with the deck moved from the camera's time to the body's. */
void align(const double before[DL_N], double x[DL_N]);
/* J <- J T, (m, N), with the Jacobian T of `align` at the state before. */
void through_alignment(int m, const double before[DL_N], double *J);
/* J += the three rows of `pad_velocity`. */
void add_pad_velocity(double *J);

#endif
