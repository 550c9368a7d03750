/* Fit a pose to the spots of lamps, with its covariance. */

#include <math.h>
#include <string.h>

#include "base/rotation.h"
#include "vision/lamps/lamps.h"
#include "vision/register/sums.h"
#include "vision/tracker.h"

enum { STEPS = 6, ROW = 6 };
/* Standard deviations of a spot at which it counts a quarter, or times the middle one's distance while that is more: another light
 * beside a lamp moves its centre. Source: Geman & McClure, Statistical methods for tomographic image reconstruction, 1987. */
static const double ROBUST = 3.0;
/* Standard deviation, px, of the centre of a spot that several lamps share: they are not equally bright. */
static const double MERGED_PX = 0.15;
static const double LEAST_LAMPS_TILT_VAR = 1e-8; /* Least variance of the deck's tilt, rad^2. */

/* A spot and the lamps in it: its ray, its standard deviation in rays, how far the lamps' middle is from it, and how that moves with
 * the pose. */
typedef struct {
    int lamps, spot;
    double ray[2], sigma, off[2], J[2][ROW], trust;
} lamp_group;

typedef struct {
    int n;
    lamp_group group[DL_LAMP_SPOTS_MAX];
} lamp_groups;

/* What the attitude and a nearly level deck say of the horizontal part of the pad's normal in `level`: its information, 1/rad^2. */
typedef struct {
    double R_level_cam[9], information[2][2];
} level_prior;

void level_of_camera(const dl_lens *camera, const dl_tilt_prior *prior, double R[9])
{
    double R_level_body[9];
    from_rpy(prior->roll_rad, prior->pitch_rad, 0.0, R_level_body);
    product(R_level_body, camera->R_body_cam, R);
}

static void expect_level(const dl_lens *camera, const dl_tilt_prior *prior, level_prior *out)
{
    /* An error of roll turns the normal to port, one of pitch ahead, each by its axis' horizontal part. */
    const double c = cos(prior->pitch_rad), *cov = prior->cov_tilt;
    const double deck = prior->sigma_deck_rad * prior->sigma_deck_rad + LEAST_LAMPS_TILT_VAR;
    const double xx = cov[3] + deck, yy = c * c * cov[0] + deck, xy = -c * cov[1], det = xx * yy - xy * xy;
    level_of_camera(camera, prior, out->R_level_cam);
    out->information[0][0] = yy / det, out->information[1][1] = xx / det;
    out->information[0][1] = out->information[1][0] = -xy / det;
}

static void gather(const dl_lens *camera, const dl_lamp_pattern *pad, const lamp_spots *spots, const lamp_assignment *of,
                   double focal_px, lamp_groups *out)
{
    out->n = 0;
    for (int s = 0; s < spots->n; s++) {
        lamp_group one = {.spot = s, .trust = 1.0};
        for (int k = 0; k < (int)pad->lamps; k++) {
            one.lamps += of->spot[k] == s;
        }
        if (one.lamps > 0) {
            camera_ray(camera, spots->spot[s].uv[0], spots->spot[s].uv[1], one.ray);
            one.sigma = hypot(spots->spot[s].sigma, one.lamps > 1 ? MERGED_PX : 0.0) / focal_px;
            out->group[out->n++] = one;
        }
    }
}

/* Add where a lamp is seen, (x/z, y/z), and how that moves with the pad's place and with a small turn of it in `cam`. */
static int add_lamp(const dl_pad_pose *pose, double x_m, double y_m, lamp_group *g)
{
    double arm[3], p[3];
    for (int i = 0; i < 3; i++) {
        arm[i] = pose->R[3 * i] * x_m + pose->R[3 * i + 1] * y_m;
        p[i] = arm[i] + pose->t[i];
    }
    if (!(p[2] >= NEAREST_LAMP_M)) {
        return 0;
    }
    const double share = 1.0 / g->lamps, z = p[2];
    for (int i = 0; i < 2; i++) {
        const double by[3] = {i == 0 ? 1.0 / z : 0.0, i == 1 ? 1.0 / z : 0.0, -p[i] / (z * z)};
        double turn[3];
        cross(arm, by, turn);
        g->off[i] -= share * p[i] / z;
        for (int k = 0; k < 3; k++) {
            g->J[i][k] += share * by[k], g->J[i][3 + k] += share * turn[k];
        }
    }
    return 1;
}

