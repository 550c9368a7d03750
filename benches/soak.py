"""Land again and again in one process, and watch memory, descriptors, threads and tasks for leaks.

`python -m benches.soak demo --virtual --hours 2` flies two hours of simulated flight, each flight with its own seed and fault;
without --virtual the landing service flies the simulated drone through sockets in real time. Campaigns judge flights; here the
exit code is 1 if after warm-up memory grew by 1 %, or descriptors, threads or tasks by one. The resources are read from /proc,
so a soak needs Linux. One too short to measure that says so and ends with 0.
"""

import argparse
import asyncio
import gc
import json
import os
import resource
import signal
import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from statistics import median

import msgspec
from msgspec import Struct, field

from benches.options import described, parsed
from companion.base import event_loop, memory
from companion.guidance.pilot import make_pilot
from companion.service.assemble import make_daemon
from companion.settings.model import Settings
from drivers.clock import SystemClock
from estimator.contracts.errors import Recoverable, SetupImpossible
from sitl.flight.one_flight import fly
from sitl.perception.levels import perceive, represents
from sitl.scenario.scenario import Scenario, load
from sitl.scenario.settings import settings_for
from sitl.scenario.with_fault import faulty

GROWTH_MAX = 0.01
"""Share by which memory may grow after warm-up."""
WARM_UP_SHARE, WARM_UP_MOST_S = 0.2, 900.0
"""Warm-up as a share of the run, and its limit: textures, caches and the allocator's arenas are filled by then."""
WARM_UP_FLIGHTS = 30
"""Number of flights after which the faults have gone most ways through the code once, and its caches and arenas are full."""
_READINGS_MIN = 8
"""Number of readings after warm-up that show a trend."""
_PAGE = resource.getpagesize()


class Reading(Struct, frozen=True):
    """The resources of this process at one instant."""

    at_s: float
    """Wall time since the start, seconds."""
    flights: int
    memory_mib: float
    """Resident memory, MiB. In virtual time it is read when what is free has been given back; see `give_back`."""
    descriptors: int
    threads: int
    tasks: int | None
    """Number of asyncio tasks; None without a loop."""
    cpu_s: float
    """CPU time so far, user and system, all threads, seconds."""


def give_back() -> None:
    """Collect what nothing refers to and give free memory back to the system.

    Without this a reading says where the heap happened to be cut: the C library keeps free pages between blocks that are in use
    (some 25 MiB here), and now and then a frame's buffer that fits into none of the gaps makes the heap longer. That looks like
    a leak of some megabytes, and would hide a small one.
    """
    gc.collect()
    memory.give_back()


def read(at_s: float, flights: int, tasks: int | None) -> Reading:
    """Take a reading now.

    Raises:
        SetupImpossible: there is no /proc.
    """
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        descriptors, threads = len(os.listdir("/proc/self/fd")) - 1, len(os.listdir("/proc/self/task"))
    except OSError as why:
        raise SetupImpossible(f"a soak reads /proc, which is not there: {why.strerror}") from why
    spent = resource.getrusage(resource.RUSAGE_SELF)
    cpu_s = spent.ru_utime + spent.ru_stime
    return Reading(at_s, flights, pages * _PAGE / 2**20, descriptors, threads, tasks, cpu_s)


class Trend(Struct, frozen=True):
    """One quantity after warm-up: the medians of the first and the last quarter of its readings."""

    first: float
    last: float
    most: float

    @property
    def growth(self) -> float:
        """Return the growth from `first` to `last` as a share of `first`; negative if it shrank."""
        return self.last / self.first - 1.0 if self.first else 0.0


