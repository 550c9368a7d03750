/* The measurement model of a sighting. Derivation: docs/estimator.md, section "Measurements". */
#ifndef DECKLANDER_SIGHTING_H
#define DECKLANDER_SIGHTING_H

#include "decklander.h"

/* The largest number of numbers that a sighting measures: a place and an orientation. */
#define SEEN_MAX 6

/* R_level_body that vision used. */
void levelling(const belief *b, double A[9]);
/* The pad's position in body axes by the mounting in the camera's file, m. */
void seen_from_body(const sighting *s, const double A[9], double seen[3]);
/* The rotation from the camera's axes, as its file has them in the body, to ned. */
void camera_to_ned(const belief *b, double back[9]);

#endif
