/* Take from cells of one paint what light can make of it: the docs of `estimator.vision.deck.clear_deck` say what that is. */

#include <math.h>
#include <string.h>

#include "base/linear.h"
#include "vision/register/sums.h"
#include "vision/tracker.h"

static const float WHITE_MOST = 2.0f; /* Most white light added to a paint that still shows, in its own light. */
static const float PURER = 0.8f; /* Share of white in its median that may be such light. */
static const float GLARE_OWN = 0.4f; /* Share of the paint's own light that is left where any amount of white is mirrored light. */
static const float MIRRORED = 2.5f; /* Light from which on it is, too. */
static const float STRONG_LIGHT = 1.5f; /* Light from which on differences count in parts of it. */
static const float SKY_MOST = 0.3f; /* Largest change of blue against red that shade makes. */
/* What is farther from the plane than this many deviations does not shape it. */
static const float NEAR = 3.0f * 1.4826f;
enum { CELLS_MAX = 1 << 16 };

static float dot(const float *a, const float *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void normalized(float *v, float more)
{
    const float by = 1.0f / (sqrtf(dot(v, v)) + more);
    for (int k = 0; k < 3; k++) {
        v[k] *= by;
    }
}

/* Write the weights of two directions in the light, neither below 0. */
static void shares(const float *light, const float *axis, const float *pale, float *of_own, float *of_pale)
{
    const float along = dot(light, axis), paler = dot(light, pale), cosine = dot(axis, pale);
    const float both = (paler - cosine * along) / fmaxf(1e-6f, 1.0f - cosine * cosine);
    const float own = along - cosine * both;
    *of_pale = both < 0.0f ? 0.0f : own < 0.0f ? paler : both;
    *of_own = both < 0.0f ? along : own < 0.0f ? 0.0f : own;
}

/* Subtract a slow plane from the cells, fitted to those near it. */
static void level(const float *place, int n, float *left, float *off, uint32_t *spare)
{
    double slow[9] = {0.0};
    for (int k = 0; k < 3; k++) {
        for (int i = 0; i < n; i++) {
            off[i] = left[3 * i + k];
        }
        slow[k] = median_of(n, off, spare);
    }
    for (int pass = 0; pass <= 2; pass++) {
        double M[9] = {1e-3, 0.0, 0.0, 0.0, 1e-3, 0.0, 0.0, 0.0, 1e-3}, B[9] = {0.0};
        for (int i = 0; i < n; i++) {
            off[i] = 0.0f;
            for (int k = 0; k < 3; k++) {
                const float rest = left[3 * i + k]
                                   - (float)(slow[k] + place[2 * i] * slow[3 + k] + place[2 * i + 1] * slow[6 + k]);
                off[i] = fmaxf(off[i], fabsf(rest));
                if (pass == 2) {
                    left[3 * i + k] = rest;
                }
            }
        }
        if (pass == 2) {
            return;
        }
        const float most = NEAR * median_of(n, off, spare);
        for (int i = 0; i < n; i++) {
            const double row[3] = {1.0, place[2 * i], place[2 * i + 1]};
            for (int j = 0; j < 9 && off[i] <= most; j++) {
                M[j] += row[j / 3] * row[j % 3], B[j] += row[j / 3] * left[3 * i + j % 3];
            }
        }
        solve_positive(3, M, 3, B);
        memcpy(slow, B, sizeof slow);
    }
}

int32_t dl_paint_rest(const float *light, const float *place, int32_t cells, const float *white, float *out, float *spare)
{
    if (!lies_within(cells, 1, CELLS_MAX)) {
        return DL_WRONG_SIZE;
    }
    const int n = cells;
    float *one = spare, own[3], hue[3] = {white[0], white[1], white[2]}, axis[3], pale[3], purest = INFINITY;
    uint32_t *keys = (uint32_t *)(void *)(spare + n);
    for (int k = 0; k < 3; k++) {
        for (int i = 0; i < n; i++) {
            one[i] = light[3 * i + k];
        }
        own[k] = median_of(n, one, keys);
    }
    const float size = sqrtf(dot(own, own)) + 1e-6f;
    normalized(hue, 1e-6f);
    for (int k = 0; k < 3; k++) {
        purest = fminf(purest, own[k] / size / fmaxf(hue[k], 1e-3f));
    }
    /* The median may be of wet paint: dry paint then has less white, as much as its channels leave. */
    for (int k = 0; k < 3; k++) {
        pale[k] = own[k] / size + WHITE_MOST * hue[k];
        axis[k] = own[k] / size - PURER * purest * hue[k];
    }
    normalized(pale, 0.0f), normalized(axis, 1e-6f);
    const float toward = dot(axis, hue), square = 1.0f - toward * toward;
    float sky[3] = {own[0] / size, 0.0f, -own[2] / size};
    const float in_axis = dot(sky, axis);
    for (int k = 0; k < 3; k++) {
        sky[k] -= in_axis * axis[k];
    }
    const float power = dot(sky, sky);
    for (int i = 0; i < n; i++) {
        const float *of = light + 3 * i;
        one[i] = (dot(of, axis) - toward * (dot(of, hue) - toward * dot(of, axis)) / fmaxf(square, 1e-6f)) / size;
    }
    const float least = GLARE_OWN * median_of(n, one, keys);
    for (int i = 0; i < n; i++) {
        const float *of = light + 3 * i;
        float left[3] = {of[0] / size, of[1] / size, of[2] / size}, of_own, of_pale;
        const float bright = sqrtf(dot(left, left)), of_white = (dot(left, hue) - toward * dot(left, axis)) / fmaxf(square, 1e-6f);
        const int mirrored = square > 0.05f && of_white > 0.0f && (bright > MIRRORED || one[i] >= least);
        shares(left, axis, pale, &of_own, &of_pale);
        for (int k = 0; k < 3; k++) {
            /* Mirrored light is any amount of white, of which a part may be a thing's. That hides markings. */
            left[k] -= mirrored ? one[i] * axis[k] + of_white * hue[k] : of_own * axis[k] + of_pale * pale[k];
            /* What is much brighter than the paint is off by errors of colour that grow with it. */
            left[k] /= fmaxf(1.0f, bright / STRONG_LIGHT);
        }
        const float blue = power > 1e-6f ? fmaxf(-SKY_MOST, fminf(SKY_MOST, dot(left, sky) / power)) : 0.0f;
        for (int k = 0; k < 3; k++) {
            out[3 * i + k] = left[k] - blue * sky[k];
        }
    }
    level(place, n, out, one, keys);
    return 1;
}
