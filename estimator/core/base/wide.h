/* Functions that are compiled twice where the compiler can: for machines with AVX2, and for all others.
 *
 * Without contraction both compute the same bits. The address sanitizer is not ready yet when the choice is made. */
#ifndef DECKLANDER_WIDE_H
#define DECKLANDER_WIDE_H

#include <string.h>

#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__)
#define WIDE __attribute__((target_clones("avx2", "default")))
#else
#define WIDE
#endif

#endif
