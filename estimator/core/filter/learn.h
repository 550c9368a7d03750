/* Learning of the deck's motion. */
#ifndef DECKLANDER_LEARN_H
#define DECKLANDER_LEARN_H

#include "filter/bank.h"
#include "filter/sighting.h"

/* The bank that belongs to a belief. What writes it takes the place. */
typedef struct {
    const dl_bank *now;
    dl_bank *place;
} sea_ref;

/* Let the bank learn by a look, and take the size and period of the waves from it. */
void learn_waves(const dl_filter_params *o, dl_belief *b, sea_ref *bank, const bank_look *look);
/* Update the bank of wave oscillators with the pad's measured position and tilt. */
void learn_from_sighting(const dl_filter_params *o, dl_belief *b, sea_ref *bank, const dl_sighting *s, const sighting_rows *seen);

#endif
