/* Compare a sighting with the belief: innovation, Jacobian and noise of place and orientation. */

#include "filter/sighting.h"

#include <math.h>
#include <string.h>

#include "base/kalman.h"
#include "base/rotation.h"
#include "filter/correction.h"

/* Variance, rad^2, above which a heading carries no information. */
static const double KNOWN_YAW_VAR = 2.0;
/* Sigma of the relative heading, rad, above which one of two opposite headings cannot be chosen. */
static const double CHOOSING_SIGMA_RAD = 0.5;

void levelling(const dl_belief *b, double A[9])
{
    const double *source = b->is_levelled ? b->levelled_by : b->R;
    double turn[9];
    about_down(-heading_of(source), turn);
    product(turn, source, A);
}

void seen_from_body(const dl_sighting *s, const double A[9], double seen[3])
{
    rotated_back(A, s->has_pose6 ? s->pose_d_level : s->d_level, seen);
}

void camera_to_ned(const dl_belief *b, double back[9])
{
    double mounted[9];
    exp_rotation(b->x + DL_CAMERA_MOUNT, mounted);
    product(b->R, mounted, back);
}

/* M's columns, times a factor, into columns `at` and on of rows of N. */
static void set_columns(double *H, int at, double factor, const double M[9])
{
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            AT(H, i, at + j) = factor * M[3 * i + j];
        }
    }
}

static void set_column(double *H, int at, const double v[3])
{
    for (int i = 0; i < 3; i++) {
        AT(H, i, at) = v[i];
    }
}

/* What the camera shows of the pad's place in the body's axes, and how that changes. */
typedef struct {
    double shown[3], rates[3], v_b[3], d_b[3], w[3];
} lens_view;

static void view_of(const dl_belief *b, lens_view *seen)
{
    const double *x = b->x;
    double turning[9], moved[3], v_ned[3];
    for (int i = 0; i < 3; i++) {
        v_ned[i] = (i < 2 ? x[DL_VESSEL_VEL + i] : 0.0) - x[DL_VEL + i];
        seen->w[i] = b->w[i] - x[DL_GYRO_BIAS + i];
    }
    rotated_back(b->R, x + DL_POS_REL, seen->d_b);
    rotated_back(b->R, v_ned, seen->v_b);
    skew(seen->w, turning);
    rotated(turning, seen->d_b, moved);
    for (int i = 0; i < 3; i++) {
        seen->rates[i] = seen->v_b[i] - moved[i];
        seen->shown[i] = seen->d_b[i] + x[DL_CAMERA_DELAY] * seen->rates[i] - x[DL_CAMERA_LEVER + i];
    }
}

/* The place's rows of the Jacobian, and those of the rate of the place. */
static void by_place(const dl_belief *b, const lens_view *seen, const double E[9], const double jl[9], double *H, double *by_rate)
{
    double back[9], ER[9], arm[9], turning[9], E_turning[9], M[9], skewed[9], column[3];
    transposed(b->R, back);
    product(E, back, ER);
    skew(seen->d_b, arm);
    skew(seen->w, turning);
    product(turning, arm, M);
    skew(seen->v_b, skewed);
    for (int i = 0; i < 9; i++) {
        skewed[i] -= M[i];
    }
    memset(by_rate, 0, 3 * DL_N * sizeof *by_rate);
    product(E, skewed, M);
    set_columns(by_rate, DL_ATT_ERR, 1.0, M);
    product(E, turning, E_turning);
    product(E_turning, back, M);
    set_columns(by_rate, DL_POS_REL, -1.0, M);
    set_columns(by_rate, DL_VEL, -1.0, ER);
    for (int i = 0; i < 3; i++) {
        AT(by_rate, i, DL_VESSEL_VEL) = ER[3 * i];
        AT(by_rate, i, DL_VESSEL_VEL + 1) = ER[3 * i + 1];
    }
    product(E, arm, M);
    set_columns(by_rate, DL_GYRO_BIAS, -1.0, M);
    set_columns(H, DL_ATT_ERR, 1.0, M);
    set_columns(H, DL_POS_REL, 1.0, ER);
    for (int i = 0; i < 3 * DL_N; i++) {
        H[i] += b->x[DL_CAMERA_DELAY] * by_rate[i];
    }
    skew(seen->shown, skewed);
    product(E, skewed, M);
    product(M, jl, skewed);
    set_columns(H, DL_CAMERA_MOUNT, 1.0, skewed);
    set_columns(H, DL_CAMERA_LEVER, -1.0, E);
    rotated(E, seen->rates, column);
    set_column(H, DL_CAMERA_DELAY, column);
}

