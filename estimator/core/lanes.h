/* Eight numbers of sixteen bits at once, and four of them as floats: by SSE2 where the machine has it, else one by one.
 *
 * Both ways compute the same bits.
 */
#ifndef DECKLANDER_LANES_H
#define DECKLANDER_LANES_H

#include <stdint.h>
#include <string.h>

#if defined(__SSE2__) && !defined(LANES_ONE_BY_ONE)

#include <emmintrin.h>

typedef __m128i lanes;
typedef __m128 four;

static inline lanes lanes_load(const void *p)
{
    return _mm_loadu_si128((const __m128i *)p);
}

static inline void lanes_store(void *p, lanes a)
{
    _mm_storeu_si128((__m128i *)p, a);
}

/* The lower four lanes; the others are zero. */
static inline lanes lanes_load_four(const void *p)
{
    return _mm_loadl_epi64((const __m128i *)p);
}

static inline void lanes_store_four(void *p, lanes a)
{
    _mm_storel_epi64((__m128i *)p, a);
}

static inline lanes lanes_all(uint16_t value)
{
    return _mm_set1_epi16((short)value);
}

static inline lanes lanes_add(lanes a, lanes b)
{
    return _mm_add_epi16(a, b);
}

static inline lanes lanes_xor(lanes a, lanes b)
{
    return _mm_xor_si128(a, b);
}

/* a b / 65536, rounded down. */
static inline lanes lanes_times(lanes a, lanes b)
{
    return _mm_mulhi_epu16(a, b);
}

/* The sums of the lower and the upper four lanes, in the lower ones. */
static inline lanes lanes_fold(lanes a)
{
    return _mm_add_epi16(a, _mm_srli_si128(a, 8));
}

static inline four four_load(const float *p)
{
    return _mm_loadu_ps(p);
}

static inline four four_scaled(four a, float by)
{
    return _mm_mul_ps(a, _mm_set1_ps(by));
}

/* The lower four lanes times floats of 0 or more, rounded, 32767 at most. */
static inline lanes lanes_lit(lanes a, four by)
{
    const __m128 exact = _mm_mul_ps(_mm_cvtepi32_ps(_mm_unpacklo_epi16(a, _mm_setzero_si128())), by);
    const __m128 most = _mm_min_ps(_mm_add_ps(exact, _mm_set1_ps(0.5f)), _mm_set1_ps(32767.0f));
    const __m128i whole = _mm_cvttps_epi32(most);
    return _mm_packs_epi32(whole, whole);
}

#else

typedef struct {
    uint16_t v[8];
} lanes;

typedef struct {
    float v[4];
} four;

static inline lanes lanes_load(const void *p)
{
    lanes a;
    memcpy(&a, p, sizeof a);
    return a;
}

static inline void lanes_store(void *p, lanes a)
{
    memcpy(p, &a, sizeof a);
}

static inline lanes lanes_load_four(const void *p)
{
    lanes a = {{0}};
    memcpy(&a, p, sizeof a / 2);
    return a;
}

static inline void lanes_store_four(void *p, lanes a)
{
    memcpy(p, &a, sizeof a / 2);
}

static inline lanes lanes_all(uint16_t value)
{
    const lanes a = {{value, value, value, value, value, value, value, value}};
    return a;
}

static inline lanes lanes_add(lanes a, lanes b)
{
    for (int k = 0; k < 8; k++) {
        a.v[k] = (uint16_t)(a.v[k] + b.v[k]);
    }
    return a;
}

static inline lanes lanes_xor(lanes a, lanes b)
{
    for (int k = 0; k < 8; k++) {
        a.v[k] ^= b.v[k];
    }
    return a;
}

static inline lanes lanes_times(lanes a, lanes b)
{
    for (int k = 0; k < 8; k++) {
        a.v[k] = (uint16_t)((uint32_t)a.v[k] * b.v[k] >> 16);
    }
    return a;
}

static inline lanes lanes_fold(lanes a)
{
    for (int k = 0; k < 4; k++) {
        a.v[k] = (uint16_t)(a.v[k] + a.v[k + 4]);
    }
    return a;
}

static inline four four_load(const float *p)
{
    four a;
    memcpy(&a, p, sizeof a);
    return a;
}

static inline four four_scaled(four a, float by)
{
    for (int k = 0; k < 4; k++) {
        a.v[k] *= by;
    }
    return a;
}

static inline lanes lanes_lit(lanes a, four by)
{
    for (int k = 0; k < 4; k++) {
        const float rounded = (float)a.v[k] * by.v[k] + 0.5f;
        a.v[k] = (uint16_t)(rounded < 32767.0f ? rounded : 32767.0f);
    }
    return a;
}

#endif

#endif
