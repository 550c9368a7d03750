#include <math.h>
#include <string.h>

#include "search.h"

/* Tolerance of each fit, as a fraction of the radius, and the least cosine between an edge's gradient and the way to the centre. */
enum { FITS = 4, FEWEST = 8 };
static const double TOLERANCE[FITS] = {0.24, 0.16, 0.11, 0.08};
static const double LEAST_ALONG = 0.85;
/* Least fraction of the outline with an edge. */
static const double LEAST_SUPPORT = 0.22;

/* A circle on the plane, and the box in px that holds the edges that may belong to it. */
typedef struct {
    double centre[2], radius, sign;
    float x, y, reach;
} trial;

/* Sums of Kasa's equations about the trial's centre. */
typedef struct {
    int n;
    double x, y, xx, xy, yy, zx, zy, z;
} kasa_sums;

/* Whether an edge belongs to a trial within a tolerance; its place relative to the trial's centre. */
static int belongs(const search_rows *rows, int i, const trial *t, double tolerance, double at[2])
{
    const edge_list *e = &rows->edges;
    const double dx = (double)(t->x - e->x[i]), dy = (double)(t->y - e->y[i]);
    if (fabs(dx) > (double)t->reach || !search_place(&rows->blocks, e->x[i], e->y[i], at)) {
        return 0;
    }
    at[0] -= t->centre[0];
    at[1] -= t->centre[1];
    const double d = sqrt(at[0] * at[0] + at[1] * at[1]), tx = (double)e->to_x[i], ty = (double)e->to_y[i];
    const double along = t->sign * (tx * dx + ty * dy), length = (tx * tx + ty * ty) * (dx * dx + dy * dy);
    return fabs(d - t->radius) < tolerance * t->radius && along > 0.0 && along * along > LEAST_ALONG * LEAST_ALONG * length;
}

static void rows_of(const search_image *image, const trial *t, int out[2])
{
    const double h = (double)image->height;
    out[0] = (int)fmax(0.0, fmin(h, (double)(t->y - t->reach)));
    out[1] = (int)fmax(0.0, fmin(h, ceil((double)(t->y + t->reach))));
}

/* Fit a circle to the edges that belong to a trial.
 *
 * Source: Kasa, A circle fitting procedure and its error analysis, IEEE Trans. Instrumentation and Measurement 25, 1976. */
static int fit_once(const search_image *image, const search_rows *rows, double tolerance, trial *t)
{
    kasa_sums s;
    int of[2];
    memset(&s, 0, sizeof s);
    rows_of(image, t, of);
    for (int i = rows->edges.first[of[0]]; i < rows->edges.first[of[1]]; i++) {
        double at[2];
        if (belongs(rows, i, t, tolerance, at)) {
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
static int outline(const search_image *image, const search_rows *rows, const trial *t, search_circle *out)
{
    const double by = SEARCH_SECTORS / (2.0 * acos(-1.0)), step = (double)image->step;
    double nearest[SEARCH_SECTORS];
    int found[SEARCH_SECTORS], of[2], n = 0;
    for (int k = 0; k < SEARCH_SECTORS; k++) {
        nearest[k] = INFINITY;
        found[k] = -1;
    }
    rows_of(image, t, of);
    for (int i = rows->edges.first[of[0]]; i < rows->edges.first[of[1]]; i++) {
        double at[2];
        if (belongs(rows, i, t, TOLERANCE[FITS - 1], at)) {
            const int k = ((int)floor((atan2(at[1], at[0]) + acos(-1.0)) * by)) % SEARCH_SECTORS;
            const double off = fabs(sqrt(at[0] * at[0] + at[1] * at[1]) - t->radius);
            if (off < nearest[k]) {
                nearest[k] = off;
                found[k] = i;
            }
        }
    }
    for (int k = 0; k < SEARCH_SECTORS; k++) {
        if (found[k] >= 0) {
            out->outline_px[2 * n] = ((double)rows->edges.x[found[k]] + 0.5) * step - 0.5;
            out->outline_px[2 * n + 1] = ((double)rows->edges.y[found[k]] + 0.5) * step - 0.5;
            n++;
        }
    }
    return n;
}

int search_fit(const search_image *image, const search_radii *radii, const search_rows *rows, const vote_peak *peak,
               search_circle *out)
{
    const double radius = radii->least * pow(radii->ratio, peak->radius);
    trial t = {{0.0, 0.0}, radius, peak->bright_inside ? 1.0 : -1.0, peak->x, peak->y, 0.0f};
    if (!search_place(&rows->blocks, peak->x, peak->y, t.centre)) {
        return 0;
    }
    const double px = radius * (double)search_scale(&rows->blocks, peak->x, peak->y);
    t.reach = (float)(1.6 * px + 2.0);
    for (int k = 0; k < FITS; k++) {
        if (!fit_once(image, rows, TOLERANCE[k], &t)) {
            return 0;
        }
    }
    out->points = outline(image, rows, &t, out);
    out->bright_inside = peak->bright_inside;
    out->centre[0] = t.centre[0], out->centre[1] = t.centre[1];
    out->radius = t.radius;
    out->support = fmin(1.0, (double)out->points / fmin(SEARCH_SECTORS, 5.0 * px));
    return out->support > LEAST_SUPPORT;
}
