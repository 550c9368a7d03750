"""The recorder as a part beside the flight: what the operator wants of it and what it is told of the links outlive a life."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from companion.recorder.recorder import PART, Recorder
from companion.runtime.beside import RestartablePart
from companion.runtime.containment import CallGuard
from companion.runtime.health import Health
from estimator.contracts.time import MonoNs


class RecorderBeside(RestartablePart[Recorder]):
    """See `RestartablePart`."""

    def __init__(self, make: Callable[[], Recorder], health: Health) -> None:
        self._wanted: bool | None = None
        self._guard = CallGuard(f"{PART}.on_link", health)
        super().__init__(PART, lambda: self._as_wanted(make()))

    def switch(self, on: bool) -> str | None:
        """The operator: record or do not; says why it cannot."""
        self._wanted = on
        return self.now.switch(on) if self.now is not None else ("the recorder failed; it is being started again" if on else None)

    def on_link(self, at: MonoNs, link: str, direction: Literal["in", "out"], data: bytes, name: str | None = None) -> None:
        """One message of a link. Links call this between the vehicle and guidance, so it never raises."""
        if self.now is not None:
            self._guard.call(self.now.on_link, at, link, direction, data, name)

    def _as_wanted(self, recorder: Recorder) -> Recorder:
        if self._wanted is not None:
            recorder.switch(self._wanted)
        return recorder
