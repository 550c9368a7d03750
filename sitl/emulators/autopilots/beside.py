"""Run the daemon beside an autopilot with frames from outside, as a task or as a process that can be killed and started again."""

import asyncio
from collections.abc import Callable, Sequence
from typing import Literal

import msgspec

from companion.base.containment import RESTART
from companion.base.health import Health
from companion.base.observer import Observer
from companion.cycle.ports import Assembly
from companion.guidance.pilot import Pilot
from companion.service.daemon import Daemon, DaemonSetup
from companion.service.vehicle_parts import ExposurePart, vehicle_parts
from companion.settings.model import Settings
from drivers.camera.exposure import ExposureDrive
from drivers.mavlink.autopilot import Autopilot
from drivers.mavlink.options import AutopilotOptions, autopilot_of
from estimator.contracts.samples import Frame, Sample
from estimator.contracts.time import Clock


class FlightDaemon:
    """The daemon of one flight.

    Args:
        settings: the daemon's settings, as `beside_autopilot` returns them.
        once: whether it ends with the first outcome; else it waits for the next flight.
    """

    def __init__(
        self, settings: Settings, pilot: Pilot, clock: Clock, observers: Sequence[Observer] = (), *, once: bool = True
    ) -> None:
        health = Health(clock)
        self.pilot = pilot
        parts = vehicle_parts(Assembly(settings, pilot, health, clock))
        self.exposure, exposing = exposure_beside(settings, pilot, health)
        """The exposure that the daemon drives; None where the camera does."""
        observers = (*parts.observers, *observers, *exposing)
        self.daemon = Daemon(
            parts.open_link,
            pilot,
            clock,
            DaemonSetup(RESTART, settings.guidance.rate_hz, threads=settings.vision.threads, once=once),
            observers=observers,
            health=health,
        )

    @property
    def autopilot(self) -> Autopilot | None:
        """The link to the autopilot while it is open."""
        link = self.daemon.link
        return link if isinstance(link, Autopilot) else None

    def offer(self, frame: Frame) -> None:
        """Give the daemon a frame that has arrived."""
        offer(self.daemon, frame)

    def report(self, sample: Sample) -> None:
        """Give the daemon a report of the ship that has arrived."""
        report(self.daemon, sample)

    def concluded(self) -> int:
        """Return the number of frames that were processed."""
        return sum(self.daemon.health.frames.values())

    def looking(self) -> bool:
        """Return whether vision is at work on its thread."""
        return self.daemon.looking


def offer(daemon: Daemon, frame: Frame) -> None:
    """Give a daemon a frame that has arrived; it is lost while the link to the vehicle is closed."""
    if daemon.link is not None:
        daemon.link.frames.offer(frame)


def report(daemon: Daemon, sample: Sample) -> None:
    """Give a daemon a report of the ship that has arrived, likewise."""
    if daemon.link is not None:
        daemon.link.samples.offer(sample)


def driven_exposure(settings: Settings) -> ExposureDrive | None:
    """Return the exposure that a service of these settings drives; None where the camera exposes by itself."""
    options = settings.camera.exposure
    return ExposureDrive(options.settle_frames) if options.driven else None


def exposure_beside(
    settings: Settings, pilot: Pilot, health: Health, drive: ExposureDrive | None = None
) -> tuple[ExposureDrive | None, tuple[Observer, ...]]:
    """Return the exposure that the service drives, the given one or a new one, and its observers; nothing if it drives none."""
    drive = drive or driven_exposure(settings)
    if drive is None:
        return None, ()
    part = ExposurePart(settings.camera.exposure, pilot)
    part.attach(drive)
    health.counters("exposure", part.counted)
    return drive, (part,)


def autopilot_in(settings: Settings) -> AutopilotOptions:
    """Return the autopilot of the settings."""
    vehicle = autopilot_of(settings.vehicle)
    assert vehicle is not None
    return vehicle


def beside_autopilot(
    settings: Settings, links: str, start: Literal["automatic", "signal"] = "signal", response: str | None = None
) -> Settings:
    """Return the settings with the autopilot at `links`, and the given start of the landing.

    Args:
        settings: of an autopilot in a simulated world (`rig_for` with `by_autopilot`).
        response: the shipped response of this stack, where the settings leave it to the vehicle; None for an autopilot's.
    """
    follow = settings.guidance.follow_deck
    if response is not None and follow.response_by_vehicle:
        follow = msgspec.structs.replace(follow, response=response)
    return msgspec.structs.replace(
        settings,
        vehicle=msgspec.structs.replace(autopilot_in(settings), links=links),
        guidance=msgspec.structs.replace(settings.guidance, start=start, follow_deck=follow),
    )


class KillableService:
    """One daemon after the other; a new one knows of those before it what a service keeps in its file.

    What a killed daemon still sends while its tasks end must be kept from the vehicle: a killed process sends nothing.

    Args:
        make: makes a daemon with a pilot of its own, that waits for the next flight after an outcome.
    """

    def __init__(self, make: Callable[[], FlightDaemon]) -> None:
        self._make = make
        self.now = make()
        """The newest daemon, even if it was killed."""
        self.gone = False
        """True if it was killed and no new one runs."""
        self._task: asyncio.Task[object] | None = None
        self._offered = self._before = self._unheard = 0

    @property
    def pilot(self) -> Pilot:
        """The newest daemon's."""
        return self.now.pilot

    @property
    def health(self) -> Health:
        """The newest daemon's."""
        return self.now.daemon.health

    def ended(self, ordered: bool) -> bool:
        """Return whether the newest daemon ended its flight by itself.

        A new daemon may find a vehicle that stands on the deck, which is the end of a flight but not of the one it is to fly.

        Args:
            ordered: whether it was ordered to land.
        """
        if self.gone or self._task is None:
            return False
        return self._task.done() or (ordered and self.now.pilot.outcome is not None)

    def start(self, group: asyncio.TaskGroup) -> None:
        """Run the daemon in a group of tasks."""
        self._task = group.create_task(self.now.daemon.run())

    def kill(self) -> None:
        """Let the daemon be gone from now on."""
        self.gone = True
        if self._task is not None:
            self._task.cancel()

    async def restart(self, group: asyncio.TaskGroup) -> None:
        """Run a new daemon in the place of a killed one."""
        if self._task is not None:
            await asyncio.wait({self._task})
        before = self.now.pilot.landing.memory
        self.now, self.gone = self._make(), False
        self.now.pilot.landing.before = before
        self._before, self._unheard = self._offered, 0
        self.start(group)

    async def stop(self) -> None:
        """End the daemon and wait until it has ended."""
        self.now.daemon.stop()
        if self._task is not None:
            await asyncio.wait({self._task})

    def offer(self, frame: Frame) -> None:
        """Give the daemon a frame that has arrived, if there is one that can take it."""
        self._offered += 1
        if self.gone or self.now.daemon.link is None:
            self._unheard += 1
        else:
            self.now.offer(frame)

    def report(self, sample: Sample) -> None:
        """Give the daemon a report of the ship that has arrived, if there is one that can take it."""
        if not self.gone:
            self.now.report(sample)

    def concluded(self) -> int:
        """Return the number of offered frames that are done with."""
        return self._offered if self.gone else self._before + self._unheard + self.now.concluded()

    def looking(self) -> bool:
        """Return whether vision is at work on its thread."""
        return not self.gone and self.now.looking()
