"""The operations that a ground station may request. The daemon implements them; MAVLink commands end here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from estimator.contracts.estimates import PathName

PATHS: tuple[PathName, ...] = ("median_mean", "dead_reckoning", "ekf")
"""Estimator paths by the number that a command carries."""


@dataclass(frozen=True, slots=True)
class LandingProgress:
    """The progress of the landing that was requested."""

    percent: int | None
    """The progress in percent, 0..100; None if it is not known."""
    landed: bool | None = None
    """The result: None while the landing goes on, True if the vehicle landed on the pad, False if it ended otherwise."""
    called_off: bool = False
    """Whether the operator ended the landing."""


class Operator(Protocol):
    """The operations; each returns None if it was carried out, or one line that gives the reason for refusing."""

    def begin(self) -> str | None:
        """Start the approach, or go on after a pause."""
        ...

    def pause(self) -> str | None:
        """Hover in place until `begin`."""
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
        """Return the progress of the landing."""
        ...
