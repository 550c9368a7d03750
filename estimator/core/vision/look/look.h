/* The parts of a look: pixels of a reduced frame, evidence for the pad, and learned colours of its paints. */
#ifndef DECKLANDER_LOOK_H
#define DECKLANDER_LOOK_H

#include "vision/tracker.h"

/* The pixels of a part of a level: of that level if it was made, else made in the tracker's room for parts from `at` on, which moves.
 * Returns whether there is room. */
int look_part(const dl_tracker *t, const dl_frame *frame, uint8_t **at, seen_part *seen);

/* The pixels of the part that shows the disc and of the one that shows the arrowhead: what the one of the higher level is made of is
 * reduced once if the other is made, too. Returns whether there is room. */
int look_parts(const dl_tracker *t, const dl_frame *frame, seen_part seen[2]);

/* The inputs of the verification of a registration, and the log-odds that it gives them. */
void look_evidence(const pad_judge *judge, const double weights[EVIDENCE], const registration *found, const aligned_pad *aligned,
                   double evidence[EVIDENCE], double *log_odds);

/* What is known of the paints after a frame that shows the pad. */
void look_paint(const pad_paint *known, const aligned_pad *aligned, pad_paint *out);

#endif
