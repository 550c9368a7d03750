/* Vectors of the compiler (gcc, clang): four and eight numbers at once, whatever the machine's registers hold. */
#ifndef DECKLANDER_VECTORS_H
#define DECKLANDER_VECTORS_H

#include <stdint.h>

typedef float float4 __attribute__((vector_size(16)));
typedef float float8 __attribute__((vector_size(32), aligned(4), may_alias));
typedef double double4 __attribute__((vector_size(32)));
typedef int32_t int4 __attribute__((vector_size(16)));

/* Four small integers in a row, as floats. Compilers turn integers of their size into floats together, and smaller ones one by one. */
static inline float4 four_of(const int16_t *from)
{
    const int4 wide = {from[0], from[1], from[2], from[3]};
    return __builtin_convertvector(wide, float4);
}

/* Between the numbers at a and those at b. */
static inline float4 four_between(const int16_t *a, const int16_t *b, float t)
{
    const float4 from = four_of(a);
    return from + t * (four_of(b) - from);
}

/* Eight floats in a row, to read or write. */
static inline float8 *eight(float *at)
{
    return (float8 *)(void *)at;
}

/* Eight floats in a row, to read. */
static inline const float8 *eight_of(const float *at)
{
    return (const float8 *)(const void *)at;
}

#endif
