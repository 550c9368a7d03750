"""The simulated sea as a training ground for controllers that learn (docs/training.md).

`import sitl.study.gym` registers `Decklander/Land-v0` where Gymnasium is installed; since 1.0 it finds none by itself.
`gymnasium.make("sitl.study.gym:Decklander/Land-v0")` needs no import.
"""

from importlib.util import find_spec

from estimator.contracts.errors import BadInput

_ID = "Decklander/Land-v0"


def register() -> None:
    """Register the environment `Decklander/Land-v0` with Gymnasium, which the import of this package does, too.

    Raises:
        BadInput: Gymnasium is not installed; the message says how to install it.
    """
    if find_spec("gymnasium") is None:
        raise BadInput("the training worlds need Gymnasium, which is not installed: install the extra decklander[rl]")
    import gymnasium

    if _ID not in gymnasium.registry:
        at = f"{__name__}.environment"
        gymnasium.register(_ID, entry_point=f"{at}:LandEnv", vector_entry_point=f"{at}:LandVectorEnv")


if find_spec("gymnasium") is not None:
    register()
