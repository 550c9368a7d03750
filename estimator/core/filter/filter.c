/* Keep the recent events with the belief after each, and answer by them. */

#include "filter/filter.h"

#include <stdlib.h>
#include <string.h>

#include "filter/begin.h"
#include "filter/correction.h"
#include "filter/run.h"

/* Memory */

static void *take(piece **spares, size_t bytes)
{
    piece *found = *spares;
    if (found != NULL) {
        *spares = found->next;
    } else {
        found = malloc(bytes);
    }
    if (found != NULL) {
        found->owners = 1;
    }
    return found;
}

static void give(piece **spares, void *back)
{
    piece *one = back;
    if (one != NULL && --one->owners == 0) {
        one->next = *spares;
        *spares = one;
    }
}

static void *shared(void *with)
{
    ((piece *)with)->owners++;
    return with;
}

/* Checkpoints */

static void checkpoint_clear(dl_filter *f, checkpoint *c)
{
    give(&f->spares[COVARIANCES], c->P);
    give(&f->spares[BANKS], c->bank);
    c->P = NULL;
    c->bank = NULL;
}

/* A covariance or a bank of its own for a checkpoint that has none; false if there is no memory. */
static bool own_covariance(dl_filter *f, checkpoint *c)
{
    return (c->P = take(&f->spares[COVARIANCES], sizeof *c->P)) != NULL;
}

static bool own_bank(dl_filter *f, checkpoint *c)
{
    return (c->bank = take(&f->spares[BANKS], sizeof *c->bank)) != NULL;
}

/* Write the first belief; false if there is no memory. */
static bool begin_checkpoint(dl_filter *f, const dl_event *e, checkpoint *after, dl_outcome *out)
{
    if (!own_covariance(f, after) || !own_bank(f, after)) {
        checkpoint_clear(f, after);
        return false;
    }
    if (!begin_belief(&f->params, e, &after->belief, after->P->P, &after->bank->bank, out)) {
        checkpoint_clear(f, after);
    }
    return true;
}

/* Write the belief after an event into a checkpoint that has none; false if there is no memory. */
static bool advance(dl_filter *f, const checkpoint *before, const dl_event *e, checkpoint *after, dl_outcome *out)
{
    if (before->P == NULL) {
        return begin_checkpoint(f, e, after, out);
    }
    double places[2][DL_N * DL_N];
    covariance c = {before->P->P, {places[0], places[1]}};
    sea_ref bank = {&before->bank->bank, NULL};
    if (e->kind == DL_SIGHTING || e->kind == DL_MOTION) {
        if (!own_bank(f, after)) {
            return false;
        }
        bank.place = &after->bank->bank;
    }
    after->belief = before->belief;
    process_event(&f->params, &after->belief, &c, &bank, e, out);
    if (bank.now != bank.place) {
        checkpoint_clear(f, after);
        after->bank = shared(before->bank);
    }
    if (c.P == before->P->P) {
        after->P = shared(before->P);
        return true;
    }
    if (!own_covariance(f, after)) {
        checkpoint_clear(f, after);
        return false;
    }
    memcpy(after->P->P, c.P, sizeof places[0]);
    return true;
}

/* The order of the events */

static int64_t compared(int64_t a, int64_t b)
{
    return (a > b) - (a < b);
}

/* Whether an event comes after another by instant, kind, frame and method: the order does not depend on when they were received. */
static bool is_later(const dl_event *a, const dl_event *b)
{
    static const int64_t rank[] = {
        [DL_IMU] = 0, [DL_ATTITUDE] = 1, [DL_VELOCITY] = 2, [DL_RANGE] = 3, [DL_HEIGHT] = 4, [DL_VESSEL] = 5, [DL_MOTION] = 6,
        [DL_SIGHTING] = 7,
    };
    int64_t order = compared(a->t, b->t);
    order = order != 0 ? order : compared(rank[a->kind], rank[b->kind]);
    order = order != 0 ? order : compared(a->seq, b->seq);
    return order != 0 ? order > 0 : a->method > b->method;
}

static past_event *event_at(const dl_filter *f, int64_t i)
{
    return f->past[f->first + i];
}

static const checkpoint *checkpoint_before(const dl_filter *f, int64_t i)
{
    return i == 0 ? &f->base : &event_at(f, i - 1)->after;
}

static void drop_first(dl_filter *f)
{
    checkpoint_clear(f, &f->base);
    f->base = event_at(f, 0)->after;
    f->times.forgotten = event_at(f, 0)->event.t;
    give(&f->spares[EVENTS], event_at(f, 0));
    f->first++;
    f->n--;
}

/* Drop the events that are older than the history, seen from the newest. */
static void drop_old(dl_filter *f)
{
    const int64_t oldest = event_at(f, f->n - 1)->event.t - f->params.history_ns;
    while (event_at(f, 0)->event.t < oldest) {
        drop_first(f);
    }
}

