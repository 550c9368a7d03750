"""The results of a campaign: a manifest, and a line of JSON for each flight that is only ever appended.

A flight counts once its line is whole and synced. A line that was torn when the process or the machine ended is cut off, and its
seed is flown again. A folder belongs to one campaign, one version of the code and one process at a time.

A session flies the jobs that are not kept yet, and keeps each result before it passes it on.
"""

import fcntl
import json
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from companion.settings.load import write_whole
from estimator.contracts.errors import BadInput, Recoverable, file_errors, refused
from sitl.campaign.plan import AnyPlan, Job, SetPlan, differences
from sitl.campaign.workers import Flight, flight_hash, job_of

MANIFEST, FLIGHTS = "manifest.json", "flights.jsonl"


class FolderStore:
    """A campaign in a folder of this machine.

    Raises:
        BadInput: the folder cannot be used, holds another campaign or another version's, or another process uses it.
    """

    def __init__(self, folder: Path, plan: AnyPlan, seeds: range) -> None:
        self.place = str(folder)
        self._path = folder / FLIGHTS
        with file_errors(f"--out {folder}"):
            folder.mkdir(parents=True, exist_ok=True)
            self._file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o666)
        try:
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as why:
                raise BadInput(f"--out {folder}: another campaign is writing into this folder") from why
            self._claim(folder, plan, seeds)
            self._keys, self._sessions, good = _scan(self._path)
            if good < os.fstat(self._file).st_size:
                os.ftruncate(self._file, good)
            self._size = good
        except BaseException:
            os.close(self._file)
            raise
        self._session = max(self._sessions, default=0) + 1

    def keys(self) -> set[str]:
        """Return the keys of the kept flights."""
        return self._keys

    def flights(self) -> Iterator[Flight]:
        """Return the kept flights in the order in which they were kept, each key once."""
        return flights_in(self._path)

    def wall_s(self, flights: int) -> float:
        """Return the share of so many flights in the wall time of the sessions that flew what is kept."""
        return sum(self._sessions.values()) * flights / max(1, len(self._keys))

    def keep(self, flights: Sequence[Flight], at_s: float) -> None:
        """Keep flights; they are safe when this returns.

        Args:
            at_s: wall time since this session began.

        Raises:
            Recoverable: they cannot be written; what was kept before still is.
        """
        records = ({"session": self._session, "at_s": round(at_s, 3), "flight": flight} for flight in flights)
        text = b"".join(json.dumps(record, separators=(",", ":"), allow_nan=False).encode() + b"\n" for record in records)
        try:
            written = 0
            while written < len(text):
                written += os.write(self._file, text[written:])
            os.fsync(self._file)
        except OSError as why:
            os.ftruncate(self._file, self._size)
            kept = f"{len(self._keys)} flights are kept, and the same command goes on from there"
            raise Recoverable(f"{self._path}: {why.strerror or why}; {kept}") from why
        self._size += len(text)
        self._keys.update(job_of(flight).key for flight in flights)
        self._sessions[self._session] = at_s

    def put(self, name: str, content: bytes) -> str:
        """Write a file beside the results and return where it is."""
        path = self._path.parent / name
        with file_errors(str(path)):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, content)
        return str(path)

    def close(self) -> None:
        """Let go of the folder."""
        os.close(self._file)

    def _claim(self, folder: Path, plan: AnyPlan, seeds: range) -> None:
        path = folder / MANIFEST
        identity = plan.identity()
        if path.exists():
            manifest = manifest_of(folder)
            refuse_other(str(folder), manifest, identity)
            manifest = manifest_of_plan(plan, seeds, manifest)
        else:
            if foreign := sorted(p.name for p in folder.iterdir() if p.name != FLIGHTS and not p.name.startswith(".new-")):
                if not self._path.stat().st_size:
                    self._path.unlink()
                raise BadInput(f"--out {folder}: the folder holds {foreign[0]!r} and no campaign")
            if self._path.stat().st_size:
                raise BadInput(f"--out {folder}: the folder holds {FLIGHTS} without {MANIFEST}, which says what they are of")
            manifest = manifest_of_plan(plan, seeds, None)
        with file_errors(f"--out {folder}: {MANIFEST}"):
            write_whole(path, json.dumps(manifest, indent=1) + "\n")


