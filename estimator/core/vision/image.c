/* Check images and frames that are given to a tracker. */

#include "vision/tracker.h"

int is_image(const dl_image *image, int channels)
{
    return image != NULL && image->px != NULL && image->channels == channels && lies_within(image->width, 1, FRAME_SIDE_MAX)
           && lies_within(image->height, 1, FRAME_SIDE_MAX) && lies_within(image->stride, channels * image->width, INT32_MAX);
}

int is_frame(const dl_tracker *t, const dl_frame *frame)
{
    const int64_t w = t->camera.lens.width, h = t->camera.lens.height;
    if (!is_image(&frame->level[0], 3) || frame->level[0].stride != 3 * w) {
        return 0;
    }
    for (int k = 0; k <= DL_FRAME_LEVELS; k++) {
        const dl_image *one = &frame->level[k];
        const int64_t wide = w >> k > 0 ? w >> k : 1, high = h >> k > 0 ? h >> k : 1;
        if (one->px != NULL && (!is_image(one, 3) || one->width != wide || one->height != high)) {
            return 0;
        }
    }
    return 1;
}
