"""Fly one job of a campaign, wherever that is; what goes wrong in a flight is its result and not the campaign's end."""

import hashlib
import os
import platform
import traceback
from collections.abc import Callable
from typing import Any, NamedTuple

from companion.settings.model import Settings
from estimator.contracts.errors import BadInput, in_words
from sitl.campaign.plan import AnyPlan, Job, canonical, code_version, differences, unpacked
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
    began_s = _cpu_s()
    try:
        scenario, settings = base.with_values(job.point, "the campaign's point")
        flight = order.flyer(name, scenario, job.seed, settings, perception, model)
    except Exception as why:
        place = traceback.extract_tb(why.__traceback__)[-1]
        output = f"{type(why).__name__}: {in_words(why)} ({place.filename.rpartition('/')[2]}:{place.lineno})"
        flight = failed(name, job, output, _cpu_s() - began_s)
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


def _cpu_s() -> float:
    spent = os.times()
    return spent.user + spent.system
