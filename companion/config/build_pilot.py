"""The pilot from the settings: pad tracker, estimator and guidance."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from companion.config import build
from companion.config.model import Settings
from companion.runtime.pilot import Pilot
from estimator.contracts.estimates import PathName


def make_pilot(settings: Settings, shadows: Sequence[PathName] = (), kind: Callable[..., Pilot] = Pilot) -> Pilot:
    """Return the pilot that the settings describe.

    Args:
        shadows: estimator paths that run beside it to be compared.
        kind: makes the pilot in place of the class itself, from the same arguments.

    Raises:
        BadInput: the camera or pad file is missing or has a fault.
    """
    return kind(
        build.tracker(settings),
        build.estimator_options(settings),
        settings.guidance,
        automatic=settings.guidance.start == "automatic",
        shadows=shadows,
    )
