"""The estimator's hot part in C99: sources, the header that is their contract (`decklander.h`), and the door to the library.

`abi` is made from the header when the library is built.
"""

from estimator.contracts.errors import SetupImpossible

CURE = "build it: `make core` in a checkout, or install decklander again"

try:
    import estimator.core.abi  # noqa: F401 - `from estimator.core import abi` would hide a missing module behind a circular import
except ModuleNotFoundError as why:
    if why.name != f"{__name__}.abi":
        raise
    raise SetupImpossible(f"the native core is not built ({why}); {CURE}") from None
