/* Find the tilt of a plane from the ellipse of an outline. */

#include <math.h>
#include <string.h>

#include "base/kalman.h"
#include "base/rotation.h"
#include "vision/align/align.h"
#include "vision/search/search.h"

/* Fewest points of an outline, and the ratios of an ellipse's axes. Below the first it is a circle that faces the camera, within
 * the accuracy of its edges. */
enum { FEWEST = 12, CONIC = 5 };
static const double SHORTEST = 1.04; /* Ratio of an ellipse's axes below which it is a circle that faces the camera. */
static const double LONGEST_AXIS = 3.0; /* Largest ratio that is taken. */
/* Cosine of 38 degrees between the pad's normal and the camera's axis: 25 degrees of tilt plus an error. */
static const double LEAST_TILT_FACING = 0.7880107536067220;
/* Least cosine between a ray and the plane's normal. */
static const double LEAST_RAY = 0.15;

/* The mean of some points, and the root of their mean square distance from it. */
static double spread_about(int n, const double *xy, double mean[2])
{
    double squares = 0.0;
    mean[0] = mean[1] = 0.0;
    for (int i = 0; i < n; i++) {
        mean[0] += xy[2 * i] / n;
        mean[1] += xy[2 * i + 1] / n;
    }
    for (int i = 0; i < n; i++) {
        const double x = xy[2 * i] - mean[0], y = xy[2 * i + 1] - mean[1];
        squares += (x * x + y * y) / n;
    }
    return sqrt(squares);
}

/* The conic p[0] (x^2 - y^2) + 2 p[1] x y + p[2] x + p[3] y + p[4] + x^2 + y^2 = 0 through points, by least squares.
 *
 * Source: Gander, Golub, Strebel, Least-squares fitting of circles and ellipses, BIT 34, 1994, section 4.1 (a fixed trace). */
static int conic_of(int n, const double *xy, const double mean[2], double scale, double p[CONIC])
{
    double M[CONIC * CONIC];
    memset(M, 0, sizeof M);
    memset(p, 0, CONIC * sizeof *p);
    for (int i = 0; i < n; i++) {
        const double x = (xy[2 * i] - mean[0]) / scale, y = (xy[2 * i + 1] - mean[1]) / scale;
        const double row[CONIC] = {x * x - y * y, 2.0 * x * y, x, y, 1.0};
        for (int j = 0; j < CONIC; j++) {
            for (int k = 0; k < CONIC; k++) {
                M[CONIC * j + k] += row[j] * row[k];
            }
            p[j] -= row[j] * (x * x + y * y);
        }
    }
    return solve_positive(CONIC, M, 1, p);
}

/* The matrix of the conic in the rays' own coordinates. */
static void cone_of(const double p[CONIC], const double mean[2], double scale, double Q[9])
{
    const double own[9] = {1.0 + p[0], p[1], 0.5 * p[2], p[1], 1.0 - p[0], 0.5 * p[3], 0.5 * p[2], 0.5 * p[3], p[4]};
    const double to[9] = {1.0 / scale, 0.0, -mean[0] / scale, 0.0, 1.0 / scale, -mean[1] / scale, 0.0, 0.0, 1.0};
    double left[9];
    product_of_transposed(to, own, left);
    product(left, to, Q);
}

/* Eigenvalues of a symmetric matrix, the largest first, and the vectors of the largest and of the least. */
static void sorted_eigen(const double Q[9], double values[3], double most[3], double least[3])
{
    double A[DL_ROWS_MAX][DL_ROWS_MAX], found[DL_ROWS_MAX], V[DL_ROWS_MAX][DL_ROWS_MAX];
    int first = 0, last = 0;
    for (int i = 0; i < 9; i++) {
        A[i / 3][i % 3] = Q[i];
    }
    symmetric_eigen(3, A, found, V);
    for (int k = 1; k < 3; k++) {
        first = found[k] > found[first] ? k : first;
        last = found[k] <= found[last] ? k : last;
    }
    for (int i = 0; i < 3; i++) {
        most[i] = V[i][first];
        least[i] = V[i][last];
    }
    values[0] = found[first], values[2] = found[last], values[1] = found[0] + found[1] + found[2] - values[0] - values[2];
}

