"""The operations that a ground station may request, and the operator that passes them to the pilot. MAVLink commands end here."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from companion.base.mission import FlightOutcome
from companion.base.orders import OrderSender, OrderSource
from companion.guidance.pilot import Pilot
from companion.guidance.pilot_operator import PilotOperator
from estimator.contracts.estimates import PathName, RelativeState
from estimator.contracts.ports import Clock

PATHS: tuple[PathName, ...] = ("median_mean", "dead_reckoning", "ekf", "constant_velocity")
"""Estimator paths by the number that a command carries."""


@dataclass(frozen=True, slots=True)
class LandingProgress:
    """The progress of the landing that was requested."""

    percent: int | None
    """The progress in percent, 0..100; None if it is not known."""
    landed: bool | None = None
    """The result: None while the landing goes on, True if the vehicle landed on the pad, False if it ended otherwise."""
    called_off: bool = False
    """True if the operator ended the landing."""


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


class PilotTower:
    """An `Operator` that commands the pilot.

    Args:
        believe: returns the steering path's newest belief.
        recording: switches the recorder; None if there is no recorder.
    """

    def __init__(
        self,
        pilot: Pilot,
        believe: Callable[[], RelativeState | None],
        clock: Clock,
        recording: Callable[[bool], str | None] | None = None,
    ) -> None:
        self._pilot = pilot
        self._handlers = PilotOperator(pilot, OrderSender(OrderSource.MAVLINK), clock, recording)
        self._believe = believe
        self._from_m: float | None = None

    def begin(self) -> str | None:
        refusal = self._handlers.start()
        if refusal is None:
            self._from_m = None
        return refusal

    def pause(self) -> str | None:
        return self._handlers.pause()

    def abort(self) -> str | None:
        return self._handlers.abort()

    def choose_path(self, path: PathName) -> str | None:
        return self._handlers.steer_by(path)

    def record(self, on: bool) -> str | None:
        return self._handlers.record(on)

    def progress(self) -> LandingProgress:
        outcome = self._pilot.outcome
        if outcome is not None:
            called_off = outcome is FlightOutcome.ABORTED
            return LandingProgress(None, None if called_off else outcome is FlightOutcome.LANDED, called_off)
        belief = self._believe()
        if belief is None or belief.height_m <= 0:
            return LandingProgress(None)
        self._from_m = max(belief.height_m, self._from_m or 0.0)
        return LandingProgress(round(100.0 * (1.0 - belief.height_m / self._from_m)))
