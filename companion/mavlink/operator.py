"""What a ground station may ask of the service. The daemon implements it; MAVLink commands end here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from estimator.contracts.estimates import PathName

PATHS: tuple[PathName, ...] = ("median_mean", "dead_reckoning", "ekf")
"""Estimator paths by the number that a command carries."""


@dataclass(frozen=True, slots=True)
class LandingProgress:
    """How the landing that was asked for goes on."""

    percent: int | None
    """0..100; None where it cannot be told."""
    landed: bool | None = None
    """None while it goes on; True when it stands on the pad; False when it ended otherwise."""
    called_off: bool = False
    """The operator ended it."""


class Operator(Protocol):
    """Each deed returns None when it was done, or one line that says why not."""

    def begin(self) -> str | None:
        """Start the approach, or go on after a pause."""
        ...

    def pause(self) -> str | None:
        """Hover where it is until `begin`."""
        ...

    def abort(self) -> str | None:
        """Call the landing off and hover."""
        ...

    def choose_path(self, path: PathName) -> str | None:
        """Let another estimator path steer."""
        ...

    def record(self, on: bool) -> str | None:
        """Start or stop a recording."""
        ...

    def progress(self) -> LandingProgress:
        """Of the landing."""
        ...
