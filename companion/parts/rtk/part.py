"""Listen to a GNSS receiver that measures a relative position, and hand its samples to the service."""

import logging
from collections.abc import Mapping

from companion.settings.rtk import RtkOptions
from drivers.endpoint import Address
from drivers.mailbox import Line
from drivers.relpos import RelposReader
from drivers.wires import open_wire
from estimator.contracts.errors import Recoverable
from estimator.contracts.samples import Sample
from estimator.contracts.time import Clock, MonoNs

log = logging.getLogger(__name__)

_REASONS = {
    "no_fix": "the receiver has no fix",
    "base_silent": "the receiver hears nothing of its base",
    "base_not_moving": "the receiver takes its base to stand still: its moving-base mode is off",
    "no_carrier_solution": "the receiver has no carrier solution",
    "too_old": "its solution came too late",
    "too_long": "its baseline is longer than expert.rtk.length_max_m",
    "no_heading": "it holds no fixed heading",
    "wrong_sender": "another sender is read",
}


class RtkPart:
    """The supervised task.

    Args:
        key: which of the settings' streams it reads, `source` or `heading`.
        reports: where samples are put.

    Raises:
        BadInput: pyubx2 is not installed.
    """

    def __init__(self, options: RtkOptions, key: str, reports: Line[Sample], clock: Clock) -> None:
        self._endpoint, self._key = options.endpoint(key), key
        self._reader = RelposReader(options.receiver(key))
        self._reports, self._clock = reports, clock

    def counted(self) -> Mapping[str, float]:
        """Return the counters for health: samples by the kind of their solution, and refused messages by reason."""
        out = {f"taken_{kind}": float(n) for kind, n in self._reader.taken.items()}
        return out | {f"refused_{why}": float(n) for why, n in self._reader.refused.items()}

    async def run(self) -> None:
        """Listen until cancelled.

        Raises:
            Recoverable: it cannot be listened to, or no longer.
        """
        try:
            async with open_wire(self._endpoint, self._clock, self._take) as wire:
                log.info("listening for relative positions on %s", self._endpoint)
                await wire.broken()
        except Recoverable as why:
            raise Recoverable(f"rtk.{self._key} {self._endpoint}: {why}") from why

    def _take(self, data: bytes, received_at: MonoNs, sender: Address | None) -> None:
        before = set(self._reader.refused)
        for sample in self._reader.take(data, received_at, sender):
            self._reports.offer(sample)
        for why in self._reader.refused.keys() - before:
            reason = _REASONS.get(why, why.replace("_", " "))
            log.warning("a message for rtk.%s was refused (%s); the next ones are counted only", self._key, reason)
