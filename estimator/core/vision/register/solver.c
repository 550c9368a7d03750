/* Step a state by its normal equations with the prior of the tilt, and compute its covariance. */

#include "vision/register/solver.h"

#include <math.h>
#include <string.h>

#include "vision/register/sums.h"
#include "base/rotation.h"

/* Standard deviation of an angle that is completely unknown: pi / sqrt(3) rad. */
static const double FREE_ROTATION_RAD = 1.8137993642342178;
static const double SIGMA_DECK_MIN_RAD = 1e-5; /* Least standard deviation of a deck's tilt, rad. */
static const double NEAREST_PLANE_M = 0.03; /* Least distance of the pad's plane, m. */

void predict_tilt(const dl_lens *camera, const dl_tilt_prior *prior, tilt_target *out)
{
    double R_level_body[9], R_level_cam[9], axes[2][3];
    const double sigma = fmax(prior->sigma_deck_rad, SIGMA_DECK_MIN_RAD), cp = cos(prior->pitch_rad), sp = sin(prior->pitch_rad);
    memset(out, 0, sizeof *out);
    out->given = prior->given != 0;
    from_rpy(prior->roll_rad, prior->pitch_rad, 0.0, R_level_body);
    product(R_level_body, camera->R_body_cam, R_level_cam);
    /* The axes about which an error of roll and of pitch turns the body. */
    rotated_back(R_level_cam, (const double[3]){cp, 0.0, -sp}, axes[0]);
    rotated_back(R_level_cam, (const double[3]){0.0, 1.0, 0.0}, axes[1]);
    for (int i = 0; i < 3; i++) {
        out->normal[i] = R_level_cam[6 + i];
        for (int j = 0; j < 3; j++) {
            double sum = i == j ? sigma * sigma : 0.0;
            for (int k = 0; k < 4; k++) {
                sum += axes[k / 2][i] * prior->cov_tilt[k] * axes[k % 2][j];
            }
            out->cov[3 * i + j] = sum;
        }
    }
}

void begin_solver(const fit_state *s, const tilt_target *tilt, double disc_radius_m, solver *out)
{
    const double away = 3.0 * sqrt(dot(s->t, s->t));
    out->tilt = *tilt, out->distant = 0;
    for (int i = 0; i < 3; i++) {
        out->blur_px2[i] = s->blur_px2[i];
        out->free[i] = 1.0 / (away * away);
        out->free[3 + i] = 1.0 / (FREE_ROTATION_RAD * FREE_ROTATION_RAD);
        out->free[6 + i] = 1.0 / (WEAK_BLUR_PX2 * WEAK_BLUR_PX2);
    }
    out->reach_m = fmin(disc_radius_m, 0.6 * s->depth_m);
}

/* Information on rotations about the pad's x and y, and the rotation that meets the prediction. */
static void tilt_information(const tilt_target *tilt, const double R[9], double A[4], double target[2])
{
    double n[2] = {0.0, 0.0}, c[4] = {0.0, 0.0, 0.0, 0.0};
    for (int i = 0; i < 3; i++) {
        n[0] += tilt->normal[i] * R[3 * i];
        n[1] += tilt->normal[i] * R[3 * i + 1];
        for (int j = 0; j < 3; j++) {
            for (int k = 0; k < 4; k++) {
                c[k] += R[3 * i + k / 2] * tilt->cov[3 * i + j] * R[3 * j + k % 2];
            }
        }
    }
    const double per = 1.0 / (c[0] * c[3] - c[1] * c[1]);
    A[0] = c[3] * per, A[1] = A[2] = -c[1] * per, A[3] = c[0] * per;
    target[0] = -n[1], target[1] = n[0];
}

/* Add the information and the gradient of the priors. */
static void add_prior(const solver *v, const fit_state *s, double H[STATES * STATES], double g[STATES])
{
    for (int i = 0; i < STATES; i++) {
        H[i * STATES + i] += v->free[i];
    }
    for (int i = 0; i < 3; i++) {
        g[6 + i] += (v->blur_px2[i] - s->blur_px2[i]) * v->free[6 + i];
    }
    if (v->tilt.given) {
        double A[4], target[2];
        tilt_information(&v->tilt, s->R, A, target);
        for (int k = 0; k < 4; k++) {
            H[(3 + k / 2) * STATES + 3 + k % 2] += A[k];
            g[3 + k / 2] += A[k] * target[k % 2];
        }
    }
}

void line_of_sight(const fit_state *s, double along[3])
{
    rotated_back(s->R, s->t, along);
    const double depth = fmax(along[2], NEAREST_PLANE_M);
    along[0] /= depth, along[1] /= depth, along[2] = 1.0;
}

double motion_px(const solver *v, const fit_state *s, const double delta[STATES])
{
    const double reach = v->reach_m;
    double sight[3] = {0.0, 0.0, 1.0};
    if (v->distant) {
        /* Along the line of sight nothing moves in the frame but the size. */
        line_of_sight(s, sight);
    }
    const double x = delta[0] - sight[0] * delta[2], y = delta[1] - sight[1] * delta[2];
    /* From afar a tilt shortens the image only by its change against the line of sight. */
    const double lever = reach * (reach / s->depth_m + 0.1);
    const double across = hypot(x, y), along = fabs(delta[2]) * reach / s->depth_m;
    const double tilt = lever * hypot(delta[3], delta[4]), turn = reach * fabs(delta[5]);
    return fmax(fmax(across, along), fmax(tilt, turn)) / s->m_per_px;
}

int step_state(const solver *v, const fit_state *s, const double H[STATES * STATES], const double g[STATES], double limit_px,
               int blur_too, fit_state *next, double *moved_px)
{
    double M[STATES * STATES], delta[STATES];
    memcpy(M, H, sizeof M);
    memcpy(delta, g, sizeof delta);
    add_prior(v, s, M, delta);
    if (!solve_symmetric(blur_too ? STATES : POSE, STATES, M, 1, delta)) {
        return 0;
    }
    for (int i = POSE; i < STATES && !blur_too; i++) {
        delta[i] = 0.0;
    }
    *moved_px = motion_px(v, s, delta);
    if (!isfinite(*moved_px)) {
        return 0;
    }
    for (int i = 0; i < STATES && *moved_px > limit_px; i++) {
        delta[i] *= limit_px / *moved_px;
    }
    *next = moved(s, delta);
    return 1;
}

int covariance_of(const solver *v, const fit_state *s, const double H[STATES * STATES], double cov[STATES * STATES])
{
    double M[STATES * STATES], unused[STATES] = {0.0};
    memcpy(M, H, sizeof M);
    add_prior(v, s, M, unused);
    for (int i = 0; i < STATES * STATES; i++) {
        cov[i] = i % (STATES + 1) == 0;
    }
    return solve_symmetric(STATES, STATES, M, STATES, cov);
}
