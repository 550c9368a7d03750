/* A reflection of the sun on the distant pad: added light, flat in the middle and soft at the rim.
 *
 * The added light is estimated together with the paints, so that it biases no edge. Its position and width are chosen from a few
 * candidates by the fraction of the residuals they explain, and then follow its gradients from one linearisation to the next. */
#ifndef DECKLANDER_REGISTER_GLARE_H
#define DECKLANDER_REGISTER_GLARE_H

#include "vision/register/patch.h"

/* Light in the middle, and its derivatives by x, y and the radius. */
enum { GLARE_COLUMNS = 4 };

/* Position and width of a reflection on the pad, m; a radius of 0 for none. */
typedef struct {
    double x, y, radius;
} glare;

/* The light of a reflection of strength one at each point, and its derivatives, per metre. */
void glare_columns(const glare *g, const footprint *f, float *const columns[GLARE_COLUMNS]);
/* The reflection moved by the amplitudes of its columns. */
glare glare_moved(const glare *g, const double amplitudes[GLARE_COLUMNS], double disc_radius_m);
/* The reflection that explains most of what the paints leave, radius 0 if none explains enough. `weight` and `residual` are by
 * channel; `values` are the regressors of `k` paint coefficients; `spare` are GLARE_SPARE rows that are written over. */
enum { GLARE_SPARE = 3 + GLARE_COLUMNS + 3 + DL_PAD_CONTRASTS };
glare glare_found(const footprint *f, float *const residual[CHANNELS], float *const weight[CHANNELS], int k, float *const *values,
                  double disc_radius_m, float *const spare[GLARE_SPARE]);

#endif