static void forget_all(dl_filter *f)
{
    while (f->n > 0) {
        drop_first(f);
    }
    checkpoint_clear(f, &f->base);
    f->first = 0;
    f->times.forgotten = f->times.received_at = -1;
    f->times.leapt_n = 0;
}

/* Make room for one more event at the end; false if there is no memory. */
static bool make_room(dl_filter *f)
{
    if (f->first + f->n < f->room) {
        return true;
    }
    if (2 * f->n > f->room || f->room == 0) {
        const int64_t room = f->room == 0 ? 256 : 2 * f->room;
        past_event **past = realloc(f->past, (size_t)room * sizeof *past);
        if (past == NULL) {
            return false;
        }
        f->past = past;
        f->room = room;
    }
    memmove(f->past, f->past + f->first, (size_t)f->n * sizeof *f->past);
    f->first = 0;
    return true;
}

/* Reception */

/* Whether an event is in time for the history; one that is not gets its outcome.
 *
 * One wrong time of reception must not make all later events too old. When several agree, the clock itself has leapt. */
static bool is_in_time(dl_filter *f, const dl_event *e, dl_outcome *out)
{
    const dl_filter_params *o = &f->params;
    const int64_t ahead = e->received_at - f->times.received_at;
    if (happened(f->times.received_at) && (ahead > o->leap_ns || -ahead > o->leap_ns)) {
        const int64_t apart = e->received_at - f->times.leapt_at;
        const bool agrees = f->times.leapt_n > 0 && apart <= o->leap_ns && -apart <= o->leap_ns;
        f->times.leapt_n = agrees ? f->times.leapt_n + 1 : 1;
        f->times.leapt_at = e->received_at;
        if (f->times.leapt_n < o->leap_count) {
            uncompared(out, ahead > 0 ? DL_TOO_NEW : DL_TOO_OLD);
            return false;
        }
        if (ahead < 0) {
            forget_all(f);
        }
    }
    f->times.leapt_n = 0;
    f->times.received_at = e->received_at > f->times.received_at ? e->received_at : f->times.received_at;
    if (e->t > f->times.received_at + o->max_ahead_ns || e->t <= f->times.forgotten) {
        uncompared(out, e->t > f->times.received_at + o->max_ahead_ns ? DL_TOO_NEW : DL_TOO_OLD);
        return false;
    }
    return true;
}

/* Insert an event that is in time, and process it and the later ones; false if there is no memory. */
static bool insert(dl_filter *f, const dl_event *e, dl_outcome *out)
{
    past_event *made = make_room(f) ? take(&f->spares[EVENTS], sizeof *made) : NULL;
    dl_outcome again;
    if (made == NULL) {
        return false;
    }
    int64_t at = f->n;
    while (at > 0 && is_later(&event_at(f, at - 1)->event, e)) {
        at--;
        checkpoint_clear(f, &event_at(f, at)->after);
        f->past[f->first + at + 1] = event_at(f, at);
    }
    made->event = *e;
    made->after = (checkpoint){.P = NULL};
    f->past[f->first + at] = made;
    f->n++;
    bool done = true;
    for (int64_t i = at; i < f->n; i++) {
        past_event *one = event_at(f, i);
        done &= advance(f, checkpoint_before(f, i), &one->event, &one->after, i == at ? out : &again);
    }
    drop_old(f);
    return done;
}

int64_t dl_filter_put(dl_filter *f, int32_t n, const dl_event *events, dl_outcome *outcomes)
{
    int64_t changed = INT64_MAX;
    for (int32_t i = 0; i < n; i++) {
        const int64_t received_at = f->times.received_at;
        const bool in_time = is_in_time(f, &events[i], &outcomes[i]);
        if (f->times.received_at < received_at) {
            changed = 0;
        }
        if (!in_time) {
            continue;
        }
        changed = events[i].t < changed ? events[i].t : changed;
        if (!insert(f, &events[i], &outcomes[i])) {
            return -1;
        }
    }
    return changed;
}

/* Answers */

const checkpoint *filter_before(const dl_filter *f, int64_t t)
{
    for (int64_t i = f->n; i > 0; i--) {
        if (event_at(f, i - 1)->event.t <= t) {
            const checkpoint *found = &event_at(f, i - 1)->after;
            return found->P == NULL ? NULL : found;
        }
    }
    return f->base.P != NULL && f->base.belief.t <= t ? &f->base : NULL;
}

bool dl_filter_answer(dl_filter *f, int64_t t, dl_answer *out)
{
    const checkpoint *before = filter_before(f, t);
    if (before != NULL) {
        answer_at(&f->params, t, &(whole_belief){&before->belief, before->P->P, &before->bank->bank}, out);
    }
    return before != NULL;
}

