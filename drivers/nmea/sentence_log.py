"""Read logs of a ship's sentences: with a logger's time before each, or with the times in the sentences themselves.

Several logs of one ship are one stream: her receivers are kept apart as on the wire, and their times are of one zero.
"""

import heapq
import math
import re
import statistics
from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

from msgspec import Struct

from drivers.files import Largest, bytes_of
from drivers.log_stamps import Tell, timeline
from drivers.nmea.sentences import NmeaReader
from drivers.one_source import SourceChoice
from drivers.ship_reports import SENTENCE
from estimator.contracts.errors import BadInput
from estimator.contracts.samples import Sample
from estimator.contracts.text import utf8_of
from estimator.contracts.time import NS_PER_S, MonoNs

_TIME = re.compile(
    r"(?P<day>\d{4}[-/]\d\d[-/]\d\d|\d\d/\d\d/\d{4})[T ,]+(?P<clock>\d\d:\d\d:\d\d(?:\.\d+)?)"
    r"|(?P<unix>(?<!\d)\d{9,13}(?:\.\d+)?)|(?P<only>\d\d:\d\d:\d\d(?:\.\d+)?)|(?P<s>(?<!\S)\d{1,8}\.\d+)"
)
_OWN = re.compile(r"\$..(?:GGA|ZDA|RMC|GLL),(\d{6}(?:\.\d+)?)", re.IGNORECASE)
_TAG_TIME = re.compile(rb"c:(\d{9,13})")
_DAY_S = 86_400.0  # length of a day
_MS_FROM = 1e11
"""Unix times above this are in milliseconds."""


class SentenceLog(Struct, frozen=True):
    """A log of sentences, and the time by which it is moved against the others, s."""

    path: Path
    offset_s: float = 0.0


class _Row(Struct, frozen=True, order=True):
    at_ns: int
    log: int
    sentence: bytes


def read(logs: Sequence[SentenceLog], tell: Tell, mmsi: int = 0, simulated: bool = False) -> Iterator[Sample]:
    """Yield the samples of all logs, in order of their arrival at the loggers; the first begins at 0.

    Raises:
        BadInput: a log cannot be read, or no time is in it.
    """
    timed = [(log, *_rows(log, tell)) for log in logs]
    zero = min(began for _, _, began in timed)
    apart = max(began for _, _, began in timed) - zero > _DAY_S
    if apart:
        tell("the logs are of different days: each begins at 0")
    choice, several = SourceChoice(), len(logs) > 1
    readers = [NmeaReader(mmsi, simulated, choice, log.path.stem if several else "") for log in logs]
    streams = []
    for n, (log, rows, began) in enumerate(timed):
        moved_ns = round((log.offset_s + (0.0 if apart else began - zero)) * NS_PER_S)
        streams.append([_Row(at + moved_ns, n, sentence) for at, sentence in rows])
    for row in heapq.merge(*streams):
        yield from readers[row.log].samples(row.sentence, MonoNs(row.at_ns))
    refused = sum((reader.refused for reader in readers), Counter[str]())
    if refused:
        tell("sentences that are not used: " + ", ".join(f"{why.replace('_', ' ')} {n}" for why, n in refused.most_common()))


def _rows(log: SentenceLog, tell: Tell) -> tuple[list[tuple[int, bytes]], float]:
    """Return the arrivals, ns since the first, and sentences of a log in order, and when it began by its own clock, s."""
    lines = utf8_of(bytes_of(log.path, Largest.LOG)).splitlines()
    found = [(line[: match.start()] + b" " + line[match.end() :], match[0]) for line in lines if (match := SENTENCE.search(line))]
    times = [logger_s(before, sentence) for before, sentence in found]
    if 2 * sum(math.isfinite(t) for t in times) < len(times) or not times:
        times = [_own_s(sentence) for _, sentence in found]
        if not any(map(math.isfinite, times)):
            raise BadInput(
                f"{log.path}: no time in it: sentences need a logger's time before them, or one with a time (GGA, RMC, ZDA)"
            )
    known = _spread(filled(times), [re.split(rb"[ *]|,(?!2\d,)", sentence)[0] for _, sentence in found])
    stamps = timeline([round(t * 1e6) for t in known], lambda text: tell(f"{log.path.name}: {text}"))
    rows = [(at, sentence) for at, (_, sentence) in zip(stamps, found, strict=True) if at is not None]
    return sorted(rows, key=lambda row: row[0]), known[0]


def filled(times: Sequence[float]) -> list[float]:
    """Return times, each unknown one that of the sentence before; after midnight a time of day goes on."""
    at, days, out = next(t for t in times if math.isfinite(t)), 0.0, []
    for t in times:
        if math.isfinite(t):
            days += _DAY_S if at < 2.0 * _DAY_S and t + days < at - 0.5 * _DAY_S else 0.0
            at = t + days
        out.append(at)
    return out


def _spread(times: Sequence[float], kinds: Sequence[bytes]) -> list[float]:
    """Return times at which several sentences of a kind that have one time lie evenly up to the next time."""
    steps = [b - a for a, b in pairwise(times) if b > a]
    usual_s, out, begin = statistics.median(steps) if steps else 0.0, list(times), 0
    for end in range(1, len(times) + 1):
        if end < len(times) and times[end] == times[begin]:
            continue
        run = kinds[begin:end]
        next_s = min(usual_s, times[end] - times[begin]) if end < len(times) else usual_s
        counts, before = Counter(run), Counter[bytes]()
        for at, kind in enumerate(run, begin):
            out[at] += max(0.0, next_s) * before[kind] / counts[kind]
            before[kind] += 1
        begin = end
    return out


def logger_s(before: bytes, sentence: bytes) -> float:
    """Return the time that a logger wrote before a sentence, s; nan if it wrote none."""
    if (tag := _TAG_TIME.search(sentence.partition(b"$")[0])) is not None:
        return _unix_s(tag[1].decode())
    found = _TIME.search(before.decode("ascii", "replace"))
    if found is None:
        return math.nan
    if found["unix"]:
        return _unix_s(found["unix"])
    if found["s"]:
        return float(found["s"])
    hour, minute, second = (found["clock"] or found["only"]).split(":")
    clock_s = 3600.0 * int(hour) + 60.0 * int(minute) + float(second)
    if not found["day"]:
        return clock_s
    parts = [int(part) for part in re.split("[-/]", found["day"])]
    year, month, day = parts if parts[0] > 99 else (parts[2], parts[0], parts[1])
    try:
        return datetime(year, month, day, tzinfo=UTC).timestamp() + clock_s
    except ValueError:
        return math.nan


def _unix_s(digits: str) -> float:
    return float(digits) * (1e-3 if float(digits) > _MS_FROM else 1.0)


def _own_s(sentence: bytes) -> float:
    found = _OWN.search(sentence.decode("ascii", "replace"))
    return math.nan if found is None else 3600.0 * int(found[1][:2]) + 60.0 * int(found[1][2:4]) + float(found[1][4:])
