/* Compute the inputs of the confidence classifier from an aligned drawing. */

#include <math.h>
#include <string.h>

#include "vision/align/align.h"

enum { SECTORS = 8, FEWEST = 6, PARTS = 3 };
/* Residual in the square root of light, full scale 1, that a right drawing leaves anyway (noise, wear, ripples) in a clear frame. */
static const double NOISE = 0.012;
/* Least difference of H and disc that the orange is placed between. */
static const double LEAST_SPAN = 0.04;
/* Linear light of a sample from which a frame clips it. */
static const double CLIPPED_LIGHT = 0.98;
/* Deviations of the noise's sum that may be left of it by chance. */
static const double CHANCE = 1.0;
/* Largest gain that counts: a larger one depends more on the blur than on the pad. */
static const double ENOUGH_SAMPLES = 4.0;
/* Factor on the visible fraction of a part: a part counts as missing if a fifth of it is in view and it does not show. */
static const double TELLING = 5.0;
/* Weight of one place without an arrowhead while the other is out of view, relative to two. */
static const double ONE_EMPTY = 0.4;
/* Least reach of a part's surroundings, m. */
static const double LEAST_REACH_M = 0.02;

/* One part of the drawing: its paint, and where its samples lie. */
typedef struct {
    int paint, drawn;
    double half_length, half_width, inner, outer, area_m2;
} zone;

/* Variances of a sample's residuals under a right drawing: of wear, ripples and a camera's usual noise, and of its noise beyond. */
typedef struct {
    double usual_var, noise_var;
} allowed;

/* How well a part shows: by the better half of the directions in view, by all of them, and how much of it is in view. */
typedef struct {
    double gain, all, shown;
} part_gain;

/* 0..1, saturating quickly: from afar a part can gain little, and any gain counts. */
static double some(double gain)
{
    return fmax(0.0, gain) / (fmax(0.0, gain) + 0.4);
}

static void zones_of(const dl_pad_template *p, double side_m, zone out[PARTS])
{
    const double pi = acos(-1.0), reach = fmax(LEAST_REACH_M, side_m), edge = p->disc_edge_m - 2.5 * reach;
    const double inner = p->ring_inner_m - 2.0 * reach, outer = p->ring_outer_m + 2.0 * reach;
    const double around = AROUND_RADII * p->disc_radius_m + side_m;
    const zone h = {PAINT_H, p->h_half_length_m > 0.0, p->h_half_length_m + reach, p->h_half_width_m + reach, -1.0, INFINITY,
                    4.0 * p->h_half_length_m * p->h_half_width_m};
    const zone ring = {PAINT_ORANGE, p->ring_outer_m > 0.0, INFINITY, INFINITY, inner, outer, pi * (outer * outer - inner * inner)};
    const zone disc = {PAINT_AROUND, (int)p->disc_drawn, INFINITY, INFINITY, edge, INFINITY, pi * (around * around - edge * edge)};
    out[0] = h, out[1] = ring, out[2] = disc;
}

/* Change of a sample that is fully covered by a paint if that gives way to the disc's. */
static double way_of(const painted *local, int paint, float way[3])
{
    double square = 0.0;
    for (int c = 0; c < 3; c++) {
        way[c] = local->paints[PAINT_DISC][c] - local->paints[paint][c];
        square += (double)way[c] * (double)way[c];
    }
    return square;
}

static void ordered(int n, double *values)
{
    for (int i = 1; i < n; i++) {
        const double value = values[i];
        int at = i;
        for (; at > 0 && values[at - 1] > value; at--) {
            values[at] = values[at - 1];
        }
        values[at] = value;
    }
}

/* Squared residuals of n samples without the share of noise of a variance, and the chance level, with that of
 * a right drawing. */
static double above_noise(double n, double squared, const allowed *of)
{
    const double count = 3.0 * n;
    return fmax(0.0, squared - of->noise_var * count) + CHANCE * of->noise_var * sqrt(2.0 * count) + of->usual_var * count;
}

/* The gain of a part from sums by direction: the logarithm of the squared residuals without it over those with it. What the frame's
 * noise adds to both does not count: it hides a part that is there from each sample, and not from all of them. */
static void gains_of(const int n[SECTORS], const double squared[SECTORS], const double change[SECTORS], const double along[SECTORS],
                     const allowed *of, part_gain *out)
{
    double gains[SECTORS], most = 0.0;
    int count = 0;
    for (int k = 0; k < SECTORS; k++) {
        most = fmax(most, change[k]);
    }
    for (int k = 0; k < SECTORS; k++) {
        if (change[k] > 0.2 * most + 1e-9) {
            const double floor = of->usual_var * 3.0 * n[k] + 1e-9, with_it = above_noise(n[k], squared[k], of) + 1e-9;
            gains[count++] = clipped(log(fmax(change[k] - 2.0 * along[k] + with_it, floor) / with_it), -1.0, ENOUGH_SAMPLES);
        }
    }
    ordered(count, gains);
    for (int k = 0; k < count; k++) {
        out->all += gains[k] / count;
        out->gain += k >= count / 2 ? gains[k] / (count - count / 2) * fmin(1.0, count / 3.0) : 0.0;
    }
}

