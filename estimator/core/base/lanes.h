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

static inline lanes lanes_at_most(lanes a, uint16_t most)
{
    return _mm_sub_epi16(a, _mm_subs_epu16(a, lanes_all(most)));
}

/* Four numbers from one place, and four from another. */
static inline lanes lanes_join(const void *lower, const void *upper)
{
    return _mm_unpacklo_epi64(lanes_load_four(lower), lanes_load_four(upper));
}

/* Two numbers from each of four places. */
static inline lanes lanes_of_pairs(const void *a, const void *b, const void *c, const void *d)
{
    int32_t pairs[4];
    memcpy(pairs, a, 4);
    memcpy(pairs + 1, b, 4);
    memcpy(pairs + 2, c, 4);
    memcpy(pairs + 3, d, 4);
    return _mm_set_epi32(pairs[3], pairs[2], pairs[1], pairs[0]);
}

/* The lower four lanes of each of two, in turn, and the upper four. */
static inline lanes lanes_zip_lower(lanes a, lanes b)
{
    return _mm_unpacklo_epi16(a, b);
}

static inline lanes lanes_zip_upper(lanes a, lanes b)
{
    return _mm_unpackhi_epi16(a, b);
}

/* The lower halves of two, one after the other, and the upper ones. */
static inline lanes lanes_lower_halves(lanes a, lanes b)
{
    return _mm_unpacklo_epi64(a, b);
}

static inline lanes lanes_upper_halves(lanes a, lanes b)
{
    return _mm_unpackhi_epi64(a, b);
}

/* Eight bytes as lanes. */
static inline lanes lanes_load_bytes(const void *p)
{
    return _mm_unpacklo_epi8(lanes_load_four(p), _mm_setzero_si128());
}

/* All bits of the lanes that are equal. */
static inline lanes lanes_equal(lanes a, lanes b)
{
    return _mm_cmpeq_epi16(a, b);
}

/* Bits of `a` where those of `choice` are set, else of `b`. */
static inline lanes lanes_choose(lanes choice, lanes a, lanes b)
{
    return _mm_or_si128(_mm_and_si128(choice, a), _mm_andnot_si128(choice, b));
}

static inline lanes lanes_or(lanes a, lanes b)
{
    return _mm_or_si128(a, b);
}

/* The sums of the products of neighbours, as signed numbers: four of 32 bits. */
static inline lanes lanes_dot_pairs(lanes a, lanes b)
{
    return _mm_madd_epi16(a, b);
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

static inline lanes lanes_at_most(lanes a, uint16_t most)
{
    for (int k = 0; k < 8; k++) {
        a.v[k] = a.v[k] < most ? a.v[k] : most;
    }
    return a;
}

static inline lanes lanes_join(const void *lower, const void *upper)
{
    lanes a;
    memcpy(a.v, lower, sizeof a / 2);
    memcpy(a.v + 4, upper, sizeof a / 2);
    return a;
}

static inline lanes lanes_of_pairs(const void *a, const void *b, const void *c, const void *d)
{
    lanes pairs;
    memcpy(pairs.v, a, 4);
    memcpy(pairs.v + 2, b, 4);
    memcpy(pairs.v + 4, c, 4);
    memcpy(pairs.v + 6, d, 4);
    return pairs;
}

static inline lanes lanes_zip_lower(lanes a, lanes b)
{
    const lanes z = {{a.v[0], b.v[0], a.v[1], b.v[1], a.v[2], b.v[2], a.v[3], b.v[3]}};
    return z;
}

static inline lanes lanes_zip_upper(lanes a, lanes b)
{
    const lanes z = {{a.v[4], b.v[4], a.v[5], b.v[5], a.v[6], b.v[6], a.v[7], b.v[7]}};
    return z;
}

static inline lanes lanes_lower_halves(lanes a, lanes b)
{
    memcpy(a.v + 4, b.v, sizeof a / 2);
    return a;
}

static inline lanes lanes_upper_halves(lanes a, lanes b)
{
    memcpy(b.v, a.v + 4, sizeof a / 2);
    return b;
}

static inline lanes lanes_load_bytes(const void *p)
{
    uint8_t bytes[8];
    lanes a;
    memcpy(bytes, p, sizeof bytes);
    for (int k = 0; k < 8; k++) {
        a.v[k] = bytes[k];
    }
    return a;
}

static inline lanes lanes_equal(lanes a, lanes b)
{
    for (int k = 0; k < 8; k++) {
        a.v[k] = a.v[k] == b.v[k] ? UINT16_MAX : 0;
    }
    return a;
}

static inline lanes lanes_choose(lanes choice, lanes a, lanes b)
{
    for (int k = 0; k < 8; k++) {
        a.v[k] = (uint16_t)((choice.v[k] & a.v[k]) | (~choice.v[k] & b.v[k]));
    }
    return a;
}

static inline lanes lanes_or(lanes a, lanes b)
{
    for (int k = 0; k < 8; k++) {
        a.v[k] |= b.v[k];
    }
    return a;
}

static inline lanes lanes_dot_pairs(lanes a, lanes b)
{
    int32_t sums[4];
    for (int k = 0; k < 4; k++) {
        sums[k] = (int16_t)a.v[2 * k] * (int16_t)b.v[2 * k] + (int16_t)a.v[2 * k + 1] * (int16_t)b.v[2 * k + 1];
    }
    memcpy(a.v, sums, sizeof a);
    return a;
}

#endif

#endif
