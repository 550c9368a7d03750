/* Register a near pad from profiles across its edges. */

#include "vision/register/near.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

enum { SAMPLINGS = 3, ROUNDS = 5, HALF_MIN = 3, GROUPS_MIN = 3, PIXEL_WORK = 1100 };
static const double NEAR_STEP_PX = 2.0; /* Longest step, px. */
static const double NEAR_AT_REST_PX = 0.08; /* Step at which the fit rests, px. */
static const double SETTLED_PX = 1.2; /* Motion after which the pixels are sampled again, px. */
static const double BLUR_FACTOR = 1.5; /* Growth of the blur after which they are. */
static const double BLUR_MORE_PX = 0.3; /* The same, px, besides. */
/* Largest displacement of an edge that counts whole, px. */
static const double SHIFT_MOST_PX = 2.0;

/* What the displacements of the groups' edges say: distance by which an edge lies outside of its fitted place, information on it, and
 * the effect on the gradient of a displacement by a pixel. */
typedef struct {
    double px[GROUPS_MAX], information[GROUPS_MAX], pull[GROUPS_MAX][STATES];
} shifts;

int take_near_rows(rows *r, near_rows *d, profiles *p)
{
    float **all[] = {&d->f.x, &d->f.y, &d->f.k1, &d->f.k2, &d->f.m, &d->round.seen, &d->round.per, &d->round.per_sigma, &d->round.m_cc,
                     &d->round.m_cs, &d->round.m_ss, &d->mixed, &d->value, &d->per_px, &d->residual, &d->per_var, &d->w, &d->weight,
                     &p->ray_x, &p->ray_y, &p->usable};
    int ok = 1;
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) {
        ok &= (*all[i] = take_rows(r, 1)) != NULL;
    }
    for (int k = 0; k < STATES; k++) {
        ok &= (d->J[k] = take_rows(r, 1)) != NULL && (d->Jw[k] = take_rows(r, 1)) != NULL;
    }
    for (int k = 0; k < BY; k++) {
        ok &= (d->d[k] = take_rows(r, 1)) != NULL;
    }
    for (int k = 0; k < CHANNELS; k++) {
        ok &= (p->light[k] = take_rows(r, 1)) != NULL && (d->spare[k] = take_rows(r, 1)) != NULL;
    }
    return ok;
}

static void mix_light(const profiles *p, const channel_mix *mix, near_rows *d)
{
    for (int g = 0; g < p->groups; g++) {
        const double *by = mix->mix[p->each[g].kind];
        const float b = (float)by[0], green = (float)by[1], red = (float)by[2];
        for (int i = p->each[g].begin; i < p->each[g].end; i++) {
            d->mixed[i] = b * p->light[0][i] + green * p->light[1][i] + red * p->light[2][i];
        }
    }
}

/* Linearise and step until the pose rests; `s` is moved, `delta` takes the last step. */
static int converge(const dl_pad_shape *pad, const profiles *p, const solver *v, near_rows *d, near_fit *fit, fit_state *s,
                    double delta[STATES], double *moved_px)
{
    fit->has_noise = 0;
    for (int n = 0; n < ROUNDS; n++) {
        fit_state next;
        if (n > 0) {
            cover_profiles(pad, s, p, 0, d);
        }
        linearise_profiles(p, d, fit);
        if (!step_state(v, s, fit->H, fit->g, NEAR_STEP_PX, 1, &next, moved_px)) {
            return 0;
        }
        difference(s, &next, delta);
        noise_after(p, delta, d, fit);
        *s = next;
        if (n > 0 && *moved_px < NEAR_AT_REST_PX) {
            break;
        }
    }
    return 1;
}

