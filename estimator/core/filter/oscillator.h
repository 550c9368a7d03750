/* How a deck moves on waves and with its vessel's turn: exact transitions over a time. */
#ifndef DECKLANDER_OSCILLATOR_H
#define DECKLANDER_OSCILLATOR_H

/* The stationary covariance of the states below for a unit displacement, by the Lyapunov equation. */
void oscillator_at_rest(double w, double zeta, double P[4][4]);
/* A damped oscillator driven by the rate of a second, equal one, over T: A, and the noise q for a unit displacement.
 * The states are [x, x', f, f']. docs/estimator.md, section "Waves". */
void oscillator_transition(double w, double zeta, double T, double A[4][4], double q[4][4]);
/* A steady turn for T seconds of a horizontal vector: the rotation, and its integral over time, s. */
void steady_turn(double rate, double T, double by[2][2], double reach[2][2]);

#endif
