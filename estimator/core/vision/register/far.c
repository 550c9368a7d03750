/* Register a distant pad from the light of all its pixels. */

#include "vision/register/far.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

#include "base/rotation.h"
#include "vision/tracker.h"

enum { ROUNDS = 12, EDGE_SECTORS = 8, STROKES = 4, PIXEL_WORK = 800 };
static const double FAR_STEP_PX = 1.5; /* Longest step, px. */
/* Step of the pose at which the fit has converged, px: it may stop for a step while the blur still changes. */
static const double FAR_AT_REST_PX = 0.02;
static const double BLUR_AT_REST_PX = 0.04; /* The same of the blur, px. */
/* Step, px, from the fourth on that shows that there is no pad: of 53 pads in any light none moved more than 0.48 px then, and where
 * there is none three fits in four move more than 0.8 px to the last round. */
static const double ASTRAY_PX = 0.75;
/* Limit on the variance of smoothed light over light: four times that of worn paint on a patchy deck. More means an object on the
 * pad, unless the frame's own noise is that large. */
static const double NOISE_DOUBTED = 5e-4;
/* Sigma of the distant disc's edges in that case, px: hiding half of the disc moves it this far. */
static const double EDGE_DOUBTED_PX = 2.0;
static const double UNDER_POINTER = 0.98; /* Coverage beyond which a pixel sees the paint under the pointer alone. */
static const double POINTER_IN_VIEW = 0.1; /* Sum of coverages from which a pointer is in view. */


int kinds_drawn(const dl_pad_shape *pad)
{
    int drawn = 0;
    for (int kind = 0; kind < DL_EDGE_KINDS; kind++) {
        drawn += pad->contrast_of_kind[kind] >= 0;
    }
    return drawn ? drawn : 1;
}

int stands_out(double amplitude, double opposite, double sigma)
{
    return amplitude - opposite > fmax(0.5, 4.0 * sigma);
}

dl_edge_support pointer_support(double amplitude, double sigma, const double contrast[CHANNELS], double in_view)
{
    dl_edge_support out = {.snr = fmax(0.0, amplitude) / fmax(sigma, 1e-6), .in_view = in_view, .likeness = 1.0};
    out.inliers = fmin(1.0, fmax(0.0, 1.0 - fabs(amplitude - 1.0)));
    for (int c = 0; c < CHANNELS; c++) {
        out.contrast_bgr[c] = contrast[c] * amplitude;
    }
    return out;
}

int support_is_seen(const dl_edge_support *e)
{
    return e->snr > SNR_SEEN && e->inliers > 0.5 && e->in_view > 0.0 && e->likeness > LIKENESS_SEEN;
}

/* Add to a covariance what hides the disc: its sectors and strokes may lie anywhere within some pixels, and the pad farther away or
 * nearer along the line of sight. */
static void add_doubt(const fit_state *s, const dl_pad_shape *pad, double cov[STATES * STATES])
{
    const double sigma = EDGE_DOUBTED_PX * s->m_per_px, range = sigma * s->depth_m / pad->disc_radius_m, turn = sigma / pad->half_length_m;
    double along[3];
    line_of_sight(s, along);
    for (int i = 0; i < 9; i++) {
        cov[i / 3 * STATES + i % 3] += along[i / 3] * along[i % 3] * range * range / EDGE_SECTORS;
    }
    cov[0] += sigma * sigma / STROKES;
    cov[STATES + 1] += sigma * sigma / STROKES;
    cov[5 * STATES + 5] += turn * turn;
}

/* H inv(gradient_cov) H and H inv(gradient_cov) g: information and gradient that correspond to the robust covariance. By the plain ones a frame would
 * count more against the predicted tilt than it knows, and by these one prior can be exchanged for another. */
