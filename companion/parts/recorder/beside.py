"""The recorder as a restartable part beside the flight: the operator's switch and the links' messages survive a restart."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from companion.base.beside import RestartablePart
from companion.base.containment import CallGuard
from companion.base.health import Health
from companion.parts.recorder.recorder import PART, Recorder
from estimator.contracts.time import MonoNs


class RecorderBeside(RestartablePart[Recorder]):
    """The restartable recorder; see `RestartablePart`."""

    def __init__(self, make: Callable[[], Recorder], health: Health) -> None:
        self._wanted: bool | None = None
        self._guard = CallGuard(f"{PART}.on_link", health)
        super().__init__(PART, lambda: self._as_wanted(make()))

    def switch(self, on: bool) -> str | None:
        """Start or stop recording for the operator; return the reason if that is impossible, else None."""
        self._wanted = on
        return self.now.switch(on) if self.now is not None else ("the recorder failed; it is being started again" if on else None)

    def on_link(self, at: MonoNs, link: str, direction: Literal["in", "out"], data: bytes, name: str | None = None) -> None:
        """Record one message of a link. Links call this between the vehicle and guidance, so it never raises."""
        if self.now is not None:
            self._guard.call(self.now.on_link, at, link, direction, data, name)

    def _as_wanted(self, recorder: Recorder) -> Recorder:
        if self._wanted is not None:
            recorder.switch(self._wanted)
        return recorder
