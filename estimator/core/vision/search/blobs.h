/* The parts of a search for blobs that stand out from their surroundings. */
#ifndef DECKLANDER_BLOBS_H
#define DECKLANDER_BLOBS_H

#include "vision/tracker.h"

/* A BGR image of half the frame's size and the frame itself; whether all channels are equal; the largest number of blobs; the noise's
 * standard deviation in the half-size image, values of a pixel; and the plane that the pad is taken to lie in. */
typedef struct {
    const dl_image *half, *full;
    int64_t grey, most;
    double noise, R_cam_plane[9];
} blob_image;

/* Sizes that blobs are looked for at: half the sides of their boxes, px of the image at half size, all even. */
enum { BLOB_SIZES = 3 };
extern const int BLOB_HALF[BLOB_SIZES];

/* A place that differs from its surroundings, px of the image at half size. */
typedef struct {
    double score;
    int x, y, size;
} blob_peak;

/* The ellipse with the area's second moments: its centre and M with (x - c)' M^-1 (x - c) = 1 on its outline, px of the frame. */
typedef struct {
    double centre[2], M[3], filled;
    int bright;
} blob_ellipse;

/* Numbers of the scratch that `blob_peaks` needs. */
int64_t blob_room(const dl_image *half);

/* Find the places that differ most from their surroundings, best first; returns how many, at most `image->most`. */
int blob_peaks(const blob_image *image, float *scratch, blob_peak *out);

/* Find the outline of the area about a peak that differs from its surroundings; returns whether there is one that is closed. */
int blob_outline(const blob_image *image, const blob_peak *peak, blob_ellipse *out);

#endif
