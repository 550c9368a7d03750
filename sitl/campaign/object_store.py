"""Results of a campaign wherever fsspec reaches: a bucket (s3://, gs://), a folder (file://) or memory (memory://).

Objects cannot be appended to. Flights are held back for some seconds and written as a new part, so that a process which is killed
loses those seconds; their seeds are flown again. Nothing is ever overwritten but the manifest.
"""

from __future__ import annotations

import json
import posixpath
import time
import uuid
from collections.abc import Iterator, Sequence
from typing import Any

from estimator.contracts.errors import BadInput, Recoverable, in_words
from sitl.campaign.lab import require_lab
from sitl.campaign.plan import AnyPlan
from sitl.campaign.store import MANIFEST, line_of, manifest_of_plan, parse_manifest, records_in, refuse_other
from sitl.campaign.task import Flight, job_of

_PARTS = "flights"
_HELD_MAX = 500
_HELD_S = 5.0


class ObjectStore:
    """A campaign under a URL.

    Raises:
        BadInput: fsspec or its driver for this kind of URL is not installed; the place holds another campaign, or another
            version's.
        Recoverable: the place cannot be reached.
    """

    def __init__(self, url: str, plan: AnyPlan, seeds: range) -> None:
        require_lab(f"--out {url}", "fsspec")
        import fsspec

        self.place = url
        try:
            self._fs, self._root = fsspec.core.url_to_fs(url)
        except (ValueError, ImportError) as why:
            raise BadInput(f"--out {url}: {in_words(why)}") from why
        self._session = uuid.uuid4().hex[:12]
        self._part = 0
        self._held: list[bytes] = []
        self._held_since_s = 0.0
        self._keys: set[str] = set()
        self._sessions: dict[str, float] = {}
        try:
            self._claim(plan, seeds)
            for record in self._records():
                self._keys.add(job_of(record["flight"]).key)
                session = str(record["session"])
                self._sessions[session] = max(self._sessions.get(session, 0.0), float(record["at_s"]))
        except OSError as why:
            raise Recoverable(f"--out {url}: {in_words(why)}") from why

    def keys(self) -> set[str]:
        return self._keys

    def flights(self) -> Iterator[Flight]:
        self._flush()
        seen: set[str] = set()
        for record in self._records():
            key = job_of(record["flight"]).key
            if key not in seen:
                seen.add(key)
                yield record["flight"]

    def wall_s(self) -> float:
        return sum(self._sessions.values())

    def keep(self, flights: Sequence[Flight], at_s: float) -> None:
        if not self._held:
            self._held_since_s = time.monotonic()
        self._held += [line_of(flight, self._session, at_s) for flight in flights]
        self._keys.update(job_of(flight).key for flight in flights)
        self._sessions[self._session] = at_s
        if len(self._held) >= _HELD_MAX or time.monotonic() - self._held_since_s >= _HELD_S:
            self._flush()

    def put(self, name: str, content: bytes) -> str:
        """Write a file beside the results and return its address."""
        path = posixpath.join(self._root, name)
        try:
            self._fs.pipe_file(path, content)
        except OSError as why:
            raise Recoverable(f"{self.place}/{name}: {in_words(why)}") from why
        return f"{self.place.rstrip('/')}/{name}"

    def close(self) -> None:
        self._flush()

    def _flush(self) -> None:
        if not self._held:
            return
        self._part += 1
        path = posixpath.join(self._root, _PARTS, f"{self._session}-{self._part:06d}.jsonl")
        try:
            self._fs.makedirs(posixpath.dirname(path), exist_ok=True)
            self._fs.pipe_file(path, b"".join(self._held))
        except OSError as why:
            raise Recoverable(f"{self.place}: {in_words(why)}; the same command goes on from what is kept") from why
        self._held.clear()

    def _claim(self, plan: AnyPlan, seeds: range) -> None:
        path = posixpath.join(self._root, MANIFEST)
        manifest: dict[str, Any] | None = None
        if self._fs.exists(path):
            manifest = parse_manifest(self._fs.cat_file(path), self.place)
            refuse_other(self.place, manifest, plan.identity())
        elif self._fs.exists(self._root) and self._fs.ls(self._root):
            raise BadInput(f"--out {self.place}: the place holds something and no campaign")
        self._fs.makedirs(self._root, exist_ok=True)
        self._fs.pipe_file(path, (json.dumps(manifest_of_plan(plan, seeds, manifest), indent=1) + "\n").encode())

    def _records(self) -> Iterator[dict[str, Any]]:
        for path in sorted(self._fs.glob(posixpath.join(self._root, _PARTS, "*.jsonl"))):
            lines = self._fs.cat_file(path).splitlines(keepends=True)
            for record, _ in records_in(lines, f"{self.place}/{posixpath.basename(path)}"):
                yield record
