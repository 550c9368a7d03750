/* The motion blur of a scene: shifted copies of it are added up.
 *
 * Source: the straight way of the frame's middle during the exposure, as weights of whole pixels.
 */

#include "interface.h"
#include "lanes.h"

static inline int32_t limited(int32_t i, int32_t n)
{
    return i < 0 ? 0 : i >= n ? n - 1 : i;
}

/* The weighted sum of some pixels of a row; beyond the frame its last ones continue. */
static inline void smear_pixel(int32_t w, int32_t column, int32_t count, const uint16_t *const *rows, const int32_t *shifts,
                               const uint16_t *weights, uint16_t *out)
{
    lanes sum = lanes_all((uint16_t)count);
    for (int32_t i = 0; i < count; i++) {
        const uint16_t *pixel = rows[i] + 4 * (int64_t)limited(column + shifts[2 * i], w);
        sum = lanes_add(sum, lanes_times(lanes_load_four(pixel), lanes_all(weights[i])));
    }
    lanes_store_four(out, sum);
}

void render_smear(int32_t h, int32_t w, const uint16_t *scene, int32_t count, const int32_t *shifts, const uint16_t *weights,
                  int32_t reach, uint16_t *smeared)
{
    const uint16_t *rows[SMEAR_MAX];
    for (int32_t row = 0; row < h; row++) {
        uint16_t *out = smeared + 4 * (int64_t)row * w;
        for (int32_t i = 0; i < count; i++) {
            rows[i] = scene + 4 * (int64_t)w * limited(row + shifts[2 * i + 1], h);
        }
        for (int32_t column = 0; column < w; column++) {
            if (column < reach || column + 2 + reach > w) {
                smear_pixel(w, column, count, rows, shifts, weights, out + 4 * column);
                continue;
            }
            lanes sum = lanes_all((uint16_t)count);
            for (int32_t i = 0; i < count; i++) {
                sum = lanes_add(sum, lanes_times(lanes_load(rows[i] + 4 * (column + shifts[2 * i])), lanes_all(weights[i])));
            }
            lanes_store(out + 4 * column++, sum);
        }
    }
}
