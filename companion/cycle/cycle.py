"""The service's cycle without clock, thread or socket: samples, frames and guidance cycles in, results out.

    samples(...)                         what the vehicle and the ship measured
    begin(frame) -> Begun                a verdict, or a look for a thread: `pilot.detect(begun.look)`
    conclude(begun, detection) -> ...    what the look saw is fused, or followed
    report(processed)                    every frame exactly once, with one verdict
    on_deck(detection)                   what the frame shows on the pad, read after the report
    decide(now) -> Decision              one guidance cycle
    carry_out(decision, send)            its command, and its report

Every frame gets exactly one counted verdict. The daemon, the simulated flight and the replay of a recording drive this object,
so what they make of one stream is equal to the bit.
"""

import logging
from collections.abc import Callable, Sequence

from msgspec import Struct, structs

from companion.base.containment import Audience, report
from companion.base.health import SHIP_PLACE, Health
from companion.base.observer import Decision, ProcessedFrame
from companion.cycle.pace import FramePace
from companion.guidance.pilot import Look, Pilot
from estimator.attitude_history import HeldCamera
from estimator.contracts.commands import Command
from estimator.contracts.errors import Recoverable
from estimator.contracts.estimates import FusionResult, Verdict
from estimator.contracts.samples import Attitude, Frame, GeoFix, Sample
from estimator.contracts.time import MonoNs, Stamp, seconds_between
from estimator.vision.detection import Detection

ATTITUDE_WAIT_S = 0.05
"""Time for which a frame waits for the samples that cover it, s."""
_ATTITUDE_SILENT_S = 0.2
"""Age of the newest attitude beyond which none is waited for, s."""

log = logging.getLogger(__name__)


class Begun(Struct, frozen=True, eq=False):
    """A frame that is being processed."""

    frame: Frame
    attitude: Attitude | None
    """The vehicle's at the exposure; None if no sample covers it."""
    held: HeldCamera | None
    """The camera as the gimbal held it at the exposure; None if that is not known, and without a gimbal."""
    at: MonoNs
    verdict: Verdict
    """The verdict, unless something is fused."""
    look: Look | None = None
    """The begin of the search; None for a frame that is not looked at."""
    follows: Attitude | None = None
    """The attitude that the look assumes where no sample covers the frame: the pad is followed, and nothing is fused."""


