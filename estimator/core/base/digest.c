/* What the library says about itself. */

#include "interface.h"

uint32_t core_digest(void)
{
    return INTERFACE_DIGEST;
}
