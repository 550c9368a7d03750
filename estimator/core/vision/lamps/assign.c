/* Assign spots to the lamps of a pattern at a pose. */

#include <math.h>
#include <string.h>

#include "vision/lamps/lamps.h"
#include "vision/tracker.h"

static const double ALONE = 0.06; /* How far the centre of a spot may lie from its lamp, beyond the reach, in radii of the spot. */
static const double SHARED = 0.35; /* The same from the middle of several lamps that share the spot. */
static const double INSET_PX = 5.0; /* Distance from the frame's edge within which a lamp need not show, px: its spot may be cut. */
static const double INSET_RADII = 2.0; /* The same in its radii, besides. */
/* Radius of the pad's surroundings over that of the outermost lamp: other spots in them speak against the pad. */
static const double ABOUT = 1.2;
/* Distance of a lamp without a spot from those that have one at which it would make its own, px. */
static const double APART_PX = 6.0;

/* Lamps in the frame, px, and which are in view. */
typedef struct {
    double uv[DL_LAMPS_MAX][2];
    int in_view[DL_LAMPS_MAX];
} projected_lamps;

void pad_point(const dl_pad_pose *pose, double x, double y, double p[3])
{
    for (int i = 0; i < 3; i++) {
        p[i] = pose->R[3 * i] * x + pose->R[3 * i + 1] * y + pose->t[i];
    }
}

static void project_lamps(const dl_lens *camera, const dl_lamp_pattern *pad, const dl_pad_pose *pose, projected_lamps *out)
{
    for (int k = 0; k < (int)pad->lamps; k++) {
        double p[3];
        pad_point(pose, pad->x_m[k], pad->y_m[k], p);
        camera_project(camera, p, out->uv[k]);
        const double inset = INSET_PX + INSET_RADII * camera->fx * pad->radius_m[k] / fmax(p[2], NEAREST_LAMP_M);
        const double u = out->uv[k][0], v = out->uv[k][1];
        out->in_view[k] = u > inset && v > inset && u < (double)camera->width - 1.0 - inset && v < (double)camera->height - 1.0 - inset;
    }
}

static double distance(const double a[2], const double b[2])
{
    return hypot(a[0] - b[0], a[1] - b[1]);
}

static int32_t nearest_spot(const lamp_spots *spots, const double uv[2], double reach_px)
{
    int32_t best = -1;
    double least = INFINITY;
    for (int k = 0; k < spots->n; k++) {
        const double away = distance(uv, spots->spot[k].uv);
        if (away < least) {
            least = away, best = k;
        }
    }
    return best >= 0 && least <= reach_px + spots->spot[best].radius ? best : -1;
}

/* Compare the place of a spot with the middle of the lamps that are assigned to it. If they differ, the lamps lose the spot. Returns
 * whether they keep it. */
static int keep_group(const dl_lamp_pattern *pad, const projected_lamps *shown, const lamp_spot *spot, int32_t s, double reach_px,
                      int32_t spot_of[DL_LAMPS_MAX])
{
    double middle[2] = {0.0, 0.0};
    int n = 0;
    for (int k = 0; k < (int)pad->lamps; k++) {
        if (spot_of[k] == s) {
            middle[0] += shown->uv[k][0], middle[1] += shown->uv[k][1], n++;
        }
    }
    if (n == 0) {
        return 0;
    }
    middle[0] /= n, middle[1] /= n;
    if (distance(middle, spot->uv) <= reach_px + (n == 1 ? ALONE : SHARED) * spot->radius) {
        return 1;
    }
    for (int k = 0; k < (int)pad->lamps; k++) {
        spot_of[k] = spot_of[k] == s ? -1 : spot_of[k];
    }
    return 0;
}

/* Count the lamps in view without a spot whose spots would be seen apart from those of other lamps. */
static int count_missing(const dl_lamp_pattern *pad, const projected_lamps *shown, const int32_t spot_of[DL_LAMPS_MAX])
{
    int n = 0;
    for (int k = 0; k < (int)pad->lamps; k++) {
        int apart = shown->in_view[k] && spot_of[k] < 0;
        for (int i = 0; i < (int)pad->lamps && apart; i++) {
            apart = spot_of[i] < 0 || distance(shown->uv[k], shown->uv[i]) > APART_PX;
        }
        n += apart;
    }
    return n;
}

/* The length of what of a circle's width lies within the frame. */
static double length_in_frame(double at, double radius, double length)
{
    return fmax(1.0, fmin(at + radius, length) - fmax(at - radius, 0.0));
}

/* Count the spots about the pad that no lamp explains. */
static void count_outliers(const dl_lens *camera, const dl_lamp_pattern *pad, const lamp_spots *spots, const dl_pad_pose *pose,
                            const int explained[DL_LAMP_SPOTS_MAX], lamp_assignment *out)
{
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY}, reach_m = 0.0, p[3], uv[2];
    for (int k = 0; k < (int)pad->lamps; k++) {
        low[0] = fmin(low[0], pad->x_m[k]), high[0] = fmax(high[0], pad->x_m[k]);
        low[1] = fmin(low[1], pad->y_m[k]), high[1] = fmax(high[1], pad->y_m[k]);
    }
    const double x = 0.5 * (low[0] + high[0]), y = 0.5 * (low[1] + high[1]);
    for (int k = 0; k < (int)pad->lamps; k++) {
        reach_m = fmax(reach_m, hypot(pad->x_m[k] - x, pad->y_m[k] - y));
    }
    out->outliers = 0, out->area_px2 = 1.0;
    pad_point(pose, x, y, p);
    if (!(p[2] > NEAREST_LAMP_M)) {
        return;
    }
    camera_project(camera, p, uv);
    const double radius = camera->fx * ABOUT * reach_m / p[2];
    const double width_px = length_in_frame(uv[0], radius, (double)camera->width);
    const double height_px = length_in_frame(uv[1], radius, (double)camera->height);
    out->area_px2 = LAMPS_PI / 4.0 * width_px * height_px;
    for (int k = 0; k < spots->n; k++) {
        out->outliers += !explained[k] && distance(uv, spots->spot[k].uv) < radius;
    }
}

void assign_lamps(const dl_lens *camera, const dl_lamp_pattern *pad, const lamp_spots *spots, const dl_pad_pose *pose, double reach_px,
                  lamp_assignment *out)
{
    projected_lamps shown;
    int explained[DL_LAMP_SPOTS_MAX], in_view = 0;
    project_lamps(camera, pad, pose, &shown);
    for (int k = 0; k < (int)pad->lamps; k++) {
        in_view += shown.in_view[k];
        out->spot[k] = shown.in_view[k] ? nearest_spot(spots, shown.uv[k], reach_px) : -1;
    }
    out->groups = 0;
    for (int s = 0; s < spots->n; s++) {
        explained[s] = keep_group(pad, &shown, &spots->spot[s], s, reach_px, out->spot);
        out->groups += explained[s];
    }
    out->expected = out->groups + count_missing(pad, &shown, out->spot);
    if (in_view == 0) {
        out->outliers = 0, out->area_px2 = 1.0;
        return;
    }
    count_outliers(camera, pad, spots, pose, explained, out);
}
