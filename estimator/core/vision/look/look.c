/* One look at where a pad may lie: the drawing is registered there, verified, and brought to level. */

#include "vision/look/look.h"

#include <math.h>

#include "vision/align/align.h"
#include "vision/register/register.h"

/* Move a rough pose, on a reduced frame, to where registration can start; it stays where that fails. */
static void approach(const dl_tracker *t, const dl_frame *frame, double sigma_tilt_rad, dl_pad_pose *pose)
{
    const dl_alignment how = {.steps = APPROACH_STEPS, .sigma_tilt_rad = sigma_tilt_rad};
    dl_pad_pose moved = *pose;
    seen_part seen;
    uint8_t *at = t->parts;
    double tilt_sigmas;
    if (align_view(&t->camera.lens, &t->pad.drawn, pose, APPROACH_SAMPLES, &seen.part) && look_part(t, frame, &at, &seen)
        && align_move(t, &seen, &how, frame->quality.noise, &moved, &tilt_sigmas)) {
        *pose = moved;
    }
}

/* Verify the drawing at a pose. The arrowhead is looked at in more detail than the rest. */
static int verify_at(const dl_tracker *t, const dl_frame *frame, const dl_pad_pose *pose, const double cut[3], dl_aligned_pad *out)
{
    seen_part seen[2];
    if (!align_view(&t->camera.lens, &t->pad.drawn, pose, FINAL_SAMPLES, &seen[0].part)) {
        return 0;
    }
    align_arrow_view(&t->camera.lens, &t->pad.drawn, pose, &seen[1].part);
    return look_parts(t, frame, seen) && align_fit(t, seen, pose, cut, &frame->quality, out);
}

int32_t dl_look(dl_tracker *t, const dl_frame *frame, const dl_start *start, dl_registered_pad *out, double *outline, int64_t outline_points)
{
    dl_pad_pose pose = start->pose;
    if (!t->has_drawing || !is_frame(t, frame) || outline_points < (t->pad.edge_points + 3) / 4) {
        return DL_WRONG_SIZE;
    }
    if (start->coarse) {
        approach(t, frame, start->sigma_tilt_rad, &pose);
    }
    if (!register_pad(t, frame, start, &pose, &out->found, outline)) {
        return 0;
    }
    if (start->alone) {
        return 1;
    }
    out->aligned.tilt_sigmas = 0.0;
    if (!verify_at(t, frame, &out->found.pose, start->cut, &out->aligned)) {
        return 0;
    }
    const dl_pad_verification *judge = &t->pad.verification;
    look_evidence(judge, start->tracked ? judge->tracked : judge->searched, &out->found, &out->aligned, out->evidence, &out->log_odds);
    if (!isfinite(out->log_odds)) {
        return 0;
    }
    look_paint(&start->known, &out->aligned, &out->paint);
    dl_sighting_in_level(&t->camera.lens, t->camera.t_body_cam, &start->prior, &out->found.pose, out->found.cov, &out->seen);
    return 1;
}

int32_t dl_align(dl_tracker *t, const dl_frame *frame, const dl_alignment *how, dl_pad_pose *pose, dl_aligned_pad *out)
{
    seen_part seen;
    uint8_t *at = t->parts;
    if (!t->has_drawing || !is_frame(t, frame)) {
        return DL_WRONG_SIZE;
    }
    out->tilt_sigmas = 0.0;
    if (how->steps > 0 || how->cover) {
        if (!align_view(&t->camera.lens, &t->pad.drawn, pose, SEARCH_SAMPLES, &seen.part) || !look_part(t, frame, &at, &seen)) {
            return 0;
        }
        if (how->cover) {
            return align_cover(t, &seen, pose, &out->cover);
        }
        if (!align_move(t, &seen, how, frame->quality.noise, pose, &out->tilt_sigmas)) {
            return 0;
        }
    }
    return verify_at(t, frame, pose, how->cut, out);
}
