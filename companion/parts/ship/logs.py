"""Logs of a ship (`companion.settings.capabilities.ShipLogs`): of her sentences, as the settings know her, and of her network."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from companion.parts.ship.options import WiredVessel
from companion.settings.model import Settings
from drivers.importer import ForeignFile
from drivers.log_stamps import Tell
from drivers.nmea import motion, network_log
from drivers.nmea.network_log import began_s
from drivers.nmea.sentence_log import SentenceLog, read
from estimator.contracts.samples import Sample

__all__ = ["began_s", "import_network", "read_sentences", "ship_motion"]


def import_network(file: ForeignFile) -> Iterator[Sample]:
    """Read a log of her network as an importer (`drivers.importer.Read`)."""
    return network_log.read(file.path, file.tell)


def ship_motion(sentence: str) -> tuple[float | None, ...] | None:
    """Return roll, pitch and heading, rad, and heave downward, m, of a whole `$PSXN,23`; None for others, or one with a fault."""
    found = motion.ship_motion(sentence)
    return None if found is None else (found.roll_rad, found.pitch_rad, found.heading_rad, found.heave_down_m)


def read_sentences(logs: Sequence[tuple[Path, int]], tell: Tell, settings: Settings) -> Iterator[Sample]:
    """Yield the samples of all logs of one ship in order.

    Args:
        logs: each with the time by which it is moved against the others, ns.

    Raises:
        BadInput: a log cannot be read, or no time is in it.
    """
    vessel = settings.of(WiredVessel)
    return read([SentenceLog(path, moved_ns * 1e-9) for path, moved_ns in logs], tell, vessel.mmsi, vessel.nmea_simulated)