/* The groups at a pose; 0 if a lamp is not before the lens. */
static int project_groups(const dl_lamp_pattern *pad, const lamp_assignment *of, const dl_pad_pose *pose, lamp_groups *groups)
{
    for (int g = 0; g < groups->n; g++) {
        lamp_group *one = &groups->group[g];
        memcpy(one->off, one->ray, sizeof one->off);
        memset(one->J, 0, sizeof one->J);
        for (int k = 0; k < (int)pad->lamps; k++) {
            if (of->spot[k] == one->spot && !add_lamp(pose, pad->x_m[k], pad->y_m[k], one)) {
                return 0;
            }
        }
    }
    return 1;
}

static double sigmas_of(const lamp_group *g)
{
    return hypot(g->off[0], g->off[1]) / g->sigma;
}

static double median_sigmas(const lamp_groups *groups)
{
    double sorted[DL_LAMP_SPOTS_MAX] = {0.0};
    const int n = groups->n;
    for (int g = 0; g < n; g++) {
        const double value = sigmas_of(&groups->group[g]);
        int at = g;
        for (; at > 0 && sorted[at - 1] > value; at--) {
            sorted[at] = sorted[at - 1];
        }
        sorted[at] = value;
    }
    return 0.5 * (sorted[n / 2] + sorted[(n - 1) / 2]);
}

/* Add the spots' information and gradient, each weighted by how far it is off. */
static void add_groups(lamp_groups *groups, double A[ROW * ROW], double b[ROW])
{
    const double limit = ROBUST * fmax(1.0, median_sigmas(groups));
    for (int n = 0; n < groups->n; n++) {
        lamp_group *g = &groups->group[n];
        const double far = sigmas_of(g) / limit, root = 1.0 / (1.0 + far * far);
        g->trust = root * root;
        const double weight = g->trust / (g->sigma * g->sigma);
        for (int i = 0; i < ROW; i++) {
            b[i] += weight * (g->J[0][i] * g->off[0] + g->J[1][i] * g->off[1]);
            for (int j = 0; j < ROW; j++) {
                A[i * ROW + j] += weight * (g->J[0][i] * g->J[0][j] + g->J[1][i] * g->J[1][j]);
            }
        }
    }
}

/* Add what is expected of the tilt. */
static void add_level(const level_prior *prior, const dl_pad_pose *pose, double A[ROW * ROW], double b[ROW])
{
    double normal[3], turn[9], T[9];
    const double of_pad[3] = {pose->R[2], pose->R[5], pose->R[8]};
    rotated(prior->R_level_cam, of_pad, normal);
    skew(normal, turn);
    product(turn, prior->R_level_cam, T);
    for (int k = 0; k < 2; k++) {
        for (int l = 0; l < 2; l++) {
            const double information = prior->information[k][l];
            for (int i = 0; i < 3; i++) {
                b[3 + i] += T[3 * k + i] * information * normal[l];
                for (int j = 0; j < 3; j++) {
                    A[(3 + i) * ROW + 3 + j] += T[3 * k + i] * information * T[3 * l + j];
                }
            }
        }
    }
}

static void move_pose(const double step[ROW], dl_pad_pose *pose)
{
    double turn[9], R[9];
    exp_rotation(step + 3, turn);
    product(turn, pose->R, R);
    memcpy(pose->R, R, sizeof R);
    for (int i = 0; i < 3; i++) {
        pose->t[i] += step[i];
    }
}

