"""An operator for MQTT and MAVLink that does what it is ordered, and keeps a list of it."""

from dataclasses import dataclass, field

from companion.base.orders import OperatorOrder
from companion.parts.mavlink.commands import LandingProgress
from estimator.contracts.time import MonoNs


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

    def order(self, order: OperatorOrder, given_at: MonoNs | None = None) -> str | None:
        return self._do(order.value)

    def record(self, on: bool) -> str | None:
        return self._do(f"record {on}")

    def progress(self) -> LandingProgress:
        return self.state
