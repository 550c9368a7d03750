"""A soak: repeated landings in one process, each graded, while memory, descriptors, threads and tasks are watched for leaks."""

import asyncio
import json
import sys
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field
from io import FileIO
from pathlib import Path

import msgspec

from companion.base import event_loop
from companion.base.health import Health
from companion.base.signals import Stopped
from companion.guidance.make_pilot import make_pilot
from companion.guidance.pilot import Pilot
from companion.service.assemble import make_daemon
from companion.settings.mission import TryOptions
from companion.settings.model import Settings
from drivers.clock import SystemClock
from estimator.contracts.errors import BadInput, Recoverable
from estimator.contracts.estimates import Verdict
from sitl.campaign.growth import Findings, Reading, findings, give_back, read
from sitl.campaign.plan import CampaignPlan
from sitl.campaign.soak_flights import Class, Flown, Outcomes, Records, real, virtual
from sitl.flight.one_flight import FlyOptions, fly
from sitl.perception.levels import perceive, represents
from sitl.scenario.scenario import Scenario
from sitl.scenario.with_fault import faulty

WARM_UP_SHARE, WARM_UP_MOST_S = 0.2, 900.0
"""Warm-up as a share of the run, and its limit: textures, caches and the allocator's arenas are filled by then."""
WARM_UP_FLIGHTS = 30
"""Number of flights after which the faults have gone most ways through the code once, and its caches and arenas are full."""
OPERATOR_WAIT_S = 15.0
"""Longest wait of the pilot for an operator: nobody is there, and a scenario's time must not end before the wait."""
_READ_EACH_S = 5.0
_SAY_EACH_S = 60.0
_DECIDED_S = 2
"""Seconds in which the pilot learns that a flight has ended; the next flight begins later."""


@dataclass(frozen=True, slots=True)
class SoakOptions:
    """Options of a soak: its flights, its length and its files."""

    seed: int
    """Seed of the first flight; each flight adds 1."""
    hours: float
    """Wall time, or flight time in virtual time."""
    flights: int | None
    """Flights in virtual time, in place of hours."""
    virtual: bool
    """Fly in virtual time, without sockets."""
    faults: bool
    fault: str | None
    """The fault of every flight; None for one by the flight's seed."""
    failed_max: int
    """Failed flights that are allowed."""
    plot: Path | None
    readings: Path | None
    """File for every reading as a line of JSON."""
    json: bool
    """Print one JSON object in place of words."""


@dataclass(slots=True)
class Tally:
    """The flights and the resource readings so far."""

    began: float = field(default_factory=time.monotonic)
    endings: Counter[str] = field(default_factory=Counter)
    outcomes: Outcomes = field(default_factory=lambda: Outcomes(Records(Flown)))
    flown_s: float = 0.0
    readings: Records[Reading] = field(default_factory=lambda: Records(Reading))
    file: FileIO | None = None
    """File for the readings, written without a buffer: a run that is killed keeps its readings."""
    _said: float = 0.0

    @property
    def flights(self) -> int:
        return self.endings.total()

    @property
    def on_pad(self) -> int:
        """Number of flights that landed on the pad."""
        return self.outcomes.count(Class.ON_PAD)

    def flown(self, ending: str, flight: Flown) -> None:
        """Add a flight that has ended."""
        self.endings[ending] += 1
        self.outcomes.flights.append(flight)

    def take(self, tasks: int | None, quiet: bool, before_mib: float | None = None) -> None:
        """Take a reading of the process, and print a line about it every minute.

        Args:
            before_mib: what `give_back` returned just before; None where it was not called.
        """
        reading = read(time.monotonic() - self.began, self.flights, tasks, before_mib)
        self.readings.append(reading)
        if self.file is not None:
            try:
                self.file.write(json.dumps(asdict(reading)).encode() + b"\n")
            except OSError as why:
                sys.stderr.write(f"--readings: {self.file.name!s}: {why.strerror or why}; no more are written\n")
                self.file = None
        if not quiet and reading.at_s - self._said >= _SAY_EACH_S:
            self._said = reading.at_s
            sys.stderr.write(
                f"{reading.at_s / 60:5.0f} min  {self.flights} flights, {self.on_pad} on the pad, "
                f"{self.outcomes.count(Class.FAILED)} failed  {reading.memory_mib:.1f} MiB  "
                f"{reading.descriptors} descriptors  {reading.threads} threads\n"
            )


