/* What the decoder and the encoder of UVLC pictures share: start codes, order and steps of coefficients, the transform's basis.
 *
 * Source: Parrot, AR.Drone Developer Guide SDK 1.7, 7.2 (video stream), and the note uvlc.txt of its SDK. */
#ifndef DECKLANDER_UVLC_H
#define DECKLANDER_UVLC_H

#include "decklander.h"

#include <stdint.h>

enum {
    UVLC_SIDE = 8,
    UVLC_COEFFICIENTS = UVLC_SIDE * UVLC_SIDE,
    UVLC_MACROBLOCK = 2 * UVLC_SIDE,
    UVLC_BLOCKS = 6,
    UVLC_START_BITS = 22,
    UVLC_START = 0x20,
    UVLC_START_NUMBER = 0x1F,
    UVLC_END = 0x1F,
    UVLC_CIF = 1,
    UVLC_VGA = 2,
    UVLC_DC_BITS = 10,
    UVLC_HAS_CHANGE = 0x40,
    UVLC_ALWAYS = 0x80,
    /* A macroblock's four blocks of light, then Cb and Cr. */
    UVLC_CB = 4,
    UVLC_CR = 5,
    /* This quantizer stands for a table of an older firmware, which is that of quantizer 2. */
    UVLC_TABLE = 31,
    UVLC_OF_TABLE = 2
};

static const uint8_t UVLC_ZIGZAG[UVLC_COEFFICIENTS] = {
    0,  1,  8,  16, 9,  2,  3,  10, 17, 24, 32, 25, 18, 11, 4,  5,  12, 19, 26, 33, 40, 48, 41, 34, 27, 20, 13, 6,  7,  14, 21, 28,
    35, 42, 49, 56, 57, 50, 43, 36, 29, 22, 15, 23, 30, 37, 44, 51, 58, 59, 52, 45, 38, 31, 39, 46, 53, 60, 61, 54, 47, 55, 62, 63};

/* The orthonormal cosine transform: row k is frequency k at the eight places. */
static const float UVLC_BASIS[UVLC_SIDE][UVLC_SIDE] = {
    {0.353553391f, 0.353553391f, 0.353553391f, 0.353553391f, 0.353553391f, 0.353553391f, 0.353553391f, 0.353553391f},
    {0.49039264f, 0.415734806f, 0.277785117f, 0.097545161f, -0.097545161f, -0.277785117f, -0.415734806f, -0.49039264f},
    {0.461939766f, 0.191341716f, -0.191341716f, -0.461939766f, -0.461939766f, -0.191341716f, 0.191341716f, 0.461939766f},
    {0.415734806f, -0.097545161f, -0.49039264f, -0.277785117f, 0.277785117f, 0.49039264f, 0.097545161f, -0.415734806f},
    {0.353553391f, -0.353553391f, -0.353553391f, 0.353553391f, 0.353553391f, -0.353553391f, -0.353553391f, 0.353553391f},
    {0.277785117f, -0.49039264f, 0.097545161f, 0.415734806f, -0.415734806f, -0.097545161f, 0.49039264f, -0.277785117f},
    {0.191341716f, -0.461939766f, 0.461939766f, -0.191341716f, -0.191341716f, 0.461939766f, -0.461939766f, 0.191341716f},
    {0.097545161f, -0.277785117f, 0.415734806f, -0.49039264f, 0.49039264f, -0.415734806f, 0.277785117f, -0.097545161f},
};

/* Return the step of a coefficient, counted by rows. */
static inline int32_t uvlc_step(int32_t coefficient, int32_t quantizer)
{
    const int32_t of = quantizer == UVLC_TABLE ? UVLC_OF_TABLE : quantizer;
    return 1 + (1 + coefficient / UVLC_SIDE + coefficient % UVLC_SIDE) * of;
}

static inline uint8_t uvlc_byte(float value)
{
    return value <= 0.0f ? 0 : value >= 255.0f ? 255 : (uint8_t)(value + 0.5f);
}

/* Bits of UVLC pictures: 32-bit words, low byte first, whose bits run from the highest to the lowest. */
typedef struct {
    const uint8_t *data;
    int32_t words;
    int32_t next;
    /* The next bits, the first of them highest; `held` of them are there. */
    uint64_t bits;
    int32_t held;
} bit_reader;

static inline bit_reader read_bits_of(const uint8_t *data, int32_t bytes)
{
    return (bit_reader){data, bytes / 4, 0, 0, 0};
}

/* Return the next 32 bits and leave them there. Beyond the end bits are zero. */
static inline uint32_t peek_32(bit_reader *in)
{
    if (in->held < 32) {
        if (in->next < in->words) {
            const uint8_t *at = in->data + 4 * (intptr_t)in->next;
            const uint32_t word = (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
            in->bits |= (uint64_t)word << (32 - in->held);
        }
        /* The count of words continues beyond the end, as far as any picture, so that `overrun` can tell. */
        in->next++;
        in->held += 32;
    }
    return (uint32_t)(in->bits >> 32);
}

/* Leave up to 32 bits out that were peeked at. */
static inline void skip_bits(bit_reader *in, int32_t count)
{
    in->bits <<= count;
    in->held -= count;
}

/* Return the next 1 to 32 bits. */
static inline uint32_t get_bits(bit_reader *in, int32_t count)
{
    const uint32_t found = peek_32(in) >> (32 - count);
    skip_bits(in, count);
    return found;
}

/* Return whether more bits were taken than there were. */
static inline int overrun(const bit_reader *in)
{
    return 32 * (int64_t)in->next - in->held > 32 * (int64_t)in->words;
}

/* Leave out what is left of a byte. */
static inline void to_next_byte(bit_reader *in)
{
    (void)peek_32(in);
    skip_bits(in, in->held % 8);
}

static inline int32_t leading_zeros(uint32_t value)
{
    int32_t zeros = 0;
    while (zeros < 32 && !(value & 0x80000000u >> zeros)) {
        zeros++;
    }
    return zeros;
}

typedef struct {
    uint8_t *data;
    int32_t room;
    int32_t used;
    uint64_t bits;
    int32_t held;
} bit_writer;

/* Write the lowest 1 to 32 bits; beyond the room they are only counted. */
static inline void put_bits(bit_writer *out, uint32_t value, int32_t count)
{
    out->bits = out->bits << count | value;
    out->held += count;
    if (out->held >= 32) {
        const uint32_t word = (uint32_t)(out->bits >> (out->held - 32));
        if (out->used + 4 <= out->room) {
            uint8_t *at = out->data + out->used;
            at[0] = (uint8_t)word, at[1] = (uint8_t)(word >> 8), at[2] = (uint8_t)(word >> 16), at[3] = (uint8_t)(word >> 24);
        }
        out->used += 4;
        out->held -= 32;
        out->bits &= ((uint64_t)1 << out->held) - 1;
    }
}

/* Fill up to a whole number of bytes or words with zeros. */
static inline void put_zeros_to(bit_writer *out, int32_t multiple)
{
    const int32_t left = out->held % multiple;
    if (left > 0) {
        put_bits(out, 0, multiple - left);
    }
}

#endif
