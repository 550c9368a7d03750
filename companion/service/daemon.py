"""The service: it supervises one vehicle, one pad tracker and one pilot until the flight has ended or `stop` is called.

Every frame that the driver offers gets exactly one counted verdict. Vision runs on a thread of its own; everything else runs
on the event loop. When the service ends, for whatever reason, the driver leaves the vehicle in its own hover.

Vehicle and guidance are vital; observers and every further part run beside the flight and cannot touch it
(`containment`). On a machine too slow for every frame some are skipped (`FramePace`). What is done with samples, frames and
decisions is the cycle's (`companion.cycle`); clock, sockets and thread are here.
"""

import asyncio
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from msgspec import structs

from companion.base.containment import Audience, Body, run, uncancelled
from companion.base.health import Health, missing_inputs
from companion.base.memory import GroundedCollector, no_full_collections
from companion.base.mission import FAULTS, FlightOutcome
from companion.base.observer import Decision, FrameTimes, Observer, ProcessedFrame
from companion.base.orders import HandledOrder
from companion.base.service_log import ReportedOnce
from companion.base.worker import Worker
from companion.cycle.cycle import ATTITUDE_WAIT_S, Cycle
from companion.cycle.pace import FramePace
from companion.cycle.ports import OpenLink, VehicleLink
from companion.guidance.pilot import Look, Pilot
from drivers.mailbox import Line
from drivers.reconnect import BackOff
from estimator.contracts.commands import Command
from estimator.contracts.errors import Recoverable
from estimator.contracts.estimates import Verdict
from estimator.contracts.samples import Frame, Sample
from estimator.contracts.time import Clock, MonoNs, Stamp, seconds_between
from estimator.vision.detection import Detection

log = logging.getLogger(__name__)

_ATTITUDE_TRIES = 10
"""Number of looks, while a frame waits, for the samples that it lacks."""
_UNREQUESTED_S = 0.1
"""Time between two looks for samples that neither guidance nor vision took, because one of them waits or is being restarted."""


@dataclass(frozen=True, slots=True)
class DaemonSetup:
    """Mode of the daemon: its options beside the settings."""

    restart: BackOff
    """The waits before a failed part is started again."""
    guidance_rate_hz: float
    """The rate of guidance cycles."""
    health_period_s: float = 0.0
    """The time between two log lines of health; 0 logs none."""
    threads: int = 1
    """The number of threads that OpenCV may use for one frame."""
    core_fraction: float = 1.0
    """The largest share of the time that looking at frames may take; 1 skips none."""
    once: bool = False
    """True if `Daemon.run` ends with the first flight; otherwise it waits for the next one."""
    prepare: Callable[[], object] = lambda: None
    """Called by the thread of vision before its first frame."""


