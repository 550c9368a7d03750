/* Registration of a large image of the pad by profiles across its edges. */
#ifndef DECKLANDER_REGISTER_NEAR_H
#define DECKLANDER_REGISTER_NEAR_H

#include "vision/register/far.h"
#include "vision/register/profiles.h"

/* The rows of a fit by profiles. */
typedef struct {
    footprint f;
    round_points round;
    /* Light through the channels' mix; coverage by the paint inside and its derivatives; derivatives of the light by the state; change
     * of the coverage as the edge moves outward by a pixel; residual; inverse of its variance; weight over variance; robust weight. */
    float *mixed, *value, *d[BY], *J[STATES], *Jw[STATES], *per_px, *residual, *per_var, *w, *weight;
    float *spare[3];
} near_rows;

/* Weights of the colour channels that separate the two paints of each kind of edge best, so that the contrast is 1; the contrast. */
typedef struct {
    double mix[DL_EDGE_KINDS][CHANNELS], contrast[DL_EDGE_KINDS][CHANNELS];
} channel_mix;

/* What a linearisation finds of a group: light outside, contrast in units of its kind's, whether it counts, the covariance of both
 * levels, sums of weighted derivatives and of them times coverage, and the change of the levels that best compensates a change of
 * the state. */
typedef struct {
    double outside, contrast, inverse[3], sums[2][STATES], levels[2][STATES];
    int accepted;
} group_fit;

/* A linearisation: information, gradient, the variance of each kind's pixels outside and inside of its edges, and their mean. */
typedef struct {
    double H[STATES * STATES], g[STATES], noise[DL_EDGE_KINDS][2], mean_noise[DL_EDGE_KINDS];
    int has_noise;
    group_fit groups[GROUPS_MAX];
} near_fit;

/* The coverage at a state by the paint inside each pixel's edge; `f` is looked at already if `looked`. */
void cover_profiles(const dl_pad_shape *pad, const fit_state *s, const profiles *p, int looked, near_rows *d);
void mix_channels(const dl_pad_shape *pad, const profiles *p, const near_rows *d, channel_mix *out);
/* Compute a linearisation at the state of `cover_profiles`. */
void linearise_profiles(const profiles *p, near_rows *d, near_fit *fit);
/* The residuals that the linearisation predicts after a step, and the noise on either side of the edges that they show. */
void noise_after(const profiles *p, const double delta[STATES], near_rows *d, near_fit *fit);
/* The amplitude of the pointer beyond the ring, and its sigma; 1 is a whole one, and sigma is infinite where it is out of view. */
void pointer_amplitude(const dl_pad_shape *pad, const fit_state *s, const profiles *p, near_rows *d, double *amplitude, double *sigma);

int take_near_rows(rows *r, near_rows *d, profiles *p);
/* Register from a state; 0 if too little of the pad is in view, or if the frame does not determine a pose. Where edges merged on the
 * way, `out->state` says so by its blur. */
int register_near(const fit_task *k, const fit_state *start, fit_solved *out);

/* Add the covariance of a pose whose picture a codec has moved by patches: each by `sigma_px` along both of the frame's axes. The fit
 * is taken to weigh all edges in the frame alike, by their length. All are in `cam`; `with_prior` is the covariance of a fit with this
 * information of the frame and the prior. */
void add_coded(const dl_lens *camera, const edge_points *edges, const fit_state *pose, double sigma_px,
               const double information[POSE * POSE], const double with_prior[POSE * POSE], double cov[POSE * POSE]);

#endif
