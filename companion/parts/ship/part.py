"""Listen to the ship beside the flight: her sentences, her network (NMEA 2000, Signal K), and receivers of relative positions."""

import logging
from collections.abc import Iterable, Iterator, Mapping
from functools import partial

from companion.base.observer import NullObserver
from companion.cycle.ports import Assembly
from companion.parts.ship.options import RtkOptions, WiredVessel
from companion.settings.capabilities import Reference
from companion.settings.model import Settings
from drivers.endpoint import parse_bus
from drivers.extras import require
from drivers.mailbox import Line
from drivers.nmea.sentences import NmeaReader, by_source
from drivers.nmea.ship_bus import BusReader
from drivers.nmea.ship_sensors import ShipSensors
from drivers.nmea.ship_wires import read_bus
from drivers.nmea.transport import SentenceSource, sentences_from
from drivers.one_source import SourceChoice
from drivers.relpos import RelposReader
from drivers.ship_reports import REFUSED_FOR
from drivers.wires import open_wire
from estimator.contracts.errors import Recoverable, refused
from estimator.contracts.samples import Sample
from estimator.contracts.time import Clock

log = logging.getLogger(__name__)

_EXPECTED = {"other_sentence", "other_message", "other_receiver"}
_OF_A_RECEIVER = {
    "no_fix": "the receiver has no fix",
    "base_silent": "the receiver hears nothing of its base",
    "base_not_moving": "the receiver takes its base to stand still: its moving-base mode is off",
    "no_carrier_solution": "the receiver has no carrier solution",
    "too_old": "its solution came too late",
    "too_long": "its baseline is longer than expert.rtk.length_max_m",
    "no_heading": "it holds no fixed heading",
    "wrong_sender": "another sender is read",
}


class _ShipPart(NullObserver):
    """A supervised task that hands the samples of one source to the service, and logs the first refusal of each kind.

    Args:
        read: what it reads, for the log.
        reports: where samples are put.
        reasons: reasons of a refusal whose names alone are not clear.
    """

    def __init__(self, read: str, reports: Line[Sample], clock: Clock, reasons: Mapping[str, str] = REFUSED_FOR) -> None:
        self._read, self._reports, self._clock, self._reasons = read, reports, clock, reasons
        self._logged: set[str] = set()

    def _counts(self) -> tuple[Mapping[str, int], Mapping[str, int]]:
        """Return what was taken, by kind, and refused, by reason."""
        raise NotImplementedError

    def counted(self) -> Mapping[str, float]:
        """Return the counters for health: what was taken, by kind, and refused, by reason."""
        taken, refused = self._counts()
        named = ("taken", taken), ("refused", refused)
        return {f"{word}_{name}": float(n) for word, counts in named for name, n in counts.items()}

    def _put(self, samples: Iterable[Sample]) -> None:
        for sample in samples:
            self._reports.offer(sample)
        for why in self._counts()[1].keys() - self._logged - _EXPECTED:
            self._logged.add(why)
            reason = self._reasons.get(why, why.replace("_", " "))
            log.warning("%s was refused (%s); the next ones are counted only", self._read, reason)


class SentencesPart(_ShipPart):
    """The supervised task that reads her sentences.

    Args:
        choice: chooses one of several sources of the ship.
        reports: where samples are put.
    """

    def __init__(self, options: WiredVessel, choice: SourceChoice, reports: Line[Sample], clock: Clock) -> None:
        super().__init__("a sentence of the ship", reports, clock)
        self._options = options
        self._reader = NmeaReader(options.mmsi, options.nmea_simulated, choice)
        self._source = SentenceSource(options.nmea_from, lambda lines, at: self._put(self._reader.samples(lines, at)))
        self._logged = {"wrong_sender"}
        """The source itself logs that."""

    def _counts(self) -> tuple[Mapping[str, int], Mapping[str, int]]:
        return self._reader.taken, self._reader.refused + self._source.refused

    def counted(self) -> Mapping[str, float]:
        return {**super().counted(), **self._reader.by_source(self._clock.now())}

    async def run(self) -> None:
        """Listen until cancelled.

        Raises:
            Recoverable: they cannot be listened to, or no longer.
        """
        async with sentences_from(self._options.endpoint(), self._source, self._clock) as wire:
            log.info("listening for the ship's sentences on %s", self._options.nmea)
            await wire.broken()


