/* Fit a circle to the edges around a peak of the votes. */

#include <math.h>
#include <string.h>

#include "vision/search/search.h"

/* Tolerance of each fit, as a fraction of the radius, and the least cosine between an edge's gradient and the way to the centre. */
enum { FITS = 4, FEWEST = 8 };
static const double TOLERANCE[FITS] = {0.24, 0.16, 0.11, 0.08};
static const double LEAST_ALONG = 0.85; /* That cosine. */
/* Least fraction of the outline with an edge. */
static const double LEAST_SUPPORT = 0.22;

/* A circle on the plane, and the box in px that holds the edges that may belong to it. */
typedef struct {
    double centre[2], radius, sign;
    float x, y, reach;
} circle_trial;

/* Sums of Kasa's equations about the circle_trial's centre. */
typedef struct {
    int n;
    double x, y, xx, xy, yy, zx, zy, z;
} kasa_sums;

/* Whether an edge's gradient points at the circle_trial's place. */
static int points_at(const edge_list *e, int i, const circle_trial *t)
{
    const double dx = (double)(t->x - e->x[i]), dy = (double)(t->y - e->y[i]), tx = (double)e->to_x[i], ty = (double)e->to_y[i];
    const double along = t->sign * (tx * dx + ty * dy), length = (tx * tx + ty * ty) * (dx * dx + dy * dy);
    return along > 0.0 && along * along > LEAST_ALONG * LEAST_ALONG * length;
}

/* Choose the edges in the circle_trial's box that point at its place. None of that depends on the fit. */
static void choose(const search_image *image, const search_rows *rows, const circle_trial *t, edge_choice *out)
{
    const edge_list *e = &rows->edges;
    const double h = (double)image->height;
    const int top = (int)fmax(0.0, fmin(h, (double)(t->y - t->reach)));
    const int low = (int)fmax(0.0, fmin(h, ceil((double)(t->y + t->reach))));
    out->n = 0;
    for (int i = e->first[top]; i < e->first[low]; i++) {
        if (fabsf(t->x - e->x[i]) <= t->reach && points_at(e, i, t)
            && search_place(&rows->blocks, e->x[i], e->y[i], out->places + 2 * out->n)) {
            out->edge[out->n++] = i;
        }
    }
}

/* Whether a chosen edge lies on a circle_trial within a tolerance; its place relative to the circle_trial's centre. */
static int lies_on(const edge_choice *of, int i, const circle_trial *t, double tolerance, double at[2])
{
    at[0] = of->places[2 * i] - t->centre[0];
    at[1] = of->places[2 * i + 1] - t->centre[1];
    return fabs(sqrt(at[0] * at[0] + at[1] * at[1]) - t->radius) < tolerance * t->radius;
}

/* Fit a circle to the edges that lie on a circle_trial.
 *
 * Source: Kasa, A circle fitting procedure and its error analysis, IEEE Trans. Instrumentation and Measurement 25, 1976. */
static int fit_once(const edge_choice *of, double tolerance, circle_trial *t)
{
    kasa_sums s;
    memset(&s, 0, sizeof s);
    for (int i = 0; i < of->n; i++) {
        double at[2];
        if (lies_on(of, i, t, tolerance, at)) {
            const double z = at[0] * at[0] + at[1] * at[1];
            s.n++;
            s.x += at[0], s.y += at[1], s.z += z;
            s.xx += at[0] * at[0], s.xy += at[0] * at[1], s.yy += at[1] * at[1];
            s.zx += z * at[0], s.zy += z * at[1];
        }
    }
    if (s.n < FEWEST) {
        return 0;
    }
    const double n = (double)s.n, xx = s.xx - s.x * s.x / n, yy = s.yy - s.y * s.y / n, xy = s.xy - s.x * s.y / n;
    const double bx = 0.5 * (s.zx - s.z * s.x / n), by = 0.5 * (s.zy - s.z * s.y / n), det = xx * yy - xy * xy;
    if (!(det > 1e-4 * (xx + yy) * (xx + yy))) {
        return 0;
    }
    const double cx = (bx * yy - by * xy) / det, cy = (by * xx - bx * xy) / det;
    const double radius2 = s.z / n - 2.0 * (cx * s.x + cy * s.y) / n + cx * cx + cy * cy;
    const double moved = hypot(cx, cy);
    if (!(radius2 > 0.3 * t->radius * t->radius && radius2 < 2.5 * t->radius * t->radius && moved < 0.6 * t->radius)) {
        return 0;
    }
    t->centre[0] += cx;
    t->centre[1] += cy;
    t->radius = sqrt(radius2);
    return 1;
}

/* The edge nearest to the circle in each sector. */
static int outline(const search_image *image, const search_rows *rows, const edge_choice *of, const circle_trial *t, dl_circle *out)
{
    const double by = DL_SEARCH_SECTORS / (2.0 * acos(-1.0)), step = (double)image->step;
    double nearest[DL_SEARCH_SECTORS];
    int found[DL_SEARCH_SECTORS], n = 0;
    for (int k = 0; k < DL_SEARCH_SECTORS; k++) {
        nearest[k] = INFINITY;
        found[k] = -1;
    }
    for (int i = 0; i < of->n; i++) {
        double at[2];
        if (lies_on(of, i, t, TOLERANCE[FITS - 1], at)) {
            const int k = ((int)floor((atan2(at[1], at[0]) + acos(-1.0)) * by)) % DL_SEARCH_SECTORS;
            const double off = fabs(sqrt(at[0] * at[0] + at[1] * at[1]) - t->radius);
            if (off < nearest[k]) {
                nearest[k] = off;
                found[k] = of->edge[i];
            }
        }
    }
    for (int k = 0; k < DL_SEARCH_SECTORS; k++) {
        if (found[k] >= 0) {
            out->outline_px[2 * n] = ((double)rows->edges.x[found[k]] + 0.5) * step - 0.5;
            out->outline_px[2 * n + 1] = ((double)rows->edges.y[found[k]] + 0.5) * step - 0.5;
            n++;
        }
    }
    return n;
}

int search_fit(const search_image *image, const dl_circle_search *radii, const search_rows *rows, const vote_peak *peak,
               dl_circle *out)
{
    const double radius = radii->least * pow(radii->ratio, peak->radius);
    circle_trial t = {{0.0, 0.0}, radius, peak->bright_inside ? 1.0 : -1.0, peak->x, peak->y, 0.0f};
    if (!search_place(&rows->blocks, peak->x, peak->y, t.centre)) {
        return 0;
    }
    const double px = radius * (double)search_scale(&rows->blocks, peak->x, peak->y);
    t.reach = (float)(1.6 * px + 2.0);
    edge_choice chosen = rows->chosen;
    choose(image, rows, &t, &chosen);
    for (int k = 0; k < FITS; k++) {
        if (!fit_once(&chosen, TOLERANCE[k], &t)) {
            return 0;
        }
    }
    out->points = outline(image, rows, &chosen, &t, out);
    out->bright_inside = peak->bright_inside;
    out->centre[0] = t.centre[0], out->centre[1] = t.centre[1];
    out->radius = t.radius;
    out->support = fmin(1.0, (double)out->points / fmin(DL_SEARCH_SECTORS, 5.0 * px));
    return out->support > LEAST_SUPPORT;
}
