/* A pose of the pad in the camera's axes, brought to level with what the attitude's errors add. */

#include <math.h>

#include "decklander.h"
#include "base/rotation.h"

/* Roll and pitch; place and small rotation; place and heading. */
enum { TILT = 2, POSE = 6, PLACE_YAW = 4 };

/* Least variance of the deck's tilt, rad^2: a deck that is level for certain still lets the matrix be inverted. */
static const double LEAST_TILT_VAR = 1e-12;
/* Least squared length of the arrow's part along the horizon. */
static const double LEAST_FLAT = 1e-9;

/* The attitude's share in a tilt that the frame shows against it. */
typedef struct {
    /* Axes in level about which errors of roll and pitch turn the body. */
    double axes[3][TILT];
    /* Errors of roll and pitch by how far the pad's normal lies from the vertical. */
    double gain[TILT][TILT];
    /* Covariance of roll and pitch that is left. */
    double left[TILT][TILT];
} tilt_share;

/* An error e of roll and pitch turns the normal by (axes e) x z = A e; what remains is the deck's own tilt, by their variances. */
static void share_tilt(const dl_tilt_prior *in, tilt_share *out)
{
    const double c = cos(in->pitch_rad), deck_var = in->sigma_deck_rad * in->sigma_deck_rad + LEAST_TILT_VAR;
    const double *C = in->cov_tilt, CA[TILT][TILT] = {{-C[1], C[0] * c}, {-C[3], C[2] * c}};
    const double a = C[3] + deck_var, b = -C[2] * c, d = C[0] * c * c + deck_var, size = a * d - b * b;
    const double inverse[TILT][TILT] = {{d / size, -b / size}, {-b / size, a / size}};
    out->axes[0][0] = c, out->axes[0][1] = 0.0;
    out->axes[1][0] = 0.0, out->axes[1][1] = 1.0;
    out->axes[2][0] = -sin(in->pitch_rad), out->axes[2][1] = 0.0;
    for (int i = 0; i < TILT; i++) {
        for (int k = 0; k < TILT; k++) {
            out->gain[i][k] = CA[i][0] * inverse[0][k] + CA[i][1] * inverse[1][k];
        }
    }
    for (int i = 0; i < TILT; i++) {
        for (int k = 0; k < TILT; k++) {
            out->left[i][k] = C[TILT * i + k] - out->gain[i][0] * CA[k][0] - out->gain[i][1] * CA[k][1];
        }
    }
}

/* Add the symmetric part of M P M' to out, (m, m); M is (m, n), P (n, n). */
static void spread(int m, int n, const double *M, const double *P, double *out)
{
    double MP[POSE * POSE];
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < n; j++) {
            MP[n * i + j] = 0.0;
            for (int k = 0; k < n; k++) {
                MP[n * i + j] += M[n * i + k] * P[n * k + j];
            }
        }
    }
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < m; j++) {
            double one = 0.0, other = 0.0;
            for (int k = 0; k < n; k++) {
                one += MP[n * i + k] * M[n * j + k];
                other += MP[n * j + k] * M[n * i + k];
            }
            out[m * i + j] += 0.5 * (one + other);
        }
    }
}

/* Errors of (place, rotation) in the camera's axes and of the attitude map to those in level.
 *
 * normal: the pad's before the attitude was corrected by it. */
static void level_covariance(const double cov_pose[36], const tilt_share *share, const double R_level_cam[9],
                             const double normal[3], dl_level_sighting *out)
{
    double across_d[9], across_normal[9], by_rotation[9], by_tilt[POSE][TILT], M[POSE][POSE] = {{0.0}};
    skew(out->d, across_d);
    skew(normal, across_normal);
    product(across_normal, R_level_cam, by_rotation);
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < TILT; k++) {
            by_tilt[i][k] = -(across_d[3 * i] * share->axes[0][k] + across_d[3 * i + 1] * share->axes[1][k] +
                              across_d[3 * i + 2] * share->axes[2][k]);
            by_tilt[3 + i][k] = share->axes[i][k];
        }
        for (int k = 0; k < 3; k++) {
            M[i][k] = M[3 + i][3 + k] = R_level_cam[3 * i + k];
        }
    }
    for (int i = 0; i < POSE; i++) {
        for (int k = 0; k < 3; k++) {
            for (int a = 0; a < TILT; a++) {
                M[i][3 + k] -= by_tilt[i][a] * (share->gain[a][0] * by_rotation[k] + share->gain[a][1] * by_rotation[3 + k]);
            }
        }
    }
    for (int i = 0; i < POSE * POSE; i++) {
        out->cov_pose[i] = 0.0;
    }
    spread(POSE, POSE, &M[0][0], cov_pose, out->cov_pose);
    spread(POSE, TILT, &by_tilt[0][0], &share->left[0][0], out->cov_pose);
}

/* The covariance of place and heading; the heading falls as the arrow's azimuth grows. */
static void heading_covariance(dl_level_sighting *out)
{
    const double x = out->R_level_pad[0], y = out->R_level_pad[3], z = out->R_level_pad[6];
    const double flat = fmax(x * x + y * y, LEAST_FLAT);
    const double rows[PLACE_YAW][POSE] = {
        {1.0}, {0.0, 1.0}, {0.0, 0.0, 1.0}, {0.0, 0.0, 0.0, x * z / flat, y * z / flat, -(x * x + y * y) / flat},
    };
    for (int i = 0; i < PLACE_YAW * PLACE_YAW; i++) {
        out->cov[i] = 0.0;
    }
    spread(PLACE_YAW, POSE, &rows[0][0], out->cov_pose, out->cov);
    out->yaw_rad = -atan2(y, x);
}

void dl_sighting_in_level(const dl_lens *lens, const double *t_body_cam, const dl_tilt_prior *prior, const dl_pad_pose *pose,
                          const double *cov_pose, dl_level_sighting *out)
{
    double R_level_body[9], before[9], turn[9], R_level_cam[9], normal[3], lever[3], lever_level[3], tilt[3];
    const double axis[3] = {pose->R[2], pose->R[5], pose->R[8]};
    tilt_share share;
    share_tilt(prior, &share);
    from_rpy(prior->roll_rad, prior->pitch_rad, 0.0, R_level_body);
    product(R_level_body, lens->R_body_cam, before);
    rotated(before, axis, normal);
    for (int i = 0; i < 3; i++) {
        tilt[i] = 0.0;
        for (int k = 0; k < TILT; k++) {
            tilt[i] += share.axes[i][k] * (share.gain[k][0] * normal[0] + share.gain[k][1] * normal[1]);
        }
    }
    exp_rotation(tilt, turn);
    product(turn, before, R_level_cam);
    rotated(R_level_body, t_body_cam, lever);
    rotated(turn, lever, lever_level);
    rotated(R_level_cam, pose->t, out->d);
    for (int i = 0; i < 3; i++) {
        out->d[i] += lever_level[i];
    }
    product(R_level_cam, pose->R, out->R_level_pad);
    orthonormalise(out->R_level_pad);
    level_covariance(cov_pose, &share, R_level_cam, normal, out);
    heading_covariance(out);
}
