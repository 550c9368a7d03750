/* Compare the drawing at all headings in polar cells. */

#include <math.h>
#include <string.h>

#include "base/vectors.h"
#include "base/wide.h"
#include "vision/search/search.h"
#include "vision/tracker.h"

enum { CELLS = DL_POLAR_RADII * DL_POLAR_ANGLES, VALUES = 4, LANES = 8, HALF_TURN = DL_POLAR_ANGLES / 2 };
/* Work of a heading. */
enum { HEADING_WORK = 35000 };
/* Least depth of a cell, m. */
static const double NEAREST_POINT_M = 1e-3;
/* Area of a paint in view, as a fraction of the whole, below which the paint is ignored. */
static const double LEAST_PAINT = 1e-3;
static const double LEAST_IN_VIEW = 0.02; /* Fraction of the disc in view below which there is no heading. */
static const double WRONG_SIDE = 0.25; /* Factor on a score whose paints are on the wrong sides. */

/* Width of the disc's edge, px, whose pixels see the surroundings, too; from afar they outweigh the H and the ring. */
static const double RIM_PX = 1.2;
static const double WIDEST_RIM = 0.5; /* Greatest share of the radius that is left out for it. */
/* Radius of the disc, px, below which a pixel between H and ring has light of both: there the ring is compared with its
 * outside alone. */
static const double RESOLVED_PX = 20.0;

/* The weight of each cell, and with it its blue, green and red, 0..1. */
typedef struct {
    float of[VALUES][CELLS];
} polar_view;

/* Sums of weight and light of the whole disc, of its ring, and of the outside of the ring; of the squares of light; and of the
 * area in view and of all. */
typedef struct {
    double whole[VALUES], ring[VALUES], outside[VALUES], squares, in_view, area;
} disc_sums;

/* Where the cells lie in the image, and whether they count. */
typedef struct {
    double u[CELLS], v[CELLS], depth[CELLS];
    int32_t counts[CELLS];
} polar_places;

/* The frame's places of the cells for a lens without distortion, px; those behind it are of no use. */
WIDE
static void project_straight(const dl_lens *c, const dl_polar_pad *pad, const dl_pad_pose *pose, polar_places *out)
{
    const double *R = pose->R, *t = pose->t, fx = c->fx, fy = c->fy, cx = c->cx, cy = c->cy;
    for (int k = 0; k < CELLS; k++) {
        const double x = pad->xy_m[2 * k], y = pad->xy_m[2 * k + 1], z = R[6] * x + R[7] * y + t[2];
        out->u[k] = (R[0] * x + R[1] * y + t[0]) / z * fx + cx;
        out->v[k] = (R[3] * x + R[4] * y + t[1]) / z * fy + cy;
        out->depth[k] = z;
    }
}

static void project_distorted(const dl_lens *c, const dl_polar_pad *pad, const dl_pad_pose *pose, polar_places *out)
{
    for (int k = 0; k < CELLS; k++) {
        const double x = pad->xy_m[2 * k], y = pad->xy_m[2 * k + 1];
        double at[3], uv[2];
        for (int i = 0; i < 3; i++) {
            at[i] = pose->R[3 * i] * x + pose->R[3 * i + 1] * y + pose->t[i];
        }
        camera_project(c, at, uv);
        out->u[k] = uv[0], out->v[k] = uv[1], out->depth[k] = at[2];
    }
}

/* Bring the places to an image `step` times smaller, and choose the cells that it has and that lie within a radius, more than
 * `beyond` along a direction. */
WIDE
static void choose(const dl_polar_pad *pad, int32_t step, int w, int h, double within, const double side[2], double beyond,
                   polar_places *of)
{
    const double by = 1.0 / step, within2 = within * within, right = w - 0.5, low = h - 0.5;
    for (int k = 0; k < CELLS; k++) {
        const double x = pad->xy_m[2 * k], y = pad->xy_m[2 * k + 1];
        const double u = (of->u[k] + 0.5) * by - 0.5, v = (of->v[k] + 0.5) * by - 0.5;
        const int in_view = (u > -0.5) & (u < right) & (v > -0.5) & (v < low) & (of->depth[k] > NEAREST_POINT_M);
        of->counts[k] = in_view & (x * x + y * y <= within2) & (x * side[0] + y * side[1] > beyond);
        of->u[k] = u > 0.0 ? u < w - 1.0 ? u : w - 1.0 : 0.0;
        of->v[k] = v > 0.0 ? v < h - 1.0 ? v : h - 1.0 : 0.0;
    }
}