class Findings(Struct, frozen=True):
    """Trends of the readings after warm-up."""

    warm_up_s: float
    cpu_share: float
    """CPU load after warm-up, in shares of one core."""
    memory_mib: Trend
    counted: dict[str, Trend | None]
    """Trends of descriptors, threads and tasks; None for tasks without a loop."""

    @property
    def faults(self) -> list[str]:
        """Return what grew and must not, in words."""
        output, m = [], self.memory_mib
        if m.growth >= GROWTH_MAX:
            output.append(f"memory grew by {m.growth:.1%} ({m.first:.1f} to {m.last:.1f} MiB)")
        for name, trend in self.counted.items():
            if trend is not None and trend.last > trend.first:
                output.append(f"{name} grew from {trend.first:g} to {trend.last:g}")
        return output

    def in_words(self, virtual: bool) -> list[str]:
        """Return a line for each quantity."""
        m = self.memory_mib
        lines = [
            f"memory     {m.first:.1f} to {m.last:.1f} MiB ({m.growth:+.2%}, most {m.most:.1f}) after {self.warm_up_s:.0f} s"
        ]
        for name, trend in self.counted.items():
            if trend is not None:
                lines.append(f"{name:<10} {trend.first:g} to {trend.last:g} (most {trend.most:g})")
        return [*lines, f"CPU        {self.cpu_share:.0%} of a core" + (", as fast as it goes" if virtual else "")]


def findings(readings: Sequence[Reading], warm_up_s: float) -> Findings | None:
    """Return the trends; None while fewer than eight readings are past the warm-up."""
    after = [r for r in readings if r.at_s >= warm_up_s]
    if len(after) < _READINGS_MIN:
        return None

    def trend(name: str) -> Trend | None:
        values = [getattr(r, name) for r in after]
        if None in values:
            return None
        quarter = len(values) // 4
        return Trend(float(median(values[:quarter])), float(median(values[-quarter:])), float(max(values)))

    wall_s = after[-1].at_s - after[0].at_s
    memory_mib = trend("memory_mib")
    assert memory_mib is not None
    return Findings(
        warm_up_s=warm_up_s,
        cpu_share=(after[-1].cpu_s - after[0].cpu_s) / wall_s if wall_s > 0 else 0.0,
        memory_mib=memory_mib,
        counted={name: trend(name) for name in ("descriptors", "threads", "tasks")},
    )


def warm_up_s(readings: Sequence[Reading]) -> float:
    """Return the length of the warm-up: a share of the run, and in a long one at least its first `WARM_UP_FLIGHTS` flights."""
    usual_s = min(WARM_UP_MOST_S, WARM_UP_SHARE * readings[-1].at_s)
    if readings[-1].flights < 2 * WARM_UP_FLIGHTS:
        return usual_s
    return max(usual_s, next(reading.at_s for reading in readings if reading.flights >= WARM_UP_FLIGHTS))


OPERATOR_WAIT_S = 15.0
"""Longest wait of the pilot for an operator: nobody is there, and a scenario's time must not end before the wait."""
_READ_EACH_S = 60.0


class Tally(Struct):
    """The flights' endings and the resource readings so far."""

    endings: Counter[str] = field(default_factory=Counter)
    readings: list[Reading] = field(default_factory=list)
    began: float = field(default_factory=time.monotonic)

    def take(self, tasks: int | None) -> None:
        """Take a reading of the process, and print a line about it."""
        reading = read(time.monotonic() - self.began, self.endings.total(), tasks)
        self.readings.append(reading)
        sys.stderr.write(
            f"{reading.at_s / 60:5.0f} min  {reading.flights} flights  {reading.memory_mib:.1f} MiB  "
            f"{reading.descriptors} descriptors  {reading.threads} threads\n"
        )


