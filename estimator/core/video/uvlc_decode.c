/* Decode UVLC pictures: bits to coefficients, blocks and pixels. */

#include "video/uvlc.h"

#include <string.h>

enum {
    HEADER_BYTES = 12,
    CIF_WIDTH = 88,
    CIF_HEIGHT = 72,
    VGA_WIDTH = 160,
    VGA_HEIGHT = 120,
    RUN_ZEROS_MAX = 6,
    LEVEL_ZEROS_MAX = 9
};

static enum dl_uvlc_result picture_header(bit_reader *in, dl_uvlc_picture *picture)
{
    if (get_bits(in, UVLC_START_BITS) != UVLC_START) {
        return DL_UVLC_NO_PICTURE;
    }
    const uint32_t format = get_bits(in, 2), resolution = get_bits(in, 3), type = get_bits(in, 3);
    picture->quantizer = get_bits(in, 5);
    picture->number = get_bits(in, 32);
    picture->intra = type == 0;
    if ((format != UVLC_CIF && format != UVLC_VGA) || resolution == 0 || picture->quantizer == 0) {
        return DL_UVLC_NO_PICTURE;
    }
    picture->width = (format == UVLC_CIF ? CIF_WIDTH : VGA_WIDTH) << (resolution - 1);
    picture->height = (format == UVLC_CIF ? CIF_HEIGHT : VGA_HEIGHT) << (resolution - 1);
    if (picture->width > DL_UVLC_WIDTH_MAX || picture->height > DL_UVLC_HEIGHT_MAX || picture->width % UVLC_MACROBLOCK ||
        picture->height % UVLC_MACROBLOCK) {
        return DL_UVLC_SIZE;
    }
    return picture->intra ? DL_UVLC_DONE : DL_UVLC_INTER;
}

/* Read where a picture says what it is. Width and height are those of a picture that can be decoded, or the result says why not. */
enum dl_uvlc_result dl_uvlc_header(const uint8_t *data, int32_t bytes, dl_uvlc_picture *picture)
{
    memset(picture, 0, sizeof *picture);
    if (bytes < HEADER_BYTES) {
        return DL_UVLC_SHORT;
    }
    bit_reader in = read_bits_of(data, bytes);
    return picture_header(&in, picture);
}

/* Find the next start code, which begins with a byte, and return its number in `number`. More zeros than its own may precede it. */
static enum dl_uvlc_result next_start(bit_reader *in, int32_t *number)
{
    to_next_byte(in);
    if (peek_32(in) >> 16) {
        return overrun(in) ? DL_UVLC_TORN : DL_UVLC_BAD_CODE;
    }
    while (!(peek_32(in) >> 10)) {
        skip_bits(in, 8);
        if (overrun(in)) {
            return DL_UVLC_TORN;
        }
    }
    const uint32_t code = get_bits(in, UVLC_START_BITS);
    *number = code & UVLC_START_NUMBER;
    return overrun(in) ? DL_UVLC_TORN : (code & ~(uint32_t)UVLC_START_NUMBER) == UVLC_START ? DL_UVLC_DONE : DL_UVLC_BAD_CODE;
}

/* Read one run of zeros and the level after it. Return 0 at the block's end, 1 if there is one, -1 for no code of the format. */
static int32_t run_and_level(bit_reader *in, int32_t *run, int32_t *level)
{
    uint32_t bits = peek_32(in);
    const int32_t run_zeros = leading_zeros(bits);
    if (run_zeros > RUN_ZEROS_MAX) {
        return -1;
    }
    int32_t length = run_zeros > 0 ? 2 * run_zeros : 1;
    *run = run_zeros > 0 ? (int32_t)(bits << run_zeros >> (32 - run_zeros)) : 0;
    bits <<= length;
    const int32_t zeros = leading_zeros(bits);
    if (zeros > LEVEL_ZEROS_MAX) {
        return -1;
    }
    if (zeros == 1) {
        skip_bits(in, length + 2);
        return 0;
    }
    const int32_t digits = zeros > 0 ? zeros : 1;
    *level = (int32_t)(bits << zeros >> (32 - digits));
    length += zeros + digits + 1;
    skip_bits(in, length - 1);
    *level = get_bits(in, 1) ? -*level : *level;
    return 1;
}

/* Read a block's coefficients, times their steps. */
static enum dl_uvlc_result read_block(bit_reader *in, int32_t more, int32_t quantizer, float coefficients[UVLC_COEFFICIENTS])
{
    memset(coefficients, 0, UVLC_COEFFICIENTS * sizeof *coefficients);
    coefficients[0] = (float)((int32_t)get_bits(in, UVLC_DC_BITS) * uvlc_step(0, quantizer));
    int32_t at = 0, run = 0, level = 0;
    while (more) {
        const int32_t found = run_and_level(in, &run, &level);
        if (found <= 0) {
            return found < 0 ? DL_UVLC_BAD_CODE : DL_UVLC_DONE;
        }
        at += run + 1;
        if (at >= UVLC_COEFFICIENTS) {
            return DL_UVLC_BAD_CODE;
        }
        const int32_t place = UVLC_ZIGZAG[at];
        coefficients[place] = (float)(level * uvlc_step(place, quantizer));
    }
    return DL_UVLC_DONE;
}

static int row_is_empty(const float row[UVLC_SIDE])
{
    int empty = 1;
    for (int i = 0; i < UVLC_SIDE; i++) {
        empty &= row[i] == 0.0f;
    }
    return empty;
}