static int robust_sums(const dense_fit *fit, double H[STATES * STATES], double g[STATES])
{
    enum { COLUMNS = STATES + 1 };
    double gradient_cov[STATES * STATES], X[STATES * COLUMNS];
    memcpy(gradient_cov, fit->gradient_cov, sizeof gradient_cov);
    for (int i = 0; i < STATES; i++) {
        const double own = fit->H[i * (STATES + 1)];
        if (!(own >= 0.0)) {
            return 0;
        }
        /* Of a state that the frame says nothing of, nothing is known but its prior. */
        gradient_cov[i * (STATES + 1)] += own > 0.0 ? 1e-9 * own : 1.0;
        memcpy(X + i * COLUMNS, fit->H + i * STATES, STATES * sizeof *X);
        X[i * COLUMNS + STATES] = fit->g[i];
    }
    if (!solve_symmetric(STATES, STATES, gradient_cov, COLUMNS, X)) {
        return 0;
    }
    for (int i = 0; i < STATES; i++) {
        for (int j = 0; j < COLUMNS; j++) {
            double sum = 0.0;
            for (int k = 0; k < STATES; k++) {
                sum += fit->H[i * STATES + k] * X[k * COLUMNS + j];
            }
            *(j < STATES ? &H[i * STATES + j] : &g[i]) = sum;
        }
    }
    return 1;
}

/* The mix of colours in which the pointer's paint stands out from the one below by one; 0 if it does not. */
static int pointer_mix(const dl_pad_shape *pad, const dense_fit *fit, double mix[CHANNELS])
{
    const int own = FIRST_REGION + (int)pad->pointer_contrast, below = (int)pad->lies_on[pad->pointer_contrast];
    double size = 0.0;
    for (int c = 0; c < CHANNELS; c++) {
        const double light = fit->paints[0][c] + (below >= 0 ? fit->paints[FIRST_REGION + below][c] : 0.0);
        mix[c] = fit->paints[own][c] / (fmax(light, 0.0) + 0.02);
        size += mix[c] * fit->paints[own][c];
    }
    for (int c = 0; c < CHANNELS; c++) {
        mix[c] /= size;
    }
    return size >= 1e-4;
}

/* Regressors of the pointer's fit at the pixels that it has an effect on, and their mixed light. */
enum { POINTER_ROWS = 4 };
typedef struct {
    int n;
    float *rows[POINTER_ROWS], *light;
} pointer_pixels;

/* The pixels beyond the ring, where the strokes have no effect, and well inside the paint below, where the surroundings have none. */
static void collect_pointer(const dl_pad_shape *pad, const patch *cut, const fit_state *s, const double mix[CHANNELS], dense_rows *d,
                            pointer_pixels *p)
{
    const int own = FIRST_REGION + (int)pad->pointer_contrast, below = (int)pad->lies_on[pad->pointer_contrast];
    const float *under = d->values[below >= 0 ? FIRST_REGION + below : 0], clear = (float)pad->pointer_clear_m;
    float *here = d->spare[2], *there = d->spare[3];
    p->n = 0, p->light = d->spare[4];
    for (int k = 0; k < POINTER_ROWS; k++) {
        p->rows[k] = d->spare[5 + k];
    }
    look_at(s, cut->ray_x, cut->ray_y, &d->f);
    cover_figure(&pad->figures[pad->pointer_figure], &d->f, 0, cut->n, 0, here);
    cover_figure(&pad->figures[pad->pointer_figure], &d->f, 0, cut->n, 1, there);
    for (int i = 0; i < cut->n; i++) {
        const float r2 = d->f.x[i] * d->f.x[i] + d->f.y[i] * d->f.y[i];
        double light = 0.0;
        for (int c = 0; c < CHANNELS; c++) {
            light += mix[c] * ((double)cut->light[c][i] - d->added[c][i]);
        }
        p->light[p->n] = (float)light;
        p->rows[0][p->n] = 1.0f, p->rows[1][p->n] = d->values[own][i] - here[i], p->rows[2][p->n] = here[i], p->rows[3][p->n] = there[i];
        p->n += r2 > clear * clear && under[i] > UNDER_POINTER;
    }
}

