/* Sample profiles across the edges of a drawing, and drop those of something else. */

#include "vision/register/profiles.h"

#include <math.h>
#include <string.h>

#include "vision/tracker.h"

static const double SPACING_PX = 1.3; /* Smallest distance between profiles along an edge, px. */
static const double NEAREST_PROFILE_M = 0.02; /* Depth from which a point is in front of the camera, m. */
/* The coverage by another figure up to which a pixel shows none of it: a normal integral of three deviations. */
static const float FOREIGN = 0.00135f;
/* The fewest edge points in view. */
enum { SEEN_MIN = 8, NUMBERS = 5, EMPTY = -1 };

/* An edge point in the frame: its pixel, the change of the pixel along the normal per metre, the way along the edges so far. */
typedef struct {
    double uv[2], out[2], way_px;
} sighted;

static int see_point(const view *v, const fit_state *s, const double *at, int half, double margin, sighted *seen)
{
    const dl_lens *camera = v->camera;
    double p[3], way[3];
    in_camera(s, at[0], at[1], p);
    for (int i = 0; i < 3; i++) {
        way[i] = s->R[3 * i] * at[2] + s->R[3 * i + 1] * at[3];
    }
    const double *cut = v->cut;
    if (!(p[2] > NEAREST_PROFILE_M) || cut[0] * p[0] + cut[1] * p[1] + (cut[2] - margin) * p[2] < 0.0) {
        return 0;
    }
    camera_project(camera, p, seen->uv);
    if (camera->distorted) {
        const double step = 1e-4, ahead[3] = {p[0] + step * way[0], p[1] + step * way[1], p[2] + step * way[2]};
        double uv[2];
        camera_project(camera, ahead, uv);
        seen->out[0] = (uv[0] - seen->uv[0]) / step, seen->out[1] = (uv[1] - seen->uv[1]) / step;
    } else {
        const double per = 1.0 / p[2];
        seen->out[0] = camera->fx * per * (way[0] - p[0] * per * way[2]);
        seen->out[1] = camera->fy * per * (way[1] - p[1] * per * way[2]);
    }
    const double middle[2] = {0.5 * ((double)camera->width - 1.0), 0.5 * ((double)camera->height - 1.0)};
    return isfinite(seen->out[0] + seen->out[1]) && fabs(seen->uv[0] - middle[0]) < middle[0] - (half + 1.0) &&
           fabs(seen->uv[1] - middle[1]) < middle[1] - (half + 1.0);
}

/* The edge points in view, one after the other in `seen` with their indices in `index`; returns their number. */
static int see_edges(const view *v, const fit_state *s, const edge_points *edges, int half, sighted *seen, int32_t *index,
                     double in_view[DL_EDGE_KINDS])
{
    int n = 0, total[DL_EDGE_KINDS] = {0}, visible[DL_EDGE_KINDS] = {0};
    const double margin = (half + 1.0) / v->camera->fx * hypot(v->cut[0], v->cut[1]);
    double way = 0.0;
    for (int i = 0; i < edges->points; i++) {
        const int kind = edges->of[2 * i];
        total[kind]++;
        if (see_point(v, s, edges->at + NUMBERS * i, half, margin, &seen[n])) {
            way += hypot(seen[n].out[0], seen[n].out[1]) * edges->at[NUMBERS * i + 4];
            seen[n].way_px = way;
            index[n++] = i;
            visible[kind]++;
        }
    }
    for (int kind = 0; kind < DL_EDGE_KINDS; kind++) {
        in_view[kind] = total[kind] ? (double)visible[kind] / total[kind] : 0.0;
    }
    return n;
}

/* The place of a pixel in an open hash table of pixels and those that use them. Source: Knuth, The Art of Computer Programming 3,
 * sec. 6.4. */
static int32_t *slot_of(int32_t *table, int32_t mask, int32_t pixel)
{
    uint32_t at = (uint32_t)pixel * 2654435761u >> 12;
    while (table[2 * (at & (uint32_t)mask)] != EMPTY && table[2 * (at & (uint32_t)mask)] != pixel) {
        at++;
    }
    return table + 2 * (at & (uint32_t)mask);
}

/* Add the pixels of one profile. */
static void add_profile(const view *v, const sighted *at, int half, int32_t *table, int32_t mask, profiles *out)
{
    const double along = fabs(at->out[1]) > fabs(at->out[0]) ? at->out[1] : at->out[0], per = 1.0 / (fabs(along) > 1e-9 ? along : 1e-9);
    for (int k = -half; k <= half; k++, out->n++) {
        const int32_t x = (int32_t)rint(at->uv[0] + k * at->out[0] * per), y = (int32_t)rint(at->uv[1] + k * at->out[1] * per);
        const int32_t pixel = y * (int32_t)v->camera->width + x;
        int32_t *slot = slot_of(table, mask, pixel);
        double ray[2];
        if (slot[0] == pixel) {
            out->usable[slot[1]] = 0.0f;
        }
        slot[0] = pixel, slot[1] = out->n;
        pixel_ray(v->camera, v->rays, x, y, ray);
        out->ray_x[out->n] = (float)ray[0], out->ray_y[out->n] = (float)ray[1];
        out->usable[out->n] = 1.0f;
        for (int c = 0; c < CHANNELS; c++) {
            out->light[c][out->n] = v->light[v->pixels[3 * (int64_t)pixel + c]];
        }
    }
}

