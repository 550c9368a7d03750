"""Fly jobs on a Dask cluster. A worker that is killed costs no flight: the scheduler gives its flights to another."""

from __future__ import annotations

import importlib
import logging
import time
import uuid
from collections.abc import Iterator
from concurrent.futures import CancelledError
from typing import Any

from estimator.contracts.errors import BadInput, Recoverable, in_words
from sitl.campaign.code import code_version, differences
from sitl.campaign.lab import require_lab
from sitl.campaign.plan import AnyPlan, Job
from sitl.campaign.task import Flight, Flyer, Order, OtherCode, base_of, failed, finished, fly_flight, fly_order

_CONNECT_S = 10.0
_WORKERS_S = 30.0
_POLL_S, _LOOK_S = 0.02, 2.0
_WORKERLESS_S = 60.0
"""Time without any worker after which a campaign ends: one that restarts its workers has them back by then."""
_ORDERS_EACH = 3
"""Orders that wait for each thread of the cluster, so that none is idle between two flights."""


class ClusterWorkers:
    """Flies jobs on a Dask cluster; a context manager that closes the connection.

    Args:
        address: of the scheduler, as `tcp://host:8786`.
        flyer: flies one scenario once.

    Raises:
        BadInput: Dask is not installed, or the address has no form that Dask knows.
        Recoverable: no scheduler answers, or it has no workers.
        OtherCode: a worker has other code.
    """

    def __init__(self, plan: AnyPlan, code: dict[str, str], address: str, flyer: Flyer = fly_flight) -> None:
        require_lab(f"--scheduler {address}", "dask", "distributed")
        distributed: Any = importlib.import_module("distributed")
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what it reports is said here, in one line
        self._plan, self._bases = plan, dict[str, bytes]()
        self._code, self._address, self._flyer = code, address, flyer
        self._run, self._orders = uuid.uuid4().hex[:8], 0
        try:
            self._client: Any = distributed.Client(address, timeout=_CONNECT_S, set_as_default=False)
        except OSError as why:
            raise Recoverable(f"--scheduler {address}: no scheduler answers there ({in_words(why)})") from why
        except (ValueError, TypeError) as why:
            raise BadInput(f"--scheduler {address}: {in_words(why)}; write it as tcp://host:8786") from why
        try:
            self.threads = self._examined()
        except BaseException:
            self._client.close(timeout=_CONNECT_S)
            raise

    def __enter__(self) -> ClusterWorkers:
        return self

    def __exit__(self, *_: object) -> None:
        self._client.close(timeout=_CONNECT_S)

    def results(self, jobs: Iterator[Job]) -> Iterator[Flight]:
        """Fly the jobs and return their results as they come.

        A flight whose worker dies again and again, more often than Dask's `allowed-failures`, has failed.

        Raises:
            OtherCode: a worker that joined has other code.
            Recoverable: the scheduler is gone, or all workers are.
        """
        distributed: Any = importlib.import_module("distributed")
        under_way: dict[str, Job] = {}
        done = distributed.as_completed(loop=self._client.loop)

        def order(job: Job) -> None:
            future = self._submit(job)
            under_way[future.key] = job
            done.add(future)

        try:
            while True:
                while len(under_way) < _ORDERS_EACH * self.threads and (job := next(jobs, None)) is not None:
                    order(job)
                if not under_way:
                    return
                self._await(done)
                future = next(done)
                job = under_way.pop(future.key)
                flight = self._result(future, job)
                if flight is not None:
                    yield flight
                    continue
                self._await_connection()
                order(job)
        finally:
            done.clear()

    def _await(self, done: Any) -> None:
        """Wait for a result.

        Raises:
            Recoverable: the cluster has had no worker for too long.
        """
        workers_at = looked_at = time.monotonic()
        while not done.has_ready() and self._client.status == "running":
            time.sleep(_POLL_S)
            now = time.monotonic()
            if now - looked_at >= _LOOK_S:
                looked_at = now
                workers_at = now if self._client.ncores() else workers_at
            if now - workers_at > _WORKERLESS_S:
                raise Recoverable(
                    f"--scheduler {self._address}: the cluster has had no worker for {_WORKERLESS_S:g} s; start one "
                    f"(dask worker {self._address}), and the same command goes on from what is kept"
                )

    def _await_connection(self) -> None:
        """Wait until the client is connected again.

        Raises:
            Recoverable: the scheduler is gone.
        """
        begun = time.monotonic()
        while self._client.status != "running":
            if self._client.status != "connecting" or time.monotonic() - begun > _CONNECT_S:
                raise self._gone()
            time.sleep(_POLL_S)

    def _submit(self, job: Job) -> Any:
        order = Order(job, base_of(self._plan, job, self._bases), self._code, self._flyer)
        self._orders += 1  # a key that was cancelled stays so, and a job may be ordered again
        return self._client.submit(fly_order, order, key=f"fly-{self._run}-{self._orders}-{job.key}", pure=False)

    def _result(self, future: Any, job: Job) -> Flight | None:
        """Return the result; None if the order was lost: the client cancels its orders when its connection breaks."""
        if future.status == "finished":
            return self._fetched(future)
        error = future.exception(timeout=_CONNECT_S) if future.status == "error" else None
        if type(error).__name__ == "KilledWorker":
            return finished(
                failed(self._plan.of(job).name, job, "the workers that flew it died"), job, self._plan.of(job).perception
            )
        if isinstance(error, BadInput):
            raise OtherCode(f"--scheduler {self._address}: {in_words(error)}") from error
        if isinstance(error, BaseException):
            said = f"{type(error).__name__}: {in_words(error)}"
            raise Recoverable(f"--scheduler {self._address}: a worker could not fly: {said}") from error
        return None

    def _fetched(self, future: Any) -> Flight | None:
        """Return a finished result; if its worker died meanwhile, another flies it again and this waits."""
        while future.status not in ("cancelled", "lost"):
            try:
                flight: Flight = future.result(timeout=_CONNECT_S)
            except (OSError, TimeoutError, CancelledError) as why:
                if self._client.status not in ("running", "connecting"):
                    raise self._gone() from why
            else:
                return flight
        return None

    def _gone(self) -> Recoverable:
        return Recoverable(f"--scheduler {self._address}: the scheduler is gone; the same command goes on from what is kept")

    def _examined(self) -> int:
        """Return the number of the cluster's threads, once every worker has shown that it has our code."""
        try:
            self._client.wait_for_workers(1, timeout=_WORKERS_S)
        except TimeoutError as why:
            raise Recoverable(f"--scheduler {self._address}: it has no workers") from why
        for worker, code in self._client.run(code_version, on_error="return").items():
            if isinstance(code, BaseException):
                raise OtherCode(f"--scheduler {self._address}: worker {worker} has no such code: {in_words(code)}")
            if other := differences(self._code, code):
                raise OtherCode(f"--scheduler {self._address}: worker {worker} has other code: {other}")
        return max(1, int(sum(self._client.ncores().values())))
