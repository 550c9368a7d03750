/* The filter: the recent events, and the belief after each. Out-of-sequence measurements are inserted at the instant when they were
 * measured, and the later events are processed again: `process_event` does not depend on when an event was received. */
#ifndef DECKLANDER_FILTER_H
#define DECKLANDER_FILTER_H

#include "filter/answer.h"

/* The kinds of what the filter takes memory for. What nobody owns is spare, and used again: after the first seconds it asks for none. */
enum { EVENTS, COVARIANCES, BANKS, KINDS };

typedef struct piece {
    struct piece *next;
    int64_t owners;
} piece;

/* A covariance or a bank that checkpoints share until an event changes it. */
typedef struct {
    piece memory;
    double P[DL_N * DL_N];
} shared_covariance;

typedef struct {
    piece memory;
    dl_bank bank;
} shared_bank;

/* The belief after an event. Without a covariance there is none: no event has shown which way is down. */
typedef struct {
    dl_belief belief;
    shared_covariance *P;
    shared_bank *bank;
} checkpoint;

typedef struct {
    piece memory;
    dl_event event;
    checkpoint after;
} past_event;

/* What the filter keeps beside the events; instants in ns, -1 where there is none. */
typedef struct {
    /* Instant of the newest event that was dropped, and the latest time of reception. */
    int64_t forgotten, received_at;
    /* Of the consecutive events whose time of reception is far from received_at: that of the newest, and their number. */
    int64_t leapt_at, leapt_n;
} filter_times;

struct dl_filter {
    dl_filter_params params;
    filter_times times;
    /* The checkpoint before the first event. */
    checkpoint base;
    /* The events in the order of their instants, and room for more. */
    past_event **past;
    int64_t first, n, room;
    piece *spares[KINDS];
    reach_table reaches;
};

/* The checkpoint after the last event not later than t, ns; NULL if there is no belief that early. */
const checkpoint *filter_before(const dl_filter *f, int64_t t);

#endif
