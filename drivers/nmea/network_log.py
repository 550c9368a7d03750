"""Read logs of a ship's network: canboat's lines and JSON, candump's, and what gateways send with a time in each line."""

import math
from collections.abc import Iterator
from pathlib import Path

from drivers.extras import require
from drivers.files import Largest, bytes_of
from drivers.log_stamps import Tell, timeline
from drivers.nmea.sentence_log import filled, logger_s
from drivers.nmea.ship_bus import BusReader
from drivers.nmea.ship_sensors import ShipSensors
from estimator.contracts.errors import BadInput
from estimator.contracts.samples import Sample
from estimator.contracts.text import utf8_of
from estimator.contracts.time import MonoNs


def read(path: Path, tell: Tell) -> Iterator[Sample]:
    """Yield the samples of a log in order; the first line is at 0.

    Raises:
        BadInput: it cannot be read, the extra `ship` is not installed, or no time is in it.
    """
    require(str(path), "ship", "nmea2000", "can")
    lines, times = _timed(path)
    sensors = ShipSensors()
    reader = BusReader(sensors)
    for at, line in zip(timeline([round(t * 1e6) for t in filled(times)], tell), lines, strict=True):
        if at is not None:
            yield from reader.line(line, MonoNs(at))
    if unused := reader.refused:
        tell("messages that are not used: " + ", ".join(f"{why.replace('_', ' ')} {n}" for why, n in unused.most_common()))


def began_s(path: Path) -> float:
    """Return when a log began by its own clock, s.

    Raises:
        BadInput: it cannot be read, or no time is in it.
    """
    return next(filter(math.isfinite, _timed(path)[1]))


def _timed(path: Path) -> tuple[list[bytes], list[float]]:
    lines = [line for line in utf8_of(bytes_of(path, Largest.LOG)).splitlines() if line.strip() and not line.startswith(b"#")]
    times = [logger_s(line[:64], b"") for line in lines]
    if not any(map(math.isfinite, times)):
        raise BadInput(f"{path}: no time in it")
    return lines, times
