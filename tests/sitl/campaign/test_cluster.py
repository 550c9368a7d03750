"""The same campaign on a Dask cluster: a killed worker loses nothing, and what does not fit is refused by name."""

import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from companion.cli import main as cli
from estimator.contracts.errors import BadInput, Recoverable
from sitl.campaign.plan import Job, code_version
from sitl.campaign.task import Order, OtherCode, fly_order
from sitl.campaign.workers import ClusterWorkers
from tests.sitl.campaign.fakes import RAISES, fake_fly, plan, tally_of

pytestmark = pytest.mark.slow


@contextmanager
def worker_program(*args: str, ready: str, **env: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run a program of Dask until the end of the context; the text is the line in which it says that it is ready."""
    more = {**os.environ, "PYTHONPATH": os.getcwd(), **env}
    child = subprocess.Popen([sys.executable, "-m", *args], stderr=subprocess.PIPE, text=True, env=more)
    assert child.stderr is not None
    try:
        line = next((line for line in child.stderr if ready in line), "")
        assert line, f"{args} ended before it was ready"
        yield child, line
    finally:
        child.kill()
        child.communicate()


def worker(address: str, name: str, **env: str):
    command = ("distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--name", name)
    return worker_program(*command, ready="Registered to", **env)


@pytest.fixture(scope="module")
def served() -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Yield a scheduler with one worker, and its address. The last test here ends it."""
    command = ("distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
    with worker_program(*command, ready="Scheduler at") as (head, line):
        address = re.search(r"tcp://\S+", line)[0]
        with worker(address, "one"):
            yield head, address


def test_a_cluster_gives_the_same_results_although_a_worker_is_killed(served) -> None:
    own, (_, address) = plan(start={"height_m": 2.1}), served
    seeds = range(RAISES - 12, RAISES + 13)
    alone = tally_of(fly_order(Order(Job(seed), own.base(), code_version(), fake_fly)) for seed in seeds)
    with worker(address, "two") as (victim, _), ClusterWorkers(own, code_version(), address, fake_fly) as cluster:
        assert cluster.threads == 2
        flights = []
        for flight in cluster.results(map(Job, seeds)):
            flights.append(flight)
            if len(flights) == 5:
                victim.kill()
    assert sorted(flight["seed"] for flight in flights) == list(seeds)
    assert tally_of(flights).hash == alone.hash
    assert tally_of(flights).counts["errors"] == 1


def test_orders_that_a_broken_connection_cancelled_are_given_again(served) -> None:
    own = plan(start={"height_m": 2.2})
    seeds = range(RAISES + 1, RAISES + 13)
    with ClusterWorkers(own, code_version(), served[1], fake_fly) as cluster:
        flights = []
        for flight in cluster.results(map(Job, seeds)):
            flights.append(flight)
            if len(flights) == 3:
                client = cluster._client
                client.loop.add_callback(client.scheduler_comm.comm.abort)
    assert sorted(flight["seed"] for flight in flights) == list(seeds)


def test_a_worker_with_other_code_is_refused_by_name(served) -> None:
    other = {**code_version(), "sources": "0" * 32}
    with pytest.raises(OtherCode, match=r"worker tcp://\S+ has other code: sources \w{12} instead of 000000000000"):
        ClusterWorkers(plan(), other, served[1], fake_fly)


def test_no_scheduler_and_a_wrong_address(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sitl.campaign.workers._CONNECT_S", 1.0)
    assert cli.main(["campaign", "calm", "--runs", "2", "--scheduler", "tcp://127.0.0.1:9"]) == 1
    output = capsys.readouterr().err
    assert "--scheduler tcp://127.0.0.1:9: no scheduler answers there" in output
    assert output.count("\n") == 1
    with pytest.raises(BadInput, match="write it as tcp://host:8786"):
        ClusterWorkers(plan(), code_version(), "carrier-pigeon://x", fake_fly)


def test_a_scheduler_that_dies_is_one_clear_line(served) -> None:
    own, (head, address) = plan(start={"height_m": 2.3}), served
    with ClusterWorkers(own, code_version(), address, fake_fly) as cluster:
        flights = cluster.results(map(Job, range(40)))
        next(flights)
        head.kill()
        began_s = time.monotonic()
        with pytest.raises(Recoverable, match=rf"--scheduler {address}: the scheduler is gone; the same command goes on"):
            list(flights)
        assert time.monotonic() - began_s < 60.0
