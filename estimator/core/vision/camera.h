/* A pinhole camera with Brown's distortion, or a fisheye: points to pixels, and pixels to rays. */
#ifndef DECKLANDER_CAMERA_H
#define DECKLANDER_CAMERA_H

#include "vision/tracker.h"

/* The pixel of a point in `cam`, px; nan at or behind the lens. */
void camera_project(const dl_lens *c, const double p[3], double uv[2]);

/* The ray (x/z, y/z) of a place in the frame, px. */
void camera_ray(const dl_lens *c, double u, double v, double ray[2]);

/* x/z and y/z of the pixels of a part of a frame, row by row. */
void camera_rays(const dl_lens *c, const frame_part *part, float *x, float *y);

/* Add what an uncertain focal length does to the covariance of a pose, (6, 6): if it is too long, the depth is by the same share. */
void add_focal_doubt(const dl_lens *c, const double t[3], double cov_pose[36]);

#endif
