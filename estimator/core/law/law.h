/* The parts of the law that follows the deck. */
#ifndef DECKLANDER_LAW_H
#define DECKLANDER_LAW_H

#include "decklander.h"

/* The deck some time ahead, in `level`: velocity, acceleration, and how far it has moved until then. */
typedef struct {
    double v[3], a[3], moved[3];
} deck_then;

/* Return whether every number of commands is one that the law has room for. */
int law_fits(const dl_law_in_use *law);
double law_limited(double value, double most);
/* A number of the gains that are flown by: while they change, one between the earlier and the later. */
double law_between(const dl_law_cycle *in, double later, double earlier);

/* The memory of one axis at the first cycle, or after a silence: what was learned of the wind is kept. */
void axis_begin(int64_t remembered, const dl_axis_measured *z, const dl_law_axis *before, dl_law_axis *after);
/* Another command under way. */
void under_way_note(int64_t remembered, double command, double *under_way);
/* The memory of one axis after a cycle of n periods with a measurement. */
void axis_observe(const dl_law_in_use *law, const dl_law_cycle *in, int64_t n, const dl_law_axis *before, const dl_axis_measured *z,
                  dl_law_axis *after);
/* The tilt to command, m/s^2, not limited yet: the later reference less the present error, the commands under way included. */
double axis_tilt(const dl_law_axis *x, const dl_law_gains *gains, double off_m, double a_deck, double a_deck_then);
/* The tilt that keeps the body over the deck, m/s^2: its acceleration less the disturbance. */
double axis_reference(const dl_law_axis *x, double a_deck);
/* The tilt that the vehicle adds by itself, after a cycle of n periods in which the law steered, or one in which somebody else did. */
void own_flown(const dl_law_params *o, double dt, int64_t n, const dl_law_axis *x, const dl_law_own *before, dl_law_own *after);
void own_hovered(double dt, double lean, const dl_law_own *before, dl_law_own *after);

/* The deck this many seconds ahead; still where nothing is known of its motion. */
void deck_ahead_of(const dl_law_cycle *in, const dl_law_course *course, double ahead_s, deck_then *out);
/* The deck's turn, by the course of the heading against the arrow. */
void turn_observe(const dl_law_cycle *in, const dl_law_memory *before, dl_law_memory *after);
/* The turn to command, rad/s; 0 where no heading is wanted or known. */
double turn_command(const dl_law_cycle *in, const dl_law_memory *memory);

/* What accelerates the body beside its answer to climb commands, m/s^2 down. */
double climb_pushed(const dl_law_params *o, double dt, double d, double a_down, double v, double arrived);
/* Vertical speed v and the way made when n commands under way have acted, the oldest first. */
double climb_predicted(const dl_law_params *o, double *v, double d, int64_t n, const double *under_way);
/* The vertical speed to command, m/s down, not limited yet. */
double climb_command(const dl_law_params *o, const dl_law_cycle *in, double v, double d, const deck_then *deck, double height_error_m);

#endif