/* R_level_pad as the camera shows it, and its derivative G, (3, N), by small rotations in `level`. */
static void by_orientation(const dl_belief *b, const lens_view *seen, const double A[9], const double E[9], const double jl[9], double M[9],
                           double *G)
{
    const double *x = b->x, late = x[DL_CAMERA_DELAY], pitch = x[PITCH] + x[DL_DECK_TRIM + 1];
    double AE[9], pad[9], body_pad[9], still[9], turn[9], spin[3], angle[3], by_roll[3], by_pitch[3], along[3], column[3];
    product(A, E, AE);
    rotated(AE, seen->w, spin);
    for (int i = 0; i < 3; i++) {
        spin[i] = -spin[i];
        angle[i] = late * spin[i];
    }
    from_rpy(x[ROLL] + x[DL_DECK_TRIM], pitch, x[DL_PAD_YAW], pad);
    product_of_transposed(b->R, pad, body_pad);
    product(AE, body_pad, still);
    exp_rotation(angle, turn);
    product(turn, still, M);
    memset(G, 0, 3 * DL_N * sizeof *G);
    set_columns(G, DL_ATT_ERR, -1.0, AE);
    product(AE, jl, still);
    set_columns(G, DL_CAMERA_MOUNT, -1.0, still);
    set_columns(G, DL_GYRO_BIAS, late, AE);
    set_column(G, DL_CAMERA_DELAY, spin);
    pad_axes(pitch, x[DL_PAD_YAW], by_roll, by_pitch);
    const double by_yaw[3] = {0.0, 0.0, 1.0}, *const axes[3] = {by_roll, by_pitch, by_yaw};
    const int columns[3][2] = {{ROLL, DL_DECK_TRIM}, {PITCH, DL_DECK_TRIM + 1}, {DL_PAD_YAW, DL_PAD_YAW}};
    for (int k = 0; k < 3; k++) {
        rotated_back(b->R, axes[k], along);
        rotated(AE, along, column);
        set_column(G, columns[k][0], column);
        set_column(G, columns[k][1], column);
    }
}

/* The row of a heading, of a sighting that shows no more of the orientation. */
static void compare_heading(const dl_sighting *s, const double M[9], const double *G, double *innov, double *H)
{
    double row[3];
    heading_by_outer_rotation(M, row);
    *innov = wrapped((s->has_yaw ? s->yaw_rad : 0.0) + heading_of(M));
    if (s->yaw_ambiguous && fabs(*innov) > 0.5 * acos(-1.0)) {
        *innov = wrapped(*innov + acos(-1.0));
    }
    for (int k = 0; k < DL_N; k++) {
        H[k] = -(row[0] * AT(G, 0, k) + row[1] * AT(G, 1, k) + row[2] * AT(G, 2, k));
    }
}

static void compare_orientation(const dl_sighting *s, const double M[9], double innov[3])
{
    double gap[9], seen[9], half_turn[9];
    product_by_transposed(s->pose_R, M, gap);
    if (s->yaw_ambiguous && gap[0] + gap[4] + gap[8] < 1.0) {
        about_down(acos(-1.0), half_turn);
        product(s->pose_R, half_turn, seen);
        product_by_transposed(seen, M, gap);
    }
    log_rotation(gap, innov);
}

static int measured_numbers(const dl_sighting *s, double yaw_sigma, int place_only)
{
    if (place_only) {
        return 3;
    }
    if (s->has_pose6) {
        return SEEN_MAX;
    }
    const int chosen = !s->yaw_ambiguous || yaw_sigma <= CHOOSING_SIGMA_RAD;
    return s->has_yaw && s->cov[15] < KNOWN_YAW_VAR && chosen ? 4 : 3;
}

/* Change of the compared quantity with a later exposure: by the body's motion, as with the delay, and by the deck's. The delay's own
 * column lacks the deck's because the state holds the deck that the camera shows; a single stamp's error moves both. */
static void by_exposure(const double x[DL_N], int m, const double *H, double slipped[SEEN_MAX])
{
    const int turns[3] = {ROLL, PITCH, DL_PAD_YAW};
    const double rates[3] = {x[ROLL + 1], x[PITCH + 1], x[DL_YAW_RATE] + x[DL_TURN_RATE]};
    const double waves[3] = {x[SURGING], x[SWAYING], x[HEAVING]};
    for (int i = 0; i < m; i++) {
        slipped[i] = AT(H, i, DL_CAMERA_DELAY);
        for (int k = 0; k < 3; k++) {
            slipped[i] += AT(H, i, DL_POS_REL + k) * waves[k] + AT(H, i, turns[k]) * rates[k];
        }
    }
}

