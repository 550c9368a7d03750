/* Registration of a pad's drawing with a frame. */
#ifndef DECKLANDER_REGISTER_H
#define DECKLANDER_REGISTER_H

#include "vision/register/state.h"
#include "vision/tracker.h"

/* Rows of floats, each as long as the largest number of pixels, that a registration works on. */
enum { FIT_ROWS = 148 };

/* The length of these rows: pixels of a small image, of profiles, or points of edges. */
int32_t register_row(int64_t edge_points);

/* Register the drawing of a tracker with a frame with so much noise, from a pose; returns whether the frame determines one. `outline`
 * takes the pixel of every fourth point of the edges. */
int register_pad(const dl_tracker *t, const dl_frame *frame, const dl_start *how, const dl_pad_pose *start, dl_registration *out, double *outline);

#endif
