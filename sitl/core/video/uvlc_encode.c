/* Encode UVLC pictures: pixels to blocks, coefficients and bits. */

#include "decklander_sim.h"
#include "video/uvlc.h"

#include <string.h>

enum { LEVEL_MAX = 511 };

static int32_t digits_of(uint32_t value)
{
    return 32 - leading_zeros(value);
}

/* A number as this many zeros, then its binary digits; a level has one zero more from 2 on, since a single one ends the block. */
static void put_run(bit_writer *out, uint32_t run)
{
    const int32_t digits = digits_of(run);
    put_bits(out, run > 0 ? run : 1, run > 0 ? 2 * digits : 1);
}

static void put_level(bit_writer *out, int32_t level)
{
    const uint32_t size = (uint32_t)(level < 0 ? -level : level);
    const int32_t digits = digits_of(size);
    if (size == 1) {
        put_bits(out, 1, 1);
    } else {
        put_bits(out, 1, digits + 1);
        put_bits(out, size & ((1u << (digits - 1)) - 1), digits - 1);
    }
    put_bits(out, level < 0, 1);
}

static void put_block(bit_writer *out, const int32_t levels[UVLC_COEFFICIENTS], int more)
{
    put_bits(out, (uint32_t)levels[0], UVLC_DC_BITS);
    uint32_t run = 0;
    for (int i = 1; i < UVLC_COEFFICIENTS && more; i++) {
        const int32_t level = levels[UVLC_ZIGZAG[i]];
        if (level == 0) {
            run++;
            continue;
        }
        put_run(out, run);
        put_level(out, level);
        run = 0;
    }
    if (more) {
        put_bits(out, 5, 3);
    }
}

/* Transform a block of 8x8 values and divide by the steps. Return whether anything but its mean is left. */
static int levels_of(const float values[UVLC_COEFFICIENTS], int32_t quantizer, int32_t levels[UVLC_COEFFICIENTS])
{
    float across[UVLC_SIDE][UVLC_SIDE] = {{0.0f}}, both[UVLC_SIDE][UVLC_SIDE] = {{0.0f}};
    for (int y = 0; y < UVLC_SIDE; y++) {
        for (int j = 0; j < UVLC_SIDE; j++) {
            for (int x = 0; x < UVLC_SIDE; x++) {
                across[y][j] += UVLC_BASIS[j][x] * values[y * UVLC_SIDE + x];
            }
        }
    }
    for (int k = 0; k < UVLC_SIDE; k++) {
        for (int y = 0; y < UVLC_SIDE; y++) {
            for (int j = 0; j < UVLC_SIDE; j++) {
                both[k][j] += UVLC_BASIS[k][y] * across[y][j];
            }
        }
    }
    int more = 0;
    for (int i = 0; i < UVLC_COEFFICIENTS; i++) {
        /* The drone's encoder drops the remainder, and sends no mean of zero. */
        const int32_t level = (int32_t)(both[i / UVLC_SIDE][i % UVLC_SIDE] / (float)uvlc_step(i, quantizer));
        levels[i] = level > LEVEL_MAX ? LEVEL_MAX : level < -LEVEL_MAX ? -LEVEL_MAX : level;
        if (i == 0) {
            levels[0] = level < 1 ? 1 : level;
        }
        more |= i > 0 && levels[i] != 0;
    }
    return more;
}

/* Split 16x16 pixels into light and colour, the colours of 2x2 pixels averaged. Source: ITU-T T.871 (JFIF), 7. */
static void split(const uint8_t *bgr, intptr_t row_bytes, float blocks[UVLC_BLOCKS][UVLC_COEFFICIENTS])
{
    memset(blocks[UVLC_CB], 0, 2 * UVLC_COEFFICIENTS * sizeof **blocks);
    for (int y = 0; y < UVLC_MACROBLOCK; y++) {
        const uint8_t *px = bgr + y * row_bytes;
        for (int x = 0; x < UVLC_MACROBLOCK; x++, px += 3) {
            const float b = px[0], g = px[1], r = px[2], light = 0.299f * r + 0.587f * g + 0.114f * b;
            blocks[2 * (y / UVLC_SIDE) + x / UVLC_SIDE][y % UVLC_SIDE * UVLC_SIDE + x % UVLC_SIDE] = light;
            const int colour = y / 2 * UVLC_SIDE + x / 2;
            blocks[UVLC_CB][colour] += 0.25f * ((b - light) / 1.772f + 128.0f);
            blocks[UVLC_CR][colour] += 0.25f * ((r - light) / 1.402f + 128.0f);
        }
    }
}

static void put_macroblock(bit_writer *out, const uint8_t *bgr, intptr_t row_bytes, int32_t quantizer)
{
    float blocks[UVLC_BLOCKS][UVLC_COEFFICIENTS];
    int32_t levels[UVLC_BLOCKS][UVLC_COEFFICIENTS];
    uint32_t what = UVLC_ALWAYS;
    split(bgr, row_bytes, blocks);
    for (int i = 0; i < UVLC_BLOCKS; i++) {
        what |= (uint32_t)levels_of(blocks[i], quantizer, levels[i]) << i;
    }
    put_bits(out, 0, 1);
    put_bits(out, what, 8);
    for (int i = 0; i < UVLC_BLOCKS; i++) {
        put_block(out, levels[i], what >> i & 1);
    }
}

static void put_picture(bit_writer *out, const dl_sim_uvlc_picture *picture, uint32_t format, uint32_t resolution)
{
    put_bits(out, format, 2);
    put_bits(out, resolution, 3);
    put_bits(out, 0, 3);
    put_bits(out, (uint32_t)picture->quantizer, 5);
    put_bits(out, (uint32_t)picture->number, 32);
}

int32_t dl_sim_uvlc_encode(const uint8_t *bgr, int32_t bytes, const dl_sim_uvlc_picture *picture, uint8_t *out, int32_t room)
{
    uint32_t format = 0, resolution = 0;
    for (int32_t k = 1; k <= 3; k++) {
        if (picture->width == 88 << (k - 1) && picture->height == 72 << (k - 1)) {
            format = UVLC_CIF, resolution = (uint32_t)k;
        } else if (picture->width == 160 << (k - 1) && picture->height == 120 << (k - 1)) {
            format = UVLC_VGA, resolution = (uint32_t)k;
        }
    }
    if (resolution < 2 || bytes != 3 * picture->width * picture->height || picture->quantizer < 1 || picture->quantizer > UVLC_TABLE) {
        return DL_NOT_CODED;
    }
    bit_writer bits = {out, room, 0, 0, 0};
    const intptr_t row_bytes = 3 * (intptr_t)picture->width;
    for (int32_t row = 0; row * UVLC_MACROBLOCK < picture->height; row++) {
        put_zeros_to(&bits, 8);
        put_bits(&bits, UVLC_START | (uint32_t)row, UVLC_START_BITS);
        if (row == 0) {
            put_picture(&bits, picture, format, resolution);
        } else {
            put_bits(&bits, (uint32_t)picture->quantizer, 5);
        }
        for (int32_t x = 0; x < picture->width; x += UVLC_MACROBLOCK) {
            put_macroblock(&bits, bgr + row * UVLC_MACROBLOCK * row_bytes + 3 * (intptr_t)x, row_bytes, (int32_t)picture->quantizer);
        }
    }
    put_zeros_to(&bits, 8);
    put_bits(&bits, UVLC_START | UVLC_END, UVLC_START_BITS);
    put_zeros_to(&bits, 32);
    return bits.used <= room ? bits.used : 0;
}
