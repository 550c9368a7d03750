/* Sum products of rows, and find medians. */

#include "vision/register/sums.h"

#include <math.h>
#include <string.h>

#include "base/vectors.h"
#include "base/wide.h"

/* The sum of eight lanes. */
static inline double across(const float8 *sum)
{
    const float8 s = *sum;
    return (double)((s[0] + s[4]) + (s[2] + s[6])) + (double)((s[1] + s[5]) + (s[3] + s[7]));
}

/* sum_n a[n] b[n] over a block */
static inline double block_product(int n, const float *a, const float *b)
{
    float8 sum = {0.0f};
    for (int i = 0; i < n; i += LANES) {
        sum += *eight_of(a + i) * *eight_of(b + i);
    }
    return across(&sum);
}

/* Add four rows of products at once, which share the values read from `a`. */
static inline void block_products(int n, const float *a, const float *const b[4], double *out)
{
    const float *b0 = b[0], *b1 = b[1], *b2 = b[2], *b3 = b[3];
    float8 s0 = {0.0f}, s1 = {0.0f}, s2 = {0.0f}, s3 = {0.0f};
    for (int i = 0; i < n; i += LANES) {
        const float8 of = *eight_of(a + i);
        s0 += of * *eight_of(b0 + i);
        s1 += of * *eight_of(b1 + i);
        s2 += of * *eight_of(b2 + i);
        s3 += of * *eight_of(b3 + i);
    }
    out[0] += across(&s0), out[1] += across(&s1), out[2] += across(&s2), out[3] += across(&s3);
}

/* Add the products of one row with rows from..b - 1. */
static inline void add_row(int n, const float *a, int from, int b, const float *const B[], int start, double *out)
{
    int j = from;
    for (; j + 4 <= b; j += 4) {
        const float *const four[4] = {B[j] + start, B[j + 1] + start, B[j + 2] + start, B[j + 3] + start};
        block_products(n, a, four, out + j);
    }
    for (; j < b; j++) {
        out[j] += block_product(n, a, B[j] + start);
    }
}

WIDE
void add_products(int n, int a, const float *const A[], int b, const float *const B[], int stride, double *out)
{
    for (int start = 0; start < n; start += SUM_BLOCK) {
        const int length = n - start < SUM_BLOCK ? n - start : SUM_BLOCK;
        for (int i = 0; i < a; i++) {
            add_row(length, A[i] + start, 0, b, B, start, out + i * stride);
        }
    }
}

WIDE
void add_squares(int n, int a, const float *const A[], const float *const B[], int stride, double *out)
{
    for (int start = 0; start < n; start += SUM_BLOCK) {
        const int length = n - start < SUM_BLOCK ? n - start : SUM_BLOCK;
        for (int i = 0; i < a; i++) {
            add_row(length, A[i] + start, i, a, B, start, out + i * stride);
        }
    }
}

void mirror(int n, int stride, double *M)
{
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < i; j++) {
            M[i * stride + j] = M[j * stride + i];
        }
    }
}

/* The bits of a float, in the order of the numbers. */
static inline uint32_t ordered(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits & 0x80000000u ? ~bits : bits | 0x80000000u;
}

static inline float unordered(uint32_t bits)
{
    bits = bits & 0x80000000u ? bits & 0x7FFFFFFFu : ~bits;
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

WIDE
static void keys_of(int n, const float *values, uint32_t *restrict keys)
{
    for (int i = 0; i < n; i++) {
        keys[i] = ordered(values[i]);
    }
}

/* The least and the largest of some keys. */
WIDE
static void ends_of(int n, const uint32_t *keys, uint32_t ends[2])
{
    uint32_t least = UINT32_MAX, most = 0;
    for (int i = 0; i < n; i++) {
        least = keys[i] < least ? keys[i] : least;
        most = keys[i] > most ? keys[i] : most;
    }
    ends[0] = least, ends[1] = most;
}

float order_statistic(int k, int n, const float *values, uint32_t *spare)
{
    enum { BINS = 512 };
    uint32_t ends[2];
    keys_of(n, values, spare);
    /* Keys are counted in bins between the least and the largest; those of the wanted one's bin are counted again. */
    for (ends_of(n, spare, ends); ends[0] < ends[1]; ends_of(n, spare, ends)) {
        uint32_t count[BINS] = {0}, bin = 0;
        int kept = 0, shift = 0;
        while ((ends[1] - ends[0]) >> shift >= BINS) {
            shift++;
        }
        for (int i = 0; i < n; i++) {
            count[(spare[i] - ends[0]) >> shift]++;
        }
        while ((int)count[bin] <= k) {
            k -= (int)count[bin++];
        }
        for (int i = 0; i < n; i++) {
            const uint32_t key = spare[i];
            spare[kept] = key;
            kept += (key - ends[0]) >> shift == bin;
        }
        n = kept;
    }
    return unordered(ends[0]);
}

float median_of(int n, const float *values, uint32_t *spare)
{
    return order_statistic(n / 2, n, values, spare);
}