static int within(const zone *z, float x, float y, double r)
{
    return fabs((double)x) < z->half_length && fabs((double)y) < z->half_width && r > z->inner && r < z->outer;
}

static part_gain gain_of_part(const samples *s, const painted *local, const zone *z, double side_m, const allowed *of)
{
    int n[SECTORS] = {0}, all = 0;
    double squared[SECTORS] = {0.0}, change[SECTORS] = {0.0}, along[SECTORS] = {0.0};
    float way[3];
    part_gain out = {0.0, 0.0, 0.0};
    const double length = way_of(local, z->paint, way);
    const float *coverage = s->coverage[z->paint];
    for (int i = 0; i < s->n; i++) {
        if (within(z, s->x[i], s->y[i], sqrt((double)(s->x[i] * s->x[i] + s->y[i] * s->y[i])))) {
            const int k = align_sector(s->x[i], s->y[i]);
            const double on_way = (double)(way[0] * s->residual[0][i] + way[1] * s->residual[1][i] + way[2] * s->residual[2][i]);
            n[k]++, all++;
            squared[k] += (double)s->squared[i];
            change[k] += (double)coverage[i] * (double)coverage[i] * length;
            along[k] += (double)coverage[i] * on_way;
        }
    }
    out.shown = fmin(1.0, all * side_m * side_m / z->area_m2);
    if (all >= FEWEST) {
        gains_of(n, squared, change, along, of, &out);
    }
    return out;
}

/* The drawing's gain: the logarithm of the squared residuals without it over those with it. */
static double gain_of_all(const samples *s, const allowed *of)
{
    double nothing = 0.0, squared = 0.0, weight = 0.0;
    for (int i = 0; i < s->n; i++) {
        const double w = (double)s->weight[i];
        weight += w;
        squared += w * (double)s->squared[i];
        for (int c = 0; c < 3; c++) {
            nothing += w * (double)s->light[c][i] * (double)s->light[c][i];
        }
    }
    return s->n < FEWEST ? 0.0 : clipped(log(above_noise(weight, nothing, of) / above_noise(weight, squared, of)), 0.0, ENOUGH_SAMPLES);
}

/* 0..1: the excess of ring paint just inside or outside of the ring, which indicates a ring that is too wide. A ring that is merely
 * displaced has a deficit of the same size on its other flank. */
static double flanks(const dl_pad_template *p, const samples *s, const painted *local)
{
    float way[3];
    int n[2] = {0, 0};
    double much[2] = {0.0, 0.0};
    const double length = way_of(local, PAINT_ORANGE, way), width = p->ring_outer_m - p->ring_inner_m;
    const double radius = (p->ring_inner_m + p->ring_outer_m) / 2.0;
    if (length < 1e-4) {
        return 0.0;
    }
    for (int i = 0; i < s->n; i++) {
        const double aside = sqrt((double)(s->x[i] * s->x[i] + s->y[i] * s->y[i])) - radius;
        if (fabs(fabs(aside) - 0.9 * width) < 0.4 * width) {
            const int side = aside > 0.0;
            n[side]++;
            much[side] -= (double)(way[0] * s->residual[0][i] + way[1] * s->residual[1][i] + way[2] * s->residual[2][i]);
        }
    }
    for (int k = 0; k < 2; k++) {
        much[k] = n[k] >= FEWEST ? much[k] / n[k] / length : 0.0;
    }
    return clipped(fmax(much[0], much[1]) + fmin(0.0, fmin(much[0], much[1])), 0.0, 1.0);
}

/* The distance of the orange from its nominal place between disc and H, mean over the channels; 0 is nominal. A bright H that the
 * frame clips may be any brighter, and the orange's place any lower than it seems. */
static double orange_off(const dl_pad_template *p, const painted *local, const double brightest_h[3], double contrast)
{
    double off = 0.0;
    for (int c = 0; c < 3; c++) {
        const double green = (double)local->paints[PAINT_DISC][c];
        const double span = fmax(p->h_side[c] * ((double)local->paints[PAINT_H][c] - green), LEAST_SPAN * contrast);
        const double place = p->h_side[c] * ((double)local->paints[PAINT_ORANGE][c] - green) / span;
        const double above = clipped(place, -0.5, 1.5) - p->orange_place[c];
        const int hidden = p->h_side[c] > 0.0 && brightest_h[c] >= CLIPPED_LIGHT && above > 0.0;
        off += hidden ? 0.0 : fabs(above) / 3.0;
    }
    return off;
}

/* The logarithm of the disc's excess in its dominant channel over the others, measured against white. */
static double disc_place(const dl_pad_template *p, const double paints[12])
{
    double ratio[3];
    for (int c = 0; c < 3; c++) {
        ratio[c] = (fmax(paints[3 * PAINT_DISC + c], 0.0) + 0.01) / (fmax(paints[3 * PAINT_H + c], 0.0) + 0.01);
    }
    const int main = (int)p->disc_channel;
    return clipped(log(ratio[main] / fmax(ratio[(main + 1) % 3], ratio[(main + 2) % 3])), -1.0, 2.0);
}

