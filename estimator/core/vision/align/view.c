/* Choose the level and the part of a frame that a pose needs. */

#include <math.h>

#include "vision/align/align.h"

/* Radius of a circle that encloses all samples, in radii of the disc, and points on it. */
static const double BOX_RADII = 1.15;
enum { BOX_POINTS = 24, LEAST_PX = 3 };
/* Pixels of a level about the box, so that every place in it lies between two. */
enum { MARGIN_PX = 2 };
/* Pixels of the chosen level along the arrowhead, if the frame has as many. */
static const double ARROW_SAMPLES = 5.0;
static const double LEAST_PROJECTED_M = 0.05; /* Least depth of a point that is projected, m. */

static int finite_pose(const dl_pad_pose *pose)
{
    double sum = 0.0;
    for (int i = 0; i < 9; i++) {
        sum += pose->R[i];
    }
    return isfinite(sum + pose->t[0] + pose->t[1] + pose->t[2]);
}

/* Left, top, right and bottom of the pad in the frame, px; all of the frame where a part of the pad is beside or behind the lens. */
static void box_of(const dl_lens *c, const dl_pad_template *p, const dl_pad_pose *pose, double box[4])
{
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
    const double size[2] = {(double)c->width, (double)c->height}, whole[4] = {0.0, 0.0, size[0], size[1]};
    for (int k = 0; k < 4; k++) {
        box[k] = whole[k];
    }
    for (int i = 0; i < BOX_POINTS; i++) {
        const double angle = 2.0 * acos(-1.0) * i / BOX_POINTS, radius = BOX_RADII * p->disc_radius_m;
        double at[3], uv[2];
        for (int k = 0; k < 3; k++) {
            at[k] = pose->t[k] + radius * (pose->R[3 * k] * cos(angle) + pose->R[3 * k + 1] * sin(angle));
        }
        if (at[2] < LEAST_PROJECTED_M) {
            return;
        }
        camera_project(c, at, uv);
        for (int k = 0; k < 2; k++) {
            low[k] = fmin(low[k], uv[k]);
            high[k] = fmax(high[k], uv[k]);
        }
    }
    for (int k = 0; k < 2; k++) {
        box[k] = fmin(fmax(0.0, low[k]), size[k]);
        box[2 + k] = fmax(0.0, fmin(size[k], high[k] + 1.0));
    }
}

/* The part of a level that a box of the frame lies in. Returns whether it is large enough to align with. */
static int part_in(const dl_lens *c, const double box[4], int level, frame_part *out)
{
    const int k = 1 << level;
    const double columns = fmax(1.0, (double)(c->width >> level)), rows = fmax(1.0, (double)(c->height >> level));
    out->level = level;
    out->left = (int64_t)floor(box[0] / k);
    out->top = (int64_t)floor(box[1] / k);
    out->width = (int64_t)fmin(ceil(box[2] / k), columns) - out->left;
    out->height = (int64_t)fmin(ceil(box[3] / k), rows) - out->top;
    return out->width >= LEAST_PX && out->height >= LEAST_PX;
}

int align_view(const dl_lens *c, const dl_pad_template *p, const dl_pad_pose *pose, int32_t most, frame_part *out)
{
    double box[4];
    if (!finite_pose(pose) || !(pose->t[2] >= LEAST_DEPTH_M)) {
        return 0;
    }
    box_of(c, p, pose, box);
    const double w = box[2] - box[0], h = box[3] - box[1];
    if (!(w >= LEAST_PX && h >= LEAST_PX)) {
        return 0;
    }
    return part_in(c, box, (int)fmin(DL_FRAME_LEVELS, fmax(0.0, ceil(0.5 * log2(w * h / most)))), out);
}

void align_arrow_view(const dl_lens *c, const dl_pad_template *p, const dl_pad_pose *pose, frame_part *out)
{
    const double arrow_px = c->fx * p->arrow_depth_m / pose->t[2];
    const int level = (int)fmin(DL_FRAME_LEVELS, floor(log2(fmax(1.0, arrow_px / ARROW_SAMPLES))));
    double box[4];
    box_of(c, p, pose, box);
    for (int k = 0; k < 2; k++) {
        box[k] = fmax(0.0, box[k] - (MARGIN_PX << level));
        box[2 + k] += MARGIN_PX << level;
    }
    part_in(c, box, level, out);
    /* A level leaves odd columns and rows of the frame out: a pad in these alone has one pixel, which shows nothing of it. */
    out->left = out->width > 0 ? out->left : (c->width >> level) - 1, out->width = out->width > 0 ? out->width : 1;
    out->top = out->height > 0 ? out->top : (c->height >> level) - 1, out->height = out->height > 0 ? out->height : 1;
}