/* The amplitudes of the pointer at a state; 0 if its paint does not differ from the one below, or if none would be in view. */
static int find_pointer(const dl_pad_shape *pad, const patch *cut, const fit_state *s, const dense_fit *fit, dense_rows *d, pointer *out)
{
    double mix[CHANNELS], M[POINTER_ROWS * POINTER_ROWS] = {0.0}, a[POINTER_ROWS] = {0.0}, inverse[POINTER_ROWS * POINTER_ROWS] = {0.0};
    pointer_pixels p;
    if (pad->pointer_kind < 0 || !pointer_mix(pad, fit, mix)) {
        return 0;
    }
    collect_pointer(pad, cut, s, mix, d, &p);
    for (int i = 0; i < p.n; i++) {
        for (int j = 0; j < POINTER_ROWS; j++) {
            a[j] += (double)p.rows[j][i] * p.light[i];
            for (int k = 0; k < POINTER_ROWS; k++) {
                M[POINTER_ROWS * j + k] += (double)p.rows[j][i] * p.rows[k][i];
            }
        }
    }
    /* The sums over the pointers' coverages are their products with the constant. */
    if (M[2] < POINTER_IN_VIEW && M[3] < POINTER_IN_VIEW) {
        return 0;
    }
    for (int j = 0; j < POINTER_ROWS; j++) {
        M[(POINTER_ROWS + 1) * j] += 1e-6;
        inverse[(POINTER_ROWS + 1) * j] = 1.0;
    }
    if (!solve_symmetric(POINTER_ROWS, POINTER_ROWS, M, 1, a) || !solve_symmetric(POINTER_ROWS, POINTER_ROWS, M, POINTER_ROWS, inverse)) {
        return 0;
    }
    double squares = 0.0;
    for (int i = 0; i < p.n; i++) {
        const double left = p.light[i] - a[0] * p.rows[0][i] - a[1] * p.rows[1][i] - a[2] * p.rows[2][i] - a[3] * p.rows[3][i];
        squares += left * left;
    }
    out->here = a[2], out->there = a[3];
    out->sigma = sqrt(squares / (p.n > 5 ? p.n - POINTER_ROWS : 1) * fmax(inverse[10], inverse[15]));
    return 1;
}

/* The support for every kind of edge from the regions' paints, and the fraction of all pixels that agree. */
static void find_support(const dl_pad_shape *pad, const patch *cut, const dense_fit *fit, const dense_rows *d, const pointer *p,
                         fit_solved *out)
{
    double all = 0.0;
    for (int i = 0; i < cut->n; i++) {
        all += (d->weight[0][i] + d->weight[1][i] + d->weight[2][i]) / 3.0;
    }
    out->inliers = fmin(1.0, all / cut->n / MEAN_WEIGHT);
    for (int kind = 0; kind < DL_EDGE_KINDS; kind++) {
        dl_edge_support *e = &out->edges[kind];
        if (pad->contrast_of_kind[kind] < 0) {
            *e = (dl_edge_support){.likeness = 1.0};
            continue;
        }
        const int row = FIRST_REGION + (int)pad->contrast_of_kind[kind];
        double total = 0.0, agree = 0.0, snr2 = 0.0;
        if (kind == pad->pointer_kind) {
            *e = p ? pointer_support(p->here, p->sigma, fit->paints[row], 1.0) : (dl_edge_support){.likeness = 1.0};
            continue;
        }
        for (int i = 0; i < cut->n; i++) {
            const double covered = d->values[row][i], edge = covered * (1.0 - covered);
            total += edge;
            agree += edge * (d->weight[0][i] + d->weight[1][i] + d->weight[2][i]) / 3.0;
        }
        for (int c = 0; c < CHANNELS; c++) {
            e->contrast_bgr[c] = fit->paints[row][c];
            snr2 += fit->paints[row][c] * fit->paints[row][c] / fmax(fit->var_paints[row][c], 1e-12);
        }
        e->snr = sqrt(snr2), e->in_view = 1.0, e->likeness = 1.0;
        e->inliers = total > 1e-6 ? fmin(1.0, agree / (MEAN_WEIGHT * total)) : 0.0;
    }
}

/* Write information on a state in the axes of another, which is turned against it. */
static void in_axes_of(const fit_state *from, const fit_state *to, double H[STATES * STATES])
{
    double Q[9], way[3];
    product_of_transposed(to->R, from->R, Q);
    for (int side = 0; side < 2; side++) {
        const int along = side ? 1 : STATES, across = side ? STATES : 1;
        for (int block = 0; block < POSE; block += 3) {
            for (int k = 0; k < STATES; k++) {
                double *at = H + block * along + k * across;
                rotated(Q, (const double[3]){at[0], at[along], at[2 * along]}, way);
                at[0] = way[0], at[along] = way[1], at[2 * along] = way[2];
            }
        }
    }
}

