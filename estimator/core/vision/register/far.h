/* Registration of a distant pad as a whole, and the pointer of the drawing that distinguishes its two headings. */
#ifndef DECKLANDER_REGISTER_FAR_H
#define DECKLANDER_REGISTER_FAR_H

#include "vision/register/dense.h"
#include "vision/register/profiles.h"
#include "vision/register/solver.h"

/* Everything that a fit starts from. */
typedef struct {
    view seen;
    const dl_pad_shape *pad;
    edge_points edges;
    tilt_target tilt;
    /* Standard deviations of the painted sizes, m, and of the place of a patch that a video codec has moved, px. */
    double size_sigma_m, coded_px;
    rows free;
    /* Work done, as the tracker counts it. */
    int64_t *work;
} fit_task;

/* Amplitude of the drawing's pointer at its place and at the opposite one, 1 is a whole pointer, and the deviation of either. */
typedef struct {
    double here, there, sigma;
} pointer;

/* Whether an amplitude exceeds the one at the opposite place clearly enough for a certain heading. */
int stands_out(double amplitude, double opposite, double sigma);
/* The number of kinds of edges that the pad has. */
int kinds_drawn(const dl_pad_shape *pad);

/* The support for a pointer of this amplitude; 1 is nominal. */
dl_edge_support pointer_support(double amplitude, double sigma, const double contrast[CHANNELS], double in_view);

/* Whether a kind of edge is clearly there, and of its paint. */
int support_is_seen(const dl_edge_support *e);

/* Register from a state; 0 if too little of the pad is in view, or if the frame does not determine a pose. */
int register_far(const fit_task *k, const fit_state *start, fit_solved *out);
/* Whether the pointer is seen at the opposite of its place and not there. */
int is_opposite(const fit_task *k, const fit_state *s);

#endif