def soak(options: SoakOptions, plan: CampaignPlan, scenario: Scenario, settings: Settings) -> int:
    """Fly, print what was found, and return the exit code.

    Args:
        plan: says what is flown, and how a flight is flown again.
        scenario: the scenario of the plan.
        settings: the settings of the plan.

    Raises:
        BadInput: the scenario cannot have the fault, or a file cannot be written.
    """
    if options.fault is not None:
        every = faulty(scenario, options.seed, possible=lambda _: True, name=options.fault)
        perceive(plan.perception, plan.perception_model).refuse(every.faults)
    settings = flown_settings(settings)
    if options.plot is not None:
        _writable("--plot", options.plot)
    interrupted: Stopped | None = None
    with nullcontext() if options.readings is None else _opened(options.readings) as file:
        tally = Tally(file=file)
        try:
            if options.virtual:
                _virtually(options, plan, scenario, settings, tally)
            else:
                event_loop.run(_really(options, plan.name, settings, tally))
        except Stopped as why:
            interrupted = why
    found = None
    readings = list(tally.readings)
    if readings:
        found = findings(readings, warm_up_s(readings))
    _say(options, plan, tally, found)
    if options.plot is not None:
        from sitl.campaign import plots

        plots.soak(options.plot, readings, list(tally.outcomes.flights))
    if interrupted is not None:
        raise interrupted
    return 0 if found is not None and not found.faults and not tally.outcomes.faults(options.failed_max) else 1


def flown_settings(settings: Settings) -> Settings:
    """Return the settings of the flights, without what only a person would need."""
    service = msgspec.structs.replace(settings.service, health_period_s=0.0, log_level="error")
    own = settings.guidance.tries
    tries = msgspec.structs.replace(own, operator_wait_s=min(own.operator_wait_s, OPERATOR_WAIT_S))
    guidance = msgspec.structs.replace(settings.guidance, tries=tries)
    return msgspec.structs.replace(settings, service=service, guidance=guidance)


def warm_up_s(readings: Sequence[Reading]) -> float:
    """Return the length of the warm-up: a share of the run, and in a long one at least its first `WARM_UP_FLIGHTS` flights."""
    usual_s = min(WARM_UP_MOST_S, WARM_UP_SHARE * readings[-1].at_s)
    if readings[-1].flights < 2 * WARM_UP_FLIGHTS:
        return usual_s
    return max(usual_s, next(reading.at_s for reading in readings if reading.flights >= WARM_UP_FLIGHTS))


def overtime_s(tries: TryOptions) -> float:
    """Return for how long a flight may go on after its scenario's time while guidance still tries to land.

    A flight is graded when it has ended; one that is cut in its third try shows nothing about the fourth.
    """
    return tries.landing_s


def _virtually(options: SoakOptions, plan: CampaignPlan, scenario: Scenario, settings: Settings, tally: Tally) -> None:
    seed = options.seed
    level = perceive(plan.perception, plan.perception_model)
    while tally.flights < options.flights if options.flights is not None else tally.flown_s < 3600.0 * options.hours:
        wanted = (
            faulty(scenario, seed, possible=lambda s: represents(level, s.faults), name=options.fault)
            if options.faults
            else scenario
        )
        # A fault costs tries, and the scenario's time was chosen without it.
        longer_s = overtime_s(settings.guidance.tries) if options.faults else 0.0
        rarer = FlyOptions(plan.perception_model, overtime_s=longer_s)
        ending = fly(plan.name, wanted, seed, settings, plan.perception, options=rarer)
        flight = virtual(time.monotonic() - tally.began, wanted.title, ending)
        tally.flown("time is up" if ending.outcome is None else ending.outcome.value, flight)
        tally.flown_s += ending.duration_s
        del ending, flight
        tally.take(None, options.json, give_back())
        seed += 1


