/* The parts of the search for the strokes of an H. */
#ifndef DECKLANDER_STROKES_H
#define DECKLANDER_STROKES_H

#include "vision/tracker.h"

/* A BGR image `step` times smaller than the frame, whether the marks are bright in it, and the plane that the pad is taken to lie in. */
typedef struct {
    int64_t width, height, stride, step, bright, plane_known;
    double R_cam_plane[9];
} strokes_image;

/* Places that are kept for each of two headings, and in all. */
enum { STROKES_BEST = 3, STROKES_PLACES = 2 * STROKES_BEST };

/* The frame seen from straight above, the H's strokes along its sides: pixels to the plane at unit distance and to the frame. */
typedef struct {
    int size;
    double turn, focal, to_plane[9], to_frame[9];
} upright_view;

/* A place of the H in an upright view: its centre, px, and whether its legs lie across. */
typedef struct {
    float score, x, y;
    int across;
} stroke_place;

/* The numbers of the scratch that an image takes. */
int64_t strokes_room(int64_t width, int64_t height);

/* Side of the upright view of an image, px. */
int64_t strokes_size(const strokes_image *image);

/* The darkest channel of each pixel, (height, width); with dark marks that of the negative. */
void strokes_darkest(const strokes_image *image, const uint8_t *px, uint8_t *out);

/* One or two shades that separate marks from their surroundings. Returns how many. */
int strokes_limits(int n, const uint8_t *grey, int limits[2]);

/* The angle in the frame, modulo 90 degrees, that most strong gradients have. Returns whether there are enough. */
int strokes_direction(int w, int h, const uint8_t *grey, double *angle);

/* The upright view for a direction in the frame; returns whether the plane can be seen. */
int strokes_place(const dl_lens *c, const strokes_image *image, double angle, upright_view *out);

/* The upright view of a grey image; -1 outside of the frame. */
void strokes_upright(const strokes_image *image, const upright_view *view, const uint8_t *grey, int16_t *out);

/* The commonest widths of strokes in a mask of 1, -1 and 0 outside of the frame, px. Returns how many, at most two. */
int strokes_widths(int n, const int8_t *mask, int32_t *starts, double widths[2]);

/* Find the best places of an H with strokes of a width in a mask, best first for each heading. Returns how many. */
int strokes_fit(const dl_pad_strokes *h, int n, const int8_t *mask, double width, int32_t *sums, float *score, stroke_place out[STROKES_PLACES]);

/* Room for the sums of a mask, in numbers. */
int64_t strokes_sums(int64_t n);

#endif
