/* The exponential function in single precision, without branches, for loops over many numbers. */
#ifndef DECKLANDER_EXPONENTIAL_H
#define DECKLANDER_EXPONENTIAL_H

#include <stdint.h>
#include <string.h>

/* e^x to 1e-6 of it, for x from -80 to 80: 2^k times the series of 2^f for |f| <= 1/2. Adding 1.5 2^23 rounds to a whole number. */
static inline float exponential(float x)
{
    const float y = x * 1.44269504f, up = y + 12582912.0f, f = y - (up - 12582912.0f);
    const float upper = 0.05550411f + f * (0.00961813f + f * (0.00133336f + f * 0.00015404f));
    const float p = 1.0f + f * (0.69314718f + f * (0.24022651f + f * upper));
    uint32_t bits;
    float scale;
    memcpy(&bits, &up, sizeof bits);
    bits = (bits << 23) + 0x3F800000u;
    memcpy(&scale, &bits, sizeof scale);
    return p * scale;
}

#endif
