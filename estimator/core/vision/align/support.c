/* Support of a pad's drawing: the log-likelihood ratio of the light about the pad with the drawing and without it. */

#include <math.h>
#include <string.h>

#include "vision/align/align.h"

/* Cells along a side, about how many samples each has, and the fewest that count. */
enum { CELLS = 7, SAMPLES = 50, FEWEST = 8 };
/* Residual in the square root of light, full scale 1, that a right drawing leaves anyway in a clear frame. */
static const double USUAL_NOISE = 0.012;
/* Log-odds against a cell being hidden: that much speaks against the pad where another thing is seen in its place, and no more. */
static const double SUPPORT_HIDDEN = 2.0;
/* A Gaussian blurs this many pixels into one, by its variance in pixels: 4 pi. */
static const double GROUP = 12.566370614359172;

typedef struct {
    double n, seen, left, drawn;
} cell;

/* The cell that a sample lies in. */
static int cell_of(float x, float y, int side, float reach)
{
    const int i = (int)((x + reach) / (2.0f * reach) * (float)side), j = (int)((y + reach) / (2.0f * reach) * (float)side);
    return (i < 0 ? 0 : i >= side ? side - 1 : i) * side + (j < 0 ? 0 : j >= side ? side - 1 : j);
}

void align_support(const dl_pad_template *p, const samples *s, int blur, double side_m, const dl_quality *of, dl_drawing_support *out)
{
    cell cells[CELLS * CELLS];
    int side = (int)sqrt((double)s->n / SAMPLES);
    side = side < 1 ? 1 : side > CELLS ? CELLS : side;
    memset(cells, 0, sizeof cells);
    memset(out, 0, sizeof *out);
    for (int i = 0; i < s->n; i++) {
        cell *at = &cells[cell_of(s->x[i], s->y[i], side, (float)(AROUND_RADII * p->disc_radius_m))];
        at->n += 1.0;
        at->left += (double)s->squared[i];
        for (int c = 0; c < 3; c++) {
            const double light = (double)s->light[c][i], drawn = light - (double)s->residual[c][i];
            at->seen += light * light;
            at->drawn += drawn * drawn;
        }
    }
    /* Blurred pixels are no separate witnesses: this many are one. */
    const double blur_px = exp(p->log_blur[blur]) / side_m, group = 1.0 + GROUP * blur_px * blur_px;
    const double usual = USUAL_NOISE * of->contrast, var = usual * usual + of->noise * of->noise;
    double agrees = 0.0;
    for (int k = 0; k < side * side; k++) {
        const cell *at = &cells[k];
        if (at->n < FEWEST) {
            continue;
        }
        const double floor = 3.0 * at->n * var + 1e-9, witnesses = 0.5 * at->n / group;
        const double could = witnesses * log1p(at->drawn / floor), support = witnesses * log((at->seen + floor) / (at->left + floor));
        out->could += could;
        out->support += fmax(support, -fmin(SUPPORT_HIDDEN, could));
        agrees += fmax(0.0, support > could ? could : support);
        out->against += support < 0.0 ? could : 0.0;
    }
    out->share = out->could > 0.0 ? agrees / out->could : 0.0;
    out->against = out->could > 0.0 ? out->against / out->could : 0.0;
}
