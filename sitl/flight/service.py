"""The service in virtual time: one process of it, which drives the cycle without thread, socket or clock of its own.

Frames wait for the samples that cover them, and vision takes its time; both as in the daemon, and the same to the bit each time.
"""

from collections.abc import Callable, Iterable, Sequence

from msgspec import structs

from companion.base.containment import Audience
from companion.base.health import Health
from companion.base.observer import Decision, Observer
from companion.cycle.cycle import ATTITUDE_WAIT_S, Begun, Cycle
from companion.cycle.pace import FramePace
from companion.guidance.pilot import Pilot
from companion.settings.model import Settings
from drivers.clock import SetClock
from estimator.contracts.commands import Command
from estimator.contracts.estimates import Verdict
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Frame, Imu, Range, Sample
from estimator.contracts.time import MonoNs, after, seconds_between
from estimator.vision.detection import Detection

VISION_S = 0.01
"""Time that vision takes for a frame, s."""
_QUICK = frozenset({Imu, Attitude, BodyVelocity, Range, Baro})
"""Samples that end no flight: what is made of them is first looked at with the next frame or in the next guidance cycle."""


class SimulatedService:
    """One process of the service, from its start until it ends or is killed.

    Args:
        settings: those that it flies with.
        health: receives what its parts count.
        observers: receive what the daemon's observers would receive.
        clock: the flight's time.
        vision_s: time that vision takes for a frame.
    """

    def __init__(
        self,
        settings: Settings,
        pilot: Pilot,
        health: Health,
        observers: Sequence[Observer],
        clock: SetClock,
        vision_s: float = VISION_S,
    ) -> None:
        self.pilot, self.health, self._clock = pilot, health, clock
        self.watched = True
        """False if health leaves the results of samples out: without observers either, none are made."""
        self._observed, self._vision_s = bool(observers), vision_s
        audience = Audience(tuple(observers), health, guarded=False)
        self.cycle = Cycle(pilot, health, audience, FramePace(settings.vision.core_fraction, pilot.camera, health))
        self.fetch: Callable[[], Sequence[Sample]] = tuple
        """Returns samples that wait in the vehicle's driver; they are taken just before they are needed."""
        self.arrived: Callable[[MonoNs], Iterable[Frame]] = lambda now: ()
        """Returns the frames that have arrived by now and were not returned yet, oldest first."""
        self.judged: Callable[[int, Verdict], object] = lambda seq, verdict: None
        """Receives the number of each frame that is done with, and its verdict."""
        self.decided: Callable[[Decision], object] = lambda decision: None
        """Receives each decision before it is carried out."""
        self._period_s = 1.0 / settings.guidance.rate_hz
        self._due = clock.now()
        self._waiting: list[Sample] = []
        self._looking: tuple[MonoNs, Begun, Detection] | None = None
        self._lacking: tuple[MonoNs, Frame] | None = None
        """A frame for whose samples is waited, and until when."""

    def unobserved(self) -> None:
        """Go on without observers."""
        self._observed, self.cycle.audience = False, Audience((), self.health)

    def take(self, samples: Sequence[Sample]) -> None:
        """Process samples that have arrived, or let them wait where nobody looks at what becomes of each."""
        if self.watched or self._observed:
            wanted = self.watched or self.cycle.audience.takes_fusion
            self.cycle.samples(samples, self._clock.t, wanted=wanted)
            return
        self._waiting += samples
        if not _QUICK.issuperset(map(type, samples)):
            self._flush()

    def catch_up(self) -> None:
        """Give the pilot the samples that wait."""
        if samples := self.fetch():
            self.take(samples)
        self._flush()

    def _flush(self) -> None:
        """Process what waits for the next look at it: together it costs less."""
        if self._waiting:
            waiting, self._waiting = self._waiting, []
            self.cycle.samples(waiting, self._clock.t, wanted=False)

    def step(self, now: MonoNs, act: Callable[[MonoNs], None], send: Callable[[Command], None]) -> None:
        """Process the frames, and run a guidance cycle if one is due.

        Args:
            act: lets a person act before a guidance cycle.
            send: gives a command to the vehicle's driver.
        """
        self._process(now)
        if now >= self._due:
            self._due = after(self._due, self._period_s)
            self.catch_up()
            act(now)
            decision = self.cycle.decide(now)
            self.decided(decision)
            self.cycle.carry_out(decision, send)
            self.cycle.pace.cycle(now, 0.0)

    def _process(self, now: MonoNs) -> None:
        self._finish(now)
        if self._lacking is None and self._looking is None:
            self._receive(now)
        if self._lacking is None:
            return
        self.catch_up()
        until, frame = self._lacking
        if now < until and self.cycle.awaits(frame.stamp, now):
            return
        self._lacking = None
        begun = self.cycle.begin(frame, now)
        if begun.look is None:
            self._conclude(begun, None, now)
            return
        self._looking = after(now, self._vision_s), begun, self.pilot.detect(begun.look)
        self._finish(now)

    def _finish(self, now: MonoNs) -> None:
        """Conclude the frame that is being looked at, once vision has taken its time."""
        if self._looking is None or now < self._looking[0]:
            return
        self.catch_up()
        _, begun, seen = self._looking
        self._looking = None
        self._conclude(begun, seen, now)

    def _receive(self, now: MonoNs) -> None:
        """Take the newest frame that has arrived."""
        newest: Frame | None = None
        for frame in self.arrived(now):
            if newest is not None:
                self.cycle.judged(Verdict.REPLACED)
                self.judged(newest.seq, Verdict.REPLACED)
            newest = frame
        if newest is None:
            return
        if self.cycle.admits(now):
            self._lacking = after(now, ATTITUDE_WAIT_S), newest
        else:
            self.judged(newest.seq, Verdict.SKIPPED)

    def _conclude(self, begun: Begun, seen: Detection | None, now: MonoNs) -> None:
        processed = structs.replace(self.cycle.conclude(begun, seen), done=now)
        self.judged(processed.frame.seq, processed.verdict)
        self.cycle.report(processed)
        if begun.look is not None:
            self.cycle.pace.looked(begun.at, seconds_between(begun.at, now))
        if processed.detection is not None and self.cycle.reads_deck:
            self.cycle.on_deck(self.pilot.search.read_deck(processed.detection))