bool dl_filter_forecast(dl_filter *f, int64_t t, int32_t n, const double *horizons_s, dl_deck_ahead *out)
{
    const checkpoint *before = filter_before(f, t);
    return before != NULL
        && forecast_deck(&f->params, t, &(whole_belief){&before->belief, before->P->P, &before->bank->bank}, &f->reaches, n, horizons_s,
                         out);
}

/* A filter's life */

void dl_filter_free(dl_filter *f)
{
    if (f != NULL) {
        forget_all(f);
        for (int kind = 0; kind < KINDS; kind++) {
            while (f->spares[kind] != NULL) {
                free(take(&f->spares[kind], 0));
            }
        }
        free(f->past);
        free(f);
    }
}

/* Bytes that are written, or read, one part after the other: what does not fit is counted and left out. */
typedef struct {
    uint8_t *out;
    const uint8_t *in;
    int64_t at, room;
} stream;

static bool copy(stream *s, void *part, size_t bytes)
{
    const bool fits = (int64_t)bytes <= s->room - s->at;
    if (fits && s->in != NULL) {
        memcpy(part, s->in + s->at, bytes);
    }
    if (fits && s->out != NULL) {
        memcpy(s->out + s->at, part, bytes);
    }
    s->at += (int64_t)bytes;
    return fits || s->in == NULL;
}

/* How a checkpoint has its covariance or bank: not at all, with the checkpoint before, or by itself. */
enum sharing { WITHOUT, SHARED, OWN };

static enum sharing sharing_of(const void *mine, const void *before)
{
    return mine == NULL ? WITHOUT : mine == before ? SHARED : OWN;
}

/* Copy a checkpoint; one that is read has no belief yet. */
static bool copy_checkpoint(stream *s, dl_filter *f, checkpoint *c, const checkpoint *before)
{
    int64_t kinds[2] = {0, 0};
    if (s->in == NULL) {
        kinds[0] = sharing_of(c->P, before == NULL ? NULL : before->P);
        kinds[1] = sharing_of(c->bank, before == NULL ? NULL : before->bank);
    }
    if (!copy(s, kinds, sizeof kinds) || !copy(s, &c->belief, sizeof c->belief) || (kinds[0] == WITHOUT) != (kinds[1] == WITHOUT)) {
        return false;
    }
    if (s->in != NULL) {
        const bool lacks = (kinds[0] == SHARED || kinds[1] == SHARED) && (before == NULL || before->P == NULL);
        if (lacks || (kinds[0] == OWN && !own_covariance(f, c)) || (kinds[1] == OWN && !own_bank(f, c))) {
            return false;
        }
        if (kinds[0] == SHARED) {
            c->P = shared(before->P);
        }
        if (kinds[1] == SHARED) {
            c->bank = shared(before->bank);
        }
    }
    return (kinds[0] != OWN || copy(s, c->P->P, sizeof c->P->P)) && (kinds[1] != OWN || copy(s, &c->bank->bank, sizeof c->bank->bank));
}

int64_t dl_filter_save(const dl_filter *f, uint8_t *out, int64_t room)
{
    stream s = {out, NULL, 0, out == NULL ? 0 : room};
    filter_times times = f->times;
    int64_t n = f->n;
    checkpoint base = f->base;
    copy(&s, &n, sizeof n);
    copy(&s, &times, sizeof times);
    copy_checkpoint(&s, NULL, &base, NULL);
    for (int64_t i = 0; i < n; i++) {
        past_event *one = event_at(f, i);
        copy(&s, &one->event, sizeof one->event);
        copy_checkpoint(&s, NULL, &one->after, checkpoint_before(f, i));
    }
    return s.at;
}

/* Read one more event with its checkpoint. */
static bool read_event(stream *s, dl_filter *f)
{
    past_event *made = make_room(f) ? take(&f->spares[EVENTS], sizeof *made) : NULL;
    if (made == NULL) {
        return false;
    }
    made->after = (checkpoint){.P = NULL};
    f->past[f->first + f->n++] = made;
    return copy(s, &made->event, sizeof made->event) && copy_checkpoint(s, f, &made->after, checkpoint_before(f, f->n - 1));
}

dl_filter *dl_filter_new(const dl_filter_params *params, const uint8_t *saved, int64_t bytes)
{
    stream s = {NULL, saved, 0, bytes};
    dl_filter *f = calloc(1, sizeof *f);
    int64_t n = 0;
    if (f == NULL) {
        return NULL;
    }
    f->params = *params;
    f->times.forgotten = f->times.received_at = -1;
    if (saved == NULL) {
        return f;
    }
    bool done = copy(&s, &n, sizeof n) && copy(&s, &f->times, sizeof f->times) && copy_checkpoint(&s, f, &f->base, NULL);
    for (int64_t i = 0; done && i < n; i++) {
        done = read_event(&s, f);
    }
    if (!done || s.at != bytes) {
        dl_filter_free(f);
        return NULL;
    }
    return f;
}