/* The covariance grows with spots that are farther off than they should be, and along the line of sight with an unknown size. */
static int covariance(const dl_lamp_pattern *pad, const lamp_groups *groups, const double A[ROW * ROW], const dl_pad_pose *pose,
                      double cov[ROW * ROW])
{
    double chi2 = 0.0, trust = 0.0, reach = 0.0;
    for (int i = 0; i < ROW * ROW; i++) {
        cov[i] = i % (ROW + 1) == 0;
    }
    if (!solve_symmetric(ROW, ROW, A, ROW, cov)) {
        return 0;
    }
    for (int n = 0; n < groups->n; n++) {
        const double sigmas = sigmas_of(&groups->group[n]);
        chi2 += groups->group[n].trust * sigmas * sigmas, trust += groups->group[n].trust;
    }
    for (int k = 0; k < (int)pad->lamps; k++) {
        reach = fmax(reach, hypot(pad->x_m[k], pad->y_m[k]));
    }
    const double grown = fmax(1.0, chi2 / fmax(1.0, 2.0 * trust - 4.0)), size = pad->size_sigma_m / reach;
    int finite = 1;
    for (int i = 0; i < ROW; i++) {
        for (int j = 0; j < ROW; j++) {
            cov[i * ROW + j] = grown * cov[i * ROW + j] + (i < 3 && j < 3 ? size * size * pose->t[i] * pose->t[j] : 0.0);
            finite &= isfinite(cov[i * ROW + j]) != 0;
        }
    }
    return finite;
}

/* The largest distance of the spots from their middle, px. */
static double extent_px(const lamp_groups *groups, double focal_px)
{
    double middle[2] = {0.0, 0.0}, most = 0.0;
    for (int g = 0; g < groups->n; g++) {
        middle[0] += groups->group[g].ray[0] / groups->n, middle[1] += groups->group[g].ray[1] / groups->n;
    }
    for (int g = 0; g < groups->n; g++) {
        most = fmax(most, hypot(groups->group[g].ray[0] - middle[0], groups->group[g].ray[1] - middle[1]));
    }
    return focal_px * most;
}

int fit_lamps(const dl_lens *camera, const dl_lamp_pattern *pad, const dl_tilt_prior *prior, const lamp_spots *spots,
              const lamp_assignment *of, const dl_pad_pose *start, lamp_fit *out)
{
    const double focal_px = 0.5 * (camera->fx + camera->fy);
    double A[ROW * ROW], step[ROW];
    lamp_groups groups;
    level_prior level;
    gather(camera, pad, spots, of, focal_px, &groups);
    expect_level(camera, prior, &level);
    out->pose = *start;
    if (groups.n < 2) {
        return 0;
    }
    for (int k = 0; k < STEPS; k++) {
        if (!project_groups(pad, of, &out->pose, &groups)) {
            return 0;
        }
        memset(A, 0, sizeof A), memset(step, 0, sizeof step);
        add_groups(&groups, A, step);
        add_level(&level, &out->pose, A, step);
        if (!solve_symmetric(ROW, ROW, A, 1, step)) {
            return 0;
        }
        move_pose(step, &out->pose);
    }
    orthonormalise(out->pose.R);
    if (!(out->pose.t[2] >= NEAREST_LAMP_M) || !isfinite(out->pose.t[0]) || !isfinite(out->pose.t[1]) || !isfinite(out->pose.t[2])) {
        return 0;
    }
    for (int g = 0; g < groups.n; g++) {
        out->off_px[g] = focal_px * hypot(groups.group[g].off[0], groups.group[g].off[1]);
    }
    out->middle_sigmas = median_sigmas(&groups), out->extent_px = extent_px(&groups, focal_px);
    if (!covariance(pad, &groups, A, &out->pose, out->cov)) {
        return 0;
    }
    add_focal_doubt(camera, out->pose.t, out->cov);
    return 1;
}
