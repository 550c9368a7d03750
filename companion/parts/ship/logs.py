"""Logs of the ship's sentences, as the settings know her."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from companion.parts.ship.options import WiredVessel
from companion.settings.model import Settings
from drivers.log_stamps import Tell
from drivers.nmea.sentence_log import SentenceLog, read
from estimator.contracts.samples import Sample


def read_sentences(logs: Sequence[tuple[Path, int]], tell: Tell, settings: Settings) -> Iterator[Sample]:
    """Yield the samples of all logs of one ship in order.

    Args:
        logs: each with the time by which it is moved against the others, ns.

    Raises:
        BadInput: a log cannot be read, or no time is in it.
    """
    vessel = settings.of(WiredVessel)
    return read([SentenceLog(path, moved_ns * 1e-9) for path, moved_ns in logs], tell, vessel.mmsi, vessel.nmea_simulated)
