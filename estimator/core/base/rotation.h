/* Vectors of three, and rotations as nine numbers in rows. */
#ifndef DECKLANDER_ROTATION_H
#define DECKLANDER_ROTATION_H

#define GRAVITY_M_S2 9.80665

/* AB = A B */
void product(const double A[9], const double B[9], double AB[9]);
/* AB = A' B */
void product_of_transposed(const double A[9], const double B[9], double AB[9]);
/* Av = A v */
void rotated(const double A[9], const double v[3], double Av[3]);
/* Av = A' v */
void rotated_back(const double A[9], const double v[3], double Av[3]);
/* K w = v x w for every w */
void skew(const double v[3], double K[9]);
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
double dot(const double a[3], const double b[3]);
/* out = a x b; out may be neither. */
void cross(const double a[3], const double b[3], double out[3]);
/* A' */
void transposed(const double A[9], double At[9]);
/* AB = A B' */
void product_by_transposed(const double A[9], const double B[9], double AB[9]);
/* The angle in -pi to pi, rad. */
double wrapped(double angle);

#endif
