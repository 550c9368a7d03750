"""The estimator's hot part in C99: sources, the header that is their contract (`decklander.h`), and the door to the library.

`abi` is made from the header when the library is built.
"""

from estimator.contracts.errors import SetupImpossible

CURE = "build it: `make core` in a checkout, or install decklander again"

try:
    from estimator.core import abi as abi
except ModuleNotFoundError as why:
    raise SetupImpossible(f"the native core is not built ({why}); {CURE}") from why
