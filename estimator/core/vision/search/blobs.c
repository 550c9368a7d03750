/* Search a frame for discs that stand out as blobs. */

#include <math.h>
#include <string.h>

#include "vision/search/search.h"
#include "vision/tracker.h"

enum { MOST = 64, PIXEL_WORK = 14, OUTLINE_WORK = 115000 };
/* Fraction of an ellipse's area at which an area is no support for a circle. */
static const double LEAST_FILLED = 0.9;
/* Noise of the half-size image, values of a pixel, per noise of the frame. */
static const double BYTE_NOISE_LEFT = 0.5 * 255.0;

/* The circle on the plane that an ellipse of the frame is; returns whether all of it can be seen there. */
static int circle_of(const dl_lens *c, const blob_image *image, const blob_ellipse *from, dl_circle *out)
{
    const double a = sqrt(from->M[0]), b = from->M[1] / a, d = sqrt(fmax(0.0, from->M[2] - b * b));
    double rays[2 * DL_SEARCH_SECTORS], places[2 * DL_SEARCH_SECTORS];
    memset(out, 0, sizeof *out);
    for (int k = 0; k < DL_SEARCH_SECTORS; k++) {
        const double turn = 2.0 * acos(-1.0) * k / DL_SEARCH_SECTORS, x = cos(turn), y = sin(turn);
        out->outline_px[2 * k] = from->centre[0] + a * x;
        out->outline_px[2 * k + 1] = from->centre[1] + b * x + d * y;
        camera_ray(c, out->outline_px[2 * k], out->outline_px[2 * k + 1], rays + 2 * k);
    }
    if (!search_on_plane(DL_SEARCH_SECTORS, rays, image->R_cam_plane, places)) {
        return 0;
    }
    for (int k = 0; k < 2 * DL_SEARCH_SECTORS; k++) {
        out->centre[k % 2] += places[k] / DL_SEARCH_SECTORS;
    }
    for (int k = 0; k < DL_SEARCH_SECTORS; k++) {
        out->radius += hypot(places[2 * k] - out->centre[0], places[2 * k + 1] - out->centre[1]) / DL_SEARCH_SECTORS;
    }
    out->points = DL_SEARCH_SECTORS;
    out->bright_inside = from->bright;
    out->support = fmin(1.0, fmax(0.0, (from->filled - LEAST_FILLED) / (1.0 - LEAST_FILLED)));
    return out->radius > 0.0;
}

int32_t search_areas(const dl_tracker *t, const dl_frame *frame, const dl_circle_search *how, dl_circle *out)
{
    blob_peak peaks[MOST];
    blob_ellipse one;
    blob_image within = {&frame->level[1], &frame->level[0], how->grey, how->most < MOST ? how->most : MOST,
                         BYTE_NOISE_LEFT * frame->quality.noise, {0.0}};
    int32_t found = 0;
    memcpy(within.R_cam_plane, how->R_cam_plane, sizeof within.R_cam_plane);
    const int n = within.most > 0 ? blob_peaks(&within, t->scratch, peaks) : 0;
    count_work(t, within.half->width * within.half->height, PIXEL_WORK);
    count_work(t, n, OUTLINE_WORK);
    for (int k = 0; k < n; k++) {
        found += blob_outline(&within, &peaks[k], &one) && circle_of(&t->camera.lens, &within, &one, &out[found]);
    }
    return found;
}
