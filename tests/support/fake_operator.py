"""An operator for MQTT and MAVLink that does what it is ordered, and keeps a list of it."""

from dataclasses import dataclass, field

from companion.parts.mavlink.commands import LandingProgress
from estimator.contracts.estimates import PathName


@dataclass
class FakeOperator:
    """Does what it is ordered unless `cannot` is set."""

    done: list[str] = field(default_factory=list)
    cannot: str | None = None
    state: LandingProgress = field(default_factory=lambda: LandingProgress(None))

    def _do(self, what: str) -> str | None:
        if self.cannot is None:
            self.done.append(what)
        return self.cannot

    def start(self) -> str | None:
        return self._do("start")

    def stay(self) -> str | None:
        return self._do("stay")

    def pause(self) -> str | None:
        return self._do("pause")

    def abort(self) -> str | None:
        return self._do("abort")

    def clear(self) -> str | None:
        return self._do("clear")

    def steer_by(self, path: PathName) -> str | None:
        return self._do(f"path {path}")

    def record(self, on: bool) -> str | None:
        return self._do(f"record {on}")

    def progress(self) -> LandingProgress:
        return self.state
