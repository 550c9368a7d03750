#include "interface.h"
#include "register_far.h"

/* Rows in the caller's memory; their length is a whole number of lanes. */
static rows rows_of(int32_t room, float *scratch)
{
    const rows r = {scratch, FIT_ROWS * room, room - room % LANES};
    return r;
}

int32_t register_dense(const camera_lens *camera, const double *rays, const uint8_t *frame, const float *light, const pad_shape *pad,
                       const tilt_prior *prior, const fit_options *o, const fit_state *start, int32_t room, float *scratch,
                       fit_solved *out)
{
    const view seen = {camera, rays, frame, light};
    rows r = rows_of(room, scratch);
    tilt_target tilt;
    predict_tilt(camera, prior, &tilt);
    return o->dense_pixels <= r.length && register_far(&seen, pad, o, &tilt, start, &r, out);
}

int32_t register_opposite(const camera_lens *camera, const double *rays, const uint8_t *frame, const float *light, const pad_shape *pad,
                          const fit_options *o, const fit_state *at, int32_t room, float *scratch)
{
    const view seen = {camera, rays, frame, light};
    rows r = rows_of(room, scratch);
    return o->dense_pixels <= r.length && is_opposite(&seen, pad, o, at, &r);
}
