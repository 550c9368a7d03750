/* Project points through a lens with Brown's distortion or a fisheye, and find the rays of pixels. */

#include "vision/tracker.h"

#include <math.h>

/* Newton steps from the distorted place, and from where the pixels beside it lead. */
enum { FIRST_STEPS = 12, NEXT_STEPS = 2 };
static const double NEAREST_PROJECTED_M = 1e-3; /* Least depth of a point that is projected. */
/* Newton steps of a fisheye, the largest angle from its axis, rad, the least slope that is followed, and the axis itself. */
enum { FISHEYE_STEPS = 20 };
static const double WIDEST_RAD = 1.5; /* Largest angle of a fisheye's ray from the axis, rad. */
static const double LEAST_SLOPE = 0.05; /* Least slope of its curve that a step divides by. */
static const double ON_AXIS = 1e-9; /* Distance from the axis, in focal lengths, of a ray along it. */
static const double SAME_RAD = 1e-13; /* Step at which the angle is found, rad. */

/* Source: Brown, Close-range camera calibration, Photogrammetric Engineering 37(8), 1971; the order of coefficients is OpenCV's. */
static inline void distort(const double d[5], double x, double y, double out[2])
{
    const double r2 = x * x + y * y, radial = 1.0 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]));
    out[0] = x * radial + 2.0 * d[2] * x * y + d[3] * (r2 + 2.0 * x * x);
    out[1] = y * radial + d[2] * (r2 + 2.0 * y * y) + 2.0 * d[3] * x * y;
}

/* One of Newton's steps towards the point that is distorted to (u, v). */
static inline void undistort_step(const double d[5], double u, double v, double xy[2])
{
    const double x = xy[0], y = xy[1], r2 = x * x + y * y;
    const double radial = 1.0 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]));
    const double slope = 2.0 * (d[0] + r2 * (2.0 * d[1] + 3.0 * r2 * d[4]));
    const double across = slope * x * y + 2.0 * d[2] * x + 2.0 * d[3] * y;
    const double xx = radial + slope * x * x + 2.0 * d[2] * y + 6.0 * d[3] * x;
    const double yy = radial + slope * y * y + 6.0 * d[2] * y + 2.0 * d[3] * x;
    double at[2];
    distort(d, x, y, at);
    const double off_x = at[0] - u, off_y = at[1] - v, by = 1.0 / (xx * yy - across * across);
    xy[0] -= (off_x * yy - off_y * across) * by;
    xy[1] -= (off_y * xx - off_x * across) * by;
}

/* Source: Kannala and Brandt, A generic camera model and calibration method for conventional, wide-angle, and fish-eye lenses,
 * PAMI 28(8), 2006; the order of coefficients is OpenCV's. */
static inline double fisheye_bent(const double d[5], double theta)
{
    const double t2 = theta * theta;
    return theta * (1.0 + t2 * (d[0] + t2 * (d[1] + t2 * (d[2] + t2 * d[3]))));
}

/* The ray of a distorted place, from an angle that is near its own; that angle is returned. */
static inline double fisheye_ray(const double d[5], double u, double v, double theta, double ray[2])
{
    const double r = sqrt(u * u + v * v);
    for (int step = 0; step < FISHEYE_STEPS; step++) {
        const double t2 = theta * theta;
        const double slope = 1.0 + t2 * (3.0 * d[0] + t2 * (5.0 * d[1] + t2 * (7.0 * d[2] + 9.0 * t2 * d[3])));
        const double by = (fisheye_bent(d, theta) - r) / fmax(slope, LEAST_SLOPE);
        theta = fmin(fmax(theta - by, 0.0), WIDEST_RAD);
        if (fabs(by) < SAME_RAD) {
            break;
        }
    }
    const double per = r > ON_AXIS ? tan(theta) / r : 1.0;
    ray[0] = u * per;
    ray[1] = v * per;
    return theta;
}

void camera_project(const dl_lens *c, const double p[3], double uv[2])
{
    const double z = p[2] > NEAREST_PROJECTED_M ? p[2] : NAN;
    double xy[2] = {p[0] / z, p[1] / z};
    if (c->fisheye) {
        const double r = sqrt(xy[0] * xy[0] + xy[1] * xy[1]), per = r > ON_AXIS ? fisheye_bent(c->distortion, atan(r)) / r : 1.0;
        xy[0] *= per, xy[1] *= per;
    } else if (c->distorted) {
        distort(c->distortion, xy[0], xy[1], xy);
    }
    uv[0] = xy[0] * c->fx + c->cx;
    uv[1] = xy[1] * c->fy + c->cy;
}

void camera_ray(const dl_lens *c, double u, double v, double ray[2])
{
    const double x = (u - c->cx) / c->fx, y = (v - c->cy) / c->fy;
    if (c->fisheye) {
        fisheye_ray(c->distortion, x, y, fmin(sqrt(x * x + y * y), WIDEST_RAD), ray);
        return;
    }
    ray[0] = x;
    ray[1] = y;
    for (int step = c->distorted ? FIRST_STEPS : 0; step > 0; step--) {
        undistort_step(c->distortion, x, y, ray);
    }
}

/* Each pixel's solution starts where the two before it lead, so two steps are enough. */
static void undistorted_row(const double d[5], int n, const double u[2], double v, float *x, float *y)
{
    double before[2] = {0.0, 0.0}, last[2] = {0.0, 0.0};
    for (int i = 0; i < n; i++) {
        double at[2] = {u[0] + u[1] * i, v};
        if (i > 1) {
            at[0] = 2.0 * last[0] - before[0];
            at[1] = 2.0 * last[1] - before[1];
        }
        for (int step = i > 1 ? NEXT_STEPS : FIRST_STEPS; step > 0; step--) {
            undistort_step(d, u[0] + u[1] * i, v, at);
        }
        for (int k = 0; k < 2; k++) {
            before[k] = last[k];
            last[k] = at[k];
        }
        x[i] = (float)at[0];
        y[i] = (float)at[1];
    }
}

void camera_rays(const dl_lens *c, const frame_part *part, float *x, float *y)
{
    const double k = (double)(1 << part->level);
    const int w = (int)part->width, h = (int)part->height;
    for (int row = 0; row < h; row++, x += w, y += w) {
        const double v = (((double)(part->top + row) + 0.5) * k - 0.5 - c->cy) / c->fy;
        const double u[2] = {(((double)part->left + 0.5) * k - 0.5 - c->cx) / c->fx, k / c->fx};
        if (c->fisheye) {
            double theta = fmin(sqrt(u[0] * u[0] + v * v), WIDEST_RAD), ray[2];
            for (int i = 0; i < w; i++) {
                theta = fisheye_ray(c->distortion, u[0] + u[1] * i, v, theta, ray);
                x[i] = (float)ray[0], y[i] = (float)ray[1];
            }
            continue;
        }
        if (c->distorted) {
            undistorted_row(c->distortion, w, u, v, x, y);
            continue;
        }
        for (int i = 0; i < w; i++) {
            x[i] = (float)(u[0] + u[1] * i);
            y[i] = (float)v;
        }
    }
}

void add_focal_doubt(const dl_lens *c, const double t[3], double cov_pose[36])
{
    const double sigma_m = c->focal_sigma * t[2];
    cov_pose[2 * 6 + 2] += sigma_m * sigma_m;
}
