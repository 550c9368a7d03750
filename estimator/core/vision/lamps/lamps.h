/* A pad's lamps: the bright spots of a dark frame, which of them are which lamps, and the pose that they give. */
#ifndef DECKLANDER_LAMPS_H
#define DECKLANDER_LAMPS_H

#include "vision/tracker.h"

/* Least depth of a lamp, m. */
#define NEAREST_LAMP_M 0.02
#define LAMPS_PI 3.14159265358979323846

/* The most rows of pixels that the bright places of a frame are made of: a dark deck with as many lights as a pad may have, and
 * each of them as near as the camera comes, has less. */
enum { BRIGHT_RUNS = 4096 };

/* The numbers of four bytes that the search of a frame works on. */
int64_t lamps_room(const dl_lens *camera);

/* A part of a frame, BGR, and the linear light of each value of a pixel. */
typedef struct {
    const uint8_t *px;
    const uint16_t *light;
    int stride, left, top, width, height;
} lit_part;

/* Centre of brightness, px of the frame, its standard deviation, alike in both directions, and the radius of a disc of the spot's
 * area. */
typedef struct {
    double uv[2], sigma, radius;
} lamp_spot;

/* The brightest first. */
typedef struct {
    int n;
    lamp_spot spot[DL_LAMP_SPOTS_MAX];
} lamp_spots;

/* A row's bright pixels in one piece, of the part: row, first and last column. */
typedef struct {
    int32_t row, first, last, root;
} bright_run;

/* What is bright in a part of a frame: brightness above the surroundings, and pieces of the rows that stand out. */
typedef struct {
    int width, height, pitch, runs;
    double noise;
    const uint16_t *smooth;
    bright_run *run;
} bright_part;

/* Lamps of a pad at a pose, and the spot of each, -1 for none. Lamps that the frame does not resolve make one spot. */
typedef struct {
    int32_t spot[DL_LAMPS_MAX];
    /* Number of spots that lamps explain, of those that the lamps in view would make, and of others about the pad; the area of the
     * pad's surroundings in the frame, px^2. */
    int groups, expected, outliers;
    double area_px2;
} lamp_assignment;

/* A pose, the covariance of its place and of a small rotation in `cam`, and how far each spot with a lamp is from its lamps: px, and
 * the middle one in its standard deviations. `extent_px` is the largest distance of these spots from their middle. */
typedef struct {
    dl_pad_pose pose;
    double cov[36], off_px[DL_LAMP_SPOTS_MAX], middle_sigmas, extent_px;
} lamp_fit;

/* The room that the bright places of a part take, numbers of four bytes. */
int64_t bright_room(int64_t width, int64_t height);
/* What is bright in a part; 0 if it has more pieces than `BRIGHT_RUNS`. */
int bright_places(const lit_part *part, uint32_t *scratch, bright_part *out);
/* The spots that the pieces make: pieces that are cut by the part's edge, too large or too long are left out. */
void spots_of(const bright_part *part, const lit_part *of, lamp_spots *out);

/* A point of the pad's plane in `cam`, m. */
void pad_point(const dl_pad_pose *pose, double x, double y, double p[3]);
/* Assign the lamps in view to the nearest spots. `reach_px` is the largest distance of a lamp from its spot's centre, or of the
 * lamps that share a spot from it on average. */
void assign_lamps(const dl_lens *camera, const dl_lamp_pattern *pad, const lamp_spots *spots, const dl_pad_pose *pose, double reach_px,
                  lamp_assignment *out);
/* The pose at which the assigned lamps lie in their spots; 0 if they do not determine one. */
int fit_lamps(const dl_lens *camera, const dl_lamp_pattern *pad, const dl_tilt_prior *prior, const lamp_spots *spots,
              const lamp_assignment *of, const dl_pad_pose *start, lamp_fit *out);

enum { LAMP_GUESSES = 6 };
/* The room that guesses take, numbers of four bytes. */
int64_t guess_room(void);
/* Poses that two spots give, those that explain the most spots first; returns their number. */
int guess_lamps(const dl_lens *camera, const dl_lamp_pattern *pad, const dl_tilt_prior *prior, const lamp_spots *spots, uint32_t *scratch,
                dl_pad_pose out[LAMP_GUESSES]);

/* Number of poses that are tried. */
double guesses_tried(const dl_lamp_pattern *pad, const lamp_spots *spots);

/* R_level_cam */
void level_of_camera(const dl_lens *camera, const dl_tilt_prior *prior, double R[9]);

#endif