/* Fill the last group up to whole lanes. */
static void end_group(profiles *out)
{
    if (out->groups == 0) {
        return;
    }
    group *last = &out->each[out->groups - 1];
    last->length = out->n - last->begin;
    for (; out->n % LANES; out->n++) {
        const int from = out->n - 1;
        out->ray_x[out->n] = out->ray_x[from], out->ray_y[out->n] = out->ray_y[from], out->usable[out->n] = 0.0f;
        for (int c = 0; c < CHANNELS; c++) {
            out->light[c][out->n] = out->light[c][from];
        }
    }
    last->end = out->n;
}

static int begin_group(profiles *out, int kind)
{
    end_group(out);
    if (out->groups == GROUPS_MAX) {
        return 0;
    }
    out->each[out->groups].begin = out->n;
    out->each[out->groups++].kind = kind;
    out->groups_of_kind[kind]++;
    return 1;
}

/* Where the pixels of each kind begin; kinds without any lie between their neighbours. */
static void mark_kinds(profiles *p)
{
    int at = 0;
    for (int kind = 0; kind < DL_EDGE_KINDS; kind++) {
        p->kind_begin[kind] = at < p->groups ? p->each[at].begin : p->n;
        at += p->groups_of_kind[kind];
    }
    p->kind_begin[DL_EDGE_KINDS] = p->n;
}

int sample_profiles(const view *v, const fit_state *s, const edge_points *edges, int half, const profile_work *work, profiles *out)
{
    const int room = work->room;
    sighted *seen = (sighted *)(void *)work->doubles;
    int32_t *index = (int32_t *)(void *)work->keys, *table = index + room, mask = 1;
    const int n = edges->points <= room ? see_edges(v, s, edges, half, seen, index, out->in_view) : 0;
    if (n < SEEN_MIN || !isfinite(seen[n - 1].way_px)) {
        return 0;
    }
    const double spacing = fmax(SPACING_PX, seen[n - 1].way_px / PROFILES);
    int64_t tick = -1;
    int piece = -1, in_piece = 0;
    while (4 * (mask + 1) <= 4 * room) {
        mask = 2 * mask + 1;
    }
    memset(table, EMPTY, (size_t)(2 * (mask + 1)) * sizeof *table);
    out->n = out->groups = 0, out->samples = 2 * half + 1;
    memset(out->groups_of_kind, 0, sizeof out->groups_of_kind);
    for (int i = 0; i < n; i++) {
        /* The last point lies at the end of the last stretch, where rounding would decide whether it begins another. */
        const int64_t here = (int64_t)fmin(seen[i].way_px / spacing, PROFILES - 1.0);
        if (here == tick) {
            continue;
        }
        tick = here;
        const int32_t *of = edges->of + 2 * index[i];
        in_piece = of[1] == piece ? in_piece + 1 : 0;
        piece = of[1];
        if (out->n + out->samples + 2 * LANES > room || (in_piece % IN_GROUP == 0 && !begin_group(out, of[0]))) {
            return 0;
        }
        add_profile(v, &seen[i], half, table, mask, out);
    }
    end_group(out);
    mark_kinds(out);
    return 1;
}

/* Let no pixel of a kind count where another figure has an edge: it has to cover a pixel wholly, or none of it. */
static void drop_beside(const dl_pad_shape *pad, const footprint *f, int kind, float *spare, profiles *p)
{
    const dl_edge_zone *zone = &pad->zones[kind];
    const int begin = p->kind_begin[kind], count = p->kind_begin[kind + 1] - begin, on = zone->on_figure >= 0;
    const int64_t figure = on ? zone->on_figure : zone->beside_figure;
    if (figure < 0 || !count) {
        return;
    }
    cover_figure(&pad->figures[figure], f, begin, count, 0, spare);
    for (int i = 0; i < count; i++) {
        const float other = on ? 1.0f - spare[i] : spare[i];
        p->usable[begin + i] = other > FOREIGN ? 0.0f : p->usable[begin + i];
    }
}

void drop_foreign(const dl_pad_shape *pad, const fit_state *s, const footprint *f, float *spare, profiles *p)
{
    const double clear = 3.0 * sigma_px(s) * s->m_per_px;
    for (int g = 0; g < p->groups; g++) {
        const dl_edge_zone *zone = &pad->zones[p->each[g].kind];
        for (int i = p->each[g].begin; i < p->each[g].end; i++) {
            const double x = f->x[i], y = f->y[i], r = sqrt(x * x + y * y);
            const int in_box = x > zone->box_m[0] - clear && x < zone->box_m[1] + clear && y > zone->box_m[2] - clear &&
                               y < zone->box_m[3] + clear && r < zone->box_radius_m + clear;
            if (r < zone->inside_m + clear || r > zone->outside_m - clear || in_box || zone->thinnest_m < 2.0 * clear) {
                p->usable[i] = 0.0f;
            }
        }
    }
    for (int kind = 0; kind < DL_EDGE_KINDS; kind++) {
        drop_beside(pad, f, kind, spare, p);
    }
}
