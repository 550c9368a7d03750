/* Compute the transition and noise of the oscillators, and of a steady turn, over a time. */

#include "filter/oscillator.h"

#include <math.h>
#include <string.h>

void oscillator_at_rest(double w, double zeta, double P[4][4])
{
    const double delta = zeta * w, w2 = w * w, force = 8.0 * delta * delta, across = 2.0 * delta;
    const double at_rest[4][4] = {
        {1.0, 0.0, across, 0.0},
        {0.0, w2, 0.0, across * w2},
        {across, 0.0, force, 0.0},
        {0.0, across * w2, 0.0, force * w2},
    };
    memcpy(P, at_rest, sizeof at_rest);
}

void oscillator_transition(double w, double zeta, double T, double A[4][4], double q[4][4])
{
    const double delta = zeta * w, w2 = w * w, wd2 = w * w - delta * delta, wd = sqrt(wd2), e = exp(-delta * T);
    const double c = e * cos(wd * T), s = e * sin(wd * T) / wd;
    const double cc = 0.5 * (T * c + s), cs = 0.5 * T * s, ss = 0.5 * (s - T * c) / wd2;
    /* [[fa, fb], [fc, fd]] is the integral for a drive by f; multiplied by J it becomes the integral for a drive by f'. */
    const double fa = cs + delta * ss, fb = ss, fc = cc - delta * delta * ss, fd = cs - delta * ss;
    const double a[4][4] = {
        {c + delta * s, s, -w2 * fb, fa - 2.0 * delta * fb},
        {-w2 * s, c - delta * s, -w2 * fd, fc - 2.0 * delta * fd},
        {0.0, 0.0, c + delta * s, s},
        {0.0, 0.0, -w2 * s, c - delta * s},
    };
    double P[4][4], AP[4][4], lost[4][4];
    memcpy(A, a, sizeof a);
    oscillator_at_rest(w, zeta, P);
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) {
            AP[i][j] = 0.0;
            for (int k = 0; k < 4; k++) {
                AP[i][j] += a[i][k] * P[k][j];
            }
        }
    }
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) {
            lost[i][j] = P[i][j];
            for (int k = 0; k < 4; k++) {
                lost[i][j] -= AP[i][k] * a[j][k];
            }
        }
    }
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) {
            q[i][j] = 0.5 * (lost[i][j] + lost[j][i]);
        }
    }
}

void steady_turn(double rate, double T, double by[2][2], double reach[2][2])
{
    const double angle = rate * T, s = sin(angle), c = cos(angle);
    double along = T * (1.0 - angle * angle / 6.0), across = 0.5 * T * angle;
    if (fabs(angle) > 1e-3) {
        along = s / rate;
        across = (1.0 - c) / rate;
    }
    by[0][0] = by[1][1] = c, by[0][1] = -s, by[1][0] = s;
    reach[0][0] = reach[1][1] = along, reach[0][1] = -across, reach[1][0] = across;
}
