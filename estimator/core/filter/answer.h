/* What the filter tells of an instant: an answer, or a forecast. */
#ifndef DECKLANDER_ANSWER_H
#define DECKLANDER_ANSWER_H

#include "filter/bank_ahead.h"

/* A belief with its covariance (N, N) and its bank. */
typedef struct {
    const dl_belief *numbers;
    const double *P;
    const dl_bank *bank;
} whole_belief;

/* Write the answer at instant t, which is not before the belief. */
void answer_at(const dl_filter_params *o, int64_t t, const whole_belief *before, dl_answer *out);
/* Write the forecast from instant t at n horizons; return false if no pad is tracked. */
bool forecast_deck(const dl_filter_params *o, int64_t t, const whole_belief *before, reach_table *reaches, int32_t n,
                   const double *horizons_s, dl_deck_ahead *out);

#endif
