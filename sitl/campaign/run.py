"""Fly the jobs of a campaign that are not kept yet, and keep each result before anybody hears of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from typing import Protocol

from sitl.campaign.plan import Job
from sitl.campaign.store import ResultStore, jobs_left
from sitl.campaign.task import Flight


class Workforce(Protocol):
    """Flies jobs somewhere: in processes of this machine, or on a cluster."""

    def results(self, jobs: Iterator[Job]) -> Iterator[Flight]:
        """Fly the jobs and return their results as they come, in any order."""
        ...


class Session:
    """One session of a campaign: what it flies is kept in the store with the time since its beginning."""

    def __init__(self, workforce: Workforce, store: ResultStore) -> None:
        self._workforce, self._store = workforce, store
        self._began_s = time.monotonic()

    def fly(self, jobs: Iterable[Job], on_flight: Callable[[Flight], None]) -> None:
        """Fly the jobs that are not kept yet.

        Args:
            on_flight: receives each result after it was kept.

        Raises:
            Recoverable: the results cannot be kept, or the cluster is gone; what was kept before still is.
            OtherCode: a worker has other code.
        """
        for flight in self._workforce.results(jobs_left(self._store, iter(jobs))):
            self._store.keep([flight], time.monotonic() - self._began_s)
            on_flight(flight)