/* The four pixels about each cell that counts, its blue, green and red in the three lowest bytes: at left and at right of the row
 * above, then below. */
typedef struct {
    uint32_t pixel[4][CELLS];
} polar_corners;

/* A pixel and the one at its right, or itself twice at the image's edge. Eight bytes are read where the row has them. */
static inline void read_two(int w, int i, const uint8_t *at, uint32_t *left, uint32_t *right)
{
    if (i + 2 < w) {
        uint64_t both;
        memcpy(&both, at, sizeof both);
        *left = (uint32_t)both;
        *right = (uint32_t)(both >> 24);
    } else {
        const uint8_t *beside = i + 1 < w ? at + 3 : at;
        *left = (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16;
        *right = (uint32_t)beside[0] | (uint32_t)beside[1] << 8 | (uint32_t)beside[2] << 16;
    }
}

static void read_corners(int w, int h, const uint8_t *px, int32_t stride, const polar_places *at, polar_corners *out)
{
    for (int k = 0; k < CELLS; k++) {
        const int i = (int)at->u[k], j = (int)at->v[k];
        const uint8_t *top = px + (size_t)j * (size_t)stride + 3 * (size_t)i, *low = j + 1 < h ? top + stride : top;
        read_two(w, i, top, &out->pixel[0][k], &out->pixel[1][k]);
        read_two(w, i, low, &out->pixel[2][k], &out->pixel[3][k]);
    }
}

/* One channel of each cell between its four pixels, 0..1. */
WIDE
static void interpolate(const polar_places *at, const polar_corners *of, int channel, float *restrict out)
{
    const int shift = 8 * channel;
    for (int k = 0; k < CELLS; k++) {
        const float across = (float)(at->u[k] - (int)at->u[k]), along = (float)(at->v[k] - (int)at->v[k]);
        const int top = (int)(of->pixel[0][k] >> shift & 255), top_right = (int)(of->pixel[1][k] >> shift & 255);
        const int low = (int)(of->pixel[2][k] >> shift & 255), low_right = (int)(of->pixel[3][k] >> shift & 255);
        const float upper = (float)top + across * (float)(top_right - top);
        const float lower = (float)low + across * (float)(low_right - low);
        out[k] = (upper + along * (lower - upper)) * (1.0f / 255.0f);
    }
}

/* The light of the cells that count. */
WIDE
static void set_cell_weights(const dl_polar_pad *pad, const polar_places *at, const float light[3][CELLS], polar_view *out)
{
    for (int r = 0; r < DL_POLAR_RADII; r++) {
        const float weight = (float)pad->area_inside[r];
        for (int k = DL_POLAR_ANGLES * r; k < DL_POLAR_ANGLES * (r + 1); k++) {
            out->of[0][k] = at->counts[k] ? weight : 0.0f;
            for (int i = 0; i < 3; i++) {
                out->of[1 + i][k] = at->counts[k] ? weight * light[i][k] : 0.0f;
            }
        }
    }
}

/* Four floats in a row, as doubles. */
static inline void four_doubles(const float *from, double4 *out)
{
    float4 four;
    memcpy(&four, from, sizeof four);
    *out = __builtin_convertvector(four, double4);
}

/* The sums of the whole disc, of its ring, and of what lies outside of the ring; and of the squares of light. */
WIDE
static void add_up(const dl_polar_pad *pad, const float light[3][CELLS], const polar_view *seen, disc_sums *out)
{
    int outermost = DL_POLAR_RADII - 1;
    while (outermost > 0 && !(pad->ring[outermost] > 0.0)) {
        outermost--;
    }
    memset(out, 0, sizeof *out);
    for (int r = 0; r < DL_POLAR_RADII; r++) {
        double4 sum[VALUES] = {{0.0}}, squares = {0.0}, weighed, bare;
        for (int k = DL_POLAR_ANGLES * r; k < DL_POLAR_ANGLES * (r + 1); k += 4) {
            four_doubles(seen->of[0] + k, &weighed);
            sum[0] += weighed;
            for (int i = 0; i < 3; i++) {
                four_doubles(seen->of[1 + i] + k, &weighed);
                four_doubles(light[i] + k, &bare);
                sum[1 + i] += weighed;
                squares += weighed * bare;
            }
        }
        out->area += DL_POLAR_ANGLES * pad->area_inside[r];
        out->squares += (squares[0] + squares[1]) + (squares[2] + squares[3]);
        for (int value = 0; value < VALUES; value++) {
            const double all = (sum[value][0] + sum[value][1]) + (sum[value][2] + sum[value][3]);
            out->whole[value] += all;
            out->ring[value] += all * pad->ring[r];
            out->outside[value] += r > outermost ? all : 0.0;
        }
    }
    out->in_view = out->whole[0];
}

static void read_view(const dl_lens *c, const dl_polar_pad *pad, const dl_image *image, int32_t step, const dl_pad_pose *pose,
                      const double *side, polar_view *out, disc_sums *sums)
{
    const int w = (int)image->width, h = (int)image->height;
    const double rim_m = RIM_PX * step * pose->t[2] / c->fx, within = pad->radius_m - fmin(rim_m, WIDEST_RIM * pad->radius_m);
    const double any_side[2] = {0.0, 0.0};
    polar_places at;
    polar_corners of;
    float light[3][CELLS];
    if (c->distorted) {
        project_distorted(c, pad, pose, &at);
    } else {
        project_straight(c, pad, pose, &at);
    }
    choose(pad, step, w, h, within, side ? side : any_side, side ? 0.0 : -1.0, &at);
    read_corners(w, h, image->px, (int32_t)image->stride, &at, &of);
    for (int i = 0; i < 3; i++) {
        interpolate(&at, &of, i, light[i]);
    }
    set_cell_weights(pad, &at, (const float(*)[CELLS])light, out);
    add_up(pad, (const float(*)[CELLS])light, out, sums);
}

void search_shape(const double *shape, ring_shape *out)
{
    int same = 1;
    for (int a = 0; a < HALF_TURN; a++) {
        same &= shape[a] == shape[a + HALF_TURN];
    }
    out->n = 0;
    out->turns = same ? HALF_TURN : DL_POLAR_ANGLES;
    for (int a = 0; a < out->turns; a++) {
        out->cell[out->n] = a;
        out->share[out->n] = (float)shape[a];
        out->n += shape[a] > 0.0;
    }
}

/* Add the light of a ring under its shape, at all turns and eight of them at once. */
WIDE
static void add_turned(const ring_shape *of, const float *ring, float *out)
{
    float around[2 * DL_POLAR_ANGLES];
    float8 sum[DL_POLAR_ANGLES / LANES] = {{0.0f}};
    const int turns = of->turns;
    if (turns == HALF_TURN) {
        for (int a = 0; a < HALF_TURN; a++) {
            around[a] = around[a + HALF_TURN] = ring[a] + ring[a + HALF_TURN];
        }
        for (int k = 0; k < of->n; k++) {
            for (int i = 0; i < HALF_TURN / LANES; i++) {
                sum[i] += of->share[k] * *eight_of(around + of->cell[k] + LANES * i);
            }
        }
    } else {
        memcpy(around, ring, DL_POLAR_ANGLES * sizeof *around);
        memcpy(around + DL_POLAR_ANGLES, ring, DL_POLAR_ANGLES * sizeof *around);
        for (int k = 0; k < of->n; k++) {
            for (int i = 0; i < DL_POLAR_ANGLES / LANES; i++) {
                sum[i] += of->share[k] * *eight_of(around + of->cell[k] + LANES * i);
            }
        }
    }
    for (int i = 0; i < DL_POLAR_ANGLES / LANES; i++) {
        *eight(out + LANES * i) += sum[i % (turns / LANES)];
    }
}

/* Weighted light under a shape that is turned by every whole number of cells: correlation along the angle. The drawing's shapes
 * cover few cells, so those are added one by one. */
static void turned_sums(const polar_view *seen, const ring_shape rings[DL_POLAR_RADII], float out[VALUES][DL_POLAR_ANGLES])
{
    memset(out, 0, sizeof(float) * DL_POLAR_ANGLES * VALUES);
    for (int ring = 0; ring < DL_POLAR_RADII; ring++) {
        for (int value = 0; value < VALUES && rings[ring].n > 0; value++) {
            add_turned(&rings[ring], seen->of[value] + DL_POLAR_ANGLES * ring, out[value]);
        }
    }
}

/* At each heading the variance between the paints, as a fraction of all; less if a paint lies on the wrong side of another.
 *
 * The ring's red is compared with that of the disc about it, or of the disc outside of it where pixels mix it with the H. A paint
 * with less than `least` in view is ignored. */
WIDE
static void rate(const float h[VALUES][DL_POLAR_ANGLES], const float arrow[VALUES][DL_POLAR_ANGLES], const disc_sums *of, double least,
                 double spread, double polarity, int resolved, double score[DL_POLAR_ANGLES])
{
    const double *whole = of->whole, *ring = of->ring;
    for (int k = 0; k < DL_POLAR_ANGLES; k++) {
        const double n_h = (double)h[0][k], n_ring = ring[0] + (double)arrow[0][k], n_disc = whole[0] - n_h - n_ring;
        const double some_h = n_h > least ? n_h : least, some_ring = n_ring > least ? n_ring : least;
        const double some_disc = n_disc > least ? n_disc : least, n_outside = of->outside[0] - (double)arrow[0][k];
        double between = 0.0, apart = 1.0, red_ring = 0.0, red_disc = 0.0;
        for (int c = 1; c < VALUES; c++) {
            const double in_h = (double)h[c][k], in_ring = ring[c] + (double)arrow[c][k], in_disc = whole[c] - in_h - in_ring;
            const double mean_h = in_h / some_h, mean_disc = in_disc / some_disc;
            red_ring = in_ring / some_ring, red_disc = mean_disc;
            between -= whole[c] * whole[c] / whole[0];
            between += n_h > least ? in_h * mean_h : 0.0;
            between += n_ring > least ? in_ring * red_ring : 0.0;
            between += n_disc > least ? in_disc * mean_disc : 0.0;
            const double over_disc = polarity * (mean_h - mean_disc);
            apart = over_disc < apart ? over_disc : apart;
        }
        const double red_outside = (of->outside[VALUES - 1] - (double)arrow[VALUES - 1][k]) / n_outside;
        const double beside = (resolved | !(n_outside > least)) ? red_disc : red_outside;
        const int h_wrong = (n_h > least) & !(apart > 0.0), ring_wrong = (n_ring > least) & !(polarity * (red_ring - beside) > 0.0);
        score[k] = ((n_disc > least) & (h_wrong | ring_wrong) ? WRONG_SIDE : 1.0) * between / spread;
    }
}

int search_heading(const dl_tracker *t, const dl_image *image, int32_t step, const dl_pad_pose *pose, const double *side, dl_polar_fit *out)
{
    const dl_lens *c = &t->camera.lens;
    const dl_polar_pad *pad = &t->pad.polar;
    polar_view seen;
    float h[VALUES][DL_POLAR_ANGLES], arrow[VALUES][DL_POLAR_ANGLES];
    double score[DL_POLAR_ANGLES];
    disc_sums of;
    count_work(t, 1, HEADING_WORK);
    read_view(c, pad, image, step, pose, side, &seen, &of);
    if (!(of.in_view >= LEAST_IN_VIEW * of.area)) {
        return 0;
    }
    const int resolved = c->fx * pad->radius_m >= RESOLVED_PX * step * pose->t[2];
    double spread = of.squares;
    for (int k = 0; k < 3; k++) {
        spread -= of.whole[1 + k] * of.whole[1 + k] / of.whole[0];
    }
    if (!(spread > 1e-6 * of.area)) {
        return 0;
    }
    turned_sums(&seen, t->lettering, h);
    turned_sums(&seen, t->arrow, arrow);
    rate((const float(*)[DL_POLAR_ANGLES])h, (const float(*)[DL_POLAR_ANGLES])arrow, &of, LEAST_PAINT * of.area, spread, pad->polarity,
         resolved, score);
    int best = 0;
    for (int k = 0; k < DL_POLAR_ANGLES; k++) {
        best = score[k] > score[best] ? k : best;
    }
    const double before = score[(best + DL_POLAR_ANGLES - 1) % DL_POLAR_ANGLES], after = score[(best + 1) % DL_POLAR_ANGLES];
    const double bend = before - 2.0 * score[best] + after;
    const double fine = bend < -1e-9 ? 0.5 * (before - after) / bend : 0.0;
    out->turn_rad = (best + fine) * 2.0 * acos(-1.0) / DL_POLAR_ANGLES;
    out->score = score[best];
    out->arrow = score[best] - score[(best + DL_POLAR_ANGLES / 2) % DL_POLAR_ANGLES];
    out->in_view = of.in_view / of.area;
    return 1;
}

int32_t dl_search_heading(dl_tracker *t, const dl_image *image, int32_t step, const dl_pad_pose *pose, const double *side, dl_polar_fit *out)
{
    if (!t->has_drawing || !is_image(image, 3) || step < 1) {
        return DL_WRONG_SIZE;
    }
    return search_heading(t, image, step, pose, side, out);
}
