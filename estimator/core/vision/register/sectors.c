/* Add to a covariance what sectors of the pad that are displaced together do. */

#include <math.h>

#include "vision/register/dense.h"

/* One over the distance from the centre, 1/m, within which a direction outward has no meaning. */
static const float LEAST_M = 1e-3f;
static const double KNOWN_LEAST = 1.0; /* Information on a sector's place, 1/px^2 over the noise's factor, from which it counts. */
static const double RIGHT_WEIGHT = 2.0; /* Sectors whose evidence it is worth that drawings are right. */

/* The sector of a place on the pad: its eighth of a turn. */
static int sector_of(float x, float y)
{
    return 4 * (y < 0.0f) + 2 * (x < 0.0f) + (fabsf(y) > fabsf(x));
}

void add_sectors(const dense_rows *d, int c, int start, int length, const float along[][SUM_BLOCK],
                 float *const projected[STATES], float m_per_px, dense_fit *fit)
{
    const float *along_x = along[0], *along_y = along[1];
    for (int i = 0; i < length; i++) {
        const float x = d->f.x[start + i], y = d->f.y[start + i], r = sqrtf(x * x + y * y), per = m_per_px / (r > LEAST_M ? r : LEAST_M);
        const double outward = per * (x * along_x[i] + y * along_y[i]), around = per * (x * along_y[i] - y * along_x[i]);
        const double w = d->w[c][start + i], left = w * d->residual[c][start + i];
        const int k2 = 2 * sector_of(x, y);
        double *by_outward = fit->pull[k2], *by_around = by_outward + STATES;
        fit->score[k2] += left * outward, fit->score[k2 + 1] += left * around;
        fit->known[k2] += w * outward * outward, fit->known[k2 + 1] += w * around * around;
        for (int k = 0; k < STATES; k++) {
            by_outward[k] += outward * projected[k][start + i];
            by_around[k] += around * projected[k][start + i];
        }
    }
}

/* The variance of the sectors' places, px^2, that neither noise nor pose explains.
 * Source of the estimate from the moments: DerSimonian, Laird, Meta-analysis in clinical trials, Controlled Clinical Trials 7(3), 1986. */
static double sector_variance(const dense_fit *fit)
{
    double noise = 0.0, squares = 0.0, known = 0.0;
    int n = 0;
    for (int i = 0; i < 3; i++) {
        noise += fit->gradient_cov[i * (STATES + 1)] / (3.0 * fmax(fit->H[i * (STATES + 1)], 1e-300));
    }
    for (int k = 0; k < SECTOR_MOVES; k++) {
        if (fit->known[k] > KNOWN_LEAST * noise) {
            squares += fit->score[k] * fit->score[k] / fit->known[k], known += fit->known[k];
            n++;
        }
    }
    const double free = n - STATES;
    if (n <= STATES) {
        return 0.0;
    }
    const double seen = fmax(0.0, (squares - noise * free) / (known * free / n));
    return free * seen / (RIGHT_WEIGHT + free);
}

void displace_sectors(double size_px, dense_fit *fit)
{
    double all[STATES] = {0.0};
    const double var = sector_variance(fit) + EDGE_SIGMA_PX * EDGE_SIGMA_PX;
    for (int k = 0; k < SECTOR_MOVES; k++) {
        const double *pull = fit->pull[k];
        for (int i = 0; i < STATES * STATES; i++) {
            fit->gradient_cov[i] += var * pull[i / STATES] * pull[i % STATES];
        }
        for (int i = 0; i < STATES && k % 2 == 0; i++) {
            all[i] += size_px * pull[i];
        }
    }
    for (int i = 0; i < STATES * STATES; i++) {
        fit->gradient_cov[i] += all[i / STATES] * all[i % STATES];
    }
}
