"""The service: it supervises one vehicle, one pad tracker and one pilot until the flight has ended or `stop` is called.

Every frame that the driver offers gets exactly one counted verdict. Vision runs on a thread of its own; everything else runs
on the event loop. When the service ends, for whatever reason, the driver leaves the vehicle in its own hover.

Vehicle and guidance are vital; observers and every further part run beside the flight and cannot touch it
(`containment`). On a machine too slow for every frame some are skipped (`FramePace`).
"""

import asyncio
import logging
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from functools import partial
from typing import Protocol

from msgspec.structs import replace

from companion.base.containment import Audience, Body, report, run, uncancelled
from companion.base.health import SHIP_PLACE, Health, missing_inputs
from companion.base.memory import GroundedCollector, no_full_collections
from companion.base.mission import FAULTS, FlightOutcome
from companion.base.observer import Decision, FrameTimes, Observer, ProcessedFrame
from companion.base.orders import HandledOrder
from companion.base.service_log import ReportedOnce
from companion.base.worker import Worker
from companion.guidance.pilot import Look, Pilot
from companion.settings.service import RestartOptions
from drivers.mailbox import Latest, Line
from estimator.attitude_history import HeldCamera
from estimator.contracts.commands import Command
from estimator.contracts.errors import Recoverable
from estimator.contracts.estimates import FusionResult, Verdict
from estimator.contracts.samples import Attitude, Frame, GeoFix, Sample
from estimator.contracts.time import Clock, MonoNs, Stamp, after, seconds_between
from estimator.vision.camera import Camera
from estimator.vision.detection import Detection

_WEIGHT = 0.2
"""Weight of the newest look in the mean: five frames distinguish a slow machine from one slow look."""
_PAUSE_MAX_S = 0.2
"""Longest time without a look: a sighting at least each 0.2 s keeps an estimate fresh, whatever a look costs."""
_LATE_WEIGHT, _LATE_S, _ROOM_S, _BACK_S = 0.05, 0.01, 0.002, 0.0005
"""Weight of the newest guidance cycle in the mean lateness; the mean above which looks make room, s: half a cycle at 50 Hz; what
each cycle adds to the pause between looks then, s, and takes off it once the mean is below half of that."""
_WINDOW_S, _LEFT_OUT, _TOLD_LATE_S = 5.0, 0.4, 0.02
"""Time of one judgement, s; share of frames left out, and mean lateness, s, above which a computer is called too slow. It is
called so until both are below half of that."""

log = logging.getLogger(__name__)


class FramePace:
    """Decides which frames are looked at, and tells health whether the computer keeps up.

    Vision and event loop share the interpreter's lock, and a small computer's core. Vision that is never idle makes guidance late
    and each sighting older: half of the frames, seen in time, land a drone better than all of them, seen late.

    Args:
        core_fraction: the largest share of the time that looks may take, 0 to 1; at 1 no frame is skipped.
        camera: what takes the frames; where they are large, smaller ones are advised.
    """

    def __init__(self, core_fraction: float, camera: Camera, health: Health) -> None:
        self._core_fraction, self._health = core_fraction, health
        smaller = f"choose {camera.width // 2}x{camera.height // 2}"
        self._cure = smaller if camera.width >= 640 else "end other programs on it"
        self._mean_s: float | None = None
        self._late_s = self._pause_s = 0.0
        self._not_before = MonoNs(0)
        self._window: tuple[MonoNs, int, int] | None = None

    def admits(self, now: MonoNs) -> bool:
        """Return whether a frame that arrives now is to be looked at."""
        return self._core_fraction >= 1.0 or now >= self._not_before

    def looked(self, began: MonoNs, duration_s: float) -> None:
        """Take how long a look took, by the clock on the wall: what else keeps the core busy counts."""
        self._mean_s = duration_s if self._mean_s is None else self._mean_s + _WEIGHT * (duration_s - self._mean_s)
        wait_s = self._mean_s / self._core_fraction + self._pause_s
        self._not_before = after(began, min(wait_s, self._mean_s + _PAUSE_MAX_S))

    def cycle(self, now: MonoNs, late_s: float) -> None:
        """Take by how much a guidance cycle came late."""
        self._late_s += _LATE_WEIGHT * (late_s - self._late_s)
        if self._late_s > _LATE_S:
            self._pause_s = min(self._pause_s + _ROOM_S, _PAUSE_MAX_S)
        elif self._late_s < 0.5 * _LATE_S:
            self._pause_s = max(self._pause_s - _BACK_S, 0.0)
        frames = self._health.frames
        arrived, left_out = frames.total(), frames[Verdict.SKIPPED] + frames[Verdict.REPLACED]
        began, arrived_before, left_before = self._window = self._window or (now, arrived, left_out)
        if (took_s := seconds_between(began, now)) >= _WINDOW_S:
            self._window = now, arrived, left_out
            self._judge((arrived - arrived_before) / took_s, (left_out - left_before) / took_s)

    def _judge(self, rate_hz: float, left_out_hz: float) -> None:
        told = self._health.too_slow
        limit, slow = 1.0 if told is None else 0.5, None
        busy = self._pause_s > 0.0 or (self._mean_s or 0.0) * rate_hz > 0.5  # else frames wait for attitudes, not for looks
        if busy and left_out_hz > limit * _LEFT_OUT * rate_hz:
            slow = f"this computer manages {rate_hz - left_out_hz:.0f} of {rate_hz:.0f} frames a second: {self._cure}"
        elif self._late_s > limit * _TOLD_LATE_S:
            slow = f"this computer is too slow: guidance is {1e3 * self._late_s:.0f} ms late"
        self._health.too_slow = slow
        if (slow is None) != (told is None):
            log.warning("%s", slow or "this computer keeps up again")


