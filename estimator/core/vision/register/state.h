/* The state of registration: the pad's pose and the blur, and what pixels look at.
 *
 * Increments are written in `pad`: t -> t + R dt, R -> R exp(dr). A pixel's ray meets the pad's plane at (x, y). With the camera at
 * (cx, cy) and height h above the plane, and with the ray's slopes k = (x - cx) / h against the plane's normal, the derivatives of
 * (x, y) are polynomials in x, y and k alone. */
#ifndef DECKLANDER_REGISTER_STATE_H
#define DECKLANDER_REGISTER_STATE_H

#include "decklander.h"

/* States: dt (3) m, dr (3) rad, blur xx, xy, yy px^2. `BY`: derivatives of a coverage, by x, y and the blur's xx, xy, yy. */
enum { STATES = 9, POSE = 6, BY = 5, LANES = 8 };

/* The largest number of profiles; that of pixels in the disc's image at which it is registered as a whole. */
enum { PROFILES = 120, DENSE_PIXELS = 1700 };
/* Standard deviation of an edge's place as predicted by drawing, lens and blur model, px. */
#define EDGE_SIGMA_PX 0.004

/* A pose, the blur at it, the size of a pixel on the pad, and the pad's depth. */
typedef struct {
    double R[9], t[3], blur_px2[3], m_per_px, depth_m;
} fit_state;

/* A fit: information and covariance in `pad`, and what else is told of it. */
typedef struct {
    int64_t dense, arrow_seen, doubted;
    double H[81], cov[81], noise_light, edge_rms_px, visible, inliers;
    fit_state state;
    dl_edge_support edges[DL_EDGE_KINDS];
} fit_solved;

/* Rows of floats of equal length, taken one after the other from memory of the caller. */
typedef struct {
    float *next;
    int32_t left, length;
} rows;

/* n, up to the next multiple of `LANES`. Rows are computed that far, and the weights of what lies beyond n are zero. */
static inline int whole_lanes(int n)
{
    return (n + LANES - 1) / LANES * LANES;
}

/* The next `count` rows; a null pointer if there is no room for them. */
float *take_rows(rows *r, int count);

/* Points on the pad that pixels look at, m, the slopes of their rays against its normal, and the squared ratio of their depth to
 * the reference depth. Rows are as long as those they were taken from. */
typedef struct {
    int n;
    float *x, *y, *k1, *k2, *m;
    double blur_m2[3], m2_per_px2;
} footprint;

/* The ray of a whole pixel; `rays` has them all if the lens distorts. */
void pixel_ray(const dl_lens *camera, const double *rays, int32_t u, int32_t v, double ray[2]);
/* p_cam = R p_pad + t for a point of the pad's plane. */
void in_camera(const fit_state *s, double x, double y, double p[3]);

/* The state at a pose, with the blur of a lens; its scale is that at the depth of the part of the pad that is in view. */
void begin_state(const dl_lens *camera, const double R[9], const double t[3], double blur_px, fit_state *s);
/* The standard deviation of the point spread with the pixel, mean over directions, px. */
double sigma_px(const fit_state *s);
/* The state for pixels k times as wide, with the blur that they and a smoothing of them add. */
fit_state reduced(const fit_state *s, int k, double smoothing_px2);
/* Undo `reduced`. The blur stays at least a pixel's, because a blur estimated in wide pixels may be less than they add. */
fit_state restored(const fit_state *s, int k, double smoothing_px2);
/* Apply an increment; the blur stays a covariance no smaller than a pixel's. */
fit_state moved(const fit_state *s, const double delta[STATES]);
/* The increment from a to b, which must be close to one another. */
void difference(const fit_state *a, const fit_state *b, double delta[STATES]);
/* What pixels with these rays look at. The rows of `f` are given. */
void look_at(const fit_state *s, const float *ray_x, const float *ray_y, footprint *f);
/* Convert derivatives by x, y and the blur in m^2, rows of `from`, to derivatives by the state, for the points from `begin` on. */
void by_state(const footprint *f, const float *const d[BY], int begin, int count, float *const J[STATES]);

#endif