async def _really(options: SoakOptions, scenario: str, settings: Settings, tally: Tally) -> None:
    child = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "sitl.emulators.ardrone.serve", scenario, f"--seed={options.seed}", "--repeat"),
        *(["--faults"] if options.faults else []),
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
        pilot = make_pilot(settings)
        clock = SystemClock()
        daemon = make_daemon(settings, pilot, clock=clock)
        tally.began = time.monotonic()
        tally.take(len(asyncio.all_tasks()), quiet=True)
        async with asyncio.TaskGroup() as group:
            flying = group.create_task(daemon.run())
            listening = group.create_task(_listen(child.stdout, tally, pilot, daemon.health))
            reading = group.create_task(_read(tally, options.json))
            await asyncio.wait({flying, listening}, timeout=3600.0 * options.hours, return_when=asyncio.FIRST_COMPLETED)
            ended_early = listening.done()
            reading.cancel()
            listening.cancel()
            daemon.stop()
        if ended_early:
            raise Recoverable("the simulated drone ended; see its output above")
    finally:
        tally.flown_s = time.monotonic() - tally.began
        child.stdin.close()
        await child.communicate()


async def _listen(lines: asyncio.StreamReader, tally: Tally, pilot: Pilot, health: Health) -> None:
    before: Counter[Verdict] = Counter()
    async for line in lines:
        printed = json.loads(line)
        if printed.get("event") == "flight":
            for _ in range(_DECIDED_S * 20):
                if pilot.outcome is not None or printed["ended"] == "time is up":
                    break
                await asyncio.sleep(0.05)  # the drone says that it landed before the pilot knows of it
            frames = health.frames - before
            before = Counter(health.frames)
            late_s = late.quantile(0.5) if (late := health.delays.get("guidance_late")) is not None else None
            tally.flown(printed["ended"], real(time.monotonic() - tally.began, printed, pilot.outcome, frames, late_s))


async def _read(tally: Tally, quiet: bool) -> None:
    while True:
        await asyncio.sleep(_READ_EACH_S)
        tally.take(len(asyncio.all_tasks()), quiet)


def _writable(option: str, path: Path) -> None:
    """Check before the first flight that a file can be written."""
    try:
        path.open("ab").close()
    except OSError as why:
        raise BadInput(f"{option}: {path}: {why.strerror or why}") from why


def _opened(path: Path) -> FileIO:
    try:
        return path.open("wb", buffering=0)
    except OSError as why:
        raise BadInput(f"--readings: {path}: {why.strerror or why}") from why


def _say(options: SoakOptions, plan: CampaignPlan, tally: Tally, found: Findings | None) -> None:
    if options.json:
        printed = {"flights": tally.flights, "on_pad": tally.on_pad, "endings": dict(tally.endings), "flown_s": tally.flown_s}
        printed |= {**tally.outcomes.as_json(), "flight_faults": tally.outcomes.faults(options.failed_max)}
        sys.stdout.write(json.dumps({**printed, "findings": None if found is None else found.as_json()}) + "\n")
        return
    endings = ", ".join(f"{n} {name}" for name, n in sorted(tally.endings.items()))
    lines = [
        f"{tally.flights} flights in {tally.flown_s / 3600:.2f} h: {endings}",
        *tally.outcomes.in_words(plan.name, plan.options),
    ]
    if found is None:
        lines.append("too short to measure growth")
    else:
        m = found.memory_mib
        lines.append(
            f"memory     {m.first:.1f} to {m.last:.1f} MiB ({m.growth:+.2%}, most {m.most:.1f}) after {found.warm_up_s:.0f} s"
        )
        for name, trend in (("descriptors", found.descriptors), ("threads", found.threads), ("tasks", found.tasks)):
            if trend is not None:
                lines.append(f"{name:<10} {trend.first:g} to {trend.last:g} (most {trend.most:g})")
        lines.append(f"CPU        {found.cpu_share:.0%} of a core" + (", as fast as it goes" if options.virtual else ""))
    lines += [f"FAULT: {fault}" for fault in tally.outcomes.faults(options.failed_max)]
    lines += [f"FAULT: {fault}" for fault in found.faults] if found is not None else []
    sys.stdout.write("\n".join(lines) + "\n")
