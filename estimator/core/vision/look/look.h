/* The parts of a look: pixels of a reduced frame, evidence for the pad, and learned colours of its paints. */
#ifndef DECKLANDER_LOOK_H
#define DECKLANDER_LOOK_H

#include "vision/tracker.h"

/* The inputs of the verification of a registration, in the order of EVIDENCE in estimator.vision.detect.verification, which
 * describes them. */
enum look_evidence {
    EVIDENCE_ONE, EVIDENCE_TEMPLATE_SCORE, EVIDENCE_INLIERS, EVIDENCE_DISC_OFF, EVIDENCE_RING_OFF, EVIDENCE_H_OFF,
    EVIDENCE_RING_UNSEEN, EVIDENCE_H_UNSEEN, EVIDENCE_DENSE, EVIDENCE_DENSE_INLIERS, EVIDENCE_RMS, EVIDENCE_VISIBLE,
    EVIDENCE_DENSE_TEMPLATE_SCORE, EVIDENCE_DENSE_DISC, EVIDENCE_DENSE_ORANGE, EVIDENCE_NO_RING, EVIDENCE_NO_H,
    EVIDENCE_DISC_UNSEEN, EVIDENCE_PAINTED, EVIDENCE_NO_DISC, EVIDENCE_H_CONTRAST_ODD, EVIDENCE_DISAGREES,
    EVIDENCE_NOT_BRIGHTER, EVIDENCE_CORNER, EVIDENCE_EDGES_ASTRAY, EVIDENCE_H_ASTRAY, EVIDENCE_HALF_DISAGREES,
    EVIDENCE_NO_H_IN_VIEW, EVIDENCE_H_DISAGREES,
};

/* The pixels of a part of a level: of that level if it was made, else made in the tracker's room for parts from `at` on, which moves.
 * Returns whether there is room. */
int look_part(const dl_tracker *t, const dl_frame *frame, uint8_t **at, seen_part *seen);

/* The pixels of the part that shows the disc and of the one that shows the arrowhead: what the one of the higher level is made of is
 * reduced once if the other is made, too. Returns whether there is room. */
int look_parts(const dl_tracker *t, const dl_frame *frame, seen_part seen[2]);

/* The inputs of the verification of a registration, and the log-odds that it gives them. */
void look_evidence(const dl_pad_verification *judge, const double weights[DL_EVIDENCE], const dl_registration *found, const dl_aligned_pad *aligned,
                   double evidence[DL_EVIDENCE], double *log_odds);

/* What is known of the paints after a frame that shows the pad. */
void look_paint(const dl_pad_paint *known, const dl_aligned_pad *aligned, dl_pad_paint *out);

#endif
