/* One look at where a pad may lie: the drawing is registered there, verified, and brought to level. */

#include <math.h>
#include <string.h>

#include "vision/align/align.h"
#include "vision/look/look.h"

/* A pad's drawing as maps, the tables of light that go with them, and the frame. */
typedef struct {
    const camera_lens *camera;
    const pad_template *drawn;
    const int16_t *maps, *local_maps;
    const float *lights;
    const uint8_t *frame;
    const frame_quality *quality;
    float *scratch;
    uint8_t *parts;
} sight;

/* Move a rough pose, on a reduced frame, to where registration can start; it stays where that fails. */
static void approach(const sight *s, double sigma_tilt_rad, pad_pose *pose)
{
    const alignment how = {.steps = APPROACH_STEPS, .sigma_tilt_rad = sigma_tilt_rad, .noise = s->quality->noise};
    pad_pose moved = *pose;
    frame_part part;
    int32_t stride;
    double tilt_sigmas;
    if (!align_view(s->camera, s->drawn, pose, APPROACH_SAMPLES, &part)) {
        return;
    }
    const uint8_t *px = look_part(s->frame, (int32_t)s->camera->width, &part, s->parts, &stride);
    if (align_move(s->camera, s->drawn, s->maps, s->lights, &part, px, stride, &how, &moved, &tilt_sigmas, s->scratch)) {
        *pose = moved;
    }
}

/* A part of a level that also holds what a part of a higher level is made of. */
static frame_part with_part(const frame_part *lower, const frame_part *higher)
{
    const int up = (int)(higher->level - lower->level);
    const int64_t left = higher->left << up, top = higher->top << up;
    const int64_t right = (higher->left + higher->width) << up, low = (higher->top + higher->height) << up;
    frame_part all = *lower;
    all.left = left < lower->left ? left : lower->left;
    all.top = top < lower->top ? top : lower->top;
    all.width = (right > lower->left + lower->width ? right : lower->left + lower->width) - all.left;
    all.height = (low > lower->top + lower->height ? low : lower->top + lower->height) - all.top;
    return all;
}

/* The pixels of two parts: what the one of the higher level is made of is reduced once if the other is made, too. */
static void both_parts(const sight *s, const frame_part *part, const frame_part *arrow, const uint8_t *px[2], int32_t stride[2])
{
    const int32_t width = (int32_t)s->camera->width;
    if (arrow->level == 0 || arrow->level >= part->level) {
        px[0] = look_part(s->frame, width, part, s->parts, &stride[0]);
        px[1] = look_part(s->frame, width, arrow, s->parts + (part->level > 0 ? stride[0] * part->height : 0), &stride[1]);
        return;
    }
    const frame_part all = with_part(arrow, part);
    const int up = (int)(part->level - arrow->level);
    const uint8_t *made = look_part(s->frame, width, &all, s->parts, &stride[1]);
    uint8_t *room = s->parts + stride[1] * all.height;
    px[1] = made + (arrow->top - all.top) * stride[1] + 3 * (arrow->left - all.left);
    look_reduced(made + ((part->top << up) - all.top) * stride[1] + 3 * ((part->left << up) - all.left), stride[1], up,
                 (int)part->width, (int)part->height, room);
    px[0] = room, stride[0] = 3 * (int32_t)part->width;
}

/* Align the drawing at a pose without moving it. The arrowhead is looked at in more detail than the rest. */
static int align_at(const sight *s, const pad_pose *pose, const double cut[3], aligned_pad *out)
{
    frame_part part, arrow;
    const uint8_t *px[2];
    int32_t stride[2];
    if (!align_view(s->camera, s->drawn, pose, FINAL_SAMPLES, &part)) {
        return 0;
    }
    align_arrow_view(s->camera, s->drawn, pose, &arrow);
    both_parts(s, &part, &arrow, px, stride);
    return align_fit(s->camera, s->drawn, s->maps, s->local_maps, s->lights, &part, px[0], stride[0], &arrow, px[1], stride[1],
                     pose, 0.0, cut, s->quality, s->scratch, out);
}

/* Bring what was registered to level. */
static void bring_to_level(const camera_lens *camera, const tilt_prior *prior, const look_options *how, const registration *found,
                           level_sighting *out)
{
    camera_sighting in = {.roll_rad = prior->roll_rad, .pitch_rad = prior->pitch_rad, .sigma_deck_rad = prior->sigma_deck_rad};
    memcpy(in.cov_tilt, prior->cov_tilt, sizeof in.cov_tilt);
    memcpy(in.R_body_cam, camera->R_body_cam, sizeof in.R_body_cam);
    memcpy(in.t_body_cam, how->t_body_cam, sizeof in.t_body_cam);
    memcpy(in.R_cam_pad, found->R, sizeof in.R_cam_pad);
    memcpy(in.t_cam_pad, found->t, sizeof in.t_cam_pad);
    memcpy(in.cov_pose, found->cov, sizeof in.cov_pose);
    sighting_in_level(&in, out);
}

int32_t look_at_pad(const camera_lens *camera, const double *rays, const uint8_t *frame, const float *light, const float *lights,
                    const pad_shape *shape, int32_t points, const double *edges, const int32_t *edge_of, const pad_template *drawn,
                    const int16_t *maps, const int16_t *local_maps, const pad_judge *judge, const tilt_prior *prior,
                    const fit_options *fit, const frame_quality *quality, const look_options *how, const pad_paint *known,
                    const double *start, int32_t room, float *scratch, uint8_t *parts, looked_pad *out, double *outline)
{
    const sight s = {camera, drawn, maps, local_maps, lights, frame, quality, scratch, parts};
    pad_pose pose;
    memcpy(&pose, start, sizeof pose);
    if (how->coarse) {
        approach(&s, how->sigma_tilt_rad, &pose);
    }
    if (!register_pad(camera, rays, frame, light, shape, points, edges, edge_of, prior, fit, (const double *)&pose, room, scratch,
                      &out->found, outline)) {
        return 0;
    }
    memcpy(pose.R, out->found.R, sizeof pose.R);
    memcpy(pose.t, out->found.t, sizeof pose.t);
    if (!align_at(&s, &pose, fit->cut, &out->aligned)) {
        return 0;
    }
    look_evidence(judge, &out->found, &out->aligned, out->evidence, &out->log_odds);
    if (!isfinite(out->log_odds)) {
        return 0;
    }
    look_paint(known, &out->aligned, &out->paint);
    bring_to_level(camera, prior, how, &out->found, &out->seen);
    return 1;
}
