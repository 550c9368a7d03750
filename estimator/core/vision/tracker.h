/* What follows one pad in the frames of one camera: its drawing, and the memory that vision works in. */
#ifndef DECKLANDER_TRACKER_H
#define DECKLANDER_TRACKER_H

#include "decklander.h"

#include <stddef.h>

/* Contrast over its deviation from which a kind of edge is seen. */
#define SNR_SEEN 5.0
/* Cosine between the contrast and that of the pad's paints from which it is. With the white balance off by 20 % and light of 3000 K,
 * white against green and orange against green stay above 0.8. */
#define LIKENESS_SEEN 0.4

/* The cells of a ring that a shape covers, and their shares; half of them where half a turn brings the shape onto itself. */
typedef struct {
    int n, turns, cell[DL_POLAR_ANGLES];
    float share[DL_POLAR_ANGLES];
} ring_shape;

struct dl_tracker {
    dl_camera camera;
    const double *rays;
    /* The light of each value of a pixel: linear, its root, its logarithm; full scale 65535. */
    float lights[3 * 256];
    uint16_t lamp_light[256];
    int has_drawing;
    dl_pad pad;
    ring_shape lettering[DL_POLAR_RADII], arrow[DL_POLAR_RADII];
    const int16_t *maps, *local_maps;
    const double *edges;
    const int32_t *edge_of;
    /* The length of the rows that registration works on, and of the scratch and of the room for parts of reduced frames. */
    int32_t row;
    int64_t floats, part_bytes;
    float *scratch;
    uint8_t *parts;
    /* Where the entries count their work; and where they do if nobody wants to know. */
    int64_t *work, uncounted;
};

/* Count the work on so many things, `each` of them some millionths of a floor. */
static inline void count_work(const dl_tracker *t, int64_t things, int64_t each)
{
    *t->work += things * each;
}

/* A part of one level of a frame, px of that level. */
typedef struct {
    int64_t level, left, top, width, height;
} frame_part;

/* The pixels of a part, and the number of bytes from row to row. */
typedef struct {
    frame_part part;
    const uint8_t *px;
    int32_t stride;
} seen_part;

/* The limit of a frame's sides, px: what is larger is a mistake. */
enum { FRAME_SIDE_MAX = 16384 };

static inline int lies_within(int64_t value, int64_t least, int64_t most)
{
    return value >= least && value <= most;
}

/* Whether an image has pixels of this many channels in rows that do not overlap, and no more of them than 32 bits count. */
int is_image(const dl_image *image, int channels);

/* Whether a frame is of the tracker's camera, its rows one after the other, and of the right size at every size that was made. */
int is_frame(const dl_tracker *t, const dl_frame *frame);

/* A pinhole camera with Brown's distortion, or a fisheye: points to pixels, and pixels to rays. */
/* The pixel of a point in `cam`, px; nan at or behind the lens. */
void camera_project(const dl_lens *c, const double p[3], double uv[2]);

/* The ray (x/z, y/z) of a place in the frame, px. */
void camera_ray(const dl_lens *c, double u, double v, double ray[2]);

/* x/z and y/z of the pixels of a part of a frame, row by row. */
void camera_rays(const dl_lens *c, const frame_part *part, float *x, float *y);

/* Add what an uncertain focal length does to the covariance of a pose, (6, 6): if it is too long, the depth is by the same share. */
void add_focal_doubt(const dl_lens *c, const double t[3], double cov_pose[36]);

#endif