_ATTITUDE_TRIES, _ATTITUDE_PAUSE_S, _ATTITUDE_SILENT_S = 10, 0.005, 0.2
_UNASKED_S = 0.1
"""Time between two looks for samples that neither guidance nor vision took, because one of them waits or is being restarted."""


class VehicleLink(Protocol):
    """A vehicle with a camera, as a driver offers it while its context is open."""

    @property
    def frames(self) -> Latest[Frame]: ...

    @property
    def samples(self) -> Line[Sample]: ...

    def command(self, command: Command) -> None: ...

    def release(self) -> None:
        """Leave the vehicle to a person on closing, instead of holding it for a successor."""
        ...


OpenLink = Callable[[], AbstractAsyncContextManager[VehicleLink]]


@dataclass(frozen=True, slots=True)
class DaemonSetup:
    """Mode of the daemon: its options beside the settings."""

    restart: RestartOptions
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
        self._link: VehicleLink | None = None
        self._ended = asyncio.Event()
        self._tracker: Worker | None = None
        self._loaded = False
        self._decided = asyncio.Event()
        """Set after the first guidance cycle, which nothing is to delay."""
        self._wrong_size_logged = False
        self._logged, self._reasons = "", ReportedOnce()
        self._look_began = MonoNs(0)
        self._taken_at = MonoNs(0)
        """Time when the waiting samples were last taken."""
        self._newest_fused: Stamp | None = None
        """Stamp of the newest frame in the estimate that no command has used."""
        self._extras = dict(extras or {})
        if reports is not None:
            self._extras["ship_reports"] = partial(self._read_reports, reports)
        self.health = health or Health(clock)
        self._pace = FramePace(options.core_fraction, pilot.camera, self.health)
        self._audience = Audience(observers, self.health)
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
        if self._link is not None:
            self._link.release()
        self._ended.set()

    async def _fly(self) -> None:
        async with self._open_link() as link:
            self._link = link
            try:
                async with asyncio.TaskGroup() as group:
                    group.create_task(uncancelled("hearing the vehicle", lambda: self._read_samples(link)), name="samples")
                    group.create_task(uncancelled("watching its frames", lambda: self._read_frames(link)), name="frames")
            finally:
                self._link = None

    async def _read_samples(self, link: VehicleLink) -> None:
        """Take the samples that nobody requested: guidance and vision take what waits just before they need it.

        Most of the time that the loop spends on a datagram is spent on waking for it, hundreds of times a second.
        """
        while True:
            if seconds_between(self._taken_at, self._clock.now()) >= _UNASKED_S:
                self._take_waiting()
            link.samples.check()
            await self._clock.sleep(_UNASKED_S)

    def _take_waiting(self) -> None:
        self._taken_at = self._clock.now()
        if self._link is not None and (samples := self._link.samples.waiting()):
            self._take(samples)

    async def _read_reports(self, reports: Line[Sample]) -> None:
        async for samples in reports.together():
            self._take(samples)

    def _take(self, samples: Sequence[Sample]) -> None:
        try:
            results, now = self._pilot.on_samples(samples), self._clock.now()
        except Exception as why:
            self._contain("estimator", why)
            return
        arrived: dict[str, int] = {}
        for sample in samples:
            place_of_ship = type(sample) is GeoFix and sample.whose == "vessel"
            name = SHIP_PLACE if place_of_ship else type(sample).__name__
            arrived[name] = arrived.get(name, 0) + 1
        for name, n in arrived.items():
            self.health.beat(name, now, n)
        self._audience.on_samples(samples)
        reported = self._audience.takes_fusion
        for sample, fused in zip(samples, results, strict=True):
            self.health.fused(sample, fused)
            if reported:
                for result in fused:
                    self._audience.on_fusion(sample.stamp.received_at, result)

    async def _read_frames(self, link: VehicleLink) -> None:
        await self._decided.wait()
        if self._tracker is not None and not self._loaded:
            self._loaded = True
            await self._tracker.run(self._prepare_vision)
        overtaken = 0
        async for frame in link.frames:
            for _ in range(link.frames.replaced - overtaken):
                self._judged(Verdict.REPLACED)
            overtaken = link.frames.replaced
            now = self._clock.now()
            self.health.beat("Frame", now)
            if not self._pace.admits(now):
                self.health.frame(Verdict.SKIPPED)
                continue
            try:
                processed = await self._process(frame)
            except asyncio.CancelledError:
                self._judged(Verdict.FAILED)
                raise
            except Exception as why:
                self._judged(Verdict.FAILED)
                self._contain("vision", why)
                continue
            self._judged(processed.verdict)
            self._audience.on_frame(processed)
            reported = self._clock.now()
            if processed.times is not None:
                for stage, seconds in processed.times.by_stage():
                    self.health.delay(stage, seconds)
            self.health.delay("exposure_to_belief", seconds_between(frame.stamp.measured_at, processed.done))
            self.health.delay("outputs", seconds_between(processed.done, reported))
            if processed.verdict is Verdict.FUSED:
                self.health.delay("arrival_to_outputs", seconds_between(frame.stamp.received_at, reported))
                self._newest_fused = frame.stamp
            for result in processed.results:
                self.health.fusion(result)
                self._audience.on_fusion(processed.done, result)
            await self._read_deck(processed)

    async def _read_deck(self, processed: ProcessedFrame) -> None:
        """Let the thread of vision read the deck in a frame that is reported, so that no sighting waits for that."""
        if processed.detection is None or self._tracker is None:
            return
        began = self._clock.now()
        if self._pilot.search.has_unread:
            seen = await self._tracker.run(self._pilot.search.read_deck, processed.detection)
            self._pilot.landing.on_pad(seen.on_pad)
        read_s = seconds_between(began, self._clock.now())
        self._pace.looked(self._look_began, seconds_between(self._look_began, processed.done) + read_s)

    def _prepare_vision(self) -> None:
        import cv2  # a tenth of the service's start, which no guidance cycle waits for

        cv2.setNumThreads(self._options.threads)
        self._options.prepare()

    def _judged(self, verdict: Verdict) -> None:
        self.health.frame(verdict)
        self._pilot.landing.on_verdict(verdict)

    async def _process(self, frame: Frame) -> ProcessedFrame:
        began = self._clock.now()
        attitude, held = await self._attitude_of(frame)
        detection: Detection | None = None
        results: tuple[FusionResult, ...] = ()
        seen, look_s = began, 0.0
        if not self._fits(frame):
            verdict = Verdict.FAILED
        elif (refused := self._pilot.estimator.admit(frame)) is not None:
            verdict = refused
        elif attitude is None:
            verdict = Verdict.NO_ATTITUDE
            await self._follow(frame)
        elif held is None and self._pilot.search.gimballed:
            verdict = Verdict.NO_GIMBAL
        else:
            assert self._tracker is not None
            self._look_began = self._clock.now()
            look = replace(self._pilot.look_at(frame, attitude, held), reads_deck=False)
            found, look_s = await self._tracker.run(self._look, look)
            seen, detection = self._clock.now(), found
            verdict, results = self._pilot.on_detection(found)
        done, times = self._clock.now(), None
        if detection is not None:
            decode_s, waited_s = seconds_between(frame.stamp.received_at, began), seconds_between(began, seen) - look_s
            times = FrameTimes(decode_s, waited_s, look_s, seconds_between(seen, done))
        camera = self._pilot.search.camera_held(held)
        return ProcessedFrame(frame, attitude, detection, verdict, began, done, results, times, camera)

    async def _follow(self, frame: Frame) -> None:
        """Look whether the pad is still in a picture that no attitude covers: it need not be another pad when samples come."""
        assumed = self._pilot.assumed_at(frame.stamp)
        if assumed is not None and self._tracker is not None:
            began = self._clock.now()
            seen = await self._tracker.run(self._pilot.detect, self._pilot.look_after(frame, assumed))
            self._pace.looked(began, seconds_between(began, self._clock.now()))
            self._pilot.on_followed(seen, assumed)

    def _look(self, look: Look) -> tuple[Detection, float]:
        """Look at a frame on the thread of vision; return what was seen, and how long the look took, s."""
        began = self._clock.now()
        detection = self._pilot.detect(look)
        return detection, seconds_between(began, self._clock.now())

    async def _attitude_of(self, frame: Frame) -> tuple[Attitude | None, HeldCamera | None]:
        """Return the attitude at the exposure, and how a gimbal held the camera; wait a little for what covers it.

        On a busy machine the vehicle's samples may still be in a socket when the frame is decoded. There is nothing to wait
        for before the first ones, and while none come.
        """
        attitude, held = None, None
        flow = self.health.flows.get("Attitude")
        age_s = None if flow is None else flow.age_s(self._clock.now())
        for _ in range(_ATTITUDE_TRIES):
            self._take_waiting()
            attitude = self._pilot.estimator.attitude_at(frame.stamp)
            held = None if attitude is None else self._pilot.held_at(frame.stamp, attitude)
            if attitude is None:
                lacking = age_s is not None and age_s < _ATTITUDE_SILENT_S
            else:
                lacking = held is None and self._pilot.awaits_gimbal(frame.stamp)
            if not lacking or self._link is None:
                break
            await self._clock.sleep(_ATTITUDE_PAUSE_S)
        return attitude, held

    def _fits(self, frame: Frame) -> bool:
        height, width = frame.px.shape[:2]
        camera = self._pilot.camera
        if (width, height) == (camera.width, camera.height):
            return True
        if not self._wrong_size_logged:
            self._wrong_size_logged = True
            log.error(
                "the vehicle sends frames of %dx%d px but the camera file describes %dx%d px: none of them can be used",
                width, height, camera.width, camera.height,
            )  # fmt: skip
        return False

    def _contain(self, what: str, why: Exception) -> None:
        """Go on after a fault of ours while a person's order decides, as it must not hold that back; else let it end the service.

        Raises:
            The exception itself: guidance flies alone, or it is one after which the part is started again.
        """
        if isinstance(why, Recoverable) or not self._pilot.operator.commands:
            raise why
        if self.health.contain(what) == 1:
            report("%s failed; a person's order is obeyed without it, further failures are only counted", what, why=why)

    async def _guide(self) -> None:
        while True:
            self._take_waiting()
            began = self._clock.now()
            self.health.beat("Decision", began)
            decision = self._pilot.decide(began)
            self._decided.set()
            decided = self._clock.now()
            self.health.delay("decide", seconds_between(began, decided))
            if decision.command is not None:
                try:
                    if self._link is None:
                        raise Recoverable("the link to the vehicle is not open")
                    self._link.command(decision.command)
                    self._commanded(decided)
                except Recoverable as why:
                    self._pilot.operator.undelivered(decision.command, began, str(why))
                    log.debug("command not sent: %s", why)
            if self._pilot.failure is not None:
                self._contain("guidance", self._pilot.failure)
            self._tell(decision)
            self.health.decision(decision, self._pilot.vehicle)
            self._audience.on_decision(decision)
            vehicle = self._pilot.vehicle
            self._collector.tick(began, None if vehicle is None else vehicle.flying)
            if self._pilot.outcome is not None and self._options.once:
                self._ended.set()
                return
            spent_s = seconds_between(began, self._clock.now())
            await self._clock.sleep(max(0.001, self._period_s - spent_s))
            late_s = seconds_between(began, self._clock.now()) - self._period_s
            self.health.delay("guidance_late", max(0.0, late_s))
            self._pace.cycle(self._clock.now(), late_s)

    def _commanded(self, decided: MonoNs) -> None:
        """Note the times of a command that was given to the link."""
        given = self._clock.now()
        self.health.delay("send", seconds_between(decided, given))
        if self._newest_fused is not None:
            self.health.delay("exposure_to_command", seconds_between(self._newest_fused.measured_at, given))
            self._newest_fused = None

    def _on_order(self, handled: HandledOrder) -> None:
        log.log(logging.INFO if handled.accepted else logging.WARNING, "%s", handled)
        self._audience.on_order(handled)

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
