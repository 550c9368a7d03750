/* Rotate Jacobians of the whole state to level, and move the deck from the camera's time to the body's. */

#include "filter/jacobian.h"

#include <math.h>
#include <string.h>

#include "base/rotation.h"
#include "base/wide.h"

/* Each direction of the deck has displacement, rate, force and its rate. */
enum { PER_DIRECTION = 4, DISP = DL_WAVES, RATE = DL_WAVES + 1 };

void rows_times(int m, const double *J, const double *F, double *JF)
{
    memset(JF, 0, (size_t)m * DL_N * sizeof *JF);
    for (int i = 0; i < m; i++) {
        for (int k = 0; k < DL_N; k++) {
            const double factor = AT(J, i, k);
            if (factor != 0.0) {
                for (int j = 0; j < DL_N; j++) {
                    AT(JF, i, j) += factor * AT(F, k, j);
                }
            }
        }
    }
}

/* The columns in which any row is not zero. */
static int columns_of(int m, const double *J, int columns[DL_N])
{
    int n = 0;
    for (int k = 0; k < DL_N; k++) {
        int used = 0;
        for (int i = 0; i < m; i++) {
            used |= AT(J, i, k) != 0.0;
        }
        columns[n] = k;
        n += used;
    }
    return n;
}

WIDE
void add_spread(int m, const double *J, const double *C, double *cov)
{
    int columns[DL_N + 1];
    const int n = columns_of(m, J, columns);
    for (int i = 0; i < m; i++) {
        double JC[DL_N] = {0.0};
        for (int k = 0; k < n; k++) {
            const double factor = AT(J, i, columns[k]);
            if (factor != 0.0) {
                for (int l = 0; l < DL_N; l++) {
                    JC[l] += factor * AT(C, columns[k], l);
                }
            }
        }
        for (int j = i; j < m; j++) {
            double sum = cov[i * m + j];
            for (int l = 0; l < n; l++) {
                sum += JC[columns[l]] * AT(J, j, columns[l]);
            }
            cov[i * m + j] = cov[j * m + i] = sum;
        }
    }
}

void level_axes_of(const double R[9], level_axes *level)
{
    const double heading = atan2(R[3], R[0]);
    level->c = cos(heading);
    level->s = sin(heading);
    heading_by_rotation(R, level->turning);
}

void turn_rows(const level_axes *level, double *J)
{
    for (int k = 0; k < DL_N; k++) {
        const double north = AT(J, 0, k), east = AT(J, 1, k);
        AT(J, 0, k) = level->c * north + level->s * east;
        AT(J, 1, k) = level->c * east - level->s * north;
    }
}

void turn_vector(const level_axes *level, double v[3])
{
    const double north = v[0], east = v[1];
    v[0] = level->c * north + level->s * east;
    v[1] = level->c * east - level->s * north;
}

void add_turning(const level_axes *level, const double v[3], double *J)
{
    for (int k = 0; k < 3; k++) {
        AT(J, 0, DL_ATT_ERR + k) += v[1] * level->turning[k];
        AT(J, 1, DL_ATT_ERR + k) -= v[0] * level->turning[k];
    }
}

static double rate_of(const double x[DL_N], int direction)
{
    return x[RATE + PER_DIRECTION * direction];
}

void align(const double before[DL_N], double x[DL_N])
{
    const double late = before[DL_CAMERA_DELAY];
    memcpy(x, before, DL_N * sizeof *x);
    for (int k = 0; k < DL_DIRECTIONS; k++) {
        x[DISP + PER_DIRECTION * k] -= late * rate_of(before, k);
    }
    for (int i = 0; i < 3; i++) {
        x[DL_POS_REL + i] -= late * rate_of(before, i);
    }
}

void through_alignment(int m, const double before[DL_N], double *J)
{
    const double late = before[DL_CAMERA_DELAY];
    for (int i = 0; i < m; i++) {
        double *row = J + i * DL_N;
        for (int k = 0; k < DL_DIRECTIONS; k++) {
            const double by = row[DISP + PER_DIRECTION * k] + (k < 3 ? row[DL_POS_REL + k] : 0.0);
            row[RATE + PER_DIRECTION * k] -= late * by;
            row[DL_CAMERA_DELAY] -= rate_of(before, k) * by;
        }
    }
}

void add_pad_velocity(double *J)
{
    for (int i = 0; i < 3; i++) {
        AT(J, i, RATE + PER_DIRECTION * i) += 1.0;
    }
    for (int i = 0; i < 2; i++) {
        AT(J, i, DL_VESSEL_VEL + i) += 1.0;
    }
}
