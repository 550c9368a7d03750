/* The parts of a search for circles in a grey image. */
#ifndef DECKLANDER_SEARCH_H
#define DECKLANDER_SEARCH_H

#include "vision/tracker.h"

/* A grey image `step` times smaller than the frame, room for this many edges, the margin around it in which centres may lie, px, and
 * the plane that the pad is taken to lie in, at unit distance from the lens. */
typedef struct {
    int64_t width, height, stride, room, margin, step;
    double R_cam_plane[9];
} search_image;

/* Edges of an image: place, px, and the way from the edge to the centre of a circle of unit radius that is bright inside, px. */
typedef struct {
    int n;
    float *x, *y, *to_x, *to_y;
    /* The first edge of each row, and their number at the end. */
    int32_t *first;
} edge_list;

/* Edges that may belong to one circle, and where they meet the plane, (n, 2). */
typedef struct {
    int n;
    int32_t *edge;
    double *places;
} edge_choice;

/* The image in blocks: corners on the plane at unit distance, and the pixels per unit of the plane, (2, 2). */
typedef struct {
    int columns, rows;
    float *corners, *scale, *least;
} block_grid;

/* The most prominent circle of each tile of votes that is dark inside, and then that which is bright: neither hides the other. */
typedef struct {
    int columns, rows;
    float *score;
    int32_t *plane;
} vote_tiles;

/* What the scratch is divided into. */
typedef struct {
    int16_t *slope_x, *slope_y;
    uint16_t *strength;
    block_grid blocks;
    edge_list edges;
    /* Of one row: the least strength of an edge at each pixel, and where ridges are, with room for eight more. */
    int16_t *least;
    uint8_t *marks;
    uint8_t *votes;
    uint16_t *row;
    vote_tiles tiles;
    edge_choice chosen;
} search_rows;

/* A place of many votes. */
typedef struct {
    float x, y;
    int radius, bright_inside;
} vote_peak;

/* A circle in a plane at unit distance, and whether the plane's tilt is known. */
typedef struct {
    double R[9], centre[2], radius;
    int known;
} circle_stand;

/* Cells along a side of a tile, and floats of the scratch for an image; with a scratch, also the parts. */
enum { TILE_CELLS = 8 };
int64_t search_divide(const search_image *image, float *scratch, search_rows *out);

/* The largest number of floats of the scratch that a search takes in a frame of a size. */
int64_t search_most(int64_t width, int64_t height);

/* Outlines of areas as circles; as `dl_search_circles`. */
int32_t search_areas(const dl_tracker *t, const dl_frame *frame, const dl_circle_search *how, dl_circle *out);

/* The best heading of a drawing, as `dl_search_heading`. */
int search_heading(const dl_tracker *t, const dl_image *image, int32_t step, const dl_pad_pose *pose, const double *side, dl_polar_fit *out);

/* The cells of a ring that a shape of DL_POLAR_ANGLES shares covers. */
void search_shape(const double *shape, ring_shape *out);

/* Find the edges: ridges of the gradient that stand out from their neighbourhood. */
void search_edges(const search_image *image, const uint8_t *grey, const float *rays, search_rows *rows);

/* Where a pixel's ray meets the plane; returns whether it does. Beyond the image the outermost blocks go on. */
int search_place(const block_grid *blocks, float x, float y, double out[2]);

/* Pixels per unit of the plane at a pixel: the root of the scale of areas. */
float search_scale(const block_grid *blocks, float x, float y);

/* Let every edge vote for the centres of the circles that it may belong to, and rate the tiles. */
void search_votes(const search_image *image, const dl_circle_search *radii, search_rows *rows);

/* Take the most prominent peak that is left, with its tile; returns whether there is one. */
int search_peak(const search_image *image, search_rows *rows, vote_peak *out);

/* Fit a circle to the edges about a peak; returns whether there is one. */
int search_fit(const search_image *image, const dl_circle_search *radii, const search_rows *rows, const vote_peak *peak,
               dl_circle *out);

/* Where rays, (n, 2), meet a plane at unit distance, (n, 2); returns whether all do. */
int search_on_plane(int n, const double *rays, const double R_cam_plane[9], double *out);

/* The planes in which an outline of at most DL_SEARCH_SECTORS rays, (n, 2), is a circle; returns how many there are. */
int search_tilts(int n, const double *rays, circle_stand out[2]);

/* The parts of a search for blobs that stand out from their surroundings. */
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

/* The parts of the search for the strokes of an H. */
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
