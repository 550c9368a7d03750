"""The simulated sea as a training ground for controllers that learn (docs/training.md)."""

from importlib.util import find_spec

from estimator.contracts.errors import BadInput


def register() -> None:
    """Register the environment `Decklander/Land-v0` with Gymnasium.

    Raises:
        BadInput: Gymnasium is not installed; the message says how to install it.
    """
    if find_spec("gymnasium") is None:
        raise BadInput("the training worlds need Gymnasium, which is not installed: install the extra decklander[rl]")
    import study.gym.environment  # noqa: F401
