/* The parts of aligning a pad's drawing with a frame.
 *
 * Numbers of samples lie in one row for each quantity, padded with zeros to whole groups of SAMPLE_LANES samples.
 */
#ifndef DECKLANDER_ALIGN_H
#define DECKLANDER_ALIGN_H

#include <math.h>

#include "base/vectors.h"
#include "vision/tracker.h"

/* Standard deviation of a lens' blur, px. */
#define LENS_BLUR_PX 0.7
/* Standard deviation of a pixel's own square, px. */
#define PIXEL_SIGMA 0.29
/* Least depth of the pad's centre, m. */
#define LEAST_DEPTH_M 0.02
/* Weight of a paint of no light, per sample: a paint that is not in view is dark. */
#define RIDGE 1e-4

enum {
    /* The widest neighbourhood of a pixel whose mean light is subtracted, px to either side. */
    LOCAL_MAX = 128,
    /* Samples are handled in groups of this many, and their rows are as long as whole groups. */
    SAMPLE_LANES = 8,
    /* Largest number of samples in the disc's bounding box during a search, on the way to a registration, and for verification. */
    SEARCH_SAMPLES = 700,
    APPROACH_SAMPLES = 1000,
    FINAL_SAMPLES = 2600,
    /* Steps of Gauss and Newton on the way to a registration. */
    APPROACH_STEPS = 6,
};
/* The verification's features, in the order of FEATURES in estimator.vision.detect.verification, which describes them. */
enum align_feature {
    FEATURE_ONE, FEATURE_H_MARKING, FEATURE_RING, FEATURE_EDGE, FEATURE_H_MARKING_ALL, FEATURE_RING_ALL, FEATURE_EDGE_ALL,
    FEATURE_H_AND_RING, FEATURE_H_AND_EDGE, FEATURE_RING_AND_EDGE, FEATURE_TWO_OF_THREE, FEATURE_SOME_RING, FEATURE_SOME_EDGE,
    FEATURE_SOME_TWO, FEATURE_H_ALONE, FEATURE_NO_H, FEATURE_NO_RING, FEATURE_NO_EDGE, FEATURE_RING_LAGS, FEATURE_FLANKS,
    FEATURE_ARROW, FEATURE_NO_ARROW, FEATURE_TEMPLATE_GAIN, FEATURE_INLIERS, FEATURE_WHITE, FEATURE_ORANGE_PLACE,
    FEATURE_ORANGE_ODD, FEATURE_DISC_PLACE, FEATURE_SIZE, FEATURE_IN_VIEW, FEATURE_TILT,
};
enum { PAINT_H = 0, PAINT_ORANGE = 1, PAINT_DISC = 2, PAINT_AROUND = 3 };
/* Radius of the surroundings that count, in radii of the disc. */
#define AROUND_RADII 1.12

static inline double clipped(double x, double low, double high)
{
    return fmin(high, fmax(low, x));
}

/* The pixels of a part of a frame as light. */
typedef struct {
    int n;
    /* Side of a pixel on the pad, m. */
    double side_m;
    float *x, *y;
    /* Linear light, and the square root of light minus its mean in the neighbourhood. */
    float *light[3], *local[3];
    /* 1 where a pixel is used, else 0; and room for a row with LOCAL_MAX pixels at either end. */
    float *trust, *wide;
} pixels;

/* The pixels on or near the disc for one pose: the first n of `samples_rows`. */
typedef struct {
    int n, room;
    float *light[3], *coverage[4], *slope_x[4], *slope_y[4];
    /* Position on the pad, m, and the ray in `pad` over its depth. */
    float *x, *y, *a, *b;
    float *weight, *residual[3], *squared;
    /* Which pixel of the part it is. */
    int32_t *pixel;
    uint32_t *spare;
} samples;

/* The paints that fit best, (4, 3), and the spread of the residuals. */
typedef struct {
    float paints[4][3];
    double spread;
} painted;

/* Sums over samples of their numbers, coverage (4), light (3) and one: times each coverage, then as they are, then squared. */
enum { SUM_ONCE = 4, SUM_SQUARED = 5, SUM_ROWS = 6 };
typedef float8 fit_sums[SUM_ROWS];

/* The part of a level that shows the disc, with about as many samples as are requested; returns whether it is large enough. */
int align_view(const dl_lens *c, const dl_pad_template *p, const dl_pad_pose *pose, int32_t most, frame_part *out);

/* The part of a level that shows the arrowhead. */
void align_arrow_view(const dl_lens *c, const dl_pad_template *p, const dl_pad_pose *pose, frame_part *out);

/* The light of a part; `with_local` also makes `local`. What is in `spare`, 6 rows, is lost. */
void align_light(const dl_tracker *t, const seen_part *part, double depth_m, int with_local, float *spare, pixels *out);