/* The displacement of each group's edge. */
static void find_shifts(const profiles *p, const near_rows *d, const near_fit *fit, shifts *out)
{
    for (int g = 0; g < p->groups; g++) {
        const group *one = &p->each[g];
        const group_fit *of = &fit->groups[g];
        double pull[STATES] = {0.0}, p0 = 0.0, p1 = 0.0, pp = 0.0, pr = 0.0;
        for (int i = one->begin; i < one->end; i++) {
            /* The change of a pixel's light as the edge moves outward by one px. */
            const double per_px = of->contrast * d->per_px[i], weighted = per_px * d->w[i];
            p0 += weighted, p1 += weighted * d->value[i], pp += weighted * per_px, pr += weighted * d->residual[i];
            for (int r = 0; r < STATES; r++) {
                pull[r] += d->Jw[r][i] * per_px;
            }
        }
        const double q0 = of->inverse[0] * p0 + of->inverse[1] * p1, q1 = of->inverse[1] * p0 + of->inverse[2] * p1;
        out->information[g] = fmax(pp - p0 * q0 - p1 * q1, 0.0);
        out->px[g] = out->information[g] > 1e-6 ? pr / out->information[g] : 0.0;
        for (int r = 0; r < STATES; r++) {
            out->pull[g][r] = pull[r] - of->sums[0][r] * q0 - of->sums[1][r] * q1;
        }
    }
}

/* The variance of edges' places, px^2, that neither noise nor pose explains, and the square root of its measured part.
 * Source: DerSimonian, Laird, Meta-analysis in clinical trials, Controlled Clinical Trials 7(3), 1986. */
static double edge_variance(const profiles *p, const near_fit *fit, const shifts *moves, const double delta[STATES], double noise,
                            double *rms_px)
{
    const double least = EDGE_SIGMA_PX * EDGE_SIGMA_PX;
    double squares = 0.0, weights = 0.0;
    int n = 0;
    *rms_px = 0.0;
    for (int g = 0; g < p->groups; g++) {
        if (!fit->groups[g].accepted || !(moves->information[g] > 1.0)) {
            continue;
        }
        double explained = 0.0;
        for (int r = 0; r < STATES; r++) {
            explained += delta[r] * moves->pull[g][r];
        }
        const double left = moves->px[g] - explained / moves->information[g], w = moves->information[g] / noise;
        const double shift = fmin(fmax(left, -SHIFT_MOST_PX), SHIFT_MOST_PX);
        squares += w * shift * shift, weights += w;
        n++;
    }
    if (n <= STATES) {
        return least;
    }
    /* Noise contributes n - 9; the rest comes from the drawing. */
    const double tau2 = fmax(0.0, (squares - (n - STATES)) / (weights * (1.0 - (double)STATES / n)));
    *rms_px = sqrt(tau2);
    return fmax(least, tau2);
}

/* The factor, at least 1, on the covariance for residuals that the pixels of a profile share, from sums of scores.
 * Source: Liang, Zeger, Longitudinal data analysis using generalized linear models, Biometrika 73(1), 1986. */
static double shared_noise(const profiles *p, const near_rows *d, const near_fit *fit)
{
    double alone = 0.0, together = 0.0;
    for (int r = 0; r < POSE; r++) {
        const double per = 1.0 / fmax(fit->H[r * (STATES + 1)], 1e-300);
        const float *Jw = d->Jw[r];
        double each = 0.0, sums = 0.0;
        for (int g = 0; g < p->groups; g++) {
            const int begin = p->each[g].begin, length = p->each[g].length;
            for (int from = begin; from < begin + length; from += p->samples) {
                double sum = 0.0;
                for (int i = from; i < from + p->samples; i++) {
                    const double score = (double)Jw[i] * d->residual[i];
                    sum += score;
                    each += score * score;
                }
                sums += sum * sum;
            }
        }
        alone += per * each, together += per * sums;
    }
    return alone > 0.0 ? fmax(1.0, together / alone) : 1.0;
}

/* Ratio of the residuals' variance after the step to the assumed one. */
static double noise_scale(const profiles *p, const near_rows *d, int groups)
{
    double sum = 0.0;
    int judged = 0;
    for (int i = 0; i < p->n; i++) {
        const double left = d->spare[0][i];
        judged += d->weight[i] > 0.0f;
        sum += d->weight[i] > 0.0f ? left * left * d->per_var[i] : 0.0;
    }
    const int free = judged - 2 * groups - STATES;
    return sum / (free > 1 ? free : 1);
}

