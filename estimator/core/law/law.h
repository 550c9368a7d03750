/* The parts of the law that follows the deck. */
#ifndef DECKLANDER_LAW_H
#define DECKLANDER_LAW_H

#include "decklander.h"

/* The deck some time ahead, in `level`: velocity, acceleration, and how far it has moved until then. */
typedef struct {
    double v[3], a[3], moved[3];
} deck_then;

double law_limited(double value, double most);
/* A number of the gains that are flown by: while they change, one between the earlier and the later. */
double law_between(const law_cycle *in, double later, double earlier);

/* The memory of one axis at the first cycle, or after a silence: what was learned of the wind is kept. */
void axis_begin(int64_t remembered, const axis_measured *z, const law_axis *before, law_axis *after);
/* Another command under way. */
void under_way_note(int64_t remembered, double command, double *under_way);
/* The tilt that keeps the body over the deck, m/s^2: its acceleration less the disturbance. */
double axis_reference(const law_axis *x, double a_deck);
/* The lean that the vehicle adds by itself, after a cycle in which the law steered or somebody else did. */
void own_flown(const law_params *o, double dt, const law_axis *x, const law_own *before, law_own *after);
void own_hovered(double dt, double lean, const law_own *before, law_own *after);

/* The deck so many seconds ahead; still where nothing is known of its motion. */
void deck_ahead_of(const law_params *o, const law_cycle *in, const double *horizons_s, const double *rates_m_s, double ahead_s,
                   deck_then *out);
/* The deck's turn, by the course of the heading against the arrow. */
void turn_observe(const law_cycle *in, const law_memory *before, law_memory *after);
/* The turn to command, rad/s; 0 where no heading is wanted or none is known. */
double turn_command(const law_cycle *in, const law_memory *memory);

/* What accelerates the body beside its answer to climb commands, m/s^2 down. */
double climb_pushed(const law_params *o, double d, double a_down, double v, double arrived);
/* Vertical speed v and the way made when n commands under way have acted, the oldest first. */
double climb_predicted(const law_params *o, double *v, double d, int64_t n, const double *under_way);
/* The vertical speed to command, m/s down, not limited yet. */
double climb_command(const law_params *o, const law_cycle *in, double v, double d, const deck_then *deck, double height_error_m);

#endif
