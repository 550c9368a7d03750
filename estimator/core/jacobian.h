/* Rows of a Jacobian of the whole state, and the deck in the state. Most entries of a row are zero. */
#ifndef DECKLANDER_JACOBIAN_H
#define DECKLANDER_JACOBIAN_H

#include "correction.h"

/* JF = J F, (m, N) */
void rows_times(int m, const double *J, const double *F, double *JF);
/* cov += J C J', (m, m), for a symmetric (N, N) C */
void add_spread(int m, const double *J, const double *C, double *cov);
/* Three rows of `ned`, turned to axes of the heading whose cosine and sinus are c and s. */
void turn_rows(double c, double s, double *J);
/* v turned as `turn_rows` turns rows. */
void turn_vector(double c, double s, double v[3]);
/* x = the state with the deck moved from the camera's time to the body's. */
void align(const double before[N], double x[N]);
/* J <- J T, (m, N), with the Jacobian T of `align` at the state before. */
void through_alignment(int m, const double before[N], double *J);
/* J += the three rows of `pad_velocity`. */
void add_pad_velocity(const double x[N], double *J);

#endif
