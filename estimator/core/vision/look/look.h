/* The parts of a look: pixels of a reduced frame, what speaks for the pad, and what is learned of its paints. */
#ifndef DECKLANDER_LOOK_H
#define DECKLANDER_LOOK_H

#include <stddef.h>

#include "decklander.h"

/* Pixels of an image some levels higher, (rows, columns), from the pixel on where they begin; behind them `out` has room for as many
 * rows of the level below as one of them takes. */
void look_reduced(const uint8_t *from, ptrdiff_t row_bytes, int levels, int columns, int rows, uint8_t *out);

/* The pixels of a part of a level, and the number of bytes from row to row: of the frame itself, or made in `parts`. */
const uint8_t *look_part(const uint8_t *frame, int32_t width, const frame_part *part, uint8_t *parts, int32_t *stride);

/* The inputs of the verification of a registration, and the log-odds that it gives them. */
void look_evidence(const pad_judge *judge, const registration *found, const aligned_pad *aligned, double evidence[EVIDENCE],
                   double *log_odds);

/* What is known of the paints after a frame that shows the pad. */
void look_paint(const pad_paint *known, const aligned_pad *aligned, pad_paint *out);

#endif