/* Linearise and step until pose and blur rest; `s` is moved, and `out` takes the robust information and the last step. */
static int converge(const fit_task *k, const patch *cut, const solver *v, dense_rows *d, fit_state *s, dense_fit *fit, fit_solved *out)
{
    double grown = 0.0, moved_px = INFINITY, g[STATES], *H = out->H;
    for (int n = 0; n < ROUNDS; n++) {
        const int last = (n >= 1 && moved_px < FAR_AT_REST_PX && grown < BLUR_AT_REST_PX) || n == ROUNDS - 1;
        fit_state next;
        *k->work += cut->n * PIXEL_WORK;
        if (!linearise_dense(k->pad, cut, s, n == 0, last, d, fit)) {
            return 0;
        }
        if (last) {
            displace_sectors(k->size_sigma_m / s->m_per_px, fit);
        }
        if ((last && !robust_sums(fit, H, g)) ||
            !step_state(v, s, last ? H : fit->H, last ? g : fit->g, FAR_STEP_PX, n > 0, &next, &moved_px) || (n >= 3 && moved_px > ASTRAY_PX)) {
            return 0;
        }
        grown = fabs(sigma_px(&next) - sigma_px(s));
        if (last) {
            in_axes_of(s, &next, H);
        }
        *s = next;
        if (last) {
            break;
        }
    }
    return 1;
}

int register_far(const fit_task *k, const fit_state *start, fit_solved *out)
{
    const dl_pad_shape *pad = k->pad;
    rows r = k->free;
    patch cut;
    dense_rows d;
    dense_fit fit = {.noise = 0.0};
    solver priors;
    pointer seen;
    fit_state s;
    if (!take_dense_rows(&r, &d)) {
        return 0;
    }
    const patch_work work = {d.values[0], &d.f};
    if (!cut_patch(&k->seen, pad, start, 1.5 + 3.0 * sigma_px(start), &r, &work, &cut)) {
        return 0;
    }
    s = cut.state;
    begin_solver(&s, &k->tilt, pad->disc_radius_m, &priors);
    priors.distant = 1;
    memset(out, 0, sizeof *out);
    if (!converge(k, &cut, &priors, &d, &s, &fit, out) || !covariance_of(&priors, &s, out->H, out->cov)) {
        return 0;
    }
    /* Surroundings alone are no object on the pad, and an overexposed pad is not one beside even surroundings. */
    out->dense = 1, out->doubted = fmin(fit.noise, fit.noise_on_pad) > NOISE_DOUBTED + NOISE_DOUBT * cut.noise;
    if (out->doubted) {
        add_doubt(&s, pad, out->cov);
    }
    const int in_view = find_pointer(pad, &cut, &s, &fit, &d, &seen);
    find_support(pad, &cut, &fit, &d, in_view ? &seen : NULL, out);
    out->arrow_seen = in_view && stands_out(seen.here, seen.there, seen.sigma) && !out->doubted;
    for (int kind = 0; kind < DL_EDGE_KINDS; kind++) {
        out->visible += out->edges[kind].in_view / kinds_drawn(pad);
    }
    out->inliers *= out->doubted ? 0.5 : 1.0;
    out->noise_light = sqrt(fit.noise * 0.5 / NOISE_LEFT);
    out->state = restored(&s, cut.reduced, SMOOTHING_PX2);
    return 1;
}

int is_opposite(const fit_task *k, const fit_state *s)
{
    rows r = k->free;
    patch cut;
    dense_rows d;
    dense_fit fit = {.noise = 0.0};
    pointer seen;
    if (!take_dense_rows(&r, &d)) {
        return 0;
    }
    const patch_work work = {d.values[0], &d.f};
    return cut_patch(&k->seen, k->pad, s, 3.0, &r, &work, &cut) && linearise_dense(k->pad, &cut, &cut.state, 1, 0, &d, &fit) &&
           find_pointer(k->pad, &cut, &cut.state, &fit, &d, &seen) && stands_out(seen.there, seen.here, seen.sigma);
}
