/* Make a tracker, and check the sizes of what is given to it. */

#include "vision/tracker.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "vision/align/align.h"
#include "vision/lamps/lamps.h"
#include "vision/register/register.h"
#include "vision/search/search.h"

/* Limits of a frame's sides and of a map's, px and cells: what is larger is a mistake. */
enum { SIDE_MAX = 16384, MAP_MAX = 16384, POINTS_MAX = 1 << 24 };

static int within(int64_t value, int64_t least, int64_t most)
{
    return value >= least && value <= most;
}

/* Whether all of some numbers lie within limits. */
static int all_within(const int64_t *values, int64_t count, int64_t least, int64_t most)
{
    for (int64_t i = 0; i < count; i++) {
        if (!within(values[i], least, most)) {
            return 0;
        }
    }
    return 1;
}

int is_image(const dl_image *image, int channels)
{
    return image != NULL && image->px != NULL && image->channels == channels && within(image->width, 1, SIDE_MAX)
           && within(image->height, 1, SIDE_MAX) && within(image->stride, channels * image->width, INT32_MAX);
}

int is_frame(const dl_tracker *t, const dl_frame *frame)
{
    const int64_t w = t->camera.lens.width, h = t->camera.lens.height;
    if (!is_image(&frame->level[0], 3) || frame->level[0].stride != 3 * w) {
        return 0;
    }
    for (int k = 0; k <= FRAME_LEVELS; k++) {
        const dl_image *one = &frame->level[k];
        const int64_t wide = w >> k > 0 ? w >> k : 1, high = h >> k > 0 ? h >> k : 1;
        if (one->px != NULL && (!is_image(one, 3) || one->width != wide || one->height != high)) {
            return 0;
        }
    }
    return 1;
}

static int is_region(const pad_region *region)
{
    return within(region->circles, 0, REGION_CIRCLES) && within(region->figure, -1, PAD_FIGURES - 1);
}

static int is_figure(const pad_figure *f)
{
    const int64_t n = f->rectangles;
    return within(n, 0, FIGURE_RECTANGLES) && within(f->x_cuts, 0, FIGURE_CUTS) && within(f->y_cuts, 0, FIGURE_CUTS)
           && within(f->sides, 0, FIGURE_SIDES) && all_within(f->x0, n, 0, f->x_cuts - 1) && all_within(f->x1, n, 0, f->x_cuts - 1)
           && all_within(f->y0, n, 0, f->y_cuts - 1) && all_within(f->y1, n, 0, f->y_cuts - 1);
}

static int is_shape(const pad_shape *s)
{
    int all = within(s->contrast_count, 1, PAD_CONTRASTS) && within(s->pointer_kind, -1, EDGE_KINDS - 1)
              && within(s->pointer_contrast, -1, PAD_CONTRASTS - 1) && within(s->pointer_figure, -1, PAD_FIGURES - 1)
              && all_within(s->lies_on, PAD_CONTRASTS, -1, PAD_CONTRASTS - 1)
              && all_within(s->contrast_of_kind, EDGE_KINDS, -1, PAD_CONTRASTS - 1)
              && all_within(s->paint_of_kind, EDGE_KINDS, 0, EDGE_KINDS - 1) && within(s->wedge.sides, 0, WEDGE_SIDES);
    for (int k = 0; k < PAD_CONTRASTS; k++) {
        all &= is_region(&s->contrasts[k]);
    }
    for (int k = 0; k < EDGE_KINDS; k++) {
        all &= is_region(&s->kinds[k]) && within(s->zones[k].on_figure, -1, PAD_FIGURES - 1)
               && within(s->zones[k].beside_figure, -1, PAD_FIGURES - 1);
    }
    for (int k = 0; k < PAD_FIGURES; k++) {
        all &= is_figure(&s->figures[k]);
    }
    return all;
}

/* Whether a drawing's numbers of parts are some that there can be. */
static int is_drawing(const dl_pad *pad, const int32_t *edge_of)
{
    const pad_template *p = &pad->drawn;
    if (!is_shape(&pad->shape) || !within(p->n, 5, MAP_MAX) || !within(p->disc_channel, 0, 2) || !within(pad->edge_points, 0, POINTS_MAX)
        || !within(p->arrow_rows, 0, MAP_MAX) || !within(p->arrow_columns, 0, MAP_MAX)) {
        return 0;
    }
    for (int64_t i = 0; i < pad->edge_points; i++) {
        if (!within(edge_of[2 * i], 0, EDGE_KINDS - 1) || !within(edge_of[2 * i + 1], 0, POINTS_MAX)) {
            return 0;
        }
    }
    return 1;
}

static int64_t larger(int64_t one, int64_t other)
{
    return one > other ? one : other;
}

/* The numbers of four bytes that the scratch has: what a part of a level of the largest size takes, which has a row and a column
 * more at either end, and what a search of a whole frame and its registration take. */
static int64_t scratch_of(const dl_tracker *t)
{
    const camera_lens *c = &t->camera.lens;
    const int64_t highest = (c->width * c->height) >> (2 * FRAME_LEVELS), around = 2 * (c->width + c->height) + 4;
    const int64_t samples = larger(FINAL_SAMPLES, highest) + around;
    const int64_t aligned = larger((int64_t)align_room(samples, 1), (int64_t)FIT_ROWS * t->row) + c->width;
    return larger(aligned, larger(search_most(c->width, c->height), lamps_room(c)));
}

static void read_light(dl_tracker *t)
{
    for (int i = 0; i < 256; i++) {
        const double light = t->camera.light[i];
        t->lights[i] = (float)light, t->lights[256 + i] = (float)sqrt(light), t->lights[512 + i] = (float)t->camera.log_light[i];
        t->linear[i] = (float)(i / 255.0);
        t->lamp_light[i] = (uint16_t)(light >= 0.0 && light <= 1.0 ? rint(65535.0 * light) : 0.0);
    }
}

dl_tracker *dl_tracker_new(const dl_camera *camera, const double *rays, const dl_pad *pad, const int16_t *coverage,
                           const int16_t *local, const double *edges, const int32_t *edge_of)
{
    const camera_lens *c = &camera->lens;
    if (!within(c->width, 1, SIDE_MAX) || !within(c->height, 1, SIDE_MAX) || (c->distorted && rays == NULL)) {
        return NULL;
    }
    if (pad != NULL && (!coverage || !local || !edges || !edge_of || !is_drawing(pad, edge_of))) {
        return NULL;
    }
    dl_tracker *t = calloc(1, sizeof *t);
    if (t == NULL) {
        return NULL;
    }
    t->camera = *camera, t->rays = c->distorted ? rays : NULL;
    t->maps = coverage, t->local_maps = local, t->edges = edges, t->edge_of = edge_of;
    t->has_drawing = pad != NULL;
    if (pad != NULL) {
        t->pad = *pad;
    }
    read_light(t);
    t->row = register_row(t->pad.edge_points);
    t->floats = scratch_of(t);
    t->part_bytes = 2 * (3 * c->width * c->height / 4) + 24 * c->width + 96;
    t->scratch = calloc((size_t)t->floats, sizeof *t->scratch);
    t->parts = calloc((size_t)t->part_bytes, 1);
    if (t->scratch == NULL || t->parts == NULL) {
        dl_tracker_free(t);
        return NULL;
    }
    return t;
}

void dl_tracker_free(dl_tracker *t)
{
    if (t != NULL) {
        free(t->scratch);
        free(t->parts);
        free(t);
    }
}
