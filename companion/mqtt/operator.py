"""The operations that an operator may request of the pilot, and the reasons for refusing them."""

from __future__ import annotations

from collections.abc import Callable

from companion.runtime.pilot import FlightOutcome, Pilot
from estimator.contracts.estimates import PathName


class PilotOperator:
    """Carries out operations; each returns None if it was carried out, else the reason why it cannot be.

    Args:
        recording: switches the recorder; None if there is no recorder.
    """

    def __init__(self, pilot: Pilot, recording: Callable[[bool], str | None] | None = None) -> None:
        self._pilot = pilot
        self._recording = recording

    def start(self) -> str | None:
        over = self._over()
        if over is None or self._pilot.outcome in (FlightOutcome.GAVE_UP, FlightOutcome.LAND_TIMEOUT):
            self._pilot.begin()
            return None
        return over

    def pause(self) -> str | None:
        if (over := self._over()) is None:
            self._pilot.pause()
        return over

    def abort(self) -> str | None:
        if (over := self._over()) is None:
            self._pilot.abort()
        return over

    def steer_by(self, path: PathName) -> str | None:
        return self._pilot.steer_by(path)

    def record(self, on: bool) -> str | None:
        return "there is no recorder in this service" if self._recording is None else self._recording(on)

    def _over(self) -> str | None:
        outcome = self._pilot.outcome
        return None if outcome is None else f"the flight is over: {outcome.value}"