static void inverse_transform(const float coefficients[UVLC_COEFFICIENTS], float values[UVLC_COEFFICIENTS])
{
    float down[UVLC_SIDE][UVLC_SIDE] = {{0.0f}};
    for (int k = 0; k < UVLC_SIDE; k++) {
        const float *row = coefficients + k * UVLC_SIDE;
        for (int y = 0; y < UVLC_SIDE && !row_is_empty(row); y++) {
            for (int j = 0; j < UVLC_SIDE; j++) {
                down[y][j] += UVLC_BASIS[k][y] * row[j];
            }
        }
    }
    memset(values, 0, UVLC_COEFFICIENTS * sizeof *values);
    for (int y = 0; y < UVLC_SIDE; y++) {
        for (int j = 0; j < UVLC_SIDE; j++) {
            for (int x = 0; x < UVLC_SIDE; x++) {
                values[y * UVLC_SIDE + x] += UVLC_BASIS[j][x] * down[y][j];
            }
        }
    }
}

/* Read a macroblock's blocks as light and colour; one that is left out is zero throughout, as its coefficients are. */
static enum dl_uvlc_result read_macroblock(bit_reader *in, int32_t *quantizer, float blocks[UVLC_BLOCKS][UVLC_COEFFICIENTS])
{
    static const int8_t CHANGES[] = {-1, -2, 1, 2};
    if (get_bits(in, 1)) {
        memset(blocks, 0, UVLC_BLOCKS * UVLC_COEFFICIENTS * sizeof **blocks);
        return DL_UVLC_DONE;
    }
    const uint32_t what = get_bits(in, 8);
    if (!(what & UVLC_ALWAYS)) {
        return DL_UVLC_BAD_CODE;
    }
    if (what & UVLC_HAS_CHANGE) {
        *quantizer += CHANGES[get_bits(in, 2)];
        if (*quantizer < 1 || *quantizer > UVLC_TABLE) {
            return DL_UVLC_BAD_CODE;
        }
    }
    for (int i = 0; i < UVLC_BLOCKS; i++) {
        float coefficients[UVLC_COEFFICIENTS];
        const enum dl_uvlc_result result = read_block(in, what >> i & 1, *quantizer, coefficients);
        if (result != DL_UVLC_DONE) {
            return result;
        }
        inverse_transform(coefficients, blocks[i]);
    }
    return DL_UVLC_DONE;
}

/* Paint a macroblock. Source of the colours: ITU-T T.871 (JFIF), 7; light and colours have the full range. */
static void paint(float blocks[UVLC_BLOCKS][UVLC_COEFFICIENTS], intptr_t row_bytes, uint8_t *bgr)
{
    for (int y = 0; y < UVLC_MACROBLOCK; y++) {
        uint8_t *px = bgr + y * row_bytes;
        for (int x = 0; x < UVLC_MACROBLOCK; x++, px += 3) {
            const float light = blocks[2 * (y / UVLC_SIDE) + x / UVLC_SIDE][y % UVLC_SIDE * UVLC_SIDE + x % UVLC_SIDE];
            const int colour = y / 2 * UVLC_SIDE + x / 2;
            const float cb = blocks[UVLC_CB][colour] - 128.0f, cr = blocks[UVLC_CR][colour] - 128.0f;
            px[0] = uvlc_byte(light + 1.772f * cb);
            px[1] = uvlc_byte(light - 0.344136f * cb - 0.714136f * cr);
            px[2] = uvlc_byte(light + 1.402f * cr);
        }
    }
}

static enum dl_uvlc_result read_row(bit_reader *in, int32_t quantizer, int32_t width, uint8_t *bgr)
{
    for (int32_t x = 0; x < width; x += UVLC_MACROBLOCK) {
        float blocks[UVLC_BLOCKS][UVLC_COEFFICIENTS];
        const enum dl_uvlc_result result = read_macroblock(in, &quantizer, blocks);
        if (result != DL_UVLC_DONE || overrun(in)) {
            return overrun(in) ? DL_UVLC_TORN : result;
        }
        paint(blocks, 3 * (intptr_t)width, bgr + 3 * (intptr_t)x);
    }
    return DL_UVLC_DONE;
}

enum dl_uvlc_result dl_uvlc_decode(const uint8_t *data, int32_t bytes, const dl_uvlc_picture *picture, uint8_t *bgr, int32_t room)
{
    dl_uvlc_picture header;
    const enum dl_uvlc_result known = dl_uvlc_header(data, bytes, &header);
    if (known != DL_UVLC_DONE) {
        return known;
    }
    if (header.width != picture->width || header.height != picture->height || room != 3 * header.width * header.height) {
        return DL_UVLC_SIZE;
    }
    bit_reader in = read_bits_of(data, bytes);
    (void)picture_header(&in, &header);
    const int32_t width = (int32_t)header.width, rows = (int32_t)header.height / UVLC_MACROBLOCK;
    int32_t quantizer = (int32_t)header.quantizer;
    for (int32_t row = 0; row <= rows; row++) {
        int32_t number = 0;
        if (row > 0) {
            const enum dl_uvlc_result result = next_start(&in, &number);
            if (result != DL_UVLC_DONE) {
                return result;
            }
            if (number != (row < rows ? row : UVLC_END)) {
                return DL_UVLC_BAD_CODE;
            }
            if (row == rows) {
                break;
            }
            quantizer = (int32_t)get_bits(&in, 5);
            if (quantizer == 0) {
                return DL_UVLC_BAD_CODE;
            }
        }
        const enum dl_uvlc_result result = read_row(&in, quantizer, width, bgr + 3 * (intptr_t)width * UVLC_MACROBLOCK * row);
        if (result != DL_UVLC_DONE) {
            return result;
        }
    }
    return DL_UVLC_DONE;
}
