/* Eight numbers of sixteen bits at once: by SSE2 where the machine has it, else one by one.
 *
 * Both ways compute the same bits.
 */
#ifndef DECKLANDER_LANES_H
#define DECKLANDER_LANES_H

#include <stdint.h>
#include <string.h>

/* Bring a part of memory near, which need not exist. */
static inline void lanes_fetch(uintptr_t address)
{
    __builtin_prefetch((const void *)address);
}

#if defined(__SSE2__) && !defined(LANES_ONE_BY_ONE)

#include <emmintrin.h>

typedef __m128i lanes;

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

/* a b / 65536, rounded to the nearest. */
static inline lanes lanes_times_rounded(lanes a, lanes b)
{
    return _mm_add_epi16(_mm_mulhi_epu16(a, b), _mm_srli_epi16(_mm_mullo_epi16(a, b), 15));
}

/* The sum, 65535 at most. */
static inline lanes lanes_add_limited(lanes a, lanes b)
{
    return _mm_adds_epu16(a, b);
}

static inline lanes lanes_at_most(lanes a, uint16_t most)
{
    return _mm_sub_epi16(a, _mm_subs_epu16(a, lanes_all(most)));
}

/* One number in the lower four lanes, another in the upper ones. */
static inline lanes lanes_of_two(uint16_t lower, uint16_t upper)
{
    const __m128i pair = _mm_cvtsi32_si128((int)((uint32_t)upper << 16 | lower));
    return _mm_shuffle_epi32(_mm_unpacklo_epi16(pair, pair), 0x50);
}

/* Four numbers from one place, and four from another. */
static inline lanes lanes_join(const void *lower, const void *upper)
{
    return _mm_unpacklo_epi64(lanes_load_four(lower), lanes_load_four(upper));
}

/* The upper four lanes as lower ones. */
static inline lanes lanes_upper(lanes a)
{
    return _mm_srli_si128(a, 8);
}

#else

typedef struct {
    uint16_t v[8];
} lanes;

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

static inline lanes lanes_times_rounded(lanes a, lanes b)
{
    for (int k = 0; k < 8; k++) {
        a.v[k] = (uint16_t)(((uint32_t)a.v[k] * b.v[k] + 32768u) >> 16);
    }
    return a;
}

static inline lanes lanes_add_limited(lanes a, lanes b)
{
    for (int k = 0; k < 8; k++) {
        const uint32_t sum = (uint32_t)a.v[k] + b.v[k];
        a.v[k] = (uint16_t)(sum < UINT16_MAX ? sum : UINT16_MAX);
    }
    return a;
}

static inline lanes lanes_at_most(lanes a, uint16_t most)
{
    for (int k = 0; k < 8; k++) {
        a.v[k] = a.v[k] < most ? a.v[k] : most;
    }
    return a;
}

static inline lanes lanes_of_two(uint16_t lower, uint16_t upper)
{
    const lanes a = {{lower, lower, lower, lower, upper, upper, upper, upper}};
    return a;
}

static inline lanes lanes_join(const void *lower, const void *upper)
{
    lanes a;
    memcpy(a.v, lower, sizeof a / 2);
    memcpy(a.v + 4, upper, sizeof a / 2);
    return a;
}

static inline lanes lanes_upper(lanes a)
{
    memmove(a.v, a.v + 4, sizeof a / 2);
    return a;
}

#endif

#endif