def manifest_of_plan(plan: AnyPlan, seeds: range, before: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the manifest of a campaign for these seeds; `before` is the one that is there already."""
    asked: list[list[int]] = list(before["seeds"]) if before is not None else []
    now = [seeds.start, len(seeds)]
    again: dict[str, Any] = {"options": list(plan.options)}
    if isinstance(plan, SetPlan):
        again["places"] = dict(plan.places)
    return {**plan.identity(), **again, "seeds": asked if now in asked else [*asked, now]}


def manifest_of(folder: Path) -> dict[str, Any]:
    """Return the manifest of a campaign's folder.

    Raises:
        BadInput: there is none, or it is damaged.
    """
    with file_errors(f"{folder} is no campaign's folder: {MANIFEST}"), refused(f"{folder}: {MANIFEST} is damaged", ValueError):
        manifest = json.loads((folder / MANIFEST).read_bytes())
    if not isinstance(manifest, dict) or "format" not in manifest or "code" not in manifest:
        raise BadInput(f"{folder}: {MANIFEST} is not that of a campaign")
    return manifest


def refuse_other(place: str, manifest: Mapping[str, Any], identity: Mapping[str, Any]) -> None:
    """Refuse a place that holds another campaign, and say what differs.

    Raises:
        BadInput: it does.
    """
    if manifest["format"] != identity["format"]:
        raise BadInput(f"--out {place}: its format is {manifest['format']}, this version writes {identity['format']}")
    own = [name for name in identity if name != "code"]
    if other := differences({name: identity[name] for name in own}, {name: manifest.get(name) for name in own}):
        raise BadInput(f"--out {place}: the folder holds another campaign: {other}; nothing was written")
    if other := differences(identity["code"], manifest["code"]):
        raise BadInput(f"--out {place}: the campaign was begun with other code ({other}); nothing was written")


def flights_in(path: Path) -> Iterator[Flight]:
    """Return the flights of a file of results, each once; none if there is no file.

    Raises:
        BadInput: a line before the last is damaged, or the file cannot be read.
    """
    seen: set[str] = set()
    if not path.exists():
        return
    with file_errors(str(path)), path.open("rb") as file:
        for record, _ in records_in(file, str(path)):
            key = job_of(record["flight"]).key
            if key not in seen:
                seen.add(key)
                yield record["flight"]


def records_in(lines: Iterable[bytes], place: str) -> Iterator[tuple[dict[str, Any], int]]:
    """Return the records of lines of results with the offset of their ends; a torn last line is left out.

    Raises:
        BadInput: a line before the last is damaged.
    """
    end = damaged = 0
    for number, line in enumerate(lines, 1):
        if damaged and line.strip():
            raise BadInput(f"{place}: line {damaged} is damaged; without that line its flight is flown again")
        record = _record(line) if line.endswith(b"\n") else None
        if record is None:
            damaged = damaged or number
            continue
        end += len(line)
        yield record, end


def _record(line: bytes) -> dict[str, Any] | None:
    """Return the record of a line if it is whole, and its hash that of its content."""
    try:
        record = json.loads(line)
        flight = record["flight"]
        whole = isinstance(flight["seed"], int) and flight["hash"] == flight_hash(flight)
    except (ValueError, KeyError, TypeError):
        return None
    return dict(record) if whole else None


def _scan(path: Path) -> tuple[set[str], dict[int, float], int]:
    """Return the keys of the kept flights, the wall time of each session, and the offset of the end of the last whole line."""
    keys: set[str] = set()
    sessions: dict[int, float] = {}
    good = 0
    with path.open("rb") as file:
        for record, good in records_in(file, str(path)):  # noqa: B007
            keys.add(job_of(record["flight"]).key)
            session = int(record["session"])
            sessions[session] = max(sessions.get(session, 0.0), float(record["at_s"]))
    return keys, sessions, good


def wall_s_in(path: Path) -> float:
    """Return the wall time of the sessions that flew what a file of results holds, s."""
    return sum(_scan(path)[1].values())


Workforce = Callable[[Iterator[Job]], Iterator[Flight]]
"""Flies jobs in processes of this machine, or on a cluster, and returns their results as they come, in any order."""


def fly_left(workforce: Workforce, store: FolderStore, jobs: Iterable[Job], on_flight: Callable[[Flight], None]) -> None:
    """Fly the jobs that are not kept yet, and keep each result with the time since the beginning of this session.

    Args:
        on_flight: receives each result after it was kept.

    Raises:
        Recoverable: the results cannot be kept, or the cluster is gone; what was kept before still is.
        OtherCode: a worker has other code.
    """
    began_s = time.monotonic()
    kept = frozenset(store.keys())
    for flight in workforce(job for job in jobs if job.key not in kept):
        store.keep([flight], time.monotonic() - began_s)
        on_flight(flight)
