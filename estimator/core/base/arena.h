/* Memory to work in, taken piece by piece. An arena without memory only counts, so that one function says what is needed where. */
#ifndef DECKLANDER_ARENA_H
#define DECKLANDER_ARENA_H

#include <stddef.h>
#include <stdint.h>

/* Memory, null to count alone, and the bytes of it that are taken. */
typedef struct {
    void *memory;
    int64_t used;
} arena;

/* Take the next bytes, from a multiple of eight on; a null pointer from an arena that only counts. */
static inline void *take(arena *a, int64_t bytes)
{
    void *taken = a->memory == NULL ? NULL : (char *)a->memory + a->used;
    a->used += (bytes + 7) / 8 * 8;
    return taken;
}

/* What is taken, in numbers of four bytes. */
static inline int64_t arena_numbers(const arena *a)
{
    return a->used / (int64_t)sizeof(float);
}

#endif