def main(argv: Sequence[str] | None = None) -> int:
    """Fly, print what was found, and return the exit code."""
    parser = described(__doc__)
    parser.add_argument("scenario", nargs="?", default="demo")
    parser.add_argument("--virtual", action="store_true", help="fly in virtual time, without sockets")
    parser.add_argument("--hours", type=float, default=1.0, help="hours to run; with --virtual hours of flight time")
    parser.add_argument("--runs", type=int, help="with --virtual: number of flights, in place of --hours")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first flight")
    parser.add_argument("--no-faults", action="store_true")
    parser.add_argument("--perception", default="pixels", help="with --virtual: pixels, model or truth")
    args = parsed(parser, "calm --virtual --runs 12 --perception truth --no-faults", argv)
    if not args.virtual and (args.runs is not None or args.perception != "pixels"):
        parser.error("--runs and --perception need --virtual")
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    scenario, tally, interrupted = load(args.scenario), Tally(), False
    settings = flown_settings(settings_for(scenario, None))
    try:
        if args.virtual:
            _virtually(args, scenario, settings, tally)
        else:
            event_loop.run(_really(args, settings, tally))
    except KeyboardInterrupt:
        interrupted = True
    found = findings(tally.readings, warm_up_s(tally.readings)) if tally.readings else None
    print(f"{tally.endings.total()} flights: {', '.join(f'{n} {name}' for name, n in sorted(tally.endings.items()))}")
    lines = ["too short to measure growth"] if found is None else found.in_words(args.virtual)
    faults = found.faults if found is not None else []
    print("\n".join([*lines, *(f"FAULT: {fault}" for fault in faults)]))
    return 130 if interrupted else int(not tally.readings or bool(faults))


def flown_settings(settings: Settings) -> Settings:
    """Return the settings of the flights, without what only a person would need."""
    service = msgspec.structs.replace(settings.service, health_period_s=0.0, log_level="error")
    own = settings.guidance.tries
    tries = msgspec.structs.replace(own, operator_wait_s=min(own.operator_wait_s, OPERATOR_WAIT_S))
    guidance = msgspec.structs.replace(settings.guidance, tries=tries)
    return msgspec.structs.replace(settings, service=service, guidance=guidance)


def _virtually(args: argparse.Namespace, scenario: Scenario, settings: Settings, tally: Tally) -> None:
    seed, level, flown_s = args.seed, perceive(args.perception, None), 0.0
    while tally.endings.total() < args.runs if args.runs is not None else flown_s < 3600.0 * args.hours:
        wanted = scenario if args.no_faults else faulty(scenario, seed, possible=lambda s: represents(level, s.faults))
        ending = fly(args.scenario, wanted, seed, settings, args.perception)
        tally.endings["time is up" if ending.outcome is None else ending.outcome.value] += 1
        flown_s += ending.duration_s
        del ending
        give_back()
        tally.take(None)
        seed += 1


async def _really(args: argparse.Namespace, settings: Settings, tally: Tally) -> None:
    child = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "sitl.emulators.ardrone.serve", args.scenario, f"--seed={args.seed}", "--repeat"),
        *([] if args.no_faults else ["--faults"]),
        *(f"--{name}-port=0" for name in ("navdata", "video", "at", "control")),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
    )
    assert child.stdin is not None
    assert child.stdout is not None
    try:
        async with asyncio.timeout(60.0):
            first = await child.stdout.readline()
        if not first:
            raise Recoverable("the simulated drone ended before it was ready; see its output above")
        ports = {f"{name}_port": port for name, port in json.loads(first)["ports"].items()}
        settings = msgspec.structs.replace(settings, vehicle=msgspec.structs.replace(settings.vehicle, **ports))
        daemon = make_daemon(settings, make_pilot(settings), clock=SystemClock())
        tally.began = time.monotonic()
        tally.take(len(asyncio.all_tasks()))
        async with asyncio.TaskGroup() as group:
            flying = group.create_task(daemon.run())
            listening = group.create_task(_listen(child.stdout, tally))
            reading = group.create_task(_read(tally))
            await asyncio.wait({flying, listening}, timeout=3600.0 * args.hours, return_when=asyncio.FIRST_COMPLETED)
            ended_early = listening.done()
            reading.cancel()
            listening.cancel()
            daemon.stop()
        if ended_early:
            raise Recoverable("the simulated drone ended; see its output above")
    finally:
        child.stdin.close()
        await child.communicate()


async def _listen(lines: asyncio.StreamReader, tally: Tally) -> None:
    async for line in lines:
        printed = json.loads(line)
        if printed.get("event") == "flight":
            tally.endings[printed["ended"]] += 1


async def _read(tally: Tally) -> None:
    while True:
        await asyncio.sleep(_READ_EACH_S)
        tally.take(len(asyncio.all_tasks()))


if __name__ == "__main__":
    sys.exit(main())