/* The normals of the planes in which a cone's cut is a circle; returns how many there are.
 *
 * Source: Kanatani and Liu, 3D interpretation of conics and orthogonality, CVGIP 58 (1993), eq. 19. */
static int circle_normals(const double Q[9], double normals[2][3])
{
    double l[3], most[3], least[3];
    sorted_eigen(Q, l, most, least);
    if (!(l[2] < 0.0 && l[1] > 0.0)) {
        return 0;
    }
    const double a = sqrt(fmax(0.0, (l[0] - l[1]) / (l[0] - l[2]))), b = sqrt((l[1] - l[2]) / (l[0] - l[2]));
    const int n = l[0] - l[1] > 1e-9 * l[0] ? 2 : 1;
    for (int k = 0; k < n; k++) {
        for (int i = 0; i < 3; i++) {
            normals[k][i] = (k ? -a : a) * most[i] + b * least[i];
        }
        for (int i = 0, turn = normals[k][2] < 0.0; turn && i < 3; i++) {
            normals[k][i] = -normals[k][i];
        }
    }
    return n;
}

/* The plane with a normal, turned as little as possible from the camera's axes. */
static void facing(const double normal[3], double R[9])
{
    const double s = hypot(normal[0], normal[1]), by = s > 1e-9 ? atan2(s, normal[2]) / s : 0.0;
    const double turn[3] = {-normal[1] * by, normal[0] * by, 0.0};
    exp_rotation(turn, R);
}

int search_on_plane(int n, const double *rays, const double R_cam_plane[9], double *out)
{
    for (int i = 0; i < n; i++) {
        const double ray[3] = {rays[2 * i], rays[2 * i + 1], 1.0};
        double at[3];
        rotated_back(R_cam_plane, ray, at);
        if (!(at[2] > LEAST_RAY)) {
            return 0;
        }
        out[2 * i] = at[0] / at[2];
        out[2 * i + 1] = at[1] / at[2];
    }
    return 1;
}

/* A circle through points by least squares on its equation.
 *
 * Source: Kasa, A circle fitting procedure and its error analysis, IEEE Trans. Instrumentation and Measurement 25, 1976. */
static int circle_of(int n, const double *xy, circle_stand *out)
{
    double mean[2], xx = 0.0, xy_ = 0.0, yy = 0.0, bx = 0.0, by = 0.0, z_mean = 0.0;
    spread_about(n, xy, mean);
    for (int i = 0; i < n; i++) {
        const double x = xy[2 * i] - mean[0], y = xy[2 * i + 1] - mean[1], z = x * x + y * y;
        xx += x * x, xy_ += x * y, yy += y * y;
        bx += 0.5 * x * z, by += 0.5 * y * z, z_mean += z / n;
    }
    const double det = xx * yy - xy_ * xy_;
    if (!(det > 1e-18)) {
        return 0;
    }
    const double cx = (bx * yy - by * xy_) / det, cy = (by * xx - bx * xy_) / det;
    out->centre[0] = mean[0] + cx, out->centre[1] = mean[1] + cy;
    out->radius = sqrt(cx * cx + cy * cy + z_mean);
    return 1;
}

int search_tilts(int n, const double *rays, circle_stand out[2])
{
    double mean[2], p[CONIC], Q[9], normals[2][3], places[2 * DL_SEARCH_SECTORS];
    int found = 0;
    const double scale = spread_about(n, rays, mean);
    if (n < FEWEST || !(scale > 0.0) || !conic_of(n, rays, mean, scale, p)) {
        return 0;
    }
    const double odd = hypot(p[0], p[1]), ratio2 = (1.0 + odd) / (1.0 - odd);
    if (!(odd < 1.0 && ratio2 > SHORTEST * SHORTEST && ratio2 < LONGEST_AXIS * LONGEST_AXIS)) {
        return 0;
    }
    cone_of(p, mean, scale, Q);
    for (int k = circle_normals(Q, normals) - 1; k >= 0; k--) {
        circle_stand *one = &out[found];
        if (normals[k][2] >= LEAST_TILT_FACING) {
            facing(normals[k], one->R);
            one->known = 1;
            found += search_on_plane(n, rays, one->R, places) && circle_of(n, places, one);
        }
    }
    return found;
}
