/* Eight numbers of sixteen bits at once, as vectors of the compiler: SSE2, NEON, or what the machine has. */
#ifndef DECKLANDER_LANES_H
#define DECKLANDER_LANES_H

#include <stdint.h>
#include <string.h>

typedef uint16_t lanes __attribute__((vector_size(16)));
typedef int16_t signed_lanes __attribute__((vector_size(16)));
typedef uint64_t lane_halves __attribute__((vector_size(16)));

/* Bring a part of memory near, which need not exist. */
static inline void lanes_fetch(uintptr_t address)
{
    __builtin_prefetch((const void *)address);
}

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

/* The lower four lanes; the others are zero. */
static inline lanes lanes_load_four(const void *p)
{
    lane_halves a = {0};
    memcpy(&a, p, sizeof a / 2);
    return (lanes)a;
}

static inline void lanes_store_four(void *p, lanes a)
{
    memcpy(p, &a, sizeof a / 2);
}

static inline lanes lanes_all(uint16_t value)
{
    const lanes a = {value, value, value, value, value, value, value, value};
    return a;
}

/* a b / 65536, rounded down. */
static inline lanes lanes_times(lanes a, lanes b)
{
#ifdef __SSE2__ /* not every compiler finds the one instruction that does this */
    return (lanes)__builtin_ia32_pmulhuw128((signed_lanes)a, (signed_lanes)b);
#else
    for (int k = 0; k < 8; k++) {
        a[k] = (uint16_t)((uint32_t)a[k] * b[k] >> 16);
    }
    return a;
#endif
}

/* a b / 65536, rounded to the nearest. */
static inline lanes lanes_times_rounded(lanes a, lanes b)
{
    return lanes_times(a, b) + (a * b >> 15);
}

/* The numbers, those above 32767 as 32767. */
static inline lanes lanes_saturated(lanes a)
{
    const lanes above = (lanes)((signed_lanes)a >> 15);
    return (a | above) & lanes_all(INT16_MAX);
}

/* The lower halves of two, one after the other, and the upper ones. */
static inline lanes lanes_lower_halves(lanes a, lanes b)
{
    const lane_halves lower = {((lane_halves)a)[0], ((lane_halves)b)[0]};
    return (lanes)lower;
}

static inline lanes lanes_upper_halves(lanes a, lanes b)
{
    const lane_halves upper = {((lane_halves)a)[1], ((lane_halves)b)[1]};
    return (lanes)upper;
}

/* The sums of the lower and the upper four lanes, in the lower ones. */
static inline lanes lanes_fold(lanes a)
{
    const lane_halves upper = {((lane_halves)a)[1]};
    return a + (lanes)upper;
}

/* Four numbers from one place, and four from another. */
static inline lanes lanes_join(const void *lower, const void *upper)
{
    return lanes_lower_halves(lanes_load_four(lower), lanes_load_four(upper));
}

/* Two numbers from each of four places. */
static inline lanes lanes_of_pairs(const void *a, const void *b, const void *c, const void *d)
{
    int32_t pairs[4];
    memcpy(pairs, a, 4);
    memcpy(pairs + 1, b, 4);
    memcpy(pairs + 2, c, 4);
    memcpy(pairs + 3, d, 4);
    return lanes_load(pairs);
}

/* The lower four lanes of each of two, in turn, and the upper four. */
static inline lanes lanes_zip_lower(lanes a, lanes b)
{
    const lanes z = {a[0], b[0], a[1], b[1], a[2], b[2], a[3], b[3]};
    return z;
}

static inline lanes lanes_zip_upper(lanes a, lanes b)
{
    const lanes z = {a[4], b[4], a[5], b[5], a[6], b[6], a[7], b[7]};
    return z;
}

/* Eight bytes as lanes. */
static inline lanes lanes_load_bytes(const void *p)
{
    uint8_t bytes __attribute__((vector_size(8)));
    memcpy(&bytes, p, sizeof bytes);
    return __builtin_convertvector(bytes, lanes);
}

/* Bits of `a` where those of `choice` are set, else of `b`. */
static inline lanes lanes_choose(lanes choice, lanes a, lanes b)
{
    return (choice & a) | (~choice & b);
}

/* The sums of the products of neighbours, as signed numbers: four of 32 bits. */
static inline lanes lanes_dot_pairs(lanes a, lanes b)
{
#ifdef __SSE2__
    return (lanes)__builtin_ia32_pmaddwd128((signed_lanes)a, (signed_lanes)b);
#else
    int32_t sums[4];
    for (int k = 0; k < 4; k++) {
        sums[k] = (int16_t)a[2 * k] * (int16_t)b[2 * k] + (int16_t)a[2 * k + 1] * (int16_t)b[2 * k + 1];
    }
    return lanes_load(sums);
#endif
}

#endif