/* cov += tau2 pull pull' with the groups' pulls in units of the state, and the same for each kind of edge whose groups lie outward
 * alike by `size_px` at one sigma: what was painted is larger or smaller than drawn. */
static void add_shifts(const profiles *p, const shifts *moves, double grow, double tau2, double size_px, double cov[STATES * STATES])
{
    double sum[STATES * STATES] = {0.0}, by_kind[DL_EDGE_KINDS][STATES] = {{0.0}};
    for (int g = 0; g < p->groups; g++) {
        double pull[STATES];
        for (int i = 0; i < STATES; i++) {
            pull[i] = 0.0;
            for (int k = 0; k < STATES; k++) {
                pull[i] += cov[i * STATES + k] * moves->pull[g][k] / grow;
            }
            by_kind[p->each[g].kind][i] += size_px * pull[i];
        }
        for (int i = 0; i < STATES * STATES; i++) {
            sum[i] += tau2 * pull[i / STATES] * pull[i % STATES];
        }
    }
    for (int i = 0; i < STATES * STATES; i++) {
        for (int kind = 0; kind < DL_EDGE_KINDS; kind++) {
            sum[i] += by_kind[kind][i / STATES] * by_kind[kind][i % STATES];
        }
        cov[i] += sum[i];
    }
}

/* The support for a kind from the pixels of its groups; `contrasts` are those of the larger groups. */
static void support_of(const profiles *p, int kind, const channel_mix *mix, const near_rows *d, const near_fit *fit, double all[2],
                       dl_edge_support *out)
{
    float contrasts[GROUPS_MAX];
    uint32_t spare[GROUPS_MAX];
    double counted = 0.0, agreed = 0.0;
    int n = 0;
    for (int g = 0; g < p->groups; g++) {
        double pixels = 0.0, agree = 0.0;
        for (int i = p->each[g].begin; i < p->each[g].end && p->each[g].kind == kind; i++) {
            pixels += p->usable[i], agree += d->weight[i];
        }
        all[0] += pixels, all[1] += agree;
        if (pixels > 8.0) {
            counted += pixels, agreed += agree;
            contrasts[n++] = (float)fit->groups[g].contrast;
        }
    }
    memset(out, 0, sizeof *out);
    out->in_view = p->in_view[kind], out->likeness = 1.0;
    if (n) {
        const double contrast = median_of(n, contrasts, spare), var = fit->mean_noise[kind];
        out->snr = var < 0.5 ? contrast / sqrt(var) : 0.0;
        out->inliers = fmin(1.0, agreed / (MEAN_WEIGHT * counted));
        for (int c = 0; c < CHANNELS; c++) {
            out->contrast_bgr[c] = mix->contrast[kind][c] * contrast;
        }
    }
}

/* The noise of linear light: the mean over the kinds whose paints differ. */
static double noise_of_light(const channel_mix *mix, const near_fit *fit)
{
    double sum = 0.0;
    int shown = 0;
    for (int kind = 0; kind < DL_EDGE_KINDS; kind++) {
        const double *m = mix->mix[kind], size2 = m[0] * m[0] + m[1] * m[1] + m[2] * m[2];
        if (fit->mean_noise[kind] < 1.0 && size2 > 0.0) {
            sum += fit->mean_noise[kind] / size2;
            shown++;
        }
    }
    return shown ? sqrt(sum / shown) : 0.0;
}

static void find_support(const dl_pad_shape *pad, const profiles *p, const channel_mix *mix, const fit_state *s, near_rows *d,
                         const near_fit *fit, fit_solved *out)
{
    double all[2] = {0.0, 0.0}, amplitude, sigma;
    for (int kind = 0; kind < DL_EDGE_KINDS; kind++) {
        support_of(p, kind, mix, d, fit, all, &out->edges[kind]);
        out->visible += p->in_view[kind] / kinds_drawn(pad);
    }
    out->inliers = fmin(1.0, all[1] / fmax(1.0, MEAN_WEIGHT * all[0]));
    out->noise_light = noise_of_light(mix, fit);
    const int kind = (int)pad->pointer_kind;
    if (kind < 0) {
        return;
    }
    const double *shown = mix->mix[pad->paint_of_kind[kind]];
    if (shown[0] != 0.0 || shown[1] != 0.0 || shown[2] != 0.0) {
        pointer_amplitude(pad, s, p, d, &amplitude, &sigma);
        out->edges[kind] = pointer_support(amplitude, sigma, mix->contrast[pad->paint_of_kind[kind]], p->in_view[kind]);
    }
    out->arrow_seen = support_is_seen(&out->edges[kind]);
}

