"""Listen to the ship's network beside the flight: NMEA 2000 or Signal K."""

import logging
from collections.abc import Mapping

from companion.base.observer import NullObserver
from drivers.endpoint import parse_bus
from drivers.mailbox import Line
from drivers.nmea.sentences import REFUSED_FOR, by_source
from drivers.nmea.ship_bus import BusReader
from drivers.nmea.ship_sensors import Samples, ShipSensors
from drivers.nmea.ship_wires import read_bus
from drivers.one_source import SourceChoice
from estimator.contracts.samples import Sample
from estimator.contracts.time import Clock

log = logging.getLogger(__name__)

_EXPECTED = {"other_message", "other_ship", "other_receiver"}


class BusPart(NullObserver):
    """The supervised task.

    Args:
        bus: the address, as `vessel.bus` has it.
        simulated: whether simulated places are taken: a rehearsal.
        choice: chooses one of several sources of the ship.
        reports: where samples are put.
    """

    def __init__(self, bus: str, simulated: bool, choice: SourceChoice, reports: Line[Sample], clock: Clock) -> None:
        self._address, self._reports, self._clock = parse_bus(bus), reports, clock
        self._sensors = ShipSensors(simulated, choice)
        self._reader = BusReader(self._sensors)
        self._logged: set[str] = set()

    def counted(self) -> Mapping[str, float]:
        """Return the counters for health: messages taken by kind, refused ones by reason, and both by source and kind."""
        out = {f"taken_{kind}": float(n) for kind, n in self._sensors.taken.items()}
        out |= {f"refused_{why}": float(n) for why, n in self._reader.refused.items()}
        return out | by_source(self._sensors.sources, self._clock.now())

    async def run(self) -> None:
        """Listen until cancelled.

        Raises:
            Recoverable: the network cannot be reached, or no longer.
        """
        opened = lambda: log.info("listening to the ship's network at %s", self._address.text)  # noqa: E731
        await read_bus(self._address, self._reader, self._take, self._clock, opened)

    def _take(self, samples: Samples) -> None:
        for sample in samples:
            self._reports.offer(sample)
        for why in self._reader.refused.keys() - self._logged - _EXPECTED:
            self._logged.add(why)
            reason = REFUSED_FOR.get(why, why.replace("_", " "))
            log.warning("a message of the ship's network was refused (%s); the next ones are counted only", reason)