/* The least contrast of the H against the disc. */
static double contrast(const painted *local)
{
    double least = INFINITY;
    for (int c = 0; c < 3; c++) {
        least = fmin(least, (double)local->paints[PAINT_H][c] - (double)local->paints[PAINT_DISC][c]);
    }
    return least;
}

/* 0..1: how surely the possible places of an arrowhead are in view, clear, and without one. */
static double empty(const double arrow[6])
{
    const double fore = arrow[1] * arrow[2], aft = arrow[4] * arrow[5];
    return (1.0 - fmax(arrow[0], arrow[3])) * fmax(fore * aft, ONE_EMPTY * fmax(fore, aft));
}

static double missing(const part_gain *part)
{
    return -fmin(1.0, TELLING * part->shown) * exp(-2.0 * fmax(0.0, part->gain));
}

/* The gains of the parts. One that the pad does not have says what the weakest of the others says, and is not missed. */
static void gains_of_parts(const samples *s, const painted *local, const zone zones[PARTS], double side_m, const allowed *of,
                           part_gain parts[PARTS])
{
    part_gain least = {ENOUGH_SAMPLES, ENOUGH_SAMPLES, 0.0};
    for (int k = 0; k < PARTS; k++) {
        if (zones[k].drawn) {
            parts[k] = gain_of_part(s, local, &zones[k], side_m, of);
            least.gain = fmin(least.gain, parts[k].gain);
            least.all = fmin(least.all, parts[k].all);
        }
    }
    for (int k = 0; k < PARTS; k++) {
        parts[k] = zones[k].drawn ? parts[k] : least;
    }
}

void align_features(const dl_pad_template *p, const samples *s, const painted *local, const double brightest_h[3], const dl_quality *of,
                    dl_aligned_pad *out)
{
    zone zones[PARTS];
    part_gain parts[PARTS];
    double *f = out->features, gains[PARTS];
    const double usual = NOISE * of->contrast;
    const allowed residual = {usual * usual, of->noise * of->noise};
    zones_of(p, out->sample_m, zones);
    gains_of_parts(s, local, zones, out->sample_m, &residual, parts);
    for (int k = 0; k < PARTS; k++) {
        gains[k] = parts[k].gain;
    }
    const double h = gains[0], ring = gains[1], edge = gains[2];
    ordered(PARTS, gains);
    const double off = fmin(1.0, TELLING * parts[1].shown) * orange_off(p, local, brightest_h, of->contrast);
    double weight = 0.0;
    for (int i = 0; i < s->n; i++) {
        weight += (double)s->weight[i];
    }
    f[FEATURE_ONE] = 1.0;
    f[FEATURE_H_MARKING] = h, f[FEATURE_RING] = ring, f[FEATURE_EDGE] = edge;
    f[FEATURE_H_MARKING_ALL] = parts[0].all, f[FEATURE_RING_ALL] = parts[1].all, f[FEATURE_EDGE_ALL] = parts[2].all;
    f[FEATURE_H_AND_RING] = fmin(h, ring), f[FEATURE_H_AND_EDGE] = fmin(h, edge), f[FEATURE_RING_AND_EDGE] = fmin(ring, edge);
    f[FEATURE_TWO_OF_THREE] = gains[1];
    f[FEATURE_SOME_RING] = some(ring), f[FEATURE_SOME_EDGE] = some(edge), f[FEATURE_SOME_TWO] = some(gains[1]);
    f[FEATURE_H_ALONE] = h * (1.0 - fmin(1.0, 2.0 * fmax(parts[1].shown, parts[2].shown)));
    f[FEATURE_NO_H] = missing(&parts[0]), f[FEATURE_NO_RING] = missing(&parts[1]), f[FEATURE_NO_EDGE] = missing(&parts[2]);
    f[FEATURE_RING_LAGS] = -fmin(1.0, TELLING * parts[1].shown) * fmax(0.0, h - ring - 0.7);
    f[FEATURE_FLANKS] = -flanks(p, s, local);
    f[FEATURE_ARROW] = fabs(out->arrow[0] * out->arrow[1] - out->arrow[3] * out->arrow[4]);
    f[FEATURE_NO_ARROW] = -empty(out->arrow);
    f[FEATURE_TEMPLATE_GAIN] = gain_of_all(s, &residual);
    f[FEATURE_INLIERS] = weight / s->n;
    f[FEATURE_WHITE] = clipped(log(fmax(1e-3, contrast(local)) / 0.2), -3.0, 1.5);
    f[FEATURE_ORANGE_PLACE] = -off, f[FEATURE_ORANGE_ODD] = -fmax(0.0, off - 0.5);
    f[FEATURE_DISC_PLACE] = disc_place(p, out->paints);
    f[FEATURE_SIZE] = clipped(log(p->disc_radius_m / out->sample_m / 10.0), -1.5, 1.5);
    f[FEATURE_IN_VIEW] = fmin(1.0, out->in_view);
    f[FEATURE_TILT] = -fmin(2.0, 0.2 * out->tilt_sigmas * out->tilt_sigmas);
}
