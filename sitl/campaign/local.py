"""Fly jobs on the cores of this machine, each in a process of its own pool; a process that dies costs no flight."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import wait as wait_for_connections

from sitl.campaign.plan import AnyPlan, Job
from sitl.campaign.task import Flight, Flyer, Order, base_of, failed, finished, fly_flight, fly_order

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
        self._plan, self._bases = plan, dict[str, bytes]()
        self._code, self._workers, self._flyer = code, workers, flyer
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
            return finished(
                failed(self._plan.of(job).name, job, "the process that flew it died"), job, self._plan.of(job).perception
            )

    def _submit(self, job: Job) -> tuple[Future[Flight], bool]:
        """Return the flight's future, and whether the pool was found broken."""
        order = Order(job, base_of(self._plan, job, self._bases), self._code, self._flyer)
        try:
            if self._pool is None:
                self._pool = _new_pool(self._workers)
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


def _new_pool(workers: int) -> ProcessPoolExecutor:
    for name in _THREADS:
        os.environ.setdefault(name, "1")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["sitl.campaign.unborn", "sitl.campaign.task"])
    _start_server()
    return ProcessPoolExecutor(workers, mp_context=context, initializer=_begin)


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
