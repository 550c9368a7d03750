/* Fit the drawing's paints at a final pose, and describe how well they explain the frame. */

#include <math.h>
#include <string.h>

#include "vision/align/align.h"

static const float PURE = 0.85f; /* Coverage above which a sample shows one paint alone. */
static const float TRUSTED = 0.5f; /* Weight from which a sample counts. */
/* Coverage by the H from which a sample's light may be clipped because of it. */
static const float SOME_H = 0.25f;
/* Work of each sample. */
enum { FIT_WORK = 350 };

/* The fraction of the disc's area inside the frame. */
static double in_view(const dl_pad_template *p, const samples *s, const dl_pad_pose *pose, double side_m)
{
    const float limit = (float)(p->disc_radius_m * p->disc_radius_m);
    int inside = 0;
    for (int i = 0; i < s->n; i++) {
        inside += s->x[i] * s->x[i] + s->y[i] * s->y[i] < limit;
    }
    return fmin(1.0, inside * side_m * side_m / (acos(-1.0) * p->disc_radius_m * p->disc_radius_m * fabs(pose->R[8])));
}

/* Number, mean and variance of the logarithms of light where one paint shows alone. */
static void measure_paints(const samples *s, const float *logarithm, const seen_part *seen, dl_aligned_pad *out)
{
    for (int k = 0; k < 4; k++) {
        double sum[3] = {0.0, 0.0, 0.0}, square[3] = {0.0, 0.0, 0.0}, n = 0.0;
        for (int i = 0; i < s->n; i++) {
            if (s->coverage[k][i] > PURE && s->weight[i] > TRUSTED) {
                const int64_t width = seen->part.width;
                const uint8_t *at = seen->px + (size_t)(s->pixel[i] / width) * (size_t)seen->stride + 3 * (s->pixel[i] % width);
                n += 1.0;
                for (int c = 0; c < 3; c++) {
                    const double value = (double)logarithm[at[c]];
                    sum[c] += value;
                    square[c] += value * value;
                }
            }
        }
        out->light_n[k] = n;
        for (int c = 0; c < 3; c++) {
            const double mean = n > 0.0 ? sum[c] / n : 0.0;
            out->light_mean[3 * k + c] = mean;
            out->light_var[3 * k + c] = n > 0.0 ? fmax(0.0, square[c] / n - mean * mean) : 0.0;
        }
    }
}

static void keep_paints(const painted *fit, double out[12])
{
    for (int i = 0; i < 12; i++) {
        out[i] = (double)fit->paints[i / 3][i % 3];
    }
}

/* The brightest light of the samples that are some of the H, by channel. */
static void brightest_h(const samples *s, double out[3])
{
    out[0] = out[1] = out[2] = 0.0;
    for (int i = 0; i < s->n; i++) {
        for (int c = 0; c < 3 && s->coverage[PAINT_H][i] >= SOME_H; c++) {
            out[c] = fmax(out[c], (double)s->light[c][i]);
        }
    }
}

int align_fit(const dl_tracker *t, const seen_part seen[2], const dl_pad_pose *pose, const double cut[3], const dl_quality *of,
              dl_aligned_pad *out)
{
    const dl_lens *c = &t->camera.lens;
    const dl_pad_template *p = &t->pad.drawn;
    const frame_part *part = &seen[0].part;
    pixels from;
    samples s;
    painted fit;
    double brightest[3];
    align_divide(part->width, part->height, t->scratch, &from, &s);
    align_light(t, seen, pose->t[2], 1, s.squared, &from);
    align_trust(cut, &from);
    const int blur = align_blur_at(c, p, from.side_m, pose->t[2]);
    if (!align_samples(p, align_map(p, t->maps, blur), &from, pose, 0, &s)) {
        return 0;
    }
    const double tilt_sigmas = out->tilt_sigmas;
    count_work(t, s.n, FIT_WORK);
    memset(out, 0, sizeof *out);
    out->sample_m = from.side_m;
    out->tilt_sigmas = tilt_sigmas;
    out->in_view = in_view(p, &s, pose, from.side_m);
    align_take(from.light, &s);
    for (int i = 0; i < s.n; i++) {
        s.weight[i] = 1.0f;
    }
    if (!align_paint(&s, 1, &fit)) {
        return 0;
    }
    keep_paints(&fit, out->paints);
    brightest_h(&s, brightest);
    measure_paints(&s, t->lights + 2 * 256, seen, out);
    align_coverage(p, align_map(p, t->local_maps, blur), &s);
    align_take(from.local, &s);
    align_uncovered(&s);
    if (!align_paint(&s, 1, &fit)) {
        return 0;
    }
    keep_paints(&fit, out->local_paints);
    align_arrow(t, &seen[1], pose, fit.paints, of->noise, out->arrow);
    /* The root of light is a pixel's value within a few per cent, and a sample of a higher level the mean of four of the one below. */
    const dl_quality of_samples = {of->noise / (double)(1 << part->level), of->contrast, of->chroma};
    align_support(p, &s, blur, from.side_m, &of_samples, &out->support);
    align_features(p, &s, &fit, brightest, &of_samples, out);
    return 1;
}