/* Variance of the turn rate about each axis, (rad/s)^2, over the time by which a stamp may err: about as far as the gyro's newest
 * reading is from its recent mean. */
static double rate_variance(const dl_belief *b)
{
    double apart[3];
    for (int i = 0; i < 3; i++) {
        apart[i] = b->w[i] - b->w_smooth[i];
    }
    return dot(apart, apart);
}

/* Noise of the compared quantity, (m, m): without the part of the attitude that levelled it, and with the stamp's own error. */
static void noise_of(const dl_belief *b, const dl_sighting *s, int m, const double A[9], const double cov_levelled_by[9],
                     const double *H, double *R)
{
    const double *d_level = s->has_pose6 ? s->pose_d_level : s->d_level, *cov = s->has_pose6 ? s->pose_cov : s->cov;
    const int width = s->has_pose6 ? 6 : 4;
    double tilt[9], row[3], arm[9], J[SEEN_MAX * 3] = {0.0}, own[SEEN_MAX * SEEN_MAX], half[SEEN_MAX * SEEN_MAX];
    double turn[SEEN_MAX][SEEN_MAX] = {{0.0}};
    /* An error of the levelling attitude, about body axes, changes what vision reports by its tilt and never by its heading. */
    memcpy(tilt, A, sizeof tilt);
    heading_by_rotation(A, row);
    for (int j = 0; j < 3; j++) {
        tilt[6 + j] -= row[j];
    }
    skew(d_level, arm);
    product(arm, tilt, J);
    for (int i = 0; i < 9; i++) {
        J[i] = -J[i];
    }
    if (m == SEEN_MAX) {
        memcpy(J + 9, tilt, sizeof tilt);
    }
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < m; j++) {
            own[i * m + j] = cov[i * width + j];
            turn[i][j] = i < 3 && j < 3 ? A[3 * j + i] : i == j;
        }
    }
    remove_attitude(m, own, J, cov_levelled_by);
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < m; j++) {
            half[i * m + j] = 0.0;
            for (int k = 0; k < m; k++) {
                half[i * m + j] += turn[i][k] * own[k * m + j];
            }
        }
    }
    const double slip = s->sigma_s * s->sigma_s, turned_var = slip * rate_variance(b);
    double slipped[SEEN_MAX], seen[3];
    by_exposure(b->x, m, H, slipped);
    seen_from_body(s, A, seen);
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < m; j++) {
            R[i * m + j] = slip * slipped[i] * slipped[j];
            for (int k = 0; k < m; k++) {
                R[i * m + j] += half[i * m + k] * turn[j][k];
            }
        }
        R[i * m + i] += turned_var * (i < 3 ? dot(seen, seen) - seen[i] * seen[i] : 1.0);
    }
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < i; j++) {
            R[i * m + j] = R[j * m + i] = 0.5 * (R[i * m + j] + R[j * m + i]);
        }
    }
}

void sighting_model(const dl_belief *b, const dl_sighting *s, const double *cov_levelled_by, double yaw_sigma, int place_only,
                    sighting_rows *out)
{
    double *innov = out->innov, *H = out->H;
    const int m = measured_numbers(s, yaw_sigma, place_only);
    double A[9], E[9], jl[9], mount[3], shown[3], found[3];
    lens_view seen;
    levelling(b, A);
    for (int i = 0; i < 3; i++) {
        mount[i] = -b->x[DL_CAMERA_MOUNT + i];
    }
    exp_rotation(mount, E);
    left_jacobian(b->x + DL_CAMERA_MOUNT, jl);
    view_of(b, &seen);
    memset(H, 0, (size_t)(m * DL_N) * sizeof *H);
    by_place(b, &seen, E, jl, H, out->by_rate);
    rotated(E, seen.shown, shown);
    seen_from_body(s, A, found);
    for (int i = 0; i < 3; i++) {
        innov[i] = found[i] - shown[i];
    }
    if (m > 3) {
        double M[9], G[3 * DL_N];
        by_orientation(b, &seen, A, E, jl, M, G);
        if (m == SEEN_MAX) {
            compare_orientation(s, M, innov + 3);
            memcpy(H + 3 * DL_N, G, sizeof G);
        } else {
            compare_heading(s, M, G, innov + 3, H + 3 * DL_N);
        }
    }
    noise_of(b, s, m, A, cov_levelled_by, H, out->R);
    out->m = m;
}
