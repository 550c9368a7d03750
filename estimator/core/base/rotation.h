/* Vectors of three, and rotations as nine numbers in rows. */
#ifndef DECKLANDER_ROTATION_H
#define DECKLANDER_ROTATION_H

#define GRAVITY_M_S2 9.80665

/* The small products are here so that every file's compiler sees through them: the steps of physics and filter are made of them. */

static inline double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* out = a x b; out may be neither. */
static inline void cross(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* AB = A B */
static inline void product(const double A[9], const double B[9], double AB[9])
{
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            AB[3 * i + j] = A[3 * i] * B[j] + A[3 * i + 1] * B[3 + j] + A[3 * i + 2] * B[6 + j];
        }
    }
}

/* AB = A' B */
static inline void product_of_transposed(const double A[9], const double B[9], double AB[9])
{
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            AB[3 * i + j] = A[i] * B[j] + A[3 + i] * B[3 + j] + A[6 + i] * B[6 + j];
        }
    }
}

/* Av = A v */
static inline void rotated(const double A[9], const double v[3], double Av[3])
{
    for (int i = 0; i < 3; i++) {
        Av[i] = dot(A + 3 * i, v);
    }
}

/* Av = A' v */
static inline void rotated_back(const double A[9], const double v[3], double Av[3])
{
    for (int i = 0; i < 3; i++) {
        Av[i] = A[i] * v[0] + A[3 + i] * v[1] + A[6 + i] * v[2];
    }
}

/* K w = v x w for every w */
static inline void skew(const double v[3], double K[9])
{
    const double k[9] = {0.0, -v[2], v[1], v[2], 0.0, -v[0], -v[1], v[0], 0.0};
    for (int i = 0; i < 9; i++) {
        K[i] = k[i];
    }
}

/* A' */
static inline void transposed(const double A[9], double At[9])
{
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            At[3 * i + j] = A[3 * j + i];
        }
    }
}

/* AB = A B' */
static inline void product_by_transposed(const double A[9], const double B[9], double AB[9])
{
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            AB[3 * i + j] = dot(A + 3 * i, B + 3 * j);
        }
    }
}

/* The rotation by the rotation vector v, rad, by Rodrigues' formula. */
void exp_rotation(const double v[3], double R[9]);
/* The rotation vector of R, rad; at half a turn it has one of the two signs. */
void log_rotation(const double R[9], double v[3]);
/* The left Jacobian of SO(3): exp(v + dv) = exp(J dv) exp(v) to first order in dv.
 * Source: Sola, Deravat, Atchuthan, A micro Lie theory for state estimation in robotics, 2018, eq. 145. */
void left_jacobian(const double v[3], double J[9]);
/* One Newton step towards the nearest rotation (Higham, Computing the polar decomposition with applications, 1986). */
void orthonormalise(double R[9]);
/* The heading, rad: the direction of the first axis seen from above. */
double heading_of(const double R[9]);
/* The rotation by an angle about the down axis, Rz(angle). */
void about_down(double angle, double R[9]);
/* The derivative of R's heading with respect to a small rotation in R's outer frame. */
void heading_by_outer_rotation(const double R[9], double row[3]);
/* The derivative of R's heading with respect to a small rotation in R's inner frame. */
void heading_by_rotation(const double R[9], double row[3]);
/* Rz(yaw) Ry(pitch) Rx(roll) (Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd ed., eq. 2.31). */
void from_rpy(double roll, double pitch, double yaw, double R[9]);
/* The angle in -pi to pi, rad. */
double wrapped(double angle);

#endif
