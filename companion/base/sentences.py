"""The ship's sentences as a part of the service: a socket, a reader, and the line of reports that the daemon takes them from."""

from __future__ import annotations

import logging
from collections.abc import Mapping

from companion.base.observer import NullObserver
from companion.settings.vessel import VesselOptions
from drivers.mailbox import Line
from drivers.nmea.listener import SentenceListener, listening
from drivers.nmea.sentences import NmeaReader
from estimator.contracts.ports import Clock
from estimator.contracts.samples import Sample
from estimator.contracts.time import MonoNs

log = logging.getLogger(__name__)


class SentencesPart(NullObserver):
    """The supervised task.

    Args:
        reports: where samples are put.
    """

    def __init__(self, options: VesselOptions, reports: Line[Sample], clock: Clock) -> None:
        self._options = options
        self._reports = reports
        self._clock = clock
        self._reader = NmeaReader(options.mmsi)
        self._listener: SentenceListener | None = None
        self._told: set[str] = set()

    def counted(self) -> Mapping[str, float]:
        """Return the counters for health: sentences taken by kind, and refused ones by reason."""
        refused = {**self._reader.refused, **({} if self._listener is None else self._listener.refused)}
        out = {f"taken_{kind}": float(n) for kind, n in self._reader.taken.items()}
        return out | {f"refused_{why}": float(n) for why, n in refused.items()}

    async def run(self) -> None:
        """Listen until cancelled.

        Raises:
            Recoverable: the socket cannot be opened or broke.
        """
        address = self._options.address()
        async with listening(address, self._options.nmea_from, self._clock, self._take) as listener:
            self._listener = listener
            log.info("listening for the ship's sentences on %s:%d", *address)
            await listener.lost

    def _take(self, datagram: bytes, received_at: MonoNs) -> None:
        for sample in self._reader.samples(datagram, received_at):
            self._reports.offer(sample)
        for why in self._reader.refused.keys() - self._told - {"other_sentence"}:
            self._told.add(why)
            log.warning("a sentence of the ship was refused (%s); the next ones are counted only", why.replace("_", " "))
