/* Dense registration of a small image of the pad: every pixel is fitted with the whole drawing and all paints at once.
 *
 * It serves a distant pad, whose edges are so close that they merge in the blur. The paints, which are linear unknowns, are
 * eliminated in each linearisation (variable projection: Golub, Pereyra, SIAM J. Numer. Anal. 10, 1973). */
#ifndef DECKLANDER_REGISTER_DENSE_H
#define DECKLANDER_REGISTER_DENSE_H

#include "vision/register/coverage.h"
#include "vision/register/patch.h"
#include "vision/register/sums.h"

/* A reflection of the sun on the distant pad: added light, flat in the middle and soft at the rim.
 *
 * The added light is estimated together with the paints, so that it biases no edge. Its position and width are chosen from a few
 * candidates by the fraction of the residuals they explain, and then follow its gradients from one linearisation to the next. */
/* Light in the middle, and its derivatives by x, y and the radius. */
enum { GLARE_COLUMNS = 4 };

/* Position and width of a reflection on the pad, m; a radius of 0 for none. */
typedef struct {
    double x, y, radius;
} glare;

/* The light of a reflection of strength one at each point, and its derivatives, per metre. */
void glare_columns(const glare *g, const footprint *f, float *const columns[GLARE_COLUMNS]);
/* The reflection moved by the amplitudes of its columns. */
glare glare_moved(const glare *g, const double amplitudes[GLARE_COLUMNS], double disc_radius_m);
/* The reflection that explains most of what the paints leave, radius 0 if none explains enough. `weight` and `residual` are by
 * channel; `values` are the regressors of `k` paint coefficients; `spare` are GLARE_SPARE rows that are written over. */
enum { GLARE_SPARE = 3 + GLARE_COLUMNS + 3 + DL_PAD_CONTRASTS };
glare glare_found(const footprint *f, float *const residual[CHANNELS], float *const weight[CHANNELS], int k, float *const *values,
                  double disc_radius_m, float *const spare[GLARE_SPARE]);

/* Coefficients before those of the regions: the surroundings' light and its change across the patch. */
enum { FIRST_REGION = 3, DENSE_SPARE = 33 };

/* Factor by which residuals may exceed the noise expected from the frame: that noise is an estimate. */
#define NOISE_DOUBT 1.5

/* The rows of a dense fit. */
typedef struct {
    footprint f;
    round_points round;
    /* The regressor of each coefficient, and the derivatives of the regions'. */
    float *values[COEFFICIENTS_MAX], *changes[DL_PAD_CONTRASTS][BY];
    /* By channel: light that pose and paints explain; squared change of that light over a pixel across the steepest edge; robust
     * weight; light plus what a dark sensor's noise amounts to; variance of the light from the edges' places; weight over variance;
     * light left over; light that a reflection adds; whether a pixel sets the scale of the noise. */
    float *model[CHANNELS], *steep2[CHANNELS], *weight[CHANNELS], *level[CHANNELS], *unsharp[CHANNELS], *w[CHANNELS], *residual[CHANNELS];
    float *added[CHANNELS], *judged[CHANNELS];
    float *spare[DENSE_SPARE];
} dense_rows;

/* Displacements of the drawing's sectors, an eighth of a turn each: outward, and around the centre. */
enum { SECTOR_MOVES = 16 };

/* One linearisation. */
typedef struct {
    /* Information with the paints eliminated, gradient, and the gradient's covariance from the residuals. */
    double H[STATES * STATES], g[STATES], gradient_cov[STATES * STATES];
    /* The effect on the gradient of a sector that lies a pixel aside, what the residuals say of its place, and the information on it;
     * only of the last linearisation. */
    double pull[SECTOR_MOVES][STATES], score[SECTOR_MOVES], known[SECTOR_MOVES];
    /* Light of the coefficients and its variances, by channel; the variances only of the last linearisation. */
    double paints[FIRST_REGION + DL_PAD_CONTRASTS][CHANNELS], var_paints[FIRST_REGION + DL_PAD_CONTRASTS][CHANNELS];
    /* Robust variance of light over light, and that of the pixels that show the pad alone; the latter only of the last linearisation. */
    double noise, noise_on_pad;
    glare reflection;
} dense_fit;

/* Sums of one linearisation, by channel: coefficients of the paints, regions, coefficients with a reflection's. */
typedef struct {
    int k, regions, total;
    double M[CHANNELS][COEFFICIENTS_MAX * COEFFICIENTS_MAX], a[CHANNELS][COEFFICIENTS_MAX], spent[CHANNELS];
    /* Products of derivatives by state and coefficient, and the coefficients' best answer to a change of the state. */
    double C[CHANNELS][STATES * COEFFICIENTS_MAX], answer[CHANNELS][COEFFICIENTS_MAX * STATES];
} dense_sums;

/* The rows of a fit; 0 if there is no room for them. */
int take_dense_rows(rows *r, dense_rows *out);
/* Compute a linearisation. `first`: there was none before that sets the scale of the residuals, so all weigh fully. `last`: also
 * compute the covariances. Returns 0 if the pixels do not determine the paints. */
int linearise_dense(const dl_pad_shape *pad, const patch *cut, const fit_state *s, int first, int last, dense_rows *d, dense_fit *fit);

/* The derivatives of a block of a channel's light by the state, plain and weighted; notes the light's squared change over a pixel. */
void dense_derivatives(const dense_rows *d, const dense_sums *s, int c, int start, int length, float m_per_px2,
                       float J[STATES][SUM_BLOCK], float Jw[STATES][SUM_BLOCK]);
/* Add the gradient's covariance from the residuals of all channels, and find the variances of the paints. */
int add_gradient_covariance(const dl_pad_shape *pad, const patch *cut, float m_per_px2, dense_rows *d, const dense_sums *s, dense_fit *fit);
/* Add the effect on the gradient of displaced sectors by a block of a channel's pixels: its derivatives along the pad's axes, and the
 * projected scores of all pixels. */
void add_sectors(const dense_rows *d, int c, int start, int length, const float along[][SUM_BLOCK],
                 float *const projected[STATES], float m_per_px, dense_fit *fit);
/* Add to the gradient's covariance sectors that are displaced independently, and all of them outward alike by the size's sigma. */
void displace_sectors(double size_px, dense_fit *fit);

#endif
