/* Pixels for registration by profiles: short rows of pixels across the edges of the drawing that are in view.
 *
 * Pixels are used as they are, without interpolation, each with its exact position on the drawing. Their noise thus stays
 * independent, and no blur is added. Consecutive profiles along an edge form a group with its own two light levels, so neither
 * uneven light nor the pattern of the surroundings biases an edge. */
#ifndef DECKLANDER_REGISTER_PROFILES_H
#define DECKLANDER_REGISTER_PROFILES_H

#include "vision/register/coverage.h"
#include "vision/register/patch.h"
#include "vision/register/sums.h"

enum { GROUPS_MAX = 256, IN_GROUP = 6, HALF_MAX = 9 };

/* Points of the drawing's edges: x, y, unit normal out of the inner paint, distance to the next; and the kind and piece of each.
 * Points of a kind and of a piece are side by side. */
typedef struct {
    int32_t points;
    const double *at;
    const int32_t *of;
} edge_points;

/* The pixels of a group: `begin` to `end`, the first `length` are its profiles' and the others have no weight. */
typedef struct {
    int begin, end, length, kind;
} group;

/* Pixels across edges, by kind and group; each group begins at a multiple of `LANES`. */
typedef struct {
    int n, samples, groups, groups_of_kind[DL_EDGE_KINDS], kind_begin[DL_EDGE_KINDS + 1];
    double in_view[DL_EDGE_KINDS];
    group each[GROUPS_MAX];
    /* Rays, linear light by channel, and 1 for a pixel that counts: not one that another profile uses too or that sees a third
     * paint. */
    float *ray_x, *ray_y, *light[CHANNELS], *usable;
} profiles;

/* Memory that profiles are sampled with and that is free afterwards: five rows of `room` numbers, and ten. */
typedef struct {
    int32_t room;
    float *keys;
    double *doubles;
} profile_work;

/* Profiles of 2 half + 1 pixels across the edges in view, at most some PROFILES of them. Returns 0 if there are too few for a fix. */
int sample_profiles(const view *v, const fit_state *s, const edge_points *edges, int half, const profile_work *work, profiles *out);
/* Let no pixel count that lies within three deviations of the blur of an edge of another kind. `spare`: a row that is written over. */
void drop_foreign(const dl_pad_shape *pad, const fit_state *s, const footprint *f, float *spare, profiles *p);

#endif
