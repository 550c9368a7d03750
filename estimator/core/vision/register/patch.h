/* The pixels of a small image of the pad, reduced by a whole factor to a number that a dense fit can take. */
#ifndef DECKLANDER_REGISTER_PATCH_H
#define DECKLANDER_REGISTER_PATCH_H

#include "vision/register/state.h"

/* Variance that smoothing adds, px^2, and the fraction of independent noise's variance that remains after it. */
#define SMOOTHING_PX2 0.5
#define NOISE_LEFT (0.375 * 0.375)

enum { CHANNELS = 3, PATCH_ROWS = 8 };

typedef struct {
    int n, columns, lines;
    /* Side of a pixel in pixels of the full frame. */
    int reduced;
    float *ray_x, *ray_y;
    /* Smoothed linear light, 0 to 1, in blue, green, red. */
    float *light[CHANNELS];
    /* Position in the patch, -1 to 1 in both directions: light may change linearly across it. */
    float *slope[2];
    /* Indices of the pixels in the grid. Those far outside the disc are left out. */
    int32_t *at;
    /* The variance, over light, that the frame's noise beyond the usual leaves. */
    double noise;
    /* The state that it was cut for, with the blur in the units of its pixels. */
    fit_state state;
} patch;

/* Scratch memory of cutting a patch: light of all its pixels, and their rays. */
typedef struct {
    float *light;
    footprint *f;
} patch_work;

/* The frame and how it was taken. */
typedef struct {
    const dl_lens *camera;
    /* Rays of all pixels if the lens distorts, else null. */
    const double *rays;
    /* Pixel values in blue, green, red, and the linear light of each value. */
    const uint8_t *pixels;
    const float *light;
    /* The line beyond which rays do not count, as in `dl_start`. */
    const double *cut;
    /* The deviation of the frame's noise beyond the usual, as a fraction of a pixel's full scale. */
    double noise;
} view;

/* Cut out the part of the frame that holds the pad, `margin_px` reduced pixels beyond it, with at most DENSE_PIXELS; `r` keeps the
 * patch. Returns 0 if too little of the pad is in view. */
int cut_patch(const view *v, const dl_pad_shape *pad, const fit_state *s, double margin_px, rows *r, const patch_work *work,
              patch *out);

#endif
