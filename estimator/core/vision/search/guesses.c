/* Guess poses of the pad from circles, and rate them by the drawing. */

#include <math.h>
#include <string.h>

#include "base/rotation.h"
#include "vision/search/search.h"
#include "vision/tracker.h"

enum { STANDS = 3 };
/* Least radius of a disc, px, at the size of the frame that its drawing is compared at. */
static const double SHARP_PX = 20.0;
static const double HALF_COVERED = 0.8; /* Support of a circle below which half of the disc is taken to be covered. */
static const double ONE_SIDED = 0.2; /* Least distance, in radii, from its centre to the mean of its edges, if they lie on one side. */
/* Fraction of the variance explained by a guess at which no further circles are looked at. */
static const double PLAIN = 0.5;

/* The size of the frame at which a disc's radius is not much more than it must be. */
static int level_of(double radius_px)
{
    int level = 0;
    while (level + 1 < DL_SEARCH_LEVELS && radius_px >= 2.0 * SHARP_PX) {
        radius_px *= 0.5;
        level++;
    }
    return level;
}

/* The half of the disc where a circle's edges are, if they lie on one side. */
static int side_of(const dl_circle *circle, const double *rays, const circle_stand *stand, double side[2])
{
    double places[2 * DL_SEARCH_SECTORS], mean[2] = {0.0, 0.0};
    const int n = (int)circle->points;
    if (circle->support > HALF_COVERED || n < 1 || !search_on_plane(n, rays, stand->R, places)) {
        return 0;
    }
    for (int i = 0; i < 2 * n; i++) {
        mean[i % 2] += (places[i] - stand->centre[i % 2]) / n;
    }
    const double length = hypot(mean[0], mean[1]);
    side[0] = mean[0] / length, side[1] = mean[1] / length;
    return length > ONE_SIDED * stand->radius;
}

/* The guess that a circle is one of the drawing's in a plane, at the heading that fits best. */
static int guess_of(const dl_tracker *t, const dl_frame *frame, const circle_stand *stand, double radius_m, const double *side,
                    dl_guess *out)
{
    const dl_lens *c = &t->camera.lens;
    const double depth = radius_m / stand->radius, at[3] = {stand->centre[0] * depth, stand->centre[1] * depth, depth};
    dl_pad_pose pose;
    dl_polar_fit fit;
    memcpy(pose.R, stand->R, sizeof pose.R);
    rotated(stand->R, at, pose.t);
    const double radius_px = c->fx * t->pad.polar.radius_m / pose.t[2];
    const int level = isfinite(radius_px) && radius_px > 1.0 ? level_of(radius_px) : 0;
    if (!search_heading(t, &frame->level[level], 1 << level, &pose, side, &fit)) {
        return 0;
    }
    memcpy(out->R, pose.R, sizeof out->R);
    memcpy(out->t, pose.t, sizeof out->t);
    out->turn_rad = fit.turn_rad;
    out->drawing = fit.score;
    out->known = stand->known;
    out->one_sided = side != NULL;
    if (side != NULL) {
        const double along = cos(fit.turn_rad), across = sin(fit.turn_rad);
        out->side[0] = along * side[0] + across * side[1];
        out->side[1] = along * side[1] - across * side[0];
    }
    return 1;
}

/* The planes that a circle may lie in: that of the search, and if its tilt is not known those in which the outline is round. */
static int stands_of(const dl_guess_search *how, const dl_circle *circle, const double *rays, circle_stand out[STANDS])
{
    memcpy(out[0].R, how->R_cam_plane, sizeof out[0].R);
    out[0].centre[0] = circle->centre[0], out[0].centre[1] = circle->centre[1];
    out[0].radius = circle->radius;
    out[0].known = (int)how->plane_known;
    return 1 + (out[0].known ? 0 : search_tilts((int)circle->points, rays, out + 1));
}

/* All guesses of one circle, as far as there is room; returns how many. */
static int32_t guesses_of(const dl_tracker *t, const dl_frame *frame, const dl_guess_search *how, const dl_circle *circle, int32_t most,
                          dl_guess *out)
{
    double rays[2 * DL_SEARCH_SECTORS], side[2];
    circle_stand stands[STANDS];
    int32_t n = 0;
    for (int i = 0; i < (int)circle->points; i++) {
        camera_ray(&t->camera.lens, circle->outline_px[2 * i], circle->outline_px[2 * i + 1], rays + 2 * i);
    }
    const int planes = stands_of(how, circle, rays, stands);
    for (int i = 0; i < planes; i++) {
        const int half = side_of(circle, rays, &stands[i], side);
        for (int j = 0; j < (int)how->radii && n < most; j++) {
            const int fits = how->sign[j] != (circle->bright_inside ? -1.0 : 1.0);
            if (fits && guess_of(t, frame, &stands[i], how->radius_m[j], half ? side : NULL, &out[n])) {
                out[n++].support = circle->support;
            }
        }
    }
    return n;
}

/* Whether numbers of circles and of guesses from them are some that there can be, and the sizes of the frame were made. */
static int is_held(const dl_tracker *t, const dl_frame *frame, const dl_guess_search *how, int32_t circles, const dl_circle *circle,
                   const int64_t *rated)
{
    int64_t known = 0;
    for (int k = 0; k < circles; k++) {
        known += rated[k] > 0 ? rated[k] : 0;
        if (circle[k].points < 0 || circle[k].points > DL_SEARCH_SECTORS || rated[k] > how->before) {
            return 0;
        }
    }
    for (int k = 0; k < DL_SEARCH_LEVELS; k++) {
        if (frame->level[k].px == NULL) {
            return 0;
        }
    }
    return t->has_drawing && is_frame(t, frame) && how->radii >= 0 && how->radii <= 4 && how->most >= 0 && known <= how->before;
}

int32_t dl_search_guesses(dl_tracker *t, const dl_frame *frame, const dl_guess_search *how, int32_t circles,
                          const dl_circle *circle, int64_t *rated, const dl_guess *before, dl_guess *out)
{
    const int32_t most = (int32_t)how->most;
    if (!is_held(t, frame, how, circles, circle, rated)) {
        return DL_WRONG_SIZE;
    }
    int32_t n = 0;
    double best = 0.0;
    for (int k = 0; k < circles && n < most && best <= PLAIN; k++, circle++) {
        const int32_t first = n;
        if (rated[k] >= 0) {
            const int32_t known = (int32_t)rated[k];
            n += known < most - n ? known : most - n;
            memcpy(out + first, before, (size_t)(n - first) * sizeof *out);
            before += known;
        } else {
            n += guesses_of(t, frame, how, circle, most - n, out + n);
            rated[k] = n < most ? n - first : DL_NONE;
        }
        for (int32_t i = first; i < n; i++) {
            best = fmax(best, out[i].drawing);
        }
    }
    return n;
}
