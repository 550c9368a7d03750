/* The choices of those who call the core: random ones that are the same on every machine, or a fuzzer's bytes. */

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define DRAWS 32768

static const uint8_t *fuzzed;
static size_t fuzzed_left;
static uint64_t draws = 1;

/* The constants of the generator are Knuth's, The Art of Computer Programming 2, 3.3.4, line 26. */
static int next_random(void)
{
    draws = draws * 6364136223846793005u + 1442695040888963407u;
    return (int)(draws >> 49);
}

static int fuzzed_byte(void)
{
    if (fuzzed_left == 0) {
        return 0;
    }
    fuzzed_left--;
    return *fuzzed++;
}

/* 0 to DRAWS - 1; random after the end of a fuzzer's bytes */
static int draw(void)
{
    return fuzzed_left > 1 ? (fuzzed_byte() << 8 | fuzzed_byte()) % DRAWS : next_random();
}

/* -1 to 1. Most of a fuzzed run's numbers are random all the same: `poisoned` gives some of them the fuzzer's values. */
static double uniform(void)
{
    return 2.0 * next_random() / (DRAWS - 1) - 1.0;
}

/* Nothing without a fuzzer. */
static void poisoned(double *values, int n)
{
    static const double kinds[] = {0.0, -0.0, NAN, INFINITY, -INFINITY, 1e300, -1e300, 1e-310, 1e9, -1.0, 1e-9, 3.141592653589793};
    for (int left = fuzzed ? fuzzed_byte() % 8 : 0; left > 0; left--) {
        values[draw() % n] = kinds[fuzzed_byte() % (sizeof kinds / sizeof *kinds)];
    }
}

static void begin(const uint8_t *bytes, size_t size)
{
    fuzzed = bytes, fuzzed_left = size, draws = 1;
}
