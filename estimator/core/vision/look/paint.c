/* What is known of the colours of the paints, which follows each frame that shows the pad slowly. */

#include <math.h>

#include "vision/look/look.h"

/* Weight of one frame: half of what is known is newer than 14 frames. */
static const double RATE = 0.05;
/* Samples of a paint alone that a frame needs to change what is known of it. */
static const double ENOUGH = 6.0;
/* Limit, in standard deviations, on the change of a paint that one frame may cause. */
static const double FARTHEST = 3.0;
/* Least scatter of a paint's light, natural logarithms. */
static const double LEAST_SCATTER = 0.03;

void look_paint(const dl_pad_paint *known, const dl_aligned_pad *aligned, dl_pad_paint *out)
{
    *out = *known;
    for (int i = 0; i < 12; i++) {
        const double mean = aligned->light_mean[i], scatter = aligned->light_var[i] + LEAST_SCATTER * LEAST_SCATTER;
        if (aligned->light_n[i / 3] < ENOUGH) {
            continue;
        }
        if (known->trust == 0.0) {
            out->mean[i] = mean, out->var[i] = scatter;
            continue;
        }
        const double reach = FARTHEST * sqrt(known->var[i]);
        const double step = fmin(fmax(mean - known->mean[i], -reach), reach);
        out->mean[i] += RATE * step;
        out->var[i] += RATE * (scatter + step * step - known->var[i]);
    }
    out->trust += RATE * (1.0 - known->trust);
}
