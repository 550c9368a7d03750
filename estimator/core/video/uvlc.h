/* What the decoder and the encoder of UVLC pictures share: start codes, order and steps of coefficients, the transform's basis.
 *
 * Source: Parrot, AR.Drone Developer Guide SDK 1.7, 7.2 (video stream), and the note uvlc.txt of its SDK. */
#ifndef DECKLANDER_UVLC_H
#define DECKLANDER_UVLC_H

#include "decklander.h"

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

#endif