class Daemon:
    """Connects the vehicle with the pilot.

    Args:
        open_link: opens the vehicle; called again after each `Recoverable`.
        pilot: the pad tracker, the estimator and guidance.
        health: the health that is shared with parts made before the daemon; if absent, a new one is made.
        extras: parts by name that run beside the flight. Their failures do not affect it.
        reports: the ship's reports from other sources than the vehicle's link; None where there are none.
    """

    def __init__(
        self,
        open_link: OpenLink,
        pilot: Pilot,
        clock: Clock,
        options: DaemonSetup,
        *,
        observers: Sequence[Observer] = (),
        health: Health | None = None,
        extras: Mapping[str, Body] | None = None,
        reports: Line[Sample] | None = None,
    ) -> None:
        self._open_link = open_link
        self._pilot = pilot
        self._clock = clock
        self._options = options
        self._period_s = 1.0 / options.guidance_rate_hz
        self._collector = GroundedCollector()
        self.link: VehicleLink | None = None
        """The open link to the vehicle; None while it is not."""
        self._ended = asyncio.Event()
        self._tracker: Worker | None = None
        self._loaded = False
        self._decided = asyncio.Event()
        """Set after the first guidance cycle, which nothing is to delay."""
        self._logged, self._reasons = "", ReportedOnce()
        self._look_began = self._decided_at = MonoNs(0)
        self._taken_at = MonoNs(0)
        """Time when the waiting samples were last taken."""
        self._newest_fused: Stamp | None = None
        """Stamp of the newest frame in the estimate that no command has used."""
        self._extras = dict(extras or {})
        if reports is not None:
            self._extras["ship_reports"] = partial(self._read_reports, reports)
        self.health = health or Health(clock)
        pace = FramePace(options.core_fraction, pilot.camera, self.health)
        self._cycle = Cycle(pilot, self.health, Audience(observers, self.health), pace)
        pilot.operator.on_order = self._on_order

    async def run(self) -> FlightOutcome | None:
        """Run until the flight has ended (with `once`) or `stop` is called; return its outcome, or None if there is none yet.

        Raises:
            ExceptionGroup: our code has a bug; the vehicle was left in its hover.
        """
        vital: dict[str, Body] = {"vehicle": self._fly, "guidance": self._guide}
        beside = dict(self._extras)
        if self._options.health_period_s > 0:
            beside["health"] = self._log_health
        self._tracker = Worker("vision")
        try:
            with no_full_collections():
                await run(vital, self._options.restart, self.health, self._clock, until=self._ended, beside=beside)
        finally:
            self._tracker.close()
        return self._pilot.outcome

    @property
    def looking(self) -> bool:
        """True if vision is at work on its thread."""
        return self._tracker is not None and self._tracker.busy

    def stop(self) -> None:
        """End `run` soon and cleanly, and release the vehicle to a person."""
        if self.link is not None:
            self.link.release()
        self._ended.set()

    async def _fly(self) -> None:
        async with self._open_link() as link:
            self.link = link
            try:
                async with asyncio.TaskGroup() as group:
                    group.create_task(uncancelled("reading its samples", lambda: self._read_samples(link)), name="samples")
                    group.create_task(uncancelled("reading its frames", lambda: self._read_frames(link)), name="frames")
            finally:
                self.link = None

    async def _read_samples(self, link: VehicleLink) -> None:
        """Take the samples that nobody requested: guidance and vision take what waits just before they need it.

        Most of the time that the loop spends on a datagram is spent on waking for it, hundreds of times a second.
        """
        while True:
            if seconds_between(self._taken_at, self._clock.now()) >= _UNREQUESTED_S:
                self._take_waiting()
            link.samples.check()
            await self._clock.sleep(_UNREQUESTED_S)

    def _take_waiting(self) -> None:
        self._taken_at = self._clock.now()
        if self.link is not None and (samples := self.link.samples.waiting()):
            self._take(samples)

    async def _read_reports(self, reports: Line[Sample]) -> None:
        async for samples in reports.together():
            self._take(samples)

    def _take(self, samples: Sequence[Sample]) -> None:
        self._cycle.samples(samples, self._clock.now())

    async def _read_frames(self, link: VehicleLink) -> None:
        await self._decided.wait()
        if self._tracker is not None and not self._loaded:
            self._loaded = True
            await self._tracker.run(self._prepare_vision)
        overtaken = 0
        async for frame in link.frames:
            for _ in range(link.frames.replaced - overtaken):
                self._cycle.judged(Verdict.REPLACED)
            overtaken = link.frames.replaced
            if not self._cycle.admits(self._clock.now()):
                continue
            try:
                processed = await self._process(frame)
            except asyncio.CancelledError:
                self._cycle.judged(Verdict.FAILED)
                raise
            except Exception as why:
                self._cycle.judged(Verdict.FAILED)
                self._cycle.contain("vision", why)
                continue
            self._cycle.report(processed)
            reported = self._clock.now()
            self.health.delay("outputs", seconds_between(processed.done, reported))
            if processed.verdict is Verdict.FUSED:
                self.health.delay("arrival_to_outputs", seconds_between(frame.stamp.received_at, reported))
                self._newest_fused = frame.stamp
            if processed.detection is not None:
                await self._read_deck(processed, processed.detection)

    async def _read_deck(self, processed: ProcessedFrame, seen: Detection) -> None:
        """Let the thread of vision read the deck in a frame that is reported, so that no sighting waits for that."""
        assert self._tracker is not None
        began = self._clock.now()
        if self._cycle.reads_deck:
            self._cycle.on_deck(await self._tracker.run(self._pilot.search.read_deck, seen))
        read_s = seconds_between(began, self._clock.now())
        self._cycle.pace.looked(self._look_began, seconds_between(self._look_began, processed.done) + read_s)

    def _prepare_vision(self) -> None:
        import cv2  # a tenth of the service's start, which no guidance cycle waits for

        cv2.setNumThreads(self._options.threads)
        self._options.prepare()

    async def _process(self, frame: Frame) -> ProcessedFrame:
        arrived = self._clock.now()
        await self._samples_of(frame)
        begun = self._cycle.begin(frame, arrived)
        if begun.look is None:
            return structs.replace(self._cycle.conclude(begun, None), done=self._clock.now())
        assert self._tracker is not None
        self._look_began = self._clock.now()
        found, look_s = await self._tracker.run(self._look, begun.look)
        seen = self._clock.now()
        processed = self._cycle.conclude(begun, found)
        done = self._clock.now()
        if processed.detection is None:
            self._cycle.pace.looked(self._look_began, seconds_between(self._look_began, seen))
            return structs.replace(processed, done=done)
        decode_s, waited_s = seconds_between(frame.stamp.received_at, arrived), seconds_between(arrived, seen) - look_s
        return structs.replace(processed, done=done, times=FrameTimes(decode_s, waited_s, look_s, seconds_between(seen, done)))

    def _look(self, look: Look) -> tuple[Detection, float]:
        """Look at a frame on the thread of vision; return what was seen, and how long the look took, s."""
        began = self._clock.now()
        detection = self._pilot.detect(look)
        return detection, seconds_between(began, self._clock.now())

    async def _samples_of(self, frame: Frame) -> None:
        """Wait a little for the samples that cover a frame: on a busy machine they may still be in a socket."""
        for _ in range(_ATTITUDE_TRIES):
            self._take_waiting()
            if self.link is None or not self._cycle.awaits(frame.stamp, self._clock.now()):
                break
            await self._clock.sleep(ATTITUDE_WAIT_S / _ATTITUDE_TRIES)

    async def _guide(self) -> None:
        while True:
            self._take_waiting()
            began = self._clock.now()
            decision = self._cycle.decide(began)
            self._decided.set()
            self._decided_at = self._clock.now()
            self.health.delay("decide", seconds_between(began, self._decided_at))
            self._cycle.carry_out(decision, self._send)
            self._tell(decision)
            vehicle = self._pilot.vehicle
            self._collector.tick(began, None if vehicle is None else vehicle.flying)
            if self._pilot.outcome is not None and self._options.once:
                self._ended.set()
                return
            spent_s = seconds_between(began, self._clock.now())
            await self._clock.sleep(max(0.001, self._period_s - spent_s))
            late_s = seconds_between(began, self._clock.now()) - self._period_s
            self.health.delay("guidance_late", max(0.0, late_s))
            self._cycle.pace.cycle(self._clock.now(), late_s)

    def _send(self, command: Command) -> None:
        """Give a command to the link, and note its times."""
        if self.link is None:
            raise Recoverable("the link to the vehicle is not open")
        self.link.command(command)
        given = self._clock.now()
        self.health.delay("send", seconds_between(self._decided_at, given))
        if self._newest_fused is not None:
            self.health.delay("exposure_to_command", seconds_between(self._newest_fused.measured_at, given))
            self._newest_fused = None

    def _on_order(self, handled: HandledOrder) -> None:
        log.log(logging.INFO if handled.accepted else logging.WARNING, "%s", handled)
        self._cycle.audience.on_order(handled)

    def _tell(self, decision: Decision) -> None:
        """Log each change of the mission's state, and the phase with its reason where these change by themselves."""
        for change in decision.transitions:
            level = logging.WARNING if change.event in FAULTS else logging.INFO
            log.log(level, "%s: %s (from %s)", change.target.value, change.reason.text, change.source.value)
        if decision.response is not None:
            level = logging.WARNING if decision.response.contradicts else logging.INFO
            log.log(level, "%s", decision.response.text)
        new = self._reasons.new(decision.reason.split("; "), decision.at)
        if (new or decision.phase != self._logged) and not decision.transitions:
            words = ": ".join(filter(None, (decision.phase, decision.reason)))
            log.log(logging.WARNING if decision.reason else logging.INFO, "%s", words)
        self._logged = decision.phase

    async def _log_health(self) -> None:
        while True:
            await self._clock.sleep(self._options.health_period_s)
            frames = ", ".join(
                f"{verdict.value} {n}" for verdict, n in sorted(self.health.frames.items(), key=lambda i: i[0].value)
            )
            health = self.health.snapshot()
            belief, missing = health.stages.get("exposure_to_belief"), missing_inputs(health)
            log.log(
                logging.WARNING if missing else logging.INFO,
                "%s; frames: %s; exposure to belief %s",
                ": ".join(filter(None, (self._pilot.state.value, ", ".join(missing)))),
                frames or "none",
                "unknown" if belief is None or belief.p50_s is None else f"{1e3 * belief.p50_s:.0f} ms",
            )
