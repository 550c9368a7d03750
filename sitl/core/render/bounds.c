/* Which part of a frame a mask covers, and which part it leaves open. */

#include "decklander_sim.h"
#include "base/wide.h"

enum { CHUNK = 256 };

/* What is known of a chunk of columns: the most and the least that covers a pixel of each. */
typedef struct {
    uint8_t most[CHUNK], least[CHUNK];
} columns;

/* The most and the least that covers a pixel of a row. */
typedef struct {
    uint8_t most, least;
} range;

WIDE
static range add_row(int32_t n, const uint8_t *restrict mask, columns *restrict c)
{
    range r = {0, UINT8_MAX};
    for (int32_t x = 0; x < n; x++) {
        const uint8_t here = mask[x];
        c->most[x] = here > c->most[x] ? here : c->most[x];
        c->least[x] = here < c->least[x] ? here : c->least[x];
        r.most = here > r.most ? here : r.most;
        r.least = here < r.least ? here : r.least;
    }
    return r;
}

/* Widen bounds, the upper one excluded; they are empty while both are equal. */
static void widen(int32_t *bounds, int32_t at)
{
    if (bounds[0] == bounds[1]) {
        bounds[0] = at;
        bounds[1] = at + 1;
    }
    bounds[0] = at < bounds[0] ? at : bounds[0];
    bounds[1] = at >= bounds[1] ? at + 1 : bounds[1];
}

void dl_sim_render_bounds(int32_t h, int32_t w, const uint8_t *mask, int32_t *covered, int32_t *open)
{
    memset(covered, 0, 4 * sizeof *covered);
    memset(open, 0, 4 * sizeof *open);
    for (int32_t x0 = 0; x0 < w; x0 += CHUNK) {
        const int32_t n = w - x0 < CHUNK ? w - x0 : CHUNK;
        columns c;
        memset(c.most, 0, sizeof c.most);
        memset(c.least, UINT8_MAX, sizeof c.least);
        for (int32_t y = 0; y < h; y++) {
            const range r = add_row(n, mask + (int64_t)y * w + x0, &c);
            if (r.most > 0) {
                widen(covered + 2, y);
            }
            if (r.least < UINT8_MAX) {
                widen(open + 2, y);
            }
        }
        for (int32_t x = 0; x < n; x++) {
            if (c.most[x] > 0) {
                widen(covered, x0 + x);
            }
            if (c.least[x] < UINT8_MAX) {
                widen(open, x0 + x);
            }
        }
    }
}
