/* Make a tracker, and check the sizes of what is given to it. */

#include "vision/tracker.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "vision/align/align.h"
#include "vision/lamps/lamps.h"
#include "vision/register/register.h"
#include "vision/search/search.h"

/* Limits of a map's sides and of an outline's points: what is larger is a mistake. */
enum { MAP_MAX = 16384, POINTS_MAX = 1 << 24 };

/* Whether all of some numbers lie within limits. */
static int all_within(const int64_t *values, int64_t count, int64_t least, int64_t most)
{
    for (int64_t i = 0; i < count; i++) {
        if (!lies_within(values[i], least, most)) {
            return 0;
        }
    }
    return 1;
}

static int is_region(const dl_pad_region *region)
{
    return lies_within(region->circles, 0, DL_REGION_CIRCLES) && lies_within(region->figure, DL_NONE, DL_PAD_FIGURES - 1);
}

static int is_figure(const dl_pad_figure *f)
{
    const int64_t n = f->rectangles;
    return lies_within(n, 0, DL_FIGURE_RECTANGLES) && lies_within(f->x_cuts, 0, DL_FIGURE_CUTS)
        && lies_within(f->y_cuts, 0, DL_FIGURE_CUTS)
           && lies_within(f->sides, 0, DL_FIGURE_SIDES) && all_within(f->x0, n, 0, f->x_cuts - 1)
           && all_within(f->x1, n, 0, f->x_cuts - 1)
           && all_within(f->y0, n, 0, f->y_cuts - 1) && all_within(f->y1, n, 0, f->y_cuts - 1);
}

static int is_shape(const dl_pad_shape *s)
{
    int all = lies_within(s->contrast_count, 1, DL_PAD_CONTRASTS) && lies_within(s->pointer_kind, DL_NONE, DL_EDGE_KINDS - 1)
              && lies_within(s->pointer_contrast, DL_NONE, DL_PAD_CONTRASTS - 1) && lies_within(s->pointer_figure, -1, DL_PAD_FIGURES - 1)
              && all_within(s->lies_on, DL_PAD_CONTRASTS, DL_NONE, DL_PAD_CONTRASTS - 1)
              && all_within(s->contrast_of_kind, DL_EDGE_KINDS, DL_NONE, DL_PAD_CONTRASTS - 1)
              && all_within(s->paint_of_kind, DL_EDGE_KINDS, 0, DL_EDGE_KINDS - 1) && lies_within(s->wedge.sides, 0, DL_WEDGE_SIDES);
    for (int k = 0; k < DL_PAD_CONTRASTS; k++) {
        all &= is_region(&s->contrasts[k]);
    }
    for (int k = 0; k < DL_EDGE_KINDS; k++) {
        all &= is_region(&s->kinds[k]) && lies_within(s->zones[k].on_figure, DL_NONE, DL_PAD_FIGURES - 1)
               && lies_within(s->zones[k].beside_figure, DL_NONE, DL_PAD_FIGURES - 1);
    }
    for (int k = 0; k < DL_PAD_FIGURES; k++) {
        all &= is_figure(&s->figures[k]);
    }
    return all;
}

/* Whether a drawing's numbers of parts are some that there can be. */
static int is_drawing(const dl_pad *pad, const int32_t *edge_of)
{
    const dl_pad_template *p = &pad->drawn;
    if (!is_shape(&pad->shape) || !lies_within(p->n, 5, MAP_MAX) || !lies_within(p->disc_channel, 0, 2)
        || !lies_within(pad->edge_points, 0, POINTS_MAX)
        || !lies_within(p->arrow_rows, 0, MAP_MAX) || !lies_within(p->arrow_columns, 0, MAP_MAX)) {
        return 0;
    }
    for (int64_t i = 0; i < pad->edge_points; i++) {
        if (!lies_within(edge_of[2 * i], 0, DL_EDGE_KINDS - 1) || !lies_within(edge_of[2 * i + 1], 0, POINTS_MAX)) {
            return 0;
        }
    }
    return 1;
}

/* Whether a camera's sides are some that there can be, and a lens that bends them has its rays. */
static int is_camera(const dl_lens *c, const double *rays)
{
    return lies_within(c->width, 1, FRAME_SIDE_MAX) && lies_within(c->height, 1, FRAME_SIDE_MAX) && !(c->distorted && rays == NULL);
}

static int64_t larger(int64_t one, int64_t other)
{
    return one > other ? one : other;
}

/* The numbers of four bytes that the scratch has: what a part of a level of the largest size takes, which has a row and a column
 * more at either end, and what a search of a whole frame and its registration take. */
static int64_t scratch_of(const dl_tracker *t)
{
    const dl_lens *c = &t->camera.lens;
    const int64_t highest = (c->width * c->height) >> (2 * DL_FRAME_LEVELS), around = 2 * (c->width + c->height) + 4;
    const int64_t most = larger(FINAL_SAMPLES, highest) + around;
    pixels from;
    samples of;
    const int64_t aligned = larger(align_divide(most, 1, NULL, &from, &of), (int64_t)FIT_ROWS * t->row) + c->width;
    return larger(aligned, larger(search_most(c->width, c->height), lamps_room(c)));
}

static void read_light(dl_tracker *t)
{
    for (int i = 0; i < 256; i++) {
        const double light = t->camera.light[i];
        t->lights[i] = (float)light, t->lights[256 + i] = (float)sqrt(light), t->lights[512 + i] = (float)t->camera.log_light[i];
        t->lamp_light[i] = (uint16_t)(light >= 0.0 && light <= 1.0 ? rint(65535.0 * light) : 0.0);
    }
}

dl_tracker *dl_tracker_new(const dl_camera *camera, const double *rays, const dl_pad *pad, const int16_t *coverage,
                           const int16_t *local, const double *edges, const int32_t *edge_of, int64_t *work)
{
    const dl_lens *c = &camera->lens;
    const int has_maps = coverage && local && edges && edge_of;
    if (!is_camera(c, rays) || (pad != NULL && !(has_maps && is_drawing(pad, edge_of)))) {
        return NULL;
    }
    dl_tracker *t = calloc(1, sizeof *t);
    if (t == NULL) {
        return NULL;
    }
    t->work = work ? work : &t->uncounted;
    t->camera = *camera, t->rays = c->distorted ? rays : NULL;
    t->maps = coverage, t->local_maps = local, t->edges = edges, t->edge_of = edge_of;
    t->has_drawing = pad != NULL;
    if (pad != NULL) {
        t->pad = *pad;
    }
    for (int ring = 0; ring < DL_POLAR_RADII; ring++) {
        search_shape(t->pad.polar.h_marking + DL_POLAR_ANGLES * ring, &t->lettering[ring]);
        search_shape(t->pad.polar.arrow + DL_POLAR_ANGLES * ring, &t->arrow[ring]);
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