/* A registration under way: what it is given, and what it has found. */
typedef struct {
    const fit_task *k;
    solver priors;
    profile_work work;
    profiles p;
    near_rows d;
    near_fit fit;
    channel_mix mix;
    fit_state s;
    double delta[STATES];
} attempt;

/* Sample the profiles and fit them, again where the pose or the blur moved too far. */
static int sample_and_fit(attempt *a)
{
    double moved_px;
    profiles *p = &a->p;
    near_rows *d = &a->d;
    fit_state *s = &a->s;
    for (int again = 0; again < SAMPLINGS; again++) {
        const double wanted = ceil(2.2 * sigma_px(s) + 1.2);
        const int half = wanted < HALF_MAX ? (int)fmax(HALF_MIN, wanted) : HALF_MAX;
        const fit_state before = *s;
        double whole[STATES];
        if (!sample_profiles(&a->k->seen, s, &a->k->edges, half, &a->work, p)) {
            return 0;
        }
        *a->k->work += p->n * PIXEL_WORK;
        d->f.n = p->n;
        look_at(s, p->ray_x, p->ray_y, &d->f);
        drop_foreign(a->k->pad, s, &d->f, d->spare[0], p);
        cover_profiles(a->k->pad, s, p, 1, d);
        mix_channels(a->k->pad, p, d, &a->mix);
        mix_light(p, &a->mix, d);
        if (!converge(a->k->pad, p, &a->priors, d, &a->fit, s, a->delta, &moved_px)) {
            return 0;
        }
        difference(&before, s, whole);
        if (motion_px(&a->priors, s, whole) < SETTLED_PX && sigma_px(s) < BLUR_FACTOR * sigma_px(&before) + BLUR_MORE_PX) {
            break;
        }
    }
    return 1;
}

int register_near(const fit_task *k, const fit_state *start, fit_solved *out)
{
    rows r = k->free;
    attempt a;
    const profiles *p = &a.p;
    const near_fit *fit = &a.fit;
    shifts moves;
    a.k = k, a.s = *start;
    a.work.keys = take_rows(&r, 5), a.work.room = r.length;
    memset(out, 0, sizeof *out);
    if (!a.work.keys || !take_near_rows(&r, &a.d, &a.p)) {
        return 0;
    }
    a.work.doubles = (double *)(void *)a.d.J[0];
    begin_solver(start, &k->tilt, k->pad->disc_radius_m, &a.priors);
    if (!sample_and_fit(&a)) {
        return 0;
    }
    int accepted = 0;
    for (int g = 0; g < p->groups; g++) {
        accepted += fit->groups[g].accepted;
    }
    out->state = a.s;
    if (accepted < GROUPS_MIN) {
        return 0;
    }
    const double scale = noise_scale(p, &a.d, accepted), grow = shared_noise(p, &a.d, fit) * scale;
    find_shifts(p, &a.d, fit, &moves);
    const double tau2 = edge_variance(p, fit, &moves, a.delta, scale, &out->edge_rms_px);
    for (int i = 0; i < STATES * STATES; i++) {
        out->H[i] = fit->H[i] / grow;
    }
    if (!covariance_of(&a.priors, &a.s, out->H, out->cov)) {
        return 0;
    }
    add_shifts(p, &moves, grow, tau2, k->size_sigma_m / a.s.m_per_px, out->cov);
    find_support(k->pad, p, &a.mix, &a.s, &a.d, fit, out);
    return 1;
}
