/* Bits of UVLC pictures: 32-bit words, low byte first, whose bits run from the highest to the lowest. */
#ifndef DECKLANDER_UVLC_BITS_H
#define DECKLANDER_UVLC_BITS_H

#include <stdint.h>

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