/* Move a pose by steps of Gauss and Newton in a frame with so much noise; returns whether it is good. */
int align_move(const dl_tracker *t, const seen_part *seen, const dl_alignment *how, double noise, dl_pad_pose *pose, double *tilt_sigmas);

/* Fit the paints at a pose to the part that shows the disc, and measure the evidence for the pad there and in the part that shows the
 * arrowhead; `tilt_sigmas` in `out` stays. Returns whether enough of the pad is in view. */
int align_fit(const dl_tracker *t, const seen_part seen[2], const dl_pad_pose *pose, const double cut[3], const dl_quality *of,
              dl_aligned_pad *out);

/* Find the line beyond which most probably something covers the pad; returns whether there is one. */
int align_cover(const dl_tracker *t, const seen_part *seen, const dl_pad_pose *pose, dl_cover_line *out);

/* The samples for one pose, with their coverage, and its slopes on request; the light is linear or local. Returns whether there are
 * enough of them. */
int align_samples(const dl_pad_template *p, const int16_t *map, const pixels *from, const dl_pad_pose *pose, int slopes, samples *out);

/* Coverage of each sample. */
void align_coverage(const dl_pad_template *p, const int16_t *map, samples *s);

/* The cell of a map before a position, with a cell before it and two behind, and the way to the next. */
static inline int align_cell(const dl_pad_template *p, float at_m, float *ahead)
{
    const float at = at_m * (float)p->per_m + (float)(p->n / 2), last = (float)(p->n - 3);
    const float inside = at > 1.0f ? at < last ? at : last : 1.0f;
    const int cell = (int)inside;
    *ahead = inside - (float)cell;
    return cell;
}

/* Coverage at a position on the pad. */
static inline float4 align_map_at(const dl_pad_template *p, const int16_t *map, float x, float y)
{
    float across, along;
    const int n = (int)p->n, i = align_cell(p, x, &along), j = align_cell(p, y, &across);
    const int16_t *cell = map + 4 * (i * n + j);
    const float4 here = four_between(cell, cell + 4, across), next = four_between(cell + 4 * n, cell + 4 * n + 4, across);
    return (here + along * (next - here)) * (1.0f / DL_TEMPLATE_ONE);
}

/* Trust the pixels on this side of a cut; returns their number. */
int align_trust(const double cut[3], pixels *from);

/* The light of the samples. */
void align_take(float *const light[3], samples *s);

/* One map: that of a blur. */
const int16_t *align_map(const dl_pad_template *p, const int16_t *maps, int blur);

/* The blur nearest to a standard deviation, m. */
int align_blur(const dl_pad_template *p, double sigma_m);

/* The blur nearest to that of the frame's samples. */
int align_blur_at(const dl_lens *c, const dl_pad_template *p, double side_m, double depth_m);

/* Fit the paints from the weights of the samples, which it replaces. */
int align_paint(samples *s, int final, painted *out);

double align_sum(const float8 *lanes);

/* The fraction of the light's weighted variance that the model explains, without what noise of a variance adds to it. */
double align_explained(const samples *s, double noise_var);

/* Add a sample's numbers to their sums. */
static inline void align_add(const samples *s, int i, fit_sums to)
{
    const float8 number = {s->coverage[0][i], s->coverage[1][i], s->coverage[2][i], s->coverage[3][i],
                           s->light[0][i],    s->light[1][i],    s->light[2][i],    1.0f};
    for (int k = 0; k < SUM_ONCE; k++) {
        to[k] += number[k] * number;
    }
    to[SUM_ONCE] += number;
    to[SUM_SQUARED] += number * number;
}

/* The sums of several samples together. */
void align_total(int n, fit_sums *of, fit_sums out);

/* How many samples there are in the sums. */
double align_number(const fit_sums of);

/* The light's variation that one colour leaves. */
double align_varied(const fit_sums of);

/* The light's variation that least-squares paints leave. */
double align_unexplained(const fit_sums of);

/* Start the weights: 1, or next to nothing on a half of the disc that something covers. */
void align_uncovered(samples *s);

/* One of eight sectors around the centre, from 0 to 7, against the sense of x to y from -x. */
int align_sector(float x, float y);

/* Support for the arrowhead at both of its places: found, seen, clear. */
void align_arrow(const dl_tracker *t, const seen_part *seen, const dl_pad_pose *pose, const float paints[4][3], double noise,
                 double out[6]);

/* The features of the verification. */
void align_features(const dl_pad_template *p, const samples *s, const painted *local, const double brightest_h[3], const dl_quality *of,
                    dl_aligned_pad *out);

/* How much the drawing explains of samples whose local light was fitted. */
void align_support(const dl_pad_template *p, const samples *s, int blur, double side_m, const dl_quality *of, dl_drawing_support *out);

/* Divide the scratch into the rows of a part's pixels and samples; returns the numbers that they take. */
int64_t align_divide(int64_t width, int64_t height, float *scratch, pixels *from, samples *s);

#endif
