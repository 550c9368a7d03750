/* Report which header the library was compiled with. */

#include "decklander.h"

uint32_t dl_digest(void)
{
    return HEADER_DIGEST;
}
