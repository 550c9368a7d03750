/* Lists of the best, best first. */
#ifndef DECKLANDER_BEST_H
#define DECKLANDER_BEST_H

#include <string.h>

/* Insert a structure into a list of n, of which `most` are kept, by the score that lies `score_at` bytes behind its beginning. Returns
 * how many the list holds. */
static inline int insert_best(const void *one, size_t size, size_t score_at, int n, int most, void *list)
{
    char *end = (char *)list + (size_t)n * size, *at = end;
    double score, other;
    memcpy(&score, (const char *)one + score_at, sizeof score);
    while (at > (char *)list && (memcpy(&other, at - size + score_at, sizeof other), other < score)) {
        at -= size;
    }
    const char *last = n < most ? end : end - size;
    if (at <= last) {
        memmove(at + size, at, (size_t)(last - at));
        memcpy(at, one, size);
    }
    return n < most ? n + 1 : most;
}

#endif
