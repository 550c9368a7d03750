/* Gauss-Newton steps of registration with the priors: tilt from the attitude and a nearly level deck. */
#ifndef DECKLANDER_REGISTER_SOLVER_H
#define DECKLANDER_REGISTER_SOLVER_H

#include "vision/register/state.h"

/* Standard deviation of the prior of the blur's covariance about its start, px^2; it holds the blur if no edge shows it. */
#define WEAK_BLUR_PX2 3.0

/* The pad's normal in `cam` as predicted by the attitude and a nearly level deck, with the covariance of the small rotation between
 * prediction and truth, rad^2; only the part across the normal matters. */
typedef struct {
    int given;
    double normal[3], cov[9];
} tilt_target;

/* The values that the weak priors are centred on. `distant`: all of the pad lies along one line of sight. */
typedef struct {
    int distant;
    tilt_target tilt;
    double blur_px2[3], free[STATES], reach_m;
} solver;

void predict_tilt(const dl_lens *camera, const dl_tilt_prior *prior, tilt_target *out);
void begin_solver(const fit_state *s, const tilt_target *tilt, double disc_radius_m, solver *out);
/* The next state and the motion in the frame, px; a step beyond the limit is shortened. The blur holds unless `blur_too`. Returns 0
 * if the sums determine no step. */
int step_state(const solver *v, const fit_state *s, const double H[STATES * STATES], const double g[STATES], double limit_px,
               int blur_too, fit_state *next, double *moved_px);
/* The way from the camera to the pad's centre in the pad's axes, one long along its normal. */
void line_of_sight(const fit_state *s, double along[3]);
double motion_px(const solver *v, const fit_state *s, const double delta[STATES]);
/* inv(H + the priors' information); 0 if it is singular. */
int covariance_of(const solver *v, const fit_state *s, const double H[STATES * STATES], double cov[STATES * STATES]);

#endif
