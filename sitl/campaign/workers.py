"""Fly jobs in processes of this machine or on a Dask cluster; a worker that dies costs no flight.

What goes wrong in a flight is its result and not the campaign's end.
Each campaign on this machine has a pool of its own. On a cluster the scheduler gives the flights of a killed worker to another.
"""

from __future__ import annotations

import hashlib
import importlib
import logging
import multiprocessing
import os
import platform
import signal
import threading
import time
import traceback
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from importlib.util import find_spec
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import wait as wait_for_connections
from typing import Any, NamedTuple

from companion.settings.model import Settings
from estimator.contracts.errors import BadInput, Recoverable, SetupImpossible, in_words, refused
from sitl.campaign.plan import AnyPlan, Job, canonical, code_version, differences, unpacked
from sitl.flight.afterwards import cpu_s
from sitl.flight.one_flight import FlyOptions, Perception, fly
from sitl.scenario.scenario import Scenario

Flight = dict[str, Any]
"""Output of `decklander simulate --json`, with `perception`, `varied` where something is, and `hash`."""
Flyer = Callable[[str, Scenario, int, Settings, Perception, str | None], Flight]
"""Flies a scenario once: name, scenario, seed, settings, perception, its error model's file.

A function of a module, so that it can be sent."""
ERROR = "error"
"""The outcome of a flight that raised an error."""
_NOT_HASHED = frozenset({"cpu_s", "hash"})


class OtherCode(BadInput):
    """A worker has other code than the campaign."""


class Order(NamedTuple):
    """A job with all that a worker needs to fly it."""

    job: Job
    base: bytes
    code: dict[str, str]
    flyer: Flyer


def order_of(plan: AnyPlan, job: Job, code: dict[str, str], flyer: Flyer) -> Order:
    """Return the order of a job of a plan."""
    return Order(job, plan.of(job).base(), code, flyer)


def lost(plan: AnyPlan, job: Job, why: str) -> Flight:
    """Return the result of a flight whose process or worker died."""
    own = plan.of(job)
    return finished(failed(own.name, job, why), job, own.perception)


def fly_flight(
    name: str, scenario: Scenario, seed: int, settings: Settings, perception: Perception, perception_model: str | None
) -> Flight:
    """Fly a scenario once; the flyer of every campaign but those of tests."""
    return fly(name, scenario, seed, settings, perception, options=FlyOptions(perception_model)).as_json()


def fly_order(order: Order) -> Flight:
    """Fly a job and return its result; a flight that raises an error has that as its outcome.

    Raises:
        OtherCode: this process runs other code than the one that ordered.
    """
    if other := differences(order.code, code_version()):
        raise OtherCode(f"the worker on {platform.node()}, process {os.getpid()}, has other code: {other}")
    name, base, perception, model = unpacked(order.base)
    job = order.job
    began_s = cpu_s()
    try:
        scenario, settings = base.with_values(job.point, "the campaign's point")
        flight = order.flyer(name, scenario, job.seed, settings, perception, model)
    except Exception as why:
        place = traceback.extract_tb(why.__traceback__)[-1]
        output = f"{type(why).__name__}: {in_words(why)} ({place.filename.rpartition('/')[2]}:{place.lineno})"
        flight = failed(name, job, output, cpu_s() - began_s)
    return finished(flight, job, perception)


def failed(name: str, job: Job, error: str, cpu_s: float = 0.0) -> Flight:
    """Return the result of a flight that did not come to an end."""
    return {
        "scenario": name,
        "seed": job.seed,
        "landed_on_pad": False,
        "outcome": ERROR,
        "duration_s": 0.0,
        "touchdown": None,
        "contacts": [],
        "in_water": False,
        "frames": {},
        "grade": "failed",
        "because": error,
        "refused": None,
        "unsafe": [],
        "lowest_blind_m": None,
        "contacts_outside_commit": 0,
        "go_arounds": 0,
        "faults": [],
        "cpu_s": round(cpu_s, 2),
    }


def error_m(flight: Flight) -> float:
    """Return how far from the pad's centre a landed vehicle stands, m; at its contact where nobody looked later."""
    stands = flight.get("standing") or flight["touchdown"]
    return float(stands["lateral_m"])


def finished(flight: Flight, job: Job, perception: str) -> Flight:
    """Return a flight's result with what the campaign knows of it, and its hash."""
    flight = {**flight, "perception": perception, **({"varied": dict(job.point)} if job.point else {})}
    if job.scenario:
        flight["in_set"] = True
    return {**flight, "hash": flight_hash(flight)}


def flight_hash(flight: Flight) -> str:
    """Return the hash of a result without its CPU time: equal wherever the same seed was flown with the same code."""
    hashed = {key: value for key, value in flight.items() if key not in _NOT_HASHED}
    return hashlib.blake2b(canonical(hashed).encode(), digest_size=16).hexdigest()


def job_of(flight: Flight) -> Job:
    """Return the job of this result."""
    return Job(flight["seed"], tuple(flight.get("varied", {}).items()), flight["scenario"] if flight.get("in_set") else "")


