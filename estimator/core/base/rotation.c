/* Exponential and logarithm of rotations, angles. */

#include "base/rotation.h"

#include <math.h>

double wrapped(double angle)
{
    return remainder(angle, 2.0 * acos(-1.0));
}

void exp_rotation(const double v[3], double R[9])
{
    const double x = v[0], y = v[1], z = v[2], t2 = dot(v, v), t = sqrt(t2);
    double a = 1.0 - t2 / 6.0, b = 0.5;
    if (t2 >= 1e-8) {
        a = sin(t) / t;
        b = (1.0 - cos(t)) / t2;
    }
    const double xy = b * x * y, xz = b * x * z, yz = b * y * z, ax = a * x, ay = a * y, az = a * z;
    R[0] = 1.0 - b * (y * y + z * z), R[1] = xy - az, R[2] = xz + ay;
    R[3] = xy + az, R[4] = 1.0 - b * (x * x + z * z), R[5] = yz - ax;
    R[6] = xz - ay, R[7] = yz + ax, R[8] = 1.0 - b * (x * x + y * y);
}

void log_rotation(const double R[9], double v[3])
{
    const double sx = 0.5 * (R[7] - R[5]), sy = 0.5 * (R[2] - R[6]), sz = 0.5 * (R[3] - R[1]);
    const double s = sqrt(sx * sx + sy * sy + sz * sz), cosine = 0.5 * (R[0] + R[4] + R[8] - 1.0);
    double k = 1.0;
    if (s < 1e-6 && cosine <= 0.0) {
        /* Near half a turn the antisymmetric part vanishes: the axis is the largest column of R + I. */
        int largest = 0;
        for (int i = 1; i < 3; i++) {
            if (R[4 * i] > R[4 * largest]) {
                largest = i;
            }
        }
        double length = 0.0;
        for (int i = 0; i < 3; i++) {
            v[i] = R[3 * i + largest] + (i == largest);
            length += v[i] * v[i];
        }
        for (int i = 0; i < 3; i++) {
            v[i] *= acos(-1.0) / sqrt(length);
        }
        return;
    }
    if (s >= 1e-6) {
        k = atan2(s, cosine) / s;
    }
    v[0] = k * sx, v[1] = k * sy, v[2] = k * sz;
}

void left_jacobian(const double v[3], double J[9])
{
    const double t2 = dot(v, v), t = sqrt(t2);
    double K[9], KK[9], a = 0.5, b = 1.0 / 6.0;
    if (t2 >= 1e-6) {
        a = (1.0 - cos(t)) / t2;
        b = (t - sin(t)) / (t2 * t);
    }
    skew(v, K);
    product(K, K, KK);
    for (int i = 0; i < 9; i++) {
        J[i] = (i % 4 == 0) + a * K[i] + b * KK[i];
    }
}

void orthonormalise(double R[9])
{
    double left[9], step[9];
    product_of_transposed(R, R, left);
    for (int i = 0; i < 9; i++) {
        left[i] = (i % 4 == 0 ? 3.0 : 0.0) - left[i];
    }
    product(R, left, step);
    for (int i = 0; i < 9; i++) {
        R[i] = 0.5 * step[i];
    }
}

double heading_of(const double R[9])
{
    return atan2(R[3], R[0]);
}

void about_down(double angle, double R[9])
{
    const double c = cos(angle), s = sin(angle);
    R[0] = c, R[1] = -s, R[2] = 0.0;
    R[3] = s, R[4] = c, R[5] = 0.0;
    R[6] = 0.0, R[7] = 0.0, R[8] = 1.0;
}

void heading_by_outer_rotation(const double R[9], double row[3])
{
    const double flat = fmax(R[0] * R[0] + R[3] * R[3], 1e-12);
    row[0] = -R[6] * R[0] / flat, row[1] = -R[6] * R[3] / flat, row[2] = 1.0;
}

void heading_by_rotation(const double R[9], double row[3])
{
    double outer[3];
    heading_by_outer_rotation(R, outer);
    rotated_back(R, outer, row);
}

void from_rpy(double roll, double pitch, double yaw, double R[9])
{
    const double cr = cos(roll), sr = sin(roll), cp = cos(pitch), sp = sin(pitch), cy = cos(yaw), sy = sin(yaw);
    R[0] = cy * cp, R[1] = cy * sp * sr - sy * cr, R[2] = cy * sp * cr + sy * sr;
    R[3] = sy * cp, R[4] = sy * sp * sr + cy * cr, R[5] = sy * sp * cr - cy * sr;
    R[6] = -sp, R[7] = cp * sr, R[8] = cp * cr;
}