class BusPart(_ShipPart):
    """The supervised task that reads her network.

    Args:
        bus: the address, as `vessel.bus` has it.
        simulated: whether simulated places are taken: a rehearsal.
        choice: chooses one of several sources of the ship.
        reports: where samples are put.
    """

    def __init__(self, bus: str, simulated: bool, choice: SourceChoice, reports: Line[Sample], clock: Clock) -> None:
        super().__init__("a message of the ship's network", reports, clock)
        self._address, self._sensors = parse_bus(bus), ShipSensors(simulated, choice)
        self._reader = BusReader(self._sensors)
        self._logged = {"other_ship"}
        """A network also carries what is of the ships around."""

    def _counts(self) -> tuple[Mapping[str, int], Mapping[str, int]]:
        return self._sensors.taken, self._reader.refused

    def counted(self) -> Mapping[str, float]:
        return {**super().counted(), **by_source(self._sensors.sources, self._clock.now())}

    async def run(self) -> None:
        """Listen until cancelled.

        Raises:
            Recoverable: the network cannot be reached, or no longer.
        """
        opened = partial(log.info, "listening to the ship's network at %s", self._address.text)
        await read_bus(self._address, self._reader, self._put, self._clock, opened)


class RtkPart(_ShipPart):
    """The supervised task that reads a GNSS receiver.

    Args:
        key: which of the settings' streams it reads, `source` or `heading`.
        reports: where samples are put.

    Raises:
        BadInput: pyubx2 is not installed.
    """

    def __init__(self, options: RtkOptions, key: str, reports: Line[Sample], clock: Clock) -> None:
        super().__init__(f"a message for rtk.{key}", reports, clock, _OF_A_RECEIVER)
        self._endpoint, self._key = options.endpoint(key), key
        self._reader = RelposReader(options.receiver(key))

    def _counts(self) -> tuple[Mapping[str, int], Mapping[str, int]]:
        return self._reader.taken, self._reader.refused

    async def run(self) -> None:
        """Listen until cancelled.

        Raises:
            Recoverable: it cannot be listened to, or no longer.
        """
        with refused(f"rtk.{self._key} {self._endpoint}", Recoverable, by=Recoverable):
            async with open_wire(self._endpoint, self._clock, lambda *data: self._put(self._reader.take(*data))) as wire:
                log.info("listening for relative positions on %s", self._endpoint)
                await wire.broken()


def join(service: Assembly) -> None:
    """Add a part for each wire of the ship that the settings name. What several wires report is taken from one of them."""
    settings, choice = service.settings, SourceChoice(log.info)
    vessel, rtk = settings.of(WiredVessel), settings.of(RtkOptions)
    reports, clock = service.ship_reports(), service.clock
    if vessel.nmea:
        service.add("sentences", SentencesPart(vessel, choice, reports, clock))
    if vessel.bus:
        service.add("bus", BusPart(vessel.bus, vessel.nmea_simulated, choice, reports, clock))
    for key in ("source", "heading"):
        if getattr(rtk, key):
            service.add(f"rtk_{key}", RtkPart(rtk, key, reports, clock))


def references(settings: Settings) -> Iterator[Reference]:
    """Yield what looks for the packages of each wire that the settings name."""
    vessel, rtk = settings.of(WiredVessel), settings.of(RtkOptions)
    if vessel.nmea:
        yield "vessel.nmea", (), partial(require, f"vessel.nmea {vessel.nmea}", "nmea", "pynmea2", "pyais")
    if vessel.bus and parse_bus(vessel.bus).signalk is None:
        yield "vessel.bus", (), partial(require, f"vessel.bus {vessel.bus}", "ship", "nmea2000", "can")
    for key in ("source", "heading"):
        if receiver := getattr(rtk, key):
            yield f"rtk.{key}", (), partial(require, f"rtk.{key} {receiver}", "ship", "pyubx2")