_ORDERS_EACH = 2
"""Orders that wait for each worker, so that none is idle between two flights."""
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class LocalWorkers:
    """Flies jobs in processes of this machine; a context manager that ends them.

    Args:
        workers: number of processes.
        flyer: flies one scenario once.
    """

    def __init__(self, plan: AnyPlan, code: dict[str, str], workers: int, flyer: Flyer = fly_flight) -> None:
        self._plan, self._code, self._workers, self._flyer = plan, code, workers, flyer
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> LocalWorkers:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def results(self, jobs: Iterator[Job]) -> Iterator[Flight]:
        """Fly the jobs and return their results as they come.

        When a process dies, all flights under way are flown again, one at a time; one that kills its process then has failed.

        Raises:
            OtherCode: the code on disk changed since this process began.
        """
        under_way: dict[Future[Flight], Job] = {}
        while True:
            broken = False
            while not broken and len(under_way) < _ORDERS_EACH * self._workers and (job := next(jobs, None)) is not None:
                future, broken = self._submit(job)
                under_way[future] = job
            if not under_way:
                return
            done, _ = wait(under_way, return_when=FIRST_COMPLETED)
            for future in done:
                if isinstance(future.exception(), BrokenProcessPool):
                    broken = True
                else:
                    del under_way[future]
                    yield future.result()
            if broken:
                suspects = list(under_way.values())
                under_way.clear()
                self._end()
                for job in suspects:
                    yield self._alone(job)

    def _alone(self, job: Job) -> Flight:
        future, _ = self._submit(job)
        try:
            return future.result()
        except BrokenProcessPool:
            self._end()
            return lost(self._plan, job, "the process that flew it died")

    def _submit(self, job: Job) -> tuple[Future[Flight], bool]:
        """Return the flight's future, and whether the pool was found broken."""
        order = order_of(self._plan, job, self._code, self._flyer)
        try:
            if self._pool is None:
                for name in _THREADS:
                    os.environ.setdefault(name, "1")
                context = multiprocessing.get_context("forkserver")
                context.set_forkserver_preload(["sitl.campaign.unborn", "sitl.campaign.workers"])
                _start_server()
                with refused(
                    "the processes of a campaign need shared memory: is /dev/shm there and writable?", OSError, by=SetupImpossible
                ):
                    self._pool = ProcessPoolExecutor(self._workers, mp_context=context, initializer=_begin)
            return self._pool.submit(fly_order, order), False
        except BrokenProcessPool as why:
            future: Future[Flight] = Future()
            future.set_exception(why)
            return future, True

    def _end(self) -> None:
        """End the processes at once: what is under way is flown again in the next session."""
        pool, self._pool = self._pool, None
        if pool is None:
            return
        processes = list((pool._processes or {}).values())
        pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.kill()


def _start_server() -> None:
    """Start the server that forks the workers with SIGINT blocked: a Ctrl-C that comes while it starts is for us alone."""
    resource_tracker.ensure_running()  # it unblocks signals when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin() -> None:
    """Make this process a worker: it leaves Ctrl-C to its parent, and ends with it whatever ended that."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT, signal.SIGTERM])
    threading.Thread(target=_end_with_parent, name="parent", daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait_for_connections([parent.sentinel])
        os._exit(1)


_CONNECT_S = 10.0
_WORKERS_S = 30.0
_POLL_S, _LOOK_S = 0.02, 2.0
_WORKERLESS_S = 60.0
"""Time without any worker after which a campaign ends: one that restarts its workers has them back by then."""
_ORDERS_EACH_THREAD = 3
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
        if missing := [package for package in ("dask", "distributed") if find_spec(package) is None]:
            raise BadInput(
                f"--scheduler {address} needs {' and '.join(missing)}, which is not installed: install requirements/lab.txt, "
                "or the extra decklander[lab]"
            )
        distributed: Any = importlib.import_module("distributed")
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # its report is printed here, in one line
        self._plan, self._code, self._address, self._flyer = plan, code, address, flyer
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
                while len(under_way) < _ORDERS_EACH_THREAD * self.threads and (job := next(jobs, None)) is not None:
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
        order = order_of(self._plan, job, self._code, self._flyer)
        self._orders += 1  # a key that was cancelled stays so, and a job may be ordered again
        return self._client.submit(fly_order, order, key=f"fly-{self._run}-{self._orders}-{job.key}", pure=False)

    def _result(self, future: Any, job: Job) -> Flight | None:
        """Return the result; None if the order was lost: the client cancels its orders when its connection breaks."""
        if future.status == "finished":
            return self._fetched(future)
        error = future.exception(timeout=_CONNECT_S) if future.status == "error" else None
        if type(error).__name__ == "KilledWorker":
            return lost(self._plan, job, "the workers that flew it died")
        if isinstance(error, BadInput):
            raise OtherCode(f"--scheduler {self._address}: {in_words(error)}") from error
        if isinstance(error, BaseException):
            output = f"{type(error).__name__}: {in_words(error)}"
            raise Recoverable(f"--scheduler {self._address}: a worker could not fly: {output}") from error
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