class Cycle:
    """The service's cycle. A fault of ours in it never holds back a person's order (`Cycle.contain`).

    Args:
        audience: the observers, which get every event in order.
        pace: decides which frames are looked at.
    """

    def __init__(self, pilot: Pilot, health: Health, audience: Audience, pace: FramePace) -> None:
        self.pilot, self.health, self.audience, self.pace = pilot, health, audience, pace
        self._wrong_size_logged = False
        pilot.operator.on_order = lambda handled: self.audience.on_order(handled)

    def samples(self, samples: Sequence[Sample], now: MonoNs, *, wanted: bool = True) -> Sequence[tuple[FusionResult, ...]]:
        """Process samples in the order in which they were received.

        Args:
            wanted: False where nobody reads what becomes of them: together they cost less.

        Returns:
            The results of each, path by path; nothing where they are not wanted, or a person's order is obeyed without them.
        """
        try:
            results = self.pilot.on_samples(samples, wanted=wanted)
        except Exception as why:
            self.contain("estimator", why)
            return ()
        arrived: dict[str, int] = {}
        for sample in samples:
            place_of_ship = type(sample) is GeoFix and sample.whose == "vessel"
            name = SHIP_PLACE if place_of_ship else type(sample).__name__
            arrived[name] = arrived.get(name, 0) + 1
        for name, n in arrived.items():
            self.health.beat(name, now, n)
        self.audience.on_samples(samples)
        if not wanted:
            return ()
        reported = self.audience.takes_fusion
        for sample, fused in zip(samples, results, strict=True):
            self.health.fused(sample, fused)
            if reported:
                for result in fused:
                    self.audience.on_fusion(sample.stamp.received_at, result)
        return results

    def judged(self, verdict: Verdict) -> None:
        """Count a frame by its verdict, one that was replaced or has failed too."""
        self.health.frame(verdict)
        self.pilot.landing.on_verdict(verdict)

    def admits(self, now: MonoNs) -> bool:
        """Return whether a frame that arrives now is to be looked at; else it is counted as skipped."""
        self.health.beat("Frame", now)
        admitted = self.pace.admits(now)
        if not admitted:
            self.health.frame(Verdict.SKIPPED)
        return admitted

    def attitude_of(self, stamp: Stamp, recorded: Attitude | None = None) -> tuple[Attitude | None, HeldCamera | None]:
        """Return the attitude at the exposure, and how a gimbal held the camera; None for what no sample covers."""
        attitude = recorded or self.pilot.estimator.attitude_at(stamp)
        return attitude, None if attitude is None else self.pilot.held_at(stamp, attitude)

    def awaits(self, stamp: Stamp, now: MonoNs) -> bool:
        """Return whether samples that a frame lacks may still come; not before the first ones, and not while none come."""
        attitude, held = self.attitude_of(stamp)
        if attitude is not None:
            return held is None and self.pilot.awaits_gimbal(stamp)
        flow = self.health.flows.get("Attitude")
        age_s = None if flow is None else flow.age_s(now)
        return age_s is not None and age_s < _ATTITUDE_SILENT_S

    def begin(self, frame: Frame, now: MonoNs, recorded: Attitude | None = None) -> Begun:
        """Begin with a frame: its size, then whether it shows anything new, its attitude, its gimbal; then the look.

        Args:
            recorded: the attitude at the exposure as a service recorded it; a part of a recording may lack its samples.
        """
        attitude, held = self.attitude_of(frame.stamp, recorded)
        begun = Begun(frame, attitude, held, now, Verdict.NO_PAD)
        if not self._fits(frame):
            return structs.replace(begun, verdict=Verdict.FAILED)
        if (refused := self.pilot.estimator.admit(frame)) is not None:
            return structs.replace(begun, verdict=refused)
        if attitude is None:
            # The pad in a picture that no attitude covers need not be another one when samples come again.
            assumed = self.pilot.assumed_at(frame.stamp)
            look = None if assumed is None else self.pilot.look_after(frame, assumed)
            return structs.replace(begun, verdict=Verdict.NO_ATTITUDE, look=look, follows=assumed)
        if held is None and self.pilot.search.gimballed:
            return structs.replace(begun, verdict=Verdict.NO_GIMBAL)
        return structs.replace(begun, look=structs.replace(self.pilot.look_at(frame, attitude, held), reads_deck=False))

    def known(self, frame: Frame, now: MonoNs, verdict: Verdict, recorded: Attitude | None) -> Begun:
        """Begin with a frame whose verdict is known already, as in a recording: it is not looked at again."""
        return Begun(frame, *self.attitude_of(frame.stamp, recorded), now, verdict)

    def conclude(self, begun: Begun, seen: Detection | None) -> ProcessedFrame:
        """Fuse what the look of a frame has seen, or follow the pad by it; None where there was no look."""
        verdict = begun.verdict
        results: tuple[FusionResult, ...] = ()
        if begun.follows is not None and seen is not None:
            self.pilot.on_followed(seen, begun.follows)
            seen = None
        elif seen is not None:
            verdict, results = self.pilot.on_detection(seen)
        camera = self.pilot.search.camera_held(begun.held)
        return ProcessedFrame(begun.frame, begun.attitude, seen, verdict, begun.at, begun.at, results, camera=camera)

    def report(self, processed: ProcessedFrame) -> None:
        """Count a frame by its verdict and hand it to the observers."""
        self.judged(processed.verdict)
        self.audience.on_frame(processed)
        for stage, seconds in () if processed.times is None else processed.times.by_stage():
            self.health.delay(stage, seconds)
        self.health.delay("exposure_to_belief", seconds_between(processed.frame.stamp.measured_at, processed.done))
        for result in processed.results:
            self.health.fusion(result)
            self.audience.on_fusion(processed.done, result)

    @property
    def reads_deck(self) -> bool:
        """True if the newest frame still shows the deck: `pilot.search.read_deck` reads it, on any thread, for `on_deck`."""
        return self.pilot.search.has_unread

    def on_deck(self, seen: Detection) -> None:
        """Take what the newest frame shows on the pad and about it."""
        self.pilot.landing.on_pad(seen.on_pad)

    def decide(self, now: MonoNs) -> Decision:
        """Run one guidance cycle. A person's order comes first, before estimator and law."""
        self.health.beat("Decision", now)
        return self.pilot.decide(now)

    def carry_out(self, decision: Decision, send: Callable[[Command], None]) -> None:
        """Send a decision's command and report the decision.

        Args:
            send: gives a command to the vehicle's driver; raises `Recoverable` where it cannot, which the person who gave
                an order learns.
        """
        if decision.command is not None:
            try:
                send(decision.command)
            except Recoverable as why:
                self.pilot.operator.undelivered(decision.command, decision.at, str(why))
                log.debug("command not sent: %s", why)
        if self.pilot.failure is not None:
            self.contain("guidance", self.pilot.failure)
        self.health.decision(decision, self.pilot.vehicle)
        self.audience.on_decision(decision)

    def contain(self, what: str, why: Exception) -> None:
        """Go on after a fault of ours while a person's order decides, as it must not hold that back; else let it end the service.

        Raises:
            The exception itself: guidance flies alone, or it is one after which the part is started again.
        """
        if isinstance(why, Recoverable) or not self.pilot.operator.commands:
            raise why
        if self.health.contain(what) == 1:
            report("%s failed; a person's order is obeyed without it, further failures are only counted", what, why=why)

    def _fits(self, frame: Frame) -> bool:
        height, width = frame.px.shape[:2]
        camera = self.pilot.camera
        if (width, height) == (camera.width, camera.height):
            return True
        if not self._wrong_size_logged:
            self._wrong_size_logged = True
            log.error(
                "the vehicle sends frames of %dx%d px but the camera file describes %dx%d px: none of them can be used",
                width, height, camera.width, camera.height,
            )  # fmt: skip
        return False
